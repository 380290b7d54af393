/** clients/web/src/stream with a fake network and a fake clock. */

import assert from 'node:assert/strict';
import { test } from 'node:test';
import * as S from '../../clients/web/src/stream/index.js';
import { errorPixels } from '../../clients/web/src/protocol/index.js';

const turn = () => new Promise((resolve) => setImmediate(resolve));

/** Work that ends when the test says so. */
function deferred() {
  const out = {};
  out.promise = new Promise((resolve, reject) => Object.assign(out, { resolve, reject }));
  return out;
}

// ---- queue ----

test('the queue runs as many as allowed, highest priority first, equal ones in order', async () => {
  const queue = new S.RequestQueue(2);
  const started = [];
  const gates = {};
  const add = (key, priority) => queue.add(key, () => (started.push(key), (gates[key] = deferred()).promise), priority);
  add('a', 0);
  add('b', 0);
  add('c', 1);
  add('d', 5);
  add('e', 1);
  await turn();
  assert.deepEqual(started, ['a', 'b']);
  gates.a.resolve();
  await turn();
  assert.deepEqual(started, ['a', 'b', 'd']);
  queue.setPriority('e', 9);
  gates.b.resolve();
  await turn();
  assert.deepEqual(started, ['a', 'b', 'd', 'e']);
});

test('asking twice is one request; cancelling ends it, frees its place, and its late answer means nothing', async () => {
  const queue = new S.RequestQueue(1);
  const gate = deferred();
  let signal;
  const first = queue.add('a', (s) => ((signal = s), gate.promise));
  assert.equal(queue.add('a', () => assert.fail('ran twice')), first);
  const waiting = queue.add('b', async () => 'b');
  await turn();
  assert.equal(queue.cancel('a'), true);
  assert.equal(signal.aborted, true);
  await assert.rejects(first, { name: 'AbortError' });
  assert.equal(await waiting, 'b');
  const again = queue.add('a', async () => 'new');
  gate.resolve('old');
  assert.equal(await again, 'new');
  assert.equal(queue.running, 0);
  assert.equal(queue.cancel('a'), false);
});

test('a request that fails, even before it waits for anything, rejects and makes room', async () => {
  const queue = new S.RequestQueue(1);
  const bad = queue.add('a', () => {
    throw new Error('no');
  });
  await assert.rejects(bad, /no/);
  assert.equal(await queue.add('b', async () => 1), 1);
});

// ---- cache ----

test('the cache keeps its bound, throws out the least recently used, and spares what is held', () => {
  const gone = [];
  const cache = new S.ByteCache(100, (value) => gone.push(value));
  cache.set('a', 'A', 40);
  cache.set('b', 'B', 40);
  cache.get('a');
  cache.set('c', 'C', 40);
  assert.deepEqual(gone, ['B']);
  cache.hold('a');
  cache.set('d', 'D', 90);
  assert.deepEqual(gone, ['B', 'C']);
  assert.equal(cache.get('a'), 'A');
  cache.release('a');
  assert.deepEqual(gone, ['B', 'C', 'D'], 'what was used last stays');
  assert.equal(cache.bytes, 40);
  cache.set('a', 'A2', 10);
  assert.deepEqual(gone, ['B', 'C', 'D', 'A']);
  cache.clear();
  assert.deepEqual([cache.bytes, cache.size, gone.at(-1)], [0, 0, 'A2']);
});

test('something larger than the whole cache is still usable until the next one comes', () => {
  const cache = new S.ByteCache(10);
  cache.set('big', 1, 100);
  assert.equal(cache.get('big'), 1);
  cache.set('small', 2, 1);
  assert.equal(cache.has('big'), false);
  assert.throws(() => cache.set('x', 1, NaN), RangeError);
});

// ---- choice of a level ----

const level = (n, error, bytes, triangles = bytes / 10) => ({ family: 'cluster', level: n, error, bytes, triangles, edges: 0, points: 0, cell: error * 1.2, object: `o${n}` });
const LADDER = [level(0, 0.32, 1e3), level(1, 0.08, 4e3), level(2, 0.02, 16e3), level(3, 0.005, 64e3), level(4, 0.00125, 256e3), level(5, 0.0003, 1024e3)];
const at = (distance) => ({ distance, fov: 45, height: 800 });

