/** Curved patches in the browser: the module cuts what the daemon serves into triangles without cracks, and the page shows no facets at any zoom. */

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { ROOT, keep, launch, openPage } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, checkerGlb, writePly } from './models.mjs';
import { decodeCurves } from '../../clients/web/src/wasm/clod.js';

const TEST = { timeout: 240000 };
const WASM = readFileSync(path.join(ROOT, 'build/wasm/clod.wasm'));

let browser;
let daemon;
let manifest;
before(async () => {
  [browser, daemon] = await Promise.all([launch(), Daemon.start(['--families', 'clod'])]);
  manifest = await daemon.bake('bumpy', writePly(bumpySphere(20)), 'bumpy.ply', 200);
}, TEST);
after(async () => {
  await browser?.close();
  await daemon?.stop();
});

async function open(level) {
  const stream = new Uint8Array(await (await fetch(`${daemon.url}v1/models/bumpy/${level.patches.object}`)).arrayBuffer());
  const [curves, ...more] = await decodeCurves(WASM, stream);
  assert.equal(more.length, 0);
  assert.equal(curves.patches, level.patches.patches);
  return curves;
}
const levels = () => manifest.families.clod.levels.filter((level) => level.patches).sort((a, b) => a.patches.patches - b.patches.patches);

const viewFrom = (eye) => {
  const length = Math.hypot(...eye);
  const forward = eye.map((x) => -x / length);
  const side = Math.hypot(forward[2], forward[0]);
  const right = [-forward[2] / side, 0, forward[0] / side];
  const up = [right[1] * forward[2] - right[2] * forward[1], right[2] * forward[0] - right[0] * forward[2], right[0] * forward[1] - right[1] * forward[0]];
  return { eye, forward, up, fov: 45, aspect: 1.5, height: 600, near: length / 100 };
};

/** Edges, by position, that do not have two triangles, one in each direction. */
function openEdges({ positions, indices }) {
  const name = (v) => `${positions[3 * v]},${positions[3 * v + 1]},${positions[3 * v + 2]}`;
  const count = new Map();
  for (let t = 0; t < indices.length; t += 3)
    for (let k = 0; k < 3; k++) {
      const [a, b] = [name(indices[t + k]), name(indices[t + ((k + 1) % 3)])];
      if (a === b) continue;
      const [key, sign] = a < b ? [`${a} ${b}`, 1] : [`${b} ${a}`, -1];
      count.set(key, (count.get(key) ?? 0) + sign);
    }
  return [...count.values()].filter((n) => n !== 0).length;
}

test('every view is without cracks, within its pixels, and only what it asks for is made anew', TEST, async () => {
  const curves = await open(levels()[0]);
  for (const strict of [false, true]) {
    curves.set({ pixels: 4, cullOutside: false, cullBack: false, strict });
    for (const distance of [8, 3, 1.5, 5]) {
      const frame = curves.update(viewFrom([0.3 * distance, 0.2 * distance, 0.9 * distance]));
      assert.equal(openEdges(frame), 0, `a crack at ${distance}`);
      assert.ok(frame.pixels <= 4 && frame.triangles >= curves.patches);
    }
  }
  assert.ok(curves.strictDeviation > 0);
  const view = viewFrom([0.9, 0.6, 2.7]);
  curves.set({ pixels: 1 });
  const first = curves.update(view);
  assert.ok(first.back > 0 && first.visible + first.back + first.outside === first.patches);
  assert.equal(curves.update(view).patchesMade, 0);
  curves.close();
});

test('damaged streams are refused with a sentence', TEST, async () => {
  const level = levels()[0];
  const stream = new Uint8Array(await (await fetch(`${daemon.url}v1/models/bumpy/${level.patches.object}`)).arrayBuffer());
  stream[stream.length - 3] ^= 1;
  await assert.rejects(decodeCurves(WASM, stream), /damaged/);
  await assert.rejects(decodeCurves(WASM, stream.subarray(0, 20)), /damaged/);
});

const facts = (page) => page.evaluate(() => ({ ...document.getElementById('facts').dataset }));
const frames = (page, n) => page.evaluate(async (count) => {
  while (count-- > 0) await new Promise(requestAnimationFrame);
}, n);

