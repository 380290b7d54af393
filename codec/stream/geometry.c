/* Positions: where the kept vertices are exactly, a least-squares mesh through them, and each other vertex as its difference from that.
 *
 * Based on: Sorkine, Cohen-Or. Least-squares Meshes. SMI 2004. The mesh minimises the squared distances of all vertices from the means of
 * their neighbours. Once a vertex is decoded, it and its neighbours' best places are brought up to date, so each prediction is close to the
 * least-squares mesh through everything decoded before. Differences are coded on the grid axis by axis, the axis nearest to the surface's
 * normal last: given the other two it is nearly determined, as in a frame of normal and tangents but without rounding twice. */
#include <math.h>
#include <string.h>

#include "codec/stream/step.h"

enum { SWEEPS = 4, ITERATIONS = 12, DEGREE = 64, LENGTHS = 25, BUCKETS = 40, FRACTIONS = 4 };

/* Of a gradient, squared, in steps, the mean over vertices: the least-squares mesh is near enough. */
#define SETTLED 0.03

/* Everything that learns. */
struct step_residual_models {
  /* By length first: long differences are rare, so most of this is never touched. */
  struct lod_bit_model length[LENGTHS][3][3][BUCKETS][FRACTIONS], first[LENGTHS][3][BUCKETS], second[3][LENGTHS][2],
      sign[3][12][2 * FRACTIONS];
  struct lod_mixer mixer[3][LENGTHS];
  float normal, tangential; /* running means of the differences, in steps */
};

/* ---- kept vertices ---- */

/* Kept vertices lie within about half a step of the coarser grid, so how far from it depends on where between two steps of the finer one
 * that place is: in eighths of a step from the nearest, counted from its own side. */
struct kept_models {
  struct lod_number_model size[FRACTIONS];
  struct lod_bit_model side[FRACTIONS][4]; /* by the size, at most 3 */
};

static int32_t code_shift(struct lod_coder *c, struct kept_models *m, float from_nearest, int32_t shift) {
  const bool below = from_nearest < 0;
  const float f = below ? -from_nearest : from_nearest;
  const int part = f < 0.125f ? 0 : f < 0.25f ? 1 : f < 0.375f ? 2 : 3;
  const uint32_t size = lod_coder_number(c, &m->size[part], shift < 0 ? 0u - (uint32_t)shift : (uint32_t)shift);
  if (size == 0)
    return 0;
  const bool away = lod_coder_bit(c, &m->side[part][size < 3 ? size : 3], LOD_ADAPT, (shift < 0) != below);
  return (int32_t)(away != below ? 0u - size : size);
}

enum lod_status lod_step_kept(struct step *s) {
  struct kept_models *m = lod_arena_calloc(s->scratch, 1, sizeof *m);
  if (m == NULL)
    return LOD_MEMORY;
  const size_t before = s->coder.out_size;
  for (uint32_t b = 0; b < s->base.vertex_count; b++) {
    uint32_t v = s->kept[b];
    if (v == LOD_NONE)
      continue;
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "kept vertices");
    for (int i = 0; i < 3; i++) {
      const int32_t at = s->base.cells[b][i];
      const float fraction = s->base.positions[b][i] - (float)at;
      const uint32_t q = (uint32_t)at + (uint32_t)code_shift(&s->coder, m, fraction, (int32_t)((uint32_t)s->cells[v][i] - (uint32_t)at));
      if (q >= 1u << 24)
        return lod_step_bad(s, "kept vertices");
      s->cells[v][i] = (int32_t)q;
      s->estimates[v][i] = (float)q;
    }
  }
  s->statistics->kept += 8.0 * (double)(s->coder.out_size - before);
  return LOD_OK;
}

/* ---- the least-squares mesh ---- */

/* Neighbours in fours, so that loops over them run as often for nearly all vertices; those that fill up add 0, which changes no bit. */
static enum lod_status widen(struct step *s) {
  const struct lod_adjacency *n = &s->adjacency;
  const uint32_t vertices = s->header.vertices;
  uint32_t *first = s->wide.first = LOD_NEW(s->scratch, (size_t)vertices + 1, uint32_t);
  if (first == NULL)
    return LOD_MEMORY;
  uint64_t count = 0;
  for (uint32_t v = 0; v < vertices; v++) {
    first[v] = (uint32_t)count;
    count += s->rim[v] > 0 ? 0 : (n->first[v + 1] - n->first[v] + 3) & ~3u;
  }
  if (count >= LOD_NONE)
    return LOD_LIMIT;
  first[vertices] = (uint32_t)count;
  uint32_t *list = s->wide.list = LOD_NEW(s->scratch, count, uint32_t);
  if (list == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < vertices; v++) {
    uint32_t at = first[v];
    for (uint32_t i = n->first[v]; i < n->first[v + 1] && at < first[v + 1]; i++)
      list[at++] = n->list[i];
    while (at < first[v + 1])
      list[at++] = vertices;
  }
  return LOD_OK;
}

