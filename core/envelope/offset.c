#include "core/envelope/offset.h"

#include <math.h>
#include <string.h>

#include "core/envelope/prism.h"
#include "core/mesh/intersect.h"
#include "core/mesh/triangle_distance.h"

static struct lod_vec3 position(const struct lod_mesh *mesh, uint32_t v) {
  return lod_vec3_from_float(mesh->positions[v]);
}

/* ---- directions ---- */

static struct lod_vec3 normal_of(const struct lod_mesh *mesh, uint32_t t) {
  const uint32_t *v = mesh->triangles[t];
  struct lod_vec3 a = position(mesh, v[0]);
  return lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(position(mesh, v[1]), a), lod_vec3_subtract(position(mesh, v[2]), a)));
}

/* Cosine of the angle to the face normal that lies farthest off; *worst is that normal. */
static double least_cosine(const struct lod_vec3 *faces, uint32_t count, struct lod_vec3 n, struct lod_vec3 *worst) {
  double least = 1;
  for (uint32_t i = 0; i < count; i++) {
    double cosine = lod_vec3_dot(faces[i], n);
    if (cosine < least && lod_vec3_length_squared(faces[i]) > 0) {
      least = cosine;
      *worst = faces[i];
    }
  }
  return least;
}

/* Centre of the smallest cap around the face normals. Based on: Badoiu, Clarkson. Smaller Core-Sets for Balls. 2003: step towards the one
 * farthest off, ever less. */
struct lod_vec3 lod_offset_central(const struct lod_vec3 *faces, uint32_t count, double *cosine) {
  struct lod_vec3 n = {0, 0, 0}, worst = {0, 0, 0};
  for (uint32_t i = 0; i < count; i++)
    n = lod_vec3_add(n, faces[i]);
  n = lod_vec3_normalize(n);
  struct lod_vec3 best = n;
  *cosine = least_cosine(faces, count, n, &worst);
  for (int i = 1; i <= 64 && *cosine < 0.9; i++) {
    n = lod_vec3_normalize(lod_vec3_add_scaled(n, worst, 1.0 / (i + 1)));
    double now = least_cosine(faces, count, n, &worst);
    if (now > *cosine) {
      *cosine = now;
      best = n;
    }
  }
  return best;
}

/* The one normal that the mesh gives a vertex; false when it gives none, or several. */
static bool given_normal(const struct lod_mesh *mesh, const uint32_t *corners, uint32_t count, struct lod_vec3 *normal, bool *several) {
  if (mesh->normals == NULL || count == 0)
    return false;
  *normal = lod_vec3_from_float(mesh->normals[mesh->corners[corners[0] / 3][corners[0] % 3]]);
  for (uint32_t i = 1; i < count; i++) {
    struct lod_vec3 other = lod_vec3_from_float(mesh->normals[mesh->corners[corners[i] / 3][corners[i] % 3]]);
    if (lod_vec3_dot(*normal, other) < 0.999) {
      *several = true;
      return false;
    }
  }
  return true;
}

enum lod_status lod_offset_directions(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, double crease_degrees,
                                      struct lod_arena *arena, struct lod_offset *offset) {
  /* A fiber nearly in a face's plane says little about what lies over the face. */
  const double least_seen = 0.02, well_seen = 0.3;
  double crease = cos(crease_degrees * 0.017453292519943295);
  offset->direction = LOD_NEW_ZERO(arena, mesh->vertex_count, struct lod_vec3);
  offset->several = LOD_NEW_ZERO(arena, mesh->vertex_count, bool);
  offset->outer = LOD_NEW_ZERO(arena, mesh->vertex_count, double);
  offset->inner = LOD_NEW_ZERO(arena, mesh->vertex_count, double);
  if (offset->direction == NULL || offset->several == NULL || offset->outer == NULL || offset->inner == NULL)
    return LOD_MEMORY;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t most = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (adjacency->vertex_begin[v + 1] - adjacency->vertex_begin[v] > most)
      most = adjacency->vertex_begin[v + 1] - adjacency->vertex_begin[v];
  struct lod_vec3 *faces = scratch == NULL ? NULL : LOD_NEW(scratch, most, struct lod_vec3);
  for (uint32_t v = 0; faces != NULL && v < mesh->vertex_count; v++) {
    const uint32_t *corners = adjacency->vertex_corners + adjacency->vertex_begin[v];
    uint32_t count = adjacency->vertex_begin[v + 1] - adjacency->vertex_begin[v];
    for (uint32_t i = 0; i < count; i++)
      faces[i] = normal_of(mesh, corners[i] / 3);
    struct lod_vec3 worst, given;
    double seen;
    struct lod_vec3 n = lod_offset_central(faces, count, &seen);
    bool one = given_normal(mesh, corners, count, &given, &offset->several[v]);
    if (one && least_cosine(faces, count, given, &worst) > well_seen)
      n = given;
    for (uint32_t i = 0; i < count && mesh->normals == NULL && !offset->several[v]; i++)
      offset->several[v] = least_cosine(faces, count, faces[i], &worst) < crease;
    if (seen > least_seen)
      offset->direction[v] = n;
  }
  lod_arena_destroy(scratch);
  return faces == NULL ? LOD_MEMORY : LOD_OK;
}

