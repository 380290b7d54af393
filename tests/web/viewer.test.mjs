/** The viewer in Chromium against the real daemon: upload, bake, stream, draw. */

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { compareGolden, covered, figures, keep, launch, openPage, picture, settled } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, checkerGlb, writePly } from './models.mjs';

const TEST = { timeout: 90000 };
let browser;
let daemon;
let manifest;
before(async () => {
  [browser, daemon] = await Promise.all([launch(), Daemon.start()]);
  manifest = await daemon.bake('bumpy', writePly(bumpySphere(48)));
}, TEST);
after(async () => {
  await browser?.close();
  await daemon?.stop();
});

async function withPage(options, run) {
  const page = await openPage(browser, options);
  try {
    await run(page);
    const strangers = page.asked.filter((url) => !url.startsWith(daemon.url) && !/^(blob|data):/.test(url));
    assert.deepEqual(strangers, [], 'no request leaves the server that the page came from');
  } finally {
    await page.context().close();
  }
}

const LEVELS = () => manifest.families.cluster.levels;

test('a model streams in, coarse first, until one pixel is kept; the figures are what the responses said', TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster`);
    await settled(page);
    const shown = await figures(page);
    const last = page.levels.at(-1).headers;
    assert.equal(shown.level, Number(last['lod-level']));
    assert.equal(shown.error, Number(last['lod-error']));
    assert.equal(shown.triangles, Number(last['lod-triangles']));
    assert.equal(shown.family, last['lod-family']);
    assert.equal(shown.loaded, page.levels.reduce((sum, l) => sum + Number(l.headers['content-length']), 0));
    const level = LEVELS()[shown.level];
    assert.deepEqual([shown.triangles, shown.error, shown.levelBytes], [level.triangles, level.error, level.bytes]);
    assert.ok(shown.px <= 1, `${shown.px} px`);
    const cheaper = LEVELS().filter((l) => l.bytes < level.bytes);
    assert.ok(cheaper.every((l) => (l.error / shown.error) * shown.px > 1), 'nothing with fewer bytes keeps one pixel');
    const errors = page.levels.map((l) => Number(l.headers['lod-error']));
    assert.deepEqual(errors, [...errors].sort((a, b) => b - a));
    assert.deepEqual(page.faults, []);
  }));

test('the picture is the golden one', TEST, () =>
  withPage({ viewport: { width: 480, height: 480 } }, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster`);
    await settled(page);
    const { part, ok } = compareGolden('bumpy', await picture(page));
    assert.ok(ok, `${(part * 100).toFixed(2)} % of the pixels differ; see build/web-tests/bumpy.png`);
  }));

test('farther away fewer triangles will do; a way that was gone before costs no byte', TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster`);
    await settled(page);
    const near = await figures(page);
    await page.focus('#canvas');
    const zoom = async (key) => {
      for (let i = 0; i < 16; i++) await page.keyboard.press(key);
      await settled(page);
      return figures(page);
    };
    const far = await zoom('-');
    assert.ok(far.triangles < near.triangles && far.px <= 1);
    const back = await zoom('+');
    assert.equal(back.level, near.level);
    await zoom('-');
    assert.equal((await zoom('+')).loaded, back.loaded);
  }));

test('a tighter tolerance brings a finer level, a looser one is remembered in the address', TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster&px=32`);
    await settled(page);
    const loose = await figures(page);
    assert.ok(loose.px <= 32);
    await page.focus('#canvas');
    for (let i = 0; i < 24; i++) await page.keyboard.press('[');
    await settled(page);
    const tight = await figures(page);
    assert.ok(tight.error < loose.error && tight.px <= 0.5);
    assert.match(page.url(), /px=0\.5/);
    await page.reload();
    await settled(page);
    assert.equal((await figures(page)).level, tight.level);
  }));

test("Low and Tan's rule: the largest cell that is not over X pixels", TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster&rule=cell&x=32`);
    await settled(page);
    await page.focus('#canvas');
    for (let i = 0; i < 6; i++) await page.keyboard.press('-');
    await settled(page);
    const shown = await figures(page);
    const limit = (32 * shown.error) / shown.px;
    const fitting = LEVELS().map((l) => l.cell ?? 0).filter((cell) => cell > 0 && cell <= limit);
    assert.ok(fitting.length > 0);
    assert.equal(LEVELS()[shown.level].cell, Math.max(...fitting));
  }));

test('a file that is dropped on the page is sent, baked and shown', TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy`);
    await settled(page);
    const bytes = writePly(bumpySphere(12)).toString('base64');
    const transfer = await page.evaluateHandle((base64) => {
      const data = new DataTransfer();
      data.items.add(new File([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))], 'Dropped thing.ply'));
      return data;
    }, bytes);
    await page.dispatchEvent('body', 'dragenter', { dataTransfer: transfer });
    assert.equal(await page.evaluate(() => document.body.classList.contains('dragging')), true);
    await page.dispatchEvent('body', 'drop', { dataTransfer: transfer });
    await page.waitForFunction(() => document.title === 'Dropped-thing - Lodestream', null, { timeout: 60000 });
    await settled(page);
    const dropped = await (await fetch(`${daemon.url}v1/models/Dropped-thing`)).json();
    assert.equal(dropped.source.triangles, bumpySphere(12).triangles.length);
    assert.equal(await page.locator('#uploads li').count(), 0);
    assert.deepEqual(page.faults, []);
  }));

