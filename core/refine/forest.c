/* The forest: faces, edges and middles made when they are first needed, and the cut through it that is drawn.
 *
 * Children of face (v0, v1, v2) with middles m0 = v0 v1, m1 = v1 v2, m2 = v2 v0: (v0, m0, m2), (m0, v1, m1), (m2, m1, v2), (m1, m2, m0).
 * Inner edge i cuts corner i off: m_i to m_(i+2); child i lies left of it, the middle child right. Halves of an edge run its way. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/refine/internal.h"

struct lod_refine_settings lod_refine_defaults(void) {
  return (struct lod_refine_settings){.crease_degrees = 180, .corner_degrees = 180, .sharp_borders = true};
}

/* At a line of the cache: nodes of 32 bytes lie in one. */
static void *alloc_lines(struct lod_arena *arena, size_t count, size_t size) {
  enum { LINE = 64 };
  char *block = count > SIZE_MAX / 2 / size ? NULL : lod_arena_alloc(arena, count * size + LINE, 1);
  return block == NULL ? NULL : block + (LINE - (uintptr_t)block % LINE) % LINE;
}

bool refine_room(struct lod_refiner *r, void **array, uint32_t *room, uint32_t count, uint32_t more, size_t size) {
  if (more <= *room - count)
    return true;
  uint64_t wanted = (uint64_t)*room + *room / 2 + 256;
  if (wanted < (uint64_t)count + more)
    wanted = (uint64_t)count + more;
  void *grown = wanted < UINT32_MAX / 2 ? alloc_lines(r->nodes, (size_t)wanted, size) : NULL;
  if (grown == NULL) {
    r->failed = true;
    return false;
  }
  if (count != 0)
    memcpy(grown, *array, count * size);
  *array = grown;
  *room = (uint32_t)wanted;
  return true;
}

/* Two arrays of one length each. */
static bool room_vertices(struct lod_refiner *r, uint32_t more) {
  uint32_t shown = r->vertex_room;
  return !r->failed && refine_room(r, (void **)&r->shown, &shown, r->vertex_count, more, sizeof *r->shown) &&
         refine_room(r, (void **)&r->vertices, &r->vertex_room, r->vertex_count, more, sizeof *r->vertices);
}
static bool room_edges(struct lod_refiner *r, uint32_t more) {
  uint32_t siblings = r->edge_room;
  return !r->failed && refine_room(r, (void **)&r->siblings, &siblings, r->edge_count, more, sizeof *r->siblings) &&
         refine_room(r, (void **)&r->edges, &r->edge_room, r->edge_count, more, sizeof *r->edges);
}
static bool room_faces(struct lod_refiner *r, uint32_t more) {
  uint32_t lineages = r->face_room;
  return !r->failed && refine_room(r, (void **)&r->lineages, &lineages, r->face_count, more, sizeof *r->lineages) &&
         refine_room(r, (void **)&r->faces, &r->face_room, r->face_count, more, sizeof *r->faces);
}
static void make_shown(struct lod_refiner *r, uint32_t v) {
  r->shown[v] = (struct shown){.limit = {NAN}, .normal = {NAN}};
}

bool refine_rooms(struct lod_refiner *r, uint32_t more) {
  uint32_t vertices = r->vertex_count + more / 2, edges = r->edge_count + 3 * (more / 2), faces = r->face_count + more;
  r->vertices = alloc_lines(r->nodes, vertices, sizeof *r->vertices);
  r->shown = alloc_lines(r->nodes, vertices, sizeof *r->shown);
  r->edges = alloc_lines(r->nodes, edges, sizeof *r->edges);
  r->siblings = alloc_lines(r->nodes, edges, sizeof *r->siblings);
  r->faces = alloc_lines(r->nodes, faces, sizeof *r->faces);
  r->lineages = alloc_lines(r->nodes, faces, sizeof *r->lineages);
  r->laters = alloc_lines(r->nodes, r->later_count + (size_t)1, sizeof *r->laters);
  r->vertex_room = vertices;
  r->edge_room = edges;
  r->face_room = faces;
  r->later_room = r->later_count + 1;
  r->journal = NULL;
  r->journal_count = r->journal_room = 0;
  return r->vertices != NULL && r->shown != NULL && r->edges != NULL && r->siblings != NULL && r->faces != NULL && r->lineages != NULL &&
         r->laters != NULL;
}

