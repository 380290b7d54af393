/* Floating-cell clustering beside meshopt_simplifySloppy: speed and certified error at equal triangle count, and the table of Low & Tan's
 * section 5 on our models. Arguments: PLY files; default: models/scans and models/cad of the shared data, else generated shapes. */
#include <dirent.h>
#include <math.h>
#include <meshoptimizer.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/cluster/cluster.h"
#include "core/mesh/distance.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static const double kShares[] = {0.5, 0.1, 0.02};
enum { SHARES = 3, REPEATS = 5 };

/* Sums of logarithms for the geometric means at the end. */
static double log_speed[SHARES + 1][2], log_error[SHARES], worst_error[SHARES];
static int models, error_models[SHARES];

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "cluster_bench: %s\n", lod_status_name(status));
    exit(1);
  }
}

static struct lod_mesh welded(const struct lod_mesh *mesh, struct lod_arena *arena) {
  struct lod_mesh out;
  must(lod_mesh_weld(mesh, arena, &out, NULL));
  return out;
}

struct timing {
  double prepare, level[SHARES];
};

/* Level time by assignment rule, all models, for the question which may be the default. */
static double rule_seconds[3];

static void time_rules(const struct lod_unit *unit, double cell) {
  for (int rule = 0; rule < 3; rule++) {
    struct lod_cluster_settings settings = lod_cluster_defaults();
    settings.threads = 1;
    settings.assignment = (enum lod_cluster_assignment)rule;
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_cluster *cluster;
    must(lod_cluster_create(unit, 1, &settings, NULL, arena, &cluster, NULL));
    double best = INFINITY;
    for (int repeat = 0; repeat < REPEATS; repeat++) {
      struct lod_arena *scratch = lod_arena_create_child(arena);
      struct lod_level level;
      double start = now();
      must(lod_cluster_level(cluster, cell, scratch, &level, NULL));
      best = fmin(best, now() - start);
      lod_arena_destroy(scratch);
    }
    rule_seconds[rule] += best;
    lod_arena_destroy(arena);
  }
}

/* Best of a few runs, in seconds. */
static struct timing time_ours(const struct lod_unit *unit, uint32_t threads, const double cells[SHARES]) {
  struct timing best = {INFINITY, {INFINITY, INFINITY, INFINITY}};
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.threads = threads;
  for (int repeat = 0; repeat < REPEATS; repeat++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_cluster *cluster;
    double start = now();
    must(lod_cluster_create(unit, 1, &settings, NULL, arena, &cluster, NULL));
    best.prepare = fmin(best.prepare, now() - start);
    for (int i = 0; i < SHARES; i++) {
      struct lod_arena *scratch = lod_arena_create_child(arena);
      struct lod_level level;
      start = now();
      must(lod_cluster_level(cluster, cells[i], scratch, &level, NULL));
      best.level[i] = fmin(best.level[i], now() - start);
      lod_arena_destroy(scratch);
    }
    lod_arena_destroy(arena);
  }
  return best;
}

/* About the smallest cell whose level has at most `triangles` triangles, and at least 99.5 % of them where there is such a cell. */
static double find_cell(const struct lod_cluster *cluster, double diagonal, uint32_t triangles) {
  double low = diagonal * 1e-5, high = diagonal;
  for (int i = 0; i < 24 && high / low > 1.0005; i++) {
    double middle = sqrt(low * high);
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_level level;
    must(lod_cluster_level(cluster, middle, arena, &level, NULL));
    uint32_t count = level.meshes[0].triangle_count;
    if (count > triangles)
      low = middle;
    else
      high = middle;
    lod_arena_destroy(arena);
    if (count <= triangles && count >= 0.995 * triangles)
      return middle;
  }
  return high;
}

static double error_of(const struct lod_mesh *level, const struct lod_mesh *source, struct lod_arena *arena) {
  struct lod_distance_settings settings = lod_distance_defaults();
  struct lod_distance distance;
  settings.threads = 2;
  must(lod_distance_measure(level, source, &settings, arena, &distance));
  return distance.two_sided.upper;
}

