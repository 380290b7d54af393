/* Puts a unit into working form: used vertices along a Morton curve, in blocks, with power-of-two scaling; graded and sorted by weight. */
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

enum { DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS };

/* LSD radix sort by the upper 32 bits, of which the lower `bits` are looked at; stable. Returns where the result is: items or scratch. */
static uint64_t *radix_sort(uint64_t *items, uint64_t *scratch, uint32_t count, uint32_t bits) {
  uint64_t *from = items, *to = scratch;
  for (uint32_t shift = 32; shift < 32 + bits; shift += DIGIT_BITS) {
    uint32_t begin[DIGITS] = {0};
    for (uint32_t i = 0; i < count; i++)
      begin[from[i] >> shift & (DIGITS - 1)]++;
    uint32_t sum = 0;
    for (uint32_t d = 0; d < DIGITS; d++) {
      uint32_t size = begin[d];
      begin[d] = sum;
      sum += size;
    }
    for (uint32_t i = 0; i < count; i++)
      to[begin[from[i] >> shift & (DIGITS - 1)]++] = from[i];
    uint64_t *other = from;
    from = to;
    to = other;
  }
  return from;
}

/* How many corners, edge ends and points use each source vertex. */
static void count_uses(const struct lod_mesh *mesh, uint32_t *uses) {
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      uses[mesh->triangles[t][k]]++;
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    for (int k = 0; k < 2; k++)
      uses[mesh->edges[e][k]]++;
}

static void find_box(struct cluster_unit *unit, const uint32_t *used, double box[6]) {
  const struct lod_mesh *mesh = unit->mesh;
  float min[3], max[3], magnitude = 0;
  for (int axis = 0; axis < 3; axis++) {
    min[axis] = INFINITY;
    max[axis] = -INFINITY;
  }
  for (uint32_t i = 0; i < unit->count; i++)
    for (int axis = 0; axis < 3; axis++) {
      float p = mesh->positions[used[i]][axis];
      min[axis] = p < min[axis] ? p : min[axis];
      max[axis] = p > max[axis] ? p : max[axis];
    }
  for (int axis = 0; axis < 3; axis++) {
    if (unit->count == 0)
      min[axis] = max[axis] = 0;
    magnitude = fmaxf(magnitude, fmaxf(fabsf(min[axis]), fabsf(max[axis])));
  }
  int exponent = 0;
  frexp((double)magnitude, &exponent);
  unit->shrink = magnitude > 0 ? ldexp(1, -exponent) : 1;
  double squared = 0;
  for (int axis = 0; axis < 3; axis++) {
    unit->origin[axis] = box[axis] = (double)min[axis] * unit->shrink;
    box[3 + axis] = (double)max[axis] * unit->shrink;
    squared += (box[3 + axis] - box[axis]) * (box[3 + axis] - box[axis]);
  }
  unit->diagonal = sqrt(squared);
}

/* Spreads ten bits, two zeros between each. */
static uint32_t spread(uint32_t v) {
  v = (v | v << 16) & 0x030000ff;
  v = (v | v << 8) & 0x0300f00f;
  v = (v | v << 4) & 0x030c30c3;
  return (v | v << 2) & 0x09249249;
}

/* Working order: by key, then along the Morton curve of a grid of 1024^3 cubes, then by source index. source holds the used vertices. */
static void sort_along_curve(struct cluster_unit *unit, const double box[6], uint64_t *items, uint64_t *scratch) {
  double extent = 0;
  for (int axis = 0; axis < 3; axis++)
    extent = fmax(extent, box[3 + axis] - box[axis]);
  double to_grid = extent > 0 ? 1023.999 / extent * unit->shrink : 0, from[3];
  for (int axis = 0; axis < 3; axis++)
    from[axis] = box[axis] / unit->shrink;
  const float(*positions)[3] = (const float(*)[3])unit->mesh->positions;
  for (uint32_t i = 0; i < unit->count; i++) {
    uint32_t v = unit->source[i], code = 0;
    for (int axis = 0; axis < 3; axis++) {
      double g = ((double)positions[v][axis] - from[axis]) * to_grid;
      code |= spread(g > 0 ? g < 1023 ? (uint32_t)g : 1023 : 0) << axis;
    }
    items[i] = (uint64_t)code << 32 | v;
  }
  uint64_t *sorted = radix_sort(items, scratch, unit->count, 30);
  if (unit->key != NULL) {
    uint32_t bits = 0;
    while (unit->groups.set_count >> bits != 0)
      bits++;
    for (uint32_t i = 0; i < unit->count; i++)
      sorted[i] = (uint64_t)unit->groups.vertex_set[(uint32_t)sorted[i]] << 32 | (uint32_t)sorted[i];
    sorted = radix_sort(sorted, sorted == items ? scratch : items, unit->count, bits);
  }
  for (uint32_t i = 0; i < unit->count; i++)
    unit->source[i] = (uint32_t)sorted[i];
}

