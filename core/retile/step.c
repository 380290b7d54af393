/* A level and its map onto the finer one. Both sides of a connection derive that map (core/mesh/overlay.h), so a level is made such that it
 * exists: where a coarse triangle is not mapped one to one, vertices of the finer level that lie on it come back, which makes the triangles
 * there smaller, until all are mapped. At the latest the two levels are the same there. Surfaces of many handles at few vertices need this:
 * their coarse edges have more than one way around. */
#include <math.h>
#include <string.h>

#include "core/mesh/overlay.h"
#include "core/retile/internal.h"

/* Where the finer level's vertices lie on the level just built. */
static enum lod_status record_step(const struct step *s, struct lod_retile_level *level, struct lod_arena *arena) {
  const struct tiling *tiling = s->tiling;
  RETILE_TRY_NEW(level->parents, arena, level->mesh.vertex_count);
  RETILE_TRY_NEW(level->flat, arena, s->finer->mesh.vertex_count);
  for (uint32_t v = 0; v < tiling->vertex_count; v++) {
    if (s->finer_to[v] == LOD_NONE)
      continue;
    struct lod_retile_point *at = &level->flat[s->finer_to[v]];
    if (s->vertex_to[v] != LOD_NONE) {
      level->parents[s->vertex_to[v]] = s->finer_to[v];
      *at = (struct lod_retile_point){.face = s->face_to[tiling->corner[v] / 3]};
      at->weights[tiling->corner[v] % 3] = LOD_RETILE_ONE;
    } else {
      *at = tiling->flat[v];
      at->face = at->face == LOD_NONE ? LOD_NONE : s->face_to[at->face];
    }
  }
  return LOD_OK;
}

/* What the overlay says, in place of the record of removal. */
static void take_places(const struct lod_overlay *overlay, struct lod_retile_level *level) {
  for (uint32_t v = 0; v < overlay->vertex_count; v++) {
    const struct lod_overlay_place *at = &overlay->coarse[v];
    if (at->face != LOD_NONE)
      level->flat[v] = (struct lod_retile_point){at->face, {at->weights[0], at->weights[1], at->weights[2]}};
  }
}

/* bad (by tiling face): the map onto it is not one to one. When none is, the level takes the overlay's places. */
static enum lod_status find_unmapped(const struct step *s, struct lod_retile_level *level, bool *bad, uint32_t *bad_count) {
  struct lod_arena *arena = lod_arena_create_child(s->scratch);
  struct lod_overlay overlay;
  *bad_count = 0;
  enum lod_status status =
      arena == NULL ? LOD_MEMORY : lod_overlay_create(&level->mesh, &s->finer->mesh, level->parents, NULL, arena, &overlay, NULL);
  for (uint32_t f = 0; status == LOD_OK && f < s->tiling->face_count; f++) {
    bad[f] = s->face_to[f] != LOD_NONE && overlay.states[s->face_to[f]] != LOD_OVERLAY_MAPPED;
    *bad_count += bad[f];
  }
  if (status == LOD_OK && *bad_count == 0)
    take_places(&overlay, level);
  lod_arena_destroy(arena);
  return status;
}

/* A face is bad, or, with `wide`, has a corner that a bad one has. */
static void widen(const struct tiling *t, const bool *bad, bool wide, bool *corner, bool *chosen) {
  for (uint32_t f = 0; f < t->face_count; f++)
    for (int k = 0; k < 3 && t->faces[f][0] != LOD_NONE && bad[f]; k++)
      corner[t->faces[f][k]] = true;
  for (uint32_t f = 0; f < t->face_count; f++) {
    chosen[f] = bad[f];
    for (int k = 0; k < 3 && wide && t->faces[f][0] != LOD_NONE; k++)
      chosen[f] = chosen[f] || corner[t->faces[f][k]];
  }
}

/* Vertices of the finer level that lie on bad faces come back. */
static enum lod_status put_back(const struct step *s, const bool *bad, uint32_t bad_count, uint32_t round, bool *kept, uint32_t *inserted) {
  enum { WIDE = 2 };
  struct tiling *t = s->tiling;
  struct lod_arena *arena = lod_arena_create_child(s->scratch);
  bool *allowed = arena == NULL ? NULL : LOD_NEW(arena, t->vertex_count, bool);
  bool *corner = arena == NULL ? NULL : LOD_NEW_ZERO(arena, t->vertex_count, bool);
  bool *chosen = arena == NULL ? NULL : LOD_NEW(arena, t->face_count, bool);
  enum lod_status status = allowed == NULL || corner == NULL || chosen == NULL ? LOD_MEMORY : LOD_OK;
  *inserted = 0;
  for (int wide = round >= WIDE; status == LOD_OK && wide < 2 && *inserted == 0; wide++) {
    widen(t, bad, wide, corner, chosen);
    for (uint32_t v = 0; v < t->vertex_count; v++)
      allowed[v] = t->dead[v] && t->copies[v] == v && s->finer_to[v] != LOD_NONE && t->flat[v].face != LOD_NONE && chosen[t->flat[v].face];
    status = insert_vertices(t, allowed, s->number, 1 + bad_count / 3 * (1 + round / 3), 0, INSERT_ALL, arena, inserted);
    for (uint32_t v = 0; status == LOD_OK && v < t->vertex_count; v++)
      kept[v] = kept[v] || (allowed[v] && !t->dead[v]);
  }
  lod_arena_destroy(arena);
  return status;
}

