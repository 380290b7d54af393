/** What a level's response says about itself: Lod-Family, Lod-Level, Lod-Error, Lod-Screen-Error, Lod-Triangles, ETag, lengths. */

/** @param {{get(name: string): string|null}} headers a fetch Headers object or anything like it */
export function parseLevelHeaders(headers) {
  return {
    family: headers.get('lod-family'),
    level: integer(headers.get('lod-level')),
    error: number(headers.get('lod-error')),
    screenError: number(headers.get('lod-screen-error')),
    triangles: integer(headers.get('lod-triangles')),
    bytes: integer(headers.get('content-length')),
    etag: headers.get('etag'),
    location: headers.get('content-location'),
    type: headers.get('content-type'),
  };
}

function number(text) {
  if (text === null || text.trim() === '') return null;
  const value = Number(text);
  return Number.isFinite(value) ? value : null;
}

function integer(text) {
  const value = number(text);
  return value !== null && Number.isSafeInteger(value) && value >= 0 ? value : null;
}
