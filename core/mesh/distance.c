/* Drives certify.h over the primitives of a side: a sample gives a first lower bound, the neighbourhoods of its worst members a better one,
 * then every primitive is certified against it, whole groups at once where they are small; what resists goes into a list that is worked
 * off from the worst bound down.
 *
 * Based on: Tang, Lee, Kim. Interactive Hausdorff distance computation for general polygonal models. 2009. Sacht, Jacobson. Cascading upper
 * bounds for triangle soup Pompeiu-Hausdorff distance. 2024.
 * Ours: work is cut in fixed chunks, and chunks in rounds. A chunk starts from the lower bound known at the start of its round and sees no
 * other chunk of that round, so the numbers do not depend on the number of threads or on their luck. */
#include "core/mesh/distance.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/certify.h"
#include "core/mesh/distance_rms.h"

enum {
  SAMPLES = 4096, /* primitives asked first */
  SAMPLE_GRAIN = 64,
  SUSPECTS = 128,    /* neighbourhoods searched next */
  SUSPECT_LEVEL = 2, /* 64 primitives each */
  CHUNK_LEVEL = 5,   /* 4096 primitives */
  FIRST_ROUND = 64,  /* chunks */
  SCAN_SPLITS = 64,  /* a primitive may take while scanning */
  FIRST_BATCH = 64,  /* pieces of the list */
  LARGEST_BATCH = 8192,
};
static const uint64_t kBudget = 20000000, kBudgetEach = 20;

struct piece_list {
  struct lod_arena *arena; /* created with the first piece */
  struct lod_piece *pieces;
  size_t count, capacity;
};

/* What a chunk brings back. */
struct chunk_result {
  double reached, upper;
  uint64_t splits;
  bool failed; /* memory */
  struct piece_list rest;
};

struct side {
  const struct lod_bvh *items; /* whose points are measured */
  const struct lod_bvh *target;
  const uint32_t *hints;
  const struct lod_distance_settings *settings;
  double known_upper, rounding;
  struct lod_arena *arena;
  double outside; /* lower bound from the other side, where only the larger counts */
  double reached, upper;
  uint64_t splits, budget;
  /* the running round */
  struct chunk_result *results;
  size_t first; /* chunk, sample or piece that the round starts with */
  uint32_t splits_each;
  const struct lod_piece *pieces;
  uint32_t *suspects; /* slots */
  double *sampled;
  atomic_bool cancelled;
};

struct lod_distance_settings lod_distance_defaults(void) {
  return (struct lod_distance_settings){
      .relative = LOD_TOLERANCE_DISTANCE_RELATIVE,
      .known_upper_ab = INFINITY,
      .known_upper_ba = INFINITY,
  };
}

static bool push(struct piece_list *list, struct lod_arena *parent, const struct lod_piece *pieces, size_t count) {
  if (count == 0)
    return true;
  if (list->arena == NULL) {
    list->arena = lod_arena_create_child(parent);
    if (list->arena == NULL)
      return false;
  }
  if (list->count + count > list->capacity) {
    size_t capacity = list->capacity * 2 > list->count + count ? list->capacity * 2 : list->count + count;
    struct lod_piece *larger = LOD_NEW(list->arena, capacity, struct lod_piece);
    if (larger == NULL)
      return false;
    if (list->count > 0)
      memcpy(larger, list->pieces, list->count * sizeof *larger);
    list->pieces = larger;
    list->capacity = capacity;
  }
  memcpy(list->pieces + list->count, pieces, count * sizeof *pieces);
  list->count += count;
  return true;
}

static void list_finish(struct piece_list *list) {
  lod_arena_destroy(list->arena);
  *list = (struct piece_list){0};
}

static struct lod_certifier start_certifier(const struct side *side) {
  struct lod_certifier certifier = {
      .items = side->items,
      .target = side->target,
      .relative = side->settings->relative,
      .absolute = side->settings->absolute,
      .rounding = side->rounding,
      .known_upper = side->known_upper,
  };
  lod_certifier_init(&certifier, fmax(side->reached, side->outside));
  return certifier;
}

