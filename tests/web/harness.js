/**
 * A page for morph.test.mjs: levels, morphs between them and a camera, drawn when told to, with a clock that the test winds. window.harness is all of
 * it.
 */

import { AmbientLight, Color, DirectionalLight, PerspectiveCamera, Scene, WebGLRenderer } from '../../clients/web/node_modules/three/build/three.module.js';
import { GLTFLoader } from '../../clients/web/node_modules/three/examples/jsm/loaders/GLTFLoader.js';
import { makeDraco } from '../../clients/web/src/three/loader.js';
import { LevelObject } from '../../clients/web/src/three/level.js';
import { Morpher } from '../../clients/web/src/three/morph.js';
import { NormalsPool } from '../../clients/web/src/three/normals-pool.js';
import { MorphDriver, screenTarget } from '../../clients/web/src/stream/morph.js';
import { CorePool } from '../../clients/web/src/wasm/pool.js';

const WIDTH = 400;
const HEIGHT = 300;
const canvas = document.createElement('canvas');
document.body.append(canvas);
const renderer = new WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
renderer.setSize(WIDTH, HEIGHT);
const scene = new Scene();
scene.background = new Color(0xffffff);
const camera = new PerspectiveCamera(45, WIDTH / HEIGHT, 0.01, 100);
const lamp = new DirectionalLight(0xffffff, 3);
lamp.position.set(1, 2, 3);
scene.add(new AmbientLight(0xffffff, 0.6), lamp);
const loader = new GLTFLoader();
loader.setDRACOLoader(makeDraco(new URL('viewer/draco/', location.href).href));
const normals = new NormalsPool(null);
const pool = new CorePool({ worker: new URL('viewer/core-worker.js', location.href), wasm: new URL('viewer/lodestream.wasm', location.href) });
const morpher = new Morpher(pool);
const levels = [];
const morphs = [];
let drawn = null;
let before = null;

function pixels() {
  const gl = renderer.getContext();
  const out = new Uint8Array(4 * WIDTH * HEIGHT);
  gl.readPixels(0, 0, WIDTH, HEIGHT, gl.RGBA, gl.UNSIGNED_BYTE, out);
  return out;
}

/** Mean absolute difference of colours, 0 to 255. */
function difference(a, b) {
  let sum = 0;
  for (let i = 0; i < a.length; i += 4) for (let c = 0; c < 3; c++) sum += Math.abs(a[i + c] - b[i + c]);
  return sum / (WIDTH * HEIGHT * 3);
}

function draw(object, distance) {
  if (drawn !== object) drawn?.root.removeFromParent();
  drawn = object;
  scene.add(object.root);
  camera.position.set(0.42 * distance, 0.3 * distance, distance);
  camera.lookAt(0, 0, 0);
  renderer.render(scene, camera);
  return pixels();
}

window.harness = {
  /** sphere: what is scaled to radius 1 at the origin, and errors with it */
  async load(urls, errors, sphere = { center: [0, 0, 0], radius: 1 }) {
    scene.scale.setScalar(1 / sphere.radius);
    scene.position.fromArray(sphere.center.map((x) => -x / sphere.radius));
    scene.updateMatrixWorld(true);
    for (let i = 0; i < urls.length; i++) {
      const gltf = await loader.loadAsync(urls[i]);
      const object = await LevelObject.create(gltf, normals);
      object.lod = { error: errors[i] / sphere.radius };
      object.reach = errors[i];
      levels.push(object);
    }
    return levels.map((l) => l.triangles);
  },

  async prepare(exact = true) {
    for (let i = 0; i + 1 < levels.length; i++) {
      const begin = performance.now();
      morphs[i] = await morpher.morph(levels[i], levels[i + 1], { reach: errors(i), exact });
      if (!morphs[i]) return null;
      morphs[i].milliseconds = performance.now() - begin;
    }
    return morphs.map((m) => ({ triangles: m.triangles, milliseconds: m.milliseconds }));
  },

  /** How far the ends of each morph are from the levels themselves. */
  ends(distance) {
    return morphs.map((morph, i) => {
      const coarse = draw(levels[i], distance);
      morph.t.value = 0;
      const start = difference(coarse, draw(morph, distance));
      morph.t.value = 1;
      const shape = draw(morph, distance);
      return { start, end: difference(draw(levels[i + 1], distance), shape) };
    });
  },

  /**
   * A dive from far to near: at each frame the level that the tolerance wants, as it is or through morphs. Returns the largest change from one frame
   * to the next that the levels alone make: both pictures from the same eye.
   */
  dive({ frames, from, to, pixels: limit, mode, seconds = 1 }) {
    const driver = new MorphDriver({ seconds });
    let at = 0; // the level that is drawn or that the morph leads to
    let running = null;
    let largest = 0;
    let steps = 0;
    const ts = [];
    before = null;
    for (let frame = 0; frame < frames; frame++) {
      const distance = from * Math.pow(to / from, frame / (frames - 1));
      const view = { distance, fov: 45, height: HEIGHT };
      const object = advance(frame / 30, view);
      const here = draw(object, distance);
      const current = now(object);
      if (before) {
        // What a person would see without any change of shape: the frame before, from this eye.
        restore(before);
        const same = draw(before.object, distance);
        restore(current);
        largest = Math.max(largest, difference(here, same));
      }
      before = current;
    }
    return { largest, steps, end: at, ts };

    function advance(clock, view) {
      if (mode === 'off') {
        while (at + 1 < levels.length && wants(at, view)) {
          at++;
          steps++;
        }
        return levels[at];
      }
      if (running === null && at + 1 < levels.length && (mode === 'screen' ? screenTarget(levels[at].lod, limit, view) > 0 : wants(at, view))) {
        running = morphs[at];
        driver.begin(0, mode === 'screen' ? 0 : 1);
        driver.update(clock);
        steps++;
      }
      if (running === null) return levels[at];
      if (mode === 'screen') driver.aim(screenTarget(levels[at].lod, limit, view));
      running.t.value = driver.update(clock);
      ts.push(driver.t);
      const shape = running;
      if (driver.t === 1) {
        running = null;
        at++;
      }
      return shape;
    }

    function wants(level, view) {
      return levels[level].lod.error / ((2 * view.distance * Math.tan((view.fov * Math.PI) / 360)) / view.height) > limit;
    }
  },

  show(which, distance) {
    const object = which.level !== undefined ? levels[which.level] : morphs[which.morph];
    if (which.t !== undefined) object.t.value = which.t;
    draw(object, distance);
  },
};

function errors(i) {
  return levels[i].reach + levels[i + 1].reach;
}

function now(object) {
  return { object, t: object.t?.value };
}

function restore({ object, t }) {
  if (t !== undefined) object.t.value = t;
}
