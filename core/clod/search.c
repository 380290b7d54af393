/* The paper's depth-first search for patterns (Gopi & Manocha 1998, 7). See lod_clod_search. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/clod/internal.h"

enum { DEGREE = 6, DEEPEST = 256 };
enum tag { UNDECIDED, RETAINED, REMOVED };

/* What is to be merged, in the order in which it can be. */
struct merge {
  uint32_t vertex, pair[2]; /* pair LOD_NONE: a star, or a vertex on a line */
};

struct search {
  struct lod_clod *clod;
  const struct lod_clod_search_settings *settings;
  struct lod_clod_search_facts *facts;
  uint8_t *tags;
  struct merge *merges;
  uint32_t merge_count;
  double cosine;
};

/* Edges around a vertex inside a face, counter-clockwise; face i lies between edges i and i + 1. */
struct ring {
  uint32_t count, half[DEGREE], vertex[DEGREE];
  struct lod_vec3 leg[DEGREE];
};

static bool gather(const struct lod_clod *clod, uint32_t v, struct ring *ring) {
  uint32_t start = clod->half[v], at = start;
  ring->count = 0;
  do {
    if (ring->count == DEGREE)
      return false;
    const struct clod_patch *patch = &clod->patches[at / 3];
    uint32_t k = at % 3, side = patch->sides[k];
    ring->half[ring->count] = at;
    ring->vertex[ring->count] = patch->corners[k == 2 ? 0 : k + 1];
    ring->leg[ring->count++] = lod_vec3_normalize(lod_vec3_subtract(clod->edges[side >> 1].inner[side & 1], clod->positions[v]));
    at = clod_across(clod, k == 0 ? at + 2 : at - 1);
  } while (at != LOD_NONE && at != start);
  return at == start && ring->count >= 3;
}

static uint32_t find(const struct ring *ring, uint32_t vertex) {
  for (uint32_t i = 0; i < ring->count; i++)
    if (ring->vertex[i] == vertex)
      return i;
  return LOD_NONE;
}

/* Edge continuity (4.1): the two legs lie on a line, up to the angle. And restricted faces (6.1). */
static bool is_mergeable(const struct search *s, const struct ring *ring, uint32_t i, uint32_t j) {
  uint32_t faces = (j + ring->count - i) % ring->count, others = ring->count - faces;
  return (faces == 2 || faces == 3) && (others == 2 || others == 3) && -lod_vec3_dot(ring->leg[i], ring->leg[j]) >= s->cosine;
}

static bool may_stay(const struct search *s, uint32_t v) {
  return s->tags[v] != REMOVED;
}

/* Whether the faces from edge i to edge j of a ring can be matched without taking anything more out. */
static bool can_match(const struct search *s, const struct ring *ring, uint32_t i, uint32_t j) {
  uint32_t faces = (j + ring->count - i) % ring->count;
  uint32_t c = ring->vertex[(i + 1) % ring->count], d = ring->vertex[(i + 2) % ring->count];
  return faces == 2 ? may_stay(s, c) : may_stay(s, c) || may_stay(s, d);
}

/* Whether v, still undecided, may go over the edges to a and b, `faces` of its faces counter-clockwise from a to b being matched already.
 */
static bool may_go(const struct search *s, uint32_t v, uint32_t a, uint32_t b, uint32_t faces, struct ring *ring) {
  if (s->tags[v] != UNDECIDED || s->clod->removable[v] != 1 || !may_stay(s, a) || !may_stay(s, b) || !gather(s->clod, v, ring))
    return false;
  uint32_t i = find(ring, a), j = find(ring, b);
  return i != LOD_NONE && j != LOD_NONE && (j + ring->count - i) % ring->count == faces && is_mergeable(s, ring, i, j) &&
         can_match(s, ring, j, i);
}

static void retain(struct search *s, uint32_t v) {
  if (s->tags[v] == UNDECIDED)
    s->tags[v] = RETAINED;
}

static void take_out(struct search *s, uint32_t v, uint32_t a, uint32_t b) {
  s->tags[v] = REMOVED;
  retain(s, a);
  retain(s, b);
}

