// The `lodestream` tool from end to end: what a person types, what comes out, and the exit status.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import { spawn } from 'node:child_process';
import { after, before, test } from 'node:test';
import { Daemon, build, bunny, eventually, makeDirectory } from './daemon.mjs';
import { asGlb, asPly, checkerPng, glbJson, sheet, wavySphere } from './models.mjs';
import { sha256 } from './worker.mjs';

const tool = path.join(build, 'lodestream');
const commands = ['bake', 'inspect', 'measure', 'export', 'decode', 'get', 'check-store', 'worker'];
const DONE = 0, BAD_INPUT = 1, USAGE = 2, LIMIT = 3;
let folder, model, textured, baked;
const at = (...names) => path.join(folder, ...names);

// Runs the tool to its end, at most a minute. Gives status, stdout, stderr.
function lodestream(...args) {
  return new Promise((resolve, reject) => {
    const child = spawn(tool, args, { cwd: folder, stdio: ['ignore', 'pipe', 'pipe'], timeout: 60000, killSignal: 'SIGKILL' });
    const out = { stdout: '', stderr: '' };
    for (const name of Object.keys(out)) child[name].setEncoding('utf8').on('data', (data) => (out[name] += data));
    child.on('error', reject);
    child.on('close', (status, signal) => resolve({ status, signal, ...out }));
  });
}

async function facts(...args) {
  const { status, stdout, stderr } = await lodestream(...args, '--json');
  assert.equal(status, DONE, stderr);
  return JSON.parse(stdout);
}

const manifestOf = (directory) => JSON.parse(fs.readFileSync(at(directory, 'manifest.json')));
const objectsOf = (directory) => fs.readdirSync(at(directory, 'objects')).sort();
const levelPath = (directory, level) => at(directory, 'objects', level.object);

before(async () => {
  folder = makeDirectory();
  model = at('ball.ply');
  textured = at('sheet.glb');
  fs.writeFileSync(model, asPly(wavySphere(40)));
  fs.writeFileSync(textured, asGlb(sheet(32), checkerPng(32)));
  const { status, stderr } = await lodestream('bake', model, '-o', 'ball');
  assert.equal(status, DONE, stderr);
  baked = manifestOf('ball');
});
after(() => fs.rmSync(folder, { recursive: true, force: true }));

