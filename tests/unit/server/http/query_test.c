#include "server/http/query.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <string.h>

static struct lod_target target;
static struct lod_query_problem problem;
static char text[4096];

static enum lod_status parse(const char *from) {
  snprintf(text, sizeof text, "%s", from);
  memset(&problem, 0, sizeof problem);
  return lod_target_parse(text, &target, &problem);
}

static void path_is_split_before_it_is_decoded(void **state) {
  (void)state;
  assert_int_equal(parse("/v1/models/a%2Fb%2e%2e/level"), LOD_OK);
  assert_int_equal(target.segment_count, 4);
  assert_string_equal(target.segments[2], "a/b..");
  assert_string_equal(target.segments[3], "level");
  assert_int_equal(parse("/"), LOD_OK);
  assert_int_equal(target.segment_count, 0);
  assert_int_equal(parse("/viewer/"), LOD_OK);
  assert_int_equal(target.segment_count, 2);
  assert_string_equal(target.segments[1], "");
}

static void absolute_form_loses_its_authority(void **state) {
  (void)state;
  assert_int_equal(parse("http://host:80/v1/models?limit=3"), LOD_OK);
  assert_int_equal(target.segment_count, 2);
  assert_string_equal(target.segments[0], "v1");
  assert_string_equal(lod_target_find(&target, "limit"), "3");
  assert_int_equal(parse("http://host"), LOD_OK);
  assert_int_equal(target.segment_count, 0);
}

static void query_is_split_before_it_is_decoded(void **state) {
  (void)state;
  assert_int_equal(parse("/a?x=1%262&y%3D=a+b&bare&&z="), LOD_OK);
  assert_int_equal(target.parameter_count, 4);
  assert_string_equal(lod_target_find(&target, "x"), "1&2");
  assert_string_equal(lod_target_find(&target, "y="), "a b");
  assert_string_equal(lod_target_find(&target, "bare"), "");
  assert_string_equal(lod_target_find(&target, "z"), "");
  assert_null(lod_target_find(&target, "w"));
}

static void bad_escapes_and_control_characters_are_refused(void **state) {
  (void)state;
  static const char *const kBad[] = {"/a%", "/a%2", "/a%zz", "/a%00b", "/a%0d%0aX: y", "/a\nb", "/a?x=%1f", "/a?%=1", "/a?x=%7F"};
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    assert_int_equal(parse(kBad[i]), LOD_BAD_INPUT);
    assert_true(problem.problem.detail[0] != 0);
  }
}

static void parameter_given_twice_is_named(void **state) {
  (void)state;
  assert_int_equal(parse("/a?px=1&px=2"), LOD_BAD_INPUT);
  assert_string_equal(problem.parameter, "px");
}

static void too_many_segments_or_parameters_are_refused(void **state) {
  (void)state;
  char many[400] = "";
  for (int i = 0; i < LOD_TARGET_SEGMENTS; i++)
    strcat(many, "/a");
  assert_int_equal(parse(many), LOD_OK);
  strcat(many, "/a");
  assert_int_equal(parse(many), LOD_BAD_INPUT);
  snprintf(many, sizeof many, "/a?");
  for (int i = 0; i < LOD_TARGET_PARAMETERS; i++)
    sprintf(many + strlen(many), "p%d=1&", i);
  assert_int_equal(parse(many), LOD_OK);
  strcat(many, "q=1");
  assert_int_equal(parse(many), LOD_BAD_INPUT);
  assert_string_equal(problem.parameter, "q");
}

static void numbers_are_finite_decimal_and_positive(void **state) {
  (void)state;
  static const struct {
    const char *text;
    double value;
  } kGood[] = {{"1", 1}, {"0.25", 0.25}, {"1e3", 1000}, {"1e+3", 1000}, {"1e 3", 1000}, {"5e-324", 5e-324}, {".5", 0.5}};
  static const char *const kBad[] = {
      "",   "0",  "-1",    "nan", "inf", "infinity", "0x10", "1px",    "1,5",
      " 1", "1 ", "1e999", "--1", "1e",  "-0",       "1 2",  "1e-999", "00000000000000000000000000000000000000000000000000000000000000001"};
  double value;
  for (size_t i = 0; i < sizeof kGood / sizeof *kGood; i++) {
    assert_int_equal(lod_parameter_number("px", kGood[i].text, 0, &value, &problem), LOD_OK);
    assert_true(value == kGood[i].value);
  }
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    memset(&problem, 0, sizeof problem);
    assert_int_equal(lod_parameter_number("px", kBad[i], 0, &value, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.parameter, "px");
  }
  assert_int_equal(lod_parameter_number("fov", "180", 180, &value, &problem), LOD_BAD_INPUT);
}

static void integers_stay_in_their_range(void **state) {
  (void)state;
  uint64_t value;
  assert_int_equal(lod_parameter_integer("limit", "1000", 1, 1000, &value, &problem), LOD_OK);
  assert_int_equal(value, 1000);
  static const char *const kBad[] = {"", "0", "1001", "-1", "+1", "1.5", "1e2", "99999999999999999999", " 1"};
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++)
    assert_int_equal(lod_parameter_integer("limit", kBad[i], 1, 1000, &value, &problem), LOD_BAD_INPUT);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(path_is_split_before_it_is_decoded),      cmocka_unit_test(absolute_form_loses_its_authority),
      cmocka_unit_test(query_is_split_before_it_is_decoded),     cmocka_unit_test(bad_escapes_and_control_characters_are_refused),
      cmocka_unit_test(parameter_given_twice_is_named),          cmocka_unit_test(too_many_segments_or_parameters_are_refused),
      cmocka_unit_test(numbers_are_finite_decimal_and_positive), cmocka_unit_test(integers_stay_in_their_range),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
