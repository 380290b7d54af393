/**
 * A daemon of node's own for what the real one cannot be made to do on command: break connections, hold answers back, send levels that
 * are broken, fall silent, be restarted. Speaks API v1 for the models it is given.
 */

import http from 'node:http';
import { createHash } from 'node:crypto';
import { readFile } from 'node:fs/promises';
import path from 'node:path';

const TYPES = { '.html': 'text/html; charset=utf-8', '.js': 'text/javascript; charset=utf-8', '.css': 'text/css', '.svg': 'image/svg+xml', '.wasm': 'application/wasm' };

/** levels: [{glb, error, cell?, triangles, edges?, points?}], coarsest first. Returns what Mock serves. */
export function mockModel(id, levels, { center = [0, 0, 0], radius = 1, warnings = [], objects = {} } = {}) {
  const stored = new Map(Object.entries(objects));
  const described = levels.map((level, i) => {
    const object = createHash('sha256').update(level.glb).digest('hex');
    stored.set(object, { type: 'model/gltf-binary', bytes: level.glb });
    return {
      level: i, vertices: level.vertices ?? 0, triangles: level.triangles, edges: level.edges ?? 0, points: level.points ?? 0, error: level.error,
      cell: level.cell ?? level.error, bytes: level.glb.length, object, type: 'model/gltf-binary',
    };
  });
  const finest = described[described.length - 1];
  const min = center.map((c) => c - radius);
  const max = center.map((c) => c + radius);
  const manifest = {
    id, revision: createHash('sha256').update(JSON.stringify(described)).digest('hex'),
    source: { format: 'glb', name: `${id}.glb`, bytes: finest.bytes, vertices: 0, triangles: finest.triangles, components: 1, diagonal: 2 * radius * Math.sqrt(3), bounds: { min, max }, sphere: { center, radius } },
    families: { cluster: { nested: true, levels: described } }, parts: [], textures: [], bake: { seconds: 0.1, warnings },
  };
  return { manifest, objects: stored };
}

export class Mock {
  /** @param {{viewer?: string, delay?: (request) => number, prefix?: string}} options delay: milliseconds before an answer */
  constructor(options = {}) {
    this.options = options;
    this.prefix = options.prefix ?? '';
    this.models = new Map();
    this.jobs = new Map();
    this.requests = [];
    this.uploads = [];
    this.sockets = new Set();
    this.broken = () => false; // true: this request gets no answer
    this.cut = () => false; // true: this level breaks off half way
    this.bake = null;
  }

  add(model) {
    this.models.set(model.manifest.id, model);
    return this;
  }

  async start(port = 0) {
    this.server = http.createServer((request, response) => this.answer(request, response).catch((error) => response.destroy(error)));
    this.server.on('connection', (socket) => {
      this.sockets.add(socket);
      socket.on('close', () => this.sockets.delete(socket));
    });
    await new Promise((resolve) => this.server.listen(port, '127.0.0.1', resolve));
    this.port = this.server.address().port;
    this.url = `http://127.0.0.1:${this.port}${this.prefix}/`;
    return this;
  }

  async stop() {
    for (const socket of this.sockets) socket.destroy();
    await new Promise((resolve) => this.server.close(resolve));
  }

  async answer(request, response) {
    const url = new URL(request.url, 'http://mock');
    this.requests.push({ method: request.method, path: url.pathname, query: url.searchParams, range: request.headers.range ?? null });
    if (this.broken(request, url)) {
      request.socket.destroy();
      return;
    }
    const wait = this.options.delay?.(request, url) ?? 0;
    if (wait) await new Promise((resolve) => setTimeout(resolve, wait));
    if (!url.pathname.startsWith(`${this.prefix}/`)) return problem(response, 404, 'unknown-path', 'There is nothing here.');
    const parts = url.pathname.slice(this.prefix.length + 1).split('/').map(decodeURIComponent);
    if (parts[0] === '' || parts[0] === 'viewer') return this.file(response, parts[0] === '' ? 'index.html' : parts.slice(1).join('/'));
    if (parts[0] !== 'v1') return problem(response, 404, 'unknown-path', 'There is nothing here.');
    if (parts[1] === 'models' && parts.length === 2) return json(response, 200, { models: this.list(), next: null });
    if (parts[1] === 'models') return this.model(request, response, url, parts.slice(2));
    if (parts[1] === 'objects') return this.object(response, parts[2]);
    if (parts[1] === 'jobs') return this.job(request, response, parts);
    return problem(response, 404, 'unknown-path', 'There is nothing here.');
  }

