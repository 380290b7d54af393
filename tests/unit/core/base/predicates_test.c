#include "core/base/predicates.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "tests/data/shapes.h"

/* --- integers of any size, the slow and simple way: the judge of the predicates --- */

enum { LIMBS = 300 };

struct big {
  int sign; /* -1, 0, 1 */
  int size;
  uint32_t limbs[LIMBS];
};

static int compare_size(const struct big *a, const struct big *b) {
  if (a->size != b->size)
    return a->size < b->size ? -1 : 1;
  for (int i = a->size - 1; i >= 0; i--)
    if (a->limbs[i] != b->limbs[i])
      return a->limbs[i] < b->limbs[i] ? -1 : 1;
  return 0;
}

static void trim(struct big *a) {
  while (a->size > 0 && a->limbs[a->size - 1] == 0)
    a->size--;
  if (a->size == 0)
    a->sign = 0;
}

static struct big add(const struct big *a, const struct big *b) {
  if (a->sign == 0)
    return *b;
  if (b->sign == 0)
    return *a;
  const struct big *large = compare_size(a, b) >= 0 ? a : b, *small = large == a ? b : a;
  struct big r = {.sign = large->sign, .size = large->size};
  int64_t carry = 0, direction = a->sign == b->sign ? 1 : -1;
  for (int i = 0; i < large->size; i++) {
    carry += (int64_t)large->limbs[i] + (i < small->size ? direction * (int64_t)small->limbs[i] : 0);
    r.limbs[i] = (uint32_t)carry;
    carry >>= 32;
  }
  if (carry != 0) {
    assert_true(r.size < LIMBS);
    r.limbs[r.size++] = (uint32_t)carry;
  }
  trim(&r);
  return r;
}

static struct big negate(struct big a) {
  a.sign = -a.sign;
  return a;
}

static struct big subtract(const struct big *a, const struct big *b) {
  struct big minus = negate(*b);
  return add(a, &minus);
}

static struct big multiply(const struct big *a, const struct big *b) {
  struct big r = {.sign = a->sign * b->sign, .size = a->size + b->size};
  assert_true(r.size <= LIMBS);
  memset(r.limbs, 0, (size_t)r.size * sizeof *r.limbs);
  for (int i = 0; i < a->size; i++) {
    uint64_t carry = 0;
    for (int j = 0; j < b->size; j++) {
      carry += (uint64_t)a->limbs[i] * b->limbs[j] + r.limbs[i + j];
      r.limbs[i + j] = (uint32_t)carry;
      carry >>= 32;
    }
    r.limbs[i + b->size] = (uint32_t)carry;
  }
  trim(&r);
  return r;
}

/* x / 2^base, which must be an integer. */
static struct big from_double(double x, int base) {
  int exponent;
  int64_t mantissa = (int64_t)ldexp(frexp(fabs(x), &exponent), 53);
  int shift = exponent - 53 - base;
  struct big r = {.sign = x > 0 ? 1 : x < 0 ? -1 : 0, .size = x != 0 ? (shift + 53) / 32 + 1 : 0};
  assert_true(x == 0 || (shift >= 0 && r.size <= LIMBS));
  memset(r.limbs, 0, (size_t)r.size * sizeof *r.limbs);
  for (int bit = 0; x != 0 && bit < 53; bit++)
    if (mantissa >> bit & 1)
      r.limbs[(bit + shift) / 32] |= 1u << (bit + shift) % 32;
  trim(&r);
  return r;
}

/* The largest base with which all coordinates are integers for sure. */
static int common_base(const double *const *points, int count, int dimension) {
  int base = 2000;
  for (int i = 0; i < count; i++)
    for (int k = 0; k < dimension; k++) {
      int exponent;
      if (frexp(points[i][k], &exponent) != 0 && exponent - 53 < base)
        base = exponent - 53;
    }
  return base;
}

static struct big minor2(const struct big *a, const struct big *b, const struct big *c, const struct big *d) {
  struct big left = multiply(a, d), right = multiply(b, c);
  return subtract(&left, &right);
}

static int determinant3(struct big m[3][3]) {
  struct big sum = {0};
  for (int i = 0; i < 3; i++) {
    struct big minor = minor2(&m[1][(i + 1) % 3], &m[1][(i + 2) % 3], &m[2][(i + 1) % 3], &m[2][(i + 2) % 3]);
    struct big term = multiply(&m[0][i], &minor);
    sum = add(&sum, &term);
  }
  return sum.sign;
}

static void differences(const double *a, const double *origin, int dimension, int base, struct big *out) {
  for (int k = 0; k < dimension; k++) {
    struct big x = from_double(a[k], base), o = from_double(origin[k], base);
    out[k] = subtract(&x, &o);
  }
}

static int true_orient2d(const double a[2], const double b[2], const double c[2]) {
  int base = common_base((const double *const[3]){a, b, c}, 3, 2);
  struct big u[2], v[2];
  differences(a, c, 2, base, u);
  differences(b, c, 2, base, v);
  return minor2(&u[0], &u[1], &v[0], &v[1]).sign;
}