/* ---- growing ---- */

static void make_edge(struct lod_refiner *r, uint32_t e, uint32_t a, uint32_t b, uint8_t level) {
  r->edges[e] =
      (struct edge){.v = {a, b}, .f = {LOD_NONE, LOD_NONE}, .middle = LOD_NONE, .child = LOD_NONE, .up = LOD_NONE, .level = level};
  r->siblings[e] = e;
}

static bool uses_smooth_mask(const struct lod_refiner *r, const struct edge *e) {
  if (!e->sharp)
    return true;
  /* A dart's own end; both ends of it need not be base vertices. */
  for (int k = 0; k < 2; k++) {
    const struct vertex *v = &r->vertices[e->v[k]];
    if (v->level == 0 && r->base.dart[v->origin])
      return true;
  }
  return false;
}

/* Halves of `e` around a middle that is there. */
static void make_halves(struct lod_refiner *r, uint32_t e, uint32_t middle) {
  uint32_t child = r->edge_count;
  r->edge_count += 2;
  struct edge *edge = &r->edges[e];
  edge->middle = middle;
  edge->child = child;
  make_edge(r, child, edge->v[0], middle, edge->level + 1);
  make_edge(r, child + 1, middle, edge->v[1], edge->level + 1);
  for (uint32_t k = 0; k < 2; k++) {
    struct edge *half = &r->edges[child + k];
    half->up = e;
    half->sharp = edge->sharp;
    half->smooth_mask = uses_smooth_mask(r, half);
  }
}

/* Siblings run between the same two vertices, either way: their halves pair by the end they have in common. */
static void link_halves(struct lod_refiner *r, uint32_t first) {
  for (uint32_t end = 0; end < 2; end++) {
    uint32_t v = r->edges[first].v[end], last = r->edges[first].child + end, head = last;
    for (uint32_t s = r->siblings[first]; s != first; s = r->siblings[s]) {
      uint32_t half = r->edges[s].child + (r->edges[s].v[0] == v ? 0 : 1);
      r->siblings[last] = half;
      r->edges[last].ringed = true;
      last = half;
    }
    r->siblings[last] = head;
    r->edges[last].ringed = true;
  }
}

bool refine_split_edge(struct lod_refiner *r, uint32_t e) {
  if (r->edges[e].child != LOD_NONE)
    return true;
  uint32_t ring = 1;
  for (uint32_t s = refine_sibling(r, e); s != e; s = refine_sibling(r, s))
    ring++;
  if (!room_vertices(r, 1) || !room_edges(r, 2 * ring))
    return false;
  uint32_t middle = r->vertex_count++;
  const struct edge *edge = &r->edges[e];
  make_shown(r, middle);
  r->vertices[middle] = (struct vertex){.origin = e,
                                        .later = LOD_NONE,
                                        .level = edge->level + 1,
                                        .rule = edge->sharp ? REFINE_CREASE : REFINE_SMOOTH,
                                        .masked = edge->smooth_mask};
  make_halves(r, e, middle);
  for (uint32_t s = refine_sibling(r, e); s != e; s = refine_sibling(r, s))
    make_halves(r, s, middle);
  if (ring > 1)
    link_halves(r, e);
  return true;
}

static void make_face(struct lod_refiner *r, uint32_t f, const uint32_t v[3], const uint32_t e[3], uint32_t up, uint32_t which) {
  uint8_t level = r->faces[up].level;
  const struct lineage *line = &r->lineages[up];
  r->faces[f] = (struct face){.v = {v[0], v[1], v[2]}, .e = {e[0], e[1], e[2]}, .child = LOD_NONE, .level = level + 1};
  r->lineages[f] = (struct lineage){up, line->base, line->path | which << 2 * level};
  for (int i = 0; i < 3; i++) {
    struct edge *edge = &r->edges[e[i]];
    edge->f[edge->v[0] == v[i] ? 0 : 1] = f;
  }
}

