/* Wedges and what they carry. Which corners share a wedge follows the triangles; values are predicted from the triangle across the gate
 * and, for normals, from the decoded surface. Normals that a client computes just as well are not sent. */
#include <math.h>
#include <string.h>

#include "codec/stream/step.h"

enum { MOST_UV_BITS = 20, NORMALS_NONE = 0, NORMALS_SMOOTH, NORMALS_SENT, NORMALS_SOME };

struct models {
  struct lod_bit_model same[4][3], fresh, has, sign[8][2];
  struct lod_number_model other, uv[LOD_UV_SETS][2][2], normal[2], color[4], bits;
};

struct attributes {
  struct step *s;
  struct models *m;
  uint32_t count;   /* wedges so far */
  uint32_t *first;  /* vertex -> the last wedge made for it, or LOD_NONE */
  uint32_t *next;   /* wedge -> the one made before for its vertex */
  uint32_t *made;   /* wedge -> corner that made it */
  uint32_t *target; /* encoding: wedge of the request -> wedge */
  uint32_t *source; /* encoding: wedge -> wedge of the request */
  uint32_t uv_bits[LOD_UV_SETS], normals, color_bits, alpha;
  bool has_uv[LOD_UV_SETS];
  float (*surface)[3]; /* wedge -> normal of the decoded surface */
};

/* ---- corners ---- */

/* The wedge that corner i of triangle t most likely has: that of the same vertex in a neighbour that is decoded. */
static uint32_t expected_wedge(const struct step *s, uint32_t t, uint32_t i, uint32_t last, int *how) {
  const uint32_t *opposite = s->connectivity.opposite;
  for (int side = 0; side < 2; side++) {
    uint32_t h = side == 0 ? 3 * t + i : 3 * t + (i + 2) % 3, o = opposite[h];
    if (o == LOD_NONE || o / 3 >= t)
      continue;
    *how = side;
    o = side == 0 ? lod_half_edge_next(o) : o;
    return s->wedge_corners[o / 3][o % 3];
  }
  *how = 2;
  return last;
}

static enum lod_status code_corner(struct attributes *a, uint32_t t, uint32_t i, uint32_t actual, int *seam) {
  struct step *s = a->s;
  struct lod_coder *c = &s->coder;
  const uint32_t v = s->triangles[t][i];
  uint32_t *corner = &s->wedge_corners[t][i];
  bool fresh = a->first[v] == LOD_NONE;
  if (!fresh) {
    int how;
    uint32_t expected = expected_wedge(s, t, i, a->first[v], &how);
    if (lod_coder_bit(c, &a->m->same[how][*seam], LOD_ADAPT_SLOW, actual == expected)) {
      *corner = expected;
      *seam = 1;
      return LOD_OK;
    }
    *seam = 2;
    fresh = lod_coder_bit(c, &a->m->fresh, LOD_ADAPT, actual == LOD_NONE);
  }
  if (!fresh) { /* another one of this vertex */
    uint32_t place = 0, w = a->first[v];
    for (uint32_t u = w; s->request != NULL && u != actual; u = a->next[u])
      place++;
    for (place = lod_coder_number(c, &a->m->other, place); place > 0 && w != LOD_NONE; place--)
      w = a->next[w];
    if (w == LOD_NONE)
      return lod_step_bad(s, "wedges");
    *corner = w;
    return LOD_OK;
  }
  if (a->count == s->header.wedges)
    return lod_step_bad(s, "wedges");
  *corner = a->count;
  s->wedge_vertex[a->count] = v;
  a->made[a->count] = 3 * t + i;
  a->next[a->count] = a->first[v];
  a->first[v] = a->count++;
  return LOD_OK;
}

static enum lod_status code_corners(struct attributes *a) {
  struct step *s = a->s;
  const struct lod_mesh *fine = s->request != NULL ? s->request->fine : NULL;
  for (uint32_t t = 0; t < s->header.triangles; t++) {
    int seam = 0;
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "wedges");
    for (uint32_t i = 0; i < 3; i++) {
      uint32_t from = LOD_NONE, before = a->count;
      if (fine != NULL) {
        uint32_t h = s->connectivity.source_half_edges[t];
        from = fine->corners[h / 3][(h % 3 + i) % 3];
      }
      LOD_TRY(code_corner(a, t, i, fine != NULL ? a->target[from] : LOD_NONE, &seam));
      if (fine != NULL && a->count > before) {
        a->target[from] = before;
        a->source[before] = from;
      }
    }
  }
  return a->count == s->header.wedges ? LOD_OK : lod_step_bad(s, "wedges");
}

