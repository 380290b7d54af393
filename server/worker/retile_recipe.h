/* What a bake asks of re-tiling, and what it is told about the answer. */
#ifndef LOD_SERVER_WORKER_RETILE_RECIPE_H
#define LOD_SERVER_WORKER_RETILE_RECIPE_H

#include "core/retile/retile.h"
#include "server/worker/bake.h"
#include "server/worker/levels.h"

/* Sets what "key=value" says, for `lodestream bake --retile`: mode=turk, placement=elimination|turk, curvature=none|tensor|turk,
 * measure=cost|length|angle, projection=polar|planes, and by number adapt, anisotropy, lead, settle, prune, steps, damping, radius, flips,
 * crease, corner, ratio, least, finest (percent of the diagonal), seed. LOD_BAD_INPUT for anything else, which says what was expected. */
LOD_WARN_UNUSED enum lod_status lod_retile_recipe_option(const char *option, struct lod_retile_settings *settings,
                                                         struct lod_problem *problem);

/* errors: error_count errors to meet, model units; used unless the request has numbers of vertices. Made in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_retile_recipe(const struct lod_bake_request *request, const double *errors, uint32_t error_count,
                                                  struct lod_arena *arena, const struct lod_retile_settings **settings,
                                                  struct lod_problem *problem);

/* Adds a warning to the model when fewer vertices were asked for than any of the levels has. */
LOD_WARN_UNUSED enum lod_status lod_retile_recipe_warn(const struct lod_bake_request *request, const struct lod_baked_level *levels,
                                                       uint32_t level_count, struct lod_arena *arena, struct lod_model *model);

#endif
