#include "server/log.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static char written[8192];

/* What one call wrote to stderr. */
static void capture(void (*write_lines)(void)) {
  int ends[2], kept = dup(STDERR_FILENO);
  assert_int_equal(pipe(ends), 0);
  dup2(ends[1], STDERR_FILENO);
  write_lines();
  dup2(kept, STDERR_FILENO);
  close(kept);
  close(ends[1]);
  ssize_t size = read(ends[0], written, sizeof written - 1);
  written[size > 0 ? size : 0] = 0;
  close(ends[0]);
}

static void write_hostile_request(void) {
  const struct lod_log_request request = {
      .method = "GET", .target = "/a\"\n\x1b[31m\xff\\", .peer = "127.0.0.1:9", .status = 404, .bytes = 12, .seconds = 0.5};
  lod_log_write_request(&request);
}

static void json_line_is_one_object_whatever_the_target(void **state) {
  (void)state;
  lod_log_open(true, LOD_LOG_INFO);
  capture(write_hostile_request);
  assert_ptr_equal(strchr(written, '\n'), written + strlen(written) - 1);
  json_t *line = json_loads(written, 0, NULL);
  assert_non_null(line);
  assert_int_equal(json_integer_value(json_object_get(line, "status")), 404);
  assert_string_equal(json_string_value(json_object_get(line, "target")), "/a\"\n\x1b[31m\xc3\xbf\\");
  json_decref(line);
}

static void text_line_holds_no_control_character(void **state) {
  (void)state;
  lod_log_open(false, LOD_LOG_INFO);
  capture(write_hostile_request);
  size_t size = strlen(written);
  assert_true(size > 0 && written[size - 1] == '\n');
  for (size_t i = 0; i + 1 < size; i++)
    assert_in_range((unsigned char)written[i], 0x20, 0x7e);
}

static char long_text[20000];
static void write_long(void) {
  const struct lod_log_request request = {.method = "GET", .target = long_text, .peer = "p", .status = 200};
  lod_log_write_request(&request);
  lod_log(LOD_LOG_INFO, "%s", long_text);
}

static void long_line_is_cut_and_still_ends(void **state) {
  (void)state;
  memset(long_text, '\t', sizeof long_text - 1);
  lod_log_open(false, LOD_LOG_INFO);
  capture(write_long);
  size_t size = strlen(written), lines = 0;
  for (size_t i = 0; i < size; i++)
    lines += written[i] == '\n';
  assert_int_equal(lines, 2);
}

static void level_drops_what_lies_below(void **state) {
  (void)state;
  lod_log_open(false, LOD_LOG_WARN);
  capture(write_hostile_request);
  assert_string_equal(written, "");
  enum lod_log_level level;
  assert_true(lod_log_level_parse("error", &level));
  assert_int_equal(level, LOD_LOG_ERROR);
  assert_false(lod_log_level_parse("loud", &level));
  lod_log_open(false, LOD_LOG_INFO);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(json_line_is_one_object_whatever_the_target),
      cmocka_unit_test(text_line_holds_no_control_character),
      cmocka_unit_test(long_line_is_cut_and_still_ends),
      cmocka_unit_test(level_drops_what_lies_below),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
