/* The patches around a vertex laid out in the plane, and the triangles that replace them.
 *
 * Based on: Lee, Sweldens, Schroeder, Cowsar, Dobkin. MAPS. 1998 (the polar map: angles around the vertex scaled to a full turn, or to half
 * a turn on a line, distances kept). What replaces them is the triangulation of least cost by dynamic programming: triangles as nearly
 * equilateral as may be, none turned over in the plane, no edge between two vertices that have one already. */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"

static const double kPi = 3.14159265358979323846;

/* The half-edge at the same vertex in the next patch counter-clockwise, or LOD_NONE. */
static uint32_t next_around(const struct lod_clod *clod, uint32_t half) {
  return clod_across(clod, half % 3 == 0 ? half + 2 : half - 1);
}

static uint32_t previous_half(uint32_t half) {
  return half % 3 == 0 ? half + 2 : half - 1;
}
static uint32_t following_half(uint32_t half) {
  return half % 3 == 2 ? half - 2 : half + 1;
}

static struct clod_edge *edge_of(const struct lod_clod *clod, uint32_t half) {
  return &clod->edges[clod->patches[half / 3].sides[half % 3] >> 1];
}

static uint32_t start_of(const struct lod_clod *clod, uint32_t half) {
  return clod->patches[half / 3].corners[half % 3];
}

/* Collects patches counter-clockwise from `half` (which starts at the vertex) until the edge `half` again or a line's edge. */
static bool collect(const struct lod_clod *clod, uint32_t half, bool open, struct clod_polygon *polygon) {
  polygon->open = open;
  polygon->size = polygon->old_count = 0;
  uint32_t at = half;
  for (;;) {
    if (polygon->size + 1 >= CLOD_RING)
      return false;
    polygon->old[polygon->old_count++] = at;
    uint32_t next = following_half(at);
    polygon->ring[polygon->size] = start_of(clod, next);
    polygon->wedges[polygon->size] = clod->patches[at / 3].wedges[next % 3];
    polygon->sectors[polygon->size++] = clod->patches[at / 3].sectors[next % 3];
    uint32_t last = previous_half(at);
    if (open && (edge_of(clod, last)->flags & CLOD_LINE) != 0) {
      polygon->ring[polygon->size] = start_of(clod, last);
      polygon->wedges[polygon->size] = clod->patches[at / 3].wedges[last % 3];
      polygon->sectors[polygon->size++] = clod->patches[at / 3].sectors[last % 3];
      break;
    }
    at = next_around(clod, at);
    if (at == LOD_NONE)
      return false;
    if (at == half) {
      if (open)
        return false;
      break;
    }
  }
  /* A ring that meets itself (closed loops of patches, folded patches) is no polygon. */
  for (uint32_t i = 0; i < polygon->size; i++)
    for (uint32_t j = 0; j < i; j++)
      if (polygon->ring[i] == polygon->ring[j])
        return false;
  return polygon->size >= 3;
}

static bool lay_out(const struct lod_clod *clod, uint32_t v, struct clod_polygon *polygon) {
  double angles[CLOD_RING], total = 0;
  struct lod_vec3 centre = clod->positions[v];
  for (uint32_t i = 0; i < polygon->old_count; i++) {
    struct lod_vec3 x = lod_vec3_normalize(lod_vec3_subtract(clod->positions[polygon->ring[i]], centre));
    struct lod_vec3 y = lod_vec3_normalize(lod_vec3_subtract(clod->positions[polygon->ring[(i + 1) % polygon->size]], centre));
    angles[i] = fmax(1e-3, acos(fmin(1, fmax(-1, lod_vec3_dot(x, y)))));
    total += angles[i];
  }
  double scale = (polygon->open ? kPi : 2 * kPi) / total, at = 0;
  for (uint32_t i = 0; i < polygon->size; i++) {
    double radius = lod_vec3_distance(clod->positions[polygon->ring[i]], centre);
    if (!(radius > 0))
      return false;
    polygon->x[i][0] = radius * cos(at);
    polygon->x[i][1] = radius * sin(at);
    if (i < polygon->old_count) {
      if (angles[i] * scale > 0.97 * kPi && !(polygon->open && polygon->size == 2))
        return false;
      at += angles[i] * scale;
    }
  }
  if (polygon->open) { /* exactly on the line */
    polygon->x[0][1] = 0;
    polygon->x[polygon->size - 1][1] = 0;
  }
  return true;
}

