/* Native clients: levels and morphs from frames that arrive in pieces, and from units in any order; what is wrong leaves the level as it
 * is. */
#include "clients/native/lodestream.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/retile.h"
#include "tests/data/arena.h"
#include "tests/data/nested.h"
#include "tests/data/shapes.h"

enum { MOST = 150 }; /* coarse triangles of a unit */

static struct steps {
  struct lod_rounded coarse, fine;
  uint8_t *first, *step, *units;
  size_t first_size, step_size, units_size;
} made;

static struct lod_mesh bare(const struct lod_mesh *mesh) {
  return (struct lod_mesh){.vertex_count = mesh->vertex_count,
                           .triangle_count = mesh->triangle_count,
                           .positions = mesh->positions,
                           .triangles = mesh->triangles};
}

static int make_steps(void **state) {
  if (open_arena(state) != 0)
    return 1;
  struct lod_mesh torus = lod_shape_torus(arena, 2, 0.7, 90, 45);
  const uint32_t counts[] = {400, 1700};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  settings.vertices = counts;
  settings.level_count = 2;
  if (lod_retile_create(&torus, &settings, NULL, arena, &retile, NULL) != LOD_OK)
    return 1;
  struct lod_mesh coarse = bare(&retile.levels[0].mesh), fine = bare(&retile.levels[1].mesh);
  made.coarse = lod_round_mesh(&coarse, 2e-3, arena);
  made.fine = lod_round_mesh(&fine, 1e-3, arena);
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  request.fine = &made.coarse.mesh;
  request.grid = made.coarse.grid;
  if (lod_delta_encode(&request, arena, &made.first, &made.first_size, NULL) != LOD_OK)
    return 1;
  request.base = &made.coarse.mesh;
  request.fine = &made.fine.mesh;
  request.grid = made.fine.grid;
  request.kept = lod_round_kept(&made.coarse, &made.fine, retile.levels[0].parents, coarse.vertex_count, arena);
  request.from = 0;
  request.to = 1;
  return lod_delta_encode(&request, arena, &made.step, &made.step_size, NULL) != LOD_OK ||
         lod_units_encode(&request, MOST, arena, &made.units, &made.units_size, NULL) != LOD_OK || made.units_size == 0;
}

static void assert_level(const struct lodestream *stream, const struct lod_mesh *expected) {
  uint32_t a, b;
  assert_int_equal(lod_delta_checksum(lodestream_level(stream), arena, &a), LOD_OK);
  assert_int_equal(lod_delta_checksum(expected, arena, &b), LOD_OK);
  assert_int_equal(a, b);
}

static struct lodestream *at_the_first_level(void) {
  struct lodestream *stream = lodestream_create(0);
  size_t used;
  assert_non_null(stream);
  assert_int_equal(lodestream_feed(stream, 0, made.first, made.first_size, &used, NULL), LOD_OK);
  assert_int_equal(used, made.first_size);
  return stream;
}

static void frames_that_arrive_in_pieces_become_levels(void **state) {
  (void)state;
  struct lodestream *stream = lodestream_create(0);
  size_t total = made.first_size + made.step_size, taken = 0, levels = 0, used;
  uint8_t *bytes = malloc(total);
  assert_null(lodestream_level(stream));
  memcpy(bytes, made.first, made.first_size);
  memcpy(bytes + made.first_size, made.step, made.step_size);
  for (size_t there = 0; there <= total; there++) {
    assert_int_equal(lodestream_feed(stream, 0, bytes + taken, there - taken, &used, NULL), LOD_OK);
    taken += used;
    if (used > 0)
      assert_level(stream, levels++ == 0 ? &made.coarse.mesh : &made.fine.mesh);
  }
  assert_int_equal(levels, 2);
  const struct lod_morph *morph;
  assert_int_equal(lodestream_morph(stream, &morph, NULL), LOD_OK);
  assert_true(morph != NULL && morph->triangle_count > made.fine.mesh.triangle_count);
  free(bytes);
  lodestream_destroy(stream);
}

