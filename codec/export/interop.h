/* A bake's levels as clients of others take them: a tileset of 3D Tiles, and a glTF whose levels are MSFT_lod.
 *
 * Based on: Open Geospatial Consortium. 3D Tiles Specification 1.1 (22-025r4), and the glTF vendor extension MSFT_lod. Both are small
 * documents over the levels' own GLBs, of which not a byte is rewritten, so what is certified stays certified. */
#ifndef LOD_CODEC_EXPORT_INTEROP_H
#define LOD_CODEC_EXPORT_INTEROP_H

#include <jansson.h>
#include <stdint.h>

#include "core/base/status.h"

enum { LOD_INTEROP_LEVELS = 24, LOD_INTEROP_URI = 96 };

struct lod_interop_level {
  const char *family; /* these two belong to the manifest */
  const char *object; /* SHA-256 of its GLB, 64 hexadecimal digits */
  uint32_t number;    /* within its family */
  double error;       /* certified, model units */
  uint64_t bytes;
  char uri[LOD_INTEROP_URI]; /* where the documents say that it lies; the object's name unless the caller writes another */
};

/* Levels of all families that no other betters in bytes without more error, thinned so that each has at least twice the bytes of the one
 * before; coarsest first, the finest among them. 0 when the manifest has none that is a GLB. */
uint32_t lod_interop_choose(const json_t *manifest, struct lod_interop_level levels[LOD_INTEROP_LEVELS]);

/* tileset.json: one tile a level, each replaced by its only child, the next finer one. geometricError is the certified error, in model
 * units taken as metres; the tileset's own is the diagonal. The volume is the source's sphere, widened by each level's error, in the axes
 * of 3D Tiles (z up), to which clients turn glTF content (y up). The caller frees *text. */
LOD_WARN_UNUSED enum lod_status lod_interop_tileset(const json_t *manifest, const struct lod_interop_level *levels, uint32_t count,
                                                    char **text, struct lod_problem *problem);

/* A glTF whose scene is the finest level, with the coarser ones as its MSFT_lod and, in MSFT_screencoverage, the least share of the screen
 * at which each still errs by less than a pixel of 1080 lines. Buffers are the levels' GLBs as they are, each from its first byte, found in
 * objects/ of the bake. The caller frees *text. LOD_BAD_INPUT when an object is no GLB of ours. */
LOD_WARN_UNUSED enum lod_status lod_interop_gltf(const json_t *manifest, const struct lod_interop_level *levels, uint32_t count,
                                                 int bake_directory_fd, char **text, struct lod_problem *problem);

/* `text` as a GLB without a binary chunk. The caller frees *glb. */
LOD_WARN_UNUSED enum lod_status lod_interop_glb(const char *text, uint8_t **glb, size_t *size, struct lod_problem *problem);

#endif
