/**
 * Pictures shared by all levels of a model: each is fetched, decoded and given to the GPU once, however many levels refer to it.
 *
 * Stands in for GLTFLoader's own texture loader. A texture that it hands out is the level's own (wrapping, channel and transform differ by
 * material) but its pixels are one THREE.Source, which three uploads once and frees with the last texture.
 */

import { LinearSRGBColorSpace, Texture } from 'three';

export class SharedTextures {
  /**
   * @param {import('../stream/client.js').Client} client
   * @param {{onBytes?: (n: number) => void, onError?: (error: Error) => void}} options
   */
  constructor(client, options = {}) {
    this.client = client;
    this.onBytes = options.onBytes ?? (() => {});
    this.onError = options.onError ?? (() => {});
    this.pictures = new Map();
    this.closing = new AbortController();
  }

  /** GLTFLoader's contract. */
  load(url, onLoad, onProgress, onError) {
    this.picture(url).then(
      (texture) => {
        const own = texture.clone();
        own.version = 1; // to be uploaded, without touching the shared source's version, which would upload its pixels again
        onLoad(own);
      },
      (error) => {
        if (!this.closing.signal.aborted) this.onError(error);
        onError?.(error);
      },
    );
  }

  picture(url) {
    const key = nameOf(url);
    let promise = this.pictures.get(key);
    if (!promise) {
      promise = this.fetchPicture(url);
      this.pictures.set(key, promise);
      promise.catch(() => this.pictures.delete(key)); // the next level tries again
    }
    return promise;
  }

  async fetchPicture(url) {
    const embedded = /^(blob|data):/.test(url);
    const response = embedded ? await fetch(url) : await this.client.request(url, { signal: this.closing.signal });
    const blob = await response.blob();
    if (!embedded) this.onBytes(blob.size);
    const bitmap = await createImageBitmap(blob, { imageOrientation: 'none', premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
    const texture = new Texture(bitmap);
    texture.colorSpace = LinearSRGBColorSpace;
    texture.flipY = false;
    texture.needsUpdate = true;
    return texture;
  }

  close() {
    this.closing.abort();
    for (const promise of this.pictures.values()) {
      promise.then(
        (texture) => {
          texture.source.data.close?.();
          texture.dispose();
        },
        () => {},
      );
    }
    this.pictures.clear();
  }
}

/** Objects are named by their hash wherever they are served from: .../<sha256> is the same picture under every path. */
function nameOf(url) {
  return url.match(/\/([0-9a-f]{64})(?:[?#]|$)/)?.[1] ?? url;
}
