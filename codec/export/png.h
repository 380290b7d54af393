/* Pictures as PNG. */
#ifndef LOD_CODEC_EXPORT_PNG_H
#define LOD_CODEC_EXPORT_PNG_H

#include <stdio.h>

#include "codec/export/picture.h"

/* 8-bit RGB, or RGBA where a pixel is not opaque. The file is not closed. LOD_IO, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_png_write(const struct lod_picture *picture, FILE *file, struct lod_problem *problem);

/* The same to bytes in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_png_encode(const struct lod_picture *picture, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                                               struct lod_problem *problem);

#endif
