/* Triangles in a patch's domain: a grid stitched to edges that are cut as they please, its bound, and the patterns that were met kept.
 *
 * The inside of a patch is a grid of m * m triangles less its outermost ring, which is stitched to the edges; the edges' factors are their
 * own. Bounds: Filip, Magedson, Markot. Surface Algorithms Using Bounds on Derivatives. 1986, made sharper for each triangle. */
#ifndef LOD_CORE_CLOD_PATTERN_H
#define LOD_CORE_CLOD_PATTERN_H

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/clod/bezier.h"

enum { LOD_TESSELLATE_MOST = 64 }; /* parts of an edge or a grid */

/* Triangles of one patch in its domain. Vertices: 0 to 2 the corners; then those inside edge 0, 1, 2 in the patch's direction (factor - 1
 * each); then the inside ones. The (m - 3)^2 triangles of the grid come first. */
struct lod_tessellation_pattern {
  uint32_t edge_vertices[3]; /* first vertex inside each edge */
  uint32_t inner_vertices;   /* first inside vertex */
  uint32_t vertex_count, triangle_count;
  struct lod_barycentric *domain; /* vertex_count */
  uint32_t (*triangles)[3];
};

/* The pattern of a grid of m (1 to LOD_TESSELLATE_MOST) with these edge factors, in `arena`. m of 1 and 2 have no inside vertices and are
 * used only where no factor exceeds m. */
LOD_WARN_UNUSED enum lod_status lod_tessellation_pattern_make(uint32_t m, const uint32_t factors[3], struct lod_arena *arena,
                                                              struct lod_tessellation_pattern *pattern);

/* An upper bound of |patch - its triangles|, corresponding points compared, over all triangles of the pattern. */
double lod_tessellation_deviation(const struct lod_bezier *patch, const struct lod_tessellation_pattern *pattern);

/* Second derivatives along the three side directions of the domain are linear: their values at the corners. h[s][c]: side s, corner c. */
struct lod_bend {
  struct lod_vec3 h[3][3];
};
struct lod_bend lod_bend_of(const struct lod_bezier *patch);
/* lod_tessellation_deviation over triangles begin up to end. */
double lod_bend_deviation(const struct lod_bend *bend, const struct lod_tessellation_pattern *pattern, uint32_t begin, uint32_t end);

/* The grid for a patch whose edges have these factors: from its own bends, then finer until the stitched ring holds as well.
 * tolerance > 0. m is one of lod_pattern_step. *pattern: number in the cache. *deviation: the bound; above the tolerance only where
 * LOD_TESSELLATE_MOST is not enough. */
struct lod_pattern_cache;
LOD_WARN_UNUSED enum lod_status lod_pattern_choose(struct lod_pattern_cache *cache, const struct lod_bezier *net, const uint32_t factors[3],
                                                   double tolerance, uint32_t *m, uint32_t *pattern, double *deviation);
/* The least number of parts from a short list that is at least `parts`: fewer patterns, fewer changes. LOD_TESSELLATE_MOST at most. */
uint32_t lod_pattern_step(double parts);

/* Bernstein polynomials of four inside vertices of a pattern, for evaluate.h: they depend on m alone. */
typedef float lod_lanes __attribute__((vector_size(16)));
struct lod_grid_basis {
  uint32_t blocks;           /* of four vertices; the last is filled up with the first */
  lod_lanes (*cubic)[9];     /* of control points 1 to 9: those of corner 0 is what the rest leaves */
  lod_lanes (*quadratic)[6]; /* 200, 020, 002, 110, 011, 101 */
};

/* Four triangles of a pattern that are not grid, side by side, for their bounds; the last block is filled up with the first. */
struct lod_ring_basis {
  uint32_t blocks;
  lod_lanes (*at)[3][3];       /* corner, coordinate */
  lod_lanes (*products)[3][3]; /* side from corner e; du dv, dv dw, dw du along it */
};

struct lod_pattern_entry {
  uint32_t m, factors[3];
  struct lod_tessellation_pattern pattern;
  struct lod_ring_basis ring;
  double unit_bounds[8]; /* of what is not grid, by mask of sides: lod_bend_deviation where second derivatives along these are at most 1 */
};

/* Patterns by (m, factors), made when first met. */
struct lod_pattern_cache {
  struct lod_arena *arena;
  struct lod_pattern_entry *entries;
  uint32_t *slots; /* hash -> entry, LOD_NONE = free */
  uint32_t count, capacity, mask;
  struct lod_grid_basis grids[LOD_TESSELLATE_MOST + 1];
};
LOD_WARN_UNUSED enum lod_status lod_pattern_cache_init(struct lod_pattern_cache *cache, struct lod_arena *arena);
LOD_WARN_UNUSED enum lod_status lod_pattern_cache_find(struct lod_pattern_cache *cache, uint32_t m, const uint32_t factors[3],
                                                       uint32_t *found);

#endif
