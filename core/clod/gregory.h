/* A patch made smooth across its edges by what it knows already: corners, tangent planes and edge curves stay, the inside bends until the
 * two patches of an edge have one tangent plane all along it. Costs no bytes: whoever draws makes it.
 *
 * Based on: Walton, Meek. A Triangular G1 Patch from Boundary Curves. Computer-Aided Design 28(2), 1996 (the cross-boundary derivative is
 * lambda(t) times the curve's derivative plus mu(t) times a field that only the edge and its ends' normals make); Chiyokura, Kimura 1983
 * and Gregory 1974 (blends of the two inner points that neighbouring edges ask for). Where it differs from the cubic it does by at most 4/9
 * of the farthest that an inner control point was moved, since the inner Bernstein polynomials of degree 4 add up to at most 12/27. */
#ifndef LOD_CORE_CLOD_GREGORY_H
#define LOD_CORE_CLOD_GREGORY_H

#include "core/clod/patches.h"

struct lod_gregory {
  struct lod_vec3 boundary[12]; /* of degree 4: corners A, B, C; then three inside each edge, in its direction */
  struct lod_vec3 inner[3][2];  /* next to corner k: as edge k asks for, as edge k - 1 asks for */
  double deviation;             /* bound of the distance to the cubic, corresponding points compared */
};

/* The patch with number `patch` made smooth across those of its edges that are not sharp. Where a corner has no normal, or an edge ends in
 * its own end, that edge stays as the cubic has it. */
void lod_gregory_make(const struct lod_patches *patches, uint32_t patch, struct lod_gregory *gregory);

/* Point and unit normal (may be NULL; zero where there is none). */
struct lod_vec3 lod_gregory_point(const struct lod_gregory *gregory, struct lod_barycentric at, struct lod_vec3 *normal);

/* What has to be so before patches can be smooth: the ends of edges in the tangent planes of their corners. A copy of `patches` in `arena`
 * (what does not change is shared) whose edges' inner points were turned into these planes, those of sharp edges into both: coarse levels
 * and quantisation leave them a little outside. *deviation (may be NULL): bound of the distance between the cubics of `patches` and the
 * strict surface of the result, corresponding points compared. Needs partners. LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_patches_make_strict(const struct lod_patches *patches, struct lod_arena *arena,
                                                        struct lod_patches *result, double *deviation);

#endif
