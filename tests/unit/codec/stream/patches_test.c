/* A C-LOD to bytes and back. */
#include "codec/stream/patches.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "codec/stream/bytes.h"
#include "core/clod/clod.h"
#include "core/clod/tessellate.h"
#include "core/mesh/topology.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_patches clod_of(const struct lod_mesh *mesh, uint32_t wanted) {
  struct lod_clod *clod;
  struct lod_clod_facts facts;
  struct lod_patches patches;
  assert_int_equal(lod_clod_create(mesh, NULL, arena, &clod, NULL), LOD_OK);
  assert_int_equal(lod_clod_simplify(clod, wanted, INFINITY, NULL), LOD_OK);
  lod_clod_facts(clod, &facts);
  assert_int_equal(lod_clod_extract(clod, facts.clod, arena, &patches, NULL), LOD_OK);
  return patches;
}

static void encode(const struct lod_patches *patches, double step, uint8_t **bytes, size_t *size) {
  struct lod_patches_encode_request request = {.patches = patches, .unit = 1, .unit_count = 3, .step = step, .error = 0.5};
  assert_int_equal(lod_patches_encode(&request, arena, bytes, size, NULL), LOD_OK);
}

static struct lod_patches decode(const uint8_t *bytes, size_t size) {
  struct lod_patches_header header;
  struct lod_patches patches;
  struct lod_problem problem = {0};
  if (lod_patches_decode(bytes, size, 0, arena, &header, &patches, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  assert_int_equal(header.unit, 1);
  assert_int_equal(header.unit_count, 3);
  assert_true(header.size == size && header.error == 0.5f);
  assert_true(lod_patches_check(&patches, NULL));
  return patches;
}

/* Each patch of `a` has one of `b` whose control points, turned as it must be, are within `most`. */
static void assert_same_patches(const struct lod_patches *a, const struct lod_patches *b, double most) {
  assert_int_equal(a->patch_count, b->patch_count);
  for (uint32_t p = 0; p < a->patch_count; p++) {
    struct lod_bezier x = lod_patches_net(a, p);
    double best = INFINITY;
    for (uint32_t q = 0; q < b->patch_count && best > most; q++)
      for (int turn = 0; turn < 3; turn++) {
        struct lod_bezier y = lod_patches_net(b, q);
        double worst = lod_vec3_distance(x.p[9], y.p[9]);
        for (int k = 0; k < 3; k++) {
          worst = fmax(worst, lod_vec3_distance(x.p[k], y.p[(k + turn) % 3]));
          worst = fmax(worst, lod_vec3_distance(x.p[3 + 2 * k], y.p[3 + 2 * ((k + turn) % 3)]));
          worst = fmax(worst, lod_vec3_distance(x.p[4 + 2 * k], y.p[4 + 2 * ((k + turn) % 3)]));
        }
        best = fmin(best, worst);
      }
    assert_true(best <= most);
  }
}

static void control_points_come_back_within_the_step(void **state) {
  (void)state;
  struct lod_mesh shapes[4] = {lod_shape_torus(arena, 1, 0.4, 40, 20), lod_shape_grid(arena, 2, 16, 0.3), lod_shape_cube(arena, 1),
                               lod_shape_tube(arena, 0.5, 3, 24, 12)};
  for (int i = 0; i < 4; i++)
    for (double step = 0.1; step > 1e-4; step /= 10) {
      struct lod_patches patches = clod_of(&shapes[i], 120);
      uint8_t *bytes;
      size_t size;
      encode(&patches, step, &bytes, &size);
      struct lod_patches back = decode(bytes, size);
      /* Half a step an axis, and the float step's own rounding. */
      assert_same_patches(&patches, &back, 0.8661 * step);
      uint32_t sharp = 0, sharp_back = 0;
      for (uint32_t e = 0; e < patches.edge_count; e++)
        sharp += patches.sharp[e];
      for (uint32_t e = 0; e < back.edge_count; e++)
        sharp_back += back.sharp[e];
      assert_int_equal(back.edge_count, patches.edge_count);
      assert_int_equal(sharp, sharp_back);
      assert_int_equal(back.normal_count, patches.normal_count);
    }
}

static void what_is_decoded_has_no_cracks(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20);
  struct lod_patches patches = clod_of(&torus, 60);
  uint8_t *bytes;
  size_t size;
  encode(&patches, 0.02, &bytes, &size);
  struct lod_patches back = decode(bytes, size);
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  struct lod_tessellation flat;
  struct lod_topology topology;
  settings.tolerance = 0.01;
  assert_int_equal(lod_tessellate(&back, &settings, arena, &flat, NULL), LOD_OK);
  assert_int_equal(lod_topology_measure(&flat.mesh, NULL, arena, &topology), LOD_OK);
  assert_true(topology.closed && topology.manifold && topology.genus == 1);
}

static void materials_and_parts_come_back(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  uint32_t materials[12], parts[12], counts[2][4] = {{0}};
  for (uint32_t t = 0; t < 12; t++) {
    materials[t] = t % 4 == 3 ? LOD_NONE : t % 4;
    parts[t] = t / 6;
  }
  cube.materials = materials;
  cube.parts = parts;
  struct lod_patches patches = clod_of(&cube, 12);
  uint8_t *bytes;
  size_t size;
  encode(&patches, 0.01, &bytes, &size);
  struct lod_patches back = decode(bytes, size);
  for (uint32_t p = 0; p < 12; p++) {
    counts[0][patches.materials[p] == LOD_NONE ? 3 : patches.materials[p]] += 1 + 100 * patches.parts[p];
    counts[1][back.materials[p] == LOD_NONE ? 3 : back.materials[p]] += 1 + 100 * back.parts[p];
  }
  assert_memory_equal(counts[0], counts[1], sizeof counts[0]);
}

static void the_same_patches_give_the_same_bytes(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 30, 15);
  struct lod_patches patches = clod_of(&torus, 60);
  uint8_t *a, *b;
  size_t a_size, b_size;
  encode(&patches, 0.01, &a, &a_size);
  encode(&patches, 0.01, &b, &b_size);
  assert_int_equal(a_size, b_size);
  assert_memory_equal(a, b, a_size);
}

