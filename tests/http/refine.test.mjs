// Refinement on demand, with the real worker: answers, caching, bad input, budgets, a full queue, deadlines, clients that go, workers that die.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Daemon, build, eventually } from './daemon.mjs';

const worker = path.join(build, 'lodestream');
const sanitized = build.includes('sanitize');
const slow = sanitized ? 10 : 1;

// A torus as PLY: smooth and closed, one part.
function torus(around, tube) {
  const positions = [];
  const faces = [];
  for (let i = 0; i < around; i++)
    for (let j = 0; j < tube; j++) {
      const a = (2 * Math.PI * i) / around;
      const b = (2 * Math.PI * j) / tube;
      positions.push([(2 + 0.7 * Math.cos(b)) * Math.cos(a), (2 + 0.7 * Math.cos(b)) * Math.sin(a), 0.7 * Math.sin(b)]);
      const at = (x, y) => (x % around) * tube + (y % tube);
      faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
  const head = `ply\nformat ascii 1.0\nelement vertex ${positions.length}\nproperty float x\nproperty float y\nproperty float z\n`;
  return `${head}element face ${faces.length}\nproperty list uchar int vertex_indices\nend_header\n` +
    positions.map((p) => p.join(' ')).join('\n') + '\n' + faces.map((f) => `3 ${f.join(' ')}`).join('\n') + '\n';
}

async function baked(options = {}, model = torus(40, 18)) {
  const daemon = await Daemon.start({ worker, refine: 2, ...options });
  const upload = await daemon.curl('/v1/models/ring', ['-T', '-'], model);
  assert.equal(upload.status, 202, String(upload.body));
  const job = await daemon.finished(upload.headers.location, 180 * slow);
  assert.equal(job.state, 'done', JSON.stringify(job));
  return daemon;
}

// Counts of a GLB's JSON.
function glb(bytes) {
  assert.equal(bytes.subarray(0, 4).toString(), 'glTF');
  assert.equal(bytes.readUInt32LE(8), bytes.length);
  const json = JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12)));
  const primitive = json.meshes[0].primitives[0];
  return { json, triangles: json.accessors[primitive.indices].count / 3, vertices: json.accessors[primitive.attributes.POSITION].count };
}

let daemon;
let levels;
before(async () => {
  daemon = await baked();
  levels = (await daemon.json('/v1/models/ring')).json.families.cluster.levels;
});
after(() => daemon?.stop());

// A level of some hundred triangles, so that what follows is quick.
const base = () => levels.find((level) => level.triangles > 200) ?? levels.at(-1);
const refined = (query, args = []) => daemon.curl(`/v1/models/ring/refine?base=cluster:${base().level}&${query}`, args);

test('three uniform steps are 64 times the base', async () => {
  const { status, headers, body } = await refined('doi=uniform&steps=3');
  assert.equal(status, 200, String(body));
  assert.equal(headers['content-type'], 'model/gltf-binary');
  assert.equal(headers['lod-base'], `cluster:${base().level}`);
  const { triangles, vertices } = glb(body);
  assert.equal(triangles, 64 * Number(headers['lod-base-triangles']));
  assert.equal(triangles, Number(headers['lod-triangles']));
  assert.equal(vertices, Number(headers['lod-vertices']));
  assert.equal(headers['lod-budget'], 'kept');
});

test('every interest answers, and refines less than all', async () => {
  const all = Number((await refined('doi=uniform&steps=3')).headers['lod-triangles']);
  for (const query of ['doi=silhouette&eye=0,0,9', 'doi=silhouette&form=edge&direction=0,1,0', 'doi=silhouette&form=cone&eye=9,0,1',
    'doi=silhouette&form=static&angle=20', 'doi=curvature&angle=12', 'doi=screen&eye=0,3,1&px=2', 'doi=focus&point=2,0,0&falloff=1',
    'doi=gaze&eye=0,0,6&look=2,0,0', 'doi=contact&point=2,0,2', 'doi=patches&threshold=0.5', 'doi=focus,silhouette&combine=product&point=2,0,0&eye=0,0,9',
    'doi=silhouette&eye=0,0,9&scheme=paper', 'doi=silhouette&eye=0,0,9&scheme=sqrt3', 'doi=silhouette&eye=0,0,9&encoding=draco']) {
    const { status, headers, body } = await refined(query);
    assert.equal(status, 200, `${query}: ${body}`);
    const triangles = Number(headers['lod-triangles']);
    assert.ok(triangles > base().triangles / 2 && triangles < all, `${query}: ${triangles} of ${all}`);
    glb(body);
  }
});

