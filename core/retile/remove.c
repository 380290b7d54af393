/* Removing vertices: the hole that a vertex leaves is laid out by its polar map and triangulated at least cost.
 *
 * Based on: Turk 1992, 4.3, 4.4, 4.6; Lee, Sweldens, Schroeder, Cowsar, Dobkin. MAPS. 1998, 4.2 (the polar map: angles scaled to fill the
 * plane, radii raised to the same power). The layout is star-shaped around the vertex, so Turk's first check cannot fail; the second (no
 * edge of three triangles) is a rule for diagonals inside the triangulation. A vertex of a feature line leaves two half holes and one edge
 * of the line between them. Topology changes nowhere: each hole is a disc, and so is what fills it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

enum { MAX_RING = 64 };

struct star {
  uint32_t v, faces, ring_count; /* ring_count: faces, or one more when it is open */
  bool closed;
  uint32_t spokes[MAX_RING]; /* v -> ring[i], in the face of ring[i], ring[i + 1] */
  uint32_t ring[MAX_RING + 1];
  uint32_t lines[2], line_count; /* ring places of marked spokes */
  struct chart_point at[MAX_RING + 1];
  uint64_t joined[MAX_RING + 1]; /* ring places that an edge outside, or of the ring, joins */
};

/* Ring places, counter-clockwise; the edge from the last to the first is new, or the line. */
struct polygon {
  uint32_t count;
  uint8_t places[MAX_RING + 1];
  bool closing; /* that edge is part of a line or border; its fields: */
  uint8_t mark;
  uint32_t start;
};

struct entry {
  double key;
  uint32_t v;
};

struct remover {
  struct tiling *tiling;
  bool (*which)(const struct tiling *tiling, uint32_t v, uint32_t level);
  uint32_t level;
  double least_facing;   /* cosine that a new triangle's normal must have with the surface's; -1: never mind */
  struct entry *pending; /* vertices to remove */
  uint32_t *changed;     /* by vertex: the round in which its star changed last */
  int8_t *place;         /* ring place by vertex, -1 */
  struct star star;
  struct polygon polygons[2];
  uint32_t polygon_count;
  uint8_t triangles[MAX_RING][3]; /* ring places */
  uint32_t triangle_count;
  double cost[MAX_RING + 1][MAX_RING + 1];
  uint8_t apex[MAX_RING + 1][MAX_RING + 1];
  uint32_t half[MAX_RING + 1][MAX_RING + 1];
};

static uint32_t start_of(const struct tiling *t, uint32_t h) {
  return t->faces[h / 3][h % 3];
}

static bool gather(const struct tiling *t, uint32_t v, struct star *s) {
  uint32_t begin = tiling_first(t, v, &s->closed), h = begin;
  s->v = v;
  s->faces = s->line_count = 0;
  do {
    if (s->faces == MAX_RING - 1)
      return false;
    if (t->marks[h] != 0) {
      if (s->line_count == 2)
        return false;
      s->lines[s->line_count++] = s->faces;
    }
    s->spokes[s->faces] = h;
    s->ring[s->faces++] = start_of(t, retile_next(h));
    h = t->twin[retile_previous(h)];
  } while (h != LOD_NONE && h != begin);
  s->ring_count = s->faces;
  if (!s->closed) {
    s->ring[s->ring_count++] = start_of(t, retile_previous(s->spokes[s->faces - 1]));
    return s->line_count == 1; /* its other border edge ends here */
  }
  return s->line_count != 1;
}

static double angle_at(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b) {
  struct lod_vec3 u = lod_vec3_subtract(a, p), w = lod_vec3_subtract(b, p);
  return retile_angle(lod_vec3_length(lod_vec3_cross(u, w)), lod_vec3_dot(u, w));
}

/* Lays out ring places from..to over the angle `span` from `begin` on. */
static void lay_sector(const struct tiling *t, struct star *s, uint32_t from, uint32_t to, double begin, double span, bool even,
                       double *angles, double *radii) {
  double sum = 0, turned[MAX_RING + 1], mean = 0;
  struct lod_vec3 p = t->positions[s->v];
  for (uint32_t i = from; i < to; i++) {
    uint32_t a = s->ring[i % s->ring_count], b = s->ring[(i + 1) % s->ring_count];
    turned[i - from] = even ? 1 : fmax(1e-3, angle_at(p, t->positions[a], t->positions[b]));
    sum += turned[i - from];
    mean += lod_vec3_distance(p, t->positions[a]) / (to - from);
  }
  for (uint32_t i = from; i <= to; i++) {
    uint32_t k = i % s->ring_count;
    double r = even || !(mean > 0) ? 1 : lod_vec3_distance(p, t->positions[s->ring[k]]) / mean;
    if (i < to || k != from % s->ring_count) {
      angles[k] = begin;
      radii[k] = pow(fmin(32, fmax(1.0 / 32, r)), fmin(2, span / sum));
    }
    if (i < to)
      begin += span * turned[i - from] / sum;
  }
}

