/**
 * One page: a model's curved patches, cut into triangles each frame as the view asks, in WebAssembly. No facets at any zoom.
 *   /viewer/patches.html#model=ID&level=2&pixels=0.5&edges=1&nets=1&error=1&wires=1&strict=1&up=z&eye=x,y,z&target=x,y,z
 */

import {
  BufferAttribute, BufferGeometry, Color, DoubleSide, DynamicDrawUsage, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, Sphere, Vector3,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { decodeCurves } from '../wasm/clod.js';
import { formatBytes, formatCount, formatPixels, formatUnits } from './format.js';
import { openStage } from './stage.js';

const FOV = 45;
const MOST_INSTANCES = 64;
const TOGGLES = ['edges', 'nets', 'error', 'wires', 'strict', 'culling', 'follow'];
const $ = (id) => document.getElementById(id);
const asked = new URLSearchParams(location.hash.slice(1));

/** Matrices of each unit's instances: parts that occur once share unit 0, in model space; each other part is a unit, in the manifest's order. */
function placesOfUnits(manifest) {
  const parts = manifest.parts ?? [];
  const units = parts.some((part) => part.instances.length === 1) || parts.length === 0 ? [[new Matrix4()]] : [];
  for (const part of parts) if (part.instances.length > 1) units.push(part.instances.map((m) => new Matrix4().fromArray(m)));
  return units;
}

/** A surface on the GPU: arrays as large as the module's, of which each frame only what changed goes over. */
class Drawn {
  constructor(curves, place, materials) {
    this.curves = curves;
    this.geometry = new BufferGeometry();
    this.geometry.boundingSphere = new Sphere(new Vector3(), Infinity); // room that is not in use holds anything
    this.mesh = new Mesh(this.geometry, materials.surface);
    this.wires = new Mesh(this.geometry, materials.wires);
    this.edges = new LineSegments(new BufferGeometry(), materials.edges);
    this.nets = new LineSegments(new BufferGeometry(), materials.nets);
    this.inverse = place.clone().invert();
    const columns = [0, 1, 2].map((k) => new Vector3().setFromMatrixColumn(place, k).length());
    this.stretch = Math.max(...columns);
    this.skew = this.stretch / Math.min(...columns); // where axes are scaled differently the tolerance is tightened by as much
    for (const object of [this.mesh, this.wires, this.edges, this.nets]) {
      object.frustumCulled = false;
      object.matrixAutoUpdate = false;
      object.matrix.copy(place);
    }
    this.lines();
  }

  /** Edges and nets as the module has them now. */
  lines() {
    this.edges.geometry.setAttribute('position', new BufferAttribute(this.curves.edgeLines(24), 3));
    this.nets.geometry.setAttribute('position', new BufferAttribute(this.curves.netLines(), 3));
  }

  attribute(name, values, size, changed) {
    let attribute = this.geometry.getAttribute(name);
    if (!attribute || attribute.array.length < values.length) {
      attribute = new BufferAttribute(new Float32Array(Math.ceil(values.length * 1.5)), size).setUsage(DynamicDrawUsage);
      this.geometry.setAttribute(name, attribute);
      attribute.array.set(values);
      return;
    }
    attribute.clearUpdateRanges();
    for (const [first, count] of changed) {
      attribute.array.set(values.subarray(size * first, size * (first + count)), size * first);
      attribute.addUpdateRange(size * first, size * count);
    }
    if (changed.length > 0) attribute.needsUpdate = true;
  }

  update(view) {
    const eye = view.eye.clone().applyMatrix4(this.inverse);
    const turn = (v) => v.clone().transformDirection(this.inverse);
    const forward = turn(view.forward);
    const up = turn(view.up);
    up.addScaledVector(forward, -up.dot(forward)).normalize();
    const frame = this.curves.update({ eye: eye.toArray(), forward: forward.toArray(), up: up.toArray(), fov: FOV, aspect: view.aspect, height: view.height, near: view.near / this.stretch });
    this.attribute('position', frame.positions, 3, frame.changed);
    this.attribute('normal', frame.normals, 3, frame.changed);
    let index = this.geometry.index;
    if (!index || index.array.length < frame.indices.length) {
      index = new BufferAttribute(new Uint32Array(Math.ceil(frame.indices.length * 1.5)), 1).setUsage(DynamicDrawUsage);
      this.geometry.setIndex(index);
    }
    index.array.set(frame.indices);
    index.clearUpdateRanges();
    index.addUpdateRange(0, frame.indices.length);
    index.needsUpdate = true;
    this.geometry.setDrawRange(0, frame.indices.length);
    return frame;
  }

  dispose() {
    for (const object of [this.mesh, this.edges, this.nets]) object.geometry.dispose();
    this.curves.close();
  }
}

/** Colours a surface by how many pixels its certified error is where it is drawn: green below half a pixel, red from two on. */
function byError(material, uniforms) {
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.fragmentShader = shader.fragmentShader
      .replace('#include <common>', '#include <common>\nuniform float errorUnits;\nuniform float focalPixels;\nuniform float showError;')
      .replace('#include <color_fragment>', `#include <color_fragment>
        float errorPixels = errorUnits * focalPixels / max(1e-9, vViewPosition.z);
        vec3 ramp = mix(mix(vec3(0.10, 0.55, 0.25), vec3(0.95, 0.80, 0.15), smoothstep(0.25, 1.0, errorPixels)), vec3(0.80, 0.10, 0.10), smoothstep(1.0, 2.0, errorPixels));
        diffuseColor.rgb = mix(diffuseColor.rgb, ramp, showError);`);
  };
  return material;
}