test('a camera that trembles at the border of two levels does not make them flicker', () => {
  const selector = new S.LevelSelector();
  // Where level 3 is exactly at 1 px:
  const border = 0.005 / (2 * Math.tan(Math.PI / 8) / 800);
  let changes = 0;
  let last = selector.select(LADDER, { rule: 'error', limit: 1 }, at(border * 1.01));
  for (let i = 0; i < 200; i++) {
    const now = selector.select(LADDER, { rule: 'error', limit: 1 }, at(border * (1 + 0.1 * Math.sin(i * 2.1))));
    if (now !== last) changes++;
    last = now;
  }
  assert.ok(changes <= 1, `${changes} changes`);
});

test('the tolerance is kept at every distance, going in and coming out', () => {
  const selector = new S.LevelSelector();
  const steps = Array.from({ length: 300 }, (_, i) => 0.5 * 1.03 ** (i < 150 ? 150 - i : i - 150));
  for (const distance of steps) {
    const chosen = selector.select(LADDER, { rule: 'error', limit: 1 }, at(distance));
    assert.ok(errorPixels(chosen.error, at(distance)) <= 1 || chosen === LADDER[5], `at ${distance}`);
  }
});

test('coming out far enough brings the coarser level back', () => {
  const selector = new S.LevelSelector();
  selector.select(LADDER, { rule: 'error', limit: 1 }, at(0.5));
  assert.equal(selector.select(LADDER, { rule: 'error', limit: 1 }, at(1000)).level, 0);
});

test("Low and Tan's rule: the largest cell not over X pixels", () => {
  const selector = new S.LevelSelector();
  const view = at(2);
  const r = (2 * 2 * Math.tan(Math.PI / 8)) / 800;
  for (const x of [1, 5, 10, 40]) {
    selector.reset();
    const chosen = selector.select(LADDER, { rule: 'cell', limit: x }, view);
    const larger = LADDER.filter((l) => l.cell > chosen.cell);
    assert.ok(chosen.cell <= x * r && larger.every((l) => l.cell > x * r), `X = ${x}`);
  }
});

test('a budget of triangles comes before the tolerance', () => {
  const selector = new S.LevelSelector();
  assert.equal(selector.select(LADDER, { rule: 'error', limit: 1, maxTriangles: 2000 }, at(0.5)).level, 2);
  assert.equal(selector.select(LADDER, { rule: 'error', limit: 1, maxTriangles: 1 }, at(0.5)).level, 0);
});

test('steps to a level: coarse first, the target last, all others together at most a fifth of its bytes', () => {
  for (const target of LADDER) {
    const steps = S.refinementSteps(LADDER, null, target);
    assert.equal(steps.at(-1), target);
    for (let i = 1; i < steps.length; i++) assert.ok(steps[i].error < steps[i - 1].error);
    const extra = steps.slice(0, -1).reduce((sum, l) => sum + l.bytes, 0);
    assert.ok(extra <= target.bytes / 5, `${extra} for ${target.bytes}`);
  }
  assert.deepEqual(S.refinementSteps(LADDER, LADDER[4], LADDER[5]), [LADDER[5]]);
  assert.ok(S.refinementSteps(LADDER, null, LADDER[5])[0].bytes <= 24 * 1024, 'something small comes first');
});

// ---- the stream ----

/** A stream whose loads wait for the test: calls[i] = {level, signal, done}. */
function makeStream(options = {}) {
  const calls = [];
  const shown = [];
  const disposed = [];
  const errors = [];
  const timers = [];
  let now = 0;
  const stream = new S.LevelStream({
    load: (l, signal) => {
      const gate = deferred();
      calls.push({ level: l, signal, done: () => gate.resolve({ value: l, bytes: l.bytes }), fail: (e) => gate.reject(e) });
      return gate.promise;
    },
    onShow: (l) => shown.push(l.level),
    dispose: (value) => disposed.push(value.level),
    onError: (error) => errors.push(error.message),
    now: () => now,
    later: (run, seconds) => timers.push({ run, seconds }),
    ...options,
  });
  stream.setLevels(LADDER);
  return { stream, calls, shown, disposed, errors, timers, pass: (seconds) => (now += seconds) };
}
const ONE = { rule: 'error', limit: 1 };

