/* Deltas beside Draco: bits by part, all levels of a nested hierarchy against the finest one alone and against separate levels, the first
 * picture, bytes until an error is met, speed (CPU time) and memory. Draco is at speed 0 on the same grids.
 *
 *   make bench-delta BENCH_ARGS="[-m retile|collapse|scan|envelope] [-b BITS] [-r RATIO] [-f SHARE] [-l LEAST] [-p] [-v] [-e]
 *                           [-u TRIANGLES] [-n DECODES] [PLY...]"
 *
 * retile (default): the finest level is re-tiled with SHARE (0.25) of the source's vertices; collapse: the finest is simplified to SHARE of
 * the source's triangles by meshopt_simplify, whose vertices are the source's, and so are all others; scan: the same with the source itself
 * as finest level; envelope: certified collapse to source vertices, 0.1 % of the diagonal the finest error, each coarser one 2.5 times
 * that. Each level (but envelope's) has 1 / RATIO (4) of the vertices of the next. The finest is quantised with BITS (12) along the longest
 * side, coarser ones as much more coarsely as they have fewer vertices, up to 32 times; -p: as bakes do, so that quantisation moves nothing
 * by more than a quarter of the level's certified error. The coarsest level has more than LEAST (50) vertices. -v: a line a level. -e:
 * bytes until certified errors are met, ours beside the best of Draco of meshopt_simplify bisected to that error, which takes minutes a
 * model. -u: steps in units too, of at most TRIANGLES of the coarser level each; bytes of all of them over the whole step's, for steps that
 * have at least two. -n: how often each level is decoded; the quickest turn counts (3). Memory is warm: rates are of decoding, not of the
 * kernel's pages. */
#include <dirent.h>
#include <malloc.h>
#include <math.h>
#include <meshoptimizer.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "codec/export/draco.h"
#include "codec/stream/delta.h"
#include "codec/stream/units.h"
#include "core/envelope/envelope.h"
#include "core/mesh/distance.h"
#include "core/retile/retile.h"
#include "tests/data/nested.h"
#include "tests/data/ply.h"

enum { MOST_LEVELS = 12, COARSEST_STEP = 32, ERRORS = 7 };
static const double kErrors[ERRORS] = {0.08, 0.04, 0.02, 0.01, 0.005, 0.0025, 0.001};

struct options {
  const char *mode;
  double bits, ratio, share, least;
  bool verbose, errors, precise; /* precise: grids by certified errors */
  uint32_t units;                /* 0: none */
};

struct chain {
  uint32_t count; /* coarsest first */
  struct lod_mesh meshes[MOST_LEVELS];
  uint32_t *parents[MOST_LEVELS];
};

struct totals {
  double models, logs, ours, draco, separate, first;
  double vertices, triangles, encode_seconds, decode_seconds, finest_vertices;
  struct lod_delta_statistics bits;
  double united, in_units, patches; /* bytes of whole steps that units were made of, of these, how many */
};

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(bool good, const char *what) {
  if (!good) {
    fprintf(stderr, "delta_bench: %s\n", what);
    exit(1);
  }
}

/* ---- hierarchies ---- */

static struct lod_mesh simplify(const struct lod_mesh *mesh, size_t triangles, struct lod_arena *arena, uint32_t **parents) {
  struct lod_mesh out = {0};
  const size_t indices = 3 * (size_t)mesh->triangle_count;
  unsigned *kept = LOD_NEW(arena, indices, unsigned);
  uint32_t *map = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  out.positions = lod_arena_alloc(arena, mesh->vertex_count, sizeof *out.positions);
  *parents = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  must(kept != NULL && map != NULL && out.positions != NULL && *parents != NULL, "out of memory");
  memset(map, 0xff, (size_t)mesh->vertex_count * sizeof *map);
  const size_t count = meshopt_simplify(kept, &mesh->triangles[0][0], indices, &mesh->positions[0][0], mesh->vertex_count,
                                        sizeof *mesh->positions, 3 * triangles, 1e9f, 0, NULL);
  out.triangle_count = (uint32_t)(count / 3);
  out.triangles = lod_arena_alloc(arena, out.triangle_count, sizeof *out.triangles);
  must(out.triangles != NULL, "out of memory");
  for (size_t i = 0; i < count; i++) {
    uint32_t v = kept[i];
    if (map[v] == LOD_NONE) {
      map[v] = out.vertex_count;
      (*parents)[out.vertex_count] = v;
      memcpy(out.positions[out.vertex_count++], mesh->positions[v], sizeof *out.positions);
    }
    out.triangles[i / 3][i % 3] = map[v];
  }
  return out;
}