bool refine_make_children(struct lod_refiner *r, uint32_t f) {
  if (r->faces[f].child != LOD_NONE)
    return true;
  for (int i = 0; i < 3; i++)
    if (!refine_split_edge(r, r->faces[f].e[i]))
      return false;
  if (!room_edges(r, 3) || !room_faces(r, 4))
    return false;
  uint32_t inner = r->edge_count, child = r->face_count;
  r->edge_count += 3;
  r->face_count += 4;
  r->faces[f].child = child;
  const struct face parent = r->faces[f];
  uint32_t m[3], near[3], far[3]; /* the half of edge i at v[i], and at v[i + 1] */
  for (int i = 0; i < 3; i++) {
    const struct edge *edge = &r->edges[parent.e[i]];
    bool along = edge->v[0] == parent.v[i];
    m[i] = edge->middle;
    near[i] = edge->child + !along;
    far[i] = edge->child + along;
  }
  for (uint32_t i = 0; i < 3; i++) {
    make_edge(r, inner + i, m[i], m[(i + 2) % 3], parent.level + 1);
    r->edges[inner + i].smooth_mask = true;
  }
  make_face(r, child, (const uint32_t[]){parent.v[0], m[0], m[2]}, (const uint32_t[]){near[0], inner, far[2]}, f, 0);
  make_face(r, child + 1, (const uint32_t[]){m[0], parent.v[1], m[1]}, (const uint32_t[]){far[0], near[1], inner + 1}, f, 1);
  make_face(r, child + 2, (const uint32_t[]){m[2], m[1], parent.v[2]}, (const uint32_t[]){inner + 2, far[1], near[2]}, f, 2);
  make_face(r, child + 3, (const uint32_t[]){m[1], m[2], m[0]}, (const uint32_t[]){inner + 2, inner, inner + 1}, f, 3);
  return true;
}

uint32_t refine_side(struct lod_refiner *r, uint32_t e, int s) {
  if (r->edges[e].f[s] != LOD_NONE || r->edges[e].up == LOD_NONE)
    return r->edges[e].f[s];
  uint32_t up = refine_side(r, r->edges[e].up, s);
  if (up == LOD_NONE || !refine_make_children(r, up))
    return LOD_NONE;
  return r->edges[e].f[s];
}

/* ---- the cut ---- */

/* The leaves beside edge e, of any of its siblings, other than `but`: their middle there comes (on) or goes. Returns how many. */
static uint32_t tell_leaves(struct lod_refiner *r, uint32_t e, uint32_t but, bool on) {
  uint32_t count = 0, s = e;
  do {
    for (int k = 0; k < 2; k++) {
      uint32_t f = r->edges[s].f[k];
      if (f == LOD_NONE || f == but || !r->faces[f].drawn || r->faces[f].split)
        continue;
      uint8_t bit = (uint8_t)(1u << refine_local(&r->faces[f], s));
      r->faces[f].active = on ? r->faces[f].active | bit : r->faces[f].active & (uint8_t)~bit;
      count++;
    }
    s = refine_sibling(r, s);
  } while (s != e);
  return count;
}

static uint32_t active_edges(const struct face *f) {
  return (f->active & 1u) + (f->active >> 1 & 1u) + (f->active >> 2 & 1u);
}

static bool journal(struct lod_refiner *r, uint32_t f) {
  if (!refine_room(r, (void **)&r->journal, &r->journal_room, r->journal_count, 1, sizeof *r->journal))
    return false;
  r->journal[r->journal_count++] = f;
  return true;
}

