#include "codec/stream/units.h"

#include <math.h>
#include <string.h>

#include "codec/stream/bytes.h"

static const uint8_t kMagic[4] = {'L', 'O', 'D', 'U'};
enum { FLAG_SMOOTH = 1 };

/* ---- the index ---- */

enum lod_status lod_units_index_bytes(const uint8_t *bytes, size_t size, size_t *index_bytes, struct lod_problem *problem) {
  struct lod_reader r = {.at = bytes + sizeof kMagic, .end = bytes + size};
  *index_bytes = 0;
  if (size < LOD_UNITS_INDEX_HEAD)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "An index of units of %zu bytes ends inside its head.", size);
  if (memcmp(bytes, kMagic, sizeof kMagic) != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units begins with the letters LODU; these bytes do not.");
  const uint32_t version = lod_read_fixed(&r, 1), flags = lod_read_fixed(&r, 1), length = lod_read_fixed(&r, 4);
  if (version != LOD_UNITS_VERSION || (flags & ~(uint32_t)FLAG_SMOOTH) != 0)
    return lod_fail(problem, LOD_UNSUPPORTED, "units-version", "An index of units has version %u, flags %u; version %d is known.", version,
                    flags, LOD_UNITS_VERSION);
  if (length < LOD_UNITS_INDEX_HEAD + 4 || length > LOD_UNITS_INDEX_MOST)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units declares that it has %u bytes, which cannot be.", length);
  *index_bytes = length;
  return LOD_OK;
}

static enum lod_status read_index(const uint8_t *bytes, size_t size, struct lod_units_header *h, struct lod_reader *r,
                                  struct lod_problem *problem) {
  LOD_TRY(lod_units_index_bytes(bytes, size, &h->index_bytes, problem));
  if (size < h->index_bytes)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "An index of units needs %zu bytes; there are %zu.", h->index_bytes, size);
  *r = (struct lod_reader){.at = bytes + h->index_bytes - 4, .end = bytes + h->index_bytes};
  const uint32_t crc = lod_read_fixed(r, 4);
  *r = (struct lod_reader){.at = bytes + LOD_UNITS_INDEX_HEAD, .end = bytes + h->index_bytes - 4};
  if (lod_crc32(bytes, h->index_bytes - 4) != crc)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units is damaged: its checksum is not that of its bytes.");
  h->version = LOD_UNITS_VERSION;
  h->smooth = (bytes[5] & FLAG_SMOOTH) != 0;
  uint32_t *const counts[] = {&h->from,     &h->to,        &h->unit,           &h->unit_count, &h->base_vertices,
                              &h->vertices, &h->triangles, &h->most_triangles, &h->patch_count};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    *counts[i] = lod_read_varint(r);
  h->base_checksum = lod_read_fixed(r, 4);
  h->checksum = lod_read_fixed(r, 4);
  bool good = true;
  for (int i = 0; i < 3; i++) {
    h->grid.origin[i] = lod_read_float(r);
    good = good && h->grid.origin[i] >= -3e38f && h->grid.origin[i] <= 3e38f;
  }
  h->grid.step = lod_read_float(r);
  good = good && h->grid.step > 0 && h->grid.step <= 3e38f && h->most_triangles > 0 && h->unit < h->unit_count;
  if (!good || r->failed || h->patch_count > (size_t)(r->end - r->at) / 3 || h->triangles > UINT32_MAX / 6)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units declares %u patches, or a grid or unit, that cannot be.",
                    h->patch_count);
  return LOD_OK;
}