static uint32_t hint_of(const struct side *side, uint32_t primitive) {
  uint32_t hint = side->hints != NULL ? side->hints[primitive] : LOD_NONE;
  return hint < side->target->count ? hint : LOD_NONE;
}

static void end_chunk(struct chunk_result *result, const struct lod_certifier *certifier) {
  result->reached = certifier->reached;
  result->upper = certifier->upper;
  result->splits = certifier->splits;
}

/* --- rounds --- */

/* Runs `body` over chunks [0, count) of a round and adds up what they bring; undecided pieces go to `rest`. */
static enum lod_status run_round(struct side *side, size_t count, size_t grain, lod_parallel_body *body, struct piece_list *rest) {
  size_t chunks = lod_parallel_chunks(count, grain);
  struct lod_arena *scratch = lod_arena_create_child(side->arena);
  side->results = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, chunks, struct chunk_result);
  if (side->results == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  lod_parallel_for(side->settings->threads, count, grain, body, side);
  bool failed = false;
  for (size_t i = 0; i < chunks; i++) {
    struct chunk_result *result = &side->results[i];
    side->reached = fmax(side->reached, result->reached);
    side->upper = fmax(side->upper, result->upper);
    side->splits += result->splits;
    failed = failed || result->failed || (rest != NULL && !push(rest, side->arena, result->rest.pieces, result->rest.count));
    list_finish(&result->rest);
  }
  lod_arena_destroy(scratch);
  if (atomic_load(&side->cancelled) || lod_progress_cancelled(side->settings->progress))
    return LOD_CANCELLED;
  return failed ? LOD_MEMORY : LOD_OK;
}

static bool stop_chunk(struct side *side) {
  if (lod_progress_cancelled(side->settings->progress))
    atomic_store(&side->cancelled, true);
  return atomic_load(&side->cancelled);
}

/* --- a first lower bound --- */

/* Distances of a corner of every stride-th primitive. */
static void sample_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct side *side = context;
  if (stop_chunk(side))
    return;
  struct chunk_result *result = &side->results[chunk];
  uint32_t last = LOD_NONE;
  for (size_t i = begin; i < end; i++) {
    uint32_t primitive = side->items->order[side->suspects[i]], hint = hint_of(side, primitive);
    struct lod_vec3 corners[3];
    double d2;
    lod_bvh_corners(side->items, primitive, corners);
    last = lod_bvh_search(side->target, corners[0], hint != LOD_NONE ? hint : last, INFINITY, -1, &d2);
    side->sampled[i] = sqrt(d2);
    result->reached = fmax(result->reached, side->sampled[i]);
  }
}

/* Certifies everything under a node. Groups that are small beside the threshold are tried as a ball first. */
static void scan_node(struct side *side, struct lod_certifier *certifier, uint32_t level, uint32_t index, struct chunk_result *result) {
  const struct lod_bvh_node *node = &side->items->levels[level][index];
  for (uint32_t lane = 0; lane < LOD_BVH_WIDTH; lane++) {
    if (!(node->min[0][lane] <= node->max[0][lane]))
      continue;
    struct lod_vec3 low = lod_vec3_make(node->min[0][lane], node->min[1][lane], node->min[2][lane]);
    struct lod_vec3 high = lod_vec3_make(node->max[0][lane], node->max[1][lane], node->max[2][lane]);
    double radius = 0.5 * lod_vec3_distance(low, high);
    if (level > 0 && radius < 0.5 * certifier->threshold &&
        lod_certify_ball(certifier, lod_vec3_scale(lod_vec3_add(low, high), 0.5), radius))
      continue;
    uint64_t child = (uint64_t)index * LOD_BVH_WIDTH + lane;
    if (level > 0) {
      scan_node(side, certifier, level - 1, (uint32_t)child, result);
    } else {
      struct lod_piece rest[LOD_CERTIFY_REST];
      uint32_t primitive = side->items->order[child];
      uint32_t left = lod_certify_primitive(certifier, primitive, hint_of(side, primitive), side->splits_each, rest);
      if (!push(&result->rest, side->arena, rest, left))
        result->failed = true;
    }
  }
}

