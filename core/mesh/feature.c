#include "core/mesh/feature.h"

#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"

static const double kRadiansPerDegree = 3.14159265358979323846 / 180;

struct lod_feature_settings lod_feature_defaults(void) {
  return (struct lod_feature_settings){
      .crease_degrees = LOD_TOLERANCE_CREASE_DEGREES,
      .corner_degrees = 45,
      .flags = LOD_FEATURE_BOUNDARY | LOD_FEATURE_CREASE | LOD_FEATURE_MATERIAL | LOD_FEATURE_UV_SEAM | LOD_FEATURE_NON_MANIFOLD,
  };
}

struct finder {
  const struct lod_mesh *mesh;
  const struct lod_adjacency *adjacency;
  struct lod_feature_settings settings;
  struct lod_features *out;
};

static struct lod_vec3 position(const struct lod_mesh *mesh, uint32_t vertex) {
  return lod_vec3_from_float(mesh->positions[vertex]);
}

static struct lod_vec3 area_vector(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 a = position(mesh, mesh->triangles[t][0]);
  return lod_vec3_cross(lod_vec3_subtract(position(mesh, mesh->triangles[t][1]), a),
                        lod_vec3_subtract(position(mesh, mesh->triangles[t][2]), a));
}

/* Whether two vectors differ by more than the angle with this cosine; false when one of them is nothing. */
static bool turns_more(struct lod_vec3 a, struct lod_vec3 b, double cosine) {
  double lengths = lod_vec3_length(a) * lod_vec3_length(b);
  return lengths > 0 && lod_vec3_dot(a, b) < cosine * lengths;
}

/* h and o: the two half-edges of one edge. The same vertex of the edge is start of one and, as they should run, end of the other. */
static bool uv_jumps(const struct lod_mesh *mesh, uint32_t h, uint32_t o) {
  if (mesh->corners == NULL)
    return false;
  bool same_way = lod_half_edge_start(mesh, h) == lod_half_edge_start(mesh, o);
  uint32_t h_next = lod_half_edge_next(h), o_next = lod_half_edge_next(o);
  const uint32_t ends[2][2] = {{h, same_way ? o : o_next}, {h_next, same_way ? o_next : o}};
  for (int end = 0; end < 2; end++) {
    uint32_t a = mesh->corners[ends[end][0] / 3][ends[end][0] % 3], b = mesh->corners[ends[end][1] / 3][ends[end][1] % 3];
    for (int set = 0; set < LOD_UV_SETS && a != b; set++)
      if (mesh->uvs[set] != NULL && (mesh->uvs[set][a][0] != mesh->uvs[set][b][0] || mesh->uvs[set][a][1] != mesh->uvs[set][b][1]))
        return true;
  }
  return false;
}

static uint8_t flags_of_pair(const struct finder *f, uint32_t h, uint32_t o, double crease_cosine) {
  const struct lod_mesh *mesh = f->mesh;
  uint32_t s = h / 3, t = o / 3;
  uint8_t flags = 0;
  struct lod_vec3 a = area_vector(mesh, s), b = area_vector(mesh, t);
  if (f->adjacency->twin[h] == LOD_NONE)
    b = lod_vec3_scale(b, -1); /* turned over against its neighbour: the bend is the surface's, not the winding's */
  if (f->settings.crease_degrees < 180 && turns_more(a, b, crease_cosine))
    flags |= LOD_FEATURE_CREASE;
  if ((mesh->materials != NULL && mesh->materials[s] != mesh->materials[t]) || (mesh->parts != NULL && mesh->parts[s] != mesh->parts[t]))
    flags |= LOD_FEATURE_MATERIAL;
  if (uv_jumps(mesh, h, o))
    flags |= LOD_FEATURE_UV_SEAM;
  return flags;
}

static void mark_edges(const struct finder *f) {
  const struct lod_adjacency *adjacency = f->adjacency;
  double crease_cosine = cos(f->settings.crease_degrees * kRadiansPerDegree);
  for (uint32_t e = 0; e < adjacency->edge_count; e++) {
    const uint32_t *sides = &adjacency->edge_half_edges[adjacency->edge_begin[e]];
    uint32_t count = adjacency->edge_begin[e + 1] - adjacency->edge_begin[e];
    uint8_t flags = count == 1  ? LOD_FEATURE_BOUNDARY
                    : count > 2 ? LOD_FEATURE_NON_MANIFOLD
                                : flags_of_pair(f, sides[0], sides[1], crease_cosine);
    f->out->edges[e] = flags & (uint8_t)f->settings.flags;
    if (f->out->edges[e] == 0)
      continue;
    f->out->edge_count++;
    f->out->degree[lod_half_edge_start(f->mesh, sides[0])]++;
    f->out->degree[lod_half_edge_end(f->mesh, sides[0])]++;
  }
}

/* Feature edges at each vertex: of vertex v, edges[begin[v]] up to edges[begin[v + 1]], ascending. */
struct spokes {
  uint32_t *begin;
  uint32_t *edges;
  bool *taken; /* by edge */
};

static void ends_of(const struct finder *f, uint32_t edge, uint32_t ends[2]) {
  uint32_t h = f->adjacency->edge_half_edges[f->adjacency->edge_begin[edge]];
  ends[0] = lod_half_edge_start(f->mesh, h);
  ends[1] = lod_half_edge_end(f->mesh, h);
}

