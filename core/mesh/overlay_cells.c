/* Finer triangles cut along the paths: nodes, the coarse triangle that each piece lies on, and fragments.
 *
 * The pieces of a finer triangle, in order: between arcs around its first corner, second, third, then what spokes divide. Every gap of its
 * sides belongs to one piece. A piece's coarse triangle is that on the same side of a chord; pieces without one ask their neighbours. */
#include <string.h>

#include "core/mesh/overlay_private.h"

enum { PIECE_NODES = 16 };

struct piece {
  uint32_t nodes[PIECE_NODES]; /* counter-clockwise */
  uint8_t sides[PIECE_NODES];  /* bits of the finer triangle's sides that the node lies on */
  uint32_t count;
};

struct cutter {
  struct overlay_work *w;
  struct lod_overlay *overlay;
  struct overlay_cells *cells;
  uint32_t node_capacity;
  uint32_t *piece_begin; /* finer triangle_count + 1 */
  uint32_t *labels;      /* pieces: coarse triangle, or LOD_NONE */
  uint32_t *edge_node;   /* by finer canonical half-edge with crossings: node of the first */
  uint32_t *bends;       /* by finer canonical half-edge: first of its bends + 1, or 0 */
  struct bend {
    uint32_t gap, node, next;
  } * bend_list;
  uint32_t bend_count, bend_capacity;
  bool *torn; /* coarse triangles whose labels contradict one another */
};

/* ---- nodes ---- */

static enum lod_status grow_nodes(struct cutter *c, uint32_t count) {
  struct lod_overlay *o = c->overlay;
  if (count <= c->node_capacity)
    return LOD_OK;
  uint32_t capacity = count + count / 4 + 64;
  struct lod_overlay_place *fine;
  uint32_t *path, *along;
  OVERLAY_TRY_NEW(fine, c->w->arena, capacity);
  OVERLAY_TRY_NEW(path, c->w->arena, capacity);
  OVERLAY_TRY_NEW(along, c->w->arena, capacity);
  if (o->node_count > 0) {
    memcpy(fine, o->fine, o->node_count * sizeof *fine);
    memcpy(path, c->cells->node_path, o->node_count * sizeof *path);
    memcpy(along, c->cells->node_along, o->node_count * sizeof *along);
  }
  o->fine = fine;
  c->cells->node_path = path;
  c->cells->node_along = along;
  c->node_capacity = capacity;
  return LOD_OK;
}

static enum lod_status add_node(struct cutter *c, struct lod_overlay_place fine, uint32_t path, uint32_t *node) {
  LOD_TRY(grow_nodes(c, c->overlay->node_count + 1));
  *node = c->overlay->node_count++;
  c->overlay->fine[*node] = fine;
  c->cells->node_path[*node] = path;
  c->cells->node_along[*node] = 0;
  return LOD_OK;
}

static enum lod_status add_vertices(struct cutter *c) {
  struct overlay_work *w = c->w;
  LOD_TRY(grow_nodes(c, w->fine->vertex_count));
  for (uint32_t v = 0; v < w->fine->vertex_count; v++) {
    struct lod_overlay_place fine = {.face = LOD_NONE};
    if (w->f.vertex_begin[v] < w->f.vertex_begin[v + 1]) {
      uint32_t corner = w->f.vertex_corners[w->f.vertex_begin[v]];
      fine.face = corner / 3;
      fine.weights[corner % 3] = LOD_OVERLAY_ONE;
    }
    c->overlay->fine[v] = fine;
    c->cells->node_path[v] = w->vertex_path[v];
    c->cells->node_along[v] = 0;
  }
  c->overlay->node_count = w->fine->vertex_count;
  return LOD_OK;
}

/* Numbers in (0, LOD_OVERLAY_ONE), ascending: nine parts where the paths would like to cross, one part evenly. */
static uint32_t spaced(double wish, uint32_t i, uint32_t count) {
  double share = 0.9 * wish + 0.1 * (i + 1) / (count + 1.0);
  return (uint32_t)(share * LOD_OVERLAY_ONE + 0.5);
}

static struct lod_overlay_place on_edge(uint32_t edge, uint32_t share) {
  struct lod_overlay_place place = {.face = edge / 3};
  place.weights[edge % 3] = LOD_OVERLAY_ONE - share;
  place.weights[(edge + 1) % 3] = share;
  return place;
}

