/* A mesh as GLB without compression, for answers made while somebody waits: writing costs little more than copying. */
#ifndef LOD_CODEC_EXPORT_GLB_PLAIN_H
#define LOD_CODEC_EXPORT_GLB_PLAIN_H

#include "core/mesh/model.h"

struct lod_glb_plain_settings {
  const char *const *image_uris; /* image_count relative URIs; NULL: images are embedded */
  const char *generator;         /* asset.generator; NULL = ours */
  const char *extras_json;       /* asset.extras as JSON text, or NULL */
};

/* What a vertex and a triangle of a mesh with normals and without UV and colours take: for a budget of bytes. */
enum { LOD_GLB_PLAIN_VERTEX = 16, LOD_GLB_PLAIN_TRIANGLE = 12 };

/* mesh: all of the model in model space, parts and materials tagged as model has them (instances placed already). Positions are the mesh's
 * own floats; normals 8 bits a component (KHR_mesh_quantization, then required), UV float, colours 8 bits. A mesh for each part; free edges
 * and points with _THICKNESS. Bytes in `arena`. LOD_BAD_INPUT: a part or material that the model does not have; LOD_LIMIT: over 4 GiB. */
LOD_WARN_UNUSED enum lod_status lod_glb_write_plain(const struct lod_model *model, const struct lod_mesh *mesh,
                                                    const struct lod_glb_plain_settings *settings, struct lod_arena *arena, uint8_t **bytes,
                                                    size_t *size, struct lod_problem *problem);

#endif
