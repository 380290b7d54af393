#include "core/base/predicates.h"

#include <math.h>
#include <stddef.h>

/* Half an ulp of 1: the relative rounding of one operation. */
static const double kEpsilon = 0x1p-53;

/* --- expansions: sums of doubles, smallest first, that overlap in no bit; zero has no component --- */

static inline double two_sum(double a, double b, double *error) {
  double x = a + b;
  double b_virtual = x - a;
  *error = (a - (x - b_virtual)) + (b - b_virtual);
  return x;
}

static inline double two_product(double a, double b, double *error) {
  double x = a * b;
  *error = fma(a, b, -x);
  return x;
}

/* h = e + f; h has room for m + n. FAST-EXPANSION-SUM, Theorem 13. Returns the length of h. */
static int expansion_sum(const double *e, int m, const double *f, int n, double *h) {
  int i = 0, j = 0, length = 0;
  double q = 0;
  while (i < m || j < n) {
    double next = j == n || (i < m && fabs(e[i]) < fabs(f[j])) ? e[i++] : f[j++];
    double error;
    q = two_sum(q, next, &error);
    if (error != 0)
      h[length++] = error;
  }
  if (q != 0)
    h[length++] = q;
  return length;
}

/* h = b * e; h has room for 2 * m. SCALE-EXPANSION, Theorem 19. */
static int expansion_scale(const double *e, int m, double b, double *h) {
  int length = 0;
  double q = 0;
  for (int i = 0; i < m; i++) {
    double low, error, high = two_product(e[i], b, &low);
    double sum = two_sum(q, low, &error);
    if (error != 0)
      h[length++] = error;
    q = two_sum(high, sum, &error);
    if (error != 0)
      h[length++] = error;
  }
  if (q != 0)
    h[length++] = q;
  return length;
}

enum { LINEAR = 2, QUADRATIC = 16, QUARTIC = 512, SUM3 = 3 * QUARTIC };

/* h = e * f with m <= QUADRATIC and n <= QUADRATIC; h has room for 2 * m * n. */
static int expansion_product(const double *e, int m, const double *f, int n, double *h) {
  double sums[2][QUARTIC], term[2 * QUADRATIC];
  int length = 0;
  for (int j = 0; j < n; j++) {
    int size = expansion_scale(e, m, f[j], term);
    length = expansion_sum(sums[j & 1], length, term, size, j == n - 1 ? h : sums[~j & 1]);
  }
  return length;
}

/* d = a - b, at most two components. */
static int difference(double a, double b, double d[LINEAR]) {
  double error, x = two_sum(a, -b, &error);
  int length = 0;
  if (error != 0)
    d[length++] = error;
  if (x != 0)
    d[length++] = x;
  return length;
}

/* h = a * d - b * c for linear expansions; room for QUADRATIC. */
static int cross_product(const double a[LINEAR], int na, const double b[LINEAR], int nb, const double c[LINEAR], int nc,
                         const double d[LINEAR], int nd, double h[QUADRATIC]) {
  double left[8], right[8];
  int nl = expansion_product(a, na, d, nd, left), nr = expansion_product(b, nb, c, nc, right);
  for (int i = 0; i < nr; i++)
    right[i] = -right[i];
  return expansion_sum(left, nl, right, nr, h);
}

static int sign_of(const double *e, int n) {
  return n == 0 ? 0 : e[n - 1] > 0 ? 1 : -1;
}

/* Copies points of `dimension` coordinates scaled by one power of two so that the largest is just below 2^240: four of them multiplied
 * neither overflow nor lose bits below the smallest double. */
static void scale_points(const double *const *points, int count, int dimension, double out[4][3]) {
  double most = 0;
  for (int i = 0; i < count; i++)
    for (int k = 0; k < dimension; k++)
      most = fmax(most, fabs(points[i][k]));
  int exponent = 0;
  (void)frexp(most, &exponent);
  for (int i = 0; i < count; i++)
    for (int k = 0; k < dimension; k++)
      out[i][k] = ldexp(points[i][k], 240 - exponent);
}

/* --- orient2d --- */

static int orient2d_exact(const double *const points[3]) {
  double p[4][3], ax[LINEAR], ay[LINEAR], bx[LINEAR], by[LINEAR], det[QUADRATIC];
  scale_points(points, 3, 2, p);
  int nax = difference(p[0][0], p[2][0], ax), nay = difference(p[0][1], p[2][1], ay);
  int nbx = difference(p[1][0], p[2][0], bx), nby = difference(p[1][1], p[2][1], by);
  return sign_of(det, cross_product(ax, nax, ay, nay, bx, nbx, by, nby, det));
}

/* A filter is trusted only where no product can have lost bits to underflow: `tiny` is below every trusted sum of products. */
static const double kTiny2 = 0x1p-900;