static void log_merge(struct search *s, uint32_t v, uint32_t a, uint32_t b) {
  s->merges[s->merge_count++] = (struct merge){v, {a, b}};
}

static void match_side(struct search *s, const struct ring *ring, uint32_t i, uint32_t j, bool stop, uint32_t depth);

/* c goes with v, over a and b: its other side is still to be matched. */
static void go_on(struct search *s, uint32_t c, uint32_t a, uint32_t b, const struct ring *ring, uint32_t depth) {
  match_side(s, ring, find(ring, b), find(ring, a), false, depth + 1);
  log_merge(s, c, a, b);
}

/* The vertex across the edge from c to d, seen from the face that v has there. */
static uint32_t beyond(const struct lod_clod *clod, uint32_t half_at_v) {
  uint32_t opposite = clod_across(clod, half_at_v % 3 == 2 ? half_at_v - 2 : half_at_v + 1);
  return opposite == LOD_NONE ? LOD_NONE : clod->patches[opposite / 3].corners[(opposite % 3 + 2) % 3];
}

/* Matches a pattern to the faces from edge i to edge j. stop: take nothing more out. */
static void match_side(struct search *s, const struct ring *ring, uint32_t i, uint32_t j, bool stop, uint32_t depth) {
  uint32_t n = ring->count, a = ring->vertex[i], b = ring->vertex[j], c = ring->vertex[(i + 1) % n], d = ring->vertex[(i + 2) % n];
  if ((j + n - i) % n == 2) {
    retain(s, c);
    s->facts->t++;
    return;
  }
  struct ring at_c, at_d;
  if (!stop && depth < DEEPEST) {
    /* Seen from c the edges to a and d enclose v's faces counter-clockwise from d to a; likewise d. */
    if (may_stay(s, d) && may_go(s, c, d, a, 2, &at_c)) {
      take_out(s, c, d, a);
      s->facts->two_t++;
      go_on(s, c, d, a, &at_c, depth);
      return;
    }
    if (may_stay(s, c) && may_go(s, d, b, c, 2, &at_d)) {
      take_out(s, d, b, c);
      s->facts->two_t++;
      go_on(s, d, b, c, &at_d, depth);
      return;
    }
    uint32_t e = beyond(s->clod, ring->half[(i + 1) % n]);
    if (e != LOD_NONE && e != a && e != b && may_go(s, c, e, a, 3, &at_c) && may_go(s, d, b, e, 3, &at_d)) {
      take_out(s, c, e, a);
      take_out(s, d, b, e);
      s->facts->t_in_t++;
      go_on(s, c, e, a, &at_c, depth);
      go_on(s, d, b, e, &at_d, depth);
      return;
    }
  }
  retain(s, c);
  retain(s, d);
  s->facts->swaps++;
}

/* A vertex of a degree over 6: the straightest pair of its edges with two faces or more on either side, all others swapped away. */
static void start_wide(struct search *s, uint32_t v) {
  const struct lod_clod *clod = s->clod;
  struct clod_hole *hole = s->clod->hole;
  s->tags[v] = RETAINED;
  if (!clod_hole_open(clod, v, NULL, hole))
    return;
  const struct clod_polygon *polygon = &hole->halves[0];
  struct lod_vec3 legs[CLOD_RING];
  for (uint32_t i = 0; i < polygon->size; i++) {
    uint32_t side = clod->patches[polygon->old[i] / 3].sides[polygon->old[i] % 3];
    legs[i] = lod_vec3_normalize(lod_vec3_subtract(clod->edges[side >> 1].inner[side & 1], clod->positions[v]));
    if (!may_stay(s, polygon->ring[i]))
      return;
  }
  uint32_t best[2] = {0, 0};
  double straightest = s->cosine;
  for (uint32_t i = 0; i < polygon->size; i++)
    for (uint32_t j = i + 2; j < polygon->size && j + 2 <= polygon->size + i; j++)
      if (-lod_vec3_dot(legs[i], legs[j]) >= straightest) {
        straightest = -lod_vec3_dot(legs[i], legs[j]);
        best[0] = i, best[1] = j;
      }
  if (best[1] == 0)
    return;
  s->tags[v] = REMOVED;
  for (uint32_t i = 0; i < polygon->size; i++)
    retain(s, polygon->ring[i]);
  s->facts->wide++;
  s->facts->swaps += polygon->size - 4;
  s->facts->t += 2;
  log_merge(s, v, polygon->ring[best[0]], polygon->ring[best[1]]);
}

