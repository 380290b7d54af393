/* The tree is that of the source: faces stay near the triangle that they began as, so its order remains a good one while boxes grow and
 * empty. A change costs the boxes on the ways from its faces to the root. */
#include "core/envelope/guard.h"

#include <math.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/mesh/bvh_tree.h"
#include "core/mesh/intersect.h"

struct lod_guard {
  struct lod_bvh *tree;    /* whose primitives are faces */
  const uint32_t *face_of; /* per primitive; NULL: faces are primitives */
  uint32_t *slot_of;       /* per face */
  bool *guarded;           /* per face */
};

static bool on_boundary(const struct lod_surface *s, uint32_t a, uint32_t b) {
  const uint32_t *ring = lod_surface_ring(s, a);
  uint32_t count = 0;
  for (uint32_t i = 0; i < s->ring_count[a]; i++) {
    const uint32_t *v = s->face[ring[i]];
    count += v[0] == b || v[1] == b || v[2] == b;
  }
  return count == 1;
}

/* Faces of components without boundary; returns how many. */
static uint32_t find_closed(const struct lod_surface *s, uint32_t *up, bool *open, bool *guarded) {
  uint32_t count = 0;
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 1; k < 3 && s->face[f][0] != LOD_NONE; k++)
      lod_sets_join(up, s->face[f][0], s->face[f][k]);
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 0; k < 3 && s->face[f][0] != LOD_NONE; k++)
      if ((s->feature[f] >> k & 1) && on_boundary(s, s->face[f][k], s->face[f][(k + 1) % 3]))
        open[lod_sets_find(up, s->face[f][0])] = true;
  for (uint32_t f = 0; f < s->face_count; f++) {
    guarded[f] = s->face[f][0] != LOD_NONE && !open[lod_sets_find(up, s->face[f][0])];
    count += guarded[f];
  }
  return count;
}

enum lod_status lod_guard_create(const struct lod_mesh *mesh, const uint32_t *face_of, const struct lod_surface *s, bool open_too,
                                 struct lod_arena *arena, struct lod_guard **out) {
  *out = NULL;
  struct lod_guard *guard = LOD_NEW_ZERO(arena, 1, struct lod_guard);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *up = scratch == NULL ? NULL : lod_sets_create(scratch, s->vertex_count);
  bool *open = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, s->vertex_count, bool);
  if (guard == NULL || up == NULL || open == NULL || (guard->guarded = LOD_NEW(arena, s->face_count, bool)) == NULL ||
      (guard->slot_of = LOD_NEW(arena, s->face_count, uint32_t)) == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  uint32_t closed = find_closed(s, up, open, guard->guarded);
  lod_arena_destroy(scratch);
  if (open_too)
    memset(guard->guarded, 1, s->face_count);
  if (closed == 0 && !open_too)
    return LOD_OK;
  struct lod_mesh *triangles = LOD_NEW(arena, 1, struct lod_mesh);
  if (triangles == NULL)
    return LOD_MEMORY;
  *triangles = *mesh;
  triangles->edge_count = triangles->point_count = 0;
  LOD_TRY(lod_bvh_create(triangles, 1, arena, &guard->tree));
  guard->face_of = face_of;
  for (uint32_t slot = 0; slot < guard->tree->count; slot++) {
    uint32_t t = guard->tree->order[slot], f = face_of == NULL ? t : face_of[t];
    guard->slot_of[f] = slot;
    if (s->face[f][0] == LOD_NONE) /* degenerate triangles cross nothing */
      lod_guard_follow(guard, s, &f, 1);
  }
  *out = guard;
  return LOD_OK;
}

