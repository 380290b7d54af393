/* What a bake asks of the family envelope. */
#ifndef LOD_SERVER_WORKER_ENVELOPE_RECIPE_H
#define LOD_SERVER_WORKER_ENVELOPE_RECIPE_H

#include "core/envelope/envelope.h"
#include "server/worker/bake.h"

struct lod_envelope_options {
  struct lod_attribute_bounds attributes; /* but uv */
  double texels;                          /* of the widest picture, that UV may be off by; 0 = slip alone */
  double rms;
  enum lod_guarding guarding;
  bool nested;
};
struct lod_envelope_options lod_envelope_options_defaults(void);

/* Sets what "key=value" says, for `lodestream bake --envelope` and the daemon's `--envelope`: nested=0|1, guard=none|closed|all, and by
 * number texels, slip, degrees, color (0 = no bound), rms (share of epsilon, 0 = none). LOD_BAD_INPUT for anything else. */
LOD_WARN_UNUSED enum lod_status lod_envelope_recipe_option(const char *option, struct lod_envelope_options *options,
                                                           struct lod_problem *problem);

/* From the request's options. errors: error_count errors to meet, model units, increasing, where the request names any; else the ladder.
 * *settings NULL: the levels of the source itself meet the request. In `arena`. UV bounds are in texels until lod_envelope_recipe_fit. */
LOD_WARN_UNUSED enum lod_status lod_envelope_recipe(const struct lod_bake_request *request, const double *errors, uint32_t error_count,
                                                    double diagonal, struct lod_arena *arena, const struct lod_envelope_settings **settings,
                                                    struct lod_problem *problem);

/* The same settings for a model and its wishes (one a unit, or NULL), which must live as long; limits of its vertices become wishes too. */
LOD_WARN_UNUSED enum lod_status lod_envelope_recipe_fit(const struct lod_model *model, const struct lod_envelope_wishes *wishes,
                                                        struct lod_arena *arena, const struct lod_envelope_settings **settings);

/* Whether the request asks for nested levels. */
bool lod_envelope_recipe_nests(const struct lod_bake_request *request);

#endif
