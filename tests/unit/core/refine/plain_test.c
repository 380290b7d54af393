/* The paper's plain rule and sqrt(3), step by step (P5-3, P5-4, P5-5). */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/topology.h"
#include "core/refine/plain.h"
#include "tests/data/shapes.h"

static struct lod_arena *arena;

static int open_arena(void **state) {
  (void)state;
  arena = lod_arena_create(0);
  return arena == NULL;
}
static int close_arena(void **state) {
  (void)state;
  lod_arena_destroy(arena);
  return 0;
}

static struct lod_mesh stepwise(const struct lod_mesh *base, enum lod_stepwise scheme, const struct lod_doi_term *term, uint32_t steps,
                                uint32_t max_triangles) {
  struct lod_doi doi = {.terms = term, .term_count = 1};
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  struct lod_mesh mesh;
  struct lod_problem problem = {0};
  limits.steps = steps;
  limits.max_triangles = max_triangles;
  if (lod_refine_stepwise(base, NULL, scheme, &doi, &limits, NULL, arena, &mesh, NULL, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  assert_true(lod_mesh_check(&mesh, NULL));
  return mesh;
}

static struct lod_topology topology_of(const struct lod_mesh *mesh) {
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &topology), LOD_OK);
  return topology;
}

static struct lod_doi_term from_front(enum lod_doi_kind kind) {
  struct lod_doi_term term = lod_doi_term_defaults(kind);
  term.view.parallel = true;
  return term;
}

static void test_plain_steps_of_everything_are_loop_subdivision(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_grid(arena, 2, 4, 0.5), uniform;
  struct lod_doi_term all = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  struct lod_mesh plain = stepwise(&base, LOD_STEPWISE_PLAIN, &all, 3, 0);
  struct lod_refine_settings settings = lod_refine_defaults();
  settings.positions = LOD_REFINE_LEVEL;
  assert_int_equal(lod_refine_uniform(&base, &settings, 3, UINT64_MAX, arena, &uniform, NULL), LOD_OK);
  assert_int_equal(plain.triangle_count, 64 * base.triangle_count);
  assert_int_equal(plain.vertex_count, uniform.vertex_count);
  for (uint32_t t = 0; t < plain.triangle_count; t++) /* rounded to float in between: not the same bits */
    for (int k = 0; k < 3; k++)
      for (int i = 0; i < 3; i++)
        assert_float_equal(plain.positions[plain.triangles[t][k]][i], uniform.positions[uniform.triangles[t][k]][i], 1e-6);
}

static void test_plain_leaves_other_vertices_where_they_are(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_doi_term term = from_front(LOD_DOI_SILHOUETTE);
  struct lod_mesh mesh = stepwise(&base, LOD_STEPWISE_PLAIN, &term, 1, 0);
  struct lod_topology topology = topology_of(&mesh);
  assert_true(topology.closed && topology.manifold && topology.oriented && topology.euler == 2);
  assert_true(mesh.triangle_count > base.triangle_count && mesh.triangle_count < 4 * base.triangle_count);
  uint32_t kept = 0;
  for (uint32_t v = 0; v < base.vertex_count; v++)
    for (uint32_t w = 0; w < mesh.vertex_count; w++)
      if (memcmp(base.positions[v], mesh.positions[w], sizeof(float[3])) == 0) {
        kept++;
        break;
      }
  assert_true(kept > base.vertex_count / 3 && kept < base.vertex_count);
}

static void test_sqrt3_triples_and_keeps_the_surface_whole(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.7, 12, 8);
  struct lod_doi_term all = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  uint32_t expected = base.triangle_count;
  for (uint32_t steps = 1; steps <= 4; steps++) {
    struct lod_mesh mesh = stepwise(&base, LOD_STEPWISE_SQRT3, &all, steps, 0);
    expected *= 3;
    assert_int_equal(mesh.triangle_count, expected);
    struct lod_topology topology = topology_of(&mesh);
    assert_true(topology.closed && topology.manifold && topology.oriented && topology.euler == 0);
    /* Edges are turned in every step: new vertices have six neighbours after the next. */
    uint32_t *valence = LOD_NEW_ZERO(arena, mesh.vertex_count, uint32_t), regular = 0;
    for (uint32_t t = 0; t < mesh.triangle_count; t++)
      for (int k = 0; k < 3; k++)
        valence[mesh.triangles[t][k]]++;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
      regular += valence[v] == 6;
    assert_int_equal(regular, mesh.vertex_count); /* as the torus itself */
  }
}

