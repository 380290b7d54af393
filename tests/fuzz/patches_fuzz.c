/* A patch stream, its checksum mended so that what lies behind it is reached; what decodes is tessellated. */
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/patches.h"
#include "core/clod/tessellate.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  struct lod_arena *arena = lod_arena_create((size_t)256 << 20);
  struct lod_patches_header header;
  struct lod_patches patches;
  struct lod_problem problem = {0};
  uint8_t *bytes = malloc(size > 0 ? size : 1);
  memcpy(bytes, data, size);
  if (lod_patches_inspect(bytes, size, &header, &problem) == LOD_OK && header.size <= size) {
    const size_t frame = header.size; /* decoding fills the header again */
    /* The checksum stands before the body, whose length the varint before it tells: find it by trying. */
    for (size_t body = 5; body < size && body < 96; body++)
      if (body < frame && body >= 9) {
        uint32_t crc = lod_crc32(bytes + body, frame - body);
        uint8_t mended[4] = {(uint8_t)crc, (uint8_t)(crc >> 8), (uint8_t)(crc >> 16), (uint8_t)(crc >> 24)}, old[4];
        memcpy(old, bytes + body - 4, 4);
        memcpy(bytes + body - 4, mended, 4);
        struct lod_problem ignored = {0};
        enum lod_status status = lod_patches_decode(bytes, size, 20000, arena, &header, &patches, &ignored);
        if (status == LOD_OK) {
          if (!lod_patches_check(&patches, NULL))
            abort();
          struct lod_tessellate_settings settings = lod_tessellate_defaults();
          struct lod_tessellation flat;
          settings.tolerance = 1;
          if (patches.patch_count < 100 && lod_tessellate(&patches, &settings, arena, &flat, &ignored) == LOD_OK &&
              flat.mesh.triangle_count < patches.patch_count)
            abort();
          break;
        }
        memcpy(bytes + body - 4, old, 4);
      }
  }
  free(bytes);
  lod_arena_destroy(arena);
  return 0;
}
