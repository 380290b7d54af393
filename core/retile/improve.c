/* Flips for better triangles (Turk 1992, 4.5): Delaunay, unless the surface would be missed by more, or a triangle would look away from it.
 */
#include <math.h>

#include "core/retile/internal.h"

/* Normals of vertices on lines are means over both sides and say nothing. */
static bool has_normal(const struct tiling *t, uint32_t v) {
  const uint32_t *w = t->points[v].weights;
  return v < t->sheet->vertex_count ? !t->sheet->on_line[v] : w[0] != 0 && w[1] != 0 && w[2] != 0;
}

static struct lod_vec3 unit_normal(const struct tiling *t, uint32_t a, uint32_t b, uint32_t c) {
  return lod_vec3_normalize(
      lod_vec3_cross(lod_vec3_subtract(t->positions[b], t->positions[a]), lod_vec3_subtract(t->positions[c], t->positions[a])));
}

/* How far the surface bulges over an edge, from the normals at its ends. */
static double bulge(const struct tiling *t, uint32_t a, uint32_t b) {
  if (!has_normal(t, a) || !has_normal(t, b))
    return 0;
  return fabs(lod_vec3_dot(lod_vec3_subtract(t->positions[b], t->positions[a]), lod_vec3_subtract(t->normals[b], t->normals[a]))) / 8;
}

static double least_facing(const struct tiling *t, struct lod_vec3 n, const uint32_t v[3]) {
  double least = 1;
  for (int k = 0; k < 3; k++)
    if (has_normal(t, v[k]))
      least = fmin(least, lod_vec3_dot(n, t->normals[v[k]]));
  return least;
}

/* Cosine and sine of the angle at p, both times the product of its sides. */
static void corner(const struct tiling *t, uint32_t p, uint32_t a, uint32_t b, double *cosine, double *sine) {
  struct lod_vec3 u = lod_vec3_subtract(t->positions[a], t->positions[p]), w = lod_vec3_subtract(t->positions[b], t->positions[p]);
  *cosine = lod_vec3_dot(u, w);
  *sine = lod_vec3_length(lod_vec3_cross(u, w));
}

static const double kFolded = 0.3; /* cosine with the surface's normal below which a triangle is folded over, or nearly so */

static bool wants_flip(const struct tiling *t, const uint32_t v[4]) {
  double cc, sc, cd, sd;
  corner(t, v[2], v[0], v[1], &cc, &sc);
  corner(t, v[3], v[0], v[1], &cd, &sd);
  bool delaunay = sc * cd + cc * sd >= -1e-9 * (fabs(cc) + sc) * (fabs(cd) + sd);
  const uint32_t old[2][3] = {{v[0], v[1], v[2]}, {v[1], v[0], v[3]}}, fresh[2][3] = {{v[2], v[0], v[3]}, {v[3], v[1], v[2]}};
  struct lod_vec3 n[4];
  double before = 1, after = 1;
  for (int i = 0; i < 2; i++) {
    n[i] = unit_normal(t, old[i][0], old[i][1], old[i][2]);
    before = fmin(before, least_facing(t, n[i], old[i]));
  }
  if (delaunay && before >= kFolded)
    return false;
  for (int i = 0; i < 2; i++) {
    n[2 + i] = unit_normal(t, fresh[i][0], fresh[i][1], fresh[i][2]);
    after = fmin(after, least_facing(t, n[2 + i], fresh[i]));
  }
  double bend_before = lod_vec3_dot(n[0], n[1]), bend_after = lod_vec3_dot(n[2], n[3]);
  if (before < kFolded && after > before + 0.2 && bend_after > bend_before)
    return true; /* a fold opens */
  if (delaunay)
    return false;
  if (after < 0.5 && after < before)
    return false;
  if (bend_after < bend_before - 0.1 && bend_after < 0.8)
    return false;
  double length = lod_vec3_distance(t->positions[v[0]], t->positions[v[1]]);
  return bulge(t, v[2], v[3]) <= 2 * bulge(t, v[0], v[1]) + 0.02 * length;
}

static double shape_of(const struct tiling *t, uint32_t a, uint32_t b, uint32_t c) {
  double x = lod_vec3_distance(t->positions[a], t->positions[b]), y = lod_vec3_distance(t->positions[b], t->positions[c]);
  double z = lod_vec3_distance(t->positions[c], t->positions[a]), product = x * y * z;
  return product > 0 ? (y + z - x) * (z + x - y) * (x + y - z) / product : 0;
}

/* With an error that matters: no flip raises it above that, and some are wanted for it alone. */
static bool shorter(const struct tiling *t, const uint32_t v[4]) {
  return lod_vec3_distance_squared(t->positions[v[2]], t->positions[v[3]]) <
         lod_vec3_distance_squared(t->positions[v[0]], t->positions[v[1]]);
}

static bool decide(struct tiling *t, uint32_t h, const uint32_t v[4]) {
  static const double kWorth = 0.85, kLeastShape = 0.25;
  bool wanted = t->measure == LOD_RETILE_MEASURE_LENGTH ? shorter(t, v) : wants_flip(t, v);
  if (!(t->enough < INFINITY))
    return wanted;
  double before = fmax(match_known(t, h / 3, t->enough), match_known(t, t->twin[h] / 3, t->enough));
  if (wanted)
    return match_allows_flip(t, h, fmax(t->enough, before));
  return before > t->enough && fmin(shape_of(t, v[2], v[0], v[3]), shape_of(t, v[3], v[1], v[2])) > kLeastShape &&
         match_allows_flip(t, h, kWorth * before);
}

/* Turns the edges of face f over that are better so. */
static uint32_t flip_around(struct tiling *t, uint32_t f) {
  uint32_t flips = 0;
  for (uint32_t h = 3 * f; h < 3 * f + 3 && t->faces[f][0] != LOD_NONE; h++) {
    uint32_t g = t->twin[h];
    if (g == LOD_NONE || t->marks[h] != 0 || (g < h && t->fresh[g / 3] != 0)) /* that one's turn sees to it */
      continue;
    const uint32_t v[4] = {t->faces[h / 3][h % 3], t->faces[g / 3][g % 3], t->faces[h / 3][(h + 2) % 3], t->faces[g / 3][(g + 2) % 3]};
    flips += decide(t, h, v) && chart_flip(t, h);
  }
  return flips;
}

/* fresh: FLIP_CHANGED since it was looked at; FLIP_NOW in this pass; 0: nothing has happened to it. */
void improve_flips(struct tiling *tiling, uint32_t passes) {
  enum { FLIP_CHANGED = 1, FLIP_NOW = 2 };
  for (uint32_t pass = 0; pass < passes; pass++) {
    uint32_t flips = 0, looked_at = 0;
    for (uint32_t f = 0; f < tiling->face_count; f++) {
      bool misses = tiling->enough < INFINITY && (double)tiling->missed[f] > tiling->enough;
      if (tiling->fresh[f] == 0 && !misses)
        continue;
      tiling->fresh[f] = FLIP_NOW;
      looked_at++;
    }
    for (uint32_t f = 0; looked_at != 0 && f < tiling->face_count; f++)
      if (tiling->fresh[f] == FLIP_NOW) {
        flips += flip_around(tiling, f);
        if (tiling->fresh[f] == FLIP_NOW)
          tiling->fresh[f] = 0;
      }
    if (flips == 0)
      break;
  }
}
