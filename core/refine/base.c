/* What the rules need to know of a base mesh: edges, which are sharp, what rule each vertex has, its neighbours in order, its wedges. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh/feature.h"
#include "core/refine/internal.h"

/* ---- boundaries that touch ---- */

struct cell {
  int64_t x, y, z;
  uint32_t vertex;
};

static int compare_cells(const void *left, const void *right) {
  const struct cell *a = left, *b = right;
  if (a->x != b->x)
    return a->x < b->x ? -1 : 1;
  if (a->y != b->y)
    return a->y < b->y ? -1 : 1;
  if (a->z != b->z)
    return a->z < b->z ? -1 : 1;
  return a->vertex < b->vertex ? -1 : a->vertex > b->vertex;
}

static struct cell cell_of(const float p[3], double size, uint32_t vertex) {
  return (struct cell){(int64_t)floor((double)p[0] / size), (int64_t)floor((double)p[1] / size), (int64_t)floor((double)p[2] / size),
                       vertex};
}

/* The lowest vertex in the cells around `at` that leads (to[] says itself) and lies within `touch`; LOD_NONE when none. */
static uint32_t find_leader(const struct lod_mesh *mesh, const struct cell *cells, uint32_t count, struct cell at, double touch,
                            const uint32_t *to) {
  uint32_t best = LOD_NONE;
  struct lod_vec3 p = lod_vec3_from_float(mesh->positions[at.vertex]);
  for (int64_t x = at.x - 1; x <= at.x + 1; x++)
    for (int64_t y = at.y - 1; y <= at.y + 1; y++) {
      struct cell key = {x, y, at.z - 1, 0};
      uint32_t low = 0, high = count;
      while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (compare_cells(&cells[middle], &key) < 0)
          low = middle + 1;
        else
          high = middle;
      }
      for (; low < count && cells[low].x == x && cells[low].y == y && cells[low].z <= at.z + 1; low++) {
        uint32_t v = cells[low].vertex;
        if (v < at.vertex && v < best && to[v] == v &&
            lod_vec3_distance_squared(p, lod_vec3_from_float(mesh->positions[v])) <= touch * touch)
          best = v;
      }
    }
  return best;
}

