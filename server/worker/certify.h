/* The certified error of one unit of a level, measured against the source after decoding. */
#ifndef LOD_SERVER_WORKER_CERTIFY_H
#define LOD_SERVER_WORKER_CERTIFY_H

#include "core/mesh/bvh.h"
#include "core/mesh/distance.h"
#include "core/mesh/mesh.h"

struct lod_certify_request {
  const struct lod_mesh *source;
  const struct lod_bvh *source_bvh; /* over source */
  const struct lod_mesh *level;     /* as the family made it */
  const struct lod_mesh *decoded;   /* as a client decodes it */
  const uint32_t *image;            /* source vertex -> level vertex (see lod_level.images), or NULL */
  const uint32_t *nearby;           /* source triangle -> level primitive, or NULL */
  double position_error;            /* how far quantisation may have moved a position, unit space */
  double absolute;                  /* slack that is good enough, unit space */
  uint32_t threads;
  const struct lod_progress *progress;
};

/* The interval of the two-sided Hausdorff distance between source and decoded. Always valid: the family's maps only make it quick, each
 * fact taken from them is checked against the decoded mesh first. */
LOD_WARN_UNUSED enum lod_status lod_certify_unit(const struct lod_certify_request *request, struct lod_arena *arena,
                                                 struct lod_distance *distance);

#endif
