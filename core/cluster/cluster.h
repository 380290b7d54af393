/* Floating-cell vertex clustering: works on any polygon soup, O(N) a level after one sort.
 *
 * Vertices are graded by visual importance and sorted once. At a level with cells of a given width the heaviest vertex becomes the
 * centre of a cell, the vertices in it are taken, and so on; every vertex is then replaced by the representative of one cell. A
 * triangle becomes a triangle, an edge or a point; duplicates go, and so does what a surviving primitive of higher dimension covers.
 * What is left as an edge carries the thickness of the part that it stands for.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997; with Rossignac, Borrel 1993 (uniform grid) as a baseline.
 *
 * Where we differ, and why:
 * - Opening cells and assigning vertices are two passes, so that NEAREST is the nearest of all cells and not of those made so far.
 *   The second pass asks for 16 neighbouring vertices at once, which makes it cheaper than the paper's probe a vertex.
 * - Nested levels (not in the paper): levels are opened coarse to fine, each starting from the centres of the coarser one. A coarse
 *   vertex therefore is a fine vertex, while every level still covers every source vertex within its own cell: no bound is relaxed.
 * - cos(theta/2) is sqrt((1 + cos theta) / 2) of the smallest cosine found: no table (section 4) and no acos.
 * - Thick edges are found by sorting the collapsed triangles by edge; the paper's binary trees give the same sets.
 * - A flattened part keeps both of its sides when each has at least a quarter of the other's area, else the larger one alone.
 *
 * Bounds. With the centre as representative |v - image(v)| <= half the cell's diagonal (cube), cell / 2 (sphere), and the cell's
 * diagonal for UNIFORM; a mean or quadric representative is clamped to its cell, which doubles the first two. Since every source
 * triangle's image is in the level and every primitive of the level is an image, max |v - image(v)|, which is what lod_level.bound
 * reports, bounds the two-sided Hausdorff distance.
 *
 * Keys. A group is one material on one connected UV chart. The key of a vertex is the set of the groups of its triangles; only
 * vertices of equal key share a cell, so an inner vertex stays on its chart and a seam vertex stays on its seam, and the centre of a
 * triangle's corner always has a wedge on the triangle's chart. A group whose box is smaller than `separate` cells (2: some two
 * pixels where such a level is shown) drops out of the keys: its seam cannot be seen. "No centre lies in another's cell" and "at most 8
 * centres a grid cell" hold per key. */
#ifndef LOD_CORE_CLUSTER_CLUSTER_H
#define LOD_CORE_CLUSTER_CLUSTER_H

#include "core/level/hierarchy.h"

enum lod_cluster_shape {
  LOD_CLUSTER_CUBE,   /* as wide as the cell */
  LOD_CLUSTER_SPHERE, /* of the cell's width as diameter; up to 64 instead of 8 centres a grid cell */
};
enum lod_cluster_assignment {
  LOD_CLUSTER_HEAVIEST,         /* 3.2: the heaviest of the cells that contain the vertex */
  LOD_CLUSTER_NEAREST_IN_ORDER, /* 3.2.3: the nearest of the cells made so far */
  LOD_CLUSTER_NEAREST,          /* ours: a second pass finds the nearest of all cells */
  LOD_CLUSTER_UNIFORM,          /* Rossignac-Borrel baseline: cells of a fixed grid over the bounding box */
};
enum lod_cluster_representative {
  LOD_CLUSTER_CENTRE,  /* the heaviest vertex itself */
  LOD_CLUSTER_MEAN,    /* of the cell's vertices, weighted by grade, clamped to the cell */
  LOD_CLUSTER_QUADRIC, /* nearest to the planes of the triangles of the cell's vertices (Lindstrom 2000), clamped */
};
enum lod_cluster_grading {
  LOD_CLUSTER_COSINE,        /* 3.1: cos(theta / 2), the probability of lying on the silhouette */
  LOD_CLUSTER_INVERSE_ANGLE, /* Rossignac-Borrel: 1 / theta, which outweighs all else as theta -> 0; for comparison */
};
enum lod_cluster_combination {
  LOD_CLUSTER_PRODUCT, /* angle factor * longest incident edge: does not depend on the rest of the model */
  LOD_CLUSTER_SUM,     /* angle_share * angle factor + (1 - angle_share) * longest incident edge / longest edge of the unit */
};

