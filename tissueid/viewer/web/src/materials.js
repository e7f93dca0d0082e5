// Materials of the scene.  A shader is compiled for every set of features that materials differ in, which takes
// a tenth of a second without a graphics card: they differ in as few as can be, in four sets of all.

import { DoubleSide, GreaterDepth, LineBasicMaterial, MeshBasicMaterial, MeshLambertMaterial, MeshPhongMaterial } from "three";

const ALIKE = { side: DoubleSide, transparent: true, forceSinglePass: true };

/** One colour everywhere. */
export const flat = (more) => new MeshBasicMaterial({ ...ALIKE, ...more });
/** Lines; with the shader of what is flat. */
export const lined = (more) => new LineBasicMaterial({ ...ALIKE, ...more });
/** Lit. */
export const shaded = (more) => new MeshLambertMaterial({ ...ALIKE, ...more });
/** Lit, with the gloss of something wet: a shader of its own, so only with a graphics card. */
export const wet = (more) => new MeshPhongMaterial({ ...ALIKE, shininess: 26, specular: 0x3a3a3a, ...more });
/** What hides behind something, seen through it. */
export const behind = (more) => flat({ depthFunc: GreaterDepth, depthWrite: false, opacity: 0.34, ...more });