static uint32_t other_end(const struct finder *f, uint32_t edge, uint32_t vertex) {
  uint32_t ends[2];
  ends_of(f, edge, ends);
  return ends[0] == vertex ? ends[1] : ends[0];
}

static bool find_spokes(const struct finder *f, struct lod_arena *scratch, struct spokes *spokes) {
  uint32_t vertices = f->mesh->vertex_count;
  spokes->begin = LOD_NEW_ZERO(scratch, (size_t)vertices + 2, uint32_t);
  spokes->edges = LOD_NEW(scratch, 2 * (size_t)f->out->edge_count, uint32_t);
  spokes->taken = LOD_NEW_ZERO(scratch, f->adjacency->edge_count, bool);
  if (spokes->begin == NULL || spokes->edges == NULL || spokes->taken == NULL)
    return false;
  for (uint32_t v = 0; v < vertices; v++)
    spokes->begin[v + 2] = spokes->begin[v + 1] + f->out->degree[v];
  for (uint32_t e = 0; e < f->adjacency->edge_count; e++) {
    uint32_t ends[2];
    if (f->out->edges[e] == 0)
      continue;
    ends_of(f, e, ends);
    for (int k = 0; k < 2; k++)
      spokes->edges[spokes->begin[ends[k] + 1]++] = e;
  }
  return true;
}

static void find_corners(const struct finder *f, const struct spokes *spokes) {
  double cosine = cos(f->settings.corner_degrees * kRadiansPerDegree);
  for (uint32_t v = 0; v < f->mesh->vertex_count; v++) {
    uint32_t degree = f->out->degree[v];
    bool corner = degree != 0 && degree != 2;
    if (degree == 2) {
      const uint32_t *edges = &spokes->edges[spokes->begin[v]];
      struct lod_vec3 here = position(f->mesh, v);
      struct lod_vec3 in = lod_vec3_subtract(here, position(f->mesh, other_end(f, edges[0], v)));
      struct lod_vec3 out = lod_vec3_subtract(position(f->mesh, other_end(f, edges[1], v)), here);
      corner = turns_more(in, out, cosine);
    }
    f->out->corners[v] = corner;
    f->out->corner_count += corner;
  }
}

/* Writes the line that leaves `vertex` by `edge` and ends at the next corner or where it began; returns the new end of line_vertices. */
static uint32_t write_line(const struct finder *f, const struct spokes *spokes, uint32_t vertex, uint32_t edge, uint32_t at) {
  uint32_t start = vertex;
  uint8_t flags = 0xff;
  f->out->line_begin[f->out->line_count] = at;
  f->out->line_vertices[at++] = vertex;
  for (;;) {
    spokes->taken[edge] = true;
    flags &= f->out->edges[edge];
    vertex = other_end(f, edge, vertex);
    f->out->line_vertices[at++] = vertex;
    if (vertex == start || f->out->corners[vertex])
      break;
    const uint32_t *edges = &spokes->edges[spokes->begin[vertex]];
    edge = edges[0] == edge ? edges[1] : edges[0];
  }
  f->out->line_flags[f->out->line_count++] = flags;
  f->out->line_begin[f->out->line_count] = at;
  return at;
}

/* Lines from corners first, then those that go around without one. */
static bool find_lines(const struct finder *f, const struct spokes *spokes, struct lod_arena *arena) {
  struct lod_features *out = f->out;
  out->line_begin = LOD_NEW_ZERO(arena, (size_t)out->edge_count + 1, uint32_t);
  out->line_vertices = LOD_NEW(arena, 2 * (size_t)out->edge_count, uint32_t); /* a line of n edges has n + 1 vertices */
  out->line_flags = LOD_NEW(arena, out->edge_count, uint8_t);
  if (out->line_begin == NULL || out->line_vertices == NULL || out->line_flags == NULL)
    return false;
  uint32_t at = 0;
  for (int around = 0; around < 2; around++)
    for (uint32_t v = 0; v < f->mesh->vertex_count; v++)
      for (uint32_t i = spokes->begin[v]; i < spokes->begin[v + 1]; i++)
        if ((around || out->corners[v]) && !spokes->taken[spokes->edges[i]])
          at = write_line(f, spokes, v, spokes->edges[i], at);
  return true;
}

enum lod_status lod_feature_find(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency,
                                 const struct lod_feature_settings *settings, struct lod_arena *arena, struct lod_features *features) {
  struct lod_features out = {0};
  struct finder f = {mesh, adjacency, settings != NULL ? *settings : lod_feature_defaults(), &out};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct spokes spokes;
  out.edges = LOD_NEW_ZERO(arena, adjacency->edge_count, uint8_t);
  out.degree = LOD_NEW_ZERO(arena, mesh->vertex_count, uint32_t);
  out.corners = LOD_NEW_ZERO(arena, mesh->vertex_count, bool);
  bool ok = scratch != NULL && out.edges != NULL && out.degree != NULL && out.corners != NULL;
  if (ok) {
    mark_edges(&f);
    ok = find_spokes(&f, scratch, &spokes);
  }
  if (ok) {
    find_corners(&f, &spokes);
    ok = find_lines(&f, &spokes, arena);
  }
  lod_arena_destroy(scratch);
  if (!ok)
    return LOD_MEMORY;
  *features = out;
  return LOD_OK;
}
