#include "core/base/arena.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <stdint.h>
#include <string.h>

static void every_allocation_is_aligned_to_64_and_its_own(void **state) {
  (void)state;
  enum { N = 200 };
  unsigned char *blocks[N];
  struct lod_arena *arena = lod_arena_create(0);
  for (size_t i = 0; i < N; i++) { /* small ones share blocks, those over 16 KiB have their own */
    size_t size = i % 7 == 0 ? 40000 + i : i * 13;
    blocks[i] = lod_arena_alloc(arena, size, 1);
    assert_non_null(blocks[i]);
    assert_int_equal((uintptr_t)blocks[i] % 64, 0);
    memset(blocks[i], (int)i, size);
  }
  for (size_t i = 0; i < N; i++) {
    size_t size = i % 7 == 0 ? 40000 + i : i * 13;
    for (size_t b = 0; b < size; b++)
      assert_int_equal(blocks[i][b], (unsigned char)i);
  }
  lod_arena_destroy(arena);
}

static void a_count_of_zero_gives_a_pointer(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  assert_non_null(lod_arena_alloc(arena, 0, 8));
  assert_non_null(LOD_NEW_ZERO(arena, 0, double));
  lod_arena_destroy(arena);
  lod_arena_destroy(NULL);
}

static void a_product_that_overflows_gives_null(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  size_t product = 7;
  assert_null(lod_arena_alloc(arena, SIZE_MAX / 4, 8));
  assert_null(lod_arena_alloc(arena, SIZE_MAX, 1));
  assert_null(lod_arena_calloc(arena, SIZE_MAX - 8, 1));
  assert_null(lod_arena_copy(arena, "", SIZE_MAX));
  assert_int_equal(lod_arena_bytes(arena), 0);
  assert_false(lod_multiply(SIZE_MAX / 2, 3, &product));
  assert_true(lod_multiply(6, 7, &product));
  assert_int_equal(product, 42);
  lod_arena_destroy(arena);
}

static void zeroed_memory_is_zero_where_used_memory_was(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  for (size_t size = 1; size < 100000; size = size * 3 + 1) {
    struct lod_arena *child = lod_arena_create_child(arena);
    memset(lod_arena_alloc(child, size, 1), 0xa5, size);
    lod_arena_destroy(child);
    const unsigned char *zero = lod_arena_calloc(arena, size, 1);
    for (size_t i = 0; i < size; i++)
      assert_int_equal(zero[i], 0);
  }
  lod_arena_destroy(arena);
}

static void a_copy_of_text_ends_in_nul(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  assert_string_equal(lod_arena_copy(arena, "tree and pot", 4), "tree");
  assert_string_equal(lod_arena_copy(arena, NULL, 0), "");
  lod_arena_destroy(arena);
}

static void a_limit_holds_for_all_children_together_and_is_given_back(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(1 << 20);
  struct lod_arena *a = lod_arena_create_child(arena), *b = lod_arena_create_child(a);
  assert_non_null(lod_arena_alloc(a, 400000, 1));
  assert_non_null(lod_arena_alloc(b, 400000, 1));
  size_t held = lod_arena_bytes(arena);
  assert_true(held >= 800000);
  assert_null(lod_arena_alloc(b, 400000, 1));
  assert_int_equal(lod_arena_bytes(arena), held);
  assert_int_equal(lod_arena_bytes(a), held);
  lod_arena_destroy(b);
  assert_true(lod_arena_bytes(arena) < 500000);
  assert_non_null(lod_arena_alloc(arena, 400000, 1));
  assert_true(lod_arena_peak_bytes(arena) >= 800000 && lod_arena_peak_bytes(arena) <= 1 << 20);
  lod_arena_destroy(a);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_allocation_is_aligned_to_64_and_its_own),
      cmocka_unit_test(a_count_of_zero_gives_a_pointer),
      cmocka_unit_test(a_product_that_overflows_gives_null),
      cmocka_unit_test(zeroed_memory_is_zero_where_used_memory_was),
      cmocka_unit_test(a_copy_of_text_ends_in_nul),
      cmocka_unit_test(a_limit_holds_for_all_children_together_and_is_given_back),
  };
  return cmocka_run_group_tests_name("core/base/arena", tests, NULL, NULL);
}
