/* A face, prepared for the question whether points lie within epsilon of it. */
#ifndef LOD_CORE_ENVELOPE_BACKWARD_TARGET_H
#define LOD_CORE_ENVELOPE_BACKWARD_TARGET_H

#include "core/mesh/mesh.h"

struct lod_target {
  double min[3], max[3]; /* of the face, widened by epsilon */
  struct lod_vec3 a, ab, ac, bc;
  struct lod_vec3 normal;    /* unit */
  struct lod_vec3 inward[3]; /* unit, in the plane, across ab, bc, ca */
  double d00, d01, d11, bc_squared;
  bool round; /* no sliver: normal and inward are exact to a few roundings */
};

static inline void lod_target_box(struct lod_target *t, const struct lod_vec3 corner[3], double epsilon) {
  const double *p = &corner[0].x, *q = &corner[1].x, *r = &corner[2].x;
  for (int k = 0; k < 3; k++) {
    double low = p[k] < q[k] ? p[k] : q[k], high = p[k] < q[k] ? q[k] : p[k];
    t->min[k] = (r[k] < low ? r[k] : low) - epsilon;
    t->max[k] = (r[k] > high ? r[k] : high) + epsilon;
  }
}

static inline bool lod_target_box_has(const struct lod_target *t, struct lod_vec3 q) {
  return q.x >= t->min[0] && q.x <= t->max[0] && q.y >= t->min[1] && q.y <= t->max[1] && q.z >= t->min[2] && q.z <= t->max[2];
}

static inline bool lod_target_box_meets(const struct lod_target *t, const double min[3], const double max[3]) {
  return max[0] >= t->min[0] && min[0] <= t->max[0] && max[1] >= t->min[1] && min[1] <= t->max[1] && max[2] >= t->min[2] &&
         min[2] <= t->max[2];
}

static inline void lod_target_make(struct lod_target *t, const struct lod_vec3 corner[3]) {
  t->a = corner[0];
  t->ab = lod_vec3_subtract(corner[1], t->a);
  t->ac = lod_vec3_subtract(corner[2], t->a);
  t->bc = lod_vec3_subtract(corner[2], corner[1]);
  t->d00 = lod_vec3_length_squared(t->ab);
  t->d01 = lod_vec3_dot(t->ab, t->ac);
  t->d11 = lod_vec3_length_squared(t->ac);
  t->bc_squared = lod_vec3_length_squared(t->bc);
  struct lod_vec3 n = lod_vec3_cross(t->ab, t->ac);
  double n_squared = lod_vec3_length_squared(n), longest = t->d00 > t->d11 ? t->d00 : t->d11;
  longest = t->bc_squared > longest ? t->bc_squared : longest;
  t->round = n_squared > 1e-4 * longest * longest; /* height over 0.01 of the longest edge */
  double inverse = n_squared > 0 ? 1 / sqrt(n_squared) : 0;
  t->normal = lod_vec3_scale(n, inverse);
  t->inward[0] = lod_vec3_scale(lod_vec3_cross(t->normal, t->ab), t->d00 > 0 ? 1 / sqrt(t->d00) : 0);
  t->inward[1] = lod_vec3_scale(lod_vec3_cross(t->normal, t->bc), t->bc_squared > 0 ? 1 / sqrt(t->bc_squared) : 0);
  t->inward[2] = lod_vec3_scale(lod_vec3_cross(t->ac, t->normal), t->d11 > 0 ? 1 / sqrt(t->d11) : 0);
}

static inline double lod_target_clamp(double x) {
  return x < 0 ? 0 : x > 1 ? 1 : x;
}

/* Shown by a point of the border (any rounding of its coordinate still gives a point of it). */
static inline bool lod_target_border_within(const struct lod_target *t, struct lod_vec3 aq, double squared) {
  double s = t->d00 > 0 ? lod_target_clamp(lod_vec3_dot(aq, t->ab) / t->d00) : 0;
  if (lod_vec3_distance_squared(aq, lod_vec3_scale(t->ab, s)) <= squared)
    return true;
  s = t->d11 > 0 ? lod_target_clamp(lod_vec3_dot(aq, t->ac) / t->d11) : 0;
  if (lod_vec3_distance_squared(aq, lod_vec3_scale(t->ac, s)) <= squared)
    return true;
  struct lod_vec3 bq = lod_vec3_subtract(aq, t->ab);
  s = t->bc_squared > 0 ? lod_target_clamp(lod_vec3_dot(bq, t->bc) / t->bc_squared) : 0;
  return lod_vec3_distance_squared(bq, lod_vec3_scale(t->bc, s)) <= squared;
}

/* Whether q lies within epsilon of the face. Rejecting too much is safe; accepting goes through a point of the face, but for the heights
 * over round faces, whose rounding LOD_TOLERANCE_CERTIFICATE covers. */
static inline bool lod_target_within(const struct lod_target *t, struct lod_vec3 q, double epsilon, double squared) {
  struct lod_vec3 aq = lod_vec3_subtract(q, t->a);
  if (t->round) {
    double height = lod_vec3_dot(t->normal, aq);
    if (height > epsilon || height < -epsilon)
      return false;
    double s0 = lod_vec3_dot(t->inward[0], aq), s1 = lod_vec3_dot(t->inward[1], lod_vec3_subtract(aq, t->ab));
    double s2 = lod_vec3_dot(t->inward[2], aq);
    if (s0 >= 0 && s1 >= 0 && s2 >= 0)
      return true;
    if (s0 < -epsilon || s1 < -epsilon || s2 < -epsilon)
      return false;
    return lod_target_border_within(t, aq, squared);
  }
  double d20 = lod_vec3_dot(aq, t->ab), d21 = lod_vec3_dot(aq, t->ac), denominator = t->d00 * t->d11 - t->d01 * t->d01;
  double v = t->d11 * d20 - t->d01 * d21, w = t->d00 * d21 - t->d01 * d20;
  if (v >= 0 && w >= 0 && v + w <= denominator && denominator > 0) {
    struct lod_vec3 p = lod_vec3_add_scaled(lod_vec3_scale(t->ab, v / denominator), t->ac, w / denominator);
    if (lod_vec3_distance_squared(aq, p) <= squared)
      return true;
  }
  return lod_target_border_within(t, aq, squared);
}

#endif
