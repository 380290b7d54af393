// What operators do: tokens with rights, settings read again, sockets and news from a service manager, stores checked and full disks mended.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { createHash } from 'node:crypto';
import { execFileSync, spawn, spawnSync } from 'node:child_process';
import { test } from 'node:test';
import { Daemon, build, bunny, curl, eventually, makeDirectory, recipeWorker, sleep } from './daemon.mjs';

const sha256 = (text) => createHash('sha256').update(text).digest('hex');
const recipe = JSON.stringify(bunny);
const problemOf = (response) => JSON.parse(response.body).type;

test('tokens have rights: their models, what they may do, and so many bytes a day', async () => {
  const directory = makeDirectory();
  const file = path.join(directory, 'tokens');
  fs.writeFileSync(file, `# name digest rights
admin sha256:${sha256('all')}
alice sha256:${sha256('hers')} models=alice-*,shared may=write
small sha256:${sha256('few')}  bytes-per-day=${recipe.length + 10}\n`);
  const daemon = await Daemon.start({ flags: ['--token-file', file, '--log', 'json'] });
  const put = (id, token, args = []) => daemon.curl(`/v1/models/${id}`, ['-T', '-', '-H', `Authorization: Bearer ${token}`, ...args], recipe);
  const remove = (id, token) => daemon.curl(`/v1/models/${id}`, ['-X', 'DELETE', '-H', `Authorization: Bearer ${token}`]);
  try {
    assert.equal((await put('x', 'wrong')).status, 401);
    assert.equal((await daemon.curl('/v1/models/x', ['-T', '-'], recipe)).status, 401);
    const forbidden = await put('bob-1', 'hers');
    assert.equal(forbidden.status, 403);
    assert.equal(problemOf(forbidden), '/problems/forbidden');
    assert.match(forbidden.headers['www-authenticate'], /insufficient_scope/);
    assert.equal((await put('alic', 'hers')).status, 403);
    for (const id of ['alice-1', 'shared']) await daemon.finished((await put(id, 'hers')).headers.location);
    assert.equal((await remove('alice-1', 'hers')).status, 403);
    assert.equal((await remove('alice-1', 'all')).status, 204);
    const first = await put('s', 'few');
    assert.equal(first.status, 202);
    await daemon.finished(first.headers.location);
    for (const args of [[], ['-H', 'Transfer-Encoding: chunked']]) {
      const more = await put('s', 'few', args);
      assert.equal(more.status, 429, more.errors);
      assert.equal(problemOf(more), '/problems/upload-quota');
      assert.ok(Number(more.headers['retry-after']) > 80000);
    }
    await eventually('the audit lines', () => (daemon.log.match(/"audit":/g) ?? []).length >= 11);
    const audits = daemon.log.split('\n').filter((line) => line.includes('"audit"')).map((line) => JSON.parse(line));
    assert.ok(audits.some((a) => a.audit === 'DELETE' && a.model === 'alice-1' && a.token === 'admin' && a.status === 204));
    assert.ok(audits.some((a) => a.audit === 'PUT' && a.model === 'bob-1' && a.token === 'alice' && a.status === 403 && a.request));
    assert.ok(audits.some((a) => a.audit === 'PUT' && a.token === '' && a.status === 401));
    assert.doesNotMatch(daemon.log, /hers|"few"/); // no token in a log
  } finally {
    await daemon.stop();
    fs.rmSync(directory, { recursive: true });
  }
});

test('made token is good with the line made for it, and a wrong file is refused with its line', async () => {
  const directory = makeDirectory();
  const file = path.join(directory, 'tokens');
  const text = execFileSync(path.join(build, 'lodestreamd'), ['--make-token', 'ci'], { encoding: 'utf8' });
  const [, token, , line] = text.split('\n');
  assert.match(token, /^[0-9a-f]{64}$/);
  fs.writeFileSync(file, `${line}\n`);
  const daemon = await Daemon.start({ flags: ['--token-file', file] });
  assert.equal((await daemon.curl('/v1/models/m', ['-T', '-', '-H', `Authorization: Bearer ${token}`], recipe)).status, 202);
  await daemon.stop();
  for (const [wrong, what] of [['a sha256:12\n', /line 1/], [`a sha256:${'0'.repeat(64)}\nb sha256:${'0'.repeat(64)} may=fly\n`, /line 2.*may=fly/], ['# none\n', /no token/]]) {
    fs.writeFileSync(file, wrong);
    await assert.rejects(Daemon.start({ flags: ['--token-file', file] }), what);
  }
  fs.rmSync(directory, { recursive: true });
});

