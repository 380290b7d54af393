/* A chained hash table whose entries are also a list in order of use. */
#include "server/http/cache.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

struct lod_cache_entry {
  struct lod_cache_entry *next_in_bucket;
  struct lod_cache_entry *newer, *older;
  uint64_t hash;
  uint32_t holders; /* callers, plus one while it is in the table */
  void *value;
  size_t key_size;
  unsigned char key[];
};

struct lod_cache {
  pthread_mutex_t lock;
  void (*finish)(void *);
  size_t capacity, bucket_count; /* bucket_count: a power of two */
  uint64_t seed, generation, hits, misses, entries;
  struct lod_cache_entry *newest, *oldest;
  struct lod_cache_entry **buckets;
};

struct lod_cache *lod_cache_create(size_t capacity, void (*finish)(void *value)) {
  struct lod_cache *cache = calloc(1, sizeof *cache);
  if (!cache)
    return NULL;
  cache->capacity = capacity ? capacity : 1;
  for (cache->bucket_count = 16; cache->bucket_count < capacity; cache->bucket_count *= 2)
    ;
  cache->buckets = calloc(cache->bucket_count, sizeof *cache->buckets);
  if (!cache->buckets) {
    free(cache);
    return NULL;
  }
  cache->finish = finish;
  if (getrandom(&cache->seed, sizeof cache->seed, GRND_NONBLOCK) != sizeof cache->seed)
    cache->seed ^= (uintptr_t)cache;
  cache->seed |= UINT64_C(1) << 63;
  pthread_mutex_init(&cache->lock, NULL);
  return cache;
}

/* Eight bytes at a time, multiplied and folded. Part of the keys are targets that strangers choose: the seed keeps them from choosing
 * collisions. */
static uint64_t hash_key(const struct lod_cache *cache, const unsigned char *key, size_t size) {
  uint64_t hash = cache->seed ^ size * UINT64_C(0x9e3779b97f4a7c15);
  while (size) {
    uint64_t word = 0;
    size_t part = size < sizeof word ? size : sizeof word;
    memcpy(&word, key, part);
    unsigned __int128 product = (unsigned __int128)(hash ^ word) * (cache->seed | 1);
    hash = (uint64_t)product ^ (uint64_t)(product >> 64) ^ UINT64_C(0x9e3779b97f4a7c15);
    key += part;
    size -= part;
  }
  return hash ^ hash >> 32;
}

static void unlink_use(struct lod_cache *cache, struct lod_cache_entry *entry) {
  *(entry->newer ? &entry->newer->older : &cache->newest) = entry->older;
  *(entry->older ? &entry->older->newer : &cache->oldest) = entry->newer;
  entry->newer = entry->older = NULL;
}

static void link_newest(struct lod_cache *cache, struct lod_cache_entry *entry) {
  entry->older = cache->newest;
  entry->newer = NULL;
  *(cache->newest ? &cache->newest->newer : &cache->oldest) = entry;
  cache->newest = entry;
}

/* Lock held. Returns the entry when this was the last holder: the caller finishes it outside the lock. */
static struct lod_cache_entry *drop(struct lod_cache_entry *entry) {
  return --entry->holders == 0 ? entry : NULL;
}

static void finish_entries(struct lod_cache *cache, struct lod_cache_entry *list) {
  while (list) {
    struct lod_cache_entry *next = list->next_in_bucket;
    cache->finish(list->value);
    free(list);
    list = next;
  }
}

/* Lock held. Takes an entry out of the table; puts it on *dead when nobody holds it. */
static void evict(struct lod_cache *cache, struct lod_cache_entry *entry, struct lod_cache_entry **dead) {
  struct lod_cache_entry **link = &cache->buckets[entry->hash & (cache->bucket_count - 1)];
  while (*link != entry)
    link = &(*link)->next_in_bucket;
  *link = entry->next_in_bucket;
  entry->next_in_bucket = NULL;
  unlink_use(cache, entry);
  cache->entries--;
  if (drop(entry)) {
    entry->next_in_bucket = *dead;
    *dead = entry;
  }
}

