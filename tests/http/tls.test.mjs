// HTTPS: the same answers, only modern versions, and the same care for connections.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import tls from 'node:tls';
import { execFileSync } from 'node:child_process';
import { after, before, test } from 'node:test';
import { Daemon, bunny, eventually, makeDirectory } from './daemon.mjs';
import { sha256 } from './worker.mjs';

let directory;
let certificate;
let key;
let daemon;

before(async () => {
  directory = makeDirectory();
  certificate = path.join(directory, 'cert.pem');
  key = path.join(directory, 'key.pem');
  execFileSync('openssl', ['req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:prime256v1', '-nodes', '-days', '2', '-subj', '/CN=localhost',
    '-addext', 'subjectAltName=IP:127.0.0.1', '-keyout', key, '-out', certificate], { stdio: 'ignore' });
  daemon = await Daemon.start({ flags: ['--tls-cert', certificate, '--tls-key', key, '--upload-bytes', '100000', '--header-seconds', '2'] });
});
after(async () => {
  await daemon?.stop();
  fs.rmSync(directory, { recursive: true, force: true });
});

const ask = (target, args = [], input = null) => daemon.curl(target, ['--cacert', certificate, ...args], input);

test('levels, ranges and uploads work over TLS', async () => {
  assert.match(daemon.url, /^https:/);
  const put = await ask('/v1/models/bunny', ['-T', '-'], JSON.stringify(bunny));
  assert.equal(put.status, 202);
  const events = await ask(`${put.headers.location}/events`);
  assert.match(String(events.body), /"state":"done"/);
  const level = await ask('/v1/models/bunny/level?error=0.01&family=cluster');
  assert.equal(`"${sha256(level.body)}"`, level.headers.etag);
  const part = await ask('/v1/models/bunny/level?error=0.01&family=cluster', ['-r', '1000000-2999999']);
  assert.equal(part.status, 206);
  assert.ok(part.body.equals(level.body.subarray(1000000, 3000000)));
});

test('many answers to a slow reader are whole over TLS, each with its request\'s id', async () => {
  const { object } = JSON.parse((await ask('/v1/models/bunny')).body).families.cluster.levels[1];
  const count = 500; // 10 MB: GnuTLS has to stop in the middle of records
  const socket = tls.connect({ port: daemon.port, host: '127.0.0.1', rejectUnauthorized: false });
  const chunks = [];
  await new Promise((resolve) => socket.on('secureConnect', resolve));
  socket.write(Array.from({ length: count }, (_, i) => `GET /v1/objects/${object} HTTP/1.1\r\nHost: x\r\nX-Request-Id: r${i}\r\n\r\n`).join(''));
  await new Promise((resolve) => setTimeout(resolve, 300));
  socket.on('data', (data) => chunks.push(data));
  let all = Buffer.alloc(0), at = 0;
  for (let i = 0; i < count; i++) {
    let head = -1;
    await eventually(`answer ${i}`, () => {
      if (chunks.length) all = Buffer.concat([all, ...chunks.splice(0)]);
      head = all.indexOf('\r\n\r\n', at);
      return head >= 0 && all.length >= head + 4 + 20000;
    });
    const header = all.subarray(at, head).toString('latin1');
    assert.match(header, new RegExp(`^HTTP/1.1 200 OK\r\nX-Request-Id: r${i}\r\n`));
    at = head + 4 + 20000;
    assert.equal(sha256(all.subarray(head + 4, at)), object);
  }
  socket.destroy();
});

test('refusal in the middle of a chunked upload arrives over TLS too', async () => {
  const response = await ask('/v1/models/big', ['-T', '-', '-H', 'Expect:'], Buffer.alloc(400000, 1));
  assert.equal(response.status, 413, response.errors);
});

test('old versions of TLS and plain HTTP are refused', async () => {
  const old = await new Promise((resolve) => {
    const socket = tls.connect({ port: daemon.port, host: '127.0.0.1', rejectUnauthorized: false, minVersion: 'TLSv1', maxVersion: 'TLSv1.1', ciphers: 'ALL:@SECLEVEL=0' });
    socket.on('secureConnect', () => resolve(socket.getProtocol()));
    socket.on('error', () => resolve('refused'));
  });
  assert.equal(old, 'refused');
  for (const version of ['--tlsv1.2', '--tlsv1.3']) assert.equal((await ask('/healthz', [version])).status, 200);
  const plain = await daemon.connect();
  plain.write('GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n');
  await eventually('it is closed', () => plain.isClosed);
  assert.doesNotMatch(plain.text, /200 OK/);
});

test('handshake that never comes is cut', async () => {
  const silent = await daemon.connect();
  silent.write('\x16\x03\x01', 'latin1');
  await eventually('it is closed', () => silent.isClosed);
});

test('wrong certificate files are told before anything is served', async () => {
  await assert.rejects(Daemon.start({ flags: ['--tls-cert', certificate] }), /go together/);
  await assert.rejects(Daemon.start({ flags: ['--tls-cert', '/nowhere', '--tls-key', key] }), /nowhere/);
  await assert.rejects(Daemon.start({ flags: ['--tls-cert', key, '--tls-key', certificate] }), /PEM/);
});
