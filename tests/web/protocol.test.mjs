/** clients/web/src/protocol: pure functions. */

import assert from 'node:assert/strict';
import { test } from 'node:test';
import * as P from '../../clients/web/src/protocol/index.js';

test('every URL keeps the path prefix of the base, and ids are escaped', () => {
  for (const base of ['https://host.example/lod', 'https://host.example/lod/', 'https://host.example/lod/?a=1#b']) {
    const urls = new P.Urls(base);
    const at = 'https://host.example/lod/';
    assert.equal(urls.viewer(), at);
    assert.equal(urls.health(), `${at}healthz`);
    assert.equal(urls.ready(), `${at}readyz`);
    assert.equal(urls.metrics(), `${at}metrics`);
    assert.equal(urls.openapi(), `${at}v1/openapi.json`);
    assert.equal(urls.models(), `${at}v1/models`);
    assert.equal(urls.models({ limit: 20, after: 'a&b' }), `${at}v1/models?limit=20&after=a%26b`);
    assert.equal(urls.model('../x'), `${at}v1/models/..%2Fx`);
    assert.equal(urls.upload('x', { name: 'a b.ply', format: 'ply' }), `${at}v1/models/x?name=a%20b.ply&format=ply`);
    assert.equal(urls.object('ab'), `${at}v1/objects/ab`);
    assert.equal(urls.job(7), `${at}v1/jobs/7`);
    assert.equal(urls.jobEvents(7), `${at}v1/jobs/7/events`);
  }
  assert.throws(() => new P.Urls('ftp://host/'), /http/);
});

test('a level is asked for by any of its selectors, and never by a number that is none', () => {
  const urls = new P.Urls('http://h/');
  assert.equal(urls.level('m', { family: 'cluster', error: 0.001 }), 'http://h/v1/models/m/level?family=cluster&error=0.001');
  assert.equal(urls.level('m', { px: 1, distance: 2.5, fov: 60, height: 1080 }), 'http://h/v1/models/m/level?px=1&distance=2.5&fov=60&height=1080');
  assert.equal(urls.level('m', { rule: 'cell', x: 5, distance: 2, fov: 60, height: 9 }), 'http://h/v1/models/m/level?rule=cell&x=5&distance=2&fov=60&height=9');
  assert.equal(urls.level('m', { maxBytes: 1000 }), 'http://h/v1/models/m/level?max_bytes=1000');
  assert.equal(urls.level('m', { maxTriangles: 10 }), 'http://h/v1/models/m/level?max_triangles=10');
  assert.throws(() => urls.level('m', { error: NaN }), /error must be a finite number/);
});

test('an error survives its trip through the URL bit for bit', () => {
  const urls = new P.Urls('http://h/');
  for (const error of [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, 6.02e-7]) {
    assert.equal(Number(new URL(urls.level('m', { error })).searchParams.get('error')), error);
  }
});

test('pixels and units are inverse, and a unit at distance 1 under 90 degrees in 2 pixels is one pixel', () => {
  const view = { distance: 1, fov: 90, height: 2 };
  assert.ok(Math.abs(P.unitsPerPixel(view) - 1) < 1e-15);
  assert.ok(Math.abs(P.errorPixels(3, view) - 3) < 1e-14);
  const other = { distance: 7.5, fov: 37, height: 911 };
  assert.ok(Math.abs(P.errorUnits(P.errorPixels(0.02, other), other) - 0.02) < 1e-16);
  // px = error * height / (2 * distance * tan(fov / 2)), design section 1
  assert.ok(Math.abs(P.errorPixels(0.02, other) - (0.02 * 911) / (2 * 7.5 * Math.tan((37 / 360) * Math.PI))) < 1e-12);
});

test('distance is to the surface of the sphere and never below near', () => {
  const sphere = { center: [1, 2, 3], radius: 2 };
  assert.equal(P.viewDistance([1, 2, 13], sphere, 0.1), 8);
  assert.equal(P.viewDistance([1, 2, 4], sphere, 0.1), 0.1);
});

const LADDER = [
  { error: 0.4, bytes: 1000, triangles: 100, cell: 0.5 },
  { error: 0.1, bytes: 4000, triangles: 400, cell: 0.125 },
  { error: 0.025, bytes: 16000, triangles: 1600, cell: 0.03 },
  { error: 0.001, bytes: 90000, triangles: 6400, cell: 0 },
];

test('the level is the one with the fewest bytes that fits; none fits: the nearest to it', () => {
  assert.deepEqual(P.selectLevel(LADDER, 'error', 0.1), { index: 1, fits: true });
  assert.deepEqual(P.selectLevel(LADDER, 'error', 0.0999), { index: 2, fits: true });
  assert.deepEqual(P.selectLevel(LADDER, 'error', 1e-9), { index: 3, fits: false });
  assert.deepEqual(P.selectLevel(LADDER, 'bytes', 20000), { index: 2, fits: true });
  assert.deepEqual(P.selectLevel(LADDER, 'bytes', 10), { index: 0, fits: false });
  assert.deepEqual(P.selectLevel(LADDER, 'triangles', 400), { index: 1, fits: true });
});

test('by cells: the largest cell that fits; a level without cells only when no cell is small enough or none has any', () => {
  assert.deepEqual(P.selectLevel(LADDER, 'cell', 0.2), { index: 1, fits: true });
  assert.equal(P.selectLevel(LADDER, 'cell', 1e-6).index, 2);
  const bare = LADDER.map((l) => ({ ...l, cell: 0 }));
  assert.equal(P.selectLevel(bare, 'cell', 1).fits, true);
});

