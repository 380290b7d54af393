/* Disjoint sets of 0 ... count - 1 in one array, by path halving (Tarjan, van Leeuwen. Worst-Case Analysis of Set Union Algorithms. 1984).
 * A set's root is its lowest member, so results do not depend on the order of joins. */
#ifndef LOD_CORE_BASE_SETS_H
#define LOD_CORE_BASE_SETS_H

#include <stdint.h>

#include "core/base/arena.h"

/* Everyone alone. NULL when memory is out. */
static inline uint32_t *lod_sets_create(struct lod_arena *arena, uint32_t count) {
  uint32_t *sets = LOD_NEW(arena, count, uint32_t);
  for (uint32_t i = 0; sets != NULL && i < count; i++)
    sets[i] = i;
  return sets;
}

static inline uint32_t lod_sets_find(uint32_t *sets, uint32_t x) {
  while (sets[x] != x)
    x = sets[x] = sets[sets[x]];
  return x;
}

static inline void lod_sets_join(uint32_t *sets, uint32_t a, uint32_t b) {
  a = lod_sets_find(sets, a);
  b = lod_sets_find(sets, b);
  if (a < b)
    sets[b] = a;
  else
    sets[a] = b;
}

#endif
