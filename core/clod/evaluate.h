/* Points and normals of a patch at all inside vertices of a pattern, four at a time from Bernstein polynomials that the pattern keeps; and
 * of an edge, from the edge alone. The same bits natively and in WebAssembly. */
#ifndef LOD_CORE_CLOD_EVALUATE_H
#define LOD_CORE_CLOD_EVALUATE_H

#include "core/clod/gregory.h"
#include "core/clod/pattern.h"

enum lod_smoothness {
  LOD_SMOOTH_SHADED, /* the cubics; normals at smooth edges are the mean of both patches' */
  LOD_SMOOTH_STRICT, /* gregory.h; for what lod_patches_make_strict has made */
};

/* Float holds what is left of a coordinate after the corner's: relative error by the patch's size, not by the model's. A point lies at most
 * `rounding` from the exact one before it is stored as float. */
struct lod_evaluator {
  struct lod_vec3 corner;
  lod_lanes point[9][3], dv[6][3], dw[6][3];
  double rounding;
};
double lod_evaluator_rounding(const struct lod_bezier *net);
void lod_evaluator_init(struct lod_evaluator *evaluator, const struct lod_bezier *net);

/* positions: count, not NULL; normals: count, unit, zero where there is none, or NULL. count: of inside vertices. */
void lod_evaluate_grid(const struct lod_evaluator *evaluator, const struct lod_grid_basis *grid, uint32_t count, float (*positions)[3],
                       float (*normals)[3]);

/* All inside vertices of patch `patch` on `pattern`, as `smoothness` says. net: the patch's. Zero normals are replaced by the nearest there
 * are. */
void lod_evaluate_inside(const struct lod_patches *patches, uint32_t patch, const struct lod_bezier *net,
                         const struct lod_tessellation_pattern *pattern, const struct lod_grid_basis *grid, enum lod_smoothness smoothness,
                         float (*positions)[3], float (*normals)[3]);

/* The factor - 1 points inside an edge, in its direction. */
void lod_evaluate_edge(const struct lod_patches *patches, uint32_t edge, uint32_t factor, float (*positions)[3]);

/* Normals at these points. users: 3 * patch + side, or LOD_NONE, of the patch that runs along the edge, then of the one against it.
 * normals: of a smooth edge the mean of both, in normals[0]; of a sharp one each user's own (normals[1] may be NULL where there is one
 * user). */
void lod_evaluate_edge_normals(const struct lod_patches *patches, uint32_t edge, const uint32_t users[2], uint32_t factor,
                               enum lod_smoothness smoothness, float (*normals[2])[3]);

/* The normal of corner `corner` of a patch: that of its sector, else the patch's own. Unit. */
struct lod_vec3 lod_evaluate_corner_normal(const struct lod_patches *patches, uint32_t patch, uint32_t corner);

/* The same for edge points in double, for tests and for halving: at t of the edge's direction. */
struct lod_vec3 lod_edge_normal(const struct lod_patches *patches, uint32_t user, bool against, double t, enum lod_smoothness smoothness);

struct lod_bezier_curve lod_patches_edge(const struct lod_patches *patches, uint32_t edge);

#endif
