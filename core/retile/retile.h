/* Re-tiling: well-shaped triangles at any number of vertices, levels whose vertices contain one another, and maps between them.
 *
 * Based on: Turk. Re-Tiling Polygonal Surfaces. SIGGRAPH 92. Points are spread over the source, put into its triangles (the mutual
 * tessellation), and then the source's own vertices are removed one at a time, each replaced by triangles of its neighbours, so that the
 * result has the topology of the source by construction. Levels are placed coarse to fine and built fine to coarse (6.1). Where we differ,
 * and why:
 * - Points come from weighted sample elimination (Yuksel. Sample Elimination for Generating Poisson Disk Sample Sets. 2015) and a few
 *   steps of repulsion that walk over the triangles; Turk's own start (random, then repulsion alone) is LOD_RETILE_TURK.
 * - Features (boundaries, creases, borders of materials and parts, UV seams) are lines: sampled first, in one dimension, merged only along
 *   themselves, never crossed by an edge. Turk states that his method is poor at sharp edges; this is why.
 * - Neighbours of a removed vertex are laid out by its polar map (Lee, Sweldens, Schroeder, Cowsar, Dobkin. MAPS. 1998), which never folds,
 *   instead of being projected onto 14 planes in turn, and triangulated at least cost by dynamic programming with Turk's second check
 * inside, so that another triangulation is found where his method keeps the vertex.
 * - Curvature is the tensor of curvature.h; Turk's radius is LOD_RETILE_CURVATURE_TURK.
 * - Points and maps are integer barycentrics of 2^20: which triangle a point lies in is exact.
 *
 * Bad input: an edge of three triangles, or of two that run the same way, is cut; its vertices stay and are welded back. Triangles that
 * name a vertex twice disappear. Fewer vertices than the topology allows: the least that removal reaches is given.
 *
 * Creases are lines from the coarsest level on whose vertices can afford them; other lines in every level.
 *
 * Fragments (Turk 1992, 6.2) are core/mesh/overlay.h's, which any nested family can use. A level is built such that the overlay maps all
 * of it one to one onto the finer one (`whole_maps`): where it does not, vertices come back, and a surface of more holes than a number of
 * vertices can map keeps more. `flat` is the overlay's, too; without whole_maps it is the record of removal (Turk's way), which may fold:
 * lod_retile_check_map says how many finer triangles lie on one coarse triangle, and how many of these are turned over.
 *
 * The error leads (Turk 1992, 8). Each level gives up a share of its vertices, those that stand out least, and gets as many back where it
 * misses the source by most; flips know the error; the finest level's vertices move over the source to where its triangles want them
 * (lead.c). An error asked for is met by adding vertices until it is proven, both ways (prove.c); where that does not succeed `bound` says
 * so.
 *
 * Turk's own ways are settings: placement, curvature, measure, projection, or all of them at once: lod_retile_turk.
 *
 * The source is cleaned first: of triangles with the same corners one is re-tiled, and where two looked either way, every level gets both
 * sides again; triangles are turned so that neighbours agree where a surface can be oriented.
 *
 * Triangles that would look away from the surface are put off while vertices are removed: where handles and thin parts leave no others, the
 * vertices stay, and the level has more than was asked for (`retained` says how many).
 *
 * Not built: removal of handles (P1-38 removes pieces, with `prune`): a tiny handle keeps a few vertices in every level. A vertex with more
 * than 62 triangles, or on a narrow strip between two lines, may be retained. Points inside non-manifold cuts and along their edges are
 * neither added nor removed, so a soup whose edges are mostly of three triangles and more does not get coarse. An error near the size of
 * the source's own triangles may stay unproven: such a level has up to as many vertices as the source, and `bound` is INFINITY. */
#ifndef LOD_CORE_RETILE_RETILE_H
#define LOD_CORE_RETILE_RETILE_H

#include "core/base/parallel.h"
#include "core/level/hierarchy.h"