static void suspect_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct side *side = context;
  if (stop_chunk(side))
    return;
  uint32_t level = side->items->level_count - 1 < SUSPECT_LEVEL ? side->items->level_count - 1 : SUSPECT_LEVEL;
  struct lod_vertex_cache cache;
  lod_vertex_cache_init(&cache);
  struct lod_certifier certifier = start_certifier(side);
  certifier.cache = &cache;
  for (size_t i = begin; i < end; i++)
    scan_node(side, &certifier, level, side->suspects[side->first + i] >> (2 * (level + 1)), &side->results[chunk]);
  end_chunk(&side->results[chunk], &certifier);
  side->results[chunk].upper = 0; /* the scan will pass here again */
}

struct suspect {
  double distance;
  uint32_t slot;
};

static int by_distance(const void *a, const void *b) {
  const struct suspect *x = a, *y = b;
  if (x->distance != y->distance)
    return x->distance > y->distance ? -1 : 1;
  return x->slot < y->slot ? -1 : x->slot > y->slot;
}

/* Asks a sample; its worst members, worst first, become the suspects. */
static enum lod_status sample(struct side *side) {
  uint32_t count = side->items->count, samples = count < SAMPLES ? count : SAMPLES;
  side->suspects = LOD_NEW(side->arena, samples, uint32_t);
  struct lod_arena *scratch = lod_arena_create_child(side->arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  side->sampled = LOD_NEW_ZERO(scratch, samples, double);
  struct suspect *suspects = LOD_NEW(scratch, samples, struct suspect);
  enum lod_status status = side->suspects == NULL || side->sampled == NULL || suspects == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK) {
    for (uint32_t i = 0; i < samples; i++)
      side->suspects[i] = (uint32_t)((uint64_t)i * count / samples);
    status = run_round(side, samples, SAMPLE_GRAIN, sample_chunk, NULL);
  }
  if (status == LOD_OK) {
    for (uint32_t i = 0; i < samples; i++)
      suspects[i] = (struct suspect){side->sampled[i], side->suspects[i]};
    qsort(suspects, samples, sizeof *suspects, by_distance);
    for (uint32_t i = 0; i < samples; i++)
      side->suspects[i] = suspects[i].slot;
  }
  lod_arena_destroy(scratch);
  return status;
}

/* Searches around the suspects, the worst first: never more than a few percent of a mesh. */
static enum lod_status question_suspects(struct side *side) {
  size_t suspects = side->items->count / 2048 < SUSPECTS ? side->items->count / 2048 : SUSPECTS, round = 8;
  side->splits_each = SCAN_SPLITS;
  for (size_t done = 0; done < suspects; done += round, round *= 2) {
    side->first = done;
    LOD_TRY(run_round(side, suspects - done < round ? suspects - done : round, 1, suspect_chunk, NULL));
  }
  return LOD_OK;
}

/* --- everything --- */

static uint32_t chunk_level(const struct side *side) {
  uint32_t top = side->items->level_count - 1;
  return top < CHUNK_LEVEL ? top : CHUNK_LEVEL;
}

static void scan_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct side *side = context;
  if (stop_chunk(side))
    return;
  struct lod_vertex_cache cache;
  lod_vertex_cache_init(&cache);
  struct lod_certifier certifier = start_certifier(side);
  certifier.cache = &cache;
  for (size_t i = begin; i < end; i++)
    scan_node(side, &certifier, chunk_level(side), (uint32_t)(side->first + i), &side->results[chunk]);
  end_chunk(&side->results[chunk], &certifier);
}

