/* What JavaScript calls of core and codec, compiled to WebAssembly (`make wasm`). Handles are pointers to one arena's worth of something;
 * results are read through lodw_* accessors or from a block of 32-bit words whose address is returned. 0 means failure; lodw_problem() then
 * has the sentence. One module instance belongs to one worker: there are no threads, no I/O, no clock. */
#include <stdlib.h>
#include <string.h>

#include "codec/stream/units.h"
#include "core/mesh/overlay.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(#name))) name
#else
#define EXPORT(name) name /* the same calls natively, for tests that compare */
#endif

static struct lod_problem problem;
static uint64_t memory_limit = (uint64_t)768 << 20;

/* A level in memory: from a decoded GLB, or from a delta. */
struct level {
  struct lod_arena *arena;
  struct lod_mesh mesh;
  uint32_t *sources; /* mesh vertex -> vertex that was given (the first), of levels from arrays */
  uint32_t *kept;    /* base vertex -> vertex of this, of levels from deltas; or NULL */
  uint32_t kept_count;
};

struct map {
  struct lod_arena *arena;
  struct lod_overlay overlay;
  const struct level *coarse, *fine;
  uint32_t *parents;
  struct lod_morph morph;
  uint32_t words[16];
};

void *EXPORT(lodw_alloc)(size_t size) {
  return malloc(size == 0 ? 1 : size);
}

void EXPORT(lodw_free)(void *block) {
  free(block);
}

/* At most so many bytes for each handle's arena. */
void EXPORT(lodw_limit)(uint32_t megabytes) {
  memory_limit = (uint64_t)megabytes << 20;
}

const char *EXPORT(lodw_problem)(void) {
  return problem.detail;
}

const char *EXPORT(lodw_problem_type)(void) {
  return problem.type;
}

static struct lod_arena *begin(void) {
  memset(&problem, 0, sizeof problem);
  struct lod_arena *arena = lod_arena_create((size_t)memory_limit);
  if (arena == NULL)
    (void)lod_fail_memory(&problem);
  return arena;
}

/* ---- levels ---- */

void EXPORT(lodw_level_free)(struct level *level) {
  if (level != NULL)
    lod_arena_destroy(level->arena);
}

static enum lod_status fill_level(struct level *level, const float *positions, uint32_t vertices, const uint32_t *index, uint32_t triangles,
                                  const uint32_t *materials) {
  struct lod_mesh given = {.vertex_count = vertices,
                           .triangle_count = triangles,
                           .positions = (float(*)[3])(uintptr_t)positions,
                           .triangles = (uint32_t(*)[3])(uintptr_t)index};
  uint32_t *to;
  if (!lod_mesh_check(&given, &problem))
    return problem.status != LOD_OK ? problem.status
                                    : lod_fail(&problem, LOD_BAD_INPUT, "mesh", "The triangles name vertices that are not there.");
  LOD_TRY(lod_mesh_weld(&given, level->arena, &level->mesh, &to));
  struct lod_mesh *mesh = &level->mesh;
  level->sources = LOD_NEW(level->arena, mesh->vertex_count, uint32_t);
  mesh->corners = lod_arena_alloc(level->arena, triangles, sizeof *mesh->corners);
  mesh->wedge_vertex = LOD_NEW(level->arena, vertices, uint32_t);
  mesh->materials = LOD_NEW(level->arena, triangles, uint32_t);
  if (level->sources == NULL || mesh->corners == NULL || mesh->wedge_vertex == NULL || mesh->materials == NULL)
    return lod_fail_memory(&problem);
  mesh->wedge_count = vertices;
  memcpy(mesh->corners, index, (size_t)triangles * sizeof *mesh->corners);
  for (uint32_t v = vertices; v-- > 0;) {
    mesh->wedge_vertex[v] = to[v] == LOD_NONE ? 0 : to[v];
    if (to[v] != LOD_NONE)
      level->sources[to[v]] = v;
  }
  for (uint32_t t = 0; t < triangles; t++)
    mesh->materials[t] = materials == NULL ? 0 : materials[t];
  return LOD_OK;
}

