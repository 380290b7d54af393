/**
 * Levels from deltas: the frames of GET /v1/models/{id}/delta, each decoded in the worker as soon as it is whole, and drawn with the materials of the
 * level that they began from.
 */

import { BufferAttribute, BufferGeometry, Group, Matrix4, Mesh } from 'three';
import { ProtocolError } from '../protocol/problem.js';
import { chooseRoute } from '../stream/morph.js';
import { LevelObject } from './level.js';
import { UnitsLoad } from './units.js';

/** A level that is on its way is waited for when the steps from it save at least this part of the bytes. */
const WORTH_WAITING = 0.25;

export class DeltaLoader {
  /**
   * @param {{client, id: string, core: () => import('../wasm/pool.js').CorePool, normals, levels: (family: string) => object[], pieces?: object[],
   *          onBytes?: (n: number) => void, onStep?: (level, value: {object, facts}, bytes: number) => void, hold?: () => Promise<void>|null,
   *          units?: {wanted: () => boolean, look: () => object|null, onPart: (part) => Promise<boolean>}}} options
   *   levels: a family's, by which routes are chosen; pieces: the manifest's units; onStep: a level on the way has come whole and may be drawn; hold: see download; units: last
   *   steps that have units come by these while `wanted` (units.js)
   */
  constructor(options) {
    this.options = options;
    this.pieces = options.pieces ?? [{ parts: [0], instances: null }];
    /** Levels at hand, by object: {level, object: LevelObject, ids: Promise<number[]>|null, in the worker, one a unit} */
    this.bases = new Map();
    this.refused = new Set();
    /** Levels that came in units -> {after, shape}: what leads to them from the last part drawn. */
    this.finals = new WeakMap();
    /** Levels on their way, whole: level -> promise. */
    this.expected = new Map();
  }

  /** `loading` will offer `level`. */
  expect(level, loading) {
    this.expected.set(level, loading);
    const done = () => this.expected.delete(level);
    loading.then(done, done);
  }

  /**
   * Coarse levels are asked for first and come first: where the steps from one that is on its way are much less than `level`, a promise that it is
   * there (or is not coming); else null.
   */
  coming(level) {
    if (this.refused.has(level.family)) return null;
    const levels = this.options.levels(level.family);
    let best = null;
    for (const [base, loading] of this.expected) {
      if (base.family !== level.family) continue;
      const route = chooseRoute(levels, base, level);
      const worth = route.kind === 'deltas' && route.bytes <= (1 - WORTH_WAITING) * level.bytes;
      if (worth && (best === null || route.bytes < best.bytes)) best = { bytes: route.bytes, loading };
    }
    return best && best.loading.then(() => {}, () => {});
  }

  /** A level that was loaded whole may be the base of deltas. */
  offer(level, object) {
    if (object.bars === 0) this.bases.set(object, { level, object, ids: null });
  }

  /** The level is about to be freed. */
  forget(object) {
    const base = this.bases.get(object);
    this.bases.delete(object);
    this.finals.get(object)?.shape.dispose();
    base?.ids?.then((ids) => ids.forEach((id) => this.options.core().free(id))).catch(() => {});
  }

  /** The cheapest way to `level` by deltas; null: its own file is fewer bytes, or deltas do not lead there. */
  route(level) {
    if (this.refused.has(level.family)) return null;
    const levels = this.options.levels(level.family);
    let best = null;
    for (const base of this.bases.values()) {
      if (base.level.family !== level.family) continue;
      const route = chooseRoute(levels, base.level, level);
      if (route.kind === 'deltas' && (best === null || route.bytes < best.bytes)) best = { ...route, base };
    }
    return best;
  }

  /** @returns {Promise<{object: LevelObject, bytes: number}|null>} null: these deltas cannot be used here, now or later */
  async load(level, route, signal) {
    const levels = this.options.levels(level.family);
    const before = route.steps.at(-1);
    const inUnits = Boolean(before.delta.units && this.pieces.length === 1 && this.options.units?.wanted());
    try {
      let { base } = route;
      let bytes = 0;
      if (!inUnits || base.level !== before) {
        const whole = await this.loadSteps(inUnits ? before : level, route, levels, signal);
        bytes = whole.bytes;
        base = this.bases.get(whole.object);
        if (!inUnits) return whole;
      }
      const units = await this.loadUnits(level, base, before.delta.units, signal);
      return { object: units.object, bytes: bytes + units.bytes };
    } catch (error) {
      if (signal.aborted || error.kind === 'unreachable' || error.kind === 'problem') throw error;
      this.refused.add(level.family); // what does not decode once never does: levels come whole from now on
      return null;
    }
  }