static void bench_model(const char *name, const struct lod_mesh *raw) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = welded(raw, arena), .scale = 1};
  const struct lod_mesh *mesh = &unit.mesh;
  struct lod_bounds box = lod_mesh_bounds(mesh);
  double diagonal = lod_bounds_diagonal(&box);
  struct lod_cluster *cluster;
  must(lod_cluster_create(&unit, 1, NULL, NULL, arena, &cluster, NULL));
  double cells[SHARES], theirs[SHARES], errors[SHARES][2];
  uint32_t counts[SHARES][2];
  for (int i = 0; i < SHARES; i++) {
    uint32_t target = (uint32_t)(kShares[i] * mesh->triangle_count) + 1;
    struct lod_mesh sloppy = {.vertex_count = mesh->vertex_count, .positions = mesh->positions};
    sloppy.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *sloppy.triangles);
    theirs[i] = INFINITY;
    for (int repeat = 0; repeat < REPEATS; repeat++) {
      double start = now();
      size_t indices = meshopt_simplifySloppy(sloppy.triangles[0], mesh->triangles[0], 3 * (size_t)mesh->triangle_count, mesh->positions[0],
                                              mesh->vertex_count, sizeof *mesh->positions, 3 * (size_t)target, 1, NULL);
      theirs[i] = fmin(theirs[i], now() - start);
      sloppy.triangle_count = (uint32_t)(indices / 3);
    }
    cells[i] = find_cell(cluster, diagonal, sloppy.triangle_count);
    struct lod_level level;
    must(lod_cluster_level(cluster, cells[i], arena, &level, NULL));
    counts[i][0] = level.meshes[0].triangle_count;
    counts[i][1] = sloppy.triangle_count;
    errors[i][0] = error_of(&level.meshes[0], mesh, arena);
    errors[i][1] = sloppy.triangle_count != 0 ? error_of(&sloppy, mesh, arena) : INFINITY;
  }
  time_rules(&unit, cells[1]);
  struct timing one = time_ours(&unit, 1, cells), two = time_ours(&unit, 2, cells);
  double million = mesh->triangle_count * 1e-6;
  printf("%-26s %8u |", name, mesh->triangle_count);
  printf(" %5.1f %5.1f %5.1f |", million / (one.prepare + one.level[0]), million / (two.prepare + two.level[0]), million / theirs[0]);
  for (int i = 1; i < SHARES; i++)
    printf(" %5.1f %5.1f %5.1f |", million / one.level[i], million / two.level[i], million / theirs[i]);
  for (int i = 0; i < SHARES; i++) {
    printf(" %6u %6u %.5f %.5f %4.2f |", counts[i][0], counts[i][1], errors[i][0] / diagonal, errors[i][1] / diagonal,
           errors[i][0] / errors[i][1]);
    if (isfinite(errors[i][1])) {
      log_error[i] += log(errors[i][0] / errors[i][1]);
      worst_error[i] = fmax(worst_error[i], errors[i][0] / errors[i][1]);
      error_models[i]++;
    }
    log_speed[i][0] += log(million / (i == 0 ? two.prepare + two.level[0] : two.level[i]));
    log_speed[i][1] += log(million / theirs[i]);
  }
  log_speed[SHARES][0] += log(million / two.level[0]);
  printf("\n");
  fflush(stdout);
  models++;
  lod_arena_destroy(arena);
}

static void print_row(const char *what, const struct lod_mesh *level, const struct lod_mesh *source, double diagonal,
                      struct lod_arena *arena) {
  printf("  %-22s %6u %6u %6u %6u  %.5f\n", what, level->vertex_count, level->triangle_count, level->edge_count, level->point_count,
         error_of(level, source, arena) / diagonal);
}