static void make_collapsed(const struct lod_mesh *source, const struct options *o, struct lod_arena *arena, struct chain *chain) {
  struct lod_mesh meshes[MOST_LEVELS];
  uint32_t *parents[MOST_LEVELS] = {NULL}, count = 0, *ignored;
  const bool whole = strcmp(o->mode, "scan") == 0;
  meshes[count++] = whole ? *source : simplify(source, (size_t)(o->share * source->triangle_count), arena, &ignored);
  while (count < MOST_LEVELS && meshes[count - 1].vertex_count / o->ratio > o->least) {
    const struct lod_mesh *finer = &meshes[count - 1];
    struct lod_mesh mesh = simplify(finer, (size_t)(finer->triangle_count / o->ratio), arena, &parents[count]);
    if (mesh.triangle_count > 0.8 * finer->triangle_count)
      break; /* stuck */
    meshes[count++] = mesh;
  }
  chain->count = count;
  for (uint32_t k = 0; k < count; k++) {
    chain->meshes[k] = meshes[count - 1 - k];
    chain->parents[k] = parents[count - 1 - k];
  }
}

static void make_retiled(const struct lod_mesh *source, const struct options *o, struct lod_arena *arena, struct chain *chain) {
  uint32_t counts[MOST_LEVELS], count = 0;
  for (double c = source->vertex_count * o->share; count < MOST_LEVELS && (c > o->least || count == 0); c /= o->ratio)
    counts[count++] = (uint32_t)c;
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = count;
  settings.threads = 1;
  struct lod_retile retile;
  must(lod_retile_create(source, &settings, NULL, arena, &retile, NULL) == LOD_OK, "re-tiling failed");
  chain->count = retile.level_count;
  for (uint32_t k = 0; k < count; k++) {
    const struct lod_mesh *mesh = &retile.levels[k].mesh; /* positions and triangles alone */
    chain->meshes[k] = (struct lod_mesh){.vertex_count = mesh->vertex_count,
                                         .triangle_count = mesh->triangle_count,
                                         .positions = mesh->positions,
                                         .triangles = mesh->triangles};
    chain->parents[k] = retile.levels[k].parents;
  }
}

struct catcher {
  struct chain finest_first;
  struct lod_arena *arena;
};

static enum lod_status catch_level(void *context, const struct lod_level *level) {
  struct catcher *c = context;
  struct chain *chain = &c->finest_first;
  const struct lod_mesh *mesh = &level->meshes[0];
  if (chain->count == MOST_LEVELS)
    return LOD_OK;
  struct lod_mesh bare = {.vertex_count = mesh->vertex_count, .triangle_count = mesh->triangle_count};
  bare.positions = lod_arena_copy(c->arena, mesh->positions, mesh->vertex_count * sizeof *mesh->positions);
  bare.triangles = lod_arena_copy(c->arena, mesh->triangles, mesh->triangle_count * sizeof *mesh->triangles);
  must(bare.positions != NULL && bare.triangles != NULL && (chain->count == 0 || level->parents != NULL), "envelope levels are not nested");
  if (chain->count > 0)
    chain->parents[chain->count] = lod_arena_copy(c->arena, level->parents[0], mesh->vertex_count * sizeof(uint32_t));
  chain->meshes[chain->count++] = bare;
  return LOD_OK;
}

static void make_envelope(const struct lod_mesh *source, const struct options *o, struct lod_arena *arena, struct chain *chain) {
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct lod_bounds bounds = lod_mesh_bounds(source);
  struct lod_unit unit = {.mesh = *source, .scale = 1};
  struct catcher c = {.arena = arena};
  double epsilons[6] = {0.001 * lod_bounds_diagonal(&bounds)};
  for (int i = 1; i < 6; i++)
    epsilons[i] = 2.5 * epsilons[i - 1];
  settings.epsilons = epsilons;
  settings.epsilon_count = 6;
  settings.collapse.vertex_subset = true;
  settings.least_gain = 0.65; /* as bakes of nested levels */
  settings.threads = 1;
  must(lod_envelope_family.build(&unit, 1, &settings, NULL, arena, catch_level, &c, NULL) == LOD_OK, "the envelope family failed");
  while (c.finest_first.count > 1 && c.finest_first.meshes[c.finest_first.count - 1].vertex_count < o->least / 2)
    c.finest_first.count--;
  chain->count = c.finest_first.count;
  for (uint32_t k = 0; k < chain->count; k++) {
    chain->meshes[k] = c.finest_first.meshes[chain->count - 1 - k];
    chain->parents[k] = c.finest_first.parents[chain->count - 1 - k];
  }
}

