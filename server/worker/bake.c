#include "server/worker/bake.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/cluster/cluster.h"
#include "core/envelope/envelope.h"
#include "core/mesh/topology.h"
#include "server/worker/levels.h"
#include "server/worker/manifest.h"

/* Levels that are the source itself, differing in precision alone (shares of the diagonal): the finest, and one for the wide gap in bytes
 * between it and the first simplified level. */
static const double kSourcePrecision[] = {1e-5, 1e-4};
enum { SOURCE_LEVELS = sizeof kSourcePrecision / sizeof kSourcePrecision[0] };

/* A family with the settings that a request asks of it, made in `arena`; settings NULL: the levels of the source itself meet the request. */
struct recipe {
  const struct lod_family *family;
  bool by_default;
  enum lod_status (*settings)(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings);
};

static enum lod_status cluster_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings);
static enum lod_status envelope_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings);

static const struct recipe kRecipes[] = {
    {&lod_cluster_family, true, cluster_settings},
    {&lod_envelope_family, false, envelope_settings}, /* takes minutes where clustering takes seconds */
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

/* A cell whose half diagonal is three quarters of the error leaves the last quarter to quantisation. */
static enum lod_status cluster_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings) {
  struct lod_cluster_settings *cluster = LOD_NEW(arena, 1, struct lod_cluster_settings);
  double *cells = LOD_NEW(arena, LOD_BAKE_MAX_LIST, double);
  if (cluster == NULL || cells == NULL)
    return LOD_MEMORY;
  *cluster = lod_cluster_defaults();
  cluster->threads = request->threads;
  if (request->epsilon_count != 0) {
    uint32_t count = requested_errors(request, diagonal, cells);
    if (count == 0) {
      *settings = NULL;
      return LOD_OK;
    }
    cluster->representative = LOD_CLUSTER_CENTRE;
    cluster->cells = cells;
    cluster->cell_count = count;
    for (uint32_t i = 0; i < count; i++)
      cells[i] *= 0.75 * 2 / 1.7320508075688772;
  }
  *settings = cluster;
  return LOD_OK;
}

struct lod_bake_request lod_bake_defaults(void) {
  return (struct lod_bake_request){.id = "model", .name = "model", .directory_fd = -1, .limits = lod_import_limits_defaults()};
}

/* One run. */
struct bake {
  const struct lod_bake_request *request;
  struct lod_problem *problem;
  struct lod_arena *arena;
  struct lod_model model;
  struct lod_source_facts source;
  struct lod_level_baker baker;
  char (*image_objects)[LOD_HASH_HEX + 1];
  const struct recipe *recipes[RECIPE_COUNT];
  struct lod_baked_family families[RECIPE_COUNT];
  uint32_t family_count;
  struct lod_baked_level source_levels[SOURCE_LEVELS];
};



enum { MAX_LEVELS = 96 };

static enum lod_status envelope_settings(const struct lod_bake_request *request, double diagonal, struct lod_arena *arena, const void **settings) {
  struct lod_envelope_settings *envelope = LOD_NEW(arena, 1, struct lod_envelope_settings);
  double *epsilons = LOD_NEW(arena, LOD_BAKE_MAX_LIST, double);
  if (envelope == NULL || epsilons == NULL)
    return LOD_MEMORY;
  *envelope = lod_envelope_defaults();
  envelope->threads = request->threads;
  envelope->epsilons = epsilons;
  if (request->epsilon_count != 0) {
    envelope->epsilon_count = requested_errors(request, diagonal, epsilons);
  } else {
    const double *ladder = lod_envelope_ladder(&envelope->epsilon_count);
    for (uint32_t i = 0; i < envelope->epsilon_count; i++)
      epsilons[i] = ladder[i] * diagonal;
  }
  *settings = envelope->epsilon_count == 0 ? NULL : envelope;
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
      return lod_fail(bake->problem, LOD_UNSUPPORTED, "unknown-family", "There is no family \"%s\"; this version bakes: %s.", request->families[i],
                      names);
    }
    chosen[k] = true;
  }
  for (uint32_t k = 0; k < RECIPE_COUNT; k++)
    if (chosen[k] || (request->family_count == 0 && kRecipes[k].by_default)) {
      bake->recipes[bake->family_count] = &kRecipes[k];
      bake->families[bake->family_count++].family = kRecipes[k].family;
    }
  return LOD_OK;
}

