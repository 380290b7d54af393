/* What the files of this folder share. Not to be included from elsewhere.
 *
 * Inside, a unit's used vertices are renumbered along a Morton curve ("working" vertices), and coordinates are multiplied by a power of
 * two so that the largest is at most 1: squares neither overflow nor lose a bit, and float arithmetic is enough for the search. */
#ifndef LOD_CORE_CLUSTER_INTERNAL_H
#define LOD_CORE_CLUSTER_INTERNAL_H

#include "core/base/parallel.h"
#include "core/cluster/cluster.h"

enum {
  CLUSTER_BLOCK = 16,      /* neighbouring working vertices that are handled at once */
  CLUSTER_GRAIN = 1 << 15, /* chunk of parallel loops */
  CLUSTER_MAX_LEVELS = 64,
  CLUSTER_UNBORN = 255, /* birth of a vertex that is no centre */
};
#define CLUSTER_MAX_COUNT (1u << 29)

/* Groups (material, chart) and the sets of them that vertices have as keys. */
struct cluster_groups {
  uint32_t group_count, set_count;
  double *extent;       /* group_count; diagonal of its box, working units */
  uint32_t *set_begin;  /* set_count + 1; into set_groups */
  uint32_t *set_groups; /* ascending within a set */
  uint32_t *vertex_set; /* per source vertex; LOD_NONE when unused. Only while preparing */
};

/* Wedges by vertex, and what they stand for. Only when the mesh has wedges. */
struct cluster_wedges {
  uint32_t *begin;    /* vertex_count + 1; into list */
  uint32_t *list;     /* ascending within a vertex */
  uint32_t *chart;    /* wedge -> chart; or NULL when the mesh has no UV */
  uint8_t *flat_part; /* part -> 1 when it is flat shaded; one entry when the mesh has no parts; or NULL when it has no normals */
};

struct cluster_unit {
  const struct lod_mesh *mesh; /* not owned */
  double scale;                /* unit to model, > 0 */
  double shrink;               /* working = unit * shrink, a power of two */
  uint32_t count;              /* working vertices */
  uint32_t block_count;
  uint32_t *source; /* working -> source vertex */
  float *x, *y, *z; /* working coordinates, padded to whole blocks */
  float *weight;
  float (*quadric)[6];      /* of the planes through each vertex, about itself: xx xy xz yy yz zz; NULL unless wanted */
  uint32_t *order;          /* working vertices, heaviest first; ties in source order */
  uint32_t *rank;           /* place in order; padded to whole blocks */
  uint32_t (*triangles)[3]; /* of working vertices, in source order */
  float (*block_box)[6];    /* min, max */
  uint32_t *key;            /* set of each working vertex; or NULL when there is one group */
  uint32_t *block_key;      /* set of all of a block, or LOD_NONE when mixed; NULL with key */
  struct cluster_groups groups;
  struct cluster_wedges wedges;
  double origin[3]; /* minimum of the box, working */
  double diagonal;  /* of the box, working */
  double area;      /* of all triangles, working */
};

struct lod_cluster {
  struct lod_cluster_settings settings;
  uint32_t unit_count;
  struct cluster_unit *units;
  uint64_t triangle_count, vertex_count; /* of all units */
};

/* Cells of one unit at one level. */
struct cluster_cells {
  double cell; /* width, working */
  uint32_t count;
  uint32_t *centre; /* cell -> working vertex, ascending */
  uint32_t *image;  /* working vertex -> cell */
  double reach;     /* at least max |v - centre(v)|, working */
  uint32_t *keys;   /* set -> key at this level; or NULL when all are one */
};

/* grade.c. Fills weight. begin, corners: working vertex -> its corners, CSR: 3 * triangle + corner, or 3 * triangle_count + 2 * edge + end.
 */
void cluster_grade(struct cluster_unit *unit, const struct lod_cluster_settings *settings, const uint32_t *begin, const uint32_t *corners);

/* prepare.c. Working order, blocks, grades, order by weight. */
LOD_WARN_UNUSED enum lod_status cluster_prepare(struct cluster_unit *unit, const struct lod_unit *source,
                                                const struct lod_cluster_settings *settings, struct lod_arena *arena);

