/* Static tessellation. See tessellate.h. */
#include "core/clod/tessellate.h"

#include <math.h>
#include <string.h>

#include "core/base/parallel.h"

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
};

static struct lod_bezier_curve edge_curve(const struct lod_patches *patches, uint32_t e) {
  return (struct lod_bezier_curve){
      {patches->positions[patches->ends[e][0]], patches->inner[e][0], patches->inner[e][1], patches->positions[patches->ends[e][1]]}};
}

static enum lod_status choose_pattern(struct job *job, uint32_t p, double *deviation) {
  const struct lod_patches *patches = job->patches;
  struct lod_bezier net = lod_patches_net(patches, p);
  uint32_t factors[3];
  for (uint32_t k = 0; k < 3; k++)
    factors[k] = job->result->factors[patches->edges[p][k] >> 1];
  return lod_pattern_choose(&job->cache, &net, factors, job->settings->tolerance, false, &job->result->grids[p], &job->pattern_of[p],
                            deviation);
}

static enum lod_status choose_all(struct job *job) {
  const struct lod_patches *patches = job->patches;
  struct lod_tessellation *result = job->result;
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    struct lod_bezier_curve curve = edge_curve(patches, e);
    /* A little finer than the tolerance asks for, so that the ring beside it can meet the tolerance with a grid of finite fineness. */
    result->factors[e] = lod_bezier_curve_segments(&curve, 0.8 * job->settings->tolerance, LOD_TESSELLATE_MOST);
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

/* Vertex of the mesh for a vertex of patch p's pattern. */
static uint32_t global_vertex(const struct job *job, uint32_t p, uint32_t local) {
  const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
  if (local < 3)
    return job->patches->corners[p][local];
  if (local >= pattern->inner_vertices)
    return job->patch_begin[p] + local - pattern->inner_vertices;
  uint32_t k = local >= pattern->edge_vertices[2] ? 2 : local >= pattern->edge_vertices[1] ? 1 : 0;
  uint32_t side = job->patches->edges[p][k], i = local - pattern->edge_vertices[k];
  uint32_t factor = job->result->factors[side >> 1];
  return job->edge_begin[side >> 1] + ((side & 1) ? factor - 2 - i : i);
}

static void fill_edges(const struct job *job) {
  const struct lod_patches *patches = job->patches;
  float(*positions)[3] = job->result->mesh.positions;
  for (uint32_t v = 0; v < patches->vertex_count; v++)
    lod_vec3_to_float(patches->positions[v], positions[v]);
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    struct lod_bezier_curve curve = edge_curve(patches, e);
    uint32_t factor = job->result->factors[e];
    for (uint32_t i = 1; i < factor; i++)
      lod_vec3_to_float(lod_bezier_curve_point(&curve, (double)i / factor), positions[job->edge_begin[e] + i - 1]);
  }
}

static void fill_patch(const struct job *job, uint32_t p) {
  const struct lod_patches *patches = job->patches;
  struct lod_tessellation *result = job->result;
  const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
  struct lod_bezier net = lod_patches_net(patches, p);
  float(*positions)[3] = result->mesh.positions + job->patch_begin[p];
  for (uint32_t v = pattern->inner_vertices; v < pattern->vertex_count; v++)
    lod_vec3_to_float(lod_bezier_point(&net, pattern->domain[v]), positions[v - pattern->inner_vertices]);
  uint32_t begin = result->triangle_begin[p];
  for (uint32_t t = 0; t < pattern->triangle_count; t++) {
    for (int k = 0; k < 3; k++)
      result->mesh.triangles[begin + t][k] = global_vertex(job, p, pattern->triangles[t][k]);
    result->patches[begin + t] = p;
    if (result->mesh.materials != NULL)
      result->mesh.materials[begin + t] = patches->materials[p];
    if (result->mesh.parts != NULL)
      result->mesh.parts[begin + t] = patches->parts[p];
  }
}

static void patch_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  (void)chunk;
  for (size_t p = begin; p < end; p++)
    fill_patch(context, (uint32_t)p);
}

