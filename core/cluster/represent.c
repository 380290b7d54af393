/* Where the vertex stands that represents a cell: its centre, the weighted mean of its vertices, or the point nearest to the planes of
 * its triangles.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 2; Lindstrom. Out-of-Core Simplification of Large
 * Polygonal Models. SIGGRAPH 2000 (quadric, small singular values cut off). Mean and quadric are clamped to the cell. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

/* Singular values below this share of the largest say nothing about the position (Lindstrom 2000, section 4.2). */
static const double kSingularCut = 1e-3;

/* x' A x - 2 b x, relative to the cell's centre, and the mean of the vertices. */
struct moments {
  double a[6]; /* xx xy xz yy yz zz */
  double b[3];
  double mean[3], weight;
};

static struct lod_vec3 working_position(const struct cluster_unit *unit, uint32_t v) {
  return lod_vec3_make((double)unit->x[v], (double)unit->y[v], (double)unit->z[v]);
}

static void add_means(const struct cluster_unit *unit, const struct cluster_cells *cells, bool weighted, struct moments *moments) {
  for (uint32_t v = 0; v < unit->count; v++) {
    struct moments *m = &moments[cells->image[v]];
    struct lod_vec3 d = lod_vec3_subtract(working_position(unit, v), working_position(unit, cells->centre[cells->image[v]]));
    double w = weighted ? (double)unit->weight[v] : 1;
    m->mean[0] += w * d.x;
    m->mean[1] += w * d.y;
    m->mean[2] += w * d.z;
    m->weight += w;
  }
  for (uint32_t c = 0; c < cells->count; c++)
    for (int axis = 0; axis < 3; axis++)
      moments[c].mean[axis] = moments[c].weight > 0 ? moments[c].mean[axis] / moments[c].weight : 0;
}

static void add_plane(struct moments *m, struct lod_vec3 n, double area, struct lod_vec3 from_centre) {
  double d = lod_vec3_dot(n, from_centre);
  m->a[0] += area * n.x * n.x;
  m->a[1] += area * n.x * n.y;
  m->a[2] += area * n.x * n.z;
  m->a[3] += area * n.y * n.y;
  m->a[4] += area * n.y * n.z;
  m->a[5] += area * n.z * n.z;
  m->b[0] += area * d * n.x;
  m->b[1] += area * d * n.y;
  m->b[2] += area * d * n.z;
}

static void add_planes(const struct cluster_unit *unit, const struct cluster_cells *cells, struct moments *moments) {
  for (uint32_t t = 0; t < unit->mesh->triangle_count; t++) {
    const uint32_t *v = unit->triangles[t];
    struct lod_vec3 p = working_position(unit, v[0]);
    struct lod_vec3 n =
        lod_vec3_cross(lod_vec3_subtract(working_position(unit, v[1]), p), lod_vec3_subtract(working_position(unit, v[2]), p));
    double area = lod_vec3_length(n);
    if (!(area > 0))
      continue;
    n = lod_vec3_scale(n, 1 / area);
    uint32_t cell[3] = {cells->image[v[0]], cells->image[v[1]], cells->image[v[2]]};
    for (int k = 0; k < 3; k++)
      if ((k < 1 || cell[k] != cell[0]) && (k < 2 || cell[k] != cell[1]))
        add_plane(&moments[cell[k]], n, area, lod_vec3_subtract(p, working_position(unit, cells->centre[cell[k]])));
  }
}

/* Eigenvectors (columns of v) and values of a symmetric matrix by cyclic Jacobi rotations; 3 x 3 settles in a handful of sweeps. */
static void eigen(const double a[6], double values[3], double v[3][3]) {
  double m[3][3] = {{a[0], a[1], a[2]}, {a[1], a[3], a[4]}, {a[2], a[4], a[5]}};
  memset(v, 0, 9 * sizeof(double));
  for (int i = 0; i < 3; i++)
    v[i][i] = 1;
  for (int sweep = 0; sweep < 12; sweep++) {
    double off = fabs(m[0][1]) + fabs(m[0][2]) + fabs(m[1][2]);
    if (off <= 1e-15 * (fabs(m[0][0]) + fabs(m[1][1]) + fabs(m[2][2])))
      break;
    for (int p = 0; p < 2; p++)
      for (int q = p + 1; q < 3; q++) {
        if (fabs(m[p][q]) < DBL_MIN)
          continue;
        double theta = (m[q][q] - m[p][p]) / (2 * m[p][q]);
        double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1)), c = 1 / sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < 3; k++) {
          double kp = m[k][p], kq = m[k][q];
          m[k][p] = c * kp - s * kq;
          m[k][q] = s * kp + c * kq;
        }
        for (int k = 0; k < 3; k++) {
          double pk = m[p][k], qk = m[q][k], vp = v[k][p], vq = v[k][q];
          m[p][k] = c * pk - s * qk;
          m[q][k] = s * pk + c * qk;
          v[k][p] = c * vp - s * vq;
          v[k][q] = s * vp + c * vq;
        }
      }
  }
  for (int i = 0; i < 3; i++)
    values[i] = m[i][i];
}

