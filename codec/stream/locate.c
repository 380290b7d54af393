/* Where in the finer level the base's vertices are.
 *
 * The base's vertices are taken in an order that starts at one and goes on to those with most neighbours found. The finer level around the
 * nearest of these is laid out in the plane as if its triangles were equilateral, and the base around it in its tangent plane; the affine
 * map between the two that suits the neighbours already found best, says where the vertex should be. Its place among the finer vertices
 * nearest to that is coded, mostly 0. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/step.h"

enum {
  PRIORITIES = 8,
  BALL = 48,
  BALLS = 512,
  FANS = 32,
  PAIRS = 24,
  CANDIDATES = 20,
  DEGREE = 64 /* neighbours of a vertex that are looked at */
};

struct models {
  struct lod_bit_model expected, gone[2], rank[2][CANDIDATES][16][8], near[16][4][4], shape[12][4][4], far[6][6][4];
  struct lod_mixer rank_mixer[CANDIDATES][2];
};

struct complex {
  float x, y;
};

/* Vertices around one, nearer ones first, and where they lie in the plane. Only the connectivity decides. */
struct ball {
  uint32_t middle, count; /* middle: LOD_NONE = an empty place */
  uint32_t vertices[BALL];
  struct complex plane[BALL];
  uint8_t hops[BALL];
};

/* A half-edge on a ball's rim: places of the corner opposite of it, and of its ends. */
struct rim {
  uint32_t half_edge;
  uint8_t apex, from, to;
};

/* Where a finer vertex is in ball number `stamp`. */
struct mark {
  uint32_t stamp, place;
};

struct search {
  struct step *step;
  struct models *models;
  uint32_t *queue_next, head[PRIORITIES], tail[PRIORITIES]; /* base vertices by number of neighbours found, first come first served */
  uint8_t *state;                                           /* base vertex: that number, or DONE */
  struct mark *marks;                                       /* of finer vertices */
  uint32_t stamp;
  struct ball *balls, *ball; /* the last ones, by their middle's number; the one in use */
  bool used[BALL];
  struct complex closed[FANS + 1], open[FANS + 1]; /* one triangle of so many around a vertex, around half of one */
  uint8_t *has_kept;                               /* component of the finer level */
  uint32_t expected;                               /* vertex: components begin in the order in which they are asked for */
};
enum { DONE = 255 };

static float distance(lod_v4 a, lod_v4 b) {
  lod_v4 d = a - b;
  d = d * d;
  return d[0] + d[1] + d[2];
}

static void keep(struct search *f, uint32_t base, uint32_t v) {
  struct step *s = f->step;
  s->kept[base] = v;
  s->estimates[v] = s->base.positions[base];
  s->estimated[v] = 2;
  if (s->component[v] != LOD_NONE)
    f->has_kept[s->component[v]] = 1;
}

/* ---- two planes ---- */

static struct complex times(struct complex a, struct complex b) {
  return (struct complex){a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x};
}

/* e^(i angle), by squaring a short series. */
static struct complex turn(double angle) {
  double x = angle / 64, xx = x * x, c = 1 - xx / 2 * (1 - xx / 12 * (1 - xx / 30)), s = x * (1 - xx / 6 * (1 - xx / 20 * (1 - xx / 42)));
  for (int i = 0; i < 6; i++) {
    double t = c * c - s * s;
    s = 2 * c * s;
    c = t;
  }
  return (struct complex){(float)c, (float)s};
}

/* ---- balls ---- */

static uint32_t add_place(struct search *f, uint32_t v, uint32_t hops, struct complex at) {
  struct ball *b = f->ball;
  const uint32_t place = b->count++;
  f->marks[v] = (struct mark){f->stamp, place};
  b->vertices[place] = v;
  b->hops[place] = (uint8_t)hops;
  b->plane[place] = at;
  return place;
}

