#include "core/clod/tessellate.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/topology.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

/* Random patches: fewer under sanitizers, which take fifty times as long. */
#if defined(__has_feature)
#if __has_feature(address_sanitizer)
enum { SAMPLED = 500 };
#define HAS_SAMPLED
#endif
#endif
#ifndef HAS_SAMPLED
enum { SAMPLED = 10000 };
#endif

static uint64_t seed = 11;

static struct lod_vec3 random_point(double size) {
  double x = lod_random_unit(&seed), y = lod_random_unit(&seed), z = lod_random_unit(&seed);
  return (struct lod_vec3){size * (2 * x - 1), size * (2 * y - 1), size * (2 * z - 1)};
}

/* Every pattern covers the domain once: areas are positive and add up, inside edges have two triangles. */
static void patterns_tile_the_domain(void **state) {
  (void)state;
  for (uint32_t m = 1; m <= 7; m++)
    for (uint32_t a = 1; a <= 6; a++)
      for (uint32_t b = 1; b <= 6; b++)
        for (uint32_t c = 1; c <= 6; c++) {
          if (m < 3 && (a > m || b > m || c > m))
            continue;
          uint32_t factors[3] = {a, b, c};
          struct lod_tessellation_pattern pattern;
          assert_int_equal(lod_tessellation_pattern_make(m, factors, arena, &pattern), LOD_OK);
          double area = 0;
          for (uint32_t t = 0; t < pattern.triangle_count; t++) {
            struct lod_barycentric p = pattern.domain[pattern.triangles[t][0]], q = pattern.domain[pattern.triangles[t][1]],
                                   r = pattern.domain[pattern.triangles[t][2]];
            double part = (q.v - p.v) * (r.w - p.w) - (q.w - p.w) * (r.v - p.v);
            assert_true(part > 1e-9);
            area += part;
          }
          assert_true(fabs(area - 1) < 1e-12);
          /* Euler: a disc whose boundary has a + b + c edges. */
          assert_int_equal(pattern.triangle_count, 2 * (pattern.vertex_count - 1) - (a + b + c));
        }
}

/* What a pattern is chosen by, in float and from its own numbers, is never below the bound of each triangle in double. */
static void quick_bounds_are_above_the_sharp_one(void **state) {
  (void)state;
  struct lod_pattern_cache cache;
  assert_int_equal(lod_pattern_cache_init(&cache, arena), LOD_OK);
  for (int i = 0; i < SAMPLED / 5; i++) {
    struct lod_bezier net;
    for (int k = 0; k < LOD_BEZIER_POINTS; k++) /* flat ones, long ones and any */
      net.p[k] =
          i % 3 == 2 ? random_point(1) : lod_vec3_add_scaled(random_point(i % 3 == 0 ? 0.01 : 1), (struct lod_vec3){0, 0, 1}, 100.0 * k);
    uint32_t factors[3], m, number;
    for (int k = 0; k < 3; k++)
      factors[k] = lod_pattern_step(1 + 20 * lod_random_unit(&seed));
    double deviation, tolerance = lod_bezier_deviation(&net, 1) * (0.002 + 0.1 * lod_random_unit(&seed));
    assert_int_equal(lod_pattern_choose(&cache, &net, factors, tolerance, &m, &number, &deviation), LOD_OK);
    const struct lod_tessellation_pattern *pattern = &cache.entries[number].pattern;
    struct lod_bend bend = lod_bend_of(&net);
    double sharp = lod_bend_deviation(&bend, pattern, m < 3 ? 0 : (m - 3) * (m - 3), pattern->triangle_count);
    assert_true(sharp <= deviation);
    assert_true(deviation <= tolerance || m == LOD_TESSELLATE_MOST);
  }
}

/* One patch with its own three edges. */
static struct lod_patches single(const struct lod_bezier *net) {
  struct lod_patches patches = {.vertex_count = 3, .edge_count = 3, .patch_count = 1};
  patches.positions = LOD_NEW(arena, 3, struct lod_vec3);
  patches.corners = lod_arena_calloc(arena, 1, sizeof *patches.corners);
  patches.sectors = lod_arena_calloc(arena, 1, sizeof *patches.sectors);
  patches.edges = lod_arena_calloc(arena, 1, sizeof *patches.edges);
  patches.ends = lod_arena_calloc(arena, 3, sizeof *patches.ends);
  patches.inner = lod_arena_calloc(arena, 3, sizeof *patches.inner);
  patches.sharp = LOD_NEW_ZERO(arena, 3, bool);
  patches.centres = LOD_NEW(arena, 1, struct lod_vec3);
  patches.normals = LOD_NEW(arena, 1, struct lod_vec3);
  for (uint32_t k = 0; k < 3; k++) {
    patches.positions[k] = net->p[k];
    patches.corners[0][k] = k;
    patches.sectors[0][k] = LOD_NONE;
    patches.edges[0][k] = 2 * k;
    patches.ends[k][0] = k;
    patches.ends[k][1] = (k + 1) % 3;
    patches.inner[k][0] = net->p[3 + 2 * k];
    patches.inner[k][1] = net->p[4 + 2 * k];
    patches.sharp[k] = true;
  }
  patches.centres[0] = net->p[LOD_BEZIER_CENTRE];
  return patches;
}

