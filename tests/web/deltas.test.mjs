/** Levels by deltas: bodies that survive a lost connection, and the page that takes deltas where they are fewer bytes. */

import assert from 'node:assert/strict';
import test from 'node:test';
import { parseManifest } from '../../clients/web/src/protocol/manifest.js';
import { DeltaLoader } from '../../clients/web/src/three/deltas.js';
import { download } from '../../clients/web/src/stream/download.js';
import { figures, launch, openPage, picture, settled } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, writePly } from './models.mjs';

const BODY = Uint8Array.from({ length: 5000 }, (_, i) => (i * 31) % 251);

/** A server whose n-th answer breaks after cuts[n] bytes. */
function breaking(cuts, { etag = () => '"one"', range = true } = {}) {
  const asked = [];
  const request = async ({ headers = {} }) => {
    const turn = asked.length;
    asked.push(headers.range ?? null);
    const from = range && headers.range ? Number(/^bytes=(\d+)-$/.exec(headers.range)[1]) : 0;
    const until = Math.min(BODY.length, from + (cuts[turn] ?? Infinity));
    if (cuts[turn] === -1) throw Object.assign(new Error('No answer'), { kind: 'unreachable' });
    let at = from;
    const body = new ReadableStream({
      pull(controller) {
        if (at >= until) {
          if (until < BODY.length) controller.error(new TypeError('network error'));
          else controller.close();
          return;
        }
        controller.enqueue(BODY.slice(at, Math.min(until, at + 700)));
        at += 700;
      },
    }, { highWaterMark: 0 });
    return new Response(body, { status: from > 0 ? 206 : 200, headers: { etag: etag(turn) } });
  };
  return { asked, request };
}

test('a connection that breaks is taken up where it broke', async () => {
  const { asked, request } = breaking([1500, 900, -1, 2000]);
  let counted = 0;
  const sizes = [];
  const waits = [];
  const { bytes } = await download(request, { onBytes: (n) => (counted += n), onGrown: (_, size) => void sizes.push(size), sleep: async (s) => void waits.push(s) });
  assert.deepEqual(bytes, BODY);
  assert.deepEqual(asked, [null, 'bytes=1500-', 'bytes=2400-', 'bytes=2400-', 'bytes=4400-']);
  assert.equal(counted, BODY.length, 'no byte came twice');
  assert.ok(sizes.every((size, i) => i === 0 || size > sizes[i - 1]));
  assert.ok(waits.length >= 4);
});

test('a body that has changed meanwhile begins anew', async () => {
  let restarts = 0;
  const { request } = breaking([2000], { etag: (turn) => (turn === 0 ? '"one"' : '"two"') });
  const { bytes } = await download(request, { onRestart: () => restarts++, sleep: async () => {} });
  assert.equal(restarts, 1);
  assert.deepEqual(bytes, BODY, 'the rest of another body is not taken for the whole');
});

test('a server without ranges sends all of it again', async () => {
  const { request } = breaking([2000], { range: false });
  const { bytes } = await download(request, { sleep: async () => {} });
  assert.deepEqual(bytes, BODY);
});

test('a connection that never holds ends in a sentence', async () => {
  const { asked, request } = breaking(Array(20).fill(0));
  await assert.rejects(download(request, { what: 'a delta', sleep: async () => {} }), /The connection broke while a delta arrived/);
  assert.ok(asked.length <= 8);
});

test('a manifest tells of its deltas', () => {
  const level = (n, delta) => ({ level: n, triangles: 1, error: 1 / (n + 1), bytes: 10, object: `o${n}`, ...(delta ? { delta } : {}) });
  const manifest = parseManifest({
    id: 'm', revision: 'r', source: { bounds: { min: [0, 0, 0], max: [1, 1, 1] } },
    families: { retile: { nested: true, levels: [level(0, { to: 1, bytes: 5, object: 'd' }), level(1)] } },
  });
  const { levels } = manifest.families.get('retile');
  assert.deepEqual(levels.map((l) => l.delta), [{ to: 1, bytes: 5, object: 'd', units: null }, null]);
  assert.deepEqual(manifest.units, [{ parts: [0], instances: null }]);
  const one = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const parts = [{ instances: [one, one] }, { instances: [one] }, { instances: [one, one, one] }, {}];
  const several = parseManifest({ id: 'm', revision: 'r', source: { bounds: { min: [0, 0, 0], max: [1, 1, 1] } }, parts, families: { retile: { levels: [level(0)] } } });
  assert.deepEqual(several.units.map((u) => [u.parts, u.instances?.length ?? null]), [[[1, 3], null], [[0], 2], [[2], 3]]);
});

