/* Edge collapses in the order of their quadric error, each admitted only with its certificate.
 *
 * Based on: Garland, Heckbert 1997 (order, placement); Dey, Edelsbrunner, Guha, Nekhayev 1999 (link condition); Varshney et al. 1995 (the
 * two-sided epsilon). The certificate is certificate.h's. */
#include "core/envelope/collapse.h"

#include <math.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/base/tolerance.h"
#include "core/envelope/internal.h"
#include "core/envelope/quadric.h"

enum { WITNESS_SLOTS_LOG2 = 17, CANCEL_EVERY = 1024 };

struct witness {
  uint32_t a, b, triangle;
  uint32_t state; /* ring_state when the edge failed with every placement; 0 = not yet */
};

struct lod_collapse_settings lod_collapse_defaults(void) {
  return (struct lod_collapse_settings){
      .flip_degrees = 75, .least_quality = 1e-3, .passes = 4, .draft = true, .polish = 1, .guarding = LOD_GUARD_CLOSED};
}

/* ---- one collapse ---- */

static struct lod_vec3 face_normal(const struct lod_vec3 p[3]) {
  return lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
}

static double face_quality(const struct lod_vec3 p[3], double normal_length) {
  double edges = lod_vec3_distance_squared(p[0], p[1]) + lod_vec3_distance_squared(p[1], p[2]) + lod_vec3_distance_squared(p[2], p[0]);
  return edges > 0 ? 3.4641016151377544 * normal_length / edges : 0;
}

/* The shape guard: no face may fold over or become a needle that the old ones were not. */
static bool shape_allows(const struct lod_collapser *c, const struct lod_vec3 old[3], const struct lod_vec3 fresh[3]) {
  struct lod_vec3 n = face_normal(old), m = face_normal(fresh);
  double n_length = lod_vec3_length(n), m_length = lod_vec3_length(m);
  if (!(m_length > 0))
    return false;
  if (n_length > 0 && lod_vec3_dot(n, m) < c->least_normal_dot * n_length * m_length)
    return false;
  double quality = face_quality(fresh, m_length);
  return quality >= c->settings.least_quality || quality >= face_quality(old, n_length);
}

static void mark_face(struct lod_collapser *c, uint32_t f) {
  c->face_mark[f] = c->mark;
}

bool lod_attempt_gather(struct lod_collapser *c, uint32_t a, uint32_t b, struct lod_vec3 to, struct lod_attempt *attempt) {
  const struct lod_surface *s = &c->surface;
  struct lod_change *change = &attempt->change;
  c->mark++;
  change->changing_count = change->face_count = 0;
  const struct lod_vec3 at = s->position[b];
  int sides = to.x == at.x && to.y == at.y && to.z == at.z ? 1 : 2; /* where b stays, its other faces do */
  for (int side = a == LOD_NONE ? 1 : 0; side < sides; side++) {
    uint32_t v = side == 0 ? a : b;
    const uint32_t *ring = lod_surface_ring(s, v);
    for (uint32_t i = 0; i < s->ring_count[v]; i++) {
      uint32_t f = ring[i];
      if (c->face_mark[f] == c->mark)
        continue; /* on the edge: seen from a */
      mark_face(c, f);
      attempt->changing[change->changing_count++] = f;
      const uint32_t *w = s->face[f];
      bool dies = side == 0 && (w[0] == b || w[1] == b || w[2] == b);
      if (dies)
        continue;
      if (change->face_count == LOD_CERTIFICATE_MAX_FACES)
        return false;
      struct lod_candidate *fresh = &attempt->faces[change->face_count];
      struct lod_vec3 old[3];
      for (int k = 0; k < 3; k++) {
        old[k] = s->position[w[k]];
        fresh->corner[k] = w[k] == v ? to : old[k];
        fresh->vertex[k] = w[k];
        change->hints[change->face_count][k] = c->near[w[k]];
      }
      fresh->face = f;
      if (!shape_allows(c, old, fresh->corner))
        return false;
      change->face_count++;
    }
  }
  change->fresh_count = change->face_count;
  change->placed_count = 0;
  return c->wedges.channels == 0 || lod_wedges_place(&c->wedges, s, a, b, to, change, attempt->faces);
}

