/* What is left to gain when no edge collapses at the places that quadrics name: other places, vertices that move, and another round.
 *
 * Based on: Hu, Yan, Bao, Alliez, Benes. Error-Bounded and Feature Preserving Surface Remeshing with Minimal Angle Improvement. 2017
 * (collapse, flip and relocate in turn under a hard bound). Ours: the places lie along the normal, because a surface that uses all of
 * epsilon runs alternately outside and inside of the source. */
#include <math.h>
#include <string.h>

#include "core/envelope/internal.h"
#include "core/envelope/quadric.h"

static struct lod_vec3 rounded(struct lod_vec3 p) {
  return lod_vec3_make((double)(float)p.x, (double)(float)p.y, (double)(float)p.z);
}

static uint64_t next_random(uint64_t *state) {
  uint64_t z = *state += 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

static double next_unit(uint64_t *state) {
  return (double)(next_random(state) >> 11) * 0x1p-53;
}

static struct lod_vec3 normal_around(const struct lod_surface *s, uint32_t v) {
  struct lod_vec3 n = {0, 0, 0};
  const uint32_t *ring = lod_surface_ring(s, v);
  for (uint32_t i = 0; i < s->ring_count[v]; i++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = s->position[s->face[ring[i]][k]];
    n = lod_vec3_add(n, lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
  }
  return lod_vec3_normalize(n);
}

enum {
  PLACES = 4, /* tried for an edge in one round */
  /* A trial costs about as many source triangles as the source has, times ten, over the faces: little per face is gained where there are
   * more than these. */
  MOST_FACES = 500,
  MOST_TRIALS = 8000,
  /* Where attributes are bounded few edges collapse at the places that quadrics name. */
  MOST_BOUNDED_FACES = 6000,
  MOST_BOUNDED_TRIALS = 60000,
};
static const double WORK = 2.5e8; /* trials, times source triangles */

/* Of the edges that do not collapse, this share is asked to turn in one round: were it all, they would turn back and forth. */
static const double FLIP_SHARE = 0.4;

struct polish {
  struct lod_collapser *c;
  struct lod_attempt attempt;
  uint64_t random, trials, most_trials;
};

static struct lod_vec3 shifted(struct polish *polish, struct lod_vec3 from, struct lod_vec3 normal, double along, double across) {
  struct lod_vec3 p = lod_vec3_add_scaled(from, normal, along * polish->c->epsilon);
  p.x += across * (2 * next_unit(&polish->random) - 1);
  p.y += across * (2 * next_unit(&polish->random) - 1);
  p.z += across * (2 * next_unit(&polish->random) - 1);
  return rounded(p);
}

/* At places of chance: between the ends or at their quadric's best, off along the normal. */
static enum lod_status collapse_edge(struct polish *polish, uint32_t a, uint32_t b, bool *done) {
  struct lod_collapser *c = polish->c;
  bool b_stays;
  *done = false;
  if (!lod_surface_can_collapse(&c->surface, a, b, &b_stays) || b_stays)
    return LOD_OK;
  struct lod_vec3 place[4], pa = c->surface.position[a], pb = c->surface.position[b];
  double cost[4];
  lod_collapser_placements(c, a, b, false, place, cost);
  struct lod_vec3 normal = lod_vec3_normalize(lod_vec3_add(normal_around(&c->surface, a), normal_around(&c->surface, b)));
  polish->attempt.change.witness = LOD_NONE;
  for (int i = 0; i < PLACES && !*done; i++) {
    double t = next_unit(&polish->random);
    struct lod_vec3 base = i % 2 == 0 ? place[0] : lod_vec3_add_scaled(pa, lod_vec3_subtract(pb, pa), t);
    struct lod_vec3 to = shifted(polish, base, normal, 2 * next_unit(&polish->random) - 1, 0.15 * lod_vec3_distance(pa, pb));
    polish->trials++;
    LOD_TRY(lod_attempt_collapse(c, a, b, to, &polish->attempt, done));
  }
  return LOD_OK;
}

static void add_fresh(struct polish *polish, uint32_t f, uint32_t a, uint32_t b, uint32_t c) {
  struct lod_change *change = &polish->attempt.change;
  struct lod_candidate *fresh = &polish->attempt.faces[change->face_count];
  const uint32_t v[3] = {a, b, c};
  for (int k = 0; k < 3; k++) {
    fresh->corner[k] = polish->c->surface.position[v[k]];
    fresh->vertex[k] = v[k];
    change->hints[change->face_count][k] = polish->c->near[v[k]];
  }
  fresh->face = f;
  polish->attempt.changing[change->face_count++] = f;
  change->changing_count = change->fresh_count = change->face_count;
  change->placed_count = 0;
  polish->c->face_mark[f] = polish->c->mark;
}

static struct lod_vec3 normal_of(const struct lod_vec3 p[3]) {
  return lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
}

/* Both new faces look the way that the old ones did together. */
static bool flip_is_flat(const struct polish *polish, struct lod_vec3 old) {
  for (int i = 0; i < 2; i++) {
    const struct lod_vec3 *p = polish->attempt.faces[i].corner;
    struct lod_vec3 n = normal_of(p);
    double edges = lod_vec3_distance_squared(p[0], p[1]) + lod_vec3_distance_squared(p[1], p[2]) + lod_vec3_distance_squared(p[2], p[0]);
    double length = lod_vec3_length(n);
    if (!(length > 0.01 * edges) || !(lod_vec3_dot(n, old) > polish->c->least_normal_dot * length * lod_vec3_length(old)))
      return false;
  }
  return true;
}

static void flip_wedges(struct polish *polish, uint32_t f, int k, uint32_t g, uint32_t other, uint32_t b) {
  const struct lod_surface *s = &polish->c->surface;
  const uint32_t *of_f = polish->c->wedges.corner[f], *of_g = polish->c->wedges.corner[g];
  uint32_t at_other = of_g[lod_surface_corner(s, g, other)], at_b = of_g[lod_surface_corner(s, g, b)], apex = of_f[(k + 2) % 3];
  const uint32_t fresh[2][3] = {{of_f[k], at_other, apex}, {at_other, at_b, apex}};
  for (int i = 0; i < 2; i++)
    memcpy(polish->attempt.faces[i].wedge, fresh[i], sizeof fresh[i]);
}

static enum lod_status flip_edge(struct polish *polish, uint32_t f, int k, bool *done) {
  struct lod_collapser *c = polish->c;
  struct lod_surface *s = &c->surface;
  uint32_t g;
  *done = false;
  if (!lod_surface_can_flip(s, f, k, &g))
    return LOD_OK;
  const uint32_t *v = s->face[f], *w = s->face[g];
  uint32_t a = v[k], b = v[(k + 1) % 3], apex = v[(k + 2) % 3];
  uint32_t other = w[0] != a && w[0] != b ? w[0] : w[1] != a && w[1] != b ? w[1] : w[2];
  struct lod_vec3 p[3] = {s->position[a], s->position[b], s->position[apex]}, q[3] = {p[1], p[0], s->position[other]};
  polish->attempt.change.face_count = 0;
  polish->attempt.change.witness = LOD_NONE;
  c->mark++;
  add_fresh(polish, f, a, other, apex);
  add_fresh(polish, g, other, b, apex);
  if (c->wedges.channels != 0)
    flip_wedges(polish, f, k, g, other, b);
  polish->trials++;
  if (!flip_is_flat(polish, lod_vec3_add(normal_of(p), normal_of(q))))
    return LOD_OK;
  enum lod_status status;
  bool admitted = lod_certificate_try(c->certificate, &polish->attempt.change, &status);
  LOD_TRY(status);
  if (!admitted || !lod_guard_allows(c->guard, s, &polish->attempt.change, LOD_NONE, LOD_NONE))
    return LOD_OK;
  LOD_TRY(lod_surface_flip(s, f, k, g));
  lod_wedges_commit(&c->wedges, &polish->attempt.change);
  lod_guard_follow(c->guard, s, polish->attempt.changing, 2);
  *done = true;
  return lod_certificate_commit(c->certificate, &polish->attempt.change);
}

static enum lod_status move_vertex(struct polish *polish, uint32_t v, bool *done) {
  struct lod_collapser *c = polish->c;
  struct lod_surface *s = &c->surface;
  *done = false;
  const uint32_t *ring = lod_surface_ring(s, v);
  double shortest = INFINITY;
  for (uint32_t i = 0; i < s->ring_count[v]; i++)
    for (int k = 0; k < 3; k++)
      if (s->face[ring[i]][k] != v)
        shortest = fmin(shortest, lod_vec3_distance(s->position[v], s->position[s->face[ring[i]][k]]));
  struct lod_vec3 to = shifted(polish, s->position[v], normal_around(s, v), next_unit(&polish->random) - 0.5, 0.2 * shortest);
  polish->trials++;
  polish->attempt.change.witness = LOD_NONE;
  if (!lod_attempt_gather(c, LOD_NONE, v, to, &polish->attempt))
    return LOD_OK;
  enum lod_status status;
  bool admitted = lod_certificate_try(c->certificate, &polish->attempt.change, &status);
  LOD_TRY(status);
  if (!admitted || !lod_guard_allows(c->guard, s, &polish->attempt.change, LOD_NONE, v))
    return LOD_OK;
  s->position[v] = to;
  lod_wedges_commit(&c->wedges, &polish->attempt.change);
  lod_guard_follow(c->guard, s, polish->attempt.changing, polish->attempt.change.changing_count);
  LOD_TRY(lod_certificate_commit(c->certificate, &polish->attempt.change));
  *done = true;
  return lod_collapser_update_after(c, v);
}

static bool spent(const struct polish *polish) {
  return polish->trials >= polish->most_trials;
}

/* Every edge collapses if it can, then a share of the others turn, then vertices move. */
static enum lod_status round_of(struct polish *polish, uint32_t *changed) {
  struct lod_collapser *c = polish->c;
  const struct lod_surface *s = &c->surface;
  bool done;
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 0; k < 3 && s->face[f][0] != LOD_NONE && !spent(polish); k++) {
      uint32_t a = s->face[f][k], b = s->face[f][(k + 1) % 3];
      if (s->kind[a] != s->kind[b] || (a > b && !(s->feature[f] >> k & 1)) || s->kind[a] == LOD_VERTEX_CORNER)
        continue;
      LOD_TRY(collapse_edge(polish, a, b, &done));
      *changed += done;
      if (done)
        LOD_TRY(lod_collapser_update_after(c, b));
    }
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 0; k < 3 && s->face[f][0] != LOD_NONE && !spent(polish); k++) {
      if (s->face[f][k] > s->face[f][(k + 1) % 3] || next_unit(&polish->random) > FLIP_SHARE)
        continue;
      LOD_TRY(flip_edge(polish, f, k, &done));
      *changed += done;
    }
  for (uint32_t v = 0; v < s->vertex_count && !spent(polish); v++) {
    if (s->ring_count[v] == 0 || s->kind[v] != LOD_VERTEX_INTERIOR)
      continue;
    LOD_TRY(move_vertex(polish, v, &done));
    *changed += done;
  }
  return LOD_OK;
}

enum lod_status lod_polish_run(struct lod_collapser *c, const struct lod_progress *progress) {
  bool bounded = c->wedges.bounded;
  if (c->settings.vertex_subset || c->surface.live_faces > (bounded ? MOST_BOUNDED_FACES : MOST_FACES))
    return LOD_OK;
  double trials = c->settings.polish * (bounded ? 4 : 1) * WORK / c->mesh->triangle_count;
  double most = c->settings.polish * (bounded ? MOST_BOUNDED_TRIALS : MOST_TRIALS);
  struct polish polish = {.c = c, .random = 1, .most_trials = (uint64_t)fmin(most, trials)};
  lod_attempt_init(c, &polish.attempt);
  for (uint32_t changed = 1; changed > 0 && !spent(&polish);) {
    if (lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    changed = 0;
    LOD_TRY(round_of(&polish, &changed));
  }
  return LOD_OK;
}
