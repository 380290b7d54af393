/* Bezier patches of any degree to triangles. See spline.h; Farin. Curves and Surfaces for Computer Aided Geometric Design. 1993. */
#include "codec/import/spline.h"

#include <math.h>
#include <string.h>

#include "core/clod/tessellate.h"
#include "core/mesh/bvh.h"

enum { TOTAL = 2 * LOD_SPLINE_DEGREE, NET = (TOTAL + 1) * (TOTAL + 2) / 2 };

/* Shares of the diagonal: of triangles from the splines; about, of cubics. */
static const double kTolerance = 2e-4, kChartTolerance = 1e-3;

/* Parts of an edge, or rows of a grid, that are tried. */
static const uint32_t kParts[] = {1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64};
enum { PARTS = sizeof kParts / sizeof kParts[0] };

uint32_t lod_spline_point_count(bool triangle, const uint32_t degree[2]) {
  return triangle ? (degree[0] + 1) * (degree[0] + 2) / 2 : (degree[0] + 1) * (degree[1] + 1);
}

enum lod_status lod_splines_add(struct lod_splines *splines, bool triangle, const uint32_t degree[2], struct lod_spline_point *points,
                                uint64_t line) {
  struct lod_reader *reader = splines->reader;
  if (degree[0] < 1 || degree[1] < 1 || degree[0] > LOD_SPLINE_DEGREE || degree[1] > LOD_SPLINE_DEGREE)
    return lod_reader_fail(reader, LOD_UNSUPPORTED, "patch-degree", "line %llu has a patch of degree %u by %u; degrees 1 to %d are known",
                           (unsigned long long)line, degree[0], degree[1], LOD_SPLINE_DEGREE);
  uint32_t count = lod_spline_point_count(triangle, degree);
  for (uint32_t i = 0; i < count; i++) {
    const struct lod_spline_point *p = &points[i];
    if (!(fabs(p->x) < 1e30 && fabs(p->y) < 1e30 && fabs(p->z) < 1e30))
      return lod_reader_bad(reader, "non-finite", "the patch that ends in line %llu has a coordinate that is not a finite number",
                            (unsigned long long)line);
    if (!(p->w > 1e-12 && p->w < 1e12))
      return lod_reader_bad(reader, "patch-weight", "the patch that ends in line %llu has a weight that is not positive",
                            (unsigned long long)line);
  }
  if (splines->count == splines->room) {
    uint32_t room = 2 * splines->room + 64;
    struct lod_spline_patch *grown = LOD_NEW(reader->scratch, room, struct lod_spline_patch);
    if (!grown)
      return lod_reader_memory(reader);
    if (splines->count > 0)
      memcpy(grown, splines->patches, splines->count * sizeof *grown);
    splines->patches = grown;
    splines->room = room;
  }
  splines->patches[splines->count++] = (struct lod_spline_patch){triangle, {degree[0], degree[1]}, points};
  splines->points += count;
  return lod_reader_add_vertices(reader, 0);
}

/* ---- homogeneous points ---- */

static struct lod_spline_point mix2(struct lod_spline_point a, struct lod_spline_point b, double t) {
  double s = 1 - t;
  return (struct lod_spline_point){s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z, s * a.w + t * b.w};
}

static struct lod_vec3 project(struct lod_spline_point p) {
  return p.w == 1 ? (struct lod_vec3){p.x, p.y, p.z} : (struct lod_vec3){p.x / p.w, p.y / p.w, p.z / p.w};
}

/* ---- curves ---- */

struct curve {
  uint32_t degree;
  struct lod_spline_point p[TOTAL + 1];
};

static int compare_points(const struct lod_spline_point *a, const struct lod_spline_point *b) {
  const double x[4] = {a->x, a->y, a->z, a->w}, y[4] = {b->x, b->y, b->z, b->w};
  for (int i = 0; i < 4; i++)
    if (x[i] != y[i])
      return x[i] < y[i] ? -1 : 1;
  return 0;
}

/* Whether the curve is to be seen from its other end: both patches of an edge then see the same. */
static bool runs_back(const struct curve *curve) {
  for (uint32_t i = 0; i <= curve->degree / 2; i++) {
    int order = compare_points(&curve->p[i], &curve->p[curve->degree - i]);
    if (order != 0)
      return order > 0;
  }
  return false;
}

static struct lod_spline_point curve_blossom(const struct curve *curve, double a, uint32_t times_a, double b) {
  struct lod_spline_point p[TOTAL + 1];
  memcpy(p, curve->p, (curve->degree + 1) * sizeof *p);
  for (uint32_t r = 0; r < curve->degree; r++)
    for (uint32_t i = 0; i + r < curve->degree; i++)
      p[i] = mix2(p[i], p[i + 1], r < times_a ? a : b);
  return p[0];
}

/* All control points of a part within e of its chord prove the curve within e of the chord, and, the ends being the same, the chord within
 * e of the curve. */
