/* Which steps between the levels of a family get a delta. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/worker/deltas.h"
#include "tests/data/arena.h"
#include "tests/data/models.h"
#include "tests/data/shapes.h"

enum { SOURCES = 2, MADE = 4 };

struct family {
  struct lod_model model;
  struct lod_level made[MADE];
  struct lod_baked_level baked[MADE]; /* by number of what was made: finest first */
};

/* Spheres of fewer and fewer triangles; every vertex of one is a vertex of the finer one before it, under the same number. */
static void make(struct family *family) {
  *family = (struct family){.model = lod_sample_plain(arena, "sphere", lod_shape_sphere(arena, 1, 4))};
  const struct lod_mesh *source = &family->model.units[0].mesh;
  struct lod_bvh *bvh;
  assert_int_equal(lod_bvh_create(source, 1, arena, &bvh), LOD_OK);
  struct lod_level_baker baker = {.model = &family->model, .source_bvhs = &bvh, .diagonal = 2 * sqrt(3), .threads = 1};
  for (int i = 0; i < MADE; i++) {
    struct lod_mesh *mesh = LOD_NEW(arena, 1, struct lod_mesh);
    uint32_t **parents = LOD_NEW(arena, 1, uint32_t *);
    *mesh = i < SOURCES ? *source : lod_shape_sphere(arena, 1, i == 2 ? 3 : 2);
    parents[0] = LOD_NEW(arena, mesh->vertex_count, uint32_t);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
      parents[0][v] = LOD_NONE;
      for (uint32_t w = 0; i >= SOURCES && w < family->made[i - 1].meshes[0].vertex_count; w++)
        if (memcmp(mesh->positions[v], family->made[i - 1].meshes[0].positions[w], sizeof *mesh->positions) == 0)
          parents[0][v] = w;
      assert_true(i < SOURCES || parents[0][v] != LOD_NONE);
    }
    family->made[i] = (struct lod_level){.meshes = mesh, .parents = parents, .bound = INFINITY};
    struct lod_problem problem = {0};
    if (lod_level_bake(&baker, &family->made[i], i == 0 ? 1e-5 : i == 1 ? 1e-4 : 0, arena, &family->baked[i], &problem) != LOD_OK)
      fail_msg("%s", problem.detail);
    family->baked[i].made = (uint32_t)i;
  }
}

/* Deltas of the levels in this order, coarsest first. */
static void bake(const struct family *family, const int *order, uint32_t count, struct lod_baked_level *levels) {
  char folder[] = "/tmp/deltas-test-XXXXXX", line[200];
  assert_non_null(mkdtemp(folder));
  struct lod_deltas_request request = {.model = &family->model,
                                       .levels = levels,
                                       .level_count = count,
                                       .made = family->made,
                                       .source_levels = SOURCES,
                                       .maps = true,
                                       .directory_fd = open(folder, O_RDONLY | O_DIRECTORY)};
  assert_true(request.directory_fd >= 0);
  for (uint32_t i = 0; i < count; i++)
    levels[i] = family->baked[order[i]];
  struct lod_problem problem = {0};
  enum lod_status status = lod_deltas_bake(&request, arena, &problem);
  close(request.directory_fd);
  snprintf(line, sizeof line, "rm -rf %s", folder);
  assert_int_equal(system(line), 0);
  if (status != LOD_OK)
    fail_msg("%s", problem.detail);
}

static void every_step_of_a_nested_family_has_a_delta(void **state) {
  (void)state;
  struct family family;
  struct lod_baked_level levels[MADE];
  make(&family);
  bake(&family, (const int[]){3, 2, 1, 0}, 4, levels);
  assert_true(levels[0].first.size > 0);
  for (int i = 0; i < 3; i++) {
    assert_true(levels[i].delta.size > 0 && levels[i].delta.size < levels[i + 1].size);
    assert_true(levels[i].delta.overlaid); /* the map between the two as they are decoded */
    assert_int_equal(levels[i].delta.unmapped, 0);
  }
}

/* Levels are ordered by their certified errors: one with fewer vertices may come after one with more, against the family's maps. */
static void a_step_against_the_maps_has_none(void **state) {
  (void)state;
  struct family family;
  struct lod_baked_level levels[MADE];
  make(&family);
  bake(&family, (const int[]){2, 3, 1, 0}, 4, levels);
  assert_int_equal(levels[0].delta.size, 0);
  assert_true(levels[1].delta.size > 0 && levels[2].delta.size > 0);
  bake(&family, (const int[]){3, 0, 1}, 3, levels); /* of the source's own levels any leads to any */
  assert_true(levels[0].delta.size > 0 && levels[1].delta.size > 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(every_step_of_a_nested_family_has_a_delta, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(a_step_against_the_maps_has_none, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
