/* The C-Model of a mesh: a patch for every triangle (Gopi & Manocha 1998, 5.1), with adjacency, tangent planes and lines. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/base/tolerance.h"
#include "core/clod/internal.h"
#include "core/mesh/feature.h"

struct lod_clod_settings lod_clod_defaults(void) {
  return (struct lod_clod_settings){
      .crease_degrees = LOD_TOLERANCE_CREASE_DEGREES,
      .corner_degrees = 45,
      .crease_length = 0.1,
      .centre_weight = 0.02,
      .curve_weight = 0.02,
      .reparametrize = true,
  };
}

/* ---- memory ---- */

static uint32_t class_of(size_t bytes) {
  uint32_t c = 6; /* 64 bytes at least */
  while (((size_t)1 << c) < bytes)
    c++;
  return c;
}

void *clod_pool_take(struct clod_pool *pool, size_t bytes) {
  uint32_t c = class_of(bytes);
  void *block = pool->free[c];
  if (block != NULL) {
    memcpy(&pool->free[c], block, sizeof block);
    return block;
  }
  /* Small blocks come a page at a time. */
  size_t size = (size_t)1 << c, count = size < 4096 ? 16384 / size : 1;
  char *page = lod_arena_alloc(pool->arena, count, size);
  if (page == NULL)
    return NULL;
  for (size_t i = 1; i < count; i++)
    clod_pool_give(pool, page + i * size, bytes);
  return page;
}

void clod_pool_give(struct clod_pool *pool, void *block, size_t bytes) {
  uint32_t c = class_of(bytes);
  memcpy(block, &pool->free[c], sizeof block);
  pool->free[c] = block;
}

bool clod_grow(struct lod_arena *arena, void **array, uint32_t *room, uint32_t needed, size_t size) {
  if (needed <= *room)
    return true;
  uint64_t larger = (uint64_t)*room * 3 / 2 + 64;
  if (larger < needed)
    larger = needed;
  if (larger >= UINT32_MAX)
    return false;
  void *grown = lod_arena_alloc(arena, larger, size);
  if (grown == NULL)
    return false;
  if (*room > 0)
    memcpy(grown, *array, *room * size);
  *array = grown;
  *room = (uint32_t)larger;
  return true;
}

struct lod_bezier clod_net(const struct lod_clod *clod, const struct clod_patch *patch) {
  struct lod_bezier net;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = patch->sides[k];
    net.p[k] = clod->positions[patch->corners[k]];
    net.p[3 + 2 * k] = clod->edges[side >> 1].inner[side & 1];
    net.p[4 + 2 * k] = clod->edges[side >> 1].inner[1 - (side & 1)];
  }
  net.p[LOD_BEZIER_CENTRE] = patch->centre;
  return net;
}

/* ---- construction ---- */

struct builder {
  struct lod_clod *clod;
  const struct lod_mesh *mesh;
  struct lod_arena *scratch;
  struct lod_adjacency adjacency;
  struct lod_features features;
  uint32_t *patch_of; /* triangle -> patch or LOD_NONE */
  uint32_t *sector;   /* union-find over corners, then sector number */
};

static bool takes_part(const struct builder *b, uint32_t t) {
  return b->adjacency.edge_of[3 * t] != LOD_NONE;
}

static bool smooth_across(const struct builder *b, uint32_t h) {
  uint32_t edge = b->adjacency.edge_of[h];
  return b->adjacency.twin[h] != LOD_NONE && (b->features.edges[edge] & (LOD_FEATURE_CREASE | LOD_FEATURE_BOUNDARY)) == 0;
}

