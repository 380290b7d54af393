/**
 * Level GLBs to LevelObjects: fetched through the stream's client, Draco decoded in a worker, pictures shared between levels.
 */

import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { ProtocolError } from '../protocol/problem.js';
import { DeltaLoader } from './deltas.js';
import { LevelObject } from './level.js';
import { NormalsPool } from './normals-pool.js';
import { SharedTextures } from './textures.js';

export class LevelLoader {
  /**
   * @param {import('../stream/client.js').Client} client
   * @param {string} id of the model
   * @param {{dracoPath: string, draco?: DRACOLoader, normalsWorker?: URL, onBytes?: (n: number) => void, onFacts?: (level, facts) => void,
   *          onTextureError?: (error: Error) => void, core?: () => import('../wasm/pool.js').CorePool, levels?: (family: string) => object[],
   *          pieces?, onStep?, hold?, units?}} options
   *   dracoPath: URL of the folder with three's decoder files; draco: a decoder shared between models; normalsWorker: URL of the bundled
   *   normals-worker.js; core, levels: with both, levels come by deltas where these are fewer bytes (deltas.js, which also says what pieces, onStep,
   *   hold and units are)
   */
  constructor(client, id, options) {
    this.client = client;
    this.id = id;
    this.options = options;
    this.textures = new SharedTextures(client, { onBytes: options.onBytes, onError: options.onTextureError });
    this.draco = options.draco ?? makeDraco(options.dracoPath);
    this.normals = new NormalsPool(options.normalsWorker ?? null);
    this.deltas = options.core && options.levels ? new DeltaLoader({ ...options, client, id, normals: this.normals }) : null;
    this.gltf = new GLTFLoader();
    this.gltf.setDRACOLoader(this.draco);
    const textures = this.textures;
    this.gltf.register((parser) => {
      parser.textureLoader = textures;
      return { name: 'LODESTREAM_shared_textures' };
    });
  }

  /** @returns {Promise<{value: {object: LevelObject, facts: object}, bytes: number}>} what LevelStream's load wants */
  async load(level, signal) {
    await this.deltas?.coming(level);
    signal.throwIfAborted();
    const route = this.deltas?.route(level);
    const stepped = route ? await this.deltas.load(level, route, signal) : null;
    if (stepped) return { value: { object: stepped.object, facts: null }, bytes: stepped.object.bytes + stepped.bytes };
    const loading = this.loadWhole(level, signal);
    this.deltas?.expect(level, loading);
    return loading;
  }

  async loadWhole(level, signal) {
    const { bytes, facts, url } = await this.client.level(this.id, level, { signal, onBytes: this.options.onBytes, hold: this.options.hold });
    this.options.onFacts?.(level, facts);
    // Texture URIs are relative to where the GLB was served.
    const folder = new URL('.', url).href;
    let gltf;
    try {
      gltf = await this.gltf.parseAsync(bytes.buffer, folder);
    } catch (cause) {
      throw new ProtocolError(`Level ${level.level} of ${this.id} cannot be read: ${cause.message}.`, { kind: 'malformed', cause });
    }
    const object = await LevelObject.create(gltf, this.normals);
    if (signal.aborted) {
      object.dispose();
      throw new DOMException('The level is no longer wanted', 'AbortError');
    }
    this.deltas?.offer(level, object);
    return { value: { object, facts }, bytes: object.bytes + bytes.length };
  }

  /** The object is about to be freed. */
  forget(object) {
    this.deltas?.forget(object);
  }

  close() {
    this.textures.close();
    this.normals.close();
    if (!this.options.draco) this.draco.dispose();
  }
}

export function makeDraco(path) {
  const draco = new DRACOLoader();
  draco.setDecoderPath(path);
  draco.setWorkerLimit(2);
  draco.preload?.();
  return draco;
}
