/** Models that tests draw: made from formulas, written as the files that a person would upload. */

import { PNG } from 'pngjs';

/** A sphere with bumps, as a scan is: {positions, triangles}. n: rings; about 4 n^2 triangles. */
export function bumpySphere(n) {
  const positions = [];
  const triangles = [];
  const columns = 2 * n;
  positions.push([0, 0, 1.12]);
  for (let i = 1; i < n; i++) {
    const theta = (i / n) * Math.PI;
    for (let j = 0; j < columns; j++) {
      const phi = (j / columns) * 2 * Math.PI;
      const r = 1 + 0.12 * Math.cos(5 * theta) * (1 - Math.pow(Math.cos(theta), 8)) + 0.08 * Math.sin(4 * phi) * Math.pow(Math.sin(theta), 3);
      positions.push([r * Math.sin(theta) * Math.cos(phi), r * Math.sin(theta) * Math.sin(phi), r * Math.cos(theta)]);
    }
  }
  positions.push([0, 0, -1.12]);
  const at = (i, j) => 1 + (i - 1) * columns + (j % columns);
  const last = positions.length - 1;
  for (let j = 0; j < columns; j++) {
    triangles.push([0, at(1, j), at(1, j + 1)]);
    for (let i = 1; i < n - 1; i++) triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    triangles.push([at(n - 1, j), last, at(n - 1, j + 1)]);
  }
  return { positions, triangles };
}

/** Binary little-endian PLY. */
export function writePly({ positions, triangles }) {
  const header = Buffer.from(
    `ply\nformat binary_little_endian 1.0\nelement vertex ${positions.length}\nproperty float x\nproperty float y\nproperty float z\n` +
      `element face ${triangles.length}\nproperty list uchar int vertex_indices\nend_header\n`,
  );
  const body = Buffer.alloc(positions.length * 12 + triangles.length * 13);
  let at = 0;
  for (const p of positions) for (const x of p) at = body.writeFloatLE(x, at);
  for (const t of triangles) {
    at = body.writeUInt8(3, at);
    for (const v of t) at = body.writeInt32LE(v, at);
  }
  return Buffer.concat([header, body]);
}

/**
 * GLB without compression. primitives: {mode, positions, indices?, thickness?, uvs?, material?}; materials and images as glTF JSON. apart: each
 * primitive is a mesh and a node of its own, so a part.
 */
export function writeGlb({ primitives, materials, textures, images, apart = false }) {
  const chunks = [];
  const bufferViews = [];
  const accessors = [];
  let length = 0;
  const accessor = (array, type, bounds) => {
    const bytes = Buffer.from(array.buffer, array.byteOffset, array.byteLength);
    const padded = Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4)]);
    bufferViews.push({ buffer: 0, byteOffset: length, byteLength: bytes.length });
    length += padded.length;
    chunks.push(padded);
    const size = { SCALAR: 1, VEC2: 2, VEC3: 3 }[type];
    const componentType = array instanceof Float32Array ? 5126 : 5125;
    const made = { bufferView: bufferViews.length - 1, componentType, count: array.length / size, type };
    if (bounds) {
      made.min = [0, 1, 2].map((a) => Math.min(...array.filter((_, i) => i % 3 === a)));
      made.max = [0, 1, 2].map((a) => Math.max(...array.filter((_, i) => i % 3 === a)));
    }
    accessors.push(made);
    return accessors.length - 1;
  };
  const out = primitives.map(({ mode = 4, positions, indices, thickness, uvs, material }) => {
    const attributes = { POSITION: accessor(Float32Array.from(positions.flat()), 'VEC3', true) };
    if (thickness) attributes._THICKNESS = accessor(Float32Array.from(thickness), 'SCALAR');
    if (uvs) attributes.TEXCOORD_0 = accessor(Float32Array.from(uvs.flat()), 'VEC2');
    const primitive = { attributes, mode };
    if (indices) primitive.indices = accessor(Uint32Array.from(indices.flat()), 'SCALAR');
    if (material !== undefined) primitive.material = material;
    return primitive;
  });
  const json = {
    asset: { version: '2.0', generator: 'tests/web' },
    scene: 0,
    scenes: [{ nodes: apart ? out.map((_, i) => i) : [0] }],
    nodes: apart ? out.map((_, i) => ({ mesh: i })) : [{ mesh: 0 }],
    meshes: apart ? out.map((primitive) => ({ primitives: [primitive] })) : [{ primitives: out }],
    materials,
    textures,
    images,
    accessors,
    bufferViews,
    buffers: [{ byteLength: length }],
  };
  const text = Buffer.from(JSON.stringify(json));
  const jsonChunk = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 0x20)]);
  const head = Buffer.alloc(20);
  head.write('glTF', 0);
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + 8 + jsonChunk.length + 8 + length, 8);
  head.writeUInt32LE(jsonChunk.length, 12);
  head.write('JSON', 16);
  const bin = Buffer.alloc(8);
  bin.writeUInt32LE(length, 0);
  bin.write('BIN\0', 4);
  return Buffer.concat([head, jsonChunk, bin, ...chunks]);
}

