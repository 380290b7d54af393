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
#include "core/clod/pattern.h"

struct lod_tessellation {
  struct lod_mesh mesh;     /* positions; normals, UVs and colours by wedge; materials, parts */
  uint32_t *patches;        /* triangle_count; patch of each triangle */
  uint32_t *triangle_begin; /* patch_count + 1: triangles of patch p are triangle_begin[p] up to triangle_begin[p + 1] */
  uint32_t *grids;          /* patch_count; m of each patch */
  uint32_t *factors;        /* edge_count */
  double deviation;         /* bound of the distance between the patches and mesh before positions were rounded to float, both ways */
};

struct lod_tessellate_settings {
  double tolerance; /* model units, > 0; what LOD_TESSELLATE_MOST cannot reach is told in `deviation` */
  bool normals;     /* make wedges with normals, and with what UVs and colours the patches have */
  uint32_t threads; /* as lod_parallel_for */
};
struct lod_tessellate_settings lod_tessellate_defaults(void);

/* Cuts edges and insides as `settings` ask and fills `result` in `arena`. Rounding to float is not in `deviation`. Fails with LOD_MEMORY,
 * LOD_LIMIT (more than 2^32 - 2 vertices). */
LOD_WARN_UNUSED enum lod_status lod_tessellate(const struct lod_patches *patches, const struct lod_tessellate_settings *settings,
                                               struct lod_arena *arena, struct lod_tessellation *result, struct lod_problem *problem);

#endif
