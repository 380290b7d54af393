/* How far the surface that was and the triangles that are lie from one another: the measure that leads placement (Turk 1992, 8).
 *
 * There: every vertex that was removed knows the triangle that it was flattened onto; its distance to that triangle, or to a neighbour that
 * is nearer, bounds its distance to all of them from above, and is mostly the same. Back: the middles of triangles and of their sides,
 * where normals tell that a triangle may leave the surface. This leads; it proves nothing. */
#include <math.h>
#include <stdlib.h>

#include "core/retile/internal.h"

static double to_triangle(const struct tiling *t, const uint32_t v[3], struct lod_vec3 p) {
  return lod_vec3_distance_squared(p, lod_closest_on_triangle(p, t->positions[v[0]], t->positions[v[1]], t->positions[v[2]]));
}

double match_error(const struct tiling *tiling, uint32_t v, double enough) {
  enum { MOST_STEPS = 16 };
  uint32_t f = tiling->flat[v].face;
  struct lod_vec3 p = tiling->positions[v];
  double best = to_triangle(tiling, tiling->faces[f], p);
  for (int step = 0; step < MOST_STEPS && best > enough * enough; step++) {
    uint32_t next = LOD_NONE;
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t twin = tiling->twin[3 * f + k];
      double d = twin == LOD_NONE ? INFINITY : to_triangle(tiling, tiling->faces[twin / 3], p);
      if (d < best) {
        best = d;
        next = twin / 3;
      }
    }
    if (next == LOD_NONE)
      break;
    f = next;
  }
  return sqrt(best);
}

static int at_border(const struct tiling *t, uint32_t v) {
  const struct lod_retile_point *at = &t->points[v];
  if (v < t->sheet->vertex_count)
    return t->sheet->on_line[v];
  for (uint32_t k = 0; k < 3; k++)
    if (at->weights[k] == 0 && t->sheet->twin[3 * at->face + (k + 1) % 3] == LOD_NONE)
      return 1;
  return 0;
}

/* Surely near the surface: no side of it is a border, and it looks the way the source does at all corners, so it misses by a small share of
 * its size. */
static bool lies_flat(const struct tiling *t, const uint32_t v[3], double enough) {
  if (at_border(t, v[0]) + at_border(t, v[1]) + at_border(t, v[2]) > 1)
    return false;
  static const double kFacing = 0.5;
  struct lod_vec3 a = t->positions[v[0]], b = t->positions[v[1]], c = t->positions[v[2]];
  struct lod_vec3 n = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
  double longest = fmax(lod_vec3_distance_squared(a, b), fmax(lod_vec3_distance_squared(b, c), lod_vec3_distance_squared(c, a)));
  double facing = 1;
  for (int k = 0; k < 3; k++)
    facing = fmin(facing, lod_vec3_dot(n, t->normals[v[k]]));
  return facing > kFacing && longest * (1 - facing * facing) <= 16 * enough * enough; /* an arc bulges by a quarter of side times sine */
}

/* The middle of a side, or (k = 3) of the triangle. */
static struct lod_vec3 sample_of(const struct tiling *t, const uint32_t v[3], int k) {
  struct lod_vec3 a = t->positions[v[k % 3]], b = t->positions[v[(k + 1) % 3]], c = t->positions[v[(k + 2) % 3]];
  return k < 3 ? lod_vec3_scale(lod_vec3_add(a, b), 0.5) : lod_vec3_scale(lod_vec3_add(a, lod_vec3_add(b, c)), 1.0 / 3);
}

/* Is one of the samples farther from the source than `most`? */
static bool leaves_source(const struct tiling *t, const uint32_t v[3], double most) {
  if (t->source == NULL || lies_flat(t, v, most))
    return false;
  for (int k = 0; k < 4; k++)
    if (lod_bvh_any_within(t->source, sample_of(t, v, 3 - k), t->points[v[k % 3]].face, most * most) == LOD_NONE)
      return true;
  return false;
}

double match_back(const struct tiling *tiling, const uint32_t v[3], double enough) {
  if (!leaves_source(tiling, v, enough))
    return 0;
  double worst = 0;
  for (int k = 0; k < 4; k++)
    worst = fmax(worst, lod_bvh_closest(tiling->source, sample_of(tiling, v, k), tiling->points[v[k % 3]].face, INFINITY).distance_squared);
  return sqrt(worst);
}

double match_face(const struct tiling *tiling, uint32_t f, double enough) {
  double worst = 0;
  for (uint32_t v = tiling->flat_head[f]; v != LOD_NONE; v = tiling->flat_next[v])
    worst = fmax(worst, match_error(tiling, v, fmax(worst, enough)));
  return fmax(worst, match_back(tiling, tiling->faces[f], fmax(worst, enough)));
}

/* Looked at a little below what is asked, for the next one will ask for less. */
static const double kBelow = 0.7;

/* missed: 0 = not known, > 0 exact, < 0: at most its negative. Neighbours that change make it a bound that is a little stale. */
double match_known(struct tiling *tiling, uint32_t f, double enough) {
  double known = (double)tiling->missed[f];
  if (known > 0 || (known < 0 && -known <= enough))
    return fabs(known);
  enough *= kBelow;
  double miss = match_face(tiling, f, enough);
  tiling->missed[f] = miss > enough ? (float)miss : -(float)fmax(enough, 1e-30);
  return miss;
}

double match_worst(struct tiling *tiling) {
  double worst = 0;
  for (uint32_t f = 0; f < tiling->face_count; f++)
    if (tiling->faces[f][0] != LOD_NONE)
      worst = fmax(worst, match_known(tiling, f, worst));
  return worst;
}

bool match_allows_flip(const struct tiling *t, uint32_t h, double most) {
  uint32_t g = t->twin[h], a = t->faces[h / 3][h % 3], b = t->faces[g / 3][g % 3], c = t->faces[h / 3][(h + 2) % 3],
           d = t->faces[g / 3][(g + 2) % 3];
  const uint32_t fresh[2][3] = {{c, a, d}, {d, b, c}};
  for (int side = 0; side < 2; side++)
    for (uint32_t v = t->flat_head[(side == 0 ? h : g) / 3]; v != LOD_NONE; v = t->flat_next[v])
      if (to_triangle(t, fresh[0], t->positions[v]) > most * most && to_triangle(t, fresh[1], t->positions[v]) > most * most)
        return false; /* a neighbour may be nearer, as match_error would find: never mind */
  return !leaves_source(t, fresh[0], most) && !leaves_source(t, fresh[1], most);
}

static int compare_floats(const void *a, const void *b) {
  float x = *(const float *)a, y = *(const float *)b;
  return (x < y) - (x > y);
}

enum lod_status match_typical(struct tiling *tiling, double share, double enough, struct lod_arena *arena, double *miss) {
  float *list;
  uint32_t count = 0;
  RETILE_TRY_NEW(list, arena, tiling->face_count);
  for (uint32_t f = 0; f < tiling->face_count; f++)
    if (tiling->faces[f][0] != LOD_NONE)
      list[count++] = (float)match_known(tiling, f, enough);
  qsort(list, count, sizeof *list, compare_floats);
  *miss = count == 0 ? 0 : (double)list[(uint32_t)(share * count)];
  return LOD_OK;
}
