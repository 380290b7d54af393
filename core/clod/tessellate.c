/* Static tessellation. See tessellate.h. */
#include "core/clod/tessellate.h"

#include <math.h>
#include <string.h>

#include "core/base/parallel.h"
#include "core/clod/evaluate.h"

/* ---- static tessellation ---- */

struct lod_tessellate_settings lod_tessellate_defaults(void) {
  return (struct lod_tessellate_settings){.normals = true};
}

struct job {
  const struct lod_patches *patches;
  const struct lod_tessellate_settings *settings;
  struct lod_tessellation *result;
  struct lod_pattern_cache cache;
  uint32_t *pattern_of;  /* patch -> cache entry */
  uint32_t *edge_begin;  /* first vertex inside an edge */
  uint32_t *patch_begin; /* first vertex inside a patch */
  /* Of wedges: their normals are laid out as vertices are, corners first, then edges, then insides. */
  uint32_t (*users)[2];      /* edge -> 3 * patch + side along and against it */
  uint32_t (*edge_wedge)[2]; /* first wedge inside an edge, of either user */
  uint32_t (*corner_wedge)[3];
  uint32_t inside_wedges; /* added to an inside vertex's number: its wedge */
  bool *split;            /* edge: its users have wedges of their own there */
};

/* Points are summed in float, less a corner, when that takes no more of the tolerance than this. */
static const double kRoundingShare = 0.1;

/* What float sums may be off, as lod_evaluator_init has it; 0 when the patch is evaluated in double. */
static double rounding_of(const struct job *job, const struct lod_bezier *net) {
  double rounding = lod_evaluator_rounding(net);
  return rounding <= kRoundingShare * job->settings->tolerance ? rounding : 0;
}

static enum lod_status choose_pattern(struct job *job, uint32_t p, double *deviation) {
  const struct lod_patches *patches = job->patches;
  struct lod_bezier net = lod_patches_net(patches, p);
  double rounding = rounding_of(job, &net);
  uint32_t factors[3];
  for (uint32_t k = 0; k < 3; k++)
    factors[k] = job->result->factors[patches->edges[p][k] >> 1];
  LOD_TRY(lod_pattern_choose(&job->cache, &net, factors, job->settings->tolerance - rounding, &job->result->grids[p], &job->pattern_of[p],
                             deviation));
  *deviation += rounding;
  return LOD_OK;
}

static enum lod_status choose_all(struct job *job) {
  const struct lod_patches *patches = job->patches;
  struct lod_tessellation *result = job->result;
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    struct lod_bezier_curve curve = lod_patches_edge(patches, e);
    /* A little finer than the tolerance asks for, so that the ring beside it can meet the tolerance with a grid of finite fineness. */
    result->factors[e] = lod_pattern_step(lod_bezier_curve_segments(&curve, 0.8 * job->settings->tolerance, LOD_TESSELLATE_MOST));
  }
  result->deviation = 0;
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    double deviation;
    LOD_TRY(choose_pattern(job, p, &deviation));
    result->deviation = fmax(result->deviation, deviation);
  }
  return LOD_OK;
}

static enum lod_status count_all(struct job *job, struct lod_arena *arena, struct lod_problem *problem) {
  const struct lod_patches *patches = job->patches;
  struct lod_tessellation *result = job->result;
  uint64_t vertices = patches->vertex_count, triangles = 0;
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    job->edge_begin[e] = (uint32_t)vertices;
    vertices += result->factors[e] - 1;
  }
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
    job->patch_begin[p] = (uint32_t)vertices;
    result->triangle_begin[p] = (uint32_t)triangles;
    vertices += pattern->vertex_count - pattern->inner_vertices;
    triangles += pattern->triangle_count;
    if (vertices >= UINT32_MAX / 4 || triangles >= UINT32_MAX / 4)
      return lod_fail(problem, LOD_LIMIT, "limit-triangles", "The patches need more than 2^30 triangles at this tolerance.");
  }
  result->triangle_begin[patches->patch_count] = (uint32_t)triangles;
  struct lod_mesh *mesh = &result->mesh;
  *mesh = (struct lod_mesh){.vertex_count = (uint32_t)vertices, .triangle_count = (uint32_t)triangles};
  mesh->positions = lod_arena_alloc(arena, vertices, sizeof *mesh->positions);
  mesh->triangles = lod_arena_alloc(arena, triangles, sizeof *mesh->triangles);
  result->patches = LOD_NEW(arena, triangles, uint32_t);
  if (patches->materials != NULL)
    mesh->materials = LOD_NEW(arena, triangles, uint32_t);
  if (patches->parts != NULL)
    mesh->parts = LOD_NEW(arena, triangles, uint32_t);
  bool ok = mesh->positions != NULL && mesh->triangles != NULL && result->patches != NULL;
  ok = ok && (patches->materials == NULL || mesh->materials != NULL) && (patches->parts == NULL || mesh->parts != NULL);
  return ok ? LOD_OK : lod_fail_memory(problem);
}

