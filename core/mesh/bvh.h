/* A bounding volume hierarchy over a mesh's triangles, segments and points, for closest-point queries.
 *
 * A primitive is a triple of vertices: triangles first (a, b, c), then free edges (a, b, b), then free points (a, a, a); its id counts
 * in that order. Building is deterministic for any number of threads. Read-only afterwards: any number of threads may query. */
#ifndef LOD_CORE_MESH_BVH_H
#define LOD_CORE_MESH_BVH_H

#include "core/mesh/mesh.h"

struct lod_bvh;

/* Builds over `mesh` (not owned, must outlive the tree) in `arena`. threads as lod_parallel_for. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_bvh_create(const struct lod_mesh *mesh, uint32_t threads, struct lod_arena *arena,
                                               struct lod_bvh **bvh);

struct lod_closest {
  double distance_squared;
  struct lod_vec3 point;
  uint32_t primitive; /* LOD_NONE when nothing lies within the radius */
};

/* The point of the mesh nearest to q. hint: a primitive likely to be near, or LOD_NONE. radius_squared: nothing farther is looked for
 * (INFINITY = everything). Exact up to lod_tolerance_rounding. */
struct lod_closest lod_bvh_closest(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared);

/* Stops at any primitive within the radius: cheaper than the nearest. */
uint32_t lod_bvh_any_within(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared);

/* Calls visit for primitives whose box meets [min, max] until it returns false. */
void lod_bvh_overlap(const struct lod_bvh *bvh, const double min[3], const double max[3], bool (*visit)(void *context, uint32_t primitive),
                     void *context);

/* Nearest point of triangle abc, which may be degenerate, to q. */
struct lod_vec3 lod_closest_on_triangle(struct lod_vec3 q, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c);

#endif
