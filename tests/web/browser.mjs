/** Headless Chromium with software WebGL, pages that cannot leave 127.0.0.1, and pictures to compare. */

import { chromium } from 'playwright-core';
import { PNG } from 'pngjs';
import { existsSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

const HERE = path.dirname(fileURLToPath(import.meta.url));
export const ROOT = path.resolve(HERE, '../..');
export const VIEWER = path.join(ROOT, 'build/web');

const FLAGS = [
  '--no-sandbox', '--disable-dev-shm-usage', '--ignore-gpu-blocklist', '--disable-background-networking', '--disable-component-update', '--no-first-run',
  // SwiftShader, always: the pictures are the same on every machine.
  '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--force-color-profile=srgb',
  '--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1',
];

export function launch() {
  const executablePath = ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find(existsSync);
  if (!executablePath) throw new Error('Chromium is missing; deploy/dependencies.sh installs it');
  return chromium.launch({ executablePath, headless: true, args: FLAGS });
}

/** A page that records what goes wrong and where its requests go. */
export async function openPage(browser, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1000, height: 640 }, deviceScaleFactor: 1, colorScheme: 'light', reducedMotion: 'reduce', ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(20000);
  page.faults = [];
  page.asked = [];
  page.levels = [];
  page.on('pageerror', (error) => page.faults.push(`page error: ${error.stack ?? error}`));
  page.on('console', (message) => {
    if (message.type() === 'error' || message.type() === 'warning') page.faults.push(`${message.type()}: ${message.text()}`);
  });
  page.on('request', (request) => page.asked.push(request.url()));
  page.on('response', (response) => {
    if (/\/(level|delta)\?/.test(response.url())) page.levels.push({ status: response.status(), headers: response.headers(), url: response.url() });
  });
  return page;
}

/** Until the level that is wanted is drawn and no fade runs. */
export async function settled(page, timeout = 20000) {
  // What a key or a slider changed is asked for by the next frame; only then "not busy" means anything.
  await frames(page, 4);
  await page.waitForFunction(() => document.getElementById('stage').getAttribute('aria-busy') === 'false' && document.getElementById('hud-px').dataset.value, null, { timeout });
  // One more frame, so that what the figures say is what the screen shows.
  await frames(page, 2);
}

function frames(page, count) {
  return page.evaluate(async (n) => {
    while (n-- > 0) await new Promise(requestAnimationFrame);
  }, count);
}

/** The exact figures behind the overlay's words. */
export function figures(page) {
  return page.evaluate(() => {
    const value = (id) => document.getElementById(id).dataset.value;
    return {
      px: Number(value('hud-px')), error: Number(value('hud-units')), triangles: Number(value('hud-triangles')), edges: Number(value('hud-bars')),
      loaded: Number(value('hud-bytes')), levelBytes: Number(value('hud-level-bytes')), level: Number(value('hud-level')), family: value('hud-family'),
    };
  });
}

/** The canvas alone, panels hidden: fonts differ between machines, the model must not. */
export async function picture(page) {
  await page.addStyleTag({ content: 'body > :not(main) { visibility: hidden !important } #canvas:focus-visible { outline: none !important }' });
  const bytes = await page.screenshot({ animations: 'disabled' });
  return PNG.sync.read(bytes);
}

/**
 * Compares with tests/web/golden/NAME.png: at most `share` of the pixels may differ by more than `step` of 255 in a channel. What was drawn goes to
 * build/web-tests, so that a person can look. UPDATE_GOLDEN=1 writes the golden picture instead.
 */
export function compareGolden(name, image, { step = 24, share = 0.01 } = {}) {
  const golden = path.join(HERE, 'golden', `${name}.png`);
  const bytes = PNG.sync.write(image);
  keep(`${name}.png`, bytes);
  if (process.env.UPDATE_GOLDEN === '1') {
    mkdirSync(path.dirname(golden), { recursive: true });
    writeFileSync(golden, bytes);
    return { part: 0, ok: true };
  }
  const expected = PNG.sync.read(readFileSync(golden));
  if (expected.width !== image.width || expected.height !== image.height) return { part: 1, ok: false };
  let different = 0;
  for (let i = 0; i < image.data.length; i += 4) {
    const d = Math.max(...[0, 1, 2].map((c) => Math.abs(image.data[i + c] - expected.data[i + c])));
    if (d > step) different++;
  }
  const part = different / (image.width * image.height);
  return { part, ok: part <= share };
}

export function keep(name, bytes) {
  const folder = path.join(ROOT, 'build/web-tests');
  mkdirSync(folder, { recursive: true });
  writeFileSync(path.join(folder, name), bytes);
}

/** Part of the pixels that differ from the background's smooth gradient: how much of the picture the model covers. */
export function covered(image, background) {
  let different = 0;
  for (let i = 0; i < image.data.length; i += 4) {
    if ([0, 1, 2].some((c) => Math.abs(image.data[i + c] - background.data[i + c]) > 12)) different++;
  }
  return different / (image.width * image.height);
}
