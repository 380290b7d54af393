#include "core/level/screen.h"

#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>
#include <math.h>

static const struct lod_view kView = {.distance = 10, .fov_degrees = 90, .height_px = 1000};

static void at_90_degrees_a_window_of_1000_px_shows_20_units_at_distance_10(void **state) {
  (void)state;
  assert_true(fabs(lod_screen_units_per_pixel(&kView) - 0.02) < 1e-15);
  assert_true(fabs(lod_screen_error_px(0.04, &kView) - 2) < 1e-12);
  assert_true(fabs(lod_screen_error_units(2, &kView) - 0.04) < 1e-15);
}

static const struct lod_level_facts kLadder[] = {
    {.error = 0, .cell = 0, .bytes = 90000, .triangles = 8000},
    {.error = 0.01, .cell = 0.1, .bytes = 40000, .triangles = 4000},
    {.error = 0.05, .cell = 0.3, .bytes = 9000, .triangles = 1000},
    {.error = 0.2, .cell = 0.9, .bytes = 1000, .triangles = 100},
};
enum { COUNT = sizeof kLadder / sizeof kLadder[0] };

static size_t choose(enum lod_rule rule, double limit, int expect_fits) {
  int fits = -1;
  size_t chosen = lod_level_select(kLadder, COUNT, rule, limit, &fits);
  assert_int_equal(fits, expect_fits);
  assert_int_equal(lod_level_select(kLadder, COUNT, rule, limit, NULL), chosen);
  return chosen;
}

static void error_rule_takes_the_fewest_bytes_that_fit(void **state) {
  (void)state;
  assert_int_equal(choose(LOD_RULE_ERROR, 0.05, 1), 2);
  assert_int_equal(choose(LOD_RULE_ERROR, 0.0499, 1), 1);
  assert_int_equal(choose(LOD_RULE_ERROR, INFINITY, 1), 3);
  assert_int_equal(choose(LOD_RULE_ERROR, 0, 1), 0);
  assert_int_equal(choose(LOD_RULE_ERROR, -1, 0), 0);
  assert_int_equal(choose(LOD_RULE_ERROR, NAN, 0), 0);
}

static void budgets_take_the_least_error_that_fits_or_the_smallest_level(void **state) {
  (void)state;
  assert_int_equal(choose(LOD_RULE_BYTES, 40000, 1), 1);
  assert_int_equal(choose(LOD_RULE_BYTES, 39999, 1), 2);
  assert_int_equal(choose(LOD_RULE_BYTES, 10, 0), 3);
  assert_int_equal(choose(LOD_RULE_TRIANGLES, 5000, 1), 1);
  assert_int_equal(choose(LOD_RULE_TRIANGLES, 1e9, 1), 0);
  assert_int_equal(choose(LOD_RULE_TRIANGLES, 99, 0), 3);
}

static void cell_rule_takes_the_largest_cell_not_over_the_limit(void **state) {
  (void)state;
  assert_int_equal(choose(LOD_RULE_CELL, 0.9, 1), 3);
  assert_int_equal(choose(LOD_RULE_CELL, 0.8, 1), 2);
  assert_int_equal(choose(LOD_RULE_CELL, 0.1, 1), 1);
  assert_int_equal(choose(LOD_RULE_CELL, 0.05, 0), 0);
}

static void cell_rule_without_any_cell_takes_the_least_error(void **state) {
  (void)state;
  const struct lod_level_facts levels[2] = {{.error = 0.5, .bytes = 10}, {.error = 0.1, .bytes = 100}};
  int fits = -1;
  assert_int_equal(lod_level_select(levels, 2, LOD_RULE_CELL, 100, &fits), 1);
  assert_int_equal(fits, 0);
}

static void ties_go_to_fewer_bytes_then_less_error_then_the_earlier(void **state) {
  (void)state;
  const struct lod_level_facts levels[4] = {{.error = 0.2, .bytes = 10, .triangles = 5},
                                            {.error = 0.1, .bytes = 10, .triangles = 5},
                                            {.error = 0.1, .bytes = 10, .triangles = 5},
                                            {.error = 0.1, .bytes = 11, .triangles = 5}};
  assert_int_equal(lod_level_select(levels, 4, LOD_RULE_ERROR, 1, NULL), 1);
  assert_int_equal(lod_level_select(levels, 4, LOD_RULE_TRIANGLES, 9, NULL), 1);
  assert_int_equal(lod_level_select(levels + 3, 1, LOD_RULE_BYTES, 1, NULL), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(at_90_degrees_a_window_of_1000_px_shows_20_units_at_distance_10),
      cmocka_unit_test(error_rule_takes_the_fewest_bytes_that_fit),
      cmocka_unit_test(budgets_take_the_least_error_that_fits_or_the_smallest_level),
      cmocka_unit_test(cell_rule_takes_the_largest_cell_not_over_the_limit),
      cmocka_unit_test(cell_rule_without_any_cell_takes_the_least_error),
      cmocka_unit_test(ties_go_to_fewer_bytes_then_less_error_then_the_earlier),
  };
  return cmocka_run_group_tests_name("core/level/screen", tests, NULL, NULL);
}