/* ---- prediction ---- */

/* Wedges that are decoded before w, near it, and how its value follows from theirs: value = sum of weights[i] * value of wedges[i]. */
struct neighbours {
  uint32_t wedges[3];
  double weights[3];
  int count;
};

static void position_of(const struct step *s, uint32_t wedge, double p[3]) {
  for (int i = 0; i < 3; i++)
    p[i] = (double)s->cells[s->wedge_vertex[wedge]][i];
}

/* Where w's vertex lies in the plane of the triangle across the gate: weights of its corners, if sensible. */
static bool affine(const struct step *s, uint32_t w, const uint32_t corners[3], double weights[3]) {
  double p[4][3], e[3][3];
  for (int k = 0; k < 3; k++)
    position_of(s, corners[k], p[k]);
  position_of(s, w, p[3]);
  for (int i = 0; i < 3; i++) {
    e[0][i] = p[1][i] - p[0][i];
    e[1][i] = p[2][i] - p[0][i];
    e[2][i] = p[3][i] - p[0][i];
  }
  double d[3][3];
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++)
      d[i][k] = e[i][0] * e[k][0] + e[i][1] * e[k][1] + e[i][2] * e[k][2];
  const double determinant = d[0][0] * d[1][1] - d[0][1] * d[0][1];
  if (!(determinant > 1e-6 * d[0][0] * d[1][1]))
    return false;
  weights[1] = (d[2][0] * d[1][1] - d[2][1] * d[0][1]) / determinant;
  weights[2] = (d[2][1] * d[0][0] - d[2][0] * d[0][1]) / determinant;
  weights[0] = 1 - weights[1] - weights[2];
  for (int k = 0; k < 3; k++)
    if (!(weights[k] > -8 && weights[k] < 8))
      return false;
  return true;
}

static struct neighbours find_neighbours(const struct attributes *a, uint32_t w) {
  const struct step *s = a->s;
  const uint32_t *wedges = s->wedge_corners[0], h = a->made[w], t = h / 3, gate = s->connectivity.opposite[3 * (size_t)t];
  struct neighbours n = {.count = 0};
  if (h % 3 == 2 && gate != LOD_NONE && gate / 3 < t && wedges[3 * t] < w && wedges[3 * t + 1] < w) {
    const uint32_t across = wedges[3 * (gate / 3) + (gate + 2) % 3];
    const uint32_t corners[3] = {wedges[3 * t], wedges[3 * t + 1], across};
    memcpy(n.wedges, corners, sizeof corners);
    if (across < w && affine(s, w, corners, n.weights)) {
      n.count = 3;
      return n;
    }
  }
  for (uint32_t k = 1; k < 3; k++) {
    uint32_t u = wedges[3 * t + (h % 3 + k) % 3];
    if (u < w)
      n.wedges[n.count++] = u;
  }
  if (n.count == 0 && w > 0)
    n.wedges[n.count++] = w - 1;
  for (int k = 0; k < n.count; k++)
    n.weights[k] = 1.0 / n.count;
  return n;
}

static int32_t predict(const struct neighbours *n, const int32_t *values, int components, int component) {
  double sum = 0;
  for (int k = 0; k < n->count; k++)
    sum += n->weights[k] * (double)values[(size_t)n->wedges[k] * (size_t)components + (size_t)component];
  return sum > -1e8 && sum < 1e8 ? (int32_t)floor(sum + 0.5) : 0;
}

/* A value near its prediction; what wraps is refused by the caller's range. */
static int32_t code_value(struct lod_coder *c, struct lod_number_model *m, struct lod_bit_model *sign, int32_t expected, int32_t value) {
  return (int32_t)((uint32_t)expected + (uint32_t)lod_coder_signed(c, m, sign, (int32_t)((uint32_t)value - (uint32_t)expected)));
}

/* ---- UV and colours: whole numbers ---- */

/* Encoding: the fewest bits with which all are whole multiples; false when none are enough. */
static bool find_uv_bits(const struct attributes *a, const float (*uvs)[2], uint32_t *bits) {
  for (*bits = 0; *bits <= MOST_UV_BITS; ++*bits) {
    bool whole = true;
    for (uint32_t w = 0; whole && w < a->s->header.wedges; w++)
      for (int i = 0; i < 2; i++) {
        double x = (double)uvs[w][i] * (double)(1u << *bits);
        whole = whole && x > -5e7 && x < 5e7 && x == floor(x);
      }
    if (whole)
      return true;
  }
  return false;
}

