/* Removes vertices in order of the certified error that their removal leaves behind. */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"

/* ---- the queue: a binary heap of vertices by the error that their removal is expected to make ---- */

struct entry {
  double key;
  uint32_t vertex;
};

struct clod_queue {
  struct entry *heap;
  uint32_t *place; /* by vertex: index in heap, LOD_NONE = not in it */
  uint32_t count;
  double reached; /* the largest error of a removal so far: what does not exceed it costs nothing */
};

static bool before(struct entry a, struct entry b) {
  return a.key < b.key || (a.key == b.key && a.vertex < b.vertex);
}

static void put(struct clod_queue *queue, uint32_t i, struct entry entry) {
  queue->heap[i] = entry;
  queue->place[entry.vertex] = i;
}

static void sift_up(struct clod_queue *queue, uint32_t i) {
  struct entry entry = queue->heap[i];
  for (; i > 0 && before(entry, queue->heap[(i - 1) / 2]); i = (i - 1) / 2)
    put(queue, i, queue->heap[(i - 1) / 2]);
  put(queue, i, entry);
}

static void sift_down(struct clod_queue *queue, uint32_t i) {
  struct entry entry = queue->heap[i];
  for (;;) {
    uint32_t child = 2 * i + 1;
    if (child >= queue->count)
      break;
    child += child + 1 < queue->count && before(queue->heap[child + 1], queue->heap[child]);
    if (!before(queue->heap[child], entry))
      break;
    put(queue, i, queue->heap[child]);
    i = child;
  }
  put(queue, i, entry);
}

static void push(struct clod_queue *queue, uint32_t vertex, double key) {
  uint32_t i = queue->place[vertex];
  if (i == LOD_NONE)
    i = queue->count++;
  queue->heap[i] = (struct entry){key, vertex};
  queue->place[vertex] = i;
  sift_up(queue, i);
  sift_down(queue, queue->place[vertex]);
}

static struct entry pop(struct clod_queue *queue) {
  struct entry top = queue->heap[0], last = queue->heap[--queue->count];
  queue->place[top.vertex] = LOD_NONE;
  if (queue->count > 0) {
    queue->heap[0] = last;
    queue->place[last.vertex] = 0;
    sift_down(queue, 0);
  }
  return top;
}

/* ---- trying a removal ---- */

/* Edges from ring number i to j of polygon h that are made anew. */
static void guess_diagonal(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t d, struct clod_end ends[2],
                           struct lod_vec3 inner[2]) {
  const struct clod_polygon *polygon = &hole->halves[h];
  bool line = polygon->open && d == 0, sharp = line && (clod->edges[hole->line_edges[0]].flags & CLOD_SHARP) != 0;
  for (int i = 0; i < 2; i++) {
    uint32_t r = polygon->diagonals[d][i];
    ends[i] = (struct clod_end){.p = clod->positions[polygon->ring[r]]};
    if (!sharp)
      ends[i].normal = clod_sector_normal(clod, polygon->sectors[r]);
  }
  for (int i = 0; i < 2; i++)
    inner[i] = clod_inner_point(ends[i], ends[1 - i].p);
  if (!sharp)
    return;
  struct lod_bezier_curve parts[2];
  for (int i = 0; i < 2; i++) {
    const struct clod_edge *edge = &clod->edges[hole->line_edges[i]];
    uint32_t from = i == 0 ? polygon->ring[0] : hole->vertex;
    bool along = edge->ends[0] == from;
    parts[i] = (struct lod_bezier_curve){
        {clod->positions[edge->ends[!along]], edge->inner[!along], edge->inner[along], clod->positions[edge->ends[along]]}};
  }
  double t;
  struct lod_bezier_curve whole = lod_bezier_merge_curves(&parts[0], &parts[1], &t);
  inner[0] = whole.p[1];
  inner[1] = whole.p[2];
}

