/* Varshney's own algorithm: large triangles over the source's vertices that cover many others, chosen greedily.
 *
 * Based on: Varshney, Agarwal, Brooks, Wright, Weber. Generating Levels of Detail for Large-Scale Polygonal Models. 1995, sections 3 to 6.
 *
 * A vertex has a fiber: the line through it along its normal (offset.h). A triangle of three vertices covers another vertex when that
 * one's fiber passes through it. The mesh is complete at every step (6.3): the triangle that covers most vertices of the mesh goes in, the
 * triangles under it go out, and the hole around it is filled, or the next is tried. What no such triangle reaches is then taken vertex by
 * vertex, which alone is the paper's own implementation (section 7).
 *
 * Where we differ, and why:
 * - All "left of", "covers" and "overlaps" are signs of orientations with fibers (predicates.h): no crack or overlap by rounding, no
 *   projection, no linear program (6.2). A vertex on an edge counts as left of it, seen from the edge's lower vertex.
 * - Vertices of a candidate lie within a few edges of one another in the mesh as it stands, and candidates are made anew for the mesh
 *   that is left: not all triples (section 5). Sets are of vertices, not of the O(n^4) faces that all projected segments cut the surface
 *   into, which would make a matrix of O(n^7) entries (6.1).
 * - Every step carries the two-sided certificate against the source (certificate.h), so a cascade does not add up its epsilons (P4-16), and
 *   offset surfaces are optional: without them triangles are kept from crossing by an exact test instead, and a triangle is not kept out of
 *   places where the source comes close to itself. With them (settings.offsets) it is the paper's construction.
 * - Lines (boundaries, feature edges) are opaque (6.5) and themselves simplified within epsilon; edges that the user names stay.
 *
 * For parts of up to some thousands of triangles. Symmetry is not kept (P4-21). */
#ifndef LOD_CORE_ENVELOPE_COVER_H
#define LOD_CORE_ENVELOPE_COVER_H

#include "core/base/parallel.h"
#include "core/envelope/offset.h"

/* ---- what the input must be (3.2) ---- */

struct lod_cover_check {
  uint32_t degenerate_triangles; /* name a vertex twice */
  uint32_t zero_area_triangles;
  uint32_t duplicate_triangles;
  uint32_t non_manifold_edges; /* of more than two triangles */
  uint32_t misoriented_edges;
  uint32_t cut_vertices;        /* bow ties: stay where they are */
  uint32_t crossing_pairs;      /* triangles that interpenetrate */
  uint32_t t_junctions;         /* boundary vertices in the middle of another's boundary edge */
  uint32_t cracks;              /* pairs of boundary edges that lie in the same place but have no vertex in common */
  uint32_t vertices_one_normal; /* the paper's two kinds */
  uint32_t vertices_several_normals;
  uint32_t vertices_hidden; /* no direction looks at the front of all faces: they stay where they are */
};

/* crease_degrees as lod_offset_directions. Returns LOD_BAD_INPUT with a sentence when the cover cannot work on it: degenerate or duplicate
 * triangles, edges of more than two triangles, neighbours that face opposite ways. The rest is a report. */
LOD_WARN_UNUSED enum lod_status lod_cover_validate(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *arena,
                                                   struct lod_cover_check *check, struct lod_problem *problem);

/* ---- the cover ---- */

enum lod_cover_offsets {
  LOD_COVER_NO_OFFSETS,    /* certificate and exact crossing test alone */
  LOD_COVER_APART_OFFSETS, /* between offset surfaces that are shown to be apart */
  LOD_COVER_PAPER_OFFSETS, /* between offset surfaces of the paper's rule */
};

