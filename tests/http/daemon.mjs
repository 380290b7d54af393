// Starts lodestreamd on a free port, speaks to it with curl and with bare sockets, and stops what it started, by process id.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import net from 'node:net';
import os from 'node:os';
import path from 'node:path';
import { spawn } from 'node:child_process';
import { after } from 'node:test';
import { fileURLToPath } from 'node:url';

export const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
export const build = path.resolve(root, process.env.LODESTREAM_BUILD ?? 'build/release');
export const recipeWorker = path.join(root, 'tests/http/worker.mjs');
export const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export function makeDirectory() {
  return fs.mkdtempSync(path.join(os.tmpdir(), 'lodestream-test-'));
}

// Polls until `probe` gives something true, which is returned; fails after `seconds`, which only a fault takes: no test measures time by them.
export async function eventually(what, probe, seconds = 180) {
  const end = Date.now() + seconds * 1000;
  for (;;) {
    const result = await probe();
    if (result) return result;
    if (Date.now() > end) assert.fail(`not within ${seconds} s: ${what}`);
    await sleep(20);
  }
}

// Whatever a failed test did not stop.
const running = new Set();
after(() => {
  for (const child of running) child.kill('SIGKILL');
});

export class Daemon {
  // flags: further flags; store: a folder to use instead of a fresh one, which is then kept; worker: path of the worker program;
  // later: families of a second bake; refine: warm workers.
  static async start({ refine = 0, later = '', flags = [], store = null, worker = recipeWorker } = {}) {
    const daemon = new Daemon();
    daemon.directory = makeDirectory();
    daemon.store = store ?? path.join(daemon.directory, 'store');
    const viewer = path.join(daemon.directory, 'viewer');
    fs.mkdirSync(path.join(viewer, 'assets'), { recursive: true });
    fs.writeFileSync(path.join(viewer, 'index.html'), '<!doctype html><title>viewer</title>');
    fs.writeFileSync(path.join(viewer, 'assets', 'app.js'), `export const text = '${'lodestream '.repeat(500)}';\n`);
    fs.writeFileSync(path.join(viewer, 'assets', 'core.wasm'), Buffer.from([0, 0x61, 0x73, 0x6d]));
    fs.writeFileSync(path.join(daemon.directory, 'secret.txt'), 'outside');
    fs.symlinkSync('../secret.txt', path.join(viewer, 'link.txt'));
    const args = ['--store', daemon.store, '--listen', '127.0.0.1:0', '--viewer', viewer, '--worker', worker, '--later-families', later, '--refine-workers', String(refine), ...flags];
    daemon.child = spawn(path.join(build, 'lodestreamd'), args, { stdio: ['ignore', 'pipe', 'pipe'] });
    daemon.log = '';
    running.add(daemon.child);
    daemon.exited = new Promise((resolve) => daemon.child.on('exit', (code, signal) => resolve({ code, signal })));
    daemon.exited.then(() => running.delete(daemon.child));
    daemon.child.on('error', (error) => (daemon.log += error.message));
    daemon.child.stderr.on('data', (data) => (daemon.log += data));
    let out = '';
    daemon.child.stdout.on('data', (data) => (out += data));
    let ended = false; // and the polling with it
    const started = await Promise.race([
      eventually('the line with the address', () => /^listening on (https?:\/\/\S+)\n/.exec(out) ?? ended),
      daemon.exited.then((how) => {
        ended = true;
        fs.rmSync(daemon.directory, { recursive: true, force: true });
        throw new Error(`lodestreamd ended: ${JSON.stringify(how)}\n${daemon.log}`);
      }),
    ]);
    daemon.url = started[1];
    daemon.port = Number(new URL(daemon.url).port);
    return daemon;
  }

