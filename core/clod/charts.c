/* The C-Model of splines: a patch for every chart (Gopi & Manocha 1998, 5.2), what it covers known triangle by triangle. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/base/tolerance.h"
#include "core/clod/internal.h"

/* A side of a chart: the vertices along it, from its corner on. */
struct side {
  uint32_t begin, count; /* of chain */
};

struct maker {
  struct lod_clod *clod;
  const struct lod_mesh *mesh;
  const struct lod_charts *charts;
  struct lod_arena *scratch;
  uint32_t *begin, *triangles; /* triangles of charts */
  struct lod_bezier *nets;
  struct side *sides; /* 3 a chart */
  uint32_t *chain, chain_count, chain_room;
  uint32_t *twin;        /* 3 a chart: the other chart's side, or LOD_NONE */
  uint32_t *corner_sets; /* 3 a chart */
  bool *fixed;           /* 3 a chart: the side meets others that do not match it, and stays as it is */
  bool suitable;
};

static enum lod_status list_triangles(struct maker *m) {
  uint32_t count = m->charts->count;
  m->begin = LOD_NEW_ZERO(m->scratch, (size_t)count + 2, uint32_t);
  m->triangles = LOD_NEW(m->scratch, m->mesh->triangle_count, uint32_t);
  if (m->begin == NULL || m->triangles == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < m->mesh->triangle_count; t++)
    m->begin[m->charts->of[t] + 2]++;
  for (uint32_t c = 0; c < count; c++)
    m->begin[c + 2] += m->begin[c + 1];
  for (uint32_t t = 0; t < m->mesh->triangle_count; t++)
    m->triangles[m->begin[m->charts->of[t] + 1]++] = t;
  return LOD_OK;
}

/* Nodes and cells of a chart. A vertex is one node: where a side is a point all its coordinates are that corner's. */
static enum lod_status make_cells(struct maker *m, uint32_t c, uint32_t *node_of, uint32_t *stamp) {
  struct lod_clod *clod = m->clod;
  struct clod_patch *patch = &clod->patches[c];
  uint32_t cells = m->begin[c + 1] - m->begin[c], nodes = 0;
  struct clod_node *list = LOD_NEW(m->scratch, 3 * (size_t)cells, struct clod_node);
  *patch = (struct clod_patch){.died = UINT32_MAX, .cell_count = cells, .material = LOD_NONE};
  patch->cells = clod_pool_take(&clod->pool, cells * sizeof *patch->cells);
  if (list == NULL || patch->cells == NULL)
    return LOD_MEMORY;
  patch->corners[0] = patch->corners[1] = patch->corners[2] = LOD_NONE;
  for (uint32_t i = 0; i < cells; i++) {
    uint32_t t = m->triangles[m->begin[c] + i];
    if (i == 0 && m->mesh->materials != NULL)
      patch->material = m->mesh->materials[t];
    if (i == 0 && m->mesh->parts != NULL)
      patch->part = m->mesh->parts[t];
    patch->cells[i].face = t;
    for (int k = 0; k < 3; k++) {
      uint32_t v = m->mesh->triangles[t][k];
      const float *at = m->charts->at[t][k];
      if (stamp[v] != c + 1) {
        stamp[v] = c + 1;
        node_of[v] = nodes;
        list[nodes++] = (struct clod_node){.v = (double)at[1], .w = (double)at[2], .id = v, .u0 = at[0] == 0};
        for (uint32_t corner = 0; corner < 3; corner++)
          if (at[corner] == 1)
            patch->corners[corner] = v;
      }
      patch->cells[i].node[k] = node_of[v];
    }
  }
  patch->nodes = clod_pool_take(&clod->pool, nodes * sizeof *patch->nodes);
  if (patch->nodes == NULL)
    return LOD_MEMORY;
  memcpy(patch->nodes, list, nodes * sizeof *list);
  patch->node_count = nodes;
  for (int k = 0; k < 3; k++)
    m->suitable = m->suitable && patch->corners[k] != LOD_NONE && patch->corners[k] != patch->corners[(k + 1) % 3];
  return LOD_OK;
}

/* Parameter of a node along side k, from corner k, or -1 when it is not on it. */
static double along_side(const struct clod_node *node, uint32_t k) {
  double at[3] = {node->u0 ? 0 : 1 - node->v - node->w, node->v, node->w};
  bool zero = (k == 0 && node->w == 0) || (k == 1 && node->u0) || (k == 2 && node->v == 0);
  return zero ? at[(k + 1) % 3] : -1;
}

struct on_side {
  double t;
  uint32_t vertex;
};