/* Coordinates, keys and boxes of blocks. The last block is padded with the last vertex. */
static void fill_blocks(struct cluster_unit *unit) {
  float shrink = (float)unit->shrink; /* may over- or underflow where the double does not */
  bool exact = isfinite(shrink) && shrink > 0;
  for (uint32_t b = 0; b < unit->block_count; b++) {
    float *box = unit->block_box[b];
    for (int axis = 0; axis < 3; axis++) {
      box[axis] = INFINITY;
      box[3 + axis] = -INFINITY;
    }
    uint32_t begin = b * CLUSTER_BLOCK, set = LOD_NONE;
    for (uint32_t i = begin; i < begin + CLUSTER_BLOCK; i++) {
      uint32_t place = i < unit->count ? i : unit->count - 1;
      const float *p = unit->mesh->positions[unit->source[place]];
      float q[3];
      for (int axis = 0; axis < 3; axis++) {
        q[axis] = exact ? p[axis] * shrink : (float)((double)p[axis] * unit->shrink);
        box[axis] = q[axis] < box[axis] ? q[axis] : box[axis];
        box[3 + axis] = q[axis] > box[3 + axis] ? q[axis] : box[3 + axis];
      }
      unit->x[i] = q[0];
      unit->y[i] = q[1];
      unit->z[i] = q[2];
      if (unit->key != NULL) {
        unit->key[i] = unit->groups.vertex_set[unit->source[place]];
        set = i == begin || set == unit->key[i] ? unit->key[i] : LOD_NONE;
        if (set == LOD_NONE)
          set = LOD_NONE - 1; /* mixed from here on */
      }
    }
    if (unit->key != NULL)
      unit->block_key[b] = set == LOD_NONE - 1 ? LOD_NONE : set;
  }
}

static enum lod_status allocate(struct cluster_unit *unit, bool quadric, struct lod_arena *arena) {
  size_t padded = ((size_t)unit->count + CLUSTER_BLOCK - 1) / CLUSTER_BLOCK * CLUSTER_BLOCK;
  unit->block_count = (uint32_t)(padded / CLUSTER_BLOCK);
  unit->x = LOD_NEW(arena, padded, float);
  unit->y = LOD_NEW(arena, padded, float);
  unit->z = LOD_NEW(arena, padded, float);
  unit->weight = LOD_NEW(arena, unit->count, float);
  unit->order = LOD_NEW(arena, unit->count, uint32_t);
  unit->rank = LOD_NEW_ZERO(arena, padded, uint32_t);
  unit->triangles = lod_arena_alloc(arena, unit->mesh->triangle_count, sizeof *unit->triangles);
  unit->block_box = lod_arena_alloc(arena, unit->block_count, sizeof *unit->block_box);
  if (unit->x == NULL || unit->y == NULL || unit->z == NULL || unit->weight == NULL || unit->order == NULL || unit->rank == NULL ||
      unit->triangles == NULL || unit->block_box == NULL)
    return LOD_MEMORY;
  if (quadric && (unit->quadric = lod_arena_alloc(arena, unit->count, sizeof *unit->quadric)) == NULL)
    return LOD_MEMORY;
  if (unit->groups.set_count > 1) {
    unit->key = LOD_NEW(arena, padded, uint32_t);
    unit->block_key = LOD_NEW(arena, unit->block_count, uint32_t);
    if (unit->key == NULL || unit->block_key == NULL)
      return LOD_MEMORY;
  }
  return LOD_OK;
}

static double triangle_area(const struct cluster_unit *unit, const uint32_t triangle[3]) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_make((double)unit->x[triangle[k]], (double)unit->y[triangle[k]], (double)unit->z[triangle[k]]);
  return 0.5 * lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
}

/* Renumbers the triangles and lists each working vertex's corners; the edges' ends are stored behind them for cluster_grade. begin holds
 * one entry more than there are working vertices; place: source vertex -> working. */
static void list_corners(struct cluster_unit *unit, const uint32_t *place, const uint32_t *uses, uint32_t *begin, uint32_t *corners) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t sum = 0;
  for (uint32_t v = 0; v < unit->count; v++) {
    begin[v] = sum;
    sum += uses[unit->source[v]];
  }
  unit->area = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t v = place[mesh->triangles[t][k]];
      unit->triangles[t][k] = v;
      corners[begin[v]++] = 3 * t + k;
    }
    unit->area += triangle_area(unit, unit->triangles[t]);
  }
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    for (uint32_t k = 0; k < 2; k++) {
      uint32_t v = place[mesh->edges[e][k]];
      corners[sum + 2 * e + k] = v;
      corners[begin[v]++] = 3 * mesh->triangle_count + 2 * e + k;
    }
  for (uint32_t v = unit->count; v > 0; v--)
    begin[v] = begin[v - 1];
  begin[0] = 0;
}

