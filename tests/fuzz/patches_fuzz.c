/* A patch stream, its checksum mended so that what lies behind it is reached; what decodes is tessellated. */
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/patches.h"
#include "core/clod/tessellate.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* As patches.c writes it: magic and version, 5 counts, 5 floats, the body's length, its checksum. */
static void mend_checksum(uint8_t *bytes, size_t frame) {
  struct lod_reader r = {.at = bytes + 5, .end = bytes + frame};
  for (int i = 0; i < 5; i++)
    lod_read_varint(&r);
  for (int i = 0; i < 5; i++)
    lod_read_float(&r);
  lod_read_varint(&r);
  if (r.failed || r.end - r.at < 4)
    return;
  struct lod_writer w = {.at = (uint8_t *)(uintptr_t)r.at};
  lod_write_fixed(&w, lod_crc32(r.at + 4, (size_t)(r.end - r.at) - 4), 4);
}

static void tessellate(const struct lod_patches *patches, struct lod_arena *arena) {
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  struct lod_tessellation flat;
  struct lod_problem problem = {0};
  settings.tolerance = 1;
  settings.threads = 1;
  settings.normals = true; /* UVs and colours go with them */
  if (patches->patch_count < 100 && lod_tessellate(patches, &settings, arena, &flat, &problem) == LOD_OK &&
      flat.mesh.triangle_count < patches->patch_count)
    abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  struct lod_arena *arena = lod_arena_create((size_t)256 << 20);
  struct lod_patches_header header;
  struct lod_patches patches;
  struct lod_problem problem = {0};
  uint8_t *bytes = malloc(size > 0 ? size : 1);
  memcpy(bytes, data, size);
  if (lod_patches_inspect(bytes, size, &header, &problem) == LOD_OK && header.size <= size)
    mend_checksum(bytes, header.size);
  if (lod_patches_decode(bytes, size, 2000, arena, &header, &patches, &problem) == LOD_OK) {
    if (!lod_patches_check(&patches, NULL))
      abort();
    tessellate(&patches, arena);
  } else if (problem.detail[0] == '\0') {
    abort();
  }
  free(bytes);
  lod_arena_destroy(arena);
  return 0;
}
