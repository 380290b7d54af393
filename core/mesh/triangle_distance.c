#include "core/mesh/triangle_distance.h"

#include "core/mesh/bvh.h"

/* An error-free sum and product: high + low is exact (Knuth 1969; Dekker 1971, with Veltkamp's splitting). */
struct pair {
  double high, low;
};

static struct pair exact_product(double x, double y) {
  double cx = 0x1.0000002p27 * x, cy = 0x1.0000002p27 * y;
  double xh = cx - (cx - x), yh = cy - (cy - y);
  double xl = x - xh, yl = y - yh;
  double high = x * y;
  return (struct pair){high, ((xh * yh - high) + xh * yl + xl * yh) + xl * yl};
}

double lod_difference_of_products(double x, double y, double z, double w) {
  struct pair p = exact_product(x, y), q = exact_product(z, w);
  double high = p.high - q.high;
  double back = high - p.high;
  double low = (p.high - (high - back)) + (-q.high - back);
  return high + (low + (p.low - q.low));
}

struct lod_vec3 lod_triangle_sliver_normal(struct lod_vec3 ab, struct lod_vec3 ac) {
  return lod_vec3_make(lod_difference_of_products(ab.y, ac.z, ab.z, ac.y), lod_difference_of_products(ab.z, ac.x, ab.x, ac.z),
                       lod_difference_of_products(ab.x, ac.y, ab.y, ac.x));
}

struct lod_vec3 lod_triangle_nearest(const struct lod_triangle_probe *t, struct lod_vec3 q) {
  struct lod_vec3 ap = lod_vec3_subtract(q, t->a);
  int out = t->normal_squared > 0 ? lod_triangle_outside(t, ap) : 7;
  if (out == 0) {
    double height = lod_vec3_dot(ap, t->normal) / t->normal_squared;
    return lod_vec3_add_scaled(q, t->normal, -height);
  }
  struct lod_vec3 candidates[3] = {
      lod_segment_nearest(ap, t->ab),
      lod_segment_nearest(ap, t->ac),
      lod_vec3_add(t->ab, lod_segment_nearest(lod_vec3_subtract(ap, t->ab), lod_vec3_subtract(t->ac, t->ab))),
  };
  struct lod_vec3 best = candidates[0];
  double best_squared = INFINITY;
  for (int i = 0; i < 3; i++) {
    double d2 = lod_vec3_distance_squared(ap, candidates[i]);
    if (out >> i & 1 && d2 < best_squared) {
      best_squared = d2;
      best = candidates[i];
    }
  }
  return lod_vec3_add(t->a, best);
}

struct lod_vec3 lod_closest_on_triangle(struct lod_vec3 q, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  struct lod_triangle_probe t = lod_triangle_prepare(a, b, c);
  return lod_triangle_nearest(&t, q);
}