static enum lod_status scan_everything(struct side *side, struct piece_list *rest) {
  size_t chunks = side->items->node_counts[chunk_level(side)], round = FIRST_ROUND;
  uint64_t fair = side->budget / side->items->count;
  side->splits_each = fair < SCAN_SPLITS ? (uint32_t)fair : SCAN_SPLITS;
  for (size_t done = 0; done < chunks; done += round, round *= 2) {
    side->first = done;
    LOD_TRY(run_round(side, chunks - done < round ? chunks - done : round, 1, scan_chunk, rest));
    lod_progress_report(side->settings->progress, "measure", (double)(done + round < chunks ? done + round : chunks) / (double)chunks);
  }
  return LOD_OK;
}

static void piece_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct side *side = context;
  if (stop_chunk(side))
    return;
  struct chunk_result *result = &side->results[chunk];
  struct lod_certifier certifier = start_certifier(side);
  for (size_t i = begin; i < end; i++) {
    struct lod_piece rest[LOD_CERTIFY_REST];
    uint32_t left = lod_certify_piece(&certifier, &side->pieces[side->first + i], side->splits_each, rest);
    if (!push(&result->rest, side->arena, rest, left))
      result->failed = true;
  }
  end_chunk(result, &certifier);
}

static int by_upper(const void *a, const void *b) {
  const struct lod_piece *x = a, *y = b;
  if (x->upper != y->upper)
    return x->upper > y->upper ? -1 : 1;
  if (x->count != y->count)
    return x->count < y->count ? -1 : 1;
  return memcmp(x->corners, y->corners, x->count * sizeof *x->corners);
}

/* Works the list off from the worst down, a generation at a time: what a piece leaves after its splits joins the next generation, which
 * may split twice as often. */
static enum lod_status work_off(struct side *side, struct piece_list *list) {
  enum lod_status status = LOD_OK;
  uint32_t splits_each = SCAN_SPLITS;
  while (status == LOD_OK && list->count > 0) {
    struct piece_list next = {0};
    qsort(list->pieces, list->count, sizeof *list->pieces, by_upper);
    size_t batch = FIRST_BATCH, done = 0;
    for (; status == LOD_OK && done < list->count && side->splits < side->budget; batch = batch < LARGEST_BATCH ? batch * 2 : batch) {
      size_t count = list->count - done < batch ? list->count - done : batch;
      uint64_t fair = (side->budget - side->splits) / count + 1;
      side->splits_each = fair < splits_each ? (uint32_t)fair : splits_each;
      side->pieces = list->pieces;
      side->first = done;
      status = run_round(side, count, 8, piece_chunk, &next);
      done += count;
    }
    if (status == LOD_OK && side->splits >= side->budget) {
      for (; done < list->count; done++)
        side->upper = fmax(side->upper, list->pieces[done].upper);
      for (size_t i = 0; i < next.count; i++)
        side->upper = fmax(side->upper, next.pieces[i].upper);
      list_finish(&next);
    }
    list_finish(list);
    *list = next;
    splits_each = splits_each < (1u << 20) ? splits_each * 2 : splits_each;
  }
  list_finish(list);
  return status;
}

static enum lod_status certify_side(struct side *side) {
  struct piece_list rest = {0};
  LOD_TRY(question_suspects(side));
  enum lod_status status = scan_everything(side, &rest);
  if (status == LOD_OK)
    return work_off(side, &rest);
  list_finish(&rest);
  return status;
}

/* --- both sides --- */

static struct lod_interval side_interval(const struct side *side) {
  struct lod_interval interval = {fmax(0, side->reached - side->rounding), side->upper + side->rounding};
  interval.upper = fmin(interval.upper, side->known_upper);
  interval.lower = fmin(interval.lower, interval.upper);
  return interval;
}

/* Closed to what was asked for, or to rounding? Where only the larger side counts it is measured against that. */
static bool is_complete(const struct side *side, const struct lod_interval *interval) {
  double lower = fmax(interval->lower, fmax(side->outside - side->rounding, 0));
  double slack = fmax(side->settings->relative * lower, side->settings->absolute);
  return interval->upper <= lower + slack + 8 * side->rounding;
}