/* ---- the peer ---- */

struct draco {
  size_t size;
  double encode_seconds, decode_seconds;
};

static struct draco draco_of(const struct lod_rounded *level) {
  struct lod_arena *arena = lod_arena_create(0);
  const struct lod_mesh *mesh = &level->mesh;
  int32_t(*cells)[3] = lod_arena_alloc(arena, mesh->vertex_count, sizeof *cells), most = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int i = 0; i < 3; i++) {
      cells[v][i] = (int32_t)lrint(((double)mesh->positions[v][i] - (double)level->grid.origin[i]) / (double)level->grid.step);
      most = cells[v][i] > most ? cells[v][i] : most;
    }
  struct lod_draco_encode_request request = {.vertex_count = mesh->vertex_count,
                                             .positions = (const int32_t(*)[3])cells,
                                             .grid = {.step = level->grid.step, .bits = 1},
                                             .point_count = mesh->vertex_count,
                                             .triangle_count = mesh->triangle_count,
                                             .triangles = (const uint32_t(*)[3])mesh->triangles,
                                             .speed = 0};
  memcpy(request.grid.origin, level->grid.origin, sizeof request.grid.origin);
  while ((1 << request.grid.bits) - 1 < most)
    request.grid.bits++;
  struct draco result = {0};
  struct lod_draco_mesh decoded;
  uint8_t *bytes;
  uint32_t points, triangles;
  const double start = now();
  must(lod_draco_encode(&request, arena, &bytes, &result.size, &points, &triangles, NULL) == LOD_OK, "Draco cannot encode");
  const double encoded = now();
  must(lod_draco_decode(bytes, result.size, NULL, arena, &decoded, NULL) == LOD_OK, "Draco cannot decode");
  result.encode_seconds = encoded - start;
  result.decode_seconds = now() - encoded;
  lod_arena_destroy(arena);
  return result;
}

/* ---- ours ---- */

struct coded {
  size_t size, peak;
  double encode_seconds, decode_seconds;
  struct lod_delta_statistics bits;
};

static uint32_t decodes = 3;

static struct coded code(const struct chain *chain, const struct lod_rounded *levels, uint32_t k, struct lod_arena *arena) {
  struct coded result = {0};
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  struct lod_problem problem = {0};
  request.fine = &levels[k].mesh;
  request.grid = levels[k].grid;
  request.statistics = &result.bits;
  request.to = k;
  if (k > 0) {
    request.from = k - 1;
    request.base = &levels[k - 1].mesh;
    request.kept = lod_round_kept(&levels[k - 1], &levels[k], chain->parents[k - 1], chain->meshes[k - 1].vertex_count, arena);
  }
  uint8_t *bytes;
  double start = now();
  if (lod_delta_encode(&request, arena, &bytes, &result.size, &problem) != LOD_OK)
    must(false, problem.detail);
  result.encode_seconds = now() - start;
  result.decode_seconds = INFINITY;
  for (uint32_t i = 0; i < decodes; i++) {
    start = now();
    struct lod_arena *own = lod_arena_create(0);
    struct lod_delta_level level;
    if (lod_delta_decode(bytes, result.size, request.base, NULL, own, &level, &problem) != LOD_OK)
      must(false, problem.detail);
    result.peak = lod_arena_peak_bytes(own);
    lod_arena_destroy(own);
    result.decode_seconds = fmin(result.decode_seconds, now() - start);
  }
  return result;
}

