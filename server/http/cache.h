/* Bounded cache of counted values, least recently used out first. Any thread may use it. */
#ifndef LOD_SERVER_HTTP_CACHE_H
#define LOD_SERVER_HTTP_CACHE_H

#include <stddef.h>
#include <stdint.h>

struct lod_cache;
struct lod_cache_entry; /* a held value */

/* capacity: values kept; finish: called once for each value, when it is out of the cache and nobody holds it. NULL: memory is out. */
struct lod_cache *lod_cache_create(size_t capacity, void (*finish)(void *value));
/* Everything must have been released. NULL is allowed. */
void lod_cache_destroy(struct lod_cache *cache);

/* The value under key, held until released; NULL = there is none.
 * generation: what values belong to; a higher number than that of the values inside empties the cache first. */
struct lod_cache_entry *lod_cache_find(struct lod_cache *cache, const void *key, size_t key_size, uint64_t generation);
/* Puts a value in (taken) and holds it. When another thread was first, its value is held and this one finished. A value of an older
 * generation is held for the caller alone. The value is finished and
 * NULL returned when memory is out. */
struct lod_cache_entry *lod_cache_insert(struct lod_cache *cache, const void *key, size_t key_size, uint64_t generation, void *value);
/* Empties the cache. */
void lod_cache_clear(struct lod_cache *cache);
/* Empties the cache when what is inside belongs to an older generation. */
void lod_cache_trim(struct lod_cache *cache, uint64_t generation);
void *lod_cache_value(const struct lod_cache_entry *entry);
void lod_cache_release(struct lod_cache *cache, struct lod_cache_entry *entry);

struct lod_cache_counts {
  uint64_t hits, misses, entries;
};
struct lod_cache_counts lod_cache_counts(struct lod_cache *cache);

#endif
