/* The arena of a test, as cmocka's set-up and tear-down: static in each test program. */
#ifndef LOD_TESTS_DATA_ARENA_H
#define LOD_TESTS_DATA_ARENA_H

#include "core/base/arena.h"

static struct lod_arena *arena;

static inline int open_arena(void **state) {
  (void)state;
  arena = lod_arena_create(0);
  return arena == NULL;
}

static inline int close_arena(void **state) {
  (void)state;
  lod_arena_destroy(arena);
  return 0;
}

#endif
