/* Grades vertices by visual importance: the probability of lying on a silhouette times the length of the longest incident edge.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 3.1. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "core/cluster/internal.h"

/* Of a vertex with more corners than this, the widest angle is sought among the edges that reach farthest in 26 fixed directions instead of
 * all pairs, so that a fan of a million triangles stays linear. */
enum { FEW = 24, DIRECTIONS = 26, LANES = 4 };

/* Four lanes, an extension that GCC and clang share. */
typedef float lanes __attribute__((vector_size(16)));
typedef int32_t mask_lanes __attribute__((vector_size(16)));

/* Unit vectors along the edges of a vertex, padded to whole lanes by repeating the last. */
struct neighbourhood {
  uint32_t count;
  float x[2 * FEW + LANES], y[2 * FEW + LANES], z[2 * FEW + LANES];
  double longest_squared;
};

struct grading {
  struct cluster_unit *unit;
  const struct lod_cluster_settings *settings;
  const uint32_t *begin, *corners;
};

static double angle_factor(double cosine, enum lod_cluster_grading grading) {
  cosine = cosine > 1 ? 1 : cosine < -1 ? -1 : cosine;
  if (grading == LOD_CLUSTER_COSINE)
    return sqrt(0.5 * (1 + cosine));
  /* The smallest angle that a float cosine tells from 0 keeps the blow-up finite. */
  return 1 / fmax(acos(cosine), 1e-4);
}

/* The two other ends of a corner: next and previous of its triangle; for the end of an edge both are the other end. */
static void other_ends(const struct cluster_unit *unit, uint32_t corner, uint32_t *next, uint32_t *previous, const uint32_t *edge_ends) {
  if (corner < 3 * unit->mesh->triangle_count) {
    const uint32_t *triangle = unit->triangles[corner / 3];
    uint32_t k = corner % 3;
    *next = triangle[k == 2 ? 0 : k + 1];
    *previous = triangle[k == 0 ? 2 : k - 1];
  } else {
    *next = *previous = edge_ends[(corner - 3 * unit->mesh->triangle_count) ^ 1];
  }
}

/* Unit vector to a neighbour; false for an edge of no length. */
static bool direction(const struct cluster_unit *unit, uint32_t from, uint32_t to, float out[3], double *length_squared) {
  double x = (double)unit->x[to] - (double)unit->x[from], y = (double)unit->y[to] - (double)unit->y[from],
         z = (double)unit->z[to] - (double)unit->z[from];
  *length_squared = x * x + y * y + z * z;
  if (*length_squared > 0x1p-100) { /* far from underflow in float */
    float inverse = 1 / sqrtf((float)*length_squared);
    out[0] = (float)x * inverse;
    out[1] = (float)y * inverse;
    out[2] = (float)z * inverse;
    return true;
  }
  if (!(*length_squared > 0))
    return false;
  double inverse = 1 / sqrt(*length_squared);
  out[0] = (float)(x * inverse);
  out[1] = (float)(y * inverse);
  out[2] = (float)(z * inverse);
  return true;
}

/* For telling multisets apart by their sums. */
static uint64_t mix(uint32_t v) {
  return (v + UINT64_C(0x9e3779b97f4a7c15)) * (v + UINT64_C(0xbf58476d1ce4e5b9));
}

static void add_direction(const struct cluster_unit *unit, uint32_t v, uint32_t to, struct neighbourhood *hood) {
  float u[3];
  double squared;
  if (!direction(unit, v, to, u, &squared))
    return;
  hood->longest_squared = fmax(hood->longest_squared, squared);
  hood->x[hood->count] = u[0];
  hood->y[hood->count] = u[1];
  hood->z[hood->count++] = u[2];
}

static void add_few(const struct cluster_unit *unit, uint32_t v, const uint32_t *corners, uint32_t count, struct neighbourhood *hood,
                    const uint32_t *edge_ends) {
  uint32_t next[FEW], previous[FEW];
  uint64_t next_sum = 0, previous_sum = 0;
  for (uint32_t i = 0; i < count; i++) {
    other_ends(unit, corners[i], &next[i], &previous[i], edge_ends);
    next_sum += mix(next[i]);
    previous_sum += mix(previous[i]);
  }
  for (uint32_t i = 0; i < count; i++)
    add_direction(unit, v, next[i], hood);
  if (next_sum == previous_sum) /* a closed fan: every edge leaves as often as it arrives */
    return;
  for (uint32_t i = 0; i < count; i++) {
    uint32_t j = 0;
    while (j < count && next[j] != previous[i])
      j++;
    if (j == count)
      add_direction(unit, v, previous[i], hood);
  }
}

/* Keeps the edge that reaches farthest in each direction of the 3 x 3 x 3 cube but its middle. */
static void add_many(const struct cluster_unit *unit, uint32_t v, const uint32_t *corners, uint32_t count, struct neighbourhood *hood,
                     const uint32_t *edge_ends) {
  float reach[DIRECTIONS];
  for (int d = 0; d < DIRECTIONS; d++)
    reach[d] = -FLT_MAX;
  for (uint32_t i = 0; i < count; i++) {
    uint32_t ends[2];
    other_ends(unit, corners[i], &ends[0], &ends[1], edge_ends);
    for (int k = 0; k < 2; k++) {
      float u[3];
      double squared;
      if (!direction(unit, v, ends[k], u, &squared))
        continue;
      hood->longest_squared = fmax(hood->longest_squared, squared);
      for (int d = 0; d < DIRECTIONS; d++) {
        int cell = d < 13 ? d : d + 1;
        float r = u[0] * (float)(cell % 3 - 1) + u[1] * (float)(cell / 3 % 3 - 1) + u[2] * (float)(cell / 9 - 1);
        if (r > reach[d]) {
          reach[d] = r;
          hood->x[d] = u[0];
          hood->y[d] = u[1];
          hood->z[d] = u[2];
        }
      }
    }
  }
  hood->count = reach[0] > -FLT_MAX ? DIRECTIONS : 0;
}

