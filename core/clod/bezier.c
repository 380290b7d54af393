/* Cubic triangular Bezier patches. See bezier.h for sources. */
#include "core/clod/bezier.h"

#include <math.h>

const uint8_t lod_bezier_exponents[LOD_BEZIER_POINTS][3] = {{3, 0, 0}, {0, 3, 0}, {0, 0, 3}, {2, 1, 0}, {1, 2, 0},
                                                            {0, 2, 1}, {0, 1, 2}, {1, 0, 2}, {2, 0, 1}, {1, 1, 1}};

/* Index by i and j; k follows. */
static const uint8_t kIndex[4][4] = {{2, 6, 5, 1}, {7, 9, 4, 0}, {8, 3, 0, 0}, {0, 0, 0, 0}};

/* Control points of the quadratics: 0 to 2 the corners, 3 + k between corners k and k + 1. kStep[q]: which three cubic control points
 * (u, v, w) make quadratic point q in a de Casteljau step; kStep2: the same from quadratics to the three linear points. */
static const uint8_t kStep[6][3] = {{0, 3, 8}, {4, 1, 5}, {7, 6, 2}, {3, 4, 9}, {9, 5, 6}, {8, 9, 7}};
static const uint8_t kStep2[3][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}};

uint32_t lod_bezier_index(uint32_t i, uint32_t j, uint32_t k) {
  (void)k;
  return kIndex[i][j];
}

static inline struct lod_vec3 mix(struct lod_barycentric at, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return (struct lod_vec3){at.u * a.x + at.v * b.x + at.w * c.x, at.u * a.y + at.v * b.y + at.w * c.y,
                           at.u * a.z + at.v * b.z + at.w * c.z};
}

static inline void step_cubic(const struct lod_vec3 *p, struct lod_barycentric at, struct lod_vec3 q[6]) {
  for (int i = 0; i < 6; i++)
    q[i] = mix(at, p[kStep[i][0]], p[kStep[i][1]], p[kStep[i][2]]);
}

static inline void step_quadratic(const struct lod_vec3 *q, struct lod_barycentric at, struct lod_vec3 l[3]) {
  for (int i = 0; i < 3; i++)
    l[i] = mix(at, q[kStep2[i][0]], q[kStep2[i][1]], q[kStep2[i][2]]);
}

void lod_bezier_basis(struct lod_barycentric at, double basis[LOD_BEZIER_POINTS]) {
  double u = at.u, v = at.v, w = at.w;
  basis[0] = u * u * u;
  basis[1] = v * v * v;
  basis[2] = w * w * w;
  basis[3] = 3 * u * u * v;
  basis[4] = 3 * u * v * v;
  basis[5] = 3 * v * v * w;
  basis[6] = 3 * v * w * w;
  basis[7] = 3 * w * w * u;
  basis[8] = 3 * w * u * u;
  basis[9] = 6 * u * v * w;
}

struct lod_vec3 lod_bezier_point(const struct lod_bezier *patch, struct lod_barycentric at) {
  double basis[LOD_BEZIER_POINTS];
  lod_bezier_basis(at, basis);
  struct lod_vec3 sum = lod_vec3_scale(patch->p[0], basis[0]);
  for (int i = 1; i < LOD_BEZIER_POINTS; i++)
    sum = lod_vec3_add_scaled(sum, patch->p[i], basis[i]);
  return sum;
}

struct lod_vec3 lod_bezier_derivatives(const struct lod_bezier *patch, struct lod_barycentric at, struct lod_vec3 *dv,
                                       struct lod_vec3 *dw) {
  struct lod_vec3 q[6], l[3];
  step_cubic(patch->p, at, q);
  step_quadratic(q, at, l);
  *dv = lod_vec3_scale(lod_vec3_subtract(l[1], l[0]), 3);
  *dw = lod_vec3_scale(lod_vec3_subtract(l[2], l[0]), 3);
  return mix(at, l[0], l[1], l[2]);
}