static enum lod_status add_crossings(struct cutter *c) {
  struct overlay_work *w = c->w;
  OVERLAY_TRY_NEW(c->edge_node, w->arena, 3 * (size_t)w->fine->triangle_count);
  for (uint32_t h = 0; h < 3 * w->fine->triangle_count; h++) {
    uint32_t count = w->counts[h], i = 0, last = 0;
    double wish = 0;
    c->edge_node[h] = c->overlay->node_count;
    for (uint32_t x = count == 0 ? LOD_NONE : w->firsts[h]; x != LOD_NONE; x = w->crossings[x].next, i++) {
      uint32_t node;
      wish = (double)w->crossings[x].share > wish ? (double)w->crossings[x].share : wish;
      uint32_t share = spaced(wish, i, count);
      share = share <= last ? last + 1 : share;
      last = share;
      LOD_TRY(add_node(c, on_edge(h, share), w->crossings[x].path, &node));
    }
  }
  return LOD_OK;
}

static uint32_t node_of_crossing(const struct cutter *c, uint32_t x) {
  const struct overlay_work *w = c->w;
  uint32_t edge = w->crossings[x].edge, node = c->edge_node[edge];
  for (uint32_t i = w->firsts[edge]; i != x; i = w->crossings[i].next)
    node++;
  return node;
}

/* Where the nodes of each path lie along it: by length on the finer surface, and a little evenly. */
static void spread_along(struct cutter *c, uint32_t *nodes, uint32_t count, struct lod_vec3 a, struct lod_vec3 b) {
  const struct overlay_work *w = c->w;
  double length = 0, sum = 0;
  struct lod_vec3 at = a;
  for (uint32_t i = 0; i <= count; i++) {
    struct lod_vec3 next = i == count ? b : lod_overlay_position(w->fine, &c->overlay->fine[nodes[i]]);
    length += lod_vec3_distance(at, next);
    at = next;
  }
  at = a;
  for (uint32_t i = 0; i < count; i++) {
    struct lod_vec3 next = lod_overlay_position(w->fine, &c->overlay->fine[nodes[i]]);
    sum += lod_vec3_distance(at, next);
    at = next;
    double share = 0.85 * (length > 0 ? sum / length : 0.5) + 0.15 * (i + 1) / (count + 1.0);
    c->cells->node_along[nodes[i]] = (uint32_t)(share * LOD_OVERLAY_ONE + 0.5);
  }
}

static enum lod_status list_crossings(struct cutter *c, struct lod_arena *results) {
  struct overlay_work *w = c->w;
  struct lod_overlay *o = c->overlay;
  uint32_t total = 0, half_edges = 3 * w->coarse->triangle_count;
  OVERLAY_TRY_NEW(o->crossing_begin, results, (size_t)half_edges + 1);
  for (uint32_t p = 0; p < half_edges; p++) {
    o->crossing_begin[p] = total;
    total += w->paths[p].state == PATH_CROSSING ? w->paths[p].count : w->paths[p].state == PATH_ALONG ? w->paths[p].count - 1 : 0;
  }
  o->crossing_begin[half_edges] = total;
  OVERLAY_TRY_NEW(o->crossings, results, total);
  for (uint32_t p = 0; p < half_edges; p++) {
    const struct overlay_path *path = &w->paths[p];
    uint32_t *nodes = o->crossings + o->crossing_begin[p], count = o->crossing_begin[p + 1] - o->crossing_begin[p];
    if (path->state == PATH_CROSSING)
      for (uint32_t i = 0, x = path->first; i < count; i++, x = w->crossings[x].onward)
        nodes[i] = node_of_crossing(c, x);
    else if (path->state == PATH_ALONG)
      for (uint32_t i = 0; i < count; i++)
        nodes[i] = lod_half_edge_start(w->fine, w->steps[path->first + i + 1]);
    if (path->state != PATH_NONE)
      spread_along(c, nodes, count, overlay_at(w->fine, w->parents[overlay_path_start(w, p)]),
                   overlay_at(w->fine, w->parents[overlay_path_end(w, p)]));
  }
  return LOD_OK;
}

/* ---- pieces ---- */

static uint32_t piece_count(const struct overlay_pattern *p) {
  return p->arcs[0] + p->arcs[1] + p->arcs[2] + p->spokes + 1;
}

