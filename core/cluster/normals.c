/* Normals of the level: recomputed from its triangles, for each smoothing side by itself.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 2, step 6.
 *
 * A smoothing side is a wedge: attributes.c gives corners of one source wedge one level wedge. A part is flat shaded when almost none of
 * its vertices is shaded smoothly over a bend; its level triangles keep their own plane's normal. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

/* Below this angle (0.1 degrees) two planes are one as far as shading tells. */
static const double kBendCosine = 0.9999985;
/* Of the vertices on a bend, the share that a flat-shaded part may shade smoothly. */
static const double kSmoothShare = 0.05;

enum { UNSEEN = 0, PLANE = 1, BENT = 2 };

static struct lod_vec3 face_normal(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
  return lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
}

/* state of each wedge: used by triangles of one plane, or of several. */
static void find_bends(const struct lod_mesh *mesh, uint8_t *state, float (*normal)[3], uint32_t *part) {
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 n = face_normal(mesh, t);
    if (!(lod_vec3_length_squared(n) > 0))
      continue;
    n = lod_vec3_normalize(n);
    for (int k = 0; k < 3; k++) {
      uint32_t w = mesh->corners[t][k];
      part[w] = mesh->parts != NULL ? mesh->parts[t] : 0;
      if (state[w] == UNSEEN) {
        state[w] = PLANE;
        lod_vec3_to_float(n, normal[w]);
      } else if (state[w] == PLANE && lod_vec3_dot(n, lod_vec3_from_float(normal[w])) < kBendCosine) {
        state[w] = BENT;
      }
    }
  }
}

static enum lod_status find_flat_parts(struct cluster_unit *unit, uint32_t part_count, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  uint8_t *state = LOD_NEW_ZERO(scratch, mesh->wedge_count, uint8_t);
  float(*normal)[3] = lod_arena_alloc(scratch, mesh->wedge_count, sizeof *normal);
  uint32_t *part = LOD_NEW(scratch, mesh->wedge_count, uint32_t);
  uint32_t *smooth = LOD_NEW_ZERO(scratch, part_count, uint32_t), *hard = LOD_NEW_ZERO(scratch, part_count, uint32_t);
  if (state == NULL || normal == NULL || part == NULL || smooth == NULL || hard == NULL)
    return LOD_MEMORY;
  find_bends(mesh, state, normal, part);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    const uint32_t *list = unit->wedges.list;
    uint32_t begin = unit->wedges.begin[v], end = unit->wedges.begin[v + 1];
    for (uint32_t i = begin; i < end; i++) {
      if (state[list[i]] == UNSEEN) /* only triangles without area use it: its part is not known */
        continue;
      if (state[list[i]] == BENT)
        smooth[part[list[i]]]++;
      bool differs = i > begin && state[list[i]] == PLANE && state[list[i - 1]] == PLANE &&
                     lod_vec3_dot(lod_vec3_from_float(normal[list[i]]), lod_vec3_from_float(normal[list[i - 1]])) < kBendCosine;
      hard[part[list[i]]] += differs;
    }
  }
  for (uint32_t p = 0; p < part_count; p++)
    unit->wedges.flat_part[p] = hard[p] > 0 && smooth[p] < kSmoothShare * ((double)smooth[p] + hard[p]);
  return LOD_OK;
}

enum lod_status cluster_find_flat_parts(struct cluster_unit *unit, struct lod_arena *arena) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t part_count = 1;
  for (uint32_t t = 0; mesh->parts != NULL && t < mesh->triangle_count; t++)
    part_count = mesh->parts[t] >= part_count ? mesh->parts[t] + 1 : part_count;
  unit->wedges.flat_part = LOD_NEW_ZERO(arena, part_count, uint8_t);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = unit->wedges.flat_part != NULL && scratch != NULL ? find_flat_parts(unit, part_count, scratch) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status cluster_adjust_normals(const struct cluster_unit *unit, const uint32_t *wedge_source, struct lod_arena *arena,
                                       struct lod_mesh *mesh) {
  mesh->normals = lod_arena_alloc(arena, mesh->wedge_count, sizeof *mesh->normals);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_vec3 *sum = scratch != NULL ? LOD_NEW_ZERO(scratch, mesh->wedge_count, struct lod_vec3) : NULL;
  if (mesh->normals == NULL || sum == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 n = face_normal(mesh, t); /* as long as twice the area */
    for (int k = 0; k < 3; k++)
      sum[mesh->corners[t][k]] = lod_vec3_add(sum[mesh->corners[t][k]], n);
  }
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    double length = lod_vec3_length(sum[w]);
    if (length > 0 && isfinite(length))
      lod_vec3_to_float(lod_vec3_scale(sum[w], 1 / length), mesh->normals[w]);
    else
      memcpy(mesh->normals[w], unit->mesh->normals[wedge_source[w]], sizeof *mesh->normals);
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}
