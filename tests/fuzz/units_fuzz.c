/* Any bytes as a step in units over a small sphere. The first byte says how: bit 0: checksums are mended first (of the index, of the base
 * in it, of each unit), so that they do not stand in the way; bit 1: what was decoded is drawn in part too. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/units.h"
#include "core/mesh/overlay.h"
#include "tests/fuzz/base.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void write_crc(uint8_t *at, uint32_t value) {
  struct lod_writer w = {.at = at};
  lod_write_fixed(&w, value, 4);
}

static void mend_index(uint8_t *bytes, size_t size, const struct lod_mesh *base, struct lod_arena *arena) {
  struct lod_reader r = {.at = bytes + LOD_UNITS_INDEX_HEAD, .end = bytes + size};
  size_t length;
  uint32_t checksum;
  if (lod_units_index_bytes(bytes, size, &length, NULL) != LOD_OK || length > size)
    return;
  for (int i = 0; i < 9; i++)
    lod_read_varint(&r);
  if (lod_delta_checksum(base, arena, &checksum) == LOD_OK && !r.failed && bytes + length - r.at >= 8)
    write_crc((uint8_t *)(uintptr_t)r.at, checksum);
  write_crc(bytes + length - 4, lod_crc32(bytes, length - 4));
}

static void mend_unit(uint8_t *bytes, size_t size) {
  struct lod_reader r = {.at = bytes, .end = bytes + size};
  for (int i = 0; i < 3; i++)
    lod_read_varint(&r);
  if (!r.failed && r.end - r.at >= 4)
    write_crc((uint8_t *)(uintptr_t)r.at, lod_crc32(r.at + 4, (size_t)(r.end - r.at) - 4));
}

static void draw(const struct lod_units *units, const struct lod_delta_level *const *levels, const struct lod_delta_level *joined,
                 struct lod_arena *arena) {
  struct lod_overlay overlay;
  struct lod_morph morph;
  uint32_t *parents = lod_arena_copy(arena, joined->kept, units->base->vertex_count * sizeof *parents);
  if (parents == NULL)
    return;
  lod_units_settle(units, levels, parents);
  if (lod_overlay_create(units->base, &joined->mesh, parents, NULL, arena, &overlay, NULL) == LOD_OK &&
      lod_overlay_part(&overlay, units->base, &joined->mesh, NULL, NULL, arena, &morph) == LOD_MEMORY)
    return; /* 256 MiB are not to be had */
}

static void decode(struct lod_units *units, uint8_t *bytes, size_t size, int mode, struct lod_arena *arena) {
  const uint32_t count = units->header.patch_count;
  struct lod_delta_level *levels = LOD_NEW_ZERO(arena, count, struct lod_delta_level), joined;
  const struct lod_delta_level **at_hand = LOD_NEW_ZERO(arena, count, const struct lod_delta_level *);
  for (uint32_t p = 0; p < count && levels != NULL && at_hand != NULL; p++) {
    const struct lod_units_patch *patch = &units->patches[p];
    struct lod_problem problem = {0};
    if (patch->size == 0 || patch->offset > size)
      continue;
    const size_t left = size - patch->offset;
    if ((mode & 1) != 0)
      mend_unit(bytes + patch->offset, patch->size < left ? patch->size : left);
    enum lod_status status = lod_units_decode(units, p, bytes + patch->offset, left, NULL, arena, &levels[p], &problem);
    if (status == LOD_OK && !lod_mesh_check(&levels[p].mesh, NULL))
      abort();
    if (status != LOD_OK && (problem.status != status || problem.detail[0] == '\0'))
      abort();
    at_hand[p] = status == LOD_OK ? &levels[p] : NULL;
  }
  if (levels == NULL || at_hand == NULL || lod_units_join(units, at_hand, arena, &joined, NULL) != LOD_OK)
    return;
  if (!lod_mesh_check(&joined.mesh, NULL))
    abort();
  if ((mode & 2) != 0)
    draw(units, at_hand, &joined, arena);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  if (size < 1)
    return 0;
  struct lod_arena *arena = lod_arena_create((size_t)256 << 20);
  struct lod_units units;
  struct lod_problem problem = {0};
  uint8_t *bytes = malloc(size);
  if (bytes == NULL)
    abort();
  memcpy(bytes, data + 1, size - 1);
  if ((data[0] & 1) != 0)
    mend_index(bytes, size - 1, lod_fuzz_base(), arena);
  const enum lod_status status = lod_units_open(bytes, size - 1, lod_fuzz_base(), NULL, arena, &units, &problem);
  if (status != LOD_OK && (problem.status != status || problem.detail[0] == '\0'))
    abort();
  if (status == LOD_OK)
    decode(&units, bytes, size - 1, data[0], arena);
  free(bytes);
  lod_arena_destroy(arena);
  return 0;
}