static enum lod_status import(struct bake *bake) {
  const struct lod_bake_request *request = bake->request;
  lod_progress_report(request->progress, "import", 0);
  struct lod_import_request import = {
      .name = request->name,
      .format = request->format,
      .bytes = request->bytes,
      .size = request->size,
      .files = request->files,
      .limits = &request->limits,
      .progress = request->progress,
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
    LOD_TRY(lod_output_object(bake->request->directory_fd, model->images[i].bytes, model->images[i].size, bake->image_objects[i], bake->problem));
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
  baker->progress = bake->request->progress;
  baker->source_bvhs = LOD_NEW(bake->arena, bake->model.unit_count, struct lod_bvh *);
  if (baker->source_bvhs == NULL)
    return lod_fail_memory(bake->problem);
  if (!(baker->diagonal > 0))
    return lod_fail(bake->problem, LOD_BAD_INPUT, "zero-size", "%s: all vertices lie at one point; a model needs an extent.", bake->request->name);
  for (uint32_t u = 0; u < bake->model.unit_count; u++)
    if (lod_bvh_create(&bake->model.units[u].mesh, bake->request->threads, bake->arena, &baker->source_bvhs[u]) != LOD_OK)
      return lod_fail_memory(bake->problem);
  return LOD_OK;
}

/* Where a family's levels go. */
struct sink {
  struct bake *bake;
  struct lod_baked_family *family;
  double begin, end; /* share of the progress bar */
};

static enum lod_status add_level(struct sink *sink, const struct lod_level *level, double position_error) {
  struct lod_baked_family *family = sink->family;
  struct bake *bake = sink->bake;
  if (family->level_count == MAX_LEVELS)
    return LOD_OK;
  if (lod_progress_cancelled(bake->request->progress))
    return lod_fail(bake->problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
  uint64_t triangles = 0, of = 0;
  for (uint32_t u = 0; u < bake->model.unit_count; u++) {
    triangles += level->meshes[u].triangle_count;
    of += bake->model.units[u].mesh.triangle_count;
  }
  /* Work falls with the triangles, so what is left of the bar is what is left of the work. */
  double left = of == 0 ? 0 : (double)triangles / (double)of;
  lod_progress_report(bake->request->progress, "levels", sink->end - (sink->end - sink->begin) * fmin(1, left));
  enum lod_status status = lod_level_bake(&bake->baker, level, position_error, bake->arena, &family->levels[family->level_count], bake->problem);
  if (status == LOD_OK)
    family->level_count++;
  else if (status == LOD_MEMORY)
    lod_fail_memory(bake->problem);
  else if (status == LOD_CANCELLED)
    lod_fail(bake->problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
  return status;
}

static enum lod_status receive_level(void *context, const struct lod_level *level) {
  return add_level(context, level, 0);
}

/* The source as imported, at the precisions of kSourcePrecision. */
static enum lod_status add_source_levels(struct sink *sink) {
  const struct lod_model *model = &sink->bake->model;
  struct lod_arena *scratch = lod_arena_create_child(sink->bake->arena);
  struct lod_mesh *meshes = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, struct lod_mesh);
  uint32_t **identity = scratch == NULL ? NULL : LOD_NEW(scratch, model->unit_count, uint32_t *);
  enum lod_status status = meshes == NULL || identity == NULL ? lod_fail_memory(sink->bake->problem) : LOD_OK;
  for (uint32_t u = 0; status == LOD_OK && u < model->unit_count; u++) {
    meshes[u] = model->units[u].mesh;
    identity[u] = LOD_NEW(scratch, meshes[u].vertex_count, uint32_t);
    if (identity[u] == NULL)
      status = lod_fail_memory(sink->bake->problem);
    for (uint32_t v = 0; status == LOD_OK && v < meshes[u].vertex_count; v++)
      identity[u][v] = v;
  }
  for (size_t i = 0; status == LOD_OK && i < SOURCE_LEVELS; i++) {
    struct lod_level level = {.meshes = meshes, .images = identity, .bound = 0};
    status = add_level(sink, &level, kSourcePrecision[i] * sink->bake->baker.diagonal);
  }
  if (status == LOD_OK)
    memcpy(sink->bake->source_levels, sink->family->levels, sizeof sink->bake->source_levels);
  lod_arena_destroy(scratch);
  return status;
}

static enum lod_status build_family(struct bake *bake, uint32_t index) {
  struct lod_baked_family *family = &bake->families[index];
  family->levels = LOD_NEW_ZERO(bake->arena, MAX_LEVELS, struct lod_baked_level);
  if (family->levels == NULL)
    return lod_fail_memory(bake->problem);
  struct sink sink = {
      .bake = bake,
      .family = family,
      .begin = 0.1 + 0.85 * index / bake->family_count,
      .end = 0.1 + 0.85 * (index + 1) / bake->family_count,
  };
  const void *settings;
  if (index == 0) {
    LOD_TRY(add_source_levels(&sink));
  } else { /* they are every family's finest */
    memcpy(family->levels, bake->source_levels, sizeof bake->source_levels);
    family->level_count = SOURCE_LEVELS;
  }
  if (bake->recipes[index]->settings(bake->request, bake->baker.diagonal, bake->arena, &settings) != LOD_OK)
    return lod_fail_memory(bake->problem);
  if (settings != NULL)
    LOD_TRY(family->family->build(bake->model.units, bake->model.unit_count, settings, bake->request->progress, bake->arena, receive_level, &sink,
                                  bake->problem));
  family->level_count = lod_levels_order(family->levels, family->level_count);
  for (uint32_t i = 0; i < family->level_count; i++) {
    struct lod_baked_level *level = &family->levels[i];
    LOD_TRY(lod_output_object(bake->request->directory_fd, level->bytes, level->size, level->object, bake->problem));
  }
  return LOD_OK;
}

static enum lod_status run(struct bake *bake, double started) {
  LOD_TRY(choose_families(bake));
  LOD_TRY(import(bake));
  LOD_TRY(prepare_baker(bake));
  LOD_TRY(write_images(bake));
  for (uint32_t i = 0; i < bake->family_count; i++)
    LOD_TRY(build_family(bake, i));
  lod_progress_report(bake->request->progress, "write", 0.95);
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
  char *manifest = lod_manifest_text(&facts);
  if (manifest == NULL)
    return lod_fail_memory(bake->problem);
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
  lod_arena_destroy(bake.arena);
  return status;
}