test('a model sharpens: each level shown is finer than the one before, the last is the one that was wanted', async () => {
  const { stream, calls, shown } = makeStream({ concurrency: 1 });
  const wanted = stream.update(ONE, at(0.5));
  await turn();
  for (let i = 0; i < calls.length; i++) {
    await turn();
    calls[i].done();
    await turn();
    stream.update(ONE, at(0.5));
    await turn();
  }
  assert.ok(shown.length >= 2);
  assert.deepEqual(shown, [...shown].sort((a, b) => a - b));
  assert.equal(shown.at(-1), wanted.level);
  assert.equal(stream.settled, true);
});

test('answers that come in the wrong order never make the picture coarser', async () => {
  const { stream, calls, shown } = makeStream({ concurrency: 4 });
  stream.update(ONE, at(0.5));
  await turn();
  assert.ok(calls.length >= 2);
  for (const call of [...calls].reverse()) {
    call.done();
    await turn();
  }
  assert.deepEqual(shown, [stream.wanted.level]);
});

test('zooming out cancels what is no longer useful; zooming in keeps what still helps', async () => {
  const { stream, calls } = makeStream({ concurrency: 1 });
  stream.update(ONE, at(30));
  await turn();
  calls[0].done();
  await turn();
  const first = stream.shown;
  stream.update(ONE, at(2)); // wants a finer one
  await turn();
  const running = calls.at(-1);
  stream.update(ONE, at(0.05)); // wants a still finer one: the running one is on the way
  await turn();
  assert.equal(running.signal.aborted, false);
  stream.update(ONE, at(40)); // back: nothing is wanted
  await turn();
  assert.equal(running.signal.aborted, true);
  assert.equal(stream.shown, first);
  assert.equal(stream.busy, false);
});

test('coming back to a level that was fetched costs no request', async () => {
  const { stream, calls, shown } = makeStream({ concurrency: 8 });
  const visit = async (distance) => {
    stream.update(ONE, at(distance));
    await turn();
    for (const call of calls) call.done();
    await turn();
    stream.update(ONE, at(distance));
    await turn();
  };
  await visit(0.5);
  const fine = stream.shown;
  await visit(1000);
  const requests = calls.length;
  await visit(0.5);
  assert.equal(calls.length, requests);
  assert.equal(stream.shown, fine);
  assert.equal(shown.at(-1), fine.level);
});

test('while the camera moves fast a coarser level is taken from the cache, never from the network', async () => {
  const { stream, calls } = makeStream({ concurrency: 8 });
  stream.update(ONE, at(0.5));
  await turn();
  for (const call of calls) call.done();
  await turn();
  const requests = calls.length;
  const fine = stream.shown;
  stream.update({ rule: 'error', limit: 8 }, at(0.5), true);
  await turn();
  assert.equal(calls.length, requests);
  assert.ok(stream.shown.error >= fine.error);
  stream.update(ONE, at(0.5), false);
  assert.equal(stream.shown, fine);
});

test('a level that fails is asked for again, later each time, and the rest goes on', async () => {
  const { stream, calls, errors, timers, pass } = makeStream({ concurrency: 1 });
  stream.update(ONE, at(1000));
  await turn();
  calls[0].fail(new Error('torn'));
  await turn();
  assert.deepEqual(errors, ['torn']);
  stream.update(ONE, at(1000));
  await turn();
  assert.equal(calls.length, 1, 'not at once');
  pass(0.6);
  timers[0].run();
  await turn();
  assert.equal(calls.length, 2);
  calls[1].fail(new Error('torn again'));
  await turn();
  assert.ok(timers[1].seconds > timers[0].seconds);
  pass(2);
  timers[1].run();
  await turn();
  calls[2].done();
  await turn();
  assert.equal(stream.settled, true);
});

test('closing cancels, frees everything once, and frees what still arrives', async () => {
  const { stream, calls, disposed } = makeStream({ concurrency: 2 });
  stream.update(ONE, at(0.5));
  await turn();
  calls[0].done();
  await turn();
  const late = calls[1];
  stream.close();
  assert.equal(late.signal.aborted, true);
  late.done();
  await turn();
  assert.deepEqual(disposed, [calls[0].level.level]);
  assert.equal(stream.update(ONE, at(1)), null);
});

test('the level that is drawn is not thrown out however small the cache', async () => {
  const { stream, calls, disposed } = makeStream({ concurrency: 8, cacheBytes: 10 });
  stream.update(ONE, at(0.5));
  await turn();
  for (const call of calls) {
    call.done();
    await turn();
  }
  assert.ok(!disposed.includes(stream.shown.level));
  assert.ok(disposed.length > 0);
});