static double curve_bound(const struct curve *curve, double from, double to) {
  struct lod_vec3 a = project(curve_blossom(curve, from, curve->degree, from)), b = project(curve_blossom(curve, to, curve->degree, to));
  struct lod_vec3 chord = lod_vec3_subtract(b, a);
  double length = lod_vec3_length_squared(chord), worst = 0;
  for (uint32_t i = 1; i < curve->degree; i++) {
    struct lod_vec3 p = project(curve_blossom(curve, from, curve->degree - i, to));
    double t = length > 0 ? lod_vec3_dot(lod_vec3_subtract(p, a), chord) / length : 0;
    worst = fmax(worst, lod_vec3_distance(p, lod_vec3_add_scaled(a, chord, fmin(fmax(t, 0), 1))));
  }
  return worst;
}

/* Least number of parts within the tolerance; both patches of an edge find the same. */
static uint32_t curve_parts(const struct curve *curve, double tolerance) {
  for (uint32_t k = 0; k + 1 < PARTS; k++) {
    bool good = true;
    for (uint32_t i = 0; i < kParts[k] && good; i++)
      good = curve_bound(curve, (double)i / kParts[k], (double)(i + 1) / kParts[k]) <= tolerance;
    if (good)
      return kParts[k];
  }
  return kParts[PARTS - 1];
}

/* ---- triangular nets: row i has degree + 1 - i points; i, j, k with k = degree - i - j are exponents of the corners at the far end of
 * rows, at the end of the first row, and at its beginning ---- */

struct net {
  uint32_t degree;
  struct lod_spline_point p[NET];
};

static uint32_t net_index(uint32_t degree, uint32_t i, uint32_t j) {
  return i * (2 * degree + 3 - i) / 2 + j;
}

/* One de Casteljau step at (u, v, w) for corners (i, j, k): degree falls by one. */
static void net_step(struct lod_spline_point *p, uint32_t degree, struct lod_barycentric at) {
  uint32_t next = 0;
  for (uint32_t i = 0; i < degree; i++)
    for (uint32_t j = 0; i + j < degree; j++) {
      const struct lod_spline_point a = p[net_index(degree, i + 1, j)], b = p[net_index(degree, i, j + 1)], c = p[net_index(degree, i, j)];
      p[next++] = (struct lod_spline_point){at.u * a.x + at.v * b.x + at.w * c.x, at.u * a.y + at.v * b.y + at.w * c.y,
                                            at.u * a.z + at.v * b.z + at.w * c.z, at.u * a.w + at.v * b.w + at.w * c.w};
    }
}

static struct lod_vec3 net_point(const struct net *net, struct lod_barycentric at) {
  struct lod_spline_point p[NET];
  memcpy(p, net->p, (net->degree + 1) * (net->degree + 2) / 2 * sizeof *p);
  for (uint32_t d = net->degree; d > 0; d--)
    net_step(p, d, at);
  return project(p[0]);
}

/* How far the part over a domain triangle and the flat triangle are from one another, both ways. Either by corresponding points: the
 * largest distance of a control point from the flat triangle's. Or as sets: where all control points are within e of the flat triangle, so
 * is the part. Its nearest points on the triangle, a continuous image of it, cover all that is farther than e from the triangle's sides,
 * and a side, having the ends of the part's edge, is within e of it: so the triangle is within 2 e of the part. */
static double net_bound(const struct net *net, const struct lod_barycentric at[3], const struct lod_vec3 flat[3]) {
  uint32_t degree = net->degree, size = (degree + 1) * (degree + 2) / 2;
  struct lod_spline_point first[NET], second[NET], third[NET];
  double worst = 0, apart = 0;
  memcpy(first, net->p, size * sizeof *first);
  for (uint32_t a = 0; a <= degree; a++) {
    if (a > 0)
      net_step(first, degree - a + 1, at[0]);
    uint32_t left = degree - a;
    memcpy(second, first, (left + 1) * (left + 2) / 2 * sizeof *second);
    for (uint32_t b = 0; b <= left; b++) {
      if (b > 0)
        net_step(second, left - b + 1, at[1]);
      uint32_t rest = left - b;
      memcpy(third, second, (rest + 1) * (rest + 2) / 2 * sizeof *third);
      for (uint32_t d = rest; d > 0; d--)
        net_step(third, d, at[2]);
      double x = (double)a / degree, y = (double)b / degree, z = (double)rest / degree;
      struct lod_vec3 q = lod_vec3_add_scaled(lod_vec3_add_scaled(lod_vec3_scale(flat[0], x), flat[1], y), flat[2], z);
      struct lod_vec3 p = project(third[0]);
      worst = fmax(worst, lod_vec3_distance(p, q));
      apart = fmax(apart, lod_vec3_distance(p, lod_closest_on_triangle(p, flat[0], flat[1], flat[2])));
    }
  }
  return fmin(worst, 2 * apart);
}