static enum lod_status measure(struct side sides[2], struct lod_arena *arena, struct lod_distance *distance) {
  const struct lod_distance_settings *settings = sides[0].settings;
  for (int s = 0; s < 2; s++)
    LOD_TRY(sample(&sides[s]));
  int larger = sides[1].reached > sides[0].reached;
  for (int i = 0; i < 2; i++) {
    struct side *side = &sides[i == 0 ? larger : !larger];
    if (settings->larger_side_only)
      side->outside = sides[i == 0 ? !larger : larger].reached;
    LOD_TRY(certify_side(side));
  }
  distance->a_to_b = side_interval(&sides[0]);
  distance->b_to_a = side_interval(&sides[1]);
  distance->two_sided.lower = fmax(distance->a_to_b.lower, distance->b_to_a.lower);
  distance->two_sided.upper = fmax(distance->a_to_b.upper, distance->b_to_a.upper);
  distance->complete = is_complete(&sides[0], &distance->a_to_b) && is_complete(&sides[1], &distance->b_to_a);
  if (settings->rms) {
    for (int s = 0; s < 2; s++) {
      double rms;
      LOD_TRY(lod_distance_sample_rms(sides[s].items, sides[s].target, settings->threads, arena, &rms));
      distance->rms = fmax(distance->rms, rms);
    }
  }
  return LOD_OK;
}

static enum lod_status measure_trees(const struct lod_mesh *a, const struct lod_mesh *b, const struct lod_distance_settings *settings,
                                     struct lod_arena *scratch, struct lod_distance *distance) {
  struct lod_bvh *built[2];
  const struct lod_bvh *trees[2] = {settings->bvh_a, settings->bvh_b};
  for (int s = 0; s < 2; s++) {
    if (trees[s] == NULL) {
      LOD_TRY(lod_bvh_create(s == 0 ? a : b, settings->threads, scratch, &built[s]));
      trees[s] = built[s];
    }
  }
  /* Corners that cutting makes are rounded too, each a little more than those it was made from: sixteen times what one distance needs. */
  double rounding = 16 * lod_tolerance_rounding(fmax(lod_mesh_magnitude(a), lod_mesh_magnitude(b)));
  struct side sides[2];
  for (int s = 0; s < 2; s++) {
    sides[s] = (struct side){
        .items = trees[s],
        .target = trees[!s],
        .hints = s == 0 ? settings->hint_ab : settings->hint_ba,
        .settings = settings,
        .known_upper = s == 0 ? settings->known_upper_ab : settings->known_upper_ba,
        .rounding = rounding,
        .arena = scratch,
        .budget = settings->budget > 0 ? settings->budget : kBudget + kBudgetEach * trees[s]->count,
    };
  }
  return measure(sides, scratch, distance);
}

static bool is_empty(const struct lod_mesh *mesh) {
  return mesh->triangle_count == 0 && mesh->edge_count == 0 && mesh->point_count == 0;
}

enum lod_status lod_distance_measure(const struct lod_mesh *a, const struct lod_mesh *b, const struct lod_distance_settings *settings,
                                     struct lod_arena *arena, struct lod_distance *distance) {
  *distance = (struct lod_distance){.complete = true};
  if (is_empty(a) || is_empty(b)) {
    /* The farthest point of nothing is at 0; the nearest point of nothing is nowhere. */
    struct lod_interval nowhere = {INFINITY, INFINITY};
    if (!is_empty(a))
      distance->a_to_b = distance->two_sided = nowhere;
    if (!is_empty(b))
      distance->b_to_a = distance->two_sided = nowhere;
    return LOD_OK;
  }
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  enum lod_status status = measure_trees(a, b, settings, scratch, distance);
  lod_arena_destroy(scratch);
  return status;
}
