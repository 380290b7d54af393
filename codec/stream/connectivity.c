#include "codec/stream/connectivity.h"

#include <string.h>

/* An edge of the front: it goes from `origin` to the next node's origin, and the triangle to its left is not known yet. */
struct node {
  uint32_t origin, next, previous;
  uint32_t twin; /* the known triangle's half-edge, which runs the other way */
  uint32_t far;  /* encoding: half-edge of the cut mesh on the unknown side, LOD_NONE = none */
  uint32_t queue_next, queue_previous;
  uint8_t bucket;
  uint8_t state;
};
enum { OPEN, DEAD /* nothing lies beyond it */, GONE };

enum { BUCKETS = 16, MOST = 11 /* triangles of a vertex, as contexts tell them apart */, NEAR = 32 };
enum operation { OP_BORDER, OP_NEW, OP_LEFT, OP_RIGHT, OP_JOIN };

/* Everything that learns. */
struct models {
  struct lod_bit_model more, border[3][MOST + 1][MOST + 1][16], fresh[5][4096], join[2][1024], side[2][1024], closes, far;
  struct lod_mixer border_mixer[8], fresh_mixer[16], join_mixer[8], side_mixer[8];
  struct lod_bit_model backward;
  struct lod_number_model near;
};

struct front {
  struct lod_coder *coder;
  const struct lod_cut *cut;
  struct lod_connectivity *out;
  struct models *models;
  struct node *nodes;
  uint32_t node_count, max_vertices, max_components;
  uint32_t head[BUCKETS], tail[BUCKETS];
  uint32_t *around;  /* vertex -> triangles known */
  uint32_t last;     /* the operations before, 3 bits each */
  uint32_t *number;  /* encoding: vertex of the cut mesh -> vertex */
  uint32_t *node_of; /* encoding: half-edge of the cut mesh -> node whose `far` it is */
  uint8_t *done;     /* encoding: triangle of the cut mesh */
  bool bad;
};

/* ---- which edge is next ---- */

static void unqueue(struct front *f, uint32_t n) {
  struct node *node = &f->nodes[n];
  if (node->bucket == BUCKETS)
    return;
  if (node->queue_previous != LOD_NONE)
    f->nodes[node->queue_previous].queue_next = node->queue_next;
  else
    f->head[node->bucket] = node->queue_next;
  if (node->queue_next != LOD_NONE)
    f->nodes[node->queue_next].queue_previous = node->queue_previous;
  else
    f->tail[node->bucket] = node->queue_previous;
  node->bucket = BUCKETS;
}

/* The more triangles the vertices of an edge have, the sooner its turn: vertices are closed one after the other and the front stays short.
 */
static void queue(struct front *f, uint32_t n) {
  struct node *node = &f->nodes[n];
  if (node->state != OPEN)
    return;
  uint32_t a = f->around[node->origin], b = f->around[f->nodes[node->next].origin], most = a > b ? a : b;
  uint8_t bucket = (uint8_t)(most < BUCKETS ? most : BUCKETS - 1);
  if (bucket == node->bucket)
    return;
  unqueue(f, n);
  node->bucket = bucket;
  node->queue_next = LOD_NONE;
  node->queue_previous = f->tail[bucket];
  if (f->tail[bucket] != LOD_NONE)
    f->nodes[f->tail[bucket]].queue_next = n;
  else
    f->head[bucket] = n;
  f->tail[bucket] = n;
}

static uint32_t next_gate(const struct front *f) {
  for (int b = BUCKETS; b-- > 0;)
    if (f->head[b] != LOD_NONE)
      return f->head[b];
  return LOD_NONE;
}

/* ---- building ---- */

static uint32_t add_node(struct front *f, uint32_t origin, uint32_t twin, uint32_t far) {
  uint32_t n = f->node_count++;
  f->nodes[n] = (struct node){.origin = origin, .twin = twin, .far = far, .bucket = BUCKETS};
  if (f->cut != NULL && far != LOD_NONE)
    f->node_of[far] = n;
  return n;
}

static void set_edge(struct front *f, uint32_t n, uint32_t twin, uint32_t far) {
  f->nodes[n].twin = twin;
  f->nodes[n].far = far;
  if (f->cut != NULL && far != LOD_NONE)
    f->node_of[far] = n;
}

static void link(struct front *f, uint32_t a, uint32_t b) {
  f->nodes[a].next = b;
  f->nodes[b].previous = a;
}

static void glue(struct front *f, uint32_t h, uint32_t n) {
  f->out->opposite[h] = f->nodes[n].twin;
  f->out->opposite[f->nodes[n].twin] = h;
  unqueue(f, n);
  f->nodes[n].state = GONE;
}

