/** computeCreasedNormals where it does not stop the picture: large meshes go to a worker, small ones are done on the spot. */
import { computeCreasedNormals } from './normals.js';

const SMALL_CORNERS = 30000;

export class NormalsPool {
  /** @param {string|URL|null} workerUrl the bundled normals-worker.js; null: everything on the spot */
  constructor(workerUrl) {
    this.workerUrl = workerUrl;
    this.worker = null;
    this.waiting = new Map();
    this.next = 0;
  }

  async compute(positions, index) {
    const corners = index ? index.length : positions.length / 3;
    if (!this.workerUrl || corners < SMALL_CORNERS) return computeCreasedNormals(positions, index);
    this.worker ??= this.start();
    const id = this.next++;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ id, positions, index });
    });
  }

  start() {
    const worker = new Worker(this.workerUrl, { type: 'module' });
    worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error) reject(new Error(data.error));
      else resolve(data);
    };
    worker.onerror = (event) => {
      for (const { reject } of this.waiting.values()) reject(new Error(event.message || 'The worker for normals failed'));
      this.waiting.clear();
    };
    return worker;
  }

  close() {
    this.worker?.terminate();
    this.worker = null;
    for (const { reject } of this.waiting.values()) reject(new DOMException('Closed', 'AbortError'));
    this.waiting.clear();
  }
}