/* Heaviest first; equal weights in source order, so that neither the box nor the curve has a say. */
static void sort_by_weight(struct cluster_unit *unit, const uint32_t *place, uint64_t *items, uint64_t *scratch) {
  uint32_t count = 0;
  for (uint32_t s = 0; s < unit->mesh->vertex_count; s++)
    if (place[s] != LOD_NONE) {
      uint32_t bits;
      memcpy(&bits, &unit->weight[place[s]], sizeof bits);
      items[count++] = (uint64_t)~bits << 32 | place[s];
    }
  const uint64_t *sorted = radix_sort(items, scratch, count, 32);
  for (uint32_t i = 0; i < count; i++) {
    unit->order[i] = (uint32_t)sorted[i];
    unit->rank[unit->order[i]] = i;
  }
}

/* Room to sort in is given back after each sort, since corners and grades need theirs in between. place: NULL = along the curve. */
static enum lod_status sort(struct cluster_unit *unit, const double box[6], const uint32_t *place, struct lod_arena *parent) {
  struct lod_arena *arena = lod_arena_create_child(parent);
  if (arena == NULL)
    return LOD_MEMORY;
  uint64_t *items = LOD_NEW(arena, unit->count, uint64_t), *scratch = LOD_NEW(arena, unit->count, uint64_t);
  bool good = items != NULL && scratch != NULL;
  if (good && place == NULL)
    sort_along_curve(unit, box, items, scratch);
  else if (good)
    sort_by_weight(unit, place, items, scratch);
  lod_arena_destroy(arena);
  return good ? LOD_OK : LOD_MEMORY;
}

static enum lod_status grade(struct cluster_unit *unit, const struct lod_cluster_settings *settings, const uint32_t *place,
                             const uint32_t *uses, struct lod_arena *parent) {
  const struct lod_mesh *mesh = unit->mesh;
  struct lod_arena *scratch = lod_arena_create_child(parent);
  if (scratch == NULL)
    return LOD_MEMORY;
  uint32_t *begin = LOD_NEW(scratch, (size_t)unit->count + 1, uint32_t);
  uint32_t *corners = LOD_NEW(scratch, 3 * (size_t)mesh->triangle_count + 4 * (size_t)mesh->edge_count, uint32_t);
  if (begin != NULL && corners != NULL) {
    list_corners(unit, place, uses, begin, corners);
    cluster_grade(unit, settings, begin, corners);
  }
  lod_arena_destroy(scratch);
  return begin != NULL && corners != NULL ? LOD_OK : LOD_MEMORY;
}

static enum lod_status prepare(struct cluster_unit *unit, const struct lod_cluster_settings *settings, struct lod_arena *arena,
                               struct lod_arena *scratch) {
  const struct lod_mesh *mesh = unit->mesh;
  uint32_t *uses = LOD_NEW_ZERO(scratch, mesh->vertex_count, uint32_t);
  uint8_t *pointed = LOD_NEW_ZERO(scratch, mesh->point_count != 0 ? mesh->vertex_count : 0, uint8_t);
  uint32_t *place = LOD_NEW(scratch, mesh->vertex_count, uint32_t);
  unit->source = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  if (uses == NULL || pointed == NULL || place == NULL || unit->source == NULL)
    return LOD_MEMORY;
  count_uses(mesh, uses);
  for (uint32_t i = 0; i < mesh->point_count; i++)
    pointed[mesh->points[i]] = 1;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (uses[v] != 0 || (mesh->point_count != 0 && pointed[v]))
      unit->source[unit->count++] = v;
  double box[6];
  find_box(unit, unit->source, box);
  LOD_TRY(cluster_find_groups(unit, arena));
  LOD_TRY(allocate(unit, settings->representative == LOD_CLUSTER_QUADRIC, arena));
  if (unit->count == 0)
    return LOD_OK;
  LOD_TRY(sort(unit, box, NULL, scratch));
  memset(place, 0xff, mesh->vertex_count * sizeof *place);
  for (uint32_t i = 0; i < unit->count; i++)
    place[unit->source[i]] = i;
  fill_blocks(unit);
  LOD_TRY(grade(unit, settings, place, uses, scratch));
  return sort(unit, box, place, scratch);
}

enum lod_status cluster_prepare(struct cluster_unit *unit, const struct lod_unit *source, const struct lod_cluster_settings *settings,
                                struct lod_arena *arena) {
  *unit = (struct cluster_unit){.mesh = &source->mesh};
  /* A unit squeezed to nothing, or a scale that is no number, must not make cells of no size. */
  unit->scale = isfinite(source->scale) && source->scale > 0x1p-60 ? source->scale : 0x1p-60;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch != NULL ? prepare(unit, settings, arena, scratch) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  return status;
}
