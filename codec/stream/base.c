/* The base in an order of its own: whoever has the same vertices and triangles sees the same base. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/step.h"

static uint64_t mix(uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9u;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebu;
  return x ^ x >> 31;
}

static uint64_t hash_position(const float p[3]) {
  uint32_t bits[3];
  for (int i = 0; i < 3; i++) {
    float value = p[i] == 0 ? 0 : p[i]; /* -0 is 0 */
    memcpy(&bits[i], &value, sizeof bits[i]);
  }
  return mix(mix(((uint64_t)bits[0] << 32 | bits[1]) + 0x9e3779b97f4a7c15u) ^ bits[2]);
}

enum lod_status lod_delta_checksum(const struct lod_mesh *mesh, struct lod_arena *arena, uint32_t *checksum) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint64_t *hash = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->vertex_count, uint64_t), sum = 0;
  if (hash == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    sum += hash[v] = hash_position(mesh->positions[v]);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint64_t h[3];
    int least = 0;
    for (int i = 0; i < 3; i++) {
      h[i] = hash[mesh->triangles[t][i]];
      if (h[i] < h[least])
        least = i;
    }
    sum += mix(mix(mix(h[least] + 1) ^ h[(least + 1) % 3]) ^ h[(least + 2) % 3]);
  }
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    sum += mix(mix(hash[mesh->edges[e][0]] + hash[mesh->edges[e][1]] + 2));
  for (uint32_t p = 0; p < mesh->point_count; p++)
    sum += mix(hash[mesh->points[p]] + 3);
  lod_arena_destroy(scratch);
  sum = mix(sum);
  *checksum = (uint32_t)(sum ^ sum >> 32);
  return LOD_OK;
}

/* ---- order ---- */

struct entry {
  float position[3];
  uint32_t vertex;
};

static int compare(const void *a, const void *b) {
  const struct entry *x = a, *y = b;
  for (int i = 0; i < 3; i++)
    if (x->position[i] != y->position[i])
      return x->position[i] < y->position[i] ? -1 : 1;
  return 0;
}

static int compare_numbers(const void *a, const void *b) {
  uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

static void sort_numbers(uint32_t *list, uint32_t count) {
  if (count > 32) {
    qsort(list, count, sizeof *list, compare_numbers);
    return;
  }
  for (uint32_t i = 1; i < count; i++) {
    const uint32_t number = list[i];
    uint32_t k = i;
    for (; k > 0 && list[k - 1] > number; k--)
      list[k] = list[k - 1];
    list[k] = number;
  }
}

/* Neighbours along triangles and segments, each once, in rising order. */
enum lod_status lod_adjacency_of_soup(const struct lod_mesh *mesh, const uint32_t *rank, struct lod_arena *arena,
                                      struct lod_adjacency *adjacency) {
  const size_t entries = 6 * (size_t)mesh->triangle_count + 2 * (size_t)mesh->edge_count;
  if (entries >= LOD_NONE)
    return LOD_LIMIT;
  uint32_t *first = adjacency->first = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 2, uint32_t);
  uint32_t *list = adjacency->list = LOD_NEW(arena, entries, uint32_t);
  if (first == NULL || list == NULL)
    return LOD_MEMORY;
  for (int pass = 0; pass < 2; pass++) {
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
      for (int i = 0; i < 3; i++) {
        uint32_t a = rank[mesh->triangles[t][i]], b = rank[mesh->triangles[t][(i + 1) % 3]];
        if (pass == 0) {
          first[a + 2]++;
          first[b + 2]++;
        } else {
          list[first[a + 1]++] = b;
          list[first[b + 1]++] = a;
        }
      }
    for (uint32_t e = 0; e < mesh->edge_count; e++)
      for (int i = 0; i < 2; i++) {
        uint32_t a = rank[mesh->edges[e][i]], b = rank[mesh->edges[e][1 - i]];
        if (pass == 0)
          first[a + 2]++;
        else
          list[first[a + 1]++] = b;
      }
    for (uint32_t v = 0; v < mesh->vertex_count && pass == 0; v++)
      first[v + 2] += first[v + 1];
  }
  uint32_t kept = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    uint32_t begin = first[v], end = first[v + 1], last = LOD_NONE;
    sort_numbers(list + begin, end - begin);
    first[v] = kept;
    for (uint32_t i = begin; i < end; i++)
      if (list[i] != v && list[i] != last)
        list[kept++] = last = list[i];
  }
  first[mesh->vertex_count] = kept;
  return LOD_OK;
}