/* Neighbours of the ball's middle, evenly around it; the half-edges between them are its first rim. Returns how many these are. */
static uint32_t lay_ring(struct search *f, uint32_t v, struct rim *rim) {
  const struct step *s = f->step;
  const uint32_t *opposite = s->connectivity.opposite;
  if (s->corners.first[v] == s->corners.first[v + 1])
    return 0;
  uint32_t start = s->corners.list[s->corners.first[v]], h = start, count = 1, last = 0;
  bool closed = false;
  for (uint32_t i = 0; i < FANS; i++) { /* back to where the fan begins */
    uint32_t o = opposite[h];
    if (o == LOD_NONE)
      break;
    o = lod_half_edge_next(o);
    closed = o == start;
    if (closed)
      break;
    h = o;
  }
  start = h;
  for (uint32_t e = h; count < FANS; count++) {
    e = opposite[lod_half_edge_previous(e)];
    if (e == LOD_NONE || e == start)
      break;
  }
  const struct complex step = closed ? f->closed[count] : f->open[count];
  struct complex at = {1, 0};
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t next = lod_half_edge_next(h), end = s->triangles[next / 3][(next + 1) % 3];
    if (i == 0)
      last = add_place(f, s->triangles[next / 3][next % 3], 1, at);
    at = times(at, step);
    const struct mark *mark = &f->marks[end];
    const uint32_t place = mark->stamp == f->stamp ? mark->place : add_place(f, end, 1, at);
    rim[i] = (struct rim){next, 0, (uint8_t)last, (uint8_t)place};
    last = place;
    h = opposite[lod_half_edge_previous(h)];
    if (h == LOD_NONE)
      return i + 1;
  }
  return count;
}

/* The ball in the plane: parallelograms over the rim's half-edges, one after the other; a vertex lies between the first two. */
static void make_ball(struct search *f, uint32_t v) {
  const struct step *s = f->step;
  struct ball *b = f->ball;
  struct rim rim[2 * BALL + FANS];
  bool once[BALL];
  b->middle = v;
  b->count = 0;
  add_place(f, v, 0, (struct complex){0, 0});
  uint32_t end = lay_ring(f, v, rim);
  for (uint32_t i = 0; i < end && b->count < BALL; i++) {
    const struct rim r = rim[i];
    const uint32_t o = s->connectivity.opposite[r.half_edge];
    if (o == LOD_NONE)
      continue;
    const uint32_t next = lod_half_edge_next(o), previous = lod_half_edge_previous(o), u = s->triangles[o / 3][previous % 3];
    const struct complex *x = b->plane, at = {x[r.from].x + x[r.to].x - x[r.apex].x, x[r.from].y + x[r.to].y - x[r.apex].y};
    if (f->marks[u].stamp == f->stamp) {
      const uint32_t place = f->marks[u].place;
      if (b->hops[place] > 1 && once[place]) {
        once[place] = false;
        b->plane[place] = (struct complex){(x[place].x + at.x) * 0.5f, (x[place].y + at.y) * 0.5f};
      }
      continue;
    }
    const uint32_t hops = 1u + (b->hops[r.from] < b->hops[r.to] ? b->hops[r.from] : b->hops[r.to]), place = add_place(f, u, hops, at);
    once[place] = true;
    rim[end++] = (struct rim){next, r.to, r.from, (uint8_t)place}; /* o runs from r.to to r.from */
    rim[end++] = (struct rim){previous, r.from, (uint8_t)place, r.to};
  }
}

/* The ball around v: made now, or not long ago. */
static void use_ball(struct search *f, uint32_t v) {
  struct ball *b = f->ball = &f->balls[v % BALLS];
  f->stamp++;
  if (b->middle != v) {
    make_ball(f, v);
    return;
  }
  for (uint32_t i = 0; i < b->count; i++)
    f->marks[b->vertices[i]] = (struct mark){f->stamp, i};
}

static lod_v4 cross(lod_v4 a, lod_v4 b) {
  return (lod_v4){a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0};
}

static float dot(lod_v4 a, lod_v4 b) {
  lod_v4 c = a * b;
  return c[0] + c[1] + c[2];
}

