/**
 * Pixels and model units, and the choice of a level: the same formulas and the same tie rules as core/level/screen.h, so that client
 * and server choose alike.
 *
 * view: {distance, fov, height} - eye to the bounding sphere's surface (model units, > 0), vertical field of view (degrees, in
 * (0, 180)), height of the window (pixels, > 0).
 */

/** Model units per pixel at that distance: R = 2 D tan(fov/2) / height (Low & Tan 1997, section 4). */
export function unitsPerPixel(view) {
  return (2 * view.distance * Math.tan((view.fov * Math.PI) / 360)) / view.height;
}

/** Size on screen of an error in model units. */
export function errorPixels(error, view) {
  return error / unitsPerPixel(view);
}

/** The error in model units that is `px` pixels on screen. */
export function errorUnits(px, view) {
  return px * unitsPerPixel(view);
}

/** Eye to the sphere's surface, never below `near`: inside the sphere the nearest surface may be anywhere in front of the eye. */
export function viewDistance(eye, sphere, near) {
  const d = Math.hypot(eye[0] - sphere.center[0], eye[1] - sphere.center[1], eye[2] - sphere.center[2]) - sphere.radius;
  return Math.max(d, near);
}

/**
 * How levels are measured against a limit. A level fits when `measured` is not over the limit; among those that fit the least of `order` wins, and
 * when none fits the least of `fallback`.
 */
const RULES = {
  error: { measured: (l) => l.error, order: (l) => l.bytes, fallback: (l) => l.error },
  bytes: { measured: (l) => l.bytes, order: (l) => l.error, fallback: (l) => l.bytes },
  triangles: { measured: (l) => l.triangles, order: (l) => l.error, fallback: (l) => l.triangles },
  cell: { measured: (l) => l.cell, order: (l) => -l.cell, fallback: (l) => l.error },
};

/**
 * Index of the level to draw. Ties: fewer bytes, then less error, then the earlier one.
 *
 * levels: {error, bytes, triangles, cell} each, at least one, any order. rule: "error", "bytes", "triangles", or "cell" (the largest
 * cell not over the limit; levels without a cell take no part unless none has one). Returns {index, fits}.
 */
export function selectLevel(levels, rule, limit) {
  const { measured, order, fallback } = RULES[rule];
  let candidates = levels.map((_, i) => i);
  if (rule === 'cell' && levels.some((l) => l.cell > 0)) candidates = candidates.filter((i) => levels[i].cell > 0);
  const fitting = candidates.filter((i) => measured(levels[i]) <= limit);
  const key = fitting.length ? order : fallback;
  const better = (a, b) => key(a) - key(b) || a.bytes - b.bytes || a.error - b.error;
  const from = fitting.length ? fitting : candidates;
  let best = from[0];
  for (const i of from) if (better(levels[i], levels[best]) < 0) best = i;
  return { index: best, fits: fitting.length > 0 };
}