/* Number, within its triangle, of the piece at gap `gap` of side k. */
static uint32_t piece_at(const struct overlay_pattern *p, uint32_t k, uint32_t gap) {
  uint32_t j = (k + 1) % 3, begin[4] = {0, p->arcs[0], p->arcs[0] + p->arcs[1], p->arcs[0] + p->arcs[1] + p->arcs[2]};
  if (gap < p->arcs[k])
    return begin[k] + gap;
  if (p->sides[k] - gap < p->arcs[j])
    return begin[j] + p->sides[k] - gap;
  if (p->apex == 3 || p->apex == k) /* spokes from the side's start: its first piece lies here */
    return begin[3];
  return begin[3] + (p->apex == j ? p->spokes : gap - p->arcs[k]);
}

static uint32_t side_node(const struct cutter *c, uint32_t h, uint32_t index) {
  uint32_t edge = overlay_canonical(c->w->f.twin, h);
  return c->edge_node[edge] + (edge == h ? index : c->w->counts[edge] - 1 - index);
}

static void add_corner(struct piece *piece, const struct cutter *c, uint32_t t, uint32_t k) {
  piece->nodes[piece->count] = c->w->fine->triangles[t][k];
  piece->sides[piece->count++] = (uint8_t)(1 << k | 1 << (k + 2) % 3);
}

static void add_side(struct piece *piece, const struct cutter *c, uint32_t t, uint32_t k, uint32_t index) {
  piece->nodes[piece->count] = side_node(c, 3 * t + k, index);
  piece->sides[piece->count++] = (uint8_t)(1 << k);
}

/* Nodes of piece `number` of triangle t, without bends. */
static void build_piece(const struct cutter *c, uint32_t t, const struct overlay_pattern *p, uint32_t number, struct piece *piece) {
  piece->count = 0;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t before = (k + 2) % 3;
    if (number >= p->arcs[k]) {
      number -= p->arcs[k];
      continue;
    }
    if (number == 0) {
      add_corner(piece, c, t, k);
    } else {
      add_side(piece, c, t, before, p->sides[before] - number);
      add_side(piece, c, t, k, number - 1);
    }
    add_side(piece, c, t, k, number);
    add_side(piece, c, t, before, p->sides[before] - 1 - number);
    return;
  }
  uint32_t first = p->apex == 3 ? 0 : p->apex; /* what spokes divide is seen from the apex on */
  for (uint32_t n = 0; n < 3; n++) {
    uint32_t k = (first + n) % 3, before = (k + 2) % 3, begin = p->arcs[(first + 1) % 3];
    if (p->spokes > 0 && ((n == 1 && number > 0) || (n == 2 && number < p->spokes)))
      continue; /* on the other side of a spoke */
    if (p->spokes > 0 && n == 2)
      add_side(piece, c, t, before, begin + number - 1);
    if (p->arcs[k] == 0) {
      add_corner(piece, c, t, k);
    } else {
      add_side(piece, c, t, before, p->sides[before] - p->arcs[k]);
      add_side(piece, c, t, k, p->arcs[k] - 1);
    }
    if (p->spokes > 0 && n == 1)
      add_side(piece, c, t, k, begin);
  }
  if (p->spokes > 0 && number > 0 && number < p->spokes) { /* apex and two neighbouring spokes */
    add_side(piece, c, t, (first + 1) % 3, p->arcs[(first + 1) % 3] + number - 1);
    add_side(piece, c, t, (first + 1) % 3, p->arcs[(first + 1) % 3] + number);
  }
}

/* ---- labels ---- */

/* How far along path p the node is: 0 at its start, LOD_OVERLAY_ONE at its end; LOD_NONE: not on it. */
static uint32_t along_path(const struct cutter *c, uint32_t p, uint32_t node) {
  const struct overlay_work *w = c->w;
  if (c->cells->node_path[node] == p)
    return c->cells->node_along[node];
  if (node == w->parents[overlay_path_start(w, p)])
    return 0;
  return node == w->parents[overlay_path_end(w, p)] ? LOD_OVERLAY_ONE : LOD_NONE;
}

/* Coarse triangle left of the way from node a to node b on path p, or LOD_NONE when that is no part of it. */
static uint32_t left_of(const struct cutter *c, uint32_t p, uint32_t a, uint32_t b) {
  uint32_t from = along_path(c, p, a), to = along_path(c, p, b);
  if (from == LOD_NONE || to == LOD_NONE || from == to)
    return LOD_NONE;
  uint32_t side = from < to ? p : c->w->c.twin[p];
  return side == LOD_NONE ? LOD_NONE : side / 3;
}

