/* Attributes of a certified level, sampled from the source. */
#include "core/envelope/envelope.h"

#include <math.h>
#include <string.h>

#include "core/envelope/attribute_target.h"
#include "core/envelope/internal.h"

/* Weights of the corners of abc for a point p of it. */
static void barycentrics(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c, double weights[3]) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a), ac = lod_vec3_subtract(c, a), ap = lod_vec3_subtract(p, a);
  double d00 = lod_vec3_dot(ab, ab), d01 = lod_vec3_dot(ab, ac), d11 = lod_vec3_dot(ac, ac);
  double d20 = lod_vec3_dot(ap, ab), d21 = lod_vec3_dot(ap, ac), denominator = d00 * d11 - d01 * d01;
  if (!(denominator > 0)) { /* without area: along the longer side */
    double t = d00 >= d11 ? (d00 > 0 ? d20 / d00 : 0) : d21 / d11;
    t = fmin(1, fmax(0, t));
    weights[0] = 1 - t;
    weights[1] = d00 >= d11 ? t : 0;
    weights[2] = d00 >= d11 ? 0 : t;
    return;
  }
  weights[1] = fmin(1, fmax(0, (d11 * d20 - d01 * d21) / denominator));
  weights[2] = fmin(1 - weights[1], fmax(0, (d00 * d21 - d01 * d20) / denominator));
  weights[0] = 1 - weights[1] - weights[2];
}

static void sample(const struct lod_mesh *source, uint32_t t, struct lod_vec3 at, struct lod_mesh *to, uint32_t wedge) {
  const uint32_t *v = source->triangles[t], *w = source->corners[t];
  double weights[3];
  barycentrics(at, lod_vec3_from_float(source->positions[v[0]]), lod_vec3_from_float(source->positions[v[1]]),
               lod_vec3_from_float(source->positions[v[2]]), weights);
  if (to->normals != NULL) {
    struct lod_vec3 n = {0, 0, 0};
    for (int k = 0; k < 3; k++)
      n = lod_vec3_add_scaled(n, lod_vec3_from_float(source->normals[w[k]]), weights[k]);
    lod_vec3_to_float(lod_vec3_normalize(n), to->normals[wedge]);
  }
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int i = 0; i < 2 && to->uvs[set] != NULL; i++) {
      double value = 0;
      for (int k = 0; k < 3; k++)
        value += weights[k] * (double)source->uvs[set][w[k]][i];
      to->uvs[set][wedge][i] = (float)value;
    }
  for (int i = 0; i < 4 && to->colors != NULL; i++) {
    double value = 0;
    for (int k = 0; k < 3; k++)
      value += weights[k] * (double)source->colors[w[k]][i];
    to->colors[wedge][i] = (float)value;
  }
}

static bool allocate(const struct lod_mesh *source, struct lod_arena *arena, struct lod_mesh *m) {
  size_t most = (size_t)m->triangle_count * 3;
  bool ok = (m->corners = lod_arena_alloc(arena, m->triangle_count, sizeof *m->corners)) != NULL &&
            (m->wedge_vertex = LOD_NEW(arena, most, uint32_t)) != NULL;
  ok = ok && (source->normals == NULL || (m->normals = lod_arena_alloc(arena, most, sizeof *m->normals)) != NULL);
  ok = ok && (source->colors == NULL || (m->colors = lod_arena_alloc(arena, most, sizeof *m->colors)) != NULL);
  for (int k = 0; k < LOD_UV_SETS; k++)
    ok = ok && (source->uvs[k] == NULL || (m->uvs[k] = lod_arena_alloc(arena, most, sizeof *m->uvs[k])) != NULL);
  return ok;
}

/* A degenerate triangle that stayed keeps its corners' attributes, a wedge each. */
static void sample_kept(const struct lod_collapser *c, uint32_t t, struct lod_mesh *to, uint32_t triangle) {
  for (int k = 0; k < 3; k++) {
    uint32_t wedge = to->corners[triangle][k] = to->wedge_count++;
    to->wedge_vertex[wedge] = to->triangles[triangle][k];
    sample(c->mesh, t, lod_vec3_from_float(c->mesh->positions[c->mesh->triangles[t][k]]), to, wedge);
  }
}

static void write_wedge(const struct lod_wedges *w, uint32_t from, struct lod_mesh *to, uint32_t wedge) {
  const double *value = w->value + (size_t)from * w->channels;
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int k = 0; k < 2 && to->uvs[set] != NULL; k++)
      to->uvs[set][wedge][k] = (float)*value++;
  for (int k = 0; k < 3 && to->normals != NULL; k++)
    to->normals[wedge][k] = (float)*value++;
  for (int k = 0; k < 4 && to->colors != NULL; k++)
    to->colors[wedge][k] = (float)*value++;
}

