#include "core/mesh/mesh.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

/* Every triangle with vertices of its own, as an STL file has it. */
static struct lod_mesh explode(const struct lod_mesh *mesh) {
  struct lod_mesh out = {.vertex_count = 3 * mesh->triangle_count, .triangle_count = mesh->triangle_count};
  out.positions = lod_arena_alloc(arena, out.vertex_count, sizeof *out.positions);
  out.triangles = lod_arena_alloc(arena, out.triangle_count, sizeof *out.triangles);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (uint32_t c = 0; c < 3; c++) {
      memcpy(out.positions[3 * t + c], mesh->positions[mesh->triangles[t][c]], sizeof *out.positions);
      out.triangles[t][c] = 3 * t + c;
    }
  return out;
}

static void cube_of_side_2_has_bounds_1_and_diagonal_2_sqrt_3(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  struct lod_bounds bounds = lod_mesh_bounds(&cube);
  for (int k = 0; k < 3; k++) {
    assert_true(bounds.min[k] == -1);
    assert_true(bounds.max[k] == 1);
  }
  assert_true(fabs(lod_bounds_diagonal(&bounds) - 2 * sqrt(3)) < 1e-15);
  assert_true(lod_mesh_magnitude(&cube) == 1);
}

static void empty_mesh_is_valid_and_has_zero_bounds(void **state) {
  (void)state;
  struct lod_mesh empty = {0}, welded;
  assert_true(lod_mesh_check(&empty, NULL));
  struct lod_bounds bounds = lod_mesh_bounds(&empty);
  assert_true(bounds.min[0] == 0 && bounds.max[2] == 0 && lod_mesh_magnitude(&empty) == 0);
  assert_int_equal(lod_mesh_weld(&empty, arena, &welded, NULL), LOD_OK);
  assert_int_equal(welded.vertex_count, 0);
  assert_true(lod_mesh_check(&welded, NULL));
}

static void check_names_the_triangle_with_an_index_beyond_the_vertices(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  cube.triangles[7][1] = 8;
  struct lod_problem problem = {0};
  assert_false(lod_mesh_check(&cube, &problem));
  assert_string_equal(problem.type, "index-out-of-range");
  assert_non_null(strstr(problem.detail, "triangle 7"));
}

static void check_names_the_vertex_that_is_not_finite(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  cube.positions[3][2] = INFINITY;
  struct lod_problem problem = {0};
  assert_false(lod_mesh_check(&cube, &problem));
  assert_non_null(strstr(problem.detail, "vertex 3"));
  cube.positions[3][2] = NAN;
  assert_false(lod_mesh_check(&cube, NULL));
}

static void check_finds_a_corner_whose_wedge_belongs_to_another_vertex(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 1, 4, 0);
  assert_true(lod_mesh_check(&grid, NULL));
  grid.corners[5][0] = grid.corners[5][1];
  struct lod_problem problem = {0};
  assert_false(lod_mesh_check(&grid, &problem));
  assert_string_equal(problem.type, "wedge-of-other-vertex");
}

static void check_finds_missing_arrays_and_bad_edges_points_and_thickness(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  uint32_t edge[1][2] = {{0, 7}}, point[1] = {3};
  float thickness[1] = {0.5f};
  cube.edge_count = cube.point_count = 1;
  assert_false(lod_mesh_check(&cube, NULL));
  cube.edges = edge;
  cube.points = point;
  cube.edge_thickness = cube.point_thickness = thickness;
  assert_true(lod_mesh_check(&cube, NULL));
  edge[0][1] = 8;
  assert_false(lod_mesh_check(&cube, NULL));
  edge[0][1] = 7;
  point[0] = 9;
  assert_false(lod_mesh_check(&cube, NULL));
  point[0] = 0;
  thickness[0] = -1;
  assert_false(lod_mesh_check(&cube, NULL));
}

static void welding_36_loose_corners_of_a_cube_gives_8_vertices(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 2), loose = explode(&cube), welded;
  uint32_t *map;
  assert_int_equal(lod_mesh_weld(&loose, arena, &welded, &map), LOD_OK);
  assert_int_equal(welded.vertex_count, 8);
  assert_int_equal(welded.triangle_count, 12);
  assert_true(lod_mesh_check(&welded, NULL));
  for (uint32_t v = 0; v < loose.vertex_count; v++)
    assert_memory_equal(loose.positions[v], welded.positions[map[v]], sizeof *welded.positions);
}

static void welding_a_loose_sphere_gives_its_vertices_back_in_order_of_first_use(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 3, 5), loose = explode(&sphere), welded;
  assert_int_equal(lod_mesh_weld(&loose, arena, &welded, NULL), LOD_OK);
  assert_int_equal(welded.vertex_count, sphere.vertex_count);
  uint32_t next = 0;
  for (uint32_t t = 0; t < welded.triangle_count; t++)
    for (int c = 0; c < 3; c++) {
      assert_true(welded.triangles[t][c] <= next);
      next += welded.triangles[t][c] == next;
      for (int k = 0; k < 3; k++)
        assert_true(welded.positions[welded.triangles[t][c]][k] == sphere.positions[sphere.triangles[t][c]][k]);
    }
}

