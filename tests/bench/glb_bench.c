/* Bytes against seconds of the GLB writer at Draco's speeds, on models given or on those of ../shared. CPU seconds, one thread.
 *
 *   make bench-glb BENCH_ARGS="MODEL..." */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "codec/export/glb.h"
#include "codec/import/import.h"

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static bool load(const char *path, struct lod_arena *arena, struct lod_model *model) {
  FILE *file = fopen(path, "rb");
  if (file == NULL)
    return false;
  fseek(file, 0, SEEK_END);
  const long size = ftell(file);
  rewind(file);
  uint8_t *bytes = lod_arena_alloc(arena, (size_t)size, 1);
  const bool whole = bytes != NULL && fread(bytes, 1, (size_t)size, file) == (size_t)size;
  fclose(file);
  struct lod_import_limits limits = {0};
  struct lod_import_request request = {.name = path, .bytes = bytes, .size = (size_t)size, .limits = &limits, .threads = 1};
  struct lod_problem problem = {0};
  if (whole && lod_import_model(&request, arena, model, &problem) == LOD_OK)
    return true;
  fprintf(stderr, "%s: %s\n", path, problem.detail);
  return false;
}

static void measure(const char *path) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model;
  if (!load(path, arena, &model)) {
    lod_arena_destroy(arena);
    return;
  }
  struct lod_bounds bounds = lod_model_bounds(&model);
  struct lod_mesh *meshes = LOD_NEW(arena, model.unit_count, struct lod_mesh);
  uint64_t triangles = 0;
  for (uint32_t u = 0; u < model.unit_count; u++) {
    meshes[u] = model.units[u].mesh;
    triangles += meshes[u].triangle_count;
  }
  printf("%s, %llu triangles\n%8s %8s %12s %10s %10s %10s\n", path, (unsigned long long)triangles, "error/d", "speed", "bytes", "bits/tri",
         "write s", "read s");
  for (double relative = 1e-4; relative > 1e-6; relative /= 20)
    for (int speed = -1; speed <= 9; speed++) {
      struct lod_arena *scratch = lod_arena_create_child(arena);
      struct lod_glb_settings settings = lod_glb_defaults();
      settings.position_error = relative * lod_bounds_diagonal(&bounds);
      settings.draco_speed = speed;
      settings.threads = 1;
      uint8_t *bytes;
      size_t size = 0;
      struct lod_problem problem = {0};
      double begin = now();
      enum lod_status status = lod_glb_write(&model, meshes, &settings, scratch, &bytes, &size, &problem);
      double middle = now();
      struct lod_mesh *decoded = LOD_NEW(scratch, model.unit_count, struct lod_mesh);
      if (status == LOD_OK)
        status = lod_glb_read(bytes, size, &model, scratch, decoded, &problem);
      if (status != LOD_OK)
        printf("%s\n", problem.detail);
      printf("%8.0e %8d %12zu %10.2f %10.3f %10.3f\n", relative, speed, size, 8.0 * (double)size / (double)triangles, middle - begin,
             now() - middle);
      fflush(stdout);
      lod_arena_destroy(scratch);
    }
  lod_arena_destroy(arena);
}

int main(int argc, char **argv) {
  if (argc > 1) {
    for (int i = 1; i < argc; i++)
      measure(argv[i]);
    return 0;
  }
  const char *shared = getenv("LODESTREAM_SHARED");
  static const char *const kModels[] = {"models/scans/bunny.ply", "models/large/mri-icbm152-1.1m.ply"};
  for (size_t i = 0; i < sizeof kModels / sizeof *kModels; i++) {
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", shared != NULL ? shared : "../shared", kModels[i]);
    measure(path);
  }
  return 0;
}