// A cube of n x n squares a side, and one of the edges on its face x = n.
function gridCube(n) {
  const numbers = new Map(), triangles = [];
  const vertex = (p) => numbers.get(`${p}`) ?? (numbers.set(`${p}`, numbers.size), numbers.size - 1);
  for (let axis = 0; axis < 3; axis++)
    for (const side of [0, n])
      for (let i = 0; i < n; i++)
        for (let j = 0; j < n; j++) {
          const at = (u, v) => { const p = [0, 0, 0]; p[axis] = side; p[(axis + 1) % 3] = u; p[(axis + 2) % 3] = v; return vertex(p); };
          const [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
          triangles.push(side === 0 ? [a, c, b] : [a, b, c], side === 0 ? [a, d, c] : [a, c, d]);
        }
  const rows = [...numbers.keys()].map((p) => p.replaceAll(',', ' ')).concat(triangles.map((t) => `3 ${t.join(' ')}`));
  return `ply\nformat ascii 1.0\nelement vertex ${numbers.size}\nproperty float x\nproperty float y\nproperty float z\n` +
    `element face ${triangles.length}\nproperty list uchar int vertex_indices\nend_header\n${rows.join('\n')}\n`;
}

test('an envelope keeps edges that a file names, and takes together what is coplanar at epsilon 0', async () => {
  fs.writeFileSync(at('cube.ply'), gridCube(6));
  fs.writeFileSync(at('edges.txt'), '# on one side\n\n6 3 3  6 4 3\n');
  const counts = [];
  for (const more of [[], ['--edges', 'edges.txt']]) {
    const { families } = await facts('bake', 'cube.ply', '-o', `cube${more.length}`, '--family', 'envelope', '--epsilon', '0', ...more);
    counts.push(families.envelope.levels[0].triangles);
  }
  assert.equal(counts[0], 12);
  assert.ok(counts[1] > 12 && counts[1] < 40, `${counts[1]}`);
  const wrong = { '6 3 3 6 4': /line 2: expected six numbers/, '6 3 3 6 4 3.5': /line 2: the model has no vertex/, '6 3 3 6 5 3': /line 2: no triangle has an edge/ };
  for (const [line, sentence] of Object.entries(wrong)) {
    fs.writeFileSync(at('wrong.txt'), `# an edge\n${line}\n`);
    const { status, stderr } = await lodestream('bake', 'cube.ply', '-o', 'wrong', '--family', 'envelope', '--edges', 'wrong.txt');
    assert.equal(status, BAD_INPUT, line);
    assert.match(stderr, sentence);
  }
  for (const epsilon of ['-1', 'nan', '', '-0.1%']) {
    const { status, stderr } = await lodestream('bake', 'cube.ply', '-o', 'wrong', '--family', 'envelope', '--epsilon', epsilon);
    assert.equal(status, USAGE, epsilon);
    assert.match(stderr, /expected a number of model units/);
  }
});

// gridCube with a limit at the vertices of one side.
function limitedCube(n, limit) {
  return gridCube(n).replace('property float z\n', 'property float z\nproperty float epsilon\n')
    .split('\n').map((row) => (row.split(' ').length === 3 && /^[0-9]/.test(row) ? `${row} ${row.startsWith(`${n} `) ? limit : -1}` : row)).join('\n');
}

test('an envelope says of a source that crosses itself what it cannot promise', async () => {
  const box = (d) => [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]].map((p) => p.map((x) => x + d).join(' '));
  const faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
  const ply = (boxes) => `ply\nformat ascii 1.0\nelement vertex ${8 * boxes.length}\nproperty float x\nproperty float y\nproperty float z\n` +
    `element face ${6 * boxes.length}\nproperty list uchar int vertex_indices\nend_header\n${boxes.flatMap(box).join('\n')}\n` +
    `${boxes.flatMap((_, i) => faces.map((f) => `4 ${f.map((v) => v + 8 * i).join(' ')}`)).join('\n')}\n`;
  for (const [boxes, crosses] of [[[0, 1], true], [[0, 3], false]]) {
    fs.writeFileSync(at('boxes.ply'), ply(boxes));
    const { bake: { warnings } } = await facts('bake', 'boxes.ply', '-o', 'boxes', '--family', 'envelope', '--epsilon', '1%');
    assert.equal(warnings.some((warning) => /\d+ triangles of the source cross others/.test(warning)), crosses, JSON.stringify(warnings));
  }
});

test('vertices of a file may say how near levels must stay', async () => {
  const n = 8, counts = [];
  for (const limit of [-1, 0.001]) {
    // Bumps of a tenth on all sides.
    const rows = limitedCube(n, limit).split('\n').map((row) => {
      const p = row.split(' ').map(Number);
      if (p.length !== 4 || row.startsWith('3 ')) return row;
      const off = 0.1 * ((p[0] + p[1] + p[2]) % 2);
      return [...p.slice(0, 3).map((x) => (x === 0 ? x - off : x === n ? x + off : x)), p[3]].join(' ');
    });
    fs.writeFileSync(at('limited.ply'), rows.join('\n'));
    const { families } = await facts('bake', 'limited.ply', '-o', `limited${limit}`, '--family', 'envelope', '--epsilon', '3%');
    counts.push(families.envelope.levels[0].triangles);
  }
  assert.ok(counts[0] < 40 && counts[1] > 2 * n * n && counts[1] < 3 * n * n + 40, `${counts}`);
});