/* The coarse triangle of a piece, from its chords and from paths along its sides. */
static uint32_t label_piece(const struct cutter *c, uint32_t t, const struct piece *piece) {
  const struct overlay_work *w = c->w;
  for (uint32_t i = 0; i < piece->count; i++) {
    uint32_t j = (i + 1) % piece->count, a = piece->nodes[i], b = piece->nodes[j], common = piece->sides[i] & piece->sides[j], label;
    if (common != 0) { /* a part of side k */
      uint32_t k = (common & 1) != 0 ? 0 : (common & 2) != 0 ? 1 : 2, h = 3 * t + k;
      uint32_t p = w->along[overlay_canonical(w->f.twin, h)];
      label = p == LOD_NONE ? LOD_NONE : left_of(c, p, a, b);
    } else {
      uint32_t p = a >= w->fine->vertex_count ? c->cells->node_path[a] : c->cells->node_path[b];
      label = p == LOD_NONE ? LOD_NONE : left_of(c, p, a, b);
    }
    if (label != LOD_NONE)
      return label;
  }
  return LOD_NONE;
}

static enum lod_status label_pieces(struct cutter *c) {
  struct overlay_work *w = c->w;
  uint32_t triangles = w->fine->triangle_count;
  OVERLAY_TRY_NEW(c->piece_begin, w->arena, (size_t)triangles + 1);
  uint32_t total = 0;
  for (uint32_t t = 0; t < triangles; t++) {
    struct overlay_pattern p = overlay_pattern_of(w, t);
    c->piece_begin[t] = total;
    total += overlay_takes_part(w->fine, t) ? piece_count(&p) : 0;
  }
  c->piece_begin[triangles] = total;
  OVERLAY_TRY_NEW(c->labels, w->arena, total);
  for (uint32_t t = 0; t < triangles; t++) {
    struct overlay_pattern p = overlay_pattern_of(w, t);
    struct piece piece;
    for (uint32_t i = c->piece_begin[t]; i < c->piece_begin[t + 1]; i++) {
      build_piece(c, t, &p, i - c->piece_begin[t], &piece);
      c->labels[i] = label_piece(c, t, &piece);
    }
  }
  return LOD_OK;
}

static uint32_t piece_across(const struct cutter *c, uint32_t h, uint32_t gap) {
  const struct overlay_work *w = c->w;
  struct overlay_pattern p = overlay_pattern_of(w, h / 3);
  return c->piece_begin[h / 3] + piece_at(&p, h % 3, gap);
}

/* Pieces without a chord take the label of a neighbour; those have no crossings on any side, so they are whole triangles. */
static enum lod_status spread_labels(struct cutter *c) {
  struct overlay_work *w = c->w;
  uint32_t *queue, head = 0, tail = 0, triangles = w->fine->triangle_count;
  OVERLAY_TRY_NEW(queue, w->arena, triangles);
  for (uint32_t t = 0; t < triangles; t++)
    if (c->piece_begin[t + 1] > c->piece_begin[t] + 1 ||
        (c->piece_begin[t + 1] == c->piece_begin[t] + 1 && c->labels[c->piece_begin[t]] != LOD_NONE))
      queue[tail++] = t;
  while (head < tail) {
    uint32_t t = queue[head++];
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t h = 3 * t + k, twin = w->f.twin[h];
      if (twin == LOD_NONE || overlay_count(w, h) != 0 || w->along[overlay_canonical(w->f.twin, h)] != LOD_NONE)
        continue;
      uint32_t here = piece_across(c, h, 0), there = piece_across(c, twin, 0);
      if (c->labels[there] == LOD_NONE && c->labels[here] != LOD_NONE) {
        c->labels[there] = c->labels[here];
        queue[tail++] = twin / 3;
      }
    }
  }
  return LOD_OK;
}

/* ---- bends ---- */

uint32_t overlay_sides_of(const struct overlay_work *w, const struct overlay_cells *cells, uint32_t node, uint32_t t) {
  uint32_t p = cells->node_path[node];
  if (node < w->fine->vertex_count && w->match[node] != LOD_NONE) {
    for (uint32_t k = 0; k < 3; k++)
      if (w->coarse->triangles[t][k] == w->match[node])
        return 1u << k | 1u << (k + 2) % 3;
    return 0;
  }
  if (p == LOD_NONE)
    return 0;
  if (p / 3 == t)
    return 1u << p % 3;
  uint32_t twin = w->c.twin[p];
  return twin != LOD_NONE && twin / 3 == t ? 1u << twin % 3 : 0;
}

