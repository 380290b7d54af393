/* Prepared units and single levels. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

struct lod_cluster_settings lod_cluster_defaults(void) {
  return (struct lod_cluster_settings){.grading = LOD_CLUSTER_COSINE,
                                       .combination = LOD_CLUSTER_PRODUCT,
                                       .angle_share = 0.5,
                                       .shape = LOD_CLUSTER_SPHERE,
                                       .assignment = LOD_CLUSTER_NEAREST,
                                       .representative = LOD_CLUSTER_QUADRIC,
                                       .nested = true,
                                       .ratio = 0.5,
                                       .min_triangles = 100,
                                       .separate = 2};
}

static enum lod_status check_settings(const struct lod_cluster_settings *s, struct lod_problem *problem) {
  if ((unsigned)s->grading > LOD_CLUSTER_INVERSE_ANGLE || (unsigned)s->combination > LOD_CLUSTER_SUM ||
      (unsigned)s->shape > LOD_CLUSTER_SPHERE || (unsigned)s->assignment > LOD_CLUSTER_UNIFORM ||
      (unsigned)s->representative > LOD_CLUSTER_QUADRIC)
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings",
                    "cluster: unknown grading, combination, shape, assignment or representative");
  if (!(s->angle_share >= 0 && s->angle_share <= 1))
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: angle_share is %g, expected a number in [0, 1]", s->angle_share);
  if (!(s->ratio >= 0.05 && s->ratio <= 0.9))
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: ratio is %g, expected a number in [0.05, 0.9]", s->ratio);
  if (s->min_triangles < 4)
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: min_triangles is %u, expected at least 4", s->min_triangles);
  if (!(s->separate >= 0))
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: separate is %g, expected a number of cells that is not negative",
                    s->separate);
  if (s->cells != NULL && s->cell_count > CLUSTER_MAX_LEVELS)
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: %u cell widths, expected at most %d", s->cell_count,
                    (int)CLUSTER_MAX_LEVELS);
  for (uint32_t i = 0; s->cells != NULL && i < s->cell_count; i++)
    if (!(s->cells[i] > 0 && isfinite(s->cells[i])) || (i > 0 && s->cells[i] <= s->cells[i - 1]))
      return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings",
                      "cluster: cell width number %u is %g, expected finite widths above 0, each larger than the one before", i,
                      s->cells[i]);
  return LOD_OK;
}

enum lod_status lod_cluster_create(const struct lod_unit *units, uint32_t unit_count, const struct lod_cluster_settings *settings,
                                   const struct lod_progress *progress, struct lod_arena *arena, struct lod_cluster **cluster,
                                   struct lod_problem *problem) {
  struct lod_cluster *c = LOD_NEW_ZERO(arena, 1, struct lod_cluster);
  if (c == NULL)
    return lod_fail_memory(problem);
  c->settings = settings != NULL ? *settings : lod_cluster_defaults();
  if (c->settings.assignment == LOD_CLUSTER_UNIFORM)
    c->settings.nested = false;
  LOD_TRY(check_settings(&c->settings, problem));
  c->unit_count = unit_count;
  c->units = LOD_NEW_ZERO(arena, unit_count, struct cluster_unit);
  if (c->units == NULL)
    return lod_fail_memory(problem);
  for (uint32_t u = 0; u < unit_count; u++) {
    const struct lod_mesh *mesh = &units[u].mesh;
    if ((uint64_t)mesh->triangle_count + mesh->edge_count + mesh->point_count > CLUSTER_MAX_COUNT || mesh->vertex_count > CLUSTER_MAX_COUNT)
      return lod_fail(problem, LOD_LIMIT, "limit-triangles", "cluster: unit %u has %u triangles and %u vertices, expected at most %u", u,
                      mesh->triangle_count, mesh->vertex_count, CLUSTER_MAX_COUNT);
    if (lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    enum lod_status status = cluster_prepare(&c->units[u], &units[u], &c->settings, arena);
    if (status != LOD_OK)
      return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
    c->triangle_count += mesh->triangle_count;
    c->vertex_count += c->units[u].count;
  }
  *cluster = c;
  return LOD_OK;
}

static void scatter_images(const struct cluster_unit *unit, const struct cluster_cells *cells, uint32_t *images) {
  if (unit->count != unit->mesh->vertex_count)
    memset(images, 0xff, unit->mesh->vertex_count * sizeof *images);
  for (uint32_t v = 0; v < unit->count; v++)
    images[unit->source[v]] = cells->image[v];
}

/* Two tasks that share nothing but what they read: what becomes of the triangles, and where the vertices stand. */
struct tasks {
  const struct cluster_unit *unit;
  const struct lod_cluster_settings *settings;
  const struct cluster_cells *cells;
  struct lod_arena *arena;   /* of the first */
  struct lod_arena *scratch; /* of the second */
  struct cluster_synthesis synthesis;
  float (*positions)[3];
  uint32_t *images;
  double bound;
  enum lod_status status[2];
};

