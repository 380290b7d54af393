/** The module's side of pool.js: keeps levels by number and does one job at a time. */

import { Core } from './core.js';

export class CoreJobs {
  /** @param {string|BufferSource} wasm URL or bytes of the module */
  constructor(wasm) {
    this.core = Core.create(typeof wasm === 'string' ? fetch(wasm) : wasm);
    this.core.catch(() => {});
    this.levels = new Map();
    this.steps = new Map();
    this.count = 0;
  }

  /** @returns {Promise<{result: any, transfer: ArrayBuffer[]}>} */
  async run(what, options) {
    const core = await this.core;
    if (what === 'level') return { result: this.keep(core.level(options.positions, options.index, options.materials)), transfer: [] };
    if (what === 'decode') {
      const level = core.decode(options.bytes, options.base === null ? null : this.levels.get(options.base));
      const arrays = level.arrays();
      return { result: { id: this.keep(level), arrays }, transfer: buffersOf(arrays) };
    }
    if (what === 'frameSize') return { result: core.frameSize(options.bytes), transfer: [] };
    if (what === 'morph') return this.morph(core, options);
    if (what.startsWith('units')) return this.units(core, what, options);
    this.levels.get(options.level)?.free();
    this.levels.delete(options.level);
    return { result: null, transfer: [] };
  }

  morph(core, { from, to, reach = 0, ...draw }) {
    const map = core.map(this.levels.get(from), this.levels.get(to), reach);
    try {
      const result = map.draw(draw);
      return { result, transfer: buffersOf(result) };
    } finally {
      map.free();
    }
  }

  units(core, what, options) {
    const step = this.steps.get(options.units);
    if (what === 'unitsOpen') {
      const opened = core.units(options.bytes, this.levels.get(options.base));
      this.steps.set(++this.count, opened);
      return { result: { id: this.count, ...opened.facts() }, transfer: [] };
    }
    if (what === 'unitsDecode') {
      step.decode(options.patch, options.bytes);
      return { result: null, transfer: [] };
    }
    if (what === 'unitsJoin') {
      const level = step.join();
      const arrays = level.arrays();
      return { result: { id: this.keep(level), arrays }, transfer: buffersOf(arrays) };
    }
    if (what === 'unitsDraw') {
      const { values, coarse, fine } = options;
      const result = step.draw(this.levels.get(options.to), { values, coarse, fineValues: fine });
      return { result, transfer: buffersOf(result) };
    }
    step?.free();
    this.steps.delete(options.units);
    return { result: null, transfer: [] };
  }

  keep(level) {
    this.levels.set(++this.count, level);
    return this.count;
  }
}

function buffersOf(arrays) {
  return Object.values(arrays).filter((value) => ArrayBuffer.isView(value)).map((value) => value.buffer);
}

if (typeof WorkerGlobalScope !== 'undefined' && globalThis instanceof WorkerGlobalScope) {
  let jobs = null;
  globalThis.onmessage = async ({ data }) => {
    if (data.wasm !== undefined) {
      jobs = new CoreJobs(data.wasm);
      return;
    }
    try {
      const { result, transfer } = await jobs.run(data.what, data.options);
      globalThis.postMessage({ number: data.number, result }, transfer);
    } catch (error) {
      globalThis.postMessage({ number: data.number, problem: { type: error.type ?? 'unknown', message: error.message } });
    }
  };
}
