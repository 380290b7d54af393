#include "core/mesh/distance.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_distance measure(const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_distance_settings settings = lod_distance_defaults();
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(a, b, &settings, arena, &distance), LOD_OK);
  return distance;
}

/* The interval holds the true value and is as narrow as it was asked to be. */
static void check_interval(struct lod_interval interval, double truth, double magnitude) {
  double rounding = 1e-12 * magnitude;
  assert_true(interval.lower <= truth + 1e-15 * magnitude);
  assert_true(interval.upper >= truth - 1e-15 * magnitude);
  assert_true(interval.upper - interval.lower <= 0.01 * interval.lower + rounding);
}

static struct lod_mesh copy(const struct lod_mesh *mesh, double scale, double dx, double dy, double dz) {
  struct lod_mesh out = *mesh;
  const double offset[3] = {dx, dy, dz};
  out.positions = lod_arena_alloc(arena, mesh->vertex_count, sizeof *out.positions);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int k = 0; k < 3; k++)
      out.positions[v][k] = (float)((double)mesh->positions[v][k] * scale + offset[k]);
  return out;
}

static struct lod_mesh one_point(double x, double y, double z) {
  struct lod_mesh mesh = {.vertex_count = 1, .point_count = 1};
  mesh.positions = lod_arena_calloc(arena, 1, sizeof *mesh.positions);
  mesh.points = lod_arena_calloc(arena, 1, sizeof *mesh.points);
  lod_vec3_to_float(lod_vec3_make(x, y, z), mesh.positions[0]);
  return mesh;
}

static void parallel_squares_are_as_far_apart_as_they_are(void **state) {
  (void)state;
  struct lod_mesh coarse = lod_shape_grid(arena, 1, 1, 0), fine = lod_shape_grid(arena, 1, 23, 0);
  struct lod_mesh above = copy(&coarse, 1, 0, 0, 0.125);
  struct lod_distance distance = measure(&above, &fine);
  check_interval(distance.a_to_b, 0.125, 1);
  check_interval(distance.b_to_a, 0.125, 1);
  check_interval(distance.two_sided, 0.125, 1);
  assert_true(distance.complete);
}

static void small_square_inside_a_large_one_is_one_sided(void **state) {
  (void)state;
  struct lod_mesh large = lod_shape_grid(arena, 2, 7, 0), small = lod_shape_grid(arena, 1, 5, 0);
  struct lod_bounds l = lod_mesh_bounds(&large), s = lod_mesh_bounds(&small);
  struct lod_mesh centred =
      copy(&small, 1, (l.min[0] + l.max[0] - s.min[0] - s.max[0]) / 2, (l.min[1] + l.max[1] - s.min[1] - s.max[1]) / 2, 0);
  struct lod_distance distance = measure(&centred, &large);
  check_interval(distance.a_to_b, 0, 2);
  check_interval(distance.b_to_a, sqrt(0.5), 2);
  check_interval(distance.two_sided, sqrt(0.5), 2);
}

static void point_above_a_triangle_sees_its_height_and_its_farthest_corner(void **state) {
  (void)state;
  struct lod_mesh square = lod_shape_grid(arena, 1, 1, 0);
  struct lod_bounds box = lod_mesh_bounds(&square);
  struct lod_mesh point = one_point(box.min[0] + 0.25, box.min[1] + 0.25, 0.5);
  struct lod_distance distance = measure(&point, &square);
  check_interval(distance.a_to_b, 0.5, 1);
  check_interval(distance.b_to_a, sqrt(2 * 0.75 * 0.75 + 0.25), 1);
  struct lod_distance swapped = measure(&square, &point);
  check_interval(swapped.b_to_a, 0.5, 1);
}

static void segment_and_its_end_points_differ_by_half_its_length(void **state) {
  (void)state;
  static uint32_t edge[1][2] = {{0, 1}}, ends[2] = {0, 1};
  struct lod_mesh segment = {.vertex_count = 2, .edge_count = 1, .edges = edge};
  segment.positions = lod_arena_calloc(arena, 2, sizeof *segment.positions);
  segment.positions[1][0] = 3;
  segment.positions[1][1] = 4;
  struct lod_mesh points = {.vertex_count = 2, .point_count = 2, .positions = segment.positions, .points = ends};
  struct lod_distance distance = measure(&segment, &points);
  check_interval(distance.a_to_b, 2.5, 4);
  check_interval(distance.b_to_a, 0, 4);
}