test('envelope levels that nest come with steps between them, and its options are checked', async () => {
  const nested = await facts('bake', model, '-o', 'nested', '--family', 'envelope', '--epsilon', '1%', '--epsilon', '4%', '--envelope', 'nested=1');
  const { levels } = nested.families.envelope;
  const k = levels.findIndex((level) => level.delta);
  assert.ok(k >= 0, JSON.stringify(levels));
  const made = await lodestream('decode', levelPath('nested', levels[k]), path.join('nested', 'objects', levels[k].delta.object), '-o', 'step.ply');
  assert.equal(made.status, 0, made.stderr);
  const [stepped, direct] = [await facts('inspect', 'step.ply'), await facts('inspect', levelPath('nested', levels[k + 1]))];
  assert.equal(stepped.triangles, direct.triangles);
  const step = path.join('nested', 'objects', levels[k].delta.object);
  assert.equal((await lodestream('decode', '--delta', step, levelPath('nested', levels[k]), '-o', 'named.ply')).status, 0);
  assert.deepEqual(fs.readFileSync(at('named.ply')), fs.readFileSync(at('step.ply')));
  const wrong = await lodestream('decode', '--delta', step, '--delta', step, levelPath('nested', levels[k]), '-o', 'no.ply'); // the base of the second is another one
  assert.equal(wrong.status, BAD_INPUT);
  assert.match(wrong.stderr, /starts from a level/);
  for (const [option, words] of [['nested=2', /knows nested=0\|1/], ['texels=-1', /texels=-1: expected a number from 0 to 1e\+09/], ['degrees=181', /degrees=181: expected a number from 0 to 180/],
    ['rms=', /rms=: expected a number from 0 to 1\b/], ['depth=3', /depth=3: envelope knows/], ['nested', /nested: envelope knows/]]) {
    const { status, stderr } = await lodestream('bake', model, '-o', 'wrong', '--family', 'envelope', '--envelope', option);
    assert.equal(status, USAGE, option);
    assert.match(stderr, words);
  }
});

test('re-tiled levels tell of their vertices and maps, and options are checked', async () => {
  const { families } = await facts('bake', model, '-o', 'retiled', '--family', 'retile', '--vertices', '3,60,200');
  const asked = families.retile.levels.filter((level) => level.vertices_asked);
  assert.deepEqual(asked.map((level) => level.vertices_asked), [3, 60, 200]);
  for (const level of asked) assert.equal(level.candidates + level.retained, level.vertices);
  assert.ok(asked[0].vertices >= 4); // no closed surface has three
  assert.deepEqual(asked.slice(0, 2).map((level) => level.delta.unmapped), [0, 0]);
  for (const [option, words] of [['lead=2', /lead=2: expected a number from 0 to 0\.9/], ['steps=1.5', /steps=1\.5: expected a whole number from 0 to 10000/],
    ['finest=0', /finest=0: expected a number from 0\.0001 to 100, percent/], ['measure=area', /measure=area: expected one of cost, length, angle/],
    ['ratio=', /ratio=: expected a number from 1\.1 to 1000/], ['depth=3', /depth=3: retile knows mode=turk/], ['steps', /steps: retile knows/]]) {
    const { status, stderr } = await lodestream('bake', model, '-o', 'wrong', '--family', 'retile', '--retile', option);
    assert.equal(status, USAGE, option);
    assert.match(stderr, words);
  }
});

test('an option that no family reads is told', async () => {
  for (const [family, option, value] of [['retile', '--vertices', '200'], ['retile', '--retile', 'seed=1'], ['envelope', '--envelope', 'nested=1'], ['envelope', '--edges', 'edges.txt'], ['clod', '--patches', '10'], ['clod', '--patterns']]) {
    const { status, stderr } = await lodestream('bake', model, '-o', 'wrong', '--family', 'cluster', option, ...(value ? [value] : []));
    assert.equal(status, USAGE, option);
    assert.match(stderr, new RegExp(`${option} is for the family ${family}, .*: add --family ${family}`));
  }
  const { status, stderr } = await lodestream('bake', model, '-o', 'wrong', '--jobs', '9999');
  assert.equal(status, USAGE);
  assert.match(stderr, /--jobs 9999: expected a whole number up to 1024/);
});