enum { LOD_RETILE_ONE = 1 << 20, LOD_RETILE_MAX_LEVELS = 32 };

enum lod_retile_placement {
  LOD_RETILE_ELIMINATION, /* blue noise by elimination, then a few steps of repulsion */
  LOD_RETILE_TURK,        /* area-weighted random, then repulsion alone (Turk 1992, 3.2) */
};

enum lod_retile_curvature {
  LOD_RETILE_CURVATURE_NONE,   /* the same spacing everywhere */
  LOD_RETILE_CURVATURE_TENSOR, /* spacing by the largest principal curvature */
  LOD_RETILE_CURVATURE_TURK,   /* the same with Turk's estimate (5.1) */
};

/* What a hole is filled by, and edges are flipped for. */
enum lod_retile_measure {
  LOD_RETILE_MEASURE_COST, /* least sum of squared sides and of turning away from the old triangles; flips: Delaunay, if the surface allows
                            */
  LOD_RETILE_MEASURE_LENGTH, /* greedy: the shortest edge in space that crosses none (Turk 1992, 4.2, 4.7); flips: the shorter diagonal */
  LOD_RETILE_MEASURE_ANGLE,  /* largest least angle (Turk 1992, 4.7) */
};

/* How the neighbours of a removed vertex are laid out. */
enum lod_retile_projection {
  LOD_RETILE_POLAR,  /* polar map: never folds */
  LOD_RETILE_PLANES, /* the tangent plane, and where its outline crosses itself 13 others; else the vertex stays (Turk 1992, 4.4) */
};

struct lod_retile_settings {
  /* Of each level; one, both or none. Vertices alone (any order): exactly so many. Errors alone (any order; model units): as few vertices
   * as prove it, and no more than the source has. Both (coarsest first): an error of 0 leaves the level to its number; else it begins with
   * that and grows up to twice as many. None: the ladder that follows from the next three. */
  const uint32_t *vertices;
  const double *errors;
  uint32_t level_count; /* of `vertices` and `errors`, at most LOD_RETILE_MAX_LEVELS */
  double ratio;         /* of the vertices of neighbouring levels, > 1; 4 */
  uint32_t least;       /* about the vertices of the coarsest level; 80. The family starts where lines leave half to the surface. */
  double finest_error;  /* the ladder ends near the vertices that this error (share of the diagonal) needs, or the source has; 2e-4 */

  enum lod_retile_placement placement;
  uint32_t steps; /* of repulsion for each level; 25. Turk: 40 */
  double damping; /* share of the radius that a force of 1 moves a point by in a step; 0.25. Turk: 0.15 */
  /* Of repulsion, in units of sqrt(area / points); 1.2: just the nearest neighbours, which spreads points evenly. Turk's 2 makes clumps. */
  double radius;
  uint64_t seed; /* of everything random; 1 */

  enum lod_retile_curvature curvature;
  double adapt; /* spacing differs from the mean by at most this factor, >= 1; 2 */

  double crease_degrees; /* an edge that bends more is a crease; LOD_TOLERANCE_CREASE_DEGREES */
  double corner_degrees; /* a line that turns more has a corner there, which stays; 45 */
  /* Share of each level's vertices that is not spread beforehand but put where the level misses the source by most, in [0, 0.9]; 0.12. */
  double lead;
  /* Pieces of the surface with a bounding box whose diagonal is less than this share of a level's spacing are missing from it, unless the
   * level has an error to meet; 0: never. */
  double prune;
  uint32_t settle; /* sweeps that move the finest level's vertices to better places when its triangles are known; 8 */
  enum lod_retile_measure measure;
  enum lod_retile_projection projection;
  /* Direction of curvature (Turk 1992, 8): normals that differ count as distance, by this many mean spacings for a right angle, so that
   * points lie closer across a bend than along it; 0: not. After Levy, Bonneel. Variational Anisotropic Surface Meshing. 2012. */
  double anisotropy;
  uint32_t flips; /* passes over all edges of a level for better triangles; 4 */
  /* Every coarse triangle of every step is mapped one to one by core/mesh/overlay.h: where one is not, vertices of the finer level come
   * back into the level, and as many go elsewhere; a level of more holes than its number can map keeps more. true. Turk: false. */
  bool whole_maps;
  uint32_t threads; /* as lod_parallel_for; results do not depend on it */
};
struct lod_retile_settings lod_retile_defaults(void);
/* Turk's method as he wrote it: random points, repulsion of 40 steps, his curvature, planes, greedy triangles, two clean-up passes, lines
 * only at borders (and where the source is no surface), no more vertices where the error is. */
