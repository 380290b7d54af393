/* Strictly smooth patches. See gregory.h. */
#include "core/clod/gregory.h"

#include <math.h>

/* Control point at 1 + i (i = 0..2) of edge k in the quartic. */
static uint32_t edge_point(uint32_t k, uint32_t i) {
  return 3 + 3 * k + i;
}

static void elevate(const struct lod_bezier *net, struct lod_gregory *g) {
  const struct lod_vec3 *p = net->p;
  for (uint32_t k = 0; k < 3; k++) {
    const struct lod_vec3 q[4] = {p[k], p[3 + 2 * k], p[4 + 2 * k], p[(k + 1) % 3]};
    g->boundary[k] = p[k];
    for (uint32_t i = 0; i < 3; i++)
      g->boundary[edge_point(k, i)] = lod_vec3_add(lod_vec3_scale(q[i], (i + 1) / 4.0), lod_vec3_scale(q[i + 1], (3 - i) / 4.0));
    /* 211 = (2 * 111 + 201 + 210) / 4 */
    struct lod_vec3 next = p[3 + 2 * k], last = p[4 + 2 * ((k + 2) % 3)];
    struct lod_vec3 sum = lod_vec3_add(lod_vec3_add(lod_vec3_scale(p[9], 2), next), last);
    g->inner[k][0] = g->inner[k][1] = lod_vec3_scale(sum, 0.25);
  }
}

/* Both inner points that edge k asks for, next to its first and its second corner. n: unit normals at its ends. False: it asks for nothing.
 */
static bool ask(const struct lod_bezier *net, const struct lod_gregory *g, uint32_t k, const struct lod_vec3 n[2], struct lod_vec3 out[2]) {
  uint32_t next = (k + 1) % 3, last = (k + 2) % 3;
  struct lod_bezier_curve curve = lod_bezier_edge(net, k);
  struct lod_vec3 w[3], a[3];
  for (int i = 0; i < 3; i++)
    w[i] = lod_vec3_subtract(curve.p[i + 1], curve.p[i]);
  for (int i = 0; i < 2; i++) {
    a[2 * i] = lod_vec3_normalize(lod_vec3_cross(n[i], w[2 * i]));
    if (!(lod_vec3_length_squared(a[2 * i]) > 0.5))
      return false;
  }
  a[1] = lod_vec3_add(a[0], a[2]);
  if (!(lod_vec3_length(a[1]) > 1e-3))
    return false; /* the planes turn over along the edge */
  a[1] = lod_vec3_normalize(a[1]);
  /* The quartic's boundary, and the cross-boundary derivative's first and last control vectors, which other edges fix. */
  struct lod_vec3 q[5] = {g->boundary[k], g->boundary[edge_point(k, 0)], g->boundary[edge_point(k, 1)], g->boundary[edge_point(k, 2)],
                          g->boundary[next]};
  struct lod_vec3 ends[2] = {g->boundary[edge_point(last, 2)], g->boundary[edge_point(next, 0)]}, d[2];
  double lambda[2], mu[2];
  for (int i = 0; i < 2; i++) {
    d[i] = lod_vec3_subtract(ends[i], lod_vec3_scale(lod_vec3_add(q[3 * i], q[3 * i + 1]), 0.5));
    lambda[i] = lod_vec3_dot(d[i], w[2 * i]) / lod_vec3_length_squared(w[2 * i]);
    mu[i] = lod_vec3_dot(d[i], a[2 * i]);
  }
  struct lod_vec3 d1 = lod_vec3_add(lod_vec3_scale(w[1], 2 * lambda[0]), lod_vec3_scale(w[0], lambda[1]));
  d1 = lod_vec3_add_scaled(lod_vec3_add_scaled(d1, a[1], 2 * mu[0]), a[0], mu[1]);
  struct lod_vec3 d2 = lod_vec3_add(lod_vec3_scale(w[2], lambda[0]), lod_vec3_scale(w[1], 2 * lambda[1]));
  d2 = lod_vec3_add_scaled(lod_vec3_add_scaled(d2, a[2], mu[0]), a[1], 2 * mu[1]);
  out[0] = lod_vec3_add_scaled(lod_vec3_scale(lod_vec3_add(q[1], q[2]), 0.5), d1, 1.0 / 3);
  out[1] = lod_vec3_add_scaled(lod_vec3_scale(lod_vec3_add(q[2], q[3]), 0.5), d2, 1.0 / 3);
  return true;
}

