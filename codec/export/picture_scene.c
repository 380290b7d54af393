#include "codec/export/picture_scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/bvh.h"
#include "core/mesh/curvature.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"

static const char *const kNames[] = {"shaded", "wireframe", "curvature", "error", "points", "tessellation", "fragments"};

/* Linear RGBA: ink for points and lines, then colours that neighbours can be told apart by. */
static const float kColors[][4] = {{0.01f, 0.01f, 0.012f, 1}, {0.62f, 0.13f, 0.10f, 1}, {0.08f, 0.30f, 0.55f, 1}, {0.75f, 0.55f, 0.12f, 1},
                                   {0.12f, 0.42f, 0.18f, 1},  {0.42f, 0.18f, 0.48f, 1}, {0.70f, 0.68f, 0.62f, 1}, {0.10f, 0.45f, 0.45f, 1}};
enum { INK = 0, FIRST_COLOR = 1, COLORS = 7 };

const char *lod_picture_kind_name(uint32_t kind) {
  return kind < LOD_PICTURE_KINDS ? kNames[kind] : NULL;
}

static int compare(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static enum lod_status curvature_heat(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_picture_settings *settings) {
  struct lod_adjacency adjacency;
  struct lod_curvature curvature;
  LOD_TRY(lod_adjacency_create(mesh, arena, &adjacency));
  LOD_TRY(lod_curvature_estimate(mesh, &adjacency, LOD_CURVATURE_TENSOR, LOD_TOLERANCE_CREASE_DEGREES, arena, &curvature));
  double *sorted = LOD_NEW(arena, mesh->vertex_count, double);
  if (sorted == NULL)
    return LOD_MEMORY;
  memcpy(sorted, curvature.largest, mesh->vertex_count * sizeof *sorted);
  qsort(sorted, mesh->vertex_count, sizeof *sorted, compare);
  settings->heat = curvature.largest;
  settings->heat_max = mesh->vertex_count == 0 ? 0 : sorted[(size_t)((mesh->vertex_count - 1) * 0.95)];
  return LOD_OK;
}

static enum lod_status error_heat(const struct lod_mesh *mesh, const struct lod_mesh *source, struct lod_arena *arena,
                                  struct lod_picture_settings *settings) {
  struct lod_bvh *bvh;
  double *heat = LOD_NEW(arena, mesh->vertex_count, double);
  if (heat == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_bvh_create(source, 1, arena, &bvh));
  uint32_t hint = LOD_NONE;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    struct lod_closest closest = lod_bvh_closest(bvh, lod_vec3_from_float(mesh->positions[v]), hint, INFINITY);
    hint = closest.primitive;
    heat[v] = closest.primitive == LOD_NONE ? 0 : sqrt(closest.distance_squared);
    settings->heat_max = fmax(settings->heat_max, heat[v]);
  }
  settings->heat = heat;
  return LOD_OK;
}

/* The mesh's vertices as balls of ink. */
static enum lod_status balls(const struct lod_mesh *mesh, const uint32_t *which, uint32_t count, double diameter, struct lod_arena *arena,
                             struct lod_mesh *out) {
  *out = (struct lod_mesh){.vertex_count = mesh->vertex_count, .positions = mesh->positions, .point_count = count};
  out->points = LOD_NEW(arena, count, uint32_t);
  out->point_thickness = LOD_NEW(arena, count, float);
  out->point_materials = LOD_NEW(arena, count, uint32_t);
  if (out->points == NULL || out->point_thickness == NULL || out->point_materials == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++) {
    out->points[i] = which == NULL ? i : which[i];
    out->point_thickness[i] = (float)diameter;
    out->point_materials[i] = INK;
  }
  return LOD_OK;
}

/* The candidates of re-tiling at that many vertices, and the mesh's triangles cut to have them as vertices; balls where they are. */
static enum lod_status tessellation(const struct lod_picture_scene *scene, double diameter, struct lod_arena *arena,
                                    struct lod_mesh meshes[2], struct lod_problem *problem) {
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  const struct lod_mesh bare = {.vertex_count = scene->mesh->vertex_count,
                                .triangle_count = scene->mesh->triangle_count,
                                .positions = scene->mesh->positions,
                                .triangles = scene->mesh->triangles};
  settings.vertices = &scene->vertices;
  settings.level_count = 1;
  LOD_TRY(lod_retile_create(&bare, &settings, NULL, arena, &retile, problem));
  const struct lod_retile_level *level = &retile.levels[0];
  LOD_TRY(lod_retile_tessellate(&bare, level->points, level->mesh.vertex_count, arena, &meshes[0]));
  return balls(&level->mesh, NULL, level->mesh.vertex_count, diameter, arena, &meshes[1]);
}