/* Corners between creases share a tangent plane: its normal is the sum of the faces' normals, each by its angle. */
static enum lod_status make_sectors(struct builder *b) {
  struct lod_clod *clod = b->clod;
  const struct lod_mesh *mesh = b->mesh;
  uint32_t corners = 3 * mesh->triangle_count;
  b->sector = LOD_NEW(b->scratch, corners, uint32_t);
  if (b->sector == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < corners; c++)
    b->sector[c] = c;
  for (uint32_t h = 0; h < corners; h++)
    if (takes_part(b, h / 3) && smooth_across(b, h)) {
      uint32_t twin = b->adjacency.twin[h];
      lod_sets_join(b->sector, h, lod_half_edge_next(twin));
      lod_sets_join(b->sector, lod_half_edge_next(h), twin);
    }
  uint32_t *number = LOD_NEW(b->scratch, corners, uint32_t);
  clod->sectors = LOD_NEW_ZERO(clod->arena, corners, struct lod_vec3);
  if (number == NULL || clod->sectors == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < corners; c++) {
    uint32_t root = lod_sets_find(b->sector, c); /* the lowest corner of its sector */
    number[c] = root == c ? clod->sector_count++ : number[root];
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (!takes_part(b, t))
      continue;
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
    struct lod_vec3 normal = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
    for (int k = 0; k < 3; k++) {
      struct lod_vec3 x = lod_vec3_normalize(lod_vec3_subtract(p[(k + 1) % 3], p[k]));
      struct lod_vec3 y = lod_vec3_normalize(lod_vec3_subtract(p[(k + 2) % 3], p[k]));
      double angle = acos(fmin(1, fmax(-1, lod_vec3_dot(x, y))));
      struct lod_vec3 *sum = &clod->sectors[number[3 * t + k]];
      *sum = lod_vec3_add_scaled(*sum, normal, angle);
    }
  }
  for (uint32_t s = 0; s < clod->sector_count; s++) {
    /* Faces that cancel have no tangent plane. */
    struct lod_vec3 sum = clod->sectors[s];
    clod->sectors[s] = lod_vec3_length(sum) > 0.05 ? lod_vec3_normalize(sum) : (struct lod_vec3){0, 0, 0};
  }
  memcpy(b->sector, number, corners * sizeof *number);
  return LOD_OK;
}

static void add_patch(struct builder *b, uint32_t t) {
  struct lod_clod *clod = b->clod;
  struct clod_patch *patch = &clod->patches[clod->patch_count];
  b->patch_of[t] = clod->patch_count++;
  *patch = (struct clod_patch){.died = UINT32_MAX,
                               .material = b->mesh->materials == NULL ? LOD_NONE : b->mesh->materials[t],
                               .part = b->mesh->parts == NULL ? 0 : b->mesh->parts[t]};
  for (uint32_t k = 0; k < 3; k++) {
    patch->corners[k] = b->adjacency.fan_of[3 * t + k];
    patch->sectors[k] = b->sector[3 * t + k];
    patch->wedges[k] = clod->attributes.width > 0 ? b->mesh->corners[t][k] : 0;
    clod->half[patch->corners[k]] = 3 * b->patch_of[t] + k;
  }
}

/* The edge's flags: lines are what must stay a line; an edge of one patch where the mesh has more is a cut. */
static uint32_t edge_flags(const struct builder *b, uint32_t h) {
  uint32_t edge = b->adjacency.edge_of[h], bits = b->features.edges[edge];
  uint32_t users = b->adjacency.edge_begin[edge + 1] - b->adjacency.edge_begin[edge];
  uint32_t flags = (bits & ~(uint32_t)LOD_FEATURE_UV_SEAM) != 0 ? CLOD_LINE : 0;
  if (!smooth_across(b, h))
    flags |= CLOD_SHARP;
  if (b->adjacency.twin[h] != LOD_NONE && clod_attributes_jump(b->clod, h, b->adjacency.twin[h]))
    flags |= CLOD_LINE;
  if (b->adjacency.twin[h] == LOD_NONE)
    flags |= CLOD_LINE | (users > 1 ? CLOD_FIXED : 0);
  return flags;
}

static void add_edge(struct builder *b, uint32_t h) {
  struct lod_clod *clod = b->clod;
  uint32_t twin = b->adjacency.twin[h], number = clod->edge_count++;
  struct clod_edge *edge = &clod->edges[number];
  uint32_t half = 3 * b->patch_of[h / 3] + h % 3;
  *edge = (struct clod_edge){.users = {half, LOD_NONE}, .flags = edge_flags(b, h)};
  edge->ends[0] = clod->patches[half / 3].corners[half % 3];
  edge->ends[1] = clod->patches[half / 3].corners[(half % 3 + 1) % 3];
  clod->patches[half / 3].sides[half % 3] = 2 * number;
  if (twin != LOD_NONE) {
    uint32_t other = 3 * b->patch_of[twin / 3] + twin % 3;
    edge->users[1] = other;
    clod->patches[other / 3].sides[other % 3] = 2 * number + 1;
  }
  struct lod_vec3 p[2] = {clod->positions[edge->ends[0]], clod->positions[edge->ends[1]]};
  for (int i = 0; i < 2; i++) {
    struct clod_end end = {.p = p[i]};
    if ((edge->flags & CLOD_SHARP) == 0)
      end.normal = clod_sector_normal(clod, clod->patches[half / 3].sectors[(half % 3 + (uint32_t)i) % 3]);
    edge->inner[i] = clod_inner_point(end, p[1 - i]);
  }
}

