/* C-LODs of meshes that one can draw.
 *
 * The checklist of the paper (shared algorithms.md, 1.3), where each line is shown:
 * P3-1 polygons here; tensor and triangular patches of degrees 1 to 9, rational too: codec/import/spline_test, and faces of n
 * corners, which are cut into such patches (no format that is read has curved patches of five sides or more). P3-2
 * every_triangle_becomes_a_patch; curvature and size are taken when asked for (order by size: search.c), not stored. P3-3, P3-5 bezier_test
 * (splits, merges), the_papers_merges_undo_splits. P3-4 coplanarity at corners is kept by fit.c; edge continuity decides in search.c;
 * affine pairs: dynamic_test (strict patches). P3-6, P3-7 every_triangle_becomes_a_patch, a_cube_keeps_its_twelve_edges. P3-8, P3-9
 * bezier_test (refined centre). P3-10 spline_test, charts_say_where_triangles_lie_on_their_patches. P3-11 to P3-18, P3-22
 * the_papers_search_finds_all_its_patterns (3T is argued away by the paper; of swaps the estimate is blind). P3-19
 * all_levels_live_in_one_structure. P3-20 a_stuck_search_goes_on. P3-21 (i) here; (ii), (iii) tessellate_test. P3-23 dynamic_test,
 * tessellate_test, web patches.test. P3-24, P3-25 tests/bench/clod_bench prints bytes and rows. P3-26 swaps are certified with the removal
 * they belong to; merging_makes_no_folds. P3-27 bounded error: the_bound_holds_at_every_stage; strict G1: dynamic_test. Change of topology
 * and parallel merging within a unit: not built. */
#include "core/clod/clod.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/clod/evaluate.h"
#include "core/clod/tessellate.h"
#include "core/mesh/distance.h"
#include "core/mesh/topology.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static struct lod_clod *model_of(const struct lod_mesh *mesh) {
  struct lod_clod *clod;
  assert_int_equal(lod_clod_create(mesh, NULL, arena, &clod, NULL), LOD_OK);
  assert_true(lod_clod_check(clod));
  return clod;
}

static struct lod_clod_facts simplify(struct lod_clod *clod, uint32_t patches, double error) {
  struct lod_clod_facts facts;
  assert_int_equal(lod_clod_simplify(clod, patches, error, NULL), LOD_OK);
  assert_true(lod_clod_check(clod));
  lod_clod_facts(clod, &facts);
  return facts;
}

static struct lod_patches extract(const struct lod_clod *clod, uint32_t number, double *error) {
  struct lod_patches patches;
  assert_int_equal(lod_clod_extract(clod, number, arena, &patches, error), LOD_OK);
  assert_true(lod_patches_check(&patches, NULL));
  return patches;
}

static struct lod_tessellation tessellate(const struct lod_patches *patches, double tolerance) {
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  struct lod_tessellation result;
  settings.tolerance = tolerance;
  assert_int_equal(lod_tessellate(patches, &settings, arena, &result, NULL), LOD_OK);
  assert_true(lod_mesh_check(&result.mesh, NULL));
  return result;
}

struct sampled {
  const struct lod_patches *patches;
  const struct lod_mesh *mesh;
  double worst;
  uint64_t count;
  double *area; /* of each source triangle, summed in units of its own */
};

static void take_sample(void *context, const struct lod_clod_sample *sample) {
  struct sampled *s = context;
  struct lod_bezier net = lod_patches_net(s->patches, sample->patch);
  s->worst = fmax(s->worst, lod_vec3_distance(lod_bezier_point(&net, sample->at), sample->point));
  s->count++;
}

/* Shared checklist 2.3.3: the bound holds at corresponding points, and the two-sided distance obeys it. */
static void assert_bound_holds(const struct lod_mesh *mesh, struct lod_clod *clod) {
  struct lod_clod_facts facts;
  lod_clod_facts(clod, &facts);
  double error;
  struct lod_patches patches = extract(clod, facts.clod, &error);
  assert_true(error == facts.error);
  struct sampled sampled = {.patches = &patches, .mesh = mesh};
  lod_clod_samples(clod, 6, take_sample, &sampled);
  assert_true(sampled.count > 0 && sampled.worst <= facts.error);
  struct lod_tessellation flat = tessellate(&patches, fmax(0.05 * facts.error, 1e-4));
  struct lod_distance distance;
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.absolute = 1e-5;
  assert_int_equal(lod_distance_measure(mesh, &flat.mesh, &settings, arena, &distance), LOD_OK);
  assert_true(distance.two_sided.lower <= facts.error + flat.deviation + 1e-6);
}

