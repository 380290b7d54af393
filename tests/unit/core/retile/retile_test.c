/* Re-tiling on meshes that one can draw. Turk 1992, line by line:
 * P1-1  polygons with holes: polygon_with_holes_has_k_plus_2n_minus_2_plus_2h; edges of three: tiny_and_broken_meshes_come_through;
 * triangles twice and turned over: wall_with_two_sides_keeps_both, patches_turned_over_are_turned_back P1-2
 * sphere_levels_are_nested_and_near, torus_keeps_its_hole (the least possible)      P1-3  assert_nested, everywhere; property test P1-4
 * cube_stays_a_cube                                                  P1-5, P1-6, P1-7, P1-8, P1-9  turks_own_mode_keeps_topology_too P1-10
 * border_of_an_open_sheet_stays_its_border                           P1-11, P1-12, P1-13  tests/unit/core/mesh/curvature_test.c P1-14,
 * P1-15  curvature_takes_points_to_where_the_surface_bends          P1-16  pictures, tests/unit/codec/export P1-17
 * square_with_n_points_becomes_2n_plus_2_triangles, polygon_with_holes...; points_on_an_edge_are_seen_from_both_sides P1-18
 * every_way_to_fill_keeps_topology: greedy by length in space, largest least angle, least cost, for the holes that vertices leave. The
 *       mutual tessellation itself is Delaunay in every mode: none of its edges outlives the removal of the old vertices by that
 * P1-19 tests/unit/core/mesh/triangulate_test.c                            P1-20 points_on_an_edge_are_seen_from_both_sides
 * P1-21, P1-22  every_way_to_fill_keeps_topology (14 planes, else the vertex stays)     P1-23 neck_of_three_triangles_stays_open
 * P1-24 retained shares: make bench-retile; turks_own_mode_keeps_topology_too
 *       the least possible: surface_of_many_handles_is_mapped_whole
 * P1-25 clean-up passes are flips of all edges of each star, with both checks and the mode's measure: settings.flips
 * P1-26 border_of_an_open_sheet_stays_its_border; corners by angle and by lines that meet
 * P1-27 sheets_back_to_back_stay_apart (2a), assert_same_topology's duplicate_triangles (2b), sharp_tip_stays_sharp
 * P1-28 to P1-33  nested levels: assert_nested; fragments: assert_mapped, tests/property/overlay_test.c, tests/property/retile_test.c
 * P1-34 figures 1, 4, 11, 12 in kind: make bench-figures, core/retile/FIGURES.md; costas_surface_has_levels_of_200_800_and_3200,
 *       points_where_it_bends_lower_the_error_of_a_dose
 * P1-35 anisotropy_lowers_the_error_of_a_bent_sheet                        P1-36 curvature tensor: curvature_test.c
 * P1-37 error_leads_vertices_to_a_spike, errors_asked_for_are_proven       P1-38 small_pieces_go_on_request
 * P1-39 a client's matter: clients/web */
#include "core/retile/retile.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/curvature.h"
#include "core/mesh/distance.h"
#include "core/mesh/overlay.h"
#include "core/mesh/topology.h"
#include "core/mesh/triangulate.h"
#include "tests/data/arena.h"
#include "tests/data/figures.h"
#include "tests/data/shapes.h"

static struct lod_retile retile(const struct lod_mesh *mesh, const uint32_t *counts, uint32_t count) {
  struct lod_retile result;
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = count;
  assert_int_equal(lod_retile_create(mesh, &settings, NULL, arena, &result, NULL), LOD_OK);
  return result;
}

static struct lod_topology topology_of(const struct lod_mesh *mesh) {
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &topology), LOD_OK);
  return topology;
}

static void assert_same_topology(const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_topology x = topology_of(a), y = topology_of(b);
  assert_int_equal(x.euler, y.euler);
  assert_int_equal(x.components, y.components);
  assert_int_equal(x.boundary_loops, y.boundary_loops);
  assert_int_equal(x.non_manifold_edges, y.non_manifold_edges);
  assert_int_equal(x.misoriented_edges, y.misoriented_edges);
  assert_int_equal(y.degenerate_triangles, 0);
  assert_int_equal(y.duplicate_triangles, 0);
}

static double distance_of(const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_distance distance;
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.absolute = 1e-6;
  assert_int_equal(lod_distance_measure(a, b, &settings, arena, &distance), LOD_OK);
  return distance.two_sided.upper;
}