static int true_orient3d(const double a[3], const double b[3], const double c[3], const double d[3]) {
  int base = common_base((const double *const[4]){a, b, c, d}, 4, 3);
  struct big m[3][3];
  differences(b, a, 3, base, m[0]);
  differences(c, a, 3, base, m[1]);
  differences(d, a, 3, base, m[2]);
  return determinant3(m);
}

static int true_incircle(const double a[2], const double b[2], const double c[2], const double d[2]) {
  const double *const points[4] = {a, b, c, d};
  int base = common_base(points, 4, 2);
  struct big m[3][3];
  for (int i = 0; i < 3; i++) {
    differences(points[i], d, 2, base, m[i]);
    struct big xx = multiply(&m[i][0], &m[i][0]), yy = multiply(&m[i][1], &m[i][1]);
    m[i][2] = add(&xx, &yy);
  }
  return determinant3(m);
}

/* --- claims --- */

static uint64_t seed;

static double uniform(void) {
  return 2 * lod_random_unit(&seed) - 1;
}

static double nudge(double x) {
  for (int64_t steps = (int64_t)(lod_random_next(&seed) % 5) - 2; steps != 0; steps += steps < 0 ? 1 : -1)
    x = nextafter(x, steps < 0 ? -INFINITY : INFINITY);
  return x;
}

static void signs_follow_the_right_hand(void **state) {
  (void)state;
  const double a[3] = {0, 0, 0}, b[3] = {1, 0, 0}, c[3] = {0, 1, 0}, up[3] = {0.2, 0.2, 1}, down[3] = {0, 0, -1e-300}, in[3] = {3, 4, 0};
  assert_int_equal(lod_orient2d(a, b, c), 1);
  assert_int_equal(lod_orient2d(a, c, b), -1);
  assert_int_equal(lod_orient2d(a, b, b), 0);
  assert_int_equal(lod_orient3d(a, b, c, up), 1);
  assert_int_equal(lod_orient3d(a, b, c, down), -1);
  assert_int_equal(lod_orient3d(a, b, c, in), 0);
  assert_int_equal(lod_incircle(a, b, c, (const double[2]){0.5, 0.5}), 1);
  assert_int_equal(lod_incircle(a, b, c, (const double[2]){1, 1}), 0);
  assert_int_equal(lod_incircle(a, b, c, (const double[2]){1, 1.0000000000000002}), -1);
  assert_int_equal(lod_incircle(a, c, b, (const double[2]){0.5, 0.5}), -1);
}

/* Kettner et al. 2008: a line through (12, 12) and (24, 24) and points a few ulp around (0.5, 0.5), where naive code errs in stripes. */
static void every_point_of_an_ulp_grid_beside_a_line_has_its_exact_side(void **state) {
  (void)state;
  const double q[2] = {12, 12}, r[2] = {24, 24};
  int on_line = 0;
  for (int i = 0; i < 64; i++)
    for (int j = 0; j < 64; j++) {
      const double p[2] = {0.5 + i * 0x1p-53, 0.5 + j * 0x1p-53};
      int expected = (p[1] > p[0]) - (p[1] < p[0]); /* above the diagonal is left of it, seen along q -> r */
      assert_int_equal(lod_orient2d(q, r, p), expected);
      on_line += expected == 0;
    }
  assert_true(on_line >= 64);
}

static void orient2d_agrees_with_integers_on_nearly_collinear_points(void **state) {
  (void)state;
  int zeros = 0;
  seed = 1;
  for (int i = 0; i < 20000; i++) {
    double a[2] = {uniform(), uniform()}, b[2] = {uniform(), uniform()}, t = i & 1 ? 0.5 : uniform() * 4;
    if (i % 3 == 0)
      for (int k = 0; k < 2; k++) {
        a[k] = (float)a[k];
        b[k] = (float)b[k];
      }
    double c[2] = {a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])};
    if (i % 4 != 0) {
      c[0] = nudge(c[0]);
      c[1] = nudge(c[1]);
    }
    int expected = true_orient2d(a, b, c);
    zeros += expected == 0;
    assert_int_equal(lod_orient2d(a, b, c), expected);
    assert_int_equal(lod_orient2d(b, a, c), -expected);
    assert_int_equal(lod_orient2d(c, a, b), expected);
  }
  assert_true(zeros > 100);
}

