/* The fundamental prism: the space that a triangle sweeps when its corners move along their normals.
 *
 * Based on: Varshney et al. 1995, 4.1 and 4.2. A point of the prism is a point of the offset triangle at its height: corners c + h d. The
 * three sides are the bilinear patches over the edges, planes where the normals at both ends agree; which side of a patch a point lies on
 * is the sign of the weight of the corner opposite to it. */
#ifndef LOD_CORE_ENVELOPE_PRISM_H
#define LOD_CORE_ENVELOPE_PRISM_H

#include <stdbool.h>

#include "core/base/vec.h"

struct lod_prism {
  struct lod_vec3 corner[3];
  struct lod_vec3 normal[3]; /* where the corners go; any length */
};

/* The point of the prism with these weights (they sum to 1) at a height. */
struct lod_vec3 lod_prism_point(const struct lod_prism *prism, const double weights[3], double height);

/* Whether no fiber meets another between heights 0 and `height` (either sign): the Jacobian of lod_prism_point is shown to be positive
 * everywhere. False may be wrong where it is nearly so. up: which way the surface faces at the corners, also where normals are inward or 0.
 */
bool lod_prism_is_valid(const struct lod_prism *prism, double height, const struct lod_vec3 up[3]);

/* The height and weights of p; false when no height between low and high has p in the plane of its offset triangle. A weight is negative
 * when p lies beyond the bilinear patch over the edge opposite to that corner. */
bool lod_prism_locate(const struct lod_prism *prism, struct lod_vec3 p, double low, double high, double *height, double weights[3]);

/* Where segment (p, q) meets the bilinear patch over the edge from a to b, between heights 0 and high; at most two points. Returns how
 * many. */
int lod_bilinear_meets(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 normal_a, struct lod_vec3 normal_b, double high,
                       struct lod_vec3 p, struct lod_vec3 q, struct lod_vec3 at[2]);

#endif
