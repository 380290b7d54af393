/* Box and bounding sphere of a model's instances.
 *
 * Based on: Gärtner. Fast and robust smallest enclosing balls. 1999 (pivoting on the farthest point). We keep at most five points and
 * try all their subsets instead of solving incrementally: in three dimensions that is small, and a degenerate subset is just skipped. */
#include "core/mesh/model.h"

#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"

/* Vertices times instances above which an instance is enclosed by its transformed box: a forest of a million trees must not cost
 * minutes for two numbers that only have to enclose. */
static const uint64_t kMostPoints = 100 * 1000 * 1000;

typedef void point_visitor(void *context, struct lod_vec3 p);

static struct lod_vec3 transform(const double m[16], struct lod_vec3 p) {
  return lod_vec3_make(m[0] * p.x + m[4] * p.y + m[8] * p.z + m[12], m[1] * p.x + m[5] * p.y + m[9] * p.z + m[13],
                       m[2] * p.x + m[6] * p.y + m[10] * p.z + m[14]);
}

static void visit_vertices(const struct lod_mesh *mesh, const double (*instances)[16], uint32_t instance_count, point_visitor *visit,
                           void *context) {
  struct lod_bounds box = {{0}, {0}};
  bool boxes = (uint64_t)instance_count * mesh->vertex_count > kMostPoints;
  if (boxes)
    box = lod_mesh_bounds(mesh);
  for (uint32_t i = 0; i < instance_count; i++) {
    if (boxes) {
      for (int c = 0; c < 8; c++)
        visit(context, transform(instances[i], lod_vec3_make(c & 1 ? box.max[0] : box.min[0], c & 2 ? box.max[1] : box.min[1],
                                                             c & 4 ? box.max[2] : box.min[2])));
    } else {
      for (uint32_t v = 0; v < mesh->vertex_count; v++)
        visit(context, transform(instances[i], lod_vec3_from_float(mesh->positions[v])));
    }
  }
}

/* Every point of the model. A unit holds either one part with any number of instances, or several parts in model space, whose one
 * instance is the identity (model.h): a unit is therefore visited whole, once for every instance of its first part. */
static void visit_points(const struct lod_model *model, point_visitor *visit, void *context) {
  static const double kIdentity[1][16] = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  uint32_t next = 0; /* parts mostly come in the order of their units, so the search goes on where it last ended */
  for (uint32_t u = 0; u < model->unit_count; u++) {
    const struct lod_part *part = NULL;
    for (uint32_t i = 0; i < model->part_count && part == NULL; i++, next = next + 1 < model->part_count ? next + 1 : 0)
      if (model->parts[next].unit == u)
        part = &model->parts[next];
    if (part == NULL || part->instances == NULL)
      visit_vertices(&model->units[u].mesh, kIdentity, 1, visit, context);
    else
      visit_vertices(&model->units[u].mesh, (const double(*)[16])part->instances, part->instance_count, visit, context);
  }
}

struct box {
  struct lod_bounds bounds;
  bool any;
};

static void grow_box(void *context, struct lod_vec3 p) {
  struct box *box = context;
  const double q[3] = {p.x, p.y, p.z};
  for (int k = 0; k < 3; k++) {
    if (!box->any || q[k] < box->bounds.min[k])
      box->bounds.min[k] = q[k];
    if (!box->any || q[k] > box->bounds.max[k])
      box->bounds.max[k] = q[k];
  }
  box->any = true;
}

struct lod_bounds lod_model_bounds(const struct lod_model *model) {
  struct box box = {0};
  visit_points(model, grow_box, &box);
  return box.bounds;
}

struct ball {
  struct lod_vec3 center;
  double radius_squared;
};