/* Wedges: a corner has one for each of its normals (and one a patch where it has none), a vertex inside an edge one, or one a patch where
 * the edge is sharp, an inside vertex one. Normals at smooth edges are the mean of both patches'. */
static enum lod_status add_normals(const struct job *job, struct lod_arena *arena) {
  const struct lod_patches *patches = job->patches;
  struct lod_mesh *mesh = &job->result->mesh;
  size_t room = (size_t)mesh->vertex_count + patches->normal_count;
  for (uint32_t e = 0; e < patches->edge_count; e++)
    room += patches->sharp[e] ? job->result->factors[e] : 0;
  room += 3 * (size_t)patches->patch_count;
  mesh->normals = lod_arena_alloc(arena, room, sizeof *mesh->normals);
  mesh->wedge_vertex = LOD_NEW(arena, room, uint32_t);
  mesh->corners = lod_arena_alloc(arena, mesh->triangle_count, sizeof *mesh->corners);
  uint32_t largest = 0;
  for (uint32_t e = 0; e < job->cache.count; e++)
    largest = job->cache.entries[e].pattern.vertex_count > largest ? job->cache.entries[e].pattern.vertex_count : largest;
  uint32_t *wedge = LOD_NEW(arena, largest, uint32_t);
  /* Wedge of each vertex that is not a corner (first user), and of each normal. */
  uint32_t *of_vertex = LOD_NEW(arena, mesh->vertex_count, uint32_t), *of_normal = LOD_NEW(arena, patches->normal_count, uint32_t);
  if (mesh->normals == NULL || mesh->wedge_vertex == NULL || mesh->corners == NULL || wedge == NULL || of_vertex == NULL ||
      of_normal == NULL)
    return LOD_MEMORY;
  memset(of_vertex, 0xff, mesh->vertex_count * sizeof *of_vertex);
  memset(of_normal, 0xff, patches->normal_count * sizeof *of_normal);
  mesh->wedge_count = 0;
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
    struct lod_bezier net = lod_patches_net(patches, p);
    for (uint32_t v = 0; v < pattern->vertex_count; v++) {
      uint32_t vertex = global_vertex(job, p, v), sector = v < 3 ? patches->sectors[p][v] : LOD_NONE;
      bool sharp = v < 3;
      if (v >= 3 && v < pattern->inner_vertices) {
        uint32_t k = v >= pattern->edge_vertices[2] ? 2 : v >= pattern->edge_vertices[1] ? 1 : 0;
        sharp = patches->sharp[patches->edges[p][k] >> 1];
      }
      uint32_t *known = sector != LOD_NONE ? &of_normal[sector] : sharp ? NULL : &of_vertex[vertex];
      struct lod_vec3 normal = sector != LOD_NONE ? patches->normals[sector] : lod_bezier_normal(&net, pattern->domain[v]);
      if (known != NULL && *known != LOD_NONE) {
        wedge[v] = *known;
        if (sector == LOD_NONE)
          normal = lod_vec3_normalize(lod_vec3_add(lod_vec3_from_float(mesh->normals[*known]), normal));
      } else {
        wedge[v] = mesh->wedge_count++;
        if (known != NULL)
          *known = wedge[v];
      }
      mesh->wedge_vertex[wedge[v]] = vertex;
      if (!(lod_vec3_length_squared(normal) > 0.5))
        normal = (struct lod_vec3){0, 0, 1};
      lod_vec3_to_float(normal, mesh->normals[wedge[v]]);
    }
    uint32_t begin = job->result->triangle_begin[p];
    for (uint32_t t = 0; t < pattern->triangle_count; t++)
      for (int k = 0; k < 3; k++)
        mesh->corners[begin + t][k] = wedge[pattern->triangles[t][k]];
  }
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
    lod_parallel_for(settings->threads, patches->patch_count, 256, patch_chunk, &job);
    if (settings->normals)
      status = add_normals(&job, arena);
  }
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
