/* The proof: let e be a current edge and Q0 ... Qm the source's line that it stands for. If Q0 and Qm lie within epsilon of e's ends and
 * every Qi within epsilon of e, all of the line is (distance to a convex set is convex); and since the nearest point on e moves without
 * jumps along the line, every point of e between those of Q0 and Qm is the nearest point of some point of the line, and those beyond are
 * nearer to Q0 or Qm than the farther of two points that are within epsilon of it. */
#include "core/envelope/curves.h"

#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/triangle_distance.h"

/* Goes along feature edges from v, coming from `from`; LOD_NONE where the chain ends. */
static uint32_t step(const struct lod_surface *s, uint32_t v, uint32_t from) {
  uint32_t ends[2];
  if (s->kind[v] != LOD_VERTEX_CURVE || lod_surface_feature_ends(s, v, ends) != 2)
    return LOD_NONE;
  return ends[0] == from ? ends[1] : ends[0];
}

static void trace(struct lod_curves *c, const struct lod_surface *s, uint32_t seed, uint32_t chain, uint32_t *used) {
  uint32_t ends[2];
  if (lod_surface_feature_ends(s, seed, ends) != 2)
    return;
  /* Back to a corner, or round to the seed. */
  uint32_t at = ends[0], from = seed;
  while (at != seed && s->kind[at] == LOD_VERTEX_CURVE) {
    uint32_t next = step(s, at, from);
    from = at;
    at = next;
  }
  c->loop[chain] = at == seed;
  c->first[chain] = *used;
  uint32_t last = at, v = at == seed ? ends[1] : from;
  c->order[(*used)++] = at;
  if (c->loop[chain]) {
    c->chain[at] = chain;
    c->place[at] = 0;
  }
  while (v != seed || !c->loop[chain]) {
    c->order[*used] = v;
    if (s->kind[v] != LOD_VERTEX_CURVE) {
      (*used)++;
      break;
    }
    c->chain[v] = chain;
    c->place[v] = (*used)++ - c->first[chain];
    uint32_t next = step(s, v, last);
    last = v;
    v = next;
  }
  c->count[chain] = *used - c->first[chain];
}

enum lod_status lod_curves_create(const struct lod_mesh *source, const struct lod_surface *s, struct lod_arena *arena,
                                  struct lod_curves *c) {
  *c = (struct lod_curves){.source = source, .margin = 2 * lod_tolerance_rounding(lod_mesh_magnitude(source))};
  size_t on_curves = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++)
    on_curves += s->ring_count[v] != 0 && s->kind[v] == LOD_VERTEX_CURVE;
  c->chain = LOD_NEW(arena, s->vertex_count, uint32_t);
  c->place = LOD_NEW_ZERO(arena, s->vertex_count, uint32_t);
  c->order = LOD_NEW(arena, 3 * on_curves, uint32_t); /* a chain has two corners at most, and a vertex of its own at least */
  c->first = LOD_NEW(arena, on_curves, uint32_t);
  c->count = LOD_NEW_ZERO(arena, on_curves, uint32_t);
  c->loop = LOD_NEW_ZERO(arena, on_curves, bool);
  if (c->chain == NULL || c->place == NULL || c->order == NULL || c->first == NULL || c->count == NULL || c->loop == NULL)
    return LOD_MEMORY;
  memset(c->chain, 0xff, s->vertex_count * sizeof *c->chain);
  uint32_t chains = 0, used = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++)
    if (s->ring_count[v] != 0 && s->kind[v] == LOD_VERTEX_CURVE && c->chain[v] == LOD_NONE)
      trace(c, s, v, chains++, &used);
  return LOD_OK;
}

/* The four vertices in a row that a collapse is about, as places in their chain, and which way they run. */
struct stretch {
  const uint32_t *order;
  uint32_t count;
  uint32_t previous, a, b, next; /* next LOD_NONE: b is a corner */
  bool backwards;
};

static uint32_t survivor(const struct lod_curves *c, uint32_t v) {
  while (c->merged[v] != v)
    v = c->merged[v];
  return v;
}

static bool find_stretch(const struct lod_curves *c, const struct lod_surface *s, uint32_t a, uint32_t b, uint32_t *previous,
                         uint32_t *next, struct stretch *stretch) {
  uint32_t chain = c->chain[a], ends[2];
  if (chain == LOD_NONE || lod_surface_feature_ends(s, a, ends) != 2 || (ends[0] != b && ends[1] != b))
    return false;
  *previous = ends[0] == b ? ends[1] : ends[0];
  *next = LOD_NONE;
  if (s->kind[b] == LOD_VERTEX_CURVE) {
    if (c->chain[b] != chain || lod_surface_feature_ends(s, b, ends) != 2)
      return false;
    *next = ends[0] == a ? ends[1] : ends[0];
  }
  const uint32_t *order = c->order + c->first[chain];
  uint32_t n = c->count[chain], at = c->place[a];
  *stretch = (struct stretch){.order = order, .count = n, .a = at, .b = c->place[b], .previous = c->place[*previous]};
  stretch->next = *next == LOD_NONE ? LOD_NONE : c->place[*next];
  if (c->loop[chain]) {
    stretch->backwards = (at + n - stretch->previous) % n + (stretch->b + n - at) % n >= n;
    return true;
  }
  bool b_curve = *next != LOD_NONE, previous_curve = s->kind[*previous] == LOD_VERTEX_CURVE;
  if (b_curve)
    stretch->backwards = stretch->b < at;
  else if (previous_curve)
    stretch->backwards = stretch->previous > at;
  else
    stretch->backwards = survivor(c, order[0]) == b;
  if (!b_curve)
    stretch->b = stretch->backwards ? 0 : n - 1;
  if (!previous_curve)
    stretch->previous = stretch->backwards ? n - 1 : 0;
  if (b_curve && s->kind[*next] != LOD_VERTEX_CURVE)
    stretch->next = stretch->backwards ? 0 : n - 1;
  return true;
}

