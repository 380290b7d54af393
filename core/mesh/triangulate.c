/* Ear cutting with hole bridging in an axis-parallel view, then flips.
 *
 * Based on: Meisters. Polygons have ears. 1975. Held. FIST: Fast Industrial-Strength Triangulation of Polygons. 2001 (corners at equal
 * places, relaxed ears as a last resort). Eberly. Triangulation by Ear Clipping. 2002 (bridges from a hole's extreme corner).
 * Differs: bridges end at the nearest corner that is visible, so that no ray hit has to be computed; all signs are exact.
 *
 * Why the result is right: cutting a corner keeps the sum of signed areas, every cut triangle's area is at least 0 by construction, so
 * when the last triangle's is too, the triangles cover each point of the view as often as the polygon winds around it, and none is
 * turned over. A crossing polygon winds negatively somewhere in some view, and that view is given up. */
#include "core/mesh/triangulate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/predicates.h"

/* Corner pairs looked at before a polygon counts as too intricate: about a second. A polygon of 100 000 corners needs a tenth. */
static const uint64_t kWorkLimit = 100 * 1000 * 1000;

/* Above this many nodes the triangles of least area (cubic in time, quadratic in memory) give way to any complete set. */
enum { LEAST_AREA_NODES = 128 };

/* A corner of the polygon that is left; a corner at the end of a bridge has two nodes. */
struct node {
  uint32_t corner;
  uint32_t prev, next;
  bool reflex; /* not strictly convex: only these can lie in an ear */
  bool gone;
};

struct grid {
  double min[2], per_cell[2];
  uint32_t cells; /* a side */
  uint32_t *start;
  uint32_t *items;
};

struct polygon {
  const float (*positions)[3];
  const uint32_t *loops;
  const uint32_t *loop_sizes;
  uint32_t loop_count;
  uint32_t corner_count;
  double (*uv)[2]; /* per corner, in the current view */
  struct node *nodes;
  uint32_t node_count; /* of the ring that all loops have become */
  uint32_t node_capacity;
  struct grid grid;
  uint64_t work;
  uint32_t (*triangles)[3];
  uint32_t triangle_count;
};

static struct lod_vec3 point3(const struct polygon *g, uint32_t corner) {
  return lod_vec3_from_float(g->positions[g->loops[corner]]);
}

static const double *point2(const struct polygon *g, uint32_t node) {
  return g->uv[g->nodes[node].corner];
}

static bool same(const double a[2], const double b[2]) {
  return a[0] == b[0] && a[1] == b[1];
}

/* Twice the area vector of corners [first, first + count), relative to its first corner against cancellation. */
static struct lod_vec3 newell_normal(const struct polygon *g, uint32_t first, uint32_t count) {
  struct lod_vec3 origin = point3(g, first), sum = {0, 0, 0}, last = {0, 0, 0};
  for (uint32_t i = 1; i < count; i++) {
    struct lod_vec3 p = lod_vec3_subtract(point3(g, first + i), origin);
    sum = lod_vec3_add(sum, lod_vec3_cross(last, p));
    last = p;
  }
  return sum;
}

/* Drops `axis`; a polygon whose normal points down that axis is mirrored, so that it turns counter-clockwise. */
static void view_corners(const float (*positions)[3], const uint32_t *loops, uint32_t count, int axis, bool mirror, double (*uv)[2]) {
  int u = (axis + 1) % 3, v = (axis + 2) % 3;
  for (uint32_t i = 0; i < count; i++) {
    uv[i][mirror] = (double)positions[loops[i]][u];
    uv[i][!mirror] = (double)positions[loops[i]][v];
  }
}

/* Axes by the size of the normal's component, largest first; returns how many are not zero. */
static int order_axes(struct lod_vec3 normal, int axes[3]) {
  const double size[3] = {fabs(normal.x), fabs(normal.y), fabs(normal.z)};
  int count = 0;
  for (int k = 0; k < 3; k++) {
    if (!(size[k] > 0))
      continue;
    int at = count++;
    for (; at > 0 && size[axes[at - 1]] < size[k]; at--)
      axes[at] = axes[at - 1];
    axes[at] = k;
  }
  return count;
}

static bool points_down(struct lod_vec3 normal, int axis) {
  return (axis == 0 ? normal.x : axis == 1 ? normal.y : normal.z) < 0;
}

