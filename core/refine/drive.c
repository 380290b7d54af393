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

/* Faces that wait to be split, in lists by urgency: interests within a quarter of a doubling are as urgent as each other, so that a list is
 * walked in the order of the surface, which is that of memory. */
enum { RANKS_A_DOUBLING = 4, RANKS = 16 * RANKS_A_DOUBLING + 1 };
struct waiting {
  uint32_t face, next;
};

struct run {
  struct lod_refiner *r;
  const struct lod_doi *doi;
  const struct lod_refine_limits *limits;
  const struct lod_progress *progress;
  struct lod_refine_stats *stats;
  struct lod_arena *scratch;
  struct waiting *list; /* of all ranks; without a budget a queue */
  uint32_t count, room;
  uint32_t first[RANKS], last[RANKS]; /* LOD_NONE: nothing of that rank */
  uint32_t steps;
};

static bool add_room(struct run *run, uint32_t more) {
  if (run->room - run->count >= more)
    return true;
  uint64_t room = (uint64_t)run->room * 2 + more + 4096;
  struct waiting *grown = room < UINT32_MAX ? LOD_NEW(run->scratch, room, struct waiting) : NULL;
  if (grown == NULL)
    return false;
  if (run->count != 0)
    memcpy(grown, run->list, run->count * sizeof *grown);
  run->list = grown;
  run->room = (uint32_t)room;
  return true;
}