/* A part of a finer edge whose ends lie on one coarse edge would be flattened onto that: a point in its middle, free to move, keeps off.
 * Labels on both sides of a gap must agree; where they do not, paths enclose no disk. */
static enum lod_status bend_edge(struct cutter *c, uint32_t h) {
  struct overlay_work *w = c->w;
  uint32_t count = w->counts[h], twin = w->f.twin[h];
  for (uint32_t gap = 0; gap <= count; gap++) {
    uint32_t label = c->labels[piece_across(c, h, gap)], other = c->labels[piece_across(c, twin, count - gap)];
    if (label != other) {
      if (label != LOD_NONE)
        c->torn[label] = true;
      if (other != LOD_NONE)
        c->torn[other] = true;
      continue;
    }
    if (label == LOD_NONE)
      continue;
    uint32_t a = gap == 0 ? lod_half_edge_start(w->fine, h) : side_node(c, h, gap - 1);
    uint32_t b = gap == count ? lod_half_edge_end(w->fine, h) : side_node(c, h, gap);
    if ((overlay_sides_of(w, c->cells, a, label) & overlay_sides_of(w, c->cells, b, label)) == 0)
      continue;
    uint32_t low = gap == 0 ? 0 : c->overlay->fine[a].weights[(h + 1) % 3];
    uint32_t high = gap == count ? LOD_OVERLAY_ONE : c->overlay->fine[b].weights[(h + 1) % 3], node;
    LOD_TRY(add_node(c, on_edge(h, low + (high - low) / 2), LOD_NONE, &node));
    if (c->bend_count == c->bend_capacity) {
      struct bend *larger;
      c->bend_capacity = 2 * c->bend_capacity + 64;
      OVERLAY_TRY_NEW(larger, w->arena, c->bend_capacity);
      if (c->bend_count > 0)
        memcpy(larger, c->bend_list, c->bend_count * sizeof *larger);
      c->bend_list = larger;
    }
    c->bend_list[c->bend_count] = (struct bend){gap, node, c->bends[h]};
    c->bends[h] = ++c->bend_count;
  }
  return LOD_OK;
}

static enum lod_status find_bends(struct cutter *c) {
  struct overlay_work *w = c->w;
  OVERLAY_TRY_ZERO(c->bends, w->arena, 3 * (size_t)w->fine->triangle_count);
  for (uint32_t h = 0; h < 3 * w->fine->triangle_count; h++)
    if (w->f.twin[h] != LOD_NONE && w->f.twin[h] > h && w->along[h] == LOD_NONE)
      LOD_TRY(bend_edge(c, h));
  /* The end of the surface lies on no coarse edge, where none ran along it. */
  for (uint32_t h = 0; h < 3 * w->fine->triangle_count; h++)
    if (w->f.twin[h] == LOD_NONE && overlay_takes_part(w->fine, h / 3) && w->along[h] == LOD_NONE) {
      uint32_t label = c->labels[piece_across(c, h, 0)];
      if (label != LOD_NONE)
        c->torn[label] = true;
    }
  return LOD_OK;
}

static uint32_t bend_at(const struct cutter *c, uint32_t h, uint32_t gap) {
  const struct overlay_work *w = c->w;
  uint32_t edge = overlay_canonical(w->f.twin, h), of = edge == h ? gap : w->counts[edge] - gap;
  for (uint32_t i = c->bends[edge]; i != 0; i = c->bend_list[i - 1].next)
    if (c->bend_list[i - 1].gap == of)
      return c->bend_list[i - 1].node;
  return LOD_NONE;
}

