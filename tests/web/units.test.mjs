/** Steps in units: what is asked for first, parts of one object, and a picture that grows part by part without an error or a crack. */

import assert from 'node:assert/strict';
import test from 'node:test';
import { PNG } from 'pngjs';
import { batches, lookOrder } from '../../clients/web/src/stream/units.js';
import { download } from '../../clients/web/src/stream/download.js';
import { figures, keep, launch, openPage, settled } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, writePly } from './models.mjs';

const ball = (x, y, z, offset, bytes, normal = [0, 0, 1]) => ({ center: [x, y, z], radius: 0.3, normal, offset, bytes });

test('what one looks at is asked for first, what is outside last', () => {
  const patches = [ball(0, 0, 9, 0, 10) /* behind */, ball(1, 0, 0, 10, 10), ball(0, 0, 0, 20, 10), ball(0.2, 0, 0, 30, 10, [0, 0, -1]) /* turned away */];
  const look = { eye: [0, 0, 5], direction: [0, 0, -1], halfAngle: 0.5 };
  assert.deepEqual(lookOrder(patches, [0, 1, 2, 3], look), [2, 1, 3, 0]);
  assert.deepEqual(lookOrder(patches, [0, 1], look), [1, 0]);
  assert.deepEqual(lookOrder(patches, [3, 0], null), [3, 0]);
});

test('patches side by side share a range, and a batch ends at its size', () => {
  const patches = [ball(0, 0, 0, 100, 10), ball(0, 0, 0, 110, 20), ball(0, 0, 0, 130, 30), ball(0, 0, 0, 160, 5)];
  assert.deepEqual(batches(patches, [3, 1, 0, 2], 40), [{ from: 100, to: 130, patches: [0, 1] }, { from: 160, to: 165, patches: [3] }]);
  assert.deepEqual(batches(patches, [2, 0], 1), [{ from: 130, to: 160, patches: [2] }], 'at least one');
});

test('a part of a body survives a lost connection, and a server without ranges', async () => {
  const body = Uint8Array.from({ length: 1000 }, (_, i) => i % 251);
  const asked = [];
  const server = (ranges) => async ({ headers }) => {
    asked.push(headers.range);
    const [, from, to] = /^bytes=(\d+)-(\d+)$/.exec(headers.range).map(Number);
    const bytes = ranges ? body.slice(from, to + 1) : body;
    const breaks = asked.length === 1 && ranges;
    const stream = new ReadableStream({
      start(controller) {
        controller.enqueue(breaks ? bytes.slice(0, 40) : bytes);
        if (!breaks) controller.close();
      },
      pull(controller) {
        controller.error(new TypeError('network error'));
      },
    }, { highWaterMark: 0 });
    return new Response(stream, { status: ranges ? 206 : 200, headers: { etag: '"one"' } });
  };
  const { bytes } = await download(server(true), { range: [200, 300], sleep: async () => {} });
  assert.deepEqual(bytes, body.slice(200, 300));
  assert.deepEqual(asked, ['bytes=200-299', 'bytes=240-299']);
  asked.length = 0;
  assert.deepEqual((await download(server(false), { range: [200, 300] })).bytes, body.slice(200, 300));
});

test('what is held is not read', async () => {
  let release;
  let held = new Promise((resolve) => (release = resolve));
  let read = 0;
  const request = async () => new Response(new ReadableStream({ pull(controller) {
    if (read++ < 3) controller.enqueue(new Uint8Array(10));
    else controller.close();
  } }, { highWaterMark: 0 }), { headers: { etag: '"one"' } });
  const done = download(request, { hold: () => held });
  await new Promise((resolve) => setTimeout(resolve, 30));
  assert.equal(read, 0);
  held = null;
  release();
  assert.equal((await done).bytes.length, 30);
});

/** Pixels inside the model's outline that show what is behind it: holes. */
function holes(png) {
  const at = (x, y) => png.data[4 * (y * png.width + x) + 3];
  let count = 0;
  for (let y = 1; y < png.height - 1; y++) {
    for (let x = 1; x < png.width - 1; x++) {
      if (at(x, y) < 255 && at(x - 1, y) === 255 && at(x + 1, y) === 255 && at(x, y - 1) === 255 && at(x, y + 1) === 255) count++;
    }
  }
  return count;
}

test('the page refines the part that one looks at first, and ends at the level', { timeout: 240000 }, async () => {
  const daemon = await Daemon.start(['--families', 'retile']);
  const browser = await launch();
  try {
    const manifest = await daemon.bake('bumpy', writePly(bumpySphere(60)), 'bumpy.ply', 120);
    const { levels } = manifest.families.retile;
    const from = levels.find((l) => l.delta?.units && l.delta.units.bytes < levels[l.delta.to].bytes);
    assert.ok(from, JSON.stringify(levels));
    const { units } = from.delta;
    const page = await openPage(browser, { viewport: { width: 480, height: 360 }, reducedMotion: 'no-preference' });
    page.setDefaultTimeout(120000);
    const ranges = [];
    await page.route(`**/v1/objects/${units.object}`, async (route) => { // a slow network
      ranges.push(route.request().headers().range);
      await new Promise((resolve) => setTimeout(resolve, 700));
      await route.continue();
    });
    await page.goto(`${daemon.url}#model=bumpy&family=retile&level=${from.level}`);
    await settled(page, 60000);
    const before = await figures(page);
    await page.evaluate((level) => (location.hash = `#model=bumpy&family=retile&level=${level}`), from.delta.to);
    await page.waitForFunction(() => document.getElementById('hud-level').textContent.includes('in part'));
    await page.addStyleTag({ content: 'body > :not(main) { visibility: hidden !important } body, main { background: transparent !important }' });
    keep('units-part.png', await page.screenshot({ omitBackground: true }));
    const png = PNG.sync.read(await page.screenshot({ omitBackground: true }));
    assert.equal(holes(png), 0, 'no crack between what is fine and what is coarse');
    await page.waitForFunction((level) => document.getElementById('hud-level').dataset.value === String(level), from.delta.to);
    await settled(page, 60000);
    const drawn = await figures(page);
    assert.equal(drawn.triangles, levels[from.delta.to].triangles);
    assert.equal(drawn.loaded - before.loaded, units.bytes, 'every byte came once');
    assert.equal(ranges[0], `bytes=0-${units.first - 1}`);
    assert.ok(ranges.length >= 3 && ranges.every((range) => /^bytes=\d+-\d+$/.test(range)), ranges.join(' '));
    assert.ok(!page.asked.some((url) => /\/delta\?/.test(url)), 'and not the whole step too');
    assert.deepEqual(page.faults, []);
  } finally {
    await browser.close();
    await daemon.stop();
  }
});
