/* Patterns of triangles in a patch's domain, and static tessellation. See tessellate.h. */
#include "core/clod/tessellate.h"

#include <math.h>
#include <string.h>

#include "core/base/parallel.h"

/* ---- patterns ---- */

struct pattern_maker {
  struct lod_tessellation_pattern *pattern;
  uint32_t m, factors[3];
};

static void set_vertex(struct pattern_maker *maker, uint32_t index, double a, double b, double c) {
  maker->pattern->domain[index] = (struct lod_barycentric){a, b, c};
}

static void add_triangle(struct pattern_maker *maker, uint32_t a, uint32_t b, uint32_t c) {
  uint32_t *t = maker->pattern->triangles[maker->pattern->triangle_count++];
  t[0] = a, t[1] = b, t[2] = c;
}

/* The i-th of factor + 1 points along side k. */
static uint32_t edge_vertex(const struct pattern_maker *maker, uint32_t k, uint32_t i) {
  if (i == 0)
    return k;
  return i == maker->factors[k] ? (k + 1) % 3 : maker->pattern->edge_vertices[k] + i - 1;
}

/* Inside points (i, j, k >= 1, i + j + k = m) lie in rows of equal k, from k = 1; row k has m - 1 - k points, by rising j. */
static uint32_t inner_vertex(const struct pattern_maker *maker, uint32_t j, uint32_t k) {
  uint32_t rows = k - 1, m = maker->m;
  return maker->pattern->inner_vertices + rows * (m - 2) - rows * (rows - 1) / 2 + (j - 1);
}

/* The s-th of m - 2 points of the ring inside side k, running as the side does. */
static uint32_t ring_vertex(const struct pattern_maker *maker, uint32_t k, uint32_t s) {
  uint32_t m = maker->m, last = m - 2 - s; /* weights: corner k: last, corner k + 1: 1 + s, the third 1 */
  switch (k) {
  case 0:
    return inner_vertex(maker, 1 + s, 1);
  case 1:
    return inner_vertex(maker, last, 1 + s);
  default:
    return inner_vertex(maker, 1, last);
  }
}

static void stitch(struct pattern_maker *maker, uint32_t k) {
  uint32_t outer = maker->factors[k], inner = maker->m - 3, o = 0, i = 0;
  while (o < outer || i < inner) {
    /* Advance where the next point comes first along the side. */
    double next_outer = (o + 0.5) / outer, next_inner = (i + 1.5) / maker->m;
    bool take_outer = i == inner || (o < outer && next_outer <= next_inner);
    uint32_t a = edge_vertex(maker, k, o), b = ring_vertex(maker, k, i);
    if (take_outer)
      add_triangle(maker, a, edge_vertex(maker, k, ++o), b);
    else
      add_triangle(maker, a, ring_vertex(maker, k, ++i), b);
  }
}

static void fill_inside(struct pattern_maker *maker) {
  uint32_t m = maker->m;
  for (uint32_t k = 1; k + 2 <= m; k++)
    for (uint32_t j = 1; j + k + 1 <= m; j++)
      set_vertex(maker, inner_vertex(maker, j, k), (double)(m - j - k) / m, (double)j / m, (double)k / m);
  for (uint32_t k = 1; k + 3 <= m; k++)
    for (uint32_t j = 1; j + k + 2 <= m; j++) {
      uint32_t a = inner_vertex(maker, j, k), b = inner_vertex(maker, j + 1, k), c = inner_vertex(maker, j, k + 1);
      add_triangle(maker, a, b, c);
      if (j + k + 3 <= m)
        add_triangle(maker, b, inner_vertex(maker, j + 1, k + 1), c);
    }
}

