/**
 * Geomorphs between two levels of a nested family: fragments that lie flat on both (core/mesh/overlay.h), moved in the vertex shader. At t = 0 the
 * picture is the coarser level's, at t = 1 the finer one's: positions, normals, picture coordinates and colours are interpolated linearly, as each
 * level's own triangles do it.
 */

import { BufferAttribute, BufferGeometry, Group, Matrix3, Mesh, ShaderChunk, Vector3 } from 'three';
import { addFade } from './fade.js';

/** Of the coarser level's triangles, at most this part may be without a map; more, and the step would jump there. */
const UNMAPPED_MAX = 0.02;
const NO_FACE = 0xffffffff;
/** Above this, preparing takes longer than a person waits. */
const TRIANGLES_MAX = 600000;

export class Morpher {
  /** @param {import('../wasm/pool.js').CorePool} pool */
  constructor(pool) {
    this.pool = pool;
    this.levels = new WeakMap();
  }

  /**
   * @param {import('./level.js').LevelObject} coarse
   * @param {import('./level.js').LevelObject} fine
   * @param {{reach: number, exact?: boolean}} options reach: see Core.map
   * @returns {Promise<MorphObject|null>} null: these two cannot be morphed one to one
   */
  async morph(coarse, fine, { reach, exact = true }) {
    if (!morphable(coarse) || !morphable(fine)) return null;
    const [from, to] = await Promise.all([this.describe(coarse), this.describe(fine)]);
    const layout = LAYOUT.filter(({ name }) => from.arrays[name] && to.arrays[name]);
    const values = layout.reduce((sum, { size }) => sum + size, 0);
    const drawn = await this.pool.morph(from.id, to.id, {
      reach, exact, values, coarse: interleave(from, layout, values), fine: interleave(to, layout, values),
    });
    if (drawn.failed > UNMAPPED_MAX * (drawn.failed + drawn.mapped)) return null;
    return new MorphObject(drawn, layout, values, to);
  }

  async describe(object) {
    let known = this.levels.get(object);
    if (!known) {
      const arrays = gather(object);
      known = { ...arrays, id: await this.pool.level(arrays.arrays.position, arrays.index, arrays.materials) };
      this.levels.set(object, known);
    }
    return known;
  }

  /** The level is about to go: its copy in the worker too. */
  forget(object) {
    const known = this.levels.get(object);
    if (known) this.pool.free(known.id);
    this.levels.delete(object);
  }

  close() {
    this.pool.close();
  }
}

const LAYOUT = [
  { name: 'normal', size: 3, start: 'lodStartNormal' },
  { name: 'uv', size: 2, start: 'lodStartUv' },
  { name: 'color', size: 4, start: 'lodStartColor' },
];

/** Bars and balls have no surface to map. */
export function morphable(object) {
  return object.bars === 0 && object.triangles > 0 && object.triangles <= TRIANGLES_MAX;
}

/** A level as arrays, with what stands beside another level's: `beside` gives the attributes both have and their interleaved values. */
export function describeLevel(object) {
  const own = gather(object);
  return {
    ...own,
    beside(coarse) {
      const layout = LAYOUT.filter(({ name }) => coarse.arrays[name] && own.arrays[name]);
      const values = layout.reduce((sum, { size }) => sum + size, 0);
      return { layout, values, from: interleave(coarse, layout, values), end: interleave(own, layout, values) };
    },
  };
}

/** All triangles of a level in the space of its root: arrays by attribute (those that every mesh has), index, a material number a triangle. */
function gather(object) {
  const meshes = [];
  object.root.updateMatrixWorld(true);
  const toRoot = object.root.parent ? object.root.parent.matrixWorld.clone().invert() : null;
  object.root.traverse((child) => {
    if (child.isMesh) meshes.push(child);
  });
  const names = ['position', ...LAYOUT.map(({ name }) => name)].filter((name) => meshes.every((m) => m.geometry.attributes[name]));
  const vertices = meshes.reduce((sum, m) => sum + m.geometry.attributes.position.count, 0);
  const corners = meshes.reduce((sum, m) => sum + indexCount(m.geometry), 0);
  const size = (name) => (name === 'position' ? 3 : LAYOUT.find((l) => l.name === name).size);
  const arrays = Object.fromEntries(names.map((name) => [name, new Float32Array(vertices * size(name))]));
  const index = new Uint32Array(corners);
  const materials = new Uint32Array(corners / 3);
  const used = new Map();
  let vertex = 0;
  let corner = 0;
  for (const mesh of meshes) {
    const matrix = toRoot ? mesh.matrixWorld.clone().premultiply(toRoot) : mesh.matrixWorld;
    for (const name of names) copyAttribute(mesh.geometry.attributes[name], arrays[name], vertex * size(name), size(name), name, matrix);
    const number = (mesh.material.userData.lodMaterial ?? -1) + 1;
    used.set(number, mesh.material);
    const own = mesh.geometry.index;
    const count = indexCount(mesh.geometry);
    for (let i = 0; i < count; i++) index[corner + i] = vertex + (own ? own.getX(i) : i);
    materials.fill(number, corner / 3, (corner + count) / 3);
    vertex += mesh.geometry.attributes.position.count;
    corner += count;
  }
  return { arrays, index, materials, used };
}

function indexCount(geometry) {
  return geometry.index ? geometry.index.count : geometry.attributes.position.count;
}

const scratch = new Vector3();

function copyAttribute(attribute, out, at, size, name, matrix) {
  const normalMatrix = name === 'normal' ? new Matrix3().getNormalMatrix(matrix) : null;
  for (let v = 0; v < attribute.count; v++, at += size) {
    if (name === 'position' || name === 'normal') {
      scratch.fromBufferAttribute(attribute, v);
      if (normalMatrix) scratch.applyMatrix3(normalMatrix).normalize();
      else scratch.applyMatrix4(matrix);
      scratch.toArray(out, at);
    } else {
      for (let k = 0; k < size; k++) out[at + k] = k < attribute.itemSize ? attribute.getComponent(v, k) : 1;
    }
  }
}

