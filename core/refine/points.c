/* Positions of a vertex at its levels, its place and normal in the limit: each computed when first asked for, and kept. */
#include <math.h>
#include <string.h>

#include "core/refine/internal.h"

enum { SMALL_RING = 16 };

static uint32_t spoke_count(const struct lod_refiner *r, uint32_t v) {
  const struct vertex *vertex = &r->vertices[v];
  if (vertex->level == 0)
    return r->base.spoke_begin[vertex->origin + 1] - r->base.spoke_begin[vertex->origin];
  return 6; /* those of sharp edges are asked side by side instead */
}

/* The other end of spoke e of v, at level k. */
static uint32_t spoke_end(struct lod_refiner *r, uint32_t e, uint32_t v, uint32_t k) {
  while (r->edges[e].level < k) {
    if (!refine_split_edge(r, e))
      return v;
    e = r->edges[e].child + (r->edges[e].v[0] == v ? 0 : 1);
  }
  return r->edges[e].v[r->edges[e].v[0] == v ? 1 : 0];
}

static struct lod_vec3 vector(const double p[3]) {
  return (struct lod_vec3){p[0], p[1], p[2]};
}

/* The inner edges that cut the two corners off that edge e of face f has: at its start (in f's direction) and at its end. */
static bool inner_edges(struct lod_refiner *r, uint32_t f, uint32_t e, uint32_t *at_start, uint32_t *at_end) {
  if (f == LOD_NONE || !refine_make_children(r, f))
    return false;
  int i = refine_local(&r->faces[f], e);
  /* The middle child's edges are inner 2, 0, 1. */
  const struct face *middle = &r->faces[r->faces[f].child + 3];
  static const int kInner[3] = {1, 2, 0};
  *at_start = middle->e[kInner[i]];
  *at_end = middle->e[kInner[(i + 1) % 3]];
  return true;
}

/* Spokes of a vertex that is not of the base and lies on no sharp edge: counter-clockwise from its edge's second end. */
static bool middle_spokes(struct lod_refiner *r, uint32_t v, uint32_t spokes[6]) {
  uint32_t e = r->vertices[v].origin;
  uint32_t left = refine_side(r, e, 0), right = refine_side(r, e, 1);
  if (!inner_edges(r, left, e, &spokes[2], &spokes[1]) || !inner_edges(r, right, e, &spokes[5], &spokes[4]))
    return false;
  spokes[0] = r->edges[e].child + 1;
  spokes[3] = r->edges[e].child;
  return true;
}

static const uint32_t *spokes_of(struct lod_refiner *r, uint32_t v, uint32_t room[6]) {
  const struct vertex *vertex = &r->vertices[v];
  if (vertex->level == 0)
    return r->base.spokes + r->base.spoke_begin[vertex->origin];
  return middle_spokes(r, v, room) ? room : NULL;
}

/* The two sharp spokes of a crease vertex. */
static void sharp_spokes(struct lod_refiner *r, uint32_t v, uint32_t spokes[2]) {
  const struct vertex *vertex = &r->vertices[v];
  if (vertex->level == 0) {
    memcpy(spokes, r->base.sharp_spokes[vertex->origin], 2 * sizeof *spokes);
  } else {
    spokes[0] = r->edges[vertex->origin].child + 1;
    spokes[1] = r->edges[vertex->origin].child;
  }
}

/* ---- positions ---- */

static struct lod_vec3 birth_position(struct lod_refiner *r, uint32_t v) {
  uint32_t e = r->vertices[v].origin;
  const struct edge edge = r->edges[e];
  struct lod_vec3 a = refine_position(r, edge.v[0], edge.level), b = refine_position(r, edge.v[1], edge.level);
  if (!r->vertices[v].masked)
    return refine_middle_sharp(r->base.grid, a, b);
  struct lod_vec3 across[2] = {{0, 0, 0}, {0, 0, 0}};
  for (int s = 0; s < 2; s++) {
    uint32_t f = refine_side(r, e, s);
    if (f == LOD_NONE)
      continue; /* memory is out */
    across[s] = refine_position(r, r->faces[f].v[(refine_local(&r->faces[f], e) + 2) % 3], edge.level);
  }
  return refine_middle_smooth(r->base.grid, a, b, across[0], across[1]);
}