static void what_is_cut_or_damaged_is_refused(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 20, 10);
  struct lod_patches patches = clod_of(&torus, 30), out;
  struct lod_patches_header header;
  uint8_t *bytes;
  size_t size;
  encode(&patches, 0.01, &bytes, &size);
  for (size_t n = 0; n < size; n++) { /* exact-size buffers: reading past the end is seen */
    uint8_t *part = malloc(n > 0 ? n : 1);
    memcpy(part, bytes, n);
    struct lod_problem problem = {0};
    assert_int_equal(lod_patches_decode(part, n, 0, arena, &header, &out, &problem), LOD_BAD_INPUT);
    assert_true(problem.detail[0] != 0);
    free(part);
  }
  for (size_t n = 0; n < size; n++)
    for (int bit = 0; bit < 8; bit += 3) {
      bytes[n] ^= (uint8_t)(1 << bit);
      struct lod_arena *child = lod_arena_create(256 << 20);
      struct lod_problem problem = {0};
      if (lod_patches_decode(bytes, size, 0, child, &header, &out, &problem) == LOD_OK)
        assert_true(lod_patches_check(&out, NULL)); /* only where the header alone changed */
      lod_arena_destroy(child);
      bytes[n] ^= (uint8_t)(1 << bit);
    }
  bytes[4] = 9;
  assert_int_equal(lod_patches_decode(bytes, size, 0, arena, &header, &out, NULL), LOD_UNSUPPORTED);
  bytes[4] = 1;
  assert_int_equal(lod_patches_decode(bytes, size, 5, arena, &header, &out, NULL), LOD_LIMIT);
}

static uint32_t count_jumps(const struct lod_patches *patches) {
  uint32_t jumps = 0;
  for (uint32_t h = 0; h < 3 * patches->patch_count; h++)
    jumps += lod_patch_attributes_jump(&patches->attributes, h / 3, h % 3, patches->partners[h / 3][h % 3]);
  return jumps;
}

