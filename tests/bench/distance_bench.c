/* bench-distance: the tree and the certified distance on models given, or on those of ../shared. CPU seconds on one thread.
 *
 *   make bench-distance [BENCH_ARGS="MODEL..."]
 * For each model: building the tree; nearest points of the primitives' centres, in the tree's order; then every level of the cluster family
 * certified against the source as a bake does it, with the family's maps, and measured again with nothing known. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/cli/cli.h"
#include "core/base/tolerance.h"
#include "core/cluster/cluster.h"
#include "core/mesh/bvh.h"
#include "core/mesh/distance.h"
#include "server/worker/certify.h"
#include "tests/data/shapes.h"

/* Without hints a fine level takes seconds: only levels with at most this many primitives are measured that way. */
static const uint32_t kUnhintedMost = 1u << 20;

static double cpu_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

struct bench {
  const struct lod_unit *unit;
  const struct lod_bvh *bvh;
  double diagonal;
  double certify_seconds, measure_seconds;
};

static enum lod_status certify_level(void *context, const struct lod_level *level) {
  struct bench *bench = context;
  const struct lod_mesh *source = &bench->unit->mesh, *mesh = &level->meshes[0];
  struct lod_arena *scratch = lod_arena_create(0);
  struct lod_certify_request request = {
      .source = source,
      .source_bvh = bench->bvh,
      .level = mesh,
      .decoded = mesh,
      .image = level->images == NULL ? NULL : level->images[0],
      .nearby = level->nearby == NULL ? NULL : level->nearby[0],
      .absolute = bench->diagonal * LOD_TOLERANCE_DISTANCE_DIAGONAL,
      .threads = 1,
  };
  struct lod_distance certified, measured = {.complete = true};
  double start = cpu_seconds();
  LOD_TRY(lod_certify_unit(&request, scratch, &certified));
  double certify = cpu_seconds() - start, measure = 0;
  bool unhinted = mesh->triangle_count <= kUnhintedMost;
  if (unhinted) {
    struct lod_distance_settings settings = lod_distance_defaults();
    settings.threads = 1;
    settings.bvh_a = bench->bvh;
    start = cpu_seconds();
    LOD_TRY(lod_distance_measure(source, mesh, &settings, scratch, &measured));
    measure = cpu_seconds() - start;
  }
  printf("%10u %8u %8u  [%.4f, %.4f] %8.3f s", mesh->triangle_count, mesh->edge_count, mesh->point_count,
         100 * certified.two_sided.lower / bench->diagonal, 100 * certified.two_sided.upper / bench->diagonal, certify);
  if (unhinted)
    printf(" %8.3f s", measure);
  printf("%s%s\n", certified.complete && measured.complete ? "" : "  INCOMPLETE",
         unhinted && (certified.two_sided.lower > measured.two_sided.upper || measured.two_sided.lower > certified.two_sided.upper)
             ? "  DISAGREE"
             : "");
  bench->certify_seconds += certify;
  bench->measure_seconds += measure;
  lod_arena_destroy(scratch);
  return LOD_OK;
}

static void bench_queries(const struct lod_mesh *mesh, const struct lod_bvh *bvh) {
  uint32_t hint = LOD_NONE;
  double sum = 0, start = cpu_seconds();
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 q = {0, 0, 0};
    for (int k = 0; k < 3; k++)
      q = lod_vec3_add_scaled(q, lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]), 1.0 / 3);
    struct lod_closest closest = lod_bvh_closest(bvh, q, hint, INFINITY);
    hint = closest.primitive;
    sum += closest.distance_squared;
  }
  double seconds = cpu_seconds() - start;
  printf("  nearest points of %u centres: %.2f M/s (sum of squares %.3g)\n", mesh->triangle_count,
         1e-6 * mesh->triangle_count / fmax(seconds, 1e-9), sum);
}

static void bench_unit(const char *name, const struct lod_unit *unit, struct lod_arena *arena) {
  const struct lod_mesh *mesh = &unit->mesh;
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  struct bench bench = {.unit = unit, .diagonal = lod_bounds_diagonal(&bounds)};
  struct lod_bvh *bvh;
  double start = cpu_seconds();
  if (lod_bvh_create(mesh, 1, arena, &bvh) != LOD_OK)
    return;
  double seconds = cpu_seconds() - start;
  bench.bvh = bvh;
  printf("%s: %u triangles\n  tree: %.3f s, %.2f Mtri/s\n", name, mesh->triangle_count, seconds,
         1e-6 * mesh->triangle_count / fmax(seconds, 1e-9));
  bench_queries(mesh, bvh);
  printf("%10s %8s %8s  %17s %10s %10s\n", "triangles", "edges", "points", "error % diagonal", "certify", "measure");
  struct lod_problem problem = {0};
  if (lod_cluster_family.build(unit, 1, NULL, NULL, arena, certify_level, &bench, &problem) != LOD_OK)
    fprintf(stderr, "%s: %s\n", name, problem.detail);
  printf("  all levels: certified in %.2f s, measured in %.2f s\n", bench.certify_seconds, bench.measure_seconds);
}

static bool bench_file(const char *path) {
  struct cli_file file;
  struct lod_problem problem = {0};
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model;
  bool loaded = cli_import(path, NULL, arena, &model, &file, &problem) == LOD_OK;
  if (loaded) {
    bench_unit(path, &model.units[0], arena);
    cli_file_close(&file);
  } else {
    fprintf(stderr, "%s\n", problem.detail);
  }
  lod_arena_destroy(arena);
  return loaded;
}

int main(int argc, char **argv) {
  setvbuf(stdout, NULL, _IOLBF, 0);
  if (argc > 1) {
    int failed = 0;
    for (int i = 1; i < argc; i++)
      failed += !bench_file(argv[i]);
    return failed > 0;
  }
  const char *shared = getenv("LODESTREAM_SHARED");
  char path[512];
  snprintf(path, sizeof path, "%s/models/scans/bunny.ply", shared == NULL ? "../shared" : shared);
  FILE *probe = fopen(path, "rb");
  if (probe != NULL) {
    fclose(probe);
    bench_file(path);
  }
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit torus = {.mesh = lod_shape_torus(arena, 1, 0.3, 1000, 500), .scale = 1};
  bench_unit("torus", &torus, arena);
  lod_arena_destroy(arena);
  return 0;
}
