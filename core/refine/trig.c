#include "core/refine/trig.h"

#include <math.h>

static const double kRadians = 0.017453292519943295;

/* |x| <= pi / 4 */
static double sine(double x) {
  double x2 = x * x, term = x, sum = x;
  for (int k = 1; k <= 10; k++) {
    term = -term * x2 / ((2 * k) * (2 * k + 1));
    sum += term;
  }
  return sum;
}

static double cosine(double x) {
  double x2 = x * x, term = 1, sum = 1;
  for (int k = 1; k <= 10; k++) {
    term = -term * x2 / ((2 * k - 1) * (2 * k));
    sum += term;
  }
  return sum;
}

double refine_sin_degrees(double degrees) {
  double sign = degrees < 0 ? -1 : 1, a = fmod(fabs(degrees), 360);
  if (a >= 180) {
    a -= 180;
    sign = -sign;
  }
  if (a > 90)
    a = 180 - a;
  return sign * (a <= 45 ? sine(a * kRadians) : cosine((90 - a) * kRadians));
}

/* x in [0, 1]: halved three times, then the series. */
static double arc_tangent(double x) {
  for (int i = 0; i < 3; i++)
    x = x / (1 + sqrt(1 + x * x));
  double x2 = x * x, power = x, sum = x;
  for (int k = 1; k <= 10; k++) {
    power = -power * x2;
    sum += power / (2 * k + 1);
  }
  return 8 * sum;
}

double refine_angle_degrees(double dot, double length2_a, double length2_b) {
  double length = sqrt(length2_a) * sqrt(length2_b);
  if (!(length > 0))
    return 0;
  double c = dot / length;
  c = c > 1 ? 1 : c < -1 ? -1 : c;
  double opposite = sqrt(1 - c), adjacent = sqrt(1 + c); /* tan of half the angle */
  double half = opposite <= adjacent ? arc_tangent(opposite / adjacent) / kRadians : 90 - arc_tangent(adjacent / opposite) / kRadians;
  return 2 * half;
}
