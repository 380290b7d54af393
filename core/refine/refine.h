/* Subdivision where it matters and nowhere else: a mesh, a degree of interest, and a finer mesh that is finest where the interest is.
 *
 * A refiner holds a forest of triangles over a base mesh. Each triangle of level k may be split into four of level k + 1 by Loop's rules.
 * What is drawn is a cut through the forest: leaves whose levels differ by at most one across an edge, and where a neighbour is finer the
 * leaf is closed by green triangles (none is ever subdivided further). Positions come from the rules on the full neighbourhood, whether it
 * is drawn or not, so a refined area equals uniform subdivision there bit for bit, and a vertex does not move when something else is
 * refined. What was computed is kept: to split what was merged before costs no geometry.
 *
 * Rules (Loop 1987): an edge's middle is 3/8 of its ends and 1/8 of the vertices across; a vertex of n neighbours is (1 - n b) of itself
 * and b of each, b = (5/8 - (3/8 + cos(2 pi / n) / 4)^2) / n. Sharp edges (boundaries, edges of other than two triangles, creases, borders
 * of materials and parts) are subdivided as cubic B-splines from points on them alone, so that patches which touch get the same points;
 * vertices of three or more sharp edges, of several fans, of more than 2048 neighbours, and corners stay where they are; a sharp edge that
 * ends inside the surface (a dart) has the smooth rule at that end (Hoppe et al. 1994). By default vertices are drawn where they go in the
 * limit, with the limit surface's normals, so depth only adds detail. Beside a dart the limit is the crease's, right up to one level.
 *
 * Positions of levels lie on a grid of 2^-40 of the mesh's magnitude: sums over neighbours are exact in double, so their order, the order
 * of splits and the machine do not matter. Attributes are linear over each base triangle; a base vertex's wedges stay apart along seams.
 *
 * Based on: Isenberg, Hartmann, Koenig. Interest Value Driven Adaptive Subdivision. 2003; Loop. Smooth Subdivision Surfaces Based on
 * Triangles. 1987; Hoppe et al. Piecewise Smooth Surface Reconstruction. 1994; Pakdel, Samavati. Incremental Adaptive Loop Subdivision.
 * 2004 (a refined area equals uniform subdivision). Where we differ: the paper leaves vertices of triangles that are not subdivided
 * unmoved, which bends the surface at the border of an area. */
#ifndef LOD_CORE_REFINE_REFINE_H
#define LOD_CORE_REFINE_REFINE_H

#include "core/base/parallel.h"
#include "core/mesh/mesh.h"

enum { LOD_REFINE_MAX_LEVEL = 12 };

enum lod_refine_positions {
  LOD_REFINE_LIMIT, /* every drawn vertex on the limit surface */
  LOD_REFINE_LEVEL, /* where the rules have it after as many steps as its finest triangle has seen: what the paper draws */
};

struct lod_refine_settings {
  double crease_degrees; /* edges whose triangles' normals differ by more are sharp; default 180 = none */
  double corner_degrees; /* a line of sharp edges that turns by more has a corner there; default 180 = none (Loop's boundaries) */
  bool sharp_borders;    /* borders of materials and parts are sharp; default true */
  /* Boundary vertices nearer to each other than this (model units) are one vertex, so that patches which touch do not crack; default 0:
   * only those at the same position, which a welded mesh has made one already. */
  double touch;
  enum lod_refine_positions positions; /* default LOD_REFINE_LIMIT */
};
struct lod_refine_settings lod_refine_defaults(void);

struct lod_refiner;

/* Draws `base` unrefined. base: welded; not owned, must outlive the refiner; triangles that name a vertex twice are left out. settings:
 * NULL = defaults. Everything lives in a child of `arena` until destroy. LOD_LIMIT "refine-size": more than 2^28 triangles. */
LOD_WARN_UNUSED enum lod_status lod_refiner_create(const struct lod_mesh *base, const struct lod_refine_settings *settings,
                                                   struct lod_arena *arena, struct lod_refiner **refiner, struct lod_problem *problem);
void lod_refiner_destroy(struct lod_refiner *refiner);

