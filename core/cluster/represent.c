/* Where the vertex stands that represents a cell: its centre, the weighted mean of its vertices, or the point nearest to the planes of
 * its triangles.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 2; Lindstrom. Out-of-Core Simplification of Large
 * Polygonal Models. SIGGRAPH 2000 (quadrics of cells). Mean and quadric are clamped to the cell.
 *
 * The planes of a vertex's triangles all pass through it, so its quadric about itself is the matrix A = sum of area n n' alone: six
 * numbers, found while grading, serve every level. About a cell's centre, v becomes (A, A (v - c)). Instead of cutting singular values
 * below 1e-3 of the largest we add 1e-3 of their sum to all: the same where planes agree, and a 3 x 3 solve without iteration. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

static const double kRegular = 1e-3;

/* x' A x - 2 b x about the cell's centre, and the mean of the vertices. Float is enough to steer where a representative stands, and the
 * sums of a cell are sums of sums of runs. */
struct moments {
  float a[6]; /* xx xy xz yy yz zz */
  float b[3];
  float mean[3], weight;
};

static struct lod_vec3 working_position(const struct cluster_unit *unit, uint32_t v) {
  return lod_vec3_make((double)unit->x[v], (double)unit->y[v], (double)unit->z[v]);
}

static void end_run(struct moments *m, struct moments *run) {
  for (int i = 0; i < 6; i++)
    m->a[i] += run->a[i];
  for (int axis = 0; axis < 3; axis++) {
    m->b[axis] += run->b[axis];
    m->mean[axis] += run->mean[axis];
  }
  m->weight += run->weight;
  *run = (struct moments){0};
}

static void add_vertices(const struct cluster_unit *unit, const struct cluster_cells *cells, bool quadric, struct moments *moments) {
  struct moments run = {0};
  enum { LONGEST = 64 };
  for (uint32_t v = 0, since = 0; v < unit->count; v++) {
    uint32_t cell = cells->image[v], centre = cells->centre[cell];
    float x = unit->x[v] - unit->x[centre], y = unit->y[v] - unit->y[centre], z = unit->z[v] - unit->z[centre];
    float w = quadric ? 1 : unit->weight[v];
    run.mean[0] += w * x;
    run.mean[1] += w * y;
    run.mean[2] += w * z;
    run.weight += w;
    if (quadric) {
      const float *a = unit->quadric[v];
      for (int i = 0; i < 6; i++)
        run.a[i] += a[i];
      run.b[0] += a[0] * x + a[1] * y + a[2] * z;
      run.b[1] += a[1] * x + a[3] * y + a[4] * z;
      run.b[2] += a[2] * x + a[4] * y + a[5] * z;
    }
    if (v + 1 == unit->count || cells->image[v + 1] != cell || v - since == LONGEST) {
      end_run(&moments[cell], &run);
      since = v + 1;
    }
  }
  for (uint32_t c = 0; c < cells->count; c++)
    for (int axis = 0; axis < 3; axis++)
      moments[c].mean[axis] = moments[c].weight > 0 ? moments[c].mean[axis] / moments[c].weight : 0;
}

/* The minimiser, drawn to the mean in the directions that the planes leave open. */
static void minimise(const struct moments *m, double x[3]) {
  const double p[3] = {(double)m->mean[0], (double)m->mean[1], (double)m->mean[2]};
  memcpy(x, p, sizeof p);
  double trace = (double)m->a[0] + (double)m->a[3] + (double)m->a[5];
  if (!(trace > 0))
    return;
  double scale = 1 / trace, a[6], r[3];
  for (int i = 0; i < 6; i++)
    a[i] = (double)m->a[i] * scale;
  r[0] = (double)m->b[0] * scale - (a[0] * p[0] + a[1] * p[1] + a[2] * p[2]);
  r[1] = (double)m->b[1] * scale - (a[1] * p[0] + a[3] * p[1] + a[4] * p[2]);
  r[2] = (double)m->b[2] * scale - (a[2] * p[0] + a[4] * p[1] + a[5] * p[2]);
  a[0] += kRegular;
  a[3] += kRegular;
  a[5] += kRegular;
  /* Cofactors: the matrix is positive definite with determinant at least about kRegular^2. */
  double c00 = a[3] * a[5] - a[4] * a[4], c01 = a[2] * a[4] - a[1] * a[5], c02 = a[1] * a[4] - a[2] * a[3];
  double c11 = a[0] * a[5] - a[2] * a[2], c12 = a[1] * a[2] - a[0] * a[4], c22 = a[0] * a[3] - a[1] * a[1];
  double inverse = 1 / (a[0] * c00 + a[1] * c01 + a[2] * c02);
  x[0] += inverse * (c00 * r[0] + c01 * r[1] + c02 * r[2]);
  x[1] += inverse * (c01 * r[0] + c11 * r[1] + c12 * r[2]);
  x[2] += inverse * (c02 * r[0] + c12 * r[1] + c22 * r[2]);
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
  add_vertices(unit, cells, quadric, moments);
  for (uint32_t c = 0; c < cells->count; c++) {
    double x[3] = {(double)moments[c].mean[0], (double)moments[c].mean[1], (double)moments[c].mean[2]};
    if (quadric)
      minimise(&moments[c], x);
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
  float most = 0, shrink = (float)unit->shrink;
  if (!(isfinite(shrink) && shrink > 0)) /* coordinates beyond 2^127 either way: bounded by the clamp to the cell */
    return 2 * sqrt(3) * cells->cell / unit->shrink;
  for (uint32_t v = 0; v < unit->count; v++) {
    const float *p = positions[cells->image[v]];
    float x = unit->x[v] - p[0] * shrink, y = unit->y[v] - p[1] * shrink, z = unit->z[v] - p[2] * shrink;
    float squared = x * x + y * y + z * z;
    most = squared > most ? squared : most;
  }
  /* Scaling is exact but for subnormal numbers; float differences and squares are off by a few 2^-24. */
  return (sqrt((double)most) * (1 + 0x1p-20)) / unit->shrink + 0x1p-147;
}

enum lod_status cluster_represent(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                  const struct cluster_cells *cells, struct lod_arena *scratch, float (*positions)[3], double *bound) {
  if (settings->representative == LOD_CLUSTER_CENTRE) {
    for (uint32_t c = 0; c < cells->count; c++)
      memcpy(positions[c], unit->mesh->positions[unit->source[cells->centre[c]]], sizeof *positions);
    *bound = cells->reach / unit->shrink;
    return LOD_OK;
  }
  LOD_TRY(move_representatives(unit, settings, cells, scratch, positions));
  *bound = farthest_move(unit, cells, positions);
  return LOD_OK;
}
