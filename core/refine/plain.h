/* Subdivision step by step, each step's mesh being the next one's base: the paper's plain rule, and sqrt(3).
 *
 * LOD_STEPWISE_PLAIN: triangles of interest are split in four, their neighbours closed as in the paper's Fig. 1, and closing triangles are
 * ordinary ones for the next step. Vertices of split triangles move by Loop's rules over the present mesh, all others keep their place. To
 * be measured beside refine.h, which is exact where this bends.
 *
 * LOD_STEPWISE_SQRT3: a triangle of interest is split in three at its centroid; an edge between two that were split is turned over, so that
 * no closing triangle is needed. A triangle that still waits for its edge to be turned has its neighbour split instead, so shapes do not
 * degenerate. A vertex moves by (4 - 2 cos(2 pi / n)) / 9 towards its neighbours' mean when all its triangles were split. Sharp edges and
 * seams are not turned, so boundaries keep their polygon (Kobbelt cuts them in three every second step).
 *
 * Based on: Isenberg, Hartmann, Koenig. Interest Value Driven Adaptive Subdivision. 2003, section 3; Amresh, Farin. Adaptive Subdivision
 * Schemes for Triangular Meshes. 2002; Kobbelt. Sqrt(3) Subdivision. 2000. */
#ifndef LOD_CORE_REFINE_PLAIN_H
#define LOD_CORE_REFINE_PLAIN_H

#include "core/refine/doi.h"

enum lod_stepwise { LOD_STEPWISE_PLAIN, LOD_STEPWISE_SQRT3 };

/* limits: steps, max_triangles and max_bytes count; steps of sqrt(3) triple. doi: CONTACT and ATTRIBUTE have no meaning on meshes that
 * change. mesh: in `arena`, with limit normals and the base's other attributes, linear in each step. *budget (may be NULL): a limit was
 * met. LOD_UNSUPPORTED "stepwise-interest", LOD_LIMIT "refine-size", LOD_CANCELLED, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_refine_stepwise(const struct lod_mesh *base, const struct lod_refine_settings *settings,
                                                    enum lod_stepwise scheme, const struct lod_doi *doi,
                                                    const struct lod_refine_limits *limits, const struct lod_progress *progress,
                                                    struct lod_arena *arena, struct lod_mesh *mesh, bool *budget,
                                                    struct lod_problem *problem);

#endif