/* Every level: a mesh, with the source's topology, the finer level's vertices, and a map that puts each finer vertex onto a triangle. */
static void assert_nested(const struct lod_mesh *source, const struct lod_retile *result) {
  for (uint32_t k = 0; k < result->level_count; k++) {
    const struct lod_retile_level *level = &result->levels[k];
    assert_true(lod_mesh_check(&level->mesh, NULL));
    assert_same_topology(source, &level->mesh);
    assert_int_equal(level->candidates + level->retained, level->mesh.vertex_count);
    if (k + 1 == result->level_count) {
      assert_null(level->parents);
      continue;
    }
    const struct lod_retile_level *finer = &result->levels[k + 1];
    uint32_t corners = 0;
    for (uint32_t v = 0; v < level->mesh.vertex_count; v++) {
      assert_true(level->parents[v] < finer->mesh.vertex_count);
      assert_memory_equal(level->mesh.positions[v], finer->mesh.positions[level->parents[v]], sizeof level->mesh.positions[v]);
      const struct lod_retile_point *at = &level->flat[level->parents[v]];
      for (int c = 0; c < 3; c++)
        corners += at->weights[c] == LOD_RETILE_ONE && level->mesh.triangles[at->face][c] == v;
    }
    assert_int_equal(corners, level->mesh.vertex_count);
    for (uint32_t v = 0; v < finer->mesh.vertex_count; v++) {
      const struct lod_retile_point *at = &level->flat[v];
      assert_true(at->face < level->mesh.triangle_count);
      assert_int_equal((uint64_t)at->weights[0] + at->weights[1] + at->weights[2], LOD_RETILE_ONE);
    }
  }
}

/* Every coarse triangle of every step is mapped one to one; proved anew in integers. */
static void assert_mapped(const struct lod_retile *result) {
  for (uint32_t k = 0; k + 1 < result->level_count; k++) {
    const struct lod_retile_level *level = &result->levels[k];
    struct lod_overlay overlay;
    struct lod_overlay_facts facts;
    assert_int_equal(lod_overlay_create(&level->mesh, &level[1].mesh, level->parents, NULL, arena, &overlay, NULL), LOD_OK);
    assert_int_equal(overlay.failed, 0);
    assert_int_equal(overlay.mapped, level->mesh.triangle_count);
    assert_int_equal(lod_overlay_check(&overlay, &level->mesh, &level[1].mesh, level->parents, arena, &facts), LOD_OK);
    if (!facts.valid)
      fail_msg("level %u: %s", k, facts.reason);
  }
}

static struct lod_mesh square(void) {
  static float positions[4][3] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}};
  static uint32_t triangles[2][3] = {{0, 1, 2}, {0, 2, 3}};
  return (struct lod_mesh){.vertex_count = 4, .triangle_count = 2, .positions = positions, .triangles = triangles};
}

static void square_with_n_points_becomes_2n_plus_2_triangles(void **state) {
  (void)state;
  struct lod_mesh mesh = square(), tiled;
  struct lod_retile_point points[100];
  uint64_t seed = 7;
  for (uint32_t n = 0; n <= 100; n += 10) {
    for (uint32_t i = 0; i < n; i++) {
      uint32_t a = 1 + (uint32_t)(lod_random_unit(&seed) * 500000), b = 1 + (uint32_t)(lod_random_unit(&seed) * 500000);
      points[i] = (struct lod_retile_point){i % 2, {a, b, LOD_RETILE_ONE - a - b}};
    }
    assert_int_equal(lod_retile_tessellate(&mesh, points, n, arena, &tiled), LOD_OK);
    assert_int_equal(tiled.triangle_count, 2 * n + 2);
    assert_int_equal(tiled.vertex_count, n + 4);
    assert_same_topology(&mesh, &tiled);
    double area = 0;
    for (uint32_t t = 0; t < tiled.triangle_count; t++) {
      const float *p = tiled.positions[tiled.triangles[t][0]], *q = tiled.positions[tiled.triangles[t][1]],
                  *r = tiled.positions[tiled.triangles[t][2]];
      double twice = ((double)q[0] - p[0]) * ((double)r[1] - p[1]) - ((double)q[1] - p[1]) * ((double)r[0] - p[0]);
      assert_true(twice > -1e-6);
      area += twice / 2;
    }
    assert_true(fabs(area - 4) < 1e-5);
  }
}

static void points_on_an_edge_are_seen_from_both_sides(void **state) {
  (void)state;
  struct lod_mesh mesh = square(), tiled;
  const uint32_t third = LOD_RETILE_ONE / 3, rest = LOD_RETILE_ONE - third;
  /* Three on the diagonal, one of them told from either side; one on the border; one on a corner. */
  const struct lod_retile_point points[] = {{0, {third, 0, rest}}, {1, {third, rest, 0}},
                                            {1, {rest, third, 0}}, {0, {1000, 0, LOD_RETILE_ONE - 1000}},
                                            {0, {third, rest, 0}}, {0, {LOD_RETILE_ONE, 0, 0}}};
  assert_int_equal(lod_retile_tessellate(&mesh, points, 6, arena, &tiled), LOD_OK);
  assert_int_equal(tiled.vertex_count, 8);
  assert_int_equal(tiled.triangle_count, 2 + 3 * 2 + 1);
  assert_same_topology(&mesh, &tiled);
}

