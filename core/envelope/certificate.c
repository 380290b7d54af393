/* Certificates of two-sided simplification.
 *
 * Based on: shared algorithms 2.4.2 and 2.4.3 (convexity lemma, multi-charge). Ours: the backward test computes, once per distinct source
 * vertex, a mask of the faces within epsilon; a triangle is certified when the masks of its corners have a face in common. */
#include "core/envelope/certificate.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"

enum {
  BACKWARD_DEPTH = 6,  /* 4-splits of a source triangle */
  FORWARD_DEPTH = 9,   /* 4-splits of a new face */
  FORWARD_TESTS = 6000 /* of one new face; what needs more is refused */
};

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
  double epsilon, epsilon_squared; /* narrowed by the rounding margin */
  double margin;
  struct charges *charges;         /* per face */
  uint32_t *version;               /* per source triangle */
  uint32_t *triangle_stamp, *vertex_stamp;
  uint64_t *vertex_mask;
  uint32_t stamp;
  struct found *found;
  uint32_t found_count, found_capacity;
};

void lod_certificate_set_epsilon(struct lod_certificate *c, double epsilon) {
  c->epsilon = fmax(0, epsilon - c->margin);
  c->epsilon_squared = c->epsilon * c->epsilon;
}

enum lod_status lod_certificate_create(const struct lod_mesh *source, const struct lod_bvh *bvh, double epsilon, struct lod_arena *arena,
                                       struct lod_certificate **certificate) {
  struct lod_certificate *c = LOD_NEW_ZERO(arena, 1, struct lod_certificate);
  if (c == NULL)
    return LOD_MEMORY;
  c->source = source;
  c->bvh = bvh;
  c->arena = arena;
  c->margin = lod_tolerance_rounding(lod_mesh_magnitude(source));
  lod_certificate_set_epsilon(c, epsilon);
  c->charges = LOD_NEW_ZERO(arena, source->triangle_count, struct charges);
  c->version = LOD_NEW_ZERO(arena, source->triangle_count, uint32_t);
  c->triangle_stamp = LOD_NEW_ZERO(arena, source->triangle_count, uint32_t);
  c->vertex_stamp = LOD_NEW_ZERO(arena, source->vertex_count, uint32_t);
  c->vertex_mask = LOD_NEW(arena, source->vertex_count, uint64_t);
  struct charge *first = LOD_NEW(arena, source->triangle_count, struct charge);
  if (c->charges == NULL || c->version == NULL || c->triangle_stamp == NULL || c->vertex_stamp == NULL || c->vertex_mask == NULL || first == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < source->triangle_count; t++) { /* every triangle is certified by itself */
    first[t] = (struct charge){t, 0};
    c->charges[t] = (struct charges){&first[t], 1, 1, 32};
  }
  *certificate = c;
  return LOD_OK;
}

/* ---- point to face ---- */

/* A candidate face with what makes rejecting cheap. Rejecting too much is safe; accepting goes through a point of the face. */
struct target {
  struct lod_vec3 a, ab, ac, bc, centre;
  double d00, d01, d11, denominator;
  double reach_squared; /* (radius + epsilon)^2 around centre */
};

static struct target make_target(const struct lod_candidate *candidate, double epsilon) {
  struct target t;
  struct lod_vec3 b = candidate->corner[1], c = candidate->corner[2];
  t.a = candidate->corner[0];
  t.ab = lod_vec3_subtract(b, t.a);
  t.ac = lod_vec3_subtract(c, t.a);
  t.bc = lod_vec3_subtract(c, b);
  t.d00 = lod_vec3_dot(t.ab, t.ab);
  t.d01 = lod_vec3_dot(t.ab, t.ac);
  t.d11 = lod_vec3_dot(t.ac, t.ac);
  t.denominator = t.d00 * t.d11 - t.d01 * t.d01;
  t.centre = lod_vec3_scale(lod_vec3_add(t.a, lod_vec3_add(b, c)), 1.0 / 3);
  double radius = sqrt(fmax(lod_vec3_distance_squared(t.centre, t.a), fmax(lod_vec3_distance_squared(t.centre, b), lod_vec3_distance_squared(t.centre, c))));
  t.reach_squared = (radius + epsilon) * (radius + epsilon);
  return t;
}

static double clamp01(double x) {
  return x < 0 ? 0 : x > 1 ? 1 : x;
}

