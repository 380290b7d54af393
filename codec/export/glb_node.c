/* The second half of a sheared instance comes from the singular value decomposition A = U S V^T: parent U S, child V^T, both of them
 * rotation and scale. */
#include "codec/export/glb_node.h"

#include <math.h>
#include <string.h>

#include "codec/export/glb_private.h"

/* Columns this close to perpendicular (cosine) pass as rotation and scale: gltf-validator and float clients see no difference. */
#define SHEAR_COSINE 1e-7

static double dot(const double a[3], const double b[3]) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool has_shear(double columns[3][3]) {
  for (int i = 0; i < 3; i++) {
    int j = (i + 1) % 3;
    if (fabs(dot(columns[i], columns[j])) > SHEAR_COSINE * sqrt(dot(columns[i], columns[i]) * dot(columns[j], columns[j])))
      return true;
  }
  return false;
}

/* One-sided Jacobi (Hestenes 1958): turns pairs of columns of `a` until all are perpendicular; v collects the turns, so that
 * a_in = a_out * v^T with v a rotation. */
static void orthogonalise(double a[3][3], double v[3][3]) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      v[i][j] = i == j;
  for (int sweep = 0; sweep < 30; sweep++) {
    bool turned = false;
    for (int p = 0; p < 2; p++)
      for (int q = p + 1; q < 3; q++) {
        double alpha = dot(a[p], a[p]), beta = dot(a[q], a[q]), gamma = dot(a[p], a[q]);
        if (fabs(gamma) <= 1e-16 * sqrt(alpha * beta) || gamma == 0)
          continue;
        turned = true;
        double zeta = (beta - alpha) / (2 * gamma);
        double t = copysign(1, zeta) / (fabs(zeta) + sqrt(1 + zeta * zeta));
        double c = 1 / sqrt(1 + t * t), s = c * t;
        for (int i = 0; i < 3; i++) {
          double x = a[p][i], y = a[q][i];
          a[p][i] = c * x - s * y;
          a[q][i] = s * x + c * y;
          x = v[p][i];
          y = v[q][i];
          v[p][i] = c * x - s * y;
          v[q][i] = s * x + c * y;
        }
      }
    if (!turned)
      return;
  }
}

static json_t *matrix_json(double columns[3][3], const double translation[3]) {
  json_t *array = json_array();
  for (int c = 0; c < 4; c++)
    for (int r = 0; r < 4; r++) {
      double value = c == 3 ? (r == 3 ? 1 : translation[r]) : r == 3 ? 0 : columns[c][r];
      if (value == floor(value) && fabs(value) < 1e15) /* "1" rather than "1.0" */
        json_array_append_new(array, json_integer((json_int_t)value));
      else
        json_array_append_new(array, json_real(value));
    }
  return array;
}

static bool is_identity(double columns[3][3], const double translation[3]) {
  for (int c = 0; c < 3; c++)
    for (int r = 0; r < 3; r++)
      if (columns[c][r] != (c == r) || translation[c] != 0)
        return false;
  return true;
}

void lod_glb_add_nodes(json_t *nodes, size_t mesh, const char *name, const double matrix[16]) {
  double columns[3][3], translation[3];
  for (int r = 0; r < 3; r++) {
    for (int c = 0; c < 3; c++)
      columns[c][r] = matrix[4 * c + r];
    translation[r] = matrix[12 + r];
  }
  json_t *node = json_object();
  if (name != NULL && name[0] != '\0')
    json_object_set_new(node, "name", lod_glb_text(name));
  json_array_append_new(nodes, node);
  if (is_identity(columns, translation)) {
    json_object_set_new(node, "mesh", json_integer((json_int_t)mesh));
    return;
  }
  if (!has_shear(columns)) {
    json_object_set_new(node, "matrix", matrix_json(columns, translation));
    json_object_set_new(node, "mesh", json_integer((json_int_t)mesh));
    return;
  }
  double v[3][3], transposed[3][3];
  orthogonalise(columns, v);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      transposed[i][j] = v[j][i];
  json_object_set_new(node, "matrix", matrix_json(columns, translation));
  json_object_set_new(node, "children", json_pack("[I]", (json_int_t)json_array_size(nodes)));
  json_array_append_new(
      nodes, json_pack("{soso}", "matrix", matrix_json(transposed, (const double[3]){0, 0, 0}), "mesh", json_integer((json_int_t)mesh)));
}

bool lod_glb_node_is_child(json_t *nodes, size_t i) {
  json_t *children = i > 0 ? json_object_get(json_array_get(nodes, i - 1), "children") : NULL;
  return children != NULL && json_integer_value(json_array_get(children, 0)) == (json_int_t)i;
}
