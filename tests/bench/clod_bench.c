/* Curved levels: per model patches against certified error, bytes and CPU time, beside the envelope family's GLB at the same certified
 * error.
 *
 * Errors are those of what the bytes decode to: measured after decoding and tessellation, the bound of the chords and the import's rounding
 * added; "bound" is what the simplification itself proves before coding. Arguments: [-e 0] leaves the envelope family out; files, or
 * "telephone". Default: a smooth sphere, a generated telephone in place of the paper's, its bunny rows (69 451, 19 774, 8 785, 3 815, 1
 * 000) and splines of the shared models. */
#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "codec/import/import.h"
#include "codec/stream/patches.h"
#include "core/clod/clod.h"
#include "core/clod/dynamic.h"
#include "core/clod/halve.h"
#include "core/clod/tessellate.h"
#include "core/envelope/envelope.h"
#include "server/worker/levels.h"
#include "tests/data/shapes.h"

static bool with_envelope = true;
/* Share of the diagonal below which the envelope family would need minutes. */
static const double kEnvelopeLeast = 3e-4;

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "clod_bench: %s\n", lod_status_name(status));
    exit(1);
  }
}

struct subject {
  const char *name;
  struct lod_arena *arena;
  struct lod_model model;
  struct lod_bvh *bvh;
  double diagonal;
};

static struct lod_tessellation tessellate(const struct lod_patches *patches, double tolerance, bool normals, struct lod_arena *arena) {
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  struct lod_tessellation flat;
  settings.tolerance = tolerance;
  settings.normals = normals;
  settings.threads = 1;
  must(lod_tessellate(patches, &settings, arena, &flat, NULL));
  return flat;
}

struct envelope {
  const struct subject *subject;
  struct lod_baked_level level;
  struct lod_arena *arena;
};

static enum lod_status take_level(void *context, const struct lod_level *level) {
  struct envelope *envelope = context;
  struct lod_bvh *bvhs[1] = {envelope->subject->bvh};
  struct lod_level_baker baker = {
      .model = &envelope->subject->model, .source_bvhs = bvhs, .diagonal = envelope->subject->diagonal, .threads = 1};
  return lod_level_bake(&baker, level, 0, envelope->arena, &envelope->level, NULL);
}

/* The envelope family within `error`, quantisation included. */
static void bench_envelope(const struct subject *subject, double error, struct lod_arena *arena) {
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct envelope envelope = {.subject = subject, .arena = arena};
  double epsilon = error - subject->model.rounding, began = now();
  if (!(epsilon > 0) || subject->model.unit_count != 1) {
    printf("  -\n");
    return;
  }
  settings.epsilons = &epsilon;
  settings.epsilon_count = 1;
  settings.least_gain = 0;
  settings.threads = 1;
  must(lod_envelope_family.build(subject->model.units, 1, &settings, NULL, arena, take_level, &envelope, NULL));
  printf("  | %7llu %8zu %8.4f %7.2f\n", (unsigned long long)envelope.level.triangles, envelope.level.size,
         100 * envelope.level.error.upper / subject->diagonal, now() - began);
}

static void bench_row(const struct subject *subject, struct lod_clod *clod, uint32_t wanted, double *seconds) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_clod_facts before, facts;
  lod_clod_facts(clod, &before);
  double began = now();
  must(lod_clod_simplify(clod, wanted, INFINITY, NULL));
  double taken = now() - began;
  *seconds += taken;
  lod_clod_facts(clod, &facts);
  struct lod_patches patches, decoded;
  must(lod_clod_extract(clod, facts.clod, arena, &patches, NULL));
  must(lod_patches_separate(&patches, arena, &patches));
  double gap = lod_patches_normal_gap(&patches, 8);
  uint32_t folded = 0;
  for (uint32_t p = 0; p < patches.patch_count; p++) {
    struct lod_bezier net = lod_patches_net(&patches, p);
    folded += !lod_bezier_is_regular(&net);
  }
  double own = fmax(facts.error, 1e-5 * subject->diagonal);
  struct lod_patches_encode_request encode = {.patches = &patches, .unit_count = 1, .step = 0.4 * own, .error = facts.error};
  struct lod_patches_header header;
  uint8_t *bytes;
  size_t size;
  must(lod_patches_encode(&encode, arena, &bytes, &size, NULL));
  must(lod_patches_decode(bytes, size, 0, arena, &header, &decoded, NULL));
  struct lod_tessellation flat = tessellate(&decoded, 0.1 * own, false, arena);
  struct lod_distance distance;
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.absolute = 1e-6 * subject->diagonal;
  settings.larger_side_only = true;
  settings.bvh_a = subject->bvh;
  must(lod_distance_measure(&subject->model.units[0].mesh, &flat.mesh, &settings, arena, &distance));
  double error = distance.two_sided.upper + flat.deviation + subject->model.rounding;
  printf("%-20s %7u %8.4f %8.4f %8zu %5.1f %7.2f %9.0f %6.1f", subject->name, facts.patches, 100 * facts.error / subject->diagonal,
         100 * error / subject->diagonal, size, (double)size / fmax(1, facts.patches), taken,
         (before.patches - facts.patches) / fmax(taken, 1e-9), gap);
  printf(" %5.1f %4u", lod_patches_normal_gap(&decoded, 8), folded);
  fflush(stdout);
  if (with_envelope && error > kEnvelopeLeast * subject->diagonal)
    bench_envelope(subject, error, arena);
  else
    printf("\n");
  lod_arena_destroy(arena);
}

