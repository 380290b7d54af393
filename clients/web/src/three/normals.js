/**
 * Vertex normals for triangles that came without: smooth where the surface is smooth, split where it has a crease.
 *
 * One fixed crease angle cannot serve every level: a scan of 200 triangles bends by 40 degrees at every edge and still stands for a smooth
 * surface, a machined part has edges of 40 degrees that must stay sharp. The distribution of bends tells them apart. Where faces were meant to be
 * flat, many edges bend far less than the others and the crease angle is small; where all edges bend alike, the surface is curved and the
 * crease angle follows the median, which grows with coarseness. Corners of one vertex share a normal when they can be reached over edges
 * bent less than the crease angle; each is weighted by its angle (Thuermer, Wuethrich. Computing Vertex Normals from Polygonal
 * Facets. 1998).
 */

const CREASE_FLAT = 38; /* where faces were meant to be flat */
const CREASE_CURVED = 75; /* at least, on curved surfaces */
const CREASE_MAX = 100;
const CREASE_PER_MEDIAN = 4;
/* Flat is what bends less than this part of the edges that bend most; decoded positions lie on a grid, so flat faces are not quite flat. */
const FLAT_PART = 0.2;
const FLAT_SHARE = 0.25;
const MUCH_MAX = 60;

/**
 * @param {ArrayLike<number>} positions 3 a vertex
 * @param {ArrayLike<number>|null} index 3 a triangle; null: vertices in order
 * @param {{crease?: number}} options crease: degrees, instead of the adaptive one
 * @returns {{normals: Float32Array, corners: Uint32Array, sources: Uint32Array, crease: number}}
 *   corners: 3 a triangle, indices of output vertices; sources: input vertex of each output vertex; normals: 3 an output vertex
 */
export function computeCreasedNormals(positions, index, options = {}) {
  const triangles = index ? Uint32Array.from(index) : Uint32Array.from({ length: positions.length / 3 }, (_, i) => i);
  const welded = weld(positions, triangles);
  const { faces, angles } = faceNormals(positions, triangles);
  const { twin: edges, plain } = pairEdges(welded, faces);
  const crease = options.crease ?? creaseAngle(edgeBends(positions, triangles, faces, edges, plain));
  const groups = smoothingGroups(welded, faces, edges, Math.cos((crease * Math.PI) / 180), triangles.length);
  return { ...gather(triangles, faces, angles, groups), crease };
}

/** @param {{bend: number, length: number}[]} bends degrees and lengths of the edges with two faces */
export function creaseAngle(bends) {
  const sorted = [...bends].sort((a, b) => a.bend - b.bend);
  const total = sorted.reduce((sum, b) => sum + b.length, 0);
  if (!(total > 0)) return CREASE_FLAT;
  const quantile = (part) => {
    let sum = 0;
    return sorted.find((b) => (sum += b.length) >= part * total).bend;
  };
  const much = Math.min(MUCH_MAX, quantile(0.8));
  const flat = sorted.reduce((sum, b) => sum + (b.bend < FLAT_PART * much ? b.length : 0), 0);
  if (flat > FLAT_SHARE * total) return CREASE_FLAT;
  return Math.min(CREASE_MAX, Math.max(CREASE_CURVED, CREASE_PER_MEDIAN * quantile(0.5)));
}

/** Per corner the first vertex with the same position: attributes split vertices that the surface does not. */
function weld(positions, triangles) {
  const count = positions.length / 3;
  let capacity = 1;
  while (capacity < count * 2) capacity *= 2;
  const table = new Int32Array(capacity).fill(-1);
  const first = new Uint32Array(count);
  const bits = new Uint32Array(3);
  const floats = new Float32Array(bits.buffer);
  for (let v = 0; v < count; v++) {
    for (let a = 0; a < 3; a++) floats[a] = positions[3 * v + a] + 0; // + 0: -0 and 0 are one place
    let slot = hash(bits) & (capacity - 1);
    for (;;) {
      const w = table[slot];
      if (w < 0) {
        table[slot] = v;
        first[v] = v;
        break;
      }
      if (positions[3 * w] === positions[3 * v] && positions[3 * w + 1] === positions[3 * v + 1] && positions[3 * w + 2] === positions[3 * v + 2]) {
        first[v] = w;
        break;
      }
      slot = (slot + 1) & (capacity - 1);
    }
  }
  return triangles.map((v) => first[v]);
}

