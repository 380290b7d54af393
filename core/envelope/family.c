#include "core/envelope/envelope.h"

#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/envelope/better.h"
#include "core/envelope/internal.h"

/* Shares of the diagonal, finest first. */
static const double kLadder[] = {0.0002, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08};

const double *lod_envelope_ladder(uint32_t *count) {
  *count = sizeof kLadder / sizeof kLadder[0];
  return kLadder;
}

struct lod_envelope_settings lod_envelope_defaults(void) {
  struct lod_envelope_settings settings = {
      .reserve = 0.12, .least_gain = 0.1, .crease_degrees = 30, .collapse = lod_collapse_defaults(), .better = lod_better_defaults()};
  settings.collapse.attributes = (struct lod_attribute_bounds){.slip = 1, .normal_degrees = 60, .color = 0.25};
  return settings;
}

/* One unit on its way through the ladder. */
struct run {
  const struct lod_unit *unit;
  struct lod_arena *arena; /* of the collapser: as long as the family runs */
  struct lod_collapser *collapser;
  struct lod_collapse_settings settings;
  struct lod_arena *level_arena; /* of the current level */
  uint32_t *last_vertex;         /* nested: source vertex -> vertex of the level emitted last; NULL before the first */
  double least_limit;            /* of its wishes, in its own measure; 0 = it has none */
  uint32_t last_surface;         /* vertices of that level's surface */
  struct lod_envelope_report report;
  enum lod_status status;
};

struct ladder {
  struct run *runs;
  uint32_t run_count;
  const struct lod_envelope_settings *settings;
  const struct lod_progress *progress;
  double epsilon;  /* of the current level, model units */
  double coplanar; /* the least there is, model units */
  struct lod_mesh *meshes;
  uint32_t **nearby, **replacements, **parents;
  enum lod_status (*step)(struct ladder *ladder, uint32_t u); /* what for_units does */
  struct lod_envelope_report *report;                         /* of the current level, or NULL */
  uint64_t last_triangles;                                    /* of the level emitted last, or of the source */
};

static enum lod_status take_wishes(struct run *run, const struct lod_envelope_wishes *wishes, double reserve, uint8_t *features) {
  const struct lod_mesh *mesh = &run->unit->mesh;
  if (wishes->limits != NULL) {
    double margin = LOD_TOLERANCE_CERTIFICATE * lod_mesh_magnitude(mesh);
    double *limits = LOD_NEW(run->arena, mesh->vertex_count, double);
    if (limits == NULL)
      return LOD_MEMORY;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
      limits[v] = fmax(0, wishes->limits[v] * (1 - reserve) - margin);
    run->least_limit = INFINITY;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
      run->least_limit = fmin(run->least_limit, wishes->limits[v]);
    run->settings.limits = limits;
  }
  if (wishes->edge_count == 0)
    return LOD_OK;
  bool *pinned = LOD_NEW_ZERO(run->arena, mesh->vertex_count, bool);
  if (pinned == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < wishes->edge_count; e++)
    pinned[wishes->edges[e][0]] = pinned[wishes->edges[e][1]] = true;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      uint32_t a = mesh->triangles[t][k], b = mesh->triangles[t][(k + 1) % 3];
      for (uint32_t e = 0; pinned[a] && pinned[b] && e < wishes->edge_count; e++)
        if ((wishes->edges[e][0] == a && wishes->edges[e][1] == b) || (wishes->edges[e][0] == b && wishes->edges[e][1] == a))
          features[t] |= (uint8_t)(1 << k);
    }
  run->settings.pinned = pinned;
  return LOD_OK;
}

static enum lod_status start_unit(struct ladder *ladder, struct run *run) {
  const struct lod_mesh *mesh = &run->unit->mesh;
  struct lod_bvh *bvh;
  uint8_t *features;
  LOD_TRY(lod_bvh_create(mesh, 1, run->arena, &bvh));
  double degrees = ladder->settings->collapse.attributes.normal_degrees;
  double crease = degrees > 0 ? fmin(degrees, ladder->settings->crease_degrees) : ladder->settings->crease_degrees;
  LOD_TRY(lod_envelope_features(mesh, crease, run->arena, &features));
  run->settings = ladder->settings->collapse;
  if (ladder->settings->wishes != NULL)
    LOD_TRY(take_wishes(run, &ladder->settings->wishes[run - ladder->runs], ladder->settings->reserve, features));
  return lod_collapser_create(mesh, bvh, features, &run->settings, run->arena, &run->collapser);
}

