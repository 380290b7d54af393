/* Properties of the certified distance over random pairs of meshes: it contains what dense samples show, and nothing a caller may hint
 * changes that. */
#include "core/mesh/distance.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static uint32_t primitive_count(const struct lod_mesh *mesh) {
  return mesh->triangle_count + mesh->edge_count + mesh->point_count;
}

static void corners_of(const struct lod_mesh *mesh, uint32_t p, struct lod_vec3 corners[3]) {
  uint32_t t[3];
  if (p < mesh->triangle_count) {
    memcpy(t, mesh->triangles[p], sizeof t);
  } else if (p < mesh->triangle_count + mesh->edge_count) {
    t[0] = mesh->edges[p - mesh->triangle_count][0];
    t[1] = t[2] = mesh->edges[p - mesh->triangle_count][1];
  } else {
    t[0] = t[1] = t[2] = mesh->points[p - mesh->triangle_count - mesh->edge_count];
  }
  for (int k = 0; k < 3; k++)
    corners[k] = lod_vec3_from_float(mesh->positions[t[k]]);
}

/* Brute force over every primitive of `to`, or its tree (tested for itself) where that would take long. Early out once within `below`,
 * which cannot be a maximum. */
static double distance_to(const struct lod_mesh *to, const struct lod_bvh *tree, struct lod_vec3 q, double below) {
  double best = INFINITY;
  if (tree != NULL)
    return sqrt(lod_bvh_closest(tree, q, LOD_NONE, INFINITY).distance_squared);
  for (uint32_t p = 0; p < primitive_count(to) && best > below * below; p++) {
    struct lod_vec3 c[3];
    corners_of(to, p, c);
    best = fmin(best, lod_vec3_distance_squared(q, lod_closest_on_triangle(q, c[0], c[1], c[2])));
  }
  return sqrt(best);
}

/* Largest distance of a grid of `steps` intervals on every primitive; *gap: no point is farther from the grid than this. */
static double dense_sample(const struct lod_mesh *from, const struct lod_mesh *to, const struct lod_bvh *tree, int steps, double *gap) {
  double largest = 0;
  *gap = 0;
  for (uint32_t p = 0; p < primitive_count(from); p++) {
    struct lod_vec3 c[3];
    corners_of(from, p, c);
    struct lod_vec3 ab = lod_vec3_subtract(c[1], c[0]), ac = lod_vec3_subtract(c[2], c[0]);
    *gap = fmax(*gap, (lod_vec3_length(ab) + lod_vec3_length(ac)) / steps);
    for (int i = 0; i <= steps; i++)
      for (int j = 0; i + j <= steps; j++) {
        struct lod_vec3 q = lod_vec3_add_scaled(lod_vec3_add_scaled(c[0], ab, (double)i / steps), ac, (double)j / steps);
        largest = fmax(largest, distance_to(to, tree, q, largest));
      }
  }
  return largest;
}

static struct lod_mesh random_mesh(uint64_t *seed) {
  uint32_t triangles = (uint32_t)(lod_random_next(seed) % 40);
  struct lod_mesh mesh = lod_shape_soup(arena, triangles + 1, 0.05 + lod_random_unit(seed), lod_random_next(seed));
  mesh.triangle_count = triangles; /* possibly none */
  mesh.edge_count = (uint32_t)(lod_random_next(seed) % 4);
  mesh.point_count = (uint32_t)(lod_random_next(seed) % 4) + (triangles + mesh.edge_count == 0);
  mesh.edges = lod_arena_alloc(arena, mesh.edge_count, sizeof *mesh.edges);
  mesh.points = lod_arena_alloc(arena, mesh.point_count, sizeof *mesh.points);
  for (uint32_t i = 0; i < 2 * mesh.edge_count; i++)
    mesh.edges[i / 2][i % 2] = (uint32_t)(lod_random_next(seed) % mesh.vertex_count);
  for (uint32_t i = 0; i < mesh.point_count; i++)
    mesh.points[i] = (uint32_t)(lod_random_next(seed) % mesh.vertex_count);
  for (uint32_t t = 0; t < mesh.triangle_count; t += 5) /* some slivers */
    memcpy(mesh.positions[mesh.triangles[t][2]], mesh.positions[mesh.triangles[t][0]], 2 * sizeof(float));
  return mesh;
}

static void check_side(struct lod_interval interval, const struct lod_mesh *from, const struct lod_mesh *to) {
  double gap, seen = dense_sample(from, to, NULL, 12, &gap);
  assert_true(interval.lower <= interval.upper);
  assert_true(interval.upper >= seen);
  assert_true(interval.lower <= seen + gap);
}

