/* What pictures show besides shading. P1-16: curvature in Turk's colours. */
#include "codec/export/picture_scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/shapes.h"

static struct lod_picture draw(const struct lod_picture_scene *scene, struct lod_arena *arena) {
  struct lod_picture_settings settings = lod_picture_defaults();
  struct lod_picture picture;
  struct lod_problem problem = {0};
  settings.width = settings.height = 200;
  if (lod_picture_render_scene(scene, settings, arena, &picture, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return picture;
}

/* Pixels, left of the legend, that are clearly red, or blue, or nearly black. */
static uint32_t count(const struct lod_picture *picture, char what) {
  uint32_t found = 0;
  for (uint32_t y = 0; y < picture->height; y++)
    for (uint32_t x = 0; x < picture->width * 9 / 10; x++) {
      const uint8_t *p = picture->rgba[(size_t)y * picture->width + x];
      found += what == 'r'   ? p[0] > 90 && p[0] > 2 * p[2] && p[0] > 2 * p[1]
               : what == 'b' ? p[2] > 90 && p[2] > 2 * p[0]
                             : p[0] + p[1] + p[2] < 120;
    }
  return found;
}

static void a_flat_sheet_is_blue_and_a_dented_one_red_in_places(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sheet = lod_shape_grid(arena, 2, 20, 0), dented = lod_shape_grid(arena, 2, 40, 0.5);
  struct lod_picture flat = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_CURVATURE, .mesh = &sheet}, arena);
  struct lod_picture bent = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_CURVATURE, .mesh = &dented}, arena);
  assert_int_equal(count(&flat, 'r'), 0);
  assert_true(count(&flat, 'b') > 500);
  assert_true(count(&bent, 'r') > 20);
  lod_arena_destroy(arena);
}

static void error_is_red_where_the_level_is_off(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 4), off = lod_shape_sphere(arena, 1, 4);
  for (uint32_t v = 0; v < off.vertex_count; v++)
    if (off.positions[v][2] > 0.5f)
      off.positions[v][2] += 0.2f;
  struct lod_picture picture = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_ERROR, .mesh = &off, .source = &sphere}, arena);
  assert_true(count(&picture, 'r') > 100);
  assert_true(count(&picture, 'b') > 100);
  struct lod_picture_scene none = {.kind = LOD_PICTURE_ERROR, .mesh = &off};
  struct lod_problem problem = {0};
  assert_int_equal(lod_picture_render_scene(&none, lod_picture_defaults(), arena, &picture, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "no-source");
  lod_arena_destroy(arena);
}

static void points_and_tessellations_have_dots_of_ink(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 3);
  struct lod_picture plain = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_SHADED, .mesh = &sphere}, arena);
  struct lod_picture points = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_POINTS, .mesh = &sphere}, arena);
  struct lod_picture tiles = draw(&(struct lod_picture_scene){.kind = LOD_PICTURE_TESSELLATION, .mesh = &sphere, .vertices = 100}, arena);
  assert_int_equal(count(&plain, 'k'), 0);
  assert_true(count(&points, 'k') > 100);
  assert_true(count(&tiles, 'k') > 100);
  lod_arena_destroy(arena);
}

static void fragments_go_from_one_level_to_the_other(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh source = lod_shape_torus(arena, 2, 0.8, 60, 30);
  const uint32_t counts[] = {60, 240};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  settings.vertices = counts;
  settings.level_count = 2;
  assert_int_equal(lod_retile_create(&source, &settings, NULL, arena, &retile, NULL), LOD_OK);
  struct lod_picture_scene scene = {.kind = LOD_PICTURE_FRAGMENTS, .mesh = &retile.levels[0].mesh, .source = &retile.levels[1].mesh};
  struct lod_picture start = draw(&scene, arena);
  scene.t = 1;
  struct lod_picture end = draw(&scene, arena);
  assert_true(count(&start, 'r') > 50);
  assert_memory_not_equal(start.rgba, end.rgba, (size_t)200 * 200 * 4);
  struct lod_mesh cube = lod_shape_cube(arena, 9);
  struct lod_problem problem = {0};
  scene.source = &cube;
  assert_int_equal(lod_picture_render_scene(&scene, lod_picture_defaults(), arena, &end, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "not-nested");
  lod_arena_destroy(arena);
}

static void every_kind_has_a_name(void **state) {
  (void)state;
  for (uint32_t kind = 0; kind < LOD_PICTURE_KINDS; kind++)
    assert_true(strlen(lod_picture_kind_name(kind)) > 3);
  assert_null(lod_picture_kind_name(LOD_PICTURE_KINDS));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_flat_sheet_is_blue_and_a_dented_one_red_in_places),
      cmocka_unit_test(error_is_red_where_the_level_is_off),
      cmocka_unit_test(points_and_tessellations_have_dots_of_ink),
      cmocka_unit_test(fragments_go_from_one_level_to_the_other),
      cmocka_unit_test(every_kind_has_a_name),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
