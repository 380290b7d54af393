/* What the envelope's modes promise beyond epsilon: limited regions, kept edges, nested levels, replacement triangles, epsilon 0; and what
 * the stages under it promise by themselves. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/tolerance.h"
#include "core/envelope/envelope.h"
#include "core/envelope/internal.h"
#include "core/mesh/distance.h"
#include "core/mesh/distance_rms.h"
#include "core/mesh/topology.h"
#include "core/mesh/triangle_distance.h"
#include "tests/data/shapes.h"

enum { MOST = 4 };

/* Levels as they came, finest first. */
struct kept {
  struct lod_arena *arena;
  uint32_t source_vertices, count;
  struct lod_mesh mesh[MOST];
  uint32_t *parents[MOST], *replacements[MOST];
  double bound[MOST];
};

static enum lod_status keep(void *context, const struct lod_level *level) {
  struct kept *kept = context;
  const struct lod_mesh *mesh = &level->meshes[0];
  struct lod_mesh *to = &kept->mesh[kept->count];
  assert_true(kept->count < MOST);
  *to = (struct lod_mesh){.vertex_count = mesh->vertex_count, .triangle_count = mesh->triangle_count};
  to->positions = lod_arena_copy(kept->arena, mesh->positions, mesh->vertex_count * sizeof *mesh->positions);
  to->triangles = lod_arena_copy(kept->arena, mesh->triangles, mesh->triangle_count * sizeof *mesh->triangles);
  if (level->parents != NULL)
    kept->parents[kept->count] = lod_arena_copy(kept->arena, level->parents[0], mesh->vertex_count * sizeof(uint32_t));
  kept->replacements[kept->count] = lod_arena_copy(kept->arena, level->replacements[0], kept->source_vertices * sizeof(uint32_t));
  kept->bound[kept->count++] = level->bound;
  return LOD_OK;
}

static void bake(struct lod_arena *arena, struct lod_mesh *mesh, struct lod_envelope_settings *settings, const double *epsilons,
                 uint32_t count, struct kept *kept) {
  *kept = (struct kept){.arena = arena, .source_vertices = mesh->vertex_count};
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  settings->epsilons = epsilons;
  settings->epsilon_count = count;
  settings->least_gain = settings->reserve = 0;
  settings->threads = 1;
  struct lod_problem problem = {0};
  assert_int_equal(lod_envelope_family.build(&unit, 1, settings, NULL, arena, keep, kept, &problem), LOD_OK);
  assert_int_equal(kept->count, count);
}

static void with_arena(void (*body)(struct lod_arena *arena)) {
  struct lod_arena *arena = lod_arena_create(0);
  assert_non_null(arena);
  body(arena);
  lod_arena_destroy(arena);
}

/* The triangles whose corners all have x over `least`. */
static struct lod_mesh part_of(struct lod_arena *arena, const struct lod_mesh *mesh, double least) {
  struct lod_mesh part = *mesh;
  part.triangle_count = 0;
  part.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *part.triangles);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    bool in = true;
    for (int k = 0; k < 3; k++)
      in = in && (double)mesh->positions[mesh->triangles[t][k]][0] > least;
    if (in)
      memcpy(part.triangles[part.triangle_count++], mesh->triangles[t], sizeof *part.triangles);
  }
  return part;
}

static double far_from(struct lod_arena *arena, const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_distance_settings settings = lod_distance_defaults();
  struct lod_distance distance;
  settings.threads = 1;
  assert_int_equal(lod_distance_measure(a, b, &settings, arena, &distance), LOD_OK);
  return distance.a_to_b.lower;
}

static void limited(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 4);
  double *limits = LOD_NEW(arena, mesh.vertex_count, double), epsilon = 0.2;
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    limits[v] = mesh.positions[v][0] > 0 ? 0.01 : INFINITY;
  struct lod_envelope_wishes wishes = {.limits = limits};
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct kept all, limited;
  bake(arena, &mesh, &settings, &epsilon, 1, &all);
  settings.wishes = &wishes;
  bake(arena, &mesh, &settings, &epsilon, 1, &limited);
  struct lod_mesh half = part_of(arena, &mesh, 0);
  assert_true(far_from(arena, &half, &limited.mesh[0]) <= 0.01);
  assert_true(far_from(arena, &half, &all.mesh[0]) > 0.01);
  assert_true(far_from(arena, &mesh, &limited.mesh[0]) <= epsilon);
  /* And forward: what of the level lies well inside of the half is near it too. */
  struct lod_mesh front = part_of(arena, &limited.mesh[0], 0.25);
  assert_true(front.triangle_count > 0 && far_from(arena, &front, &mesh) <= 0.01);
  assert_true(limited.mesh[0].triangle_count > all.mesh[0].triangle_count);
  assert_true(limited.mesh[0].triangle_count < mesh.triangle_count / 16); /* 434 when all is at 0.01, 16 at 0.2 */
}

