/**
 * Every URL of API v1 (see /v1/openapi.json), beneath a base that may carry a path prefix: a daemon at https://host/models/ behind a
 * proxy has the base "https://host/models/". Pure: no fetch, no DOM.
 */

/** Ways to choose a level, in the order in which they are written. Exactly one of error, px, maxBytes, maxTriangles, rule is given. */
const LEVEL_QUERY = [
  ['family', 'family'],
  ['error', 'error'],
  ['px', 'px'],
  ['rule', 'rule'],
  ['x', 'x'],
  ['distance', 'distance'],
  ['fov', 'fov'],
  ['height', 'height'],
  ['maxBytes', 'max_bytes'],
  ['maxTriangles', 'max_triangles'],
];

export class Urls {
  /** @param {string|URL} base absolute URL of the daemon's root; a missing final slash is added, query and fragment are dropped */
  constructor(base) {
    const url = new URL(base);
    if (url.protocol !== 'http:' && url.protocol !== 'https:') throw new TypeError(`base must be http or https, not ${url.protocol}`);
    url.search = '';
    url.hash = '';
    if (!url.pathname.endsWith('/')) url.pathname += '/';
    this.base = url.href;
  }

  health() {
    return `${this.base}healthz`;
  }

  ready() {
    return `${this.base}readyz`;
  }

  metrics() {
    return `${this.base}metrics`;
  }

  openapi() {
    return `${this.base}v1/openapi.json`;
  }

  viewer() {
    return this.base;
  }

  /** @param {{limit?: number, after?: string}} page */
  models(page = {}) {
    return `${this.base}v1/models${query([
      ['limit', page.limit],
      ['after', page.after],
    ])}`;
  }

  model(id) {
    return `${this.base}v1/models/${encodeURIComponent(id)}`;
  }

  /** Where to PUT a model's bytes. name: of the file, for messages; format: names an importer instead of sniffing. */
  upload(id, options = {}) {
    return `${this.model(id)}${query([
      ['name', options.name],
      ['format', options.format],
    ])}`;
  }

  /**
   * @param {string} id
   * @param {{family?: string, error?: number, px?: number, distance?: number, fov?: number, height?: number, rule?: string, x?: number,
   *          maxBytes?: number, maxTriangles?: number}} choice
   */
  level(id, choice = {}) {
    return `${this.model(id)}/level${query(LEVEL_QUERY.map(([key, name]) => [name, choice[key]]))}`;
  }

  /**
   * The steps from level `from` to `to` of a family. Without `from`, a first picture comes first.
   * @param {string} id
   * @param {{family?: string, from?: number, to?: number}} steps
   */
  delta(id, steps = {}) {
    return `${this.model(id)}/delta${query([
      ['family', steps.family],
      ['from', steps.from],
      ['to', steps.to],
    ])}`;
  }

  object(sha256) {
    return `${this.base}v1/objects/${encodeURIComponent(sha256)}`;
  }

  job(number) {
    return `${this.base}v1/jobs/${encodeURIComponent(number)}`;
  }

  jobEvents(number) {
    return `${this.job(number)}/events`;
  }
}

/** "?a=1&b=2" without the pairs whose value is undefined or null; "" when none is left. */
function query(pairs) {
  const parts = [];
  for (const [name, value] of pairs) {
    if (value === undefined || value === null) continue;
    if (typeof value === 'number' && !Number.isFinite(value)) throw new TypeError(`${name} must be a finite number`);
    parts.push(`${name}=${encodeURIComponent(String(value))}`);
  }
  return parts.length ? `?${parts.join('&')}` : '';
}