enum lod_status lod_envelope_extract_attributes(const struct lod_collapser *c, struct lod_arena *arena, struct lod_mesh *result) {
  const struct lod_surface *s = &c->surface;
  if (c->wedges.channels == 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *wedge_to = scratch == NULL ? NULL : LOD_NEW(scratch, c->wedges.count, uint32_t);
  if (wedge_to == NULL || !allocate(c->mesh, arena, result)) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  memset(wedge_to, 0xff, c->wedges.count * sizeof *wedge_to);
  for (uint32_t f = 0, out = 0; f < s->face_count; f++) {
    if (s->face[f][0] == LOD_NONE)
      continue;
    for (int k = 0; k < 3; k++) {
      uint32_t from = c->wedges.corner[f][k];
      if (wedge_to[from] == LOD_NONE) {
        wedge_to[from] = result->wedge_count++;
        result->wedge_vertex[wedge_to[from]] = result->triangles[out][k];
        write_wedge(&c->wedges, from, result, wedge_to[from]);
      }
      result->corners[out][k] = wedge_to[from];
    }
    out++;
  }
  for (uint32_t i = 0; i < c->kept_count; i++)
    sample_kept(c, c->kept[i], result, result->triangle_count - c->kept_count + i);
  lod_arena_destroy(scratch);
  return LOD_OK;
}

/* ---- how far they are from the source's ---- */

struct deviation {
  double worst; /* of groups over their bounds, or of the distance where nothing is bounded; INFINITY = none yet */
  double of_group[LOD_MOST_GROUPS];
};

/* A triangle of one mesh, as what points of the other are compared with. */
struct side {
  struct lod_target target;
  struct lod_attribute_target attributes;
};

static void make_side(const struct lod_collapser *c, const struct lod_vec3 p[3], const double *const value[3], struct side *side) {
  lod_target_make(&side->target, p);
  lod_attribute_target_make(&side->attributes, &c->wedges, &side->target, value, c->epsilon);
}

static void side_of_face(const struct lod_collapser *c, uint32_t f, struct lod_vec3 p[3], const double *value[3]) {
  for (int k = 0; k < 3; k++) {
    p[k] = c->surface.position[c->surface.face[f][k]];
    value[k] = c->wedges.value + (size_t)c->wedges.corner[f][k] * c->wedges.channels;
  }
}

static void side_of_source(const struct lod_collapser *c, uint32_t t, struct lod_vec3 p[3], const double *value[3]) {
  for (int k = 0; k < 3; k++) {
    p[k] = lod_vec3_from_float(c->mesh->positions[c->mesh->triangles[t][k]]);
    value[k] = c->wedges.of_source + (size_t)c->mesh->corners[t][k] * c->wedges.channels;
  }
}

/* The point (s, t) of a side against q; kept when it fits better than what d holds. */
static void compare_at(const struct lod_collapser *c, const struct side *side, struct lod_vec3 q, const double *value, double s, double t,
                       struct deviation *d) {
  const struct lod_wedges *w = &c->wedges;
  struct lod_vec3 p = lod_vec3_add_scaled(lod_vec3_add_scaled(side->target.a, side->target.ab, s), side->target.ac, t);
  struct deviation fresh = {.worst = lod_vec3_distance(p, q) / c->epsilon};
  if (w->bounded && fresh.worst <= 1)
    fresh.worst = 0;
  for (uint32_t g = 0; g < w->group_count; g++) {
    double sum = 0;
    for (uint32_t i = w->groups[g].first; i < w->groups[g].first + w->groups[g].count; i++) {
      double difference = side->attributes.a[i] + s * side->attributes.ab[i] + t * side->attributes.ac[i] - value[i];
      sum += difference * difference;
    }
    fresh.of_group[g] = sqrt(sum);
    if (isfinite(w->groups[g].bound))
      fresh.worst = fmax(fresh.worst, fresh.of_group[g] / w->groups[g].bound);
  }
  if (fresh.worst < d->worst)
    *d = fresh;
}

static void compare(const struct lod_collapser *c, const struct side *side, struct lod_vec3 q, const double *value, struct deviation *d) {
  const struct lod_target *face = &side->target;
  const struct lod_attribute_target *a = &side->attributes;
  struct lod_vec3 aq = lod_vec3_subtract(q, face->a);
  double p0 = lod_vec3_dot(aq, face->ab), p1 = lod_vec3_dot(aq, face->ac), s, t;
  double r0 = a->inverse_squared * p0, r1 = a->inverse_squared * p1;
  for (uint32_t i = 0; i < c->wedges.channels; i++) {
    r0 += c->wedges.weight[i] * a->ab[i] * (value[i] - a->a[i]);
    r1 += c->wedges.weight[i] * a->ac[i] * (value[i] - a->a[i]);
  }
  lod_nearest_weights(a->g00, a->g01, a->g11, r0, r1, &s, &t);
  compare_at(c, side, q, value, s, t, d);
  lod_nearest_weights(face->d00, face->d01, face->d11, p0, p1, &s, &t);
  compare_at(c, side, q, value, s, t, d);
}

/* The centre and the corners of a triangle against a side. */
enum { SAMPLES = 4 };
static void compare_triangle(const struct lod_collapser *c, const struct side *side, const struct lod_vec3 p[3],
                             const double *const value[3], struct deviation d[SAMPLES]) {
  double mean[LOD_MOST_CHANNELS];
  for (uint32_t i = 0; i < c->wedges.channels; i++)
    mean[i] = (value[0][i] + value[1][i] + value[2][i]) / 3;
  compare(c, side, lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3), mean, &d[0]);
  for (int k = 0; k < 3; k++)
    compare(c, side, p[k], value[k], &d[1 + k]);
}

