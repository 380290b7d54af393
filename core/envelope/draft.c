/* Collapses without certificates, for where epsilon is far above what the surface does: each is bounded by a map, and bounds add up.
 *
 * Based on: Cohen, Manocha, Olano. Simplifying Polygonal Models Using Successive Mappings. 1997 (old and new faces around an edge are laid
 * over each other in a plane; their difference is linear between the points where that overlay has corners, so it is greatest at one of
 * them). Ours: a bound per vertex; only what is a height field over one plane is tried, all else is left to the certificate. */
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/envelope/internal.h"
#include "core/envelope/quadric.h"
#include "core/mesh/bvh_tree.h"

/* Hubs of many faces jam certificates later, which look at few faces around. */
enum { CANCEL_EVERY = 16384, BLOCK = 4096, MAX_RING = 64, MAX_SPOKES = 2 * MAX_RING, MOST_FRESH = 16 };

/* Normals of faces and of the plane of the overlay: cosine at least this. */
static const double LEAST_COSINE = 0.1;

/* A vertex laid in the plane. */
struct flat {
  double x, y, z; /* z: height over the plane */
  double bound;   /* of the map so far, see struct draft */
};

struct overlay {
  struct lod_vec3 axis[3], origin;
  struct flat old[2];                  /* the vertices that go: a, and b when it moves */
  struct flat fresh;                   /* the vertex that comes, or b when it stays */
  struct flat old_corner[160][3];      /* faces as they are */
  struct flat new_corner[MAX_RING][3]; /* faces as they will be, each turned so that `fresh` comes first */
  struct flat spoke_of[MAX_SPOKES][2]; /* edges of the old faces that end at a vertex that goes */
  uint32_t old_count, new_count, spoke_count;
};

struct draft {
  /* Per vertex; linear in between: how far the map from the source to the surface moves what arrives there, at most. */
  double *bound;
  double limit, rounding, proven;
  struct overlay overlay;
};

static struct flat flatten(const struct overlay *o, struct lod_vec3 p, double bound) {
  struct lod_vec3 d = lod_vec3_subtract(p, o->origin);
  return (struct flat){lod_vec3_dot(o->axis[0], d), lod_vec3_dot(o->axis[1], d), lod_vec3_dot(o->axis[2], d), bound};
}

static double turn(const struct flat *a, const struct flat *b, const struct flat *c) {
  return (b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x);
}

static struct lod_vec3 normal_of(const struct lod_vec3 p[3]) {
  return lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
}

static bool faces_up(const struct overlay *o, const struct lod_vec3 p[3]) {
  struct lod_vec3 n = normal_of(p);
  double up = lod_vec3_dot(n, o->axis[2]);
  return up > 0 && up * up >= LEAST_COSINE * LEAST_COSINE * lod_vec3_length_squared(n);
}

static void old_face(const struct lod_surface *s, uint32_t f, struct lod_vec3 p[3]) {
  for (int k = 0; k < 3; k++)
    p[k] = s->position[s->face[f][k]];
}

/* The plane: across the mean normal of the old faces. */
static bool choose_plane(const struct lod_surface *s, const struct lod_attempt *attempt, struct lod_vec3 origin, struct overlay *o) {
  struct lod_vec3 n = {0, 0, 0}, p[3];
  for (uint32_t i = 0; i < attempt->change.changing_count; i++) {
    old_face(s, attempt->changing[i], p);
    n = lod_vec3_add(n, normal_of(p));
  }
  double length = lod_vec3_length(n);
  if (!(length > 0))
    return false;
  o->origin = origin;
  o->axis[2] = lod_vec3_scale(n, 1 / length);
  struct lod_vec3 m = o->axis[2];
  struct lod_vec3 across = fabs(m.x) < 0.6 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0);
  o->axis[0] = lod_vec3_normalize(lod_vec3_cross(across, m));
  o->axis[1] = lod_vec3_cross(m, o->axis[0]);
  return true;
}

static bool same_place(struct lod_vec3 p, struct lod_vec3 q) {
  return p.x == q.x && p.y == q.y && p.z == q.z;
}

/* Of a fan of triangles that all turn the same way, each goes around its centre by less than half a turn: how often the fan's border
 * crosses the ray from the centre along x is how often it goes around. */
static uint32_t crosses_ray(const struct flat *centre, const struct flat *from, const struct flat *to) {
  return from->y <= centre->y && to->y > centre->y;
}

