/**
 * One level ready to be drawn: what GLTFLoader made of the GLB, with normals where there were none, thick edges and points as bars and balls, a
 * fade shared by all its materials, and everything counted so that it can be freed.
 */

import { BufferAttribute, BufferGeometry, Color, DoubleSide, Mesh, MeshStandardMaterial } from 'three';
import { addFade } from './fade.js';
import { thickLines, thickMaterial, thickPoints } from './thick.js';

/** For triangles without a material of their own: unglazed clay, seen from both sides, since nothing says which one is outside. */
function clay() {
  return new MeshStandardMaterial({ name: 'clay', color: new Color(0.5, 0.487, 0.465), roughness: 0.62, metalness: 0, side: DoubleSide });
}

export class LevelObject {
  /**
   * @param {import('three/addons/loaders/GLTFLoader.js').GLTF} gltf takes over everything in it
   * @param {import('./normals-pool.js').NormalsPool} normals
   * @returns {Promise<LevelObject>}
   */
  static async create(gltf, normals) {
    const root = gltf.scene ?? gltf.scenes[0];
    const made = new Map();
    const lacking = new Set();
    root.traverse((object) => {
      if (object.isMesh && !object.geometry.attributes.normal) lacking.add(object.geometry);
    });
    for (const geometry of lacking) made.set(geometry, await withNormals(geometry, normals));
    return new LevelObject(gltf, root, made);
  }

  /** made: geometry of GLTFLoader's -> the one to draw instead */
  constructor(gltf, root, made) {
    this.root = root;
    this.fade = { value: 1 };
    this.triangles = 0;
    this.bars = 0;
    this.bytes = 0;
    this.thick = new Set();
    this.viewportHeight = { value: 1 };
    this.geometries = new Set();
    this.materials = new Map();
    this.prepare(gltf, made);
    this.root.updateMatrixWorld(true);
  }

  prepare(gltf, made) {
    const drawn = [];
    this.root.traverse((object) => {
      if (object.isMesh || object.isLine || object.isPoints) drawn.push(object);
    });
    for (const object of drawn) {
      if (object.isMesh) this.prepareMesh(object, gltf, made);
      else this.replaceByBars(object, gltf, made);
    }
    for (const geometry of this.geometries) this.bytes += geometryBytes(geometry);
  }

  prepareMesh(mesh, gltf, made) {
    const lacksNormals = made.has(mesh.geometry);
    const geometry = made.get(mesh.geometry) ?? mesh.geometry;
    mesh.geometry = geometry;
    this.geometries.add(geometry);
    this.triangles += (geometry.index ? geometry.index.count : geometry.attributes.position.count) / 3;
    const primitive = primitiveOf(gltf, mesh);
    mesh.material = this.materialFor(mesh.material, primitive?.material === undefined, lacksNormals);
    mesh.material.userData.lodMaterial = primitive?.material ?? -1; // levels of one model number their materials alike
  }

  /** The level's own material for one of GLTFLoader's: faceless ones become clay, flat shading gives way to our normals. */
  materialFor(material, isDefault, lacksNormals) {
    const there = this.materials.get(material);
    if (there) return there;
    let own = material;
    if (isDefault) {
      own = clay();
      own.vertexColors = material.vertexColors;
      if (own.vertexColors) own.color.set(0xffffff);
      material.dispose();
    } else if (lacksNormals) {
      own.flatShading = false;
    }
    addFade(own, this.fade);
    this.materials.set(material, own);
    return own;
  }

  replaceByBars(object, gltf, made) {
    let geometry = made.get(object.geometry);
    if (!geometry) {
      geometry = object.isPoints ? thickPoints(object) : thickLines(object);
      made.set(object.geometry, geometry);
      this.geometries.add(geometry);
      object.geometry.dispose();
    }
    const mesh = new Mesh(geometry, this.thickMaterialFor(object, gltf));
    mesh.name = object.name;
    mesh.renderOrder = 1; // after triangles: where a bar is thinner than a pixel, what is behind it must be there to shine through
    mesh.applyMatrix4(object.matrix);
    for (const child of [...object.children]) mesh.add(child);
    if (object.parent) {
      object.parent.add(mesh);
      object.removeFromParent();
    } else {
      this.root = mesh;
    }
    this.bars += geometry.instanceCount;
  }