/* Unchanged faces around the ring: those that share an edge with it first, then those that share a vertex. */
static void gather_neighbours(void *context, struct lod_change *change) {
  struct lod_attempt *attempt = context;
  struct lod_collapser *c = attempt->collapser;
  const struct lod_surface *s = &c->surface;
  for (int edges_only = 1; edges_only >= 0; edges_only--)
    for (uint32_t i = 0; i < change->changing_count; i++)
      for (int k = 0; k < 3; k++) {
        uint32_t v = s->face[attempt->changing[i]][k], w = s->face[attempt->changing[i]][(k + 1) % 3];
        const uint32_t *ring = lod_surface_ring(s, v);
        for (uint32_t j = 0; j < s->ring_count[v]; j++) {
          uint32_t f = ring[j];
          const uint32_t *u = s->face[f];
          if (c->face_mark[f] == c->mark || (edges_only && u[0] != w && u[1] != w && u[2] != w))
            continue;
          if (change->face_count == LOD_CERTIFICATE_MAX_FACES)
            return;
          mark_face(c, f);
          struct lod_candidate *face = &attempt->faces[change->face_count++];
          for (int n = 0; n < 3; n++)
            face->corner[n] = s->position[u[n]];
          memcpy(face->vertex, u, sizeof face->vertex);
          if (c->wedges.channels != 0)
            memcpy(face->wedge, c->wedges.corner[f], sizeof face->wedge);
          face->face = f;
        }
      }
}

static struct witness *witness_of(struct lod_collapser *c, uint32_t a, uint32_t b) {
  uint64_t h = ((uint64_t)a << 32 | b) * 0x9e3779b97f4a7c15u;
  return &c->witnesses[h >> (64 - WITNESS_SLOTS_LOG2)];
}

enum lod_status lod_collapser_update_after(struct lod_collapser *c, uint32_t b) {
  const struct lod_surface *s = &c->surface;
  c->near[b] = lod_certificate_nearest(c->certificate, s->position[b], c->near[b]);
  c->stamp[b]++;
  c->mark++;
  const uint32_t *ring = lod_surface_ring(s, b);
  for (uint32_t i = 0; i < s->ring_count[b]; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t w = s->face[ring[i]][k];
      /* An edge's two faces both list its far end; push it once, from the face where it comes first. */
      bool first = w != b;
      for (uint32_t j = 0; j < i && first; j++)
        first = s->face[ring[j]][0] != w && s->face[ring[j]][1] != w && s->face[ring[j]][2] != w;
      if (first)
        LOD_TRY(lod_queue_push_edge(c, b, w));
    }
  return LOD_OK;
}

/* Changes when a vertex around a or b does. Never 0. */
static uint32_t ring_state(const struct lod_collapser *c, uint32_t a, uint32_t b) {
  const struct lod_surface *s = &c->surface;
  uint32_t sum = 0;
  for (int side = 0; side < 2; side++) {
    uint32_t v = side == 0 ? a : b;
    const uint32_t *ring = lod_surface_ring(s, v);
    for (uint32_t i = 0; i < s->ring_count[v]; i++)
      for (int k = 0; k < 3; k++)
        sum += c->stamp[s->face[ring[i]][k]];
  }
  return sum | 0x80000000u;
}

void lod_attempt_init(struct lod_collapser *c, struct lod_attempt *attempt) {
  attempt->collapser = c;
  attempt->change.gather = gather_neighbours;
  attempt->change.context = attempt;
  attempt->change.changing = attempt->changing;
  attempt->change.faces = attempt->faces;
  attempt->change.witness = LOD_NONE;
  attempt->change.placed_count = 0;
}