/* A vertex inside a face, from which a search begins: one side is matched and stopped, the other goes on. */
static void start_inside(struct search *s, uint32_t v) {
  struct ring ring;
  if (!gather(s->clod, v, &ring)) {
    s->tags[v] = RETAINED;
    if (s->settings->wide)
      start_wide(s, v);
    return;
  }
  if (ring.count == 3) { /* a star: the vertex may stand out of the plane of its three neighbours by the angle */
    struct lod_vec3 n =
        lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(ring.leg[1], ring.leg[0]), lod_vec3_subtract(ring.leg[2], ring.leg[0])));
    bool flat = fabs(lod_vec3_dot(n, ring.leg[0])) <= sqrt(1 - s->cosine * s->cosine);
    if (!flat || !may_stay(s, ring.vertex[0]) || !may_stay(s, ring.vertex[1]) || !may_stay(s, ring.vertex[2])) {
      s->tags[v] = RETAINED;
      return;
    }
    take_out(s, v, ring.vertex[0], ring.vertex[1]);
    retain(s, ring.vertex[2]);
    s->facts->star++;
    log_merge(s, v, LOD_NONE, LOD_NONE);
    return;
  }
  uint32_t best[2] = {0, 0};
  double straightest = -2;
  for (uint32_t i = 0; i < ring.count; i++)
    for (uint32_t j = i + 1; j < ring.count; j++) {
      double straight = -lod_vec3_dot(ring.leg[i], ring.leg[j]);
      if (straight > straightest && is_mergeable(s, &ring, i, j) && may_stay(s, ring.vertex[i]) && may_stay(s, ring.vertex[j]) &&
          can_match(s, &ring, i, j) && can_match(s, &ring, j, i)) {
        straightest = straight;
        best[0] = i, best[1] = j;
      }
    }
  if (straightest < -1) {
    s->tags[v] = RETAINED;
    return;
  }
  take_out(s, v, ring.vertex[best[0]], ring.vertex[best[1]]);
  match_side(s, &ring, best[0], best[1], true, 0);
  if (can_match(s, &ring, best[1], best[0]))
    match_side(s, &ring, best[1], best[0], false, 0);
  log_merge(s, v, ring.vertex[best[0]], ring.vertex[best[1]]);
}

/* A vertex on a line: only the line's edges are mergeable (6.1). Faces on either side are left to the hole. */
static void start_on_line(struct search *s, uint32_t v) {
  struct clod_hole *hole = s->clod->hole;
  s->tags[v] = RETAINED;
  if (!clod_hole_open(s->clod, v, NULL, hole))
    return;
  struct lod_vec3 legs[2];
  for (int i = 0; i < 2; i++) {
    const struct clod_edge *edge = &s->clod->edges[hole->line_edges[i]];
    legs[i] = lod_vec3_normalize(lod_vec3_subtract(edge->inner[edge->ends[1] == v], s->clod->positions[v]));
  }
  bool good = -lod_vec3_dot(legs[0], legs[1]) >= s->cosine;
  for (uint32_t h = 0; h < hole->half_count; h++) {
    const struct clod_polygon *polygon = &hole->halves[h];
    good = good && polygon->old_count <= 3;
    for (uint32_t i = 0; i < polygon->size; i++)
      good = good && may_stay(s, polygon->ring[i]);
  }
  if (!good)
    return;
  s->tags[v] = REMOVED;
  for (uint32_t h = 0; h < hole->half_count; h++) {
    for (uint32_t i = 0; i < hole->halves[h].size; i++)
      retain(s, hole->halves[h].ring[i]);
    s->facts->t += hole->halves[h].old_count == 2;
    s->facts->swaps += hole->halves[h].old_count == 3;
  }
  log_merge(s, v, LOD_NONE, LOD_NONE);
}