static bool lay_out_old(const struct lod_collapser *c, const struct draft *draft, const struct lod_attempt *attempt, uint32_t a, uint32_t b,
                        bool b_stays, struct overlay *o, uint32_t *windings) {
  const struct lod_surface *s = &c->surface;
  o->old_count = attempt->change.changing_count;
  o->spoke_count = 0;
  for (uint32_t i = 0; i < o->old_count; i++) {
    struct lod_vec3 p[3];
    const uint32_t *v = s->face[attempt->changing[i]];
    old_face(s, attempt->changing[i], p);
    if (!faces_up(o, p))
      return false;
    struct flat *q = o->old_corner[i];
    for (int k = 0; k < 3; k++)
      q[k] = flatten(o, p[k], draft->bound[v[k]]);
    for (int k = 0; k < 3; k++) {
      int next = k == 2 ? 0 : k + 1, last = k == 0 ? 2 : k - 1;
      if (v[k] == a && b_stays)
        *windings += crosses_ray(&o->old[0], &q[next], &q[last]);
      if (v[k] != a && (v[k] != b || b_stays))
        continue;
      o->spoke_of[o->spoke_count][0] = q[k]; /* the one that runs on from there: each spoke once */
      o->spoke_of[o->spoke_count++][1] = q[next];
    }
  }
  return true;
}

/* Fills the overlay; false where a face is steep or upside down, or where the faces go around more than once. */
static bool lay_out(const struct lod_collapser *c, struct draft *draft, const struct lod_attempt *attempt, uint32_t a, uint32_t b,
                    struct lod_vec3 to) {
  const struct lod_surface *s = &c->surface;
  struct overlay *o = &draft->overlay;
  bool b_stays = same_place(to, s->position[b]);
  if (!choose_plane(s, attempt, to, o))
    return false;
  o->old[0] = flatten(o, s->position[a], draft->bound[a]);
  o->old[1] = flatten(o, s->position[b], draft->bound[b]);
  o->fresh = flatten(o, to, draft->bound[b]);
  o->new_count = attempt->change.fresh_count;
  uint32_t windings = 0;
  if (!lay_out_old(c, draft, attempt, a, b, b_stays, o, &windings))
    return false;
  for (uint32_t i = 0; i < o->new_count; i++) {
    const struct lod_candidate *face = &attempt->faces[i];
    const uint32_t *v = s->face[face->face];
    if (!faces_up(o, face->corner))
      return false;
    int first = v[0] == a || v[0] == b ? 0 : v[1] == a || v[1] == b ? 1 : 2;
    struct flat *q = o->new_corner[i];
    q[0] = o->fresh;
    for (int k = 1; k < 3; k++)
      q[k] = flatten(o, face->corner[(first + k) % 3], draft->bound[v[(first + k) % 3]]);
    if (!b_stays)
      windings += crosses_ray(&q[0], &q[1], &q[2]);
  }
  return windings == 1;
}

/* Weights of a triangle of the overlay under point q; false when q is not over it. */
static bool weights_under(const struct flat t[3], const struct flat *q, double w[3]) {
  w[0] = turn(&t[1], &t[2], q);
  w[1] = turn(&t[2], &t[0], q);
  w[2] = turn(&t[0], &t[1], q);
  double area = w[0] + w[1] + w[2], slack = -1e-12 * area;
  if (!(area > 0) || w[0] < slack || w[1] < slack || w[2] < slack)
    return false;
  for (int k = 0; k < 3; k++)
    w[k] /= area;
  return true;
}

/* The bound that the fresh vertex needs so that old vertex q is within what the new faces say there. */
static double bound_for_old(const struct overlay *o, const struct flat *q) {
  double w[3];
  for (uint32_t i = 0; i < o->new_count; i++) {
    const struct flat *t = o->new_corner[i];
    if (!weights_under(t, q, w))
      continue;
    double height = w[0] * t[0].z + w[1] * t[1].z + w[2] * t[2].z;
    double needed = q->bound + fabs(height - q->z) - w[1] * t[1].bound - w[2] * t[2].bound;
    return needed <= 0 ? 0 : w[0] > 0 ? needed / w[0] : INFINITY;
  }
  return INFINITY;
}

/* The same for its own place among the old faces. */
static double bound_for_fresh(const struct overlay *o) {
  double w[3];
  for (uint32_t i = 0; i < o->old_count; i++) {
    const struct flat *t = o->old_corner[i];
    if (weights_under(t, &o->fresh, w))
      return w[0] * t[0].bound + w[1] * t[1].bound + w[2] * t[2].bound + fabs(w[0] * t[0].z + w[1] * t[1].z + w[2] * t[2].z - o->fresh.z);
  }
  return INFINITY;
}

