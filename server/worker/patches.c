#include "server/worker/patches.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/patches.h"
#include "core/clod/clod.h"
#include "core/clod/halve.h"
#include "core/clod/tessellate.h"

/* Shares of the diagonal, finest first. */
static const double kLadder[] = {0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.04};

/* Of what a level may be off, patches get this share; the rest is for quantisation (half the cube's diagonal of kStep steps) and the chords
 * of the tessellation. kStep and kChord are shares of the patches' own error. */
static const double kPatches = 0.65, kStep = 0.4, kChord = 0.12;
/* Steps of UVs: a share of what they are off, between a texel of 1024 and a quarter of one of 16384. */
static const double kMostUvStep = 1e-3, kLeastUvStep = 0x1p-16;

const double *lod_curved_ladder(uint32_t *count) {
  *count = sizeof kLadder / sizeof kLadder[0];
  return kLadder;
}

struct run {
  const struct lod_unit *units;
  uint32_t unit_count;
  struct lod_clod **clods;    /* what the level at hand is taken from: one of the next two */
  struct lod_clod **splines;  /* from the unit's charts, or NULL */
  struct lod_clod **polygons; /* from its triangles; made when first needed */
  struct lod_arena *arena;
  bool search;
  uint32_t *most; /* patches of each unit before anything was merged */
  double least;   /* error below which nothing is coded more finely, model units */
  const struct lod_progress *progress;
  struct lod_problem *problem;
};

/* One unit of a level: what a client makes of it, its frame's bytes. */
struct piece {
  struct lod_mesh mesh;
  uint8_t *bytes;
  size_t size;
  uint32_t patches;
  double error, deviation; /* model units: bound of the patches before coding; of their chords */
  double uv;               /* how far UVs are off; INFINITY: the source has some that the patches have not */
  double color;            /* and colours */
};

static enum lod_status make_piece(const struct run *run, uint32_t u, struct lod_arena *arena, struct piece *piece) {
  struct lod_clod_facts facts;
  struct lod_patches patches, decoded;
  double error;
  lod_clod_facts(run->clods[u], &facts);
  if (lod_clod_extract(run->clods[u], facts.clod, arena, &patches, &error) != LOD_OK)
    return lod_fail_memory(run->problem);
  if (lod_patches_separate(&patches, arena, &patches) != LOD_OK)
    return lod_fail_memory(run->problem);
  double scale = run->units[u].scale, floor = run->least / scale;
  double own = fmax(error, floor);
  struct lod_patches_encode_request encode = {
      .patches = &patches, .unit = u, .unit_count = run->unit_count, .step = kStep * own, .error = error * scale};
  encode.uv_step = fmin(kMostUvStep, fmax(kLeastUvStep, kStep * patches.attributes.uv_off));
  struct lod_patches_header header;
  LOD_TRY(lod_patches_encode(&encode, arena, &piece->bytes, &piece->size, run->problem));
  LOD_TRY(lod_patches_decode(piece->bytes, piece->size, 0, arena, &header, &decoded, run->problem));
  struct lod_tessellate_settings settings = lod_tessellate_defaults();
  struct lod_tessellation flat;
  settings.tolerance = kChord * own;
  settings.threads = 1;
  LOD_TRY(lod_tessellate(&decoded, &settings, arena, &flat, run->problem));
  piece->mesh = flat.mesh;
  piece->patches = decoded.patch_count;
  piece->error = (error + 0.867 * (double)header.step) * scale;
  piece->deviation = flat.deviation * scale;
  /* Linear over triangles as over patches: corresponding points have the same. 0.71: of a square's half diagonal. */
  piece->uv = patches.attributes.corners != NULL ? patches.attributes.uv_off + 0.71 * encode.uv_step : 0;
  piece->color = patches.attributes.corners != NULL && patches.attributes.has_colors ? patches.attributes.color_off + 0.5 / 255 : 0;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (run->units[u].mesh.uvs[set] != NULL && !patches.attributes.has_uv[set])
      piece->uv = INFINITY;
  return LOD_OK;
}

