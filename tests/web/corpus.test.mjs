/**
 * Deltas of real models: what a bake stores is decoded natively and in WebAssembly, frame by frame and unit by unit, and so are the maps between
 * levels; the hashes must be equal. Models are those of the shared folder, some of each kind and family, or all of them with
 * LODESTREAM_TEST_TABLE=120, then with a line for each, and 120 seconds at most for a bake or a decoding; and one from a generator.
 */

import assert from 'node:assert/strict';
import { execFile } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import test from 'node:test';
import { fileURLToPath } from 'node:url';
import { promisify } from 'node:util';
import { Core } from '../../clients/web/src/wasm/core.js';
import { bumpySphere, writePly } from './models.mjs';
import { takeUnits } from './native.mjs';

const ROOT = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const MODELS = path.join(process.env.LODESTREAM_SHARED ?? path.join(ROOT, '../shared'), 'models');
const SECONDS = Number(process.env.LODESTREAM_TEST_TABLE ?? 0);
const TABLE = SECONDS > 0;
const run = promisify(execFile);
const TOOL = path.join(ROOT, 'build/release/lodestream');
const BYTES = readFileSync(path.join(ROOT, 'build/web/lodestream.wasm'));
const folder = mkdtempSync(path.join(tmpdir(), 'lodestream-corpus-'));
test.after(() => rmSync(folder, { recursive: true }));

/** Of each family what takes a moment to bake: scans and parts, borders, thin things, many units, UVs, colours and materials. */
const FEW = {
  retile: ['scans/spot.ply', 'cad/block.ply', 'iso/retinal-cgal.ply', 'thin/cactus-cgal.ply', 'gltf/Duck.glb'],
  cluster: ['scans/spot.ply', 'cad/block.ply', 'iso/retinal-cgal.ply', 'thin/dead-tree.ply', 'gltf/BoxVertexColors.glb', 'gltf/SimpleInstancing.glb', 'gltf/Fox.glb'],
  envelope: ['scans/fandisk.ply', 'cad/flange.ply', 'gltf/BoxTextured.glb'],
};
const SETTINGS = { retile: [], cluster: [], envelope: ['--envelope', 'nested=1'] };
const HAS_MODEL = /\.(glb|gltf|ply|obj|stl|off|drc)$/i;

/** The file to bake of a name in the shared folder, which may be a folder. */
function fileOf(name) {
  const at = path.join(MODELS, name);
  if (!existsSync(at)) return null;
  if (!statSync(at).isDirectory()) return HAS_MODEL.test(at) ? at : null;
  const inside = readdirSync(at).filter((f) => HAS_MODEL.test(f)).sort((a, b) => Number(/\.gl(b|tf)$/.test(b)) - Number(/\.gl(b|tf)$/.test(a)));
  return inside.length > 0 ? path.join(at, inside[0]) : null;
}

/**
 * Objects of a family in the order in which they are applied, a first picture first. Where a level has no step to the next one, that one's GLB comes,
 * as PLY, and the rest of the chain behind it, if that is triangles alone and the model one unit, whose instances are not placed: a page does likewise.
 */
async function chain(manifest, family, bake) {
  const { levels } = manifest.families[family];
  const object = ({ object }) => path.join(bake, 'objects', object);
  const files = levels[0]?.first ? [object(levels[0].first)] : [];
  const single = manifest.parts.length === 1;
  for (const [k, { delta }] of levels.entries()) {
    if (files.length === 0) break;
    if (delta) {
      if (delta.units) files.push(object(delta.units));
      files.push(object(delta));
    } else if (single && levels.slice(k + 1).some((l) => l.delta) && !levels[k + 1].edges && !levels[k + 1].points) {
      const ply = path.join(bake, `${k + 1}.ply`);
      await run(TOOL, ['decode', object(levels[k + 1]), '-o', ply]);
      files.push(ply);
    } else {
      break;
    }
  }
  return files;
}

/** Positions and index of a binary PLY of ours. */
function readPly(file) {
  const bytes = readFileSync(file);
  const end = bytes.indexOf('end_header\n') + 11;
  const header = bytes.toString('latin1', 0, end);
  const properties = /element vertex (\d+)\n((?:property \w+ \w+\n)+)element face (\d+)/.exec(header);
  const [vertices, faces] = [Number(properties[1]), Number(properties[3])];
  const stride = properties[2].trim().split('\n').reduce((sum, line) => sum + (line.startsWith('property uchar') ? 1 : 4), 0);
  const positions = new Float32Array(3 * vertices);
  const index = new Uint32Array(3 * faces);
  for (let v = 0; v < vertices; v++) for (let i = 0; i < 3; i++) positions[3 * v + i] = bytes.readFloatLE(end + v * stride + 4 * i);
  const at = end + vertices * stride;
  for (let t = 0; t < faces; t++) for (let i = 0; i < 3; i++) index[3 * t + i] = bytes.readInt32LE(at + 13 * t + 1 + 4 * i);
  return { positions, index };
}

