#include "core/mesh/curvature.h"

#include <math.h>

struct frame {
  struct lod_vec3 u, v, n;
};

static struct frame frame_of(struct lod_vec3 n) {
  struct lod_vec3 axis = fabs(n.x) < 0.6 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0);
  struct lod_vec3 u = lod_vec3_normalize(lod_vec3_cross(axis, n));
  return (struct frame){u, lod_vec3_cross(n, u), n};
}

static struct lod_vec3 corner_position(const struct lod_mesh *mesh, uint32_t t, int k) {
  return lod_vec3_from_float(mesh->positions[mesh->triangles[t][k % 3]]);
}

static double corner_angle(const struct lod_mesh *mesh, uint32_t t, int k) {
  struct lod_vec3 p = corner_position(mesh, t, k);
  struct lod_vec3 a = lod_vec3_subtract(corner_position(mesh, t, k + 1), p), b = lod_vec3_subtract(corner_position(mesh, t, k + 2), p);
  return atan2(lod_vec3_length(lod_vec3_cross(a, b)), lod_vec3_dot(a, b));
}

static struct lod_vec3 face_normal(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p = corner_position(mesh, t, 0);
  return lod_vec3_normalize(
      lod_vec3_cross(lod_vec3_subtract(corner_position(mesh, t, 1), p), lod_vec3_subtract(corner_position(mesh, t, 2), p)));
}

/* By corner: its triangle's normal times its angle, which every sum of normals here is made of. */
static enum lod_status weigh_corners(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_vec3 **faces,
                                     struct lod_vec3 **weighted) {
  *faces = LOD_NEW(arena, mesh->triangle_count, struct lod_vec3);
  *weighted = LOD_NEW(arena, 3 * (size_t)mesh->triangle_count, struct lod_vec3);
  if (*faces == NULL || *weighted == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    (*faces)[t] = face_normal(mesh, t);
    for (int k = 0; k < 3; k++)
      (*weighted)[3 * (size_t)t + (size_t)k] = lod_vec3_scale((*faces)[t], corner_angle(mesh, t, k));
  }
  return LOD_OK;
}

static enum lod_status vertex_normals(const struct lod_mesh *mesh, const struct lod_vec3 *weighted, struct lod_arena *arena,
                                      struct lod_vec3 **normals) {
  struct lod_vec3 *n = LOD_NEW_ZERO(arena, mesh->vertex_count, struct lod_vec3);
  if (n == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      n[mesh->triangles[t][k]] = lod_vec3_add(n[mesh->triangles[t][k]], weighted[3 * (size_t)t + (size_t)k]);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    n[v] = lod_vec3_normalize(n[v]);
  *normals = n;
  return LOD_OK;
}

/* The normal at each corner, of the faces at its vertex that bend from its own by less than a crease. */
static enum lod_status corner_normals(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, double crease_degrees,
                                      const struct lod_vec3 *faces, const struct lod_vec3 *weighted, struct lod_arena *arena,
                                      struct lod_vec3 **result) {
  enum { MOST_FACES = 64 }; /* of a vertex looked at pair by pair; at a larger hub all count */
  double least = cos(crease_degrees * (3.14159265358979323846 / 180));
  struct lod_vec3 *normals = LOD_NEW_ZERO(arena, 3 * (size_t)mesh->triangle_count, struct lod_vec3);
  if (normals == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    const uint32_t *corners = adjacency->vertex_corners + adjacency->vertex_begin[v];
    uint32_t count = adjacency->vertex_begin[v + 1] - adjacency->vertex_begin[v];
    struct lod_vec3 all = {0, 0, 0};
    bool smooth = true;
    for (uint32_t i = 0; i < count; i++) {
      all = lod_vec3_add(all, weighted[corners[i]]);
      for (uint32_t j = 0; j < i && smooth && count <= MOST_FACES; j++)
        smooth = lod_vec3_dot(faces[corners[i] / 3], faces[corners[j] / 3]) >= least;
    }
    all = lod_vec3_normalize(all);
    for (uint32_t i = 0; i < count; i++) {
      struct lod_vec3 sum = {0, 0, 0}, own = faces[corners[i] / 3];
      for (uint32_t j = 0; j < count && !smooth; j++)
        if (j == i || lod_vec3_dot(own, faces[corners[j] / 3]) >= least)
          sum = lod_vec3_add(sum, weighted[corners[j]]);
      normals[corners[i]] = smooth ? all : lod_vec3_normalize(sum);
    }
  }
  *result = normals;
  return LOD_OK;
}

/* The symmetric tensor (e, f, g) in the face's frame whose product with each side is the change of the normal along it, by least squares;
 * false for a triangle without area. */
static bool fit_face(const struct lod_mesh *mesh, uint32_t t, const struct lod_vec3 *normals, struct frame *frame, double tensor[3]) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = corner_position(mesh, t, k);
  struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
  double longest = 0;
  for (int k = 0; k < 3; k++)
    longest = fmax(longest, lod_vec3_distance_squared(p[k], p[(k + 1) % 3]));
  if (!(lod_vec3_length(n) > 1e-9 * longest))
    return false;
  *frame = frame_of(lod_vec3_normalize(n));
  double a[3][4] = {{0}}; /* normal equations, right side last */
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 side = lod_vec3_subtract(p[(k + 2) % 3], p[(k + 1) % 3]);
    struct lod_vec3 change = lod_vec3_subtract(normals[3 * (size_t)t + (size_t)(k + 2) % 3], normals[3 * (size_t)t + (size_t)(k + 1) % 3]);
    double x = lod_vec3_dot(side, frame->u), y = lod_vec3_dot(side, frame->v);
    double cx = lod_vec3_dot(change, frame->u), cy = lod_vec3_dot(change, frame->v);
    const double rows[2][4] = {{x, y, 0, cx}, {0, x, y, cy}};
    for (int r = 0; r < 2; r++)
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
          a[i][j] += rows[r][i] * rows[r][j];
  }
  for (int i = 0; i < 3; i++) { /* positive definite for a triangle with area: no pivoting */
    if (!(a[i][i] > 0))
      return false;
    for (int r = i + 1; r < 3; r++)
      for (int j = 3; j >= i; j--)
        a[r][j] -= a[i][j] * a[r][i] / a[i][i];
  }
  for (int i = 2; i >= 0; i--) {
    tensor[i] = a[i][3];
    for (int j = i + 1; j < 3; j++)
      tensor[i] -= a[i][j] * tensor[j];
    tensor[i] /= a[i][i];
  }
  return true;
}

