/* Certificates of two-sided simplification.
 *
 * Based on: shared algorithms 2.4.2 and 2.4.3 (convexity lemma, multi-charge). Ours: the backward test computes, once per distinct source
 * vertex, a mask of the faces within epsilon; a triangle is certified when the masks of its corners have a face in common. */
#include "core/envelope/certificate.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/envelope/forward.h"

enum {
  BACKWARD_DEPTH = 12, /* cuts of a source triangle */
  PART_CORNERS = 9,
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

struct proxy {
  struct lod_forward forward; /* epsilon: what is left of it */
  double proven;
  const uint32_t *triangle_of;
};

struct lod_certificate {
  const struct lod_mesh *source;
  const struct lod_bvh *bvh;
  struct lod_arena *arena;
  double epsilon, epsilon_squared; /* narrowed by the rounding margin */
  double full_epsilon, margin;
  struct lod_forward forward;
  struct proxy proxies[PROXIES]; /* finest first */
  uint32_t proxy_count;
  struct charges *charges; /* per face */
  uint32_t *version;       /* per source triangle */
  uint32_t *triangle_stamp, *vertex_stamp, *rest_stamp;
  uint64_t *vertex_mask, *rest_mask;
  uint32_t stamp;
  struct found *found;
  uint32_t found_count, found_capacity;
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
  for (uint32_t i = 0; i < c->proxy_count; i++)
    set_forward_epsilon(&c->proxies[i].forward, c->epsilon - c->proxies[i].proven);
}

enum lod_status lod_certificate_add_proxy(struct lod_certificate *c, const struct lod_mesh *mesh, double proven,
                                          const uint32_t *triangle_of) {
  if (c->proxy_count == PROXIES) {
    memmove(c->proxies, c->proxies + 1, (PROXIES - 1) * sizeof *c->proxies);
    c->proxy_count--;
  }
  struct proxy *proxy = &c->proxies[c->proxy_count];
  struct lod_bvh *bvh;
  LOD_TRY(lod_bvh_create(mesh, 1, c->arena, &bvh));
  LOD_TRY(lod_forward_init(&proxy->forward, mesh, bvh, c->arena));
  proxy->proven = proven;
  proxy->triangle_of = triangle_of;
  c->proxy_count++;
  lod_certificate_set_epsilon(c, c->full_epsilon);
  return LOD_OK;
}

enum lod_status lod_certificate_create(const struct lod_mesh *source, const struct lod_bvh *bvh, double epsilon, struct lod_arena *arena,
                                       struct lod_certificate **certificate) {
  struct lod_certificate *c = LOD_NEW_ZERO(arena, 1, struct lod_certificate);
  if (c == NULL)
    return LOD_MEMORY;
  c->source = source;
  c->bvh = bvh;
  c->arena = arena;
  c->margin = 2 * lod_tolerance_rounding(lod_mesh_magnitude(source)); /* of distances, and of the corners of pieces that were cut */
  LOD_TRY(lod_forward_init(&c->forward, source, bvh, arena));
  lod_certificate_set_epsilon(c, epsilon);
  c->charges = LOD_NEW_ZERO(arena, source->triangle_count, struct charges);
  c->version = LOD_NEW_ZERO(arena, source->triangle_count, uint32_t);
  c->triangle_stamp = LOD_NEW_ZERO(arena, source->triangle_count, uint32_t);
  c->vertex_stamp = LOD_NEW_ZERO(arena, source->vertex_count, uint32_t);
  c->vertex_mask = LOD_NEW(arena, source->vertex_count, uint64_t);
  c->rest_stamp = LOD_NEW_ZERO(arena, source->vertex_count, uint32_t);
  c->rest_mask = LOD_NEW(arena, source->vertex_count, uint64_t);
  struct charge *first = LOD_NEW(arena, source->triangle_count, struct charge);
  if (c->charges == NULL || c->version == NULL || c->triangle_stamp == NULL || c->vertex_stamp == NULL || c->vertex_mask == NULL ||
      c->rest_stamp == NULL || c->rest_mask == NULL || first == NULL)
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
  double reach, reach_squared; /* radius + epsilon around centre */
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
  double radius = sqrt(
      fmax(lod_vec3_distance_squared(t.centre, t.a), fmax(lod_vec3_distance_squared(t.centre, b), lod_vec3_distance_squared(t.centre, c))));
  t.reach = (radius + epsilon) * (1 + 1e-12);
  t.reach_squared = t.reach * t.reach;
  return t;
}

static double clamp01(double x) {
  return x < 0 ? 0 : x > 1 ? 1 : x;
}

/* Whether q is within epsilon of the face: shown by a point of the face (any rounding of its coordinates v, w still gives a point of it).
 */
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
  struct lod_change *change;
  struct target targets[LOD_CERTIFICATE_MAX_FACES];
  uint32_t target_count;
  bool gathered;       /* the unchanged neighbours are among them */
  uint64_t candidates; /* those that may be near the source triangle that is being certified */
};

