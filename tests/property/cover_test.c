/* What every cover promises, on meshes that try to break it, with each kind of offset surfaces: within epsilon both ways, measured afresh;
 * the same topology; vertices of the source; no crossing that was not there. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "core/envelope/cover.h"
#include "core/mesh/distance.h"
#include "core/mesh/intersect.h"
#include "core/mesh/topology.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static void check_result(struct lod_arena *arena, const struct lod_mesh *mesh, const struct lod_cover *cover, double epsilon) {
  struct lod_mesh result;
  uint32_t *vertex_of = LOD_NEW(arena, mesh->vertex_count, uint32_t), *nearby = LOD_NEW(arena, mesh->triangle_count, uint32_t);
  assert_int_equal(lod_cover_extract(cover, arena, &result, vertex_of, nearby), LOD_OK);
  assert_true(lod_mesh_check(&result, NULL));
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (vertex_of[v] != LOD_NONE)
      assert_memory_equal(mesh->positions[v], result.positions[vertex_of[v]], sizeof *mesh->positions);
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.threads = 1;
  settings.hint_ab = nearby;
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(mesh, &result, &settings, arena, &distance), LOD_OK);
  assert_true(distance.two_sided.lower <= epsilon * (1 + 1e-9));
  assert_true(distance.two_sided.upper <= epsilon * 1.02);
  struct lod_topology before, after;
  struct lod_crossings crossings_before, crossings_after;
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &before), LOD_OK);
  assert_int_equal(lod_topology_measure(&result, NULL, arena, &after), LOD_OK);
  assert_int_equal(before.components, after.components);
  assert_int_equal(before.boundary_loops, after.boundary_loops);
  assert_int_equal(before.euler, after.euler);
  assert_int_equal(before.manifold, after.manifold);
  assert_int_equal(after.duplicate_triangles + after.non_manifold_edges + after.misoriented_edges + after.degenerate_triangles, 0);
  assert_int_equal(lod_intersect_count(mesh, NULL, arena, NULL, &crossings_before), LOD_OK);
  assert_int_equal(lod_intersect_count(&result, NULL, arena, NULL, &crossings_after), LOD_OK);
  if (crossings_before.pairs == 0)
    assert_int_equal(crossings_after.pairs, 0);
}

static uint32_t cover(struct lod_arena *arena, const struct lod_mesh *mesh, enum lod_cover_offsets offsets, bool vertices_only,
                      double share) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double epsilon = share * lod_bounds_diagonal(&bounds);
  struct lod_cover_settings settings = lod_cover_defaults();
  settings.offsets = offsets;
  settings.vertices_only = vertices_only;
  struct lod_bvh *bvh;
  struct lod_cover *c;
  struct lod_problem problem = {0};
  assert_int_equal(lod_bvh_create(mesh, 1, arena, &bvh), LOD_OK);
  assert_int_equal(lod_cover_create(mesh, bvh, &settings, arena, &c, &problem), LOD_OK);
  assert_int_equal(lod_cover_run(c, epsilon, NULL), LOD_OK);
  check_result(arena, mesh, c, epsilon);
  return lod_cover_triangle_count(c);
}

/* At small and large epsilon, in all modes. */
static void cover_all(struct lod_mesh (*make)(struct lod_arena *arena)) {
  static const double kShares[] = {0.002, 0.02, 0.08};
  for (int i = 0; i < 3; i++)
    for (int mode = 0; mode < 4; mode++) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_mesh mesh = make(arena);
      uint32_t triangles = cover(arena, &mesh, mode == 3 ? LOD_COVER_NO_OFFSETS : (enum lod_cover_offsets)mode, mode == 3, kShares[i]);
      assert_true(triangles <= mesh.triangle_count);
      if (i > 0 && mode == 0) /* it does something */
        assert_true(triangles < 0.8 * mesh.triangle_count);
      lod_arena_destroy(arena);
    }
}

static struct lod_mesh torus(struct lod_arena *arena) {
  return lod_shape_torus(arena, 1, 0.35, 20, 10);
}

static struct lod_mesh bumpy_grid(struct lod_arena *arena) {
  return lod_shape_grid(arena, 1, 13, 0.15);
}

static struct lod_mesh spikes(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 2);
  uint64_t seed = 7;
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    float scale = (float)(v % 9 == 0 ? 1 + 2 * lod_random_unit(&seed) : 1 + 0.02 * lod_random_unit(&seed));
    for (int k = 0; k < 3; k++)
      mesh.positions[v][k] *= scale;
  }
  return mesh;
}

