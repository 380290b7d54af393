#include "server/http/deadline.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const struct lod_deadline_limits kLimits = {.header_seconds = 10, .idle_seconds = 60, .rate_seconds = 30, .rate_bytes = 1000};

static void one_byte_a_second_of_headers_is_cut_after_ten_seconds(void **state) {
  (void)state;
  struct lod_deadline deadline;
  double now = 100;
  uint64_t received = 0;
  lod_deadline_accept(&deadline, now);
  enum lod_cut cut = LOD_CUT_NO;
  while (cut == LOD_CUT_NO && now < 200)
    cut = lod_deadline_check(&deadline, &kLimits, ++received, 0, now += 1);
  assert_int_equal(cut, LOD_CUT_HEADERS);
  assert_true(now > 110 && now <= 113);
}

static void drip_after_the_request_line_is_cut_too(void **state) {
  (void)state;
  struct lod_deadline deadline;
  lod_deadline_accept(&deadline, 100);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 5, 0, 101), LOD_CUT_NO);
  lod_deadline_enter(&deadline, LOD_PHASE_HEADERS, 105);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 90, 0, 110), LOD_CUT_NO);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 91, 0, 112), LOD_CUT_HEADERS); /* counted from the first byte */
}

static void silent_connection_is_cut_when_idle_too_long(void **state) {
  (void)state;
  struct lod_deadline deadline;
  lod_deadline_accept(&deadline, 100);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 0, 0, 159), LOD_CUT_NO);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 0, 0, 161), LOD_CUT_IDLE);
}

static void last_requests_bytes_do_not_begin_the_next(void **state) {
  (void)state;
  struct lod_deadline deadline;
  lod_deadline_accept(&deadline, 100);
  lod_deadline_enter(&deadline, LOD_PHASE_WAIT, 100);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 500, 0, 101), LOD_CUT_NO);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 500, 0, 130), LOD_CUT_NO);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 501, 0, 140), LOD_CUT_NO);
  assert_int_equal(lod_deadline_check(&deadline, &kLimits, 501, 0, 151), LOD_CUT_HEADERS);
}

static enum lod_cut transfer(enum lod_phase phase, uint64_t rate, double seconds) {
  struct lod_deadline deadline;
  enum lod_cut cut = LOD_CUT_NO;
  uint64_t bytes = 12345;
  lod_deadline_accept(&deadline, 100);
  lod_deadline_enter(&deadline, phase, 100);
  for (double now = 100; cut == LOD_CUT_NO && now < 100 + seconds; now += 1, bytes += rate)
    cut = phase == LOD_PHASE_SEND ? lod_deadline_check(&deadline, &kLimits, 1, bytes, now)
                                  : lod_deadline_check(&deadline, &kLimits, bytes, 1, now);
  return cut;
}

static void trickle_is_cut_and_a_steady_transfer_is_not(void **state) {
  (void)state;
  assert_int_equal(transfer(LOD_PHASE_SEND, 999, 100), LOD_CUT_SLOW_READER);
  assert_int_equal(transfer(LOD_PHASE_SEND, 0, 100), LOD_CUT_SLOW_READER);
  assert_int_equal(transfer(LOD_PHASE_SEND, 1001, 10000), LOD_CUT_NO);
  assert_int_equal(transfer(LOD_PHASE_RECEIVE, 999, 100), LOD_CUT_SLOW_SENDER);
  assert_int_equal(transfer(LOD_PHASE_RECEIVE, 1001, 10000), LOD_CUT_NO);
  assert_int_equal(transfer(LOD_PHASE_SEND, 0, 29), LOD_CUT_NO);
}

static void our_own_work_has_no_deadline(void **state) {
  (void)state;
  assert_int_equal(transfer(LOD_PHASE_WORK, 0, 100000), LOD_CUT_NO);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(one_byte_a_second_of_headers_is_cut_after_ten_seconds), cmocka_unit_test(drip_after_the_request_line_is_cut_too),
      cmocka_unit_test(silent_connection_is_cut_when_idle_too_long),           cmocka_unit_test(last_requests_bytes_do_not_begin_the_next),
      cmocka_unit_test(trickle_is_cut_and_a_steady_transfer_is_not),           cmocka_unit_test(our_own_work_has_no_deadline),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
