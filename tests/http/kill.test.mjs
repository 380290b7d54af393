// The whole daemon dies by kill -9 at random moments while models are put, replaced, deleted, baked, collected and read, its start
// included. Afterwards, what was acknowledged is what is found, every object is what its name says, and the store is sound.
// LODESTREAM_TEST_DAEMON_KILLS=200 is the long form.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import { createHash } from 'node:crypto';
import { spawnSync } from 'node:child_process';
import { test } from 'node:test';
import { Daemon, build, eventually, makeDirectory, sleep } from './daemon.mjs';

const kills = Number(process.env.LODESTREAM_TEST_DAEMON_KILLS ?? 5);
const WRITERS = 4, MODELS = 3; // of each writer
const SETTLED = 3; // of all kills, every so many are followed by an orderly stop and a look at a store that must be clean

const sha256 = (bytes) => createHash('sha256').update(bytes).digest('hex');
let seed = Number(process.env.LODESTREAM_TEST_SEED ?? 20261130);
function random() { // the same kills in each run, as far as the machine allows
  seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
  return seed / 2 ** 32;
}

// A bumpy sheet in one of six shapes: uploads differ, their levels' objects are shared between models and revisions.
let serial = 0;
function makeUpload() {
  const shape = Math.floor(random() * 6), n = 4 + 3 * shape;
  const lines = ['ply', 'format ascii 1.0', `comment upload ${serial++}`, `element vertex ${n * n}`, 'property float x', 'property float y', 'property float z',
    `element face ${2 * (n - 1) * (n - 1)}`, 'property list uchar int vertex_indices', 'end_header'];
  for (let i = 0; i < n * n; i++) lines.push(`${i % n} ${Math.floor(i / n)} ${((i * i * 7 + shape) % 11) / 20}`);
  for (let y = 0; y + 1 < n; y++)
    for (let x = 0; x + 1 < n; x++) {
      const a = y * n + x;
      lines.push(`3 ${a} ${a + 1} ${a + n}`, `3 ${a + 1} ${a + n + 1} ${a + n}`);
    }
  return Buffer.from(`${lines.join('\n')}\n`);
}

function request(agent, daemon, method, target, body = null) {
  return new Promise((resolve, reject) => {
    const outgoing = http.request({ agent, host: '127.0.0.1', port: daemon.port, method, path: target, timeout: 120000,
      headers: body ? { 'Content-Length': body.length } : {} }, (incoming) => {
      const chunks = [];
      incoming.on('data', (chunk) => chunks.push(chunk));
      incoming.on('error', reject);
      incoming.on('end', () => (incoming.complete ? resolve({ status: incoming.statusCode, headers: incoming.headers, body: Buffer.concat(chunks) }) : reject(new Error('cut'))));
    });
    outgoing.on('timeout', () => outgoing.destroy(new Error('no answer in 120 s')));
    outgoing.on('error', reject);
    outgoing.end(body);
  });
}

// What is known of one model: `now` holds the digests that it may have (null: it may be absent); more than one only while a request whose
// answer was lost hangs over it.
class Model {
  constructor(id) {
    this.id = id;
    this.now = [null];
    this.jobs = []; // acknowledged since the last look
  }
}

let rounds = 0;
const totals = { put: 0, deleted: 0, lost: 0, reads: 0, refused: 0 };

