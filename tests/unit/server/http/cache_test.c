#include "server/http/cache.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>

static atomic_int finished;
static int values[100];
static void finish(void *value) {
  (void)value;
  atomic_fetch_add(&finished, 1);
}

static struct lod_cache *fresh(size_t capacity) {
  atomic_store(&finished, 0);
  struct lod_cache *cache = lod_cache_create(capacity, finish);
  assert_non_null(cache);
  return cache;
}

static void put(struct lod_cache *cache, int key, uint64_t generation) {
  lod_cache_release(cache, lod_cache_insert(cache, &key, sizeof key, generation, &values[key]));
}

static bool has(struct lod_cache *cache, int key, uint64_t generation) {
  struct lod_cache_entry *entry = lod_cache_find(cache, &key, sizeof key, generation);
  if (!entry)
    return false;
  assert_ptr_equal(lod_cache_value(entry), &values[key]);
  lod_cache_release(cache, entry);
  return true;
}

static void least_recently_used_goes_first(void **state) {
  (void)state;
  struct lod_cache *cache = fresh(3);
  for (int key = 0; key < 3; key++)
    put(cache, key, 0);
  assert_true(has(cache, 0, 0)); /* now 1 is the oldest */
  put(cache, 3, 0);
  assert_int_equal(atomic_load(&finished), 1);
  assert_false(has(cache, 1, 0));
  assert_true(has(cache, 0, 0) && has(cache, 2, 0) && has(cache, 3, 0));
  assert_int_equal(lod_cache_counts(cache).entries, 3);
  lod_cache_destroy(cache);
  assert_int_equal(atomic_load(&finished), 4);
}

static void held_value_outlives_its_eviction(void **state) {
  (void)state;
  struct lod_cache *cache = fresh(1);
  int key = 0;
  struct lod_cache_entry *held = lod_cache_insert(cache, &key, sizeof key, 0, &values[0]);
  put(cache, 1, 0);
  assert_int_equal(atomic_load(&finished), 0);
  assert_ptr_equal(lod_cache_value(held), &values[0]);
  lod_cache_release(cache, held);
  assert_int_equal(atomic_load(&finished), 1);
  lod_cache_destroy(cache);
}

static void new_generation_empties_the_cache(void **state) {
  (void)state;
  struct lod_cache *cache = fresh(10);
  for (int key = 0; key < 5; key++)
    put(cache, key, 7);
  assert_true(has(cache, 3, 7));
  assert_false(has(cache, 3, 8));
  assert_int_equal(atomic_load(&finished), 5);
  put(cache, 3, 8);
  lod_cache_trim(cache, 8);
  assert_true(has(cache, 3, 8));
  lod_cache_trim(cache, 9);
  assert_int_equal(atomic_load(&finished), 6);
  lod_cache_destroy(cache);
}

static void value_of_an_older_generation_is_not_kept(void **state) {
  (void)state;
  struct lod_cache *cache = fresh(10);
  int key = 2;
  put(cache, 1, 5);
  struct lod_cache_entry *late = lod_cache_insert(cache, &key, sizeof key, 4, &values[2]);
  assert_ptr_equal(lod_cache_value(late), &values[2]);
  assert_true(has(cache, 1, 5));
  assert_true(has(cache, 1, 4));
  assert_false(has(cache, 2, 5));
  lod_cache_release(cache, late);
  assert_int_equal(atomic_load(&finished), 1);
  lod_cache_destroy(cache);
}

static void second_value_of_a_key_is_dropped_for_the_first(void **state) {
  (void)state;
  struct lod_cache *cache = fresh(10);
  int key = 4;
  put(cache, key, 0);
  struct lod_cache_entry *entry = lod_cache_insert(cache, &key, sizeof key, 0, &values[9]);
  assert_ptr_equal(lod_cache_value(entry), &values[4]);
  assert_int_equal(atomic_load(&finished), 1);
  lod_cache_release(cache, entry);
  lod_cache_destroy(cache);
}

static struct lod_cache *shared;
static void *hammer(void *argument) {
  unsigned x = *(unsigned *)argument;
  for (int i = 0; i < 20000; i++) {
    int key = (int)((x = x * 1664525 + 1013904223) >> 24) % 50;
    uint64_t generation = (uint64_t)i / 5000;
    if (!has(shared, key, generation))
      put(shared, key, generation);
  }
  return NULL;
}

static void threads_finish_each_value_once(void **state) {
  (void)state;
  shared = fresh(20);
  pthread_t threads[4];
  unsigned seeds[4] = {1, 2, 3, 4};
  for (int i = 0; i < 4; i++)
    assert_int_equal(pthread_create(&threads[i], NULL, hammer, &seeds[i]), 0);
  for (int i = 0; i < 4; i++)
    pthread_join(threads[i], NULL);
  struct lod_cache_counts counts = lod_cache_counts(shared);
  assert_true(counts.entries <= 20);
  assert_int_equal(counts.hits + counts.misses, 80000);
  lod_cache_destroy(shared);
  assert_int_equal(atomic_load(&finished), counts.misses); /* each miss made one value, kept or not */
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(least_recently_used_goes_first),
      cmocka_unit_test(held_value_outlives_its_eviction),
      cmocka_unit_test(new_generation_empties_the_cache),
      cmocka_unit_test(value_of_an_older_generation_is_not_kept),
      cmocka_unit_test(second_value_of_a_key_is_dropped_for_the_first),
      cmocka_unit_test(threads_finish_each_value_once),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