static enum lod_status fit_diagonals(struct lod_clod *clod, struct clod_hole *hole, uint32_t h) {
  struct clod_polygon *polygon = &hole->halves[h];
  for (uint32_t d = 0; d < polygon->diagonal_count; d++) {
    struct lod_vec3 *inner = polygon->inner[d];
    if (h == 1 && d == 0) { /* the line's edge, seen from its other side */
      inner[0] = hole->halves[0].inner[0][1];
      inner[1] = hole->halves[0].inner[0][0];
      continue;
    }
    struct clod_end ends[2];
    double *t;
    struct lod_vec3 *samples;
    uint32_t count;
    guess_diagonal(clod, hole, h, d, ends, inner);
    if (hole->paper) {
      clod_inverse_diagonal(clod, hole, h, d, inner);
      continue;
    }
    LOD_TRY(clod_local_sample(hole, h, d, &t, &samples, &count));
    struct lod_vec3 guess[2] = {inner[0], inner[1]};
    clod_fit_curve(ends, t, samples, count, clod->settings.curve_weight, inner);
    if (!clod->settings.reparametrize)
      continue;
    struct lod_bezier_curve curve = {{ends[0].p, inner[0], inner[1], ends[1].p}};
    clod_project_curve(&curve, samples, count, t);
    clod_local_move_samples(hole, h, count);
    inner[0] = guess[0];
    inner[1] = guess[1];
    clod_fit_curve(ends, t, samples, count, clod->settings.curve_weight, inner);
  }
  return LOD_OK;
}

/* Sides of the patch that was between ring vertices s and s + 1. */
static uint32_t outer_side(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t s) {
  uint32_t old = polygon->old[s];
  return clod->patches[old / 3].sides[(old % 3 + 1) % 3];
}

static void gather_net(const struct lod_clod *clod, const struct clod_polygon *polygon, uint32_t i, struct lod_bezier *net) {
  for (uint32_t k = 0; k < 3; k++) {
    net->p[k] = clod->positions[polygon->ring[polygon->triangles[i][k]]];
    uint32_t name = polygon->sides[i][k];
    if (name < CLOD_RING) {
      uint32_t side = outer_side(clod, polygon, name);
      net->p[3 + 2 * k] = clod->edges[side >> 1].inner[side & 1];
      net->p[4 + 2 * k] = clod->edges[side >> 1].inner[1 - (side & 1)];
    } else {
      uint32_t d = name - CLOD_RING, against = polygon->diagonals[d][0] != polygon->triangles[i][k];
      net->p[3 + 2 * k] = polygon->inner[d][against];
      net->p[4 + 2 * k] = polygon->inner[d][1 - against];
    }
  }
  lod_bezier_set_centre(net);
}

/* A fitted centre that folds the patch goes back towards where the edges alone would have it. Whether it is regular then. */
static bool unfold(struct lod_bezier *net, struct lod_vec3 plain) {
  static const double kShares[] = {1, 0.5, 0};
  struct lod_vec3 fitted = net->p[LOD_BEZIER_CENTRE];
  for (int i = 0; i < 3; i++) {
    net->p[LOD_BEZIER_CENTRE] = lod_vec3_add_scaled(plain, lod_vec3_subtract(fitted, plain), kShares[i]);
    if (lod_bezier_is_regular(net))
      return true;
  }
  net->p[LOD_BEZIER_CENTRE] = fitted;
  return false;
}

static void fit_patches(const struct lod_clod *clod, struct clod_hole *hole, double limit) {
  hole->bound = 0;
  for (uint32_t h = 0; h < hole->half_count && hole->bound <= limit; h++)
    for (uint32_t i = 0; i < hole->halves[h].triangle_count && hole->bound <= limit; i++) {
      struct lod_bezier *net = &hole->nets[h][i];
      struct clod_node *nodes;
      struct clod_cell *cells;
      uint32_t node_count, cell_count;
      clod_local_patch(hole, h, i, &nodes, &node_count, &cells, &cell_count);
      gather_net(clod, &hole->halves[h], i, net);
      if (hole->paper) {
        clod_inverse_centre(clod, hole, h, i, net);
        if (clod->settings.reparametrize)
          clod_project_nodes(clod, net, nodes, node_count);
        hole->estimates[h][i] = clod_estimate(clod, hole, h, i);
        hole->bounds[h][i] = clod_patch_bound(clod, net, nodes, cells, cell_count, limit);
        hole->bound = fmax(hole->bound, hole->bounds[h][i]);
        hole->regular[h][i] = lod_bezier_is_regular(net);
        continue;
      }
      hole->estimates[h][i] = 0;
      struct lod_vec3 guess = net->p[LOD_BEZIER_CENTRE];
      clod_fit_centre(clod, net, nodes, node_count, cells, cell_count);
      if (clod->settings.reparametrize) {
        clod_project_nodes(clod, net, nodes, node_count);
        net->p[LOD_BEZIER_CENTRE] = guess;
        clod_fit_centre(clod, net, nodes, node_count, cells, cell_count);
      }
      hole->regular[h][i] = unfold(net, guess);
      hole->bounds[h][i] = clod_patch_bound(clod, net, nodes, cells, cell_count, limit);
      hole->bound = fmax(hole->bound, hole->bounds[h][i]);
    }
}

