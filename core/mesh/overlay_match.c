/* Which vertices of two levels are the same, for levels that come without parents. */
#include <string.h>

#include "core/mesh/overlay_private.h"

struct cells {
  double size;
  uint32_t mask, *begin, *members;
};

static uint32_t bucket_of(const struct cells *c, int64_t x, int64_t y, int64_t z) {
  uint64_t hash = (uint64_t)x * 0x9e3779b97f4a7c15u ^ (uint64_t)y * 0xc2b2ae3d27d4eb4fu ^ (uint64_t)z * 0x165667b19e3779f9u;
  return (uint32_t)(hash >> 32) & c->mask;
}

static void cell_of(const struct cells *c, const float p[3], int64_t cell[3]) {
  for (int k = 0; k < 3; k++) {
    double x = (double)p[k] / c->size;
    cell[k] = (int64_t)x - (x < 0);
  }
}

static enum lod_status fill_cells(struct cells *c, const struct lod_mesh *mesh, double size, struct lod_arena *arena) {
  uint32_t buckets = 64;
  while (buckets < mesh->vertex_count && buckets < 1u << 30)
    buckets *= 2;
  c->size = size;
  c->mask = buckets - 1;
  OVERLAY_TRY_ZERO(c->begin, arena, (size_t)buckets + 2);
  OVERLAY_TRY_NEW(c->members, arena, mesh->vertex_count);
  for (int pass = 0; pass < 2; pass++) {
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
      int64_t cell[3];
      cell_of(c, mesh->positions[v], cell);
      uint32_t b = bucket_of(c, cell[0], cell[1], cell[2]);
      if (pass == 0)
        c->begin[b + 2]++;
      else
        c->members[c->begin[b + 1]++] = v;
    }
    for (uint32_t b = 0; pass == 0 && b <= buckets; b++)
      c->begin[b + 1] += c->begin[b];
  }
  return LOD_OK;
}

static uint32_t nearest(const struct cells *c, const struct lod_mesh *mesh, const float p[3], double reach) {
  int64_t cell[3];
  double best = reach * reach;
  uint32_t found = LOD_NONE;
  struct lod_vec3 at = lod_vec3_from_float(p);
  cell_of(c, p, cell);
  for (int64_t i = 0; i < 27; i++) {
    uint32_t b = bucket_of(c, cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1);
    for (uint32_t k = c->begin[b]; k < c->begin[b + 1]; k++) {
      double distance = lod_vec3_distance_squared(at, overlay_at(mesh, c->members[k]));
      if (distance < best || (distance == best && (found == LOD_NONE || c->members[k] < found))) {
        best = distance;
        found = c->members[k];
      }
    }
  }
  return found;
}

enum lod_status lod_overlay_match(const struct lod_mesh *coarse, const struct lod_mesh *fine, double reach, struct lod_arena *arena,
                                  uint32_t *parents) {
  struct cells of_fine, of_coarse;
  /* So that a cell's number fits and neighbours within reach lie in neighbouring cells. */
  double size = fmax(reach, 1e-9 * fmax(lod_mesh_magnitude(coarse), lod_mesh_magnitude(fine)));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (!(size > 0))
    size = 1;
  if (status == LOD_OK)
    status = fill_cells(&of_fine, fine, size, scratch);
  if (status == LOD_OK)
    status = fill_cells(&of_coarse, coarse, size, scratch);
  for (uint32_t v = 0; status == LOD_OK && v < coarse->vertex_count; v++) {
    uint32_t to = nearest(&of_fine, fine, coarse->positions[v], reach);
    parents[v] = to != LOD_NONE && nearest(&of_coarse, coarse, fine->positions[to], reach) == v ? to : LOD_NONE;
  }
  lod_arena_destroy(scratch);
  return status;
}
