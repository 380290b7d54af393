/* Groups (a material on a connected UV chart) and the sets of groups that decide which vertices may share a cell. */
#include <math.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/cluster/internal.h"

/* Heap sort: in place, no recursion, no bad case. */
static void sort_values(uint64_t *values, size_t count) {
  for (size_t heap = count / 2, end = count; end > 1;) {
    uint64_t value;
    if (heap > 0) {
      value = values[--heap];
    } else {
      value = values[--end];
      values[end] = values[0];
    }
    size_t hole = heap;
    for (size_t child; (child = 2 * hole + 1) < end; hole = child) {
      if (child + 1 < end && values[child + 1] > values[child])
        child++;
      if (values[child] <= value)
        break;
      values[hole] = values[child];
    }
    values[hole] = value;
  }
}

static enum lod_status list_wedges(struct cluster_unit *unit, struct lod_arena *arena) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t *begin = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 1, uint32_t), *list = LOD_NEW(arena, mesh->wedge_count, uint32_t);
  if (begin == NULL || list == NULL)
    return LOD_MEMORY;
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    begin[mesh->wedge_vertex[w] + 1]++;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    begin[v + 1] += begin[v];
  for (uint32_t w = mesh->wedge_count; w-- > 0;)
    list[--begin[mesh->wedge_vertex[w] + 1]] = w;
  /* begin[v + 1] is now where v starts. */
  memmove(begin, begin + 1, mesh->vertex_count * sizeof *begin);
  begin[mesh->vertex_count] = mesh->wedge_count;
  unit->wedges.begin = begin;
  unit->wedges.list = list;
  return LOD_OK;
}

static uint64_t uv_hash(const struct lod_mesh *mesh, uint32_t wedge) {
  uint64_t hash = 0;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (mesh->uvs[set] != NULL) {
      uint64_t bits;
      memcpy(&bits, mesh->uvs[set][wedge], sizeof bits);
      hash = cluster_hash(hash + bits);
    }
  return hash;
}

/* Charts: wedges joined by a triangle, or at one vertex with the same UV (they differ in normal or colour alone). A collision of the
 * 32-bit hash would only join two charts that meet at that vertex. */
static enum lod_status find_charts(struct cluster_unit *unit, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t *chart = lod_sets_create(arena, mesh->wedge_count), most = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    uint32_t count = unit->wedges.begin[v + 1] - unit->wedges.begin[v];
    most = count > most ? count : most;
  }
  uint64_t *sorted = LOD_NEW(scratch, most, uint64_t);
  if (chart == NULL || sorted == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    lod_sets_join(chart, mesh->corners[t][0], mesh->corners[t][1]);
    lod_sets_join(chart, mesh->corners[t][0], mesh->corners[t][2]);
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    const uint32_t *list = unit->wedges.list + unit->wedges.begin[v];
    uint32_t count = unit->wedges.begin[v + 1] - unit->wedges.begin[v];
    if (count < 2)
      continue;
    for (uint32_t i = 0; i < count; i++)
      sorted[i] = (uv_hash(mesh, list[i]) & 0xffffffff00000000u) | list[i];
    sort_values(sorted, count);
    for (uint32_t i = 1; i < count; i++)
      if (sorted[i] >> 32 == sorted[i - 1] >> 32)
        lod_sets_join(chart, (uint32_t)sorted[i], (uint32_t)sorted[i - 1]);
  }
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    chart[w] = lod_sets_find(chart, w);
  unit->wedges.chart = chart;
  return LOD_OK;
}

/* Numbers pairs, or the lists of `store`, densely in order of first appearance. */
struct intern {
  uint32_t mask, count;
  uint32_t *slots; /* id or LOD_NONE */
  uint64_t *pairs;
};

static enum lod_status intern_create(struct intern *intern, uint64_t most, struct lod_arena *scratch) {
  uint32_t size = cluster_power_of_two(most + most / 2);
  *intern = (struct intern){.mask = size - 1, .slots = LOD_NEW(scratch, size, uint32_t)};
  if (intern->slots == NULL)
    return LOD_MEMORY;
  memset(intern->slots, 0xff, size * sizeof *intern->slots);
  return LOD_OK;
}