struct lod_cluster_settings {
  enum lod_cluster_grading grading;
  enum lod_cluster_combination combination;
  double angle_share; /* of SUM, in [0, 1]; 0.5 */
  enum lod_cluster_shape shape;
  enum lod_cluster_assignment assignment;
  enum lod_cluster_representative representative;
  bool nested;            /* coarse centres are fine centres; always false for UNIFORM */
  double ratio;           /* vertices, and so about triangles, of a level over those of the next finer one, in [0.05, 0.9]; 0.5 */
  uint32_t min_triangles; /* about the triangles of the coarsest level, at least 4; 100 */
  const double *cells;    /* widths of the cells in model units, strictly increasing (finest first), instead of the two above; or NULL */
  uint32_t cell_count;    /* at most 64 */
  double separate;        /* a chart or material stays apart while its box's diagonal is at least this many cells; 2. 0 = always */
  uint32_t threads;       /* as lod_parallel_for; results do not depend on it; 0 */
};
/* Sphere, nearest, quadric: of all combinations the least certified error at equal triangle count on the corpus (bench-cluster). The
 * paper's own are cube, heaviest or nearest in order, and centre. */
struct lod_cluster_settings lod_cluster_defaults(void);

/* Graded and sorted units, ready for any number of levels: about 40 bytes a source triangle of a closed mesh; making a level takes some 40
 * more while it lasts. */
struct lod_cluster;

/* Grades, sorts and indexes. `units` (not owned) must outlive the result, which lives in `arena`. settings NULL = defaults; `cells` is not
 * copied. LOD_BAD_INPUT for settings out of range, LOD_LIMIT for a unit over 2^29 triangles or vertices, LOD_MEMORY, LOD_CANCELLED. */
LOD_WARN_UNUSED enum lod_status lod_cluster_create(const struct lod_unit *units, uint32_t unit_count,
                                                   const struct lod_cluster_settings *settings, const struct lod_progress *progress,
                                                   struct lod_arena *arena, struct lod_cluster **cluster, struct lod_problem *problem);

/* One level at one cell width (model units, > 0; raised to 2^-20 of a unit's diagonal where it is less), independent of other levels, so
 * without parents. Everything in `level` belongs to `arena`. Any number of threads may build levels of one cluster, each in its own arena.
 */
LOD_WARN_UNUSED enum lod_status lod_cluster_level(const struct lod_cluster *cluster, double cell, struct lod_arena *arena,
                                                  struct lod_level *level, struct lod_problem *problem);

/* Hands the ladder of levels to `sink`, finest first, as lod_family.build does. A source of fewer than 2 * min_triangles has none. */
LOD_WARN_UNUSED enum lod_status lod_cluster_ladder(const struct lod_cluster *cluster, const struct lod_progress *progress,
                                                   struct lod_arena *arena, lod_level_sink *sink, void *sink_context,
                                                   struct lod_problem *problem);

/* Grades of a unit's vertices, by source index; 0 for a vertex that nothing uses. In `arena`. */
LOD_WARN_UNUSED enum lod_status lod_cluster_weights(const struct lod_cluster *cluster, uint32_t unit, struct lod_arena *arena,
                                                    float **weights);

/* Normal of a thick edge from v1 to v2 for a camera at c, unit length: in the plane of edge and camera, perpendicular to the edge, turned
 * towards the camera: ((v1 - c) x (v2 - c)) x (v2 - v1) (3.3.2; brackets and sign are ours). Zero when camera and edge are in line. Its
 * width in pixels is thickness / lod_screen_units_per_pixel. */
struct lod_vec3 lod_cluster_edge_normal(struct lod_vec3 v1, struct lod_vec3 v2, struct lod_vec3 c);

/* settings of its build: struct lod_cluster_settings. */
extern const struct lod_family lod_cluster_family;

#endif
