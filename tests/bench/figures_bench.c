/* Turk's figures 1, 4, 11 and 12 in kind, on surfaces of tests/data/figures.h: a row for each level, and with -p FOLDER a picture of it.
 * Beside each row of ours the paper's own way (lod_retile_turk), and for figure 11 uniform spacing beside spacing by curvature. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/picture.h"
#include "codec/export/png.h"
#include "core/mesh/distance.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/figures.h"
#include "tests/data/surface.h"

static const char *picture_folder;

static void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "figures_bench: %s\n", lod_status_name(status));
    exit(1);
  }
}

static void draw(const char *name, const struct lod_mesh *mesh, const struct lod_sphere *frame) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_picture_settings settings = lod_picture_defaults();
  struct lod_picture picture;
  char path[4096];
  settings.width = settings.height = 480;
  settings.up_axis = 2;
  settings.flat = settings.wireframe = true;
  settings.frame = frame;
  must(lod_picture_render(mesh, 1, &settings, arena, &picture, NULL));
  snprintf(path, sizeof path, "%s/%s.png", picture_folder, name);
  FILE *file = fopen(path, "wb");
  if (file == NULL || lod_png_write(&picture, file, NULL) != LOD_OK)
    fprintf(stderr, "figures_bench: cannot write %s\n", path);
  if (file != NULL)
    fclose(file);
  lod_arena_destroy(arena);
}

/* Mean of 2r/R. */
static double shape_of(const struct lod_mesh *mesh) {
  double sum = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    double s[3], product;
    for (int k = 0; k < 3; k++)
      s[k] = lod_vec3_distance(lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]),
                               lod_vec3_from_float(mesh->positions[mesh->triangles[t][(k + 1) % 3]]));
    product = s[0] * s[1] * s[2];
    sum += product > 0 ? fmax(0, (s[1] + s[2] - s[0]) * (s[2] + s[0] - s[1]) * (s[0] + s[1] - s[2]) / product) : 0;
  }
  return mesh->triangle_count != 0 ? sum / mesh->triangle_count : 0;
}

/* "whole", or how many coarse triangles the map onto the next finer level fails for. */
static void tell_map(const struct lod_retile_level *level, struct lod_arena *arena) {
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  must(lod_overlay_create(&level->mesh, &level[1].mesh, level->parents, NULL, arena, &overlay, NULL));
  must(lod_overlay_check(&overlay, &level->mesh, &level[1].mesh, level->parents, arena, &facts));
  if (overlay.failed == 0 && facts.valid)
    printf(" | whole, %u fragments\n", overlay.triangle_count);
  else
    printf(" | %u unmapped %s\n", overlay.failed, facts.reason);
}

static void show(const char *figure, const char *way, const struct lod_mesh *source, const struct lod_retile_settings *settings) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_bounds bounds = lod_mesh_bounds(source);
  double diagonal = lod_bounds_diagonal(&bounds);
  struct lod_sphere frame = {.radius = 0.33 * diagonal};
  for (int k = 0; k < 3; k++)
    frame.center[k] = (bounds.min[k] + bounds.max[k]) / 2;
  struct lod_topology topology = lod_surface_topology(source, arena);
  struct lod_retile retile;
  char name[256];
  must(lod_retile_create(source, settings, NULL, arena, &retile, NULL));
  if (picture_folder != NULL && strcmp(way, "ours") == 0) {
    snprintf(name, sizeof name, "%s-source", figure);
    draw(name, source, &frame);
  }
  for (uint32_t k = 0; k < retile.level_count; k++) {
    const struct lod_retile_level *level = &retile.levels[k];
    struct lod_distance_settings exact = lod_distance_defaults();
    struct lod_distance distance;
    struct lod_topology own = lod_surface_topology(&level->mesh, arena);
    exact.rms = true;
    must(lod_distance_measure(&level->mesh, source, &exact, arena, &distance));
    printf("%-10s %-8s %6u %6u %5u | %7.3f %7.4f | %5.3f | %s", figure, way, source->vertex_count, level->mesh.vertex_count,
           level->retained, 100 * distance.two_sided.upper / diagonal, 100 * distance.rms / diagonal, shape_of(&level->mesh),
           lod_surface_same(&own, &topology) ? "kept" : "LOST");
    if (k + 1 < retile.level_count)
      tell_map(level, arena);
    else
      printf("\n");
    snprintf(name, sizeof name, "%s-%s-%u", figure, way, level->mesh.vertex_count);
    if (picture_folder != NULL)
      draw(name, &level->mesh, &frame);
  }
  lod_arena_destroy(arena);
}

static void figure(const char *name, const struct lod_mesh *source, const uint32_t *counts, uint32_t count) {
  struct lod_retile_settings settings = lod_retile_defaults(), turk = lod_retile_turk();
  settings.vertices = turk.vertices = counts;
  settings.level_count = turk.level_count = count;
  show(name, "ours", source, &settings);
  show(name, "turk", source, &turk);
}

int main(int argc, char **argv) {
  struct lod_arena *arena = lod_arena_create(0);
  for (int i = 1; i + 1 < argc; i += 2)
    if (strcmp(argv[i], "-p") == 0)
      picture_folder = argv[i + 1];
  const struct lod_mesh dose = lod_figure_dose(arena, 28), molecule = lod_figure_molecule(arena, 21),
                        costa = lod_figure_costa(arena, 50, 0.14), fine = lod_figure_dose(arena, 50);
  printf("%-10s %-8s %6s %6s %5s | %7s %7s | %5s | topo | map\n", "figure", "way", "source", "vert", "kept", "error %", "rms %", "2r/R");
  figure("fig1-dose", &dose, (const uint32_t[]){400}, 1);
  figure("fig4-mol", &molecule, (const uint32_t[]){201, 801, 3676}, 3);
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = (const uint32_t[]){800};
  settings.level_count = 1;
  settings.lead = 0; /* spacing alone */
  show("fig11-dose", "curved", &fine, &settings);
  settings.curvature = LOD_RETILE_CURVATURE_NONE;
  show("fig11-dose", "uniform", &fine, &settings);
  figure("fig12-min", &costa, (const uint32_t[]){200, 800, 3200}, 3);
  lod_arena_destroy(arena);
  return 0;
}
