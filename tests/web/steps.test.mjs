/** Steps between levels in the page against the real daemon: what its settings do, and what damage and a lost connection leave of the picture. */

import assert from 'node:assert/strict';
import net from 'node:net';
import { after, before, test } from 'node:test';
import { figures, launch, openPage, picture, settled } from './browser.mjs';
import { Daemon } from './daemon.mjs';
import { bumpySphere, writePly } from './models.mjs';

const TEST = { timeout: 300000 };
const WAIT = 120000;
let daemon;
let nested;
let browser;
let manifests;
before(async () => {
  [browser, daemon, nested] = await Promise.all([launch(), Daemon.start(['--families', 'retile']), Daemon.start(['--families', 'envelope', '--envelope', 'nested=1'])]);
  const file = writePly(bumpySphere(40));
  const [retile, envelope] = await Promise.all([daemon, nested].map((d) => d.bake('bumpy', file, 'bumpy.ply', 240)));
  manifests = { retile: retile.families.retile, envelope: envelope.families.envelope };
});
after(async () => {
  await browser?.close();
  await daemon?.stop();
  await nested?.stop();
});

/** The first level from which a delta is worth it. */
const stepOf = ({ levels }) => {
  const from = levels.find((l) => l.delta && l.delta.bytes < levels[l.delta.to].bytes);
  assert.ok(from, JSON.stringify(levels));
  return { from, to: levels[from.delta.to] };
};

async function open(url, family, level, options = {}) {
  const page = await openPage(browser, { viewport: { width: 360, height: 270 }, reducedMotion: 'no-preference', ...options });
  page.setDefaultTimeout(WAIT);
  await page.goto(`${url}#model=bumpy&family=${family}&level=${level}`);
  await settled(page, WAIT);
  assert.equal((await figures(page)).level, level);
  return page;
}

const choose = (page, settings) =>
  page.evaluate((all) => {
    for (const [id, value] of Object.entries(all)) {
      document.getElementById(id).value = value;
      document.getElementById(id).dispatchEvent(new Event('change'));
    }
  }, settings);

/** From now on every t that the page shows, and how many triangles are drawn with it. */
const record = (page) =>
  page.evaluate(() => {
    const morph = document.getElementById('hud-morph');
    window.recorded = [];
    new MutationObserver(() => {
      if (morph.dataset.value !== '') window.recorded.push({ t: Number(morph.dataset.value), drawn: Number(morph.dataset.drawn) });
    }).observe(morph, { attributes: true, attributeFilter: ['data-value'] });
  });

async function reach(page, family, level) {
  await page.evaluate(([f, l]) => (location.hash = `#model=bumpy&family=${f}&level=${l}`), [family, level]);
  await page.waitForFunction((l) => document.getElementById('hud-level').dataset.value === String(l), level);
  await settled(page, WAIT);
}

for (const shapes of ['exact', 'cheap']) {
  test(`by time a level grows out of the one before, by ${shapes === 'exact' ? 'fragments' : 'vertices'}`, TEST, async () => {
    const { from, to } = stepOf(manifests.retile);
    const page = await open(daemon.url, 'retile', from.level);
    await choose(page, { drive: 'time', shapes });
    await record(page);
    await reach(page, 'retile', to.level);
    const seen = await page.evaluate(() => window.recorded);
    assert.ok(seen.length >= 3, `${seen.length} pictures on the way`);
    assert.ok(seen.every(({ t }, i) => i === 0 || t >= seen[i - 1].t), `t rises: ${seen.map(({ t }) => t)}`);
    assert.ok(seen[0].t < 0.3 && seen.some(({ t }) => t > 0.1 && t < 0.9), `no jump: ${seen.map(({ t }) => t)}`);
    for (const { drawn } of seen) {
      if (shapes === 'exact') assert.ok(drawn > to.triangles, `${drawn} fragments of ${to.triangles} triangles`);
      else assert.equal(drawn, to.triangles);
    }
    assert.equal(await page.locator('#hud-morph').textContent(), '', 'at the end the level alone is drawn');
    assert.equal((await figures(page)).triangles, to.triangles);
    assert.deepEqual(page.faults, []);
    await page.context().close();
  });
}