test('every command explains itself and says its version', async () => {
  const version = fs.readFileSync(path.join(build, '../../VERSION'), 'utf8').trim();
  for (const command of [[], ...commands.map((name) => [name])]) {
    const help = await lodestream(...command, '--help');
    assert.equal(help.status, DONE, command[0]);
    assert.match(help.stdout, /^Usage: lodestream /);
    assert.equal(help.stderr, '');
    const said = await lodestream(...command, '--version');
    assert.equal(said.status, DONE, command[0]);
    assert.equal(said.stdout, `lodestream ${version}\n`);
  }
  const overview = (await lodestream('--help')).stdout;
  for (const name of commands) assert.match(overview, new RegExp(`^  ${name} +[A-Z]`, 'm'));
});

test('wrong usage is status 2, says what is wrong on stderr, prints nothing and makes nothing', async () => {
  const wrong = [
    [[], /Usage/], [['nonsense'], /nonsense/], [['bake'], /MODEL/], [['bake', model], /-o/], [['bake', model, model, '-o', 'no'], /one MODEL/],
    [['bake', model, '-o'], /value/], [['bake', model, '-o', 'no', '--nope'], /--nope/], [['bake', model, '-o', 'no', '-z'], /-z/],
    [['bake', model, '-o', 'no', '--jobs', 'many'], /--jobs many/], [['bake', model, '-o', 'no', '--max-triangles', '-1'], /--max-triangles -1/],
    [['bake', model, '-o', 'no', '--epsilon', '-1'], /--epsilon -1/], [['bake', model, '-o', 'no', '--epsilon', 'nan'], /--epsilon nan/],
    [['bake', model, '-o', 'no', '--epsilon', '1%%'], /--epsilon 1%%/], [['bake', model, '-o', 'no', '--epsilon='], /--epsilon/],
    [['bake', model, '-o', 'no', '--epsilon', 'inf'], /--epsilon inf/], [['bake', model, '-o', 'no', '--family', 'nope'], /nope.*cluster/s],
    [['measure', model], /two/], [['measure', model, model, '--relative', 'x'], /--relative x/], [['inspect'], /one MODEL/],
    [['inspect', model, '--size', '4'], /--size 4/], [['decode', model], /-o/], [['export', 'ball', '-o', 'no', '--format', 'zip'], /zip/],
    [['export', 'ball'], /-o/], [['get', 'http://127.0.0.1:9/v1/models/x'], /-o/], [['get', '-o', 'no'], /URL/], [['worker'], /lodestreamd/],
  ];
  for (const [args, sentence] of wrong) {
    const { status, stdout, stderr } = await lodestream(...args);
    assert.equal(status, USAGE, `${args}: ${stderr}`);
    assert.match(stderr, sentence, String(args));
    assert.equal(stdout, '', String(args));
  }
  assert.ok(!fs.existsSync(at('no')));
});

