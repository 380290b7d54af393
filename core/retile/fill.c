/* Turk's own ways to fill the hole that a vertex leaves (1992, 4.2 to 4.4, 4.7): seen from its normal or 13 other directions, and
 * triangulated greedily by length in space. Crossings are decided exactly, in integers. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

/* The 13 directions from a cell of a cubic lattice to its neighbours: faces, edges, corners; each with its opposite. */
static const double kDirections[13][3] = {{1, 0, 0}, {0, 1, 0},  {0, 0, 1}, {1, 1, 0},  {1, -1, 0}, {1, 0, 1}, {1, 0, -1},
                                          {0, 1, 1}, {0, 1, -1}, {1, 1, 1}, {1, 1, -1}, {1, -1, 1}, {-1, 1, 1}};

void fill_project(const struct lod_vec3 *positions, uint32_t count, struct lod_vec3 origin, struct lod_vec3 normal, uint32_t plane,
                  struct chart_point *at) {
  struct lod_vec3 n = normal;
  if (plane > 0) {
    const double *d = kDirections[plane - 1];
    n = lod_vec3_normalize(lod_vec3_make(d[0], d[1], d[2]));
    if (lod_vec3_dot(n, normal) < 0)
      n = lod_vec3_scale(n, -1);
  }
  struct lod_vec3 axis = fabs(n.x) < 0.6 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0);
  struct lod_vec3 u = lod_vec3_normalize(lod_vec3_cross(axis, n)), v = lod_vec3_cross(n, u);
  double largest = 0;
  for (uint32_t i = 0; i < count; i++) {
    struct lod_vec3 d = lod_vec3_subtract(positions[i], origin);
    largest = fmax(largest, fmax(fabs(lod_vec3_dot(d, u)), fabs(lod_vec3_dot(d, v))));
  }
  for (uint32_t i = 0; i < count; i++) {
    struct lod_vec3 d = lod_vec3_subtract(positions[i], origin);
    double scale = largest > 0 ? CHART_SIDE / largest : 0;
    at[i] = (struct chart_point){(int32_t)lrint(lod_vec3_dot(d, u) * scale), (int32_t)lrint(lod_vec3_dot(d, v) * scale)};
  }
}

static int sign_of(int64_t x) {
  return (x > 0) - (x < 0);
}

static bool on_segment(struct chart_point a, struct chart_point b, struct chart_point p) {
  return (p.x < a.x) + (p.x < b.x) <= 1 && (p.x > a.x) + (p.x > b.x) <= 1 && (p.y < a.y) + (p.y < b.y) <= 1 &&
         (p.y > a.y) + (p.y > b.y) <= 1;
}

/* Do two closed segments without a common end meet? */
static bool segments_meet(struct chart_point a, struct chart_point b, struct chart_point c, struct chart_point d) {
  int abc = sign_of(chart_orient(a, b, c)), abd = sign_of(chart_orient(a, b, d)), cda = sign_of(chart_orient(c, d, a)),
      cdb = sign_of(chart_orient(c, d, b));
  if (abc * abd < 0 && cda * cdb < 0)
    return true;
  return (abc == 0 && on_segment(a, b, c)) || (abd == 0 && on_segment(a, b, d)) || (cda == 0 && on_segment(c, d, a)) ||
         (cdb == 0 && on_segment(c, d, b));
}

bool fill_is_simple(const struct chart_point *at, const uint8_t *places, uint32_t count) {
  int64_t area = 0;
  const struct chart_point zero = {0, 0};
  for (uint32_t i = 0; i < count; i++) {
    struct chart_point a = at[places[i]], b = at[places[(i + 1) % count]];
    area += chart_orient(zero, a, b);
    if (a.x == b.x && a.y == b.y)
      return false;
    for (uint32_t j = i + 2; j < count; j++)
      if ((j + 1) % count != i && segments_meet(a, b, at[places[j]], at[places[(j + 1) % count]]))
        return false;
  }
  return area > 0;
}

struct diagonal {
  double length;
  uint8_t from, to; /* places in the polygon, from < to */
};

