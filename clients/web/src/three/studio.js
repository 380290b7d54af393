/**
 * A photographer's studio as an environment map: a soft room with three lamps, filtered for every roughness by formula.
 *
 * PMREMGenerator would filter a rendered room on the GPU, with hundreds of samples a pixel: 20 s without a GPU, and different in the last bit on
 * every machine. Here the room is a sum of terms whose blur is known: bands of spherical harmonics in the height y, and spherical
 * Gaussians for the lamps (Wang et al. All-Frequency Rendering of Dynamic, Spatially-Varying Reflectance. SIGGRAPH Asia 2009,
 * section 4: the product of two Gaussians' widths). It takes some milliseconds and is the same everywhere.
 */

import { CubeTexture, DataTexture, DataUtils, HalfFloatType, LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, RGBAFormat } from 'three';

/* Level sizes. The one for roughness 1 is also what matt surfaces see: at 16 a side its texels do not show. */
const SIZES = [128, 64, 32, 16, 8];

/** Radiance of the room: band 0, 1, 2 in y. Light from above, a grey floor. */
const ROOM = { even: [0.46, 0.47, 0.49], up: [0.3, 0.31, 0.33], poles: [0.08, 0.08, 0.08] };

/** Lamps: where, how bright, how sharp (larger is smaller). */
const LAMPS = [
  { towards: [-0.55, 0.68, 0.5], colour: [7, 6.8, 6.5], sharpness: 38 },
  { towards: [0.92, 0.2, 0.34], colour: [2.6, 2.7, 2.9], sharpness: 16 },
  { towards: [0.15, 0.55, -0.82], colour: [4.2, 4.2, 4.3], sharpness: 26 },
].map((lamp) => ({ ...lamp, towards: normalize(lamp.towards) }));

/** Radiance from direction d as a surface of this roughness (0 mirror, 1 matt) gathers it. */
export function studioRadiance(d, roughness) {
  const blur = roughness * roughness;
  const first = 1 - blur / 3; // a cosine lobe keeps 2/3 of band 1 and 1/4 of band 2
  const second = 1 - 0.75 * blur;
  const y = d[1] * first;
  const poles = (d[1] * d[1] - 1 / 3) * second;
  const out = ROOM.even.map((e, c) => e + ROOM.up[c] * y + ROOM.poles[c] * poles);
  const lobe = 2 / Math.max(blur * blur, 1e-4); // GGX with alpha = roughness^2 as a Gaussian
  for (const { towards, colour, sharpness } of LAMPS) {
    const wide = (sharpness * lobe) / (sharpness + lobe);
    const cosine = d[0] * towards[0] + d[1] * towards[1] + d[2] * towards[2];
    const weight = (wide / sharpness) * Math.exp(wide * (cosine - 1));
    for (let c = 0; c < 3; c++) out[c] += colour[c] * weight;
  }
  return out;
}

/** For Scene.environment. Dispose as any texture. */
export function studioEnvironment() {
  // three counts a cube's mip levels without its base, so the last one but one is the one that it takes for roughness 1.
  const last = SIZES.length - 2;
  const faces = SIZES.map((size, lod) => cube(size, lod >= last ? 1 : 1 - Math.sqrt(1 - lod / last)));
  const texture = new CubeTexture(faces[0]);
  texture.mipmaps = faces.slice(1).map((image, i) => ({ image, width: SIZES[i + 1], height: SIZES[i + 1] }));
  texture.format = RGBAFormat;
  texture.type = HalfFloatType;
  texture.colorSpace = LinearSRGBColorSpace;
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.generateMipmaps = false;
  texture.isPMREMTexture = true;
  texture.needsUpdate = true;
  return texture;
}

/* Direction of texel (s, t) in [-1, 1] of each face, +x -x +y -y +z -z (OpenGL ES 3.0, section 3.8.10). */
const FACES = [
  (s, t) => [1, -t, -s],
  (s, t) => [-1, -t, s],
  (s, t) => [s, 1, t],
  (s, t) => [s, -1, -t],
  (s, t) => [s, -t, 1],
  (s, t) => [-s, -t, -1],
];

function cube(size, roughness) {
  return FACES.map((direction) => {
    const data = new Uint16Array(size * size * 4);
    for (let row = 0; row < size; row++) {
      for (let column = 0; column < size; column++) {
        const d = normalize(direction((2 * column + 1) / size - 1, (2 * row + 1) / size - 1));
        d[0] = -d[0]; // three mirrors cube textures in x
        const colour = studioRadiance(d, roughness);
        const at = (row * size + column) * 4;
        for (let c = 0; c < 3; c++) data[at + c] = DataUtils.toHalfFloat(Math.max(0, colour[c]));
        data[at + 3] = DataUtils.toHalfFloat(1);
      }
    }
    return new DataTexture(data, size, size, RGBAFormat, HalfFloatType);
  });
}

function normalize(v) {
  const length = Math.hypot(...v);
  return v.map((x) => x / length);
}
