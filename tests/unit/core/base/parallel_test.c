#include "core/base/parallel.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <string.h>

enum { MOST = 5000 };

struct record {
  size_t grain, count;
  unsigned char visits[MOST];
  double sums[MOST]; /* by chunk */
};

static void visit(void *context, size_t begin, size_t end, size_t chunk) {
  struct record *record = context;
  assert_true(begin == chunk * record->grain && begin < end && end <= record->count);
  assert_true(end - begin == record->grain || end == record->count);
  for (size_t i = begin; i < end; i++) {
    record->visits[i]++;
    record->sums[chunk] += 1.0 / (double)(i + 1);
  }
}

static void every_index_is_visited_once_and_sums_do_not_depend_on_threads(void **state) {
  (void)state;
  static const size_t kCounts[] = {0, 1, 63, 64, 65, 1000, MOST}, kGrains[] = {1, 7, 64, MOST, 3 * MOST};
  static struct record one, many;
  for (size_t c = 0; c < sizeof kCounts / sizeof kCounts[0]; c++)
    for (size_t g = 0; g < sizeof kGrains / sizeof kGrains[0]; g++) {
      memset(&one, 0, sizeof one);
      one.count = kCounts[c];
      one.grain = kGrains[g];
      many = one;
      lod_parallel_for(1, one.count, one.grain, visit, &one);
      lod_parallel_for(c % 2 ? 0 : 5, many.count, many.grain, visit, &many);
      for (size_t i = 0; i < MOST; i++)
        assert_int_equal(one.visits[i], i < one.count);
      assert_memory_equal(&one, &many, sizeof one);
    }
}

static void chunks_round_up(void **state) {
  (void)state;
  assert_int_equal(lod_parallel_chunks(0, 4), 0);
  assert_int_equal(lod_parallel_chunks(4, 4), 1);
  assert_int_equal(lod_parallel_chunks(5, 4), 2);
  assert_int_equal(lod_parallel_chunks(SIZE_MAX, 2), SIZE_MAX / 2 + 1);
}

struct listener {
  double fraction;
  bool stop;
};

static void hear(void *context, const char *stage, double fraction) {
  assert_string_equal(stage, "weld");
  ((struct listener *)context)->fraction = fraction;
}

static bool asked_to_stop(void *context) {
  return ((struct listener *)context)->stop;
}

static void progress_reaches_who_listens_and_nobody_need_listen(void **state) {
  (void)state;
  struct listener listener = {0};
  struct lod_progress progress = {.report = hear, .cancelled = asked_to_stop, .context = &listener}, deaf = {0};
  lod_progress_report(&progress, "weld", 0.5);
  assert_true(listener.fraction == 0.5);
  assert_false(lod_progress_cancelled(&progress));
  listener.stop = true;
  assert_true(lod_progress_cancelled(&progress));
  lod_progress_report(NULL, "weld", 1);
  lod_progress_report(&deaf, "weld", 1);
  assert_false(lod_progress_cancelled(NULL) || lod_progress_cancelled(&deaf));
}

static void step_fills_its_share_of_the_bar_and_stops_with_the_whole(void **state) {
  (void)state;
  struct listener listener = {0};
  struct lod_progress whole = {.report = hear, .cancelled = asked_to_stop, .context = &listener};
  struct lod_progress_span second_half, its_first_half, silent;
  lod_progress_span_init(&second_half, &whole, 0.5, 1);
  lod_progress_span_init(&its_first_half, &second_half.step, 0, 0.5);
  lod_progress_span_init(&silent, &whole, 0, 0);
  lod_progress_report(&second_half.step, "weld", 0);
  assert_true(listener.fraction == 0.5);
  lod_progress_report(&its_first_half.step, "weld", 1);
  assert_true(listener.fraction == 0.75);
  lod_progress_report(&silent.step, "weld", 1);
  assert_true(listener.fraction == 0.75);
  assert_false(lod_progress_cancelled(&its_first_half.step) || lod_progress_cancelled(&silent.step));
  listener.stop = true;
  assert_true(lod_progress_cancelled(&its_first_half.step) && lod_progress_cancelled(&silent.step));
  lod_progress_span_init(&second_half, NULL, 0.5, 1);
  lod_progress_report(&second_half.step, "weld", 1);
  assert_false(lod_progress_cancelled(&second_half.step));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_index_is_visited_once_and_sums_do_not_depend_on_threads),
      cmocka_unit_test(chunks_round_up),
      cmocka_unit_test(progress_reaches_who_listens_and_nobody_need_listen),
      cmocka_unit_test(step_fills_its_share_of_the_bar_and_stops_with_the_whole),
  };
  return cmocka_run_group_tests_name("core/base/parallel", tests, NULL, NULL);
}
