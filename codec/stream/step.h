/* Between the files of the delta coder: a step from a base to a finer level while it is coded, in either direction. */
#ifndef LOD_CODEC_STREAM_STEP_H
#define LOD_CODEC_STREAM_STEP_H

#include "codec/stream/connectivity.h"
#include "codec/stream/delta.h"

/* Three coordinates and nothing, added lane by lane: SIMD where there is some, the same bits where there is none. */
typedef float lod_v4 __attribute__((vector_size(16)));

/* Neighbours of vertex v: list[first[v]] to list[first[v + 1] - 1]. */
struct lod_adjacency {
  uint32_t *first, *list;
};
LOD_WARN_UNUSED enum lod_status lod_adjacency_of_soup(const struct lod_mesh *mesh, const uint32_t *rank, struct lod_arena *arena,
                                                      struct lod_adjacency *adjacency);

/* The coarser level in the order that its positions give it, whatever order it came in. */
struct step_base {
  uint32_t vertex_count;
  uint32_t *order;     /* ours -> the caller's */
  uint32_t *rank;      /* the caller's -> ours */
  lod_v4 *positions;   /* in steps of the finer level's grid, from its origin */
  int32_t (*cells)[3]; /* the same, rounded */
  lod_v4 *normals;     /* of unit length, or 0 */
  struct lod_adjacency adjacency;
};
LOD_WARN_UNUSED enum lod_status lod_step_base(const struct lod_mesh *mesh, const struct lod_delta_grid *grid, struct lod_arena *arena,
                                              struct step_base *base);

/* Which part and material primitives have: `count` pairs, and an index a primitive. */
struct step_groups {
  uint32_t count;
  uint32_t (*pairs)[2];                 /* part, material (LOD_NONE = default) */
  uint32_t *triangles, *edges, *points; /* indices */
};

struct step {
  struct lod_coder coder;
  struct lod_delta_header header;
  struct lod_arena *arena, *scratch;
  struct lod_problem *problem;
  const struct lod_delta_encode_request *request; /* NULL when decoding */
  struct lod_delta_statistics *statistics;
  uint32_t cut_vertices, components; /* of the header: of the cut mesh */

  struct step_base base;
  struct lod_cut cut; /* encoding */
  struct lod_connectivity connectivity;
  uint32_t loose;           /* vertices of no triangle: the last ones */
  uint32_t *source;         /* encoding: vertex -> vertex of request->fine */
  uint32_t *target;         /* encoding: vertex of request->fine -> vertex */
  uint32_t (*triangles)[3]; /* welded */
  uint32_t *component;      /* vertex -> component of the connectivity; LOD_NONE where loose */
  uint32_t (*edges)[2], *points;
  float *edge_thickness, *point_thickness;
  struct step_groups groups;
  struct lod_adjacency adjacency; /* of the finer level; neighbours across uncut edges once, those along cut edges first */
  uint32_t *rim;                  /* vertex -> how many of its neighbours are along cut edges */
  struct lod_adjacency corners;   /* vertex -> its 3 t + i */
  lod_v4 *estimates;              /* vertex -> where it seems to lie while base vertices are found; in steps */
  uint8_t *estimated;             /* vertex: 0 nothing known, 1 estimated, 2 kept */
  uint32_t *kept;                 /* base vertex (ours) -> vertex or LOD_NONE */
  int32_t (*cells)[3];            /* vertex -> grid indices */

  /* attributes.c: as in struct lod_mesh; NULL where there are none */
  uint32_t (*wedge_corners)[3], *wedge_vertex;
  float (*normals)[3], (*uvs[LOD_UV_SETS])[2], (*colors)[4];

  /* geometry.c */
  uint32_t *order; /* vertices by their distance from kept ones: kept_count of these, then those that are `reached` */
  uint32_t kept_count, reached;
  /* Neighbours of vertices inside (none of those on a rim), filled up to fours with `vertices`, a number behind all others: what is there
   * adds nothing. */
  struct lod_adjacency wide;
  float *share;      /* vertex -> 1 / number of neighbours whose mean it should be: those along the rim, where it has some */
  float *inner;      /* vertex -> the same inside, 0 on the rim */
  float *stiffness;  /* vertex -> 1 / (1 + sum of the neighbours' share^2) */
  lod_v4 *laplacian; /* vertex -> estimate less mean of the neighbours' estimates */
  float (*size)[2];  /* vertex -> its difference along the normal and across, in steps; 0 = none */
};

/* ---- topology.c ---- */
LOD_WARN_UNUSED enum lod_status lod_step_topology(struct step *step);
/* ---- locate.c ---- */
LOD_WARN_UNUSED enum lod_status lod_step_locate(struct step *step);
/* ---- attributes.c ---- */
LOD_WARN_UNUSED enum lod_status lod_step_attributes(struct step *step);
/* ---- geometry.c ---- */
LOD_WARN_UNUSED enum lod_status lod_step_predict(struct step *step);
LOD_WARN_UNUSED enum lod_status lod_step_kept(struct step *step);
LOD_WARN_UNUSED enum lod_status lod_step_geometry(struct step *step);

/* What every decoder makes of a grid index: two roundings of float, as codec/export/draco.h's grid. */
static inline float lod_step_position(const struct lod_delta_grid *grid, int axis, int32_t q) {
  const float offset = (float)q * grid->step;
  return offset + grid->origin[axis];
}

static inline enum lod_status lod_step_bad(struct step *step, const char *what) {
  return lod_fail(step->problem, LOD_BAD_INPUT, lod_coder_overrun(&step->coder) ? "truncated" : "delta", "A delta's %s make no sense.",
                  what);
}

#endif