static enum lod_status code_uvs(struct attributes *a, int set) {
  struct step *s = a->s;
  const uint32_t wedges = s->header.wedges;
  int32_t *values = LOD_NEW_ZERO(s->scratch, 2 * (size_t)wedges, int32_t);
  s->uvs[set] = lod_arena_alloc(s->arena, wedges, sizeof *s->uvs[set]);
  if (values == NULL || s->uvs[set] == NULL)
    return LOD_MEMORY;
  const double scale = (double)(1u << a->uv_bits[set]);
  for (uint32_t w = 0; w < wedges; w++) {
    const struct neighbours n = find_neighbours(a, w);
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "UVs");
    for (int i = 0; i < 2; i++) {
      const int kind = n.count == 3;
      int32_t actual = s->request != NULL ? (int32_t)((double)s->request->fine->uvs[set][a->source[w]][i] * scale) : 0;
      int32_t value = code_value(&s->coder, &a->m->uv[set][kind][i], &a->m->sign[2 * set + kind][i], predict(&n, values, 2, i), actual);
      if (value < -50000000 || value > 50000000)
        return lod_step_bad(s, "UVs");
      values[2 * (size_t)w + (size_t)i] = value;
      s->uvs[set][w][i] = (float)((double)value / scale);
    }
  }
  return LOD_OK;
}

static int32_t color_value(const struct attributes *a, float color) {
  return (int32_t)floor((double)color * (double)((1u << a->color_bits) - 1) + 0.5);
}

static float color_of(const struct attributes *a, int32_t value) {
  return (float)((double)value / (double)((1u << a->color_bits) - 1));
}

static bool find_color_bits(struct attributes *a, const float (*colors)[4]) {
  a->alpha = 0;
  for (uint32_t w = 0; w < a->s->header.wedges; w++)
    a->alpha |= colors[w][3] != 1;
  for (a->color_bits = 8; a->color_bits <= 16; a->color_bits += 8) {
    bool whole = true;
    for (uint32_t w = 0; whole && w < a->s->header.wedges; w++)
      for (int i = 0; i < 4; i++)
        whole = whole && colors[w][i] >= 0 && colors[w][i] <= 1 && color_of(a, color_value(a, colors[w][i])) == colors[w][i];
    if (whole)
      return true;
  }
  return false;
}

static enum lod_status code_colors(struct attributes *a) {
  struct step *s = a->s;
  const uint32_t wedges = s->header.wedges;
  int32_t *values = LOD_NEW_ZERO(s->scratch, 4 * (size_t)wedges, int32_t);
  s->colors = lod_arena_alloc(s->arena, wedges, sizeof *s->colors);
  if (values == NULL || s->colors == NULL)
    return LOD_MEMORY;
  for (uint32_t w = 0; w < wedges; w++) {
    struct neighbours n = find_neighbours(a, w);
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "colours");
    if (n.count == 3) { /* colours do not go on as UVs do */
      n.count = 2;
      n.weights[0] = n.weights[1] = 0.5;
    }
    s->colors[w][3] = 1;
    for (int i = 0; i < (a->alpha ? 4 : 3); i++) {
      int32_t actual = s->request != NULL ? color_value(a, s->request->fine->colors[a->source[w]][i]) : 0;
      int32_t value = code_value(&s->coder, &a->m->color[i], &a->m->sign[4 + i / 2][i % 2], predict(&n, values, 4, i), actual);
      if (value < 0 || value >= 1 << a->color_bits)
        return lod_step_bad(s, "colours");
      values[4 * (size_t)w + (size_t)i] = value;
      s->colors[w][i] = color_of(a, value);
    }
  }
  return LOD_OK;
}

/* ---- normals ---- */

static enum lod_status find_surface(struct attributes *a) {
  const struct step *s = a->s;
  a->surface = lod_arena_calloc(s->scratch, s->header.wedges, sizeof *a->surface);
  if (a->surface == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < s->header.triangles; t++) {
    double p[3], q[3];
    for (int i = 0; i < 3; i++) {
      p[i] = (double)s->cells[s->triangles[t][1]][i] - (double)s->cells[s->triangles[t][0]][i];
      q[i] = (double)s->cells[s->triangles[t][2]][i] - (double)s->cells[s->triangles[t][0]][i];
    }
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++)
        a->surface[s->wedge_corners[t][k]][i] += (float)(p[(i + 1) % 3] * q[(i + 2) % 3] - p[(i + 2) % 3] * q[(i + 1) % 3]);
  }
  for (uint32_t w = 0; w < s->header.wedges; w++) {
    double square = 0;
    for (int i = 0; i < 3; i++)
      square += (double)a->surface[w][i] * (double)a->surface[w][i];
    for (int i = 0; i < 3; i++)
      a->surface[w][i] = square > 0 ? (float)((double)a->surface[w][i] / sqrt(square)) : (float)(i == 2);
  }
  return LOD_OK;
}

