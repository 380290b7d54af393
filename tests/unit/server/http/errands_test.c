/* Equal jobs go together. This program is the pool's worker too (pool_worker.h). */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <pthread.h>
#include <time.h>

#include "server/http/errands.h"
#include "tests/unit/server/jobs/pool_worker.h"

static char self[4096];

struct client {
  struct lod_waiter waiter;
  atomic_uint told;
  enum lod_status status;
  bool cancelled;
  char text[16];
};

static void quiet(void *context, const char *line) {
  (void)context, (void)line;
}

static struct lod_pool *pool_of(uint32_t queue) {
  struct lod_pool_settings settings = lod_pool_defaults();
  struct lod_pool *pool;
  settings.worker_path = self;
  settings.workers = 1;
  settings.queue_limit = queue;
  settings.deadline_seconds = 60;
  settings.memory_limit_bytes = UINT64_C(1) << 44;
  settings.log = quiet;
  assert_int_equal(lod_pool_create(&settings, &pool, NULL), LOD_OK);
  return pool;
}

static void take(struct lod_waiter *waiter, struct lod_errand *errand, bool cancelled) {
  struct client *client = (struct client *)waiter;
  client->status = errand->job.problem.status;
  client->cancelled = cancelled;
  if (errand->answer != NULL)
    snprintf(client->text, sizeof client->text, "%.*s", (int)errand->answer->size, (const char *)errand->answer->bytes);
  atomic_fetch_add(&client->told, 1);
}

static atomic_uint landings;
static void land(struct lod_errand *errand) {
  atomic_fetch_add(&landings, 1);
  if (errand->job.problem.status != LOD_OK)
    return;
  errand->answer = lod_body_create(errand->job.bytes, errand->job.size, free, errand->job.bytes);
  errand->job.bytes = NULL;
}

static enum lod_status join(struct lod_errands *errands, const char *key, const char *role, struct client *client) {
  struct lod_errand *errand = lod_errand_create();
  struct lod_problem problem = {0};
  assert_non_null(errand);
  snprintf(errand->key, sizeof errand->key, "%s", key);
  assert_true(asprintf(&errand->parameters, "{\"role\":\"%s\"}", role) > 0);
  errand->base = lod_body_create("base", 4, NULL, NULL);
  errand->job.kind = "refine";
  memset(errand->job.base, 'a', 64);
  errand->landed = land;
  client->waiter.done = take;
  enum lod_status status = lod_errands_join(errands, errand, &client->waiter, &problem);
  lod_errand_release(errand);
  return status;
}

static void wait_for(struct client *client) {
  for (int i = 0; i < 6000 && atomic_load(&client->told) == 0; i++)
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  assert_int_equal(atomic_load(&client->told), 1);
}

static void until(struct lod_pool *pool, uint64_t running, uint64_t waiting) {
  for (int i = 0; i < 6000; i++) {
    struct lod_pool_counts counts = lod_pool_counts(pool);
    if (counts.running == running && counts.waiting == waiting)
      return;
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  }
  fail();
}

static void test_equal_ones_are_one_job_and_others_are_not(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(8);
  struct lod_errands *errands = lod_errands_create(pool);
  struct client busy = {0}, same[3] = {0}, other = {0};
  atomic_store(&landings, 0);
  assert_int_equal(join(errands, "busy", "stop", &busy), LOD_OK);
  until(pool, 1, 0);
  for (int i = 0; i < 3; i++)
    assert_int_equal(join(errands, "same", "quick", &same[i]), LOD_OK);
  assert_int_equal(join(errands, "other", "quick", &other), LOD_OK);
  until(pool, 1, 2);
  assert_int_equal(lod_errands_shared(errands), 2);
  lod_errands_leave(errands, &busy.waiter);
  assert_true(busy.cancelled && atomic_load(&busy.told) == 1);
  for (int i = 0; i < 3; i++) {
    wait_for(&same[i]);
    assert_int_equal(same[i].status, LOD_OK);
    assert_string_equal(same[i].text, "quick");
  }
  wait_for(&other);
  assert_int_equal(lod_pool_counts(pool).answered, 2);
  assert_int_equal(atomic_load(&landings), 3);
  /* What is over is asked for anew. */
  struct client later = {0};
  assert_int_equal(join(errands, "same", "quick", &later), LOD_OK);
  wait_for(&later);
  assert_int_equal(lod_pool_counts(pool).answered, 3);
  lod_errands_leave(errands, &later.waiter); /* too late: nothing happens */
  assert_int_equal(atomic_load(&later.told), 1);
  lod_pool_destroy(pool);
  lod_errands_destroy(errands);
}

