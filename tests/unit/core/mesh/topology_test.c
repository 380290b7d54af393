#include "core/mesh/topology.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <string.h>

#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_topology measure(const struct lod_mesh *mesh) {
  struct lod_adjacency adjacency;
  struct lod_topology topology, again;
  memset(&topology, 0, sizeof topology);
  memset(&again, 0, sizeof again);
  assert_int_equal(lod_adjacency_create(mesh, arena, &adjacency), LOD_OK);
  assert_true(lod_adjacency_check(mesh, &adjacency));
  size_t before = lod_arena_bytes(arena);
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &topology), LOD_OK);
  assert_int_equal(lod_topology_measure(mesh, &adjacency, arena, &again), LOD_OK);
  assert_int_equal(lod_arena_bytes(arena), before);
  assert_int_equal(topology.euler, again.euler);
  assert_int_equal(topology.components, again.components);
  assert_int_equal(topology.non_manifold_vertices, again.non_manifold_vertices);
  return topology;
}

static struct lod_mesh soup_of(uint32_t vertices, uint32_t count, const uint32_t (*triangles)[3]) {
  struct lod_mesh mesh = lod_shape_soup(arena, vertices / 3 + 1, 0.5, 1);
  mesh.vertex_count = vertices;
  mesh.triangle_count = count;
  mesh.triangles = lod_arena_copy(arena, triangles, count * sizeof *triangles);
  return mesh;
}

static void cube_sphere_and_tube_are_closed_balls(void **state) {
  (void)state;
  struct lod_mesh shapes[3] = {lod_shape_cube(arena, 1), lod_shape_sphere(arena, 1, 3), lod_shape_tube(arena, 1, 4, 12, 3)};
  for (int i = 0; i < 3; i++) {
    struct lod_topology t = measure(&shapes[i]);
    assert_int_equal(t.vertices, shapes[i].vertex_count);
    assert_int_equal(t.edges * 2, shapes[i].triangle_count * 3);
    assert_true(t.closed && t.manifold && t.oriented && t.orientable && t.has_genus);
    assert_int_equal(t.euler, 2);
    assert_int_equal(t.genus, 0);
    assert_int_equal(t.components, 1);
    assert_int_equal(t.boundary_loops + t.zero_area_triangles + t.duplicate_triangles, 0);
  }
}

static void a_torus_has_genus_1_and_two_of_them_2(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 2, 0.5, 16, 8);
  assert_int_equal(measure(&torus).genus, 1);
  struct lod_mesh two = lod_shape_join(arena, &torus, &torus, (const double[3]){9, 0, 0});
  struct lod_topology t = measure(&two);
  assert_int_equal(t.genus, 2);
  assert_int_equal(t.components, 2);
  assert_int_equal(t.euler, 0);
}

static void a_grid_has_one_loop_and_with_a_hole_two(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 1, 6, 0);
  struct lod_topology t = measure(&grid);
  assert_int_equal(t.boundary_loops, 1);
  assert_int_equal(t.boundary_edges, 24);
  assert_false(t.closed);
  assert_int_equal(t.euler, 1);
  assert_int_equal(t.genus, 0);
  uint32_t cell = 2 * (2 * 6 + 2); /* take the two triangles of an inner square away */
  memmove(grid.triangles[cell], grid.triangles[cell + 2], (grid.triangle_count - cell - 2) * sizeof *grid.triangles);
  grid.triangle_count -= 2;
  t = measure(&grid);
  assert_int_equal(t.boundary_loops, 2);
  assert_int_equal(t.boundary_edges, 28);
  assert_int_equal(t.genus, 0);
}

static void two_triangles_that_meet_in_a_point_are_a_bow_tie(void **state) {
  (void)state;
  struct lod_mesh mesh = soup_of(5, 2, (const uint32_t[][3]){{0, 1, 2}, {0, 3, 4}});
  struct lod_topology t = measure(&mesh);
  assert_int_equal(t.non_manifold_vertices, 1);
  assert_int_equal(t.non_manifold_edges, 0);
  assert_int_equal(t.components, 1);
  assert_int_equal(t.boundary_loops, 1); /* connected through the point */
  assert_false(t.manifold || t.has_genus);
  struct lod_adjacency adjacency;
  assert_int_equal(lod_adjacency_create(&mesh, arena, &adjacency), LOD_OK);
  assert_int_equal(adjacency.fan_count, 6);
  assert_int_equal(adjacency.cut_vertices, 1);
  assert_int_equal(adjacency.fan_vertex[0], 0);
  assert_int_equal(adjacency.fan_vertex[1], 0);
}

