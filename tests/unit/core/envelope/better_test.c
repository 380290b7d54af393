/* The better of collapse and cover, on two parts side by side. */
#include "core/envelope/better.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/distance.h"
#include "core/mesh/topology.h"
#include "tests/data/shapes.h"

static struct lod_mesh two_parts(struct lod_arena *arena) {
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.35, 14, 8), grid = lod_shape_grid(arena, 1, 10, 0.1);
  struct lod_mesh mesh = lod_shape_join(arena, &torus, &grid, (const double[3]){3, 0, 0});
  mesh.materials = LOD_NEW_ZERO(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = torus.triangle_count; t < mesh.triangle_count; t++)
    mesh.materials[t] = 1;
  return mesh;
}

/* Collapses within epsilon, betters it and checks what came of it. */
static struct lod_better_report better(struct lod_arena *arena, bool vertex_subset, double epsilon,
                                       const struct lod_better_settings *settings, uint32_t *before, uint32_t *after) {
  struct lod_mesh mesh = two_parts(arena), level;
  struct lod_bvh *bvh;
  struct lod_collapser *collapser;
  struct lod_collapse_settings collapse = lod_collapse_defaults();
  struct lod_better_report report;
  collapse.vertex_subset = vertex_subset;
  uint32_t *nearby = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  assert_int_equal(lod_bvh_create(&mesh, 1, arena, &bvh), LOD_OK);
  assert_int_equal(lod_collapser_create(&mesh, bvh, NULL, &collapse, arena, &collapser), LOD_OK);
  assert_int_equal(lod_collapser_run(collapser, epsilon, NULL), LOD_OK);
  assert_int_equal(lod_collapser_extract(collapser, arena, &level, nearby), LOD_OK);
  *before = level.triangle_count;
  assert_int_equal(lod_envelope_better(collapser, epsilon, settings, NULL, arena, &level, nearby, &report), LOD_OK);
  *after = level.triangle_count;
  assert_true(lod_mesh_check(&level, NULL));
  bool *used = LOD_NEW_ZERO(arena, level.vertex_count, bool);
  for (uint32_t i = 0; i < 3 * level.triangle_count; i++)
    used[level.triangles[i / 3][i % 3]] = true;
  for (uint32_t v = 0; v < level.vertex_count; v++)
    assert_true(used[v]);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) { /* a hint leads to the same part */
    assert_in_range(nearby[t], 0, level.triangle_count - 1);
    assert_int_equal(level.materials[nearby[t]], mesh.materials[t]);
  }
  struct lod_distance_settings measure = lod_distance_defaults();
  struct lod_distance distance;
  struct lod_topology topology;
  assert_int_equal(lod_distance_measure(&mesh, &level, &measure, arena, &distance), LOD_OK);
  assert_true(distance.two_sided.lower <= epsilon * (1 + 1e-9) && distance.two_sided.upper <= epsilon * 1.02);
  assert_int_equal(lod_topology_measure(&level, NULL, arena, &topology), LOD_OK);
  assert_int_equal(topology.components, 2);
  assert_int_equal(topology.boundary_loops, 1);
  assert_int_equal(topology.euler, 1);
  return report;
}

static void a_smaller_cover_takes_the_place_of_its_part(void **state) {
  (void)state;
  uint32_t exchanged = 0, saved = 0;
  static const double kEpsilons[] = {0.01, 0.03, 0.06, 0.12, 0.25};
  for (int i = 0; i < 5; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_better_settings settings = lod_better_defaults();
    uint32_t before, after;
    struct lod_better_report report = better(arena, true, kEpsilons[i], &settings, &before, &after);
    assert_int_equal(before - after, report.saved_going_on + report.saved_in_parts);
    exchanged += report.parts_exchanged;
    saved += before - after;
    lod_arena_destroy(arena);
  }
  assert_true(exchanged > 0 && saved > 20);
}

static void it_never_adds_triangles_and_can_be_left_out(void **state) {
  (void)state;
  for (int i = 0; i < 4; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_better_settings settings = i < 2 ? lod_better_defaults() : (struct lod_better_settings){0};
    uint32_t before, after;
    struct lod_better_report report = better(arena, false, i % 2 == 0 ? 0.02 : 0.1, &settings, &before, &after);
    assert_true(after <= before);
    if (i >= 2) {
      assert_int_equal(after, before);
      assert_int_equal(report.parts_exchanged + report.saved_going_on, 0);
    }
    lod_arena_destroy(arena);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_smaller_cover_takes_the_place_of_its_part),
      cmocka_unit_test(it_never_adds_triangles_and_can_be_left_out),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
