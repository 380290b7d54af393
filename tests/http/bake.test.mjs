// The whole way with the real worker: a model goes in, levels come out that meet what was asked for.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Daemon, build } from './daemon.mjs';
import { sha256 } from './worker.mjs';

// A sphere of radius 1 as ASCII PLY, 2 * rings * sectors - 2 * sectors triangles.
function sphere(rings, sectors) {
  const points = [[0, 0, 1]];
  for (let i = 1; i < rings; i++) {
    for (let j = 0; j < sectors; j++) {
      const a = (Math.PI * i) / rings;
      const b = (2 * Math.PI * j) / sectors;
      points.push([Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)]);
    }
  }
  points.push([0, 0, -1]);
  const at = (i, j) => 1 + (i - 1) * sectors + (j % sectors);
  const faces = [];
  for (let j = 0; j < sectors; j++) {
    faces.push([0, at(1, j), at(1, j + 1)], [points.length - 1, at(rings - 1, j + 1), at(rings - 1, j)]);
    for (let i = 1; i < rings - 1; i++) faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
  }
  const lines = ['ply', 'format ascii 1.0', `element vertex ${points.length}`, 'property float x', 'property float y', 'property float z',
    `element face ${faces.length}`, 'property list uchar int vertex_indices', 'end_header', ...points.map((p) => p.join(' ')),
    ...faces.map((f) => `3 ${f.join(' ')}`)];
  return { text: `${lines.join('\n')}\n`, triangles: faces.length };
}

let daemon;
before(async () => {
  daemon = await Daemon.start({ worker: path.join(build, 'lodestream') });
});
after(() => daemon?.stop());

const put = async (id, bytes, query = '') => {
  const file = path.join(daemon.directory, 'upload');
  fs.writeFileSync(file, bytes);
  const response = await daemon.curl(`/v1/models/${id}${query}`, ['-T', file]);
  assert.equal(response.status, 202, String(response.body));
  return daemon.finished(response.headers.location);
};

test('sphere becomes levels that fit what is asked for', async () => {
  const { text, triangles } = sphere(60, 120);
  const job = await put('sphere', text, '?name=sphere.ply');
  assert.equal(job.state, 'done', JSON.stringify(job.problem));
  const { json: manifest } = await daemon.json('/v1/models/sphere');
  assert.equal(manifest.source.triangles, triangles);
  assert.equal(manifest.source.sha256, sha256(Buffer.from(text)));
  const { levels } = manifest.families.cluster;
  assert.ok(levels.length >= 3);
  assert.ok(levels.at(-1).error < levels[0].error);
  for (const level of levels) {
    const { status, headers, body } = await daemon.curl(`/v1/models/sphere/level?error=${level.error}&family=cluster`);
    assert.equal(status, 200);
    assert.ok(Number(headers['lod-error']) <= level.error);
    assert.ok(body.length <= level.bytes);
    assert.equal(String(body.subarray(0, 4)), 'glTF');
    assert.equal(`"${sha256(body)}"`, headers.etag);
  }
  const near = await daemon.curl('/v1/models/sphere/level?px=1&distance=4&fov=60&height=1080');
  assert.ok(Number(near.headers['lod-screen-error']) <= 1 || near.headers['lod-level'] === String(levels.length - 1));
});

test('documents over the levels: a tileset whose errors are the certified ones, a glTF whose buffers are the levels', async () => {
  const { json: manifest } = await daemon.json('/v1/models/sphere');
  const { headers, json: tileset } = await daemon.json('/v1/models/sphere/tileset.json');
  assert.match(headers['content-type'], /^application\/json/);
  assert.match(headers['cache-control'], /no-cache/);
  assert.equal(tileset.asset.version, '1.1');
  assert.ok(tileset.geometricError >= tileset.root.geometricError);
  const levels = manifest.families.cluster.levels;
  let tiles = 0;
  for (let tile = tileset.root; tile; tile = tile.children?.[0]) {
    const { body } = await daemon.curl(new URL(tile.content.uri, 'http://x/v1/models/sphere/tileset.json').pathname);
    const level = levels.find(({ object }) => object === sha256(body));
    assert.ok(Math.abs(tile.geometricError - level.error) <= 1e-8 * level.error);
    const child = tile.children?.[0];
    assert.ok(!child || (child.geometricError < tile.geometricError && child.boundingVolume.sphere[3] <= tile.boundingVolume.sphere[3]));
    assert.ok(child || level === levels.at(-1), 'the finest level is the last tile');
    tiles++;
  }
  assert.ok(tiles >= 3);
  const { status, body } = await daemon.curl('/v1/models/sphere/model.glb');
  assert.equal(status, 200);
  const gltf = JSON.parse(body.subarray(20, 20 + body.readUInt32LE(12)));
  assert.equal(gltf.buffers.length, tiles);
  const root = gltf.nodes[gltf.scenes[gltf.scene].nodes[0]];
  assert.equal(root.extensions.MSFT_lod.ids.length, tiles - 1);
  assert.equal(root.extras.MSFT_screencoverage.length, tiles);
  for (const buffer of gltf.buffers) assert.ok(levels.some(({ object, bytes }) => object === buffer.uri && bytes === buffer.byteLength));
  for (const name of ['tileset.json', 'model.glb']) assert.equal((await daemon.curl(`/v1/models/none/${name}`)).status, 404);
});