test('smaller levels that a second bake adds are taken up where one looks', TEST, async () => {
  const twice = await Daemon.start(['--later-families', 'envelope']);
  const page = await openPage(browser, {});
  try {
    await page.goto(twice.url);
    await page.setInputFiles('#file', { name: 'later.ply', mimeType: 'application/octet-stream', buffer: writePly(bumpySphere(12)) });
    await page.waitForFunction(() => document.title === 'later - Lodestream', null, { timeout: 60000 });
    await page.waitForFunction(() => [...document.querySelectorAll('#family option')].some((o) => o.value === 'envelope'), null, { timeout: 60000 });
    await settled(page);
    assert.equal(await page.locator('#uploads li').count(), 0);
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
    await twice.stop();
  }
});

test('a file that is no model leaves a sentence that names it, and the model that was shown', TEST, () =>
  withPage({}, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy`);
    await settled(page);
    const torn = writePly(bumpySphere(12)).subarray(0, 3000);
    await page.setInputFiles('#file', { name: 'torn.ply', mimeType: 'application/octet-stream', buffer: torn });
    const alert = page.locator('#uploads [role="alert"]');
    await alert.waitFor({ timeout: 60000 });
    const text = await alert.textContent();
    assert.match(text, /^[A-Z].{15,}[.!?]$/s);
    assert.doesNotMatch(text, /undefined|NaN|\[object|status \d/);
    assert.equal((await fetch(`${daemon.url}v1/models/torn`)).status, 404);
    assert.equal(await page.title(), 'bumpy - Lodestream');
  }));

test('a textured model is drawn with its picture, which is fetched once for all levels', TEST, () =>
  withPage({ viewport: { width: 480, height: 480 } }, async (page) => {
    const checker = await daemon.bake('checker', checkerGlb(24), 'checker.glb');
    assert.equal(checker.textures.length, 1);
    await page.goto(`${daemon.url}#model=checker&px=32`);
    await settled(page);
    await page.focus('#canvas');
    for (let i = 0; i < 24; i++) await page.keyboard.press('[');
    await settled(page);
    assert.ok(page.levels.length >= 2);
    assert.equal(page.asked.filter((url) => url.endsWith(checker.textures[0].object)).length, 1);
    const { part, ok } = compareGolden('checker', await picture(page));
    assert.ok(ok, `${(part * 100).toFixed(2)} % of the pixels differ; see build/web-tests/checker.png`);
    assert.deepEqual(page.faults, []);
  }));

test('a phone: nothing scrolls sideways, sheets open and close, the model is drawn', TEST, () =>
  withPage({ viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, hasTouch: true, isMobile: true, colorScheme: 'dark' }, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy`);
    await settled(page);
    const overflow = () => page.evaluate(() => {
      const wide = [...document.querySelectorAll('body *')].filter((e) => {
        const box = e.getBoundingClientRect();
        return box.width > 0 && getComputedStyle(e).visibility !== 'hidden' && !e.closest('.hidden, svg') && (box.left < -1 || box.right > innerWidth + 1);
      });
      return { scroll: document.documentElement.scrollWidth - innerWidth, wide: wide.map((e) => e.outerHTML.slice(0, 80)) };
    });
    assert.deepEqual(await overflow(), { scroll: 0, wide: [] });
    keep('phone.png', await page.screenshot());
    for (const name of ['Models', 'View']) {
      await page.getByRole('button', { name, exact: true }).tap();
      assert.deepEqual(await overflow(), { scroll: 0, wide: [] });
      keep(`phone-${name.toLowerCase()}.png`, await page.screenshot());
    }
    assert.equal(await page.locator('.panel.open').count(), 1);
    const small = await page.evaluate(() =>
      [...document.querySelectorAll('.toggle, .panel.open button:not(.link), .panel.open .switch')].filter((e) => e.offsetParent && e.getBoundingClientRect().height < 32).map((e) => e.outerHTML.slice(0, 60)),
    );
    assert.deepEqual(small, [], 'everything can be met with a finger');
    await page.locator('#canvas').tap({ position: { x: 190, y: 724 } });
    assert.equal(await page.locator('.panel.open').count(), 0);
    const with_ = await picture(page);
    await page.evaluate(() => (document.getElementById('canvas').style.visibility = 'hidden'));
    assert.ok(covered(with_, await picture(page)) > 0.1);
    assert.deepEqual(page.faults, []);
  }));

test('turning fast draws a coarser level, resting brings the sharp one back', TEST, () =>
  withPage({ reducedMotion: 'no-preference', viewport: { width: 320, height: 240 } }, async (page) => {
    await page.goto(`${daemon.url}#model=bumpy&family=cluster&px=16`);
    await settled(page);
    // Sharpen step by step, so that coarser levels are at hand: motion never fetches.
    await page.focus('#canvas');
    for (let i = 0; i < 24; i++) {
      await page.keyboard.press('[');
      if (i % 4 === 3) await settled(page);
    }
    const rest = await figures(page);
    await page.evaluate(() => {
      window.seen = new Set();
      new MutationObserver(() => window.seen.add(document.getElementById('hud-level').dataset.value)).observe(document.getElementById('hud'), { subtree: true, attributes: true, childList: true, characterData: true });
    });
    // Back and forth across the whole picture, as a hand would.
    await page.mouse.move(60, 120);
    await page.mouse.down();
    for (let i = 0; i < 24; i++) await page.mouse.move(i % 2 ? 60 : 260, 120, { steps: 3 });
    await page.mouse.up();
    await page.waitForFunction((level) => document.getElementById('hud-level').dataset.value === level && document.getElementById('stage').getAttribute('aria-busy') === 'false', String(rest.level));
    const seen = (await page.evaluate(() => [...window.seen])).map(Number);
    assert.ok(seen.some((level) => level < rest.level), `levels while moving: ${seen}`);
  }));
