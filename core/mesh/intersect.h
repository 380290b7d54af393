/* Whether triangles meet where they should not: decided by exact predicates.
 *
 * Two triangles of a mesh may share a vertex or an edge; they cross when they have any other point in common. A triangle without area is
 * taken as the segment that it is. */
#ifndef LOD_CORE_MESH_INTERSECT_H
#define LOD_CORE_MESH_INTERSECT_H

#include "core/mesh/bvh.h"

/* Corners as doubles that come from floats or are near them (predicates.h), and what tells which corners are shared: equal numbers are the
 * same corner. */
struct lod_corners {
  double point[3][3];
  uint32_t vertex[3];
};

/* Whether the two cross: they have a point in common that is not part of a shared corner or shared edge. Three shared corners cross. */
bool lod_triangles_cross(const struct lod_corners *a, const struct lod_corners *b);

/* Whether segment (p, q) has a point in common with triangle abc, borders included. */
bool lod_segment_meets_triangle(const double p[3], const double q[3], const double a[3], const double b[3], const double c[3]);

struct lod_crossings {
  uint64_t pairs;     /* of crossing triangles */
  uint32_t triangles; /* in at least one pair */
};

/* Counts them in `mesh`, which must be welded. bvh: over `mesh`, or NULL to make one for the while. crossed (triangle_count, caller's):
 * which triangles they are; or NULL. Triangles that name a vertex twice take no part. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_intersect_count(const struct lod_mesh *mesh, const struct lod_bvh *bvh, struct lod_arena *arena,
                                                    bool *crossed, struct lod_crossings *crossings);

#endif
