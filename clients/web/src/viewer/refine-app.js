/**
 * One page: a level of a model, refined each frame where it is of interest, in WebAssembly. The mouse is the gaze, the focus and the finger.
 *   /viewer/refine.html#model=ID&kind=gaze&base=cluster:2&steps=4&up=z
 */

import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshStandardMaterial, Raycaster, Vector2, Vector3 } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { makeDraco } from '../three/loader.js';
import { Births, Refinement } from '../wasm/refine.js';
import { formatCount } from './format.js';
import { openStage } from './stage.js';

const FOV = 45;
const GROW_SECONDS = 0.3;
const OPERATIONS_A_FRAME = 1500;
const HINTS = {
  gaze: 'Finest where the mouse is, coarser towards the edge of the field of view, as an eye resolves; outlines stay twice as fine.',
  focus: 'Focus and context: finest at the point under the mouse, fading with distance.',
  part: 'Focus and context: the part under the mouse is in focus; what lies around it fades with the distance to it. A click holds it.',
  contact: 'The point that touches: the closest triangle and those around it are split, step by step.',
  face: 'Triangles within 20 degrees of edge-on.',
  silhouette: 'Edges between front and back.',
  cone: 'Triangles whose normals on the limit surface hold one that is edge-on.',
  static: 'Edges that bend outwards by more than 30 degrees: for any view.',
  curvature: 'Edges along which the normal turns by more than 10 degrees.',
  screen: 'Edges that stand off the limit surface by more than a pixel.',
  patches: 'Where Clough-Tocher patches do not join smoothly, or cross their triangle: what a finger would feel.',
  attribute: 'The interest that the model carries (glTF _DOI, PLY property doi), or the red of its vertex colours.',
  uniform: 'Everything.',
};
const $ = (id) => document.getElementById(id);
const asked = new URLSearchParams(location.hash.slice(1));

/** Arrays of all triangles of a loaded GLB, placed; each mesh is a part. */
function arrays(root) {
  const positions = [];
  const index = [];
  const parts = [];
  const values = [];
  let own = false; // an interest of the model's own, in alpha
  let part = 0;
  const p = new Vector3();
  root.updateMatrixWorld(true);
  root.traverse((object) => {
    if (!object.isMesh) return;
    const at = positions.length / 3;
    const attribute = object.geometry.getAttribute('position');
    for (let i = 0; i < attribute.count; i++) positions.push(...p.fromBufferAttribute(attribute, i).applyMatrix4(object.matrixWorld));
    const color = object.geometry.getAttribute('color');
    for (let i = 0; i < attribute.count; i++) {
      own ||= color?.itemSize === 4 && color.getW(i) < 1;
      values.push(color ? [color.getX(i), color.itemSize === 4 ? color.getW(i) : 1] : [0, 0]);
    }
    const faces = object.geometry.index;
    const count = faces ? faces.count : attribute.count;
    for (let i = 0; i < count; i++) index.push(at + (faces ? faces.getX(i) : i));
    for (let i = 0; i < count / 3; i++) parts.push(part);
    part++;
  });
  return { positions: new Float32Array(positions), index: new Uint32Array(index), parts: new Uint32Array(parts), values: Float32Array.from(values, ([red, alpha]) => (own ? alpha : red)) };
}

/** A level small enough to be coarse: the one asked for, or the finest of at most 2000 triangles. */
async function chooseBase(id) {
  const manifest = await (await fetch(`../v1/models/${id}`)).json();
  const [family, number] = (asked.get('base') ?? '').split(':');
  const levels = Object.entries(manifest.families).flatMap(([name, f]) => f.levels.map((level) => ({ ...level, family: name })))
    .filter((level) => (!family || level.family === family) && (!number || level.level === Number(number)));
  const small = levels.filter((level) => level.triangles <= 2000).sort((a, b) => b.triangles - a.triangles);
  return small[0] ?? levels.sort((a, b) => a.triangles - b.triangles)[0];
}

function growing(material, uniforms) {
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.vertexShader = shader.vertexShader
      .replace('#include <common>', '#include <common>\nattribute vec3 from;\nattribute float born;\nuniform float now;\nuniform float grow;')
      .replace('#include <begin_vertex>', 'vec3 transformed = mix(from, position, smoothstep(0.0, 1.0, (now - born) / grow));');
  };
  return material;
}

