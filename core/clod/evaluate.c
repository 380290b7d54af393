/* Many points at once. See evaluate.h. */
#include "core/clod/evaluate.h"

#include <math.h>
#include <string.h>

static lod_lanes splat(double x) {
  float f = (float)x;
  return (lod_lanes){f, f, f, f};
}

static void splat3(lod_lanes out[3], struct lod_vec3 v, double scale) {
  out[0] = splat(scale * v.x);
  out[1] = splat(scale * v.y);
  out[2] = splat(scale * v.z);
}

/* 9 products, each of two rounded numbers, and 8 sums; weights add up to at most 1. */
double lod_evaluator_rounding(const struct lod_bezier *net) {
  double extent = 0;
  for (int i = 1; i < LOD_BEZIER_POINTS; i++) {
    struct lod_vec3 d = lod_vec3_subtract(net->p[i], net->p[0]);
    extent = fmax(extent, fabs(d.x) + fabs(d.y) + fabs(d.z));
  }
  return 24 * 0x1p-24 * extent;
}

void lod_evaluator_init(struct lod_evaluator *e, const struct lod_bezier *net) {
  /* Control points of the derivatives along B - A and C - A: quadratic point i less another of the cubic. */
  static const uint8_t kFrom[6] = {0, 4, 7, 3, 9, 8}, kV[6] = {3, 1, 6, 4, 5, 9}, kW[6] = {8, 5, 2, 9, 6, 7};
  const struct lod_vec3 *p = net->p;
  e->corner = p[0];
  for (int i = 0; i < 9; i++)
    splat3(e->point[i], lod_vec3_subtract(p[i + 1], p[0]), 1);
  for (int i = 0; i < 6; i++) {
    splat3(e->dv[i], lod_vec3_subtract(p[kV[i]], p[kFrom[i]]), 3);
    splat3(e->dw[i], lod_vec3_subtract(p[kW[i]], p[kFrom[i]]), 3);
  }
  e->rounding = lod_evaluator_rounding(net);
}

static void sum_lanes(lod_lanes out[3], const lod_lanes (*points)[3], const lod_lanes *basis, int count) {
  for (int axis = 0; axis < 3; axis++)
    out[axis] = points[0][axis] * basis[0];
  for (int i = 1; i < count; i++)
    for (int axis = 0; axis < 3; axis++)
      out[axis] += points[i][axis] * basis[i];
}

void lod_evaluate_grid(const struct lod_evaluator *e, const struct lod_grid_basis *grid, uint32_t count, float (*positions)[3],
                       float (*normals)[3]) {
  for (uint32_t block = 0; 4 * block < count; block++) {
    uint32_t here = count - 4 * block < 4 ? count - 4 * block : 4;
    lod_lanes p[3];
    sum_lanes(p, e->point, grid->cubic[block], 9);
    for (uint32_t i = 0; i < here; i++) {
      float *out = positions[4 * block + i];
      out[0] = (float)(e->corner.x + (double)p[0][i]);
      out[1] = (float)(e->corner.y + (double)p[1][i]);
      out[2] = (float)(e->corner.z + (double)p[2][i]);
    }
    if (normals == NULL)
      continue;
    lod_lanes a[3], b[3];
    sum_lanes(a, e->dv, grid->quadratic[block], 6);
    sum_lanes(b, e->dw, grid->quadratic[block], 6);
    lod_lanes n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    lod_lanes square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2], size;
    lod_lanes slopes = a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
    for (int i = 0; i < 4; i++)
      size[i] = sqrtf(square[i]);
    /* Nearly parallel derivatives say nothing. */
    for (uint32_t i = 0; i < here; i++) {
      float *out = normals[4 * block + i], scale = size[i] > 1e-5f * slopes[i] ? 1 / size[i] : 0;
      for (int axis = 0; axis < 3; axis++)
        out[axis] = n[axis][i] * scale;
    }
  }
}

static void store_normal(struct lod_vec3 normal, float out[3]) {
  if (!(lod_vec3_length_squared(normal) > 0.5))
    normal = (struct lod_vec3){0, 0, 1};
  lod_vec3_to_float(normal, out);
}

void lod_evaluate_inside(const struct lod_patches *patches, uint32_t patch, const struct lod_bezier *net,
                         const struct lod_tessellation_pattern *pattern, const struct lod_grid_basis *grid, enum lod_smoothness smoothness,
                         float (*positions)[3], float (*normals)[3]) {
  uint32_t count = pattern->vertex_count - pattern->inner_vertices;
  const struct lod_barycentric *at = pattern->domain + pattern->inner_vertices;
  if (count == 0)
    return;
  if (smoothness == LOD_SMOOTH_STRICT) {
    struct lod_gregory gregory;
    lod_gregory_make(patches, patch, &gregory);
    for (uint32_t v = 0; v < count; v++) {
      struct lod_vec3 normal;
      lod_vec3_to_float(lod_gregory_point(&gregory, at[v], normals == NULL ? NULL : &normal), positions[v]);
      if (normals != NULL)
        store_normal(lod_vec3_length_squared(normal) > 0.5 ? normal : lod_bezier_normal(net, at[v]), normals[v]);
    }
    return;
  }
  struct lod_evaluator evaluator;
  lod_evaluator_init(&evaluator, net);
  lod_evaluate_grid(&evaluator, grid, count, positions, normals);
  for (uint32_t v = 0; v < count && normals != NULL; v++)
    if (normals[v][0] == 0 && normals[v][1] == 0 && normals[v][2] == 0)
      store_normal(lod_bezier_normal(net, at[v]), normals[v]);
}