/** A little tree of thick edges: {positions, edges, thickness per vertex pair}. Every edge has its own two vertices. */
export function barTree(depth) {
  const positions = [];
  const thickness = [];
  const grow = (from, direction, length, width, left) => {
    const to = from.map((x, i) => x + direction[i] * length);
    positions.push(from, to);
    thickness.push(width, width);
    if (left === 0) return;
    for (let k = 0; k < 3; k++) {
      const turn = (k / 3) * 2 * Math.PI + left;
      const bent = normalize([direction[0] + 0.75 * Math.cos(turn), direction[1], direction[2] + 0.75 * Math.sin(turn)]);
      grow(to, bent, length * 0.7, width * 0.6, left - 1);
    }
  };
  grow([0, -1, 0], [0, 1, 0], 0.8, 0.14, depth);
  return { positions, thickness };
}

function normalize(v) {
  const length = Math.hypot(...v);
  return v.map((x) => x / length);
}

/** A ball with thin square bars in all directions, as a burr: clustering turns the bars into thick edges while the ball still has triangles. */
export function burr(count) {
  const ball = bumpySphere(24);
  const positions = ball.positions.map((p) => p.map((x) => 0.4 * x));
  const triangles = ball.triangles;
  for (let i = 0; i < count; i++) {
    const z = 1 - (2 * i + 1) / count;
    const phi = i * 2.399963; // golden angle
    const d = [Math.sqrt(1 - z * z) * Math.cos(phi), Math.sqrt(1 - z * z) * Math.sin(phi), z];
    const side = normalize(Math.abs(d[2]) < 0.9 ? [d[1], -d[0], 0] : [0, d[2], -d[1]]);
    const other = [d[1] * side[2] - d[2] * side[1], d[2] * side[0] - d[0] * side[2], d[0] * side[1] - d[1] * side[0]];
    const base = positions.length;
    const segments = 6;
    for (let s = 0; s <= segments; s++) {
      for (let k = 0; k < 4; k++) {
        const u = 0.015 * (k === 0 || k === 3 ? 1 : -1);
        const v = 0.015 * (k < 2 ? 1 : -1);
        positions.push([0, 1, 2].map((a) => d[a] * (0.3 + s / segments) + side[a] * u + other[a] * v));
      }
    }
    const quad = (a, b, c, e) => triangles.push([a, b, c], [a, c, e]);
    for (let s = 0; s < segments; s++) {
      for (let k = 0; k < 4; k++) quad(base + 4 * s + k, base + 4 * s + ((k + 1) % 4), base + 4 * s + 4 + ((k + 1) % 4), base + 4 * s + 4 + k);
    }
    quad(base + 3, base + 2, base + 1, base);
    const end = base + 4 * segments;
    quad(end, end + 1, end + 2, end + 3);
  }
  return { positions, triangles };
}

/** A wavy sheet with a picture of squares on it, as a GLB with the picture inside. */
export function checkerGlb(n) {
  const positions = [];
  const uvs = [];
  const indices = [];
  for (let i = 0; i <= n; i++) {
    for (let j = 0; j <= n; j++) {
      const x = (2 * i) / n - 1;
      const y = (2 * j) / n - 1;
      positions.push([x, y, 0.25 * Math.sin(3 * x) * Math.cos(3 * y)]);
      uvs.push([i / n, j / n]);
    }
  }
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      const a = i * (n + 1) + j;
      indices.push([a, a + n + 1, a + n + 2], [a, a + n + 2, a + 1]);
    }
  }
  const image = new PNG({ width: 64, height: 64 });
  for (let y = 0; y < 64; y++) {
    for (let x = 0; x < 64; x++) {
      const odd = ((x >> 3) + (y >> 3)) & 1;
      image.data.set(odd ? [210, 70, 40, 255] : [240, 230, 200, 255], (y * 64 + x) * 4);
    }
  }
  const uri = `data:image/png;base64,${PNG.sync.write(image).toString('base64')}`;
  return writeGlb({
    primitives: [{ positions, uvs, indices, material: 0 }],
    materials: [{ pbrMetallicRoughness: { baseColorTexture: { index: 0 }, metallicFactor: 0, roughnessFactor: 0.8 }, doubleSided: true }],
    textures: [{ source: 0 }],
    images: [{ uri }],
  });
}
