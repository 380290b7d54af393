/* A family's maps make certification quick and can never make it wrong. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "server/worker/certify.h"
#include "tests/data/shapes.h"

struct level {
  struct lod_mesh mesh;
  uint32_t *image; /* source vertex -> mesh vertex */
};

/* Vertices are snapped to a coarse grid and merged; triangles that collapse are dropped, as are those already there. Every image must stay
 * covered, which the test's shapes see to: a closed surface whose triangles are smaller than a cell keeps its collapsed edges. */
static struct level snap(struct lod_arena *arena, const struct lod_mesh *source, double cell) {
  struct level level = {.image = LOD_NEW(arena, source->vertex_count, uint32_t)};
  struct lod_mesh *m = &level.mesh;
  *m = (struct lod_mesh){0};
  m->positions = lod_arena_alloc(arena, source->vertex_count, sizeof *m->positions);
  m->triangles = lod_arena_alloc(arena, source->triangle_count, sizeof *m->triangles);
  for (uint32_t v = 0; v < source->vertex_count; v++) {
    float p[3];
    for (int k = 0; k < 3; k++)
      p[k] = (float)(cell * round((double)source->positions[v][k] / cell));
    uint32_t to = 0;
    while (to < m->vertex_count && memcmp(m->positions[to], p, sizeof p) != 0)
      to++;
    if (to == m->vertex_count)
      memcpy(m->positions[m->vertex_count++], p, sizeof p);
    level.image[v] = to;
  }
  for (uint32_t t = 0; t < source->triangle_count; t++) {
    uint32_t v[3];
    for (int k = 0; k < 3; k++)
      v[k] = level.image[source->triangles[t][k]];
    if (v[0] != v[1] && v[1] != v[2] && v[2] != v[0])
      memcpy(m->triangles[m->triangle_count++], v, sizeof v);
  }
  return level;
}

/* What a coder does: other vertex and triangle order, positions moved by at most `error`. */
static struct lod_mesh recode(struct lod_arena *arena, const struct lod_mesh *mesh, double error) {
  struct lod_mesh out = {.vertex_count = mesh->vertex_count, .triangle_count = mesh->triangle_count};
  out.positions = lod_arena_alloc(arena, mesh->vertex_count, sizeof *out.positions);
  out.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *out.triangles);
  uint64_t random = 7;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int k = 0; k < 3; k++)
      out.positions[mesh->vertex_count - 1 - v][k] =
          (float)((double)mesh->positions[v][k] + (2 * lod_random_unit(&random) - 1) * error / 1.8);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      out.triangles[mesh->triangle_count - 1 - t][(k + 1) % 3] = mesh->vertex_count - 1 - mesh->triangles[t][k];
  return out;
}

static struct lod_distance certify(struct lod_arena *arena, const struct lod_mesh *source, const struct level *level,
                                   const struct lod_mesh *decoded, const uint32_t *image, double position_error) {
  struct lod_bvh *bvh;
  assert_int_equal(lod_bvh_create(source, 1, arena, &bvh), LOD_OK);
  struct lod_certify_request request = {.source = source,
                                        .source_bvh = bvh,
                                        .level = &level->mesh,
                                        .decoded = decoded,
                                        .image = image,
                                        .position_error = position_error,
                                        .threads = 2};
  struct lod_distance distance;
  assert_int_equal(lod_certify_unit(&request, arena, &distance), LOD_OK);
  return distance;
}

static struct lod_distance plain(struct lod_arena *arena, const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_distance_settings settings = lod_distance_defaults();
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(a, b, &settings, arena, &distance), LOD_OK);
  return distance;
}

static void agree(const struct lod_distance *a, const struct lod_distance *b) {
  assert_true(a->two_sided.lower <= b->two_sided.upper && b->two_sided.lower <= a->two_sided.upper);
  assert_true(a->two_sided.upper >= a->two_sided.lower && isfinite(a->two_sided.upper));
}

static void maps_agree_with_a_measure_that_has_none(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 4);
  struct level level = snap(arena, &sphere, 0.2);
  struct lod_mesh decoded = recode(arena, &level.mesh, 0.01);
  struct lod_distance with = certify(arena, &sphere, &level, &decoded, level.image, 0.01);
  struct lod_distance without = plain(arena, &sphere, &decoded);
  agree(&with, &without);
  assert_true(with.two_sided.upper <= 0.2 * sqrt(3) / 2 + 0.0101);
  lod_arena_destroy(arena);
}

static void a_wrong_map_never_makes_the_interval_wrong(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.3, 40, 20);
  struct level level = snap(arena, &torus, 0.15);
  struct lod_mesh decoded = recode(arena, &level.mesh, 0.002);
  struct lod_distance truth = plain(arena, &torus, &decoded);
  uint64_t random = 3;
  uint32_t *wrong = LOD_NEW(arena, torus.vertex_count, uint32_t);
  for (uint32_t v = 0; v < torus.vertex_count; v++)
    wrong[v] = lod_random_unit(&random) < 0.2 ? LOD_NONE : (uint32_t)(lod_random_unit(&random) * level.mesh.vertex_count);
  struct lod_distance with = certify(arena, &torus, &level, &decoded, wrong, 0.002);
  agree(&with, &truth);
  lod_arena_destroy(arena);
}

static void a_triangle_lost_in_coding_is_noticed(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh grid = lod_shape_grid(arena, 1, 10, 0);
  struct level level = {.mesh = grid, .image = LOD_NEW(arena, grid.vertex_count, uint32_t)};
  for (uint32_t v = 0; v < grid.vertex_count; v++)
    level.image[v] = v;
  struct lod_mesh decoded = recode(arena, &grid, 0);
  struct lod_distance whole = certify(arena, &grid, &level, &decoded, level.image, 1e-6);
  assert_true(whole.two_sided.upper < 1e-6);
  decoded.triangle_count -= 2; /* the first square of the grid: its corner is now one cell away from what is left */
  struct lod_distance holed = certify(arena, &grid, &level, &decoded, level.image, 1e-6);
  assert_true(holed.two_sided.lower > 0.0985 && holed.two_sided.upper < 0.1015);
  lod_arena_destroy(arena);
}

static void an_identical_mesh_has_only_rounding(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh soup = lod_shape_soup(arena, 300, 0.1, 5);
  struct level level = {.mesh = soup, .image = LOD_NEW(arena, soup.vertex_count, uint32_t)};
  for (uint32_t v = 0; v < soup.vertex_count; v++)
    level.image[v] = v;
  struct lod_distance same = certify(arena, &soup, &level, &soup, level.image, 1e-9);
  assert_true(same.two_sided.upper < 1e-12);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(maps_agree_with_a_measure_that_has_none),
      cmocka_unit_test(a_wrong_map_never_makes_the_interval_wrong),
      cmocka_unit_test(a_triangle_lost_in_coding_is_noticed),
      cmocka_unit_test(an_identical_mesh_has_only_rounding),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
