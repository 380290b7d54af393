/* 4x4 column-major matrices of nodes and instances. */
#include <math.h>
#include <string.h>

#include "codec/import/scene.h"

void lod_matrix_identity(double m[16]) {
  for (int i = 0; i < 16; i++)
    m[i] = i % 5 == 0;
}

void lod_matrix_multiply(const double a[16], const double b[16], double product[16]) {
  for (int column = 0; column < 4; column++)
    for (int row = 0; row < 4; row++) {
      double sum = 0;
      for (int k = 0; k < 4; k++)
        sum += a[k * 4 + row] * b[column * 4 + k];
      product[column * 4 + row] = sum;
    }
}

bool lod_matrix_is_finite(const double m[16]) {
  for (int i = 0; i < 16; i++)
    if (!isfinite(m[i]))
      return false;
  return true;
}

/* One Jacobi rotation that zeroes s[p][q]. */
static void jacobi_rotate(double s[3][3], int p, int q) {
  if (s[p][q] == 0)
    return;
  double theta = (s[q][q] - s[p][p]) / (2 * s[p][q]);
  double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
  double c = 1 / sqrt(t * t + 1), sine = t * c;
  for (int k = 0; k < 3; k++) {
    double kp = s[k][p], kq = s[k][q];
    s[k][p] = c * kp - sine * kq;
    s[k][q] = sine * kp + c * kq;
  }
  for (int k = 0; k < 3; k++) {
    double pk = s[p][k], qk = s[q][k];
    s[p][k] = c * pk - sine * qk;
    s[q][k] = sine * pk + c * qk;
  }
}

/* The largest singular value: the root of the largest eigenvalue of M^T M. Jacobi rotations make the matrix nearly diagonal, Gershgorin's
 * discs then bound the eigenvalue from above whatever is left, and the last factor covers the roundings of the rotations. */
double lod_matrix_stretch(const double m[16]) {
  double largest = 0;
  for (int i = 0; i < 12; i++)
    largest = fmax(largest, fabs(m[i]));
  if (largest == 0)
    return 0;
  double s[3][3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      s[i][j] = 0;
      for (int k = 0; k < 3; k++)
        s[i][j] += m[i * 4 + k] / largest * (m[j * 4 + k] / largest);
    }
  for (int sweep = 0; sweep < 8; sweep++) {
    jacobi_rotate(s, 0, 1);
    jacobi_rotate(s, 0, 2);
    jacobi_rotate(s, 1, 2);
  }
  double bound = 0;
  for (int i = 0; i < 3; i++) {
    double disc = s[i][i];
    for (int j = 0; j < 3; j++)
      disc += i == j ? 0 : fabs(s[i][j]);
    bound = fmax(bound, disc);
  }
  /* An isometry, the common case, is to give exactly 1. */
  double stretch = largest * sqrt(bound);
  return fabs(stretch - 1) < 1e-15 ? 1 : stretch * (1 + 1e-12);
}
