/* Points on the surface and who is near whom. */
#include <math.h>
#include <string.h>

#include "core/retile/internal.h"

static uint32_t bucket_of(const struct cloud_grid *grid, int64_t x, int64_t y, int64_t z) {
  uint64_t h = (uint64_t)x * 0x9e3779b97f4a7c15u ^ (uint64_t)y * 0xc2b2ae3d27d4eb4fu ^ (uint64_t)z * 0x165667b19e3779f9u;
  h ^= h >> 29;
  h *= 0xbf58476d1ce4e5b9u;
  return (uint32_t)(h >> 32) & grid->mask;
}

static void cell_of(const struct cloud_grid *grid, struct lod_vec3 p, int64_t cell[3]) {
  const double q[3] = {p.x, p.y, p.z};
  for (int i = 0; i < 3; i++)
    cell[i] = (int64_t)floor((q[i] - grid->origin[i]) / grid->cell);
}

enum lod_status cloud_grid_create(const struct cloud_point *points, uint32_t count, double cell, struct lod_arena *arena,
                                  struct cloud_grid *grid) {
  *grid = (struct cloud_grid){.cell = cell};
  uint32_t size = 64;
  while (size < count && size < (1u << 28))
    size *= 2;
  grid->mask = size - 1;
  uint32_t *bucket;
  RETILE_TRY_NEW_ZERO(grid->begin, arena, (size_t)size + 1);
  RETILE_TRY_NEW(grid->members, arena, count);
  RETILE_TRY_NEW(bucket, arena, count);
  if (count != 0) {
    grid->origin[0] = points[0].position.x;
    grid->origin[1] = points[0].position.y;
    grid->origin[2] = points[0].position.z;
  }
  for (uint32_t i = 0; i < count; i++) {
    int64_t c[3];
    cell_of(grid, points[i].position, c);
    bucket[i] = bucket_of(grid, c[0], c[1], c[2]);
    grid->begin[bucket[i]]++;
  }
  for (uint32_t b = 0, sum = 0; b <= size; b++)
    grid->begin[b] = sum += b < size ? grid->begin[b] : 0;
  for (uint32_t i = count; i-- > 0;) {
    struct cloud_member *m = &grid->members[--grid->begin[bucket[i]]];
    const double q[3] = {points[i].position.x, points[i].position.y, points[i].position.z};
    m->point = i;
    for (int k = 0; k < 3; k++) {
      m->at[k] = (float)(q[k] - grid->origin[k]);
      grid->extent = fmax(grid->extent, fabs(q[k] - grid->origin[k]));
    }
  }
  return LOD_OK;
}

float cloud_far_from(const struct cloud_grid *grid, struct lod_vec3 p, double reach, float from[3]) {
  const double q[3] = {p.x, p.y, p.z};
  double extent = grid->extent;
  for (int k = 0; k < 3; k++) {
    from[k] = (float)(q[k] - grid->origin[k]);
    extent = fmax(extent, fabs(q[k] - grid->origin[k]));
  }
  reach += 4e-7 * extent; /* two roundings to float of each coordinate, and those of the sum of squares */
  return (float)(reach * reach * (1 + 1e-5));
}

int cloud_grid_buckets(const struct cloud_grid *grid, struct lod_vec3 p, uint32_t buckets[27]) {
  int64_t c[3];
  int count = 0;
  cell_of(grid, p, c);
  for (int64_t z = -1; z <= 1; z++)
    for (int64_t y = -1; y <= 1; y++)
      for (int64_t x = -1; x <= 1; x++) {
        uint32_t b = bucket_of(grid, c[0] + x, c[1] + y, c[2] + z);
        bool seen = grid->begin[b] == grid->begin[b + 1];
        for (int i = 0; i < count && !seen; i++)
          seen = buckets[i] == b;
        if (!seen)
          buckets[count++] = b;
      }
  return count;
}

bool cloud_neighbours(const struct cloud_point *a, const struct cloud_point *b, double distance_squared) {
  if (lod_vec3_dot(a->normal, b->normal) <= 0)
    return false;
  double height = lod_vec3_dot(lod_vec3_subtract(b->position, a->position), a->normal);
  return height * height < 0.25 * distance_squared || distance_squared == 0;
}

void cloud_place(const struct sheet *sheet, const struct lod_retile_point *at, struct cloud_point *point) {
  point->at = *at;
  point->position = sheet_position(sheet, at);
  point->spacing = sheet_spacing(sheet, at);
  struct lod_vec3 n = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    n = lod_vec3_add_scaled(n, sheet->vertex_normals[sheet->faces[at->face][k]], at->weights[k] * (1.0 / LOD_RETILE_ONE));
  n = lod_vec3_normalize(n);
  /* Beside a crease the face itself knows better. */
  point->normal = lod_vec3_dot(n, sheet->normals[at->face]) < 0.7 ? sheet->normals[at->face] : n;
}