/* The paper's table in kind: one cell size and shape, four ways. */
static void table_model(const char *name, const struct lod_mesh *raw) {
  static const struct {
    const char *name;
    enum lod_cluster_assignment assignment;
  } kWays[] = {{"uniform", LOD_CLUSTER_UNIFORM},
               {"floating, heaviest", LOD_CLUSTER_HEAVIEST},
               {"floating, nearest made", LOD_CLUSTER_NEAREST_IN_ORDER},
               {"floating, nearest", LOD_CLUSTER_NEAREST}};
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = welded(raw, arena), .scale = 1};
  struct lod_bounds box = lod_mesh_bounds(&unit.mesh);
  double diagonal = lod_bounds_diagonal(&box), cell = diagonal / 16;
  printf("%s, cell = diagonal / 16\n", name);
  printf("  %-22s %6u %6u %6u %6u\n", "source", unit.mesh.vertex_count, unit.mesh.triangle_count, 0, 0);
  for (size_t i = 0; i < sizeof kWays / sizeof *kWays; i++) {
    struct lod_cluster_settings settings = lod_cluster_defaults();
    settings.assignment = kWays[i].assignment;
    settings.shape = LOD_CLUSTER_CUBE;
    settings.representative = LOD_CLUSTER_CENTRE;
    struct lod_cluster *cluster;
    struct lod_level level;
    must(lod_cluster_create(&unit, 1, &settings, NULL, arena, &cluster, NULL));
    must(lod_cluster_level(cluster, cell, arena, &level, NULL));
    print_row(kWays[i].name, &level.meshes[0], &unit.mesh, diagonal, arena);
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

static void each_file(char **paths, int count, void (*run)(const char *, const struct lod_mesh *)) {
  for (int i = 0; i < count; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh mesh;
    const char *slash = strrchr(paths[i], '/');
    if (lod_ply_read(paths[i], arena, &mesh))
      run(slash != NULL ? slash + 1 : paths[i], &mesh);
    else
      fprintf(stderr, "cluster_bench: %s: not a binary little-endian PLY of float points and triangles\n", paths[i]);
    lod_arena_destroy(arena);
  }
}

static void each_shape(void (*run)(const char *, const struct lod_mesh *)) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 7), torus = lod_shape_torus(arena, 3, 1, 400, 200),
                  tree = lod_shape_tree(arena, 7, true);
  run("sphere", &sphere);
  run("torus", &torus);
  run("tree", &tree);
  lod_arena_destroy(arena);
}

static void print_means(void) {
  if (models == 0)
    return;
  printf("geometric means, two threads: first level %.1f (sloppy %.1f)", exp(log_speed[0][0] / models), exp(log_speed[0][1] / models));
  printf(", the same without prepare %.1f", exp(log_speed[SHARES][0] / models));
  for (int i = 1; i < SHARES; i++)
    printf(", at %g%% %.1f (%.1f)", 100 * kShares[i], exp(log_speed[i][0] / models), exp(log_speed[i][1] / models));
  printf(" Mtri/s\nlevels at 10 %% by rule: heaviest %.0f ms, nearest in order %.0f ms, nearest %.0f ms\n", 1e3 * rule_seconds[0],
         1e3 * rule_seconds[1], 1e3 * rule_seconds[2]);
  printf("certified error over sloppy's at equal triangles:");
  for (int i = 0; i < SHARES; i++)
    printf(" %g%%: mean %.2f worst %.2f;", 100 * kShares[i], exp(log_error[i] / fmax(1, error_models[i])), worst_error[i]);
  printf("\n");
}

int main(int argc, char **argv) {
  enum { MOST = 1000 };
  static char *found[MOST];
  char **paths = argv + 1;
  int count = argc - 1;
  const char *shared = lod_shared_folder();
  if (count == 0 && shared != NULL) {
    char folder[4096];
    snprintf(folder, sizeof folder, "%s/models/scans", shared);
    count = list_folder(folder, found, MOST);
    snprintf(folder, sizeof folder, "%s/models/cad", shared);
    count += list_folder(folder, found + count, MOST - count);
    paths = found;
  }
  printf(
      "Speed in Mtri/s of source: first level (50 %%, with grading and sort) and further levels (10 %%, 2 %%), each: one thread, two "
      "threads,\n"
      "meshopt_simplifySloppy. Then at 50, 10, 2 %%: triangles ours and theirs, certified error over diagonal ours and theirs, ratio.\n");
  if (count != 0)
    each_file(paths, count, bench_model);
  else
    each_shape(bench_model);
  print_means();
  printf("\nLow & Tan's table in kind: vertices, triangles, edges, points, certified error over diagonal\n");
  if (count != 0)
    each_file(paths, count, table_model);
  else
    each_shape(table_model);
  return 0;
}
