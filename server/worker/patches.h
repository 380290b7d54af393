/* Curved levels on their way into a store: simplified, coded, decoded again, tessellated. Where core/clod and codec/stream meet. */
#ifndef LOD_SERVER_WORKER_PATCHES_H
#define LOD_SERVER_WORKER_PATCHES_H

#include "core/level/hierarchy.h"

struct lod_curved_settings {
  const uint32_t *patches; /* of each level, any order; NULL = by errors */
  uint32_t patch_count;    /* of `patches` */
  const double *errors;    /* model units, finest first: what each level may be off, coding and tessellation included */
  uint32_t error_count;
  bool search; /* by lod_clod_search, its angle relaxed where it is stuck */
};

/* Shares of the diagonal of the default ladder, finest first; *count of them. */
const double *lod_curved_ladder(uint32_t *count);

/* settings of its build: struct lod_curved_settings; not NULL. Levels have `patches`, and as meshes what a client makes of the decoded
 * patches. */
extern const struct lod_family lod_curved_family;

#endif
