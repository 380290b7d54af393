/**
 * One page: a model's curved patches, cut into triangles each frame as the view asks, in WebAssembly. No facets at any zoom.
 *   /viewer/patches.html#model=ID&level=2&pixels=0.5&edges=1&nets=1&error=1&wires=1&strict=1&up=z&eye=x,y,z&target=x,y,z
 */

import { Color, DoubleSide, LineBasicMaterial, Matrix4, MeshBasicMaterial, MeshStandardMaterial, Vector3 } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { CurvedSurface, loadMaterials } from '../three/curves.js';
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

/** Standard materials can show the error; others (unlit ones) stay as they are. */
const ready = (material, uniforms) => (material.isMeshStandardMaterial ? byError(material, uniforms) : material);

class Page {
  constructor() {
    Object.assign(this, openStage($('canvas'), FOV, asked.get('up') === 'z'));
    this.uniforms = { errorUnits: { value: 0 }, focalPixels: { value: 1 }, showError: { value: 0 } };
    const offset = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2, side: DoubleSide };
    this.own = new Map();
    this.materials = {
      of: (number, colored) => this.materialOf(number, colored, offset),
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
    const { materials } = this.manifest;
    this.given = materials ? await loadMaterials(`../v1/models/${id}/${materials.object}`) : [];
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

  /** The model's material with this number, or clay, with colours of vertices where there are any. */
  materialOf(number, colored, offset) {
    const key = `${number} ${colored}`;
    if (this.own.has(key)) return this.own.get(key);
    const given = this.given[number]?.clone();
    const material = given ?? new MeshStandardMaterial({ color: colored ? 0xffffff : 0xc9b79c, roughness: 0.45, metalness: 0.05 });
    Object.assign(material, offset, { side: given?.side ?? DoubleSide, vertexColors: colored });
    this.own.set(key, ready(material, this.uniforms));
    return material;
  }

  /** The stream of the level that is chosen, or of that which is a pixel off from where the camera is. */
  async load() {
    const choice = this.choices.get($('level').value);
    const distance = Math.max(1e-3 * this.radius, this.camera.position.distanceTo(this.centre) - this.radius);
    const url = choice ? `../v1/models/${this.id}/${choice.patches.object}` : `../v1/models/${this.id}/patches?px=1&distance=${distance}&fov=${FOV}&height=${$('canvas').clientHeight}`;
    const answer = await fetch(url);
    if (!answer.ok) throw new Error((await answer.json()).detail ?? `The patches cannot be had: ${answer.status}.`);
    const stream = new Uint8Array(await answer.arrayBuffer());
    const { slip } = choice?.patches ?? this.manifest.families.clod?.levels[Number(answer.headers.get('Lod-Level'))]?.patches ?? {};
    this.texels = slip?.texels ?? 0;
    this.error = choice ? choice.patches.error : Number(answer.headers.get('Lod-Error'));
    this.bytes = stream.length;
    const curves = await decodeCurves(fetch('clod.wasm'), stream, { copies: (unit) => Math.min(MOST_INSTANCES, this.places[unit]?.length ?? 1) });
    for (const drawn of this.drawn) drawn.dispose();
    this.scene.remove(...this.drawn.flatMap((d) => d.objects));
    const used = new Map();
    this.drawn = curves.map((c) => {
      const instance = used.get(c.unit) ?? 0;
      used.set(c.unit, instance + 1);
      return new CurvedSurface(c, this.places[c.unit]?.[instance] ?? new Matrix4(), this.materials, FOV);
    });
    for (const { objects } of this.drawn) this.scene.add(...objects);
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
    $('facts').value = `${formatCount(given)} patches in ${formatBytes(this.bytes)}\ncertified error ${formatUnits(this.error)}, at most ${formatPixels(errorPixels)} px here\n${this.texels ? `textures slip by at most ${formatPixels(this.texels)} texels\n` : ''}` +
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
