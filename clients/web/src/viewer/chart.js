/** The levels as dots: bytes to the right, certified error upwards, both logarithmic. A dot can be chosen to hold its level. */

import { formatBytes, formatUnits } from './format.js';

const SVG = 'http://www.w3.org/2000/svg';
const BOX = { left: 34, right: 258, top: 8, bottom: 124 };

export class Chart {
  /** @param {SVGElement} svg @param {{onPick: (level) => void}} options */
  constructor(svg, options) {
    this.svg = svg;
    this.options = options;
    this.levels = [];
    this.dots = new Map();
  }

  /** levels: of one family or several */
  setLevels(levels) {
    this.levels = levels;
    this.trail = null;
    this.dots.clear();
    this.svg.replaceChildren();
    if (!levels.length) return;
    const x = scale(levels.map((l) => l.bytes), BOX.left + 8, BOX.right - 8);
    const y = scale(levels.map((l) => l.error).filter((e) => e > 0), BOX.bottom - 8, BOX.top + 8);
    this.x = x;
    this.y = y;
    // An exact level has no place on a logarithmic axis: it lies on the bottom line.
    const place = (l) => [x(l.bytes), l.error > 0 ? y(l.error) : BOX.bottom];
    this.line('axis', BOX.left, BOX.bottom, BOX.right, BOX.bottom);
    this.line('axis', BOX.left, BOX.top, BOX.left, BOX.bottom);
    this.labels(x, y);
    this.limitLine = this.line('limit', BOX.left, 0, BOX.right, 0);
    this.limitText = this.text('', BOX.right, 0, 'end', 'limit-text');
    for (const family of new Set(levels.map((l) => l.family))) {
      const own = levels.filter((l) => l.family === family).sort((a, b) => a.bytes - b.bytes || a.error - b.error);
      // A level that needs more bytes than a better one of its family is a dot off the line.
      let best = Infinity;
      const front = own.filter((l) => l.error < best && ((best = l.error), true));
      this.add(this.svg, 'polyline', { class: 'path', points: front.map((l) => place(l).join(',')).join(' ') });
    }
    this.trail = this.add(this.svg, 'polyline', { class: 'trail' });
    for (const level of levels) this.dot(level, place(level));
  }

  /** What has been drawn so far: certified error after so many bytes of everything that came, as steps. trail: [{bytes, error}] in order. */
  trace(trail) {
    if (!this.trail) return;
    const corners = [];
    const clampX = (v) => Math.min(BOX.right, Math.max(BOX.left, v));
    for (const { bytes, error } of trail) {
      const at = [clampX(this.x(Math.max(bytes, 1))), error > 0 ? Math.min(BOX.bottom, Math.max(BOX.top, this.y(error))) : BOX.bottom];
      if (corners.length) corners.push([at[0], corners[corners.length - 1][1]]);
      corners.push(at);
    }
    const text = corners.map((c) => c.map((v) => v.toFixed(1)).join(',')).join(' ');
    if (this.trail.getAttribute('points') !== text) this.trail.setAttribute('points', text);
  }

  labels(x, y) {
    const bytes = this.levels.map((l) => l.bytes);
    const errors = this.levels.map((l) => l.error).filter((e) => e > 0);
    const [least, most] = ends(bytes);
    if (most === undefined) {
      this.text(formatBytes(least), x(least), BOX.bottom + 14, 'middle');
    } else {
      this.text(formatBytes(least), x(least) - 4, BOX.bottom + 14, 'start');
      this.text('bytes', (BOX.left + BOX.right) / 2, BOX.bottom + 14, 'middle');
      this.text(formatBytes(most), x(most) + 4, BOX.bottom + 14, 'end');
    }
    for (const value of ends(errors)) this.text(shortUnits(value), BOX.left - 4, y(value) + 3, 'end');
  }

  dot(level, [cx, cy]) {
    const group = this.add(this.svg, 'g', { class: 'dot', tabindex: '0', role: 'button' });
    this.add(group, 'circle', { class: 'hit', cx, cy, r: 11 });
    this.add(group, 'circle', { class: 'mark', cx, cy, r: 3.5 });
    const words = `${level.family} level ${level.level}: ${formatBytes(level.bytes)}, error ${formatUnits(level.error)}, ${level.triangles.toLocaleString('en')} triangles`;
    this.add(group, 'title', {}).textContent = words;
    group.setAttribute('aria-label', `Hold ${words}`);
    group.addEventListener('click', () => this.options.onPick(level));
    group.addEventListener('keydown', (event) => {
      if (event.key !== 'Enter' && event.key !== ' ') return;
      event.preventDefault();
      this.options.onPick(level);
    });
    this.dots.set(level, group);
  }

  /** limit: the tolerance in model units at this view, or null; text: what it is called */
  mark(current, pinned, limit, text) {
    for (const [level, group] of this.dots) {
      group.classList.toggle('current', level === current);
      group.classList.toggle('pinned', level === pinned);
      group.setAttribute('aria-pressed', String(level === pinned));
      if (level === current) group.setAttribute('aria-current', 'true');
      else group.removeAttribute('aria-current');
    }
    if (!this.limitLine) return;
    const shown = limit !== null && limit > 0 && Number.isFinite(limit);
    const at = shown ? Math.min(BOX.bottom, Math.max(BOX.top, this.y(limit))) : 0;
    for (const element of [this.limitLine, this.limitText]) element.toggleAttribute('hidden', !shown);
    this.limitLine.style.display = this.limitText.style.display = shown ? '' : 'none';
    this.limitLine.setAttribute('y1', at);
    this.limitLine.setAttribute('y2', at);
    this.limitText.setAttribute('y', at < BOX.top + 14 ? at + 11 : at - 4);
    this.limitText.textContent = text;
  }

  line(name, x1, y1, x2, y2) {
    return this.add(this.svg, 'line', { class: name, x1, y1, x2, y2 });
  }

  text(words, x, y, anchor, name = '') {
    const element = this.add(this.svg, 'text', { x, y, 'text-anchor': anchor, class: name });
    element.textContent = words;
    return element;
  }

  add(parent, name, attributes) {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    parent.append(element);
    return element;
  }
}

/** At most six letters, which is what the margin holds. */
function shortUnits(value) {
  const text = formatUnits(value);
  return text.length <= 6 ? text : value.toExponential(1).replace('e+', 'e');
}

function ends(values) {
  const low = Math.min(...values);
  const high = Math.max(...values);
  if (!Number.isFinite(low)) return [];
  return low === high ? [low] : [low, high];
}

/** Logarithmic; the middle when all values are one. */
function scale(values, from, to) {
  const [low, high = low] = ends(values);
  if (low === undefined || low === high) return () => (from + to) / 2;
  const span = Math.log(high) - Math.log(low);
  return (value) => from + ((Math.log(value) - Math.log(low)) / span) * (to - from);
}
