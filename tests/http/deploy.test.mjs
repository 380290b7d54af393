// What lies in deploy/: nginx in front as a cache, the systemd unit, compose and Kubernetes files. Each part is left out where its tool is not there.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import net from 'node:net';
import path from 'node:path';
import { spawn, spawnSync } from 'node:child_process';
import { test } from 'node:test';
import { Daemon, bunny, curl, eventually, makeDirectory, root, sleep } from './daemon.mjs';
import { sha256 } from './worker.mjs';

const deploy = (name) => fs.readFileSync(path.join(root, 'deploy', name), 'utf8');
const freePort = () => new Promise((resolve) => {
  const server = net.createServer().listen(0, '127.0.0.1', () => {
    const { port } = server.address();
    server.close(() => resolve(port));
  });
});
const nginx = ['/usr/sbin/nginx', '/usr/bin/nginx'].find((file) => fs.existsSync(file));

// deploy/nginx.conf with other addresses and folders, and nothing else changed.
async function startCache(daemon, directory) {
  const port = await freePort();
  const changes = [['server lodestream:8080', `server 127.0.0.1:${daemon.port}`], ['listen 80;', `listen 127.0.0.1:${port};`], ['/var/run/nginx.pid', `${directory}/pid`],
    ['/var/cache/nginx/lodestream', `${directory}/cache`], ['/dev/stderr', `${directory}/error.log`]];
  let text = deploy('nginx.conf');
  for (const [from, to] of changes) {
    assert.ok(text.includes(from), from);
    text = text.replace(from, to);
  }
  text = text.replace('http {', `http {\n${['client_body', 'proxy', 'fastcgi', 'uwsgi', 'scgi'].map((name) => `${name}_temp_path ${directory}/${name};`).join(' ')}`);
  const file = path.join(directory, 'nginx.conf');
  fs.writeFileSync(file, text);
  fs.chmodSync(directory, 0o755);
  const child = spawn(nginx, ['-p', directory, '-c', file, '-g', `daemon off; ${process.getuid() === 0 ? 'user root;' : ''}`], { stdio: ['ignore', 'ignore', 'pipe'] });
  let errors = '';
  child.stderr.on('data', (data) => (errors += data));
  const ended = new Promise((resolve) => child.on('exit', resolve));
  await eventually('nginx answers', async () => {
    assert.equal(child.exitCode, null, errors);
    return (await curl(`http://127.0.0.1:${port}/healthz`)).status === 200;
  });
  return { url: `http://127.0.0.1:${port}`, stop: () => (child.kill('SIGTERM'), ended) };
}

