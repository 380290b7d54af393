/* Warm workers that answer, fail, crash, hang, lie and leave. This program is its own worker (pool_worker.h). */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "server/jobs/pool.h"
#include "tests/unit/server/jobs/pool_worker.h"

static char self[4096];

struct errand {
  struct lod_pool_job job;
  char parameters[64];
  atomic_uint told;
};

static void quiet(void *context, const char *line) {
  (void)context, (void)line;
}

static const char *folder; /* of the next pool's workers */

static struct lod_pool *pool_of(uint32_t workers, uint32_t queue, double seconds) {
  struct lod_pool_settings settings = lod_pool_defaults();
  struct lod_pool *pool;
  struct lod_problem problem = {0};
  settings.worker_path = self;
  settings.workers = workers;
  settings.queue_limit = queue;
  settings.deadline_seconds = seconds;
  settings.memory_limit_bytes = UINT64_C(1) << 44; /* a sanitizer's shadow counts */
  settings.log = quiet;
  settings.folder = folder;
  if (lod_pool_create(&settings, &pool, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return pool;
}

static void done(struct lod_pool_job *job) {
  atomic_fetch_add(&((struct errand *)job)->told, 1);
}

static struct errand *errand_of(const char *role) {
  struct errand *errand = calloc(1, sizeof *errand);
  snprintf(errand->parameters, sizeof errand->parameters, "{\"role\":\"%s\"}", role);
  errand->job = (struct lod_pool_job){.kind = "refine", .parameters = errand->parameters, .done = done};
  memset(errand->job.base, 'a', 64);
  return errand;
}

static void submit(struct lod_pool *pool, struct errand *errand) {
  struct lod_problem problem = {0};
  if (lod_pool_submit(pool, &errand->job, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
}

static void wait_for(const struct errand *errand) {
  for (int i = 0; i < 6000 && atomic_load(&errand->told) == 0; i++)
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  assert_int_equal(atomic_load(&errand->told), 1);
}

static void forget(struct errand *errand) {
  free(errand->job.facts);
  free(errand->job.bytes);
  free(errand);
}

static struct errand *ask(struct lod_pool *pool, const char *role) {
  struct errand *errand = errand_of(role);
  submit(pool, errand);
  wait_for(errand);
  return errand;
}

static int pid_of(const struct errand *errand) {
  assert_non_null(errand->job.facts);
  return (int)strtol(strstr(errand->job.facts, "\"pid\":") + 6, NULL, 10);
}

/* A worker answers; its process. */
static int answered_by(struct lod_pool *pool) {
  struct errand *errand = ask(pool, "quick");
  assert_int_equal(errand->job.problem.status, LOD_OK);
  assert_int_equal(errand->job.size, 5);
  assert_memory_equal(errand->job.bytes, "quick", 5);
  int pid = pid_of(errand);
  forget(errand);
  return pid;
}

static void until_busy(struct lod_pool *pool, uint64_t running, uint64_t waiting) {
  struct lod_pool_counts counts = {0};
  for (int i = 0; i < 6000; i++) {
    counts = lod_pool_counts(pool);
    if (counts.running == running && counts.waiting == waiting)
      return;
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  }
  fail_msg("%d run, %d wait", (int)counts.running, (int)counts.waiting);
}

/* ---- tests ---- */

static void test_values_and_base_reach_the_worker_and_the_answer_comes_back(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 4, 20);
  static uint8_t base[2 * LOD_FRAME_MAX + 7], values[LOD_FRAME_MAX + 4];
  memset(base, 'b', sizeof base);
  memset(values, 'v', sizeof values);
  struct errand *errand = errand_of("echo");
  errand->job.base_bytes = base;
  errand->job.base_size = sizeof base;
  errand->job.values = values;
  errand->job.values_size = sizeof values;
  submit(pool, errand);
  wait_for(errand);
  assert_int_equal(errand->job.problem.status, LOD_OK);
  assert_int_equal(errand->job.size, sizeof base + sizeof values);
  assert_memory_equal(errand->job.bytes, values, sizeof values);
  assert_memory_equal(errand->job.bytes + sizeof values, base, sizeof base);
  forget(errand);
  errand = ask(pool, "large");
  assert_int_equal(errand->job.size, 3 * LOD_FRAME_MAX + 5);
  for (size_t i = 0; i < errand->job.size; i++)
    assert_int_equal(errand->job.bytes[i], (uint8_t)(i % 251));
  forget(errand);
  errand = ask(pool, "empty");
  assert_int_equal(errand->job.problem.status, LOD_OK);
  assert_int_equal(errand->job.size, 0);
  forget(errand);
  struct lod_pool_counts counts = lod_pool_counts(pool);
  assert_int_equal(counts.answered, 3);
  assert_int_equal(counts.workers_started, 1);
  assert_int_equal(counts.alive, 1);
  assert_true(counts.seconds > 0);
  lod_pool_destroy(pool);
}

static void test_a_failure_keeps_its_words_and_the_worker(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 4, 20);
  int before = answered_by(pool);
  struct errand *errand = ask(pool, "fail");
  assert_int_equal(errand->job.problem.status, LOD_BAD_INPUT);
  assert_string_equal(errand->job.problem.type, "bad-parameter");
  assert_string_equal(errand->job.problem.detail, "No such part.");
  assert_string_equal(errand->job.parameter, "part");
  assert_null(errand->job.bytes);
  forget(errand);
  assert_int_equal(answered_by(pool), before);
  assert_int_equal(lod_pool_counts(pool).failed, 1);
  lod_pool_destroy(pool);
}

static void test_workers_that_die_or_lie_are_replaced_and_counted_by_cause(void **state) {
  (void)state;
  static const struct {
    const char *role;
    enum lod_pool_end end;
  } kDeaths[] = {{"signal", LOD_POOL_END_SIGNAL},   {"exit", LOD_POOL_END_EXIT},      {"half", LOD_POOL_END_EXIT},
                 {"more", LOD_POOL_END_NONSENSE},   {"twice", LOD_POOL_END_NONSENSE}, {"negative", LOD_POOL_END_NONSENSE},
                 {"strange", LOD_POOL_END_NONSENSE}};
  struct lod_pool *pool = pool_of(1, 4, 20);
  for (size_t i = 0; i < sizeof kDeaths / sizeof *kDeaths; i++) {
    int before = answered_by(pool);
    uint64_t ends = lod_pool_counts(pool).ends[kDeaths[i].end];
    struct errand *errand = ask(pool, kDeaths[i].role);
    assert_int_equal(errand->job.problem.status, LOD_IO);
    assert_string_equal(errand->job.problem.type, "worker-crashed");
    assert_null(errand->job.bytes);
    assert_null(errand->job.facts);
    forget(errand);
    assert_int_equal(lod_pool_counts(pool).ends[kDeaths[i].end], ends + 1);
    assert_int_not_equal(answered_by(pool), before);
  }
  assert_int_equal(lod_pool_counts(pool).crashed, sizeof kDeaths / sizeof *kDeaths);
  lod_pool_destroy(pool);
}

static void test_a_worker_that_leaves_between_requests_costs_nobody_an_answer(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 4, 20);
  for (int i = 0; i < 3; i++) {
    struct errand *errand = ask(pool, "leave");
    assert_int_equal(errand->job.problem.status, LOD_OK);
    assert_memory_equal(errand->job.bytes, "left", 4);
    forget(errand);
    nanosleep(&(struct timespec){.tv_nsec = 100000000}, NULL); /* until it has ended */
    (void)answered_by(pool);
  }
  assert_int_equal(lod_pool_counts(pool).ends[LOD_POOL_END_IDLE], 3);
  assert_int_equal(lod_pool_counts(pool).crashed, 0);
  lod_pool_destroy(pool);
}

static void test_a_full_queue_refuses_and_a_cancelled_request_makes_room(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 2, 60);
  struct errand *running = errand_of("stop"), *first = errand_of("quick"), *second = errand_of("quick"), *third = errand_of("quick");
  submit(pool, running);
  until_busy(pool, 1, 0);
  submit(pool, first);
  submit(pool, second);
  struct lod_problem problem = {0};
  assert_int_equal(lod_pool_submit(pool, &third->job, &problem), LOD_LIMIT);
  assert_string_equal(problem.type, "queue-full");
  lod_pool_cancel(pool, &first->job); /* the one at the head */
  assert_int_equal(atomic_load(&first->told), 1);
  assert_int_equal(first->job.problem.status, LOD_CANCELLED);
  submit(pool, third);
  lod_pool_cancel(pool, &third->job); /* the one at the tail */
  assert_int_equal(atomic_load(&third->told), 1);
  assert_int_equal(atomic_load(&second->told), 0);
  lod_pool_cancel(pool, &running->job); /* the worker stops when told to, and lives on */
  wait_for(running);
  assert_string_equal(running->job.problem.type, "cancelled");
  wait_for(second);
  assert_int_equal(second->job.problem.status, LOD_OK);
  struct lod_pool_counts counts = lod_pool_counts(pool);
  assert_int_equal(counts.refused, 1);
  assert_int_equal(counts.cancelled, 3);
  assert_int_equal(counts.workers_started, 1);
  assert_true(counts.wait_seconds > 0);
  lod_pool_destroy(pool);
  forget(running);
  forget(first);
  forget(second);
  forget(third);
}

