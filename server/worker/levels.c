#include "server/worker/levels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb.h"
#include "core/base/tolerance.h"
#include "core/mesh/intersect.h"
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
  baked->patches.color_bound = level->patches->color_bound;
  /* Rounding to float moves a vertex by at most sqrt(3) 2^-24 of the largest coordinate. */
  baked->patches.error = error.upper + level->patches->deviation + 0x1p-23 * magnitude;
  return LOD_OK;
}

static enum lod_status count_crossings(const struct lod_model *model, const struct lod_mesh *meshes, struct lod_arena *arena,
                                       uint64_t *pairs) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : LOD_OK;
  *pairs = 0;
  for (uint32_t u = 0; status == LOD_OK && u < model->unit_count; u++) {
    struct lod_crossings crossings;
    status = lod_intersect_count(&meshes[u], NULL, scratch, NULL, &crossings);
    *pairs += status == LOD_OK ? crossings.pairs : 0;
  }
  lod_arena_destroy(scratch);
  return status;
}

/* One attempt at one precision. crossings: of the decoded level; or NULL. */
static enum lod_status encode(const struct lod_level_baker *baker, const struct lod_level *level, double position_error,
                              struct lod_arena *arena, uint64_t *crossings, struct lod_baked_level *baked, struct lod_problem *problem) {
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
  if (status == LOD_OK && crossings != NULL)
    status = count_crossings(model, decoded, scratch, crossings);
  if (status == LOD_OK && level->patches != NULL)
    status = certify_patches(baker, level, scratch, unit_errors, baked);
  if (status == LOD_OK)
    count_figures(model, decoded, unit_errors, scratch, baked);
  lod_arena_destroy(scratch);
  return status;
}

/* What a trial of a precision has made. */
struct trial {
  struct lod_arena *arena;
  struct lod_baked_level result;
  uint64_t crossings; /* pairs of triangles that cross as decoded */
};

static enum lod_status begin_trial(const struct lod_level_baker *baker, const struct lod_level *level, double quantisation,
                                   struct lod_arena *arena, struct trial *trial, struct lod_problem *problem) {
  *trial = (struct trial){.arena = lod_arena_create_child(arena)};
  trial->result = (struct lod_baked_level){.cell = level->cell,
                                           .counted = level->counted,
                                           .asked = level->asked,
                                           .candidates = level->candidates,
                                           .retained = level->retained,
                                           .has_drift = level->has_drift,
                                           .uv_drift = level->uv_drift,
                                           .normal_drift = level->normal_drift,
                                           .uv_bound = level->uv_bound,
                                           .normal_bound = level->normal_bound};
  if (trial->arena == NULL)
    return lod_fail_memory(problem);
  enum lod_status status =
      encode(baker, level, quantisation, trial->arena, level->target > 0 ? &trial->crossings : NULL, &trial->result, problem);
  if (status != LOD_OK)
    lod_arena_destroy(trial->arena);
  return status;
}

static enum lod_status keep_trial(const struct lod_level_baker *baker, struct trial *trial, struct lod_arena *arena,
                                  struct lod_baked_level *baked, struct lod_problem *problem) {
  *baked = trial->result;
  baked->bytes = lod_arena_copy(arena, trial->result.bytes, trial->result.size);
  baked->parts = lod_arena_copy(arena, trial->result.parts, baker->model->part_count * sizeof *baked->parts);
  lod_arena_destroy(trial->arena);
  return baked->bytes == NULL || baked->parts == NULL ? lod_fail_memory(problem) : LOD_OK;
}

/* Precisions that are tried for a level that was asked for, as shares of its error, coarse to fine. */
static const double kShares[] = {0.25, 0.18, 0.12, 0.08, 0.04, 0.02, 0.01};
enum { SHARES = sizeof kShares / sizeof kShares[0] };

/* The coarsest of them whose decoded level keeps to the error and crosses itself no more than before; when none does, the last that kept to
 * the error with the fewest crossings. */
static enum lod_status bake_to_target(const struct lod_level_baker *baker, const struct lod_level *level, struct lod_arena *arena,
                                      struct lod_baked_level *baked, struct lod_problem *problem) {
  uint64_t before;
  struct trial best = {.arena = NULL}, trial;
  if (count_crossings(baker->model, level->meshes, arena, &before) != LOD_OK)
    return lod_fail_memory(problem);
  double least = 1e-6 * baker->diagonal;
  for (int i = 0; i < SHARES; i++) {
    double quantisation = kShares[i] * level->target;
    if (level->precision > 0 && quantisation > level->precision && i + 1 < SHARES && kShares[i + 1] * level->target >= level->precision)
      continue; /* there is a coarse enough one that is finer */
    quantisation = fmax(least, level->precision > 0 ? fmin(quantisation, level->precision) : quantisation);
    LOD_TRY(begin_trial(baker, level, quantisation, arena, &trial, problem));
    bool met = trial.result.error.upper <= level->target, best_met = best.arena != NULL && best.result.error.upper <= level->target;
    bool better = best.arena == NULL || (met && !best_met) || (met == best_met && trial.crossings < best.crossings) ||
                  (!met && !best_met && trial.result.error.upper < best.result.error.upper);
    bool done = (met && trial.crossings <= before) || quantisation <= least;
    if (better && best.arena != NULL)
      lod_arena_destroy(best.arena);
    if (better)
      best = trial;
    else
      lod_arena_destroy(trial.arena);
    if (done)
      break;
  }
  return keep_trial(baker, &best, arena, baked, problem);
}