/* How far UVs and colours of what replaces the hole would be off. */
static void bound_attributes(const struct lod_clod *clod, struct clod_hole *hole) {
  hole->cost = hole->bound;
  for (uint32_t h = 0; h < hole->half_count && isfinite(hole->bound); h++)
    for (uint32_t i = 0; i < hole->halves[h].triangle_count; i++) {
      const struct clod_polygon *polygon = &hole->halves[h];
      struct clod_node *nodes;
      struct clod_cell *cells;
      uint32_t node_count, cell_count, wedges[3];
      clod_local_patch(hole, h, i, &nodes, &node_count, &cells, &cell_count);
      for (int k = 0; k < 3; k++)
        wedges[k] = polygon->wedges[polygon->triangles[i][k]];
      clod_attributes_off(clod, wedges, nodes, cells, cell_count, hole->offs[h][i]);
      hole->cost = fmax(hole->cost, clod_attributes_cost(clod, hole->offs[h][i]));
    }
}

/* ---- folds ---- */

static struct lod_vec3 side_normal(const struct lod_bezier *net, uint32_t k, double t) {
  double at[3] = {0, 0, 0};
  at[k] = 1 - t;
  at[(k + 1) % 3] = t;
  return lod_bezier_normal(net, (struct lod_barycentric){at[0], at[1], at[2]});
}

/* Patches with side k of a, from its corner on, and side l of b, against it, turn back on one another somewhere along it. */
static bool folds_over(const struct lod_bezier *a, uint32_t k, const struct lod_bezier *b, uint32_t l) {
  for (int i = 1; i < 4; i++)
    if (lod_vec3_dot(side_normal(a, k, i / 4.0), side_normal(b, l, 1 - i / 4.0)) < 0)
      return true;
  return false;
}

/* The net across side `name` of a polygon's triangle i, *l its side; false where the surface is sharp there, or ends. */
static bool net_across(const struct lod_clod *clod, const struct clod_hole *hole, uint32_t h, uint32_t i, uint32_t name,
                       struct lod_bezier *net, uint32_t *l) {
  const struct clod_polygon *polygon = &hole->halves[h];
  if (name < CLOD_RING) {
    uint32_t side = outer_side(clod, polygon, name), other = clod->edges[side >> 1].users[1 - (side & 1)];
    if (other == LOD_NONE || (clod->edges[side >> 1].flags & CLOD_SHARP) != 0)
      return false;
    for (uint32_t j = 0; j < polygon->old_count; j++)
      if (polygon->old[j] / 3 == other / 3)
        return false; /* both sides of the edge are in the hole */
    *net = clod_net(clod, &clod->patches[other / 3]);
    *l = other % 3;
    return true;
  }
  if (polygon->open && name == CLOD_RING)
    return false;
  for (uint32_t j = 0; j < i; j++) /* each diagonal once */
    for (uint32_t k = 0; k < 3; k++)
      if (polygon->sides[j][k] == name) {
        *net = hole->nets[h][j];
        *l = k;
        return true;
      }
  return false;
}

/* What would replace the hole has a patch that is folded, or folds over a neighbour, and the hole had less of that. A patch is not folded
 * when lod_bezier_is_regular proves it. */
