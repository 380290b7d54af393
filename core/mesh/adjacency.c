/* Edges are found by bucketing half-edges at their lower vertex and sorting each small bucket: linear in practice, and the numbering
 * depends on nothing but the mesh. */
#include "core/mesh/adjacency.h"

#include <stdlib.h>
#include <string.h>

static bool is_degenerate(const uint32_t triangle[3]) {
  return triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0];
}

struct entry {
  uint32_t high;      /* the edge's other vertex */
  uint32_t half_edge; /* makes the order total */
};

static bool entry_less(const struct entry *a, const struct entry *b) {
  return a->high != b->high ? a->high < b->high : a->half_edge < b->half_edge;
}

static int compare_entries(const void *left, const void *right) {
  return entry_less(left, right) ? -1 : entry_less(right, left) ? 1 : 0;
}

static void sort_entries(struct entry *entries, uint32_t count) {
  if (count > 24) { /* a vertex of a thousand triangles must not cost a million steps */
    qsort(entries, count, sizeof *entries, compare_entries);
    return;
  }
  for (uint32_t i = 1; i < count; i++) {
    struct entry x = entries[i];
    uint32_t at = i;
    for (; at > 0 && entry_less(&x, &entries[at - 1]); at--)
      entries[at] = entries[at - 1];
    entries[at] = x;
  }
}

/* Turns counts at [i + 1] into begins. */
static void accumulate(uint32_t *begin, uint32_t count) {
  for (uint32_t i = 0; i < count; i++)
    begin[i + 1] += begin[i];
}

static void ends_of(const struct lod_mesh *mesh, uint32_t h, uint32_t *low, uint32_t *high) {
  uint32_t a = lod_half_edge_start(mesh, h), b = lod_half_edge_end(mesh, h);
  *low = a < b ? a : b;
  *high = a < b ? b : a;
}

/* Fills edge_of, edge_begin, edge_half_edges, twin and the edge part of the report. */
static bool find_edges(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_arena *scratch, struct lod_adjacency *out) {
  uint32_t half_edges = 3 * mesh->triangle_count, low, high;
  uint32_t *begin = LOD_NEW_ZERO(scratch, (size_t)mesh->vertex_count + 2, uint32_t);
  struct entry *entries = LOD_NEW(scratch, half_edges, struct entry);
  out->twin = LOD_NEW(arena, half_edges, uint32_t);
  out->edge_of = LOD_NEW(arena, half_edges, uint32_t);
  out->edge_half_edges = LOD_NEW(arena, half_edges, uint32_t);
  if (begin == NULL || entries == NULL || out->twin == NULL || out->edge_of == NULL || out->edge_half_edges == NULL)
    return false;
  memset(out->twin, 0xff, half_edges * sizeof *out->twin);
  memset(out->edge_of, 0xff, half_edges * sizeof *out->edge_of);
  for (uint32_t h = 0; h < half_edges; h++) { /* counted one behind, so that placing moves begin[v + 1] to where v + 1 begins */
    if (is_degenerate(mesh->triangles[h / 3])) {
      out->degenerate_triangles += h % 3 == 0;
      continue;
    }
    ends_of(mesh, h, &low, &high);
    begin[(size_t)low + 2]++;
  }
  accumulate(begin, mesh->vertex_count + 1);
  for (uint32_t h = 0; h < half_edges; h++) {
    if (is_degenerate(mesh->triangles[h / 3]))
      continue;
    ends_of(mesh, h, &low, &high);
    entries[begin[(size_t)low + 1]++] = (struct entry){high, h};
  }
  uint32_t edges = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    sort_entries(&entries[begin[v]], begin[v + 1] - begin[v]);
    for (uint32_t i = begin[v]; i < begin[v + 1]; i++)
      edges += i == begin[v] || entries[i].high != entries[i - 1].high;
  }
  out->edge_count = edges;
  out->edge_begin = LOD_NEW(arena, (size_t)edges + 1, uint32_t);
  if (out->edge_begin == NULL)
    return false;
  uint32_t edge = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (uint32_t i = begin[v]; i < begin[v + 1]; i++) {
      if (i == begin[v] || entries[i].high != entries[i - 1].high)
        out->edge_begin[edge++] = i;
      out->edge_of[entries[i].half_edge] = edge - 1;
      out->edge_half_edges[i] = entries[i].half_edge;
    }
  out->edge_begin[edges] = begin[mesh->vertex_count];
  return true;
}

static void pair_twins(const struct lod_mesh *mesh, struct lod_adjacency *out) {
  for (uint32_t e = 0; e < out->edge_count; e++) {
    const uint32_t *sides = &out->edge_half_edges[out->edge_begin[e]];
    uint32_t count = out->edge_begin[e + 1] - out->edge_begin[e];
    if (count == 1) {
      out->boundary_edges++;
    } else if (count > 2) {
      out->non_manifold_edges++;
    } else if (lod_half_edge_start(mesh, sides[0]) == lod_half_edge_start(mesh, sides[1])) {
      out->misoriented_edges++;
    } else {
      out->twin[sides[0]] = sides[1];
      out->twin[sides[1]] = sides[0];
    }
  }
}

