/* The tree behind bvh.h, for the modules that walk it themselves (closest.c, distance.c).
 *
 * Primitives are sorted along a Hilbert curve and packed: leaf j holds slots [4j, 4j + 4), lane k of node i at level 0 is leaf 4i + k, lane
 * k of node i at level l is node 4i + k at level l - 1. No pointers: a node's place says what is under it, so any node is also a group of
 * neighbouring primitives. */
#ifndef LOD_CORE_MESH_BVH_TREE_H
#define LOD_CORE_MESH_BVH_TREE_H

#include "core/mesh/bvh.h"
#include "core/mesh/triangle_distance.h"

enum { LOD_BVH_WIDTH = 4, LOD_BVH_LEAF = 4, LOD_BVH_LEVELS = 16 };

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
  uint32_t *order;        /* count; slot -> primitive */
  float (*corners)[3][3]; /* count; by slot */
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

/* Slots under node `index` of `level`. */
static inline void lod_bvh_slots(const struct lod_bvh *bvh, uint32_t level, uint32_t index, uint32_t *begin, uint32_t *end) {
  uint64_t size = (uint64_t)LOD_BVH_LEAF << (2 * (level + 1));
  uint64_t first = index * size;
  *begin = (uint32_t)(first < bvh->count ? first : bvh->count);
  *end = (uint32_t)(first + size < bvh->count ? first + size : bvh->count);
}

/* The probe of a slot, and of a primitive. */
static inline struct lod_triangle_probe lod_bvh_probe_slot(const struct lod_bvh *bvh, uint32_t slot) {
  const float(*c)[3] = bvh->corners[slot];
  return lod_triangle_prepare(lod_vec3_from_float(c[0]), lod_vec3_from_float(c[1]), lod_vec3_from_float(c[2]));
}
static inline struct lod_triangle_probe lod_bvh_probe(const struct lod_bvh *bvh, uint32_t primitive) {
  uint32_t triple[3];
  lod_mesh_primitive(bvh->mesh, primitive, triple);
  return lod_triangle_prepare(lod_vec3_from_float(bvh->mesh->positions[triple[0]]), lod_vec3_from_float(bvh->mesh->positions[triple[1]]),
                              lod_vec3_from_float(bvh->mesh->positions[triple[2]]));
}

/* The primitive nearest to q, or the first one met within accept_squared: what a bound needs is often no more. Nothing farther than
 * radius_squared is looked for; hint as lod_bvh_closest. Returns the primitive or LOD_NONE; *distance_squared is its distance. */
uint32_t lod_bvh_search(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared, double accept_squared,
                        double *distance_squared);

#endif
