// Curved levels from end to end: baked, described, decoded, measured, served.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { spawn } from 'node:child_process';
import { after, before, test } from 'node:test';
import { Daemon, build, bunny, makeDirectory } from './daemon.mjs';
import { asPly, wavySphere } from './models.mjs';
import { sha256 } from './worker.mjs';

const tool = path.join(build, 'lodestream');
const type = 'application/vnd.lodestream.patches';
let folder, manifest;
const at = (...names) => path.join(folder, ...names);

function lodestream(...args) {
  return new Promise((resolve, reject) => {
    const child = spawn(tool, args, { cwd: folder, stdio: ['ignore', 'pipe', 'pipe'], timeout: 60000, killSignal: 'SIGKILL' });
    const out = { stdout: '', stderr: '' };
    for (const name of Object.keys(out)) child[name].setEncoding('utf8').on('data', (data) => (out[name] += data));
    child.on('error', reject);
    child.on('close', (status) => resolve({ status, ...out }));
  });
}

before(async () => {
  folder = makeDirectory();
  fs.writeFileSync(at('ball.ply'), asPly(wavySphere(40)));
  fs.writeFileSync(at('small.ply'), asPly(wavySphere(14)));
  const { status, stderr } = await lodestream('bake', 'ball.ply', '-o', 'ball', '--family', 'clod', '--patches', '1200,150,400');
  assert.equal(status, 0, stderr);
  manifest = JSON.parse(fs.readFileSync(at('ball', 'manifest.json')));
});
after(() => fs.rmSync(folder, { recursive: true, force: true }));

const curved = () => manifest.families.clod.levels.filter((level) => level.patches);

test('levels have the patches that were asked for, coarsest first, in fewer bytes the fewer they are', () => {
  assert.deepEqual(curved().map((level) => level.patches.patches), [150, 400, 1200]);
  for (const { patches } of curved()) {
    const bytes = fs.readFileSync(at('ball', 'objects', patches.object));
    assert.equal(bytes.length, patches.bytes);
    assert.equal(sha256(bytes), patches.object);
    assert.equal(bytes.toString('latin1', 0, 4), 'LODP');
    assert.equal(patches.type, type);
  }
  const [a, b, c] = curved().map((level) => level.patches);
  assert.ok(a.bytes < b.bytes && b.bytes < c.bytes && a.error > b.error && b.error > c.error);
});

test('patterns found as the paper does are certified as well', async () => {
  const { status, stderr } = await lodestream('bake', 'ball.ply', '-o', 'patterns', '--family', 'clod', '--patches', '400,150', '--patterns');
  assert.equal(status, 0, stderr);
  const levels = JSON.parse(fs.readFileSync(at('patterns', 'manifest.json'))).families.clod.levels.filter((level) => level.patches);
  assert.equal(levels.length, 2);
  for (const { patches } of levels) {
    await lodestream('decode', at('patterns', 'objects', patches.object), '-o', 'patterns.ply');
    const facts = JSON.parse((await lodestream('measure', 'ball.ply', 'patterns.ply', '--json')).stdout);
    assert.ok(patches.patches <= 420 && facts.lower <= patches.error, `${facts.lower} > ${patches.error}`);
  }
});

test('what patches decode to is within the error that the manifest certifies', async () => {
  for (const { patches } of curved()) {
    const decoded = await lodestream('decode', at('ball', 'objects', patches.object), '-o', 'patches.ply');
    assert.equal(decoded.status, 0, decoded.stderr);
    const measured = await lodestream('measure', 'ball.ply', 'patches.ply', '--json');
    const facts = JSON.parse(measured.stdout);
    assert.ok(facts.lower <= patches.error, `${facts.lower} > ${patches.error}`);
    assert.equal(facts.b.boundary_edges, 0);
    assert.equal(facts.b.genus, 0);
  }
});

test('where polygons need fewer bytes the manifest says so, and is right', () => {
  for (const { patches } of curved()) {
    const better = manifest.families.clod.levels.filter((level) => level.error <= patches.error && level.bytes < patches.bytes);
    assert.equal(Boolean(patches.polygons), better.length > 0);
    if (patches.polygons) assert.equal(patches.polygons.bytes, Math.min(...better.map((level) => level.bytes)));
  }
});

test('damaged patches are refused with a sentence', async () => {
  const bytes = fs.readFileSync(at('ball', 'objects', curved()[0].patches.object));
  bytes[bytes.length - 1] ^= 1;
  fs.writeFileSync(at('bad.patches'), bytes);
  const { status, stderr } = await lodestream('decode', 'bad.patches', '-o', 'bad.ply');
  assert.equal(status, 1);
  assert.match(stderr, /patch stream/i);
});

test('the daemon chooses among patches as among levels', async () => {
  const daemon = await Daemon.start({ worker: tool, flags: ['--families', 'clod'] });
  try {
    const accepted = await daemon.curl('/v1/models/ball', ['-T', at('small.ply')]);
    assert.equal(accepted.status, 202, String(accepted.body));
    const job = await daemon.finished(accepted.headers.location);
    assert.equal(job.state, 'done', JSON.stringify(job));
    const levels = (await daemon.json('/v1/models/ball')).json.families.clod.levels.filter((level) => level.patches);
    assert.ok(levels.length >= 2);
    for (const { level, patches } of levels) {
      const { status, headers, body } = await daemon.curl(`/v1/models/ball/patches?error=${patches.error * 1.0001}`);
      assert.equal(status, 200);
      assert.equal(headers['content-type'], type);
      assert.ok(Number(headers['lod-error']) <= patches.error * 1.0001);
      assert.ok(body.length <= patches.bytes);
      assert.ok(Number(headers['lod-level']) <= level + 1);
    }
    const seen = await daemon.curl('/v1/models/ball/patches?px=1&distance=5');
    assert.equal(seen.status, 200);
    assert.ok(Number(seen.headers['lod-screen-error']) >= 0);
    assert.equal((await daemon.curl('/v1/models/ball/patches?error=-1')).status, 400);
    assert.equal((await daemon.curl('/v1/models/none/patches?error=1')).status, 404);
  } finally {
    await daemon.stop();
  }
});

test('a model without patches says that it has none', async () => {
  const daemon = await Daemon.start();
  try {
    await daemon.bake('bunny', bunny);
    const { status, body } = await daemon.curl('/v1/models/bunny/patches?error=1');
    assert.equal(status, 404);
    assert.match(String(body), /no-patches/);
  } finally {
    await daemon.stop();
  }
});
