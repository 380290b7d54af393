/* Half-edges over any triangle soup: where it is a surface, who lies across an edge; where it is not, it is cut, and the cuts are told.
 *
 * Half-edge 3 * t + k runs along triangle t from its corner k to corner k + 1; corner 3 * t + k is where it starts. Two half-edges are
 * twins when their edge has exactly these two and they run against each other. An edge of one triangle (a boundary), of more than two, or
 * of two that run the same way has no twins: there the surface is cut. What is left around a vertex falls into fans; a vertex of several
 * fans (a bow tie, or a cut that ends there) counts once for each in an algorithm that wants a manifold: fan_vertex welds back.
 *
 * Triangles that name a vertex twice take no part. Nothing is moved or renumbered. */
#ifndef LOD_CORE_MESH_ADJACENCY_H
#define LOD_CORE_MESH_ADJACENCY_H

#include "core/mesh/mesh.h"

struct lod_adjacency {
  uint32_t vertex_count;   /* as the mesh */
  uint32_t triangle_count; /* as the mesh */
  uint32_t edge_count;     /* different pairs of vertices */
  uint32_t fan_count;

  uint32_t *twin;       /* 3 * triangle_count; LOD_NONE where the surface ends or is cut */
  uint32_t *edge_of;    /* 3 * triangle_count; edge number by half-edge; LOD_NONE in degenerate triangles */
  uint32_t *edge_begin; /* edge_count + 1; half-edges of edge e are edge_half_edges[edge_begin[e]] up to edge_begin[e + 1], ascending */
  uint32_t *edge_half_edges;
  uint32_t *vertex_begin;   /* vertex_count + 1; corners at vertex v are vertex_corners[vertex_begin[v]] up to vertex_begin[v + 1] ... */
  uint32_t *vertex_corners; /* ... fan by fan, each counter-clockwise from its open end, or from its lowest corner when it is closed */
  uint32_t *fan_of;         /* 3 * triangle_count; fan number by corner; LOD_NONE in degenerate triangles */
  uint32_t *fan_vertex;     /* fan_count; ascending: fans of one vertex are neighbours */

  /* The report. */
  uint32_t degenerate_triangles; /* name a vertex twice */
  uint32_t boundary_edges;       /* of one triangle */
  uint32_t non_manifold_edges;   /* of more than two */
  uint32_t misoriented_edges;    /* of two that run the same way */
  uint32_t cut_vertices;         /* of more than one fan */
};

/* Results go to `arena`. Edges are numbered by their lower, then their higher vertex. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_adjacency_create(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_adjacency *adjacency);

/* The same without vertices and fans, in half the time. */
LOD_WARN_UNUSED enum lod_status lod_adjacency_create_edges(const struct lod_mesh *mesh, struct lod_arena *arena,
                                                           struct lod_adjacency *adjacency);

/* Twins are mutual and match, every corner is in its vertex's list once, fans follow twins. For assertions. */
bool lod_adjacency_check(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency);

static inline uint32_t lod_half_edge_next(uint32_t h) {
  return h % 3 == 2 ? h - 2 : h + 1;
}
static inline uint32_t lod_half_edge_previous(uint32_t h) {
  return h % 3 == 0 ? h + 2 : h - 1;
}
static inline uint32_t lod_half_edge_start(const struct lod_mesh *mesh, uint32_t h) {
  return mesh->triangles[h / 3][h % 3];
}
static inline uint32_t lod_half_edge_end(const struct lod_mesh *mesh, uint32_t h) {
  return mesh->triangles[h / 3][(h + 1) % 3];
}

/* The corner at the same vertex in the next triangle counter-clockwise (clockwise); LOD_NONE where the fan ends. */
static inline uint32_t lod_corner_left(const struct lod_adjacency *adjacency, uint32_t corner) {
  return adjacency->twin[lod_half_edge_previous(corner)];
}
static inline uint32_t lod_corner_right(const struct lod_adjacency *adjacency, uint32_t corner) {
  uint32_t twin = adjacency->twin[corner];
  return twin == LOD_NONE ? LOD_NONE : lod_half_edge_next(twin);
}

#endif
