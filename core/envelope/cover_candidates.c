/* Candidate triangles and the vertices that they cover (Varshney et al. 1995, section 5). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/envelope/cover_internal.h"

uint32_t cover_around(struct lod_cover *c, uint32_t v, uint32_t reach, uint32_t around[COVER_NEAR]) {
  uint32_t count = 1, begin = 0;
  c->mark++;
  around[0] = v;
  c->vertex_mark[v] = c->mark;
  for (uint32_t step = 0; step < reach; step++) {
    uint32_t end = count;
    for (uint32_t i = begin; i < end; i++) {
      if (i > 0 && c->kind[around[i]] != COVER_INTERIOR)
        continue; /* what lies behind a line is another surface */
      const struct cover_ring *ring = &c->ring[around[i]];
      for (uint32_t j = 0; j < ring->count; j++)
        for (int k = 0; k < 3; k++) {
          uint32_t w = c->face[ring->faces[j]][k];
          if (c->vertex_mark[w] == c->mark || count == COVER_NEAR)
            continue;
          c->vertex_mark[w] = c->mark;
          around[count++] = w;
        }
    }
    begin = end;
  }
  return count;
}

uint32_t cover_count(struct lod_cover *c, const uint32_t v[3]) {
  uint32_t around[COVER_NEAR], count = 0;
  uint32_t n = cover_around(c, v[0], c->settings.reach, around);
  for (uint32_t i = 1; i < n; i++)
    if (around[i] != v[1] && around[i] != v[2] && c->kind[around[i]] == COVER_INTERIOR && cover_covers(c, v, around[i]))
      count++;
  return count;
}

/* Signs of everything around one vertex: left[i][j] has bit k when k lies left of the way from i to j. */
struct table {
  struct lod_cover *cover;
  uint32_t around[COVER_NEAR], count;
  uint64_t removable; /* interior vertices */
  uint64_t left[COVER_NEAR][COVER_NEAR];
};

static void fill_table(struct table *t) {
  t->removable = 0;
  for (uint32_t k = 0; k < t->count; k++)
    if (t->cover->kind[t->around[k]] == COVER_INTERIOR)
      t->removable |= (uint64_t)1 << k;
  uint64_t all = t->count == 64 ? ~(uint64_t)0 : ((uint64_t)1 << t->count) - 1;
  for (uint32_t i = 0; i < t->count; i++)
    for (uint32_t j = i + 1; j < t->count; j++) {
      uint64_t left = 0, ends = (uint64_t)1 << i | (uint64_t)1 << j;
      for (uint32_t k = 0; k < t->count; k++)
        if (k != i && k != j && cover_side(t->cover, t->around[i], t->around[j], t->around[k]) > 0)
          left |= (uint64_t)1 << k;
      t->left[i][j] = left;
      t->left[j][i] = all & ~left & ~ends;
    }
}

/* Whether every covered vertex lies within epsilon of the triangle's plane; *height is that of the farthest. */
static bool low_enough(const struct lod_cover *c, const struct table *t, const uint32_t v[3], uint64_t covered, float *height) {
  struct lod_vec3 a = cover_point(c, v[0]);
  struct lod_vec3 n =
      lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(cover_point(c, v[1]), a), lod_vec3_subtract(cover_point(c, v[2]), a)));
  double most = 0;
  for (; covered != 0; covered &= covered - 1) {
    double h = fabs(lod_vec3_dot(n, lod_vec3_subtract(cover_point(c, t->around[__builtin_ctzll(covered)]), a)));
    if (h > c->epsilon)
      return false;
    most = fmax(most, h);
  }
  *height = (float)most;
  return true;
}

struct list {
  struct lod_arena *arena;
  struct cover_candidate *items;
  size_t count, capacity;
};

static enum lod_status append(struct list *list, const struct cover_candidate *candidate) {
  if (list->count == list->capacity) {
    size_t capacity = list->capacity == 0 ? 4096 : 2 * list->capacity;
    struct cover_candidate *grown = LOD_NEW(list->arena, capacity, struct cover_candidate);
    if (grown == NULL)
      return LOD_MEMORY;
    if (list->count != 0)
      memcpy(grown, list->items, list->count * sizeof *grown);
    list->items = grown;
    list->capacity = capacity;
  }
  list->items[list->count++] = *candidate;
  return LOD_OK;
}

/* Triangles whose lowest vertex is the first of the table. */
static enum lod_status add_triangles(struct lod_cover *c, const struct table *t, struct list *list) {
  for (uint32_t i = 1; i < t->count; i++)
    for (uint32_t j = 1; j < t->count; j++) {
      uint32_t v[3] = {t->around[0], t->around[i], t->around[j]};
      if (i == j || v[1] < v[0] || v[2] < v[0] || !(t->left[0][i] >> j & 1) || (j < i && t->left[0][j] >> i & 1))
        continue;
      uint64_t covered = t->left[0][i] & t->left[i][j] & t->left[j][0];
      if ((covered & t->removable) == 0 || (covered & ~t->removable) != 0)
        continue; /* it must cover some, and none that has to stay */
      struct cover_candidate candidate = {.count = (uint32_t)__builtin_popcountll(covered)};
      memcpy(candidate.v, v, sizeof v);
      if (cover_faces_out(c, v[0], v[1], v[2]) && low_enough(c, t, v, covered, &candidate.height))
        LOD_TRY(append(list, &candidate));
    }
  return LOD_OK;
}

static int compare(const void *x, const void *y) {
  const struct cover_candidate *a = x, *b = y;
  if (a->count != b->count)
    return a->count > b->count ? -1 : 1;
  if (a->height < b->height || a->height > b->height)
    return a->height < b->height ? -1 : 1;
  return memcmp(a->v, b->v, sizeof a->v);
}

enum lod_status cover_candidates(struct lod_cover *c, struct lod_arena *arena, struct cover_candidate **candidates, size_t *count) {
  struct list list = {.arena = arena};
  struct table *table = LOD_NEW(arena, 1, struct table);
  if (table == NULL)
    return LOD_MEMORY;
  table->cover = c;
  for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
    if (!cover_stands(c, v))
      continue;
    table->count = cover_around(c, v, c->settings.reach, table->around);
    fill_table(table);
    LOD_TRY(add_triangles(c, table, &list));
  }
  if (list.count != 0)
    qsort(list.items, list.count, sizeof *list.items, compare);
  *candidates = list.items;
  *count = list.count;
  return LOD_OK;
}
