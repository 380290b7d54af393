#include "core/mesh/mesh.h"

#include <math.h>
#include <string.h>

struct lod_bounds lod_mesh_bounds(const struct lod_mesh *mesh) {
  struct lod_bounds bounds = {{0}, {0}};
  if (mesh->vertex_count == 0)
    return bounds;
  float min[3], max[3];
  memcpy(min, mesh->positions[0], sizeof min);
  memcpy(max, mesh->positions[0], sizeof max);
  for (uint32_t v = 1; v < mesh->vertex_count; v++)
    for (int k = 0; k < 3; k++) {
      float x = mesh->positions[v][k];
      min[k] = x < min[k] ? x : min[k];
      max[k] = x > max[k] ? x : max[k];
    }
  for (int k = 0; k < 3; k++) {
    bounds.min[k] = (double)min[k];
    bounds.max[k] = (double)max[k];
  }
  return bounds;
}

double lod_bounds_diagonal(const struct lod_bounds *bounds) {
  return lod_vec3_distance(lod_vec3_make(bounds->min[0], bounds->min[1], bounds->min[2]),
                           lod_vec3_make(bounds->max[0], bounds->max[1], bounds->max[2]));
}

double lod_mesh_magnitude(const struct lod_mesh *mesh) {
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  double magnitude = 0;
  for (int k = 0; k < 3; k++)
    magnitude = fmax(magnitude, fmax(fabs(bounds.min[k]), fabs(bounds.max[k])));
  return magnitude;
}

/* --- check --- */

static bool bad(struct lod_problem *problem, const char *type, const char *what, uint32_t item, const char *rule) {
  lod_fail(problem, LOD_BAD_INPUT, type, "The mesh is not valid: %s %u %s.", what, item, rule);
  return false;
}

static bool check_arrays(const struct lod_mesh *m, struct lod_problem *problem) {
  const struct {
    const char *name;
    bool missing;
  } rules[] = {
      {"positions", m->vertex_count != 0 && m->positions == NULL},
      {"triangles", m->triangle_count != 0 && m->triangles == NULL},
      {"edges", m->edge_count != 0 && m->edges == NULL},
      {"points", m->point_count != 0 && m->points == NULL},
      {"wedge_vertex", m->wedge_count != 0 && m->wedge_vertex == NULL},
      {"corners", m->wedge_count != 0 && m->triangle_count != 0 && m->corners == NULL},
  };
  for (size_t i = 0; i < sizeof rules / sizeof rules[0]; i++)
    if (rules[i].missing) {
      lod_fail(problem, LOD_BAD_INPUT, "array-missing", "The mesh is not valid: its array %s is missing although its count is not 0.",
               rules[i].name);
      return false;
    }
  return true;
}

static bool check_thickness(const float *thickness, uint32_t count, const char *what, struct lod_problem *problem) {
  for (uint32_t i = 0; thickness != NULL && i < count; i++)
    if (!(thickness[i] >= 0) || !isfinite(thickness[i]))
      return bad(problem, "thickness-not-finite", what, i, "has a thickness that is negative or not finite");
  return true;
}

bool lod_mesh_check(const struct lod_mesh *mesh, struct lod_problem *problem) {
  if (!check_arrays(mesh, problem))
    return false;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (!isfinite(mesh->positions[v][0]) || !isfinite(mesh->positions[v][1]) || !isfinite(mesh->positions[v][2]))
      return bad(problem, "position-not-finite", "vertex", v, "has a coordinate that is not finite");
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    if (mesh->wedge_vertex[w] >= mesh->vertex_count)
      return bad(problem, "index-out-of-range", "wedge", w, "belongs to a vertex beyond the last one");
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int c = 0; c < 3; c++) {
      if (mesh->triangles[t][c] >= mesh->vertex_count)
        return bad(problem, "index-out-of-range", "triangle", t, "refers to a vertex beyond the last one");
      if (mesh->wedge_count == 0)
        continue;
      if (mesh->corners[t][c] >= mesh->wedge_count)
        return bad(problem, "index-out-of-range", "triangle", t, "refers to a wedge beyond the last one");
      if (mesh->wedge_vertex[mesh->corners[t][c]] != mesh->triangles[t][c])
        return bad(problem, "wedge-of-other-vertex", "triangle", t, "has a corner whose wedge belongs to another vertex");
    }
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    if (mesh->edges[e][0] >= mesh->vertex_count || mesh->edges[e][1] >= mesh->vertex_count)
      return bad(problem, "index-out-of-range", "edge", e, "refers to a vertex beyond the last one");
  for (uint32_t p = 0; p < mesh->point_count; p++)
    if (mesh->points[p] >= mesh->vertex_count)
      return bad(problem, "index-out-of-range", "point", p, "refers to a vertex beyond the last one");
  return check_thickness(mesh->edge_thickness, mesh->edge_count, "edge", problem) &&
         check_thickness(mesh->point_thickness, mesh->point_count, "point", problem);
}

