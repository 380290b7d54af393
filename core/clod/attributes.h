/* UVs and colours of patches: a number for each corner of each patch, linear over its domain.
 *
 * Both patches of an edge may have different numbers there: the edge is a seam, and stays a line. Since fragments (clod.h) correspond
 * linearly, the largest difference from the source at corresponding points is that at their corners: it is known exactly, up to rounding.
 */
#ifndef LOD_CORE_CLOD_ATTRIBUTES_H
#define LOD_CORE_CLOD_ATTRIBUTES_H

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/mesh/mesh.h"

enum { LOD_PATCH_NUMBERS = 2 * LOD_UV_SETS + 4 };

struct lod_patch_attributes {
  bool has_uv[LOD_UV_SETS], has_colors;
  uint32_t width, count;    /* numbers a wedge, in the order UV sets, RGBA; wedges */
  float *values;            /* count * width */
  uint32_t (*corners)[3];   /* patch_count; wedge of each corner. NULL: there are no attributes */
  double uv_off, color_off; /* from the source at corresponding points, at most: UV, length of the difference in any set; colours, largest
                               component. 0 where it is not known */
};

static inline uint32_t lod_patch_attributes_width(const bool has_uv[LOD_UV_SETS], bool has_colors) {
  uint32_t width = has_colors ? 4 : 0;
  for (int set = 0; set < LOD_UV_SETS; set++)
    width += has_uv[set] ? 2 : 0;
  return width;
}

static inline const float *lod_patch_attributes_at(const struct lod_patch_attributes *a, uint32_t patch, uint32_t corner) {
  return a->values + (size_t)a->width * a->corners[patch][corner];
}

/* Whether two wedges have different numbers. */
bool lod_patch_attributes_differ(const struct lod_patch_attributes *a, uint32_t wedge, uint32_t other);

/* Whether numbers jump across side `side` of a patch; partner: 3 * patch + side across it, or LOD_NONE. */
bool lod_patch_attributes_jump(const struct lod_patch_attributes *a, uint32_t patch, uint32_t side, uint32_t partner);

/* Copies the numbers of mesh wedge `from` (the mesh has what `a` has) to `out`, or those of a value to mesh wedge `to`. */
void lod_patch_attributes_gather(const struct lod_patch_attributes *a, const struct lod_mesh *mesh, uint32_t from, float *out);
void lod_patch_attributes_scatter(const struct lod_patch_attributes *a, const float *values, struct lod_mesh *mesh, uint32_t to);

/* out = numbers of a patch at barycentric coordinates. */
void lod_patch_attributes_mix(const struct lod_patch_attributes *a, uint32_t patch, const double at[3], float *out);

#endif
