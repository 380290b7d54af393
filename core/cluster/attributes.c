/* Attributes of a level: every corner finds its wedge in the source, nothing is averaged through levels.
 *
 * A level triangle stands for a source triangle, its corner for a corner of that, whose wedge lies on some chart. The level's corner takes
 * the wedge that the cell's centre has on that chart; of several, the one whose normal is nearest to the corner's. When the centre has
 * none there (its chart is too small to be kept apart), the corner's own wedge is taken: texture then shifts within the cell, but
 * never jumps across the atlas. Level wedges are the distinct pairs of cell and source wedge; a triangle of a flat-shaded part adds the
 * direction of its plane, so that only coplanar neighbours share one. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

struct wedge {
  uint32_t cell, source;
  uint32_t plane; /* direction of a flat-shaded triangle, 0 else */
};

struct wedge_table {
  uint32_t mask, count;
  uint32_t *slots;
  struct wedge *wedges;
};

static uint32_t intern_wedge(struct wedge_table *table, struct wedge wedge) {
  uint64_t hash = cluster_hash(cluster_hash((uint64_t)wedge.cell << 32 | wedge.source) + wedge.plane);
  for (uint32_t slot = (uint32_t)hash & table->mask;; slot = (slot + 1) & table->mask) {
    uint32_t id = table->slots[slot];
    if (id == LOD_NONE) {
      table->slots[slot] = table->count;
      table->wedges[table->count] = wedge;
      return table->count++;
    }
    const struct wedge *w = &table->wedges[id];
    if (w->cell == wedge.cell && w->source == wedge.source && w->plane == wedge.plane)
      return id;
  }
}

static float normal_match(const struct lod_mesh *mesh, uint32_t a, uint32_t b) {
  const float *m = mesh->normals[a], *n = mesh->normals[b];
  return m[0] * n[0] + m[1] * n[1] + m[2] * n[2];
}

static uint32_t source_wedge(const struct cluster_unit *unit, uint32_t centre, uint32_t corner_wedge) {
  const struct lod_mesh *mesh = unit->mesh;
  const struct cluster_wedges *wedges = &unit->wedges;
  if (mesh->wedge_vertex[corner_wedge] == centre)
    return corner_wedge;
  uint32_t best = corner_wedge;
  float match = -INFINITY;
  for (uint32_t i = wedges->begin[centre]; i < wedges->begin[centre + 1]; i++) {
    uint32_t w = wedges->list[i];
    if (wedges->chart != NULL && wedges->chart[w] != wedges->chart[corner_wedge])
      continue;
    float m = mesh->normals != NULL ? normal_match(mesh, w, corner_wedge) : 0;
    if (m > match) {
      match = m;
      best = w;
    }
  }
  return best;
}

/* A plane's direction to about 0.05 degrees, never 0. */
static uint32_t plane_code(const struct lod_mesh *mesh, const uint32_t triangle[3]) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[triangle[k]]);
  struct lod_vec3 n = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
  if (!isfinite(n.x + n.y + n.z))
    return 1;
  uint32_t x = (uint32_t)lround(n.x * 511 + 512), y = (uint32_t)lround(n.y * 511 + 512), z = (uint32_t)lround(n.z * 511 + 512);
  return (x << 20 | y << 10 | z) + 1;
}

static enum lod_status make_wedges(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                   const struct cluster_synthesis *synthesis, struct lod_arena *arena, struct lod_arena *scratch,
                                   struct lod_mesh *mesh, struct wedge_table *table) {
  const struct lod_mesh *source = unit->mesh;
  uint64_t most = 3 * (uint64_t)mesh->triangle_count;
  uint32_t size = cluster_power_of_two(most + most / 2);
  table->mask = size - 1;
  table->slots = LOD_NEW(scratch, size, uint32_t);
  table->wedges = LOD_NEW(scratch, most, struct wedge);
  mesh->corners = lod_arena_alloc(arena, mesh->triangle_count, sizeof *mesh->corners);
  if (table->slots == NULL || table->wedges == NULL || mesh->corners == NULL)
    return LOD_MEMORY;
  memset(table->slots, 0xff, size * sizeof *table->slots);
  for (uint32_t i = 0; i < mesh->triangle_count; i++) {
    uint32_t t = synthesis->triangle_source[i];
    bool flat = unit->wedges.flat_part != NULL && unit->wedges.flat_part[source->parts != NULL ? source->parts[t] : 0];
    uint32_t plane = flat ? plane_code(mesh, mesh->triangles[i]) : 0;
    for (int k = 0; k < 3; k++) {
      uint32_t cell = mesh->triangles[i][k], corner = 0;
      while (corner < 2 && cells->image[unit->triangles[t][corner]] != cell)
        corner++;
      uint32_t w = source_wedge(unit, unit->source[cells->centre[cell]], source->corners[t][corner]);
      mesh->corners[i][k] = intern_wedge(table, (struct wedge){cell, w, plane});
    }
  }
  return LOD_OK;
}

