/* Where in the finer level the base's vertices are.
 *
 * The base's vertices are taken in an order that starts at one and goes to those with most neighbours found. Meanwhile the finer level gets
 * estimated positions around what is found: averages inside, and outside parallelograms, as if its triangles went on as they came. A base
 * vertex is then most likely the vertex whose estimate lies nearest to it: its place in that ranking is coded, mostly 0. */
#include <stdlib.h>
#include <string.h>

#include "codec/stream/step.h"

enum { PRIORITIES = 8, BALL = 48, CANDIDATES = 12, REACH = 2, DEGREE = 64 /* neighbours of a vertex that are looked at */ };

struct models {
  struct lod_bit_model expected, gone[2], rank[3][CANDIDATES + 1][16][8];
  struct lod_mixer rank_mixer[CANDIDATES + 1];
};

struct search {
  struct step *step;
  struct models *models;
  uint32_t *queue_next, head[PRIORITIES], tail[PRIORITIES]; /* base vertices by number of neighbours found, first come first served */
  uint8_t *state;                                           /* base vertex: that number, or DONE */
  uint32_t *seen, stamp;                                    /* fine vertex: visited in ball `stamp` */
  uint32_t ball[BALL];
  uint8_t hops[BALL];
  uint8_t *has_kept; /* component of the finer level */
  uint32_t expected; /* vertex: components begin in the order in which they are asked for */
};
enum { DONE = 255 };

static float distance(lod_v4 a, lod_v4 b) {
  lod_v4 d = a - b;
  d = d * d;
  return d[0] + d[1] + d[2];
}

/* ---- balls ---- */

/* Vertices around v, nearest by number of edges first: at most BALL, at most `hops` away. */
static uint32_t grow_ball(struct search *f, uint32_t v, int hops) {
  const struct lod_adjacency *n = &f->step->adjacency;
  uint32_t count = 0;
  f->stamp++;
  f->seen[v] = f->stamp;
  f->hops[count] = 0;
  f->ball[count++] = v;
  for (uint32_t i = 0; i < count && f->hops[i] < hops; i++)
    for (uint32_t k = n->first[f->ball[i]], end = n->first[f->ball[i] + 1]; k < end && count < BALL; k++) {
      uint32_t u = n->list[k];
      if (k - n->first[f->ball[i]] == DEGREE)
        break;
      if (f->seen[u] == f->stamp)
        continue;
      f->seen[u] = f->stamp;
      f->hops[count] = (uint8_t)(f->hops[i] + 1);
      f->ball[count++] = u;
    }
  return count;
}

/* Where v seems to lie. */
static void estimate(struct step *s, uint32_t v) {
  const struct lod_adjacency *n = &s->adjacency, *corners = &s->corners;
  const lod_v4 *e = s->estimates;
  lod_v4 sum = {0, 0, 0, 0}, plain = {0, 0, 0, 0};
  uint32_t known = 0, fans = 0, degree = n->first[v + 1] - n->first[v];
  degree = degree > 32 ? 32 : degree;
  for (uint32_t i = n->first[v]; i < n->first[v] + degree; i++)
    if (s->estimated[n->list[i]]) {
      plain += e[n->list[i]];
      known++;
    }
  if (known == 0)
    return;
  if (known < degree)
    for (uint32_t i = corners->first[v]; i < corners->first[v + 1] && i < corners->first[v] + 32; i++) {
      uint32_t h = lod_half_edge_next(corners->list[i]), o = s->connectivity.opposite[h];
      if (o == LOD_NONE)
        continue;
      uint32_t b = s->triangles[h / 3][h % 3], c = s->triangles[h / 3][(h + 1) % 3], a = s->triangles[o / 3][(o + 2) % 3];
      if (!s->estimated[a] || !s->estimated[b] || !s->estimated[c] || a == v)
        continue;
      sum += e[b] + e[c] - e[a];
      fans++;
    }
  s->estimates[v] = fans > 0 ? sum / (float)fans : plain / (float)known;
  s->estimated[v] = 1;
}

