/**
 * Levels for many objects under one frame budget: as much benefit as the budget allows.
 *
 * Based on: Funkhouser, Sequin. Adaptive Display Algorithm for Interactive Frame Rates During Visualization of Complex Virtual
 * Environments. SIGGRAPH 1993, sections 3 to 6; applied to clustered levels as Low and Tan 1997, section 5, propose.
 *
 * Benefit = size on screen * accuracy * importance * focus * motion * hysteresis; cost is in triangles. Where we differ: accuracy comes from
 * the certified error (1 / (1 + px), so an error of a pixel halves it) and not from a count of polygons, and the greedy choice climbs
 * each object's upper convex hull of (cost, benefit), which keeps the paper's guarantee of at least half the best value.
 */

const HYSTERESIS = 0.1;

/**
 * @param {{levels: {triangles: number, error: number}[], unitsPerPixel: number, pixels: number, importance?: number, focus?: number,
 *          motion?: number, current?: number}[]} objects
 *   levels: any order; pixels: area on screen; focus and motion in (0, 1]: 1 at the centre of the gaze, 1 at rest; current: index drawn now
 * @param {number} budget triangles a frame
 * @returns {{chosen: number[], cost: number, benefit: number}} chosen[i]: index into objects[i].levels, -1 = not drawn
 */
export function scheduleLevels(objects, budget) {
  const hulls = objects.map((object) => benefitHull(object, budget));
  const chosen = objects.map(() => -1);
  const steps = hulls.flatMap((hull, object) =>
    hull.map((point, i) => ({ object, i, point, gain: point.benefit - (hull[i - 1]?.benefit ?? 0), cost: point.cost - (hull[i - 1]?.cost ?? 0) })),
  );
  // Slopes fall along a hull, so this order takes every object's steps from coarse to fine.
  steps.sort((a, b) => b.gain * a.cost - a.gain * b.cost || a.object - b.object || a.i - b.i);
  let cost = 0;
  let benefit = 0;
  const blocked = new Set();
  for (const step of steps) {
    if (blocked.has(step.object)) continue;
    if (cost + step.cost > budget) {
      blocked.add(step.object);
      continue;
    }
    cost += step.cost;
    benefit += step.gain;
    chosen[step.object] = step.point.index;
  }
  return better(hulls, chosen, cost, benefit);
}

/** One valuable object too large for what the greedy choice left over: alone it may be worth more than all of that (the guarantee of one half). */
function better(hulls, chosen, cost, benefit) {
  let best = null;
  hulls.forEach((hull, object) => {
    for (const point of hull) if (point.benefit > (best?.point.benefit ?? benefit)) best = { object, point };
  });
  if (!best) return { chosen, cost, benefit };
  const alone = chosen.map((_, object) => (object === best.object ? best.point.index : -1));
  return { chosen: alone, cost: best.point.cost, benefit: best.point.benefit };
}

/** Levels within the budget on the upper convex hull of (cost, benefit) through the origin, by rising cost: {index, cost, benefit}. */
function benefitHull(object, budget) {
  const weight = object.pixels * (object.importance ?? 1) * (object.focus ?? 1) * (object.motion ?? 1);
  const points = object.levels
    .map((level, index) => {
      const px = level.error / object.unitsPerPixel;
      const hysteresis = object.current === index ? 1 + HYSTERESIS : 1;
      return { index, cost: Math.max(level.triangles, 1), benefit: (weight * hysteresis) / (1 + px) };
    })
    .filter((point) => point.cost <= budget)
    .sort((a, b) => a.cost - b.cost || b.benefit - a.benefit);
  const hull = [];
  for (const point of points) {
    if (hull.length && point.benefit <= hull[hull.length - 1].benefit) continue;
    while (hull.length) {
      const last = hull[hull.length - 1];
      const before = hull[hull.length - 2] ?? { cost: 0, benefit: 0 };
      if ((point.benefit - before.benefit) * (last.cost - before.cost) < (last.benefit - before.benefit) * (point.cost - before.cost)) break;
      hull.pop();
    }
    hull.push(point);
  }
  return hull;
}

/**
 * Triangles a frame that hold a frame rate, learnt from the frames that were drawn.
 *
 * A display waits for its refresh, so a frame's time says how slow it was but not how fast it could have been. Hence no fit of time
 * against triangles: the budget shrinks when frames are late, grows while they are in time, and stays below what failed lately.
 */
export class FrameBudget {
  /** @param {{start?: number, memorySeconds?: number}} options */
  constructor(options = {}) {
    this.triangles = options.start ?? Infinity;
    this.memorySeconds = options.memorySeconds ?? 10;
    this.average = null;
    this.failed = null;
  }

  /**
   * One frame: how many triangles it drew, how long it took, the clock at its end. Returns the budget.
   * seconds over a quarter are a pause, not a slow frame, unless there are several of them.
   */
  add(triangles, seconds, framesPerSecond, now) {
    if (!(seconds > 0)) return this.triangles;
    const target = 1 / framesPerSecond;
    this.average = this.average === null ? seconds : this.average + (Math.min(seconds, 1) - this.average) * 0.2;
    if (this.failed && now - this.failed.at > this.memorySeconds) this.failed = null;
    if (this.average > target * 1.2) {
      this.failed = { triangles, at: now };
      this.triangles = Math.max(1, Math.min(this.triangles, triangles) * Math.max(0.5, (target / this.average) * 0.9));
      this.average = target; // what comes next is measured anew
    } else if (this.triangles !== Infinity) {
      const ceiling = this.failed ? this.failed.triangles * 0.9 : Infinity;
      this.triangles = Math.max(this.triangles, Math.min(this.triangles * 1.05, ceiling));
    }
    return this.triangles;
  }
}
