/** The viewer in Chromium against a daemon that misbehaves on command (mock.mjs). */

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { compareGolden, figures, launch, openPage, picture, covered, settled, VIEWER } from './browser.mjs';
import { Mock, mockModel } from './mock.mjs';
import { barTree, bumpySphere, writeGlb, writePly } from './models.mjs';

const TEST = { timeout: 60000 };
let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

function sphereLevel(rings, error) {
  const { positions, triangles } = bumpySphere(rings);
  return { glb: writeGlb({ primitives: [{ positions, indices: triangles }] }), error, triangles: triangles.length };
}

const LEVELS = [sphereLevel(6, 0.3), sphereLevel(14, 0.06), sphereLevel(40, 0.006)];
const sphere = (id = 'sphere', levels = LEVELS) => mockModel(id, levels, { radius: 1.2 });

async function withMock(options, models, run) {
  const mock = await new Mock({ viewer: VIEWER, ...options }).start();
  for (const model of models) mock.add(model);
  const page = await openPage(browser, options.page);
  try {
    await run(mock, page);
  } finally {
    await page.context().close();
    await mock.stop();
  }
}

test('a server that is down is said to be down, and found again when it is back', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    mock.broken = (request, url) => url.pathname.startsWith('/v1/');
    await page.goto(mock.url);
    const alert = page.getByRole('alert');
    await alert.waitFor();
    assert.match(await alert.textContent(), /^The server at 127\.0\.0\.1:\d+ cannot be reached\. Trying again in \d+ seconds?\./);
    mock.broken = () => false;
    await settled(page);
    assert.equal(await alert.count(), 0);
  }));

test('a level that breaks off is taken up where it broke', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    let cuts = 2;
    mock.cut = () => cuts-- > 0;
    await page.goto(mock.url);
    await settled(page);
    const shown = await figures(page);
    assert.ok(shown.triangles > 0);
    const ranges = mock.requests.filter((r) => r.range);
    assert.ok(ranges.length >= 2, JSON.stringify(ranges));
    const whole = mock.requests.filter((r) => /\/level$/.test(r.path) && !r.range);
    const levels = mock.models.get('sphere').manifest.families.cluster.levels;
    const bytes = whole.reduce((sum, r) => sum + levels.find((l) => l.error <= Number(r.query.get('error'))).bytes, 0);
    assert.equal(shown.loaded, bytes, 'no byte came twice');
    assert.equal(await page.getByRole('alert').count(), 0);
  }));

test('a level that is not answered is said so, asked for again, and arrives', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    mock.broken = (request, url) => /\/level$/.test(url.pathname);
    await page.goto(mock.url);
    await page.getByRole('alert').waitFor();
    assert.match(await page.getByRole('alert').textContent(), /^Level \d did not arrive: .* It is asked for again\./);
    mock.broken = () => false;
    await settled(page);
    assert.ok((await figures(page)).triangles > 0);
  }));

test('a level that is no GLB is an error in a sentence, and the page lives on', TEST, () =>
  withMock({}, [mockModel('bad', [{ glb: Buffer.from('not a GLB at all'), error: 0.1, triangles: 1 }]), sphere('good')], async (mock, page) => {
    await page.goto(`${mock.url}#model=bad`);
    await page.getByRole('alert').waitFor();
    assert.match(await page.getByRole('alert').textContent(), /Level 0 of bad cannot be read/);
    await page.getByRole('button', { name: /^good/ }).click();
    await settled(page);
    assert.equal(await page.title(), 'good - Lodestream');
  }));

test('coarse comes first and every picture is finer than the one before', TEST, () =>
  withMock({ delay: (request, url) => (url.searchParams.get('error') === '0.006' ? 700 : 0) }, [sphere()], async (mock, page) => {
    await page.goto(mock.url);
    await page.waitForFunction(() => document.getElementById('hud-level').dataset.value === '1');
    assert.equal(await page.locator('#stage').getAttribute('aria-busy'), 'true');
    await settled(page);
    const shown = await figures(page);
    assert.equal(shown.level, 2);
    assert.ok(shown.px <= 1.0 || shown.level === LEVELS.length - 1);
    const bytes = page.levels.map((l) => Number(l.headers['content-length']));
    assert.deepEqual(bytes, [...bytes].sort((a, b) => a - b));
    assert.equal(shown.loaded, bytes.reduce((a, b) => a + b, 0));
  }));

test('behind a path prefix everything is found', TEST, () =>
  withMock({ prefix: '/some/where' }, [sphere()], async (mock, page) => {
    await page.goto(mock.url);
    await settled(page);
    assert.deepEqual(page.faults, []);
    assert.ok(page.asked.every((url) => url.startsWith(mock.url)), page.asked.find((url) => !url.startsWith(mock.url)));
  }));

