/* Vertices put back where the error is: the level's triangles are split at the vertices that they miss by most, and flipped into shape
 * (Turk 1992, 8: a measure of match that guides re-tiling). What comes back was a vertex of the finer level, or of the source, so levels
 * stay nested, and splits and flips keep the topology. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

static uint32_t start_of(const struct tiling *t, uint32_t h) {
  return t->faces[h / 3][h % 3];
}

/* ---- where a vertex of a line belongs ---- */

/* The half-edges of the sheet that begin at v and run along lines of the level: at most two are wanted. */
static uint32_t line_steps(const struct tiling *t, uint32_t v, uint32_t level, uint32_t steps[2], struct lod_vec3 ways[2]) {
  const struct sheet *sheet = t->sheet;
  const struct lod_retile_point *at = &t->points[v];
  uint32_t count = 0;
  if (v >= sheet->vertex_count) { /* on an edge, or inside a face */
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t h = 3 * at->face + (k + 1) % 3, twin = sheet->twin[h];
      if (at->weights[k] != 0 || sheet->marks[h] == 0 || sheet->marks[h] > 1 + level)
        continue;
      struct lod_vec3 way =
          lod_vec3_subtract(sheet->positions[sheet->faces[at->face][(k + 2) % 3]], sheet->positions[sheet->faces[at->face][(k + 1) % 3]]);
      steps[0] = h;
      ways[0] = way;
      steps[1] = twin;
      ways[1] = lod_vec3_scale(way, -1);
      return 2;
    }
    return 0;
  }
  if (!sheet->on_line[v])
    return 0;
  uint32_t begin = 3 * at->face, h;
  for (uint32_t k = 0; k < 3; k++)
    if (sheet->faces[at->face][k] == v)
      begin = 3 * at->face + k;
  while (sheet->twin[begin] != LOD_NONE && count < 64) { /* clockwise to the open end, if there is one */
    uint32_t next = retile_next(sheet->twin[begin]);
    if (next == 3 * at->face || next == 3 * at->face + 1 || next == 3 * at->face + 2)
      break;
    begin = next;
    count++;
  }
  count = 0;
  h = begin;
  uint32_t last = h;
  for (int guard = 0; guard < 1000; guard++) {
    uint32_t end = sheet->faces[h / 3][(h + 1) % 3];
    if (sheet->marks[h] != 0 && sheet->marks[h] <= 1 + level) {
      if (count == 2)
        return 3;
      steps[count] = h;
      ways[count++] = lod_vec3_subtract(sheet->positions[end], sheet->positions[v]);
    }
    last = retile_previous(h);
    h = sheet->twin[last];
    if (h == LOD_NONE || h == begin)
      break;
  }
  if (h == LOD_NONE) { /* the border that ends here has no face on its left */
    if (count == 2)
      return 3;
    steps[count] = LOD_NONE;
    ways[count++] = lod_vec3_subtract(sheet->positions[sheet->faces[last / 3][last % 3]], sheet->positions[v]);
  }
  return count;
}

/* The marked edge of v's face that it lies on, or LOD_NONE. */
static uint32_t line_edge(const struct tiling *t, uint32_t v) {
  const struct lod_retile_point *at = &t->flat[v];
  uint32_t best = LOD_NONE, least = LOD_RETILE_ONE / 256;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t h = 3 * at->face + (k + 1) % 3;
    if (t->marks[h] != 0 && at->weights[k] <= least) {
      least = at->weights[k];
      best = h;
    }
  }
  return best;
}

/* ---- one vertex ---- */

static bool lay_triangle(const struct tiling *t, const uint32_t v[3], double scale, struct chart_point at[3]) {
  struct lod_vec3 p = lod_vec3_subtract(t->positions[v[1]], t->positions[v[0]]),
                  q = lod_vec3_subtract(t->positions[v[2]], t->positions[v[0]]);
  double length = lod_vec3_length(p);
  if (!(length > 0))
    return false;
  struct lod_vec3 axis = lod_vec3_scale(p, 1 / length);
  double x = lod_vec3_dot(q, axis), y = lod_vec3_length(lod_vec3_cross(axis, q)), largest = fmax(length, fmax(fabs(x), y));
  scale = scale > 0 ? scale : CHART_SIDE / largest;
  if (largest * scale > CHART_SIDE + 1)
    return false;
  at[0] = (struct chart_point){0, 0};
  at[1] = (struct chart_point){(int32_t)lrint(length * scale), 0};
  at[2] = (struct chart_point){(int32_t)lrint(x * scale), (int32_t)lrint(y * scale)};
  return chart_orient(at[0], at[1], at[2]) > 0;
}

