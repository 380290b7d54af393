#include "core/clod/patches.h"

#include <math.h>
#include <string.h>

struct lod_bezier lod_patches_net(const struct lod_patches *patches, uint32_t patch) {
  struct lod_bezier net;
  for (uint32_t k = 0; k < 3; k++) {
    net.p[k] = patches->positions[patches->corners[patch][k]];
    uint32_t side = patches->edges[patch][k];
    net.p[3 + 2 * k] = patches->inner[side >> 1][side & 1];
    net.p[4 + 2 * k] = patches->inner[side >> 1][1 - (side & 1)];
  }
  net.p[LOD_BEZIER_CENTRE] = patches->centres[patch];
  return net;
}

static bool is_finite(struct lod_vec3 v) {
  return isfinite(v.x) && isfinite(v.y) && isfinite(v.z);
}

static bool all_finite(const struct lod_patches *patches) {
  bool good = true;
  for (uint32_t v = 0; v < patches->vertex_count; v++)
    good = good && is_finite(patches->positions[v]);
  for (uint32_t n = 0; n < patches->normal_count; n++)
    good = good && is_finite(patches->normals[n]);
  for (uint32_t e = 0; e < patches->edge_count; e++)
    good = good && is_finite(patches->inner[e][0]) && is_finite(patches->inner[e][1]);
  for (uint32_t p = 0; p < patches->patch_count; p++)
    good = good && is_finite(patches->centres[p]);
  return good;
}

static bool patch_good(const struct lod_patches *patches, uint32_t p) {
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = patches->edges[p][k];
    if (patches->corners[p][k] >= patches->vertex_count || side >> 1 >= patches->edge_count ||
        patches->corners[p][(k + 1) % 3] >= patches->vertex_count)
      return false;
    if (patches->ends[side >> 1][side & 1] != patches->corners[p][k] ||
        patches->ends[side >> 1][1 - (side & 1)] != patches->corners[p][(k + 1) % 3])
      return false;
    if (patches->sectors[p][k] != LOD_NONE && patches->sectors[p][k] >= patches->normal_count)
      return false;
  }
  return true;
}

bool lod_patches_check(const struct lod_patches *patches, struct lod_problem *problem) {
  for (uint32_t e = 0; e < patches->edge_count; e++)
    if (patches->ends[e][0] >= patches->vertex_count || patches->ends[e][1] >= patches->vertex_count) {
      lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "edge %u names a vertex that is not there", e);
      return false;
    }
  for (uint32_t p = 0; p < patches->patch_count; p++)
    if (!patch_good(patches, p)) {
      lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "patch %u and its edges do not agree", p);
      return false;
    }
  if (!all_finite(patches)) {
    lod_fail(problem, LOD_BAD_INPUT, "non-finite", "a control point is not finite");
    return false;
  }
  return true;
}

enum lod_status lod_patches_find_partners(struct lod_patches *patches, struct lod_arena *arena) {
  uint32_t *user = LOD_NEW(arena, 2 * (size_t)patches->edge_count, uint32_t);
  if (user == NULL)
    return LOD_MEMORY;
  memset(user, 0xff, 2 * (size_t)patches->edge_count * sizeof *user);
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++)
      user[patches->edges[p][k]] = 3 * p + k;
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++)
      patches->partners[p][k] = user[patches->edges[p][k] ^ 1];
  return LOD_OK;
}

static void grow(struct lod_bounds *bounds, struct lod_vec3 p) {
  double at[3] = {p.x, p.y, p.z};
  for (int axis = 0; axis < 3; axis++) {
    bounds->min[axis] = fmin(bounds->min[axis], at[axis]);
    bounds->max[axis] = fmax(bounds->max[axis], at[axis]);
  }
}

struct lod_bounds lod_patches_bounds(const struct lod_patches *patches) {
  struct lod_bounds bounds = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    struct lod_bezier net = lod_patches_net(patches, p);
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      grow(&bounds, net.p[i]);
  }
  return patches->patch_count > 0 ? bounds : (struct lod_bounds){{0}, {0}};
}

static struct lod_barycentric on_side(uint32_t k, double t) {
  double at[3] = {0, 0, 0};
  at[k] = 1 - t;
  at[(k + 1) % 3] = t;
  return (struct lod_barycentric){at[0], at[1], at[2]};
}

double lod_patches_normal_gap(const struct lod_patches *patches, uint32_t samples) {
  double least = 1;
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t side = patches->edges[p][k], other = patches->partners[p][k];
      if (patches->sharp[side >> 1] || other == LOD_NONE || other / 3 <= p)
        continue;
      struct lod_bezier a = lod_patches_net(patches, p), b = lod_patches_net(patches, other / 3);
      for (uint32_t s = 0; s <= samples; s++) {
        double t = (double)s / samples;
        struct lod_vec3 na = lod_bezier_normal(&a, on_side(k, t)), nb = lod_bezier_normal(&b, on_side(other % 3, 1 - t));
        if (lod_vec3_length_squared(na) > 0.5 && lod_vec3_length_squared(nb) > 0.5)
          least = fmin(least, lod_vec3_dot(na, nb));
      }
    }
  }
  return acos(fmax(-1, least)) * (180 / 3.14159265358979323846);
}
