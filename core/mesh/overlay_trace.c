/* Coarse edges as shortest paths over the finer surface that cross no other path.
 *
 * A search (A*) goes from gap to gap of finer edges (overlay_private.h), each crossed where the plane through the coarse edge cuts it. A
 * path that is blocked, or has to go a long way round, looks for the cheapest set of paths in its way, takes their place, and these are
 * traced anew; each time a path gives way it becomes harder to move (after McMurchie, Ebeling. PathFinder. 1995). */
#include <stdlib.h>
#include <string.h>

#include "core/mesh/overlay_private.h"

enum { MAX_STATES = 6000, MAX_RIPS = 12 };
#define DETOUR 2.0    /* a path this many times as long as its edge first asks others to give way */
#define LONG_WAY 10.0 /* the longest path that crosses none */
#define PRICE 0.5     /* of crossing a path, in lengths of the edge ... */
#define GROWTH 0.5    /* ... and how much more each time that it gave way */

struct state {
  double cost;
  struct lod_vec3 at;
  double share;
  uint32_t half_edge, gap; /* about to be crossed; LOD_NONE: arrived, gap = slot of the sector there */
  uint32_t from;           /* state before; of a start: LOD_NONE */
  uint32_t other;          /* next state of the same half-edge */
  uint32_t start;          /* slot of the sector that the path left from */
};

struct entry {
  double key;
  uint32_t state;
};

struct search {
  struct overlay_work *w;
  uint32_t path, a, b; /* finer vertices */
  struct lod_vec3 pa, pb, across;
  double length, limit, penalty; /* penalty > 0: paths may be crossed */
  struct state *states;
  uint32_t state_count, state_capacity;
  struct entry *heap;
  uint32_t heap_count, heap_capacity;
  uint32_t *stamp, *head; /* by finer half-edge: the search that last saw it, its first state */
  uint32_t number;
  struct overlay_sector from, to;
  uint32_t *ripped;
  uint32_t ripped_count, ripped_capacity;
};

/* ---- heap ---- */

static bool before(const struct entry *a, const struct entry *b) {
  return a->key != b->key ? a->key < b->key : a->state < b->state;
}

static enum lod_status push_heap(struct search *s, double key, uint32_t state) {
  if (s->heap_count == s->heap_capacity) {
    uint32_t capacity = s->heap_capacity == 0 ? 256 : 2 * s->heap_capacity;
    struct entry *larger;
    OVERLAY_TRY_NEW(larger, s->w->arena, capacity);
    if (s->heap_count != 0)
      memcpy(larger, s->heap, s->heap_count * sizeof *larger);
    s->heap = larger;
    s->heap_capacity = capacity;
  }
  struct entry x = {key, state};
  uint32_t i = s->heap_count++;
  for (; i > 0 && before(&x, &s->heap[(i - 1) / 2]); i = (i - 1) / 2)
    s->heap[i] = s->heap[(i - 1) / 2];
  s->heap[i] = x;
  return LOD_OK;
}

static uint32_t pop_heap(struct search *s) {
  uint32_t top = s->heap[0].state, i = 0;
  struct entry x = s->heap[--s->heap_count];
  for (uint32_t child; (child = 2 * i + 1) < s->heap_count; i = child) {
    if (child + 1 < s->heap_count && before(&s->heap[child + 1], &s->heap[child]))
      child++;
    if (!before(&s->heap[child], &x))
      break;
    s->heap[i] = s->heap[child];
  }
  s->heap[i] = x;
  return top;
}

/* ---- states ---- */

/* Where the plane through the coarse edge cuts a finer edge, or the nearer end. */
static double cut_share(const struct search *s, struct lod_vec3 p, struct lod_vec3 q) {
  double dp = lod_vec3_dot(lod_vec3_subtract(p, s->pa), s->across), dq = lod_vec3_dot(lod_vec3_subtract(q, s->pa), s->across);
  double share = 0.5;
  if ((dp < 0) != (dq < 0))
    share = dp / (dp - dq);
  else if (dp != dq)
    share = fabs(dp) < fabs(dq) ? 0 : 1;
  return share < 0.03 ? 0.03 : share > 0.97 ? 0.97 : share;
}

