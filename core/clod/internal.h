/* The changing surface of clod.h, seen from inside the folder.
 *
 * Patches, edges and sectors are only added, never changed or removed (only their last users are): a C-LOD is what was born by its number
 * and had not died. Edges have at most two users, one in each direction. */
#ifndef LOD_CORE_CLOD_INTERNAL_H
#define LOD_CORE_CLOD_INTERNAL_H

#include "core/clod/clod.h"

enum clod_edge_flag {
  CLOD_LINE = 1,  /* boundary, crease, border: stays a line */
  CLOD_SHARP = 2, /* normals differ across it, or it has one side */
  CLOD_FIXED = 4, /* where the surface was cut: straight, its ends stay */
};

struct clod_edge {
  uint32_t ends[2];
  uint32_t users[2]; /* 3 * patch + side running along, against; LOD_NONE. Of now */
  uint32_t flags;
  struct lod_vec3 inner[2];
};

/* A point of the overlay (below) in a patch: domain coordinates of corners 1 and 2; that of corner 0 is the rest. On a side the coordinate
 * of the corner opposite is exactly 0 (or, opposite corner 0, `u0` is set). */
struct clod_node {
  double v, w;
  uint32_t id; /* overlay point */
  uint32_t u0; /* 1: the coordinate of corner 0 is exactly 0 */
};

/* A fragment: a part of a source triangle that corresponds to a triangle of the domain. */
struct clod_cell {
  uint32_t node[3]; /* of the same patch */
  uint32_t face;    /* source triangle */
};

struct clod_patch {
  uint32_t corners[3], sides[3] /* 2 * edge + against */, sectors[3];
  uint32_t born, died; /* C-LOD numbers; died UINT32_MAX = lives */
  uint32_t material, part;
  uint32_t wedges[3]; /* of the source, whose UVs and colours the corners have; 0 where there are none */
  float off[2];       /* attributes.h: how far UVs and colours are off, rounded up */
  uint32_t node_count, cell_count;
  struct lod_vec3 centre;
  double bound, estimate;  /* certified; the paper's */
  struct clod_node *nodes; /* NULL once it died */
  struct clod_cell *cells;
};

/* Memory in blocks of powers of two that come back. */
enum { CLOD_POOL_CLASSES = 40 };
struct clod_pool {
  struct lod_arena *arena;
  void *free[CLOD_POOL_CLASSES];
};
void *clod_pool_take(struct clod_pool *pool, size_t bytes);
void clod_pool_give(struct clod_pool *pool, void *block, size_t bytes);

struct lod_clod {
  const struct lod_mesh *mesh; /* not owned */
  struct lod_clod_settings settings;
  struct lod_arena *arena;
  struct clod_pool pool;

  uint32_t vertex_count; /* fans of the source */
  struct lod_vec3 *positions;
  uint8_t *removable;  /* vertex_count: 0 stays, 1 inside a face, 2 on a line */
  uint8_t *ring_place; /* vertex_count: 1 + its number in the polygon at hand, else 0 */
  uint32_t *half;      /* vertex_count: 3 * patch + k of a living patch whose corner k it is; LOD_NONE */

  struct clod_edge *edges;
  struct clod_patch *patches;
  struct lod_vec3 *sectors; /* unit normals; zero = none */
  uint32_t edge_count, edge_room, patch_count, patch_room, sector_count;
  uint32_t living_patches, living_vertices, number;
  double rounding, magnitude;
  struct lod_patch_attributes attributes; /* which there are; no values */
  double uv_length, color_length;         /* what a difference of 1 counts as, model units */

  /* Overlay points: the source's vertices first, then points where source edges cross edges of patches. */
  struct lod_vec3 *points;
  uint32_t point_count, point_room;
  uint32_t *free_points; /* not in use any more */
  uint32_t free_count, free_room;

  struct clod_queue *queue;
  struct clod_hole *hole; /* scratch of one removal */
  uint64_t tried;
};

/* Grows an array that lives in the arena, old content kept. */
bool clod_grow(struct lod_arena *arena, void **array, uint32_t *room, uint32_t needed, size_t size);

static inline struct lod_vec3 clod_sector_normal(const struct lod_clod *clod, uint32_t sector) {
  return sector == LOD_NONE ? (struct lod_vec3){0, 0, 0} : clod->sectors[sector];
}
static inline uint32_t clod_across(const struct lod_clod *clod, uint32_t half) {
  uint32_t side = clod->patches[half / 3].sides[half % 3];
  return clod->edges[side >> 1].users[1 - (side & 1)];
}
struct lod_bezier clod_net(const struct lod_clod *clod, const struct clod_patch *patch);

