#include "clients/cli/deltas.h"

#include <string.h>

#include "codec/stream/units.h"

bool cli_is_delta(const char *path) {
  struct cli_file file;
  if (strcmp(path, "-") == 0 || cli_file_open(path, &file, NULL) != LOD_OK)
    return false;
  bool is = file.size >= 4 && (memcmp(file.bytes, "LODD", 4) == 0 || memcmp(file.bytes, "LODU", 4) == 0);
  cli_file_close(&file);
  return is;
}

/* As many units as the first frame says, without triangles yet. */
static enum lod_status make_model(const struct lod_delta_header *header, struct lod_model *model, struct lod_arena *arena,
                                  struct lod_problem *problem) {
  const uint32_t units = header->unit_count;
  *model = (struct lod_model){.format = "delta", .name = "", .unit_count = units, .part_count = units};
  model->units = LOD_NEW_ZERO(arena, units, struct lod_unit);
  model->parts = LOD_NEW_ZERO(arena, units, struct lod_part);
  double(*identity)[16] = lod_arena_calloc(arena, 1, sizeof *identity);
  if (model->units == NULL || model->parts == NULL || identity == NULL)
    return lod_fail_memory(problem);
  for (int i = 0; i < 4; i++)
    (*identity)[5 * i] = 1;
  for (uint32_t u = 0; u < units; u++) {
    model->units[u].scale = 1;
    model->parts[u] = (struct lod_part){.name = "", .unit = u, .instance_count = 1, .instances = identity};
  }
  return LOD_OK;
}

/* A level's GLB knows fewer materials and parts than the model that it was made of: everything goes to the unit's first part. */
static void retag(struct lod_mesh *mesh, uint32_t unit, const struct lod_model *model) {
  uint32_t part = 0;
  while (part + 1 < model->part_count && model->parts[part].unit != unit)
    part++;
  uint32_t *const lists[] = {mesh->parts, mesh->edge_parts, mesh->point_parts};
  const uint32_t counts[] = {mesh->triangle_count, mesh->edge_count, mesh->point_count};
  for (size_t i = 0; i < sizeof lists / sizeof *lists; i++)
    for (uint32_t k = 0; lists[i] != NULL && k < counts[i]; k++)
      lists[i][k] = part;
  mesh->materials = mesh->edge_materials = mesh->point_materials = NULL;
}

/* All units of a step. */
static enum lod_status join_units(const char *path, const uint8_t *bytes, size_t size, struct lod_model *model, struct lod_arena *arena,
                                  struct lod_problem *problem) {
  struct lod_units units;
  struct lod_delta_level joined;
  if (model->unit_count != 1)
    return lod_fail(problem, LOD_BAD_INPUT, "wrong-base", "%s: units are of a model of one unit; the level before has %u.", path,
                    model->unit_count);
  LOD_TRY(lod_units_open(bytes, size, &model->units[0].mesh, NULL, arena, &units, problem));
  const uint32_t count = units.header.patch_count;
  struct lod_delta_level *levels = LOD_NEW_ZERO(arena, count, struct lod_delta_level);
  const struct lod_delta_level **list = LOD_NEW_ZERO(arena, count, const struct lod_delta_level *);
  if (levels == NULL || list == NULL)
    return lod_fail_memory(problem);
  for (uint32_t p = 0; p < count; p++) {
    const struct lod_units_patch *patch = &units.patches[p];
    if (patch->size == 0)
      continue;
    if (patch->offset > size)
      return lod_fail(problem, LOD_BAD_INPUT, "truncated", "%s ends before unit %u.", path, p);
    LOD_TRY(lod_units_decode(&units, p, bytes + patch->offset, size - patch->offset, NULL, arena, &levels[p], problem));
    list[p] = &levels[p];
  }
  LOD_TRY(lod_units_join(&units, list, arena, &joined, problem));
  retag(&joined.mesh, 0, model);
  model->units[0].mesh = joined.mesh;
  return LOD_OK;
}

static enum lod_status apply(const char *path, const uint8_t *bytes, size_t size, size_t *used, bool based, struct lod_model *model,
                             struct lod_arena *arena, struct lod_problem *problem) {
  struct lod_delta_header header;
  struct lod_delta_level level;
  LOD_TRY(lod_delta_inspect(bytes, size, &header, problem));
  if (!based && header.from == LOD_NONE && model->unit_count == 0)
    LOD_TRY(make_model(&header, model, arena, problem));
  if (header.unit_count != model->unit_count)
    return lod_fail(problem, LOD_BAD_INPUT, "wrong-base", "%s: a delta is for a model of %u units; the level before it has %u.", path,
                    header.unit_count, model->unit_count);
  struct lod_mesh *mesh = &model->units[header.unit].mesh;
  LOD_TRY(lod_delta_decode(bytes, size, header.from == LOD_NONE ? NULL : mesh, NULL, arena, &level, problem));
  retag(&level.mesh, header.unit, model);
  *mesh = level.mesh;
  *used = header.size;
  return LOD_OK;
}

enum lod_status cli_apply_deltas(const char *path, bool based, struct lod_model *model, struct lod_arena *arena,
                                 struct lod_problem *problem) {
  struct cli_file file;
  LOD_TRY(cli_file_open(path, &file, problem));
  enum lod_status status = LOD_OK;
  if (file.size == 0)
    status = lod_fail(problem, LOD_BAD_INPUT, "truncated", "%s is empty; deltas are expected.", path);
  const bool units = file.size >= 4 && memcmp(file.bytes, "LODU", 4) == 0;
  if (units)
    status = join_units(path, file.bytes, file.size, model, arena, problem);
  for (size_t at = 0, used = 0; status == LOD_OK && at < file.size && !units; at += used)
    status = apply(path, file.bytes + at, file.size - at, &used, based, model, arena, problem);
  cli_file_close(&file);
  return status;
}
