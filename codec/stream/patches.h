/* A C-LOD in few bytes: application/vnd.lodestream.patches.
 *
 * What is coded, in this order: connectivity of the patches, as for deltas; which edges are sharp; materials and parts; corners on a grid,
 * each as its difference from a parallelogram; a normal for each sector (corners that hang together over edges that are not sharp), as its
 * difference from the mean of the flat patches; of each edge the differences of its two inner points from the rule that follows from
 * corners and normals (lod_bezier_inner_rule), in a frame of tangent and normal; of each patch that of its centre from
 * lod_bezier_set_centre. Most differences are 0 or small multiples of the step. Last, where there are any, UVs and colours: which edges
 * they jump across, and for each group of corners between such edges each number, in steps of its own, from a parallelogram.
 *
 * The step bounds what quantisation moves: no control point by more than sqrt(3)/2 steps, so by the convex hull no point of the surface
 * either. codec/FORMAT.md, section 7, describes every byte. Decoding needs integers, + - * / and sqrt alone: the same bits everywhere.
 *
 * Based on: Gopi, Manocha. 1998 (what follows from corners and normals), and connectivity.h, coder.h. */
#ifndef LOD_CODEC_STREAM_PATCHES_H
#define LOD_CODEC_STREAM_PATCHES_H

#include <stddef.h>

#include "core/clod/patches.h"

#define LOD_PATCHES_TYPE "application/vnd.lodestream.patches"

/* Frames without UVs and colours have version 1, others 2. */
enum { LOD_PATCHES_VERSION = 2 };

struct lod_patches_header {
  uint32_t unit, unit_count; /* which of the model's units, of how many */
  uint32_t vertices, patches, components;
  float origin[3], step;
  float error; /* certified bound of the model's two-sided distance to the source that was known when this was written, model units; 0 =
                  not told. The manifest's may be less */
  uint32_t version;
  size_t size; /* of the frame: frames follow one another */
};

struct lod_patches_encode_request {
  const struct lod_patches *patches; /* no patch may have a corner twice */
  uint32_t unit, unit_count;
  double step; /* > 0, units of the patches; made larger where coordinates would need more than 24 bits */
  double error;
  double uv_step; /* of UVs; 0: 2^-12 */
};

/* One frame in `arena`. LOD_BAD_INPUT where patches are not fit; LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_patches_encode(const struct lod_patches_encode_request *request, struct lod_arena *arena,
                                                   uint8_t **bytes, size_t *size, struct lod_problem *problem);

/* Reads a frame's header. LOD_BAD_INPUT, LOD_UNSUPPORTED. */
LOD_WARN_UNUSED enum lod_status lod_patches_inspect(const uint8_t *bytes, size_t size, struct lod_patches_header *header,
                                                    struct lod_problem *problem);

/* Decodes the frame that begins at `bytes` (size may be more) into `arena`, partners included. max_patches: 0 = no limit. LOD_BAD_INPUT,
 * LOD_UNSUPPORTED, LOD_LIMIT, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_patches_decode(const uint8_t *bytes, size_t size, uint32_t max_patches, struct lod_arena *arena,
                                                   struct lod_patches_header *header, struct lod_patches *patches,
                                                   struct lod_problem *problem);

#endif
