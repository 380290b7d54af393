/* The forest behind a refiner. Inside core/refine. */
#ifndef LOD_CORE_REFINE_INTERNAL_H
#define LOD_CORE_REFINE_INTERNAL_H

#include "core/mesh/adjacency.h"
#include "core/refine/refine.h"
#include "core/refine/rules.h"

enum { REFINE_TABLE = 32 };

/* A base mesh with what the rules need to know of it. Half-edge 3 t + k as in adjacency.h. */
struct refine_base {
  struct lod_mesh mesh; /* the caller's arrays, or triangles of our own when boundaries were welded */
  struct lod_adjacency adjacency;
  struct refine_grid grid;
  double (*points)[3];    /* vertex_count; on the grid */
  uint32_t edge_count;    /* edges as the rules see them: one for a pair of twins, one for each half-edge without */
  uint32_t *edge_half;    /* edge_count; the half-edge that runs its way: its triangle lies left of it */
  uint32_t *edge_of;      /* 3 * triangle_count; LOD_NONE in degenerate triangles */
  uint32_t *edge_sibling; /* edge_count; ring of the edges between the same two vertices; itself when alone */
  bool *edge_sharp;       /* edge_count */
  bool *edge_split;       /* edge_count; wedges or normals differ across it */
  uint8_t *rule;          /* vertex_count; enum refine_rule */
  bool *dart;             /* vertex_count */
  uint32_t *spoke_begin;  /* vertex_count + 1; edges at vertex v: counter-clockwise when it has one fan, both open ends included */
  uint32_t *spokes;
  uint32_t (*sharp_spokes)[2]; /* vertex_count; of REFINE_CREASE */
  uint32_t *corner_group;      /* 3 * triangle_count; a corner that stands for all that share a wedge with this one */
  uint32_t triangles;          /* not degenerate */
  struct refine_weights move[REFINE_TABLE], limit[REFINE_TABLE]; /* by valence, from 3 */
};

static inline struct refine_weights refine_base_move(const struct refine_base *base, uint32_t n) {
  return n < REFINE_TABLE ? base->move[n] : refine_vertex_weights(n);
}
static inline struct refine_weights refine_base_limit(const struct refine_base *base, uint32_t n) {
  return n < REFINE_TABLE ? base->limit[n] : refine_limit_weights(n);
}

LOD_WARN_UNUSED enum lod_status refine_base_create(const struct lod_mesh *mesh, const struct lod_refine_settings *settings,
                                                   struct lod_arena *arena, struct refine_base *base, struct lod_problem *problem);

/* The vertex across `h`'s edge from its triangle's side: third corner of the triangle of half-edge h. */
static inline uint32_t refine_third(const struct refine_base *base, uint32_t h) {
  return base->mesh.triangles[h / 3][(h % 3 + 2) % 3];
}

enum vertex_has { HAS_POSITION = 1, HAS_USER = 2 };

struct vertex {
  double p[3];     /* at the level it is born at */
  uint32_t origin; /* the base vertex, or the edge that it is the middle of */
  uint32_t later;  /* first of its positions at later levels, LOD_NONE = none yet */
  uint8_t level, rule, has;
  bool masked; /* middle by the smooth mask */
};

/* What interests and output read most, apart so that it stays in the cache: 32 bytes, like an edge and a face. */
struct shown {
  float limit[3];  /* [0] not a number: not computed yet */
  float normal[3]; /* likewise, with the limit; of REFINE_SMOOTH alone */
  uint32_t stamp;  /* emission that `wedge` belongs to */
  uint32_t wedge;  /* first wedge of this emission, or for a vertex of free edges alone its number */
};

struct edge {
  uint32_t v[2];
  uint32_t f[2];   /* left, right of v[0] -> v[1] at this level; LOD_NONE = not made, or none */
  uint32_t middle; /* LOD_NONE until split */
  uint32_t child;  /* v[0]..middle, and the next number middle..v[1] */
  uint32_t up;     /* the edge it is half of, or LOD_NONE: of the base, or inside a face */
  uint8_t level;
  bool sharp : 1, smooth_mask : 1; /* smooth_mask: its middle has four parents */
  bool ringed : 1;                 /* has siblings */
  uint16_t active;                 /* drawn-split faces on it (this edge's own sides) */
};

struct face {
  uint32_t v[3];
  uint32_t e[3]; /* e[i] between v[i] and v[i + 1] */
  uint32_t child;
  uint8_t level;
  bool split;     /* drawn as its children */
  bool drawn;     /* in the cut or above it */
  uint8_t active; /* of a leaf: bit i = edge i has a drawn middle */
};