/* value: above 1. */
static uint32_t rank_of(double value) {
  uint64_t bits, one = UINT64_C(1023) * RANKS_A_DOUBLING;
  memcpy(&bits, &value, sizeof bits);
  uint64_t rank = (bits >> 50) - one; /* exponent and two bits of the fraction */
  return rank < RANKS ? (uint32_t)rank : RANKS - 1;
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

static bool consider(struct run *run, uint32_t f, bool ranked) {
  if (run->r->faces[f].level >= run->steps)
    return true;
  if (!add_room(run, 1))
    return false;
  if (!ranked) {
    run->list[run->count++].face = f;
    return true;
  }
  double value = lod_doi_value(run->r, run->doi, run->limits, f);
  run->stats->evaluated++;
  if (!(value > 1))
    return true;
  uint32_t rank = rank_of(value), at = run->count++;
  run->list[at] = (struct waiting){f, LOD_NONE};
  if (run->first[rank] == LOD_NONE)
    run->first[rank] = at;
  else
    run->list[run->last[rank]].next = at;
  run->last[rank] = at;
  return true;
}

/* Children of all that the latest split opened. */
static bool consider_journal(struct run *run, bool ranked) {
  struct lod_refiner *r = run->r;
  for (uint32_t i = 0; i < r->journal_count; i++)
    for (uint32_t k = 0; k < 4; k++)
      if (!consider(run, r->faces[r->journal[i]].child + k, ranked))
        return false;
  return true;
}

static bool consider_leaves(struct run *run, uint32_t f, bool ranked) {
  if (!run->r->faces[f].split)
    return consider(run, f, ranked);
  for (uint32_t k = 0; k < 4; k++)
    if (!consider_leaves(run, run->r->faces[f].child + k, ranked))
      return false;
  return true;
}

static enum lod_status run_queue(struct run *run) {
  for (uint32_t at = 0; at < run->count; at++) {
    uint32_t f = run->list[at].face;
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

/* What splitting a face will read, fetched while others are split: stage by stage, as each is found through the one before. */
static void fetch(const struct lod_refiner *r, uint32_t f, int stage) {
  const struct face *face = &r->faces[f];
  if (stage == 0) {
    __builtin_prefetch(face);
    return;
  }
  for (int i = 0; i < 3; i++) {
    const struct edge *edge = &r->edges[face->e[i]];
    if (stage == 1) {
      __builtin_prefetch(edge);
      __builtin_prefetch(&r->shown[face->v[i]]);
      continue;
    }
    if (stage == 3) { /* faces that may have to be split before, so that levels differ by one at most */
      for (int k = 0; k < 2 && edge->up != LOD_NONE; k++)
        if (r->edges[edge->up].f[k] != LOD_NONE)
          __builtin_prefetch(&r->faces[r->edges[edge->up].f[k]]);
      continue;
    }
    if (edge->up != LOD_NONE)
      __builtin_prefetch(&r->edges[edge->up]);
    if (edge->middle != LOD_NONE)
      __builtin_prefetch(&r->shown[edge->middle]);
    for (int k = 0; k < 2; k++)
      if (edge->f[k] != LOD_NONE && edge->f[k] != f)
        __builtin_prefetch(&r->faces[edge->f[k]]);
  }
  if (stage == 2 && face->child != LOD_NONE) {
    __builtin_prefetch(&r->faces[face->child]);
    __builtin_prefetch(&r->faces[face->child + 2]);
  }
}

/* Split one after the other: what is most urgent, all of it, then what is most urgent by then. */
static enum lod_status run_ranks(struct run *run) {
  enum { STAGES = 4, AHEAD = 3 };
  uint32_t refused = 0, steps = 0;
  for (int rank = RANKS; rank-- > 0;) {
    uint32_t at = run->first[rank], ahead[STAGES];
    if (at == LOD_NONE)
      continue;
    run->first[rank] = LOD_NONE;       /* what comes meanwhile is a list of its own */
    for (int k = 0; k < STAGES; k++) { /* stage 0 is farthest ahead */
      ahead[k] = at;
      for (int i = 0; i < AHEAD * (STAGES - k) && ahead[k] != LOD_NONE; i++, ahead[k] = run->list[ahead[k]].next)
        fetch(run->r, run->list[ahead[k]].face, k);
    }
    for (; at != LOD_NONE; at = run->list[at].next) {
      uint32_t f = run->list[at].face;
      for (int k = 0; k < STAGES; k++)
        if (ahead[k] != LOD_NONE) {
          fetch(run->r, run->list[ahead[k]].face, k);
          ahead[k] = run->list[ahead[k]].next;
        }
      if (steps++ % 1024 == 0 && lod_progress_cancelled(run->progress))
        return LOD_CANCELLED;
      if (run->r->faces[f].split)
        continue;
      if (!split_within(run, f)) {
        if (run->r->failed)
          return LOD_MEMORY;
        if (++refused == PATIENCE)
          return LOD_OK;
        continue;
      }
      refused = 0;
      if (!consider_journal(run, true))
        return LOD_MEMORY;
    }
    rank = RANKS; /* more urgent ones may have come */
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
  memset(run->first, 0xff, sizeof run->first);
  run->steps = run->limits->steps < LOD_REFINE_MAX_LEVEL ? run->limits->steps : LOD_REFINE_MAX_LEVEL;
}

enum lod_status lod_refine_run(struct lod_refiner *r, const struct lod_doi *doi, const struct lod_refine_limits *limits,
                               const struct lod_progress *progress, struct lod_refine_stats *stats) {
  struct lod_refine_stats unwanted;
  struct run run = {.r = r, .doi = doi, .limits = limits, .progress = progress, .stats = stats == NULL ? &unwanted : stats};
  start(&run);
  if (r->failed || (run.scratch = lod_arena_create_child(r->arena)) == NULL)
    return LOD_MEMORY;
  bool ranked = has_budget(&run);
  enum lod_status status = run_contacts(&run);
  for (uint32_t f = 0; f < r->base_faces && status == LOD_OK; f++) {
    if (!consider_leaves(&run, f, ranked))
      status = LOD_MEMORY;
    if (f % 4096 == 0 && lod_progress_cancelled(progress))
      status = LOD_CANCELLED;
  }
  if (status == LOD_OK)
    status = ranked ? run_ranks(&run) : run_queue(&run);
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
    struct wish wish = {lod_doi_value(r, run->doi, run->limits, f), refine_key(r, f), f};
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
