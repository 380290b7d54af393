/**
 * The module in a worker, asked by promises. Levels and maps stay in the worker; numbers name them. Where no worker can be started (a test in
 * node, a page without them) the same runs here. What was asked for and is no longer wanted is answered all the same: jobs are short.
 */

import { CoreJobs } from './core-worker.js';

export class CorePool {
  /** @param {{worker?: URL|null, wasm: URL|string|BufferSource}} options worker: URL of the bundled core-worker.js */
  constructor({ worker = null, wasm }) {
    this.waiting = new Map();
    this.count = 0;
    this.jobs = null;
    this.worker = null;
    try {
      this.worker = worker === null ? null : new Worker(worker, { type: 'module' });
    } catch {
      this.worker = null; // a policy forbids workers
    }
    if (this.worker) {
      this.worker.onmessage = ({ data }) => this.answer(data);
      this.worker.onerror = (event) => this.fail(event.message || 'The worker stopped.');
      this.worker.postMessage({ wasm: wasm instanceof URL ? wasm.href : wasm });
    } else {
      this.jobs = new CoreJobs(wasm instanceof URL ? wasm.href : wasm);
    }
  }

  /** A level as it is drawn; resolves to its number. */
  level(positions, index, materials = null) {
    return this.ask('level', { positions, index, materials });
  }

  /** The level that `bytes` make of level `base` (null: of a first picture); {id, arrays}. */
  decode(bytes, base = null) {
    return this.ask('decode', { bytes, base });
  }

  /** The morph from level `from` to the finer level `to`. options: `reach` of Core.map, and those of LevelMap.draw, which makes the result. */
  morph(from, to, options) {
    return this.ask('morph', { from, to, ...options });
  }

  /** Bytes of the delta frame that begins at `bytes`; 0: more of them are needed to tell. */
  frameSize(bytes) {
    return this.ask('frameSize', { bytes });
  }

  /** The step in units whose index begins at `bytes`, from level `base`; {id, first, patches, ...} as Units.facts in core.js. */
  unitsOpen(bytes, base) {
    return this.ask('unitsOpen', { bytes, base });
  }

  unitsDecode(units, patch, bytes) {
    return this.ask('unitsDecode', { units, patch, bytes });
  }

  /** What has come, as a level; {id, arrays}. */
  unitsJoin(units) {
    return this.ask('unitsJoin', { units });
  }

  /** What to draw of it; level `to`: what unitsJoin made last, as it is drawn. */
  unitsDraw(units, to, options) {
    return this.ask('unitsDraw', { units, to, ...options });
  }

  unitsFree(units) {
    this.ask('unitsFree', { units }).catch(() => {});
  }

  free(level) {
    this.ask('free', { level }).catch(() => {});
  }

  ask(what, options) {
    if (this.jobs) return this.jobs.run(what, options).then(({ result }) => result);
    if (!this.worker) return Promise.reject(new Error('The worker has stopped.'));
    const number = ++this.count;
    return new Promise((resolve, reject) => {
      this.waiting.set(number, { resolve, reject });
      this.worker.postMessage({ number, what, options });
    });
  }

  answer({ number, result, problem }) {
    const waiting = this.waiting.get(number);
    this.waiting.delete(number);
    if (problem) waiting?.reject(Object.assign(new Error(problem.message), { type: problem.type }));
    else waiting?.resolve(result);
  }

  fail(message) {
    for (const { reject } of this.waiting.values()) reject(new Error(message));
    this.waiting.clear();
    this.worker?.terminate();
    this.worker = null;
  }

  close() {
    this.fail('The model was closed.');
    this.jobs = null;
  }
}
