/* Merges by the inverse of de Casteljau's algorithm (Gopi & Manocha 1998, 4.2, 6.1, 6.2), and the paper's estimate of their error (10). */
#include <math.h>

#include "core/clod/internal.h"

static struct lod_bezier turned(const struct lod_bezier *net, uint32_t by) {
  struct lod_bezier out = *net;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t from = (k + by) % 3;
    out.p[k] = net->p[from];
    out.p[3 + 2 * k] = net->p[3 + 2 * from];
    out.p[4 + 2 * k] = net->p[4 + 2 * from];
  }
  return out;
}

/* Old patch i of a polygon with the vertex as its corner `place`; then ring vertices i and i + 1. */
static struct lod_bezier old_net(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, uint32_t place) {
  struct lod_bezier net = clod_net(clod, &clod->patches[polygon->old[i] / 3]);
  return turned(&net, (polygon->old[i] % 3 + 3 - place) % 3);
}

/* From ring vertex i to the vertex. */
static struct lod_bezier_curve spoke(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i) {
  bool last = i == polygon->old_count; /* the end of an open polygon */
  struct lod_bezier net = old_net(clod, polygon, last ? i - 1 : i, 0);
  struct lod_bezier_curve c = lod_bezier_edge(&net, last ? 2 : 0);
  return last ? c : (struct lod_bezier_curve){{c.p[3], c.p[2], c.p[1], c.p[0]}};
}

static struct lod_bezier_curve backwards(struct lod_bezier_curve c) {
  return (struct lod_bezier_curve){{c.p[3], c.p[2], c.p[1], c.p[0]}};
}

/* Where the edge from v to m is met by the line from a to b, all four projected to the plane of both lines' directions. */
static double crossing(struct lod_vec3 v, struct lod_vec3 m, struct lod_vec3 a, struct lod_vec3 b) {
  struct lod_vec3 along = lod_vec3_subtract(m, v), across = lod_vec3_subtract(b, a), n = lod_vec3_cross(along, across);
  double square = lod_vec3_length_squared(n);
  if (!(square > 0))
    return 0.5;
  double t = lod_vec3_dot(lod_vec3_cross(lod_vec3_subtract(a, v), across), n) / square;
  return fmin(0.9, fmax(0.1, t));
}

/* A swap of diagonals: both patches of the spoke to ring vertex m are split at one point of it, and the parts of their lines to the
 * neighbours i and j put together. */
static struct lod_bezier_curve swapped(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, uint32_t m,
                                       uint32_t j) {
  struct lod_bezier left = old_net(clod, polygon, i, 0), right = old_net(clod, polygon, m, 0);
  double t = crossing(left.p[0], left.p[2], left.p[1], right.p[2]);
  struct lod_barycentric in_left = {1 - t, 0, t}, in_right = {1 - t, t, 0}, second = {0, 1, 0}, third = {0, 0, 1};
  struct lod_bezier a = lod_bezier_restrict(&left, second, in_left, third), b = lod_bezier_restrict(&right, in_right, third, second);
  struct lod_bezier_curve first = lod_bezier_edge(&a, 0), last = lod_bezier_edge(&b, 0);
  (void)j;
  return lod_bezier_merge_curves(&first, &last, &t);
}

/* Diagonal d is what the two edges of the merge become. */
static bool is_merged(const struct clod_hole *hole, const struct clod_polygon *polygon, uint32_t d) {
  uint32_t a = polygon->ring[polygon->diagonals[d][0]], b = polygon->ring[polygon->diagonals[d][1]];
  return (polygon->open && d == 0) || (a == hole->pair[0] && b == hole->pair[1]) || (a == hole->pair[1] && b == hole->pair[0]);
}

void clod_inverse_diagonal(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t d, struct lod_vec3 inner[2]) {
  const struct clod_polygon *polygon = &hole->halves[h];
  uint32_t i = polygon->diagonals[d][0], j = polygon->diagonals[d][1], n = polygon->size;
  struct lod_bezier_curve curve;
  double t;
  if (is_merged(hole, polygon, d)) {
    struct lod_bezier_curve a = spoke(clod, polygon, i), b = backwards(spoke(clod, polygon, j));
    curve = lod_bezier_merge_curves(&a, &b, &t);
  } else if (j == i + 2) {
    curve = swapped(clod, polygon, i, i + 1, j);
  } else if (!polygon->open && i + n == j + 2) {
    curve = backwards(swapped(clod, polygon, j, (j + 1) % n, i));
  } else {
    return;
  }
  inner[0] = curve.p[1];
  inner[1] = curve.p[2];
}

