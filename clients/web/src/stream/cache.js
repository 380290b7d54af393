/**
 * A byte-bounded least-recently-used cache. What is held (drawn now, for example) is never thrown out, even when that exceeds the bound.
 */
export class ByteCache {
  /**
   * @param {number} limit bytes
   * @param {(value, key) => void} onEvict called for whatever leaves: to free GPU memory
   */
  constructor(limit, onEvict = () => {}) {
    this.limit = limit;
    this.onEvict = onEvict;
    this.bytes = 0;
    /** Map order is the order of use: the first is the least recently used. */
    this.entries = new Map();
  }

  get size() {
    return this.entries.size;
  }

  has(key) {
    return this.entries.has(key);
  }

  /** The value, which becomes the most recently used; undefined when there is none. */
  get(key) {
    const entry = this.entries.get(key);
    if (!entry) return undefined;
    this.entries.delete(key);
    this.entries.set(key, entry);
    return entry.value;
  }

  set(key, value, bytes) {
    if (!(bytes >= 0)) throw new RangeError('bytes must not be negative');
    const old = this.entries.get(key);
    if (old) {
      this.entries.delete(key);
      this.bytes -= old.bytes;
      if (old.value !== value) this.onEvict(old.value, key);
    }
    this.entries.set(key, { value, bytes, holds: old?.holds ?? 0 });
    this.bytes += bytes;
    this.trim(key);
  }

  /** Held entries stay. Each hold needs one release. */
  hold(key) {
    const entry = this.entries.get(key);
    if (entry) entry.holds++;
    return entry !== undefined;
  }

  release(key) {
    const entry = this.entries.get(key);
    if (!entry || entry.holds === 0) return;
    entry.holds--;
    this.trim();
  }

  delete(key) {
    const entry = this.entries.get(key);
    if (!entry) return false;
    this.evict(key, entry);
    return true;
  }

  clear() {
    for (const [key, entry] of [...this.entries]) this.evict(key, entry);
  }

  /** Throws out the least recently used until the bound is kept; `newest` is spared, so that what was just fetched can be used at all. */
  trim(newest) {
    for (const [key, entry] of this.entries) {
      if (this.bytes <= this.limit) return;
      if (entry.holds === 0 && key !== newest) this.evict(key, entry);
    }
  }

  evict(key, entry) {
    this.entries.delete(key);
    this.bytes -= entry.bytes;
    this.onEvict(entry.value, key);
  }
}
