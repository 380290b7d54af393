#include "core/envelope/prism.h"

#include <math.h>

static struct lod_vec3 lifted(const struct lod_prism *prism, int corner, double height) {
  return lod_vec3_add_scaled(prism->corner[corner], prism->normal[corner], height);
}

struct lod_vec3 lod_prism_point(const struct lod_prism *prism, const double weights[3], double height) {
  struct lod_vec3 sum = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    sum = lod_vec3_add_scaled(sum, lifted(prism, k, height), weights[k]);
  return sum;
}

/* The Jacobian is sum of weights * (normal of the offset triangle) . normal[k]: linear in the weights, quadratic in the height, so its
 * Bernstein coefficients over the height bound it. */
bool lod_prism_is_valid(const struct lod_prism *prism, double height, const struct lod_vec3 up[3]) {
  struct lod_vec3 u = lod_vec3_subtract(prism->corner[1], prism->corner[0]), v = lod_vec3_subtract(prism->corner[2], prism->corner[0]);
  struct lod_vec3 du = lod_vec3_scale(lod_vec3_subtract(prism->normal[1], prism->normal[0]), height);
  struct lod_vec3 dv = lod_vec3_scale(lod_vec3_subtract(prism->normal[2], prism->normal[0]), height);
  struct lod_vec3 start = lod_vec3_cross(u, v), end = lod_vec3_cross(lod_vec3_add(u, du), lod_vec3_add(v, dv));
  struct lod_vec3 middle = lod_vec3_add_scaled(start, lod_vec3_add(lod_vec3_cross(u, dv), lod_vec3_cross(du, v)), 0.5);
  for (int k = 0; k < 3; k++)
    if (!(lod_vec3_dot(start, up[k]) > 0 && lod_vec3_dot(middle, up[k]) > 0 && lod_vec3_dot(end, up[k]) > 0))
      return false;
  return true;
}

/* Six times the volume between the offset triangle at a height and p: its zero is p's height. */
static double volume_at(const struct lod_prism *prism, struct lod_vec3 p, double height) {
  struct lod_vec3 a = lifted(prism, 0, height);
  return lod_vec3_dot(lod_vec3_cross(lod_vec3_subtract(lifted(prism, 1, height), a), lod_vec3_subtract(lifted(prism, 2, height), a)),
                      lod_vec3_subtract(p, a));
}

static void weigh(const struct lod_prism *prism, struct lod_vec3 p, double height, double weights[3]) {
  struct lod_vec3 q[3];
  for (int k = 0; k < 3; k++)
    q[k] = lifted(prism, k, height);
  struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(q[1], q[0]), lod_vec3_subtract(q[2], q[0]));
  double squared = lod_vec3_length_squared(n);
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 from = q[(k + 1) % 3], edge = lod_vec3_subtract(q[(k + 2) % 3], from);
    weights[k] = squared > 0 ? lod_vec3_dot(n, lod_vec3_cross(edge, lod_vec3_subtract(p, from))) / squared : 0;
  }
}

bool lod_prism_locate(const struct lod_prism *prism, struct lod_vec3 p, double low, double high, double *height, double weights[3]) {
  double at_low = volume_at(prism, p, low), at_high = volume_at(prism, p, high);
  if (at_low < 0 || at_high > 0)
    return false;
  for (int i = 0; i < 100 && high - low > 1e-15 * fmax(fabs(low), fabs(high)); i++) {
    double middle = i % 3 != 2 && at_low > at_high ? low + (high - low) * at_low / (at_low - at_high) : low + (high - low) / 2;
    double value = volume_at(prism, p, middle);
    if (value == 0) {
      low = high = middle;
      break;
    }
    if (value > 0) {
      low = middle;
      at_low = value;
    } else {
      high = middle;
      at_high = value;
    }
  }
  *height = low + (high - low) / 2;
  weigh(prism, p, *height, weights);
  return true;
}

/* Roots of a u^2 + b u + c. */
static int solve_quadratic(double a, double b, double c, double root[2]) {
  double discriminant = b * b - 4 * a * c;
  if (discriminant < 0)
    return 0;
  double q = -0.5 * (b + copysign(sqrt(discriminant), b));
  int count = 0;
  if (a != 0)
    root[count++] = q / a;
  if (q != 0)
    root[count++] = c / q;
  return count;
}

/* A fiber of the patch and the segment meet when they lie in one plane: a quadratic in the fiber's place on the edge. */
int lod_bilinear_meets(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 normal_a, struct lod_vec3 normal_b, double high,
                       struct lod_vec3 p, struct lod_vec3 q, struct lod_vec3 at[2]) {
  struct lod_vec3 d = lod_vec3_subtract(q, p), ap = lod_vec3_subtract(a, p), ab = lod_vec3_subtract(b, a);
  struct lod_vec3 turn = lod_vec3_subtract(normal_b, normal_a);
  struct lod_vec3 apd = lod_vec3_cross(ap, d), abd = lod_vec3_cross(ab, d);
  double root[2];
  int roots =
      solve_quadratic(lod_vec3_dot(abd, turn), lod_vec3_dot(abd, normal_a) + lod_vec3_dot(apd, turn), lod_vec3_dot(apd, normal_a), root);
  int count = 0;
  for (int i = 0; i < roots; i++) {
    if (!(root[i] >= 0 && root[i] <= 1))
      continue;
    struct lod_vec3 foot = lod_vec3_add_scaled(a, ab, root[i]), fiber = lod_vec3_add_scaled(normal_a, turn, root[i]);
    struct lod_vec3 across = lod_vec3_cross(d, fiber), to = lod_vec3_subtract(foot, p);
    double squared = lod_vec3_length_squared(across);
    if (!(squared > 0))
      continue;
    double along = lod_vec3_dot(lod_vec3_cross(to, fiber), across) / squared;
    double height = lod_vec3_dot(lod_vec3_cross(to, d), across) / squared;
    if (along >= 0 && along <= 1 && height >= 0 && height <= high)
      at[count++] = lod_vec3_add_scaled(p, d, along);
  }
  return count;
}
