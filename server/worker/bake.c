#include "server/worker/bake.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/cluster/cluster.h"
#include "core/envelope/envelope.h"
#include "core/mesh/copy.h"
#include "core/mesh/intersect.h"
#include "core/mesh/topology.h"
#include "core/retile/retile.h"
#include "server/worker/deltas.h"
#include "server/worker/edges.h"
#include "server/worker/envelope_recipe.h"
#include "server/worker/levels.h"
#include "server/worker/manifest.h"
#include "server/worker/patches.h"
#include "server/worker/retile_recipe.h"

/* Levels that are the source itself, differing in precision alone (shares of the diagonal): the finest, and one for the wide gap in bytes
 * between it and the first simplified level. */
static const double kSourcePrecision[] = {1e-5, 1e-4};
enum { SOURCE_LEVELS = sizeof kSourcePrecision / sizeof kSourcePrecision[0] };

/* Of the progress bar: when the model is imported, and when all families are; of a family's share, when its levels are built. */
static const double kImported = 0.1, kWritten = 0.95, kBuilt = 0.4;

/* A family with the settings that a request asks of it, made in `arena`; settings NULL: the levels of the source itself meet the request.
 */
struct recipe {
  const struct lod_family *family;
  bool by_default;
  bool searches; /* with errors asked for it makes more levels than those, of which keep_requested chooses */
  enum lod_status (*settings)(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings);
};

static enum lod_status cluster_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                        const void **settings);
static enum lod_status envelope_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                         const void **settings);
static enum lod_status retile_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                       const void **settings);

static enum lod_status clod_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                     const void **settings);

static const struct recipe kRecipes[] = {
    {&lod_cluster_family, true, true, cluster_settings},
    {&lod_envelope_family, false, false, envelope_settings}, /* takes ten times as long as clustering */
    {&lod_retile_family, false, false, retile_settings},
    {&lod_curved_family, false, false, clod_settings},
};
enum { RECIPE_COUNT = sizeof kRecipes / sizeof kRecipes[0] };

const struct lod_family *lod_bake_family(uint32_t index) {
  return index < RECIPE_COUNT ? kRecipes[index].family : NULL;
}

static int compare(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return x < y ? -1 : x > y ? 1 : 0;
}

/* The errors asked for in model units, smallest first, each once; those that quantisation alone would break are left out: the levels of the
 * source itself are for them. */
static uint32_t requested_errors(const struct lod_bake_request *request, double diagonal, double *errors) {
  uint32_t count = 0;
  for (uint32_t i = 0; i < request->epsilon_count; i++) {
    double error = request->epsilons[i] * (request->epsilon_relative[i] ? diagonal : 1);
    if (error > 4 * kSourcePrecision[0] * diagonal)
      errors[count++] = error;
  }
  qsort(errors, count, sizeof *errors, compare);
  uint32_t kept = 0;
  for (uint32_t i = 0; i < count; i++)
    if (kept == 0 || errors[i] > errors[kept - 1])
      errors[kept++] = errors[i];
  return kept;
}

/* Cells among which those are found that meet the errors asked for: a cell's proven bound is its width, but the certified error is mostly a
 * small share of it, a different one on every model. So a ladder of cells is baked, from the width whose bound leaves a quarter of the
 * least error to quantisation up to `kWidestCell` of the greatest, and keep_requested keeps for each error the level of fewest bytes. Being
 * one ladder, what is kept is nested. */
static const double kCellStep = 1.2599210498948732; /* 2^(1/3) */
static const double kWidestCell = 32, kWidestCellOfDiagonal = 0.25;
enum { MAX_CELLS = 64 }; /* of struct lod_cluster_settings */

static uint32_t cells_for_errors(const double *errors, uint32_t count, double diagonal, double *cells) {
  double narrow = 0.75 * errors[0];
  double wide = fmax(narrow, fmin(kWidestCell * errors[count - 1], kWidestCellOfDiagonal * diagonal));
  double step = fmax(kCellStep, pow(wide / narrow, 1.0 / (MAX_CELLS - 1)));
  uint32_t cell_count = 0;
  for (double cell = narrow; cell <= wide && cell_count < MAX_CELLS; cell *= step)
    cells[cell_count++] = cell;
  return cell_count;
}

