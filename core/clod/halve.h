/* The same surface in more patches: edges halved, and the patches at them cut so that no crack opens.
 *
 * Based on: Farin. Curves and Surfaces for Computer Aided Geometric Design. 1993 (restrictions by blossoms): a straight line in the domain
 * of a cubic is a cubic curve, so two, three or four cubics are the patch that they replace, up to rounding. Halves of an edge depend on
 * its own curve alone. */
#ifndef LOD_CORE_CLOD_HALVE_H
#define LOD_CORE_CLOD_HALVE_H

#include "core/clod/evaluate.h"

/* marks: edge_count; edges to halve. roots: patch_count, or NULL: a number of each patch; *new_roots: the same for what was made of it.
 * A patch of which all three edges are halved becomes four. patches needs partners; result has them. LOD_MEMORY, LOD_LIMIT. */
LOD_WARN_UNUSED enum lod_status lod_patches_halve(const struct lod_patches *patches, const bool *marks, const uint32_t *roots,
                                                  struct lod_arena *arena, struct lod_patches *result, uint32_t **new_roots);

/* A copy in `arena` (or the same) in which no two edges have the same two ends and no edge ends where it began: such edges are halved. What
 * names edges by their ends (codec/stream) needs it. LOD_MEMORY, LOD_LIMIT. */
LOD_WARN_UNUSED enum lod_status lod_patches_separate(const struct lod_patches *patches, struct lod_arena *arena,
                                                     struct lod_patches *result);

#endif
