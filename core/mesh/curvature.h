/* How much a surface bends at its vertices.
 *
 * Based on: Rusinkiewicz. Estimating Curvatures and Their Derivatives on Triangle Meshes. 2004 (a tensor a face from the normals at its
 * corners, averaged at vertices); Turk. Re-Tiling Polygonal Surfaces. 1992, 5.1 (the smallest radius over the edges of a vertex). Turk's
 * radius tan(theta) |P - Q| / 2 is taken as |P - Q| sqrt(1 - c^2) / (2 |c|), c = cos theta, so that an edge that bends the other way does
 * not turn it negative, and curvatures are averaged instead of radii, so that a flat edge does not make it infinite. */
#ifndef LOD_CORE_MESH_CURVATURE_H
#define LOD_CORE_MESH_CURVATURE_H

#include "core/mesh/adjacency.h"

enum lod_curvature_method {
  LOD_CURVATURE_TENSOR,
  LOD_CURVATURE_TURK, /* `largest` alone; principal, directions: NULL */
};

/* All by mesh vertex; a vertex without triangles has 0. */
struct lod_curvature {
  double *largest;        /* largest absolute principal curvature, 1 / model unit */
  double (*principal)[2]; /* the larger in absolute value first; positive where the surface bends away from its normal, as a sphere does */
  struct lod_vec3 *directions; /* unit, of the first */
};

/* Results go to `arena`. Fails with LOD_MEMORY alone.
 *
 * adjacency: of mesh
 * crease_degrees: faces whose normals differ by more lie on other sides of a crease and do not make a vertex curved (tensor only); 180 = no
 *   creases */
LOD_WARN_UNUSED enum lod_status lod_curvature_estimate(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency,
                                                       enum lod_curvature_method method, double crease_degrees, struct lod_arena *arena,
                                                       struct lod_curvature *curvature);

#endif
