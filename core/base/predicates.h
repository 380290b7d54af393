/* Exact signs of the determinants that topology is decided by.
 *
 * Based on: Shewchuk. Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates. 1997. We have two stages
 * instead of four: the filter decides nearly always, and behind it everything is exact, with zeros dropped, so that coordinates that
 * come from floats (whose differences and products are short) cost little.
 *
 * Exact for finite coordinates whose nonzero magnitudes lie within a factor 2^400 of one another: all floats do, and all doubles of
 * one model do in practice. Scale does not matter: products that would overflow or underflow are scaled by a power of two. */
#ifndef LOD_CORE_BASE_PREDICATES_H
#define LOD_CORE_BASE_PREDICATES_H

/* +1 when a, b, c turn counter-clockwise, -1 when clockwise, 0 when they lie on a line. */
int lod_orient2d(const double a[2], const double b[2], const double c[2]);

/* +1 when d lies on the side of the plane abc from which abc looks counter-clockwise, -1 on the other side, 0 when the four are
 * coplanar: the sign of (b - a) x (c - a) . (d - a). */
int lod_orient3d(const double a[3], const double b[3], const double c[3], const double d[3]);

/* a, b, c counter-clockwise: +1 when d lies inside their circle, -1 when outside, 0 on it. Clockwise: the opposite. */
int lod_incircle(const double a[2], const double b[2], const double c[2], const double d[2]);

#endif
