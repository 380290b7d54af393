/* Cubic triangular Bezier patches: points, de Casteljau, blossoms, splits and their inverses, bounds.
 *
 * Based on: Gopi, Manocha. A Unified Approach for Simplifying Polygonal and Spline Models. 1998, section 4 (splits and inverse splits);
 * Farin. Curves and Surfaces for Computer Aided Geometric Design. 1993 (blossoms); Filip, Magedson, Markot. Surface Algorithms Using
 * Bounds on Derivatives. 1986 (how finely a patch must be cut).
 *
 * A patch has corners A, B, C with barycentric coordinates u, v, w. Control points: 0 to 2 the corners; 3 + 2 k and 4 + 2 k those of edge
 * k (from corner k to corner k + 1), in that direction; 9 the centre:
 *
 *        A                     0
 *       201 210               8 3
 *     102 111 120            7 9 4
 *    C  012  021  B         2 6 5 1
 */
#ifndef LOD_CORE_CLOD_BEZIER_H
#define LOD_CORE_CLOD_BEZIER_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/vec.h"

enum { LOD_BEZIER_POINTS = 10, LOD_BEZIER_CENTRE = 9 };

struct lod_bezier {
  struct lod_vec3 p[LOD_BEZIER_POINTS];
};

/* A cubic curve p[0] .. p[3]. */
struct lod_bezier_curve {
  struct lod_vec3 p[4];
};

/* Barycentric coordinates; u + v + w = 1. */
struct lod_barycentric {
  double u, v, w;
};

/* i, j, k of control point c: the exponents of u, v, w. */
extern const uint8_t lod_bezier_exponents[LOD_BEZIER_POINTS][3];

/* The control point with these exponents (i + j + k = 3). */
uint32_t lod_bezier_index(uint32_t i, uint32_t j, uint32_t k);

/* The ten Bernstein polynomials at `at`. */
void lod_bezier_basis(struct lod_barycentric at, double basis[LOD_BEZIER_POINTS]);

struct lod_vec3 lod_bezier_point(const struct lod_bezier *patch, struct lod_barycentric at);

/* The point and the derivatives in the directions B - A and C - A (in domain coordinates v and w). */
struct lod_vec3 lod_bezier_derivatives(const struct lod_bezier *patch, struct lod_barycentric at, struct lod_vec3 *dv, struct lod_vec3 *dw);

/* Unit normal, pointing to where A, B, C turn counter-clockwise; where the derivatives are parallel (a collapsed edge) it is taken a little
 * inside. Zero when the whole neighbourhood is flat to a line. */
struct lod_vec3 lod_bezier_normal(const struct lod_bezier *patch, struct lod_barycentric at);

/* The polar form at a, b, c: symmetric, affine in each, and the point where all three are equal. */
struct lod_vec3 lod_bezier_blossom(const struct lod_bezier *patch, struct lod_barycentric a, struct lod_barycentric b,
                                   struct lod_barycentric c);

/* The patch over the part of the domain with corners a, b, c (any three points, outside too). */
struct lod_bezier lod_bezier_restrict(const struct lod_bezier *patch, struct lod_barycentric a, struct lod_barycentric b,
                                      struct lod_barycentric c);

/* de Casteljau at `at`: parts[k] has the corner k replaced by the point, so its other corners are the patch's. When one coordinate is 0 the
 * part opposite has no area, and the other two are the two-way split (Gopi & Manocha 1998, 4.2). */
void lod_bezier_split(const struct lod_bezier *patch, struct lod_barycentric at, struct lod_bezier parts[3]);

/* The inverse: parts as lod_bezier_split makes them, put together again. *at: where they were split, from the point and its three
 * neighbours (the barycentric coordinates of 000 in the triangle of 100, 010, 001). Outer points are taken as they are, the centre is the
 * least-squares mean of what each part says. False, and the patch the same with `at` at the centroid, when the neighbours span no
 * triangle. */