/* Two directions that span the base's tangent plane at a vertex. */
static void tangents(const struct step_base *b, uint32_t v, lod_v4 axes[2]) {
  const lod_v4 n = b->normals[v], x = {1, 0, 0, 0}, y = {0, 1, 0, 0};
  const lod_v4 a = cross(n, n[0] * n[0] < 0.5f ? x : y);
  const float length = dot(a, a);
  axes[0] = length > 0 ? a * (1 / sqrtf(length)) : x;
  axes[1] = length > 0 ? cross(n, axes[0]) : y;
}

/* Where `to` lies in that plane, as far away as it really is. */
static struct complex unfold(const lod_v4 axes[2], lod_v4 to) {
  struct complex z = {dot(axes[0], to), dot(axes[1], to)};
  const float flat = z.x * z.x + z.y * z.y, whole = dot(to, to), stretch = flat > 0 ? sqrtf(whole / flat) : 0;
  return (struct complex){z.x * stretch, z.y * stretch};
}

/* A vertex found in both planes. */
struct pair {
  struct complex w, z; /* in the finer level's, in the base's */
};

/* z = a w + b conj(w) + c: the affine map that takes the finer level's plane to the base's best near z = `at`. b, by which it is not a
 * similarity, is held small. */
struct affine {
  struct complex a, b, c;
};

static struct affine fit_map(const struct pair *pairs, uint32_t count, struct complex at) {
  struct complex w0 = {0, 0}, z0 = {0, 0}, w2 = {0, 0}, zc = {0, 0}, zw = {0, 0};
  float sum = 0, ww = 0, weights[PAIRS], reach = (at.x * at.x + at.y * at.y) * 0.1f + 1e-12f;
  for (uint32_t i = 0; i < count; i++) {
    const float dx = pairs[i].z.x - at.x, dy = pairs[i].z.y - at.y, weight = 1 / (dx * dx + dy * dy + reach);
    w0.x += weight * pairs[i].w.x, w0.y += weight * pairs[i].w.y;
    z0.x += weight * pairs[i].z.x, z0.y += weight * pairs[i].z.y;
    sum += weights[i] = weight;
  }
  w0.x /= sum, w0.y /= sum, z0.x /= sum, z0.y /= sum;
  for (uint32_t i = 0; i < count; i++) {
    const struct complex w = {pairs[i].w.x - w0.x, pairs[i].w.y - w0.y}, z = {pairs[i].z.x - z0.x, pairs[i].z.y - z0.y};
    const struct complex c = {w.x, -w.y}, cc = times(c, c), p = times(z, c), q = times(z, w);
    const float weight = weights[i] / sum;
    ww += weight * (w.x * w.x + w.y * w.y);
    w2.x += weight * cc.x, w2.y += weight * cc.y;
    zc.x += weight * p.x, zc.y += weight * p.y;
    zw.x += weight * q.x, zw.y += weight * q.y;
  }
  /* normal equations: ww a + conj(w)^2 b = z conj(w); w^2 a + (ww + small) b = z w */
  const float other = ww * 1.25f + 0.01f, determinant = ww * other - (w2.x * w2.x + w2.y * w2.y);
  const struct complex back = {w2.x, -w2.y}, p = times(w2, zw), q = times(back, zc);
  struct affine map = {{0, 0}, {0, 0}, z0};
  if (!(determinant > 1e-9f * ww * ww))
    return map;
  map.a = (struct complex){(other * zc.x - p.x) / determinant, (other * zc.y - p.y) / determinant};
  map.b = (struct complex){(ww * zw.x - q.x) / determinant, (ww * zw.y - q.y) / determinant};
  const struct complex aw = times(map.a, w0), bw = times(map.b, (struct complex){w0.x, -w0.y});
  map.c = (struct complex){z0.x - aw.x - bw.x, z0.y - aw.y - bw.y};
  return map;
}

/* ---- the order of the base's vertices ---- */

static void enqueue(struct search *f, uint32_t base, uint32_t priority) {
  f->queue_next[base] = LOD_NONE;
  if (f->tail[priority] == LOD_NONE)
    f->head[priority] = base;
  else
    f->queue_next[f->tail[priority]] = base;
  f->tail[priority] = base;
}

