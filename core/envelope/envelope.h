/* Error-bounded levels: within epsilon of the source, both ways, proven, in as few triangles as possible.
 *
 * Based on: Varshney, Agarwal, Brooks, Wright, Weber. Generating Levels of Detail for Large-Scale Polygonal Models. 1995 (the two-sided
 * epsilon-approximation). Where we differ, and why:
 * - Certified edge collapses instead of a cover by candidate triangles: near-linear in the triangles, and vertices may move.
 * - Every level is certified against the source, not against the level before: epsilons do not add up over the cascade (P4-16). */
#ifndef LOD_CORE_ENVELOPE_ENVELOPE_H
#define LOD_CORE_ENVELOPE_ENVELOPE_H

#include "core/envelope/collapse.h"
#include "core/level/hierarchy.h"

struct lod_envelope_settings {
  const double *epsilons; /* model units, > 0, strictly increasing (finest first); NULL = the ladder of lod_envelope_ladder */
  uint32_t epsilon_count;
  /* Share of each epsilon left to the quantisation that follows, in [0, 0.9]; 0.12. */
  double reserve;
  double least_gain;     /* a level that saves less than this share of the triangles of the one before is left out; 0 = none; 0.1 */
  double crease_degrees; /* an edge across which the source's own normals jump by more is a crease and stays a line; 30 */
  struct lod_collapse_settings collapse;
  uint32_t threads; /* as lod_parallel_for; results do not depend on it */
};
struct lod_envelope_settings lod_envelope_defaults(void);

/* Shares of the diagonal of the default ladder, finest first; *count of them. */
const double *lod_envelope_ladder(uint32_t *count);

/* settings of its build: struct lod_envelope_settings. Levels have `nearby` and a bound, no images. */
extern const struct lod_family lod_envelope_family;

/* Feature bits of lod_surface_create for `mesh`: boundaries, non-manifold edges, borders of materials and parts, UV seams, creases.
 * triangle_count of them in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_envelope_features(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *arena,
                                                      uint8_t **features);

/* Gives `result` (extracted from `collapser`) wedges whose attributes are sampled on the source: for each vertex and each of the sectors
 * that features cut its faces into, at the nearest point of the source triangles charged to that sector. Does nothing when the source has
 * none. */
LOD_WARN_UNUSED enum lod_status lod_envelope_sample_attributes(const struct lod_collapser *collapser, struct lod_arena *arena,
                                                               struct lod_mesh *result);

#endif