/* A convex body's distance is convex, so the swollen sphere's farthest points are corners, each right above the corner it came from. */
static void sphere_swollen_by_a_tenth_is_a_tenth_away(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 3);
  struct lod_mesh swollen = copy(&sphere, 1.125, 0, 0, 0);
  struct lod_distance distance = measure(&sphere, &swollen);
  assert_true(distance.b_to_a.lower <= 0.125 + 1e-6 && distance.b_to_a.upper >= 0.125 - 1e-6);
  assert_true(distance.b_to_a.upper <= 0.125 * 1.0101);
  assert_true(distance.a_to_b.upper < distance.b_to_a.upper && distance.a_to_b.lower > 0.12);
  assert_true(distance.complete);
}

static void shifted_tube_is_as_far_as_it_was_shifted(void **state) {
  (void)state;
  struct lod_mesh tube = lod_shape_tube(arena, 1, 4, 32, 6);
  struct lod_mesh shifted = copy(&tube, 1, 0, 0, 0.25);
  struct lod_distance distance = measure(&tube, &shifted);
  check_interval(distance.two_sided, 0.25, 4);
}

static void spike_on_a_plane_is_as_far_as_it_is_high(void **state) {
  (void)state;
  struct lod_mesh plane = lod_shape_grid(arena, 1, 200, 0);
  struct lod_mesh spiked = copy(&plane, 1, 0, 0, 0);
  uint32_t tip = plane.vertex_count / 2 + 77;
  spiked.positions[tip][2] = 0.375f;
  struct lod_distance distance = measure(&plane, &spiked);
  check_interval(distance.b_to_a, 0.375, 1);
  check_interval(distance.two_sided, 0.375, 1);
  assert_true(distance.a_to_b.upper < 0.01);
}

static void mesh_is_at_distance_0_from_itself_and_from_its_halves(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.25, 100, 40);
  struct lod_distance distance = measure(&torus, &torus);
  assert_true(distance.two_sided.lower == 0 && distance.two_sided.upper < 1e-12);
  /* One flat square, two triangulations: no triangle of one lies in one triangle of the other. */
  struct lod_mesh fine = lod_shape_grid(arena, 1, 31, 0), coarse = lod_shape_grid(arena, 1, 17, 0);
  struct lod_bounds f = lod_mesh_bounds(&fine), c = lod_mesh_bounds(&coarse);
  assert_memory_equal(&f, &c, sizeof f);
  distance = measure(&fine, &coarse);
  assert_true(distance.complete);
  assert_true(distance.two_sided.lower == 0 && distance.two_sided.upper < 1e-12);
}

static void nothing_is_at_0_from_nothing_and_infinitely_far_from_something(void **state) {
  (void)state;
  struct lod_mesh empty = {0}, cube = lod_shape_cube(arena, 1);
  struct lod_distance distance = measure(&empty, &empty);
  assert_true(distance.two_sided.lower == 0 && distance.two_sided.upper == 0 && distance.complete);
  distance = measure(&cube, &empty);
  assert_true(isinf(distance.a_to_b.lower) && isinf(distance.a_to_b.upper) && isinf(distance.two_sided.upper));
  assert_true(distance.b_to_a.upper == 0);
}

/* 0.0625 is one unit in the last place of a float near 10^6: rounding must neither hide nor swell it. */
static void shift_by_one_last_place_at_a_million_is_measured(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 512, 64, 0);
  struct lod_mesh low = copy(&grid, 1, 1e6, 1e6, 1e6);
  struct lod_mesh high = copy(&low, 1, 0, 0, 0.0625);
  assert_true(high.positions[0][2] - low.positions[0][2] == 0.0625f);
  struct lod_distance distance = measure(&low, &high);
  assert_true(distance.complete);
  assert_true(distance.two_sided.lower <= 0.0625 && distance.two_sided.lower >= 0.0624);
  assert_true(distance.two_sided.upper >= 0.0625 && distance.two_sided.upper <= 0.0632);
}

