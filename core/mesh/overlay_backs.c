/* Walls with two sides: triangles with the same three corners that look either way. The second takes no part while paths are traced; it has
 * the map of the first, mirrored. */
#include <stdlib.h>
#include <string.h>

#include "core/mesh/overlay_private.h"

struct triple {
  uint32_t v[3]; /* ascending */
  uint32_t triangle;
  bool odd; /* an odd permutation of the triangle's corners */
};

static int compare_triples(const void *left, const void *right) {
  const struct triple *a = left, *b = right;
  for (int k = 0; k < 3; k++)
    if (a->v[k] != b->v[k])
      return a->v[k] < b->v[k] ? -1 : 1;
  return a->triangle < b->triangle ? -1 : a->triangle > b->triangle;
}

static struct triple triple_of(const struct lod_mesh *mesh, uint32_t t) {
  struct triple x = {.triangle = t};
  memcpy(x.v, mesh->triangles[t], sizeof x.v);
  for (int k = 0; k < 3; k++) { /* sorts three */
    int i = k == 1 ? 1 : 0;
    if (x.v[i] > x.v[i + 1]) {
      uint32_t v = x.v[i];
      x.v[i] = x.v[i + 1];
      x.v[i + 1] = v;
      x.odd = !x.odd;
    }
  }
  return x;
}

enum lod_status overlay_find_backs(const struct lod_mesh *mesh, struct lod_arena *arena, uint32_t **front, uint32_t *count) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct triple *list = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, struct triple);
  *front = list == NULL ? NULL : LOD_NEW(arena, mesh->triangle_count, uint32_t);
  *count = 0;
  for (uint32_t t = 0; *front != NULL && t < mesh->triangle_count; t++) {
    list[t] = triple_of(mesh, t);
    (*front)[t] = LOD_NONE;
  }
  if (*front != NULL)
    qsort(list, mesh->triangle_count, sizeof *list, compare_triples);
  for (uint32_t i = 0, end; *front != NULL && i < mesh->triangle_count; i = end) {
    for (end = i + 1; end < mesh->triangle_count && memcmp(list[i].v, list[end].v, sizeof list[i].v) == 0; end++)
      if (list[end].odd != list[i].odd && end == i + 1 && overlay_takes_part(mesh, list[i].triangle)) {
        (*front)[list[end].triangle] = list[i].triangle;
        ++*count;
      }
  }
  lod_arena_destroy(scratch);
  return *front == NULL ? LOD_MEMORY : LOD_OK;
}

enum lod_status overlay_hide_backs(const struct lod_mesh *mesh, const uint32_t *front, struct lod_arena *arena, struct lod_mesh *shown) {
  *shown = *mesh;
  OVERLAY_TRY_NEW(shown->triangles, arena, mesh->triangle_count);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      shown->triangles[t][k] = mesh->triangles[t][front[t] == LOD_NONE ? k : 0];
  return LOD_OK;
}

/* back[t]: the triangle that hides behind t, or LOD_NONE. */
static enum lod_status invert(const uint32_t *front, uint32_t count, struct lod_arena *arena, uint32_t **back) {
  OVERLAY_TRY_NEW(*back, arena, count);
  memset(*back, 0xff, count * sizeof **back);
  for (uint32_t t = 0; t < count; t++)
    if (front[t] != LOD_NONE)
      (*back)[front[t]] = t;
  return LOD_OK;
}

/* A coarse back is mapped as its front is, when every finer triangle on that has a back too. */
static void judge_backs(const struct overlay_work *w, struct lod_overlay *o, const uint32_t *back, const uint32_t *fine_back) {
  for (uint32_t t = 0; t < w->coarse->triangle_count; t++)
    if (back[t] != LOD_NONE)
      o->states[back[t]] = o->states[t];
  for (uint32_t i = 0; i < o->triangle_count; i++)
    if (o->coarse_faces[i] != LOD_NONE && back[o->coarse_faces[i]] != LOD_NONE && fine_back[o->fine_faces[i]] == LOD_NONE)
      o->states[back[o->coarse_faces[i]]] = LOD_OVERLAY_TORN;
}

enum lod_status overlay_mirror_backs(struct overlay_work *w, const uint32_t *front, const uint32_t *fine_front, struct lod_arena *results,
                                     struct lod_overlay *o) {
  uint32_t *back, *fine_back, mirrored = 0, faces = w->coarse->triangle_count, *begin;
  LOD_TRY(invert(front, faces, w->arena, &back));
  LOD_TRY(invert(fine_front, w->fine->triangle_count, w->arena, &fine_back));
  judge_backs(w, o, back, fine_back);
  for (uint32_t i = 0; i < o->triangle_count; i++)
    mirrored += fine_back[o->fine_faces[i]] != LOD_NONE;
  const struct lod_overlay from = *o;
  size_t count = (size_t)from.triangle_count + mirrored;
  if (count >= LOD_NONE / 3)
    return LOD_LIMIT;
  OVERLAY_TRY_NEW(o->triangles, results, count);
  OVERLAY_TRY_NEW(o->coarse_faces, results, count);
  OVERLAY_TRY_NEW(o->fine_faces, results, count);
  OVERLAY_TRY_ZERO(begin, w->arena, (size_t)faces + 2);
  for (int pass = 0; pass < 2; pass++) { /* counts, then places, by coarse triangle, stably */
    for (uint32_t i = 0; i < from.triangle_count; i++)
      for (int side = 0; side < (fine_back[from.fine_faces[i]] == LOD_NONE ? 1 : 2); side++) {
        uint32_t coarse = from.coarse_faces[i];
        if (side == 1 && coarse != LOD_NONE)
          coarse = back[coarse] == LOD_NONE || o->states[back[coarse]] == LOD_OVERLAY_TORN ? LOD_NONE : back[coarse];
        uint32_t slot = coarse == LOD_NONE ? faces : coarse;
        if (pass == 0) {
          begin[slot + 1]++;
          continue;
        }
        uint32_t to = begin[slot]++;
        for (int k = 0; k < 3; k++)
          o->triangles[to][k] = from.triangles[i][side == 0 || k == 0 ? k : 3 - k];
        o->coarse_faces[to] = coarse;
        o->fine_faces[to] = side == 0 ? from.fine_faces[i] : fine_back[from.fine_faces[i]];
      }
    for (uint32_t f = 0; f <= faces && pass == 0; f++)
      begin[f + 1] += begin[f];
  }
  o->triangle_count = (uint32_t)count;
  return LOD_OK;
}
