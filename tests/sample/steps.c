/* Nested levels as deltas, with the hashes that decoding them and laying them over one another give natively:
 *
 *   steps DIR               Writes DIR/NAME-K.delta (frame K; 0 is the first picture), of levels from generators and of the shared models
 *                           where they are. A line of JSON for each: {"file", "level", "map", "vertices", "triangles"}; where the step
 *                           has units, also DIR/NAME-units-K.delta, with "units": {"count", "half", "drawn", "all"}: of the first half of
 *                           them what they are together and what is drawn of it, and of all.
 *   steps --decode FILE...  Reads objects of a bake: a first picture, then its steps, each behind the file of its units where it has some;
 *                           a PLY is a level to begin anew from. A line for each frame: {"unit", "level", "map", "failed", "vertices"},
 *                           and for units as above.
 *
 * tests/web/wasm.test.mjs and corpus.test.mjs do the same in WebAssembly. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#pragma GCC diagnostic ignored "-Wmissing-prototypes"
#include "clients/web/src/wasm/module.c"
#include "core/retile/retile.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static void must(bool good, const char *what) {
  if (!good) {
    fprintf(stderr, "steps: %s: %s\n", what, problem.detail);
    exit(1);
  }
}

/* Onto a grid of a power of two, 2^15 steps across or a little more. */
static struct lod_delta_grid quantise(struct lod_mesh *mesh) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  int exponent;
  frexp(lod_bounds_diagonal(&bounds) / 32768, &exponent);
  struct lod_delta_grid grid = {.step = (float)ldexp(1, exponent)};
  for (int k = 0; k < 3; k++)
    grid.origin[k] = (float)(floor(bounds.min[k] / (double)grid.step) * (double)grid.step);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int k = 0; k < 3; k++) {
      float q = (float)floor(((double)mesh->positions[v][k] - (double)grid.origin[k]) / (double)grid.step + 0.5);
      mesh->positions[v][k] = grid.origin[k] + grid.step * q;
    }
  return grid;
}

static void write_file(const char *folder, const char *name, uint32_t number, const uint8_t *bytes, size_t size) {
  char path[4300];
  snprintf(path, sizeof path, "%.4000s/%.200s-%u.delta", folder, name, number);
  FILE *file = fopen(path, "wb");
  must(file != NULL && fwrite(bytes, 1, size, file) == size && fclose(file) == 0, path);
}

enum { PATCH = 200 };

/* Decodes units `from` to `to` - 1 as they stand in the stream. */
static void take_units(struct units *u, const uint8_t *bytes, uint32_t from, uint32_t to) {
  for (uint32_t p = from; p < to; p++) {
    const struct lod_units_patch *patch = &u->units.patches[p];
    must(patch->size == 0 || lodw_units_decode(u, p, bytes + patch->offset, patch->size) != 0, "units");
  }
}

/* Members of JSON: how many units, hashes of half of them, of what is drawn of those, of all. */
static void print_units(const char *name, const uint8_t *bytes, size_t size, const struct level *base) {
  struct units *u = lodw_units_open(bytes, size, base);
  must(u != NULL, name);
  const uint32_t count = u->units.header.patch_count;
  take_units(u, bytes, 0, count / 2);
  struct level *half = lodw_units_join(u);
  must(half != NULL, name);
  const uint32_t *words = lodw_units_draw(u, base, half, 0, NULL, NULL);
  must(words != NULL, name);
  uint32_t drawn = mix(0x811c9dc5u, u->morph.start, 3 * (size_t)u->morph.vertex_count);
  drawn = mix(drawn, u->morph.end, 3 * (size_t)u->morph.vertex_count);
  drawn = mix(drawn, u->morph.triangles, 3 * (size_t)u->morph.triangle_count);
  const uint32_t hash = lodw_level_hash(half);
  take_units(u, bytes, count / 2, count);
  struct level *all = lodw_units_join(u);
  must(all != NULL, name);
  printf("\"count\":%u,\"half\":%u,\"drawn\":%u,\"all\":%u", count, hash, drawn, lodw_level_hash(all));
  lodw_level_free(all);
  lodw_level_free(half);
  lodw_units_free(u);
}