static void many_points_on_one_triangle_stay_a_tiling(void **state) {
  (void)state;
  enum { N = 20000 };
  struct lod_mesh mesh = square(), tiled;
  struct lod_retile_point *points = LOD_NEW(arena, N, struct lod_retile_point);
  for (uint32_t i = 0; i < N; i++) /* on a lattice: many on lines and circles */
    points[i] = (struct lod_retile_point){0, {1024 * (1 + i % 141), 1024 * (1 + i / 141), LOD_RETILE_ONE - 1024 * (2 + i % 141 + i / 141)}};
  assert_int_equal(lod_retile_tessellate(&mesh, points, N, arena, &tiled), LOD_OK);
  assert_int_equal(tiled.triangle_count, 2 * N + 2);
  assert_same_topology(&mesh, &tiled);
}

static void sphere_levels_are_nested_and_near(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 5);
  const uint32_t counts[] = {800, 50, 200};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t n = k == 0 ? 50 : k == 1 ? 200 : 800;
    assert_int_equal(result.levels[k].candidates, n);
    assert_int_equal(result.levels[k].retained, 0);
    assert_true(distance_of(&result.levels[k].mesh, &mesh) < 12.0 / n); /* a lattice would have 2.4 / n */
  }
}

static void torus_keeps_its_hole(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 60, 30);
  const uint32_t counts[] = {4, 60, 400, 3000};
  struct lod_retile result = retile(&mesh, counts, 4);
  assert_nested(&mesh, &result);
  assert_true(result.levels[0].mesh.vertex_count >= 7); /* no torus has fewer */
  assert_true(result.levels[0].mesh.vertex_count < 30);
}

static void cube_stays_a_cube(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_cube(arena, 2);
  const uint32_t counts[] = {8, 60, 500};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  for (uint32_t k = 0; k < 3; k++) {
    assert_int_equal(result.levels[k].mesh.vertex_count, counts[k]);
    assert_true(distance_of(&result.levels[k].mesh, &mesh) < 1e-5);
  }
}

static void border_of_an_open_sheet_stays_its_border(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_grid(arena, 2, 40, 0.3);
  const uint32_t counts[] = {40, 160, 640};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  for (uint32_t k = 0; k < 3; k++) {
    const struct lod_mesh *level = &result.levels[k].mesh;
    struct lod_bounds bounds = lod_mesh_bounds(level);
    assert_true(bounds.max[0] - bounds.min[0] == 2 && bounds.max[1] - bounds.min[1] == 2); /* the four corners */
    /* UVs are linear in x and y: sampled, not averaged. */
    for (uint32_t w = 0; w < level->wedge_count; w++) {
      const float *p = level->positions[level->wedge_vertex[w]];
      assert_true(fabs((double)level->uvs[0][w][0] - ((double)p[0] - bounds.min[0]) / 2) < 1e-5);
    }
  }
}

/* Turk 1992, Fig. 2a: parts that are near in space and far on the surface. */
static void sheets_back_to_back_stay_apart(void **state) {
  (void)state;
  struct lod_mesh sheet = lod_shape_grid(arena, 2, 30, 0.2);
  struct lod_mesh mesh = lod_shape_join(arena, &sheet, &sheet, (const double[3]){0, 0, 0.01});
  const uint32_t counts[] = {60, 300};
  struct lod_retile result = retile(&mesh, counts, 2);
  assert_nested(&mesh, &result);
  assert_int_equal(topology_of(&result.levels[0].mesh).components, 2);
}

/* Turk 1992, Fig. 6: two balls that hang together by a neck of three triangles around. */
static void neck_of_three_triangles_stays_open(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_tube(arena, 1, 40, 3, 12);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    double z = (double)mesh.positions[v][2], r = 0.05 + z * z / 400 * 8;
    mesh.positions[v][0] *= (float)r;
    mesh.positions[v][1] *= (float)r;
  }
  const uint32_t counts[] = {4, 12, 100};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
}

static struct lod_mesh two_materials(void) {
  struct lod_mesh mesh = lod_shape_grid(arena, 2, 30, 0.2);
  mesh.materials = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    double x = 0;
    for (int k = 0; k < 3; k++)
      x += (double)mesh.positions[mesh.triangles[t][k]][0];
    mesh.materials[t] = x > 0;
  }
  return mesh;
}