static bool lay_out(const struct tiling *t, struct star *s, bool even) {
  const double pi = 3.14159265358979323846;
  double angles[MAX_RING + 1], radii[MAX_RING + 1], largest = 0;
  if (!s->closed) {
    lay_sector(t, s, 0, s->faces, 0, pi, even, angles, radii);
  } else if (s->line_count == 0) {
    lay_sector(t, s, 0, s->faces, 0, 2 * pi, even, angles, radii);
  } else {
    lay_sector(t, s, s->lines[0], s->lines[1], 0, pi, even, angles, radii);
    lay_sector(t, s, s->lines[1], s->lines[0] + s->faces, pi, pi, even, angles, radii);
    angles[s->lines[0]] = 0;
  }
  for (uint32_t i = 0; i < s->ring_count; i++)
    largest = fmax(largest, radii[i]);
  for (uint32_t i = 0; i < s->ring_count; i++) {
    s->at[i].x = (int32_t)lrint(CHART_SIDE * radii[i] / largest * cos(angles[i]));
    s->at[i].y = (int32_t)lrint(CHART_SIDE * radii[i] / largest * sin(angles[i]));
  }
  const struct chart_point zero = {0, 0};
  for (uint32_t i = 0; i < s->faces; i++)
    if (chart_orient(zero, s->at[i], s->at[(i + 1) % s->ring_count]) <= 0)
      return false;
  return true;
}

static uint32_t first_copy(const struct tiling *t, uint32_t v) {
  uint32_t least = v;
  for (uint32_t w = t->copies[v]; w != v; w = t->copies[w])
    least = w < least ? w : least;
  return least;
}

/* Marks the ring's vertices, all copies, with their place (LOD_NONE: -1 again); false when the ring names a vertex twice. */
static bool mark_ring(struct remover *r, bool mark) {
  const struct star *s = &r->star;
  const uint32_t *copies = r->tiling->copies;
  bool good = true;
  for (uint32_t i = 0; i < s->ring_count; i++) {
    uint32_t copy = s->ring[i];
    good = good && (!mark || r->place[copy] < 0);
    do
      r->place[copy] = mark ? (int8_t)i : -1;
    while ((copy = copies[copy]) != s->ring[i]);
  }
  return good;
}

static inline void note(const struct remover *r, uint32_t v, uint64_t *joined) {
  int8_t place = r->place[v];
  if (place >= 0)
    *joined |= UINT64_C(1) << place;
}

/* Places of what an edge joins to v. */
static uint64_t joined_to(const struct remover *r, uint32_t v) {
  const struct tiling *t = r->tiling;
  uint32_t begin = t->corner[v], h = begin, last;
  uint64_t joined = 0;
  do {
    note(r, start_of(t, retile_next(h)), &joined);
    last = retile_previous(h);
    h = t->twin[last];
  } while (h != LOD_NONE && h != begin);
  if (h != LOD_NONE)
    return joined;
  note(r, start_of(t, last), &joined); /* open: the other end, and what lies before `begin` */
  for (h = t->twin[begin]; h != LOD_NONE; h = t->twin[h]) {
    h = retile_next(h);
    note(r, start_of(t, retile_next(h)), &joined);
  }
  return joined;
}

/* Fills s->joined; false when the ring names a vertex twice. */
static bool join(struct remover *r) {
  struct star *s = &r->star;
  bool good = mark_ring(r, true);
  for (uint32_t i = 0; good && i < s->ring_count; i++) {
    uint32_t copy = s->ring[i];
    s->joined[i] = 0;
    do
      s->joined[i] |= joined_to(r, copy);
    while ((copy = r->tiling->copies[copy]) != s->ring[i]);
  }
  mark_ring(r, false);
  return good;
}