/* Nested: where the vertices of the level that is emitted were in the one before. Those that stand for themselves alone (of free edges, and
 * of degenerate triangles that stay) come last in every level. */
static enum lod_status find_parents(struct ladder *ladder, uint32_t u) {
  struct run *run = &ladder->runs[u];
  const struct lod_surface *s = &run->collapser->surface;
  uint32_t count = ladder->meshes[u].vertex_count, level_vertex = 0;
  bool first = run->last_vertex == NULL;
  uint32_t *parents = LOD_NEW(run->level_arena, count, uint32_t);
  if (parents == NULL || (first && (run->last_vertex = LOD_NEW(run->arena, s->vertex_count, uint32_t)) == NULL))
    return LOD_MEMORY;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    if (s->ring_count[v] == 0)
      continue;
    uint32_t origin = run->collapser->origin[v];
    parents[level_vertex] = first ? origin : run->last_vertex[origin];
    run->last_vertex[origin] = level_vertex++; /* origins are all different */
  }
  for (uint32_t i = level_vertex; i < count && !first; i++)
    parents[i] = run->last_surface + i - level_vertex;
  run->last_surface = level_vertex;
  ladder->parents[u] = first && count != level_vertex ? NULL : parents; /* whose places in the source are not kept */
  return LOD_OK;
}

static enum lod_status collapse_unit(struct ladder *ladder, uint32_t u) {
  struct run *run = &ladder->runs[u];
  if (run->collapser == NULL)
    LOD_TRY(start_unit(ladder, run));
  double coplanar = LOD_TOLERANCE_COPLANAR * lod_mesh_magnitude(&run->unit->mesh);
  return lod_collapser_run(run->collapser, fmax(coplanar, ladder->epsilon / run->unit->scale), ladder->progress);
}

/* The cover's word, where it needs fewer triangles; replacements are then the nearest. */
static enum lod_status take_better(struct ladder *ladder, uint32_t u) {
  struct run *run = &ladder->runs[u];
  struct lod_better_report better = {0};
  LOD_TRY(lod_envelope_better(run->collapser, ladder->epsilon / run->unit->scale, &ladder->settings->better, ladder->progress,
                              run->level_arena, &ladder->meshes[u], ladder->nearby[u], &better));
  if (better.saved_going_on == 0 && better.saved_in_parts == 0)
    return LOD_OK;
  const struct lod_mesh *source = &run->unit->mesh;
  struct lod_bvh *bvh;
  LOD_TRY(lod_bvh_create(&ladder->meshes[u], 1, run->level_arena, &bvh));
  for (uint32_t v = 0, near = LOD_NONE; v < source->vertex_count; v++)
    if (ladder->replacements[u][v] != LOD_NONE)
      ladder->replacements[u][v] = near = lod_bvh_closest(bvh, lod_vec3_from_float(source->positions[v]), near, INFINITY).primitive;
  return LOD_OK;
}

static enum lod_status extract_unit(struct ladder *ladder, uint32_t u) {
  struct run *run = &ladder->runs[u];
  ladder->nearby[u] = LOD_NEW(run->level_arena, run->unit->mesh.triangle_count, uint32_t);
  ladder->replacements[u] = LOD_NEW(run->level_arena, run->unit->mesh.vertex_count, uint32_t);
  if (ladder->nearby[u] == NULL || ladder->replacements[u] == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_collapser_extract(run->collapser, run->level_arena, &ladder->meshes[u], ladder->nearby[u]));
  LOD_TRY(lod_envelope_extract_attributes(run->collapser, run->level_arena, &ladder->meshes[u]));
  if (ladder->settings->collapse.vertex_subset)
    LOD_TRY(find_parents(ladder, u));
  LOD_TRY(lod_collapser_replacements(run->collapser, ladder->replacements[u]));
  if (!ladder->settings->collapse.vertex_subset && ladder->settings->wishes == NULL && ladder->settings->collapse.rms == 0)
    LOD_TRY(take_better(ladder, u));
  run->report = (struct lod_envelope_report){0};
  return lod_envelope_measure_attributes(run->collapser, run->level_arena, &run->report);
}

static void unit_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct ladder *ladder = context;
  (void)chunk;
  for (size_t u = begin; u < end; u++)
    ladder->runs[u].status = ladder->step(ladder, (uint32_t)u);
}

static enum lod_status for_units(struct ladder *ladder, enum lod_status (*step)(struct ladder *ladder, uint32_t u)) {
  ladder->step = step;
  lod_parallel_for(ladder->settings->threads, ladder->run_count, 1, unit_chunk, ladder);
  for (uint32_t u = 0; u < ladder->run_count; u++)
    LOD_TRY(ladder->runs[u].status);
  return LOD_OK;
}

