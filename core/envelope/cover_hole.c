/* Holes: what a triangle lies over goes out, and the rest of the hole is filled (Varshney et al. 1995, 6.2 and 6.3).
 *
 * A hole is a disc of faces. Its border is cut into paths by the edges that the filling must have, and each path is filled by the
 * triangulation of least cost (dynamic programming over the path). Nothing changes before the certificate and the crossing test agree. */
#include <math.h>
#include <string.h>

#include "core/envelope/cover_internal.h"
#include "core/mesh/bvh_tree.h"
#include "core/mesh/intersect.h"

enum { PATH = COVER_FILL + 3, UNDER = 256 };

/* Cost of a triangle: the square of how much of epsilon it takes, and a little for its shape. */
static const double SHAPE_COST = 0.02, SHAPE_MOST = 50;

struct attempt {
  struct lod_cover *cover;
  struct cover_hole hole;
  uint32_t border[3 * COVER_HOLE][2], border_count;
  uint32_t loop[3 * COVER_HOLE], loop_count;
  uint32_t under[UNDER], under_count; /* vertices that vanish now or have done so before, over the hole */
  double epsilon;                     /* of this step */
  uint32_t fill_patch[COVER_FILL];    /* which side of the lines a filling triangle is on */
  uint32_t ids[COVER_FILL];           /* the faces that they become */
  struct lod_change change;
  struct lod_candidate faces[LOD_CERTIFICATE_MAX_FACES];
};

/* ---- faces of a hole ---- */

/* Whether the edge from p to q has all of the triangle on its right. */
static bool separates(const struct lod_cover *c, uint32_t p, uint32_t q, const uint32_t v[3]) {
  for (int k = 0; k < 3; k++)
    if (v[k] != p && v[k] != q && cover_side(c, p, q, v[k]) > 0)
      return false;
  return true;
}

/* Whether two triangles over the same part of the surface overlap, along the fibers: two convex sets do not when an edge of either
 * separates them. */
static bool overlap(const struct lod_cover *c, const uint32_t a[3], const uint32_t b[3]) {
  for (int k = 0; k < 3; k++)
    if (separates(c, a[k], a[(k + 1) % 3], b) || separates(c, b[k], b[(k + 1) % 3], a))
      return false;
  return true;
}

static bool add_face(struct attempt *a, uint32_t f) {
  if (a->hole.face_count == COVER_HOLE)
    return false;
  a->hole.faces[a->hole.face_count++] = f;
  a->cover->face_mark[f] = a->cover->mark;
  return true;
}

/* All faces around the vertices of face f that triangle v covers: also of one on its edge, whose faces beyond the edge overlap nothing. */
static bool add_covered(struct attempt *a, const uint32_t v[3], uint32_t f) {
  struct lod_cover *c = a->cover;
  for (int k = 0; k < 3; k++) {
    uint32_t w = c->face[f][k];
    if (w == v[0] || w == v[1] || w == v[2] || c->kind[w] != COVER_INTERIOR || !cover_covers(c, v, w))
      continue;
    for (uint32_t i = 0; i < c->ring[w].count; i++)
      if (c->face_mark[c->ring[w].faces[i]] != c->mark && !add_face(a, c->ring[w].faces[i]))
        return false;
  }
  return true;
}

/* The faces that triangle v overlaps, from its first corner on, and those around the vertices that it covers; false when there are too
 * many, or a line runs between them. */
static bool flood(struct attempt *a, const uint32_t v[3]) {
  struct lod_cover *c = a->cover;
  c->mark++;
  const struct cover_ring *ring = &c->ring[v[0]];
  for (uint32_t i = 0; i < ring->count; i++)
    if (overlap(c, v, c->face[ring->faces[i]]) && !add_face(a, ring->faces[i]))
      return false;
  for (uint32_t i = 0; i < a->hole.face_count; i++) {
    uint32_t f = a->hole.faces[i];
    if (!add_covered(a, v, f))
      return false;
    for (int k = 0; k < 3; k++) {
      uint32_t g = cover_across(c, f, c->face[f][k], c->face[f][(k + 1) % 3]);
      if (g == LOD_NONE || c->face_mark[g] == c->mark || !overlap(c, v, c->face[g]))
        continue;
      if ((c->opaque[f] >> k & 1) || !add_face(a, g))
        return false;
    }
  }
  return a->hole.face_count > 1;
}