static enum lod_status take_level(const struct step *s, struct lod_arena *arena, struct lod_retile_level *level) {
  LOD_TRY(extract_level(s->tiling, s->number, arena, level, s->vertex_to, s->face_to));
  return s->finer == NULL ? LOD_OK : record_step(s, level, arena);
}

static enum lod_status take_again(const struct step *s, struct lod_arena **arena, struct lod_retile_level *level) {
  lod_arena_destroy(*arena);
  *arena = lod_arena_create_child(s->scratch);
  return *arena == NULL ? LOD_MEMORY : take_level(s, *arena, level);
}

/* An error that was proven before vertices changed. */
static enum lod_status prove_again(const struct step *s, double *bound) {
  struct lod_arena *arena = lod_arena_create_child(s->scratch);
  bool *wanted = arena == NULL ? NULL : LOD_NEW(arena, s->tiling->vertex_count, bool);
  uint32_t bad = 0;
  enum lod_status status = wanted == NULL ? LOD_MEMORY : prove_level(s->tiling, *bound, s->settings->threads, arena, wanted, &bad);
  if (bad != 0)
    *bound = INFINITY;
  lod_arena_destroy(arena);
  return status;
}

/* As many vertices as before, elsewhere than where they were `kept`. */
static enum lod_status even_out(const struct step *s, uint32_t target, const bool *kept) {
  struct tiling *t = s->tiling;
  uint32_t count = lead_count(t), inserted;
  if (count > target)
    LOD_TRY(lead_thin_out(t, s->number, count - target, kept, s->scratch));
  count = lead_count(t);
  if (count >= target)
    return LOD_OK;
  struct lod_arena *arena = lod_arena_create_child(s->scratch);
  bool *allowed = arena == NULL ? NULL : LOD_NEW(arena, t->vertex_count, bool);
  for (uint32_t v = 0; allowed != NULL && v < t->vertex_count; v++)
    allowed[v] = t->dead[v] && t->copies[v] == v && s->finer_to[v] != LOD_NONE && t->flat[v].face != LOD_NONE;
  enum lod_status status =
      allowed == NULL ? LOD_MEMORY : insert_vertices(t, allowed, s->number, target - count, 0, INSERT_ALL, arena, &inserted);
  lod_arena_destroy(arena);
  return status;
}

/* Vertices back, until all is mapped; `level` is the tiling as it is, in an arena that dies with the next round. More vertices may map
 * less, where handles are tight: of all rounds the one that left least unmapped is returned to. */
static enum lod_status mend(const struct step *s, struct lod_retile_level *level, struct lod_arena **arena, bool *changed) {
  enum { MOST_ROUNDS = 12, EVEN_ROUNDS = 4, WORSE = 6 };
  uint32_t least_bad = UINT32_MAX, worse = 0, bad_count = 0, target = lead_count(s->tiling);
  bool *bad, *kept;
  struct tiling *best = NULL;
  target = target > s->goal->vertices ? target : s->goal->vertices;
  RETILE_TRY_NEW(bad, s->scratch, s->tiling->face_count);
  RETILE_TRY_NEW_ZERO(kept, s->scratch, s->tiling->vertex_count);
  for (uint32_t round = 0;; round++) {
    uint32_t inserted = 0;
    LOD_TRY(find_unmapped(s, level, bad, &bad_count));
    bool uneven = s->goal->error == 0 && *changed && round < EVEN_ROUNDS && lead_count(s->tiling) != target;
    worse = bad_count < least_bad ? 0 : worse + 1;
    if ((bad_count == 0 && !uneven) || (bad_count != 0 && worse == WORSE) || round == MOST_ROUNDS)
      break;
    if (bad_count < least_bad)
      LOD_TRY(tiling_keep(s->tiling, s->scratch, &best));
    least_bad = bad_count < least_bad ? bad_count : least_bad;
    if (bad_count != 0)
      LOD_TRY(put_back(s, bad, bad_count, round, kept, &inserted));
    if (inserted == 0 && !uneven)
      break; /* nothing is left to come back */
    if (s->goal->error == 0 && round < EVEN_ROUNDS)
      LOD_TRY(even_out(s, target, kept));
    *changed = true;
    LOD_TRY(take_again(s, arena, level));
  }
  if (bad_count > least_bad) {
    tiling_return(s->tiling, best);
    LOD_TRY(take_again(s, arena, level));
    LOD_TRY(find_unmapped(s, level, bad, &bad_count));
  }
  s->goal->unmapped = bad_count;
  return LOD_OK;
}

enum lod_status step_finish(const struct step *s, double *bound, struct lod_retile_level *level) {
  bool changed = false;
  s->goal->unmapped = 0;
  LOD_TRY(take_level(s, s->arena, level));
  if (s->finer == NULL || !s->settings->whole_maps || s->goal->pilot)
    return LOD_OK;
  struct lod_arena *rounds = NULL;
  enum lod_status status = mend(s, level, &rounds, &changed);
  if (status == LOD_OK && changed) {
    const struct lod_retile_point *flat = level->flat;
    status = take_level(s, s->arena, level);
    if (status == LOD_OK && s->goal->unmapped == 0)
      memcpy(level->flat, flat, s->finer->mesh.vertex_count * sizeof *flat);
  }
  lod_arena_destroy(rounds);
  return status == LOD_OK && changed && *bound < INFINITY ? prove_again(s, bound) : status;
}
