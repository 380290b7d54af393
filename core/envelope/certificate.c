/* Certificates of two-sided simplification.
 *
 * Based on: shared algorithms 2.4.2 and 2.4.3 (convexity lemma, multi-charge). Ours: the backward test computes, once per distinct source
 * vertex, a mask of the faces within epsilon; a triangle is certified when the masks of its corners have a face in common. */
#include "core/envelope/certificate.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/triangle_distance.h"

enum {
  FORWARD_PIECES = 2000, /* of one new face; what needs more is refused */
  PROXY_PIECES = 200,
  PROXIES = 3
};

/* A proxy may take this share of epsilon. */
#define PROXY_SHARE 0.34

/* One charge: source triangle `triangle` used this face while its version was `version`. */
struct charge {
  uint32_t triangle, version;
};

struct charges {
  struct charge *items;
  uint32_t count, capacity, purge_at;
};

/* What a backward certificate found for one source triangle of the current trial. */
struct found {
  uint32_t triangle;
  uint64_t used; /* candidate faces that certify it */
};

struct lod_certificate {
  const struct lod_mesh *source;
  const struct lod_bvh *bvh;
  struct lod_arena *arena;
  uint32_t face_count;             /* of the surface */
  double epsilon, epsilon_squared; /* narrowed by the margin */
  double full_epsilon, margin;
  struct lod_forward forward;
  struct lod_proxy proxies[PROXIES]; /* finest first */
  uint32_t proxy_count;
  struct charges *charges;  /* per face */
  uint32_t *version;        /* per source triangle */
  uint32_t *triangle_stamp; /* per source triangle: the trial that asked for it last */
  uint32_t stamp;
  struct lod_backward *backward;
  const struct lod_wedges *wedges; /* NULL: attributes are not bounded */
  const uint32_t *patch;
  struct found *found;
  uint32_t found_count, found_capacity;
  double rms; /* share of epsilon; 0 = nobody asks */
};

static void set_forward_epsilon(struct lod_forward *forward, double epsilon) {
  forward->epsilon = fmax(0, epsilon);
  forward->epsilon_squared = forward->epsilon * forward->epsilon;
}

void lod_certificate_set_epsilon(struct lod_certificate *c, double epsilon) {
  c->full_epsilon = epsilon;
  c->epsilon = fmax(0, epsilon - c->margin);
  c->epsilon_squared = c->epsilon * c->epsilon;
  set_forward_epsilon(&c->forward, c->epsilon);
  lod_backward_set_epsilon(c->backward, c->epsilon);
  for (uint32_t i = 0; i < c->proxy_count; i++)
    set_forward_epsilon(&c->proxies[i].forward, c->epsilon - c->proxies[i].proven);
}

void lod_certificate_add_proxy(struct lod_certificate *c, const struct lod_forward *proxy, double proven, const uint32_t *triangle_of) {
  if (c->proxy_count == PROXIES) {
    memmove(c->proxies, c->proxies + 1, (PROXIES - 1) * sizeof *c->proxies);
    c->proxy_count--;
  }
  c->proxies[c->proxy_count++] = (struct lod_proxy){*proxy, proven, triangle_of};
  lod_certificate_set_epsilon(c, c->full_epsilon);
}

const struct lod_proxy *lod_certificate_proxy(const struct lod_certificate *c, double most) {
  for (uint32_t i = c->proxy_count; i > 0; i--)
    if (c->proxies[i - 1].proven <= most)
      return &c->proxies[i - 1];
  return NULL;
}

const struct lod_forward *lod_certificate_source(const struct lod_certificate *c) {
  return &c->forward;
}