struct lod_cover_settings {
  enum lod_cover_offsets offsets; /* default LOD_COVER_NO_OFFSETS */
  bool vertices_only;             /* remove vertices one by one, no candidate triangles (section 7); default false */
  bool may_cross;                 /* do not test that no new triangle crosses another; default false */
  uint32_t reach;        /* edges between vertices of a candidate; 2 or more; default 2: 3 takes four times as long and saves 1 to 3 % */
  uint32_t rounds;       /* of candidates; default 4 */
  double budget;         /* most tries per triangle of the mesh; default 60 */
  double crease_degrees; /* for vertices' kinds; default 40 */
  const uint8_t *feature_edges;   /* per triangle, bit k: edge from corner k is a line that stays one; or NULL. Not owned */
  const float *vertex_epsilon;    /* vertex_count: share of epsilon there, in [0, 1] (adaptive approximation, 6.5); or NULL. Not owned */
  const uint32_t (*preserved)[2]; /* edges, as pairs of vertices, that stay as they are (6.5); or NULL. Not owned */
  uint32_t preserved_count;
};
struct lod_cover_settings lod_cover_defaults(void);

struct lod_cover_report {
  uint64_t candidates;     /* triangles that cover at least one vertex, of all rounds */
  uint64_t tried;          /* of them and of vertices */
  uint32_t steps;          /* candidates that went in */
  uint32_t removed_singly; /* vertices taken one by one */
  uint32_t largest_set;    /* d: most vertices covered by one candidate */
  double alpha;            /* worst ratio of the largest candidate to the largest that fitted; 1 or more */
  /* triangles / (alpha (1 + lg d)), 6.4: an estimate of what the best choice among these candidates would need at least. */
  double optimum_at_least;
  double thinnest, thickest; /* of the offset surfaces, model units; 0 without them */
};

struct lod_cover;
struct lod_certificate;

/* mesh and bvh (over it) are not owned. Everything lives in `arena`. Fails with LOD_BAD_INPUT as lod_cover_validate does, or where an index
 * of settings.preserved is no vertex. */
LOD_WARN_UNUSED enum lod_status lod_cover_create(const struct lod_mesh *mesh, const struct lod_bvh *bvh,
                                                 const struct lod_cover_settings *settings, struct lod_arena *arena,
                                                 struct lod_cover **cover, struct lod_problem *problem);

/* Begins with another mesh instead of the source: one that `proof` shows to lie within an epsilon of it, such as a result of the certified
 * collapse. Its vertices are those that candidates have, and its lines stay as they are. face_to: face of the proof -> triangle of `start`,
 * LOD_NONE for those that are gone. settings->feature_edges is about `start`; vertex_epsilon still about the source. start and proof are
 * not owned; the proof is needed for this call alone. */
LOD_WARN_UNUSED enum lod_status lod_cover_create_from(const struct lod_mesh *start, const struct lod_mesh *source,
                                                      const struct lod_bvh *source_bvh, const struct lod_certificate *proof,
                                                      const uint32_t *face_to, const struct lod_cover_settings *settings,
                                                      struct lod_arena *arena, struct lod_cover **cover, struct lod_problem *problem);

/* Covers until nothing more fits into epsilon (model units; at least that of the run before: cascade). A run of a fresh cover is direct. */
LOD_WARN_UNUSED enum lod_status lod_cover_run(struct lod_cover *cover, double epsilon, const struct lod_progress *progress);

uint32_t lod_cover_triangle_count(const struct lod_cover *cover);
struct lod_cover_report lod_cover_report(const struct lod_cover *cover);

/* The mesh as it stands: positions, triangles, materials, parts, and the attributes that its vertices have in the source. vertex_of: source
 * vertex -> its vertex, or LOD_NONE; nearby: source triangle -> a triangle that certified a part of it, or LOD_NONE (both caller's, or
 * NULL). */
LOD_WARN_UNUSED enum lod_status lod_cover_extract(const struct lod_cover *cover, struct lod_arena *arena, struct lod_mesh *mesh,
                                                  uint32_t *vertex_of, uint32_t *nearby);

/* Where each vertex that it began with goes (6.5): the triangle that replaces it, LOD_NONE for those that stay, and the point of it that
 * the vertex reaches along its normal; where its normal misses the triangle (beside a boundary), the nearest point. vertex_count each,
 * caller's. */
void lod_cover_replacements(const struct lod_cover *cover, uint32_t *triangle, struct lod_vec3 *target);

#endif