static enum lod_status new_state(struct search *s, const struct state *state) {
  if (s->state_count == s->state_capacity) {
    uint32_t capacity = s->state_capacity == 0 ? 256 : 2 * s->state_capacity;
    struct state *larger;
    OVERLAY_TRY_NEW(larger, s->w->arena, capacity);
    if (s->state_count != 0)
      memcpy(larger, s->states, s->state_count * sizeof *larger);
    s->states = larger;
    s->state_capacity = capacity;
  }
  double ahead = state->half_edge == LOD_NONE ? 0 : lod_vec3_distance(state->at, s->pb);
  if (!(state->cost + ahead <= s->limit))
    return LOD_OK;
  s->states[s->state_count++] = *state;
  return push_heap(s, state->cost + ahead, s->state_count - 1);
}

static bool touches(const struct search *s, uint32_t h) {
  uint32_t u = lod_half_edge_start(s->w->fine, h), v = lod_half_edge_end(s->w->fine, h);
  return u == s->a || v == s->a || u == s->b || v == s->b;
}

/* Has the path that leads to `from` crossed the edge of h before, elsewhere than at `from` itself? */
static bool crossed(const struct search *s, uint32_t from, uint32_t h) {
  uint32_t twin = s->w->f.twin[h];
  for (; from != LOD_NONE; from = s->states[from].from)
    if (s->states[from].half_edge == h || s->states[from].half_edge == twin)
      return true;
  return false;
}

static double price(const struct search *s, uint32_t path) {
  return s->penalty * (1 + GROWTH * s->w->paths[path].rips);
}

/* Comes to gap `gap` of half-edge h, from inside its triangle; same: only moved to another gap of it, past other paths. */
static enum lod_status reach(struct search *s, uint32_t from, uint32_t start, uint32_t h, uint32_t gap, double more, bool same) {
  struct overlay_work *w = s->w;
  uint32_t along = same ? LOD_NONE : w->along[overlay_canonical(w->f.twin, h)];
  if (!same && (w->f.twin[h] == LOD_NONE || (along != LOD_NONE && !(s->penalty > 0)) || touches(s, h) || crossed(s, from, h)))
    return LOD_OK;
  more += along != LOD_NONE ? price(s, along) : 0;
  struct state state = {.half_edge = h, .gap = gap, .from = from, .start = start};
  double base = from == LOD_NONE ? 0 : s->states[from].cost;
  if (same) {
    state.at = s->states[from].at;
    state.share = s->states[from].share;
    state.cost = base + more;
  } else {
    struct lod_vec3 p = overlay_at(w->fine, lod_half_edge_start(w->fine, h)), q = overlay_at(w->fine, lod_half_edge_end(w->fine, h));
    state.share = cut_share(s, p, q);
    state.at = lod_vec3_add_scaled(p, lod_vec3_subtract(q, p), state.share);
    state.cost = base + more + lod_vec3_distance(from == LOD_NONE ? s->pa : s->states[from].at, state.at);
  }
  if (s->stamp[h] != s->number) {
    s->stamp[h] = s->number;
    s->head[h] = LOD_NONE;
  }
  for (uint32_t i = s->head[h]; i != LOD_NONE; i = s->states[i].other)
    if (s->states[i].gap == gap && s->states[i].cost <= state.cost)
      return LOD_OK;
  state.other = s->head[h];
  uint32_t number = s->state_count;
  LOD_TRY(new_state(s, &state));
  if (s->state_count > number)
    s->head[h] = number;
  return LOD_OK;
}

/* ---- crossing other paths ---- */

