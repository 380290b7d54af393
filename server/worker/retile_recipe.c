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

struct number {
  const char *key;
  double least, most;
  double *real;
  uint32_t *whole;
  uint64_t *large;
};
enum { NUMBERS = 15 };

/* The ranges are those of retile_check_settings. */
static void list_numbers(struct lod_retile_settings *s, struct number numbers[NUMBERS]) {
  const struct number all[NUMBERS] = {
      {"adapt", 1, 100, &s->adapt, NULL, NULL},
      {"anisotropy", 0, 100, &s->anisotropy, NULL, NULL},
      {"lead", 0, 0.9, &s->lead, NULL, NULL},
      {"settle", 0, 1000, NULL, &s->settle, NULL},
      {"prune", 0, 1000, &s->prune, NULL, NULL},
      {"steps", 0, 10000, NULL, &s->steps, NULL},
      {"damping", 0, 1, &s->damping, NULL, NULL},
      {"radius", 0, 10, &s->radius, NULL, NULL},
      {"flips", 0, 1000, NULL, &s->flips, NULL},
      {"crease", 0, 180, &s->crease_degrees, NULL, NULL},
      {"corner", 0, 180, &s->corner_degrees, NULL, NULL},
      {"ratio", 1.1, 1000, &s->ratio, NULL, NULL},
      {"least", 4, 1e6, NULL, &s->least, NULL},
      {"finest", 1e-4, 100, &s->finest_error, NULL, NULL}, /* percent */
      {"seed", 0, 9e15, NULL, NULL, &s->seed},
  };
  memcpy(numbers, all, sizeof all);
}

static enum lod_status set_number(const struct number *number, const char *option, const char *text, struct lod_problem *problem) {
  char *end;
  double value = strtod(text, &end);
  bool whole = number->real == NULL;
  if (end == text || *end != '\0' || !(value >= number->least && value <= number->most) || (whole && value != floor(value)))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-retile-option", "%.80s: expected a %s from %.15g to %.15g%s.", option,
                    whole ? "whole number" : "number", number->least, number->most,
                    strcmp(number->key, "finest") == 0 ? ", percent of the diagonal" : "");
  if (number->real != NULL)
    *number->real = strcmp(number->key, "finest") == 0 ? value / 100 : value;
  else if (number->whole != NULL)
    *number->whole = (uint32_t)value;
  else
    *number->large = (uint64_t)value;
  return LOD_OK;
}

/* The key is one of words, the value none of its. */
static enum lod_status refuse_word(const char *option, const char *key, struct lod_problem *problem) {
  char known[120] = "";
  for (size_t i = 0; i < sizeof kWords / sizeof *kWords; i++)
    if (strcmp(key, kWords[i].key) == 0)
      snprintf(known + strlen(known), sizeof known - strlen(known), "%s%s", known[0] == '\0' ? "" : ", ", kWords[i].value);
  return lod_fail(problem, LOD_BAD_INPUT, "bad-retile-option", "%.80s: expected one of %s.", option, known);
}

enum lod_status lod_retile_recipe_option(const char *option, struct lod_retile_settings *settings, struct lod_problem *problem) {
  const char *equals = strchr(option, '=');
  char key[32] = "";
  bool word = false;
  if (equals != NULL && (size_t)(equals - option) < sizeof key)
    memcpy(key, option, (size_t)(equals - option));
  if (strcmp(option, "mode=turk") == 0) {
    struct lod_retile_settings turk = lod_retile_turk();
    turk.threads = settings->threads;
    *settings = turk;
    return LOD_OK;
  }
  for (size_t i = 0; i < sizeof kWords / sizeof *kWords; i++) {
    if (strcmp(key, kWords[i].key) != 0)
      continue;
    word = true;
    if (strcmp(equals + 1, kWords[i].value) == 0) {
      set_word(settings, &kWords[i]);
      return LOD_OK;
    }
  }
  if (word)
    return refuse_word(option, key, problem);
  struct number numbers[NUMBERS];
  list_numbers(settings, numbers);
  for (size_t i = 0; i < NUMBERS; i++)
    if (strcmp(key, numbers[i].key) == 0)
      return set_number(&numbers[i], option, equals + 1, problem);
  return lod_fail(
      problem, LOD_BAD_INPUT, "bad-retile-option",
      "%.80s: retile knows mode=turk, placement, curvature, measure, projection, and by number adapt, anisotropy, lead, settle, "
      "prune, steps, damping, radius, flips, crease, corner, ratio, least, finest, seed.",
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