static enum lod_status emit(const struct run *run, struct lod_arena *arena, lod_level_sink *sink, void *sink_context) {
  struct lod_mesh *meshes = LOD_NEW(arena, run->unit_count, struct lod_mesh);
  struct piece *pieces = LOD_NEW_ZERO(arena, run->unit_count, struct piece);
  if (meshes == NULL || pieces == NULL)
    return lod_fail_memory(run->problem);
  struct lod_level_patches patches = {0};
  double bound = 0, uv = 0;
  for (uint32_t u = 0; u < run->unit_count; u++) {
    LOD_TRY(make_piece(run, u, arena, &pieces[u]));
    meshes[u] = pieces[u].mesh;
    patches.size += pieces[u].size;
    patches.count += pieces[u].patches;
    patches.deviation = fmax(patches.deviation, pieces[u].deviation);
    bound = fmax(bound, pieces[u].error + pieces[u].deviation);
    uv = fmax(uv, pieces[u].uv);
    patches.color_bound = fmax(patches.color_bound, pieces[u].color);
  }
  uint8_t *bytes = LOD_NEW(arena, patches.size, uint8_t);
  if (bytes == NULL)
    return lod_fail_memory(run->problem);
  size_t at = 0;
  for (uint32_t u = 0; u < run->unit_count; u++) {
    memcpy(bytes + at, pieces[u].bytes, pieces[u].size);
    at += pieces[u].size;
  }
  patches.bytes = bytes;
  struct lod_level level = {.meshes = meshes, .patches = &patches, .bound = bound, .uv_bound = uv, .normal_bound = INFINITY};
  return sink(sink_context, &level);
}

static uint64_t patches_of_all(const struct run *run) {
  uint64_t sum = 0;
  for (uint32_t u = 0; u < run->unit_count; u++) {
    struct lod_clod_facts facts;
    lod_clod_facts(run->clods[u], &facts);
    sum += facts.patches;
  }
  return sum;
}

/* Splines are merged from their own patches, the finest level being these: triangles, which only approximate them, would need many times as
 * many patches for any error below. */
static enum lod_status choose_model(const struct run *run, uint32_t u) {
  if (run->splines[u] != NULL) {
    run->clods[u] = run->splines[u];
    return LOD_OK;
  }
  if (run->polygons[u] == NULL)
    LOD_TRY(lod_clod_create(&run->units[u].mesh, NULL, run->arena, &run->polygons[u], run->problem));
  run->clods[u] = run->polygons[u];
  return LOD_OK;
}

/* C-LOD after C-LOD of the paper's search, until it is stuck with edges that turn by a right angle. Where it is stuck before, vertices of
 * high degree go too, curves are moved into planes, and the angle is relaxed (Gopi & Manocha 1998, 8.2). */
static enum lod_status search_patterns(struct lod_clod *clod, uint32_t wanted, double error, const struct lod_progress *progress) {
  struct lod_clod_search_settings settings = lod_clod_search_defaults();
  settings.patches = wanted;
  settings.error = error;
  struct lod_clod_facts facts;
  for (lod_clod_facts(clod, &facts); facts.patches > wanted && settings.angle_degrees < 90; lod_clod_facts(clod, &facts)) {
    struct lod_clod_search_facts found;
    LOD_TRY(lod_clod_search(clod, &settings, progress, &found));
    if (found.removed - found.refused > facts.vertices / 100)
      continue;
    uint32_t moved;
    if (settings.wide) {
      LOD_TRY(lod_clod_straighten(clod, error, &moved));
      settings.angle_degrees *= 1.3;
    }
    settings.wide = true;
  }
  return LOD_OK;
}