struct lod_vec3 lod_bezier_normal(const struct lod_bezier *patch, struct lod_barycentric at) {
  static const double kInward[] = {0, 1e-4, 1e-2, 0.1};
  for (int attempt = 0; attempt < 4; attempt++) {
    double s = kInward[attempt];
    struct lod_barycentric q = {at.u + s * (1.0 / 3 - at.u), at.v + s * (1.0 / 3 - at.v), at.w + s * (1.0 / 3 - at.w)};
    struct lod_vec3 dv, dw;
    lod_bezier_derivatives(patch, q, &dv, &dw);
    struct lod_vec3 normal = lod_vec3_cross(dv, dw);
    double scale = lod_vec3_length_squared(dv) + lod_vec3_length_squared(dw) + lod_vec3_distance_squared(patch->p[0], patch->p[1]) +
                   lod_vec3_distance_squared(patch->p[0], patch->p[2]);
    if (lod_vec3_length(normal) > 1e-7 * scale)
      return lod_vec3_normalize(normal);
  }
  return (struct lod_vec3){0, 0, 0};
}

struct lod_vec3 lod_bezier_blossom(const struct lod_bezier *patch, struct lod_barycentric a, struct lod_barycentric b,
                                   struct lod_barycentric c) {
  struct lod_vec3 q[6], l[3];
  step_cubic(patch->p, a, q);
  step_quadratic(q, b, l);
  return mix(c, l[0], l[1], l[2]);
}

struct lod_bezier lod_bezier_restrict(const struct lod_bezier *patch, struct lod_barycentric a, struct lod_barycentric b,
                                      struct lod_barycentric c) {
  struct lod_barycentric at[3] = {a, b, c};
  struct lod_vec3 q[3][6], l[3][3][3]; /* l[i][j]: arguments at[i], at[j], i <= j */
  struct lod_bezier part;
  for (int i = 0; i < 3; i++) {
    step_cubic(patch->p, at[i], q[i]);
    for (int j = i; j < 3; j++)
      step_quadratic(q[i], at[j], l[i][j]);
  }
  for (int i = 0; i < 3; i++)
    part.p[i] = mix(at[i], l[i][i][0], l[i][i][1], l[i][i][2]);
  for (int k = 0; k < 3; k++) {
    int n = (k + 1) % 3;
    part.p[3 + 2 * k] = mix(at[n], l[k][k][0], l[k][k][1], l[k][k][2]);
    part.p[4 + 2 * k] = mix(at[k], l[n][n][0], l[n][n][1], l[n][n][2]);
  }
  part.p[9] = mix(c, l[0][1][0], l[0][1][1], l[0][1][2]);
  return part;
}

static const struct lod_barycentric kCorner[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

void lod_bezier_split(const struct lod_bezier *patch, struct lod_barycentric at, struct lod_bezier parts[3]) {
  for (int k = 0; k < 3; k++) {
    struct lod_barycentric corner[3] = {kCorner[0], kCorner[1], kCorner[2]};
    corner[k] = at;
    parts[k] = lod_bezier_restrict(patch, corner[0], corner[1], corner[2]);
  }
}

/* Barycentric coordinates of q's projection in the triangle. */
static bool barycentric_in(struct lod_vec3 q, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c, struct lod_barycentric *at) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a), ac = lod_vec3_subtract(c, a), aq = lod_vec3_subtract(q, a);
  struct lod_vec3 normal = lod_vec3_cross(ab, ac);
  double area = lod_vec3_length_squared(normal);
  double scale = lod_vec3_length_squared(ab) * lod_vec3_length_squared(ac);
  if (!(area > 1e-20 * scale))
    return false;
  at->v = lod_vec3_dot(lod_vec3_cross(aq, ac), normal) / area;
  at->w = lod_vec3_dot(lod_vec3_cross(ab, aq), normal) / area;
  at->u = 1 - at->v - at->w;
  return true;
}