/* m of 1 and 2: each edge is whole or halved. */
static void fill_small(struct pattern_maker *maker) {
  uint32_t halved = 0, count = 0;
  for (uint32_t k = 0; k < 3; k++)
    if (maker->factors[k] == 2) {
      halved |= 1u << k;
      count++;
    }
  if (count == 0) {
    add_triangle(maker, 0, 1, 2);
  } else if (count == 3) {
    uint32_t a = edge_vertex(maker, 0, 1), b = edge_vertex(maker, 1, 1), c = edge_vertex(maker, 2, 1);
    add_triangle(maker, 0, a, c);
    add_triangle(maker, 1, b, a);
    add_triangle(maker, 2, c, b);
    add_triangle(maker, a, b, c);
  } else if (count == 1) {
    uint32_t k = halved == 1 ? 0 : halved == 2 ? 1 : 2, middle = edge_vertex(maker, k, 1);
    add_triangle(maker, k, middle, (k + 2) % 3);
    add_triangle(maker, middle, (k + 1) % 3, (k + 2) % 3);
  } else {
    uint32_t whole = (halved & 1) == 0 ? 0 : (halved & 2) == 0 ? 1 : 2; /* from corner `whole`; both other sides are halved */
    uint32_t next = edge_vertex(maker, (whole + 1) % 3, 1), last = edge_vertex(maker, (whole + 2) % 3, 1);
    add_triangle(maker, (whole + 2) % 3, last, next);
    add_triangle(maker, whole, (whole + 1) % 3, next);
    add_triangle(maker, whole, next, last);
  }
}

enum lod_status lod_tessellation_pattern_make(uint32_t m, const uint32_t factors[3], struct lod_arena *arena,
                                              struct lod_tessellation_pattern *pattern) {
  struct pattern_maker maker = {.pattern = pattern, .m = m, .factors = {factors[0], factors[1], factors[2]}};
  *pattern = (struct lod_tessellation_pattern){0};
  uint32_t next = 3;
  for (uint32_t k = 0; k < 3; k++) {
    pattern->edge_vertices[k] = next;
    next += factors[k] - 1;
  }
  pattern->inner_vertices = next;
  uint32_t inside = m >= 3 ? (m - 1) * (m - 2) / 2 : 0;
  pattern->vertex_count = next + inside;
  size_t room = (size_t)m * m + factors[0] + factors[1] + factors[2] + 4;
  pattern->domain = LOD_NEW(arena, pattern->vertex_count, struct lod_barycentric);
  pattern->triangles = lod_arena_alloc(arena, room, sizeof *pattern->triangles);
  if (pattern->domain == NULL || pattern->triangles == NULL)
    return LOD_MEMORY;
  for (uint32_t k = 0; k < 3; k++) {
    double at[3] = {0, 0, 0};
    at[k] = 1;
    set_vertex(&maker, k, at[0], at[1], at[2]);
    for (uint32_t i = 1; i < factors[k]; i++) {
      at[(k + 1) % 3] = (double)i / factors[k];
      at[k] = (double)(factors[k] - i) / factors[k];
      set_vertex(&maker, edge_vertex(&maker, k, i), at[0], at[1], at[2]);
    }
  }
  if (m < 3) {
    fill_small(&maker);
    return LOD_OK;
  }
  fill_inside(&maker);
  for (uint32_t k = 0; k < 3; k++)
    stitch(&maker, k);
  return LOD_OK;
}

/* ---- bounds ---- */

/* Second derivatives along the three side directions of the domain are linear: their values at the corners. h[s][c]: side s, corner c. */
struct bend {
  struct lod_vec3 h[3][3];
};

static struct lod_vec3 second(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return (struct lod_vec3){6 * (a.x - 2 * b.x + c.x), 6 * (a.y - 2 * b.y + c.y), 6 * (a.z - 2 * b.z + c.z)};
}

static struct bend bend_of(const struct lod_bezier *patch) {
  const struct lod_vec3 *p = patch->p;
  struct bend bend = {{{second(p[0], p[3], p[4]), second(p[3], p[4], p[1]), second(p[8], p[9], p[5])},
                       {second(p[4], p[9], p[7]), second(p[1], p[5], p[6]), second(p[5], p[6], p[2])},
                       {second(p[7], p[8], p[0]), second(p[6], p[9], p[3]), second(p[2], p[7], p[8])}}};
  return bend;
}

static double coordinate(struct lod_barycentric at, int k) {
  return k == 0 ? at.u : k == 1 ? at.v : at.w;
}

/* Largest second derivative along the side from a to b of a small triangle, over its three corners. For a direction d with coordinates
 * that add up to 0, the second derivative is -(sum over sides s = (a, b) of d_a d_b h_s). */
