/* Re-tiling: per model and number of vertices the certified error, triangle quality and time, ours beside Turk's literal placement.
 * Arguments: [-n N[,N...]] [-e PERCENT[,...]] [-p FOLDER] [-s STEPS] [-d DAMPING] [-r RADIUS] [-l LEAD] [-t SETTLE] [-a ADAPT] [-o 1] PLY
 * files; default: models/scans, cad, iso of the shared
 * data and 250, 800, 2500 vertices. -p writes pictures of every level; -o leaves the comparisons out. */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "codec/export/picture.h"
#include "codec/export/png.h"
#include "core/mesh/distance.h"
#include "core/retile/retile.h"
#include "tests/data/ply.h"
#include "tests/data/surface.h"

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "retile_bench: %s\n", lod_status_name(status));
    exit(1);
  }
}

struct quality {
  double mean, percent, angle; /* of 2r/R: mean and 1 % quantile; mean smallest angle, degrees */
  double valence6;             /* share of vertices inside */
};

static int compare(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static struct quality measure_quality(const struct lod_mesh *mesh, struct lod_arena *arena) {
  struct quality q = {0};
  double *shape = LOD_NEW(arena, mesh->triangle_count, double);
  uint32_t *valence = LOD_NEW_ZERO(arena, mesh->vertex_count, uint32_t), regular = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    double s[3], smallest = 180;
    for (int k = 0; k < 3; k++) {
      p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
      valence[mesh->triangles[t][k]]++;
    }
    for (int k = 0; k < 3; k++)
      s[k] = lod_vec3_distance(p[(k + 1) % 3], p[(k + 2) % 3]);
    for (int k = 0; k < 3; k++) {
      double cosine =
          (s[(k + 1) % 3] * s[(k + 1) % 3] + s[(k + 2) % 3] * s[(k + 2) % 3] - s[k] * s[k]) / (2 * s[(k + 1) % 3] * s[(k + 2) % 3]);
      smallest = fmin(smallest, acos(fmin(1, fmax(-1, cosine))) * 57.29577951308232);
    }
    double product = s[0] * s[1] * s[2];
    shape[t] = product > 0 ? fmax(0, (s[1] + s[2] - s[0]) * (s[2] + s[0] - s[1]) * (s[0] + s[1] - s[2]) / product) : 0; /* 2r/R */
    q.mean += shape[t] / mesh->triangle_count;
    q.angle += smallest / mesh->triangle_count;
  }
  qsort(shape, mesh->triangle_count, sizeof *shape, compare);
  q.percent = mesh->triangle_count != 0 ? shape[mesh->triangle_count / 100] : 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    regular += valence[v] == 6;
  q.valence6 = mesh->vertex_count != 0 ? (double)regular / mesh->vertex_count : 0;
  return q;
}

static const char *picture_folder;
static double steps_asked = -1, damping_asked = -1, radius_asked = -1, lead_asked = -1, settle_asked = -1,
              adapt_asked = -1; /* by -s, -d, -r; -1: the default */
static bool ours_only;          /* -o 1 */

static void draw(const char *name, const char *mode, const struct lod_mesh *mesh) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_picture_settings settings = lod_picture_defaults();
  struct lod_picture picture;
  char path[4096];
  settings.flat = settings.wireframe = true;
  must(lod_picture_render(mesh, 1, &settings, arena, &picture, NULL));
  snprintf(path, sizeof path, "%s/%s-%s-%u.png", picture_folder, name, mode, mesh->vertex_count);
  FILE *file = fopen(path, "wb");
  if (file == NULL || lod_png_write(&picture, file, NULL) != LOD_OK)
    fprintf(stderr, "retile_bench: cannot write %s\n", path);
  if (file != NULL)
    fclose(file);
  lod_arena_destroy(arena);
}

static void bench(const char *name, const struct lod_mesh *mesh, const char *mode, const struct lod_retile_settings *settings) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double diagonal = lod_bounds_diagonal(&bounds), start = now();
  struct lod_retile retile;
  struct lod_topology source;
  must(lod_retile_create(mesh, settings, NULL, arena, &retile, NULL));
  double seconds = now() - start;
  size_t peak = lod_arena_peak_bytes(arena);
  source = lod_surface_topology(mesh, arena);
  for (uint32_t k = 0; k < retile.level_count; k++) {
    const struct lod_retile_level *level = &retile.levels[k];
    struct lod_arena *scratch = lod_arena_create(0);
    struct lod_topology topology;
    struct lod_distance_settings exact = lod_distance_defaults();
    struct lod_distance distance;
    exact.rms = true;
    topology = lod_surface_topology(&level->mesh, scratch);
    must(lod_distance_measure(&level->mesh, mesh, &exact, scratch, &distance));

    struct quality q = measure_quality(&level->mesh, scratch);
    struct lod_retile_map_facts map = {.valid = true};
    if (level->flat != NULL)
      must(lod_retile_check_map(level, level + 1, scratch, &map));
    bool kept = lod_surface_same(&topology, &source);
    printf("%-22.22s %-7s %7u %6u %5u | %7.3f %7.4f | %5.3f %5.3f %5.1f %4.0f%% | %s | %5u %5u | %6.2f %6.1f\n", name, mode,
           level->mesh.vertex_count, level->mesh.triangle_count, level->retained, 100 * distance.two_sided.upper / diagonal,
           100 * distance.rms / diagonal, q.mean, q.percent, q.angle, 100 * q.valence6, kept ? "kept" : "LOST", map.inside, map.folded,
           k == 0 ? seconds : 0, k == 0 ? (double)peak / 1048576 : 0);
    fflush(stdout);
    if (picture_folder != NULL)
      draw(name, mode, &level->mesh);
    lod_arena_destroy(scratch);
  }
  lod_arena_destroy(arena);
}