static bool split_at(struct tiling *t, uint32_t v) {
  uint32_t f = t->flat[v].face, corners[3];
  struct chart_point at[3], p;
  memcpy(corners, t->faces[f], sizeof corners);
  if (!lay_triangle(t, corners, 0, at))
    return false;
  int64_t x = LOD_RETILE_ONE / 2, y = LOD_RETILE_ONE / 2;
  for (int k = 0; k < 3; k++) {
    x += (int64_t)t->flat[v].weights[k] * at[k].x;
    y += (int64_t)t->flat[v].weights[k] * at[k].y;
  }
  p = (struct chart_point){(int32_t)(x >> 20), (int32_t)(y >> 20)};
  for (int k = 0; k < 3; k++)
    if (chart_orient(at[k], at[(k + 1) % 3], p) <= 0)
      return false;
  uint32_t list = chart_lift(t, f, at, LOD_NONE), faces[3] = {f, t->free_faces[t->free_count - 1], t->free_faces[t->free_count - 2]};
  tiling_split_face(t, f, v); /* (a, b, v), (b, c, v), (c, a, v) */
  const struct chart_point fresh[3][3] = {{at[0], at[1], p}, {at[1], at[2], p}, {at[2], at[0], p}};
  t->dead[v] = false;
  for (uint32_t w = list, *link = &list; w != LOD_NONE; w = *link) /* v is flat no more */
    if (w == v)
      *link = t->flat_next[w];
    else
      link = &t->flat_next[w];
  chart_drop(t, list, faces, fresh, 3);
  return true;
}