/* Border of the marked faces, and the vertices inside. */
static bool find_border(struct attempt *a) {
  struct lod_cover *c = a->cover;
  for (uint32_t i = 0; i < a->hole.face_count; i++) {
    uint32_t f = a->hole.faces[i];
    for (int k = 0; k < 3; k++) {
      uint32_t u = c->face[f][k], w = c->face[f][(k + 1) % 3], g = cover_across(c, f, u, w);
      if (g != LOD_NONE && c->face_mark[g] == c->mark)
        continue;
      if (c->vertex_mark[u] == c->mark)
        return false; /* the border touches itself */
      c->vertex_mark[u] = c->mark;
      c->vertex_slot[u] = a->border_count;
      a->border[a->border_count][0] = u;
      a->border[a->border_count++][1] = w;
    }
  }
  for (uint32_t i = 0; i < a->hole.face_count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t u = c->face[a->hole.faces[i]][k];
      if (c->vertex_mark[u] == c->mark)
        continue;
      if (c->kind[u] != COVER_INTERIOR || a->hole.inside_count == COVER_HOLE)
        return false;
      c->vertex_mark[u] = c->mark;
      c->vertex_slot[u] = LOD_NONE;
      a->hole.inside[a->hole.inside_count++] = u;
    }
  return true;
}

/* The border as one loop that starts at a vertex; false unless the hole is a disc. */
static bool find_loop(struct attempt *a, uint32_t start) {
  const struct lod_cover *c = a->cover;
  if (c->vertex_mark[start] != c->mark || c->vertex_slot[start] == LOD_NONE)
    return false;
  uint32_t v = start;
  do {
    if (a->loop_count == a->border_count || c->vertex_mark[v] != c->mark || c->vertex_slot[v] == LOD_NONE)
      return false;
    a->loop[a->loop_count++] = v;
    v = a->border[c->vertex_slot[v]][1];
  } while (v != start);
  return a->loop_count == a->border_count && a->hole.face_count + 2 == 2 * a->hole.inside_count + a->loop_count;
}

static void find_under(struct attempt *a) {
  const struct lod_cover *c = a->cover;
  for (uint32_t i = 0; i < a->hole.inside_count && a->under_count < UNDER; i++)
    a->under[a->under_count++] = a->hole.inside[i];
  for (uint32_t i = 0; i < a->hole.face_count; i++)
    for (uint32_t u = c->first[a->hole.faces[i]]; u != LOD_NONE && a->under_count < UNDER; u = c->next[u])
      a->under[a->under_count++] = u;
}

/* Epsilon of this step: the least of all source triangles that the hole answers for. */
static void find_epsilon(struct attempt *a) {
  const struct lod_cover *c = a->cover;
  double share = 1;
  for (uint32_t i = 0; i < a->hole.face_count && c->settings.vertex_epsilon != NULL; i++) {
    uint32_t count = lod_certificate_charge_count(c->certificate, a->hole.faces[i]);
    for (uint32_t j = 0; j < count; j++) {
      uint32_t t = lod_certificate_charge(c->certificate, a->hole.faces[i], j);
      for (int k = 0; k < 3 && t != LOD_NONE; k++)
        share = fmin(share, (double)c->settings.vertex_epsilon[c->source->triangles[t][k]]);
    }
  }
  a->epsilon = share * c->epsilon;
}

/* ---- filling ---- */

struct filling {
  struct attempt *attempt;
  uint32_t path[PATH], count;
  bool usable[PATH][PATH]; /* the edge between two may be there */
  double cost[PATH][PATH];
  uint8_t by[PATH][PATH];
};

/* Whether a face outside of the hole has edge (u, w). */
static bool exists_outside(const struct lod_cover *c, uint32_t u, uint32_t w) {
  const struct cover_ring *ring = &c->ring[u];
  for (uint32_t i = 0; i < ring->count; i++) {
    const uint32_t *v = c->face[ring->faces[i]];
    if (c->face_mark[ring->faces[i]] != c->mark && (v[0] == w || v[1] == w || v[2] == w))
      return true;
  }
  return false;
}

static bool near_source(const struct attempt *a, struct lod_vec3 p, uint32_t hint) {
  double radius = fmax(0, a->epsilon - a->cover->margin);
  return lod_bvh_any_within(a->cover->bvh, p, hint, radius * radius) != LOD_NONE;
}