static double errors_asked[LOD_RETILE_MAX_LEVELS]; /* by -e, percent of the diagonal */
static uint32_t error_count;

/* Levels that meet errors. */
static void bench_errors(const char *name, const struct lod_mesh *mesh) {
  double errors[LOD_RETILE_MAX_LEVELS];
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  struct lod_retile_settings settings = lod_retile_defaults();
  for (uint32_t k = 0; k < error_count; k++)
    errors[k] = errors_asked[k] / 100 * lod_bounds_diagonal(&bounds);
  settings.errors = errors;
  settings.level_count = error_count;
  settings.threads = 1;
  bench(name, mesh, "error", &settings);
}

static void bench_file(const char *path, const uint32_t *counts, uint32_t count) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh raw, mesh;
  const char *slash = strrchr(path, '/');
  if (!lod_ply_read(path, arena, &raw)) {
    fprintf(stderr, "retile_bench: %s: not a binary little-endian PLY of float points and triangles\n", path);
  } else {
    must(lod_mesh_weld(&raw, arena, &mesh, NULL));
    struct lod_retile_settings settings = lod_retile_defaults();
    if (error_count != 0) {
      bench_errors(slash != NULL ? slash + 1 : path, &mesh);
      lod_arena_destroy(arena);
      return;
    }
    settings.vertices = counts;
    settings.level_count = count;
    settings.threads = 1;
    settings.steps = steps_asked >= 0 ? (uint32_t)steps_asked : settings.steps;
    settings.damping = damping_asked >= 0 ? damping_asked : settings.damping;
    settings.radius = radius_asked >= 0 ? radius_asked : settings.radius;
    settings.lead = lead_asked >= 0 ? lead_asked : settings.lead;
    settings.settle = settle_asked >= 0 ? (uint32_t)settle_asked : settings.settle;
    settings.adapt = adapt_asked >= 0 ? adapt_asked : settings.adapt;
    bench(slash != NULL ? slash + 1 : path, &mesh, "ours", &settings);
    settings.curvature = LOD_RETILE_CURVATURE_NONE;
    if (!ours_only)
      bench(slash != NULL ? slash + 1 : path, &mesh, "uniform", &settings);
    settings = lod_retile_turk();
    settings.vertices = counts;
    settings.level_count = count;
    settings.threads = 1;
    if (!ours_only)
      bench(slash != NULL ? slash + 1 : path, &mesh, "turk", &settings);
  }
  lod_arena_destroy(arena);
}

static int compare_names(const void *a, const void *b) {
  return strcmp(*(char *const *)a, *(char *const *)b);
}

static int list_folder(const char *folder, char **names, int most) {
  DIR *directory = opendir(folder);
  int count = 0;
  for (struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL && count < most;) {
    size_t length = strlen(entry->d_name);
    if (length > 4 && strcmp(entry->d_name + length - 4, ".ply") == 0 && asprintf(&names[count], "%s/%s", folder, entry->d_name) > 0)
      count++;
  }
  if (directory != NULL)
    closedir(directory);
  qsort(names, (size_t)count, sizeof *names, compare_names);
  return count;
}

int main(int argc, char **argv) {
  enum { MOST = 1000 };
  static char *found[MOST];
  uint32_t counts[LOD_RETILE_MAX_LEVELS] = {250, 800, 2500}, count = 3;

  int first = 1;
  for (; first + 1 < argc && argv[first][0] == '-'; first += 2) {
    if (strcmp(argv[first], "-p") == 0)
      picture_folder = argv[first + 1];
    static const struct {
      const char *name;
      double *value;
    } kNumbers[] = {{"-s", &steps_asked}, {"-d", &damping_asked}, {"-r", &radius_asked},
                    {"-l", &lead_asked},  {"-t", &settle_asked},  {"-a", &adapt_asked}};
    for (size_t i = 0; i < sizeof kNumbers / sizeof *kNumbers; i++)
      if (strcmp(argv[first], kNumbers[i].name) == 0)
        *kNumbers[i].value = strtod(argv[first + 1], NULL);
    ours_only = ours_only || strcmp(argv[first], "-o") == 0;
    for (char *word = strcmp(argv[first], "-e") == 0 ? strtok(argv[first + 1], ",") : NULL; word != NULL; word = strtok(NULL, ","))
      errors_asked[error_count++] = strtod(word, NULL);
    count = strcmp(argv[first], "-n") == 0 ? 0 : count;
    for (char *word = strcmp(argv[first], "-n") == 0 ? strtok(argv[first + 1], ",") : NULL; word != NULL; word = strtok(NULL, ","))
      counts[count++] = (uint32_t)strtoul(word, NULL, 10);
  }
  char **paths = argv + first;
  int files = argc - first;
  const char *shared = lod_shared_folder();
  static const char *const kFolders[] = {"scans", "cad", "iso"};
  for (size_t i = 0; argc - first == 0 && shared != NULL && i < sizeof kFolders / sizeof *kFolders; i++) {
    char folder[4096];
    snprintf(folder, sizeof folder, "%s/models/%s", shared, kFolders[i]);
    paths = found;
    files += list_folder(folder, found + files, MOST - files);
  }
  printf("%-22s %-7s %7s %6s %5s | %7s %7s | %5s %5s %5s %5s | topo | %5s %5s | %6s %6s\n", "model", "mode", "vert", "tri", "kept",
         "error %", "rms %", "2r/R", "1 %", "angle", "val 6", "flat", "fold", "s", "MiB");
  for (int i = 0; i < files; i++)
    bench_file(paths[i], counts, count);
  return 0;
}
