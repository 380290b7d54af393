/* Objects that a focus is about: the centre of a part's box, or a line through the middle of it.
 *
 * Based on: Isenberg et al. 2003, 4.3 ("the center of the bounding object approximation" or "a point on the internal skeleton", for which
 * Deussen et al. 1999 is named). Ours is the line through the centroids of slices square to the part's longest principal axis: right for
 * what a skeleton is asked for, long and bent things that do not branch. */
#include <math.h>
#include <string.h>

#include "core/refine/doi.h"

enum { SLICES = 16 };

struct piece {
  double area;
  struct lod_vec3 centre;
};

static bool belongs(const struct lod_mesh *mesh, uint32_t t, uint32_t part) {
  return mesh->parts == NULL || mesh->parts[t] == part;
}

static struct piece piece_of(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
  struct lod_vec3 cross = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
  return (struct piece){lod_vec3_length(cross) / 2, lod_vec3_scale(lod_vec3_add(lod_vec3_add(p[0], p[1]), p[2]), 1.0 / 3)};
}

/* Direction of the largest spread, by power iteration on the covariance. */
static struct lod_vec3 longest_axis(const struct lod_mesh *mesh, uint32_t part, struct lod_vec3 mean) {
  double c[6] = {0}; /* xx xy xz yy yz zz */
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (!belongs(mesh, t, part))
      continue;
    struct piece piece = piece_of(mesh, t);
    struct lod_vec3 d = lod_vec3_subtract(piece.centre, mean);
    c[0] += piece.area * d.x * d.x;
    c[1] += piece.area * d.x * d.y;
    c[2] += piece.area * d.x * d.z;
    c[3] += piece.area * d.y * d.y;
    c[4] += piece.area * d.y * d.z;
    c[5] += piece.area * d.z * d.z;
  }
  struct lod_vec3 axis = {1, 0.9, 0.8}; /* square to no likely axis */
  for (int i = 0; i < 60; i++) {
    struct lod_vec3 next = {c[0] * axis.x + c[1] * axis.y + c[2] * axis.z, c[1] * axis.x + c[3] * axis.y + c[4] * axis.z,
                            c[2] * axis.x + c[4] * axis.y + c[5] * axis.z};
    if (!(lod_vec3_length_squared(next) > 0))
      break;
    axis = lod_vec3_normalize(next);
  }
  return lod_vec3_normalize(axis);
}

static uint32_t slice(const struct lod_mesh *mesh, uint32_t part, struct lod_vec3 mean, double (*bones)[3]) {
  struct lod_vec3 axis = longest_axis(mesh, part, mean), sums[SLICES];
  double low = INFINITY, high = -INFINITY, areas[SLICES] = {0};
  memset(sums, 0, sizeof sums);
  for (int pass = 0; pass < 2; pass++)
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
      if (!belongs(mesh, t, part))
        continue;
      struct piece piece = piece_of(mesh, t);
      double along = lod_vec3_dot(lod_vec3_subtract(piece.centre, mean), axis);
      if (pass == 0) {
        low = fmin(low, along);
        high = fmax(high, along);
        continue;
      }
      double place = high > low ? (along - low) / (high - low) * SLICES : 0;
      int at = place >= SLICES ? SLICES - 1 : (int)place;
      areas[at] += piece.area;
      sums[at] = lod_vec3_add_scaled(sums[at], piece.centre, piece.area);
    }
  uint32_t count = 0;
  for (int i = 0; i < SLICES; i++)
    if (areas[i] > 0) {
      struct lod_vec3 p = lod_vec3_scale(sums[i], 1 / areas[i]);
      memcpy(bones[count++], (const double[]){p.x, p.y, p.z}, sizeof *bones);
    }
  return count;
}

enum lod_status lod_doi_object_of_part(const struct lod_mesh *mesh, uint32_t part, bool skeleton, struct lod_arena *arena,
                                       struct lod_doi_object *object, struct lod_problem *problem) {
  double min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY}, area = 0;
  struct lod_vec3 sum = {0, 0, 0};
  uint32_t count = 0;
  *object = (struct lod_doi_object){.dominance = 1, .part = part};
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (!belongs(mesh, t, part))
      continue;
    struct piece piece = piece_of(mesh, t);
    sum = lod_vec3_add_scaled(sum, piece.centre, piece.area);
    area += piece.area;
    count++;
    for (int k = 0; k < 3; k++)
      for (int i = 0; i < 3; i++) {
        double x = (double)mesh->positions[mesh->triangles[t][k]][i];
        min[i] = fmin(min[i], x);
        max[i] = fmax(max[i], x);
      }
  }
  if (count == 0)
    return lod_fail(problem, LOD_BAD_INPUT, "unknown-part", "The focus is on part %u, which has no triangle.", part);
  object->bones = lod_arena_alloc(arena, SLICES, sizeof *object->bones);
  if (object->bones == NULL)
    return lod_fail_memory(problem);
  if (skeleton && area > 0)
    object->bone_count = slice(mesh, part, lod_vec3_scale(sum, 1 / area), object->bones);
  if (object->bone_count == 0) {
    object->bone_count = 1;
    for (int i = 0; i < 3; i++)
      object->bones[0][i] = (min[i] + max[i]) / 2;
  }
  return LOD_OK;
}
