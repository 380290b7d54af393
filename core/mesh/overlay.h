/* The overlay of two nested levels: a bijection between a coarse surface and a finer one, cut into fragments that are flat on both.
 *
 * Based on: Turk. Re-Tiling Polygonal Surfaces. SIGGRAPH 92, section 6: finer vertices are flattened onto coarse triangles, finer triangles
 * are cut along coarse edges, and moving the fragments' corners on straight lines inflates one level into the other without a jump. Turk
 * records this while he removes vertices. We derive it from the two levels alone, so that a client finds, bit for bit, what a server finds,
 * and interpolation costs no bytes:
 * 1. Every coarse edge becomes a path over the finer surface between the two vertices that its ends are there, the paths around a vertex in
 *    the order of the edges around it, no two crossing (Praun, Sweldens, Schroeder. Consistent Mesh Parameterizations. 2001; paths as
 *    counts of crossings, after Gillespie, Sharp, Crane. Integer Coordinates for Intrinsic Geometry Processing. 2021). Boundaries and
 *    creases run along finer edges.
 * 2. The paths cut the finer surface into one disk for each coarse triangle, which is laid out in that triangle with its rim on the edges
 *    and every inner corner at a weighted mean of its neighbours, which cannot fold (Floater. One-to-one Piecewise Linear Mappings over
 *    Triangulations. 2003).
 * 3. All corners are rounded to integer barycentrics of LOD_OVERLAY_ONE, and each triangle's map is checked in integers: every fragment has
 *    positive area and together they have the area of the triangle, which makes the map a bijection. A triangle that fails says so and
 *    leaves the others as they are.
 *
 * Only + - * / sqrt: the same bits natively and in WebAssembly.
 *
 * Walls with two sides (triangles with the same corners that look either way) are mapped once; the second side has the first one's map,
 * mirrored, and no crossings of its own.
 *
 * Works for any two levels whose coarse vertices are vertices of the finer one: open surfaces, several components, edges of more than two
 * triangles (which cut the surface, adjacency.h). Where topology differs there is no bijection, and the triangles concerned say so. */
#ifndef LOD_CORE_MESH_OVERLAY_H
#define LOD_CORE_MESH_OVERLAY_H

#include "core/mesh/mesh.h"

enum { LOD_OVERLAY_ONE = 1 << 20 };

/* A point of a triangle: weights of its corners, which add up to LOD_OVERLAY_ONE. face LOD_NONE: no point. */
struct lod_overlay_place {
  uint32_t face;
  uint32_t weights[3];
};

enum lod_overlay_state {
  LOD_OVERLAY_MAPPED,   /* the map onto this coarse triangle is a bijection, checked in integers */
  LOD_OVERLAY_UNTRACED, /* one of its edges has no path over the finer surface */
  LOD_OVERLAY_TORN,     /* its paths enclose no disk of the finer surface */
  LOD_OVERLAY_FOLDED,   /* integers are too coarse for its disk: a fragment has no area */
  LOD_OVERLAY_EMPTY,    /* it names a vertex twice, and takes no part */
};

/* A node is a corner of fragments: vertices of the finer level first, under their own numbers, then where finer edges cross coarse edges,
 * and a few points more that keep fragments from having all corners on one line. */
struct lod_overlay {
  uint32_t vertex_count; /* of the finer level */
  uint32_t node_count;
  struct lod_overlay_place *coarse; /* node_count: where each lies on the coarse level. Of a triangle that is not mapped: only near it */
  struct lod_overlay_place *fine;   /* node_count: where each lies on the finer level; LOD_NONE of vertices that no triangle names */

  /* Nodes on each coarse half-edge 3 * t + k, from its start to its end without these: those where finer edges cross it, and finer vertices
   * on it. A half-edge with a lower twin (adjacency.h) has none: they are listed there. */
  uint32_t *crossing_begin; /* 3 * coarse triangles + 1 */
  uint32_t *crossings;      /* nodes */

  /* Fragments, cut into triangles; ordered by coarse triangle, LOD_NONE last. */
  uint32_t triangle_count;
  uint32_t (*triangles)[3]; /* nodes, counter-clockwise on both levels */
  uint32_t *coarse_faces;   /* the coarse triangle that it lies on; LOD_NONE: not known (only beside triangles that are not mapped) */
  uint32_t *fine_faces;     /* the finer triangle that it is a part of */

  uint8_t *states; /* coarse triangle_count; enum lod_overlay_state */
  uint32_t mapped; /* coarse triangles that are LOD_OVERLAY_MAPPED ... */
  uint32_t failed; /* ... and that are neither this nor LOD_OVERLAY_EMPTY */
  uint32_t lost;   /* finer triangles that lie, in whole or in part, on no mapped coarse triangle */
  uint32_t tries;  /* searches for paths, for measurements */
};

struct lod_overlay_settings {
  double crease_cosine; /* an edge whose normals have a smaller cosine is a line to follow; -1 = none. Default cos 40 degrees */
};
struct lod_overlay_settings lod_overlay_defaults(void);