/* A first look at whether a triangle stays within epsilon: what passes here is proven by the certificate. */
static bool seems_near(const struct attempt *a, const uint32_t v[3]) {
  const struct lod_cover *c = a->cover;
  if (c->settings.offsets != LOD_COVER_NO_OFFSETS && !lod_offset_admits(c->mesh, c->bvh, &c->offset, v, c->epsilon))
    return false;
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = cover_point(c, v[k]);
  if (!near_source(a, lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3), c->near[v[0]]))
    return false;
  for (int k = 0; k < 3; k++)
    if (!near_source(a, lod_vec3_scale(lod_vec3_add(p[k], p[(k + 1) % 3]), 0.5), c->near[v[k]]))
      return false;
  return true;
}

/* INFINITY: not allowed. */
static double triangle_cost(const struct attempt *a, const uint32_t v[3]) {
  const struct lod_cover *c = a->cover;
  if (!cover_faces_out(c, v[0], v[1], v[2]))
    return INFINITY;
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = cover_point(c, v[k]);
  struct lod_triangle_probe probe = lod_triangle_prepare(p[0], p[1], p[2]);
  double most = 0, squared = a->epsilon * a->epsilon;
  for (uint32_t i = 0; i < a->under_count; i++) {
    if (!cover_covers(c, v, a->under[i]))
      continue;
    double d = lod_triangle_distance_squared(&probe, cover_point(c, a->under[i]));
    if (d > squared)
      return INFINITY;
    most = fmax(most, d);
  }
  if (!seems_near(a, v))
    return INFINITY;
  double edges = lod_vec3_distance_squared(p[0], p[1]) + lod_vec3_distance_squared(p[1], p[2]) + lod_vec3_distance_squared(p[2], p[0]);
  double shape = edges / (3.4641016151377544 * sqrt(probe.normal_squared));
  return (squared > 0 ? most / squared : 0) + SHAPE_COST * fmin(SHAPE_MOST, shape);
}

static void add_fill(struct attempt *a, uint32_t u, uint32_t v, uint32_t w, uint32_t patch) {
  a->fill_patch[a->hole.fill_count] = patch;
  memcpy(a->hole.fill[a->hole.fill_count++], (const uint32_t[3]){u, v, w}, sizeof a->hole.fill[0]);
}

static void emit(struct filling *f, uint32_t i, uint32_t j, uint32_t patch) {
  if (j - i < 2)
    return;
  uint32_t k = f->by[i][j];
  add_fill(f->attempt, f->path[i], f->path[k], f->path[j], patch);
  emit(f, i, k, patch);
  emit(f, k, j, patch);
}

/* Patch of the hole's face that has the border edge from u to w. */
static uint32_t patch_at(const struct attempt *a, uint32_t u, uint32_t w) {
  const struct lod_cover *c = a->cover;
  for (uint32_t i = 0; i < a->hole.face_count; i++)
    for (int k = 0; k < 3; k++)
      if (c->face[a->hole.faces[i]][k] == u && c->face[a->hole.faces[i]][(k + 1) % 3] == w)
        return c->patch[a->hole.faces[i]];
  return c->patch[a->hole.faces[0]];
}

/* Each filling triangle becomes a face of the hole that was on its side of the lines: a side's filling is smaller than the side was. */
static void choose_ids(struct attempt *a) {
  const struct lod_cover *c = a->cover;
  bool used[COVER_HOLE] = {false};
  for (uint32_t i = 0; i < a->hole.fill_count; i++)
    for (uint32_t j = 0; j < a->hole.face_count; j++)
      if (!used[j] && c->patch[a->hole.faces[j]] == a->fill_patch[i]) {
        used[j] = true;
        a->ids[i] = a->hole.faces[j];
        break;
      }
}