static int by_parameter(const void *a, const void *b) {
  const struct on_side *x = a, *y = b;
  return x->t != y->t ? (x->t < y->t ? -1 : 1) : (x->vertex > y->vertex) - (x->vertex < y->vertex);
}

static enum lod_status make_sides(struct maker *m, uint32_t c) {
  const struct clod_patch *patch = &m->clod->patches[c];
  struct on_side *list = LOD_NEW(m->scratch, patch->node_count, struct on_side);
  if (list == NULL)
    return LOD_MEMORY;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t count = 0;
    for (uint32_t n = 0; n < patch->node_count; n++) {
      double t = along_side(&patch->nodes[n], k);
      if (t >= 0)
        list[count++] = (struct on_side){t, patch->nodes[n].id};
    }
    qsort(list, count, sizeof *list, by_parameter);
    if (!clod_grow(m->scratch, (void **)&m->chain, &m->chain_room, m->chain_count + count, sizeof *m->chain))
      return LOD_MEMORY;
    m->sides[3 * c + k] = (struct side){m->chain_count, count};
    for (uint32_t i = 0; i < count; i++)
      m->chain[m->chain_count++] = list[i].vertex;
  }
  return LOD_OK;
}

/* ---- neighbours ---- */

struct key {
  uint32_t low, high, side; /* the two ends */
};

static int by_ends(const void *a, const void *b) {
  const struct key *x = a, *y = b;
  if (x->low != y->low)
    return x->low < y->low ? -1 : 1;
  if (x->high != y->high)
    return x->high < y->high ? -1 : 1;
  return x->side < y->side ? -1 : 1;
}

static bool is_reverse(const struct maker *m, uint32_t a, uint32_t b) {
  struct side x = m->sides[a], y = m->sides[b];
  bool same = x.count == y.count;
  for (uint32_t i = 0; i < x.count && same; i++)
    same = m->chain[x.begin + i] == m->chain[y.begin + y.count - 1 - i];
  return same;
}

/* A side is a border only where no other uses its vertices. Elsewhere more than two charts meet, or two that do not match: all of these
 * sides stay the splines' own curves, which are the same, and so does the seam. */
static enum lod_status find_fixed(struct maker *m) {
  uint32_t count = 3 * m->charts->count;
  uint32_t *uses = LOD_NEW_ZERO(m->scratch, m->mesh->vertex_count, uint32_t);
  bool *odd = LOD_NEW_ZERO(m->scratch, m->mesh->vertex_count, bool);
  m->fixed = LOD_NEW_ZERO(m->scratch, count, bool);
  if (uses == NULL || odd == NULL || m->fixed == NULL)
    return LOD_MEMORY;
  for (uint32_t s = 0; s < count; s++)
    for (uint32_t i = 1; i + 1 < m->sides[s].count; i++)
      uses[m->chain[m->sides[s].begin + i]]++;
  for (uint32_t s = 0; s < count; s++)
    for (uint32_t i = 1; i + 1 < m->sides[s].count; i++) {
      uint32_t v = m->chain[m->sides[s].begin + i];
      odd[v] = odd[v] || uses[v] > (m->twin[s] == LOD_NONE ? 1 : 2);
    }
  for (uint32_t s = 0; s < count; s++)
    for (uint32_t i = 1; i + 1 < m->sides[s].count; i++)
      m->fixed[s] = m->fixed[s] || odd[m->chain[m->sides[s].begin + i]];
  return LOD_OK;
}

static enum lod_status find_twins(struct maker *m) {
  uint32_t count = 3 * m->charts->count;
  struct key *keys = LOD_NEW(m->scratch, count, struct key);
  if (keys == NULL)
    return LOD_MEMORY;
  for (uint32_t s = 0; s < count; s++) {
    uint32_t a = m->chain[m->sides[s].begin], b = m->chain[m->sides[s].begin + m->sides[s].count - 1];
    keys[s] = (struct key){a < b ? a : b, a < b ? b : a, s};
    m->twin[s] = LOD_NONE;
  }
  qsort(keys, count, sizeof *keys, by_ends);
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t j = i + 1; j < count && m->twin[keys[i].side] == LOD_NONE && keys[j].low == keys[i].low && keys[j].high == keys[i].high;
         j++)
      if (m->twin[keys[j].side] == LOD_NONE && is_reverse(m, keys[i].side, keys[j].side)) {
        m->twin[keys[i].side] = keys[j].side;
        m->twin[keys[j].side] = keys[i].side;
      }
  return find_fixed(m);
}

/* ---- edges and sectors ---- */

