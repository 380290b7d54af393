/**
 * Levels of one model arriving as the view changes: what is wanted is asked for coarse first, what is no longer useful is cancelled, what was
 * fetched stays in a byte-bounded cache, and what is drawn only ever changes to something better suited. Pure: loading is injected.
 */

import { LevelSelector, refinementSteps } from './selector.js';
import { RequestQueue } from './queue.js';
import { ByteCache } from './cache.js';

const RETRY_SECONDS = [0.5, 1, 2, 4, 8, 15];

export class LevelStream {
  /**
   * @param {{
   *   load: (level, signal: AbortSignal) => Promise<{value: any, bytes: number}>,  value: what is drawn; bytes: what it costs to keep
   *   dispose?: (value) => void,
   *   onShow: (level, value) => void,           this level is to be drawn from now on
   *   onError?: (error, level) => void,
   *   now: () => number,                        seconds
   *   later?: (run: () => void, seconds: number) => void,
   *   cacheBytes?: number, concurrency?: number }} options
   */
  constructor(options) {
    this.options = options;
    this.selector = new LevelSelector();
    this.queue = new RequestQueue(options.concurrency ?? 2);
    this.cache = new ByteCache(options.cacheBytes ?? 256 << 20, (value) => options.dispose?.(value));
    this.levels = [];
    this.wanted = null;
    this.shown = null;
    this.pinned = null;
    this.moving = false;
    this.failures = new Map();
    this.closed = false;
  }

  /** The levels to choose from (protocol's familyLevels). What is drawn stays until a level of the new set has arrived. */
  setLevels(levels) {
    this.levels = levels;
    this.selector.reset();
    this.wanted = null;
    this.pinned = null;
    for (const key of this.queue.keys()) if (!levels.some((l) => keyOf(l) === key)) this.queue.cancel(key);
  }

  /**
   * Call whenever view or tolerance may have changed; cheap. Returns the level that is wanted, null before setLevels.
   * moving: while true nothing coarser than what is drawn is fetched, only taken from the cache: the wish may be gone in a moment.
   */
  update(tolerance, view, moving = false) {
    if (this.closed || !this.levels.length) return null;
    const chosen = this.selector.select(this.levels, tolerance, view);
    this.wanted = this.pinned ?? chosen;
    this.moving = moving;
    this.request();
    return this.wanted;
  }

  /** Draws this level whatever the view; null: back to choosing. Takes effect with the next update. */
  pin(level) {
    this.pinned = level && this.levels.includes(level) ? level : null;
  }

  /** Whether what is drawn is what is wanted. */
  get settled() {
    return this.wanted !== null && this.shown === this.wanted;
  }

  get busy() {
    return this.queue.entries.size > 0;
  }

  close() {
    this.closed = true;
    this.queue.cancelAll();
    if (this.shown) this.cache.release(keyOf(this.shown));
    this.shown = null;
    this.cache.clear();
  }

  request() {
    const target = this.wanted;
    if (this.shown === target) {
      this.cancelExcept([]);
      return;
    }
    if (this.cache.has(keyOf(target))) {
      this.cancelExcept([]);
      this.show(target);
      return;
    }
    const from = this.shown && this.levels.includes(this.shown) ? this.shown : null;
    if (from && from.error < target.error) {
      this.relax(from, target);
      return;
    }
    // Steps that lie in the cache cost nothing: the finest of them is shown at once.
    const improves = (l) => from === null || l.error < from.error;
    const cached = this.levels.filter((l) => l.error >= target.error && improves(l) && this.cache.has(keyOf(l)));
    if (cached.length) this.show(cached.reduce((best, l) => (l.error < best.error ? l : best)));

    const start = this.shown && this.levels.includes(this.shown) ? this.shown : null;
    const steps = refinementSteps(this.levels, start, target);
    this.cancelExcept(steps);
    steps.forEach((level, i) => {
      if (!this.cache.has(keyOf(level)) && !this.waiting(level)) this.fetch(level, steps.length - i);
    });
  }

  /** What is drawn is finer than wanted: the lightest level at hand that is fine enough now, the wanted one when there is time for it. */
  relax(from, target) {
    const lighter = this.levels.filter((l) => l.error <= target.error && l.triangles < from.triangles && this.cache.has(keyOf(l)));
    if (lighter.length) this.show(lighter.reduce((best, l) => (l.triangles < best.triangles ? l : best)));
    this.cancelExcept(this.moving ? [] : [target]);
    if (!this.moving && !this.waiting(target)) this.fetch(target, 1);
  }

  /** Cancels what is neither a step nor on the way: one that runs and lies between what is drawn and what is wanted still helps. */
  cancelExcept(steps) {
    const keep = new Set(steps.map(keyOf));
    for (const level of this.levels) {
      const key = keyOf(level);
      if (keep.has(key) || !this.queue.has(key)) continue;
      const between = this.shown !== this.wanted && level.error > this.wanted.error && (!this.shown || level.error < this.shown.error);
      if (!(between && this.queue.isRunning(key))) this.queue.cancel(key);
    }
  }

  fetch(level, priority) {
    const key = keyOf(level);
    const had = this.queue.has(key);
    const promise = this.queue.add(key, (signal) => this.options.load(level, signal), priority);
    if (had) return;
    promise.then(
      (loaded) => this.arrived(level, loaded),
      (error) => this.failed(level, error),
    );
  }

  arrived(level, loaded) {
    if (this.closed) {
      this.options.dispose?.(loaded.value);
      return;
    }
    this.failures.delete(keyOf(level));
    this.cache.set(keyOf(level), loaded.value, loaded.bytes);
    if (this.wanted === null || !this.levels.includes(level)) return;
    const current = this.shown && this.levels.includes(this.shown) ? this.shown : null;
    const nearer = current === null || (current.error > this.wanted.error && level.error < current.error && level.error >= this.wanted.error);
    if (level === this.wanted || nearer) this.show(level);
  }

  /** A level that came on the way to another one, whole; as if it had been asked for. */
  offer(level, loaded) {
    if (this.cache.has(keyOf(level))) this.options.dispose?.(loaded.value);
    else this.arrived(level, loaded);
  }

  failed(level, error) {
    if (this.closed || error?.name === 'AbortError') return;
    const key = keyOf(level);
    const count = (this.failures.get(key)?.count ?? 0) + 1;
    const wait = RETRY_SECONDS[Math.min(count, RETRY_SECONDS.length) - 1];
    this.failures.set(key, { count, until: this.options.now() + wait });
    this.options.onError?.(error, level);
    this.options.later?.(() => {
      if (!this.closed && this.wanted) this.request();
    }, wait);
  }

  waiting(level) {
    const failure = this.failures.get(keyOf(level));
    return failure !== undefined && this.options.now() < failure.until;
  }

  show(level) {
    const value = this.cache.get(keyOf(level));
    if (value === undefined || this.shown === level) return;
    this.cache.hold(keyOf(level));
    if (this.shown) this.cache.release(keyOf(this.shown));
    this.shown = level;
    this.options.onShow(level, value);
  }
}

/** Levels are the same when family, number and bytes are: an object's hash covers all of it. */
export function keyOf(level) {
  return `${level.family}/${level.level}/${level.object}`;
}
