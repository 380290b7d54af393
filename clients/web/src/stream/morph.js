/**
 * How far a geomorph is. t = 0 is the coarser level, t = 1 the finer one; t moves towards its target at a bounded rate and never jumps, whatever
 * the target or the clock does. Pure: seconds come from the caller.
 *
 * By time: the target is an end, and t gets there in `seconds`. By screen error: the target follows the view (screenTarget), so that a dive that stops
 * half way leaves the shape half way, and flying back takes it back.
 */

import { errorPixels } from '../protocol/screen.js';

/** A frame that took longer (a hidden page, a slow decode) moves t no further than this many seconds would. */
const LONGEST_STEP = 1 / 15;

export class MorphDriver {
  /** @param {{seconds?: number}} options seconds: from one end to the other */
  constructor(options = {}) {
    this.seconds = options.seconds ?? 0.5;
    this.t = 1;
    this.target = 1;
    this.paused = false;
    this.last = null;
  }

  /** Starts a step at t. */
  begin(t, target) {
    this.t = clamp(t);
    this.target = clamp(target);
    this.last = null;
  }

  aim(target) {
    this.target = clamp(target);
  }

  /** t stays where it is until resume; time that passes meanwhile does not count. */
  pause() {
    this.paused = true;
  }

  resume() {
    this.paused = false;
    this.last = null;
  }

  /** @param {number} seconds a clock @returns {number} t */
  update(seconds) {
    const dt = this.last === null ? 0 : Math.min(Math.max(seconds - this.last, 0), LONGEST_STEP);
    this.last = seconds;
    if (this.paused) return this.t;
    const step = this.seconds > 0 ? dt / this.seconds : 1;
    this.t = this.t < this.target ? Math.min(this.target, this.t + step) : Math.max(this.target, this.t - step);
    return this.t;
  }

  get done() {
    return this.t === this.target;
  }
}

/**
 * Where t should be at this view: the coarser level alone while its error is at most half the limit, the finer one alone from where the coarser would
 * break it. Between them t follows the error on screen, so it is continuous in the view.
 */
export function screenTarget(coarse, limit, view) {
  return clamp(2 * (errorPixels(coarse.error, view) / limit) - 1);
}

/**
 * How to get level `target` when `have` is at hand (null: nothing): the deltas from there on, or its own file, whichever is fewer bytes.
 *
 * @param {{level: number, bytes: number, error: number, delta: {to: number, bytes: number}|null}[]} levels of one family
 * @returns {{kind: "deltas", steps: object[], bytes: number} | {kind: "level", level: object, bytes: number}}
 *   steps: the levels whose delta is asked for, in order; the last one's leads to target
 */
export function chooseRoute(levels, have, target) {
  const whole = { kind: 'level', level: target, bytes: target.bytes };
  if (!have || have.level >= target.level) return whole;
  const steps = [];
  let bytes = 0;
  for (let at = have.level; at !== target.level; ) {
    const step = levels.find((l) => l.level === at);
    if (!step?.delta || step.delta.to <= at || step.delta.to > target.level) return whole;
    steps.push(step);
    bytes += step.delta.bytes;
    at = step.delta.to;
  }
  return bytes < whole.bytes ? { kind: 'deltas', steps, bytes } : whole;
}

function clamp(t) {
  return Math.min(1, Math.max(0, t));
}