static void fill_edges(const struct job *job) {
  const struct lod_patches *patches = job->patches;
  float(*positions)[3] = job->result->mesh.positions;
  for (uint32_t v = 0; v < patches->vertex_count; v++)
    lod_vec3_to_float(patches->positions[v], positions[v]);
  for (uint32_t e = 0; e < patches->edge_count; e++)
    lod_evaluate_edge(patches, e, job->result->factors[e], positions + job->edge_begin[e]);
}

/* Numbers of the vertices of patch p's pattern that are not inside, and of their wedges (NULL = not wanted). */
static void gather_outer(const struct job *job, uint32_t p, const struct lod_tessellation_pattern *pattern, uint32_t *vertices,
                         uint32_t *wedges) {
  const struct lod_patches *patches = job->patches;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = patches->edges[p][k], e = side >> 1, against = side & 1, count = job->result->factors[e] - 1;
    uint32_t *out = vertices + pattern->edge_vertices[k], first = job->edge_begin[e];
    vertices[k] = patches->corners[p][k];
    for (uint32_t i = 0; i < count; i++)
      out[i] = first + (against ? count - 1 - i : i);
    if (wedges == NULL)
      continue;
    wedges[k] = job->corner_wedge[p][k];
    out = wedges + pattern->edge_vertices[k];
    first = job->edge_wedge[e][against];
    for (uint32_t i = 0; i < count; i++)
      out[i] = first + (against ? count - 1 - i : i);
  }
}

static void fill_points(const struct job *job, uint32_t p, const struct lod_tessellation_pattern *pattern) {
  struct lod_mesh *mesh = &job->result->mesh;
  struct lod_bezier net = lod_patches_net(job->patches, p);
  float(*positions)[3] = mesh->positions + job->patch_begin[p];
  float(*normals)[3] = mesh->normals == NULL ? NULL : mesh->normals + job->inside_wedges + job->patch_begin[p];
  uint32_t m = job->result->grids[p];
  if (m < 3)
    return;
  lod_evaluate_inside(job->patches, p, &net, pattern, &job->cache.grids[m], LOD_SMOOTH_SHADED, positions, normals);
  if (rounding_of(job, &net) == 0)
    for (uint32_t v = pattern->inner_vertices; v < pattern->vertex_count; v++)
      lod_vec3_to_float(lod_bezier_point(&net, pattern->domain[v]), positions[v - pattern->inner_vertices]);
  const struct lod_patch_attributes *a = &job->patches->attributes;
  for (uint32_t v = pattern->inner_vertices; a->corners != NULL && mesh->normals != NULL && v < pattern->vertex_count; v++) {
    float values[LOD_PATCH_NUMBERS];
    lod_patch_attributes_mix(a, p, (const double[3]){pattern->domain[v].u, pattern->domain[v].v, pattern->domain[v].w}, values);
    lod_patch_attributes_scatter(a, values, mesh, job->inside_wedges + job->patch_begin[p] + v - pattern->inner_vertices);
  }
}

/* Triangles of a pattern with numbers of vertices, or of wedges. inside: of the first inside vertex. */
static void fill_triangles(const struct lod_tessellation_pattern *pattern, uint32_t grid, const uint32_t *outer, uint32_t inside,
                           uint32_t (*out)[3]) {
  inside -= pattern->inner_vertices;
  for (uint32_t t = 0; t < grid; t++)
    for (int k = 0; k < 3; k++)
      out[t][k] = pattern->triangles[t][k] + inside;
  for (uint32_t t = grid; t < pattern->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      uint32_t v = pattern->triangles[t][k];
      out[t][k] = v < pattern->inner_vertices ? outer[v] : v + inside;
    }
}

static void fill_patch(const struct job *job, uint32_t p) {
  const struct lod_patches *patches = job->patches;
  struct lod_tessellation *result = job->result;
  struct lod_mesh *mesh = &result->mesh;
  const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
  uint32_t vertices[3 * LOD_TESSELLATE_MOST], wedges[3 * LOD_TESSELLATE_MOST], m = result->grids[p], grid = m < 3 ? 0 : (m - 3) * (m - 3);
  uint32_t begin = result->triangle_begin[p];
  fill_points(job, p, pattern);
  gather_outer(job, p, pattern, vertices, mesh->normals == NULL ? NULL : wedges);
  fill_triangles(pattern, grid, vertices, job->patch_begin[p], mesh->triangles + begin);
  if (mesh->normals != NULL)
    fill_triangles(pattern, grid, wedges, job->inside_wedges + job->patch_begin[p], mesh->corners + begin);
  for (uint32_t t = 0; t < pattern->triangle_count; t++)
    result->patches[begin + t] = p;
  for (uint32_t t = 0; mesh->materials != NULL && t < pattern->triangle_count; t++)
    mesh->materials[begin + t] = patches->materials[p];
  for (uint32_t t = 0; mesh->parts != NULL && t < pattern->triangle_count; t++)
    mesh->parts[begin + t] = patches->parts[p];
}