static void set_closing(struct remover *r, struct polygon *p, uint32_t half_edge) {
  p->closing = true;
  p->mark = r->tiling->marks[half_edge];
  p->start = r->tiling->start[half_edge];
}

/* The holes that removing the vertex leaves. */
static void make_polygons(struct remover *r) {
  const struct star *s = &r->star;
  r->polygon_count = 1;
  struct polygon *p = r->polygons;
  p[0].closing = false;
  p[0].count = 0;
  if (s->closed && s->line_count == 2) {
    r->polygon_count = 2;
    for (uint32_t side = 0; side < 2; side++) {
      uint32_t from = s->lines[side], to = side == 0 ? s->lines[1] : s->lines[0] + s->faces;
      p[side].count = 0;
      for (uint32_t i = from; i <= to; i++)
        p[side].places[p[side].count++] = (uint8_t)(i % s->faces);
      set_closing(r, &p[side], retile_previous(s->spokes[(to - 1) % s->faces]));
    }
    return;
  }
  for (uint32_t i = 0; i < s->ring_count; i++)
    p[0].places[p[0].count++] = (uint8_t)i;
  if (!s->closed)
    set_closing(r, &p[0], retile_previous(s->spokes[s->faces - 1]));
}

static struct lod_vec3 normal_of(const struct tiling *t, uint32_t a, uint32_t b, uint32_t c) {
  return lod_vec3_cross(lod_vec3_subtract(t->positions[b], t->positions[a]), lod_vec3_subtract(t->positions[c], t->positions[a]));
}

/* Does the triangle look at least so much the way that the surface does? */
static bool looks_right(const struct tiling *t, const uint32_t v[3], struct lod_vec3 n, struct lod_vec3 facing, double least) {
  bool right = lod_vec3_dot(n, facing) >= least;
  for (int k = 0; k < 3 && right; k++) /* on lines a normal is a mean over both sides and says nothing */
    right = (v[k] < t->sheet->vertex_count && t->sheet->on_line[v[k]]) || lod_vec3_dot(n, t->normals[v[k]]) >= least;
  return right;
}

/* Short edges, and triangles that look the way the old ones did; a triangle that looks away costs dearly. */
static double triangle_cost(const struct remover *r, uint8_t a, uint8_t b, uint8_t c, struct lod_vec3 facing) {
  const struct tiling *t = r->tiling;
  const struct star *s = &r->star;
  uint32_t v[3] = {s->ring[a], s->ring[b], s->ring[c]};
  double sides = 0;
  for (int k = 0; k < 3; k++)
    sides += lod_vec3_distance_squared(t->positions[v[k]], t->positions[v[(k + 1) % 3]]);
  struct lod_vec3 n = lod_vec3_normalize(normal_of(t, v[0], v[1], v[2]));
  double away = 1 - lod_vec3_dot(n, facing);
  if (r->least_facing > -1 && !looks_right(t, v, n, facing, r->least_facing))
    return INFINITY;
  return sides * (1 + 3 * away + (away > 0.8 ? 30 * (away - 0.8) : 0));
}

/* Less is better: minus the least angle. */
static double angle_cost(const struct tiling *t, const struct star *s, uint8_t a, uint8_t b, uint8_t c) {
  double least = 4;
  const uint8_t place[3] = {a, b, c};
  for (int k = 0; k < 3; k++)
    least = fmin(least, angle_at(t->positions[s->ring[place[k]]], t->positions[s->ring[place[(k + 1) % 3]]],
                                 t->positions[s->ring[place[(k + 2) % 3]]]));
  return -least;
}