static void no_triangle_crosses_a_material_border(void **state) {
  (void)state;
  struct lod_mesh mesh = two_materials();
  const uint32_t counts[] = {30, 200};
  struct lod_retile result = retile(&mesh, counts, 2);
  assert_nested(&mesh, &result);
  for (uint32_t k = 0; k < 2; k++) {
    const struct lod_mesh *level = &result.levels[k].mesh;
    for (uint32_t t = 0; t < level->triangle_count; t++)
      for (int c = 0; c < 3; c++) {
        double x = (double)level->positions[level->triangles[t][c]][0];
        assert_true(level->materials[t] == 0 ? x < 1e-5 : x > -1e-5);
      }
  }
}

static void result_does_not_depend_on_threads(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 80, 40);
  struct lod_retile results[2];
  for (uint32_t i = 0; i < 2; i++) {
    struct lod_retile_settings settings = lod_retile_defaults();
    settings.threads = i == 0 ? 1 : 3;
    assert_int_equal(lod_retile_create(&mesh, &settings, NULL, arena, &results[i], NULL), LOD_OK);
  }
  assert_int_equal(results[0].level_count, results[1].level_count);
  assert_true(results[0].level_count >= 2);
  for (uint32_t k = 0; k < results[0].level_count; k++) {
    const struct lod_mesh *a = &results[0].levels[k].mesh, *b = &results[1].levels[k].mesh;
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->positions, b->positions, a->vertex_count * sizeof *a->positions);
    assert_memory_equal(a->triangles, b->triangles, a->triangle_count * sizeof *a->triangles);
  }
}

static void turks_own_mode_keeps_topology_too(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 60, 30);
  const uint32_t counts[] = {200, 800};
  struct lod_retile result;
  struct lod_retile_settings settings = lod_retile_turk();
  settings.vertices = counts;
  settings.level_count = 2;
  assert_int_equal(lod_retile_create(&mesh, &settings, NULL, arena, &result, NULL), LOD_OK);
  assert_nested(&mesh, &result);
  assert_int_equal(result.levels[1].candidates, 800);
  assert_true(result.levels[1].retained <= 20);
}

static struct lod_retile retile_with(const struct lod_mesh *mesh, const struct lod_retile_settings *settings) {
  struct lod_retile result;
  assert_int_equal(lod_retile_create(mesh, settings, NULL, arena, &result, NULL), LOD_OK);
  return result;
}

static void every_way_to_fill_keeps_topology(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 60, 30), sheet = lod_shape_grid(arena, 2, 30, 0.5);
  const uint32_t counts[] = {50, 400};
  for (int measure = LOD_RETILE_MEASURE_COST; measure <= LOD_RETILE_MEASURE_ANGLE; measure++)
    for (int projection = LOD_RETILE_POLAR; projection <= LOD_RETILE_PLANES; projection++) {
      struct lod_retile_settings settings = lod_retile_defaults();
      settings.vertices = counts;
      settings.level_count = 2;
      settings.measure = (enum lod_retile_measure)measure;
      settings.projection = (enum lod_retile_projection)projection;
      struct lod_retile result = retile_with(&mesh, &settings);
      assert_nested(&mesh, &result);
      result = retile_with(&sheet, &settings);
      assert_nested(&sheet, &result);
      assert_int_equal(result.levels[1].mesh.vertex_count, 400);
    }
}

/* A sheet that is flat but for one thin spike: points that are spread miss it. */
static void error_leads_vertices_to_a_spike(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_grid(arena, 2, 60, 0);
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    double x = (double)mesh.positions[v][0] - 0.31, y = (double)mesh.positions[v][1] - 0.22;
    mesh.positions[v][2] = (float)(0.6 * exp(-(x * x + y * y) / 0.002));
  }
  const uint32_t counts[] = {100};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = 1;
  settings.curvature = LOD_RETILE_CURVATURE_NONE;
  settings.crease_degrees = 180;
  double errors[2];
  for (int led = 0; led < 2; led++) {
    settings.lead = led ? 0.1 : 0;
    struct lod_retile result = retile_with(&mesh, &settings);
    assert_nested(&mesh, &result);
    assert_int_equal(result.levels[0].mesh.vertex_count, 100);
    errors[led] = distance_of(&result.levels[0].mesh, &mesh);
  }
  assert_true(errors[1] < 0.9 * errors[0]);
}

