/* Curved levels of detail: a surface as cubic triangular patches, simplified patch by patch within a certified error.
 *
 * Based on: Gopi, Manocha. A Unified Approach for Simplifying Polygonal and Spline Models. 1998. Polygons become patches one by one (5.1),
 * then vertices are removed: what T, star, 2T, T-in-T and swaps of diagonals do to the patches around a vertex (6) is done at once, in
 * every way that they can be combined. All C-LODs live in one structure (8.1). Where we differ, and why:
 * - Order: a priority queue on the certified error of the result, not a depth-first search for patterns. The paper's search, its inverse
 *   de Casteljau merges and its accumulated estimate are lod_clod_search.
 * - Shape: new edges and centres are fitted by least squares to what they cover; corners' tangent planes are kept.
 * - Error: every patch knows which part of the source lies where in its domain, as triangles of source and domain that correspond one to
 *   one (overlay.c); the control points of the difference bound the distance of corresponding points, so the two-sided distance to the
 *   *source* is bounded and nothing accumulates. Where domain triangles fold the bound still holds: the map is onto.
 * - Lines (boundaries, creases, borders of materials and parts) stay lines: vertices on them are merged along them alone.
 *
 * Bad input: edges of three triangles or of two that run the same way are cut, and stay as they are, straight; triangles that name a vertex
 * twice are left out.
 *
 * UVs and colours are the source's at the corners that stay, linear over each patch (attributes.h); where they jump the surface has a line.
 * How far they are off at corresponding points is known, and counts: a texture may slip by four times what the surface may be off, black
 * for white counts as 2 % of the diagonal. */
#ifndef LOD_CORE_CLOD_CLOD_H
#define LOD_CORE_CLOD_CLOD_H

#include "core/base/parallel.h"
#include "core/clod/patches.h"
#include "core/mesh/model.h"

struct lod_clod;

struct lod_clod_settings {
  double crease_degrees; /* an edge that bends more is a crease; LOD_TOLERANCE_CREASE_DEGREES */
  double corner_degrees; /* a line that turns more has a corner there, and no tangent; 45 */
  double crease_length;  /* creases that add up to less of the diagonal, joined by vertices, count as smooth; 0.1 */
  double centre_weight;  /* of the first guess of a centre against its samples, > 0; 0.02 */
  double curve_weight;   /* of the first guess of an edge's inner points against its samples, > 0; 0.02 */
  bool reparametrize;    /* move domain points to the nearest point of the patch once; true */
};
struct lod_clod_settings lod_clod_defaults(void);

/* The C-Model of `mesh` (welded; not owned, must outlive it): a patch for every triangle. Everything lives in `arena`. LOD_MEMORY,
 * LOD_LIMIT (over 2^28 triangles). */
LOD_WARN_UNUSED enum lod_status lod_clod_create(const struct lod_mesh *mesh, const struct lod_clod_settings *settings,
                                                struct lod_arena *arena, struct lod_clod **clod, struct lod_problem *problem);

/* The C-Model of splines (5.2): a patch for each chart of `charts`, which lie on `mesh` (neither owned), with the charts' own edges and
 * centres fitted to what they cover. Edges are shared where two charts have the same vertices along a side. *suitable false, and no
 * C-Model: a chart has the same vertex at two corners, or sides of neighbours do not match, so that edges would open: take lod_clod_create.
 * LOD_MEMORY, LOD_LIMIT. */
LOD_WARN_UNUSED enum lod_status lod_clod_create_charts(const struct lod_mesh *mesh, const struct lod_charts *charts,
                                                       const struct lod_clod_settings *settings, struct lod_arena *arena,
                                                       struct lod_clod **clod, bool *suitable, struct lod_problem *problem);

/* Removes vertices, least error first, until `patches` are left or every further removal would make a patch of more than `error` (model
 * units; INFINITY = any). May be called again with less patches or more error. LOD_MEMORY, LOD_CANCELLED. */
LOD_WARN_UNUSED enum lod_status lod_clod_simplify(struct lod_clod *clod, uint32_t patches, double error,
                                                  const struct lod_progress *progress);

