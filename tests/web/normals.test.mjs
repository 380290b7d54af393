/** clients/web/src/three/normals.js and the viewer's pure parts. */

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { computeCreasedNormals } from '../../clients/web/src/three/normals.js';
import { formatAttributes, formatBytes, formatPixels, formatUnits } from '../../clients/web/src/viewer/format.js';
import { DEFAULTS, formatFragment, parseFragment } from '../../clients/web/src/viewer/location.js';
import { bumpySphere } from './models.mjs';

const CUBE = {
  positions: [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1],
  triangles: [0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7],
};

test('a cube keeps its edges: 24 vertices, every normal along an axis', () => {
  const { normals, sources, corners } = computeCreasedNormals(CUBE.positions, CUBE.triangles);
  assert.equal(sources.length, 24);
  assert.equal(corners.length, 36);
  for (let i = 0; i < normals.length; i += 3) {
    const largest = Math.max(...[0, 1, 2].map((a) => Math.abs(normals[i + a])));
    assert.ok(Math.abs(largest - 1) < 1e-6);
  }
});

for (const rings of [5, 12, 60]) {
  test(`a sphere of ${rings} rings is smooth: one normal a vertex, along the radius`, () => {
    const { positions, triangles } = bumpySphere(rings);
    const round = positions.map((p) => p.map((x) => x / Math.hypot(...p)));
    const { normals, sources } = computeCreasedNormals(round.flat(), triangles.flat());
    assert.equal(sources.length, positions.length);
    for (let v = 0; v < sources.length; v++) {
      const p = round[sources[v]];
      const cosine = p[0] * normals[3 * v] + p[1] * normals[3 * v + 1] + p[2] * normals[3 * v + 2];
      assert.ok(cosine > (rings < 10 ? 0.95 : 0.98), `vertex ${v}: ${cosine}`);
    }
  });
}

test('a cylinder of 16 sides is round at its side and sharp at its rim', () => {
  const n = 16;
  const positions = [];
  const triangles = [];
  for (let i = 0; i < n; i++) {
    const a = (i / n) * 2 * Math.PI;
    positions.push(Math.cos(a), Math.sin(a), 0, Math.cos(a), Math.sin(a), 3);
    const j = (i + 1) % n;
    triangles.push(2 * i, 2 * j, 2 * j + 1, 2 * i, 2 * j + 1, 2 * i + 1);
    if (i > 0 && i < n - 1) triangles.push(0, 2 * j, 2 * i, 1, 2 * i + 1, 2 * j + 1);
  }
  const { sources, normals } = computeCreasedNormals(positions, triangles);
  assert.equal(sources.length, 4 * n, 'each rim vertex once for the side, once for the lid');
  const tilted = Array.from({ length: sources.length }, (_, v) => Math.abs(normals[3 * v + 2])).filter((z) => z > 0.01 && z < 0.99);
  assert.equal(tilted.length, 0);
});

test('vertices that a texture seam splits still share a normal', () => {
  const positions = [0, 0, 0, 1, 0, 0, 0, 1, 0.3, 1, 0, 0, 0, 1, 0.3, 1, 1, 0];
  const { normals, sources } = computeCreasedNormals(positions, [0, 1, 2, 3, 5, 4], { crease: 90 });
  const at = (v) => [...sources].indexOf(v);
  for (const [a, b] of [[1, 3], [2, 4]]) for (let k = 0; k < 3; k++) assert.ok(Math.abs(normals[3 * at(a) + k] - normals[3 * at(b) + k]) < 1e-6);
});

test('degenerate, doubled and non-manifold triangles give unit normals and keep every corner', () => {
  const positions = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1];
  const index = [0, 1, 2, 0, 1, 2, 0, 2, 1, 0, 1, 3, 0, 0, 1, 1, 1, 1];
  const { normals, corners, sources } = computeCreasedNormals(positions, index);
  assert.deepEqual([...corners].map((c) => sources[c]), index);
  for (let i = 0; i < normals.length; i += 3) assert.ok(Math.abs(Math.hypot(normals[i], normals[i + 1], normals[i + 2]) - 1) < 1e-6);
  assert.equal(computeCreasedNormals([], []).corners.length, 0);
  assert.equal(computeCreasedNormals(positions.slice(0, 9), null).corners.length, 3);
});

// What takes the square of their number would not end before the runner gives up.
test('a million triangles keep every corner', () => {
  const { positions, triangles } = bumpySphere(500);
  const index = Uint32Array.from(triangles.flat());
  const { normals, corners, sources } = computeCreasedNormals(Float32Array.from(positions.flat()), index);
  assert.equal(corners.length, index.length);
  let wrong = 0;
  for (let i = 0; i < index.length; i++) wrong += sources[corners[i]] !== index[i];
  for (let i = 0; i < normals.length; i += 3) wrong += !(Math.abs(Math.hypot(normals[i], normals[i + 1], normals[i + 2]) - 1) < 1e-5);
  assert.equal(wrong, 0);
});

test('bytes, units and pixels read well and a bound never reads smaller than it is', () => {
  assert.deepEqual([0, 999, 1000, 18412, 3033195, 2e9].map(formatBytes), ['0 B', '999 B', '1 kB', '18.4 kB', '3.03 MB', '2 GB']);
  assert.deepEqual([0, 0.00131, 2.4e-7, 12.5, 123456].map(formatUnits), ['0', '0.00131', '2.4e-7', '12.5', '1.2e5']);
  assert.deepEqual([0, 0.004, 0.421, 0.999, 3.101, 12.2, 300].map(formatPixels), ['0', '< 0.01', '0.43', '1', '3.11', '13', '300']);
  assert.equal(formatAttributes({ texels: 29.21, uv: 0.0143, degrees: 60 }), 'Textures within 29.3 texels, normals within 60°');
  assert.equal(formatAttributes({ texels: null, uv: 0.0143, degrees: null }), 'Textures within 0.0143 of UV');
  assert.equal(formatAttributes({ texels: null, uv: null, degrees: 9.96 }), 'Normals within 10°');
  assert.equal(formatAttributes(null), '');
});

test('the address says what is shown and comes back the same; nonsense falls back to the defaults', () => {
  const state = { ...DEFAULTS, model: 'a b', px: 2.5, family: 'cluster', level: 3, spin: true, up: 'z' };
  assert.equal(formatFragment(state), '#model=a+b&px=2.5&family=cluster&up=z&level=3&spin=1');
  assert.deepEqual(parseFragment(formatFragment(state)), state);
  assert.deepEqual(parseFragment('#px=-1&x=NaN&up=q&level=1e9&rule=zzz&nothing=1'), { ...DEFAULTS });
  assert.equal(formatFragment(DEFAULTS), '');
});