test('a model that was replaced while it was looked at is read anew', TEST, () =>
  withMock({}, [sphere('m', [sphereLevel(8, 0.2), sphereLevel(14, 0.06)])], async (mock, page) => {
    await page.goto(`${mock.url}#model=m&px=64`);
    await settled(page);
    const before = (await figures(page)).error;
    const next = sphere('m', [sphereLevel(8, 0.29), sphereLevel(30, 0.011)]);
    // The old revision's levels are gone: the mock answers 404 once for what the page still asks for.
    const answer = mock.answer.bind(mock);
    let gone = true;
    mock.answer = async (request, response) => {
      if (gone && /\/level\?/.test(request.url)) {
        gone = false;
        mock.add(next);
        response.writeHead(404, { 'content-type': 'application/problem+json' });
        return response.end('{"detail":"There is no such level."}');
      }
      return answer(request, response);
    };
    await page.focus('#canvas');
    for (let i = 0; i < 24; i++) await page.keyboard.press('[');
    await page.waitForFunction(() => document.getElementById('hud-units').dataset.value === '0.011');
    assert.notEqual((await figures(page)).error, before);
  }));

test('a bake that fails leaves its sentence with the upload and nothing else', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    mock.bake = () => [
      { state: 'queued', progress: 0 },
      { state: 'running', stage: 'import', progress: 0.1 },
      { state: 'failed', problem: { type: '/problems/truncated', status: 400, title: 'Truncated', detail: 'torn.ply ends after 10 of 20 faces' } },
    ];
    await page.goto(mock.url);
    await settled(page);
    await page.setInputFiles('#file', { name: 'torn.ply', mimeType: 'application/octet-stream', buffer: Buffer.from('ply') });
    await page.locator('#uploads [role="alert"]').waitFor();
    assert.equal(await page.locator('#uploads [role="alert"]').textContent(), 'Torn.ply ends after 10 of 20 faces.');
    assert.equal(await page.title(), 'sphere - Lodestream');
    await page.getByRole('button', { name: 'Dismiss' }).first().click();
    assert.equal(await page.locator('#uploads li').count(), 0);
  }));

test('a name that is taken asks first, and keeping both adds a second one', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    mock.bake = (id) => {
      mock.add(sphere(id));
      return [{ state: 'running', progress: 0.5, stage: 'cluster' }, { state: 'done', progress: 1 }];
    };
    await page.goto(mock.url);
    await settled(page);
    await page.setInputFiles('#file', { name: 'sphere.ply', mimeType: 'application/octet-stream', buffer: writePly(bumpySphere(4)) });
    await page.getByRole('button', { name: 'Add as sphere-2' }).click();
    await page.waitForFunction(() => document.title === 'sphere-2 - Lodestream');
    assert.deepEqual(mock.uploads.map((u) => [u.id, u.bytes.equals(writePly(bumpySphere(4)))]), [['sphere-2', true]]);
    assert.match(page.url(), /#model=sphere-2/);
  }));

test('deleting asks first and goes back to what is left', TEST, () =>
  withMock({}, [sphere('a'), sphere('b')], async (mock, page) => {
    await page.goto(`${mock.url}#model=b`);
    await settled(page);
    await page.getByRole('button', { name: 'Delete b' }).click();
    await page.getByRole('button', { name: 'Keep it' }).click();
    assert.equal(mock.models.size, 2);
    await page.getByRole('button', { name: 'Delete b' }).click();
    await page.getByRole('dialog').getByRole('button', { name: 'Delete' }).click();
    await page.waitForFunction(() => document.title === 'a - Lodestream');
    assert.deepEqual([...mock.models.keys()], ['a']);
  }));

test('no model: the page says what to do; one arrives from elsewhere: it is shown', TEST, () =>
  withMock({}, [], async (mock, page) => {
    await page.goto(mock.url);
    await page.getByRole('heading', { name: 'No models yet' }).waitFor();
    await page.goto(`${mock.url}#model=gone`);
    await page.reload();
    await page.getByRole('alert').waitFor();
    assert.match(await page.getByRole('alert').textContent(), /^There is no model gone on this server\./);
  }));

test('thick edges face the camera, are as wide as their thickness, and fade below a pixel without vanishing', TEST, () => {
  const positions = [[-1, 0, 0], [1, 0, 0]];
  const bar = (thickness) => mockModel('bar', [{ glb: writeGlb({ primitives: [{ mode: 1, positions, thickness: [thickness, thickness] }] }), error: 0, triangles: 0, edges: 1 }], { radius: 1 });
  return withMock({ page: { viewport: { width: 600, height: 600 } } }, [bar(0.2)], async (mock, page) => {
    await page.goto(`${mock.url}#model=bar`);
    await settled(page);
    assert.equal((await figures(page)).edges, 1);
    const blank = await backgroundOf(page);
    // Rows that the bar covers in the middle column, with what it should be: thickness / units per pixel at the bar's distance.
    const rows = (image) => {
      let n = 0;
      const x = 300;
      for (let y = 0; y < 600; y++) {
        const i = (y * 600 + x) * 4;
        n += [0, 1, 2].reduce((m, c) => Math.max(m, Math.abs(image.data[i + c] - blank.data[i + c])), 0) > 12 ? 1 : 0;
      }
      return n;
    };
    const wide = await picture(page);
    const facts = await page.evaluate(() => ({ px: Number(document.getElementById('hud-px').dataset.value) }));
    assert.equal(facts.px, 0);
    // half angle 22.5 degrees; the free part of a 600 x 600 picture with sheets is (600 - 50 - 112) high
    const half = Math.atan(Math.tan(Math.PI / 8) * (438 / 600));
    const distance = 1 / Math.sin(half);
    const expected = 0.2 / ((2 * distance * Math.tan(Math.PI / 8)) / 600);
    assert.ok(Math.abs(rows(wide) - expected) < 0.12 * expected + 2, `${rows(wide)} rows, expected ${expected}`);
    mock.add(bar(1e-4));
    await page.reload();
    await settled(page);
    const thin = await picture(page);
    assert.ok(rows(thin) <= 2);
    mock.add(bar(0.004));
    await page.reload();
    await settled(page);
    const pixelWide = await picture(page);
    assert.ok(rows(pixelWide) >= 1 && rows(pixelWide) <= 3);
    assert.ok(covered(pixelWide, blank) > 0);
  });
});

