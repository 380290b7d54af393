#include "server/http/response.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

/* ---- ranges ---- */

static void single_range_is_cut_to_the_size(void **state) {
  (void)state;
  static const struct {
    const char *text;
    uint64_t size, first, count;
  } kGood[] = {
      {"bytes=0-0", 10, 0, 1},
      {"bytes=0-", 10, 0, 10},
      {"bytes=9-", 10, 9, 1},
      {"bytes=2-4", 10, 2, 3},
      {"bytes=2-99", 10, 2, 8},
      {"bytes=-3", 10, 7, 3},
      {"bytes=-99", 10, 0, 10},
      {"BYTES=1-1", 10, 1, 1},
      {"bytes= 1-2 ", 10, 1, 2},
      {"bytes=5-99999999999999999999999", 10, 5, 5},
      {"bytes=-99999999999999999999999", 10, 0, 10},
  };
  for (size_t i = 0; i < sizeof kGood / sizeof *kGood; i++) {
    uint64_t first, count;
    assert_int_equal(lod_range_parse(kGood[i].text, kGood[i].size, &first, &count), LOD_RANGE_PART);
    assert_int_equal(first, kGood[i].first);
    assert_int_equal(count, kGood[i].count);
  }
}

static void bad_range_is_told_from_no_range(void **state) {
  (void)state;
  static const char *const kBad[] = {"bytes=10-",
                                     "bytes=10-20",
                                     "bytes=4-2",
                                     "bytes=-0",
                                     "bytes=",
                                     "bytes=-",
                                     "bytes=a-b",
                                     "bytes=1-2x",
                                     "bytes=1",
                                     "bytes=--1",
                                     "bytes=99999999999999999999999-"};
  static const char *const kNone[] = {"", "items=0-1", "bytes", "bytes=0-1,3-4"};
  uint64_t first, count;
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++)
    assert_int_equal(lod_range_parse(kBad[i], 10, &first, &count), LOD_RANGE_BAD);
  for (size_t i = 0; i < sizeof kNone / sizeof *kNone; i++)
    assert_int_equal(lod_range_parse(kNone[i], 10, &first, &count), LOD_RANGE_NONE);
  assert_int_equal(lod_range_parse(NULL, 10, &first, &count), LOD_RANGE_NONE);
  assert_int_equal(lod_range_parse("bytes=0-", 0, &first, &count), LOD_RANGE_BAD);
  assert_int_equal(lod_range_parse("bytes=-1", 0, &first, &count), LOD_RANGE_BAD);
}

/* ---- conditions ---- */

static unsigned plan(struct lod_conditions conditions) {
  return lod_conditions_plan(&conditions, "\"a\"", 10).status;
}

static void entity_tag_lists_are_compared_weakly_or_strongly(void **state) {
  (void)state;
  assert_true(lod_etag_listed("\"x\", \"a\"", "\"a\"", true));
  assert_true(lod_etag_listed("W/\"a\"", "\"a\"", true));
  assert_false(lod_etag_listed("W/\"a\"", "\"a\"", false));
  assert_true(lod_etag_listed("W/\"a\" , \"a\"", "\"a\"", false));
  assert_true(lod_etag_listed("*", "\"a\"", false));
  assert_false(lod_etag_listed("\"aa\"", "\"a\"", true));
  assert_false(lod_etag_listed("a", "\"a\"", true));
  assert_false(lod_etag_listed("\"a", "\"a\"", true));
  assert_false(lod_etag_listed("", "\"a\"", true));
}

static void conditions_come_before_ranges(void **state) {
  (void)state;
  assert_int_equal(plan((struct lod_conditions){.get = true}), 200);
  assert_int_equal(plan((struct lod_conditions){.get = true, .if_none_match = "\"a\"", .range = "bytes=0-1"}), 304);
  assert_int_equal(plan((struct lod_conditions){.get = false, .if_none_match = "\"a\""}), 304);
  assert_int_equal(plan((struct lod_conditions){.get = true, .if_none_match = "\"b\"", .range = "bytes=0-1"}), 206);
  assert_int_equal(plan((struct lod_conditions){.get = true, .if_match = "\"b\"", .range = "bytes=0-1"}), 412);
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=10-"}), 416);
}

static void range_counts_for_get_alone(void **state) {
  (void)state;
  assert_int_equal(plan((struct lod_conditions){.get = false, .range = "bytes=0-1"}), 200);
  assert_int_equal(plan((struct lod_conditions){.get = false, .range = "bytes=10-"}), 200);
}