test('SIGHUP reads settings, tokens and certificate again, and keeps the old ones when anything is wrong', async () => {
  const directory = makeDirectory();
  const config = path.join(directory, 'lodestream.conf');
  const tokens = path.join(directory, 'tokens');
  const files = { certificate: path.join(directory, 'cert.pem'), key: path.join(directory, 'key.pem') };
  const make = (name) => execFileSync('openssl', ['req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:prime256v1', '-nodes', '-days', '2',
    '-subj', `/CN=${name}`, '-keyout', files.key, '-out', files.certificate], { stdio: 'ignore' });
  make('first');
  fs.writeFileSync(tokens, 'first token\n');
  fs.writeFileSync(config, `token-file = ${tokens}\nupload-bytes = 1000000\n`);
  const daemon = await Daemon.start({ flags: ['--config', config, '--tls-cert', files.certificate, '--tls-key', files.key] });
  const put = (token, args = []) => daemon.curl('/v1/models/m', ['-k', '-T', '-', '-H', `Authorization: Bearer ${token}`, ...args], recipe);
  const subject = () => execFileSync('sh', ['-c', `openssl s_client -connect 127.0.0.1:${daemon.port} </dev/null 2>/dev/null | openssl x509 -noout -subject`], { encoding: 'utf8' });
  const reload = async (pattern) => {
    const from = daemon.log.length;
    daemon.child.kill('SIGHUP');
    await eventually(`the log says ${pattern}`, () => pattern.test(daemon.log.slice(from)));
  };
  try {
    assert.match(subject(), /first/);
    assert.equal((await put('first token')).status, 202);
    const kept = await daemon.connect(); // an idle connection lives on
    make('second');
    fs.writeFileSync(tokens, 'second token\n');
    fs.writeFileSync(config, `token-file = ${tokens}\nupload-bytes = 100\nloops = 7\ncors = none\n`);
    await reload(/settings were read again/);
    assert.match(daemon.log, /next start: loops/);
    assert.match(subject(), /second/);
    assert.equal((await put('first token')).status, 401);
    assert.equal((await put('second token')).status, 413);
    assert.equal((await daemon.curl('/v1/models', ['-k'])).headers['access-control-allow-origin'], undefined);
    fs.writeFileSync(tokens, 'x sha256:1\n');
    await reload(/old settings stay: .*line 1/);
    assert.equal((await put('second token')).status, 413);
    fs.writeFileSync(tokens, 'second token\n');
    fs.writeFileSync(files.certificate, 'no certificate');
    await reload(/old settings stay: .*PEM/);
    assert.match(subject(), /second/);
    assert.ok(!kept.isClosed);
    kept.destroy();
  } finally {
    assert.deepEqual(await daemon.stop(), { code: 0, signal: null });
    fs.rmSync(directory, { recursive: true });
  }
});

// A service manager in ten lines of Perl: a listening socket on descriptor 3 and a socket for notices; it prints the notices.
const manager = `
use strict; use Socket; use IO::Select;
my ($path, $watchdog, @command) = @ARGV;
socket(my $notices, AF_UNIX, SOCK_DGRAM, 0); bind($notices, pack_sockaddr_un($path));
socket(my $listener, AF_INET, SOCK_STREAM, 0); bind($listener, pack_sockaddr_in(0, inet_aton('127.0.0.1'))); listen($listener, 64);
my ($port) = unpack_sockaddr_in(getsockname($listener));
$| = 1; print "port $port\\n";
my $pid = fork();
if (!$pid) {
  use POSIX; POSIX::dup2(fileno($listener), 3); 
  $ENV{NOTIFY_SOCKET} = $path; $ENV{LISTEN_PID} = $$; $ENV{LISTEN_FDS} = 1; $ENV{WATCHDOG_USEC} = $watchdog; $ENV{WATCHDOG_PID} = $$;
  exec(@command);
}
print "pid $pid\\n"; close($listener);
my $select = IO::Select->new($notices);
while (waitpid($pid, 1) == 0) { while ($select->can_read(0.05)) { recv($notices, my $text, 4096, 0); $text =~ s/\\n/;/g; print "notice $text\\n"; } }
print 'exit ', $? >> 8, "\\n";
`;