static struct lod_vec3 point(const struct lod_curves *c, const struct stretch *stretch, uint32_t place) {
  return lod_vec3_from_float(c->source->positions[stretch->order[place]]);
}

static uint32_t after(const struct stretch *stretch, uint32_t place) {
  if (stretch->backwards)
    return place == 0 ? stretch->count - 1 : place - 1;
  return place + 1 == stretch->count ? 0 : place + 1;
}

/* Whether the edge from u to w may stand for the chain between two places. */
static bool stands_for(const struct lod_curves *c, const struct stretch *stretch, struct lod_vec3 u, uint32_t from, struct lod_vec3 w,
                       uint32_t to, double squared) {
  struct lod_vec3 edge = lod_vec3_subtract(w, u);
  if (lod_vec3_distance_squared(u, point(c, stretch, from)) > squared || lod_vec3_distance_squared(w, point(c, stretch, to)) > squared)
    return false;
  for (uint32_t i = from; i != to; i = after(stretch, i))
    if (lod_segment_distance_squared(lod_vec3_subtract(point(c, stretch, i), u), edge) > squared)
      return false;
  return true;
}

bool lod_curves_allow(const struct lod_curves *c, const struct lod_surface *s, uint32_t a, uint32_t b, struct lod_vec3 to, double epsilon,
                      uint32_t *place) {
  struct stretch stretch;
  uint32_t previous, next;
  if (!find_stretch(c, s, a, b, &previous, &next, &stretch))
    return false;
  double narrowed = fmax(0, epsilon - c->margin), squared = narrowed * narrowed;
  *place = stretch.b;
  if (next != LOD_NONE) { /* of the places from a to b, the nearest */
    double best = lod_vec3_distance_squared(to, point(c, &stretch, stretch.b));
    for (uint32_t i = stretch.a; i != stretch.b; i = after(&stretch, i)) {
      double d = lod_vec3_distance_squared(to, point(c, &stretch, i));
      if (d < best) {
        best = d;
        *place = i;
      }
    }
  }
  return stands_for(c, &stretch, s->position[previous], stretch.previous, to, *place, squared) &&
         (next == LOD_NONE || stands_for(c, &stretch, to, *place, s->position[next], stretch.next, squared));
}

void lod_curves_collapse(struct lod_curves *c, const struct lod_surface *s, uint32_t b, uint32_t place) {
  if (s->kind[b] == LOD_VERTEX_CURVE)
    c->place[b] = place;
}

/* The line that leaves junction e by its edge to w, as it would be with e at `to`. */
static bool allows_end(const struct lod_curves *c, const struct lod_surface *s, uint32_t e, uint32_t w, struct lod_vec3 to,
                       double squared) {
  uint32_t chain = s->kind[w] == LOD_VERTEX_CURVE ? c->chain[w] : LOD_NONE, ends[2];
  if (chain == LOD_NONE)
    return true;
  if (c->loop[chain] || lod_surface_feature_ends(s, w, ends) != 2)
    return false;
  uint32_t next = ends[0] == e ? ends[1] : ends[0], n = c->count[chain];
  struct stretch stretch = {.order = c->order + c->first[chain], .count = n};
  stretch.backwards = s->kind[next] == LOD_VERTEX_CURVE ? c->place[next] < c->place[w] : survivor(c, stretch.order[0]) != e;
  return stands_for(c, &stretch, to, stretch.backwards ? n - 1 : 0, s->position[w], c->place[w], squared);
}

bool lod_curves_allow_junction(const struct lod_curves *c, const struct lod_surface *s, uint32_t a, uint32_t b, struct lod_vec3 to,
                               double epsilon) {
  double narrowed = fmax(0, epsilon - c->margin), squared = narrowed * narrowed;
  for (int side = 0; side < 2; side++) {
    uint32_t e = side == 0 ? a : b;
    const uint32_t *ring = lod_surface_ring(s, e);
    for (uint32_t i = 0; i < s->ring_count[e]; i++) {
      uint32_t f = ring[i];
      int k = lod_surface_corner(s, f, e);
      const uint32_t ends[2] = {s->face[f][(k + 1) % 3], s->face[f][(k + 2) % 3]};
      const uint8_t bit[2] = {(uint8_t)(1 << k), (uint8_t)(1 << (k + 2) % 3)};
      for (int j = 0; j < 2; j++)
        if ((s->feature[f] & bit[j]) != 0 && ends[j] != a && ends[j] != b && !allows_end(c, s, e, ends[j], to, squared))
          return false;
    }
  }
  return true;
}