class Page {
  constructor() {
    Object.assign(this, openStage($('canvas'), FOV, asked.get('up') === 'z'));
    this.uniforms = { now: { value: 0 }, grow: { value: GROW_SECONDS } };
    this.surface = new Mesh(new BufferGeometry(), growing(new MeshStandardMaterial({ color: 0xc9b79c, roughness: 0.55, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }), this.uniforms));
    this.wires = new Mesh(this.surface.geometry, growing(new MeshStandardMaterial({ color: 0x1b2a38, wireframe: true }), this.uniforms));
    this.surface.frustumCulled = this.wires.frustumCulled = false;
    this.scene.add(this.surface, this.wires);
    this.controls = new OrbitControls(this.camera, $('canvas'));
    this.mouse = new Vector2(0, 0);
    this.births = new Births(GROW_SECONDS);
    this.ray = new Raycaster();
    $('canvas').addEventListener('pointermove', (event) => {
      const box = $('canvas').getBoundingClientRect();
      this.mouse.set(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    });
    if (asked.get('kind') in HINTS) $('kind').value = asked.get('kind');
    if (asked.get('steps')) $('steps').value = asked.get('steps');
    $('kind').addEventListener('change', () => this.explain());
    $('canvas').addEventListener('click', () => {
      this.held = this.held === undefined && $('kind').value === 'part' ? this.part : undefined;
    });
    this.explain();
  }

  explain() {
    this.held = undefined;
    $('hint').textContent = HINTS[$('kind').value];
  }

  async load(id) {
    $('back').href = `../#${new URLSearchParams({ model: id })}`;
    const base = await chooseBase(id);
    const loader = new GLTFLoader();
    const draco = makeDraco(new URL('draco/', location.href).href);
    loader.setDRACOLoader(draco);
    const gltf = await loader.loadAsync(`../v1/models/${id}/${base.object}`);
    draco.dispose();
    const mesh = arrays(gltf.scene);
    this.refinement = await Refinement.create(fetch('refine.wasm'), mesh);
    this.refinement.values(mesh.values);
    this.baseTriangles = mesh.index.length / 3;
    this.parts = mesh.parts;
    this.base = new Mesh(new BufferGeometry(), new MeshStandardMaterial({ side: DoubleSide })); // to be pointed at, not drawn
    this.base.geometry.setAttribute('position', new BufferAttribute(mesh.positions, 3));
    this.base.geometry.setIndex(new BufferAttribute(mesh.index, 1));
    this.upload(0);
    this.surface.geometry.computeBoundingSphere();
    const { center, radius } = this.surface.geometry.boundingSphere;
    this.center = center.clone();
    this.radius = radius;
    this.camera.near = radius / 100;
    this.camera.far = radius * 20;
    this.camera.position.copy(center).add((asked.get('up') === 'z' ? new Vector3(0.6, -1, 0.4) : new Vector3(0.6, 0.4, 1)).normalize().multiplyScalar(radius * 2.9));
    this.controls.target.copy(center);
    this.controls.update();
    this.controls.saveState();
  }

  /** The drawn mesh to the GPU, with the time that each vertex was born. */
  upload(now) {
    const mesh = this.refinement.mesh();
    const geometry = this.surface.geometry;
    this.times = this.births.times(mesh.ids, now);
    const index = new BufferAttribute(mesh.index, 1);
    index.version = this.uploads = (this.uploads ?? 0) + 1; // three keeps its wires by this number
    geometry.setIndex(index);
    for (const [name, values, size] of [['position', mesh.positions, 3], ['normal', mesh.normals, 3], ['from', mesh.from, 3], ['born', this.times, 1]])
      geometry.setAttribute(name, new BufferAttribute(values, size));
    this.triangles = mesh.triangles;
    geometry.boundingSphere ??= null;
  }

  /** Where the mouse's ray meets the base, else where it passes its sphere nearest. */
  pointer() {
    this.ray.setFromCamera(this.mouse, this.camera);
    const { origin, direction } = this.ray.ray;
    const [hit] = this.ray.intersectObject(this.base);
    if (hit) return { direction, point: hit.point, part: this.parts[hit.faceIndex] };
    const towards = this.center.clone().sub(origin);
    const along = towards.dot(direction);
    const nearest = origin.clone().addScaledVector(direction, along);
    const miss = nearest.distanceTo(this.center);
    const back = miss < this.radius ? Math.sqrt(this.radius ** 2 - miss ** 2) : 0;
    return { direction, point: origin.clone().addScaledVector(direction, along - 0.7 * back) };
  }

  interest() {
    const kind = $('kind').value;
    const { direction, point, part } = this.pointer();
    this.part = part ?? this.part ?? this.parts[0];
    this.refinement.interest({
      kind: kind === 'part' ? 'focus' : kind, ...(kind === 'part' && { part: this.held ?? this.part }), eye: this.camera.position.toArray(), look: direction.toArray(), point: point.toArray(), pixels: 1, fov: FOV,
      height: this.renderer.domElement.height, falloff: this.radius * (kind === 'part' ? 0.45 : 0.8),
    });
    return kind;
  }

  frame(milliseconds) {
    const now = milliseconds / 1000;
    const { clientWidth: width, clientHeight: height } = $('canvas');
    if (this.width !== width || this.height !== height) {
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      [this.width, this.height] = [width, height];
    }
    const kind = this.interest();
    const limits = { steps: Number($('steps').value), maxTriangles: Math.max(Number($('budget').value), this.baseTriangles), maxOperations: OPERATIONS_A_FRAME };
    const start = performance.now();
    const count = this.refinement.update(limits);
    if (kind === 'contact') this.touch(limits.steps);
    if (count > 0 || kind === 'contact') this.upload(now);
    const spent = performance.now() - start;
    this.uniforms.now.value = now;
    this.wires.visible = $('wires').checked;
    this.renderer.render(this.scene, this.camera);
    $('facts').value = `${formatCount(this.triangles)} triangles from ${formatCount(this.baseTriangles)}\n${formatCount(count)} splits and merges\n${spent.toFixed(1)} ms to refine`;
    Object.assign($('facts').dataset, { triangles: this.triangles, base: this.baseTriangles, operations: count, frame: (this.frames = (this.frames ?? 0) + 1) });
  }

  /** A finger draws what it touches; what it touched before goes by the next update, for nothing asks for it any more. */
  touch(steps) {
    const contact = this.refinement.contact(steps);
    $('facts').dataset.contact = contact ? contact.point.join(' ') : '';
  }
}

const page = new Page();
await page.load(asked.get('model') ?? '');
document.body.dataset.ready = 'true';
const loop = (milliseconds) => {
  page.frame(milliseconds);
  requestAnimationFrame(loop);
};
requestAnimationFrame(loop);
