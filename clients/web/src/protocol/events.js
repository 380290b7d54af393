/** Server-sent events, as the HTML standard's section 9.2 parses them: feed text in any pieces, take whole events out. */
export class EventStreamParser {
  constructor() {
    this.rest = '';
    this.data = [];
    this.event = '';
    this.first = true;
    this.afterReturn = false;
  }

  /** @param {string} text decoded UTF-8, cut anywhere. Returns [{event, data}] of the events that it completed. */
  push(text) {
    const events = [];
    for (const line of this.lines(text)) {
      if (line === '') {
        if (this.data.length) events.push({ event: this.event || 'message', data: this.data.join('\n') });
        this.data = [];
        this.event = '';
      } else {
        this.field(line);
      }
    }
    return events;
  }

  /** Lines that `text` completes; CR, LF and CR LF all end one, also when CR and LF arrive apart. */
  lines(text) {
    if (this.first && text.length) {
      if (text.charCodeAt(0) === 0xfeff) text = text.slice(1);
      this.first = false;
    }
    if (this.afterReturn && text.length) {
      if (text[0] === '\n') text = text.slice(1);
      this.afterReturn = false;
    }
    this.afterReturn = text.endsWith('\r');
    const parts = (this.rest + text).split(/\r\n|\r|\n/);
    this.rest = parts.pop();
    return parts;
  }

  field(line) {
    const colon = line.indexOf(':');
    if (colon === 0) return; // a comment, sent to keep the connection alive
    const name = colon < 0 ? line : line.slice(0, colon);
    let value = colon < 0 ? '' : line.slice(colon + 1);
    if (value.startsWith(' ')) value = value.slice(1);
    if (name === 'data') this.data.push(value);
    else if (name === 'event') this.event = value;
  }
}