/* Fills between a path and the edge that closes it. closing_exists: that edge is part of the border already. */
static bool fill_path(struct filling *f, bool closing_exists) {
  struct attempt *a = f->attempt;
  uint32_t n = f->count;
  if (n < 3)
    return true;
  if (a->hole.fill_count + n - 2 > COVER_FILL)
    return false;
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = i + 1; j < n; j++)
      f->usable[i][j] = j == i + 1 || (i == 0 && j == n - 1 && closing_exists) || !exists_outside(a->cover, f->path[i], f->path[j]);
  for (uint32_t i = 0; i + 1 < n; i++)
    f->cost[i][i + 1] = 0;
  for (uint32_t span = 2; span < n; span++)
    for (uint32_t i = 0; i + span < n; i++) {
      uint32_t j = i + span;
      f->cost[i][j] = INFINITY;
      for (uint32_t k = i + 1; k < j && f->usable[i][j]; k++) {
        if (!f->usable[i][k] || !f->usable[k][j])
          continue;
        double sum = f->cost[i][k] + f->cost[k][j];
        if (!(sum < f->cost[i][j]))
          continue;
        sum += triangle_cost(a, (const uint32_t[3]){f->path[i], f->path[k], f->path[j]});
        if (sum < f->cost[i][j]) {
          f->cost[i][j] = sum;
          f->by[i][j] = (uint8_t)k;
        }
      }
    }
  if (!(f->cost[0][n - 1] < INFINITY))
    return false;
  emit(f, 0, n - 1, patch_at(a, f->path[0], f->path[1]));
  return true;
}

/* The stretch of the loop from place i to place j, both included. */
static bool take_path(struct filling *f, uint32_t i, uint32_t j) {
  const struct attempt *a = f->attempt;
  f->count = 0;
  for (;; i = i + 1 == a->loop_count ? 0 : i + 1) {
    if (f->count == PATH)
      return false;
    f->path[f->count++] = a->loop[i];
    if (i == j)
      return true;
  }
}

/* ---- whether it may be ---- */

/* Unchanged faces around the hole: those that share an edge with it first, then those that share a vertex. */
static void gather(void *context, struct lod_change *change) {
  struct attempt *a = context;
  struct lod_cover *c = a->cover;
  for (int edges_only = 1; edges_only >= 0; edges_only--)
    for (uint32_t i = 0; i < a->hole.face_count; i++)
      for (int k = 0; k < 3; k++) {
        uint32_t u = c->face[a->hole.faces[i]][k], w = c->face[a->hole.faces[i]][(k + 1) % 3];
        for (uint32_t j = 0; j < c->ring[u].count; j++) {
          uint32_t f = c->ring[u].faces[j];
          const uint32_t *v = c->face[f];
          if (c->face_mark[f] == c->mark || (edges_only && v[0] != w && v[1] != w && v[2] != w))
            continue;
          if (change->face_count == LOD_CERTIFICATE_MAX_FACES)
            return;
          c->face_mark[f] = c->mark;
          struct lod_candidate *face = &a->faces[change->face_count++];
          for (int n = 0; n < 3; n++)
            face->corner[n] = cover_point(c, v[n]);
          face->face = f;
        }
      }
}

static struct lod_corners corners_of(const struct lod_cover *c, const uint32_t v[3]) {
  struct lod_corners corners;
  for (int i = 0; i < 3; i++) {
    corners.vertex[i] = v[i];
    memcpy(corners.point[i], c->at[v[i]], sizeof corners.point[i]);
  }
  return corners;
}

static bool in_hole(const struct attempt *a, uint32_t f) {
  for (uint32_t i = 0; i < a->hole.face_count; i++)
    if (a->hole.faces[i] == f)
      return true;
  return false;
}

static bool hole_crosses(const struct attempt *a, const struct lod_corners *other) {
  for (uint32_t i = 0; i < a->hole.face_count; i++) {
    struct lod_corners old = corners_of(a->cover, a->cover->face[a->hole.faces[i]]);
    if (lod_triangles_cross(&old, other))
      return true;
  }
  return false;
}

