/** A reader of 3D Tiles that is not ours, on a model of ours. The test moves the camera and asks what is drawn. */

import { Group, PerspectiveCamera, Scene, WebGLRenderer } from 'three';
import { DRACOLoader } from 'three/examples/jsm/loaders/DRACOLoader.js';
import { TilesRenderer } from '3d-tiles-renderer';
import { GLTFExtensionsPlugin } from '3d-tiles-renderer/plugins';

window.show = (url, [x, y, z], radius) => {
  const renderer = new WebGLRenderer({ antialias: false });
  renderer.setSize(400, 400);
  document.body.append(renderer.domElement);
  const scene = new Scene();
  const camera = new PerspectiveCamera(60, 1, radius / 100, radius * 1000);
  const tiles = new TilesRenderer(url);
  tiles.registerPlugin(new GLTFExtensionsPlugin({ dracoLoader: new DRACOLoader().setDecoderPath('/draco/') }));
  tiles.errorTarget = 1;
  tiles.setCamera(camera);
  tiles.setResolutionFromRenderer(camera, renderer);
  // The sphere of a tileset is z up; tiles.group keeps that, so the camera does too.
  scene.add(new Group().add(tiles.group));
  window.failures = [];
  tiles.addEventListener('load-error', ({ error }) => window.failures.push(String(error)));
  let distance = 3 * radius;
  window.setDistance = (radii) => (distance = radii * radius);
  window.drawn = () => {
    let triangles = 0;
    for (const tile of tiles.visibleTiles) tile.engineData.scene.traverse((o) => (triangles += o.isMesh ? (o.geometry.index?.count ?? o.geometry.attributes.position.count) / 3 : 0));
    return { triangles, error: Math.max(0, ...[...tiles.visibleTiles].map((tile) => tile.geometricError)), busy: tiles.stats.downloading + tiles.stats.parsing };
  };
  renderer.setAnimationLoop(() => {
    camera.position.set(x, y - distance, z);
    camera.up.set(0, 0, 1);
    camera.lookAt(x, y, z);
    camera.updateMatrixWorld();
    tiles.update();
    renderer.render(scene, camera);
  });
};
