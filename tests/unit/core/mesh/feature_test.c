#include "core/mesh/feature.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_adjacency adjacency;

/* Finds, and checks that lines hold every feature edge once, run along edges and break at corners alone. */
static struct lod_features find(const struct lod_mesh *mesh, const struct lod_feature_settings *settings) {
  struct lod_features f;
  assert_int_equal(lod_adjacency_create(mesh, arena, &adjacency), LOD_OK);
  assert_int_equal(lod_feature_find(mesh, &adjacency, settings, arena, &f), LOD_OK);
  uint32_t *seen = LOD_NEW_ZERO(arena, adjacency.edge_count, uint32_t), steps = 0;
  for (uint32_t l = 0; l < f.line_count; l++) {
    assert_true(f.line_begin[l + 1] >= f.line_begin[l] + 2);
    for (uint32_t i = f.line_begin[l] + 1; i < f.line_begin[l + 1]; i++, steps++) {
      uint32_t edge = LOD_NONE;
      for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
        uint32_t a = lod_half_edge_start(mesh, h), b = lod_half_edge_end(mesh, h), p = f.line_vertices[i - 1], q = f.line_vertices[i];
        if (adjacency.edge_of[h] != LOD_NONE && ((a == p && b == q) || (a == q && b == p)))
          edge = adjacency.edge_of[h];
      }
      assert_int_not_equal(edge, LOD_NONE);
      assert_int_equal(seen[edge]++, 0);
      assert_int_not_equal(f.edges[edge], 0);
      assert_int_equal(f.edges[edge] & f.line_flags[l], f.line_flags[l]);
      if (i + 1 < f.line_begin[l + 1])
        assert_false(f.corners[f.line_vertices[i]]);
    }
    uint32_t first = f.line_vertices[f.line_begin[l]], last = f.line_vertices[f.line_begin[l + 1] - 1];
    assert_true(first == last || (f.corners[first] && f.corners[last]));
  }
  assert_int_equal(steps, f.edge_count);
  return f;
}

static void a_cube_has_12_creases_and_8_corners(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  struct lod_features f = find(&cube, NULL);
  assert_int_equal(f.edge_count, 12);
  assert_int_equal(f.corner_count, 8);
  assert_int_equal(f.line_count, 12);
  for (uint32_t l = 0; l < 12; l++)
    assert_int_equal(f.line_flags[l], LOD_FEATURE_CREASE);
}

static void a_cube_turned_partly_inside_out_has_the_same_creases(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  for (uint32_t t = 0; t < 12; t += 3) {
    uint32_t swap = cube.triangles[t][0];
    cube.triangles[t][0] = cube.triangles[t][2];
    cube.triangles[t][2] = swap;
  }
  assert_int_equal(find(&cube, NULL).edge_count, 12);
}

static void a_sphere_is_smooth_and_a_fine_angle_finds_every_edge(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 2);
  struct lod_features f = find(&sphere, NULL);
  assert_int_equal(f.edge_count + f.line_count + f.corner_count, 0);
  struct lod_feature_settings settings = lod_feature_defaults();
  settings.crease_degrees = 0.1;
  assert_int_equal(find(&sphere, &settings).edge_count, 480);
}

static void a_tube_has_two_rims_that_go_around(void **state) {
  (void)state;
  struct lod_mesh tube = lod_shape_tube(arena, 1, 2, 24, 3);
  struct lod_features f = find(&tube, NULL);
  assert_int_equal(f.edge_count, 48);
  assert_int_equal(f.line_count, 2);
  assert_int_equal(f.corner_count, 0);
  assert_int_equal(f.line_vertices[f.line_begin[0]], f.line_vertices[f.line_begin[1] - 1]);
}

static void an_open_square_has_four_boundary_lines(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 1, 5, 0);
  struct lod_features f = find(&grid, NULL);
  assert_int_equal(f.edge_count, 20);
  assert_int_equal(f.corner_count, 4);
  assert_int_equal(f.line_count, 4);
  assert_true(f.corners[0] && f.corners[5] && f.corners[30] && f.corners[35]);
  struct lod_feature_settings settings = lod_feature_defaults();
  settings.corner_degrees = 100;
  f = find(&grid, &settings);
  assert_int_equal(f.line_count, 1);
  settings.flags &= ~(uint32_t)LOD_FEATURE_BOUNDARY;
  assert_int_equal(find(&grid, &settings).edge_count, 0);
}

static void a_material_border_down_the_middle_is_one_line(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 1, 4, 0);
  grid.materials = LOD_NEW_ZERO(arena, grid.triangle_count, uint32_t);
  for (uint32_t t = 0; t < grid.triangle_count; t++)
    grid.materials[t] = t / 2 % 4 < 2 ? 3 : LOD_NONE;
  struct lod_features f = find(&grid, NULL);
  uint32_t lines = 0;
  for (uint32_t l = 0; l < f.line_count; l++)
    if (f.line_flags[l] == LOD_FEATURE_MATERIAL) {
      lines++;
      assert_int_equal(f.line_begin[l + 1] - f.line_begin[l], 5);
    }
  assert_int_equal(lines, 1);
  assert_int_equal(f.corner_count, 6); /* the square's four and the border's two ends */
  grid.parts = grid.materials;
  grid.materials = NULL;
  assert_int_equal(find(&grid, NULL).line_count, f.line_count);
}

