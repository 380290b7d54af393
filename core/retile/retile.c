#include "core/retile/retile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/curvature.h"
#include "core/retile/internal.h"

struct lod_retile_settings lod_retile_defaults(void) {
  return (struct lod_retile_settings){.ratio = 4,
                                      .least = 200,
                                      .finest_error = 2e-4,
                                      .placement = LOD_RETILE_ELIMINATION,
                                      .steps = 25,
                                      .damping = 0.25,
                                      .radius = 1.2,
                                      .seed = 1,
                                      .curvature = LOD_RETILE_CURVATURE_TENSOR,
                                      .adapt = 2,
                                      .crease_degrees = LOD_TOLERANCE_CREASE_DEGREES,
                                      .corner_degrees = 45,
                                      .lead = 0.03,
                                      .settle = 4,
                                      .flips = 4};
}

enum lod_status retile_check_settings(const struct lod_retile_settings *s, struct lod_problem *problem) {
  if (s->vertices != NULL && (s->level_count == 0 || s->level_count > LOD_RETILE_MAX_LEVELS))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-vertices", "Between 1 and %d vertex counts can be asked for, not %u.",
                    LOD_RETILE_MAX_LEVELS, s->level_count);
  if (s->vertices == NULL && !(s->ratio >= 1.1 && s->ratio <= 1000 && s->finest_error > 0))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-ladder",
                    "The ratio of levels must be in [1.1, 1000] and the finest error positive, not %g and %g.", s->ratio, s->finest_error);
  if (!(s->damping >= 0 && s->damping <= 1 && s->radius >= 0 && s->radius <= 10 && s->adapt >= 1 && s->adapt <= 100 && s->steps <= 10000))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-repulsion",
                    "Repulsion takes a damping in [0, 1], a radius in [0, 10], at most 10000 steps, and spacing adapts by 1 to 100.");
  if (!(s->lead >= 0 && s->lead <= 0.9 && s->settle <= 1000))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-lead", "The share of vertices led by the error must be in [0, 0.9], not %g.", s->lead);
  return LOD_OK;
}

static int compare_counts(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

enum lod_status retile_vertices_for(const struct lod_mesh *mesh, double error, struct lod_arena *arena, double *vertices) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_curvature curvature;
  struct lod_adjacency adjacency;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : lod_adjacency_create(mesh, scratch, &adjacency);
  if (status == LOD_OK)
    status = lod_curvature_estimate(mesh, &adjacency, LOD_CURVATURE_TENSOR, LOD_TOLERANCE_CREASE_DEGREES, scratch, &curvature);
  *vertices = 0;
  for (uint32_t t = 0; status == LOD_OK && t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    double k = 0;
    for (int i = 0; i < 3; i++) {
      p[i] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][i]]);
      k += curvature.largest[mesh->triangles[t][i]] / 3;
    }
    double area = 0.5 * lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
    *vertices += area * k / (8 * error) * 1.1547005383792517;
  }
  lod_arena_destroy(scratch);
  return status;
}

/* Vertex counts, coarsest first. */
static enum lod_status choose_counts(const struct lod_mesh *mesh, const struct lod_retile_settings *s, struct lod_arena *arena,
                                     uint32_t counts[LOD_RETILE_MAX_LEVELS], uint32_t *level_count) {
  if (s->vertices != NULL) {
    memcpy(counts, s->vertices, s->level_count * sizeof *counts);
    qsort(counts, s->level_count, sizeof *counts, compare_counts);
    *level_count = s->level_count;
    return LOD_OK;
  }
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double error = s->finest_error * lod_bounds_diagonal(&bounds), finest = 0;
  if (error > 0)
    LOD_TRY(retile_vertices_for(mesh, error, arena, &finest));
  finest = fmin(fmax(finest, s->least), mesh->vertex_count);
  double steps = fmax(0, floor(log(finest / fmax(4, s->least)) / log(s->ratio) + 0.5));
  *level_count = (uint32_t)fmin(steps, LOD_RETILE_MAX_LEVELS - 1) + 1;
  for (uint32_t k = 0; k < *level_count; k++)
    counts[k] = (uint32_t)fmax(4, lrint(finest / pow(s->ratio, *level_count - 1 - k)));
  return LOD_OK;
}