static double choose(uint32_t n, uint32_t k) {
  double c = 1;
  for (uint32_t i = 0; i < k; i++)
    c = c * (n - i) / (i + 1);
  return c;
}

/* The half of a tensor patch with the corners (0, 0), (1, 0), (0, 1), or (1, 1), (0, 1), (1, 0), as a net of the total degree with its far
 * corner, second and first being these. Exact: the mean of the polar form over all ways to share its arguments among both degrees. */
static void half_of_tensor(const struct lod_spline_patch *patch, bool second, struct net *net) {
  uint32_t m = patch->degree[0], n = patch->degree[1], degree = m + n;
  net->degree = degree;
  double ways = choose(degree, m);
  for (uint32_t i = 0; i <= degree; i++)
    for (uint32_t j = 0; i + j <= degree; j++) {
      uint32_t k = degree - i - j;
      struct lod_spline_point sum = {0, 0, 0, 0};
      for (uint32_t i1 = 0; i1 <= i && i1 <= m; i1++)
        for (uint32_t j1 = 0; j1 <= j && i1 + j1 <= m; j1++) {
          uint32_t k1 = m - i1 - j1;
          if (k1 > k)
            continue;
          /* Arguments that are 1, in the first and in the second variable. */
          uint32_t s = second ? i1 + k1 : j1, t = second ? (i - i1) + (j - j1) : k - k1;
          double weight = choose(i, i1) * choose(j, j1) * choose(k, k1) / ways;
          const struct lod_spline_point *p = &patch->points[s * (n + 1) + t];
          sum = (struct lod_spline_point){sum.x + weight * p->x, sum.y + weight * p->y, sum.z + weight * p->z, sum.w + weight * p->w};
        }
      net->p[net_index(degree, i, j)] = sum;
    }
}

/* ---- patches to triangles ---- */

struct cutting {
  struct lod_reader *reader;
  struct lod_arena *arena; /* of one patch */
  struct lod_mesh mesh;
  uint32_t vertex_room, triangle_room;
  double tolerance, deviation;
  double rounding; /* squared */
  struct lod_charts charts;
  uint32_t chart_room;
  bool no_charts; /* a patch has none: none are told */
};

/* How the net that is being cut lies in its chart. */
struct placing {
  bool pole, second; /* pole: the chart is the whole tensor patch, of which this is half */
  uint32_t chart;
};

/* Barycentric coordinates in the chart. Of a patch one side of which is a point, s from 0 to 1 along that side and t away from it: the
 * point has 1 - t. */
static void place(const struct placing *placing, struct lod_barycentric at, float out[3]) {
  double s = placing->second ? 1 - at.v : at.v, t = placing->second ? 1 - at.w : at.w;
  const double chart[3] = {placing->pole ? 1 - t : at.u, placing->pole ? t * s : at.v, placing->pole ? t * (1 - s) : at.w};
  for (int k = 0; k < 3; k++)
    out[k] = (float)chart[k];
}

static enum lod_status grow(struct cutting *c, uint32_t vertices, uint32_t triangles) {
  struct lod_mesh *mesh = &c->mesh;
  if (mesh->vertex_count + vertices > c->vertex_room) {
    uint32_t room = 2 * c->vertex_room + vertices + 1024;
    float(*positions)[3] = lod_arena_alloc(c->reader->scratch, room, sizeof *positions);
    if (!positions)
      return lod_reader_memory(c->reader);
    if (mesh->vertex_count > 0)
      memcpy(positions, mesh->positions, mesh->vertex_count * sizeof *positions);
    mesh->positions = positions;
    c->vertex_room = room;
  }
  if (mesh->triangle_count + triangles > c->triangle_room) {
    uint32_t room = 2 * c->triangle_room + triangles + 1024;
    uint32_t(*list)[3] = lod_arena_alloc(c->reader->scratch, room, sizeof *list);
    if (!list)
      return lod_reader_memory(c->reader);
    if (mesh->triangle_count > 0)
      memcpy(list, mesh->triangles, mesh->triangle_count * sizeof *list);
    uint32_t *of = LOD_NEW(c->reader->scratch, room, uint32_t);
    float(*at)[3][3] = lod_arena_alloc(c->reader->scratch, room, sizeof *at);
    if (!of || !at)
      return lod_reader_memory(c->reader);
    if (mesh->triangle_count > 0) {
      memcpy(of, c->charts.of, mesh->triangle_count * sizeof *of);
      memcpy(at, c->charts.at, mesh->triangle_count * sizeof *at);
    }
    mesh->triangles = list;
    c->charts.of = of;
    c->charts.at = at;
    c->triangle_room = room;
  }
  return LOD_OK;
}