struct lod_bezier_curve lod_patches_edge(const struct lod_patches *patches, uint32_t e) {
  return (struct lod_bezier_curve){
      {patches->positions[patches->ends[e][0]], patches->inner[e][0], patches->inner[e][1], patches->positions[patches->ends[e][1]]}};
}

void lod_evaluate_edge(const struct lod_patches *patches, uint32_t edge, uint32_t factor, float (*positions)[3]) {
  struct lod_bezier_curve curve = lod_patches_edge(patches, edge);
  for (uint32_t i = 1; i < factor; i++)
    lod_vec3_to_float(lod_bezier_curve_point(&curve, (double)i / factor), positions[i - 1]);
}

static struct lod_barycentric on_side(uint32_t side, bool against, double t) {
  double at[3] = {0, 0, 0};
  at[side] = against ? t : 1 - t;
  at[(side + 1) % 3] = against ? 1 - t : t;
  return (struct lod_barycentric){at[0], at[1], at[2]};
}

struct lod_vec3 lod_edge_normal(const struct lod_patches *patches, uint32_t user, bool against, double t, enum lod_smoothness smoothness) {
  struct lod_bezier net = lod_patches_net(patches, user / 3);
  struct lod_barycentric at = on_side(user % 3, against, t);
  if (smoothness == LOD_SMOOTH_STRICT) {
    struct lod_gregory gregory;
    struct lod_vec3 normal;
    lod_gregory_make(patches, user / 3, &gregory);
    lod_gregory_point(&gregory, at, &normal);
    if (lod_vec3_length_squared(normal) > 0.5)
      return normal;
  }
  return lod_bezier_normal(&net, at);
}

/* Along side k of the cubic: derivatives along the side and towards the third corner, as quadratics. */
struct ribbon {
  struct lod_vec3 along[3], across[3];
};

static void make_ribbon(const struct lod_bezier *net, uint32_t k, struct ribbon *ribbon) {
  uint32_t n = (k + 1) % 3, l = (k + 2) % 3;
  const struct lod_vec3 *p = net->p, outer[4] = {p[k], p[3 + 2 * k], p[4 + 2 * k], p[n]};
  const struct lod_vec3 inner[3] = {p[4 + 2 * l], p[9], p[3 + 2 * n]};
  for (int i = 0; i < 3; i++) {
    ribbon->along[i] = lod_vec3_subtract(outer[i + 1], outer[i]);
    ribbon->across[i] = lod_vec3_subtract(inner[i], outer[i]);
  }
}

static struct lod_vec3 quadratic(const struct lod_vec3 p[3], double t) {
  double s = 1 - t;
  return lod_vec3_add_scaled(lod_vec3_add_scaled(lod_vec3_scale(p[0], s * s), p[1], 2 * s * t), p[2], t * t);
}

static struct lod_vec3 ribbon_normal(const struct ribbon *ribbon, double t) {
  struct lod_vec3 a = quadratic(ribbon->along, t), b = quadratic(ribbon->across, t), n = lod_vec3_cross(a, b);
  double size = lod_vec3_length(n);
  return size > 1e-7 * (lod_vec3_length_squared(a) + lod_vec3_length_squared(b)) ? lod_vec3_scale(n, 1 / size) : (struct lod_vec3){0, 0, 0};
}

void lod_evaluate_edge_normals(const struct lod_patches *patches, uint32_t edge, const uint32_t users[2], uint32_t factor,
                               enum lod_smoothness smoothness, float (*normals[2])[3]) {
  struct ribbon ribbons[2];
  bool sharp = patches->sharp[edge], strict = smoothness == LOD_SMOOTH_STRICT;
  for (int u = 0; u < 2; u++)
    if (users[u] != LOD_NONE) {
      struct lod_bezier net = lod_patches_net(patches, users[u] / 3);
      make_ribbon(&net, users[u] % 3, &ribbons[u]);
    }
  for (uint32_t i = 1; i < factor; i++) {
    struct lod_vec3 n[2] = {{0, 0, 0}, {0, 0, 0}};
    double t = (double)i / factor;
    for (int u = 0; u < 2; u++) {
      if (users[u] == LOD_NONE)
        continue;
      n[u] = strict ? (struct lod_vec3){0, 0, 0} : ribbon_normal(&ribbons[u], u == 0 ? t : 1 - t);
      if (!(lod_vec3_length_squared(n[u]) > 0.5))
        n[u] = lod_edge_normal(patches, users[u], u == 1, t, smoothness);
      if (strict && !sharp) /* both are the same */
        break;
    }
    if (!sharp)
      store_normal(lod_vec3_normalize(lod_vec3_add(n[0], n[1])), normals[0][i - 1]);
    for (int u = 0; u < 2 && sharp; u++)
      if (users[u] != LOD_NONE && normals[u] != NULL)
        store_normal(n[u], normals[u][i - 1]);
  }
}

struct lod_vec3 lod_evaluate_corner_normal(const struct lod_patches *patches, uint32_t patch, uint32_t corner) {
  uint32_t sector = patches->sectors[patch][corner];
  if (sector != LOD_NONE)
    return patches->normals[sector];
  struct lod_bezier net = lod_patches_net(patches, patch);
  return lod_bezier_normal(&net, on_side(corner, false, 0));
}
