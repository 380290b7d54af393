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

/* In `nearby` while it is being filled: a triangle's id, or one of these with the id of a pair or cell. */
enum { COLLAPSED_TO_PAIR = 1 << 30 };
#define COLLAPSED_TO_CELL (2u << 30)
#define COLLAPSED_ID 0x3fffffffu
_Static_assert(COLLAPSED_TO_PAIR > CLUSTER_MAX_COUNT, "tags lie above ids");

/* Two cells, the smaller first, that a triangle or an edge has collapsed to. */
struct pair {
  uint32_t cell[2];
  uint32_t source;    /* as cluster_synthesis.edge_source */
  uint32_t primitive; /* once resolved */
};

struct work {
  const struct cluster_unit *unit;
  const struct cluster_cells *cells;
  struct cluster_synthesis *out;
  struct lod_arena *scratch;
  uint32_t triangle_mask, pair_mask, pair_count, pair_room, fold_count, fold_room;
  uint32_t *triangle_slots, *pair_slots;
  struct pair *pairs;
  uint32_t (*folds)[2];      /* triangles of equal cells and opposite orientation */
  uint32_t *fan_begin, *fan; /* cell -> its triangles, CSR */
  uint32_t *cell_source;     /* cell -> first source primitive that collapsed into it */
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
  work->triangle_slots = LOD_NEW(work->scratch, size, uint32_t);
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

static enum lod_status add_triangle(struct work *work, const uint32_t image[3], uint32_t source, uint32_t *room) {
  struct cluster_synthesis *out = work->out;
  uint32_t key[3], reverse = LOD_NONE;
  rotate(image[0], image[1], image[2], key);
  uint32_t slot = (uint32_t)triangle_hash(key) & work->triangle_mask;
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
    out->triangles = grow(work->scratch, out->triangles, out->triangle_count, sizeof *out->triangles, room);
    out->triangle_source = grow(work->scratch, out->triangle_source, out->triangle_count, sizeof *out->triangle_source, &other_room);
    if (out->triangles == NULL || out->triangle_source == NULL)
      return LOD_MEMORY;
  }
  uint32_t id = out->triangle_count++;
  memcpy(out->triangles[id], key, sizeof key);
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

static enum lod_status add_pair(struct work *work, uint32_t a, uint32_t b, uint32_t source, uint32_t *id) {
  uint32_t low = a < b ? a : b, high = a < b ? b : a, slot = pair_slot(work, low, high);
  *id = work->pair_slots[slot];
  if (*id != LOD_NONE)
    return LOD_OK;
  if (work->pair_count == work->pair_room) {
    work->pairs = grow(work->scratch, work->pairs, work->pair_count, sizeof *work->pairs, &work->pair_room);
    if (work->pairs == NULL)
      return LOD_MEMORY;
  }
  *id = work->pair_slots[slot] = work->pair_count++;
  work->pairs[*id] = (struct pair){{low, high}, source, LOD_NONE};
  if (2 * (uint64_t)work->pair_count > work->pair_mask)
    return resize_pair_slots(work, 2 * (work->pair_mask + 1));
  return LOD_OK;
}

/* likely: triangles of the level to make room for. */
static enum lod_status map_triangles(struct work *work, uint32_t likely) {
  const struct cluster_unit *unit = work->unit;
  const uint32_t *image = work->cells->image;
  work->out->triangles = lod_arena_alloc(work->scratch, likely, sizeof *work->out->triangles);
  work->out->triangle_source = LOD_NEW(work->scratch, likely, uint32_t);
  if (work->out->triangles == NULL || work->out->triangle_source == NULL)
    return LOD_MEMORY;
  uint32_t room = likely, last[2] = {LOD_NONE, LOD_NONE}, last_id = LOD_NONE;
  for (uint32_t t = 0; t < unit->mesh->triangle_count; t++) {
    const uint32_t *v = unit->triangles[t];
    uint32_t i[3] = {image[v[0]], image[v[1]], image[v[2]]};
    if (i[0] == i[1] && i[1] == i[2]) {
      work->out->nearby[t] = COLLAPSED_TO_CELL | i[0];
      if (work->cell_source[i[0]] == LOD_NONE)
        work->cell_source[i[0]] = t;
    } else if (i[0] != i[1] && i[1] != i[2] && i[2] != i[0]) {
      LOD_TRY(add_triangle(work, i, t, &room));
    } else {
      uint32_t a = i[0], b = i[1] != a ? i[1] : i[2];
      if (!((a == last[0] && b == last[1]) || (a == last[1] && b == last[0]))) {
        LOD_TRY(add_pair(work, a, b, t, &last_id));
        last[0] = a;
        last[1] = b;
      }
      work->out->nearby[t] = COLLAPSED_TO_PAIR | last_id;
    }
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

static enum lod_status list_fans(struct work *work) {
  const struct cluster_synthesis *out = work->out;
  uint32_t cells = work->cells->count;
  work->fan_begin = LOD_NEW_ZERO(work->scratch, (size_t)cells + 1, uint32_t);
  work->fan = LOD_NEW(work->scratch, 3 * (size_t)out->triangle_count, uint32_t);
  if (work->fan_begin == NULL || work->fan == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < out->triangle_count; i++)
    for (int k = 0; k < 3; k++)
      work->fan_begin[out->triangles[i][k]]++;
  uint32_t sum = 0;
  for (uint32_t c = 0; c <= cells; c++) {
    sum += work->fan_begin[c];
    work->fan_begin[c] = sum;
  }
  for (uint32_t i = out->triangle_count; i-- > 0;)
    for (int k = 0; k < 3; k++)
      work->fan[--work->fan_begin[out->triangles[i][k]]] = i;
  return LOD_OK;
}

/* A surviving triangle with both cells, or LOD_NONE. Walks the shorter fan: all pairs together take O(n sqrt n) at worst. */
static uint32_t triangle_with(const struct work *work, uint32_t a, uint32_t b) {
  if (work->fan_begin[a + 1] - work->fan_begin[a] > work->fan_begin[b + 1] - work->fan_begin[b]) {
    uint32_t other = a;
    a = b;
    b = other;
  }
  for (uint32_t i = work->fan_begin[a]; i < work->fan_begin[a + 1]; i++) {
    const uint32_t *t = work->out->triangles[work->fan[i]];
    if (t[0] == b || t[1] == b || t[2] == b)
      return work->fan[i];
  }
  return LOD_NONE;
}

/* Pairs that no triangle covers become edges; cells that nothing uses become points. cell_primitive: any primitive of each cell. */
static enum lod_status keep_uncovered(struct work *work, uint32_t *cell_primitive, struct lod_arena *arena) {
  struct cluster_synthesis *out = work->out;
  uint32_t cells = work->cells->count;
  for (uint32_t p = 0; p < work->pair_count; p++) {
    struct pair *pair = &work->pairs[p];
    pair->primitive = triangle_with(work, pair->cell[0], pair->cell[1]);
    out->edge_count += pair->primitive == LOD_NONE;
  }
  out->edges = lod_arena_alloc(arena, out->edge_count, sizeof *out->edges);
  out->edge_source = LOD_NEW(arena, out->edge_count, uint32_t);
  if (out->edges == NULL || out->edge_source == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < cells; c++)
    cell_primitive[c] = work->fan_begin[c] != work->fan_begin[c + 1] ? work->fan[work->fan_begin[c]] : LOD_NONE;
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

static enum lod_status copy_triangles(struct cluster_synthesis *out, struct lod_arena *arena) {
  uint32_t(*triangles)[3] = lod_arena_alloc(arena, out->triangle_count, sizeof *triangles);
  uint32_t *source = LOD_NEW(arena, out->triangle_count, uint32_t);
  if (triangles == NULL || source == NULL)
    return LOD_MEMORY;
  if (out->triangle_count != 0) {
    memcpy(triangles, out->triangles, out->triangle_count * sizeof *triangles);
    memcpy(source, out->triangle_source, out->triangle_count * sizeof *source);
  }
  out->triangles = triangles;
  out->triangle_source = source;
  return LOD_OK;
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
  uint64_t likely = 2 * (uint64_t)cells < source_count ? 2 * (uint64_t)cells : source_count;
  LOD_TRY(resize_triangle_slots(work, cluster_power_of_two(2 * likely)));
  LOD_TRY(resize_pair_slots(work, cluster_power_of_two(likely)));
  LOD_TRY(map_triangles(work, (uint32_t)likely + 16));
  LOD_TRY(map_free_primitives(work));
  LOD_TRY(remove_folds(work));
  LOD_TRY(list_fans(work));
  LOD_TRY(keep_uncovered(work, cell_primitive, arena));
  for (uint32_t t = 0; t < source_count; t++) {
    uint32_t id = out->nearby[t] & COLLAPSED_ID;
    if (out->nearby[t] >= COLLAPSED_TO_CELL)
      out->nearby[t] = cell_primitive[id];
    else if (out->nearby[t] >= COLLAPSED_TO_PAIR)
      out->nearby[t] = work->pairs[id].primitive;
  }
  return copy_triangles(out, arena);
}

enum lod_status cluster_synthesize(const struct cluster_unit *unit, const struct cluster_cells *cells, struct lod_arena *arena,
                                   struct cluster_synthesis *synthesis) {
  *synthesis = (struct cluster_synthesis){0};
  struct work work = {.unit = unit, .cells = cells, .out = synthesis, .scratch = lod_arena_create_child(arena)};
  enum lod_status status = work.scratch != NULL ? synthesize(&work, arena) : LOD_MEMORY;
  lod_arena_destroy(work.scratch);
  return status;
}
