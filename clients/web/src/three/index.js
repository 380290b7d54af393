export { LevelLoader, makeDraco } from './loader.js';
export { DeltaLoader, levelFromArrays } from './deltas.js';
export { LevelObject } from './level.js';
export { SharedTextures } from './textures.js';
export { computeCreasedNormals, creaseAngle } from './normals.js';
export { thickLines, thickMaterial, thickPoints } from './thick.js';
export { MorphObject, Morpher, morphable } from './morph.js';