/* Whether q is within epsilon of the face: shown by a point of the face (any rounding of its coordinates v, w still gives a point of it). */
static bool within(const struct target *t, struct lod_vec3 q, double epsilon_squared) {
  if (lod_vec3_distance_squared(q, t->centre) > t->reach_squared)
    return false;
  struct lod_vec3 aq = lod_vec3_subtract(q, t->a);
  double d20 = lod_vec3_dot(aq, t->ab), d21 = lod_vec3_dot(aq, t->ac);
  double v = t->d11 * d20 - t->d01 * d21, w = t->d00 * d21 - t->d01 * d20;
  if (v >= 0 && w >= 0 && v + w <= t->denominator && t->denominator > 0) {
    v /= t->denominator;
    w /= t->denominator;
    struct lod_vec3 p = lod_vec3_add_scaled(lod_vec3_scale(t->ab, v), t->ac, w);
    return lod_vec3_distance_squared(aq, p) <= epsilon_squared;
  }
  /* Outside: nearest on the border. */
  double s = t->d00 > 0 ? clamp01(d20 / t->d00) : 0;
  if (lod_vec3_distance_squared(aq, lod_vec3_scale(t->ab, s)) <= epsilon_squared)
    return true;
  s = t->d11 > 0 ? clamp01(d21 / t->d11) : 0;
  if (lod_vec3_distance_squared(aq, lod_vec3_scale(t->ac, s)) <= epsilon_squared)
    return true;
  double length = lod_vec3_dot(t->bc, t->bc);
  struct lod_vec3 bq = lod_vec3_subtract(aq, t->ab);
  s = length > 0 ? clamp01(lod_vec3_dot(bq, t->bc) / length) : 0;
  return lod_vec3_distance_squared(bq, lod_vec3_scale(t->bc, s)) <= epsilon_squared;
}

/* ---- backward ---- */

struct trial {
  struct lod_certificate *certificate;
  const struct lod_change *change;
  struct target targets[LOD_CERTIFICATE_MAX_FACES];
  uint32_t target_count;
};

static uint64_t mask_of(const struct trial *trial, struct lod_vec3 q) {
  uint64_t mask = 0;
  for (uint32_t k = 0; k < trial->target_count; k++)
    if (within(&trial->targets[k], q, trial->certificate->epsilon_squared))
      mask |= (uint64_t)1 << k;
  return mask;
}

static uint64_t vertex_mask(const struct trial *trial, uint32_t v) {
  struct lod_certificate *c = trial->certificate;
  if (c->vertex_stamp[v] != c->stamp) {
    c->vertex_stamp[v] = c->stamp;
    c->vertex_mask[v] = mask_of(trial, lod_vec3_from_float(c->source->positions[v]));
  }
  return c->vertex_mask[v];
}

/* Certifies the piece with corners p and their masks m; adds the faces used to *used. */
static bool certify_piece(const struct trial *trial, const struct lod_vec3 p[3], const uint64_t m[3], int depth, uint64_t *used) {
  uint64_t common = m[0] & m[1] & m[2];
  if (common != 0) {
    if ((common & *used) == 0)
      *used |= common & -common;
    return true;
  }
  if (depth == 0 || m[0] == 0 || m[1] == 0 || m[2] == 0)
    return false;
  struct lod_vec3 h[3];
  uint64_t n[3];
  for (int k = 0; k < 3; k++) {
    h[k] = lod_vec3_scale(lod_vec3_add(p[k], p[(k + 1) % 3]), 0.5);
    n[k] = mask_of(trial, h[k]);
    if (n[k] == 0)
      return false;
  }
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 q[3] = {p[k], h[k], h[(k + 2) % 3]};
    uint64_t o[3] = {m[k], n[k], n[(k + 2) % 3]};
    if (!certify_piece(trial, q, o, depth - 1, used))
      return false;
  }
  return certify_piece(trial, h, n, depth - 1, used);
}

static bool certify_source_triangle(const struct trial *trial, uint32_t t, uint64_t *used) {
  const struct lod_mesh *source = trial->certificate->source;
  uint64_t m[3];
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++) {
    m[k] = vertex_mask(trial, source->triangles[t][k]);
    if (m[k] == 0)
      return false;
    p[k] = lod_vec3_from_float(source->positions[source->triangles[t][k]]);
  }
  *used = 0;
  return certify_piece(trial, p, m, BACKWARD_DEPTH, used);
}

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

