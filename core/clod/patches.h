/* One C-LOD by itself: cubic triangular patches that share corners and edge curves. What is coded, sent and tessellated.
 *
 * Based on: Gopi, Manocha. A Unified Approach for Simplifying Polygonal and Spline Models. 1998. Edges are shared: the two patches of an
 * edge have the same boundary curve by construction, so there is no gap to close. */
#ifndef LOD_CORE_CLOD_PATCHES_H
#define LOD_CORE_CLOD_PATCHES_H

#include <stdbool.h>

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/clod/attributes.h"
#include "core/clod/bezier.h"
#include "core/mesh/mesh.h"

struct lod_patches {
  uint32_t vertex_count, edge_count, patch_count, normal_count;
  struct lod_vec3 *positions;  /* vertex_count; corners of patches */
  struct lod_vec3 *normals;    /* normal_count, unit: of tangent planes at corners; a corner on a crease has several */
  uint32_t (*corners)[3];      /* patch_count; vertices, counter-clockwise seen from outside */
  uint32_t (*sectors)[3];      /* patch_count; normal of each corner, or LOD_NONE where there is no tangent plane */
  uint32_t (*edges)[3];        /* patch_count; 2 * edge + (1 when the patch runs against it) of the side from corner k to corner k + 1 */
  uint32_t (*ends)[2];         /* edge_count; vertices of the edge in its own direction; several edges may have the same two */
  struct lod_vec3 (*inner)[2]; /* edge_count; inner control points of its curve, nearer to ends[0] first */
  bool *sharp;                 /* edge_count; normals need not agree across it: a crease, a border, an edge of one patch */
  struct lod_vec3 *centres;    /* patch_count */
  uint32_t (*partners)[3];     /* patch_count; 3 * patch + side across each side, or LOD_NONE; or NULL = not known */
  uint32_t *materials;         /* patch_count, as lod_mesh; or NULL */
  uint32_t *parts;             /* patch_count, as lod_mesh; or NULL */
  struct lod_patch_attributes attributes; /* UVs and colours */
};

/* Gathers the control net of a patch. */
struct lod_bezier lod_patches_net(const struct lod_patches *patches, uint32_t patch);

/* Counts and indices in range, coordinates finite, edges of at most two patches that end where the edge ends. */
bool lod_patches_check(const struct lod_patches *patches, struct lod_problem *problem);

/* Fills partners from edges. Scratch stays in `arena`. LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_patches_find_partners(struct lod_patches *patches, struct lod_arena *arena);

/* Whether normals, UVs or colours jump across an edge; users: 3 * patch + side of the patch along it and of the one against it, or
 * LOD_NONE. */
static inline bool lod_patches_are_split(const struct lod_patches *patches, uint32_t edge, const uint32_t users[2]) {
  return users[0] != LOD_NONE && users[1] != LOD_NONE &&
         (patches->sharp[edge] || lod_patch_attributes_jump(&patches->attributes, users[0] / 3, users[0] % 3, users[1]));
}

/* Box of all control points: the surface lies inside. */
struct lod_bounds lod_patches_bounds(const struct lod_patches *patches);

/* Largest angle, in degrees, between the normals of two patches at the same point of an edge that is not sharp, from `samples` points an
 * edge: how far from G1. Sampled: a figure, not a bound. Points where a patch has no normal are passed over. Needs partners. */
double lod_patches_normal_gap(const struct lod_patches *patches, uint32_t samples);

#endif
