/**
 * Which level to draw, without flicker: the fewest bytes that keep the tolerance, refined at once, coarsened only when a coarser level
 * keeps it with room to spare. Pure; see protocol/screen.js for the rule itself.
 */

import { errorPixels, selectLevel, unitsPerPixel } from '../protocol/screen.js';

/** A coarser level must keep this part of the tolerance before it replaces a finer one: between the two borders nothing changes. */
const COARSEN_AT = 0.75;

export class LevelSelector {
  /** @param {{coarsenAt?: number}} options */
  constructor(options = {}) {
    this.coarsenAt = options.coarsenAt ?? COARSEN_AT;
    this.current = null;
  }

  reset() {
    this.current = null;
  }

  /**
   * @param {object[]} levels as familyLevels gives them
   * @param {{rule: "error"|"cell", limit: number, maxTriangles?: number}} tolerance limit: pixels of certified error, or pixels per cell (Low & Tan's X);
   *        maxTriangles: a budget that comes before the tolerance (frame rate)
   * @param {{distance, fov, height}} view
   * @returns {object} the level wanted now
   */
  select(levels, tolerance, view) {
    const within = withinBudget(levels, tolerance.maxTriangles);
    const limit = tolerance.limit * unitsPerPixel(view);
    const ideal = within[selectLevel(within, tolerance.rule, limit).index];
    const current = this.current && within.includes(this.current) ? this.current : null;
    this.current = current ? this.settle(within, current, ideal, tolerance.rule, limit) : ideal;
    return this.current;
  }

  settle(levels, current, ideal, rule, limit) {
    if (current === ideal) return current;
    const measured = rule === 'cell' && current.cell > 0 ? current.cell : current.error;
    if (measured > limit) return ideal;
    const spare = levels[selectLevel(levels, rule, limit * this.coarsenAt).index];
    return spare.bytes < current.bytes ? spare : current;
  }
}

/** Levels that fit the budget; the one with the fewest triangles when none does. */
function withinBudget(levels, maxTriangles) {
  if (maxTriangles === undefined) return levels;
  const fitting = levels.filter((l) => l.triangles + l.edges + l.points <= maxTriangles);
  return fitting.length ? fitting : [levels[selectLevel(levels, 'triangles', 0).index]];
}

/** Levels in between are fetched only when they cost at most this part of the next one: all of them together stay below 1/(GROWTH - 1). */
const GROWTH = 6;
/** Below this a request costs more time than its bytes. */
const SMALL_BYTES = 24 * 1024;

/**
 * What to fetch to get from `shown` (or from nothing, null) to `target`: coarse first, then finer, the target last. Something is on
 * screen after a few kilobytes, and all steps together cost at most a fifth more than the target alone.
 */
export function refinementSteps(levels, shown, target) {
  const steps = [target];
  const start = shown ? shown.bytes : 0;
  let next = target;
  while (next.bytes > SMALL_BYTES) {
    const smaller = levels.filter(
      (l) => l.family === target.family && l.error > next.error && l.bytes * GROWTH <= next.bytes && l.bytes > start * 2,
    );
    if (!smaller.length) break;
    next = smaller.reduce((best, l) => (l.error < best.error ? l : best));
    steps.unshift(next);
  }
  return shown ? steps.filter((l) => l === target || l.error < shown.error) : steps;
}

/** What the overlay says of a level at a view. */
export function levelOnScreen(level, view) {
  return { errorPixels: errorPixels(level.error, view), cellPixels: level.cell / unitsPerPixel(view) };
}