static enum lod_status read_patches(struct lod_units *units, struct lod_reader *r, struct lod_problem *problem) {
  struct lod_units_header *h = &units->header;
  uint64_t vertices = 0, triangles = 0;
  h->size = h->index_bytes;
  h->primer_patch = LOD_NONE;
  for (uint32_t p = 0; p < h->patch_count; p++) {
    struct lod_units_patch *patch = &units->patches[p];
    patch->offset = h->size;
    patch->size = lod_read_varint(r);
    patch->vertices = lod_read_varint(r);
    patch->triangles = lod_read_varint(r);
    h->size += patch->size;
    vertices += patch->vertices;
    triangles += patch->triangles;
    if (patch->size != 0 && h->primer_patch == LOD_NONE)
      h->primer_patch = p;
    if ((patch->size == 0) != (patch->triangles == 0) || h->size < patch->offset)
      r->failed = true;
  }
  if (r->failed || r->at != r->end || triangles != h->triangles || vertices < h->vertices || vertices > 3 * triangles)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "The patches of an index of units do not add up to %u vertices and %u triangles.",
                    h->vertices, h->triangles);
  if (h->primer_patch == LOD_NONE)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units has no unit with a frame: there is nothing to decode.");
  return LOD_OK;
}

/* ---- patches ---- */

static void measure(const struct lod_mesh *base, struct lod_units_patch *patch) {
  double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, area = 0;
  for (uint32_t k = 0; k < patch->coarse_count; k++) {
    struct lod_vec3 p[3];
    for (int i = 0; i < 3; i++) {
      const float *at = base->positions[base->triangles[patch->coarse[k]][i]];
      p[i] = lod_vec3_from_float(at);
      for (int axis = 0; axis < 3; axis++) {
        low[axis] = fmin(low[axis], (double)at[axis]);
        high[axis] = fmax(high[axis], (double)at[axis]);
      }
    }
    const struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
    patch->normal[0] += n.x;
    patch->normal[1] += n.y;
    patch->normal[2] += n.z;
    area += lod_vec3_length(n);
  }
  for (int axis = 0; axis < 3; axis++) {
    patch->center[axis] = (low[axis] + high[axis]) / 2;
    patch->normal[axis] = area > 0 ? patch->normal[axis] / area : 0;
  }
  const struct lod_vec3 center = lod_vec3_make(patch->center[0], patch->center[1], patch->center[2]);
  for (uint32_t k = 0; k < patch->coarse_count; k++)
    for (int i = 0; i < 3; i++)
      patch->radius =
          fmax(patch->radius, lod_vec3_distance(center, lod_vec3_from_float(base->positions[base->triangles[patch->coarse[k]][i]])));
}

static enum lod_status find_patches(struct lod_units *units, struct lod_arena *arena, struct lod_problem *problem) {
  const struct lod_units_header *h = &units->header;
  const struct lod_mesh *base = units->base;
  uint32_t *patch, count, *list = LOD_NEW(arena, base->triangle_count, uint32_t), checksum = 0;
  if (list == NULL)
    return LOD_MEMORY;
  if (base->vertex_count == h->base_vertices)
    LOD_TRY(lod_delta_checksum(base, arena, &checksum));
  if (base->vertex_count != h->base_vertices || checksum != h->base_checksum)
    return lod_fail(problem, LOD_BAD_INPUT, "wrong-base",
                    "Units start from a level of %u vertices with checksum %08x; this one has %u vertices and checksum %08x.",
                    h->base_vertices, h->base_checksum, base->vertex_count, checksum);
  LOD_TRY(lod_units_partition(base, &h->grid, h->most_triangles, arena, &patch, &count));
  if (count != h->patch_count)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "An index of units declares %u patches; the level that it starts from has %u.",
                    h->patch_count, count);
  for (uint32_t t = 0; t < base->triangle_count; t++)
    units->patches[patch[t]].coarse_count++;
  for (uint32_t p = 0, at = 0; p < count; p++) {
    units->patches[p].coarse = list + at;
    at += units->patches[p].coarse_count;
    units->patches[p].coarse_count = 0;
  }
  for (uint32_t t = 0; t < base->triangle_count; t++) {
    struct lod_units_patch *p = &units->patches[patch[t]];
    list[(size_t)(p->coarse - list) + p->coarse_count++] = t;
  }
  for (uint32_t p = 0; p < count; p++)
    measure(base, &units->patches[p]);
  return LOD_OK;
}

