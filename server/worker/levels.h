/* Levels on their way into a store: encoded, decoded again, certified. */
#ifndef LOD_SERVER_WORKER_LEVELS_H
#define LOD_SERVER_WORKER_LEVELS_H

#include "core/level/hierarchy.h"
#include "core/mesh/bvh.h"
#include "core/mesh/distance.h"
#include "server/worker/output.h"

/* A level's share in one part of the model. */
struct lod_part_figures {
  uint64_t vertices, triangles, edges, points;
  double error; /* bound of the part's unit, model units */
};

/* A step in codec/stream's form, a frame a unit; size 0 = there is none. */
struct lod_baked_delta {
  size_t size;
  char object[LOD_HASH_HEX + 1];
  bool overlaid;     /* the map of the step, between levels as they are decoded, was made and checked ... */
  uint64_t unmapped; /* ... and so many triangles of the coarser level are not mapped one to one */
  /* The same step in patches that can be decoded one by one (codec/stream/units.h), where it is large enough; size 0 = it is not. */
  struct {
    size_t size, first; /* bytes of all; of the index and the frame behind it */
    uint32_t count;
    char object[LOD_HASH_HEX + 1];
  } units;
};

struct lod_baked_level {
  uint64_t vertices, triangles, edges, points; /* as decoded; instances not counted */
  struct lod_interval error;                   /* certified, model units, quantisation and import rounding included */
  double cell;
  bool counted, has_drift; /* as lod_level, and so are the next */
  uint64_t asked, candidates, retained;
  double uv_drift, normal_drift, uv_bound, normal_bound;
  uint8_t *bytes; /* the GLB */
  size_t size;
  char object[LOD_HASH_HEX + 1];  /* set when it is written */
  struct lod_part_figures *parts; /* part_count */
  double position_error;          /* of its quantisation, model units */
  uint32_t made;                  /* place among the levels that the family made, finest first */
  /* The same level as curved patches; size 0 = none. */
  struct {
    const uint8_t *bytes;
    size_t size;
    uint64_t count;
    double error;       /* certified, model units: of what the bytes decode to */
    double color_bound; /* as lod_level_patches */
    char object[LOD_HASH_HEX + 1];
  } patches;
  struct lod_baked_delta delta; /* to the next finer level; of the coarsest also: */
  struct lod_baked_delta first; /* the level itself in the form of a delta */
};

/* What all levels of a model share. */
struct lod_level_baker {
  const struct lod_model *model;
  struct lod_bvh **source_bvhs;  /* unit_count */
  const char *const *image_uris; /* image_count */
  double diagonal;
  uint32_t threads;
  const struct lod_progress *progress;
};

/* Encodes `level` so that quantisation takes at most a quarter of its certified error, or exactly `position_error` where that is > 0 (the
 * source itself, which has no other error). Results live in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_level_bake(const struct lod_level_baker *baker, const struct lod_level *level, double position_error,
                                               struct lod_arena *arena, struct lod_baked_level *baked, struct lod_problem *problem);

/* Orders levels coarsest first and drops every level that another one betters in bytes without more error; of a curved level the patches,
 * where another's better them, and the level with them unless its triangles are worth keeping. Returns how many are left. */
uint32_t lod_levels_order(struct lod_baked_level *levels, uint32_t count);

#endif
