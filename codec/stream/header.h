/* A frame's header, byte by byte as in codec/FORMAT.md. */
#ifndef LOD_CODEC_STREAM_HEADER_H
#define LOD_CODEC_STREAM_HEADER_H

#include "codec/stream/step.h"

/* Reads the header with what only the coder itself needs: the counts of the cut mesh and the first section's CRC. */
struct delta_inner {
  uint32_t cut_vertices, components, first_crc;
};
LOD_WARN_UNUSED enum lod_status lod_delta_read_header(const uint8_t *bytes, size_t size, struct lod_delta_header *header,
                                                      struct delta_inner *inner, struct lod_problem *problem);

/* Writes it; header_bytes and size are set. */
void lod_delta_write_header(struct lod_delta_header *header, const struct delta_inner *inner, uint8_t bytes[LOD_DELTA_MAX_HEADER_BYTES]);

/* The short form, of frames in an index (units.h), which has the rest: `header` comes in with its counts, grid and levels. */
LOD_WARN_UNUSED enum lod_status lod_delta_read_short(const uint8_t *bytes, size_t size, struct lod_delta_header *header,
                                                     struct delta_inner *inner, struct lod_problem *problem);
void lod_delta_write_short(struct lod_delta_header *header, const struct delta_inner *inner, uint8_t bytes[LOD_DELTA_MAX_HEADER_BYTES]);

#endif