/* ---- fit.c ---- */

/* One end of a curve: its corner and the tangent plane there (zero = none). */
struct clod_end {
  struct lod_vec3 p, normal;
};
/* The paper's inner point next to `near` (5.1): the point a third of the way, projected to the tangent plane. */
struct lod_vec3 clod_inner_point(struct clod_end near, struct lod_vec3 far);

/* Fits inner points to `count` samples at parameters t; inner[] holds the first guess. Stays in the tangent planes where there are any. */
void clod_fit_curve(const struct clod_end ends[2], const double *t, const struct lod_vec3 *samples, uint32_t count, double weight,
                    struct lod_vec3 inner[2]);
/* Moves parameters to the nearest points of the curve, one step. */
void clod_project_curve(const struct lod_bezier_curve *curve, const struct lod_vec3 *samples, uint32_t count, double *t);

/* Fits the centre of net to the nodes and cells; net's centre is the first guess. */
void clod_fit_centre(const struct lod_clod *clod, struct lod_bezier *net, const struct clod_node *nodes, uint32_t node_count,
                     const struct clod_cell *cells, uint32_t cell_count);
/* Moves inside nodes to the nearest points of the patch, one step. */
void clod_project_nodes(const struct lod_clod *clod, const struct lod_bezier *net, struct clod_node *nodes, uint32_t node_count);
/* max over cells of lod_bezier_bound, rounding included; stops with INFINITY above `limit`. */
double clod_patch_bound(const struct lod_clod *clod, const struct lod_bezier *net, const struct clod_node *nodes,
                        const struct clod_cell *cells, uint32_t cell_count, double limit);

static inline struct lod_barycentric clod_domain(const struct clod_node *node) {
  return (struct lod_barycentric){node->u0 ? 0 : 1 - node->v - node->w, node->v, node->w};
}

/* ---- hole.c: the patches around a vertex, laid out flat, and the patches that replace them ---- */

enum { CLOD_RING = 16, CLOD_HALVES = 2 };

/* A polygon of ring vertices 0 .. size - 1, counter-clockwise around the vertex at the origin. Patch i of `old` lies between ring vertices
 * i and i + 1. Open: the vertex lies on a line that goes from ring vertex size - 1 over the vertex to ring vertex 0. */
struct clod_polygon {
  bool open;
  uint32_t size, old_count;
  uint32_t old[CLOD_RING];  /* 3 * patch + corner of the vertex */
  uint32_t ring[CLOD_RING]; /* vertices */
  uint32_t sectors[CLOD_RING], wedges[CLOD_RING];
  double x[CLOD_RING][2];
  /* Result: triangles of ring numbers, counter-clockwise, and diagonals (the line's new edge first, when open). */
  uint32_t triangle_count, diagonal_count;
  uint32_t triangles[CLOD_RING][3];
  uint32_t diagonals[CLOD_RING][2];
  struct lod_vec3 inner[CLOD_RING][2]; /* of diagonals */
  /* Side s of triangle i, from its corner s to s + 1: outer side number (its first ring vertex), or CLOD_RING + diagonal. */
  uint32_t sides[CLOD_RING][3];
};

struct clod_local; /* overlay.c */

struct clod_hole {
  uint32_t vertex, half_count;
  struct clod_polygon halves[CLOD_HALVES];
  uint32_t line_edges[2]; /* edges of the line through the vertex: to ring 0 of halves[0], and to its last */
  double line_t;          /* parameter of the vertex on the new line, from ring 0 of halves[0] */
  struct lod_bezier nets[CLOD_HALVES][CLOD_RING];
  double bounds[CLOD_HALVES][CLOD_RING], estimates[CLOD_HALVES][CLOD_RING];
  double offs[CLOD_HALVES][CLOD_RING][2]; /* of UVs and colours */
  bool regular[CLOD_HALVES][CLOD_RING];   /* lod_bezier_is_regular */
  double bound;                           /* of the distance */
  double cost;                            /* the larger of that and what UVs and colours count as */
  bool paper;                             /* merged by inverse subdivision */
  uint32_t pair[2];                       /* of the merge, vertices; LOD_NONE = none */
  bool local_used;                        /* points were made in the overlay */
  struct clod_local *local;
};