struct lod_vec3 lod_offset_vertex(const struct lod_mesh *mesh, const struct lod_offset *offset, uint32_t v, int side) {
  return lod_vec3_add_scaled(position(mesh, v), offset->direction[v], side > 0 ? offset->outer[v] : -offset->inner[v]);
}

/* ---- thickness ---- */

static double *thickness_of(const struct lod_offset *offset, int side) {
  return side > 0 ? offset->outer : offset->inner;
}

static bool share_vertex(const uint32_t a[3], const uint32_t b[3]) {
  for (int i = 0; i < 3; i++)
    if (a[i] == b[0] || a[i] == b[1] || a[i] == b[2])
      return true;
  return false;
}

/* The prism over t on one side, whose height 1 is the offset surface. */
static struct lod_prism half_prism(const struct lod_mesh *mesh, const struct lod_offset *offset, uint32_t t, int side) {
  struct lod_prism prism;
  for (int k = 0; k < 3; k++) {
    uint32_t v = mesh->triangles[t][k];
    prism.corner[k] = position(mesh, v);
    prism.normal[k] = lod_vec3_scale(offset->direction[v], side * thickness_of(offset, side)[v]);
  }
  return prism;
}

static void box_of(const struct lod_vec3 *points, int count, double low[3], double high[3]) {
  for (int k = 0; k < 3; k++) {
    low[k] = INFINITY;
    high[k] = -INFINITY;
  }
  for (int i = 0; i < count; i++) {
    const double p[3] = {points[i].x, points[i].y, points[i].z};
    for (int k = 0; k < 3; k++) {
      low[k] = fmin(low[k], p[k]);
      high[k] = fmax(high[k], p[k]);
    }
  }
}

/* What the rule of the paper looks at over one triangle. */
struct approach {
  const struct lod_mesh *mesh;
  uint32_t triangle;
  struct lod_prism prism; /* height 1 is twice epsilon */
  struct lod_triangle_probe probe;
  double nearest; /* squared */
};

static void approach_point(struct approach *approach, struct lod_vec3 p) {
  approach->nearest = fmin(approach->nearest, lod_triangle_distance_squared(&approach->probe, p));
}

/* Where the segment from p to p + d meets triangle q. */
static bool pierce(struct lod_vec3 p, struct lod_vec3 d, const struct lod_vec3 q[3], struct lod_vec3 *at) {
  struct lod_vec3 u = lod_vec3_subtract(q[1], q[0]), v = lod_vec3_subtract(q[2], q[0]), n = lod_vec3_cross(u, v);
  double slope = lod_vec3_dot(n, d);
  if (slope == 0)
    return false;
  double s = lod_vec3_dot(n, lod_vec3_subtract(q[0], p)) / slope;
  *at = lod_vec3_add_scaled(p, d, s);
  for (int k = 0; k < 3; k++)
    if (lod_vec3_dot(n, lod_vec3_cross(lod_vec3_subtract(q[(k + 1) % 3], q[k]), lod_vec3_subtract(*at, q[k]))) < 0)
      return false;
  return s >= 0 && s <= 1;
}