/* groups.c. shrink must be set. Sets unit->groups and unit->wedges. */
LOD_WARN_UNUSED enum lod_status cluster_find_groups(struct cluster_unit *unit, struct lod_arena *arena);
/* Set -> key at a cell width: groups too small to be seen are left out. *keys = NULL when one key is left. */
LOD_WARN_UNUSED enum lod_status cluster_keys(const struct cluster_unit *unit, double cell, double separate, struct lod_arena *arena,
                                             uint32_t **keys);

/* cells.c. Opens cells of width `cell` in weight order beside the centres already born (birth < level, which no new cell may cover);
 * new centres get birth = level. *count: all centres. */
LOD_WARN_UNUSED enum lod_status cluster_open(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell,
                                             const uint32_t *keys, uint8_t *birth, uint8_t level, struct lod_arena *scratch,
                                             uint32_t *count);
/* Finds every vertex's cell among the centres with birth <= level. Fills cells (keys given). */
LOD_WARN_UNUSED enum lod_status cluster_assign(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell,
                                               uint32_t *keys, const uint8_t *birth, uint8_t level, struct lod_arena *arena,
                                               struct cluster_cells *cells);
/* Unit cell in working units for a cell in model units, within sensible limits. */
double cluster_working_cell(const struct cluster_unit *unit, double cell);

/* represent.c. Positions of the level's vertices, unit space; *bound: max |v - image(v)|, unit space. Allocates in `scratch` alone. */
LOD_WARN_UNUSED enum lod_status cluster_represent(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                                  const struct cluster_cells *cells, struct lod_arena *scratch, float (*positions)[3],
                                                  double *bound);

/* synthesize.c. Triangles, edges and points of the level with what they came from. */
struct cluster_synthesis {
  uint32_t triangle_count, edge_count, point_count;
  uint32_t (*triangles)[3];
  uint32_t *triangle_source; /* a source triangle that became it */
  uint32_t (*edges)[2];
  uint32_t *edge_source; /* a source triangle, or triangle_count + a source edge, that became it */
  uint32_t *points;
  uint32_t *point_source; /* source triangle; triangle_count + source edge; triangle_count + edge_count + source point */
  uint32_t *nearby;       /* source triangle -> primitive */
};
LOD_WARN_UNUSED enum lod_status cluster_synthesize(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                                   struct lod_arena *arena, struct cluster_synthesis *synthesis);

/* thick_edge.c. Thickness of edges and points, unit space, both in `arena`. */
LOD_WARN_UNUSED enum lod_status cluster_thicken(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                                const struct cluster_synthesis *synthesis, struct lod_arena *arena, float **edge_thickness,
                                                float **point_thickness);

/* attributes.c. Corners, wedges, attributes, materials and parts of `mesh`, whose positions and primitives are set. */
LOD_WARN_UNUSED enum lod_status cluster_attribute(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                                  const struct cluster_synthesis *synthesis, struct lod_arena *arena,
                                                  struct lod_mesh *mesh);
/* normals.c. Finds which parts are flat shaded. */
LOD_WARN_UNUSED enum lod_status cluster_find_flat_parts(struct cluster_unit *unit, struct lod_arena *arena);
/* Area-weighted normals a wedge; wedge_source: wedge of the level -> source wedge, for where the triangles have no area. */
LOD_WARN_UNUSED enum lod_status cluster_adjust_normals(const struct cluster_unit *unit, const uint32_t *wedge_source,
                                                       struct lod_arena *arena, struct lod_mesh *mesh);

/* level.c. A whole unit at one level. */
LOD_WARN_UNUSED enum lod_status cluster_make_mesh(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                                  const struct cluster_cells *cells, struct lod_arena *arena, struct lod_mesh *mesh,
                                                  uint32_t **images, uint32_t **nearby, double *bound);

/* Finalizer of SplitMix64: a good hash of 64 bits. */
static inline uint64_t cluster_hash(uint64_t v) {
  v = (v ^ (v >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
  v = (v ^ (v >> 27)) * UINT64_C(0x94d049bb133111eb);
  return v ^ (v >> 31);
}

static inline uint32_t cluster_power_of_two(uint64_t at_least) {
  uint32_t size = 16;
  while (size < at_least && size < (1u << 31))
    size *= 2;
  return size;
}

#endif