void lod_gregory_make(const struct lod_patches *patches, uint32_t patch, struct lod_gregory *g) {
  struct lod_bezier net = lod_patches_net(patches, patch);
  struct lod_vec3 plain[3];
  elevate(&net, g);
  for (uint32_t k = 0; k < 3; k++)
    plain[k] = g->inner[k][0];
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t from = patches->sectors[patch][k], to = patches->sectors[patch][(k + 1) % 3];
    if (patches->sharp[patches->edges[patch][k] >> 1] || from == LOD_NONE || to == LOD_NONE)
      continue;
    const struct lod_vec3 normals[2] = {patches->normals[from], patches->normals[to]};
    struct lod_vec3 asked[2];
    if (!ask(&net, g, k, normals, asked))
      continue;
    g->inner[k][0] = asked[0];
    g->inner[(k + 1) % 3][1] = asked[1];
  }
  double most = 0;
  for (uint32_t k = 0; k < 3; k++)
    for (int i = 0; i < 2; i++)
      most = fmax(most, lod_vec3_distance(g->inner[k][i], plain[k]));
  g->deviation = most * (4.0 / 9);
}

/* The direction of an edge that leaves a corner along `leg`, in the planes of the normals there (zero = none). */
static struct lod_vec3 turn_into_planes(struct lod_vec3 leg, const struct lod_vec3 n[2]) {
  struct lod_vec3 line = lod_vec3_cross(n[0], n[1]), turned = leg;
  bool has[2] = {lod_vec3_length_squared(n[0]) > 0.5, lod_vec3_length_squared(n[1]) > 0.5};
  if (has[0] && has[1] && lod_vec3_length(line) > 0.05) {
    line = lod_vec3_normalize(line);
    turned = lod_vec3_scale(line, lod_vec3_dot(line, leg));
  } else if (has[0] || has[1]) {
    struct lod_vec3 one = has[0] ? n[0] : n[1];
    turned = lod_vec3_add_scaled(leg, one, -lod_vec3_dot(one, leg));
  }
  /* As long as before; an edge that stands on its planes says nothing. */
  double before = lod_vec3_length(leg), after = lod_vec3_length(turned);
  return after > 0.2 * before ? lod_vec3_scale(turned, before / after) : leg;
}

static void turn_edges(const struct lod_patches *patches, struct lod_patches *result) {
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t side = patches->edges[p][k], e = side >> 1, other = patches->partners[p][k];
      if ((side & 1) != 0 && other != LOD_NONE)
        continue; /* once */
      for (uint32_t i = 0; i < 2; i++) {
        uint32_t mine = patches->sectors[p][(k + i) % 3],
                 theirs = other == LOD_NONE ? LOD_NONE : patches->sectors[other / 3][(other % 3 + 1 - i) % 3];
        struct lod_vec3 n[2] = {{0, 0, 0}, {0, 0, 0}};
        if (mine != LOD_NONE)
          n[0] = patches->normals[mine];
        if (theirs != LOD_NONE && theirs != mine)
          n[1] = patches->normals[theirs];
        uint32_t end = i ^ (side & 1);
        struct lod_vec3 corner = patches->positions[patches->ends[e][end]];
        result->inner[e][end] = lod_vec3_add(corner, turn_into_planes(lod_vec3_subtract(patches->inner[e][end], corner), n));
      }
    }
}

