/**
 * Follows a job to its end: server-sent events while they flow, polling when they do not (a proxy that buffers, a connection that breaks).
 */

import { EventStreamParser } from '../protocol/events.js';
import { ProtocolError, sentence } from '../protocol/problem.js';

const POLL_SECONDS = [0.25, 0.5, 1, 2];
const FAILURES_MAX = 8;
/** No event for this long, nor a comment (the daemon sends one every 10 s): something on the way holds the stream back. */
const SILENCE_SECONDS = 25;

/**
 * @param {import('./client.js').Client} client
 * @param {string} number
 * @param {{onUpdate?: (job: {state, stage, progress}) => void, signal?: AbortSignal, sleep?: (seconds, signal) => Promise<void>,
 *          silenceSeconds?: number}} options
 * @returns {Promise<object>} the finished job; a failed one throws its problem as a ProtocolError
 */
export async function followJob(client, number, options = {}) {
  const { onUpdate = () => {}, signal, sleep = sleepSeconds, silenceSeconds = SILENCE_SECONDS } = options;
  let last = '';
  const tell = (job) => {
    const text = JSON.stringify(job);
    if (text !== last) onUpdate(job);
    last = text;
    return job.state === 'done' || job.state === 'failed';
  };
  const ended = (await followEvents(client, number, tell, signal, silenceSeconds)) ?? (await poll(client, number, tell, signal, sleep));
  if (ended.state === 'failed') throw failure(ended);
  return ended;
}

/** The job's last state, or null when the stream ended, broke or fell silent before it. */
async function followEvents(client, number, tell, signal, silenceSeconds) {
  const stop = new AbortController();
  const abort = () => stop.abort();
  signal?.addEventListener('abort', abort, { once: true });
  let timer;
  const heard = () => {
    clearTimeout(timer);
    timer = setTimeout(abort, silenceSeconds * 1000);
  };
  try {
    heard();
    const response = await client.request(client.urls.jobEvents(number), {
      signal: stop.signal,
      headers: { accept: 'text/event-stream' },
      cache: 'no-store',
    });
    if (!/^text\/event-stream\b/i.test(response.headers.get('content-type') ?? '')) return null;
    const parser = new EventStreamParser();
    const decoder = new TextDecoder();
    const reader = response.body.getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return null;
      heard();
      for (const { data } of parser.push(decoder.decode(value, { stream: true }))) {
        const job = JSON.parse(data);
        if (tell(job)) return job;
      }
    }
  } catch (error) {
    if (signal?.aborted) throw error;
    if (error instanceof ProtocolError && error.status === 404) throw error;
    return null;
  } finally {
    clearTimeout(timer);
    signal?.removeEventListener('abort', abort);
    stop.abort();
  }
}

async function poll(client, number, tell, signal, sleep) {
  let failures = 0;
  for (let turn = 0; ; turn++) {
    try {
      const job = await client.job(number, signal);
      failures = 0;
      if (tell(job)) return job;
    } catch (error) {
      const lasting = error instanceof ProtocolError && error.kind === 'problem' && error.status < 500 && error.status !== 429;
      if (signal?.aborted || lasting || ++failures >= FAILURES_MAX) throw error;
    }
    await sleep(POLL_SECONDS[Math.min(turn, POLL_SECONDS.length - 1)], signal);
  }
}

function failure(job) {
  const problem = job.problem ?? null;
  const text = problem ? sentence(problem) : 'The server could not make levels of this model.';
  return new ProtocolError(text, { status: problem?.status, type: problem?.type, problem });
}

function sleepSeconds(seconds, signal) {
  return new Promise((resolve, reject) => {
    const end = () => {
      clearTimeout(timer);
      reject(new DOMException('Waiting was cancelled', 'AbortError'));
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener('abort', end);
      resolve();
    }, seconds * 1000);
    signal?.addEventListener('abort', end, { once: true });
  });
}