static uint32_t intern_pair(struct intern *intern, uint64_t pair) {
  for (uint32_t slot = (uint32_t)cluster_hash(pair) & intern->mask;; slot = (slot + 1) & intern->mask) {
    uint32_t id = intern->slots[slot];
    if (id == LOD_NONE) {
      intern->slots[slot] = intern->count;
      intern->pairs[intern->count] = pair;
      return intern->count++;
    }
    if (intern->pairs[id] == pair)
      return id;
  }
}

struct set_store {
  uint32_t *begin, *groups;
};

/* The id of the set that is written behind the last one in the store; it stays there when it is new. */
static uint32_t intern_set(struct intern *intern, struct set_store *store, uint32_t count) {
  const uint32_t *set = store->groups + store->begin[intern->count];
  uint64_t hash = count;
  for (uint32_t i = 0; i < count; i++)
    hash = cluster_hash(hash + set[i] + 1);
  for (uint32_t slot = (uint32_t)hash & intern->mask;; slot = (slot + 1) & intern->mask) {
    uint32_t id = intern->slots[slot];
    if (id == LOD_NONE) {
      intern->slots[slot] = intern->count;
      store->begin[intern->count + 1] = store->begin[intern->count] + count;
      return intern->count++;
    }
    if (store->begin[id + 1] - store->begin[id] == count && memcmp(store->groups + store->begin[id], set, count * sizeof *set) == 0)
      return id;
  }
}

/* triangle -> group */
static enum lod_status group_triangles(struct cluster_unit *unit, uint32_t *group, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  struct intern intern;
  LOD_TRY(intern_create(&intern, mesh->triangle_count, scratch));
  intern.pairs = LOD_NEW(scratch, mesh->triangle_count, uint64_t);
  if (intern.pairs == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint64_t material = mesh->materials != NULL ? mesh->materials[t] : 0;
    uint64_t chart = unit->wedges.chart != NULL ? unit->wedges.chart[mesh->corners[t][0]] : 0;
    group[t] = intern_pair(&intern, material << 32 | chart);
  }
  unit->groups.group_count = intern.count;
  return LOD_OK;
}

static enum lod_status measure_groups(struct cluster_unit *unit, const uint32_t *group, struct lod_arena *arena,
                                      struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t count = unit->groups.group_count;
  float(*box)[6] = lod_arena_alloc(scratch, count, sizeof *box);
  unit->groups.extent = LOD_NEW(arena, count, double);
  if (box == NULL || unit->groups.extent == NULL)
    return LOD_MEMORY;
  for (uint32_t g = 0; g < count; g++)
    for (int i = 0; i < 6; i++)
      box[g][i] = i < 3 ? INFINITY : -INFINITY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      for (int axis = 0; axis < 3; axis++) {
        float p = mesh->positions[mesh->triangles[t][k]][axis], *b = box[group[t]];
        b[axis] = p < b[axis] ? p : b[axis];
        b[3 + axis] = p > b[3 + axis] ? p : b[3 + axis];
      }
  for (uint32_t g = 0; g < count; g++) {
    double squared = 0;
    for (int axis = 0; axis < 3; axis++) {
      double width = ((double)box[g][3 + axis] - (double)box[g][axis]) * unit->shrink;
      squared += width * width;
    }
    unit->groups.extent[g] = sqrt(squared);
  }
  return LOD_OK;
}

