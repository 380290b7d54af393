#include "core/refine/doi.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/mesh/bvh.h"
#include "core/refine/internal.h"
#include "core/refine/trig.h"

struct lod_doi_term lod_doi_term_defaults(enum lod_doi_kind kind) {
  struct lod_doi_term term = {.kind = kind,
                              .view = {.direction = {0, 0, 1}, .fov_degrees = 60, .height_px = 1080},
                              .pixels = 1,
                              .look = {0, 0, -1},
                              .acuity_slope = 1.32 / 60,
                              .acuity_centre = 1.0 / 48};
  term.degrees = kind == LOD_DOI_FACE_ANGLE ? 20 : kind == LOD_DOI_DIHEDRAL ? 30 : kind == LOD_DOI_CURVATURE ? 10 : 0;
  term.threshold = kind == LOD_DOI_CLOUGH_TOCHER ? 1 : 0;
  return term;
}

struct lod_refine_limits lod_refine_limits_defaults(void) {
  return (struct lod_refine_limits){.steps = 3, .bytes_per_vertex = 16, .bytes_per_triangle = 12, .hysteresis = 0.64};
}

/* What is asked about one face, computed when first needed. */
struct look {
  struct lod_refiner *r;
  struct face copy; /* the forest may move */
  uint32_t face;
  struct lod_vec3 p[3], centre, normal;
  bool has_vertex_normals;
  struct lod_vec3 vertex_normals[3];
};

static struct lod_vec3 corner_normal(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
}

static struct look look_at(struct lod_refiner *r, uint32_t f) {
  struct look look = {.r = r, .copy = r->faces[f], .face = f};
  for (int i = 0; i < 3; i++) /* as they are drawn at this level */
    look.p[i] = r->settings.positions == LOD_REFINE_LIMIT ? refine_limit_vec(r, look.copy.v[i])
                                                          : refine_position(r, look.copy.v[i], look.copy.level);
  look.centre = lod_vec3_scale(lod_vec3_add(lod_vec3_add(look.p[0], look.p[1]), look.p[2]), 1.0 / 3);
  look.normal = corner_normal(look.p[0], look.p[1], look.p[2]);
  return look;
}

static uint32_t base_of(const struct look *look) {
  return look->r->lineages[look->face].base;
}

static const struct lod_vec3 *vertex_normals(struct look *look) {
  for (int i = 0; i < 3 && !look->has_vertex_normals; i++) {
    float n[3];
    refine_normal(look->r, look->copy.v[i], base_of(look), n);
    look->vertex_normals[i] = lod_vec3_from_float(n);
  }
  look->has_vertex_normals = true;
  return look->vertex_normals;
}

static struct lod_vec3 vec(const double v[3]) {
  return (struct lod_vec3){v[0], v[1], v[2]};
}

/* Unit, towards the viewer; zero when the eye is there. */
static struct lod_vec3 view_from(const struct lod_doi_view *view, struct lod_vec3 p) {
  return lod_vec3_normalize(view->parallel ? vec(view->direction) : lod_vec3_subtract(vec(view->eye), p));
}

static double gather3(enum lod_doi_gather gather, const double v[3]) {
  if (gather == LOD_DOI_MEAN)
    return (v[0] + v[1] + v[2]) / 3;
  double best = v[0];
  for (int i = 1; i < 3; i++)
    best = gather == LOD_DOI_MAX ? fmax(best, v[i]) : fmin(best, v[i]);
  return best;
}

/* Asked for every face, with one or two angles: remembered. */
static double sine_of(struct lod_refiner *r, double degrees) {
  for (int i = 0; i < 2; i++)
    if (r->sine_known[i] && r->sine_degrees[i] == degrees)
      return r->sines[i];
  int at = r->sine_known[0] ? 1 : 0;
  r->sine_known[at] = true;
  r->sine_degrees[at] = degrees;
  return r->sines[at] = refine_sin_degrees(degrees);
}

/* ---- neighbours in the drawn cut ---- */

/* The drawn triangle across edge i, of this level or the coarser one beside it; LOD_NONE: none, or several. */
static uint32_t neighbour(const struct lod_refiner *r, const struct face *face, int i) {
  uint32_t e = face->e[i];
  const struct edge *edge = &r->edges[e];
  int other = edge->v[0] == face->v[i] ? 1 : 0;
  if (edge->ringed)
    return LOD_NONE;
  if (edge->f[other] != LOD_NONE && r->faces[edge->f[other]].drawn)
    return edge->f[other];
  if (edge->up == LOD_NONE)
    return LOD_NONE;
  uint32_t g = r->edges[edge->up].f[other];
  return g != LOD_NONE && r->faces[g].drawn ? g : LOD_NONE;
}