test('bad input is status 1 with a sentence, as JSON where that is asked for', async () => {
  fs.writeFileSync(at('noise.ply'), 'not a model at all');
  fs.writeFileSync(at('cut.glb'), fs.readFileSync(textured).subarray(0, 3000));
  const wrong = [['bake', 'none.ply', '-o', 'no'], ['bake', 'noise.ply', '-o', 'no'], ['bake', 'cut.glb', '-o', 'no'], ['inspect', 'cut.glb'],
    ['inspect', folder], ['measure', model, 'noise.ply'], ['decode', 'noise.ply', '-o', 'no.ply'], ['export', 'objects', '-o', 'no'],
    ['inspect', 'ball', '--level', '99', '--picture', 'no.png'], ['bake', model, '-o', 'noise.ply'],
    ['get', 'http://127.0.0.1:1/v1/models/x', '-o', 'no.glb', '--error', '1']];
  for (const args of wrong) {
    const plain = await lodestream(...args);
    assert.equal(plain.status, BAD_INPUT, `${args}: ${plain.stderr}`);
    assert.match(plain.stderr, /^lodestream: .{15,} \[[a-z0-9-]+\]\n$/, String(args));
    assert.equal(plain.stdout, '', String(args));
    const { problem } = JSON.parse((await lodestream(...args, '--json')).stdout);
    assert.match(problem.type, /^[a-z0-9-]+$/);
    const timeless = (text) => text.replace(/ after \d+ ms/, ''); // libcurl's
    assert.ok(timeless(plain.stderr).includes(timeless(problem.detail)), String(args));
  }
  assert.deepEqual(fs.readdirSync(folder).filter((name) => name.startsWith('no') && name !== 'noise.ply'), []);
});

test('facts that cannot be written are no success', { skip: !fs.existsSync('/dev/full') }, async () => {
  const full = fs.openSync('/dev/full', 'w');
  const child = spawn(tool, ['inspect', model, '--json'], { cwd: folder, stdio: ['ignore', full, 'ignore'] });
  fs.closeSync(full);
  assert.equal(await new Promise((resolve) => child.on('exit', resolve)), BAD_INPUT);
});

test('limit that is broken is status 3 and names the limit', async () => {
  for (const [limit, input] of [['--max-triangles', model], ['--max-vertices', model], ['--max-bytes', model], ['--max-texture-pixels', textured],
    ['--max-texture-bytes', textured], ['--max-memory', model]]) {
    const { status, stderr } = await lodestream('bake', input, '-o', 'limited', limit, '10');
    assert.equal(status, LIMIT, `${limit}: ${stderr}`);
    assert.ok(!fs.existsSync(at('limited', 'manifest.json')), limit);
    if (limit !== '--max-memory') assert.match(stderr, /\b10\b/, limit);
  }
});

test('bake writes objects under their hashes, coarsest first, errors and triangles in order', async () => {
  const { levels } = baked.families.cluster;
  assert.ok(levels.length >= 4);
  assert.equal(baked.id, 'ball');
  assert.equal(baked.source.sha256, sha256(fs.readFileSync(model)));
  assert.equal(baked.source.triangles, wavySphere(40).faces.length);
  assert.deepEqual(objectsOf('ball'), [...new Set([...levels, ...levels.flatMap(({ delta, first }) => [delta, delta?.units, first]), baked.tileset, baked.gltf]
    .filter((reference) => reference).map(({ object }) => object))].sort());
  levels.forEach((level, i) => {
    const bytes = fs.readFileSync(levelPath('ball', level));
    assert.equal(sha256(bytes), level.object);
    assert.equal(bytes.length, level.bytes);
    assert.equal(level.level, i);
    assert.ok(level.error > 0 && level.error_lower <= level.error);
    if (i === 0) return;
    assert.ok(level.error < levels[i - 1].error && level.bytes > levels[i - 1].bytes);
    assert.ok(level.triangles >= levels[i - 1].triangles);
  });
  assert.ok(levels[0].triangles <= 400 && levels.at(-1).triangles === baked.source.triangles);
});

for (const family of ['cluster', 'envelope']) {
  test(`errors that are asked of ${family} are met by levels much smaller than the source`, async () => {
    await facts('bake', model, '-o', `met-${family}`, '--family', family, '--epsilon', '1%', '--epsilon', '0.25%');
    const { families, source } = manifestOf(`met-${family}`);
    for (const share of [0.01, 0.0025]) {
      const level = families[family].levels.find(({ error }) => error <= share * source.diagonal);
      assert.ok(level, `no level meets ${share}`);
      assert.ok(level.triangles < source.triangles / 2, `${share} takes ${level.triangles} triangles`);
    }
  });
}