test('a manifest tells what is proven of attributes', () => {
  const level = (n, drift) => ({ level: n, triangles: 1, error: 1 / (n + 1), bytes: 10, object: `o${n}`, ...(drift ? { drift } : {}) });
  const manifest = parseManifest({
    id: 'm', revision: 'r', source: { bounds: { min: [0, 0, 0], max: [1, 1, 1] } },
    families: { envelope: { levels: [level(0, { uv: 1, normal_degrees: 3, texels_bound: 4.5, uv_bound: 0.01, normal_degrees_bound: 10 }), level(1, { uv: 0, normal_degrees: 1 }), level(2)] } },
  });
  assert.deepEqual(manifest.families.get('envelope').levels.map((l) => l.attributes), [{ texels: 4.5, uv: 0.01, degrees: 10 }, null, null]);
});

test('the steps from a level that is on its way are waited for only where they are much less', async () => {
  const levels = [
    { family: 'f', level: 0, bytes: 1000, delta: { to: 1, bytes: 2000 } },
    { family: 'f', level: 1, bytes: 2400, delta: { to: 2, bytes: 3000 } },
    { family: 'f', level: 2, bytes: 9000, delta: null },
  ];
  const deltas = new DeltaLoader({ levels: () => levels });
  assert.equal(deltas.coming(levels[2]), null);
  let arrive;
  deltas.expect(levels[0], new Promise((resolve) => (arrive = resolve)));
  assert.equal(deltas.coming(levels[1]), null, '2000 instead of 2400 is not worth it');
  const coming = deltas.coming(levels[2]);
  assert.ok(coming, '5000 instead of 9000 is');
  assert.equal(deltas.coming({ ...levels[2], family: 'g' }), null);
  arrive();
  await coming;
  assert.equal(deltas.coming(levels[2]), null, 'it is there');
  deltas.expect(levels[0], Promise.reject(new Error('lost')));
  await deltas.coming(levels[2]);
  deltas.offer(levels[0], { bars: 0 });
  assert.equal(deltas.route(levels[2]).bytes, 5000);
  assert.equal(deltas.route(levels[1]).bytes, 2000);
  deltas.refused.add('f');
  assert.equal(deltas.route(levels[2]), null);
});

/* ---- the page against the daemon ---- */

test('the page sharpens by deltas, and what it draws is the level', { timeout: 180000 }, async () => {
  const daemon = await Daemon.start(['--families', 'retile']);
  const browser = await launch();
  try {
    const manifest = await daemon.bake('bumpy', writePly(bumpySphere(40)));
    const { levels } = manifest.families.retile;
    const from = levels.find((l) => l.delta && l.delta.bytes < levels[l.delta.to].bytes);
    assert.ok(from, 'a delta that is worth it');
    const page = await openPage(browser, { viewport: { width: 320, height: 240 } });
    page.setDefaultTimeout(60000);
    await page.goto(`${daemon.url}#model=bumpy&family=retile&level=${from.level}`);
    await settled(page, 60000);
    assert.equal((await figures(page)).level, from.level);
    const bytes = (await figures(page)).loaded;
    await page.evaluate((level) => (location.hash = `#model=bumpy&family=retile&level=${level}`), from.delta.to);
    await page.waitForFunction((level) => document.getElementById('hud-level').dataset.value === String(level), from.delta.to);
    await settled(page, 60000);
    const asked = page.asked.filter((url) => /\/(delta|level)\?/.test(url)).map((url) => url.replace(/^.*\/v1/, ''));
    assert.ok(asked.some((url) => url.endsWith(`/delta?family=retile&from=${from.level}&to=${from.delta.to}`)), asked.join(' '));
    const drawn = await figures(page);
    assert.equal(drawn.triangles, levels[from.delta.to].triangles);
    assert.equal(drawn.loaded - bytes, from.delta.bytes, 'the delta is all that came');
    assert.deepEqual(page.faults, []);
    await damaged(browser, daemon, levels, from);
  } finally {
    await browser.close();
    await daemon.stop();
  }
});