static bool approach_triangle(void *context, uint32_t u) {
  struct approach *approach = context;
  const struct lod_mesh *mesh = approach->mesh;
  if (u >= mesh->triangle_count || share_vertex(mesh->triangles[u], mesh->triangles[approach->triangle]))
    return true;
  struct lod_vec3 q[3], at[2];
  const struct lod_prism *prism = &approach->prism;
  double height, weights[3];
  for (int k = 0; k < 3; k++) {
    q[k] = position(mesh, mesh->triangles[u][k]);
    if (lod_prism_locate(prism, q[k], 0, 1, &height, weights) && weights[0] >= 0 && weights[1] >= 0 && weights[2] >= 0)
      approach_point(approach, q[k]);
  }
  for (int k = 0; k < 3; k++) {
    for (int e = 0; e < 3; e++) {
      int count = lod_bilinear_meets(prism->corner[e], prism->corner[(e + 1) % 3], prism->normal[e], prism->normal[(e + 1) % 3], 1, q[k],
                                     q[(k + 1) % 3], at);
      for (int i = 0; i < count; i++)
        approach_point(approach, at[i]);
    }
    if (pierce(prism->corner[k], prism->normal[k], q, at))
      approach_point(approach, at[0]);
  }
  return true;
}

/* 4.3: for each triangle half of the least distance to what its prism of twice epsilon meets, for each vertex the least of its triangles'.
 */
static void paper_rule(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const double *epsilon, int side, struct lod_offset *offset) {
  double *thickness = thickness_of(offset, side);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    thickness[v] = 2 * epsilon[v];
  double *result = side > 0 ? offset->inner : offset->outer; /* the other side is free until its own turn */
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    result[v] = epsilon[v];
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct approach approach = {.mesh = mesh, .triangle = t, .prism = half_prism(mesh, offset, t, side), .nearest = INFINITY};
    struct lod_vec3 all[6];
    for (int k = 0; k < 3; k++) {
      all[k] = approach.prism.corner[k];
      all[k + 3] = lod_vec3_add(approach.prism.corner[k], approach.prism.normal[k]);
    }
    approach.probe = lod_triangle_prepare(all[0], all[1], all[2]);
    double low[3], high[3];
    box_of(all, 6, low, high);
    lod_bvh_overlap(bvh, low, high, approach_triangle, &approach);
    for (int k = 0; k < 3 && approach.nearest < INFINITY; k++) {
      double *r = &result[mesh->triangles[t][k]];
      *r = fmin(*r, 0.5 * sqrt(approach.nearest));
    }
  }
  memcpy(thickness, result, mesh->vertex_count * sizeof *thickness);
}

/* Whether the plane through a direction holds the two sets of six points apart. */
static bool apart_along(struct lod_vec3 axis, const struct lod_vec3 a[6], const struct lod_vec3 b[6]) {
  double a_low = INFINITY, a_high = -INFINITY, b_low = INFINITY, b_high = -INFINITY;
  for (int i = 0; i < 6; i++) {
    double x = lod_vec3_dot(axis, a[i]), y = lod_vec3_dot(axis, b[i]);
    a_low = fmin(a_low, x);
    a_high = fmax(a_high, x);
    b_low = fmin(b_low, y);
    b_high = fmax(b_high, y);
  }
  double slack = 1e-12 * (fabs(a_low) + fabs(a_high) + fabs(b_low) + fabs(b_high));
  return a_high + slack < b_low || b_high + slack < a_low;
}

static void corners_of(const struct lod_prism *prism, struct lod_vec3 out[6]) {
  for (int k = 0; k < 3; k++) {
    out[k] = prism->corner[k];
    out[k + 3] = lod_vec3_add(prism->corner[k], prism->normal[k]);
  }
}

static struct lod_vec3 plane_of(const struct lod_vec3 *p, int a, int b, int c) {
  return lod_vec3_cross(lod_vec3_subtract(p[b], p[a]), lod_vec3_subtract(p[c], p[a]));
}

/* Along the way from one to the other, or its part across either's fibers: prisms side by side are apart there. */
static bool apart_across(const struct lod_vec3 a[6], const struct lod_vec3 b[6]) {
  struct lod_vec3 way = {0, 0, 0};
  for (int i = 0; i < 6; i++)
    way = lod_vec3_add(way, lod_vec3_subtract(b[i], a[i]));
  if (apart_along(way, a, b))
    return true;
  for (int k = 0; k < 2; k++) {
    const struct lod_vec3 *p = k == 0 ? a : b;
    struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
    double squared = lod_vec3_length_squared(n);
    if (squared > 0 && apart_along(lod_vec3_add_scaled(way, n, -lod_vec3_dot(way, n) / squared), a, b))
      return true;
  }
  return false;
}