  /** By one response with all steps to `level`; levels on the way are told of as they come. */
  async loadSteps(level, { base, steps, bytes: expected }, levels, signal) {
    const { client, id, core, onBytes, hold } = this.options;
    const pool = core();
    const lasts = []; // the levels that have come, each with its numbers in the worker
    let decoded = []; // units of the next one
    let at = 0;
    let queue = Promise.resolve();
    const frames = async (bytes, size) => {
      while (lasts.at(-1)?.level !== level) {
        const length = await pool.frameSize(bytes.slice(at, Math.min(size, at + 160)));
        if (length === 0 || at + length > size) return;
        const frame = bytes.slice(at, at + length);
        at += length;
        const from = lasts.at(-1)?.ids ?? (await this.own(base));
        signal.throwIfAborted();
        decoded.push(await pool.decode(frame, from[decoded.length])); // frames of units come in their order
        if (decoded.length < this.pieces.length) continue;
        const next = levels.find((l) => l.level === steps[lasts.length].delta.to);
        const ids = decoded.map(({ id }) => id);
        const object = await levelFromArrays(decoded.map(({ arrays }) => arrays), base.object, this.options.normals, this.pieces);
        this.bases.set(object, { level: next, object, ids: Promise.resolve(ids) });
        decoded = [];
        lasts.push({ ids, level: next, object });
        if (next !== level) this.options.onStep?.(next, { object, facts: null }, object.bytes + length);
      }
    };
    const bytes = await client.delta(id, { family: level.family, from: base.level.level, to: level.level }, {
      signal, onBytes, expected, hold, onGrown: (buffer, size) => (queue = queue.then(() => frames(buffer, size))), onRestart: () => {
        at = 0;
        lasts.length = 0;
        decoded = [];
      },
    });
    await queue;
    await frames(bytes, bytes.length);
    const last = lasts.at(-1);
    if (last?.level !== level) throw new ProtocolError('The steps end before the level.', { kind: 'malformed' });
    return { object: last.object, bytes: bytes.length };
  }

  async loadUnits(level, base, units, signal) {
    const { client, core, normals, onBytes, hold } = this.options;
    const [number] = await this.own(base);
    const load = new UnitsLoad({ client, core, normals, onBytes, hold, look: this.options.units.look, onPart: this.options.units.onPart });
    const { object, id, bytes, morph } = await load.run({ id: number, object: base.object }, units, signal);
    this.bases.set(object, { level, object, ids: Promise.resolve([id]) });
    if (morph) this.finals.set(object, morph);
    return { object, bytes };
  }

  /** The base's numbers in the worker. */
  own(base) {
    base.ids ??= Promise.all(trianglesOf(base.object, this.pieces).map(({ positions, index }) => this.options.core().level(positions, index)));
    return base.ids;
  }
}

/** Positions as decoded, welded by the module: of each unit, in its own space. */
function trianglesOf(object, pieces) {
  const unitOf = new Map(pieces.flatMap(({ parts }, u) => parts.map((part) => [part, u])));
  const units = pieces.map(() => ({ positions: [], index: [] }));
  const seen = new Set(); // instances share their geometry
  object.root.traverse((mesh) => {
    if (!mesh.isMesh || seen.has(mesh.geometry)) return;
    seen.add(mesh.geometry);
    const { positions, index } = units[unitOf.get(mesh.userData.part ?? mesh.parent?.userData.part ?? 0) ?? 0];
    const { position } = mesh.geometry.attributes;
    const offset = positions.length / 3;
    for (let v = 0; v < position.count; v++) positions.push(position.getX(v), position.getY(v), position.getZ(v));
    const own = mesh.geometry.index;
    const count = own ? own.count : position.count;
    for (let i = 0; i < count; i++) index.push(offset + (own ? own.getX(i) : i));
  });
  return units.map(({ positions, index }) => ({ positions: Float32Array.from(positions), index: Uint32Array.from(index) }));
}

/**
 * A LevelObject of decoded arrays (an item a unit) with the materials of another level of the model.
 * @param {object[]} units @param {{parts: number[], instances: number[][]|null}[]} pieces
 */
export async function levelFromArrays(units, like, normals, pieces = [{ parts: [0], instances: null }]) {
  const materials = new Map();
  like.root.traverse((mesh) => {
    if (mesh.isMesh) materials.set(mesh.material.userData.lodMaterial ?? -1, mesh.material);
  });
  const root = new Group();
  const associations = new Map();
  const primitives = [];
  units.forEach((arrays, u) => {
    for (const { geometry, number } of geometriesOf(arrays)) {
      const like = materials.get(number);
      if (!like) throw new Error(`The level has a material ${number} that the one before it lacks.`);
      const material = like.clone();
      for (const matrix of pieces[u].instances ?? [null]) {
        const mesh = new Mesh(geometry, material);
        mesh.userData.part = pieces[u].parts[0];
        if (matrix) mesh.applyMatrix4(new Matrix4().fromArray(matrix));
        associations.set(mesh, { meshes: 0, primitives: primitives.length });
        root.add(mesh);
      }
      primitives.push({ material: number < 0 ? undefined : number });
    }
  });
  return LevelObject.create({ scene: root, parser: { associations, json: { meshes: [{ primitives }] } } }, normals);
}

/** One geometry for each material of a unit. */
function geometriesOf(arrays) {
  const wedges = arrays.wedgeVertex !== null && arrays.corners !== null;
  const corners = wedges ? arrays.corners : arrays.triangles;
  const positions = wedges ? spread(arrays.positions, arrays.wedgeVertex) : arrays.positions;
  const numbers = arrays.materials ? Int32Array.from(arrays.materials) : new Int32Array(corners.length / 3).fill(-1);
  return [...new Set(numbers)].map((number) => {
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    if (wedges && arrays.normals) geometry.setAttribute('normal', new BufferAttribute(arrays.normals, 3));
    if (wedges && arrays.uvs) geometry.setAttribute('uv', new BufferAttribute(arrays.uvs, 2));
    if (wedges && arrays.colors) geometry.setAttribute('color', new BufferAttribute(arrays.colors, 4));
    geometry.setIndex(new BufferAttribute(corners.filter((_, i) => numbers[Math.floor(i / 3)] === number), 1));
    return { geometry, number };
  });
}

function spread(positions, wedgeVertex) {
  const out = new Float32Array(3 * wedgeVertex.length);
  for (let w = 0; w < wedgeVertex.length; w++) for (let k = 0; k < 3; k++) out[3 * w + k] = positions[3 * wedgeVertex[w] + k];
  return out;
}
