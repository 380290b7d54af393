/** Short sentences over the picture; errors stay until they are dismissed, the rest goes by itself. */

const SHOWN_MS = 5000;
const MESSAGES_MAX = 3;

export class Messages {
  constructor(element) {
    this.element = element;
    this.keyed = new Map();
  }

  /**
   * @param {string} text
   * @param {{error?: boolean, key?: string, lasting?: boolean}} options key: replaces the message of the same key
   */
  show(text, options = {}) {
    let item = options.key ? this.keyed.get(options.key) : undefined;
    if (item) {
      item.querySelector('span').textContent = text;
      item.classList.toggle('error', options.error === true);
      return;
    }
    item = document.createElement('div');
    item.className = options.error ? 'message error' : 'message';
    if (options.error) item.setAttribute('role', 'alert');
    const words = document.createElement('span');
    words.textContent = text;
    const close = document.createElement('button');
    close.type = 'button';
    close.textContent = '×';
    close.setAttribute('aria-label', 'Dismiss');
    close.onclick = () => this.remove(item);
    item.append(words, close);
    this.element.append(item);
    if (options.key) this.keyed.set(options.key, item);
    while (this.element.children.length > MESSAGES_MAX) this.remove(this.element.firstElementChild);
    if (!options.error && !options.lasting) setTimeout(() => this.remove(item), SHOWN_MS);
  }

  clear(key) {
    const item = this.keyed.get(key);
    if (item) this.remove(item);
  }

  remove(item) {
    item.remove();
    for (const [key, value] of this.keyed) if (value === item) this.keyed.delete(key);
  }
}
