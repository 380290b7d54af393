#include "clients/cli/patches.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/stream/patches.h"
#include "core/clod/tessellate.h"

bool cli_is_patches(const char *path) {
  char magic[4];
  FILE *file = fopen(path, "rb");
  bool is = file != NULL && fread(magic, 1, sizeof magic, file) == sizeof magic && memcmp(magic, "LODP", sizeof magic) == 0;
  if (file != NULL)
    fclose(file);
  return is;
}

static enum lod_status read_file(const char *path, struct lod_arena *arena, uint8_t **bytes, size_t *size, struct lod_problem *problem) {
  FILE *file = fopen(path, "rb");
  long length = -1;
  if (file != NULL && fseek(file, 0, SEEK_END) == 0)
    length = ftell(file);
  if (length < 0 || fseek(file, 0, SEEK_SET) != 0) {
    if (file != NULL)
      fclose(file);
    return lod_fail(problem, LOD_IO, "read-failed", "Cannot read %s: %s.", path, strerror(errno));
  }
  *size = (size_t)length;
  *bytes = LOD_NEW(arena, *size, uint8_t);
  size_t got = *bytes == NULL ? 0 : fread(*bytes, 1, *size, file);
  fclose(file);
  if (*bytes == NULL)
    return lod_fail_memory(problem);
  return got == *size ? LOD_OK : lod_fail(problem, LOD_IO, "read-failed", "Cannot read all of %s.", path);
}

/* Positions and triangles of `more` behind those of `mesh`. */
static enum lod_status append(struct lod_arena *arena, struct lod_mesh *mesh, const struct lod_mesh *more) {
  float(*positions)[3] = lod_arena_alloc(arena, (size_t)mesh->vertex_count + more->vertex_count, sizeof *positions);
  uint32_t(*triangles)[3] = lod_arena_alloc(arena, (size_t)mesh->triangle_count + more->triangle_count, sizeof *triangles);
  if (positions == NULL || triangles == NULL)
    return LOD_MEMORY;
  if (mesh->vertex_count > 0)
    memcpy(positions, mesh->positions, mesh->vertex_count * sizeof *positions);
  if (mesh->triangle_count > 0)
    memcpy(triangles, mesh->triangles, mesh->triangle_count * sizeof *triangles);
  if (more->vertex_count > 0)
    memcpy(positions + mesh->vertex_count, more->positions, more->vertex_count * sizeof *positions);
  for (uint32_t t = 0; t < more->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      triangles[mesh->triangle_count + t][k] = more->triangles[t][k] + mesh->vertex_count;
  mesh->positions = positions;
  mesh->triangles = triangles;
  mesh->vertex_count += more->vertex_count;
  mesh->triangle_count += more->triangle_count;
  return LOD_OK;
}

enum lod_status cli_tessellate(const char *path, struct lod_arena *arena, struct lod_mesh *mesh, struct lod_problem *problem) {
  uint8_t *bytes = NULL;
  size_t size = 0, at = 0;
  *mesh = (struct lod_mesh){0};
  LOD_TRY(read_file(path, arena, &bytes, &size, problem));
  while (at < size) {
    struct lod_patches_header header;
    struct lod_patches patches;
    struct lod_tessellation flat;
    struct lod_tessellate_settings settings = lod_tessellate_defaults();
    LOD_TRY(lod_patches_decode(bytes + at, size - at, 0, arena, &header, &patches, problem));
    struct lod_bounds bounds = lod_patches_bounds(&patches);
    double extent = lod_bounds_diagonal(&bounds);
    settings.tolerance = fmax(header.error > 0 ? 0.1 * (double)header.error : 1e-4 * extent, 1e-6 * extent);
    settings.normals = false;
    if (!(settings.tolerance > 0))
      settings.tolerance = 1;
    LOD_TRY(lod_tessellate(&patches, &settings, arena, &flat, problem));
    if (append(arena, mesh, &flat.mesh) != LOD_OK)
      return lod_fail_memory(problem);
    at += header.size;
  }
  return LOD_OK;
}