static enum lod_status cluster_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                        const void **settings) {
  struct lod_cluster_settings *cluster = LOD_NEW(arena, 1, struct lod_cluster_settings);
  double *cells = LOD_NEW(arena, MAX_CELLS, double);
  if (cluster == NULL || cells == NULL)
    return LOD_MEMORY;
  *cluster = lod_cluster_defaults();
  cluster->threads = request->threads;
  if (request->epsilon_count != 0) {
    double errors[LOD_BAKE_MAX_LIST];
    uint32_t count = requested_errors(request, diagonal, errors);
    if (count == 0) {
      *settings = NULL;
      return LOD_OK;
    }
    cluster->cells = cells;
    cluster->cell_count = cells_for_errors(errors, count, diagonal, cells);
  }
  *settings = cluster;
  return LOD_OK;
}

struct lod_bake_request lod_bake_defaults(void) {
  return (struct lod_bake_request){.id = "model", .name = "model", .directory_fd = -1, .limits = lod_import_limits_defaults()};
}

enum { MAX_LEVELS = 96 }; /* of one family */

/* One run. */
struct bake {
  const struct lod_bake_request *request;
  struct lod_problem *problem;
  struct lod_arena *arena;
  struct lod_model model;
  struct lod_source_facts source;
  struct lod_level_baker baker;
  struct lod_progress_span silent;
  char (*image_objects)[LOD_HASH_HEX + 1];
  const struct recipe *recipes[RECIPE_COUNT];
  struct lod_baked_family families[RECIPE_COUNT];
  uint32_t family_count;
  struct lod_envelope_wishes *wishes; /* one a unit; NULL when the request has none */
  struct lod_baked_level source_levels[SOURCE_LEVELS];
  struct lod_arena *level_arenas[RECIPE_COUNT * MAX_LEVELS]; /* hold the levels' bytes */
  uint32_t level_arena_count;
};

static enum lod_status envelope_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                         const void **settings) {
  double errors[LOD_BAKE_MAX_LIST];
  uint32_t count = requested_errors(request, diagonal, errors);
  const struct lod_envelope_settings *envelope;
  LOD_TRY(lod_envelope_recipe(request, errors, count, diagonal, arena, &envelope, NULL)); /* checked in choose_families */
  *settings = envelope;
  return LOD_OK;
}

static enum lod_status retile_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                       const void **settings) {
  double errors[LOD_BAKE_MAX_LIST];
  uint32_t count = requested_errors(request, diagonal, errors);
  const struct lod_retile_settings *retile = NULL;
  if (request->vertices_count != 0 || request->epsilon_count == 0 || count != 0)
    LOD_TRY(lod_retile_recipe(request, errors, count, arena, &retile, NULL)); /* options are checked in choose_families */
  *settings = retile;
  return LOD_OK;
}

static enum lod_status clod_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena,
                                     const void **settings) {
  struct lod_curved_settings *curved = LOD_NEW_ZERO(arena, 1, struct lod_curved_settings);
  double *errors = LOD_NEW(arena, LOD_BAKE_MAX_LIST, double);
  if (curved == NULL || errors == NULL)
    return LOD_MEMORY;
  *settings = curved;
  curved->errors = errors;
  curved->search = request->patches_search;
  if (request->patches_count != 0) {
    curved->patches = request->patches;
    curved->patch_count = request->patches_count;
  } else if (request->epsilon_count != 0) {
    curved->error_count = requested_errors(request, diagonal, errors);
    *settings = curved->error_count == 0 ? NULL : curved;
  } else {
    const double *ladder = lod_curved_ladder(&curved->error_count);
    for (uint32_t i = 0; i < curved->error_count; i++)
      errors[i] = ladder[i] * diagonal;
  }
  return LOD_OK;
}