/* The mean of a vertex's neighbours, on a rim of those along it: rims are smooth curves. */
static inline lod_v4 mean(const struct step *s, const lod_v4 *x, uint32_t v) {
  lod_v4 sum = {0, 0, 0, 0};
  for (const uint32_t *n = s->wide.list + s->wide.first[v], *end = s->wide.list + s->wide.first[v + 1]; n < end; n += 4) {
    sum += x[n[0]];
    sum += x[n[1]];
    sum += x[n[2]];
    sum += x[n[3]];
  }
  if (s->rim[v] > 0)
    for (uint32_t i = s->adjacency.first[v], end = i + s->rim[v]; i < end; i++)
      sum += x[s->adjacency.list[i]];
  return sum * s->share[v];
}

/* How far each vertex is from the mean of its neighbours. */
static inline lod_v4 laplacian(const struct step *s, const lod_v4 *x, uint32_t v) {
  return s->share[v] > 0 ? x[v] - mean(s, x, v) : (lod_v4){0, 0, 0, 0};
}

/* Half the gradient of the sum of squares of `lap` with respect to vertex v. */
static inline lod_v4 gradient(const struct step *s, const lod_v4 *lap, uint32_t v) {
  lod_v4 sum = lap[v];
  for (const uint32_t *n = s->wide.list + s->wide.first[v], *end = s->wide.list + s->wide.first[v + 1]; n < end; n += 4) {
    sum -= lap[n[0]] * s->inner[n[0]];
    sum -= lap[n[1]] * s->inner[n[1]];
    sum -= lap[n[2]] * s->inner[n[2]];
    sum -= lap[n[3]] * s->inner[n[3]];
  }
  if (s->rim[v] == 0)
    return sum;
  const struct lod_adjacency *n = &s->adjacency;
  uint32_t i = n->first[v];
  for (const uint32_t end = i + s->rim[v]; i < end; i++)
    sum -= lap[n->list[i]] * s->share[n->list[i]];
  for (; i < n->first[v + 1]; i++)
    sum -= lap[n->list[i]] * s->inner[n->list[i]];
  return sum;
}

/* Vertices in order of their distance from kept ones, in edges; those that are connected to none are left out. */
static enum lod_status find_order(struct step *s) {
  const struct lod_adjacency *n = &s->adjacency;
  const uint32_t vertices = s->header.vertices;
  uint8_t *seen = LOD_NEW_ZERO(s->scratch, vertices, uint8_t);
  s->order = LOD_NEW(s->scratch, vertices, uint32_t);
  if (seen == NULL || s->order == NULL)
    return LOD_MEMORY;
  uint32_t count = 0;
  for (uint32_t v = 0; v < vertices; v++)
    if (s->estimated[v] == 2) {
      seen[v] = 1;
      s->order[count++] = v;
    }
  s->kept_count = count;
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t k = n->first[s->order[i]]; k < n->first[s->order[i] + 1]; k++)
      if (!seen[n->list[k]]) {
        seen[n->list[k]] = 1;
        s->order[count++] = n->list[k];
      }
  s->reached = count;
  return LOD_OK;
}

static void smooth(struct step *s, lod_v4 *x) {
  const struct lod_adjacency *n = &s->adjacency;
  for (uint32_t i = s->kept_count; i < s->reached; i++) { /* no estimate yet: from what is nearer */
    uint32_t v = s->order[i], known = 0;
    if (s->estimated[v] != 0)
      continue;
    lod_v4 sum = {0, 0, 0, 0};
    for (uint32_t k = n->first[v]; k < n->first[v + 1]; k++)
      if (s->estimated[n->list[k]]) {
        sum += x[n->list[k]];
        known++;
      }
    x[v] = sum / (float)(known > 0 ? known : 1);
    s->estimated[v] = 1;
  }
  for (int sweep = 0; sweep < SWEEPS; sweep++)
    for (uint32_t i = s->kept_count; i < s->reached; i++)
      x[s->order[i]] = mean(s, x, s->order[i]);
}

