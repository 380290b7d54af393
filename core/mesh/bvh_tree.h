/* The tree behind bvh.h, for the modules that walk it themselves (closest.c, distance.c).
 *
 * Packed and without pointers: slots are primitives in tree order, lane k of node i at level 0 is slot 4i + k, lane k of node i at level l
 * is node 4i + k at level l - 1. A node's place says what is under it, so any node is also a group of 4^(l + 1) neighbouring primitives. */
#ifndef LOD_CORE_MESH_BVH_TREE_H
#define LOD_CORE_MESH_BVH_TREE_H

#include "core/mesh/bvh.h"
#include "core/mesh/triangle_distance.h"

enum { LOD_BVH_WIDTH = 4, LOD_BVH_LEAF = 4, LOD_BVH_LEVELS = 17 };

/* Boxes of four children, one lane each; exact bounds of float corners. An absent child is [INFINITY, -INFINITY]. */
struct lod_bvh_node {
  float min[3][LOD_BVH_WIDTH];
  float max[3][LOD_BVH_WIDTH];
};

struct lod_bvh {
  const struct lod_mesh *mesh; /* not owned */
  uint32_t count;              /* primitives */
  uint32_t level_count;        /* 0 when empty; the root is node 0 of the last level */
  uint32_t node_counts[LOD_BVH_LEVELS];
  struct lod_bvh_node *levels[LOD_BVH_LEVELS];
  uint32_t *order; /* count; slot -> primitive */
};

/* Vertex indices of a primitive as a triple. */
static inline void lod_mesh_primitive(const struct lod_mesh *mesh, uint32_t primitive, uint32_t triple[3]) {
  if (primitive < mesh->triangle_count) {
    for (int k = 0; k < 3; k++)
      triple[k] = mesh->triangles[primitive][k];
    return;
  }
  primitive -= mesh->triangle_count;
  if (primitive < mesh->edge_count) {
    triple[0] = mesh->edges[primitive][0];
    triple[1] = triple[2] = mesh->edges[primitive][1];
  } else {
    triple[0] = triple[1] = triple[2] = mesh->points[primitive - mesh->edge_count];
  }
}

/* The corners of a primitive, and its probe. */
static inline void lod_bvh_corners(const struct lod_bvh *bvh, uint32_t primitive, struct lod_vec3 corners[3]) {
  uint32_t triple[3];
  lod_mesh_primitive(bvh->mesh, primitive, triple);
  for (int k = 0; k < 3; k++)
    corners[k] = lod_vec3_from_float(bvh->mesh->positions[triple[k]]);
}
static inline struct lod_triangle_probe lod_bvh_probe(const struct lod_bvh *bvh, uint32_t primitive) {
  struct lod_vec3 corners[3];
  lod_bvh_corners(bvh, primitive, corners);
  return lod_triangle_prepare(corners[0], corners[1], corners[2]);
}

/* The primitive nearest to q, or the first one met within accept_squared: what a bound needs is often no more. Nothing farther than
 * radius_squared is looked for; hint as lod_bvh_closest. Returns the primitive or LOD_NONE; *distance_squared is its distance. */
uint32_t lod_bvh_search(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared, double accept_squared,
                        double *distance_squared);

#endif
