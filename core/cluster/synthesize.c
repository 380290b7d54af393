/* What becomes of the source's triangles, edges and points: their images, without duplicates and without what is covered anyway.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 2 (synthesis, elimination).
 *
 * Triangles are told apart by their three cells; both orientations may stay (a flattened part is seen from both sides), unless one of
 * them has less than a quarter of the other's source area: then it is a fold and goes. Covered means: an edge that is an edge of a
 * surviving triangle, a point that is an end of any surviving triangle or edge. */
#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

static const double kFoldArea = 0.25;

/* In `nearby` while it is being filled: a triangle's id, or one of these with the number of a pair or cell. */
enum { COLLAPSED_TO_PAIR = 1 << 30 };
#define COLLAPSED_TO_CELL (2u << 30)
#define COLLAPSED_ID 0x3fffffffu
_Static_assert(COLLAPSED_TO_PAIR > CLUSTER_MAX_COUNT, "tags lie above ids");

/* Two cells, the lesser first, that a triangle or an edge has collapsed to. */
struct pair {
  uint32_t cell[2];
  uint32_t source;    /* as cluster_synthesis.edge_source */
  uint32_t primitive; /* the triangle that covers it, or LOD_NONE while it is to become an edge */
};

/* A side of a surviving triangle, at its lesser end. */
struct side {
  uint32_t other, triangle;
};

/* Beyond this many sides at a cell, what they say about a pair is remembered in the table of pairs. */
enum { LONG_LIST = 64 };

struct work {
  const struct cluster_unit *unit;
  const struct cluster_cells *cells;
  struct cluster_synthesis *out;
  struct lod_arena *arena;       /* of the results */
  struct lod_arena *scratch;     /* until the end */
  struct lod_arena *table_arena; /* of triangle_slots, until the triangles are known */
  uint32_t triangle_mask, pair_mask, pair_count, pair_room, fold_count, fold_room;
  uint32_t *triangle_slots, *pair_slots;
  struct pair *pairs;
  uint32_t (*folds)[2]; /* triangles of equal cells and opposite orientation */
  uint32_t *side_begin; /* cell -> the sides of surviving triangles that it is the lesser end of, CSR */
  struct side *sides;
  uint32_t *cell_source; /* cell -> first source primitive that collapsed into it */
};

/* A larger copy of an array of `count` entries with room for *room * 2. */
static void *grow(struct lod_arena *arena, const void *array, uint32_t count, size_t size, uint32_t *room) {
  uint32_t more = *room < 512 ? 1024 : 2 * *room;
  void *larger = lod_arena_alloc(arena, more, size);
  if (larger == NULL)
    return NULL;
  if (count != 0)
    memcpy(larger, array, count * size);
  *room = more;
  return larger;
}

/* Rotated so that the smallest comes first. */
static void rotate(uint32_t a, uint32_t b, uint32_t c, uint32_t out[3]) {
  if (a < b && a < c) {
    out[0] = a, out[1] = b, out[2] = c;
  } else if (b < c) {
    out[0] = b, out[1] = c, out[2] = a;
  } else {
    out[0] = c, out[1] = a, out[2] = b;
  }
}

static uint64_t triangle_hash(const uint32_t t[3]) {
  uint64_t low = t[1] < t[2] ? t[1] : t[2], high = t[1] < t[2] ? t[2] : t[1];
  return cluster_hash(((uint64_t)t[0] << 32 | low) * UINT64_C(0x9e3779b97f4a7c15) + high);
}

static enum lod_status resize_triangle_slots(struct work *work, uint32_t size) {
  work->triangle_slots = LOD_NEW(work->table_arena, size, uint32_t);
  if (work->triangle_slots == NULL)
    return LOD_MEMORY;
  memset(work->triangle_slots, 0xff, size * sizeof *work->triangle_slots);
  work->triangle_mask = size - 1;
  for (uint32_t i = 0; i < work->out->triangle_count; i++) {
    uint32_t slot = (uint32_t)triangle_hash(work->out->triangles[i]) & work->triangle_mask;
    while (work->triangle_slots[slot] != LOD_NONE)
      slot = (slot + 1) & work->triangle_mask;
    work->triangle_slots[slot] = i;
  }
  return LOD_OK;
}