static void add_dot(lod_v4 a, lod_v4 b, double sums[3]) {
  lod_v4 c = a * b;
  for (int i = 0; i < 3; i++)
    sums[i] += (double)c[i];
}

/* Laplacians of `x`, and what each takes part with in the gradients of its neighbours. */
struct field {
  lod_v4 *lap, *part;
};

static void find_laplacians(const struct step *s, const lod_v4 *x, struct field f, double square[3]) {
  for (uint32_t v = 0; v < s->header.vertices; v++) {
    f.lap[v] = laplacian(s, x, v);
    f.part[v] = f.lap[v] * s->inner[v];
    add_dot(f.lap[v], f.lap[v], square);
  }
}

/* As gradient(), to the bit. */
static inline lod_v4 field_gradient(const struct step *s, struct field f, uint32_t v) {
  lod_v4 sum = f.lap[v];
  for (const uint32_t *n = s->wide.list + s->wide.first[v], *end = s->wide.list + s->wide.first[v + 1]; n < end; n += 4) {
    sum -= f.part[n[0]];
    sum -= f.part[n[1]];
    sum -= f.part[n[2]];
    sum -= f.part[n[3]];
  }
  if (s->rim[v] == 0)
    return sum;
  const struct lod_adjacency *n = &s->adjacency;
  uint32_t i = n->first[v];
  for (const uint32_t end = i + s->rim[v]; i < end; i++)
    sum -= f.lap[n->list[i]] * s->share[n->list[i]];
  for (; i < n->first[v + 1]; i++)
    sum -= f.part[n->list[i]];
  return sum;
}

/* One step of conjugate gradients; false when nothing is gained by another. */
static bool descend(struct step *s, lod_v4 *x, lod_v4 *residual, lod_v4 *direction, struct field f, double square[3]) {
  double curvature[3] = {0, 0, 0}, next[3] = {0, 0, 0};
  find_laplacians(s, direction, f, curvature);
  lod_v4 alpha = {0, 0, 0, 0}, beta = {0, 0, 0, 0};
  for (int i = 0; i < 3; i++)
    alpha[i] = curvature[i] > 0 ? (float)(square[i] / curvature[i]) : 0;
  for (uint32_t i = s->kept_count; i < s->reached; i++) {
    const uint32_t v = s->order[i];
    x[v] += alpha * direction[v];
    residual[v] -= alpha * field_gradient(s, f, v);
    add_dot(residual[v], residual[v], next);
  }
  for (int i = 0; i < 3; i++) {
    beta[i] = square[i] > 0 ? (float)(next[i] / square[i]) : 0;
    square[i] = next[i];
  }
  if (square[0] + square[1] + square[2] <= SETTLED * (s->reached - s->kept_count))
    return false;
  for (uint32_t i = s->kept_count; i < s->reached; i++)
    direction[s->order[i]] = residual[s->order[i]] + beta * direction[s->order[i]];
  return true;
}

/* Conjugate gradients for the vertices that are not kept, each coordinate by itself. */
static enum lod_status minimise(struct step *s, lod_v4 *x) {
  const uint32_t vertices = s->header.vertices;
  struct lod_arena *scratch = lod_arena_create_child(s->scratch);
  lod_v4 *residual = scratch == NULL ? NULL : LOD_NEW(scratch, vertices, lod_v4);
  lod_v4 *direction = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, (size_t)vertices + 1, lod_v4);
  struct field f = {scratch == NULL ? NULL : LOD_NEW(scratch, vertices, lod_v4),
                    scratch == NULL ? NULL : LOD_NEW(scratch, (size_t)vertices + 1, lod_v4)};
  if (residual == NULL || direction == NULL || f.lap == NULL || f.part == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double square[3] = {0, 0, 0}, ignored[3] = {0, 0, 0};
  find_laplacians(s, x, f, ignored);
  f.part[vertices] = (lod_v4){0, 0, 0, 0};
  for (uint32_t i = s->kept_count; i < s->reached; i++) {
    uint32_t v = s->order[i];
    direction[v] = residual[v] = -field_gradient(s, f, v);
    add_dot(residual[v], residual[v], square);
  }
  for (int iteration = 0; iteration < ITERATIONS && descend(s, x, residual, direction, f, square);)
    iteration++;
  lod_arena_destroy(scratch);
  return LOD_OK;
}

