/* A unit's level on its grid: positions rounded and welded, and what rounding made of triangles, edges and points. */
#include <math.h>
#include <string.h>

#include "codec/export/glb_private.h"

static uint64_t mix(uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9u;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebu;
  return x ^ x >> 31;
}

static size_t table_size(size_t entries) {
  size_t size = 16;
  while (size < 2 * entries)
    size *= 2;
  return size;
}

/* One grid for the whole unit, so that vertices that parts share stay shared. */
struct lod_draco_grid lod_glb_grid(const struct lod_mesh *mesh, double position_error) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  float min[3], max[3];
  for (int i = 0; i < 3; i++) {
    min[i] = (float)bounds.min[i];
    max[i] = (float)bounds.max[i];
  }
  /* Rounding moves each coordinate by at most step / 2, a position by at most sqrt(3) / 2 steps. */
  return lod_draco_grid_make(min, max, 3, position_error * 2 / sqrt(3.0) * (1 - 0x1p-40));
}

static enum lod_status weld(const struct lod_mesh *mesh, struct lod_arena *arena, struct glb_unit *unit, struct lod_problem *problem) {
  const size_t size = table_size(mesh->vertex_count);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *table = scratch == NULL ? NULL : LOD_NEW(scratch, size, uint32_t);
  unit->welded = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  unit->positions = lod_arena_alloc(arena, mesh->vertex_count, sizeof *unit->positions);
  if (table == NULL || unit->welded == NULL || unit->positions == NULL) {
    lod_arena_destroy(scratch);
    return lod_fail_memory(problem);
  }
  memset(table, 0xff, size * sizeof *table);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    int32_t q[3];
    for (int i = 0; i < 3; i++)
      q[i] = lod_draco_grid_index(&unit->grid, i, mesh->positions[v][i]);
    size_t slot = mix((uint64_t)q[0] | (uint64_t)q[1] << 24 | (uint64_t)q[2] << 48) ^ mix((uint64_t)q[2] + 1);
    for (slot &= size - 1; table[slot] != LOD_NONE && memcmp(unit->positions[table[slot]], q, sizeof q) != 0;
         slot = (slot + 1) & (size - 1)) {
    }
    if (table[slot] == LOD_NONE) {
      table[slot] = unit->vertex_count;
      memcpy(unit->positions[unit->vertex_count++], q, sizeof q);
    }
    unit->welded[v] = table[slot];
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

/* Segments that collapsed triangles left, by their ends. */
struct segments {
  size_t size;
  uint32_t (*ends)[2];  /* LOD_NONE = free slot */
  uint32_t *triangle;   /* which mesh triangle left it */
  uint8_t (*corner)[2]; /* its corners at the two ends */
  bool *covered;
};

static size_t segment_slot(const struct segments *set, uint32_t a, uint32_t b) {
  size_t slot = mix((uint64_t)a << 32 | b) & (set->size - 1);
  while (set->ends[slot][0] != LOD_NONE && (set->ends[slot][0] != a || set->ends[slot][1] != b))
    slot = (slot + 1) & (set->size - 1);
  return slot;
}

static void cover_segment(struct segments *set, uint32_t a, uint32_t b) {
  size_t slot = a < b ? segment_slot(set, a, b) : segment_slot(set, b, a);
  if (set->ends[slot][0] != LOD_NONE)
    set->covered[slot] = true;
}

static void corners_of(const struct glb_unit *unit, uint32_t triangle, uint32_t corner[3]) {
  for (int c = 0; c < 3; c++)
    corner[c] = unit->welded[unit->mesh->triangles[triangle][c]];
}

static enum lod_status segments_init(struct segments *set, const struct glb_unit *unit, const uint32_t *collapsed, uint32_t count,
                                     struct lod_arena *scratch) {
  set->size = table_size(count);
  set->ends = lod_arena_alloc(scratch, set->size, sizeof *set->ends);
  set->triangle = LOD_NEW(scratch, set->size, uint32_t);
  set->corner = lod_arena_alloc(scratch, set->size, sizeof *set->corner);
  set->covered = LOD_NEW_ZERO(scratch, set->size, bool);
  if (set->ends == NULL || set->triangle == NULL || set->corner == NULL || set->covered == NULL)
    return LOD_MEMORY;
  memset(set->ends, 0xff, set->size * sizeof *set->ends);
  for (uint32_t i = 0; i < count; i++) {
    uint32_t corner[3];
    corners_of(unit, collapsed[i], corner);
    int first = 0, second = corner[0] != corner[1] ? 1 : 2;
    if (corner[first] == corner[second])
      continue; /* a point */
    if (corner[first] > corner[second]) {
      int swap = first;
      first = second;
      second = swap;
    }
    size_t slot = segment_slot(set, corner[first], corner[second]);
    if (set->ends[slot][0] != LOD_NONE)
      continue;
    set->ends[slot][0] = corner[first];
    set->ends[slot][1] = corner[second];
    set->triangle[slot] = collapsed[i];
    set->corner[slot][0] = (uint8_t)first;
    set->corner[slot][1] = (uint8_t)second;
  }
  return LOD_OK;
}

static void add_edge(struct glb_unit *unit, struct glb_edge edge, bool *used) {
  used[edge.vertices[0]] = used[edge.vertices[1]] = true;
  unit->edges[unit->edge_count++] = edge;
}

/* The mesh's own edges; those that became points are kept for add_points. */
static void add_own_edges(struct glb_unit *unit, bool *used, struct segments *set) {
  const struct lod_mesh *mesh = unit->mesh;
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    uint32_t a = mesh->edges[e][0], b = mesh->edges[e][1];
    if (unit->welded[a] == unit->welded[b])
      continue;
    add_edge(unit,
             (struct glb_edge){.vertices = {unit->welded[a], unit->welded[b]},
                               .sources = {a, b},
                               .part = mesh->edge_parts != NULL ? mesh->edge_parts[e] : unit->only_part,
                               .material = mesh->edge_materials != NULL ? mesh->edge_materials[e] : LOD_NONE,
                               .thickness = mesh->edge_thickness != NULL ? mesh->edge_thickness[e] : 0},
             used);
    cover_segment(set, unit->welded[a], unit->welded[b]);
  }
}