/* The cut goes through the children of leaf f from now on. */
static void open_face(struct lod_refiner *r, uint32_t f) {
  struct face *face = &r->faces[f];
  r->drawn_triangles += 3 - active_edges(face);
  for (int i = 0; i < 3; i++) {
    uint32_t e = face->e[i];
    if (!(face->active >> i & 1)) {
      r->drawn_triangles += tell_leaves(r, e, f, true);
      r->drawn_vertices++;
    }
    r->edges[e].active++;
  }
  face->split = true;
  for (uint32_t k = 0; k < 4; k++) {
    r->faces[face->child + k].drawn = true;
    r->faces[face->child + k].active = 0; /* whatever is finer than they needs f to be split */
  }
}

static void close_face(struct lod_refiner *r, uint32_t f) {
  struct face *face = &r->faces[f];
  face->split = false;
  face->active = 0;
  for (uint32_t k = 0; k < 4; k++)
    r->faces[face->child + k].drawn = false;
  for (int i = 0; i < 3; i++) {
    uint32_t e = face->e[i];
    r->edges[e].active--;
    if (refine_edge_active(r, e)) {
      face->active |= (uint8_t)(1u << i);
    } else {
      r->drawn_triangles -= tell_leaves(r, e, f, false);
      r->drawn_vertices--;
    }
  }
  r->drawn_triangles -= 3 - active_edges(face);
}

static bool split_face(struct lod_refiner *r, uint32_t f);

/* Every triangle beside the coarser edge `up` is split. */
static bool split_beside(struct lod_refiner *r, uint32_t up, uint32_t but) {
  uint32_t s = up;
  do {
    for (int k = 0; k < 2; k++) {
      uint32_t g = r->edges[s].f[k];
      if (g != LOD_NONE && g != but && !r->faces[g].split && !split_face(r, g))
        return false;
    }
    s = refine_sibling(r, s);
  } while (s != up);
  return true;
}

/* A leaf with three finer neighbours looks as if it were split: it is, so that interest may go on in it. */
static bool settle_beside(struct lod_refiner *r, uint32_t e, uint32_t but) {
  uint32_t s = e;
  do {
    for (int k = 0; k < 2; k++) {
      uint32_t g = r->edges[s].f[k];
      if (g != LOD_NONE && g != but && r->faces[g].drawn && !r->faces[g].split && r->faces[g].active == 7 && !split_face(r, g))
        return false;
    }
    s = refine_sibling(r, s);
  } while (s != e);
  return true;
}

static bool split_face(struct lod_refiner *r, uint32_t f) {
  for (int i = 0; i < 3; i++) {
    uint32_t up = r->edges[r->faces[f].e[i]].up;
    if (up != LOD_NONE && !split_beside(r, up, r->lineages[f].up))
      return false;
  }
  if (r->faces[f].split) /* a neighbour's settling came first */
    return true;
  if (!refine_make_children(r, f) || !journal(r, f))
    return false;
  open_face(r, f);
  for (int i = 0; i < 3; i++)
    if (!settle_beside(r, r->faces[f].e[i], f))
      return false;
  return true;
}

void refine_undo(struct lod_refiner *r) {
  while (r->journal_count > 0)
    close_face(r, r->journal[--r->journal_count]);
}

bool lod_refiner_split(struct lod_refiner *r, uint32_t f) {
  assert(f < r->face_count);
  r->journal_count = 0;
  const struct face *face = &r->faces[f];
  if (r->failed || !face->drawn || face->split || face->level >= LOD_REFINE_MAX_LEVEL)
    return false;
  if (split_face(r, f))
    return true;
  refine_undo(r);
  return false;
}

bool lod_refiner_merge(struct lod_refiner *r, uint32_t f) {
  assert(f < r->face_count);
  const struct face *face = &r->faces[f];
  if (r->failed || !face->drawn || !face->split)
    return false;
  for (uint32_t k = 0; k < 4; k++)
    if (r->faces[face->child + k].split)
      return false;
  for (int i = 0; i < 3; i++)
    for (uint32_t k = 0; k < 2; k++)
      if (refine_edge_active(r, r->edges[face->e[i]].child + k))
        return false;
  close_face(r, f);
  return true;
}

