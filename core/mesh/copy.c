#include "core/mesh/copy.h"

enum lod_status lod_mesh_copy(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_mesh *copy) {
  *copy = *mesh;
  struct array {
    void **at; /* in the copy: still the original's pointer */
    size_t count, size;
  };
#define ARRAY(field, n)                                                                                                                    \
  { (void **)&copy->field, mesh->n, sizeof *mesh->field }
  const struct array arrays[] = {
      ARRAY(positions, vertex_count),    ARRAY(limits, vertex_count),         ARRAY(triangles, triangle_count),
      ARRAY(corners, triangle_count),    ARRAY(wedge_vertex, wedge_count),    ARRAY(normals, wedge_count),
      ARRAY(uvs[0], wedge_count),        ARRAY(uvs[1], wedge_count),          ARRAY(colors, wedge_count),
      ARRAY(materials, triangle_count),  ARRAY(parts, triangle_count),        ARRAY(edges, edge_count),
      ARRAY(edge_thickness, edge_count), ARRAY(edge_materials, edge_count),   ARRAY(edge_parts, edge_count),
      ARRAY(points, point_count),        ARRAY(point_thickness, point_count), ARRAY(point_materials, point_count),
      ARRAY(point_parts, point_count),
  };
#undef ARRAY
  for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++) {
    if (*arrays[i].at == NULL)
      continue;
    void *to = lod_arena_copy(arena, *arrays[i].at, arrays[i].count * arrays[i].size);
    if (to == NULL)
      return LOD_MEMORY;
    *arrays[i].at = to;
  }
  return LOD_OK;
}
