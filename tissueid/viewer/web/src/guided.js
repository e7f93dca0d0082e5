// What is drawn of a guided axis: the axis, the funnel around it, and the bone with its neck and guide hole.
// Everything is built upright, the axis along y and the entry point at the origin, and then put in its place.

import {
  BufferGeometry, CylinderGeometry, Group, LatheGeometry, Line, LineDashedMaterial, Mesh, RingGeometry,
  SphereGeometry, Vector2, Vector3,
} from "three";
import { flat, inked, shaded } from "./materials.js";

const MM = 1000;
const UP = new Vector3(0, 1, 0);
// drawn only: the neck of a femur is some three quarters as thick as its head
const NECK_RADII = 0.72;
const NECK_LENGTHS = 1.6;

const glassy = (ink, opacity) => shaded(ink, { opacity, depthWrite: false });

function axis({ from_m: from, to_m: to }) {
  const material = inked("guide", new LineDashedMaterial({ dashSize: 3, gapSize: 2 }));
  const ends = [new Vector3(0, from * MM, 0), new Vector3(0, to * MM, 0)];
  const line = new Line(new BufferGeometry().setFromPoints(ends), material);
  line.computeLineDistances();
  return [line];
}

function funnel({ profile_m: profile }) {
  const points = profile.map(([r, z]) => new Vector2(r * MM, z * MM));
  return [new Mesh(new LatheGeometry(points, 72), glassy("guide", 0.3))];
}

function bone({ radius_m: radius, hole_radius_m: hole }) {
  const material = glassy("bone", 0.55);
  const r = radius * MM;
  const head = new Mesh(new SphereGeometry(r, 64, 40), material);
  head.position.y = -r;
  const tube = new CylinderGeometry(NECK_RADII * r, NECK_RADII * r, NECK_LENGTHS * r, 48, 1, true);
  const neck = new Mesh(tube, material);
  neck.position.y = -(1 + NECK_LENGTHS / 2 + 0.5) * r;
  const ring = new Mesh(new RingGeometry(hole * MM * 0.93, hole * MM, 48), flat("guide", { depthTest: false }));
  ring.rotation.x = -Math.PI / 2;
  ring.renderOrder = 3;
  return [head, neck, ring];
}

/** Builders by the kind of an object; each gives a group in its place. */
export function guidedBuilders(toWorld) {
  const placed = (build) => (object) => {
    const group = new Group();
    group.add(...build(object));
    group.position.copy(toWorld(object.entry_m));
    group.quaternion.setFromUnitVectors(UP, toWorld(object.axis).normalize());
    return group;
  };
  return { axis: placed(axis), funnel: placed(funnel), bone: placed(bone) };
}