static double side_bend(const struct bend *bend, const struct lod_barycentric corner[3], int from, int to) {
  double d[3];
  for (int k = 0; k < 3; k++)
    d[k] = coordinate(corner[to], k) - coordinate(corner[from], k);
  double worst = 0;
  for (int c = 0; c < 3; c++) {
    struct lod_vec3 sum = {0, 0, 0};
    for (int s = 0; s < 3; s++)
      for (int k = 0; k < 3; k++)
        sum = lod_vec3_add_scaled(sum, bend->h[s][k], -d[s] * d[(s + 1) % 3] * coordinate(corner[c], k));
    worst = fmax(worst, lod_vec3_length_squared(sum));
  }
  return sqrt(worst);
}

/* Maximum of 1/2 (x l0 l1 + y l1 l2 + z l2 l0) over barycentric coordinates l: on a side an eighth of its D; inside where the gradient is
 * the same in all three, at l0 : l1 : l2 = y (x + z - y) : z (x + y - z) : x (y + z - x), when these are positive. */
static double triangle_bound(double x, double y, double z) {
  double most = fmax(x, fmax(y, z)) / 8;
  double l0 = y * (x + z - y), l1 = z * (x + y - z), l2 = x * (y + z - x), sum = l0 + l1 + l2;
  if (!(l0 > 0 && l1 > 0 && l2 > 0))
    return most;
  return fmax(most, 0.5 * (x * l0 * l1 + y * l1 * l2 + z * l2 * l0) / (sum * sum));
}

static double deviation_of(const struct bend *bend, const struct lod_tessellation_pattern *pattern, uint32_t begin, uint32_t end) {
  double worst = 0;
  for (uint32_t t = begin; t < end; t++) {
    const uint32_t *triangle = pattern->triangles[t];
    struct lod_barycentric corner[3] = {pattern->domain[triangle[0]], pattern->domain[triangle[1]], pattern->domain[triangle[2]]};
    worst = fmax(worst, triangle_bound(side_bend(bend, corner, 0, 1), side_bend(bend, corner, 1, 2), side_bend(bend, corner, 2, 0)));
  }
  return worst;
}

double lod_tessellation_deviation(const struct lod_bezier *patch, const struct lod_tessellation_pattern *pattern) {
  struct bend bend = bend_of(patch);
  return deviation_of(&bend, pattern, 0, pattern->triangle_count);
}

/* ---- static tessellation ---- */

struct lod_tessellate_settings lod_tessellate_defaults(void) {
  return (struct lod_tessellate_settings){.normals = true};
}

/* Patterns by (m, factors), made when first met. */
struct cache {
  struct lod_arena *arena;
  struct entry {
    uint32_t m, factors[3];
    struct lod_tessellation_pattern pattern;
  } * entries;
  uint32_t *slots; /* hash -> entry, LOD_NONE = free */
  uint32_t count, capacity, mask;
};

static uint32_t hash_of(uint32_t m, const uint32_t factors[3]) {
  uint64_t x = m | (uint64_t)factors[0] << 8 | (uint64_t)factors[1] << 16 | (uint64_t)factors[2] << 24;
  x *= 0x9E3779B97F4A7C15u;
  return (uint32_t)(x >> 40);
}

static enum lod_status cache_init(struct cache *cache, struct lod_arena *arena) {
  enum { FIRST = 256 };
  *cache = (struct cache){.arena = arena, .capacity = FIRST, .mask = 2 * FIRST - 1};
  cache->entries = LOD_NEW(arena, cache->capacity, struct entry);
  cache->slots = LOD_NEW(arena, cache->mask + 1, uint32_t);
  if (cache->entries == NULL || cache->slots == NULL)
    return LOD_MEMORY;
  memset(cache->slots, 0xff, (cache->mask + 1) * sizeof *cache->slots);
  return LOD_OK;
}