test('two bakes are the same byte for byte, with any number of threads, but for time and memory', async () => {
  await facts('bake', textured, '-o', 'one', '--id', 'sheet', '-j', '1');
  await facts('bake', textured, '-o', 'two', '--id', 'sheet', '-j', '2');
  await facts('bake', textured, '-o', 'again', '--id', 'sheet', '-j', '2');
  const text = (directory) => String(fs.readFileSync(at(directory, 'manifest.json'))).replace(/"(seconds|peak_bytes)":[0-9.e+-]+/g, '"$1":0');
  for (const other of ['two', 'again']) {
    assert.equal(text(other), text('one'));
    assert.deepEqual(objectsOf(other), objectsOf('one'));
    for (const name of objectsOf('one')) assert.ok(fs.readFileSync(at(other, 'objects', name)).equals(fs.readFileSync(at('one', 'objects', name))));
  }
});

test('distance that measure finds agrees with what the manifest certifies', async () => {
  for (const level of baked.families.cluster.levels) {
    const measured = await facts('measure', model, levelPath('ball', level));
    assert.ok(measured.lower >= 0 && measured.lower <= measured.upper);
    assert.ok(measured.lower <= level.error && level.error_lower <= measured.upper, `level ${level.level}: two intervals that do not meet`);
    assert.ok(measured.rms <= measured.upper);
    assert.ok(Math.abs(measured.diagonal - baked.source.diagonal) < 1e-6 * measured.diagonal);
    assert.equal(measured.a.triangles, baked.source.triangles);
    assert.equal(measured.a.closed, true);
    assert.equal(measured.a.components, 1);
    assert.ok(measured.b.triangles > 0 && measured.b.vertices > 0);
  }
  const itself = await facts('measure', model, model);
  assert.equal(itself.lower, 0);
  assert.ok(itself.upper < 1e-6);
});

test('inspect shows a model and a bake, and draws them', async () => {
  const seen = await facts('inspect', model);
  assert.equal(seen.triangles, baked.source.triangles);
  assert.equal((await facts('inspect', textured)).textures, 1);
  assert.deepEqual(await facts('inspect', 'ball'), baked);
  const plain = await lodestream('inspect', 'ball');
  for (const level of baked.families.cluster.levels) assert.match(plain.stdout, new RegExp(`^ +${level.level} .*\\d`, 'm'));
  const sizes = [];
  for (const args of [[model], ['ball', '--level', '0'], ['ball', '--wireframe']]) {
    assert.equal((await lodestream('inspect', ...args, '--picture', 'out.png', '--size', '64')).status, DONE);
    const png = fs.readFileSync(at('out.png'));
    assert.equal(png.toString('latin1', 1, 4), 'PNG');
    assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [64, 64]);
    sizes.push(sha256(png));
  }
  assert.equal(new Set(sizes).size, 3, 'different things look the same');
});

test('decoded level is the level', async () => {
  for (const level of [baked.families.cluster.levels[0], baked.families.cluster.levels.at(-1)]) {
    const decoded = await facts('decode', levelPath('ball', level), '-o', 'level.ply');
    assert.equal(decoded.triangles, level.triangles);
    assert.match(fs.readFileSync(at('level.ply'), 'latin1'), /^ply\n/);
    const { lower, upper } = await facts('measure', levelPath('ball', level), 'level.ply');
    assert.equal(lower, 0);
    assert.ok(upper <= 1e-6 * baked.source.diagonal, `${upper}`);
  }
  const piped = await lodestream('decode', levelPath('ball', baked.families.cluster.levels[0]), '-o', '-');
  assert.match(piped.stdout, /^ply\n/);
  const both = await lodestream('decode', levelPath('ball', baked.families.cluster.levels[0]), '-o', '-', '--json');
  assert.equal(both.stdout, piped.stdout, 'facts among the bytes');
  assert.equal(JSON.parse(both.stderr).triangles, baked.families.cluster.levels[0].triangles);
});