test('a level with fewer bytes and less error wins whatever the order', () => {
  const levels = [{ error: 0.1, bytes: 500, triangles: 1, cell: 0 }, { error: 0.05, bytes: 400, triangles: 2, cell: 0 }];
  assert.equal(P.selectLevel(levels, 'error', 0.2).index, 1);
  assert.equal(P.selectLevel([...levels].reverse(), 'error', 0.2).index, 0);
});

test('headers of a level are read, and what is missing or no number is null', () => {
  const facts = P.parseLevelHeaders(new Headers({ 'Lod-Family': 'cluster', 'Lod-Level': '3', 'Lod-Error': '0.00131', 'Lod-Triangles': '12', 'Lod-Screen-Error': 'x' }));
  assert.deepEqual([facts.family, facts.level, facts.error, facts.triangles], ['cluster', 3, 0.00131, 12]);
  assert.deepEqual([facts.screenError, facts.bytes, facts.etag], [null, null, null]);
  assert.equal(P.parseLevelHeaders(new Headers({ 'lod-level': '-1' })).level, null);
});

test('a problem is a sentence: detail, else title, else what the status means', () => {
  const json = 'application/problem+json; charset=utf-8';
  assert.equal(P.problemFromResponse(400, json, '{"detail":"px must be positive","title":"Bad"}').message, 'Px must be positive.');
  assert.equal(P.problemFromResponse(400, json, '{"title":"Bad query"}').message, 'Bad query.');
  assert.match(P.problemFromResponse(413, 'text/html', '<html>').message, /larger than the server accepts/);
  assert.match(P.problemFromResponse(418, json, '{"detail":').message, /status 418/);
  const error = P.problemFromResponse(404, json, '{"type":"/problems/unknown-model","detail":"None."}');
  assert.deepEqual([error.status, error.type, error.kind], [404, '/problems/unknown-model', 'problem']);
});

test('events are the same however the bytes are cut', () => {
  const text = '\ufeff: hello\r\nretry: 2000\r\nevent: job\r\nid: 1\r\ndata: {"a":1}\r\n\r\ndata: x\rdata:y\r\rdata: z\n\nevent: lost\n\ndata: unfinished';
  const whole = new P.EventStreamParser().push(text);
  assert.deepEqual(whole, [{ event: 'job', data: '{"a":1}' }, { event: 'message', data: 'x\ny' }, { event: 'message', data: 'z' }]);
  for (let size = 1; size < 9; size++) {
    const parser = new P.EventStreamParser();
    const events = [];
    for (let i = 0; i < text.length; i += size) events.push(...parser.push(text.slice(i, i + size)));
    assert.deepEqual(events, whole, `pieces of ${size}`);
  }
});

test('file names become ids that the server accepts', () => {
  const cases = { 'bunny.ply': 'bunny', 'My Model (2).GLB': 'My-Model-2', 'C:\\a\\b.stl': 'b', '.hidden': 'hidden', '-x.obj': 'x', 'Größe.off': 'Grosse', '日本.ply': 'model', 'v1.2.ply': 'v1.2' };
  for (const [name, id] of Object.entries(cases)) assert.equal(P.modelIdFromFileName(name), id, name);
  for (const name of ['', '...', 'a'.repeat(300), '/', '?#', '\u0000.ply']) assert.ok(P.modelIdValid(P.modelIdFromFileName(name)), name);
  assert.equal(P.uniqueModelId('a', new Set(['a', 'a-2'])), 'a-3');
  assert.ok(P.modelIdValid(P.uniqueModelId('a'.repeat(128), new Set(['a'.repeat(128)]))));
});

const MANIFEST = {
  id: 'm', revision: 'r',
  source: { triangles: 5, diagonal: 2, bounds: { min: [0, 0, 0], max: [1, 1, 1] }, sphere: { center: [0, 0, 0], radius: 1 } },
  families: { cluster: { nested: true, levels: [{ level: 0, triangles: 1, error: 0.5, bytes: 10, object: 'a' }, { level: 1, triangles: 5, error: 0.1, bytes: 50, object: 'b' }] } },
  bake: { seconds: 1, warnings: ['w', 3] },
};

test('a manifest is checked where it is used', () => {
  const manifest = P.parseManifest(MANIFEST);
  assert.deepEqual(P.familyLevels(manifest).map((l) => l.level), [0, 1]);
  assert.equal(P.familyLevels(manifest, 'cluster')[1].family, 'cluster');
  assert.deepEqual(P.familyLevels(manifest, 'none'), []);
  assert.deepEqual(manifest.warnings, ['w']);
  const without = structuredClone(MANIFEST);
  delete without.source.sphere;
  assert.ok(Math.abs(P.parseManifest(without).sphere.radius - Math.sqrt(3) / 2) < 1e-12);
});

test('a manifest that lacks something says what', () => {
  const broken = [
    [(m) => delete m.families, /families should be an object/],
    [(m) => (m.families = {}), /at least one family/],
    [(m) => (m.families.cluster.levels[1].error = NaN), /families\.cluster\.levels\[1\]\.error/],
    [(m) => (m.families.cluster.levels[0].object = ''), /levels\[0\]\.object/],
    [(m) => (m.source.bounds.min = [0, 0]), /source\.bounds\.min should be three numbers/],
  ];
  for (const [spoil, message] of broken) {
    const manifest = structuredClone(MANIFEST);
    spoil(manifest);
    assert.throws(() => P.parseManifest(manifest), message);
  }
  assert.throws(() => P.parseModelList({}), /models should be a list/);
  assert.deepEqual(P.parseModelList({ models: [{ id: 'a' }], next: null }).models[0].families, []);
});