  async file(response, name) {
    try {
      const bytes = await readFile(path.join(this.options.viewer, path.normalize(`/${name}`)));
      response.writeHead(200, { 'content-type': TYPES[path.extname(name)] ?? 'application/octet-stream', 'content-length': bytes.length });
      response.end(bytes);
    } catch {
      problem(response, 404, 'unknown-file', 'The viewer has no such file.');
    }
  }

  list() {
    return [...this.models.values()].map(({ manifest }) => ({
      id: manifest.id, revision: manifest.revision, triangles: manifest.source.triangles, bytes: manifest.source.bytes,
      diagonal: manifest.source.diagonal, created: '2026-01-01T00:00:00Z', families: Object.keys(manifest.families),
    }));
  }

  async model(request, response, url, [id, what]) {
    if (request.method === 'PUT') return this.put(request, response, id);
    const model = this.models.get(id);
    if (!model) return problem(response, 404, 'unknown-model', `There is no model '${id}'.`);
    if (request.method === 'DELETE') {
      this.models.delete(id);
      response.writeHead(204).end();
      return undefined;
    }
    if (what === undefined) return json(response, 200, model.manifest);
    if (what !== 'level') return this.object(response, what);
    const { levels } = model.manifest.families.cluster;
    const limit = Number(url.searchParams.get('error'));
    const level = levels.find((l) => l.error <= limit) ?? levels[levels.length - 1];
    const { bytes: whole } = model.objects.get(level.object);
    const range = /^bytes=(\d+)-(\d*)$/.exec(request.headers.range ?? ''); // a browser's cache asks for single bytes of what it has a part of
    const [from, until] = range ? [Number(range[1]), range[2] ? Number(range[2]) + 1 : whole.length] : [0, whole.length];
    const bytes = whole.subarray(from, until);
    response.writeHead(range ? 206 : 200, {
      ...(range ? { 'content-range': `bytes ${from}-${until - 1}/${whole.length}`, 'accept-ranges': 'bytes' } : {}),
      'content-type': level.type, 'content-length': bytes.length, etag: `"${level.object}"`, 'content-location': `${this.prefix}/v1/objects/${level.object}`,
      'lod-family': 'cluster', 'lod-level': level.level, 'lod-error': level.error, 'lod-triangles': level.triangles,
    });
    if (!this.cut(url)) return response.end(bytes);
    response.write(bytes.subarray(0, bytes.length >> 1));
    setTimeout(() => request.socket.destroy(), 30);
    return undefined;
  }

  object(response, sha256) {
    for (const { objects } of this.models.values()) {
      const object = objects.get(sha256);
      if (!object) continue;
      response.writeHead(200, { 'content-type': object.type, 'content-length': object.bytes.length });
      response.end(object.bytes);
      return;
    }
    problem(response, 404, 'unknown-object', 'There is no such object.');
  }

  async put(request, response, id) {
    const pieces = [];
    for await (const piece of request) pieces.push(piece);
    const bytes = Buffer.concat(pieces);
    this.uploads.push({ id, bytes });
    const number = this.jobs.size + 1;
    this.jobs.set(number, { steps: this.bake ? this.bake(id, bytes) : [], at: 0 });
    response.writeHead(202, { 'content-type': 'application/json', location: `/v1/jobs/${number}` });
    response.end(JSON.stringify({ job: number, id }));
  }

  /** A job is a list of states; each question and each event moves it on by one. */
  job(request, response, [, , number, events]) {
    const job = this.jobs.get(Number(number));
    if (!job) return problem(response, 404, 'unknown-job', 'There is no such job.');
    if (events !== 'events') return json(response, 200, job.steps[Math.min(job.at++, job.steps.length - 1)]);
    response.writeHead(200, { 'content-type': 'text/event-stream' });
    const send = () => {
      const state = job.steps[Math.min(job.at++, job.steps.length - 1)];
      response.write(`event: job\ndata: ${JSON.stringify(state)}\n\n`);
      if (state.state === 'done' || state.state === 'failed') response.end();
      else setTimeout(send, 20);
    };
    send();
    return undefined;
  }
}

function json(response, status, value) {
  const text = JSON.stringify(value);
  response.writeHead(status, { 'content-type': 'application/json', 'content-length': Buffer.byteLength(text) });
  response.end(text);
}

function problem(response, status, type, detail) {
  response.writeHead(status, { 'content-type': 'application/problem+json' });
  response.end(JSON.stringify({ type: `/problems/${type}`, title: type, status, detail }));
}
