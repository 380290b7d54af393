/* Exact intersection of triangles.
 *
 * Based on: Devillers, Guigue. Faster Triangle-Triangle Intersection Tests. 2002 (signs of orientations alone). Ours: reduced to segments
 * against triangles, which also answers for shared corners and edges. */
#include "core/mesh/intersect.h"

#include <math.h>
#include <string.h>

#include "core/base/predicates.h"

/* ---- in one plane: seen along the axis that the plane faces most ---- */

static void view(const double p[3], int axis, double out[2]) {
  out[0] = p[(axis + 1) % 3];
  out[1] = p[(axis + 2) % 3];
}

/* An axis along which abc does not look like a line; -1 when it is one along each. */
static int viewing_axis(const double a[3], const double b[3], const double c[3]) {
  double normal[3];
  for (int k = 0; k < 3; k++) {
    int i = (k + 1) % 3, j = (k + 2) % 3;
    normal[k] = fabs((b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i]));
  }
  int first = normal[0] >= normal[1] && normal[0] >= normal[2] ? 0 : normal[1] >= normal[2] ? 1 : 2;
  for (int k = 0; k < 3; k++) {
    int axis = (first + k) % 3;
    double u[2], v[2], w[2];
    view(a, axis, u);
    view(b, axis, v);
    view(c, axis, w);
    if (lod_orient2d(u, v, w) != 0)
      return axis;
  }
  return -1;
}

static bool between(const double p[2], const double q[2], const double x[2]) {
  for (int k = 0; k < 2; k++)
    if (x[k] < fmin(p[k], q[k]) || x[k] > fmax(p[k], q[k]))
      return false;
  return true;
}

static bool segments_meet(const double p[2], const double q[2], const double r[2], const double s[2]) {
  int pr = lod_orient2d(p, q, r), ps = lod_orient2d(p, q, s), rp = lod_orient2d(r, s, p), rq = lod_orient2d(r, s, q);
  if (pr * ps < 0 && rp * rq < 0)
    return true;
  return (pr == 0 && between(p, q, r)) || (ps == 0 && between(p, q, s)) || (rp == 0 && between(r, s, p)) || (rq == 0 && between(r, s, q));
}

static bool flat_segment_meets_triangle(const double p[3], const double q[3], const double a[3], const double b[3], const double c[3],
                                        int axis) {
  double u[2], v[2], t[3][2];
  view(p, axis, u);
  view(q, axis, v);
  view(a, axis, t[0]);
  view(b, axis, t[1]);
  view(c, axis, t[2]);
  for (int k = 0; k < 3; k++)
    if (segments_meet(u, v, t[k], t[(k + 1) % 3]))
      return true;
  int side[3];
  for (int k = 0; k < 3; k++)
    side[k] = lod_orient2d(t[k], t[(k + 1) % 3], u);
  return (side[0] > 0 && side[1] > 0 && side[2] > 0) || (side[0] < 0 && side[1] < 0 && side[2] < 0);
}

/* Two segments in space, either of which may be a point. */
static bool space_segments_meet(const double p[3], const double q[3], const double r[3], const double s[3]) {
  if (lod_orient3d(p, q, r, s) != 0)
    return false;
  for (int axis = 0; axis < 3; axis++) { /* in one plane: they meet when they do along every axis */
    double u[2], v[2], w[2], x[2];
    view(p, axis, u);
    view(q, axis, v);
    view(r, axis, w);
    view(s, axis, x);
    if (!segments_meet(u, v, w, x))
      return false;
  }
  return true;
}

bool lod_segment_meets_triangle(const double p[3], const double q[3], const double a[3], const double b[3], const double c[3]) {
  int axis = viewing_axis(a, b, c);
  if (axis < 0)
    return space_segments_meet(p, q, a, b) || space_segments_meet(p, q, b, c) || space_segments_meet(p, q, c, a);
  int above = lod_orient3d(a, b, c, p), below = lod_orient3d(a, b, c, q);
  if (above * below > 0)
    return false;
  if (above == 0 && below == 0)
    return flat_segment_meets_triangle(p, q, a, b, c, axis);
  int ab = lod_orient3d(p, q, a, b), bc = lod_orient3d(p, q, b, c), ca = lod_orient3d(p, q, c, a);
  return (ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0);
}

/* ---- two triangles ---- */

static bool boxes_apart(const struct lod_corners *a, const struct lod_corners *b) {
  for (int k = 0; k < 3; k++) {
    double low = fmin(a->point[0][k], fmin(a->point[1][k], a->point[2][k])),
           high = fmax(a->point[0][k], fmax(a->point[1][k], a->point[2][k]));
    if (low > fmax(b->point[0][k], fmax(b->point[1][k], b->point[2][k])) ||
        high < fmin(b->point[0][k], fmin(b->point[1][k], b->point[2][k])))
      return true;
  }
  return false;
}