static void add_report(struct lod_envelope_report *sum, const struct lod_envelope_report *unit, uint32_t triangles) {
  sum->triangles += triangles;
  for (int set = 0; set < LOD_UV_SETS; set++)
    sum->uv[set] = fmax(sum->uv[set], unit->uv[set]);
  sum->normal_degrees = fmax(sum->normal_degrees, unit->normal_degrees);
  for (int set = 0; set < LOD_UV_SETS; set++)
    sum->uv_bound[set] = fmax(sum->uv_bound[set], unit->uv_bound[set]);
  sum->normal_bound = fmax(sum->normal_bound, unit->normal_bound);
}

static enum lod_status emit_level(struct ladder *ladder, struct lod_arena *arena, lod_level_sink *sink, void *sink_context) {
  enum lod_status status = LOD_OK;
  for (uint32_t u = 0; u < ladder->run_count; u++) {
    ladder->runs[u].level_arena = lod_arena_create_child(arena);
    if (ladder->runs[u].level_arena == NULL)
      status = LOD_MEMORY;
  }
  if (status == LOD_OK)
    status = for_units(ladder, extract_unit);
  for (uint32_t u = 0; status == LOD_OK && ladder->report != NULL && u < ladder->run_count; u++)
    add_report(ladder->report, &ladder->runs[u].report, ladder->meshes[u].triangle_count);
  if (status == LOD_OK) {
    struct lod_envelope_report drift = {0};
    bool attributes = false;
    for (uint32_t u = 0; u < ladder->run_count; u++) {
      add_report(&drift, &ladder->runs[u].report, 0);
      attributes = attributes || ladder->runs[u].unit->mesh.wedge_count != 0;
    }
    struct lod_level level = {
        .meshes = ladder->meshes, .nearby = ladder->nearby, .replacements = ladder->replacements, .bound = ladder->epsilon};
    level.target = ladder->epsilon / (1 - ladder->settings->reserve);
    for (uint32_t u = 0; u < ladder->run_count; u++) {
      double precision = ladder->settings->reserve * fmin(level.target, ladder->runs[u].least_limit * ladder->runs[u].unit->scale);
      if (precision > 0 && (level.precision == 0 || precision < level.precision))
        level.precision = precision;
    }
    level.has_drift = attributes;
    for (int set = 0; set < LOD_UV_SETS; set++)
      level.uv_drift = fmax(level.uv_drift, drift.uv[set]);
    level.normal_drift = drift.normal_degrees;
    level.uv_bound = fmax(drift.uv_bound[0], drift.uv_bound[1]);
    level.normal_bound = drift.normal_bound;
    if (ladder->runs[0].last_vertex != NULL && ladder->parents[0] != NULL)
      level.parents = ladder->parents;
    status = sink(sink_context, &level);
  }
  for (uint32_t u = 0; u < ladder->run_count; u++) {
    lod_arena_destroy(ladder->runs[u].level_arena);
    ladder->runs[u].level_arena = NULL;
  }
  return status;
}

static enum lod_status build_level(struct ladder *ladder, struct lod_arena *arena, lod_level_sink *sink, void *sink_context) {
  LOD_TRY(for_units(ladder, collapse_unit));
  uint64_t triangles = 0;
  for (uint32_t u = 0; u < ladder->run_count; u++)
    triangles += ladder->runs[u].collapser->surface.live_faces;
  if ((double)triangles > (1 - ladder->settings->least_gain) * (double)ladder->last_triangles)
    return LOD_OK;
  ladder->last_triangles = triangles;
  if (ladder->report != NULL)
    ladder->report->epsilon = ladder->epsilon;
  return emit_level(ladder, arena, sink, sink_context);
}

/* The largest unit's diagonal, in the model: what the default ladder's shares refer to. */
static double largest_diagonal(const struct lod_unit *units, uint32_t unit_count) {
  double largest = 0;
  for (uint32_t u = 0; u < unit_count; u++) {
    struct lod_bounds bounds = lod_mesh_bounds(&units[u].mesh);
    largest = fmax(largest, lod_bounds_diagonal(&bounds) * units[u].scale);
  }
  return largest;
}

