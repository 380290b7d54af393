/* A level as GLB: KHR_draco_mesh_compression for triangles, plain accessors for LINES and POINTS (with _THICKNESS), materials as they
 * came, textures by relative URI (the object's SHA-256, a sibling of the GLB wherever it is served from), a node per part and instance. */
#ifndef LOD_CODEC_EXPORT_GLB_H
#define LOD_CODEC_EXPORT_GLB_H

#include "codec/export/draco.h"
#include "core/mesh/model.h"

/* Positions lie on a grid per unit: origin + step * integer, the same grid for all parts of the unit, so that shared vertices coincide. */
struct lod_glb_settings {
  double position_error; /* quantisation moves no position by more than this, in model units (> 0); the writer picks the grid */
  int normal_bits;       /* octahedral, 2 to 16; default 8 */
  int uv_bits;           /* steps of 2^-uv_bits in UV, whatever the range; default 12 */
  int color_bits;        /* 1 to 16 a channel; default 8 */
  int draco_speed;       /* 0 = smallest ... 9 = fastest; -1 (default) = by size: what README.md recommends and measured */
  /* Leave normals out where a client can compute them: all of a primitive within 3 degrees of the area-weighted mean of the faces at that
   * position. The primitive then says extras.normals = "smooth". Viewers that do not know this show facets; default false. */
  bool omit_smooth_normals;
  bool keep_unused_uvs;          /* also send UV sets that no texture of the material refers to; default false */
  uint32_t threads;              /* as lod_parallel_for; the bytes do not depend on it */
  const char *const *image_uris; /* image_count relative URIs; NULL: images are embedded in the GLB */
  const char *generator;         /* asset.generator */
  const char *extras_json;       /* asset.extras as JSON text, or NULL */
};
struct lod_glb_settings lod_glb_defaults(void);

/* meshes: unit_count level meshes of model's units. Bytes in `arena`.
 *
 * What rounding to the grid makes of every triangle, edge and point is in the GLB: a triangle that collapses to a segment or point no
 * other primitive covers goes out as LINES or POINTS. So the two-sided distance between `meshes` and what a client decodes is at most
 * position_error, unless the grid had to be coarser than that (draco.h says when; measuring the decoded mesh shows it). */
LOD_WARN_UNUSED enum lod_status lod_glb_write(const struct lod_model *model, const struct lod_mesh *meshes,
                                              const struct lod_glb_settings *settings, struct lod_arena *arena, uint8_t **bytes,
                                              size_t *size, struct lod_problem *problem);

/* The model's materials alone as a glTF document (JSON, in `arena`), material i being the model's: for clients of streams that name
 * materials by number. image_uris: as in the settings, not NULL. */
LOD_WARN_UNUSED enum lod_status lod_gltf_materials_write(const struct lod_model *model, const char *const *image_uris,
                                                         struct lod_arena *arena, char **text, struct lod_problem *problem);

/* The grid on which lod_glb_write puts the positions of a unit's level: with lod_draco_grid_index and lod_draco_grid_point, where each
 * vertex goes. position_error: in unit space, so that of the settings over the unit's scale. */
struct lod_draco_grid lod_glb_grid(const struct lod_mesh *mesh, double position_error);

/* Decodes what lod_glb_write wrote: unit_count meshes in unit space (welded by position; parts and materials tagged as the model has
 * them), the way a client sees it. Checks every length and index; reads only this file's own kind of GLB (import.h reads any). Used to
 * certify a level after decoding. */
LOD_WARN_UNUSED enum lod_status lod_glb_read(const uint8_t *bytes, size_t size, const struct lod_model *model, struct lod_arena *arena,
                                             struct lod_mesh *meshes, struct lod_problem *problem);

#endif
