/* The patches of a level, and parts of meshes. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/step.h"
#include "codec/stream/units.h"

/* A triangle by where it is: equal only for triangles of the same three vertices. */
struct key {
  int64_t middle[3]; /* three times, in steps of the grid */
  uint32_t ranks[3]; /* of its vertices among the level's, rising */
  uint32_t triangle;
};

static int compare_from(const struct key *a, const struct key *b, int axis) {
  for (int i = 0; i < 3; i++) {
    const int k = (axis + i) % 3;
    if (a->middle[k] != b->middle[k])
      return a->middle[k] < b->middle[k] ? -1 : 1;
  }
  for (int i = 0; i < 3; i++)
    if (a->ranks[i] != b->ranks[i])
      return a->ranks[i] < b->ranks[i] ? -1 : 1;
  return 0;
}

static int compare_x(const void *a, const void *b) {
  return compare_from(a, b, 0);
}

static int compare_y(const void *a, const void *b) {
  return compare_from(a, b, 1);
}

static int compare_z(const void *a, const void *b) {
  return compare_from(a, b, 2);
}

static void make_keys(const struct lod_mesh *mesh, const struct step_base *base, struct key *keys) {
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct key *key = &keys[t];
    *key = (struct key){.triangle = t};
    for (int i = 0; i < 3; i++) {
      uint32_t rank = base->rank[mesh->triangles[t][i]], k = (uint32_t)i;
      for (int axis = 0; axis < 3; axis++)
        key->middle[axis] += base->cells[rank][axis];
      for (; k > 0 && rank < key->ranks[k - 1]; k--)
        key->ranks[k] = key->ranks[k - 1];
      key->ranks[k] = rank;
    }
  }
}

/* Sorts the keys along their longest axis; where the second half begins, or `count` where all are one triangle. */
static uint32_t halve(struct key *keys, uint32_t count) {
  static int (*const kCompare[3])(const void *, const void *) = {compare_x, compare_y, compare_z};
  int64_t low[3], high[3], longest = -1;
  int axis = 0;
  for (int i = 0; i < 3; i++) {
    low[i] = high[i] = keys[0].middle[i];
    for (uint32_t k = 1; k < count; k++) {
      low[i] = keys[k].middle[i] < low[i] ? keys[k].middle[i] : low[i];
      high[i] = keys[k].middle[i] > high[i] ? keys[k].middle[i] : high[i];
    }
    if (high[i] - low[i] > longest) {
      longest = high[i] - low[i];
      axis = i;
    }
  }
  qsort(keys, count, sizeof *keys, kCompare[axis]);
  for (uint32_t step = 0; step < count; step++) { /* the nearest to the middle at which two triangles differ */
    const uint32_t middle = count / 2, up = middle + step, down = middle - step;
    if (up > 0 && up < count && compare_from(&keys[up - 1], &keys[up], axis) != 0)
      return up;
    if (step < middle && compare_from(&keys[down - 1], &keys[down], axis) != 0)
      return down;
  }
  return count;
}

enum lod_status lod_units_partition(const struct lod_mesh *base, const struct lod_delta_grid *grid, uint32_t most_triangles,
                                    struct lod_arena *arena, uint32_t **patch, uint32_t *count) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct step_base order;
  struct key *keys = scratch == NULL ? NULL : LOD_NEW(scratch, base->triangle_count, struct key);
  uint32_t *patches = LOD_NEW(arena, base->triangle_count, uint32_t);
  uint32_t(*stack)[2] = scratch == NULL ? NULL : lod_arena_alloc(scratch, (size_t)base->triangle_count + 2, sizeof *stack), depth = 0;
  enum lod_status status = keys == NULL || patches == NULL || stack == NULL ? LOD_MEMORY : lod_step_base(base, grid, scratch, &order);
  *count = 0;
  *patch = patches;
  if (status == LOD_OK) {
    make_keys(base, &order, keys);
    if (base->triangle_count > 0)
      memcpy(stack[depth++], (uint32_t[2]){0, base->triangle_count}, sizeof *stack);
  }
  while (depth > 0) {
    const uint32_t begin = stack[--depth][0], size = stack[depth][1];
    const uint32_t half = size > most_triangles ? halve(keys + begin, size) : size;
    if (half < size) { /* the first half comes off the stack first */
      memcpy(stack[depth++], (uint32_t[2]){begin + half, size - half}, sizeof *stack);
      memcpy(stack[depth++], (uint32_t[2]){begin, half}, sizeof *stack);
      continue;
    }
    for (uint32_t k = begin; k < begin + size; k++)
      patches[keys[k].triangle] = *count;
    ++*count;
  }
  lod_arena_destroy(scratch);
  return status;
}

/* ---- parts of meshes ---- */

