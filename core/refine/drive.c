/* From interest to splits and merges: all at once, or some a frame. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/refine/doi.h"
#include "core/refine/internal.h"

/* A face and how much it is wanted; ordered by that, then by a key that does not depend on history. */
struct wish {
  double value;
  uint64_t key;
  uint32_t face;
};

static bool before(const struct wish *a, const struct wish *b) {
  return a->value != b->value ? a->value > b->value : a->key < b->key;
}
static int compare_wishes(const void *left, const void *right) {
  return before(left, right) ? -1 : before(right, left) ? 1 : 0;
}

struct run {
  struct lod_refiner *r;
  const struct lod_doi *doi;
  const struct lod_refine_limits *limits;
  const struct lod_progress *progress;
  struct lod_refine_stats *stats;
  struct lod_arena *scratch;
  struct wish *wishes; /* a heap in run with a budget; else a queue */
  uint32_t count, room;
  uint32_t steps;
};

static bool add_room(struct run *run, uint32_t more) {
  if (run->room - run->count >= more)
    return true;
  uint64_t room = (uint64_t)run->room * 2 + more + 256;
  struct wish *grown = room < UINT32_MAX ? LOD_NEW(run->scratch, room, struct wish) : NULL;
  if (grown == NULL)
    return false;
  if (run->count != 0)
    memcpy(grown, run->wishes, run->count * sizeof *grown);
  run->wishes = grown;
  run->room = (uint32_t)room;
  return true;
}

static bool over(const struct run *run) {
  const struct lod_refine_limits *l = run->limits;
  double bytes = l->bytes_per_vertex * lod_refiner_vertices(run->r) + l->bytes_per_triangle * lod_refiner_triangles(run->r);
  return (l->max_triangles != 0 && lod_refiner_triangles(run->r) > l->max_triangles) || (l->max_bytes != 0 && bytes > (double)l->max_bytes);
}

static bool has_budget(const struct run *run) {
  return run->limits->max_triangles != 0 || run->limits->max_bytes != 0;
}

/* Splits with what that entails, or nothing when the budget has no room for it. */
static bool split_within(struct run *run, uint32_t f) {
  if (!lod_refiner_split(run->r, f))
    return false;
  if (over(run)) {
    refine_undo(run->r);
    run->stats->budget = true;
    return false;
  }
  run->stats->splits++;
  return true;
}

/* ---- all at once ---- */

static void heap_push(struct run *run, struct wish wish) {
  uint32_t at = run->count++;
  for (uint32_t up; at > 0 && before(&wish, &run->wishes[up = (at - 1) / 2]); at = up)
    run->wishes[at] = run->wishes[up];
  run->wishes[at] = wish;
}

static struct wish heap_pop(struct run *run) {
  struct wish top = run->wishes[0], last = run->wishes[--run->count];
  uint32_t at = 0;
  for (;;) {
    uint32_t down = 2 * at + 1;
    if (down >= run->count)
      break;
    if (down + 1 < run->count && before(&run->wishes[down + 1], &run->wishes[down]))
      down++;
    if (!before(&run->wishes[down], &last))
      break;
    run->wishes[at] = run->wishes[down];
    at = down;
  }
  if (run->count != 0)
    run->wishes[at] = last;
  return top;
}

static bool consider(struct run *run, uint32_t f, bool heap) {
  const struct face *face = &run->r->faces[f];
  if (face->level >= run->steps)
    return true;
  if (!add_room(run, 1))
    return false;
  struct wish wish = {.key = refine_key(face), .face = f};
  if (!heap) {
    run->wishes[run->count++] = wish;
    return true;
  }
  wish.value = lod_doi_value(run->r, run->doi, run->limits, f);
  run->stats->evaluated++;
  if (wish.value > 1)
    heap_push(run, wish);
  return true;
}

