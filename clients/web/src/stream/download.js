/**
 * A body that survives a lost connection: what has come is kept, and the rest is asked for with Range. Pure: requests, clock and sleep are injected.
 */

import { ProtocolError } from '../protocol/problem.js';

const WAIT_SECONDS = [0.25, 0.5, 1, 2, 4];

/**
 * @param {(init: {signal?: AbortSignal, headers?: object}) => Promise<Response>} request asks for the body, with these headers besides its own
 * @param {{signal?: AbortSignal, expected?: number, onBytes?: (n: number) => void, onGrown?: (bytes: Uint8Array, size: number) => void|Promise<void>,
 *          onRestart?: () => void, range?: [number, number], hold?: () => Promise<void>|null, what?: string, sleep?: (seconds: number) => Promise<void>}} options
 *   expected: a size to begin with; being wrong only costs a copy. onGrown: what there is so far, the first `size` of `bytes`. onRestart: what
 *   came is worth nothing, since the body has changed meanwhile. range: of the body, only these bytes, the last one not included. hold: asked
 *   before each piece; while its promise is open nothing is read, so the server stops sending too
 * @returns {Promise<{bytes: Uint8Array, response: Response}>} response: the first one
 */
export async function download(request, options = {}) {
  const { signal, onBytes = () => {}, onGrown, onRestart = () => {}, range = null, hold = () => null, what = 'a level', sleep = sleepSeconds } = options;
  await hold();
  const first = await request({ signal, headers: rangeHeader(range, 0) });
  let etag = first.headers.get('etag');
  const body = new Growing(options.expected ?? (Number(first.headers.get('content-length')) || 0));
  let response = first;
  for (let tries = 0; ; ) {
    const before = body.size;
    try {
      await readInto(body, response, { onBytes, onGrown, hold, signal });
      return { bytes: cut(body.take(), response, range), response: first };
    } catch (cause) {
      if (signal?.aborted) throw cause;
      if (!(cause instanceof BrokenError)) throw cause;
      tries = body.size > before ? 0 : tries + 1;
      if (!etag || etag.startsWith('W/') || tries >= WAIT_SECONDS.length) {
        throw new ProtocolError(`The connection broke while ${what} arrived.`, { kind: 'unreachable', cause: cause.cause });
      }
    }
    response = await again(request, { signal, tries, size: body.size, range, sleep });
    const same = response.headers.get('etag') === etag;
    if (response.status === 206 && same) continue;
    body.size = 0;
    onRestart();
    if (response.status === 206) response = await again(request, { signal, tries, size: 0, range, sleep });
    etag = response.headers.get('etag');
  }
}

/** The rest of the body. No answer is as good as a broken one, for a while. */
async function again(request, { signal, tries, size, range, sleep }) {
  for (let turn = tries; ; turn++) {
    await sleep(WAIT_SECONDS[Math.min(turn, WAIT_SECONDS.length - 1)]);
    signal?.throwIfAborted();
    try {
      return await request({ signal, headers: rangeHeader(range, size) });
    } catch (error) {
      if (signal?.aborted || error.kind !== 'unreachable' || turn + 1 >= WAIT_SECONDS.length) throw error;
    }
  }
}

/** What lacks when `size` bytes of the range (null: of all) have come. */
function rangeHeader(range, size) {
  if (range) return { range: `bytes=${range[0] + size}-${range[1] - 1}` };
  return size > 0 ? { range: `bytes=${size}-` } : {};
}

/** A server without ranges sends all of it. */
function cut(bytes, response, range) {
  return range && response.status === 200 ? bytes.slice(range[0], range[1]) : bytes;
}

class BrokenError extends Error {}

async function readInto(body, response, { onBytes, onGrown, hold, signal }) {
  const reader = response.body.getReader();
  for (;;) {
    let piece;
    await hold();
    signal?.throwIfAborted();
    try {
      piece = await reader.read();
    } catch (cause) {
      throw new BrokenError('broken', { cause });
    }
    if (piece.done) return;
    body.add(piece.value);
    onBytes(piece.value.length);
    await onGrown?.(body.buffer, body.size);
  }
}

class Growing {
  constructor(expected) {
    this.buffer = new Uint8Array(Math.max(expected, 1));
    this.size = 0;
  }

  add(piece) {
    if (this.size + piece.length > this.buffer.length) {
      const larger = new Uint8Array(Math.max(this.buffer.length * 2, this.size + piece.length));
      larger.set(this.buffer.subarray(0, this.size));
      this.buffer = larger;
    }
    this.buffer.set(piece, this.size);
    this.size += piece.length;
  }

  take() {
    return this.size === this.buffer.length ? this.buffer : this.buffer.slice(0, this.size);
  }
}

function sleepSeconds(seconds) {
  return new Promise((resolve) => setTimeout(resolve, seconds * 1000));
}
