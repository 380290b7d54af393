/* The source made as much of a surface as it can be before it is cut: of triangles with the same three corners one is kept, and triangles
 * are turned so that neighbours run along their edge against each other. What was a wall with two sides is remembered, and gets its other
 * side back in every level (extract.c). */
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

struct triple {
  uint32_t corners[3], triangle; /* ascending corners */
};

static int compare_triples(const void *a, const void *b) {
  const struct triple *x = a, *y = b;
  for (int k = 0; k < 3; k++)
    if (x->corners[k] != y->corners[k])
      return x->corners[k] < y->corners[k] ? -1 : 1;
  return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

static void sort_corners(const uint32_t *t, struct triple *out, uint32_t triangle) {
  uint32_t a = t[0], b = t[1], c = t[2], swap;
  if (a > b)
    swap = a, a = b, b = swap;
  if (b > c)
    swap = b, b = c, c = swap;
  if (a > b)
    swap = a, a = b, b = swap;
  *out = (struct triple){{a, b, c}, triangle};
}

static bool same_turn(const uint32_t *a, const uint32_t *b) {
  int k = b[0] == a[0] ? 0 : b[1] == a[0] ? 1 : 2;
  return b[(k + 1) % 3] == a[1];
}

/* back: for each triangle its other side, or LOD_NONE; dropped: it is one of several. */
static enum lod_status find_doubles(const struct lod_mesh *mesh, struct lod_arena *scratch, uint32_t *back, bool *dropped,
                                    uint32_t *dropped_count) {
  struct triple *triples;
  uint32_t count = mesh->triangle_count;
  RETILE_TRY_NEW(triples, scratch, count);
  for (uint32_t t = 0; t < count; t++) {
    sort_corners(mesh->triangles[t], &triples[t], t);
    back[t] = LOD_NONE;
    dropped[t] = false;
  }
  qsort(triples, count, sizeof *triples, compare_triples);
  *dropped_count = 0;
  for (uint32_t i = 0, first = 0; i < count; i++) {
    const struct triple *x = &triples[i], *y = &triples[first];
    if (i == first || memcmp(x->corners, y->corners, sizeof x->corners) != 0 || x->corners[0] == x->corners[1] ||
        x->corners[1] == x->corners[2]) {
      first = i;
      continue;
    }
    dropped[x->triangle] = true;
    ++*dropped_count;
    if (back[y->triangle] == LOD_NONE && !same_turn(mesh->triangles[y->triangle], mesh->triangles[x->triangle]))
      back[y->triangle] = x->triangle;
  }
  return LOD_OK;
}

static double twice_area(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
  return lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]), p),
                                        lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]), p)));
}

/* Which triangles to turn over, over edges of two; where a surface cannot be oriented the cut stays. Of each piece the larger part, by
 * area, stays as it is. */
static enum lod_status find_turns(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, struct lod_arena *scratch,
                                  bool *turned) {
  uint32_t *queue, count = mesh->triangle_count;
  bool *seen;
  RETILE_TRY_NEW(queue, scratch, count);
  RETILE_TRY_NEW_ZERO(seen, scratch, count);
  memset(turned, 0, count * sizeof *turned);
  for (uint32_t seed = 0; seed < count; seed++) {
    uint32_t begin = 0, end = 0;
    double kept = 0, changed = 0;
    if (seen[seed] || adjacency->edge_of[3 * (size_t)seed] == LOD_NONE)
      continue;
    queue[end++] = seed;
    seen[seed] = true;
    while (begin < end) {
      uint32_t t = queue[begin++];
      *(turned[t] ? &changed : &kept) += twice_area(mesh, t);
      for (uint32_t k = 0; k < 3; k++) {
        uint32_t h = 3 * t + k, e = adjacency->edge_of[h], first = adjacency->edge_begin[e];
        if (adjacency->edge_begin[e + 1] - first != 2)
          continue;
        uint32_t other = adjacency->edge_half_edges[first] == h ? adjacency->edge_half_edges[first + 1] : adjacency->edge_half_edges[first];
        if (seen[other / 3])
          continue;
        seen[other / 3] = true;
        turned[other / 3] = turned[t] != (lod_half_edge_start(mesh, h) == lod_half_edge_start(mesh, other));
        queue[end++] = other / 3;
      }
    }
    for (uint32_t i = 0; i < end && changed > kept; i++)
      turned[queue[i]] = !turned[queue[i]];
  }
  return LOD_OK;
}

