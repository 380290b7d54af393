/* Connectivity of a manifold mesh: a front grows over it a triangle at a time, and each triangle's third vertex is coded as new, or as a
 * neighbour on the front, or as another vertex of it.
 *
 * Based on: Gumhold, Strasser. Real Time Compression of Triangle Mesh Connectivity. SIGGRAPH 98 (the operations); Alliez, Desbrun.
 * Valence-Driven Connectivity Encoding for 3D Meshes. 2001 (the next edge is one whose vertices are nearly closed). Each operation is coded
 * with the numbers of triangles that the vertices around already have: what a valence coder codes, without its separate list. */
#ifndef LOD_CODEC_STREAM_CONNECTIVITY_H
#define LOD_CODEC_STREAM_CONNECTIVITY_H

#include "codec/stream/coder.h"
#include "core/mesh/mesh.h"

/* Half-edge 3 t + i of triangle t goes from its corner i to its corner (i + 1) % 3. */
static inline uint32_t lod_half_edge_next(uint32_t h) {
  return h % 3 == 2 ? h - 2 : h + 1;
}
static inline uint32_t lod_half_edge_previous(uint32_t h) {
  return h % 3 == 0 ? h + 2 : h - 1;
}

/* A mesh cut until it is an oriented manifold with boundary: at edges with more than two triangles, where those that run opposite ways stay
 * together in pairs and the rest is cut off, and at vertices with several fans. */
struct lod_cut {
  uint32_t triangle_count, vertex_count; /* vertex_count: of the cut mesh, each copy one */
  const uint32_t (*triangles)[3];        /* as given */
  uint32_t *opposite;                    /* half-edge -> the one glued to it, or LOD_NONE */
  uint32_t *corner;                      /* 3 t + i -> vertex of the cut mesh */
  uint32_t *uncut;                       /* vertex of the cut mesh -> vertex */
  uint32_t component_count;
};

/* No triangle may have a vertex twice. LOD_MEMORY only. */
LOD_WARN_UNUSED enum lod_status lod_cut_create(const uint32_t (*triangles)[3], uint32_t triangle_count, uint32_t vertex_count,
                                               struct lod_arena *arena, struct lod_cut *cut);

/* The cut mesh in the order of the stream. */
struct lod_connectivity {
  uint32_t triangle_count, vertex_count;
  uint32_t (*triangles)[3];
  uint32_t *opposite;  /* as in lod_cut; a triangle's half-edge 3 t is the one it was reached over, or a component begins there */
  uint32_t *component; /* vertex -> connected component, counted from 0 */
  uint32_t component_count;
  /* Encoding only: */
  uint32_t *source_vertices;   /* vertex -> vertex of the cut mesh */
  uint32_t *source_half_edges; /* triangle -> half-edge of the cut mesh that is its half-edge 3 t */
};

/* Encodes `cut`, or, when the coder decodes and cut is NULL, decodes triangle_count triangles in at most max_components components with at
 * most max_vertices vertices. starts:
 * vertices of the cut mesh at which components should begin, in this order (start_count; others follow). Fails with LOD_BAD_INPUT,
 * LOD_MEMORY.
 */
LOD_WARN_UNUSED enum lod_status lod_connectivity_code(struct lod_coder *coder, const struct lod_cut *cut, const uint32_t *starts,
                                                      uint32_t start_count, uint32_t triangle_count, uint32_t max_vertices,
                                                      uint32_t max_components, struct lod_arena *arena,
                                                      struct lod_connectivity *connectivity, struct lod_problem *problem);

#endif
