/* The ladder of levels: cell widths, nested centres, and the levels themselves, finest first.
 *
 * First pass, coarse to fine: a level's centres are those of the coarser level and what its own smaller cells leave uncovered, opened in
 * weight order. The birth of a vertex is the coarsest level that it is a centre of; one byte a vertex describes all levels. Widths
 * shrink by about sqrt(2) and are corrected from the counts seen, so that vertices double. Second pass, fine to coarse: every source
 * vertex goes to its cell among the level's centres, and the level is made from the source. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

enum { TRIES = 6 };

/* A level's count may miss its target by this factor before its cell is corrected. */
static const double kMiss = 1.25;

struct ladder {
  const struct lod_cluster *cluster;
  const struct lod_progress *progress;
  struct lod_arena *arena;
  uint8_t **birth; /* per unit, by working vertex */
  uint32_t count;
  double cells[CLUSTER_MAX_LEVELS]; /* model units, coarsest first */
  uint64_t centres[CLUSTER_MAX_LEVELS];
};

/* Opens level `level` in every unit; undoes an earlier try. */
static enum lod_status open_level(struct ladder *ladder, uint32_t level, double cell) {
  const struct lod_cluster *cluster = ladder->cluster;
  ladder->cells[level] = cell;
  ladder->centres[level] = 0;
  struct lod_arena *scratch = lod_arena_create_child(ladder->arena);
  enum lod_status status = scratch != NULL ? LOD_OK : LOD_MEMORY;
  for (uint32_t u = 0; status == LOD_OK && u < cluster->unit_count; u++) {
    const struct cluster_unit *unit = &cluster->units[u];
    double working = cluster_working_cell(unit, cell);
    uint32_t *keys, count = 0;
    for (uint32_t v = 0; v < unit->count; v++)
      if (ladder->birth[u][v] >= level)
        ladder->birth[u][v] = CLUSTER_UNBORN;
    status = cluster_keys(unit, working, cluster->settings.separate, scratch, &keys);
    if (status == LOD_OK)
      status = cluster_open(unit, &cluster->settings, working, keys, ladder->birth[u], (uint8_t)level, scratch, &count);
    ladder->centres[level] += count;
    if (status == LOD_OK && lod_progress_cancelled(ladder->progress))
      status = LOD_CANCELLED;
  }
  lod_arena_destroy(scratch);
  return status;
}

/* A width that leaves about `target` cells if they tile the surface in half-cell steps, and at least one the size of everything. */
static double guess_cell(const struct lod_cluster *cluster, double target) {
  double area = 0, diagonal = 0;
  for (uint32_t u = 0; u < cluster->unit_count; u++) {
    const struct cluster_unit *unit = &cluster->units[u];
    double to_model = unit->scale / unit->shrink;
    area += unit->area * to_model * to_model;
    diagonal = fmax(diagonal, unit->diagonal * to_model);
  }
  double cell = sqrt(2 * area / target);
  if (!(cell > diagonal * 1e-4)) /* threads and points have no area */
    cell = diagonal / sqrt(target);
  return cell > 0 ? fmin(cell, 2 * diagonal) : 1;
}

/* Opens a level of about `target` cells: tries widths from `cell` on, by the power law of the exponent and between the widths that are
 * known to give too many and too few. A lattice may have no such width; then the last one tried stays. */
static enum lod_status open_near(struct ladder *ladder, uint32_t level, double target, double cell, double exponent) {
  double low = 0, high = level > 0 ? ladder->cells[level - 1] : INFINITY;
  for (int try = 0;; try++) {
    LOD_TRY(open_level(ladder, level, cell));
    double count = (double)ladder->centres[level];
    if ((count <= target * kMiss && count >= target / kMiss) || try == TRIES - 1)
      return LOD_OK;
    if (count > target)
      low = fmax(low, cell);
    else
      high = fmin(high, cell);
    double next = cell * pow(count / target, 1 / exponent);
    if (!(next > low * 1.001 && next < high / 1.001))
      next = isinf(high) ? cell * 2 : low > 0 ? sqrt(low * high) : high * sqrt(ladder->cluster->settings.ratio);
    cell = next;
  }
}

/* Widths by counts: from about min_triangles up to `ratio` of the source, in vertices (half as many as triangles on a closed surface;
 * vertices fall steadily with the cell whatever the model is made of). */