test('a held level stays whatever the view', async () => {
  const { stream, calls } = makeStream({ concurrency: 8 });
  stream.pin(LADDER[1]);
  stream.update(ONE, at(0.1));
  await turn();
  for (const call of calls) call.done();
  await turn();
  stream.update(ONE, at(100));
  assert.equal(stream.shown, LADDER[1]);
  stream.pin(level(9, 1, 1));
  assert.equal(stream.pinned, null, 'a level of another model cannot be held');
});

// ---- motion, frame rate, scheduler ----

test('turning fast makes the tolerance grow, rest brings it back within a second', () => {
  const meter = new S.MotionMeter();
  let t = 0;
  const turnBy = (speed, seconds) => {
    let value;
    for (let i = 0; i < seconds * 60; i++) {
      t += 1 / 60;
      turnBy.angle = (turnBy.angle ?? 0) + speed / 60;
      value = meter.update({ eye: [3 * Math.cos(turnBy.angle), 0, 3 * Math.sin(turnBy.angle)], target: [0, 0, 0] }, t);
    }
    return value;
  };
  assert.equal(S.motionFactor(turnBy(0.1, 1)), 1, 'slow turning stays sharp');
  const speed = turnBy(2, 1);
  assert.ok(Math.abs(speed - 2) < 0.1, `measured ${speed}`);
  assert.ok(S.motionFactor(speed) > 4);
  const resting = turnBy(0, 1);
  assert.equal(S.motionFactor(resting), 1);
  t += 5;
  assert.equal(meter.update({ eye: [3 * Math.cos(turnBy.angle), 0, 3 * Math.sin(turnBy.angle)], target: [0, 0, 0] }, t), 0);
  assert.equal(S.motionFactor(100), 8);
});

test('the frame budget finds what a machine can draw and stays there', () => {
  const budget = new S.FrameBudget();
  const perTriangle = 1 / 30 / 100000; // this machine draws 100,000 triangles in a thirtieth of a second, and waits for a 60 Hz refresh
  const refresh = 1 / 60;
  let triangles = 500000;
  let now = 0;
  const late = [];
  for (let i = 0; i < 900; i++) {
    const seconds = Math.max(1, Math.ceil((triangles * perTriangle) / refresh)) * refresh;
    now += seconds;
    if (i > 300) late.push(seconds > 0.034);
    triangles = Math.min(500000, budget.add(triangles, seconds, 30, now));
  }
  assert.ok(triangles > 50000 && triangles < 101000, `${triangles}`);
  assert.ok(late.filter(Boolean).length / late.length < 0.1, 'nearly all frames in time');
});

test('the scheduler keeps the budget, and large near objects get their triangles first', () => {
  const object = (pixels, extra = {}) => ({ levels: LADDER.map(({ triangles, error }) => ({ triangles, error })), unitsPerPixel: 0.004, pixels, ...extra });
  const near = object(90000);
  const far = object(400);
  for (const budget of [0, 50, 150, 1000, 5000, 20000, 1e6]) {
    const { chosen, cost } = S.scheduleLevels([near, far, near], budget);
    const spent = chosen.reduce((sum, i, k) => sum + (i < 0 ? 0 : [near, far, near][k].levels[i].triangles), 0);
    assert.equal(spent, cost);
    assert.ok(cost <= budget);
    assert.ok(chosen[0] >= chosen[1]);
  }
  assert.deepEqual(S.scheduleLevels([near], 0).chosen, [-1]);
  assert.equal(S.scheduleLevels([near, far], Infinity).chosen[0], 5);
});

test('the scheduler is never worse than half the best choice, against all choices', () => {
  let seed = 7;
  const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const benefit = (o, i) => (i < 0 ? 0 : o.pixels / (1 + o.levels[i].error / o.unitsPerPixel));
  for (let round = 0; round < 200; round++) {
    const objects = Array.from({ length: 3 }, () => ({
      unitsPerPixel: 0.01,
      pixels: 1 + random() * 1000,
      levels: Array.from({ length: 3 }, () => ({ triangles: 1 + Math.floor(random() * 100), error: random() * 0.1 })),
    }));
    const budget = Math.floor(random() * 200);
    let best = 0;
    for (let a = -1; a < 3; a++) for (let b = -1; b < 3; b++) for (let c = -1; c < 3; c++) {
      const pick = [a, b, c];
      const cost = pick.reduce((sum, i, k) => sum + (i < 0 ? 0 : objects[k].levels[i].triangles), 0);
      if (cost <= budget) best = Math.max(best, pick.reduce((sum, i, k) => sum + benefit(objects[k], i), 0));
    }
    const { chosen } = S.scheduleLevels(objects, budget);
    const value = chosen.reduce((sum, i, k) => sum + benefit(objects[k], i), 0);
    assert.ok(value >= best / 2 - 1e-9, `round ${round}: ${value} of ${best}`);
  }
});