static void errors_asked_for_are_proven(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 120, 60);
  const double errors[] = {0.02, 0.3, 0.08};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.errors = errors;
  settings.level_count = 3;
  struct lod_retile result = retile_with(&mesh, &settings);
  assert_nested(&mesh, &result);
  for (uint32_t k = 0; k < 3; k++) {
    double asked = k == 0 ? 0.3 : k == 1 ? 0.08 : 0.02;
    assert_true(result.levels[k].bound == asked);
    assert_true(distance_of(&result.levels[k].mesh, &mesh) <= asked * 1.00001);
    assert_true(k == 0 || result.levels[k].mesh.vertex_count > result.levels[k - 1].mesh.vertex_count);
  }
  assert_true(result.levels[2].mesh.vertex_count < mesh.vertex_count / 2);
}

static void wall_with_two_sides_keeps_both(void **state) {
  (void)state;
  struct lod_mesh sheet = lod_shape_grid(arena, 2, 20, 0.3), mesh = sheet;
  uint32_t n = sheet.triangle_count;
  mesh.uvs[0] = NULL;
  mesh.wedge_count = 0;
  mesh.corners = NULL;
  mesh.wedge_vertex = NULL;
  mesh.triangle_count = 2 * n;
  mesh.triangles = lod_arena_alloc(arena, 2 * (size_t)n, sizeof *mesh.triangles);
  for (uint32_t t = 0; t < n; t++) {
    memcpy(mesh.triangles[t], sheet.triangles[t], sizeof *mesh.triangles);
    memcpy(mesh.triangles[n + t], (uint32_t[3]){sheet.triangles[t][0], sheet.triangles[t][2], sheet.triangles[t][1]},
           sizeof *mesh.triangles);
  }
  const uint32_t counts[] = {40, 150};
  struct lod_retile result = retile(&mesh, counts, 2);
  for (uint32_t k = 0; k < 2; k++) {
    const struct lod_mesh *level = &result.levels[k].mesh;
    assert_int_equal(level->vertex_count, counts[k]);
    assert_int_equal(topology_of(level).duplicate_triangles, level->triangle_count / 2);
    double up = 0;
    for (uint32_t t = 0; t < level->triangle_count; t++) {
      const float *p = level->positions[level->triangles[t][0]], *q = level->positions[level->triangles[t][1]],
                  *r = level->positions[level->triangles[t][2]];
      up += ((double)q[0] - p[0]) * ((double)r[1] - p[1]) - ((double)q[1] - p[1]) * ((double)r[0] - p[0]);
    }
    assert_true(fabs(up) < 1e-6); /* as much looks up as down */
  }
  assert_mapped(&result); /* both sides */
}

static void patches_turned_over_are_turned_back(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 3);
  uint64_t seed = 3;
  for (uint32_t t = 0; t < mesh.triangle_count; t++)
    if (lod_random_unit(&seed) < 0.3) {
      uint32_t second = mesh.triangles[t][1];
      mesh.triangles[t][1] = mesh.triangles[t][2];
      mesh.triangles[t][2] = second;
    }
  const uint32_t counts[] = {60};
  struct lod_retile result = retile(&mesh, counts, 1);
  struct lod_topology topology = topology_of(&result.levels[0].mesh);
  assert_int_equal(result.levels[0].mesh.vertex_count, 60);
  assert_true(topology.closed && topology.manifold && topology.oriented);
  assert_int_equal(topology.euler, 2);
}

static void small_pieces_go_on_request(void **state) {
  (void)state;
  struct lod_mesh large = lod_shape_sphere(arena, 1, 3), small = lod_shape_sphere(arena, 0.1, 2);
  struct lod_mesh mesh = lod_shape_join(arena, &large, &small, (const double[3]){1.5, 0, 0});
  const uint32_t counts[] = {40, 500};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = 2;
  struct lod_retile result = retile_with(&mesh, &settings);
  assert_nested(&mesh, &result);
  settings.prune = 1;
  result = retile_with(&mesh, &settings);
  assert_int_equal(topology_of(&result.levels[0].mesh).components, 1);
  assert_int_equal(topology_of(&result.levels[1].mesh).components, 2);
  assert_int_equal(result.levels[0].mesh.vertex_count, 40);
  assert_true(distance_of(&result.levels[0].mesh, &mesh) > 0.4); /* what is missing counts */
}

/* Turk's third pitfall: triangles that meet at a sharp corner. */
static void sharp_tip_stays_sharp(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_tube(arena, 0.2, 4, 24, 30);
  double top = -1e9;
  for (uint32_t v = 0; v < mesh.vertex_count; v++) {
    double z = (double)mesh.positions[v][2];
    top = fmax(top, z);
    mesh.positions[v][0] *= (float)(0.02 + 0.98 * (2 - z) / 4);
    mesh.positions[v][1] *= (float)(0.02 + 0.98 * (2 - z) / 4);
  }
  const uint32_t counts[] = {30, 150};
  struct lod_retile result = retile(&mesh, counts, 2);
  assert_nested(&mesh, &result);
  assert_true(distance_of(&result.levels[0].mesh, &mesh) < 0.25); /* of 4 */
  assert_true(distance_of(&result.levels[1].mesh, &mesh) < 0.05);
}

