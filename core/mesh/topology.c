#include "core/mesh/topology.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"

struct work {
  const struct lod_mesh *mesh;
  const struct lod_adjacency *adjacency;
  struct lod_arena *scratch;
  struct lod_topology *out;
};

/* Components by vertices, boundary loops by the vertices of boundary edges. */
static bool count_components(const struct work *w) {
  const struct lod_mesh *mesh = w->mesh;
  const struct lod_adjacency *adjacency = w->adjacency;
  uint32_t *up = lod_sets_create(w->scratch, mesh->vertex_count), *border = lod_sets_create(w->scratch, mesh->vertex_count);
  uint8_t *on_border = LOD_NEW_ZERO(w->scratch, mesh->vertex_count, uint8_t);
  if (up == NULL || border == NULL || on_border == NULL)
    return false;
  for (uint32_t e = 0; e < adjacency->edge_count; e++) {
    uint32_t first = adjacency->edge_begin[e], h = adjacency->edge_half_edges[first];
    uint32_t a = lod_half_edge_start(mesh, h), b = lod_half_edge_end(mesh, h);
    lod_sets_join(up, a, b);
    if (adjacency->edge_begin[e + 1] == first + 1) {
      lod_sets_join(border, a, b);
      on_border[a] = on_border[b] = 1;
    }
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    w->out->components += adjacency->vertex_begin[v] < adjacency->vertex_begin[v + 1] && lod_sets_find(up, v) == v;
    w->out->boundary_loops += on_border[v] && lod_sets_find(border, v) == v;
  }
  return true;
}

/* A vertex whose fans are joined by an edge where adjacency cut the surface is no bow tie: only what hangs by the vertex alone is. */
static bool count_bow_ties(const struct work *w) {
  const struct lod_adjacency *adjacency = w->adjacency;
  uint32_t *up = lod_sets_create(w->scratch, adjacency->fan_count);
  if (up == NULL)
    return false;
  for (uint32_t e = 0; e < adjacency->edge_count; e++) {
    const uint32_t *sides = &adjacency->edge_half_edges[adjacency->edge_begin[e]];
    uint32_t count = adjacency->edge_begin[e + 1] - adjacency->edge_begin[e], start = lod_half_edge_start(w->mesh, sides[0]);
    for (uint32_t i = 1; i < count && adjacency->twin[sides[0]] == LOD_NONE; i++) {
      bool same_way = lod_half_edge_start(w->mesh, sides[i]) == start;
      uint32_t next = lod_half_edge_next(sides[i]), first_next = lod_half_edge_next(sides[0]);
      lod_sets_join(up, adjacency->fan_of[sides[0]], adjacency->fan_of[same_way ? sides[i] : next]);
      lod_sets_join(up, adjacency->fan_of[first_next], adjacency->fan_of[same_way ? next : sides[i]]);
    }
  }
  for (uint32_t f = 0; f < adjacency->fan_count;) {
    uint32_t vertex = adjacency->fan_vertex[f], sets = 0;
    for (; f < adjacency->fan_count && adjacency->fan_vertex[f] == vertex; f++)
      sets += lod_sets_find(up, f) == f;
    w->out->non_manifold_vertices += sets > 1;
  }
  return true;
}

/* Every triangle is two nodes, as it is and turned over; an edge of two triangles joins those that fit. When a triangle lands in one set
 * with its own other side, the surface is a Moebius strip somewhere. */
static bool find_orientability(const struct work *w) {
  const struct lod_adjacency *adjacency = w->adjacency;
  w->out->orientable = true;
  if (w->out->misoriented_edges == 0)
    return true;
  if (w->mesh->triangle_count > UINT32_MAX / 2)
    return false;
  uint32_t *up = lod_sets_create(w->scratch, 2 * w->mesh->triangle_count);
  if (up == NULL)
    return false;
  for (uint32_t e = 0; e < adjacency->edge_count; e++) {
    const uint32_t *sides = &adjacency->edge_half_edges[adjacency->edge_begin[e]];
    if (adjacency->edge_begin[e + 1] - adjacency->edge_begin[e] != 2)
      continue;
    uint32_t a = sides[0] / 3 * 2, b = sides[1] / 3 * 2, turned = adjacency->twin[sides[0]] == LOD_NONE;
    lod_sets_join(up, a, b + turned);
    lod_sets_join(up, a + 1, b + 1 - turned);
  }
  for (uint32_t t = 0; t < w->mesh->triangle_count && w->out->orientable; t++)
    w->out->orientable = lod_sets_find(up, 2 * t) != lod_sets_find(up, 2 * t + 1);
  return true;
}

struct pair {
  uint32_t middle, high; /* the triangle's other vertices, above the bucket's */
};

static int compare_pairs(const void *left, const void *right) {
  const struct pair *a = left, *b = right;
  if (a->middle != b->middle)
    return a->middle < b->middle ? -1 : 1;
  return (a->high > b->high) - (a->high < b->high);
}

static bool is_degenerate(const uint32_t t[3]) {
  return t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
}

