// Every file of the shared folder of broken models goes through the running daemon with the real worker: it is imported or refused with a
// sentence; nobody crashes and nothing is left behind. Without the shared folder there is nothing to test.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Daemon, build, eventually, root, sleep } from './daemon.mjs';

const folder = path.join(process.env.LODESTREAM_SHARED ?? path.join(root, '../shared'), 'models/invalid');
const files = fs.existsSync(folder) ? list(folder).filter((name) => !name.endsWith('.report.json')) : [];
const print = process.env.LODESTREAM_TEST_TABLE !== undefined; // the whole table, to be read by a person

function list(directory) {
  return fs.readdirSync(directory, { withFileTypes: true }).flatMap((entry) => {
    const name = path.join(directory, entry.name);
    return entry.isDirectory() ? list(name) : [name];
  }).sort();
}

let daemon;
const jobs = new Map(); // file -> how its job ended

before(async () => {
  if (!files.length) return;
  daemon = await Daemon.start({ worker: path.join(build, 'lodestream'), flags: ['--bakes', '2', '--bake-threads', '1', '--bake-seconds', '300'] });
  for (const [i, file] of files.entries()) {
    const target = `/v1/models/m${i}?name=${encodeURIComponent(path.basename(file))}`;
    let response;
    for (;;) {
      response = await daemon.curl(target, ['-T', file]);
      if (response.status !== 503) break; // the queue is full
      await sleep(50);
    }
    jobs.set(file, { id: `m${i}`, status: response.status, body: response.body, location: response.headers.location });
  }
  for (const job of jobs.values()) {
    if (job.status !== 202) job.problem = JSON.parse(job.body);
    else Object.assign(job, await daemon.finished(job.location));
  }
}, { timeout: 400000 });
after(() => daemon?.stop());

const skip = files.length === 0;
test('every broken model is imported or refused with a problem that a person understands', { skip }, () => {
  assert.equal(jobs.size, files.length);
  for (const [file, job] of jobs) {
    const name = path.relative(folder, file);
    if (print) console.log(`${job.state ?? job.status}\t${name}\t${job.problem ? `${job.problem.type}\t${job.problem.detail}` : ''}`);
    if (job.state === 'done') continue;
    const { problem } = job;
    assert.ok(problem, name);
    assert.match(problem.type, /^\/problems\/[a-z0-9-]+$/, name);
    assert.notEqual(problem.type, '/problems/worker-crashed', `${name}: ${problem.detail}`);
    assert.ok([400, 413, 422].includes(problem.status), `${name}: ${JSON.stringify(problem)}`); // never our own fault
    assert.ok(problem.title.length > 3 && problem.detail.length > 20, `${name}: ${JSON.stringify(problem)}`);
    assert.doesNotMatch(problem.detail, /\/tmp|\/proc|[^\x20-\x7e\u00a0-\uffff]/, name);
  }
});

test('what was imported can be asked for, what was refused is not there', { skip }, async () => {
  for (const [file, job] of jobs) {
    const { status } = await daemon.curl(`/v1/models/${job.id}`, ['-I']);
    assert.equal(status, job.state === 'done' ? 200 : 404, file);
    if (job.state === 'done') assert.equal((await daemon.curl(`/v1/models/${job.id}/level?error=1`)).status, 200, file);
  }
});

test('daemon lives, and nothing is left over', { skip }, async () => {
  assert.equal((await daemon.curl('/readyz')).status, 200);
  assert.equal(daemon.child.exitCode, null);
  await eventually('no leftovers', () => ['uploads', 'work'].every((name) => fs.readdirSync(path.join(daemon.store, name)).length === 0));
  assert.doesNotMatch(daemon.log, /signal \d+|Sanitizer|crash/);
  const ends = Object.fromEntries([...String((await daemon.curl('/metrics')).body).matchAll(/^lodestream_worker_ends_total\{cause="(\w+)"\} (\d+)$/gm)].map(([, cause, count]) => [cause, Number(count)]));
  if (print) console.log('workers ended:', JSON.stringify(ends));
  assert.equal(ends.crashed + ends.killed + ends.stopped, 0, JSON.stringify(ends)); // each said itself how it went
  assert.equal(ends.done + ends.failed, [...jobs.values()].filter((job) => job.status === 202).length);
});
