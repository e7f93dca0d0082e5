// The hand of a simulated device, led by a pointer or by keys.

import { Vector3 } from "three";
import { toDevice, toWorld } from "./scene.js";

const SEND_MS = 16;
// keys move the hand at this speed [mm/s of the device]
const KEY_SPEED = 30;
const KEYS = { ArrowDown: [0, -1, 0], ArrowUp: [0, 1, 0], ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], PageUp: [0, 0, -1], PageDown: [0, 0, 1] };

export class Hand {
  /** grip(): where the device is now [m], or null; say(words): to the server. */
  constructor(scene, grip, say) {
    this.scene = scene;
    this.grip = grip;
    this.say = say;
    this.target = null;
    this.sentMs = 0;
    this.held = new Set();
    const { canvas } = scene;
    canvas.addEventListener("pointerdown", (event) => this.take(event));
    canvas.addEventListener("pointermove", (event) => this.lead(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, () => this.drag && this.letGo());
    canvas.addEventListener("keydown", (event) => this.press(event));
    canvas.addEventListener("keyup", (event) => this.held.delete(event.key));
    window.addEventListener("blur", () => this.letGo());
  }

  /** Whether a page may lead the hand; else the left button turns the scene. */
  allow(allowed) {
    this.allowed = allowed;
    this.scene.controls.mouseButtons = { LEFT: allowed ? null : 0, MIDDLE: 1, RIGHT: 0 };
    this.scene.controls.touches = { ONE: allowed ? null : 0, TWO: 3 };
    this.scene.canvas.classList.toggle("led", allowed);
    this.target = null;
  }

  take(event) {
    const grip = this.grip();
    if (!this.allowed || event.button !== 0 || grip === null) return;
    this.scene.canvas.setPointerCapture(event.pointerId);
    this.drag = { x: event.clientX, y: event.clientY, from: this.target === null ? toWorld(grip) : toWorld(this.target) };
    this.moveTo(this.drag.from);
  }

  lead(event) {
    if (!this.drag) return;
    const mm = this.scene.mmPerPixel();
    const { up, camera } = this.scene;
    const right = new Vector3().setFromMatrixColumn(camera.matrixWorld, 0);
    right.addScaledVector(up, -right.dot(up)).normalize();
    this.moveTo(this.drag.from.clone().addScaledVector(right, (event.clientX - this.drag.x) * mm).addScaledVector(up, -(event.clientY - this.drag.y) * mm));
  }

  letGo() {
    this.held.clear();
    this.drag = null;
    if (this.target === null) return;
    this.target = null;
    this.say({ pointer: null });
  }

  press(event) {
    if (event.key === "Escape") this.letGo();
    if (!this.allowed || !(event.key in KEYS)) return;
    event.preventDefault();
    this.held.add(event.key);
  }

  /** Called with every picture: keys that are held go on. */
  step(seconds) {
    const grip = this.grip();
    if (!this.held.size || grip === null) return;
    const move = [...this.held].map((key) => KEYS[key]).reduce((sum, one) => sum.map((value, i) => value + one[i]), [0, 0, 0]);
    const from = toWorld(this.target ?? grip);
    this.moveTo(from.add(new Vector3(...move).multiplyScalar(KEY_SPEED * Math.min(seconds, 0.1))));
  }

  moveTo(point) {
    this.target = toDevice(point).map((value) => Math.min(0.29, Math.max(-0.29, value)));
    if (performance.now() - this.sentMs >= SEND_MS) this.send();
    else this.late ??= setTimeout(() => this.send(), SEND_MS);
  }

  send() {
    this.late = null;
    if (this.target === null) return;
    this.sentMs = performance.now();
    this.say({ pointer: this.target.map((value) => Number(value.toFixed(6))) });
  }
}