test('a model is served with its first families, and then with the later ones too', async () => {
  const twice = await Daemon.start({ worker: path.join(build, 'lodestream'), later: 'envelope' });
  try {
    const file = path.join(twice.directory, 'upload');
    fs.writeFileSync(file, sphere(24, 48).text);
    const { headers } = await twice.curl('/v1/models/ball', ['-T', file]);
    const first = await twice.finished(headers.location);
    assert.equal(first.state, 'done', JSON.stringify(first.problem));
    const second = await twice.finished(`/v1/jobs/${first.next}`);
    assert.equal(second.state, 'done', JSON.stringify(second.problem));
    assert.equal(second.next, undefined);
    const { json: manifest } = await twice.json('/v1/models/ball');
    assert.deepEqual(Object.keys(manifest.families).sort(), ['cluster', 'envelope']);
    // The point of it: the same error for fewer bytes.
    const { headers: chosen } = await twice.curl(`/v1/models/ball/level?error=${0.01 * manifest.source.diagonal}`);
    assert.equal(chosen['lod-family'], 'envelope');
    assert.ok(Number(chosen['lod-error']) <= 0.01 * manifest.source.diagonal);
  } finally {
    await twice.stop();
  }
});

test('the family envelope is baked nested where the daemon is asked to, and sent step by step', async () => {
  const nested = await Daemon.start({ worker: path.join(build, 'lodestream'), later: 'envelope', flags: ['--envelope', 'nested=1,rms=0.5'] });
  try {
    const file = path.join(nested.directory, 'upload');
    fs.writeFileSync(file, sphere(24, 48).text);
    const { headers } = await nested.curl('/v1/models/ball', ['-T', file]);
    const first = await nested.finished(headers.location);
    const second = await nested.finished(`/v1/jobs/${first.next}`);
    assert.equal(second.state, 'done', JSON.stringify(second.problem));
    const { json: manifest } = await nested.json('/v1/models/ball');
    const { levels } = manifest.families.envelope;
    assert.equal(manifest.families.envelope.nested, true, 'a client may morph');
    const steps = levels.filter((level) => level.delta);
    assert.ok(steps.length > 0 && levels[0].first, JSON.stringify(levels));
    const whole = await nested.curl('/v1/models/ball/delta?family=envelope&to=1');
    assert.equal(whole.status, 200);
    assert.equal(whole.body.length, levels[0].first.bytes + levels[0].delta.bytes);
  } finally {
    await nested.stop();
  }
});

test('progress of a bake only grows, and is not full before it is done', async () => {
  const file = path.join(daemon.directory, 'upload');
  fs.writeFileSync(file, sphere(50, 100).text);
  const { headers } = await daemon.curl('/v1/models/slow', ['-T', file]);
  const events = await daemon.curl(`${headers.location}/events`, ['-N']);
  const seen = String(events.body).split('\n').filter((line) => line.startsWith('data: ')).map((line) => JSON.parse(line.slice(6)));
  assert.equal(seen.at(-1).state, 'done');
  assert.ok(new Set(seen.map((job) => job.stage)).size >= 4, JSON.stringify(seen));
  seen.forEach((job, i) => {
    assert.ok(i === 0 || job.progress >= seen[i - 1].progress, `${JSON.stringify(seen[i - 1])} then ${JSON.stringify(job)}`);
    assert.ok(['store', 'done'].includes(job.stage) || job.progress < 1, JSON.stringify(job));
  });
});

test('what is no model fails with a problem that says so, and nothing is left', async () => {
  for (const [id, bytes] of [['noise', Buffer.from('not a model at all')], ['cut', Buffer.from(sphere(10, 10).text.slice(0, 700))]]) {
    const job = await put(id, bytes, '?name=x.ply');
    assert.equal(job.state, 'failed');
    assert.ok(job.problem.detail.length > 10, JSON.stringify(job.problem));
    assert.equal(job.problem.status, 400, JSON.stringify(job.problem)); // the model's fault, not the worker's
    assert.match(job.problem.type, /^\/problems\/[a-z0-9-]+$/);
    assert.equal((await daemon.curl(`/v1/models/${id}`)).status, 404);
  }
  for (const folder of ['uploads', 'work']) assert.deepEqual(fs.readdirSync(path.join(daemon.store, folder)), []);
});