static bool too_fine(const struct tiling *tiling, uint32_t v, uint32_t level) {
  return tiling->birth[v] > level;
}

/* Where the finer level's vertices lie on the level just built. */
static enum lod_status record_step(const struct tiling *tiling, struct lod_retile_level *level, const struct lod_retile_level *finer,
                                   const uint32_t *finer_to, const uint32_t *vertex_to, const uint32_t *face_to, struct lod_arena *arena) {
  RETILE_TRY_NEW(level->parents, arena, level->mesh.vertex_count);
  RETILE_TRY_NEW(level->flat, arena, finer->mesh.vertex_count);
  for (uint32_t v = 0; v < tiling->vertex_count; v++) {
    if (finer_to[v] == LOD_NONE)
      continue;
    struct lod_retile_point *at = &level->flat[finer_to[v]];
    if (vertex_to[v] != LOD_NONE) {
      level->parents[vertex_to[v]] = finer_to[v];
      *at = (struct lod_retile_point){.face = face_to[tiling->corner[v] / 3]};
      at->weights[tiling->corner[v] % 3] = LOD_RETILE_ONE;
    } else {
      *at = tiling->flat[v];
      at->face = face_to[at->face];
    }
  }
  return LOD_OK;
}

static enum lod_status build_levels(struct tiling *tiling, const struct lod_retile_settings *settings, const uint32_t *counts,
                                    const struct lod_progress *progress, struct lod_arena *arena, struct lod_arena *scratch,
                                    struct lod_retile *retile) {
  uint32_t *maps[2], *face_to;
  for (int i = 0; i < 2; i++)
    RETILE_TRY_NEW(maps[i], scratch, tiling->vertex_count);
  RETILE_TRY_NEW(face_to, scratch, tiling->face_count);
  for (uint32_t k = retile->level_count; k-- > 0;) {
    struct lod_retile_level *level = &retile->levels[k];
    uint32_t left;
    lod_progress_report(progress, "retile", 1 - 0.6 * (k + 1) / retile->level_count);
    if (lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    tiling_descend(tiling, k);
    LOD_TRY(remove_vertices(tiling, too_fine, k, scratch, &left));
    improve_flips(tiling, settings->flips);
    if (left != 0) { /* flips may have made room */
      LOD_TRY(remove_vertices(tiling, too_fine, k, scratch, &left));
      improve_flips(tiling, 1);
    }
    if (settings->lead > 0)
      LOD_TRY(lead_level(tiling, settings, k, k + 1 < retile->level_count ? maps[(k + 1) % 2] : NULL, counts[k], scratch));
    LOD_TRY(extract_level(tiling, k, arena, level, maps[k % 2], face_to));
    if (k + 1 < retile->level_count)
      LOD_TRY(record_step(tiling, level, &retile->levels[k + 1], maps[(k + 1) % 2], maps[k % 2], face_to, arena));
  }
  return LOD_OK;
}

static enum lod_status create(const struct lod_mesh *mesh, const struct lod_retile_settings *settings, const struct lod_progress *progress,
                              struct lod_arena *arena, struct lod_arena *scratch, struct lod_retile *retile) {
  uint32_t counts[LOD_RETILE_MAX_LEVELS];
  LOD_TRY(choose_counts(mesh, settings, scratch, counts, &retile->level_count));
  RETILE_TRY_NEW_ZERO(retile->levels, arena, retile->level_count);
  struct sheet sheet;
  struct sites sites;
  struct tiling tiling;
  LOD_TRY(sheet_create(mesh, settings, counts, retile->level_count, scratch, &sheet));
  LOD_TRY(place_sites(&sheet, settings, counts, retile->level_count, progress, scratch, &sites));
  lod_progress_report(progress, "tessellate", 0.35);
  LOD_TRY(tiling_create(&sheet, &sites, scratch, &tiling));
  tiling.enough = INFINITY;
  struct lod_bvh *bvh = NULL;
  if (settings->lead > 0)
    LOD_TRY(lod_bvh_create(mesh, settings->threads, scratch, &bvh));
  tiling.source = bvh;
  return build_levels(&tiling, settings, counts, progress, arena, scratch, retile);
}

enum lod_status lod_retile_create(const struct lod_mesh *mesh, const struct lod_retile_settings *settings,
                                  const struct lod_progress *progress, struct lod_arena *arena, struct lod_retile *retile,
                                  struct lod_problem *problem) {
  struct lod_retile_settings defaults = lod_retile_defaults();
  *retile = (struct lod_retile){0};
  if (settings == NULL)
    settings = &defaults;
  LOD_TRY(retile_check_settings(settings, problem));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : create(mesh, settings, progress, arena, scratch, retile);
  lod_arena_destroy(scratch);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  else if (status == LOD_CANCELLED)
    lod_fail(problem, status, "cancelled", "The bake was cancelled.");
  else if (status == LOD_LIMIT)
    lod_fail(problem, status, "limit-vertices", "The source and the vertices asked for make more than 2^32 half-edges.");
  return status;
}

static enum lod_status tessellate(const struct lod_mesh *mesh, const struct lod_retile_point *points, uint32_t point_count,
                                  struct lod_arena *arena, struct lod_arena *scratch, struct lod_mesh *out) {
  struct lod_retile_settings settings = lod_retile_defaults();
  struct sheet sheet;
  struct sites sites = {.count = point_count};
  struct tiling tiling;
  settings.curvature = LOD_RETILE_CURVATURE_NONE;
  LOD_TRY(sheet_create(mesh, &settings, &(uint32_t){point_count}, 1, scratch, &sheet));
  RETILE_TRY_NEW(sites.items, scratch, point_count);
  for (uint32_t i = 0; i < point_count; i++) {
    struct lod_retile_point p = points[i];
    sites.items[i] = (struct site){p, LOD_NONE, 0};
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t h = 3 * p.face + (k + 1) % 3;
      if (p.weights[k] == LOD_RETILE_ONE)
        sites.items[i].vertex = sheet.faces[p.face][k];
      else if (p.weights[k] == 0 && sheet.twin[h] < h) { /* an edge is named by its lower half-edge */
        uint32_t twin = sheet.twin[h];
        struct lod_retile_point *q = &sites.items[i].point;
        *q = (struct lod_retile_point){.face = twin / 3};
        q->weights[twin % 3] = p.weights[(k + 2) % 3];
        q->weights[(twin + 1) % 3] = p.weights[(k + 1) % 3];
      }
    }
  }
  LOD_TRY(tiling_create(&sheet, &sites, scratch, &tiling));
  *out = (struct lod_mesh){.vertex_count = tiling.vertex_count};
  RETILE_TRY_NEW(out->positions, arena, tiling.vertex_count);
  RETILE_TRY_NEW(out->triangles, arena, tiling.face_count);
  for (uint32_t v = 0; v < tiling.vertex_count; v++)
    lod_vec3_to_float(tiling.positions[v], out->positions[v]);
  for (uint32_t f = 0; f < tiling.face_count; f++)
    if (tiling.faces[f][0] != LOD_NONE)
      memcpy(out->triangles[out->triangle_count++], tiling.faces[f], sizeof *out->triangles);
  return LOD_OK;
}

enum lod_status lod_retile_tessellate(const struct lod_mesh *mesh, const struct lod_retile_point *points, uint32_t point_count,
                                      struct lod_arena *arena, struct lod_mesh *tessellation) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : tessellate(mesh, points, point_count, arena, scratch, tessellation);
  lod_arena_destroy(scratch);
  return status;
}
