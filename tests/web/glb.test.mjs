// Levels as browsers see them: gltf-validator finds no error, and draco3d (the decoder that three.js carries) unpacks the same triangles,
// to the bit, that the C reader certified.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, readdirSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, test } from 'node:test';
import { fileURLToPath } from 'node:url';
import draco3d from 'draco3d';
import validator from 'gltf-validator';

const root = fileURLToPath(new URL('../..', import.meta.url));
const folder = mkdtempSync(join(tmpdir(), 'lodestream-glb-'));
after(() => rmSync(folder, { recursive: true }));
execFileSync(join(root, 'build/release/tests/golden/glb_test'), ['--write', folder]);
const names = readdirSync(folder).filter((name) => name.endsWith('.glb')).sort();
const decoder = await draco3d.createDecoderModule({});

function open(bytes) {
  const jsonSize = bytes.readUInt32LE(12);
  return { json: JSON.parse(bytes.subarray(20, 20 + jsonSize)), bin: bytes.subarray(28 + jsonSize) };
}

// Corner positions of a triangle primitive, 9 floats a triangle.
function triangles({ json, bin }, primitive) {
  const view = (index) => bin.subarray(json.bufferViews[index].byteOffset ?? 0).subarray(0, json.bufferViews[index].byteLength);
  const position = json.accessors[primitive.attributes.POSITION], index = json.accessors[primitive.indices];
  const draco = primitive.extensions?.KHR_draco_mesh_compression;
  const out = new Float32Array(index.count * 3);
  if (!draco) {
    const data = view(position.bufferView), list = view(index.bufferView);
    for (let i = 0; i < index.count; i++) {
      const v = index.componentType === 5121 ? list[i] : index.componentType === 5123 ? list.readUInt16LE(2 * i) : list.readUInt32LE(4 * i);
      for (let k = 0; k < 3; k++) out[3 * i + k] = data.readFloatLE(12 * v + 4 * k);
    }
    return out;
  }
  const bytes = view(draco.bufferView), reader = new decoder.Decoder(), buffer = new decoder.DecoderBuffer(), mesh = new decoder.Mesh();
  buffer.Init(new Int8Array(bytes), bytes.length);
  assert.ok(reader.DecodeBufferToMesh(buffer, mesh).ok());
  assert.equal(mesh.num_faces() * 3, index.count);
  assert.equal(mesh.num_points(), position.count);
  for (const [name, id] of Object.entries(draco.attributes)) {
    const accessor = json.accessors[primitive.attributes[name]], attribute = reader.GetAttributeByUniqueId(mesh, id);
    assert.equal(accessor.count, mesh.num_points(), name);
    assert.equal(attribute.num_components(), { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 }[accessor.type], name);
    assert.equal(attribute.normalized(), accessor.normalized ?? false, name);
  }
  const values = new decoder.DracoFloat32Array(), face = new decoder.DracoInt32Array();
  reader.GetAttributeFloatForAllPoints(mesh, reader.GetAttributeByUniqueId(mesh, draco.attributes.POSITION), values);
  for (let f = 0; f < mesh.num_faces(); f++) {
    reader.GetFaceFromMesh(mesh, f, face);
    for (let c = 0; c < 3; c++) for (let k = 0; k < 3; k++) out[9 * f + 3 * c + k] = values.GetValue(3 * face.GetValue(c) + k);
  }
  for (const thing of [values, face, mesh, buffer, reader]) decoder.destroy(thing);
  return out;
}

test('there are samples', () => assert.equal(names.length, 16));

for (const name of names) {
  const bytes = readFileSync(join(folder, name)), expected = JSON.parse(readFileSync(join(folder, name.replace('.glb', '.json'))));

  test(`${name} (${expected.name}) has no error for gltf-validator`, async () => {
    const report = await validator.validateBytes(new Uint8Array(bytes), {
      externalResourceFunction: async () => { throw new Error('textures are elsewhere'); },
    });
    const messages = report.issues.messages.filter((m) => m.severity < 2 && m.code !== 'IO_ERROR');
    assert.deepEqual(messages, []);
  });

  test(`${name} (${expected.name}) decodes with draco3d to what the C reader saw`, () => {
    const glb = open(bytes);
    let count = 0, edges = 0, points = 0, sum = 0;
    const min = [Infinity, Infinity, Infinity], max = [-Infinity, -Infinity, -Infinity];
    for (const mesh of glb.json.meshes) for (const primitive of mesh.primitives) {
      const accessor = glb.json.accessors[primitive.attributes.POSITION];
      if (primitive.mode === 1) edges += glb.json.accessors[primitive.indices].count / 2;
      if (primitive.mode === 0) points += accessor.count;
      if ((primitive.mode ?? 4) !== 4) continue;
      const corners = triangles(glb, primitive);
      count += corners.length / 9;
      for (let i = 0; i < corners.length; i++) {
        sum += (i % 3 + 1) * corners[i];
        min[i % 3] = Math.min(min[i % 3], corners[i]);
        max[i % 3] = Math.max(max[i % 3], corners[i]);
        assert.ok(corners[i] >= Math.fround(accessor.min[i % 3]) && corners[i] <= Math.fround(accessor.max[i % 3]));
      }
    }
    assert.deepEqual([count, edges, points], [expected.triangles, expected.edges, expected.points]);
    assert.ok(Math.abs(sum - expected.sum) <= 1e-9 * (1 + Math.abs(sum)), `${sum} and ${expected.sum}`);
  });
}
