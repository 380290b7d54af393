/** Every level that the daemon serves, as other programs see it: valid for Khronos' validator, decodable by draco3d, as many triangles as it says. */

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { createHash } from 'node:crypto';
import draco3d from 'draco3d';
import validator from 'gltf-validator';
import { Daemon } from './daemon.mjs';
import { burr, bumpySphere, checkerGlb, writePly } from './models.mjs';

const TEST = { timeout: 90000 };
let daemon;
let decoder;
const manifests = {};
before(async () => {
  daemon = await Daemon.start();
  decoder = await draco3d.createDecoderModule({});
  manifests.bumpy = await daemon.bake('bumpy', writePly(bumpySphere(32)));
  manifests.checker = await daemon.bake('checker', checkerGlb(24), 'checker.glb');
  manifests.bars = await daemon.bake('bars', writePly(burr(40)));
}, TEST);
after(() => daemon?.stop());

const levelsOf = (id) => Object.entries(manifests[id].families).flatMap(([family, { levels }]) => levels.map((level) => ({ family, ...level })));
const bytesOf = async (level) => new Uint8Array(await (await fetch(`${daemon.url}v1/objects/${level.object}`)).arrayBuffer());

for (const id of ['bumpy', 'checker', 'bars']) {
  test(`${id}: every level is what its name says and valid glTF`, TEST, async () => {
    for (const level of levelsOf(id)) {
      const bytes = await bytesOf(level);
      assert.equal(bytes.length, level.bytes);
      assert.equal(createHash('sha256').update(bytes).digest('hex'), level.object);
      const report = await validator.validateBytes(bytes, {
        uri: `${level.object}.glb`,
        externalResourceFunction: async (uri) => new Uint8Array(await (await fetch(`${daemon.url}v1/objects/${uri}`)).arrayBuffer()),
      });
      const serious = report.issues.messages.filter((m) => m.severity <= 1);
      assert.deepEqual(serious, [], `${level.family} ${level.level}`);
    }
  });

  test(`${id}: every level decodes to the triangles, edges and points that the manifest counts`, TEST, async () => {
    for (const level of levelsOf(id)) {
      const counts = countPrimitives(await bytesOf(level));
      assert.deepEqual(counts, { triangles: level.triangles, edges: level.edges, points: level.points }, `${level.family} ${level.level}`);
    }
  });
}

test('bars left over from the burr carry their thickness', TEST, async () => {
  const withEdges = levelsOf('bars').filter((l) => l.edges > 0);
  assert.ok(withEdges.length > 0, 'a burr leaves edges at some level');
  for (const level of withEdges) {
    const { json, view } = parseGlb(await bytesOf(level));
    for (const primitive of primitives(json).filter((p) => p.mode === 1)) {
      const accessor = json.accessors[primitive.attributes._THICKNESS];
      const values = floatsOf(json, view, accessor);
      assert.ok(values.some((x) => x > 0) && values.every((x) => x >= 0 && Number.isFinite(x)));
    }
  }
});

test('pictures resolve beside the level wherever it is served', TEST, async () => {
  const [level] = levelsOf('checker');
  const { json } = parseGlb(await bytesOf(level));
  const { uri } = json.images[0];
  assert.match(uri, /^[0-9a-f]{64}$/);
  for (const place of [`v1/objects/${level.object}`, `v1/models/checker/level?error=${level.error}`]) {
    const response = await fetch(new URL(uri, `${daemon.url}${place}`));
    assert.equal(response.status, 200);
    assert.equal(createHash('sha256').update(new Uint8Array(await response.arrayBuffer())).digest('hex'), uri);
  }
});

function parseGlb(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  assert.equal(view.getUint32(0, true), 0x46546c67);
  const length = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
  const start = 20 + length + 8;
  return { json, view: bytes.subarray(start, start + view.getUint32(20 + length, true)) };
}

const primitives = (json) => json.meshes.flatMap((mesh) => mesh.primitives);

function floatsOf(json, binary, accessor) {
  const view = json.bufferViews[accessor.bufferView];
  const offset = (view.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
  assert.equal(accessor.componentType, 5126);
  return [...new Float32Array(binary.slice(offset, offset + accessor.count * 4).buffer)];
}

function countPrimitives(bytes) {
  const { json, view } = parseGlb(bytes);
  const counts = { triangles: 0, edges: 0, points: 0 };
  for (const primitive of primitives(json)) {
    const indices = primitive.indices === undefined ? json.accessors[primitive.attributes.POSITION].count : json.accessors[primitive.indices].count;
    if (primitive.mode === 1) counts.edges += indices / 2;
    else if (primitive.mode === 0) counts.points += indices;
    else {
      const draco = primitive.extensions?.KHR_draco_mesh_compression;
      counts.triangles += draco ? decodeDraco(json.bufferViews[draco.bufferView], view, json.accessors, primitive, draco) : indices / 3;
    }
  }
  return counts;
}

/** Triangles of one Draco primitive; its accessors must count what is really in it. */
function decodeDraco(bufferView, binary, accessors, primitive, draco) {
  const from = bufferView.byteOffset ?? 0;
  const data = binary.slice(from, from + bufferView.byteLength);
  const mesh = new decoder.Mesh();
  const own = new decoder.Decoder();
  try {
    const status = own.DecodeArrayToMesh(data, data.length, mesh);
    assert.ok(status.ok(), status.error_msg());
    assert.equal(mesh.num_faces() * 3, accessors[primitive.indices].count);
    assert.equal(mesh.num_points(), accessors[primitive.attributes.POSITION].count);
    for (const id of Object.values(draco.attributes)) assert.ok(own.GetAttributeByUniqueId(mesh, id).ptr);
    return mesh.num_faces();
  } finally {
    decoder.destroy(mesh);
    decoder.destroy(own);
  }
}