/* Whether two prisms are shown to be apart by a plane along one of their faces, or along an edge of each. */
static bool prisms_apart(const struct lod_vec3 a[6], const struct lod_vec3 b[6]) {
  if (apart_across(a, b))
    return true;
  static const int kFaces[8][3] = {{0, 1, 2}, {3, 4, 5}, {0, 1, 4}, {1, 4, 3}, {1, 2, 5}, {2, 5, 4}, {2, 0, 3}, {0, 3, 5}};
  static const int kEdges[9][2] = {{0, 1}, {1, 2}, {2, 0}, {3, 4}, {4, 5}, {5, 3}, {0, 3}, {1, 4}, {2, 5}};
  for (int f = 0; f < 8; f++)
    if (apart_along(plane_of(a, kFaces[f][0], kFaces[f][1], kFaces[f][2]), a, b) ||
        apart_along(plane_of(b, kFaces[f][0], kFaces[f][1], kFaces[f][2]), a, b))
      return true;
  for (int i = 0; i < 9; i++)
    for (int j = 0; j < 9; j++)
      if (apart_along(
              lod_vec3_cross(lod_vec3_subtract(a[kEdges[i][1]], a[kEdges[i][0]]), lod_vec3_subtract(b[kEdges[j][1]], b[kEdges[j][0]])), a,
              b))
        return true;
  return false;
}

/* Looks for prisms that meet the one over a triangle. */
struct separation {
  const struct lod_mesh *mesh;
  struct lod_offset *offset;
  uint32_t triangle;
  int side;
  struct lod_vec3 corners[6];
  const uint8_t *stale; /* per triangle: it, or what it was tested against, has changed since; NULL = all */
  bool *shrink;         /* per vertex, inner then outer */
  bool any;
};

static bool separate(void *context, uint32_t u) {
  struct separation *s = context;
  const struct lod_mesh *mesh = s->mesh;
  if (u >= mesh->triangle_count || u < s->triangle || share_vertex(mesh->triangles[u], mesh->triangles[s->triangle]) ||
      !(s->stale[u] || s->stale[s->triangle]))
    return true;
  for (int side = -1; side <= 1; side += 2) {
    struct lod_prism other = half_prism(mesh, s->offset, u, side);
    struct lod_vec3 corners[6];
    corners_of(&other, corners);
    if (prisms_apart(s->corners, corners))
      continue;
    s->any = true;
    for (int k = 0; k < 3; k++) {
      s->shrink[2 * mesh->triangles[s->triangle][k] + (s->side > 0)] = true;
      s->shrink[2 * mesh->triangles[u][k] + (side > 0)] = true;
    }
  }
  return true;
}

static bool shrink_marked(const struct lod_mesh *mesh, struct lod_offset *offset, bool *shrink, uint8_t *stale, double factor) {
  bool any = false;
  memset(stale, 0, mesh->triangle_count);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 6; k++)
      stale[t] |= shrink[2 * mesh->triangles[t][k / 2] + k % 2];
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int side = 0; side < 2; side++) {
      double *thickness = side == 0 ? &offset->inner[v] : &offset->outer[v];
      if (shrink[2 * v + side]) {
        *thickness *= factor;
        shrink[2 * v + side] = false;
        any = true;
      }
    }
  return any;
}

static void mark_folded(const struct lod_mesh *mesh, const struct lod_offset *offset, bool *shrink) {
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int side = -1; side <= 1; side += 2) {
      struct lod_prism prism = half_prism(mesh, offset, t, side);
      struct lod_vec3 up[3];
      for (int k = 0; k < 3; k++)
        up[k] = offset->direction[mesh->triangles[t][k]];
      bool valid = lod_prism_is_valid(&prism, 1, up);
      for (int k = 0; k < 3 && !valid; k++)
        shrink[2 * mesh->triangles[t][k] + (side > 0)] = true;
    }
}

static bool mark_meeting(const struct lod_mesh *mesh, const struct lod_bvh *bvh, struct lod_offset *offset, double most,
                         const uint8_t *stale, bool *shrink) {
  bool any = false;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int side = -1; side <= 1; side += 2) {
      struct separation s = {.mesh = mesh, .offset = offset, .triangle = t, .side = side, .stale = stale, .shrink = shrink};
      struct lod_prism prism = half_prism(mesh, offset, t, side);
      corners_of(&prism, s.corners);
      double low[3], high[3];
      box_of(s.corners, 6, low, high);
      for (int k = 0; k < 3; k++) {
        low[k] -= most;
        high[k] += most;
      }
      lod_bvh_overlap(bvh, low, high, separate, &s);
      any = any || s.any;
    }
  return any;
}