/* Octahedral coordinates, 0 to 2^bits - 2 each, and back (Meyer, Suessmuth, Sussner, Stamminger. On Floating-Point Normal Vectors. 2010).
 */
static void octahedral(const float n[3], uint32_t bits, int32_t q[2]) {
  const double sum = fabs((double)n[0]) + fabs((double)n[1]) + fabs((double)n[2]), half = (double)((1u << (bits - 1)) - 1);
  double x = sum > 0 ? (double)n[0] / sum : 0, y = sum > 0 ? (double)n[1] / sum : 0;
  if (n[2] < 0) {
    double fold = (1 - fabs(y)) * (x < 0 ? -1 : 1);
    y = (1 - fabs(x)) * (y < 0 ? -1 : 1);
    x = fold;
  }
  q[0] = (int32_t)floor((x + 1) * half + 0.5);
  q[1] = (int32_t)floor((y + 1) * half + 0.5);
}

static void unfold(const int32_t q[2], uint32_t bits, float n[3]) {
  const double half = (double)((1u << (bits - 1)) - 1);
  double x = (double)q[0] / half - 1, y = (double)q[1] / half - 1, z = 1 - fabs(x) - fabs(y);
  if (z < 0) {
    double fold = (1 - fabs(y)) * (x < 0 ? -1 : 1);
    y = (1 - fabs(x)) * (y < 0 ? -1 : 1);
    x = fold;
  }
  const double length = sqrt(x * x + y * y + z * z);
  n[0] = (float)(x / length);
  n[1] = (float)(y / length);
  n[2] = (float)(z / length);
}

/* Encoding: whether all normals are within `degrees` of the surface's, some are missing, or all must be sent. */
static uint32_t judge_normals(const struct attributes *a, const float (*normals)[3], double degrees) {
  const double least = cos(degrees * 0.017453292519943295);
  bool smooth = true, some = false;
  for (uint32_t w = 0; w < a->s->header.wedges; w++) {
    const float *n = normals[a->source[w]], *m = a->surface[w];
    const double square = (double)n[0] * (double)n[0] + (double)n[1] * (double)n[1] + (double)n[2] * (double)n[2];
    const double dot = (double)n[0] * (double)m[0] + (double)n[1] * (double)m[1] + (double)n[2] * (double)m[2];
    smooth = smooth && dot >= least;
    some = some || !(square > 0.25);
  }
  return some ? NORMALS_SOME : smooth ? NORMALS_SMOOTH : NORMALS_SENT;
}

static enum lod_status code_normals(struct attributes *a) {
  struct step *s = a->s;
  const uint32_t wedges = s->header.wedges;
  const float(*given)[3] = s->request != NULL ? (const float(*)[3])s->request->fine->normals : NULL;
  LOD_TRY(find_surface(a));
  if (given != NULL)
    a->normals = judge_normals(a, given, s->request->normal_degrees);
  a->normals = lod_coder_raw(&s->coder, a->normals, 2);
  if (a->normals == NORMALS_NONE)
    return lod_step_bad(s, "normals");
  if (a->normals == NORMALS_SMOOTH) {
    s->normals = lod_arena_copy(s->arena, a->surface, wedges * sizeof *a->surface);
    return s->normals == NULL ? LOD_MEMORY : LOD_OK;
  }
  uint32_t bits = lod_coder_raw(&s->coder, s->request != NULL ? (uint32_t)s->request->normal_bits : 0, 5);
  if (bits < 2 || bits > 16)
    return lod_step_bad(s, "normals");
  s->normals = lod_arena_calloc(s->arena, wedges, sizeof *s->normals);
  if (s->normals == NULL)
    return LOD_MEMORY;
  for (uint32_t w = 0; w < wedges; w++) {
    int32_t expected[2], actual[2] = {0, 0};
    const float *n = given != NULL ? given[a->source[w]] : NULL;
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "normals");
    if (a->normals == NORMALS_SOME &&
        !lod_coder_bit(&s->coder, &a->m->has, LOD_ADAPT, n != NULL && (n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.25f)))
      continue;
    octahedral(a->surface[w], bits, expected);
    if (n != NULL)
      octahedral(n, bits, actual);
    for (int i = 0; i < 2; i++) {
      actual[i] = code_value(&s->coder, &a->m->normal[i], &a->m->sign[6][i], expected[i], actual[i]);
      if (actual[i] < 0 || actual[i] > (int32_t)(1u << bits))
        return lod_step_bad(s, "normals");
    }
    unfold(actual, bits, s->normals[w]);
  }
  return LOD_OK;
}