static void test_sqrt3_refines_where_it_is_asked_without_degenerating(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_doi_term term = from_front(LOD_DOI_FACE_ANGLE);
  struct lod_mesh mesh = stepwise(&base, LOD_STEPWISE_SQRT3, &term, 5, 0);
  struct lod_topology topology = topology_of(&mesh);
  assert_true(topology.closed && topology.manifold && topology.oriented && topology.euler == 2);
  assert_true(mesh.triangle_count > 3 * base.triangle_count && mesh.triangle_count < 100 * base.triangle_count);
  double worst = 180;
  for (uint32_t t = 0; t < mesh.triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      struct lod_vec3 p = lod_vec3_from_float(mesh.positions[mesh.triangles[t][k]]);
      struct lod_vec3 a = lod_vec3_normalize(lod_vec3_subtract(lod_vec3_from_float(mesh.positions[mesh.triangles[t][(k + 1) % 3]]), p));
      struct lod_vec3 b = lod_vec3_normalize(lod_vec3_subtract(lod_vec3_from_float(mesh.positions[mesh.triangles[t][(k + 2) % 3]]), p));
      worst = fmin(worst, acos(fmin(1, lod_vec3_dot(a, b))) * 57.29578);
    }
  assert_true(worst > 8); /* a triangle split again and again without turning its edges would have a third of a third of 60 */
}

static void test_stepwise_budgets_hold(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_doi_term term = from_front(LOD_DOI_FACE_ANGLE);
  for (int scheme = 0; scheme < 2; scheme++)
    for (uint32_t budget = 400; budget < 10000; budget *= 2) {
      struct lod_mesh mesh = stepwise(&base, (enum lod_stepwise)scheme, &term, 5, budget);
      assert_true(mesh.triangle_count <= budget && mesh.triangle_count > base.triangle_count);
      struct lod_topology topology = topology_of(&mesh);
      assert_true(topology.closed && topology.manifold);
    }
}

static void test_stepwise_carries_attributes_and_refuses_what_it_cannot(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_grid(arena, 2, 4, 0), result;
  struct lod_doi_term all = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  for (int scheme = 0; scheme < 2; scheme++) {
    struct lod_mesh mesh = stepwise(&base, (enum lod_stepwise)scheme, &all, 2, 0);
    assert_non_null(mesh.uvs[0]);
    for (uint32_t w = 0; w < mesh.wedge_count; w++)
      for (int k = 0; k < 2; k++)
        assert_true(mesh.uvs[0][w][k] >= -1e-6f && mesh.uvs[0][w][k] <= 1 + 1e-6f);
  }
  struct lod_doi_term touch = lod_doi_term_defaults(LOD_DOI_CONTACT);
  struct lod_doi doi = {.terms = &touch, .term_count = 1};
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  struct lod_problem problem = {0};
  assert_int_equal(lod_refine_stepwise(&base, NULL, LOD_STEPWISE_PLAIN, &doi, &limits, NULL, arena, &result, NULL, &problem),
                   LOD_UNSUPPORTED);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_plain_steps_of_everything_are_loop_subdivision),
      cmocka_unit_test(test_plain_leaves_other_vertices_where_they_are),
      cmocka_unit_test(test_sqrt3_triples_and_keeps_the_surface_whole),
      cmocka_unit_test(test_sqrt3_refines_where_it_is_asked_without_degenerating),
      cmocka_unit_test(test_stepwise_budgets_hold),
      cmocka_unit_test(test_stepwise_carries_attributes_and_refuses_what_it_cannot),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
