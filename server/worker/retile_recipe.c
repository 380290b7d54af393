#include "server/worker/retile_recipe.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Share of an error asked for that is left to quantisation, as core/envelope does. */
static const double kReserve = 0.12;

/* A level may have a few vertices more than asked for without anyone being told. */
static const double kMore = 1.05;

struct word {
  const char *key, *value;
  size_t offset; /* of an enum in the settings */
  int number;
};
static const struct word kWords[] = {
    {"placement", "elimination", offsetof(struct lod_retile_settings, placement), LOD_RETILE_ELIMINATION},
    {"placement", "turk", offsetof(struct lod_retile_settings, placement), LOD_RETILE_TURK},
    {"curvature", "none", offsetof(struct lod_retile_settings, curvature), LOD_RETILE_CURVATURE_NONE},
    {"curvature", "tensor", offsetof(struct lod_retile_settings, curvature), LOD_RETILE_CURVATURE_TENSOR},
    {"curvature", "turk", offsetof(struct lod_retile_settings, curvature), LOD_RETILE_CURVATURE_TURK},
    {"measure", "cost", offsetof(struct lod_retile_settings, measure), LOD_RETILE_MEASURE_COST},
    {"measure", "length", offsetof(struct lod_retile_settings, measure), LOD_RETILE_MEASURE_LENGTH},
    {"measure", "angle", offsetof(struct lod_retile_settings, measure), LOD_RETILE_MEASURE_ANGLE},
    {"projection", "polar", offsetof(struct lod_retile_settings, projection), LOD_RETILE_POLAR},
    {"projection", "planes", offsetof(struct lod_retile_settings, projection), LOD_RETILE_PLANES},
};

static void set_word(struct lod_retile_settings *s, const struct word *word) {
  switch (word->offset) { /* each its own enum type */
  case offsetof(struct lod_retile_settings, placement):
    s->placement = (enum lod_retile_placement)word->number;
    break;
  case offsetof(struct lod_retile_settings, curvature):
    s->curvature = (enum lod_retile_curvature)word->number;
    break;
  case offsetof(struct lod_retile_settings, measure):
    s->measure = (enum lod_retile_measure)word->number;
    break;
  default:
    s->projection = (enum lod_retile_projection)word->number;
    break;
  }
}

static bool set_number(struct lod_retile_settings *s, const char *key, double value) {
  const struct {
    const char *name;
    double *real;
    uint32_t *whole;
  } numbers[] = {
      {"adapt", &s->adapt, NULL}, {"anisotropy", &s->anisotropy, NULL}, {"lead", &s->lead, NULL},       {"settle", NULL, &s->settle},
      {"prune", &s->prune, NULL}, {"steps", NULL, &s->steps},           {"damping", &s->damping, NULL}, {"radius", &s->radius, NULL},
      {"flips", NULL, &s->flips}, {"crease", &s->crease_degrees, NULL}, {"ratio", &s->ratio, NULL},     {"least", NULL, &s->least},
  };
  if (strcmp(key, "seed") == 0 && value >= 0 && value < 9e15 && value == floor(value)) {
    s->seed = (uint64_t)value;
    return true;
  }
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
    if (strcmp(key, numbers[i].name) == 0) {
      if (numbers[i].real != NULL)
        *numbers[i].real = value;
      else if (value >= 0 && value <= 1e6 && value == floor(value))
        *numbers[i].whole = (uint32_t)value;
      else
        return false;
      return true;
    }
  return false;
}

enum lod_status lod_retile_recipe_option(const char *option, struct lod_retile_settings *settings, struct lod_problem *problem) {
  const char *equals = strchr(option, '=');
  char key[32] = "";
  if (equals != NULL && (size_t)(equals - option) < sizeof key) {
    memcpy(key, option, (size_t)(equals - option));
    if (strcmp(option, "mode=turk") == 0) {
      struct lod_retile_settings turk = lod_retile_turk();
      turk.threads = settings->threads;
      *settings = turk;
      return LOD_OK;
    }
    for (size_t i = 0; i < sizeof kWords / sizeof *kWords; i++)
      if (strcmp(key, kWords[i].key) == 0 && strcmp(equals + 1, kWords[i].value) == 0) {
        set_word(settings, &kWords[i]);
        return LOD_OK;
      }
    char *end;
    double value = strtod(equals + 1, &end);
    if (end != equals + 1 && *end == '\0' && isfinite(value) && set_number(settings, key, value))
      return LOD_OK;
  }
  return lod_fail(problem, LOD_BAD_INPUT, "bad-retile-option", "Re-tiling knows no \"%.60s\"; it takes key=value as its help says.",
                  option);
}

enum lod_status lod_retile_recipe(const struct lod_bake_request *request, const double *errors, uint32_t error_count,
                                  struct lod_arena *arena, const struct lod_retile_settings **settings, struct lod_problem *problem) {
  struct lod_retile_settings *retile = LOD_NEW(arena, 1, struct lod_retile_settings);
  double *own = LOD_NEW(arena, LOD_BAKE_MAX_LIST, double);
  if (retile == NULL || own == NULL)
    return lod_fail_memory(problem);
  *retile = lod_retile_defaults();
  retile->threads = request->threads;
  for (uint32_t i = 0; i < request->retile_option_count; i++)
    LOD_TRY(lod_retile_recipe_option(request->retile_options[i], retile, problem));
  if (request->vertices_count != 0) {
    retile->vertices = request->vertices;
    retile->level_count = request->vertices_count < LOD_RETILE_MAX_LEVELS ? request->vertices_count : LOD_RETILE_MAX_LEVELS;
  } else if (error_count != 0) {
    retile->level_count = error_count < LOD_RETILE_MAX_LEVELS ? error_count : LOD_RETILE_MAX_LEVELS;
    retile->errors = own;
    for (uint32_t i = 0; i < retile->level_count; i++)
      own[i] = (1 - kReserve) * errors[i];
  }
  *settings = retile;
  return LOD_OK;
}

enum lod_status lod_retile_recipe_warn(const struct lod_bake_request *request, const struct lod_baked_level *levels, uint32_t level_count,
                                       struct lod_arena *arena, struct lod_model *model) {
  uint64_t asked = UINT64_MAX, got = UINT64_MAX;
  for (uint32_t i = 0; i < request->vertices_count; i++)
    asked = request->vertices[i] < asked ? request->vertices[i] : asked;
  for (uint32_t i = 0; i < level_count; i++)
    got = levels[i].vertices < got ? levels[i].vertices : got;
  if (request->vertices_count == 0 || level_count == 0 || (double)got <= kMore * (double)asked)
    return LOD_OK;
  const char **warnings = lod_arena_alloc(arena, (size_t)model->warning_count + 1, sizeof *warnings);
  char *text = lod_arena_alloc(arena, 256, 1);
  if (warnings == NULL || text == NULL)
    return LOD_MEMORY;
  if (model->warning_count != 0)
    memcpy(warnings, model->warnings, model->warning_count * sizeof *warnings);
  snprintf(text, 256, "retile: %llu vertices were asked for; %llu are the fewest that keep the model's pieces and holes.",
           (unsigned long long)asked, (unsigned long long)got);
  warnings[model->warning_count++] = text;
  model->warnings = warnings;
  return LOD_OK;
}
