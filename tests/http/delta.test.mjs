// Steps between levels, over HTTP and from the command line: real worker, real tool.
import assert from 'node:assert/strict';
import { execFile } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { promisify } from 'node:util';
import { Daemon, build } from './daemon.mjs';
import { asPly, wavySphere } from './models.mjs';
import { sha256 } from './worker.mjs';

const tool = path.join(build, 'lodestream');
const run = promisify(execFile);
const type = 'application/vnd.lodestream.delta';
let daemon;
let levels;
const file = (name) => path.join(daemon.directory, name);

before(async () => {
  daemon = await Daemon.start({ worker: tool, flags: ['--families', 'cluster,retile'] });
  fs.writeFileSync(file('ball.ply'), asPly(wavySphere(44)));
  const sent = await daemon.curl('/v1/models/ball?name=ball.ply', ['-T', file('ball.ply')]);
  const job = await daemon.finished(sent.headers.location);
  assert.equal(job.state, 'done', JSON.stringify(job));
  levels = (await daemon.json('/v1/models/ball')).json.families.retile.levels;
});
after(() => daemon?.stop());

// The last of the levels that a chain of steps from the first leads to.
const reach = () => levels.findIndex((level) => !level.delta);

test('a re-tiled model has steps between its levels and a first picture', () => {
  assert.ok(reach() >= 1, JSON.stringify(levels));
  assert.equal(levels[0].first.type, type);
  for (const [k, level] of levels.entries()) {
    if (level.delta) assert.equal(level.delta.to, k + 1);
    if (k > 0) assert.equal(level.first, undefined);
  }
  assert.equal(levels.at(-1).delta, undefined);
});

test('one step is its object, several are joined, none is asked for twice', async () => {
  const one = await daemon.curl('/v1/models/ball/delta?family=retile&from=0&to=1');
  assert.equal(one.status, 200);
  assert.equal(one.headers['content-type'], type);
  assert.equal(sha256(one.body), levels[0].delta.object);
  assert.equal(one.headers['lod-from'], '0');
  assert.equal(one.headers['lod-level'], '1');
  assert.equal(Number(one.headers['lod-error']), levels[1].error);
  const all = await daemon.curl(`/v1/models/ball/delta?family=retile&to=${reach()}`);
  assert.equal(all.headers['lod-from'], undefined);
  const bytes = [levels[0].first, ...levels.slice(0, reach()).map((level) => level.delta)].reduce((sum, step) => sum + step.bytes, 0);
  assert.equal(all.body.length, bytes);
  const again = await daemon.curl(`/v1/models/ball/delta?family=retile&to=${reach()}`, ['-H', `If-None-Match: ${all.headers.etag}`]);
  assert.equal(again.status, 304);
  const part = await daemon.curl(`/v1/models/ball/delta?family=retile&to=${reach()}`, ['-H', 'Range: bytes=10-19']);
  assert.equal(part.status, 206);
  assert.deepEqual(part.body, all.body.subarray(10, 20));
});

test('a step that cannot be is refused with a reason', async () => {
  const last = levels.length - 1;
  for (const [query, status] of [[`from=${last}`, 400], ['from=1&to=1', 400], ['from=-1', 400], ['to=99', 400], ['family=none', 400], ['x=1', 400]])
    assert.equal((await daemon.curl(`/v1/models/ball/delta?${query}${query.includes('family') ? '' : '&family=retile'}`)).status, status, query);
  assert.equal((await daemon.curl('/v1/models/nobody/delta')).status, 404);
  assert.ok(reach() < last);
  assert.equal((await daemon.curl(`/v1/models/ball/delta?family=retile&from=0&to=${last}`)).status, 404);
});

test('who has a level gets the steps when they are fewer bytes, the level when not', async () => {
  const to = reach();
  const ask = (have) => daemon.curl(`/v1/models/ball/level?family=retile&error=${levels[to].error}${have}`);
  const without = await ask('');
  assert.equal(without.headers['content-type'], 'model/gltf-binary');
  assert.equal(without.headers['lod-level'], String(to));
  const withOne = await ask(`&have=${to - 1}`);
  const fewer = levels[to - 1].delta.bytes < levels[to].bytes;
  assert.ok(fewer);
  assert.equal(withOne.headers['content-type'], type);
  assert.equal(withOne.headers['lod-from'], String(to - 1));
  assert.equal(sha256(withOne.body), levels[to - 1].delta.object);
  assert.notEqual(withOne.headers.etag, without.headers.etag);
  const finer = await ask(`&have=${to}`);
  assert.equal(finer.headers['content-type'], 'model/gltf-binary');
  assert.equal((await daemon.curl('/v1/models/ball/level?error=1&have=0')).status, 400);
});

