/** Model ids: 1 to 128 of [A-Za-z0-9._-], not beginning with a dot or a dash. */

const LENGTH_MAX = 128;

export function modelIdValid(id) {
  return typeof id === 'string' && /^[A-Za-z0-9_][A-Za-z0-9._-]{0,127}$/.test(id);
}

/** "Großer Hase (2).ply" -> "Grosser-Hase-2": the base name without its ending, what an id cannot hold written as a dash. */
export function modelIdFromFileName(name) {
  const base = String(name).split(/[\\/]/).pop();
  const stem = base.replace(/(?<=.)\.[A-Za-z0-9]{1,8}$/, '');
  const plain = stem.replace(/ß/g, 'ss').normalize('NFKD').replace(/[\u0300-\u036f]/g, '');
  const id = plain
    .replace(/[^A-Za-z0-9._-]+/g, '-')
    .replace(/-{2,}/g, '-')
    .replace(/^[.-]+|[.-]+$/g, '')
    .slice(0, LENGTH_MAX);
  return id || 'model';
}

/** id itself, or id-2, id-3, ... : the first that `taken` (a Set) does not hold. */
export function uniqueModelId(id, taken) {
  if (!taken.has(id)) return id;
  for (let n = 2; ; n++) {
    const suffix = `-${n}`;
    const candidate = id.slice(0, LENGTH_MAX - suffix.length) + suffix;
    if (!taken.has(candidate)) return candidate;
  }
}
