/** Models that tests draw: made from formulas, written as the files that a person would upload. */

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
 * GLB without compression. primitives: {mode, positions, indices?, thickness?, uvs?, material?}; materials and images as glTF JSON.
 */
export function writeGlb({ primitives, materials, textures, images }) {
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
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    meshes: [{ primitives: out }],
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