static void take(struct lodestream *stream, uint32_t p) {
  struct lod_problem problem = {0};
  const struct lod_units_patch *patch = &lodestream_units(stream)->patches[p];
  if (patch->size != 0 && lodestream_units_take(stream, p, made.units + patch->offset, patch->size, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
}

static void units_in_any_order_become_the_finer_level(void **state) {
  (void)state;
  struct lodestream *stream = at_the_first_level();
  const struct lod_morph *morph;
  struct lod_problem problem = {0};
  assert_null(lodestream_units(stream));
  assert_int_equal(lodestream_units_begin(stream, made.units, made.units_size, NULL), LOD_OK);
  const struct lod_units *units = lodestream_units(stream);
  const uint32_t count = units->header.patch_count;
  assert_true(count >= 4 && units->header.primer_patch == 0);
  uint32_t drawn = made.coarse.mesh.triangle_count;
  take(stream, 0);
  for (uint32_t p = count; p-- > 1;) {
    if (p + 2 == count) {
      assert_int_equal(lodestream_units_finish(stream, &problem), LOD_BAD_INPUT); /* not yet */
      assert_level(stream, &made.coarse.mesh);
    }
    take(stream, p);
    take(stream, p); /* again: nothing */
    assert_int_equal(lodestream_units_morph(stream, &morph, NULL), LOD_OK);
    assert_true(morph->triangle_count >= drawn && morph->settled != NULL);
    drawn = morph->triangle_count;
  }
  uint32_t settled = 0;
  for (uint32_t v = 0; v < morph->vertex_count; v++)
    settled += morph->settled[v];
  assert_true(settled > morph->vertex_count / 2); /* what was drawn before has grown */
  assert_int_equal(lodestream_units_finish(stream, &problem), LOD_OK);
  assert_level(stream, &made.fine.mesh);
  assert_null(lodestream_units(stream));
  assert_int_equal(lodestream_morph(stream, &morph, NULL), LOD_OK);
  assert_non_null(morph);
  lodestream_destroy(stream);
}

static void damaged_units_leave_the_level_and_what_has_come(void **state) {
  (void)state;
  struct lodestream *stream = at_the_first_level();
  const struct lod_morph *morph;
  uint8_t *bad = malloc(made.units_size);
  assert_int_equal(lodestream_units_take(stream, 0, made.units, made.units_size, NULL), LOD_BAD_INPUT); /* none has begun */
  assert_int_equal(lodestream_units_begin(stream, made.units, 9, NULL), LOD_BAD_INPUT);
  assert_null(lodestream_units(stream));
  assert_int_equal(lodestream_units_begin(stream, made.units, made.units_size, NULL), LOD_OK);
  const struct lod_units_patch *patches = lodestream_units(stream)->patches;
  for (uint32_t p = 0; p < 2; p++) {
    for (size_t i = 0; i < 8 * patches[p].size; i += 7) {
      struct lod_problem problem = {0};
      memcpy(bad, made.units, made.units_size);
      bad[patches[p].offset + i / 8] ^= (uint8_t)(1 << i % 8);
      const enum lod_status status = lodestream_units_take(stream, p, bad + patches[p].offset, patches[p].size, &problem);
      assert_true(status == LOD_BAD_INPUT || status == LOD_UNSUPPORTED);
      assert_true(problem.detail[0] != '\0');
    }
    assert_int_equal(lodestream_units_take(stream, p, made.units + patches[p].offset, patches[p].size - 1, NULL), LOD_BAD_INPUT);
    assert_int_equal(lodestream_units_morph(stream, &morph, NULL), LOD_OK);
    take(stream, p); /* the right bytes still do */
  }
  memcpy(bad, made.units, made.units_size);
  bad[4]++;
  assert_int_equal(lodestream_units_begin(stream, bad, made.units_size, NULL), LOD_UNSUPPORTED);
  assert_non_null(lodestream_units(stream)); /* the one that had begun goes on */
  assert_level(stream, &made.coarse.mesh);
  lodestream_units_drop(stream);
  assert_null(lodestream_units(stream));
  free(bad);
  lodestream_destroy(stream);
}

static void units_of_another_level_are_refused(void **state) {
  (void)state;
  struct lod_problem problem = {0};
  struct lodestream *stream = lodestream_create(0);
  assert_int_equal(lodestream_units_begin(stream, made.units, made.units_size, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  assert_int_equal(lodestream_start(stream, &made.fine.mesh, NULL), LOD_OK);
  assert_int_equal(lodestream_units_begin(stream, made.units, made.units_size, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  lodestream_destroy(stream);
}

static void a_new_level_ends_a_step_in_units(void **state) {
  (void)state;
  struct lodestream *stream = at_the_first_level();
  size_t used;
  assert_int_equal(lodestream_units_begin(stream, made.units, made.units_size, NULL), LOD_OK);
  take(stream, 0);
  assert_int_equal(lodestream_feed(stream, 0, made.step, made.step_size, &used, NULL), LOD_OK);
  assert_null(lodestream_units(stream));
  assert_level(stream, &made.fine.mesh);
  lodestream_destroy(stream);
}

static void a_bound_of_memory_holds(void **state) {
  (void)state;
  struct lod_problem problem = {0};
  bool begun = false;
  for (size_t memory = 1 << 12; !begun; memory += memory / 2) {
    struct lodestream *stream = lodestream_create(memory);
    size_t used;
    enum lod_status status = stream == NULL ? LOD_MEMORY : lodestream_feed(stream, 0, made.first, made.first_size, &used, &problem);
    if (status == LOD_OK)
      status = lodestream_units_begin(stream, made.units, made.units_size, &problem);
    for (uint32_t p = 0; status == LOD_OK && p < lodestream_units(stream)->header.patch_count; p++) {
      const struct lod_units_patch *patch = &lodestream_units(stream)->patches[p];
      status = lodestream_units_take(stream, p, made.units + patch->offset, patch->size, &problem);
    }
    if (status == LOD_OK)
      status = lodestream_units_finish(stream, &problem);
    assert_true(status == LOD_OK || status == LOD_MEMORY || status == LOD_LIMIT);
    begun = status == LOD_OK;
    lodestream_destroy(stream);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(frames_that_arrive_in_pieces_become_levels),
      cmocka_unit_test(units_in_any_order_become_the_finer_level),
      cmocka_unit_test(damaged_units_leave_the_level_and_what_has_come),
      cmocka_unit_test(units_of_another_level_are_refused),
      cmocka_unit_test(a_new_level_ends_a_step_in_units),
      cmocka_unit_test(a_bound_of_memory_holds),
  };
  return cmocka_run_group_tests(tests, make_steps, close_arena);
}
