#include "codec/stream/bytes.h"

#include <string.h>

uint32_t lod_read_fixed(struct lod_reader *r, int bytes) {
  uint32_t value = 0;
  if (r->failed || r->end - r->at < bytes) {
    r->failed = true;
    return 0;
  }
  for (int i = 0; i < bytes; i++)
    value |= (uint32_t)*r->at++ << (8 * i);
  return value;
}

uint32_t lod_read_varint(struct lod_reader *r) {
  uint64_t value = 0;
  for (int shift = 0; shift < 35; shift += 7) {
    uint32_t byte = lod_read_fixed(r, 1);
    value |= (uint64_t)(byte & 127) << shift;
    if (byte < 128) {
      r->failed = r->failed || value > UINT32_MAX;
      return r->failed ? 0 : (uint32_t)value;
    }
  }
  r->failed = true;
  return 0;
}

float lod_read_float(struct lod_reader *r) {
  uint32_t bits = lod_read_fixed(r, 4);
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

void lod_write_fixed(struct lod_writer *w, uint32_t value, int bytes) {
  for (int i = 0; i < bytes; i++)
    *w->at++ = (uint8_t)(value >> (8 * i));
}

void lod_write_varint(struct lod_writer *w, uint32_t value) {
  while (value >= 128) {
    *w->at++ = (uint8_t)(value | 128);
    value >>= 7;
  }
  *w->at++ = (uint8_t)value;
}

void lod_write_float(struct lod_writer *w, float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  lod_write_fixed(w, bits, 4);
}

uint32_t lod_crc32(const uint8_t *bytes, size_t size) {
  static const uint32_t kNibble[16] = {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
                                       0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};
  uint32_t crc = UINT32_MAX;
  for (size_t i = 0; i < size; i++) {
    crc ^= bytes[i];
    crc = crc >> 4 ^ kNibble[crc & 15];
    crc = crc >> 4 ^ kNibble[crc & 15];
  }
  return ~crc;
}
