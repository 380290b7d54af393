#include "server/worker/levels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb.h"
#include "core/base/tolerance.h"
#include "server/worker/certify.h"

static enum lod_status certify(const struct lod_level_baker *baker, const struct lod_level *level, const struct lod_mesh *decoded,
                               double position_error, struct lod_arena *arena, double *unit_errors, struct lod_interval *error) {
  *error = (struct lod_interval){0, 0};
  for (uint32_t u = 0; u < baker->model->unit_count; u++) {
    const struct lod_unit *unit = &baker->model->units[u];
    struct lod_certify_request request = {
        .source = &unit->mesh,
        .source_bvh = baker->source_bvhs[u],
        .level = &level->meshes[u],
        .decoded = &decoded[u],
        .image = level->images == NULL ? NULL : level->images[u],
        .nearby = level->nearby == NULL ? NULL : level->nearby[u],
        .position_error = position_error / unit->scale,
        .absolute = baker->diagonal * LOD_TOLERANCE_DISTANCE_DIAGONAL / unit->scale,
        .threads = baker->threads,
        .progress = baker->progress,
    };
    struct lod_distance distance;
    LOD_TRY(lod_certify_unit(&request, arena, &distance));
    unit_errors[u] = distance.two_sided.upper * unit->scale + baker->model->rounding;
    error->upper = fmax(error->upper, unit_errors[u]);
    /* With several units a point may lie nearer to another unit than to its own: only one unit's lower bound is the model's. */
    if (baker->model->unit_count == 1 && baker->model->units[0].scale == 1)
      error->lower = fmax(0, distance.two_sided.lower - baker->model->rounding);
  }
  return LOD_OK;
}

static void count_figures(const struct lod_model *model, const struct lod_mesh *meshes, const double *unit_errors,
                          struct lod_arena *scratch, struct lod_baked_level *baked) {
  baked->vertices = baked->triangles = baked->edges = baked->points = 0;
  memset(baked->parts, 0, model->part_count * sizeof *baked->parts);
  for (uint32_t p = 0; p < model->part_count; p++)
    baked->parts[p].error = unit_errors[model->parts[p].unit];
  for (uint32_t u = 0; u < model->unit_count; u++) {
    const struct lod_mesh *mesh = &meshes[u];
    baked->vertices += mesh->vertex_count;
    baked->triangles += mesh->triangle_count;
    baked->edges += mesh->edge_count;
    baked->points += mesh->point_count;
    uint32_t *last_part = LOD_NEW(scratch, mesh->vertex_count, uint32_t); /* counts a vertex once a run of its part's primitives */
    if (last_part == NULL)
      continue;
    memset(last_part, 0xff, (size_t)mesh->vertex_count * sizeof *last_part);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
      uint32_t part = mesh->parts == NULL ? 0 : mesh->parts[t];
      baked->parts[part].triangles++;
      for (int k = 0; k < 3; k++) {
        uint32_t v = mesh->triangles[t][k];
        baked->parts[part].vertices += last_part[v] != part;
        last_part[v] = part;
      }
    }
    for (uint32_t e = 0; e < mesh->edge_count; e++)
      baked->parts[mesh->edge_parts == NULL ? 0 : mesh->edge_parts[e]].edges++;
    for (uint32_t q = 0; q < mesh->point_count; q++)
      baked->parts[mesh->point_parts == NULL ? 0 : mesh->point_parts[q]].points++;
  }
}

/* The patches against the source: the level's meshes are their chords. */
static enum lod_status certify_patches(const struct lod_level_baker *baker, const struct lod_level *level, struct lod_arena *scratch,
                                       double *unit_errors, struct lod_baked_level *baked) {
  double *errors = LOD_NEW(scratch, baker->model->unit_count, double), magnitude = 0;
  struct lod_interval error;
  if (errors == NULL)
    return LOD_MEMORY;
  (void)unit_errors;
  LOD_TRY(certify(baker, level, level->meshes, 0, scratch, errors, &error));
  for (uint32_t u = 0; u < baker->model->unit_count; u++)
    magnitude = fmax(magnitude, lod_mesh_magnitude(&level->meshes[u]) * baker->model->units[u].scale);
  baked->patches.bytes = level->patches->bytes;
  baked->patches.size = level->patches->size;
  baked->patches.count = level->patches->count;
  /* Rounding to float moves a vertex by at most sqrt(3) 2^-24 of the largest coordinate. */
  baked->patches.error = error.upper + level->patches->deviation + 0x1p-23 * magnitude;
  return LOD_OK;
}