static double now_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static enum lod_status choose_families(struct bake *bake) {
  const struct lod_bake_request *request = bake->request;
  bool chosen[RECIPE_COUNT] = {false};
  for (uint32_t i = 0; i < request->family_count; i++) {
    uint32_t k = 0;
    while (k < RECIPE_COUNT && strcmp(kRecipes[k].family->name, request->families[i]) != 0)
      k++;
    if (k == RECIPE_COUNT) {
      char names[128] = "";
      for (k = 0; k < RECIPE_COUNT; k++)
        snprintf(names + strlen(names), sizeof names - strlen(names), "%s%s", k == 0 ? "" : ", ", kRecipes[k].family->name);
      return lod_fail(bake->problem, LOD_UNSUPPORTED, "unknown-family", "There is no family \"%s\"; this version bakes: %s.",
                      request->families[i], names);
    }
    chosen[k] = true;
  }
  struct lod_retile_settings ignored = lod_retile_defaults();
  for (uint32_t i = 0; i < request->retile_option_count; i++)
    LOD_TRY(lod_retile_recipe_option(request->retile_options[i], &ignored, bake->problem));
  struct lod_envelope_options unused = lod_envelope_options_defaults();
  for (uint32_t i = 0; i < request->envelope_option_count; i++)
    LOD_TRY(lod_envelope_recipe_option(request->envelope_options[i], &unused, bake->problem));
  for (uint32_t k = 0; k < RECIPE_COUNT; k++)
    if (chosen[k] || (request->family_count == 0 && kRecipes[k].by_default)) {
      bake->recipes[bake->family_count] = &kRecipes[k];
      bake->families[bake->family_count++].family = kRecipes[k].family;
    }
  return LOD_OK;
}

static enum lod_status import(struct bake *bake) {
  const struct lod_bake_request *request = bake->request;
  struct lod_progress_span span;
  lod_progress_span_init(&span, request->progress, 0, kImported);
  struct lod_import_request import = {
      .name = request->name,
      .format = request->format,
      .bytes = request->bytes,
      .size = request->size,
      .files = request->files,
      .limits = &request->limits,
      .progress = &span.step,
      .threads = request->threads,
  };
  LOD_TRY(lod_import_model(&import, bake->arena, &bake->model, bake->problem));
  lod_hash_bytes(request->bytes, request->size, bake->source.sha256);
  bake->source.bytes = request->size;
  bake->source.bounds = lod_model_bounds(&bake->model);
  bake->source.sphere = lod_model_sphere(&bake->model);
  bake->source.closed = true;
  for (uint32_t u = 0; u < bake->model.unit_count; u++) {
    struct lod_topology topology;
    if (lod_topology_measure(&bake->model.units[u].mesh, NULL, bake->arena, &topology) != LOD_OK)
      return lod_fail_memory(bake->problem);
    bake->source.components += topology.components;
    bake->source.boundary_loops += topology.boundary_loops;
    bake->source.non_manifold_edges += topology.non_manifold_edges;
    bake->source.degenerate_triangles += topology.degenerate_triangles;
    bake->source.closed = bake->source.closed && topology.closed;
  }
  return LOD_OK;
}

static enum lod_status write_images(struct bake *bake) {
  const struct lod_model *model = &bake->model;
  bake->image_objects = lod_arena_calloc(bake->arena, model->image_count, sizeof *bake->image_objects);
  const char **uris = LOD_NEW(bake->arena, model->image_count, const char *);
  if (bake->image_objects == NULL || uris == NULL)
    return lod_fail_memory(bake->problem);
  for (uint32_t i = 0; i < model->image_count; i++) {
    LOD_TRY(lod_output_object(bake->request->directory_fd, model->images[i].bytes, model->images[i].size, bake->image_objects[i],
                              bake->problem));
    uris[i] = bake->image_objects[i];
  }
  bake->baker.image_uris = uris;
  return LOD_OK;
}

static enum lod_status prepare_baker(struct bake *bake) {
  struct lod_level_baker *baker = &bake->baker;
  baker->model = &bake->model;
  baker->diagonal = lod_bounds_diagonal(&bake->source.bounds);
  baker->threads = bake->request->threads;
  lod_progress_span_init(&bake->silent, bake->request->progress, 0, 0); /* levels that are made side by side have no bar of their own */
  baker->progress = &bake->silent.step;
  baker->source_bvhs = LOD_NEW(bake->arena, bake->model.unit_count, struct lod_bvh *);
  if (baker->source_bvhs == NULL)
    return lod_fail_memory(bake->problem);
  if (!(baker->diagonal > 0))
    return lod_fail(bake->problem, LOD_BAD_INPUT, "zero-size", "%s: all vertices lie at one point; a model needs an extent.",
                    bake->request->name);
  for (uint32_t u = 0; u < bake->model.unit_count; u++)
    if (lod_bvh_create(&bake->model.units[u].mesh, bake->request->threads, bake->arena, &baker->source_bvhs[u]) != LOD_OK)
      return lod_fail_memory(bake->problem);
  return LOD_OK;
}