static bool makes_folds(const struct lod_clod *clod, const struct clod_hole *hole) {
  uint32_t before = 0, after = 0;
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t i = 0; i < hole->halves[h].triangle_count; i++) {
      const struct lod_bezier *net = &hole->nets[h][i];
      after += !hole->regular[h][i];
      for (uint32_t k = 0; k < 3; k++) {
        struct lod_bezier other;
        uint32_t l;
        after += net_across(clod, hole, h, i, hole->halves[h].sides[i][k], &other, &l) && folds_over(net, k, &other, l);
      }
    }
  if (after == 0)
    return false;
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t s = 0; s < hole->halves[h].old_count; s++) {
      uint32_t p = hole->halves[h].old[s] / 3;
      struct lod_bezier net = clod_net(clod, &clod->patches[p]);
      before += !lod_bezier_is_regular(&net);
      for (uint32_t k = 0; k < 3; k++) {
        uint32_t across = clod_across(clod, 3 * p + k);
        if (across == LOD_NONE || (clod->edges[clod->patches[p].sides[k] >> 1].flags & CLOD_SHARP) != 0)
          continue;
        struct lod_bezier other = clod_net(clod, &clod->patches[across / 3]);
        before += folds_over(&net, k, &other, across % 3); /* those inside count twice: the hole may lose them */
      }
    }
  return after >= before;
}

enum lod_status clod_try_removal(struct lod_clod *clod, uint32_t v, const uint32_t *pair, bool paper, double limit) {
  struct clod_hole *hole = clod->hole;
  hole->bound = hole->cost = INFINITY;
  hole->paper = paper;
  for (int i = 0; i < 2; i++)
    hole->pair[i] = pair == NULL ? LOD_NONE : pair[i];
  clod->tried++;
  if (!clod_hole_open(clod, v, pair, hole)) {
    hole->local_used = false;
    return LOD_OK;
  }
  bool good;
  hole->local_used = true;
  LOD_TRY(clod_local_cut(clod, hole, &good));
  for (uint32_t h = 0; h < hole->half_count && good; h++)
    LOD_TRY(fit_diagonals(clod, hole, h));
  if (good)
    LOD_TRY(clod_local_deal(clod, hole, &good));
  if (good)
    fit_patches(clod, hole, limit);
  if (isfinite(hole->bound) && hole->bound <= limit && makes_folds(clod, hole))
    hole->bound = INFINITY;
  bound_attributes(clod, hole);
  return LOD_OK;
}

/* ---- making it so ---- */

static void release_patch(struct lod_clod *clod, uint32_t p) {
  struct clod_patch *patch = &clod->patches[p];
  clod_pool_give(&clod->pool, patch->nodes, patch->node_count * sizeof *patch->nodes);
  clod_pool_give(&clod->pool, patch->cells, patch->cell_count * sizeof *patch->cells);
  patch->nodes = NULL;
  patch->cells = NULL;
  patch->died = clod->number;
  for (uint32_t k = 0; k < 3; k++)
    clod->edges[patch->sides[k] >> 1].users[patch->sides[k] & 1] = LOD_NONE;
}

static enum lod_status add_edges(struct lod_clod *clod, struct clod_hole *hole, uint32_t numbers[CLOD_HALVES][CLOD_RING]) {
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t d = 0; d < hole->halves[h].diagonal_count; d++) {
      const struct clod_polygon *polygon = &hole->halves[h];
      bool line = polygon->open && d == 0;
      if (line && h == 1) {
        numbers[1][0] = numbers[0][0];
        continue;
      }
      if (!clod_grow(clod->arena, (void **)&clod->edges, &clod->edge_room, clod->edge_count + 1, sizeof *clod->edges))
        return LOD_MEMORY;
      numbers[h][d] = clod->edge_count;
      struct clod_edge *edge = &clod->edges[clod->edge_count++];
      *edge = (struct clod_edge){.users = {LOD_NONE, LOD_NONE}, .flags = line ? clod->edges[hole->line_edges[0]].flags : 0};
      for (int i = 0; i < 2; i++) {
        edge->ends[i] = polygon->ring[polygon->diagonals[d][i]];
        edge->inner[i] = polygon->inner[d][i];
      }
    }
  return LOD_OK;
}