static bool edge_meets(const struct lod_corners *of, int from, const struct lod_corners *b) {
  return lod_segment_meets_triangle(of->point[from], of->point[(from + 1) % 3], b->point[0], b->point[1], b->point[2]);
}

/* They share the edge opposite to a's corner i and b's corner j: they cross when they are in one plane, on the same side of it. */
static bool folded(const struct lod_corners *a, int i, const struct lod_corners *b, int j) {
  const double *p = a->point[(i + 1) % 3], *q = a->point[(i + 2) % 3];
  if (lod_orient3d(p, q, a->point[i], b->point[j]) != 0)
    return false;
  int axis = viewing_axis(p, q, a->point[i]);
  if (axis < 0)
    return viewing_axis(p, q, b->point[j]) < 0;
  double u[2], v[2], w[2], x[2];
  view(p, axis, u);
  view(q, axis, v);
  view(a->point[i], axis, w);
  view(b->point[j], axis, x);
  return lod_orient2d(u, v, w) * lod_orient2d(u, v, x) > 0;
}

bool lod_triangles_cross(const struct lod_corners *a, const struct lod_corners *b) {
  if (boxes_apart(a, b))
    return false;
  int shared = 0, at_a[3], at_b[3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      if (a->vertex[i] == b->vertex[j] && shared < 3) {
        at_a[shared] = i;
        at_b[shared++] = j;
      }
  if (shared == 0) {
    for (int k = 0; k < 3; k++)
      if (edge_meets(a, k, b) || edge_meets(b, k, a))
        return true;
    return false;
  }
  if (shared == 1)
    return edge_meets(a, (at_a[0] + 1) % 3, b) || edge_meets(b, (at_b[0] + 1) % 3, a);
  if (shared == 2)
    return folded(a, 3 - at_a[0] - at_a[1], b, 3 - at_b[0] - at_b[1]);
  return true;
}

/* ---- a mesh ---- */

struct counting {
  const struct lod_mesh *mesh;
  struct lod_corners of;
  uint32_t triangle;
  bool *crossed;
  struct lod_crossings *crossings;
};

static bool corners_of(const struct lod_mesh *mesh, uint32_t t, struct lod_corners *corners) {
  const uint32_t *v = mesh->triangles[t];
  for (int i = 0; i < 3; i++) {
    corners->vertex[i] = v[i];
    for (int k = 0; k < 3; k++)
      corners->point[i][k] = (double)mesh->positions[v[i]][k];
  }
  return v[0] != v[1] && v[1] != v[2] && v[2] != v[0];
}

static bool visit(void *context, uint32_t primitive) {
  struct counting *counting = context;
  struct lod_corners other;
  if (primitive <= counting->triangle || primitive >= counting->mesh->triangle_count || !corners_of(counting->mesh, primitive, &other))
    return true;
  if (lod_triangles_cross(&counting->of, &other)) {
    counting->crossings->pairs++;
    counting->crossed[counting->triangle] = counting->crossed[primitive] = true;
  }
  return true;
}

enum lod_status lod_intersect_count(const struct lod_mesh *mesh, const struct lod_bvh *bvh, struct lod_arena *arena, bool *crossed,
                                    struct lod_crossings *crossings) {
  *crossings = (struct lod_crossings){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct lod_bvh *own = NULL;
  enum lod_status status = bvh == NULL ? lod_bvh_create(mesh, 1, scratch, &own) : LOD_OK;
  struct counting counting = {.mesh = mesh, .crossed = crossed == NULL ? LOD_NEW(scratch, mesh->triangle_count, bool) : crossed};
  counting.crossings = crossings;
  if (counting.crossed == NULL)
    status = LOD_MEMORY;
  else
    memset(counting.crossed, 0, mesh->triangle_count * sizeof *counting.crossed);
  for (uint32_t t = 0; status == LOD_OK && t < mesh->triangle_count; t++) {
    if (!corners_of(mesh, t, &counting.of))
      continue;
    counting.triangle = t;
    double low[3], high[3];
    for (int k = 0; k < 3; k++) {
      low[k] = fmin(counting.of.point[0][k], fmin(counting.of.point[1][k], counting.of.point[2][k]));
      high[k] = fmax(counting.of.point[0][k], fmax(counting.of.point[1][k], counting.of.point[2][k]));
    }
    lod_bvh_overlap(bvh == NULL ? own : bvh, low, high, visit, &counting);
  }
  for (uint32_t t = 0; status == LOD_OK && t < mesh->triangle_count; t++)
    crossings->triangles += counting.crossed[t];
  lod_arena_destroy(scratch);
  return status;
}