/* The least cosine between any two of the directions; 1 when there are fewer than two. */
static float least_cosine(struct neighbourhood *hood) {
  lanes least = {1, 1, 1, 1};
  if (hood->count == 0)
    return 1;
  for (uint32_t i = hood->count; i % LANES != 0; i++) {
    hood->x[i] = hood->x[hood->count - 1];
    hood->y[i] = hood->y[hood->count - 1];
    hood->z[i] = hood->z[hood->count - 1];
  }
  for (uint32_t j = 0; j < hood->count; j += LANES) {
    lanes x, y, z;
    memcpy(&x, hood->x + j, sizeof x);
    memcpy(&y, hood->y + j, sizeof y);
    memcpy(&z, hood->z + j, sizeof z);
    uint32_t last = j + LANES < hood->count ? j + LANES : hood->count;
    for (uint32_t i = 0; i < last; i++) {
      lanes cosine = x * hood->x[i] + y * hood->y[i] + z * hood->z[i];
      mask_lanes less = cosine < least;
      least = (lanes)((less & (mask_lanes)cosine) | (~less & (mask_lanes)least));
    }
  }
  float result = least[0];
  for (int i = 1; i < LANES; i++)
    result = least[i] < result ? least[i] : result;
  return result;
}

/* Sum of area n n' over the triangles of a vertex, for its quadric: in float, since it only steers where representatives stand. */
static void sum_planes(const struct cluster_unit *unit, uint32_t v, const uint32_t *corners, uint32_t count, float out[6]) {
  float a[6] = {0}, px = unit->x[v], py = unit->y[v], pz = unit->z[v];
  for (uint32_t i = 0; i < count; i++) {
    if (corners[i] >= 3 * unit->mesh->triangle_count)
      continue;
    uint32_t ends[2];
    other_ends(unit, corners[i], &ends[0], &ends[1], NULL);
    float ax = unit->x[ends[0]] - px, ay = unit->y[ends[0]] - py, az = unit->z[ends[0]] - pz;
    float bx = unit->x[ends[1]] - px, by = unit->y[ends[1]] - py, bz = unit->z[ends[1]] - pz;
    float x = ay * bz - az * by, y = az * bx - ax * bz, z = ax * by - ay * bx;
    float inverse = 1 / sqrtf(x * x + y * y + z * z + FLT_MIN); /* no area: all products are 0 */
    a[0] += x * x * inverse;
    a[1] += x * y * inverse;
    a[2] += x * z * inverse;
    a[3] += y * y * inverse;
    a[4] += y * z * inverse;
    a[5] += z * z * inverse;
  }
  memcpy(out, a, sizeof a);
}

static void grade_range(void *context, size_t begin, size_t end, size_t chunk) {
  (void)chunk;
  const struct grading *grading = context;
  struct cluster_unit *unit = grading->unit;
  const uint32_t *edge_ends = grading->corners + grading->begin[unit->count]; /* stored behind the corners */
  for (size_t v = begin; v < end; v++) {
    const uint32_t *corners = grading->corners + grading->begin[v];
    uint32_t count = grading->begin[v + 1] - grading->begin[v];
    struct neighbourhood hood;
    hood.count = 0;
    hood.longest_squared = 0;
    if (count <= FEW)
      add_few(unit, (uint32_t)v, corners, count, &hood, edge_ends);
    else
      add_many(unit, (uint32_t)v, corners, count, &hood, edge_ends);
    if (unit->quadric != NULL)
      sum_planes(unit, (uint32_t)v, corners, count, unit->quadric[v]);
    double factor = angle_factor((double)least_cosine(&hood), grading->settings->grading);
    double length = sqrt(hood.longest_squared);
    unit->weight[v] = (float)(grading->settings->combination == LOD_CLUSTER_PRODUCT ? factor * length : factor);
    /* For the sum the length is put aside in rank, which is not filled yet, until the longest of all is known. */
    if (grading->settings->combination == LOD_CLUSTER_SUM) {
      union {
        float f;
        uint32_t u;
      } bits = {.f = (float)length};
      unit->rank[v] = bits.u;
    }
  }
}

static void combine_sum(struct cluster_unit *unit, double share) {
  float longest = 0;
  for (int pass = 0; pass < 2; pass++)
    for (uint32_t v = 0; v < unit->count; v++) {
      union {
        uint32_t u;
        float f;
      } length = {.u = unit->rank[v]};
      if (pass == 0)
        longest = length.f > longest ? length.f : longest;
      else
        unit->weight[v] = (float)(share * (double)unit->weight[v] + (longest > 0 ? (1 - share) * (double)length.f / (double)longest : 0));
    }
}

void cluster_grade(struct cluster_unit *unit, const struct lod_cluster_settings *settings, const uint32_t *begin, const uint32_t *corners) {
  struct grading grading = {unit, settings, begin, corners};
  lod_parallel_for(settings->threads, unit->count, CLUSTER_GRAIN / 4, grade_range, &grading);
  if (settings->combination == LOD_CLUSTER_SUM)
    combine_sum(unit, settings->angle_share);
}
