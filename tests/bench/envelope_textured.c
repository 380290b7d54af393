/* Textured models in bench-envelope: seams and normals kept, attributes measured, beside meshopt_simplify over split vertices,
 * primitive by primitive. */
#include <fcntl.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <meshoptimizer.h>

#include "clients/cli/cli.h"
#include "codec/export/glb.h"
#include "codec/import/import.h"
#include "core/envelope/envelope.h"
#include "tests/bench/envelope_bench.h"

struct textured {
  struct lod_arena *arena;
  struct lod_model model;
  double diagonal, epsilon, started;
  struct lod_envelope_report report;
  const char *aim, *who;
};

static double texture_width(const struct lod_model *model) {
  double width = 0;
  for (uint32_t i = 0; i < model->image_count; i++)
    width = fmax(width, model->images[i].width);
  return width;
}

/* Bytes of the level without its textures, and the certified error of what comes back, over all units. */
static size_t level_bytes(const struct textured *t, const struct lod_mesh *meshes, struct lod_interval *error) {
  struct lod_glb_settings settings = lod_glb_defaults();
  const char **uris = LOD_NEW(t->arena, t->model.image_count, const char *);
  struct lod_mesh *back = LOD_NEW(t->arena, t->model.unit_count, struct lod_mesh);
  if (uris == NULL || back == NULL)
    abort();
  for (uint32_t i = 0; i < t->model.image_count; i++)
    uris[i] = "texture";
  settings.image_uris = uris;
  settings.position_error = BENCH_RESERVE * t->epsilon;
  settings.threads = 1;
  uint8_t *bytes;
  size_t size;
  struct lod_problem problem = {0};
  must(lod_glb_write(&t->model, meshes, &settings, t->arena, &bytes, &size, &problem));
  must(lod_glb_read(bytes, size, &t->model, t->arena, back, &problem));
  *error = (struct lod_interval){0, 0};
  for (uint32_t u = 0; u < t->model.unit_count; u++) {
    struct lod_distance_settings measure = lod_distance_defaults();
    struct lod_distance distance;
    measure.threads = 1;
    measure.larger_side_only = true;
    must(lod_distance_measure(&t->model.units[u].mesh, &back[u], &measure, t->arena, &distance));
    error->lower = fmax(error->lower, distance.two_sided.lower * t->model.units[u].scale);
    error->upper = fmax(error->upper, distance.two_sided.upper * t->model.units[u].scale);
  }
  return size;
}

static uint32_t all_triangles(const struct textured *t, const struct lod_mesh *meshes) {
  uint32_t sum = 0;
  for (uint32_t u = 0; u < t->model.unit_count; u++)
    sum += meshes[u].triangle_count;
  return sum;
}

static void print_row(const struct textured *t, const char *who, uint32_t triangles, size_t bytes, struct lod_interval error, double texels,
                      double degrees, double seconds) {
  double percent = 100 / t->diagonal;
  char attributes[64] = "not measured";
  if (texels >= 0)
    snprintf(attributes, sizeof attributes, "%.1f texels, %.1f degrees", texels, degrees);
  printf("  %6.2f %%  %-16s %8u tri %9zu B  [%.4f, %.4f] %%  %-26s %6.2f s  %s\n", t->epsilon * percent, who, triangles, bytes,
         error.lower * percent, error.upper * percent, attributes, seconds, t->aim);
  fflush(stdout);
}

static enum lod_status take_level(void *context, const struct lod_level *level) {
  struct textured *t = context;
  double seconds = cpu_seconds() - t->started, uv = 0;
  struct lod_interval error;
  size_t bytes = level_bytes(t, level->meshes, &error);
  for (int set = 0; set < LOD_UV_SETS; set++)
    uv = fmax(uv, t->report.uv[set]);
  print_row(t, t->who, all_triangles(t, level->meshes), bytes, error, uv * texture_width(&t->model), t->report.normal_degrees, seconds);
  return LOD_OK;
}