/* Children of all that the latest split opened. */
static bool consider_journal(struct run *run, bool heap) {
  struct lod_refiner *r = run->r;
  for (uint32_t i = 0; i < r->journal_count; i++)
    for (uint32_t k = 0; k < 4; k++)
      if (!consider(run, r->faces[r->journal[i]].child + k, heap))
        return false;
  return true;
}

static bool consider_leaves(struct run *run, uint32_t f, bool heap) {
  if (!run->r->faces[f].split)
    return consider(run, f, heap);
  for (uint32_t k = 0; k < 4; k++)
    if (!consider_leaves(run, run->r->faces[f].child + k, heap))
      return false;
  return true;
}

static enum lod_status run_queue(struct run *run) {
  for (uint32_t at = 0; at < run->count; at++) {
    uint32_t f = run->wishes[at].face;
    if (at % 1024 == 0 && lod_progress_cancelled(run->progress))
      return LOD_CANCELLED;
    if (run->r->faces[f].split)
      continue;
    run->stats->evaluated++;
    if (!(lod_doi_value(run->r, run->doi, run->limits, f) > 1))
      continue;
    if (split_within(run, f) && !consider_journal(run, false))
      return LOD_MEMORY;
    if (run->r->failed)
      return LOD_MEMORY;
  }
  return LOD_OK;
}

/* Faces that do not fit are passed over: something less urgent may need less. After many in a row nothing will. */
enum { PATIENCE = 256 };

static enum lod_status run_heap(struct run *run) {
  uint32_t refused = 0, steps = 0;
  while (run->count != 0 && refused < PATIENCE) {
    struct wish wish = heap_pop(run);
    if (steps++ % 1024 == 0 && lod_progress_cancelled(run->progress))
      return LOD_CANCELLED;
    if (run->r->faces[wish.face].split)
      continue;
    if (!split_within(run, wish.face)) {
      refused++;
      if (run->r->failed)
        return LOD_MEMORY;
      continue;
    }
    refused = 0;
    if (!consider_journal(run, true))
      return LOD_MEMORY;
  }
  return LOD_OK;
}

static enum lod_status run_contacts(struct run *run) {
  for (uint32_t i = 0; i < run->doi->term_count; i++) {
    struct lod_contact contact;
    if (run->doi->terms[i].kind != LOD_DOI_CONTACT || run->r->base_faces == 0)
      continue;
    enum lod_status status = refine_contact_within(run->r, run->doi->terms[i].point, run->steps, run->limits, &contact);
    if (status == LOD_LIMIT)
      run->stats->budget = true;
    else if (status != LOD_OK)
      return status;
  }
  return LOD_OK;
}

static void start(struct run *run) {
  *run->stats = (struct lod_refine_stats){0};
  run->steps = run->limits->steps < LOD_REFINE_MAX_LEVEL ? run->limits->steps : LOD_REFINE_MAX_LEVEL;
}

enum lod_status lod_refine_run(struct lod_refiner *r, const struct lod_doi *doi, const struct lod_refine_limits *limits,
                               const struct lod_progress *progress, struct lod_refine_stats *stats) {
  struct lod_refine_stats unwanted;
  struct run run = {.r = r, .doi = doi, .limits = limits, .progress = progress, .stats = stats == NULL ? &unwanted : stats};
  start(&run);
  if (r->failed || (run.scratch = lod_arena_create_child(r->arena)) == NULL)
    return LOD_MEMORY;
  bool heap = has_budget(&run);
  enum lod_status status = run_contacts(&run);
  for (uint32_t f = 0; f < r->base_faces && status == LOD_OK; f++) {
    if (!consider_leaves(&run, f, heap))
      status = LOD_MEMORY;
    if (f % 4096 == 0 && lod_progress_cancelled(progress))
      status = LOD_CANCELLED;
  }
  if (status == LOD_OK)
    status = heap ? run_heap(&run) : run_queue(&run);
  lod_arena_destroy(run.scratch);
  return r->failed ? LOD_MEMORY : status;
}

/* ---- some a frame ---- */