/* UVs with a seam across the middle and colours: at every corner of every patch as they were, within half a step. */
static void uvs_and_colours_come_back_within_their_steps(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 16, 0.3);
  struct lod_mesh mesh = grid;
  mesh.wedge_count = 3 * grid.triangle_count;
  mesh.corners = lod_arena_alloc(arena, grid.triangle_count, sizeof *mesh.corners);
  mesh.wedge_vertex = LOD_NEW(arena, mesh.wedge_count, uint32_t);
  mesh.uvs[0] = lod_arena_alloc(arena, mesh.wedge_count, sizeof *mesh.uvs[0]);
  mesh.colors = lod_arena_alloc(arena, mesh.wedge_count, sizeof *mesh.colors);
  assert_true(mesh.corners != NULL && mesh.wedge_vertex != NULL && mesh.uvs[0] != NULL && mesh.colors != NULL);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    float middle = 0;
    for (int k = 0; k < 3; k++)
      middle += mesh.positions[mesh.triangles[t][k]][0];
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t w = mesh.corners[t][k] = 3 * t + k, v = mesh.wedge_vertex[w] = mesh.triangles[t][k];
      mesh.uvs[0][w][0] = mesh.positions[v][0] + (middle > 0 ? 5.0f : 0.0f);
      mesh.uvs[0][w][1] = mesh.positions[v][1] * 0.25f;
      for (int i = 0; i < 4; i++)
        mesh.colors[w][i] = i == 3 ? 1 : 0.5f + 0.25f * mesh.positions[v][i % 2];
    }
  }
  mesh.normals = NULL;
  struct lod_patches patches = clod_of(&mesh, 60);
  assert_true(patches.attributes.has_uv[0] && !patches.attributes.has_uv[1] && patches.attributes.has_colors);
  assert_true(count_jumps(&patches) > 0 && patches.attributes.uv_off < 0.5);
  uint8_t *bytes;
  size_t size;
  encode(&patches, 0.001, &bytes, &size);
  struct lod_patches back = decode(bytes, size);
  assert_int_equal(bytes[4], 2);
  assert_int_equal(count_jumps(&back), count_jumps(&patches));
  for (uint32_t p = 0; p < back.patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) { /* the same patch: its middle is where no other's is */
      double best = INFINITY;
      struct lod_bezier net = lod_patches_net(&back, p);
      const float *found = NULL, *mine = lod_patch_attributes_at(&back.attributes, p, k);
      for (uint32_t q = 0; q < patches.patch_count; q++)
        for (uint32_t l = 0; l < 3; l++) {
          struct lod_bezier other = lod_patches_net(&patches, q);
          double off = lod_vec3_distance(net.p[LOD_BEZIER_CENTRE], other.p[LOD_BEZIER_CENTRE]) + lod_vec3_distance(net.p[k], other.p[l]);
          if (off < best) {
            best = off;
            found = lod_patch_attributes_at(&patches.attributes, q, l);
          }
        }
      for (int i = 0; i < 6; i++)
        assert_true(fabs((double)mine[i] - (double)found[i]) <= (i < 2 ? 0.501 * 0x1p-12 : 0.501 / 255));
    }
  /* Damage is refused or harmless, as without attributes. */
  for (size_t n = 40; n < size; n++) {
    struct lod_arena *child = lod_arena_create(256 << 20);
    struct lod_patches_header header;
    struct lod_patches out;
    struct lod_problem problem = {0};
    assert_int_equal(lod_patches_decode(bytes, n, 0, child, &header, &out, &problem), LOD_BAD_INPUT);
    lod_arena_destroy(child);
  }
}

static void assert_bytes(const uint8_t *bytes, size_t size, size_t expected_size, uint32_t crc) {
  if (size != expected_size || lod_crc32(bytes, size) != crc)
    fail_msg("%zu bytes with CRC-32 0x%08x, expected %zu with 0x%08x", size, lod_crc32(bytes, size), expected_size, crc);
}