/* Of what is drawn alone: the forest may be much larger. */
static void fold(struct lod_refiner *r, uint32_t f) {
  struct face *face = &r->faces[f];
  if (!face->split)
    return;
  face->split = false;
  face->active = 0;
  for (int i = 0; i < 3; i++)
    r->edges[face->e[i]].active = 0;
  for (uint32_t k = 0; k < 4; k++) {
    fold(r, face->child + k);
    r->faces[face->child + k].drawn = false;
  }
}

void lod_refiner_reset(struct lod_refiner *r) {
  for (uint32_t f = 0; f < r->base_faces; f++) {
    fold(r, f);
    r->faces[f].active = 0;
  }
  r->drawn_triangles = r->base_faces;
  r->drawn_vertices = 0;
  for (uint32_t v = 0; v < r->base.mesh.vertex_count; v++)
    r->drawn_vertices += (r->vertices[v].has & HAS_USER) != 0;
}

/* ---- birth and facts ---- */

static bool plant(struct lod_refiner *r) {
  const struct refine_base *b = &r->base;
  uint32_t v_count = b->mesh.vertex_count, e_count = b->edge_count, t_count = b->mesh.triangle_count;
  r->face_of = LOD_NEW(r->arena, t_count, uint32_t);
  if (r->face_of == NULL || !room_vertices(r, v_count + v_count / 2 + 64) || !room_edges(r, 2 * e_count + 64) ||
      !room_faces(r, 2 * t_count + 64))
    return false;
  for (uint32_t v = 0; v < v_count; v++) {
    make_shown(r, v);
    r->vertices[v] = (struct vertex){
        .p = {b->points[v][0], b->points[v][1], b->points[v][2]}, .origin = v, .later = LOD_NONE, .rule = b->rule[v], .has = HAS_POSITION};
  }
  for (uint32_t e = 0; e < e_count; e++) {
    uint32_t h = b->edge_half[e];
    make_edge(r, e, lod_half_edge_start(&b->mesh, h), lod_half_edge_end(&b->mesh, h), 0);
    r->edges[e].sharp = b->edge_sharp[e];
    r->siblings[e] = b->edge_sibling[e];
    r->edges[e].ringed = b->edge_sibling[e] != e;
  }
  r->vertex_count = v_count;
  r->edge_count = e_count;
  for (uint32_t e = 0; e < e_count; e++)
    r->edges[e].smooth_mask = r->base.adjacency.twin[b->edge_half[e]] != LOD_NONE && uses_smooth_mask(r, &r->edges[e]);
  for (uint32_t t = 0; t < t_count; t++) {
    r->face_of[t] = LOD_NONE;
    if (b->edge_of[3 * t] == LOD_NONE)
      continue;
    uint32_t f = r->face_of[t] = r->face_count++;
    r->faces[f] = (struct face){.child = LOD_NONE, .drawn = true};
    r->lineages[f] = (struct lineage){LOD_NONE, t, 0};
    for (int i = 0; i < 3; i++) {
      uint32_t h = 3 * t + (uint32_t)i, e = b->edge_of[h];
      r->faces[f].v[i] = b->mesh.triangles[t][i];
      r->faces[f].e[i] = e;
      r->edges[e].f[b->edge_half[e] == h ? 0 : 1] = f;
      r->vertices[r->faces[f].v[i]].has |= HAS_USER;
    }
  }
  r->base_faces = r->face_count;
  return true;
}

enum lod_status lod_refiner_create(const struct lod_mesh *base, const struct lod_refine_settings *settings, struct lod_arena *arena,
                                   struct lod_refiner **result, struct lod_problem *problem) {
  *result = NULL;
  struct lod_arena *own = lod_arena_create_child(arena);
  struct lod_refiner *r = own == NULL ? NULL : LOD_NEW_ZERO(own, 1, struct lod_refiner);
  if (r == NULL) {
    lod_arena_destroy(own);
    return lod_fail_memory(problem);
  }
  r->arena = own;
  r->nodes = lod_arena_create_child(own);
  r->settings = settings == NULL ? lod_refine_defaults() : *settings;
  enum lod_status status = r->nodes == NULL ? lod_fail_memory(problem) : refine_base_create(base, &r->settings, own, &r->base, problem);
  if (status == LOD_OK && !plant(r))
    status = lod_fail_memory(problem);
  if (status != LOD_OK) {
    lod_refiner_destroy(r);
    return status;
  }
  lod_refiner_reset(r);
  *result = r;
  return LOD_OK;
}