static int compare_numbers(const void *a, const void *b) {
  const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

/* What the listed rows of `index` name, each once, in rising order. */
static enum lod_status list_used(uint32_t (*index)[3], const uint32_t *rows, uint32_t count, struct lod_arena *arena, uint32_t **used,
                                 uint32_t *used_count) {
  uint32_t *list = *used = LOD_NEW(arena, 3 * (size_t)count, uint32_t);
  *used_count = 0;
  if (list == NULL)
    return LOD_MEMORY;
  for (uint32_t k = 0; k < count; k++)
    memcpy(list + 3 * (size_t)k, index[rows[k]], sizeof *index);
  if (count > 0)
    qsort(list, 3 * (size_t)count, sizeof *list, compare_numbers);
  for (size_t k = 0; k < 3 * (size_t)count; k++)
    if (*used_count == 0 || list[*used_count - 1] != list[k])
      list[(*used_count)++] = list[k];
  return LOD_OK;
}

static uint32_t place_of(const uint32_t *used, uint32_t count, uint32_t number) {
  uint32_t low = 0;
  while (count > 1) {
    const uint32_t half = count / 2;
    if (used[low + half] <= number)
      low += half;
    count -= half;
  }
  return low;
}

static void rename_rows(uint32_t (*rows)[3], uint32_t count, const uint32_t *used, uint32_t used_count) {
  for (uint32_t k = 0; k < count; k++)
    for (int i = 0; i < 3; i++)
      rows[k][i] = place_of(used, used_count, rows[k][i]);
}

/* Rows `old` of an array; *out stays NULL where there is none. */
static enum lod_status take_rows(const void *from, size_t size, const uint32_t *old, uint32_t count, struct lod_arena *arena, void *out) {
  char *rows = from == NULL ? NULL : lod_arena_alloc(arena, count, size);
  for (uint32_t k = 0; rows != NULL && k < count; k++)
    memcpy(rows + k * size, (const char *)from + old[k] * size, size);
  memcpy(out, &rows, sizeof rows);
  return from != NULL && rows == NULL ? LOD_MEMORY : LOD_OK;
}

static enum lod_status take_wedges(const struct lod_mesh *mesh, const uint32_t *triangles, uint32_t count, const uint32_t *vertices,
                                   struct lod_arena *arena, struct lod_mesh *part) {
  uint32_t *old;
  LOD_TRY(list_used(mesh->corners, triangles, count, arena, &old, &part->wedge_count));
  LOD_TRY(take_rows(mesh->corners, sizeof *mesh->corners, triangles, count, arena, &part->corners));
  rename_rows(part->corners, count, old, part->wedge_count);
  LOD_TRY(take_rows(mesh->wedge_vertex, sizeof *mesh->wedge_vertex, old, part->wedge_count, arena, &part->wedge_vertex));
  for (uint32_t w = 0; w < part->wedge_count; w++)
    part->wedge_vertex[w] = place_of(vertices, part->vertex_count, part->wedge_vertex[w]);
  LOD_TRY(take_rows(mesh->normals, sizeof *mesh->normals, old, part->wedge_count, arena, &part->normals));
  LOD_TRY(take_rows(mesh->colors, sizeof *mesh->colors, old, part->wedge_count, arena, &part->colors));
  for (int set = 0; set < LOD_UV_SETS; set++)
    LOD_TRY(take_rows(mesh->uvs[set], sizeof *mesh->uvs[set], old, part->wedge_count, arena, &part->uvs[set]));
  return LOD_OK;
}

enum lod_status lod_units_part(const struct lod_mesh *mesh, const uint32_t *triangles, uint32_t count, struct lod_arena *arena,
                               struct lod_mesh *part, uint32_t **vertices) {
  *part = (struct lod_mesh){.triangle_count = count};
  LOD_TRY(list_used(mesh->triangles, triangles, count, arena, vertices, &part->vertex_count));
  LOD_TRY(take_rows(mesh->positions, sizeof *mesh->positions, *vertices, part->vertex_count, arena, &part->positions));
  LOD_TRY(take_rows(mesh->triangles, sizeof *mesh->triangles, triangles, count, arena, &part->triangles));
  rename_rows(part->triangles, count, *vertices, part->vertex_count);
  LOD_TRY(take_rows(mesh->materials, sizeof *mesh->materials, triangles, count, arena, &part->materials));
  LOD_TRY(take_rows(mesh->parts, sizeof *mesh->parts, triangles, count, arena, &part->parts));
  return mesh->wedge_count == 0 ? LOD_OK : take_wedges(mesh, triangles, count, *vertices, arena, part);
}

enum lod_status lod_units_normals(const struct lod_mesh *mesh, struct lod_arena *arena, float (**normals)[3]) {
  *normals = lod_arena_calloc(arena, mesh->wedge_count, sizeof **normals);
  if (*normals == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    double p[3], q[3];
    const uint32_t *v = mesh->triangles[t];
    for (int i = 0; i < 3; i++) {
      p[i] = (double)mesh->positions[v[1]][i] - (double)mesh->positions[v[0]][i];
      q[i] = (double)mesh->positions[v[2]][i] - (double)mesh->positions[v[0]][i];
    }
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++)
        (*normals)[mesh->corners[t][k]][i] += (float)(p[(i + 1) % 3] * q[(i + 2) % 3] - p[(i + 2) % 3] * q[(i + 1) % 3]);
  }
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    float *n = (*normals)[w];
    const double square = (double)n[0] * (double)n[0] + (double)n[1] * (double)n[1] + (double)n[2] * (double)n[2];
    for (int i = 0; i < 3; i++)
      n[i] = square > 0 ? (float)((double)n[i] / sqrt(square)) : (float)(i == 2);
  }
  return LOD_OK;
}
