#include "server/worker/envelope_recipe.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct lod_envelope_options lod_envelope_options_defaults(void) {
  struct lod_envelope_settings settings = lod_envelope_defaults();
  return (struct lod_envelope_options){.attributes = settings.collapse.attributes, .guarding = settings.collapse.guarding};
}

static bool set_word(struct lod_envelope_options *o, const char *key, const char *value) {
  static const char *const kGuards[] = {[LOD_GUARD_NONE] = "none", [LOD_GUARD_CLOSED] = "closed", [LOD_GUARD_ALL] = "all"};
  for (int i = 0; strcmp(key, "guard") == 0 && i < 3; i++)
    if (strcmp(value, kGuards[i]) == 0) {
      o->guarding = (enum lod_guarding)i;
      return true;
    }
  if (strcmp(key, "nested") != 0 || (strcmp(value, "0") != 0 && strcmp(value, "1") != 0))
    return false;
  o->nested = value[0] == '1';
  return true;
}

/* *most: INFINITY, or where the key is right and the value is not, the most that it may be. */
static bool set_number(struct lod_envelope_options *o, const char *key, const char *value, double *most) {
  const struct {
    const char *name;
    double *number, most;
  } numbers[] = {
      {"texels", &o->texels, 1e9},
      {"slip", &o->attributes.slip, 1e9},
      {"degrees", &o->attributes.normal_degrees, 180},
      {"color", &o->attributes.color, 10},
      {"rms", &o->rms, 1},
  };
  char *end;
  double number = strtod(value, &end);
  *most = INFINITY;
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
    if (strcmp(key, numbers[i].name) != 0)
      continue;
    if (*value != '\0' && *end == '\0' && number >= 0 && number <= numbers[i].most) {
      *numbers[i].number = number;
      return true;
    }
    *most = numbers[i].most;
  }
  return false;
}

enum lod_status lod_envelope_recipe_option(const char *option, struct lod_envelope_options *options, struct lod_problem *problem) {
  const char *equals = strchr(option, '=');
  char key[32] = "";
  double most = INFINITY;
  if (equals != NULL && (size_t)(equals - option) < sizeof key) {
    memcpy(key, option, (size_t)(equals - option));
    key[equals - option] = '\0';
    if (set_word(options, key, equals + 1) || set_number(options, key, equals + 1, &most))
      return LOD_OK;
  }
  if (most < INFINITY)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-option", "%.80s: expected a number from 0 to %g.", option, most);
  return lod_fail(problem, LOD_BAD_INPUT, "bad-option",
                  "%.80s: envelope knows nested=0|1, guard=none|closed|all, rms=0...1, and 0 or more of texels, slip, degrees, color.",
                  option);
}

/* The options are checked in any case before. */
static struct lod_envelope_options options_of(const struct lod_bake_request *request, enum lod_status *status,
                                              struct lod_problem *problem) {
  struct lod_envelope_options options = lod_envelope_options_defaults();
  *status = LOD_OK;
  for (uint32_t i = 0; i < request->envelope_option_count && *status == LOD_OK; i++)
    *status = lod_envelope_recipe_option(request->envelope_options[i], &options, problem);
  return options;
}

bool lod_envelope_recipe_nests(const struct lod_bake_request *request) {
  enum lod_status status;
  return options_of(request, &status, NULL).nested && status == LOD_OK;
}

/* Each step of a chain of deltas pays the connectivity of its level: with levels farther apart, all of them together are no more bytes than
 * the finest one alone. */
static const double kNestedGain = 0.65;

enum lod_status lod_envelope_recipe(const struct lod_bake_request *request, const double *errors, uint32_t error_count, double diagonal,
                                    struct lod_arena *arena, const struct lod_envelope_settings **settings, struct lod_problem *problem) {
  enum lod_status status;
  struct lod_envelope_options options = options_of(request, &status, problem);
  struct lod_envelope_settings *envelope = LOD_NEW(arena, 1, struct lod_envelope_settings);
  double *epsilons = LOD_NEW(arena, LOD_BAKE_MAX_LIST + 1, double);
  LOD_TRY(status);
  if (envelope == NULL || epsilons == NULL)
    return LOD_MEMORY;
  *envelope = lod_envelope_defaults();
  envelope->threads = request->threads;
  envelope->epsilons = epsilons;
  envelope->collapse.attributes = options.attributes;
  envelope->collapse.attributes.uv = options.texels;
  envelope->collapse.rms = options.rms;
  envelope->collapse.guarding = options.guarding;
  envelope->collapse.vertex_subset = options.nested;
  if (request->epsilon_count != 0) {
    bool coplanar = false; /* 0 asks for the source without what is coplanar in it; other errors this small are for its own levels */
    for (uint32_t i = 0; i < request->epsilon_count; i++)
      coplanar = coplanar || !(request->epsilons[i] > 0);
    epsilons[0] = 0;
    memcpy(epsilons + coplanar, errors, error_count * sizeof *errors);
    envelope->epsilon_count = coplanar + error_count;
    envelope->least_gain = 0; /* what was asked for comes */
  } else {
    const double *ladder = lod_envelope_ladder(&envelope->epsilon_count);
    for (uint32_t i = 0; i < envelope->epsilon_count; i++)
      epsilons[i] = ladder[i] * diagonal;
    if (options.nested)
      envelope->least_gain = kNestedGain;
  }
  *settings = envelope->epsilon_count == 0 ? NULL : envelope;
  return LOD_OK;
}

/* Wishes with the limits that vertices of the model say for themselves. */
static enum lod_status add_limits(const struct lod_model *model, const struct lod_envelope_wishes *wishes, struct lod_arena *arena,
                                  const struct lod_envelope_wishes **all) {
  bool any = false;
  for (uint32_t u = 0; u < model->unit_count; u++)
    any = any || model->units[u].mesh.limits != NULL;
  *all = wishes;
  if (!any)
    return LOD_OK;
  struct lod_envelope_wishes *added = LOD_NEW_ZERO(arena, model->unit_count, struct lod_envelope_wishes);
  for (uint32_t u = 0; added != NULL && u < model->unit_count; u++) {
    const struct lod_unit *unit = &model->units[u];
    if (wishes != NULL)
      added[u] = wishes[u];
    if (unit->mesh.limits == NULL)
      continue;
    double *limits = LOD_NEW(arena, unit->mesh.vertex_count, double);
    if (limits == NULL)
      return LOD_MEMORY;
    for (uint32_t v = 0; v < unit->mesh.vertex_count; v++)
      limits[v] = (double)unit->mesh.limits[v] / unit->scale;
    added[u].limits = limits;
  }
  *all = added;
  return added == NULL ? LOD_MEMORY : LOD_OK;
}

enum lod_status lod_envelope_recipe_fit(const struct lod_model *model, const struct lod_envelope_wishes *wishes, struct lod_arena *arena,
                                        const struct lod_envelope_settings **settings) {
  struct lod_envelope_settings *envelope = lod_arena_copy(arena, *settings, sizeof *envelope);
  if (envelope == NULL)
    return LOD_MEMORY;
  double texels = 0;
  for (uint32_t i = 0; i < model->image_count; i++)
    texels = fmax(texels, fmax(model->images[i].width, model->images[i].height));
  envelope->collapse.attributes.uv = texels > 0 ? envelope->collapse.attributes.uv / texels : 0;
  LOD_TRY(add_limits(model, wishes, arena, &envelope->wishes));
  *settings = envelope;
  return LOD_OK;
}
