/** lodestream.wasm gives the bits that the same C gives natively, refuses what is broken, and stays small. */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import test from 'node:test';
import { fileURLToPath } from 'node:url';
import { gzipSync } from 'node:zlib';
import { Core, CoreError } from '../../clients/web/src/wasm/core.js';
import { takeUnits } from './native.mjs';

const ROOT = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const BYTES = readFileSync(path.join(ROOT, 'build/web/lodestream.wasm'));
const folder = mkdtempSync(path.join(tmpdir(), 'lodestream-steps-'));
const steps = execFileSync(path.join(ROOT, 'build/release/tests/sample/steps'), [folder], { encoding: 'utf8', cwd: ROOT })
  .trim().split('\n').map((line) => JSON.parse(line));
const read = (step) => readFileSync(path.join(folder, step.file));
test.after(() => rmSync(folder, { recursive: true }));

test('decoded deltas and maps have the hashes that native code gives', async () => {
  const core = await Core.create(BYTES);
  let base = null;
  assert.ok(steps.length >= 9);
  for (const step of steps) {
    if (step.first) base = null;
    const level = core.decode(read(step), base);
    assert.equal(level.hash, step.level, `${step.file}: level`);
    if (base) {
      const map = core.map(base, level);
      assert.equal(map.hash, step.map, `${step.file}: map`);
      const drawn = map.draw();
      assert.equal(drawn.failed, step.failed);
      assert.ok(drawn.triangles.length / 3 >= step.triangles);
      map.free();
      base.free();
    }
    base = level;
  }
  base.free();
});

test('units, and what is drawn of half of them, have the hashes that native code gives', async () => {
  const core = await Core.create(BYTES);
  let base = null;
  let seen = 0;
  for (const step of steps) {
    if (step.first) base = null;
    if (step.units) {
      const bytes = readFileSync(path.join(folder, step.units.file));
      const { file, ...native } = step.units;
      assert.deepEqual(takeUnits(core, bytes, base), native, file);
      const units = core.units(bytes, base);
      assert.throws(() => units.decode(units.facts().patches.length - 1, bytes.subarray(0, 40)), CoreError);
      units.free();
      seen++;
    }
    base = core.decode(read(step), base);
  }
  assert.ok(seen >= 3);
});

test('memory is given back: decoding everything a second time needs no more', async () => {
  const core = await Core.create(BYTES);
  const all = () => {
    let base = null;
    for (const step of steps) {
      if (step.first && base) {
        base.free();
        base = null;
      }
      const level = core.decode(read(step), base);
      if (base) {
        core.map(base, level).free();
        base.free();
      }
      base = level;
    }
    base.free();
  };
  all();
  const before = core.bytes;
  all();
  all();
  assert.equal(core.bytes, before);
});

test('broken deltas are refused with a sentence, and the base stays', async () => {
  const core = await Core.create(BYTES);
  const [first, second] = steps;
  const base = core.decode(read(first));
  const whole = read(second);
  const hash = base.hash;
  for (let size = 0; size < whole.length; size += 1 + (size >> 5)) {
    assert.throws(() => core.decode(whole.subarray(0, size), base), CoreError);
  }
  for (let at = 0; at < whole.length; at += 7) {
    const bytes = Buffer.from(whole);
    bytes[at] ^= 1 << at % 8;
    try {
      const level = core.decode(bytes, base);
      assert.equal(level.hash, second.level, `a changed byte ${at} went unnoticed`);
      level.free();
    } catch (error) {
      assert.ok(error instanceof CoreError && error.message.length > 10, `${at}: ${error}`);
    }
  }
  assert.throws(() => core.decode(whole, null), (error) => error instanceof CoreError);
  assert.equal(base.hash, hash);
  assert.equal(core.decode(whole, base).hash, second.level);
});

test('frames tell their length from their beginning', async () => {
  const core = await Core.create(BYTES);
  const [first, second] = steps.map(read);
  const both = Buffer.concat([first, second]);
  assert.equal(core.frameSize(both), first.length);
  assert.equal(core.frameSize(both.subarray(0, 3)), 0);
  assert.equal(core.frameSize(both.subarray(first.length)), second.length);
  assert.throws(() => core.frameSize(Buffer.alloc(200, 7)), CoreError);
});

test('memory is bounded', async () => {
  const core = await Core.create(BYTES, { megabytes: 1 });
  const n = 40000;
  assert.throws(() => core.level(new Float32Array(3 * n), new Uint32Array(6 * n)), (error) => error.type === 'out-of-memory');
});

test('levels as they are drawn: vertices doubled for their normals are one for the surface', async () => {
  const core = await Core.create(BYTES);
  // A square of two triangles with a doubled diagonal, and the same with its middle as a vertex.
  const coarse = core.level([0, 0, 0, 4, 0, 0, 4, 4, 0, 0, 0, 0, 4, 4, 0, 0, 4, 0], [0, 1, 2, 3, 4, 5]);
  const fine = core.level([0, 0, 0, 4, 0, 0, 4, 4, 0, 0, 4, 0, 1, 3, 1], [0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4]);
  const map = core.map(coarse, fine, 0.01);
  const drawn = map.draw({ values: 1, coarse: [1, 1, 1, 2, 2, 2], fine: [5, 5, 5, 5, 5] });
  assert.equal(drawn.mapped, 2);
  assert.equal(drawn.failed, 0);
  assert.equal(drawn.triangles.length / 3, 6);
  // At t = 0 everything lies in the plane, and the two sides of the diagonal keep their own value.
  for (let i = 2; i < drawn.start.length; i += 3) assert.equal(drawn.start[i], 0);
  assert.deepEqual([...new Set(drawn.startValues.map((x) => Math.round(x * 1e5) / 1e5))].sort(), [1, 2]);
  assert.ok(drawn.endValues.every((x) => Math.abs(x - 5) < 1e-5));
  assert.equal(map.draw({ exact: false }).triangles.length / 3, 4);
});

test('the module and its glue are at most 100 kB compressed', () => {
  const glue = ['core.js', 'core-worker.js', 'pool.js'].map((name) => readFileSync(path.join(ROOT, 'clients/web/src/wasm', name)));
  const size = gzipSync(BYTES, { level: 9 }).length + gzipSync(Buffer.concat(glue), { level: 9 }).length;
  assert.ok(size <= 100000, `${size} bytes`);
});
