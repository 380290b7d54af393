/* Cubic patches over triangles for force without edges.
 *
 * Based on: Isenberg et al. 2003, 4.2; Clough, Tocher. Finite Element Stiffness Matrices for Analysis of Plates in Bending. 1965; Farin.
 * CAGD. The side's inner points lie in the corners' tangent planes; the middle point of each patch is moved along the side's mean normal
 * until the tangent plane at the middle of the side is square to it, so that both neighbours take the same one; what is inside follows from
 * C1. */
#include <math.h>

#include "core/refine/doi.h"

/* Places in points[i] by exponents (corner i, corner i + 1, centre). */
enum { P300, P210, P120, P030, P201, P111, P021, P102, P012, P003 };

static struct lod_vec3 onto_plane(struct lod_vec3 p, struct lod_vec3 q, struct lod_vec3 n) {
  return lod_vec3_add_scaled(p, n, -lod_vec3_dot(lod_vec3_subtract(p, q), n));
}

static struct lod_vec3 mean3(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return lod_vec3_scale(lod_vec3_add(lod_vec3_add(a, b), c), 1.0 / 3);
}

static struct lod_vec3 toward(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 n) {
  return onto_plane(lod_vec3_add_scaled(a, lod_vec3_subtract(b, a), 1.0 / 3), a, n);
}

void lod_clough_tocher_fit(const struct lod_vec3 corners[3], const struct lod_vec3 normals[3], struct lod_clough_tocher *patches) {
  struct lod_vec3 spoke[3], inner[3], near[3], centre;
  struct lod_vec3(*b)[10] = patches->points;
  for (int i = 0; i < 3; i++) {
    int j = (i + 1) % 3;
    b[i][P300] = corners[i];
    b[i][P030] = corners[j];
    b[i][P210] = toward(corners[i], corners[j], normals[i]);
    b[i][P120] = toward(corners[j], corners[i], normals[j]);
  }
  for (int i = 0; i < 3; i++) /* C1 at the corner */
    spoke[i] = mean3(corners[i], b[i][P210], b[(i + 2) % 3][P120]);
  for (int i = 0; i < 3; i++) {
    int j = (i + 1) % 3;
    struct lod_vec3 n = lod_vec3_normalize(lod_vec3_add(normals[i], normals[j]));
    /* Derivative across the side at its middle is (spoke_i + 2 inner + spoke_j) / 4 minus a point of the tangent there. */
    struct lod_vec3 middle = lod_vec3_scale(
        lod_vec3_add(lod_vec3_add(b[i][P300], b[i][P030]), lod_vec3_scale(lod_vec3_add(b[i][P210], b[i][P120]), 3)), 1.0 / 8);
    struct lod_vec3 guess = lod_vec3_scale(lod_vec3_add(spoke[i], spoke[j]), 0.5);
    struct lod_vec3 across = lod_vec3_scale(lod_vec3_add(lod_vec3_add(spoke[i], spoke[j]), lod_vec3_scale(guess, 2)), 0.25);
    inner[i] = lod_vec3_add_scaled(guess, n, -2 * lod_vec3_dot(lod_vec3_subtract(across, middle), n));
  }
  for (int i = 0; i < 3; i++)
    near[i] = mean3(spoke[i], inner[i], inner[(i + 2) % 3]);
  centre = mean3(near[0], near[1], near[2]);
  for (int i = 0; i < 3; i++) {
    int j = (i + 1) % 3;
    b[i][P201] = spoke[i];
    b[i][P021] = spoke[j];
    b[i][P111] = inner[i];
    b[i][P102] = near[i];
    b[i][P012] = near[j];
    b[i][P003] = centre;
  }
}

struct lod_vec3 lod_clough_tocher_point(const struct lod_clough_tocher *patches, int patch, const double w[3]) {
  static const int kPower[10][4] = {{3, 0, 0, 1}, {2, 1, 0, 3}, {1, 2, 0, 3}, {0, 3, 0, 1}, {2, 0, 1, 3},
                                    {1, 1, 1, 6}, {0, 2, 1, 3}, {1, 0, 2, 3}, {0, 1, 2, 3}, {0, 0, 3, 1}};
  struct lod_vec3 sum = {0, 0, 0};
  for (int n = 0; n < 10; n++) {
    double weight = kPower[n][3];
    for (int k = 0; k < 3; k++)
      for (int p = 0; p < kPower[n][k]; p++)
        weight *= w[k];
    sum = lod_vec3_add_scaled(sum, patches->points[patch][n], weight);
  }
  return sum;
}

/* Of the point nearest to p in the plane of a b c. */
static bool barycentric(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c, double v[3]) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a), ac = lod_vec3_subtract(c, a), ap = lod_vec3_subtract(p, a), n = lod_vec3_cross(ab, ac);
  double area = lod_vec3_length_squared(n);
  if (!(area > 0))
    return false;
  v[1] = lod_vec3_dot(lod_vec3_cross(ap, ac), n) / area;
  v[2] = lod_vec3_dot(lod_vec3_cross(ab, ap), n) / area;
  v[0] = 1 - v[1] - v[2];
  return true;
}

double lod_clough_tocher_error(const struct lod_clough_tocher *a, int i, const struct lod_clough_tocher *b, int j) {
  /* The three triangles of a's net along the side, and b's point over each: b's side runs the other way. */
  static const int kNet[3][3] = {{P201, P300, P210}, {P111, P210, P120}, {P021, P120, P030}};
  static const int kAcross[3] = {P021, P111, P201};
  double v[3][3], error = 0;
  for (int k = 0; k < 3; k++)
    if (!barycentric(b->points[j][kAcross[k]], a->points[i][kNet[k][0]], a->points[i][kNet[k][1]], a->points[i][kNet[k][2]], v[k]))
      return INFINITY;
  for (int k = 0; k < 3; k++)
    error += fabs(fabs(v[0][k]) - fabs(v[1][k])) + fabs(fabs(v[0][k]) - fabs(v[2][k]));
  return error;
}

bool lod_clough_tocher_one_sided(const struct lod_clough_tocher *patches) {
  struct lod_vec3 a = patches->points[0][P300], b = patches->points[1][P300], c = patches->points[2][P300];
  struct lod_vec3 n = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
  double size = fmax(lod_vec3_distance(a, b), fmax(lod_vec3_distance(b, c), lod_vec3_distance(c, a))), low = 0, high = 0;
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 10; k++) {
      double d = lod_vec3_dot(lod_vec3_subtract(patches->points[i][k], a), n);
      low = fmin(low, d);
      high = fmax(high, d);
    }
  return low >= -1e-9 * size || high <= 1e-9 * size;
}