/* The same for where an old edge ab crosses the new edge from the fresh vertex to d. */
static double bound_for_crossing(const struct flat *a, const struct flat *b, const struct flat *fresh, const struct flat *d) {
  double a_side = turn(fresh, d, a), b_side = turn(fresh, d, b);
  if (a_side * b_side >= 0)
    return 0;
  double fresh_side = turn(a, b, fresh), d_side = turn(a, b, d);
  if (fresh_side * d_side >= 0)
    return 0;
  double t = a_side / (a_side - b_side), u = fresh_side / (fresh_side - d_side);
  double gap = fabs(a->z + t * (b->z - a->z) - (fresh->z + u * (d->z - fresh->z)));
  double needed = a->bound + t * (b->bound - a->bound) + gap - u * d->bound;
  return needed <= 0 ? 0 : u < 1 ? needed / (1 - u) : INFINITY;
}

/* The bound of the fresh vertex, that the new faces bound the map by what is linear between it and its neighbours: it must do so at the
 * corners of the overlay of old and new faces. INFINITY when there is no map; more than the limit may be any such number. */
static double bound_of(const struct lod_collapser *c, struct draft *draft, const struct lod_attempt *attempt, uint32_t a, uint32_t b,
                       struct lod_vec3 to) {
  if (!lay_out(c, draft, attempt, a, b, to))
    return INFINITY;
  const struct overlay *o = &draft->overlay;
  bool b_stays = same_place(to, c->surface.position[b]);
  double most = bound_for_old(o, &o->old[0]);
  if (b_stays)
    most = fmax(most, draft->bound[b]);
  else if (most <= draft->limit)
    most = fmax(most, fmax(bound_for_old(o, &o->old[1]), bound_for_fresh(o)));
  for (uint32_t i = 0; i < o->new_count && most <= draft->limit; i++)
    for (int k = 1; k < 3; k++) /* twice where two faces share the edge; each where b stays and the fan is open */
      for (uint32_t j = 0; j < o->spoke_count && (k == 1 || b_stays); j++)
        most = fmax(most, bound_for_crossing(&o->spoke_of[j][0], &o->spoke_of[j][1], &o->new_corner[i][0], &o->new_corner[i][k]));
  return most * (1 + 1e-9) + draft->rounding;
}

/* Any vertex of the faces that change: those with one that is suspect are always asked for. */
static bool is_suspect(const struct lod_collapser *c, const struct lod_attempt *attempt) {
  bool suspect = c->suspect == NULL;
  for (uint32_t i = 0; i < attempt->change.changing_count && !suspect; i++) {
    const uint32_t *v = c->surface.face[attempt->changing[i]];
    suspect = c->suspect[v[0]] || c->suspect[v[1]] || c->suspect[v[2]];
  }
  return suspect;
}

static enum lod_status try_edge(struct lod_collapser *c, uint32_t a, uint32_t b, struct draft *draft, struct lod_attempt *attempt) {
  struct lod_vec3 place[4];
  double cost[4];
  bool b_stays;
  /* Interior edges alone: vertices drained into lines would leave triangles from line to line, on which lines cannot collapse. */
  if (c->surface.kind[a] != LOD_VERTEX_INTERIOR || c->surface.kind[b] != LOD_VERTEX_INTERIOR)
    return LOD_OK;
  lod_collapser_placements(c, a, b, c->surface.kind[b] != LOD_VERTEX_INTERIOR, place, cost);
  if (cost[0] > c->gate * (c->quadric[a].weight + c->quadric[b].weight) || !lod_surface_can_collapse(&c->surface, a, b, &b_stays) ||
      !lod_attempt_gather(c, a, b, place[0], attempt) || attempt->change.changing_count > MAX_RING ||
      attempt->change.fresh_count > MOST_FRESH)
    return LOD_OK;
  double bound = bound_of(c, draft, attempt, a, b, place[0]);
  bool asks = c->guard != NULL && is_suspect(c, attempt);
  if (!(bound <= draft->limit) || (asks && !lod_guard_allows(c->guard, &c->surface, &attempt->change, a, b)))
    return LOD_OK;
  if (asks && c->suspect != NULL)
    c->suspect[b] = c->suspect[a] || c->suspect[b];
  lod_collapser_note_origin(c, a, b, place[0]);
  LOD_TRY(lod_surface_collapse(&c->surface, a, b, place[0]));
  lod_wedges_commit(&c->wedges, &attempt->change);
  lod_guard_follow(c->guard, &c->surface, attempt->changing, attempt->change.changing_count);
  draft->bound[b] = bound;
  draft->proven = fmax(draft->proven, bound);
  lod_quadric_add(&c->quadric[b], &c->quadric[a]);
  c->merged[a] = b;
  c->stamp[a]++;
  c->stamp[b]++;
  return LOD_OK;
}

