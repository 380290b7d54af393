/* UVs and colours of a changing C-Model: what they cost when patches are merged, how far they are off, and those of one C-LOD. */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"
#include "core/mesh/adjacency.h"

/* Differences of colours and UVs count as lengths where removals are put in order and limited: a texture may slip by kSlip times what the
 * surface may be off; black to white counts as kColors of the diagonal. */
static const double kSlip = 4, kColors = 0.02;

static struct lod_vec3 corner_of(const struct lod_mesh *mesh, uint32_t t, int k) {
  return lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
}

void clod_attributes_begin(struct lod_clod *clod) {
  const struct lod_mesh *mesh = clod->mesh;
  struct lod_patch_attributes *a = &clod->attributes;
  double area = 0, flat = 0;
  if (mesh->corners == NULL)
    return;
  for (int set = 0; set < LOD_UV_SETS; set++)
    a->has_uv[set] = mesh->uvs[set] != NULL;
  a->has_colors = mesh->colors != NULL;
  a->width = lod_patch_attributes_width(a->has_uv, a->has_colors);
  for (uint32_t t = 0; mesh->uvs[0] != NULL && t < mesh->triangle_count; t++) {
    struct lod_vec3 p = corner_of(mesh, t, 0);
    area += lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(corner_of(mesh, t, 1), p), lod_vec3_subtract(corner_of(mesh, t, 2), p)));
    const float *x = mesh->uvs[0][mesh->corners[t][0]], *y = mesh->uvs[0][mesh->corners[t][1]], *z = mesh->uvs[0][mesh->corners[t][2]];
    flat +=
        fabs(((double)y[0] - (double)x[0]) * ((double)z[1] - (double)x[1]) - ((double)y[1] - (double)x[1]) * ((double)z[0] - (double)x[0]));
  }
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  clod->uv_length = flat > 0 ? sqrt(area / flat) / kSlip : 0;
  clod->color_length = kColors * lod_bounds_diagonal(&bounds);
}

static void gather(const struct lod_clod *clod, uint32_t wedge, double out[LOD_PATCH_NUMBERS]) {
  float values[LOD_PATCH_NUMBERS];
  lod_patch_attributes_gather(&clod->attributes, clod->mesh, wedge, values);
  for (uint32_t i = 0; i < clod->attributes.width; i++)
    out[i] = (double)values[i];
}

bool clod_attributes_jump(const struct lod_clod *clod, uint32_t half, uint32_t twin) {
  const struct lod_mesh *mesh = clod->mesh;
  uint32_t ends[2][2] = {{half, lod_half_edge_next(twin)}, {lod_half_edge_next(half), twin}};
  bool jump = false;
  for (int i = 0; i < 2 && clod->attributes.width > 0; i++) {
    float a[LOD_PATCH_NUMBERS], b[LOD_PATCH_NUMBERS];
    lod_patch_attributes_gather(&clod->attributes, mesh, mesh->corners[ends[i][0] / 3][ends[i][0] % 3], a);
    lod_patch_attributes_gather(&clod->attributes, mesh, mesh->corners[ends[i][1] / 3][ends[i][1] % 3], b);
    jump = jump || memcmp(a, b, clod->attributes.width * sizeof *a) != 0;
  }
  return jump;
}

/* Barycentric coordinates of a point of source triangle t: exact at its corners. */
static void place_in_face(const struct lod_mesh *mesh, uint32_t t, struct lod_vec3 p, double out[3]) {
  struct lod_vec3 a = corner_of(mesh, t, 0), b = corner_of(mesh, t, 1), c = corner_of(mesh, t, 2);
  double to[3] = {lod_vec3_distance_squared(p, a), lod_vec3_distance_squared(p, b), lod_vec3_distance_squared(p, c)};
  int nearest = to[0] <= to[1] && to[0] <= to[2] ? 0 : to[1] <= to[2] ? 1 : 2;
  struct lod_vec3 x = lod_vec3_subtract(b, a), y = lod_vec3_subtract(c, a), q = lod_vec3_subtract(p, a);
  double xx = lod_vec3_length_squared(x), xy = lod_vec3_dot(x, y), yy = lod_vec3_length_squared(y), det = xx * yy - xy * xy;
  out[0] = nearest == 0, out[1] = nearest == 1, out[2] = nearest == 2;
  if (to[nearest] == 0 || !(det > 1e-24 * xx * yy))
    return;
  double v = fmin(1, fmax(0, (yy * lod_vec3_dot(q, x) - xy * lod_vec3_dot(q, y)) / det));
  double w = fmin(1 - v, fmax(0, (xx * lod_vec3_dot(q, y) - xy * lod_vec3_dot(q, x)) / det));
  out[0] = 1 - v - w, out[1] = v, out[2] = w;
}

