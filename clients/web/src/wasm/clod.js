/**
 * clod.wasm for JavaScript: curved patches from their stream, and each frame the triangles that a view asks for. Works in node and in a page;
 * touches neither DOM nor three. clod.c beside this file is the other half.
 */

/** The module has no files: what libc would print goes nowhere. */
const NO_FILES = { fd_close: () => 8, fd_seek: () => 8, fd_write: () => 8 };

const UV_SETS = 2;

function layoutOf(has) {
  let width = 0;
  const uv = Array.from({ length: UV_SETS }, (_, set) => (has & (1 << set) ? (width += 2) - 2 : -1));
  const color = has & (1 << UV_SETS) ? (width += 4) - 4 : -1;
  return { uv, color, width };
}

/** One unit of a model: a surface of curved patches that is tessellated as a view moves. */
export class Curves {
  constructor(c, handle) {
    this.c = c;
    this.handle = handle;
    this.view = c.lodc_alloc(13 * 8);
    const [unit, units, patches, edges, vertices, has] = this.words(c.lodc_words(handle), 6);
    /** @type {{uv: number[], color: number, width: number}} where the numbers of a vertex hold each UV set and the colour; -1: not there */
    this.layout = layoutOf(has);
    const numbers = new Float64Array(c.memory.buffer, c.lodc_numbers(handle), 1);
    /** error: certified bound to the source, model units, before quantisation; the manifest's is measured after it */
    Object.assign(this, { unit, units, patches, edges, vertices, error: numbers[0] });
  }

  words(address, count) {
    return new Uint32Array(this.c.memory.buffer, address, count);
  }

  /** @param {{pixels?: number, cullOutside?: boolean, cullBack?: boolean, strict?: boolean}} settings strict: one tangent plane along edges */
  set({ pixels = 0.5, cullOutside = true, cullBack = true, strict = false } = {}) {
    if (!this.c.lodc_settings(this.handle, pixels, cullOutside, cullBack, strict)) throw new Error('The patches need more memory than this page may use.');
  }

  /** How far the strict surface is from the cubics at most, model units; 0 before it was asked for. */
  get strictDeviation() {
    return new Float64Array(this.c.memory.buffer, this.c.lodc_numbers(this.handle), 2)[1];
  }

  /**
   * One frame. Arrays are views of the module's memory, valid until it is called again; `changed` are ranges [first, count] of vertices.
   * @param {{eye: number[], forward: number[], up: number[], fov: number, aspect: number, height: number, near: number}} view in the unit's
   * space; forward and up unit and perpendicular; fov: vertical, degrees; height: pixels
   */
  update({ eye, forward, up, fov, aspect, height, near }) {
    new Float64Array(this.c.memory.buffer, this.view, 13).set([...eye, ...forward, ...up, fov, aspect, height, near]);
    const address = this.c.lodc_update(this.handle, this.view);
    if (!address) throw new Error('The triangles need more memory than this page may use.');
    const [room, indexCount, positions, normals, roots, indices, ranges, rangeCount, patches, visible, outside, back, patchesMade, edgesMade,
      verticesMade, halved, numbers, width, groups, groupCount] = this.words(address, 20);
    const { buffer } = this.c.memory;
    const flat = new Uint32Array(buffer, ranges, 2 * rangeCount);
    const parts = new Uint32Array(buffer, groups, 3 * groupCount);
    return {
      positions: new Float32Array(buffer, positions, 3 * room),
      normals: new Float32Array(buffer, normals, 3 * room),
      roots: new Uint32Array(buffer, roots, room),
      indices: new Uint32Array(buffer, indices, indexCount),
      /** UVs and colours, as `layout` says; null: there are none */
      numbers: numbers ? new Float32Array(buffer, numbers, width * room) : null,
      /** of indices; material -1: none */
      groups: Array.from({ length: groupCount }, (_, i) => ({ material: parts[3 * i] | 0, first: parts[3 * i + 1], count: parts[3 * i + 2] })),
      changed: Array.from({ length: rangeCount }, (_, i) => [flat[2 * i], flat[2 * i + 1]]),
      patches, visible, outside, back, patchesMade, edgesMade, verticesMade, halved: halved !== 0, triangles: indexCount / 3,
      pixels: new Float64Array(buffer, this.c.lodc_numbers(this.handle), 3)[2],
    };
  }

  lines(kind, parts) {
    const count = this.c.lodc_lines(this.handle, kind, parts, 0);
    const block = this.c.lodc_alloc(4 * count);
    if (!block) throw new Error('The lines need more memory than this page may use.');
    this.c.lodc_lines(this.handle, kind, parts, block);
    const lines = new Float32Array(this.c.memory.buffer, block, count).slice();
    this.c.lodc_free(block);
    return lines;
  }

  /** Ends of line segments, 6 numbers each: the patches' edges, and their control nets. */
  edgeLines(parts = 12) {
    return this.lines(0, parts);
  }
  netLines() {
    return this.lines(1, 1);
  }

  /** Box of all control points. */
  bounds() {
    const block = this.c.lodc_alloc(48);
    this.c.lodc_bounds(this.handle, block);
    const box = [...new Float64Array(this.c.memory.buffer, block, 6)];
    this.c.lodc_free(block);
    return { min: box.slice(0, 3), max: box.slice(3) };
  }

  close() {
    this.c.lodc_free(this.view);
    this.c.lodc_destroy(this.handle);
    this.handle = 0;
  }
}

/**
 * All units of a stream of patches.
 * @param {BufferSource|Response|Promise<Response>} source the module's bytes
 * @param {Uint8Array} stream as `GET .../patches` answers
 * @param {{megabytes?: number, copies?: (unit: number) => number}} options copies: how many instances of a unit follow views of their own
 * @returns {Promise<Curves[]>} in the order of the stream, copies of a unit one after the other
 */
export async function decodeCurves(source, stream, { megabytes = 1024, copies = () => 1 } = {}) {
  const awaited = await source;
  const bytes = typeof Response !== 'undefined' && awaited instanceof Response ? await awaited.arrayBuffer() : awaited;
  const { instance } = await WebAssembly.instantiate(bytes, { wasi_snapshot_preview1: NO_FILES });
  const c = instance.exports;
  const curves = [];
  for (let at = 0; at < stream.length;) {
    const rest = stream.length - at;
    const block = c.lodc_alloc(rest);
    if (!block) throw new Error('The patches need more memory than this page may use.');
    new Uint8Array(c.memory.buffer, block, rest).set(stream.subarray(at));
    const size = c.lodc_frame_size(block, rest);
    let unit = 0;
    for (let copy = 0; copy === 0 || copy < copies(unit); copy++) {
      const handle = size > 0 ? c.lodc_create(block, size, megabytes) : 0;
      if (!handle) throw new Error('The stream of patches is damaged, or too large for this page.');
      curves.push(new Curves(c, handle));
      unit = curves.at(-1).unit;
    }
    c.lodc_free(block);
    at += size;
  }
  return curves;
}