static enum lod_status climb(struct ladder *ladder) {
  const struct lod_cluster_settings *settings = &ladder->cluster->settings;
  double most = (double)ladder->cluster->vertex_count * settings->ratio;
  double share = (double)ladder->cluster->vertex_count / fmax(1, (double)ladder->cluster->triangle_count); /* 1/2 on a closed surface */
  double least = fmax(settings->min_triangles * fmin(share, 0.5), 2);
  if (ladder->cluster->triangle_count < 2 * (uint64_t)settings->min_triangles && ladder->cluster->triangle_count != 0)
    return LOD_OK;
  double steps = floor(log(most / least) / -log(settings->ratio) + 0.25);
  if (!(steps >= 0))
    return LOD_OK;
  uint32_t levels = steps + 1 < CLUSTER_MAX_LEVELS ? (uint32_t)steps + 1 : CLUSTER_MAX_LEVELS;
  double target = most * pow(settings->ratio, levels - 1), cell = guess_cell(ladder->cluster, target), exponent = 2;
  for (uint32_t step = 0; step < levels; step++, target /= settings->ratio) {
    uint32_t level = ladder->count;
    LOD_TRY(open_near(ladder, level, target, cell, exponent));
    double count = (double)ladder->centres[level];
    if (count > 0.95 * (double)ladder->cluster->vertex_count)
      break; /* births of this level stay, but no level that is emitted looks at them */
    if (level == 0 || (ladder->cells[level] < ladder->cells[level - 1] && ladder->centres[level] > ladder->centres[level - 1])) {
      if (level > 0) {
        exponent = log(count / (double)ladder->centres[level - 1]) / log(ladder->cells[level - 1] / ladder->cells[level]);
        exponent = exponent < 1 ? 1 : exponent < 3 ? exponent : 3;
      }
      ladder->count++;
    }
    cell = fmin(ladder->cells[level] * pow(count / (target / settings->ratio), 1 / exponent), ladder->cells[level] * 0.95);
    lod_progress_report(ladder->progress, "cells", 0.3 * (step + 1) / levels);
  }
  return LOD_OK;
}

static enum lod_status climb_given(struct ladder *ladder) {
  const struct lod_cluster_settings *settings = &ladder->cluster->settings;
  for (uint32_t level = 0; level < settings->cell_count; level++) {
    LOD_TRY(open_level(ladder, level, settings->cells[settings->cell_count - 1 - level]));
    ladder->count = level + 1;
  }
  return LOD_OK;
}

/* Centres with birth <= level and with birth <= finer ascend alike: a coarse centre's parent is its number among the finer ones. */
static void find_parents(const struct cluster_unit *unit, const uint8_t *birth, uint32_t level, uint32_t finer, uint32_t *parents) {
  uint32_t coarse = 0, fine = 0;
  for (uint32_t v = 0; v < unit->count; v++) {
    if (birth[v] <= level)
      parents[coarse++] = fine;
    fine += birth[v] <= finer;
  }
}

static enum lod_status make_unit_level(const struct ladder *ladder, uint32_t level, uint32_t u, struct lod_arena *arena,
                                       struct lod_mesh *mesh, uint32_t **images, uint32_t **nearby, double *bound) {
  const struct cluster_unit *unit = &ladder->cluster->units[u];
  const struct lod_cluster_settings *settings = &ladder->cluster->settings;
  double cell = cluster_working_cell(unit, ladder->cells[level]);
  struct cluster_cells cells;
  uint32_t *keys;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch != NULL ? cluster_keys(unit, cell, settings->separate, scratch, &keys) : LOD_MEMORY;
  if (status == LOD_OK)
    status = cluster_assign(unit, settings, cell, keys, ladder->birth[u], (uint8_t)level, scratch, &cells);
  if (status == LOD_OK)
    status = cluster_make_mesh(unit, settings, &cells, arena, mesh, images, nearby, bound);
  lod_arena_destroy(scratch);
  return status;
}

static enum lod_status make_level(const struct ladder *ladder, uint32_t level, struct lod_arena *arena, struct lod_level *out) {
  uint32_t unit_count = ladder->cluster->unit_count;
  *out = (struct lod_level){.cell = ladder->cells[level], .meshes = LOD_NEW_ZERO(arena, unit_count, struct lod_mesh)};
  uint32_t **images = LOD_NEW_ZERO(arena, unit_count, uint32_t *), **nearby = LOD_NEW_ZERO(arena, unit_count, uint32_t *);
  uint32_t **parents = LOD_NEW_ZERO(arena, unit_count, uint32_t *);
  if (out->meshes == NULL || images == NULL || nearby == NULL || parents == NULL)
    return LOD_MEMORY;
  bool finest = level + 1 == ladder->count;
  for (uint32_t u = 0; u < unit_count; u++) {
    double bound = 0;
    LOD_TRY(make_unit_level(ladder, level, u, arena, &out->meshes[u], &images[u], &nearby[u], &bound));
    out->bound = fmax(out->bound, bound * ladder->cluster->units[u].scale);
    if (finest)
      continue;
    parents[u] = LOD_NEW(arena, out->meshes[u].vertex_count, uint32_t);
    if (parents[u] == NULL)
      return LOD_MEMORY;
    find_parents(&ladder->cluster->units[u], ladder->birth[u], level, level + 1, parents[u]);
  }
  out->images = images;
  out->nearby = nearby;
  out->parents = finest ? NULL : parents;
  return LOD_OK;
}

