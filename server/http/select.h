/* From a query to a level: what the client asked for, and the level that answers it. Pure. */
#ifndef LOD_SERVER_HTTP_SELECT_H
#define LOD_SERVER_HTTP_SELECT_H

#include "core/level/screen.h"
#include "server/http/query.h"
#include "server/store/store.h"

enum { LOD_FAMILY_NAME_MAX = 32 };

struct lod_selection {
  enum lod_rule rule;
  double limit;  /* model units, bytes or triangles, as the rule says */
  bool has_view; /* view is set: a screen error can be told */
  struct lod_view view;
  char family[LOD_FAMILY_NAME_MAX + 1]; /* "" = any */
  uint32_t have;                        /* level of that family that the client has; UINT32_MAX = none */
};

/* Reads exactly one selector:
 *   error=E                                      model units
 *   [px=1] distance=D [fov=60] [height=1080]     pixels, model units, degrees (vertical), pixels; this one when there is none
 *   max_bytes=N | max_triangles=N
 *   rule=cell x=X distance=D [fov=60] [height=1080]    Low & Tan's rule: the largest cell not over X * R
 * and family=auto|NAME, and beside a NAME have=K, the level of it that the client has. Zero, negative, not finite, unknown, given twice,
 * contradictory: LOD_BAD_INPUT naming the parameter. */
LOD_WARN_UNUSED enum lod_status lod_selection_parse(const struct lod_target *target, struct lod_selection *selection,
                                                    struct lod_query_problem *problem);

struct lod_choice {
  const struct lod_stored_family *family;
  const struct lod_stored_level *level;
  bool fits;              /* whether the limit is met */
  double screen_error_px; /* of the chosen level; 0 unless selection->has_view */
};
/* The level of `model` (borrowed from it). LOD_BAD_INPUT naming "family" when the model has no such family; LOD_UNSUPPORTED
 * "no-levels" when it has no level at all; LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_selection_choose(const struct lod_selection *selection, const struct lod_stored_model *model,
                                                     struct lod_choice *choice, struct lod_query_problem *problem);

#endif