enum lod_status lod_units_open(const uint8_t *bytes, size_t size, const struct lod_mesh *base, const struct lod_delta_limits *limits,
                               struct lod_arena *arena, struct lod_units *units, struct lod_problem *problem) {
  struct lod_reader r;
  struct lod_units_header h = {0};
  *units = (struct lod_units){0};
  LOD_TRY(read_index(bytes, size, &h, &r, problem));
  if (limits != NULL && ((limits->max_vertices != 0 && h.vertices > limits->max_vertices) ||
                         (limits->max_triangles != 0 && h.triangles > limits->max_triangles)))
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "Units declare %u vertices and %u triangles, more than the limit.", h.vertices,
                    h.triangles);
  *units = (struct lod_units){.header = h, .base = base, .patches = LOD_NEW_ZERO(arena, h.patch_count, struct lod_units_patch)};
  enum lod_status status = units->patches == NULL ? LOD_MEMORY : read_patches(units, &r, problem);
  if (status == LOD_OK)
    status = find_patches(units, arena, problem);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

/* ---- frames ---- */

static enum lod_status decode(struct lod_units *units, uint32_t p, const uint8_t *bytes, size_t size, const struct lod_delta_limits *limits,
                              struct lod_arena *arena, struct lod_arena *scratch, struct lod_delta_level *level,
                              struct lod_problem *problem) {
  const struct lod_units_patch *patch = &units->patches[p];
  const struct lod_units_header *h = &units->header;
  struct lod_mesh part;
  uint32_t *vertices, *kept = LOD_NEW(arena, 3 * (size_t)patch->coarse_count, uint32_t);
  if (kept == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_units_part(units->base, patch->coarse, patch->coarse_count, scratch, &part, &vertices));
  const struct lod_delta_header header = {.from = h->from,
                                          .to = h->to,
                                          .unit = h->unit,
                                          .unit_count = h->unit_count,
                                          .base_vertices = part.vertex_count,
                                          .vertices = patch->vertices,
                                          .triangles = patch->triangles,
                                          .grid = h->grid};
  const bool first = p == h->primer_patch;
  if (size < patch->size)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "Unit %u needs %zu bytes; there are %zu.", p, patch->size, size);
  if (!first && units->primer == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "wrong-primer", "Unit %u begins with what unit %u has taught, which has not been decoded.", p,
                    h->primer_patch);
  LOD_TRY(lod_delta_decode_part(bytes, patch->size, &header, &part, limits, first ? NULL : units->primer, arena,
                                first && units->primer == NULL ? &units->primer : NULL, level, problem));
  for (uint32_t k = 0; k < 3 * patch->coarse_count; k++)
    kept[k] = level->kept[part.triangles[k / 3][k % 3]];
  level->kept = kept;
  return LOD_OK;
}

enum lod_status lod_units_decode(struct lod_units *units, uint32_t patch, const uint8_t *bytes, size_t size,
                                 const struct lod_delta_limits *limits, struct lod_arena *arena, struct lod_delta_level *level,
                                 struct lod_problem *problem) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  *level = (struct lod_delta_level){0};
  enum lod_status status = LOD_MEMORY;
  if (scratch != NULL)
    status = patch < units->header.patch_count
                 ? decode(units, patch, bytes, size, limits, arena, scratch, level, problem)
                 : lod_fail(problem, LOD_BAD_INPUT, "units", "There is no unit %u; there are %u.", patch, units->header.patch_count);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

/* ---- together ---- */

struct joining {
  struct lod_mesh all; /* one behind the other, not welded */
  uint32_t *begin;     /* patch -> its first vertex */
  bool whole;
};