/* Shared checklist 2.3.6: over random patches the error is never above the tolerance, and the mean slack is under 2.5. Errors are those of
 * corresponding points, densely sampled. */
static void the_error_is_never_above_the_tolerance_and_not_far_below(void **state) {
  (void)state;
  enum { PATCHES = SAMPLED };
  double slack = 0;
  struct lod_arena *outer = arena;
  for (int round = 0; round < PATCHES; round++) {
    arena = lod_arena_create_child(outer);
    struct lod_bezier net = lod_bezier_flat((struct lod_vec3){0, 0, 0}, (struct lod_vec3){1, 0, 0}, (struct lod_vec3){0, 1, 0});
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      net.p[i] = lod_vec3_add(net.p[i], random_point(0.25));
    struct lod_patches patches = single(&net);
    struct lod_tessellate_settings settings = lod_tessellate_defaults();
    settings.tolerance = 0.002 * pow(2, 5 * lod_random_unit(&seed));
    settings.normals = false;
    struct lod_tessellation result;
    assert_int_equal(lod_tessellate(&patches, &settings, arena, &result, NULL), LOD_OK);
    assert_true(result.deviation <= settings.tolerance);
    struct lod_tessellation_pattern pattern;
    assert_int_equal(lod_tessellation_pattern_make(result.grids[0], result.factors, arena, &pattern), LOD_OK);
    double worst = 0;
    for (uint32_t t = 0; t < pattern.triangle_count; t++)
      for (int i = 0; i <= 4; i++)
        for (int j = 0; i + j <= 4; j++) {
          double l[3] = {(4 - i - j) / 4.0, i / 4.0, j / 4.0};
          struct lod_barycentric at = {0, 0, 0};
          struct lod_vec3 q = {0, 0, 0};
          for (int k = 0; k < 3; k++) {
            struct lod_barycentric corner = pattern.domain[pattern.triangles[t][k]];
            at = (struct lod_barycentric){at.u + l[k] * corner.u, at.v + l[k] * corner.v, at.w + l[k] * corner.w};
            q = lod_vec3_add_scaled(q, lod_bezier_point(&net, corner), l[k]);
          }
          worst = fmax(worst, lod_vec3_distance(lod_bezier_point(&net, at), q));
        }
    assert_true(worst <= settings.tolerance * (1 + 1e-9));
    slack += settings.tolerance / worst / PATCHES;
    lod_arena_destroy(arena);
  }
  arena = outer;
  print_message("mean slack %.2f\n", slack);
  assert_true(slack < 2.5);
}

/* Two patches over one edge that need very different factors. */
static void neighbours_of_any_factors_leave_no_crack(void **state) {
  (void)state;
  struct lod_bezier net = lod_bezier_flat((struct lod_vec3){0, 0, 0}, (struct lod_vec3){1, 0, 0}, (struct lod_vec3){0, 1, 0});
  net.p[9].z = 3;
  struct lod_patches a = single(&net), both = a;
  both.vertex_count = 4, both.edge_count = 5, both.patch_count = 2;
  both.positions = LOD_NEW(arena, 4, struct lod_vec3);
  memcpy(both.positions, a.positions, 3 * sizeof *a.positions);
  both.positions[3] = (struct lod_vec3){1, 1, 0};
  both.corners = lod_arena_calloc(arena, 2, sizeof *both.corners);
  both.edges = lod_arena_calloc(arena, 2, sizeof *both.edges);
  both.sectors = lod_arena_calloc(arena, 2, sizeof *both.sectors);
  memset(both.sectors, 0xff, 2 * sizeof *both.sectors);
  both.ends = lod_arena_calloc(arena, 5, sizeof *both.ends);
  both.inner = lod_arena_calloc(arena, 5, sizeof *both.inner);
  both.sharp = LOD_NEW_ZERO(arena, 5, bool);
  both.centres = LOD_NEW(arena, 2, struct lod_vec3);
  static const uint32_t kCorners[2][3] = {{0, 1, 2}, {1, 3, 2}}, kEdges[2][3] = {{0, 2, 4}, {6, 8, 3}};
  static const uint32_t kEnds[5][2] = {{0, 1}, {1, 2}, {2, 0}, {1, 3}, {3, 2}};
  memcpy(both.corners, kCorners, sizeof kCorners);
  memcpy(both.edges, kEdges, sizeof kEdges);
  memcpy(both.ends, kEnds, sizeof kEnds);
  for (uint32_t e = 0; e < 5; e++)
    for (int i = 0; i < 2; i++) {
      struct lod_vec3 near = both.positions[kEnds[e][i]], far = both.positions[kEnds[e][1 - i]];
      both.inner[e][i] = lod_vec3_add_scaled(near, lod_vec3_subtract(far, near), 1.0 / 3);
    }
  both.inner[1][0].z = 0.5;
  both.centres[0] = net.p[9];
  both.centres[1] = (struct lod_vec3){2.0 / 3, 2.0 / 3, 0};
  assert_true(lod_patches_check(&both, NULL));
  for (double tolerance = 0.5; tolerance > 0.001; tolerance /= 3) {
    struct lod_tessellate_settings settings = lod_tessellate_defaults();
    settings.tolerance = tolerance;
    struct lod_tessellation result;
    assert_int_equal(lod_tessellate(&both, &settings, arena, &result, NULL), LOD_OK);
    assert_true(lod_mesh_check(&result.mesh, NULL));
    struct lod_topology topology;
    assert_int_equal(lod_topology_measure(&result.mesh, NULL, arena, &topology), LOD_OK);
    assert_true(topology.manifold && topology.oriented);
    assert_int_equal(topology.boundary_loops, 1);
    assert_int_equal(topology.boundary_edges, result.factors[0] + result.factors[2] + result.factors[3] + result.factors[4]);
  }
}

