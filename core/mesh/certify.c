#include "core/mesh/certify.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* A piece this deep is far below rounding: its bound is taken as it is. Cuts along the target come first, then only halves, which are sure
 * to end. */
enum { MAX_DEPTH = 200, MAX_CUTS = 60 };

static void update_threshold(struct lod_certifier *c) {
  double sure = fmax(c->lower - c->rounding, 0);
  double wanted = sure + fmax(c->relative * sure, c->absolute) - c->rounding;
  /* Two roundings above the lower bound, or cutting would not end. */
  c->threshold = fmax(wanted, c->lower + 2 * c->rounding);
}

void lod_vertex_cache_init(struct lod_vertex_cache *cache) {
  memset(cache->vertices, 0xff, sizeof cache->vertices);
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

/* --- bounds --- */

static const struct lod_triangle_probe *probe(struct lod_certifier *c, uint32_t primitive) {
  if (c->probe_primitive != primitive) {
    c->probe = lod_bvh_probe(c->target, primitive);
    c->probe_primitive = primitive;
  }
  return &c->probe;
}

/* Convexity: no point of the piece is farther from a triangle than the piece's farthest corner, *worst. */
static double corner_bound(struct lod_certifier *c, const struct lod_piece *piece, uint32_t primitive, uint32_t *worst) {
  const struct lod_triangle_probe *t = probe(c, primitive);
  double bound = -1;
  for (uint32_t i = 0; i < piece->count; i++) {
    double d2 = lod_triangle_distance_squared(t, piece->corners[i]);
    if (d2 > bound) {
      bound = d2;
      *worst = i;
    }
  }
  return sqrt(bound);
}

/* The same for the piece's own record. */
static bool drop_by_corners(struct lod_certifier *c, struct lod_piece *piece, uint32_t primitive, uint32_t *worst) {
  double bound = corner_bound(c, piece, primitive, worst);
  if (bound < piece->upper)
    piece->upper = bound;
  if (!drop(c, bound))
    return false;
  c->last = primitive;
  return true;
}

/* The exact distance of a point of the piece, as far as it matters; returns the primitive found. */
static uint32_t reach(struct lod_certifier *c, struct lod_vec3 p, uint32_t hint, double accept, double *distance) {
  double d2, accept_squared = accept > 0 ? accept * accept : -1;
  uint32_t found = lod_bvh_search(c->target, p, hint, INFINITY, accept_squared, &d2);
  *distance = sqrt(d2);
  if (!(d2 <= accept_squared))
    lod_certifier_raise(c, *distance);
  return found;
}

static struct lod_vec3 piece_centre(const struct lod_piece *piece, double *radius) {
  struct lod_vec3 sum = piece->corners[0];
  for (uint32_t i = 1; i < piece->count; i++)
    sum = lod_vec3_add(sum, piece->corners[i]);
  struct lod_vec3 centre = lod_vec3_scale(sum, 1.0 / piece->count);
  double r2 = 0;
  for (uint32_t i = 0; i < piece->count; i++)
    r2 = fmax(r2, lod_vec3_distance_squared(centre, piece->corners[i]));
  *radius = sqrt(r2);
  return centre;
}

/* --- cutting --- */

struct plane {
  struct lod_vec3 point, normal;
};

static void add_corner(struct lod_piece *piece, struct lod_vec3 corner, uint32_t near) {
  assert(piece->count < LOD_PIECE_CORNERS);
  piece->corners[piece->count] = corner;
  piece->near[piece->count++] = near;
}

/* parts[0] lies behind the plane, parts[1] before it. False when the plane does not separate corners, or leaves too many. */
static bool cut(const struct lod_piece *piece, const struct plane *plane, struct lod_piece parts[2]) {
  double side[LOD_PIECE_CORNERS];
  uint32_t behind = 0, before = 0, count = piece->count;
  for (uint32_t i = 0; i < count; i++) {
    side[i] = lod_vec3_dot(plane->normal, lod_vec3_subtract(piece->corners[i], plane->point));
    behind += side[i] < 0;
    before += side[i] > 0;
  }
  if (behind == 0 || before == 0 || count - before + 2 > LOD_PIECE_CORNERS || count - behind + 2 > LOD_PIECE_CORNERS)
    return false;
  for (int k = 0; k < 2; k++) {
    parts[k].count = 0;
    parts[k].upper = piece->upper;
    parts[k].hint = piece->hint;
    parts[k].depth = piece->depth + 1;
  }
  for (uint32_t i = 0; i < count; i++) {
    uint32_t next = i + 1 < count ? i + 1 : 0;
    if (side[i] <= 0)
      add_corner(&parts[0], piece->corners[i], piece->near[i]);
    if (side[i] >= 0)
      add_corner(&parts[1], piece->corners[i], piece->near[i]);
    if ((side[i] < 0) == (side[next] < 0) || side[i] == 0 || side[next] == 0 || (count == 2 && i == 1))
      continue;
    double at = side[i] / (side[i] - side[next]);
    struct lod_vec3 corner = lod_vec3_add_scaled(piece->corners[i], lod_vec3_subtract(piece->corners[next], piece->corners[i]), at);
    add_corner(&parts[0], corner, LOD_NONE);
    add_corner(&parts[1], corner, LOD_NONE);
  }
  return true;
}

/* Along a diagonal: no new corners. */
static void cut_diagonal(const struct lod_piece *piece, struct lod_piece parts[2]) {
  uint32_t middle = piece->count / 2;
  parts[0] = parts[1] = *piece;
  parts[0].depth = parts[1].depth = piece->depth + 1;
  parts[0].count = parts[1].count = 0;
  for (uint32_t i = 0; i <= middle; i++)
    add_corner(&parts[0], piece->corners[i], piece->near[i]);
  for (uint32_t i = middle; i <= piece->count; i++)
    add_corner(&parts[1], piece->corners[i % piece->count], piece->near[i % piece->count]);
}

/* Half way between its two farthest corners. */
static void halve(const struct lod_piece *piece, struct lod_piece parts[2]) {
  uint32_t a = 0, b = 0;
  double farthest = -1;
  for (uint32_t i = 0; i < piece->count; i++) {
    for (uint32_t k = i + 1; k < piece->count; k++) {
      double d2 = lod_vec3_distance_squared(piece->corners[i], piece->corners[k]);
      if (d2 > farthest) {
        farthest = d2;
        a = i;
        b = k;
      }
    }
  }
  struct plane plane = {lod_vec3_scale(lod_vec3_add(piece->corners[a], piece->corners[b]), 0.5),
                        lod_vec3_subtract(piece->corners[b], piece->corners[a])};
  if (piece->count <= LOD_PIECE_CORNERS - 2 && cut(piece, &plane, parts))
    return;
  if (piece->count > 3) {
    cut_diagonal(piece, parts);
    return;
  }
  /* Corners a rounding apart: nothing between them. Twice the same piece, deeper, ends at MAX_DEPTH. */
  parts[0] = parts[1] = *piece;
  parts[0].depth = parts[1].depth = MAX_DEPTH;
}

/* Where the piece's corner p hangs over an edge of a target triangle, and is near enough to its plane that what lies within the edges will
 * be dropped, the plane through that edge, upright, is a cut that follows the target's own pieces. Not worth it where the target's
 * triangles are smaller than the threshold (there halves are dropped whole) or much smaller than the piece (they would be peeled off one by
 * one). */
static bool find_edge_plane(struct lod_certifier *c, uint32_t primitive, struct lod_vec3 p, struct plane *plane) {
  const struct lod_triangle_probe *t = probe(c, primitive);
  double t2 = c->threshold * c->threshold, size2 = fmax(lod_vec3_length_squared(t->ab), lod_vec3_length_squared(t->ac));
  if (!(t->normal_squared > 0) || size2 < t2)
    return false;
  struct lod_vec3 ap = lod_vec3_subtract(p, t->a);
  double height = lod_vec3_dot(ap, t->normal);
  if (height * height > t2 * t->normal_squared)
    return false;
  const struct lod_vec3 starts[3] = {lod_vec3_make(0, 0, 0), t->ab, t->ac};
  const struct lod_vec3 edges[3] = {t->ab, lod_vec3_subtract(t->ac, t->ab), lod_vec3_scale(t->ac, -1)};
  double least = 1e-4 * t2, farthest = least; /* less is no progress */
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 outward = lod_vec3_cross(edges[k], t->normal);
    double over = lod_vec3_dot(outward, lod_vec3_subtract(ap, starts[k]));
    if (over <= 0)
      continue;
    over = over * over / lod_vec3_length_squared(outward);
    if (over > farthest) {
      farthest = over;
      *plane = (struct plane){lod_vec3_add(t->a, starts[k]), outward};
    }
  }
  return farthest > least && farthest < 4 * size2;
}

