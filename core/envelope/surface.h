/* A triangle surface that edge collapses change: plain arrays, vertex -> face lists, feature flags per face edge. */
#ifndef LOD_CORE_ENVELOPE_SURFACE_H
#define LOD_CORE_ENVELOPE_SURFACE_H

#include "core/mesh/mesh.h"

/* What may happen to a vertex (the order of Dey et al. 1999 for 2-complexes). */
enum lod_vertex_kind {
  LOD_VERTEX_INTERIOR, /* one disc of faces, no feature edge */
  LOD_VERTEX_CURVE,    /* on one feature polyline: exactly two feature edges */
  LOD_VERTEX_JUNCTION, /* where feature lines end or meet, else a disc or half a disc: may merge with another along a line */
  LOD_VERTEX_CORNER,   /* anything else: stays where it is */
};

struct lod_surface {
  uint32_t vertex_count, face_count; /* of the arrays; dead ones included */
  uint32_t live_faces;
  struct lod_vec3 *position;   /* vertex_count; always representable as float */
  uint32_t (*face)[3];         /* face_count; face[f][0] == LOD_NONE: dead */
  uint8_t *feature;            /* face_count; bit k: the edge face[k], face[k + 1] is a feature */
  uint8_t *kind;               /* vertex_count; enum lod_vertex_kind */
  uint32_t *ring, *ring_count; /* vertex_count; where a vertex's faces stand in pool, how many */
  uint32_t *pool;
  size_t pool_used, pool_size;
  struct lod_arena *arena; /* not owned */
};

/* From a mesh of triangles (its free edges and points are not part of it). Degenerate triangles (two equal vertices) are dead from the
 * start. feature_edges: per triangle, bits as `feature`; NULL = boundaries and non-manifold edges only, which are always features. */
LOD_WARN_UNUSED enum lod_status lod_surface_create(const struct lod_mesh *mesh, const uint8_t *feature_edges, struct lod_arena *arena,
                                                   struct lod_surface *surface);

/* Faces of vertex v: surface->pool + surface->ring[v], ring_count[v] of them. */
static inline const uint32_t *lod_surface_ring(const struct lod_surface *surface, uint32_t v) {
  return surface->pool + surface->ring[v];
}

/* Position of v in face f: 0, 1, 2. */
static inline int lod_surface_corner(const struct lod_surface *surface, uint32_t f, uint32_t v) {
  return surface->face[f][0] == v ? 0 : surface->face[f][1] == v ? 1 : 2;
}

/* Whether f and g share an edge that is no feature. */
bool lod_surface_smooth_neighbours(const struct lod_surface *surface, uint32_t f, uint32_t g);

/* The far ends of v's feature edges; at most two are listed, the number of all of them (up to 3) is returned. */
uint32_t lod_surface_feature_ends(const struct lod_surface *surface, uint32_t v, uint32_t ends[2]);

/* Makes corners of all junctions. */
void lod_surface_fix_junctions(struct lod_surface *surface);

/* Whether collapsing edge (a, b) keeps the topology and lets features be; *b_stays: the result must stay at b's place. */
bool lod_surface_can_collapse(const struct lod_surface *surface, uint32_t a, uint32_t b, bool *b_stays);

/* b takes a's faces and moves to `to`; faces on edge (a, b) die. Call only after lod_surface_can_collapse. LOD_MEMORY alone can fail,
 * before anything has changed. */
LOD_WARN_UNUSED enum lod_status lod_surface_collapse(struct lod_surface *surface, uint32_t a, uint32_t b, struct lod_vec3 to);

/* Whether the edge between face f's corners k and k + 1 may turn to join the two apexes: it is no feature, and they are not joined yet. *g:
 * the face on its other side. */
bool lod_surface_can_flip(const struct lod_surface *surface, uint32_t f, int k, uint32_t *g);

/* With f = (a, b, c), a its corner k, and g = (b, a, d): f becomes (a, d, c) and g (d, b, c). Call only after lod_surface_can_flip.
 * LOD_MEMORY alone can fail, before anything has changed. */
LOD_WARN_UNUSED enum lod_status lod_surface_flip(struct lod_surface *surface, uint32_t f, int k, uint32_t g);

/* Every list agrees with every face; for assertions. */
bool lod_surface_check(const struct lod_surface *surface);

#endif