static enum lod_status add_chart(struct cutting *c, const struct lod_bezier *net, uint32_t *number) {
  if (c->charts.count == c->chart_room) {
    uint32_t room = 2 * c->chart_room + 64;
    double(*nets)[10][3] = lod_arena_alloc(c->reader->scratch, room, sizeof *nets);
    if (!nets)
      return lod_reader_memory(c->reader);
    if (c->charts.count > 0)
      memcpy(nets, c->charts.nets, c->charts.count * sizeof *nets);
    c->charts.nets = nets;
    c->chart_room = room;
  }
  *number = c->charts.count++;
  for (int i = 0; i < LOD_BEZIER_POINTS; i++) {
    const double p[3] = {net->p[i].x, net->p[i].y, net->p[i].z};
    memcpy(c->charts.nets[*number][i], p, sizeof p);
  }
  return LOD_OK;
}

static uint32_t add_vertex(struct cutting *c, struct lod_vec3 p) {
  float *out = c->mesh.positions[c->mesh.vertex_count];
  lod_vec3_to_float(p, out);
  c->rounding = fmax(c->rounding, lod_vec3_distance_squared(p, lod_vec3_from_float(out)));
  return c->mesh.vertex_count++;
}

/* An edge of a patch: its curve as both of its users see it, and its vertices in the patch's direction. */
struct edge {
  struct curve curve;
  uint32_t parts;
  bool back, point; /* point: all of it is one */
};

static void make_edge(struct edge *edge, double tolerance) {
  edge->back = runs_back(&edge->curve);
  if (edge->back)
    for (uint32_t i = 0; i <= edge->curve.degree / 2; i++) {
      struct lod_spline_point p = edge->curve.p[i];
      edge->curve.p[i] = edge->curve.p[edge->curve.degree - i];
      edge->curve.p[edge->curve.degree - i] = p;
    }
  edge->point = true;
  for (uint32_t i = 1; i <= edge->curve.degree; i++)
    edge->point = edge->point && lod_vec3_distance(project(edge->curve.p[i]), project(edge->curve.p[0])) == 0;
  edge->parts = edge->point ? 1 : curve_parts(&edge->curve, tolerance);
}

/* Point i of the edge in the direction of its user. */
static struct lod_vec3 edge_point(const struct edge *edge, uint32_t i) {
  uint32_t at = edge->back ? edge->parts - i : i;
  if (edge->point)
    return project(edge->curve.p[0]);
  if (at == 0 || at == edge->parts)
    return project(edge->curve.p[at == 0 ? 0 : edge->curve.degree]);
  double t = (double)at / edge->parts;
  return project(curve_blossom(&edge->curve, t, edge->curve.degree, t));
}