/* What it costs to come to a corner that arcs and spokes of others cut off. */
static double price_of_corner(const struct search *s, uint32_t corner) {
  struct overlay_pattern p = overlay_pattern_of(s->w, corner / 3);
  double sum = 0;
  for (uint32_t i = 0; i < p.arcs[corner % 3]; i++)
    sum += price(s, s->w->crossings[overlay_crossing_at(s->w, corner, i)].path);
  if (p.apex != 3 && p.apex != corner % 3) {
    uint32_t side = 3 * (corner / 3) + (p.apex + 1) % 3;
    for (uint32_t i = 0; i < p.spokes; i++)
      sum += price(s, s->w->crossings[overlay_crossing_at(s->w, side, overlay_slot_gap(&p, p.apex, i))].path);
  }
  return sum;
}

static enum lod_status note_ripped(struct search *s, uint32_t path) {
  for (uint32_t i = 0; i < s->ripped_count; i++)
    if (s->ripped[i] == path)
      return LOD_OK;
  if (s->ripped_count == s->ripped_capacity) {
    uint32_t capacity = s->ripped_capacity == 0 ? 64 : 2 * s->ripped_capacity, *larger;
    OVERLAY_TRY_NEW(larger, s->w->arena, capacity);
    if (s->ripped_count != 0)
      memcpy(larger, s->ripped, s->ripped_count * sizeof *larger);
    s->ripped = larger;
    s->ripped_capacity = capacity;
  }
  s->ripped[s->ripped_count++] = path;
  return LOD_OK;
}

static enum lod_status note_corner(struct search *s, uint32_t corner) {
  struct overlay_pattern p = overlay_pattern_of(s->w, corner / 3);
  for (uint32_t i = 0; i < p.arcs[corner % 3]; i++)
    LOD_TRY(note_ripped(s, s->w->crossings[overlay_crossing_at(s->w, corner, i)].path));
  if (p.apex != 3 && p.apex != corner % 3) {
    uint32_t side = 3 * (corner / 3) + (p.apex + 1) % 3;
    for (uint32_t i = 0; i < p.spokes; i++)
      LOD_TRY(note_ripped(s, s->w->crossings[overlay_crossing_at(s->w, side, overlay_slot_gap(&p, p.apex, i))].path));
  }
  return LOD_OK;
}

/* The paths that the found one crosses. */
static enum lod_status note_all(struct search *s, uint32_t goal) {
  s->ripped_count = 0;
  LOD_TRY(note_corner(s, s->to.slots[s->states[goal].gap].corner));
  LOD_TRY(note_corner(s, s->from.slots[s->states[goal].start].corner));
  for (uint32_t i = s->states[goal].from; i != LOD_NONE; i = s->states[i].from) {
    uint32_t j = s->states[i].from, along = s->w->along[overlay_canonical(s->w->f.twin, s->states[i].half_edge)];
    if (along != LOD_NONE)
      LOD_TRY(note_ripped(s, along));
    if (j == LOD_NONE || s->states[j].half_edge != s->states[i].half_edge)
      continue;
    uint32_t gap = s->states[i].gap > s->states[j].gap ? s->states[j].gap : s->states[i].gap;
    LOD_TRY(note_ripped(s, s->w->crossings[overlay_crossing_at(s->w, s->states[i].half_edge, gap)].path));
  }
  return LOD_OK;
}

/* ---- the search ---- */

static enum lod_status arrive(struct search *s, uint32_t from, uint32_t corner, uint32_t slot) {
  for (uint32_t i = 0; i < s->to.count; i++) {
    const struct overlay_slot *at = &s->to.slots[i];
    if (at->corner != corner || at->slot != slot)
      continue;
    const struct state *last = &s->states[from];
    struct state state = {.half_edge = LOD_NONE, .gap = i, .from = from, .start = last->start, .at = s->pb};
    state.cost = last->cost + lod_vec3_distance(last->at, s->pb);
    if (s->penalty > 0)
      state.cost += price_of_corner(s, corner);
    LOD_TRY(new_state(s, &state));
  }
  return LOD_OK;
}

