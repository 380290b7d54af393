/* The judge of bench-envelope: Draco round trip, certified distance of what comes back, topology, crossings. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "codec/export/glb.h"
#include "core/mesh/intersect.h"
#include "tests/bench/envelope_bench.h"
#include "tests/data/models.h"

void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "bench-envelope: %s\n", lod_status_name(status));
    abort();
  }
}

double cpu_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

struct lod_distance bench_measure(const struct bench *b, const struct lod_mesh *level, const uint32_t *nearby, bool rms) {
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.threads = 1;
  settings.bvh_a = b->bvh;
  settings.hint_ab = nearby;
  settings.larger_side_only = true;
  settings.rms = rms;
  settings.absolute = 1e-7 * b->diagonal;
  struct lod_distance distance;
  must(lod_distance_measure(b->mesh, level, &settings, b->arena, &distance));
  return distance;
}

/* The mesh as a client decodes it; *draco: bytes of the Draco buffer alone. */
static struct lod_mesh round_trip(const struct bench *b, const struct lod_mesh *level, double epsilon, size_t *draco) {
  struct lod_mesh plain = *level, back;
  plain.wedge_count = 0;
  plain.corners = NULL;
  plain.materials = plain.parts = NULL;
  struct lod_model model = lod_sample_plain(b->arena, "level", plain);
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.position_error = BENCH_RESERVE * epsilon;
  settings.threads = 1;
  uint8_t *bytes;
  size_t size;
  struct lod_problem problem = {0};
  must(lod_glb_write(&model, &plain, &settings, b->arena, &bytes, &size, &problem));
  uint32_t json;
  memcpy(&json, bytes + 12, sizeof json);
  *draco = size - 12 - 8 - json - 8;
  must(lod_glb_read(bytes, size, &model, b->arena, &back, &problem));
  return back;
}

void bench_judge(const struct bench *b, const struct lod_mesh *level, const uint32_t *nearby, double epsilon, struct verdict *verdict) {
  verdict->found = true;
  verdict->triangles = level->triangle_count;
  verdict->plain_upper = bench_measure(b, level, nearby, false).two_sided.upper;
  struct lod_mesh decoded = round_trip(b, level, epsilon, &verdict->draco);
  struct lod_distance distance = bench_measure(b, &decoded, NULL, true);
  verdict->lower = distance.two_sided.lower;
  verdict->upper = distance.two_sided.upper;
  verdict->rms = distance.rms;
  must(lod_topology_measure(level, NULL, b->arena, &verdict->topology));
  const struct lod_topology *x = &b->topology, *y = &verdict->topology;
  verdict->same_topology =
      x->components == y->components && x->boundary_loops == y->boundary_loops && x->euler == y->euler && x->manifold == y->manifold;
  struct lod_crossings crossings;
  must(lod_intersect_count(level, NULL, b->arena, NULL, &crossings));
  verdict->crossings = crossings.pairs;
}

static double peak_megabytes(void) {
  struct rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return (double)usage.ru_maxrss / 1024;
}

struct verdict bench_in_child(void (*body)(const struct bench *b, double epsilon, struct verdict *verdict), const struct bench *b,
                              double epsilon) {
  struct verdict *shared = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0), result;
  if (shared == MAP_FAILED)
    abort();
  *shared = (struct verdict){0};
  fflush(stdout);
  pid_t child = fork();
  if (child < 0)
    abort();
  if (child == 0) {
    double before = peak_megabytes();
    body(b, epsilon, shared);
    if (shared->megabytes == 0) /* of all that was done; a body that knows better has said so */
      shared->megabytes = peak_megabytes() - before;
    _exit(0);
  }
  int status;
  if (waitpid(child, &status, 0) != child || !WIFEXITED(status) || WEXITSTATUS(status) != 0)
    shared->found = false;
  result = *shared;
  munmap(shared, sizeof *shared);
  return result;
}
