/** What the pages of one view draw on: a clear canvas over the page's ground, light from the sky and a lamp that the camera carries. */

import { DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, WebGLRenderer } from 'three';

/** @param {HTMLCanvasElement} canvas @param {number} fov degrees, vertical @param {boolean} upIsZ */
export function openStage(canvas, fov, upIsZ) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
  const scene = new Scene();
  const camera = new PerspectiveCamera(fov, 1, 0.01, 100);
  const lamp = new DirectionalLight(0xffffff, 2);
  lamp.position.set(-1, 2, 3);
  camera.add(lamp);
  if (upIsZ) camera.up.set(0, 0, 1);
  scene.add(new HemisphereLight(0xffffff, 0x8899aa, 1.6), camera);
  return { renderer, scene, camera };
}