static void every_triangle_becomes_a_patch_that_meets_its_corners(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 2);
  struct lod_clod *clod = model_of(&sphere);
  double error;
  struct lod_patches patches = extract(clod, 0, &error);
  assert_int_equal(patches.patch_count, sphere.triangle_count);
  for (uint32_t p = 0; p < patches.patch_count; p++) {
    struct lod_bezier net = lod_patches_net(&patches, p);
    /* Closer to the sphere than the flat triangle is. */
    struct lod_vec3 centre = lod_bezier_point(&net, (struct lod_barycentric){1.0 / 3, 1.0 / 3, 1.0 / 3});
    assert_true(fabs(lod_vec3_length(centre) - 1) < 2e-3);
  }
  assert_bound_holds(&sphere, clod);
  assert_true(lod_patches_normal_gap(&patches, 8) < 3);
}

static void the_bound_holds_at_every_stage(void **state) {
  (void)state;
  struct lod_mesh shapes[4] = {lod_shape_sphere(arena, 1, 4), lod_shape_torus(arena, 1, 0.4, 60, 30), lod_shape_grid(arena, 2, 30, 0.3),
                               lod_shape_tube(arena, 0.5, 3, 40, 30)};
  static const uint32_t kShares[] = {4, 16, 40};
  for (int i = 0; i < 4; i++) {
    struct lod_clod *clod = model_of(&shapes[i]);
    for (int k = 0; k < 3; k++) {
      uint32_t wanted = shapes[i].triangle_count / kShares[k];
      struct lod_clod_facts facts = simplify(clod, wanted, INFINITY);
      assert_true(facts.patches <= wanted + 2 || k == 2);
      assert_bound_holds(&shapes[i], clod);
    }
  }
}

static void an_error_asked_for_is_not_exceeded(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 80, 40);
  struct lod_clod *clod = model_of(&torus);
  struct lod_clod_facts facts = simplify(clod, 0, 0.01);
  assert_true(facts.error <= 0.01);
  /* Triangles need some 2 800 for this (chord height r a^2 / 8 around both circles); cubics need few. */
  assert_true(facts.patches < 250);
}

static void topology_stays(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 60, 30);
  struct lod_clod *clod = model_of(&torus);
  struct lod_clod_facts facts = simplify(clod, 60, INFINITY);
  struct lod_patches patches = extract(clod, facts.clod, NULL);
  struct lod_tessellation flat = tessellate(&patches, 0.01);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&flat.mesh, NULL, arena, &topology), LOD_OK);
  assert_true(topology.closed && topology.manifold && topology.oriented);
  assert_int_equal(topology.genus, 1);
  assert_int_equal(topology.components, 1);
}

/* P3-7 */
static void a_cube_keeps_its_twelve_edges(void **state) {
  (void)state;
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  struct lod_clod *clod = model_of(&cube);
  struct lod_clod_facts facts = simplify(clod, 0, INFINITY);
  assert_int_equal(facts.patches, 12);
  assert_true(facts.error < 1e-12);
  struct lod_patches patches = extract(clod, 0, NULL);
  uint32_t sharp = 0;
  for (uint32_t e = 0; e < patches.edge_count; e++)
    sharp += patches.sharp[e];
  assert_int_equal(sharp, 12);
  assert_int_equal(patches.normal_count, 24);
}

static void a_boundary_stays_a_boundary(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 24, 0.2);
  struct lod_clod *clod = model_of(&grid);
  struct lod_clod_facts facts = simplify(clod, 100, 0.05);
  struct lod_patches patches = extract(clod, facts.clod, NULL);
  struct lod_tessellation flat = tessellate(&patches, 0.005);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&flat.mesh, NULL, arena, &topology), LOD_OK);
  assert_int_equal(topology.boundary_loops, 1);
  assert_int_equal(topology.euler, 1);
  assert_bound_holds(&grid, clod);
}

struct slips {
  const struct lod_mesh *mesh;
  const struct lod_patches *patches;
  double worst;
};