test('each object of a focus has its dominance', async () => {
  const count = async (query) => {
    const { status, headers, body } = await refined(`doi=focus&steps=3&falloff=1&${query}`);
    assert.equal(status, 200, String(body));
    return Number(headers['lod-triangles']);
  };
  const both = await count('point=2,0,0;-2,0,0');
  const one = await count('point=2,0,0');
  assert.equal(await count('point=2,0,0;-2,0,0&dominance=1,1'), both);
  assert.equal(await count('point=2,0,0;-2,0,0&dominance=1,0'), one);
  const some = await count('point=2,0,0;-2,0,0&dominance=1,0.5');
  assert.ok(some > one && some < both, `${one} ${some} ${both}`);
  for (const bad of ['1', '1,1,1', '1,2', '1,x', '']) {
    const { status, body } = await refined(`doi=focus&point=2,0,0;-2,0,0&dominance=${bad}`);
    assert.equal(status, 400, bad);
    assert.equal(JSON.parse(body).parameter, 'dominance');
  }
});

test('equal requests have one ETag, are answered from memory, and 304 when the client has them', async () => {
  const first = await refined('doi=silhouette&eye=0,0,7&angle=25');
  const again = await daemon.curl(`/v1/models/ring/refine?angle=25&doi=silhouette&eye=0,0,7&base=cluster:${base().level}`);
  assert.equal(again.headers.etag, first.headers.etag);
  assert.deepEqual(again.body, first.body);
  const other = await refined('doi=silhouette&eye=0,0,7.5&angle=25');
  assert.notEqual(other.headers.etag, first.headers.etag);
  const known = await refined('doi=silhouette&eye=0,0,7&angle=25', ['-H', `If-None-Match: ${first.headers.etag}`]);
  assert.equal(known.status, 304);
  assert.equal(known.body.length, 0);
  const part = await refined('doi=silhouette&eye=0,0,7&angle=25', ['-H', 'Range: bytes=0-3']);
  assert.equal(part.status, 206);
  assert.equal(String(part.body), 'glTF');
});

const metric = async (own, name) => {
  const text = String((await own.curl('/metrics')).body);
  const line = text.split('\n').find((candidate) => candidate.startsWith(`${name} `));
  assert.ok(line, name);
  return Number(line.slice(name.length + 1));
};
const hits = (own, from) => metric(own, `lodestream_refine_hits_total{from="${from}"}`);

test('answers outlive a restart in the store, within their bounds, and go with their model', async () => {
  const store = fs.mkdtempSync(path.join(os.tmpdir(), 'lodestream-refined-'));
  const folder = path.join(store, 'refined');
  let own = await baked({ store });
  try {
    const objects = await metric(own, 'lodestream_store_objects_bytes');
    const ask = (query) => own.curl(`/v1/models/ring/refine?${query}`);
    const first = await ask('doi=silhouette&eye=0,0,8&steps=3');
    assert.equal(first.status, 200, String(first.body));
    await eventually('the answer is written', () => fs.readdirSync(folder).some((name) => name.endsWith('.ring')));
    assert.equal(await metric(own, 'lodestream_store_objects_bytes'), objects, 'an answer is no object');
    await own.stop();
    own = await Daemon.start({ worker, refine: 2, store });
    const again = await ask('steps=3&doi=silhouette&eye=0,0,8');
    assert.deepEqual(again.body, first.body);
    assert.equal(again.headers.etag, first.headers.etag);
    for (const name of ['lod-base', 'lod-base-triangles', 'lod-triangles', 'lod-vertices', 'lod-budget'])
      assert.equal(again.headers[name], first.headers[name], name);
    assert.equal(await hits(own, 'store'), 1);
    assert.equal(await metric(own, 'lodestream_refine_requests_total{outcome="answered"}'), 0, 'no worker was asked');
    await ask('doi=silhouette&eye=0,0,8&steps=3');
    assert.equal(await hits(own, 'memory'), 1);
    await own.stop();
    // A file that is not whole is found out, and made anew.
    const [name] = fs.readdirSync(folder);
    const bytes = fs.readFileSync(path.join(folder, name));
    bytes[100] ^= 1;
    fs.writeFileSync(path.join(folder, name), bytes);
    fs.writeFileSync(path.join(folder, 'stray'), 'x');
    own = await Daemon.start({ worker, refine: 2, store });
    assert.deepEqual((await ask('doi=silhouette&eye=0,0,8&steps=3')).body, first.body);
    assert.equal(await hits(own, 'store'), 0);
    assert.ok(!fs.existsSync(path.join(folder, 'stray')));
    await eventually('the answer is written again', () => fs.readdirSync(folder).includes(name));
    assert.equal((await own.curl('/v1/models/ring', ['-X', 'DELETE'])).status, 204);
    assert.deepEqual(fs.readdirSync(folder), []);
  } finally {
    await own.stop();
    fs.rmSync(store, { recursive: true, force: true });
  }
});