static enum lod_status add_triangle(struct work *work, const uint32_t key[3], uint32_t hash, uint32_t source, uint32_t *room) {
  struct cluster_synthesis *out = work->out;
  uint32_t reverse = LOD_NONE, slot = hash & work->triangle_mask;
  for (uint32_t id; (id = work->triangle_slots[slot]) != LOD_NONE; slot = (slot + 1) & work->triangle_mask) {
    const uint32_t *other = out->triangles[id];
    if (other[0] != key[0])
      continue;
    if (other[1] == key[1] && other[2] == key[2]) {
      out->nearby[source] = id;
      return LOD_OK;
    }
    if (other[1] == key[2] && other[2] == key[1])
      reverse = id;
  }
  if (out->triangle_count == *room) {
    uint32_t other_room = *room;
    out->triangles = grow(work->arena, out->triangles, out->triangle_count, sizeof *out->triangles, room);
    out->triangle_source = grow(work->arena, out->triangle_source, out->triangle_count, sizeof *out->triangle_source, &other_room);
    if (out->triangles == NULL || out->triangle_source == NULL)
      return LOD_MEMORY;
  }
  uint32_t id = out->triangle_count++;
  memcpy(out->triangles[id], key, sizeof out->triangles[id]);
  out->triangle_source[id] = source;
  out->nearby[source] = id;
  work->triangle_slots[slot] = id;
  if (reverse != LOD_NONE) {
    if (work->fold_count == work->fold_room) {
      work->folds = grow(work->scratch, work->folds, work->fold_count, sizeof *work->folds, &work->fold_room);
      if (work->folds == NULL)
        return LOD_MEMORY;
    }
    work->folds[work->fold_count][0] = reverse;
    work->folds[work->fold_count++][1] = id;
  }
  if (2 * (uint64_t)out->triangle_count > work->triangle_mask)
    LOD_TRY(resize_triangle_slots(work, 2 * (work->triangle_mask + 1)));
  return LOD_OK;
}

static uint32_t pair_slot(const struct work *work, uint32_t a, uint32_t b) {
  uint32_t slot = (uint32_t)cluster_hash((uint64_t)a << 32 | b) & work->pair_mask;
  for (uint32_t id; (id = work->pair_slots[slot]) != LOD_NONE; slot = (slot + 1) & work->pair_mask)
    if (work->pairs[id].cell[0] == a && work->pairs[id].cell[1] == b)
      break;
  return slot;
}

static enum lod_status resize_pair_slots(struct work *work, uint32_t size) {
  work->pair_slots = LOD_NEW(work->scratch, size, uint32_t);
  if (work->pair_slots == NULL)
    return LOD_MEMORY;
  memset(work->pair_slots, 0xff, size * sizeof *work->pair_slots);
  work->pair_mask = size - 1;
  for (uint32_t i = 0; i < work->pair_count; i++)
    work->pair_slots[pair_slot(work, work->pairs[i].cell[0], work->pairs[i].cell[1])] = i;
  return LOD_OK;
}

/* A surviving triangle with side low-high, or LOD_NONE. */
static uint32_t triangle_beside(const struct work *work, uint32_t low, uint32_t high) {
  for (uint32_t i = work->side_begin[low]; i < work->side_begin[low + 1]; i++)
    if (work->sides[i].other == high)
      return work->sides[i].triangle;
  return LOD_NONE;
}

/* *id: the number of the pair of cells in `nearby`'s terms, that is the triangle that covers it or COLLAPSED_TO_PAIR with a pair. */
static enum lod_status add_pair(struct work *work, uint32_t a, uint32_t b, uint32_t source, uint32_t *id) {
  uint32_t low = a < b ? a : b, high = a < b ? b : a, beside = LOD_NONE;
  bool remember = work->side_begin[low + 1] - work->side_begin[low] > LONG_LIST;
  if (!remember && (beside = triangle_beside(work, low, high)) != LOD_NONE) {
    *id = beside;
    return LOD_OK;
  }
  uint32_t slot = pair_slot(work, low, high);
  *id = work->pair_slots[slot];
  if (*id != LOD_NONE) {
    *id = work->pairs[*id].primitive != LOD_NONE ? work->pairs[*id].primitive : COLLAPSED_TO_PAIR | *id;
    return LOD_OK;
  }
  if (remember)
    beside = triangle_beside(work, low, high);
  if (work->pair_count == work->pair_room) {
    work->pairs = grow(work->scratch, work->pairs, work->pair_count, sizeof *work->pairs, &work->pair_room);
    if (work->pairs == NULL)
      return LOD_MEMORY;
  }
  uint32_t pair = work->pair_slots[slot] = work->pair_count++;
  work->pairs[pair] = (struct pair){{low, high}, source, beside};
  *id = beside != LOD_NONE ? beside : COLLAPSED_TO_PAIR | pair;
  if (2 * (uint64_t)work->pair_count > work->pair_mask)
    return resize_pair_slots(work, 2 * (work->pair_mask + 1));
  return LOD_OK;
}