static enum lod_status create(const struct lod_forward *source, uint32_t face_count, const double *limits, double epsilon,
                              struct lod_arena *arena, struct lod_certificate **certificate) {
  struct lod_certificate *c = LOD_NEW_ZERO(arena, 1, struct lod_certificate);
  if (c == NULL)
    return LOD_MEMORY;
  uint32_t count = source->source->triangle_count;
  c->source = source->source;
  c->bvh = source->bvh;
  c->arena = arena;
  c->face_count = face_count;
  c->margin = LOD_TOLERANCE_CERTIFICATE * lod_mesh_magnitude(c->source);
  LOD_TRY(lod_backward_create(c->source, limits, arena, &c->backward));
  c->forward = *source;
  c->forward.limits = limits;
  lod_certificate_set_epsilon(c, epsilon);
  c->charges = LOD_NEW_ZERO(arena, face_count, struct charges);
  c->version = LOD_NEW_ZERO(arena, count, uint32_t);
  c->triangle_stamp = LOD_NEW_ZERO(arena, count, uint32_t);
  if (c->charges == NULL || c->version == NULL || c->triangle_stamp == NULL)
    return LOD_MEMORY;
  *certificate = c;
  return LOD_OK;
}

enum lod_status lod_certificate_create(const struct lod_mesh *source, const struct lod_bvh *bvh, const double *limits, double epsilon,
                                       struct lod_arena *arena, struct lod_certificate **certificate) {
  struct lod_forward forward;
  LOD_TRY(lod_forward_init(&forward, source, bvh, arena));
  LOD_TRY(create(&forward, source->triangle_count, limits, epsilon, arena, certificate));
  struct lod_certificate *c = *certificate;
  struct charge *first = LOD_NEW(arena, source->triangle_count, struct charge);
  if (first == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < source->triangle_count; t++) { /* every triangle is certified by itself */
    first[t] = (struct charge){t, 0};
    c->charges[t] = (struct charges){&first[t], 1, 1, 32};
  }
  return LOD_OK;
}

enum lod_status lod_certificate_create_bare(const struct lod_forward *source, uint32_t face_count, double epsilon, struct lod_arena *arena,
                                            struct lod_certificate **certificate) {
  return create(source, face_count, NULL, epsilon, arena, certificate);
}

enum lod_status lod_certificate_bound_attributes(struct lod_certificate *c, const struct lod_wedges *wedges, const uint32_t *patch) {
  c->wedges = wedges;
  c->patch = patch;
  return lod_backward_bound_attributes(c->backward, wedges, patch, c->arena);
}

/* ---- backward ---- */

static bool add_found(struct lod_certificate *c, uint32_t triangle, uint64_t used) {
  if (c->found_count == c->found_capacity) {
    uint32_t capacity = c->found_capacity == 0 ? 1024 : 2 * c->found_capacity;
    struct found *grown = LOD_NEW(c->arena, capacity, struct found);
    if (grown == NULL)
      return false;
    if (c->found_count != 0)
      memcpy(grown, c->found, c->found_count * sizeof *grown);
    c->found = grown;
    c->found_capacity = capacity;
  }
  c->found[c->found_count++] = (struct found){triangle, used};
  return true;
}

/* A witness of an earlier trial counts only while it still depends on the changing faces. */
static bool is_charged(const struct lod_certificate *c, const struct lod_change *change, uint32_t triangle) {
  for (uint32_t i = 0; i < change->changing_count; i++) {
    const struct charges *charges = &c->charges[change->changing[i]];
    for (uint32_t j = 0; j < charges->count; j++)
      if (charges->items[j].triangle == triangle && charges->items[j].version == c->version[triangle])
        return true;
  }
  return false;
}

static bool try_backward(struct lod_certificate *c, struct lod_change *change, enum lod_status *status) {
  uint64_t used;
  c->found_count = 0;
  if (change->witness != LOD_NONE && is_charged(c, change, change->witness) && !lod_backward_test(c->backward, change->witness, &used))
    return false;
  for (uint32_t i = 0; i < change->changing_count; i++) {
    const struct charges *charges = &c->charges[change->changing[i]];
    for (uint32_t j = 0; j < charges->count; j++) {
      uint32_t t = charges->items[j].triangle;
      if (charges->items[j].version != c->version[t] || c->triangle_stamp[t] == c->stamp)
        continue;
      c->triangle_stamp[t] = c->stamp;
      if (!lod_backward_test(c->backward, t, &used)) {
        change->witness = t;
        return false;
      }
      if (!add_found(c, t, used)) {
        *status = LOD_MEMORY;
        return false;
      }
    }
  }
  return true;
}

