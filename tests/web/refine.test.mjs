/** Refinement in the browser: the module gives the bits that the tool gives; the page follows the mouse within its budget. */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { ROOT, keep, launch, openPage } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, writeGlb, writePly } from './models.mjs';
import { Births, Refinement } from '../../clients/web/src/wasm/refine.js';

const TEST = { timeout: 120000 };
const WASM = readFileSync(path.join(ROOT, 'build/wasm/refine.wasm'));
const TOOL = path.join(ROOT, process.env.LODESTREAM_BUILD ?? 'build/release', 'lodestream');

/** An octahedron: small, and none of its numbers is odd. */
const OCTAHEDRON = {
  positions: new Float32Array([1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1]),
  index: new Uint32Array([0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5]),
};

function ply({ positions, index }) {
  const rows = (list) => Array.from({ length: list.length / 3 }, (_, i) => [...list.slice(3 * i, 3 * i + 3)]);
  return `ply\nformat ascii 1.0\nelement vertex ${positions.length / 3}\nproperty float x\nproperty float y\nproperty float z\n` +
    `element face ${index.length / 3}\nproperty list uchar int vertex_indices\nend_header\n` +
    `${rows(positions).map((p) => p.join(' ')).join('\n')}\n${rows(index).map((f) => `3 ${f.join(' ')}`).join('\n')}\n`;
}

/** Positions, as bytes, of a GLB that the tool wrote. */
function toolPositions(args) {
  const folder = mkdtempSync(path.join(os.tmpdir(), 'lodestream-refine-'));
  try {
    writeFileSync(path.join(folder, 'in.ply'), ply(OCTAHEDRON));
    execFileSync(TOOL, ['refine', path.join(folder, 'in.ply'), '-o', path.join(folder, 'out.glb'), ...args]);
    const glb = readFileSync(path.join(folder, 'out.glb'));
    const length = glb.readUInt32LE(12);
    const json = JSON.parse(glb.subarray(20, 20 + length));
    const view = json.bufferViews[json.accessors[json.meshes[0].primitives[0].attributes.POSITION].bufferView];
    return glb.subarray(28 + length + view.byteOffset, 28 + length + view.byteOffset + view.byteLength);
  } finally {
    rmSync(folder, { recursive: true });
  }
}

test('the module gives what the tool gives, bit for bit', TEST, async () => {
  const refinement = await Refinement.create(WASM, OCTAHEDRON);
  for (const [interest, args] of [
    [{ kind: 'uniform' }, ['--doi', 'uniform']],
    [{ kind: 'face', eye: [3, 1, 2] }, ['--doi', 'silhouette', '--eye', '3,1,2']],
    [{ kind: 'cone', direction: [1, 2, 3] }, ['--doi', 'silhouette', '--form', 'cone', '--direction', '1,2,3']],
    [{ kind: 'curvature' }, ['--doi', 'curvature']],
    [{ kind: 'gaze', eye: [0, 0, 4], look: [0.5, 0, -4] }, ['--doi', 'gaze', '--eye', '0,0,4', '--look', '0.5,0,0']],
  ]) {
    refinement.interest(interest);
    refinement.run({ steps: 5, maxTriangles: 20000 });
    const ours = refinement.mesh().positions;
    const theirs = toolPositions([...args, '--steps', '5', '--max-triangles', '20000']);
    assert.deepEqual(Buffer.from(ours.buffer), Buffer.from(theirs), args.join(' '));
  }
  refinement.close();
});

test('frames stay within operations and budget, and settle', TEST, async () => {
  const refinement = await Refinement.create(WASM, OCTAHEDRON);
  const births = new Births(0.3);
  let grew = false;
  for (let frame = 0; frame < 60; frame++) {
    const a = Math.min(frame, 30) / 10;
    refinement.interest({ kind: 'gaze', eye: [0, 0, 3], look: [Math.sin(a), Math.cos(a), -3] });
    const count = refinement.update({ steps: 7, maxTriangles: 5000, maxOperations: 200 });
    assert.ok(count <= 200);
    const { triangles, ids } = refinement.mesh();
    assert.ok(triangles <= 5000);
    const times = births.times(ids, frame / 60);
    grew ||= frame > 0 && births.growing(times, frame / 60);
    if (frame === 59) assert.equal(count, 0);
  }
  assert.ok(grew, 'new vertices grow');
  assert.ok(!births.growing(births.times(refinement.mesh().ids, 2), 2), 'and are grown after a while');
  refinement.close();
});

test('contact touches the surface', TEST, async () => {
  const refinement = await Refinement.create(WASM, OCTAHEDRON);
  refinement.interest({ kind: 'contact', point: [0, 0, 2] });
  const { point, normal, distance } = refinement.contact(6);
  assert.ok(point[2] > 0.4 && normal[2] > 0.99 && Math.abs(distance - (2 - point[2])) < 0.01);
  refinement.close();
});

test('values of the client refine where they are', TEST, async () => {
  const refinement = await Refinement.create(WASM, OCTAHEDRON);
  assert.throws(() => refinement.interest({ kind: 'attribute' }), /no values/);
  refinement.values(new Float32Array([1, 0, 0, 0, 0, 0])); // at [1, 0, 0]
  refinement.interest({ kind: 'attribute' });
  refinement.run({ steps: 4 });
  const { positions, index, levels } = refinement.mesh();
  const x = (t) => [0, 1, 2].reduce((sum, k) => sum + positions[3 * index[3 * t + k]], 0) / 3;
  const finest = Math.max(...levels);
  assert.equal(finest, 4);
  for (let t = 0; t < levels.length; t++) if (levels[t] === finest) assert.ok(x(t) > 0, `${x(t)}`);
  assert.ok(levels.length < 8 * 4 ** 4 / 2);
  refinement.close();
});

