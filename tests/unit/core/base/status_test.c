#include "core/base/status.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <string.h>

static void the_first_problem_is_kept(void **state) {
  (void)state;
  struct lod_problem problem = {0};
  assert_int_equal(lod_fail(&problem, LOD_BAD_INPUT, "truncated", "%s ends after %d bytes.", "a.ply", 12), LOD_BAD_INPUT);
  assert_int_equal(lod_fail(&problem, LOD_IO, "disk-full", "No space."), LOD_IO);
  assert_int_equal(problem.status, LOD_BAD_INPUT);
  assert_string_equal(problem.type, "truncated");
  assert_string_equal(problem.detail, "a.ply ends after 12 bytes.");
}

static void long_text_is_cut_to_fit(void **state) {
  (void)state;
  struct lod_problem problem = {0};
  char text[1000];
  memset(text, 'x', sizeof text - 1);
  text[sizeof text - 1] = 0;
  (void)lod_fail(&problem, LOD_LIMIT, text, "%s", text);
  assert_int_equal(strlen(problem.type), sizeof problem.type - 1);
  assert_int_equal(strlen(problem.detail), sizeof problem.detail - 1);
}

static void nobody_need_listen(void **state) {
  (void)state;
  assert_int_equal(lod_fail(NULL, LOD_LIMIT, "limit-vertices", "Too many."), LOD_LIMIT);
  assert_int_equal(lod_fail_memory(NULL), LOD_MEMORY);
}

static enum lod_status twice(enum lod_status first, int *reached) {
  LOD_TRY(first);
  ++*reached;
  return LOD_OK;
}

static void try_returns_what_failed_and_goes_on_otherwise(void **state) {
  (void)state;
  int reached = 0;
  assert_int_equal(twice(LOD_CANCELLED, &reached), LOD_CANCELLED);
  assert_int_equal(reached, 0);
  assert_int_equal(twice(LOD_OK, &reached), LOD_OK);
  assert_int_equal(reached, 1);
}

static void every_status_has_a_name_of_its_own(void **state) {
  (void)state;
  for (int a = LOD_OK; a <= LOD_CANCELLED; a++)
    for (int b = LOD_OK; b < a; b++)
      assert_string_not_equal(lod_status_name((enum lod_status)a), lod_status_name((enum lod_status)b));
  assert_string_equal(lod_status_name(LOD_CANCELLED), "cancelled");
  assert_string_equal(lod_status_name((enum lod_status)99), "unknown");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(the_first_problem_is_kept),
      cmocka_unit_test(long_text_is_cut_to_fit),
      cmocka_unit_test(nobody_need_listen),
      cmocka_unit_test(try_returns_what_failed_and_goes_on_otherwise),
      cmocka_unit_test(every_status_has_a_name_of_its_own),
  };
  return cmocka_run_group_tests_name("core/base/status", tests, NULL, NULL);
}
