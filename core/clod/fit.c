/* Least-squares curves and centres, foot points, and the certified bound (shared checklist 2.3.3 and 2.3.4). */
#include <math.h>

#include "core/clod/internal.h"

struct lod_vec3 clod_inner_point(struct clod_end near, struct lod_vec3 far) {
  return lod_bezier_inner_rule(near.p, near.normal, far);
}

/* Directions in which an inner point may move: two in the tangent plane, three where there is none. */
static int directions(struct lod_vec3 normal, struct lod_vec3 basis[3]) {
  if (!(lod_vec3_length_squared(normal) > 0.5)) {
    basis[0] = (struct lod_vec3){1, 0, 0};
    basis[1] = (struct lod_vec3){0, 1, 0};
    basis[2] = (struct lod_vec3){0, 0, 1};
    return 3;
  }
  struct lod_vec3 axis = fabs(normal.x) < 0.6 ? (struct lod_vec3){1, 0, 0} : (struct lod_vec3){0, 1, 0};
  basis[0] = lod_vec3_normalize(lod_vec3_cross(normal, axis));
  basis[1] = lod_vec3_cross(normal, basis[0]);
  return 2;
}

/* An inner point moves by at most this share of the chord: what asks for more is no curve from corner to corner. */
static const double kMostMove = 0.25;

/* Solves the n by n system (symmetric, positive definite) in place; the solution is left in r. */
static bool solve(double a[6][6], double r[6], int n) {
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < i; j++) {
      double s = a[i][j];
      for (int k = 0; k < j; k++)
        s -= a[i][k] * a[j][k];
      a[i][j] = s / a[j][j];
    }
    double d = a[i][i];
    for (int k = 0; k < i; k++)
      d -= a[i][k] * a[i][k];
    if (!(d > 0))
      return false;
    a[i][i] = sqrt(d);
  }
  for (int i = 0; i < n; i++) {
    for (int k = 0; k < i; k++)
      r[i] -= a[i][k] * r[k];
    r[i] /= a[i][i];
  }
  for (int i = n; i-- > 0;) {
    for (int k = i + 1; k < n; k++)
      r[i] -= a[k][i] * r[k];
    r[i] /= a[i][i];
  }
  return true;
}

void clod_fit_curve(const struct clod_end ends[2], const double *t, const struct lod_vec3 *samples, uint32_t count, double weight,
                    struct lod_vec3 inner[2]) {
  struct lod_vec3 basis[6];
  int first = directions(ends[0].normal, basis), n = first + directions(ends[1].normal, basis + first);
  double a[6][6] = {{0}}, r[6] = {0};
  for (int i = 0; i < n; i++)
    a[i][i] = weight;
  for (uint32_t s = 0; s < count; s++) {
    double x = t[s], y = 1 - x, b1 = 3 * y * y * x, b2 = 3 * y * x * x;
    struct lod_bezier_curve curve = {{ends[0].p, inner[0], inner[1], ends[1].p}};
    struct lod_vec3 rest = lod_vec3_subtract(samples[s], lod_bezier_curve_point(&curve, x));
    for (int i = 0; i < n; i++) {
      double bi = i < first ? b1 : b2;
      r[i] += bi * lod_vec3_dot(rest, basis[i]);
      for (int j = 0; j <= i; j++)
        a[i][j] += bi * (j < first ? b1 : b2) * lod_vec3_dot(basis[i], basis[j]);
    }
  }
  if (!solve(a, r, n))
    return;
  struct lod_vec3 move[2] = {{0, 0, 0}, {0, 0, 0}};
  for (int i = 0; i < n; i++)
    move[i >= first] = lod_vec3_add_scaled(move[i >= first], basis[i], r[i]);
  double most = kMostMove * lod_vec3_distance(ends[0].p, ends[1].p);
  for (int i = 0; i < 2; i++)
    inner[i] = lod_vec3_add_scaled(inner[i], move[i], fmin(1, most / fmax(lod_vec3_length(move[i]), 1e-300)));
}

void clod_project_curve(const struct lod_bezier_curve *curve, const struct lod_vec3 *samples, uint32_t count, double *t) {
  const struct lod_vec3 *p = curve->p;
  for (uint32_t s = 0; s < count; s++) {
    double x = t[s], y = 1 - x;
    struct lod_vec3 d = lod_vec3_scale(lod_vec3_subtract(p[1], p[0]), 3 * y * y);
    d = lod_vec3_add_scaled(d, lod_vec3_subtract(p[2], p[1]), 6 * x * y);
    d = lod_vec3_add_scaled(d, lod_vec3_subtract(p[3], p[2]), 3 * x * x);
    double speed = lod_vec3_length_squared(d);
    if (!(speed > 0))
      continue;
    double step = lod_vec3_dot(lod_vec3_subtract(samples[s], lod_bezier_curve_point(curve, x)), d) / speed;
    double room = 0.5 * fmin(x, y);
    t[s] = x + fmin(fmax(step, -room), room);
  }
}