let browser;
let daemon;
before(async () => {
  [browser, daemon] = await Promise.all([launch(), Daemon.start()]);
  await daemon.bake('bumpy', writePly(bumpySphere(48)));
}, TEST);
after(async () => {
  await browser?.close();
  await daemon?.stop();
});

const facts = (page) => page.evaluate(() => ({ ...document.getElementById('facts').dataset }));
async function settle(page) {
  await page.waitForFunction(() => {
    const { operations, frame } = document.getElementById('facts').dataset;
    return Number(frame) > 5 && operations === '0';
  });
}

test('each interest refines, within the budget, and the mouse moves the gaze', TEST, async () => {
  const page = await openPage(browser, { viewport: { width: 640, height: 480 } });
  try {
    await page.goto(`${daemon.url}viewer/refine.html#model=bumpy&kind=gaze&steps=4`);
    await page.waitForSelector('body[data-ready=true]');
    await page.mouse.move(250, 240);
    await settle(page);
    const left = await facts(page);
    assert.ok(Number(left.triangles) > Number(left.base) && Number(left.triangles) <= 60000);
    keep('refine-gaze.png', await page.screenshot());
    const before_ = await page.evaluate(() => document.getElementById('canvas').toDataURL());
    await page.mouse.move(420, 200);
    await page.waitForFunction((was) => document.getElementById('canvas').toDataURL() !== was, before_);
    assert.match(await page.getAttribute('#back', 'href'), /model=bumpy/);
    for (const kind of ['focus', 'part', 'contact', 'face', 'silhouette', 'cone', 'static', 'curvature', 'screen', 'patches', 'attribute']) {
      await page.selectOption('#kind', kind);
      await page.waitForTimeout(300);
      if (kind !== 'contact') await settle(page);
      const now = await facts(page);
      assert.ok(Number(now.triangles) >= Number(now.base) && Number(now.triangles) <= 60000, kind);
      if (kind === 'focus' || kind === 'cone') keep(`refine-${kind}.png`, await page.screenshot());
    }
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
  }
});

/** An arm along x with a bracelet and a ball at its end: three parts. */
function armWithBracelet() {
  // Rings of `around` vertices at [x, radius], one after the other; closed: the last leads to the first.
  const ringed = (rings, around, closed = false) => {
    const positions = rings.flatMap(([x, r]) => Array.from({ length: around }, (_, j) => [x, r * Math.cos((2 * Math.PI * j) / around), r * Math.sin((2 * Math.PI * j) / around)]));
    const at = (i, j) => (i % rings.length) * around + (j % around);
    const indices = [];
    for (let i = 0; i + (closed ? 0 : 1) < rings.length; i++)
      for (let j = 0; j < around; j++) indices.push([at(i, j), at(i, j + 1), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
    return { positions, indices };
  };
  const circle = (n, phase, x, r, size) => Array.from({ length: n }, (_, i) => [x + size * Math.cos((-2 * Math.PI * i) / n + phase), r + size * Math.sin((-2 * Math.PI * i) / n + phase)]);
  return writeGlb({
    apart: true,
    primitives: [
      ringed(Array.from({ length: 9 }, (_, i) => [i - 4, i === 0 || i === 8 ? 0.25 : 0.6]), 12),
      ringed(circle(7, 0, 0, 0.8, 0.18), 14, true),
      ringed(Array.from({ length: 6 }, (_, i) => [5 - Math.cos((Math.PI * (i + 0.5)) / 6), Math.sin((Math.PI * (i + 0.5)) / 6)]), 10),
    ],
  });
}

test('the viewer leads to the page, and a part of several comes into focus', TEST, async () => {
  const page = await openPage(browser, { viewport: { width: 1100, height: 700 } });
  try {
    await daemon.bake('arm', armWithBracelet(), 'arm.glb');
    await page.goto(`${daemon.url}#model=arm`);
    await page.waitForSelector('#refine:not([hidden])');
    keep('refine-links.png', await page.screenshot());
    await page.click('#refine a[data-kind=part]');
    await page.waitForSelector('body[data-ready=true]');
    assert.match(page.url(), /refine\.html#model=arm&kind=part/);
    const canvas = await page.locator('#canvas').boundingBox();
    await page.fill('#steps', '3');
    const at = async (x, y) => {
      await page.mouse.move(canvas.x + x * canvas.width, canvas.y + y * canvas.height);
      await page.waitForTimeout(300);
      await settle(page);
      return Number((await facts(page)).triangles);
    };
    const ball = await at(0.72, 0.56);
    const bracelet = await at(0.459, 0.422);
    keep('refine-part.png', await page.screenshot());
    await page.mouse.click(canvas.x + 0.459 * canvas.width, canvas.y + 0.422 * canvas.height);
    assert.equal(await at(0.72, 0.56), bracelet, 'a click holds the part');
    const base = Number((await facts(page)).base);
    assert.ok(ball > 2 * base && bracelet > 2 * base && ball !== bracelet, `${base} ${ball} ${bracelet}`);
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
  }
});