/* Lock held. */
static void follow_generation(struct lod_cache *cache, uint64_t generation, struct lod_cache_entry **dead) {
  if (generation <= cache->generation)
    return;
  while (cache->oldest)
    evict(cache, cache->oldest, dead);
  cache->generation = generation;
}

static struct lod_cache_entry *look_up(struct lod_cache *cache, uint64_t hash, const void *key, size_t key_size) {
  struct lod_cache_entry *entry = cache->buckets[hash & (cache->bucket_count - 1)];
  while (entry && (entry->hash != hash || entry->key_size != key_size || memcmp(entry->key, key, key_size) != 0))
    entry = entry->next_in_bucket;
  if (entry) {
    entry->holders++;
    if (entry != cache->newest) {
      unlink_use(cache, entry);
      link_newest(cache, entry);
    }
  }
  return entry;
}

struct lod_cache_entry *lod_cache_find(struct lod_cache *cache, const void *key, size_t key_size, uint64_t generation) {
  uint64_t hash = hash_key(cache, key, key_size);
  struct lod_cache_entry *dead = NULL;
  pthread_mutex_lock(&cache->lock);
  follow_generation(cache, generation, &dead);
  struct lod_cache_entry *entry = look_up(cache, hash, key, key_size);
  *(entry ? &cache->hits : &cache->misses) += 1;
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
  return entry;
}

struct lod_cache_entry *lod_cache_insert(struct lod_cache *cache, const void *key, size_t key_size, uint64_t generation, void *value) {
  struct lod_cache_entry *entry = malloc(sizeof *entry + key_size), *dead = NULL;
  if (!entry) {
    cache->finish(value);
    return NULL;
  }
  *entry = (struct lod_cache_entry){.hash = hash_key(cache, key, key_size), .value = value, .key_size = key_size};
  memcpy(entry->key, key, key_size);
  pthread_mutex_lock(&cache->lock);
  follow_generation(cache, generation, &dead);
  bool late = generation < cache->generation; /* what it belongs to was replaced while it was made */
  struct lod_cache_entry *held = late ? NULL : look_up(cache, entry->hash, key, key_size);
  if (late) {
    entry->holders = 1;
    held = entry;
  } else if (held) {
    entry->next_in_bucket = dead;
    dead = entry;
  } else {
    struct lod_cache_entry **bucket = &cache->buckets[entry->hash & (cache->bucket_count - 1)];
    entry->holders = 2;
    entry->next_in_bucket = *bucket;
    *bucket = entry;
    link_newest(cache, entry);
    cache->entries++;
    while (cache->entries > cache->capacity)
      evict(cache, cache->oldest, &dead);
    held = entry;
  }
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
  return held;
}

void lod_cache_trim(struct lod_cache *cache, uint64_t generation) {
  struct lod_cache_entry *dead = NULL;
  pthread_mutex_lock(&cache->lock);
  follow_generation(cache, generation, &dead);
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
}

void lod_cache_clear(struct lod_cache *cache) {
  struct lod_cache_entry *dead = NULL;
  pthread_mutex_lock(&cache->lock);
  while (cache->oldest)
    evict(cache, cache->oldest, &dead);
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
}

void *lod_cache_value(const struct lod_cache_entry *entry) {
  return entry->value;
}

void lod_cache_release(struct lod_cache *cache, struct lod_cache_entry *entry) {
  pthread_mutex_lock(&cache->lock);
  struct lod_cache_entry *dead = drop(entry);
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
}

void lod_cache_destroy(struct lod_cache *cache) {
  if (!cache)
    return;
  struct lod_cache_entry *dead = NULL;
  pthread_mutex_lock(&cache->lock);
  while (cache->oldest)
    evict(cache, cache->oldest, &dead);
  pthread_mutex_unlock(&cache->lock);
  finish_entries(cache, dead);
  pthread_mutex_destroy(&cache->lock);
  free(cache->buckets);
  free(cache);
}

struct lod_cache_counts lod_cache_counts(struct lod_cache *cache) {
  pthread_mutex_lock(&cache->lock);
  struct lod_cache_counts counts = {cache->hits, cache->misses, cache->entries};
  pthread_mutex_unlock(&cache->lock);
  return counts;
}