struct cell {
  int32_t at[3];
};

static int compare_cells(const void *a, const void *b) {
  return memcmp(a, b, sizeof(struct cell));
}

/* Vertices that fall onto another one's place on the grid of this precision. */
static enum lod_status count_merges(const struct lod_level_baker *baker, const struct lod_level *level, double quantisation,
                                    struct lod_arena *arena, uint64_t *merges) {
  *merges = 0;
  for (uint32_t u = 0; u < baker->model->unit_count; u++) {
    const struct lod_mesh *mesh = &level->meshes[u];
    const struct lod_draco_grid grid = lod_glb_grid(mesh, quantisation / baker->model->units[u].scale);
    struct lod_arena *scratch = lod_arena_create_child(arena);
    struct cell *cells = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->vertex_count, struct cell);
    for (uint32_t v = 0; cells != NULL && v < mesh->vertex_count; v++)
      for (int i = 0; i < 3; i++)
        cells[v].at[i] = lod_draco_grid_index(&grid, i, mesh->positions[v][i]);
    if (cells != NULL)
      qsort(cells, mesh->vertex_count, sizeof *cells, compare_cells);
    for (uint32_t v = 1; cells != NULL && v < mesh->vertex_count; v++)
      *merges += compare_cells(&cells[v - 1], &cells[v]) == 0;
    bool ok = cells != NULL;
    lod_arena_destroy(scratch);
    if (!ok)
      return LOD_MEMORY;
  }
  return LOD_OK;
}

/* The coarsest of this precision and finer ones at which as few vertices merge as at the finest: a level that keeps its source's topology
 * keeps it when it is decoded, and the map onto the finer level, too. */
static enum lod_status keep_apart(const struct lod_level_baker *baker, const struct lod_level *level, double least, struct lod_arena *arena,
                                  double *quantisation) {
  uint64_t merges, fewest;
  LOD_TRY(count_merges(baker, level, *quantisation, arena, &merges));
  if (merges == 0)
    return LOD_OK;
  LOD_TRY(count_merges(baker, level, least, arena, &fewest));
  while (merges > fewest && *quantisation > least) {
    *quantisation = fmax(least, *quantisation / 2);
    LOD_TRY(count_merges(baker, level, *quantisation, arena, &merges));
  }
  return LOD_OK;
}

enum lod_status lod_level_bake(const struct lod_level_baker *baker, const struct lod_level *level, double position_error,
                               struct lod_arena *arena, struct lod_baked_level *baked, struct lod_problem *problem) {
  if (level->target > 0 && !(position_error > 0))
    return bake_to_target(baker, level, arena, baked, problem);
  /* A level's certified error is mostly 0.4 to 0.6 of its family's bound: this is right the first time. */
  double quantisation = position_error > 0 ? position_error : 0.1 * (isfinite(level->bound) ? level->bound : level->expected);
  double least = 1e-6 * baker->diagonal;
  if (!isfinite(quantisation) || quantisation < least)
    quantisation = position_error > 0 ? position_error : least;
  enum { ATTEMPTS = 3 };
  for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
    struct trial trial;
    double wanted = quantisation;
    if (level->apart && keep_apart(baker, level, least, arena, &quantisation) != LOD_OK)
      return lod_fail_memory(problem);
    LOD_TRY(begin_trial(baker, level, quantisation, arena, &trial, problem));
    double upper = trial.result.error.upper;
    bool good = position_error > 0 || 4 * quantisation <= upper || quantisation <= least || attempt == ATTEMPTS - 1;
    /* A family without a bound of its own was only measured: now its error is known. */
    if (!isfinite(level->bound) && attempt == 0 && position_error <= 0 && quantisation == wanted && 8 * quantisation < upper)
      good = false;
    if (good)
      return keep_trial(baker, &trial, arena, baked, problem);
    lod_arena_destroy(trial.arena);
    quantisation = fmax(least, upper / (attempt == 0 ? 4.5 : 8));
  }
  return LOD_OK;
}

static int coarser_first(const void *a, const void *b) {
  const struct lod_baked_level *x = a, *y = b;
  if (x->error.upper != y->error.upper)
    return x->error.upper > y->error.upper ? -1 : 1;
  if (x->size != y->size)
    return x->size < y->size ? 1 : -1;
  return (x->patches.size != 0) - (y->patches.size != 0);
}

/* Patches that others better go. What is left of such a level is its triangles: as many as the error of curves asks for, they are not worth
 * keeping for themselves unless nothing betters them either. */
static void drop_patches(struct lod_baked_level *levels, uint32_t count) {
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t j = 0; j < count && levels[i].patches.size != 0; j++) {
      size_t mine = levels[i].patches.size, other = levels[j].patches.size;
      double error = levels[i].patches.error, others = levels[j].patches.error;
      if (j == i || other == 0 || other > mine || others > error || (other == mine && others == error && j > i))
        continue;
      levels[i].patches.size = 0;
    }
}

uint32_t lod_levels_order(struct lod_baked_level *levels, uint32_t count) {
  drop_patches(levels, count);
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
