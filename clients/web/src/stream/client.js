/**
 * API v1 over an injected fetch: JSON in and out, every failure a ProtocolError with a sentence. No DOM.
 */

import { ProtocolError, problemFromResponse } from '../protocol/problem.js';
import { Urls } from '../protocol/urls.js';
import { parseLevelHeaders } from '../protocol/headers.js';
import { download } from './download.js';
import { parseManifest, parseModelList } from '../protocol/manifest.js';

const LIST_PAGE = 200;

export class Client {
  /**
   * @param {string} base URL of the daemon's root
   * @param {{fetch?: typeof fetch, token?: () => string|null}} options token: what Authorization: Bearer carries, asked per request
   */
  constructor(base, options = {}) {
    this.urls = new Urls(base);
    this.token = options.token ?? (() => null);
    const given = options.fetch ?? globalThis.fetch;
    this.fetch = (url, init) => given(url, init);
  }

  headers() {
    const token = this.token();
    return token ? { authorization: `Bearer ${token}` } : {};
  }

  /** A 2xx response, or a ProtocolError. An abort stays an AbortError. */
  async request(url, init = {}) {
    let response;
    try {
      response = await this.fetch(url, { ...init, headers: { ...this.headers(), ...init.headers } });
    } catch (cause) {
      if (init.signal?.aborted) throw cause;
      throw new ProtocolError(`No answer from ${new URL(url).host}.`, { kind: 'unreachable', cause });
    }
    if (response.ok) return response;
    const body = await response.text().catch(() => '');
    throw problemFromResponse(response.status, response.headers.get('content-type'), body);
  }

  async json(url, init = {}) {
    const response = await this.request(url, init);
    let text;
    try {
      text = await response.text();
    } catch (cause) {
      if (init.signal?.aborted) throw cause;
      throw new ProtocolError('The connection broke while the answer arrived.', { kind: 'unreachable', cause });
    }
    try {
      return JSON.parse(text);
    } catch (cause) {
      throw new ProtocolError('The answer is not JSON.', { kind: 'malformed', cause });
    }
  }

  /** Every model, all pages. */
  async models(signal) {
    const models = [];
    let after;
    do {
      const page = parseModelList(await this.json(this.urls.models({ limit: LIST_PAGE, after }), { signal }));
      models.push(...page.models);
      if (page.next !== null && page.next === after) break;
      after = page.next ?? undefined;
    } while (after !== undefined);
    return models;
  }

  async manifest(id, signal) {
    return parseManifest(await this.json(this.urls.model(id), { signal, cache: 'no-cache' }));
  }

  async remove(id) {
    await this.request(this.urls.model(id), { method: 'DELETE' });
  }

  job(number, signal) {
    return this.json(this.urls.job(number), { signal, cache: 'no-store' });
  }

  /**
   * A level's bytes and what the response says about them.
   *
   * The level is asked for by its own certified error, so every level has one URL that caches can keep, and the answer is the one with the
   * fewest bytes that keeps this error.
   * onBytes(n): called with the size of every piece as it arrives.
   */
  async level(id, level, { signal, onBytes, hold } = {}) {
    const url = this.urls.level(id, { family: level.family, error: level.error });
    const { bytes, response } = await download((init) => this.request(url, init), { signal, onBytes, hold, expected: level.bytes });
    return { bytes, facts: parseLevelHeaders(response.headers), url: response.url };
  }

  /**
   * The frames of the steps between two levels of a family. A lost connection is taken up where it broke.
   * onGrown(bytes, size): what there is so far, to use frames as they arrive; onRestart: what came so far is worth nothing; hold: see download.
   */
  async delta(id, steps, { signal, onBytes, onGrown, onRestart, expected, hold } = {}) {
    const url = this.urls.delta(id, steps);
    const { bytes } = await download((init) => this.request(url, init), { signal, onBytes, onGrown, onRestart, expected, hold, what: 'a delta' });
    return bytes;
  }

  /** Bytes `from` to `to` - 1 of an object, which never changes: caches may keep any part of it. */
  async part(object, from, to, { signal, onBytes, hold } = {}) {
    const url = this.urls.object(object);
    const { bytes } = await download((init) => this.request(url, init), { signal, onBytes, expected: to - from, range: [from, to], hold, what: 'a part of a delta' });
    return bytes;
  }
}
