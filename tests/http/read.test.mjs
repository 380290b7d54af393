// Reading: levels, objects, lists, conditions, ranges, headers, the viewer's files.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { gunzipSync } from 'node:zlib';
import { Daemon, bunny } from './daemon.mjs';
import { sha256 } from './worker.mjs';

let daemon;
let manifest;

before(async () => {
  daemon = await Daemon.start();
  const job = await daemon.bake('bunny', bunny);
  assert.equal(job.state, 'done', JSON.stringify(job));
  manifest = (await daemon.json('/v1/models/bunny')).json;
});
after(() => daemon?.stop());

test('healthy and ready', async () => {
  for (const target of ['/healthz', '/readyz']) {
    const { status, body, headers } = await daemon.curl(target);
    assert.equal(status, 200);
    assert.equal(String(body), 'ok\n');
    assert.equal(headers['cache-control'], 'no-store');
  }
});

test('level with the fewest bytes that fits is sent, with what it is in the headers', async () => {
  const expected = manifest.families.retile.levels[1];
  const { status, headers, body } = await daemon.curl('/v1/models/bunny/level?error=0.05');
  assert.equal(status, 200);
  assert.equal(headers['content-type'], 'model/gltf-binary');
  assert.equal(sha256(body), expected.object);
  assert.equal(headers['content-location'], `/v1/objects/${expected.object}`);
  assert.equal(headers.etag, `"${expected.object}"`);
  assert.equal(headers['cache-control'], 'no-cache');
  assert.equal(headers['lod-family'], 'retile');
  assert.equal(headers['lod-level'], '1');
  assert.equal(Number(headers['lod-error']), 0.02);
  assert.equal(headers['lod-triangles'], '3000');
  assert.equal(headers['lod-screen-error'], undefined);
});

test('pixels choose by the view, and the screen error is told', async () => {
  // One pixel is 2 * 10 * tan(45 degrees) / 1000 = 0.02 units.
  const { headers } = await daemon.curl('/v1/models/bunny/level?px=1.01&distance=10&fov=90&height=1000');
  assert.equal(headers['lod-family'], 'retile');
  assert.equal(headers['lod-level'], '1');
  assert.ok(Math.abs(Number(headers['lod-screen-error']) - 1) < 1e-9);
  // What is shared between replies is not the screen error.
  for (const args of [[], ['-I'], ['-r', '3-9']]) {
    const further = (await daemon.curl('/v1/models/bunny/level?px=1.01&distance=20&fov=90&height=1000', ['-H', 'X-Request-Id: far', ...args])).headers;
    assert.ok(Number(further['lod-screen-error']) <= 1.01 && further['lod-screen-error'] !== headers['lod-screen-error']);
    assert.equal(further['x-request-id'], 'far');
    assert.match(further['server-timing'], /^app;dur=\d+\.\d+$/);
    const again = (await daemon.curl('/v1/models/bunny/level?px=1.01&distance=10&fov=90&height=1000', args)).headers;
    assert.equal(again['lod-screen-error'], headers['lod-screen-error']);
  }
});

test('when no level is fine enough the finest is sent and the screen error tells the truth', async () => {
  const { status, headers } = await daemon.curl('/v1/models/bunny/level?distance=0.001&fov=90&height=1000', ['-I']);
  assert.equal(status, 200);
  assert.equal(Number(headers['lod-error']), 0.01);
  assert.ok(Number(headers['lod-screen-error']) > 1000);
});

test('budgets, the cell rule and a named family choose', async () => {
  const chosen = async (query) => {
    const { headers } = await daemon.curl(`/v1/models/bunny/level?${query}`, ['-I']);
    return `${headers['lod-family']} ${headers['lod-level']}`;
  };
  assert.equal(await chosen('max_bytes=45000'), 'retile 1');
  assert.equal(await chosen('max_triangles=999'), 'retile 0');
  assert.equal(await chosen('rule=cell&x=10.1&distance=10&fov=90&height=1000'), 'cluster 1');
  assert.equal(await chosen('error=0.3&family=cluster'), 'cluster 1');
});