/* Adds the face's tensor, turned into the vertex's tangent plane, to sum. */
static void add_turned(const struct frame *face, const double tensor[3], const struct frame *vertex, double weight, double sum[3]) {
  struct frame turned = *face; /* the face's plane rotated onto the vertex's */
  struct lod_vec3 axis = lod_vec3_cross(face->n, vertex->n);
  double cosine = lod_vec3_dot(face->n, vertex->n);
  if (cosine <= -0.99)
    return;
  for (int i = 0; i < 2; i++) { /* Rodrigues, with 1 / (1 + cos) for (1 - cos) / sin^2 */
    struct lod_vec3 *w = i == 0 ? &turned.u : &turned.v;
    struct lod_vec3 cross = lod_vec3_cross(axis, *w);
    struct lod_vec3 twice = lod_vec3_cross(axis, cross);
    *w = lod_vec3_add(*w, lod_vec3_add_scaled(cross, twice, 1 / (1 + cosine)));
  }
  double uu = lod_vec3_dot(vertex->u, turned.u), uv = lod_vec3_dot(vertex->u, turned.v);
  double vu = lod_vec3_dot(vertex->v, turned.u), vv = lod_vec3_dot(vertex->v, turned.v);
  double e = tensor[0], f = tensor[1], g = tensor[2];
  sum[0] += weight * (e * uu * uu + 2 * f * uu * uv + g * uv * uv);
  sum[1] += weight * (e * uu * vu + f * (uu * vv + uv * vu) + g * uv * vv);
  sum[2] += weight * (e * vu * vu + 2 * f * vu * vv + g * vv * vv);
}