static void swapping_the_meshes_swaps_the_sides(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 4), cube = lod_shape_cube(arena, 1.5);
  struct lod_distance one = measure(&sphere, &cube), other = measure(&cube, &sphere);
  assert_memory_equal(&one.a_to_b, &other.b_to_a, sizeof one.a_to_b);
  assert_memory_equal(&one.b_to_a, &other.a_to_b, sizeof one.a_to_b);
  assert_memory_equal(&one.two_sided, &other.two_sided, sizeof one.two_sided);
  double truth = 0.75 * sqrt(3) - 1; /* the sphere is a polyhedron a little inside of the sphere */
  assert_true(one.b_to_a.lower > truth * 0.99 && one.b_to_a.upper < truth * 1.03);
}

static void any_number_of_threads_gives_the_same_bits(void **state) {
  (void)state;
  struct lod_mesh a = lod_shape_torus(arena, 1, 0.3, 400, 90), b = lod_shape_torus(arena, 1.01, 0.29, 150, 51);
  struct lod_distance first;
  for (uint32_t threads = 1; threads <= 5; threads += threads == 1 ? 1 : 3) {
    struct lod_distance_settings settings = lod_distance_defaults();
    settings.threads = threads;
    settings.rms = true;
    struct lod_distance distance;
    memset(&distance, 0, sizeof distance);
    assert_int_equal(lod_distance_measure(&a, &b, &settings, arena, &distance), LOD_OK);
    if (threads == 1)
      first = distance;
    assert_memory_equal(&first.a_to_b, &distance.a_to_b, sizeof first.a_to_b);
    assert_memory_equal(&first.b_to_a, &distance.b_to_a, sizeof first.b_to_a);
    assert_memory_equal(&first.two_sided, &distance.two_sided, sizeof first.two_sided);
    assert_memory_equal(&first.rms, &distance.rms, sizeof first.rms);
  }
}

static void rms_between_parallel_squares_is_their_distance(void **state) {
  (void)state;
  struct lod_mesh square = lod_shape_grid(arena, 1, 9, 0), above = copy(&square, 1, 0, 0, 0.5);
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.rms = true;
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(&square, &above, &settings, arena, &distance), LOD_OK);
  assert_true(fabs(distance.rms - 0.5) < 1e-12);
  /* Tilted from 0 to 1 along x: the mean of x squared is 1/3, seen straight up; the nearest point lies at x / sqrt(2). */
  struct lod_mesh tilted = copy(&square, 1, 0, 0, 0);
  struct lod_bounds box = lod_mesh_bounds(&square);
  for (uint32_t v = 0; v < tilted.vertex_count; v++)
    tilted.positions[v][2] = tilted.positions[v][0] - (float)box.min[0];
  struct lod_mesh wide = copy(&square, 4, 0, 0, 0);
  struct lod_bounds w = lod_mesh_bounds(&wide);
  wide = copy(&wide, 1, box.min[0] - w.min[0] - 1, box.min[1] - w.min[1] - 1, 0);
  struct lod_distance up;
  assert_int_equal(lod_distance_measure(&tilted, &wide, &settings, arena, &up), LOD_OK);
  assert_true(up.a_to_b.upper >= 1 && up.a_to_b.upper <= 1.0101);
}

static void known_upper_bound_ends_the_work_and_is_the_answer(void **state) {
  (void)state;
  struct lod_mesh square = lod_shape_grid(arena, 1, 50, 0), above = copy(&square, 1, 0, 0, 0.5);
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.known_upper_ab = settings.known_upper_ba = 0.5;
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(&square, &above, &settings, arena, &distance), LOD_OK);
  assert_true(distance.two_sided.upper == 0.5 && distance.two_sided.lower >= 0.499);
}