static bool is_collinear(const struct polygon *g) {
  double uv[3][2];
  uint32_t far = 0;
  double most = 0;
  for (uint32_t i = 1; i < g->corner_count; i++) {
    double d = lod_vec3_distance_squared(point3(g, 0), point3(g, i));
    if (d > most) {
      most = d;
      far = i;
    }
  }
  for (uint32_t i = 1; far != 0 && i < g->corner_count; i++)
    for (int axis = 0; axis < 3; axis++) {
      const uint32_t three[3] = {g->loops[0], g->loops[far], g->loops[i]};
      view_corners(g->positions, three, 3, axis, false, uv);
      if (lod_orient2d(uv[0], uv[1], uv[2]) != 0)
        return false;
    }
  return true;
}

/* --- the ring --- */

/* Links the corners of one loop; `reverse` walks it backwards. Returns its first node. */
static uint32_t add_loop(struct polygon *g, uint32_t first, uint32_t count, bool reverse) {
  uint32_t base = g->node_count;
  for (uint32_t i = 0; i < count; i++) {
    struct node *node = &g->nodes[base + i];
    *node = (struct node){.corner = first + (reverse ? count - 1 - i : i)};
    node->prev = base + (i == 0 ? count - 1 : i - 1);
    node->next = base + (i + 1 == count ? 0 : i + 1);
  }
  g->node_count += count;
  return base;
}

/* Joins the loop of node m into the ring at node p by a bridge walked both ways. */
static void add_bridge(struct polygon *g, uint32_t p, uint32_t m) {
  struct node *nodes = g->nodes;
  uint32_t m2 = g->node_count++, p2 = g->node_count++;
  nodes[m2] = (struct node){.corner = nodes[m].corner, .prev = nodes[m].prev, .next = p2};
  nodes[p2] = (struct node){.corner = nodes[p].corner, .prev = m2, .next = nodes[p].next};
  nodes[nodes[m].prev].next = m2; /* of a loop of one corner this is m itself: the bridge goes m, m2 */
  nodes[nodes[p].next].prev = p2;
  nodes[p].next = m;
  nodes[m].prev = p;
}

static bool lexicographically_less(const double a[2], const double b[2]) {
  return a[0] < b[0] || (a[0] == b[0] && a[1] < b[1]);
}

/* Whether the segment from node p towards `target` starts inside the polygon's angle at p. strict: not along an edge. */
static bool in_cone(const struct polygon *g, uint32_t p, const double target[2], bool strict) {
  const double *a = point2(g, g->nodes[p].prev), *b = point2(g, p), *c = point2(g, g->nodes[p].next);
  int turn = lod_orient2d(a, b, c), left_in = lod_orient2d(a, b, target), left_out = lod_orient2d(b, c, target);
  int least = strict ? 1 : 0;
  if (turn > 0)
    return left_in >= least && left_out >= least;
  if (turn < 0)
    return left_in >= least || left_out >= least;
  /* Straight on, or the tip of a slit, around which everything is inside. */
  bool slit = (a[0] - b[0]) * (c[0] - b[0]) + (a[1] - b[1]) * (c[1] - b[1]) > 0;
  return slit || left_in >= least;
}

/* No edge of the ring crosses the open segment p-m and no corner lies on it. m comes before every p in lexicographic order. */
static bool is_visible(struct polygon *g, uint32_t ring, const double m[2], const double p[2]) {
  double low = fmin(m[1], p[1]), high = fmax(m[1], p[1]);
  uint32_t at = ring;
  do {
    const double *a = point2(g, at), *b = point2(g, g->nodes[at].next);
    at = g->nodes[at].next;
    g->work++;
    if (fmax(a[0], b[0]) < m[0] || fmin(a[0], b[0]) > p[0] || fmax(a[1], b[1]) < low || fmin(a[1], b[1]) > high)
      continue;
    int side_a = lod_orient2d(m, p, a), side_b = lod_orient2d(m, p, b);
    if (side_a == 0 && lexicographically_less(m, a) && lexicographically_less(a, p))
      return false;
    if (side_a * side_b < 0 && lod_orient2d(a, b, m) * lod_orient2d(a, b, p) < 0)
      return false;
  } while (at != ring);
  return true;
}

