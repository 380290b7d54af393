/* Two heaps of steps, kept up to date as levels change: the best one up, the worst one to take back. A step leads from one level of an
 * object to the next on the upper convex hull of its (cost, benefit) points, along which value falls, so that no good step waits behind
 * a bad one. It ends: a step is taken back only for one of more value, and one that found no room is not tried again. */
#include "core/level/schedule.h"

#include <assert.h>
#include <math.h>
#include <string.h>

struct object {
  uint32_t first, count; /* its hull: levels in hulls[first ...] */
  uint32_t at;           /* place in the hull */
  uint32_t was;          /* place in the hull of last frame's level, or UINT32_MAX */
  bool stuck;            /* its step up found no room */
};

struct heap {
  uint32_t *objects; /* heap order */
  uint32_t *place;   /* object -> where it is in objects; UINT32_MAX = not in the heap */
  double *value;     /* by object */
  uint32_t count;
  bool up; /* steps up, largest value first; else steps to take back, smallest first */
};

struct schedule {
  const struct lod_schedule_object *in;
  const struct lod_schedule_settings *settings;
  struct object *objects;
  uint32_t *hulls;
  uint64_t cost;
};

struct lod_schedule_settings lod_schedule_defaults(void) {
  return (struct lod_schedule_settings){.cost = LOD_SCHEDULE_TRIANGLES, .budget = 1000000, .enough_px = 0.5, .hysteresis = 0.25};
}

double lod_schedule_benefit(const struct lod_schedule_object *object, uint32_t level) {
  double px = lod_screen_error_px(object->levels[level].error, &object->view);
  return isfinite(px) ? object->importance / (px + 1) : 0;
}

static uint64_t level_cost(const struct schedule *s, uint32_t object, uint32_t level) {
  const struct lod_level_facts *facts = &s->in[object].levels[level];
  return s->settings->cost == LOD_SCHEDULE_BYTES ? facts->bytes : facts->triangles;
}

static uint32_t level_at(const struct schedule *s, uint32_t object, uint32_t place) {
  return s->hulls[s->objects[object].first + place];
}

/* Benefit a unit of cost of the step from place to place + 1; free steps are worth everything. */
static double step_value(const struct schedule *s, uint32_t object, uint32_t place) {
  uint32_t from = level_at(s, object, place), to = level_at(s, object, place + 1);
  double gain = lod_schedule_benefit(&s->in[object], to) - lod_schedule_benefit(&s->in[object], from);
  double cost = (double)level_cost(s, object, to) - (double)level_cost(s, object, from);
  double value = cost > 0 ? gain / cost : INFINITY;
  /* Above last frame's level a step counts for less; what was drawn keeps its full value. */
  bool above = s->objects[object].was != UINT32_MAX && place >= s->objects[object].was;
  return above ? value / (1 + s->settings->hysteresis) : value;
}

/* Levels worth stepping through: up to the first that is good enough, on the upper hull of benefit over cost. */
static void make_hull(struct schedule *s, uint32_t index, uint32_t first, uint32_t was) {
  const struct lod_schedule_object *in = &s->in[index];
  struct object *object = &s->objects[index];
  uint32_t *hull = s->hulls + first, count = 0, last = in->level_count - 1;
  for (uint32_t level = 0; level <= last; level++) {
    double benefit = lod_schedule_benefit(in, level);
    if (count > 0 && !(benefit > lod_schedule_benefit(in, hull[count - 1])))
      continue;
    while (count >= 2) {
      uint32_t a = hull[count - 2], b = hull[count - 1];
      double ab = (lod_schedule_benefit(in, b) - lod_schedule_benefit(in, a)) *
                  ((double)level_cost(s, index, level) - (double)level_cost(s, index, b));
      double bc = (benefit - lod_schedule_benefit(in, b)) * ((double)level_cost(s, index, b) - (double)level_cost(s, index, a));
      if (ab >= bc)
        break;
      count--;
    }
    hull[count++] = level;
    if (lod_screen_error_px(in->levels[level].error, &in->view) <= s->settings->enough_px)
      break;
  }
  *object = (struct object){first, count, 0, UINT32_MAX, false};
  if (was == UINT32_MAX)
    return;
  for (uint32_t i = 0; i < count && hull[i] <= was; i++)
    object->at = object->was = i;
}

static bool before(const struct heap *heap, uint32_t a, uint32_t b) {
  double va = heap->value[a], vb = heap->value[b];
  return va == vb ? a < b : heap->up ? va > vb : va < vb;
}

static void put(struct heap *heap, uint32_t place, uint32_t object) {
  heap->objects[place] = object;
  heap->place[object] = place;
}

