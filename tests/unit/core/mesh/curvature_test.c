#include "core/mesh/curvature.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_curvature estimate(const struct lod_mesh *mesh, enum lod_curvature_method method) {
  struct lod_curvature c;
  struct lod_adjacency adjacency;
  assert_int_equal(lod_adjacency_create(mesh, arena, &adjacency), LOD_OK);
  assert_int_equal(lod_curvature_estimate(mesh, &adjacency, method, 40, arena, &c), LOD_OK);
  return c;
}

static void sphere_of_radius_2_bends_by_a_half(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_sphere(arena, 2, 4);
  struct lod_curvature tensor = estimate(&mesh, LOD_CURVATURE_TENSOR), turk = estimate(&mesh, LOD_CURVATURE_TURK);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    assert_true(fabs(tensor.principal[v][0] - 0.5) < 0.05 && fabs(tensor.principal[v][1] - 0.5) < 0.05);
    assert_true(tensor.largest[v] == fabs(tensor.principal[v][0]));
    assert_true(fabs(turk.largest[v] - 0.5) < 0.05);
  }
}

static void torus_bends_most_around_its_tube(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 4, 1, 160, 60);
  struct lod_curvature c = estimate(&mesh, LOD_CURVATURE_TENSOR);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    const float *p = mesh.positions[v];
    double around = hypot((double)p[0], (double)p[1]);
    assert_true(fabs(c.principal[v][0] - 1) < 0.05);
    assert_true(fabs(c.principal[v][1] - (around - 4) / around) < 0.05); /* cos / (R + r cos), r = 1 */
    struct lod_vec3 along = lod_vec3_make(-(double)p[1] / around, (double)p[0] / around, 0);
    assert_true(fabs(lod_vec3_dot(c.directions[v], along)) < 0.1);
  }
}

static void cube_is_flat_but_for_its_creases(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_cube(arena, 2);
  struct lod_curvature tensor = estimate(&mesh, LOD_CURVATURE_TENSOR), turk = estimate(&mesh, LOD_CURVATURE_TURK);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    assert_true(tensor.largest[v] < 1e-9);
    assert_true(turk.largest[v] > 0.3 && isfinite(turk.largest[v]));
  }
}

static void what_has_no_area_has_no_curvature(void **state) {
  (void)state;
  static float positions[4][3] = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {9, 9, 9}};
  static uint32_t triangles[2][3] = {{0, 1, 2}, {0, 0, 1}};
  struct lod_mesh mesh = {.vertex_count = 4, .triangle_count = 2, .positions = positions, .triangles = triangles};
  struct lod_curvature tensor = estimate(&mesh, LOD_CURVATURE_TENSOR), turk = estimate(&mesh, LOD_CURVATURE_TURK);
  for (uint32_t v = 0; v < 4; v++)
    assert_true(tensor.largest[v] == 0 && turk.largest[v] == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(sphere_of_radius_2_bends_by_a_half, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(torus_bends_most_around_its_tube, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(cube_is_flat_but_for_its_creases, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(what_has_no_area_has_no_curvature, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
