#include "core/mesh/certify.h"

#include <math.h>

/* A piece this deep is far below rounding: its bound is taken as it is. */
enum { MAX_DEPTH = 100 };

static void update_threshold(struct lod_certifier *c) {
  double sure = fmax(c->lower - c->rounding, 0);
  double wanted = sure + fmax(c->relative * sure, c->absolute) - c->rounding;
  /* Two roundings above the lower bound, or splitting would not end. */
  c->threshold = fmax(wanted, c->lower + 2 * c->rounding);
}

void lod_certifier_init(struct lod_certifier *certifier, double lower) {
  certifier->lower = lower;
  certifier->reached = 0;
  certifier->upper = 0;
  certifier->splits = 0;
  certifier->last = LOD_NONE;
  certifier->probe_primitive = LOD_NONE;
  update_threshold(certifier);
}

void lod_certifier_raise(struct lod_certifier *certifier, double distance) {
  if (distance > certifier->reached)
    certifier->reached = distance;
  if (distance > certifier->lower) {
    certifier->lower = distance;
    update_threshold(certifier);
  }
}

static bool drop(struct lod_certifier *c, double bound) {
  bound = fmin(bound, c->known_upper);
  if (!(bound <= c->threshold))
    return false;
  if (bound > c->upper)
    c->upper = bound;
  return true;
}

bool lod_certify_ball(struct lod_certifier *c, struct lod_vec3 centre, double radius) {
  double room = c->threshold - radius, d2;
  if (!(room > 0))
    return false;
  uint32_t found = lod_bvh_search(c->target, centre, c->last, room * room, room * room, &d2);
  if (found == LOD_NONE)
    return false;
  c->last = found;
  return drop(c, sqrt(d2) + radius);
}

static const struct lod_triangle_probe *probe(struct lod_certifier *c, uint32_t primitive) {
  if (c->probe_primitive != primitive) {
    c->probe = lod_bvh_probe(c->target, primitive);
    c->probe_primitive = primitive;
  }
  return &c->probe;
}

/* Convexity: no point of the piece is farther from a triangle than the piece's farthest corner. Stops with INFINITY at a corner beyond
 * `enough`. *worst: the corner that decided. */
static double corner_bound(struct lod_certifier *c, const struct lod_piece *piece, uint32_t primitive, double enough, int *worst) {
  const struct lod_triangle_probe *t = probe(c, primitive);
  double bound = 0;
  for (int k = 0; k < 3; k++) {
    double d2 = lod_triangle_distance_squared(t, piece->corners[k]);
    if (d2 > bound) {
      bound = d2;
      *worst = k;
    }
    if (d2 > enough * enough)
      return INFINITY;
  }
  return sqrt(bound);
}

/* The exact distance of a point of the piece, as far as it matters: returns the primitive found. */
static uint32_t reach(struct lod_certifier *c, struct lod_vec3 p, uint32_t hint, double accept, double *distance) {
  double d2, accept_squared = accept > 0 ? accept * accept : -1;
  uint32_t found = lod_bvh_search(c->target, p, hint, INFINITY, accept_squared, &d2);
  *distance = sqrt(d2);
  if (!(d2 <= accept_squared))
    lod_certifier_raise(c, *distance);
  return found;
}

static bool evaluate(struct lod_certifier *c, struct lod_piece *piece) {
  if (drop(c, piece->upper))
    return true;
  int worst = 0;
  if (piece->hint != LOD_NONE && drop(c, corner_bound(c, piece, piece->hint, c->threshold, &worst))) {
    c->last = piece->hint;
    return true;
  }
  if (c->last != LOD_NONE && c->last != piece->hint && drop(c, corner_bound(c, piece, c->last, c->threshold, &worst)))
    return true;
  const struct lod_vec3 *v = piece->corners;
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(lod_vec3_add(v[0], v[1]), v[2]), 1.0 / 3);
  double radius = sqrt(fmax(fmax(lod_vec3_distance_squared(centre, v[0]), lod_vec3_distance_squared(centre, v[1])),
                            lod_vec3_distance_squared(centre, v[2])));
  double distance;
  uint32_t hint = piece->hint != LOD_NONE ? piece->hint : c->last;
  hint = reach(c, centre, hint, c->threshold - radius, &distance);
  c->last = piece->hint = hint;
  double bound = distance + radius;
  if (drop(c, bound))
    return true;
  bound = fmin(bound, corner_bound(c, piece, hint, INFINITY, &worst));
  if (drop(c, bound))
    return true;
  /* Maxima like corners. */
  hint = reach(c, v[worst], hint, c->lower, &distance);
  int unused = 0;
  bound = fmin(bound, corner_bound(c, piece, hint, INFINITY, &unused));
  piece->upper = fmin(bound, piece->upper);
  return drop(c, piece->upper);
}

/* Halves the longest edge. */
static void split(const struct lod_piece *piece, struct lod_piece children[2]) {
  int longest = 0;
  double longest_squared = -1;
  for (int k = 0; k < 3; k++) {
    double l2 = lod_vec3_distance_squared(piece->corners[k], piece->corners[(k + 1) % 3]);
    if (l2 > longest_squared) {
      longest_squared = l2;
      longest = k;
    }
  }
  int next = (longest + 1) % 3;
  struct lod_vec3 middle = lod_vec3_scale(lod_vec3_add(piece->corners[longest], piece->corners[next]), 0.5);
  children[0] = children[1] = *piece;
  children[0].corners[next] = middle;
  children[1].corners[longest] = middle;
  children[0].depth = children[1].depth = piece->depth + 1;
}

uint32_t lod_certify_piece(struct lod_certifier *c, const struct lod_piece *piece, uint32_t splits,
                           struct lod_piece rest[LOD_CERTIFY_REST]) {
  struct lod_piece stack[LOD_CERTIFY_REST];
  uint32_t depth = 0, left = 0, used = 0;
  stack[depth++] = *piece;
  while (depth > 0) {
    struct lod_piece top = stack[--depth];
    if (evaluate(c, &top))
      continue;
    if (top.depth >= MAX_DEPTH) {
      c->upper = fmax(c->upper, top.upper);
    } else if (used >= splits || depth + 2 + left > LOD_CERTIFY_REST) {
      rest[left++] = top;
    } else {
      split(&top, &stack[depth]);
      depth += 2;
      used++;
    }
  }
  c->splits += used;
  return left;
}