static enum lod_status add_patch(struct lod_clod *clod, struct clod_hole *hole, uint32_t h, uint32_t i, const uint32_t *edges,
                                 const uint32_t *outer) {
  const struct clod_polygon *polygon = &hole->halves[h];
  if (!clod_grow(clod->arena, (void **)&clod->patches, &clod->patch_room, clod->patch_count + 1, sizeof *clod->patches))
    return LOD_MEMORY;
  uint32_t p = clod->patch_count;
  struct clod_patch *patch = &clod->patches[p];
  const struct clod_patch *old = &clod->patches[polygon->old[0] / 3];
  *patch = (struct clod_patch){.born = clod->number,
                               .died = UINT32_MAX,
                               .material = old->material,
                               .part = old->part,
                               .centre = hole->nets[h][i].p[LOD_BEZIER_CENTRE],
                               .bound = hole->bounds[h][i],
                               .estimate = hole->estimates[h][i]};
  for (int a = 0; a < 2; a++)
    patch->off[a] = hole->offs[h][i][a] > 0 ? nextafterf((float)hole->offs[h][i][a], INFINITY) : 0;
  struct clod_node *nodes;
  struct clod_cell *cells;
  clod_local_patch(hole, h, i, &nodes, &patch->node_count, &cells, &patch->cell_count);
  patch->nodes = clod_pool_take(&clod->pool, patch->node_count * sizeof *nodes);
  patch->cells = clod_pool_take(&clod->pool, patch->cell_count * sizeof *cells);
  if (patch->nodes == NULL || patch->cells == NULL)
    return LOD_MEMORY;
  memcpy(patch->nodes, nodes, patch->node_count * sizeof *nodes);
  memcpy(patch->cells, cells, patch->cell_count * sizeof *cells);
  clod->patch_count++;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t corner = polygon->triangles[i][k], name = polygon->sides[i][k];
    patch->corners[k] = polygon->ring[corner];
    patch->sectors[k] = polygon->sectors[corner];
    patch->wedges[k] = polygon->wedges[corner];
    clod->half[patch->corners[k]] = 3 * p + k;
    if (name < CLOD_RING) {
      patch->sides[k] = outer[name];
    } else {
      /* The line's edge was named by the first half, against which the second runs. */
      uint32_t edge = edges[name - CLOD_RING];
      patch->sides[k] = 2 * edge + (clod->edges[edge].ends[0] != patch->corners[k]);
    }
    clod->edges[patch->sides[k] >> 1].users[patch->sides[k] & 1] = 3 * p + k;
  }
  return LOD_OK;
}

enum lod_status clod_commit(struct lod_clod *clod) {
  struct clod_hole *hole = clod->hole;
  uint32_t numbers[CLOD_HALVES][CLOD_RING], outer[CLOD_HALVES][CLOD_RING];
  clod->number++;
  LOD_TRY(add_edges(clod, hole, numbers));
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t s = 0; s < hole->halves[h].old_count; s++)
      outer[h][s] = outer_side(clod, &hole->halves[h], s);
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t s = 0; s < hole->halves[h].old_count; s++)
      release_patch(clod, hole->halves[h].old[s] / 3);
  for (uint32_t h = 0; h < hole->half_count; h++) {
    const struct clod_polygon *polygon = &hole->halves[h];
    for (uint32_t i = 0; i < polygon->triangle_count; i++)
      LOD_TRY(add_patch(clod, hole, h, i, numbers[h], outer[h]));
    clod->living_patches -= polygon->old_count - polygon->triangle_count;
  }
  clod->half[hole->vertex] = LOD_NONE;
  clod->removable[hole->vertex] = 0;
  clod->living_vertices--;
  return clod_local_commit(clod, hole);
}

enum lod_status clod_give_up(struct lod_clod *clod) {
  return clod->hole->local_used ? clod_local_abandon(clod, clod->hole) : LOD_OK;
}

/* ---- the loop ---- */

/* A removal that is tried is made when it is at most so much worse than the next might be: trying it again later costs more than it gains.
 */
static const double kEase = 1.1;

/* Cheap guess before a removal was tried: half of how far the vertex stands above its neighbours' mean, but no less than the bounds of its
 * patches, since what replaces these is hardly ever nearer to the source. A guess that is too low costs a try; these are about right for
 * polygons. Patches of splines cover many triangles, and may get nearer to them: there each is tried. */