static void run_units(const char *folder, const char *name, uint32_t k, const struct lod_delta_encode_request *request,
                      const struct level *base, struct lod_arena *arena) {
  char file[300];
  uint8_t *bytes;
  size_t size;
  must(lod_units_encode(request, PATCH, arena, &bytes, &size, &problem) == LOD_OK, name);
  if (size == 0)
    return;
  snprintf(file, sizeof file, "%.200s-units", name);
  write_file(folder, file, k, bytes, size);
  printf(",\"units\":{\"file\":\"%s-%u.delta\",", file, k);
  print_units(name, bytes, size, base);
  printf("}");
}

static void run(const char *folder, const char *name, const struct lod_mesh *mesh, const uint32_t *counts, uint32_t count) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  struct level *before = NULL;
  settings.vertices = counts;
  settings.level_count = count;
  must(lod_retile_create(mesh, &settings, NULL, arena, &retile, &problem) == LOD_OK, name);
  uint32_t *order = NULL; /* vertex of the level -> vertex as decoded */
  for (uint32_t k = 0; k < count; k++) {
    struct lod_mesh *fine = &retile.levels[k].mesh;
    struct lod_delta_encode_request request = lod_delta_encode_defaults();
    uint8_t *bytes;
    size_t size;
    request.grid = quantise(fine);
    for (int set = 0; set < LOD_UV_SETS; set++)
      for (uint32_t w = 0; w < fine->wedge_count && fine->uvs[set] != NULL; w++)
        for (int i = 0; i < 2; i++) /* as a level's GLB has them */
          fine->uvs[set][w][i] = (float)((int)(fine->uvs[set][w][i] * 4096) / 4096.0);
    request.fine = fine;
    request.from = k == 0 ? LOD_NONE : k - 1;
    request.to = k;
    request.unit_count = 1;
    uint32_t *kept = k == 0 ? NULL : LOD_NEW(arena, before->mesh.vertex_count, uint32_t);
    for (uint32_t v = 0; k > 0 && v < retile.levels[k - 1].mesh.vertex_count; v++)
      kept[order[v]] = retile.levels[k - 1].parents[v];
    request.base = k == 0 ? NULL : &before->mesh;
    request.kept = kept;
    must(lod_delta_encode(&request, arena, &bytes, &size, &problem) == LOD_OK, name);
    write_file(folder, name, k, bytes, size);
    struct level *level = lodw_level_decode(bytes, size, before);
    must(level != NULL, name);
    struct map *map = before == NULL ? NULL : lodw_map_create(before, level, 0);
    must(before == NULL || map != NULL, name);
    printf("{\"file\":\"%s-%u.delta\",\"first\":%s,\"level\":%u,\"map\":%u,\"vertices\":%u,\"triangles\":%u,\"failed\":%u", name, k,
           k == 0 ? "true" : "false", lodw_level_hash(level), map == NULL ? 0 : lodw_map_hash(map), level->mesh.vertex_count,
           level->mesh.triangle_count, map == NULL ? 0 : map->overlay.failed);
    if (before != NULL)
      run_units(folder, name, k, &request, before, arena);
    printf("}\n");
    lodw_map_free(map);
    order = LOD_NEW(arena, fine->vertex_count, uint32_t);
    must(lod_overlay_match(fine, &level->mesh, (double)request.grid.step / 4, arena, order) == LOD_OK, name);
    lodw_level_free(before);
    before = level;
  }
  lodw_level_free(before);
  lod_arena_destroy(arena);
}

/* ---- what a bake has written ---- */

static uint8_t *read_file(const char *path, size_t *size) {
  FILE *file = fopen(path, "rb");
  must(file != NULL && fseek(file, 0, SEEK_END) == 0, path);
  *size = (size_t)ftell(file);
  rewind(file);
  uint8_t *bytes = malloc(*size + 1);
  must(bytes != NULL && fread(bytes, 1, *size, file) == *size, path);
  fclose(file);
  return bytes;
}

