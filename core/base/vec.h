/* Small vector arithmetic in double. Positions are stored as float[3]; all geometry is computed in double. */
#ifndef LOD_CORE_BASE_VEC_H
#define LOD_CORE_BASE_VEC_H

#include <math.h>

struct lod_vec3 {
  double x, y, z;
};

static inline struct lod_vec3 lod_vec3_make(double x, double y, double z) {
  return (struct lod_vec3){x, y, z};
}
static inline struct lod_vec3 lod_vec3_from_float(const float p[3]) {
  return (struct lod_vec3){(double)p[0], (double)p[1], (double)p[2]};
}
static inline void lod_vec3_to_float(struct lod_vec3 v, float out[3]) {
  out[0] = (float)v.x;
  out[1] = (float)v.y;
  out[2] = (float)v.z;
}
static inline struct lod_vec3 lod_vec3_add(struct lod_vec3 a, struct lod_vec3 b) {
  return (struct lod_vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}
static inline struct lod_vec3 lod_vec3_subtract(struct lod_vec3 a, struct lod_vec3 b) {
  return (struct lod_vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}
static inline struct lod_vec3 lod_vec3_scale(struct lod_vec3 a, double s) {
  return (struct lod_vec3){a.x * s, a.y * s, a.z * s};
}
/* a + s * b */
static inline struct lod_vec3 lod_vec3_add_scaled(struct lod_vec3 a, struct lod_vec3 b, double s) {
  return (struct lod_vec3){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
static inline double lod_vec3_dot(struct lod_vec3 a, struct lod_vec3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline struct lod_vec3 lod_vec3_cross(struct lod_vec3 a, struct lod_vec3 b) {
  return (struct lod_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline double lod_vec3_length_squared(struct lod_vec3 a) {
  return lod_vec3_dot(a, a);
}
static inline double lod_vec3_length(struct lod_vec3 a) {
  return sqrt(lod_vec3_dot(a, a));
}
static inline double lod_vec3_distance_squared(struct lod_vec3 a, struct lod_vec3 b) {
  return lod_vec3_length_squared(lod_vec3_subtract(a, b));
}
static inline double lod_vec3_distance(struct lod_vec3 a, struct lod_vec3 b) {
  return sqrt(lod_vec3_distance_squared(a, b));
}
/* The zero vector stays zero. */
static inline struct lod_vec3 lod_vec3_normalize(struct lod_vec3 a) {
  double length = lod_vec3_length(a);
  return length > 0 ? lod_vec3_scale(a, 1 / length) : a;
}

#endif
