/* Any bytes as a level's GLB: refused, or meshes with every index in range. The model that they claim to be a level of has two units,
 * three parts and three materials. */
#include <stdint.h>
#include <stdlib.h>

#include "codec/export/glb.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  struct lod_unit units[2] = {{.scale = 1}, {.scale = 1}};
  struct lod_part parts[3] = {{.name = "a", .unit = 0}, {.name = "b", .unit = 0}, {.name = "c", .unit = 1}};
  struct lod_material materials[3] = {{.json = "{}"}, {.json = "{}"}, {.json = "{}"}};
  const struct lod_model model = {
      .unit_count = 2, .units = units, .part_count = 3, .parts = parts, .material_count = 3, .materials = materials};
  struct lod_arena *arena = lod_arena_create(256u << 20);
  struct lod_mesh meshes[2];
  struct lod_problem problem = {0};
  const enum lod_status status = lod_glb_read(data, size, &model, arena, meshes, &problem);
  if ((status == LOD_OK) != (problem.status == LOD_OK))
    abort();
  for (int u = 0; u < 2 && status == LOD_OK; u++) {
    for (uint32_t t = 0; t < meshes[u].triangle_count; t++) {
      if (meshes[u].parts[t] >= 3 || (meshes[u].materials[t] >= 3 && meshes[u].materials[t] != LOD_NONE))
        abort();
      for (int c = 0; c < 3; c++)
        if (meshes[u].triangles[t][c] >= meshes[u].vertex_count ||
            (meshes[u].corners != NULL && meshes[u].corners[t][c] >= meshes[u].wedge_count))
          abort();
    }
    for (uint32_t e = 0; e < meshes[u].edge_count; e++)
      if (meshes[u].edges[e][0] >= meshes[u].vertex_count || meshes[u].edges[e][1] >= meshes[u].vertex_count)
        abort();
    for (uint32_t p = 0; p < meshes[u].point_count; p++)
      if (meshes[u].points[p] >= meshes[u].vertex_count)
        abort();
  }
  lod_arena_destroy(arena);
  return 0;
}