bool lod_bezier_merge_star(const struct lod_bezier parts[3], struct lod_bezier *patch, struct lod_barycentric *at) {
  /* parts[0] = (S, B, C): its points next to S on the edges to B and C are 010 and 001; parts[1] = (A, S, C) has 100 and 001. */
  struct lod_vec3 s = parts[0].p[0];
  bool good = barycentric_in(s, parts[1].p[4], parts[0].p[3], parts[0].p[8], at) && at->u > 0.02 && at->v > 0.02 && at->w > 0.02;
  if (!good)
    *at = (struct lod_barycentric){1.0 / 3, 1.0 / 3, 1.0 / 3};
  const struct lod_vec3 *a = parts[0].p, *b = parts[1].p, *c = parts[2].p;
  struct lod_vec3 *p = patch->p;
  p[0] = b[0], p[1] = c[1], p[2] = a[2];
  p[3] = c[3], p[4] = c[4];
  p[5] = a[5], p[6] = a[6];
  p[7] = b[7], p[8] = b[8];
  double u = at->u, v = at->v, w = at->w;
  /* The part's centre is u P + v P + w P of the step's three points; which of them is 111 differs by part. */
  struct lod_vec3 from_c = lod_vec3_scale(lod_vec3_add_scaled(lod_vec3_add_scaled(c[9], p[3], -u), p[4], -v), 1 / w);
  struct lod_vec3 from_b = lod_vec3_scale(lod_vec3_add_scaled(lod_vec3_add_scaled(b[9], p[8], -u), p[7], -w), 1 / v);
  struct lod_vec3 from_a = lod_vec3_scale(lod_vec3_add_scaled(lod_vec3_add_scaled(a[9], p[5], -v), p[6], -w), 1 / u);
  double total = u * u + v * v + w * w;
  p[9] = lod_vec3_scale(lod_vec3_add_scaled(lod_vec3_add_scaled(lod_vec3_scale(from_a, u * u), from_b, v * v), from_c, w * w), 1 / total);
  return good;
}

struct lod_bezier_curve lod_bezier_merge_curves(const struct lod_bezier_curve *a, const struct lod_bezier_curve *b, double *t) {
  double before = lod_vec3_distance(a->p[2], a->p[3]), after = lod_vec3_distance(b->p[0], b->p[1]);
  double share = before + after > 0 ? before / (before + after) : 0.5;
  share = fmin(fmax(share, 0.05), 0.95);
  *t = share;
  struct lod_bezier_curve c = {{a->p[0], lod_vec3_add_scaled(a->p[0], lod_vec3_subtract(a->p[1], a->p[0]), 1 / share),
                                lod_vec3_add_scaled(b->p[3], lod_vec3_subtract(b->p[2], b->p[3]), 1 / (1 - share)), b->p[3]}};
  return c;
}

struct lod_bezier lod_bezier_merge_pair(const struct lod_bezier *a, const struct lod_bezier *b, double *t) {
  struct lod_bezier_curve first = lod_bezier_edge(a, 0), second = lod_bezier_edge(b, 0);
  struct lod_bezier_curve whole = lod_bezier_merge_curves(&first, &second, t);
  double v = *t, u = 1 - v;
  struct lod_bezier m;
  m.p[0] = whole.p[0], m.p[3] = whole.p[1], m.p[4] = whole.p[2], m.p[1] = whole.p[3];
  m.p[2] = a->p[2];
  m.p[5] = b->p[5], m.p[6] = b->p[6];
  m.p[7] = a->p[7], m.p[8] = a->p[8];
  /* a's centre = u 201 + v 111, b's = u 111 + v 021. */
  struct lod_vec3 from_a = lod_vec3_scale(lod_vec3_add_scaled(a->p[9], m.p[8], -u), 1 / v);
  struct lod_vec3 from_b = lod_vec3_scale(lod_vec3_add_scaled(b->p[9], m.p[5], -v), 1 / u);
  m.p[9] = lod_vec3_scale(lod_vec3_add_scaled(lod_vec3_scale(from_a, v * v), from_b, u * u), 1 / (u * u + v * v));
  return m;
}

struct lod_vec3 lod_bezier_curve_point(const struct lod_bezier_curve *curve, double t) {
  double s = 1 - t, b0 = s * s * s, b1 = 3 * s * s * t, b2 = 3 * s * t * t, b3 = t * t * t;
  const struct lod_vec3 *p = curve->p;
  return (struct lod_vec3){b0 * p[0].x + b1 * p[1].x + b2 * p[2].x + b3 * p[3].x, b0 * p[0].y + b1 * p[1].y + b2 * p[2].y + b3 * p[3].y,
                           b0 * p[0].z + b1 * p[1].z + b2 * p[2].z + b3 * p[3].z};
}

static struct lod_vec3 between(struct lod_vec3 a, struct lod_vec3 b, double t) {
  return lod_vec3_add_scaled(lod_vec3_scale(a, 1 - t), b, t);
}

