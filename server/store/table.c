#include "server/store/table.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

struct lod_table_slot {
  uint64_t hash;
  const char *key; /* NULL = free */
  void *value;
};

enum { FIRST_CAPACITY = 64 };

/* FNV-1a, folded so that the low bits depend on all others. Keys are model ids and digests; who may write them holds the token. */
static uint64_t hash_key(const char *key) {
  uint64_t hash = 0xcbf29ce484222325u;
  for (; *key != 0; key++)
    hash = (hash ^ (unsigned char)*key) * 0x100000001b3u;
  return hash ^ hash >> 32;
}

void lod_table_finish(struct lod_table *table) {
  free(table->slots);
  *table = (struct lod_table){0};
}

static size_t place(const struct lod_table *table, uint64_t hash, const char *key) {
  size_t mask = table->capacity - 1;
  size_t i = hash & mask;
  while (table->slots[i].key != NULL && (table->slots[i].hash != hash || strcmp(table->slots[i].key, key) != 0))
    i = (i + 1) & mask;
  return i;
}

bool lod_table_reserve(struct lod_table *table) {
  if (table->count + 1 <= table->capacity / 2)
    return true;
  struct lod_table larger = {.capacity = table->capacity == 0 ? FIRST_CAPACITY : table->capacity * 2, .count = table->count};
  larger.slots = calloc(larger.capacity, sizeof *larger.slots);
  if (larger.slots == NULL)
    return false;
  for (size_t i = 0; i < table->capacity; i++) {
    const struct lod_table_slot *slot = &table->slots[i];
    if (slot->key != NULL)
      larger.slots[place(&larger, slot->hash, slot->key)] = *slot;
  }
  free(table->slots);
  *table = larger;
  return true;
}

void lod_table_insert(struct lod_table *table, const char *key, void *value) {
  assert(table->count + 1 <= table->capacity / 2);
  uint64_t hash = hash_key(key);
  struct lod_table_slot *slot = &table->slots[place(table, hash, key)];
  assert(slot->key == NULL);
  *slot = (struct lod_table_slot){hash, key, value};
  table->count++;
}

void *lod_table_find(const struct lod_table *table, const char *key) {
  return table->count == 0 ? NULL : table->slots[place(table, hash_key(key), key)].value;
}

void *lod_table_remove(struct lod_table *table, const char *key) {
  if (table->count == 0)
    return NULL;
  size_t mask = table->capacity - 1;
  size_t hole = place(table, hash_key(key), key);
  if (table->slots[hole].key == NULL)
    return NULL;
  void *value = table->slots[hole].value;
  /* Later slots of the run move back when their home is not between the hole and them, so no tombstone is needed. */
  for (size_t i = (hole + 1) & mask; table->slots[i].key != NULL; i = (i + 1) & mask) {
    size_t home = table->slots[i].hash & mask;
    if (((i - home) & mask) >= ((i - hole) & mask)) {
      table->slots[hole] = table->slots[i];
      hole = i;
    }
  }
  table->slots[hole] = (struct lod_table_slot){0};
  table->count--;
  return value;
}

void *lod_table_next(const struct lod_table *table, size_t *position) {
  while (*position < table->capacity) {
    const struct lod_table_slot *slot = &table->slots[(*position)++];
    if (slot->key != NULL)
      return slot->value;
  }
  return NULL;
}