struct frame {
  struct wish *splits, *merges; /* most wanted first; least wanted last */
  uint32_t split_count, merge_count;
};

/* Leaves that want to be split, and faces whose children could go. */
static void survey(struct run *run, uint32_t f, struct frame *frame, uint32_t max) {
  struct lod_refiner *r = run->r;
  const struct face *face = &r->faces[f];
  bool leaf = !face->split, last = !leaf;
  for (uint32_t k = 0; k < 4 && !leaf; k++)
    if (r->faces[face->child + k].split)
      last = false;
  if (leaf ? face->level < run->steps : last) {
    struct wish wish = {lod_doi_value(r, run->doi, run->limits, f), refine_key(&r->faces[f]), f};
    run->stats->evaluated++;
    if (last && r->faces[f].level >= run->steps) /* steps became fewer */
      wish.value = -1;
    if (leaf && wish.value > 1 && frame->split_count < max)
      frame->splits[frame->split_count++] = wish;
    if (last && frame->merge_count < max)
      frame->merges[frame->merge_count++] = wish;
  }
  for (uint32_t k = 0; k < 4 && !leaf; k++)
    survey(run, r->faces[f].child + k, frame, max);
}

/* The least wanted face that can be merged and is wanted less than `bar`; false when there is none. */
static bool make_room(struct run *run, struct frame *frame, double bar) {
  while (frame->merge_count != 0) {
    struct wish *least = &frame->merges[frame->merge_count - 1];
    if (!(least->value < bar))
      return false;
    frame->merge_count--;
    if (lod_refiner_merge(run->r, least->face)) {
      run->stats->merges++;
      return true;
    }
  }
  return false;
}

static bool spent(const struct run *run) {
  return run->limits->max_operations != 0 && run->stats->splits + run->stats->merges >= run->limits->max_operations;
}

static void work(struct run *run, struct frame *frame) {
  double low = run->limits->hysteresis;
  while (!spent(run) && make_room(run, frame, over(run) ? INFINITY : low))
    ;
  uint32_t refused = 0;
  for (uint32_t i = 0; i < frame->split_count && !spent(run) && refused < PATIENCE; i++) {
    const struct wish *wish = &frame->splits[i];
    if (run->r->faces[wish->face].split || !run->r->faces[wish->face].drawn)
      continue;
    while (!split_within(run, wish->face)) {
      if (run->r->failed || spent(run) || !has_budget(run) || !make_room(run, frame, fmin(wish->value * low, 1e300))) {
        refused++;
        break;
      }
    }
  }
}

enum lod_status lod_refine_update(struct lod_refiner *r, const struct lod_doi *doi, const struct lod_refine_limits *limits,
                                  struct lod_refine_stats *stats) {
  struct lod_refine_stats unwanted;
  struct run run = {.r = r, .doi = doi, .limits = limits, .stats = stats == NULL ? &unwanted : stats};
  struct frame frame = {0};
  start(&run);
  if (r->failed || (run.scratch = lod_arena_create_child(r->arena)) == NULL)
    return LOD_MEMORY;
  uint32_t most = r->drawn_triangles + 1; /* leaves, and fewer parents than those */
  frame.splits = LOD_NEW(run.scratch, most, struct wish);
  frame.merges = LOD_NEW(run.scratch, most, struct wish);
  if (frame.splits == NULL || frame.merges == NULL) {
    lod_arena_destroy(run.scratch);
    return LOD_MEMORY;
  }
  for (uint32_t f = 0; f < r->base_faces && !r->failed; f++)
    survey(&run, f, &frame, most);
  qsort(frame.splits, frame.split_count, sizeof *frame.splits, compare_wishes);
  qsort(frame.merges, frame.merge_count, sizeof *frame.merges, compare_wishes);
  if (!r->failed)
    work(&run, &frame);
  run.stats->settled = run.stats->splits + run.stats->merges == 0;
  lod_arena_destroy(run.scratch);
  return r->failed ? LOD_MEMORY : LOD_OK;
}
