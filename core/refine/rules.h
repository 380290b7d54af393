/* Loop's rules as functions of points on a grid. Inside core/refine.
 *
 * All points are multiples of `step` below 2^41 steps, so sums of up to 4096 of them are exact and in any order the same. */
#ifndef LOD_CORE_REFINE_RULES_H
#define LOD_CORE_REFINE_RULES_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/vec.h"

enum refine_rule { REFINE_SMOOTH, REFINE_CREASE, REFINE_CORNER };
enum { REFINE_MAX_VALENCE = 2048 };

struct refine_grid {
  double magic; /* x + magic - magic rounds x to the grid */
};

/* magnitude: largest absolute coordinate, finite. */
struct refine_grid refine_grid_for(double magnitude);

static inline double refine_snap1(struct refine_grid grid, double x) {
  return (x + grid.magic) - grid.magic;
}
static inline struct lod_vec3 refine_snap(struct refine_grid grid, struct lod_vec3 p) {
  return (struct lod_vec3){refine_snap1(grid, p.x), refine_snap1(grid, p.y), refine_snap1(grid, p.z)};
}

/* cos and sin of i / n of a full turn, from +, -, * and / alone: the same bits everywhere. n >= 1, i < n. */
double refine_cos_turn(uint32_t i, uint32_t n);
double refine_sin_turn(uint32_t i, uint32_t n);

/* keep + n * give = 1 */
struct refine_weights {
  double keep, give;
};
/* Of a vertex of n neighbours after one step, and in the limit. n >= 3. */
struct refine_weights refine_vertex_weights(uint32_t n);
struct refine_weights refine_limit_weights(uint32_t n);

static inline struct lod_vec3 refine_middle_smooth(struct refine_grid grid, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c,
                                                   struct lod_vec3 d) {
  struct lod_vec3 ends = lod_vec3_scale(lod_vec3_add(a, b), 0.375);
  return refine_snap(grid, lod_vec3_add_scaled(ends, lod_vec3_add(c, d), 0.125));
}
static inline struct lod_vec3 refine_middle_sharp(struct refine_grid grid, struct lod_vec3 a, struct lod_vec3 b) {
  return refine_snap(grid, lod_vec3_scale(lod_vec3_add(a, b), 0.5));
}
static inline struct lod_vec3 refine_move_smooth(struct refine_grid grid, struct refine_weights w, struct lod_vec3 p, struct lod_vec3 sum) {
  return refine_snap(grid, lod_vec3_add_scaled(lod_vec3_scale(p, w.keep), sum, w.give));
}
static inline struct lod_vec3 refine_move_crease(struct refine_grid grid, struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b) {
  return refine_snap(grid, lod_vec3_add_scaled(lod_vec3_scale(p, 0.75), lod_vec3_add(a, b), 0.125));
}
static inline struct lod_vec3 refine_limit_smooth(struct refine_weights w, struct lod_vec3 p, struct lod_vec3 sum) {
  return lod_vec3_add_scaled(lod_vec3_scale(p, w.keep), sum, w.give);
}
static inline struct lod_vec3 refine_limit_crease(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b) {
  return lod_vec3_scale(lod_vec3_add(lod_vec3_scale(p, 4), lod_vec3_add(a, b)), 1.0 / 6);
}

/* Unit normals as floats; a zero cross product gives 0 0 0. */
static inline void refine_store_normal(struct lod_vec3 n, float out[3]) {
  lod_vec3_to_float(lod_vec3_normalize(n), out);
}

/* Normal from a full ring, counter-clockwise; regular: n = 6 by exact sums. */
struct lod_vec3 refine_ring_normal(const struct lod_vec3 *ring, uint32_t n);
/* Normal of a sector between two sharp edges ring[0] and ring[n - 1], counter-clockwise, n >= 2, around p. */
struct lod_vec3 refine_sector_normal(struct lod_vec3 p, const struct lod_vec3 *ring, uint32_t n);
/* Sum of triangle normals of a fan around p. */
struct lod_vec3 refine_fan_normal(struct lod_vec3 p, const struct lod_vec3 *ring, uint32_t n, bool closed);

#endif
