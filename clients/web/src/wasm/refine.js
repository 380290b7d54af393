/**
 * refine.wasm for JavaScript: a mesh subdivided where something is of interest, a few splits and merges a frame. Works in node and in a page;
 * touches neither DOM nor three. refine.c beside this file is the other half.
 */

/** As in core/refine/doi.h. */
export const INTERESTS = { uniform: 0, face: 1, silhouette: 3, cone: 4, static: 5, curvature: 6, screen: 7, focus: 8, gaze: 9, contact: 10, attribute: 11, patches: 12 };

/** The module has no files: what libc would print goes nowhere. */
const NO_FILES = { fd_close: () => 8, fd_seek: () => 8, fd_write: () => 8 };
const NO_PART = 0xffffffff;

export class Refinement {
  /**
   * @param {BufferSource|Response|Promise<Response>} source the module's bytes
   * @param {{positions: Float32Array, index: Uint32Array, parts?: Uint32Array}} mesh
   * @param {{crease?: number, megabytes?: number}} options crease: degrees; edges that bend more stay sharp
   */
  static async create(source, mesh, options = {}) {
    const awaited = await source;
    const bytes = typeof Response !== 'undefined' && awaited instanceof Response ? await awaited.arrayBuffer() : awaited;
    const { instance } = await WebAssembly.instantiate(bytes, { wasi_snapshot_preview1: NO_FILES });
    return new Refinement(instance, mesh, options);
  }

  constructor(instance, { positions, index, parts = null }, { crease = 180, megabytes = 512 } = {}) {
    this.c = instance.exports;
    const blocks = [this.put(Float32Array, positions), this.put(Uint32Array, index), parts ? this.put(Uint32Array, parts) : 0];
    this.handle = this.c.lodr_create(blocks[0], positions.length / 3, blocks[1], index.length / 3, blocks[2], crease, megabytes);
    for (const block of blocks) if (block) this.c.lodr_free(block);
    if (!this.handle) throw new Error('The mesh cannot be refined: it is malformed or too large for this page.');
    this.numbers = this.c.lodr_alloc(17 * 8);
  }

  put(Type, values) {
    const block = this.c.lodr_alloc(values.length * Type.BYTES_PER_ELEMENT);
    if (block === 0) throw new Error('The mesh needs more memory than this page may use.');
    new Type(this.c.memory.buffer, block, values.length).set(values);
    return block;
  }

  /**
   * What is of interest from now on. @param {{kind: keyof INTERESTS, eye?: number[], direction?: number[], look?: number[], point?: number[],
   * degrees?: number, pixels?: number, fov?: number, height?: number, falloff?: number, part?: number}} interest look: the direction of gaze
   */
  interest({ kind, eye, direction, look = [0, 0, -1], point = [0, 0, 0], degrees = 0, pixels = 1, fov = 45, height = 600, falloff = 0, part = NO_PART }) {
    const v = [...(eye ?? [0, 0, 0]), ...(direction ?? [0, 0, 1]), ...look, ...point, degrees, pixels, fov, height, falloff];
    new Float64Array(this.c.memory.buffer, this.numbers, 17).set(v);
    if (!this.c.lodr_interest(this.handle, INTERESTS[kind], !eye, part, this.numbers)) throw new Error(kind === 'attribute' ? 'There are no values yet.' : `There is no part ${part}.`);
    this.kind = kind;
  }

  /** What `attribute` goes by: a number in [0, 1] for each vertex as it was given. */
  values(values) {
    const block = this.put(Float32Array, values);
    const kept = this.c.lodr_values(this.handle, block);
    this.c.lodr_free(block);
    if (!kept) throw new Error('The mesh needs more memory than this page may use.');
  }

  /** One frame: at most maxOperations splits and merges. @returns {number} how many; 0: settled */
  update({ steps = 4, maxTriangles = 0, maxOperations = 2000 } = {}) {
    const count = this.c.lodr_update(this.handle, steps, maxTriangles, maxOperations);
    if (count < 0) throw new Error('Refining needs more memory than this page may use.');
    return count;
  }

  /** All at once, as the server does it. */
  run({ steps = 3, maxTriangles = 0 } = {}) {
    if (!this.c.lodr_run(this.handle, steps, maxTriangles)) throw new Error('Refining needs more memory than this page may use.');
  }

  /** The point of the interest on the surface, which is refined around it. */
  contact(steps = 5) {
    if (!this.c.lodr_contact(this.handle, steps, this.numbers)) return null;
    const out = [...new Float64Array(this.c.memory.buffer, this.numbers, 7)];
    return { point: out.slice(0, 3), normal: out.slice(3, 6), distance: out[6] };
  }

  /** Copies of the drawn mesh: a vertex for each side of a sharp edge; `from`: where a new one comes from; `ids`: the same from frame to frame. */
  mesh() {
    const address = this.c.lodr_mesh(this.handle);
    if (!address) throw new Error('Refining needs more memory than this page may use.');
    const [vertices, triangles, positions, normals, from, ids, index, levels] = new Uint32Array(this.c.memory.buffer, address, 8);
    const take = (Type, at, length) => new Type(this.c.memory.buffer, at, length).slice();
    return {
      vertices, triangles,
      positions: take(Float32Array, positions, 3 * vertices),
      normals: take(Float32Array, normals, 3 * vertices),
      from: take(Float32Array, from, 3 * vertices),
      ids: take(Uint32Array, ids, vertices),
      index: take(Uint32Array, index, 3 * triangles),
      levels: take(Uint8Array, levels, triangles),
    };
  }

  close() {
    this.c.lodr_free(this.numbers);
    this.c.lodr_destroy(this.handle);
    this.handle = 0;
  }
}

/** When each vertex of a refinement was first drawn, so that it can grow out of its edge. Pure: the clock is a parameter. */
export class Births {
  constructor(seconds = 0.3) {
    this.seconds = seconds;
    this.born = new Map();
  }

  /** Seconds at which each vertex was born; what is drawn no more is forgotten. */
  times(ids, now) {
    const next = new Map();
    const times = new Float32Array(ids.length);
    const first = this.born.size === 0;
    for (let i = 0; i < ids.length; i++) {
      const time = this.born.get(ids[i]) ?? (first ? now - 2 * this.seconds : now);
      next.set(ids[i], time);
      times[i] = time;
    }
    this.born = next;
    return times;
  }

  /** Whether something still grows. */
  growing(times, now) {
    for (const time of times) if (now - time < this.seconds) return true;
    return false;
  }
}
