/* At what precision levels are coded. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "server/worker/levels.h"
#include "tests/data/arena.h"
#include "tests/data/models.h"
#include "tests/data/shapes.h"

/* A coarse sphere that is far from its source, and beside it a tetrahedron smaller than what such an error leaves to quantisation. */
static struct lod_mesh sphere_and_speck(double size) {
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 1), mesh = {0};
  static const float kCorners[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  static const uint32_t kFaces[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
  mesh.positions = lod_arena_alloc(arena, sphere.vertex_count + 4, sizeof *mesh.positions);
  mesh.triangles = lod_arena_alloc(arena, sphere.triangle_count + 4, sizeof *mesh.triangles);
  memcpy(mesh.positions, sphere.positions, sphere.vertex_count * sizeof *mesh.positions);
  memcpy(mesh.triangles, sphere.triangles, sphere.triangle_count * sizeof *mesh.triangles);
  for (int i = 0; i < 4; i++)
    for (int k = 0; k < 3; k++) {
      mesh.positions[sphere.vertex_count + (uint32_t)i][k] = (float)((k == 0 ? 1.1 : 0) + size * kCorners[i][k]);
      mesh.triangles[sphere.triangle_count + (uint32_t)i][k] = sphere.vertex_count + kFaces[i][k];
    }
  mesh.vertex_count = sphere.vertex_count + 4;
  mesh.triangle_count = sphere.triangle_count + 4;
  return mesh;
}

static struct lod_baked_level bake(const struct lod_mesh *mesh, bool apart) {
  struct lod_model model = lod_sample_plain(arena, "sphere", lod_shape_sphere(arena, 1, 4));
  struct lod_bvh *bvh;
  struct lod_mesh copy = *mesh;
  struct lod_problem problem = {0};
  struct lod_baked_level baked;
  assert_int_equal(lod_bvh_create(&model.units[0].mesh, 1, arena, &bvh), LOD_OK);
  struct lod_level_baker baker = {.model = &model, .source_bvhs = &bvh, .diagonal = 2 * sqrt(3), .threads = 1};
  struct lod_level level = {.meshes = &copy, .bound = INFINITY, .apart = apart};
  if (lod_level_bake(&baker, &level, 0, arena, &baked, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return baked;
}

static void vertices_that_must_stay_apart_do(void **state) {
  (void)state;
  const struct lod_mesh mesh = sphere_and_speck(0.004);
  const struct lod_baked_level merged = bake(&mesh, false), apart = bake(&mesh, true);
  assert_true(merged.vertices < mesh.vertex_count && merged.triangles < mesh.triangle_count); /* else this tests nothing */
  assert_int_equal(apart.vertices, mesh.vertex_count);
  assert_int_equal(apart.triangles, mesh.triangle_count);
  assert_true(apart.position_error < merged.position_error && apart.position_error > 1e-4); /* no finer than needed */
}

/* Triangles' bytes and error; patches' bytes and error. */
static struct lod_baked_level curved(size_t size, double error, size_t patches, double curved_error) {
  struct lod_baked_level level = {.size = size, .error = {error, error}};
  level.patches.size = patches;
  level.patches.error = curved_error;
  return level;
}

static void curved_levels_that_another_betters_are_dropped(void **state) {
  (void)state;
  struct lod_baked_level levels[5] = {
      curved(100, 1, 0, 0),    /* the source's own */
      curved(900, 2, 80, 2.2), /* stays: nothing is finer in fewer bytes of patches */
      curved(950, 4, 90, 4.2), /* more bytes and more error: goes, and its triangles with it */
      curved(800, 6, 40, 6.2), /* stays for its patches, though its triangles are many */
      curved(50, 5, 95, 5.2),  /* patches go; triangles are the fewest of all, and stay */
  };
  assert_int_equal(lod_levels_order(levels, 5), 4);
  assert_true(levels[0].patches.size == 40 && levels[1].size == 50 && levels[1].patches.size == 0);
  assert_true(levels[2].patches.size == 80 && levels[3].size == 100);
}

static void of_equal_curved_levels_one_stays(void **state) {
  (void)state;
  struct lod_baked_level levels[2] = {curved(900, 2, 80, 2.2), curved(900, 2, 80, 2.2)};
  assert_int_equal(lod_levels_order(levels, 2), 1);
  assert_int_equal(levels[0].patches.size, 80);
}

/* Vertices at one place merge at any precision: nothing is refined for them. */
static void vertices_at_one_place_do_not_cost_precision(void **state) {
  (void)state;
  const struct lod_mesh mesh = sphere_and_speck(0);
  const struct lod_baked_level merged = bake(&mesh, false), apart = bake(&mesh, true);
  assert_true(apart.position_error == merged.position_error);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(vertices_that_must_stay_apart_do, open_arena, close_arena),
      cmocka_unit_test(curved_levels_that_another_betters_are_dropped),
      cmocka_unit_test(of_equal_curved_levels_one_stays),
      cmocka_unit_test_setup_teardown(vertices_at_one_place_do_not_cost_precision, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