/* Writes the fan that `corner` is in behind `at`, and numbers it; returns the new end. */
static uint32_t write_fan(struct lod_adjacency *out, uint32_t corner, uint32_t *list, uint32_t at) {
  uint32_t first = corner;
  for (uint32_t right = lod_corner_right(out, first); right != LOD_NONE && right != corner; right = lod_corner_right(out, first))
    first = right;
  if (lod_corner_right(out, first) != LOD_NONE)
    first = corner; /* closed: it came around */
  for (uint32_t c = first; c != LOD_NONE && out->fan_of[c] == LOD_NONE; c = lod_corner_left(out, c)) {
    out->fan_of[c] = out->fan_count;
    list[at++] = c;
  }
  out->fan_count++;
  return at;
}

/* Fills vertex_begin, vertex_corners, fan_of, fan_vertex. Corners are entered by vertex first, then put in turning order. */
static bool find_fans(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_arena *scratch, struct lod_adjacency *out) {
  uint32_t corners = 3 * mesh->triangle_count;
  uint32_t *begin = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 2, uint32_t);
  uint32_t *plain = LOD_NEW(scratch, corners, uint32_t);
  out->vertex_corners = LOD_NEW(arena, corners, uint32_t);
  out->fan_of = LOD_NEW(arena, corners, uint32_t);
  if (begin == NULL || plain == NULL || out->vertex_corners == NULL || out->fan_of == NULL)
    return false;
  memset(out->fan_of, 0xff, corners * sizeof *out->fan_of);
  for (uint32_t c = 0; c < corners; c++)
    if (out->edge_of[c] != LOD_NONE)
      begin[(size_t)lod_half_edge_start(mesh, c) + 2]++;
  accumulate(begin, mesh->vertex_count + 1);
  for (uint32_t c = 0; c < corners; c++)
    if (out->edge_of[c] != LOD_NONE)
      plain[begin[(size_t)lod_half_edge_start(mesh, c) + 1]++] = c;
  out->vertex_begin = begin;
  uint32_t at = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    uint32_t first_fan = out->fan_count;
    for (uint32_t i = begin[v]; i < begin[v + 1]; i++)
      if (out->fan_of[plain[i]] == LOD_NONE)
        at = write_fan(out, plain[i], out->vertex_corners, at);
    out->cut_vertices += out->fan_count > first_fan + 1;
  }
  out->fan_vertex = LOD_NEW(arena, out->fan_count, uint32_t);
  if (out->fan_vertex == NULL)
    return false;
  for (uint32_t i = 0; i < at; i++)
    out->fan_vertex[out->fan_of[out->vertex_corners[i]]] = lod_half_edge_start(mesh, out->vertex_corners[i]);
  return true;
}

enum lod_status lod_adjacency_create_edges(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_adjacency *adjacency) {
  if (mesh->triangle_count > UINT32_MAX / 3 - 1 || mesh->vertex_count > UINT32_MAX - 2)
    return LOD_MEMORY; /* half-edges have 32 bits */
  *adjacency = (struct lod_adjacency){.vertex_count = mesh->vertex_count, .triangle_count = mesh->triangle_count};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  bool ok = scratch != NULL && find_edges(mesh, arena, scratch, adjacency);
  lod_arena_destroy(scratch);
  if (!ok)
    return LOD_MEMORY;
  pair_twins(mesh, adjacency);
  return LOD_OK;
}

enum lod_status lod_adjacency_create(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_adjacency *adjacency) {
  struct lod_adjacency out;
  LOD_TRY(lod_adjacency_create_edges(mesh, arena, &out));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  bool ok = scratch != NULL && find_fans(mesh, arena, scratch, &out);
  lod_arena_destroy(scratch);
  if (!ok)
    return LOD_MEMORY;
  *adjacency = out;
  return LOD_OK;
}

bool lod_adjacency_check(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency) {
  if (adjacency->vertex_count != mesh->vertex_count || adjacency->triangle_count != mesh->triangle_count)
    return false;
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
    uint32_t twin = adjacency->twin[h];
    if ((adjacency->edge_of[h] == LOD_NONE) != is_degenerate(mesh->triangles[h / 3]))
      return false;
    if (twin != LOD_NONE &&
        (adjacency->twin[twin] != h || adjacency->edge_of[twin] != adjacency->edge_of[h] ||
         lod_half_edge_start(mesh, twin) != lod_half_edge_end(mesh, h) || lod_half_edge_end(mesh, twin) != lod_half_edge_start(mesh, h) ||
         adjacency->fan_of[lod_half_edge_next(twin)] != adjacency->fan_of[h]))
      return false;
  }
  uint32_t listed = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (uint32_t i = adjacency->vertex_begin[v]; i < adjacency->vertex_begin[v + 1]; i++, listed++) {
      uint32_t corner = adjacency->vertex_corners[i], fan = adjacency->fan_of[corner];
      if (lod_half_edge_start(mesh, corner) != v || fan >= adjacency->fan_count || adjacency->fan_vertex[fan] != v)
        return false;
      bool same_fan = i > adjacency->vertex_begin[v] && adjacency->fan_of[adjacency->vertex_corners[i - 1]] == fan;
      if (same_fan && lod_corner_left(adjacency, adjacency->vertex_corners[i - 1]) != corner)
        return false;
    }
  for (uint32_t e = 0; e < adjacency->edge_count; e++)
    for (uint32_t i = adjacency->edge_begin[e]; i < adjacency->edge_begin[e + 1]; i++)
      if (adjacency->edge_of[adjacency->edge_half_edges[i]] != e)
        return false;
  return listed == 3 * (mesh->triangle_count - adjacency->degenerate_triangles);
}