enum lod_status lod_attempt_collapse(struct lod_collapser *c, uint32_t a, uint32_t b, struct lod_vec3 to, struct lod_attempt *attempt,
                                     bool *done) {
  uint32_t stands_for = LOD_NONE;
  bool on_curve = c->surface.kind[a] == LOD_VERTEX_CURVE;
  *done = false;
  if (on_curve && !lod_curves_allow(&c->curves, &c->surface, a, b, to, c->epsilon, &stands_for))
    return LOD_OK;
  bool on_junction = c->surface.kind[a] == LOD_VERTEX_JUNCTION;
  if (on_junction && !lod_curves_allow_junction(&c->curves, &c->surface, a, b, to, c->epsilon))
    return LOD_OK;
  if (!lod_attempt_gather(c, a, b, to, attempt))
    return LOD_OK;
  enum lod_status status;
  bool admitted = lod_certificate_try(c->certificate, &attempt->change, &status);
  LOD_TRY(status);
  if (!admitted || !lod_guard_allows(c->guard, &c->surface, &attempt->change, a, b))
    return LOD_OK;
  lod_collapser_note_origin(c, a, b, to);
  LOD_TRY(lod_surface_collapse(&c->surface, a, b, to));
  lod_wedges_commit(&c->wedges, &attempt->change);
  lod_guard_follow(c->guard, &c->surface, attempt->changing, attempt->change.changing_count);
  if (on_curve)
    lod_curves_collapse(&c->curves, &c->surface, b, stands_for);
  c->merged[a] = b;
  LOD_TRY(lod_certificate_commit(c->certificate, &attempt->change));
  lod_quadric_add(&c->quadric[b], &c->quadric[a]);
  c->stamp[a]++;
  *done = true;
  return LOD_OK;
}

/* Tries edge (a, b) at up to `most` places; *done when it collapsed. */
static enum lod_status try_edge(struct lod_collapser *c, uint32_t a, uint32_t b, int most, bool *done) {
  bool b_stays;
  *done = false;
  struct witness *witness = witness_of(c, a, b);
  bool known = witness->a == a && witness->b == b;
  uint32_t state = known ? ring_state(c, a, b) : 0;
  if (known && witness->state == state)
    return LOD_OK;
  struct lod_vec3 place[4];
  double cost[4];
  int count = lod_collapser_placements(c, a, b, c->surface.kind[a] != c->surface.kind[b], place, cost);
  double gate = c->gate * (c->quadric[a].weight + c->quadric[b].weight);
  if (cost[0] > gate || !lod_surface_can_collapse(&c->surface, a, b, &b_stays))
    return LOD_OK;
  struct lod_attempt attempt;
  lod_attempt_init(c, &attempt);
  if (known)
    attempt.change.witness = witness->triangle;
  for (int i = 0; i < count && i < most && cost[i] <= gate; i++) {
    LOD_TRY(lod_attempt_collapse(c, a, b, place[i], &attempt, done));
    if (*done)
      return lod_collapser_update_after(c, b);
    if (attempt.change.witness != LOD_NONE) {
      *witness = (struct witness){a, b, attempt.change.witness, 0};
      known = true;
    }
  }
  if (most >= count) {
    if (!known)
      *witness = (struct witness){a, b, LOD_NONE, 0};
    witness->state = state != 0 ? state : ring_state(c, a, b);
  }
  return LOD_OK;
}

