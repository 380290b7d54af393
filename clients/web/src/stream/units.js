/**
 * Which units of a step to ask for first, and which bytes. Pure.
 */

/**
 * The patches by what one looks at: those in the picture's middle first, then what else is in the picture, what faces away, and what lies outside.
 *
 * @param {{center: number[], radius: number, normal: number[]}[]} patches
 * @param {number[]} lacking numbers of those to order
 * @param {{eye: number[], direction: number[], halfAngle: number}|null} look in model space; direction: of unit length; halfAngle: of the view's
 *   circumcircle, radians
 */
export function lookOrder(patches, lacking, look) {
  if (!look) return lacking;
  const ranks = new Map(lacking.map((p) => [p, rank(patches[p], look)]));
  return [...lacking].sort((a, b) => ranks.get(a) - ranks.get(b) || a - b);
}

function rank({ center, radius, normal }, { eye, direction, halfAngle }) {
  const to = center.map((x, i) => x - eye[i]);
  const distance = Math.hypot(...to) || 1e-30;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const angle = Math.acos(Math.max(-1, Math.min(1, dot(to, direction) / distance)));
  const half = Math.asin(Math.min(1, radius / distance));
  const outside = distance > radius && angle - half > halfAngle;
  const away = dot(normal, to) / distance > 0.35;
  return (outside ? 10 : 0) + (away ? 5 : 0) + angle;
}

/**
 * The first of `order` up to about `size` bytes, as ranges of bytes; patches that lie side by side share one.
 * @returns {{from: number, to: number, patches: number[]}[]}
 */
export function batches(patches, order, size) {
  const taken = [];
  let bytes = 0;
  for (const p of order) {
    if (taken.length > 0 && bytes + patches[p].bytes > size) break;
    taken.push(p);
    bytes += patches[p].bytes;
  }
  const ranges = [];
  for (const p of taken.sort((a, b) => patches[a].offset - patches[b].offset)) {
    const { offset, bytes: length } = patches[p];
    const last = ranges.at(-1);
    if (last && offset - last.to <= 0) {
      last.to = offset + length;
      last.patches.push(p);
    } else {
      ranges.push({ from: offset, to: offset + length, patches: [p] });
    }
  }
  return ranges;
}