static bool try_backward(struct trial *trial, struct lod_change *change, enum lod_status *status) {
  struct lod_certificate *c = trial->certificate;
  uint64_t used;
  c->found_count = 0;
  if (change->witness != LOD_NONE && is_charged(c, change, change->witness) && !certify_source_triangle(trial, change->witness, &used))
    return false;
  for (uint32_t i = 0; i < change->changing_count; i++) {
    const struct charges *charges = &c->charges[change->changing[i]];
    for (uint32_t j = 0; j < charges->count; j++) {
      uint32_t t = charges->items[j].triangle;
      if (charges->items[j].version != c->version[t] || c->triangle_stamp[t] == c->stamp)
        continue;
      c->triangle_stamp[t] = c->stamp;
      if (!certify_source_triangle(trial, t, &used)) {
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

struct forward {
  const struct lod_certificate *certificate;
  uint32_t tests; /* left */
};

static double point_to_source_triangle(const struct lod_certificate *c, uint32_t t, struct lod_vec3 q) {
  const uint32_t *v = c->source->triangles[t];
  struct lod_vec3 p = lod_closest_on_triangle(q, lod_vec3_from_float(c->source->positions[v[0]]), lod_vec3_from_float(c->source->positions[v[1]]),
                                              lod_vec3_from_float(c->source->positions[v[2]]));
  return lod_vec3_distance_squared(p, q);
}

static bool all_within(const struct lod_certificate *c, uint32_t t, const struct lod_vec3 *p) {
  return t < c->source->triangle_count && point_to_source_triangle(c, t, p[0]) <= c->epsilon_squared &&
         point_to_source_triangle(c, t, p[1]) <= c->epsilon_squared && point_to_source_triangle(c, t, p[2]) <= c->epsilon_squared;
}

/* near[k]: a source triangle within epsilon of p[k]. A piece is proven by one source triangle near all its corners, or by one so near its
 * centre that the radius still fits; a piece with a point that has nothing within epsilon is refuted. */
static bool forward_piece(struct forward *f, const struct lod_vec3 p[3], const uint32_t near[3], int depth) {
  const struct lod_certificate *c = f->certificate;
  if (f->tests == 0)
    return false;
  f->tests--;
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3);
  double radius = sqrt(fmax(lod_vec3_distance_squared(centre, p[0]), fmax(lod_vec3_distance_squared(centre, p[1]), lod_vec3_distance_squared(centre, p[2]))));
  double rest = c->epsilon - radius;
  for (int k = 0; k < 3 && rest > 0; k++)
    if ((k == 0 || near[k] != near[k - 1]) && point_to_source_triangle(c, near[k], centre) <= rest * rest)
      return true;
  for (int k = 0; k < 3; k++)
    if ((k == 0 || near[k] != near[0]) && (k < 2 || near[k] != near[1]) && all_within(c, near[k], p))
      return true;
  if (rest > 0) {
    struct lod_closest closest = lod_bvh_closest(c->bvh, centre, near[0], c->epsilon_squared);
    if (closest.primitive >= c->source->triangle_count)
      return false;
    if (closest.distance_squared <= rest * rest || all_within(c, closest.primitive, p))
      return true;
  }
  if (depth == 0)
    return false;
  struct lod_vec3 h[3];
  uint32_t n[3];
  for (int k = 0; k < 3; k++) {
    h[k] = lod_vec3_scale(lod_vec3_add(p[k], p[(k + 1) % 3]), 0.5);
    n[k] = lod_bvh_any_within(c->bvh, h[k], near[k], c->epsilon_squared);
    if (n[k] >= c->source->triangle_count)
      return false;
  }
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 q[3] = {p[k], h[k], h[(k + 2) % 3]};
    uint32_t o[3] = {near[k], n[k], n[(k + 2) % 3]};
    if (!forward_piece(f, q, o, depth - 1))
      return false;
  }
  return forward_piece(f, h, n, depth - 1);
}

/* Nearby source triangles of the corners; false when a corner or the centre has none within epsilon: most refusals end here. */
static bool forward_probe(const struct lod_certificate *c, const struct lod_candidate *face, const uint32_t hints[3], uint32_t near[3]) {
  for (int k = 0; k < 3; k++) {
    near[k] = lod_bvh_any_within(c->bvh, face->corner[k], hints[k], c->epsilon_squared);
    if (near[k] >= c->source->triangle_count)
      return false;
  }
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(face->corner[0], lod_vec3_add(face->corner[1], face->corner[2])), 1.0 / 3);
  return lod_bvh_any_within(c->bvh, centre, near[0], c->epsilon_squared) < c->source->triangle_count;
}

bool lod_certificate_try(struct lod_certificate *c, struct lod_change *change, enum lod_status *status) {
  assert(change->face_count <= LOD_CERTIFICATE_MAX_FACES);
  *status = LOD_OK;
  c->stamp++;
  struct trial trial = {.certificate = c, .change = change, .target_count = change->face_count};
  for (uint32_t k = 0; k < change->face_count; k++)
    trial.targets[k] = make_target(&change->faces[k], c->epsilon);
  uint32_t near[LOD_CERTIFICATE_MAX_FACES][3];
  for (uint32_t k = 0; k < change->fresh_count; k++)
    if (!forward_probe(c, &change->faces[k], change->hints[k], near[k]))
      return false;
  if (!try_backward(&trial, change, status))
    return false;
  for (uint32_t k = 0; k < change->fresh_count; k++) {
    struct forward forward = {c, FORWARD_TESTS};
    if (!forward_piece(&forward, change->faces[k].corner, near[k], FORWARD_DEPTH))
      return false;
  }
  return true;
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
  for (uint32_t f = 0; f < c->source->triangle_count; f++)
    for (uint32_t i = 0; i < c->charges[f].count; i++)
      if (c->charges[f].items[i].version == c->version[c->charges[f].items[i].triangle])
        nearby[c->charges[f].items[i].triangle] = face_to[f];
}
