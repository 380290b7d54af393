/**
 * The picture: camera, light, the level that is drawn and the one that fades out. Draws only when something changes.
 */

import {
  DirectionalLight, Group, NeutralToneMapping, PerspectiveCamera, Scene, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { MorphDriver, screenTarget } from '../stream/morph.js';
import { studioEnvironment } from '../three/studio.js';

const FOV = 45;
const FADE_SECONDS = 0.28;
const FLY_SECONDS = 0.5;
const MORPH_SECONDS = 0.6;
const PIXEL_RATIO_MAX = 2;
const KEY_TURN = Math.PI / 24;
/** Eye directions, model standing upright: a little from the right and from above. */
const FIRST_LOOK = new Vector3(0.42, 0.3, 1).normalize();

export class View {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{onFrame: (facts: {view, eye: number[], target: number[], seconds: number, frameSeconds: number|null}) => boolean,
   *          onShown?: () => void, reducedMotion: () => boolean,
   *          morph?: (before, next) => Promise<{object: import('../three/morph.js').MorphObject, refines: boolean}|null>|null}} options
   *   onFrame: before each drawing; true: another frame is needed soon. onShown: a fade or a morph has ended. morph: what leads from one level to
   *   the next without a jump; null, at once or later: the levels cross-fade. drive: null: morphs take their time; {limit}: they follow the error
   *   on screen, and are at their end where the coarser level's is `limit` pixels
   */
  constructor(canvas, options) {
    this.canvas = canvas;
    this.options = options;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: 'high-performance' });
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.toneMappingExposure = 0.95;
    this.renderer.setClearColor(0x000000, 0);
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(FOV, 1, 0.01, 100);
    this.scene.add(this.camera);
    this.light();
    this.model = new Group();
    this.model.matrixAutoUpdate = false;
    this.scene.add(this.model);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = !options.reducedMotion();
    this.controls.dampingFactor = 0.09;
    this.controls.autoRotateSpeed = 1.2;
    this.controls.zoomSpeed = 1.1;
    this.controls.addEventListener('change', () => this.invalidate());
    this.controls.addEventListener('start', () => (this.flight = null));
    this.insets = { left: 0, right: 0, top: 0, bottom: 0 };
    this.sphere = { center: new Vector3(), radius: 1 };
    this.shown = null;
    this.leaving = null;
    this.waiting = null;
    this.fadeStart = null;
    this.preparing = null;
    this.morph = null;
    this.driver = new MorphDriver({ seconds: MORPH_SECONDS });
    /** The levels at the ends of the morph. */
    this.pair = null;
    this.flight = null;
    this.wireframe = false;
    this.lastFrame = null;
    this.requested = false;
    /** Told when nothing changes any more. */
    this.calm = [];
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener('webglcontextrestored', () => this.invalidate());
    this.resize();
  }

  light() {
    this.scene.environment = studioEnvironment();
    // A lamp over the viewer's left shoulder goes with the camera: shape is readable from every side.
    const key = new DirectionalLight(0xffffff, 1.5);
    key.position.set(-0.9, 1.1, 0.7);
    this.camera.add(key, key.target);
    key.target.position.set(0, 0, -1);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, PIXEL_RATIO_MAX));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.placeCentre();
    this.invalidate();
  }

  /** Pixels at the picture's borders that panels cover: the model is framed in what is left. */
  setInsets(insets) {
    this.insets = insets;
    this.placeCentre();
    this.invalidate();
  }

  /** Moves the optical axis to the middle of the free part; scale, and with it what a pixel measures, stays. */
  placeCentre() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { left, right, top, bottom } = this.insets;
    this.camera.setViewOffset(width, height, (right - left) / 2, (bottom - top) / 2, width, height);
  }

  /** Half the angle under which the free part of the picture is seen, in its narrower direction. */
  freeHalfAngle() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { left, right, top, bottom } = this.insets;
    const free = Math.max(0.3, Math.min((width - left - right) / height, (height - top - bottom) / height));
    return Math.atan(Math.tan((FOV * Math.PI) / 360) * free);
  }

  /** A new model: its bounding sphere in model space and which axis is up. The camera flies to it at once. */
  setModel(sphere, up) {
    this.modelSphere = sphere;
    this.setUp(up);
    this.frame(false);
  }

  setUp(up) {
    this.model.matrix.identity();
    if (up === 'z') this.model.matrix.makeRotationX(-Math.PI / 2);
    this.model.matrixWorldNeedsUpdate = true;
    if (!this.modelSphere) return;
    this.sphere.center.fromArray(this.modelSphere.center).applyMatrix4(this.model.matrix);
    this.sphere.radius = this.modelSphere.radius;
    this.controls.minDistance = this.sphere.radius * 0.02;
    this.controls.maxDistance = this.sphere.radius * 60;
    this.invalidate();
  }

  /** Whole model in the picture, seen from the first side; animated unless motion is unwelcome. */
  frame(animated = true) {
    const { center, radius } = this.sphere;
    const eye = center.clone().addScaledVector(FIRST_LOOK, radius / Math.sin(this.freeHalfAngle()));
    if (animated && !this.options.reducedMotion()) {
      this.flight = { from: { eye: this.camera.position.clone(), target: this.controls.target.clone() }, eye, target: center.clone(), start: null };
    } else {
      this.flight = null;
      this.camera.position.copy(eye);
      this.controls.target.copy(center);
      this.controls.update();
    }
    this.invalidate();
  }

  /**
   * The level to draw from now on (a LevelObject), null for nothing. It grows out of the one before where a morph is known, and fades in over it
   * elsewhere; a level that comes meanwhile waits for the end, and only the last of those that wait is shown.
   */
  show(object) {
    if (this.fading && object) {
      this.waiting = object;
      this.invalidate(); // a morph that rests may be at the end that leads there
      return;
    }
    this.waiting = null;
    if (object === this.shown) return;
    if (!object) this.stopChange();
    const before = this.shown;
    const preparing = before && object ? this.options.morph?.(before, object) : null;
    if (!preparing) {
      this.replace(object);
      return;
    }
    this.preparing = object;
    preparing
      .catch(() => null)
      .then((morph) => {
        if (this.preparing !== object || this.shown !== before) {
          morph?.object.dispose();
          return;
        }
        this.preparing = null;
        if (morph) this.grow(object, morph);
        else this.replace(object);
      });
  }

  /**
   * A part of a level that is on its way (three/units.js): grows out of what it follows. Resolves when it has grown; false: something else is drawn.
   */
  async showPart(part, animated) {
    await this.whenCalm();
    if (!part.follows(this.shown)) return false;
    this.grow(part, { object: part.morph, refines: true });
    if (!animated) this.driver.begin(1, 1);
    await this.whenCalm();
    return this.shown === part;
  }

  whenCalm() {
    return this.fading ? new Promise((resolve) => this.calm.push(resolve)) : Promise.resolve();
  }

  tellCalm() {
    if (this.fading) return;
    for (const resolve of this.calm.splice(0)) resolve();
  }

  /** Where one looks, in model space; halfAngle: of the circle around the picture. */
  look() {
    const inverse = this.model.matrix.clone().invert();
    const eye = this.camera.position.clone().applyMatrix4(inverse);
    const direction = this.camera.getWorldDirection(new Vector3()).transformDirection(inverse);
    const halfAngle = Math.atan(Math.tan((FOV * Math.PI) / 360) * Math.hypot(1, this.camera.aspect));
    return { eye: eye.toArray(), direction: direction.toArray(), halfAngle };
  }

  /** Cross-fades to the object. */
  replace(object) {
    const before = this.shown;
    this.shown = object;
    if (object) {
      object.setWireframe(this.wireframe);
      object.fade.value = before ? 0 : 1;
      this.model.add(object.root);
    }
    if (before && object) {
      this.leaving = before;
      this.fadeStart = null;
    } else if (before) {
      this.end(before);
    }
    if (!before) this.options.onShown?.();
    this.tellCalm();
    this.invalidate();
  }

  /** From what is drawn to `object` through a morph's shapes. refines: the object is its finer end. */
  grow(object, { object: shape, refines }) {
    const before = this.shown;
    this.end(before);
    this.pair = object.transient || before.transient ? null : { coarse: refines ? before : object, fine: refines ? object : before };
    this.shown = object;
    object.setWireframe(this.wireframe);
    shape.setWireframe(this.wireframe);
    this.morph = shape;
    this.driver.begin(refines ? 0 : 1, refines ? 1 : 0);
    shape.t.value = this.driver.t;
    this.model.add(shape.root);
    this.invalidate();
  }

  morphStep(seconds) {
    if (!this.morph) return false;
    const follows = this.follow();
    this.morph.t.value = this.driver.update(seconds);
    if (this.driver.paused) return false;
    if (!this.driver.done) return true;
    if (follows) {
      const back = this.driver.t === 0 && (this.waiting ?? this.shown) !== this.pair.fine;
      if (this.driver.t < 1 && !back) return false; // rests there until the view changes
      this.shown = this.driver.t === 1 ? this.pair.fine : this.pair.coarse;
      if (this.waiting === this.shown) this.waiting = null;
    }
    this.stopChange();
    this.options.onShown?.();
    this.showWaiting();
    this.tellCalm();
    return true;
  }

  /** Where the morph should be by the error on screen; false: it goes by time. */
  follow() {
    const drive = this.pair && this.options.drive?.();
    if (!drive) {
      if (this.pair) this.driver.aim(this.shown === this.pair.fine ? 1 : 0);
      return false;
    }
    const { view } = this.facts(0, null);
    const wanted = screenTarget(this.pair.coarse.lod, drive.limit, view);
    // Either end may be asked for meanwhile (less is, while one moves): the view alone says how far. For another level the nearer end comes first.
    const other = this.waiting !== null && this.waiting !== this.pair.coarse && this.waiting !== this.pair.fine;
    this.driver.aim(!other ? wanted : this.waiting.lod.error > this.pair.coarse.lod.error ? 0 : 1);
    return true;
  }

  /** The morph that is drawn: how far it is, and its triangles; null: a level alone is. */
  get grown() {
    return this.morph && { t: this.morph.t.value, triangles: this.morph.triangles };
  }

  /** A morph that follows the error on screen and is where it should be. */
  get resting() {
    return this.morph !== null && this.pair !== null && this.driver.done && this.leaving === null && this.preparing === null && Boolean(this.options.drive?.());
  }

  /** A level has been asked for that what is drawn does not lead to; a morph that rests serves both its ends. */
  get waits() {
    return this.waiting !== null && !(this.resting && (this.waiting === this.pair.coarse || this.waiting === this.pair.fine));
  }

  /** What changes is at its end: the level alone is drawn. */
  stopChange() {
    this.preparing = null;
    if (this.morph) {
      this.morph.dispose();
      this.morph = null;
      this.pair = null;
      if (this.shown) this.model.add(this.shown.root);
    }
    if (this.leaving) this.end(this.leaving);
    this.leaving = null;
  }

  showWaiting() {
    const waiting = this.waiting;
    this.waiting = null;
    if (waiting) this.show(waiting);
  }

  /** The object is about to be freed: it must not be drawn again. */
  forget(object) {
    if (this.waiting === object) this.waiting = null;
    if (this.pair?.coarse === object || this.pair?.fine === object) this.pair = null; // the morph goes on by time
    if (this.preparing === object) this.preparing = null;
    if (this.leaving === object) {
      this.end(object);
      this.leaving = null;
      if (this.shown) this.shown.fade.value = 1;
    }
    if (this.shown === object && this.preparing) {
      const next = this.preparing; // what it was to grow into takes its place at once
      this.preparing = null;
      this.end(object);
      this.shown = null;
      this.replace(next);
      this.showWaiting();
    }
    if (this.shown === object) this.show(null);
    this.tellCalm();
    this.invalidate();
  }

  get fading() {
    return this.leaving !== null || this.morph !== null || this.preparing !== null;
  }

  end(object) {
    object.root.removeFromParent();
    object.fade.value = 1;
    if (object.transient) object.dispose(); // nobody else keeps it
  }

  setWireframe(on) {
    this.wireframe = on;
    this.shown?.setWireframe(on);
    this.leaving?.setWireframe(on);
    this.morph?.setWireframe(on);
    this.invalidate();
  }

  setSpin(on) {
    this.controls.autoRotate = on;
    this.invalidate();
  }

  /** Keyboard: turn by angles, move by parts of the picture, zoom by a factor. */
  turn(right, up) {
    this.flight = null;
    const offset = this.camera.position.clone().sub(this.controls.target);
    const polar = Math.acos(Math.min(1, Math.max(-1, offset.y / offset.length())));
    const azimuth = Math.atan2(offset.x, offset.z) + right * KEY_TURN;
    const tilted = Math.min(Math.PI - 0.01, Math.max(0.01, polar + up * KEY_TURN));
    this.camera.position.copy(this.controls.target).add(new Vector3().setFromSphericalCoords(offset.length(), tilted, azimuth));
    this.invalidate();
  }

  move(right, up) {
    this.flight = null;
    const reach = this.camera.position.distanceTo(this.controls.target) * Math.tan((FOV * Math.PI) / 360) * 0.12;
    const x = new Vector3().setFromMatrixColumn(this.camera.matrix, 0).multiplyScalar(right * reach);
    const y = new Vector3().setFromMatrixColumn(this.camera.matrix, 1).multiplyScalar(up * reach);
    for (const v of [this.camera.position, this.controls.target]) v.add(x).add(y);
    this.invalidate();
  }

  zoom(factor) {
    this.flight = null;
    const offset = this.camera.position.clone().sub(this.controls.target);
    const length = Math.min(this.controls.maxDistance, Math.max(this.controls.minDistance, offset.length() * factor));
    this.camera.position.copy(this.controls.target).add(offset.setLength(length));
    this.invalidate();
  }

  invalidate() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame((ms) => this.draw(ms / 1000));
  }

  draw(seconds) {
    this.requested = false;
    const frameSeconds = this.lastFrame === null ? null : seconds - this.lastFrame;
    this.lastFrame = seconds;
    let more = this.fly(seconds);
    more = this.controls.update(frameSeconds ?? undefined) || more || this.controls.autoRotate;
    more = this.fadeStep(seconds) || more;
    more = this.morphStep(seconds) || more;
    this.clip();
    this.camera.updateMatrixWorld();
    more = this.options.onFrame(this.facts(seconds, frameSeconds)) || more || this.leaving !== null || (this.morph !== null && !this.resting && !this.driver.paused);
    const height = this.renderer.domElement.height;
    for (const object of [this.shown, this.leaving]) if (object) object.viewportHeight.value = height;
    this.renderer.render(this.scene, this.camera);
    if (more) this.invalidate();
    else this.lastFrame = null;
  }

  facts(seconds, frameSeconds) {
    const eye = this.camera.position.toArray();
    const distance = Math.max(this.camera.position.distanceTo(this.sphere.center) - this.sphere.radius, this.camera.near);
    const view = { distance, fov: this.camera.fov, height: this.renderer.domElement.height };
    return { view, eye, target: this.controls.target.toArray(), seconds, frameSeconds };
  }

  /** Near and far around the sphere, so that depth is as fine as it can be. */
  clip() {
    const { center, radius } = this.sphere;
    const d = this.camera.position.distanceTo(center);
    this.camera.near = Math.max(d - radius * 1.1, radius * 1e-3);
    this.camera.far = Math.max(d + radius * 1.1, this.camera.near * 2);
    this.camera.updateProjectionMatrix();
  }

  fly(seconds) {
    const flight = this.flight;
    if (!flight) return false;
    flight.start ??= seconds;
    const t = Math.min(1, (seconds - flight.start) / FLY_SECONDS);
    const s = t * t * (3 - 2 * t);
    this.camera.position.lerpVectors(flight.from.eye, flight.eye, s);
    this.controls.target.lerpVectors(flight.from.target, flight.target, s);
    if (t === 1) this.flight = null;
    return t < 1;
  }

  fadeStep(seconds) {
    if (!this.leaving) return false;
    this.fadeStart ??= seconds;
    const t = Math.min(1, (seconds - this.fadeStart) / FADE_SECONDS);
    this.shown.fade.value = t;
    this.leaving.fade.value = t > 0 ? -t : 1;
    if (t < 1) return true;
    this.end(this.leaving);
    this.leaving = null;
    this.options.onShown?.();
    this.showWaiting();
    this.tellCalm();
    return true;
  }
}