static double turn(const double a[2], const double b[2], const double c[2]) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

static double square(const double a[2], const double b[2]) {
  return (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]);
}

/* 1 for an equilateral triangle, more for others, INFINITY for one that is turned over in the plane or has next to no area. */
static double triangle_cost(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, uint32_t j, uint32_t k) {
  const double *a = polygon->x[i], *b = polygon->x[j], *c = polygon->x[k];
  double area = turn(a, b, c), sides = square(a, b) + square(b, c) + square(c, a);
  if (!(area > 0.01 * sides))
    return INFINITY;
  struct lod_vec3 p = clod->positions[polygon->ring[i]], q = clod->positions[polygon->ring[j]], r = clod->positions[polygon->ring[k]];
  double x = lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(q, p), lod_vec3_subtract(r, p)));
  double lengths = lod_vec3_distance_squared(p, q) + lod_vec3_distance_squared(q, r) + lod_vec3_distance_squared(r, p);
  if (!(x > 0.005 * lengths))
    return INFINITY;
  return lengths / (2 * 1.7320508075688772 * x);
}

/* The half-edges that start at ring vertex i, both ways from one of them: take says when that is enough. */
typedef bool take_corner(void *context, const struct clod_patch *patch, uint32_t corner);
static void walk_around(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, take_corner *take, void *context) {
  uint32_t start = following_half(polygon->old[i < polygon->old_count ? i : i - 1]);
  if (i == polygon->old_count)
    start = previous_half(polygon->old[i - 1]);
  for (int way = 0; way < 2; way++) {
    uint32_t at = start, steps = 0;
    do {
      if (!take(context, &clod->patches[at / 3], at % 3))
        return;
      if (way == 0) {
        at = next_around(clod, at);
      } else {
        uint32_t across = clod_across(clod, at);
        at = across == LOD_NONE ? LOD_NONE : following_half(across);
      }
    } while (at != LOD_NONE && at != start && ++steps < 256);
    if (at == start)
      break;
  }
}

struct joined {
  uint32_t vertex;
  bool found;
};

static bool look_for(void *context, const struct clod_patch *patch, uint32_t corner) {
  struct joined *joined = context;
  joined->found =
      patch->corners[corner == 2 ? 0 : corner + 1] == joined->vertex || patch->corners[corner == 0 ? 2 : corner - 1] == joined->vertex;
  return !joined->found;
}

/* Whether an edge joins ring vertex i and another vertex. */
static bool is_joined(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, uint32_t vertex) {
  struct joined joined = {vertex, false};
  walk_around(clod, polygon, i, look_for, &joined);
  return joined.found;
}

struct forbidden {
  const struct lod_clod *clod;
  uint32_t i;
  bool (*allowed)[CLOD_RING];
};

static bool forbid(void *context, const struct clod_patch *patch, uint32_t corner) {
  struct forbidden *f = context;
  for (uint32_t k = 1; k < 3; k++) {
    uint32_t j = f->clod->ring_place[patch->corners[(corner + k) % 3]];
    if (j != 0)
      f->allowed[f->i][j - 1] = f->allowed[j - 1][f->i] = false;
  }
  return true;
}

/* allowed[i][j]: no edge joins ring vertices i and j. */
static void find_forbidden(const struct lod_clod *clod, const struct clod_polygon *polygon, bool allowed[CLOD_RING][CLOD_RING]) {
  memset(allowed, 1, sizeof(bool[CLOD_RING][CLOD_RING]));
  for (uint32_t i = 0; i < polygon->size; i++)
    clod->ring_place[polygon->ring[i]] = (uint8_t)(i + 1);
  for (uint32_t i = 0; i < polygon->size; i++) {
    struct forbidden f = {clod, i, allowed};
    walk_around(clod, polygon, i, forbid, &f);
  }
  for (uint32_t i = 0; i < polygon->size; i++)
    clod->ring_place[polygon->ring[i]] = 0;
}

static void add_triangles(struct clod_polygon *polygon, const uint8_t best[CLOD_RING][CLOD_RING], uint32_t i, uint32_t k) {
  if (k < i + 2)
    return;
  uint32_t j = best[i][k];
  uint32_t *t = polygon->triangles[polygon->triangle_count++];
  t[0] = i, t[1] = j, t[2] = k;
  add_triangles(polygon, best, i, j);
  add_triangles(polygon, best, j, k);
}

