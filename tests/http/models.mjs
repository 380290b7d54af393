// Models that tests make from formulas, as the files that a person would bake.
import zlib from 'node:zlib';

// A sphere of radius 1 with waves, {points, faces}: about 4 n^2 triangles.
export function wavySphere(n) {
  const columns = 2 * n;
  const points = [[0, 0, 1]];
  for (let i = 1; i < n; i++) {
    for (let j = 0; j < columns; j++) {
      const theta = (Math.PI * i) / n;
      const phi = (2 * Math.PI * j) / columns;
      const r = 1 + 0.1 * Math.sin(4 * phi) * Math.sin(theta) ** 4;
      points.push([r * Math.sin(theta) * Math.cos(phi), r * Math.sin(theta) * Math.sin(phi), r * Math.cos(theta)]);
    }
  }
  points.push([0, 0, -1]);
  const at = (i, j) => 1 + (i - 1) * columns + (j % columns);
  const faces = [];
  for (let j = 0; j < columns; j++) {
    faces.push([0, at(1, j), at(1, j + 1)], [points.length - 1, at(n - 1, j + 1), at(n - 1, j)]);
    for (let i = 1; i < n - 1; i++) faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
  }
  return { points, faces };
}

// A wavy square sheet from -1 to 1 with n * n * 2 triangles and a texture coordinate a point.
export function sheet(n) {
  const points = [];
  const uvs = [];
  const faces = [];
  for (let i = 0; i <= n; i++) {
    for (let j = 0; j <= n; j++) {
      const [x, y] = [(2 * i) / n - 1, (2 * j) / n - 1];
      points.push([x, y, 0.25 * Math.sin(3 * x) * Math.cos(3 * y)]);
      uvs.push([i / n, j / n]);
    }
  }
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      const a = i * (n + 1) + j;
      faces.push([a, a + n + 1, a + n + 2], [a, a + n + 2, a + 1]);
    }
  }
  return { points, uvs, faces };
}

export function asPly({ points, faces }) {
  const lines = ['ply', 'format ascii 1.0', `element vertex ${points.length}`, 'property float x', 'property float y', 'property float z',
    `element face ${faces.length}`, 'property list uchar int vertex_indices', 'end_header', ...points.map((p) => p.join(' ')),
    ...faces.map((f) => `${f.length} ${f.join(' ')}`)];
  return Buffer.from(`${lines.join('\n')}\n`);
}

function crc32(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; k++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return (crc ^ 0xffffffff) >>> 0;
}

// A PNG of squares, size * size, 8-bit RGB.
export function checkerPng(size) {
  const chunk = (type, data) => {
    const body = Buffer.concat([Buffer.from(type), data]);
    const bytes = Buffer.alloc(body.length + 8);
    bytes.writeUInt32BE(data.length, 0);
    body.copy(bytes, 4);
    bytes.writeUInt32BE(crc32(body), body.length + 4);
    return bytes;
  };
  const header = Buffer.alloc(13);
  header.writeUInt32BE(size, 0);
  header.writeUInt32BE(size, 4);
  header.set([8, 2, 0, 0, 0], 8);
  const rows = Buffer.alloc(size * (1 + 3 * size));
  for (let y = 0; y < size; y++)
    for (let x = 0; x < size; x++) rows.set(((x >> 2) + (y >> 2)) & 1 ? [210, 70, 40] : [240, 230, 200], y * (1 + 3 * size) + 1 + 3 * x);
  return Buffer.concat([Buffer.from('\x89PNG\r\n\x1a\n', 'latin1'), chunk('IHDR', header), chunk('IDAT', zlib.deflateSync(rows)),
    chunk('IEND', Buffer.alloc(0))]);
}

// A textured GLB; the picture is a buffer view.
export function asGlb({ points, uvs, faces }, picture) {
  const positions = Buffer.from(Float32Array.from(points.flat()).buffer);
  const coordinates = Buffer.from(Float32Array.from(uvs.flat()).buffer);
  const indices = Buffer.from(Uint32Array.from(faces.flat()).buffer);
  const parts = [positions, coordinates, indices, Buffer.concat([picture, Buffer.alloc(-picture.length & 3)])];
  const lengths = [positions.length, coordinates.length, indices.length, picture.length];
  let offset = 0;
  const bufferViews = parts.map((part, i) => {
    const view = { buffer: 0, byteOffset: offset, byteLength: lengths[i] };
    offset += part.length;
    return view;
  });
  const axis = (pick) => [0, 1, 2].map((k) => points.reduce((best, p) => pick(best, Math.fround(p[k])), Math.fround(points[0][k])));
  const json = {
    asset: { version: '2.0' },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, TEXCOORD_0: 1 }, indices: 2, material: 0 }] }],
    materials: [{ pbrMetallicRoughness: { baseColorTexture: { index: 0 } } }],
    textures: [{ source: 0 }],
    images: [{ bufferView: 3, mimeType: 'image/png' }],
    accessors: [
      { bufferView: 0, componentType: 5126, count: points.length, type: 'VEC3', min: axis(Math.min), max: axis(Math.max) },
      { bufferView: 1, componentType: 5126, count: uvs.length, type: 'VEC2' },
      { bufferView: 2, componentType: 5125, count: faces.length * 3, type: 'SCALAR' },
    ],
    bufferViews,
    buffers: [{ byteLength: offset }],
  };
  const text = Buffer.from(JSON.stringify(json));
  const padded = Buffer.concat([text, Buffer.alloc(-text.length & 3, 0x20)]);
  const chunk = (type, data) => {
    const head = Buffer.alloc(8);
    head.writeUInt32LE(data.length, 0);
    head.write(type, 4, 'latin1');
    return Buffer.concat([head, data]);
  };
  const chunks = Buffer.concat([chunk('JSON', padded), chunk('BIN\0', Buffer.concat(parts))]);
  const head = Buffer.alloc(12);
  head.write('glTF', 0);
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + chunks.length, 8);
  return Buffer.concat([head, chunks]);
}

// The JSON of a GLB.
export function glbJson(bytes) {
  return JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12)));
}