static struct level *new_level(void) {
  struct lod_arena *arena = begin();
  struct level *level = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct level);
  if (level == NULL) {
    lod_arena_destroy(arena);
    (void)lod_fail_memory(&problem);
    return NULL;
  }
  level->arena = arena;
  return level;
}

/* A level as it is drawn: vertices that share a position are one for the surface and stay apart for attributes. materials: a number a
 * triangle, or 0. */
struct level *EXPORT(lodw_level_create)(const float *positions, uint32_t vertices, const uint32_t *index, uint32_t triangles,
                                        const uint32_t *materials) {
  struct level *level = new_level();
  enum lod_status status = level == NULL ? LOD_OK : fill_level(level, positions, vertices, index, triangles, materials);
  if (status == LOD_MEMORY)
    (void)lod_fail_memory(&problem);
  if (status != LOD_OK) {
    lodw_level_free(level);
    return NULL;
  }
  return level;
}

/* The frame that begins at `bytes`, after `base` (0: a first picture). */
struct level *EXPORT(lodw_level_decode)(const uint8_t *bytes, size_t size, const struct level *base) {
  struct level *level = new_level();
  struct lod_delta_level decoded;
  struct lod_delta_limits limits = {.max_memory_bytes = memory_limit};
  if (level == NULL)
    return NULL;
  if (lod_delta_decode(bytes, size, base == NULL ? NULL : &base->mesh, &limits, level->arena, &decoded, &problem) != LOD_OK) {
    lodw_level_free(level);
    return NULL;
  }
  level->mesh = decoded.mesh;
  level->kept = (uint32_t *)(uintptr_t)decoded.kept;
  level->kept_count = base == NULL ? 0 : base->mesh.vertex_count;
  return level;
}

/* Bytes of the frame that begins at `bytes`, of which `size` are there: 0 = more are needed, or it is wrong (lodw_problem_type). */
size_t EXPORT(lodw_frame_size)(const uint8_t *bytes, size_t size) {
  struct lod_delta_header header;
  memset(&problem, 0, sizeof problem);
  return lod_delta_inspect(bytes, size, &header, &problem) == LOD_OK ? header.size : 0;
}

/* vertices, triangles, wedges, addresses of positions, triangles, corners (0), normals (0), uv 0 (0), colors (0), wedge_vertex (0),
 * materials (0). Valid until the next call. */
const uint32_t *EXPORT(lodw_level_words)(const struct level *level) {
  static uint32_t words[11];
  const struct lod_mesh *m = &level->mesh;
  const void *const addresses[8] = {m->positions, m->triangles, m->corners,      m->normals,
                                    m->uvs[0],    m->colors,    m->wedge_vertex, m->materials};
  words[0] = m->vertex_count;
  words[1] = m->triangle_count;
  words[2] = m->wedge_count;
  for (int i = 0; i < 8; i++)
    words[3 + i] = (uint32_t)(uintptr_t)addresses[i];
  return words;
}

/* Of everything decoded, to compare machines: FNV-1a over words. */
static uint32_t mix(uint32_t hash, const void *data, size_t words) {
  const unsigned char *bytes = data;
  for (size_t i = 0; data != NULL && i < 4 * words; i++)
    hash = (hash ^ bytes[i]) * 0x01000193u;
  return hash;
}