/* The cheapest triangulation of one hole; its triangles are added. */
static bool fill(struct remover *r, const struct polygon *p) {
  const struct star *s = &r->star;
  const struct tiling *t = r->tiling;
  uint32_t n = p->count;
  if (t->measure == LOD_RETILE_MEASURE_LENGTH) {
    struct lod_vec3 positions[MAX_RING + 1];
    for (uint32_t i = 0; i < s->ring_count; i++)
      positions[i] = t->positions[s->ring[i]];
    return fill_greedy(s->at, p->places, n, positions, s->joined, r->triangles, &r->triangle_count);
  }
  bool by_angle = t->measure == LOD_RETILE_MEASURE_ANGLE;
  struct lod_vec3 facing = {0, 0, 0};
  for (uint32_t i = 0; i + 1 < n + (p->closing ? 0 : 1); i++)
    facing = lod_vec3_add(facing, normal_of(t, s->v, s->ring[p->places[i]], s->ring[p->places[(i + 1) % n]]));
  facing = lod_vec3_normalize(facing);
  for (uint32_t i = 0; i + 1 < n; i++)
    r->cost[i][i + 1] = by_angle ? -4 : 0;
  for (uint32_t length = 2; length < n; length++)
    for (uint32_t i = 0; i + length < n; i++) {
      uint32_t j = i + length;
      uint8_t a = p->places[i], c = p->places[j];
      r->cost[i][j] = INFINITY;
      if (length < n - 1 && (s->joined[a] >> c & 1) != 0)
        continue;
      for (uint32_t k = i + 1; k < j; k++) {
        uint8_t b = p->places[k];
        double sum = by_angle ? fmax(r->cost[i][k], r->cost[k][j]) : r->cost[i][k] + r->cost[k][j];
        if (!(sum < r->cost[i][j]) || chart_orient(s->at[a], s->at[b], s->at[c]) <= 0)
          continue;
        sum = by_angle ? fmax(sum, angle_cost(t, s, a, b, c)) : sum + triangle_cost(r, a, b, c, facing);
        if (sum < r->cost[i][j]) {
          r->cost[i][j] = sum;
          r->apex[i][j] = (uint8_t)k;
        }
      }
    }
  if (!isfinite(r->cost[0][n - 1]))
    return false;
  uint8_t stack[2 * MAX_RING + 4][2];
  uint32_t top = 0;
  stack[top][0] = 0;
  stack[top++][1] = (uint8_t)(n - 1);
  while (top != 0) {
    uint8_t i = stack[--top][0], j = stack[top][1];
    if (j - i < 2)
      continue;
    uint8_t k = r->apex[i][j], *out = r->triangles[r->triangle_count++];
    out[0] = p->places[i];
    out[1] = p->places[k];
    out[2] = p->places[j];
    stack[top][0] = i;
    stack[top++][1] = k;
    stack[top][0] = k;
    stack[top++][1] = j;
  }
  return true;
}

/* Would the edge that a hole closes with, or its only triangle, be there twice? */
static bool closes(const struct remover *r) {
  const struct star *s = &r->star;
  const struct tiling *t = r->tiling;
  for (uint32_t i = 0; i < r->polygon_count; i++) {
    const struct polygon *p = &r->polygons[i];
    if (p->count < 3 || (p->closing && (s->joined[p->places[p->count - 1]] >> p->places[0] & 1) != 0))
      return false;
  }
  if (s->closed && s->line_count == 0 && s->faces == 3) {
    uint32_t outer = t->twin[retile_next(s->spokes[0])];
    return outer == LOD_NONE || first_copy(t, start_of(t, retile_previous(outer))) != first_copy(t, s->ring[2]);
  }
  return true;
}

static void move_flat(struct remover *r, const uint32_t *slots) {
  struct tiling *t = r->tiling;
  const struct star *s = &r->star;
  uint32_t list = LOD_NONE;
  for (uint32_t i = 0; i < s->faces; i++) {
    struct chart_point at[3];
    at[s->spokes[i] % 3] = (struct chart_point){0, 0};
    at[(s->spokes[i] + 1) % 3] = s->at[i];
    at[(s->spokes[i] + 2) % 3] = s->at[(i + 1) % s->ring_count];
    list = chart_lift(t, s->spokes[i] / 3, at, list);
  }
  list = chart_add(t, s->v, (struct chart_point){0, 0}, list);
  struct chart_point corners[MAX_RING][3];
  for (uint32_t i = 0; i < r->triangle_count; i++)
    for (int k = 0; k < 3; k++)
      corners[i][k] = s->at[r->triangles[i][k]];
  chart_drop(t, list, slots, (const struct chart_point(*)[3])corners, r->triangle_count);
}