enum lod_status lod_step_predict(struct step *s) {
  const uint32_t vertices = s->header.vertices;
  s->share = LOD_NEW(s->scratch, vertices, float);
  s->inner = LOD_NEW_ZERO(s->scratch, (size_t)vertices + 1, float);
  s->stiffness = LOD_NEW(s->scratch, vertices, float);
  s->laplacian = LOD_NEW_ZERO(s->scratch, (size_t)vertices + 1, lod_v4);
  s->size = lod_arena_calloc(s->scratch, vertices, sizeof *s->size);
  if (s->share == NULL || s->inner == NULL || s->stiffness == NULL || s->laplacian == NULL || s->size == NULL)
    return LOD_MEMORY;
  LOD_TRY(widen(s));
  const struct lod_adjacency *n = &s->adjacency;
  for (uint32_t v = 0; v < vertices; v++) {
    uint32_t degree = s->rim[v] > 0 ? s->rim[v] : n->first[v + 1] - n->first[v];
    s->share[v] = degree > 0 ? 1 / (float)degree : 0;
    s->inner[v] = s->rim[v] > 0 ? 0 : s->share[v];
  }
  for (uint32_t v = 0; v < vertices; v++) {
    float sum = 1;
    for (uint32_t i = n->first[v]; i < n->first[v + 1]; i++) {
      const float weight = i < n->first[v] + s->rim[v] ? s->share[n->list[i]] : s->inner[n->list[i]];
      sum += weight * weight;
    }
    s->stiffness[v] = 1 / sum;
  }
  LOD_TRY(find_order(s));
  smooth(s, s->estimates);
  if (s->kept_count < s->reached)
    LOD_TRY(minimise(s, s->estimates));
  for (uint32_t v = 0; v < vertices; v++)
    s->laplacian[v] = laplacian(s, s->estimates, v);
  return LOD_OK;
}

/* ---- differences ---- */

static inline void move(struct step *s, uint32_t v, lod_v4 by) {
  s->estimates[v] += by;
  s->laplacian[v] += by;
  for (const uint32_t *n = s->wide.list + s->wide.first[v], *end = s->wide.list + s->wide.first[v + 1]; n < end; n += 4)
    for (int k = 0; k < 4; k++)
      s->laplacian[n[k]] -= by * s->inner[n[k]];
  if (s->rim[v] == 0)
    return;
  const struct lod_adjacency *n = &s->adjacency;
  uint32_t i = n->first[v];
  for (const uint32_t end = i + s->rim[v]; i < end; i++)
    s->laplacian[n->list[i]] -= by * s->share[n->list[i]];
  for (; i < n->first[v + 1]; i++)
    s->laplacian[n->list[i]] -= by * s->inner[n->list[i]];
}

/* Twice the normal of the surface as it seems to be around v, not of unit length. */
static lod_v4 normal_at(const struct step *s, uint32_t v) {
  const struct lod_adjacency *k = &s->corners;
  const lod_v4 *x = s->estimates;
  lod_v4 sum = {0, 0, 0, 0};
  for (uint32_t i = k->first[v]; i < k->first[v + 1] && i < k->first[v] + DEGREE; i++) {
    uint32_t h = k->list[i];
    const uint32_t *t = s->triangles[h / 3];
    lod_v4 a = x[t[(h + 1) % 3]] - x[v], b = x[t[(h + 2) % 3]] - x[v];
    sum += (lod_v4){a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0};
  }
  return sum;
}

/* Half-octaves of a positive size, and quarters of an octave. */
static uint32_t bucket_of(float size, int shift, uint32_t most) {
  uint32_t bits;
  size = size < 0.0625f ? 0.0625f : size;
  memcpy(&bits, &size, sizeof bits);
  uint32_t bucket = (bits - 0x3d800000u) >> shift;
  return bucket < most ? bucket : most;
}

