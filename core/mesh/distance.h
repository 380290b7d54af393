/* Certified two-sided Hausdorff distance between two sets of triangles, segments and points: an interval, never a sample.
 *
 * Based on the convexity lemma: the distance to a convex set is convex, so corners within e of one triangle S prove the whole triangle
 * within e of S; what that does not decide is cut and tried again (branch and bound, after Tang, Lee, Kim 2009; see distance.c).
 * Bounds are widened by lod_tolerance_rounding, so rounding never breaks them. */
#ifndef LOD_CORE_MESH_DISTANCE_H
#define LOD_CORE_MESH_DISTANCE_H

#include "core/base/parallel.h"
#include "core/mesh/bvh.h"
#include "core/mesh/mesh.h"

struct lod_interval {
  double lower, upper;
};

struct lod_distance_settings {
  double relative;  /* stop when upper - lower <= relative * lower ... (default LOD_TOLERANCE_DISTANCE_RELATIVE) */
  double absolute;  /* ... or <= absolute, in model units (default 0) */
  uint64_t budget;  /* about the most cuts a side before it stops with a looser, still valid interval; 0 = 20 million and 20 a primitive */
  uint32_t threads; /* as lod_parallel_for; results do not depend on it */
  double known_upper_ab; /* an upper bound of a->b already proven by other means; INFINITY = none */
  double known_upper_ba;
  const uint32_t *hint_ab; /* per primitive of a (numbered as in bvh.h): a primitive of b likely to lie near, or LOD_NONE; or NULL */
  const uint32_t *hint_ba;
  const struct lod_bvh *bvh_a; /* a tree over a, when the caller has one; NULL = built here. Not owned */
  const struct lod_bvh *bvh_b;
  bool larger_side_only; /* certify two_sided alone: the smaller side's interval is valid but may stay loose. Saves most of its time */
  bool rms;              /* also estimate the root mean square distance by sampling */
  const struct lod_progress *progress; /* or NULL */
};
struct lod_distance_settings lod_distance_defaults(void);

struct lod_distance {
  struct lod_interval a_to_b, b_to_a, two_sided;
  double rms;    /* sampled, area weighted, larger of both sides; 0 unless asked for */
  bool complete; /* false: the budget ran out before the tolerance was met */
};

/* Both meshes empty: 0. One empty: [INFINITY, INFINITY]. Fails with LOD_MEMORY or LOD_CANCELLED. */
LOD_WARN_UNUSED enum lod_status lod_distance_measure(const struct lod_mesh *a, const struct lod_mesh *b,
                                                     const struct lod_distance_settings *settings, struct lod_arena *arena,
                                                     struct lod_distance *distance);

#endif
