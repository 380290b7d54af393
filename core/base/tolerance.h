/* Every tolerance of core that is not an exact predicate, each with its reason. Lengths are relative to the model's diagonal. */
#ifndef LOD_CORE_BASE_TOLERANCE_H
#define LOD_CORE_BASE_TOLERANCE_H

#include <math.h>

/* Bound on the rounding of a computed distance between points whose coordinates are at most `magnitude` in absolute value: a certified
 * bound is widened, and a tested radius narrowed, by this much. 64 u L with u = 2^-53 covers the about 30 roundings of a point-triangle
 * distance in double (each at most u relative to L). */
static inline double lod_tolerance_rounding(double magnitude) {
  return 64 * 0x1p-53 * magnitude;
}

/* Margin, relative to the largest coordinate, by which a certificate of a simplified surface narrows its epsilon: covers distances to
 * planes whose unit normals come from triangles as thin as 0.01 (4 u / 0.01 = 5e-14 of the lengths involved), and corners of pieces cut up
 * to 2000 times. A millionth of the smallest epsilon of use. */
#define LOD_TOLERANCE_CERTIFICATE 0x1p-39

/* Relative to the largest coordinate: what is this near to a plane is coplanar as far as coordinates in float can tell (their rounding is
 * 2^-24 each, and a plane goes through three of them). */
#define LOD_TOLERANCE_COPLANAR 0x1p-22

/* A crease is an edge whose faces' normals differ by more than this (degrees), unless the caller says otherwise (Turk 1992, 2.1.4 of the
 * checklist). */
#define LOD_TOLERANCE_CREASE_DEGREES 40.0

/* Slack that a measured distance interval closes to: upper - lower <= 1 % of lower. */
#define LOD_TOLERANCE_DISTANCE_RELATIVE 0.01
/* ... or this share of the diagonal, whichever is larger: below it levels look alike at any zoom. */
#define LOD_TOLERANCE_DISTANCE_DIAGONAL 1e-6

#endif
