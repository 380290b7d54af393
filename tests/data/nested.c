#include "tests/data/nested.h"

#include <stdlib.h>
#include <string.h>

#include "codec/export/draco.h"

static void *need(void *pointer) {
  if (pointer == NULL)
    abort();
  return pointer;
}

struct lod_rounded lod_round_mesh(const struct lod_mesh *mesh, double step, struct lod_arena *arena) {
  struct lod_rounded out = {0};
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  struct lod_mesh copy = *mesh;
  float min[3], max[3];
  for (int i = 0; i < 3; i++) {
    min[i] = (float)bounds.min[i];
    max[i] = (float)bounds.max[i];
  }
  struct lod_draco_grid grid = lod_draco_grid_make(min, max, 3, step);
  memcpy(out.grid.origin, grid.origin, sizeof out.grid.origin);
  out.grid.step = grid.step;
  copy.positions = need(lod_arena_alloc(arena, mesh->vertex_count, sizeof *copy.positions));
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int i = 0; i < 3; i++)
      copy.positions[v][i] = lod_draco_grid_point(&grid, i, lod_draco_grid_index(&grid, i, mesh->positions[v][i]));
  copy.triangles = need(lod_arena_alloc(arena, mesh->triangle_count, sizeof *copy.triangles));
  copy.corners = mesh->corners == NULL ? NULL : need(lod_arena_alloc(arena, mesh->triangle_count, sizeof *copy.corners));
  copy.materials = mesh->materials == NULL ? NULL : need(LOD_NEW(arena, mesh->triangle_count, uint32_t));
  copy.parts = mesh->parts == NULL ? NULL : need(LOD_NEW(arena, mesh->triangle_count, uint32_t));
  copy.triangle_count = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint32_t *v = mesh->triangles[t], k = copy.triangle_count;
    const size_t size = sizeof copy.positions[0];
    if (memcmp(copy.positions[v[0]], copy.positions[v[1]], size) == 0 || memcmp(copy.positions[v[1]], copy.positions[v[2]], size) == 0 ||
        memcmp(copy.positions[v[2]], copy.positions[v[0]], size) == 0)
      continue;
    memcpy(copy.triangles[k], v, sizeof copy.triangles[k]);
    if (copy.corners != NULL)
      memcpy(copy.corners[k], mesh->corners[t], sizeof copy.corners[k]);
    if (copy.materials != NULL)
      copy.materials[k] = mesh->materials[t];
    if (copy.parts != NULL)
      copy.parts[k] = mesh->parts[t];
    copy.triangle_count++;
  }
  if (lod_mesh_weld(&copy, arena, &out.mesh, &out.map) != LOD_OK)
    abort();
  return out;
}

uint32_t *lod_round_kept(const struct lod_rounded *coarse, const struct lod_rounded *fine, const uint32_t *parents, uint32_t parent_count,
                         struct lod_arena *arena) {
  uint32_t *kept = need(LOD_NEW(arena, coarse->mesh.vertex_count, uint32_t));
  uint8_t *taken = need(LOD_NEW_ZERO(arena, fine->mesh.vertex_count, uint8_t));
  memset(kept, 0xff, (size_t)coarse->mesh.vertex_count * sizeof *kept);
  for (uint32_t v = 0; v < parent_count; v++) {
    uint32_t c = coarse->map[v], f = parents[v] == LOD_NONE ? LOD_NONE : fine->map[parents[v]];
    if (c == LOD_NONE || f == LOD_NONE || kept[c] != LOD_NONE || taken[f])
      continue;
    kept[c] = f;
    taken[f] = 1;
  }
  return kept;
}