bool lod_bezier_merge_star(const struct lod_bezier parts[3], struct lod_bezier *patch, struct lod_barycentric *at);

/* The inverse of a curve's split at t: a, b -> one curve. t from the lengths of the inner legs at the joint, clamped to [0.05, 0.95]. */
struct lod_bezier_curve lod_bezier_merge_curves(const struct lod_bezier_curve *a, const struct lod_bezier_curve *b, double *t);

/* The inverse of a two-way split: a = (A, S, C), b = (S, B, C) -> (A, B, C), S on AB. *t: B's share at S. */
struct lod_bezier lod_bezier_merge_pair(const struct lod_bezier *a, const struct lod_bezier *b, double *t);

struct lod_vec3 lod_bezier_curve_point(const struct lod_bezier_curve *curve, double t);
void lod_bezier_split_curve(const struct lod_bezier_curve *curve, double t, struct lod_bezier_curve *a, struct lod_bezier_curve *b);

/* Edge k in its direction. */
struct lod_bezier_curve lod_bezier_edge(const struct lod_bezier *patch, uint32_t k);

/* The flat triangle as a cubic. */
struct lod_bezier lod_bezier_flat(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c);

/* The inner control point next to corner `near` of an edge to `far`: a third of the way, projected to the tangent plane with this unit
 * normal (Gopi & Manocha 1998, 5.1; the same as PN triangles'), or not at all where the normal is 0 0 0. An edge that leaves the plane more
 * steeply than 1 in 3 or so says that the plane is not to be trusted: then it is moved less. */
struct lod_vec3 lod_bezier_inner_rule(struct lod_vec3 near, struct lod_vec3 normal, struct lod_vec3 far);

/* Sets the centre to the PN triangle's E + (E - V) / 2: right for quadratic patches. */
void lod_bezier_set_centre(struct lod_bezier *patch);

/* The point nearest, in the sense of least squares, to the planes that coplanarity with the neighbours asks for (Gopi & Manocha 1998, 5.1,
 * second pass): for each side k with has[k] the plane through its control points along (inner points' line) x (line of the two centres).
 * net's own centre is the first guess and holds what the planes leave open with weight `regular` (> 0; to 0: the intersection of three
 * planes, or the projection to the line of two or the plane of one). neighbours: centres across the sides. */
struct lod_vec3 lod_bezier_refine_centre(const struct lod_bezier *net, const struct lod_vec3 neighbours[3], const bool has[3],
                                         double regular);

/* Largest distance between a patch restricted to the domain triangle and a flat triangle with the same parameters: an upper bound by the
 * convex hull of the control points of the difference. */
double lod_bezier_bound(const struct lod_bezier *patch, const struct lod_barycentric domain[3], const struct lod_vec3 flat[3]);

/* Least m so that cutting into m parts (curve), or m * m triangles (patch), stays within `tolerance` of what is cut, corresponding points
 * compared; at least 1, at most `most`. */
uint32_t lod_bezier_curve_segments(const struct lod_bezier_curve *curve, double tolerance, uint32_t most);
uint32_t lod_bezier_segments(const struct lod_bezier *patch, double tolerance, uint32_t most);

/* The bound behind lod_bezier_segments: how far a patch cut into m * m triangles may be from it, and a curve cut into m. */
double lod_bezier_deviation(const struct lod_bezier *patch, uint32_t m);
double lod_bezier_curve_deviation(const struct lod_bezier_curve *curve, uint32_t m);

/* A cone that holds all normals of a patch: unit axis and the sine of the half angle, below 1. False: no such cone was found. */
bool lod_bezier_normal_cone(const struct lod_bezier *net, struct lod_vec3 *axis, double *sine);
/* Proof that the patch has a normal everywhere, and so does not fold over itself locally: it was cut into parts, up to three times over,
 * each with such a cone. False: not proven. */
bool lod_bezier_is_regular(const struct lod_bezier *net);

#endif
