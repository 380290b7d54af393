#include "core/base/arena.h"

#include <assert.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { ALIGNMENT = 64, SMALL_BLOCK = 64 * 1024 };

struct block {
  struct block *next;
  size_t size; /* payload bytes */
};

struct lod_arena {
  struct lod_arena *parent;
  struct block *blocks;
  unsigned char *free_begin; /* rest of the current small block */
  unsigned char *free_end;
  size_t limit;
  _Atomic size_t bytes;
  _Atomic size_t peak;
};

static const size_t kHeader = (sizeof(struct block) + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;

bool lod_multiply(size_t a, size_t b, size_t *product) {
  return !__builtin_mul_overflow(a, b, product);
}

static void uncharge(struct lod_arena *arena, size_t bytes) {
  for (; arena != NULL; arena = arena->parent)
    atomic_fetch_sub_explicit(&arena->bytes, bytes, memory_order_relaxed);
}

static bool charge(struct lod_arena *first, size_t bytes) {
  for (struct lod_arena *arena = first; arena != NULL; arena = arena->parent) {
    size_t now = atomic_fetch_add_explicit(&arena->bytes, bytes, memory_order_relaxed) + bytes;
    if (arena->limit != 0 && now > arena->limit) {
      for (struct lod_arena *undo = first;; undo = undo->parent) {
        atomic_fetch_sub_explicit(&undo->bytes, bytes, memory_order_relaxed);
        if (undo == arena)
          return false;
      }
    }
    size_t peak = atomic_load_explicit(&arena->peak, memory_order_relaxed);
    while (now > peak && !atomic_compare_exchange_weak_explicit(&arena->peak, &peak, now, memory_order_relaxed, memory_order_relaxed)) {
    }
  }
  return true;
}

static struct lod_arena *create(struct lod_arena *parent, size_t limit) {
  struct lod_arena *arena = calloc(1, sizeof *arena);
  if (arena != NULL) {
    arena->parent = parent;
    arena->limit = limit;
  }
  return arena;
}

struct lod_arena *lod_arena_create(size_t limit_bytes) {
  return create(NULL, limit_bytes);
}

struct lod_arena *lod_arena_create_child(struct lod_arena *parent) {
  assert(parent != NULL);
  return create(parent, 0);
}

void lod_arena_destroy(struct lod_arena *arena) {
  if (arena == NULL)
    return;
  uncharge(arena->parent, atomic_load_explicit(&arena->bytes, memory_order_relaxed));
  for (struct block *block = arena->blocks; block != NULL;) {
    struct block *next = block->next;
    free(block);
    block = next;
  }
  free(arena);
}

static unsigned char *add_block(struct lod_arena *arena, size_t size, bool zero) {
  size_t total;
  if (__builtin_add_overflow(size, kHeader + ALIGNMENT, &total) || !charge(arena, size))
    return NULL;
  /* calloc of a large block is a fresh mapping: zero pages cost nothing until they are touched. */
  struct block *block = zero ? calloc(1, total) : malloc(total);
  if (block == NULL) {
    uncharge(arena, size);
    return NULL;
  }
  block->next = arena->blocks;
  block->size = size;
  arena->blocks = block;
  uintptr_t start = (uintptr_t)block + sizeof *block;
  return (unsigned char *)((start + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT);
}

static void *allocate(struct lod_arena *arena, size_t count, size_t size, bool zero) {
  size_t bytes;
  if (!lod_multiply(count, size, &bytes) || bytes > SIZE_MAX / 2)
    return NULL;
  bytes = bytes == 0 ? ALIGNMENT : (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
  if (bytes > SMALL_BLOCK / 4)
    return add_block(arena, bytes, zero);
  if (arena->free_begin == NULL || (size_t)(arena->free_end - arena->free_begin) < bytes) {
    unsigned char *begin = add_block(arena, SMALL_BLOCK, false);
    if (begin == NULL)
      return NULL;
    arena->free_begin = begin;
    arena->free_end = begin + SMALL_BLOCK;
  }
  void *result = arena->free_begin;
  arena->free_begin += bytes;
  if (zero)
    memset(result, 0, bytes);
  return result;
}

void *lod_arena_alloc(struct lod_arena *arena, size_t count, size_t size) {
  return allocate(arena, count, size, false);
}

void *lod_arena_calloc(struct lod_arena *arena, size_t count, size_t size) {
  return allocate(arena, count, size, true);
}

void *lod_arena_copy(struct lod_arena *arena, const void *bytes, size_t size) {
  if (size == SIZE_MAX)
    return NULL;
  unsigned char *copy = allocate(arena, size + 1, 1, false);
  if (copy == NULL)
    return NULL;
  if (size != 0)
    memcpy(copy, bytes, size);
  copy[size] = 0;
  return copy;
}

size_t lod_arena_bytes(const struct lod_arena *arena) {
  return atomic_load_explicit(&arena->bytes, memory_order_relaxed);
}

size_t lod_arena_peak_bytes(const struct lod_arena *arena) {
  return atomic_load_explicit(&arena->peak, memory_order_relaxed);
}