/** What comes wrong leaves the picture as it is; the level itself is asked for instead, and then no more deltas. */
async function damaged(browser, daemon, levels, from) {
  const url = `${daemon.url}v1/models/bumpy/delta?family=retile&from=${from.level}&to=${from.delta.to}`;
  const good = Buffer.from(await (await fetch(url)).arrayBuffer());
  const change = (at, value) => Buffer.concat([good.subarray(0, at), Buffer.from([value]), good.subarray(at + 1)]);
  const first = Buffer.from(await (await fetch(`${daemon.url}v1/models/bumpy/delta?family=retile`)).arrayBuffer());
  const ways = {
    'a flipped bit': change(good.length - 9, good.at(-9) ^ 4), truncated: good.subarray(0, good.length / 2), 'a later version': change(4, 99),
    'another base': first, 'a header of noise': change(20, good[20] ^ 255),
  };
  for (const [name, body] of Object.entries(ways)) {
    const page = await openPage(browser, { viewport: { width: 200, height: 150 } });
    page.setDefaultTimeout(60000);
    let shown = null;
    await page.route('**/delta?*', async (route) => {
      await route.fulfill({ status: 200, contentType: 'application/vnd.lodestream.delta', body });
    });
    await page.route((u) => u.pathname.endsWith('/level') && u.search.includes(`error=${levels[from.delta.to].error}`), async (route) => {
      shown = (await figures(page)).level; // while the level is on its way
      await route.continue();
    });
    await page.goto(`${daemon.url}#model=bumpy&family=retile&level=${from.level}`);
    await settled(page, 60000);
    await page.evaluate((level) => (location.hash = `#model=bumpy&family=retile&level=${level}`), from.delta.to);
    await page.waitForFunction((level) => document.getElementById('hud-level').dataset.value === String(level), from.delta.to);
    await settled(page, 60000);
    assert.equal(shown, from.level, `${name}: the picture stays at the last good level`);
    assert.equal((await figures(page)).triangles, levels[from.delta.to].triangles, name);
    assert.deepEqual(page.faults, [], name);
    await page.context().close();
  }
}

/** A glTF of two bumpy spheres that share a mesh, and one with another: two units. */
function twins(n) {
  const { positions, triangles } = bumpySphere(n);
  const points = Float32Array.from(positions.flat());
  const index = Uint32Array.from(triangles.flat());
  const bytes = Buffer.concat([Buffer.from(points.buffer), Buffer.from(index.buffer)]);
  const reach = (pick) => [0, 1, 2].map((k) => pick(...positions.map((p) => Math.fround(p[k]))));
  const mesh = { primitives: [{ attributes: { POSITION: 0 }, indices: 1 }] };
  return Buffer.from(JSON.stringify({
    asset: { version: '2.0' }, scene: 0, scenes: [{ nodes: [0, 1, 2] }],
    nodes: [{ mesh: 0, translation: [-3, 0, 0] }, { mesh: 0, translation: [3, 0, 0], scale: [0.5, 0.5, 0.5] }, { mesh: 1 }], meshes: [mesh, mesh],
    accessors: [
      { bufferView: 0, componentType: 5126, type: 'VEC3', count: positions.length, min: reach(Math.min), max: reach(Math.max) },
      { bufferView: 1, componentType: 5125, type: 'SCALAR', count: index.length },
    ],
    bufferViews: [{ buffer: 0, byteOffset: 0, byteLength: points.byteLength }, { buffer: 0, byteOffset: points.byteLength, byteLength: index.byteLength }],
    buffers: [{ byteLength: bytes.length, uri: `data:application/octet-stream;base64,${bytes.toString('base64')}` }],
  }));
}

test('a model of several units sharpens by deltas too, its instances with it', { timeout: 180000 }, async () => {
  const daemon = await Daemon.start(['--families', 'retile']);
  const browser = await launch();
  try {
    const manifest = await daemon.bake('twins', twins(30), 'twins.gltf');
    const { levels } = manifest.families.retile;
    const from = levels.find((l) => l.delta && l.delta.bytes < levels[l.delta.to].bytes);
    assert.ok(from, JSON.stringify(levels.map(({ level, bytes, delta }) => ({ level, bytes, delta }))));
    const shots = [];
    for (const whole of [false, true]) {
      const page = await openPage(browser, { viewport: { width: 320, height: 240 } });
      page.setDefaultTimeout(60000);
      if (!whole) {
        await page.goto(`${daemon.url}#model=twins&family=retile&level=${from.level}`);
        await settled(page, 60000);
      }
      await page.goto(`${daemon.url}#model=twins&family=retile&level=${from.delta.to}`);
      await page.waitForFunction((level) => document.getElementById('hud-level').dataset.value === String(level), from.delta.to);
      await settled(page, 60000);
      assert.equal(page.asked.some((url) => /\/delta\?/.test(url)), !whole, page.asked.join(' '));
      assert.deepEqual(page.faults, []);
      shots.push(await picture(page));
    }
    const [a, b] = shots.map((png) => png.data);
    let sum = 0;
    for (let i = 0; i < a.length; i++) sum += Math.abs(a[i] - b[i]);
    assert.ok(sum / a.length < 0.2, `the level by deltas looks like the level: mean difference ${sum / a.length}`);
  } finally {
    await browser.close();
    await daemon.stop();
  }
});
