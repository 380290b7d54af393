#include "codec/stream/header.h"

#include <string.h>

#include "codec/stream/bytes.h"

static const uint8_t kMagic[4] = {'L', 'O', 'D', 'D'};
enum { FLAG_BASE = 1, FLAGS = FLAG_BASE };

/* What decoding holds at once, bounds for what step.h's arrays, connectivity.c's nodes, and the result take; the models of all contexts are
 * the constant. tests/unit/codec/stream compares it with what is really taken. */
enum {
  PER_TRIANGLE = 196,
  PER_VERTEX = 308,
  PER_CUT_VERTEX = 56,
  PER_COMPONENT = 80,
  PER_BASE_VERTEX = 128,
  PER_PRIMITIVE = 72,
  PER_WEDGE = 160,
  MODELS = 2 << 20
};

static uint64_t memory_of(const struct lod_delta_header *h, const struct delta_inner *inner) {
  return MODELS + (uint64_t)PER_TRIANGLE * h->triangles + (uint64_t)PER_VERTEX * h->vertices +
         (uint64_t)PER_CUT_VERTEX * inner->cut_vertices + (uint64_t)PER_COMPONENT * inner->components +
         (uint64_t)PER_BASE_VERTEX * h->base_vertices + (uint64_t)PER_PRIMITIVE * ((uint64_t)h->edges + h->points) +
         (uint64_t)PER_WEDGE * h->wedges;
}

/* Whether the counts can belong to one another and to so many bytes. A bit model's probability ends at 1 / 4096, so a triangle, which takes
 * at least one decision, costs at least 1 / 2900 bits; the free share is for the smallest meshes. */
static bool plausible(const struct lod_delta_header *h, const struct delta_inner *inner) {
  const uint64_t most = ((uint64_t)1 << 16) + 23000 * (uint64_t)(h->size - h->header_bytes);
  return h->triangles <= most && h->vertices <= most && h->edges <= most && h->points <= most && h->wedges <= most &&
         inner->cut_vertices <= 3 * (uint64_t)h->triangles && inner->components <= h->triangles && h->triangles < UINT32_MAX / 6 &&
         h->base_vertices < UINT32_MAX / 6 && h->edges < UINT32_MAX / 6 && h->wedges <= 3 * (uint64_t)h->triangles;
}

enum lod_status lod_delta_read_header(const uint8_t *bytes, size_t size, struct lod_delta_header *header, struct delta_inner *inner,
                                      struct lod_problem *problem) {
  struct lod_reader r = {.at = bytes, .end = bytes + size};
  struct lod_delta_header h = {0};
  *inner = (struct delta_inner){0};
  if (size < 6)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A delta of %zu bytes ends inside its header.", size);
  if (memcmp(bytes, kMagic, sizeof kMagic) != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "delta", "A delta begins with the letters LODD; these bytes do not.");
  r.at += sizeof kMagic;
  h.version = lod_read_fixed(&r, 1);
  const uint32_t flags = lod_read_fixed(&r, 1);
  if (h.version != LOD_DELTA_VERSION || (flags & ~(uint32_t)FLAGS) != 0)
    return lod_fail(problem, LOD_UNSUPPORTED, "delta-version", "A delta has version %u, flags %u; version %d is known.", h.version, flags,
                    LOD_DELTA_VERSION);
  uint32_t *const counts[] = {&h.to,    &h.unit,   &h.unit_count, &h.vertices, &h.triangles, &inner->cut_vertices, &inner->components,
                              &h.edges, &h.points, &h.wedges};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    *counts[i] = lod_read_varint(&r);
  const size_t body = lod_read_varint(&r);
  h.from = LOD_NONE;
  if ((flags & FLAG_BASE) != 0) {
    h.from = lod_read_varint(&r);
    h.base_vertices = lod_read_varint(&r);
    h.base_checksum = lod_read_fixed(&r, 4);
  }
  h.checksum = lod_read_fixed(&r, 4);
  for (int i = 0; i < 3; i++)
    h.grid.origin[i] = lod_read_float(&r);
  h.grid.step = lod_read_float(&r);
  inner->first_crc = lod_read_fixed(&r, 4);
  const size_t checked = (size_t)(r.at - bytes);
  const uint32_t crc = lod_read_fixed(&r, 2);
  h.header_bytes = (size_t)(r.at - bytes);
  h.size = h.header_bytes + body;
  if (r.failed && size < LOD_DELTA_MAX_HEADER_BYTES)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A delta of %zu bytes ends inside its header.", size);
  if (r.failed || (lod_crc32(bytes, checked) & 0xffff) != crc)
    return lod_fail(problem, LOD_BAD_INPUT, "delta", "A delta's header is damaged: its checksum is not that of its bytes.");
  bool grid = h.grid.step > 0 && h.grid.step <= 3e38f;
  for (int i = 0; i < 3; i++)
    grid = grid && h.grid.origin[i] >= -3e38f && h.grid.origin[i] <= 3e38f;
  if (!grid || !plausible(&h, inner) || h.unit >= h.unit_count)
    return lod_fail(problem, LOD_BAD_INPUT, "delta",
                    "A delta of %zu bytes declares %u vertices and %u triangles, or a grid or unit, that cannot be.", body, h.vertices,
                    h.triangles);
  h.memory_bytes = memory_of(&h, inner);
  *header = h;
  return LOD_OK;
}

