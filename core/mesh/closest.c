/* Queries of bvh.h: nearest child first, boxes in float (rounded so that nothing is missed), triangles in double. */
#include <float.h>

#include "core/mesh/bvh.h"
#include "core/mesh/bvh_tree.h"

enum { STACK = 3 * LOD_BVH_LEVELS + 4 };

/* A query point between two floats, so that float distances to boxes never exceed the true ones by more than kSlack tells. */
struct box_probe {
  float below[3], above[3];
};

struct pending {
  float distance_squared;
  uint32_t level, index;
};

/* Six roundings make a float distance at most (1 + 2^-24)^6 of the true one. */
static const float kSlack = 1 - 0x1p-20f;

static float round_down(double x) {
  float f = (float)x;
  if ((double)f <= x)
    return f;
  return f > FLT_MAX ? FLT_MAX : f - fabsf(f) * 0x1p-23f - 0x1p-149f;
}

static float round_up(double x) {
  return -round_down(-x);
}

/* A squared distance as a limit for box_distances, which overflow to infinity a little early. */
static float make_limit(double squared) {
  return squared < 1e38 ? round_up(squared) : INFINITY;
}

static struct box_probe make_box_probe(struct lod_vec3 q) {
  return (struct box_probe){{round_down(q.x), round_down(q.y), round_down(q.z)}, {round_up(q.x), round_up(q.y), round_up(q.z)}};
}

/* Lower bounds of the squared distances to four boxes. */
static inline void box_distances(const struct lod_bvh_node *node, const struct box_probe *probe, float out[LOD_BVH_WIDTH]) {
  float sum[LOD_BVH_WIDTH] = {0};
  for (int k = 0; k < 3; k++) {
    for (int i = 0; i < LOD_BVH_WIDTH; i++) {
      float below = node->min[k][i] - probe->above[k], above = probe->below[k] - node->max[k][i];
      float gap = below > above ? below : above;
      gap = gap > 0 ? gap : 0;
      sum[i] += gap * gap;
    }
  }
  for (int i = 0; i < LOD_BVH_WIDTH; i++)
    out[i] = sum[i] * kSlack;
}

/* Lanes by ascending distance; exchanges of a fixed network, so that ties keep one order everywhere. */
static inline void sort_lanes(const float d[LOD_BVH_WIDTH], uint32_t lanes[LOD_BVH_WIDTH]) {
  for (uint32_t i = 0; i < LOD_BVH_WIDTH; i++)
    lanes[i] = i;
  static const uint8_t kNetwork[5][2] = {{0, 1}, {2, 3}, {0, 2}, {1, 3}, {1, 2}};
  for (int s = 0; s < 5; s++) {
    uint32_t a = lanes[kNetwork[s][0]], b = lanes[kNetwork[s][1]];
    bool exchange = d[b] < d[a];
    lanes[kNetwork[s][0]] = exchange ? b : a;
    lanes[kNetwork[s][1]] = exchange ? a : b;
  }
}

uint32_t lod_bvh_search(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared, double accept_squared,
                        double *distance_squared) {
  uint32_t best = LOD_NONE;
  double best_squared = radius_squared;
  if (hint < bvh->count) {
    struct lod_triangle_probe t = lod_bvh_probe(bvh, hint);
    double d2 = lod_triangle_distance_squared(&t, q);
    if (d2 <= best_squared) {
      best_squared = d2;
      best = hint;
    }
  }
  struct box_probe probe = make_box_probe(q);
  struct pending stack[STACK];
  int depth = 0;
  if (bvh->level_count > 0)
    stack[depth++] = (struct pending){0, bvh->level_count - 1, 0};
  float limit = make_limit(best_squared);
  while (depth > 0 && !(best != LOD_NONE && best_squared <= accept_squared)) {
    struct pending top = stack[--depth];
    if (top.distance_squared > limit)
      continue;
    float d[LOD_BVH_WIDTH];
    uint32_t lanes[LOD_BVH_WIDTH];
    box_distances(&bvh->levels[top.level][top.index], &probe, d);
    sort_lanes(d, lanes);
    if (top.level > 0) {
      uint32_t first = top.index * LOD_BVH_WIDTH, children = bvh->node_counts[top.level - 1];
      for (int i = LOD_BVH_WIDTH - 1; i >= 0; i--) {
        if (d[lanes[i]] <= limit && first + lanes[i] < children)
          stack[depth++] = (struct pending){d[lanes[i]], top.level - 1, first + lanes[i]};
      }
      continue;
    }
    for (int i = 0; i < LOD_BVH_WIDTH && d[lanes[i]] <= limit; i++) {
      uint64_t slot = ((uint64_t)top.index * LOD_BVH_WIDTH + lanes[i]) * LOD_BVH_LEAF;
      for (uint64_t end = slot + LOD_BVH_LEAF; slot < end && slot < bvh->count; slot++) {
        struct lod_triangle_probe t = lod_bvh_probe_slot(bvh, (uint32_t)slot);
        double d2 = lod_triangle_distance_squared(&t, q);
        if (d2 < best_squared || (best == LOD_NONE && d2 <= best_squared)) {
          best_squared = d2;
          best = bvh->order[slot];
        }
      }
      limit = make_limit(best_squared);
    }
  }
  *distance_squared = best_squared;
  return best;
}

