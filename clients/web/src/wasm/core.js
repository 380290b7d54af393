/**
 * lodestream.wasm for JavaScript: levels from drawn arrays or from deltas, and the map between two of them as what a geomorph draws. Works in
 * node, in a page and in a worker; touches neither DOM nor three. module.c beside this file is the other half.
 */

/** A failure of the module's: `type` as in C ("truncated", "wrong-base", "out-of-memory"), a sentence as message. */
export class CoreError extends Error {
  constructor(type, message) {
    super(message || 'The WebAssembly module failed.');
    this.name = 'CoreError';
    this.type = type || 'unknown';
  }
}

/** The module has no files: what libc would print goes nowhere. */
const NO_FILES = { fd_close: () => 8, fd_seek: () => 8, fd_write: () => 8 };

export class Core {
  /**
   * @param {BufferSource|Response|Promise<Response>} source the module's bytes
   * @param {{megabytes?: number}} options megabytes: the most that one level or map may take
   */
  static async create(source, options = {}) {
    const awaited = await source;
    const bytes = typeof Response !== 'undefined' && awaited instanceof Response ? await awaited.arrayBuffer() : awaited;
    const { instance } = await WebAssembly.instantiate(bytes, { wasi_snapshot_preview1: NO_FILES });
    return new Core(instance, options);
  }

  constructor(instance, { megabytes = 512 } = {}) {
    this.c = instance.exports;
    this.c.lodw_limit(megabytes);
  }

  /** @returns {Level} positions: 3 a vertex; index: 3 a triangle; materials: a number a triangle, or null */
  level(positions, index, materials = null) {
    const blocks = [this.put(Float32Array, positions), this.put(Uint32Array, index), materials ? this.put(Uint32Array, materials) : 0];
    const handle = this.c.lodw_level_create(blocks[0], positions.length / 3, blocks[1], index.length / 3, blocks[2]);
    for (const block of blocks) this.c.lodw_free(block);
    return new Level(this, this.check(handle));
  }

  /** The level that the delta frame at the start of `bytes` makes of `base`; null: of a first picture. The base stays as it is. */
  decode(bytes, base = null) {
    const block = this.put(Uint8Array, bytes);
    const handle = this.c.lodw_level_decode(block, bytes.length, base ? base.handle : 0);
    this.c.lodw_free(block);
    return new Level(this, this.check(handle));
  }

  /** Bytes of the frame that begins at `bytes`; 0: its header is not whole yet. A wrong header throws. */
  frameSize(bytes) {
    const head = bytes.subarray(0, 160);
    const block = this.put(Uint8Array, head);
    const size = this.c.lodw_frame_size(block, head.length);
    this.c.lodw_free(block);
    if (size === 0 && this.text(this.c.lodw_problem_type()) !== 'truncated') this.check(0);
    return size;
  }

  /** reach: how far apart, in model units, the same vertex may lie in the two levels, where no delta said which it is. */
  map(coarse, fine, reach = 0) {
    return new LevelMap(this, this.check(this.c.lodw_map_create(coarse.handle, fine.handle, reach)), coarse, fine);
  }

  /** The step in units whose index begins at `bytes`, from level `base`, which must outlive it. */
  units(bytes, base) {
    const block = this.put(Uint8Array, bytes);
    const handle = this.c.lodw_units_open(block, bytes.length, base.handle);
    this.c.lodw_free(block);
    return new Units(this, this.check(handle), base);
  }

  get bytes() {
    return this.c.memory.buffer.byteLength;
  }

  put(Type, values) {
    const block = this.c.lodw_alloc(values.length * Type.BYTES_PER_ELEMENT);
    if (block === 0) throw new CoreError('out-of-memory', 'The level needs more memory than this page may use.');
    new Type(this.c.memory.buffer, block, values.length).set(values);
    return block;
  }

  /** A copy out of the module's memory, which may move with the next call. */
  take(Type, address, length) {
    return address === 0 ? null : new Type(this.c.memory.buffer, address, length).slice();
  }

  words(address, count) {
    return new Uint32Array(this.c.memory.buffer, address, count);
  }

  check(handle) {
    if (handle === 0) throw new CoreError(this.text(this.c.lodw_problem_type()), this.text(this.c.lodw_problem()));
    return handle;
  }

  text(address) {
    const bytes = new Uint8Array(this.c.memory.buffer, address);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }
}

class Level {
  constructor(core, handle) {
    this.core = core;
    this.handle = handle;
  }

  get hash() {
    return this.core.c.lodw_level_hash(this.handle) >>> 0;
  }

  /** Arrays of their own: positions and triangles; corners (wedges of triangles), wedgeVertex, normals, uvs, colors by wedge, materials; null: none. */
  arrays() {
    const [vertices, triangles, wedges, ...at] = this.core.words(this.core.c.lodw_level_words(this.handle), 11);
    const [positions, index, corners, normals, uvs, colors, wedgeVertex, materials] = at;
    return {
      positions: this.core.take(Float32Array, positions, 3 * vertices),
      triangles: this.core.take(Uint32Array, index, 3 * triangles),
      corners: this.core.take(Uint32Array, corners, 3 * triangles),
      wedgeVertex: this.core.take(Uint32Array, wedgeVertex, wedges),
      normals: this.core.take(Float32Array, normals, 3 * wedges),
      uvs: this.core.take(Float32Array, uvs, 2 * wedges),
      colors: this.core.take(Float32Array, colors, 4 * wedges),
      materials: this.core.take(Uint32Array, materials, triangles),
    };
  }

