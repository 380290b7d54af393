/* Flat points through a change of triangles: into the plane of the chart, and onto the triangle there that contains them; exact but for
 * the rounding of their weights to 2^-20. */
#include <math.h>

#include "core/retile/internal.h"

uint32_t chart_lift(struct tiling *tiling, uint32_t face, const struct chart_point at[3], uint32_t list) {
  for (uint32_t v = tiling->flat_head[face], next; v != LOD_NONE; v = next) {
    next = tiling->flat_next[v];
    int64_t x = 0, y = 0;
    for (int k = 0; k < 3; k++) {
      x += (int64_t)tiling->flat[v].weights[k] * at[k].x;
      y += (int64_t)tiling->flat[v].weights[k] * at[k].y;
    }
    tiling->plane[v][0] = x;
    tiling->plane[v][1] = y;
    tiling->flat_next[v] = list;
    list = v;
  }
  tiling->flat_head[face] = LOD_NONE;
  return list;
}

uint32_t chart_add(struct tiling *tiling, uint32_t v, struct chart_point at, uint32_t list) {
  tiling->plane[v][0] = (int64_t)at.x * LOD_RETILE_ONE;
  tiling->plane[v][1] = (int64_t)at.y * LOD_RETILE_ONE;
  tiling->flat_next[v] = list;
  return v;
}

/* Twice the area of a, b, p times ONE. Below 2^61: coordinates are at most 2^18, p's 2^38. */
static int64_t orient_scaled(struct chart_point a, struct chart_point b, const int64_t p[2]) {
  return (int64_t)(b.x - a.x) * (p[1] - (int64_t)a.y * LOD_RETILE_ONE) - (int64_t)(b.y - a.y) * (p[0] - (int64_t)a.x * LOD_RETILE_ONE);
}

void chart_drop(struct tiling *tiling, uint32_t list, const uint32_t *faces, const struct chart_point (*corners)[3], uint32_t count) {
  for (uint32_t v = list, next; v != LOD_NONE; v = next) {
    next = tiling->flat_next[v];
    uint32_t best = 0;
    double best_share = -1e300;
    int64_t best_sides[3] = {1, 1, 1};
    for (uint32_t i = 0; i < count; i++) {
      const struct chart_point *c = corners[i];
      int64_t sides[3], least = INT64_MAX;
      for (int k = 0; k < 3; k++) {
        sides[k] = orient_scaled(c[(k + 1) % 3], c[(k + 2) % 3], tiling->plane[v]);
        least = sides[k] < least ? sides[k] : least;
      }
      /* One contains it but for the rounding of its weights: then the one that it misses least. */
      double share = least >= 0 ? 0 : (double)least / (double)chart_orient(c[0], c[1], c[2]);
      if (share > best_share) {
        best_share = share;
        best = i;
        for (int k = 0; k < 3; k++)
          best_sides[k] = sides[k];
      }
      if (least >= 0)
        break;
    }
    int64_t area = chart_orient(corners[best][0], corners[best][1], corners[best][2]);
    uint32_t weights[3], largest = 0, sum = 0;
    for (uint32_t k = 0; k < 3; k++) {
      int64_t w = (best_sides[k] + area / 2) / area;
      weights[k] = w < 0 ? 0 : w > LOD_RETILE_ONE ? LOD_RETILE_ONE : (uint32_t)w;
      sum += weights[k];
      largest = weights[k] > weights[largest] ? k : largest;
    }
    weights[largest] += LOD_RETILE_ONE - sum;
    tiling->flat[v] = (struct lod_retile_point){faces[best], {weights[0], weights[1], weights[2]}};
    tiling->flat_next[v] = tiling->flat_head[faces[best]];
    tiling->flat_head[faces[best]] = v;
  }
}

/* The two triangles at an edge, unfolded to the plane: a, b, c, d of (a, b, c) and (b, a, d). */
static bool unfold(const struct tiling *t, const uint32_t v[4], struct chart_point at[4]) {
  struct lod_vec3 p[4];
  for (int i = 0; i < 4; i++)
    p[i] = lod_vec3_subtract(t->positions[v[i]], t->positions[v[0]]);
  double length = lod_vec3_length(p[1]);
  if (!(length > 0))
    return false;
  struct lod_vec3 axis = lod_vec3_scale(p[1], 1 / length);
  double q[4][2] = {{0, 0}, {length, 0}}, largest = length;
  for (int i = 2; i < 4; i++) {
    q[i][0] = lod_vec3_dot(p[i], axis);
    double height = lod_vec3_length(lod_vec3_cross(axis, p[i]));
    q[i][1] = i == 2 ? height : -height;
    largest = fmax(largest, fmax(fabs(q[i][0]), height));
  }
  for (int i = 0; i < 4; i++)
    at[i] = (struct chart_point){(int32_t)lrint(q[i][0] / largest * CHART_SIDE), (int32_t)lrint(q[i][1] / largest * CHART_SIDE)};
  return chart_orient(at[0], at[1], at[2]) > 0 && chart_orient(at[1], at[0], at[3]) > 0;
}

bool chart_flip(struct tiling *tiling, uint32_t h) {
  uint32_t g = tiling->twin[h];
  if (g == LOD_NONE || tiling->marks[h] != 0)
    return false;
  const uint32_t(*f)[3] = (const uint32_t(*)[3])tiling->faces;
  uint32_t v[4] = {f[h / 3][h % 3], f[g / 3][g % 3], f[h / 3][(h + 2) % 3], f[g / 3][(g + 2) % 3]};
  struct chart_point at[4];
  if (tiling_same(tiling, v[2], v[3]) || !unfold(tiling, v, at) || chart_orient(at[2], at[0], at[3]) <= 0 ||
      chart_orient(at[3], at[1], at[2]) <= 0 || tiling_connected(tiling, v[2], v[3]))
    return false;
  struct chart_point corners[3];
  for (uint32_t k = 0; k < 3; k++)
    corners[(h + k) % 3] = at[k];
  uint32_t list = chart_lift(tiling, h / 3, corners, LOD_NONE);
  static const int kOther[3] = {1, 0, 3};
  for (uint32_t k = 0; k < 3; k++)
    corners[(g + k) % 3] = at[kOther[k]];
  list = chart_lift(tiling, g / 3, corners, list);
  tiling_flip(tiling, h);
  const struct chart_point fresh[2][3] = {{at[2], at[0], at[3]}, {at[3], at[1], at[2]}}; /* as tiling_flip orders them */
  const uint32_t faces[2] = {h / 3, g / 3};
  chart_drop(tiling, list, faces, fresh, 2);
  return true;
}
