#include "core/retile/retile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/curvature.h"
#include "core/retile/internal.h"

struct lod_retile_settings lod_retile_defaults(void) {
  return (struct lod_retile_settings){.ratio = 4,
                                      .least = 80,
                                      .finest_error = 2e-4,
                                      .placement = LOD_RETILE_ELIMINATION,
                                      .steps = 25,
                                      .damping = 0.25,
                                      .radius = 1.2,
                                      .seed = 1,
                                      .curvature = LOD_RETILE_CURVATURE_TENSOR,
                                      .adapt = 2,
                                      .crease_degrees = LOD_TOLERANCE_CREASE_DEGREES,
                                      .corner_degrees = 45,
                                      .lead = 0.03,
                                      .settle = 8,
                                      .flips = 4,
                                      .whole_maps = true};
}

struct lod_retile_settings lod_retile_turk(void) {
  struct lod_retile_settings s = lod_retile_defaults();
  s.placement = LOD_RETILE_TURK;
  s.curvature = LOD_RETILE_CURVATURE_TURK;
  s.measure = LOD_RETILE_MEASURE_LENGTH;
  s.projection = LOD_RETILE_PLANES;
  s.steps = 40;
  s.damping = 0.15;
  s.radius = 2;
  s.crease_degrees = 180;
  s.flips = 2;
  s.lead = 0;
  s.settle = 0;
  s.whole_maps = false;
  return s;
}

enum lod_status retile_check_settings(const struct lod_retile_settings *s, struct lod_problem *problem) {
  if ((s->vertices != NULL || s->errors != NULL) && (s->level_count == 0 || s->level_count > LOD_RETILE_MAX_LEVELS))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-vertices", "Between 1 and %d vertex counts can be asked for, not %u.",
                    LOD_RETILE_MAX_LEVELS, s->level_count);
  for (uint32_t k = 0; s->errors != NULL && k < s->level_count; k++)
    if (!(s->errors[k] >= 0 && s->errors[k] < INFINITY) || (s->vertices == NULL && s->errors[k] == 0))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-errors", "The error of a level must be a positive number, not %g.", s->errors[k]);
  if (s->vertices == NULL && s->errors == NULL && !(s->ratio >= 1.1 && s->ratio <= 1000 && s->finest_error > 0))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-ladder",
                    "The ratio of levels must be in [1.1, 1000] and the finest error positive, not %g and %g.", s->ratio, s->finest_error);
  if (!(s->damping >= 0 && s->damping <= 1 && s->radius >= 0 && s->radius <= 10 && s->adapt >= 1 && s->adapt <= 100 && s->steps <= 10000))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-repulsion",
                    "Repulsion takes a damping in [0, 1], a radius in [0, 10], at most 10000 steps, and spacing adapts by 1 to 100.");
  if (!(s->lead >= 0 && s->lead <= 0.9 && s->settle <= 1000 && s->prune >= 0 && s->prune <= 1000 && s->anisotropy >= 0 &&
        s->anisotropy <= 100))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-lead",
                    "The share of vertices led by the error must be in [0, 0.9], not %g, pruning in [0, 1000] and anisotropy in [0, 100].",
                    s->lead);
  return LOD_OK;
}

static int compare_counts(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

enum lod_status retile_vertices_for(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, double error,
                                    struct lod_arena *arena, double *vertices) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_curvature curvature;
  struct lod_adjacency own;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : adjacency != NULL ? LOD_OK : lod_adjacency_create(mesh, scratch, &own);
  if (status == LOD_OK)
    status = lod_curvature_estimate(mesh, adjacency != NULL ? adjacency : &own, LOD_CURVATURE_TENSOR, LOD_TOLERANCE_CREASE_DEGREES, scratch,
                                    &curvature);
  *vertices = 0;
  for (uint32_t t = 0; status == LOD_OK && t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    double k = 0;
    for (int i = 0; i < 3; i++) {
      p[i] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][i]]);
      k += curvature.largest[mesh->triangles[t][i]] / 3;
    }
    double area = 0.5 * lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
    *vertices += area * k / (8 * error) * 1.1547005383792517;
  }
  lod_arena_destroy(scratch);
  return status;
}