/* An integer near the real number `at`, of about the given size of difference. */
static int32_t code_axis(struct lod_coder *c, struct step_residual_models *m, int kind, float at, float size, uint32_t known,
                         int32_t value) {
  const float rounded = floorf(at + 0.5f), fraction = at - rounded;
  const int32_t nearest = (int32_t)rounded;
  int32_t r = value - nearest;
  const uint32_t half = bucket_of(size, 22, BUCKETS - 1), quarter = bucket_of(size, 21, BUCKETS - 1);
  const float f = fraction < 0 ? -fraction : fraction;
  const uint32_t away = f < 0.125f ? 0 : f < 0.25f ? 1 : f < 0.375f ? 2 : 3, small = half < 11 ? half : 11;
  uint32_t magnitude = r < 0 ? 0u - (uint32_t)r : (uint32_t)r, length = 0, n = 0;
  while (magnitude >> length != 0)
    length++;
  while (n < LENGTHS - 1) {
    struct lod_bit_model *models[3] = {&m->length[n][0][kind][half][away], &m->length[n][1][kind][quarter][0],
                                       &m->length[n][2][kind][half][known]};
    if (!lod_coder_mix(c, models, 3, &m->mixer[kind][n], LOD_ADAPT, length > n))
      break;
    n++;
  }
  if (n == 0)
    return nearest;
  bool negative = lod_coder_bit(c, &m->sign[kind][small][away * 2 + (fraction < 0)], LOD_ADAPT, r < 0);
  uint32_t result = 1;
  if (n >= 2)
    result = 2 | (uint32_t)lod_coder_bit(c, &m->first[n][kind][half], LOD_ADAPT, magnitude >> (n - 2) & 1);
  if (n >= 3) {
    uint32_t bit = (uint32_t)lod_coder_bit(c, &m->second[kind][n][result & 1], LOD_ADAPT, magnitude >> (n - 3) & 1);
    result = result << 1 | bit;
  }
  if (n >= 4)
    result = result << (n - 3) | lod_coder_raw(c, magnitude, (int)n - 3);
  return nearest + (int32_t)(negative ? 0u - result : result);
}

/* Sizes of the differences to expect at v: of its neighbours that are decoded, and the running mean. */
static void expect(const struct step *s, const struct step_residual_models *m, uint32_t v, float *normal, float *tangential,
                   uint32_t *known) {
  const struct lod_adjacency *n = &s->adjacency;
  float sum_normal = m->normal, sum_tangential = m->tangential, weight = 1;
  uint32_t fixed = 0, end = n->first[v + 1] < n->first[v] + DEGREE ? n->first[v + 1] : n->first[v] + DEGREE;
  for (uint32_t i = n->first[v]; i < end; i++) {
    uint32_t u = n->list[i];
    fixed += s->estimated[u] == 2;
    if (s->estimated[u] != 2 || s->size[u][1] == 0)
      continue;
    sum_normal += s->size[u][0];
    sum_tangential += s->size[u][1];
    weight += 1;
  }
  *normal = sum_normal / weight;
  *tangential = sum_tangential / weight;
  *known = end == n->first[v] ? 0 : fixed * 4 / (end - n->first[v]);
  if (*known > 3)
    *known = 3;
}

/* Near the grid; also what is not a number. */
static float clamp(float at) {
  return at > -1e6f ? (at < 2e7f ? at : 2e7f) : -1e6f;
}

/* Codes the cells of v, whose position seems to be `at` on a surface with normal `n`. */
static bool code_vertex(struct step *s, struct step_residual_models *m, uint32_t v, lod_v4 at, lod_v4 n) {
  lod_v4 nn = n * n;
  float length = nn[0] + nn[1] + nn[2], sn, st;
  uint32_t known;
  n = length > 0 ? n * (1 / sqrtf(length)) : (lod_v4){0, 0, 1, 0};
  expect(s, m, v, &sn, &st, &known);
  nn = n * n;
  const int k = nn[0] > nn[1] ? (nn[0] > nn[2] ? 0 : 2) : (nn[1] > nn[2] ? 1 : 2), i = k == 0 ? 1 : 0, j = k == 2 ? 1 : 2;
  const float t2 = st * st + 0.01f, n2 = sn * sn + 0.01f, gap = t2 - n2; /* covariance: t2 I - gap n n^T */
  const float vi = t2 - gap * nn[i], vij = -gap * n[i] * n[j];
  const float slope = vij / vi, vj = t2 - gap * nn[j] - slope * vij;
  const float precision = n2 + gap * nn[k], vk = t2 * n2 / precision;
  for (int a = 0; a < 3; a++)
    at[a] = clamp(at[a]);
  lod_v4 e = {0, 0, 0, 0};
  int32_t *q = s->cells[v];
  q[i] = code_axis(&s->coder, m, 0, at[i], sqrtf(vi), known, q[i]);
  e[i] = (float)q[i] - at[i];
  q[j] = code_axis(&s->coder, m, 1, clamp(at[j] + slope * e[i]), sqrtf(vj > 0 ? vj : 0), known, q[j]);
  e[j] = (float)q[j] - at[j];
  const float shift = -gap * n[k] * (n[i] * e[i] + n[j] * e[j]) / precision;
  q[k] = code_axis(&s->coder, m, 2, clamp(at[k] + shift), sqrtf(vk), known, q[k]);
  e[k] = (float)q[k] - at[k];
  for (int a = 0; a < 3; a++)
    if (q[a] < 0 || q[a] >= 1 << 24)
      return false;
  lod_v4 dots = e * n, squares = e * e;
  float along = dots[0] + dots[1] + dots[2], rest = squares[0] + squares[1] + squares[2] - along * along;
  along = along < 0 ? -along : along;
  rest = sqrtf(rest > 0 ? rest * 0.5f : 0);
  s->size[v][0] = along;
  s->size[v][1] = rest + 1e-6f;
  m->normal += (along - m->normal) * (1 / 64.f);
  m->tangential += (rest - m->tangential) * (1 / 64.f);
  return true;
}