static void patch_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  (void)chunk;
  for (size_t p = begin; p < end; p++)
    fill_patch(context, (uint32_t)p);
}

static void add_wedge(struct lod_mesh *mesh, uint32_t vertex, struct lod_vec3 normal) {
  if (!(lod_vec3_length_squared(normal) > 0.5))
    normal = (struct lod_vec3){0, 0, 1};
  mesh->wedge_vertex[mesh->wedge_count] = vertex;
  lod_vec3_to_float(normal, mesh->normals[mesh->wedge_count++]);
}

/* One for each normal of a corner with the same attributes, one a patch where it has none. */
static enum lod_status add_corner_wedges(struct job *job, struct lod_arena *scratch) {
  const struct lod_patches *patches = job->patches;
  const struct lod_patch_attributes *a = &patches->attributes;
  struct lod_mesh *mesh = &job->result->mesh;
  uint32_t *of_normal = LOD_NEW(scratch, patches->normal_count, uint32_t); /* the latest wedge */
  uint32_t *user = LOD_NEW(scratch, patches->normal_count, uint32_t);      /* and which corner it was made for */
  if (of_normal == NULL || user == NULL)
    return LOD_MEMORY;
  memset(of_normal, 0xff, patches->normal_count * sizeof *of_normal);
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t sector = patches->sectors[p][k];
      if (sector != LOD_NONE && of_normal[sector] != LOD_NONE &&
          (a->corners == NULL || !lod_patch_attributes_differ(a, a->corners[p][k], a->corners[user[sector] / 3][user[sector] % 3]))) {
        job->corner_wedge[p][k] = of_normal[sector];
        continue;
      }
      job->corner_wedge[p][k] = mesh->wedge_count;
      if (sector != LOD_NONE) {
        of_normal[sector] = mesh->wedge_count;
        user[sector] = 3 * p + k;
      }
      if (a->corners != NULL)
        lod_patch_attributes_scatter(a, lod_patch_attributes_at(a, p, k), mesh, mesh->wedge_count);
      add_wedge(mesh, patches->corners[p][k], lod_evaluate_corner_normal(patches, p, k));
    }
  return LOD_OK;
}

/* Attributes inside an edge, as the user on side `side` has them. */
static void add_edge_attributes(const struct job *job, uint32_t e, uint32_t side, uint32_t count) {
  uint32_t user = job->users[e][side], k = user % 3;
  for (uint32_t i = 0; i < count; i++) {
    double t = (i + 1.0) / (count + 1), at[3] = {0, 0, 0};
    float values[LOD_PATCH_NUMBERS];
    at[k] = side == 0 ? 1 - t : t;
    at[(k + 1) % 3] = 1 - at[k];
    lod_patch_attributes_mix(&job->patches->attributes, user / 3, at, values);
    lod_patch_attributes_scatter(&job->patches->attributes, values, &job->result->mesh, job->edge_wedge[e][side] + i);
  }
}

/* One a vertex, or one a patch where the edge is sharp. Normals at smooth edges are the mean of both patches'. */
static void add_edge_wedges(struct job *job) {
  const struct lod_patches *patches = job->patches;
  struct lod_mesh *mesh = &job->result->mesh;
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    uint32_t count = job->result->factors[e] - 1;
    float(*normals[2])[3] = {NULL, NULL};
    for (uint32_t side = 0; side < 2; side++) {
      bool own = side == 0 || job->split[e];
      job->edge_wedge[e][side] = own ? mesh->wedge_count : job->edge_wedge[e][0];
      normals[side] = mesh->normals + job->edge_wedge[e][side];
      for (uint32_t i = 0; own && i < count; i++)
        mesh->wedge_vertex[mesh->wedge_count++] = job->edge_begin[e] + i;
    }
    if (count == 0)
      continue;
    lod_evaluate_edge_normals(patches, e, job->users[e], count + 1, LOD_SMOOTH_SHADED, normals);
    if (job->split[e] && !patches->sharp[e])
      memcpy(normals[1], normals[0], count * sizeof *normals[0]);
    if (patches->attributes.corners == NULL)
      continue;
    uint32_t first = job->users[e][0] == LOD_NONE;
    add_edge_attributes(job, e, first, count);
    if (job->split[e])
      add_edge_attributes(job, e, 1, count);
  }
}

