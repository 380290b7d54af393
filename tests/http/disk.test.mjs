// Disks that fail the daemon, and whether it says so: a store at its quota, folders that may not be written, a file system that an error
// made read-only. Models are served on, the problem has a name, and what can come back by itself does. And /readyz: the truth.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { test } from 'node:test';
import { Daemon, build, bunny, eventually, makeDirectory } from './daemon.mjs';

const recipe = (seed, size = 20000) => JSON.stringify({ seed, families: { cluster: { levels: [{ error: 0.1, triangles: 1000, size }] } } });
const problemOf = (response) => JSON.parse(response.body).type;
const put = (daemon, id, text) => daemon.curl(`/v1/models/${id}`, ['-T', '-'], text);
const ready = (daemon) => daemon.curl('/readyz');
const done = (command, ...args) => spawnSync(command, args, { encoding: 'utf8' });
const checkStore = (store) => spawnSync(path.join(build, 'lodestream'), ['check-store', store], { encoding: 'utf8' });

test('store at its quota refuses the bake by name, keeps the old revision, and takes it when room was made', async () => {
  const daemon = await Daemon.start({ flags: ['--store-bytes', '100000'] });
  try {
    await daemon.bake('a', JSON.parse(recipe(1, 60000)));
    await daemon.bake('b', JSON.parse(recipe(2, 30000)));
    const before = (await daemon.curl('/v1/models/b')).headers.etag;
    const job = await daemon.bake('b', JSON.parse(recipe(3, 50000)));
    assert.equal(job.state, 'failed');
    assert.equal(job.problem.type, '/problems/quota');
    assert.equal(job.problem.status, 507);
    assert.equal((await daemon.curl('/v1/models/b')).headers.etag, before);
    assert.equal((await daemon.curl('/v1/models/b/level?error=1')).status, 200);
    assert.equal((await ready(daemon)).status, 200); // small models still go in
    assert.equal((await daemon.curl('/v1/models/a', ['-X', 'DELETE'])).status, 204);
    assert.equal((await daemon.bake('b', JSON.parse(recipe(3, 50000)))).state, 'done');
  } finally {
    await daemon.stop();
  }
});

test('folders that may not be written are told by name, and uploads are taken again when they may', async (t) => {
  const directory = makeDirectory(), store = path.join(directory, 'store');
  const daemon = await Daemon.start({ store });
  const folders = ['uploads', 'work', 'objects', '.'].map((name) => path.join(store, name));
  const lock = (how) => done('chattr', how, ...folders).status === 0;
  try {
    await daemon.bake('m', bunny);
    if (!lock('+i')) return t.skip('chattr +i is not possible here');
    const notReady = await ready(daemon), refused = await put(daemon, 'n', recipe(5));
    assert.equal(notReady.status, 503);
    assert.equal(problemOf(notReady), '/problems/store-read-only');
    assert.equal(refused.status, 503);
    assert.equal(problemOf(refused), '/problems/store-read-only');
    assert.ok(refused.headers['retry-after']);
    assert.equal((await daemon.curl('/v1/models/m/level?error=1')).status, 200);
    lock('-i');
    await eventually('it is ready again', async () => (await ready(daemon)).status === 200);
    assert.equal((await daemon.finished((await put(daemon, 'n', recipe(5))).headers.location)).state, 'done');
  } finally {
    lock('-i');
    assert.deepEqual(await daemon.stop(), { code: 0, signal: null });
    assert.equal(checkStore(store).status, 0);
    fs.rmSync(directory, { recursive: true });
  }
});

test('disk that fills while a bake writes fails that bake alone', async (t) => {
  const directory = makeDirectory(), store = path.join(directory, 'store');
  fs.mkdirSync(store);
  if (done('mount', '-t', 'tmpfs', '-o', 'size=4m', 'tmpfs', store).status !== 0) return t.skip('mounting is not allowed here');
  const daemon = await Daemon.start({ store, worker: path.join(build, 'lodestream'), flags: ['--families', 'cluster'] });
  const grid = (n) => {
    const lines = ['OFF', `${n * n} ${2 * (n - 1) * (n - 1)} 0`];
    for (let i = 0; i < n * n; i++) lines.push(`${i % n} ${Math.floor(i / n)} ${Math.sin(i) + Math.cos(i * i)}`);
    for (let y = 0; y + 1 < n; y++) for (let x = 0; x + 1 < n; x++) lines.push(`3 ${y * n + x} ${y * n + x + 1} ${y * n + x + n}`, `3 ${y * n + x + 1} ${y * n + x + n + 1} ${y * n + x + n}`);
    return lines.join('\n');
  };
  try {
    assert.equal((await daemon.finished((await put(daemon, 'small', grid(10))).headers.location)).state, 'done');
    const big = grid(240); // 2.6 MB, and levels of more than what is left
    const accepted = await put(daemon, 'big', big);
    if (accepted.status === 202) {
      const job = await daemon.finished(accepted.headers.location);
      assert.equal(job.state, 'failed');
      assert.equal(job.problem.type, '/problems/disk-full', JSON.stringify(job.problem));
      assert.equal(job.problem.status, 507);
    } else {
      assert.equal(accepted.status, 507);
    }
    assert.equal((await daemon.curl('/v1/models/big')).status, 404);
    assert.equal((await daemon.curl('/v1/models/small/level?error=1')).status, 200);
    assert.equal((await daemon.finished((await put(daemon, 'again', grid(12))).headers.location)).state, 'done'); // nothing of the big one is left
    assert.equal((await ready(daemon)).status, 200);
  } finally {
    await daemon.stop();
    assert.equal(checkStore(store).status, 0);
    done('umount', store);
    fs.rmSync(directory, { recursive: true, force: true });
  }
});

