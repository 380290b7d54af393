/** Manifest and model list: checked on arrival, so that everything behind can rely on their shape. */

import { ProtocolError } from './problem.js';

/**
 * @param {unknown} json what GET /v1/models/{id} answered
 * @returns {{id, revision, source, sphere: {center: number[], radius: number}, bounds, diagonal: number,
 *   units: geometries that are simplified by themselves, {parts: number[], instances: number[][]|null}[]; families: Map<string, {name, nested, levels: Level[]}>, warnings: string[], seconds: number|null}}
 *   Level: {family, level, vertices, triangles, edges, points, error, cell, patches, attributes: {texels, uv, degrees}|null, bytes, object, type, delta: {to, bytes, object, units: {units, first, bytes, object}|null}|null}; level 0 is the
 *   coarsest; delta: the step to a finer level, units: the same in parts
 */
export function parseManifest(json) {
  const manifest = object(json, 'manifest');
  const source = object(manifest.source, 'source');
  const bounds = { min: vector(source.bounds?.min, 'source.bounds.min'), max: vector(source.bounds?.max, 'source.bounds.max') };
  const sphere = source.sphere
    ? { center: vector(source.sphere.center, 'source.sphere.center'), radius: number(source.sphere.radius, 'source.sphere.radius') }
    : sphereOfBounds(bounds);
  const families = new Map();
  for (const [name, family] of Object.entries(object(manifest.families, 'families'))) {
    if (!Array.isArray(family?.levels)) throw malformed(`families.${name}.levels`, 'a list');
    const levels = family.levels.map((level, index) => parseLevel(name, level, index));
    if (levels.length) families.set(name, { name, nested: family.nested === true, levels });
  }
  if (families.size === 0) throw malformed('families', 'at least one family with a level');
  return {
    id: text(manifest.id, 'id'),
    revision: text(manifest.revision, 'revision'),
    source,
    bounds,
    sphere: { center: sphere.center, radius: sphere.radius > 0 ? sphere.radius : 1 },
    diagonal: finite(source.diagonal) ?? distance(bounds.min, bounds.max),
    families,
    units: listUnits(manifest.parts),
    warnings: Array.isArray(manifest.bake?.warnings) ? manifest.bake.warnings.filter((w) => typeof w === 'string') : [],
    seconds: finite(manifest.bake?.seconds),
  };
}

/** @returns {{models: {id, revision, triangles, bytes, diagonal, created, families: string[]}[], next: string|null}} */
export function parseModelList(json) {
  const list = object(json, 'model list');
  if (!Array.isArray(list.models)) throw malformed('models', 'a list');
  return {
    models: list.models.map((model, i) => ({
      id: text(model?.id, `models[${i}].id`),
      revision: model.revision ?? '',
      triangles: finite(model.triangles) ?? 0,
      bytes: finite(model.bytes) ?? 0,
      diagonal: finite(model.diagonal) ?? 0,
      created: model.created ?? null,
      families: Array.isArray(model.families) ? model.families : [],
    })),
    next: typeof list.next === 'string' ? list.next : null,
  };
}

/** Levels of one family, or of all of them for "auto", coarsest (largest error) first. */
export function familyLevels(manifest, family = 'auto') {
  const families = family === 'auto' ? [...manifest.families.values()] : [manifest.families.get(family)].filter(Boolean);
  return families.flatMap((f) => f.levels).sort((a, b) => b.error - a.error || a.bytes - b.bytes);
}

/** Parts that occur once are the first unit together, in model space (instances null); each with several instances is one of its own. */
function listUnits(parts) {
  if (!Array.isArray(parts) || parts.length === 0) return [{ parts: [0], instances: null }];
  const several = (part) => Array.isArray(part?.instances) && part.instances.length > 1;
  const single = parts.flatMap((part, i) => (several(part) ? [] : [i]));
  const own = parts.flatMap((part, i) => (several(part) ? [{ parts: [i], instances: part.instances }] : []));
  return single.length > 0 ? [{ parts: single, instances: null }, ...own] : own;
}

function parseLevel(family, level, index) {
  const path = `families.${family}.levels[${index}]`;
  return {
    family,
    level: number(level?.level, `${path}.level`),
    vertices: finite(level.vertices) ?? 0,
    triangles: number(level.triangles, `${path}.triangles`),
    edges: finite(level.edges) ?? 0,
    points: finite(level.points) ?? 0,
    error: number(level.error, `${path}.error`),
    cell: finite(level.cell) ?? 0,
    patches: finite(level.patches?.patches) ?? 0,
    attributes: parseAttributes(level.drift),
    bytes: number(level.bytes, `${path}.bytes`),
    object: text(level.object, `${path}.object`),
    type: level.type ?? 'model/gltf-binary',
    delta: level.delta ? parseDelta(level.delta, `${path}.delta`) : null,
  };
}

/** How far textures and normals are proven to stay at most; null where nothing is. */
function parseAttributes(drift) {
  const texels = finite(drift?.texels_bound) ?? null, uv = finite(drift?.uv_bound) ?? null, degrees = finite(drift?.normal_degrees_bound) ?? null;
  return texels === null && uv === null && degrees === null ? null : { texels, uv, degrees };
}

function parseDelta(delta, path) {
  const { units } = delta;
  return {
    to: number(delta.to, `${path}.to`),
    bytes: number(delta.bytes, `${path}.bytes`),
    object: text(delta.object, `${path}.object`),
    units: !units ? null : {
      units: number(units.units, `${path}.units.units`),
      first: number(units.first, `${path}.units.first`),
      bytes: number(units.bytes, `${path}.units.bytes`),
      object: text(units.object, `${path}.units.object`),
    },
  };
}

function malformed(path, expected) {
  return new ProtocolError(`The server's description of the model is not usable: ${path} should be ${expected}.`, { kind: 'malformed' });
}

function object(value, path) {
  if (value === null || typeof value !== 'object' || Array.isArray(value)) throw malformed(path, 'an object');
  return value;
}

function text(value, path) {
  if (typeof value !== 'string' || value === '') throw malformed(path, 'a text');
  return value;
}

function finite(value) {
  return typeof value === 'number' && Number.isFinite(value) ? value : null;
}

function number(value, path) {
  const n = finite(value);
  if (n === null || n < 0) throw malformed(path, 'a number not below 0');
  return n;
}

function vector(value, path) {
  if (!Array.isArray(value) || value.length !== 3 || !value.every((x) => finite(x) !== null)) throw malformed(path, 'three numbers');
  return value;
}

function distance(a, b) {
  return Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
}

function sphereOfBounds({ min, max }) {
  return { center: min.map((x, i) => (x + max[i]) / 2), radius: distance(min, max) / 2 };
}
