/* Bezier patches of any degree to triangles. See spline.h; Farin. Curves and Surfaces for Computer Aided Geometric Design. 1993. */
#include "codec/import/spline.h"

#include <math.h>
#include <string.h>

#include "core/clod/tessellate.h"
#include "core/mesh/bvh.h"

enum { TOTAL = 2 * LOD_SPLINE_DEGREE, NET = (TOTAL + 1) * (TOTAL + 2) / 2 };

/* Share of the diagonal. */
static const double kTolerance = 2e-4;

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
};

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
    mesh->triangles = list;
    c->triangle_room = room;
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
  bool back;
};

static void make_edge(struct edge *edge, double tolerance) {
  edge->back = runs_back(&edge->curve);
  if (edge->back)
    for (uint32_t i = 0; i <= edge->curve.degree / 2; i++) {
      struct lod_spline_point p = edge->curve.p[i];
      edge->curve.p[i] = edge->curve.p[edge->curve.degree - i];
      edge->curve.p[edge->curve.degree - i] = p;
    }
  edge->parts = curve_parts(&edge->curve, tolerance);
}

/* Point i of the edge in the direction of its user. */
static struct lod_vec3 edge_point(const struct edge *edge, uint32_t i) {
  uint32_t at = edge->back ? edge->parts - i : i;
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
static enum lod_status cut_net(struct cutting *c, const struct net *net, const struct edge *const edges[3], const bool reversed[3]) {
  uint32_t factors[3], largest = 1;
  for (int k = 0; k < 3; k++) {
    factors[k] = edges[k]->parts;
    largest = factors[k] > largest ? factors[k] : largest;
  }
  for (uint32_t trial = 0; trial < PARTS; trial++) {
    uint32_t m = kParts[trial];
    if (m < 3 && largest > m)
      continue;
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
      for (int k = 0; k < 3; k++)
        c->mesh.triangles[c->mesh.triangle_count][k] = first + pattern.triangles[t][k];
      c->mesh.triangle_count++;
    }
    return LOD_OK;
  }
  return LOD_OK;
}

static enum lod_status cut_tensor(struct cutting *c, const struct lod_spline_patch *patch) {
  uint32_t m = patch->degree[0], n = patch->degree[1];
  struct net *nets = LOD_NEW(c->arena, 2, struct net);
  struct edge *edges = LOD_NEW(c->arena, 5, struct edge);
  if (!nets || !edges)
    return lod_reader_memory(c->reader);
  half_of_tensor(patch, false, &nets[0]);
  half_of_tensor(patch, true, &nets[1]);
  /* Sides: second variable 0, first 1, second 1, first 0, each by its rising variable; then the diagonal from (1, 0) to (0, 1). */
  for (int e = 0; e < 4; e++)
    edges[e].curve.degree = e % 2 == 0 ? m : n;
  for (uint32_t s = 0; s <= m; s++) {
    edges[0].curve.p[s] = patch->points[s * (n + 1)];
    edges[2].curve.p[s] = patch->points[s * (n + 1) + n];
  }
  for (uint32_t t = 0; t <= n; t++) {
    edges[1].curve.p[t] = patch->points[m * (n + 1) + t];
    edges[3].curve.p[t] = patch->points[t];
  }
  edges[4].curve.degree = m + n;
  for (uint32_t j = 0; j <= m + n; j++) /* far corner exponent 0: row 0, from (0, 1) to (1, 0) */
    edges[4].curve.p[m + n - j] = nets[0].p[net_index(m + n, 0, j)];
  for (int e = 0; e < 5; e++)
    make_edge(&edges[e], 0.4 * c->tolerance);
  const struct edge *first[3] = {&edges[0], &edges[4], &edges[3]}, *second[3] = {&edges[2], &edges[4], &edges[1]};
  /* (0,0)-(1,0), (1,0)-(0,1), (0,1)-(0,0); (1,1)-(0,1), (0,1)-(1,0), (1,0)-(1,1). */
  static const bool kFirst[3] = {false, false, true}, kSecond[3] = {true, true, false};
  LOD_TRY(cut_net(c, &nets[0], first, kFirst));
  return cut_net(c, &nets[1], second, kSecond);
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
  for (int k = 0; k < 3; k++) {
    edges[k].curve.degree = d;
    make_edge(&edges[k], 0.4 * c->tolerance);
  }
  const struct edge *list[3] = {&edges[0], &edges[1], &edges[2]};
  static const bool kNone[3] = {false, false, false};
  return cut_net(c, net, list, kNone);
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
  for (uint32_t p = 0; p < splines->count; p++) {
    c.arena = lod_arena_create_child(reader->scratch);
    if (!c.arena)
      return lod_reader_memory(reader);
    enum lod_status status = splines->patches[p].triangle ? cut_triangle(&c, &splines->patches[p]) : cut_tensor(&c, &splines->patches[p]);
    lod_arena_destroy(c.arena);
    LOD_TRY(status);
    if (p % 64 == 0)
      LOD_TRY(lod_reader_progress(reader, 0.4 * p / splines->count));
  }
  LOD_TRY(lod_reader_add_vertices(reader, c.mesh.vertex_count));
  reader->source_vertices = splines->points;
  /* Arithmetic of some hundred roundings of coordinates no larger than the control points'. */
  double magnitude = lod_mesh_magnitude(&c.mesh);
  struct lod_scene_part part = {.mesh = c.mesh, .rounding = c.deviation + sqrt(c.rounding) + 1024 * 0x1p-53 * magnitude};
  lod_scene_warn(reader->scene, "%u patches were cut into %u triangles, within %.3g of them: part of every error.", splines->count,
                 c.mesh.triangle_count, c.deviation);
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}