  thickMaterialFor(object, gltf) {
    const there = this.materials.get(object.material);
    if (there) return there;
    const base = object.material.clone();
    const primitive = primitiveOf(gltf, object);
    // Bars carry no picture coordinates: what the picture would show is somewhere in the middle.
    if (base.map) base.color.multiplyScalar(0.5);
    else if (primitive?.material === undefined && !object.geometry.attributes.color) base.color.copy(clay().color);
    const own = thickMaterial(base, object.geometry.attributes.color !== undefined, this.viewportHeight);
    addFade(own, this.fade);
    this.materials.set(object.material, own);
    this.thick.add(own);
    return own;
  }

  setWireframe(on) {
    for (const material of this.materials.values()) if (!this.thick.has(material)) material.wireframe = on;
  }

  /** Frees GPU memory. Pictures shared with other levels stay with them. */
  dispose() {
    this.root.removeFromParent();
    for (const geometry of this.geometries) geometry.dispose();
    for (const material of this.materials.values()) {
      for (const value of Object.values(material)) if (value?.isTexture) value.dispose();
      material.dispose();
    }
    this.geometries.clear();
    this.materials.clear();
  }
}

async function withNormals(geometry, pool) {
  const position = geometry.attributes.position;
  const points = floats(position);
  const { normals, corners, sources } = await pool.compute(points, geometry.index ? geometry.index.array : null);
  const split = new BufferGeometry();
  split.name = geometry.name;
  for (const [name, attribute] of Object.entries(geometry.attributes)) {
    const size = attribute.itemSize;
    const source = name === 'position' ? points : null;
    const Type = source ? Float32Array : attribute.array.constructor;
    const array = new Type(sources.length * size);
    const from = source ?? packed(attribute);
    for (let v = 0; v < sources.length; v++) for (let k = 0; k < size; k++) array[v * size + k] = from[sources[v] * size + k];
    split.setAttribute(name, new BufferAttribute(array, size, source ? false : attribute.normalized));
  }
  split.setAttribute('normal', new BufferAttribute(normals, 3));
  split.setIndex(new BufferAttribute(sources.length > 65535 ? corners : Uint16Array.from(corners), 1));
  split.userData = geometry.userData;
  geometry.dispose();
  return split;
}

function floats(attribute) {
  if (attribute.array instanceof Float32Array && !attribute.isInterleavedBufferAttribute) return attribute.array;
  const out = new Float32Array(attribute.count * 3);
  for (let i = 0; i < attribute.count; i++) {
    out[3 * i] = attribute.getX(i);
    out[3 * i + 1] = attribute.getY(i);
    out[3 * i + 2] = attribute.getZ(i);
  }
  return out;
}

/** Raw components without the gaps of interleaving. */
function packed(attribute) {
  if (!attribute.isInterleavedBufferAttribute) return attribute.array;
  const { array, stride } = attribute.data;
  const out = new array.constructor(attribute.count * attribute.itemSize);
  for (let i = 0; i < attribute.count; i++) {
    for (let k = 0; k < attribute.itemSize; k++) out[i * attribute.itemSize + k] = array[i * stride + attribute.offset + k];
  }
  return out;
}

function geometryBytes(geometry) {
  let bytes = geometry.index ? geometry.index.array.byteLength : 0;
  for (const attribute of Object.values(geometry.attributes)) bytes += attribute.array?.byteLength ?? attribute.data.array.byteLength;
  return bytes;
}

function primitiveOf(gltf, mesh) {
  const link = gltf.parser.associations.get(mesh);
  if (link?.meshes === undefined) return undefined;
  return gltf.parser.json.meshes[link.meshes].primitives[link.primitives ?? 0];
}