static bool cut_along_target(struct lod_certifier *c, const struct lod_piece *piece, uint32_t primitive, uint32_t worst,
                             struct lod_piece parts[2]) {
  struct plane plane;
  if (piece->depth > MAX_CUTS || piece->count > LOD_PIECE_CORNERS - 2 || !find_edge_plane(c, primitive, piece->corners[worst], &plane) ||
      !cut(piece, &plane, parts))
    return false;
  parts[0].hint = primitive;
  parts[1].hint = piece->near[worst] != primitive ? piece->near[worst] : LOD_NONE;
  return true;
}

/* Where the piece lies in a valley of the target, its parts near to either slope: the plane as far from one slope as from the other, on the
 * sides where the piece is. `worst` is far from the slope of the hint and near to its own. */
static bool cut_between_targets(struct lod_certifier *c, const struct lod_piece *piece, uint32_t worst, struct lod_piece parts[2]) {
  uint32_t slopes[2] = {piece->hint, piece->near[worst]};
  if (slopes[0] == slopes[1] || piece->depth > MAX_CUTS || piece->count > LOD_PIECE_CORNERS - 2)
    return false;
  struct lod_vec3 normals[2], origins[2];
  double radius;
  struct lod_vec3 points[2] = {piece_centre(piece, &radius), piece->corners[worst]};
  for (int k = 0; k < 2; k++) {
    const struct lod_triangle_probe *t = probe(c, slopes[k]);
    if (!(t->normal_squared > 0))
      return false;
    origins[k] = t->a;
    bool below = lod_vec3_dot(t->normal, lod_vec3_subtract(points[k], t->a)) < 0;
    normals[k] = lod_vec3_scale(t->normal, (below ? -1 : 1) / sqrt(t->normal_squared));
  }
  struct plane plane = {.normal = lod_vec3_subtract(normals[0], normals[1])};
  double length_squared = lod_vec3_length_squared(plane.normal);
  if (!(length_squared > 1e-12))
    return false;
  /* The point of the plane under the worst corner: heights differ by `excess` there. */
  double excess = lod_vec3_dot(normals[0], lod_vec3_subtract(points[1], origins[0])) -
                  lod_vec3_dot(normals[1], lod_vec3_subtract(points[1], origins[1]));
  plane.point = lod_vec3_add_scaled(points[1], plane.normal, -excess / length_squared);
  double least = 0.05 * c->threshold, lowest = 0;
  for (uint32_t i = 0; i < piece->count; i++)
    lowest = fmin(lowest, lod_vec3_dot(plane.normal, lod_vec3_subtract(piece->corners[i], plane.point)));
  if (excess < least || lowest > -least || !cut(piece, &plane, parts))
    return false;
  parts[0].hint = slopes[0];
  parts[1].hint = slopes[1];
  return true;
}