static enum lod_status fragments(const struct lod_picture_scene *scene, double diagonal, struct lod_arena *arena, struct lod_mesh *out,
                                 struct lod_problem *problem) {
  const struct lod_mesh *coarse = scene->mesh, *fine = scene->source;
  struct lod_overlay overlay;
  struct lod_morph morph;
  uint32_t *parents = LOD_NEW(arena, coarse->vertex_count, uint32_t);
  if (parents == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_overlay_match(coarse, fine, scene->reach > 0 ? scene->reach : 1e-3 * diagonal, arena, parents));
  LOD_TRY(lod_overlay_create(coarse, fine, parents, NULL, arena, &overlay, problem));
  if (overlay.mapped == 0)
    return lod_fail(problem, LOD_BAD_INPUT, "not-nested",
                    "No triangle of the coarser level is mapped: the levels do not contain one another.");
  LOD_TRY(lod_overlay_fragments(&overlay, coarse, fine, NULL, arena, &morph));
  *out = (struct lod_mesh){.vertex_count = morph.vertex_count, .triangle_count = morph.triangle_count, .triangles = morph.triangles};
  out->positions = morph.start;
  out->materials = LOD_NEW(arena, morph.triangle_count, uint32_t);
  if (out->materials == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < morph.vertex_count; v++)
    for (int k = 0; k < 3; k++)
      morph.start[v][k] += (float)scene->t * (morph.end[v][k] - morph.start[v][k]);
  for (uint32_t i = 0; i < morph.triangle_count; i++)
    out->materials[i] = morph.coarse_faces[i] == LOD_NONE ? INK : FIRST_COLOR + morph.coarse_faces[i] % COLORS;
  return LOD_OK;
}

static enum lod_status compose(const struct lod_picture_scene *scene, struct lod_picture_settings *settings, struct lod_arena *arena,
                               struct lod_mesh meshes[2], uint32_t *count, struct lod_problem *problem) {
  struct lod_bounds bounds = lod_mesh_bounds(scene->mesh);
  double diagonal = lod_bounds_diagonal(&bounds);
  *count = 1;
  meshes[0] = *scene->mesh;
  switch (scene->kind) {
  case LOD_PICTURE_WIREFRAME:
    settings->wireframe = true;
    return LOD_OK;
  case LOD_PICTURE_CURVATURE:
    return curvature_heat(scene->mesh, arena, settings);
  case LOD_PICTURE_ERROR:
    return error_heat(scene->mesh, scene->source, arena, settings);
  case LOD_PICTURE_POINTS:
    *count = 2;
    return balls(scene->mesh, NULL, scene->mesh->vertex_count, diagonal / (8 * sqrt(fmax(64, scene->mesh->vertex_count))), arena,
                 &meshes[1]);
  case LOD_PICTURE_TESSELLATION:
    *count = 2;
    settings->wireframe = settings->flat = true;
    return tessellation(scene, diagonal / (8 * sqrt(fmax(64, scene->vertices))), arena, meshes, problem);
  case LOD_PICTURE_FRAGMENTS:
    settings->wireframe = settings->flat = true;
    return fragments(scene, diagonal, arena, &meshes[0], problem);
  default:
    return LOD_OK;
  }
}

enum lod_status lod_picture_render_scene(const struct lod_picture_scene *scene, struct lod_picture_settings settings,
                                         struct lod_arena *arena, struct lod_picture *picture, struct lod_problem *problem) {
  struct lod_mesh meshes[2] = {{0}};
  uint32_t count;
  bool needs = scene->kind == LOD_PICTURE_ERROR || scene->kind == LOD_PICTURE_FRAGMENTS;
  if (needs && scene->source == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "no-source", "A picture of %s needs another surface to compare with.", kNames[scene->kind]);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : compose(scene, &settings, scratch, meshes, &count, problem);
  settings.material_colors = scene->kind == LOD_PICTURE_SHADED || scene->kind == LOD_PICTURE_WIREFRAME ? settings.material_colors : kColors;
  if (settings.material_colors == kColors)
    settings.material_color_count = sizeof kColors / sizeof *kColors;
  if (status == LOD_OK && scene->kind != LOD_PICTURE_FRAGMENTS && settings.material_colors == kColors)
    meshes[0].materials = NULL; /* clay, whatever the model's own materials are */
  if (status == LOD_OK)
    status = lod_picture_render(meshes, count, &settings, arena, picture, problem);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