uint32_t EXPORT(lodw_level_hash)(const struct level *level) {
  const struct lod_mesh *m = &level->mesh;
  uint32_t hash = mix(0x811c9dc5u, m->positions, 3 * (size_t)m->vertex_count);
  hash = mix(hash, m->triangles, 3 * (size_t)m->triangle_count);
  hash = mix(hash, m->corners, 3 * (size_t)m->triangle_count);
  hash = mix(hash, m->normals, 3 * (size_t)m->wedge_count);
  hash = mix(hash, m->uvs[0], 2 * (size_t)m->wedge_count);
  hash = mix(hash, m->uvs[1], 2 * (size_t)m->wedge_count);
  hash = mix(hash, m->colors, 4 * (size_t)m->wedge_count);
  hash = mix(hash, m->materials, m->triangle_count);
  hash = mix(hash, m->parts, m->triangle_count);
  hash = mix(hash, m->edges, 2 * (size_t)m->edge_count);
  hash = mix(hash, m->edge_thickness, m->edge_count);
  hash = mix(hash, m->points, m->point_count);
  return mix(hash, level->kept, level->kept_count);
}

/* ---- maps ---- */

void EXPORT(lodw_map_free)(struct map *map) {
  if (map != NULL)
    lod_arena_destroy(map->arena);
}

static enum lod_status find_parents(struct map *map, double reach) {
  const struct lod_mesh *coarse = &map->coarse->mesh;
  map->parents = LOD_NEW(map->arena, coarse->vertex_count, uint32_t);
  if (map->parents == NULL)
    return lod_fail_memory(&problem);
  if (map->fine->kept == NULL || map->fine->kept_count != coarse->vertex_count)
    return lod_overlay_match(coarse, &map->fine->mesh, reach, map->arena, map->parents);
  memcpy(map->parents, map->fine->kept, coarse->vertex_count * sizeof *map->parents);
  return LOD_OK;
}

/* The overlay of two levels, which must outlive it. Which vertices are the same: as the delta said, else the nearest within `reach`. */
struct map *EXPORT(lodw_map_create)(const struct level *coarse, const struct level *fine, double reach) {
  struct lod_arena *arena = begin();
  struct map *map = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct map);
  enum lod_status status = map == NULL ? lod_fail_memory(&problem) : LOD_OK;
  if (status == LOD_OK) {
    map->arena = arena;
    map->coarse = coarse;
    map->fine = fine;
    status = find_parents(map, reach);
  }
  if (status == LOD_OK)
    status = lod_overlay_create(&coarse->mesh, &fine->mesh, map->parents, NULL, arena, &map->overlay, &problem);
  if (status == LOD_OK)
    return map;
  if (status == LOD_MEMORY)
    (void)lod_fail_memory(&problem);
  lod_arena_destroy(arena);
  return NULL;
}

uint32_t EXPORT(lodw_map_hash)(const struct map *map) {
  uint64_t hash = lod_overlay_hash(&map->overlay);
  return (uint32_t)(hash ^ hash >> 32);
}

/* exact: fragments; else the finer level's triangles. values: numbers a wedge in the two arrays (0 = none).
 * Returns: vertices, triangles, addresses of start and end positions, triangles, finer face of each triangle, start and end values; coarse
 * triangles mapped, failed. */
const uint32_t *EXPORT(lodw_map_draw)(struct map *map, uint32_t exact, uint32_t values, const float *coarse, const float *fine) {
  struct lod_morph_values all = {values, coarse, fine};
  memset(&problem, 0, sizeof problem);
  enum lod_status status = (exact != 0 ? lod_overlay_fragments : lod_overlay_vertices)(&map->overlay, &map->coarse->mesh, &map->fine->mesh,
                                                                                       values == 0 ? NULL : &all, map->arena, &map->morph);
  if (status != LOD_OK) {
    (void)lod_fail_memory(&problem);
    return NULL;
  }
  const struct lod_morph *m = &map->morph;
  const void *const addresses[6] = {m->start, m->end, m->triangles, m->fine_faces, m->start_values, m->end_values};
  map->words[0] = m->vertex_count;
  map->words[1] = m->triangle_count;
  for (int i = 0; i < 6; i++)
    map->words[2 + i] = (uint32_t)(uintptr_t)addresses[i];
  map->words[8] = map->overlay.mapped;
  map->words[9] = map->overlay.failed;
  return map->words;
}