static void bench_tessellation(const struct subject *subject, const struct lod_clod *clod) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_clod_facts facts;
  struct lod_patches patches;
  lod_clod_facts(clod, &facts);
  must(lod_clod_extract(clod, facts.clod, arena, &patches, NULL));
  for (int normals = 0; normals < 2; normals++) {
    double first = 0, taken = INFINITY;
    struct lod_tessellation flat;
    for (int turn = 0; turn < 5; turn++) {
      struct lod_arena *scratch = lod_arena_create_child(arena);
      double began = now();
      flat = tessellate(&patches, 2e-5 * subject->diagonal, normals != 0, scratch);
      taken = fmin(taken, now() - began);
      first = turn == 0 ? taken : first;
      lod_arena_destroy(scratch);
    }
    printf("%-20s tessellation%s: %u vertices, %u triangles, %.1f M vertices/s (the first time, pages being mapped, %.1f)\n", subject->name,
           normals ? " with normals" : "", flat.mesh.vertex_count, flat.mesh.triangle_count,
           1e-6 * flat.mesh.vertex_count / fmax(taken, 1e-9), 1e-6 * flat.mesh.vertex_count / fmax(first, 1e-9));
  }
  lod_arena_destroy(arena);
}

/* Following a view: everything made anew by turns at two tolerances, in memory that is there already; then a camera that moves. */
static void bench_dynamic(const struct subject *subject, const struct lod_clod *clod, enum lod_smoothness smoothness) {
  enum { TURNS = 6, FRAMES = 60 };
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_clod_facts facts;
  struct lod_patches patches;
  struct lod_dynamic *dynamic;
  struct lod_dynamic_stats stats;
  lod_clod_facts(clod, &facts);
  must(lod_clod_extract(clod, facts.clod, arena, &patches, NULL));
  if (smoothness == LOD_SMOOTH_STRICT)
    must(lod_patches_make_strict(&patches, arena, &patches, NULL));
  must(lod_dynamic_create(&patches, arena, &dynamic));
  struct lod_bounds bounds = lod_model_bounds(&subject->model);
  struct lod_vec3 centre = {(bounds.min[0] + bounds.max[0]) / 2, (bounds.min[1] + bounds.max[1]) / 2, (bounds.min[2] + bounds.max[2]) / 2};
  struct lod_dynamic_view view = {.eye = lod_vec3_add(centre, (struct lod_vec3){0, 0, 1.3 * subject->diagonal}),
                                  .forward = {0, 0, -1},
                                  .up = {0, 1, 0},
                                  .fov_degrees = 45,
                                  .aspect = 1.6,
                                  .height_px = 1080,
                                  .near = 1e-3 * subject->diagonal};
  struct lod_dynamic_settings settings = lod_dynamic_defaults();
  settings.smoothness = smoothness;
  settings.cull_back = settings.cull_outside = false;
  uint64_t vertices = 0;
  double began = 0;
  for (int turn = -2; turn < TURNS; turn++) {
    if (turn == 0)
      began = now();
    settings.pixels = turn % 2 == 0 ? 0.03 : 0.3;
    must(lod_dynamic_update(dynamic, &view, &settings, &stats));
    vertices += turn < 0 ? 0 : stats.vertices_made;
  }
  double taken = now() - began;
  printf("%-20s following a view%s: %.1f M vertices/s made", subject->name, smoothness == LOD_SMOOTH_STRICT ? ", strictly smooth" : "",
         1e-6 * (double)vertices / fmax(taken, 1e-9));
  settings.pixels = 0.5;
  settings.cull_back = settings.cull_outside = true;
  must(lod_dynamic_update(dynamic, &view, &settings, &stats));
  uint64_t made = 0, seen = 0;
  began = now();
  for (int frame = 0; frame < FRAMES; frame++) {
    view.eye.z -= 0.012 * subject->diagonal;
    must(lod_dynamic_update(dynamic, &view, &settings, &stats));
    made += stats.patches_made;
    seen += stats.visible;
  }
  printf("; a moving camera: %.2f ms a frame, %.1f %% of %.0f patches seen made anew, %u triangles\n", 1e3 * (now() - began) / FRAMES,
         100 * (double)made / fmax(1, (double)seen), (double)seen / FRAMES, stats.triangles);
  lod_dynamic_destroy(dynamic);
  lod_arena_destroy(arena);
}