/* The old patches that new triangle i is the inverse of: 2 of a T, 3 of a star, else 0. at: where the vertex lies in its domain. */
static uint32_t covered(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i, struct lod_bezier parts[3],
                        struct lod_bezier *merged, struct lod_barycentric *at) {
  const struct clod_polygon *polygon = &hole->halves[h];
  const uint32_t *c = polygon->triangles[i];
  uint32_t n = polygon->size;
  if (!polygon->open && n == 3) {
    parts[0] = old_net(clod, polygon, 1, 0);
    parts[1] = old_net(clod, polygon, 2, 1);
    parts[2] = old_net(clod, polygon, 0, 2);
    lod_bezier_merge_star(parts, merged, at);
    return 3;
  }
  /* Two sides of the triangle are the hole's own: corner k between them. */
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t a = c[k == 0 ? 2 : k - 1], m = c[k];
    if (polygon->sides[i][k == 0 ? 2 : k - 1] != a || polygon->sides[i][k] != m || polygon->sides[i][k == 2 ? 0 : k + 1] < CLOD_RING ||
        !is_merged(hole, polygon, polygon->sides[i][k == 2 ? 0 : k + 1] - CLOD_RING))
      continue;
    /* (a, m, b), the vertex on the side from b to a. */
    double t;
    parts[0] = old_net(clod, polygon, m, 1); /* (b, vertex, m) */
    parts[1] = old_net(clod, polygon, a, 0); /* (vertex, a, m) */
    struct lod_bezier pair = lod_bezier_merge_pair(&parts[0], &parts[1], &t);
    *merged = turned(&pair, (3 + 2 - k) % 3); /* as the triangle has it: its corner k is m, which the merge has third */
    double bary[3] = {0, 0, 0};
    bary[k == 2 ? 0 : k + 1] = 1 - t;
    bary[k == 0 ? 2 : k - 1] = t;
    *at = (struct lod_barycentric){bary[0], bary[1], bary[2]};
    /* Told as parts of the triangle: corner a replaced by the vertex, then corner b. */
    struct lod_bezier first = parts[0], second = parts[1];
    parts[0] = turned(&first, (3 + 2 - k) % 3);
    parts[1] = turned(&second, (3 + 2 - k) % 3);
    return 2;
  }
  return 0;
}

void clod_inverse_centre(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i, struct lod_bezier *net) {
  struct lod_bezier parts[3], merged;
  struct lod_barycentric at;
  if (covered(clod, hole, h, i, parts, &merged, &at) > 0)
    net->p[LOD_BEZIER_CENTRE] = merged.p[LOD_BEZIER_CENTRE];
}

double clod_estimate(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i) {
  static const double kWeights[3] = {1, 0.75, 0.5}; /* corners, edges, centre */
  const struct clod_polygon *polygon = &hole->halves[h];
  struct lod_bezier parts[3], merged, again[3];
  struct lod_barycentric at;
  double before = 0, most = 0;
  for (uint32_t s = 0; s < polygon->old_count; s++)
    before = fmax(before, clod->patches[polygon->old[s] / 3].estimate);
  uint32_t count = covered(clod, hole, h, i, parts, &merged, &at);
  if (count == 0)
    return before;
  lod_bezier_split(&hole->nets[h][i], at, again);
  for (uint32_t q = 0; q < count; q++) {
    /* Of a T the part whose corner is the vertex: found by which old patch shares the other two. */
    uint32_t same = q;
    if (count == 2) {
      double best = INFINITY;
      for (uint32_t k = 0; k < 3; k++) {
        double off = 0;
        for (int c = 0; c < 3; c++)
          off += lod_vec3_distance(again[k].p[c], parts[q].p[c]);
        if (off < best) {
          best = off;
          same = k;
        }
      }
    }
    for (int c = 0; c < LOD_BEZIER_POINTS; c++)
      most = fmax(most, kWeights[c < 3 ? 0 : c < 9 ? 1 : 2] * lod_vec3_distance(again[same].p[c], parts[q].p[c]));
  }
  return before + most;
}
