/* The better of the certified collapse and of the cover, part by part (algorithms 2.4.4: "choose the smaller result").
 *
 * The collapse places its vertices freely and mostly wins. So the cover first goes on where the collapse has stopped: it takes out vertices
 * that no single collapse can, and never adds a triangle. Small parts are covered from the source as well; where that needs fewer triangles
 * the part is exchanged. Both are certified against the source by the same certificate.
 *
 * Only for units without wedges: attributes of a collapse are sampled for its vertices and measured there. Limits and pinned vertices of
 * the collapse are not known here: the family does not ask where there are any, nor where levels must nest. */
#ifndef LOD_CORE_ENVELOPE_BETTER_H
#define LOD_CORE_ENVELOPE_BETTER_H

#include "core/base/parallel.h"
#include "core/envelope/collapse.h"

struct lod_better_settings {
  uint32_t level_triangles; /* levels of up to this many are gone on with; 0 = none; default 4000 */
  uint32_t part_triangles;  /* connected parts of the source of up to this many are covered from the source; 0 = none; default 300 */
  uint32_t all_triangles;   /* of all such parts together, the first ones; default 3000 */
};
struct lod_better_settings lod_better_defaults(void);

struct lod_better_report {
  uint32_t saved_going_on;  /* triangles */
  uint32_t parts_exchanged; /* and in how many parts the cover was the smaller */
  uint32_t saved_in_parts;
};

/* collapser: has run up to epsilon, and `level` and nearby (source triangle_count) are what lod_collapser_extract has made of it; both are
 * replaced where the cover does better. level lives in `arena`. Nothing else changes. */
LOD_WARN_UNUSED enum lod_status lod_envelope_better(const struct lod_collapser *collapser, double epsilon,
                                                    const struct lod_better_settings *settings, const struct lod_progress *progress,
                                                    struct lod_arena *arena, struct lod_mesh *level, uint32_t *nearby,
                                                    struct lod_better_report *report);

#endif
