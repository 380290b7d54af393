/* bench-bake: seconds and memory of whole bakes, certified errors included, one process each.
 *
 *   make bench-bake [BENCH_ARGS="model.ply ..."]
 * Without arguments: bunny and the two large models of ../shared/models (or $LODESTREAM_SHARED/models) when they are there, unpacked with
 * xz into build/bench; otherwise a generated torus. */
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "server/worker/bake.h"
#include "tests/data/shapes.h"

static const char *const kWork = "build/bench";

static double now_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* In a child of its own, so that the peak memory is this bake's. */
static int bake(const char *path, const char *directory) {
  struct cli_file file;
  struct lod_problem problem = {0};
  if (cli_file_open(path, &file, &problem) != LOD_OK) {
    fprintf(stderr, "%s\n", problem.detail);
    return 1;
  }
  struct lod_bake_request request = lod_bake_defaults();
  request.name = path;
  request.bytes = file.bytes;
  request.size = file.size;
  request.directory_fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (request.directory_fd < 0 || lod_bake_run(&request, &problem) != LOD_OK) {
    fprintf(stderr, "%s: %s\n", path, problem.detail);
    return 1;
  }
  return 0;
}

static void print_row(const char *path, const char *directory, double seconds, const struct rusage *usage) {
  char manifest_path[512], object_bytes[32], triangles[32];
  snprintf(manifest_path, sizeof manifest_path, "%s/manifest.json", directory);
  json_t *manifest = json_load_file(manifest_path, 0, NULL);
  const char *name = strrchr(path, '/');
  name = name == NULL ? path : name + 1;
  uint64_t bytes = 0;
  size_t levels = 0;
  double coarsest = 0;
  const char *family_name;
  json_t *family;
  double diagonal = json_number_value(json_object_get(json_object_get(manifest, "source"), "diagonal"));
  json_object_foreach(json_object_get(manifest, "families"), family_name, family) {
    size_t i;
    json_t *level;
    json_array_foreach(json_object_get(family, "levels"), i, level) {
      bytes += (uint64_t)json_integer_value(json_object_get(level, "bytes"));
      coarsest = fmax(coarsest, json_number_value(json_object_get(level, "error")) / diagonal);
      levels++;
    }
  }
  printf("%-28s %12s %8.2f %8.2f %8.0f %6zu %10s %9.3f\n", name,
         cli_count((uint64_t)json_integer_value(json_object_get(json_object_get(manifest, "source"), "triangles")), triangles), seconds,
         (double)(usage->ru_utime.tv_sec + usage->ru_stime.tv_sec) + 1e-6 * (double)(usage->ru_utime.tv_usec + usage->ru_stime.tv_usec),
         (double)usage->ru_maxrss / 1024, levels, cli_bytes(bytes, object_bytes), 100 * coarsest);
  fflush(stdout);
  json_decref(manifest);
}

static void run(const char *path) {
  char directory[256], command[512];
  snprintf(directory, sizeof directory, "%s/bake-%d", kWork, (int)getpid());
  mkdir(directory, 0755);
  double started = now_seconds();
  pid_t child = fork();
  if (child == 0)
    _exit(bake(path, directory));
  int status;
  struct rusage usage;
  if (wait4(child, &status, 0, &usage) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0)
    print_row(path, directory, now_seconds() - started, &usage);
  else
    printf("%-28s failed\n", path);
  snprintf(command, sizeof command, "rm -rf '%s'", directory);
  if (system(command) != 0)
    fprintf(stderr, "could not remove %s\n", directory);
}

/* models/large/NAME.ply.xz unpacked once; false when it is not there. */
static bool unpack(const char *models, const char *name, char path[512]) {
  char packed[512], command[1200];
  struct stat st;
  snprintf(packed, sizeof packed, "%s/large/%s.ply.xz", models, name);
  snprintf(path, 512, "%s/%s.ply", kWork, name);
  if (stat(path, &st) == 0)
    return true;
  if (stat(packed, &st) != 0)
    return false;
  snprintf(command, sizeof command, "xz -dkc '%s' > '%s.part' && mv '%s.part' '%s'", packed, path, path, path);
  return system(command) == 0;
}

static void write_torus(const char *path) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 1000, 500);
  FILE *out = fopen(path, "wb");
  if (out == NULL)
    exit(1);
  fprintf(out,
          "ply\nformat binary_little_endian 1.0\nelement vertex %u\nproperty float x\nproperty float y\nproperty float z\nelement face %u\n"
          "property list uchar int vertex_indices\nend_header\n",
          torus.vertex_count, torus.triangle_count);
  fwrite(torus.positions, sizeof *torus.positions, torus.vertex_count, out);
  for (uint32_t t = 0; t < torus.triangle_count; t++) {
    fputc(3, out);
    fwrite(torus.triangles[t], sizeof *torus.triangles, 1, out);
  }
  fclose(out);
  lod_arena_destroy(arena);
}

int main(int argc, char **argv) {
  const char *shared = getenv("LODESTREAM_SHARED");
  char models[400], path[512];
  snprintf(models, sizeof models, "%s/models", shared != NULL ? shared : "../shared");
  mkdir("build", 0755);
  mkdir(kWork, 0755);
  printf("%-28s %12s %8s %8s %8s %6s %10s %9s\n", "model", "triangles", "seconds", "cpu s", "MiB", "levels", "bytes", "coarsest%");
  if (argc > 1) {
    for (int i = 1; i < argc; i++)
      run(argv[i]);
    return 0;
  }
  struct stat st;
  snprintf(path, sizeof path, "%s/scans/bunny.ply", models);
  if (stat(path, &st) != 0) {
    snprintf(path, sizeof path, "%s/torus.ply", kWork);
    write_torus(path);
  }
  run(path);
  if (unpack(models, "mri-icbm152-1.1m", path))
    run(path);
  if (unpack(models, "ct-abdomen-5m", path))
    run(path);
  return 0;
}
