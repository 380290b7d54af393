/** One model being looked at: its manifest, its stream of levels, what has been loaded. Ends when another is opened. */

import { familyLevels } from '../protocol/index.js';
import { LevelStream } from '../stream/index.js';
import { LevelLoader } from '../three/index.js';

export class ModelSession {
  /**
   * @param {{client, id, manifest, assets: {draco, normalsWorker}, onShow: (level, value) => void, onDispose: (value) => void,
   *          onBytes: () => void, onError: (error, level) => void, onTextureError: (error) => void}} options
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
    this.loader = new LevelLoader(client, id, { ...options.assets, onBytes: count, onTextureError: options.onTextureError });
    this.stream = new LevelStream({
      load: (level, signal) => this.loader.load(level, signal),
      dispose: (value) => {
        options.onDispose(value);
        value.object.dispose();
      },
      onShow: (level, value) => {
        this.facts = value.facts;
        options.onShow(level, value);
      },
      onError: options.onError,
      now: () => performance.now() / 1000,
      later: (run, seconds) => setTimeout(run, seconds * 1000),
    });
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
    this.stream.close();
    this.loader.close();
  }
}
