/* Error-bounded levels: within epsilon of the source, both ways, proven, in as few triangles as possible.
 *
 * Based on: Varshney, Agarwal, Brooks, Wright, Weber. Generating Levels of Detail for Large-Scale Polygonal Models. 1995 (the two-sided
 * epsilon-approximation). Where we differ, and why:
 * - Certified edge collapses instead of a cover by candidate triangles: near-linear in the triangles, and vertices may move.
 * - Every level is certified against the source, not against the level before: epsilons do not add up over the cascade (P4-16).
 * - Lines (boundaries, seams, creases, borders of materials) are certified against the source's lines as well (curves.h; P4-14).
 *
 * The candidate cover itself, with its reported bound, is cover.h; better.h takes the better of both.
 * - No face newly crosses another (guard.h) in components without boundary, or everywhere when asked; instead of offsets that keep apart.
 *
 * What topology cannot promise: non-manifold edges and vertices stay where they are, so a surface made of them keeps them; quantisation,
 * which comes after, may let faces cross that come closer than its step. */
#ifndef LOD_CORE_ENVELOPE_ENVELOPE_H
#define LOD_CORE_ENVELOPE_ENVELOPE_H

#include "core/envelope/better.h"
#include "core/envelope/collapse.h"
#include "core/level/hierarchy.h"

/* How far attributes of a level are from the source's, in two ways.
 * - Bounds, proven with the positions (attribute_target.h): every point of the source has a point of the level on its side of seams and
 *   creases within epsilon whose attributes differ by no more. Before quantisation.
 * - Drift, sampled: the largest difference found at corners and centres of all triangles of both meshes, each against the point of the
 * other that fits best. A figure, not a bound, but it looks both ways. */
struct lod_envelope_report {
  double epsilon; /* of the level, as certified before quantisation; 0 = the level was left out */
  uint64_t triangles;
  double uv[LOD_UV_SETS]; /* units of UV: times the texture's width it is texels */
  double normal_degrees;
  double uv_bound[LOD_UV_SETS], normal_bound; /* INFINITY = none, 0 = no such attribute */
};

/* What the user asks of one unit. */
struct lod_envelope_wishes {
  const double *limits;       /* per vertex: the most that the result may be from the source there, in the unit's own measure, linear in
                               * between (P4-15); INFINITY = epsilon; or NULL */
  const uint32_t (*edges)[2]; /* edge_count: vertices of edges of the mesh that stay as they are (P4-14); or NULL */
  uint32_t edge_count;
};

struct lod_envelope_settings {
  /* Model units, strictly increasing (finest first); NULL = the ladder of lod_envelope_ladder. A first of 0 asks for what is coplanar as
   * far as floats can tell: its bound is LOD_TOLERANCE_COPLANAR times the largest coordinate. */
  const double *epsilons;
  uint32_t epsilon_count;
  /* Share of each epsilon left to the quantisation that follows, in [0, 0.9]; 0.12. */
  double reserve;
  double least_gain;     /* a level that saves less than this share of the triangles of the one before is left out; 0 = none; 0.1 */
  double crease_degrees; /* an edge across which the source's own normals jump by more is a crease and stays a line; 30 */
  struct lod_collapse_settings collapse;    /* with attributes bounded: slip 1, normals 60 degrees, colours 0.25 */
  struct lod_better_settings better;        /* where the cover (cover.h) goes on, or does better; not with vertex_subset or wishes */
  const struct lod_envelope_wishes *wishes; /* one a unit; or NULL */
  struct lod_envelope_report *reports;      /* one an epsilon, caller's; or NULL */
  uint32_t threads;                         /* as lod_parallel_for; results do not depend on it */
};
struct lod_envelope_settings lod_envelope_defaults(void);

/* Shares of the diagonal of the default ladder, finest first; *count of them. */
const double *lod_envelope_ladder(uint32_t *count);

/* settings of its build: struct lod_envelope_settings. Levels have `nearby`, `replacements` and a bound, no images. With
 * collapse.vertex_subset they are nested and have `parents`. */
extern const struct lod_family lod_envelope_family;

/* Feature bits of lod_surface_create for `mesh`: boundaries, non-manifold edges, borders of materials and parts, UV seams, creases.
 * triangle_count of them in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_envelope_features(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *arena,
                                                      uint8_t **features);

/* Gives `result` (extracted from `collapser`) the collapser's wedges. Does nothing when the source has none. */
LOD_WARN_UNUSED enum lod_status lod_envelope_extract_attributes(const struct lod_collapser *collapser, struct lod_arena *arena,
                                                                struct lod_mesh *result);

/* Worsens the drift of `report` by that of the surface as it stands, and sets the bounds. */
LOD_WARN_UNUSED enum lod_status lod_envelope_measure_attributes(const struct lod_collapser *collapser, struct lod_arena *scratch_parent,
                                                                struct lod_envelope_report *report);

#endif