test('the least recently used answers go when the bound is reached', async () => {
  const own = await baked({ flags: ['--refined-bytes', '400KiB'] });
  try {
    for (let i = 0; i < 8; i++) {
      const { status, body } = await own.curl(`/v1/models/ring/refine?doi=uniform&steps=1&crease=${i + 100}`);
      assert.equal(status, 200);
      assert.ok(body.length < 100 * 1024, String(body.length));
    }
    await eventually('all are written', async () => (await metric(own, 'lodestream_refined_files')) > 0 && (await metric(own, 'lodestream_refined_evicted_total')) > 0);
    assert.ok((await metric(own, 'lodestream_refined_bytes')) <= 400 * 1024);
  } finally {
    await own.stop();
  }
});

test('equal requests that are under way are one job, and one that leaves does not take it from the others', async () => {
  const own = await baked({ refine: 1, flags: ['--refine-seconds', String(10 * slow)] });
  try {
    const ask = (args = []) => own.curl('/v1/models/ring/refine?doi=uniform&steps=10&max_triangles=300000', args);
    const answers = await Promise.all([ask(['-m', '0.05']), ask(), ask(), ask()]);
    for (const answer of answers.slice(1)) {
      assert.equal(answer.status, 200, String(answer.body));
      assert.deepEqual(answer.body, answers[1].body);
    }
    assert.ok((await hits(own, 'flight')) >= 2);
    assert.ok((await metric(own, 'lodestream_refine_requests_total{outcome="answered"}')) <= 2);
  } finally {
    await own.stop();
  }
});

test('the same request gives the same bytes whatever its worker did before', async () => {
  const query = 'doi=screen&eye=1,2,4&px=1&max_triangles=5000';
  const first = await refined(query);
  for (let i = 0; i < 6; i++) await refined(`doi=silhouette&eye=${i},0,9`);
  const fresh = await baked();
  try {
    const second = await fresh.curl(`/v1/models/ring/refine?base=cluster:${base().level}&${query}`);
    assert.deepEqual(second.body, first.body);
  } finally {
    await fresh.stop();
  }
});

test('a billion triangles are the budget', async () => {
  const { status, headers } = await refined('doi=uniform&steps=10&max_triangles=20000');
  assert.equal(status, 200);
  assert.equal(headers['lod-budget'], 'reached');
  const triangles = Number(headers['lod-triangles']);
  assert.ok(triangles <= 20000 && triangles > 18000, String(triangles));
  const bytes = await refined('doi=uniform&steps=10&max_bytes=100000');
  assert.ok(bytes.body.length < 110000 && bytes.body.length > 60000, String(bytes.body.length));
});