/* A level that waits to be encoded and certified. Levels do not depend on each other, so all of a family's are done side by side, finest
 * (and longest) first. */
struct pending {
  struct lod_arena *arena; /* of the copy, then of the result */
  struct lod_level level;
  double position_error; /* as lod_level_bake */
  struct lod_baked_level *baked;
  enum lod_status status;
  struct lod_problem problem;
};

struct family_job {
  struct bake *bake;
  struct lod_baked_family *family;
  struct pending *pending;
  uint32_t pending_count;
  struct lod_level *made; /* all levels of the family, as it made them, in that order; those of the source first */
  pthread_mutex_t lock;
  double waiting, done;                 /* triangles: of the levels that are pending, of those among them that are baked */
  struct lod_progress_span build;       /* what the family itself does, */
  struct lod_progress_span bake_levels; /* and what is done with its levels when it has ended */
};

static uint64_t level_triangles(const struct bake *bake, const struct lod_level *level) {
  uint64_t triangles = 0;
  for (uint32_t u = 0; u < bake->model.unit_count; u++)
    triangles += level->meshes[u].triangle_count;
  return triangles;
}

/* maps: per unit `count(unit)` numbers or NULL. */
static uint32_t *const *copy_maps(const struct bake *bake, uint32_t *const *maps, bool by_vertex, struct lod_arena *arena, bool *ok) {
  if (maps == NULL)
    return NULL;
  uint32_t **copy = LOD_NEW_ZERO(arena, bake->model.unit_count, uint32_t *);
  for (uint32_t u = 0; copy != NULL && u < bake->model.unit_count; u++) {
    const struct lod_mesh *source = &bake->model.units[u].mesh;
    size_t count = by_vertex ? source->vertex_count : source->triangle_count;
    if (maps[u] != NULL && (copy[u] = lod_arena_copy(arena, maps[u], count * sizeof **maps)) == NULL)
      *ok = false;
  }
  *ok = *ok && copy != NULL;
  return copy;
}

static uint32_t *const *copy_parents(const struct bake *bake, const struct lod_level *level, struct lod_arena *arena, bool *ok) {
  if (level->parents == NULL)
    return NULL;
  uint32_t **copy = LOD_NEW_ZERO(arena, bake->model.unit_count, uint32_t *);
  for (uint32_t u = 0; copy != NULL && u < bake->model.unit_count; u++)
    if (level->parents[u] != NULL &&
        (copy[u] = lod_arena_copy(arena, level->parents[u], level->meshes[u].vertex_count * sizeof **copy)) == NULL)
      *ok = false;
  *ok = *ok && copy != NULL;
  return copy;
}

static enum lod_status add_pending(struct family_job *job, const struct lod_level *level, double position_error) {
  struct bake *bake = job->bake;
  if (job->pending_count == MAX_LEVELS)
    return LOD_OK;
  struct pending *pending = &job->pending[job->pending_count];
  *pending = (struct pending){.level = *level, .position_error = position_error, .arena = lod_arena_create_child(bake->arena)};
  if (pending->arena == NULL)
    return lod_fail_memory(bake->problem);
  job->pending_count++;
  pending->level.meshes = LOD_NEW(pending->arena, bake->model.unit_count, struct lod_mesh);
  bool ok = pending->level.meshes != NULL;
  for (uint32_t u = 0; ok && u < bake->model.unit_count; u++)
    ok = lod_mesh_copy(&level->meshes[u], pending->arena, &pending->level.meshes[u]) == LOD_OK;
  pending->level.images = copy_maps(bake, level->images, true, pending->arena, &ok);
  pending->level.nearby = copy_maps(bake, level->nearby, false, pending->arena, &ok);
  if (ok && level->patches != NULL) {
    struct lod_level_patches *patches = lod_arena_copy(pending->arena, level->patches, sizeof *patches);
    ok = patches != NULL && (patches->bytes = lod_arena_copy(pending->arena, patches->bytes, patches->size)) != NULL;
    pending->level.patches = patches;
  }
  pending->level.replacements = NULL;
  pending->level.parents = copy_parents(bake, level, pending->arena, &ok);
  job->waiting += (double)level_triangles(bake, level);
  return ok ? LOD_OK : lod_fail_memory(bake->problem);
}