/* ---- terms ---- */

static double face_angle(const struct lod_doi_term *term, struct look *look) {
  struct lod_vec3 v = view_from(&term->view, look->centre);
  double value = 1 - fabs(lod_vec3_dot(look->normal, v)), bar = 1 - sine_of(look->r, term->degrees);
  return bar > 0 ? value / bar : INFINITY;
}

static double silhouette(const struct lod_doi_term *term, struct look *look) {
  double values[3] = {0, 0, 0};
  for (int i = 0; i < 3; i++) {
    uint32_t g = neighbour(look->r, &look->copy, i);
    if (g == LOD_NONE)
      continue;
    struct look other = look_at(look->r, g);
    struct lod_vec3 middle = lod_vec3_scale(lod_vec3_add(look->p[i], look->p[(i + 1) % 3]), 0.5);
    struct lod_vec3 v = view_from(&term->view, middle); /* one for both, so that no edge is missed */
    double a = lod_vec3_dot(look->normal, v), b = lod_vec3_dot(other.normal, v);
    values[i] = (a >= 0 && b < 0) || (a <= 0 && b > 0) ? 2 : 0; /* eq. 2 is 1 against any threshold between 0 and 1 */
  }
  return gather3(term->gather, values);
}

/* Corners' normals turned by up to `degrees` to either side of the silhouette. */
static double cone(const struct lod_doi_term *term, struct look *look) {
  double margin = sine_of(look->r, term->degrees);
  const struct lod_vec3 *n = vertex_normals(look);
  bool front = false, back = false;
  for (int i = 0; i < 3; i++) {
    double d = lod_vec3_dot(n[i], view_from(&term->view, look->p[i]));
    front |= d >= -margin;
    back |= d <= margin;
  }
  double d = lod_vec3_dot(look->normal, view_from(&term->view, look->centre));
  front |= d >= -margin;
  back |= d <= margin;
  return front && back ? 2 : 0;
}

static double dihedral(const struct lod_doi_term *term, struct look *look) {
  double values[3] = {0, 0, 0}, bar = 2 * sine_of(look->r, term->degrees / 2);
  for (int i = 0; i < 3; i++) {
    uint32_t g = neighbour(look->r, &look->copy, i);
    if (g == LOD_NONE)
      continue;
    struct look other = look_at(look->r, g);
    bool concave = false; /* its far corner stands out on our outer side */
    for (int k = 0; k < 3; k++)
      concave |= lod_vec3_dot(look->normal, lod_vec3_subtract(other.p[k], look->p[i])) > 1e-12 * lod_vec3_distance(other.p[k], look->p[i]);
    double chord = lod_vec3_distance(look->normal, other.normal);
    values[i] = concave && !term->concave_too ? 0 : bar > 0 ? chord / bar : chord > 0 ? INFINITY : 0;
  }
  return gather3(term->gather, values);
}

static double curvature(const struct lod_doi_term *term, struct look *look) {
  double values[3], bar = 2 * sine_of(look->r, term->degrees / 2);
  const struct lod_vec3 *n = vertex_normals(look);
  for (int i = 0; i < 3; i++) {
    double chord = lod_vec3_distance(n[i], n[(i + 1) % 3]);
    values[i] = bar > 0 ? chord / bar : chord > 0 ? INFINITY : 0;
  }
  return gather3(term->gather, values);
}

/* How far the limit surface stands off from the middle of each edge: a circle through its ends with their normals. An estimate. */
static void stand_off(struct look *look, double off[3]) {
  const struct lod_vec3 *n = vertex_normals(look);
  for (int i = 0; i < 3; i++)
    off[i] = lod_vec3_distance(look->p[i], look->p[(i + 1) % 3]) * lod_vec3_distance(n[i], n[(i + 1) % 3]) / 8;
}

static double nearest_distance(struct lod_vec3 eye, const struct look *look) {
  return lod_vec3_distance(eye, lod_closest_on_triangle(eye, look->p[0], look->p[1], look->p[2]));
}

