/* Deltas between the levels of a family whose vertices are nested: coded, decoded again, compared with what the level's GLB decodes to. */
#ifndef LOD_SERVER_WORKER_DELTAS_H
#define LOD_SERVER_WORKER_DELTAS_H

#include "server/worker/levels.h"

struct lod_deltas_request {
  const struct lod_model *model;
  struct lod_baked_level *levels; /* level_count, coarsest first: get their delta and first */
  uint32_t level_count;
  /* What the family made, finest first, by levels[].made; the first source_levels of them are the source itself. Meshes before
   * quantisation; parents lead to the level before. */
  const struct lod_level *made;
  uint32_t source_levels;
  bool maps; /* the family promises flat maps: those of the decoded levels are made, proven and told of (lod_baked_delta.unmapped) */
  int directory_fd;
  const struct lod_progress *progress; /* may be NULL: only asked whether to stop */
};

/* A step that the family's maps do not lead over, or whose meshes the coder does not take (attributes), is left without. A delta that does
 * not decode to exactly its level's GLB is a bug of ours and fails the bake: the level's certified error would not be its own. */
LOD_WARN_UNUSED enum lod_status lod_deltas_bake(const struct lod_deltas_request *request, struct lod_arena *arena,
                                                struct lod_problem *problem);

#endif
