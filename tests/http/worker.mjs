#!/usr/bin/env node
// A worker for tests: speaks the frames of server/jobs/frame.h, but its "model" is a recipe in JSON, so that a test chooses levels, sizes,
// progress and misbehaviour. The real worker has tests of its own; what is tested with this one is the daemon.
//
// Recipe: {"families":{"cluster":{"nested":true,"levels":[{"error":1,"triangles":10,"size":1000,"cell":2}, ...]}},
//          "texture":true, "steps":3, "step_ms":50, "behave":"crash"|"hang"|"fail"|"lie",
//          "later":"hang"|...: how to behave when the family envelope is asked for too}
import fs from 'node:fs';
import path from 'node:path';
import { createHash } from 'node:crypto';
import { fileURLToPath } from 'node:url';

export const sha256 = (bytes) => createHash('sha256').update(bytes).digest('hex');

// Bytes that differ by seed and do not compress.
export function makeBytes(seed, size) {
  const bytes = Buffer.alloc(size);
  let state = (seed * 2654435761 + 12345) >>> 0;
  for (let i = 0; i < size; i++) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    bytes[i] = state >>> 24;
  }
  return bytes;
}

// Writes manifest.json and objects/ for a recipe; returns the manifest.
export function bake(directory, id, name, source, recipe) {
  fs.mkdirSync(path.join(directory, 'objects'), { recursive: true });
  const put = (bytes) => {
    const hash = sha256(bytes);
    fs.writeFileSync(path.join(directory, 'objects', hash), bytes);
    return { object: recipe.behave === 'lie' ? sha256(Buffer.from('lie')) : hash, bytes: bytes.length };
  };
  let seed = recipe.seed ?? 1;
  const families = {};
  for (const [family, { nested, levels }] of Object.entries(recipe.families)) {
    families[family] = {
      nested: nested ?? true,
      levels: levels.map((level, index) => ({
        level: index,
        vertices: level.triangles + 2,
        triangles: level.triangles,
        error: level.error,
        ...(level.cell ? { cell: level.cell } : {}),
        ...put(makeBytes(seed++, level.size)),
        type: 'model/gltf-binary',
      })),
    };
  }
  const manifest = {
    id,
    revision: sha256(source),
    source: {
      format: 'recipe', name, sha256: sha256(source), bytes: source.length, vertices: 100, triangles: 196, components: 1, boundary_loops: 0,
      closed: true, diagonal: 2, bounds: { min: [-1, -1, -1], max: [1, 1, 1] }, sphere: { center: [0, 0, 0], radius: 1 },
    },
    parts: [{ name: 'part', instances: [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]] }],
    families,
    ...(recipe.texture ? { textures: [{ ...put(makeBytes(777, 5000)), type: 'image/png', width: 4, height: 4 }] } : {}),
    bake: { settings: {}, seconds: 0.1, warnings: [] },
  };
  fs.writeFileSync(path.join(directory, 'manifest.json'), JSON.stringify(manifest));
  return manifest;
}

function readExactly(fd, size) {
  const bytes = Buffer.alloc(size);
  for (let used = 0; used < size;) {
    let count;
    try {
      count = fs.readSync(fd, bytes, used, size - used, null);
    } catch (error) {
      if (error.code === 'EAGAIN') continue;
      throw error;
    }
    if (count === 0) throw new Error('end of file');
    used += count;
  }
  return bytes;
}

function send(type, message) {
  const payload = Buffer.from(JSON.stringify(message));
  const header = Buffer.alloc(5);
  header.writeUInt32LE(payload.length, 0);
  header[4] = type.charCodeAt(0);
  const frame = Buffer.concat([header, payload]);
  for (let used = 0; used < frame.length;) used += fs.writeSync(3, frame, used, frame.length - used);
}

const sleep = (ms) => Atomics.wait(new Int32Array(new SharedArrayBuffer(4)), 0, 0, ms);

function work() {
  const header = readExactly(3, 5);
  const job = JSON.parse(readExactly(3, header.readUInt32LE(0)));
  if (job.job === 'try') return send('D', {}); // the daemon wants to know whether bakes can be
  const source = fs.readFileSync('/proc/self/fd/4');
  let recipe;
  try {
    recipe = JSON.parse(source);
  } catch {
    send('F', { status: 'bad-input', type: 'truncated', detail: `'${job.name}': not a recipe.` });
    return;
  }
  if (recipe.later && job.families.includes('envelope')) recipe.behave = recipe.later;
  const steps = recipe.steps ?? 0;
  for (let i = 0; i < steps; i++) {
    send('P', { stage: `step-${i}`, progress: i / steps });
    sleep(recipe.step_ms ?? 50);
  }
  if (recipe.behave === 'crash') process.kill(process.pid, 'SIGSEGV');
  if (recipe.behave === 'hang') for (;;) sleep(1000);
  if (recipe.behave === 'fail') {
    send('F', { status: 'bad-input', type: 'index-out-of-range', detail: `'${job.name}': face 7 names vertex 99 of 12.` });
    return;
  }
  bake('/proc/self/fd/5', job.id, job.name, source, recipe);
  send('D', {});
}

if (process.argv[1] === fileURLToPath(import.meta.url)) work();