test('wrong query is a 400 that names the parameter', async () => {
  const wrong = {
    'px=0&distance=1': 'px', 'px=nan&distance=1': 'px', 'px=1': 'distance', '': 'distance', 'distance=-1': 'distance', 'error=inf': 'error',
    'error=0': 'error', 'error=1&max_bytes=2': 'max_bytes', 'distance=1&fov=180': 'fov', 'error=1&family=nope': 'family', 'error=1&foo=1': 'foo',
    'error=1&error=2': 'error', 'rule=best&x=1&distance=1': 'rule',
  };
  for (const [query, parameter] of Object.entries(wrong)) {
    const { status, headers, json } = await daemon.json(`/v1/models/bunny/level?${query}`);
    assert.equal(status, 400, query);
    assert.equal(headers['content-type'], 'application/problem+json');
    assert.equal(json.parameter, parameter, query);
    assert.equal(json.status, 400);
    assert.equal(json.type, '/problems/bad-parameter');
    assert.ok(json.title && json.detail);
  }
});

test('what is not there is a 404 problem', async () => {
  const types = {
    '/nope': 'unknown-path', '/v1/models/none': 'unknown-model', '/v1/models/none/level?error=1': 'unknown-model',
    [`/v1/objects/${'0'.repeat(64)}`]: 'unknown-object', '/v1/objects/abc': 'unknown-path', '/v1/jobs/999': 'unknown-job',
    '/v1/jobs/999/events': 'unknown-job', '/v1/models/bunny/delta?from=0&to=1': 'no-delta',
  };
  for (const [target, type] of Object.entries(types)) {
    const { status, json } = await daemon.json(target);
    assert.equal(status, 404, target);
    assert.equal(json.type, `/problems/${type}`, target);
  }
});

test('object is immutable and found beside the model too', async () => {
  const { object, bytes } = manifest.textures[0];
  for (const target of [`/v1/objects/${object}`, `/v1/models/bunny/${object}`]) {
    const { status, headers, body } = await daemon.curl(target);
    assert.equal(status, 200);
    assert.equal(sha256(body), object);
    assert.equal(Number(headers['content-length']), bytes);
    assert.equal(headers['content-type'], 'image/png');
    assert.equal(headers['cache-control'], 'public, max-age=31536000, immutable');
    assert.equal(headers.etag, `"${object}"`);
    assert.equal(headers['accept-ranges'], 'bytes');
  }
});

test('every answer may be read by other origins and has ETag or no-store', async () => {
  const { object } = manifest.textures[0];
  const targets = ['/', '/healthz', '/metrics', '/v1/models', '/v1/models/bunny', '/v1/models/bunny/level?error=1', `/v1/objects/${object}`, '/v1/jobs/1',
    '/v1/openapi.json', '/nope', '/v1/models?x=1', '/viewer/assets/app.js'];
  for (const target of targets) {
    for (const args of [[], ['-I']]) {
      const { headers } = await daemon.curl(target, args);
      assert.equal(headers['access-control-allow-origin'], '*', target);
      assert.equal(headers['cross-origin-resource-policy'], 'cross-origin', target);
      assert.equal(headers['x-content-type-options'], 'nosniff', target);
      assert.equal(headers['timing-allow-origin'], '*', target);
      for (const name of ['ETag', 'Content-Range', 'Content-Location', 'Location', 'Lod-Error', 'Lod-Screen-Error'])
        assert.ok(headers['access-control-expose-headers'].includes(name), `${target}: ${name}`);
      assert.ok(headers.etag || headers['cache-control'] === 'no-store', target);
    }
  }
});

test('HEAD has the headers of GET and no body', async () => {
  const { object } = manifest.textures[0];
  for (const target of ['/healthz', '/v1/models', '/v1/models/bunny', '/v1/models/bunny/level?error=1', `/v1/objects/${object}`, '/v1/openapi.json', '/']) {
    const get = await daemon.curl(target);
    const head = await daemon.curl(target, ['-I']);
    assert.equal(head.status, 200, target);
    assert.equal(head.body.length, 0, target);
    for (const name of ['date', 'server-timing', 'x-request-id']) { // of the single answer
      delete get.headers[name];
      delete head.headers[name];
    }
    assert.deepEqual(head.headers, get.headers, target);
  }
});