static double rms_of(struct lod_arena *arena, const struct lod_mesh *source, const struct lod_mesh *level) {
  struct lod_bvh *from, *to;
  double rms;
  assert_int_equal(lod_bvh_create(source, 1, arena, &from), LOD_OK);
  assert_int_equal(lod_bvh_create(level, 1, arena, &to), LOD_OK);
  assert_int_equal(lod_distance_sample_rms(from, to, 1, arena, &rms), LOD_OK);
  return rms;
}

/* A mesh that uses all of its epsilon is farther off in the mean than one that is asked to mind the mean too. */
static void mean_error(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_torus(arena, 2, 0.6, 64, 32);
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct kept most, mean;
  double epsilon = 0.1;
  bake(arena, &mesh, &settings, &epsilon, 1, &most);
  settings.collapse.rms = 0.15;
  bake(arena, &mesh, &settings, &epsilon, 1, &mean);
  assert_true(mean.mesh[0].triangle_count > most.mesh[0].triangle_count && mean.mesh[0].triangle_count < mesh.triangle_count / 2);
  assert_true(rms_of(arena, &mesh, &mean.mesh[0]) < 0.6 * rms_of(arena, &mesh, &most.mesh[0]));
}

static void test_the_mean_error_can_be_minded_too(void **state) {
  (void)state;
  with_arena(mean_error);
}

static void test_a_limited_region_stays_nearer_than_epsilon(void **state) {
  (void)state;
  with_arena(limited);
}

static bool has_edge(const struct lod_mesh *mesh, const float p[3], const float q[3]) {
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      const float *a = mesh->positions[mesh->triangles[t][k]], *b = mesh->positions[mesh->triangles[t][(k + 1) % 3]];
      if ((memcmp(a, p, sizeof(float[3])) == 0 && memcmp(b, q, sizeof(float[3])) == 0) ||
          (memcmp(b, p, sizeof(float[3])) == 0 && memcmp(a, q, sizeof(float[3])) == 0))
        return true;
    }
  return false;
}

static void kept_edges(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_grid(arena, 1, 20, 0.1);
  uint32_t edges[12][2];
  for (uint32_t i = 0; i < 12; i++) { /* here and there */
    edges[i][0] = mesh.triangles[31 + 50 * i][0];
    edges[i][1] = mesh.triangles[31 + 50 * i][1];
  }
  struct lod_envelope_wishes wishes = {.edges = (const uint32_t(*)[2])edges, .edge_count = 12};
  double epsilons[3] = {0.01, 0.1, 1};
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct kept free_levels, kept;
  bake(arena, &mesh, &settings, epsilons, 3, &free_levels);
  settings.wishes = &wishes;
  bake(arena, &mesh, &settings, epsilons, 3, &kept);
  uint32_t still_there = 0;
  for (uint32_t i = 0; i < 12; i++) {
    const float *p = mesh.positions[edges[i][0]], *q = mesh.positions[edges[i][1]];
    for (uint32_t level = 0; level < 3; level++)
      assert_true(has_edge(&kept.mesh[level], p, q));
    still_there += has_edge(&free_levels.mesh[2], p, q);
  }
  assert_int_equal(still_there, 0);
  assert_true(kept.mesh[2].triangle_count < mesh.triangle_count / 4);
}

static void test_edges_asked_for_stay_at_any_epsilon(void **state) {
  (void)state;
  with_arena(kept_edges);
}

static void nested(struct lod_arena *arena) {
  struct lod_mesh shapes[2] = {lod_shape_torus(arena, 2, 0.6, 32, 16), lod_shape_grid(arena, 2, 24, 0.3)};
  double epsilons[4] = {0.01, 0.04, 0.1, 0.3};
  for (int i = 0; i < 2; i++) {
    struct lod_envelope_settings settings = lod_envelope_defaults();
    struct kept kept;
    settings.collapse.vertex_subset = true;
    bake(arena, &shapes[i], &settings, epsilons, 4, &kept);
    for (uint32_t level = 0; level < 4; level++) {
      const struct lod_mesh *mesh = &kept.mesh[level], *finer = level == 0 ? &shapes[i] : &kept.mesh[level - 1];
      assert_non_null(kept.parents[level]);
      assert_true(mesh->vertex_count < finer->vertex_count);
      for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        assert_true(kept.parents[level][v] < finer->vertex_count);
        assert_memory_equal(mesh->positions[v], finer->positions[kept.parents[level][v]], sizeof(float[3]));
      }
    }
  }
}