/* Edges keep the entry that they began with: what changed around them since, and to whom their ends went, is looked at when their turn
 * comes. Costs mostly grow, so they are not late. */
static enum lod_status next_edge(struct lod_collapser *c, struct draft *draft, struct lod_attempt *attempt) {
  struct lod_queue_entry e = lod_queue_pop(c);
  uint32_t a = lod_survivor(c->merged, e.a), b = lod_survivor(c->merged, e.b);
  if (a == b)
    return LOD_OK;
  if (a != e.a || b != e.b || c->stamp[a] != e.stamp_a || c->stamp[b] != e.stamp_b)
    return lod_queue_push_edge(c, a, b);
  return try_edge(c, a, b, draft, attempt);
}

static enum lod_status drain(struct lod_collapser *c, struct draft *draft, struct lod_attempt *attempt,
                             const struct lod_progress *progress) {
  for (uint32_t popped = 1; c->heap_count > 0; popped++) {
    if (popped % CANCEL_EVERY == 0 && lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    LOD_TRY(next_edge(c, draft, attempt));
  }
  return LOD_OK;
}

/* Edges inside a block of neighbouring triangles, which the tree over the source tells, then the next block's. What is admitted depends on
 * bounds and gate and hardly on the order, and a block stays in the caches where the whole does not. */
static enum lod_status run_blocks(struct lod_collapser *c, struct draft *draft, struct lod_attempt *attempt, struct lod_arena *scratch,
                                  const struct lod_progress *progress) {
  struct lod_surface *s = &c->surface;
  uint32_t *block_of = LOD_NEW(scratch, s->vertex_count, uint32_t);
  if (block_of == NULL)
    return LOD_MEMORY;
  for (uint32_t slot = 0; slot < c->bvh->count; slot++)
    for (int k = 0; k < 3 && c->bvh->order[slot] < s->face_count && s->face[c->bvh->order[slot]][0] != LOD_NONE; k++)
      block_of[s->face[c->bvh->order[slot]][k]] = slot / BLOCK; /* the last one's */
  c->heap_count = 0;
  for (uint32_t slot = 0; slot < c->bvh->count; slot++) {
    uint32_t f = c->bvh->order[slot];
    for (int k = 0; f < s->face_count && k < 3 && s->face[f][0] != LOD_NONE; k++) {
      uint32_t a = s->face[f][k], b = s->face[f][k == 2 ? 0 : k + 1];
      if (a < b && block_of[a] == slot / BLOCK && block_of[b] == slot / BLOCK)
        LOD_TRY(lod_queue_push_edge(c, a, b));
    }
    if ((slot + 1) % BLOCK == 0)
      LOD_TRY(drain(c, draft, attempt, progress));
  }
  return drain(c, draft, attempt, progress);
}

enum lod_status lod_draft_run(struct lod_collapser *c, double limit, const struct lod_progress *progress, double *proven) {
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  struct draft *draft = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, 1, struct draft);
  struct lod_attempt *attempt = scratch == NULL ? NULL : LOD_NEW(scratch, 1, struct lod_attempt);
  if (c->bound == NULL)
    c->bound = LOD_NEW_ZERO(c->arena, c->surface.vertex_count, double);
  if (draft == NULL || attempt == NULL || c->bound == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  attempt->collapser = c;
  attempt->change.changing = attempt->changing;
  attempt->change.faces = attempt->faces;
  draft->limit = limit;
  draft->bound = c->bound;
  draft->proven = c->reached;
  draft->rounding = 2 * lod_tolerance_rounding(lod_mesh_magnitude(c->mesh));
  enum lod_status status = c->surface.live_faces > 2 * BLOCK ? run_blocks(c, draft, attempt, scratch, progress) : LOD_OK;
  if (status == LOD_OK)
    status = lod_queue_push_all(c);
  if (status == LOD_OK)
    status = drain(c, draft, attempt, progress);
  *proven = c->reached = draft->proven;
  lod_arena_destroy(scratch);
  return status;
}
