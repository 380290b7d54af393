/* Headers of our formats: varints, fixed little-endian numbers, a cyclic checksum. Reading checks every length. */
#ifndef LOD_CODEC_STREAM_BYTES_H
#define LOD_CODEC_STREAM_BYTES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct lod_reader {
  const uint8_t *at, *end;
  bool failed; /* something was missing or too large; every value read since is 0 */
};

uint32_t lod_read_fixed(struct lod_reader *reader, int bytes); /* 1 to 4, little-endian */
uint32_t lod_read_varint(struct lod_reader *reader);           /* 7 bits a byte, lowest first; up to 32 bits */
float lod_read_float(struct lod_reader *reader);

/* Into a buffer that the caller knows to be large enough (5 bytes for a varint). */
struct lod_writer {
  uint8_t *at;
};
void lod_write_fixed(struct lod_writer *writer, uint32_t value, int bytes);
void lod_write_varint(struct lod_writer *writer, uint32_t value);
void lod_write_float(struct lod_writer *writer, float value);

/* CRC-32 (ISO 3309, as in PNG and zlib) of `size` bytes. */
uint32_t lod_crc32(const uint8_t *bytes, size_t size);

#endif