static void run_task(void *context, size_t begin, size_t end, size_t chunk) {
  struct tasks *tasks = context;
  (void)end;
  (void)chunk;
  if (begin == 0) {
    tasks->status[0] = cluster_synthesize(tasks->unit, tasks->cells, tasks->arena, &tasks->synthesis);
  } else {
    tasks->status[1] = cluster_represent(tasks->unit, tasks->settings, tasks->cells, tasks->scratch, tasks->positions, &tasks->bound);
    scatter_images(tasks->unit, tasks->cells, tasks->images);
  }
}

enum lod_status cluster_make_mesh(const struct cluster_unit *unit, const struct lod_cluster_settings *settings,
                                  const struct cluster_cells *cells, struct lod_arena *arena, struct lod_mesh *mesh, uint32_t **images,
                                  uint32_t **nearby, double *bound) {
  struct tasks tasks = {.unit = unit, .settings = settings, .cells = cells, .arena = arena, .scratch = lod_arena_create_child(arena)};
  tasks.positions = lod_arena_alloc(arena, cells->count, sizeof *tasks.positions);
  tasks.images = LOD_NEW(arena, unit->mesh->vertex_count, uint32_t);
  if (tasks.scratch == NULL || tasks.positions == NULL || tasks.images == NULL) {
    lod_arena_destroy(tasks.scratch);
    return LOD_MEMORY;
  }
  lod_parallel_for(settings->threads, 2, 1, run_task, &tasks);
  lod_arena_destroy(tasks.scratch);
  LOD_TRY(tasks.status[0]);
  LOD_TRY(tasks.status[1]);
  const struct cluster_synthesis *synthesis = &tasks.synthesis;
  *mesh = (struct lod_mesh){.vertex_count = cells->count,
                            .triangle_count = synthesis->triangle_count,
                            .edge_count = synthesis->edge_count,
                            .point_count = synthesis->point_count,
                            .positions = tasks.positions,
                            .triangles = synthesis->triangles,
                            .edges = synthesis->edges,
                            .points = synthesis->points};
  LOD_TRY(cluster_thicken(unit, cells, synthesis, arena, &mesh->edge_thickness, &mesh->point_thickness));
  LOD_TRY(cluster_attribute(unit, cells, synthesis, arena, mesh));
  *images = tasks.images;
  *nearby = synthesis->nearby;
  *bound = tasks.bound;
  return LOD_OK;
}

static enum lod_status make_unit_level(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell,
                                       struct lod_arena *arena, struct lod_mesh *mesh, uint32_t **images, uint32_t **nearby,
                                       double *bound) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint8_t *birth = scratch != NULL ? LOD_NEW(scratch, unit->count, uint8_t) : NULL;
  enum lod_status status = birth != NULL ? LOD_OK : LOD_MEMORY;
  uint32_t *keys = NULL, count;
  struct cluster_cells cells;
  if (status == LOD_OK) {
    memset(birth, CLUSTER_UNBORN, unit->count);
    status = cluster_keys(unit, cell, settings->separate, scratch, &keys);
  }
  if (status == LOD_OK)
    status = cluster_open(unit, settings, cell, keys, birth, 0, scratch, &count);
  if (status == LOD_OK)
    status = cluster_assign(unit, settings, cell, keys, birth, 0, scratch, &cells);
  if (status == LOD_OK)
    status = cluster_make_mesh(unit, settings, &cells, arena, mesh, images, nearby, bound);
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status lod_cluster_level(const struct lod_cluster *cluster, double cell, struct lod_arena *arena, struct lod_level *level,
                                  struct lod_problem *problem) {
  if (!(cell > 0 && isfinite(cell)))
    return lod_fail(problem, LOD_BAD_INPUT, "cluster-settings", "cluster: cell width is %g, expected a finite number above 0", cell);
  *level = (struct lod_level){.cell = cell};
  level->meshes = LOD_NEW_ZERO(arena, cluster->unit_count, struct lod_mesh);
  uint32_t **images = LOD_NEW(arena, cluster->unit_count, uint32_t *), **nearby = LOD_NEW(arena, cluster->unit_count, uint32_t *);
  if (level->meshes == NULL || images == NULL || nearby == NULL)
    return lod_fail_memory(problem);
  level->images = images;
  level->nearby = nearby;
  for (uint32_t u = 0; u < cluster->unit_count; u++) {
    const struct cluster_unit *unit = &cluster->units[u];
    double bound;
    enum lod_status status = make_unit_level(unit, &cluster->settings, cluster_working_cell(unit, cell), arena, &level->meshes[u],
                                             &images[u], &nearby[u], &bound);
    if (status != LOD_OK)
      return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
    level->bound = fmax(level->bound, bound * unit->scale);
  }
  return LOD_OK;
}

enum lod_status lod_cluster_weights(const struct lod_cluster *cluster, uint32_t unit, struct lod_arena *arena, float **weights) {
  const struct cluster_unit *u = &cluster->units[unit];
  *weights = LOD_NEW_ZERO(arena, u->mesh->vertex_count, float);
  if (*weights == NULL)
    return LOD_MEMORY;
  /* Lengths, and with them products, were taken in working units. */
  double scale = cluster->settings.combination == LOD_CLUSTER_PRODUCT ? 1 / u->shrink : 1;
  for (uint32_t v = 0; v < u->count; v++)
    (*weights)[u->source[v]] = (float)((double)u->weight[v] * scale);
  return LOD_OK;
}