test('service manager passes a socket, and hears of ready, reload, watchdog and stop', async () => {
  const directory = makeDirectory();
  const args = ['-e', manager, path.join(directory, 'notify'), '400000', path.join(build, 'lodestreamd'), '--store', path.join(directory, 'store'), '--worker', recipeWorker];
  const child = spawn('perl', args, { stdio: ['ignore', 'pipe', 'pipe'] });
  let out = '';
  child.stdout.on('data', (data) => (out += data));
  child.stderr.on('data', (data) => (out += data));
  try {
    await eventually('ready', () => /notice READY=1/.test(out));
    const port = /port (\d+)/.exec(out)[1];
    const pid = Number(/pid (\d+)/.exec(out)[1]);
    assert.match(out, new RegExp(`listening on http://127.0.0.1:${port}`));
    const answers = await Promise.all(Array.from({ length: 8 }, () => curl(`http://127.0.0.1:${port}/healthz`)));
    assert.ok(answers.every((answer) => answer.status === 200));
    await eventually('the watchdog is fed', () => (out.match(/notice WATCHDOG=1/g) ?? []).length >= 3);
    process.kill(pid, 'SIGHUP');
    await eventually('reloading', () => /notice RELOADING=1;MONOTONIC_USEC=\d+[^]*notice READY=1/.test(out));
    process.kill(pid, 'SIGSTOP'); // a daemon that hangs is silent
    await sleep(300);
    const before = (out.match(/WATCHDOG/g) ?? []).length;
    await sleep(1000);
    assert.ok((out.match(/WATCHDOG/g) ?? []).length <= before + 1);
    process.kill(pid, 'SIGCONT');
    process.kill(pid, 'SIGTERM');
    await eventually('stopped', () => /notice STOPPING=1[^]*exit 0/.test(out));
  } finally {
    const pid = /pid (\d+)/.exec(out);
    if (pid && !/exit \d/.test(out)) process.kill(Number(pid[1]), 'SIGKILL');
    fs.rmSync(directory, { recursive: true, force: true });
  }
});