/* Every unit down to its share of `patches` of `all`, or as far as `error` allows. */
static enum lod_status simplify(const struct run *run, double share, double error) {
  for (uint32_t u = 0; u < run->unit_count; u++) {
    LOD_TRY(choose_model(run, u));
    uint32_t wanted = (uint32_t)fmax(0, floor(share * run->most[u] + 0.5));
    double own = error / run->units[u].scale;
    LOD_TRY(run->search ? search_patterns(run->clods[u], wanted, own, run->progress)
                        : lod_clod_simplify(run->clods[u], wanted, own, run->progress));
  }
  return LOD_OK;
}

static int falling(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return x < y ? 1 : x > y ? -1 : 0;
}

static enum lod_status emit_in(const struct run *run, struct lod_arena *arena, lod_level_sink *sink, void *sink_context) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : emit(run, scratch, sink, sink_context);
  lod_arena_destroy(scratch);
  return status;
}

static enum lod_status run_levels(const struct run *run, const struct lod_curved_settings *settings, struct lod_arena *arena,
                                  lod_level_sink *sink, void *sink_context) {
  uint64_t all = 0, before = UINT64_MAX;
  for (uint32_t u = 0; u < run->unit_count; u++)
    all += run->most[u];
  uint32_t count = settings->patches != NULL ? settings->patch_count : settings->error_count;
  uint32_t *wanted = LOD_NEW(arena, count, uint32_t);
  if (wanted == NULL)
    return LOD_MEMORY;
  if (settings->patches != NULL) {
    memcpy(wanted, settings->patches, count * sizeof *wanted);
    qsort(wanted, count, sizeof *wanted, falling);
  }
  for (uint32_t k = 0; k < count; k++) {
    bool by_number = settings->patches != NULL;
    LOD_TRY(
        simplify(run, by_number && all > 0 ? (double)wanted[k] / (double)all : 0, by_number ? INFINITY : kPatches * settings->errors[k]));
    lod_progress_report(run->progress, "clod", (k + 1.0) / count);
    uint64_t now = patches_of_all(run);
    if (now < before) /* no level twice */
      LOD_TRY(emit_in(run, arena, sink, sink_context));
    before = now;
  }
  return LOD_OK;
}

static enum lod_status build(const struct lod_unit *units, uint32_t unit_count, const void *settings, const struct lod_progress *progress,
                             struct lod_arena *arena, lod_level_sink *sink, void *sink_context, struct lod_problem *problem) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct run run = {.units = units,
                    .unit_count = unit_count,
                    .progress = progress,
                    .problem = problem,
                    .search = ((const struct lod_curved_settings *)settings)->search};
  struct lod_clod **lists = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, 3 * (size_t)unit_count, struct lod_clod *);
  run.most = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, unit_count, uint32_t);
  enum lod_status status = lists == NULL || run.most == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK) {
    run.clods = lists;
    run.splines = lists + unit_count;
    run.polygons = lists + 2 * (size_t)unit_count;
    run.arena = scratch;
  }
  for (uint32_t u = 0; status == LOD_OK && u < unit_count; u++) {
    struct lod_bounds bounds = lod_mesh_bounds(&units[u].mesh);
    run.least = fmax(run.least, 1e-5 * lod_bounds_diagonal(&bounds) * units[u].scale);
    bool suitable = false;
    run.most[u] = units[u].mesh.triangle_count;
    if (units[u].charts != NULL)
      status = lod_clod_create_charts(&units[u].mesh, units[u].charts, NULL, scratch, &run.splines[u], &suitable, problem);
    if (suitable)
      run.most[u] = units[u].charts->count;
  }
  if (status == LOD_OK)
    status = run_levels(&run, settings, scratch, sink, sink_context);
  lod_arena_destroy(scratch);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  if (status == LOD_CANCELLED)
    lod_fail(problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
  return status;
}

const struct lod_family lod_curved_family = {
    .name = "clod",
    .sentence = "curved patches that show no facets at any zoom, proven within an error of the source",
    .nested = false,
    .build = build,
};