/** What tests/sample/steps --decode prints of files, by the module. */
function decodeFiles(core, files) {
  const out = [];
  const levels = [];
  for (const file of files) {
    if (file.endsWith('.ply')) {
      const { positions, index } = readPly(file);
      levels[0].free();
      levels[0] = core.level(positions, index);
      continue;
    }
    const bytes = readFileSync(file);
    if (bytes.toString('latin1', 0, 4) === 'LODU') {
      out.push(takeUnits(core, bytes, levels[0]));
      continue;
    }
    for (let at = 0, unit = 0; at < bytes.length; unit++) {
      const size = core.frameSize(bytes.subarray(at));
      const base = levels[unit] ?? null;
      const level = core.decode(bytes.subarray(at, at + size), base);
      const map = base ? core.map(base, level) : null;
      out.push({ unit, level: level.hash, map: map?.hash ?? 0, failed: map ? map.draw().failed : 0, vertices: level.arrays().positions.length / 3 });
      map?.free();
      base?.free();
      levels[unit] = level;
      at += size;
    }
  }
  for (const level of levels) level.free();
  return out;
}

/** Bakes, decodes both ways, compares. Returns how many frames and units were compared; 0: the family has no steps there. */
async function compare(file, family, timeout = 0) {
  const bake = mkdtempSync(path.join(folder, 'bake-'));
  try {
    await run(TOOL, ['bake', file, '-o', bake, '--family', family, ...SETTINGS[family]], { timeout, maxBuffer: 1 << 26 });
    const files = await chain(JSON.parse(readFileSync(path.join(bake, 'manifest.json'), 'utf8')), family, bake);
    if (files.length === 0) return { frames: 0, units: 0, vertices: 0 };
    const { stdout } = await run(path.join(ROOT, 'build/release/tests/sample/steps'), ['--decode', ...files], { timeout, maxBuffer: 1 << 28 });
    const native = stdout.trim().split('\n').map((line) => JSON.parse(line));
    const core = await Core.create(BYTES, { megabytes: 1536 });
    assert.deepEqual(decodeFiles(core, files), native, `${file}, ${family}`);
    const frames = native.filter((f) => f.level !== undefined);
    const units = native.filter((f) => f.level === undefined);
    return { frames: frames.length, units: units.reduce((sum, u) => sum + u.count, 0), vertices: frames.reduce((sum, f) => sum + f.vertices, 0) };
  } finally {
    rmSync(bake, { recursive: true, force: true });
  }
}

test('a generated scan, by every family', async () => {
  const file = path.join(folder, 'bumpy.ply');
  writeFileSync(file, writePly(bumpySphere(40)));
  for (const family of Object.keys(FEW)) {
    const { frames, units } = await compare(file, family);
    assert.ok(frames >= 3, `${family}: ${frames} frames`);
    if (family !== 'envelope') assert.ok(units >= 2, `${family}: ${units} units`);
  }
});

for (const [family, names] of Object.entries(FEW)) {
  test(`shared models, ${family}`, { skip: !existsSync(MODELS) || TABLE }, async () => {
    for (const name of names) {
      const file = fileOf(name);
      assert.ok(file, name);
      const { frames } = await compare(file, family);
      assert.ok(frames >= 1, `${name}, ${family}: ${frames} frames`);
    }
  });
}

test('all shared models, by every family', { timeout: 0x7fffffff, skip: !existsSync(MODELS) || !TABLE }, async () => {
  const kinds = ['scans', 'cad', 'iso', 'thin', 'gltf'].filter((kind) => existsSync(path.join(MODELS, kind)));
  const wrong = [];
  const sums = { models: 0, frames: 0, units: 0, vertices: 0, bakes: 0 };
  for (const kind of kinds) {
    for (const name of readdirSync(path.join(MODELS, kind)).sort()) {
      const file = fileOf(path.join(kind, name));
      if (!file) continue;
      sums.models++;
      for (const family of Object.keys(FEW)) {
        let told;
        try {
          const facts = await compare(file, family, 1000 * SECONDS);
          told = `${facts.frames} frames, ${facts.units} units, ${facts.vertices} vertices`;
          for (const key of ['frames', 'units', 'vertices']) sums[key] += facts[key];
          sums.bakes++;
        } catch (error) {
          told = error.killed ? `did not end in ${SECONDS} s` : String(error.stderr || error.message).trim().split('\n')[0];
          if (error.code === 'ERR_ASSERTION' || !(error.code === 1 || error.code === 3 || error.killed)) wrong.push(`${kind}/${name}, ${family}: ${error.message}`);
        }
        console.log(`# ${kind}/${name}, ${family}: ${told}`);
      }
    }
  }
  console.log(`# ${JSON.stringify(sums)}`);
  assert.deepEqual(wrong, []);
});