static void finish(struct search *f, uint32_t base, bool kept) {
  const struct lod_adjacency *n = &f->step->base.adjacency;
  f->state[base] = DONE;
  for (uint32_t i = n->first[base]; i < n->first[base + 1] && kept; i++) {
    uint32_t u = n->list[i];
    if (f->state[u] == DONE || f->state[u] == PRIORITIES - 1)
      continue;
    if (f->state[u] == 0)
      enqueue(f, u, f->state[u] = 1);
    else
      f->state[u]++; /* moves up when it is met in its old queue */
  }
}

static uint32_t dequeue(struct search *f) {
  for (uint32_t p = PRIORITIES; p-- > 1;)
    while (f->head[p] != LOD_NONE) {
      uint32_t base = f->head[p];
      f->head[p] = f->queue_next[base];
      if (f->head[p] == LOD_NONE)
        f->tail[p] = LOD_NONE;
      if (f->state[base] == DONE)
        continue;
      if (f->state[base] > p) {
        enqueue(f, base, f->state[base]);
        p = f->state[base] + 1u;
        break;
      }
      return base;
    }
  return LOD_NONE;
}

/* ---- coding ---- */

/* A vertex by its number, or none. Returns false where the stream makes no sense. */
static bool code_explicit(struct search *f, uint32_t base, uint32_t actual, int context) {
  struct step *s = f->step;
  if (lod_coder_bit(&s->coder, &f->models->gone[context], LOD_ADAPT, actual == LOD_NONE)) {
    finish(f, base, false);
    return true;
  }
  while (f->expected < s->header.vertices && s->component[f->expected] != LOD_NONE && f->has_kept[s->component[f->expected]])
    f->expected++;
  uint32_t v = f->expected;
  if (!lod_coder_bit(&s->coder, &f->models->expected, LOD_ADAPT, actual == f->expected)) {
    int bits = 0;
    while (bits < 32 && (uint64_t)s->header.vertices > (uint64_t)1 << bits)
      bits++;
    v = lod_coder_raw(&s->coder, actual, bits);
  }
  if (v >= s->header.vertices || s->estimated[v] == 2)
    return false;
  keep(f, base, v);
  finish(f, base, true);
  return true;
}

/* Vertices of the ball that the base vertex may be, nearest to where it should be first: sorted as far as anybody asked. */
struct candidates {
  uint32_t count, sorted;
  uint8_t place[BALL];  /* in the ball */
  float distance[BALL]; /* squared, in edges of the finer level */
};

/* The i-th of them; of equal ones that which comes first in the ball. */
static void sort_to(struct candidates *c, uint32_t i) {
  for (; c->sorted <= i; c->sorted++) {
    uint32_t best = c->sorted;
    for (uint32_t k = best + 1; k < c->count; k++)
      if (c->distance[k] < c->distance[best])
        best = k;
    const float distance = c->distance[best];
    const uint8_t place = c->place[best];
    for (uint32_t k = best; k > c->sorted; k--) { /* the others stay in order */
      c->distance[k] = c->distance[k - 1];
      c->place[k] = c->place[k - 1];
    }
    c->distance[c->sorted] = distance;
    c->place[c->sorted] = place;
  }
}

/* The found neighbour that is nearest to a base vertex. */
static uint32_t find_anchor(const struct search *f, uint32_t base) {
  const struct step *s = f->step;
  const struct lod_adjacency *n = &s->base.adjacency;
  uint32_t anchor = LOD_NONE;
  float nearest = 0;
  for (uint32_t i = n->first[base]; i < n->first[base + 1]; i++) {
    uint32_t u = n->list[i];
    float d = s->kept[u] == LOD_NONE ? 0 : distance(s->base.positions[base], s->base.positions[u]);
    if (s->kept[u] != LOD_NONE && (anchor == LOD_NONE || d < nearest)) {
      anchor = u;
      nearest = d;
    }
  }
  return anchor;
}