enum lod_status lod_collapser_pass(struct lod_collapser *c, int places, const struct lod_progress *progress, uint32_t *collapsed) {
  uint32_t tried = 0;
  *collapsed = 0;
  LOD_TRY(lod_queue_push_all(c));
  while (c->heap_count > 0) {
    struct lod_queue_entry e = lod_queue_pop(c);
    if (c->stamp[e.a] != e.stamp_a || c->stamp[e.b] != e.stamp_b)
      continue;
    if (++tried % CANCEL_EVERY == 0 && lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    bool done;
    LOD_TRY(try_edge(c, e.a, e.b, places, &done));
    if (!done && c->surface.kind[e.a] == c->surface.kind[e.b] && c->settings.vertex_subset)
      LOD_TRY(try_edge(c, e.b, e.a, places, &done));
    *collapsed += done;
  }
  return LOD_OK;
}

void lod_collapser_set_epsilon(struct lod_collapser *c, double epsilon, double gate) {
  c->epsilon = epsilon;
  lod_certificate_set_epsilon(c->certificate, epsilon - c->spent);
  if (c->wedges.channels != 0)
    lod_wedges_set_epsilon(&c->wedges, epsilon);
  c->gate = gate * epsilon * epsilon;
  for (size_t i = 0; i < (size_t)1 << WITNESS_SLOTS_LOG2; i++)
    c->witnesses[i].state = 0;
}

void lod_collapser_reach(struct lod_collapser *c, double epsilon) {
  c->reached = epsilon;
  for (uint32_t v = 0; c->bound != NULL && v < c->mesh->vertex_count; v++)
    c->bound[v] = epsilon;
}

void lod_collapser_forget(struct lod_collapser *c) {
  memset(c->witnesses, 0xff, ((size_t)1 << WITNESS_SLOTS_LOG2) * sizeof *c->witnesses);
}

/* ---- set-up ---- */

static void init_quadrics(struct lod_collapser *c) {
  const struct lod_surface *s = &c->surface;
  for (uint32_t f = 0; f < s->face_count; f++) {
    if (s->face[f][0] == LOD_NONE)
      continue;
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = s->position[s->face[f][k]];
    struct lod_vec3 normal = face_normal(p);
    double length = lod_vec3_length(normal);
    if (!(length > 0))
      continue;
    struct lod_vec3 n = lod_vec3_scale(normal, 1 / length);
    for (int k = 0; k < 3; k++)
      lod_quadric_add_plane(&c->quadric[s->face[f][k]], n, -lod_vec3_dot(n, p[0]), length / 2);
    for (int k = 0; k < 3; k++) {
      if (!(s->feature[f] >> k & 1))
        continue;
      /* A wall through the feature edge keeps its ends on it. */
      struct lod_vec3 edge = lod_vec3_subtract(p[(k + 1) % 3], p[k]);
      struct lod_vec3 wall = lod_vec3_normalize(lod_vec3_cross(edge, n));
      double weight = 2 * lod_vec3_length_squared(edge);
      lod_quadric_add_plane(&c->quadric[s->face[f][k]], wall, -lod_vec3_dot(wall, p[k]), weight);
      lod_quadric_add_plane(&c->quadric[s->face[f][(k + 1) % 3]], wall, -lod_vec3_dot(wall, p[k]), weight);
    }
  }
}

/* A live face on the segment that a degenerate triangle of the source is; LOD_NONE where there is none. */
static uint32_t find_host(const struct lod_collapser *c, uint32_t t) {
  const struct lod_surface *s = &c->surface;
  const uint32_t *v = c->mesh->triangles[t];
  uint32_t a = v[0], b = v[1] != v[0] ? v[1] : v[2];
  const uint32_t *ring = lod_surface_ring(s, a);
  for (uint32_t i = 0; i < s->ring_count[a]; i++) {
    const uint32_t *w = s->face[ring[i]];
    if (w[0] == b || w[1] == b || w[2] == b)
      return ring[i];
  }
  return LOD_NONE;
}

/* Regions that are connected across edges that are no features. */
static enum lod_status find_patches(struct lod_collapser *c) {
  const struct lod_surface *s = &c->surface;
  if (c->patch != NULL)
    return LOD_OK; /* of the source: starting afresh does not change them */
  c->patch = lod_sets_create(c->arena, s->face_count);
  if (c->patch == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    const uint32_t *ring = lod_surface_ring(s, v);
    for (uint32_t i = 0; i < s->ring_count[v]; i++)
      for (uint32_t j = i + 1; j < s->ring_count[v]; j++)
        if (lod_surface_smooth_neighbours(s, ring[i], ring[j]))
          lod_sets_join(c->patch, ring[i], ring[j]);
  }
  for (uint32_t f = 0; f < s->face_count; f++) {
    uint32_t host = s->face[f][0] == LOD_NONE ? find_host(c, f) : f;
    c->patch[f] = lod_sets_find(c->patch, host == LOD_NONE ? f : host);
  }
  return LOD_OK;
}

/* A source triangle that names a vertex twice is a segment or point of the source: a live face on it answers for it, or it stays as it is.
 */
static enum lod_status host_degenerate(struct lod_collapser *c) {
  const struct lod_surface *s = &c->surface;
  c->kept = LOD_NEW(c->arena, s->face_count - s->live_faces, uint32_t);
  if (c->kept == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < s->face_count; t++) {
    if (s->face[t][0] != LOD_NONE)
      continue;
    uint32_t host = find_host(c, t);
    if (host == LOD_NONE)
      c->kept[c->kept_count++] = t;
    else
      LOD_TRY(lod_certificate_move(c->certificate, t, host));
  }
  return LOD_OK;
}

enum lod_status lod_collapser_start(struct lod_collapser *c) {
  const struct lod_mesh *mesh = c->mesh;
  LOD_TRY(lod_surface_create(mesh, c->feature_edges, c->arena, &c->surface));
  for (uint32_t v = 0; v < mesh->vertex_count && c->settings.pinned != NULL; v++)
    if (c->settings.pinned[v])
      c->surface.kind[v] = LOD_VERTEX_CORNER;
  LOD_TRY(find_patches(c));
  LOD_TRY(lod_wedges_create(mesh, &c->surface, &c->settings.attributes, c->arena, &c->wedges));
  LOD_TRY(lod_certificate_create(mesh, c->bvh, c->settings.limits, 0, c->arena, &c->certificate));
  lod_certificate_set_rms(c->certificate, c->settings.rms);
  if (c->wedges.bounded)
    LOD_TRY(lod_certificate_bound_attributes(c->certificate, &c->wedges, c->patch));
  c->guard = NULL;
  c->has_guard = false;
  c->spent = 0;
  lod_collapser_reach(c, 0);
  c->proxy_faces = mesh->triangle_count;
  c->proxy_epsilon = 0;
  c->kept_count = 0;
  memset(c->quadric, 0, mesh->vertex_count * sizeof *c->quadric);
  lod_collapser_forget(c);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    c->merged[v] = c->origin[v] = v;
    c->near[v] = c->surface.ring_count[v] != 0 ? lod_surface_ring(&c->surface, v)[0] : LOD_NONE;
  }
  if (!c->wedges.bounded)
    lod_surface_fix_junctions(&c->surface);
  LOD_TRY(lod_curves_create(mesh, &c->surface, c->arena, &c->curves));
  c->curves.merged = c->merged;
  LOD_TRY(host_degenerate(c));
  init_quadrics(c);
  return LOD_OK;
}

