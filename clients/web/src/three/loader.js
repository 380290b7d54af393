/**
 * Level GLBs to LevelObjects: fetched through the stream's client, Draco decoded in a worker, pictures shared between levels.
 */

import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { ProtocolError } from '../protocol/problem.js';
import { LevelObject } from './level.js';
import { NormalsPool } from './normals-pool.js';
import { SharedTextures } from './textures.js';

export class LevelLoader {
  /**
   * @param {import('../stream/client.js').Client} client
   * @param {string} id of the model
   * @param {{dracoPath: string, draco?: DRACOLoader, normalsWorker?: URL, onBytes?: (n: number) => void, onFacts?: (level, facts) => void,
   *          onTextureError?: (error: Error) => void}} options
   *   dracoPath: URL of the folder with three's decoder files; draco: a decoder shared between models; normalsWorker: URL of the bundled
   *   normals-worker.js
   */
  constructor(client, id, options) {
    this.client = client;
    this.id = id;
    this.options = options;
    this.textures = new SharedTextures(client, { onBytes: options.onBytes, onError: options.onTextureError });
    this.draco = options.draco ?? makeDraco(options.dracoPath);
    this.normals = new NormalsPool(options.normalsWorker ?? null);
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
    const { bytes, facts, url } = await this.client.level(this.id, level, { signal, onBytes: this.options.onBytes });
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
    return { value: { object, facts }, bytes: object.bytes + bytes.length };
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