static void a_texture_torn_along_a_row_is_a_seam_there_alone(void **state) {
  (void)state;
  enum { N = 4, ROW = N + 1 };
  struct lod_mesh grid = lod_shape_grid(arena, 1, N, 0);
  uint32_t old = grid.wedge_count, more = old + ROW;
  uint32_t *wedge_vertex = LOD_NEW(arena, more, uint32_t);
  float(*uv)[2] = lod_arena_alloc(arena, more, sizeof *uv);
  memcpy(wedge_vertex, grid.wedge_vertex, old * sizeof *wedge_vertex);
  memcpy(uv, grid.uvs[0], old * sizeof *uv);
  for (uint32_t i = 0; i < ROW; i++) { /* the middle row again, elsewhere in the texture but for its first vertex */
    wedge_vertex[old + i] = 2 * ROW + i;
    uv[old + i][0] = uv[2 * ROW + i][0] + (i == 0 ? 0 : 0.5f);
    uv[old + i][1] = uv[2 * ROW + i][1];
  }
  for (uint32_t t = grid.triangle_count / 2; t < grid.triangle_count; t++)
    for (int c = 0; c < 3; c++)
      if (grid.corners[t][c] / ROW == 2)
        grid.corners[t][c] += old - 2 * ROW;
  grid.wedge_vertex = wedge_vertex;
  grid.uvs[0] = uv;
  grid.wedge_count = more;
  assert_true(lod_mesh_check(&grid, NULL));
  struct lod_features f = find(&grid, NULL);
  uint32_t seams = 0;
  for (uint32_t e = 0; e < adjacency.edge_count; e++)
    seams += (f.edges[e] & LOD_FEATURE_UV_SEAM) != 0;
  assert_int_equal(seams, N);
}

static void a_fold_of_39_degrees_is_no_crease_and_of_41_is(void **state) {
  (void)state;
  for (int i = 0; i < 2; i++) {
    double angle = (i == 0 ? 39 : 41) * 3.14159265358979 / 180;
    float positions[4][3] = {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {(float)-cos(angle), 0, (float)-sin(angle)}};
    uint32_t triangles[2][3] = {{0, 2, 1}, {0, 1, 3}};
    struct lod_mesh mesh = {.vertex_count = 4, .triangle_count = 2, .positions = positions, .triangles = triangles};
    struct lod_features f = find(&mesh, NULL);
    assert_int_equal(f.edge_count, 4 + i);
    assert_int_equal(f.degree[0], 2 + i);
  }
}

static void three_sheets_on_an_edge_make_it_a_line_of_its_own(void **state) {
  (void)state;
  float positions[5][3] = {{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {-1, 1, 0}, {-1, -1, 0}};
  uint32_t triangles[3][3] = {{0, 1, 2}, {0, 1, 3}, {0, 1, 4}};
  struct lod_mesh mesh = {.vertex_count = 5, .triangle_count = 3, .positions = positions, .triangles = triangles};
  struct lod_features f = find(&mesh, NULL);
  uint32_t lines = 0;
  for (uint32_t l = 0; l < f.line_count; l++)
    lines += f.line_flags[l] == LOD_FEATURE_NON_MANIFOLD;
  assert_int_equal(lines, 1);
  assert_int_equal(f.degree[0], 4);
}

static void random_soups_string_every_edge_once(void **state) {
  (void)state;
  uint64_t seed = 21;
  for (int trial = 0; trial < 100; trial++) {
    struct lod_mesh mesh = lod_shape_soup(arena, 14, 0.5, seed);
    mesh.vertex_count = 9;
    for (uint32_t t = 0; t < mesh.triangle_count; t++)
      for (int k = 0; k < 3; k++)
        mesh.triangles[t][k] = (uint32_t)(lod_random_next(&seed) % 9);
    find(&mesh, NULL);
  }
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(a_cube_has_12_creases_and_8_corners),
      CLAIM(a_cube_turned_partly_inside_out_has_the_same_creases),
      CLAIM(a_sphere_is_smooth_and_a_fine_angle_finds_every_edge),
      CLAIM(a_tube_has_two_rims_that_go_around),
      CLAIM(an_open_square_has_four_boundary_lines),
      CLAIM(a_material_border_down_the_middle_is_one_line),
      CLAIM(a_texture_torn_along_a_row_is_a_seam_there_alone),
      CLAIM(a_fold_of_39_degrees_is_no_crease_and_of_41_is),
      CLAIM(three_sheets_on_an_edge_make_it_a_line_of_its_own),
      CLAIM(random_soups_string_every_edge_once),
  };
  return cmocka_run_group_tests_name("core/mesh/feature", tests, NULL, NULL);
}
