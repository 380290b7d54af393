/* The paper's table 2 in kind: how much smaller the parts of an assembly become at percents of their own diagonals. */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "codec/import/import.h"
#include "core/envelope/envelope.h"
#include "core/mesh/intersect.h"
#include "tests/bench/envelope_bench.h"

enum { LEVELS = 4 };
static const double kPercents[LEVELS] = {1, 2, 4, 8};
static const double kPaper[LEVELS] = {37.8, 54.6, 63.7, 68.7};

struct sums {
  uint64_t source, result[LEVELS], direct[LEVELS];
  double worst[LEVELS]; /* certified error over epsilon */
  uint32_t parts, changed_topology, level;
  const struct lod_mesh *mesh;
  double epsilon;
  struct lod_topology topology;
  struct lod_arena *arena;
};

/* One part of the model with positions alone: the table is about geometry. */
static struct lod_mesh take_part(const struct lod_mesh *mesh, uint32_t part, struct lod_arena *arena) {
  struct lod_mesh raw = {.vertex_count = mesh->vertex_count, .positions = mesh->positions}, welded;
  raw.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *raw.triangles);
  if (raw.triangles == NULL)
    abort();
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint32_t *v = mesh->triangles[t];
    if ((mesh->parts == NULL || mesh->parts[t] == part) && v[0] != v[1] && v[1] != v[2] && v[2] != v[0])
      memcpy(raw.triangles[raw.triangle_count++], v, sizeof *raw.triangles);
  }
  must(lod_mesh_weld(&raw, arena, &welded, NULL));
  return welded;
}

static enum lod_status take_level(void *context, const struct lod_level *level) {
  struct sums *sums = context;
  const struct lod_mesh *result = &level->meshes[0];
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.threads = 1;
  settings.larger_side_only = true;
  settings.hint_ab = level->nearby == NULL ? NULL : level->nearby[0];
  struct lod_distance distance;
  struct lod_topology topology;
  must(lod_distance_measure(sums->mesh, result, &settings, sums->arena, &distance));
  must(lod_topology_measure(result, NULL, sums->arena, &topology));
  sums->result[sums->level] += result->triangle_count;
  double share = distance.two_sided.lower / sums->epsilon;
  if (share > sums->worst[sums->level])
    sums->worst[sums->level] = share;
  sums->changed_topology += topology.components != sums->topology.components || topology.euler != sums->topology.euler ||
                            topology.boundary_loops != sums->topology.boundary_loops;
  return LOD_OK;
}

static void simplify(struct sums *sums, const struct lod_mesh *mesh) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  sums->mesh = mesh;
  sums->source += mesh->triangle_count;
  sums->parts++;
  must(lod_topology_measure(mesh, NULL, sums->arena, &sums->topology));
  for (sums->level = 0; sums->level < LEVELS; sums->level++) {
    sums->epsilon = kPercents[sums->level] / 100 * lod_bounds_diagonal(&bounds);
    struct lod_envelope_settings settings = lod_envelope_defaults();
    settings.epsilons = &sums->epsilon;
    settings.epsilon_count = 1;
    settings.reserve = settings.least_gain = 0;
    settings.threads = 1;
    struct lod_problem problem = {0};
    must(lod_envelope_family.build(&unit, 1, &settings, NULL, sums->arena, take_level, sums, &problem));
  }
}

bool bench_parts(const char *path) {
  struct cli_file file;
  struct lod_problem problem = {0};
  if (access(path, R_OK) != 0 || cli_file_open(path, &file, &problem) != LOD_OK)
    return false;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_import_request request = {.name = path, .bytes = file.bytes, .size = file.size, .threads = 1};
  struct lod_model model;
  must(lod_import_model(&request, arena, &model, &problem));
  struct sums sums = {0};
  double started = cpu_seconds();
  for (uint32_t p = 0; p < model.part_count; p++) {
    struct lod_arena *part = lod_arena_create_child(arena);
    struct lod_mesh mesh = take_part(&model.units[model.parts[p].unit].mesh, p, part);
    sums.arena = part;
    if (mesh.triangle_count != 0)
      simplify(&sums, &mesh);
    lod_arena_destroy(part);
  }
  const char *name = strrchr(path, '/');
  printf("\nPercent reduction over all parts, each by itself, at percents of its own diagonal: %s, %u parts, %llu triangles, %.1f s\n",
         name == NULL ? path : name + 1, sums.parts, (unsigned long long)sums.source, cpu_seconds() - started);
  printf("  %8s %10s %10s %10s %16s\n", "epsilon", "triangles", "reduction", "the paper", "error / epsilon");
  for (int i = 0; i < LEVELS; i++)
    printf("  %6.0f %% %10llu %8.1f %% %8.1f %% %16.4f\n", kPercents[i], (unsigned long long)sums.result[i],
           100 - 100 * (double)sums.result[i] / (double)sums.source, kPaper[i], sums.worst[i]);
  printf("  topology changed in %u of %u levels\n", sums.changed_topology, sums.parts * LEVELS);
  lod_arena_destroy(arena);
  cli_file_close(&file);
  return true;
}