static void add_sample(const struct lod_bezier *net, struct lod_barycentric at, struct lod_vec3 point, double weight, double *sum,
                       struct lod_vec3 *residual) {
  double basis[LOD_BEZIER_POINTS];
  lod_bezier_basis(at, basis);
  struct lod_vec3 rest = point;
  for (int i = 0; i < LOD_BEZIER_POINTS; i++)
    rest = lod_vec3_add_scaled(rest, net->p[i], -basis[i]);
  *sum += weight * basis[LOD_BEZIER_CENTRE] * basis[LOD_BEZIER_CENTRE];
  *residual = lod_vec3_add_scaled(*residual, rest, weight * basis[LOD_BEZIER_CENTRE]);
}

void clod_fit_centre(const struct lod_clod *clod, struct lod_bezier *net, const struct clod_node *nodes, uint32_t node_count,
                     const struct clod_cell *cells, uint32_t cell_count) {
  double sum = clod->settings.centre_weight;
  struct lod_vec3 residual = {0, 0, 0};
  for (uint32_t n = 0; n < node_count; n++)
    if (nodes[n].v > 0 && nodes[n].w > 0 && !nodes[n].u0)
      add_sample(net, clod_domain(&nodes[n]), clod->points[nodes[n].id], 1, &sum, &residual);
  for (uint32_t c = 0; c < cell_count; c++) {
    const uint32_t *n = cells[c].node;
    struct lod_barycentric at = {0, (nodes[n[0]].v + nodes[n[1]].v + nodes[n[2]].v) / 3,
                                 (nodes[n[0]].w + nodes[n[1]].w + nodes[n[2]].w) / 3};
    at.u = 1 - at.v - at.w;
    struct lod_vec3 point =
        lod_vec3_add(lod_vec3_add(clod->points[nodes[n[0]].id], clod->points[nodes[n[1]].id]), clod->points[nodes[n[2]].id]);
    add_sample(net, at, lod_vec3_scale(point, 1.0 / 3), 0.5, &sum, &residual);
  }
  net->p[LOD_BEZIER_CENTRE] = lod_vec3_add_scaled(net->p[LOD_BEZIER_CENTRE], residual, 1 / sum);
}

void clod_project_nodes(const struct lod_clod *clod, const struct lod_bezier *net, struct clod_node *nodes, uint32_t node_count) {
  for (uint32_t n = 0; n < node_count; n++) {
    struct clod_node *node = &nodes[n];
    if (node->u0 || !(node->v > 0) || !(node->w > 0))
      continue; /* on a side */
    struct lod_vec3 dv, dw, rest = lod_vec3_subtract(clod->points[node->id], lod_bezier_derivatives(net, clod_domain(node), &dv, &dw));
    double vv = lod_vec3_dot(dv, dv), vw = lod_vec3_dot(dv, dw), ww = lod_vec3_dot(dw, dw), det = vv * ww - vw * vw;
    if (!(det > 1e-6 * vv * ww))
      continue;
    double rv = lod_vec3_dot(rest, dv), rw = lod_vec3_dot(rest, dw);
    double v = (ww * rv - vw * rw) / det, w = (vv * rw - vw * rv) / det, step = 1;
    /* Not further than half of the way to a side. */
    double u = -v - w, at[3] = {1 - node->v - node->w, node->v, node->w}, move[3] = {u, v, w};
    for (int k = 0; k < 3; k++)
      if (move[k] < 0)
        step = fmin(step, 0.5 * at[k] / -move[k]);
    node->v += step * v;
    node->w += step * w;
  }
}

double clod_patch_bound(const struct lod_clod *clod, const struct lod_bezier *net, const struct clod_node *nodes,
                        const struct clod_cell *cells, uint32_t cell_count, double limit) {
  double worst = 0;
  for (uint32_t c = 0; c < cell_count && worst <= limit; c++) {
    struct lod_barycentric domain[3];
    struct lod_vec3 flat[3];
    for (int k = 0; k < 3; k++) {
      const struct clod_node *node = &nodes[cells[c].node[k]];
      domain[k] = clod_domain(node);
      flat[k] = clod->points[node->id];
    }
    worst = fmax(worst, lod_bezier_bound(net, domain, flat));
  }
  return worst > limit ? INFINITY : worst + clod->rounding;
}