/* One C-LOD in the paper's own way (6, 7): a depth-first search for patterns of patches, then their merges. A vertex of degree up to 6 may
 * go over a pair of its edges that run on smoothly with 0, 2 or 3 faces on either side: two are a T; three are a 2T or a T-in-T where the
 * vertices that these take with them may go as well, else a T after a swap of diagonals. A vertex of degree 3 is a star. Edges are merged
 * by the inverse of de Casteljau's algorithm, centres too where there is such an inverse, else by lod_bezier_set_centre; nothing is fitted.
 * The certificate is carried along as in lod_clod_simplify, and folds are refused; the paper's own estimate is told beside it. */
struct lod_clod_search_settings {
  double angle_degrees; /* by how much a pair of edges may turn; 20. The paper relaxes it from C-LOD to C-LOD */
  double error;         /* merges that are certified to be off by more are not made; INFINITY = the paper, which does not ask */
  uint32_t patches;     /* stop there */
  bool wide; /* vertices of a degree over 6 too: as many swaps as bring it down to 4, and a T on either side (8.2: "multiple swap diagonal
                operations"), at once; false */
};
struct lod_clod_search_settings lod_clod_search_defaults(void);

struct lod_clod_search_facts {
  uint32_t t, star, two_t, t_in_t; /* patterns found */
  uint32_t swaps;                  /* diagonals swapped so that a T is left */
  uint32_t wide;                   /* vertices of a degree over 6 that are among the removed */
  uint32_t removed, retained;      /* vertices, as tagged */
  uint32_t refused;                /* of those removed: could not be merged as tagged, for folds, edges that exist or the error */
  double estimate;                 /* the paper's (10), accumulated: largest distance of control points when patches are subdivided again,
                                      corners counting more than centres. Not a bound, and blind to swaps */
};
/* LOD_MEMORY, LOD_CANCELLED. When facts->removed less refused is 0 the search is stuck at this angle. */
LOD_WARN_UNUSED enum lod_status lod_clod_search(struct lod_clod *clod, const struct lod_clod_search_settings *settings,
                                                const struct lod_progress *progress, struct lod_clod_search_facts *facts);

/* For a search that is stuck (8.2): curves of edges are moved into planes, corners and tangent planes kept, neighbours alike so that no
 * crack opens, wherever the patches stay within `error` and do not fold. One more C-LOD with as many patches; *moved: edges. LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_clod_straighten(struct lod_clod *clod, double error, uint32_t *moved);

/* Facts of now. error: bound of the two-sided distance to the source, model units. */
struct lod_clod_facts {
  uint32_t patches, vertices, edges;
  uint32_t clod;      /* number of this C-LOD: how many removals were made */
  double error;       /* max over patches */
  uint64_t fragments; /* triangles of source and domain that correspond */
  uint64_t tried;     /* removals evaluated so far */
  size_t
      history_bytes; /* of everything that all C-LODs so far need: corners, edges, patches with the numbers of the C-LODs that have them */
};
void lod_clod_facts(const struct lod_clod *clod, struct lod_clod_facts *facts);

/* C-LOD number `number` (0 = the C-Model, up to facts.clod) with its adjacency, in `arena`. *error (may be NULL): its bound. LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_clod_extract(const struct lod_clod *clod, uint32_t number, struct lod_arena *arena,
                                                 struct lod_patches *patches, double *error);

/* A point of the source and where it lies on a patch: for tests and hints. */
struct lod_clod_sample {
  uint32_t patch; /* as lod_clod_extract(facts.clod) numbers them */
  struct lod_barycentric at;
  uint32_t face; /* source triangle */
  struct lod_vec3 point;
};
/* Corresponding points of now, `per_side`^2 or so for each fragment, told one by one. */
void lod_clod_samples(const struct lod_clod *clod, uint32_t per_side, void (*take)(void *context, const struct lod_clod_sample *sample),
                      void *context);

/* Structure agrees with itself: for assertions and tests. */
bool lod_clod_check(const struct lod_clod *clod);

#endif