/* Whether the filling crosses a face that the hole's faces did not. Looks at all faces: parts are small. */
static bool crosses_anew(const struct attempt *a) {
  const struct lod_cover *c = a->cover;
  struct lod_corners fill[COVER_FILL];
  float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
  for (uint32_t i = 0; i < a->hole.fill_count; i++) {
    fill[i] = corners_of(c, a->hole.fill[i]);
    for (int k = 0; k < 9; k++) {
      low[k % 3] = fminf(low[k % 3], (float)fill[i].point[k / 3][k % 3]);
      high[k % 3] = fmaxf(high[k % 3], (float)fill[i].point[k / 3][k % 3]);
    }
  }
  for (uint32_t i = 0; i < a->hole.fill_count; i++)
    for (uint32_t j = i + 1; j < a->hole.fill_count; j++)
      if (lod_triangles_cross(&fill[i], &fill[j]))
        return true;
  for (uint32_t f = 0; f < c->mesh->triangle_count; f++) {
    const float *box = c->box[f];
    if (c->face[f][0] == LOD_NONE || box[0] > high[0] || box[1] > high[1] || box[2] > high[2] || box[3] < low[0] || box[4] < low[1] ||
        box[5] < low[2])
      continue;
    struct lod_corners other = corners_of(c, c->face[f]);
    for (uint32_t i = 0; i < a->hole.fill_count; i++)
      if (lod_triangles_cross(&fill[i], &other) && !in_hole(a, f) && !hole_crosses(a, &other))
        return true;
  }
  return false;
}

/* ---- doing it ---- */

/* The face, of those that stand where the hole was, that replaces a vertex. */
static uint32_t replacement(const struct attempt *a, uint32_t u) {
  const struct lod_cover *c = a->cover;
  uint32_t best = LOD_NONE;
  double best_distance = INFINITY;
  bool best_covers = false;
  for (uint32_t i = 0; i < a->change.face_count; i++) {
    uint32_t f = a->faces[i].face;
    bool covers = cover_covers(c, c->face[f], u);
    if ((best_covers && !covers) || (i >= a->hole.fill_count && best_covers))
      continue;
    struct lod_triangle_probe probe = lod_triangle_prepare(a->faces[i].corner[0], a->faces[i].corner[1], a->faces[i].corner[2]);
    double distance = lod_triangle_distance_squared(&probe, cover_point(c, u));
    if ((covers && !best_covers) || distance < best_distance) {
      best = f;
      best_distance = distance;
      best_covers = covers;
    }
  }
  return best;
}

static void give(struct lod_cover *c, uint32_t u, uint32_t f) {
  c->replaced[u] = f;
  c->next[u] = c->first[f];
  c->first[f] = u;
}

/* Vertices that vanish now or have done so before get the face that replaces them now. */
static void hand_over(struct attempt *a) {
  struct lod_cover *c = a->cover;
  uint32_t all = LOD_NONE; /* a list */
  for (uint32_t i = 0; i < a->hole.face_count; i++) {
    uint32_t u = c->first[a->hole.faces[i]], next;
    for (; u != LOD_NONE; u = next) {
      next = c->next[u];
      c->next[u] = all;
      all = u;
    }
    c->first[a->hole.faces[i]] = LOD_NONE;
  }
  for (uint32_t i = 0; i < a->hole.inside_count; i++) {
    c->next[a->hole.inside[i]] = all;
    all = a->hole.inside[i];
  }
  for (uint32_t next; all != LOD_NONE; all = next) {
    next = c->next[all];
    give(c, all, replacement(a, all));
  }
}

static enum lod_status try_fill(struct attempt *a, bool *done) {
  struct lod_cover *c = a->cover;
  struct lod_change *change = &a->change;
  *change = (struct lod_change){.gather = gather, .context = a, .changing = a->hole.faces, .changing_count = a->hole.face_count};
  change->faces = a->faces;
  change->face_count = change->fresh_count = a->hole.fill_count;
  change->witness = LOD_NONE;
  choose_ids(a);
  for (uint32_t i = 0; i < a->hole.fill_count; i++) {
    a->faces[i].face = a->ids[i];
    for (int k = 0; k < 3; k++) {
      a->faces[i].corner[k] = cover_point(c, a->hole.fill[i][k]);
      change->hints[i][k] = c->near[a->hole.fill[i][k]];
    }
  }
  enum lod_status status;
  lod_certificate_set_epsilon(c->certificate, a->epsilon);
  bool may = lod_certificate_try(c->certificate, change, &status);
  LOD_TRY(status);
  if (!may || (!c->settings.may_cross && crosses_anew(a)))
    return LOD_OK;
  if (change->face_count == 0)
    gather(a, change); /* somebody has to replace the vertex */
  LOD_TRY(lod_certificate_commit(c->certificate, change));
  LOD_TRY(cover_replace(c, &a->hole, a->ids));
  hand_over(a);
  *done = true;
  return LOD_OK;
}