/* Fills the hole of removable vertex v: polygons and their triangles. pair: two ring vertices that an edge has to join (of a vertex inside
 * a face), or NULL. False when no triangulation is allowed. */
bool clod_hole_open(const struct lod_clod *clod, uint32_t v, const uint32_t *pair, struct clod_hole *hole);

/* ---- simplify.c ---- */

/* Allocates what removals need, once. */
LOD_WARN_UNUSED enum lod_status clod_prepare(struct lod_clod *clod);
/* clod->hole->cost: what removing v would leave; INFINITY when it may not be removed, or would leave more than `limit`. pair: as above,
 * then edges and centres are merged by inverse subdivision; NULL: they are fitted. */
LOD_WARN_UNUSED enum lod_status clod_try_removal(struct lod_clod *clod, uint32_t v, const uint32_t *pair, bool paper, double limit);
/* Makes the removal that was tried, or gives it up. */
LOD_WARN_UNUSED enum lod_status clod_commit(struct lod_clod *clod);
LOD_WARN_UNUSED enum lod_status clod_give_up(struct lod_clod *clod);

/* ---- slip.c ---- */

/* Which attributes the mesh has, and what differences count as. */
void clod_attributes_begin(struct lod_clod *clod);
/* Whether they jump between two half-edges of the source. */
bool clod_attributes_jump(const struct lod_clod *clod, uint32_t half, uint32_t twin);
/* How far UVs (length) and colours (component) that are linear between these wedges are from the source's, at most. */
void clod_attributes_off(const struct lod_clod *clod, const uint32_t wedges[3], const struct clod_node *nodes,
                         const struct clod_cell *cells, uint32_t cell_count, double off[2]);
double clod_attributes_cost(const struct lod_clod *clod, const double off[2]);
LOD_WARN_UNUSED enum lod_status clod_attributes_extract(const struct lod_clod *clod, uint32_t number, struct lod_arena *arena,
                                                        struct lod_arena *scratch, struct lod_patch_attributes *out, uint32_t patch_count);

/* ---- search.c ---- */

/* Edges and, where *centre is set, the centre of triangle i by inverse subdivision (paper's 4.2, 6.2). */
void clod_inverse_diagonal(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t d, struct lod_vec3 inner[2]);
void clod_inverse_centre(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i, struct lod_bezier *net);
/* The paper's estimate of triangle i, accumulated. */
double clod_estimate(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i);
/* Ring number of a patch's old neighbour: polygon side names and the like. */
uint32_t clod_ring_number(const struct clod_polygon *polygon, uint32_t vertex);

/* ---- overlay.c ---- */

LOD_WARN_UNUSED enum lod_status clod_local_create(struct lod_arena *arena, struct clod_local **local);
/* Gathers fragments of the hole, mends those that no edge cuts any more, cuts them by the diagonals and deals them to the new triangles.
 * *good false: the hole must stay as it is. */
LOD_WARN_UNUSED enum lod_status clod_local_cut(struct lod_clod *clod, struct clod_hole *hole, bool *good);
/* Samples of a diagonal of half h: parameters and points, in arrays that live until the next call. Changed parameters are taken over by
 * clod_local_move_samples. */
LOD_WARN_UNUSED enum lod_status clod_local_sample(struct clod_hole *hole, uint32_t h, uint32_t diagonal, double **t,
                                                  struct lod_vec3 **points, uint32_t *count);
void clod_local_move_samples(struct clod_hole *hole, uint32_t h, uint32_t count);
/* Deals fragments to the new triangles. */
LOD_WARN_UNUSED enum lod_status clod_local_deal(struct lod_clod *clod, struct clod_hole *hole, bool *good);
/* Nodes and cells of new triangle i of half h, in arrays that live until the next hole. */
void clod_local_patch(struct clod_hole *hole, uint32_t h, uint32_t i, struct clod_node **nodes, uint32_t *node_count,
                      struct clod_cell **cells, uint32_t *cell_count);
/* The hole was filled: points that were taken out may be used again. Or it was not: those that were made for it. */
LOD_WARN_UNUSED enum lod_status clod_local_commit(struct lod_clod *clod, struct clod_hole *hole);
LOD_WARN_UNUSED enum lod_status clod_local_abandon(struct lod_clod *clod, struct clod_hole *hole);

/* A C-Model without patches, whose makers fill it in; NULL: no memory. */
struct lod_clod *clod_begin(const struct lod_mesh *mesh, const struct lod_clod_settings *settings, struct lod_arena *arena);

#endif
