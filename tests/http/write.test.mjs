// Writing: uploads, jobs and their events, replacing and deleting, the token.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Daemon, bunny, eventually, sleep } from './daemon.mjs';

const limit = 1 << 20;
let daemon;

before(async () => {
  daemon = await Daemon.start({ flags: ['--upload-bytes', String(limit), '--bake-queue', '2'] });
});
after(() => daemon?.stop());

// Files that uploads would leave behind.
const leftovers = () => ['uploads', 'work'].flatMap((name) => fs.readdirSync(path.join(daemon.store, name)));
const problemOf = (response) => JSON.parse(response.body);

test('upload is accepted with its job, and the model is there when the job is done', async () => {
  const response = await daemon.curl('/v1/models/one', ['-T', '-', '-H', 'Content-Disposition: attachment; filename="dir/one.ply"'], JSON.stringify(bunny));
  assert.equal(response.status, 202);
  const { job, id } = JSON.parse(response.body);
  assert.equal(id, 'one');
  assert.equal(response.headers.location, `/v1/jobs/${job}`);
  const ended = await daemon.finished(response.headers.location);
  assert.equal(ended.state, 'done');
  assert.equal(ended.progress, 1);
  assert.ok(ended.finished >= ended.created);
  const { status, json } = await daemon.json('/v1/models/one');
  assert.equal(status, 200);
  assert.equal(json.source.name, 'one.ply');
});

test('upload with a length and upload in chunks are the same', async () => {
  const text = JSON.stringify(bunny);
  const file = path.join(daemon.directory, 'recipe.json');
  fs.writeFileSync(file, text);
  const known = await daemon.curl('/v1/models/known?name=k.ply', ['-T', file]);
  assert.equal(known.status, 202);
  await daemon.finished(known.headers.location);
  await daemon.bake('chunked', bunny, ['-H', 'Transfer-Encoding: chunked']);
  const hash = async (id) => (await daemon.json(`/v1/models/${id}`)).json.source.sha256;
  assert.equal(await hash('known'), await hash('chunked'));
  assert.equal((await daemon.json('/v1/models/known')).json.source.name, 'k.ply');
});

test('body over the limit is refused by its length, before it is sent', async () => {
  const socket = await daemon.connect();
  socket.write(`PUT /v1/models/big HTTP/1.1\r\nHost: x\r\nContent-Length: ${limit + 1}\r\nExpect: 100-continue\r\n\r\n`);
  await eventually('an answer', () => socket.text.includes('\r\n\r\n'));
  assert.match(socket.text, /^HTTP\/1\.1 413 /);
  await socket.closed_;
});

test('refusal reaches a client that sends its body without waiting', async () => {
  const file = path.join(daemon.directory, 'big.bin');
  fs.writeFileSync(file, Buffer.alloc(8 * limit, 1));
  for (let i = 0; i < 5; i++) {
    const response = await daemon.curl('/v1/models/big', ['-T', file, '-H', 'Expect:']);
    assert.equal(response.status, 413, response.errors);
    assert.equal(problemOf(response).type, '/problems/upload-too-large');
  }
});

test('chunked body over the limit is refused while it arrives', async () => {
  const file = path.join(daemon.directory, 'big.bin');
  for (let i = 0; i < 5; i++) {
    const response = await daemon.curl('/v1/models/big', ['-T', file, '-H', 'Transfer-Encoding: chunked', '-H', 'Expect:']);
    assert.equal(response.status, 413, response.errors);
    assert.equal(response.headers['access-control-allow-origin'], '*');
    assert.equal(problemOf(response).type, '/problems/upload-too-large');
  }
  const exact = await daemon.curl('/v1/models/exact', ['-T', '-'], Buffer.alloc(limit, 0x20));
  assert.equal(exact.status, 202);
  await daemon.finished(exact.headers.location);
});