enum lod_status lod_delta_inspect(const uint8_t *bytes, size_t size, struct lod_delta_header *header, struct lod_problem *problem) {
  struct delta_inner inner;
  return lod_delta_read_header(bytes, size, header, &inner, problem);
}

void lod_delta_write_header(struct lod_delta_header *h, const struct delta_inner *inner, uint8_t bytes[LOD_DELTA_MAX_HEADER_BYTES]) {
  struct lod_writer w = {.at = bytes};
  const size_t body = h->size;
  memcpy(w.at, kMagic, sizeof kMagic);
  w.at += sizeof kMagic;
  lod_write_fixed(&w, LOD_DELTA_VERSION, 1);
  lod_write_fixed(&w, h->from != LOD_NONE ? FLAG_BASE : 0, 1);
  const uint32_t counts[] = {h->to,    h->unit,   h->unit_count, h->vertices, h->triangles, inner->cut_vertices, inner->components,
                             h->edges, h->points, h->wedges};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    lod_write_varint(&w, counts[i]);
  lod_write_varint(&w, (uint32_t)body);
  if (h->from != LOD_NONE) {
    lod_write_varint(&w, h->from);
    lod_write_varint(&w, h->base_vertices);
    lod_write_fixed(&w, h->base_checksum, 4);
  }
  lod_write_fixed(&w, h->checksum, 4);
  for (int i = 0; i < 3; i++)
    lod_write_float(&w, h->grid.origin[i]);
  lod_write_float(&w, h->grid.step);
  lod_write_fixed(&w, inner->first_crc, 4);
  lod_write_fixed(&w, lod_crc32(bytes, (size_t)(w.at - bytes)) & 0xffff, 2);
  h->version = LOD_DELTA_VERSION;
  h->header_bytes = (size_t)(w.at - bytes);
  h->size = h->header_bytes + body;
  h->memory_bytes = memory_of(h, inner);
}

enum lod_status lod_delta_read_short(const uint8_t *bytes, size_t size, struct lod_delta_header *h, struct delta_inner *inner,
                                     struct lod_problem *problem) {
  struct lod_reader r = {.at = bytes, .end = bytes + size};
  *inner = (struct delta_inner){0};
  inner->cut_vertices = lod_read_varint(&r);
  inner->components = lod_read_varint(&r);
  h->wedges = lod_read_varint(&r);
  inner->first_crc = lod_read_fixed(&r, 4);
  h->version = LOD_DELTA_VERSION;
  h->header_bytes = (size_t)(r.at - bytes);
  h->size = size;
  if (r.failed)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A unit of %zu bytes ends inside its header.", size);
  if (!plausible(h, inner))
    return lod_fail(problem, LOD_BAD_INPUT, "delta", "A unit of %zu bytes declares %u vertices and %u triangles, which cannot be.", size,
                    h->vertices, h->triangles);
  h->memory_bytes = memory_of(h, inner);
  return LOD_OK;
}

void lod_delta_write_short(struct lod_delta_header *h, const struct delta_inner *inner, uint8_t bytes[LOD_DELTA_MAX_HEADER_BYTES]) {
  struct lod_writer w = {.at = bytes};
  const size_t body = h->size;
  lod_write_varint(&w, inner->cut_vertices);
  lod_write_varint(&w, inner->components);
  lod_write_varint(&w, h->wedges);
  lod_write_fixed(&w, inner->first_crc, 4);
  h->version = LOD_DELTA_VERSION;
  h->header_bytes = (size_t)(w.at - bytes);
  h->size = h->header_bytes + body;
  h->memory_bytes = memory_of(h, inner);
}