static struct lod_barycentric on_side(uint32_t k, double t) {
  double at[3] = {0, 0, 0};
  at[k] = 1 - t;
  at[(k + 1) % 3] = t;
  return (struct lod_barycentric){at[0], at[1], at[2]};
}

/* Whether two charts bend by more than a crease along their common side. */
static bool is_crease(const struct maker *m, uint32_t s) {
  double least = 1, limit = cos(m->clod->settings.crease_degrees * 3.14159265358979323846 / 180);
  for (int i = 1; i < 8; i++) {
    struct lod_vec3 a = lod_bezier_normal(&m->nets[s / 3], on_side(s % 3, i / 8.0));
    struct lod_vec3 b = lod_bezier_normal(&m->nets[m->twin[s] / 3], on_side(m->twin[s] % 3, 1 - i / 8.0));
    least = fmin(least, lod_vec3_dot(a, b));
  }
  return least < limit;
}

static void add_edge(struct maker *m, uint32_t s) {
  struct lod_clod *clod = m->clod;
  uint32_t twin = m->twin[s], number = clod->edge_count++, n = s % 3 == 2 ? s - 2 : s + 1;
  struct clod_edge *edge = &clod->edges[number];
  bool sharp = twin == LOD_NONE || is_crease(m, s);
  *edge = (struct clod_edge){.users = {s, twin}, .flags = sharp ? CLOD_LINE | CLOD_SHARP : 0};
  if (m->fixed[s])
    edge->flags |= CLOD_LINE | CLOD_FIXED;
  edge->ends[0] = clod->patches[s / 3].corners[s % 3];
  edge->ends[1] = clod->patches[s / 3].corners[n % 3];
  edge->inner[0] = m->nets[s / 3].p[3 + 2 * (s % 3)];
  edge->inner[1] = m->nets[s / 3].p[4 + 2 * (s % 3)];
  clod->patches[s / 3].sides[s % 3] = 2 * number;
  if (twin != LOD_NONE)
    clod->patches[twin / 3].sides[twin % 3] = 2 * number + 1;
  if (!sharp) {
    lod_sets_join(m->corner_sets, s, twin % 3 == 2 ? twin - 2 : twin + 1);
    lod_sets_join(m->corner_sets, n, twin);
  }
}

static enum lod_status make_sectors(struct maker *m) {
  struct lod_clod *clod = m->clod;
  uint32_t corners = 3 * m->charts->count;
  clod->sectors = LOD_NEW_ZERO(clod->arena, corners, struct lod_vec3);
  uint32_t *number = LOD_NEW(m->scratch, corners, uint32_t);
  if (clod->sectors == NULL || number == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < corners; c++) {
    uint32_t root = lod_sets_find(m->corner_sets, c);
    number[c] = root == c ? clod->sector_count++ : number[root];
    clod->patches[c / 3].sectors[c % 3] = number[c];
    struct lod_vec3 *sum = &clod->sectors[number[c]];
    *sum = lod_vec3_add(*sum, lod_bezier_normal(&m->nets[c / 3], on_side(c % 3, 0)));
  }
  for (uint32_t s = 0; s < clod->sector_count; s++) {
    struct lod_vec3 sum = clod->sectors[s];
    clod->sectors[s] = lod_vec3_length(sum) > 0.05 ? lod_vec3_normalize(sum) : (struct lod_vec3){0, 0, 0};
  }
  return LOD_OK;
}

/* 1: inside a face, all patches around it; 2: on a line of two edges; 0: stays. */
static enum lod_status mark_removable(struct maker *m) {
  struct lod_clod *clod = m->clod;
  uint32_t *corners = LOD_NEW_ZERO(m->scratch, clod->vertex_count, uint32_t),
           *around = LOD_NEW_ZERO(m->scratch, clod->vertex_count, uint32_t);
  uint8_t *lines = LOD_NEW_ZERO(m->scratch, clod->vertex_count, uint8_t);
  if (corners == NULL || around == NULL || lines == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * clod->patch_count; h++)
    corners[clod->patches[h / 3].corners[h % 3]]++;
  for (uint32_t e = 0; e < clod->edge_count; e++)
    for (int i = 0; i < 2 && (clod->edges[e].flags & CLOD_LINE) != 0; i++)
      lines[clod->edges[e].ends[i]] =
          (clod->edges[e].flags & CLOD_FIXED) != 0 || lines[clod->edges[e].ends[i]] >= 3 ? 3 : lines[clod->edges[e].ends[i]] + 1;
  for (uint32_t v = 0; v < clod->vertex_count; v++) {
    if (corners[v] == 0)
      continue;
    clod->living_vertices++;
    uint32_t start = clod->half[v], at = start, count = 0;
    do { /* clockwise as far as it goes, then the other way from where it began */
      count++;
      uint32_t across = clod_across(clod, at);
      at = across == LOD_NONE ? LOD_NONE : across % 3 == 2 ? across - 2 : across + 1;
    } while (at != LOD_NONE && at != start && count <= corners[v]);
    for (at = at == start ? LOD_NONE : clod_across(clod, start % 3 == 0 ? start + 2 : start - 1); at != LOD_NONE && count <= corners[v];
         at = clod_across(clod, at % 3 == 0 ? at + 2 : at - 1))
      count++;
    clod->removable[v] = count != corners[v] ? 0 : lines[v] == 0 ? 1 : lines[v] == 2 ? 2 : 0;
  }
  return LOD_OK;
}

