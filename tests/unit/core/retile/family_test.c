/* The ladder that nobody chose: how many vertices the levels of a model have. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>

#include "core/retile/retile.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

struct ladder {
  uint32_t levels, coarsest;
};

static enum lod_status count(void *context, const struct lod_level *level) {
  struct ladder *ladder = context;
  ladder->levels++;
  ladder->coarsest = level->meshes[0].vertex_count;
  return LOD_OK;
}

static struct ladder ladder_of(const struct lod_mesh *mesh) {
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  struct ladder ladder = {0};
  struct lod_problem problem = {0};
  assert_int_equal(lod_retile_family.build(&unit, 1, NULL, NULL, arena, count, &ladder, &problem), LOD_OK);
  return ladder;
}

/* A sphere in 12 bands of 8 materials each: 85 radii of line, 96 corners and more. */
static void a_model_of_many_patches_starts_finer(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 5);
  struct ladder plain = ladder_of(&mesh);
  assert_true(plain.levels >= 2 && plain.coarsest < 400);
  mesh.materials = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    double p[3] = {0, 0, 0};
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++)
        p[k] += (double)mesh.positions[mesh.triangles[t][i]][k] / 3;
    mesh.materials[t] = (uint32_t)(6 * (p[2] + 1)) * 8 + (uint32_t)(4 + 4 * atan2(p[1], p[0]) / 3.15);
  }
  struct ladder patched = ladder_of(&mesh);
  assert_true(patched.levels >= 1 && patched.coarsest > 1000 && patched.coarsest < 7000);
}

/* Where lines take nearly every vertex, there is one level of fewer vertices than the source. */
static void a_model_of_nothing_but_lines_has_one_level(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 4);
  mesh.materials = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = 0; t < mesh.triangle_count; t++)
    mesh.materials[t] = t % 3;
  struct ladder ladder = ladder_of(&mesh);
  assert_int_equal(ladder.levels, 1);
  assert_true(ladder.coarsest > mesh.vertex_count / 2 && ladder.coarsest <= mesh.vertex_count);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(a_model_of_many_patches_starts_finer, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(a_model_of_nothing_but_lines_has_one_level, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