static void test_a_worker_that_does_not_stop_is_ended(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 2, 60);
  struct errand *errand = errand_of("hang");
  submit(pool, errand);
  until_busy(pool, 1, 0);
  lod_pool_cancel(pool, &errand->job);
  wait_for(errand);
  assert_string_equal(errand->job.problem.type, "cancelled");
  assert_int_equal(lod_pool_counts(pool).ends[LOD_POOL_END_CANCELLED], 1);
  (void)answered_by(pool);
  lod_pool_destroy(pool);
  forget(errand);
}

static void test_deadlines_hold_at_work_and_in_the_queue(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1, 4, 0.7);
  struct errand *working = errand_of("hang"), *waiting = errand_of("hang");
  submit(pool, working);
  until_busy(pool, 1, 0);
  submit(pool, waiting);
  wait_for(working);
  wait_for(waiting);
  assert_string_equal(working->job.problem.type, "deadline");
  assert_int_equal(waiting->job.problem.status, LOD_CANCELLED);
  assert_string_equal(waiting->job.problem.type, "deadline");
  assert_int_equal(lod_pool_counts(pool).late, 2);
  assert_true(lod_pool_counts(pool).ends[LOD_POOL_END_DEADLINE] >= 1);
  lod_pool_destroy(pool);
  forget(working);
  forget(waiting);
}

