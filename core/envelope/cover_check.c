/* The validator (Varshney et al. 1995, 3.2). */
#include <math.h>

#include "core/envelope/cover.h"
#include "core/mesh/intersect.h"
#include "core/mesh/topology.h"

struct boundary {
  const struct lod_mesh *mesh;
  const struct lod_adjacency *adjacency;
  uint32_t *edges; /* half-edges at the boundary */
  uint32_t count;
};

static struct lod_vec3 corner(const struct lod_mesh *mesh, uint32_t v) {
  return lod_vec3_from_float(mesh->positions[v]);
}

/* Whether p lies on the segment, within a millionth of its length, away from its ends. */
static bool on_segment(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a), ap = lod_vec3_subtract(p, a);
  double squared = lod_vec3_length_squared(ab), along = lod_vec3_dot(ap, ab);
  if (!(along > 1e-6 * squared && along < (1 - 1e-6) * squared))
    return false;
  return lod_vec3_distance_squared(ap, lod_vec3_scale(ab, along / squared)) <= 1e-12 * squared;
}

/* T-junctions: ends of boundary edges in the middle of another. Cracks: boundary edges whose ends are in the same places, or near them,
 * but other vertices. Quadratic in the boundary, which parts of this size can afford. */
static void check_boundary(const struct boundary *b, struct lod_cover_check *check) {
  for (uint32_t i = 0; i < b->count; i++) {
    uint32_t p = lod_half_edge_start(b->mesh, b->edges[i]), q = lod_half_edge_end(b->mesh, b->edges[i]);
    struct lod_vec3 at = corner(b->mesh, p), to = corner(b->mesh, q);
    bool junction = false;
    for (uint32_t j = 0; j < b->count; j++) {
      uint32_t r = lod_half_edge_start(b->mesh, b->edges[j]), s = lod_half_edge_end(b->mesh, b->edges[j]);
      if (r != p && s != p)
        junction = junction || on_segment(at, corner(b->mesh, r), corner(b->mesh, s));
      if (j <= i || p == r || p == s || q == r || q == s)
        continue;
      double near = 1e-12 * lod_vec3_distance_squared(at, to);
      check->cracks +=
          lod_vec3_distance_squared(at, corner(b->mesh, s)) <= near && lod_vec3_distance_squared(to, corner(b->mesh, r)) <= near;
    }
    check->t_junctions += junction;
  }
}

static enum lod_status judge(const struct lod_cover_check *check, struct lod_problem *problem) {
  if (check->degenerate_triangles + check->duplicate_triangles != 0)
    return lod_fail(
        problem, LOD_BAD_INPUT, "degenerate-triangles",
        "The cover needs triangles with three different vertices, each once; %u name one twice and %u are there more than once.",
        check->degenerate_triangles, check->duplicate_triangles);
  if (check->non_manifold_edges + check->misoriented_edges != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "not-a-surface",
                    "The cover needs edges of one or two triangles that face the same way; %u edges have more and %u have opposed ones.",
                    check->non_manifold_edges, check->misoriented_edges);
  return LOD_OK;
}

static enum lod_status measure(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *scratch,
                               struct lod_cover_check *check) {
  struct lod_adjacency adjacency;
  struct lod_topology topology;
  struct lod_offset offset;
  struct lod_crossings crossings;
  LOD_TRY(lod_adjacency_create(mesh, scratch, &adjacency));
  LOD_TRY(lod_topology_measure(mesh, &adjacency, scratch, &topology));
  LOD_TRY(lod_offset_directions(mesh, &adjacency, crease_degrees, scratch, &offset));
  LOD_TRY(lod_intersect_count(mesh, NULL, scratch, NULL, &crossings));
  check->degenerate_triangles = topology.degenerate_triangles;
  check->zero_area_triangles = topology.zero_area_triangles;
  check->duplicate_triangles = topology.duplicate_triangles;
  check->non_manifold_edges = topology.non_manifold_edges;
  check->misoriented_edges = topology.misoriented_edges;
  check->cut_vertices = adjacency.cut_vertices;
  check->crossing_pairs = crossings.pairs > UINT32_MAX ? UINT32_MAX : (uint32_t)crossings.pairs;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    if (adjacency.vertex_begin[v] == adjacency.vertex_begin[v + 1])
      continue;
    check->vertices_hidden += !(lod_vec3_length_squared(offset.direction[v]) > 0);
    check->vertices_several_normals += offset.several[v];
    check->vertices_one_normal += !offset.several[v];
  }
  struct boundary boundary = {.mesh = mesh, .adjacency = &adjacency, .edges = LOD_NEW(scratch, 3 * (size_t)mesh->triangle_count, uint32_t)};
  if (boundary.edges == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
    uint32_t e = adjacency.edge_of[h];
    if (e != LOD_NONE && adjacency.edge_begin[e + 1] - adjacency.edge_begin[e] == 1)
      boundary.edges[boundary.count++] = h;
  }
  check_boundary(&boundary, check);
  return LOD_OK;
}

enum lod_status lod_cover_validate(const struct lod_mesh *mesh, double crease_degrees, struct lod_arena *arena,
                                   struct lod_cover_check *check, struct lod_problem *problem) {
  *check = (struct lod_cover_check){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : measure(mesh, crease_degrees, scratch, check);
  lod_arena_destroy(scratch);
  return status == LOD_OK ? judge(check, problem) : lod_fail_memory(problem);
}