/* A source triangle on its way: where its slot is going to be looked for. */
struct arrival {
  uint32_t source, slot;
  uint32_t key[3]; /* rotated cells */
};

/* Surviving triangles, in source order. Hashes a handful ahead, so that their slots are on the way from memory while the ones before are
 * looked up. likely: triangles of the level to make room for. */
static enum lod_status map_triangles(struct work *work, uint32_t likely) {
  const struct cluster_unit *unit = work->unit;
  const uint32_t *image = work->cells->image;
  struct cluster_synthesis *out = work->out;
  out->triangles = lod_arena_alloc(work->arena, likely, sizeof *out->triangles);
  out->triangle_source = LOD_NEW(work->arena, likely, uint32_t);
  if (out->triangles == NULL || out->triangle_source == NULL)
    return LOD_MEMORY;
  enum { AHEAD = 32 };
  struct arrival arrivals[AHEAD];
  uint32_t room = likely, waiting = 0;
  for (uint32_t t = 0, count = unit->mesh->triangle_count; t < count; t++) {
    const uint32_t *v = unit->triangles[t];
    uint32_t a = image[v[0]], b = image[v[1]], c = image[v[2]];
    if (a == b && b == c) {
      out->nearby[t] = COLLAPSED_TO_CELL | a;
      if (work->cell_source[a] == LOD_NONE)
        work->cell_source[a] = t;
    } else if (a != b && b != c && c != a) {
      struct arrival *arrival = &arrivals[waiting++];
      rotate(a, b, c, arrival->key);
      arrival->source = t;
      arrival->slot = (uint32_t)triangle_hash(arrival->key);
      __builtin_prefetch(&work->triangle_slots[arrival->slot & work->triangle_mask]);
    } else {
      out->nearby[t] = COLLAPSED_TO_PAIR;
    }
    if (waiting == AHEAD || t + 1 == count) {
      for (uint32_t i = 0; i < waiting; i++)
        LOD_TRY(add_triangle(work, arrivals[i].key, arrivals[i].slot, arrivals[i].source, &room));
      waiting = 0;
    }
  }
  return LOD_OK;
}

/* Triangles collapsed to a pair of cells: the triangle that covers the pair, or a new pair. */
static enum lod_status map_pairs(struct work *work) {
  const struct cluster_unit *unit = work->unit;
  const uint32_t *image = work->cells->image;
  uint32_t last[2] = {LOD_NONE, LOD_NONE}, last_id = LOD_NONE;
  for (uint32_t t = 0; t < unit->mesh->triangle_count; t++) {
    if (work->out->nearby[t] != COLLAPSED_TO_PAIR)
      continue;
    const uint32_t *v = unit->triangles[t];
    uint32_t a = image[v[0]], b = image[v[1]] != a ? image[v[1]] : image[v[2]];
    if (!((a == last[0] && b == last[1]) || (a == last[1] && b == last[0]))) {
      LOD_TRY(add_pair(work, a, b, t, &last_id));
      last[0] = a;
      last[1] = b;
    }
    work->out->nearby[t] = last_id;
  }
  return LOD_OK;
}

/* Source edges and points by working vertices: those that the mesh has free-standing, by a search from source to working. */
static enum lod_status map_free_primitives(struct work *work) {
  const struct lod_mesh *mesh = work->unit->mesh;
  if (mesh->edge_count == 0 && mesh->point_count == 0)
    return LOD_OK;
  uint32_t *place = LOD_NEW(work->scratch, mesh->vertex_count, uint32_t);
  if (place == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < work->unit->count; v++)
    place[work->unit->source[v]] = v;
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    uint32_t a = work->cells->image[place[mesh->edges[e][0]]], b = work->cells->image[place[mesh->edges[e][1]]], id;
    if (a != b)
      LOD_TRY(add_pair(work, a, b, mesh->triangle_count + e, &id));
    else if (work->cell_source[a] == LOD_NONE)
      work->cell_source[a] = mesh->triangle_count + e;
  }
  for (uint32_t p = 0; p < mesh->point_count; p++) {
    uint32_t a = work->cells->image[place[mesh->points[p]]];
    if (work->cell_source[a] == LOD_NONE)
      work->cell_source[a] = mesh->triangle_count + mesh->edge_count + p;
  }
  return LOD_OK;
}

