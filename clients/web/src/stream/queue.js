/**
 * Requests with priorities, at most `concurrency` at a time; each can be cancelled while it waits and while it runs.
 * One key is one request: asking again joins the one there is. Pure: what a request does is injected.
 */
export class RequestQueue {
  constructor(concurrency = 4) {
    this.concurrency = concurrency;
    /** @type {Map<string, {key, priority, order, run, controller, promise, resolve, reject, running}>} */
    this.entries = new Map();
    this.running = 0;
    this.order = 0;
  }

  /**
   * @param {string} key names the request
   * @param {(signal: AbortSignal) => Promise<T>} run
   * @param {number} priority larger goes first; equal ones in the order in which they came
   * @returns {Promise<T>} rejects with an AbortError when cancelled
   * @template T
   */
  add(key, run, priority = 0) {
    const there = this.entries.get(key);
    if (there) {
      there.priority = priority;
      return there.promise;
    }
    const entry = { key, priority, order: this.order++, run, controller: new AbortController(), running: false };
    entry.promise = new Promise((resolve, reject) => {
      entry.resolve = resolve;
      entry.reject = reject;
    });
    // Whoever cancels need not listen; a rejection nobody waits for is no error.
    entry.promise.catch(() => {});
    this.entries.set(key, entry);
    this.pump();
    return entry.promise;
  }

  has(key) {
    return this.entries.has(key);
  }

  isRunning(key) {
    return this.entries.get(key)?.running === true;
  }

  keys() {
    return [...this.entries.keys()];
  }

  setPriority(key, priority) {
    const entry = this.entries.get(key);
    if (entry) entry.priority = priority;
  }

  /** Forgets the request; a running one is told through its signal. False when there is none of this key. */
  cancel(key) {
    const entry = this.entries.get(key);
    if (!entry) return false;
    this.remove(entry);
    entry.controller.abort();
    entry.reject(new DOMException(`${key} was cancelled`, 'AbortError'));
    this.pump();
    return true;
  }

  cancelAll() {
    for (const key of this.keys()) this.cancel(key);
  }

  remove(entry) {
    this.entries.delete(entry.key);
    if (entry.running) {
      entry.running = false;
      this.running--;
    }
  }

  pump() {
    while (this.running < this.concurrency) {
      let next = null;
      for (const entry of this.entries.values()) {
        if (entry.running) continue;
        if (!next || entry.priority > next.priority || (entry.priority === next.priority && entry.order < next.order)) next = entry;
      }
      if (!next) return;
      this.start(next);
    }
  }

  start(entry) {
    entry.running = true;
    this.running++;
    const settle = (outcome, value) => {
      // A cancelled entry is gone already, perhaps with a new one in its place: its late outcome means nothing.
      if (this.entries.get(entry.key) !== entry) return;
      this.remove(entry);
      entry[outcome](value);
      this.pump();
    };
    Promise.resolve()
      .then(() => entry.run(entry.controller.signal))
      .then(
        (value) => settle('resolve', value),
        (error) => settle('reject', error),
      );
  }
}