/* ---- forward ---- */

static bool near_source(const struct lod_certificate *c, struct lod_vec3 p, uint32_t hint, uint32_t *near) {
  *near = lod_bvh_any_within(c->bvh, p, hint, c->epsilon_squared);
  return *near < c->source->triangle_count;
}

/* The coarsest proxy that leaves most of epsilon; NULL when there is none. */
static const struct lod_proxy *useful_proxy(const struct lod_certificate *c) {
  for (uint32_t i = c->forward.limits != NULL ? 0 : c->proxy_count; i > 0; i--) /* a proxy knows of no limits */
    if (c->proxies[i - 1].proven <= PROXY_SHARE * c->epsilon)
      return &c->proxies[i - 1];
  return NULL;
}

static bool probe(const struct lod_certificate *c, const struct lod_proxy *proxy, const struct lod_candidate *face, uint32_t hint,
                  uint32_t *near) {
  const struct lod_vec3 *p = face->corner;
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3);
  if (proxy != NULL &&
      lod_bvh_any_within(proxy->forward.bvh, centre, proxy->triangle_of[face->face], proxy->forward.epsilon_squared) != LOD_NONE) {
    *near = LOD_NONE;
    return true;
  }
  return near_source(c, centre, hint, near);
}

static bool try_forward(const struct lod_certificate *c, const struct lod_proxy *proxy, const struct lod_candidate *face, uint32_t near) {
  struct lod_vec3 refuter;
  if (proxy != NULL) {
    enum lod_forward_answer answer =
        lod_forward_test(&proxy->forward, face->corner, proxy->triangle_of[face->face], PROXY_PIECES, &refuter, NULL);
    if (answer == LOD_FORWARD_PROVEN)
      return true;
    uint32_t hint;
    if (answer == LOD_FORWARD_REFUTED && !near_source(c, refuter, LOD_NONE, &hint))
      return false;
  }
  return lod_forward_test(&c->forward, face->corner, near, FORWARD_PIECES, &refuter, NULL) == LOD_FORWARD_PROVEN;
}

/* Points of fresh faces against the triangles that they are to be charged with, on the same patch: an attribute that no source has near
 * there shows what is not the source's. Sampled, at the centre, at corners that moved, at middles of edges to corners that changed. */
static bool attributes_of_source(const struct lod_certificate *c, const struct lod_candidate *face, const double *const corner[3],
                                 const bool moved[3], const bool changed[3]) {
  static const double kWeights[7][3] = {{1, 0, 0},     {0, 1, 0},     {0, 0, 1},    {1.0 / 3, 1.0 / 3, 1.0 / 3},
                                        {0.5, 0.5, 0}, {0, 0.5, 0.5}, {0.5, 0, 0.5}};
  for (int i = 0; i < 7; i++) {
    const double *w = kWeights[i];
    const bool *which = i < 3 ? moved : changed;
    if (i != 3 && !(w[0] > 0 && which[0]) && !(w[1] > 0 && which[1]) && !(w[2] > 0 && which[2]))
      continue;
    struct lod_vec3 p = lod_vec3_scale(face->corner[0], w[0]);
    p = lod_vec3_add_scaled(lod_vec3_add_scaled(p, face->corner[1], w[1]), face->corner[2], w[2]);
    double value[LOD_MOST_CHANNELS];
    for (uint32_t n = 0; n < c->wedges->channels; n++)
      value[n] = w[0] * corner[0][n] + w[1] * corner[1][n] + w[2] * corner[2][n];
    bool shown = false;
    for (uint32_t j = 0; j < c->found_count && !shown; j++)
      shown = c->patch[c->found[j].triangle] == c->patch[face->face] && lod_backward_shows(c->backward, c->found[j].triangle, p, value);
    if (!shown)
      return false;
  }
  return true;
}

