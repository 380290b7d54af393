/* A level is led by its error: vertices that matter least are taken away, and as many come back where the level misses by most. */
#include <math.h>
#include <stdlib.h>

#include "core/retile/internal.h"

static uint32_t count_vertices(const struct tiling *tiling) {
  uint32_t count = 0;
  for (uint32_t v = 0; v < tiling->vertex_count; v++) { /* the lowest copy counts */
    bool lowest = !tiling->dead[v];
    for (uint32_t w = tiling->copies[v]; w != v && lowest; w = tiling->copies[w])
      lowest = w > v;
    count += lowest;
  }
  return count;
}

struct costed {
  double cost;
  uint32_t v;
};

static int compare_costs(const void *a, const void *b) {
  const struct costed *x = a, *y = b;
  if (x->cost != y->cost)
    return x->cost < y->cost ? -1 : 1;
  return x->v < y->v ? -1 : x->v > y->v;
}

/* Is v inside the surface, with no neighbour taken? */
static bool may_go(const struct tiling *t, uint32_t v, const bool *taken) {
  uint32_t begin = t->corner[v], h = begin;
  do {
    uint32_t previous = retile_previous(h);
    if (t->marks[h] != 0 || t->twin[previous] == LOD_NONE || taken[t->faces[h / 3][(h + 1) % 3]])
      return false;
    h = t->twin[previous];
  } while (h != begin);
  return true;
}

static bool is_taken(const struct tiling *tiling, uint32_t v, uint32_t level) {
  return tiling->birth[v] != TILING_OLD && tiling->birth[v] > level;
}

/* Takes about `most` vertices away that stand out least; they belong to the finer level then. */
static enum lod_status thin_out(struct tiling *t, uint32_t level, uint32_t most, struct lod_arena *arena) {
  struct costed *list;
  bool *taken;
  uint32_t count = 0, left;
  RETILE_TRY_NEW(list, arena, t->vertex_count);
  RETILE_TRY_NEW_ZERO(taken, arena, t->vertex_count);
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (!t->dead[v] && !t->fixed[v] && t->birth[v] <= level && t->copies[v] == v)
      list[count++] = (struct costed){remove_cost(t, v), v};
  qsort(list, count, sizeof *list, compare_costs);
  for (uint32_t i = 0, done = 0; i < count && done < most; i++)
    if (may_go(t, list[i].v, taken)) {
      taken[list[i].v] = true;
      t->birth[list[i].v] = (uint8_t)(level + 1);
      done++;
    }
  LOD_TRY(remove_vertices(t, is_taken, level, arena, &left));
  if (left != 0) /* then they stay what they were */
    for (uint32_t v = 0; v < t->vertex_count; v++)
      if (taken[v] && !t->dead[v])
        t->birth[v] = (uint8_t)level;
  improve_flips(t, 2);
  return LOD_OK;
}

enum lod_status lead_level(struct tiling *tiling, const struct lod_retile_settings *settings, uint32_t level, const uint32_t *finer_to,
                           uint32_t wanted, struct lod_arena *arena) {
  static const double kTolerated = 0.7; /* share of the worst error below which shape comes first */
  static const double kNoError = 1e-7;  /* share of the extent: the level is the source already */
  struct lod_arena *scratch = lod_arena_create_child(arena);
  bool *allowed = scratch == NULL ? NULL : LOD_NEW(scratch, tiling->vertex_count, bool);
  enum lod_status status = allowed == NULL ? LOD_MEMORY : LOD_OK;
  double worst = match_worst(tiling);
  uint32_t inserted, count = count_vertices(tiling);
  uint32_t most = worst > kNoError * sqrt(tiling->sheet->area) ? (uint32_t)lrint(settings->lead * wanted) : 0;
  bool finest = finer_to == NULL;
  if (status == LOD_OK && finest)
    settle_vertices(tiling, level, settings->settle / 2, kTolerated * worst);
  if (status == LOD_OK && count + most > wanted)
    status = thin_out(tiling, level, count + most - wanted, scratch);
  for (uint32_t v = 0; status == LOD_OK && v < tiling->vertex_count; v++)
    allowed[v] = tiling->dead[v] && tiling->copies[v] == v &&
                 (finest ? v < tiling->sheet->vertex_count || tiling->birth[v] > level : finer_to[v] != LOD_NONE);
  count = count_vertices(tiling);
  if (status == LOD_OK && count < wanted)
    status = insert_vertices(tiling, allowed, level, wanted - count, 0, true, scratch, &inserted);
  if (status == LOD_OK) {
    tiling->enough = kTolerated * match_worst(tiling);
    improve_flips(tiling, 3);
    if (finest)
      settle_vertices(tiling, level, settings->settle - settings->settle / 2, tiling->enough);
  }
  tiling->enough = INFINITY;
  lod_arena_destroy(scratch);
  return status;
}