static void three_triangles_on_one_edge_are_cut_there(void **state) {
  (void)state;
  struct lod_mesh mesh = soup_of(5, 3, (const uint32_t[][3]){{0, 1, 2}, {1, 0, 3}, {0, 1, 4}});
  struct lod_topology t = measure(&mesh);
  assert_int_equal(t.non_manifold_edges, 1);
  assert_int_equal(t.non_manifold_vertices, 0); /* they hang together by the edge */
  assert_int_equal(t.boundary_edges, 6);
  assert_false(t.oriented);
  assert_true(t.orientable);
  struct lod_adjacency adjacency;
  assert_int_equal(lod_adjacency_create(&mesh, arena, &adjacency), LOD_OK);
  for (uint32_t h = 0; h < 9; h++)
    assert_int_equal(adjacency.twin[h], LOD_NONE);
  assert_int_equal(adjacency.cut_vertices, 2);
  assert_int_equal(adjacency.fan_count, 9);
}

static void a_triangle_turned_over_is_misoriented_but_orientable(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  uint32_t swap = cube.triangles[4][0];
  cube.triangles[4][0] = cube.triangles[4][1];
  cube.triangles[4][1] = swap;
  struct lod_topology t = measure(&cube);
  assert_int_equal(t.misoriented_edges, 3);
  assert_true(t.orientable && t.manifold && t.closed);
  assert_false(t.oriented || t.has_genus);
}

static void a_moebius_strip_is_not_orientable(void **state) {
  (void)state;
  enum { N = 9 };
  uint32_t triangles[2 * N][3];
  for (uint32_t i = 0; i < N; i++) { /* rungs (2 i, 2 i + 1); the last is joined to the first upside down */
    uint32_t a = 2 * i, b = 2 * i + 1, c = i + 1 < N ? 2 * i + 2 : 1, d = i + 1 < N ? 2 * i + 3 : 0;
    const uint32_t two[2][3] = {{a, b, d}, {a, d, c}};
    memcpy(triangles[2 * i], two, sizeof two);
  }
  struct lod_mesh mesh = soup_of(2 * N, 2 * N, (const uint32_t(*)[3])triangles);
  struct lod_topology t = measure(&mesh);
  assert_true(t.manifold);
  assert_int_equal(t.boundary_loops, 1);
  assert_int_equal(t.misoriented_edges, 1);
  assert_false(t.oriented);
  assert_false(t.orientable);
  assert_int_equal(t.euler, 0);
}

static void doubled_and_degenerate_triangles_are_counted(void **state) {
  (void)state;
  struct lod_mesh mesh = soup_of(6, 7, (const uint32_t[][3]){{0, 1, 2}, {2, 0, 1}, {0, 2, 1}, {3, 3, 4}, {5, 5, 5}, {1, 3, 4}, {4, 1, 3}});
  struct lod_topology t = measure(&mesh);
  assert_int_equal(t.duplicate_triangles, 3);
  assert_int_equal(t.degenerate_triangles, 2);
  assert_int_equal(t.vertices, 6);
  assert_int_equal(t.edges, 6);
  assert_int_equal(t.euler, 5 - 6 + 5); /* vertex 5 is in a degenerate triangle alone */
}

static void needles_have_no_area(void **state) {
  (void)state;
  float positions[3][3] = {{0, 0, 0}, {1, 0, 0}, {0.5f, 1e-13f, 0}};
  uint32_t triangles[1][3] = {{0, 1, 2}};
  struct lod_mesh mesh = {.vertex_count = 3, .triangle_count = 1, .positions = positions, .triangles = triangles};
  assert_int_equal(measure(&mesh).zero_area_triangles, 1);
  positions[2][1] = 1e-5f;
  assert_int_equal(measure(&mesh).zero_area_triangles, 0);
}