/* The step in units, decoded and joined. */
static void in_units(const struct chain *chain, const struct lod_rounded *levels, uint32_t k, const struct options *o, size_t whole,
                     struct totals *t) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  struct lod_problem problem = {0};
  struct lod_units units;
  struct lod_delta_level joined;
  uint8_t *bytes;
  size_t size;
  request.base = &levels[k - 1].mesh;
  request.fine = &levels[k].mesh;
  request.grid = levels[k].grid;
  request.from = k - 1;
  request.to = k;
  struct lod_delta_statistics bits = {0};
  request.statistics = &bits;
  request.kept = lod_round_kept(&levels[k - 1], &levels[k], chain->parents[k - 1], chain->meshes[k - 1].vertex_count, arena);
  if (lod_units_encode(&request, o->units, arena, &bytes, &size, &problem) != LOD_OK)
    must(false, problem.detail);
  if (size != 0) {
    if (lod_units_open(bytes, size, request.base, NULL, arena, &units, &problem) != LOD_OK)
      must(false, problem.detail);
    struct lod_delta_level *decoded = LOD_NEW_ZERO(arena, units.header.patch_count, struct lod_delta_level);
    const struct lod_delta_level **all = LOD_NEW_ZERO(arena, units.header.patch_count, const struct lod_delta_level *);
    for (uint32_t p = 0; p < units.header.patch_count; p++) {
      if (units.patches[p].size == 0)
        continue;
      if (lod_units_decode(&units, p, bytes + units.patches[p].offset, units.patches[p].size, NULL, arena, &decoded[p], &problem) != LOD_OK)
        must(false, problem.detail);
      all[p] = &decoded[p];
    }
    if (lod_units_join(&units, all, arena, &joined, &problem) != LOD_OK)
      must(false, problem.detail);
    t->united += (double)whole;
    t->in_units += (double)size;
    t->patches += units.header.patch_count;
    if (o->verbose)
      printf(
          "   %7u v in %u units: connectivity %5.2f match %5.2f kept %5.2f positions %6.2f header %4.2f bits a vertex | %zu B, %.3f of the "
          "whole step's\n",
          levels[k].mesh.vertex_count, units.header.patch_count, bits.connectivity / levels[k].mesh.vertex_count,
          bits.match / levels[k].mesh.vertex_count, bits.kept / levels[k].mesh.vertex_count, bits.geometry / levels[k].mesh.vertex_count,
          bits.header / levels[k].mesh.vertex_count, size, (double)size / (double)whole);
  }
  lod_arena_destroy(arena);
}

/* ---- errors ---- */

static double certified(const struct lod_mesh *level, const struct lod_mesh *source) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_distance_settings settings = lod_distance_defaults();
  struct lod_distance distance;
  must(lod_distance_measure(level, source, &settings, arena, &distance) == LOD_OK, "cannot measure");
  lod_arena_destroy(arena);
  return distance.two_sided.upper;
}

/* Fewest bytes of Draco of meshopt_simplify whose certified error is at most `error`: fewest triangles by bisection, for each of a few
 * precisions. */
static size_t peer_bytes(const struct lod_mesh *source, double error) {
  size_t best = 0;
  for (double part = 0.5; part > 0.1; part /= 2) { /* of the error, for quantisation */
    double low = 4, high = source->triangle_count;
    size_t bytes = 0;
    for (int i = 0; i < 12 && high > 1.02 * low; i++) {
      struct lod_arena *arena = lod_arena_create(0);
      const double middle = i == 0 ? high : sqrt(low * high);
      uint32_t *parents;
      struct lod_mesh mesh = simplify(source, (size_t)middle, arena, &parents);
      struct lod_rounded rounded = lod_round_mesh(&mesh, part * error * 2 / sqrt(3.0), arena);
      const bool fits = rounded.mesh.triangle_count > 0 && certified(&rounded.mesh, source) <= error;
      if (fits) {
        bytes = draco_of(&rounded).size;
        high = middle;
      } else if (i == 0) {
        high = 0; /* not even all of it */
      } else {
        low = middle;
      }
      lod_arena_destroy(arena);
    }
    if (bytes != 0 && (best == 0 || bytes < best))
      best = bytes;
  }
  return best;
}

static void print_errors(const struct chain *chain, const struct lod_rounded *levels, const size_t *sizes, const struct lod_mesh *source) {
  struct lod_bounds bounds = lod_mesh_bounds(source);
  const double diagonal = lod_bounds_diagonal(&bounds);
  double errors[MOST_LEVELS];
  for (uint32_t k = 0; k < chain->count; k++)
    errors[k] = certified(&levels[k].mesh, source);
  printf("   error %%      ours bytes (error %%)     peer bytes   ratio\n");
  for (int e = 0; e < ERRORS; e++) {
    size_t sum = 0;
    uint32_t k = 0;
    for (; k < chain->count; k++) {
      sum += sizes[k];
      if (errors[k] <= kErrors[e] * diagonal)
        break;
    }
    const size_t peer = peer_bytes(source, kErrors[e] * diagonal);
    if (k == chain->count)
      printf("   %5.2f     not met (%.3f)            %10zu\n", 100 * kErrors[e], 100 * errors[k - 1] / diagonal, peer);
    else
      printf("   %5.2f     %10zu (%.3f)          %10zu   %5.2f\n", 100 * kErrors[e], sum, 100 * errors[k] / diagonal, peer,
             peer > 0 ? (double)sum / (double)peer : 0);
    fflush(stdout);
  }
}