enum lod_status cover_try_triangle(struct lod_cover *c, const uint32_t v[3], bool *done) {
  struct attempt attempt, *a = &attempt;
  *done = false;
  a->cover = c;
  a->hole.face_count = a->hole.inside_count = a->hole.fill_count = 0;
  a->border_count = a->loop_count = a->under_count = 0;
  a->hole.chord[0] = LOD_NONE;
  if (!flood(a, v) || !find_border(a) || !find_loop(a, v[0]) || a->hole.inside_count == 0)
    return LOD_OK;
  uint32_t place[3] = {0, 0, 0};
  for (uint32_t i = 0; i < a->loop_count; i++)
    for (int k = 1; k < 3; k++)
      if (a->loop[i] == v[k])
        place[k] = i;
  if (!(0 < place[1] && place[1] < place[2]))
    return LOD_OK;
  find_epsilon(a);
  find_under(a);
  if (!(triangle_cost(a, v) < INFINITY))
    return LOD_OK;
  add_fill(a, v[0], v[1], v[2], c->patch[a->hole.faces[0]]);
  struct filling filling = {.attempt = a};
  for (int k = 0; k < 3; k++)
    if (!take_path(&filling, place[k], place[(k + 1) % 3]) || !fill_path(&filling, false) ||
        (filling.count > 2 && exists_outside(c, v[k], v[(k + 1) % 3])))
      return LOD_OK;
  return try_fill(a, done);
}

/* ---- one vertex ---- */

/* Where the line through v goes on, both ways, and whether all that lay between is within epsilon of the chord. */
static bool find_chord(const struct attempt *a, uint32_t v, uint32_t chord[2]) {
  const struct lod_cover *c = a->cover;
  for (int way = 0; way < 2; way++) {
    uint32_t from = v, at = c->link[v][way];
    while (!cover_stands(c, at)) {
      uint32_t next = c->link[at][0] == from ? c->link[at][1] : c->link[at][0];
      from = at;
      at = next;
    }
    chord[way] = at;
  }
  if (chord[0] == chord[1] || chord[0] == v || chord[1] == v)
    return false;
  struct lod_vec3 start = cover_point(c, chord[0]), edge = lod_vec3_subtract(cover_point(c, chord[1]), start);
  double radius = fmax(0, a->epsilon - c->margin);
  for (int way = 0; way < 2; way++) {
    uint32_t from = way == 0 ? c->link[v][1] : c->link[v][0], at = v;
    while (at != chord[way]) {
      if (lod_segment_distance_squared(lod_vec3_subtract(cover_point(c, at), start), edge) > radius * radius)
        return false;
      uint32_t next = at == v ? c->link[v][way] : c->link[at][0] == from ? c->link[at][1] : c->link[at][0];
      from = at;
      at = next;
    }
  }
  return true;
}

/* The faces around v, and the loop or path across from it. */
static bool find_star(struct attempt *a, uint32_t v, bool *closed) {
  struct lod_cover *c = a->cover;
  const struct cover_ring *ring = &c->ring[v];
  if (ring->count == 0 || ring->count > COVER_FILL)
    return false;
  c->mark++;
  for (uint32_t i = 0; i < ring->count; i++) {
    uint32_t f = ring->faces[i], k = c->face[f][0] == v ? 0 : c->face[f][1] == v ? 1 : 2, u = c->face[f][(k + 1) % 3];
    add_face(a, f);
    if (c->vertex_mark[u] == c->mark)
      return false;
    c->vertex_mark[u] = c->mark;
    c->vertex_slot[u] = i;
    a->border[i][0] = u;
    a->border[i][1] = c->face[f][(k + 2) % 3];
  }
  a->border_count = ring->count;
  uint32_t start = a->border[0][0];
  *closed = true;
  for (uint32_t i = 0; i < ring->count; i++) {
    bool entered = false;
    for (uint32_t j = 0; j < ring->count; j++)
      entered = entered || a->border[j][1] == a->border[i][0];
    if (!entered) {
      start = a->border[i][0];
      *closed = false;
    }
  }
  uint32_t u = start;
  for (uint32_t i = 0; i < ring->count; i++) {
    if (c->vertex_mark[u] != c->mark)
      return false;
    a->loop[a->loop_count++] = u;
    u = a->border[c->vertex_slot[u]][1];
  }
  if (!*closed)
    a->loop[a->loop_count++] = u;
  a->hole.inside[a->hole.inside_count++] = v;
  return !*closed || u == start;
}