enum lod_status lod_collapser_create(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const uint8_t *feature_edges,
                                     const struct lod_collapse_settings *settings, struct lod_arena *arena,
                                     struct lod_collapser **collapser) {
  struct lod_collapser *c = LOD_NEW_ZERO(arena, 1, struct lod_collapser);
  if (c == NULL)
    return LOD_MEMORY;
  c->mesh = mesh;
  c->bvh = bvh;
  c->feature_edges = feature_edges;
  c->arena = arena;
  c->settings = settings == NULL ? lod_collapse_defaults() : *settings;
  c->least_normal_dot = cos(c->settings.flip_degrees * 0.017453292519943295);
  c->quadric = LOD_NEW(arena, mesh->vertex_count, struct lod_quadric);
  c->near = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  c->stamp = LOD_NEW_ZERO(arena, mesh->vertex_count, uint32_t);
  c->face_mark = LOD_NEW_ZERO(arena, mesh->triangle_count, uint32_t);
  c->merged = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  c->origin = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  c->witnesses = LOD_NEW(arena, (size_t)1 << WITNESS_SLOTS_LOG2, struct witness);
  if (c->quadric == NULL || c->near == NULL || c->stamp == NULL || c->face_mark == NULL || c->merged == NULL || c->origin == NULL ||
      c->witnesses == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_collapser_start(c));
  *collapser = c;
  return LOD_OK;
}