static struct lod_mesh thin_sheets(struct lod_arena *arena) {
  struct lod_mesh sheet = lod_shape_grid(arena, 1, 9, 0.1), other = lod_shape_grid(arena, 1, 7, 0.1);
  return lod_shape_join(arena, &sheet, &other, (const double[3]){0.003, 0.002, 0.05});
}

static struct lod_mesh nested_shells(struct lod_arena *arena) {
  struct lod_mesh shell = lod_shape_sphere(arena, 1, 2), inner = lod_shape_sphere(arena, 0.9, 1);
  return lod_shape_join(arena, &shell, &inner, (const double[3]){0, 0, 0});
}

static struct lod_mesh needles(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_grid(arena, 1, 10, 0.2);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    mesh.positions[v][0] *= 1000;
    mesh.positions[v][1] *= 0.01f;
  }
  return mesh;
}

static struct lod_mesh noisy_torus(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_torus(arena, 1, 0.35, 18, 9);
  uint64_t seed = 21;
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    for (int k = 0; k < 3; k++)
      mesh.positions[v][k] += (float)(0.02 * lod_random_unit(&seed));
  return mesh;
}

/* Hexagonal fans joined at their rims only by a vertex: bow ties stay. */
static struct lod_mesh bow_tie(struct lod_arena *arena) {
  struct lod_mesh mesh = {.vertex_count = 15};
  mesh.positions = lod_arena_calloc(arena, 15, sizeof *mesh.positions);
  mesh.triangles = lod_arena_calloc(arena, 12, sizeof *mesh.triangles);
  for (int fan = 0; fan < 2; fan++) {
    uint32_t hub = fan == 0 ? 0 : 7;
    for (uint32_t i = 0; i < 6; i++) {
      float *p = mesh.positions[hub + 1 + i];
      p[0] = (float)(cos(1.0471975512 * i) + (fan == 0 ? 0 : 2));
      p[1] = (float)sin(1.0471975512 * i);
    }
    mesh.positions[hub][0] = fan == 0 ? 0 : 2;
    for (uint32_t i = 0; i < 6; i++) {
      uint32_t *t = mesh.triangles[mesh.triangle_count++], a = hub + 1 + i, b = hub + 1 + (i + 1) % 6;
      t[0] = hub;
      t[1] = fan == 1 && i == 3 ? 1 : a; /* the second fan's westernmost vertex is the first one's easternmost */
      t[2] = fan == 1 && (i + 1) % 6 == 3 ? 1 : b;
    }
  }
  return mesh;
}

static void closed_and_open_shapes(void **state) {
  (void)state;
  cover_all(torus);
  cover_all(bumpy_grid);
}

static void spiky_noisy_and_thin_triangles(void **state) {
  (void)state;
  cover_all(spikes);
  cover_all(noisy_torus);
  cover_all(needles);
}

static void sheets_and_shells(void **state) {
  (void)state;
  cover_all(thin_sheets);
  cover_all(nested_shells);
}

static void a_bow_tie_stays_one(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = bow_tie(arena);
  for (int mode = 0; mode < 3; mode++)
    assert_in_range(cover(arena, &mesh, (enum lod_cover_offsets)mode, false, 0.01), 2, 10);
  lod_arena_destroy(arena);
}

static void parts_of_the_corpus(void **state) {
  (void)state;
  static const char *const kParts[] = {"cad/joint-cgal", "cad/rotor-cgal", "thin/cactus-cgal"};
  for (int i = 0; i < 3 && lod_shared_folder() != NULL; i++) {
    char path[512];
    struct lod_mesh raw, mesh;
    struct lod_arena *arena = lod_arena_create(0);
    snprintf(path, sizeof path, "%s/models/%s.ply", lod_shared_folder(), kParts[i]);
    if (lod_ply_read(path, arena, &raw)) {
      assert_int_equal(lod_mesh_weld(&raw, arena, &mesh, NULL), LOD_OK);
      (void)cover(arena, &mesh, LOD_COVER_NO_OFFSETS, false, 0.005);
      (void)cover(arena, &mesh, LOD_COVER_APART_OFFSETS, false, 0.01);
    }
    lod_arena_destroy(arena);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(closed_and_open_shapes), cmocka_unit_test(spiky_noisy_and_thin_triangles),
      cmocka_unit_test(sheets_and_shells),      cmocka_unit_test(a_bow_tie_stays_one),
      cmocka_unit_test(parts_of_the_corpus),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