/* Puts the new triangles in the place of the old ones. */
static void replace(struct remover *r) {
  struct tiling *t = r->tiling;
  struct star *s = &r->star;
  uint32_t slots[MAX_RING], outer[MAX_RING], start[MAX_RING], region[2];
  uint8_t mark[MAX_RING];
  for (uint32_t i = 0; i < s->faces; i++) {
    uint32_t h = retile_next(s->spokes[i]);
    slots[i] = s->spokes[i] / 3;
    outer[i] = t->twin[h];
    mark[i] = t->marks[h];
    start[i] = t->start[h];
  }
  for (uint32_t i = 0; i < r->polygon_count; i++)
    region[i] = t->region[slots[r->polygons[i].places[0]]];
  move_flat(r, slots);
  for (uint32_t i = 0; i < r->triangle_count; i++)
    for (uint32_t k = 0; k < 3; k++) {
      uint8_t a = r->triangles[i][k], b = r->triangles[i][(k + 1) % 3];
      uint32_t h = 3 * slots[i] + k;
      match_forget(t, slots[i]);
      t->faces[slots[i]][k] = s->ring[a];
      t->corner[s->ring[a]] = h;
      t->twin[h] = LOD_NONE;
      t->marks[h] = 0;
      r->half[a][b] = h;
    }
  uint32_t in_first = r->polygons[0].count - 2;
  for (uint32_t i = 0; i < r->triangle_count; i++) {
    t->region[slots[i]] = region[i < in_first ? 0 : 1];
    for (uint32_t k = 0; k < 3; k++) {
      uint8_t a = r->triangles[i][k], b = r->triangles[i][(k + 1) % 3];
      uint32_t h = 3 * slots[i] + k;
      const struct polygon *p = &r->polygons[i < in_first ? 0 : 1];
      if (p->closing && a == p->places[p->count - 1] && b == p->places[0]) {
        t->marks[h] = p->mark;
        t->start[h] = p->start;
        if (s->closed)
          t->twin[h] = r->half[b][a];
      } else if (a < s->faces && b == (a + 1) % s->ring_count) {
        tiling_link(t, h, outer[a]);
        t->marks[h] = mark[a];
        t->start[h] = start[a];
      } else {
        t->twin[h] = r->half[b][a];
      }
    }
  }
  for (uint32_t i = r->triangle_count; i < s->faces; i++)
    t->faces[slots[i]][0] = LOD_NONE;
  t->dead[s->v] = true;
}

/* A side of a line with one triangle gets a second one by a flip, when that is possible. */
static bool widen(struct remover *r) {
  const struct star *s = &r->star;
  for (uint32_t i = 0; i < r->polygon_count; i++)
    if (r->polygons[i].count == 2 && !chart_flip(r->tiling, retile_next(s->spokes[r->polygons[i].places[0]])))
      return false;
  return true;
}

/* The ring projected onto one of Turk's planes; false when an outline crosses itself there (his first check). */
static bool look_from(struct remover *r, uint32_t plane) {
  const struct tiling *t = r->tiling;
  struct star *s = &r->star;
  struct lod_vec3 positions[MAX_RING + 1], normal = {0, 0, 0};
  for (uint32_t i = 0; i < s->ring_count; i++)
    positions[i] = t->positions[s->ring[i]];
  for (uint32_t i = 0; i < s->faces; i++)
    normal = lod_vec3_add(normal, normal_of(t, s->v, s->ring[i], s->ring[(i + 1) % s->ring_count]));
  fill_project(positions, s->ring_count, t->positions[s->v], lod_vec3_normalize(normal), plane, s->at);
  for (uint32_t i = 0; i < r->polygon_count; i++)
    if (!fill_is_simple(s->at, r->polygons[i].places, r->polygons[i].count))
      return false;
  return true;
}

static bool remove_vertex(struct remover *r, uint32_t v) {
  struct star *s = &r->star;
  for (int attempt = 0;; attempt++) {
    if (r->tiling->fixed[v] || !gather(r->tiling, v, s))
      return false;
    make_polygons(r);
    bool narrow = r->polygons[0].count < 3 || (r->polygon_count == 2 && r->polygons[1].count < 3);
    if (!narrow)
      break;
    if (attempt == 1 || !widen(r))
      return false;
  }
  if (!join(r) || !closes(r))
    return false;
  uint32_t layouts = r->tiling->projection == LOD_RETILE_PLANES ? FILL_PLANES : 2;
  for (uint32_t layout = 0; layout < layouts; layout++) {
    r->triangle_count = 0;
    if (layouts == 2 ? !lay_out(r->tiling, s, layout != 0) : !look_from(r, layout))
      continue;
    bool filled = true;
    for (uint32_t i = 0; i < r->polygon_count && filled; i++)
      filled = fill(r, &r->polygons[i]);
    if (filled) {
      replace(r);
      return true;
    }
  }
  return false;
}

/* ---- the order ---- */