static uint32_t add_vertex(struct front *f, uint32_t source, uint32_t component) {
  uint32_t v = f->out->vertex_count;
  if (v >= f->max_vertices) {
    f->bad = true;
    return 0;
  }
  f->out->vertex_count++;
  f->around[v] = 0;
  f->out->component[v] = component;
  if (f->cut != NULL) {
    f->number[source] = v;
    f->out->source_vertices[v] = source;
  }
  return v;
}

/* Triangle (a, b, v), whose half-edge 0 is glued to `twin` (LOD_NONE: to nothing yet) and is `source` in the cut mesh. Returns its
 * half-edge 0.
 */
static uint32_t add_triangle(struct front *f, uint32_t a, uint32_t b, uint32_t v, uint32_t twin, uint32_t source) {
  struct lod_connectivity *out = f->out;
  uint32_t t = out->triangle_count++;
  out->triangles[t][0] = a;
  out->triangles[t][1] = b;
  out->triangles[t][2] = v;
  f->around[a]++;
  f->around[b]++;
  f->around[v]++;
  if (twin != LOD_NONE) {
    out->opposite[3 * t] = twin;
    out->opposite[twin] = 3 * t;
  }
  if (f->cut != NULL) {
    out->source_half_edges[t] = source;
    f->done[source / 3] = 1;
  }
  return 3 * t;
}

static uint32_t far_of(const struct front *f, uint32_t source) {
  return f->cut != NULL ? f->cut->opposite[source] : LOD_NONE;
}

static void begin_component(struct front *f, uint32_t source) {
  uint32_t h[3] = {source, 0, 0}, v[3], component = f->out->component_count++;
  if (f->cut != NULL) {
    h[1] = lod_half_edge_next(source);
    h[2] = lod_half_edge_previous(source);
  }
  for (int i = 0; i < 3; i++)
    v[i] = add_vertex(f, f->cut != NULL ? f->cut->corner[h[i]] : 0, component);
  if (f->bad)
    return;
  uint32_t e = add_triangle(f, v[0], v[1], v[2], LOD_NONE, source);
  uint32_t n0 = add_node(f, v[1], e, far_of(f, h[0])); /* the front runs the other way */
  uint32_t n1 = add_node(f, v[2], e + 1, far_of(f, h[1]));
  uint32_t n2 = add_node(f, v[0], e + 2, far_of(f, h[2]));
  link(f, n0, n2);
  link(f, n2, n1);
  link(f, n1, n0);
  queue(f, n0);
  queue(f, n1);
  queue(f, n2);
}

/* ---- contexts ---- */

struct gate {
  uint32_t n, previous, next;
  uint32_t a, b;
  uint32_t ta, tb, tp, tn, to; /* triangles of a, b, the vertex before, the one behind, the one across */
  bool dead_previous, dead_next, three;
};

static uint32_t around(const struct front *f, uint32_t v) {
  return f->around[v] < MOST ? f->around[v] : MOST;
}

static struct gate look(const struct front *f, uint32_t n) {
  const struct node *node = &f->nodes[n];
  struct gate g = {.n = n, .previous = node->previous, .next = node->next, .a = node->origin, .b = f->nodes[node->next].origin};
  g.ta = around(f, g.a);
  g.tb = around(f, g.b);
  g.tp = around(f, f->nodes[g.previous].origin);
  g.tn = around(f, f->nodes[f->nodes[g.next].next].origin);
  g.to = around(f, f->out->triangles[node->twin / 3][(node->twin + 2) % 3]);
  g.dead_previous = f->nodes[g.previous].state == DEAD;
  g.dead_next = f->nodes[g.next].state == DEAD;
  g.three = f->nodes[g.next].next == g.previous;
  return g;
}

enum { SIDES = MOST + 1 };