static void bake_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct family_job *job = context;
  (void)chunk;
  for (size_t i = begin; i < end; i++) {
    struct pending *pending = &job->pending[i];
    if (lod_progress_cancelled(job->bake->request->progress)) {
      pending->status = LOD_CANCELLED;
      continue;
    }
    struct lod_level_baker baker = job->bake->baker;
    baker.threads = 1;
    pending->status = lod_level_bake(&baker, &pending->level, pending->position_error, pending->arena, pending->baked, &pending->problem);
    pthread_mutex_lock(&job->lock);
    job->done += (double)level_triangles(job->bake, &pending->level);
    lod_progress_report(&job->bake_levels.step, "certify", job->done / fmax(1, job->waiting));
    pthread_mutex_unlock(&job->lock);
  }
}

/* Encodes and certifies what waits; the results' arenas stay with the bake. */
static enum lod_status bake_pending(struct family_job *job) {
  struct bake *bake = job->bake;
  struct lod_baked_family *family = job->family;
  for (uint32_t i = 0; i < job->pending_count; i++) {
    job->pending[i].baked = &family->levels[family->level_count + i];
    job->made[family->level_count + i] = job->pending[i].level;
  }
  lod_parallel_for(bake->request->threads, job->pending_count, 1, bake_chunk, job);
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; i < job->pending_count; i++) {
    struct pending *pending = &job->pending[i];
    bake->level_arenas[bake->level_arena_count++] = pending->arena;
    if (status != LOD_OK || pending->status == LOD_OK)
      continue;
    status = pending->status;
    if (pending->problem.status != LOD_OK)
      *bake->problem = pending->problem;
    else if (status == LOD_MEMORY)
      lod_fail_memory(bake->problem);
    else if (status == LOD_CANCELLED)
      lod_fail(bake->problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
  }
  for (uint32_t i = 0; i < job->pending_count; i++, family->level_count++)
    family->levels[family->level_count].made = family->level_count;
  job->pending_count = 0;
  job->waiting = job->done = 0;
  return status;
}

/* Levels wait for others to be baked beside, but not for more memory than a halving ladder and the source's own levels take. */
static enum lod_status receive_level(void *context, const struct lod_level *level) {
  struct family_job *job = context;
  double source = 0;
  for (uint32_t u = 0; u < job->bake->model.unit_count; u++)
    source += job->bake->model.units[u].mesh.triangle_count;
  LOD_TRY(add_pending(job, level, 0));
  return job->waiting > (SOURCE_LEVELS + 3) * source ? bake_pending(job) : LOD_OK;
}

/* The source as imported, at the precisions of kSourcePrecision. */
static enum lod_status add_source_levels(struct family_job *job) {
  const struct lod_model *model = &job->bake->model;
  struct lod_arena *scratch = lod_arena_create_child(job->bake->arena);
  struct lod_mesh *meshes = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, struct lod_mesh);
  uint32_t **identity = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, uint32_t *);
  enum lod_status status = meshes == NULL || identity == NULL ? lod_fail_memory(job->bake->problem) : LOD_OK;
  for (uint32_t u = 0; status == LOD_OK && u < model->unit_count; u++) {
    meshes[u] = model->units[u].mesh;
    identity[u] = LOD_NEW(scratch, meshes[u].vertex_count, uint32_t);
    if (identity[u] == NULL)
      status = lod_fail_memory(job->bake->problem);
    for (uint32_t v = 0; status == LOD_OK && v < meshes[u].vertex_count; v++)
      identity[u][v] = v;
  }
  for (size_t i = 0; status == LOD_OK && i < SOURCE_LEVELS; i++) {
    struct lod_level level = {.meshes = meshes, .images = identity, .bound = 0};
    status = add_pending(job, &level, kSourcePrecision[i] * job->bake->baker.diagonal);
  }
  lod_arena_destroy(scratch);
  return status;
}