int lod_orient2d(const double a[2], const double b[2], const double c[2]) {
  double left = (a[0] - c[0]) * (b[1] - c[1]), right = (a[1] - c[1]) * (b[0] - c[0]);
  double det = left - right, sum = fabs(left) + fabs(right);
  double bound = (3 + 16 * kEpsilon) * kEpsilon * sum;
  if (fabs(det) > bound && sum > kTiny2 && sum < INFINITY)
    return det > 0 ? 1 : -1;
  return orient2d_exact((const double *const[3]){a, b, c});
}

/* --- orient3d --- */

static int orient3d_exact(const double *const points[4]) {
  double p[4][3], e[3][3][LINEAR], minor[QUADRATIC], terms[3][8 * QUADRATIC], partial[16 * QUADRATIC], det[24 * QUADRATIC];
  int n[3][3], size[3];
  scale_points(points, 4, 3, p);
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++)
      n[i][k] = difference(p[i + 1][k], p[0][k], e[i][k]);
  for (int i = 0; i < 3; i++) { /* the third difference's component k times the minor of the two others */
    int x = (i + 1) % 3, y = (i + 2) % 3;
    int m = cross_product(e[0][x], n[0][x], e[0][y], n[0][y], e[1][x], n[1][x], e[1][y], n[1][y], minor);
    size[i] = expansion_product(minor, m, e[2][i], n[2][i], terms[i]);
  }
  int sum = expansion_sum(terms[0], size[0], terms[1], size[1], partial);
  return sign_of(det, expansion_sum(partial, sum, terms[2], size[2], det));
}

/* Three or four factors: the inner products' lost bits are multiplied by the outer factor, so that must be bounded too. */
static const double kTiny4 = 0x1p-500, kHuge4 = 0x1p200;

int lod_orient3d(const double a[3], const double b[3], const double c[3], const double d[3]) {
  double u[3], v[3], w[3];
  for (int k = 0; k < 3; k++) {
    u[k] = b[k] - a[k];
    v[k] = c[k] - a[k];
    w[k] = d[k] - a[k];
  }
  double det = 0, permanent = 0;
  for (int i = 0; i < 3; i++) {
    int x = (i + 1) % 3, y = (i + 2) % 3;
    double left = u[x] * v[y], right = u[y] * v[x];
    det += w[i] * (left - right);
    permanent += (fabs(left) + fabs(right)) * fabs(w[i]);
  }
  double bound = (7 + 56 * kEpsilon) * kEpsilon * permanent;
  if (fabs(det) > bound && permanent > kTiny4 && fmax(fabs(w[0]), fmax(fabs(w[1]), fabs(w[2]))) < kHuge4)
    return det > 0 ? 1 : -1;
  return orient3d_exact((const double *const[4]){a, b, c, d});
}

/* --- incircle --- */

static int incircle_exact(const double *const points[4]) {
  double p[4][3], e[3][2][LINEAR], terms[3][QUARTIC], partial[2 * QUARTIC], det[SUM3];
  int n[3][2], size[3];
  scale_points(points, 4, 2, p);
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 2; k++)
      n[i][k] = difference(p[i][k], p[3][k], e[i][k]);
  for (int i = 0; i < 3; i++) {
    int s = (i + 1) % 3, t = (i + 2) % 3;
    double minor[QUADRATIC], lift[QUADRATIC], xx[8], yy[8];
    int m = cross_product(e[s][0], n[s][0], e[s][1], n[s][1], e[t][0], n[t][0], e[t][1], n[t][1], minor);
    int nx = expansion_product(e[i][0], n[i][0], e[i][0], n[i][0], xx), ny = expansion_product(e[i][1], n[i][1], e[i][1], n[i][1], yy);
    int l = expansion_sum(xx, nx, yy, ny, lift);
    size[i] = expansion_product(minor, m, lift, l, terms[i]);
  }
  int sum = expansion_sum(terms[0], size[0], terms[1], size[1], partial);
  return sign_of(det, expansion_sum(partial, sum, terms[2], size[2], det));
}

int lod_incircle(const double a[2], const double b[2], const double c[2], const double d[2]) {
  const double *const abc[3] = {a, b, c};
  double x[3], y[3], det = 0, permanent = 0, most = 0;
  for (int i = 0; i < 3; i++) {
    x[i] = abc[i][0] - d[0];
    y[i] = abc[i][1] - d[1];
    most = fmax(most, fmax(fabs(x[i]), fabs(y[i])));
  }
  for (int i = 0; i < 3; i++) {
    int s = (i + 1) % 3, t = (i + 2) % 3;
    double left = x[s] * y[t], right = x[t] * y[s], lift = x[i] * x[i] + y[i] * y[i];
    det += lift * (left - right);
    permanent += (fabs(left) + fabs(right)) * lift;
  }
  double bound = (10 + 96 * kEpsilon) * kEpsilon * permanent;
  if (fabs(det) > bound && permanent > kTiny4 && most < kHuge4)
    return det > 0 ? 1 : -1;
  return incircle_exact((const double *const[4]){a, b, c, d});
}