test('by the error on screen a level grows as one comes near, rests when one rests, and goes back', TEST, async () => {
  const { levels } = manifests.retile;
  // The finer level must be enough while the coarser one is between half the limit and the limit.
  const from = levels.find((l) => l.delta && l.delta.bytes < levels[l.delta.to].bytes && levels[l.delta.to].error < 0.45 * l.error);
  assert.ok(from, JSON.stringify(levels));
  const to = levels[from.delta.to];
  const page = await open(daemon.url, 'retile', from.level);
  await choose(page, { drive: 'error' });
  const limit = (await figures(page)).px / 0.75; // so half of the step is made
  await page.evaluate((px) => (location.hash = `#model=bumpy&family=retile&px=${px}`), limit);

  /** t that the view asks for, and t, triangles and level as they are drawn, when nothing moves. */
  const resting = async () => {
    await page.waitForFunction(() => document.getElementById('stage').getAttribute('aria-busy') === 'false');
    return page.evaluate(([coarse, most]) => {
      const data = (id) => document.getElementById(id).dataset;
      const { value, drawn } = data('hud-morph');
      const px = (coarse * Number(data('hud-px').value)) / Number(data('hud-units').value);
      return { wanted: Math.min(1, Math.max(0, (2 * px) / most - 1)), t: value === '' || value === undefined ? null : Number(value), drawn: Number(drawn), level: Number(data('hud-level').value) };
    }, [from.error, limit]);
  };
  /** The same once t is what the view asks for. */
  const arrive = async (good) => {
    let seen;
    for (const end = Date.now() + WAIT; Date.now() < end; await page.waitForTimeout(50)) {
      seen = await resting();
      if (good(seen)) return seen;
    }
    assert.fail(JSON.stringify(seen));
  };
  const there = ({ t, wanted }) => t !== null && Math.abs(t - wanted) < 0.01;
  const half = await arrive(there);
  assert.ok(half.t > 0.45 && half.t < 0.55, `half of the step: ${half.t}`);
  assert.ok(half.drawn > to.triangles, `${half.drawn} fragments of ${to.triangles} triangles`);
  assert.equal(half.level, to.level);
  await page.waitForTimeout(300);
  assert.equal((await resting()).t, half.t, 'it rests while the view rests');

  await page.focus('#canvas');
  await page.keyboard.press('-');
  const farther = await arrive((s) => there(s) && s.wanted < half.wanted);
  await page.keyboard.press('+');
  const again = await arrive((s) => there(s) && s.wanted > farther.wanted);
  assert.ok(farther.t < half.t && again.t > farther.t, `${half.t}, farther ${farther.t}, again ${again.t}`);

  for (let i = 0; i < 30; i++) await page.keyboard.press('-');
  const far = await arrive((s) => s.t === null);
  assert.ok(far.level <= from.level, `far away the coarser level alone: ${far.level}`);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test('nested levels of the envelope: the step instead of the level, and a morph', TEST, async () => {
  const { envelope } = manifests;
  assert.equal(envelope.nested, true);
  const { from, to } = stepOf(envelope);
  const answer = await fetch(`${nested.url}v1/models/bumpy/level?family=envelope&error=${to.error}&have=${from.level}`);
  assert.equal(answer.headers.get('content-type'), 'application/vnd.lodestream.delta');
  assert.equal((await answer.arrayBuffer()).byteLength, from.delta.bytes);
  const page = await open(nested.url, 'envelope', from.level);
  const before = (await figures(page)).loaded;
  await record(page);
  await reach(page, 'envelope', to.level);
  const after = await figures(page);
  assert.equal(after.loaded - before, from.delta.bytes, 'the step is all that came');
  assert.equal(after.triangles, to.triangles);
  const seen = await page.evaluate(() => window.recorded);
  assert.ok(seen.some(({ t }) => t > 0 && t < 1), 'it grew');
  assert.ok(seen.every(({ drawn }) => drawn > to.triangles), 'by fragments');
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test('damaged units leave the picture at the last good level, and the level itself comes instead', TEST, async () => {
  const { levels } = manifests.retile;
  const from = levels.find((l) => l.delta?.units && l.delta.units.bytes < levels[l.delta.to].bytes);
  assert.ok(from, JSON.stringify(levels));
  const to = levels[from.delta.to];
  const { units } = from.delta;
  const flip = (bytes, at) => bytes.map((b, i) => (i === at ? b ^ 16 : b));
  const ways = {
    'the index': (bytes, head) => (head ? flip(bytes, 30) : bytes),
    'the first unit': (bytes, head) => (head ? flip(bytes, bytes.length - 5) : bytes),
    'a later unit': (bytes, head) => (head ? bytes : flip(bytes, bytes.length - 5)),
  };
  for (const [name, damage] of Object.entries(ways)) {
    const page = await open(daemon.url, 'retile', from.level, { reducedMotion: 'reduce' });
    const good = await picture(page);
    await page.route(`**/v1/objects/${units.object}`, async (route) => {
      const response = await route.fetch();
      const head = /^bytes=0-/.test(route.request().headers().range);
      await route.fulfill({ response, body: Buffer.from(damage(new Uint8Array(await response.body()), head)) });
    });
    let shown = null;
    let drawn = null;
    await page.route((u) => u.pathname.endsWith('/level') && u.search.includes(`error=${to.error}`), async (route) => {
      shown = (await figures(page)).level; // while the level is on its way
      drawn = await picture(page);
      await route.continue();
    });
    await reach(page, 'retile', to.level);
    assert.equal(shown, from.level, `${name}: the picture stays at the last good level`);
    if (name !== 'a later unit') assert.ok(good.data.equals(drawn.data), `${name}: to the pixel`);
    assert.equal((await figures(page)).triangles, to.triangles, name);
    assert.deepEqual(page.faults, [], name);
    await page.context().close();
  }
});

/** Between page and daemon: the first answer to a request for `what` ends after `size` bytes; everything is counted. */
async function breaking(target, what, size) {
  const { hostname, port } = new URL(target);
  const asked = [];
  const sockets = new Set();
  const server = net.createServer((client) => {
    const upstream = net.connect(Number(port), hostname);
    let left = Infinity;
    for (const socket of [client, upstream]) {
      sockets.add(socket);
      socket.on('error', () => {});
      socket.on('close', () => {
        sockets.delete(socket);
        client.destroy();
        upstream.destroy();
      });
    }
    client.on('data', (data) => {
      const text = data.toString('latin1');
      if (text.startsWith('GET ') && text.split('\r\n')[0].includes(what)) {
        asked.push(/^range: *(\S+)/im.exec(text)?.[1] ?? null);
        if (asked.length === 1) left = size;
      }
      upstream.write(data);
    });
    upstream.on('data', (data) => {
      if (left === Infinity) {
        client.write(data);
        return;
      }
      client.write(data.subarray(0, left));
      left -= Math.min(left, data.length);
      if (left === 0) client.end(() => upstream.destroy());
    });
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  return {
    asked, url: `http://127.0.0.1:${server.address().port}/`,
    stop: () => {
      for (const socket of sockets) socket.destroy();
      return new Promise((resolve) => server.close(resolve));
    },
  };
}

test('a step that breaks off is taken up where it broke, and so is a unit', TEST, async () => {
  const { levels } = manifests.retile;
  const whole = stepOf(manifests.retile);
  const inUnits = levels.find((l) => l.delta?.units && l.delta.units.bytes < levels[l.delta.to].bytes);
  const ways = [
    { ...whole, units: false, what: '/delta?', bytes: whole.from.delta.bytes },
    { from: inUnits, to: levels[inUnits.delta.to], units: true, what: inUnits.delta.units.object, bytes: inUnits.delta.units.bytes },
  ];
  for (const { from, to, units, what, bytes } of ways) {
    const line = await breaking(daemon.url, what, 900);
    const page = await open(line.url, 'retile', from.level, { reducedMotion: 'reduce' });
    await page.evaluate((on) => (document.getElementById('units').checked = on), units);
    const before = (await figures(page)).loaded;
    await reach(page, 'retile', to.level);
    const drawn = await figures(page);
    assert.equal(drawn.triangles, to.triangles);
    assert.equal(drawn.loaded - before, bytes, 'no byte came twice');
    assert.ok(line.asked.length >= 2, JSON.stringify(line.asked));
    const again = Number(/^bytes=(\d+)-/.exec(line.asked[1])?.[1]);
    assert.ok(again > 0 && again < 900, `the rest was asked for: ${line.asked}`);
    assert.ok(!page.asked.some((url) => url.includes('/level?') && url.includes(`error=${to.error}`)), 'and not the level');
    assert.ok(page.faults.every((fault) => /ERR_|net::/.test(fault)), page.faults.join('\n'));
    await page.context().close();
    await line.stop();
  }
});