/* Moves an object to where its value belongs, from `place` on. */
static void settle(struct heap *heap, uint32_t place, uint32_t object) {
  for (; place > 0 && before(heap, object, heap->objects[(place - 1) / 2]); place = (place - 1) / 2)
    put(heap, place, heap->objects[(place - 1) / 2]);
  for (uint32_t child; (child = 2 * place + 1) < heap->count; place = child) {
    if (child + 1 < heap->count && before(heap, heap->objects[child + 1], heap->objects[child]))
      child++;
    if (!before(heap, heap->objects[child], object))
      break;
    put(heap, place, heap->objects[child]);
  }
  put(heap, place, object);
}

static void leave(struct heap *heap, uint32_t object) {
  uint32_t place = heap->place[object], last = heap->objects[--heap->count];
  heap->place[object] = UINT32_MAX;
  if (last != object)
    settle(heap, place, last);
}

/* The object's level has changed, or it is new: enters, leaves or moves. */
static void renew(const struct schedule *s, struct heap *heap, uint32_t i) {
  const struct object *object = &s->objects[i];
  bool wanted = heap->up ? object->at + 1 < object->count && !object->stuck : object->at > 0;
  if (!wanted) {
    if (heap->place[i] != UINT32_MAX)
      leave(heap, i);
    return;
  }
  heap->value[i] = step_value(s, i, heap->up ? object->at : object->at - 1);
  settle(heap, heap->place[i] != UINT32_MAX ? heap->place[i] : heap->count++, i);
}

static uint64_t step_cost(const struct schedule *s, uint32_t object, uint32_t place) {
  return level_cost(s, object, level_at(s, object, place + 1)) - level_cost(s, object, level_at(s, object, place));
}

static void step(struct schedule *s, struct heap *up, struct heap *down, uint32_t i, bool upwards) {
  if (upwards)
    s->cost += step_cost(s, i, s->objects[i].at++);
  else
    s->cost -= step_cost(s, i, --s->objects[i].at);
  renew(s, up, i);
  renew(s, down, i);
}

static void improve(struct schedule *s, struct heap *up, struct heap *down) {
  while (s->cost > s->settings->budget && down->count > 0)
    step(s, up, down, down->objects[0], false);
  while (up->count > 0) {
    uint32_t i = up->objects[0];
    if (s->cost + step_cost(s, i, s->objects[i].at) <= s->settings->budget) {
      step(s, up, down, i, true);
    } else if (down->count > 0 && down->objects[0] != i && down->value[down->objects[0]] < up->value[i]) {
      step(s, up, down, down->objects[0], false);
    } else {
      s->objects[i].stuck = true;
      renew(s, up, i);
    }
  }
}

static enum lod_status make_heap(struct heap *heap, uint32_t object_count, bool up, struct lod_arena *scratch) {
  *heap = (struct heap){.objects = LOD_NEW(scratch, object_count, uint32_t),
                        .place = LOD_NEW(scratch, object_count, uint32_t),
                        .value = LOD_NEW(scratch, object_count, double),
                        .up = up};
  if (heap->objects == NULL || heap->place == NULL || heap->value == NULL)
    return LOD_MEMORY;
  memset(heap->place, 0xff, object_count * sizeof *heap->place);
  return LOD_OK;
}

static enum lod_status choose(struct schedule *s, uint32_t object_count, struct lod_arena *scratch, uint32_t *chosen) {
  size_t levels = 0;
  for (uint32_t i = 0; i < object_count; i++)
    levels += s->in[i].level_count;
  s->objects = LOD_NEW(scratch, object_count, struct object);
  s->hulls = LOD_NEW(scratch, levels, uint32_t);
  struct heap up, down;
  LOD_TRY(make_heap(&up, object_count, true, scratch));
  LOD_TRY(make_heap(&down, object_count, false, scratch));
  if (s->objects == NULL || s->hulls == NULL)
    return LOD_MEMORY;
  uint32_t first = 0;
  for (uint32_t i = 0; i < object_count; first += s->in[i++].level_count) {
    assert(s->in[i].level_count > 0 && s->in[i].importance >= 0);
    make_hull(s, i, first, chosen[i]);
    s->cost += level_cost(s, i, level_at(s, i, s->objects[i].at));
  }
  for (uint32_t i = 0; i < object_count; i++) {
    renew(s, &up, i);
    renew(s, &down, i);
  }
  improve(s, &up, &down);
  for (uint32_t i = 0; i < object_count; i++)
    chosen[i] = level_at(s, i, s->objects[i].at);
  return LOD_OK;
}

enum lod_status lod_schedule_choose(const struct lod_schedule_object *objects, uint32_t object_count,
                                    const struct lod_schedule_settings *settings, struct lod_arena *arena, uint32_t *chosen, uint64_t *cost,
                                    double *benefit) {
  struct schedule s = {.in = objects, .settings = settings};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch != NULL ? choose(&s, object_count, scratch, chosen) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  if (status != LOD_OK)
    return status;
  if (cost != NULL)
    *cost = s.cost;
  if (benefit != NULL) {
    *benefit = 0;
    for (uint32_t i = 0; i < object_count; i++)
      *benefit += lod_schedule_benefit(&objects[i], chosen[i]);
  }
  return LOD_OK;
}