/* Vertices used by edges and points alone get the empty set. */
static enum lod_status collect_sets(struct cluster_unit *unit, const uint32_t *group, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t *begin = LOD_NEW_ZERO(scratch, (size_t)mesh->vertex_count + 1, uint32_t);
  uint64_t *incident = LOD_NEW(scratch, 3 * (size_t)mesh->triangle_count, uint64_t);
  struct set_store store = {LOD_NEW(arena, (size_t)mesh->vertex_count + 1, uint32_t),
                            LOD_NEW(arena, 3 * (size_t)mesh->triangle_count, uint32_t)};
  unit->groups.vertex_set = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  struct intern intern;
  LOD_TRY(intern_create(&intern, mesh->vertex_count, scratch));
  if (begin == NULL || incident == NULL || store.begin == NULL || store.groups == NULL || unit->groups.vertex_set == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      begin[mesh->triangles[t][k]]++;
  for (uint32_t v = 0, sum = 0; v <= mesh->vertex_count; v++) {
    sum += begin[v];
    begin[v] = sum;
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      incident[--begin[mesh->triangles[t][k]]] = group[t];
  store.begin[0] = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    uint64_t *list = incident + begin[v];
    uint32_t count = begin[v + 1] - begin[v], unique = 0;
    sort_values(list, count);
    for (uint32_t i = 0; i < count; i++)
      if (i == 0 || list[i] != list[i - 1])
        store.groups[store.begin[intern.count] + unique++] = (uint32_t)list[i];
    unit->groups.vertex_set[v] = intern_set(&intern, &store, unique);
  }
  unit->groups.set_count = intern.count;
  unit->groups.set_begin = store.begin;
  unit->groups.set_groups = store.groups;
  return LOD_OK;
}

static bool one_material(const struct lod_mesh *mesh) {
  if (mesh->materials == NULL)
    return true;
  for (uint32_t t = 1; t < mesh->triangle_count; t++)
    if (mesh->materials[t] != mesh->materials[0])
      return false;
  return true;
}

static enum lod_status find_groups(struct cluster_unit *unit, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  unit->groups.set_count = 1;
  if (mesh->wedge_count != 0)
    LOD_TRY(list_wedges(unit, arena));
  bool mapped = mesh->wedge_count != 0 && (mesh->uvs[0] != NULL || mesh->uvs[1] != NULL);
  if (mapped)
    LOD_TRY(find_charts(unit, arena, scratch));
  if (!mapped && one_material(mesh))
    return LOD_OK;
  uint32_t *group = LOD_NEW(scratch, mesh->triangle_count, uint32_t);
  if (group == NULL)
    return LOD_MEMORY;
  LOD_TRY(group_triangles(unit, group, scratch));
  if (unit->groups.group_count < 2)
    return LOD_OK;
  LOD_TRY(measure_groups(unit, group, arena, scratch));
  return collect_sets(unit, group, arena, scratch);
}

enum lod_status cluster_find_groups(struct cluster_unit *unit, struct lod_arena *arena) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch != NULL ? find_groups(unit, arena, scratch) : LOD_MEMORY;
  if (status == LOD_OK && unit->mesh->wedge_count != 0 && unit->mesh->normals != NULL)
    status = cluster_find_flat_parts(unit, arena);
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status cluster_keys(const struct cluster_unit *unit, double cell, double separate, struct lod_arena *arena, uint32_t **keys) {
  const struct cluster_groups *groups = &unit->groups;
  *keys = NULL;
  if (unit->key == NULL)
    return LOD_OK;
  uint32_t *map = LOD_NEW(arena, groups->set_count, uint32_t);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (map == NULL || scratch == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  struct set_store store = {LOD_NEW(scratch, (size_t)groups->set_count + 1, uint32_t),
                            LOD_NEW(scratch, groups->set_begin[groups->set_count], uint32_t)};
  struct intern intern;
  enum lod_status status = intern_create(&intern, groups->set_count, scratch);
  if (status == LOD_OK && (store.begin == NULL || store.groups == NULL))
    status = LOD_MEMORY;
  if (status == LOD_OK) {
    store.begin[0] = 0;
    for (uint32_t s = 0; s < groups->set_count; s++) {
      uint32_t kept = 0;
      for (uint32_t i = groups->set_begin[s]; i < groups->set_begin[s + 1]; i++)
        if (groups->extent[groups->set_groups[i]] >= separate * cell)
          store.groups[store.begin[intern.count] + kept++] = groups->set_groups[i];
      map[s] = intern_set(&intern, &store, kept);
    }
    if (intern.count > 1)
      *keys = map;
  }
  lod_arena_destroy(scratch);
  return status;
}