test('decoded steps are the level to the bit', async () => {
  const to = reach();
  const first = await daemon.curl(`/v1/models/ball/delta?family=retile&to=${to}`);
  const rest = await daemon.curl(`/v1/models/ball/delta?family=retile&from=0&to=${to}`);
  fs.writeFileSync(file('first.bin'), first.body);
  fs.writeFileSync(file('rest.bin'), rest.body);
  for (const k of [0, to]) fs.writeFileSync(file(`${k}.glb`), (await daemon.curl(`/v1/objects/${levels[k].object}`)).body);
  await run(tool, ['decode', file(`${to}.glb`), '-o', file('level.ply')]);
  await run(tool, ['decode', file('first.bin'), '-o', file('a.ply')]);
  await run(tool, ['decode', file('0.glb'), file('rest.bin'), '-o', file('b.ply')]);
  for (const name of ['a.ply', 'b.ply']) {
    const facts = JSON.parse((await run(tool, ['measure', file(name), file('level.ply'), '--json'])).stdout);
    assert.ok(facts.upper <= 1e-9 * facts.diagonal, JSON.stringify(facts));
    assert.equal(facts.a.triangles, facts.b.triangles);
    assert.equal(facts.a.vertices, facts.b.vertices);
  }
  await assert.rejects(run(tool, ['decode', file(`${to}.glb`), file('rest.bin'), '-o', file('c.ply')]), /wrong-base/);
});


test('native client draws every level as it arrives, and a morph that begins and ends at levels', async () => {
  const to = reach();
  const { body } = await daemon.curl(`/v1/models/ball/delta?family=retile&to=${to}`);
  const example = (bytes) => new Promise((resolve) => {
    const child = execFile(path.join(build, 'clients/native/example'), [file('drawn'), '0', '0.5', '1'], (error, out, err) => resolve({ error, out, err }));
    child.stdin.on('error', () => {});
    child.stdin.end(bytes);
  });
  const { error, out } = await example(body);
  assert.equal(error, null);
  assert.equal(out.trim().split('\n').length, to + 1);
  const same = async (a, b) => {
    const facts = JSON.parse((await run(tool, ['measure', file(a), file(b), '--json'])).stdout);
    assert.ok(facts.upper <= 1e-6 * facts.diagonal, `${a} ${b} ${JSON.stringify(facts)}`);
  };
  await same('drawn-1-0.ply', 'drawn-0.ply');
  await same('drawn-1-1.ply', 'drawn-1.ply');
  const cut = await example(body.subarray(0, body.length - 3));
  assert.match(cut.err, /picture stays at level/);
  const bad = Buffer.from(body);
  bad[body.length - 3] ^= 4;
  const broken = await example(bad);
  assert.equal(broken.error.code, 1);
  assert.match(broken.err, /damaged/);
});

test('native client takes a step in units from the level reached, part by part', async () => {
  fs.writeFileSync(file('fine.ply'), asPly(wavySphere(100)));
  await run(tool, ['bake', file('fine.ply'), '-o', file('bake'), '--family', 'retile', '--vertices', '1100,3000']);
  const { levels } = JSON.parse(fs.readFileSync(file('bake/manifest.json'))).families.retile;
  const read = ({ object }) => fs.readFileSync(file(path.join('bake/objects', object)));
  const at = 0;
  const { units } = levels[at].delta;
  const frames = read(levels[0].first);
  const object = read(units);
  assert.equal(object.length, units.bytes);
  fs.writeFileSync(file('units.bin'), object);
  const example = () => new Promise((resolve) => {
    const child = execFile(path.join(build, 'clients/native/example'), ['--units', file('units.bin'), file('parts'), '0', '1'], (error, out, err) => resolve({ error, out, err }));
    child.stdin.end(frames);
  });
  const { error, out, err } = await example();
  assert.equal(error, null, err);
  const parts = Number(/level \d+: .* in (\d+) units/.exec(out)?.[1]);
  assert.ok(parts >= 2, out);
  const bound = async (a, b) => {
    const facts = JSON.parse((await run(tool, ['measure', file(a), file(b), '--json'])).stdout);
    return facts.upper / facts.diagonal;
  };
  fs.writeFileSync(file('whole.glb'), read(levels[at + 1]));
  await run(tool, ['decode', file('whole.glb'), '-o', file('whole.ply')]);
  assert.ok(await bound(`parts-${at + 1}.ply`, 'whole.ply') <= 1e-9, 'all units are the level');
  assert.ok(await bound(`parts-${at + 1}.1-0.ply`, `parts-${at}.ply`) <= 1e-6, 'a drawing begins at what is there');
  assert.ok(await bound(`parts-${at + 1}.${parts}-1.ply`, 'whole.ply') <= 1e-6, 'and ends at the level');
  assert.ok(await bound(`parts-${at + 1}.1-1.ply`, 'whole.ply') > 1e-6, 'the first part is not all of it');
  object[object.length - 3] ^= 4;
  fs.writeFileSync(file('units.bin'), object);
  const broken = await example();
  assert.equal(broken.error.code, 1);
  assert.match(broken.err, new RegExp(`damaged.* The picture stays at level ${at}\\.`));
});