static void add_deviations(const struct lod_wedges *w, const struct deviation d[SAMPLES], struct lod_envelope_report *report) {
  for (int i = 0; i < SAMPLES; i++) {
    uint32_t g = 0;
    if (!isfinite(d[i].worst))
      continue;
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (w->source->uvs[set] != NULL)
        report->uv[set] = fmax(report->uv[set], d[i].of_group[g++]);
    if (w->source->normals != NULL) /* of a chord between interpolated normals: what its arc is on the unit sphere */
      report->normal_degrees = fmax(report->normal_degrees, 2 * asin(fmin(1, 0.5 * d[i].of_group[g])) * 57.29577951308232);
  }
}

/* A face against what it and the faces around it are charged with. */
static void compare_face(const struct lod_collapser *c, uint32_t f, const struct lod_vec3 p[3], const double *const value[3],
                         struct deviation d[SAMPLES]) {
  for (int k = 0; k < 3; k++) {
    const uint32_t *ring = lod_surface_ring(&c->surface, c->surface.face[f][k]);
    for (uint32_t j = 0; j < c->surface.ring_count[c->surface.face[f][k]]; j++)
      for (uint32_t i = 0; i < lod_certificate_charge_count(c->certificate, ring[j]); i++) {
        uint32_t t = lod_certificate_charge(c->certificate, ring[j], i);
        if (t == LOD_NONE || c->patch[t] != c->patch[f])
          continue;
        struct lod_vec3 q[3];
        const double *at_q[3];
        struct side triangle;
        side_of_source(c, t, q, at_q);
        make_side(c, q, at_q, &triangle);
        compare_triangle(c, &triangle, p, value, d);
      }
  }
}

enum lod_status lod_envelope_measure_attributes(const struct lod_collapser *c, struct lod_arena *arena,
                                                struct lod_envelope_report *report) {
  static const struct deviation kNone = {.worst = INFINITY};
  if (c->wedges.channels == 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct deviation(*of_source)[SAMPLES] = scratch == NULL ? NULL : lod_arena_alloc(scratch, c->mesh->triangle_count, sizeof *of_source);
  if (of_source == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++)
    for (int i = 0; i < SAMPLES; i++)
      of_source[t][i] = kNone;
  for (uint32_t f = 0; f < c->surface.face_count; f++) {
    if (c->surface.face[f][0] == LOD_NONE)
      continue;
    struct deviation of_face[SAMPLES] = {kNone, kNone, kNone, kNone};
    struct lod_vec3 p[3], q[3];
    const double *at_p[3], *at_q[3];
    struct side face;
    side_of_face(c, f, p, at_p);
    make_side(c, p, at_p, &face);
    for (uint32_t i = 0; i < lod_certificate_charge_count(c->certificate, f); i++) {
      uint32_t t = lod_certificate_charge(c->certificate, f, i);
      if (t == LOD_NONE || c->patch[t] != c->patch[f])
        continue;
      side_of_source(c, t, q, at_q);
      compare_triangle(c, &face, q, at_q, of_source[t]);
    }
    compare_face(c, f, p, at_p, of_face);
    add_deviations(&c->wedges, of_face, report);
  }
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++)
    add_deviations(&c->wedges, of_source[t], report);
  lod_arena_destroy(scratch);
  uint32_t g = 0;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (c->mesh->uvs[set] != NULL)
      report->uv_bound[set] = c->wedges.groups[g++].bound;
  if (c->mesh->normals != NULL)
    report->normal_bound = isfinite(c->wedges.groups[g].bound) ? c->wedges.bounds.normal_degrees : INFINITY;
  return LOD_OK;
}