/* Puts v on the edge of h, which runs from a to b along a line. */
static bool split_line(struct tiling *t, uint32_t v, uint32_t h, const uint32_t steps[2], const struct lod_vec3 ways[2]) {
  uint32_t g = t->twin[h], a = start_of(t, h), b = start_of(t, retile_next(h)), c = start_of(t, retile_previous(h));
  uint32_t left[3] = {a, b, c}, right[3] = {b, a, g == LOD_NONE ? LOD_NONE : start_of(t, retile_previous(g))};
  struct chart_point at[2][3], p;
  if (!lay_triangle(t, left, 0, at[0]) || (g != LOD_NONE && !lay_triangle(t, right, 0, at[1])))
    return false;
  const struct lod_retile_point *flat = &t->flat[v];
  double share = (double)flat->weights[(h + 1) % 3] / ((double)flat->weights[(h + 1) % 3] + flat->weights[h % 3]);
  if (!(share > 1e-3 && share < 1 - 1e-3))
    return false;
  uint32_t list[2] = {LOD_NONE, LOD_NONE}, faces[2][2] = {{h / 3, t->free_faces[t->free_count - 1]}, {0, 0}};
  struct chart_point fresh[2][2][3];
  for (int side = 0; side < (g == LOD_NONE ? 1 : 2); side++) {
    uint32_t half = side == 0 ? h : g;
    struct chart_point corners[3];
    for (uint32_t k = 0; k < 3; k++)
      corners[(half + k) % 3] = at[side][k];
    p = (struct chart_point){(int32_t)lrint((side == 0 ? share : 1 - share) * at[side][1].x), 0};
    if (chart_orient(at[side][0], p, at[side][2]) <= 0 || chart_orient(p, at[side][1], at[side][2]) <= 0) {
      for (uint32_t k = 0; side == 1 && k < 3; k++)
        corners[(h + k) % 3] = at[0][k];
      if (side == 1) /* back to where they were */
        chart_drop(t, list[0], &(uint32_t){h / 3}, (const struct chart_point(*)[3]) & corners, 1);
      return false;
    }
    list[side] = chart_lift(t, half / 3, corners, LOD_NONE);
    memcpy(fresh[side][0], (struct chart_point[3]){at[side][0], p, at[side][2]}, sizeof fresh[side][0]);
    memcpy(fresh[side][1], (struct chart_point[3]){p, at[side][1], at[side][2]}, sizeof fresh[side][1]);
  }
  faces[1][0] = g == LOD_NONE ? 0 : g / 3;
  faces[1][1] = t->free_count < 2 ? 0 : t->free_faces[t->free_count - 2];
  tiling_split_edge(t, h, v); /* slot h: a -> v, slot g: b -> v */
  t->dead[v] = false;
  struct lod_vec3 way = lod_vec3_subtract(t->positions[b], t->positions[a]);
  uint32_t ahead = lod_vec3_dot(ways[0], way) >= lod_vec3_dot(ways[1], way) ? 0 : 1;
  uint32_t on = 3 * faces[0][1]; /* v -> b */
  t->start[on] = steps[ahead] == LOD_NONE ? t->start[h] : steps[ahead] / 3;
  if (g != LOD_NONE)
    t->start[3 * faces[1][1]] = steps[1 - ahead] == LOD_NONE ? t->start[g] : steps[1 - ahead] / 3; /* v -> a */
  for (int side = 0; side < (g == LOD_NONE ? 1 : 2); side++) {
    for (uint32_t w = list[side], *link = &list[side]; w != LOD_NONE; w = *link)
      if (w == v)
        *link = t->flat_next[w];
      else
        link = &t->flat_next[w];
    uint32_t half = side == 0 ? h : g; /* corners of a split face stand where they stood: turn the charts to match */
    struct chart_point turned[2][3];
    for (uint32_t k = 0; k < 3; k++) {
      turned[0][(half + k) % 3] = fresh[side][0][k];
      turned[1][k] = fresh[side][1][k];
    }
    chart_drop(t, list[side], faces[side], (const struct chart_point(*)[3])turned, 2);
  }
  return true;
}

/* ---- which vertices ---- */

struct candidate {
  double score;
  uint32_t v, face;
};

static int compare_candidates(const void *a, const void *b) {
  const struct candidate *x = a, *y = b;
  if (x->score != y->score)
    return x->score > y->score ? -1 : 1;
  return x->v < y->v ? -1 : x->v > y->v;
}

/* How well a vertex there goes with the others: 0 on a corner of its triangle, 1 as far from them as they are from one another. */
static double room_for(const struct tiling *t, uint32_t v) {
  const uint32_t *c = t->faces[t->flat[v].face];
  double nearest = INFINITY, longest = 0;
  for (int k = 0; k < 3; k++) {
    nearest = fmin(nearest, lod_vec3_distance_squared(t->positions[v], t->positions[c[k]]));
    longest = fmax(longest, lod_vec3_distance_squared(t->positions[c[k]], t->positions[c[(k + 1) % 3]]));
  }
  return longest > 0 ? fmin(1, 2 * sqrt(nearest / longest)) : 0;
}

static double longest_side(const struct tiling *t, uint32_t f) {
  double longest = 0;
  for (uint32_t k = 0; k < 3; k++)
    longest = fmax(longest, lod_vec3_distance_squared(t->positions[t->faces[f][k]], t->positions[t->faces[f][(k + 1) % 3]]));
  return longest;
}