/* The found neighbours of base vertex `of` that lie in the ball. */
static uint32_t gather(struct search *f, uint32_t of, lod_v4 origin, const lod_v4 axes[2], struct pair pairs[PAIRS], uint32_t count) {
  const struct step *s = f->step;
  const struct lod_adjacency *n = &s->base.adjacency;
  for (uint32_t i = n->first[of]; i < n->first[of + 1] && i < n->first[of] + DEGREE && count < PAIRS; i++) {
    uint32_t u = n->list[i], v = s->kept[u];
    if (v == LOD_NONE || f->marks[v].stamp != f->stamp)
      continue;
    const uint32_t place = f->marks[v].place;
    if (place == 0 || f->used[place])
      continue;
    f->used[place] = true;
    pairs[count++] = (struct pair){f->ball->plane[place], unfold(axes, s->base.positions[u] - origin)};
  }
  return count;
}

static void find_candidates(struct search *f, uint32_t base, struct candidates *candidates) {
  struct step *s = f->step;
  const uint32_t anchor = find_anchor(f, base);
  const lod_v4 origin = s->base.positions[anchor];
  lod_v4 axes[2];
  struct pair pairs[PAIRS] = {{{0, 0}, {0, 0}}};
  use_ball(f, s->kept[anchor]);
  const struct ball *ball = f->ball;
  tangents(&s->base, anchor, axes);
  memset(f->used, 0, sizeof f->used);
  const struct complex z = unfold(axes, s->base.positions[base] - origin);
  const struct affine map = fit_map(pairs, gather(f, anchor, origin, axes, pairs, gather(f, base, origin, axes, pairs, 1)), z);
  const float scale = map.a.x * map.a.x + map.a.y * map.a.y + map.b.x * map.b.x + map.b.y * map.b.y, unit = scale > 0 ? 1 / scale : 0;
  uint32_t count = 0;
  for (uint32_t i = 1; i < ball->count; i++) {
    const struct complex w = ball->plane[i], c = {w.x, -w.y}, aw = times(map.a, w), bw = times(map.b, c);
    const float dx = aw.x + bw.x + map.c.x - z.x, dy = aw.y + bw.y + map.c.y - z.y;
    candidates->distance[count] = (dx * dx + dy * dy) * unit;
    candidates->place[count] = (uint8_t)i;
    count += s->estimated[ball->vertices[i]] != 2;
  }
  candidates->count = count;
  candidates->sorted = 0;
}

/* How far ahead of the next one a candidate is: 0 (level) to 15. */
static uint32_t lead(float nearer, float farther) {
  uint32_t n = 0;
  static const float kSteps[15] = {1.02f, 1.05f, 1.1f, 1.2f, 1.35f, 1.5f, 1.8f, 2.2f, 2.8f, 3.5f, 5, 8, 14, 30, 80};
  while (n < 15 && farther > kSteps[n] * nearer)
    n++;
  return n;
}

/* How many neighbours of a vertex are found, up to 3, and how many there are, up to 11: found vertices are seldom side by side. */
static uint32_t surroundings(const struct search *f, uint32_t v, uint32_t *valence) {
  const struct lod_adjacency *n = &f->step->adjacency;
  uint32_t found = 0;
  *valence = n->first[v + 1] - n->first[v];
  for (uint32_t i = 0; i < *valence && i < DEGREE && found < 3; i++)
    found += f->step->estimated[n->list[n->first[v] + i]] == 2;
  *valence = *valence < 11 ? *valence : 11;
  return found;
}

static uint32_t hops_of(uint32_t hops) {
  return hops < 5 ? hops : 5;
}

