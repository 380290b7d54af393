/* Triangles from patches: crack-free, within a tolerance, static or following a view.
 *
 * Based on: Gopi, Manocha. 1998 (section 1, after Kumar, Manocha, Lalwani. Interactive Display of Large Scale NURBS Models. 1995); Filip,
 * Magedson, Markot. Surface Algorithms Using Bounds on Derivatives. 1986. An edge is cut into as many equal parts as its own curve needs,
 * its points are made once and used by both patches: no crack, whatever the patches' own factors are. The inside of a patch is a grid of
 * m * m triangles less its outermost ring, which is stitched to the edges. m is raised until the bound of every stitched triangle holds
 * too.
 *
 * Shared between native code and WebAssembly: plain arrays, no allocation but from the arena, same bits. */
#ifndef LOD_CORE_CLOD_TESSELLATE_H
#define LOD_CORE_CLOD_TESSELLATE_H

#include "core/clod/patches.h"

enum { LOD_TESSELLATE_MOST = 64 }; /* parts of an edge or a grid */

/* Triangles of one patch in its domain. Vertices: 0 to 2 the corners; then those inside edge 0, 1, 2 in the patch's direction (factor - 1
 * each); then the inside ones. */
struct lod_tessellation_pattern {
  uint32_t edge_vertices[3]; /* first vertex inside each edge */
  uint32_t inner_vertices;   /* first inside vertex */
  uint32_t vertex_count, triangle_count;
  struct lod_barycentric *domain; /* vertex_count */
  uint32_t (*triangles)[3];
};

/* The pattern of a grid of m (1 to LOD_TESSELLATE_MOST) with these edge factors, in `arena`. m of 1 and 2 have no inside vertices and are
 * used only where no factor exceeds m. */
LOD_WARN_UNUSED enum lod_status lod_tessellation_pattern_make(uint32_t m, const uint32_t factors[3], struct lod_arena *arena,
                                                              struct lod_tessellation_pattern *pattern);

/* An upper bound of |patch - its triangles|, corresponding points compared, over all triangles of the pattern. */
double lod_tessellation_deviation(const struct lod_bezier *patch, const struct lod_tessellation_pattern *pattern);

struct lod_tessellation {
  struct lod_mesh mesh;     /* positions, normals by wedge, materials, parts */
  uint32_t *patches;        /* triangle_count; patch of each triangle */
  uint32_t *triangle_begin; /* patch_count + 1: triangles of patch p are triangle_begin[p] up to triangle_begin[p + 1] */
  uint32_t *grids;          /* patch_count; m of each patch */
  uint32_t *factors;        /* edge_count */
  double deviation;         /* bound of the distance between the patches and mesh before positions were rounded to float, both ways */
};

struct lod_tessellate_settings {
  double tolerance; /* model units, > 0; what LOD_TESSELLATE_MOST cannot reach is told in `deviation` */
  bool normals;     /* make wedges with normals */
  uint32_t threads; /* as lod_parallel_for */
};
struct lod_tessellate_settings lod_tessellate_defaults(void);

/* Cuts edges and insides as `settings` ask and fills `result` in `arena`. Rounding to float is not in `deviation`. Fails with LOD_MEMORY,
 * LOD_LIMIT (more than 2^32 - 2 vertices). */
LOD_WARN_UNUSED enum lod_status lod_tessellate(const struct lod_patches *patches, const struct lod_tessellate_settings *settings,
                                               struct lod_arena *arena, struct lod_tessellation *result, struct lod_problem *problem);

#endif