static void test_vertices_of_nested_levels_are_vertices_of_the_finer_one(void **state) {
  (void)state;
  with_arena(nested);
}

static void replaced(struct lod_arena *arena) {
  struct lod_mesh shapes[2] = {lod_shape_torus(arena, 2, 0.6, 32, 16), lod_shape_tree(arena, 2, true)};
  double epsilons[3] = {0.01, 0.05, 0.2};
  for (int i = 0; i < 2; i++) {
    struct lod_envelope_settings settings = lod_envelope_defaults();
    struct kept kept;
    bake(arena, &shapes[i], &settings, epsilons, 3, &kept);
    for (uint32_t level = 0; level < 3; level++)
      for (uint32_t v = 0; v < shapes[i].vertex_count; v++) {
        assert_true(kept.replacements[level][v] < kept.mesh[level].triangle_count);
        const uint32_t *t = kept.mesh[level].triangles[kept.replacements[level][v]];
        struct lod_triangle_probe probe = lod_triangle_prepare(lod_vec3_from_float(kept.mesh[level].positions[t[0]]),
                                                               lod_vec3_from_float(kept.mesh[level].positions[t[1]]),
                                                               lod_vec3_from_float(kept.mesh[level].positions[t[2]]));
        double d2 = lod_triangle_distance_squared(&probe, lod_vec3_from_float(shapes[i].positions[v]));
        assert_true(sqrt(d2) <= kept.bound[level]);
      }
  }
}

static void test_every_vertex_has_a_triangle_near_it_that_replaces_it(void **state) {
  (void)state;
  with_arena(replaced);
}

static void coplanar(struct lod_arena *arena) {
  double nothing = 0;
  struct kept kept;
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct lod_mesh grid = lod_shape_grid(arena, 1, 24, 0), bumpy = lod_shape_grid(arena, 1, 24, 0.2);
  bake(arena, &grid, &settings, &nothing, 1, &kept);
  assert_int_equal(kept.mesh[0].triangle_count, 2);
  grid.wedge_count = 0; /* without UV nothing bounds attributes, and a draft would be made if it could be */
  grid.corners = NULL;
  grid.uvs[0] = NULL;
  bake(arena, &grid, &settings, &nothing, 1, &kept);
  assert_int_equal(kept.mesh[0].triangle_count, 2);
  assert_true(kept.bound[0] > 0 && kept.bound[0] <= 1e-6);
  bake(arena, &bumpy, &settings, &nothing, 1, &kept);
  assert_true(kept.mesh[0].triangle_count > bumpy.triangle_count * 9 / 10);
  for (uint32_t v = 0; v < grid.vertex_count; v++) { /* a plane askew: coplanar up to the rounding of floats */
    double x = (double)grid.positions[v][0], y = (double)grid.positions[v][1];
    grid.positions[v][2] = (float)(0.3 * x + 0.7 * y);
  }
  bake(arena, &grid, &settings, &nothing, 1, &kept);
  assert_in_range(kept.mesh[0].triangle_count, 2, 4);
}

static void test_epsilon_0_takes_together_what_is_coplanar_alone(void **state) {
  (void)state;
  with_arena(coplanar);
}

static void refused(struct lod_arena *arena) {
  const double bad[][2] = {{-1, 1}, {NAN, 1}, {INFINITY, 1}, {0.1, 0.1}, {0.2, 0.1}};
  struct lod_unit unit = {.mesh = lod_shape_grid(arena, 1, 4, 0), .scale = 1};
  for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
    struct lod_envelope_settings settings = lod_envelope_defaults();
    struct lod_problem problem = {0};
    struct kept kept = {.arena = arena};
    settings.epsilons = bad[i];
    settings.epsilon_count = 2;
    assert_int_equal(lod_envelope_family.build(&unit, 1, &settings, NULL, arena, keep, &kept, &problem), LOD_BAD_INPUT);
    assert_non_null(strstr(problem.detail, "Epsilons must be"));
  }
}

static void test_epsilons_that_are_negative_or_no_number_are_refused(void **state) {
  (void)state;
  with_arena(refused);
}