static double error_with(const struct lod_mesh *mesh, const struct lod_retile_settings *settings) {
  struct lod_retile result = retile_with(mesh, settings);
  assert_nested(mesh, &result);
  return distance_of(&result.levels[0].mesh, mesh);
}

/* A gutter bends across and not along. */
static void anisotropy_lowers_the_error_of_a_bent_sheet(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_grid(arena, 4, 60, 0);
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    mesh.positions[v][2] = (float)(0.5 * cos(3 * (double)mesh.positions[v][0]));
  const uint32_t counts[] = {160};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = 1;
  settings.lead = 0;
  settings.settle = 0;
  settings.curvature = LOD_RETILE_CURVATURE_NONE;
  double even = error_with(&mesh, &settings);
  settings.anisotropy = 3;
  assert_true(error_with(&mesh, &settings) < even);
}

/* One half of the sheet is flat. */
static void curvature_takes_points_to_where_the_surface_bends(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_grid(arena, 4, 60, 0);
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    if (mesh.positions[v][0] > 0)
      mesh.positions[v][2] = (float)(0.1 * (1 - cos(6 * (double)mesh.positions[v][0])));
  const uint32_t counts[] = {300};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = 1;
  settings.lead = 0;
  for (int turk = 0; turk < 2; turk++) {
    settings.curvature = turk ? LOD_RETILE_CURVATURE_TURK : LOD_RETILE_CURVATURE_TENSOR;
    struct lod_retile result = retile_with(&mesh, &settings);
    uint32_t bent = 0;
    for (uint32_t v = 0; v < result.levels[0].mesh.vertex_count; v++)
      bent += result.levels[0].mesh.positions[v][0] > 0.05f;
    assert_true(bent > 180);
  }
}

/* k corners in all loops, h holes, n points: k + 2n - 2 + 2h triangles. */
static void polygon_with_holes_has_k_plus_2n_minus_2_plus_2h(void **state) {
  (void)state;
  static float positions[16][3] = {{0, 0, 0}, {6, 0, 0}, {6, 4, 0}, {3, 3, 0}, {0, 4, 0}, {1, 1, 0},
                                   {2, 1, 0}, {2, 2, 0}, {1, 2, 0}, {4, 1, 0}, {5, 1, 0}, {4.5f, 2, 0}};
  const uint32_t loops[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}, sizes[] = {5, 4, 3};
  uint32_t triangles[16][3], flags, k = 12, h = 2;
  assert_int_equal(lod_triangulate_polygon((const float(*)[3])positions, loops, sizes, 3, arena, triangles, &flags), LOD_OK);
  assert_int_equal(flags, 0);
  struct lod_mesh mesh = {.vertex_count = k, .triangle_count = k + 2 * h - 2, .positions = positions, .triangles = triangles}, tiled;
  struct lod_retile_point points[40];
  uint64_t seed = 5;
  for (uint32_t n = 0; n <= 40; n += 8) {
    for (uint32_t i = 0; i < n; i++) {
      uint32_t a = 1 + (uint32_t)(lod_random_unit(&seed) * 500000), b = 1 + (uint32_t)(lod_random_unit(&seed) * 500000);
      points[i] = (struct lod_retile_point){i % mesh.triangle_count, {a, b, LOD_RETILE_ONE - a - b}};
    }
    assert_int_equal(lod_retile_tessellate(&mesh, points, n, arena, &tiled), LOD_OK);
    assert_int_equal(tiled.triangle_count, k + 2 * n - 2 + 2 * h);
    assert_same_topology(&mesh, &tiled);
  }
}

static void tiny_and_broken_meshes_come_through(void **state) {
  (void)state;
  static float positions[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 0, 0}, {0, 0, 1}};
  static uint32_t one[1][3] = {{0, 1, 2}}, flat[1][3] = {{0, 1, 3}}, twice[1][3] = {{0, 0, 1}},
                  fin[3][3] = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}};
  static const struct { uint32_t (*triangles)[3], count; } kCases[] = {{one, 0}, {one, 1}, {flat, 1}, {twice, 1}, {fin, 3}};
  const uint32_t counts[] = {3, 50};
  for (size_t i = 0; i < sizeof kCases / sizeof *kCases; i++) {
    struct lod_mesh mesh = {.vertex_count = 5, .triangle_count = kCases[i].count, .positions = positions, .triangles = kCases[i].triangles};
    struct lod_retile result = retile(&mesh, counts, 2);
    assert_int_equal(result.level_count, 2);
    for (uint32_t k = 0; k < 2; k++)
      assert_true(lod_mesh_check(&result.levels[k].mesh, NULL));
    if (kCases[i].triangles == one && kCases[i].count == 1) {
      assert_int_equal(result.levels[0].mesh.triangle_count, 1);
      assert_int_equal(result.levels[1].mesh.vertex_count, 50);
    }
    if (kCases[i].triangles == fin) /* three triangles at one edge, still */
      assert_int_equal(topology_of(&result.levels[1].mesh).non_manifold_edges, 1);
  }
}