/* Whether the border edge that becomes the line already is one, or has nobody behind it. */
static bool blocked(const struct attempt *a, uint32_t u, uint32_t w) {
  const struct lod_cover *c = a->cover;
  for (uint32_t i = 0; i < a->hole.face_count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t f = a->hole.faces[i], p = c->face[f][k], q = c->face[f][(k + 1) % 3];
      if ((p == u && q == w) || (p == w && q == u))
        return (c->opaque[f] >> k & 1) || cover_across(c, f, p, q) == LOD_NONE;
    }
  return false;
}

/* Fills on each side of the line through the vertex. */
static bool fill_sides(struct attempt *a, struct filling *f, bool closed) {
  const uint32_t *chord = a->hole.chord;
  uint32_t place[2] = {LOD_NONE, LOD_NONE}, n = a->loop_count;
  for (uint32_t i = 0; i < n; i++)
    for (int k = 0; k < 2; k++)
      if (a->loop[i] == chord[k])
        place[k] = i;
  if (place[0] == LOD_NONE || place[1] == LOD_NONE || (!closed && place[0] + place[1] != n - 1) ||
      (!closed && place[0] != 0 && place[1] != 0))
    return false;
  uint32_t low = place[0] < place[1] ? place[0] : place[1], high = place[0] < place[1] ? place[1] : place[0];
  bool beside = high - low == 1 || (closed && low + n - high == 1);
  if (beside ? (closed && n == 2) || blocked(a, chord[0], chord[1]) : exists_outside(a->cover, chord[0], chord[1]))
    return false;
  if (!take_path(f, low, high) || !fill_path(f, beside))
    return false;
  return !closed || (take_path(f, high, low) && fill_path(f, beside));
}

/* What a collapse of v into the vertex at place k of its loop would leave: a fan. False when a triangle of it may not be. */
static bool fill_fan(struct attempt *a, uint32_t k) {
  const struct lod_cover *c = a->cover;
  uint32_t n = a->loop_count, apex = a->loop[k];
  a->hole.fill_count = 0;
  for (uint32_t i = 1; i + 1 < n; i++) {
    uint32_t u = a->loop[(k + i) % n], w = a->loop[(k + i + 1) % n];
    if (!cover_faces_out(c, apex, u, w) || (i > 1 && exists_outside(c, apex, u)))
      return false;
    add_fill(a, apex, u, w, c->patch[a->hole.faces[0]]);
  }
  return true;
}

/* The filling of least cost is the likeliest to fit; where it does not, fans may. */
static enum lod_status try_fans(struct attempt *a, bool *done) {
  enum { MOST = 8 };
  for (uint32_t k = 0; k < a->loop_count && a->loop_count <= MOST && !*done; k++) {
    a->cover->mark++; /* neighbours were marked */
    for (uint32_t i = 0; i < a->hole.face_count; i++)
      a->cover->face_mark[a->hole.faces[i]] = a->cover->mark;
    if (fill_fan(a, k))
      LOD_TRY(try_fill(a, done));
  }
  return LOD_OK;
}

enum lod_status cover_try_vertex(struct lod_cover *c, uint32_t v, bool *done) {
  struct attempt attempt, *a = &attempt;
  bool closed;
  *done = false;
  a->cover = c;
  a->hole.face_count = a->hole.inside_count = a->hole.fill_count = 0;
  a->border_count = a->loop_count = a->under_count = 0;
  a->hole.chord[0] = LOD_NONE;
  if (c->kind[v] == COVER_FIXED || !find_star(a, v, &closed))
    return LOD_OK;
  find_epsilon(a);
  find_under(a);
  struct filling filling = {.attempt = a};
  if (c->kind[v] == COVER_INTERIOR) {
    if (!closed || a->loop_count < 3)
      return LOD_OK;
    if (take_path(&filling, 0, a->loop_count - 1) && fill_path(&filling, true))
      LOD_TRY(try_fill(a, done));
    return *done ? LOD_OK : try_fans(a, done);
  }
  if (!find_chord(a, v, a->hole.chord) || !fill_sides(a, &filling, closed))
    return LOD_OK;
  return try_fill(a, done);
}