// ext4 on a loop device, on which the kernel is told to find an error: it goes read-only under a daemon that has files open for writing,
// and neither statvfs nor a descriptor says so.
test('file system that an error made read-only is told by name; the next start finds all that was acknowledged', async (t) => {
  const directory = makeDirectory(), image = path.join(directory, 'image'), store = path.join(directory, 'store');
  fs.mkdirSync(store);
  fs.closeSync(fs.openSync(image, 'w'));
  fs.truncateSync(image, 64 << 20);
  const mount = () => done('mkfs.ext4', '-q', '-F', image).error === undefined && done('mount', '-o', 'loop,errors=remount-ro', image, store).status === 0;
  if (!mount()) return t.skip('an ext4 image cannot be mounted here');
  let daemon = null;
  try {
    const device = path.basename(done('findmnt', '-no', 'SOURCE', store).stdout.trim()), trigger = `/sys/fs/ext4/${device}/trigger_fs_error`;
    daemon = await Daemon.start({ store });
    await daemon.bake('m', bunny);
    assert.equal((await ready(daemon)).status, 200);
    if (!fs.existsSync(trigger)) return t.skip('this kernel raises no errors on request');
    done('sync');
    fs.writeFileSync(trigger, '1');
    const notReady = await eventually('it is not ready', async () => {
      const response = await ready(daemon);
      return response.status === 503 && response;
    }, 5);
    assert.match(problemOf(notReady), /^\/problems\/store-(read-only|error)$/);
    const refused = await put(daemon, 'n', recipe(5));
    assert.equal(refused.status, 503, String(refused.body));
    assert.equal(problemOf(refused), '/problems/store-read-only');
    assert.notEqual((await daemon.curl('/v1/models/m', ['-X', 'DELETE'])).status, 204);
    assert.equal((await daemon.curl('/v1/models/m/level?error=1')).status, 200);
    await daemon.stop();
    assert.equal(done('umount', store).status, 0);
    done('e2fsck', '-fy', image);
    assert.equal(done('mount', '-o', 'loop', image, store).status, 0);
    assert.equal(checkStore(store).status, 0, checkStore(store).stdout);
    daemon = await Daemon.start({ store });
    assert.equal((await ready(daemon)).status, 200);
    assert.equal((await daemon.curl('/v1/models/m/level?error=1')).status, 200);
    assert.equal((await daemon.finished((await put(daemon, 'n', recipe(5))).headers.location)).state, 'done');
  } finally {
    await daemon?.stop();
    done('umount', store);
    fs.rmSync(directory, { recursive: true, force: true });
  }
});

test('daemon whose workers cannot enter their jail is not ready, and says what fails', async () => {
  process.env.LODESTREAM_JAIL = 'dungeon';
  const daemon = await Daemon.start({ worker: path.join(build, 'lodestream') });
  delete process.env.LODESTREAM_JAIL;
  const answer = await ready(daemon);
  assert.equal(answer.status, 503);
  assert.equal(problemOf(answer), '/problems/jail-strategy');
  assert.equal((await daemon.curl('/healthz')).status, 200); // it lives
  await daemon.stop();
  const caged = await Daemon.start({ worker: path.join(build, 'lodestream') });
  assert.equal((await ready(caged)).status, 200);
  await caged.stop();
  process.env.LODESTREAM_JAIL = 'none';
  const free = await Daemon.start({ worker: path.join(build, 'lodestream') });
  delete process.env.LODESTREAM_JAIL;
  assert.equal((await ready(free)).status, 200);
  assert.match(free.log, /WITHOUT A JAIL/);
  await free.stop();
});