static double source_area(const struct cluster_unit *unit, uint32_t t) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++) {
    uint32_t v = unit->triangles[t][k];
    p[k] = lod_vec3_make((double)unit->x[v], (double)unit->y[v], (double)unit->z[v]);
  }
  return lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
}

/* Removes the lesser side of a fold and renumbers the triangles. */
static enum lod_status remove_folds(struct work *work) {
  struct cluster_synthesis *out = work->out;
  if (work->fold_count == 0)
    return LOD_OK;
  uint32_t *entry = LOD_NEW(work->scratch, out->triangle_count, uint32_t);
  double *area = LOD_NEW_ZERO(work->scratch, 2 * (size_t)work->fold_count, double);
  if (entry == NULL || area == NULL)
    return LOD_MEMORY;
  memset(entry, 0xff, out->triangle_count * sizeof *entry);
  for (uint32_t f = 0; f < work->fold_count; f++)
    for (uint32_t side = 0; side < 2; side++)
      entry[work->folds[f][side]] = 2 * f + side;
  uint32_t source_count = work->unit->mesh->triangle_count;
  for (uint32_t t = 0; t < source_count; t++)
    if (out->nearby[t] < COLLAPSED_TO_PAIR && entry[out->nearby[t]] != LOD_NONE)
      area[entry[out->nearby[t]]] += source_area(work->unit, t);
  /* From here on entry[i] is where triangle i goes. */
  uint32_t kept = 0;
  for (uint32_t i = 0; i < out->triangle_count; i++) {
    uint32_t e = entry[i];
    if (e != LOD_NONE && (area[e] < kFoldArea * area[e ^ 1])) {
      entry[i] = LOD_NONE;
      continue;
    }
    entry[i] = kept;
    memmove(out->triangles[kept], out->triangles[i], sizeof *out->triangles);
    out->triangle_source[kept++] = out->triangle_source[i];
  }
  out->triangle_count = kept;
  for (uint32_t f = 0; f < work->fold_count; f++)
    for (int side = 0; side < 2; side++)
      if (entry[work->folds[f][side]] == LOD_NONE)
        entry[work->folds[f][side]] = entry[work->folds[f][1 - side]];
  for (uint32_t t = 0; t < source_count; t++)
    if (out->nearby[t] < COLLAPSED_TO_PAIR)
      out->nearby[t] = entry[out->nearby[t]];
  return LOD_OK;
}

/* Also a triangle of each cell, in cell_primitive. */
static enum lod_status list_sides(struct work *work, uint32_t *cell_primitive) {
  const struct cluster_synthesis *out = work->out;
  uint32_t cells = work->cells->count;
  uint32_t *begin = work->side_begin = LOD_NEW_ZERO(work->scratch, (size_t)cells + 1, uint32_t);
  work->sides = lod_arena_alloc(work->scratch, 3 * (size_t)out->triangle_count, sizeof *work->sides);
  if (begin == NULL || work->sides == NULL)
    return LOD_MEMORY;
  memset(cell_primitive, 0xff, cells * sizeof *cell_primitive);
  for (uint32_t i = 0; i < out->triangle_count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t a = out->triangles[i][k], b = out->triangles[i][k == 2 ? 0 : k + 1];
      begin[a < b ? a : b]++;
      cell_primitive[a] = i;
    }
  uint32_t sum = 0;
  for (uint32_t c = 0; c <= cells; c++) {
    sum += begin[c];
    begin[c] = sum;
  }
  for (uint32_t i = out->triangle_count; i-- > 0;)
    for (int k = 0; k < 3; k++) {
      uint32_t a = out->triangles[i][k], b = out->triangles[i][k == 2 ? 0 : k + 1];
      work->sides[--begin[a < b ? a : b]] = (struct side){a < b ? b : a, i};
    }
  return LOD_OK;
}

