/* Queries of bvh.h: nearest child first, boxes in float (rounded so that nothing is missed), triangles in double. */
#include <float.h>
#include <string.h>

#include "core/mesh/bvh.h"
#include "core/mesh/bvh_tree.h"

enum { STACK = 3 * LOD_BVH_LEVELS + 4 };

/* A query point between two floats, so that float distances to boxes never exceed the true ones by more than kSlack tells. */
struct box_probe {
  float below[3], above[3];
};

struct pending {
  uint32_t key; /* lower bound of its squared distance, see sort_lanes */
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

/* A lane a child; GCC's and clang's vector extension, so that no compiler has to find out. */
typedef float lanes4 __attribute__((vector_size(16)));

static inline lanes4 max4(lanes4 a, lanes4 b) {
  lanes4 larger;
  for (int i = 0; i < LOD_BVH_WIDTH; i++)
    larger[i] = a[i] > b[i] ? a[i] : b[i];
  return larger;
}

static inline lanes4 load4(const float x[LOD_BVH_WIDTH]) {
  lanes4 lanes;
  memcpy(&lanes, x, sizeof lanes);
  return lanes;
}

/* Lower bounds of the squared distances to four boxes. */
static inline void box_distances(const struct lod_bvh_node *node, const struct box_probe *probe, float out[LOD_BVH_WIDTH]) {
  lanes4 sum = {0}, zero = {0};
  for (int k = 0; k < 3; k++) {
    lanes4 gap = max4(max4(load4(node->min[k]) - probe->above[k], probe->below[k] - load4(node->max[k])), zero);
    sum += gap * gap;
  }
  sum *= kSlack;
  memcpy(out, &sum, sizeof sum);
}

static inline uint32_t float_bits(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

/* Lanes by ascending distance. A key is a distance with its lane in the last two bits: for positive floats the order of the bits is the
 * order of the numbers, a truncated lower bound is still one, and keys are all different. */
static inline void sort_lanes(const float d[LOD_BVH_WIDTH], uint32_t keys[LOD_BVH_WIDTH]) {
  static const uint8_t kNetwork[5][2] = {{0, 1}, {2, 3}, {0, 2}, {1, 3}, {1, 2}};
  for (uint32_t i = 0; i < LOD_BVH_WIDTH; i++)
    keys[i] = (float_bits(d[i]) & ~3u) | i;
  for (int s = 0; s < 5; s++) {
    uint32_t a = keys[kNetwork[s][0]], b = keys[kNetwork[s][1]];
    keys[kNetwork[s][0]] = a < b ? a : b;
    keys[kNetwork[s][1]] = a < b ? b : a;
  }
}

struct best {
  double squared;
  uint32_t primitive;
};

static inline void try_primitive(const struct lod_bvh *bvh, uint32_t primitive, struct lod_vec3 q, struct best *best) {
  struct lod_triangle_probe t = lod_bvh_probe(bvh, primitive);
  double d2 = lod_triangle_distance_squared(&t, q);
  if (d2 < best->squared || (best->primitive == LOD_NONE && d2 <= best->squared)) {
    best->squared = d2;
    best->primitive = primitive;
  }
}

uint32_t lod_bvh_search(const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double radius_squared, double accept_squared,
                        double *distance_squared) {
  struct best best = {radius_squared, LOD_NONE};
  if (hint < bvh->count)
    try_primitive(bvh, hint, q, &best);
  struct box_probe probe = make_box_probe(q);
  struct pending stack[STACK];
  int depth = 0;
  if (bvh->level_count > 0)
    stack[depth++] = (struct pending){0, bvh->level_count - 1, 0};
  uint32_t limit = float_bits(make_limit(best.squared)) | 3;
  while (depth > 0 && !(best.primitive != LOD_NONE && best.squared <= accept_squared)) {
    struct pending top = stack[--depth];
    if (top.key > limit)
      continue;
    float d[LOD_BVH_WIDTH];
    uint32_t keys[LOD_BVH_WIDTH];
    box_distances(&bvh->levels[top.level][top.index], &probe, d);
    sort_lanes(d, keys);
    uint32_t first = top.index * LOD_BVH_WIDTH;
    if (top.level > 0) {
      uint32_t children = bvh->node_counts[top.level - 1];
      for (int i = LOD_BVH_WIDTH - 1; i >= 0; i--) {
        uint32_t child = first + (keys[i] & 3);
        if (keys[i] <= limit && child < children)
          stack[depth++] = (struct pending){keys[i], top.level - 1, child};
      }
      continue;
    }
    for (int i = 0; i < LOD_BVH_WIDTH && keys[i] <= limit; i++) {
      uint32_t slot = first + (keys[i] & 3);
      if (slot < bvh->count) {
        try_primitive(bvh, bvh->order[slot], q, &best);
        limit = float_bits(make_limit(best.squared)) | 3;
      }
    }
  }
  *distance_squared = best.squared;
  return best.primitive;
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
      } else if (child < bvh->count && !visit(context, bvh->order[child])) {
        return;
      }
    }
  }
}
