/**
 * PUT of a model's bytes with progress. fetch cannot tell how much of a body has left, so this uses XMLHttpRequest, injected so that it runs
 * without a browser.
 */

import { ProtocolError, problemFromResponse } from '../protocol/problem.js';

/**
 * @param {import('./client.js').Client} client
 * @param {string} id
 * @param {Blob|ArrayBufferView} body
 * @param {{name?: string, format?: string, onProgress?: (part: number, sent: number, total: number) => void, signal?: AbortSignal,
 *          XMLHttpRequest?: typeof XMLHttpRequest}} options
 * @returns {Promise<{job: string, location: string}>} the job that bakes it
 */
export function upload(client, id, body, options = {}) {
  const { onProgress = () => {}, signal } = options;
  const Request = options.XMLHttpRequest ?? globalThis.XMLHttpRequest;
  const url = client.urls.upload(id, { name: options.name, format: options.format });
  return new Promise((resolve, reject) => {
    if (signal?.aborted) {
      reject(new DOMException('The upload was cancelled', 'AbortError'));
      return;
    }
    const request = new Request();
    request.open('PUT', url);
    for (const [name, value] of Object.entries(client.headers())) request.setRequestHeader(name, value);
    request.setRequestHeader('content-type', 'application/octet-stream');
    request.upload.onprogress = (event) => {
      if (event.lengthComputable && event.total > 0) onProgress(event.loaded / event.total, event.loaded, event.total);
    };
    const abort = () => request.abort();
    signal?.addEventListener('abort', abort, { once: true });
    request.onloadend = () => signal?.removeEventListener('abort', abort);
    request.onload = () => {
      try {
        resolve(accepted(request, url));
      } catch (error) {
        reject(error);
      }
    };
    request.onabort = () => reject(new DOMException('The upload was cancelled', 'AbortError'));
    request.onerror = () =>
      reject(new ProtocolError('The connection broke during the upload; nothing has changed on the server.', { kind: 'unreachable' }));
    request.send(body);
  });
}

function accepted(request, url) {
  if (request.status < 200 || request.status > 299) {
    throw problemFromResponse(request.status, request.getResponseHeader('content-type'), request.responseText);
  }
  const location = request.getResponseHeader('location') ?? locationFromBody(request.responseText);
  const number = location?.match(/\/v1\/jobs\/([^/?#]+)\/?$/)?.[1];
  if (!number) throw new ProtocolError('The server took the upload but named no job.', { kind: 'malformed', status: request.status });
  return { job: decodeURIComponent(number), location: new URL(location, url).href };
}

/** A proxy or a cross-origin rule may hide the header; the daemon's body names the job as well. */
function locationFromBody(text) {
  try {
    const { job } = JSON.parse(text);
    return job === undefined ? null : `/v1/jobs/${job}`;
  } catch {
    return null;
  }
}