static bool try_attributes(const struct lod_certificate *c, const struct lod_change *change) {
  for (uint32_t k = 0; k < change->fresh_count && c->wedges != NULL; k++) {
    const double *corner[3];
    bool moved[3] = {false, false, false}, all = change->placed_count == 0, changed[3] = {all, all, all};
    for (int i = 0; i < 3; i++) {
      corner[i] = lod_backward_value(c->backward, k, i);
      for (uint32_t j = 0; j < change->placed_count; j++) {
        bool placed = change->placed[j].wedge == change->faces[k].wedge[i];
        changed[i] = changed[i] || placed;
        moved[i] = moved[i] || (placed && change->placed[j].moved);
      }
    }
    if (!attributes_of_source(c, &change->faces[k], corner, moved, changed))
      return false;
  }
  return true;
}

void lod_certificate_set_rms(struct lod_certificate *c, double share) {
  c->rms = share;
}

static bool mean_allows(const struct lod_certificate *c, const struct lod_change *change) {
  double sum = 0, area = 0;
  for (uint32_t i = 0; i < c->found_count && c->rms > 0; i++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(c->source->positions[c->source->triangles[c->found[i].triangle][k]]);
    struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3);
    double size = lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]))), nearest = INFINITY;
    for (uint64_t used = c->found[i].used; used != 0; used &= used - 1) {
      const struct lod_vec3 *q = change->faces[__builtin_ctzll(used)].corner;
      nearest = fmin(nearest, lod_vec3_distance_squared(centre, lod_closest_on_triangle(centre, q[0], q[1], q[2])));
    }
    sum += size * nearest;
    area += size;
  }
  return sum <= c->rms * c->rms * c->epsilon_squared * area;
}

bool lod_certificate_try(struct lod_certificate *c, struct lod_change *change, enum lod_status *status) {
  assert(change->face_count <= LOD_CERTIFICATE_MAX_FACES);
  *status = LOD_OK;
  c->stamp++;
  const struct lod_proxy *proxy = useful_proxy(c);
  uint32_t near[LOD_CERTIFICATE_MAX_FACES];
  for (uint32_t k = 0; k < change->fresh_count; k++)
    if (!probe(c, proxy, &change->faces[k], change->hints[k][0], &near[k]))
      return false;
  lod_backward_begin(c->backward, change);
  if (!try_backward(c, change, status))
    return false;
  for (uint32_t k = 0; k < change->fresh_count; k++)
    if (!try_forward(c, proxy, &change->faces[k], near[k]))
      return false;
  return try_attributes(c, change) && mean_allows(c, change);
}

/* ---- commit ---- */

static void purge(const struct lod_certificate *c, struct charges *charges) {
  uint32_t kept = 0;
  for (uint32_t i = 0; i < charges->count; i++)
    if (charges->items[i].version == c->version[charges->items[i].triangle])
      charges->items[kept++] = charges->items[i];
  charges->count = kept;
  charges->purge_at = kept * 2 + 32;
}

static enum lod_status charge_face(struct lod_certificate *c, uint32_t face, uint32_t triangle) {
  struct charges *charges = &c->charges[face];
  if (charges->count >= charges->purge_at)
    purge(c, charges);
  if (charges->count == charges->capacity) {
    uint32_t capacity = charges->capacity < 8 ? 16 : 2 * charges->capacity;
    struct charge *grown = LOD_NEW(c->arena, capacity, struct charge);
    if (grown == NULL)
      return LOD_MEMORY;
    if (charges->count != 0)
      memcpy(grown, charges->items, charges->count * sizeof *grown);
    charges->items = grown;
    charges->capacity = capacity;
  }
  charges->items[charges->count++] = (struct charge){triangle, c->version[triangle]};
  return LOD_OK;
}

enum lod_status lod_certificate_move(struct lod_certificate *c, uint32_t triangle, uint32_t face) {
  c->version[triangle]++;
  return charge_face(c, face, triangle);
}