static void if_range_needs_the_same_strong_tag(void **state) {
  (void)state;
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=0-1", .if_range = "\"a\""}), 206);
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=0-1", .if_range = "\"b\""}), 200);
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=0-1", .if_range = "W/\"a\""}), 200);
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=0-1", .if_range = "Sun, 06 Nov 1994 08:49:37 GMT"}), 200);
  assert_int_equal(plan((struct lod_conditions){.get = true, .range = "bytes=99-", .if_range = "\"b\""}), 200);
}

static void changes_follow_if_match_and_if_none_match(void **state) {
  (void)state;
  struct lod_conditions create = {.if_none_match = "*"}, same = {.if_match = "\"a\""}, any = {.if_match = "*"};
  assert_true(lod_conditions_allow_change(&create, NULL));
  assert_false(lod_conditions_allow_change(&create, "\"a\""));
  assert_true(lod_conditions_allow_change(&same, "\"a\""));
  assert_false(lod_conditions_allow_change(&same, "\"b\""));
  assert_false(lod_conditions_allow_change(&same, NULL));
  assert_false(lod_conditions_allow_change(&any, NULL));
  assert_true(lod_conditions_allow_change(&any, "\"b\""));
}

/* ---- problems ---- */

static void problem_is_rfc_9457(void **state) {
  (void)state;
  struct lod_reply reply = {0};
  lod_reply_problem(&reply, 400, "bad-parameter", "'px' is \"wrong\"\xff\n", "px");
  assert_string_equal(reply.type, "application/problem+json");
  json_t *object = json_loadb((const char *)reply.body->bytes, reply.body->size, 0, NULL);
  assert_non_null(object);
  assert_string_equal(json_string_value(json_object_get(object, "type")), "/problems/bad-parameter");
  assert_string_equal(json_string_value(json_object_get(object, "title")), "Bad parameter");
  assert_int_equal(json_integer_value(json_object_get(object, "status")), 400);
  assert_string_equal(json_string_value(json_object_get(object, "detail")), "'px' is \"wrong\"?\n");
  assert_string_equal(json_string_value(json_object_get(object, "parameter")), "px");
  json_decref(object);
  lod_reply_finish(&reply);
}

static void full_queue_is_503_and_other_limits_413(void **state) {
  (void)state;
  struct lod_query_problem full = {.problem = {LOD_LIMIT, "queue-full", "x"}}, large = {.problem = {LOD_LIMIT, "limit-vertices", "x"}};
  struct lod_reply reply = {0};
  lod_reply_failure(&reply, &full);
  assert_int_equal(reply.status, 503);
  assert_string_equal(reply.headers[0].name, "Retry-After");
  lod_reply_finish(&reply);
  lod_reply_failure(&reply, &large);
  assert_int_equal(reply.status, 413);
  lod_reply_finish(&reply);
}

static void header_value_cannot_split_the_response(void **state) {
  (void)state;
  struct lod_reply reply = {0};
  lod_reply_header(&reply, "Location", "/a%sb", "\r\nSet-Cookie: x");
  assert_string_equal(reply.headers[0].value, "/a__Set-Cookie: xb");
}

/* ---- bodies and text ---- */

static int finished;
static void count_finish(void *context) {
  (void)context;
  finished++;
}

static void body_is_finished_by_its_last_holder(void **state) {
  (void)state;
  finished = 0;
  struct lod_body *body = lod_body_create("abc", 3, count_finish, NULL);
  lod_body_retain(body);
  lod_body_release(body);
  assert_int_equal(finished, 0);
  lod_body_release(body);
  assert_int_equal(finished, 1);
  lod_body_release(NULL);
}

static void gzip_reads_back(void **state) {
  (void)state;
  char text[5000];
  for (size_t i = 0; i < sizeof text; i++)
    text[i] = "level "[i % 6];
  struct lod_body *body = lod_body_create(text, sizeof text, NULL, NULL), *small = lod_body_gzip(body);
  assert_non_null(small);
  assert_true(small->size < 200);
  unsigned char back[6000];
  z_stream stream = {.next_in = (Bytef *)small->bytes, .avail_in = (uInt)small->size, .next_out = back, .avail_out = sizeof back};
  assert_int_equal(inflateInit2(&stream, 15 + 16), Z_OK);
  assert_int_equal(inflate(&stream, Z_FINISH), Z_STREAM_END);
  assert_int_equal(stream.total_out, sizeof text);
  assert_memory_equal(back, text, sizeof text);
  inflateEnd(&stream);
  lod_body_release(small);
  lod_body_release(body);
}

