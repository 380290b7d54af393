/* Certified levels beside plain quadric simplification at the same certified error: triangles, error, topology, time.
 *
 *   make bench-envelope                           bunny, igea and fandisk of the shared scans, else shapes
 *   make bench-envelope BENCH_ARGS="a.ply 0.1 2"  one file, epsilons in percent of the diagonal */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <meshoptimizer.h>

#include "core/envelope/envelope.h"
#include "core/mesh/distance.h"
#include "core/mesh/topology.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static double cpu_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(enum lod_status status) {
  if (status != LOD_OK)
    abort();
}

struct bench {
  struct lod_arena *arena;
  const struct lod_mesh *mesh;
  struct lod_bvh *bvh;
  struct lod_topology topology;
  double diagonal;
};

static struct lod_distance measure(const struct bench *b, const struct lod_mesh *level, const uint32_t *nearby, bool rms) {
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.threads = 1;
  settings.bvh_a = b->bvh;
  settings.hint_ab = nearby;
  settings.larger_side_only = true;
  settings.rms = rms;
  struct lod_distance distance;
  must(lod_distance_measure(b->mesh, level, &settings, b->arena, &distance));
  return distance;
}

/* Fewest triangles that meshopt_simplify needs for a certified error of `epsilon`, by bisection over the target. */
static size_t meshopt_triangles(const struct bench *b, double epsilon, struct lod_distance *best, struct lod_topology *topology) {
  size_t indices = 3 * (size_t)b->mesh->triangle_count, low = 0, high = b->mesh->triangle_count, found = high;
  unsigned *out = malloc(indices * sizeof *out);
  if (out == NULL)
    abort();
  *best = (struct lod_distance){0};
  *topology = b->topology;
  while (high - low > 1 + high / 100) {
    size_t target = (low + high) / 2;
    size_t count = meshopt_simplify(out, &b->mesh->triangles[0][0], indices, &b->mesh->positions[0][0], b->mesh->vertex_count, 12,
                                    3 * target, FLT_MAX, 0, NULL);
    struct lod_mesh level = {
        .positions = b->mesh->positions, .vertex_count = b->mesh->vertex_count, .triangle_count = (uint32_t)(count / 3)};
    level.triangles = (uint32_t(*)[3])(void *)out;
    struct lod_distance distance = measure(b, &level, NULL, true);
    if (count != 0 && distance.two_sided.upper <= epsilon) {
      high = target;
      if (count / 3 <= found) {
        found = count / 3;
        *best = distance;
        must(lod_topology_measure(&level, NULL, b->arena, topology));
      }
    } else {
      low = target;
    }
  }
  free(out);
  return found;
}

static bool same_topology(const struct lod_topology *a, const struct lod_topology *b) {
  return a->components == b->components && a->boundary_loops == b->boundary_loops && a->euler == b->euler && a->manifold == b->manifold;
}

struct row {
  struct bench *bench;
  double percent, started;
};

static enum lod_status print_row(void *context, const struct lod_level *level) {
  struct row *row = context;
  struct bench *b = row->bench;
  double seconds = cpu_seconds() - row->started, percent = 100 / b->diagonal;
  struct lod_distance ours = measure(b, &level->meshes[0], level->nearby[0], true), theirs;
  struct lod_topology topology, their_topology;
  must(lod_topology_measure(&level->meshes[0], NULL, b->arena, &topology));
  size_t triangles = meshopt_triangles(b, ours.two_sided.upper, &theirs, &their_topology);
  printf("  %6.3f %% %8u tri  [%.4f, %.4f] %%  rms %.4f %%  topology %-7s %7.2f s %8.0f tri/s | meshopt %8zu tri  <= %.4f %%  rms %.4f %%  "
         "topology %-7s "
         "ours %.2f of it\n",
         row->percent, level->meshes[0].triangle_count, ours.two_sided.lower * percent, ours.two_sided.upper * percent, ours.rms * percent,
         same_topology(&topology, &b->topology) ? "kept" : "changed", seconds, b->mesh->triangle_count / seconds, triangles,
         theirs.two_sided.upper * percent, theirs.rms * percent, same_topology(&their_topology, &b->topology) ? "kept" : "changed",
         (double)level->meshes[0].triangle_count / (double)triangles);
  fflush(stdout);
  return LOD_OK;
}

/* Each epsilon from the source: the exact mode's speed. */
static void bench_mesh(const char *name, const struct lod_mesh *mesh, const double *percents, int count) {
  struct bench b = {.arena = lod_arena_create(0), .mesh = mesh};
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  b.diagonal = lod_bounds_diagonal(&bounds);
  must(lod_bvh_create(mesh, 1, b.arena, &b.bvh));
  must(lod_topology_measure(mesh, NULL, b.arena, &b.topology));
  printf("%s: %u triangles\n", name, mesh->triangle_count);
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  for (int i = 0; i < count; i++) {
    double epsilon = percents[i] / 100 * b.diagonal;
    struct lod_envelope_settings settings = lod_envelope_defaults();
    settings.epsilons = &epsilon;
    settings.epsilon_count = 1;
    settings.reserve = settings.least_gain = 0;
    settings.threads = 1;
    struct row row = {&b, percents[i], cpu_seconds()};
    struct lod_problem problem = {0};
    must(lod_envelope_family.build(&unit, 1, &settings, NULL, b.arena, print_row, &row, &problem));
  }
  lod_arena_destroy(b.arena);
}

static enum lod_status count_level(void *context, const struct lod_level *level) {
  printf(" %u", level->meshes[0].triangle_count);
  ++*(int *)context;
  return LOD_OK;
}

static void bench_ladder(const struct lod_mesh *mesh) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  struct lod_problem problem = {0};
  int levels = 0;
  printf("  default ladder:");
  double started = cpu_seconds();
  must(lod_envelope_family.build(&unit, 1, NULL, NULL, arena, count_level, &levels, &problem));
  printf(" triangles, %d levels in %.2f s\n", levels, cpu_seconds() - started);
  lod_arena_destroy(arena);
}

static bool read_welded(const char *path, struct lod_arena *arena, struct lod_mesh *mesh) {
  struct lod_mesh raw;
  return lod_ply_read(path, arena, &raw) && lod_mesh_weld(&raw, arena, mesh, NULL) == LOD_OK;
}

int main(int argc, char **argv) {
  static const char *const kModels[] = {"bunny", "igea", "fandisk"};
  double percents[16] = {0.1, 0.5, 2};
  int count = argc > 2 ? argc - 2 : 3;
  for (int i = 0; i < count && i < 16 && argc > 2; i++)
    percents[i] = atof(argv[i + 2]);
  count = count > 16 ? 16 : count;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh;
  bool any = false;
  for (size_t i = 0; i < (argc > 1 ? 1 : sizeof kModels / sizeof kModels[0]); i++) {
    char path[1024];
    snprintf(path, sizeof path, "%s/models/scans/%s.ply", lod_shared_folder() == NULL ? "." : lod_shared_folder(), kModels[i]);
    if (!read_welded(argc > 1 ? argv[1] : path, arena, &mesh))
      continue;
    any = true;
    bench_mesh(argc > 1 ? argv[1] : kModels[i], &mesh, percents, count);
    bench_ladder(&mesh);
  }
  if (!any) {
    mesh = lod_shape_torus(arena, 2, 0.6, 200, 100);
    bench_mesh("torus", &mesh, percents, count);
    bench_ladder(&mesh);
  }
  lod_arena_destroy(arena);
  return 0;
}