void lod_refiner_destroy(struct lod_refiner *r) {
  if (r == NULL)
    return;
  lod_arena_destroy(r->nodes);
  lod_arena_destroy(r->arena);
}

size_t lod_refiner_bytes(const struct lod_refiner *r) {
  return lod_arena_bytes(r->arena);
}
uint32_t lod_refiner_triangles(const struct lod_refiner *r) {
  return r->drawn_triangles;
}
uint32_t lod_refiner_vertices(const struct lod_refiner *r) {
  return r->drawn_vertices;
}
bool lod_refiner_failed(const struct lod_refiner *r) {
  return r->failed;
}
uint32_t lod_refiner_base_face(const struct lod_refiner *r, uint32_t triangle) {
  assert(triangle < r->base.mesh.triangle_count);
  return r->face_of[triangle];
}
uint32_t lod_refiner_face_level(const struct lod_refiner *r, uint32_t face) {
  assert(face < r->face_count);
  return r->faces[face].level;
}
uint32_t lod_refiner_face_base(const struct lod_refiner *r, uint32_t face) {
  assert(face < r->face_count);
  return r->lineages[face].base;
}
uint32_t lod_refiner_face_children(const struct lod_refiner *r, uint32_t face) {
  assert(face < r->face_count);
  return r->faces[face].split ? r->faces[face].child : LOD_NONE;
}

/* ---- check ---- */

static bool check_leaf(const struct lod_refiner *r, uint32_t f, uint32_t *triangles) {
  const struct face *face = &r->faces[f];
  uint32_t active = active_edges(face);
  for (int i = 0; i < 3; i++)
    if (refine_edge_active(r, face->e[i]) != (face->active >> i & 1))
      return false;
  for (int i = 0; i < 3; i++) {
    const struct edge *e = &r->edges[face->e[i]];
    if (e->f[e->v[0] == face->v[i] ? 0 : 1] != f)
      return false;
    for (uint32_t k = 0; k < 2 && e->child != LOD_NONE; k++) /* two levels finer */
      if (refine_edge_active(r, e->child + k))
        return false;
  }
  *triangles += 1 + active;
  return true;
}

static bool check_face(const struct lod_refiner *r, uint32_t f, uint32_t *triangles) {
  const struct face *face = &r->faces[f];
  if (!face->drawn)
    return false;
  if (!face->split)
    return check_leaf(r, f, triangles);
  for (int i = 0; i < 3; i++)
    if (r->edges[face->e[i]].active == 0)
      return false;
  for (uint32_t k = 0; k < 4; k++)
    if (!check_face(r, face->child + k, triangles))
      return false;
  return true;
}

bool lod_refiner_check(struct lod_refiner *r) {
  uint32_t triangles = 0, middles = 0, users = 0;
  for (uint32_t f = 0; f < r->base_faces; f++)
    if (!check_face(r, f, &triangles))
      return false;
  for (uint32_t e = 0; e < r->edge_count; e++) {
    uint32_t drawn = 0, s = e;
    for (int k = 0; k < 2; k++)
      drawn += r->edges[e].f[k] != LOD_NONE && r->faces[r->edges[e].f[k]].split;
    if (drawn != r->edges[e].active)
      return false;
    bool first = true; /* the lowest of the ring counts its middle */
    while ((s = refine_sibling(r, s)) != e)
      first &= s > e;
    middles += first && refine_edge_active(r, e);
  }
  for (uint32_t v = 0; v < r->base.mesh.vertex_count; v++)
    users += (r->vertices[v].has & HAS_USER) != 0;
  return triangles == r->drawn_triangles && middles + users == r->drawn_vertices;
}
