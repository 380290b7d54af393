#include <string.h>

#include "codec/stream/connectivity.h"

/* One stable counting sort of `order` by end(order[i]) into `sorted`; count: vertex_count + 1 numbers. */
static void sort_by_end(const uint32_t *flat, bool larger, const uint32_t *order, size_t half_edges, uint32_t vertex_count, uint32_t *count,
                        uint32_t *sorted) {
  memset(count, 0, ((size_t)vertex_count + 1) * sizeof *count);
  for (size_t pass = 0; pass < 2; pass++) {
    for (size_t i = 0; i < half_edges; i++) {
      uint32_t h = order != NULL ? order[i] : (uint32_t)i, a = flat[h], b = flat[lod_half_edge_next(h)];
      uint32_t end = (a < b) == larger ? b : a;
      if (pass == 0)
        count[end]++;
      else
        sorted[count[end]++] = h;
    }
    uint32_t sum = 0;
    for (uint32_t v = 0; v <= vertex_count && pass == 0; v++) {
      uint32_t here = count[v];
      count[v] = sum;
      sum += here;
    }
  }
}

/* Half-edges sorted by their edge: those of one edge stand together. */
static enum lod_status glue(const uint32_t (*triangles)[3], uint32_t triangle_count, uint32_t vertex_count, struct lod_arena *scratch,
                            uint32_t *opposite) {
  const size_t half_edges = 3 * (size_t)triangle_count;
  uint32_t *count = LOD_NEW(scratch, (size_t)vertex_count + 1, uint32_t);
  uint32_t *order = LOD_NEW(scratch, half_edges, uint32_t), *sorted = LOD_NEW(scratch, half_edges, uint32_t);
  if (count == NULL || order == NULL || sorted == NULL)
    return LOD_MEMORY;
  memset(opposite, 0xff, half_edges * sizeof *opposite);
  if (half_edges == 0)
    return LOD_OK;
  const uint32_t *flat = &triangles[0][0];
  sort_by_end(flat, true, NULL, half_edges, vertex_count, count, order);
  sort_by_end(flat, false, order, half_edges, vertex_count, count, sorted);
  for (size_t i = 0, end; i < half_edges; i = end) {
    uint32_t h = sorted[i], a = flat[h], b = flat[lod_half_edge_next(h)];
    for (end = i + 1; end < half_edges; end++) {
      uint32_t c = flat[sorted[end]], d = flat[lod_half_edge_next(sorted[end])];
      if (!((c == a && d == b) || (c == b && d == a)))
        break;
    }
    for (size_t forth = i, back = i;; forth++, back++) { /* those that run opposite ways in pairs, as they come */
      while (forth < end && flat[sorted[forth]] != a)
        forth++;
      while (back < end && flat[sorted[back]] != b)
        back++;
      if (forth == end || back == end)
        break;
      opposite[sorted[forth]] = sorted[back];
      opposite[sorted[back]] = sorted[forth];
    }
  }
  return LOD_OK;
}

/* Gives all corners of the fan around the origin of half-edge `h` the same vertex. */
static void number_fan(const uint32_t *opposite, uint32_t h, uint32_t vertex, uint32_t *corner) {
  uint32_t start = h;
  for (;;) { /* back to the fan's first half-edge, or around once */
    uint32_t o = opposite[h];
    if (o == LOD_NONE)
      break;
    o = lod_half_edge_next(o);
    if (o == start)
      break;
    h = o;
  }
  for (start = h;;) {
    corner[h] = vertex;
    uint32_t o = opposite[lod_half_edge_previous(h)];
    if (o == LOD_NONE || o == start)
      return;
    h = o;
  }
}

static enum lod_status count_components(struct lod_cut *cut, struct lod_arena *arena) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint8_t *seen = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, cut->triangle_count, uint8_t);
  uint32_t *stack = scratch == NULL ? NULL : LOD_NEW(scratch, cut->triangle_count, uint32_t);
  const bool good = seen != NULL && stack != NULL;
  for (uint32_t t = 0; t < cut->triangle_count && good; t++) {
    if (seen[t])
      continue;
    uint32_t top = 0;
    cut->component_count++;
    seen[t] = 1;
    for (stack[top++] = t; top > 0;) {
      uint32_t u = stack[--top];
      for (uint32_t h = 3 * u; h < 3 * u + 3; h++)
        if (cut->opposite[h] != LOD_NONE && !seen[cut->opposite[h] / 3]) {
          seen[cut->opposite[h] / 3] = 1;
          stack[top++] = cut->opposite[h] / 3;
        }
    }
  }
  lod_arena_destroy(scratch);
  return good ? LOD_OK : LOD_MEMORY;
}

enum lod_status lod_cut_create(const uint32_t (*triangles)[3], uint32_t triangle_count, uint32_t vertex_count, struct lod_arena *arena,
                               struct lod_cut *cut) {
  const size_t half_edges = 3 * (size_t)triangle_count;
  *cut = (struct lod_cut){.triangle_count = triangle_count, .triangles = triangles};
  cut->opposite = LOD_NEW(arena, half_edges, uint32_t);
  cut->corner = LOD_NEW(arena, half_edges, uint32_t);
  cut->uncut = LOD_NEW(arena, half_edges, uint32_t);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = LOD_MEMORY;
  if (cut->opposite != NULL && cut->corner != NULL && cut->uncut != NULL && scratch != NULL)
    status = glue(triangles, triangle_count, vertex_count, scratch, cut->opposite);
  lod_arena_destroy(scratch);
  LOD_TRY(status);
  memset(cut->corner, 0xff, half_edges * sizeof *cut->corner);
  for (uint32_t h = 0; h < half_edges; h++)
    if (cut->corner[h] == LOD_NONE) {
      cut->uncut[cut->vertex_count] = triangles[h / 3][h % 3];
      number_fan(cut->opposite, h, cut->vertex_count++, cut->corner);
    }
  return count_components(cut, arena);
}