static enum operation code_operation(struct front *f, const struct gate *g, enum operation op) {
  struct lod_coder *c = f->coder;
  struct models *m = f->models;
  const uint32_t dead = (uint32_t)g->dead_previous + 2 * (uint32_t)g->dead_next, ends = g->ta * SIDES + g->tb, last = f->last & 63;
  struct lod_bit_model *border[3] = {&m->border[0][g->ta][g->tb][dead], &m->border[1][g->to][last & 7][dead],
                                     &m->border[2][last >> 3][last & 7][dead]};
  if (lod_coder_mix(c, border, 3, &m->border_mixer[dead], LOD_ADAPT_SLOW, op == OP_BORDER))
    return OP_BORDER;
  const uint32_t shape = dead * 2 + g->three;
  struct lod_bit_model *fresh[5] = {&m->fresh[0][ends * 8 + shape], &m->fresh[1][(g->ta * SIDES + g->tp) * 2 + g->dead_previous],
                                    &m->fresh[2][(g->tb * SIDES + g->tn) * 2 + g->dead_next], &m->fresh[3][last * 8 + shape],
                                    &m->fresh[4][(g->to * SIDES + (g->ta + g->tb) / 2) * 8 + shape]};
  if (lod_coder_mix(c, fresh, 5, &m->fresh_mixer[shape], LOD_ADAPT_SLOW, op == OP_NEW))
    return OP_NEW;
  if (g->dead_previous && g->dead_next)
    return OP_JOIN;
  struct lod_bit_model *join[2] = {&m->join[0][ends * 4 + dead], &m->join[1][last * 8 + shape]};
  if (lod_coder_mix(c, join, 2, &m->join_mixer[shape], LOD_ADAPT_SLOW, op == OP_JOIN))
    return OP_JOIN;
  if (g->dead_previous || g->dead_next)
    return g->dead_previous ? OP_RIGHT : OP_LEFT;
  const uint32_t three = g->three ? SIDES * SIDES : 0;
  struct lod_bit_model *side[2] = {&m->side[0][ends + three], &m->side[1][g->tp * SIDES + g->tn + three]};
  return lod_coder_mix(c, side, 2, &m->side_mixer[g->three], LOD_ADAPT, op == OP_LEFT) ? OP_LEFT : OP_RIGHT;
}

/* Which node of the front: a few steps along it, or any by its number. */
static uint32_t code_join(struct front *f, const struct gate *g, uint32_t target) {
  struct lod_coder *c = f->coder;
  struct models *m = f->models;
  uint32_t steps = 0;
  bool backward = false;
  if (f->cut != NULL) {
    uint32_t ahead = g->next, behind = g->previous;
    for (uint32_t i = 1; i <= NEAR && steps == 0; i++) {
      ahead = f->nodes[ahead].next;
      if (ahead == target)
        steps = i;
      else if (behind == target)
        steps = i, backward = true;
      behind = f->nodes[behind].previous;
    }
  }
  if (lod_coder_bit(c, &m->far, LOD_ADAPT, steps == 0)) {
    int bits = 0;
    while (bits < 32 && (uint64_t)f->node_count > (uint64_t)1 << bits)
      bits++;
    target = lod_coder_raw(c, target, bits);
    return target < f->node_count && f->nodes[target].state != GONE ? target : LOD_NONE;
  }
  backward = lod_coder_bit(c, &m->backward, LOD_ADAPT, backward);
  steps = lod_coder_number(c, &m->near, steps - 1) + 1;
  if (steps > NEAR)
    return LOD_NONE;
  uint32_t n = backward ? g->previous : f->nodes[g->next].next;
  for (uint32_t i = 1; i < steps; i++)
    n = backward ? f->nodes[n].previous : f->nodes[n].next;
  return n;
}

/* ---- encoding: what the cut mesh says ---- */

/* The node at which the fan of the new triangle's corner at half-edge `h` (its origin) goes on. Turning around the vertex over unknown
 * triangles ends at a known one in at least one direction. */
static uint32_t find_join(const struct front *f, uint32_t h) {
  const struct lod_cut *cut = f->cut;
  for (uint32_t e = h;;) { /* over half-edges that leave the vertex: the node itself leaves it */
    uint32_t o = cut->opposite[lod_half_edge_previous(e)];
    if (o == LOD_NONE)
      break;
    if (f->done[o / 3]) {
      /* previous(e) arrives at the vertex and its other side is known: the node behind it leaves the vertex */
      return f->nodes[f->node_of[lod_half_edge_previous(e)]].next;
    }
    e = o;
  }
  for (uint32_t e = h;;) {
    uint32_t o = cut->opposite[e];
    if (o == LOD_NONE)
      return LOD_NONE;
    if (f->done[o / 3])
      return f->node_of[e];
    e = lod_half_edge_next(o);
  }
}

static enum operation find_operation(const struct front *f, const struct gate *g) {
  uint32_t far = f->nodes[g->n].far;
  if (far == LOD_NONE)
    return OP_BORDER;
  uint32_t next = lod_half_edge_next(far), previous = lod_half_edge_previous(far);
  if (f->number[f->cut->corner[previous]] == LOD_NONE)
    return OP_NEW;
  if (!g->dead_previous && f->nodes[g->previous].far == previous)
    return OP_LEFT;
  if (!g->dead_next && f->nodes[g->next].far == next)
    return OP_RIGHT;
  return OP_JOIN;
}