enum lod_status lod_guard_check(const struct lod_guard *guard, struct lod_arena *arena, bool *crossed) {
  if (guard == NULL)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  bool *found = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, guard->tree->count, bool);
  struct lod_crossings crossings;
  enum lod_status status = found == NULL ? LOD_MEMORY : lod_intersect_count(guard->tree->mesh, guard->tree, scratch, found, &crossings);
  for (uint32_t t = 0; status == LOD_OK && t < guard->tree->count; t++) {
    uint32_t f = guard->face_of == NULL ? t : guard->face_of[t];
    crossed[f] = found[t] && guard->guarded[f];
  }
  lod_arena_destroy(scratch);
  return status;
}

struct box {
  double min[3], max[3];
};

static struct box box_of(const struct lod_corners *c) {
  struct box box;
  for (int k = 0; k < 3; k++) {
    box.min[k] = fmin(c->point[0][k], fmin(c->point[1][k], c->point[2][k]));
    box.max[k] = fmax(c->point[0][k], fmax(c->point[1][k], c->point[2][k]));
  }
  return box;
}

static struct lod_corners corners_of(const struct lod_surface *s, uint32_t f) {
  struct lod_corners c;
  for (int k = 0; k < 3; k++) {
    c.vertex[k] = s->face[f][k];
    memcpy(c.point[k], &s->position[c.vertex[k]], sizeof c.point[k]);
  }
  return c;
}

/* A triangle with its plane. */
struct shape {
  struct lod_corners corners;
  struct box box;
  struct lod_vec3 normal; /* twice the area long */
  double slack;           /* heights over the plane are exact to less, times the length of the normal */
};

static struct lod_vec3 point_of(const struct lod_corners *c, int k) {
  return lod_vec3_make(c->point[k][0], c->point[k][1], c->point[k][2]);
}

static struct shape shape_of(const struct lod_corners *corners) {
  struct shape shape = {.corners = *corners, .box = box_of(corners)};
  struct lod_vec3 a = point_of(corners, 0);
  struct lod_vec3 ab = lod_vec3_subtract(point_of(corners, 1), a), ac = lod_vec3_subtract(point_of(corners, 2), a);
  shape.normal = lod_vec3_cross(ab, ac);
  shape.slack = 1e-12 * lod_vec3_length(ab) * lod_vec3_length(ac);
  return shape;
}

/* Whether all corners of other that it does not share with one lie surely on the same side of its plane: then they do not cross. */
static bool surely_beside(const struct shape *one, const struct shape *other) {
  struct lod_vec3 a = point_of(&one->corners, 0);
  int above = 0, below = 0, rest = 0;
  for (int k = 0; k < 3; k++) {
    uint32_t v = other->corners.vertex[k];
    if (v == one->corners.vertex[0] || v == one->corners.vertex[1] || v == one->corners.vertex[2])
      continue;
    rest++;
    struct lod_vec3 d = lod_vec3_subtract(point_of(&other->corners, k), a);
    double height = lod_vec3_dot(one->normal, d), slack = one->slack * (fabs(d.x) + fabs(d.y) + fabs(d.z));
    above += height > slack;
    below += height < -slack;
  }
  return rest > 0 && (above == rest || below == rest);
}

static bool cross(const struct shape *one, const struct shape *other) {
  for (int k = 0; k < 3; k++)
    if (one->box.min[k] > other->box.max[k] || other->box.min[k] > one->box.max[k])
      return false;
  return !surely_beside(one, other) && !surely_beside(other, one) && lod_triangles_cross(&one->corners, &other->corners);
}

struct query {
  const struct lod_surface *surface;
  const struct lod_change *change;
  const struct shape *fresh;
  const uint32_t *face_of;
  bool crosses;
};

static bool is_changing(const struct lod_change *change, uint32_t f) {
  for (uint32_t i = 0; i < change->changing_count; i++)
    if (change->changing[i] == f)
      return true;
  return false;
}

static bool crossed_before(const struct query *q, const struct shape *other) {
  for (uint32_t i = 0; i < q->change->changing_count; i++) {
    struct lod_corners old = corners_of(q->surface, q->change->changing[i]);
    if (lod_triangles_cross(&old, &other->corners))
      return true;
  }
  return false;
}