static enum lod_status check_settings(const struct lod_envelope_settings *settings, struct lod_problem *problem) {
  for (uint32_t i = 0; settings->epsilons != NULL && i < settings->epsilon_count; i++)
    if (!(settings->epsilons[i] >= 0) || !isfinite(settings->epsilons[i]) || (i > 0 && settings->epsilons[i] <= settings->epsilons[i - 1]))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-epsilon",
                      "Epsilons must be at least 0, finite and strictly increasing; number %u is %g.", i, settings->epsilons[i]);
  if (!(settings->least_gain >= 0 && settings->least_gain < 1))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-gain", "The least gain of a level must be in [0, 1), not %g.", settings->least_gain);
  if (!(settings->reserve >= 0 && settings->reserve <= 0.9))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-reserve", "The share of epsilon kept for quantisation must be in [0, 0.9], not %g.",
                    settings->reserve);
  const struct lod_attribute_bounds *a = &settings->collapse.attributes;
  if (!(a->uv >= 0 && a->slip >= 0 && a->normal_degrees >= 0 && a->color >= 0 && settings->collapse.rms >= 0))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-bound", "Bounds of attributes and of the mean error must be 0 (none) or more.");
  return LOD_OK;
}

static enum lod_status climb(struct ladder *ladder, const double *epsilons, uint32_t count, double unit_of_epsilon, struct lod_arena *arena,
                             lod_level_sink *sink, void *sink_context) {
  for (uint32_t i = 0; i < count; i++) {
    if (lod_progress_cancelled(ladder->progress))
      return LOD_CANCELLED;
    ladder->epsilon = fmax(epsilons[i] * unit_of_epsilon * (1 - ladder->settings->reserve), ladder->coplanar);
    ladder->report = ladder->settings->reports == NULL ? NULL : &ladder->settings->reports[i];
    if (ladder->report != NULL)
      *ladder->report = (struct lod_envelope_report){0};
    LOD_TRY(build_level(ladder, arena, sink, sink_context));
  }
  return LOD_OK;
}

static enum lod_status build(const struct lod_unit *units, uint32_t unit_count, const void *family_settings,
                             const struct lod_progress *progress, struct lod_arena *arena, lod_level_sink *sink, void *sink_context,
                             struct lod_problem *problem) {
  struct lod_envelope_settings settings =
      family_settings == NULL ? lod_envelope_defaults() : *(const struct lod_envelope_settings *)family_settings;
  LOD_TRY(check_settings(&settings, problem));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return lod_fail_memory(problem);
  struct ladder ladder = {.run_count = unit_count, .settings = &settings, .progress = progress};
  ladder.runs = LOD_NEW_ZERO(scratch, unit_count, struct run);
  ladder.meshes = LOD_NEW_ZERO(scratch, unit_count, struct lod_mesh);
  ladder.nearby = LOD_NEW_ZERO(scratch, unit_count, uint32_t *);
  ladder.replacements = LOD_NEW_ZERO(scratch, unit_count, uint32_t *);
  ladder.parents = LOD_NEW_ZERO(scratch, unit_count, uint32_t *);
  enum lod_status status =
      ladder.runs == NULL || ladder.meshes == NULL || ladder.nearby == NULL || ladder.replacements == NULL || ladder.parents == NULL
          ? LOD_MEMORY
          : LOD_OK;
  for (uint32_t u = 0; status == LOD_OK && u < unit_count; u++) {
    ladder.last_triangles += units[u].mesh.triangle_count;
    ladder.runs[u] = (struct run){.unit = &units[u], .arena = lod_arena_create_child(scratch)};
    if (ladder.runs[u].arena == NULL)
      status = LOD_MEMORY;
  }
  for (uint32_t u = 0; u < unit_count; u++)
    ladder.coplanar = fmax(ladder.coplanar, LOD_TOLERANCE_COPLANAR * lod_mesh_magnitude(&units[u].mesh) * units[u].scale);
  if (status == LOD_OK && settings.epsilons != NULL)
    status = climb(&ladder, settings.epsilons, settings.epsilon_count, 1, arena, sink, sink_context);
  else if (status == LOD_OK)
    status = climb(&ladder, kLadder, sizeof kLadder / sizeof kLadder[0], largest_diagonal(units, unit_count), arena, sink, sink_context);
  for (uint32_t u = 0; ladder.runs != NULL && u < unit_count; u++)
    lod_arena_destroy(ladder.runs[u].arena);
  lod_arena_destroy(scratch);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  if (status == LOD_CANCELLED)
    lod_fail(problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
  return status;
}

const struct lod_family lod_envelope_family = {
    .name = "envelope",
    .sentence = "within epsilon of the source in both directions, proven, in as few triangles as possible",
    .nested = false,
    .build = build,
};
