/* The map between two nested levels. Checklist: P1-30 (fragments split by coarse edges, with the number of their finer triangle), P1-31 (no
 * fragment is cut by an edge that is in neither level: pieces are whole by construction), P1-32 (t = 0 is the coarse level and t = 1 the
 * finer one, certified; areas sum exactly), P1-33 (every finer vertex knows its coarse triangle). P1-28 and P1-29, the nesting itself, are
 * retile_test.c's. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/distance.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static double diagonal_of(const struct lod_mesh *mesh) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  return lod_bounds_diagonal(&bounds);
}

/* The certified distance of the fragments at t = 0 or 1 from a level. */
static double distance_at(const struct lod_morph *morph, bool end, const struct lod_mesh *level, struct lod_arena *arena) {
  struct lod_mesh shape = {.vertex_count = morph->vertex_count,
                           .triangle_count = morph->triangle_count,
                           .positions = end ? morph->end : morph->start,
                           .triangles = morph->triangles};
  struct lod_distance distance;
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.absolute = 1e-7 * diagonal_of(level);
  assert_int_equal(lod_distance_measure(&shape, level, &settings, arena, &distance), LOD_OK);
  return distance.two_sided.upper;
}

/* Lays one over the other, checks it in integers, and returns how many coarse triangles are not mapped. */
static uint32_t check_step(const char *name, const struct lod_mesh *coarse, const struct lod_mesh *fine, const uint32_t *parents,
                           bool shapes, struct lod_arena *arena) {
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  assert_int_equal(lod_overlay_create(coarse, fine, parents, NULL, arena, &overlay, NULL), LOD_OK);
  assert_int_equal(lod_overlay_check(&overlay, coarse, fine, parents, arena, &facts), LOD_OK);
  if (!facts.valid)
    fail_msg("%s: %s", name, facts.reason);
  assert_int_equal(facts.coarse_area, overlay.mapped);
  for (uint32_t v = 0; overlay.failed == 0 && v < fine->vertex_count; v++)
    assert_true(overlay.fine[v].face == LOD_NONE || overlay.coarse[v].face < coarse->triangle_count);
  struct lod_morph morph;
  assert_int_equal(lod_overlay_fragments(&overlay, coarse, fine, NULL, arena, &morph), LOD_OK);
  assert_int_equal(morph.triangle_count, overlay.triangle_count);
  if (shapes && overlay.failed == 0) {
    assert_true(distance_at(&morph, false, coarse, arena) <= 1e-6 * diagonal_of(fine));
    assert_true(distance_at(&morph, true, fine, arena) <= 1e-6 * diagonal_of(fine));
  }
  return overlay.failed;
}

/* Re-tiles and checks every step. */
static uint32_t check_levels(const char *name, const struct lod_mesh *mesh, const uint32_t *counts, uint32_t level_count, bool shapes) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  uint32_t failed = 0;
  settings.vertices = counts;
  settings.level_count = level_count;
  assert_int_equal(lod_retile_create(mesh, &settings, NULL, arena, &retile, NULL), LOD_OK);
  for (uint32_t k = 0; k + 1 < retile.level_count; k++)
    failed += check_step(name, &retile.levels[k].mesh, &retile.levels[k + 1].mesh, retile.levels[k].parents, shapes, arena);
  lod_arena_destroy(arena);
  return failed;
}

static uint32_t *identity(const struct lod_mesh *mesh, struct lod_arena *arena) {
  uint32_t *parents = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    parents[v] = v;
  return parents;
}

static void a_level_over_itself_is_its_own_triangles(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_torus(arena, 2, 0.7, 24, 12);
  struct lod_overlay overlay;
  assert_int_equal(lod_overlay_create(&mesh, &mesh, identity(&mesh, arena), NULL, arena, &overlay, NULL), LOD_OK);
  assert_int_equal(overlay.mapped, mesh.triangle_count);
  assert_int_equal(overlay.triangle_count, mesh.triangle_count);
  assert_int_equal(overlay.node_count, mesh.vertex_count);
  for (uint32_t i = 0; i < overlay.triangle_count; i++)
    assert_int_equal(overlay.coarse_faces[i], overlay.fine_faces[i]);
  lod_arena_destroy(arena);
}