static void bench(struct subject *subject, const uint32_t *rows, uint32_t row_count) {
  struct lod_bounds bounds = lod_model_bounds(&subject->model);
  subject->diagonal = lod_bounds_diagonal(&bounds);
  must(lod_bvh_create(&subject->model.units[0].mesh, 1, subject->arena, &subject->bvh));
  struct lod_clod *clod;
  struct lod_clod_facts facts;
  double began = now(), seconds = 0;
  const struct lod_charts *charts = subject->model.units[0].charts;
  bool suitable = false;
  if (charts != NULL)
    must(lod_clod_create_charts(&subject->model.units[0].mesh, charts, NULL, subject->arena, &clod, &suitable, NULL));
  if (!suitable)
    must(lod_clod_create(&subject->model.units[0].mesh, NULL, subject->arena, &clod, NULL));
  lod_clod_facts(clod, &facts);
  printf("%-20s %s", subject->name, suitable ? "from splines: " : charts != NULL ? "splines do not match: " : "");
  printf("C-Model of %u patches in %.2f s (%.2f M triangles/s), bound %.4f %%, import within %.4f %%\n", facts.patches, now() - began,
         1e-6 * facts.patches / (now() - began), 100 * facts.error / subject->diagonal, 100 * subject->model.rounding / subject->diagonal);
  for (uint32_t i = 0; i < row_count; i++)
    bench_row(subject, clod, rows[i], &seconds);
  lod_clod_facts(clod, &facts);
  printf("%-20s %.2f s in all; %llu removals tried for %u made; all %u C-LODs in %.2f MB (input %.2f MB)\n", subject->name, seconds,
         (unsigned long long)facts.tried, facts.clod, facts.clod + 1, 1e-6 * (double)facts.history_bytes,
         1e-6 * (12.0 * subject->model.units[0].mesh.vertex_count + 12.0 * subject->model.units[0].mesh.triangle_count));
  bench_tessellation(subject, clod);
  bench_dynamic(subject, clod, LOD_SMOOTH_SHADED);
  bench_dynamic(subject, clod, LOD_SMOOTH_STRICT);
}

static bool load(struct subject *subject, const char *path) {
  FILE *file = fopen(path, "rb");
  if (file == NULL)
    return false;
  fseek(file, 0, SEEK_END);
  size_t size = (size_t)ftell(file);
  rewind(file);
  uint8_t *bytes = malloc(size + 1);
  bool read = bytes != NULL && fread(bytes, 1, size, file) == size;
  fclose(file);
  struct lod_problem problem = {0};
  struct lod_import_request request = {.name = path, .bytes = bytes, .size = size, .threads = 1};
  subject->name = strrchr(path, '/') == NULL ? path : strrchr(path, '/') + 1;
  subject->arena = lod_arena_create(0);
  if (!read || lod_import_model(&request, subject->arena, &subject->model, &problem) != LOD_OK)
    fprintf(stderr, "%s\n", problem.detail);
  free(bytes);
  return read && problem.status == LOD_OK;
}

static void bench_sphere(void) {
  static const uint32_t kRows[] = {2000, 500, 120, 40};
  struct subject subject = {.name = "sphere (generated)", .arena = lod_arena_create(0)};
  struct lod_part part = {.name = "", .instance_count = 1};
  double identity[1][16] = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  struct lod_unit unit = {.mesh = lod_shape_sphere(subject.arena, 1, 6), .scale = 1};
  part.instances = identity;
  subject.model = (struct lod_model){.format = "", .name = "", .unit_count = 1, .part_count = 1, .units = &unit, .parts = &part};
  bench(&subject, kRows, 4);
  lod_arena_destroy(subject.arena);
}

/* Half the keys' and the screen's height over the face of a telephone, at x, y; slopes are steep, not sharp. */
static double relief(double x, double y) {
  double height = 0;
  for (int key = 0; key < 15; key++) {
    double dx = (x - 0.2 * (key % 3 - 1)) / 0.075, dy = (y + 0.62 - 0.13 * (key / 3)) / 0.045, d = dx * dx * dx * dx + dy * dy * dy * dy;
    height += 0.012 / (1 + d * d);
  }
  double dx = x / 0.27, dy = (y - 0.4) / 0.24, d = pow(dx, 8) + pow(dy, 8);
  return height - 0.02 / (1 + d * d);
}