static double guess_key(const struct lod_clod *clod, uint32_t v) {
  uint32_t half = clod->half[v];
  if (half == LOD_NONE)
    return INFINITY;
  struct lod_vec3 sum = {0, 0, 0};
  double count = 0, bound = 0;
  uint32_t at = half;
  bool splines = false;
  do {
    const struct clod_patch *patch = &clod->patches[at / 3];
    bound = fmax(bound, patch->bound);
    splines = splines || patch->cell_count > 1;
    sum = lod_vec3_add(sum, clod->positions[patch->corners[(at + 1) % 3]]);
    count++;
    at = clod_across(clod, at % 3 == 0 ? at + 2 : at - 1);
  } while (at != LOD_NONE && at != half && count < 64);
  struct lod_vec3 mean = lod_vec3_scale(sum, 1 / count);
  struct lod_vec3 normal = clod_sector_normal(clod, clod->patches[half / 3].sectors[half % 3]);
  double above = fabs(lod_vec3_dot(normal, lod_vec3_subtract(clod->positions[v], mean)));
  return splines ? 0.1 * above : fmax(bound, 0.5 * above);
}

enum lod_status clod_prepare(struct lod_clod *clod) {
  if (clod->hole != NULL)
    return LOD_OK;
  struct clod_hole *hole = LOD_NEW_ZERO(clod->arena, 1, struct clod_hole);
  clod->ring_place = LOD_NEW_ZERO(clod->arena, clod->vertex_count, uint8_t);
  if (hole == NULL || clod->ring_place == NULL)
    return LOD_MEMORY;
  LOD_TRY(clod_local_create(clod->arena, &hole->local));
  clod->hole = hole;
  return LOD_OK;
}

static enum lod_status start(struct lod_clod *clod) {
  LOD_TRY(clod_prepare(clod));
  clod->queue = LOD_NEW_ZERO(clod->arena, 1, struct clod_queue);
  if (clod->queue == NULL)
    return LOD_MEMORY;
  clod->queue->heap = LOD_NEW(clod->arena, clod->vertex_count, struct entry);
  clod->queue->place = LOD_NEW(clod->arena, clod->vertex_count, uint32_t);
  if (clod->queue->heap == NULL || clod->queue->place == NULL)
    return LOD_MEMORY;
  memset(clod->queue->place, 0xff, clod->vertex_count * sizeof *clod->queue->place);
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    if (clod->removable[v] != 0)
      push(clod->queue, v, guess_key(clod, v));
  return LOD_OK;
}

/* Those around a hole may be worth another try. */
static void requeue_ring(struct lod_clod *clod, double key) {
  const struct clod_hole *hole = clod->hole;
  for (uint32_t h = 0; h < hole->half_count; h++)
    for (uint32_t i = 0; i < hole->halves[h].size; i++) {
      uint32_t v = hole->halves[h].ring[i];
      if (clod->removable[v] != 0 && clod->queue->place[v] == LOD_NONE)
        push(clod->queue, v, key);
    }
}

enum lod_status lod_clod_simplify(struct lod_clod *clod, uint32_t patches, double error, const struct lod_progress *progress) {
  if (clod->queue == NULL)
    LOD_TRY(start(clod));
  struct clod_queue *queue = clod->queue;
  while (clod->living_patches > patches && queue->count > 0 && queue->heap[0].key <= error) {
    if (clod->tried % 256 == 0 && lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    struct entry top = pop(queue);
    double next = queue->count > 0 ? queue->heap[0].key : INFINITY, enough = fmin(error, fmax(queue->reached, kEase * next));
    LOD_TRY(clod_try_removal(clod, top.vertex, NULL, false, INFINITY));
    double cost = clod->hole->cost;
    if (isfinite(cost) && cost <= enough) {
      queue->reached = fmax(queue->reached, cost);
      LOD_TRY(clod_commit(clod));
      requeue_ring(clod, cost);
      continue;
    }
    LOD_TRY(clod_give_up(clod));
    if (isfinite(cost))
      push(queue, top.vertex, cost);
  }
  return LOD_OK;
}
