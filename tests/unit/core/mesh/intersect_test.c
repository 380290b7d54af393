/* Triangles that cross, touch, share and lie flat, each pair as one would draw it. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "core/mesh/intersect.h"
#include "tests/data/shapes.h"

static struct lod_corners triangle(uint32_t i, uint32_t j, uint32_t k, const double p[9]) {
  struct lod_corners t = {.vertex = {i, j, k}};
  for (int n = 0; n < 9; n++)
    t.point[n / 3][n % 3] = p[n];
  return t;
}

/* The base: (0, 0), (2, 0), (0, 2) in z = 0. */
static bool crosses_base(uint32_t i, uint32_t j, uint32_t k, const double p[9]) {
  struct lod_corners base = triangle(0, 1, 2, (const double[9]){0, 0, 0, 2, 0, 0, 0, 2, 0}), other = triangle(i, j, k, p);
  bool crosses = lod_triangles_cross(&base, &other);
  assert_int_equal(lod_triangles_cross(&other, &base), crosses);
  return crosses;
}

static void apart(void **state) {
  (void)state;
  assert_false(crosses_base(3, 4, 5, (const double[9]){0, 0, 1, 2, 0, 1, 0, 2, 1}));
  assert_false(crosses_base(3, 4, 5, (const double[9]){1.5, 1.5, -1, 1.5, 1.5, 1, 2, 2, 0}));
  assert_false(crosses_base(3, 4, 5, (const double[9]){1.5, 1.5, 0, 2, 1.5, 0, 1.5, 2, 0}));
}

static void pierced(void **state) {
  (void)state;
  assert_true(crosses_base(3, 4, 5, (const double[9]){0.5, 0.5, -1, 0.5, 0.5, 1, 5, 5, 0}));
  assert_true(crosses_base(3, 4, 5, (const double[9]){0.25, 0.25, 0, 0.5, 0.25, 0, 0.25, 0.5, 0})); /* inside, in its plane */
  assert_true(crosses_base(3, 4, 5, (const double[9]){-1, -1, 0, 9, -1, 0, -1, 9, 0}));             /* around it, in its plane */
  assert_true(crosses_base(3, 4, 5, (const double[9]){0, 0, 0, -1, 0, 1, -1, 0, 2})); /* touches a corner that is not shared */
}

static void shared_corner(void **state) {
  (void)state;
  assert_false(crosses_base(0, 4, 5, (const double[9]){0, 0, 0, 1, 1, 1, 2, 0, 1}));
  assert_false(crosses_base(0, 4, 5, (const double[9]){0, 0, 0, -1, 0, 0, 0, -1, 0})); /* in its plane, opposite */
  assert_true(crosses_base(0, 4, 5, (const double[9]){0, 0, 0, 1, 1, 1, 1, 1, -1}));
  assert_true(crosses_base(0, 4, 5, (const double[9]){0, 0, 0, 1, 0.1, 0, 0.1, 1, 0})); /* in its plane, inside its angle */
  assert_true(crosses_base(0, 4, 5, (const double[9]){0, 0, 0, 9, 1, 0, 1, 9, 0}));     /* the same, and larger */
}

static void shared_edge(void **state) {
  (void)state;
  assert_false(crosses_base(1, 0, 5, (const double[9]){2, 0, 0, 0, 0, 0, 1, -1, 0}));
  assert_false(crosses_base(1, 0, 5, (const double[9]){2, 0, 0, 0, 0, 0, 1, 1, 0.001}));
  assert_true(crosses_base(1, 0, 5, (const double[9]){2, 0, 0, 0, 0, 0, 1, 1, 0})); /* folded flat */
  assert_true(crosses_base(2, 1, 0, (const double[9]){0, 2, 0, 2, 0, 0, 0, 0, 0}));
}

static void without_area(void **state) {
  (void)state;
  assert_true(crosses_base(3, 4, 5, (const double[9]){0.5, 0.5, -1, 0.5, 0.5, 1, 0.5, 0.5, 2}));
  assert_false(crosses_base(3, 4, 5, (const double[9]){3, 3, -1, 3, 3, 1, 3, 3, 2}));
  struct lod_corners a = triangle(0, 1, 2, (const double[9]){0, 0, 0, 1, 1, 1, 2, 2, 2});
  struct lod_corners b = triangle(3, 4, 5, (const double[9]){0, 2, 1, 1, 1, 1, 2, 0, 1});
  struct lod_corners c = triangle(3, 4, 5, (const double[9]){0, 2, 2, 1, 1, 2, 2, 0, 2});
  assert_true(lod_triangles_cross(&a, &b));
  assert_false(lod_triangles_cross(&a, &c));
}

static struct lod_crossings count(struct lod_arena *arena, const struct lod_mesh *mesh) {
  struct lod_crossings crossings;
  assert_int_equal(lod_intersect_count(mesh, NULL, arena, NULL, &crossings), LOD_OK);
  return crossings;
}

static void of_a_mesh(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 3), cube = lod_shape_cube(arena, 1);
  assert_int_equal(count(arena, &sphere).pairs, 0);
  assert_int_equal(count(arena, &cube).pairs, 0);
  struct lod_mesh apart_ = lod_shape_join(arena, &sphere, &cube, (const double[3]){2, 0, 0});
  assert_int_equal(count(arena, &apart_).pairs, 0);
  struct lod_mesh crossing = lod_shape_join(arena, &sphere, &cube, (const double[3]){1, 0.01, 0.02});
  uint64_t pairs = 0;
  for (uint32_t t = 0; t < crossing.triangle_count; t++)
    for (uint32_t u = t + 1; u < crossing.triangle_count; u++) {
      struct lod_corners a, b;
      for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
          a.vertex[i] = crossing.triangles[t][i];
          b.vertex[i] = crossing.triangles[u][i];
          a.point[i][k] = (double)crossing.positions[a.vertex[i]][k];
          b.point[i][k] = (double)crossing.positions[b.vertex[i]][k];
        }
      pairs += lod_triangles_cross(&a, &b);
    }
  assert_true(pairs > 10);
  assert_int_equal(count(arena, &crossing).pairs, pairs);
  assert_true(count(arena, &crossing).triangles > 10);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(apart),       cmocka_unit_test(pierced),      cmocka_unit_test(shared_corner),
      cmocka_unit_test(shared_edge), cmocka_unit_test(without_area), cmocka_unit_test(of_a_mesh),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
