/**
 * Vertices that WebAssembly makes a second when all triangles of a C-LOD are made anew, at two tolerances by turns.
 *
 *   node tests/bench/curves_bench.mjs STREAM...   (objects of `patches` in a bake, or answers of GET .../patches)
 */
import { readFileSync } from 'node:fs';
import { decodeCurves } from '../../clients/web/src/wasm/clod.js';

const WASM = readFileSync(new URL('../../build/wasm/clod.wasm', import.meta.url));
const TURNS = 12;

for (const file of process.argv.slice(2)) {
  const [curves] = await decodeCurves(WASM, new Uint8Array(readFileSync(file)));
  const { min: low, max: high } = curves.bounds();
  const centre = low.map((x, i) => (x + high[i]) / 2);
  const size = Math.hypot(...low.map((x, i) => high[i] - x));
  const view = { eye: [centre[0], centre[1], centre[2] + 1.3 * size], forward: [0, 0, -1], up: [0, 1, 0], fov: 45, aspect: 1.6, height: 1080, near: 1e-3 * size };
  for (const strict of [false, true]) {
    let vertices = 0;
    let taken = 0;
    for (let turn = -2; turn < TURNS; turn++) {
      curves.set({ pixels: turn % 2 === 0 ? 0.03 : 0.3, cullOutside: false, cullBack: false, strict });
      const { user, system } = process.cpuUsage();
      const { verticesMade } = curves.update(view);
      const after = process.cpuUsage();
      if (turn < 0) continue;
      vertices += verticesMade;
      taken += after.user + after.system - user - system;
    }
    console.log(`${file.split('/').pop()}: ${curves.patches} patches${strict ? ', strictly smooth' : ''}: ${(vertices / taken).toFixed(1)} M vertices/s (CPU)`);
  }
  curves.close();
}
