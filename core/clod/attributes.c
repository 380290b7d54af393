#include "core/clod/attributes.h"

#include <string.h>

bool lod_patch_attributes_differ(const struct lod_patch_attributes *a, uint32_t wedge, uint32_t other) {
  return wedge != other &&
         memcmp(a->values + (size_t)a->width * wedge, a->values + (size_t)a->width * other, a->width * sizeof *a->values) != 0;
}

bool lod_patch_attributes_jump(const struct lod_patch_attributes *a, uint32_t patch, uint32_t side, uint32_t partner) {
  if (a->corners == NULL || partner == LOD_NONE)
    return false;
  uint32_t p = partner / 3, k = partner % 3, n = (side + 1) % 3, m = (k + 1) % 3;
  return lod_patch_attributes_differ(a, a->corners[patch][side], a->corners[p][m]) ||
         lod_patch_attributes_differ(a, a->corners[patch][n], a->corners[p][k]);
}

void lod_patch_attributes_gather(const struct lod_patch_attributes *a, const struct lod_mesh *mesh, uint32_t from, float *out) {
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (a->has_uv[set]) {
      memcpy(out, mesh->uvs[set][from], 2 * sizeof *out);
      out += 2;
    }
  if (a->has_colors)
    memcpy(out, mesh->colors[from], 4 * sizeof *out);
}

void lod_patch_attributes_scatter(const struct lod_patch_attributes *a, const float *values, struct lod_mesh *mesh, uint32_t to) {
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (a->has_uv[set]) {
      memcpy(mesh->uvs[set][to], values, 2 * sizeof *values);
      values += 2;
    }
  if (a->has_colors)
    memcpy(mesh->colors[to], values, 4 * sizeof *values);
}

void lod_patch_attributes_mix(const struct lod_patch_attributes *a, uint32_t patch, const double at[3], float *out) {
  const float *x = lod_patch_attributes_at(a, patch, 0), *y = lod_patch_attributes_at(a, patch, 1),
              *z = lod_patch_attributes_at(a, patch, 2);
  for (uint32_t i = 0; i < a->width; i++)
    out[i] = (float)(at[0] * (double)x[i] + at[1] * (double)y[i] + at[2] * (double)z[i]);
}