void lod_bezier_split_curve(const struct lod_bezier_curve *curve, double t, struct lod_bezier_curve *a, struct lod_bezier_curve *b) {
  const struct lod_vec3 *p = curve->p;
  struct lod_vec3 p01 = between(p[0], p[1], t), p12 = between(p[1], p[2], t), p23 = between(p[2], p[3], t);
  struct lod_vec3 p012 = between(p01, p12, t), p123 = between(p12, p23, t), middle = between(p012, p123, t);
  struct lod_vec3 first = p[0], last = p[3];
  *a = (struct lod_bezier_curve){{first, p01, p012, middle}};
  *b = (struct lod_bezier_curve){{middle, p123, p23, last}};
}

struct lod_bezier_curve lod_bezier_edge(const struct lod_bezier *patch, uint32_t k) {
  return (struct lod_bezier_curve){{patch->p[k], patch->p[3 + 2 * k], patch->p[4 + 2 * k], patch->p[(k + 1) % 3]}};
}

struct lod_bezier lod_bezier_flat(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  struct lod_vec3 corner[3] = {a, b, c};
  struct lod_bezier flat;
  for (int i = 0; i < LOD_BEZIER_POINTS; i++) {
    const uint8_t *e = lod_bezier_exponents[i];
    struct lod_vec3 sum = lod_vec3_scale(corner[0], e[0]);
    sum = lod_vec3_add_scaled(lod_vec3_add_scaled(sum, corner[1], e[1]), corner[2], e[2]);
    flat.p[i] = e[0] == 3 || e[1] == 3 || e[2] == 3 ? corner[i] : lod_vec3_scale(sum, 1.0 / 3);
  }
  return flat;
}

struct lod_vec3 lod_bezier_inner_rule(struct lod_vec3 near, struct lod_vec3 normal, struct lod_vec3 far) {
  static const double kMostSlope = 0.35; /* sine */
  struct lod_vec3 third = lod_vec3_scale(lod_vec3_subtract(far, near), 1.0 / 3);
  double height = lod_vec3_dot(third, normal), most = kMostSlope * lod_vec3_length(third);
  height = height > most ? most : height < -most ? -most : height;
  return lod_vec3_add(near, lod_vec3_add_scaled(third, normal, -height));
}

void lod_bezier_set_centre(struct lod_bezier *patch) {
  struct lod_vec3 edges = {0, 0, 0}, corners = {0, 0, 0};
  for (int i = 0; i < 3; i++)
    corners = lod_vec3_add(corners, patch->p[i]);
  for (int i = 3; i < 9; i++)
    edges = lod_vec3_add(edges, patch->p[i]);
  patch->p[9] = lod_vec3_subtract(lod_vec3_scale(edges, 1.5 / 6), lod_vec3_scale(corners, 0.5 / 3));
}

struct lod_vec3 lod_bezier_refine_centre(const struct lod_bezier *net, const struct lod_vec3 neighbours[3], const bool has[3],
                                         double regular) {
  struct lod_vec3 c0 = net->p[LOD_BEZIER_CENTRE];
  double a[3][3] = {{regular, 0, 0}, {0, regular, 0}, {0, 0, regular}}, r[3] = {0, 0, 0};
  for (int k = 0; k < 3; k++) {
    if (!has[k])
      continue;
    struct lod_vec3 along = lod_vec3_subtract(net->p[4 + 2 * k], net->p[3 + 2 * k]), over = lod_vec3_subtract(neighbours[k], c0);
    struct lod_vec3 n = lod_vec3_cross(along, over);
    double length = lod_vec3_length(n);
    if (!(length > 1e-9 * lod_vec3_length(along) * lod_vec3_length(over)))
      continue;
    n = lod_vec3_scale(n, 1 / length);
    double offset = lod_vec3_dot(n, lod_vec3_subtract(net->p[3 + 2 * k], c0)), v[3] = {n.x, n.y, n.z};
    for (int i = 0; i < 3; i++) {
      for (int j = 0; j < 3; j++)
        a[i][j] += v[i] * v[j];
      r[i] += v[i] * offset;
    }
  }
  /* Symmetric and positive definite: Cramer's rule is enough for three unknowns. */
  struct lod_vec3 x = {a[0][0], a[1][0], a[2][0]}, y = {a[0][1], a[1][1], a[2][1]}, z = {a[0][2], a[1][2], a[2][2]}, b = {r[0], r[1], r[2]};
  double det = lod_vec3_dot(x, lod_vec3_cross(y, z));
  struct lod_vec3 move = {lod_vec3_dot(b, lod_vec3_cross(y, z)) / det, lod_vec3_dot(x, lod_vec3_cross(b, z)) / det,
                          lod_vec3_dot(x, lod_vec3_cross(y, b)) / det};
  return lod_vec3_add(c0, move);
}