/* P3-21 (ii) and (iii): several edges between the same two corners; a patch whose two corners are one, its side a loop. */
static void degenerate_patches_are_cut_as_any_other(void **state) {
  (void)state;
  struct lod_vec3 positions[2] = {{0, 0, 0}, {2, 0, 0}};
  uint32_t corners[2][3] = {{0, 0, 1}, {0, 0, 1}}, edges[2][3] = {{0, 2, 4}, {1, 5, 3}}, sectors[2][3],
           ends[3][2] = {{0, 0}, {0, 1}, {1, 0}};
  struct lod_vec3 inner[3][2] = {{{-1, 1, 0}, {-1, -1, 0}}, {{0.7, -0.3, 0}, {1.5, -0.2, 0}}, {{1.5, 0.2, 0}, {0.7, 0.3, 0}}};
  struct lod_vec3 centres[2] = {{0, 0, 1}, {0, 0, -1}};
  bool sharp[3] = {false, false, false};
  memset(sectors, 0xff, sizeof sectors);
  struct lod_patches drop = {.vertex_count = 2,
                             .edge_count = 3,
                             .patch_count = 2,
                             .positions = positions,
                             .corners = corners,
                             .edges = edges,
                             .sectors = sectors,
                             .ends = ends,
                             .inner = inner,
                             .sharp = sharp,
                             .centres = centres};
  assert_true(lod_patches_check(&drop, NULL));
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  settings.tolerance = 0.01;
  struct lod_tessellation result;
  assert_int_equal(lod_tessellate(&drop, &settings, arena, &result, NULL), LOD_OK);
  assert_true(result.deviation <= 0.01);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&result.mesh, NULL, arena, &topology), LOD_OK);
  /* A pillow with two of its corners at one point, where it is pinched. */
  assert_true(topology.closed && topology.oriented);
  assert_int_equal(topology.non_manifold_vertices, 1);
  assert_int_equal(topology.euler, 1);
}

static void wrong_patches_are_told(void **state) {
  (void)state;
  struct lod_bezier net = lod_bezier_flat((struct lod_vec3){0, 0, 0}, (struct lod_vec3){1, 0, 0}, (struct lod_vec3){0, 1, 0});
  struct lod_patches patches = single(&net);
  struct lod_problem problem = {0};
  assert_true(lod_patches_check(&patches, &problem));
  patches.centres[0].x = NAN;
  assert_false(lod_patches_check(&patches, &problem));
  assert_string_equal(problem.type, "non-finite");
  patches = single(&net);
  patches.edges[0][1] = 0;
  assert_false(lod_patches_check(&patches, NULL));
  patches = single(&net);
  patches.corners[0][2] = 3;
  assert_false(lod_patches_check(&patches, NULL));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(patterns_tile_the_domain),
      cmocka_unit_test(quick_bounds_are_above_the_sharp_one),
      cmocka_unit_test(the_error_is_never_above_the_tolerance_and_not_far_below),
      cmocka_unit_test(neighbours_of_any_factors_leave_no_crack),
      cmocka_unit_test(degenerate_patches_are_cut_as_any_other),
      cmocka_unit_test(wrong_patches_are_told),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
