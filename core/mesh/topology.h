/* The facts about a mesh as a surface: what it is made of, where it ends, what is wrong with it. For manifests and reports. */
#ifndef LOD_CORE_MESH_TOPOLOGY_H
#define LOD_CORE_MESH_TOPOLOGY_H

#include "core/mesh/adjacency.h"

/* Triangles that name a vertex twice count in `triangles` and `degenerate_triangles` and take no further part. */
struct lod_topology {
  uint32_t vertices;  /* that a triangle names */
  uint32_t triangles; /* all */
  uint32_t edges;
  uint32_t components;            /* connected through shared vertices */
  uint32_t boundary_edges;        /* of one triangle */
  uint32_t boundary_loops;        /* connected sets of boundary edges: on a manifold each is a loop */
  uint32_t non_manifold_edges;    /* of more than two triangles */
  uint32_t non_manifold_vertices; /* whose triangles do not all hang together by edges at that vertex (bow ties) */
  uint32_t misoriented_edges;     /* whose two triangles run along it the same way */
  uint32_t degenerate_triangles;  /* name a vertex twice */
  uint32_t zero_area_triangles;   /* area at most 1e-12 of the longest side's square; degenerate ones not counted again */
  uint32_t duplicate_triangles;   /* of n with the same three vertices, n - 1 */
  int64_t euler;                  /* vertices - edges + triangles of what takes part */
  int64_t genus;                  /* sum over components; 0 unless has_genus */
  bool has_genus;                 /* manifold and consistently oriented */
  bool manifold;                  /* no non-manifold edge or vertex */
  bool closed;                    /* no boundary edge */
  bool oriented;                  /* consistently: no misoriented or non-manifold edge */
  bool orientable;                /* turning some triangles over would leave no misoriented edge; non-manifold edges are cuts for this */
};

/* `mesh` must be welded for the answers to mean anything. adjacency: of `mesh`, or NULL to make one for the while. Needs some arena for
 * scratch, which is freed before the return. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_topology_measure(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency,
                                                     struct lod_arena *arena, struct lod_topology *topology);

#endif