/* The point with equal distance to all of 2 to 4 points, in their affine hull; false when they are affinely dependent. */
static bool circumscribe(const struct lod_vec3 *points, int count, struct ball *ball) {
  double a[3][4];
  int n = count - 1;
  struct lod_vec3 edge[3];
  for (int i = 0; i < n; i++)
    edge[i] = lod_vec3_subtract(points[i + 1], points[0]);
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < n; j++)
      a[i][j] = 2 * lod_vec3_dot(edge[i], edge[j]);
    a[i][n] = lod_vec3_length_squared(edge[i]);
  }
  for (int i = 0; i < n; i++) { /* Gram matrix: symmetric positive, the largest diagonal element is a good pivot */
    int pivot = i;
    for (int r = i + 1; r < n; r++)
      if (fabs(a[r][i]) > fabs(a[pivot][i]))
        pivot = r;
    if (!(fabs(a[pivot][i]) > 1e-14 * a[0][n]))
      return false;
    for (int c = 0; c <= n; c++) {
      double swap = a[i][c];
      a[i][c] = a[pivot][c];
      a[pivot][c] = swap;
    }
    for (int r = 0; r < n; r++) {
      double factor = r == i ? 0 : a[r][i] / a[i][i];
      for (int c = i; c <= n; c++)
        a[r][c] -= factor * a[i][c];
    }
  }
  struct lod_vec3 offset = {0, 0, 0};
  for (int i = 0; i < n; i++)
    offset = lod_vec3_add_scaled(offset, edge[i], a[i][n] / a[i][i]);
  ball->center = lod_vec3_add(points[0], offset);
  ball->radius_squared = lod_vec3_length_squared(offset);
  return true;
}

/* Smallest ball through a subset of `points` (at most 5) that contains all of them within rounding; keeps that subset in `points`. */
static bool smallest_ball(struct lod_vec3 points[5], int *count, struct ball *best) {
  int best_mask = 0;
  for (int mask = 1; mask < 1 << *count; mask++) {
    struct lod_vec3 subset[5] = {{0}};
    int size = 0;
    for (int i = 0; i < *count; i++)
      if (mask >> i & 1)
        subset[size++] = points[i];
    struct ball ball = {subset[0], 0};
    if (size > 4 || (size > 1 && !circumscribe(subset, size, &ball)))
      continue;
    if (best_mask != 0 && ball.radius_squared >= best->radius_squared)
      continue;
    bool contains = true;
    for (int i = 0; i < *count && contains; i++)
      contains = mask >> i & 1 || lod_vec3_distance_squared(points[i], ball.center) <= ball.radius_squared * (1 + 1e-12);
    if (!contains)
      continue;
    *best = ball;
    best_mask = mask;
  }
  int size = 0;
  for (int i = 0; i < *count; i++)
    if (best_mask >> i & 1)
      points[size++] = points[i];
  if (best_mask != 0)
    *count = size;
  return best_mask != 0;
}

struct farthest {
  struct lod_vec3 center, point;
  double distance_squared;
};

static void find_farthest(void *context, struct lod_vec3 p) {
  struct farthest *farthest = context;
  double d = lod_vec3_distance_squared(p, farthest->center);
  if (d > farthest->distance_squared) {
    farthest->distance_squared = d;
    farthest->point = p;
  }
}

struct lod_sphere lod_model_sphere(const struct lod_model *model) {
  enum { PASSES = 32 }; /* about 8 are usual; each brings the ball strictly nearer to the smallest one */
  struct lod_bounds bounds = lod_model_bounds(model);
  struct ball ball = {{(bounds.min[0] + bounds.max[0]) / 2, (bounds.min[1] + bounds.max[1]) / 2, (bounds.min[2] + bounds.max[2]) / 2}, 0};
  struct lod_vec3 support[5], best_center = ball.center;
  int count = 0;
  double best = INFINITY;
  for (int pass = 0; pass < PASSES; pass++) {
    struct farthest farthest = {.center = ball.center, .point = ball.center, .distance_squared = 0};
    visit_points(model, find_farthest, &farthest);
    if (farthest.distance_squared < best) {
      best = farthest.distance_squared;
      best_center = ball.center;
    }
    if (farthest.distance_squared <= ball.radius_squared * (1 + 1e-9))
      break;
    support[count++] = farthest.point;
    if (!smallest_ball(support, &count, &ball) || count > 4)
      break;
  }
  double magnitude = 0;
  for (int k = 0; k < 3; k++)
    magnitude = fmax(magnitude, fmax(fabs(bounds.min[k]), fabs(bounds.max[k])));
  /* Never smaller than needed: the distances above are rounded. */
  double radius = best == 0 ? 0 : sqrt(best) + lod_tolerance_rounding(magnitude);
  return (struct lod_sphere){{best_center.x, best_center.y, best_center.z}, radius};
}