function interleave({ arrays }, layout, values) {
  const vertices = arrays.position.length / 3;
  const out = new Float32Array(vertices * values);
  let offset = 0;
  for (const { name, size } of layout) {
    for (let v = 0; v < vertices; v++) for (let k = 0; k < size; k++) out[v * values + offset + k] = arrays[name][v * size + k];
    offset += size;
  }
  return out;
}

/** Drawn in place of a level while t is between its ends; the same interface as LevelObject's. */
export class MorphObject {
  /** coarse: where some triangles are the coarser level's own (drawn.coarseFaces), it; describeLevel's or the like */
  constructor(drawn, layout, values, fine, coarse = null) {
    this.root = new Group();
    this.t = { value: 0 };
    this.fade = { value: 1 };
    this.viewportHeight = { value: 1 };
    this.triangles = drawn.triangles.length / 3;
    this.bars = 0;
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute('position', new BufferAttribute(drawn.end, 3));
    this.geometry.setAttribute('lodStart', new BufferAttribute(drawn.start, 3));
    this.settles = drawn.settled !== undefined;
    if (this.settles) this.geometry.setAttribute('lodSettled', new BufferAttribute(Float32Array.from(drawn.settled), 1));
    let offset = 0;
    for (const { name, size, start } of layout) {
      this.geometry.setAttribute(name, new BufferAttribute(pick(drawn.endValues, values, offset, size), size));
      this.geometry.setAttribute(start, new BufferAttribute(pick(drawn.startValues, values, offset, size), size));
      offset += size;
    }
    const used = new Map([...(coarse?.used ?? []), ...fine.used]);
    this.materials = [...used.values()].map((material) => this.material(material, layout));
    this.sortByMaterial(drawn, [...used.keys()], fine, coarse);
    this.mesh = new Mesh(this.geometry, this.materials);
    this.mesh.frustumCulled = false; // the bounding sphere is the finer level's alone
    this.root.add(this.mesh);
    this.bytes = Object.values(this.geometry.attributes).reduce((sum, a) => sum + a.array.byteLength, this.geometry.index.array.byteLength);
  }

  material(like, layout) {
    const own = like.clone();
    addMorph(own, this.t, layout, this.settles);
    addFade(own, this.fade);
    return own;
  }

  /** Fragments of one material are drawn together. */
  sortByMaterial(drawn, numbers, fine, coarse) {
    const materialOf = (i) => (drawn.faces[i] === NO_FACE ? coarse.materials[drawn.coarseFaces[i]] : fine.materials[drawn.faces[i]]);
    const index = new Uint32Array(drawn.triangles.length);
    let at = 0;
    numbers.forEach((number, group) => {
      const begin = at;
      for (let i = 0; i < drawn.faces.length; i++) {
        if (materialOf(i) !== number) continue;
        index.set(drawn.triangles.subarray(3 * i, 3 * i + 3), at);
        at += 3;
      }
      this.geometry.addGroup(begin, at - begin, group);
    });
    this.geometry.setIndex(new BufferAttribute(index, 1));
  }

  setWireframe(on) {
    for (const material of this.materials) material.wireframe = on;
  }

  dispose() {
    this.root.removeFromParent();
    this.geometry.dispose();
    for (const material of this.materials) material.dispose();
  }
}

function pick(from, values, offset, size) {
  const out = new Float32Array((from.length / values) * size);
  for (let v = 0, i = offset; i < from.length; v += size, i += values) for (let k = 0; k < size; k++) out[v + k] = from[i + k];
  return out;
}

/** Makes a built-in material draw between two shapes; t: a uniform {value}. */
function addMorph(material, t, layout, settles) {
  const has = (name) => layout.some((l) => l.name === name);
  material.onBeforeCompile = (shader) => {
    shader.uniforms.lodT = t;
    let text = shader.vertexShader;
    let head = 'uniform float lodT;\nattribute vec3 lodStart;\n';
    head += settles ? 'attribute float lodSettled;\n#define lodAt max( lodT, lodSettled )\n' : '#define lodAt lodT\n';
    text = text.replace('#include <begin_vertex>', 'vec3 transformed = mix(lodStart, position, lodAt);');
    if (has('normal')) {
      head += 'attribute vec3 lodStartNormal;\n';
      text = text.replace('#include <beginnormal_vertex>', ShaderChunk.beginnormal_vertex.replace('vec3( normal )', 'mix(lodStartNormal, normal, lodAt)'));
      // Normals of a level are linear on its triangles; a normal of length one at every fragment's corner would not be.
      text = text.replace('#include <normal_vertex>', ShaderChunk.normal_vertex.replace('normalize( transformedNormal )', 'transformedNormal'));
    }
    if (has('uv')) {
      head += 'attribute vec2 lodStartUv;\n';
      text = text.replace('#include <uv_vertex>', ShaderChunk.uv_vertex.replace(/vec3\( \w+_UV, 1 \)/g, 'vec3( mix(lodStartUv, uv, lodAt), 1 )'));
    }
    if (has('color')) {
      head += '#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )\nattribute vec4 lodStartColor;\n#endif\n';
      text = text.replace('#include <color_vertex>', '#include <color_vertex>\n#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )\nvColor.rgb = mix(lodStartColor.rgb, color.rgb, lodAt);\n#endif');
    }
    shader.vertexShader = head + text;
  };
  material.customProgramCacheKey = () => `lod-morph ${settles} ${layout.map((l) => l.name).join(' ')}`;
}