/* ---- fitting ---- */

/* Edges that are not exactly the splines' (diagonals, higher degrees, rational ones) are fitted to the vertices along them where that is
 * nearer. */
static enum lod_status fit_edge(struct maker *m, uint32_t e) {
  struct clod_edge *edge = &m->clod->edges[e];
  struct side side = m->sides[edge->users[0]];
  const struct clod_patch *patch = &m->clod->patches[edge->users[0] / 3];
  if (side.count < 4 || (edge->flags & CLOD_FIXED) != 0)
    return LOD_OK;
  double *t = LOD_NEW(m->scratch, side.count, double);
  struct lod_vec3 *samples = LOD_NEW(m->scratch, side.count, struct lod_vec3), inner[2] = {edge->inner[0], edge->inner[1]};
  if (t == NULL || samples == NULL)
    return LOD_MEMORY;
  uint32_t count = 0;
  for (uint32_t n = 0; n < patch->node_count; n++) {
    double at = along_side(&patch->nodes[n], edge->users[0] % 3);
    if (at > 0 && at < 1) {
      t[count] = at;
      samples[count++] = m->clod->positions[patch->nodes[n].id];
    }
  }
  struct clod_end ends[2] = {{.p = m->clod->positions[edge->ends[0]]}, {.p = m->clod->positions[edge->ends[1]]}};
  clod_fit_curve(ends, t, samples, count, 1e-6, inner);
  double before = 0, after = 0;
  struct lod_bezier_curve old = {{ends[0].p, edge->inner[0], edge->inner[1], ends[1].p}},
                          fitted = {{ends[0].p, inner[0], inner[1], ends[1].p}};
  for (uint32_t i = 0; i < count; i++) {
    before = fmax(before, lod_vec3_distance(lod_bezier_curve_point(&old, t[i]), samples[i]));
    after = fmax(after, lod_vec3_distance(lod_bezier_curve_point(&fitted, t[i]), samples[i]));
  }
  if (after < 0.8 * before)
    memcpy(edge->inner, inner, sizeof inner);
  return LOD_OK;
}

/* Centres: the rule's, or fitted to what the patch covers, with points moved to where the patch is nearest; what is bounded best. */
static void fit_centre(struct maker *m, uint32_t p) {
  struct lod_clod *clod = m->clod;
  struct clod_patch *patch = &clod->patches[p];
  struct lod_bezier net = clod_net(clod, patch), best;
  lod_bezier_set_centre(&net);
  best = net;
  patch->bound = clod_patch_bound(clod, &net, patch->nodes, patch->cells, patch->cell_count, INFINITY);
  for (int round = 0; round < 3; round++) {
    if (round > 0)
      clod_project_nodes(clod, &net, patch->nodes, patch->node_count);
    clod_fit_centre(clod, &net, patch->nodes, patch->node_count, patch->cells, patch->cell_count);
    /* Nodes have moved, so the last is taken; in the first round only what is better. */
    double bound = clod_patch_bound(clod, &net, patch->nodes, patch->cells, patch->cell_count, INFINITY);
    if (round > 0 || bound < patch->bound) {
      best = net;
      patch->bound = bound;
    }
  }
  patch->centre = best.p[LOD_BEZIER_CENTRE];
}

/* ---- all of it ---- */