static void gzip_of_what_does_not_shrink_is_refused(void **state) {
  (void)state;
  unsigned char noise[4096];
  uint32_t x = 1;
  for (size_t i = 0; i < sizeof noise; i++)
    noise[i] = (unsigned char)((x = x * 1664525 + 1013904223) >> 24);
  struct lod_body *body = lod_body_create(noise, sizeof noise, NULL, NULL);
  assert_null(lod_body_gzip(body));
  lod_body_release(body);
}

static void accept_encoding_is_read_with_its_weights(void **state) {
  (void)state;
  assert_true(lod_accepts_gzip("gzip, deflate, br"));
  assert_true(lod_accepts_gzip("br;q=1.0, GZIP;q=0.5"));
  assert_true(lod_accepts_gzip("*"));
  assert_false(lod_accepts_gzip("gzip;q=0"));
  assert_false(lod_accepts_gzip("gzip; q=0.000"));
  assert_false(lod_accepts_gzip("br, xgzip"));
  assert_false(lod_accepts_gzip("identity"));
  assert_false(lod_accepts_gzip(""));
  assert_false(lod_accepts_gzip(NULL));
}

static void number_reads_back_as_the_same_double(void **state) {
  (void)state;
  static const double kNumbers[] = {0.1, 1.0 / 3, 5e-324, 1.7976931348623157e308, 3, 0.0031, 123456789.125};
  char text[32];
  for (size_t i = 0; i < sizeof kNumbers / sizeof *kNumbers; i++) {
    lod_format_number(kNumbers[i], text);
    assert_true(strtod(text, NULL) == kNumbers[i]);
  }
  lod_format_number(0.1, text);
  assert_string_equal(text, "0.1");
}

static void bound_is_never_below_and_hardly_above(void **state) {
  (void)state;
  char text[32];
  double value = 1e-30;
  for (int i = 0; i < 3000; i++, value *= 1.0517) {
    lod_format_bound(value, text);
    assert_true(strlen(text) <= 18);
    assert_true(strtod(text, NULL) >= value && strtod(text, NULL) <= value * (1 + 2e-11));
  }
  lod_format_bound(0, text);
  assert_string_equal(text, "0");
  lod_format_bound(1.7976931348623157e308, text);
  assert_true(strtod(text, NULL) == 1.7976931348623157e308);
}

static void bytes_outside_of_utf8_become_question_marks(void **state) {
  (void)state;
  static const char *const kPairs[][2] = {{"caf\xc3\xa9", "caf\xc3\xa9"},
                                          {"\xe2\x82\xac\xf0\x9f\x90\xb0", "\xe2\x82\xac\xf0\x9f\x90\xb0"},
                                          {"a\xffz", "a?z"},
                                          {"\xc0\x80", "??"},
                                          {"\xed\xa0\x80", "???"},
                                          {"\xc3", "?"},
                                          {"\xf4\x90\x80\x80", "????"}};
  for (size_t i = 0; i < sizeof kPairs / sizeof *kPairs; i++) {
    char *copy = lod_utf8_copy(kPairs[i][0]);
    assert_string_equal(copy, kPairs[i][1]);
    free(copy);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(single_range_is_cut_to_the_size),
      cmocka_unit_test(bad_range_is_told_from_no_range),
      cmocka_unit_test(entity_tag_lists_are_compared_weakly_or_strongly),
      cmocka_unit_test(conditions_come_before_ranges),
      cmocka_unit_test(range_counts_for_get_alone),
      cmocka_unit_test(if_range_needs_the_same_strong_tag),
      cmocka_unit_test(changes_follow_if_match_and_if_none_match),
      cmocka_unit_test(problem_is_rfc_9457),
      cmocka_unit_test(full_queue_is_503_and_other_limits_413),
      cmocka_unit_test(header_value_cannot_split_the_response),
      cmocka_unit_test(body_is_finished_by_its_last_holder),
      cmocka_unit_test(gzip_reads_back),
      cmocka_unit_test(gzip_of_what_does_not_shrink_is_refused),
      cmocka_unit_test(accept_encoding_is_read_with_its_weights),
      cmocka_unit_test(number_reads_back_as_the_same_double),
      cmocka_unit_test(bound_is_never_below_and_hardly_above),
      cmocka_unit_test(bytes_outside_of_utf8_become_question_marks),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