static void larger_side_alone_gives_the_same_two_sided_promise(void **state) {
  (void)state;
  struct lod_mesh large = lod_shape_grid(arena, 2, 40, 0.3), small = lod_shape_grid(arena, 1, 30, 0);
  struct lod_distance full = measure(&small, &large);
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.larger_side_only = true;
  struct lod_bvh *trees[2];
  assert_int_equal(lod_bvh_create(&small, 1, arena, &trees[0]), LOD_OK);
  assert_int_equal(lod_bvh_create(&large, 1, arena, &trees[1]), LOD_OK);
  settings.bvh_a = trees[0];
  settings.bvh_b = trees[1];
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(&small, &large, &settings, arena, &distance), LOD_OK);
  assert_true(distance.complete);
  assert_true(distance.two_sided.upper >= full.two_sided.lower && distance.two_sided.lower <= full.two_sided.upper);
  assert_true(distance.two_sided.upper <= distance.two_sided.lower * 1.0101);
  assert_true(distance.a_to_b.upper >= full.a_to_b.lower && distance.a_to_b.lower <= full.a_to_b.upper);
}

static void exhausted_budget_widens_the_interval_but_never_breaks_it(void **state) {
  (void)state;
  struct lod_mesh a = lod_shape_torus(arena, 1, 0.3, 60, 30), b = lod_shape_torus(arena, 1, 0.3, 7, 5);
  struct lod_distance full = measure(&a, &b);
  bool incomplete = false;
  for (uint64_t budget = 1; budget < 5000; budget *= 8) {
    struct lod_distance_settings settings = lod_distance_defaults();
    settings.relative = 1e-4;
    settings.budget = budget;
    struct lod_distance distance;
    assert_int_equal(lod_distance_measure(&a, &b, &settings, arena, &distance), LOD_OK);
    assert_true(distance.two_sided.lower <= full.two_sided.upper && distance.two_sided.upper >= full.two_sided.lower);
    assert_true(isfinite(distance.two_sided.upper));
    assert_true(!distance.complete || distance.two_sided.upper <= distance.two_sided.lower * 1.00011);
    incomplete = incomplete || !distance.complete;
  }
  assert_true(incomplete);
}

static bool always(void *context) {
  (void)context;
  return true;
}

static void cancelled_measurement_says_so(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 5);
  struct lod_progress progress = {.cancelled = always};
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.progress = &progress;
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(&sphere, &sphere, &settings, arena, &distance), LOD_CANCELLED);
}

static void measurement_over_a_memory_limit_fails_and_leaves_nothing_behind(void **state) {
  (void)state;
  struct lod_mesh a = lod_shape_sphere(arena, 1, 4), b = lod_shape_sphere(arena, 1.2, 3);
  struct lod_distance_settings settings = lod_distance_defaults();
  bool failed = false, succeeded = false;
  for (size_t limit = 1 << 14; limit < 64 << 20; limit *= 2) {
    struct lod_arena *small = lod_arena_create(limit);
    struct lod_distance distance;
    enum lod_status status = lod_distance_measure(&a, &b, &settings, small, &distance);
    assert_true(status == LOD_OK || status == LOD_MEMORY);
    assert_int_equal(lod_arena_bytes(small), 0);
    failed = failed || status == LOD_MEMORY;
    succeeded = succeeded || status == LOD_OK;
    lod_arena_destroy(small);
  }
  assert_true(failed && succeeded);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(parallel_squares_are_as_far_apart_as_they_are, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(small_square_inside_a_large_one_is_one_sided, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(point_above_a_triangle_sees_its_height_and_its_farthest_corner, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(segment_and_its_end_points_differ_by_half_its_length, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(sphere_swollen_by_a_tenth_is_a_tenth_away, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(shifted_tube_is_as_far_as_it_was_shifted, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(spike_on_a_plane_is_as_far_as_it_is_high, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(mesh_is_at_distance_0_from_itself_and_from_its_halves, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(nothing_is_at_0_from_nothing_and_infinitely_far_from_something, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(shift_by_one_last_place_at_a_million_is_measured, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(swapping_the_meshes_swaps_the_sides, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(any_number_of_threads_gives_the_same_bits, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(rms_between_parallel_squares_is_their_distance, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(known_upper_bound_ends_the_work_and_is_the_answer, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(larger_side_alone_gives_the_same_two_sided_promise, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(exhausted_budget_widens_the_interval_but_never_breaks_it, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(cancelled_measurement_says_so, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(measurement_over_a_memory_limit_fails_and_leaves_nothing_behind, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
