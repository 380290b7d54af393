/* Re-tiling as a family: each unit gets its share of every level's vertices, by area. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh/feature.h"
#include "core/retile/internal.h"

static double unit_area(const struct lod_unit *unit) {
  const struct lod_mesh *mesh = &unit->mesh;
  double area = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    for (int i = 0; i < 3; i++)
      p[i] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][i]]);
    area += 0.5 * lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
  }
  return area * unit->scale * unit->scale;
}

static int compare_counts(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

/* What the whole model's levels shall be, coarsest first. */
struct plan {
  uint32_t counts[LOD_RETILE_MAX_LEVELS];
  double errors[LOD_RETILE_MAX_LEVELS]; /* model units; 0 = none */
  uint32_t level_count;
  bool by_error; /* counts say nothing */
  bool asked;    /* counts are what somebody asked for */
};

/* What the units' shapes take, added up. */
struct need {
  double finest;                     /* vertices that the finest error takes by curvature alone */
  double line_length, corners, area; /* of borders and seams; of all faces; model units */
};

static enum lod_status add_lines(const struct lod_unit *unit, const struct lod_adjacency *adjacency, struct lod_arena *scratch,
                                 struct need *need) {
  const struct lod_mesh *mesh = &unit->mesh;
  struct lod_features features;
  struct lod_feature_settings wanted = lod_feature_defaults();
  wanted.flags = LOD_FEATURE_BOUNDARY | LOD_FEATURE_MATERIAL | LOD_FEATURE_UV_SEAM;
  LOD_TRY(lod_feature_find(mesh, adjacency, &wanted, scratch, &features));
  for (uint32_t i = 0; i < features.line_count; i++)
    for (uint32_t k = features.line_begin[i]; k + 1 < features.line_begin[i + 1]; k++)
      need->line_length += unit->scale * lod_vec3_distance(lod_vec3_from_float(mesh->positions[features.line_vertices[k]]),
                                                           lod_vec3_from_float(mesh->positions[features.line_vertices[k + 1]]));
  need->corners += features.corner_count;
  return LOD_OK;
}

static enum lod_status add_unit(const struct lod_unit *unit, double error, struct lod_arena *arena, struct need *need) {
  const struct lod_mesh *mesh = &unit->mesh;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency adjacency;
  double finest = 0;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : lod_adjacency_create(mesh, scratch, &adjacency);
  if (status == LOD_OK && error > 0)
    status = retile_vertices_for(mesh, &adjacency, error / unit->scale, scratch, &finest);
  if (status == LOD_OK && (mesh->wedge_count != 0 || mesh->materials != NULL || mesh->parts != NULL))
    status = add_lines(unit, &adjacency, scratch, need);
  need->finest += finest;
  need->area += unit_area(unit);
  lod_arena_destroy(scratch);
  return status;
}

/* Lines that no triangle crosses (borders, seams) take vertices before any surface is left to share: a level with fewer vertices than lets
 * the surface have half shows textures stretched between corners of their charts, and misses by as much as the lines' bends. */
static double need_of_lines(const struct need *need) {
  /* n / 2 = corners + length / (1.5 spacing), with n hexagons of that spacing on the area */
  double b = need->area > 0 ? need->line_length / (1.5 * sqrt(1.1547005383792517 * need->area)) : 0;
  double root = b + sqrt(b * b + 2 * need->corners);
  return root * root;
}

/* The worst place of a level needs about so many times the vertices that its curvature tells. */
static const double kErrorReserve = 2;
/* A level of more of the source's vertices than this is not worth its bytes. */
static const double kMostOfSource = 0.6;

/* The ladder ends with the level that proves finest_error, or has a quarter (1 / ratio) of the source's vertices: the source is a level by
 * itself wherever levels are served. */
static enum lod_status plan_ladder(const struct lod_unit *units, uint32_t unit_count, const struct lod_retile_settings *s,
                                   struct lod_arena *scratch, struct plan *plan) {
  double vertices = 0, diagonal = 0;
  for (uint32_t u = 0; u < unit_count; u++) {
    struct lod_bounds bounds = lod_mesh_bounds(&units[u].mesh);
    diagonal = fmax(diagonal, lod_bounds_diagonal(&bounds) * units[u].scale);
    vertices += units[u].mesh.vertex_count;
  }
  struct need need = {0};
  for (uint32_t u = 0; u < unit_count; u++)
    LOD_TRY(add_unit(&units[u], s->finest_error * diagonal, scratch, &need));
  /* An error that spacing by curvature does not meet with a quarter of the source's vertices is not worth chasing. */
  double finest = kErrorReserve * need.finest, lines = need_of_lines(&need);
  bool reachable = finest <= vertices / s->ratio;
  double least = fmin(fmax(s->least, lines), fmax(s->least, kMostOfSource * vertices));
  finest = fmax(fmin(finest, vertices / s->ratio), fmin(least, vertices));
  double steps = fmax(0, floor(log(finest / fmax(4, least)) / log(s->ratio) + 0.5));
  plan->level_count = (uint32_t)fmin(steps, LOD_RETILE_MAX_LEVELS - 1) + 1;
  for (uint32_t k = 0; k < plan->level_count; k++) {
    plan->counts[k] = (uint32_t)lrint(fmin(4e9, finest / pow(s->ratio, plan->level_count - 1 - k)));
    plan->errors[k] = reachable && k + 1 == plan->level_count ? s->finest_error * diagonal : 0;
  }
  return LOD_OK;
}