static bool code_near(struct search *f, uint32_t base, uint32_t actual) {
  struct step *s = f->step;
  struct candidates near;
  find_candidates(f, base, &near);
  const uint32_t *vertices = f->ball->vertices, count = near.count < CANDIDATES ? near.count : CANDIDATES;
  const uint32_t anchors = f->state[base] < 8 ? f->state[base] : 7;
  for (uint32_t i = 0; i < count; i++) {
    sort_to(&near, i + 2 < count ? i + 2 : count - 1);
    const float spread = i + 1 < count ? near.distance[i + 1] : 1e30f;
    const uint32_t v = vertices[near.place[i]], hops = hops_of(f->ball->hops[near.place[i]]);
    uint32_t ahead = lead(near.distance[i], spread), third = i + 2 < count ? lead(near.distance[i], near.distance[i + 2]) : 15;
    uint32_t place = i < 3 ? i : 3, valence, beside = surroundings(f, v, &valence);
    struct lod_bit_model *models[5] = {&f->models->rank[0][i][ahead][anchors], &f->models->rank[1][i][third][ahead / 2],
                                       &f->models->near[lead(0.02f, near.distance[i])][beside][place],
                                       &f->models->shape[valence][beside][place],
                                       &f->models->far[hops][hops_of(f->ball->hops[near.place[0]])][place]};
    if (!lod_coder_mix(&s->coder, models, 5, &f->models->rank_mixer[i][beside > 0], LOD_ADAPT, v == actual))
      continue;
    keep(f, base, v);
    finish(f, base, true);
    return true;
  }
  return code_explicit(f, base, actual, 1);
}

static bool allocate(struct search *f) {
  struct step *s = f->step;
  const uint32_t bases = s->base.vertex_count, vertices = s->header.vertices;
  f->models = lod_coder_models(&s->coder, sizeof *f->models, s->scratch);
  f->queue_next = LOD_NEW(s->scratch, bases, uint32_t);
  f->state = LOD_NEW_ZERO(s->scratch, bases, uint8_t);
  f->marks = LOD_NEW_ZERO(s->scratch, vertices, struct mark);
  const uint32_t balls = vertices < BALLS ? vertices : BALLS;
  f->balls = LOD_NEW(s->scratch, balls, struct ball);
  f->has_kept = LOD_NEW_ZERO(s->scratch, s->connectivity.component_count, uint8_t);
  s->kept = LOD_NEW(s->scratch, bases, uint32_t);
  s->estimates = LOD_NEW_ZERO(s->scratch, (size_t)vertices + 1, lod_v4); /* the last one stays 0: geometry.c */
  s->estimated = LOD_NEW_ZERO(s->scratch, vertices, uint8_t);
  memset(f->head, 0xff, sizeof f->head);
  memset(f->tail, 0xff, sizeof f->tail);
  if (f->models == NULL || f->queue_next == NULL || f->state == NULL || f->marks == NULL || f->balls == NULL || f->has_kept == NULL ||
      s->kept == NULL || s->estimates == NULL || s->estimated == NULL)
    return false;
  memset(s->kept, 0xff, (size_t)bases * sizeof *s->kept);
  for (uint32_t i = 0; i < balls; i++)
    f->balls[i].middle = LOD_NONE;
  for (int i = 1; i <= FANS; i++) {
    f->closed[i] = turn(6.283185307179586 / i);
    f->open[i] = turn(3.141592653589793 / i);
  }
  return true;
}

enum lod_status lod_step_locate(struct step *s) {
  struct search f = {.step = s};
  if (!allocate(&f))
    return LOD_MEMORY;
  const size_t before = s->coder.out_size;
  for (uint32_t seed = 0;;) {
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "kept vertices");
    uint32_t base = dequeue(&f);
    const bool near = base != LOD_NONE;
    while (!near && seed < s->base.vertex_count && f.state[seed] == DONE)
      seed++;
    if (!near && seed == s->base.vertex_count)
      break;
    base = near ? base : seed;
    uint32_t actual = LOD_NONE;
    if (s->request != NULL && s->request->kept[s->base.order[base]] != LOD_NONE)
      actual = s->target[s->request->kept[s->base.order[base]]];
    if (!(near ? code_near(&f, base, actual) : code_explicit(&f, base, actual, 0)))
      return lod_step_bad(s, "kept vertices");
  }
  s->statistics->match += 8.0 * (double)(s->coder.out_size - before);
  return LOD_OK;
}
