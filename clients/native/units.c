#include <string.h>

#include "clients/native/stream.h"

void lodestream_units_drop(struct lodestream *stream) {
  lod_arena_destroy(stream->step.drawn);
  lod_arena_destroy(stream->step.arena);
  stream->step = (struct unfinished){0};
}

enum lod_status lodestream_units_begin(struct lodestream *stream, const uint8_t *bytes, size_t size, struct lod_problem *problem) {
  struct unfinished next = {.arena = lod_arena_create_child(stream->arena)};
  static const struct lod_mesh kNone;
  const struct lod_mesh *base = stream->now.arena == NULL ? &kNone : &stream->now.level.mesh;
  if (next.arena == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = lod_units_open(bytes, size, base, NULL, next.arena, &next.units, problem);
  if (status == LOD_OK) {
    next.levels = LOD_NEW_ZERO(next.arena, next.units.header.patch_count, struct lod_delta_level);
    next.at_hand = LOD_NEW_ZERO(next.arena, next.units.header.patch_count, const struct lod_delta_level *);
    if (next.levels == NULL || next.at_hand == NULL)
      status = lod_fail_memory(problem);
  }
  if (status != LOD_OK) {
    lod_arena_destroy(next.arena);
    return status;
  }
  lodestream_units_drop(stream);
  stream->step = next;
  return LOD_OK;
}

const struct lod_units *lodestream_units(const struct lodestream *stream) {
  return stream->step.arena == NULL ? NULL : &stream->step.units;
}

static enum lod_status no_step(struct lod_problem *problem) {
  return lod_fail(problem, LOD_BAD_INPUT, "units", "No step in units has begun.");
}

enum lod_status lodestream_units_take(struct lodestream *stream, uint32_t patch, const uint8_t *bytes, size_t size,
                                      struct lod_problem *problem) {
  struct unfinished *step = &stream->step;
  struct lod_delta_level level;
  if (step->arena == NULL)
    return no_step(problem);
  if (patch < step->units.header.patch_count && step->at_hand[patch] != NULL)
    return LOD_OK;
  LOD_TRY(lod_units_decode(&step->units, patch, bytes, size, NULL, step->arena, &level, problem));
  step->levels[patch] = level;
  step->at_hand[patch] = &step->levels[patch];
  return LOD_OK;
}

static enum lod_status draw(struct unfinished *step, struct lod_arena *arena, struct lod_arena *scratch, struct lod_morph *morph,
                            struct lod_problem *problem) {
  const struct lod_mesh *coarse = step->units.base;
  struct lod_delta_level joined;
  struct lod_overlay overlay;
  LOD_TRY(lod_units_join(&step->units, step->at_hand, scratch, &joined, problem));
  uint32_t *parents = lod_arena_copy(scratch, joined.kept, coarse->vertex_count * sizeof *parents);
  if (parents == NULL)
    return LOD_MEMORY;
  lod_units_settle(&step->units, step->at_hand, parents);
  LOD_TRY(lod_overlay_create(coarse, &joined.mesh, parents, NULL, scratch, &overlay, problem));
  LOD_TRY(lod_overlay_part(&overlay, coarse, &joined.mesh, NULL, step->states, arena, morph));
  if (step->states == NULL && (step->states = LOD_NEW(step->arena, coarse->triangle_count, uint8_t)) == NULL)
    return LOD_MEMORY;
  memcpy(step->states, overlay.states, coarse->triangle_count * sizeof *step->states);
  return LOD_OK;
}

enum lod_status lodestream_units_morph(struct lodestream *stream, const struct lod_morph **morph, struct lod_problem *problem) {
  struct unfinished *step = &stream->step;
  *morph = NULL;
  if (step->arena == NULL)
    return no_step(problem);
  struct lod_arena *drawn = lod_arena_create_child(stream->arena), *scratch = lod_arena_create_child(stream->arena);
  struct lod_morph next;
  enum lod_status status = LOD_MEMORY;
  if (drawn != NULL && scratch != NULL)
    status = draw(step, drawn, scratch, &next, problem);
  lod_arena_destroy(scratch);
  if (status != LOD_OK) {
    lod_arena_destroy(drawn);
    return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
  }
  lod_arena_destroy(step->drawn);
  step->drawn = drawn;
  step->morph = next;
  *morph = &step->morph;
  return LOD_OK;
}

enum lod_status lodestream_units_finish(struct lodestream *stream, struct lod_problem *problem) {
  struct unfinished *step = &stream->step;
  if (step->arena == NULL)
    return no_step(problem);
  for (uint32_t p = 0; p < step->units.header.patch_count; p++)
    if (step->at_hand[p] == NULL && step->units.patches[p].size != 0)
      return lod_fail(problem, LOD_BAD_INPUT, "units", "Unit %u of %u has not come.", p, step->units.header.patch_count);
  struct held next = {.arena = lod_arena_create_child(stream->arena)};
  if (next.arena == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = lod_units_join(&step->units, step->at_hand, next.arena, &next.level, problem);
  if (status != LOD_OK) {
    lod_arena_destroy(next.arena);
    return status;
  }
  lodestream_step(stream, &next);
  return LOD_OK;
}