static enum lod_status copy_attributes(const struct cluster_unit *unit, const struct wedge_table *table, struct lod_arena *arena,
                                       struct lod_arena *scratch, struct lod_mesh *mesh) {
  const struct lod_mesh *source = unit->mesh;
  uint32_t count = table->count;
  mesh->wedge_count = count;
  mesh->wedge_vertex = LOD_NEW(arena, count, uint32_t);
  uint32_t *wedge_source = LOD_NEW(scratch, count, uint32_t);
  if (mesh->wedge_vertex == NULL || wedge_source == NULL)
    return LOD_MEMORY;
  for (uint32_t w = 0; w < count; w++) {
    mesh->wedge_vertex[w] = table->wedges[w].cell;
    wedge_source[w] = table->wedges[w].source;
  }
  for (int set = 0; set < LOD_UV_SETS; set++) {
    if (source->uvs[set] == NULL)
      continue;
    mesh->uvs[set] = lod_arena_alloc(arena, count, sizeof *mesh->uvs[set]);
    if (mesh->uvs[set] == NULL)
      return LOD_MEMORY;
    for (uint32_t w = 0; w < count; w++)
      memcpy(mesh->uvs[set][w], source->uvs[set][wedge_source[w]], sizeof *mesh->uvs[set]);
  }
  if (source->colors != NULL) {
    mesh->colors = lod_arena_alloc(arena, count, sizeof *mesh->colors);
    if (mesh->colors == NULL)
      return LOD_MEMORY;
    for (uint32_t w = 0; w < count; w++)
      memcpy(mesh->colors[w], source->colors[wedge_source[w]], sizeof *mesh->colors);
  }
  return source->normals != NULL ? cluster_adjust_normals(unit, wedge_source, arena, mesh) : LOD_OK;
}

/* *out = tag of each primitive by where it came from; `sources` are arrays of the source's triangles, edges and points, in that order. */
static enum lod_status copy_tags(const struct lod_mesh *source, uint32_t *const sources[3], uint32_t none, const uint32_t *from,
                                 uint32_t count, struct lod_arena *arena, uint32_t **out) {
  *out = NULL;
  if (sources[0] == NULL && sources[1] == NULL && sources[2] == NULL)
    return LOD_OK;
  *out = LOD_NEW(arena, count, uint32_t);
  if (*out == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++) {
    uint32_t id = from[i];
    int kind = id < source->triangle_count ? 0 : id - source->triangle_count < source->edge_count ? 1 : 2;
    id -= kind == 0 ? 0 : kind == 1 ? source->triangle_count : source->triangle_count + source->edge_count;
    (*out)[i] = sources[kind] != NULL ? sources[kind][id] : none;
  }
  return LOD_OK;
}

enum lod_status cluster_attribute(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                  const struct cluster_synthesis *synthesis, struct lod_arena *arena, struct lod_mesh *mesh) {
  const struct lod_mesh *source = unit->mesh;
  uint32_t *const materials[3] = {source->materials, source->edge_materials, source->point_materials};
  uint32_t *const parts[3] = {source->parts, source->edge_parts, source->point_parts};
  LOD_TRY(copy_tags(source, materials, LOD_NONE, synthesis->triangle_source, mesh->triangle_count, arena, &mesh->materials));
  LOD_TRY(copy_tags(source, materials, LOD_NONE, synthesis->edge_source, mesh->edge_count, arena, &mesh->edge_materials));
  LOD_TRY(copy_tags(source, materials, LOD_NONE, synthesis->point_source, mesh->point_count, arena, &mesh->point_materials));
  LOD_TRY(copy_tags(source, parts, 0, synthesis->triangle_source, mesh->triangle_count, arena, &mesh->parts));
  LOD_TRY(copy_tags(source, parts, 0, synthesis->edge_source, mesh->edge_count, arena, &mesh->edge_parts));
  LOD_TRY(copy_tags(source, parts, 0, synthesis->point_source, mesh->point_count, arena, &mesh->point_parts));
  if (source->wedge_count == 0 || mesh->triangle_count == 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct wedge_table table = {0};
  enum lod_status status = scratch != NULL ? make_wedges(unit, cells, synthesis, arena, scratch, mesh, &table) : LOD_MEMORY;
  if (status == LOD_OK)
    status = copy_attributes(unit, &table, arena, scratch, mesh);
  lod_arena_destroy(scratch);
  return status;
}