/* --- deciding --- */

/* True when the piece is dropped; otherwise it is in two parts. */
static bool decide(struct lod_certifier *c, struct lod_piece *piece, struct lod_piece parts[2]) {
  if (drop(c, piece->upper))
    return true;
  uint32_t worst = 0, tried = piece->hint;
  if (tried != LOD_NONE) {
    if (drop_by_corners(c, piece, tried, &worst))
      return true;
    if (cut_along_target(c, piece, tried, worst, parts))
      return false;
  }
  double radius, distance;
  struct lod_vec3 centre = piece_centre(piece, &radius);
  piece->hint = reach(c, centre, tried != LOD_NONE ? tried : c->last, c->threshold - radius, &distance);
  if (distance + radius < piece->upper)
    piece->upper = distance + radius;
  if (drop(c, piece->upper))
    return true;
  if (piece->hint != tried) {
    if (drop_by_corners(c, piece, piece->hint, &worst))
      return true;
    if (cut_along_target(c, piece, piece->hint, worst, parts))
      return false;
  }
  /* Maxima like corners. */
  if (piece->near[worst] == LOD_NONE) {
    uint32_t unused;
    piece->near[worst] = reach(c, piece->corners[worst], piece->hint, c->lower, &distance);
    if (piece->near[worst] != piece->hint && drop_by_corners(c, piece, piece->near[worst], &unused))
      return true;
  }
  if (drop(c, piece->upper))
    return true;
  if (!cut_between_targets(c, piece, worst, parts))
    halve(piece, parts);
  return false;
}