test('known entity tag gives 304 without a body but with the tag', async () => {
  const { object } = manifest.textures[0];
  for (const target of ['/v1/models', '/v1/models/bunny', '/v1/models/bunny/level?error=1', '/v1/models/bunny/level?distance=3', `/v1/objects/${object}`,
    '/v1/openapi.json', '/', '/viewer/assets/app.js']) {
    const first = await daemon.curl(target);
    for (const tag of [first.headers.etag, `W/${first.headers.etag}`, `"other", ${first.headers.etag}`, '*']) {
      const again = await daemon.curl(target, ['-H', `If-None-Match: ${tag}`]);
      assert.equal(again.status, 304, `${target} ${tag}`);
      assert.equal(again.body.length, 0);
      assert.equal(again.headers.etag, first.headers.etag);
      assert.notEqual(again.headers['content-length'], '0');
    }
    assert.equal((await daemon.curl(target, ['-H', 'If-None-Match: "other"'])).status, 200);
  }
});

test('single range is exact, several ranges give all, a bad one 416', async () => {
  const { object } = manifest.families.cluster.levels[1];
  const whole = (await daemon.curl(`/v1/objects/${object}`)).body;
  const size = whole.length;
  const cases = [['0-0', 0, 0], ['100-199', 100, 199], [`${size - 1}-`, size - 1, size - 1], ['-10', size - 10, size - 1], [`5-${size * 2}`, 5, size - 1]];
  for (const target of [`/v1/objects/${object}`, '/v1/models/bunny/level?error=0.1&family=cluster']) {
    for (const [range, first, last] of cases) {
      const { status, headers, body } = await daemon.curl(target, ['-H', `Range: bytes=${range}`]);
      assert.equal(status, 206, range);
      assert.equal(headers['content-range'], `bytes ${first}-${last}/${size}`);
      assert.equal(Number(headers['content-length']), last - first + 1);
      assert.equal(headers.etag, `"${object}"`);
      assert.deepEqual(body, whole.subarray(first, last + 1));
    }
    for (const range of [`${size}-`, '9-3', 'x-y', '-0']) {
      const { status, headers } = await daemon.curl(target, ['-H', `Range: bytes=${range}`]);
      assert.equal(status, 416, range);
      assert.equal(headers['content-range'], `bytes */${size}`);
    }
    assert.equal((await daemon.curl(target, ['-H', 'Range: bytes=0-1,5-6'])).body.length, size);
    assert.equal((await daemon.curl(target, ['-H', 'Range: lines=0-1'])).status, 200);
    assert.equal((await daemon.curl(target, ['-I', '-H', 'Range: bytes=0-1'])).status, 200);
  }
});

test('If-Range keeps the range only while the tag is the same', async () => {
  const { object } = manifest.families.cluster.levels[1];
  const target = `/v1/objects/${object}`;
  const ask = async (tag) => (await daemon.curl(target, ['-H', 'Range: bytes=0-9', '-H', `If-Range: ${tag}`])).status;
  assert.equal(await ask(`"${object}"`), 206);
  assert.equal(await ask('"other"'), 200);
  assert.equal(await ask(`W/"${object}"`), 200);
  assert.equal(await ask('Sun, 06 Nov 1994 08:49:37 GMT'), 200);
});

test('wrong method is 405 with Allow, OPTIONS tells what may be sent', async () => {
  const put = await daemon.curl('/v1/models', ['-X', 'PUT']);
  assert.equal(put.status, 405);
  assert.equal(put.headers.allow, 'GET, HEAD, OPTIONS');
  assert.equal((await daemon.curl('/healthz', ['-X', 'POST', '-d', 'x'])).status, 405);
  assert.equal((await daemon.curl('/healthz', ['-X', 'BREW'])).status, 405);
  const options = await daemon.curl('/v1/models/x', ['-X', 'OPTIONS', '-H', 'Origin: https://a.example', '-H', 'Access-Control-Request-Method: PUT',
    '-H', 'Access-Control-Request-Headers: authorization']);
  assert.equal(options.status, 204);
  assert.match(options.headers['access-control-allow-methods'], /PUT.*DELETE/);
  assert.match(options.headers['access-control-allow-headers'], /Authorization/);
  assert.equal(options.headers['access-control-allow-origin'], '*');
});