static enum lod_status reserve(const struct lod_units *units, const struct lod_delta_level *const *levels, struct lod_arena *scratch,
                               struct joining *j) {
  struct lod_mesh *all = &j->all;
  bool uvs[LOD_UV_SETS] = {false}, colors = false, normals = false;
  j->begin = LOD_NEW(scratch, units->header.patch_count, uint32_t);
  j->whole = true;
  for (uint32_t p = 0; p < units->header.patch_count; p++) {
    const struct lod_mesh *mesh = levels[p] == NULL ? NULL : &levels[p]->mesh;
    j->whole = j->whole && (mesh != NULL || units->patches[p].size == 0);
    if (mesh == NULL)
      continue;
    all->vertex_count += mesh->vertex_count;
    all->triangle_count += mesh->triangle_count;
    all->wedge_count += mesh->wedge_count;
    colors = colors || mesh->colors != NULL;
    normals = normals || mesh->normals != NULL;
    for (int set = 0; set < LOD_UV_SETS; set++)
      uvs[set] = uvs[set] || mesh->uvs[set] != NULL;
  }
  all->positions = lod_arena_alloc(scratch, all->vertex_count, sizeof *all->positions);
  all->triangles = lod_arena_alloc(scratch, all->triangle_count, sizeof *all->triangles);
  all->materials = LOD_NEW(scratch, all->triangle_count, uint32_t);
  all->parts = LOD_NEW(scratch, all->triangle_count, uint32_t);
  bool good = j->begin != NULL && all->positions != NULL && all->triangles != NULL && all->materials != NULL && all->parts != NULL;
  if (all->wedge_count == 0)
    return good ? LOD_OK : LOD_MEMORY;
  all->corners = lod_arena_alloc(scratch, all->triangle_count, sizeof *all->corners);
  all->wedge_vertex = LOD_NEW(scratch, all->wedge_count, uint32_t);
  good = good && all->corners != NULL && all->wedge_vertex != NULL;
  all->colors = colors ? lod_arena_calloc(scratch, all->wedge_count, sizeof *all->colors) : NULL;
  all->normals = normals && !units->header.smooth ? lod_arena_calloc(scratch, all->wedge_count, sizeof *all->normals) : NULL;
  good = good && (!colors || all->colors != NULL) && (!normals || units->header.smooth || all->normals != NULL);
  for (int set = 0; set < LOD_UV_SETS; set++) {
    all->uvs[set] = uvs[set] ? lod_arena_calloc(scratch, all->wedge_count, sizeof *all->uvs[set]) : NULL;
    good = good && (!uvs[set] || all->uvs[set] != NULL);
  }
  return good ? LOD_OK : LOD_MEMORY;
}

static void copy_rows(void *to, const void *from, size_t at, uint32_t count, size_t size) {
  if (to != NULL && from != NULL && count != 0)
    memcpy((char *)to + at * size, from, count * size);
}

static bool append(struct joining *j, const struct lod_mesh *mesh, uint32_t vertex, uint32_t triangle, uint32_t wedge) {
  struct lod_mesh *all = &j->all;
  copy_rows(all->positions, mesh->positions, vertex, mesh->vertex_count, sizeof *all->positions);
  copy_rows(all->materials, mesh->materials, triangle, mesh->triangle_count, sizeof *all->materials);
  copy_rows(all->parts, mesh->parts, triangle, mesh->triangle_count, sizeof *all->parts);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int i = 0; i < 3; i++)
      all->triangles[triangle + t][i] = mesh->triangles[t][i] + vertex;
  if (all->wedge_count == 0)
    return true;
  if (mesh->wedge_count == 0 && mesh->triangle_count != 0)
    return false;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int i = 0; i < 3; i++)
      all->corners[triangle + t][i] = mesh->corners[t][i] + wedge;
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    all->wedge_vertex[wedge + w] = mesh->wedge_vertex[w] + vertex;
  copy_rows(all->colors, mesh->colors, wedge, mesh->wedge_count, sizeof *all->colors);
  copy_rows(all->normals, mesh->normals, wedge, mesh->wedge_count, sizeof *all->normals);
  for (int set = 0; set < LOD_UV_SETS; set++)
    copy_rows(all->uvs[set], mesh->uvs[set], wedge, mesh->wedge_count, sizeof *all->uvs[set]);
  return true;
}