// Writes until the daemon is gone. Every request to a model waits for the one before, so their order is known.
async function write(agent, daemon, models, state) {
  while (!state.dead) {
    const model = models[Math.floor(random() * models.length)];
    const upload = random() < 0.75 ? makeUpload() : null;
    const digest = upload ? sha256(upload) : null;
    try {
      const answer = await request(agent, daemon, upload ? 'PUT' : 'DELETE', `/v1/models/${model.id}`, upload);
      if (answer.status === 202) {
        model.now = [digest];
        model.jobs.push({ digest, location: answer.headers.location });
        totals.put++;
      } else if (answer.status === 204 || (answer.status === 404 && !upload)) {
        // A model whose first bake had not ended was not there yet: the answer is 404, and its jobs are cancelled all the same.
        model.now = [null];
        model.jobs = [];
        totals.deleted++;
      } else {
        assert.equal(answer.status, 503, String(answer.body)); // the queue is full: nothing was taken
        totals.refused++;
        await sleep(20);
      }
    } catch (error) {
      if (error instanceof assert.AssertionError) throw error;
      assert.ok(await state.died, `the daemon did not die, and yet: ${error.message}`);
      if (!model.now.includes(digest)) model.now.push(digest);
      totals.lost++;
      return;
    }
  }
}

// Reads what there is: whatever a reader gets has the bytes that its name says.
async function read(agent, daemon, models, state) {
  while (!state.dead) {
    try {
      const answer = await request(agent, daemon, 'GET', `/v1/models/${models[Math.floor(random() * models.length)].id}`);
      if (answer.status !== 200) continue;
      for (const { object } of Object.values(JSON.parse(answer.body).families)[0].levels) {
        const got = await request(agent, daemon, 'GET', `/v1/objects/${object}`);
        assert.ok(got.status === 200 || got.status === 404); // replaced meanwhile
        if (got.status === 200) assert.equal(sha256(got.body), object);
        totals.reads++;
      }
    } catch (error) {
      if (error instanceof assert.AssertionError) throw error;
      assert.ok(await state.died, `the daemon did not die, and yet: ${error.message}`);
      return;
    }
  }
}

// Processes of the worker program that have a file of this store open.
function workersOf(store) {
  return fs.readdirSync('/proc').filter((name) => /^\d+$/.test(name)).filter((pid) => {
    try {
      if (fs.readlinkSync(`/proc/${pid}/exe`) !== fs.realpathSync(path.join(build, 'lodestream'))) return false;
      return fs.readdirSync(`/proc/${pid}/fd`).some((fd) => fs.readlinkSync(`/proc/${pid}/fd/${fd}`).startsWith(store));
    } catch {
      return false; // ended meanwhile
    }
  });
}

function checkStore(store) {
  const { status, stdout, stderr } = spawnSync(path.join(build, 'lodestream'), ['check-store', store], { encoding: 'utf8' });
  assert.equal(stderr, '');
  const found = /(\d+) damaged, (\d+) missing, (\d+) models not whole, (\d+) stray files, (\d+) lost uploads/.exec(stdout);
  assert.ok(found, stdout);
  const [, damaged, missing, broken, stray, lost] = found.map(Number);
  return { status, stdout, damaged, missing, broken, stray, lost };
}

const listOf = (store, name) => fs.readdirSync(path.join(store, name));

// The daemon has no work left: what is found is what was acknowledged. Afterwards nothing is uncertain any more.
async function compare(agent, daemon, models) {
  await eventually('all jobs have ended', async () => (await daemon.metric('lodestream_jobs_queued')) + (await daemon.metric('lodestream_jobs_running')) === 0, 600);
  for (const model of models) {
    const answer = await request(agent, daemon, 'GET', `/v1/models/${model.id}`);
    const manifest = answer.status === 200 ? JSON.parse(answer.body) : null;
    const found = manifest ? manifest.source.sha256 : null;
    const jobs = [];
    for (const job of model.jobs) jobs.push({ ...job, job: JSON.parse((await request(agent, daemon, 'GET', job.location)).body) });
    assert.ok(model.now.includes(found), `${model.id} is ${found}, acknowledged was one of ${model.now}; ${JSON.stringify(jobs)}`);
    for (const { digest, job } of jobs) {
      assert.equal(job.id, model.id);
      if (digest === found) assert.equal(job.state, 'done', JSON.stringify(job));
      else assert.ok(job.state === 'done' || /cancelled|superseded/.test(job.problem.type), JSON.stringify(job));
    }
    for (const { object, bytes } of manifest ? Object.values(manifest.families).flatMap((family) => family.levels) : []) {
      const { status, body } = await request(agent, daemon, 'GET', `/v1/objects/${object}`);
      assert.equal(status, 200);
      assert.equal(body.length, bytes);
      assert.equal(sha256(body), object);
    }
    model.now = [found];
    model.jobs = [];
  }
}