static bool same_position(const float *a, const float *b) {
  return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Cuts one triangular net. edges[k]: from corner k to k + 1, in that direction or, where reversed[k], against it. Corners 0, 1, 2 are the
 * net's far corner, the end of its first row, and its beginning. */
static enum lod_status cut_net(struct cutting *c, const struct net *net, const struct edge *const edges[3], const bool reversed[3],
                               const struct placing *placing) {
  uint32_t factors[3], largest = 1;
  for (int k = 0; k < 3; k++) {
    factors[k] = edges[k]->parts;
    largest = factors[k] > largest ? factors[k] : largest;
  }
  for (uint32_t trial = 0; trial < PARTS; trial++) {
    uint32_t m = kParts[trial];
    if (m < 3 && largest > m)
      continue;
    for (int k = 0; k < 3; k++)
      if (edges[k]->point) /* the surface turns around it: each row needs its own */
        factors[k] = m;
    struct lod_tessellation_pattern pattern;
    if (lod_tessellation_pattern_make(m, factors, c->arena, &pattern) != LOD_OK)
      return lod_reader_memory(c->reader);
    struct lod_vec3 *points = LOD_NEW(c->arena, pattern.vertex_count, struct lod_vec3);
    if (!points)
      return lod_reader_memory(c->reader);
    for (uint32_t k = 0; k < 3; k++)
      for (uint32_t i = 0; i < factors[k]; i++)
        points[i == 0 ? k : pattern.edge_vertices[k] + i - 1] = edge_point(edges[k], reversed[k] ? factors[k] - i : i);
    for (uint32_t v = pattern.inner_vertices; v < pattern.vertex_count; v++)
      points[v] = net_point(net, pattern.domain[v]);
    double worst = 0;
    for (uint32_t t = 0; t < pattern.triangle_count && (worst <= c->tolerance || trial + 1 == PARTS); t++) {
      struct lod_barycentric at[3];
      struct lod_vec3 flat[3];
      for (int k = 0; k < 3; k++) {
        at[k] = pattern.domain[pattern.triangles[t][k]];
        flat[k] = points[pattern.triangles[t][k]];
      }
      worst = fmax(worst, net_bound(net, at, flat));
    }
    if (worst > c->tolerance && trial + 1 < PARTS)
      continue;
    c->deviation = fmax(c->deviation, worst);
    LOD_TRY(lod_reader_add_triangles(c->reader, pattern.triangle_count));
    LOD_TRY(grow(c, pattern.vertex_count, pattern.triangle_count));
    uint32_t first = c->mesh.vertex_count;
    for (uint32_t v = 0; v < pattern.vertex_count; v++)
      add_vertex(c, points[v]);
    for (uint32_t t = 0; t < pattern.triangle_count; t++) {
      const float *p[3];
      for (int k = 0; k < 3; k++)
        p[k] = c->mesh.positions[first + pattern.triangles[t][k]];
      if (same_position(p[0], p[1]) || same_position(p[1], p[2]) || same_position(p[2], p[0]))
        continue; /* at a collapsed edge */
      for (int k = 0; k < 3; k++) {
        c->mesh.triangles[c->mesh.triangle_count][k] = first + pattern.triangles[t][k];
        place(placing, pattern.domain[pattern.triangles[t][k]], c->charts.at[c->mesh.triangle_count][k]);
      }
      c->charts.of[c->mesh.triangle_count] = placing->chart;
      c->mesh.triangle_count++;
    }
    return LOD_OK;
  }
  return LOD_OK;
}

/* ---- cubics near a patch ---- */

/* The cubic with the curve's ends and end tangents: the curve itself where it is a cubic or less. */
static struct lod_bezier_curve cubic_near(const struct curve *curve) {
  uint32_t d = curve->degree;
  struct lod_vec3 a = project(curve->p[0]), b = project(curve->p[d]);
  struct lod_vec3 da = lod_vec3_subtract(project(curve->p[1]), a), db = lod_vec3_subtract(project(curve->p[d - 1]), b);
  return (struct lod_bezier_curve){{a, lod_vec3_add_scaled(a, da, d / 3.0 * curve->p[1].w / curve->p[0].w),
                                    lod_vec3_add_scaled(b, db, d / 3.0 * curve->p[d - 1].w / curve->p[d].w), b}};
}

static double farthest(const struct curve *curve, const struct lod_bezier_curve *cubic) {
  enum { SAMPLES = 16 };
  double worst = 0;
  for (int i = 1; i < SAMPLES; i++) {
    double t = (double)i / SAMPLES;
    worst = fmax(worst, lod_vec3_distance(project(curve_blossom(curve, t, curve->degree, t)), lod_bezier_curve_point(cubic, t)));
  }
  return worst;
}

/* The patch turned by a quarter: what ran by the first variable runs by the second. */
static struct lod_spline_patch turned(const struct lod_spline_patch *patch, struct lod_spline_point *points) {
  uint32_t m = patch->degree[0], n = patch->degree[1];
  for (uint32_t s = 0; s <= n; s++)
    for (uint32_t t = 0; t <= m; t++)
      points[s * (m + 1) + t] = patch->points[(m - t) * (n + 1) + s];
  return (struct lod_spline_patch){false, {n, m}, points};
}

struct tensor {
  struct lod_spline_patch patch;
  struct net nets[2];
  struct curve curves[5]; /* sides t = 0, s = 1, t = 1, s = 0, each by its rising variable; the diagonal from (1, 0) to (0, 1) */
  struct lod_bezier_curve diagonal;
  double diagonal_error;
  bool collapsed[4];
};

/* The cubic for the diagonal: with its end tangents (P10 + P01 - P00 and the like), or as Gopi and Manocha 1998, 5.2, have it, each control
 * point that of an isoparametric curve; the better one. */
static void choose_diagonal(struct tensor *tensor) {
  const struct lod_spline_patch *patch = &tensor->patch;
  tensor->diagonal = cubic_near(&tensor->curves[4]);
  tensor->diagonal_error = farthest(&tensor->curves[4], &tensor->diagonal);
  if (patch->degree[0] != 3 || patch->degree[1] != 3)
    return;
  struct lod_bezier_curve iso;
  for (uint32_t i = 0; i < 4; i++) { /* along the diagonal the second variable falls as the first does not */
    struct curve row = {.degree = 3};
    memcpy(row.p, patch->points + 4 * (3 - i), 4 * sizeof *row.p);
    iso.p[i] = project(curve_blossom(&row, i / 3.0, 3, i / 3.0));
  }
  double error = farthest(&tensor->curves[4], &iso);
  if (error < tensor->diagonal_error) {
    tensor->diagonal = iso;
    tensor->diagonal_error = error;
  }
}

static void make_tensor(const struct lod_spline_patch *patch, struct tensor *tensor) {
  uint32_t m = patch->degree[0], n = patch->degree[1];
  tensor->patch = *patch;
  half_of_tensor(patch, false, &tensor->nets[0]);
  half_of_tensor(patch, true, &tensor->nets[1]);
  for (int e = 0; e < 4; e++)
    tensor->curves[e].degree = e % 2 == 0 ? m : n;
  for (uint32_t s = 0; s <= m; s++) {
    tensor->curves[0].p[s] = patch->points[s * (n + 1)];
    tensor->curves[2].p[s] = patch->points[s * (n + 1) + n];
  }
  for (uint32_t t = 0; t <= n; t++) {
    tensor->curves[1].p[t] = patch->points[m * (n + 1) + t];
    tensor->curves[3].p[t] = patch->points[t];
  }
  tensor->curves[4].degree = m + n;
  for (uint32_t j = 0; j <= m + n; j++) /* far corner exponent 0: row 0, from (0, 1) to (1, 0) */
    tensor->curves[4].p[m + n - j] = tensor->nets[0].p[net_index(m + n, 0, j)];
  for (int e = 0; e < 4; e++) {
    tensor->collapsed[e] = true;
    for (uint32_t i = 1; i <= tensor->curves[e].degree; i++)
      tensor->collapsed[e] =
          tensor->collapsed[e] && lod_vec3_distance(project(tensor->curves[e].p[i]), project(tensor->curves[e].p[0])) == 0;
  }
  choose_diagonal(tensor);
}

static struct lod_bezier_curve backwards(struct lod_bezier_curve c) {
  return (struct lod_bezier_curve){{c.p[3], c.p[2], c.p[1], c.p[0]}};
}

/* The net with these sides, the centre by the rule for quadratics. */
static struct lod_bezier net_of_sides(struct lod_bezier_curve a, struct lod_bezier_curve b, struct lod_bezier_curve c) {
  struct lod_bezier net = {{a.p[0], b.p[0], c.p[0], a.p[1], a.p[2], b.p[1], b.p[2], c.p[1], c.p[2], a.p[0]}};
  lod_bezier_set_centre(&net);
  return net;
}

/* Charts of a tensor patch: its halves, or itself where the side t = 0 is a point. */
static enum lod_status chart_tensor(struct cutting *c, const struct tensor *tensor, struct placing placings[2]) {
  struct lod_bezier_curve sides[4];
  for (int e = 0; e < 4; e++)
    sides[e] = cubic_near(&tensor->curves[e]);
  if (tensor->collapsed[0]) { /* the point, (1, 1), (0, 1) */
    struct lod_bezier net = net_of_sides(sides[1], backwards(sides[2]), backwards(sides[3]));
    LOD_TRY(add_chart(c, &net, &placings[0].chart));
    placings[1] = (struct placing){.pole = true, .second = true, .chart = placings[0].chart};
    placings[0].pole = true;
    return LOD_OK;
  }
  struct lod_bezier first = net_of_sides(sides[0], tensor->diagonal, backwards(sides[3]));
  struct lod_bezier second = net_of_sides(backwards(sides[2]), backwards(tensor->diagonal), sides[1]);
  LOD_TRY(add_chart(c, &first, &placings[0].chart));
  return add_chart(c, &second, &placings[1].chart);
}

static enum lod_status cut_tensor(struct cutting *c, const struct lod_spline_patch *patch) {
  struct tensor *tensors = LOD_NEW_ZERO(c->arena, 2, struct tensor), *best = &tensors[0];
  struct edge *edges = LOD_NEW(c->arena, 5, struct edge);
  struct lod_spline_point *points = LOD_NEW(c->arena, 2 * (size_t)lod_spline_point_count(false, patch->degree), struct lod_spline_point);
  if (!tensors || !edges || !points)
    return lod_reader_memory(c->reader);
  make_tensor(patch, &tensors[0]);
  uint32_t collapsed = 0;
  for (int e = 0; e < 4; e++)
    collapsed += tensors[0].collapsed[e];
  if (collapsed > 1)
    c->no_charts = true;
  struct lod_spline_patch other = *patch;
  for (int turn = 0; turn < 3 && (collapsed == 1 ? !best->collapsed[0] : turn < 1); turn++) {
    /* The other diagonal, or until the point is where it is looked for. */
    other = turned(&other, points + (turn % 2) * lod_spline_point_count(false, patch->degree));
    make_tensor(&other, &tensors[1]);
    if (collapsed == 1 || tensors[1].diagonal_error < tensors[0].diagonal_error)
      best = &tensors[1];
  }
  for (int e = 0; e < 5; e++) {
    edges[e].curve = best->curves[e];
    make_edge(&edges[e], 0.4 * c->tolerance);
  }
  struct placing placings[2] = {{0}};
  LOD_TRY(chart_tensor(c, best, placings));
  const struct edge *first[3] = {&edges[0], &edges[4], &edges[3]}, *second[3] = {&edges[2], &edges[4], &edges[1]};
  /* (0,0)-(1,0), (1,0)-(0,1), (0,1)-(0,0); (1,1)-(0,1), (0,1)-(1,0), (1,0)-(1,1). */
  static const bool kFirst[3] = {false, false, true}, kSecond[3] = {true, true, false};
  LOD_TRY(cut_net(c, &best->nets[0], first, kFirst, &placings[0]));
  return cut_net(c, &best->nets[1], second, kSecond, &placings[1]);
}

static enum lod_status cut_triangle(struct cutting *c, const struct lod_spline_patch *patch) {
  uint32_t d = patch->degree[0];
  struct net *net = LOD_NEW(c->arena, 1, struct net);
  struct edge *edges = LOD_NEW(c->arena, 3, struct edge);
  if (!net || !edges)
    return lod_reader_memory(c->reader);
  net->degree = d;
  memcpy(net->p, patch->points, (d + 1) * (d + 2) / 2 * sizeof *net->p);
  for (uint32_t i = 0; i <= d; i++) { /* far corner to end of the first row, that to its beginning, that to the far corner */
    edges[0].curve.p[i] = net->p[net_index(d, d - i, i)];
    edges[1].curve.p[i] = net->p[net_index(d, 0, d - i)];
    edges[2].curve.p[i] = net->p[net_index(d, i, 0)];
  }
  struct lod_bezier_curve sides[3];
  for (int k = 0; k < 3; k++) {
    edges[k].curve.degree = d;
    sides[k] = cubic_near(&edges[k].curve);
    make_edge(&edges[k], 0.4 * c->tolerance);
    c->no_charts = c->no_charts || edges[k].point;
  }
  struct lod_bezier cubic = net_of_sides(sides[0], sides[1], sides[2]);
  if (d == 3) /* its own centre, exactly */
    cubic.p[LOD_BEZIER_CENTRE] = project(net->p[net_index(3, 1, 1)]);
  struct placing placing = {0};
  LOD_TRY(add_chart(c, &cubic, &placing.chart));
  const struct edge *list[3] = {&edges[0], &edges[1], &edges[2]};
  static const bool kNone[3] = {false, false, false};
  return cut_net(c, net, list, kNone, &placing);
}

/* ---- finer charts ---- */

/* How far cubic charts are from a tensor patch at corresponding points, about: sampled, and only used to choose. */
static double chart_error(const struct tensor *tensor) {
  enum { SIDE = 4 };
  double worst = tensor->diagonal_error;
  struct lod_bezier_curve sides[4];
  for (int e = 0; e < 4; e++) {
    sides[e] = cubic_near(&tensor->curves[e]);
    worst = fmax(worst, farthest(&tensor->curves[e], &sides[e]));
  }
  struct lod_bezier cubics[2] = {net_of_sides(sides[0], tensor->diagonal, backwards(sides[3])),
                                 net_of_sides(backwards(sides[2]), backwards(tensor->diagonal), sides[1])};
  for (int h = 0; h < 2; h++) {
    struct lod_barycentric middle = {1.0 / 3, 1.0 / 3, 1.0 / 3};
    struct lod_vec3 off = lod_vec3_subtract(net_point(&tensor->nets[h], middle), lod_bezier_point(&cubics[h], middle));
    cubics[h].p[LOD_BEZIER_CENTRE] = lod_vec3_add_scaled(cubics[h].p[LOD_BEZIER_CENTRE], off, 4.5); /* meets the patch there */
    for (int i = 1; i < SIDE; i++)
      for (int j = 1; i + j < SIDE; j++) {
        struct lod_barycentric at = {(double)(SIDE - i - j) / SIDE, (double)i / SIDE, (double)j / SIDE};
        worst = fmax(worst, lod_vec3_distance(net_point(&tensor->nets[h], at), lod_bezier_point(&cubics[h], at)));
      }
  }
  return worst;
}

/* Both halves of rows of `count` control points, `stride` apart, by de Casteljau in the middle. Halves are the same from either end. */
static void halve_row(const struct lod_spline_point *row, uint32_t count, uint32_t stride, struct lod_spline_point *low,
                      struct lod_spline_point *high) {
  struct lod_spline_point p[LOD_SPLINE_DEGREE + 1];
  for (uint32_t i = 0; i < count; i++)
    p[i] = row[i * stride];
  for (uint32_t r = 0; r < count; r++) {
    low[r * stride] = p[0];
    high[(count - 1 - r) * stride] = p[count - 1 - r];
    for (uint32_t i = 0; i + r + 1 < count; i++)
      p[i] = mix2(p[i], p[i + 1], 0.5);
  }
}

/* Replaces every tensor patch by its four quarters. All at once, so that neighbours still match. */
static enum lod_status quarter_all(struct lod_splines *splines) {
  struct lod_arena *arena = splines->reader->scratch;
  struct lod_spline_patch *quarters = LOD_NEW(arena, 4 * (size_t)splines->count, struct lod_spline_patch);
  if (!quarters)
    return lod_reader_memory(splines->reader);
  for (uint32_t p = 0; p < splines->count; p++) {
    const struct lod_spline_patch *patch = &splines->patches[p];
    uint32_t rows = patch->degree[0] + 1, columns = patch->degree[1] + 1, count = rows * columns;
    struct lod_spline_point *points = LOD_NEW(arena, 6 * (size_t)count, struct lod_spline_point);
    if (!points)
      return lod_reader_memory(splines->reader);
    for (uint32_t c = 0; c < columns; c++) /* by the first variable */
      halve_row(patch->points + c, rows, columns, points + c, points + count + c);
    for (uint32_t half = 0; half < 2; half++) {
      for (uint32_t r = 0; r < rows; r++)
        halve_row(points + half * count + r * columns, columns, 1, points + (2 + 2 * half) * count + r * columns,
                  points + (3 + 2 * half) * count + r * columns);
      for (uint32_t k = 0; k < 2; k++)
        quarters[4 * p + 2 * half + k] =
            (struct lod_spline_patch){.degree = {patch->degree[0], patch->degree[1]}, .points = points + (2 + 2 * half + k) * count};
    }
  }
  splines->patches = quarters;
  splines->count *= 4;
  splines->room = splines->count;
  return LOD_OK;
}

/* Quarters the patches until cubics are near enough (Gopi & Manocha 1998, 5.2), at most twice. */
static enum lod_status refine_charts(struct lod_splines *splines, double tolerance) {
  enum { TIMES = 2, MOST = 1 << 11 }; /* more patches are many enough */
  struct tensor *tensor = LOD_NEW(splines->reader->scratch, 1, struct tensor);
  if (!tensor)
    return lod_reader_memory(splines->reader);
  for (int time = 0; time < TIMES && splines->count <= MOST; time++) {
    double worst = 0;
    for (uint32_t p = 0; p < splines->count; p++) {
      if (splines->patches[p].triangle)
        return LOD_OK; /* a file of triangles, or of both, stays as it is */
      make_tensor(&splines->patches[p], tensor);
      if (!tensor->collapsed[0] && !tensor->collapsed[1] && !tensor->collapsed[2] && !tensor->collapsed[3])
        worst = fmax(worst, chart_error(tensor));
    }
    if (worst <= tolerance)
      return LOD_OK;
    LOD_TRY(quarter_all(splines));
  }
  return LOD_OK;
}

static double diagonal_of(const struct lod_splines *splines) {
  double min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY}, sum = 0;
  for (uint32_t p = 0; p < splines->count; p++) {
    const struct lod_spline_patch *patch = &splines->patches[p];
    for (uint32_t i = 0; i < lod_spline_point_count(patch->triangle, patch->degree); i++) {
      struct lod_vec3 at = project(patch->points[i]);
      double x[3] = {at.x, at.y, at.z};
      for (int axis = 0; axis < 3; axis++) {
        min[axis] = fmin(min[axis], x[axis]);
        max[axis] = fmax(max[axis], x[axis]);
      }
    }
  }
  for (int axis = 0; axis < 3; axis++)
    sum += (max[axis] - min[axis]) * (max[axis] - min[axis]);
  return sqrt(sum);
}