  // SIGTERM, then SIGKILL after `seconds`; removes the folder. Gives how it ended.
  async stop(seconds = 60) {
    this.child.kill('SIGTERM');
    const timer = setTimeout(() => this.child.kill('SIGKILL'), seconds * 1000);
    const how = await this.exited;
    clearTimeout(timer);
    fs.rmSync(this.directory, { recursive: true, force: true });
    assert.doesNotMatch(this.log, /Sanitizer|runtime error/, this.log);
    return how;
  }

  // One request by curl. args: curl's own. Gives status (0 = no answer), headers by lower-case name, body, and curl's exit code.
  curl(target, args = [], input = null) {
    return curl(this.url + target, args, input);
  }

  async json(target, args = []) {
    const response = await this.curl(target, args);
    return { ...response, json: JSON.parse(response.body) };
  }

  // Uploads a recipe (see worker.mjs) and waits for its job to end; gives the job.
  async bake(id, recipe, args = []) {
    const response = await this.curl(`/v1/models/${id}`, ['-T', '-', ...args], JSON.stringify(recipe));
    assert.equal(response.status, 202, String(response.body));
    return this.finished(response.headers.location);
  }

  async finished(job, seconds = 180) {
    return eventually(`${job} ends`, async () => {
      const { json } = await this.json(job);
      return (json.state === 'done' || json.state === 'failed') && json;
    }, seconds);
  }

  // A bare connection; text and closed are kept up to date.
  connect(options = {}) {
    const socket = net.connect({ port: this.port, host: '127.0.0.1', ...options });
    socket.text = '';
    socket.isClosed = false;
    socket.setEncoding('latin1');
    socket.on('data', (data) => (socket.text += data));
    socket.on('error', () => {});
    socket.closed_ = new Promise((resolve) => socket.on('close', () => resolve((socket.isClosed = true))));
    return new Promise((resolve, reject) => {
      socket.once('connect', () => resolve(socket));
      socket.once('error', reject);
    });
  }

  async metric(name) {
    const { body } = await this.curl('/metrics');
    const line = String(body).split('\n').find((text) => text.startsWith(`${name} `));
    assert.ok(line, `no metric ${name}`);
    return Number(line.slice(name.length + 1));
  }
}

export async function curl(url, args = [], input = null) {
  const child = spawn('curl', ['-sS', '-i', '--path-as-is', '-m', '180', ...args, url], { stdio: ['pipe', 'pipe', 'pipe'] });
  const chunks = [];
  let errors = '';
  child.stdout.on('data', (data) => chunks.push(data));
  child.stderr.on('data', (data) => (errors += data));
  child.stdin.on('error', () => {});
  child.stdin.end(input ?? '');
  const exit = await new Promise((resolve) => child.on('close', resolve));
  return { ...parse(Buffer.concat(chunks)), exit, errors };
}

// The last response in `bytes`; interim ones (100 Continue) are skipped.
export function parse(bytes) {
  for (;;) {
    const end = bytes.indexOf('\r\n\r\n');
    if (end < 0) return { status: 0, headers: {}, body: bytes };
    const [first, ...lines] = bytes.subarray(0, end).toString('latin1').split('\r\n');
    const status = Number(first.split(' ')[1]);
    const body = bytes.subarray(end + 4);
    if (status >= 200) {
      const headers = {};
      for (const line of lines) headers[line.slice(0, line.indexOf(':')).toLowerCase()] = line.slice(line.indexOf(':') + 2);
      return { status, headers, body };
    }
    bytes = body;
  }
}

// Three levels of one family and two of another; cluster 1 is what error=0.1 gets, retile 1 what 0.02 gets.
export const bunny = {
  texture: true,
  families: {
    cluster: {
      levels: [
        { error: 0.5, triangles: 100, size: 3000, cell: 1 },
        { error: 0.1, triangles: 1000, size: 20000, cell: 0.2 },
        { error: 0.01, triangles: 50000, size: 4000000, cell: 0.02 },
      ],
    },
    retile: { levels: [{ error: 0.2, triangles: 200, size: 4000 }, { error: 0.02, triangles: 3000, size: 40000 }] },
  },
};