static int compare_diagonals(const void *a, const void *b) {
  const struct diagonal *x = a, *y = b;
  if (x->length != y->length)
    return x->length < y->length ? -1 : 1;
  return x->from != y->from ? (x->from < y->from ? -1 : 1) : (x->to > y->to) - (x->to < y->to);
}

/* Does the way from corner i to q begin inside the polygon? */
static bool starts_inside(const struct chart_point *at, const uint8_t *places, uint32_t count, uint32_t i, struct chart_point q) {
  struct chart_point p = at[places[i]], next = at[places[(i + 1) % count]], previous = at[places[(i + count - 1) % count]];
  bool left_of_next = chart_orient(p, next, q) > 0, right_of_previous = chart_orient(p, q, previous) > 0;
  return chart_orient(previous, p, next) > 0 ? left_of_next && right_of_previous : left_of_next || right_of_previous;
}

static bool crosses(const struct chart_point *at, const uint8_t *places, uint32_t count, const struct diagonal *d,
                    const struct diagonal *accepted, uint32_t accepted_count) {
  struct chart_point a = at[places[d->from]], b = at[places[d->to]];
  for (uint32_t i = 0; i < count; i++) {
    uint32_t j = (i + 1) % count;
    if (i != d->from && i != d->to && j != d->from && j != d->to && segments_meet(a, b, at[places[i]], at[places[j]]))
      return true;
  }
  for (uint32_t i = 0; i < accepted_count; i++) { /* diagonals of a polygon cross when their ends alternate */
    const struct diagonal *e = &accepted[i];
    if ((d->from < e->from && e->from < d->to && d->to < e->to) || (e->from < d->from && d->from < e->to && e->to < d->to))
      return true;
  }
  return false;
}

bool fill_greedy(const struct chart_point *at, const uint8_t *places, uint32_t count, const struct lod_vec3 *positions,
                 const uint64_t *joined, uint8_t (*triangles)[3], uint32_t *triangle_count) {
  enum { MOST = 64 };
  struct diagonal list[MOST * MOST / 2], accepted[MOST];
  bool edge[MOST + 1][MOST + 1] = {{false}};
  uint32_t total = 0, accepted_count = 0;
  if (count > MOST)
    return false;
  for (uint32_t i = 0; i < count; i++)
    edge[i][(i + 1) % count] = edge[(i + 1) % count][i] = true;
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t j = i + 2; j < count; j++)
      if ((i != 0 || j + 1 != count) && (joined[places[i]] >> places[j] & 1) == 0)
        list[total++] = (struct diagonal){lod_vec3_distance(positions[places[i]], positions[places[j]]), (uint8_t)i, (uint8_t)j};
  qsort(list, total, sizeof *list, compare_diagonals);
  for (uint32_t i = 0; i < total && accepted_count + 3 < count; i++)
    if (starts_inside(at, places, count, list[i].from, at[places[list[i].to]]) &&
        starts_inside(at, places, count, list[i].to, at[places[list[i].from]]) &&
        !crosses(at, places, count, &list[i], accepted, accepted_count)) {
      accepted[accepted_count++] = list[i];
      edge[list[i].from][list[i].to] = edge[list[i].to][list[i].from] = true;
    }
  if (accepted_count + 3 < count)
    return false;
  uint8_t stack[MOST][2];
  uint32_t top = 1, begin = *triangle_count;
  stack[0][0] = 0;
  stack[0][1] = (uint8_t)(count - 1);
  while (top != 0) {
    uint8_t i = stack[--top][0], j = stack[top][1], k = (uint8_t)(i + 1);
    if (j - i < 2)
      continue;
    while (k < j && !(edge[i][k] && edge[k][j]))
      k++;
    if (k == j || chart_orient(at[places[i]], at[places[k]], at[places[j]]) <= 0) {
      *triangle_count = begin;
      return false;
    }
    uint8_t *out = triangles[(*triangle_count)++];
    out[0] = places[i];
    out[1] = places[k];
    out[2] = places[j];
    stack[top][0] = i;
    stack[top++][1] = k;
    stack[top][0] = k;
    stack[top++][1] = j;
  }
  return true;
}
