#include <stdlib.h>

#include "clients/native/stream.h"
#include "core/mesh/copy.h"

struct lodestream *lodestream_create(size_t memory) {
  struct lodestream *stream = calloc(1, sizeof *stream);
  if (stream != NULL)
    stream->arena = lod_arena_create(memory);
  if (stream != NULL && stream->arena == NULL) {
    free(stream);
    return NULL;
  }
  return stream;
}

void lodestream_destroy(struct lodestream *stream) {
  if (stream == NULL)
    return;
  lodestream_units_drop(stream);
  lod_arena_destroy(stream->before.arena);
  lod_arena_destroy(stream->now.arena);
  lod_arena_destroy(stream->arena);
  free(stream);
}

void lodestream_step(struct lodestream *stream, const struct held *next) {
  lodestream_units_drop(stream); /* its base goes */
  lod_arena_destroy(stream->before.arena);
  stream->before = stream->now;
  stream->now = *next;
}

enum lod_status lodestream_start(struct lodestream *stream, const struct lod_mesh *level, struct lod_problem *problem) {
  struct held next = {.arena = lod_arena_create_child(stream->arena)};
  if (next.arena == NULL || lod_mesh_copy(level, next.arena, &next.level.mesh) != LOD_OK) {
    lod_arena_destroy(next.arena);
    return lod_fail_memory(problem);
  }
  lodestream_step(stream, &next);
  return LOD_OK;
}

enum lod_status lodestream_feed(struct lodestream *stream, uint32_t unit, const uint8_t *bytes, size_t size, size_t *used,
                                struct lod_problem *problem) {
  struct lod_delta_header header;
  struct lod_problem why = {0};
  *used = 0;
  enum lod_status status = lod_delta_inspect(bytes, size, &header, &why);
  if (status != LOD_OK && size < LOD_DELTA_MAX_HEADER_BYTES && why.type[0] == 't') /* "truncated": more is to come */
    return LOD_OK;
  if (status != LOD_OK)
    return lod_fail(problem, status, why.type, "%s", why.detail);
  if (size < header.size)
    return LOD_OK;
  *used = header.size;
  if (header.unit != unit)
    return LOD_OK;
  struct held next = {.arena = lod_arena_create_child(stream->arena)};
  if (next.arena == NULL)
    return lod_fail_memory(problem);
  const bool based = header.from != LOD_NONE && stream->now.arena != NULL;
  status = lod_delta_decode(bytes, size, based ? &stream->now.level.mesh : NULL, NULL, next.arena, &next.level, problem);
  if (status == LOD_OK)
    lodestream_step(stream, &next);
  else
    lod_arena_destroy(next.arena);
  return status;
}

const struct lod_mesh *lodestream_level(const struct lodestream *stream) {
  return stream->now.arena == NULL ? NULL : &stream->now.level.mesh;
}

enum lod_status lodestream_morph(struct lodestream *stream, const struct lod_morph **morph, struct lod_problem *problem) {
  struct held *now = &stream->now;
  *morph = NULL;
  if (now->arena == NULL || now->level.kept == NULL)
    return LOD_OK;
  if (!now->morphs) {
    const struct lod_mesh *coarse = &stream->before.level.mesh, *fine = &now->level.mesh;
    struct lod_arena *scratch = lod_arena_create_child(now->arena);
    struct lod_overlay overlay;
    if (scratch == NULL)
      return lod_fail_memory(problem);
    enum lod_status status = lod_overlay_create(coarse, fine, now->level.kept, NULL, scratch, &overlay, problem);
    if (status == LOD_OK && (status = lod_overlay_fragments(&overlay, coarse, fine, NULL, now->arena, &now->morph)) == LOD_MEMORY)
      status = lod_fail_memory(problem);
    lod_arena_destroy(scratch);
    LOD_TRY(status);
    now->morphs = true;
  }
  *morph = &now->morph;
  return LOD_OK;
}