static enum lod_status gather_levels(struct bake *bake, uint32_t index, struct family_job *job) {
  struct lod_baked_family *family = job->family;
  const void *settings;
  if (bake->recipes[index]->settings(bake->request, bake->baker.diagonal, bake->arena, &settings) != LOD_OK)
    return lod_fail_memory(bake->problem);
  if (index == 0) {
    LOD_TRY(add_source_levels(job));
  } else { /* they are every family's finest */
    memcpy(family->levels, bake->source_levels, sizeof bake->source_levels);
    family->level_count = SOURCE_LEVELS;
  }
  if (settings == NULL)
    return LOD_OK;
  if (family->family == &lod_envelope_family) {
    const struct lod_envelope_settings *envelope = settings;
    if (lod_envelope_recipe_fit(&bake->model, bake->wishes, bake->arena, &envelope) != LOD_OK)
      return lod_fail_memory(bake->problem);
    settings = envelope;
  }
  return family->family->build(bake->model.units, bake->model.unit_count, settings, &job->build.step, bake->arena, receive_level, job,
                               bake->problem);
}

static bool is_source_level(const struct bake *bake, const struct lod_baked_level *level) {
  for (size_t i = 0; i < SOURCE_LEVELS; i++)
    if (level->bytes == bake->source_levels[i].bytes)
      return true;
  return false;
}

/* Of ordered levels: for each error asked for the one of fewest bytes that meets it, and those of the source. */
static void keep_requested(const struct bake *bake, struct lod_baked_family *family) {
  double errors[LOD_BAKE_MAX_LIST];
  uint32_t count = requested_errors(bake->request, bake->baker.diagonal, errors), kept = 0;
  double coarser = INFINITY; /* error of the level before */
  for (uint32_t i = 0; i < family->level_count; i++) {
    bool wanted = is_source_level(bake, &family->levels[i]);
    for (uint32_t k = 0; k < count; k++)
      wanted = wanted || (family->levels[i].error.upper <= errors[k] && errors[k] < coarser);
    coarser = family->levels[i].error.upper;
    if (wanted)
      family->levels[kept++] = family->levels[i];
  }
  family->level_count = kept;
}

static enum lod_status build_family(struct bake *bake, uint32_t index) {
  struct lod_baked_family *family = &bake->families[index];
  family->nested = family->family->nested || (family->family == &lod_envelope_family && lod_envelope_recipe_nests(bake->request));
  struct family_job job = {
      .bake = bake,
      .family = family,
      .lock = PTHREAD_MUTEX_INITIALIZER,
  };
  double share = (kWritten - kImported) / bake->family_count, begin = kImported + share * index;
  lod_progress_span_init(&job.build, bake->request->progress, begin, begin + kBuilt * share);
  family->levels = LOD_NEW_ZERO(bake->arena, MAX_LEVELS + SOURCE_LEVELS, struct lod_baked_level);
  job.pending = LOD_NEW_ZERO(bake->arena, MAX_LEVELS, struct pending);
  job.made = LOD_NEW_ZERO(bake->arena, MAX_LEVELS + SOURCE_LEVELS, struct lod_level);
  if (family->levels == NULL || job.pending == NULL || job.made == NULL)
    return lod_fail_memory(bake->problem);
  lod_progress_report(&job.build.step, family->family->name, 0);
  enum lod_status status = gather_levels(bake, index, &job);
  lod_progress_span_init(&job.bake_levels, bake->request->progress, begin + kBuilt * share, begin + share);
  if (status == LOD_OK)
    status = bake_pending(&job);
  else
    for (uint32_t i = 0; i < job.pending_count; i++)
      lod_arena_destroy(job.pending[i].arena);
  LOD_TRY(status);
  if (index == 0)
    memcpy(bake->source_levels, family->levels, sizeof bake->source_levels);
  family->level_count = lod_levels_order(family->levels, family->level_count);
  if (family->family == &lod_retile_family &&
      lod_retile_recipe_warn(bake->request, family->levels, family->level_count, bake->arena, &bake->model) != LOD_OK)
    return lod_fail_memory(bake->problem);
  if (bake->request->epsilon_count != 0 && bake->recipes[index]->searches)
    keep_requested(bake, family);
  for (uint32_t i = 0; i < family->level_count; i++) {
    struct lod_baked_level *level = &family->levels[i];
    LOD_TRY(lod_output_object(bake->request->directory_fd, level->bytes, level->size, level->object, bake->problem));
    if (level->patches.size != 0)
      LOD_TRY(
          lod_output_object(bake->request->directory_fd, level->patches.bytes, level->patches.size, level->patches.object, bake->problem));
  }
  if (!family->nested)
    return LOD_OK;
  struct lod_deltas_request deltas = {.model = &bake->model,
                                      .levels = family->levels,
                                      .level_count = family->level_count,
                                      .made = job.made,
                                      .source_levels = SOURCE_LEVELS,
                                      .maps = family->family == &lod_retile_family,
                                      .directory_fd = bake->request->directory_fd,
                                      .progress = bake->request->progress};
  return lod_deltas_bake(&deltas, bake->arena, bake->problem);
}