/* Lines bend as curves do: at a vertex where two edges of a line go on smoothly, both take the direction of its neighbours' chord. */
static void bend_lines(struct builder *b, const uint32_t *line_ends) {
  struct lod_clod *clod = b->clod;
  for (uint32_t v = 0; v < clod->vertex_count; v++) {
    if (clod->removable[v] != 2 || b->features.corners[b->adjacency.fan_vertex[v]])
      continue;
    struct clod_edge *edge[2];
    int at[2];
    struct lod_vec3 far[2];
    for (int i = 0; i < 2; i++) {
      edge[i] = &clod->edges[line_ends[2 * v + i] >> 1];
      at[i] = line_ends[2 * v + i] & 1;
      far[i] = clod->positions[edge[i]->ends[1 - at[i]]];
    }
    struct lod_vec3 tangent = lod_vec3_normalize(lod_vec3_subtract(far[1], far[0]));
    for (int i = 0; i < 2; i++)
      if ((edge[i]->flags & CLOD_SHARP) != 0) {
        struct lod_vec3 chord = lod_vec3_subtract(far[i], clod->positions[v]);
        edge[i]->inner[at[i]] = lod_vec3_add_scaled(clod->positions[v], tangent, lod_vec3_dot(chord, tangent) / 3);
      }
  }
}

/* Which vertices may go: 1 inside a smooth face, 2 on a line of two edges. Where a line turns sharply the error of a curve that cuts the
 * corner says when it may go. */
static enum lod_status mark_removable(struct builder *b) {
  struct lod_clod *clod = b->clod;
  uint32_t *line_ends = LOD_NEW_ZERO(b->scratch, 2 * (size_t)clod->vertex_count, uint32_t);
  uint8_t *lines = LOD_NEW_ZERO(b->scratch, clod->vertex_count, uint8_t);
  if (line_ends == NULL || lines == NULL)
    return LOD_MEMORY;
  bool *fixed = LOD_NEW_ZERO(b->scratch, clod->vertex_count, bool);
  if (fixed == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < clod->edge_count; e++)
    for (uint32_t i = 0; i < 2; i++) {
      uint32_t v = clod->edges[e].ends[i];
      fixed[v] = fixed[v] || (clod->edges[e].flags & CLOD_FIXED) != 0;
      if ((clod->edges[e].flags & CLOD_LINE) != 0) {
        if (lines[v] < 2)
          line_ends[2 * v + lines[v]] = 2 * e + i;
        lines[v] = lines[v] < 3 ? lines[v] + 1 : 3;
      }
    }
  const uint32_t *fan_vertex = b->adjacency.fan_vertex;
  for (uint32_t v = 0; v < clod->vertex_count; v++) {
    bool one_fan = (v == 0 || fan_vertex[v - 1] != fan_vertex[v]) && (v + 1 == clod->vertex_count || fan_vertex[v + 1] != fan_vertex[v]);
    clod->removable[v] = !one_fan || fixed[v] ? 0 : lines[v] == 0 ? 1 : lines[v] == 2 ? 2 : 0;
  }
  bend_lines(b, line_ends);
  return LOD_OK;
}

/* Square of the farthest that an inner control point is from the flat triangle's. */
static double largest_bulge(const struct lod_bezier *net) {
  struct lod_bezier flat = lod_bezier_flat(net->p[0], net->p[1], net->p[2]);
  double largest = 0;
  for (int i = 3; i < LOD_BEZIER_POINTS; i++)
    largest = fmax(largest, lod_vec3_distance_squared(net->p[i], flat.p[i]));
  return largest;
}