/* ---- steps in units ---- */

/* Patches of a coarse level on their way. The level must outlive them. */
struct units {
  struct lod_arena *arena;
  struct lod_units units;
  struct lod_delta_level *levels;
  const struct lod_delta_level **at_hand; /* NULL: has not come */
  struct lod_delta_level joined;          /* what had come at the last lodw_units_join ... */
  uint32_t *parents;                      /* ... and which of the coarse level's vertices could be drawn there */
  struct lod_arena *drawn;
  struct lod_morph morph;
  uint8_t *states; /* of the drawing before; NULL: there was none */
  uint32_t words[16];
};

void EXPORT(lodw_units_free)(struct units *u) {
  if (u == NULL)
    return;
  lod_arena_destroy(u->drawn);
  lod_arena_destroy(u->arena);
}

/* Bytes of the index that begins at `bytes`; 0 = wrong, or fewer than 10 are there. */
size_t EXPORT(lodw_units_index_bytes)(const uint8_t *bytes, size_t size) {
  size_t length;
  memset(&problem, 0, sizeof problem);
  return lod_units_index_bytes(bytes, size, &length, &problem) == LOD_OK ? length : 0;
}

struct units *EXPORT(lodw_units_open)(const uint8_t *bytes, size_t size, const struct level *base) {
  struct lod_arena *arena = begin();
  struct units *u = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct units);
  if (u == NULL) {
    lod_arena_destroy(arena);
    (void)lod_fail_memory(&problem);
    return NULL;
  }
  u->arena = arena;
  if (lod_units_open(bytes, size, &base->mesh, NULL, arena, &u->units, &problem) == LOD_OK) {
    u->levels = LOD_NEW_ZERO(arena, u->units.header.patch_count, struct lod_delta_level);
    u->at_hand = LOD_NEW_ZERO(arena, u->units.header.patch_count, const struct lod_delta_level *);
    if (u->levels != NULL && u->at_hand != NULL)
      return u;
    (void)lod_fail_memory(&problem);
  }
  lod_arena_destroy(arena);
  return NULL;
}

/* Patches, first one to decode (LOD_NONE: none), bytes of index and frames, finer vertices, finer triangles; then for each patch: offset
 * and bytes of its frame, and as floats its ball's center and radius and its mean normal. Valid until the handle is freed. */
const uint32_t *EXPORT(lodw_units_words)(struct units *u) {
  const struct lod_units_header *h = &u->units.header;
  uint32_t *words = LOD_NEW(u->arena, 5 + 9 * (size_t)h->patch_count, uint32_t), *at = words;
  if (words == NULL)
    return NULL;
  const uint32_t head[5] = {h->patch_count, h->primer_patch, (uint32_t)h->size, h->vertices, h->triangles};
  memcpy(at, head, sizeof head);
  at += 5;
  for (uint32_t p = 0; p < h->patch_count; p++, at += 9) {
    const struct lod_units_patch *patch = &u->units.patches[p];
    const float numbers[7] = {(float)patch->center[0], (float)patch->center[1], (float)patch->center[2], (float)patch->radius,
                              (float)patch->normal[0], (float)patch->normal[1], (float)patch->normal[2]};
    at[0] = (uint32_t)patch->offset;
    at[1] = (uint32_t)patch->size;
    memcpy(at + 2, numbers, sizeof numbers);
  }
  return words;
}

/* 1: the patch is at hand; 0: its bytes are wrong, and nothing has changed. */
uint32_t EXPORT(lodw_units_decode)(struct units *u, uint32_t patch, const uint8_t *bytes, size_t size) {
  const struct lod_delta_limits limits = {.max_memory_bytes = memory_limit};
  struct lod_delta_level level;
  memset(&problem, 0, sizeof problem);
  if (lod_units_decode(&u->units, patch, bytes, size, &limits, u->arena, &level, &problem) != LOD_OK)
    return 0;
  u->levels[patch] = level;
  u->at_hand[patch] = &u->levels[patch];
  return 1;
}