static uint32_t *random_hints(uint64_t *seed, uint32_t count, uint32_t range) {
  uint32_t *hints = lod_arena_alloc(arena, count, sizeof *hints);
  for (uint32_t i = 0; i < count; i++)
    hints[i] = lod_random_next(seed) % 5 == 0 ? LOD_NONE : (uint32_t)(lod_random_next(seed) % range);
  return hints;
}

static void interval_contains_what_dense_samples_show(void **state) {
  (void)state;
  uint64_t seed = 2024;
  for (int round = 0; round < 40; round++) {
    struct lod_mesh a = random_mesh(&seed), b = random_mesh(&seed);
    struct lod_distance_settings settings = lod_distance_defaults();
    struct lod_distance distance;
    assert_int_equal(lod_distance_measure(&a, &b, &settings, arena, &distance), LOD_OK);
    assert_true(distance.complete);
    assert_true(distance.a_to_b.upper <= 1.0101 * distance.a_to_b.lower + 1e-11);
    assert_true(distance.b_to_a.upper <= 1.0101 * distance.b_to_a.lower + 1e-11);
    check_side(distance.a_to_b, &a, &b);
    check_side(distance.b_to_a, &b, &a);
    assert_true(distance.two_sided.lower == fmax(distance.a_to_b.lower, distance.b_to_a.lower));
    assert_true(distance.two_sided.upper == fmax(distance.a_to_b.upper, distance.b_to_a.upper));
  }
}

static void wrong_hints_never_break_the_interval(void **state) {
  (void)state;
  uint64_t seed = 77;
  for (int round = 0; round < 40; round++) {
    struct lod_mesh a = random_mesh(&seed), b = random_mesh(&seed);
    struct lod_distance_settings settings = lod_distance_defaults();
    settings.hint_ab = random_hints(&seed, primitive_count(&a), primitive_count(&b));
    settings.hint_ba = round % 2 ? NULL : random_hints(&seed, primitive_count(&b), primitive_count(&a));
    settings.larger_side_only = round % 3 == 0;
    struct lod_distance distance;
    assert_int_equal(lod_distance_measure(&a, &b, &settings, arena, &distance), LOD_OK);
    assert_true(distance.complete);
    assert_true(distance.two_sided.upper <= 1.0101 * distance.two_sided.lower + 1e-11);
    check_side(distance.a_to_b, &a, &b);
    check_side(distance.b_to_a, &b, &a);
  }
}

/* Smooth surfaces that nearly agree: the distance is far smaller than the triangles, and pieces are cut along the target. */
static void close_surfaces_of_unlike_triangles_are_measured_exactly(void **state) {
  (void)state;
  static const int kAround[][2] = {{40, 20}, {64, 24}, {37, 53}};
  struct lod_mesh fine = lod_shape_torus(arena, 1, 0.4, 90, 45);
  struct lod_bvh *tree;
  assert_int_equal(lod_bvh_create(&fine, 1, arena, &tree), LOD_OK);
  for (size_t i = 0; i < sizeof kAround / sizeof *kAround; i++) {
    struct lod_mesh coarse = lod_shape_torus(arena, 1, 0.4, kAround[i][0], kAround[i][1]);
    struct lod_distance_settings settings = lod_distance_defaults();
    struct lod_distance distance, hinted;
    assert_int_equal(lod_distance_measure(&fine, &coarse, &settings, arena, &distance), LOD_OK);
    assert_true(distance.complete && distance.two_sided.upper <= 1.0101 * distance.two_sided.lower);
    double gap, seen = dense_sample(&coarse, &fine, tree, 4, &gap);
    assert_true(seen <= distance.b_to_a.upper && seen >= 0.5 * distance.b_to_a.lower);
    uint64_t seed = i;
    settings.hint_ab = random_hints(&seed, fine.triangle_count, coarse.triangle_count);
    settings.hint_ba = random_hints(&seed, coarse.triangle_count, fine.triangle_count);
    assert_int_equal(lod_distance_measure(&fine, &coarse, &settings, arena, &hinted), LOD_OK);
    assert_true(hinted.two_sided.lower <= distance.two_sided.upper && hinted.two_sided.upper >= distance.two_sided.lower);
    assert_true(hinted.complete);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(interval_contains_what_dense_samples_show, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(wrong_hints_never_break_the_interval, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(close_surfaces_of_unlike_triangles_are_measured_exactly, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