/* ---- one step ---- */

static void apply_left(struct front *f, const struct gate *g, uint32_t e, bool closes) {
  glue(f, e + 2, g->previous);
  unqueue(f, g->n);
  f->nodes[g->n].state = GONE;
  if (closes) {
    glue(f, e + 1, g->next);
    return;
  }
  uint32_t n = add_node(f, f->nodes[g->previous].origin, e + 1, far_of(f, f->cut != NULL ? lod_half_edge_next(f->nodes[g->n].far) : 0));
  uint32_t before = f->nodes[g->previous].previous;
  if (before == g->next) { /* a loop of three whose third edge stays open */
    link(f, n, g->next);
    link(f, g->next, n);
  } else {
    link(f, before, n);
    link(f, n, g->next);
  }
  queue(f, f->nodes[n].previous);
  queue(f, n);
  queue(f, g->next);
}

static void apply_right(struct front *f, const struct gate *g, uint32_t e) {
  glue(f, e + 1, g->next);
  uint32_t beyond = f->nodes[g->next].next;
  set_edge(f, g->n, e + 2, far_of(f, f->cut != NULL ? lod_half_edge_previous(f->nodes[g->n].far) : 0));
  link(f, g->n, beyond);
  unqueue(f, g->n);
  queue(f, f->nodes[g->n].previous);
  queue(f, g->n);
  queue(f, beyond);
}

/* The gate becomes (a, v) and a new node (v, b); behind (a, v) comes `join`, the node that leaves v, or the new node where v is new. */
static void apply_open(struct front *f, const struct gate *g, uint32_t e, uint32_t v, uint32_t join) {
  uint32_t far = f->nodes[g->n].far;
  uint32_t n = add_node(f, v, e + 1, far_of(f, f->cut != NULL ? lod_half_edge_next(far) : 0));
  set_edge(f, g->n, e + 2, far_of(f, f->cut != NULL ? lod_half_edge_previous(far) : 0));
  if (join == LOD_NONE) {
    link(f, g->n, n);
  } else {
    link(f, f->nodes[join].previous, n);
    link(f, g->n, join);
    queue(f, join);
    queue(f, f->nodes[n].previous);
  }
  link(f, n, g->next);
  unqueue(f, g->n);
  queue(f, f->nodes[g->n].previous);
  queue(f, g->n);
  queue(f, n);
  queue(f, g->next);
}

static void step(struct front *f, uint32_t gate) {
  struct gate g = look(f, gate);
  uint32_t join = LOD_NONE;
  const uint32_t far = f->nodes[gate].far, twin = f->nodes[gate].twin;
  enum operation op = OP_BORDER;
  if (f->cut != NULL)
    op = find_operation(f, &g);
  op = code_operation(f, &g, op);
  f->last = (f->last << 3 | op) & 511;
  uint32_t v = 0;
  switch (op) {
  case OP_BORDER:
    unqueue(f, gate);
    f->nodes[gate].state = DEAD;
    return;
  case OP_NEW:
    v = add_vertex(f, f->cut != NULL ? f->cut->corner[lod_half_edge_previous(far)] : 0, f->out->component[g.a]);
    if (!f->bad)
      apply_open(f, &g, add_triangle(f, g.a, g.b, v, twin, far), v, LOD_NONE);
    return;
  case OP_LEFT: {
    if (f->nodes[g.previous].origin == g.b) {
      f->bad = true;
      return;
    }
    bool closes = g.three && !g.dead_next;
    if (closes)
      closes =
          lod_coder_bit(f->coder, &f->models->closes, LOD_ADAPT_SLOW, f->cut != NULL && f->nodes[g.next].far == lod_half_edge_next(far));
    apply_left(f, &g, add_triangle(f, g.a, g.b, f->nodes[g.previous].origin, twin, far), closes);
    return;
  }
  case OP_RIGHT:
    v = f->nodes[f->nodes[g.next].next].origin;
    if (v == g.a)
      f->bad = true;
    else
      apply_right(f, &g, add_triangle(f, g.a, g.b, v, twin, far));
    return;
  case OP_JOIN:
    if (f->cut != NULL)
      join = find_join(f, lod_half_edge_previous(far));
    join = code_join(f, &g, join);
    v = join == LOD_NONE ? g.a : f->nodes[join].origin;
    if (v == g.a || v == g.b) {
      f->bad = true;
      return;
    }
    apply_open(f, &g, add_triangle(f, g.a, g.b, v, twin, far), v, join);
    return;
  }
}