/* meshopt_simplify of the triangles of one part and material, over wedges, so that seams and creases are borders. Appends to `out`. */
static void simplify_group(const struct textured *t, const struct lod_mesh *mesh, uint32_t part, uint32_t material,
                           const float (*positions)[3], uint32_t points, double share, struct lod_mesh *out) {
  const uint32_t(*from)[3] = (const uint32_t(*)[3])(mesh->wedge_count != 0 ? mesh->corners : mesh->triangles);
  uint32_t(*corners)[3] = lod_arena_alloc(t->arena, mesh->triangle_count, sizeof *corners), count = 0;
  uint32_t(*result)[3] = lod_arena_alloc(t->arena, mesh->triangle_count, sizeof *result);
  if (corners == NULL || result == NULL)
    abort();
  for (uint32_t i = 0; i < mesh->triangle_count; i++)
    if ((mesh->parts == NULL || mesh->parts[i] == part) && (mesh->materials == NULL || mesh->materials[i] == material))
      memcpy(corners[count++], from[i], sizeof *corners);
  if (count == 0)
    return;
  size_t kept = meshopt_simplify(&result[0][0], &corners[0][0], 3 * (size_t)count, &positions[0][0], points, 12,
                                 3 * (size_t)(share * count), FLT_MAX, 0, NULL) /
                3;
  for (size_t i = 0; i < kept; i++, out->triangle_count++) {
    for (int k = 0; k < 3; k++) {
      out->triangles[out->triangle_count][k] = mesh->wedge_count != 0 ? mesh->wedge_vertex[result[i][k]] : result[i][k];
      if (mesh->wedge_count != 0)
        out->corners[out->triangle_count][k] = result[i][k];
    }
    if (mesh->parts != NULL)
      out->parts[out->triangle_count] = part;
    if (mesh->materials != NULL)
      out->materials[out->triangle_count] = material;
  }
}

static void simplify_meshopt(const struct textured *t, double share, struct lod_mesh *out) {
  for (uint32_t u = 0; u < t->model.unit_count; u++) {
    const struct lod_mesh *mesh = &t->model.units[u].mesh;
    uint32_t points = mesh->wedge_count != 0 ? mesh->wedge_count : mesh->vertex_count;
    float(*positions)[3] = lod_arena_alloc(t->arena, points, sizeof *positions);
    out[u] = *mesh;
    out[u].triangle_count = 0;
    out[u].triangles = lod_arena_alloc(t->arena, mesh->triangle_count, sizeof *out[u].triangles);
    out[u].corners = mesh->wedge_count == 0 ? NULL : lod_arena_alloc(t->arena, mesh->triangle_count, sizeof *out[u].corners);
    out[u].materials = mesh->materials == NULL ? NULL : LOD_NEW(t->arena, mesh->triangle_count, uint32_t);
    out[u].parts = mesh->parts == NULL ? NULL : LOD_NEW(t->arena, mesh->triangle_count, uint32_t);
    if (positions == NULL || out[u].triangles == NULL)
      abort();
    for (uint32_t w = 0; w < points; w++)
      memcpy(positions[w], mesh->positions[mesh->wedge_count != 0 ? mesh->wedge_vertex[w] : w], sizeof *positions);
    for (uint32_t part = 0; part < (mesh->parts == NULL ? 1 : t->model.part_count); part++)
      for (uint32_t m = 0; m <= (mesh->materials == NULL ? 0 : t->model.material_count); m++) /* the last: none */
        simplify_group(t, mesh, part, m == t->model.material_count ? LOD_NONE : m, (const float(*)[3])positions, points, share, &out[u]);
  }
}

