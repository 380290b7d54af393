/* The forest in a new order: that of drawing, so that what is used together lies together. */
#include <string.h>

#include "core/refine/internal.h"

struct packing {
  struct lod_refiner *old, *fresh;
  uint32_t *face, *edge, *vertex; /* old number -> new; LOD_NONE: none yet */
};

/* Halves of edge e, of its siblings, and their middle get numbers, once. */
static void place_halves(struct packing *p, uint32_t e) {
  struct lod_refiner *old = p->old, *fresh = p->fresh;
  uint32_t s = e;
  if (old->edges[e].child == LOD_NONE || p->edge[old->edges[e].child] != LOD_NONE)
    return;
  p->vertex[old->edges[e].middle] = fresh->vertex_count++;
  do {
    for (uint32_t k = 0; k < 2; k++)
      p->edge[old->edges[s].child + k] = fresh->edge_count++;
    s = refine_sibling(old, s);
  } while (s != e);
}

static void place_children(struct packing *p, uint32_t f) {
  const struct face *face = &p->old->faces[f];
  if (face->child == LOD_NONE)
    return;
  for (int i = 0; i < 3; i++)
    place_halves(p, face->e[i]);
  const struct face *middle = &p->old->faces[face->child + 3]; /* its edges are the inner ones: 2, 0, 1 */
  uint32_t inner = middle->e[1];
  for (uint32_t i = 0; i < 3; i++)
    p->edge[inner + i] = p->fresh->edge_count++;
  for (uint32_t k = 0; k < 4; k++)
    p->face[face->child + k] = p->fresh->face_count++;
  for (uint32_t k = 0; k < 4; k++)
    place_children(p, face->child + k);
}

static uint32_t of(const uint32_t *numbers, uint32_t old) {
  return old == LOD_NONE ? LOD_NONE : numbers[old];
}

static void move_faces(const struct packing *p) {
  const struct lod_refiner *old = p->old;
  for (uint32_t f = 0; f < old->face_count; f++) {
    struct face *to = &p->fresh->faces[p->face[f]];
    struct lineage *line = &p->fresh->lineages[p->face[f]];
    *to = old->faces[f];
    *line = old->lineages[f];
    for (int i = 0; i < 3; i++) {
      to->v[i] = p->vertex[to->v[i]];
      to->e[i] = p->edge[to->e[i]];
    }
    to->child = of(p->face, to->child);
    line->up = of(p->face, line->up);
  }
}

static void move_edges(const struct packing *p) {
  const struct lod_refiner *old = p->old;
  for (uint32_t e = 0; e < old->edge_count; e++) {
    struct edge *to = &p->fresh->edges[p->edge[e]];
    *to = old->edges[e];
    for (int k = 0; k < 2; k++) {
      to->v[k] = p->vertex[to->v[k]];
      to->f[k] = of(p->face, to->f[k]);
    }
    to->middle = of(p->vertex, to->middle);
    to->child = of(p->edge, to->child);
    to->up = of(p->edge, to->up);
    p->fresh->siblings[p->edge[e]] = p->edge[old->siblings[e]];
  }
}

static void move_vertices(const struct packing *p) {
  const struct lod_refiner *old = p->old;
  for (uint32_t v = 0; v < old->vertex_count; v++) {
    struct vertex *to = &p->fresh->vertices[p->vertex[v]];
    *to = old->vertices[v];
    if (to->level != 0)
      to->origin = p->edge[to->origin];
    p->fresh->shown[p->vertex[v]] = old->shown[v];
    p->fresh->shown[p->vertex[v]].stamp = 0;
  }
}

/* Numbers of the base stay; the rest follows as it is drawn, and what belongs to no face last. */
static void number_all(struct packing *p) {
  struct lod_refiner *old = p->old, *fresh = p->fresh;
  uint32_t vertices = old->base.mesh.vertex_count, edges = old->base.edge_count;
  memset(p->face, 0xff, old->face_count * sizeof *p->face);
  memset(p->edge, 0xff, old->edge_count * sizeof *p->edge);
  memset(p->vertex, 0xff, old->vertex_count * sizeof *p->vertex);
  for (uint32_t f = 0; f < old->base_faces; f++)
    p->face[f] = f;
  for (uint32_t e = 0; e < edges; e++)
    p->edge[e] = e;
  for (uint32_t v = 0; v < vertices; v++)
    p->vertex[v] = v;
  fresh->face_count = old->base_faces;
  fresh->edge_count = edges;
  fresh->vertex_count = vertices;
  for (uint32_t f = 0; f < old->base_faces; f++)
    place_children(p, f);
  for (uint32_t e = 0; e < old->edge_count; e++) /* halves come after what they are halves of */
    place_halves(p, e);
}

enum { WORTH_WHILE = 4096 };

bool lod_refiner_pack(struct lod_refiner *r, double growth) {
  struct lod_refiner fresh = *r;
  struct packing p = {.old = r, .fresh = &fresh};
  if (r->failed || r->face_count - r->packed_faces < WORTH_WHILE || r->face_count - r->packed_faces < growth * r->packed_faces)
    return false;
  fresh.nodes = lod_arena_create_child(r->arena);
  struct lod_arena *scratch = lod_arena_create_child(r->arena);
  bool made = fresh.nodes != NULL && scratch != NULL && refine_rooms(&fresh, r->face_count / 4);
  if (made) {
    p.face = LOD_NEW(scratch, r->face_count, uint32_t);
    p.edge = LOD_NEW(scratch, r->edge_count, uint32_t);
    p.vertex = LOD_NEW(scratch, r->vertex_count, uint32_t);
    made = p.face != NULL && p.edge != NULL && p.vertex != NULL;
  }
  if (made) {
    number_all(&p);
    move_faces(&p);
    move_edges(&p);
    move_vertices(&p);
    if (r->later_count != 0)
      memcpy(fresh.laters, r->laters, r->later_count * sizeof *r->laters);
    fresh.packed_faces = r->face_count;
    struct lod_arena *gone = r->nodes;
    *r = fresh;
    lod_arena_destroy(gone);
  } else {
    lod_arena_destroy(fresh.nodes);
  }
  lod_arena_destroy(scratch);
  return made;
}