/* Centres: the first guess, then the point nearest to the three planes that neighbours ask for (5.1's second pass, regularised). */
static enum lod_status make_centres(struct builder *b) {
  struct lod_clod *clod = b->clod;
  struct lod_vec3 *first = LOD_NEW(b->scratch, clod->patch_count, struct lod_vec3);
  if (first == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    struct lod_bezier net = clod_net(clod, &clod->patches[p]);
    lod_bezier_set_centre(&net);
    first[p] = net.p[LOD_BEZIER_CENTRE];
  }
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    struct lod_bezier net = clod_net(clod, &clod->patches[p]);
    struct lod_vec3 neighbours[3];
    bool has[3];
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t across = clod_across(clod, 3 * p + k);
      has[k] = across != LOD_NONE && (clod->edges[clod->patches[p].sides[k] >> 1].flags & CLOD_SHARP) == 0;
      neighbours[k] = has[k] ? first[across / 3] : first[p];
    }
    net.p[LOD_BEZIER_CENTRE] = first[p];
    struct lod_bezier refined = net;
    refined.p[LOD_BEZIER_CENTRE] = lod_bezier_refine_centre(&net, neighbours, has, 0.01);
    /* Planes that are nearly parallel, or neighbours that fold, say little. */
    bool better = lod_vec3_distance_squared(refined.p[LOD_BEZIER_CENTRE], first[p]) < largest_bulge(&net);
    clod->patches[p].centre = better ? refined.p[LOD_BEZIER_CENTRE] : first[p];
  }
  return LOD_OK;
}

static bool is_folded(const struct lod_clod *clod, uint32_t p) {
  struct lod_bezier net = clod_net(clod, &clod->patches[p]);
  struct lod_vec3 axis;
  double sine;
  return !lod_bezier_normal_cone(&net, &axis, &sine);
}

static void bound_all(struct lod_clod *clod) {
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    struct clod_patch *patch = &clod->patches[p];
    struct lod_bezier net = clod_net(clod, patch);
    patch->bound = clod_patch_bound(clod, &net, patch->nodes, patch->cells, patch->cell_count, INFINITY);
  }
}

/* Every patch starts with its triangle as the one fragment. */
static enum lod_status make_fragments(struct builder *b) {
  struct lod_clod *clod = b->clod;
  clod->point_count = clod->point_room = clod->vertex_count;
  clod->points = LOD_NEW(clod->arena, clod->vertex_count, struct lod_vec3);
  if (clod->points == NULL)
    return LOD_MEMORY;
  memcpy(clod->points, clod->positions, clod->vertex_count * sizeof *clod->points);
  for (uint32_t t = 0; t < b->mesh->triangle_count; t++) {
    if (b->patch_of[t] == LOD_NONE)
      continue;
    struct clod_patch *patch = &clod->patches[b->patch_of[t]];
    patch->nodes = clod_pool_take(&clod->pool, 3 * sizeof *patch->nodes);
    patch->cells = clod_pool_take(&clod->pool, sizeof *patch->cells);
    if (patch->nodes == NULL || patch->cells == NULL)
      return LOD_MEMORY;
    patch->node_count = 3;
    patch->cell_count = 1;
    for (uint32_t k = 0; k < 3; k++)
      patch->nodes[k] = (struct clod_node){.v = k == 1, .w = k == 2, .id = patch->corners[k], .u0 = k != 0};
    patch->cells[0] = (struct clod_cell){{0, 1, 2}, t};
  }
  bound_all(clod);
  return LOD_OK;
}