/* One attempt at one precision. */
static enum lod_status encode(const struct lod_level_baker *baker, const struct lod_level *level, double position_error,
                              struct lod_arena *arena, struct lod_baked_level *baked, struct lod_problem *problem) {
  const struct lod_model *model = baker->model;
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.position_error = position_error;
  settings.threads = baker->threads;
  settings.image_uris = baker->image_uris;
  settings.generator = "Lodestream " LOD_VERSION;
  baked->position_error = position_error;
  LOD_TRY(lod_glb_write(model, level->meshes, &settings, arena, &baked->bytes, &baked->size, problem));

  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_mesh *decoded = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, struct lod_mesh);
  double *unit_errors = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, double);
  baked->parts = LOD_NEW(arena, model->part_count, struct lod_part_figures);
  enum lod_status status = LOD_OK;
  if (decoded == NULL || unit_errors == NULL || baked->parts == NULL)
    status = lod_fail_memory(problem);
  if (status == LOD_OK)
    status = lod_glb_read(baked->bytes, baked->size, model, scratch, decoded, problem);
  if (status == LOD_OK)
    status = certify(baker, level, decoded, position_error, scratch, unit_errors, &baked->error);
  if (status == LOD_OK && level->patches != NULL)
    status = certify_patches(baker, level, scratch, unit_errors, baked);
  if (status == LOD_OK)
    count_figures(model, decoded, unit_errors, scratch, baked);
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status lod_level_bake(const struct lod_level_baker *baker, const struct lod_level *level, double position_error,
                               struct lod_arena *arena, struct lod_baked_level *baked, struct lod_problem *problem) {
  /* A level's certified error is mostly 0.4 to 0.6 of its family's bound: this is right the first time. */
  double quantisation = position_error > 0 ? position_error : 0.1 * (isfinite(level->bound) ? level->bound : level->expected);
  double least = 1e-6 * baker->diagonal;
  if (!isfinite(quantisation) || quantisation < least)
    quantisation = position_error > 0 ? position_error : least;
  baked->cell = level->cell;
  enum { ATTEMPTS = 3 };
  for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
    struct lod_arena *trial = lod_arena_create_child(arena);
    if (trial == NULL)
      return lod_fail_memory(problem);
    struct lod_baked_level result = {
        .cell = level->cell, .has_drift = level->has_drift, .uv_drift = level->uv_drift, .normal_drift = level->normal_drift};
    enum lod_status status = encode(baker, level, quantisation, trial, &result, problem);
    if (status != LOD_OK) {
      lod_arena_destroy(trial);
      return status;
    }
    bool good = position_error > 0 || 4 * quantisation <= result.error.upper || quantisation <= least || attempt == ATTEMPTS - 1;
    /* A family without a bound of its own was only measured: now its error is known. */
    if (!isfinite(level->bound) && attempt == 0 && position_error <= 0 && 8 * quantisation < result.error.upper)
      good = false;
    if (good) {
      *baked = result;
      baked->bytes = lod_arena_copy(arena, result.bytes, result.size);
      baked->parts = lod_arena_copy(arena, result.parts, baker->model->part_count * sizeof *result.parts);
    }
    lod_arena_destroy(trial);
    if (good)
      return baked->bytes == NULL || baked->parts == NULL ? lod_fail_memory(problem) : LOD_OK;
    quantisation = fmax(least, result.error.upper / (attempt == 0 ? 4.5 : 8));
  }
  return LOD_OK;
}

static int coarser_first(const void *a, const void *b) {
  const struct lod_baked_level *x = a, *y = b;
  if (x->error.upper != y->error.upper)
    return x->error.upper > y->error.upper ? -1 : 1;
  return x->size < y->size ? 1 : x->size > y->size ? -1 : 0;
}

uint32_t lod_levels_order(struct lod_baked_level *levels, uint32_t count) {
  qsort(levels, count, sizeof *levels, coarser_first);
  uint32_t kept = 0;
  size_t fewest = SIZE_MAX;
  for (uint32_t i = count; i-- > 0;) { /* finest first: keep what is smaller than everything finer */
    if (levels[i].size >= fewest && levels[i].patches.size == 0)
      continue; /* triangles of curved levels may be many: it is their patches that are few */
    fewest = levels[i].size < fewest ? levels[i].size : fewest;
    levels[count - ++kept] = levels[i];
  }
  memmove(levels, levels + (count - kept), kept * sizeof *levels);
  return kept;
}