/* The frame at `bytes` on its unit of the levels reached; returns its size. */
static size_t decode_frame(const char *path, const uint8_t *bytes, size_t size, struct level ***levels, uint32_t *units) {
  struct lod_delta_header header;
  must(lod_delta_inspect(bytes, size, &header, &problem) == LOD_OK, path);
  if (*levels == NULL) {
    *units = header.unit_count;
    *levels = calloc(*units, sizeof **levels);
  }
  must(*levels != NULL && header.unit < *units, path);
  struct level **base = &(*levels)[header.unit], *level = lodw_level_decode(bytes, size, *base);
  must(level != NULL, path);
  struct map *map = *base == NULL ? NULL : lodw_map_create(*base, level, 0);
  must(*base == NULL || map != NULL, path);
  printf("{\"unit\":%u,\"level\":%u,\"map\":%u,\"failed\":%u,\"vertices\":%u}\n", header.unit, lodw_level_hash(level),
         map == NULL ? 0 : lodw_map_hash(map), map == NULL ? 0 : map->overlay.failed, level->mesh.vertex_count);
  lodw_map_free(map);
  lodw_level_free(*base);
  *base = level;
  return header.size;
}

/* A level as somebody has it who has read its GLB. */
static struct level *read_level(const char *path) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh;
  must(lod_ply_read(path, arena, &mesh), path);
  struct level *level = lodw_level_create(&mesh.positions[0][0], mesh.vertex_count, &mesh.triangles[0][0], mesh.triangle_count, NULL);
  must(level != NULL, path);
  lod_arena_destroy(arena);
  return level;
}

static void decode_files(char **paths, int count) {
  struct level **levels = NULL;
  uint32_t units = 0;
  lodw_limit(1536);
  for (int i = 0; i < count; i++) {
    size_t size;
    if (strstr(paths[i], ".ply") != NULL) {
      must(levels != NULL && units == 1, paths[i]);
      lodw_level_free(levels[0]);
      levels[0] = read_level(paths[i]);
      continue;
    }
    uint8_t *bytes = read_file(paths[i], &size);
    if (size >= 4 && memcmp(bytes, "LODU", 4) == 0) {
      must(units == 1, paths[i]);
      printf("{");
      print_units(paths[i], bytes, size, levels[0]);
      printf("}\n");
    } else {
      for (size_t at = 0; at < size;)
        at += decode_frame(paths[i], bytes + at, size - at, &levels, &units);
    }
    free(bytes);
  }
  for (uint32_t u = 0; u < units; u++)
    lodw_level_free(levels[u]);
  free(levels);
}

int main(int argc, char **argv) {
  static const char *const kModels[] = {"scans/bunny.ply", "scans/fandisk.ply", "cad/block.ply", "scans/horse.ply"};
  const uint32_t counts[] = {120, 480, 1920};
  if (argc >= 3 && strcmp(argv[1], "--decode") == 0) {
    decode_files(argv + 2, argc - 2);
    return 0;
  }
  if (argc != 2) {
    fprintf(stderr, "usage: steps DIR | --decode FILE...\n");
    return 2;
  }
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 2, 0.8, 90, 45), grid = lod_shape_grid(arena, 2, 60, 0.5),
                  tube = lod_shape_tube(arena, 0.5, 3, 60, 60), raw, mesh;
  run(argv[1], "torus", &torus, counts, 3);
  run(argv[1], "grid", &grid, counts, 3);
  run(argv[1], "tube", &tube, counts, 3);
  const char *shared = lod_shared_folder();
  for (size_t i = 0; shared != NULL && i < sizeof kModels / sizeof *kModels; i++) {
    char path[4096], name[64];
    snprintf(path, sizeof path, "%s/models/%s", shared, kModels[i]);
    if (!lod_ply_read(path, arena, &raw) || lod_mesh_weld(&raw, arena, &mesh, NULL) != LOD_OK)
      continue;
    snprintf(name, sizeof name, "%s", strchr(kModels[i], '/') + 1);
    *strchr(name, '.') = '\0';
    run(argv[1], name, &mesh, counts, 3);
  }
  lod_arena_destroy(arena);
  return 0;
}