static double screen(const struct lod_doi_term *term, struct look *look) {
  double off[3], distance = nearest_distance(vec(term->view.eye), look);
  double scale = term->view.height_px * sine_of(look->r, 90 - term->view.fov_degrees / 2) /
                 (2 * sine_of(look->r, term->view.fov_degrees / 2)) / term->pixels;
  stand_off(look, off);
  for (int i = 0; i < 3; i++)
    off[i] = distance > 0 ? off[i] * scale / distance : off[i] > 0 ? INFINITY : 0;
  return gather3(term->gather, off);
}

static double gaze(const struct lod_doi_term *term, struct look *look) {
  struct lod_vec3 eye = vec(term->view.eye), gazed = vec(term->look);
  double off[3], distance = nearest_distance(eye, look), eccentricity = 180;
  stand_off(look, off);
  for (int i = 0; i < 4; i++) { /* corners and centre: a large triangle may reach under the gaze */
    struct lod_vec3 to = lod_vec3_subtract(i < 3 ? look->p[i] : look->centre, eye);
    double e = refine_angle_degrees(lod_vec3_dot(to, gazed), lod_vec3_length_squared(to), lod_vec3_length_squared(gazed));
    eccentricity = fmin(eccentricity, e);
  }
  struct lod_vec3 to = lod_vec3_subtract(look->centre, eye);
  double reach = refine_angle_degrees(lod_vec3_dot(lod_vec3_subtract(look->p[0], eye), to),
                                      lod_vec3_length_squared(lod_vec3_subtract(look->p[0], eye)), lod_vec3_length_squared(to));
  eccentricity = fmax(0, eccentricity - reach);
  double resolved = term->acuity_centre + term->acuity_slope * eccentricity; /* degrees */
  const struct lod_vec3 *n = vertex_normals(look);
  bool front = false, back = false; /* contrast in the periphery sits at silhouettes: keep them twice as fine */
  for (int i = 0; i < 3; i++) {
    double d = lod_vec3_dot(n[i], lod_vec3_subtract(eye, look->p[i]));
    front |= d >= 0;
    back |= d <= 0;
  }
  double gain = 57.29577951308232 / resolved * (front && back ? 2 : 1);
  for (int i = 0; i < 3; i++)
    off[i] = distance > 0 ? off[i] / distance * gain : off[i] > 0 ? INFINITY : 0;
  return gather3(term->gather, off);
}

/* ---- graded terms ---- */

static double graded(double interest, const struct look *look, uint32_t steps) {
  return interest * steps / (look->copy.level + look->r->level_bias + 0.5);
}

static double line_distance2(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a);
  double length2 = lod_vec3_length_squared(ab), t = length2 > 0 ? lod_vec3_dot(lod_vec3_subtract(p, a), ab) / length2 : 0;
  return lod_vec3_distance_squared(p, lod_vec3_add_scaled(a, ab, fmin(1, fmax(0, t))));
}

static double object_distance(const struct lod_doi_object *object, struct lod_vec3 p) {
  double best = INFINITY;
  for (uint32_t i = 0; i + (object->bone_count > 1) < object->bone_count; i++)
    best = fmin(best, line_distance2(p, vec(object->bones[i]), vec(object->bones[object->bone_count > 1 ? i + 1 : i])));
  return sqrt(best);
}

static double focus(const struct lod_doi_term *term, struct look *look, uint32_t steps) {
  const uint32_t *parts = look->r->base.mesh.parts;
  double best = 0;
  for (uint32_t i = 0; i < term->object_count; i++) {
    const struct lod_doi_object *object = &term->objects[i];
    bool own = object->part != LOD_NONE && (parts == NULL || parts[base_of(look)] == object->part);
    /* From the point of the triangle that is nearest: its centre would make coarse triangles look far away. */
    double d = own ? 0 : INFINITY;
    for (int k = 0; k < 4 && !own; k++)
      d = fmin(d, object_distance(object, k < 3 ? look->p[k] : look->centre));
    if (!own && object->bone_count == 1)
      d = lod_vec3_distance(vec(object->bones[0]), lod_closest_on_triangle(vec(object->bones[0]), look->p[0], look->p[1], look->p[2]));
    double fall = d == 0 ? 1 : term->falloff > 0 ? 1 - d / term->falloff : 0;
    best = fmax(best, object->dominance * fmax(0, fall));
  }
  return graded(best, look, steps);
}

