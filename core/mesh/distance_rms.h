/* A sampled root mean square distance: a figure for people, never a bound. */
#ifndef LOD_CORE_MESH_DISTANCE_RMS_H
#define LOD_CORE_MESH_DISTANCE_RMS_H

#include "core/mesh/bvh.h"

/* Area-weighted over the triangles of `items` (over its primitives alike, when no triangle has an area), distances to `target`. Both not
 * empty. The same for any number of threads. */
LOD_WARN_UNUSED enum lod_status lod_distance_sample_rms(const struct lod_bvh *items, const struct lod_bvh *target, uint32_t threads,
                                                        struct lod_arena *arena, double *rms);

#endif