test('exported tree is served by any file server, its levels find their textures', async () => {
  assert.equal((await lodestream('bake', textured, '-o', 'sheet')).status, DONE);
  assert.equal((await lodestream('export', 'sheet', '-o', 'site', '--format', 'static')).status, DONE);
  const manifest = manifestOf('sheet');
  const server = http.createServer((request, response) => {
    const file = path.join(at('site'), path.normalize(new URL(request.url, 'http://x').pathname));
    fs.readFile(file, (error, bytes) => response.writeHead(error ? 404 : 200).end(bytes));
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const origin = `http://127.0.0.1:${server.address().port}`;
  const get = (url) => new Promise((resolve, reject) => {
    http.get(url, { agent: false }, (response) => {
      const chunks = [];
      response.on('data', (data) => chunks.push(data)).on('end', () => resolve({ status: response.statusCode, body: Buffer.concat(chunks) }));
    }).on('error', reject);
  });
  try {
    const page = await get(`${origin}/index.html`);
    assert.equal(page.status, 200);
    const served = JSON.parse((await get(`${origin}/manifest.json`)).body);
    assert.equal(served.revision, manifest.revision);
    for (const [i, level] of served.families.cluster.levels.entries()) {
      assert.match(String(page.body), new RegExp(`href="families/cluster/${i}\\.glb"`));
      for (const url of [`${origin}/families/cluster/${i}.glb`, `${origin}/objects/${level.object}`]) {
        const { status, body } = await get(url);
        assert.equal(status, 200, url);
        assert.equal(sha256(body), level.object);
        const { images } = glbJson(body);
        assert.equal(images.length, 1);
        const texture = await get(new URL(images[0].uri, url));
        assert.equal(texture.status, 200, `${images[0].uri} beside ${url}`);
        assert.ok(texture.body.equals(checkerPng(32)), 'the texture is not the one that came in');
      }
    }
  } finally {
    await new Promise((resolve) => server.close(resolve));
  }
  const twice = await lodestream('export', 'sheet', '-o', 'site');
  assert.equal(twice.status, BAD_INPUT);
  assert.match(twice.stderr, /site/);
});

test('exported tiles and glTF name what lies beside them', async () => {
  const manifest = manifestOf('sheet');
  for (const [format, document] of [['3dtiles', 'tileset.json'], ['gltf', 'model.gltf']]) {
    const out = `as-${format}`;
    assert.equal((await lodestream('export', 'sheet', '-o', out, '--format', format)).status, DONE);
    const json = JSON.parse(fs.readFileSync(at(out, document)));
    const uris = format === 'gltf' ? json.buffers.map(({ uri }) => uri) : [];
    for (let tile = json.root; tile; tile = tile.children?.[0]) uris.push(tile.content.uri);
    const objects = uris.map((uri) => sha256(fs.readFileSync(at(out, uri))));
    assert.equal(new Set(objects).size, objects.length);
    assert.ok(objects.includes(manifest.families.cluster.levels.at(-1).object), 'the finest level is among them');
    for (const uri of uris) {
      const { images } = glbJson(fs.readFileSync(at(out, uri)));
      for (const image of images) assert.ok(fs.existsSync(at(out, image.uri)), `${image.uri} beside ${uri}`);
    }
    for (const image of json.images ?? []) assert.ok(fs.existsSync(at(out, image.uri)));
  }
  const refused = await lodestream('export', 'sheet', '-o', 'no', '--format', 'gltf', '--viewer', 'site');
  assert.equal(refused.status, USAGE);
});

test('get writes the level that a server chooses and says what it is; a refusal leaves no file', async () => {
  const daemon = await Daemon.start();
  try {
    await daemon.bake('bunny', bunny);
    const url = `${daemon.url}/v1/models/bunny`;
    const out = at('got.glb');
    const got = await facts('get', url, '--px', '1', '--distance', '20', '--fov', '60', '--height', '1080', '-o', out);
    const { headers, body } = await daemon.curl('/v1/models/bunny/level?px=1&distance=20&fov=60&height=1080');
    assert.ok(fs.readFileSync(out).equals(body));
    for (const name of ['lod-family', 'lod-level', 'lod-error', 'lod-screen-error', 'lod-triangles']) assert.equal(got[name], headers[name]);
    assert.equal(got.bytes, body.length);
    fs.rmSync(out);
    const plain = await lodestream('get', `${url}/`, '--error', '0.1', '--family', 'cluster', '-o', out);
    assert.equal(plain.status, DONE, plain.stderr);
    assert.match(plain.stdout, /^lod-level +1$/m);
    fs.rmSync(out);
    for (const [target, args, sentence] of [[`${daemon.url}/v1/models/none`, ['--error', '1'], /404/], [url, ['--error', '0'], /400.*error/],
      [url, ['--error', '1', '--family', 'nope'], /400.*nope|400.*family/]]) {
      const refused = await lodestream('get', target, ...args, '-o', out);
      assert.equal(refused.status, BAD_INPUT);
      assert.match(refused.stderr, sentence);
      assert.deepEqual(fs.readdirSync(folder).filter((name) => name.startsWith('got')), []);
    }
    fs.mkdirSync(out);
    const blocked = await lodestream('get', url, '--error', '0.1', '-o', out);
    assert.equal(blocked.status, BAD_INPUT, 'a file that cannot be put into place is no success');
    assert.deepEqual(fs.readdirSync(folder).filter((name) => name.startsWith('got')), ['got.glb']);
    const tokenless = await lodestream('get', url, '--error', '0.1', '--token', 'none.txt', '-o', 'got-with-token.glb');
    assert.equal(tokenless.status, BAD_INPUT);
    assert.match(tokenless.stderr, /none\.txt/);
  } finally {
    await daemon.stop();
  }
});

test('bake that is killed leaves no manifest, and the next one into the same folder is whole', async () => {
  const large = at('large.ply');
  fs.writeFileSync(large, asPly(wavySphere(220)));
  const child = spawn(tool, ['bake', large, '-o', 'killed', '-j', '1'], { cwd: folder, stdio: 'ignore' });
  const ended = new Promise((resolve) => child.on('exit', (status, signal) => resolve(signal)));
  await eventually('the bake has begun', () => fs.existsSync(at('killed')));
  await new Promise((resolve) => setTimeout(resolve, 150));
  child.kill('SIGKILL');
  assert.equal(await ended, 'SIGKILL', 'it was done before it could be killed');
  assert.ok(!fs.existsSync(at('killed', 'manifest.json')));
  assert.equal((await lodestream('inspect', 'killed')).status, BAD_INPUT);
  await facts('bake', model, '-o', 'killed');
  for (const level of manifestOf('killed').families.cluster.levels) assert.equal(sha256(fs.readFileSync(levelPath('killed', level))), level.object);
});

test('second bake into a directory leaves nothing of the first, and nothing of anybody else is touched', async () => {
  const stranger = 'f'.repeat(64);
  let first = [];
  for (const more of [[], ['--epsilon', '2%']]) {
    const { status, stderr } = await lodestream('bake', model, '-o', 'twice', ...more);
    assert.equal(status, 0, stderr);
    if (more.length) break;
    first = fs.readdirSync(at('twice', 'objects'));
    fs.writeFileSync(at('twice', 'objects', stranger), 'somebody else');
  }
  const text = fs.readFileSync(at('twice', 'manifest.json'), 'utf8');
  const named = [...new Set([...text.matchAll(/"object":\s*"([0-9a-f]{64})"/g)].map((match) => match[1]))];
  assert.ok(first.some((name) => !named.includes(name)), 'the second bake made something else');
  assert.deepEqual(fs.readdirSync(at('twice', 'objects')).sort(), [...named, stranger].sort());
});