static void compare_uv(void *context, const struct lod_clod_sample *sample) {
  struct slips *s = context;
  float mine[LOD_PATCH_NUMBERS];
  double at[3] = {sample->at.u, sample->at.v, sample->at.w};
  lod_patch_attributes_mix(&s->patches->attributes, sample->patch, at, mine);
  /* The source's: the grid's UVs are known everywhere from x and y. */
  double u = sample->point.x / 2 + 0.5, v = sample->point.y / 2 + 0.5;
  s->worst = fmax(s->worst, sqrt(((double)mine[0] - u) * ((double)mine[0] - u) + ((double)mine[1] - v) * ((double)mine[1] - v)));
}

/* UVs are carried: what they are off is bounded at all corresponding points, and limits what may be merged. */
static void textures_slip_by_no_more_than_is_told(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 24, 0.4);
  struct lod_clod *clod = model_of(&grid);
  double before = 0;
  for (uint32_t wanted = 600; wanted > 8; wanted /= 3) {
    struct lod_clod_facts facts = simplify(clod, wanted, INFINITY);
    struct lod_patches patches = extract(clod, facts.clod, NULL);
    struct slips slips = {&grid, &patches, 0};
    assert_true(patches.attributes.has_uv[0] && !patches.attributes.has_colors);
    lod_clod_samples(clod, 3, compare_uv, &slips);
    assert_true(slips.worst > 0 && slips.worst <= patches.attributes.uv_off * 1.0001 + 1e-6);
    assert_true(slips.worst > 0.5 * patches.attributes.uv_off && patches.attributes.uv_off >= before);
    before = patches.attributes.uv_off;
    struct lod_tessellate_settings settings = lod_tessellate_defaults();
    struct lod_tessellation flat;
    settings.tolerance = 0.002;
    assert_int_equal(lod_tessellate(&patches, &settings, arena, &flat, NULL), LOD_OK);
    assert_true(lod_mesh_check(&flat.mesh, NULL) && flat.mesh.uvs[0] != NULL && flat.mesh.uvs[1] == NULL);
    for (uint32_t t = 0; t < flat.mesh.triangle_count; t++)
      for (int k = 0; k < 3; k++) { /* UV against position: what the textures slip, and what the surface is off */
        const float *uv = flat.mesh.uvs[0][flat.mesh.corners[t][k]], *p = flat.mesh.positions[flat.mesh.triangles[t][k]];
        double off = fmax(fabs((double)uv[0] - (double)p[0] / 2 - 0.5), fabs((double)uv[1] - (double)p[1] / 2 - 0.5));
        assert_true(off <= patches.attributes.uv_off + facts.error / 2 + 1e-5);
      }
  }
  /* A limit counts for both: textures slip by no more than four times the error, in lengths. */
  clod = model_of(&grid);
  struct lod_clod_facts facts = simplify(clod, 0, 0.01);
  struct lod_patches patches = extract(clod, facts.clod, NULL);
  assert_true(facts.patches > 8 && facts.patches < grid.triangle_count && patches.attributes.uv_off * 2 <= 4 * 0.0101);
}

/* P3-19: any C-LOD comes out of the structure as it was when it was the last one. */
static void all_levels_live_in_one_structure(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 3);
  struct lod_clod *clod = model_of(&sphere);
  struct lod_clod_facts middle = simplify(clod, 400, INFINITY);
  double then, now;
  struct lod_patches before = extract(clod, middle.clod, &then);
  struct lod_clod_facts last = simplify(clod, 60, INFINITY);
  assert_true(last.patches < middle.patches && last.clod > middle.clod);
  struct lod_patches after = extract(clod, middle.clod, &now);
  assert_true(then == now);
  assert_int_equal(before.patch_count, after.patch_count);
  assert_int_equal(before.vertex_count, after.vertex_count);
  assert_memory_equal(before.corners, after.corners, before.patch_count * sizeof *before.corners);
  assert_memory_equal(before.partners, after.partners, before.patch_count * sizeof *before.partners);
  assert_memory_equal(before.centres, after.centres, before.patch_count * sizeof *before.centres);
  assert_memory_equal(before.inner, after.inner, before.edge_count * sizeof *before.inner);
  assert_int_equal(extract(clod, 0, NULL).patch_count, sphere.triangle_count);
}