/* Adds what bends there are on the piece's sides. */
static void add_bends(const struct cutter *c, uint32_t t, struct piece *piece) {
  const struct overlay_work *w = c->w;
  struct piece bent = {.count = 0};
  for (uint32_t i = 0; i < piece->count; i++) {
    uint32_t j = (i + 1) % piece->count, common = piece->sides[i] & piece->sides[j];
    bent.nodes[bent.count] = piece->nodes[i];
    bent.sides[bent.count++] = piece->sides[i];
    if (common == 0)
      continue;
    uint32_t k = (common & 1) != 0 ? 0 : (common & 2) != 0 ? 1 : 2, h = 3 * t + k, gap = 0;
    if (c->bends[overlay_canonical(w->f.twin, h)] == 0)
      continue;
    if (piece->nodes[i] >= w->fine->vertex_count)
      while (side_node(c, h, gap++) != piece->nodes[i]) {
      }
    uint32_t node = bend_at(c, h, gap);
    if (node == LOD_NONE)
      continue;
    bent.nodes[bent.count] = node;
    bent.sides[bent.count++] = (uint8_t)(1 << k);
  }
  *piece = bent;
}

/* ---- fragments ---- */

static bool emit(struct lod_overlay *o, uint32_t a, uint32_t b, uint32_t c, uint32_t coarse, uint32_t fine) {
  uint32_t *out = o->triangles[o->triangle_count];
  out[0] = a;
  out[1] = b;
  out[2] = c;
  o->coarse_faces[o->triangle_count] = coarse;
  o->fine_faces[o->triangle_count++] = fine;
  return true;
}

/* May the piece be cut into triangles that all have corner `apex`: none with all corners on one side, here or there? */
static bool star_works(const struct piece *piece, const uint32_t *coarse_sides, uint32_t apex) {
  for (uint32_t i = 1; i + 1 < piece->count; i++) {
    uint32_t a = (apex + i) % piece->count, b = (apex + i + 1) % piece->count;
    if ((piece->sides[apex] & piece->sides[a] & piece->sides[b]) != 0 || (coarse_sides[apex] & coarse_sides[a] & coarse_sides[b]) != 0)
      return false;
    if (i > 1 && ((piece->sides[apex] & piece->sides[a]) != 0 || (coarse_sides[apex] & coarse_sides[a]) != 0))
      return false;
  }
  return true;
}

static struct lod_overlay_place middle_of(const struct cutter *c, uint32_t t, const struct piece *piece) {
  struct lod_overlay_place place = {.face = t};
  int64_t sum[3] = {0};
  for (uint32_t i = 0; i < piece->count; i++) {
    int64_t weights[3];
    if (!lod_overlay_on_face(c->w->fine, &c->overlay->fine[piece->nodes[i]], t, weights))
      continue;
    for (int k = 0; k < 3; k++)
      sum[k] += weights[k];
  }
  place.weights[0] = (uint32_t)(sum[0] / piece->count);
  place.weights[1] = (uint32_t)(sum[1] / piece->count);
  place.weights[2] = LOD_OVERLAY_ONE - place.weights[0] - place.weights[1];
  return place;
}

static enum lod_status cut_piece(struct cutter *c, uint32_t t, const struct piece *piece, uint32_t label) {
  uint32_t coarse_sides[PIECE_NODES] = {0}, node;
  for (uint32_t i = 0; i < piece->count && label != LOD_NONE; i++)
    coarse_sides[i] = overlay_sides_of(c->w, c->cells, piece->nodes[i], label);
  for (uint32_t apex = 0; apex < piece->count; apex++) {
    if (!star_works(piece, coarse_sides, apex))
      continue;
    for (uint32_t i = 1; i + 1 < piece->count; i++)
      emit(c->overlay, piece->nodes[apex], piece->nodes[(apex + i) % piece->count], piece->nodes[(apex + i + 1) % piece->count], label, t);
    return LOD_OK;
  }
  LOD_TRY(add_node(c, middle_of(c, t, piece), LOD_NONE, &node));
  for (uint32_t i = 0; i < piece->count; i++)
    emit(c->overlay, node, piece->nodes[i], piece->nodes[(i + 1) % piece->count], label, t);
  return LOD_OK;
}

/* An upper bound of the fragment triangles. */
static size_t most_triangles(const struct cutter *c) {
  const struct overlay_work *w = c->w;
  size_t sum = 0;
  for (uint32_t t = 0; t < w->fine->triangle_count; t++) {
    struct overlay_pattern p = overlay_pattern_of(w, t);
    uint32_t bends = 0;
    for (uint32_t k = 0; k < 3; k++)
      for (uint32_t i = c->bends[overlay_canonical(w->f.twin, 3 * t + k)]; i != 0; i = c->bend_list[i - 1].next)
        bends++;
    if (c->piece_begin[t + 1] > c->piece_begin[t]) /* a chord adds a piece and two ends to each side of it; a node in the middle two more */
      sum += 3 + bends + 6 * (size_t)(piece_count(&p) - 1);
  }
  return sum;
}

