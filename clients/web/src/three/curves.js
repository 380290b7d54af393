/**
 * Curved patches for three: a surface that is cut into triangles as a view moves (wasm/clod.js), with the model's own materials.
 */

import {
  BufferAttribute, BufferGeometry, DynamicDrawUsage, InterleavedBuffer, InterleavedBufferAttribute, LineSegments, Mesh, Sphere, Vector3,
} from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

const UV_NAMES = ['uv', 'uv1'];

/**
 * The materials that patch streams name by number.
 * @param {string} url of the manifest's `materials`; textures are its siblings
 * @returns {Promise<import('three').Material[]>}
 */
export async function loadMaterials(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`The materials cannot be had: ${answer.status}.`);
  const { parser } = await new GLTFLoader().parseAsync(await answer.text(), new URL('.', new URL(url, document.baseURI)).href);
  return Promise.all((parser.json.materials ?? []).map((_, i) => parser.getDependency('material', i)));
}

/** A surface on the GPU: arrays as large as the module's, of which each frame only what changed goes over. */
export class CurvedSurface {
  /**
   * @param {import('../wasm/clod.js').Curves} curves taken over
   * @param {import('three').Matrix4} place of the instance
   * @param {{of: (material: number, colored: boolean) => import('three').Material, wires, edges, nets}} materials of: -1 = none named
   * @param {number} fov vertical, degrees
   */
  constructor(curves, place, materials, fov) {
    Object.assign(this, { curves, materials, fov, geometry: new BufferGeometry(), drawnWith: [] });
    this.geometry.boundingSphere = new Sphere(new Vector3(), Infinity); // room that is not in use holds anything
    this.mesh = new Mesh(this.geometry, this.drawnWith);
    this.wires = new Mesh(this.geometry, materials.wires);
    this.edges = new LineSegments(new BufferGeometry(), materials.edges);
    this.nets = new LineSegments(new BufferGeometry(), materials.nets);
    this.inverse = place.clone().invert();
    const columns = [0, 1, 2].map((k) => new Vector3().setFromMatrixColumn(place, k).length());
    this.stretch = Math.max(...columns);
    this.skew = this.stretch / Math.min(...columns); // where axes are scaled differently the tolerance is tightened by as much
    for (const object of this.objects) {
      object.frustumCulled = false;
      object.matrixAutoUpdate = false;
      object.matrix.copy(place);
    }
    this.lines();
  }

  get objects() {
    return [this.mesh, this.wires, this.edges, this.nets];
  }

  /** Edges and nets as the module has them now. */
  lines() {
    this.edges.geometry.setAttribute('position', new BufferAttribute(this.curves.edgeLines(24), 3));
    this.nets.geometry.setAttribute('position', new BufferAttribute(this.curves.netLines(), 3));
  }

  /** Copies what changed of `values`, `size` numbers a vertex, into a buffer that `make` makes when there is none large enough. */
  fill(buffer, values, size, changed, make) {
    if (!buffer || buffer.array.length < values.length) {
      const made = make(new Float32Array(Math.ceil(values.length * 1.5)));
      made.setUsage(DynamicDrawUsage);
      made.array.set(values);
      return made;
    }
    buffer.clearUpdateRanges();
    for (const [first, count] of changed) {
      buffer.array.set(values.subarray(size * first, size * (first + count)), size * first);
      buffer.addUpdateRange(size * first, size * count);
    }
    if (changed.length > 0) buffer.needsUpdate = true;
    return buffer;
  }

  attribute(name, values, changed) {
    const attribute = this.fill(this.geometry.getAttribute(name), values, 3, changed, (array) => new BufferAttribute(array, 3));
    this.geometry.setAttribute(name, attribute);
  }

  /** UVs and colours share a buffer. */
  numbers(values, changed) {
    const { width, uv, color } = this.curves.layout;
    const buffer = this.fill(this.interleaved, values, width, changed, (array) => new InterleavedBuffer(array, width));
    if (buffer === this.interleaved) return;
    this.interleaved = buffer;
    uv.forEach((offset, set) => {
      if (offset >= 0) this.geometry.setAttribute(UV_NAMES[set], new InterleavedBufferAttribute(buffer, 2, offset));
    });
    if (color >= 0) this.geometry.setAttribute('color', new InterleavedBufferAttribute(buffer, 4, color));
  }

  indices(indices) {
    let { index } = this.geometry;
    if (!index || index.array.length < indices.length) {
      index = new BufferAttribute(new Uint32Array(Math.ceil(indices.length * 1.5)), 1).setUsage(DynamicDrawUsage);
      this.geometry.setIndex(index);
    }
    index.array.set(indices);
    index.clearUpdateRanges();
    index.addUpdateRange(0, indices.length);
    index.needsUpdate = true;
    this.geometry.setDrawRange(0, indices.length);
  }

  /** A draw for each material that is seen. */
  groups(groups) {
    const colored = this.curves.layout.color >= 0;
    this.geometry.clearGroups();
    this.drawnWith.length = 0;
    for (const { material, first, count } of groups) {
      this.geometry.addGroup(first, count, this.drawnWith.length);
      this.drawnWith.push(this.materials.of(material, colored));
    }
  }

  /** @param {{eye: Vector3, forward: Vector3, up: Vector3, aspect: number, height: number, near: number}} view in the model's space */
  update(view) {
    const eye = view.eye.clone().applyMatrix4(this.inverse);
    const turn = (v) => v.clone().transformDirection(this.inverse);
    const forward = turn(view.forward);
    const up = turn(view.up);
    up.addScaledVector(forward, -up.dot(forward)).normalize();
    const frame = this.curves.update({
      eye: eye.toArray(), forward: forward.toArray(), up: up.toArray(), fov: this.fov, aspect: view.aspect, height: view.height, near: view.near / this.stretch,
    });
    this.attribute('position', frame.positions, frame.changed);
    this.attribute('normal', frame.normals, frame.changed);
    if (frame.numbers) this.numbers(frame.numbers, frame.changed);
    this.indices(frame.indices);
    this.groups(frame.groups);
    return frame;
  }

  dispose() {
    for (const object of [this.mesh, this.edges, this.nets]) object.geometry.dispose();
    this.curves.close();
  }
}
