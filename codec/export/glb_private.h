/* Between the files of the GLB writer. */
#ifndef LOD_CODEC_EXPORT_GLB_PRIVATE_H
#define LOD_CODEC_EXPORT_GLB_PRIVATE_H

#include <jansson.h>

#include "codec/export/draco.h"
#include "codec/export/glb.h"

/* ---- glb_grid.c: a unit's level on its grid ---- */

struct glb_edge {
  uint32_t vertices[2]; /* of the glb_unit */
  uint32_t sources[2];  /* of the mesh: where colours and UVs come from */
  uint32_t part, material;
  float thickness;
};

struct glb_point {
  uint32_t vertex, source, part, material;
  float thickness;
};

struct glb_unit {
  const struct lod_mesh *mesh;
  uint32_t only_part; /* where the mesh does not tag parts */
  struct lod_draco_grid grid;
  uint32_t vertex_count; /* different grid points */
  int32_t (*positions)[3];
  uint32_t *welded; /* mesh vertex -> vertex */
  uint32_t triangle_count, edge_count, point_count;
  uint32_t *triangles; /* mesh triangles that still have three different corners */
  struct glb_edge *edges;
  struct glb_point *points;
  uint32_t *first_wedge; /* mesh vertex -> one of its wedges, or LOD_NONE; NULL when nothing but triangles needs one */
};

LOD_WARN_UNUSED enum lod_status lod_glb_quantise(const struct lod_mesh *mesh, uint32_t only_part, double position_error,
                                                 struct lod_arena *arena, struct glb_unit *unit, struct lod_problem *problem);

static inline uint32_t glb_triangle_part(const struct glb_unit *unit, uint32_t t) {
  return unit->mesh->parts != NULL ? unit->mesh->parts[t] : unit->only_part;
}
static inline uint32_t glb_triangle_material(const struct lod_mesh *mesh, uint32_t t) {
  return mesh->materials != NULL ? mesh->materials[t] : LOD_NONE;
}

/* ---- glb_material.c ---- */

/* Which of the model's materials, textures and images a level uses, and their JSON with indices into those alone. */
struct glb_materials {
  uint32_t *material_index;                         /* model material -> index in the GLB, or LOD_NONE */
  uint8_t *uv_used;                                 /* model material -> bit s set: some texture reads UV set s */
  json_t *materials, *textures, *samplers, *images; /* arrays, maybe empty */
  json_t *used, *required;                          /* objects whose keys are extension names */
  uint32_t *embedded;                               /* model images to embed, in order of their place in `images`; LOD_NONE = by URI */
  uint32_t image_count;
};

/* uses: per model material, whether some primitive has it. The caller releases with finish, also after a failure. */
LOD_WARN_UNUSED enum lod_status lod_glb_materials_init(const struct lod_model *model, const bool *uses,
                                                       const struct lod_glb_settings *settings, struct lod_arena *arena,
                                                       struct glb_materials *materials, struct lod_problem *problem);
void lod_glb_materials_finish(struct glb_materials *materials);

/* A JSON string of any bytes: what is not UTF-8 becomes "?". */
json_t *lod_glb_text(const char *text);

/* ---- glb_primitive.c: what one primitive sends ---- */

enum glb_mode { GLB_POINTS = 0, GLB_LINES = 1, GLB_TRIANGLES = 4 };
enum glb_attribute { GLB_POSITION, GLB_NORMAL, GLB_TEXCOORD_0, GLB_TEXCOORD_1, GLB_COLOR_0, GLB_THICKNESS, GLB_ATTRIBUTES };
extern const char *const kGlbAttributeNames[GLB_ATTRIBUTES];

struct glb_array {
  enum lod_draco_component component;
  int components; /* 0: the primitive does not have this attribute */
  void *values;   /* count * components; NULL where Draco holds them */
};

struct glb_primitive {
  enum glb_mode mode;
  uint32_t unit, part, material; /* material of the model, or LOD_NONE */
  uint32_t begin, count;         /* of the group's items */
  /* Filled by building and encoding: */
  bool smooth_normals; /* left out, see lod_glb_settings.omit_smooth_normals */
  uint32_t vertex_count, index_count;
  struct glb_array attributes[GLB_ATTRIBUTES];
  float min[3], max[3];
  uint8_t *draco; /* NULL: plain arrays */
  size_t draco_size;
  uint32_t *indices; /* NULL with draco, and for points */
};

/* A primitive on its way through Draco; lives for a batch. */
struct glb_build {
  struct lod_arena *arena;
  struct lod_draco_encode_request request;
  struct lod_draco_input inputs[LOD_DRACO_MAX_INPUTS];
  const struct lod_glb_settings *settings;
  struct glb_primitive *primitive;
  struct lod_problem problem;
  enum lod_status status;
};

/* Scratch of the units' sizes; every entry LOD_NONE between calls. */
struct glb_scratch {
  uint32_t *vertices; /* the largest glb_unit.vertex_count */
  uint32_t *wedges;   /* the largest wedge_count */
};

/* order: the items (triangles, edges or points of the glb_unit) sorted by primitive. */
LOD_WARN_UNUSED enum lod_status lod_glb_build_triangles(const struct glb_unit *unit, const uint32_t *order, const struct lod_part *part,
                                                        uint8_t uv_used, const struct glb_scratch *scratch, struct glb_build *build);
/* Runs Draco on a build (any thread). Results in build->arena. */
void lod_glb_encode_triangles(struct glb_build *build);
/* LINES and POINTS: plain arrays in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_glb_build_lines(const struct glb_unit *unit, const uint32_t *order, const struct lod_part *part,
                                                    uint8_t uv_used, const struct lod_glb_settings *settings,
                                                    const struct glb_scratch *scratch, struct lod_arena *arena,
                                                    struct glb_primitive *primitive, struct lod_problem *problem);

#endif