static void wrong_settings_are_refused(void **state) {
  (void)state;
  struct lod_mesh mesh = square();
  struct lod_retile result;
  struct lod_problem problem = {0};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.ratio = 0.5;
  assert_int_equal(lod_retile_create(&mesh, &settings, NULL, arena, &result, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "bad-ladder");
}

/* Figure 12. The surface is minimal: its two curvatures cancel out, but at its ends, where triangles are long. */
static void costas_surface_has_levels_of_200_800_and_3200(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_figure_costa(arena, 50, 0.14);
  struct lod_topology topology = topology_of(&mesh);
  assert_int_equal(topology.euler, -3); /* a torus less three discs */
  assert_int_equal(topology.boundary_loops, 3);
  struct lod_adjacency adjacency;
  struct lod_curvature curvature;
  assert_int_equal(lod_adjacency_create(&mesh, arena, &adjacency), LOD_OK);
  assert_int_equal(lod_curvature_estimate(&mesh, &adjacency, LOD_CURVATURE_TENSOR, 180, arena, &curvature), LOD_OK);
  double mean = 0, bent = 0;
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    if (lod_vec3_length(lod_vec3_from_float(mesh.positions[v])) < 1.5) {
      mean += fabs(curvature.principal[v][0] + curvature.principal[v][1]);
      bent += fabs(curvature.principal[v][0]);
    }
  assert_true(mean < 0.02 * bent);
  const uint32_t counts[] = {200, 800, 3200};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  assert_mapped(&result);
  for (uint32_t k = 0; k < 3; k++)
    assert_int_equal(result.levels[k].mesh.vertex_count, counts[k]);
  assert_true(distance_of(&result.levels[2].mesh, &mesh) < 0.5 * distance_of(&result.levels[1].mesh, &mesh));
}

/* Figure 11, at 800 points. */
static void points_where_it_bends_lower_the_error_of_a_dose(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_figure_dose(arena, 50);
  struct lod_retile_settings settings = lod_retile_defaults();
  const uint32_t counts[] = {800};
  double errors[2];
  settings.vertices = counts;
  settings.level_count = 1;
  settings.lead = 0;
  for (int curved = 0; curved < 2; curved++) {
    settings.curvature = curved ? LOD_RETILE_CURVATURE_TENSOR : LOD_RETILE_CURVATURE_NONE;
    struct lod_retile result = retile_with(&mesh, &settings);
    assert_int_equal(result.levels[0].mesh.vertex_count, 800);
    errors[curved] = distance_of(&result.levels[0].mesh, &mesh);
  }
  assert_true(errors[1] < errors[0]);
}

static double gyroid(const double p[3], const void *context) {
  (void)context;
  double x = 9 * p[0], y = 9 * p[1], z = 9 * p[2], f = sin(x) * cos(y) + sin(y) * cos(z) + sin(z) * cos(x);
  double out = fmax(fabs(p[0]), fmax(fabs(p[1]), fabs(p[2])));
  return out > 0.9 ? 0 : 1 + (0.6 - fabs(f)); /* a closed wall along the gyroid */
}

/* More holes than the coarsest level has vertices for: it keeps as many as it takes to be mapped. */
static void surface_of_many_handles_is_mapped_whole(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_figure_iso(arena, 40, gyroid, NULL);
  struct lod_topology topology = topology_of(&mesh);
  assert_true(topology.euler < -100);
  const uint32_t counts[] = {60, 1500, 5000};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  assert_mapped(&result);
  assert_true(result.levels[0].mesh.vertex_count > counts[0]);
  assert_true(result.levels[0].mesh.vertex_count < mesh.vertex_count / 4);
}

/* A sheet rolled into a tube whose picture goes once around it: u jumps from 1 to 0 along a seam of the smooth surface. */
static struct lod_mesh rolled_sheet(uint32_t around, uint32_t along) {
  struct lod_mesh mesh = {.vertex_count = around * (along + 1), .wedge_count = (around + 1) * (along + 1)};
  mesh.positions = lod_arena_alloc(arena, mesh.vertex_count, sizeof *mesh.positions);
  mesh.wedge_vertex = LOD_NEW(arena, mesh.wedge_count, uint32_t);
  mesh.uvs[0] = lod_arena_alloc(arena, mesh.wedge_count, sizeof *mesh.uvs[0]);
  mesh.triangles = lod_arena_alloc(arena, 2 * (size_t)around * along, sizeof *mesh.triangles);
  mesh.corners = lod_arena_alloc(arena, 2 * (size_t)around * along, sizeof *mesh.corners);
  for (uint32_t y = 0; y <= along; y++)
    for (uint32_t x = 0; x <= around; x++) {
      uint32_t wedge = y * (around + 1) + x, v = y * around + x % around;
      double angle = 6.283185307179586 * x / around;
      mesh.wedge_vertex[wedge] = v;
      mesh.uvs[0][wedge][0] = (float)x / (float)around;
      mesh.uvs[0][wedge][1] = (float)y / (float)along;
      mesh.positions[v][0] = (float)cos(angle);
      mesh.positions[v][1] = (float)sin(angle);
      mesh.positions[v][2] = 3 * (float)y / (float)along;
    }
  for (uint32_t y = 0; y < along; y++)
    for (uint32_t x = 0; x < around; x++) {
      const uint32_t a = y * (around + 1) + x, c[2][3] = {{a, a + 1, a + around + 2}, {a, a + around + 2, a + around + 1}};
      for (int k = 0; k < 2; k++, mesh.triangle_count++)
        for (int j = 0; j < 3; j++) {
          mesh.corners[mesh.triangle_count][j] = c[k][j];
          mesh.triangles[mesh.triangle_count][j] = mesh.wedge_vertex[c[k][j]];
        }
    }
  return mesh;
}

static void a_seam_stays_a_seam_and_each_side_keeps_its_picture(void **state) {
  (void)state;
  struct lod_mesh mesh = rolled_sheet(80, 60);
  const uint32_t counts[] = {60, 240, 1000};
  struct lod_retile result = retile(&mesh, counts, 3);
  assert_nested(&mesh, &result);
  assert_mapped(&result);
  for (uint32_t k = 0; k < 3; k++) {
    const struct lod_mesh *level = &result.levels[k].mesh;
    uint32_t jumps = 0;
    for (uint32_t t = 0; t < level->triangle_count; t++)
      for (int c = 0; c < 3; c++) {
        const float *uv = level->uvs[0][level->corners[t][c]], *next = level->uvs[0][level->corners[t][(c + 1) % 3]],
                    *p = level->positions[level->triangles[t][c]];
        double turn = atan2((double)p[1], (double)p[0]) / 6.283185307179586 - (double)uv[0];
        assert_true(fabs(turn - floor(turn + 0.5)) < 2e-3); /* where it lies around the tube, from whichever side of the seam */
        assert_true(fabs((double)uv[1] - (double)p[2] / 3) < 2e-3);
        assert_true(fabs((double)(uv[0] - next[0])) < 0.5); /* no triangle has corners of both sides */
        jumps += uv[0] == 0 || uv[0] == 1;
      }
    assert_true(jumps > 4); /* the seam has vertices of its own on either side */
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(square_with_n_points_becomes_2n_plus_2_triangles, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(points_on_an_edge_are_seen_from_both_sides, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(many_points_on_one_triangle_stay_a_tiling, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(sphere_levels_are_nested_and_near, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(torus_keeps_its_hole, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(cube_stays_a_cube, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(border_of_an_open_sheet_stays_its_border, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(sheets_back_to_back_stay_apart, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(neck_of_three_triangles_stays_open, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(no_triangle_crosses_a_material_border, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(result_does_not_depend_on_threads, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(turks_own_mode_keeps_topology_too, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(every_way_to_fill_keeps_topology, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(error_leads_vertices_to_a_spike, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(errors_asked_for_are_proven, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(wall_with_two_sides_keeps_both, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(patches_turned_over_are_turned_back, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(small_pieces_go_on_request, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(sharp_tip_stays_sharp, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(anisotropy_lowers_the_error_of_a_bent_sheet, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(curvature_takes_points_to_where_the_surface_bends, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(polygon_with_holes_has_k_plus_2n_minus_2_plus_2h, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(tiny_and_broken_meshes_come_through, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(wrong_settings_are_refused, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(costas_surface_has_levels_of_200_800_and_3200, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(points_where_it_bends_lower_the_error_of_a_dose, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(surface_of_many_handles_is_mapped_whole, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(a_seam_stays_a_seam_and_each_side_keeps_its_picture, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