test('a tree of bars and a ball is a tree from every side', TEST, () => {
  const { positions, thickness } = barTree(3);
  const glb = writeGlb({ primitives: [{ mode: 1, positions, thickness }, { mode: 0, positions: [[0, 1.6, 0]], thickness: [0.3] }] });
  return withMock({ page: { viewport: { width: 500, height: 500 } } }, [mockModel('tree', [{ glb, error: 0, triangles: 0, edges: positions.length / 2, points: 1 }], { radius: 1.9 })], async (mock, page) => {
    await page.goto(`${mock.url}#model=tree`);
    await settled(page);
    const blank = await backgroundOf(page);
    await page.focus('#canvas');
    for (let side = 0; side < 4; side++) {
      const part = covered(await picture(page), blank);
      assert.ok(part > 0.01 && part < 0.3, `side ${side}: ${part}`);
      for (let i = 0; i < 6; i++) await page.keyboard.press(side === 2 ? 'ArrowDown' : 'ArrowRight');
      await settled(page);
    }
    assert.deepEqual(page.faults, []);
  });
});

test('what is drawn is the golden picture: a coarse sphere is smooth, a cube has edges, bars are round', TEST, () => {
  const { positions, thickness } = barTree(3);
  const cube = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1]);
  const faces = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]];
  const models = [
    mockModel('coarse', [sphereLevel(7, 0)], { radius: 1.2 }),
    mockModel('cube', [{ glb: writeGlb({ primitives: [{ positions: cube, indices: faces }] }), error: 0, triangles: 12 }], { radius: Math.sqrt(3) }),
    mockModel('tree', [{ glb: writeGlb({ primitives: [{ mode: 1, positions, thickness }] }), error: 0, triangles: 0, edges: positions.length / 2 }], { radius: 1.9 }),
  ];
  return withMock({ page: { viewport: { width: 400, height: 480 } } }, models, async (mock, page) => {
    for (const name of ['coarse', 'cube', 'tree']) {
      await page.goto(`${mock.url}#model=${name}`);
      await page.reload();
      await settled(page);
      const { part, ok } = compareGolden(name, await picture(page));
      assert.ok(ok, `${name}: ${(part * 100).toFixed(2)} % of the pixels differ; see build/web-tests/${name}.png`);
    }
    assert.deepEqual(page.faults, []);
  });
});

test('every control can be reached and used from the keyboard, and each has a name', TEST, () =>
  withMock({}, [sphere()], async (mock, page) => {
    await page.goto(mock.url);
    await settled(page);
    const nameless = await page.evaluate(() =>
      [...document.querySelectorAll('button, input:not([hidden]), select, [role="button"], svg[role]')]
        .filter((e) => !(e.getAttribute('aria-label') || e.labels?.length || e.textContent.trim() || e.getAttribute('aria-labelledby')))
        .map((e) => e.outerHTML),
    );
    assert.deepEqual(nameless, []);
    await page.focus('#canvas');
    const before = (await figures(page)).level;
    for (let i = 0; i < 14; i++) await page.keyboard.press('-');
    await settled(page);
    assert.ok((await figures(page)).level < before, 'farther away a coarser level will do');
    assert.ok((await figures(page)).px <= 1);
    await page.keyboard.press('w');
    assert.equal(await page.locator('#wire').isChecked(), true);
    await page.keyboard.press(']');
    assert.match(page.url(), /px=1\.19/);
    await page.locator('.dot').first().focus();
    await page.keyboard.press('Enter');
    await page.waitForFunction(() => document.getElementById('hud-level').dataset.value === '0');
    assert.match(page.url(), /level=0/);
    await page.getByRole('button', { name: 'Follow the view' }).click();
    await page.waitForFunction(() => document.getElementById('hud-level').dataset.value !== '0');
  }));

/** What lies behind the model: the page's gradient without it. */
async function backgroundOf(page) {
  await page.evaluate(() => (document.getElementById('canvas').style.visibility = 'hidden'));
  const image = await picture(page);
  await page.evaluate(() => (document.getElementById('canvas').style.visibility = ''));
  return image;
}