static void add_collapsed_edges(struct glb_unit *unit, bool *used, const struct segments *set) {
  const struct lod_mesh *mesh = unit->mesh;
  for (size_t slot = 0; slot < set->size; slot++) {
    if (set->ends[slot][0] == LOD_NONE || set->covered[slot])
      continue;
    uint32_t t = set->triangle[slot];
    add_edge(unit,
             (struct glb_edge){.vertices = {set->ends[slot][0], set->ends[slot][1]},
                               .sources = {mesh->triangles[t][set->corner[slot][0]], mesh->triangles[t][set->corner[slot][1]]},
                               .part = glb_triangle_part(unit, t),
                               .material = glb_triangle_material(mesh, t)},
             used);
  }
}

static void add_points(struct glb_unit *unit, bool *used, const uint32_t *collapsed, uint32_t collapsed_count) {
  const struct lod_mesh *mesh = unit->mesh;
  for (uint32_t p = 0; p < mesh->point_count; p++) {
    uint32_t v = mesh->points[p];
    used[unit->welded[v]] = true;
    unit->points[unit->point_count++] = (struct glb_point){.vertex = unit->welded[v],
                                                           .source = v,
                                                           .part = mesh->point_parts != NULL ? mesh->point_parts[p] : unit->only_part,
                                                           .material = mesh->point_materials != NULL ? mesh->point_materials[p] : LOD_NONE,
                                                           .thickness = mesh->point_thickness != NULL ? mesh->point_thickness[p] : 0};
  }
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    uint32_t v = mesh->edges[e][0];
    float thickness = mesh->edge_thickness != NULL ? mesh->edge_thickness[e] : 0;
    if (unit->welded[v] != unit->welded[mesh->edges[e][1]] || (used[unit->welded[v]] && !(thickness > 0)))
      continue;
    used[unit->welded[v]] = true;
    unit->points[unit->point_count++] = (struct glb_point){.vertex = unit->welded[v],
                                                           .source = v,
                                                           .part = mesh->edge_parts != NULL ? mesh->edge_parts[e] : unit->only_part,
                                                           .material = mesh->edge_materials != NULL ? mesh->edge_materials[e] : LOD_NONE,
                                                           .thickness = thickness};
  }
  for (uint32_t i = 0; i < collapsed_count; i++) {
    uint32_t corner[3];
    corners_of(unit, collapsed[i], corner);
    if (used[corner[0]] || corner[0] != corner[1] || corner[0] != corner[2])
      continue;
    used[corner[0]] = true;
    unit->points[unit->point_count++] = (struct glb_point){.vertex = corner[0],
                                                           .source = mesh->triangles[collapsed[i]][0],
                                                           .part = glb_triangle_part(unit, collapsed[i]),
                                                           .material = glb_triangle_material(mesh, collapsed[i])};
  }
}