/* For each face that misses by more than `enough` (fill: for each face) the vertex on it that does most about it. */
static uint32_t list_candidates(struct tiling *t, const bool *allowed, double enough, bool fill, struct candidate *list) {
  uint32_t count = 0;
  for (uint32_t f = 0; f < t->face_count; f++) {
    if (t->faces[f][0] == LOD_NONE)
      continue;
    double worst = fill ? longest_side(t, f) : match_known(t, f, enough);
    if (worst <= enough && !fill)
      continue;
    struct candidate best = {0, LOD_NONE, f};
    for (uint32_t v = t->flat_head[f]; v != LOD_NONE; v = t->flat_next[v]) {
      if (!allowed[v])
        continue;
      double score = (fill ? 1 : match_error(t, v, best.score)) * room_for(t, v);
      if (score > best.score) {
        best.score = score;
        best.v = v;
      }
    }
    for (uint32_t k = 0; k < 3 && best.v == LOD_NONE && !fill; k++) /* a face beside it may do */
      for (uint32_t v = t->twin[3 * f + k] == LOD_NONE ? LOD_NONE : t->flat_head[t->twin[3 * f + k] / 3]; v != LOD_NONE;
           v = t->flat_next[v]) {
        double score = allowed[v] ? room_for(t, v) : 0;
        if (score > best.score)
          best = (struct candidate){score, v, t->flat[v].face};
      }
    if (best.v != LOD_NONE) {
      best.score = worst * room_for(t, best.v);
      list[count++] = best;
    }
  }
  qsort(list, count, sizeof *list, compare_candidates);
  return count;
}

static bool insert_one(struct tiling *t, uint32_t v, uint32_t level) {
  uint32_t steps[2];
  struct lod_vec3 ways[2];
  uint32_t lines = line_steps(t, v, level, steps, ways);
  if (lines == 0)
    return split_at(t, v);
  uint32_t h = lines == 2 ? line_edge(t, v) : LOD_NONE;
  return h != LOD_NONE && split_line(t, v, h, steps, ways);
}

static void block(const struct tiling *t, uint32_t f, uint32_t stamp, uint32_t *blocked) {
  blocked[f] = stamp;
  for (uint32_t k = 0; k < 3; k++)
    if (t->twin[3 * f + k] != LOD_NONE)
      blocked[t->twin[3 * f + k] / 3] = stamp;
}

static uint32_t list_free(struct tiling *t) {
  t->free_count = 0;
  for (uint32_t f = t->face_count; f-- > 0;)
    if (t->faces[f][0] == LOD_NONE)
      t->free_faces[t->free_count++] = f;
  return t->free_count;
}

enum lod_status insert_vertices(struct tiling *t, const bool *allowed, uint32_t level, uint32_t most, double enough, enum insert_mode mode,
                                struct lod_arena *arena, uint32_t *inserted) {
  enum { MOST_ROUNDS = 40 };
  double near = 0.6; /* what misses by less than this share of the worst waits for another round */
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct candidate *list = scratch == NULL ? NULL : LOD_NEW(scratch, t->face_count, struct candidate);
  uint32_t *blocked = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, t->face_count, uint32_t);
  bool *open = scratch == NULL ? NULL : lod_arena_copy(scratch, allowed, t->vertex_count * sizeof *allowed), filling = mode == INSERT_ALL;
  t->free_faces = scratch == NULL ? NULL : LOD_NEW(scratch, t->face_count, uint32_t);
  enum lod_status status = list == NULL || blocked == NULL || open == NULL || t->free_faces == NULL ? LOD_MEMORY : LOD_OK;
  *inserted = 0;
  for (uint32_t round = 1; status == LOD_OK && round <= MOST_ROUNDS && *inserted < most && list_free(t) > 2; round++) {
    double limit = filling ? 0 : fmax(enough, near * match_worst(t));
    uint32_t count = list_candidates(t, open, limit, filling, list), done = 0, share = (most - *inserted) / 3 + 1;
    t->enough = filling ? INFINITY : limit;
    for (uint32_t i = 0; i < count && done < share && t->free_count >= 2; i++) {
      if (blocked[list[i].face] == round)
        continue;
      uint32_t face = t->flat[list[i].v].face;
      open[list[i].v] = false;
      if (!insert_one(t, list[i].v, level))
        continue;
      t->birth[list[i].v] = (uint8_t)level;
      block(t, face, round, blocked);
      done++;
    }
    *inserted += done;
    if (done != 0)
      improve_flips(t, 3);
    else if (!filling && limit > enough && near > 0.01)
      near *= 0.6;
    else if (mode == INSERT_FILL && !filling)
      filling = true;
    else
      break;
  }
  t->free_faces = NULL;
  t->free_count = 0;
  t->enough = INFINITY;
  lod_arena_destroy(scratch);
  return status;
}
