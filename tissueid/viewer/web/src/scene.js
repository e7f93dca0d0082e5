// The scene: tissue, tool, force, contact, workspace.  World: millimetres of the device, y up.
// The device's frame is x right, y up, z toward the user: what lies in front of the user lies below here.

import {
  AmbientLight, ArrowHelper, Box3, Box3Helper, BoxGeometry, BufferAttribute, Color, ConeGeometry, CylinderGeometry,
  DirectionalLight, FrontSide, Group, HemisphereLight, LineSegments, BufferGeometry, Mesh, PerspectiveCamera,
  PlaneGeometry, Quaternion, RingGeometry, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { CSS2DObject, CSS2DRenderer } from "three/addons/renderers/CSS2DRenderer.js";
import { ImprovedNoise } from "three/addons/math/ImprovedNoise.js";
import { guidedBuilders } from "./guided.js";
import { behind, flat, lined, shaded, wet } from "./materials.js";
import { colour } from "./theme.js";

const MM = 1000;
// a tip is drawn at least this large, or it could not be seen
const SMALLEST_TIP_MM = 6;
const SHAFT_MM = 90;
// a guide wire must not hide the hole it goes into; a real one has 1.2 mm
const WIRE_MM = 1.2;
const WIRE_LENGTH_MM = 120;
// 5 N is half of the workspace
const ARROW_MM_PER_N = 12;
const SMALLEST_ARROW_N = 0.02;
const PATCH_MM = 120;
const SLAB_MM = 42;
const SEGMENTS = 60;
const BOX_ROWS = 12;
// the first vertex of a box's lid, which comes behind two of its walls
const LID = 2 * (SEGMENTS + 1) * (BOX_ROWS + 1);
const SPHERE_ROWS = 64;
const SPHERE_COLUMNS = 96;
// what a cone is drawn as deep as, in its drawn radii
const CONE_HEIGHT = 2.6;
// tissue is mottled by so much of its colour
const MOTTLE = 0.16;
// a dent of this depth is drawn in the colour of what is pressed [mm]
const PRESSED_MM = 14;
// share of the frame that is left free around the block
const MARGIN = 0.1;
// a surface that lags behind its tool by more has been left by it [mm]
const LEFT_MM = 0.02;
// every so many lines of the mesh one is drawn: bent lines show what shading alone does not
const LINE_EVERY = 4;
// pictures that come slower are drawn with fewer pixels, and those without a graphics card with the fewest
const SLOW_MS = 45;
const LEAST_RATIO = 0.5;
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;

const CAMERAS = { oblique: [105, 95, 165], front: [0, 26, 230], side: [230, 26, 0.01], top: [0, 240, 0.01] };
// of every kind something: drawn small before anything is known, so that its shaders are ready by then
const REHEARSAL = [
  { kind: "workspace", ranges_m: [[-0.05, 0.05], [-0.05, 0.05], [0.07, 0.17]] },
  { kind: "tool", radius_m: 0.004, shape: "sphere", half_angle_deg: null },
  { kind: "surface", shape: "plane", point_m: [0, 0, 0.12], normal: [0, 0, 1], size_m: [0, 0, 0], motion_scale: 1 },
];
// what is looked at lies a little above the surface, where the tool is; of a block, a little below
const RAISED_MM = 6;
const LOWERED_MM = 5;

const flatPatch = () => new PlaneGeometry(PATCH_MM, PATCH_MM, SEGMENTS, SEGMENTS).rotateX(-Math.PI / 2);
/** Tissues about the origin, and the lattice that lines are drawn along: rows, columns and first vertex. */
const FORMS = {
  sphere: ([x]) => [new SphereGeometry(x, SPHERE_COLUMNS, SPHERE_ROWS), SPHERE_ROWS, SPHERE_COLUMNS, 0],
  box: ([x, y, z]) => [new BoxGeometry(2 * x, 2 * z, 2 * y, SEGMENTS, BOX_ROWS, SEGMENTS), SEGMENTS, SEGMENTS, LID],
  plane: (_size, turn) => [flatPatch().applyQuaternion(turn), SEGMENTS, SEGMENTS, 0],
};

/** From the device's frame [m] to the world [mm]. */
export const toWorld = ([x, y, z]) => new Vector3(x * MM, z * MM, -y * MM);
/** The inverse. */
export const toDevice = (point) => [point.x / MM, -point.z / MM, point.y / MM];

export class TissueScene {
  /** words: where those of the arrow and of the point that the hand asks for are put, over the canvas. */
  constructor(canvas, words) {
    this.canvas = canvas;
    const software = isSoftware();
    this.tissueMaterial = software ? shaded : wet;
    this.renderer = new WebGLRenderer({ canvas, antialias: !software });
    this.words = new CSS2DRenderer({ element: words });
    // asking for a shader's errors waits for it, and for those before it
    this.renderer.debug.checkShaderErrors = false;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(38, 1, 1, 2000);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = 40;
    this.controls.maxDistance = 600;
    this.scene.add(new AmbientLight(0xffffff, 0.9), new HemisphereLight(0xffffff, 0x806060, 1.1));
    const sun = new DirectionalLight(0xffffff, 1.8);
    sun.position.set(60, 140, 90);
    this.scene.add(sun);
    this.content = new Group();
    this.scene.add(this.content);
    this.ratio = Math.min(window.devicePixelRatio || 1, 2) * (software ? LEAST_RATIO : 1);
    this.intervalMs = 0;
    this.drawnMs = performance.now();
    this.changed = true;
    this.clear();
    this.controls.addEventListener("change", () => { this.changed = true; });
    this.view = "oblique";
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
  }

  /** Draw what a scene is made of once, on a few pixels, and forget it: for the time before there is one. */
  rehearse() {
    this.renderer.setSize(8, 8, false);
    this.show({ scene: { objects: REHEARSAL } });
    this.place({ position_m: [0, 0, 0.118], force_N: [0, 0, 2], depth_mm: 2, surface_mm: 2, ruptured: true, target_m: [0, 0, 0.1] });
    // all are asked for before one is waited for
    this.renderer.compile(this.scene, this.camera);
    this.renderer.render(this.scene, this.camera);
    this.clear();
    this.renderer.render(this.scene, this.camera);
    this.resize();
  }

  /** Nothing to be seen. */
  clear() {
    this.content.clear();
    this.surface = this.tool = this.dentAt = null;
    this.up = new Vector3(0, 1, 0);
    this.centre = new Vector3();
  }

  /** Build what a hello lists; kinds this page does not know are left out. */
  show(hello) {
    this.clear();
    const builders = {
      workspace: (object) => this.workspace(object), tool: (object) => this.buildTool(object),
      surface: (object) => this.buildSurface(object), ...guidedBuilders(toWorld),
    };
    for (const object of hello.scene.objects) {
      const made = builders[object.kind]?.(object);
      if (made) this.content.add(made);
    }
    this.recolour();
    this.look(this.view);
    this.resize();
  }

  workspace({ ranges_m: ranges }) {
    const box = new Box3().setFromPoints([0, 1].map((end) => toWorld(ranges.map((one) => one[end]))));
    box.getCenter(this.centre);
    return Object.assign(new Box3Helper(box), { material: lined("faint", { opacity: 0.45 }) });
  }

  buildTool({ radius_m: radius, shape, half_angle_deg: halfAngle, axis }) {
    const wire = shape === "wire";
    if (wire) this.up = toWorld(axis).normalize();
    this.tipRadius = wire ? 0 : radius * MM;
    this.drawnRadius = wire ? WIRE_MM : Math.max(this.tipRadius, SMALLEST_TIP_MM);
    this.tool = new Group();
    const material = shaded("tool");
    this.tip = { shape, slope: shape === "cone" ? Math.tan((halfAngle * Math.PI) / 180) : 0 };
    const form = tipGeometry(shape, this.drawnRadius, this.tip.slope);
    const tip = new Mesh(form, material);
    // the part that is in the tissue is seen through it
    const hidden = new Mesh(form, behind("tool"));
    const thickness = wire ? this.drawnRadius : this.drawnRadius * 0.45;
    const length = wire ? WIRE_LENGTH_MM : SHAFT_MM;
    const shaft = new Mesh(new CylinderGeometry(thickness, thickness, length, 24), material);
    shaft.position.y = length / 2;
    for (const part of [tip, shaft]) part.renderOrder = 2;
    hidden.renderOrder = 3;
    this.tool.add(tip, shaft, hidden);
    this.arrow = new ArrowHelper(new Vector3(0, 1, 0), new Vector3(), 1);
    // the arrow is seen through the tool: it starts inside it
    this.arrow.line.material = lined("device", { linewidth: 3, depthTest: false });
    this.arrow.cone.material = flat("device", { depthTest: false });
    this.arrow.line.renderOrder = this.arrow.cone.renderOrder = 5;
    this.arrow.visible = false;
    const ring = wire ? SMALLEST_TIP_MM * 0.6 : this.drawnRadius * 1.1;
    this.contact = new Mesh(new RingGeometry(ring, ring * 1.18, 40), flat("device", { depthTest: false }));
    this.contact.renderOrder = 4;
    this.target = new Mesh(new SphereGeometry(2.2, 16, 12), flat("hand", { depthTest: false, opacity: 0.85 }));
    this.spring = segments("hand", new Array(6).fill(0));
    this.spring.frustumCulled = false;
    const cross = [-1, 0, -1, 1, 0, 1, -1, 0, 1, 1, 0, -1].map((value) => value * this.drawnRadius * 1.6);
    this.rupture = segments("alarm", cross);
    this.target.renderOrder = this.spring.renderOrder = 6;
    this.rupture.renderOrder = 7;
    for (const part of [this.target, this.spring, this.rupture]) part.visible = false;
    this.forceTag = tag("force");
    this.target.add(tag("hand", "your hand"));
    this.content.add(this.forceTag, this.tool, this.arrow, this.contact, this.target, this.spring, this.rupture);
  }

  buildSurface(object) {
    const size = object.size_m.map((value) => value * MM);
    const point = toWorld(object.point_m);
    this.up = toWorld(object.normal).normalize();
    const [geometry, ...lattice] = FORMS[object.shape](size, this.upright());
    geometry.translate(...point);
    const tissue = this.tissueMaterial(null, { vertexColors: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
    // the far wall of a closed tissue would be drawn over the near one
    if (object.shape !== "plane") tissue.side = FrontSide;
    const mesh = new Mesh(geometry, tissue);
    geometry.setAttribute("color", new BufferAttribute(new Float32Array(geometry.attributes.position.array.length), 3));
    mesh.frustumCulled = false;
    this.content.add(mesh);
    this.surface = { object, point, mesh, rest: geometry.attributes.position.array.slice(), mottle: mottle(geometry.attributes.position.array), deformed: -1, reach: object.shape === "plane" ? PATCH_MM / 2 : 2 * Math.min(...size.filter((one) => one > 0)) };
    this.addLines(geometry, ...lattice);
    if (object.shape === "plane") this.addSlab(point);
  }

  /** Lines on a tissue, along the lattice of its vertices: they bend with it. */
  addLines(geometry, rows, columns, first) {
    const index = [];
    const at = (i, j) => first + i * (columns + 1) + j;
    for (let i = 0; i <= rows; i += 1) {
      for (let j = 0; j <= columns; j += 1) {
        if (i % LINE_EVERY === 0 && j < columns) index.push(at(i, j), at(i, j + 1));
        if (j % LINE_EVERY === 0 && i < rows) index.push(at(i, j), at(i + 1, j));
      }
    }
    const lines = new BufferGeometry();
    lines.setAttribute("position", geometry.attributes.position);
    lines.setIndex(index);
    const grid = new LineSegments(lines, lined("mesh", { opacity: 0.2 }));
    grid.renderOrder = 1;
    grid.frustumCulled = false;
    this.content.add(grid);
  }

  /** The block that a flat tissue belongs to. */
  addSlab(point) {
    const material = shaded("slab", { opacity: 0.55, depthWrite: false });
    const walls = new Group();
    for (const [x, z, turn] of [[0, 1, 0], [0, -1, 0], [1, 0, Math.PI / 2], [-1, 0, Math.PI / 2]]) {
      const wall = new Mesh(new PlaneGeometry(PATCH_MM, SLAB_MM), material);
      wall.position.set((x * PATCH_MM) / 2, -SLAB_MM / 2, (z * PATCH_MM) / 2);
      wall.rotation.y = turn;
      walls.add(wall);
    }
    walls.quaternion.copy(this.upright());
    walls.position.copy(point);
    this.content.add(walls);
  }

  /** Turn from the world's y to the direction out of the tissue. */
  upright() {
    return new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), this.up);
  }

  recolour() {
    this.scene.background = new Color(colour("scene"));
    this.tissueColour = new Color(colour("tissue"));
    this.pressedColour = new Color(colour("pressed"));
    this.content.traverse(({ material }) => {
      if (material?.userData.ink) material.color.set(colour(material.userData.ink));
    });
    if (this.surface) this.surface.deformed = -1;
    this.changed = true;
  }

  look(name) {
    this.view = name;
    const target = this.surface ? this.surface.point.clone() : this.centre.clone();
    if (this.surface && this.surface.object.shape !== "plane") target.copy(this.centre);
    const narrow = Math.max(1, 1.15 / Math.max(this.camera.aspect, 0.2));
    target.addScaledVector(this.up, this.surface?.object.shape === "plane" ? -LOWERED_MM : RAISED_MM);
    this.controls.target.copy(target);
    this.camera.position.copy(target).add(new Vector3(...CAMERAS[name]).multiplyScalar(narrow));
    this.stepBack(target);
    this.controls.update();
    this.changed = true;
  }

  /** Move the camera away from what it looks at until the whole block is in the frame. */
  stepBack(target) {
    if (this.surface?.object.shape !== "plane") return;
    this.camera.lookAt(target);
    this.camera.updateMatrixWorld();
    const [right, up, back] = [new Vector3(), new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, back);
    const high = Math.tan((this.camera.fov * Math.PI) / 360) * (1 - MARGIN);
    const turn = this.upright();
    let distance = this.camera.position.distanceTo(target);
    for (const x of [-0.5, 0.5]) for (const z of [-0.5, 0.5]) for (const y of [0, -SLAB_MM]) {
      const corner = new Vector3(x * PATCH_MM, y, z * PATCH_MM).applyQuaternion(turn).add(this.surface.point).sub(target);
      const aside = Math.max(Math.abs(corner.dot(right)) / (high * this.camera.aspect), Math.abs(corner.dot(up)) / high);
      distance = Math.max(distance, corner.dot(back) + aside);
    }
    this.camera.position.copy(target).addScaledVector(back, distance);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    const before = this.camera.aspect;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(width, height, false);
    this.words.setSize(width, height);
    if (Math.abs(before - this.camera.aspect) > 0.01) this.look(this.view);
    this.changed = true;
  }

  /** Millimetres of the world that one pixel covers where the tool is. */
  mmPerPixel() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    return (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.canvas.clientHeight;
  }

  /** Place everything as a sample says. state: { position_m, force_N, depth_mm, surface_mm, ruptured, target_m } */
  place(state) {
    if (!this.tool || Number.isNaN(state.position_m[0])) return;
    const grip = toWorld(state.position_m);
    const out = this.outward(grip, state.force_N);
    const force = toWorld(state.force_N).divideScalar(MM);
    this.tool.position.copy(grip).addScaledVector(out, this.drawnRadius - this.tipRadius);
    this.tool.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), out);
    const newtons = force.length();
    this.arrow.visible = newtons > SMALLEST_ARROW_N;
    if (this.arrow.visible) {
      const length = newtons * ARROW_MM_PER_N + 6;
      this.arrow.position.copy(this.tool.position);
      this.arrow.setDirection(force.normalize());
      this.arrow.setLength(length + this.drawnRadius, 6, 5);
      this.forceTag.position.copy(this.arrow.position).addScaledVector(force, length + this.drawnRadius);
      this.forceTag.element.textContent = `${newtons.toFixed(2)} N on the hand`;
    }
    this.forceTag.visible = this.arrow.visible;
    const tip = grip.clone().addScaledVector(out, -this.tipRadius);
    const scale = this.surface ? this.surface.object.motion_scale : 1;
    const depth = Math.max(state.depth_mm, 0) * scale;
    this.contact.visible = depth > 0;
    this.contact.position.copy(tip).addScaledVector(out, depth);
    this.contact.quaternion.setFromUnitVectors(new Vector3(0, 0, 1), out);
    this.rupture.visible = state.ruptured;
    this.rupture.position.copy(this.contact.position);
    if (this.surface) {
      // a surface that its tool has left goes back by itself, as the law says, where it was left
      const dent = Math.max(state.surface_mm, 0) * scale;
      const left = dent > depth + LEFT_MM;
      if (!left || this.dentAt === null) this.dentAt = this.contact.position.clone();
      this.deform(this.dentAt, out, Math.max(dent, depth));
    }
    this.target.visible = this.spring.visible = state.target_m !== null;
    if (this.target.visible) {
      this.target.position.copy(toWorld(state.target_m));
      const ends = this.spring.geometry.attributes.position;
      ends.array.set([...grip, ...this.target.position]);
      ends.needsUpdate = true;
    }
    this.changed = true;
  }

  /** Direction out of the tissue at the tool. */
  outward(grip, force) {
    const shape = this.surface?.object.shape;
    if (shape === "sphere") return grip.clone().sub(this.surface.point).normalize();
    const push = toWorld(force);
    if (shape === "box" && push.length() > SMALLEST_ARROW_N * MM) return push.normalize();
    return this.up.clone();
  }

  /** Press the surface in around a point: outside the contact as under a sphere on a half space (Hertz). */
  deform(at, out, depth) {
    const { mesh, rest, reach } = this.surface;
    if (depth === this.surface.deformed && depth === 0) return;
    this.surface.deformed = depth;
    const press = dentUnder(this.tip, this.drawnRadius, depth);
    const positions = mesh.geometry.attributes.position;
    const colours = mesh.geometry.attributes.color;
    const { array } = positions;
    const tint = new Color(), vertex = new Vector3();
    for (let i = 0; i < array.length; i += 3) {
      const r = vertex.fromArray(rest, i).distanceTo(at);
      const down = depth === 0 ? 0 : press(r) * Math.max(0, 1 - (r / reach) ** 2);
      vertex.addScaledVector(out, -down).toArray(array, i);
      tint.copy(this.tissueColour).multiplyScalar(this.surface.mottle[i / 3]).lerp(this.pressedColour, Math.min(0.85, down / PRESSED_MM));
      tint.toArray(colours.array, i);
    }
    positions.needsUpdate = colours.needsUpdate = true;
    mesh.geometry.computeVertexNormals();
  }

  /** Draw, where anything has changed; fewer pixels on a machine that is slow at it. */
  draw(nowMs) {
    if (!this.changed) return false;
    this.changed = false;
    this.renderer.render(this.scene, this.camera);
    this.words.render(this.scene, this.camera);
    // a long rest between two pictures says nothing about how long they take
    const interval = Math.min(nowMs - this.drawnMs, 4 * SLOW_MS);
    this.drawnMs = nowMs;
    this.intervalMs += 0.05 * (interval - this.intervalMs);
    if (this.intervalMs > SLOW_MS && this.ratio > LEAST_RATIO) {
      this.ratio = Math.max(LEAST_RATIO, this.ratio * 0.8);
      this.intervalMs = 0;
      this.resize();
    }
    return true;
  }

  /** The scene as a PNG. */
  picture() {
    this.renderer.render(this.scene, this.camera);
    return new Promise((done) => { this.canvas.toBlob(done, "image/png"); });
  }
}