/* Crosses the gap of state number `from` and goes wherever the region behind it leads. */
static enum lod_status expand(struct search *s, uint32_t from) {
  struct overlay_work *w = s->w;
  const struct state here = s->states[from];
  uint32_t count = overlay_count(w, here.half_edge);
  if (s->penalty > 0) {
    if (here.gap > 0)
      LOD_TRY(reach(s, from, here.start, here.half_edge, here.gap - 1,
                    price(s, w->crossings[overlay_crossing_at(w, here.half_edge, here.gap - 1)].path), true));
    if (here.gap < count)
      LOD_TRY(reach(s, from, here.start, here.half_edge, here.gap + 1,
                    price(s, w->crossings[overlay_crossing_at(w, here.half_edge, here.gap)].path), true));
  }
  uint32_t u = w->f.twin[here.half_edge], i = u % 3, j = (i + 1) % 3, k = (i + 2) % 3, base = 3 * (u / 3), gap = count - here.gap;
  uint32_t onto_j = base + j, onto_k = base + k; /* half-edges from j to k, from k to i */
  struct overlay_pattern p = overlay_pattern_of(w, u / 3);
  if (gap < p.arcs[i])
    return reach(s, from, here.start, onto_k, p.sides[k] - gap, 0, false);
  if (count - gap < p.arcs[j])
    return reach(s, from, here.start, onto_j, count - gap, 0, false);
  uint32_t slot = gap - p.arcs[i], last = p.apex == k ? p.spokes : 0;
  bool behind_i = p.apex == i, behind_j = p.apex == j; /* spokes of these corners lie between here and corner k */
  if (w->match[w->fine->triangles[u / 3][k]] != LOD_NONE && w->fine->triangles[u / 3][k] == s->b) {
    if (p.arcs[k] == 0 && !behind_i && !behind_j)
      LOD_TRY(arrive(s, from, base + k, slot));
    else if (s->penalty > 0)
      LOD_TRY(arrive(s, from, base + k, 0));
  }
  if (slot == 0 && !behind_i)
    LOD_TRY(reach(s, from, here.start, onto_k, p.sides[k] - p.arcs[i], 0, false));
  if (slot == last && !behind_j)
    LOD_TRY(reach(s, from, here.start, onto_j, p.arcs[j], 0, false));
  return LOD_OK;
}

static enum lod_status leave(struct search *s) {
  struct overlay_work *w = s->w;
  for (uint32_t i = 0; i < s->from.count; i++) {
    const struct overlay_slot *slot = &s->from.slots[i];
    uint32_t corner = slot->corner;
    struct overlay_pattern p = overlay_pattern_of(w, corner / 3);
    double more = s->penalty > 0 ? price_of_corner(s, corner) : 0;
    LOD_TRY(reach(s, LOD_NONE, i, 3 * (corner / 3) + (corner + 1) % 3, overlay_slot_gap(&p, corner % 3, slot->slot), more, false));
  }
  return LOD_OK;
}

/* The cheapest way of at most `limit`; penalty: for a path crossed, 0 = none may be. *goal: state, or LOD_NONE. */
static enum lod_status run(struct search *s, double limit, double penalty, uint32_t *goal) {
  struct overlay_work *w = s->w;
  *goal = LOD_NONE;
  s->number++;
  w->tries++;
  s->state_count = s->heap_count = 0;
  s->limit = limit;
  s->penalty = penalty;
  LOD_TRY(overlay_find_sector(w, s->path, 0, penalty > 0 ? OVERLAY_WAYS_ALL : OVERLAY_WAYS_ACROSS, &s->from));
  LOD_TRY(overlay_find_sector(w, s->path, 1, penalty > 0 ? OVERLAY_WAYS_ALL : OVERLAY_WAYS_ACROSS, &s->to));
  LOD_TRY(leave(s));
  while (s->heap_count > 0 && s->state_count < MAX_STATES) {
    uint32_t at = pop_heap(s);
    if (s->states[at].half_edge == LOD_NONE) {
      *goal = at;
      return LOD_OK;
    }
    LOD_TRY(expand(s, at));
  }
  return LOD_OK;
}