static void keep(struct search *f, uint32_t base, uint32_t v) {
  struct step *s = f->step;
  s->kept[base] = v;
  s->estimates[v] = s->base.positions[base];
  s->estimated[v] = 2;
  if (s->component[v] != LOD_NONE)
    f->has_kept[s->component[v]] = 1;
  uint32_t count = grow_ball(f, v, REACH);
  for (uint32_t i = 1; i < count; i++)
    if (s->estimated[f->ball[i]] < 2)
      estimate(s, f->ball[i]);
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

struct candidate {
  uint32_t vertex;
  float distance;
};

static uint32_t find_candidates(struct search *f, uint32_t base, struct candidate candidates[CANDIDATES]) {
  struct step *s = f->step;
  const struct lod_adjacency *n = &s->base.adjacency;
  const lod_v4 x = s->base.positions[base];
  uint32_t anchor = LOD_NONE, count = 0;
  float nearest = 0;
  for (uint32_t i = n->first[base]; i < n->first[base + 1]; i++) {
    uint32_t u = n->list[i];
    if (s->kept[u] == LOD_NONE)
      continue;
    float d = distance(x, s->base.positions[u]);
    if (anchor == LOD_NONE || d < nearest) {
      anchor = s->kept[u];
      nearest = d;
    }
  }
  uint32_t ball = grow_ball(f, anchor, 5);
  for (uint32_t i = 1; i < ball; i++) {
    uint32_t v = f->ball[i];
    if (s->estimated[v] != 1)
      continue;
    float d = distance(x, s->estimates[v]);
    uint32_t k = count < CANDIDATES ? count++ : CANDIDATES;
    while (k > 0 && d < candidates[k - 1].distance) {
      if (k < CANDIDATES)
        candidates[k] = candidates[k - 1];
      k--;
    }
    if (k < CANDIDATES)
      candidates[k] = (struct candidate){v, d};
  }
  return count;
}

/* How far ahead of the next one a candidate is: 0 (level) to 15. */
static uint32_t lead(float nearer, float farther) {
  uint32_t n = 0;
  static const float kSteps[15] = {1.02f, 1.05f, 1.1f, 1.2f, 1.35f, 1.5f, 1.8f, 2.2f, 2.8f, 3.5f, 5, 8, 14, 30, 80};
  while (n < 15 && farther > kSteps[n] * nearer)
    n++;
  return n;
}

static bool code_near(struct search *f, uint32_t base, uint32_t actual) {
  struct step *s = f->step;
  struct candidate candidates[CANDIDATES];
  uint32_t count = find_candidates(f, base, candidates);
  uint32_t anchors = f->state[base] < 8 ? f->state[base] : 7, rank = 0;
  while (rank < count && candidates[rank].vertex != actual)
    rank++;
  for (uint32_t i = 0; i < count; i++) {
    float spread = i + 1 < count ? candidates[i + 1].distance : 1e30f;
    uint32_t ahead = lead(candidates[i].distance, spread),
             third = i + 2 < count ? lead(candidates[i].distance, candidates[i + 2].distance) : 15;
    struct lod_bit_model *models[3] = {&f->models->rank[0][i][ahead][anchors], &f->models->rank[1][i][third][ahead / 2],
                                       &f->models->rank[2][i][0][anchors]};
    if (!lod_coder_mix(&s->coder, models, 3, &f->models->rank_mixer[i], LOD_ADAPT, rank == i))
      continue;
    keep(f, base, candidates[i].vertex);
    finish(f, base, true);
    return true;
  }
  return code_explicit(f, base, actual, 1);
}

static bool allocate(struct search *f) {
  struct step *s = f->step;
  const uint32_t bases = s->base.vertex_count, vertices = s->header.vertices;
  f->models = LOD_NEW_ZERO(s->scratch, 1, struct models);
  f->queue_next = LOD_NEW(s->scratch, bases, uint32_t);
  f->state = LOD_NEW_ZERO(s->scratch, bases, uint8_t);
  f->seen = LOD_NEW_ZERO(s->scratch, vertices, uint32_t);
  f->has_kept = LOD_NEW_ZERO(s->scratch, s->connectivity.component_count, uint8_t);
  s->kept = LOD_NEW(s->scratch, bases, uint32_t);
  s->estimates = LOD_NEW_ZERO(s->scratch, vertices, lod_v4);
  s->estimated = LOD_NEW_ZERO(s->scratch, vertices, uint8_t);
  memset(f->head, 0xff, sizeof f->head);
  memset(f->tail, 0xff, sizeof f->tail);
  if (f->models == NULL || f->queue_next == NULL || f->state == NULL || f->seen == NULL || f->has_kept == NULL || s->kept == NULL ||
      s->estimates == NULL || s->estimated == NULL)
    return false;
  memset(s->kept, 0xff, (size_t)bases * sizeof *s->kept);
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