/** Whether pictures are computed without a graphics card. */
function isSoftware() {
  const probe = document.createElement("canvas").getContext("webgl2");
  const facts = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = facts ? probe.getParameter(facts.UNMASKED_RENDERER_WEBGL) : "";
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name);
}

/** Straight lines between pairs of points, seen through everything. */
function segments(ink, places) {
  const points = new BufferAttribute(new Float32Array(places), 3);
  return new LineSegments(new BufferGeometry().setAttribute("position", points), lined(ink, { depthTest: false }));
}

/** Words beside a point of the scene. */
function tag(name, textContent = "") {
  const element = Object.assign(document.createElement("p"), { id: `tag-${name}`, className: "tag", textContent });
  const made = new CSS2DObject(element);
  made.center.set(0, 0.5);
  return made;
}

/** A tip that ends a drawn radius below the origin. */
function tipGeometry(shape, radius, slope) {
  if (shape === "flat") return new CylinderGeometry(radius, radius, 2 * radius, 40);
  if (shape !== "cone") return new SphereGeometry(radius, 32, 20);
  const height = Math.min(CONE_HEIGHT * radius, (2 * radius) / slope);
  return new ConeGeometry(height * slope, height, 40).rotateX(Math.PI).translate(0, height / 2 - radius, 0);
}

