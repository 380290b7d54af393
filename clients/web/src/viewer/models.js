/** The list of models, and uploads: choose or drop files, follow their jobs, delete. */

import { modelIdFromFileName, uniqueModelId } from '../protocol/ids.js';
import { followJob, upload } from '../stream/index.js';
import { formatBytes, formatCount } from './format.js';

const STAGES = { queued: 'Waiting for its turn', running: 'Making levels', done: 'Done', failed: 'Failed' };
/** Of the second job, which adds families to a model that is shown already. */
const LATER_STAGES = { ...STAGES, queued: 'Ready; smaller levels will follow', running: 'Ready; making smaller levels' };

export class ModelList {
  /**
   * @param {{list: HTMLElement, uploads: HTMLElement, client, ask: (text, choices) => Promise<string|null>, onOpen: (id) => void,
   *          onGone: (id) => void, onBaked: (id) => void, onImproved: (id) => void, onError: (text) => void, onUnauthorized: () => void}} options
   */
  constructor(options) {
    this.options = options;
    this.models = [];
    this.current = null;
    this.sending = Promise.resolve();
  }

  async refresh(signal) {
    this.models = await this.options.client.models(signal);
    this.draw();
    return this.models;
  }

  setCurrent(id) {
    this.current = id;
    this.draw();
  }

  draw() {
    const { list } = this.options;
    const focused = document.activeElement?.closest?.('li')?.dataset.id;
    list.replaceChildren(...(this.models.length ? this.models.map((model) => this.row(model)) : [note('None yet')]));
    if (focused) list.querySelector(`li[data-id="${CSS.escape(focused)}"] .open`)?.focus();
  }

  row(model) {
    const item = document.createElement('li');
    item.dataset.id = model.id;
    const open = document.createElement('button');
    open.type = 'button';
    open.className = 'open';
    if (model.id === this.current) open.setAttribute('aria-current', 'true');
    const name = document.createElement('b');
    name.textContent = model.id;
    name.title = model.id;
    const facts = document.createElement('small');
    facts.textContent = `${formatCount(model.triangles)} triangles, ${formatBytes(model.bytes)}`;
    open.append(name, facts);
    open.onclick = () => this.options.onOpen(model.id);
    const remove = document.createElement('button');
    remove.type = 'button';
    remove.className = 'remove';
    remove.textContent = '×';
    remove.setAttribute('aria-label', `Delete ${model.id}`);
    remove.title = 'Delete';
    remove.onclick = () => this.remove(model.id);
    item.append(open, remove);
    return item;
  }

  async remove(id) {
    const answer = await this.options.ask(`Delete ${id} and all its levels from the server?`, [
      ['cancel', 'Keep it'],
      ['delete', 'Delete', 'danger'],
    ]);
    if (answer !== 'delete') return;
    try {
      await this.options.client.remove(id);
      this.models = this.models.filter((m) => m.id !== id);
      this.draw();
      this.options.onGone(id);
    } catch (error) {
      this.refused(error);
      this.options.onError(`${id} was not deleted: ${error.message}`);
    }
  }

  /** Files one after another: an upload uses the whole line anyway, and the first is ready the sooner. */
  add(files) {
    for (const file of files) this.sending = this.sending.then(() => this.send(file));
    return this.sending;
  }

  async send(file) {
    const taken = new Set(this.models.map((m) => m.id));
    let id = modelIdFromFileName(file.name);
    if (taken.has(id)) {
      const other = uniqueModelId(id, taken);
      const answer = await this.options.ask(`There is a model ${id} already.`, [
        ['cancel', 'Cancel'],
        ['replace', 'Replace it'],
        ['both', `Add as ${other}`, 'primary'],
      ]);
      if (answer === 'both') id = other;
      else if (answer !== 'replace') return;
    }
    const row = new UploadRow(id);
    this.options.uploads.append(row.element);
    try {
      const { job } = await upload(this.options.client, id, file, {
        name: file.name,
        signal: row.abort.signal,
        onProgress: (part, sent, total) => row.progress(part * 0.5, `Sending ${formatBytes(sent)} of ${formatBytes(total)}`),
      });
      row.progress(0.5, STAGES.queued);
      // Baking goes on beside the next file's upload.
      this.follow(id, job, row);
    } catch (error) {
      this.uploadFailed(row, error);
    }
  }

  async follow(id, job, row) {
    try {
      const done = await this.followOne(job, row, STAGES, 0.5);
      await this.refresh().catch(() => {}); // the page's own polling says when the server is gone
      this.options.onBaked(id);
      if (done.next) {
        await this.followOne(done.next, row, LATER_STAGES, 0);
        await this.refresh().catch(() => {});
        this.options.onImproved(id);
      }
      row.element.remove();
    } catch (error) {
      this.uploadFailed(row, error);
    }
  }

  /** from: where its share of the bar begins. */
  followOne(job, row, stages, from) {
    return followJob(this.options.client, job, {
      signal: row.abort.signal,
      onUpdate: (state) => {
        const words = stages[state.state] ?? state.state;
        row.progress(from + (1 - from) * (state.progress ?? 0), state.stage ? `${words}: ${state.stage}` : words);
      },
    });
  }

  uploadFailed(row, error) {
    if (error.name === 'AbortError') row.element.remove();
    else row.fail(error.message);
    this.refused(error);
  }

  refused(error) {
    if (error.status === 401 || error.status === 403) this.options.onUnauthorized();
  }
}

class UploadRow {
  constructor(id) {
    this.abort = new AbortController();
    this.element = document.createElement('li');
    const head = document.createElement('div');
    head.className = 'row';
    const name = document.createElement('b');
    name.textContent = id;
    this.close = document.createElement('button');
    this.close.type = 'button';
    this.close.className = 'small';
    this.close.textContent = 'Cancel';
    this.close.onclick = () => {
      this.abort.abort();
      this.element.remove();
    };
    head.append(name, this.close);
    this.bar = document.createElement('progress');
    this.bar.max = 1;
    this.bar.value = 0;
    this.bar.setAttribute('aria-label', `Progress of ${id}`);
    this.words = document.createElement('small');
    this.words.textContent = 'Sending';
    this.element.append(head, this.bar, this.words);
  }

  progress(part, words) {
    this.bar.value = part;
    this.words.textContent = words;
  }

  fail(sentence) {
    this.bar.remove();
    this.words.className = 'bad';
    this.words.setAttribute('role', 'alert');
    this.words.textContent = sentence;
    this.close.textContent = 'Dismiss';
  }
}

function note(text) {
  const item = document.createElement('li');
  const words = document.createElement('span');
  words.className = 'none';
  words.textContent = text;
  item.append(words);
  return item;
}