static enum lod_status by_tensor(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, double crease_degrees,
                                 struct lod_arena *arena, struct lod_arena *scratch, struct lod_curvature *c) {
  struct lod_vec3 *normals, *corners, *faces, *weighted;
  LOD_TRY(weigh_corners(mesh, scratch, &faces, &weighted));
  LOD_TRY(corner_normals(mesh, adjacency, crease_degrees, faces, weighted, scratch, &corners));
  LOD_TRY(vertex_normals(mesh, weighted, scratch, &normals));
  double(*sums)[4] = lod_arena_calloc(scratch, mesh->vertex_count, sizeof *sums);
  c->principal = lod_arena_calloc(arena, mesh->vertex_count, sizeof *c->principal);
  c->directions = LOD_NEW_ZERO(arena, mesh->vertex_count, struct lod_vec3);
  if (sums == NULL || c->principal == NULL || c->directions == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct frame frame;
    double tensor[3];
    if (!fit_face(mesh, t, corners, &frame, tensor))
      continue;
    struct lod_vec3 p = corner_position(mesh, t, 0);
    double area = lod_vec3_length(
        lod_vec3_cross(lod_vec3_subtract(corner_position(mesh, t, 1), p), lod_vec3_subtract(corner_position(mesh, t, 2), p)));
    for (int k = 0; k < 3; k++) {
      uint32_t v = mesh->triangles[t][k];
      struct frame vertex = frame_of(normals[v]);
      add_turned(&frame, tensor, &vertex, area, sums[v]);
      sums[v][3] += area;
    }
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    if (!(sums[v][3] > 0))
      continue;
    double e = sums[v][0] / sums[v][3], f = sums[v][1] / sums[v][3], g = sums[v][2] / sums[v][3];
    double mean = 0.5 * (e + g), half = hypot(0.5 * (e - g), f);
    double first = mean >= 0 ? mean + half : mean - half, second = mean >= 0 ? mean - half : mean + half;
    struct frame frame = frame_of(normals[v]);
    /* (f, first - e) and (first - g, f) are the same direction; the longer one is exact enough. */
    double x = f, y = first - e;
    if (fabs(first - g) > fabs(first - e)) {
      x = first - g;
      y = f;
    }
    struct lod_vec3 direction = lod_vec3_add_scaled(lod_vec3_scale(frame.u, x), frame.v, y);
    c->directions[v] = lod_vec3_length_squared(direction) > 0 ? lod_vec3_normalize(direction) : frame.u;
    c->principal[v][0] = first;
    c->principal[v][1] = second;
    c->largest[v] = fabs(first);
  }
  return LOD_OK;
}

static enum lod_status by_radius(const struct lod_mesh *mesh, struct lod_arena *scratch, struct lod_curvature *c) {
  struct lod_vec3 *normals, *faces, *weighted;
  LOD_TRY(weigh_corners(mesh, scratch, &faces, &weighted));
  LOD_TRY(vertex_normals(mesh, weighted, scratch, &normals));
  double *own = LOD_NEW_ZERO(scratch, mesh->vertex_count, double);
  uint32_t *count = LOD_NEW_ZERO(scratch, mesh->vertex_count, uint32_t);
  if (own == NULL || count == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      for (int way = 1; way < 3; way++) {
        uint32_t p = mesh->triangles[t][k], q = mesh->triangles[t][(k + way) % 3];
        struct lod_vec3 edge = lod_vec3_subtract(lod_vec3_from_float(mesh->positions[q]), lod_vec3_from_float(mesh->positions[p]));
        double length = lod_vec3_length(edge), cosine = length > 0 ? lod_vec3_dot(normals[p], edge) / length : 0;
        double sine = sqrt(fmax(0, 1 - cosine * cosine));
        if (length > 0)
          own[p] = fmax(own[p], 2 * fabs(cosine) / (length * fmax(sine, 1e-3)));
      }
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    c->largest[v] = own[v];
    count[v] = 1;
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      for (int way = 1; way < 3; way++) { /* a neighbour counts once a triangle that they share */
        c->largest[mesh->triangles[t][k]] += own[mesh->triangles[t][(k + way) % 3]];
        count[mesh->triangles[t][k]]++;
      }
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    c->largest[v] /= count[v];
  return LOD_OK;
}

enum lod_status lod_curvature_estimate(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, enum lod_curvature_method method,
                                       double crease_degrees, struct lod_arena *arena, struct lod_curvature *curvature) {
  *curvature = (struct lod_curvature){.largest = LOD_NEW_ZERO(arena, mesh->vertex_count, double)};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = LOD_MEMORY;
  if (curvature->largest != NULL && scratch != NULL)
    status = method == LOD_CURVATURE_TURK ? by_radius(mesh, scratch, curvature)
                                          : by_tensor(mesh, adjacency, crease_degrees, arena, scratch, curvature);
  lod_arena_destroy(scratch);
  return status;
}