static void the_same_input_gives_the_same_bits(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.3, 40, 20);
  struct lod_patches first, second;
  struct lod_clod *a = model_of(&torus), *b = model_of(&torus);
  first = extract(a, simplify(a, 100, INFINITY).clod, NULL);
  second = extract(b, simplify(b, 100, INFINITY).clod, NULL);
  assert_int_equal(first.patch_count, second.patch_count);
  assert_memory_equal(first.centres, second.centres, first.patch_count * sizeof *first.centres);
  assert_memory_equal(first.inner, second.inner, first.edge_count * sizeof *first.inner);
}

/* P3-21 (i): two patches with the same corners and edges, back to back. */
static void a_pillow_of_two_patches_is_left_alone(void **state) {
  (void)state;
  float positions[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  uint32_t triangles[2][3] = {{0, 1, 2}, {0, 2, 1}};
  struct lod_mesh pillow = {.vertex_count = 3, .triangle_count = 2, .positions = positions, .triangles = triangles};
  struct lod_clod *clod = model_of(&pillow);
  struct lod_clod_facts facts = simplify(clod, 0, INFINITY);
  assert_int_equal(facts.patches, 2);
  assert_int_equal(facts.edges, 3);
  struct lod_patches patches = extract(clod, 0, NULL);
  assert_true(isfinite(lod_patches_bounds(&patches).max[0]));
}

/* Trap 14 of the shared list: a tetrahedron would close up into two patches that share three edges. */
static void a_tetrahedron_does_not_close_up(void **state) {
  (void)state;
  float positions[4][3] = {{1, 1, 1}, {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}};
  uint32_t triangles[4][3] = {{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};
  struct lod_mesh tetrahedron = {.vertex_count = 4, .triangle_count = 4, .positions = positions, .triangles = triangles};
  struct lod_clod_settings settings = lod_clod_defaults();
  settings.crease_degrees = 180;
  struct lod_clod *clod;
  assert_int_equal(lod_clod_create(&tetrahedron, &settings, arena, &clod, NULL), LOD_OK);
  assert_int_equal(simplify(clod, 0, INFINITY).patches, 4);
}

static void damaged_meshes_are_taken_as_they_are(void **state) {
  (void)state;
  struct lod_mesh soup = lod_shape_soup(arena, 200, 0.2, 3), welded;
  assert_int_equal(lod_mesh_weld(&soup, arena, &welded, NULL), LOD_OK);
  simplify(model_of(&welded), 0, INFINITY);
  /* Three triangles on one edge, one of them also turned over, and one that names a vertex twice. */
  float positions[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, -1, 0}};
  uint32_t triangles[5][3] = {{0, 1, 2}, {0, 1, 3}, {1, 0, 4}, {2, 2, 3}, {0, 0, 0}};
  struct lod_mesh fan = {.vertex_count = 5, .triangle_count = 5, .positions = positions, .triangles = triangles};
  struct lod_clod *clod = model_of(&fan);
  struct lod_clod_facts facts = simplify(clod, 0, INFINITY);
  assert_int_equal(facts.patches, 3);
  assert_bound_holds(&fan, clod);
}

static void a_mesh_without_triangles_gives_nothing(void **state) {
  (void)state;
  struct lod_mesh nothing = {0};
  struct lod_clod *clod = model_of(&nothing);
  assert_int_equal(simplify(clod, 0, INFINITY).patches, 0);
  assert_int_equal(extract(clod, 0, NULL).patch_count, 0);
}

/* Patches that are not proven regular, and smooth edges whose patches turn back on one another. */
static uint32_t count_folds(const struct lod_patches *patches) {
  uint32_t folds = 0;
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    struct lod_bezier net = lod_patches_net(patches, p);
    folds += !lod_bezier_is_regular(&net);
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t other = patches->partners[p][k], side = patches->edges[p][k];
      if (other == LOD_NONE || other < 3 * p || patches->sharp[side >> 1])
        continue;
      for (int i = 1; i < 4; i++)
        if (lod_vec3_dot(lod_edge_normal(patches, 3 * p + k, side & 1, i / 4.0, LOD_SMOOTH_SHADED),
                         lod_edge_normal(patches, other, (side & 1) == 0, i / 4.0, LOD_SMOOTH_SHADED)) < 0) {
          folds++;
          break;
        }
    }
  }
  return folds;
}