/* coarse, fine: welded; segments and points of theirs take no part. Corners (seams), materials and parts, where both have them, are lines
 * that paths follow where they can.
 * parents: coarse vertex_count; the same vertex in `fine`, each once; LOD_NONE: has none, and triangles there stay unmapped
 * settings: NULL = defaults
 * Results go to `arena`. LOD_BAD_INPUT for wrong parents, LOD_LIMIT over 2^29 triangles, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_overlay_create(const struct lod_mesh *coarse, const struct lod_mesh *fine, const uint32_t *parents,
                                                   const struct lod_overlay_settings *settings, struct lod_arena *arena,
                                                   struct lod_overlay *overlay, struct lod_problem *problem);

/* The same point on another triangle of `mesh` that holds it too (it lies on their common edge or corner). False when it does not. */
bool lod_overlay_on_face(const struct lod_mesh *mesh, const struct lod_overlay_place *place, uint32_t face, int64_t weights[3]);

/* Everything the overlay promises, anew and in integers: on every mapped coarse triangle fragments have positive area and tile it exactly;
 * on every finer triangle they have positive area and tile it exactly; fragments meet along whole sides; coarse vertices lie on
 * themselves. The totals are of twice the areas in units of LOD_OVERLAY_ONE^2 a triangle. */
struct lod_overlay_facts {
  bool valid;
  char reason[120];      /* why not; "" when valid */
  uint64_t coarse_area;  /* sum over mapped triangles, in whole triangles: equals overlay.mapped when valid */
  uint64_t fine_area;    /* sum over finer triangles that do not name a vertex twice, in whole triangles */
  uint32_t bent;         /* nodes that are neither vertices nor crossings */
  uint32_t largest;      /* fragment triangles on one coarse triangle, at most */
  int64_t smallest_area; /* of a fragment on the coarse level, twice, of LOD_OVERLAY_ONE^2 */
};
LOD_WARN_UNUSED enum lod_status lod_overlay_check(const struct lod_overlay *overlay, const struct lod_mesh *coarse,
                                                  const struct lod_mesh *fine, const uint32_t *parents, struct lod_arena *arena,
                                                  struct lod_overlay_facts *facts);

/* A number that is the same exactly when places, crossings and fragments are: to compare machines. */
uint64_t lod_overlay_hash(const struct lod_overlay *overlay);

/* Position of a node on the coarse (t = 0) or the finer level (t = 1). */
struct lod_vec3 lod_overlay_position(const struct lod_mesh *mesh, const struct lod_overlay_place *place);

/* ---- drawing (overlay_draw.c) ---- */

/* What a geomorph draws: triangles whose corners have two positions and two sets of attributes. A corner becomes one vertex for each pair
 * of wedges (coarse, fine) that it is seen through, so seams of either level stay sharp. Position at t: start + t * (end - start). */
struct lod_morph {
  uint32_t vertex_count, triangle_count;
  float (*start)[3];        /* positions on the coarse level */
  float (*end)[3];          /* on the finer one */
  uint32_t (*triangles)[3]; /* vertices */
  uint32_t *fine_faces;     /* triangle_count: the finer triangle each is part of (material, patch); LOD_NONE: of none (lod_overlay_part) */
  uint32_t *coarse_faces;   /* triangle_count: the coarse one, or LOD_NONE */
  float *start_values;      /* vertex_count * values: attributes on the coarse level, or NULL */
  float *end_values;        /* vertex_count * values: on the finer one, or NULL */
  uint8_t *settled;         /* vertex_count: 1 = at its end already, whatever t; NULL but from lod_overlay_part */
};

/* Attributes to interpolate, `values` numbers a wedge (a vertex, for meshes without wedges); NULL: none of that level, 0 is written. */
struct lod_morph_values {
  uint32_t values;
  const float *coarse, *fine;
};

/* Exact: all fragments. With t = 0 the shape is the coarse level where it is mapped, with t = 1 the finer level. */
LOD_WARN_UNUSED enum lod_status lod_overlay_fragments(const struct lod_overlay *overlay, const struct lod_mesh *coarse,
                                                      const struct lod_mesh *fine, const struct lod_morph_values *values,
                                                      struct lod_arena *arena, struct lod_morph *morph);
/* Cheap: the finer level's own triangles with flattened vertices; at t = 0 those that straddle coarse edges cut corners. */
LOD_WARN_UNUSED enum lod_status lod_overlay_vertices(const struct lod_overlay *overlay, const struct lod_mesh *coarse,
                                                     const struct lod_mesh *fine, const struct lod_morph_values *values,
                                                     struct lod_arena *arena, struct lod_morph *morph);

/* Part of it: fragments on the coarse triangles that are mapped, all others as they are, for levels whose finer one has come in part only
 * (codec/stream/units.h). There are no cracks: what lies on an edge or vertex of a coarse triangle that is not mapped stays on the coarse
 * level at any t, and the coarse triangle beside it is cut at the same points.
 * before: coarse triangle_count, or NULL: the states of the overlay drawn before this one; what was fragments then, and not held back by a
 * neighbour, is at its end now (settled). */
LOD_WARN_UNUSED enum lod_status lod_overlay_part(const struct lod_overlay *overlay, const struct lod_mesh *coarse,
                                                 const struct lod_mesh *fine, const struct lod_morph_values *values, const uint8_t *before,
                                                 struct lod_arena *arena, struct lod_morph *morph);

/* Which vertex of `fine` each coarse vertex is, for levels that come without `parents`: the nearest one, when no other coarse vertex is
 * nearer to that. parents: room for coarse->vertex_count; LOD_NONE where there is none within `reach` (model units). */
LOD_WARN_UNUSED enum lod_status lod_overlay_match(const struct lod_mesh *coarse, const struct lod_mesh *fine, double reach,
                                                  struct lod_arena *arena, uint32_t *parents);

#endif