/* The draft has no certificate to lean on: its bound is measured here. */
static void drafts(struct lod_arena *arena) {
  struct lod_mesh shapes[] = {lod_shape_sphere(arena, 1, 4), lod_shape_torus(arena, 2, 0.6, 120, 60), lod_shape_grid(arena, 1, 40, 0.2),
                              lod_shape_tree(arena, 2, true)};
  for (size_t i = 0; i < sizeof shapes / sizeof shapes[0]; i++)
    for (int step = 0; step < 3; step++) {
      double limit = step == 0 ? 0.003 : step == 1 ? 0.03 : 0.3, proven;
      struct lod_bvh *bvh;
      struct lod_collapser *c;
      assert_int_equal(lod_bvh_create(&shapes[i], 1, arena, &bvh), LOD_OK);
      assert_int_equal(lod_collapser_create(&shapes[i], bvh, NULL, NULL, arena, &c), LOD_OK);
      c->epsilon = 2 * limit;
      c->gate = INFINITY; /* whatever the bounds allow */
      assert_int_equal(lod_draft_run(c, limit, NULL, &proven), LOD_OK);
      assert_true(lod_surface_check(&c->surface));
      assert_true(proven <= limit && c->surface.live_faces < shapes[i].triangle_count);
      struct lod_mesh draft;
      uint32_t *face_to = LOD_NEW(arena, c->surface.face_count, uint32_t);
      assert_int_equal(lod_collapser_extract_surface(c, arena, &draft, face_to), LOD_OK);
      assert_true(far_from(arena, &draft, &shapes[i]) <= proven);
      assert_true(far_from(arena, &shapes[i], &draft) <= proven);
    }
}

static void test_a_draft_stays_within_the_bound_of_its_map(void **state) {
  (void)state;
  with_arena(drafts);
}

/* What the level before has taken of epsilon, a draft that goes on from it has to reckon with. */
static void drafts_of_levels(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_torus(arena, 2, 0.6, 60, 30);
  struct lod_bvh *bvh;
  struct lod_collapser *c;
  double proven;
  assert_int_equal(lod_bvh_create(&mesh, 1, arena, &bvh), LOD_OK);
  assert_int_equal(lod_collapser_create(&mesh, bvh, NULL, NULL, arena, &c), LOD_OK);
  assert_int_equal(lod_collapser_run(c, 0.03, NULL), LOD_OK);
  c->gate = INFINITY;
  assert_int_equal(lod_draft_run(c, 0.04, NULL, &proven), LOD_OK);
  struct lod_mesh draft;
  uint32_t *face_to = LOD_NEW(arena, c->surface.face_count, uint32_t);
  assert_int_equal(lod_collapser_extract_surface(c, arena, &draft, face_to), LOD_OK);
  assert_true(proven >= 0.03 && proven <= 0.04);
  assert_true(far_from(arena, &draft, &mesh) <= proven && far_from(arena, &mesh, &draft) <= proven);
}

static void test_a_draft_of_a_later_level_reckons_with_the_one_before(void **state) {
  (void)state;
  with_arena(drafts_of_levels);
}

static void flips(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_torus(arena, 2, 0.6, 14, 9);
  struct lod_surface s;
  uint64_t seed = 3;
  uint32_t flipped = 0;
  assert_int_equal(lod_surface_create(&mesh, NULL, arena, &s), LOD_OK);
  for (int i = 0; i < 2000; i++) {
    uint32_t f = (uint32_t)(lod_random_unit(&seed) * s.face_count), g;
    int k = (int)(lod_random_unit(&seed) * 3);
    if (!lod_surface_can_flip(&s, f, k, &g))
      continue;
    assert_int_equal(lod_surface_flip(&s, f, k, g), LOD_OK);
    flipped++;
  }
  assert_true(flipped > 500 && lod_surface_check(&s));
  struct lod_mesh after = mesh;
  after.triangles = s.face;
  struct lod_topology before_topology, after_topology;
  assert_int_equal(lod_topology_measure(&mesh, NULL, arena, &before_topology), LOD_OK);
  assert_int_equal(lod_topology_measure(&after, NULL, arena, &after_topology), LOD_OK);
  assert_true(after_topology.manifold && after_topology.oriented && after_topology.closed);
  assert_int_equal(after_topology.genus, before_topology.genus);
}

static void test_flips_keep_a_torus_a_torus(void **state) {
  (void)state;
  with_arena(flips);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_the_mean_error_can_be_minded_too),
      cmocka_unit_test(test_a_limited_region_stays_nearer_than_epsilon),
      cmocka_unit_test(test_edges_asked_for_stay_at_any_epsilon),
      cmocka_unit_test(test_vertices_of_nested_levels_are_vertices_of_the_finer_one),
      cmocka_unit_test(test_every_vertex_has_a_triangle_near_it_that_replaces_it),
      cmocka_unit_test(test_epsilon_0_takes_together_what_is_coplanar_alone),
      cmocka_unit_test(test_epsilons_that_are_negative_or_no_number_are_refused),
      cmocka_unit_test(test_a_draft_stays_within_the_bound_of_its_map),
      cmocka_unit_test(test_a_draft_of_a_later_level_reckons_with_the_one_before),
      cmocka_unit_test(test_flips_keep_a_torus_a_torus),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