static bool is_outer(const struct clod_polygon *polygon, uint32_t i, uint32_t j) {
  return j == i + 1 || (!polygon->open && i == 0 && j == polygon->size - 1);
}

/* Names the sides of triangles, and the diagonals; i < j. */
static uint32_t side_name(struct clod_polygon *polygon, uint32_t i, uint32_t j) {
  if (i > j) {
    uint32_t swap = i;
    i = j;
    j = swap;
  }
  if (j == i + 1)
    return i;
  if (is_outer(polygon, i, j))
    return j;
  for (uint32_t d = 0; d < polygon->diagonal_count; d++)
    if (polygon->diagonals[d][0] == i && polygon->diagonals[d][1] == j)
      return CLOD_RING + d;
  polygon->diagonals[polygon->diagonal_count][0] = i;
  polygon->diagonals[polygon->diagonal_count][1] = j;
  return CLOD_RING + polygon->diagonal_count++;
}

/* An edge has to join ring vertices p and q, so that none may cross it. */
static void force(const struct clod_polygon *polygon, uint32_t p, uint32_t q, bool allowed[CLOD_RING][CLOD_RING]) {
  for (uint32_t i = 0; i < polygon->size; i++)
    for (uint32_t k = 0; k < polygon->size; k++) {
      bool i_in = i > p && i<q, k_in = k> p && k < q, i_out = i < p || i > q, k_out = k < p || k > q;
      if ((i_in && k_out) || (i_out && k_in))
        allowed[i][k] = false;
    }
}

uint32_t clod_ring_number(const struct clod_polygon *polygon, uint32_t vertex) {
  for (uint32_t i = 0; i < polygon->size; i++)
    if (polygon->ring[i] == vertex)
      return i;
  return LOD_NONE;
}

/* Least cost of what is allowed; best: the third corner. */
static double cheapest(const struct lod_clod *clod, const struct clod_polygon *polygon, const bool allowed[CLOD_RING][CLOD_RING],
                       uint8_t best[CLOD_RING][CLOD_RING]) {
  double cost[CLOD_RING][CLOD_RING];
  uint32_t n = polygon->size;
  for (uint32_t i = 0; i + 1 < n; i++)
    cost[i][i + 1] = 0;
  for (uint32_t length = 2; length < n; length++)
    for (uint32_t i = 0; i + length < n; i++) {
      uint32_t k = i + length;
      cost[i][k] = INFINITY;
      best[i][k] = (uint8_t)(i + 1);
      if (!is_outer(polygon, i, k) && !allowed[i][k])
        continue;
      for (uint32_t j = i + 1; j < k; j++) {
        double c = cost[i][j] + cost[j][k];
        if (c < cost[i][k])
          c += triangle_cost(clod, polygon, i, j, k);
        if (c < cost[i][k]) {
          cost[i][k] = c;
          best[i][k] = (uint8_t)j;
        }
      }
    }
  return cost[0][n - 1];
}

static void cut_up(struct clod_polygon *polygon, const uint8_t best[CLOD_RING][CLOD_RING]) {
  polygon->triangle_count = polygon->diagonal_count = 0;
  if (polygon->open)
    side_name(polygon, 0, polygon->size - 1);
  add_triangles(polygon, best, 0, polygon->size - 1);
  for (uint32_t t = 0; t < polygon->triangle_count; t++)
    for (uint32_t s = 0; s < 3; s++)
      polygon->sides[t][s] = side_name(polygon, polygon->triangles[t][s], polygon->triangles[t][(s + 1) % 3]);
}