/* The best place of v while everything else stays where it seems to be. */
static void relax(struct step *s, uint32_t v) {
  move(s, v, gradient(s, s->laplacian, v) * -s->stiffness[v]);
}

static enum lod_status code_reached(struct step *s, struct step_residual_models *m) {
  const struct lod_adjacency *n = &s->adjacency;
  for (uint32_t i = s->kept_count; i < s->reached; i++) {
    uint32_t v = s->order[i];
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "positions");
    relax(s, v);
    if (!code_vertex(s, m, v, s->estimates[v], normal_at(s, v)))
      return lod_step_bad(s, "positions");
    lod_v4 exact = {(float)s->cells[v][0], (float)s->cells[v][1], (float)s->cells[v][2], 0};
    move(s, v, exact - s->estimates[v]);
    s->estimates[v] = exact;
    s->estimated[v] = 2;
    for (uint32_t k = n->first[v]; k < n->first[v + 1]; k++)
      if (s->estimated[n->list[k]] != 2)
        relax(s, n->list[k]);
  }
  return LOD_OK;
}

/* Vertices that no kept vertex is connected with: in the order of the stream, by parallelograms. */
static enum lod_status code_rest(struct step *s, struct step_residual_models *m) {
  lod_v4 last = {0, 0, 0, 0};
  for (uint32_t t = 0; t < s->header.triangles; t++)
    for (uint32_t i = 0; i < 3; i++) {
      uint32_t v = s->triangles[t][i], gate = s->connectivity.opposite[3 * (size_t)t];
      if (s->estimated[v] == 2)
        continue;
      if (lod_coder_overrun(&s->coder))
        return lod_step_bad(s, "positions");
      lod_v4 at = last, normal = {0, 0, 1, 0};
      if (i == 2 && gate != LOD_NONE && gate / 3 < t) {
        const uint32_t a = s->triangles[t][0], b = s->triangles[t][1], o = s->triangles[gate / 3][(gate + 2) % 3];
        const lod_v4 *x = s->estimates;
        lod_v4 p = x[a] - x[o], r = x[b] - x[o];
        at = x[a] + x[b] - x[o];
        normal = (lod_v4){p[1] * r[2] - p[2] * r[1], p[2] * r[0] - p[0] * r[2], p[0] * r[1] - p[1] * r[0], 0};
      }
      if (!code_vertex(s, m, v, at, normal))
        return lod_step_bad(s, "positions");
      s->estimates[v] = last = (lod_v4){(float)s->cells[v][0], (float)s->cells[v][1], (float)s->cells[v][2], 0};
      s->estimated[v] = 2;
    }
  for (uint32_t v = 0; v < s->header.vertices; v++) {
    if (s->estimated[v] == 2)
      continue;
    if (lod_coder_overrun(&s->coder) || !code_vertex(s, m, v, last, (lod_v4){0, 0, 1, 0}))
      return lod_step_bad(s, "positions");
    s->estimates[v] = last = (lod_v4){(float)s->cells[v][0], (float)s->cells[v][1], (float)s->cells[v][2], 0};
    s->estimated[v] = 2;
  }
  return LOD_OK;
}

enum lod_status lod_step_geometry(struct step *s) {
  struct step_residual_models *m = lod_coder_models(&s->coder, sizeof *m, s->scratch);
  if (m == NULL)
    return LOD_MEMORY;
  if (s->coder.primer == NULL)
    m->normal = m->tangential = 16;
  const size_t before = s->coder.out_size;
  LOD_TRY(code_reached(s, m));
  LOD_TRY(code_rest(s, m));
  s->statistics->geometry += 8.0 * (double)(s->coder.out_size - before);
  return LOD_OK;
}