/* Which of the faces first ... first + count - 1 are within epsilon of q. */
static uint64_t mask_of(const struct trial *trial, struct lod_vec3 q, uint64_t candidates) {
  uint64_t mask = 0;
  for (; candidates != 0; candidates &= candidates - 1) {
    int k = __builtin_ctzll(candidates);
    if (within(&trial->targets[k], q, trial->certificate->epsilon_squared))
      mask |= (uint64_t)1 << k;
  }
  return mask;
}

/* Faces first ... end - 1 as bits. */
static uint64_t bits(uint32_t first, uint32_t end) {
  uint64_t below = end >= 64 ? ~(uint64_t)0 : ((uint64_t)1 << end) - 1;
  return first >= 64 ? 0 : below >> first << first;
}

/* Targets for the fresh faces, or the neighbours as well. */
static void make_targets(struct trial *trial, bool neighbours) {
  struct lod_change *change = trial->change;
  if (neighbours)
    change->gather(change->context, change);
  for (; trial->target_count < change->face_count; trial->target_count++)
    trial->targets[trial->target_count] = make_target(&change->faces[trial->target_count], trial->certificate->epsilon);
  trial->gathered = neighbours;
}

/* Faces that may be near a part of the source triangle with corners p. */
static uint64_t candidates_near(const struct trial *trial, const struct lod_vec3 p[3]) {
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3);
  double radius = 0;
  for (int k = 0; k < 3; k++)
    radius = fmax(radius, lod_vec3_distance_squared(centre, p[k]));
  radius = sqrt(radius);
  uint64_t mask = 0;
  for (uint32_t k = 0; k < trial->target_count; k++) {
    double reach = radius + trial->targets[k].reach;
    if (lod_vec3_distance_squared(centre, trial->targets[k].centre) <= reach * reach)
      mask |= (uint64_t)1 << k;
  }
  return mask;
}

/* The fresh faces near a source vertex: they certify nearly everything, so that the others are asked only where these do not. */
static uint64_t fresh_mask(const struct trial *trial, uint32_t v) {
  struct lod_certificate *c = trial->certificate;
  if (c->vertex_stamp[v] != c->stamp) {
    c->vertex_stamp[v] = c->stamp;
    c->vertex_mask[v] = mask_of(trial, lod_vec3_from_float(c->source->positions[v]), bits(0, trial->change->fresh_count));
  }
  return c->vertex_mask[v];
}

static uint64_t vertex_mask(const struct trial *trial, uint32_t v) {
  struct lod_certificate *c = trial->certificate;
  uint64_t fresh = fresh_mask(trial, v);
  if (c->rest_stamp[v] != c->stamp) {
    c->rest_stamp[v] = c->stamp;
    c->rest_mask[v] = mask_of(trial, lod_vec3_from_float(c->source->positions[v]), bits(trial->change->fresh_count, trial->target_count));
  }
  return fresh | c->rest_mask[v];
}

/* A convex part of a source triangle, with the faces within epsilon of each corner. */
struct part {
  struct lod_vec3 corner[PART_CORNERS];
  uint64_t mask[PART_CORNERS];
  uint32_t count;
};

static struct lod_vec3 inward_of(const struct target *t, int edge, struct lod_vec3 *from) {
  struct lod_vec3 n = lod_vec3_cross(t->ab, t->ac);
  *from = edge == 1 ? lod_vec3_add(t->a, t->ab) : t->a;
  return edge == 0 ? lod_vec3_cross(n, t->ab) : edge == 1 ? lod_vec3_cross(n, t->bc) : lod_vec3_cross(t->ac, n);
}

