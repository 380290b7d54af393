/** Errors a person can read: RFC 9457 problem+json from the server, or a plain sentence for everything that has none. */

export class ProtocolError extends Error {
  /**
   * @param {string} message a sentence for people
   * @param {{status?: number, type?: string, problem?: object, cause?: unknown, kind?: "problem"|"unreachable"|"malformed"}} facts
   *        kind: the server refused, the server did not answer, or the answer is not what API v1 promises
   */
  constructor(message, facts = {}) {
    super(message, facts.cause === undefined ? undefined : { cause: facts.cause });
    this.name = 'ProtocolError';
    this.kind = facts.kind ?? 'problem';
    this.status = facts.status ?? 0;
    this.type = facts.type ?? 'about:blank';
    this.problem = facts.problem ?? null;
  }
}

/** For statuses that came without a problem document, from a proxy for example. */
const STATUS_SENTENCES = new Map([
  [400, 'The server did not understand the request.'],
  [401, 'The server wants a token for this.'],
  [403, 'The server does not allow this.'],
  [404, 'The server has nothing under this name.'],
  [405, 'The server does not allow this here.'],
  [408, 'The server waited too long for the request.'],
  [413, 'The file is larger than the server accepts.'],
  [415, 'The server cannot read this kind of file.'],
  [429, 'The server is asked too often; try again in a while.'],
  [500, 'The server failed.'],
  [502, 'The proxy could not reach the server.'],
  [503, 'The server is busy; try again in a while.'],
  [504, 'The server took too long to answer.'],
  [507, 'The server has no space left.'],
]);

/** One sentence for a problem document: its detail, else its title, else what the status means; ends with a full stop. */
export function sentence(problem, status = 0) {
  const said = [problem?.detail, problem?.title].find((text) => typeof text === 'string' && text.trim() !== '');
  if (said === undefined) return STATUS_SENTENCES.get(status) ?? `The server answered with status ${status}.`;
  const text = said.trim();
  const capital = text[0].toUpperCase() + text.slice(1);
  return /[.!?…]$/.test(capital) ? capital : `${capital}.`;
}

/** The error for a response whose status is not 2xx. body: its text, "" when it has none. */
export function problemFromResponse(status, contentType, body) {
  let problem = null;
  if (/^application\/(problem\+)?json\b/i.test(contentType ?? '')) {
    try {
      const value = JSON.parse(body);
      if (value !== null && typeof value === 'object' && !Array.isArray(value)) problem = value;
    } catch {
      // A proxy may cut the body short; the status still says enough.
    }
  }
  return new ProtocolError(sentence(problem, status), { status, type: problem?.type, problem });
}