static double worst_error(const struct textured *t, const struct lod_mesh *meshes) {
  double worst = 0;
  for (uint32_t u = 0; u < t->model.unit_count; u++) {
    struct lod_distance_settings measure = lod_distance_defaults();
    struct lod_distance distance;
    measure.threads = 1;
    measure.larger_side_only = true;
    must(lod_distance_measure(&t->model.units[u].mesh, &meshes[u], &measure, t->arena, &distance));
    worst = fmax(worst, distance.two_sided.upper * t->model.units[u].scale);
  }
  return worst;
}

static void bench_peer(const struct textured *t) {
  double low = 0, high = 1, seconds = 0;
  struct lod_mesh *meshes = LOD_NEW(t->arena, t->model.unit_count, struct lod_mesh);
  if (meshes == NULL)
    abort();
  while (high - low > 0.01 * high) {
    double share = (low + high) / 2, started = cpu_seconds();
    simplify_meshopt(t, share, meshes);
    seconds = cpu_seconds() - started;
    if (all_triangles(t, meshes) != 0 && worst_error(t, meshes) <= (1 - BENCH_RESERVE) * t->epsilon)
      high = share;
    else
      low = share;
    if (low > 0.995 || high < 1e-4)
      break;
  }
  simplify_meshopt(t, high, meshes);
  struct lod_interval error;
  size_t bytes = level_bytes(t, meshes, &error);
  print_row(t, "meshopt", all_triangles(t, meshes), bytes, error, -1, 0, seconds);
}

bool bench_textured(const char *path, const double *percents, const char *const *aims, int count) {
  struct cli_file file;
  struct textured t = {.arena = lod_arena_create(0)};
  struct lod_problem problem = {0};
  if (access(path, R_OK) != 0 || cli_file_open(path, &file, &problem) != LOD_OK) {
    lod_arena_destroy(t.arena);
    return false;
  }
  struct lod_import_request request = {.name = path, .bytes = file.bytes, .size = file.size, .threads = 1};
  struct lod_import_files files;
  char folder[1024];
  snprintf(folder, sizeof folder, "%s", path);
  char *slash = strrchr(folder, '/');
  if (slash != NULL)
    *slash = 0;
  int fd = open(slash == NULL ? "." : folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  files = lod_import_files_beneath(&fd);
  request.files = &files;
  if (lod_import_model(&request, t.arena, &t.model, &problem) != LOD_OK) {
    fprintf(stderr, "%s\n", problem.detail);
    return false;
  }
  struct lod_bounds bounds = lod_model_bounds(&t.model);
  t.diagonal = lod_bounds_diagonal(&bounds);
  const char *name = strrchr(path, '/');
  printf("\n%s: %llu triangles, seams and normals kept; bytes of the GLB without textures\n", name == NULL ? path : name + 1,
         (unsigned long long)t.model.source_triangles);
  for (int i = 0; i < 3 * count; i++) {
    static const char *const kNames[3] = {"4 texels, 10 deg", "the default", "no bounds"};
    struct lod_envelope_settings settings = lod_envelope_defaults();
    t.epsilon = percents[i / 3] / 100 * t.diagonal;
    t.aim = aims == NULL || i % 3 != 0 ? "" : aims[i / 3];
    t.who = kNames[i % 3];
    if (i % 3 != 1)
      settings.collapse.attributes = (struct lod_attribute_bounds){0, 0, 0, 0};
    if (i % 3 == 0)
      settings.collapse.attributes = (struct lod_attribute_bounds){.uv = 4 / texture_width(&t.model), .normal_degrees = 10};
    t.started = cpu_seconds();
    settings.epsilons = &t.epsilon;
    settings.epsilon_count = 1;
    settings.reserve = BENCH_RESERVE;
    settings.least_gain = 0;
    settings.threads = 1;
    settings.reports = &t.report;
    must(lod_envelope_family.build(t.model.units, t.model.unit_count, &settings, NULL, t.arena, take_level, &t, &problem));
    t.aim = "";
    if (i % 3 == 2)
      bench_peer(&t);
  }
  close(fd);
  cli_file_close(&file);
  lod_arena_destroy(t.arena);
  return true;
}
