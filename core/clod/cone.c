/* All normals of a cubic patch in a cone. */
#include <math.h>

#include "core/clod/bezier.h"

/* The normal, a quartic, is a positive combination of its Bernstein points, each of which is one of products of the derivatives' control
 * vectors: so all normals lie in a cone that holds these products. */
bool lod_bezier_normal_cone(const struct lod_bezier *net, struct lod_vec3 *axis, double *sine) {
  static const uint8_t kExponents[6][3] = {{2, 0, 0}, {0, 2, 0}, {0, 0, 2}, {1, 1, 0}, {0, 1, 1}, {1, 0, 1}};
  static const uint8_t kFrom[6] = {0, 4, 7, 3, 9, 8}, kV[6] = {3, 1, 6, 4, 5, 9}, kW[6] = {8, 5, 2, 9, 6, 7};
  static const double kFactorial[5] = {1, 1, 2, 6, 24};
  struct lod_vec3 dv[6], dw[6], n[15], sum = {0, 0, 0};
  for (int i = 0; i < 6; i++) {
    dv[i] = lod_vec3_subtract(net->p[kV[i]], net->p[kFrom[i]]);
    dw[i] = lod_vec3_subtract(net->p[kW[i]], net->p[kFrom[i]]);
  }
  for (int c = 0; c < 15; c++)
    n[c] = (struct lod_vec3){0, 0, 0};
  for (int i = 0; i < 6; i++)
    for (int j = 0; j < 6; j++) {
      uint32_t a = kExponents[i][0] + kExponents[j][0], b = kExponents[i][1] + kExponents[j][1];
      double weight = 1;
      for (int k = 0; k < 3; k++) /* multinomials of both; that of the product is the same for all that go into a point */
        weight /= kFactorial[kExponents[i][k]] * kFactorial[kExponents[j][k]];
      struct lod_vec3 *point = &n[(4 - a) * (5 - a) / 2 + b];
      *point = lod_vec3_add_scaled(*point, lod_vec3_cross(dv[i], dw[j]), weight);
    }
  double longest = 0;
  for (int c = 0; c < 15; c++)
    longest = fmax(longest, lod_vec3_length(n[c]));
  for (int c = 0; c < 15; c++)
    if (lod_vec3_length(n[c]) > 1e-12 * longest)
      sum = lod_vec3_add(sum, lod_vec3_normalize(n[c]));
  *axis = lod_vec3_normalize(sum);
  double least = 1;
  for (int c = 0; c < 15; c++) {
    double length = lod_vec3_length(n[c]);
    if (length > 0)
      least = fmin(least, lod_vec3_dot(n[c], *axis) / length);
  }
  *sine = least > 0 ? sqrt(fmax(0, 1 - least * least)) : 1;
  return longest > 0 && least > 1e-6;
}

enum { REGULAR_DEPTH = 3 };

static bool regular_within(const struct lod_bezier *net, int depth) {
  static const struct lod_barycentric kCorners[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                      kMiddles[3] = {{0.5, 0.5, 0}, {0, 0.5, 0.5}, {0.5, 0, 0.5}};
  struct lod_vec3 axis;
  double sine;
  if (lod_bezier_normal_cone(net, &axis, &sine))
    return true;
  if (depth == 0)
    return false;
  for (int k = 0; k < 4; k++) {
    struct lod_bezier part = k == 3 ? lod_bezier_restrict(net, kMiddles[0], kMiddles[1], kMiddles[2])
                                    : lod_bezier_restrict(net, kCorners[k], kMiddles[k], kMiddles[(k + 2) % 3]);
    if (!regular_within(&part, depth - 1))
      return false;
  }
  return true;
}

bool lod_bezier_is_regular(const struct lod_bezier *net) {
  return regular_within(net, REGULAR_DEPTH);
}