/**
 * Function of the distance from a tip's axis: how far a half space is pressed in.  Sphere: Hertz, as Johnson 1985,
 * 3.42; flat and cone: Sneddon 1965, doi 10.1016/0020-7225(65)90019-4.
 */
function dentUnder({ shape, slope }, radius, depth) {
  if (shape === "flat") return (r) => (r <= radius ? depth : (2 / Math.PI) * depth * Math.asin(radius / r));
  if (shape === "cone") {
    const edge = (2 / Math.PI) * depth * slope;
    return (r) => (r <= edge ? depth - r / slope : (edge / slope) * (Math.asin(edge / r) + Math.sqrt((r / edge) ** 2 - 1) - r / edge));
  }
  const edge = Math.sqrt(radius * depth);
  return (r) => {
    if (r <= edge) return depth - (r * r) / (2 * radius);
    const ratio = edge / r;
    return (depth / Math.PI) * ((2 - 1 / (ratio * ratio)) * Math.asin(ratio) + Math.sqrt(1 - ratio * ratio) / ratio);
  };
}

/** Brightness of each vertex: smooth noise of two lengths, the same each time. */
function mottle(positions) {
  const noise = new ImprovedNoise();
  return Float32Array.from({ length: positions.length / 3 }, (_, n) => {
    const [x, y, z] = positions.subarray(3 * n, 3 * n + 3);
    return 1 + MOTTLE * (1.4 * noise.noise(x / 17, y / 17, z / 17) + noise.noise(x / 5, y / 5, z / 5));
  });
}
