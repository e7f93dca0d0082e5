// Materials of the scene.  A shader is compiled for every set of features that materials differ in, which takes
// a tenth of a second without a graphics card: they differ in as few as can be, in four sets of all.

import { DoubleSide, GreaterDepth, LineBasicMaterial, MeshBasicMaterial, MeshLambertMaterial, MeshPhongMaterial } from "three";

const ALIKE = { side: DoubleSide, transparent: true, forceSinglePass: true };

/** A material whose colour has this name in the style sheet; the scene sets it. */
export const inked = (ink, material) => Object.assign(material, { userData: { ink } });
/** One colour everywhere. */
export const flat = (ink, more) => inked(ink, new MeshBasicMaterial({ ...ALIKE, ...more }));
/** Lines; with the shader of what is flat. */
export const lined = (ink, more) => inked(ink, new LineBasicMaterial({ ...ALIKE, ...more }));
/** Lit. */
export const shaded = (ink, more) => inked(ink, new MeshLambertMaterial({ ...ALIKE, ...more }));
/** Lit, with the gloss of something wet: a shader of its own, so only with a graphics card. */
export const wet = (ink, more) =>
  inked(ink, new MeshPhongMaterial({ ...ALIKE, shininess: 26, specular: 0x3a3a3a, ...more }));
/** What hides behind something, seen through it. */
export const behind = (ink) => flat(ink, { depthFunc: GreaterDepth, depthWrite: false, opacity: 0.34 });