/* First as if all diagonals were allowed: looking around every ring vertex costs more, and hardly any is not. */
static bool triangulate(const struct lod_clod *clod, struct clod_polygon *polygon, const uint32_t *pair) {
  bool allowed[CLOD_RING][CLOD_RING], good = pair == NULL;
  uint8_t best[CLOD_RING][CLOD_RING];
  if (pair == NULL) {
    memset(allowed, 1, sizeof allowed);
    if (!isfinite(cheapest(clod, polygon, (const bool(*)[CLOD_RING])allowed, best)))
      return false;
    cut_up(polygon, (const uint8_t(*)[CLOD_RING])best);
    for (uint32_t d = 0; d < polygon->diagonal_count && good; d++)
      good = !is_joined(clod, polygon, polygon->diagonals[d][0], polygon->ring[polygon->diagonals[d][1]]);
    if (good)
      return true;
  }
  find_forbidden(clod, polygon, allowed);
  if (pair != NULL) {
    uint32_t p = clod_ring_number(polygon, pair[0]), q = clod_ring_number(polygon, pair[1]);
    if (p == LOD_NONE || q == LOD_NONE || !allowed[p][q])
      return false;
    force(polygon, p < q ? p : q, p < q ? q : p, allowed);
  }
  if (!isfinite(cheapest(clod, polygon, (const bool(*)[CLOD_RING])allowed, best)))
    return false;
  cut_up(polygon, (const uint8_t(*)[CLOD_RING])best);
  return true;
}

/* A star of three whose outside is one patch would leave two patches back to back with the same three edges. */
static bool closes_up(const struct lod_clod *clod, const struct clod_polygon *polygon) {
  if (polygon->open || polygon->size != 3)
    return false;
  uint32_t outside[3];
  for (uint32_t i = 0; i < 3; i++)
    outside[i] = clod_across(clod, following_half(polygon->old[i]));
  return outside[0] != LOD_NONE && outside[1] != LOD_NONE && outside[0] / 3 == outside[1] / 3;
}

/* The line's edge from the vertex where the patches of its left side begin. */
static uint32_t line_start(const struct lod_clod *clod, uint32_t v, uint32_t skip) {
  uint32_t start = clod->half[v], at = start;
  do { /* as far clockwise as it goes */
    if ((edge_of(clod, at)->flags & CLOD_LINE) != 0 && at != skip)
      return at;
    uint32_t across = clod_across(clod, at);
    at = across == LOD_NONE ? LOD_NONE : following_half(across);
  } while (at != LOD_NONE && at != start);
  for (at = next_around(clod, start); at != LOD_NONE && at != start; at = next_around(clod, at))
    if ((edge_of(clod, at)->flags & CLOD_LINE) != 0 && at != skip)
      return at;
  return LOD_NONE;
}

static bool open_line(const struct lod_clod *clod, uint32_t v, struct clod_hole *hole) {
  hole->half_count = 0;
  uint32_t first = line_start(clod, v, LOD_NONE);
  if (first == LOD_NONE || !collect(clod, first, true, &hole->halves[hole->half_count++]))
    return false;
  const struct clod_polygon *left = &hole->halves[0];
  uint32_t begin = left->old[0], end = previous_half(left->old[left->old_count - 1]);
  hole->line_edges[0] = clod->patches[begin / 3].sides[begin % 3] >> 1;
  hole->line_edges[1] = clod->patches[end / 3].sides[end % 3] >> 1;
  if (hole->line_edges[0] == hole->line_edges[1])
    return false;
  const struct clod_edge *a = &clod->edges[hole->line_edges[0]], *b = &clod->edges[hole->line_edges[1]];
  if (a->flags != b->flags)
    return false; /* a boundary that becomes a crease has a corner there */
  double la = lod_vec3_distance(clod->positions[a->ends[0]], clod->positions[a->ends[1]]);
  double lb = lod_vec3_distance(clod->positions[b->ends[0]], clod->positions[b->ends[1]]);
  hole->line_t = la / (la + lb);
  uint32_t second = clod_across(clod, end);
  if (second == LOD_NONE)
    return clod_across(clod, begin) == LOD_NONE;
  return collect(clod, second, true, &hole->halves[hole->half_count++]) && hole->halves[1].ring[0] == left->ring[left->size - 1] &&
         hole->halves[1].ring[hole->halves[1].size - 1] == left->ring[0];
}

bool clod_hole_open(const struct lod_clod *clod, uint32_t v, const uint32_t *pair, struct clod_hole *hole) {
  hole->vertex = v;
  if (clod->removable[v] == 1) {
    hole->half_count = 1;
    if (!collect(clod, clod->half[v], false, &hole->halves[0]) || closes_up(clod, &hole->halves[0]))
      return false;
  } else if (clod->removable[v] != 2 || !open_line(clod, v, hole)) {
    return false;
  }
  for (uint32_t h = 0; h < hole->half_count; h++)
    if (!lay_out(clod, v, &hole->halves[h]) || !triangulate(clod, &hole->halves[h], pair))
      return false;
  return true;
}