static void the_empty_mesh_is_closed_and_has_nothing(void **state) {
  (void)state;
  struct lod_mesh empty = {0};
  struct lod_topology t = measure(&empty);
  assert_true(t.closed && t.manifold);
  assert_int_equal(t.components + t.edges + t.vertices, 0);
}

static void corners_around_an_inner_vertex_turn_counter_clockwise(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 2, 0);
  struct lod_adjacency adjacency;
  assert_int_equal(lod_adjacency_create(&grid, arena, &adjacency), LOD_OK);
  uint32_t begin = adjacency.vertex_begin[4], end = adjacency.vertex_begin[5];
  assert_int_equal(end - begin, 6); /* the middle of the grid */
  for (uint32_t i = begin; i < end; i++) {
    const float *p = grid.positions[lod_half_edge_end(&grid, adjacency.vertex_corners[i])];
    const float *q = grid.positions[lod_half_edge_end(&grid, adjacency.vertex_corners[i + 1 < end ? i + 1 : begin])];
    assert_true((double)p[0] * (double)q[1] - (double)p[1] * (double)q[0] > 0);
  }
  uint32_t first = adjacency.vertex_corners[adjacency.vertex_begin[1]]; /* the middle of the lower side: starts at its open end */
  assert_int_equal(lod_corner_right(&adjacency, first), LOD_NONE);
  assert_int_equal(lod_half_edge_end(&grid, first), 2);
}

/* Two thousand triangles around one edge's end: a bucket far larger than usual. */
static void a_fan_of_2000_triangles_is_one_fan(void **state) {
  (void)state;
  struct lod_mesh tube = lod_shape_tube(arena, 1, 1, 2000, 1);
  struct lod_adjacency adjacency;
  assert_int_equal(lod_adjacency_create(&tube, arena, &adjacency), LOD_OK);
  assert_true(lod_adjacency_check(&tube, &adjacency));
  assert_int_equal(adjacency.fan_count, tube.vertex_count);
  assert_int_equal(adjacency.cut_vertices + adjacency.boundary_edges, 0);
}

static void random_soups_of_few_vertices_keep_every_invariant(void **state) {
  (void)state;
  uint64_t seed = 9;
  for (int trial = 0; trial < 300; trial++) {
    uint32_t vertices = 4 + (uint32_t)(lod_random_next(&seed) % 12), count = (uint32_t)(lod_random_next(&seed) % 60), triangles[60][3];
    for (uint32_t t = 0; t < count; t++)
      for (int k = 0; k < 3; k++)
        triangles[t][k] = (uint32_t)(lod_random_next(&seed) % vertices);
    struct lod_mesh mesh = soup_of(vertices, count, (const uint32_t(*)[3])triangles);
    struct lod_topology t = measure(&mesh);
    assert_true(t.non_manifold_vertices <= vertices && t.components <= vertices);
  }
}

static void a_small_memory_limit_says_memory(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 5);
  struct lod_arena *small = lod_arena_create(100000);
  struct lod_adjacency adjacency;
  struct lod_topology topology;
  assert_int_equal(lod_adjacency_create(&sphere, small, &adjacency), LOD_MEMORY);
  assert_int_equal(lod_topology_measure(&sphere, NULL, small, &topology), LOD_MEMORY);
  lod_arena_destroy(small);
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(cube_sphere_and_tube_are_closed_balls),
      CLAIM(a_torus_has_genus_1_and_two_of_them_2),
      CLAIM(a_grid_has_one_loop_and_with_a_hole_two),
      CLAIM(two_triangles_that_meet_in_a_point_are_a_bow_tie),
      CLAIM(three_triangles_on_one_edge_are_cut_there),
      CLAIM(a_triangle_turned_over_is_misoriented_but_orientable),
      CLAIM(a_moebius_strip_is_not_orientable),
      CLAIM(doubled_and_degenerate_triangles_are_counted),
      CLAIM(needles_have_no_area),
      CLAIM(the_empty_mesh_is_closed_and_has_nothing),
      CLAIM(corners_around_an_inner_vertex_turn_counter_clockwise),
      CLAIM(a_fan_of_2000_triangles_is_one_fan),
      CLAIM(random_soups_of_few_vertices_keep_every_invariant),
      CLAIM(a_small_memory_limit_says_memory),
  };
  return cmocka_run_group_tests_name("core/mesh/topology", tests, NULL, NULL);
}