static enum lod_status plan_levels(const struct lod_unit *units, uint32_t unit_count, const struct lod_retile_settings *s,
                                   struct lod_arena *scratch, struct plan *plan) {
  *plan = (struct plan){.level_count = s->level_count, .by_error = s->vertices == NULL && s->errors != NULL, .asked = s->vertices != NULL};
  if (s->vertices == NULL && s->errors == NULL)
    return plan_ladder(units, unit_count, s, scratch, plan);
  if (s->vertices != NULL)
    memcpy(plan->counts, s->vertices, s->level_count * sizeof *plan->counts);
  if (s->errors != NULL)
    memcpy(plan->errors, s->errors, s->level_count * sizeof *plan->errors);
  else
    qsort(plan->counts, s->level_count, sizeof *plan->counts, compare_counts);
  return LOD_OK;
}

static enum lod_status build_unit(const struct lod_unit *unit, double share, const struct lod_retile_settings *settings,
                                  const struct plan *plan, const struct lod_progress *progress, struct lod_arena *arena,
                                  struct lod_retile *retile, struct lod_problem *problem) {
  uint32_t own[LOD_RETILE_MAX_LEVELS];
  double errors[LOD_RETILE_MAX_LEVELS];
  struct lod_retile_settings s = *settings;
  bool any_error = false;
  for (uint32_t k = 0; k < plan->level_count; k++) {
    own[k] = (uint32_t)fmax(4, lrint(plan->counts[k] * share));
    if (settings->vertices == NULL && own[k] > unit->mesh.vertex_count)
      own[k] = unit->mesh.vertex_count;
    errors[k] = plan->errors[k] / unit->scale;
    any_error = any_error || errors[k] > 0;
  }
  s.vertices = plan->by_error ? NULL : own;
  s.errors = any_error ? errors : NULL;
  s.level_count = plan->level_count;
  return lod_retile_create(&unit->mesh, &s, progress, arena, retile, problem);
}

static enum lod_status emit(const struct lod_retile *retiles, const struct lod_unit *units, uint32_t unit_count, const struct plan *plan,
                            struct lod_arena *arena, lod_level_sink *sink, void *sink_context) {
  struct lod_mesh *meshes;
  uint32_t **parents;
  RETILE_TRY_NEW(meshes, arena, unit_count);
  RETILE_TRY_NEW(parents, arena, unit_count);
  for (uint32_t k = plan->level_count; k-- > 0;) {
    double bound = 0, expected = 0;
    uint64_t candidates = 0, retained = 0;
    for (uint32_t u = 0; u < unit_count; u++) {
      bound = fmax(bound, retiles[u].levels[k].bound * units[u].scale);
      expected = fmax(expected, retiles[u].levels[k].missed * units[u].scale);
      candidates += retiles[u].levels[k].candidates;
      retained += retiles[u].levels[k].retained;
      meshes[u] = retiles[u].levels[k].mesh;
      parents[u] = retiles[u].levels[k].parents;
    }
    struct lod_level level = {.meshes = meshes,
                              .parents = k + 1 < plan->level_count ? parents : NULL,
                              .bound = bound,
                              .apart = true,
                              .counted = true,
                              .asked = plan->asked ? plan->counts[k] : 0,
                              .candidates = candidates,
                              .retained = retained,
                              .expected = expected};
    LOD_TRY(sink(sink_context, &level));
  }
  return LOD_OK;
}

static enum lod_status build(const struct lod_unit *units, uint32_t unit_count, const void *family_settings,
                             const struct lod_progress *progress, struct lod_arena *arena, lod_level_sink *sink, void *sink_context,
                             struct lod_problem *problem) {
  struct lod_retile_settings settings =
      family_settings == NULL ? lod_retile_defaults() : *(const struct lod_retile_settings *)family_settings;
  struct plan plan = {0};
  LOD_TRY(retile_check_settings(&settings, problem));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_retile *retiles = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, unit_count, struct lod_retile);
  enum lod_status status = retiles == NULL ? lod_fail_memory(problem) : LOD_OK;
  if (status == LOD_OK && plan_levels(units, unit_count, &settings, scratch, &plan) != LOD_OK)
    status = lod_fail_memory(problem);
  double area = 0;
  for (uint32_t u = 0; u < unit_count; u++)
    area += unit_area(&units[u]);
  for (uint32_t u = 0; u < unit_count && status == LOD_OK; u++)
    status = build_unit(&units[u], area > 0 ? unit_area(&units[u]) / area : 1.0 / unit_count, &settings, &plan, progress, scratch,
                        &retiles[u], problem);
  if (status == LOD_OK)
    status = emit(retiles, units, unit_count, &plan, scratch, sink, sink_context);
  lod_arena_destroy(scratch);
  return status;
}

const struct lod_family lod_retile_family = {
    .name = "retile",
    .sentence = "well-shaped triangles at any number of vertices, each level's vertices among the finer one's",
    .nested = true,
    .build = build,
};