test('numbers of the client say where', async () => {
  const count = Number((await refined('doi=uniform&steps=0')).headers['lod-base-triangles']);
  const values = Buffer.alloc(4 * count);
  values.writeFloatLE(1, 4 * 10);
  const post = (query, body) => daemon.curl(`/v1/models/ring/refine?base=cluster:${base().level}&${query}`,
    ['-X', 'POST', '-H', 'Content-Type: application/octet-stream', '--data-binary', '@-'], body);
  const { status, headers, body } = await post('doi=attribute&steps=3', values);
  assert.equal(status, 200, String(body));
  const triangles = Number(headers['lod-triangles']);
  assert.ok(triangles >= count + 63 && triangles < count + 400, String(triangles));
  const corners = Buffer.alloc(12 * count);
  for (let i = 0; i < 3; i++) corners.writeFloatLE(1, 4 * (30 + i));
  assert.equal((await post('doi=attribute&steps=3', corners)).status, 200);
  const wrong = await post('doi=attribute', values.subarray(0, 40));
  assert.equal(wrong.status, 400);
  const [triangles3, , corners3, vertices3, positions3] = JSON.parse(wrong.body).detail.match(/takes (.*)/)[1].match(/\d+/g).map(Number)
    .reduce((all, n, i) => (i === 1 ? [...all, 0, n] : [...all, n]), []);
  assert.deepEqual([triangles3, corners3], [count, 3 * count]);
  for (const numbers of new Set([vertices3, positions3])) {
    const byVertex = Buffer.alloc(4 * numbers);
    byVertex.writeFloatLE(1, 4 * 7);
    const answer = await post('doi=attribute&steps=3&per=vertex', byVertex);
    assert.equal(answer.status, 200, String(answer.body));
    const fine = Number(answer.headers['lod-triangles']);
    assert.ok(fine > count + 63 && fine < count + 1000, String(fine));
    assert.equal((await post('doi=attribute&per=triangle', byVertex)).status, 400);
    byVertex.writeFloatLE(1.5, 0);
    assert.match(JSON.parse((await post('doi=attribute&per=vertex', byVertex)).body).detail, /Number 0 of the body is 1.5/);
    byVertex.writeFloatLE(NaN, 0);
    assert.equal((await post('doi=attribute&per=vertex', byVertex)).status, 400);
  }
  assert.equal((await post('doi=attribute&per=smell', values)).status, 400);
  assert.equal((await post('doi=attribute', values.subarray(0, 7))).status, 400);
  assert.equal((await post('doi=uniform', values)).status, 400);
});

test('an interest of the model is carried to its levels', async () => {
  const plain = torus(40, 24).split('\n');
  const first = plain.indexOf('end_header') + 1;
  const marked = plain.slice(first, first + 40 * 24).map((line) => `${line} ${Number(line.split(' ')[0]) > 2 ? 1 : 0}`);
  const own = await baked({}, [...plain.slice(0, 6), 'property float doi', ...plain.slice(6, first), ...marked, ...plain.slice(first + 40 * 24)].join('\n'));
  try {
    const ask = (query) => own.curl(`/v1/models/ring/refine?${query}`);
    const none = await ask('doi=uniform&steps=0');
    const some = await ask('doi=attribute&attribute=doi&steps=2');
    const all = await ask('doi=uniform&steps=2');
    assert.equal(some.status, 200, String(some.body));
    const count = ({ headers }) => Number(headers['lod-triangles']);
    assert.ok(count(some) > 1.5 * count(none) && count(some) < 0.6 * count(all), `${count(none)} ${count(some)} ${count(all)}`);
    const missing = await refined('doi=attribute&attribute=doi');
    assert.equal(missing.status, 400);
    assert.match(JSON.parse(missing.body).detail, /_DOI/);
  } finally {
    await own.stop();
  }
});

test('contact is told as JSON', async () => {
  const { status, json } = await daemon.json('/v1/models/ring/contact?point=2,0,3&steps=4');
  assert.equal(status, 200);
  assert.ok(Math.abs(json.point[0] - 2) < 0.2 && Math.abs(json.point[2] - 0.6) < 0.2, JSON.stringify(json));
  assert.ok(json.normal[2] > 0.9);
  assert.ok(Math.abs(Math.hypot(2 - json.point[0], json.point[1], 3 - json.point[2]) - json.distance) < 1e-6);
});

