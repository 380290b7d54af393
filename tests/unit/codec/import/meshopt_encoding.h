/* Attribute streams of EXT_meshopt_compression by an encoder of the plainest kind, straight from the extension's appendix A. */
#ifndef LOD_TESTS_UNIT_CODEC_IMPORT_MESHOPT_ENCODING_H
#define LOD_TESTS_UNIT_CODEC_IMPORT_MESHOPT_ENCODING_H

#include "tests/unit/codec/import/importing.h"

static inline uint8_t test_zigzag(uint8_t v) {
  return (uint8_t)((v & 0x80) ? ~(v << 1) : v << 1);
}

static inline void test_meshopt_group(struct test_bytes *stream, int encoding, const uint8_t deltas[16]) {
  if (encoding == 3)
    test_append(stream, deltas, 16);
  if (encoding == 0 || encoding == 3)
    return;
  int bits = encoding == 1 ? 2 : 4, per_byte = 8 / bits;
  uint8_t sentinel = (uint8_t)((1 << bits) - 1), packed[8] = {0};
  for (int i = 0; i < 16; i++)
    packed[i / per_byte] |= (uint8_t)((deltas[i] < sentinel ? deltas[i] : sentinel) << (8 - bits - i % per_byte * bits));
  test_append(stream, packed, (size_t)(16 / per_byte));
  for (int i = 0; i < 16; i++)
    if (deltas[i] >= sentinel)
      test_append(stream, &deltas[i], 1);
}

/* Every group in the encoding that `pick` names (or the plainest that can hold it). */
static inline struct test_bytes test_meshopt_attributes(const uint8_t *data, size_t count, size_t stride, int pick) {
  struct test_bytes stream = {0};
  uint8_t last[256] = {0};
  size_t most = 8192 / stride & ~(size_t)15;
  most = most < 256 ? most : 256;
  test_append(&stream, "\xA0", 1);
  memcpy(last, data, count ? stride : 0);
  uint8_t baseline[256];
  memcpy(baseline, last, sizeof baseline);
  for (size_t done = 0; done < count; done += most) {
    size_t elements = count - done < most ? count - done : most, groups = (elements + 15) / 16;
    for (size_t k = 0; k < stride; k++) {
      struct test_bytes body = {0};
      uint8_t header[4] = {0};
      for (size_t g = 0; g < groups; g++) {
        uint8_t deltas[16] = {0};
        int used = 0;
        for (size_t i = 0; i < 16 && g * 16 + i < elements; i++) {
          uint8_t value = data[(done + g * 16 + i) * stride + k];
          deltas[i] = test_zigzag((uint8_t)(value - last[k]));
          last[k] = value;
          used |= deltas[i];
        }
        int encoding = used == 0 ? 0 : pick;
        header[g / 4] |= (uint8_t)(encoding << (g % 4 * 2));
        test_meshopt_group(&body, encoding, deltas);
      }
      test_append(&stream, header, (groups + 3) / 4);
      test_append(&stream, body.bytes ? body.bytes : header, body.size);
      free(body.bytes);
    }
  }
  uint8_t padding[32] = {0};
  if (stride < 32)
    test_append(&stream, padding, 32 - stride);
  test_append(&stream, baseline, stride);
  return stream;
}

#endif