  free() {
    this.core.c.lodw_level_free(this.handle);
    this.handle = 0;
  }
}

/** Patches of a level on their way to a finer one. */
class Units {
  constructor(core, handle, base) {
    this.core = core;
    this.handle = handle;
    this.base = base;
  }

  /** {first: the patch to decode first, size, vertices, triangles, patches: {offset, bytes, center, radius, normal}[]}; offsets from the index's first byte. */
  facts() {
    const address = this.core.check(this.core.c.lodw_units_words(this.handle));
    const [count, first, size, vertices, triangles] = this.core.words(address, 5);
    const words = this.core.words(address + 20, 9 * count);
    const floats = new Float32Array(words.buffer, words.byteOffset, words.length);
    const patches = Array.from({ length: count }, (_, p) => ({
      offset: words[9 * p], bytes: words[9 * p + 1], center: [...floats.slice(9 * p + 2, 9 * p + 5)], radius: floats[9 * p + 5],
      normal: [...floats.slice(9 * p + 6, 9 * p + 9)],
    }));
    return { first, size, vertices, triangles, patches };
  }

  decode(patch, bytes) {
    const block = this.core.put(Uint8Array, bytes);
    const good = this.core.c.lodw_units_decode(this.handle, patch, block, bytes.length);
    this.core.c.lodw_free(block);
    this.core.check(good);
  }

  /** What has come so far as a level of its own. */
  join() {
    return new Level(this.core, this.core.check(this.core.c.lodw_units_join(this.handle)));
  }

  /**
   * What to draw: fragments where the patches around are there, the coarse level elsewhere; as LevelMap.draw, with `coarseFaces` (faces of the coarse
   * level; `faces` is 2^32 - 1 where a triangle is the coarse level's own) and `settled` (1 a vertex: at its end already, whatever t).
   * fine: what join() made last, as it is drawn.
   */
  draw(fine, { values = 0, coarse = null, fineValues = null } = {}) {
    const blocks = [values && coarse ? this.core.put(Float32Array, coarse) : 0, values && fineValues ? this.core.put(Float32Array, fineValues) : 0];
    const address = this.core.c.lodw_units_draw(this.handle, this.base.handle, fine.handle, values, blocks[0], blocks[1]);
    for (const block of blocks) this.core.c.lodw_free(block);
    const [vertices, triangles, start, end, index, faces, coarseFaces, startValues, endValues, settled, mapped, failed] = this.core.words(this.core.check(address), 12);
    return {
      start: this.core.take(Float32Array, start, 3 * vertices),
      end: this.core.take(Float32Array, end, 3 * vertices),
      triangles: this.core.take(Uint32Array, index, 3 * triangles),
      faces: this.core.take(Uint32Array, faces, triangles),
      coarseFaces: this.core.take(Uint32Array, coarseFaces, triangles),
      startValues: values ? this.core.take(Float32Array, startValues, values * vertices) : null,
      endValues: values ? this.core.take(Float32Array, endValues, values * vertices) : null,
      settled: this.core.take(Uint8Array, settled, vertices),
      mapped,
      failed,
    };
  }

  free() {
    this.core.c.lodw_units_free(this.handle);
    this.handle = 0;
  }
}

class LevelMap {
  constructor(core, handle) {
    this.core = core;
    this.handle = handle;
  }

  get hash() {
    return this.core.c.lodw_map_hash(this.handle) >>> 0;
  }

  /**
   * What a geomorph draws: positions and values at t = 0 (start) and t = 1 (end).
   * exact: fragments, which are the coarse level at t = 0; otherwise the finer level's triangles, fewer but only nearly so.
   * values: numbers a wedge (of decoded levels) or a vertex as given, in `coarse` and `fine`.
   */
  draw({ exact = true, values = 0, coarse = null, fine = null } = {}) {
    const blocks = [values && coarse ? this.core.put(Float32Array, coarse) : 0, values && fine ? this.core.put(Float32Array, fine) : 0];
    const address = this.core.c.lodw_map_draw(this.handle, exact ? 1 : 0, values, blocks[0], blocks[1]);
    for (const block of blocks) this.core.c.lodw_free(block);
    const [vertices, triangles, start, end, index, faces, startValues, endValues, mapped, failed] = this.core.words(this.core.check(address), 10);
    return {
      start: this.core.take(Float32Array, start, 3 * vertices),
      end: this.core.take(Float32Array, end, 3 * vertices),
      triangles: this.core.take(Uint32Array, index, 3 * triangles),
      faces: this.core.take(Uint32Array, faces, triangles),
      startValues: values ? this.core.take(Float32Array, startValues, values * vertices) : null,
      endValues: values ? this.core.take(Float32Array, endValues, values * vertices) : null,
      mapped,
      failed,
    };
  }

  free() {
    this.core.c.lodw_map_free(this.handle);
    this.handle = 0;
  }
}
