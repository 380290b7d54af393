/* Materials and textures of a scene that assimp read, as glTF. */
#ifndef LOD_CODEC_IMPORT_ASSIMP_MATERIAL_H
#define LOD_CODEC_IMPORT_ASSIMP_MATERIAL_H

#include "codec/import/reader.h"

struct aiScene;

/* Adds material `number` of the scene; LOD_NONE for one that assimp made up. */
LOD_WARN_UNUSED enum lod_status lod_assimp_material(struct lod_reader *reader, const struct aiScene *scene, uint32_t number,
                                                    uint32_t *material);

#endif
