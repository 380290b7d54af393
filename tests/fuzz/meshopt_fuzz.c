/* Byte 0: mode and filter; 1: stride; 2 and 3: count, up to 4095; the rest is the stream, in a buffer of its own. */
#include <stdlib.h>
#include <string.h>

#include "codec/import/meshopt.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  if (size < 4)
    return 0;
  size_t stride = (size_t)data[1] + 1, count = (size_t)data[2] | (size_t)(data[3] & 15) << 8;
  uint8_t *out = malloc(stride * count + 1), *stream = malloc(size - 4 ? size - 4 : 1);
  memcpy(stream, data + 4, size - 4);
  if (lod_meshopt_decode((enum lod_meshopt_mode)(data[0] % 3), (enum lod_meshopt_filter)(data[0] / 3 % 4), out, count, stride, stream,
                         size - 4, NULL) == LOD_OK) {
    /* Everything was written: reading it under the memory sanitizers' eyes changes nothing. */
    volatile uint8_t sum = 0;
    for (size_t i = 0; i < stride * count; i++)
      sum = (uint8_t)(sum + out[i]);
  }
  free(out);
  free(stream);
  return 0;
}