struct size {
  double square; /* of the smallest patch around a vertex, by its edges */
  uint32_t vertex;
};

static int by_size(const void *a, const void *b) {
  const struct size *x = a, *y = b;
  return x->square != y->square ? (x->square < y->square ? -1 : 1) : (x->vertex > y->vertex) - (x->vertex < y->vertex);
}

/* Small patches first (8). */
static uint32_t order(const struct lod_clod *clod, struct size *sizes) {
  uint32_t count = 0;
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    sizes[v] = (struct size){INFINITY, v};
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (patch->died != UINT32_MAX)
      continue;
    double square = 0;
    for (uint32_t k = 0; k < 3; k++)
      square += lod_vec3_distance_squared(clod->positions[patch->corners[k]], clod->positions[patch->corners[(k + 1) % 3]]);
    for (uint32_t k = 0; k < 3; k++)
      sizes[patch->corners[k]].square = fmin(sizes[patch->corners[k]].square, square);
  }
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    if (clod->half[v] != LOD_NONE && clod->removable[v] != 0)
      sizes[count++] = sizes[v];
  qsort(sizes, count, sizeof *sizes, by_size);
  return count;
}

static enum lod_status merge_all(struct search *s, const struct lod_progress *progress) {
  struct lod_clod *clod = s->clod;
  for (uint32_t i = 0; i < s->merge_count; i++) {
    const struct merge *merge = &s->merges[i];
    if (i % 256 == 0 && lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    if (clod->living_patches <= s->settings->patches) {
      s->facts->refused += s->merge_count - i;
      break;
    }
    LOD_TRY(clod_try_removal(clod, merge->vertex, merge->pair[0] == LOD_NONE ? NULL : merge->pair, true, s->settings->error));
    if (isfinite(clod->hole->cost) && clod->hole->cost <= s->settings->error) {
      LOD_TRY(clod_commit(clod));
    } else {
      LOD_TRY(clod_give_up(clod));
      s->facts->refused++;
    }
  }
  for (uint32_t p = 0; p < clod->patch_count; p++)
    if (clod->patches[p].died == UINT32_MAX)
      s->facts->estimate = fmax(s->facts->estimate, clod->patches[p].estimate);
  return LOD_OK;
}

struct lod_clod_search_settings lod_clod_search_defaults(void) {
  return (struct lod_clod_search_settings){.angle_degrees = 20, .error = INFINITY};
}

enum lod_status lod_clod_search(struct lod_clod *clod, const struct lod_clod_search_settings *settings, const struct lod_progress *progress,
                                struct lod_clod_search_facts *facts) {
  *facts = (struct lod_clod_search_facts){0};
  LOD_TRY(clod_prepare(clod));
  struct lod_arena *scratch = lod_arena_create_child(clod->arena);
  struct search s = {
      .clod = clod, .settings = settings, .facts = facts, .cosine = cos(settings->angle_degrees * 3.14159265358979323846 / 180)};
  struct size *sizes = scratch == NULL ? NULL : LOD_NEW(scratch, clod->vertex_count, struct size);
  enum lod_status status = LOD_MEMORY;
  if (sizes != NULL) {
    s.tags = LOD_NEW_ZERO(scratch, clod->vertex_count, uint8_t);
    s.merges = LOD_NEW(scratch, clod->vertex_count, struct merge);
    status = s.tags == NULL || s.merges == NULL ? LOD_MEMORY : LOD_OK;
  }
  if (status == LOD_OK) {
    uint32_t count = order(clod, sizes);
    for (uint32_t i = 0; i < count; i++) {
      uint32_t v = sizes[i].vertex;
      if (s.tags[v] == UNDECIDED && clod->removable[v] == 1)
        start_inside(&s, v);
      else if (s.tags[v] == UNDECIDED)
        start_on_line(&s, v);
    }
    facts->removed = s.merge_count;
    facts->retained = clod->living_vertices - s.merge_count;
    status = merge_all(&s, progress);
  }
  lod_arena_destroy(scratch);
  return status;
}
