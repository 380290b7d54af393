/* Any bytes as a delta. The first byte says how the rest is meant: bit 0: as a whole frame, else as a body behind a header that is right
 * about it (its counts are the next 8 bytes), so that checksums do not stand in the way; bit 1: with a base, a small sphere. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/header.h"
#include "tests/fuzz/base.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { COUNTS = 8 };

static uint8_t *dress(const uint8_t *data, size_t *size, const struct lod_mesh *base, struct lod_arena *arena) {
  struct lod_delta_header header = {.from = LOD_NONE, .unit_count = 1, .grid = {{-2, -2, -2}, 1.f / 1024}};
  /* Not more than a short body can hold: what is allocated for the rest takes most of a run. */
  header.vertices = (uint32_t)(data[0] | (data[1] & 7) << 8);
  header.triangles = (uint32_t)(data[2] | (data[3] & 15) << 8);
  header.edges = data[6] & 15;
  header.points = data[6] >> 4;
  header.wedges = data[7];
  struct delta_inner inner = {.cut_vertices = header.vertices + data[4], .components = data[5]};
  if (base != NULL) {
    header.from = 0;
    header.to = 1;
    header.base_vertices = base->vertex_count;
    if (lod_delta_checksum(base, arena, &header.base_checksum) != LOD_OK)
      abort();
  }
  uint8_t bytes[LOD_DELTA_MAX_HEADER_BYTES];
  header.size = *size - COUNTS;
  inner.first_crc = lod_crc32(data + COUNTS, header.size);
  lod_delta_write_header(&header, &inner, bytes);
  uint8_t *frame = malloc(header.size);
  if (frame == NULL)
    abort();
  memcpy(frame, bytes, header.header_bytes);
  memcpy(frame + header.header_bytes, data + COUNTS, *size - COUNTS);
  *size = header.size;
  return frame;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  if (size < 1 + COUNTS)
    return 0;
  const int mode = data[0];
  struct lod_arena *arena = lod_arena_create((size_t)256 << 20), *own = lod_arena_create_child(arena);
  const struct lod_mesh *base = (mode & 2) != 0 ? lod_fuzz_base() : NULL;
  data++, size--;
  uint8_t *frame = NULL;
  if ((mode & 1) == 0)
    frame = dress(data, &size, base, own);
  struct lod_delta_header header;
  struct lod_delta_level level;
  struct lod_problem problem = {0};
  struct lod_arena *result = lod_arena_create_child(arena);
  enum lod_status status = lod_delta_decode(frame != NULL ? frame : data, size, base, NULL, result, &level, &problem);
  if (status == LOD_OK && !lod_mesh_check(&level.mesh, NULL))
    abort();
  if (status != LOD_OK && (problem.status != status || problem.detail[0] == '\0'))
    abort();
  if (lod_delta_inspect(frame != NULL ? frame : data, size, &header, NULL) == LOD_OK && lod_arena_peak_bytes(result) > header.memory_bytes)
    abort();
  lod_arena_destroy(result);
  lod_arena_destroy(own);
  lod_arena_destroy(arena);
  free(frame);
  return 0;
}
