/* Who simplifies in bench-envelope: the family, the cover, and peers, which are bisected to the same certified error. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include <meshoptimizer.h>

#include "core/envelope/cover.h"
#include "core/envelope/envelope.h"
#include "tests/bench/envelope_bench.h"

static double peak_megabytes(void) {
  struct rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return (double)usage.ru_maxrss / 1024;
}

/* ---- ours ---- */

struct request {
  const struct bench *bench;
  struct verdict *verdict;
  double epsilon, started, megabytes;
};

static enum lod_status take_level(void *context, const struct lod_level *level) {
  struct request *request = context;
  request->verdict->seconds = cpu_seconds() - request->started;
  request->verdict->megabytes = fmax(0.1, peak_megabytes() - request->megabytes);
  bench_judge(request->bench, &level->meshes[0], level->nearby == NULL ? NULL : level->nearby[0], request->epsilon, request->verdict);
  return LOD_OK;
}

void bench_collapse(const struct bench *b, double epsilon, struct verdict *verdict) {
  struct lod_unit unit = {.mesh = *b->mesh, .scale = 1};
  struct lod_envelope_settings settings = lod_envelope_defaults();
  settings.epsilons = &epsilon;
  settings.epsilon_count = 1;
  settings.reserve = BENCH_RESERVE;
  settings.least_gain = 0;
  settings.threads = 1;
  struct request request = {b, verdict, epsilon, cpu_seconds(), peak_megabytes()};
  struct lod_problem problem = {0};
  must(lod_envelope_family.build(&unit, 1, &settings, NULL, b->arena, take_level, &request, &problem));
}

static void cover(const struct bench *b, double epsilon, enum lod_cover_offsets offsets, struct verdict *verdict) {
  struct lod_cover_settings settings = lod_cover_defaults();
  settings.offsets = offsets;
  struct lod_cover *c;
  struct lod_mesh level;
  struct lod_problem problem = {0};
  double started = cpu_seconds(), megabytes = peak_megabytes();
  if (lod_cover_create(b->mesh, b->bvh, &settings, b->arena, &c, &problem) != LOD_OK)
    return; /* not a surface */
  must(lod_cover_run(c, (1 - BENCH_RESERVE) * epsilon, NULL));
  uint32_t *nearby = LOD_NEW(b->arena, b->mesh->triangle_count, uint32_t);
  if (nearby == NULL)
    abort();
  must(lod_cover_extract(c, b->arena, &level, NULL, nearby));
  verdict->seconds = cpu_seconds() - started;
  verdict->megabytes = fmax(0.1, peak_megabytes() - megabytes);
  bench_judge(b, &level, nearby, epsilon, verdict);
}

void bench_cover(const struct bench *b, double epsilon, struct verdict *verdict) {
  cover(b, epsilon, LOD_COVER_NO_OFFSETS, verdict);
}

void bench_cover_offsets(const struct bench *b, double epsilon, struct verdict *verdict) {
  cover(b, epsilon, LOD_COVER_PAPER_OFFSETS, verdict);
}

/* ---- peers ---- */

/* Simplifies to about `target` triangles; false when it could not. The result lives until the next call. */
struct peer {
  const struct bench *bench;
  bool (*simplify)(struct peer *peer, uint32_t target, struct lod_mesh *level);
  uint32_t *indices;
  float (*positions)[3];
};

static void *take(size_t size) {
  void *memory = malloc(size);
  if (memory == NULL)
    abort();
  return memory;
}

/* Fewest triangles whose certified error fits, by bisection over the target to 1 %. Errors of a peer do not fall evenly with its triangles:
 * the search may miss a lucky target, as any user's would. */
static void bisect(struct peer *peer, double epsilon, struct verdict *verdict) {
  const struct bench *b = peer->bench;
  uint32_t low = 0, high = b->mesh->triangle_count, best = 0;
  struct lod_mesh level;
  double megabytes = peak_megabytes();
  while (high - low > 1 + high / 100) {
    uint32_t target = low + (high - low) / 2;
    double started = cpu_seconds();
    if (!peer->simplify(peer, target, &level)) {
      low = target;
      continue;
    }
    double seconds = cpu_seconds() - started;
    if (level.triangle_count != 0 && bench_measure(b, &level, NULL, false).two_sided.upper <= (1 - BENCH_RESERVE) * epsilon) {
      high = best = target;
      verdict->seconds = seconds;
    } else {
      low = target;
    }
  }
  verdict->megabytes = fmax(0.1, peak_megabytes() - megabytes);
  if (best != 0 && peer->simplify(peer, best, &level))
    bench_judge(b, &level, NULL, epsilon, verdict);
}

static bool simplify_meshopt(struct peer *peer, uint32_t target, struct lod_mesh *level) {
  const struct lod_mesh *mesh = peer->bench->mesh;
  size_t count = meshopt_simplify(peer->indices, &mesh->triangles[0][0], 3 * (size_t)mesh->triangle_count, &mesh->positions[0][0],
                                  mesh->vertex_count, 12, 3 * (size_t)target, FLT_MAX, 0, NULL);
  *level = (struct lod_mesh){.positions = mesh->positions, .vertex_count = mesh->vertex_count, .triangle_count = (uint32_t)(count / 3)};
  level->triangles = (uint32_t(*)[3])(void *)peer->indices;
  return count != 0;
}

void bench_meshopt(const struct bench *b, double epsilon, struct verdict *verdict) {
  struct peer peer = {.bench = b, .simplify = simplify_meshopt, .indices = take(12 * (size_t)b->mesh->triangle_count)};
  bisect(&peer, epsilon, verdict);
}

static bool simplify_cgal(struct peer *peer, uint32_t target, struct lod_mesh *level) {
  const struct lod_mesh *mesh = peer->bench->mesh;
  *level = (struct lod_mesh){.positions = peer->positions};
  level->triangles = (uint32_t(*)[3])(void *)peer->indices;
  level->triangle_count = bench_cgal_collapse((const float(*)[3])mesh->positions, mesh->vertex_count, (const uint32_t(*)[3])mesh->triangles,
                                              mesh->triangle_count, target, peer->positions, &level->vertex_count, level->triangles);
  return level->triangle_count != 0;
}

void bench_cgal(const struct bench *b, double epsilon, struct verdict *verdict) {
  if (!bench_has_cgal() || !b->topology.manifold || !b->topology.oriented)
    return; /* its surfaces are oriented manifolds */
  struct peer peer = {.bench = b,
                      .simplify = simplify_cgal,
                      .indices = take(12 * (size_t)b->mesh->triangle_count),
                      .positions = take(sizeof(float[3]) * b->mesh->vertex_count)};
  bisect(&peer, epsilon, verdict);
}