test('bad requests are 400 and name the parameter', async () => {
  for (const [query, parameter] of [['steps=3', 'doi'], ['doi=smell', 'doi'], ['doi=silhouette', 'eye'], ['doi=silhouette&eye=1,2', 'eye'],
    ['doi=silhouette&direction=0,0,0', 'direction'], ['doi=gaze&eye=0,0,1&look=0,0,1', 'look'], ['doi=uniform&steps=99', 'steps'],
    ['doi=uniform&eye=0,0,1', 'eye'], ['doi=focus&part=bracelet', 'part'], ['doi=uniform&nonsense=1', 'nonsense'],
    ['doi=attribute&attribute=red', 'attribute']]) {
    const { status, body } = await refined(query);
    assert.equal(status, 400, `${query}: ${body}`);
    assert.equal(JSON.parse(body).parameter, parameter, `${query}: ${body}`);
  }
  const unknown = await daemon.curl('/v1/models/ring/refine?doi=uniform&base=cluster:99');
  assert.equal(unknown.status, 400);
  assert.equal(JSON.parse(unknown.body).parameter, 'base');
  assert.equal((await daemon.curl('/v1/models/none/refine?doi=uniform')).status, 404);
  assert.equal((await daemon.curl('/v1/models/ring/contact')).status, 400);
});

test('a worker that dies is replaced and its request gets a clear error', async () => {
  const own = await baked({ refine: 1 });
  try {
    const ticks = (pid) => Number(fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ')[1].split(' ')[11]);
    const children = () => fs.readdirSync(`/proc/${own.child.pid}/task`).flatMap((task) =>
      fs.readFileSync(`/proc/${own.child.pid}/task/${task}/children`, 'utf8').trim().split(' ').filter(Boolean).map(Number));
    assert.equal((await own.curl('/v1/models/ring/refine?doi=uniform&steps=1')).status, 200);
    const before = children();
    assert.equal(before.length, 1);
    // While it is at work: it has used processor time since it was asked.
    const rest = ticks(before[0]);
    const asked = own.curl('/v1/models/ring/refine?doi=uniform&steps=10&max_triangles=400000');
    await eventually('the worker is at work', () => ticks(before[0]) > rest + 2);
    process.kill(before[0], 'SIGKILL');
    const { status, body } = await asked;
    assert.equal(status, 500, String(body));
    assert.match(JSON.parse(body).type, /worker-crashed/);
    // Between requests.
    assert.equal((await own.curl('/v1/models/ring/refine?doi=uniform&steps=2')).status, 200);
    const next = children();
    assert.ok(next.length === 1 && next[0] !== before[0]);
    process.kill(next[0], 'SIGKILL');
    assert.equal((await own.curl('/v1/models/ring/refine?doi=curvature&steps=2')).status, 200);
  } finally {
    await own.stop();
  }
});

test('a full queue says 503 and when to come back; a client that goes cancels; late is 503', async () => {
  const own = await baked({ refine: 1, flags: ['--refine-queue', '1', '--refine-seconds', String(sanitized ? 20 : 2)] });
  try {
    const heavy = (i) => own.curl(`/v1/models/ring/refine?doi=uniform&steps=10&max_triangles=${499000 + i}`, i === 0 ? ['-m', '0.3'] : []);
    const answers = await Promise.all([0, 1, 2, 3, 4, 5].map(heavy));
    const refused = answers.filter((answer) => answer.status === 503);
    assert.ok(refused.length >= 2, JSON.stringify(answers.map((answer) => answer.status)));
    for (const answer of refused) {
      assert.ok(Number(answer.headers['retry-after']) > 0);
      assert.match(JSON.parse(answer.body).type, /queue-full|deadline/);
    }
    // After a client has gone its worker is soon free for the next.
    await Promise.allSettled([heavy(0)]);
    await eventually('an answer after clients that went', async () =>
      (await own.curl('/v1/models/ring/refine?doi=contact&point=2,0,2&steps=2')).status === 200, 60 * slow);
  } finally {
    await own.stop(30);
  }
});

test('a server without workers for it says so', async () => {
  const own = await Daemon.start();
  try {
    const { status, body } = await own.curl('/v1/models/ring/refine?doi=uniform');
    assert.equal(status, 422);
    assert.match(JSON.parse(body).type, /no-refinement/);
  } finally {
    await own.stop();
  }
});
