/* Small parts go when a level is coarse (Turk 1992, 8: nothing need be left of an ear that is less than a pixel): pieces of the surface
 * that hang together and are smaller than a share of the level's spacing. On request: the error counts what is missing. */
#include <math.h>

#include "core/base/sets.h"
#include "core/retile/internal.h"

static void drop_face(struct tiling *t, uint32_t f) {
  for (uint32_t v = t->flat_head[f]; v != LOD_NONE; v = t->flat_next[v])
    t->flat[v].face = LOD_NONE;
  t->flat_head[f] = LOD_NONE;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t v = t->faces[f][k];
    t->dead[v] = true;
    t->flat[v].face = LOD_NONE;
  }
  t->faces[f][0] = LOD_NONE;
}

enum lod_status prune_pieces(struct tiling *t, double size, struct lod_arena *arena) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *parent = scratch == NULL ? NULL : lod_sets_create(scratch, t->vertex_count), largest = LOD_NONE;
  struct lod_bounds *bounds = scratch == NULL ? NULL : LOD_NEW(scratch, t->vertex_count, struct lod_bounds);
  if (parent == NULL || bounds == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t v = 0; v < t->vertex_count; v++)
    bounds[v] = (struct lod_bounds){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  for (uint32_t f = 0; f < t->face_count; f++)
    for (uint32_t k = 0; k < 3 && t->faces[f][0] != LOD_NONE; k++) {
      lod_sets_join(parent, t->faces[f][k], t->faces[f][(k + 1) % 3]);
      lod_sets_join(parent, t->faces[f][k], t->copies[t->faces[f][k]]);
    }
  for (uint32_t f = 0; f < t->face_count; f++)
    for (uint32_t k = 0; k < 3 && t->faces[f][0] != LOD_NONE; k++) {
      struct lod_vec3 p = t->positions[t->faces[f][k]];
      struct lod_bounds *b = &bounds[lod_sets_find(parent, t->faces[f][k])];
      const double q[3] = {p.x, p.y, p.z};
      for (int i = 0; i < 3; i++) {
        b->min[i] = fmin(b->min[i], q[i]);
        b->max[i] = fmax(b->max[i], q[i]);
      }
    }
  double extent = 0;
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (parent[v] == v && bounds[v].max[0] >= bounds[v].min[0] && lod_bounds_diagonal(&bounds[v]) > extent) {
      extent = lod_bounds_diagonal(&bounds[v]);
      largest = v;
    }
  for (uint32_t f = 0; f < t->face_count; f++) { /* the largest stays, however small */
    uint32_t root = t->faces[f][0] == LOD_NONE ? largest : lod_sets_find(parent, t->faces[f][0]);
    if (root != largest && lod_bounds_diagonal(&bounds[root]) < size)
      drop_face(t, f);
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}