/* The triangles of `from` that are not dropped; corners 1 and 2 of turned ones changed. */
static enum lod_status select_triangles(const struct lod_mesh *from, const uint32_t *chosen, uint32_t count, const bool *turned,
                                        struct lod_arena *arena, struct lod_mesh *to) {
  *to = *from;
  to->triangle_count = count;
  RETILE_TRY_NEW(to->triangles, arena, count);
  if (from->corners != NULL)
    RETILE_TRY_NEW(to->corners, arena, count);
  if (from->materials != NULL)
    RETILE_TRY_NEW(to->materials, arena, count);
  if (from->parts != NULL)
    RETILE_TRY_NEW(to->parts, arena, count);
  for (uint32_t i = 0; i < count; i++) {
    uint32_t t = chosen[i];
    for (int k = 0; k < 3; k++) {
      int place = turned != NULL && turned[i] && k != 0 ? 3 - k : k;
      to->triangles[i][k] = from->triangles[t][place];
      if (from->corners != NULL)
        to->corners[i][k] = from->corners[t][place];
    }
    if (from->materials != NULL)
      to->materials[i] = from->materials[t];
    if (from->parts != NULL)
      to->parts[i] = from->parts[t];
  }
  return LOD_OK;
}

enum lod_status clean_source(const struct lod_mesh *mesh, struct lod_arena *arena, struct cleaned *cleaned) {
  *cleaned = (struct cleaned){.source = mesh, .mesh = *mesh};
  struct lod_adjacency adjacency;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *back = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, uint32_t), dropped_count = 0, count = 0;
  bool *dropped = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, bool), *turned = NULL;
  enum lod_status status = back == NULL || dropped == NULL ? LOD_MEMORY : find_doubles(mesh, scratch, back, dropped, &dropped_count);
  uint32_t *chosen = status == LOD_OK ? LOD_NEW(arena, mesh->triangle_count, uint32_t) : NULL;
  status = status == LOD_OK && chosen == NULL ? LOD_MEMORY : status;
  for (uint32_t t = 0; status == LOD_OK && t < mesh->triangle_count; t++)
    if (!dropped[t])
      chosen[count++] = t;
  struct lod_mesh once = *mesh;
  if (status == LOD_OK && dropped_count != 0)
    status = select_triangles(mesh, chosen, count, NULL, scratch, &once);
  if (status == LOD_OK)
    status = lod_adjacency_create(&once, scratch, &adjacency);
  bool turns = status == LOD_OK && adjacency.misoriented_edges != 0;
  if (turns) {
    turned = LOD_NEW(arena, count, bool);
    status = turned == NULL ? LOD_MEMORY : find_turns(&once, &adjacency, scratch, turned);
  }
  if (status == LOD_OK && (turns || dropped_count != 0)) {
    status = select_triangles(mesh, chosen, count, turned, arena, &cleaned->mesh);
    cleaned->back = status == LOD_OK ? LOD_NEW(arena, count, uint32_t) : NULL;
    status = status == LOD_OK && cleaned->back == NULL ? LOD_MEMORY : status;
    for (uint32_t i = 0; status == LOD_OK && i < count; i++)
      cleaned->back[i] = back[chosen[i]];
    cleaned->from = chosen;
    cleaned->turned = turned;
  }
  lod_arena_destroy(scratch);
  return status;
}

struct lod_retile_point clean_point(const struct cleaned *cleaned, struct lod_retile_point point) {
  if (cleaned->from == NULL)
    return point;
  struct lod_retile_point own = {cleaned->from[point.face], {point.weights[0], point.weights[1], point.weights[2]}};
  if (cleaned->turned != NULL && cleaned->turned[point.face]) {
    own.weights[1] = point.weights[2];
    own.weights[2] = point.weights[1];
  }
  return own;
}