void clod_attributes_off(const struct lod_clod *clod, const uint32_t wedges[3], const struct clod_node *nodes,
                         const struct clod_cell *cells, uint32_t cell_count, double off[2]) {
  const struct lod_patch_attributes *a = &clod->attributes;
  double patch[3][LOD_PATCH_NUMBERS], face[3][LOD_PATCH_NUMBERS];
  off[0] = off[1] = 0;
  if (a->width == 0)
    return;
  for (int k = 0; k < 3; k++)
    gather(clod, wedges[k], patch[k]);
  for (uint32_t c = 0; c < cell_count; c++) {
    for (int k = 0; k < 3; k++)
      gather(clod, clod->mesh->corners[cells[c].face][k], face[k]);
    for (int k = 0; k < 3; k++) {
      const struct clod_node *node = &nodes[cells[c].node[k]];
      struct lod_barycentric at = clod_domain(node);
      double in[3], d[LOD_PATCH_NUMBERS];
      place_in_face(clod->mesh, cells[c].face, clod->points[node->id], in);
      for (uint32_t i = 0; i < a->width; i++)
        d[i] =
            at.u * patch[0][i] + at.v * patch[1][i] + at.w * patch[2][i] - (in[0] * face[0][i] + in[1] * face[1][i] + in[2] * face[2][i]);
      uint32_t i = 0;
      for (int set = 0; set < LOD_UV_SETS; set++)
        if (a->has_uv[set]) {
          off[0] = fmax(off[0], sqrt(d[i] * d[i] + d[i + 1] * d[i + 1]));
          i += 2;
        }
      for (; i < a->width; i++)
        off[1] = fmax(off[1], fabs(d[i]));
    }
  }
}

double clod_attributes_cost(const struct lod_clod *clod, const double off[2]) {
  return fmax(clod->uv_length * off[0], clod->color_length * off[1]);
}

enum lod_status clod_attributes_extract(const struct lod_clod *clod, uint32_t number, struct lod_arena *arena, struct lod_arena *scratch,
                                        struct lod_patch_attributes *out, uint32_t patch_count) {
  *out = clod->attributes;
  if (out->width == 0)
    return LOD_OK;
  uint32_t *map = LOD_NEW(scratch, clod->mesh->wedge_count, uint32_t);
  out->corners = lod_arena_alloc(arena, patch_count, sizeof *out->corners);
  if (map == NULL || out->corners == NULL)
    return LOD_MEMORY;
  memset(map, 0xff, clod->mesh->wedge_count * sizeof *map);
  uint32_t next = 0;
  for (int pass = 0; pass < 2; pass++) {
    for (uint32_t p = 0; p < clod->patch_count; p++) {
      const struct clod_patch *patch = &clod->patches[p];
      if (!(patch->born <= number && number < patch->died))
        continue;
      for (int k = 0; k < 3 && pass == 0; k++) {
        uint32_t *place = &map[patch->wedges[k]];
        *place = *place == LOD_NONE ? out->count++ : *place;
        out->corners[next][k] = *place;
      }
      for (int k = 0; k < 3 && pass == 1; k++)
        lod_patch_attributes_gather(out, clod->mesh, patch->wedges[k], out->values + (size_t)out->width * map[patch->wedges[k]]);
      out->uv_off = fmax(out->uv_off, (double)patch->off[0]);
      out->color_off = fmax(out->color_off, (double)patch->off[1]);
      next++;
    }
    if (pass == 0 && (out->values = LOD_NEW(arena, (size_t)out->count * out->width, float)) == NULL)
      return LOD_MEMORY;
  }
  return LOD_OK;
}