/* In place of the paper's telephone: a box with round edges, keys and a sunken screen, in as many triangles. */
static void bench_phone(void) {
  static const uint32_t kRows[] = {20037, 10562, 4362, 1623};
  enum { ALONG = 85, FACES = 6 };
  static const double kHalf[3] = {0.36, 0.8, 0.09}, kRound = 0.08;
  struct subject subject = {.name = "telephone (gen.)", .arena = lod_arena_create(0)};
  struct lod_part part = {.name = "", .instance_count = 1};
  double identity[1][16] = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  struct lod_mesh soup = {.vertex_count = FACES * (ALONG + 1) * 44, .triangle_count = FACES * ALONG * 43 * 2};
  soup.positions = lod_arena_alloc(subject.arena, soup.vertex_count, sizeof *soup.positions);
  soup.triangles = lod_arena_alloc(subject.arena, soup.triangle_count, sizeof *soup.triangles);
  uint32_t t = 0;
  for (int face = 0; face < FACES; face++)
    for (int i = 0; i <= ALONG; i++)
      for (int j = 0; j <= 43; j++) {
        uint32_t v = (uint32_t)((face * (ALONG + 1) + i) * 44 + j);
        int axis = face / 2, a = axis == 1 ? 2 : 1, b = axis == 0 ? 2 : 0;
        double side = face % 2 == 0 ? 1 : -1, p[3], q[3], length = 0;
        p[axis] = side;
        p[a] = 2.0 * i / ALONG - 1;
        p[b] = 2.0 * j / 43 - 1;
        for (int k = 0; k < 3; k++) {
          p[k] *= kHalf[k];
          q[k] = fmax(-kHalf[k] + kRound, fmin(kHalf[k] - kRound, p[k]));
          length += (p[k] - q[k]) * (p[k] - q[k]);
        }
        for (int k = 0; k < 3; k++)
          p[k] = q[k] + kRound * (p[k] - q[k]) / sqrt(length);
        if (p[2] > 0)
          p[2] += relief(p[0], p[1]);
        for (int k = 0; k < 3; k++)
          soup.positions[v][k] = (float)p[k];
        if (i == ALONG || j == 43)
          continue;
        bool turned = (side > 0) == (axis != 2);
        uint32_t c[4] = {v, v + 44, v + 45, v + 1};
        for (int half = 0; half < 2; half++, t++)
          for (uint32_t k = 0; k < 3; k++)
            soup.triangles[t][turned ? k : 2 - k] = c[k == 0 ? 0 : k + (uint32_t)half];
      }
  struct lod_unit unit = {.scale = 1};
  must(lod_mesh_weld(&soup, subject.arena, &unit.mesh, NULL));
  part.instances = identity;
  subject.model = (struct lod_model){.format = "", .name = "", .unit_count = 1, .part_count = 1, .units = &unit, .parts = &part};
  bench(&subject, kRows, 4);
  lod_arena_destroy(subject.arena);
}

int main(int argc, char **argv) {
  static const uint32_t kBunny[] = {19774, 8785, 3815, 1000}, kSpline[] = {2000, 800, 300, 120};
  const char *shared = getenv("LODESTREAM_SHARED");
  int first = 1;
  /* Memory that was given back is used again: otherwise mapping pages is most of what tessellation takes. */
  mallopt(M_MMAP_THRESHOLD, 1 << 30);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  if (argc > 2 && strcmp(argv[1], "-e") == 0) {
    with_envelope = strcmp(argv[2], "0") != 0;
    first = 3;
  }
  printf("%-20s %7s %8s %8s %8s %5s %7s %9s %6s %5s %4s  | %7s %8s %8s %7s\n", "model", "patches", "bound %", "error %", "bytes", "/p", "s",
         "patches/s", "gap", "coded", "fold", "tris", "bytes", "error %", "s");
  for (int i = first; i < argc; i++) {
    struct subject subject = {0};
    if (strcmp(argv[i], "telephone") == 0)
      bench_phone();
    else if (load(&subject, argv[i]))
      bench(&subject, kSpline, 4);
    lod_arena_destroy(subject.arena);
  }
  if (first < argc)
    return 0;
  bench_sphere();
  bench_phone();
  static const char *const kModels[] = {"scans/bunny.ply", "spline/teapot-32.bpt", "spline/vase.bpt", "spline/spot-acc-732.bpt"};
  for (size_t i = 0; i < sizeof kModels / sizeof *kModels; i++) {
    char path[4096];
    snprintf(path, sizeof path, "%s/models/%s", shared == NULL ? "../shared" : shared, kModels[i]);
    struct subject subject = {0};
    if (load(&subject, path))
      bench(&subject, i == 0 ? kBunny : kSpline, 4);
    lod_arena_destroy(subject.arena);
  }
  return 0;
}