/* Barycentric weights of a face's corners in its base triangle, in units of 1 / 2^level. */
static void face_weights(uint32_t path, uint32_t levels, uint32_t weights[3][3]) {
  uint32_t w[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (uint32_t level = 0; level < levels; level++) {
    uint32_t which = path >> 2 * level & 3, m[3][3];
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++)
        m[i][k] = w[i][k] + w[(i + 1) % 3][k]; /* the others double, so this is the middle */
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++)
        w[i][k] *= 2;
    if (which == 0) {
      memcpy(w[1], m[0], sizeof *m);
      memcpy(w[2], m[2], sizeof *m);
    } else if (which == 1) {
      memcpy(w[0], m[0], sizeof *m);
      memcpy(w[2], m[1], sizeof *m);
    } else if (which == 2) {
      memcpy(w[0], m[2], sizeof *m);
      memcpy(w[1], m[1], sizeof *m);
    } else {
      memcpy(w[0], m[1], sizeof *m);
      memcpy(w[1], m[2], sizeof *m);
      memcpy(w[2], m[0], sizeof *m);
    }
  }
  memcpy(weights, w, sizeof w);
}

static double attribute(const struct lod_doi_term *term, struct look *look, uint32_t steps) {
  if (term->values_by_triangle)
    return graded((double)term->values[base_of(look)], look, steps);
  uint32_t weights[3][3];
  double values[3] = {0, 0, 0};
  const uint32_t *v = look->r->base.mesh.triangles[base_of(look)];
  face_weights(look->r->lineages[look->face].path, look->copy.level, weights);
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++)
      values[i] += weights[i][k] * (double)term->values[v[k]] / (double)(1u << look->copy.level);
  return graded(gather3(term->gather, values), look, steps);
}

static void fit(struct look *look, struct lod_clough_tocher *patches) {
  lod_clough_tocher_fit(look->p, vertex_normals(look), patches);
}

static double clough_tocher(const struct lod_doi_term *term, struct look *look) {
  struct lod_clough_tocher own, other;
  double values[3] = {0, 0, 0};
  fit(look, &own);
  if (!lod_clough_tocher_one_sided(&own))
    return 2;
  for (int i = 0; i < 3; i++) {
    uint32_t g = neighbour(look->r, &look->copy, i);
    if (g == LOD_NONE || look->r->faces[g].level != look->copy.level)
      continue;
    struct look across = look_at(look->r, g);
    fit(&across, &other);
    double error = lod_clough_tocher_error(&own, i, &other, refine_local(&across.copy, look->copy.e[i]));
    values[i] = term->threshold > 0 ? error / term->threshold : error > 0 ? INFINITY : 0;
  }
  return gather3(term->gather, values);
}

static double term_value(const struct lod_doi_term *term, struct look *look, uint32_t steps) {
  switch (term->kind) {
  case LOD_DOI_UNIFORM:
    return 2;
  case LOD_DOI_FACE_ANGLE:
    return face_angle(term, look);
  case LOD_DOI_RAW_ANGLE:
    return 1 + lod_vec3_dot(look->normal, view_from(&term->view, look->centre)) - term->threshold;
  case LOD_DOI_SILHOUETTE:
    return silhouette(term, look);
  case LOD_DOI_CONE:
    return cone(term, look);
  case LOD_DOI_DIHEDRAL:
    return dihedral(term, look);
  case LOD_DOI_CURVATURE:
    return curvature(term, look);
  case LOD_DOI_SCREEN:
    return screen(term, look);
  case LOD_DOI_FOCUS:
    return focus(term, look, steps);
  case LOD_DOI_GAZE:
    return gaze(term, look);
  case LOD_DOI_ATTRIBUTE:
    return attribute(term, look, steps);
  case LOD_DOI_CLOUGH_TOCHER:
    return clough_tocher(term, look);
  case LOD_DOI_CONTACT:
    return 0; /* lod_refine_run goes its own way */
  }
  return 0;
}

double lod_doi_value(struct lod_refiner *r, const struct lod_doi *doi, const struct lod_refine_limits *limits, uint32_t f) {
  assert(f < r->face_count && r->faces[f].drawn);
  struct look look = look_at(r, f);
  double value = doi->product ? 1 : 0;
  for (uint32_t i = 0; i < doi->term_count; i++) {
    double v = term_value(&doi->terms[i], &look, limits->steps);
    v = v != v ? 0 : v; /* 0 * infinity and the like */
    value = doi->product ? value * v : fmax(value, v);
  }
  return value != value ? 0 : value;
}