// ---- client, upload, jobs ----

const answer = (status, body, headers = {}) => new Response(body, { status, headers });
const jsonAnswer = (value, status = 200) => answer(status, JSON.stringify(value), { 'content-type': 'application/json' });

test('the client follows pages, sends its token, and turns refusals into sentences', async () => {
  const asked = [];
  const client = new S.Client('http://h/p/', {
    token: () => 'secret',
    fetch: async (url, init) => {
      asked.push([url, init.headers.authorization]);
      if (url.includes('after=b')) return jsonAnswer({ models: [{ id: 'c' }], next: null });
      if (url.includes('/v1/models?')) return jsonAnswer({ models: [{ id: 'a' }, { id: 'b' }], next: 'b' });
      return answer(404, '{"detail":"There is no model."}', { 'content-type': 'application/problem+json' });
    },
  });
  assert.deepEqual((await client.models()).map((m) => m.id), ['a', 'b', 'c']);
  assert.deepEqual(asked[0], ['http://h/p/v1/models?limit=200', 'Bearer secret']);
  await assert.rejects(client.manifest('x'), { message: 'There is no model.', status: 404 });
});

test('a server that does not answer, and an answer that is no JSON, are told apart', async () => {
  const down = new S.Client('http://h/', { fetch: async () => { throw new TypeError('failed'); } });
  await assert.rejects(down.models(), { kind: 'unreachable', message: 'No answer from h.' });
  const odd = new S.Client('http://h/', { fetch: async () => answer(200, '<html>') });
  await assert.rejects(odd.models(), { kind: 'malformed' });
});

test('a level arrives whole, in pieces of any size, whatever its length was said to be', async () => {
  const body = Uint8Array.from({ length: 1000 }, (_, i) => i);
  for (const said of ['1000', '10', undefined]) {
    const client = new S.Client('http://h/', {
      fetch: async () => {
        const stream = new ReadableStream({
          start(controller) {
            for (let i = 0; i < 1000; i += 300) controller.enqueue(body.subarray(i, Math.min(1000, i + 300)));
            controller.close();
          },
        });
        return answer(200, stream, { 'lod-level': '2', 'lod-error': '0.5', ...(said ? { 'content-length': said } : {}) });
      },
    });
    let counted = 0;
    const { bytes, facts } = await client.level('m', LADDER[2], { onBytes: (n) => (counted += n) });
    assert.deepEqual(bytes, body);
    assert.deepEqual([counted, facts.level, facts.error], [1000, 2, 0.5]);
  }
});

class FakeRequest {
  static next = null;
  constructor() {
    this.upload = {};
    this.sent = {};
    FakeRequest.last = this;
  }
  open(method, url) {
    Object.assign(this.sent, { method, url });
  }
  setRequestHeader(name, value) {
    this.sent[name] = value;
  }
  getResponseHeader(name) {
    return this.answer.headers?.[name] ?? null;
  }
  abort() {
    this.onabort?.();
    this.onloadend?.();
  }
  send() {
    this.upload.onprogress({ lengthComputable: true, loaded: 5, total: 10 });
    this.answer = FakeRequest.next;
    if (!this.answer) return;
    if (this.answer === 'error') this.onerror();
    else {
      this.status = this.answer.status;
      this.responseText = this.answer.text ?? '';
      this.onload();
    }
    this.onloadend?.();
  }
}

test('an upload tells its progress and names its job, also when only the body does', async () => {
  const client = new S.Client('http://h/p/', { fetch: async () => assert.fail(), token: () => 't' });
  const parts = [];
  FakeRequest.next = { status: 202, headers: { location: '/p/v1/jobs/12' } };
  const options = { XMLHttpRequest: FakeRequest, name: 'a.ply', onProgress: (part) => parts.push(part) };
  assert.equal((await S.upload(client, 'a', new Uint8Array(10), options)).job, '12');
  assert.deepEqual(parts, [0.5]);
  assert.deepEqual([FakeRequest.last.sent.method, FakeRequest.last.sent.url, FakeRequest.last.sent.authorization], ['PUT', 'http://h/p/v1/models/a?name=a.ply', 'Bearer t']);
  FakeRequest.next = { status: 202, text: '{"job":13}' };
  assert.equal((await S.upload(client, 'a', new Uint8Array(1), options)).job, '13');
  FakeRequest.next = { status: 202 };
  await assert.rejects(S.upload(client, 'a', new Uint8Array(1), options), { kind: 'malformed' });
});

