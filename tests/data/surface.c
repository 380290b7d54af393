#include "tests/data/surface.h"

#include <stdlib.h>
#include <string.h>

static int compare_numbers(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

static int compare_triples(const void *a, const void *b) {
  const uint32_t *x = a, *y = b;
  for (int k = 0; k < 4; k++)
    if (x[k] != y[k])
      return x[k] < y[k] ? -1 : 1;
  return 0;
}

struct lod_topology lod_surface_topology(const struct lod_mesh *mesh, struct lod_arena *arena) {
  struct lod_mesh once = *mesh;
  uint32_t(*sorted)[4] = lod_arena_alloc(arena, mesh->triangle_count, sizeof *sorted);
  once.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *once.triangles);
  once.triangle_count = 0;
  if (sorted == NULL || once.triangles == NULL)
    abort();
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    memcpy(sorted[t], mesh->triangles[t], sizeof mesh->triangles[t]);
    qsort(sorted[t], 3, sizeof sorted[t][0], compare_numbers);
    sorted[t][3] = t;
  }
  qsort(sorted, mesh->triangle_count, sizeof *sorted, compare_triples);
  for (uint32_t i = 0; i < mesh->triangle_count; i++) {
    bool again = i != 0 && memcmp(sorted[i], sorted[i - 1], 3 * sizeof sorted[i][0]) == 0;
    if (!again && sorted[i][0] != sorted[i][1] && sorted[i][1] != sorted[i][2])
      memcpy(once.triangles[once.triangle_count++], mesh->triangles[sorted[i][3]], sizeof *once.triangles);
  }
  struct lod_topology topology;
  if (lod_topology_measure(&once, NULL, arena, &topology) != LOD_OK)
    abort();
  return topology;
}

bool lod_surface_same(const struct lod_topology *a, const struct lod_topology *b) {
  return a->euler == b->euler && a->components == b->components && a->boundary_loops == b->boundary_loops &&
         a->non_manifold_edges == b->non_manifold_edges;
}
