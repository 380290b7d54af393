#include "core/mesh/model.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

static struct lod_sphere sphere_of(struct lod_mesh mesh) {
  struct lod_unit unit = {.mesh = mesh, .scale = 1};
  double instances[1][16];
  memcpy(instances[0], kIdentity, sizeof kIdentity);
  struct lod_part part = {.unit = 0, .instance_count = 1, .instances = instances};
  struct lod_model model = {.unit_count = 1, .part_count = 1, .units = &unit, .parts = &part};
  return lod_model_sphere(&model);
}

static double farthest(const struct lod_mesh *mesh, const struct lod_sphere *sphere) {
  double most = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    most = fmax(most, lod_vec3_distance(lod_vec3_from_float(mesh->positions[v]),
                                        lod_vec3_make(sphere->center[0], sphere->center[1], sphere->center[2])));
  return most;
}

static void sphere_of_a_cube_has_half_its_diagonal(void **state) {
  (void)state;
  struct lod_sphere sphere = sphere_of(lod_shape_cube(arena, 2));
  assert_true(sphere.radius >= sqrt(3) && sphere.radius < sqrt(3) * (1 + 1e-12));
  for (int k = 0; k < 3; k++)
    assert_true(fabs(sphere.center[k]) < 1e-12);
}

static void sphere_of_a_regular_triangle_is_its_circumcircle(void **state) {
  (void)state;
  float positions[3][3] = {{1, 0, 5}, {-0.5f, 0.8660254f, 5}, {-0.5f, -0.8660254f, 5}};
  struct lod_sphere sphere = sphere_of((struct lod_mesh){.vertex_count = 3, .positions = positions});
  assert_true(fabs(sphere.radius - 1) < 1e-6);
  assert_true(fabs(sphere.center[2] - 5) < 1e-6);
}

static void sphere_of_one_or_no_point_has_radius_zero(void **state) {
  (void)state;
  float positions[2][3] = {{1, 2, 3}, {1, 2, 3}};
  assert_true(sphere_of((struct lod_mesh){.vertex_count = 1, .positions = positions}).radius == 0);
  assert_true(sphere_of((struct lod_mesh){.vertex_count = 2, .positions = positions}).radius == 0);
  assert_true(sphere_of((struct lod_mesh){0}).radius == 0);
}

static void no_vertex_is_outside_and_the_ball_is_smallest(void **state) {
  (void)state;
  struct lod_mesh ball = lod_shape_sphere(arena, 2, 4);
  struct lod_sphere sphere = sphere_of(ball);
  assert_true(farthest(&ball, &sphere) <= sphere.radius && sphere.radius < 2 * (1 + 1e-6));
  for (uint64_t seed = 1; seed <= 50; seed++) {
    struct lod_mesh soup = lod_shape_soup(arena, 200, 0.1, seed);
    sphere = sphere_of(soup);
    assert_true(farthest(&soup, &sphere) <= sphere.radius);
    /* A ball is smallest when its centre lies in the hull of the points on it: no direction leads away from all of them. */
    struct lod_vec3 center = lod_vec3_make(sphere.center[0], sphere.center[1], sphere.center[2]);
    uint64_t random = seed;
    for (int trial = 0; trial < 200; trial++) {
      struct lod_vec3 d =
          lod_vec3_normalize(lod_vec3_make(lod_random_unit(&random) - 0.5, lod_random_unit(&random) - 0.5, lod_random_unit(&random) - 0.5));
      struct lod_vec3 moved = lod_vec3_add_scaled(center, d, 1e-3 * sphere.radius);
      struct lod_sphere other = {{moved.x, moved.y, moved.z}, 0};
      assert_true(farthest(&soup, &other) > sphere.radius * (1 - 1e-8));
    }
  }
}

static void two_instances_of_a_cube_are_both_enclosed(void **state) {
  (void)state;
  struct lod_unit unit = {.mesh = lod_shape_cube(arena, 2), .scale = 2};
  double instances[2][16];
  memcpy(instances[0], kIdentity, sizeof kIdentity);
  memcpy(instances[1], kIdentity, sizeof kIdentity);
  instances[1][0] = instances[1][5] = instances[1][10] = 2;
  instances[1][12] = 10;
  struct lod_part part = {.unit = 0, .instance_count = 2, .instances = instances};
  struct lod_model model = {.unit_count = 1, .part_count = 1, .units = &unit, .parts = &part};
  struct lod_bounds bounds = lod_model_bounds(&model);
  assert_true(bounds.min[0] == -1 && bounds.max[0] == 12 && bounds.min[1] == -2 && bounds.max[1] == 2);
  struct lod_sphere sphere = lod_model_sphere(&model);
  double big = sqrt((12 - sphere.center[0]) * (12 - sphere.center[0]) + 8),
         small = sqrt((sphere.center[0] + 1) * (sphere.center[0] + 1) + 2);
  assert_true(sphere.radius >= big * (1 - 1e-14) && sphere.radius >= small * (1 - 1e-14));
  assert_true(sphere.radius < 7);
}

static void parts_in_unit_0_are_visited_though_they_come_last(void **state) {
  (void)state;
  struct lod_unit units[2] = {{.mesh = lod_shape_cube(arena, 8), .scale = 1}, {.mesh = lod_shape_cube(arena, 2), .scale = 1}};
  double instances[2][16];
  memcpy(instances[0], kIdentity, sizeof kIdentity);
  memcpy(instances[1], kIdentity, sizeof kIdentity);
  instances[1][14] = 20;
  struct lod_part parts[3] = {{.unit = 1, .instance_count = 2, .instances = instances},
                              {.unit = 0, .instance_count = 1, .instances = instances},
                              {.unit = 0, .instance_count = 1, .instances = instances}};
  struct lod_model model = {.unit_count = 2, .part_count = 3, .units = units, .parts = parts};
  struct lod_bounds bounds = lod_model_bounds(&model);
  assert_true(bounds.min[2] == -4 && bounds.max[2] == 21 && bounds.max[0] == 4);
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(sphere_of_a_cube_has_half_its_diagonal),    CLAIM(sphere_of_a_regular_triangle_is_its_circumcircle),
      CLAIM(sphere_of_one_or_no_point_has_radius_zero), CLAIM(no_vertex_is_outside_and_the_ball_is_smallest),
      CLAIM(two_instances_of_a_cube_are_both_enclosed), CLAIM(parts_in_unit_0_are_visited_though_they_come_last),
  };
  return cmocka_run_group_tests_name("core/mesh/model", tests, NULL, NULL);
}
