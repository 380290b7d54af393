#include "core/envelope/envelope.h"

#include <math.h>

#include "core/mesh/adjacency.h"

/* Whether the attributes at one end of an edge jump from one side to the other. */
static bool attributes_jump(const struct lod_mesh *mesh, uint32_t a, uint32_t b, double least_dot) {
  if (a == b)
    return false;
  for (int k = 0; k < LOD_UV_SETS; k++)
    if (mesh->uvs[k] != NULL && (mesh->uvs[k][a][0] != mesh->uvs[k][b][0] || mesh->uvs[k][a][1] != mesh->uvs[k][b][1]))
      return true;
  if (mesh->normals == NULL)
    return false;
  const float *m = mesh->normals[a], *n = mesh->normals[b];
  return (double)m[0] * (double)n[0] + (double)m[1] * (double)n[1] + (double)m[2] * (double)n[2] < least_dot;
}

static bool is_feature(const struct lod_mesh *mesh, uint32_t h, uint32_t twin, double least_dot) {
  if (twin == LOD_NONE)
    return true;
  uint32_t t = h / 3, u = twin / 3;
  if (mesh->materials != NULL && mesh->materials[t] != mesh->materials[u])
    return true;
  if (mesh->parts != NULL && mesh->parts[t] != mesh->parts[u])
    return true;
  if (mesh->wedge_count == 0)
    return false;
  return attributes_jump(mesh, mesh->corners[t][h % 3], mesh->corners[u][(twin % 3 + 1) % 3], least_dot) ||
         attributes_jump(mesh, mesh->corners[t][(h % 3 + 1) % 3], mesh->corners[u][twin % 3], least_dot);
}

enum lod_status lod_envelope_features(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *arena, uint8_t **features) {
  *features = LOD_NEW_ZERO(arena, mesh->triangle_count, uint8_t);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency adjacency;
  if (*features == NULL || scratch == NULL || lod_adjacency_create_edges(mesh, scratch, &adjacency) != LOD_OK) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double least_dot = cos(crease_degrees * 0.017453292519943295);
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
    if (adjacency.edge_of[h] != LOD_NONE && is_feature(mesh, h, adjacency.twin[h], least_dot))
      (*features)[h / 3] |= (uint8_t)(1 << h % 3);
  lod_arena_destroy(scratch);
  return LOD_OK;
}
