/* Pixels and model units, and the choice of a level. Pure functions on plain facts: the daemon links this and nothing else of core's
 * geometry. */
#ifndef LOD_CORE_LEVEL_SCREEN_H
#define LOD_CORE_LEVEL_SCREEN_H

#include <stddef.h>
#include <stdint.h>

struct lod_view {
  double distance;    /* eye to the bounding sphere's surface, model units, > 0 */
  double fov_degrees; /* vertical, in (0, 180) */
  double height_px;   /* of the window, > 0 */
};

/* Model units per pixel at that distance: R = 2 D tan(fov/2) / height (Low & Tan 1997, section 4). */
double lod_screen_units_per_pixel(const struct lod_view *view);
/* px = error * height / (2 * distance * tan(fov / 2)) */
double lod_screen_error_px(double error, const struct lod_view *view);
/* The error that is `px` pixels on screen. */
double lod_screen_error_units(double px, const struct lod_view *view);

/* What choosing needs to know of a level. */
struct lod_level_facts {
  double error; /* certified, model units */
  double cell;  /* width of the clustering cell, model units; 0 where the family has none */
  uint64_t bytes;
  uint64_t triangles;
};

enum lod_rule {
  LOD_RULE_ERROR,     /* fewest bytes with error <= limit; none fits: least error */
  LOD_RULE_BYTES,     /* least error with bytes <= limit; none fits: fewest bytes */
  LOD_RULE_TRIANGLES, /* least error with triangles <= limit; none fits: fewest triangles */
  LOD_RULE_CELL,      /* Low & Tan: the largest cell not over limit (= X * R); none fits, or none has a cell: least error of all */
};

/* Index of the chosen level of count >= 1 levels in any order. Ties: fewer bytes, then less error, then the earlier one.
 * *fits (may be NULL): whether the limit is met. */
size_t lod_level_select(const struct lod_level_facts *levels, size_t count, enum lod_rule rule, double limit, int *fits);

#endif