static void test_one_that_leaves_does_not_take_the_answer_from_the_others_and_the_last_cancels(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(8);
  struct lod_errands *errands = lod_errands_create(pool);
  struct client first = {0}, second = {0}, third = {0};
  assert_int_equal(join(errands, "k", "stop", &first), LOD_OK);
  assert_int_equal(join(errands, "k", "stop", &second), LOD_OK);
  until(pool, 1, 0);
  lod_errands_leave(errands, &first.waiter); /* whose job it is */
  assert_true(first.cancelled && atomic_load(&first.told) == 1);
  assert_int_equal(lod_pool_counts(pool).running, 1);
  assert_int_equal(atomic_load(&second.told), 0);
  lod_errands_leave(errands, &second.waiter);
  assert_true(second.cancelled);
  /* The job is told to stop; whoever asks the same now gets a job of its own. */
  assert_int_equal(join(errands, "k", "quick", &third), LOD_OK);
  wait_for(&third);
  assert_int_equal(third.status, LOD_OK);
  assert_string_equal(third.text, "quick");
  assert_int_equal(lod_pool_counts(pool).cancelled, 1);
  lod_pool_destroy(pool);
  lod_errands_destroy(errands);
}

static void test_failures_and_the_end_reach_all(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(1);
  struct lod_errands *errands = lod_errands_create(pool);
  struct client bad[2] = {0}, busy = {0}, waits[2] = {0}, refused = {0}, gone = {0};
  assert_int_equal(join(errands, "busy", "stop", &busy), LOD_OK);
  until(pool, 1, 0);
  assert_int_equal(join(errands, "bad", "fail", &bad[0]), LOD_OK);
  assert_int_equal(join(errands, "bad", "fail", &bad[1]), LOD_OK);
  assert_int_equal(join(errands, "full", "quick", &refused), LOD_LIMIT);
  assert_int_equal(atomic_load(&refused.told), 0);
  lod_errands_leave(errands, &gone.waiter); /* before it was sent */
  assert_int_equal(join(errands, "bad", "fail", &gone), LOD_CANCELLED);
  lod_errands_leave(errands, &busy.waiter);
  for (int i = 0; i < 2; i++) {
    wait_for(&bad[i]);
    assert_int_equal(bad[i].status, LOD_BAD_INPUT);
  }
  for (int i = 0; i < 2; i++)
    assert_int_equal(join(errands, "last", "stop", &waits[i]), LOD_OK);
  lod_pool_destroy(pool);
  for (int i = 0; i < 2; i++) {
    wait_for(&waits[i]);
    assert_int_equal(waits[i].status, LOD_CANCELLED);
  }
  lod_errands_destroy(errands);
  lod_errands_destroy(NULL);
  lod_errand_release(NULL);
}

/* Many come and go at once. */
struct crowd {
  struct lod_errands *errands;
  unsigned number;
};
static void *visit(void *argument) {
  struct crowd *crowd = argument;
  unsigned random = 12345u + 77u * crowd->number;
  for (int i = 0; i < 60; i++) {
    struct client *client = calloc(1, sizeof *client);
    char key[8];
    random = random * 1664525u + 1013904223u;
    snprintf(key, sizeof key, "k%u", random >> 30);
    if (join(crowd->errands, key, "quick", client) == LOD_OK) {
      if (random >> 20 & 1)
        lod_errands_leave(crowd->errands, &client->waiter);
      wait_for(client);
      assert_true(client->cancelled || strcmp(client->text, "quick") == 0);
    }
    free(client);
  }
  return NULL;
}
static void test_a_crowd_is_served(void **state) {
  (void)state;
  struct lod_pool *pool = pool_of(64);
  struct crowd crowd[6];
  pthread_t threads[6];
  struct lod_errands *errands = lod_errands_create(pool);
  for (unsigned i = 0; i < 6; i++) {
    crowd[i] = (struct crowd){errands, i};
    assert_int_equal(pthread_create(&threads[i], NULL, visit, &crowd[i]), 0);
  }
  for (int i = 0; i < 6; i++)
    pthread_join(threads[i], NULL);
  lod_pool_destroy(pool);
  lod_errands_destroy(errands);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "worker") == 0)
    return act_as_pool_worker();
  if (realpath("/proc/self/exe", self) == NULL)
    return 1;
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_equal_ones_are_one_job_and_others_are_not),
      cmocka_unit_test(test_one_that_leaves_does_not_take_the_answer_from_the_others_and_the_last_cancels),
      cmocka_unit_test(test_failures_and_the_end_reach_all),
      cmocka_unit_test(test_a_crowd_is_served),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