/* Pairs that no triangle covers become edges; cells that nothing uses become points, and get their primitive in cell_primitive. */
static enum lod_status keep_uncovered(struct work *work, uint32_t *cell_primitive, struct lod_arena *arena) {
  struct cluster_synthesis *out = work->out;
  uint32_t cells = work->cells->count;
  for (uint32_t p = 0; p < work->pair_count; p++)
    out->edge_count += work->pairs[p].primitive == LOD_NONE;
  out->edges = lod_arena_alloc(arena, out->edge_count, sizeof *out->edges);
  out->edge_source = LOD_NEW(arena, out->edge_count, uint32_t);
  if (out->edges == NULL || out->edge_source == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0, edge = 0; p < work->pair_count; p++) {
    struct pair *pair = &work->pairs[p];
    if (pair->primitive != LOD_NONE)
      continue;
    memcpy(out->edges[edge], pair->cell, sizeof pair->cell);
    out->edge_source[edge] = pair->source;
    pair->primitive = out->triangle_count + edge++;
    for (int k = 0; k < 2; k++)
      if (cell_primitive[pair->cell[k]] == LOD_NONE)
        cell_primitive[pair->cell[k]] = pair->primitive;
  }
  for (uint32_t c = 0; c < cells; c++)
    out->point_count += cell_primitive[c] == LOD_NONE;
  out->points = LOD_NEW(arena, out->point_count, uint32_t);
  out->point_source = LOD_NEW(arena, out->point_count, uint32_t);
  if (out->points == NULL || out->point_source == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0, point = 0; c < cells; c++)
    if (cell_primitive[c] == LOD_NONE) {
      assert(work->cell_source[c] != LOD_NONE); /* something uses every working vertex */
      out->points[point] = c;
      out->point_source[point] = work->cell_source[c];
      cell_primitive[c] = out->triangle_count + out->edge_count + point++;
    }
  return LOD_OK;
}

static enum lod_status make_triangles(struct work *work) {
  uint32_t source_count = work->unit->mesh->triangle_count;
  uint64_t likely = 2 * (uint64_t)work->cells->count < source_count ? 2 * (uint64_t)work->cells->count : source_count;
  work->table_arena = lod_arena_create_child(work->scratch);
  enum lod_status status = work->table_arena != NULL ? resize_triangle_slots(work, cluster_power_of_two(2 * likely)) : LOD_MEMORY;
  if (status == LOD_OK)
    status = map_triangles(work, (uint32_t)likely + 16);
  lod_arena_destroy(work->table_arena);
  return status == LOD_OK ? remove_folds(work) : status;
}

static enum lod_status synthesize(struct work *work, struct lod_arena *arena) {
  struct cluster_synthesis *out = work->out;
  uint32_t cells = work->cells->count, source_count = work->unit->mesh->triangle_count;
  out->nearby = LOD_NEW(arena, source_count, uint32_t);
  work->cell_source = LOD_NEW(work->scratch, cells, uint32_t);
  uint32_t *cell_primitive = LOD_NEW(work->scratch, cells, uint32_t);
  if (out->nearby == NULL || work->cell_source == NULL || cell_primitive == NULL)
    return LOD_MEMORY;
  memset(work->cell_source, 0xff, cells * sizeof *work->cell_source);
  LOD_TRY(make_triangles(work));
  LOD_TRY(resize_pair_slots(work, 256));
  LOD_TRY(list_sides(work, cell_primitive));
  LOD_TRY(map_pairs(work));
  LOD_TRY(map_free_primitives(work));
  LOD_TRY(keep_uncovered(work, cell_primitive, arena));
  for (uint32_t t = 0; t < source_count; t++) {
    uint32_t id = out->nearby[t] & COLLAPSED_ID;
    if (out->nearby[t] >= COLLAPSED_TO_CELL)
      out->nearby[t] = cell_primitive[id];
    else if (out->nearby[t] >= COLLAPSED_TO_PAIR)
      out->nearby[t] = work->pairs[id].primitive;
  }
  return LOD_OK;
}

enum lod_status cluster_synthesize(const struct cluster_unit *unit, const struct cluster_cells *cells, struct lod_arena *arena,
                                   struct cluster_synthesis *synthesis) {
  *synthesis = (struct cluster_synthesis){0};
  struct work work = {.unit = unit, .cells = cells, .out = synthesis, .arena = arena, .scratch = lod_arena_create_child(arena)};
  enum lod_status status = work.scratch != NULL ? synthesize(&work, arena) : LOD_MEMORY;
  lod_arena_destroy(work.scratch);
  return status;
}