/* Down to as few patches as there can be: a surface that had no folds has none, one that had some has no more. */
static void merging_makes_no_folds(void **state) {
  (void)state;
  struct lod_mesh shapes[3] = {lod_shape_sphere(arena, 1, 4), lod_shape_torus(arena, 1, 0.4, 40, 20),
                               lod_shape_tube(arena, 0.5, 3, 24, 12)};
  for (uint32_t v = 0; v < shapes[0].vertex_count; v++) { /* waves, whose crests merge badly */
    float *p = shapes[0].positions[v];
    float r = 1 + 0.25f * sinf(9 * p[0]) * cosf(7 * p[1]) * sinf(8 * p[2] + 1);
    for (int axis = 0; axis < 3; axis++)
      p[axis] *= r;
  }
  for (int i = 0; i < 3; i++) {
    struct lod_clod *clod = model_of(&shapes[i]);
    uint32_t before = UINT32_MAX;
    for (uint32_t wanted = 4096; wanted > 4; wanted /= 3) {
      struct lod_clod_facts facts = simplify(clod, wanted, INFINITY);
      struct lod_patches patches = extract(clod, facts.clod, NULL);
      uint32_t folds = count_folds(&patches);
      assert_true(folds <= before && folds < 3);
      before = folds;
    }
  }
}

/* P3-11 to P3-18, P3-20, P3-22: the paper's own search, C-LOD after C-LOD, its angle relaxed as it sticks. */
static void the_papers_search_finds_all_its_patterns(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 60, 30), tube = lod_shape_tube(arena, 0.5, 3, 24, 12);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 4);
  const struct lod_mesh *const shapes[3] = {&torus, &tube, &sphere};
  struct lod_clod_search_facts sum = {0};
  for (int i = 0; i < 3; i++) {
    struct lod_clod *clod = model_of(shapes[i]);
    struct lod_clod_facts facts;
    struct lod_clod_search_settings settings = lod_clod_search_defaults();
    lod_clod_facts(clod, &facts);
    uint32_t before = facts.patches, rounds = 0;
    double estimate = 0;
    for (; rounds < 40 && facts.patches > 40; rounds++) {
      struct lod_clod_search_facts found;
      uint32_t patches = facts.patches, vertices = facts.vertices;
      assert_int_equal(lod_clod_search(clod, &settings, NULL, &found), LOD_OK);
      assert_true(lod_clod_check(clod));
      lod_clod_facts(clod, &facts);
      /* A vertex inside takes two patches with it, one on a border of one side one. */
      assert_true(patches - facts.patches <= 2 * (found.removed - found.refused));
      assert_int_equal(vertices - facts.vertices, found.removed - found.refused);
      assert_true(found.estimate >= estimate || found.removed == found.refused || facts.patches < patches);
      estimate = found.estimate;
      sum.t += found.t, sum.star += found.star, sum.two_t += found.two_t, sum.t_in_t += found.t_in_t, sum.swaps += found.swaps;
      sum.removed += found.removed, sum.refused += found.refused;
      if (found.removed - found.refused < 4)
        settings.angle_degrees *= 1.3;
    }
    print_message("%u patches to %u in %u C-LODs; certified %.4f, estimate %.4f\n", before, facts.patches, rounds, facts.error, estimate);
    assert_true(facts.patches < before / 8);
    assert_true(estimate > 0);
    assert_bound_holds(shapes[i], clod);
  }
  print_message("T %u, star %u, 2T %u, T-in-T %u, swaps %u; %u removed, %u refused\n", sum.t, sum.star, sum.two_t, sum.t_in_t, sum.swaps,
                sum.removed, sum.refused);
  assert_true(sum.t > 0 && sum.star > 0 && sum.two_t > 0 && sum.t_in_t > 0 && sum.swaps > 0);
}

static double out_of_plane(const struct lod_patches *patches, uint32_t e) {
  struct lod_vec3 a = patches->positions[patches->ends[e][0]], chord = lod_vec3_subtract(patches->positions[patches->ends[e][1]], a);
  struct lod_vec3 n = lod_vec3_cross(chord, lod_vec3_subtract(patches->inner[e][0], a));
  double size = lod_vec3_length(n) * lod_vec3_length(chord);
  return size > 0 ? fabs(lod_vec3_dot(n, lod_vec3_subtract(patches->inner[e][1], a))) / size : 0;
}