static int compare_errors(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x < y) - (x > y);
}

/* Share of the vertices that an error needs by curvature alone which a level begins with: what misses is added where it does. */
static const double kBegin = 0.85;

static enum lod_status choose_by_error(const struct lod_mesh *mesh, const struct lod_retile_settings *s, struct lod_arena *arena,
                                       struct retile_goal *goals) {
  double *errors = lod_arena_copy(arena, s->errors, s->level_count * sizeof *errors);
  if (errors == NULL)
    return LOD_MEMORY;
  qsort(errors, s->level_count, sizeof *errors, compare_errors);
  for (uint32_t k = 0; k < s->level_count; k++) {
    double needed;
    LOD_TRY(retile_vertices_for(mesh, NULL, errors[k], arena, &needed));
    needed = fmin(fmax(4, kBegin * needed), 0.7 * mesh->vertex_count);
    /* A level of more vertices than the source would not be worth having: the source itself misses by nothing. */
    goals[k] = (struct retile_goal){.vertices = (uint32_t)lrint(needed), .most = mesh->vertex_count, .error = errors[k]};
  }
  return LOD_OK;
}

/* Coarsest first. */
static enum lod_status choose_goals(const struct lod_mesh *mesh, const struct lod_retile_settings *s, struct lod_arena *arena,
                                    struct retile_goal goals[LOD_RETILE_MAX_LEVELS], uint32_t *level_count) {
  *level_count = s->level_count;
  if (s->vertices == NULL && s->errors != NULL)
    return choose_by_error(mesh, s, arena, goals);
  if (s->vertices != NULL) {
    uint32_t counts[LOD_RETILE_MAX_LEVELS];
    memcpy(counts, s->vertices, s->level_count * sizeof *counts);
    if (s->errors == NULL)
      qsort(counts, s->level_count, sizeof *counts, compare_counts);
    for (uint32_t k = 0; k < s->level_count; k++)
      goals[k] = (struct retile_goal){.vertices = counts[k],
                                      .most = counts[k] > UINT32_MAX / 2 ? UINT32_MAX : 2 * counts[k],
                                      .error = s->errors == NULL ? 0 : s->errors[k]};
    return LOD_OK;
  }
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double error = s->finest_error * lod_bounds_diagonal(&bounds), finest = 0;
  if (error > 0)
    LOD_TRY(retile_vertices_for(mesh, NULL, error, arena, &finest));
  bool reachable = 2 * finest <= mesh->vertex_count / s->ratio; /* what takes more is not worth chasing */
  finest = fmin(fmax(2 * finest, s->least), mesh->vertex_count);
  double steps = fmax(0, floor(log(finest / fmax(4, s->least)) / log(s->ratio) + 0.5));
  *level_count = (uint32_t)fmin(steps, LOD_RETILE_MAX_LEVELS - 1) + 1;
  for (uint32_t k = 0; k < *level_count; k++) {
    uint32_t count = (uint32_t)fmax(4, lrint(finest / pow(s->ratio, *level_count - 1 - k)));
    goals[k] = (struct retile_goal){.vertices = count, .most = 2 * count, .error = reachable && k + 1 == *level_count ? error : 0};
  }
  return LOD_OK;
}

static bool too_fine(const struct tiling *tiling, uint32_t v, uint32_t level) {
  return tiling->birth[v] > level;
}

