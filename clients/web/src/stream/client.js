/**
 * API v1 over an injected fetch: JSON in and out, every failure a ProtocolError with a sentence. No DOM.
 */

import { ProtocolError, problemFromResponse } from '../protocol/problem.js';
import { Urls } from '../protocol/urls.js';
import { parseLevelHeaders } from '../protocol/headers.js';
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
  async level(id, level, { signal, onBytes = () => {} } = {}) {
    const response = await this.request(this.urls.level(id, { family: level.family, error: level.error }), { signal });
    const facts = parseLevelHeaders(response.headers);
    const bytes = await readBody(response, facts.bytes ?? level.bytes, onBytes, signal);
    return { bytes, facts, url: response.url };
  }
}

/** The whole body as one Uint8Array, told piece by piece. expected: a size to begin with; being wrong only costs a copy. */
async function readBody(response, expected, onBytes, signal) {
  const reader = response.body.getReader();
  let buffer = new Uint8Array(Math.max(expected, 1));
  let size = 0;
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (size + value.length > buffer.length) {
        const larger = new Uint8Array(Math.max(buffer.length * 2, size + value.length));
        larger.set(buffer.subarray(0, size));
        buffer = larger;
      }
      buffer.set(value, size);
      size += value.length;
      onBytes(value.length);
    }
  } catch (cause) {
    if (signal?.aborted) throw cause;
    throw new ProtocolError('The connection broke while a level arrived.', { kind: 'unreachable', cause });
  }
  return size === buffer.length ? buffer : buffer.slice(0, size);
}