test('upload cut short changes nothing and leaves nothing', async () => {
  await daemon.bake('short', bunny);
  const before = await daemon.json('/v1/models/short');
  const jobs = await daemon.metric('lodestream_jobs_done_total');
  for (const head of [`Content-Length: 100000`, 'Transfer-Encoding: chunked']) {
    const socket = await daemon.connect();
    socket.write(`PUT /v1/models/short HTTP/1.1\r\nHost: x\r\n${head}\r\n\r\n`);
    socket.write(head.startsWith('T') ? `64\r\n${'x'.repeat(100)}\r\n` : 'x'.repeat(5000));
    await sleep(100);
    socket.destroy();
  }
  await eventually('the connections are gone', async () => (await daemon.metric('lodestream_http_connections')) === 1);
  const afterwards = await daemon.json('/v1/models/short');
  assert.equal(afterwards.headers.etag, before.headers.etag);
  assert.equal(await daemon.metric('lodestream_jobs_done_total'), jobs);
  assert.equal(await daemon.metric('lodestream_jobs_queued'), 0);
  assert.deepEqual(leftovers(), []);
});

test('wrong uploads are refused by name', async () => {
  const put = (target) => daemon.curl(target, ['-T', '-'], 'x');
  for (const [target, parameter] of [['/v1/models/.x', 'id'], ['/v1/models/a%2Fb', 'id'], [`/v1/models/${'x'.repeat(129)}`, 'id'],
    ['/v1/models/x?format=../x', 'format'], ['/v1/models/x?formta=ply', 'formta']]) {
    const response = await put(target);
    assert.equal(response.status, 400, target);
    assert.equal(problemOf(response).parameter, parameter, target);
  }
  const empty = await daemon.curl('/v1/models/x', ['-X', 'PUT', '-H', 'Content-Length: 0']);
  assert.equal(empty.status, 400);
  assert.equal(problemOf(empty).type, '/problems/empty-body');
});

test('failed, crashed and lying bakes fail their job and nothing else', async () => {
  await daemon.bake('steady', bunny);
  const before = (await daemon.json('/v1/models/steady')).headers.etag;
  const expected = { fail: /face 7/, crash: /./, lie: /./ };
  for (const [behave, detail] of Object.entries(expected)) {
    const job = await daemon.bake('steady', { ...bunny, behave });
    assert.equal(job.state, 'failed', behave);
    assert.match(job.problem.type, /^\/problems\/[a-z0-9-]+$/);
    assert.match(job.problem.detail, detail);
    assert.equal((await daemon.json('/v1/models/steady')).headers.etag, before);
    assert.equal((await daemon.curl('/v1/models/steady/level?error=1')).status, 200);
  }
  assert.equal((await daemon.bake('steady', bunny)).state, 'done');
  assert.deepEqual(leftovers(), []);
});

test('hung bake fails its job when its time is over', async () => {
  const impatient = await Daemon.start({ flags: ['--bake-seconds', '1'] });
  try {
    const job = await impatient.bake('hung', { ...bunny, behave: 'hang' });
    assert.equal(job.state, 'failed');
    assert.match(job.problem.detail, /./);
    assert.equal((await impatient.curl('/v1/models/hung')).status, 404);
    for (const name of ['uploads', 'work']) assert.deepEqual(fs.readdirSync(path.join(impatient.store, name)), []);
  } finally {
    await impatient.stop();
  }
});

test('events tell each change once and end with the job', async () => {
  const response = await daemon.curl('/v1/models/eventful', ['-T', '-'], JSON.stringify({ ...bunny, steps: 4, step_ms: 150 }));
  const events = await daemon.curl(`${response.headers.location}/events`, ['-N']);
  assert.equal(events.status, 200);
  assert.equal(events.exit, 0, events.errors);
  assert.equal(events.headers['content-type'], 'text/event-stream');
  assert.equal(events.headers['cache-control'], 'no-store');
  const seen = String(events.body).split('\n').filter((line) => line.startsWith('data: ')).map((line) => JSON.parse(line.slice(6)));
  assert.ok(seen.length >= 4, JSON.stringify(seen));
  assert.equal(seen.at(-1).state, 'done');
  assert.ok(seen.some((job) => job.state === 'running' && job.stage === 'step-2'));
  for (let i = 1; i < seen.length; i++) {
    assert.ok(seen[i].progress >= seen[i - 1].progress);
    assert.notDeepEqual(seen[i], seen[i - 1]);
  }
  const late = await daemon.curl(`${response.headers.location}/events`);
  assert.equal(String(late.body).match(/^data: /gm).length, 1);
});

