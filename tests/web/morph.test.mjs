/** Geomorphs: t is continuous, the ends are the levels, a dive does not pop. The driver alone in node, the picture in headless Chromium. */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { copyFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync, cpSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import test from 'node:test';
import { MorphDriver, chooseRoute, screenTarget } from '../../clients/web/src/stream/morph.js';
import { ROOT, VIEWER, keep, launch, openPage } from './browser.mjs';
import { Mock } from './mock.mjs';
import { bumpySphere, writePly } from './models.mjs';

const WEB = path.join(ROOT, 'clients/web');

test('t moves at its rate, however the clock ticks', () => {
  const driver = new MorphDriver({ seconds: 2 });
  driver.begin(0, 1);
  assert.equal(driver.update(10), 0);
  assert.ok(Math.abs(driver.update(10.05) - 0.025) < 1e-12);
  assert.ok(driver.update(15) - 0.025 <= 1 / 30 + 1e-12, 'a hidden page does not make it jump');
  driver.aim(0);
  const t = driver.t;
  assert.ok(driver.update(15.01) < t && driver.t > 0);
});

test('a paused morph stays, and goes on from there', () => {
  const driver = new MorphDriver({ seconds: 1 });
  driver.begin(0, 1);
  driver.update(0);
  const t = driver.update(0.05);
  driver.pause();
  assert.equal(driver.update(5), t);
  driver.resume();
  assert.equal(driver.update(9), t);
  assert.ok(driver.update(9.05) > t);
  for (let s = 9.05; !driver.done; s += 0.05) driver.update(s);
  assert.equal(driver.t, 1);
});

test('the screen target is continuous in the view and ends where the coarse level would break the limit', () => {
  const coarse = { error: 0.01 };
  const at = (distance) => screenTarget(coarse, 1, { distance, fov: 60, height: 1000 });
  const breaks = (0.01 * 1000) / (2 * Math.tan(Math.PI / 6));
  assert.equal(at(breaks), 1);
  assert.equal(at(breaks * 2), 0);
  let last = at(breaks * 3);
  for (let d = breaks * 3; d > breaks / 2; d *= 0.99) {
    assert.ok(at(d) >= last && at(d) - last < 0.05);
    last = at(d);
  }
});

test('deltas are taken when they are fewer bytes than the level itself', () => {
  const levels = [
    { level: 0, bytes: 1000, delta: { to: 1, bytes: 2000 } },
    { level: 1, bytes: 4000, delta: { to: 2, bytes: 9000 } },
    { level: 2, bytes: 12000, delta: null },
  ];
  assert.deepEqual(chooseRoute(levels, null, levels[2]), { kind: 'level', level: levels[2], bytes: 12000 });
  assert.deepEqual(chooseRoute(levels, levels[0], levels[2]), { kind: 'deltas', steps: [levels[0], levels[1]], bytes: 11000 });
  assert.deepEqual(chooseRoute(levels, levels[1], levels[2]), { kind: 'deltas', steps: [levels[1]], bytes: 9000 });
  assert.equal(chooseRoute(levels, levels[2], levels[0]).kind, 'level');
  levels[1].delta.bytes = 12001;
  assert.equal(chooseRoute(levels, levels[1], levels[2]).kind, 'level');
  levels[1].delta = null;
  assert.equal(chooseRoute(levels, levels[0], levels[2]).kind, 'level');
});

/* ---- the picture ---- */

const folder = mkdtempSync(path.join(tmpdir(), 'lodestream-morph-'));
let browser;
let mock;
let page;
let levels;

test.before(async () => {
  writeFileSync(path.join(folder, 'bumpy.ply'), writePly(bumpySphere(60)));
  execFileSync(path.join(ROOT, 'build/release/lodestream'), ['bake', path.join(folder, 'bumpy.ply'), '-o', path.join(folder, 'bake'), '--family', 'retile', '--vertices', '150,600,2400'], { stdio: 'pipe' });
  const manifest = JSON.parse(readFileSync(path.join(folder, 'bake/manifest.json'), 'utf8'));
  levels = manifest.families.retile.levels.slice(0, 3);
  const site = path.join(folder, 'site');
  cpSync(VIEWER, site, { recursive: true });
  execFileSync(path.join(WEB, 'node_modules/.bin/esbuild'), [path.join(ROOT, 'tests/web/harness.js'), '--bundle', '--format=esm', '--target=es2022', '--log-level=warning', `--outfile=${path.join(site, 'harness.js')}`], { stdio: 'pipe' });
  writeFileSync(path.join(site, 'index.html'), '<!doctype html><link rel="icon" href="data:,"><body style="margin:0"><script type="module" src="viewer/harness.js"></script>');
  levels.forEach((level, i) => copyFileSync(path.join(folder, 'bake/objects', level.object), path.join(site, `level-${i}.glb`)));
  mock = await new Mock({ viewer: site }).start();
  browser = await launch();
  page = await openPage(browser, { viewport: { width: 400, height: 300 } });
  await page.goto(mock.url);
  await page.waitForFunction(() => window.harness !== undefined);
  const triangles = await page.evaluate(([urls, errors]) => window.harness.load(urls, errors), [levels.map((_, i) => `viewer/level-${i}.glb`), levels.map((l) => l.error)]);
  assert.deepEqual(triangles, levels.map((l) => l.triangles));
});

test.after(async () => {
  await browser?.close();
  await mock?.stop();
  rmSync(folder, { recursive: true, force: true });
});

const photograph = async (name) => keep(`morph-${name}.png`, await page.locator('canvas').screenshot());

test('at t = 0 and t = 1 the picture is the levels\' own', async () => {
  const made = await page.evaluate(() => window.harness.prepare(true));
  assert.ok(made, 'the levels can be morphed');
  for (const [i, { triangles }] of made.entries()) assert.ok(triangles > levels[i + 1].triangles && triangles < 4 * levels[i + 1].triangles);
  for (const [i, { start, end }] of (await page.evaluate(() => window.harness.ends(3))).entries()) {
    console.log(`# morph ${i}: t = 0 differs by ${start.toFixed(4)}, t = 1 by ${end.toFixed(4)} of 255`);
    assert.ok(start <= 0.1, `t = 0 of morph ${i} differs from its level by ${start}`);
    assert.ok(end <= 0.1, `t = 1 of morph ${i} differs from its level by ${end}`);
  }
  for (const t of [0, 0.5, 1]) {
    await page.evaluate((x) => window.harness.show({ morph: 0, t: x }, 3), t);
    await photograph(`t${t}`);
  }
});

test('a dive does not pop', async () => {
  // The coarsest level is enough down to a distance of 6, so that every step is seen from near.
  const pixels = (levels[0].error * 300) / (2 * 6 * Math.tan(Math.PI / 8));
  const dive = (mode) => page.evaluate((o) => window.harness.dive(o), { frames: 150, from: 9, to: 1.5, pixels, mode });
  const off = await dive('off');
  const time = await dive('time');
  const screen = await dive('screen');
  console.log(`# largest mean change between frames: swaps ${off.largest.toFixed(2)}, by time ${time.largest.toFixed(3)}, by screen error ${screen.largest.toFixed(3)}`);
  assert.ok(off.steps >= 2 && time.steps >= 2 && screen.steps >= 2, 'the dive crosses the levels');
  assert.ok(off.largest > 3 * time.largest, `swaps pop: ${off.largest} against ${time.largest}`);
  assert.ok(time.largest <= 1.5, `by time: ${time.largest}`);
  assert.ok(screen.largest <= 1.5, `by screen error: ${screen.largest}`);
});

test('the cheap morph has no more triangles than the finer level', async () => {
  const made = await page.evaluate(() => window.harness.prepare(false));
  assert.deepEqual(made.map((m) => m.triangles), levels.slice(1).map((l) => l.triangles));
  const ends = await page.evaluate(() => window.harness.ends(3));
  for (const { start, end } of ends) {
    assert.ok(end <= 0.1);
    assert.ok(start > 0, 'where triangles straddle coarse edges the shape differs');
  }
  assert.deepEqual(page.faults, []);
});