/* Of a face, read less often. */
struct lineage {
  uint32_t up, base;
  uint32_t path; /* 2 bits a level, the base's child in the lowest two */
};

struct later {
  double p[3];
  uint32_t next;
};

struct lod_refiner {
  struct lod_arena *arena; /* child: all memory */
  struct lod_arena *nodes; /* child of that: the arrays of the forest */
  struct refine_base base;
  struct lod_refine_settings settings;
  struct vertex *vertices;
  struct shown *shown; /* by vertex */
  struct edge *edges;
  uint32_t *siblings; /* by edge; ring of edges between the same two vertices; itself when alone */
  struct face *faces;
  struct lineage *lineages; /* by face */
  struct later *laters;
  uint32_t vertex_count, edge_count, face_count, later_count;
  uint32_t vertex_room, edge_room, face_room, later_room;
  uint32_t packed_faces; /* when lod_refiner_pack was called last */
  uint32_t *face_of;     /* base triangle -> face */
  uint32_t base_faces;
  uint32_t drawn_triangles, drawn_vertices, epoch;
  uint32_t *journal; /* faces split by the latest lod_refiner_split, in order */
  uint32_t journal_count, journal_room;
  bool sine_known[2]; /* of the angles asked for last */
  double sine_degrees[2], sines[2];
  uint32_t level_bias; /* added to levels where interest is graded: the base is a level of something coarser */
  bool failed;
};

/* Makes a face's children if it has none. False when memory is out. */
bool refine_make_children(struct lod_refiner *r, uint32_t face);
/* Gives an edge its middle and two halves if it has none. */
bool refine_split_edge(struct lod_refiner *r, uint32_t edge);
/* The face of the edge's own level on side s, made when it is not there; LOD_NONE where the surface ends, or memory is out. */
uint32_t refine_side(struct lod_refiner *r, uint32_t edge, int s);
/* Fresh arrays in r->nodes with room for what there is and for `more` faces; r->failed stays as it is. */
bool refine_rooms(struct lod_refiner *r, uint32_t more);
bool refine_room(struct lod_refiner *r, void **array, uint32_t *room, uint32_t count, uint32_t more, size_t size);

/* Position at a level (>= the vertex's own), on the limit surface, and the normal on one side of what is sharp: `corner` is the face and
 * corner that asks. Computed once. Zero vectors after failure. */
struct lod_vec3 refine_position(struct lod_refiner *r, uint32_t vertex, uint32_t level);
const float *refine_limit(struct lod_refiner *r, uint32_t vertex);
void refine_normal(struct lod_refiner *r, uint32_t vertex, uint32_t base_triangle, float normal[3]);
static inline struct lod_vec3 refine_limit_vec(struct lod_refiner *r, uint32_t vertex) {
  return lod_vec3_from_float(refine_limit(r, vertex));
}

/* The next of the edges between the same two vertices; itself when it is alone. */
static inline uint32_t refine_sibling(const struct lod_refiner *r, uint32_t edge) {
  return r->edges[edge].ringed ? r->siblings[edge] : edge;
}

/* Whether a leaf's edge has a drawn middle. */
static inline bool refine_edge_active(const struct lod_refiner *r, uint32_t edge) {
  const struct edge *e = &r->edges[edge];
  if (e->active != 0)
    return true;
  if (!e->ringed)
    return false;
  for (uint32_t s = r->siblings[edge]; s != edge; s = r->siblings[s])
    if (r->edges[s].active != 0)
      return true;
  return false;
}

static inline int refine_local(const struct face *f, uint32_t edge) {
  return f->e[0] == edge ? 0 : f->e[1] == edge ? 1 : 2;
}

/* Undoes the splits that the latest lod_refiner_split made. */
void refine_undo(struct lod_refiner *r);
/* Total order of faces that does not depend on history. */
static inline uint64_t refine_key(const struct lod_refiner *r, uint32_t f) {
  return (uint64_t)r->faces[f].level << 56 | (uint64_t)r->lineages[f].base << 24 | r->lineages[f].path; /* coarse before fine */
}

struct lod_contact;
struct lod_refine_limits;
/* lod_refine_contact that stops at a budget (limits: NULL = none) with LOD_LIMIT; *contact is then what was reached. */
LOD_WARN_UNUSED enum lod_status refine_contact_within(struct lod_refiner *r, const double point[3], uint32_t steps,
                                                      const struct lod_refine_limits *limits, struct lod_contact *contact);

#endif
