// What a person waits for, in headless Chromium: time to a first picture and to one pixel over an emulated link, beside a page that loads one
// Draco GLB of the finest level; and the pop: the largest change between two frames of a dive, with morphs and without.
//
//   make bench-stream BENCH_ARGS="[MODEL...]"        ../shared/models/scans/bunny.ply, or a generated sphere without ../shared
//
// The link is a proxy of ours between browser and daemon: LATENCY_MS for a round trip and MBIT per second towards the browser, shared by all
// connections, so that it runs where the kernel has no netem. Times are wall clock, medians of TURNS: read them beside the load, which is printed.
import { execFileSync } from 'node:child_process';
import { copyFileSync, cpSync, existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import net from 'node:net';
import os from 'node:os';
import path from 'node:path';
import { ROOT, VIEWER, launch, openPage } from '../web/browser.mjs';
import { Daemon } from '../web/daemon.mjs';
import { Mock } from '../web/mock.mjs';
import { bumpySphere, writePly } from '../web/models.mjs';

const MBIT = 10;
const LATENCY_MS = 50;
const TURNS = 3; // medians of so many
const WEB = path.join(ROOT, 'clients/web');
const SHARED = process.env.LODESTREAM_SHARED ?? path.join(ROOT, '../shared');

/** A TCP proxy that delays both ways and lets so many bytes a second through to the client. */
async function link(target) {
  const { hostname, port } = new URL(target);
  let free = 0; // when the link is next free, ms
  const server = net.createServer((client) => {
    const up = net.connect(Number(port), hostname);
    const quiet = () => {
      client.destroy();
      up.destroy();
    };
    client.on('error', quiet).on('close', quiet);
    up.on('error', quiet);
    client.on('data', (data) => setTimeout(() => up.writable && up.write(data), LATENCY_MS / 2));
    up.on('data', (data) => {
      const now = performance.now();
      const begins = Math.max(now, free);
      free = begins + (data.length * 8) / (MBIT * 1000);
      up.pause(); // nothing piles up here: the sender feels the link
      setTimeout(() => up.resume(), free - now);
      setTimeout(() => client.writable && client.write(data), free - now + LATENCY_MS / 2);
    });
    up.on('end', () => setTimeout(() => client.end(), Math.max(0, free - performance.now()) + LATENCY_MS));
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  return { url: `http://127.0.0.1:${server.address().port}/`, close: () => server.close() };
}

const ONE = `
import { AmbientLight, Box3, Color, DirectionalLight, PerspectiveCamera, Scene, Sphere, WebGLRenderer } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
const renderer = new WebGLRenderer({ antialias: true });
renderer.setSize(innerWidth, innerHeight);
document.body.append(renderer.domElement);
const draco = new DRACOLoader();
draco.setDecoderPath(new URL('draco/', import.meta.url).href);
draco.preload();
const loader = new GLTFLoader();
loader.setDRACOLoader(draco);
const asked = performance.now();
const gltf = await loader.loadAsync(new URLSearchParams(location.search).get('glb'));
const scene = new Scene();
scene.background = new Color(0xffffff);
scene.add(gltf.scene, new AmbientLight(0xffffff, 1), new DirectionalLight(0xffffff, 2));
const { center, radius } = new Box3().setFromObject(gltf.scene).getBoundingSphere(new Sphere());
const camera = new PerspectiveCamera(45, innerWidth / innerHeight, radius / 100, radius * 10);
camera.position.copy(center);
camera.position.z += radius * 2.6;
renderer.render(scene, camera);
renderer.getContext().finish();
window.times = { asked, drawn: performance.now() };
`;

function sites() {
  const folder = mkdtempSync(path.join(os.tmpdir(), 'lodestream-stream-'));
  cpSync(VIEWER, folder, { recursive: true });
  writeFileSync(path.join(folder, 'one-source.js'), ONE);
  const bundle = (from, to) => execFileSync(path.join(WEB, 'node_modules/.bin/esbuild'), [from, '--bundle', '--format=esm', '--minify', '--target=es2022', '--log-level=warning', `--outfile=${path.join(folder, to)}`], { stdio: 'inherit', env: { ...process.env, NODE_PATH: path.join(WEB, 'node_modules') } });
  bundle(path.join(folder, 'one-source.js'), 'one.js');
  writeFileSync(path.join(folder, 'one.html'), '<!doctype html><link rel="icon" href="data:,"><body style="margin:0"><script type="module" src="one.js"></script>');
  return folder;
}

const seconds = (ms) => `${(ms / 1000).toFixed(2)} s`;

/** From the typed address to a first picture and to 1 px, in ms, and when the model was asked for. */
async function openModel(browser, url, id, family) {
  const page = await openPage(browser, { viewport: { width: 320, height: 240 }, reducedMotion: 'reduce' });
  page.setDefaultTimeout(180000);
  await page.addInitScript(() => {
    window.seen = {};
    const look = () => {
      const px = document.getElementById('hud-px')?.dataset.value;
      const busy = document.getElementById('stage')?.getAttribute('aria-busy');
      if (px && !window.seen.first) window.seen.first = { at: performance.now(), px: Number(px), bytes: Number(document.getElementById('hud-bytes').dataset.value) };
      if (px && Number(px) <= 1 && !window.seen.sharp) window.seen.sharp = { at: performance.now(), px: Number(px), bytes: Number(document.getElementById('hud-bytes').dataset.value) };
      if (!(window.seen.sharp && busy === 'false')) requestAnimationFrame(look);
      else window.seen.done = true;
    };
    addEventListener('DOMContentLoaded', look);
  });
  await page.goto(`${url}#model=${id}&family=${family}&px=1`);
  await page.waitForFunction(() => window.seen.done);
  const { seen, asked } = await page.evaluate((name) => ({ seen: window.seen, asked: performance.getEntriesByType('resource').find((e) => new URL(e.name).pathname.endsWith(`/v1/models/${name}`))?.startTime ?? 0 }), id);
  await page.context().close();
  return { ...seen, asked };
}

async function openOne(browser, url, object) {
  const page = await openPage(browser, { viewport: { width: 320, height: 240 } });
  page.setDefaultTimeout(180000);
  await page.goto(`${url}viewer/one.html?glb=${encodeURIComponent(`/v1/objects/${object}`)}`);
  await page.waitForFunction(() => window.times);
  const seen = await page.evaluate(() => window.times);
  await page.context().close();
  return seen;
}

const median = (list) => [...list].sort((a, b) => a - b)[Math.floor(list.length / 2)];

/** Pages of the families and of one GLB by turns, after a turn that does not count: the browser's own first page is slower than all others. */
async function times(browser, daemon, id, families, finest) {
  const { url, close } = await link(daemon.url);
  const seen = Object.fromEntries(families.map((family) => [family, []]));
  const one = [];
  try {
    for (let turn = 0; turn <= TURNS; turn++) {
      for (const family of families) {
        const times = await openModel(browser, url, id, family);
        if (turn > 0) seen[family].push(times);
      }
      const times = await openOne(browser, url, finest.object);
      if (turn > 0) one.push(times);
    }
  } finally {
    close();
  }
  for (const family of families) {
    const of = (get) => seconds(median(seen[family].map(get)));
    const { first, sharp } = seen[family][0];
    console.log(`${id}, ${family}: first picture ${of((t) => t.first.at)} after the address was typed, ${of((t) => t.first.at - t.asked)} after the model was asked for (${first.bytes} B, ${first.px.toFixed(1)} px); at most 1 px ${of((t) => t.sharp.at)}, ${of((t) => t.sharp.at - t.asked)} (${sharp.bytes} B)`);
  }
  const of = (get) => seconds(median(one.map(get)));
  console.log(`${id}, one Draco GLB of ${finest.bytes} B: first and last picture ${of((t) => t.drawn)}, ${of((t) => t.drawn - t.asked)} after it was asked for`);
}

async function pop(browser, bytes, name) {
  const folder = mkdtempSync(path.join(os.tmpdir(), 'lodestream-pop-'));
  const site = path.join(folder, 'site');
  let mock;
  try {
    writeFileSync(path.join(folder, name), bytes);
    execFileSync(path.join(ROOT, 'build/release/lodestream'), ['bake', path.join(folder, name), '-o', path.join(folder, 'bake'), '--family', 'retile', '--vertices', '300,1200,4800'], { stdio: 'pipe' });
    const manifest = JSON.parse(readFileSync(path.join(folder, 'bake/manifest.json'), 'utf8'));
    const levels = manifest.families.retile.levels.slice(0, 3);
    const { center, radius } = manifest.source.sphere;
    cpSync(VIEWER, site, { recursive: true });
    execFileSync(path.join(WEB, 'node_modules/.bin/esbuild'), [path.join(ROOT, 'tests/web/harness.js'), '--bundle', '--format=esm', '--target=es2022', '--log-level=warning', `--outfile=${path.join(site, 'harness.js')}`], { stdio: 'pipe' });
    writeFileSync(path.join(site, 'index.html'), '<!doctype html><link rel="icon" href="data:,"><body style="margin:0"><script type="module" src="viewer/harness.js"></script>');
    levels.forEach((level, i) => copyFileSync(path.join(folder, 'bake/objects', level.object), path.join(site, `level-${i}.glb`)));
    mock = await new Mock({ viewer: site }).start();
    const page = await openPage(browser, { viewport: { width: 400, height: 300 } });
    page.setDefaultTimeout(180000);
    await page.goto(mock.url);
    await page.waitForFunction(() => window.harness !== undefined);
    await page.evaluate(([urls, errors, sphere]) => window.harness.load(urls, errors, sphere), [levels.map((_, i) => `viewer/level-${i}.glb`), levels.map((l) => l.error), { center, radius }]);
    const made = await page.evaluate(() => window.harness.prepare(true));
    const ends = await page.evaluate(() => window.harness.ends(3));
    const pixels = (levels[0].error / radius * 300) / (2 * 6 * Math.tan(Math.PI / 8));
    const dive = (mode) => page.evaluate((o) => window.harness.dive(o), { frames: 150, from: 9, to: 1.5, pixels, mode });
    const off = await dive('off');
    const time = await dive('time');
    const screen = await dive('screen');
    console.log(`${name}, ${levels.map((l) => l.triangles).join(', ')} triangles${made ? '' : ' (not morphed)'}: largest mean change between frames of a dive (of 255): swaps ${off.largest.toFixed(2)}, morph by time ${time.largest.toFixed(3)}, by error on screen ${screen.largest.toFixed(3)}; t = 0 differs from its level by ${ends.map((e) => e.start.toFixed(4)).join(', ')}, t = 1 by ${ends.map((e) => e.end.toFixed(4)).join(', ')}`);
    await page.context().close();
  } finally {
    await mock?.stop();
    rmSync(folder, { recursive: true, force: true });
  }
}

const bunny = path.join(SHARED, 'models/scans/bunny.ply');
const given = process.argv.slice(2);
const files = given.length > 0 ? given : existsSync(bunny) ? [bunny] : [];
const models = files.map((file) => ({ name: path.basename(file), bytes: readFileSync(file) }));
if (models.length === 0) models.push({ name: 'bumpy.ply', bytes: writePly(bumpySphere(150)) });
const browser = await launch();
const folder = sites();
console.log(`${MBIT} Mbit/s, ${LATENCY_MS} ms, by proxy; load ${os.loadavg()[0].toFixed(1)} on ${os.cpus().length} processors`);
const daemon = await Daemon.start(['--families', 'cluster,retile', '--viewer', folder]);
try {
  for (const { name, bytes } of models) {
    const id = path.parse(name).name;
    const manifest = await daemon.bake(id, bytes, name, 300);
    await times(browser, daemon, id, ['retile', 'auto'], manifest.families.retile.levels.at(-1));
    await pop(browser, bytes, name);
  }
} finally {
  await daemon.stop();
  await browser.close();
  rmSync(folder, { recursive: true, force: true });
}
