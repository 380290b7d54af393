/* Offset surfaces that do not meet themselves or each other: for each vertex a direction and how far it may go, outwards and inwards.
 *
 * Based on: Varshney et al. 1995, 4.3. Where we differ:
 * - The paper's point of closest approach is a corner of the other triangle or lies on its border. Where a large triangle covers the whole
 *   prism it is neither, so the three fibers at the corners are tried against it as well.
 * - The paper's rule leaves folds between neighbours and says nothing of them. Behind either rule here, thickness is taken back until every
 *   prism is valid (prism.h) and prisms of triangles without a common vertex are shown to be apart. */
#ifndef LOD_CORE_ENVELOPE_OFFSET_H
#define LOD_CORE_ENVELOPE_OFFSET_H

#include "core/mesh/adjacency.h"
#include "core/mesh/bvh.h"

enum lod_offset_rule {
  LOD_OFFSET_APART, /* begins with epsilon, takes back what is shown to be in the way: thicker */
  LOD_OFFSET_PAPER, /* half the way to what a prism of twice epsilon meets (4.3) */
};

struct lod_offset {
  struct lod_vec3 *direction; /* vertex_count; unit; zero where no direction looks at the front of all faces: there thickness is 0 */
  bool *several;              /* vertex_count; it has several normals: a crease runs through it */
  double *outer, *inner;      /* vertex_count; along direction, against it; in [0, epsilon of the vertex] */
};

/* Directions alone: outer and inner are 0. A vertex whose normals in the mesh agree, and look at the front of all its faces, goes along
 * them; else along the direction that is farthest from looking along any of its faces. crease_degrees: faces that differ by more than this
 * make a vertex of several normals. */
LOD_WARN_UNUSED enum lod_status lod_offset_directions(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency,
                                                      double crease_degrees, struct lod_arena *arena, struct lod_offset *offset);

/* The direction that is farthest from looking along any face, of their unit normals (or zero); *cosine is of the angle to the one farthest
 * off. */
struct lod_vec3 lod_offset_central(const struct lod_vec3 *faces, uint32_t count, double *cosine);

/* Thickness, from the directions. epsilon: per vertex. */
LOD_WARN_UNUSED enum lod_status lod_offset_thicken(const struct lod_mesh *mesh, const struct lod_bvh *bvh, enum lod_offset_rule rule,
                                                   const double *epsilon, struct lod_arena *arena, struct lod_offset *offset);

/* The corner of an offset surface over vertex v; side > 0 is outside. */
struct lod_vec3 lod_offset_vertex(const struct lod_mesh *mesh, const struct lod_offset *offset, uint32_t v, int side);

/* Whether a triangle of vertices of `mesh` meets neither offset surface: a candidate triangle (section 5). v[1] == v[2]: the same of an
 * edge. epsilon: at least the largest thickness. */
bool lod_offset_admits(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const struct lod_offset *offset, const uint32_t v[3],
                       double epsilon);

#endif
