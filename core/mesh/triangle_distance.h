/* Distance from points to one triangle, segment or point, in double, for inner loops: prepare once, ask for several points.
 *
 * Accurate on slivers too: the error stays a few roundings of the longest length involved, however thin the triangle, because every
 * decision is made with the normal, and the normal of a sliver is computed with error-free products (Dekker 1971). Barycentric formulas
 * that divide by the squared area lose all digits there. */
#ifndef LOD_CORE_MESH_TRIANGLE_DISTANCE_H
#define LOD_CORE_MESH_TRIANGLE_DISTANCE_H

#include "core/base/vec.h"

struct lod_triangle_probe {
  struct lod_vec3 a, ab, ac;
  struct lod_vec3 normal; /* ab x ac; zero when the triangle is taken as its three edges */
  double normal_squared;
};

/* x * y - z * w with one rounding of the result, for any cancellation (no overflow expected: lengths come from floats). */
double lod_difference_of_products(double x, double y, double z, double w);

/* The normal of a sliver; out of line because it is rare. */
struct lod_vec3 lod_triangle_sliver_normal(struct lod_vec3 ab, struct lod_vec3 ac);

static inline struct lod_triangle_probe lod_triangle_prepare(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  struct lod_triangle_probe t;
  t.a = a;
  t.ab = lod_vec3_subtract(b, a);
  t.ac = lod_vec3_subtract(c, a);
  t.normal = lod_vec3_cross(t.ab, t.ac);
  t.normal_squared = lod_vec3_length_squared(t.normal);
  double product = lod_vec3_length_squared(t.ab) * lod_vec3_length_squared(t.ac);
  if (t.normal_squared < 1e-6 * product) { /* sine of the angle at a below 1e-3 */
    t.normal = lod_triangle_sliver_normal(t.ab, t.ac);
    t.normal_squared = lod_vec3_length_squared(t.normal);
    if (t.normal_squared <= 1e-40 * product) /* narrower than rounding: its edges are all of it */
      t.normal_squared = 0;
  }
  return t;
}

/* Point of the segment from the origin to `edge` nearest to p; both relative to the segment's start. */
static inline struct lod_vec3 lod_segment_nearest(struct lod_vec3 p, struct lod_vec3 edge) {
  double along = lod_vec3_dot(p, edge);
  if (along <= 0)
    return lod_vec3_make(0, 0, 0);
  double length_squared = lod_vec3_length_squared(edge);
  if (along >= length_squared)
    return edge;
  return lod_vec3_scale(edge, along / length_squared);
}

static inline double lod_segment_distance_squared(struct lod_vec3 p, struct lod_vec3 edge) {
  return lod_vec3_distance_squared(p, lod_segment_nearest(p, edge));
}

/* Which side of each edge the point lies on: a bit is set when it lies outside of ab (1), ca (2), bc (4). */
static inline int lod_triangle_outside(const struct lod_triangle_probe *t, struct lod_vec3 ap) {
  struct lod_vec3 bc = lod_vec3_subtract(t->ac, t->ab), bp = lod_vec3_subtract(ap, t->ab);
  int out = lod_vec3_dot(t->normal, lod_vec3_cross(t->ab, ap)) < 0 ? 1 : 0;
  out |= lod_vec3_dot(t->normal, lod_vec3_cross(ap, t->ac)) < 0 ? 2 : 0;
  out |= lod_vec3_dot(t->normal, lod_vec3_cross(bc, bp)) < 0 ? 4 : 0;
  return out;
}

/* Squared distance of q to the triangle. Outside of one edge, the nearest point is on that edge; outside of two, on either. */
static inline double lod_triangle_distance_squared(const struct lod_triangle_probe *t, struct lod_vec3 q) {
  struct lod_vec3 ap = lod_vec3_subtract(q, t->a);
  int out = 7;
  if (t->normal_squared > 0) {
    out = lod_triangle_outside(t, ap);
    if (out == 0) {
      double height = lod_vec3_dot(ap, t->normal);
      return height * height / t->normal_squared;
    }
  }
  double best = INFINITY;
  if (out & 1)
    best = lod_segment_distance_squared(ap, t->ab);
  if (out & 2)
    best = fmin(best, lod_segment_distance_squared(ap, t->ac));
  if (out & 4)
    best = fmin(best, lod_segment_distance_squared(lod_vec3_subtract(ap, t->ab), lod_vec3_subtract(t->ac, t->ab)));
  return best;
}

/* The point itself. */
struct lod_vec3 lod_triangle_nearest(const struct lod_triangle_probe *t, struct lod_vec3 q);

#endif