/* Replaces mesh->triangles by ones in which boundary vertices within `touch` of each other are the lowest of them. */
static enum lod_status weld_boundaries(struct lod_mesh *mesh, double touch, struct lod_arena *arena) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct lod_adjacency adjacency;
  enum lod_status status = lod_adjacency_create(mesh, scratch, &adjacency);
  uint32_t *to = LOD_NEW(scratch, mesh->vertex_count, uint32_t), count = 0;
  bool *boundary = LOD_NEW_ZERO(scratch, mesh->vertex_count, bool);
  struct cell *cells = LOD_NEW(scratch, mesh->vertex_count, struct cell);
  uint32_t(*triangles)[3] = lod_arena_alloc(arena, mesh->triangle_count, sizeof *triangles);
  if (status == LOD_OK && (to == NULL || boundary == NULL || cells == NULL || triangles == NULL))
    status = LOD_MEMORY;
  if (status != LOD_OK) {
    lod_arena_destroy(scratch);
    return status;
  }
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
    if (adjacency.edge_of[h] != LOD_NONE && adjacency.twin[h] == LOD_NONE)
      boundary[lod_half_edge_start(mesh, h)] = boundary[lod_half_edge_end(mesh, h)] = true;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    to[v] = v;
    if (boundary[v])
      cells[count++] = cell_of(mesh->positions[v], touch, v);
  }
  struct cell *sorted = LOD_NEW(scratch, count, struct cell);
  if (sorted == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  memcpy(sorted, cells, count * sizeof *cells);
  qsort(sorted, count, sizeof *sorted, compare_cells);
  for (uint32_t i = 0; i < count; i++) { /* ascending, so that leaders are settled before their followers */
    uint32_t leader = find_leader(mesh, sorted, count, cells[i], touch, to);
    if (leader != LOD_NONE)
      to[cells[i].vertex] = leader;
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      triangles[t][k] = to[mesh->triangles[t][k]];
  mesh->triangles = triangles;
  lod_arena_destroy(scratch);
  return LOD_OK;
}

/* ---- edges ---- */

static bool make_edges(struct refine_base *b, struct lod_arena *arena) {
  const struct lod_adjacency *adjacency = &b->adjacency;
  uint32_t half_edges = 3 * b->mesh.triangle_count;
  b->edge_of = LOD_NEW(arena, half_edges, uint32_t);
  b->edge_half = LOD_NEW(arena, half_edges, uint32_t);
  b->edge_sibling = LOD_NEW(arena, half_edges, uint32_t);
  b->edge_sharp = LOD_NEW_ZERO(arena, half_edges, bool);
  b->edge_split = LOD_NEW_ZERO(arena, half_edges, bool);
  if (b->edge_of == NULL || b->edge_half == NULL || b->edge_sibling == NULL || b->edge_sharp == NULL || b->edge_split == NULL)
    return false;
  for (uint32_t h = 0; h < half_edges; h++) {
    uint32_t twin = adjacency->twin[h];
    b->edge_of[h] = LOD_NONE;
    if (adjacency->edge_of[h] == LOD_NONE)
      continue;
    b->edge_of[h] = twin != LOD_NONE && twin < h ? b->edge_of[twin] : b->edge_count;
    if (b->edge_of[h] == b->edge_count)
      b->edge_half[b->edge_count++] = h;
  }
  for (uint32_t i = 0; i < adjacency->edge_count; i++) { /* those between the same two vertices in a ring */
    uint32_t begin = adjacency->edge_begin[i], end = adjacency->edge_begin[i + 1], first = LOD_NONE, last = LOD_NONE;
    for (uint32_t j = begin; j < end; j++) {
      uint32_t e = b->edge_of[adjacency->edge_half_edges[j]];
      if (b->edge_half[e] != adjacency->edge_half_edges[j])
        continue; /* a twin's second */
      if (first == LOD_NONE)
        first = e;
      else
        b->edge_sibling[last] = e;
      last = e;
    }
    b->edge_sibling[last] = first;
  }
  return true;
}

static bool wedges_differ(const struct lod_mesh *mesh, uint32_t h, uint32_t twin) {
  return mesh->corners != NULL && (mesh->corners[h / 3][h % 3] != mesh->corners[twin / 3][(twin % 3 + 1) % 3] ||
                                   mesh->corners[h / 3][(h % 3 + 1) % 3] != mesh->corners[twin / 3][twin % 3]);
}

/* Normals of the base are not carried (the limit has its own), so a wedge that differs in its normal alone is no seam. */
static bool attributes_differ(const struct lod_mesh *mesh, uint32_t h, uint32_t twin) {
  if (!wedges_differ(mesh, h, twin))
    return false;
  for (int end = 0; end < 2; end++) {
    uint32_t a = mesh->corners[h / 3][(h % 3 + (uint32_t)end) % 3], c = mesh->corners[twin / 3][(twin % 3 + 1 - (uint32_t)end) % 3];
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (mesh->uvs[set] != NULL && memcmp(mesh->uvs[set][a], mesh->uvs[set][c], sizeof mesh->uvs[set][a]) != 0)
        return true;
    if (mesh->colors != NULL && memcmp(mesh->colors[a], mesh->colors[c], sizeof mesh->colors[a]) != 0)
      return true;
  }
  return false;
}

static enum lod_status tag_edges(struct refine_base *b, const struct lod_refine_settings *settings, struct lod_arena *arena,
                                 struct lod_features *features) {
  struct lod_feature_settings wanted = lod_feature_defaults();
  wanted.crease_degrees = settings->crease_degrees;
  wanted.corner_degrees = settings->corner_degrees;
  wanted.flags = LOD_FEATURE_BOUNDARY | LOD_FEATURE_NON_MANIFOLD;
  if (settings->crease_degrees < 180)
    wanted.flags |= LOD_FEATURE_CREASE;
  if (settings->sharp_borders)
    wanted.flags |= LOD_FEATURE_MATERIAL;
  LOD_TRY(lod_feature_find(&b->mesh, &b->adjacency, &wanted, arena, features));
  for (uint32_t e = 0; e < b->edge_count; e++) {
    uint32_t h = b->edge_half[e], twin = b->adjacency.twin[h];
    b->edge_sharp[e] = twin == LOD_NONE || features->edges[b->adjacency.edge_of[h]] != 0;
    b->edge_split[e] = b->edge_sharp[e] || (twin != LOD_NONE && attributes_differ(&b->mesh, h, twin));
  }
  return LOD_OK;
}

/* ---- vertices ---- */

static uint32_t corner_edge(const struct refine_base *b, uint32_t corner) {
  return b->edge_of[corner];
}

/* Spokes of v behind b->spokes[at]; each edge once. Returns how many. */
static uint32_t list_spokes(struct refine_base *b, uint32_t v, uint32_t at, bool write) {
  const struct lod_adjacency *adjacency = &b->adjacency;
  uint32_t count = 0;
  for (uint32_t i = adjacency->vertex_begin[v]; i < adjacency->vertex_begin[v + 1]; i++) {
    uint32_t corner = adjacency->vertex_corners[i];
    if (write)
      b->spokes[at + count] = corner_edge(b, corner);
    count++;
    bool ends = lod_corner_left(adjacency, corner) == LOD_NONE;
    if (ends) {
      if (write)
        b->spokes[at + count] = corner_edge(b, lod_half_edge_previous(corner));
      count++;
    }
  }
  return count;
}

static void set_rule(struct refine_base *b, uint32_t v, const struct lod_features *features, bool corners) {
  const struct lod_adjacency *adjacency = &b->adjacency;
  uint32_t sharp = 0, begin = b->spoke_begin[v], end = b->spoke_begin[v + 1];
  for (uint32_t i = begin; i < end; i++)
    if (b->edge_sharp[b->spokes[i]]) {
      if (sharp < 2)
        b->sharp_spokes[v][sharp] = b->spokes[i];
      sharp++;
    }
  uint32_t first = adjacency->vertex_begin[v], last = adjacency->vertex_begin[v + 1];
  bool one_fan =
      first < last && adjacency->fan_of[adjacency->vertex_corners[first]] == adjacency->fan_of[adjacency->vertex_corners[last - 1]];
  bool corner = sharp > 2 || (sharp == 2 && corners && features->corners[v]);
  if (sharp == 2 && b->adjacency.edge_of[b->edge_half[b->sharp_spokes[v][0]]] == b->adjacency.edge_of[b->edge_half[b->sharp_spokes[v][1]]])
    corner = true; /* a strip whose two ends meet the wrong way round: one line comes, none goes on */
  if (!one_fan || end - begin > REFINE_MAX_VALENCE || end - begin < 2 || corner)
    b->rule[v] = REFINE_CORNER;
  else if (sharp == 2)
    b->rule[v] = REFINE_CREASE;
  else
    b->rule[v] = end - begin < 3 ? REFINE_CORNER : REFINE_SMOOTH; /* two triangles back to back */
  b->dart[v] = sharp == 1 && b->rule[v] == REFINE_SMOOTH;
}

static bool make_vertices(struct refine_base *b, const struct lod_features *features, bool corners, struct lod_arena *arena) {
  uint32_t count = b->mesh.vertex_count;
  b->spoke_begin = LOD_NEW(arena, (size_t)count + 1, uint32_t);
  b->rule = LOD_NEW_ZERO(arena, count, uint8_t);
  b->dart = LOD_NEW_ZERO(arena, count, bool);
  b->points = lod_arena_alloc(arena, count, sizeof *b->points);
  b->sharp_spokes = lod_arena_alloc(arena, count, sizeof *b->sharp_spokes);
  if (b->spoke_begin == NULL || b->rule == NULL || b->dart == NULL || b->points == NULL || b->sharp_spokes == NULL)
    return false;
  b->spoke_begin[0] = 0;
  for (uint32_t v = 0; v < count; v++)
    b->spoke_begin[v + 1] = b->spoke_begin[v] + list_spokes(b, v, 0, false);
  b->spokes = LOD_NEW(arena, b->spoke_begin[count], uint32_t);
  if (b->spokes == NULL)
    return false;
  for (uint32_t v = 0; v < count; v++) {
    list_spokes(b, v, b->spoke_begin[v], true);
    set_rule(b, v, features, corners);
    for (int k = 0; k < 3; k++)
      b->points[v][k] = refine_snap1(b->grid, (double)b->mesh.positions[v][k]);
  }
  return true;
}

/* ---- wedges ---- */

/* Corners at one vertex that no split edge parts share a wedge; the first of them in the fan's order stands for all. */
static bool group_corners(struct refine_base *b, struct lod_arena *arena) {
  const struct lod_adjacency *adjacency = &b->adjacency;
  b->corner_group = LOD_NEW(arena, (size_t)3 * b->mesh.triangle_count, uint32_t);
  if (b->corner_group == NULL)
    return false;
  for (uint32_t c = 0; c < 3 * b->mesh.triangle_count; c++)
    b->corner_group[c] = LOD_NONE;
  for (uint32_t v = 0; v < b->mesh.vertex_count; v++) {
    for (uint32_t i = adjacency->vertex_begin[v]; i < adjacency->vertex_begin[v + 1]; i++) {
      uint32_t start = adjacency->vertex_corners[i];
      if (b->corner_group[start] != LOD_NONE)
        continue;
      uint32_t first = start; /* clockwise to the split edge, or around */
      while (!b->edge_split[corner_edge(b, first)]) {
        uint32_t right = lod_corner_right(adjacency, first);
        if (right == LOD_NONE || right == start)
          break;
        first = right;
      }
      for (uint32_t c = first;;) {
        b->corner_group[c] = first;
        if (b->edge_split[corner_edge(b, lod_half_edge_previous(c))])
          break;
        c = lod_corner_left(adjacency, c);
        if (c == LOD_NONE || c == first)
          break;
      }
    }
  }
  return true;
}

enum lod_status refine_base_create(const struct lod_mesh *mesh, const struct lod_refine_settings *settings, struct lod_arena *arena,
                                   struct refine_base *b, struct lod_problem *problem) {
  *b = (struct refine_base){.mesh = *mesh};
  if (mesh->triangle_count > 1u << 28)
    return lod_fail(problem, LOD_LIMIT, "refine-size", "A base of %u triangles is too large to refine; the limit is %u.",
                    mesh->triangle_count, 1u << 28);
  double magnitude = lod_mesh_magnitude(mesh);
  b->grid = refine_grid_for(magnitude);
  if (settings->touch > magnitude * 0x1p-40 && weld_boundaries(&b->mesh, settings->touch, arena) != LOD_OK)
    return lod_fail_memory(problem);
  struct lod_features features;
  if (lod_adjacency_create(&b->mesh, arena, &b->adjacency) != LOD_OK || !make_edges(b, arena) ||
      tag_edges(b, settings, arena, &features) != LOD_OK || !make_vertices(b, &features, settings->corner_degrees < 180, arena) ||
      !group_corners(b, arena))
    return lod_fail_memory(problem);
  for (uint32_t n = 3; n < REFINE_TABLE; n++) {
    b->move[n] = refine_vertex_weights(n);
    b->limit[n] = refine_limit_weights(n);
  }
  b->triangles = mesh->triangle_count - b->adjacency.degenerate_triangles;
  return LOD_OK;
}