static enum lod_status place(struct search *s, uint32_t goal) {
  struct overlay_work *w = s->w;
  struct overlay_path *path = &w->paths[s->path];
  uint32_t onward = LOD_NONE, count = 0;
  for (uint32_t i = s->states[goal].from; i != LOD_NONE; i = s->states[i].from) {
    uint32_t x;
    LOD_TRY(overlay_cross(w, s->path, s->states[i].half_edge, s->states[i].gap, s->states[i].share, &x));
    w->crossings[x].onward = onward;
    onward = x;
    count++;
  }
  path->state = PATH_CROSSING;
  path->first = onward;
  path->count = count;
  path->corner[0] = s->from.slots[s->states[goal].start].corner;
  path->corner[1] = s->to.slots[s->states[goal].gap].corner;
  overlay_join_fans(w, s->path, path->corner[0]);
  overlay_join_fans(w, w->c.twin[s->path], path->corner[1]);
  return LOD_OK;
}

static void aim(struct search *s, uint32_t p) {
  struct overlay_work *w = s->w;
  struct lod_vec3 normal = {0}, along;
  s->path = p;
  s->a = w->parents[overlay_path_start(w, p)];
  s->b = w->parents[overlay_path_end(w, p)];
  s->pa = overlay_at(w->fine, s->a);
  s->pb = overlay_at(w->fine, s->b);
  along = lod_vec3_subtract(s->pb, s->pa);
  s->length = lod_vec3_length(along);
  const uint32_t sides[2] = {p, w->c.twin[p]};
  for (int i = 0; i < 2; i++) {
    const uint32_t *v = w->coarse->triangles[sides[i] / 3];
    struct lod_vec3 o = overlay_at(w->coarse, v[0]);
    normal = lod_vec3_add(normal, lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(overlay_at(w->coarse, v[1]), o),
                                                                    lod_vec3_subtract(overlay_at(w->coarse, v[2]), o))));
  }
  s->across = lod_vec3_cross(normal, along);
}

static void rip_noted(struct search *s) {
  struct overlay_work *w = s->w;
  for (uint32_t i = 0; i < s->ripped_count; i++) {
    overlay_rip(w, s->ripped[i]);
    if (w->paths[s->ripped[i]].rips < UINT8_MAX)
      w->paths[s->ripped[i]].rips++;
  }
}

/* Neighbours on the finer surface: the edge between them, when what crosses it has given way. */
static enum lod_status clear_edge(struct search *s, bool *placed) {
  struct overlay_work *w = s->w;
  *placed = false;
  for (uint32_t i = w->f.vertex_begin[s->a]; i < w->f.vertex_begin[s->a + 1] && !*placed; i++) {
    uint32_t h = w->f.vertex_corners[i], count = w->f.twin[h] == LOD_NONE ? 0 : overlay_count(w, h);
    if (count == 0 || lod_half_edge_end(w->fine, h) != s->b)
      continue;
    for (uint32_t k = 0; k < count; k++)
      LOD_TRY(note_ripped(s, w->crossings[overlay_crossing_at(w, h, k)].path));
    rip_noted(s);
    LOD_TRY(overlay_retake_edge(w, s->path, &s->from, placed));
    break; /* what has given way is traced again, wherever this leads */
  }
  return LOD_OK;
}

