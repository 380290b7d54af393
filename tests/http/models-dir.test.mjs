// --models DIR: files become models when they come, when they change, and at the start when they are new.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Daemon, bunny, eventually, makeDirectory, sleep } from './daemon.mjs';

let directory;
let models;
let daemon;

const start = async () => {
  daemon = await Daemon.start({ store: path.join(directory, 'store'), flags: ['--models', models] });
};
before(async () => {
  directory = makeDirectory();
  models = path.join(directory, 'models');
  fs.mkdirSync(models);
  fs.writeFileSync(path.join(models, 'first.ply'), JSON.stringify(bunny));
  await start();
});
after(async () => {
  await daemon?.stop();
  fs.rmSync(directory, { recursive: true, force: true });
});

const source = async (id) => {
  const { status, body } = await daemon.curl(`/v1/models/${id}`);
  return status === 200 ? JSON.parse(body).source : null;
};
const bakes = () => daemon.metric('lodestream_jobs_done_total');

test('file that is there at the start becomes a model under its base name', async () => {
  const { name } = await eventually('the model', () => source('first'));
  assert.equal(name, 'first.ply');
});

test('file that is copied or moved in becomes a model', async () => {
  fs.writeFileSync(path.join(models, 'second one.glb'), JSON.stringify({ ...bunny, seed: 100 }));
  fs.writeFileSync(path.join(directory, 'third.stl'), JSON.stringify({ ...bunny, seed: 200 }));
  fs.renameSync(path.join(directory, 'third.stl'), path.join(models, 'third.stl'));
  await eventually('the second', () => source('second-one'));
  await eventually('the third', () => source('third'));
});

test('changed file is baked again, the same bytes are not', async () => {
  const before = await source('first');
  const count = await bakes();
  fs.writeFileSync(path.join(models, 'first.ply'), JSON.stringify(bunny));
  await sleep(500);
  assert.equal(await bakes(), count);
  fs.writeFileSync(path.join(models, 'first.ply'), JSON.stringify({ ...bunny, seed: 400 }));
  await eventually('another source', async () => (await source('first')).sha256 !== before.sha256);
});

test('hidden files, companions and second files of a name are left out', async () => {
  fs.writeFileSync(path.join(models, '.hidden.ply'), JSON.stringify(bunny));
  fs.writeFileSync(path.join(models, 'skin.png'), 'x');
  fs.writeFileSync(path.join(models, 'third.zzz'), JSON.stringify({ ...bunny, seed: 900 }));
  await eventually('a word about it', () => daemon.log.includes("'third.zzz' is left out"));
  assert.equal((await source('third')).name, 'third.stl');
  assert.equal(await source('skin'), null);
});

test('restart bakes what changed meanwhile and nothing else', async () => {
  await eventually('quiet', async () => (await daemon.metric('lodestream_jobs_running')) + (await daemon.metric('lodestream_jobs_queued')) === 0);
  await daemon.stop();
  fs.writeFileSync(path.join(models, 'fourth.ply'), JSON.stringify({ ...bunny, seed: 600 }));
  await start();
  await eventually('the fourth', () => source('fourth'));
  assert.equal(await bakes(), 1);
  assert.ok(await source('first'));
});

test('folder that is not there is told', async () => {
  await assert.rejects(Daemon.start({ flags: ['--models', path.join(directory, 'nowhere')] }), /nowhere/);
});