/* Triangles of the surface that certify triangle t. */
static bool find_in_surface(const struct lod_certificate *c, const struct lod_forward *surface, uint32_t t, uint32_t hint,
                            struct lod_forward_used *used) {
  struct lod_vec3 p[3], refuter;
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(c->source->positions[c->source->triangles[t][k]]);
  used->count = 0;
  if (lod_forward_test(surface, p, hint, FORWARD_PIECES, &refuter, used) == LOD_FORWARD_PROVEN && used->count <= used->capacity)
    return true;
  used->count = 0; /* folds, and hints from far away, lead the walk astray */
  return lod_forward_test_by_halves(surface, p, FORWARD_PIECES, used) && used->count <= used->capacity;
}

enum lod_status lod_certificate_recharge(struct lod_certificate *c, const struct lod_forward *surface, const uint32_t *face_of,
                                         const uint32_t *hints, bool *proven) {
  enum { MOST = 512 };
  uint32_t triangles[MOST];
  struct lod_forward_used used = {.triangles = triangles, .capacity = MOST};
  struct lod_forward narrowed = *surface;
  set_forward_epsilon(&narrowed, c->epsilon);
  for (uint32_t f = 0; f < c->face_count; f++)
    c->charges[f].count = 0;
  *proven = true;
  for (uint32_t t = 0; t < c->source->triangle_count; t++) {
    if (!find_in_surface(c, &narrowed, t, hints == NULL ? LOD_NONE : hints[t], &used)) {
      *proven = false;
      return LOD_OK;
    }
    c->version[t]++;
    for (uint32_t i = 0; i < used.count; i++) {
      uint32_t known = 0;
      while (known < i && triangles[known] != triangles[i])
        known++;
      if (known == i)
        LOD_TRY(charge_face(c, face_of[triangles[i]], t));
    }
  }
  return LOD_OK;
}

enum lod_status lod_certificate_adopt(struct lod_certificate *c, const struct lod_certificate *from, const uint32_t *face_to) {
  for (uint32_t f = 0; f < c->face_count; f++)
    c->charges[f].count = 0;
  for (uint32_t f = 0; f < c->face_count; f++)
    for (uint32_t i = 0; i < from->charges[f].count && face_to[f] != LOD_NONE; i++) {
      struct charge charge = from->charges[f].items[i];
      if (charge.version == from->version[charge.triangle])
        LOD_TRY(charge_face(c, face_to[f], charge.triangle));
    }
  return LOD_OK;
}

enum lod_status lod_certificate_commit(struct lod_certificate *c, const struct lod_change *change) {
  for (uint32_t i = 0; i < change->changing_count; i++)
    c->charges[change->changing[i]].count = 0; /* all of them are charged anew below */
  for (uint32_t i = 0; i < c->found_count; i++) {
    c->version[c->found[i].triangle]++;
    for (uint64_t used = c->found[i].used; used != 0; used &= used - 1)
      LOD_TRY(charge_face(c, change->faces[__builtin_ctzll(used)].face, c->found[i].triangle));
  }
  return LOD_OK;
}

uint32_t lod_certificate_nearest(const struct lod_certificate *c, struct lod_vec3 p, uint32_t hint) {
  return lod_bvh_closest(c->bvh, p, hint, INFINITY).primitive;
}

uint32_t lod_certificate_charge_count(const struct lod_certificate *c, uint32_t face) {
  return c->charges[face].count;
}

uint32_t lod_certificate_charge(const struct lod_certificate *c, uint32_t face, uint32_t i) {
  struct charge charge = c->charges[face].items[i];
  return charge.version == c->version[charge.triangle] ? charge.triangle : LOD_NONE;
}

void lod_certificate_charged(const struct lod_certificate *c, const uint32_t *face_to, uint32_t *nearby) {
  memset(nearby, 0xff, c->source->triangle_count * sizeof *nearby);
  for (uint32_t f = 0; f < c->face_count; f++)
    for (uint32_t i = 0; i < c->charges[f].count; i++)
      if (c->charges[f].items[i].version == c->version[c->charges[f].items[i].triangle])
        nearby[c->charges[f].items[i].triangle] = face_to[f];
}
