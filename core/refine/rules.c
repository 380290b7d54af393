#include "core/refine/rules.h"

#include <assert.h>

/* 1.5 * 2^52 steps: adding it leaves no bits below the step, and room for 2^51 steps either side. */
struct refine_grid refine_grid_for(double magnitude) {
  int exponent = 0;
  assert(isfinite(magnitude));
  if (magnitude > 0)
    frexp(magnitude, &exponent);
  if (exponent < -900) /* the step must not be denormal */
    exponent = -900;
  return (struct refine_grid){ldexp(1.5, 52 + exponent - 40)};
}

static const double kPi = 3.14159265358979323846;

/* |x| <= pi / 4: below 2^-53 after 10 terms. */
static double cos_small(double x) {
  double x2 = x * x, term = 1, sum = 1;
  for (int k = 1; k <= 10; k++) {
    term = -term * x2 / ((2 * k - 1) * (2 * k));
    sum += term;
  }
  return sum;
}

static double sin_small(double x) {
  double x2 = x * x, term = x, sum = x;
  for (int k = 1; k <= 10; k++) {
    term = -term * x2 / ((2 * k) * (2 * k + 1));
    sum += term;
  }
  return sum;
}

/* cos of i / n turns with 8 i <= n. */
static double cos_eighth(uint64_t i, uint64_t n) {
  return cos_small(2 * kPi * (double)i / (double)n);
}
static double sin_eighth(uint64_t i, uint64_t n) {
  return sin_small(2 * kPi * (double)i / (double)n);
}

static double sin_quarter(uint64_t i, uint64_t n) { /* 4 i <= n */
  if (12 * i == n)
    return 0.5;
  return 8 * i <= n ? sin_eighth(i, n) : cos_eighth(n - 4 * i, 4 * n);
}

double refine_sin_turn(uint32_t i, uint32_t n) {
  uint64_t a = i, b = n;
  double sign = 1;
  if (2 * a >= b) { /* second half */
    sign = -1;
    a = 2 * a - b;
    b = 2 * b;
  }
  if (4 * a > b) { /* second quarter */
    a = b - 2 * a;
    b = 2 * b;
  }
  return a == 0 ? 0 : sign * sin_quarter(a, b);
}

double refine_cos_turn(uint32_t i, uint32_t n) { /* a quarter of a turn ahead */
  uint64_t a = 4 * (uint64_t)i + n, b = 4 * (uint64_t)n;
  a %= b;
  double sign = 1;
  if (2 * a >= b) {
    sign = -1;
    a = 2 * a - b;
    b = 2 * b;
  }
  if (4 * a > b) {
    a = b - 2 * a;
    b = 2 * b;
  }
  return a == 0 ? 0 : sign * sin_quarter(a, b);
}

static double beta(uint32_t n) {
  double c = 0.375 + 0.25 * refine_cos_turn(1, n);
  return (0.625 - c * c) / n;
}

struct refine_weights refine_vertex_weights(uint32_t n) {
  double b = beta(n);
  return (struct refine_weights){1 - n * b, b};
}

struct refine_weights refine_limit_weights(uint32_t n) {
  double chi = 1 / (3 / (8 * beta(n)) + n);
  return (struct refine_weights){1 - n * chi, chi};
}

static struct lod_vec3 regular_ring_normal(const struct lod_vec3 *q) {
  struct lod_vec3 a = lod_vec3_subtract(lod_vec3_add(q[1], q[5]), lod_vec3_add(q[2], q[4]));
  struct lod_vec3 t1 = lod_vec3_add_scaled(lod_vec3_subtract(q[0], q[3]), a, 0.5);
  struct lod_vec3 t2 = lod_vec3_subtract(lod_vec3_add(q[1], q[2]), lod_vec3_add(q[4], q[5]));
  return lod_vec3_cross(t1, t2);
}

struct lod_vec3 refine_ring_normal(const struct lod_vec3 *ring, uint32_t n) {
  if (n == 6)
    return regular_ring_normal(ring);
  struct lod_vec3 t1 = {0}, t2 = {0};
  for (uint32_t i = 0; i < n; i++) {
    t1 = lod_vec3_add_scaled(t1, ring[i], refine_cos_turn(i, n));
    t2 = lod_vec3_add_scaled(t2, ring[i], refine_sin_turn(i, n));
  }
  return lod_vec3_cross(t1, t2);
}

/* The left eigenvectors of the rules around a sharp line with k = n - 1 triangles beside it [derived here; Hoppe et al. 1994 give those of
 * k = 1 to 4]. For k >= 2 with theta = pi / k: neighbour i weighs sin(i theta), the two ends w0 = (sin theta - cot(theta / 2)) / (1 + 2 cos
 * theta), the vertex itself (2 cos theta - 1) w0 - sin theta; the eigenvalue is 3/8 + cos(theta) / 4. */
struct lod_vec3 refine_sector_normal(struct lod_vec3 p, const struct lod_vec3 *ring, uint32_t n) {
  struct lod_vec3 along = lod_vec3_subtract(ring[0], ring[n - 1]), across = {0};
  uint32_t k = n - 1;
  if (k == 1) {
    across = lod_vec3_add_scaled(lod_vec3_add(ring[0], ring[1]), p, -2);
  } else if (k == 2) {
    across = lod_vec3_subtract(ring[1], p);
  } else if (k == 3) {
    across = lod_vec3_scale(lod_vec3_add(ring[1], ring[2]), 2);
    across = lod_vec3_add_scaled(lod_vec3_subtract(across, lod_vec3_add(ring[0], ring[3])), p, -2);
  } else {
    double c = refine_cos_turn(1, 2 * k), s = refine_sin_turn(1, 2 * k);
    double end = (s - (1 + c) / s) / (1 + 2 * c);
    across = lod_vec3_scale(lod_vec3_add(ring[0], ring[k]), end);
    across = lod_vec3_add_scaled(across, p, (2 * c - 1) * end - s);
    for (uint32_t i = 1; i < k; i++)
      across = lod_vec3_add_scaled(across, ring[i], refine_sin_turn(i, 2 * k));
  }
  return lod_vec3_cross(along, across);
}

struct lod_vec3 refine_fan_normal(struct lod_vec3 p, const struct lod_vec3 *ring, uint32_t n, bool closed) {
  struct lod_vec3 sum = {0};
  for (uint32_t i = 0; i + 1 < n + closed; i++)
    sum = lod_vec3_add(sum, lod_vec3_cross(lod_vec3_subtract(ring[i], p), lod_vec3_subtract(ring[(i + 1) % n], p)));
  return sum;
}