/* An icosahedron and its subdivision into four: fine edges between middles, coarse edges along two fine ones. */
static void a_subdivided_sphere_needs_no_crossing(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh coarse = lod_shape_sphere(arena, 1, 1), fine = lod_shape_sphere(arena, 1, 2);
  uint32_t *parents = LOD_NEW(arena, coarse.vertex_count, uint32_t);
  struct lod_overlay overlay;
  assert_int_equal(lod_overlay_match(&coarse, &fine, 1e-5, arena, parents), LOD_OK);
  for (uint32_t v = 0; v < coarse.vertex_count; v++)
    assert_true(parents[v] != LOD_NONE);
  assert_int_equal(check_step("sphere", &coarse, &fine, parents, true, arena), 0);
  assert_int_equal(lod_overlay_create(&coarse, &fine, parents, NULL, arena, &overlay, NULL), LOD_OK);
  assert_int_equal(overlay.mapped, coarse.triangle_count);
  lod_arena_destroy(arena);
}

/* A square of two triangles over a fan whose middle lies on no coarse edge: fragments by hand. */
static void a_square_is_cut_along_its_diagonal(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  float corners[5][3] = {{0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {0, 4, 0}, {1, 3, 1}};
  uint32_t two[2][3] = {{0, 1, 2}, {0, 2, 3}}, four[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
  struct lod_mesh coarse = {.vertex_count = 4, .triangle_count = 2, .positions = corners, .triangles = two};
  struct lod_mesh fine = {.vertex_count = 5, .triangle_count = 4, .positions = corners, .triangles = four};
  uint32_t parents[4] = {0, 1, 2, 3};
  struct lod_overlay overlay;
  assert_int_equal(check_step("square", &coarse, &fine, parents, true, arena), 0);
  assert_int_equal(lod_overlay_create(&coarse, &fine, parents, NULL, arena, &overlay, NULL), LOD_OK);
  assert_int_equal(overlay.coarse[4].face, 1);    /* the fan's middle lies beyond the diagonal ... */
  assert_int_equal(overlay.crossing_begin[6], 1); /* ... so the diagonal crosses one edge, from it to corner 1 ... */
  assert_int_equal(overlay.fine[5].weights[0] + overlay.fine[5].weights[1] + overlay.fine[5].weights[2], LOD_OVERLAY_ONE);
  assert_int_equal(overlay.triangle_count, 6); /* ... and two triangles are cut in two */
  lod_arena_destroy(arena);
}

static void shapes_of_every_kind_are_mapped_whole(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  const uint32_t counts[] = {40, 160, 640}, few[] = {8, 60};
  struct lod_mesh grid = lod_shape_grid(arena, 2, 30, 0.4), torus = lod_shape_torus(arena, 2, 0.8, 60, 30),
                  tube = lod_shape_tube(arena, 0.4, 4, 24, 40), cube = lod_shape_cube(arena, 2), sphere = lod_shape_sphere(arena, 1, 4);
  const double offset[3] = {6, 0, 0};
  struct lod_mesh both = lod_shape_join(arena, &torus, &grid, offset);
  assert_int_equal(check_levels("grid", &grid, counts, 3, true), 0);
  assert_int_equal(check_levels("torus", &torus, counts, 3, true), 0);
  assert_int_equal(check_levels("tube", &tube, counts, 3, true), 0);
  assert_int_equal(check_levels("cube", &cube, few, 2, true), 0);
  assert_int_equal(check_levels("sphere", &sphere, counts, 3, true), 0);
  assert_int_equal(check_levels("both", &both, counts, 3, true), 0);
  lod_arena_destroy(arena);
}

/* A fin: an edge of three triangles. It cuts the surface in three, which each have their map. */
static void an_edge_of_three_triangles_is_kept(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh grid = lod_shape_grid(arena, 2, 10, 0.2), mesh = grid;
  mesh.positions = lod_arena_alloc(arena, grid.vertex_count + 1, sizeof *mesh.positions);
  mesh.triangles = lod_arena_alloc(arena, grid.triangle_count + 1, sizeof *mesh.triangles);
  memcpy(mesh.positions, grid.positions, grid.vertex_count * sizeof *mesh.positions);
  memcpy(mesh.triangles, grid.triangles, grid.triangle_count * sizeof *mesh.triangles);
  const uint32_t *t = grid.triangles[grid.triangle_count / 2];
  mesh.positions[grid.vertex_count][0] = mesh.positions[t[0]][0];
  mesh.positions[grid.vertex_count][1] = mesh.positions[t[0]][1];
  mesh.positions[grid.vertex_count][2] = 1;
  uint32_t fin[3] = {t[0], t[1], grid.vertex_count};
  memcpy(mesh.triangles[grid.triangle_count], fin, sizeof fin);
  mesh.vertex_count++;
  mesh.triangle_count++;
  mesh.corners = NULL;
  mesh.wedge_count = 0;
  mesh.uvs[0] = NULL;
  const uint32_t counts[] = {20, 90};
  assert_int_equal(check_levels("fin", &mesh, counts, 2, true), 0);
  lod_arena_destroy(arena);
}

/* A strip bent around until the middles of its ends meet in one vertex, which its border passes twice and the coarser level has not. */
static void a_border_that_passes_a_vertex_twice_is_no_crash(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  enum { BENDS = 12, STRIP = 2 * BENDS, PINCH = STRIP };
  float positions[STRIP + 1][3] = {{0}};
  uint32_t coarse_triangles[STRIP - 2][3], fine_triangles[STRIP][3], parents[STRIP], count = 0;
  for (uint32_t i = 0; i < BENDS; i++) /* inner and outer corners by turns */
    for (uint32_t side = 0; side < 2; side++) {
      double angle = 0.1 + 6.08 * i / (BENDS - 1);
      positions[2 * i + side][0] = (float)((1 + side) * cos(angle));
      positions[2 * i + side][1] = (float)((1 + side) * sin(angle));
      parents[2 * i + side] = 2 * i + side;
    }
  positions[PINCH][0] = 1.5f;
  for (uint32_t v = 0; v + 2 < STRIP; v++) {
    const uint32_t t[3] = {v, v % 2 == 0 ? v + 1 : v + 2, v % 2 == 0 ? v + 2 : v + 1};
    memcpy(coarse_triangles[v], t, sizeof t);
    if (v != 0 && v + 3 != STRIP) {
      memcpy(fine_triangles[count++], t, sizeof t);
      continue;
    }
    uint32_t a = v == 0 ? 0 : STRIP - 2, b = v == 0 ? 1 : STRIP - 1; /* the end, which is cut in two */
    for (uint32_t half = 0; half < 2; half++, count++)
      for (int k = 0; k < 3; k++)
        fine_triangles[count][k] = t[k] == (half == 0 ? a : b) ? PINCH : t[k];
  }
  struct lod_mesh fine = {.vertex_count = STRIP + 1, .triangle_count = count, .positions = positions, .triangles = fine_triangles};
  struct lod_mesh coarse = {.vertex_count = STRIP, .triangle_count = STRIP - 2, .positions = positions, .triangles = coarse_triangles};
  uint32_t failed = check_step("pinched strip", &coarse, &fine, parents, false, arena);
  assert_true(failed >= 1 && failed <= 2); /* one path at most runs through the vertex */
  lod_arena_destroy(arena);
}

/* A torus cannot be mapped onto a sphere: what is left says so, and the rest is still valid. */
static void levels_of_different_topology_say_so(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh fine = lod_shape_torus(arena, 2, 0.7, 24, 12);
  float positions[4][3];
  uint32_t triangles[4][3] = {{0, 1, 2}, {0, 2, 3}, {0, 3, 1}, {1, 3, 2}}, parents[4] = {0, 80, 150, 230};
  for (int v = 0; v < 4; v++)
    memcpy(positions[v], fine.positions[parents[v]], sizeof positions[v]);
  struct lod_mesh coarse = {.vertex_count = 4, .triangle_count = 4, .positions = positions, .triangles = triangles};
  assert_true(check_step("torus over tetrahedron", &coarse, &fine, parents, true, arena) > 0);
  uint32_t none[4] = {LOD_NONE, LOD_NONE, LOD_NONE, LOD_NONE};
  assert_int_equal(check_step("no parents", &coarse, &fine, none, false, arena), 4);
  lod_arena_destroy(arena);
}

static void wrong_parents_are_bad_input(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_cube(arena, 1);
  struct lod_overlay overlay;
  struct lod_problem problem = {0};
  uint32_t *parents = identity(&mesh, arena);
  parents[3] = 2;
  assert_int_equal(lod_overlay_create(&mesh, &mesh, parents, NULL, arena, &overlay, &problem), LOD_BAD_INPUT);
  parents[3] = 8;
  assert_int_equal(lod_overlay_create(&mesh, &mesh, parents, NULL, arena, &overlay, NULL), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "bad-parents");
  lod_arena_destroy(arena);
}

/* Half a step of one weight, and the check sees it. */
static void the_check_sees_a_moved_point(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh coarse = lod_shape_sphere(arena, 1, 1), fine = lod_shape_sphere(arena, 1, 3);
  uint32_t *parents = LOD_NEW(arena, coarse.vertex_count, uint32_t), moved = LOD_NONE;
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  assert_int_equal(lod_overlay_match(&coarse, &fine, 1e-5, arena, parents), LOD_OK);
  assert_int_equal(lod_overlay_create(&coarse, &fine, parents, NULL, arena, &overlay, NULL), LOD_OK);
  for (uint32_t v = 0; v < fine.vertex_count && moved == LOD_NONE; v++)
    if (overlay.coarse[v].weights[0] != 0 && overlay.coarse[v].weights[1] != 0 && overlay.coarse[v].weights[2] != 0)
      moved = v;
  assert_true(moved != LOD_NONE);
  struct lod_overlay_place keep = overlay.coarse[moved];
  overlay.coarse[moved].weights[0]--;
  assert_int_equal(lod_overlay_check(&overlay, &coarse, &fine, parents, arena, &facts), LOD_OK);
  assert_false(facts.valid);
  overlay.coarse[moved] = keep;
  overlay.coarse[moved].weights[0] = LOD_OVERLAY_ONE - 2;
  overlay.coarse[moved].weights[1] = overlay.coarse[moved].weights[2] = 1;
  assert_int_equal(lod_overlay_check(&overlay, &coarse, &fine, parents, arena, &facts), LOD_OK);
  assert_false(facts.valid);
  overlay.coarse[moved] = keep;
  overlay.triangles[5][1] = overlay.triangles[5][0];
  assert_int_equal(lod_overlay_check(&overlay, &coarse, &fine, parents, arena, &facts), LOD_OK);
  assert_false(facts.valid);
  lod_arena_destroy(arena);
}

static void the_same_levels_give_the_same_bits(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_grid(arena, 2, 24, 0.5);
  const uint32_t counts[] = {50, 200};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  struct lod_overlay first, second;
  settings.vertices = counts;
  settings.level_count = 2;
  assert_int_equal(lod_retile_create(&mesh, &settings, NULL, arena, &retile, NULL), LOD_OK);
  const struct lod_retile_level *l = retile.levels;
  assert_int_equal(lod_overlay_create(&l[0].mesh, &l[1].mesh, l[0].parents, NULL, arena, &first, NULL), LOD_OK);
  assert_int_equal(lod_overlay_create(&l[0].mesh, &l[1].mesh, l[0].parents, NULL, arena, &second, NULL), LOD_OK);
  assert_true(lod_overlay_hash(&first) == lod_overlay_hash(&second));
  second.coarse[l[1].mesh.vertex_count - 1].weights[0] ^= 1;
  assert_true(lod_overlay_hash(&first) != lod_overlay_hash(&second));
  lod_arena_destroy(arena);
}

/* Values that are linear on both levels stay so on fragments; the two sides of a seam stay apart. */
static void attributes_follow_both_levels(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_grid(arena, 2, 24, 0.5);
  const uint32_t counts[] = {50, 200};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  settings.vertices = counts;
  settings.level_count = 2;
  assert_int_equal(lod_retile_create(&mesh, &settings, NULL, arena, &retile, NULL), LOD_OK);
  const struct lod_mesh *coarse = &retile.levels[0].mesh, *fine = &retile.levels[1].mesh;
  struct lod_overlay overlay;
  assert_int_equal(lod_overlay_create(coarse, fine, retile.levels[0].parents, NULL, arena, &overlay, NULL), LOD_OK);
  struct lod_morph_values values = {2, &coarse->uvs[0][0][0], &fine->uvs[0][0][0]};
  for (int exact = 0; exact < 2; exact++) {
    struct lod_morph morph;
    assert_int_equal((exact ? lod_overlay_fragments : lod_overlay_vertices)(&overlay, coarse, fine, &values, arena, &morph), LOD_OK);
    for (uint32_t v = 0; v < morph.vertex_count; v++) { /* the grid's UV is its place: (p + 1) / 2 */
      for (int k = 0; k < 2; k++) {
        assert_true(fabs((double)morph.start_values[2 * v + (uint32_t)k] - ((double)morph.start[v][k] / 2 + 0.5)) < 2e-3);
        assert_true(fabs((double)morph.end_values[2 * v + (uint32_t)k] - ((double)morph.end[v][k] / 2 + 0.5)) < 2e-3);
      }
    }
    assert_true(morph.vertex_count == (exact ? overlay.node_count : fine->vertex_count));
  }
  lod_arena_destroy(arena);
}

static void shared_models_are_mapped_whole(void **state) {
  (void)state;
  static const char *const kModels[] = {"scans/bunny.ply",  "scans/cow.ply",    "scans/fandisk.ply",    "cad/block.ply",
                                        "scans/3holes.ply", "scans/teapot.ply", "iso/protein-1crn.ply", "thin/bones-foot-cgal.ply"};
  const char *shared = lod_shared_folder();
  for (size_t i = 0; shared != NULL && i < sizeof kModels / sizeof *kModels; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh raw, mesh;
    char path[4096];
    snprintf(path, sizeof path, "%s/models/%s", shared, kModels[i]);
    const uint32_t counts[] = {300, 1200};
    if (lod_ply_read(path, arena, &raw)) {
      assert_int_equal(lod_mesh_weld(&raw, arena, &mesh, NULL), LOD_OK);
      uint32_t failed = check_levels(kModels[i], &mesh, counts, 2, i < 4);
      if (failed != 0)
        fail_msg("%s: %u coarse triangles are not mapped", kModels[i], failed);
    }
    lod_arena_destroy(arena);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_level_over_itself_is_its_own_triangles),
      cmocka_unit_test(a_subdivided_sphere_needs_no_crossing),
      cmocka_unit_test(a_square_is_cut_along_its_diagonal),
      cmocka_unit_test(shapes_of_every_kind_are_mapped_whole),
      cmocka_unit_test(an_edge_of_three_triangles_is_kept),
      cmocka_unit_test(a_border_that_passes_a_vertex_twice_is_no_crash),
      cmocka_unit_test(levels_of_different_topology_say_so),
      cmocka_unit_test(wrong_parents_are_bad_input),
      cmocka_unit_test(the_check_sees_a_moved_point),
      cmocka_unit_test(the_same_levels_give_the_same_bits),
      cmocka_unit_test(attributes_follow_both_levels),
      cmocka_unit_test(shared_models_are_mapped_whole),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
