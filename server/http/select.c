/* Choosing a level from a query. Low & Tan's rule: Low, Tan. Model Simplification Using Vertex-Clustering. 1997, section 4. */
#include "server/http/select.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const kKnown[] = {"error",         "px",   "distance", "fov",    "height", "max_bytes",
                                     "max_triangles", "rule", "x",        "family", "have",   NULL};

/* Every parameter that belongs to one selector alone, in the order in which a selector is recognised. Two of different selectors
 * contradict. */
enum selector { SELECT_NONE, SELECT_ERROR, SELECT_BYTES, SELECT_TRIANGLES, SELECT_CELL, SELECT_PIXELS };
static const struct {
  const char *name;
  enum selector selector;
} kSelectors[] = {
    {"error", SELECT_ERROR}, {"max_bytes", SELECT_BYTES}, {"max_triangles", SELECT_TRIANGLES},
    {"rule", SELECT_CELL},   {"x", SELECT_CELL},          {"px", SELECT_PIXELS},
};
static const char *const kView[] = {"distance", "fov", "height"};

static enum lod_status find_selector(const struct lod_target *target, enum selector *selector, struct lod_query_problem *problem) {
  const char *first = NULL;
  *selector = SELECT_NONE;
  for (size_t i = 0; i < sizeof kSelectors / sizeof *kSelectors; i++) {
    const char *name = kSelectors[i].name;
    if (!lod_target_find(target, name))
      continue;
    if (first && kSelectors[i].selector != *selector)
      return lod_parameter_fail(problem, name,
                                "'%s' and '%s' contradict each other: give one of error, px, max_bytes, max_triangles, rule.", first, name);
    first = first ? first : name;
    *selector = kSelectors[i].selector;
  }
  if (*selector == SELECT_NONE)
    *selector = SELECT_PIXELS;
  if (*selector != SELECT_PIXELS && *selector != SELECT_CELL)
    for (size_t i = 0; i < sizeof kView / sizeof *kView; i++)
      if (lod_target_find(target, kView[i]))
        return lod_parameter_fail(problem, kView[i], "'%s' has no meaning beside '%s'; it goes with px or rule=cell.", kView[i], first);
  return LOD_OK;
}

static enum lod_status optional_number(const struct lod_target *target, const char *name, double otherwise, double below, double *value,
                                       struct lod_query_problem *problem) {
  const char *text = lod_target_find(target, name);
  *value = otherwise;
  return text ? lod_parameter_number(name, text, below, value, problem) : LOD_OK;
}

static enum lod_status parse_view(const struct lod_target *target, struct lod_selection *selection, struct lod_query_problem *problem) {
  struct lod_view *view = &selection->view;
  LOD_TRY(optional_number(target, "fov", 60, 180, &view->fov_degrees, problem));
  LOD_TRY(optional_number(target, "height", 1080, 0, &view->height_px, problem));
  LOD_TRY(optional_number(target, "distance", 0, 0, &view->distance, problem));
  if (!(view->distance > 0))
    return lod_parameter_fail(problem, "distance",
                              "'distance' is missing: the distance from the eye to the bounding sphere's surface, in model units.");
  selection->has_view = true;
  return LOD_OK;
}

static enum lod_status parse_limit(const struct lod_target *target, enum selector selector, struct lod_selection *selection,
                                   struct lod_query_problem *problem) {
  uint64_t count = 0;
  double factor = 1;
  switch (selector) {
  case SELECT_ERROR:
    selection->rule = LOD_RULE_ERROR;
    return lod_parameter_number("error", lod_target_find(target, "error"), 0, &selection->limit, problem);
  case SELECT_BYTES:
  case SELECT_TRIANGLES: {
    const char *name = selector == SELECT_BYTES ? "max_bytes" : "max_triangles";
    selection->rule = selector == SELECT_BYTES ? LOD_RULE_BYTES : LOD_RULE_TRIANGLES;
    LOD_TRY(lod_parameter_integer(name, lod_target_find(target, name), 1, UINT64_C(1) << 53, &count, problem));
    selection->limit = (double)count;
    return LOD_OK;
  }
  case SELECT_CELL: {
    const char *rule = lod_target_find(target, "rule"), *x = lod_target_find(target, "x");
    if (!rule || strcmp(rule, "cell") != 0)
      return lod_parameter_fail(problem, "rule", "'rule' must be 'cell'.");
    if (!x)
      return lod_parameter_fail(problem, "x", "'x' is missing: the largest cell allowed, in pixels.");
    selection->rule = LOD_RULE_CELL;
    LOD_TRY(lod_parameter_number("x", x, 0, &factor, problem));
    break;
  }
  default:
    selection->rule = LOD_RULE_ERROR;
    LOD_TRY(optional_number(target, "px", 1, 0, &factor, problem));
  }
  LOD_TRY(parse_view(target, selection, problem));
  /* A view may be so far that a pixel is wider than any double: then every level fits. */
  selection->limit = fmin(lod_screen_error_units(factor, &selection->view), DBL_MAX);
  return LOD_OK;
}

