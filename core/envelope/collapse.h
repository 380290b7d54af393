/* Simplification of one mesh within a certified two-sided distance, by edge collapses. Levels of growing epsilon continue from one another,
 * but every certificate is against the source, so errors do not add. */
#ifndef LOD_CORE_ENVELOPE_COLLAPSE_H
#define LOD_CORE_ENVELOPE_COLLAPSE_H

#include "core/base/parallel.h"
#include "core/envelope/wedges.h"
#include "core/mesh/bvh.h"
#include "core/mesh/mesh.h"

struct lod_collapser;

/* Where faces must not newly cross others (guard.h). */
enum lod_guarding {
  LOD_GUARD_NONE,
  LOD_GUARD_CLOSED, /* in components without a boundary */
  LOD_GUARD_ALL,
};

struct lod_collapse_settings {
  bool vertex_subset;   /* vertices of the result are vertices of the source (P4-1); default false: placed freely */
  double flip_degrees;  /* a face may not turn by more than this in one collapse; default 75 */
  double least_quality; /* of new faces, 4 sqrt(3) area / sum of squared edges, unless the old were worse; default 1e-3 */
  uint32_t passes;      /* over all edges, until none of 1 % collapses; default 4 */
  bool draft;           /* begin with collapses that are bounded by maps (draft.c), five times as fast; default true */
  double polish;        /* how much is spent on other places, flips and moves once few faces are left; 0 = nothing, default 1 */
  double rms; /* the root mean square of the distance may take this share of epsilon, around every change, sampled; 0 = nothing asks;
               * default 0. Without draft */
  enum lod_guarding guarding;             /* default LOD_GUARD_CLOSED */
  struct lod_attribute_bounds attributes; /* default: none. With them there is no draft, and corners of lines may merge */
  /* Per source vertex, how far the result may be from the source there at most, linear in between (P4-15); or NULL. Not owned. */
  const double *limits;
  const bool
      *pinned; /* per source vertex, whether it and the feature edges between two such stay as they are (P4-14); or NULL. Not owned */
};
struct lod_collapse_settings lod_collapse_defaults(void);

/* mesh and bvh (over it) are not owned. feature_edges as lod_surface_create. Everything lives in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_collapser_create(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const uint8_t *feature_edges,
                                                     const struct lod_collapse_settings *settings, struct lod_arena *arena,
                                                     struct lod_collapser **collapser);

/* Collapses until nothing more fits into epsilon (model units; at least that of the run before). */
LOD_WARN_UNUSED enum lod_status lod_collapser_run(struct lod_collapser *collapser, double epsilon, const struct lod_progress *progress);

/* The surface as it stands: positions and triangles (and materials, parts). nearby (source triangle_count, caller's): per source triangle a
 * result triangle that certified a part of it, or LOD_NONE. */
LOD_WARN_UNUSED enum lod_status lod_collapser_extract(const struct lod_collapser *collapser, struct lod_arena *arena, struct lod_mesh *mesh,
                                                      uint32_t *nearby);

/* replacements (source vertex_count, caller's): per source vertex the nearest result triangle among those that certify a triangle of it
 * (P4-13), within epsilon; LOD_NONE where no triangle has it. */
LOD_WARN_UNUSED enum lod_status lod_collapser_replacements(const struct lod_collapser *collapser, uint32_t *replacements);

#endif