/* P3-20: where no pattern is found at this angle any more, vertices of high degree go, and curves are moved into planes; certified too. */
static void a_stuck_search_goes_on(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 60, 30);
  struct lod_clod *clod = model_of(&torus);
  struct lod_clod_facts facts, then;
  struct lod_clod_search_settings settings = lod_clod_search_defaults();
  struct lod_clod_search_facts found = {.removed = 1};
  for (int round = 0; round < 60 && found.removed > found.refused; round++)
    assert_int_equal(lod_clod_search(clod, &settings, NULL, &found), LOD_OK);
  lod_clod_facts(clod, &then);
  assert_true(found.removed == found.refused && then.patches > 40);
  struct lod_patches before = extract(clod, then.clod, NULL);
  uint32_t moved, wide = 0, planar = 0;
  double error = 1.5 * then.error;
  assert_int_equal(lod_clod_straighten(clod, error, &moved), LOD_OK);
  assert_true(lod_clod_check(clod));
  lod_clod_facts(clod, &facts);
  assert_true(moved > 0 && facts.clod == then.clod + 1 && facts.patches == then.patches && facts.error <= error);
  struct lod_patches after = extract(clod, facts.clod, NULL), again = extract(clod, then.clod, NULL);
  for (uint32_t e = 0; e < before.edge_count; e++)
    planar += out_of_plane(&before, e) < 1e-9;
  for (uint32_t e = 0; e < after.edge_count; e++)
    planar -= out_of_plane(&after, e) < 1e-9;
  assert_true((int32_t)planar < 0); /* more are */
  assert_memory_equal(before.inner, again.inner, before.edge_count * sizeof *before.inner);
  assert_memory_equal(before.centres, again.centres, before.patch_count * sizeof *before.centres);
  struct lod_tessellation flat = tessellate(&after, 0.01);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&flat.mesh, NULL, arena, &topology), LOD_OK);
  assert_int_equal(topology.boundary_loops, 0);
  assert_int_equal(topology.euler, 0);
  settings.wide = true;
  for (int round = 0; round < 20; round++) {
    assert_int_equal(lod_clod_search(clod, &settings, NULL, &found), LOD_OK);
    wide += found.wide;
    settings.angle_degrees *= 1.1;
  }
  lod_clod_facts(clod, &facts);
  print_message("stuck at %u patches, %u edges made planar, then %u of high degree tagged to go: %u patches\n", then.patches, moved, wide,
                facts.patches);
  assert_true(wide > 0 && facts.patches < then.patches && lod_clod_check(clod));
  assert_bound_holds(&torus, clod);
}

/* What one cubic was split into is put together again, to the last digits: T and star are the inverse of de Casteljau's algorithm. */
static void the_papers_merges_undo_splits(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 2, 2, 0);
  struct lod_clod *clod = model_of(&grid);
  struct lod_clod_search_settings settings = lod_clod_search_defaults();
  struct lod_clod_search_facts found;
  assert_int_equal(lod_clod_search(clod, &settings, NULL, &found), LOD_OK);
  struct lod_clod_facts facts;
  lod_clod_facts(clod, &facts);
  assert_true(found.removed - found.refused > 0 && facts.error < 1e-6 && found.estimate < 1e-6);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_triangle_becomes_a_patch_that_meets_its_corners),
      cmocka_unit_test(the_bound_holds_at_every_stage),
      cmocka_unit_test(an_error_asked_for_is_not_exceeded),
      cmocka_unit_test(topology_stays),
      cmocka_unit_test(a_cube_keeps_its_twelve_edges),
      cmocka_unit_test(a_boundary_stays_a_boundary),
      cmocka_unit_test(textures_slip_by_no_more_than_is_told),
      cmocka_unit_test(all_levels_live_in_one_structure),
      cmocka_unit_test(the_same_input_gives_the_same_bits),
      cmocka_unit_test(merging_makes_no_folds),
      cmocka_unit_test(the_papers_search_finds_all_its_patterns),
      cmocka_unit_test(a_stuck_search_goes_on),
      cmocka_unit_test(the_papers_merges_undo_splits),
      cmocka_unit_test(a_pillow_of_two_patches_is_left_alone),
      cmocka_unit_test(a_tetrahedron_does_not_close_up),
      cmocka_unit_test(damaged_meshes_are_taken_as_they_are),
      cmocka_unit_test(a_mesh_without_triangles_gives_nothing),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
