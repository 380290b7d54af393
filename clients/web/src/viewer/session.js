/** One model being looked at: its manifest, its stream of levels, what has been loaded. Ends when another is opened. */

import { familyLevels } from '../protocol/index.js';
import { LevelStream } from '../stream/index.js';
import { LevelLoader, Morpher } from '../three/index.js';

export class ModelSession {
  /**
   * @param {{client, id, manifest, assets: {draco, normalsWorker, core: () => CorePool}, onShow: (level, value) => void, onDispose: (value) => void,
   *          onBytes: () => void, onError: (error, level) => void, onTextureError: (error) => void,
   *          units: {wanted: () => boolean, look: () => object, onPart: (part) => Promise<boolean>}}} options
   */
  constructor(options) {
    const { client, id, manifest } = options;
    this.id = id;
    this.manifest = manifest;
    this.loadedBytes = 0;
    this.facts = null;
    this.family = null;
    const count = (n) => {
      this.loadedBytes += n;
      options.onBytes();
    };
    this.loader = new LevelLoader(client, id, {
      ...options.assets,
      levels: (family) => manifest.families.get(family).levels,
      pieces: manifest.units,
      onBytes: count,
      onTextureError: options.onTextureError,
      onStep: (level, value, bytes) => {
        value.object.lod = level;
        this.stream.offer(level, { value, bytes });
      },
      hold: () => this.held?.promise ?? null,
      units: options.units,
    });
    /** While paused: {promise, release}. */
    this.held = null;
    this.core = options.assets.core;
    this.morpher = null;
    /** What was drawn after how many bytes: the certified error against what it cost. */
    this.trail = [];
    this.stream = new LevelStream({
      load: (level, signal) => this.load(level, signal),
      dispose: (value) => {
        options.onDispose(value);
        this.morpher?.forget(value.object);
        this.loader.forget(value.object);
        value.object.dispose();
      },
      onShow: (level, value) => {
        this.facts = value.facts;
        this.trail.push({ bytes: this.loadedBytes, error: level.error });
        options.onShow(level, value);
      },
      onError: options.onError,
      now: () => performance.now() / 1000,
      later: (run, seconds) => setTimeout(run, seconds * 1000),
    });
  }

  async load(level, signal) {
    const loaded = await this.loader.load(level, signal);
    loaded.value.object.lod = level;
    return loaded;
  }

  /** Nothing more is read from the network, and what was asked for goes on where it stands when it is over. */
  pause() {
    if (this.held) return;
    const held = { promise: null, release: null };
    held.promise = new Promise((resolve) => (held.release = resolve));
    this.held = held;
  }

  resume() {
    this.held?.release();
    this.held = null;
  }

  /**
   * What leads from one drawn level to another without a jump; null where there is no such thing: levels of different families, or of one whose
   * levels do not contain one another.
   * @returns {Promise<{object: import('../three/morph.js').MorphObject, refines: boolean}|null>|null}
   */
  morph(before, next, exact = true) {
    const final = this.loader.deltas?.finals.get(next);
    if (final && final.after === before) return Promise.resolve({ object: final.shape, refines: true });
    if (before.transient) return null; // of a level that is no longer on its way
    const a = before.lod;
    const b = next.lod;
    if (!a || !b || a.family !== b.family || a.level === b.level || !this.manifest.families.get(a.family)?.nested) return null;
    const refines = b.level > a.level;
    this.morpher ??= new Morpher(this.core());
    const [coarse, fine] = refines ? [before, next] : [next, before];
    // Decoded positions are off by less than the certified errors, which count quantisation.
    return this.morpher.morph(coarse, fine, { reach: a.error + b.error, exact }).then((object) => object && { object, refines });
  }

  /** A name that the model does not have falls back to all of them. */
  setFamily(name) {
    const family = this.manifest.families.has(name) ? name : 'auto';
    if (family === this.family) return;
    this.family = family;
    this.stream.setLevels(familyLevels(this.manifest, family));
  }

  get levels() {
    return this.stream.levels;
  }

  get shown() {
    return this.stream.shown;
  }

  close() {
    this.resume();
    this.stream.close();
    this.loader.close();
  }
}