enum lod_status lod_selection_parse(const struct lod_target *target, struct lod_selection *selection, struct lod_query_problem *problem) {
  *selection = (struct lod_selection){.have = UINT32_MAX};
  LOD_TRY(lod_target_check_names(target, kKnown, problem));
  enum selector selector;
  LOD_TRY(find_selector(target, &selector, problem));
  LOD_TRY(parse_limit(target, selector, selection, problem));
  const char *family = lod_target_find(target, "family");
  if (family && strcmp(family, "auto") != 0) {
    if (!*family || strlen(family) > LOD_FAMILY_NAME_MAX)
      return lod_parameter_fail(problem, "family", "'family' must be 'auto' or the name of a family, not '%.40s'.", family);
    snprintf(selection->family, sizeof selection->family, "%s", family);
  }
  const char *have = lod_target_find(target, "have");
  if (have && !selection->family[0])
    return lod_parameter_fail(problem, "have", "'have' is the number of a level of one family: name it by 'family'.");
  uint64_t number = 0;
  if (have) {
    LOD_TRY(lod_parameter_integer("have", have, 0, 65535, &number, problem));
    selection->have = (uint32_t)number;
  }
  return LOD_OK;
}

static enum lod_status unknown_family(const struct lod_selection *selection, const struct lod_stored_model *model,
                                      struct lod_query_problem *problem) {
  char names[200] = "auto";
  for (uint32_t i = 0; i < model->family_count; i++) {
    size_t used = strlen(names);
    snprintf(names + used, sizeof names - used, ", %s", model->families[i].name);
  }
  return lod_parameter_fail(problem, "family", "The model '%s' has no family '%s'; it has: %s.", model->id, selection->family, names);
}

enum lod_status lod_selection_choose(const struct lod_selection *selection, const struct lod_stored_model *model, struct lod_choice *choice,
                                     struct lod_query_problem *problem) {
  enum { FEW = 256 };
  struct lod_level_facts few[FEW], *facts = few;
  size_t count = 0;
  bool found = !selection->family[0];
  for (uint32_t i = 0; i < model->family_count; i++)
    if (!selection->family[0] || strcmp(selection->family, model->families[i].name) == 0) {
      count += model->families[i].level_count;
      found = true;
    }
  if (!found)
    return unknown_family(selection, model, problem);
  if (count == 0)
    return lod_fail(&problem->problem, LOD_UNSUPPORTED, "no-levels", "The model '%s' has no levels.", model->id);
  if (count > FEW && !(facts = calloc(count, sizeof *facts)))
    return lod_fail_memory(&problem->problem);

  size_t next = 0;
  for (uint32_t i = 0; i < model->family_count; i++)
    if (!selection->family[0] || strcmp(selection->family, model->families[i].name) == 0)
      for (uint32_t j = 0; j < model->families[i].level_count; j++)
        facts[next++] = model->families[i].levels[j].facts;
  int fits = 0;
  size_t chosen = lod_level_select(facts, count, selection->rule, selection->limit, &fits);
  if (facts != few)
    free(facts);

  *choice = (struct lod_choice){.fits = fits != 0};
  for (uint32_t i = 0; i < model->family_count; i++) {
    const struct lod_stored_family *family = &model->families[i];
    if (selection->family[0] && strcmp(selection->family, family->name) != 0)
      continue;
    if (chosen < family->level_count) {
      choice->family = family;
      choice->level = &family->levels[chosen];
      break;
    }
    chosen -= family->level_count;
  }
  if (selection->has_view)
    choice->screen_error_px = lod_screen_error_px(choice->level->facts.error, &selection->view);
  return LOD_OK;
}