enum lod_status lod_patches_make_strict(const struct lod_patches *given, struct lod_arena *arena, struct lod_patches *result,
                                        double *deviation) {
  const struct lod_patches copy = *given, *patches = &copy; /* which may be the result */
  *result = *patches;
  result->inner = lod_arena_alloc(arena, patches->edge_count, sizeof *result->inner);
  result->centres = LOD_NEW(arena, patches->patch_count, struct lod_vec3);
  if (result->inner == NULL || result->centres == NULL)
    return LOD_MEMORY;
  turn_edges(patches, result);
  double most = 0;
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    /* Where edges go the centre goes: a quarter of the sum of six, as lod_bezier_set_centre weighs them. */
    struct lod_vec3 move = {0, 0, 0};
    result->centres[p] = patches->centres[p];
    struct lod_bezier old = lod_patches_net(patches, p), net = lod_patches_net(result, p);
    for (int i = 3; i < 9; i++)
      move = lod_vec3_add_scaled(move, lod_vec3_subtract(net.p[i], old.p[i]), 0.25);
    result->centres[p] = lod_vec3_add(old.p[9], move);
    net.p[9] = result->centres[p];
    double moved = 0;
    for (int i = 3; i < 10; i++) /* Bernstein polynomials other than the corners' add up to at most 8/9 */
      moved = fmax(moved, lod_vec3_distance(net.p[i], old.p[i]));
    struct lod_gregory gregory;
    lod_gregory_make(result, p, &gregory);
    most = fmax(most, 8.0 / 9 * moved + gregory.deviation);
  }
  if (deviation != NULL)
    *deviation = most;
  return LOD_OK;
}

/* Sum of value and of the derivatives by the three coordinates as if they were independent: along B - A it is by v less by u. */
struct sums {
  struct lod_vec3 value, by[3];
};

static void add(struct sums *s, struct lod_vec3 p, double value, const double by[3]) {
  s->value = lod_vec3_add_scaled(s->value, p, value);
  for (int k = 0; k < 3; k++)
    s->by[k] = lod_vec3_add_scaled(s->by[k], p, by[k]);
}

struct lod_vec3 lod_gregory_point(const struct lod_gregory *g, struct lod_barycentric at, struct lod_vec3 *normal) {
  const double x[3] = {at.u, at.v, at.w};
  struct sums s = {{0, 0, 0}, {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}};
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t n = (k + 1) % 3, l = (k + 2) % 3;
    double a = x[k], b = x[n], c = x[l], by[3] = {0, 0, 0};
    by[k] = 4 * a * a * a;
    add(&s, g->boundary[k], a * a * a * a, by);
    static const double kBinomial[3] = {4, 6, 4};
    const double pa[4] = {1, a, a * a, a * a * a}, pb[4] = {1, b, b * b, b * b * b};
    for (uint32_t i = 0; i < 3; i++) {
      by[k] = kBinomial[i] * (3 - i) * pa[2 - i] * pb[1 + i];
      by[n] = kBinomial[i] * (1 + i) * pa[3 - i] * pb[i];
      add(&s, g->boundary[edge_point(k, i)], kBinomial[i] * pa[3 - i] * pb[1 + i], by);
    }
    /* 12 a^2 b c times (b P + c Q) / (b + c): P where c = 0, on edge k; Q where b = 0, on the edge before. At corner k, where b + c = 0,
     * the product and its derivatives vanish. */
    double t = b + c;
    if (!(t > 0))
      continue;
    struct lod_vec3 p = g->inner[k][0], q = g->inner[k][1];
    struct lod_vec3 blend = lod_vec3_add(lod_vec3_scale(p, b / t), lod_vec3_scale(q, c / t)), apart = lod_vec3_subtract(p, q);
    double weight = 12 * a * a * b * c;
    by[k] = 24 * a * b * c;
    by[n] = 12 * a * a * c;
    by[l] = 12 * a * a * b;
    add(&s, blend, weight, by);
    s.by[n] = lod_vec3_add_scaled(s.by[n], apart, weight * c / (t * t));
    s.by[l] = lod_vec3_add_scaled(s.by[l], apart, -weight * b / (t * t));
  }
  if (normal != NULL) {
    struct lod_vec3 dv = lod_vec3_subtract(s.by[1], s.by[0]), dw = lod_vec3_subtract(s.by[2], s.by[0]), n = lod_vec3_cross(dv, dw);
    *normal = lod_vec3_length(n) > 1e-7 * (lod_vec3_length_squared(dv) + lod_vec3_length_squared(dw)) ? lod_vec3_normalize(n)
                                                                                                      : (struct lod_vec3){0, 0, 0};
  }
  return s.value;
}