/* Each of the base's vertices in the joined mesh, each of that mesh's at most once. */
static enum lod_status join_kept(const struct lod_units *units, const struct lod_delta_level *const *levels, const struct joining *j,
                                 const uint32_t *map, struct lod_arena *arena, struct lod_arena *scratch, struct lod_delta_level *joined) {
  uint32_t *kept = LOD_NEW(arena, units->base->vertex_count, uint32_t);
  uint8_t *taken = LOD_NEW_ZERO(scratch, joined->mesh.vertex_count, uint8_t);
  if (kept == NULL || taken == NULL)
    return LOD_MEMORY;
  memset(kept, 0xff, (size_t)units->base->vertex_count * sizeof *kept);
  for (uint32_t p = 0; p < units->header.patch_count; p++)
    for (uint32_t k = 0; levels[p] != NULL && k < 3 * units->patches[p].coarse_count; k++) {
      uint32_t *to = &kept[units->base->triangles[units->patches[p].coarse[k / 3]][k % 3]], local = levels[p]->kept[k];
      if (*to != LOD_NONE || local == LOD_NONE || taken[map[j->begin[p] + local]])
        continue;
      *to = map[j->begin[p] + local];
      taken[*to] = 1;
    }
  joined->kept = kept;
  return LOD_OK;
}

static enum lod_status join(const struct lod_units *units, const struct lod_delta_level *const *levels, struct lod_arena *arena,
                            struct lod_arena *scratch, struct lod_delta_level *joined, struct lod_problem *problem) {
  struct joining j = {0};
  uint32_t *map, vertex = 0, triangle = 0, wedge = 0, checksum;
  LOD_TRY(reserve(units, levels, scratch, &j));
  for (uint32_t p = 0; p < units->header.patch_count; p++) {
    if (levels[p] == NULL)
      continue;
    const struct lod_mesh *mesh = &levels[p]->mesh;
    j.begin[p] = vertex;
    if (!append(&j, mesh, vertex, triangle, wedge))
      return lod_fail(problem, LOD_BAD_INPUT, "units", "Patch %u has no attributes; others have.", p);
    vertex += mesh->vertex_count;
    triangle += mesh->triangle_count;
    wedge += mesh->wedge_count;
  }
  LOD_TRY(lod_mesh_weld(&j.all, arena, &joined->mesh, &map));
  LOD_TRY(join_kept(units, levels, &j, map, arena, scratch, joined));
  if (units->header.smooth && joined->mesh.wedge_count != 0)
    LOD_TRY(lod_units_normals(&joined->mesh, arena, &joined->mesh.normals));
  if (!j.whole)
    return LOD_OK;
  LOD_TRY(lod_delta_checksum(&joined->mesh, scratch, &checksum));
  if (checksum != units->header.checksum)
    return lod_fail(problem, LOD_BAD_INPUT, "units", "All units together are a level with checksum %08x; their index says %08x.", checksum,
                    units->header.checksum);
  return LOD_OK;
}

enum lod_status lod_units_join(const struct lod_units *units, const struct lod_delta_level *const *levels, struct lod_arena *arena,
                               struct lod_delta_level *joined, struct lod_problem *problem) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  *joined = (struct lod_delta_level){0};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : join(units, levels, arena, scratch, joined, problem);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

void lod_units_settle(const struct lod_units *units, const struct lod_delta_level *const *levels, uint32_t *kept) {
  const struct lod_mesh *base = units->base;
  for (uint32_t p = 0; p < units->header.patch_count; p++)
    for (uint32_t k = 0; levels[p] == NULL && units->patches[p].size != 0 && k < units->patches[p].coarse_count; k++)
      for (int i = 0; i < 3; i++)
        kept[base->triangles[units->patches[p].coarse[k]][i]] = LOD_NONE;
}