struct lod_closest lod_bvh_closest(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared) {
  struct lod_closest closest = {.distance_squared = radius_squared, .point = q, .primitive = LOD_NONE};
  closest.primitive = lod_bvh_search(bvh, q, hint, radius_squared, -1, &closest.distance_squared);
  if (closest.primitive != LOD_NONE) {
    struct lod_triangle_probe t = lod_bvh_probe(bvh, closest.primitive);
    closest.point = lod_triangle_nearest(&t, q);
  }
  return closest;
}

uint32_t lod_bvh_any_within(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared) {
  double distance_squared;
  return lod_bvh_search(bvh, q, hint, radius_squared, radius_squared, &distance_squared);
}

static bool boxes_meet(const double min[3], const double max[3], const float other_min[3], const float other_max[3]) {
  for (int k = 0; k < 3; k++) {
    if ((double)other_min[k] > max[k] || (double)other_max[k] < min[k])
      return false;
  }
  return true;
}

static bool visit_leaf(const struct lod_bvh *bvh, uint64_t slot, const double min[3], const double max[3],
                       bool (*visit)(void *context, uint32_t primitive), void *context) {
  for (uint64_t end = slot + LOD_BVH_LEAF; slot < end && slot < bvh->count; slot++) {
    float low[3], high[3];
    for (int k = 0; k < 3; k++) {
      const float(*c)[3] = bvh->corners[slot];
      low[k] = fminf(fminf(c[0][k], c[1][k]), c[2][k]);
      high[k] = fmaxf(fmaxf(c[0][k], c[1][k]), c[2][k]);
    }
    if (boxes_meet(min, max, low, high) && !visit(context, bvh->order[slot]))
      return false;
  }
  return true;
}

void lod_bvh_overlap(const struct lod_bvh *bvh, const double min[3], const double max[3], bool (*visit)(void *context, uint32_t primitive),
                     void *context) {
  struct pending stack[STACK];
  int depth = 0;
  if (bvh->level_count > 0)
    stack[depth++] = (struct pending){0, bvh->level_count - 1, 0};
  while (depth > 0) {
    struct pending top = stack[--depth];
    const struct lod_bvh_node *node = &bvh->levels[top.level][top.index];
    for (uint32_t lane = 0; lane < LOD_BVH_WIDTH; lane++) {
      float low[3] = {node->min[0][lane], node->min[1][lane], node->min[2][lane]};
      float high[3] = {node->max[0][lane], node->max[1][lane], node->max[2][lane]};
      uint64_t child = (uint64_t)top.index * LOD_BVH_WIDTH + lane;
      if (!boxes_meet(min, max, low, high))
        continue;
      if (top.level > 0) {
        if (child < bvh->node_counts[top.level - 1])
          stack[depth++] = (struct pending){0, top.level - 1, (uint32_t)child};
      } else if (!visit_leaf(bvh, child * LOD_BVH_LEAF, min, max, visit, context)) {
        return;
      }
    }
  }
}