static enum lod_status allocate(struct maker *m) {
  struct lod_clod *clod = m->clod;
  uint32_t count = m->charts->count, vertices = m->mesh->vertex_count;
  clod->vertex_count = vertices;
  clod->patch_room = count;
  clod->edge_room = 3 * count;
  clod->positions = LOD_NEW(clod->arena, vertices, struct lod_vec3);
  clod->points = LOD_NEW(clod->arena, vertices, struct lod_vec3);
  clod->removable = LOD_NEW_ZERO(clod->arena, vertices, uint8_t);
  clod->half = LOD_NEW(clod->arena, vertices, uint32_t);
  clod->patches = LOD_NEW(clod->arena, count, struct clod_patch);
  clod->edges = LOD_NEW(clod->arena, 3 * (size_t)count, struct clod_edge);
  m->nets = LOD_NEW(m->scratch, count, struct lod_bezier);
  m->sides = LOD_NEW(m->scratch, 3 * (size_t)count, struct side);
  m->twin = LOD_NEW(m->scratch, 3 * (size_t)count, uint32_t);
  m->corner_sets = LOD_NEW(m->scratch, 3 * (size_t)count, uint32_t);
  return clod->positions != NULL && clod->points != NULL && clod->removable != NULL && clod->half != NULL && clod->patches != NULL &&
                 clod->edges != NULL && m->nets != NULL && m->sides != NULL && m->twin != NULL && m->corner_sets != NULL
             ? LOD_OK
             : LOD_MEMORY;
}

static enum lod_status make_patches(struct maker *m) {
  struct lod_clod *clod = m->clod;
  uint32_t *node_of = LOD_NEW(m->scratch, clod->vertex_count, uint32_t), *stamp = LOD_NEW_ZERO(m->scratch, clod->vertex_count, uint32_t);
  if (node_of == NULL || stamp == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    clod->positions[v] = clod->points[v] = lod_vec3_from_float(m->mesh->positions[v]);
  clod->point_count = clod->point_room = clod->vertex_count;
  memset(clod->half, 0xff, clod->vertex_count * sizeof *clod->half);
  for (uint32_t c = 0; c < m->charts->count && m->suitable; c++) {
    m->suitable = m->begin[c + 1] > m->begin[c];
    if (!m->suitable)
      break;
    LOD_TRY(make_cells(m, c, node_of, stamp));
    if (!m->suitable)
      break;
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      m->nets[c].p[i] = (struct lod_vec3){m->charts->nets[c][i][0], m->charts->nets[c][i][1], m->charts->nets[c][i][2]};
    for (uint32_t k = 0; k < 3; k++) {
      m->nets[c].p[k] = clod->positions[clod->patches[c].corners[k]];
      clod->half[clod->patches[c].corners[k]] = 3 * c + k;
      m->corner_sets[3 * c + k] = 3 * c + k;
    }
    LOD_TRY(make_sides(m, c));
  }
  return LOD_OK;
}

static enum lod_status make(struct maker *m) {
  struct lod_clod *clod = m->clod;
  LOD_TRY(allocate(m));
  LOD_TRY(list_triangles(m));
  LOD_TRY(make_patches(m));
  if (!m->suitable)
    return LOD_OK;
  clod->patch_count = clod->living_patches = m->charts->count;
  LOD_TRY(find_twins(m));
  if (!m->suitable)
    return LOD_OK;
  for (uint32_t s = 0; s < 3 * clod->patch_count; s++)
    if (m->twin[s] == LOD_NONE || m->twin[s] > s)
      add_edge(m, s);
  LOD_TRY(make_sectors(m));
  LOD_TRY(mark_removable(m));
  for (uint32_t e = 0; e < clod->edge_count; e++)
    LOD_TRY(fit_edge(m, e));
  for (uint32_t p = 0; p < clod->patch_count; p++)
    fit_centre(m, p);
  return LOD_OK;
}

enum lod_status lod_clod_create_charts(const struct lod_mesh *mesh, const struct lod_charts *charts,
                                       const struct lod_clod_settings *settings, struct lod_arena *arena, struct lod_clod **clod,
                                       bool *suitable, struct lod_problem *problem) {
  *clod = NULL;
  *suitable = false;
  if (mesh->triangle_count >= 1u << 28 || charts->count >= 1u << 28)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "More than 2^28 triangles cannot become curved patches.");
  struct lod_clod *c = clod_begin(mesh, settings, arena);
  if (c != NULL) /* no spline file that is read has any */
    c->attributes = (struct lod_patch_attributes){0};
  struct maker m = {.clod = c, .mesh = mesh, .charts = charts, .scratch = lod_arena_create_child(arena), .suitable = true};
  enum lod_status status = LOD_MEMORY;
  if (c != NULL && m.scratch != NULL)
    status = make(&m);
  lod_arena_destroy(m.scratch);
  *suitable = status == LOD_OK && m.suitable;
  *clod = *suitable ? c : NULL;
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
