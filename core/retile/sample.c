/* Drawing points, and keeping those that lie far from one another.
 *
 * Based on: Yuksel. Sample Elimination for Generating Poisson Disk Sample Sets. 2015: every point has a weight that sums up how near its
 * neighbours are; the heaviest goes first. Distances are divided by the mean of the wanted spacings. Fixed points weigh on the others and
 * stay. Neighbours are looked up again when a point goes, which takes as long as remembering them and no memory. */
#include <math.h>

#include "core/retile/internal.h"

enum lod_status sample_draw(const struct sheet *sheet, uint32_t count, bool stratified, uint64_t seed, struct lod_arena *arena,
                            struct cloud_point *points) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  double *sums = scratch == NULL ? NULL : LOD_NEW(scratch, sheet->face_count, double);
  if (sums == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double sum = 0;
  for (uint32_t f = 0; f < sheet->face_count; f++) {
    double s = 0;
    for (int k = 0; k < 3 && sheet->faces[f][0] != LOD_NONE; k++)
      s += sheet->spacing[sheet->faces[f][k]] / 3;
    sums[f] = sum += s > 0 ? sheet->areas[f] / (s * s) : 0; /* the stored area of Turk 1992, 5.2 */
  }
  uint32_t face = 0;
  for (uint32_t i = 0; i < count; i++) {
    double at = sum * (stratified ? (i + retile_random_unit(&seed)) / count : retile_random_unit(&seed));
    if (stratified) {
      while (face + 1 < sheet->face_count && sums[face] <= at)
        face++;
    } else {
      uint32_t low = 0, high = sheet->face_count - 1;
      while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (sums[middle] <= at)
          low = middle + 1;
        else
          high = middle;
      }
      face = low;
    }
    double u = sqrt(retile_random_unit(&seed)), v = retile_random_unit(&seed);
    struct lod_retile_point p = {face, {0, 0, 0}};
    p.weights[1] = 1 + (uint32_t)(u * (1 - v) * (LOD_RETILE_ONE - 4));
    p.weights[2] = 1 + (uint32_t)(u * v * (LOD_RETILE_ONE - 4));
    p.weights[0] = LOD_RETILE_ONE - p.weights[1] - p.weights[2];
    cloud_place(sheet, &p, &points[i]);
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

struct elimination {
  const struct cloud_point *points;
  struct cloud_grid grid;
  double distance, least, bend; /* bend: as cloud_distance_squared */
  double widest;                /* of the points' spacings */
  double *weight;
  uint32_t *heap, *slot, heap_count; /* slot: place in the heap, LOD_NONE when fixed or gone */
  uint32_t fixed;
};

static double pair_weight(const struct elimination *e, uint32_t i, uint32_t j) {
  const struct cloud_point *a = &e->points[i], *b = &e->points[j];
  double d2 = cloud_distance_squared(a, b, e->bend), reach = e->distance * 0.5 * (a->spacing + b->spacing);
  if (d2 >= reach * reach || !cloud_neighbours(a, b, lod_vec3_distance_squared(a->position, b->position)))
    return 0;
  double x = 1 - fmax(sqrt(d2) / reach, e->least);
  x *= x;
  x *= x;
  return x * x;
}

static void sift(struct elimination *e, uint32_t at) {
  uint32_t i = e->heap[at];
  for (uint32_t child; (child = 2 * at + 1) < e->heap_count; at = child) {
    if (child + 1 < e->heap_count && e->weight[e->heap[child + 1]] > e->weight[e->heap[child]])
      child++;
    if (!(e->weight[e->heap[child]] > e->weight[i]))
      break;
    e->heap[at] = e->heap[child];
    e->slot[e->heap[at]] = at;
  }
  e->heap[at] = i;
  e->slot[i] = at;
}

/* With lower set: what i weighs on its neighbours is taken off them; else: returns what they weigh on i. */
static double visit_neighbours(struct elimination *e, uint32_t i, bool lower) {
  uint32_t buckets[27];
  double sum = 0;
  int count = cloud_grid_buckets(&e->grid, e->points[i].position, buckets);
  float from[3], far = cloud_far_from(&e->grid, e->points[i].position, e->distance * 0.5 * (e->points[i].spacing + e->widest), from);
  for (int b = 0; b < count; b++)
    for (uint32_t m = e->grid.begin[buckets[b]]; m < e->grid.begin[buckets[b] + 1]; m++) {
      uint32_t j = e->grid.members[m].point;
      if (j == i || cloud_is_far(&e->grid.members[m], from, far) || (lower && e->slot[j] == LOD_NONE))
        continue;
      double w = pair_weight(e, lower ? j : i, lower ? i : j);
      sum += w;
      if (lower && w > 0) {
        e->weight[j] -= w;
        sift(e, e->slot[j]);
      }
    }
  return sum;
}

enum lod_status sample_eliminate(const struct cloud_point *points, uint32_t fixed, uint32_t count, uint32_t keep, double distance,
                                 double bend, struct lod_arena *arena, bool *kept) {
  for (uint32_t i = 0; i < count; i++)
    kept[i] = true;
  if (count - fixed <= keep)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct elimination e = {.points = points, .distance = distance, .bend = bend, .fixed = fixed};
  e.least = keep == 0 ? 0 : 0.65 * (1 - pow((double)keep / (count - fixed), 1.5));
  for (uint32_t i = 0; i < count; i++)
    e.widest = fmax(e.widest, points[i].spacing);
  e.weight = LOD_NEW(scratch, count, double);
  e.heap = LOD_NEW(scratch, count, uint32_t);
  e.slot = LOD_NEW(scratch, count, uint32_t);
  enum lod_status status = e.weight == NULL || e.heap == NULL || e.slot == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK)
    status = cloud_grid_create(points, count, distance * e.widest, scratch, &e.grid);
  if (status == LOD_OK) {
    for (uint32_t i = 0; i < count; i++) {
      e.weight[i] = i < fixed ? 0 : visit_neighbours(&e, i, false);
      e.slot[i] = LOD_NONE;
    }
    for (uint32_t i = fixed; i < count; i++) {
      e.slot[i] = e.heap_count;
      e.heap[e.heap_count++] = i;
    }
    for (uint32_t i = e.heap_count / 2; i-- > 0;)
      sift(&e, i);
    while (e.heap_count > keep) {
      uint32_t top = e.heap[0];
      kept[top] = false;
      e.heap[0] = e.heap[--e.heap_count];
      e.slot[e.heap[0]] = 0;
      e.slot[top] = LOD_NONE;
      if (e.heap_count != 0)
        sift(&e, 0);
      visit_neighbours(&e, top, true);
    }
  }
  lod_arena_destroy(scratch);
  return status;
}
