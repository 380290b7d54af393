/* Materials and textures of a scene that assimp read, as glTF. */
#ifndef LOD_CODEC_IMPORT_ASSIMP_MATERIAL_H
#define LOD_CODEC_IMPORT_ASSIMP_MATERIAL_H

#include "codec/import/reader.h"

struct aiScene;

/* Adds material `number` of the scene; LOD_NONE for one that assimp made up. */
LOD_WARN_UNUSED enum lod_status lod_assimp_material(struct lod_reader *reader, const struct aiScene *scene, uint32_t number, uint32_t *material);

/* A file beside the model. These formats name files with absolute paths of the machine they were made on, so a name that is not safe is cut
 * to its last part and looked for beside the model. A missing file is a warning and *bytes NULL. */
LOD_WARN_UNUSED enum lod_status lod_assimp_open(struct lod_reader *reader, const char *path, struct lod_arena *arena, const uint8_t **bytes,
                                                size_t *size);

#endif