static enum lod_status warn(struct bake *bake, const char *sentence, uint64_t count) {
  enum { LENGTH = 240 };
  const char **warnings = LOD_NEW(bake->arena, (size_t)bake->model.warning_count + 1, const char *);
  char *text = LOD_NEW(bake->arena, LENGTH, char);
  if (warnings == NULL || text == NULL)
    return lod_fail_memory(bake->problem);
  snprintf(text, LENGTH, "envelope: %llu %s", (unsigned long long)count, sentence);
  if (bake->model.warning_count != 0)
    memcpy(warnings, bake->model.warnings, bake->model.warning_count * sizeof *warnings);
  warnings[bake->model.warning_count++] = text;
  bake->model.warnings = warnings;
  return LOD_OK;
}

/* What `envelope` cannot promise of this source. */
static enum lod_status warn_of_topology(struct bake *bake) {
  bool envelope = false;
  uint64_t crossing = 0;
  for (uint32_t i = 0; i < bake->family_count; i++)
    envelope = envelope || bake->families[i].family == &lod_envelope_family;
  for (uint32_t u = 0; envelope && u < bake->model.unit_count; u++) {
    struct lod_crossings crossings;
    if (lod_intersect_count(&bake->model.units[u].mesh, bake->baker.source_bvhs[u], bake->arena, NULL, &crossings) != LOD_OK)
      return lod_fail_memory(bake->problem);
    crossing += crossings.triangles;
  }
  if (envelope && bake->source.non_manifold_edges != 0)
    LOD_TRY(warn(bake,
                 "edges have more than two triangles; levels are within their errors and keep these edges as lines, but that faces "
                 "keep clear of one another is not promised there.",
                 bake->source.non_manifold_edges));
  if (crossing != 0)
    LOD_TRY(warn(bake,
                 "triangles of the source cross others; levels are within their errors and cross no more than it does, but have no inside "
                 "and outside there.",
                 crossing));
  return LOD_OK;
}

static enum lod_status run(struct bake *bake, double started) {
  LOD_TRY(choose_families(bake));
  LOD_TRY(import(bake));
  LOD_TRY(prepare_baker(bake));
  LOD_TRY(warn_of_topology(bake));
  if (bake->request->edges != NULL)
    LOD_TRY(lod_edges_read(bake->request->edges_name, bake->request->edges, bake->request->edges_size, &bake->model, bake->arena,
                           &bake->wishes, bake->problem));
  LOD_TRY(write_images(bake));
  for (uint32_t i = 0; i < bake->family_count; i++)
    LOD_TRY(build_family(bake, i));
  lod_progress_report(bake->request->progress, "write", kWritten);
  struct lod_manifest_facts facts = {
      .request = bake->request,
      .model = &bake->model,
      .source = &bake->source,
      .families = bake->families,
      .family_count = bake->family_count,
      .image_objects = (const char(*)[LOD_HASH_HEX + 1]) bake->image_objects,
      .seconds = now_seconds() - started,
      .peak_bytes = lod_arena_peak_bytes(bake->arena),
  };
  char *manifest = NULL;
  LOD_TRY(lod_manifest_text(&facts, &manifest, bake->problem));
  enum lod_status status = lod_output_file(bake->request->directory_fd, "manifest.json", manifest, strlen(manifest), bake->problem);
  free(manifest);
  lod_progress_report(bake->request->progress, "done", 1);
  return status;
}

enum lod_status lod_bake_run(const struct lod_bake_request *request, struct lod_problem *problem) {
  double started = now_seconds();
  struct bake bake = {.request = request, .problem = problem, .arena = lod_arena_create(request->max_memory_bytes)};
  if (bake.arena == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = run(&bake, started);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  for (uint32_t i = 0; i < bake.level_arena_count; i++)
    lod_arena_destroy(bake.level_arenas[i]);
  lod_arena_destroy(bake.arena);
  return status;
}