/* --- weld ---
 *
 * Items (vertices, wedges) with equal keys get the number of the first of them. Open addressing in a table that doubles with the number
 * of different keys, so that a triangle soup needs memory for its real vertices only; 32 bits of the hash stay beside the item, so
 * growing and most misses never touch the keys. Hashes are computed a block ahead and the slots prefetched. */

enum { BLOCK = 64 };

struct key_source {
  uint32_t words;              /* of 32 bits in a key */
  const struct lod_mesh *mesh; /* not owned */
  const uint32_t *vertex_map;  /* for wedges */
  void (*read)(const struct key_source *source, uint32_t item, uint32_t *words);
};

enum { MOST_WORDS = 1 + 3 + 2 * LOD_UV_SETS + 4 };

static uint32_t canonical_bits(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits == 0x80000000u ? 0 : bits; /* -0 is 0 */
}

static void read_vertex(const struct key_source *source, uint32_t v, uint32_t *words) {
  for (int k = 0; k < 3; k++)
    words[k] = canonical_bits(source->mesh->positions[v][k]);
}

static void read_wedge(const struct key_source *source, uint32_t w, uint32_t *words) {
  const struct lod_mesh *mesh = source->mesh;
  *words++ = source->vertex_map[mesh->wedge_vertex[w]];
  for (int k = 0; mesh->normals != NULL && k < 3; k++)
    *words++ = canonical_bits(mesh->normals[w][k]);
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int k = 0; mesh->uvs[set] != NULL && k < 2; k++)
      *words++ = canonical_bits(mesh->uvs[set][w][k]);
  for (int k = 0; mesh->colors != NULL && k < 4; k++)
    *words++ = canonical_bits(mesh->colors[w][k]);
}

static uint64_t hash_words(const uint32_t *words, uint32_t count) {
  uint64_t h = 0x9e3779b97f4a7c15u;
  for (uint32_t i = 0; i < count; i++) {
    h = (h ^ words[i]) * 0xff51afd7ed558ccdu;
    h ^= h >> 32;
  }
  h *= 0xc4ceb9fe1a85ec53u;
  return h ^ h >> 29;
}

struct slot {
  uint32_t tag;
  uint32_t item; /* LOD_NONE = free */
};

struct table {
  struct lod_arena *arena; /* of `slots` alone: gone when the table grows */
  struct slot *slots;
  uint64_t mask;
  uint64_t used;
};

static bool table_allocate(struct table *table, struct lod_arena *parent, uint64_t capacity) {
  table->arena = lod_arena_create_child(parent);
  table->slots = table->arena != NULL ? LOD_NEW(table->arena, capacity, struct slot) : NULL;
  table->mask = capacity - 1;
  if (table->slots == NULL)
    return false;
  memset(table->slots, 0xff, capacity * sizeof *table->slots);
  return true;
}

/* The slot comes from the tag alone, so that growing needs no key. Past 2^32 slots the tables only gets denser chains. */
static uint64_t first_slot(const struct table *table, uint32_t tag) {
  return (table->mask >> 32 ? (uint64_t)tag << 1 : tag) & table->mask;
}

static bool table_grow(struct table *table, struct lod_arena *parent) {
  struct table bigger = {.used = table->used};
  if (!table_allocate(&bigger, parent, (table->mask + 1) * 2)) {
    lod_arena_destroy(bigger.arena);
    return false;
  }
  for (uint64_t i = 0; i <= table->mask; i++) {
    if (table->slots[i].item == LOD_NONE)
      continue;
    uint64_t at = first_slot(&bigger, table->slots[i].tag);
    while (bigger.slots[at].item != LOD_NONE)
      at = (at + 1) & bigger.mask;
    bigger.slots[at] = table->slots[i];
  }
  lod_arena_destroy(table->arena);
  *table = bigger;
  return true;
}

/* The first item entered with the key of `item`; `item` itself when it is new. */
static uint32_t table_enter(struct table *table, const struct key_source *source, uint32_t item, uint32_t tag, const uint32_t *key) {
  uint64_t at = first_slot(table, tag);
  for (; table->slots[at].item != LOD_NONE; at = (at + 1) & table->mask) {
    if (table->slots[at].tag != tag)
      continue;
    uint32_t other[MOST_WORDS];
    source->read(source, table->slots[at].item, other);
    if (memcmp(other, key, source->words * sizeof *key) == 0)
      return table->slots[at].item;
  }
  table->slots[at] = (struct slot){tag, item};
  table->used++;
  return item;
}

