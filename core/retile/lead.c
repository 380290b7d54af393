/* A level is led by its error: vertices that matter least are taken away, and as many come back where the level misses by most. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

uint32_t lead_count(const struct tiling *tiling) {
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

static enum lod_status take_away(struct tiling *t, uint32_t level, const bool *taken, struct lod_arena *arena) {
  uint32_t left;
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (taken[v])
      t->birth[v] = (uint8_t)(level + 1);
  LOD_TRY(remove_vertices(t, is_taken, level, arena, &left));
  for (uint32_t v = 0; v < t->vertex_count && left != 0; v++)
    if (taken[v] && !t->dead[v])
      t->birth[v] = (uint8_t)level; /* then they stay what they were */
  improve_flips(t, 2);
  return LOD_OK;
}

enum lod_status lead_thin_out(struct tiling *t, uint32_t level, uint32_t most, const bool *kept, struct lod_arena *arena) {
  struct costed *list;
  bool *taken;
  uint32_t count = 0;
  RETILE_TRY_NEW(list, arena, t->vertex_count);
  RETILE_TRY_NEW_ZERO(taken, arena, t->vertex_count);
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (!t->dead[v] && !t->fixed[v] && t->birth[v] <= level && t->copies[v] == v && (kept == NULL || !kept[v]))
      list[count++] = (struct costed){remove_cost(t, v), v};
  qsort(list, count, sizeof *list, compare_costs);
  for (uint32_t i = 0, done = 0; i < count && done < most; i++)
    if (may_go(t, list[i].v, taken)) {
      taken[list[i].v] = true;
      done++;
    }
  return take_away(t, level, taken, arena);
}

static bool anything_lies_on(const struct tiling *t, uint32_t f, const bool *allowed) {
  for (uint32_t v = t->flat_head[f]; v != LOD_NONE; v = t->flat_next[v])
    if (allowed[v])
      return true;
  return false;
}

/* A face that misses and that nothing allowed lies on, so nothing can be put there: one of its corners goes, and what fills the hole is
 * another face. */
static enum lod_status reopen(struct tiling *t, uint32_t level, double error, const bool *allowed, struct lod_arena *arena) {
  bool *taken;
  uint32_t count = 0;
  RETILE_TRY_NEW_ZERO(taken, arena, t->vertex_count);
  for (uint32_t f = 0; f < t->face_count; f++) {
    if (t->faces[f][0] == LOD_NONE || match_known(t, f, error) <= error || anything_lies_on(t, f, allowed))
      continue;
    uint32_t best = LOD_NONE;
    for (int k = 0; k < 3; k++) {
      uint32_t v = t->faces[f][k];
      if (!t->fixed[v] && t->birth[v] <= level && t->copies[v] == v && may_go(t, v, taken) &&
          (best == LOD_NONE || remove_cost(t, v) < remove_cost(t, best)))
        best = v;
    }
    if (best != LOD_NONE) {
      taken[best] = true;
      count++;
    }
  }
  return count == 0 ? LOD_OK : take_away(t, level, taken, arena);
}

struct leader {
  struct tiling *tiling;
  const struct lod_retile_settings *settings;
  struct retile_goal *goal;
  const uint32_t *finer_to; /* NULL: the finest */
  uint32_t level;
  struct lod_arena *arena;
  bool *allowed, *wanted; /* by tiling vertex */
};

static void allow(struct leader *l) {
  const struct tiling *t = l->tiling;
  for (uint32_t v = 0; v < t->vertex_count; v++)
    l->allowed[v] = t->dead[v] && t->copies[v] == v &&
                    (l->finer_to == NULL ? v < t->sheet->vertex_count || t->birth[v] > l->level : l->finer_to[v] != LOD_NONE);
}

/* Around faces that miss and stay so: vertices that lie within two rings of them are wanted. */
static enum lod_status want_around(struct leader *l, double error) {
  enum { RINGS = 2 };
  const struct tiling *t = l->tiling;
  bool *near, *next;
  RETILE_TRY_NEW_ZERO(near, l->arena, t->vertex_count);
  RETILE_TRY_NEW_ZERO(next, l->arena, t->vertex_count);
  memset(l->wanted, 0, t->vertex_count * sizeof *l->wanted);
  for (uint32_t f = 0; f < t->face_count; f++)
    for (int k = 0; k < 3 && t->faces[f][0] != LOD_NONE && (double)t->missed[f] > error; k++)
      near[t->faces[f][k]] = true;
  for (int ring = 0; ring < RINGS; ring++, near = next)
    for (uint32_t f = 0; f < t->face_count; f++) {
      const uint32_t *c = t->faces[f];
      if (c[0] == LOD_NONE || !(near[c[0]] || near[c[1]] || near[c[2]]))
        continue;
      for (int k = 0; k < 3 && ring + 1 < RINGS; k++)
        next[c[k]] = true;
      for (uint32_t v = t->flat_head[f]; v != LOD_NONE; v = t->flat_next[v])
        l->wanted[v] = l->allowed[v];
    }
  return LOD_OK;
}