const crc32 = (bytes) => {
  let crc = -1;
  for (const byte of bytes) {
    crc ^= byte;
    for (let i = 0; i < 8; i++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
};

test('check-store finds a changed byte, and --repair leaves a store that serves the rest', async () => {
  const directory = makeDirectory();
  const store = path.join(directory, 'store');
  const first = await Daemon.start({ store });
  await first.bake('good', bunny);
  await first.bake('bad', { ...bunny, seed: 500 });
  const name = (await first.json('/v1/models/bad')).json.families.cluster.levels[1].object;
  const check = (...args) => spawnSync(path.join(build, 'lodestream'), ['check-store', store, ...args], { encoding: 'utf8' });
  assert.match(check().stderr, /in use/);
  await first.stop();
  // Answers that a daemon kept: one that is whole, of a model that is there; the same of one that is not; cut short; and no answer at all.
  const answer = (text) => {
    const bytes = Buffer.concat([Buffer.from(text), Buffer.from('{}'), Buffer.alloc(24)]), end = bytes.length - 24;
    bytes.writeBigUInt64LE(BigInt(text.length), end);
    bytes.writeUInt32LE(2, end + 8);
    bytes.writeUInt32LE(crc32(bytes.subarray(0, end + 12)), end + 12);
    bytes.write('LODANSW1', end + 16);
    return bytes;
  };
  const keep = (name, bytes) => fs.writeFileSync(path.join(store, 'refined', name), bytes);
  keep(`${'1'.repeat(32)}.good`, answer('kept'));
  const sound = check();
  assert.equal(sound.status, 0, sound.stdout + sound.stderr);
  assert.match(sound.stdout, /2 models, .* 0 damaged, 0 missing.* 1 refinements: 0 damaged, 0 stray/);
  keep(`${'2'.repeat(32)}.gone`, answer('orphan'));
  keep(`${'3'.repeat(32)}.good`, answer('cut short').subarray(1));
  keep('.new', '');
  keep(`${'4'.repeat(32)}.bad`, answer('of a model that --repair removes'));
  const cache = check();
  assert.equal(cache.status, 1);
  assert.match(cache.stdout, /5 refinements: 2 damaged, 1 stray/);
  assert.match(cache.stdout, /file refined\/2{32}\.gone is of a model that is not there\n/);
  assert.match(cache.stdout, /file refined\/3{32}\.good is damaged or cut short\n/);
  const object = path.join(store, 'objects', name.slice(0, 2), name);
  fs.chmodSync(object, 0o600);
  const bytes = fs.readFileSync(object);
  bytes[100] ^= 1;
  fs.writeFileSync(object, bytes);
  const found = check();
  assert.equal(found.status, 1);
  assert.match(found.stdout, new RegExp(`object ${name} is damaged`));
  assert.match(found.stdout, /model bad cannot be served whole/);
  assert.equal(check('--repair').status, 0);
  assert.equal(check().status, 0);
  assert.deepEqual(fs.readdirSync(path.join(store, 'refined')), [`${'1'.repeat(32)}.good`]);
  const second = await Daemon.start({ store });
  assert.equal((await second.curl('/v1/models/good/level?error=1')).status, 200);
  assert.equal((await second.curl('/v1/models/bad')).status, 404);
  await second.bake('bad', { ...bunny, seed: 500 });
  assert.equal((await second.curl('/v1/models/bad')).status, 200);
  await second.stop();
  fs.rmSync(directory, { recursive: true });
});

test('store that becomes read-only is told by name, serves on, and takes uploads again by itself', { skip: process.getuid() === 0 ? false : 'needs to mount' }, async (t) => {
  const directory = makeDirectory();
  const store = path.join(directory, 'store');
  fs.mkdirSync(store);
  if (spawnSync('mount', ['-t', 'tmpfs', '-o', 'size=64m', 'tmpfs', store]).status !== 0) return t.skip('mounting is not allowed here');
  const daemon = await Daemon.start({ store });
  try {
    await daemon.bake('m', bunny);
    assert.equal((await daemon.curl('/readyz')).status, 200);
    const put = () => daemon.curl('/v1/models/n', ['-T', '-'], recipe);
    // SQLite holds its files open for writing, so the file system itself cannot be remounted; filled to the brim it refuses as well.
    fs.writeFileSync(path.join(store, 'ballast'), Buffer.alloc(1 << 20));
    let filled = 0;
    try {
      for (;;) {
        fs.appendFileSync(path.join(store, 'ballast'), Buffer.alloc(1 << 16));
        filled++;
      }
    } catch (error) {
      assert.equal(error.code, 'ENOSPC');
    }
    assert.ok(filled > 10);
    const ready = await daemon.curl('/readyz');
    assert.equal(ready.status, 503);
    assert.equal(problemOf(ready), '/problems/disk-full');
    const refused = await put();
    assert.ok([500, 507].includes(refused.status), String(refused.body));
    assert.equal(problemOf(refused), '/problems/disk-full');
    assert.equal((await daemon.curl('/v1/models/m/level?error=1')).status, 200);
    fs.unlinkSync(path.join(store, 'ballast'));
    await eventually('it is ready again', async () => (await daemon.curl('/readyz')).status === 200);
    const taken = await put();
    assert.equal(taken.status, 202);
    assert.equal((await daemon.finished(taken.headers.location)).state, 'done');
  } finally {
    await daemon.stop();
    spawnSync('umount', [store]);
    fs.rmSync(directory, { recursive: true, force: true });
  }
});

test('an upload is served while the second bake of another model goes on for ever, and the metrics say so', async () => {
  const daemon = await Daemon.start({ later: 'envelope' });
  try {
    const first = await daemon.bake('one', { ...bunny, later: 'hang' });
    await eventually('the second bake runs', async () => (await daemon.metric('lodestream_jobs_later_running')) === 1);
    for (const id of ['two', 'three']) {
      assert.equal((await daemon.bake(id, { ...bunny, later: 'hang' })).state, 'done');
      assert.equal((await daemon.curl(`/v1/models/${id}/level?error=1`)).status, 200);
    }
    assert.equal((await daemon.json(`/v1/jobs/${first.next}`)).json.state, 'running');
    assert.equal(await daemon.metric('lodestream_jobs_later_running'), 1);
    assert.equal(await daemon.metric('lodestream_jobs_later_queued'), 2);
    assert.match(String((await daemon.curl('/metrics')).body), /^lodestream_bake_wait_seconds_total\{bake="first"\} \d/m);
    assert.equal((await daemon.curl('/v1/models/one', ['-X', 'DELETE'])).status, 204);
    await eventually('the next second bake runs', async () => (await daemon.metric('lodestream_jobs_later_queued')) === 1);
  } finally {
    await daemon.stop();
  }
});

test('every metric of the dashboard is one that the daemon has', async () => {
  const daemon = await Daemon.start();
  await daemon.bake('m', bunny);
  await daemon.curl('/v1/models/m/level?error=1');
  const text = String((await daemon.curl('/metrics')).body);
  await daemon.stop();
  const dashboard = fs.readFileSync(new URL('../../deploy/grafana.json', import.meta.url), 'utf8');
  const names = new Set(JSON.parse(dashboard).panels.flatMap((panel) => panel.targets.flatMap((target) => target.expr.match(/(lodestream|process)_[a-z_]+/g))));
  assert.ok(names.size > 15);
  for (const name of names) {
    assert.match(text, new RegExp(`^# HELP ${name.replace(/_bucket$/, '')} \\S`, 'm'), name);
    assert.match(text, new RegExp(`^${name}[ {]`, 'm'), name);
  }
  for (const [, labels, name] of dashboard.matchAll(/by \(([a-z, ]+)\) \((?:rate|increase)\(([a-z_]+)/g))
    for (const label of labels.split(', ')) assert.match(text, new RegExp(`^${name}\\{.*\\b${label}=`, 'm'), `${name} by ${label}`);
  assert.match(text, /lodestream_worker_ends_total\{cause="done"\} 1/);
});