test('text is sent as gzip to those who take it, under a tag of its own', async () => {
  const plain = await daemon.curl('/viewer/assets/app.js');
  const zipped = await daemon.curl('/viewer/assets/app.js', ['-H', 'Accept-Encoding: gzip']);
  assert.equal(zipped.headers['content-encoding'], 'gzip');
  assert.deepEqual(gunzipSync(zipped.body), plain.body);
  assert.notEqual(zipped.headers.etag, plain.headers.etag);
  assert.equal(plain.headers.vary, 'Accept-Encoding');
  const again = await daemon.curl('/viewer/assets/app.js', ['-H', 'Accept-Encoding: gzip', '-H', `If-None-Match: ${zipped.headers.etag}`]);
  assert.equal(again.status, 304);
  const document = await daemon.curl('/v1/openapi.json', ['-H', 'Accept-Encoding: gzip']);
  assert.equal(JSON.parse(gunzipSync(document.body)).openapi, '3.1.0');
  const level = await daemon.curl('/v1/models/bunny/level?error=1', ['-H', 'Accept-Encoding: gzip']);
  assert.equal(level.headers['content-encoding'], undefined);
});

test('models are listed in order, a page at a time', async () => {
  for (const id of ['a', 'b', 'c', 'd']) await daemon.bake(id, { seed: id.charCodeAt(0), families: bunny.families });
  const seen = [];
  let target = '/v1/models?limit=2';
  for (let pages = 0; target && pages < 10; pages++) {
    const { json } = await daemon.json(target);
    assert.ok(json.models.length <= 2);
    seen.push(...json.models.map((model) => model.id));
    target = json.next && `/v1/models${json.next}`;
  }
  assert.deepEqual(seen, ['a', 'b', 'bunny', 'c', 'd']);
  for (const query of ['limit=0', 'limit=1001', 'limit=x', 'after=../x']) assert.equal((await daemon.curl(`/v1/models?${query}`)).status, 400, query);
  const { json } = await daemon.json('/v1/models?after=bunny&limit=1');
  assert.equal(json.models[0].id, 'c');
  assert.deepEqual(json.models[0].families, [{ name: 'cluster', levels: 3 }, { name: 'retile', levels: 2 }]);
});

test('viewer serves its files with their types, and nothing outside of its folder', async () => {
  const page = await daemon.curl('/');
  assert.equal(page.headers['content-type'], 'text/html; charset=utf-8');
  assert.match(String(page.body), /viewer/);
  assert.equal((await daemon.curl('/viewer/index.html')).status, 200);
  assert.equal((await daemon.curl('/viewer/assets/app.js?v=3')).headers['content-type'], 'text/javascript; charset=utf-8');
  assert.equal((await daemon.curl('/viewer/assets/core.wasm')).headers['content-type'], 'application/wasm');
  for (const target of ['/viewer/', '/viewer/../secret.txt', '/viewer/%2e%2e/secret.txt', '/viewer/..%2fsecret.txt', '/viewer/assets/../../secret.txt', '/viewer//etc/passwd',
    '/viewer/%2fetc%2fpasswd', '/viewer/link.txt', '/viewer/assets', '/viewer/.hidden', '/viewer/none.js', '/../../../../etc/passwd']) {
    const { status, body } = await daemon.curl(target);
    assert.equal(status, 404, target);
    assert.doesNotMatch(String(body), /outside|root:/, target);
  }
});

test('target that is not a URL is refused', async () => {
  for (const target of ['/v1/models/%zz', '/v1/models/a%00b', '/v1/models?x=%0d%0a']) assert.equal((await daemon.curl(target)).status, 400, target);
  assert.equal((await daemon.curl(`/${'a'.repeat(20000)}`)).status, 414);
  assert.equal((await daemon.curl('/healthz', ['-H', `X: ${'a'.repeat(20000)}`])).status, 431);
});

test('metrics count what was answered', async () => {
  const { body } = await daemon.curl('/metrics');
  const text = String(body);
  assert.match(text, /lodestream_http_requests_total\{route="\/v1\/models\/\{id\}\/level",status="200"\} \d+/);
  assert.match(text, /lodestream_models 5\n/);
  assert.match(text, /lodestream_jobs_done_total 5\n/);
  assert.match(text, /lodestream_http_partial_total [1-9]/);
  assert.match(text, /lodestream_http_not_modified_total [1-9]/);
});

test('openapi document is served and lists the paths', async () => {
  const { json } = await daemon.json('/v1/openapi.json');
  assert.ok(json.paths['/v1/models/{id}/level'].get);
  assert.ok(json.paths['/v1/models/{id}'].put);
});
