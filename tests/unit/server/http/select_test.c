#include "server/http/select.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Two families over one model: cluster is coarse and cheap, retile is finer for its bytes; only cluster has cells. */
static struct lod_stored_level cluster[] = {
    {.level = 0, .facts = {.error = 0.5, .cell = 1.0, .bytes = 3000, .triangles = 100}},
    {.level = 1, .facts = {.error = 0.1, .cell = 0.2, .bytes = 20000, .triangles = 1000}},
    {.level = 2, .facts = {.error = 0.01, .cell = 0.02, .bytes = 90000, .triangles = 9000}},
};
static struct lod_stored_level retile[] = {
    {.level = 0, .facts = {.error = 0.2, .bytes = 4000, .triangles = 200}},
    {.level = 1, .facts = {.error = 0.02, .bytes = 40000, .triangles = 3000}},
};
static struct lod_stored_family families[] = {{"cluster", true, 3, cluster}, {"retile", true, 2, retile}};
static const struct lod_stored_model model = {.id = "bunny", .family_count = 2, .families = families};

static struct lod_query_problem problem;
static struct lod_selection selection;
static struct lod_choice choice;

static enum lod_status select_level(const char *query) {
  char text[512];
  struct lod_target target;
  snprintf(text, sizeof text, "/level?%s", query);
  memset(&problem, 0, sizeof problem);
  enum lod_status status = lod_target_parse(text, &target, &problem);
  if (status == LOD_OK)
    status = lod_selection_parse(&target, &selection, &problem);
  return status == LOD_OK ? lod_selection_choose(&selection, &model, &choice, &problem) : status;
}

static void expect(const char *query, const char *family, unsigned level, bool fits) {
  assert_int_equal(select_level(query), LOD_OK);
  assert_string_equal(choice.family->name, family);
  assert_int_equal(choice.level->level, level);
  assert_int_equal(choice.fits, fits);
}

static void error_gets_the_fewest_bytes_of_any_family(void **state) {
  (void)state;
  expect("error=0.5", "cluster", 0, true);
  expect("error=0.3", "retile", 0, true);
  expect("error=0.1", "cluster", 1, true);
  expect("error=0.05", "retile", 1, true);
  expect("error=0.001", "cluster", 2, false);
}

static void family_restricts_the_choice(void **state) {
  (void)state;
  expect("error=0.3&family=cluster", "cluster", 1, true);
  expect("error=0.3&family=auto", "retile", 0, true);
  expect("error=0.05&family=cluster", "cluster", 2, true);
}

static void budgets_get_the_least_error_that_fits(void **state) {
  (void)state;
  expect("max_bytes=50000", "retile", 1, true);
  expect("max_bytes=10", "cluster", 0, false);
  expect("max_triangles=999", "retile", 0, true);
}

/* One pixel at distance 10, 90 degrees, 1000 pixels: 2 * 10 * tan(45) / 1000 = 0.02 units. */
static void pixels_become_units_of_the_view(void **state) {
  (void)state;
  expect("px=1.001&distance=10&fov=90&height=1000", "retile", 1, true);
  assert_true(fabs(selection.limit - 0.02002) < 1e-15);
  assert_true(fabs(choice.screen_error_px - 1) < 1e-12);
  expect("px=0.501&distance=10&fov=90&height=1000", "cluster", 2, true);
}

static void view_has_defaults_but_no_default_distance(void **state) {
  (void)state;
  assert_int_equal(select_level("distance=1"), LOD_OK);
  assert_true(fabs(selection.limit - 2 * tan(acos(-1) / 6) / 1080) < 1e-15);
  assert_int_equal(select_level("px=1"), LOD_BAD_INPUT);
  assert_string_equal(problem.parameter, "distance");
  assert_int_equal(select_level(""), LOD_BAD_INPUT);
  assert_string_equal(problem.parameter, "distance");
}

static void cell_rule_takes_the_largest_cell_not_over_x_pixels(void **state) {
  (void)state;
  expect("rule=cell&x=10.1&distance=10&fov=90&height=1000", "cluster", 1, true); /* X * R = 0.202 */
  expect("rule=cell&x=9.9&distance=10&fov=90&height=1000", "cluster", 2, true);
  assert_true(choice.screen_error_px > 0);
}