static void minus_zero_is_zero_and_a_degenerate_triangle_stays(void **state) {
  (void)state;
  float positions[4][3] = {{0, 0, 0}, {-0.0f, 0, -0.0f}, {1, 0, 0}, {9, 9, 9}};
  uint32_t triangles[1][3] = {{1, 0, 2}};
  struct lod_mesh mesh = {.vertex_count = 4, .triangle_count = 1, .positions = positions, .triangles = triangles}, welded;
  uint32_t *map;
  assert_int_equal(lod_mesh_weld(&mesh, arena, &welded, &map), LOD_OK);
  assert_int_equal(welded.vertex_count, 2);
  assert_int_equal(welded.triangle_count, 1);
  assert_int_equal(welded.triangles[0][0], welded.triangles[0][1]);
  assert_false(signbit(welded.positions[0][0]) || signbit(welded.positions[0][2]));
  assert_int_equal(map[3], LOD_NONE);
}

static void a_uv_seam_keeps_two_wedges_at_one_vertex_and_equal_wedges_become_one(void **state) {
  (void)state;
  /* Two triangles that share the edge (0,0,0)-(0,1,0); the texture is torn at (0,1,0) only. */
  float positions[6][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 0}, {0, 1, 0}, {-1, 0, 0}};
  float uvs[6][2] = {{0, 0}, {1, 0}, {0, 1}, {0, 0}, {0.5f, 1}, {0, 0.5f}};
  uint32_t triangles[2][3] = {{0, 1, 2}, {3, 4, 5}}, wedge_vertex[6] = {0, 1, 2, 3, 4, 5};
  struct lod_mesh mesh = {.vertex_count = 6, .triangle_count = 2, .wedge_count = 6, .positions = positions, .triangles = triangles};
  mesh.corners = triangles;
  mesh.wedge_vertex = wedge_vertex;
  mesh.uvs[1] = uvs;
  struct lod_mesh welded;
  assert_int_equal(lod_mesh_weld(&mesh, arena, &welded, NULL), LOD_OK);
  assert_int_equal(welded.vertex_count, 4);
  assert_int_equal(welded.wedge_count, 5);
  assert_true(lod_mesh_check(&welded, NULL));
  assert_null(welded.uvs[0]);
  for (uint32_t t = 0; t < 2; t++)
    for (int c = 0; c < 3; c++)
      assert_memory_equal(welded.uvs[1][welded.corners[t][c]], uvs[triangles[t][c]], sizeof *uvs);
}

static void welding_keeps_edges_points_and_tags(void **state) {
  (void)state;
  float positions[6][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 0, 0}, {5, 5, 5}, {5, 5, 5}};
  uint32_t triangles[1][3] = {{0, 1, 2}}, edges[1][2] = {{3, 4}}, points[1] = {5}, material[1] = {7}, part[1] = {2};
  float thickness[1] = {0.25f};
  struct lod_mesh mesh = {.vertex_count = 6, .triangle_count = 1, .edge_count = 1, .point_count = 1, .positions = positions};
  mesh.triangles = triangles;
  mesh.edges = edges;
  mesh.points = points;
  mesh.materials = mesh.edge_materials = mesh.point_materials = material;
  mesh.parts = mesh.edge_parts = mesh.point_parts = part;
  mesh.edge_thickness = mesh.point_thickness = thickness;
  struct lod_mesh welded;
  assert_int_equal(lod_mesh_weld(&mesh, arena, &welded, NULL), LOD_OK);
  assert_int_equal(welded.vertex_count, 4);
  assert_int_equal(welded.edges[0][0], welded.triangles[0][1]);
  assert_int_equal(welded.edges[0][1], welded.points[0]);
  assert_true(welded.materials[0] == 7 && welded.edge_materials[0] == 7 && welded.point_materials[0] == 7);
  assert_true(welded.parts[0] == 2 && welded.edge_parts[0] == 2 && welded.point_parts[0] == 2);
  assert_true(welded.edge_thickness[0] == 0.25f && welded.point_thickness[0] == 0.25f);
}

static void welding_under_a_small_memory_limit_says_memory(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 5), loose = explode(&sphere), welded;
  struct lod_arena *small = lod_arena_create(300000);
  assert_int_equal(lod_mesh_weld(&loose, small, &welded, NULL), LOD_MEMORY);
  lod_arena_destroy(small);
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(cube_of_side_2_has_bounds_1_and_diagonal_2_sqrt_3),
      CLAIM(empty_mesh_is_valid_and_has_zero_bounds),
      CLAIM(check_names_the_triangle_with_an_index_beyond_the_vertices),
      CLAIM(check_names_the_vertex_that_is_not_finite),
      CLAIM(check_finds_a_corner_whose_wedge_belongs_to_another_vertex),
      CLAIM(check_finds_missing_arrays_and_bad_edges_points_and_thickness),
      CLAIM(welding_36_loose_corners_of_a_cube_gives_8_vertices),
      CLAIM(welding_a_loose_sphere_gives_its_vertices_back_in_order_of_first_use),
      CLAIM(minus_zero_is_zero_and_a_degenerate_triangle_stays),
      CLAIM(a_uv_seam_keeps_two_wedges_at_one_vertex_and_equal_wedges_become_one),
      CLAIM(welding_keeps_edges_points_and_tags),
      CLAIM(welding_under_a_small_memory_limit_says_memory),
  };
  return cmocka_run_group_tests_name("core/mesh/mesh", tests, NULL, NULL);
}