/* ---- one model ---- */

static void print_level(const struct lod_rounded *level, const struct coded *c, const struct draco *d) {
  const double v = level->mesh.vertex_count;
  printf("   %7.0f v %7u t | connectivity %5.2f match %5.2f kept %5.2f positions %6.2f rest %4.2f header %4.2f = %6.2f bits a vertex | "
         "%8zu B, Draco %8zu | encode %5.0f kt/s (Draco %5.0f) decode %5.0f kv/s (Draco %5.0f) %5.1f MB\n",
         v, level->mesh.triangle_count, c->bits.connectivity / v, c->bits.match / v, c->bits.kept / v, c->bits.geometry / v,
         (c->bits.groups + c->bits.attributes) / v, c->bits.header / v, 8.0 * (double)c->size / v, c->size, d->size,
         1e-3 * level->mesh.triangle_count / c->encode_seconds, 1e-3 * level->mesh.triangle_count / d->encode_seconds,
         1e-3 * v / c->decode_seconds, 1e-3 * v / d->decode_seconds, (double)c->peak / 1048576);
}

static void add(struct totals *t, const struct lod_rounded *level, const struct coded *c) {
  t->ours += (double)c->size;
  t->vertices += level->mesh.vertex_count;
  t->triangles += level->mesh.triangle_count;
  t->encode_seconds += c->encode_seconds;
  t->decode_seconds += c->decode_seconds;
  t->bits.connectivity += c->bits.connectivity;
  t->bits.match += c->bits.match;
  t->bits.kept += c->bits.kept;
  t->bits.geometry += c->bits.geometry;
}

static void bench(const char *path, const struct options *o, struct totals *t) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh raw, source;
  struct chain chain = {0};
  struct lod_rounded levels[MOST_LEVELS];
  size_t sizes[MOST_LEVELS], total = 0, separate = 0, finest = 0;
  if (!lod_ply_read(path, arena, &raw) || lod_mesh_weld(&raw, arena, &source, NULL) != LOD_OK || source.vertex_count < 500) {
    lod_arena_destroy(arena);
    return;
  }
  struct lod_bounds bounds = lod_mesh_bounds(&source);
  double side = 0;
  for (int i = 0; i < 3; i++)
    side = fmax(side, bounds.max[i] - bounds.min[i]);
  if (strcmp(o->mode, "retile") == 0)
    make_retiled(&source, o, arena, &chain);
  else if (strcmp(o->mode, "envelope") == 0)
    make_envelope(&source, o, arena, &chain);
  else
    make_collapsed(&source, o, arena, &chain);
  for (uint32_t k = 0; k < chain.count; k++) {
    const double coarser = (double)chain.meshes[chain.count - 1].vertex_count / chain.meshes[k].vertex_count,
                 unit = side / (exp2(o->bits) - 1);
    double step = unit * fmin(coarser, COARSEST_STEP);
    if (o->precise && k + 1 < chain.count)
      step = fmax(unit, certified(&chain.meshes[k], &source) / 4 * 2 / sqrt(3));
    levels[k] = lod_round_mesh(&chain.meshes[k], step, arena);
  }
  if (o->verbose)
    printf("%s\n", path);
  for (uint32_t k = 0; k < chain.count; k++) {
    struct coded c = code(&chain, levels, k, arena);
    struct draco d = draco_of(&levels[k]);
    if (o->verbose)
      print_level(&levels[k], &c, &d);
    add(t, &levels[k], &c);
    if (o->units != 0 && k > 0)
      in_units(&chain, levels, k, o, c.size, t);
    total += sizes[k] = c.size;
    separate += d.size;
    finest = d.size;
  }
  const char *name = strrchr(path, '/') != NULL ? strrchr(path, '/') + 1 : path;
  printf("%-22.22s %7u v %2u levels | %8zu B | %5.3f of Draco's finest (%8zu B), %5.3f of separate levels | first picture %5.2f%%\n", name,
         levels[chain.count - 1].mesh.vertex_count, chain.count, total, (double)total / (double)finest, finest,
         (double)total / (double)separate, 100.0 * (double)sizes[0] / (double)total);
  t->models++;
  t->logs += log((double)total / (double)finest);
  t->draco += (double)finest;
  t->separate += (double)separate;
  t->first += (double)sizes[0];
  t->finest_vertices += levels[chain.count - 1].mesh.vertex_count;
  if (o->errors)
    print_errors(&chain, levels, sizes, &source);
  fflush(stdout);
  lod_arena_destroy(arena);
}