static void sort_three(const uint32_t t[3], uint32_t sorted[3]) {
  uint32_t low = t[0] < t[1] ? t[0] : t[1], high = t[0] < t[1] ? t[1] : t[0];
  sorted[0] = t[2] < low ? t[2] : low;
  sorted[2] = t[2] > high ? t[2] : high;
  sorted[1] = t[2] < low ? low : t[2] > high ? high : t[2];
}

/* Buckets triangles at their lowest vertex and sorts the small buckets. */
static bool count_duplicates(const struct work *w) {
  const struct lod_mesh *mesh = w->mesh;
  uint32_t *begin = LOD_NEW_ZERO(w->scratch, (size_t)mesh->vertex_count + 2, uint32_t), sorted[3];
  struct pair *pairs = LOD_NEW(w->scratch, mesh->triangle_count, struct pair);
  if (begin == NULL || pairs == NULL)
    return false;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    sort_three(mesh->triangles[t], sorted);
    if (!is_degenerate(sorted))
      begin[(size_t)sorted[0] + 2]++;
  }
  for (uint32_t v = 0; v <= mesh->vertex_count; v++)
    begin[v + 1] += begin[v];
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    sort_three(mesh->triangles[t], sorted);
    if (!is_degenerate(sorted))
      pairs[begin[(size_t)sorted[0] + 1]++] = (struct pair){sorted[1], sorted[2]};
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    if (begin[v + 1] - begin[v] > 1)
      qsort(&pairs[begin[v]], begin[v + 1] - begin[v], sizeof *pairs, compare_pairs);
    for (uint32_t i = begin[v] + 1; i < begin[v + 1]; i++)
      w->out->duplicate_triangles += compare_pairs(&pairs[i - 1], &pairs[i]) == 0;
  }
  return true;
}

static void count_zero_areas(const struct work *w) {
  const struct lod_mesh *mesh = w->mesh;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (is_degenerate(mesh->triangles[t]))
      continue;
    struct lod_vec3 a = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
    struct lod_vec3 b = lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]);
    struct lod_vec3 c = lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]);
    double area = lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a))) / 2;
    double longest = fmax(lod_vec3_distance_squared(b, c), fmax(lod_vec3_distance_squared(a, c), lod_vec3_distance_squared(a, b)));
    w->out->zero_area_triangles += !(area > 1e-12 * longest);
  }
}

static bool count_vertices(const struct work *w, uint32_t *taking_part) {
  uint8_t *used = LOD_NEW_ZERO(w->scratch, w->mesh->vertex_count, uint8_t);
  if (used == NULL)
    return false;
  for (uint32_t t = 0; t < w->mesh->triangle_count; t++)
    for (int c = 0; c < 3; c++)
      used[w->mesh->triangles[t][c]] = 1;
  *taking_part = 0;
  for (uint32_t v = 0; v < w->mesh->vertex_count; v++) {
    w->out->vertices += used[v];
    *taking_part += w->adjacency->vertex_begin[v] < w->adjacency->vertex_begin[v + 1];
  }
  return true;
}

static bool measure(const struct work *w) {
  const struct lod_adjacency *adjacency = w->adjacency;
  struct lod_topology *out = w->out;
  uint32_t taking_part;
  *out = (struct lod_topology){.triangles = w->mesh->triangle_count,
                               .edges = adjacency->edge_count,
                               .boundary_edges = adjacency->boundary_edges,
                               .non_manifold_edges = adjacency->non_manifold_edges,
                               .misoriented_edges = adjacency->misoriented_edges,
                               .degenerate_triangles = adjacency->degenerate_triangles};
  if (!count_vertices(w, &taking_part) || !count_components(w) || !count_bow_ties(w) || !find_orientability(w) || !count_duplicates(w))
    return false;
  count_zero_areas(w);
  out->euler = (int64_t)taking_part - out->edges + (out->triangles - out->degenerate_triangles);
  out->manifold = out->non_manifold_edges == 0 && out->non_manifold_vertices == 0;
  out->closed = out->boundary_edges == 0;
  out->oriented = out->misoriented_edges == 0 && out->non_manifold_edges == 0;
  out->has_genus = out->manifold && out->misoriented_edges == 0;
  /* Euler-Poincare: chi = 2 components - 2 genus - loops. */
  if (out->has_genus)
    out->genus = (2 * (int64_t)out->components - out->boundary_loops - out->euler) / 2;
  return true;
}

enum lod_status lod_topology_measure(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, struct lod_arena *arena,
                                     struct lod_topology *topology) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency own;
  if (scratch == NULL)
    return LOD_MEMORY;
  bool ok = true;
  if (adjacency == NULL) {
    ok = lod_adjacency_create(mesh, scratch, &own) == LOD_OK;
    adjacency = &own;
  }
  struct work work = {mesh, adjacency, scratch, topology};
  ok = ok && measure(&work);
  lod_arena_destroy(scratch);
  return ok ? LOD_OK : LOD_MEMORY;
}