class Page {
  constructor() {
    Object.assign(this, openStage($('canvas'), FOV, asked.get('up') === 'z'));
    this.uniforms = { errorUnits: { value: 0 }, focalPixels: { value: 1 }, showError: { value: 0 } };
    const offset = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2, side: DoubleSide };
    this.materials = {
      surface: byError(new MeshStandardMaterial({ color: 0xc9b79c, roughness: 0.45, metalness: 0.05, ...offset }), this.uniforms),
      wires: new MeshBasicMaterial({ color: 0x1b2a38, wireframe: true, transparent: true, opacity: 0.35 }),
      edges: new LineBasicMaterial({ color: new Color(0x7a1f1f) }),
      nets: new LineBasicMaterial({ color: new Color(0x1f4f9a) }),
    };
    this.controls = new OrbitControls(this.camera, $('canvas'));
    this.controls.zoomSpeed = 1.5;
    this.controls.zoomToCursor = true;
    this.drawn = [];
    for (const name of TOGGLES) {
      if (asked.has(name)) $(name).checked = asked.get(name) === '1';
      $(name).addEventListener('change', () => this.settings());
    }
    if (asked.has('pixels')) $('pixels').value = asked.get('pixels');
    $('pixels').addEventListener('change', () => this.settings());
    $('level').addEventListener('change', () => this.load());
  }

  async open(id) {
    this.id = id;
    $('back').href = `../#${new URLSearchParams({ model: id })}`;
    this.manifest = await (await fetch(`../v1/models/${id}`)).json();
    this.places = placesOfUnits(this.manifest);
    const { min, max } = this.manifest.source.bounds;
    this.centre = new Vector3().addVectors(new Vector3(...min), new Vector3(...max)).multiplyScalar(0.5);
    this.radius = new Vector3(...max).distanceTo(this.centre);
    const choices = Object.values(this.manifest.families).flatMap((family) => family.levels).filter((level) => level.patches)
      .sort((a, b) => a.patches.patches - b.patches.patches);
    $('level').add(new Option('one pixel from here', ''));
    for (const { level, patches } of choices)
      $('level').add(new Option(`${formatCount(patches.patches)} patches, ${formatBytes(patches.bytes)}`, String(level)));
    this.choices = new Map(choices.map((level) => [String(level.level), level]));
    if (asked.has('level')) $('level').value = asked.get('level');
    const at = (name, otherwise) => (asked.has(name) ? new Vector3(...asked.get(name).split(',').map(Number)) : otherwise);
    this.controls.target.copy(at('target', this.centre));
    this.camera.position.copy(at('eye', this.centre.clone().add((asked.get('up') === 'z' ? new Vector3(0.6, -1, 0.4) : new Vector3(0.6, 0.4, 1)).normalize().multiplyScalar(this.radius * 2.7))));
    this.controls.minDistance = this.radius * 1e-5;
    this.controls.update();
    await this.load();
  }

  /** The stream of the level that is chosen, or of that which is a pixel off from where the camera is. */
  async load() {
    const choice = this.choices.get($('level').value);
    const distance = Math.max(1e-3 * this.radius, this.camera.position.distanceTo(this.centre) - this.radius);
    const url = choice ? `../v1/models/${this.id}/${choice.patches.object}` : `../v1/models/${this.id}/patches?px=1&distance=${distance}&fov=${FOV}&height=${$('canvas').clientHeight}`;
    const answer = await fetch(url);
    if (!answer.ok) throw new Error((await answer.json()).detail ?? `The patches cannot be had: ${answer.status}.`);
    const stream = new Uint8Array(await answer.arrayBuffer());
    this.error = choice ? choice.patches.error : Number(answer.headers.get('Lod-Error'));
    this.bytes = stream.length;
    const curves = await decodeCurves(fetch('clod.wasm'), stream, { copies: (unit) => Math.min(MOST_INSTANCES, this.places[unit]?.length ?? 1) });
    for (const drawn of this.drawn) drawn.dispose();
    this.scene.remove(...this.drawn.flatMap((d) => [d.mesh, d.wires, d.edges, d.nets]));
    const used = new Map();
    this.drawn = curves.map((c) => {
      const instance = used.get(c.unit) ?? 0;
      used.set(c.unit, instance + 1);
      return new Drawn(c, this.places[c.unit]?.[instance] ?? new Matrix4(), this.materials);
    });
    for (const { mesh, wires, edges, nets } of this.drawn) this.scene.add(mesh, wires, edges, nets);
    this.settings();
  }

  settings() {
    const on = Object.fromEntries(TOGGLES.map((name) => [name, $(name).checked]));
    const strict = this.strict !== on.strict;
    this.strict = on.strict;
    for (const drawn of this.drawn) {
      drawn.curves.set({ pixels: Number($('pixels').value) / drawn.skew, cullOutside: on.culling, cullBack: on.culling, strict: on.strict });
      if (strict) drawn.lines();
      drawn.wires.visible = on.wires;
      drawn.edges.visible = on.edges;
      drawn.nets.visible = on.nets;
    }
    this.uniforms.showError.value = on.error ? 1 : 0;
    this.uniforms.errorUnits.value = this.error;
    this.follow = on.follow;
    this.stale = true;
  }

  /** The camera as the module wants it; near and far go with the distance, so that any zoom has depth to draw with. */
  view() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = Math.max(distance * 0.01, this.radius * 1e-6);
    this.camera.far = distance + this.radius * 6;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld(true);
    const e = this.camera.matrixWorld.elements;
    return {
      eye: this.camera.position, forward: new Vector3(-e[8], -e[9], -e[10]).normalize(), up: new Vector3(e[4], e[5], e[6]).normalize(),
      aspect: this.width / this.height, height: this.renderer.domElement.height, near: this.camera.near,
    };
  }

  frame() {
    const { clientWidth: width, clientHeight: height } = $('canvas');
    if (this.width !== width || this.height !== height) {
      this.renderer.setPixelRatio(window.devicePixelRatio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      [this.width, this.height, this.stale] = [width, height, true];
    }
    const view = this.view();
    const now = [...view.eye.toArray(), ...view.forward.toArray(), ...view.up.toArray()].join();
    if (this.stale || (this.follow && now !== this.seen)) this.tessellate(view);
    [this.stale, this.seen] = [false, now];
    this.renderer.render(this.scene, this.camera);
    Object.assign($('facts').dataset, { frame: (this.frames = (this.frames ?? 0) + 1) });
  }

  tessellate(view) {
    const start = performance.now();
    const sum = { triangles: 0, patches: 0, visible: 0, outside: 0, back: 0, patchesMade: 0, verticesMade: 0 };
    let pixels = 0;
    for (const drawn of this.drawn) {
      const frame = drawn.update(view);
      for (const name of Object.keys(sum)) sum[name] += frame[name];
      pixels = Math.max(pixels, frame.pixels * drawn.skew);
    }
    const spent = performance.now() - start;
    const focal = view.height / (2 * Math.tan((FOV * Math.PI) / 360));
    this.uniforms.focalPixels.value = focal;
    const nearest = Math.max(view.near, view.eye.distanceTo(this.centre) - this.radius);
    const errorPixels = (this.error * focal) / nearest;
    const given = this.drawn.reduce((n, d) => n + d.curves.patches, 0);
    const n = Object.fromEntries(Object.entries(sum).map(([name, count]) => [name, formatCount(count)]));
    $('facts').value = `${formatCount(given)} patches in ${formatBytes(this.bytes)}\ncertified error ${formatUnits(this.error)}, at most ${formatPixels(errorPixels)} px here\n` +
      `${n.triangles} triangles, within ${formatPixels(pixels)} px of the curves\n${n.visible} patches seen, ${n.back} from behind, ${n.outside} outside\n` +
      `${n.patchesMade} patches, ${n.verticesMade} vertices made\n${spent.toFixed(1)} ms`;
    Object.assign($('facts').dataset, { ...sum, given, pixels, bytes: this.bytes, milliseconds: spent.toFixed(2) });
  }
}

const page = new Page();
window.page = page; // for tests and for the curious
try {
  await page.open(asked.get('model') ?? '');
  document.body.dataset.ready = 'true';
} catch (problem) {
  $('facts').value = problem.message;
  document.body.dataset.ready = 'failed';
}
const loop = () => {
  page.frame();
  requestAnimationFrame(loop);
};
requestAnimationFrame(loop);