const start = (store) => Daemon.start({ store, worker: path.join(build, 'lodestream'), later: 'envelope',
  flags: ['--families', 'cluster', '--bakes', '2', '--bake-threads', '1', '--bake-queue', '8', '--address-connections', '0'] });

async function kill(daemon, store) {
  daemon.child.kill('SIGKILL');
  assert.deepEqual(await daemon.exited, { code: null, signal: 'SIGKILL' });
  fs.rmSync(daemon.directory, { recursive: true, force: true });
  assert.doesNotMatch(daemon.log, /Sanitizer|runtime error/);
  await eventually('no worker outlives its daemon', () => workersOf(store).length === 0);
}

// Loads the daemon until it is killed, at a random moment.
async function loadAndKill(daemon, store, models, agent) {
  const state = { dead: false };
  state.died = daemon.exited.then(() => (state.dead = true));
  const before = totals.put;
  const clients = Array.from({ length: WRITERS }, (_, i) => write(agent, daemon, models.slice(i * MODELS, (i + 1) * MODELS), state));
  clients.push(read(agent, daemon, models, state), read(agent, daemon, models, state));
  await Promise.race([sleep(20 + random() ** 2 * 800), ...clients]);
  if (before < 3 * rounds++) // a machine too slow for its share of work before the kill
    await eventually('some uploads are acknowledged', () => state.dead || totals.put > before + 3);
  await kill(daemon, store);
  await Promise.all(clients);
}

test(`${kills} kills of the daemon at random moments lose nothing that was acknowledged`, { timeout: 600000 + kills * 20000 }, async () => {
  const directory = makeDirectory();
  const store = path.join(directory, 'store');
  const models = Array.from({ length: WRITERS * MODELS }, (_, i) => new Model(`m${i}`));
  const agent = new http.Agent({ keepAlive: true });
  let daemon = await start(store), stray = 0, restarts = 0;
  for (let done = 0; done < kills;) {
    await loadAndKill(daemon, store, models, agent);
    done++;
    const raw = checkStore(store); // before anything is recovered: files that nothing names yet, and no other flaw
    assert.deepEqual({ ...raw, status: 0, stdout: '', stray: 0 }, { status: 0, stdout: '', damaged: 0, missing: 0, broken: 0, stray: 0, lost: 0 }, raw.stdout);
    stray += raw.stray;
    daemon = await start(store);
    if (done < kills && random() < 0.4) { // while it recovers
      await sleep(random() * 200);
      await kill(daemon, store);
      done++;
      restarts++;
      daemon = await start(store);
    }
    await compare(agent, daemon, models);
    if (done % SETTLED && done < kills) continue;
    assert.deepEqual(await daemon.stop(), { code: 0, signal: null });
    const clean = checkStore(store);
    assert.equal(clean.status, 0, clean.stdout);
    assert.deepEqual([listOf(store, 'uploads'), listOf(store, 'work')], [[], []]);
    if (done < kills) daemon = await start(store);
  }
  agent.destroy();
  fs.rmSync(directory, { recursive: true });
  console.log(`${kills} kills (${restarts} during recovery): ${totals.put} uploads and ${totals.deleted} deletes acknowledged, ${totals.lost} requests without an answer, ` +
    `${totals.refused} refused by a full queue, ${totals.reads} objects read under load; ${stray} files without a name found after the kills and swept`);
  assert.ok(totals.put > 2 * (rounds - 1) && totals.lost > rounds / 2, 'the kills did hit work');
});