/* The face within epsilon of most corners. */
static uint32_t best_face(const struct part *part) {
  uint64_t any = 0;
  for (uint32_t i = 0; i < part->count; i++)
    any |= part->mask[i];
  uint32_t best = 0, most = 0;
  for (; any != 0; any &= any - 1) {
    uint32_t k = (uint32_t)__builtin_ctzll(any), near = 0;
    for (uint32_t i = 0; i < part->count; i++)
      near += part->mask[i] >> k & 1;
    if (near > most) {
      most = near;
      best = k;
    }
  }
  return best;
}

/* Sides of the corners against the edge of face t that the part hangs over farthest; false when there is none that cuts the part. */
static bool find_cut(const struct target *t, const struct part *part, uint32_t face, double side[PART_CORNERS]) {
  double farthest = 0;
  for (int edge = 0; edge < 3; edge++) {
    struct lod_vec3 from, inward = inward_of(t, edge, &from);
    double s[PART_CORNERS], scale = lod_vec3_length(inward), out = 0, in = 0;
    for (uint32_t i = 0; i < part->count; i++) {
      s[i] = lod_vec3_dot(inward, lod_vec3_subtract(part->corner[i], from));
      if (s[i] < out && !(part->mask[i] >> face & 1))
        out = s[i];
      if (s[i] > in)
        in = s[i];
    }
    /* Not so near the border that rounding decides. */
    if (in > 1e-6 * -out && out < 1e-6 * -in && out < farthest * scale) {
      farthest = out / scale;
      memcpy(side, s, part->count * sizeof *s);
    }
  }
  return farthest < 0;
}

/* Through the middle of the longest edge. */
static void find_half(const struct part *part, double side[PART_CORNERS]) {
  uint32_t longest = 0;
  double length = -1;
  for (uint32_t i = 0; i < part->count; i++) {
    double l = lod_vec3_distance_squared(part->corner[i], part->corner[(i + 1) % part->count]);
    if (l > length) {
      length = l;
      longest = i;
    }
  }
  struct lod_vec3 a = part->corner[longest], ab = lod_vec3_subtract(part->corner[(longest + 1) % part->count], a);
  for (uint32_t i = 0; i < part->count; i++)
    side[i] = lod_vec3_dot(ab, lod_vec3_subtract(part->corner[i], a)) - 0.5 * length;
}

/* Both sides of the cut. False when a point on the cut has no face near, which refutes the part, or when the cut does not cross its border
 * just twice, which rounding can do. */
static bool cut_part(const struct trial *trial, const struct part *part, const double side[PART_CORNERS], struct part *inside,
                     struct part *outside) {
  uint32_t crossings = 0;
  for (uint32_t i = 0; i < part->count; i++)
    crossings += (side[i] > 0) != (side[(i + 1) % part->count] > 0);
  if (crossings != 2)
    return false;
  inside->count = outside->count = 0;
  for (uint32_t i = 0; i < part->count; i++) {
    uint32_t j = i + 1 == part->count ? 0 : i + 1;
    struct part *to = side[i] > 0 ? inside : outside;
    to->corner[to->count] = part->corner[i];
    to->mask[to->count++] = part->mask[i];
    if ((side[i] > 0) == (side[j] > 0))
      continue;
    struct lod_vec3 at =
        lod_vec3_add_scaled(part->corner[i], lod_vec3_subtract(part->corner[j], part->corner[i]), side[i] / (side[i] - side[j]));
    uint64_t mask = mask_of(trial, at, trial->candidates);
    if (mask == 0)
      return false;
    inside->corner[inside->count] = outside->corner[outside->count] = at;
    inside->mask[inside->count++] = outside->mask[outside->count++] = mask;
  }
  return true;
}

/* Certifies a part: by a face near all its corners, else cut along the border of the face that is near most of them, so that the parts are
 * about as many as the faces below. Adds the faces used to *used. */
