/** Other people's readers take our documents: 3d-tiles-renderer the tileset, the Khronos validator the glTF with MSFT_lod. */

import assert from 'node:assert/strict';
import http from 'node:http';
import { readFileSync } from 'node:fs';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { build } from 'esbuild';
import validator from 'gltf-validator';
import { launch, openPage, ROOT } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, writePly } from './models.mjs';

const TEST = { timeout: 90000 };
const DRACO = path.join(ROOT, 'tests/web/node_modules/three/examples/jsm/libs/draco');
let browser, daemon, manifest, pages, origin;

before(async () => {
  [browser, daemon] = await Promise.all([launch(), Daemon.start()]);
  manifest = await daemon.bake('bumpy', writePly(bumpySphere(48)));
  const { outputFiles } = await build({ entryPoints: [path.join(ROOT, 'tests/web/tiles-page.js')], bundle: true, format: 'esm', write: false, logLevel: 'error' });
  pages = http.createServer((request, response) => {
    const name = new URL(request.url, 'http://page').pathname;
    if (name === '/') response.setHeader('content-type', 'text/html').end('<!doctype html><link rel="icon" href="data:,"><script type="module" src="page.js"></script>');
    else if (name === '/page.js') response.setHeader('content-type', 'text/javascript').end(outputFiles[0].text);
    else if (/^\/draco\/[\w.]+$/.test(name)) response.setHeader('content-type', name.endsWith('.wasm') ? 'application/wasm' : 'text/javascript').end(readFileSync(path.join(DRACO, path.basename(name))));
    else response.writeHead(404).end();
  });
  await new Promise((resolve) => pages.listen(0, '127.0.0.1', resolve));
  origin = `http://127.0.0.1:${pages.address().port}/`;
}, TEST);
after(async () => {
  await browser?.close();
  await daemon?.stop();
  pages?.closeAllConnections();
  await new Promise((resolve) => (pages ? pages.close(resolve) : resolve()));
});

test('3d-tiles-renderer draws the level whose certified error is under a pixel, coarser from afar', TEST, async () => {
  const page = await openPage(browser, { viewport: { width: 420, height: 420 } });
  try {
    await page.goto(origin);
    await page.waitForFunction(() => window.show);
    const tileset = await (await fetch(`${daemon.url}v1/models/bumpy/tileset.json`)).json();
    const [x, y, z, radius] = tileset.root.boundingVolume.sphere;
    await page.evaluate(([url, center, r]) => window.show(url, center, r), [`${daemon.url}v1/models/bumpy/tileset.json`, [x, y, z], radius]);
    const look = async (radii) => {
      await page.evaluate((d) => window.setDistance(d), radii);
      await page.waitForFunction(() => {
        const now = JSON.stringify(window.drawn());
        window.same = now === window.last ? (window.same ?? 0) + 1 : 0;
        window.last = now;
        return window.drawn().triangles > 0 && window.drawn().busy === 0 && window.same > 20;
      });
      return page.evaluate(() => window.drawn());
    };
    const levels = manifest.families.cluster.levels;
    const near = await look(2), far = await look(200);
    assert.ok(far.triangles < near.triangles, `${far.triangles} from afar, ${near.triangles} near`);
    for (const [radii, drawn] of [[2, near], [200, far]]) {
      const level = levels.find(({ error }) => Math.abs(error - drawn.error) < 1e-8 * error);
      assert.equal(drawn.triangles, level.triangles);
      // Its distance is to the bounding volume, as the standard says.
      const pixels = (drawn.error * 400) / (2 * (radii - 1) * radius * Math.tan(Math.PI / 6));
      assert.ok(pixels <= 1.1 || level === levels.at(-1), `${pixels} px`);
    }
    assert.deepEqual(await page.evaluate(() => window.failures), []);
    assert.deepEqual(page.faults.filter((fault) => fault.startsWith('page error') || fault.startsWith('error')), []);
  } finally {
    await page.context().close();
  }
});

test('the Khronos validator finds no error in the glTF over all levels, and every level in it', TEST, async () => {
  const url = `${daemon.url}v1/models/bumpy/model.glb`;
  const bytes = new Uint8Array(await (await fetch(url)).arrayBuffer());
  const fetched = [];
  const report = await validator.validateBytes(bytes, {
    uri: 'model.glb',
    externalResourceFunction: async (uri) => {
      fetched.push(uri);
      return new Uint8Array(await (await fetch(new URL(uri, url))).arrayBuffer());
    },
  });
  const worst = report.issues.messages.filter(({ severity }) => severity <= 1 && severity >= 0);
  assert.deepEqual(worst.filter(({ code }) => !['UNSUPPORTED_EXTENSION'].includes(code)), []);
  assert.ok(fetched.length >= 3);
  assert.ok(report.info.totalTriangleCount === undefined || report.info.totalTriangleCount > manifest.source.triangles, 'more than the finest level');
});
