/* A hash table from text to pointers. Keys are not owned: they live in the values. Not locked. */
#ifndef LOD_SERVER_STORE_TABLE_H
#define LOD_SERVER_STORE_TABLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct lod_table {
  struct lod_table_slot *slots;
  size_t capacity, count;
};

/* All zero is an empty table. Frees the slots, not the values. */
void lod_table_finish(struct lod_table *table);

/* Makes room so that the next insert cannot fail. False when memory is out. */
bool lod_table_reserve(struct lod_table *table);
/* key must not be there yet, must outlive its place in the table, and room must have been reserved. */
void lod_table_insert(struct lod_table *table, const char *key, void *value);
/* NULL when there is none. */
void *lod_table_find(const struct lod_table *table, const char *key);
/* Takes the key out and returns its value; NULL when there is none. */
void *lod_table_remove(struct lod_table *table, const char *key);
/* Walks in no order: start with *position = 0; NULL at the end. The table must not change meanwhile. */
void *lod_table_next(const struct lod_table *table, size_t *position);

#endif