test('the page tessellates as the camera moves, shows edges, nets and error on demand, and has no facets when near', TEST, async () => {
  const page = await openPage(browser, { viewport: { width: 800, height: 600 } });
  try {
    await page.goto(`${daemon.url}viewer/patches.html#model=bumpy`);
    await page.waitForSelector('body[data-ready=true]');
    await frames(page, 3);
    const far = await facts(page);
    assert.ok(Number(far.triangles) > 0 && Number(far.pixels) <= 0.5 && Number(far.back) > 0);
    keep('patches.png', await page.screenshot());
    const coarsest = String(levels()[0].level);
    await page.selectOption('#level', coarsest);
    await page.waitForFunction((n) => document.getElementById('facts').dataset.given === String(n), levels()[0].patches.patches);
    for (const id of ['edges', 'nets', 'error', 'wires']) {
      const before_ = await page.evaluate(() => document.getElementById('canvas').toDataURL());
      await page.check(`#${id}`);
      await page.waitForFunction((was) => document.getElementById('canvas').toDataURL() !== was, before_);
      keep(`patches-${id}.png`, await page.screenshot());
      await page.uncheck(`#${id}`);
    }
    const wide = await facts(page);
    await page.evaluate(() => { // a hundredth of the radius above the surface: patches need to be halved
      const { controls, camera } = window.page;
      controls.target.set(0.02, 0.02, 1.06);
      camera.position.set(0.03, 0.05, 1.12);
      controls.update();
    });
    await page.waitForFunction((n) => Number(document.getElementById('facts').dataset.patches) > n, Number(wide.patches));
    await frames(page, 2);
    const near = await facts(page);
    assert.ok(Number(near.patches) > Number(wide.patches) && Number(near.outside) > 0 && Number(near.pixels) <= 0.5, JSON.stringify(near));
    assert.ok(Number(near.triangles) < 200000, JSON.stringify(near));
    keep('patches-near.png', await page.screenshot());
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
  }
});

/** Reddish, and pale, pixels of the canvas: the squares of checkerGlb's picture. */
const squares = (page) => page.evaluate(() => {
  const canvas = document.getElementById('canvas');
  const context = Object.assign(document.createElement('canvas'), { width: canvas.width, height: canvas.height }).getContext('2d');
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  let [red, pale] = [0, 0];
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 255) continue;
    if (data[i] > 1.6 * data[i + 2]) red++;
    else pale++;
  }
  return { red, pale };
});

test('a textured model is drawn with its pictures while the camera moves, and its slip is told', TEST, async () => {
  const textured = await daemon.bake('checker', checkerGlb(24), 'checker.glb', 200);
  const curved = textured.families.clod.levels.filter((level) => level.patches);
  assert.ok(curved.length >= 2 && curved.every(({ patches }) => patches.slip.uv > 0 && patches.slip.texels > 0 && !('color' in patches.slip)), JSON.stringify(curved));
  const materials = await (await fetch(`${daemon.url}v1/models/checker/${textured.materials.object}`)).json();
  assert.equal(materials.materials.length, 1);
  assert.equal(materials.meshes, undefined);
  const page = await openPage(browser, { viewport: { width: 800, height: 600 } });
  try {
    await page.goto(`${daemon.url}viewer/patches.html#model=checker&level=${curved[0].level}&eye=0,0.4,3&target=0,0,0`);
    await page.waitForSelector('body[data-ready=true]');
    await frames(page, 3);
    const far = await squares(page);
    assert.ok(far.red > 0.3 * far.pale && far.pale > 0.3 * far.red, JSON.stringify(far));
    assert.match(await page.locator('#facts').inputValue().catch(() => page.locator('#facts').textContent()), /texels/);
    keep('patches-textured.png', await page.screenshot());
    await page.evaluate(() => { // the middle of one square, from so near that it is all there is
      const { controls, camera } = window.page;
      controls.target.set(0.06, 0.06, 0.04);
      camera.position.set(0.06, 0.06, 0.14);
      controls.update();
    });
    await frames(page, 3);
    const near = await squares(page);
    assert.ok(Math.max(near.red, near.pale) > 5 * Math.min(near.red, near.pale), JSON.stringify(near));
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
  }
});

test('the viewer leads to the page and back', TEST, async () => {
  const page = await openPage(browser);
  try {
    await page.goto(`${daemon.url}#model=bumpy`);
    await page.click('#curves');
    await page.waitForSelector('body[data-ready=true]');
    assert.match(page.url(), /patches\.html#model=bumpy/);
    assert.match(await page.locator('#back').getAttribute('href'), /#model=bumpy$/);
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
  }
});