/* From level k to level k + 1. */
static struct lod_vec3 moved_position(struct lod_refiner *r, uint32_t v, uint32_t k, struct lod_vec3 p) {
  uint32_t room[6];
  if (r->vertices[v].rule == REFINE_CORNER)
    return p;
  if (r->vertices[v].rule == REFINE_CREASE) {
    sharp_spokes(r, v, room);
    struct lod_vec3 a = refine_position(r, spoke_end(r, room[0], v, k), k), b = refine_position(r, spoke_end(r, room[1], v, k), k);
    return refine_move_crease(r->base.grid, p, a, b);
  }
  const uint32_t *spokes = spokes_of(r, v, room);
  uint32_t count = spokes == NULL ? 0 : spoke_count(r, v);
  struct lod_vec3 sum = {0};
  for (uint32_t i = 0; i < count; i++)
    sum = lod_vec3_add(sum, refine_position(r, spoke_end(r, spokes[i], v, k), k));
  return count == 0 ? p : refine_move_smooth(r->base.grid, refine_base_move(&r->base, count), p, sum);
}

static bool keep_later(struct lod_refiner *r, uint32_t v, uint32_t last, struct lod_vec3 p) {
  if (r->failed || !refine_room(r, (void **)&r->laters, &r->later_room, r->later_count, 1, sizeof *r->laters))
    return false;
  uint32_t at = r->later_count++;
  r->laters[at] = (struct later){{p.x, p.y, p.z}, LOD_NONE};
  if (last == LOD_NONE)
    r->vertices[v].later = at;
  else
    r->laters[last].next = at;
  return true;
}

struct lod_vec3 refine_position(struct lod_refiner *r, uint32_t v, uint32_t level) {
  if (r->failed)
    return (struct lod_vec3){0};
  if (!(r->vertices[v].has & HAS_POSITION)) {
    struct lod_vec3 p = birth_position(r, v);
    struct vertex *vertex = &r->vertices[v];
    vertex->p[0] = p.x;
    vertex->p[1] = p.y;
    vertex->p[2] = p.z;
    vertex->has |= HAS_POSITION;
  }
  struct lod_vec3 p = vector(r->vertices[v].p);
  if (r->vertices[v].rule == REFINE_CORNER)
    return p;
  uint32_t last = LOD_NONE;
  for (uint32_t k = r->vertices[v].level; k < level; k++) {
    uint32_t next = last == LOD_NONE ? r->vertices[v].later : r->laters[last].next;
    if (next == LOD_NONE) {
      p = moved_position(r, v, k, p);
      /* What was asked for on the way may have come here for this very level. */
      next = last == LOD_NONE ? r->vertices[v].later : r->laters[last].next;
      if (next == LOD_NONE && !keep_later(r, v, last, p))
        return p;
      next = last == LOD_NONE ? r->vertices[v].later : r->laters[last].next;
    }
    last = next;
    p = vector(r->laters[last].p);
  }
  return p;
}

/* ---- limit ---- */

static uint32_t full_ring(struct lod_refiner *r, uint32_t v, struct lod_vec3 *ring, struct lod_vec3 *sum) {
  uint32_t room[6], k = r->vertices[v].level;
  const uint32_t *spokes = spokes_of(r, v, room);
  uint32_t count = spokes == NULL ? 0 : spoke_count(r, v);
  *sum = (struct lod_vec3){0};
  for (uint32_t i = 0; i < count; i++) {
    struct lod_vec3 q = refine_position(r, spoke_end(r, spokes[i], v, k), k);
    if (ring != NULL)
      ring[i] = q;
    *sum = lod_vec3_add(*sum, q);
  }
  return count;
}