static void orient3d_agrees_with_integers_on_nearly_coplanar_points(void **state) {
  (void)state;
  int zeros = 0;
  seed = 2;
  for (int i = 0; i < 6000; i++) {
    double p[3][3], d[3];
    double s = uniform(), t = uniform();
    for (int j = 0; j < 3; j++)
      for (int k = 0; k < 3; k++)
        p[j][k] = i % 3 == 0 ? (double)(float)uniform() : uniform();
    if (i % 3 == 0)
      s = 0.5, t = 0.25;
    for (int k = 0; k < 3; k++)
      d[k] = nudge(p[0][k] + s * (p[1][k] - p[0][k]) + t * (p[2][k] - p[0][k]));
    if (i % 5 == 0)
      d[2] = p[0][2] = p[1][2] = p[2][2];
    int expected = true_orient3d(p[0], p[1], p[2], d);
    zeros += expected == 0;
    assert_int_equal(lod_orient3d(p[0], p[1], p[2], d), expected);
    assert_int_equal(lod_orient3d(p[1], p[0], p[2], d), -expected);
    assert_int_equal(lod_orient3d(d, p[0], p[2], p[1]), true_orient3d(d, p[0], p[2], p[1]));
  }
  assert_true(zeros > 100);
}

static void incircle_agrees_with_integers_on_nearly_cocircular_points(void **state) {
  (void)state;
  int zeros = 0;
  seed = 3;
  for (int i = 0; i < 6000; i++) {
    double p[4][2], x = uniform(), y = uniform(), r = 1 + uniform() / 2, turn = uniform();
    for (int j = 0; j < 4; j++) {
      double angle = turn + j * (1 + lod_random_unit(&seed) / 2);
      p[j][0] = nudge(x + r * cos(angle));
      p[j][1] = nudge(y + r * sin(angle));
    }
    if (i % 3 == 0) { /* the corners of a rectangle are cocircular, exactly */
      const double w = (float)x, h = (float)y;
      const double corners[4][2] = {{0.25, 0.5}, {0.25 + w, 0.5}, {0.25 + w, 0.5 + h}, {0.25, 0.5 + h}};
      memcpy(p, corners, sizeof p);
    }
    int expected = true_incircle(p[0], p[1], p[2], p[3]);
    zeros += expected == 0;
    assert_int_equal(lod_incircle(p[0], p[1], p[2], p[3]), expected);
    assert_int_equal(lod_incircle(p[1], p[0], p[2], p[3]), -expected);
    assert_int_equal(lod_incircle(p[3], p[1], p[2], p[0]), true_incircle(p[3], p[1], p[2], p[0]));
  }
  assert_true(zeros > 1000);
}

/* Coordinates on a small integer grid, scaled so far that naive products overflow, underflow or become subnormal. */
static void signs_do_not_depend_on_scale(void **state) {
  (void)state;
  static const int kExponents[] = {0, 500, 1000, -500, -1000, -1050};
  seed = 4;
  for (int i = 0; i < 3000; i++) {
    double p[4][3], q[4][3];
    for (int j = 0; j < 4; j++)
      for (int k = 0; k < 3; k++)
        p[j][k] = (double)(lod_random_next(&seed) % 9);
    for (size_t e = 0; e < sizeof kExponents / sizeof kExponents[0]; e++) {
      for (int j = 0; j < 4; j++)
        for (int k = 0; k < 3; k++)
          q[j][k] = ldexp(p[j][k], kExponents[e]);
      assert_int_equal(lod_orient2d(q[0], q[1], q[2]), true_orient2d(p[0], p[1], p[2]));
      assert_int_equal(lod_orient3d(q[0], q[1], q[2], q[3]), true_orient3d(p[0], p[1], p[2], p[3]));
      assert_int_equal(lod_incircle(q[0], q[1], q[2], q[3]), true_incircle(p[0], p[1], p[2], p[3]));
    }
  }
}

/* Floats from the smallest to the largest in one determinant. */
static void floats_of_all_magnitudes_together_are_exact(void **state) {
  (void)state;
  seed = 5;
  for (int i = 0; i < 3000; i++) {
    double p[4][3];
    for (int j = 0; j < 4; j++)
      for (int k = 0; k < 3; k++)
        p[j][k] = (double)(float)ldexp(uniform(), (int)(lod_random_next(&seed) % 277) - 149);
    if (i % 2)
      p[3][0] = p[0][0], p[3][1] = p[0][1];
    if (i % 4 == 1)
      p[2][2] = p[1][2] = p[0][2];
    assert_int_equal(lod_orient2d(p[0], p[1], p[2]), true_orient2d(p[0], p[1], p[2]));
    assert_int_equal(lod_orient3d(p[0], p[1], p[2], p[3]), true_orient3d(p[0], p[1], p[2], p[3]));
    assert_int_equal(lod_incircle(p[0], p[1], p[2], p[3]), true_incircle(p[0], p[1], p[2], p[3]));
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(signs_follow_the_right_hand),
      cmocka_unit_test(every_point_of_an_ulp_grid_beside_a_line_has_its_exact_side),
      cmocka_unit_test(orient2d_agrees_with_integers_on_nearly_collinear_points),
      cmocka_unit_test(orient3d_agrees_with_integers_on_nearly_coplanar_points),
      cmocka_unit_test(incircle_agrees_with_integers_on_nearly_cocircular_points),
      cmocka_unit_test(signs_do_not_depend_on_scale),
      cmocka_unit_test(floats_of_all_magnitudes_together_are_exact),
  };
  return cmocka_run_group_tests_name("core/base/predicates", tests, NULL, NULL);
}
