/**
 * Pictures of the viewer to look at: uploads the named files to a fresh daemon and photographs each at desktop and at phone size.
 *
 *   node tests/web/shots.mjs OUT_DIR MODEL[#fragment]...      for example  node tests/web/shots.mjs /tmp/shots bunny.ply 'tree.ply#level=1'
 */

import { mkdirSync, readFileSync } from 'node:fs';
import path from 'node:path';
import { modelIdFromFileName } from '../../clients/web/src/protocol/ids.js';
import { figures, launch, openPage, settled } from './browser.mjs';
import { Daemon } from './daemon.mjs';

const [out, ...models] = process.argv.slice(2);
if (!models.length) {
  console.error('usage: node tests/web/shots.mjs OUT_DIR MODEL[#fragment]...');
  process.exit(2);
}
mkdirSync(out, { recursive: true });
const SIZES = {
  desktop: { viewport: { width: 1280, height: 800 } },
  phone: { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true, colorScheme: 'dark' },
};

const daemon = await Daemon.start();
const browser = await launch();
try {
  const baked = new Set();
  for (const model of models) {
    const [file, fragment = ''] = model.split('#');
    const id = modelIdFromFileName(file);
    if (!baked.has(id)) await daemon.bake(id, readFileSync(file), path.basename(file), 600);
    baked.add(id);
    for (const [size, options] of Object.entries(SIZES)) {
      const page = await openPage(browser, options);
      await page.goto(`${daemon.url}#model=${id}&${fragment}`);
      await settled(page, 60000);
      const name = `${id}${fragment ? `-${fragment.replace(/[^a-z0-9]+/gi, '-')}` : ''}-${size}.png`;
      await page.screenshot({ path: path.join(out, name) });
      console.log(name, JSON.stringify(await figures(page)), page.faults.join('\n'));
      await page.context().close();
    }
  }
} finally {
  await browser.close();
  await daemon.stop();
}