/* Edges across which normals or attributes jump. */
static enum lod_status find_split(struct job *job, struct lod_arena *scratch) {
  const struct lod_patches *patches = job->patches;
  job->split = LOD_NEW_ZERO(scratch, patches->edge_count, bool);
  if (job->split == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < patches->edge_count; e++)
    job->split[e] = lod_patches_are_split(patches, e, job->users[e]);
  return LOD_OK;
}

static bool add_attributes(const struct lod_patch_attributes *a, struct lod_mesh *mesh, size_t room, struct lod_arena *arena) {
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (a->has_uv[set] && (mesh->uvs[set] = lod_arena_alloc(arena, room, sizeof *mesh->uvs[set])) == NULL)
      return false;
  return !a->has_colors || (mesh->colors = lod_arena_alloc(arena, room, sizeof *mesh->colors)) != NULL;
}

/* Room for all wedges, normals of corners and of edges; those inside are filled with the points. */
static enum lod_status add_wedges(struct job *job, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_patches *patches = job->patches;
  struct lod_mesh *mesh = &job->result->mesh;
  job->users = lod_arena_alloc(scratch, patches->edge_count, sizeof *job->users);
  if (job->users == NULL)
    return LOD_MEMORY;
  memset(job->users, 0xff, patches->edge_count * sizeof *job->users);
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++)
      job->users[patches->edges[p][k] >> 1][patches->edges[p][k] & 1] = 3 * p + k;
  LOD_TRY(find_split(job, scratch));
  size_t room = (size_t)mesh->vertex_count + 3 * (size_t)patches->patch_count;
  for (uint32_t e = 0; e < patches->edge_count; e++)
    room += job->split[e] ? job->result->factors[e] - 1 : 0;
  mesh->normals = lod_arena_alloc(arena, room, sizeof *mesh->normals);
  mesh->wedge_vertex = LOD_NEW(arena, room, uint32_t);
  mesh->corners = lod_arena_alloc(arena, mesh->triangle_count, sizeof *mesh->corners);
  job->edge_wedge = lod_arena_alloc(scratch, patches->edge_count, sizeof *job->edge_wedge);
  job->corner_wedge = lod_arena_alloc(scratch, patches->patch_count, sizeof *job->corner_wedge);
  bool ok = add_attributes(&patches->attributes, mesh, room, arena);
  if (!ok || mesh->normals == NULL || mesh->wedge_vertex == NULL || mesh->corners == NULL || job->edge_wedge == NULL ||
      job->corner_wedge == NULL)
    return LOD_MEMORY;
  mesh->wedge_count = 0;
  LOD_TRY(add_corner_wedges(job, scratch));
  add_edge_wedges(job);
  uint32_t first = patches->patch_count == 0 ? mesh->vertex_count : job->patch_begin[0];
  job->inside_wedges = mesh->wedge_count - first;
  for (uint32_t v = first; v < mesh->vertex_count; v++)
    mesh->wedge_vertex[mesh->wedge_count++] = v;
  return LOD_OK;
}

enum lod_status lod_tessellate(const struct lod_patches *patches, const struct lod_tessellate_settings *settings, struct lod_arena *arena,
                               struct lod_tessellation *result, struct lod_problem *problem) {
  *result = (struct lod_tessellation){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct job job = {.patches = patches, .settings = settings, .result = result};
  result->factors = LOD_NEW(arena, patches->edge_count, uint32_t);
  result->grids = LOD_NEW(arena, patches->patch_count, uint32_t);
  result->triangle_begin = LOD_NEW(arena, (size_t)patches->patch_count + 1, uint32_t);
  enum lod_status status = LOD_MEMORY;
  if (scratch != NULL && result->factors != NULL && result->grids != NULL && result->triangle_begin != NULL) {
    job.pattern_of = LOD_NEW(scratch, patches->patch_count, uint32_t);
    job.edge_begin = LOD_NEW(scratch, patches->edge_count, uint32_t);
    job.patch_begin = LOD_NEW(scratch, patches->patch_count, uint32_t);
    if (job.pattern_of != NULL && job.edge_begin != NULL && job.patch_begin != NULL)
      status = lod_pattern_cache_init(&job.cache, scratch);
  }
  if (status == LOD_OK)
    status = choose_all(&job);
  if (status == LOD_OK)
    status = count_all(&job, arena, problem);
  if (status == LOD_OK) {
    fill_edges(&job);
    if (settings->normals)
      status = add_wedges(&job, arena, scratch);
  }
  if (status == LOD_OK)
    lod_parallel_for(settings->threads, patches->patch_count, 256, patch_chunk, &job);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