static void set_limit(struct lod_refiner *r, uint32_t v, struct lod_vec3 p) {
  lod_vec3_to_float(p, r->shown[v].limit);
}

/* Both from one ring. */
static void smooth_limit(struct lod_refiner *r, uint32_t v) {
  struct lod_vec3 small[SMALL_RING], sum, normal = {0}, *ring = small;
  struct lod_arena *scratch = NULL;
  uint32_t count = spoke_count(r, v);
  if (count > SMALL_RING) {
    scratch = lod_arena_create_child(r->arena);
    ring = scratch == NULL ? NULL : LOD_NEW(scratch, count, struct lod_vec3);
    if (ring == NULL) {
      lod_arena_destroy(scratch);
      r->failed = true;
      return;
    }
  }
  struct lod_vec3 p = refine_position(r, v, r->vertices[v].level);
  count = full_ring(r, v, ring, &sum);
  if (count >= 3) {
    p = refine_limit_smooth(refine_base_limit(&r->base, count), p, sum);
    normal = refine_ring_normal(ring, count);
  }
  set_limit(r, v, p);
  refine_store_normal(normal, r->shown[v].normal);
  lod_arena_destroy(scratch);
}

const float *refine_limit(struct lod_refiner *r, uint32_t v) {
  static const float kZero[3];
  if (!isnan(r->shown[v].limit[0]))
    return r->shown[v].limit;
  if (r->failed)
    return kZero;
  uint32_t spokes[2], k = r->vertices[v].level;
  if (r->vertices[v].rule == REFINE_SMOOTH) {
    smooth_limit(r, v);
  } else if (r->vertices[v].rule == REFINE_CREASE) {
    struct lod_vec3 p = refine_position(r, v, k);
    sharp_spokes(r, v, spokes);
    struct lod_vec3 a = refine_position(r, spoke_end(r, spokes[0], v, k), k), b = refine_position(r, spoke_end(r, spokes[1], v, k), k);
    set_limit(r, v, refine_limit_crease(p, a, b));
  } else if (k == 0) { /* stays: the base's own float */
    memcpy(r->shown[v].limit, r->base.mesh.positions[r->vertices[v].origin], sizeof r->shown[v].limit);
  }
  return r->failed ? kZero : r->shown[v].limit;
}

/* ---- normals beside sharp edges ---- */

/* Ring of the sector of base vertex v that corner `corner` lies in; false: a closed fan without a sharp edge. */
static uint32_t base_sector(struct lod_refiner *r, uint32_t corner, struct lod_vec3 *ring, uint32_t room, bool *closed) {
  const struct refine_base *b = &r->base;
  const struct lod_adjacency *adjacency = &b->adjacency;
  uint32_t first = corner, count = 0;
  *closed = false;
  while (!b->edge_sharp[b->edge_of[first]]) {
    uint32_t right = lod_corner_right(adjacency, first);
    if (right == LOD_NONE || right == corner) {
      *closed = right == corner;
      break;
    }
    first = right;
  }
  for (uint32_t c = first;;) {
    if (count < room)
      ring[count++] = vector(b->points[lod_half_edge_end(&b->mesh, c)]);
    uint32_t previous = lod_half_edge_previous(c), left = lod_corner_left(adjacency, c);
    if (!*closed && (b->edge_sharp[b->edge_of[previous]] || left == LOD_NONE)) {
      if (count < room)
        ring[count++] = vector(b->points[lod_half_edge_start(&b->mesh, previous)]);
      return count;
    }
    if (left == first || left == LOD_NONE)
      return count;
    c = left;
  }
}