uint32_t lod_certify_piece(struct lod_certifier *c, const struct lod_piece *piece, uint32_t splits,
                           struct lod_piece rest[LOD_CERTIFY_REST]) {
  struct lod_piece stack[LOD_CERTIFY_REST];
  uint32_t depth = 0, left = 0, used = 0;
  stack[depth++] = *piece;
  while (depth > 0) {
    struct lod_piece top = stack[--depth], parts[2];
    if (decide(c, &top, parts))
      continue;
    if (top.depth >= MAX_DEPTH) {
      c->upper = fmax(c->upper, top.upper);
    } else if (used >= splits || depth + 2 + left > LOD_CERTIFY_REST) {
      rest[left++] = top;
    } else {
      stack[depth++] = parts[0];
      stack[depth++] = parts[1];
      used++;
    }
  }
  c->splits += used;
  return left;
}

/* The nearest primitive of a vertex of items, remembered. */
static uint32_t nearest_of_vertex(struct lod_certifier *c, uint32_t vertex, struct lod_vec3 p, uint32_t hint) {
  uint32_t slot = (vertex * 0x9e3779b1u) >> 20;
  if (c->cache->vertices[slot] != vertex) {
    double distance;
    c->cache->vertices[slot] = vertex;
    c->cache->nearest[slot] = reach(c, p, hint, -1, &distance);
  }
  return c->cache->nearest[slot];
}

uint32_t lod_certify_primitive(struct lod_certifier *c, uint32_t primitive, uint32_t hint, uint32_t splits,
                               struct lod_piece rest[LOD_CERTIFY_REST]) {
  struct lod_piece piece = {.upper = INFINITY, .hint = hint};
  uint32_t triple[3], worst;
  lod_mesh_primitive(c->items->mesh, primitive, triple);
  piece.count = triple[1] == triple[0] ? 1 : triple[2] == triple[1] ? 2 : 3;
  for (uint32_t k = 0; k < piece.count; k++) {
    piece.corners[k] = lod_vec3_from_float(c->items->mesh->positions[triple[k]]);
    piece.near[k] = LOD_NONE;
  }
  if (drop(c, INFINITY) || (hint != LOD_NONE && drop_by_corners(c, &piece, hint, &worst)))
    return 0;
  if (c->last != LOD_NONE && c->last != hint && drop_by_corners(c, &piece, c->last, &worst))
    return 0;
  double best = INFINITY;
  for (uint32_t k = 0; k < piece.count; k++) {
    uint32_t near = piece.near[k] = nearest_of_vertex(c, triple[k], piece.corners[k], hint != LOD_NONE ? hint : c->last);
    if ((k > 0 && near == piece.near[0]) || (k > 1 && near == piece.near[1]))
      continue;
    double bound = corner_bound(c, &piece, near, &worst);
    if (drop(c, bound)) {
      c->last = near;
      return 0;
    }
    if (bound < best) {
      best = bound;
      piece.hint = near;
    }
  }
  piece.upper = fmin(piece.upper, best);
  return lod_certify_piece(c, &piece, splits, rest);
}
