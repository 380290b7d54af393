/** What tests/sample/steps prints of levels in units, by the module, to be compared. */

/** FNV-1a over the bytes of arrays, as module.c's. */
function hashOf(...arrays) {
  let hash = 0x811c9dc5;
  for (const array of arrays) for (const byte of new Uint8Array(array.buffer, array.byteOffset, array.byteLength)) hash = Math.imul(hash ^ byte, 0x01000193);
  return hash >>> 0;
}

/** How many units there are, and the hashes of half of them joined, of what is drawn of those, and of all. */
export function takeUnits(core, bytes, base) {
  const units = core.units(bytes, base);
  const { patches } = units.facts();
  const middle = Math.floor(patches.length / 2);
  const take = (from, to) => patches.slice(from, to).forEach(({ offset, bytes: size }, p) => size && units.decode(from + p, bytes.subarray(offset, offset + size)));
  take(0, middle);
  const half = units.join();
  const drawn = units.draw(half);
  take(middle, patches.length);
  const all = units.join();
  const facts = { count: patches.length, half: half.hash, drawn: hashOf(drawn.start, drawn.end, drawn.triangles), all: all.hash };
  for (const each of [all, half, units]) each.free();
  return facts;
}