/* What version 1 is, to the byte: a change here needs a new version. And to the bit what decoding makes of it. */
static void the_bytes_of_version_1_are_these(void **state) {
  (void)state;
  struct lod_mesh shapes[3] = {lod_shape_torus(arena, 1, 0.4, 20, 10), lod_shape_grid(arena, 2, 8, 0.3), lod_shape_cube(arena, 1)};
  static const struct {
    uint32_t size, crc, decoded;
  } kExpected[3] = {{778, 0x2aea1f7a, 0xd11b246f}, {299, 0x784bf8ef, 0xc30c90e7}, {62, 0xec627063, 0x78b68809}};
  for (int i = 0; i < 3; i++) {
    struct lod_patches patches = clod_of(&shapes[i], UINT32_MAX);
    patches.attributes = (struct lod_patch_attributes){0};
    uint8_t *bytes;
    size_t size;
    encode(&patches, 0.01, &bytes, &size);
    assert_bytes(bytes, size, kExpected[i].size, kExpected[i].crc);
    struct lod_patches back = decode(bytes, size);
    uint32_t crc = lod_crc32((const uint8_t *)back.positions, back.vertex_count * sizeof *back.positions);
    crc ^= 3 * lod_crc32((const uint8_t *)back.inner, back.edge_count * sizeof *back.inner);
    crc ^= 5 * lod_crc32((const uint8_t *)back.centres, back.patch_count * sizeof *back.centres);
    crc ^= 7 * lod_crc32((const uint8_t *)back.normals, back.normal_count * sizeof *back.normals);
    assert_int_equal(crc, kExpected[i].decoded);
  }
}

/* The example of codec/FORMAT.md, 7.3: one patch with the corners 0 0 0, 1 0 0, 0 1 0 and a raised centre. */
static void the_example_of_the_format_is_what_it_says(void **state) {
  (void)state;
  struct lod_vec3 positions[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, centre = {1.0 / 3, 1.0 / 3, 0.25}, inner[3][2];
  uint32_t corners[1][3] = {{0, 1, 2}}, edges[1][3] = {{0, 2, 4}}, sectors[1][3] = {{LOD_NONE, LOD_NONE, LOD_NONE}},
           ends[3][2] = {{0, 1}, {1, 2}, {2, 0}}, partners[1][3] = {{LOD_NONE, LOD_NONE, LOD_NONE}};
  bool sharp[3] = {true, true, true};
  for (int e = 0; e < 3; e++)
    for (int k = 0; k < 2; k++) {
      struct lod_vec3 near = positions[ends[e][k]], far = positions[ends[e][1 - k]];
      inner[e][k] = lod_vec3_add_scaled(near, lod_vec3_subtract(far, near), 1.0 / 3);
    }
  struct lod_patches one = {.vertex_count = 3,
                            .edge_count = 3,
                            .patch_count = 1,
                            .positions = positions,
                            .corners = corners,
                            .edges = edges,
                            .sectors = sectors,
                            .ends = ends,
                            .inner = inner,
                            .sharp = sharp,
                            .centres = &centre,
                            .partners = partners};
  struct lod_patches_encode_request request = {.patches = &one, .unit = 0, .unit_count = 1, .step = 0.0625, .error = 0.5};
  static const uint8_t kBytes[] = {0x4c, 0x4f, 0x44, 0x50, 0x01, 0x00, 0x01, 0x03, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00,
                                   0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80, 0x3d, 0x00, 0x00,
                                   0x00, 0x3f, 0x06, 0x89, 0x7c, 0xc9, 0xf0, 0xf8, 0x15, 0x3d, 0x89, 0xa0, 0xb3};
  uint8_t *bytes;
  size_t size;
  assert_int_equal(lod_patches_encode(&request, arena, &bytes, &size, NULL), LOD_OK);
  assert_int_equal(size, sizeof kBytes);
  assert_memory_equal(bytes, kBytes, sizeof kBytes);
}

static void nothing_is_coded_too(void **state) {
  (void)state;
  struct lod_patches nothing = {0};
  uint8_t *bytes;
  size_t size;
  encode(&nothing, 0.01, &bytes, &size);
  assert_int_equal(decode(bytes, size).patch_count, 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(control_points_come_back_within_the_step),
      cmocka_unit_test(what_is_decoded_has_no_cracks),
      cmocka_unit_test(materials_and_parts_come_back),
      cmocka_unit_test(the_same_patches_give_the_same_bytes),
      cmocka_unit_test(what_is_cut_or_damaged_is_refused),
      cmocka_unit_test(uvs_and_colours_come_back_within_their_steps),
      cmocka_unit_test(the_bytes_of_version_1_are_these),
      cmocka_unit_test(the_example_of_the_format_is_what_it_says),
      cmocka_unit_test(nothing_is_coded_too),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