static bool certify_part(const struct trial *trial, const struct part *part, int depth, uint64_t *used) {
  uint64_t common = ~(uint64_t)0;
  for (uint32_t i = 0; i < part->count; i++)
    common &= part->mask[i];
  if (common != 0) {
    if ((common & *used) == 0)
      *used |= common & -common;
    return true;
  }
  if (depth == 0 || part->count + 2 > PART_CORNERS)
    return false;
  uint32_t face = best_face(part);
  double side[PART_CORNERS];
  if (!find_cut(&trial->targets[face], part, face, side))
    find_half(part, side);
  struct part inside, outside;
  return cut_part(trial, part, side, &inside, &outside) && certify_part(trial, &inside, depth - 1, used) &&
         certify_part(trial, &outside, depth - 1, used);
}

static bool certify_source_triangle(struct trial *trial, uint32_t t, uint64_t *used) {
  const struct lod_mesh *source = trial->certificate->source;
  const uint32_t *v = source->triangles[t];
  *used = 0;
  uint64_t common = fresh_mask(trial, v[0]) & fresh_mask(trial, v[1]) & fresh_mask(trial, v[2]);
  if (common != 0) {
    *used = common & -common;
    return true;
  }
  if (!trial->gathered)
    make_targets(trial, true);
  struct part part = {.count = 3};
  for (int k = 0; k < 3; k++) {
    part.mask[k] = vertex_mask(trial, v[k]);
    if (part.mask[k] == 0)
      return false;
    part.corner[k] = lod_vec3_from_float(source->positions[v[k]]);
  }
  trial->candidates = candidates_near(trial, part.corner);
  return certify_part(trial, &part, BACKWARD_DEPTH, used);
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

static bool near_source(const struct lod_certificate *c, struct lod_vec3 p, uint32_t hint, uint32_t *near) {
  *near = lod_bvh_any_within(c->bvh, p, hint, c->epsilon_squared);
  return *near < c->source->triangle_count;
}

/* The coarsest proxy that leaves most of epsilon; NULL when there is none. */
static const struct proxy *useful_proxy(const struct lod_certificate *c) {
  for (uint32_t i = c->proxy_count; i > 0; i--)
    if (c->proxies[i - 1].proven <= PROXY_SHARE * c->epsilon)
      return &c->proxies[i - 1];
  return NULL;
}

static bool probe(const struct lod_certificate *c, const struct proxy *proxy, const struct lod_candidate *face, uint32_t hint,
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

static bool try_forward(const struct lod_certificate *c, const struct proxy *proxy, const struct lod_candidate *face, uint32_t near) {
  struct lod_vec3 refuter;
  if (proxy != NULL) {

    enum lod_forward_answer answer =
        lod_forward_test(&proxy->forward, face->corner, proxy->triangle_of[face->face], PROXY_PIECES, &refuter);
    if (answer == LOD_FORWARD_PROVEN)
      return true;

    uint32_t hint;
    if (answer == LOD_FORWARD_REFUTED && !near_source(c, refuter, LOD_NONE, &hint))
      return false;
  }
  return lod_forward_test(&c->forward, face->corner, near, FORWARD_PIECES, &refuter) == LOD_FORWARD_PROVEN;
}

bool lod_certificate_try(struct lod_certificate *c, struct lod_change *change, enum lod_status *status) {
  assert(change->face_count <= LOD_CERTIFICATE_MAX_FACES);
  *status = LOD_OK;
  c->stamp++;
  const struct proxy *proxy = useful_proxy(c);
  uint32_t near[LOD_CERTIFICATE_MAX_FACES];
  for (uint32_t k = 0; k < change->fresh_count; k++)
    if (!probe(c, proxy, &change->faces[k], change->hints[k][0], &near[k])) {
      return false;
    }
  struct trial trial;
  trial.certificate = c;
  trial.change = change;
  trial.target_count = 0;
  make_targets(&trial, false);
  if (!try_backward(&trial, change, status)) {
    return false;
  }
  for (uint32_t k = 0; k < change->fresh_count; k++)
    if (!try_forward(c, proxy, &change->faces[k], near[k])) {
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

enum lod_status lod_certificate_move(struct lod_certificate *c, uint32_t triangle, uint32_t face) {
  c->version[triangle]++;
  return charge_face(c, face, triangle);
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