/* Sums of the triangles' cross products, in integers, so that their order does not matter. */
static enum lod_status find_normals(const struct lod_mesh *mesh, struct step_base *base, struct lod_arena *arena) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  int64_t(*sums)[3] = scratch == NULL ? NULL : lod_arena_calloc(scratch, mesh->vertex_count, sizeof *sums);
  base->normals = LOD_NEW(arena, mesh->vertex_count, lod_v4);
  if (sums == NULL || base->normals == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    int64_t a[3], b[3];
    uint32_t v[3];
    for (int i = 0; i < 3; i++)
      v[i] = base->rank[mesh->triangles[t][i]];
    for (int i = 0; i < 3; i++) {
      a[i] = (int64_t)base->cells[v[1]][i] - base->cells[v[0]][i];
      b[i] = (int64_t)base->cells[v[2]][i] - base->cells[v[0]][i];
    }
    for (int i = 0; i < 3; i++) { /* unsigned: a sum that a broken base makes too large wraps */
      uint64_t n = (uint64_t)(a[(i + 1) % 3] * b[(i + 2) % 3]) - (uint64_t)(a[(i + 2) % 3] * b[(i + 1) % 3]);
      for (int k = 0; k < 3; k++)
        sums[v[k]][i] = (int64_t)((uint64_t)sums[v[k]][i] + n);
    }
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    const lod_v4 n = {(float)sums[v][0], (float)sums[v][1], (float)sums[v][2], 0}, nn = n * n;
    const float length = nn[0] + nn[1] + nn[2];
    base->normals[v] = length > 0 && length < 3e38f ? n * (1 / sqrtf(length)) : (lod_v4){0, 0, 0, 0};
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

enum lod_status lod_step_base(const struct lod_mesh *mesh, const struct lod_delta_grid *grid, struct lod_arena *arena,
                              struct step_base *base) {
  *base = (struct step_base){.vertex_count = mesh->vertex_count};
  base->order = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  base->rank = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  base->positions = LOD_NEW(arena, mesh->vertex_count, lod_v4);
  base->cells = lod_arena_alloc(arena, mesh->vertex_count, sizeof *base->cells);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct entry *entries = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->vertex_count, struct entry);
  if (base->order == NULL || base->rank == NULL || base->positions == NULL || base->cells == NULL || entries == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    memcpy(entries[v].position, mesh->positions[v], sizeof entries[v].position);
    entries[v].vertex = v;
  }
  qsort(entries, mesh->vertex_count, sizeof *entries, compare);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    base->order[v] = entries[v].vertex;
    base->rank[entries[v].vertex] = v;
    lod_v4 x = {0, 0, 0, 0};
    for (int i = 0; i < 3; i++) {
      double steps = ((double)entries[v].position[i] - (double)grid->origin[i]) / (double)grid->step;
      steps = steps < -1e9 ? -1e9 : steps > 1e9 ? 1e9 : steps;
      x[i] = (float)steps;
      base->cells[v][i] = (int32_t)floor(steps + 0.5);
    }
    base->positions[v] = x;
  }
  lod_arena_destroy(scratch);
  LOD_TRY(find_normals(mesh, base, arena));
  return lod_adjacency_of_soup(mesh, base->rank, arena, &base->adjacency);
}