/* The minimiser nearest to the mean in the directions that the planes leave open. */
static void minimise(const struct moments *m, double x[3]) {
  double values[3], v[3][3], residual[3];
  eigen(m->a, values, v);
  const double *a = m->a, *p = m->mean;
  residual[0] = m->b[0] - (a[0] * p[0] + a[1] * p[1] + a[2] * p[2]);
  residual[1] = m->b[1] - (a[1] * p[0] + a[3] * p[1] + a[4] * p[2]);
  residual[2] = m->b[2] - (a[2] * p[0] + a[4] * p[1] + a[5] * p[2]);
  double largest = fmax(values[0], fmax(values[1], values[2]));
  for (int axis = 0; axis < 3; axis++)
    x[axis] = p[axis];
  for (int i = 0; i < 3; i++) {
    if (!(values[i] > kSingularCut * largest))
      continue;
    double along = (v[0][i] * residual[0] + v[1][i] * residual[1] + v[2][i] * residual[2]) / values[i];
    for (int axis = 0; axis < 3; axis++)
      x[axis] += along * v[axis][i];
  }
}

/* Into the cell around the centre, which is the origin here. */
static void clamp(double x[3], double half, bool sphere) {
  if (sphere) {
    double length = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    for (int axis = 0; axis < 3; axis++)
      x[axis] *= length > half ? half / length : 1;
  }
  for (int axis = 0; axis < 3; axis++)
    x[axis] = x[axis] > half ? half : x[axis] > -half ? x[axis] : -half; /* also turns NaN into a corner of the cell */
}

/* Into the fixed grid cell that holds the centre. */
static void clamp_to_grid(const struct cluster_unit *unit, double cell, struct lod_vec3 centre, double x[3]) {
  double at[3] = {centre.x, centre.y, centre.z};
  for (int axis = 0; axis < 3; axis++) {
    double low = unit->origin[axis] + floor((at[axis] - unit->origin[axis]) / cell) * cell - at[axis];
    x[axis] = x[axis] > low + cell ? low + cell : x[axis] > low ? x[axis] : low;
  }
}

static enum lod_status move_representatives(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                            const struct cluster_cells *cells, struct lod_arena *arena, float (*positions)[3]) {
  struct moments *moments = LOD_NEW_ZERO(arena, cells->count, struct moments);
  if (moments == NULL)
    return LOD_MEMORY;
  bool quadric = settings->representative == LOD_CLUSTER_QUADRIC;
  add_means(unit, cells, !quadric, moments);
  if (quadric)
    add_planes(unit, cells, moments);
  for (uint32_t c = 0; c < cells->count; c++) {
    double x[3];
    if (quadric)
      minimise(&moments[c], x);
    else
      memcpy(x, moments[c].mean, sizeof x);
    struct lod_vec3 centre = working_position(unit, cells->centre[c]);
    if (settings->assignment == LOD_CLUSTER_UNIFORM)
      clamp_to_grid(unit, cells->cell, centre, x);
    else
      clamp(x, cells->cell / 2, settings->shape == LOD_CLUSTER_SPHERE);
    lod_vec3_to_float(lod_vec3_scale(lod_vec3_add(centre, lod_vec3_make(x[0], x[1], x[2])), 1 / unit->shrink), positions[c]);
  }
  return LOD_OK;
}

static double farthest_move(const struct cluster_unit *unit, const struct cluster_cells *cells, float (*const positions)[3]) {
  double most = 0;
  for (uint32_t v = 0; v < unit->count; v++) {
    struct lod_vec3 from = lod_vec3_from_float(unit->mesh->positions[unit->source[v]]);
    most = fmax(most, lod_vec3_distance_squared(from, lod_vec3_from_float(positions[cells->image[v]])));
  }
  return sqrt(most) * (1 + 0x1p-50);
}

enum lod_status cluster_represent(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                  const struct cluster_cells *cells, struct lod_arena *arena, float (**positions)[3], double *bound) {
  *positions = lod_arena_alloc(arena, cells->count, sizeof **positions);
  if (*positions == NULL)
    return LOD_MEMORY;
  if (settings->representative == LOD_CLUSTER_CENTRE) {
    for (uint32_t c = 0; c < cells->count; c++)
      memcpy((*positions)[c], unit->mesh->positions[unit->source[cells->centre[c]]], sizeof **positions);
    *bound = cells->reach / unit->shrink;
    return LOD_OK;
  }
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch != NULL ? move_representatives(unit, settings, cells, scratch, *positions) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  if (status == LOD_OK)
    *bound = farthest_move(unit, cells, *positions);
  return status;
}