// Looking once a second would see one step a second, however slow the machine is.
test('events arrive at once, not at the next tick', async () => {
  const steps = 30;
  const began = performance.now();
  const response = await daemon.curl('/v1/models/prompt', ['-T', '-'], JSON.stringify({ ...bunny, steps, step_ms: 100 }));
  const { body } = await daemon.curl(`${response.headers.location}/events`);
  const seconds = (performance.now() - began) / 1000, seen = new Set(String(body).match(/step-\d+/g)).size;
  assert.ok(seen > Math.min(seconds + 4, steps - 5), `${seen} of ${steps} steps in ${seconds} s`);
  await daemon.finished(response.headers.location);
});

test('listener that goes away is noticed', async () => {
  const response = await daemon.curl('/v1/models/gone', ['-T', '-'], JSON.stringify({ ...bunny, behave: 'hang' }));
  const sockets = await Promise.all(Array.from({ length: 8 }, () => daemon.connect()));
  for (const socket of sockets) socket.write(`GET ${response.headers.location}/events HTTP/1.1\r\nHost: x\r\n\r\n`);
  await eventually('eight streams', async () => (await daemon.metric('lodestream_http_event_streams')) === 8);
  for (const socket of sockets) socket.destroy();
  await eventually('no stream', async () => (await daemon.metric('lodestream_http_event_streams')) === 0);
  assert.equal((await daemon.curl('/v1/models/gone', ['-X', 'DELETE'])).status, 204); // ends the bake
  await daemon.finished(response.headers.location);
});

test('full queue is told before the body is sent', async () => {
  const hang = JSON.stringify({ ...bunny, behave: 'hang' });
  const jobs = [];
  for (let i = 0; i < 3; i++) {
    const response = await daemon.curl(`/v1/models/queue${i}`, ['-T', '-'], hang);
    assert.equal(response.status, 202);
    jobs.push(response.headers.location);
    if (i === 0) await eventually('the first runs', async () => (await daemon.json(jobs[0])).json.state === 'running');
  }
  const refused = await daemon.curl('/v1/models/queue3', ['-T', '-'], hang);
  assert.equal(refused.status, 503);
  assert.equal(problemOf(refused).type, '/problems/queue-full');
  assert.ok(Number(refused.headers['retry-after']) > 0);
  for (const [i, job] of jobs.entries()) {
    assert.equal((await daemon.curl(`/v1/models/queue${i}`, ['-X', 'DELETE'])).status, 204);
    await daemon.finished(job);
  }
});

test('old revision serves until the new one is whole', async () => {
  await daemon.bake('replaced', { ...bunny, seed: 300 });
  const before = await daemon.curl('/v1/models/replaced/level?error=0.1&family=cluster');
  const put = await daemon.curl('/v1/models/replaced', ['-T', '-'], JSON.stringify({ ...bunny, seed: 350, steps: 3, step_ms: 150 }));
  let same = 0;
  for (let state = ''; state !== 'done';) {
    ({ state } = (await daemon.json(put.headers.location)).json);
    assert.notEqual(state, 'failed');
    const now = await daemon.curl('/v1/models/replaced/level?error=0.1&family=cluster');
    assert.equal(now.status, 200);
    same += now.headers.etag === before.headers.etag;
  }
  assert.ok(same > 0);
  const replaced = await daemon.curl('/v1/models/replaced/level?error=0.1&family=cluster', ['-H', `If-None-Match: ${before.headers.etag}`]);
  assert.equal(replaced.status, 200);
  assert.notEqual(replaced.headers.etag, before.headers.etag);
  await eventually('the old object goes', async () => (await daemon.curl(before.headers['content-location'])).status === 404);
});