static struct lod_vec3 base_sector_normal(struct lod_refiner *r, uint32_t v, uint32_t triangle) {
  const struct refine_base *b = &r->base;
  uint32_t corner = LOD_NONE;
  for (uint32_t k = 0; k < 3; k++)
    if (b->mesh.triangles[triangle][k] == v)
      corner = 3 * triangle + k;
  uint32_t triangles = b->adjacency.vertex_begin[v + 1] - b->adjacency.vertex_begin[v];
  struct lod_vec3 small[SMALL_RING], *ring = small, normal = {0};
  struct lod_arena *scratch = NULL;
  uint32_t room = SMALL_RING;
  if (triangles + 1 > SMALL_RING) {
    room = triangles + 1;
    scratch = lod_arena_create_child(r->arena);
    ring = scratch == NULL ? NULL : LOD_NEW(scratch, room, struct lod_vec3);
  }
  if (ring != NULL && corner != LOD_NONE) {
    bool closed;
    uint32_t count = base_sector(r, corner, ring, room, &closed);
    struct lod_vec3 p = vector(b->points[v]);
    bool crease = r->vertices[v].rule == REFINE_CREASE && !closed && count >= 2;
    normal = crease ? refine_sector_normal(p, ring, count) : refine_fan_normal(p, ring, count, closed);
  }
  lod_arena_destroy(scratch);
  return normal;
}

/* Which side of base edge `e` (or a sibling, then *e becomes it) triangle t lies on. */
static int base_side(const struct lod_refiner *r, uint32_t *e, uint32_t t) {
  for (uint32_t s = *e;;) {
    for (int k = 0; k < 2; k++)
      if (r->edges[s].f[k] != LOD_NONE && r->lineages[r->edges[s].f[k]].base == t) {
        *e = s;
        return k;
      }
    s = refine_sibling(r, s);
    if (s == *e)
      return -1;
  }
}

/* The edge between two given vertices among e and its siblings that belongs to base edge `root`. */
static uint32_t sibling_under(const struct lod_refiner *r, uint32_t e, uint32_t root) {
  for (uint32_t s = e;;) {
    uint32_t top = s;
    while (r->edges[top].up != LOD_NONE)
      top = r->edges[top].up;
    if (top == root)
      return s;
    s = refine_sibling(r, s);
    if (s == e)
      return e;
  }
}

static struct lod_vec3 middle_sector_normal(struct lod_refiner *r, uint32_t v, uint32_t triangle) {
  uint32_t e = r->vertices[v].origin, root = e, k = r->vertices[v].level, at_start, at_end;
  while (r->edges[root].up != LOD_NONE)
    root = r->edges[root].up;
  int side = base_side(r, &root, triangle);
  if (side < 0)
    return (struct lod_vec3){0};
  e = sibling_under(r, e, root);
  uint32_t f = refine_side(r, e, side);
  if (!inner_edges(r, f, e, &at_start, &at_end))
    return (struct lod_vec3){0};
  /* Counter-clockwise in f: from the end that its direction leads to. */
  uint32_t to = r->edges[e].v[side == 0 ? 1 : 0], from = r->edges[e].v[side == 0 ? 0 : 1];
  struct lod_vec3 ring[4] = {refine_position(r, to, k), refine_position(r, spoke_end(r, at_end, v, k), k),
                             refine_position(r, spoke_end(r, at_start, v, k), k), refine_position(r, from, k)};
  return refine_sector_normal(refine_position(r, v, k), ring, 4);
}

void refine_normal(struct lod_refiner *r, uint32_t v, uint32_t base_triangle, float normal[3]) {
  memset(normal, 0, 3 * sizeof *normal);
  if (r->failed)
    return;
  if (!isnan(r->shown[v].normal[0])) {
    memcpy(normal, r->shown[v].normal, 3 * sizeof *normal);
  } else if (r->vertices[v].rule == REFINE_SMOOTH) {
    refine_limit(r, v);
    memcpy(normal, r->shown[v].normal, 3 * sizeof *normal);
  } else if (r->vertices[v].level == 0) {
    refine_store_normal(base_sector_normal(r, r->vertices[v].origin, base_triangle), normal);
  } else {
    refine_store_normal(middle_sector_normal(r, v, base_triangle), normal);
  }
}