/* The ring's node nearest to m that a bridge may end at; LOD_NONE when there is none (the hole is not inside, or crosses). */
static uint32_t find_bridge(struct polygon *g, uint32_t ring, uint32_t m_node, bool strict) {
  const double *m = point2(g, m_node), *beyond = point2(g, g->nodes[m_node].next);
  double tried = -1;
  uint32_t tried_node = 0;
  while (g->work < kWorkLimit) {
    double best = INFINITY;
    uint32_t p = LOD_NONE, at = ring;
    do {
      const double *q = point2(g, at);
      double dx = q[0] - m[0], dy = q[1] - m[1], d = dx * dx + dy * dy;
      bool untried = d > tried || (d == tried && at > tried_node);
      if (untried && (d < best || (d == best && at < p)) && !lexicographically_less(q, m)) {
        best = d;
        p = at;
      }
      g->work++;
      at = g->nodes[at].next;
    } while (at != ring);
    if (p == LOD_NONE)
      return LOD_NONE;
    const double *q = point2(g, p);
    if (same(m, q) ? in_cone(g, p, beyond, strict) : in_cone(g, p, m, strict) && is_visible(g, ring, m, q))
      return p;
    tried = best;
    tried_node = p;
  }
  return LOD_NONE;
}

static double signed_area(const struct polygon *g, uint32_t first, uint32_t count) {
  double sum = 0;
  const double *o = g->uv[first];
  for (uint32_t i = 1; i + 1 < count; i++) {
    const double *a = g->uv[first + i], *b = g->uv[first + i + 1];
    sum += (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
  }
  return sum;
}

struct hole {
  double extreme[2]; /* its lexicographically largest corner */
  uint32_t node;
};

static int compare_holes(const void *left, const void *right) {
  const struct hole *a = left, *b = right;
  if (!same(a->extreme, b->extreme))
    return lexicographically_less(a->extreme, b->extreme) ? 1 : -1;
  return a->node < b->node ? -1 : 1;
}

/* Makes one ring of all loops. Holes join from the right: whatever lies right of a hole's extreme corner belongs to the ring already.
 * force: a hole that cannot be bridged is joined anyhow (the triangles will overlap). */
static bool join_loops(struct polygon *g, struct hole *holes, bool force) {
  g->node_count = 0;
  uint32_t ring = add_loop(g, 0, g->loop_sizes[0], false), first = g->loop_sizes[0];
  for (uint32_t h = 1; h < g->loop_count; first += g->loop_sizes[h++]) {
    uint32_t base = add_loop(g, first, g->loop_sizes[h], signed_area(g, first, g->loop_sizes[h]) > 0), best = base;
    for (uint32_t i = 1; i < g->loop_sizes[h]; i++)
      if (lexicographically_less(point2(g, best), point2(g, base + i)))
        best = base + i;
    holes[h - 1].node = best;
    memcpy(holes[h - 1].extreme, point2(g, best), sizeof holes->extreme);
  }
  qsort(holes, g->loop_count - 1, sizeof *holes, compare_holes);
  for (uint32_t h = 0; h + 1 < g->loop_count; h++) {
    uint32_t p = force ? ring : find_bridge(g, ring, holes[h].node, true);
    if (p == LOD_NONE)
      p = find_bridge(g, ring, holes[h].node, false);
    if (p == LOD_NONE)
      return false;
    add_bridge(g, p, holes[h].node);
  }
  return true;
}

/* --- ears --- */

static uint32_t cell_of(const struct grid *grid, double x, int k) {
  double c = (x - grid->min[k]) * grid->per_cell[k];
  return c > 0 ? c < grid->cells ? (uint32_t)c : grid->cells - 1 : 0;
}

/* Reflex nodes by place. Only they can block an ear, and cutting never makes a node reflex. */
static bool build_grid(struct polygon *g, struct lod_arena *scratch) {
  struct grid *grid = &g->grid;
  double max[2] = {-INFINITY, -INFINITY};
  uint32_t reflex = 0;
  grid->min[0] = grid->min[1] = INFINITY;
  for (uint32_t i = 0; i < g->node_count; i++) {
    reflex += g->nodes[i].reflex;
    for (int k = 0; k < 2; k++) {
      grid->min[k] = fmin(grid->min[k], point2(g, i)[k]);
      max[k] = fmax(max[k], point2(g, i)[k]);
    }
  }
  grid->cells = reflex < 16 ? 1 : (uint32_t)fmin(1024, sqrt((double)reflex));
  for (int k = 0; k < 2; k++)
    grid->per_cell[k] = max[k] > grid->min[k] ? grid->cells / (max[k] - grid->min[k]) : 0;
  size_t count = (size_t)grid->cells * grid->cells;
  grid->start = LOD_NEW_ZERO(scratch, count + 1, uint32_t);
  grid->items = LOD_NEW(scratch, reflex, uint32_t);
  if (grid->start == NULL || grid->items == NULL)
    return false;
  for (int pass = 0; pass < 2; pass++) { /* counting sort: count, then place from the back so that order is kept */
    for (uint32_t i = g->node_count; i-- > 0;) {
      if (!g->nodes[i].reflex)
        continue;
      uint32_t *start = &grid->start[(size_t)cell_of(grid, point2(g, i)[1], 1) * grid->cells + cell_of(grid, point2(g, i)[0], 0)];
      if (pass == 0)
        ++*start;
      else
        grid->items[--*start] = i;
    }
    for (size_t c = 1; pass == 0 && c <= count; c++)
      grid->start[c] += grid->start[c - 1];
  }
  return true;
}

/* How much an ear is allowed to touch. Relaxed ears occur where the polygon touches itself. */
enum level { STRICT, RELAXED, FLAT, GIVE_UP };

static bool blocks(const double *a, const double *b, const double *c, const double *w, enum level level) {
  if (same(w, a) || same(w, b) || same(w, c))
    return false;
  int ab = lod_orient2d(a, b, w), bc = lod_orient2d(b, c, w), ca = lod_orient2d(c, a, w);
  int least = level == STRICT ? 0 : 1; /* relaxed: only what lies inside or on the cut c-a itself */
  return ab >= least && bc >= least && ca >= 0;
}

static bool is_blocked(struct polygon *g, const double *a, const double *b, const double *c, enum level level) {
  const struct grid *grid = &g->grid;
  double min[2], max[2];
  for (int k = 0; k < 2; k++) {
    min[k] = fmin(a[k], fmin(b[k], c[k]));
    max[k] = fmax(a[k], fmax(b[k], c[k]));
  }
  uint32_t x0 = cell_of(grid, min[0], 0), x1 = cell_of(grid, max[0], 0), y0 = cell_of(grid, min[1], 1), y1 = cell_of(grid, max[1], 1);
  for (uint32_t y = y0; y <= y1; y++) {
    size_t row = (size_t)y * grid->cells;
    g->work += x1 - x0 + 1 + grid->start[row + x1 + 1] - grid->start[row + x0];
    for (uint32_t i = grid->start[row + x0]; i < grid->start[row + x1 + 1]; i++) {
      const struct node *node = &g->nodes[grid->items[i]];
      const double *w = g->uv[node->corner];
      if (node->reflex && !node->gone && w[0] >= min[0] && w[0] <= max[0] && w[1] >= min[1] && w[1] <= max[1] && blocks(a, b, c, w, level))
        return true;
    }
  }
  return false;
}

static void emit(struct polygon *g, uint32_t a, uint32_t b, uint32_t c) {
  uint32_t *triangle = g->triangles[g->triangle_count++];
  triangle[0] = g->nodes[a].corner;
  triangle[1] = g->nodes[b].corner;
  triangle[2] = g->nodes[c].corner;
}

static bool is_ear(struct polygon *g, uint32_t node, enum level level) {
  const double *a = point2(g, g->nodes[node].prev), *b = point2(g, node), *c = point2(g, g->nodes[node].next);
  if (same(a, b) || same(b, c))
    return true;
  int turn = lod_orient2d(a, b, c);
  return turn > 0 ? !is_blocked(g, a, b, c, level) : turn == 0 && level == FLAT;
}

static void update_reflex(struct polygon *g, uint32_t node) {
  struct node *n = &g->nodes[node];
  n->reflex = lod_orient2d(point2(g, n->prev), point2(g, node), point2(g, n->next)) <= 0;
}

/* Cuts the ring into triangles; false when the view does not allow it. */
static bool cut_ears(struct polygon *g) {
  uint32_t left = g->node_count, node = 0, tried = 0;
  enum level level = STRICT;
  g->triangle_count = 0;
  while (left > 3) {
    if (is_ear(g, node, level)) {
      uint32_t prev = g->nodes[node].prev, next = g->nodes[node].next;
      emit(g, prev, node, next);
      g->nodes[node].gone = true;
      g->nodes[prev].next = next;
      g->nodes[next].prev = prev;
      update_reflex(g, prev);
      update_reflex(g, next);
      left--;
      node = g->nodes[next].next; /* not next itself: that would spin a fan of slivers */
      tried = 0;
      level = STRICT;
      continue;
    }
    node = g->nodes[node].next;
    if (++tried == left) {
      tried = 0;
      level++;
    }
    if (level == GIVE_UP || g->work > kWorkLimit)
      return false;
  }
  uint32_t prev = g->nodes[node].prev, next = g->nodes[node].next;
  emit(g, prev, node, next);
  return lod_orient2d(point2(g, prev), point2(g, node), point2(g, next)) >= 0;
}

/* --- flips --- */

/* Cotangent of the angle at `apex`, in space. */
static double cotangent(const struct polygon *g, uint32_t apex, uint32_t a, uint32_t b) {
  struct lod_vec3 u = lod_vec3_subtract(point3(g, a), point3(g, apex)), v = lod_vec3_subtract(point3(g, b), point3(g, apex));
  return lod_vec3_dot(u, v) / lod_vec3_length(lod_vec3_cross(u, v));
}

/* Opposite angles over 180 degrees together. The slack keeps ties, such as a square's, and rounding from flipping for ever. */
static bool should_flip(const struct polygon *g, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
  return cotangent(g, c, a, b) + cotangent(g, d, a, b) < -1e-9;
}

struct side {
  uint64_t key;
  uint32_t half_edge;
};

static int compare_sides(const void *left, const void *right) {
  const struct side *a = left, *b = right;
  if (a->key != b->key)
    return a->key < b->key ? -1 : 1;
  return a->half_edge < b->half_edge ? -1 : 1;
}

/* twin[3 * t + k]: the half-edge on the other side of corner k -> k + 1 of triangle t; LOD_NONE on the polygon's own edges. */
static uint32_t *find_twins(const struct polygon *g, struct lod_arena *scratch) {
  uint32_t count = 3 * g->triangle_count;
  uint32_t *twin = LOD_NEW(scratch, count, uint32_t);
  struct side *sides = LOD_NEW(scratch, count, struct side);
  if (twin == NULL || sides == NULL)
    return NULL;
  for (uint32_t h = 0; h < count; h++) {
    uint32_t a = g->triangles[h / 3][h % 3], b = g->triangles[h / 3][(h + 1) % 3];
    sides[h] = (struct side){a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a, h};
    twin[h] = LOD_NONE;
  }
  qsort(sides, count, sizeof *sides, compare_sides);
  for (uint32_t i = 0; i < count;) {
    uint32_t end = i + 1;
    while (end < count && sides[end].key == sides[i].key)
      end++;
    uint32_t s = sides[i].half_edge, t = sides[end - 1].half_edge;
    if (end == i + 2 && g->triangles[s / 3][s % 3] != g->triangles[t / 3][t % 3]) {
      twin[s] = t;
      twin[t] = s;
    }
    i = end;
  }
  return twin;
}

static void link_twins(uint32_t *twin, uint32_t a, uint32_t b) {
  twin[a] = b;
  if (b != LOD_NONE)
    twin[b] = a;
}

/* Flips the edge of half-edge h when both new triangles are proper in the view and better in space. */
static bool try_flip(struct polygon *g, uint32_t *twin, uint32_t h) {
  uint32_t o = twin[h];
  if (o == LOD_NONE || o < h)
    return false;
  uint32_t t = h / 3, u = o / 3, i = h % 3, j = o % 3;
  uint32_t a = g->triangles[t][i], b = g->triangles[t][(i + 1) % 3], c = g->triangles[t][(i + 2) % 3], d = g->triangles[u][(j + 2) % 3];
  if (!should_flip(g, a, b, c, d) || lod_orient2d(g->uv[a], g->uv[d], g->uv[c]) <= 0 || lod_orient2d(g->uv[d], g->uv[b], g->uv[c]) <= 0)
    return false;
  uint32_t bc = twin[3 * t + (i + 1) % 3], ca = twin[3 * t + (i + 2) % 3], ad = twin[3 * u + (j + 1) % 3], db = twin[3 * u + (j + 2) % 3];
  const uint32_t first[3] = {a, d, c}, second[3] = {d, b, c};
  memcpy(g->triangles[t], first, sizeof first);
  memcpy(g->triangles[u], second, sizeof second);
  link_twins(twin, 3 * t, ad);
  link_twins(twin, 3 * t + 1, 3 * u + 2);
  link_twins(twin, 3 * t + 2, ca);
  link_twins(twin, 3 * u, db);
  link_twins(twin, 3 * u + 1, bc);
  return true;
}

static bool flip_to_delaunay(struct polygon *g, struct lod_arena *scratch) {
  uint32_t *twin = find_twins(g, scratch);
  if (twin == NULL)
    return false;
  uint64_t flips_left = 64 * (uint64_t)g->triangle_count; /* any moment is a valid end */
  for (int passes = 64; passes > 0; passes--) {
    uint64_t before = flips_left;
    for (uint32_t h = 0; h < 3 * g->triangle_count && flips_left > 0; h++)
      flips_left -= try_flip(g, twin, h);
    if (flips_left == before || flips_left == 0)
      break;
  }
  return true;
}

/* --- what crosses itself --- */

/* Triangles of least total area in space, by dynamic programming over the ring (Klincsek. Minimal triangulations of polygonal domains.
 * 1980). */
static bool cut_least_area(struct polygon *g, const uint32_t *ring, struct lod_arena *scratch) {
  uint32_t n = g->node_count;
  double *cost = LOD_NEW_ZERO(scratch, (size_t)n * n, double);
  uint32_t *choice = LOD_NEW_ZERO(scratch, (size_t)n * n, uint32_t);
  uint32_t(*stack)[2] = lod_arena_alloc(scratch, n, sizeof *stack);
  if (cost == NULL || choice == NULL || stack == NULL)
    return false;
  for (uint32_t span = 2; span < n; span++)
    for (uint32_t i = 0; i + span < n; i++) {
      uint32_t j = i + span;
      struct lod_vec3 a = point3(g, ring[i]), c = point3(g, ring[j]);
      double best = INFINITY;
      for (uint32_t k = i + 1; k < j; k++) {
        struct lod_vec3 b = point3(g, ring[k]);
        double area = lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
        double total = cost[(size_t)i * n + k] + cost[(size_t)k * n + j] + area;
        if (total < best || k == i + 1) {
          best = total;
          choice[(size_t)i * n + j] = k;
        }
      }
      cost[(size_t)i * n + j] = best;
    }
  uint32_t depth = 0;
  stack[depth][0] = 0;
  stack[depth++][1] = n - 1;
  while (depth > 0) {
    uint32_t i = stack[--depth][0], j = stack[depth][1];
    if (j - i < 2)
      continue;
    uint32_t k = choice[(size_t)i * n + j];
    const uint32_t triangle[3] = {ring[i], ring[k], ring[j]};
    memcpy(g->triangles[g->triangle_count++], triangle, sizeof triangle);
    stack[depth][0] = i;
    stack[depth++][1] = k;
    stack[depth][0] = k;
    stack[depth++][1] = j;
  }
  return true;
}

/* Cuts every second corner, again and again: complete, in linear time, whatever the shape. */
static void cut_every_second(struct polygon *g, uint32_t *ring) {
  for (uint32_t n = g->node_count, kept; n > 2; n = kept) {
    kept = 0;
    for (uint32_t i = 0; i < n; i += 2) {
      ring[kept++] = ring[i]; /* ring[0] stays itself */
      if (i + 1 == n)
        break;
      const uint32_t triangle[3] = {ring[i], ring[i + 1], i + 2 < n ? ring[i + 2] : ring[0]};
      memcpy(g->triangles[g->triangle_count++], triangle, sizeof triangle);
    }
  }
}

static bool cut_anyhow(struct polygon *g, struct hole *holes, struct lod_arena *scratch) {
  (void)join_loops(g, holes, true);
  uint32_t *ring = LOD_NEW(scratch, g->node_count, uint32_t);
  if (ring == NULL)
    return false;
  uint32_t node = 0;
  for (uint32_t i = 0; i < g->node_count; i++, node = g->nodes[node].next)
    ring[i] = g->nodes[node].corner;
  g->triangle_count = 0;
  if (g->node_count <= LEAST_AREA_NODES)
    return cut_least_area(g, ring, scratch);
  cut_every_second(g, ring);
  return true;
}

/* --- drivers --- */

/* A quad without scratch memory; false when neither diagonal gives two triangles that look the right way in the best view. */
static bool cut_quad(struct polygon *g) {
  double uv[4][2];
  int axes[3];
  struct lod_vec3 normal = newell_normal(g, 0, 4);
  if (order_axes(normal, axes) == 0)
    return false;
  view_corners(g->positions, g->loops, 4, axes[0], points_down(normal, axes[0]), uv);
  int turn[4];
  for (int i = 0; i < 4; i++)
    turn[i] = lod_orient2d(uv[(i + 3) % 4], uv[i], uv[(i + 1) % 4]);
  for (int least = 1; least >= 0; least--) { /* a triangle without area only where it cannot be helped */
    bool even = turn[1] >= least && turn[3] >= least, odd = turn[0] >= least && turn[2] >= least;
    if (!even && !odd)
      continue;
    uint32_t s = even && (!odd || !should_flip(g, 0, 2, 1, 3)) ? 0 : 1;
    const uint32_t triangles[2][3] = {{s, s + 1, s + 2}, {s, s + 2, (s + 3) % 4}};
    memcpy(g->triangles, triangles, sizeof triangles);
    return true;
  }
  return false;
}

static enum lod_status cut_polygon(struct polygon *g, struct lod_arena *scratch, uint32_t *flags) {
  g->node_capacity = g->corner_count + 2 * (g->loop_count - 1);
  g->uv = lod_arena_alloc(scratch, g->corner_count, sizeof *g->uv);
  g->nodes = LOD_NEW(scratch, g->node_capacity, struct node);
  struct hole *holes = LOD_NEW(scratch, g->loop_count, struct hole);
  if (g->uv == NULL || g->nodes == NULL || holes == NULL)
    return LOD_MEMORY;
  struct lod_vec3 normal = newell_normal(g, 0, g->loop_sizes[0]);
  int axes[3], axis_count = order_axes(normal, axes);
  bool collinear = is_collinear(g);
  for (int i = 0; i < axis_count && !collinear; i++) {
    view_corners(g->positions, g->loops, g->corner_count, axes[i], points_down(normal, axes[i]), g->uv);
    if (!join_loops(g, holes, false))
      continue;
    for (uint32_t n = 0; n < g->node_count; n++)
      update_reflex(g, n);
    if (!build_grid(g, scratch))
      return LOD_MEMORY;
    if (cut_ears(g))
      return flip_to_delaunay(g, scratch) ? LOD_OK : LOD_MEMORY;
  }
  *flags |= collinear ? LOD_TRIANGULATE_DEGENERATE : LOD_TRIANGULATE_CROSSED;
  view_corners(g->positions, g->loops, g->corner_count, axis_count > 0 ? axes[0] : 0, false, g->uv);
  return cut_anyhow(g, holes, scratch) ? LOD_OK : LOD_MEMORY;
}

enum lod_status lod_triangulate_polygon(const float (*positions)[3], const uint32_t *loops, const uint32_t *loop_sizes, uint32_t loop_count,
                                        struct lod_arena *arena, uint32_t (*triangles)[3], uint32_t *flags) {
  uint32_t ignored;
  flags = flags != NULL ? flags : &ignored;
  *flags = 0;
  size_t count = lod_triangulate_count(loop_sizes, loop_count);
  if (count == 0)
    return LOD_OK;
  if (count > UINT32_MAX / 4)
    return LOD_MEMORY;
  struct polygon g = {.positions = positions, .loops = loops, .loop_sizes = loop_sizes, .loop_count = loop_count, .triangles = triangles};
  for (uint32_t i = 0; i < loop_count; i++)
    g.corner_count += loop_sizes[i];
  if (count == 1) {
    for (uint32_t i = 0; i < 3; i++)
      triangles[0][i] = i;
    *flags = is_collinear(&g) ? LOD_TRIANGULATE_DEGENERATE : 0;
    return LOD_OK;
  }
  if (count == 2 && loop_count == 1 && cut_quad(&g)) {
    *flags = is_collinear(&g) ? LOD_TRIANGULATE_DEGENERATE : 0;
    return LOD_OK;
  }
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  enum lod_status status = cut_polygon(&g, scratch, flags);
  lod_arena_destroy(scratch);
  return status;
}
