/* One import of fuzzed bytes, with small limits so that a run is short: what the limits refuse was checked before it was allocated. */
#ifndef LOD_TESTS_FUZZ_IMPORTING_H
#define LOD_TESTS_FUZZ_IMPORTING_H

#include <stdlib.h>
#include <string.h>

#include "codec/import/import.h"

/* Every name exists and has the fuzzed bytes themselves. */
struct fuzz_bytes {
  const uint8_t *bytes;
  size_t size;
};

static enum lod_status fuzz_read(void *context, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                                 struct lod_problem *problem) {
  const struct fuzz_bytes *self = context;
  bool climbs = strcmp(uri, "..") == 0 || strncmp(uri, "../", 3) == 0 || strstr(uri, "/../");
  if (uri[0] == '/' || climbs || (strlen(uri) >= 3 && strcmp(uri + strlen(uri) - 3, "/..") == 0))
    abort(); /* an unsafe name must never come this far */
  if (strlen(uri) % 3 == 0)
    return lod_fail(problem, LOD_BAD_INPUT, "missing-file", "'%.100s' is not there", uri);
  *bytes = lod_arena_copy(arena, self->bytes, self->size);
  *size = self->size;
  return *bytes ? LOD_OK : lod_fail_memory(problem);
}

/* most: vertices and triangles. */
static inline void fuzz_import_at_most(const uint8_t *bytes, size_t size, const char *format, uint32_t most) {
  struct lod_import_limits limits = lod_import_limits_defaults();
  limits.max_bytes = 1 << 22;
  limits.max_vertices = limits.max_triangles = most;
  limits.max_instances = 1000;
  struct fuzz_bytes self = {bytes, size};
  struct lod_import_files files = {fuzz_read, &self};
  struct lod_arena *arena = lod_arena_create((size_t)256 << 20);
  struct lod_model model;
  struct lod_problem problem = {0};
  struct lod_import_request request = {
      .name = "fuzz", .format = format, .bytes = bytes, .size = size, .files = &files, .limits = &limits, .threads = 1};
  if (!arena)
    return;
  enum lod_status status = lod_import_model(&request, arena, &model, &problem);
  if ((status == LOD_OK) != (problem.type[0] == 0))
    abort(); /* a problem without failure, or a failure without a problem */
  for (uint32_t u = 0; u < model.unit_count; u++)
    if (!lod_mesh_check(&model.units[u].mesh, NULL))
      abort();
  lod_arena_destroy(arena);
}

static inline void fuzz_import(const uint8_t *bytes, size_t size, const char *format) {
  fuzz_import_at_most(bytes, size, format, 4000);
}

#endif