test('preconditions guard changes', async () => {
  await daemon.bake('guarded', bunny);
  const { headers } = await daemon.curl('/v1/models/guarded', ['--compressed']);
  const put = (condition) => daemon.curl('/v1/models/guarded', ['-T', '-', '-H', condition], JSON.stringify(bunny));
  assert.equal((await put('If-None-Match: *')).status, 412);
  assert.equal((await put('If-Match: "other"')).status, 412);
  assert.equal((await daemon.curl('/v1/models/guarded', ['-X', 'DELETE', '-H', 'If-Match: "other"'])).status, 412);
  const good = await put(`If-Match: ${headers.etag}`);
  assert.equal(good.status, 202);
  await daemon.finished(good.headers.location);
});

test('deleted model and its objects are gone', async () => {
  await daemon.bake('doomed', { ...bunny, seed: 900 });
  const { json } = await daemon.json('/v1/models/doomed');
  const { object } = json.families.cluster.levels[0];
  assert.equal((await daemon.curl(`/v1/objects/${object}`)).status, 200);
  assert.equal((await daemon.curl('/v1/models/doomed', ['-X', 'DELETE'])).status, 204);
  assert.equal((await daemon.curl('/v1/models/doomed')).status, 404);
  await eventually('the object goes', async () => (await daemon.curl(`/v1/objects/${object}`)).status === 404);
  assert.equal(fs.existsSync(path.join(daemon.store, 'objects', object.slice(0, 2), object)), false);
  assert.equal((await daemon.curl('/v1/models/doomed', ['-X', 'DELETE'])).status, 404);
});

test('an upload that still bakes does not bring a deleted model back', async () => {
  const slow = { ...bunny, seed: 901, steps: 25, step_ms: 100 };
  const { headers } = await daemon.curl('/v1/models/undone', ['-T', '-'], JSON.stringify(slow));
  await eventually('the bake runs', async () => (await daemon.json(headers.location)).json.state === 'running');
  await daemon.curl('/v1/models/undone', ['-X', 'DELETE']);
  const { json } = await daemon.json(headers.location);
  assert.equal(json.state, 'failed');
  assert.match(json.problem.type, /cancelled/);
  assert.equal((await daemon.curl('/v1/models/undone')).status, 404);
});

test('with a token only its holder changes anything, and anyone reads', async () => {
  const file = path.join(daemon.directory, 'token');
  fs.writeFileSync(file, 'correct horse\n');
  const guarded = await Daemon.start({ flags: ['--token-file', file] });
  try {
    const put = (args) => guarded.curl('/v1/models/m', ['-T', '-', ...args], JSON.stringify(bunny));
    for (const args of [[], ['-H', 'Authorization: Bearer wrong'], ['-H', 'Authorization: Basic Y29ycmVjdA=='], ['-H', 'Authorization: Bearer correct horse x']]) {
      const response = await put(args);
      assert.equal(response.status, 401);
      assert.match(response.headers['www-authenticate'], /^Bearer realm="lodestream"/);
      assert.equal(problemOf(response).type, '/problems/unauthorized');
    }
    assert.equal((await guarded.curl('/v1/models/m', ['-X', 'DELETE'])).status, 401);
    const good = await put(['-H', 'Authorization: Bearer correct horse']);
    assert.equal(good.status, 202);
    await guarded.finished(good.headers.location);
    assert.equal((await guarded.curl('/v1/models/m')).status, 200);
    assert.equal((await guarded.curl('/v1/models/m', ['-X', 'DELETE', '-H', 'Authorization: Bearer correct horse'])).status, 204);
  } finally {
    await guarded.stop();
  }
});