static enum lod_status build_levels(struct tiling *tiling, const struct lod_retile_settings *settings, struct retile_goal *goals,
                                    const struct lod_progress *progress, struct lod_arena *arena, struct lod_arena *scratch,
                                    struct lod_retile *retile) {
  uint32_t *maps[2], *face_to;
  for (int i = 0; i < 2; i++)
    RETILE_TRY_NEW(maps[i], scratch, tiling->vertex_count);
  RETILE_TRY_NEW(face_to, scratch, tiling->face_count);
  for (uint32_t k = retile->level_count; k-- > 0;) {
    struct lod_retile_level *level = &retile->levels[k];
    uint32_t left;
    lod_progress_report(progress, "retile", 1 - 0.6 * (k + 1) / retile->level_count);
    if (lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    tiling_descend(tiling, k);
    LOD_TRY(remove_vertices(tiling, too_fine, k, scratch, &left));
    improve_flips(tiling, settings->flips);
    if (left != 0) { /* flips may have made room */
      LOD_TRY(remove_vertices(tiling, too_fine, k, scratch, &left));
      improve_flips(tiling, 1);
    }
    if (settings->prune > 0 && !(goals[k].error > 0))
      LOD_TRY(prune_pieces(tiling, settings->prune * sqrt(1.1547005383792517 * tiling->sheet->area / fmax(1, goals[k].vertices)), scratch));
    double bound = INFINITY;
    if (tiling->source != NULL)
      LOD_TRY(lead_level(tiling, settings, k, k + 1 < retile->level_count ? maps[(k + 1) % 2] : NULL, &goals[k], scratch, &bound));
    struct step step = {.tiling = tiling,
                        .settings = settings,
                        .goal = &goals[k],
                        .number = k,
                        .finer = k + 1 < retile->level_count ? level + 1 : NULL,
                        .finer_to = maps[(k + 1) % 2],
                        .vertex_to = maps[k % 2],
                        .face_to = face_to,
                        .arena = arena,
                        .scratch = scratch};
    LOD_TRY(step_finish(&step, &bound, level));
    level->bound = bound;
    level->missed = tiling->source == NULL ? 0 : fmin(match_worst(tiling), bound);
  }
  return LOD_OK;
}

static enum lod_status attempt(const struct cleaned *cleaned, const struct lod_retile_settings *settings, struct retile_goal *goals,
                               const struct lod_bvh *bvh, const struct lod_progress *progress, struct lod_arena *arena,
                               struct lod_arena *scratch, struct lod_retile *retile) {
  uint32_t counts[LOD_RETILE_MAX_LEVELS];
  for (uint32_t k = 0; k < retile->level_count; k++)
    counts[k] = goals[k].vertices;
  RETILE_TRY_NEW_ZERO(retile->levels, arena, retile->level_count);
  struct sheet sheet;
  struct sites sites;
  struct tiling tiling;
  LOD_TRY(sheet_create(cleaned, settings, counts, retile->level_count, scratch, &sheet));
  LOD_TRY(place_sites(&sheet, settings, counts, retile->level_count, progress, scratch, &sites));
  lod_progress_report(progress, "tessellate", 0.35);
  LOD_TRY(tiling_create(&sheet, &sites, scratch, &tiling));
  tiling.enough = INFINITY;
  tiling.measure = settings->measure;
  tiling.projection = settings->projection;
  tiling.upright = settings->whole_maps;
  tiling.source = bvh;
  return build_levels(&tiling, settings, goals, progress, arena, scratch, retile);
}

/* Numbers of vertices from what a pilot missed by: errors go with one over the number. False when they are good as they are. */
static bool correct_goals(struct retile_goal *goals, uint32_t level_count) {
  static const double kAim = 0.85, kFew = 1.2, kMany = 0.7; /* of the error: what to aim at, and what is near enough to it */
  bool changed = false;
  for (uint32_t k = level_count; k-- > 0;) {
    struct retile_goal *g = &goals[k];
    double ratio = g->error > 0 ? g->typical / (kAim * g->error) : 1;
    bool grows = ratio > kFew && g->vertices < g->most, shrinks = ratio < kMany && g->vertices > 4;
    if (!grows && !shrinks)
      continue;
    double count = fmin(g->vertices * fmin(4, fmax(0.25, ratio)), fmin(g->most, 4e9));
    g->vertices = (uint32_t)fmax(4, lrint(count));
    changed = true;
  }
  for (uint32_t k = 1; k < level_count; k++) /* levels stay in order */
    goals[k].vertices = goals[k].vertices < goals[k - 1].vertices ? goals[k - 1].vertices : goals[k].vertices;
  return changed;
}

/* A level that even with vertices put back is not mapped whole gets more to begin with. False when all are mapped. */
static bool relax_goals(struct retile_goal *goals, uint32_t level_count) {
  static const double kMore = 1.5;
  bool changed = false;
  for (uint32_t k = level_count - 1; k-- > 0;) {
    if (goals[k].unmapped == 0)
      continue;
    uint32_t more = (uint32_t)fmin(kMore * goals[k].vertices + 8, goals[k + 1].vertices);
    changed = changed || more > goals[k].vertices;
    goals[k].vertices = more > goals[k].vertices ? more : goals[k].vertices;
    goals[k].most = goals[k].most < more ? more : goals[k].most;
  }
  return changed;
}

static uint64_t unmapped(const struct retile_goal *goals, uint32_t level_count) {
  uint64_t sum = 0;
  for (uint32_t k = 0; k < level_count; k++)
    sum += goals[k].unmapped;
  return sum;
}

/* A try takes as long as the levels: small sources, whose few triangles must map all, may have several. */
static uint32_t tries_for(const struct lod_mesh *mesh) {
  enum { MOST = 5, WORK = 1000000 }; /* triangles of all tries */
  uint32_t tries = WORK / (mesh->triangle_count + 1);
  return tries < 1 ? 1 : tries < MOST ? tries : MOST;
}

/* With numbers relaxed until all maps are whole; the try that leaves least is taken. Levels of the others stay in `arena`: it is rare. */
static enum lod_status create_whole(const struct cleaned *cleaned, const struct lod_retile_settings *settings, struct retile_goal *goals,
                                    const struct lod_bvh *bvh, const struct lod_progress *progress, struct lod_arena *arena,
                                    struct lod_arena *scratch, struct lod_retile *retile) {
  uint32_t tries = settings->whole_maps ? tries_for(&cleaned->mesh) : 1;
  uint64_t least = UINT64_MAX;
  struct lod_retile best = *retile;
  for (uint32_t try = 0; try < tries && least != 0; try++) {
    struct lod_arena *work = lod_arena_create_child(scratch);
    enum lod_status status = work == NULL ? LOD_MEMORY : attempt(cleaned, settings, goals, bvh, progress, arena, work, retile);
    lod_arena_destroy(work);
    LOD_TRY(status);
    uint64_t bad = unmapped(goals, retile->level_count);
    if (bad < least) {
      best = *retile;
      least = bad;
    }
    if (bad != 0 && !relax_goals(goals, retile->level_count))
      break;
  }
  *retile = best;
  return LOD_OK;
}

static enum lod_status create(const struct lod_mesh *source, const struct lod_retile_settings *settings,
                              const struct lod_progress *progress, struct lod_arena *arena, struct lod_arena *scratch,
                              struct lod_retile *retile) {
  enum { MOST_PILOTS = 3 };
  struct cleaned cleaned;
  LOD_TRY(clean_source(source, scratch, &cleaned));
  const struct lod_mesh *mesh = &cleaned.mesh;
  struct retile_goal goals[LOD_RETILE_MAX_LEVELS];
  LOD_TRY(choose_goals(mesh, settings, scratch, goals, &retile->level_count));
  struct lod_bvh *bvh = NULL;
  bool errors = false;
  for (uint32_t k = 0; k < retile->level_count; k++)
    errors = errors || goals[k].error > 0;
  if (settings->lead > 0 || errors)
    LOD_TRY(lod_bvh_create(mesh, settings->threads, scratch, &bvh));
  /* Numbers asked for, or of a ladder, are not tried beforehand: that would take as long as the levels themselves. */
  for (int pilot = 0; pilot < MOST_PILOTS && settings->vertices == NULL && settings->errors != NULL; pilot++) {
    struct lod_arena *trial = lod_arena_create_child(scratch);
    for (uint32_t k = 0; k < retile->level_count; k++)
      goals[k].pilot = true;
    enum lod_status status = trial == NULL ? LOD_MEMORY : attempt(&cleaned, settings, goals, bvh, progress, trial, trial, retile);
    lod_arena_destroy(trial);
    LOD_TRY(status);
    if (!correct_goals(goals, retile->level_count))
      break;
  }
  for (uint32_t k = 0; k < retile->level_count; k++)
    goals[k].pilot = false;
  return create_whole(&cleaned, settings, goals, bvh, progress, arena, scratch, retile);
}

enum lod_status lod_retile_create(const struct lod_mesh *mesh, const struct lod_retile_settings *settings,
                                  const struct lod_progress *progress, struct lod_arena *arena, struct lod_retile *retile,
                                  struct lod_problem *problem) {
  struct lod_retile_settings defaults = lod_retile_defaults();
  *retile = (struct lod_retile){0};
  if (settings == NULL)
    settings = &defaults;
  LOD_TRY(retile_check_settings(settings, problem));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : create(mesh, settings, progress, arena, scratch, retile);
  lod_arena_destroy(scratch);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  else if (status == LOD_CANCELLED)
    lod_fail(problem, status, "cancelled", "The bake was cancelled.");
  else if (status == LOD_LIMIT)
    lod_fail(problem, status, "limit-vertices", "The source and the vertices asked for make more than 2^32 half-edges.");
  return status;
}

static enum lod_status tessellate(const struct lod_mesh *mesh, const struct lod_retile_point *points, uint32_t point_count,
                                  struct lod_arena *arena, struct lod_arena *scratch, struct lod_mesh *out) {
  struct lod_retile_settings settings = lod_retile_defaults();
  struct sheet sheet;
  struct sites sites = {.count = point_count};
  struct tiling tiling;
  settings.curvature = LOD_RETILE_CURVATURE_NONE;
  settings.anisotropy = 0;
  const struct cleaned as_it_is = {.source = mesh, .mesh = *mesh};
  LOD_TRY(sheet_create(&as_it_is, &settings, &(uint32_t){point_count}, 1, scratch, &sheet));
  RETILE_TRY_NEW(sites.items, scratch, point_count);
  for (uint32_t i = 0; i < point_count; i++) {
    struct lod_retile_point p = points[i];
    sites.items[i] = (struct site){p, LOD_NONE, 0};
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t h = 3 * p.face + (k + 1) % 3;
      if (p.weights[k] == LOD_RETILE_ONE)
        sites.items[i].vertex = sheet.faces[p.face][k];
      else if (p.weights[k] == 0 && sheet.twin[h] < h) { /* an edge is named by its lower half-edge */
        uint32_t twin = sheet.twin[h];
        struct lod_retile_point *q = &sites.items[i].point;
        *q = (struct lod_retile_point){.face = twin / 3};
        q->weights[twin % 3] = p.weights[(k + 2) % 3];
        q->weights[(twin + 1) % 3] = p.weights[(k + 1) % 3];
      }
    }
  }
  LOD_TRY(tiling_create(&sheet, &sites, scratch, &tiling));
  *out = (struct lod_mesh){.vertex_count = tiling.vertex_count};
  RETILE_TRY_NEW(out->positions, arena, tiling.vertex_count);
  RETILE_TRY_NEW(out->triangles, arena, tiling.face_count);
  for (uint32_t v = 0; v < tiling.vertex_count; v++)
    lod_vec3_to_float(tiling.positions[v], out->positions[v]);
  for (uint32_t f = 0; f < tiling.face_count; f++)
    if (tiling.faces[f][0] != LOD_NONE)
      memcpy(out->triangles[out->triangle_count++], tiling.faces[f], sizeof *out->triangles);
  return LOD_OK;
}

enum lod_status lod_retile_tessellate(const struct lod_mesh *mesh, const struct lod_retile_point *points, uint32_t point_count,
                                      struct lod_arena *arena, struct lod_mesh *tessellation) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : tessellate(mesh, points, point_count, arena, scratch, tessellation);
  lod_arena_destroy(scratch);
  return status;
}