/* What has come, as a level of its own; with all patches it is the finer level. */
struct level *EXPORT(lodw_units_join)(struct units *u) {
  struct level *level = new_level();
  struct lod_delta_level *joined = &u->joined;
  const size_t bases = u->units.base->vertex_count;
  if (level == NULL)
    return NULL;
  if (lod_units_join(&u->units, u->at_hand, level->arena, joined, &problem) == LOD_OK) {
    u->parents = lod_arena_copy(level->arena, joined->kept, bases * sizeof *u->parents);
    if (u->parents != NULL) {
      level->mesh = joined->mesh;
      level->kept = (uint32_t *)(uintptr_t)joined->kept;
      level->kept_count = (uint32_t)bases;
      lod_units_settle(&u->units, u->at_hand, u->parents);
      return level;
    }
    (void)lod_fail_memory(&problem);
  }
  lodw_level_free(level);
  return NULL;
}

/* Vertices of `fine`, the joined level as it is drawn, instead of the joined level's own: they are at the same places. */
static enum lod_status name_parents(const struct units *u, const struct level *fine, struct lod_arena *arena, uint32_t **parents) {
  const uint32_t bases = u->units.base->vertex_count;
  uint32_t *same = LOD_NEW(arena, u->joined.mesh.vertex_count, uint32_t);
  *parents = LOD_NEW(arena, bases, uint32_t);
  if (same == NULL || *parents == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_overlay_match(&u->joined.mesh, &fine->mesh, 1e-100, arena, same));
  for (uint32_t v = 0; v < bases; v++)
    (*parents)[v] = u->parents[v] == LOD_NONE ? LOD_NONE : same[u->parents[v]];
  return LOD_OK;
}

/* What to draw of it. fine: the level that lodw_units_join made last, as it is drawn, with coarse and fine values as for lodw_map_draw.
 * Returns: vertices, triangles, addresses of start and end positions, triangles, finer and coarse face of each triangle, start and end
 * values, settled (a byte a vertex); coarse triangles mapped, failed. */
const uint32_t *EXPORT(lodw_units_draw)(struct units *u, const struct level *coarse, const struct level *fine, uint32_t values,
                                        const float *coarse_values, const float *fine_values) {
  const struct lod_morph_values all = {values, coarse_values, fine_values};
  const uint32_t triangles = coarse->mesh.triangle_count;
  struct lod_overlay overlay;
  uint32_t *parents;
  lod_arena_destroy(u->drawn);
  u->drawn = begin();
  if (u->drawn == NULL)
    return NULL;
  enum lod_status status = name_parents(u, fine, u->drawn, &parents);
  if (status == LOD_OK)
    status = lod_overlay_create(&coarse->mesh, &fine->mesh, parents, NULL, u->drawn, &overlay, &problem);
  if (status == LOD_OK)
    status = lod_overlay_part(&overlay, &coarse->mesh, &fine->mesh, values == 0 ? NULL : &all, u->states, u->drawn, &u->morph);
  if (status == LOD_OK && u->states == NULL && (u->states = LOD_NEW(u->arena, triangles, uint8_t)) == NULL)
    status = LOD_MEMORY;
  if (status == LOD_MEMORY)
    (void)lod_fail_memory(&problem);
  if (status != LOD_OK)
    return NULL;
  memcpy(u->states, overlay.states, triangles);
  const struct lod_morph *m = &u->morph;
  const void *const addresses[8] = {m->start,        m->end,          m->triangles,  m->fine_faces,
                                    m->coarse_faces, m->start_values, m->end_values, m->settled};
  u->words[0] = m->vertex_count;
  u->words[1] = m->triangle_count;
  for (int i = 0; i < 8; i++)
    u->words[2 + i] = (uint32_t)(uintptr_t)addresses[i];
  u->words[10] = overlay.mapped;
  u->words[11] = overlay.failed;
  return u->words;
}