static bool visit(void *context, uint32_t primitive) {
  struct query *q = context;
  uint32_t f = q->face_of == NULL ? primitive : q->face_of[primitive];
  if (is_changing(q->change, f))
    return true;
  struct lod_corners corners = corners_of(q->surface, f);
  struct shape other = shape_of(&corners);
  for (uint32_t i = 0; i < q->change->fresh_count && !q->crosses; i++)
    q->crosses = cross(&q->fresh[i], &other) && !crossed_before(q, &other);
  return !q->crosses;
}

static bool changing_cross(const struct query *q) {
  for (uint32_t i = 0; i < q->change->changing_count; i++) {
    struct lod_corners one = corners_of(q->surface, q->change->changing[i]);
    for (uint32_t j = 0; j < i; j++) {
      struct lod_corners other = corners_of(q->surface, q->change->changing[j]);
      if (lod_triangles_cross(&one, &other))
        return true;
    }
  }
  return false;
}

bool lod_guard_allows(struct lod_guard *guard, const struct lod_surface *s, const struct lod_change *change, uint32_t a, uint32_t b) {
  if (guard == NULL || change->fresh_count == 0 || !guard->guarded[change->faces[0].face])
    return true;
  struct shape fresh[LOD_CERTIFICATE_MAX_FACES];
  struct query q = {.surface = s, .change = change, .fresh = fresh, .face_of = guard->face_of};
  struct box all = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  for (uint32_t i = 0; i < change->fresh_count; i++) {
    struct lod_corners corners;
    const uint32_t *v = change->faces[i].vertex;
    for (int k = 0; k < 3; k++) {
      corners.vertex[k] = v[k] == a ? b : v[k];
      memcpy(corners.point[k], &change->faces[i].corner[k], sizeof corners.point[k]);
    }
    fresh[i] = shape_of(&corners);
    for (uint32_t j = 0; j < i; j++)
      if (cross(&fresh[i], &fresh[j]) && !changing_cross(&q))
        return false;
    for (int k = 0; k < 3; k++) {
      all.min[k] = fmin(all.min[k], fresh[i].box.min[k]);
      all.max[k] = fmax(all.max[k], fresh[i].box.max[k]);
    }
  }
  lod_bvh_overlap(guard->tree, all.min, all.max, visit, &q);
  return !q.crosses;
}

static void set_lane(struct lod_bvh_node *node, uint32_t lane, const float min[3], const float max[3]) {
  for (int k = 0; k < 3; k++) {
    node->min[k][lane] = min[k];
    node->max[k][lane] = max[k];
  }
}

void lod_guard_follow(struct lod_guard *guard, const struct lod_surface *s, const uint32_t *changed, uint32_t count) {
  for (uint32_t i = 0; guard != NULL && i < count; i++) {
    uint32_t f = changed[i], index = guard->slot_of[f];
    float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
    if (s->face[f][0] != LOD_NONE) {
      struct lod_corners corners = corners_of(s, f);
      struct box box = box_of(&corners);
      for (int k = 0; k < 3; k++) {
        min[k] = (float)box.min[k];
        max[k] = (float)box.max[k];
      }
    }
    for (uint32_t level = 0; level < guard->tree->level_count; level++) {
      struct lod_bvh_node *node = &guard->tree->levels[level][index / LOD_BVH_WIDTH];
      set_lane(node, index % LOD_BVH_WIDTH, min, max);
      for (int k = 0; k < 3; k++)
        for (int lane = 0; lane < LOD_BVH_WIDTH; lane++) {
          min[k] = lane == 0 || node->min[k][lane] < min[k] ? node->min[k][lane] : min[k];
          max[k] = lane == 0 || node->max[k][lane] > max[k] ? node->max[k][lane] : max[k];
        }
      index /= LOD_BVH_WIDTH;
    }
  }
}