test('an upload that is refused, cut or cancelled says so', async () => {
  const client = new S.Client('http://h/', { fetch: async () => assert.fail() });
  FakeRequest.next = { status: 413, headers: { 'content-type': 'application/problem+json' }, text: '{"detail":"Larger than 1 GiB"}' };
  await assert.rejects(S.upload(client, 'a', new Uint8Array(1), { XMLHttpRequest: FakeRequest }), { message: 'Larger than 1 GiB.', status: 413 });
  FakeRequest.next = 'error';
  await assert.rejects(S.upload(client, 'a', new Uint8Array(1), { XMLHttpRequest: FakeRequest }), { kind: 'unreachable' });
  FakeRequest.next = null;
  const stop = new AbortController();
  const running = S.upload(client, 'a', new Uint8Array(1), { XMLHttpRequest: FakeRequest, signal: stop.signal });
  stop.abort();
  await assert.rejects(running, { name: 'AbortError' });
  await assert.rejects(S.upload(client, 'a', new Uint8Array(1), { XMLHttpRequest: FakeRequest, signal: stop.signal }), { name: 'AbortError' });
});

const event = (job) => `event: job\ndata: ${JSON.stringify(job)}\n\n`;
const sleepless = async () => {};

test('a job is followed by its events to the end', async () => {
  const text = event({ state: 'queued', progress: 0 }) + ': still here\n\n' + event({ state: 'running', stage: 'cluster', progress: 0.5 }) + event({ state: 'done', progress: 1 });
  const client = new S.Client('http://h/', { fetch: async () => answer(200, text, { 'content-type': 'text/event-stream' }) });
  const states = [];
  const job = await S.followJob(client, '1', { onUpdate: (j) => states.push(j.state), sleep: sleepless });
  assert.deepEqual(states, ['queued', 'running', 'done']);
  assert.equal(job.progress, 1);
});

test('events that break off or never come are replaced by asking', async () => {
  for (const events of [answer(200, event({ state: 'running' }), { 'content-type': 'text/event-stream' }), answer(200, 'x'), null, 'silent']) {
    let polls = 0;
    const client = new S.Client('http://h/', {
      fetch: async (url, init) => {
        if (!url.endsWith('/events')) return polls++ === 0 ? answer(502, '') : jsonAnswer({ state: polls < 3 ? 'running' : 'done', progress: polls / 3 });
        if (events === null) throw new TypeError('failed');
        if (events !== 'silent') return events;
        return new Promise((_, reject) => init.signal.addEventListener('abort', () => reject(new DOMException('x', 'AbortError'))));
      },
    });
    const job = await S.followJob(client, '1', { sleep: sleepless, silenceSeconds: 0.02 });
    assert.equal(job.state, 'done');
    assert.equal(polls, 3);
  }
});

test('a job that fails throws its problem; a job that is unknown or a caller that leaves ends the wait', async () => {
  const failed = { state: 'failed', problem: { type: '/problems/truncated', status: 400, detail: 'The file ends after 10 of 20 triangles' } };
  const client = new S.Client('http://h/', { fetch: async () => answer(200, event(failed), { 'content-type': 'text/event-stream' }) });
  await assert.rejects(S.followJob(client, '1', { sleep: sleepless }), { message: 'The file ends after 10 of 20 triangles.', type: '/problems/truncated' });
  const none = new S.Client('http://h/', { fetch: async () => answer(404, '') });
  await assert.rejects(S.followJob(none, '1', { sleep: sleepless }), { status: 404 });
  const stop = new AbortController();
  const waiting = new S.Client('http://h/', {
    fetch: (url, init) => new Promise((_, reject) => init.signal.addEventListener('abort', () => reject(new DOMException('x', 'AbortError')))),
  });
  const running = S.followJob(waiting, '1', { signal: stop.signal });
  await turn();
  stop.abort();
  await assert.rejects(running, { name: 'AbortError' });
});