double remove_cost(const struct tiling *t, uint32_t v) {
  bool closed;
  uint32_t begin = tiling_first(t, v, &closed), h = begin, count = 0;
  struct lod_vec3 p = t->positions[v], sum = {0, 0, 0};
  double length = 0;
  do {
    struct lod_vec3 d = lod_vec3_subtract(t->positions[start_of(t, retile_next(h))], p);
    sum = lod_vec3_add(sum, d);
    length += lod_vec3_length(d);
    count++;
    h = t->twin[retile_previous(h)];
  } while (h != LOD_NONE && h != begin && count < 1000);
  return fabs(lod_vec3_dot(sum, t->normals[v])) / count + 0.03 * length;
}

static int compare_entries(const void *left, const void *right) {
  const struct entry *a = left, *b = right;
  if (a->key != b->key)
    return a->key < b->key ? -1 : 1;
  return a->v < b->v ? -1 : a->v > b->v;
}

/* Removes what can be, in rounds of vertices that are no neighbours (Lee et al. 1998, 4.1), those that stand out least first: costs are
 * looked at once a round. A vertex that cannot go is tried again when its neighbours have changed. *left: what stays. */
static enum lod_status remove_all(struct remover *r, uint32_t *left) {
  struct tiling *t = r->tiling;
  uint32_t pending = 0, removed = 1;
  *left = 0;
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (!t->dead[v] && r->which(t, v, r->level)) {
      ++*left;
      r->changed[v] = 1;
      if (!t->fixed[v])
        r->pending[pending++] = (struct entry){0, v};
    }
  for (uint32_t round = 2; removed != 0; round++) {
    uint32_t kept = 0, count = 0;
    removed = 0;
    for (uint32_t i = 0; i < pending; i++) /* those that can be tried come first */
      if (r->changed[r->pending[i].v] + 1 >= round) {
        struct entry entry = {remove_cost(t, r->pending[i].v), r->pending[i].v};
        r->pending[i] = r->pending[count];
        r->pending[count++] = entry;
      }
    qsort(r->pending, count, sizeof *r->pending, compare_entries);
    for (uint32_t i = 0; i < pending; i++) {
      struct entry entry = r->pending[i];
      if (i < count && r->changed[entry.v] != round && remove_vertex(r, entry.v)) {
        for (uint32_t k = 0; k < r->star.ring_count; k++)
          r->changed[r->star.ring[k]] = round;
        removed++;
        continue;
      }
      r->pending[kept++] = entry;
    }
    pending = kept;
    *left -= removed;
  }
  return LOD_OK;
}

static uint32_t count_alive(const struct tiling *t) {
  uint32_t count = 0;
  for (uint32_t v = 0; v < t->vertex_count; v++)
    count += !t->dead[v];
  return count;
}

/* Triangles that look away from the surface are put off: around handles and in thin parts they take edges to the wrong side, from where no
 * map leads back (overlay.h). A few that nothing else can do without are let pass; where there are many, the surface has more holes than
 * the level has vertices for, and these stay. */
enum { PHASES = 3 };
static const double kLeastFacing[PHASES] = {0, -0.3, -1}, kFew = 0.02;

enum lod_status remove_vertices(struct tiling *tiling, bool (*which)(const struct tiling *tiling, uint32_t v, uint32_t level),
                                uint32_t level, struct lod_arena *arena, uint32_t *left) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct remover *r = scratch == NULL ? NULL : LOD_NEW(scratch, 1, struct remover);
  enum lod_status status = r == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK) {
    *r = (struct remover){.tiling = tiling, .which = which, .level = level};
    r->pending = LOD_NEW(scratch, tiling->vertex_count, struct entry);
    r->changed = LOD_NEW(scratch, tiling->vertex_count, uint32_t);
    r->place = LOD_NEW(scratch, tiling->vertex_count, int8_t);
    status = r->pending == NULL || r->changed == NULL || r->place == NULL ? LOD_MEMORY : LOD_OK;
  }
  uint32_t remaining = 0;
  if (status == LOD_OK)
    memset(r->place, -1, tiling->vertex_count);
  for (int phase = tiling->upright ? 0 : PHASES - 1; status == LOD_OK && phase < PHASES; phase++) {
    r->least_facing = kLeastFacing[phase];
    status = remove_all(r, &remaining);
    if (phase + 2 == PHASES && remaining > kFew * count_alive(tiling))
      break;
  }
  lod_arena_destroy(scratch);
  *left = remaining;
  return status;
}