/* map[item]: items with map[item] != LOD_NONE take part, and get numbers 0, 1, ... by first appearance, equal keys the same. */
static bool number_by_key(const struct key_source *source, uint32_t count, struct lod_arena *scratch, uint32_t *map, uint32_t *distinct) {
  struct table table = {0};
  bool ok = table_allocate(&table, scratch, 4096);
  uint32_t next = 0;
  for (uint64_t begin = 0; ok && begin < count; begin += BLOCK) {
    uint32_t size = count - begin < BLOCK ? (uint32_t)(count - begin) : BLOCK, first = (uint32_t)begin;
    uint32_t keys[BLOCK][MOST_WORDS], tags[BLOCK];
    if ((table.used + size) * 2 > table.mask && !(ok = table_grow(&table, scratch)))
      break;
    for (uint32_t i = 0; i < size; i++) {
      if (map[first + i] == LOD_NONE)
        continue;
      source->read(source, first + i, keys[i]);
      tags[i] = (uint32_t)hash_words(keys[i], source->words);
      __builtin_prefetch(&table.slots[first_slot(&table, tags[i])]);
    }
    for (uint32_t i = 0; i < size; i++) {
      if (map[first + i] == LOD_NONE)
        continue;
      uint32_t found = table_enter(&table, source, first + i, tags[i], keys[i]);
      map[first + i] = found == first + i ? next++ : map[found];
    }
  }
  lod_arena_destroy(table.arena);
  *distinct = next;
  return ok;
}

static uint32_t *none_map(struct lod_arena *arena, uint32_t count) {
  uint32_t *map = LOD_NEW(arena, count, uint32_t);
  if (map != NULL)
    memset(map, 0xff, count * sizeof *map);
  return map;
}

/* Copies rows of `width` floats to the new number of each item; the first of equal items wins (they are equal but for -0). */
static bool gather(const float *from, uint32_t width, const uint32_t *map, uint32_t count, uint32_t distinct, struct lod_arena *arena,
                   float **to) {
  *to = NULL;
  if (from == NULL)
    return true;
  *to = lod_arena_alloc(arena, distinct, width * sizeof(float));
  if (*to == NULL)
    return false;
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t k = 0; map[i] != LOD_NONE && k < width; k++)
      (*to)[(size_t)map[i] * width + k] = from[(size_t)i * width + k] + 0.0f; /* -0 + 0 = 0 */
  return true;
}

static bool copy_words(const void *from, size_t count, struct lod_arena *arena, void *to) {
  void *copy = NULL;
  if (from != NULL && (copy = lod_arena_alloc(arena, count, sizeof(uint32_t))) == NULL)
    return false;
  if (from != NULL)
    memcpy(copy, from, count * sizeof(uint32_t));
  memcpy(to, &copy, sizeof copy);
  return true;
}

static bool remap(const uint32_t *from, size_t count, const uint32_t *map, struct lod_arena *arena, void *to) {
  uint32_t *copy = LOD_NEW(arena, count, uint32_t);
  if (copy == NULL)
    return false;
  for (size_t i = 0; i < count; i++)
    copy[i] = map[from[i]];
  memcpy(to, &copy, sizeof copy);
  return true;
}

static void mark_used(const uint32_t *indices, size_t count, uint32_t *map) {
  for (size_t i = 0; i < count; i++)
    map[indices[i]] = 0;
}

/* Of vertices that become one, the least. */
static bool gather_limits(const struct lod_mesh *mesh, const uint32_t *map, struct lod_arena *arena, struct lod_mesh *out) {
  if (mesh->limits == NULL)
    return true;
  out->limits = LOD_NEW(arena, out->vertex_count, float);
  for (uint32_t v = 0; out->limits != NULL && v < out->vertex_count; v++)
    out->limits[v] = INFINITY;
  for (uint32_t v = 0; out->limits != NULL && v < mesh->vertex_count; v++)
    if (map[v] != LOD_NONE && mesh->limits[v] < out->limits[map[v]])
      out->limits[map[v]] = mesh->limits[v];
  return out->limits != NULL;
}