double lod_bezier_bound(const struct lod_bezier *patch, const struct lod_barycentric domain[3], const struct lod_vec3 flat[3]) {
  struct lod_bezier part = lod_bezier_restrict(patch, domain[0], domain[1], domain[2]);
  double worst = 0;
  for (int i = 0; i < LOD_BEZIER_POINTS; i++) {
    const uint8_t *e = lod_bezier_exponents[i];
    struct lod_vec3 q = lod_vec3_scale(flat[0], e[0] / 3.0);
    q = lod_vec3_add_scaled(lod_vec3_add_scaled(q, flat[1], e[1] / 3.0), flat[2], e[2] / 3.0);
    worst = fmax(worst, lod_vec3_distance_squared(part.p[i], q));
  }
  return sqrt(worst);
}

/* Largest second difference of three neighbouring control points, squared. */
static double second_difference(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c, struct lod_vec3 d) {
  struct lod_vec3 x = {a.x - b.x - c.x + d.x, a.y - b.y - c.y + d.y, a.z - b.z - c.z + d.z};
  return lod_vec3_length_squared(x);
}

/* max |second derivative| of the curve; 6 * the larger second difference. */
static double curve_bend(const struct lod_bezier_curve *curve) {
  const struct lod_vec3 *p = curve->p;
  return 6 * sqrt(fmax(second_difference(p[0], p[1], p[1], p[2]), second_difference(p[1], p[2], p[2], p[3])));
}

double lod_bezier_curve_deviation(const struct lod_bezier_curve *curve, uint32_t m) {
  return curve_bend(curve) / (8.0 * m * m);
}

/* With l the barycentric coordinates in a small triangle and D_ab the bounds of the second derivative along its side ab, de Casteljau's
 * first step and the identity sum l_a q_aa - q = sum l_a l_b (q_aa - 2 q_ab + q_bb) for a quadratic q give
 *   |linear interpolant - patch| <= 1/2 sum over sides of l_a l_b D_ab <= 1/6 max D,
 * since sum l_a l_b <= 1/3. The second derivative along a side is linear, so the three second differences along it bound it. For a
 * quadratic this is sharp (the 2/9 of all six differences is not needed). */
static double patch_bend(const struct lod_bezier *patch) {
  const struct lod_vec3 *p = patch->p;
  /* Second differences along side A-B of the three rows of quadratics' corners: 300 210 120, 210 120 030, 201 111 021; likewise others. */
  double ab = fmax(second_difference(p[0], p[3], p[3], p[4]), second_difference(p[3], p[4], p[4], p[1]));
  ab = fmax(ab, second_difference(p[8], p[9], p[9], p[5]));
  double bc = fmax(second_difference(p[1], p[5], p[5], p[6]), second_difference(p[5], p[6], p[6], p[2]));
  bc = fmax(bc, second_difference(p[4], p[9], p[9], p[7]));
  double ca = fmax(second_difference(p[2], p[7], p[7], p[8]), second_difference(p[7], p[8], p[8], p[0]));
  ca = fmax(ca, second_difference(p[6], p[9], p[9], p[3]));
  return 6 * sqrt(fmax(ab, fmax(bc, ca)));
}

double lod_bezier_deviation(const struct lod_bezier *patch, uint32_t m) {
  return patch_bend(patch) / (6.0 * m * m);
}

static uint32_t segments(double deviation, double tolerance, uint32_t most) {
  double m = ceil(sqrt(deviation / tolerance));
  return m >= most ? most : m > 1 ? (uint32_t)m : 1;
}

uint32_t lod_bezier_curve_segments(const struct lod_bezier_curve *curve, double tolerance, uint32_t most) {
  return segments(lod_bezier_curve_deviation(curve, 1), tolerance, most);
}

uint32_t lod_bezier_segments(const struct lod_bezier *patch, double tolerance, uint32_t most) {
  return segments(lod_bezier_deviation(patch, 1), tolerance, most);
}
