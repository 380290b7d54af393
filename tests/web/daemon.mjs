/** The real lodestreamd on a free port with an empty store; ended by its process id. */

import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { ROOT, VIEWER } from './browser.mjs';

const START_SECONDS = 20;
const BAKE_SECONDS = 60;
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class Daemon {
  /** Without later families, so that a test sees a model's one revision; flags may say otherwise. */
  static async start(flags = []) {
    const daemon = new Daemon();
    daemon.folder = mkdtempSync(path.join(os.tmpdir(), 'lodestream-web-'));
    const program = path.join(ROOT, process.env.LODESTREAM_BUILD ?? 'build/release', 'lodestreamd');
    const args = ['--store', path.join(daemon.folder, 'store'), '--listen', '127.0.0.1:0', '--viewer', VIEWER, '--later-families', '', ...flags];
    daemon.child = spawn(program, args, { stdio: ['ignore', 'pipe', 'pipe'] });
    daemon.log = '';
    daemon.child.stderr.on('data', (data) => (daemon.log += data));
    daemon.ended = new Promise((resolve) => {
      daemon.child.on('exit', (code, signal) => resolve(`${program} ended with ${code ?? signal}`));
      daemon.child.on('error', (error) => resolve(`${program} does not start: ${error.message}; build it first`));
    });
    let out = '';
    const listening = new Promise((resolve) => {
      daemon.child.stdout.on('data', (data) => {
        out += data;
        const line = /listening on (http:\S+)/.exec(out);
        if (line) resolve(`${line[1].replace(/\/$/, '')}/`);
      });
    });
    const late = sleep(START_SECONDS * 1000).then(() => undefined);
    daemon.url = await Promise.race([listening, daemon.ended.then((why) => Promise.reject(new Error(`${why}\n${daemon.log}`))), late]);
    if (!daemon.url) throw new Error(`lodestreamd did not say where it listens within ${START_SECONDS} s\n${daemon.log}`);
    return daemon;
  }

  async stop() {
    this.child.kill('SIGTERM');
    const kill = setTimeout(() => this.child.kill('SIGKILL'), 10000);
    await this.ended;
    clearTimeout(kill);
    rmSync(this.folder, { recursive: true, force: true });
  }

  /** Uploads a file's bytes and waits for the bake; gives the manifest. */
  async bake(id, bytes, name = `${id}.ply`, seconds = BAKE_SECONDS) {
    const response = await fetch(`${this.url}v1/models/${id}?name=${name}`, { method: 'PUT', body: bytes });
    if (response.status !== 202) throw new Error(`PUT ${id}: ${response.status} ${await response.text()}`);
    const location = new URL(response.headers.get('location'), this.url);
    const end = Date.now() + seconds * 1000;
    for (;;) {
      const job = await (await fetch(location)).json();
      if (job.state === 'failed') throw new Error(`${id} failed: ${JSON.stringify(job.problem)}`);
      if (job.state === 'done') break;
      if (Date.now() > end) throw new Error(`${id} was not baked within ${seconds} s: ${JSON.stringify(job)}`);
      await sleep(50);
    }
    return (await fetch(`${this.url}v1/models/${id}`)).json();
  }
}