static bool weld_vertices(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_arena *scratch, struct lod_mesh *out,
                          uint32_t *map) {
  mark_used((const uint32_t *)mesh->triangles, (size_t)mesh->triangle_count * 3, map);
  mark_used((const uint32_t *)mesh->edges, (size_t)mesh->edge_count * 2, map);
  mark_used(mesh->points, mesh->point_count, map);
  struct key_source source = {3, mesh, NULL, read_vertex};
  float *positions;
  if (!number_by_key(&source, mesh->vertex_count, scratch, map, &out->vertex_count) ||
      !gather((const float *)mesh->positions, 3, map, mesh->vertex_count, out->vertex_count, arena, &positions))
    return false;
  out->positions = (float(*)[3])positions;
  if (!gather_limits(mesh, map, arena, out))
    return false;
  return (mesh->triangle_count == 0 ||
          remap((const uint32_t *)mesh->triangles, (size_t)mesh->triangle_count * 3, map, arena, &out->triangles)) &&
         (mesh->edge_count == 0 || remap((const uint32_t *)mesh->edges, (size_t)mesh->edge_count * 2, map, arena, &out->edges)) &&
         (mesh->point_count == 0 || remap(mesh->points, mesh->point_count, map, arena, &out->points));
}

static bool weld_wedges(const struct lod_mesh *mesh, const uint32_t *vertex_map, struct lod_arena *arena, struct lod_arena *scratch,
                        struct lod_mesh *out) {
  if (mesh->wedge_count == 0 || mesh->corners == NULL)
    return true;
  uint32_t *map = none_map(scratch, mesh->wedge_count);
  if (map == NULL)
    return false;
  mark_used((const uint32_t *)mesh->corners, (size_t)mesh->triangle_count * 3, map);
  struct key_source source = {1, mesh, vertex_map, read_wedge};
  source.words += (mesh->normals != NULL ? 3 : 0) + (mesh->colors != NULL ? 4 : 0);
  for (int set = 0; set < LOD_UV_SETS; set++)
    source.words += mesh->uvs[set] != NULL ? 2 : 0;
  if (!number_by_key(&source, mesh->wedge_count, scratch, map, &out->wedge_count))
    return false;
  if (out->wedge_count == 0)
    return true;
  out->wedge_vertex = LOD_NEW(arena, out->wedge_count, uint32_t);
  if (out->wedge_vertex == NULL)
    return false;
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    if (map[w] != LOD_NONE)
      out->wedge_vertex[map[w]] = vertex_map[mesh->wedge_vertex[w]];
  float *rows;
  if (!gather((const float *)mesh->normals, 3, map, mesh->wedge_count, out->wedge_count, arena, &rows))
    return false;
  out->normals = (float(*)[3])rows;
  for (int set = 0; set < LOD_UV_SETS; set++) {
    if (!gather((const float *)mesh->uvs[set], 2, map, mesh->wedge_count, out->wedge_count, arena, &rows))
      return false;
    out->uvs[set] = (float(*)[2])rows;
  }
  if (!gather((const float *)mesh->colors, 4, map, mesh->wedge_count, out->wedge_count, arena, &rows))
    return false;
  out->colors = (float(*)[4])rows;
  return remap((const uint32_t *)mesh->corners, (size_t)mesh->triangle_count * 3, map, arena, &out->corners);
}

static bool copy_tags(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_mesh *out) {
  return copy_words(mesh->materials, mesh->triangle_count, arena, &out->materials) &&
         copy_words(mesh->parts, mesh->triangle_count, arena, &out->parts) &&
         copy_words(mesh->edge_thickness, mesh->edge_count, arena, &out->edge_thickness) &&
         copy_words(mesh->edge_materials, mesh->edge_count, arena, &out->edge_materials) &&
         copy_words(mesh->edge_parts, mesh->edge_count, arena, &out->edge_parts) &&
         copy_words(mesh->point_thickness, mesh->point_count, arena, &out->point_thickness) &&
         copy_words(mesh->point_materials, mesh->point_count, arena, &out->point_materials) &&
         copy_words(mesh->point_parts, mesh->point_count, arena, &out->point_parts);
}

enum lod_status lod_mesh_weld(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_mesh *welded, uint32_t **vertex_map) {
  struct lod_mesh out = {.triangle_count = mesh->triangle_count, .edge_count = mesh->edge_count, .point_count = mesh->point_count};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  uint32_t *map = none_map(vertex_map != NULL ? arena : scratch, mesh->vertex_count);
  bool ok = map != NULL && weld_vertices(mesh, arena, scratch, &out, map) && weld_wedges(mesh, map, arena, scratch, &out) &&
            copy_tags(mesh, arena, &out);
  lod_arena_destroy(scratch);
  if (!ok)
    return LOD_MEMORY;
  *welded = out;
  if (vertex_map != NULL)
    *vertex_map = map;
  return LOD_OK;
}