test('nginx in front keeps objects for good, asks again for levels by their tag, and lets writes through', { skip: nginx ? false : 'no nginx here' }, async () => {
  const directory = makeDirectory();
  const daemon = await Daemon.start({ flags: ['--address-connections', '0'] });
  const cache = await startCache(daemon, directory);
  const get = (target, args = []) => curl(cache.url + target, args);
  try {
    const put = await curl(`${cache.url}/v1/models/bunny`, ['-T', '-'], JSON.stringify(bunny));
    assert.equal(put.status, 202);
    await daemon.finished(put.headers.location);
    const { object, bytes } = JSON.parse((await get('/v1/models/bunny')).body).families.cluster.levels[2];
    const target = `/v1/objects/${object}`, asked = () => daemon.metric('lodestream_http_body_sent_bytes_total');

    const first = await get(target);
    assert.equal(first.headers['x-cache'], 'MISS');
    assert.equal(sha256(first.body), object);
    assert.equal(first.headers.etag, `"${object}"`);
    assert.equal(first.headers['cache-control'], 'public, max-age=31536000, immutable');
    const before = await asked();
    for (const args of [[], ['-H', 'Accept-Encoding: gzip']]) {
      const again = await get(target, args);
      assert.equal(again.headers['x-cache'], 'HIT', args.join());
      assert.equal(sha256(again.body), object);
      assert.equal(again.headers.etag, `"${object}"`);
    }
    const part = await get(target, ['-r', '1000-1999']);
    assert.equal(part.status, 206);
    assert.equal(part.headers['content-range'], `bytes 1000-1999/${bytes}`);
    assert.ok(part.body.equals(first.body.subarray(1000, 2000)));
    assert.equal((await get(target, ['-H', `If-None-Match: "${object}"`])).status, 304);
    assert.equal((await get(target, ['-H', 'If-None-Match: "other"'])).status, 200);
    assert.equal((await get(target, ['-I'])).headers['content-length'], String(bytes));
    assert.ok((await asked()) - before < 1e6, 'the daemon was not asked for those bytes again');

    const level = '/v1/models/bunny/level?error=0.1&family=cluster';
    const one = await get(level);
    assert.equal(one.headers['x-cache'], 'MISS');
    assert.equal(one.headers['lod-level'], '1');
    assert.equal((await get(level)).headers['lod-level'], '1'); // kept headers are the reply's
    await sleep(2300); // nginx counts whole seconds
    const later = await get(level);
    assert.equal(later.headers['x-cache'], 'REVALIDATED');
    assert.equal(later.headers.etag, one.headers.etag);
    const replaced = await curl(`${cache.url}/v1/models/bunny`, ['-T', '-'], JSON.stringify({ ...bunny, seed: 77 }));
    await daemon.finished(replaced.headers.location);
    await sleep(2300); // nginx counts whole seconds
    const fresh = await get(level);
    assert.equal(fresh.headers['x-cache'], 'EXPIRED');
    assert.notEqual(fresh.headers.etag, one.headers.etag);

    const zipped = await get('/v1/models/bunny', ['-H', 'Accept-Encoding: gzip']), plain = await get('/v1/models/bunny', ['-H', 'Accept-Encoding: identity']);
    assert.equal(zipped.headers['content-encoding'], 'gzip');
    assert.equal(plain.headers['content-encoding'], undefined);
    assert.equal((await get('/metrics')).status, 404);
    assert.equal((await curl(`${cache.url}/v1/models/bunny`, ['-X', 'DELETE'])).status, 204);
    let refused = 0;
    for (let i = 0; i < 40; i++) refused += (await curl(`${cache.url}/v1/models/x${i}`, ['-X', 'DELETE'])).status === 503;
    assert.ok(refused > 0, 'writes are limited');
    assert.equal((await get(target)).headers['x-cache'], 'HIT'); // reads are not
  } finally {
    await cache.stop();
    await daemon.stop();
    fs.rmSync(directory, { recursive: true, force: true });
  }
});

const analyze = spawnSync('systemd-analyze', ['--version'], { encoding: 'utf8' });
test('systemd understands every line of the unit, and its filter has what a worker needs', { skip: analyze.status === 0 ? false : 'no systemd-analyze here' }, () => {
  const directory = makeDirectory();
  for (const name of ['lodestream.service', 'lodestream.socket'])
    fs.writeFileSync(path.join(directory, name), deploy(`systemd/${name}`).replaceAll('/usr/local/bin/lodestreamd', '/bin/true'));
  const verify = spawnSync('systemd-analyze', ['verify', '--man=no', path.join(directory, 'lodestream.service')], { encoding: 'utf8' });
  fs.rmSync(directory, { recursive: true });
  assert.equal(verify.stderr.split('\n').filter((line) => line.includes('lodestream.service')).join('\n'), '');
  assert.equal(verify.status, 0, verify.stderr);
  // Groups expanded as this systemd has them.
  const expand = (name) => spawnSync('systemd-analyze', ['syscall-filter', name], { encoding: 'utf8' }).stdout.split('\n').slice(1).map((line) => line.trim())
    .filter((line) => line && !line.startsWith('#')).flatMap((line) => (line.startsWith('@') ? expand(line) : [line]));
  const allowed = new Set(/^SystemCallFilter=(.*)$/m.exec(deploy('systemd/lodestream.service'))[1].split(' ').flatMap((word) => (word.startsWith('@') ? expand(word) : [word])));
  for (const call of ['seccomp', 'landlock_create_ruleset', 'landlock_add_rule', 'landlock_restrict_self', 'unshare', 'chroot', 'capset', 'prctl', 'execve', 'sendfile', 'accept4', 'setrlimit', 'close_range', 'mremap', 'linkat', 'sync_file_range'])
    assert.ok(allowed.has(call), call);
});