static int compare_doubles(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* A few patches swell far more than the rest where the source's normals are poor, or fold. Their edges are drawn towards the chord until
 * they do not stand out: at most kSwell times the median. */
static enum lod_status flatten_swollen(struct builder *b) {
  enum { ROUNDS = 5 };
  static const double kSwell = 2;
  struct lod_clod *clod = b->clod;
  double *bounds = LOD_NEW(b->scratch, clod->patch_count, double);
  if (bounds == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < clod->patch_count; p++)
    bounds[p] = clod->patches[p].bound;
  qsort(bounds, clod->patch_count, sizeof *bounds, compare_doubles);
  double most = clod->patch_count == 0 ? 0 : kSwell * bounds[clod->patch_count / 2];
  bool *bad = LOD_NEW(b->scratch, clod->patch_count, bool);
  if (bad == NULL)
    return LOD_MEMORY;
  for (int round = 0; round < ROUNDS; round++) {
    bool any = false;
    for (uint32_t p = 0; p < clod->patch_count; p++)
      bad[p] = clod->patches[p].bound > most || is_folded(clod, p);
    for (uint32_t e = 0; e < clod->edge_count; e++) {
      struct clod_edge *edge = &clod->edges[e];
      bool swollen = false;
      for (int i = 0; i < 2; i++)
        swollen = swollen || (edge->users[i] != LOD_NONE && bad[edge->users[i] / 3]);
      any = any || swollen;
      for (int i = 0; i < 2 && swollen; i++) {
        struct lod_vec3 near = clod->positions[edge->ends[i]], far = clod->positions[edge->ends[1 - i]];
        struct lod_vec3 flat = lod_vec3_add_scaled(near, lod_vec3_subtract(far, near), 1.0 / 3);
        edge->inner[i] = lod_vec3_scale(lod_vec3_add(edge->inner[i], flat), 0.5);
      }
    }
    if (!any)
      break;
    LOD_TRY(make_centres(b));
    bound_all(clod);
  }
  return LOD_OK;
}

static enum lod_status allocate(struct builder *b) {
  struct lod_clod *clod = b->clod;
  uint32_t triangles = b->mesh->triangle_count;
  clod->vertex_count = b->adjacency.fan_count;
  clod->patch_room = triangles;
  clod->edge_room = 3 * triangles;
  clod->positions = LOD_NEW(clod->arena, clod->vertex_count, struct lod_vec3);
  clod->removable = LOD_NEW_ZERO(clod->arena, clod->vertex_count, uint8_t);
  clod->half = LOD_NEW(clod->arena, clod->vertex_count, uint32_t);
  clod->patches = LOD_NEW(clod->arena, clod->patch_room, struct clod_patch);
  clod->edges = LOD_NEW(clod->arena, clod->edge_room, struct clod_edge);
  b->patch_of = LOD_NEW(b->scratch, triangles, uint32_t);
  if (clod->positions == NULL || clod->removable == NULL || clod->half == NULL || clod->patches == NULL || clod->edges == NULL ||
      b->patch_of == NULL)
    return LOD_MEMORY;
  memset(b->patch_of, 0xff, triangles * sizeof *b->patch_of);
  memset(clod->half, 0xff, clod->vertex_count * sizeof *clod->half);
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    clod->positions[v] = lod_vec3_from_float(b->mesh->positions[b->adjacency.fan_vertex[v]]);
  return LOD_OK;
}

/* Creases that add up to less than `crease_length` of the diagonal, joined through vertices, are noise of a scan, not a shape: left alone
 * they would pin thousands of vertices. */
static enum lod_status dissolve_short_creases(struct builder *b) {
  const struct lod_mesh *mesh = b->mesh;
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double least = b->clod->settings.crease_length * lod_bounds_diagonal(&bounds);
  uint32_t *group = LOD_NEW(b->scratch, mesh->vertex_count, uint32_t);
  double *length = LOD_NEW_ZERO(b->scratch, mesh->vertex_count, double);
  if (group == NULL || length == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    group[v] = v;
  for (int pass = 0; pass < 3; pass++)
    for (uint32_t e = 0; e < b->adjacency.edge_count; e++) {
      if (b->features.edges[e] == 0)
        continue;
      uint32_t h = b->adjacency.edge_half_edges[b->adjacency.edge_begin[e]];
      uint32_t from = lod_half_edge_start(mesh, h), to = lod_half_edge_end(mesh, h), root = lod_sets_find(group, from);
      bool crease = b->features.edges[e] == LOD_FEATURE_CREASE;
      if (pass == 0)
        lod_sets_join(group, from, to);
      else if (pass == 1) /* other lines hold the creases that meet them */
        length[root] +=
            crease ? lod_vec3_distance(lod_vec3_from_float(mesh->positions[from]), lod_vec3_from_float(mesh->positions[to])) : INFINITY;
      else if (crease && length[root] < least)
        b->features.edges[e] = 0;
    }
  return LOD_OK;
}

static enum lod_status build(struct builder *b) {
  struct lod_clod *clod = b->clod;
  struct lod_feature_settings features = lod_feature_defaults();
  features.crease_degrees = clod->settings.crease_degrees;
  features.corner_degrees = clod->settings.corner_degrees;
  features.flags &= ~(uint32_t)LOD_FEATURE_UV_SEAM;
  LOD_TRY(lod_adjacency_create(b->mesh, b->scratch, &b->adjacency));
  LOD_TRY(lod_feature_find(b->mesh, &b->adjacency, &features, b->scratch, &b->features));
  LOD_TRY(dissolve_short_creases(b));
  LOD_TRY(allocate(b));
  LOD_TRY(make_sectors(b));
  for (uint32_t t = 0; t < b->mesh->triangle_count; t++)
    if (takes_part(b, t))
      add_patch(b, t);
  for (uint32_t h = 0; h < 3 * b->mesh->triangle_count; h++)
    if (takes_part(b, h / 3) && (b->adjacency.twin[h] == LOD_NONE || b->adjacency.twin[h] > h))
      add_edge(b, h);
  clod->living_patches = clod->patch_count;
  clod->living_vertices = clod->vertex_count;
  LOD_TRY(mark_removable(b));
  LOD_TRY(make_centres(b));
  LOD_TRY(make_fragments(b));
  return flatten_swollen(b);
}

struct lod_clod *clod_begin(const struct lod_mesh *mesh, const struct lod_clod_settings *settings, struct lod_arena *arena) {
  struct lod_clod *c = LOD_NEW_ZERO(arena, 1, struct lod_clod);
  if (c == NULL)
    return NULL;
  c->mesh = mesh;
  c->settings = settings == NULL ? lod_clod_defaults() : *settings;
  c->arena = arena;
  c->pool.arena = arena;
  c->magnitude = lod_mesh_magnitude(mesh);
  c->rounding = lod_tolerance_rounding(c->magnitude);
  clod_attributes_begin(c);
  return c;
}

enum lod_status lod_clod_create(const struct lod_mesh *mesh, const struct lod_clod_settings *settings, struct lod_arena *arena,
                                struct lod_clod **clod, struct lod_problem *problem) {
  if (mesh->triangle_count >= 1u << 28)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "More than 2^28 triangles cannot become curved patches.");
  struct lod_clod *c = clod_begin(mesh, settings, arena);
  struct builder b = {.clod = c, .mesh = mesh, .scratch = lod_arena_create_child(arena)};
  enum lod_status status = LOD_MEMORY;
  if (c != NULL && b.scratch != NULL)
    status = build(&b);
  lod_arena_destroy(b.scratch);
  *clod = c;
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

void lod_clod_facts(const struct lod_clod *clod, struct lod_clod_facts *facts) {
  *facts = (struct lod_clod_facts){
      .patches = clod->living_patches, .vertices = clod->living_vertices, .clod = clod->number, .tried = clod->tried};
  for (uint32_t p = 0; p < clod->patch_count; p++)
    if (clod->patches[p].died == UINT32_MAX) {
      facts->error = fmax(facts->error, clod->patches[p].bound);
      facts->fragments += clod->patches[p].cell_count;
    }
  for (uint32_t e = 0; e < clod->edge_count; e++)
    facts->edges += clod->edges[e].users[0] != LOD_NONE || clod->edges[e].users[1] != LOD_NONE;
  /* Per patch: three sides and sectors, centre, two C-LOD numbers; corners follow from sides. */
  facts->history_bytes = clod->vertex_count * 3 * sizeof(float) + clod->edge_count * (2 * sizeof(uint32_t) + 6 * sizeof(float)) +
                         clod->patch_count * (8 * sizeof(uint32_t) + 3 * sizeof(float)) + clod->sector_count * 3 * sizeof(float);
}

bool lod_clod_check(const struct lod_clod *clod) {
  uint32_t living = 0;
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (patch->died != UINT32_MAX)
      continue;
    living++;
    for (uint32_t k = 0; k < 3; k++) {
      const struct clod_edge *edge = &clod->edges[patch->sides[k] >> 1];
      uint32_t against = patch->sides[k] & 1;
      if (edge->users[against] != 3 * p + k || edge->ends[against] != patch->corners[k] ||
          edge->ends[1 - against] != patch->corners[(k + 1) % 3])
        return false;
      uint32_t half = clod->half[patch->corners[k]];
      if (half == LOD_NONE || clod->patches[half / 3].died != UINT32_MAX || clod->patches[half / 3].corners[half % 3] != patch->corners[k])
        return false;
    }
    for (uint32_t c = 0; c < patch->cell_count; c++)
      for (int k = 0; k < 3; k++)
        if (patch->cells[c].node[k] >= patch->node_count || patch->nodes[patch->cells[c].node[k]].id >= clod->point_count)
          return false;
  }
  return living == clod->living_patches;
}