function hash(bits) {
  let h = Math.imul(bits[0], 0x85ebca6b) ^ Math.imul(bits[1], 0xc2b2ae35) ^ Math.imul(bits[2], 0x27d4eb2f);
  h ^= h >>> 15;
  h = Math.imul(h, 0x2c1b3c6d);
  return (h ^ (h >>> 13)) >>> 0;
}

/** Unit normal per triangle (0 for one without area) and the angle at each corner. */
function faceNormals(positions, triangles) {
  const count = triangles.length / 3;
  const faces = new Float32Array(count * 3);
  const angles = new Float32Array(count * 3);
  const e = [new Float64Array(3), new Float64Array(3), new Float64Array(3)];
  for (let t = 0; t < count; t++) {
    for (let k = 0; k < 3; k++) {
      const a = triangles[3 * t + k] * 3;
      const b = triangles[3 * t + ((k + 1) % 3)] * 3;
      for (let axis = 0; axis < 3; axis++) e[k][axis] = positions[b + axis] - positions[a + axis];
    }
    const n = cross(e[0], e[1]);
    const length = Math.hypot(n[0], n[1], n[2]);
    if (!(length > 0)) continue;
    for (let axis = 0; axis < 3; axis++) faces[3 * t + axis] = n[axis] / length;
    for (let k = 0; k < 3; k++) {
      // Between edge k and the reverse of edge k + 2; |cross| is twice the area at every corner.
      const u = e[k];
      const w = e[(k + 2) % 3];
      angles[3 * t + k] = Math.atan2(length, -(u[0] * w[0] + u[1] * w[1] + u[2] * w[2]));
    }
  }
  return { faces, angles };
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/**
 * Half-edge k of triangle t (from corner k to k + 1) -> the half-edge it runs against, or -1 at borders and where neighbours disagree about
 * which side is outside. Where more than two triangles meet, as where clustering has folded a thin part together, those that bend least belong
 * together.
 */
function pairEdges(welded, faces) {
  const corners = welded.length;
  const table = new PairTable(corners);
  const last = new Int32Array(corners).fill(-1); // at the first half-edge of an edge: the newest of its others
  const before = new Int32Array(corners).fill(-1); // the one that came before
  const uses = new Uint32Array(corners);
  for (let h = 0; h < corners; h++) {
    const a = welded[h];
    const b = welded[next(h)];
    const first = table.find(Math.min(a, b), Math.max(a, b), h);
    uses[first]++;
    if (first === h || a === b) continue;
    before[h] = last[first];
    last[first] = h;
  }
  const twin = new Int32Array(corners).fill(-1);
  for (let h = 0; h < corners; h++) {
    if (uses[h] === 2 && last[h] >= 0) {
      if (welded[h] === welded[next(last[h])]) {
        twin[h] = last[h];
        twin[last[h]] = h;
      }
    } else if (uses[h] > 2) {
      pairCrowded(h, last, before, welded, faces, twin);
    }
  }
  // Folds say nothing about how the surface bends: only edges of two triangles do.
  return { twin, plain: (h) => uses[h] === 2 };
}

/* More triangles on one edge than this are no surface; each is left to itself. */
const CROWD_MAX = 16;

function pairCrowded(first, last, before, welded, faces, twin) {
  const crowd = [first];
  for (let h = last[first]; h >= 0; h = before[h]) crowd.push(h);
  if (crowd.length > CROWD_MAX) return;
  const pairs = [];
  for (const h of crowd) {
    for (const g of crowd) if (h < g && welded[h] === welded[next(g)]) pairs.push([h, g, bendCosine(faces, h, g)]);
  }
  pairs.sort((x, y) => y[2] - x[2] || x[0] - y[0] || x[1] - y[1]);
  for (const [h, g] of pairs) {
    if (twin[h] >= 0 || twin[g] >= 0) continue;
    twin[h] = g;
    twin[g] = h;
  }
}

/** Pairs of numbers -> the value that was first given for the pair; open addressing, for at most `count` pairs. */
class PairTable {
  constructor(count) {
    let capacity = 16;
    while (capacity < count * 1.5) capacity *= 2;
    this.mask = capacity - 1;
    this.slots = new Int32Array(capacity).fill(-1);
    this.first = new Uint32Array(count);
    this.second = new Uint32Array(count);
    this.size = 0;
    this.values = new Uint32Array(count);
  }

  find(a, b, value) {
    let slot = hash2(a, b) & this.mask;
    for (;;) {
      const entry = this.slots[slot];
      if (entry < 0) break;
      if (this.first[entry] === a && this.second[entry] === b) return this.values[entry];
      slot = (slot + 1) & this.mask;
    }
    this.slots[slot] = this.size;
    this.first[this.size] = a;
    this.second[this.size] = b;
    this.values[this.size++] = value;
    return value;
  }
}

function hash2(a, b) {
  let h = Math.imul(a, 0x85ebca6b) ^ Math.imul(b, 0xc2b2ae35);
  h ^= h >>> 15;
  h = Math.imul(h, 0x2c1b3c6d);
  return (h ^ (h >>> 13)) >>> 0;
}

function next(h) {
  return h % 3 === 2 ? h - 2 : h + 1;
}

function bendCosine(faces, h, g) {
  const a = 3 * Math.floor(h / 3);
  const b = 3 * Math.floor(g / 3);
  return faces[a] * faces[b] + faces[a + 1] * faces[b + 1] + faces[a + 2] * faces[b + 2];
}

function edgeBends(positions, triangles, faces, twin, plain) {
  const bends = [];
  const step = Math.max(1, Math.floor(twin.length / 30000)); // a median needs no more
  for (let h = 0; h < twin.length; h += step) {
    if (twin[h] < 0 || !plain(h)) continue;
    const a = triangles[h] * 3;
    const b = triangles[next(h)] * 3;
    const length = Math.hypot(positions[b] - positions[a], positions[b + 1] - positions[a + 1], positions[b + 2] - positions[a + 2]);
    const bend = (Math.acos(Math.min(1, Math.max(-1, bendCosine(faces, h, twin[h])))) * 180) / Math.PI;
    bends.push({ bend, length });
  }
  return bends;
}

/** Union of the corners around each vertex across edges that are no crease: per corner the root of its group. */
function smoothingGroups(welded, faces, twin, cosine, corners) {
  const parent = Uint32Array.from({ length: corners }, (_, i) => i);
  const root = (c) => {
    while (parent[c] !== c) {
      parent[c] = parent[parent[c]];
      c = parent[c];
    }
    return c;
  };
  const join = (a, b) => {
    const x = root(a);
    const y = root(b);
    if (x !== y) parent[Math.max(x, y)] = Math.min(x, y);
  };
  for (let h = 0; h < corners; h++) {
    const g = twin[h];
    if (g < h || bendCosine(faces, h, g) < cosine) continue;
    join(h, next(g)); // both stand at the start of h
    join(next(h), g);
  }
  return Uint32Array.from({ length: corners }, (_, c) => root(c));
}

/** One output vertex per input vertex and group. */
function gather(triangles, faces, angles, groups) {
  const corners = triangles.length;
  const sums = new Float64Array(corners * 3);
  for (let c = 0; c < corners; c++) {
    const face = 3 * Math.floor(c / 3);
    for (let axis = 0; axis < 3; axis++) sums[3 * groups[c] + axis] += angles[c] * faces[face + axis];
  }
  const table = new PairTable(corners);
  const out = new Uint32Array(corners);
  const sources = new Uint32Array(corners);
  const normals = new Float32Array(corners * 3);
  let count = 0;
  for (let c = 0; c < corners; c++) {
    const v = table.find(triangles[c], groups[c], count);
    out[c] = v;
    if (v < count) continue;
    sources[v] = triangles[c];
    const g = 3 * groups[c];
    const length = Math.hypot(sums[g], sums[g + 1], sums[g + 2]);
    for (let axis = 0; axis < 3; axis++) normals[3 * v + axis] = length > 1e-12 ? sums[g + axis] / length : axis === 2 ? 1 : 0;
    count++;
  }
  return { normals: normals.slice(0, 3 * count), corners: out, sources: sources.slice(0, count) };
}