struct lod_retile_settings lod_retile_turk(void);

/* A point of a triangle: weights of its corners, which add up to LOD_RETILE_ONE. */
struct lod_retile_point {
  uint32_t face;
  uint32_t weights[3];
};

struct lod_retile_level {
  struct lod_mesh mesh;            /* with attributes sampled from the source, materials and parts */
  uint32_t candidates;             /* vertices placed by us, corners of features among them */
  uint32_t retained;               /* vertices of the source that could not be removed */
  double bound;                    /* proven error of mesh, in its units; INFINITY = none was asked for, or it could not be met */
  double missed;                   /* about its error, by the measure of match that leads: no proof; 0 = nothing led */
  struct lod_retile_point *points; /* vertex_count: where each lies on the source (face = source triangle) */
  uint32_t *parents;               /* vertex_count: the same vertex in the next finer level; of the finest: NULL */
  /* Of each vertex of the next finer level: where it lies on this one (face = triangle of mesh) when it is flattened; finest: NULL. With
   * `prune`: face = LOD_NONE where its piece is missing here. */
  struct lod_retile_point *flat;
};

struct lod_retile {
  uint32_t level_count;
  struct lod_retile_level *levels; /* coarsest first */
};

/* Re-tiles `mesh` (welded; no segments or points of its own are kept). Results live in `arena`. LOD_BAD_INPUT for wrong settings,
 * LOD_CANCELLED, LOD_MEMORY. A mesh without triangles gives levels without triangles. */
LOD_WARN_UNUSED enum lod_status lod_retile_create(const struct lod_mesh *mesh, const struct lod_retile_settings *settings,
                                                  const struct lod_progress *progress, struct lod_arena *arena, struct lod_retile *retile,
                                                  struct lod_problem *problem);

/* Points on `mesh`, in place of spread ones, as the mutual tessellation sees them: every triangle replaced by triangles that tile it
 * exactly, with its points as vertices (Turk 1992, 4.2). Points lie strictly inside triangles or, with one weight 0, on an edge, which both
 * triangles see; equal points are made one. Vertices: those of the mesh, then those of the points. For pictures and tests. */
LOD_WARN_UNUSED enum lod_status lod_retile_tessellate(const struct lod_mesh *mesh, const struct lod_retile_point *points,
                                                      uint32_t point_count, struct lod_arena *arena, struct lod_mesh *tessellation);

/* A step from `level` to the next finer one, checked in integers. */
struct lod_retile_map_facts {
  bool valid;          /* every finer vertex lies on a triangle, weights add up, coarse vertices lie on themselves */
  uint32_t inside;     /* finer triangles whose three corners lie on one coarse triangle ... */
  uint32_t folded;     /* ... of these: turned over when they are flattened */
  uint32_t flattened;  /* ... of these: without area: their corners lie on one coarse edge, and the overlay bends their sides off it */
  uint32_t straddling; /* finer triangles that lie on several coarse ones */
};
LOD_WARN_UNUSED enum lod_status lod_retile_check_map(const struct lod_retile_level *level, const struct lod_retile_level *finer,
                                                     struct lod_arena *arena, struct lod_retile_map_facts *facts);

/* settings of its build: struct lod_retile_settings. Levels have parents, no bound. */
extern const struct lod_family lod_retile_family;

#endif
