/* Memory of one job: allocations that live until the arena is destroyed, under one byte limit shared with child arenas.
 *
 * Results go into the caller's arena; scratch goes into a child that the function creates and destroys. An arena belongs to one
 * thread at a time; several children of one parent may be used by several threads at once (the shared byte count is atomic). */
#ifndef LOD_CORE_BASE_ARENA_H
#define LOD_CORE_BASE_ARENA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct lod_arena;

/* limit_bytes: the most that this arena and all its children hold at once; 0 = no limit. NULL when memory is out. */
struct lod_arena *lod_arena_create(size_t limit_bytes);

/* A child that counts against `parent`'s limit (and its parents'); the parent must outlive it. NULL when memory is out. */
struct lod_arena *lod_arena_create_child(struct lod_arena *parent);

/* Frees everything allocated from `arena`. NULL is allowed. Children must be destroyed before. */
void lod_arena_destroy(struct lod_arena *arena);

/* count * size bytes aligned to 64; uninitialised. NULL on overflow, limit or no memory. A count of 0 gives a valid pointer. */
void *lod_arena_alloc(struct lod_arena *arena, size_t count, size_t size);

/* The same, filled with zeros (pages of large blocks come from the system already zeroed). */
void *lod_arena_calloc(struct lod_arena *arena, size_t count, size_t size);

/* A copy of `size` bytes with a NUL behind it (so that text is a string). NULL on limit or no memory. */
void *lod_arena_copy(struct lod_arena *arena, const void *bytes, size_t size);

/* Bytes held now and at most so far, children included. */
size_t lod_arena_bytes(const struct lod_arena *arena);
size_t lod_arena_peak_bytes(const struct lod_arena *arena);

/* *product = a * b; false when it does not fit. */
bool lod_multiply(size_t a, size_t b, size_t *product);

/* Typed helper: T *p = LOD_NEW(arena, count, T); NULL on failure. */
#define LOD_NEW(arena, count, type) ((type *)lod_arena_alloc((arena), (count), sizeof(type)))
#define LOD_NEW_ZERO(arena, count, type) ((type *)lod_arena_calloc((arena), (count), sizeof(type)))

#endif