static enum lod_status emit_nested(struct ladder *ladder, lod_level_sink *sink, void *context) {
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; status == LOD_OK && i < ladder->count; i++) {
    struct lod_arena *arena = lod_arena_create_child(ladder->arena);
    struct lod_level level;
    status = arena != NULL ? make_level(ladder, ladder->count - 1 - i, arena, &level) : LOD_MEMORY;
    if (status == LOD_OK && lod_progress_cancelled(ladder->progress))
      status = LOD_CANCELLED;
    if (status == LOD_OK)
      status = sink(context, &level);
    lod_arena_destroy(arena);
    lod_progress_report(ladder->progress, "levels", 0.3 + 0.7 * (i + 1) / ladder->count);
  }
  return status;
}

/* The same widths, every level opened for itself. */
static enum lod_status emit_independent(struct ladder *ladder, lod_level_sink *sink, void *context, struct lod_problem *problem) {
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; status == LOD_OK && i < ladder->count; i++) {
    struct lod_arena *arena = lod_arena_create_child(ladder->arena);
    struct lod_level level;
    status = arena != NULL ? lod_cluster_level(ladder->cluster, ladder->cells[ladder->count - 1 - i], arena, &level, problem) : LOD_MEMORY;
    if (status == LOD_OK && lod_progress_cancelled(ladder->progress))
      status = LOD_CANCELLED;
    if (status == LOD_OK)
      status = sink(context, &level);
    lod_arena_destroy(arena);
    lod_progress_report(ladder->progress, "levels", 0.3 + 0.7 * (i + 1) / ladder->count);
  }
  return status;
}

static enum lod_status run(struct ladder *ladder, lod_level_sink *sink, void *context, struct lod_problem *problem) {
  const struct lod_cluster *cluster = ladder->cluster;
  ladder->birth = LOD_NEW(ladder->arena, cluster->unit_count, uint8_t *);
  if (ladder->birth == NULL)
    return LOD_MEMORY;
  for (uint32_t u = 0; u < cluster->unit_count; u++) {
    ladder->birth[u] = LOD_NEW(ladder->arena, cluster->units[u].count, uint8_t);
    if (ladder->birth[u] == NULL)
      return LOD_MEMORY;
    memset(ladder->birth[u], CLUSTER_UNBORN, cluster->units[u].count);
  }
  LOD_TRY(cluster->settings.cells != NULL ? climb_given(ladder) : climb(ladder));
  return cluster->settings.nested ? emit_nested(ladder, sink, context) : emit_independent(ladder, sink, context, problem);
}

enum lod_status lod_cluster_ladder(const struct lod_cluster *cluster, const struct lod_progress *progress, struct lod_arena *arena,
                                   lod_level_sink *sink, void *sink_context, struct lod_problem *problem) {
  struct ladder ladder = {.cluster = cluster, .progress = progress, .arena = lod_arena_create_child(arena)};
  enum lod_status status = ladder.arena != NULL ? run(&ladder, sink, sink_context, problem) : LOD_MEMORY;
  lod_arena_destroy(ladder.arena);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

static enum lod_status build(const struct lod_unit *units, uint32_t unit_count, const void *settings, const struct lod_progress *progress,
                             struct lod_arena *arena, lod_level_sink *sink, void *sink_context, struct lod_problem *problem) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return lod_fail_memory(problem);
  struct lod_cluster *cluster;
  enum lod_status status = lod_cluster_create(units, unit_count, settings, progress, scratch, &cluster, problem);
  if (status == LOD_OK)
    status = lod_cluster_ladder(cluster, progress, scratch, sink, sink_context, problem);
  lod_arena_destroy(scratch);
  return status;
}

const struct lod_family lod_cluster_family = {
    .name = "cluster",
    .sentence =
        "Floating-cell vertex clustering (Low and Tan 1997): any polygon soup, across parts, with thick edges for what becomes thin.",
    .nested = true,
    .build = build,
};