enum lod_status lod_splines_finish(struct lod_splines *splines) {
  struct lod_reader *reader = splines->reader;
  if (splines->count == 0)
    return lod_reader_bad(reader, "empty", "the file has no patches");
  double diagonal = diagonal_of(splines);
  struct cutting c = {.reader = reader, .tolerance = fmax(kTolerance * diagonal, 1e-30)};
  uint32_t given = splines->count, counted = 0;
  LOD_TRY(refine_charts(splines, kChartTolerance * diagonal));
  for (uint32_t p = 0; p < splines->count; p++) {
    c.arena = lod_arena_create_child(reader->scratch);
    if (!c.arena)
      return lod_reader_memory(reader);
    enum lod_status status = splines->patches[p].triangle ? cut_triangle(&c, &splines->patches[p]) : cut_tensor(&c, &splines->patches[p]);
    lod_arena_destroy(c.arena);
    LOD_TRY(status);
    LOD_TRY(lod_reader_add_vertices(reader, c.mesh.vertex_count - counted)); /* before all patches are cut: a limit saves the rest */
    counted = c.mesh.vertex_count;
    if (p % 64 == 0)
      LOD_TRY(lod_reader_progress(reader, 0.4 * p / splines->count));
  }
  reader->source_vertices = splines->points;
  /* Arithmetic of some hundred roundings of coordinates no larger than the control points'. */
  double magnitude = lod_mesh_magnitude(&c.mesh);
  struct lod_charts *charts = lod_arena_copy(reader->scratch, &c.charts, sizeof c.charts);
  if (!charts)
    return lod_reader_memory(reader);
  struct lod_scene_part part = {
      .mesh = c.mesh, .rounding = c.deviation + sqrt(c.rounding) + 1024 * 0x1p-53 * magnitude, .charts = c.no_charts ? NULL : charts};
  lod_scene_warn(reader->scene, "%u patches were cut into %u triangles, within %.3g of them: part of every error.", given,
                 c.mesh.triangle_count, c.deviation);
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}