/* Until the error is proven, or nothing more can be done. */
static enum lod_status meet_error(struct leader *l, double *bound) {
  enum { MOST_ROUNDS = 16, SETTLED = 3, REOPENED = 11, STALLED = 6, FEW = 3 };
  static const double kAim = 0.8; /* the measure of match is no proof: aim a little lower */
  struct tiling *t = l->tiling;
  const struct retile_goal *goal = l->goal;
  uint32_t least_bad = UINT32_MAX, stalled = 0;
  for (int round = 0; round < MOST_ROUNDS; round++) {
    uint32_t count = lead_count(t), inserted = 0, bad;
    allow(l);
    if (count < goal->most)
      LOD_TRY(insert_vertices(t, l->allowed, l->level, goal->most - count, (round == 0 ? kAim : 1) * goal->error, INSERT_MISSED, l->arena,
                              &inserted));
    if (count + inserted >= goal->most)
      break; /* and it misses still */
    t->enough = kAim * goal->error;
    improve_flips(t, 3);
    if (l->finer_to == NULL && round < SETTLED)
      settle_vertices(t, l->level, 3, kAim * goal->error);
    LOD_TRY(prove_level(t, goal->error, l->settings->threads, l->arena, l->wanted, &bad));
    if (bad == 0) {
      *bound = goal->error;
      break;
    }
    stalled = 10 * (uint64_t)bad > 9 * (uint64_t)least_bad ? stalled + 1 : 0;
    least_bad = bad < least_bad ? bad : least_bad;
    if (stalled == STALLED)
      break;
    allow(l);
    if (stalled > 1)
      LOD_TRY(want_around(l, goal->error));
    else if (round < REOPENED)
      LOD_TRY(reopen(t, l->level, goal->error, l->allowed, l->arena));
    allow(l);
    for (uint32_t v = 0; v < t->vertex_count; v++)
      l->wanted[v] = l->wanted[v] && l->allowed[v];
    count = lead_count(t);
    uint32_t most = goal->most - count;
    if (stalled > 1)
      most = most < FEW + bad ? most : FEW + bad;
    if (round > 0 && count < goal->most)
      LOD_TRY(insert_vertices(t, l->wanted, l->level, most, 0, INSERT_ALL, l->arena, &inserted));
  }
  return LOD_OK;
}

static enum lod_status lead(struct leader *l, double *bound) {
  static const double kTolerated = 0.7; /* share of the worst error below which shape comes first */
  static const double kFewFaces = 0.01; /* for so many vertices can be added without harm to shape */
  static const double kNoError = 1e-7;  /* share of the extent: the level is the source already */
  struct tiling *t = l->tiling;
  struct retile_goal *goal = l->goal;
  double worst = match_worst(t);
  uint32_t inserted, count = lead_count(t);
  uint32_t most = worst > kNoError * sqrt(t->sheet->area) ? (uint32_t)lrint(l->settings->lead * goal->vertices) : 0;
  if (l->finer_to == NULL)
    settle_vertices(t, l->level, l->settings->settle / 2, fmax(kTolerated * worst, 0.8 * goal->error));
  if (count + most > goal->vertices)
    LOD_TRY(lead_thin_out(t, l->level, count + most - goal->vertices, NULL, l->arena));
  allow(l);
  count = lead_count(t);
  if (count < goal->vertices)
    LOD_TRY(insert_vertices(t, l->allowed, l->level, goal->vertices - count, 0, INSERT_FILL, l->arena, &inserted));
  t->enough = kTolerated * match_worst(t);
  improve_flips(t, 3);
  if (l->finer_to == NULL)
    settle_vertices(t, l->level, l->settings->settle - l->settings->settle / 2, t->enough);
  if (goal->error > 0)
    LOD_TRY(match_typical(t, kFewFaces, 0.4 * goal->error, l->arena, &goal->typical));
  return goal->error > 0 && !goal->pilot ? meet_error(l, bound) : LOD_OK;
}

enum lod_status lead_level(struct tiling *tiling, const struct lod_retile_settings *settings, uint32_t level, const uint32_t *finer_to,
                           struct retile_goal *goal, struct lod_arena *arena, double *bound) {
  struct leader l = {tiling, settings, goal, finer_to, level, lod_arena_create_child(arena), NULL, NULL};
  l.allowed = l.arena == NULL ? NULL : LOD_NEW(l.arena, tiling->vertex_count, bool);
  l.wanted = l.arena == NULL ? NULL : LOD_NEW(l.arena, tiling->vertex_count, bool);
  *bound = INFINITY;
  enum lod_status status = l.allowed == NULL || l.wanted == NULL ? LOD_MEMORY : lead(&l, bound);
  tiling->enough = INFINITY;
  lod_arena_destroy(l.arena);
  return status;
}