/* ---- the whole ---- */

static enum lod_status prepare(struct attributes *a) {
  struct step *s = a->s;
  const uint32_t wedges = s->header.wedges;
  a->m = lod_coder_models(&s->coder, sizeof *a->m, s->scratch);
  a->first = LOD_NEW(s->scratch, s->header.vertices, uint32_t);
  a->next = LOD_NEW(s->scratch, wedges, uint32_t);
  a->made = LOD_NEW(s->scratch, wedges, uint32_t);
  s->wedge_corners = lod_arena_alloc(s->arena, s->header.triangles, sizeof *s->wedge_corners);
  s->wedge_vertex = LOD_NEW(s->arena, wedges, uint32_t);
  if (a->m == NULL || a->first == NULL || a->next == NULL || a->made == NULL || s->wedge_corners == NULL || s->wedge_vertex == NULL)
    return LOD_MEMORY;
  memset(a->first, 0xff, (size_t)s->header.vertices * sizeof *a->first);
  if (s->request == NULL)
    return LOD_OK;
  a->target = LOD_NEW(s->scratch, wedges, uint32_t);
  a->source = LOD_NEW(s->scratch, wedges, uint32_t);
  if (a->target == NULL || a->source == NULL)
    return LOD_MEMORY;
  memset(a->target, 0xff, (size_t)wedges * sizeof *a->target);
  return LOD_OK;
}

/* Which attributes there are, and with how many bits. */
static enum lod_status code_kinds(struct attributes *a, bool *normals, bool *colors) {
  struct step *s = a->s;
  const struct lod_mesh *fine = s->request != NULL ? s->request->fine : NULL;
  struct lod_coder *c = &s->coder;
  for (int set = 0; set < LOD_UV_SETS; set++) {
    a->has_uv[set] = fine != NULL && fine->uvs[set] != NULL;
    if (a->has_uv[set] && !find_uv_bits(a, (const float(*)[2])fine->uvs[set], &a->uv_bits[set]))
      return lod_fail(s->problem, LOD_BAD_INPUT, "off-grid", "UVs of a level to encode are not whole multiples of 2^-%d.", MOST_UV_BITS);
    a->has_uv[set] = lod_coder_raw(c, a->has_uv[set], 1);
    a->uv_bits[set] = a->has_uv[set] ? lod_coder_raw(c, a->uv_bits[set], 5) : 0;
    if (a->uv_bits[set] > MOST_UV_BITS)
      return lod_step_bad(s, "UVs");
  }
  *colors = fine != NULL && fine->colors != NULL;
  if (*colors && !find_color_bits(a, (const float(*)[4])fine->colors))
    return lod_fail(s->problem, LOD_BAD_INPUT, "off-grid", "Colours of a level to encode have more than 16 bits.");
  *colors = lod_coder_raw(c, *colors, 1);
  if (*colors) {
    a->color_bits = lod_coder_raw(c, a->color_bits == 16, 1) ? 16 : 8;
    a->alpha = lod_coder_raw(c, a->alpha, 1);
  }
  *normals = lod_coder_raw(c, fine != NULL && fine->normals != NULL, 1);
  return LOD_OK;
}

enum lod_status lod_step_attributes(struct step *s) {
  struct attributes a = {.s = s};
  bool normals, colors;
  const size_t before = s->coder.out_size;
  if (s->header.wedges == 0)
    return LOD_OK;
  LOD_TRY(prepare(&a));
  LOD_TRY(code_kinds(&a, &normals, &colors));
  LOD_TRY(code_corners(&a));
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (a.has_uv[set])
      LOD_TRY(code_uvs(&a, set));
  if (colors)
    LOD_TRY(code_colors(&a));
  if (normals)
    LOD_TRY(code_normals(&a));
  s->statistics->attributes += 8.0 * (double)(s->coder.out_size - before);
  return LOD_OK;
}