static void test_the_end_tells_everybody(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(2, 8, 60);
  struct errand *list[6];
  for (int i = 0; i < 6; i++)
    submit(pool, list[i] = errand_of("stop"));
  until_busy(pool, 2, 4);
  lod_pool_destroy(pool);
  for (int i = 0; i < 6; i++) {
    assert_int_equal(atomic_load(&list[i]->told), 1);
    assert_int_equal(list[i]->job.problem.status, LOD_CANCELLED);
    forget(list[i]);
  }
  lod_pool_destroy(NULL);
}

static void test_a_program_that_is_not_there_is_a_clear_error(void **state) {
  (void)state;
  struct lod_pool_settings settings = lod_pool_defaults();
  struct lod_pool *pool;
  settings.worker_path = "/nowhere/lodestream";
  settings.workers = 1;
  settings.log = quiet;
  assert_int_equal(lod_pool_create(&settings, &pool, NULL), LOD_OK);
  struct errand *errand = ask(pool, "quick");
  assert_int_equal(errand->job.problem.status, LOD_IO);
  assert_string_not_equal(errand->job.problem.detail, "");
  forget(errand);
  lod_pool_destroy(pool);
}

/* A container's root is read-only, /tmp with it; on a full disk the store is. */
static void test_workers_start_in_the_folder_given_or_in_tmp(void **state) {
  (void)state;
  char own[] = "/tmp/lodestream-pool-XXXXXX";
  assert_non_null(mkdtemp(own));
  const struct timespec long_ago[2] = {{0, 0}, {0, 0}};
  struct stat facts;
  assert_int_equal(utimensat(AT_FDCWD, own, long_ago, 0), 0);
  const char *const folders[] = {own, "/nowhere/at/all"};
  for (int i = 0; i < 2; i++) {
    folder = folders[i];
    struct lod_pool *pool = pool_of(1, 4, 60);
    assert_true(answered_by(pool) > 0);
    lod_pool_destroy(pool);
  }
  folder = NULL;
  assert_int_equal(stat(own, &facts), 0);
  assert_true(facts.st_mtim.tv_sec > 0); /* something was made in it, */
  assert_int_equal(rmdir(own), 0);       /* and is gone */
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "worker") == 0)
    return act_as_pool_worker();
  if (realpath("/proc/self/exe", self) == NULL)
    return 1;
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_values_and_base_reach_the_worker_and_the_answer_comes_back),
      cmocka_unit_test(test_a_failure_keeps_its_words_and_the_worker),
      cmocka_unit_test(test_workers_that_die_or_lie_are_replaced_and_counted_by_cause),
      cmocka_unit_test(test_a_worker_that_leaves_between_requests_costs_nobody_an_answer),
      cmocka_unit_test(test_a_full_queue_refuses_and_a_cancelled_request_makes_room),
      cmocka_unit_test(test_a_worker_that_does_not_stop_is_ended),
      cmocka_unit_test(test_deadlines_hold_at_work_and_in_the_queue),
      cmocka_unit_test(test_the_end_tells_everybody),
      cmocka_unit_test(test_workers_start_in_the_folder_given_or_in_tmp),
      cmocka_unit_test(test_a_program_that_is_not_there_is_a_clear_error),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