static enum lod_status cut_pieces(struct cutter *c, struct lod_arena *results) {
  struct overlay_work *w = c->w;
  struct lod_overlay *o = c->overlay;
  size_t most = most_triangles(c);
  if (most >= LOD_NONE / 3)
    return LOD_LIMIT;
  (void)results;
  OVERLAY_TRY_NEW(o->triangles, w->arena, most);
  OVERLAY_TRY_NEW(o->coarse_faces, w->arena, most);
  OVERLAY_TRY_NEW(o->fine_faces, w->arena, most);
  for (uint32_t t = 0; t < w->fine->triangle_count; t++) {
    struct overlay_pattern p = overlay_pattern_of(w, t);
    struct piece piece;
    bool bends = false;
    for (uint32_t k = 0; k < 3; k++)
      bends = bends || c->bends[overlay_canonical(w->f.twin, 3 * t + k)] != 0;
    for (uint32_t i = c->piece_begin[t]; i < c->piece_begin[t + 1]; i++) {
      build_piece(c, t, &p, i - c->piece_begin[t], &piece);
      if (bends)
        add_bends(c, t, &piece);
      LOD_TRY(cut_piece(c, t, &piece, c->labels[i]));
    }
  }
  return LOD_OK;
}

/* Orders fragments by coarse triangle, stably, into `results`. */
static enum lod_status sort_fragments(struct cutter *c, struct lod_arena *results) {
  struct lod_overlay *o = c->overlay, from = *o;
  uint32_t faces = c->w->coarse->triangle_count, *begin;
  OVERLAY_TRY_ZERO(begin, c->w->arena, (size_t)faces + 2);
  OVERLAY_TRY_NEW(o->triangles, results, o->triangle_count);
  OVERLAY_TRY_NEW(o->coarse_faces, results, o->triangle_count);
  OVERLAY_TRY_NEW(o->fine_faces, results, o->triangle_count);
  for (uint32_t i = 0; i < from.triangle_count; i++)
    begin[(from.coarse_faces[i] == LOD_NONE ? faces : from.coarse_faces[i]) + 1]++;
  for (uint32_t f = 0; f <= faces; f++)
    begin[f + 1] += begin[f];
  for (uint32_t i = 0; i < from.triangle_count; i++) {
    uint32_t to = begin[from.coarse_faces[i] == LOD_NONE ? faces : from.coarse_faces[i]]++;
    memcpy(o->triangles[to], from.triangles[i], sizeof *o->triangles);
    o->coarse_faces[to] = from.coarse_faces[i];
    o->fine_faces[to] = from.fine_faces[i];
  }
  return LOD_OK;
}

static void judge(const struct cutter *c) {
  const struct overlay_work *w = c->w;
  for (uint32_t t = 0; t < w->coarse->triangle_count; t++) {
    c->overlay->states[t] = LOD_OVERLAY_EMPTY;
    if (!overlay_takes_part(w->coarse, t))
      continue;
    c->overlay->states[t] = c->torn[t] ? LOD_OVERLAY_TORN : LOD_OVERLAY_MAPPED;
    for (uint32_t k = 0; k < 3; k++)
      if (w->paths[overlay_canonical(w->c.twin, 3 * t + k)].state == PATH_NONE)
        c->overlay->states[t] = LOD_OVERLAY_UNTRACED;
  }
}

enum lod_status overlay_cut(struct overlay_work *w, struct lod_arena *results, struct lod_overlay *overlay, struct overlay_cells *cells) {
  struct cutter c = {.w = w, .overlay = overlay, .cells = cells};
  overlay->vertex_count = w->fine->vertex_count;
  OVERLAY_TRY_ZERO(c.torn, w->arena, w->coarse->triangle_count);
  OVERLAY_TRY_NEW(overlay->states, results, w->coarse->triangle_count);
  LOD_TRY(add_vertices(&c));
  LOD_TRY(add_crossings(&c));
  LOD_TRY(list_crossings(&c, results));
  LOD_TRY(label_pieces(&c));
  LOD_TRY(spread_labels(&c));
  LOD_TRY(find_bends(&c));
  LOD_TRY(cut_pieces(&c, results));
  LOD_TRY(sort_fragments(&c, results));
  judge(&c);
  return LOD_OK;
}
