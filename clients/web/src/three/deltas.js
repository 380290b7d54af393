/**
 * Levels from deltas: the frames of GET /v1/models/{id}/delta, each decoded in the worker as soon as it is whole, and drawn with the materials of the
 * level that they began from.
 */

import { BufferAttribute, BufferGeometry, Group, Mesh } from 'three';
import { ProtocolError } from '../protocol/problem.js';
import { chooseRoute } from '../stream/morph.js';
import { LevelObject } from './level.js';
import { UnitsLoad } from './units.js';

/** A level that is on its way is waited for when the steps from it save at least this part of the bytes. */
const WORTH_WAITING = 0.25;

export class DeltaLoader {
  /**
   * @param {{client, id: string, core: () => import('../wasm/pool.js').CorePool, normals, levels: (family: string) => object[],
   *          onBytes?: (n: number) => void, onStep?: (level, value: {object, facts}, bytes: number) => void, hold?: () => Promise<void>|null,
   *          units?: {wanted: () => boolean, look: () => object|null, onPart: (part) => Promise<boolean>}}} options
   *   levels: a family's, by which routes are chosen; onStep: a level on the way has come whole and may be drawn; hold: see download; units: last
   *   steps that have units come by these while `wanted` (units.js)
   */
  constructor(options) {
    this.options = options;
    /** Levels at hand, by object: {level, object: LevelObject, id: Promise<number>|null} */
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
    if (object.bars === 0) this.bases.set(object, { level, object, id: null });
  }

  /** The level is about to be freed. */
  forget(object) {
    const base = this.bases.get(object);
    this.bases.delete(object);
    this.finals.get(object)?.shape.dispose();
    base?.id?.then((id) => this.options.core().free(id)).catch(() => {});
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
    const inUnits = Boolean(before.delta.units && this.options.units?.wanted());
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
    const lasts = [];
    let at = 0;
    let queue = Promise.resolve();
    const frames = async (bytes, size) => {
      while (lasts.at(-1)?.level !== level) {
        const length = await pool.frameSize(bytes.slice(at, Math.min(size, at + 160)));
        if (length === 0 || at + length > size) return;
        const frame = bytes.slice(at, at + length);
        at += length;
        const from = lasts.at(-1) ?? (await this.own(base));
        const next = levels.find((l) => l.level === steps[lasts.length].delta.to);
        signal.throwIfAborted();
        const decoded = await pool.decode(frame, from.id);
        const object = await this.object({ id: decoded.id, arrays: decoded.arrays, level: next }, base.object);
        lasts.push({ id: decoded.id, level: next, object });
        if (next !== level) this.options.onStep?.(next, { object, facts: null }, object.bytes + length);
      }
    };
    const bytes = await client.delta(id, { family: level.family, from: base.level.level, to: level.level }, {
      signal, onBytes, expected, hold, onGrown: (buffer, size) => (queue = queue.then(() => frames(buffer, size))), onRestart: () => {
        at = 0;
        lasts.length = 0;
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
    await this.own(base);
    const load = new UnitsLoad({ client, core, normals, onBytes, hold, look: this.options.units.look, onPart: this.options.units.onPart });
    const { object, id, bytes, morph } = await load.run(base, units, signal);
    this.bases.set(object, { level, object, id: Promise.resolve(id) });
    if (morph) this.finals.set(object, morph);
    return { object, bytes };
  }

  /** The number of the base in the worker. */
  own(base) {
    base.id ??= (async () => {
      const { positions, index } = trianglesOf(base.object);
      return this.options.core().level(positions, index);
    })();
    return base.id.then((id) => ({ id, level: base.level }));
  }

  /** The decoded level as what is drawn; it becomes a base itself. */
  async object({ id, arrays, level }, like) {
    const object = await levelFromArrays(arrays, like, this.options.normals);
    this.bases.set(object, { level, object, id: Promise.resolve(id) });
    return object;
  }
}

/** Positions as decoded, welded by the module: those of all meshes, which lie in the model's space. */
function trianglesOf(object) {
  const positions = [];
  const index = [];
  object.root.traverse((mesh) => {
    if (!mesh.isMesh) return;
    const { position } = mesh.geometry.attributes;
    const offset = positions.length / 3;
    for (let v = 0; v < position.count; v++) positions.push(position.getX(v), position.getY(v), position.getZ(v));
    const own = mesh.geometry.index;
    const count = own ? own.count : position.count;
    for (let i = 0; i < count; i++) index.push(offset + (own ? own.getX(i) : i));
  });
  return { positions: Float32Array.from(positions), index: Uint32Array.from(index) };
}

/** A LevelObject of decoded arrays with the materials of another level of the model. */
export async function levelFromArrays(arrays, like, normals) {
  const materials = new Map();
  like.root.traverse((mesh) => {
    if (mesh.isMesh) materials.set(mesh.material.userData.lodMaterial ?? -1, mesh.material);
  });
  const wedges = arrays.wedgeVertex !== null && arrays.corners !== null;
  const corners = wedges ? arrays.corners : arrays.triangles;
  const positions = wedges ? spread(arrays.positions, arrays.wedgeVertex) : arrays.positions;
  const numbers = arrays.materials ? Int32Array.from(arrays.materials) : new Int32Array(corners.length / 3).fill(-1);
  const root = new Group();
  const associations = new Map();
  const primitives = [];
  for (const number of new Set(numbers)) {
    const material = materials.get(number);
    if (!material) throw new Error(`The level has a material ${number} that the one before it lacks.`);
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(positions, 3));
    if (wedges && arrays.normals) geometry.setAttribute('normal', new BufferAttribute(arrays.normals, 3));
    if (wedges && arrays.uvs) geometry.setAttribute('uv', new BufferAttribute(arrays.uvs, 2));
    if (wedges && arrays.colors) geometry.setAttribute('color', new BufferAttribute(arrays.colors, 4));
    geometry.setIndex(new BufferAttribute(corners.filter((_, i) => numbers[Math.floor(i / 3)] === number), 1));
    const mesh = new Mesh(geometry, material.clone());
    associations.set(mesh, { meshes: 0, primitives: primitives.length });
    primitives.push({ material: number < 0 ? undefined : number });
    root.add(mesh);
  }
  return LevelObject.create({ scene: root, parser: { associations, json: { meshes: [{ primitives }] } } }, normals);
}

function spread(positions, wedgeVertex) {
  const out = new Float32Array(3 * wedgeVertex.length);
  for (let w = 0; w < wedgeVertex.length; w++) for (let k = 0; k < 3; k++) out[3 * w + k] = positions[3 * wedgeVertex[w] + k];
  return out;
}