/* Edges and points, once triangles are split into whole and collapsed ones. */
static enum lod_status collect_rest(struct glb_unit *unit, const uint32_t *collapsed, uint32_t collapsed_count, struct lod_arena *scratch,
                                    struct lod_arena *arena) {
  const struct lod_mesh *mesh = unit->mesh;
  struct segments set;
  LOD_TRY(segments_init(&set, unit, collapsed, collapsed_count, scratch));
  bool *used = LOD_NEW_ZERO(scratch, unit->vertex_count, bool);
  /* In size_t: a sum of two counts may pass 32 bits where memory would not. */
  unit->edges = LOD_NEW(arena, (size_t)mesh->edge_count + collapsed_count, struct glb_edge);
  unit->points = LOD_NEW(arena, (size_t)mesh->point_count + mesh->edge_count + collapsed_count, struct glb_point);
  if (used == NULL || unit->edges == NULL || unit->points == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < unit->triangle_count; i++) {
    uint32_t corner[3];
    corners_of(unit, unit->triangles[i], corner);
    for (int c = 0; c < 3; c++) {
      used[corner[c]] = true;
      if (collapsed_count > 0)
        cover_segment(&set, corner[c], corner[(c + 1) % 3]);
    }
  }
  add_own_edges(unit, used, &set);
  add_collapsed_edges(unit, used, &set);
  add_points(unit, used, collapsed, collapsed_count);
  if (unit->edge_count + unit->point_count == 0 || mesh->wedge_count == 0)
    return LOD_OK;
  unit->first_wedge = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  if (unit->first_wedge == NULL)
    return LOD_MEMORY;
  memset(unit->first_wedge, 0xff, (size_t)mesh->vertex_count * sizeof *unit->first_wedge);
  for (uint32_t w = mesh->wedge_count; w-- > 0;)
    unit->first_wedge[mesh->wedge_vertex[w]] = w;
  return LOD_OK;
}

enum lod_status lod_glb_quantise(const struct lod_mesh *mesh, uint32_t only_part, double position_error, struct lod_arena *arena,
                                 struct glb_unit *unit, struct lod_problem *problem) {
  *unit = (struct glb_unit){.mesh = mesh, .only_part = only_part, .grid = lod_glb_grid(mesh, position_error)};
  LOD_TRY(weld(mesh, arena, unit, problem));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *collapsed = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, uint32_t);
  unit->triangles = LOD_NEW(arena, mesh->triangle_count, uint32_t);
  if (collapsed == NULL || unit->triangles == NULL) {
    lod_arena_destroy(scratch);
    return lod_fail_memory(problem);
  }
  uint32_t collapsed_count = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint32_t corner[3];
    corners_of(unit, t, corner);
    if (corner[0] == corner[1] || corner[1] == corner[2] || corner[2] == corner[0])
      collapsed[collapsed_count++] = t;
    else
      unit->triangles[unit->triangle_count++] = t;
  }
  enum lod_status status = collect_rest(unit, collapsed, collapsed_count, scratch, arena);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