/* Draws the base again; keeps what was computed. */
void lod_refiner_reset(struct lod_refiner *refiner);
/* Renumbers what was computed in the order of drawing, when it has grown by this share since the last time: splitting and drawing then walk
 * through memory instead of jumping. What is drawn stays; faces and ids have other numbers afterwards. False: it was not worth while, or
 * memory had no room; nothing changed. */
bool lod_refiner_pack(struct lod_refiner *refiner, double growth);
/* Bytes held by what was computed. */
size_t lod_refiner_bytes(const struct lod_refiner *refiner);
/* Triangles and vertices that lod_refiner_mesh would give, green ones included; kept up to date. */
uint32_t lod_refiner_triangles(const struct lod_refiner *refiner);
uint32_t lod_refiner_vertices(const struct lod_refiner *refiner);

/* ---- faces: numbers of triangles of the forest, base triangles first in the order of the base (degenerate ones: LOD_NONE) ---- */

uint32_t lod_refiner_base_face(const struct lod_refiner *refiner, uint32_t triangle);
uint32_t lod_refiner_face_level(const struct lod_refiner *refiner, uint32_t face);
uint32_t lod_refiner_face_base(const struct lod_refiner *refiner, uint32_t face); /* triangle of the base mesh */
/* The first of a split face's four, which are neighbours in number; LOD_NONE when it is not split. */
uint32_t lod_refiner_face_children(const struct lod_refiner *refiner, uint32_t face);

/* Splits a leaf and, so that neighbours differ by at most one level, what has to be split with it; a leaf that comes to have three finer
 * neighbours is split too, since it looks so.
 * False, and nothing changed: it is not a leaf, is at LOD_REFINE_MAX_LEVEL, or memory is out (then every later call fails). */
bool lod_refiner_split(struct lod_refiner *refiner, uint32_t face);
/* Takes the four children of `face` away. False, and nothing changed: they are not all leaves, or a neighbour two levels finer needs them.
 * Where all three neighbours stay finer it goes on looking as if split (paper, Fig. 1 c). */
bool lod_refiner_merge(struct lod_refiner *refiner, uint32_t face);

/* Memory ran out in some call: only reset of nothing, only destroy is left. */
bool lod_refiner_failed(const struct lod_refiner *refiner);
/* Neighbours' levels, green patterns, counts and links are as promised. For assertions and tests; slow. */
bool lod_refiner_check(struct lod_refiner *refiner);

/* ---- what comes out ---- */

struct lod_refine_output {
  struct lod_mesh mesh;
  uint32_t *base;  /* triangle_count; triangle of the base mesh it lies in */
  uint8_t *levels; /* triangle_count; level of the leaf it belongs to */
  bool *green;     /* triangle_count; closes a leaf beside a finer one */
  /* Where a vertex that is new at some level comes from, for morphing it in: the ends of its edge as output vertices; a base vertex: twice
   * itself. parents[v] are drawn whenever v is. */
  uint32_t (*parents)[2];
  uint32_t *ids; /* vertex_count; the same for the same vertex as long as the refiner lives; free edges' own vertices: LOD_NONE */
};

/* The drawn mesh in `arena`, the same bytes whatever was drawn before: triangles in the order of the base, children in theirs. It has
 * wedges with limit normals (apart along sharp edges and the base's seams) and the base's other attributes; free edges and points of the
 * base follow unchanged. LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_refiner_mesh(struct lod_refiner *refiner, struct lod_arena *arena, struct lod_refine_output *output);
/* The same without parents and ids, which are NULL. */
LOD_WARN_UNUSED enum lod_status lod_refiner_surface(struct lod_refiner *refiner, struct lod_arena *arena, struct lod_refine_output *output);

/* The drawn position of what every triangle of level `steps` would be, without a forest: the fast way when all is refined. The same bits
 * as a refiner whose leaves all have that level, vertices numbered by level, triangles by base triangle and child. LOD_LIMIT
 * "refine-size" when the result has more than max_triangles or 2^31 triangles. */
LOD_WARN_UNUSED enum lod_status lod_refine_uniform(const struct lod_mesh *base, const struct lod_refine_settings *settings, uint32_t steps,
                                                   uint64_t max_triangles, struct lod_arena *arena, struct lod_mesh *mesh,
                                                   struct lod_problem *problem);

#endif
