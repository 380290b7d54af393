#include "tests/data/arena.h"
#include "tests/data/shapes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>

/* By the divergence theorem: the volume of a closed, outward oriented mesh; 0 area vectors sum for closedness. */
static double volume(const struct lod_mesh *mesh) {
  double sum = 0;
  struct lod_vec3 area = {0, 0, 0};
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 a = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
    struct lod_vec3 b = lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]);
    struct lod_vec3 c = lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]);
    sum += lod_vec3_dot(a, lod_vec3_cross(b, c)) / 6;
    area = lod_vec3_add(area, lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
  }
  assert_true(lod_vec3_length(area) < 1e-4);
  assert_true(lod_mesh_check(mesh, NULL));
  return sum;
}

static void closed_shapes_have_their_volume_and_look_outward(void **state) {
  (void)state;
  const double pi = 3.14159265358979;
  struct lod_mesh cube = lod_shape_cube(arena, 2), sphere = lod_shape_sphere(arena, 1, 5), torus = lod_shape_torus(arena, 2, 0.5, 200, 100),
                  tube = lod_shape_tube(arena, 1, 3, 400, 2);
  assert_int_equal(cube.vertex_count, 8);
  assert_true(fabs(volume(&cube) - 8) < 1e-9);
  assert_int_equal(sphere.triangle_count, 20480);
  assert_true(fabs(volume(&sphere) - 4 * pi / 3) < 0.01);
  assert_int_equal(torus.triangle_count, 40000);
  assert_true(fabs(volume(&torus) - 2 * pi * pi * 2 * 0.25) < 0.02);
  assert_true(fabs(volume(&tube) - 3 * pi) < 0.01);
}

static void tree_of_4_generations_has_40_branches_and_the_pot_widens_it(void **state) {
  (void)state;
  struct lod_mesh bare = lod_shape_tree(arena, 4, false), potted = lod_shape_tree(arena, 4, true);
  assert_int_equal(bare.triangle_count, 40 * 48);
  assert_true(volume(&bare) > 0);
  assert_true(volume(&potted) > volume(&bare) + 2);
  struct lod_bounds a = lod_mesh_bounds(&bare), b = lod_mesh_bounds(&potted);
  assert_true(a.min[2] == 0 && b.min[2] == -0.5 && a.max[2] == b.max[2]);
}

static void grid_has_corners_uvs_and_bump(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 8, 0.25);
  assert_true(lod_mesh_check(&grid, NULL));
  assert_int_equal(grid.triangle_count, 128);
  struct lod_bounds bounds = lod_mesh_bounds(&grid);
  assert_true(bounds.min[0] == -1 && bounds.max[1] == 1 && bounds.max[2] == 0.25 && bounds.min[2] == -0.25);
  assert_true(grid.uvs[0][80][0] == 1 && grid.uvs[0][80][1] == 1);
}

static void soup_repeats_for_its_seed_and_stays_in_the_unit_cube(void **state) {
  (void)state;
  struct lod_mesh a = lod_shape_soup(arena, 1000, 0.1, 7), b = lod_shape_soup(arena, 1000, 0.1, 7), c = lod_shape_soup(arena, 1000, 0.1, 8);
  assert_memory_equal(a.positions, b.positions, a.vertex_count * sizeof *a.positions);
  assert_memory_not_equal(a.positions, c.positions, a.vertex_count * sizeof *a.positions);
  struct lod_bounds bounds = lod_mesh_bounds(&a);
  for (int k = 0; k < 3; k++)
    assert_true(bounds.min[k] >= 0 && bounds.max[k] <= 1);
}

static void join_moves_the_second_mesh(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  struct lod_mesh two = lod_shape_join(arena, &cube, &cube, (const double[3]){5, 0, 0});
  struct lod_bounds bounds = lod_mesh_bounds(&two);
  assert_int_equal(two.triangle_count, 24);
  assert_true(bounds.min[0] == -1 && bounds.max[0] == 6);
  assert_true(fabs(volume(&two) - 16) < 1e-6);
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(closed_shapes_have_their_volume_and_look_outward),
      CLAIM(tree_of_4_generations_has_40_branches_and_the_pot_widens_it),
      CLAIM(grid_has_corners_uvs_and_bump),
      CLAIM(soup_repeats_for_its_seed_and_stays_in_the_unit_cube),
      CLAIM(join_moves_the_second_mesh),
  };
  return cmocka_run_group_tests_name("tests/data/shapes", tests, NULL, NULL);
}
