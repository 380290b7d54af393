#include "core/mesh/distance_rms.h"

#include "core/base/parallel.h"
#include "core/mesh/bvh_tree.h"

/* One sample a stratum of equal area: the error of the mean shrinks faster than with independent samples. */
enum { SAMPLES = 1 << 17, GRAIN = 1 << 11 };

struct sampling {
  const struct lod_bvh *items, *target;
  double *ends; /* cumulative area by slot */
  double *sums; /* a chunk */
};

/* The R2 sequence of M. Roberts (2018): low discrepancy without tables. */
static double fraction(double x) {
  return x - floor(x);
}

static struct lod_vec3 sample_point(const struct lod_bvh *items, uint32_t slot, double u, double v) {
  if (u + v > 1) {
    u = 1 - u;
    v = 1 - v;
  }
  struct lod_triangle_probe t = lod_bvh_probe(items, items->order[slot]);
  return lod_vec3_add_scaled(lod_vec3_add_scaled(t.a, t.ab, u), t.ac, v);
}

static uint32_t find_slot(const struct sampling *s, double at) {
  uint32_t low = 0, high = s->items->count - 1;
  while (low < high) {
    uint32_t middle = low + (high - low) / 2;
    if (s->ends[middle] > at)
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

static void sample_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct sampling *s = context;
  double total = s->ends[s->items->count - 1], sum = 0;
  uint32_t hint = LOD_NONE;
  for (size_t i = begin; i < end; i++) {
    uint32_t slot = find_slot(s, total * ((double)i + 0.5) / SAMPLES);
    struct lod_vec3 p = sample_point(s->items, slot, fraction(0.7548776662466927 * (double)i), fraction(0.5698402909980532 * (double)i));
    double d2;
    hint = lod_bvh_search(s->target, p, hint, INFINITY, -1, &d2);
    sum += d2;
  }
  s->sums[chunk] = sum;
}

enum lod_status lod_distance_sample_rms(const struct lod_bvh *items, const struct lod_bvh *target, uint32_t threads,
                                        struct lod_arena *arena, double *rms) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  size_t chunks = lod_parallel_chunks(SAMPLES, GRAIN);
  struct sampling s = {items, target, LOD_NEW(scratch, items->count, double), LOD_NEW(scratch, chunks, double)};
  if (s.ends == NULL || s.sums == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double total = 0;
  for (uint32_t slot = 0; slot < items->count; slot++)
    s.ends[slot] = total += sqrt(lod_bvh_probe(items, items->order[slot]).normal_squared);
  for (uint32_t slot = 0; !(total > 0) && slot < items->count; slot++)
    s.ends[slot] = slot + 1.0;
  lod_parallel_for(threads, SAMPLES, GRAIN, sample_chunk, &s);
  double sum = 0;
  for (size_t i = 0; i < chunks; i++)
    sum += s.sums[i];
  *rms = sqrt(sum / SAMPLES);
  lod_arena_destroy(scratch);
  return LOD_OK;
}