enum lod_status lod_offset_thicken(const struct lod_mesh *mesh, const struct lod_bvh *bvh, enum lod_offset_rule rule, const double *epsilon,
                                   struct lod_arena *arena, struct lod_offset *offset) {
  enum { ROUNDS = 40 };
  const double factor = 0.7;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  bool *shrink = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, 2 * (size_t)mesh->vertex_count, bool);
  uint8_t *stale = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, uint8_t);
  double *outer = scratch == NULL ? NULL : LOD_NEW(scratch, mesh->vertex_count, double);
  if (shrink == NULL || stale == NULL || outer == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double most = 0;
  if (rule == LOD_OFFSET_PAPER) {
    paper_rule(mesh, bvh, epsilon, 1, offset);
    memcpy(outer, offset->outer, mesh->vertex_count * sizeof *outer);
    paper_rule(mesh, bvh, epsilon, -1, offset);
    memcpy(offset->outer, outer, mesh->vertex_count * sizeof *outer);
  } else {
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
      offset->outer[v] = offset->inner[v] = epsilon[v];
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    most = fmax(most, epsilon[v]);
    if (!(lod_vec3_length_squared(offset->direction[v]) > 0))
      offset->outer[v] = offset->inner[v] = 0;
  }
  memset(stale, 1, mesh->triangle_count);
  for (int round = 0; round <= ROUNDS; round++) {
    mark_folded(mesh, offset, shrink);
    mark_meeting(mesh, bvh, offset, most, stale, shrink);
    if (!shrink_marked(mesh, offset, shrink, stale, round == ROUNDS ? 0 : factor))
      break;
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

/* ---- what lies between ---- */

struct admission {
  const struct lod_mesh *mesh;
  const struct lod_offset *offset;
  struct lod_corners triangle;
  bool admitted;
};

static void set_point(double out[3], struct lod_vec3 p) {
  out[0] = p.x;
  out[1] = p.y;
  out[2] = p.z;
}

static bool admit(void *context, uint32_t t) {
  struct admission *a = context;
  if (t >= a->mesh->triangle_count)
    return true;
  for (int side = -1; side <= 1; side += 2) {
    struct lod_corners shell;
    for (int k = 0; k < 3; k++) {
      uint32_t v = a->mesh->triangles[t][k];
      set_point(shell.point[k], lod_offset_vertex(a->mesh, a->offset, v, side));
      /* Where there is no thickness, surface and offset surface share the vertex. */
      shell.vertex[k] = (side > 0 ? a->offset->outer : a->offset->inner)[v] == 0 ? v : a->mesh->vertex_count + (uint32_t)k;
    }
    int shared = 0;
    for (int k = 0; k < 3; k++)
      shared +=
          shell.vertex[k] == a->triangle.vertex[0] || shell.vertex[k] == a->triangle.vertex[1] || shell.vertex[k] == a->triangle.vertex[2];
    if (a->triangle.vertex[1] == a->triangle.vertex[2]) {
      if (shared == 0 &&
          lod_segment_meets_triangle(a->triangle.point[0], a->triangle.point[1], shell.point[0], shell.point[1], shell.point[2]))
        a->admitted = false;
    } else if (shared < 3 && lod_triangles_cross(&a->triangle, &shell)) { /* 3: no thickness at all, it is the offset surface itself */
      a->admitted = false;
    }
  }
  return a->admitted;
}

bool lod_offset_admits(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const struct lod_offset *offset, const uint32_t v[3],
                       double epsilon) {
  struct admission a = {.mesh = mesh, .offset = offset, .admitted = true};
  struct lod_vec3 p[3];
  double low[3], high[3];
  for (int k = 0; k < 3; k++) {
    p[k] = position(mesh, v[k]);
    set_point(a.triangle.point[k], p[k]);
    a.triangle.vertex[k] = v[k];
  }
  box_of(p, 3, low, high);
  for (int k = 0; k < 3; k++) {
    low[k] -= epsilon;
    high[k] += epsilon;
  }
  lod_bvh_overlap(bvh, low, high, admit, &a);
  return a.admitted;
}