static enum lod_status cache_grow(struct cache *cache) {
  uint32_t capacity = 2 * cache->capacity, mask = 2 * capacity - 1;
  struct entry *entries = LOD_NEW(cache->arena, capacity, struct entry);
  uint32_t *slots = LOD_NEW(cache->arena, mask + 1, uint32_t);
  if (entries == NULL || slots == NULL)
    return LOD_MEMORY;
  memcpy(entries, cache->entries, cache->count * sizeof *entries);
  memset(slots, 0xff, (mask + 1) * sizeof *slots);
  for (uint32_t e = 0; e < cache->count; e++) {
    uint32_t slot = hash_of(entries[e].m, entries[e].factors) & mask;
    while (slots[slot] != LOD_NONE)
      slot = (slot + 1) & mask;
    slots[slot] = e;
  }
  cache->entries = entries;
  cache->slots = slots;
  cache->capacity = capacity;
  cache->mask = mask;
  return LOD_OK;
}

/* Index of the entry, which moves when more are added. */
static enum lod_status cache_find(struct cache *cache, uint32_t m, const uint32_t factors[3], uint32_t *found) {
  uint32_t slot = hash_of(m, factors) & cache->mask;
  for (; cache->slots[slot] != LOD_NONE; slot = (slot + 1) & cache->mask) {
    struct entry *entry = &cache->entries[cache->slots[slot]];
    if (entry->m == m && memcmp(entry->factors, factors, sizeof entry->factors) == 0) {
      *found = cache->slots[slot];
      return LOD_OK;
    }
  }
  if (cache->count == cache->capacity) {
    LOD_TRY(cache_grow(cache));
    return cache_find(cache, m, factors, found);
  }
  struct entry *entry = &cache->entries[cache->count];
  entry->m = m;
  memcpy(entry->factors, factors, sizeof entry->factors);
  LOD_TRY(lod_tessellation_pattern_make(m, factors, cache->arena, &entry->pattern));
  *found = cache->slots[slot] = cache->count++;
  return LOD_OK;
}

struct job {
  const struct lod_patches *patches;
  const struct lod_tessellate_settings *settings;
  struct lod_tessellation *result;
  struct cache cache;
  uint32_t *pattern_of;  /* patch -> cache entry */
  uint32_t *edge_begin;  /* first vertex inside an edge */
  uint32_t *patch_begin; /* first vertex inside a patch */
};

static struct lod_bezier_curve edge_curve(const struct lod_patches *patches, uint32_t e) {
  return (struct lod_bezier_curve){
      {patches->positions[patches->ends[e][0]], patches->inner[e][0], patches->inner[e][1], patches->positions[patches->ends[e][1]]}};
}

/* The grid of a patch: from its own bends, then finer until the stitched ring holds as well. */
static enum lod_status choose_pattern(struct job *job, uint32_t p, double *deviation) {
  const struct lod_patches *patches = job->patches;
  struct lod_bezier net = lod_patches_net(patches, p);
  struct bend bend = bend_of(&net);
  uint32_t factors[3], largest = 1;
  for (uint32_t k = 0; k < 3; k++) {
    factors[k] = job->result->factors[patches->edges[p][k] >> 1];
    largest = factors[k] > largest ? factors[k] : largest;
  }
  uint32_t m = lod_bezier_segments(&net, job->settings->tolerance, LOD_TESSELLATE_MOST);
  if (m < 3 && largest > m)
    m = largest == 2 ? 2 : 3;
  for (;; m = m + 1 + m / 8 < LOD_TESSELLATE_MOST ? m + 1 + m / 8 : LOD_TESSELLATE_MOST) {
    LOD_TRY(cache_find(&job->cache, m, factors, &job->pattern_of[p]));
    const struct lod_tessellation_pattern *pattern = &job->cache.entries[job->pattern_of[p]].pattern;
    uint32_t ring = m < 3 ? 0 : (m - 3) * (m - 3); /* the inner triangles come first and obey the grid's bound */
    *deviation = deviation_of(&bend, pattern, ring, pattern->triangle_count);
    if (ring > 0)
      *deviation = fmax(*deviation, lod_bezier_deviation(&net, m));
    if (*deviation <= job->settings->tolerance || m == LOD_TESSELLATE_MOST)
      break;
  }
  job->result->grids[p] = m;
  return LOD_OK;
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
      status = cache_init(&job.cache, scratch);
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
