// Decoding in the browser: the step to a re-tiled model's finest level by our WebAssembly in Chromium's worker, beside draco3d on the GLB of
// the same level in the same page.
//
//   make bench-decode BENCH_ARGS="[MODEL...]"        three scans of ../shared/models, or a generated sphere without ../shared
//
// Each is decoded in turns for some seconds, and the median of the later half counts, when the browser has compiled both modules for speed; the
// first turn is told too. Times are wall clock: read them beside the load, which is printed.
import { execFileSync } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { gzipSync } from 'node:zlib';
import { ROOT, VIEWER, launch, openPage } from '../web/browser.mjs';
import { Mock } from '../web/mock.mjs';
import { bumpySphere, writePly } from '../web/models.mjs';

const SHARED = process.env.LODESTREAM_SHARED ?? path.join(ROOT, '../shared');
const ROUNDS = 24;
const SECONDS = 6; // at least, so that small models are compiled as well as large ones

/** The bytes of the Draco stream in a GLB of one primitive. */
function dracoOf(glb) {
  const json = glb.readUInt32LE(12);
  const document = JSON.parse(glb.subarray(20, 20 + json).toString());
  const view = document.bufferViews[document.meshes[0].primitives[0].extensions.KHR_draco_mesh_compression.bufferView];
  const begin = 20 + json + 8 + (view.byteOffset ?? 0);
  return glb.subarray(begin, begin + view.byteLength);
}

/** In the page. */
async function measure({ steps, draco, rounds, seconds }) {
  const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const worker = new Worker('/viewer/core-worker.js', { type: 'module' });
  let number = 0;
  const waiting = new Map();
  worker.onmessage = ({ data }) => {
    waiting.get(data.number)(data);
    waiting.delete(data.number);
  };
  const ask = (what, options) => new Promise((resolve, reject) => {
    waiting.set(++number, ({ result, problem }) => (problem ? reject(new Error(problem.message)) : resolve(result)));
    worker.postMessage({ number, what, options });
  });
  worker.postMessage({ wasm: new URL('/viewer/lodestream.wasm', location.href).href });
  let base = null;
  for (const step of steps.slice(0, -1)) base = (await ask('decode', { bytes: bytesOf(step), base })).id;
  const last = bytesOf(steps.at(-1));
  await new Promise((resolve, reject) => {
    const script = document.createElement('script');
    script.src = '/viewer/draco/draco_wasm_wrapper.js';
    script.onload = resolve;
    script.onerror = reject;
    document.head.append(script);
  });
  const module = await DracoDecoderModule({ wasmBinary: await (await fetch('/viewer/draco/draco_decoder.wasm')).arrayBuffer() });
  const whole = bytesOf(draco);
  const theirs = () => {
    const decoder = new module.Decoder(), mesh = new module.Mesh();
    decoder.DecodeArrayToMesh(whole, whole.length, mesh);
    const points = mesh.num_points(), size = 12 * points, indices = 12 * mesh.num_faces();
    const out = module._malloc(size);
    decoder.GetAttributeDataArrayForAllPoints(mesh, decoder.GetAttribute(mesh, decoder.GetAttributeId(mesh, module.POSITION)), module.DT_FLOAT32, size, out);
    const positions = module.HEAPF32.slice(out / 4, (out + size) / 4);
    module._free(out);
    const list = module._malloc(indices);
    decoder.GetTrianglesUInt32Array(mesh, indices, list);
    const triangles = module.HEAPU32.slice(list / 4, (list + indices) / 4);
    module._free(list);
    module.destroy(mesh);
    module.destroy(decoder);
    return { points, positions, triangles };
  };
  const median = (list) => list.slice(list.length >> 1).sort((a, b) => a - b)[list.length >> 2];
  const ours = [], others = [];
  let vertices = 0, points = 0, triangles = [0, 0];
  const start = performance.now();
  for (let round = 0; round < rounds || performance.now() - start < 1000 * seconds; round++) {
    let began = performance.now();
    const level = await ask('decode', { bytes: last.slice(), base });
    ours.push(performance.now() - began);
    vertices = level.arrays.positions.length / 3;
    triangles[0] = level.arrays.triangles.length / 3;
    await ask('free', { level: level.id });
    began = performance.now();
    const mesh = theirs();
    others.push(performance.now() - began);
    points = mesh.points;
    triangles[1] = mesh.triangles.length / 3;
  }
  worker.terminate();
  return { first: ours[0], ours: median(ours), others: median(others), vertices, points, triangles };
}

const scans = ['bunny', 'igea', 'horse'].map((name) => path.join(SHARED, `models/scans/${name}.ply`));
const given = process.argv.slice(2);
const folder = mkdtempSync(path.join(os.tmpdir(), 'lodestream-decode-'));
const files = given.length > 0 ? given : scans.filter(existsSync);
if (files.length === 0) {
  files.push(path.join(folder, 'bumpy.ply'));
  writeFileSync(files[0], writePly(bumpySphere(150)));
}
const browser = await launch();
const mock = await new Mock({ viewer: VIEWER }).start();
try {
  const packed = (file) => gzipSync(readFileSync(path.join(VIEWER, file))).length;
  console.log(`compressed: lodestream.wasm ${packed('lodestream.wasm')} B and core-worker.js ${packed('core-worker.js')} B; draco_decoder.wasm ${packed('draco/draco_decoder.wasm')} B and its wrapper ${packed('draco/draco_wasm_wrapper.js')} B`);
  for (const file of files) {
    const out = path.join(folder, path.parse(file).name);
    const bake = (...more) => execFileSync(path.join(ROOT, 'build/release/lodestream'), ['bake', file, '-o', out, '--family', 'retile', ...more], { stdio: 'pipe' });
    bake();
    const { levels } = JSON.parse(readFileSync(path.join(out, 'manifest.json'), 'utf8')).families.retile;
    const object = (name) => readFileSync(path.join(out, 'objects', name));
    const end = levels.findIndex((level) => !level.delta); // steps lead as far as here
    const steps = [levels[0].first, ...levels.slice(0, end).map((level) => level.delta)].map((step) => object(step.object).toString('base64'));
    const page = await openPage(browser);
    page.setDefaultTimeout(180000);
    await page.goto(mock.url);
    const r = await page.evaluate(measure, { steps, draco: dracoOf(object(levels[end].object)).toString('base64'), rounds: ROUNDS, seconds: SECONDS });
    await page.context().close();
    console.log(`${path.basename(file)}, step to level ${end} of ${levels.length - 1}: ${r.vertices} vertices, ${r.triangles[0]} triangles, ${r.ours.toFixed(1)} ms, ${(r.vertices / r.ours / 1000).toFixed(3)} M vertices/s (aim 0.5; first turn ${r.first.toFixed(1)} ms); draco3d ${r.points} points, ${r.triangles[1]} triangles, ${r.others.toFixed(1)} ms, ${(r.points / r.others / 1000).toFixed(3)} M/s; load ${os.loadavg()[0].toFixed(1)} on ${os.cpus().length} processors`);
  }
} finally {
  await mock.stop();
  await browser.close();
  rmSync(folder, { recursive: true, force: true });
}
