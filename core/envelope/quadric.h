/* Quadric error metric. Based on: Garland, Heckbert. Surface Simplification Using Quadric Error Metrics. 1997. Orders collapses; proves
 * nothing. */
#ifndef LOD_CORE_ENVELOPE_QUADRIC_H
#define LOD_CORE_ENVELOPE_QUADRIC_H

#include <stdbool.h>

#include "core/base/vec.h"

/* p' A p + 2 b' p + c, A symmetric; weight: of the planes in it. */
struct lod_quadric {
  double a00, a01, a02, a11, a12, a22, b0, b1, b2, c;
  double weight;
};

static inline void lod_quadric_add(struct lod_quadric *q, const struct lod_quadric *r) {
  q->a00 += r->a00;
  q->a01 += r->a01;
  q->a02 += r->a02;
  q->a11 += r->a11;
  q->a12 += r->a12;
  q->a22 += r->a22;
  q->b0 += r->b0;
  q->b1 += r->b1;
  q->b2 += r->b2;
  q->c += r->c;
  q->weight += r->weight;
}

/* weight * (squared distance to the plane n.p + d = 0, n unit) */
static inline void lod_quadric_add_plane(struct lod_quadric *q, struct lod_vec3 n, double d, double weight) {
  struct lod_quadric r = {n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z, n.x * d, n.y * d, n.z * d, d * d, 1};
  double *from = &r.a00, *to = &q->a00;
  for (int i = 0; i < 11; i++)
    to[i] += weight * from[i];
}

static inline double lod_quadric_value(const struct lod_quadric *q, struct lod_vec3 p) {
  return q->a00 * p.x * p.x + q->a11 * p.y * p.y + q->a22 * p.z * p.z + 2 * (q->a01 * p.x * p.y + q->a02 * p.x * p.z + q->a12 * p.y * p.z) +
         2 * (q->b0 * p.x + q->b1 * p.y + q->b2 * p.z) + q->c;
}

/* Where the value is least, pulled weakly towards `towards` so that flat and straight regions have an answer. False when singular. */
static inline bool lod_quadric_minimum(const struct lod_quadric *q, struct lod_vec3 towards, struct lod_vec3 *p) {
  double pull = 1e-6 * (q->a00 + q->a11 + q->a22);
  double a00 = q->a00 + pull, a11 = q->a11 + pull, a22 = q->a22 + pull;
  double r0 = pull * towards.x - q->b0, r1 = pull * towards.y - q->b1, r2 = pull * towards.z - q->b2;
  double c00 = a11 * a22 - q->a12 * q->a12, c01 = q->a02 * q->a12 - q->a01 * a22, c02 = q->a01 * q->a12 - q->a02 * a11;
  double det = a00 * c00 + q->a01 * c01 + q->a02 * c02;
  if (!(fabs(det) > 0))
    return false;
  double c11 = a00 * a22 - q->a02 * q->a02, c12 = q->a01 * q->a02 - a00 * q->a12, c22 = a00 * a11 - q->a01 * q->a01;
  *p =
      lod_vec3_make((c00 * r0 + c01 * r1 + c02 * r2) / det, (c01 * r0 + c11 * r1 + c12 * r2) / det, (c02 * r0 + c12 * r1 + c22 * r2) / det);
  return isfinite(p->x) && isfinite(p->y) && isfinite(p->z);
}

#endif