static int compare_names(const void *a, const void *b) {
  return strcmp(*(char *const *)a, *(char *const *)b);
}

static void bench_folder(const char *folder, const struct options *o, struct totals *t) {
  char *names[512], path[8192];
  size_t count = 0;
  DIR *directory = opendir(folder);
  for (struct dirent *entry; directory != NULL && count < 512 && (entry = readdir(directory)) != NULL;)
    if (strstr(entry->d_name, ".ply") != NULL)
      names[count++] = strdup(entry->d_name);
  if (directory != NULL)
    closedir(directory);
  qsort(names, count, sizeof *names, compare_names);
  for (size_t i = 0; i < count; i++) {
    snprintf(path, sizeof path, "%s/%s", folder, names[i]);
    bench(path, o, t);
    free(names[i]);
  }
}

static void print_totals(const struct totals *t) {
  if (t->models == 0)
    return;
  printf("%.0f models: %.3f of Draco's finest level (geometric mean %.3f), %.3f of separate levels, first picture %.2f%% | bits a finest "
         "vertex: connectivity %.2f match %.2f kept %.2f positions %.2f | encode %.0f kt/s, decode %.0f kv/s\n",
         t->models, t->ours / t->draco, exp(t->logs / t->models), t->ours / t->separate, 100 * t->first / t->ours,
         t->bits.connectivity / t->finest_vertices, t->bits.match / t->finest_vertices, t->bits.kept / t->finest_vertices,
         t->bits.geometry / t->finest_vertices, 1e-3 * t->triangles / t->encode_seconds, 1e-3 * t->vertices / t->decode_seconds);
  if (t->united > 0)
    printf("steps in units: %.0f patches, %.3f of the whole steps' bytes\n", t->patches, t->in_units / t->united);
}

int main(int argc, char **argv) {
  struct options o = {.mode = "retile", .bits = 12, .ratio = 4, .share = 0.25, .least = 50};
  struct totals totals = {0};
  bool given = false;
  mallopt(M_MMAP_MAX, 0);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  for (int i = 1; i < argc; i++) {
    const char *value = i + 1 < argc ? argv[i + 1] : "";
    if (strcmp(argv[i], "-v") == 0)
      o.verbose = true;
    else if (strcmp(argv[i], "-e") == 0)
      o.errors = true;
    else if (strcmp(argv[i], "-p") == 0)
      o.precise = true;
    else if (strcmp(argv[i], "-l") == 0)
      o.least = atof(value), i++;
    else if (strcmp(argv[i], "-m") == 0)
      o.mode = value, i++;
    else if (strcmp(argv[i], "-u") == 0)
      o.units = (uint32_t)atoi(value), i++;
    else if (strcmp(argv[i], "-n") == 0)
      decodes = (uint32_t)fmax(1, atof(value)), i++;
    else if (strcmp(argv[i], "-b") == 0)
      o.bits = atof(value), i++;
    else if (strcmp(argv[i], "-r") == 0)
      o.ratio = atof(value), i++;
    else if (strcmp(argv[i], "-f") == 0)
      o.share = atof(value), i++;
    else
      bench(argv[i], &o, &totals), given = true;
  }
  const char *shared = lod_shared_folder();
  static const char *const kFolders[] = {"scans", "cad", "iso"};
  for (size_t f = 0; f < 3 && !given && shared != NULL; f++) {
    char path[4200];
    struct totals part = {0};
    snprintf(path, sizeof path, "%s/models/%s", shared, kFolders[f]);
    bench_folder(path, &o, &part);
    printf("%s: ", kFolders[f]);
    print_totals(&part);
  }
  print_totals(&totals);
  return 0;
}