/* Traces path p, or moves what is in its way: those paths are in s->ripped afterwards. */
static enum lod_status trace(struct search *s, uint32_t p, double unit) {
  struct overlay_work *w = s->w;
  uint32_t goal;
  bool placed = false;
  s->ripped_count = 0;
  if (w->paths[p].rips > 0)
    LOD_TRY(overlay_retake_edge(w, p, &s->from, &placed));
  if (placed)
    return LOD_OK;
  aim(s, p);
  double length = s->length > unit ? s->length : unit;
  LOD_TRY(run(s, DETOUR * length, 0, &goal));
  if (goal == LOD_NONE && w->paths[p].rips < MAX_RIPS) {
    LOD_TRY(run(s, INFINITY, PRICE * length, &goal));
    if (goal != LOD_NONE) {
      LOD_TRY(note_all(s, goal));
      rip_noted(s);
    } else {
      w->paths[p].rips++;
      LOD_TRY(clear_edge(s, &placed));
      if (placed)
        return LOD_OK;
    }
  }
  if (goal == LOD_NONE || s->ripped_count > 0)
    LOD_TRY(run(s, s->ripped_count > 0 ? INFINITY : LONG_WAY * length, 0, &goal));
  return goal == LOD_NONE ? LOD_OK : place(s, goal);
}

struct job {
  double length;
  uint32_t path;
};

static int compare_jobs(const void *left, const void *right) {
  const struct job *a = left, *b = right;
  return a->length != b->length ? (a->length < b->length ? -1 : 1) : (a->path > b->path) - (a->path < b->path);
}

/* Interior edges that have no path yet, short ones first. */
static enum lod_status list_jobs(const struct overlay_work *w, struct job **jobs, uint32_t *count, double *mean) {
  OVERLAY_TRY_NEW(*jobs, w->arena, (size_t)3 * w->coarse->triangle_count / 2 + 1);
  *count = 0;
  *mean = 0;
  for (uint32_t p = 0; p < 3 * w->coarse->triangle_count; p++) {
    uint32_t a = lod_half_edge_start(w->coarse, p), b = lod_half_edge_end(w->coarse, p);
    if (w->c.twin[p] == LOD_NONE || w->c.twin[p] < p || w->paths[p].state != PATH_NONE || w->parents[a] == LOD_NONE ||
        w->parents[b] == LOD_NONE)
      continue;
    double length = lod_vec3_distance(overlay_at(w->fine, w->parents[a]), overlay_at(w->fine, w->parents[b]));
    *mean += length;
    (*jobs)[(*count)++] = (struct job){length, p};
  }
  if (*count > 0)
    *mean /= *count;
  qsort(*jobs, *count, sizeof **jobs, compare_jobs);
  return LOD_OK;
}

enum lod_status overlay_trace(struct overlay_work *w) {
  struct search s = {.w = w};
  struct job *jobs;
  uint32_t count, half_edges = 3 * w->fine->triangle_count;
  double mean;
  LOD_TRY(list_jobs(w, &jobs, &count, &mean));
  OVERLAY_TRY_ZERO(s.stamp, w->arena, half_edges);
  OVERLAY_TRY_NEW(s.head, w->arena, half_edges);
  /* A stack of what had to give way, traced before what comes next. */
  uint32_t *stack, depth = 0, capacity = 256;
  OVERLAY_TRY_NEW(stack, w->arena, capacity);
  for (uint32_t i = 0; i < count; i++) {
    stack[depth++] = jobs[i].path;
    while (depth > 0) {
      LOD_TRY(trace(&s, stack[--depth], 1e-3 * mean));
      if (depth + s.ripped_count + 1 > capacity) {
        uint32_t *larger;
        capacity = 2 * (depth + s.ripped_count + 1);
        OVERLAY_TRY_NEW(larger, w->arena, capacity);
        memcpy(larger, stack, depth * sizeof *larger);
        stack = larger;
      }
      for (uint32_t k = s.ripped_count; k-- > 0;)
        stack[depth++] = s.ripped[k];
    }
  }
  return LOD_OK;
}
