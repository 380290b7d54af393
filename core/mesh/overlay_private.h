/* Inside the overlay. Coarse edges are named by their canonical half-edge, the lower of the two; so are finer edges. */
#ifndef LOD_CORE_MESH_OVERLAY_PRIVATE_H
#define LOD_CORE_MESH_OVERLAY_PRIVATE_H

#include "core/mesh/adjacency.h"
#include "core/mesh/overlay.h"

#define OVERLAY_TRY_NEW(pointer, arena, count)                                                                                             \
  do {                                                                                                                                     \
    if (((pointer) = lod_arena_alloc((arena), (count), sizeof *(pointer))) == NULL)                                                        \
      return LOD_MEMORY;                                                                                                                   \
  } while (0)
#define OVERLAY_TRY_ZERO(pointer, arena, count)                                                                                            \
  do {                                                                                                                                     \
    if (((pointer) = lod_arena_calloc((arena), (count), sizeof *(pointer))) == NULL)                                                       \
      return LOD_MEMORY;                                                                                                                   \
  } while (0)

/* ---- overlay_arrange.c: paths as crossings of finer edges ----
 *
 * A finer triangle sees paths as chords that do not cross: arcs around a corner, from one side to the next, and spokes from one corner to
 * the side opposite. How many there are of each follows from the counts of crossings on its three sides. Between two neighbouring crossings
 * of a side lies a gap; gap g of a half-edge comes after g crossings from its start. */

struct overlay_crossing {
  uint32_t path;   /* coarse canonical half-edge */
  uint32_t edge;   /* finer canonical half-edge */
  uint32_t next;   /* crossing on the same edge, towards its end */
  uint32_t onward; /* crossing on the same path, towards its end; of unused ones: the next unused */
  float share;     /* of the edge, where the path would like to cross it */
};

enum overlay_path_state { PATH_NONE, PATH_CROSSING, PATH_ALONG };

struct overlay_path {
  uint8_t state;
  uint8_t rips;       /* how often it had to give way */
  uint32_t first;     /* crossing, when it crosses; index into steps when it runs along finer edges */
  uint32_t count;     /* crossings or steps */
  uint32_t corner[2]; /* PATH_CROSSING: finer corner that it starts at and ends at */
};

struct overlay_work {
  const struct lod_mesh *coarse, *fine;
  struct lod_adjacency c, f;
  const uint32_t *parents;
  const struct lod_overlay_settings *settings;
  struct lod_arena *arena;
  uint32_t *match; /* finer vertex -> coarse vertex, or LOD_NONE */

  uint32_t *counts;      /* by finer half-edge, canonical ones only: crossings ... */
  uint32_t *firsts;      /* ... and the first of them */
  uint32_t *along;       /* by finer canonical half-edge: coarse path that runs along it, or LOD_NONE */
  uint32_t *vertex_path; /* by finer vertex: the path through it, when it is no coarse vertex, or LOD_NONE */
  struct overlay_crossing *crossings;
  uint32_t crossing_count, crossing_capacity, unused;
  uint32_t *steps; /* finer half-edges that paths run along, in their direction */
  uint32_t step_count, step_capacity;
  struct overlay_path *paths; /* by coarse half-edge, canonical ones only */
  uint32_t *fan_to;           /* coarse fan -> finer fan, or LOD_NONE */
  uint32_t *fan_from;         /* finer fan -> coarse fan, or LOD_NONE */
  uint32_t tries;
};

struct overlay_pattern {
  uint32_t sides[3]; /* crossings of each */
  uint32_t arcs[3];  /* around each corner */
  uint32_t spokes;
  uint32_t apex; /* corner that the spokes come from; 3 = none */
};

static inline uint32_t overlay_canonical(const uint32_t *twin, uint32_t h) {
  return twin[h] < h ? twin[h] : h;
}
static inline uint32_t overlay_count(const struct overlay_work *w, uint32_t h) {
  return w->counts[overlay_canonical(w->f.twin, h)];
}
static inline bool overlay_takes_part(const struct lod_mesh *mesh, uint32_t t) {
  const uint32_t *v = mesh->triangles[t];
  return v[0] != v[1] && v[1] != v[2] && v[2] != v[0];
}
static inline struct lod_vec3 overlay_at(const struct lod_mesh *mesh, uint32_t v) {
  return lod_vec3_from_float(mesh->positions[v]);
}
/* Of triangle t, twice its area long. */
static inline struct lod_vec3 overlay_normal(const struct lod_mesh *mesh, uint32_t t) {
  const uint32_t *v = mesh->triangles[t];
  struct lod_vec3 a = overlay_at(mesh, v[0]);
  return lod_vec3_cross(lod_vec3_subtract(overlay_at(mesh, v[1]), a), lod_vec3_subtract(overlay_at(mesh, v[2]), a));
}
struct overlay_pattern overlay_pattern_of(const struct overlay_work *w, uint32_t t);
/* Gap of the side opposite to the corner that spoke slot `slot` leads to. */
static inline uint32_t overlay_slot_gap(const struct overlay_pattern *p, uint32_t corner, uint32_t slot) {
  return p->arcs[(corner + 1) % 3] + slot;
}
/* Crossing number `index` from the start of half-edge h. */
uint32_t overlay_crossing_at(const struct overlay_work *w, uint32_t h, uint32_t index);
LOD_WARN_UNUSED enum lod_status overlay_arrange(struct overlay_work *w);
/* Puts a crossing of `path` into gap `gap` of half-edge h; returns it in *crossing. */
LOD_WARN_UNUSED enum lod_status overlay_cross(struct overlay_work *w, uint32_t path, uint32_t h, uint32_t gap, double share,
                                              uint32_t *crossing);
