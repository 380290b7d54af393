/* Which level of every object to draw, or to fetch, when all of them together have one budget: constant frame rate.
 *
 * Based on: Funkhouser, Sequin. Adaptive Display Algorithm for Interactive Frame Rates During Visualization of Complex Virtual
 * Environments. SIGGRAPH 93 (the scheduler that Low & Tan 1997, section 4, leave room for).
 *
 * benefit of a level = importance * (1 - screen error / (screen error + 1 px)): 1/2 at one pixel, falling to 0; importance is what the
 * caller knows of size on screen, focus and motion. Starting from the levels of the frame before, the scheduler takes the step that gains
 * most benefit a unit of cost as long as the budget lasts, and takes back the one that loses least when it does not: greedy on a
 * multiple-choice knapsack, short of the best by at most the one step that did not fit. Hysteresis: a step up
 * from last frame's level must gain `hysteresis` more, so that small changes of the view do not toggle levels.
 *
 * Pure: no state but what the caller passes; O(n log n) after large changes of the view, O(n) when nothing changes. */
#ifndef LOD_CORE_LEVEL_SCHEDULE_H
#define LOD_CORE_LEVEL_SCHEDULE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/level/screen.h"

struct lod_schedule_object {
  const struct lod_level_facts *levels; /* coarsest first: errors must not rise, costs must not fall; not owned */
  uint32_t level_count;                 /* at least 1 */
  struct lod_view view;                 /* as seen now */
  double importance;                    /* >= 0; 0 = out of sight: takes its coarsest level */
};

enum lod_schedule_cost { LOD_SCHEDULE_TRIANGLES, LOD_SCHEDULE_BYTES };

struct lod_schedule_settings {
  enum lod_schedule_cost cost;
  uint64_t budget;   /* of all objects together; the coarsest levels are taken even if they alone exceed it */
  double enough_px;  /* no finer level once the screen error is at most this; 0.5 */
  double hysteresis; /* a step up must gain this share more than a step that keeps last frame's level, >= 0; 0.25 */
};
struct lod_schedule_settings lod_schedule_defaults(void);

/* chosen: in: the levels of the frame before, or UINT32_MAX for a new object; out: the levels to take. *cost, *benefit (may be NULL): their
 * sums. Scratch from a child of `arena`; fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_schedule_choose(const struct lod_schedule_object *objects, uint32_t object_count,
                                                    const struct lod_schedule_settings *settings, struct lod_arena *arena, uint32_t *chosen,
                                                    uint64_t *cost, double *benefit);

/* What a level is worth: for tests and overlays. */
double lod_schedule_benefit(const struct lod_schedule_object *object, uint32_t level);

#endif
