// What is drawn of a guided axis: the axis, the funnel around it, and the bone with its neck and guide hole.
// Everything is built upright, the axis along y and the entry point at the origin, and then put in its place.

import {
  BufferGeometry, CylinderGeometry, Group, LatheGeometry, Line, LineDashedMaterial, Mesh, RingGeometry,
  SphereGeometry, Vector2, Vector3,
} from "three";
import { flat, shaded } from "./materials.js";
import { colour } from "./theme.js";

const MM = 1000;
const UP = new Vector3(0, 1, 0);
// drawn only: the neck of a femur is some three quarters as thick as its head
const NECK_RADII = 0.72;
const NECK_LENGTHS = 1.6;

const glassy = (opacity) => shaded({ opacity, depthWrite: false });

function axis({ from_m: from, to_m: to }) {
  const material = new LineDashedMaterial({ dashSize: 3, gapSize: 2 });
  const ends = [new Vector3(0, from * MM, 0), new Vector3(0, to * MM, 0)];
  const line = new Line(new BufferGeometry().setFromPoints(ends), material);
  line.computeLineDistances();
  return { parts: [line], materials: { guide: [material] } };
}

function funnel({ profile_m: profile }) {
  const material = glassy(0.3);
  const points = profile.map(([r, z]) => new Vector2(r * MM, z * MM));
  return { parts: [new Mesh(new LatheGeometry(points, 72), material)], materials: { guide: [material] } };
}

function bone({ radius_m: radius, hole_radius_m: hole }) {
  const material = glassy(0.55);
  const head = new Mesh(new SphereGeometry(radius * MM, 64, 40), material);
  head.position.y = -radius * MM;
  const neck = new Mesh(
    new CylinderGeometry(NECK_RADII * radius * MM, NECK_RADII * radius * MM, NECK_LENGTHS * radius * MM, 48, 1, true),
    material,
  );
  neck.position.y = -(1 + NECK_LENGTHS / 2 + 0.5) * radius * MM;
  const rim = flat({ depthTest: false });
  const ring = new Mesh(new RingGeometry(hole * MM * 0.93, hole * MM, 48), rim);
  ring.rotation.x = -Math.PI / 2;
  ring.renderOrder = 3;
  return { parts: [head, neck, ring], materials: { bone: [material], guide: [rim] } };
}

/** Builders by the kind of an object; each gives a group in its place, and a function that colours it anew. */
export function guidedBuilders(toWorld) {
  const placed = (build) => (object) => {
    const { parts, materials } = build(object);
    const group = new Group();
    group.add(...parts);
    group.position.copy(toWorld(object.entry_m));
    group.quaternion.setFromUnitVectors(UP, toWorld(object.axis).normalize());
    const recolour = () => {
      for (const [name, all] of Object.entries(materials)) all.forEach((material) => material.color.set(colour(name)));
    };
    return { group, recolour };
  };
  return { axis: placed(axis), funnel: placed(funnel), bone: placed(bone) };
}
