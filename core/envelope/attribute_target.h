/* A face with attributes: whether a point with attributes has a point of it near enough in both.
 *
 * The points (position, attributes) of a face are a triangle in many dimensions, a convex set, and so are those within epsilon and the
 * bounds of one of its points: what holds at the corners of a part of a source triangle holds in all of it, as for positions alone. */
#ifndef LOD_CORE_ENVELOPE_ATTRIBUTE_TARGET_H
#define LOD_CORE_ENVELOPE_ATTRIBUTE_TARGET_H

#include "core/envelope/backward_target.h"
#include "core/envelope/wedges.h"

struct lod_attribute_target {
  double a[LOD_MOST_CHANNELS], ab[LOD_MOST_CHANNELS], ac[LOD_MOST_CHANNELS];
  double inverse_squared; /* of the epsilon that positions are scaled by */
  double g00, g01, g11;   /* products of the edges, positions over epsilon and attributes over their bounds */
};

static inline void lod_attribute_target_make(struct lod_attribute_target *t, const struct lod_wedges *w, const struct lod_target *face,
                                             const double *const value[3], double epsilon) {
  t->inverse_squared = epsilon > 0 ? 1 / (epsilon * epsilon) : 0;
  t->g00 = t->inverse_squared * face->d00;
  t->g01 = t->inverse_squared * face->d01;
  t->g11 = t->inverse_squared * face->d11;
  for (uint32_t c = 0; c < w->channels; c++) {
    t->a[c] = value[0][c];
    t->ab[c] = value[1][c] - value[0][c];
    t->ac[c] = value[2][c] - value[0][c];
    t->g00 += w->weight[c] * t->ab[c] * t->ab[c];
    t->g01 += w->weight[c] * t->ab[c] * t->ac[c];
    t->g11 += w->weight[c] * t->ac[c] * t->ac[c];
  }
}

/* Weights of b and c of the point of a triangle nearest to one whose products with the edges are r0 and r1. */
static inline void lod_nearest_weights(double g00, double g01, double g11, double r0, double r1, double *s, double *t) {
  double det = g00 * g11 - g01 * g01, v = g11 * r0 - g01 * r1, w = g00 * r1 - g01 * r0;
  if (v >= 0 && w >= 0 && v + w <= det && det > 0) {
    *s = v / det;
    *t = w / det;
    return;
  }
  /* The best of the three edges; q(s, t) = s^2 g00 + 2 s t g01 + t^2 g11 - 2 s r0 - 2 t r1. */
  double s0 = g00 > 0 ? lod_target_clamp(r0 / g00) : 0, t1 = g11 > 0 ? lod_target_clamp(r1 / g11) : 0;
  double bc = g00 - 2 * g01 + g11, t2 = bc > 0 ? lod_target_clamp((r1 - r0 + g00 - g01) / bc) : 0, s2 = 1 - t2;
  double q0 = s0 * (s0 * g00 - 2 * r0), q1 = t1 * (t1 * g11 - 2 * r1);
  double q2 = s2 * (s2 * g00 - 2 * r0) + t2 * (t2 * g11 - 2 * r1) + 2 * s2 * t2 * g01;
  *s = q0 <= q1 && q0 <= q2 ? s0 : q1 <= q2 ? 0 : s2;
  *t = q0 <= q1 && q0 <= q2 ? 0 : q1 <= q2 ? t1 : t2;
}

static inline bool lod_attribute_target_shows(const struct lod_attribute_target *t, const struct lod_wedges *w,
                                              const struct lod_target *face, struct lod_vec3 aq, const double *value, double squared,
                                              double u, double v) {
  struct lod_vec3 p = lod_vec3_add_scaled(lod_vec3_scale(face->ab, u), face->ac, v);
  if (lod_vec3_distance_squared(aq, p) > squared)
    return false;
  for (uint32_t g = 0; g < w->group_count; g++) {
    double sum = 0;
    for (uint32_t c = w->groups[g].first; c < w->groups[g].first + w->groups[g].count; c++) {
      double d = t->a[c] + u * t->ab[c] + v * t->ac[c] - value[c];
      sum += d * d;
    }
    if (!(sum <= w->groups[g].bound * w->groups[g].bound))
      return false;
  }
  return true;
}

/* Shown by the point nearest in all dimensions, or by the nearest in space. False may be wrong where another point of the face would do. */
static inline bool lod_attribute_target_within(const struct lod_attribute_target *t, const struct lod_wedges *w,
                                               const struct lod_target *face, struct lod_vec3 q, const double *value, double epsilon) {
  struct lod_vec3 aq = lod_vec3_subtract(q, face->a);
  double p0 = lod_vec3_dot(aq, face->ab), p1 = lod_vec3_dot(aq, face->ac), squared = epsilon * epsilon, u, v;
  double r0 = t->inverse_squared * p0, r1 = t->inverse_squared * p1;
  for (uint32_t c = 0; c < w->channels; c++) {
    r0 += w->weight[c] * t->ab[c] * (value[c] - t->a[c]);
    r1 += w->weight[c] * t->ac[c] * (value[c] - t->a[c]);
  }
  lod_nearest_weights(t->g00, t->g01, t->g11, r0, r1, &u, &v);
  if (lod_attribute_target_shows(t, w, face, aq, value, squared, u, v))
    return true;
  lod_nearest_weights(face->d00, face->d01, face->d11, p0, p1, &u, &v);
  return lod_attribute_target_shows(t, w, face, aq, value, squared, u, v);
}

#endif
