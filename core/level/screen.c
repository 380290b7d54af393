/* Based on: Low, Tan. Model simplification using vertex-clustering. 1997, section 4 (which level for which distance). */
#include "core/level/screen.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>

static const double kRadiansPerDegree = 3.14159265358979323846 / 180;

double lod_screen_units_per_pixel(const struct lod_view *view) {
  return 2 * view->distance * tan(view->fov_degrees * kRadiansPerDegree / 2) / view->height_px;
}

double lod_screen_error_px(double error, const struct lod_view *view) {
  return error / lod_screen_units_per_pixel(view);
}

double lod_screen_error_units(double px, const struct lod_view *view) {
  return px * lod_screen_units_per_pixel(view);
}

/* What a rule measures against the limit, and what it then wants least of; the tie-breaks are the same for all. */
static bool meets(const struct lod_level_facts *level, enum lod_rule rule, double limit) {
  switch (rule) {
  case LOD_RULE_ERROR:
    return level->error <= limit;
  case LOD_RULE_BYTES:
    return (double)level->bytes <= limit;
  case LOD_RULE_TRIANGLES:
    return (double)level->triangles <= limit;
  case LOD_RULE_CELL:
    return level->cell > 0 && level->cell <= limit;
  }
  return false;
}

/* Sort key among levels that meet the limit, smaller is better. */
static double wish(const struct lod_level_facts *level, enum lod_rule rule) {
  switch (rule) {
  case LOD_RULE_ERROR:
    return (double)level->bytes;
  case LOD_RULE_BYTES:
  case LOD_RULE_TRIANGLES:
    return level->error;
  case LOD_RULE_CELL:
    return -level->cell;
  }
  return 0;
}

/* Sort key when none meets it. */
static double fallback(const struct lod_level_facts *level, enum lod_rule rule) {
  switch (rule) {
  case LOD_RULE_ERROR:
  case LOD_RULE_CELL:
    return level->error;
  case LOD_RULE_BYTES:
    return (double)level->bytes;
  case LOD_RULE_TRIANGLES:
    return (double)level->triangles;
  }
  return 0;
}

static bool better(const struct lod_level_facts *a, double key_a, const struct lod_level_facts *b, double key_b) {
  if (key_a != key_b)
    return key_a < key_b;
  if (a->bytes != b->bytes)
    return a->bytes < b->bytes;
  return a->error < b->error;
}

size_t lod_level_select(const struct lod_level_facts *levels, size_t count, enum lod_rule rule, double limit, int *fits) {
  assert(count >= 1);
  size_t best = 0;
  bool found = false;
  for (size_t i = 0; i < count; i++) {
    if (meets(&levels[i], rule, limit) &&
        (!found || better(&levels[i], wish(&levels[i], rule), &levels[best], wish(&levels[best], rule)))) {
      best = i;
      found = true;
    }
  }
  if (fits != NULL)
    *fits = found;
  if (found)
    return best;
  for (size_t i = 1; i < count; i++)
    if (better(&levels[i], fallback(&levels[i], rule), &levels[best], fallback(&levels[best], rule)))
      best = i;
  return best;
}