static bool allocate(struct front *f, uint32_t triangle_count, struct lod_arena *arena, struct lod_arena *scratch) {
  const size_t half_edges = 3 * (size_t)triangle_count;
  struct lod_connectivity *out = f->out;
  const size_t nodes = (size_t)triangle_count + 2 * (size_t)f->max_components; /* a component's first triangle makes three, any other one */
  out->triangles = lod_arena_alloc(arena, triangle_count, sizeof *out->triangles);
  out->opposite = LOD_NEW(arena, half_edges, uint32_t);
  out->component = LOD_NEW(arena, f->max_vertices, uint32_t);
  f->models = lod_coder_models(f->coder, sizeof *f->models, arena);
  f->nodes = LOD_NEW(scratch, nodes, struct node);
  f->around = LOD_NEW(scratch, f->max_vertices, uint32_t);
  bool good = out->triangles != NULL && out->opposite != NULL && out->component != NULL && f->models != NULL && f->nodes != NULL &&
              f->around != NULL;
  if (f->cut != NULL) {
    out->source_vertices = LOD_NEW(arena, f->max_vertices, uint32_t);
    out->source_half_edges = LOD_NEW(arena, triangle_count, uint32_t);
    f->number = LOD_NEW(scratch, f->cut->vertex_count, uint32_t);
    f->node_of = LOD_NEW(scratch, half_edges, uint32_t);
    f->done = LOD_NEW_ZERO(scratch, triangle_count, uint8_t);
    good = good && out->source_vertices != NULL && out->source_half_edges != NULL && f->number != NULL && f->node_of != NULL &&
           f->done != NULL;
    if (good)
      memset(f->number, 0xff, f->cut->vertex_count * sizeof *f->number);
  }
  if (good)
    memset(out->opposite, 0xff, half_edges * sizeof *out->opposite);
  return good;
}

/* A half-edge that leaves each vertex of the cut mesh: where components can begin. */
static uint32_t *leaving_half_edges(const struct lod_cut *cut, struct lod_arena *scratch) {
  uint32_t *leaving = LOD_NEW(scratch, cut->vertex_count, uint32_t);
  for (uint32_t h = 3 * cut->triangle_count; leaving != NULL && h-- > 0;)
    leaving[cut->corner[h]] = h;
  return leaving;
}

static enum lod_status run(struct front *f, const uint32_t *starts, uint32_t start_count, uint32_t triangle_count,
                           struct lod_arena *scratch, struct lod_problem *problem) {
  uint32_t *leaving = f->cut != NULL ? leaving_half_edges(f->cut, scratch) : NULL, start = 0, other = 0;
  if (f->cut != NULL && leaving == NULL)
    return LOD_MEMORY;
  while (!f->bad) {
    const uint32_t gate = next_gate(f);
    uint32_t source = 0;
    if (lod_coder_overrun(f->coder))
      return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A delta ends inside its connectivity.");
    if (f->out->triangle_count == triangle_count)
      return LOD_OK; /* what is left of the front is border */
    if (gate != LOD_NONE) {
      step(f, gate);
      continue;
    }
    if (f->cut != NULL) {
      while (start < start_count && f->number[starts[start]] != LOD_NONE)
        start++;
      while (start == start_count && f->done[other])
        other++;
      source = start < start_count ? leaving[starts[start]] : 3 * other;
    }
    if (f->out->component_count == f->max_components)
      break;
    begin_component(f, source);
  }
  return lod_fail(problem, LOD_BAD_INPUT, "delta", "A delta's connectivity makes no sense after %u triangles.", f->out->triangle_count);
}

enum lod_status lod_connectivity_code(struct lod_coder *coder, const struct lod_cut *cut, const uint32_t *starts, uint32_t start_count,
                                      uint32_t triangle_count, uint32_t max_vertices, uint32_t max_components, struct lod_arena *arena,
                                      struct lod_connectivity *connectivity, struct lod_problem *problem) {
  struct front f = {.coder = coder, .cut = cut, .out = connectivity, .max_vertices = max_vertices, .max_components = max_components};
  *connectivity = (struct lod_connectivity){0};
  memset(f.head, 0xff, sizeof f.head);
  memset(f.tail, 0xff, sizeof f.tail);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = LOD_MEMORY;
  if (scratch != NULL && allocate(&f, triangle_count, arena, scratch))
    status = run(&f, starts, start_count, triangle_count, scratch, problem);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