/* Takes away a path, not one along a boundary. */
void overlay_rip(struct overlay_work *w, uint32_t path);

/* Where a path may leave a coarse vertex: slots of finer corners, between the paths that are there before and after it. */
struct overlay_slot {
  uint32_t corner; /* finer */
  uint32_t slot;
};
struct overlay_sector {
  struct overlay_slot *slots;
  uint32_t count, capacity;
};
/* Corners that a path may leave by: into the triangle, to its far side; along an edge, too, which leads out of corners that spokes of
 * others cut off from the far side; or all, whoever is in the way. */
enum overlay_ways { OVERLAY_WAYS_ACROSS, OVERLAY_WAYS_ALONG, OVERLAY_WAYS_ALL };
/* end: 0 = at the start of path p, 1 = at its end. */
LOD_WARN_UNUSED enum lod_status overlay_find_sector(struct overlay_work *w, uint32_t p, int end, enum overlay_ways ways,
                                                    struct overlay_sector *sector);
/* Is finer half-edge h, which starts at the vertex, in the sector and free? */
bool overlay_sector_has_edge(const struct overlay_work *w, const struct overlay_sector *sector, uint32_t h);
/* Remembers which fans belong together. */
void overlay_join_fans(struct overlay_work *w, uint32_t coarse_corner, uint32_t fine_corner);

static inline uint32_t overlay_path_start(const struct overlay_work *w, uint32_t p) {
  return lod_half_edge_start(w->coarse, p);
}
static inline uint32_t overlay_path_end(const struct overlay_work *w, uint32_t p) {
  return lod_half_edge_end(w->coarse, p);
}

/* ---- overlay_border.c: paths along boundaries and cuts ---- */
LOD_WARN_UNUSED enum lod_status overlay_trace_boundaries(struct overlay_work *w);

/* ---- overlay_line.c: paths along finer edges ---- */
/* Adds a half-edge to the steps, and makes the steps from `begin` on the path. */
LOD_WARN_UNUSED enum lod_status overlay_add_step(struct overlay_work *w, uint32_t half_edge);
void overlay_place_along(struct overlay_work *w, uint32_t path, uint32_t begin);
LOD_WARN_UNUSED enum lod_status overlay_follow_lines(struct overlay_work *w);
/* A path that gave way: along a finer edge between its ends again, if one is free. */
LOD_WARN_UNUSED enum lod_status overlay_retake_edge(struct overlay_work *w, uint32_t path, struct overlay_sector *sector, bool *placed);

/* ---- overlay_trace.c: all other paths ---- */
LOD_WARN_UNUSED enum lod_status overlay_trace(struct overlay_work *w);

/* ---- overlay_cells.c: nodes and fragments ---- */
struct overlay_cells {
  uint32_t *node_path;  /* node_count: the path that the node lies on, when it is no coarse vertex; LOD_NONE inside */
  uint32_t *node_along; /* node_count: how far along the path, of LOD_OVERLAY_ONE */
};
LOD_WARN_UNUSED enum lod_status overlay_cut(struct overlay_work *w, struct lod_arena *results, struct lod_overlay *overlay,
                                            struct overlay_cells *cells);
/* Bits of the sides of coarse triangle t that the node lies on. */
uint32_t overlay_sides_of(const struct overlay_work *w, const struct overlay_cells *cells, uint32_t node, uint32_t t);

/* ---- overlay_embed.c: disks into triangles ---- */
LOD_WARN_UNUSED enum lod_status overlay_embed(struct overlay_work *w, const struct overlay_cells *cells, struct lod_overlay *overlay);
/* Mapped, failed and lost triangles. */
LOD_WARN_UNUSED enum lod_status overlay_count_up(struct overlay_work *w, struct lod_overlay *overlay);

/* ---- overlay_backs.c: walls with two sides ---- */
/* front: triangle_count; the triangle with the same corners, the other way round, that this one is the back of; LOD_NONE. */
LOD_WARN_UNUSED enum lod_status overlay_find_backs(const struct lod_mesh *mesh, struct lod_arena *arena, uint32_t **front, uint32_t *count);
/* The mesh with backs as triangles that take no part. */
LOD_WARN_UNUSED enum lod_status overlay_hide_backs(const struct lod_mesh *mesh, const uint32_t *front, struct lod_arena *arena,
                                                   struct lod_mesh *shown);
/* Adds the fragments of backs; w's meshes hide them. */
LOD_WARN_UNUSED enum lod_status overlay_mirror_backs(struct overlay_work *w, const uint32_t *front, const uint32_t *fine_front,
                                                     struct lod_arena *results, struct lod_overlay *overlay);

/* ---- overlay_part.c: what lies beside coarse triangles that are not mapped ---- */
struct overlay_part {
  struct lod_adjacency c;
  uint8_t *held;    /* node: on an edge or vertex of a triangle that is not mapped */
  uint8_t *settled; /* node: was drawn before, and was not held then */
};
LOD_WARN_UNUSED enum lod_status overlay_part_create(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const uint8_t *before,
                                                    struct lod_arena *arena, struct overlay_part *part);
/* How many nodes of mapped triangles lie on coarse half-edge h; `index` counts from its start. */
uint32_t overlay_part_count(const struct overlay_part *part, const struct lod_overlay *overlay, uint32_t h);
uint32_t overlay_part_node(const struct overlay_part *part, const struct lod_overlay *overlay, uint32_t h, uint32_t index);

#endif
