/* Decoder of EXT_meshopt_compression, written from the extension's specification.
 *
 * Every read and write is bounded; streams that the encoder would not make (wrong header, wrong length, bytes left over, indices out of
 * range of 32 bits) are refused. Runs in time linear in count * stride. */
#ifndef LOD_CODEC_IMPORT_MESHOPT_H
#define LOD_CODEC_IMPORT_MESHOPT_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum lod_meshopt_mode { LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_TRIANGLES, LOD_MESHOPT_INDICES };
enum lod_meshopt_filter { LOD_MESHOPT_NONE, LOD_MESHOPT_OCTAHEDRAL, LOD_MESHOPT_QUATERNION, LOD_MESHOPT_EXPONENTIAL };

/* Fills out: count * stride bytes, little-endian as glTF buffers are.
 * stride: ATTRIBUTES: a multiple of 4 up to 256; TRIANGLES, INDICES: 2 or 4.
 * filter: with ATTRIBUTES only; OCTAHEDRAL needs stride 4 or 8, QUATERNION 8.
 * count: TRIANGLES: a multiple of 3.
 * LOD_BAD_INPUT ("bad-meshopt") when the arguments or the stream are wrong. */
LOD_WARN_UNUSED enum lod_status lod_meshopt_decode(enum lod_meshopt_mode mode, enum lod_meshopt_filter filter, uint8_t *out, size_t count,
                                                   size_t stride, const uint8_t *bytes, size_t size, struct lod_problem *problem);

#endif