static void far_view_lets_every_level_fit(void **state) {
  (void)state;
  expect("distance=1e308&px=1e300", "cluster", 0, true);
  assert_true(isfinite(selection.limit));
}

static void wrong_query_names_its_parameter(void **state) {
  (void)state;
  static const char *const kBad[][2] = {
      {"px=0&distance=1", "px"},
      {"px=-1&distance=1", "px"},
      {"px=nan&distance=1", "px"},
      {"px=inf&distance=1", "px"},
      {"px=&distance=1", "px"},
      {"distance=0", "distance"},
      {"distance=NaN", "distance"},
      {"distance=1&fov=180", "fov"},
      {"distance=1&fov=0", "fov"},
      {"distance=1&height=0", "height"},
      {"error=0", "error"},
      {"error=-1", "error"},
      {"error=1e999", "error"},
      {"max_bytes=0", "max_bytes"},
      {"max_bytes=1.5", "max_bytes"},
      {"max_triangles=-3", "max_triangles"},
      {"error=1&max_bytes=3", "max_bytes"},
      {"error=1&px=1&distance=1", "px"},
      {"error=1&distance=1", "distance"},
      {"max_bytes=1&max_triangles=1", "max_triangles"},
      {"max_bytes=1&fov=60", "fov"},
      {"px=1&distance=1&rule=cell&x=1", "px"},
      {"rule=cell&distance=1", "x"},
      {"rule=cell&x=1", "distance"},
      {"rule=error&x=1&distance=1", "rule"},
      {"x=1&distance=1", "rule"},
      {"error=1&family=nope", "family"},
      {"error=1&family=", "family"},
      {"error=1&family=aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "family"},
      {"error=1&colour=red", "colour"},
  };
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    assert_int_equal(select_level(kBad[i][0]), LOD_BAD_INPUT);
    assert_string_equal(problem.parameter, kBad[i][1]);
    assert_non_null(strstr(problem.problem.detail, kBad[i][1]));
  }
}

static void model_without_levels_is_told(void **state) {
  (void)state;
  const struct lod_stored_model empty = {.id = "empty"};
  selection = (struct lod_selection){.rule = LOD_RULE_ERROR, .limit = 1};
  memset(&problem, 0, sizeof problem);
  assert_int_equal(lod_selection_choose(&selection, &empty, &choice, &problem), LOD_UNSUPPORTED);
  assert_string_equal(problem.problem.type, "no-levels");
}

static void more_levels_than_fit_the_stack_are_all_looked_at(void **state) {
  (void)state;
  enum { COUNT = 1000 };
  static struct lod_stored_level many[COUNT];
  for (uint32_t i = 0; i < COUNT; i++)
    many[i] = (struct lod_stored_level){.level = i, .facts = {.error = 1.0 / (i + 1), .bytes = i + 1, .triangles = i + 1}};
  struct lod_stored_family one = {"cluster", true, COUNT, many};
  const struct lod_stored_model large = {.id = "large", .family_count = 1, .families = &one};
  selection = (struct lod_selection){.rule = LOD_RULE_ERROR, .limit = 1.0 / 900};
  assert_int_equal(lod_selection_choose(&selection, &large, &choice, &problem), LOD_OK);
  assert_int_equal(choice.level->level, 899);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(error_gets_the_fewest_bytes_of_any_family),
      cmocka_unit_test(family_restricts_the_choice),
      cmocka_unit_test(budgets_get_the_least_error_that_fits),
      cmocka_unit_test(pixels_become_units_of_the_view),
      cmocka_unit_test(view_has_defaults_but_no_default_distance),
      cmocka_unit_test(cell_rule_takes_the_largest_cell_not_over_x_pixels),
      cmocka_unit_test(far_view_lets_every_level_fit),
      cmocka_unit_test(wrong_query_names_its_parameter),
      cmocka_unit_test(model_without_levels_is_told),
      cmocka_unit_test(more_levels_than_fit_the_stack_are_all_looked_at),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
