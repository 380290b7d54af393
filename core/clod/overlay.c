/* Which part of the source lies where in the patches of a hole: gathered, mended, cut by new diagonals, dealt to new triangles.
 *
 * The overlay is the common refinement of the source's triangles and the patches: its triangles (cells) lie in one of each, and their
 * corners say where in both. Where a patch's edge is given up, the points in which it cut the source's edges are taken out again, so that
 * the overlay stays about as fine as the source (Turk 1992, 6.2, knows such fragments; he keeps them). Any correspondence that is
 * continuous and takes sides to sides serves the bound, so points may be moved along sides, and inside, as a better fit asks for. */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"

enum node_kind { NODE_INNER, NODE_SIDE, NODE_CORNER, NODE_DIAGONAL, NODE_GONE };

struct local_node {
  double x[2], t; /* t: along the side or diagonal */
  struct lod_vec3 p;
  uint32_t id, kind, ref; /* ref: side, ring vertex or diagonal */
};

struct local_cell {
  uint32_t node[3], face, target; /* target: new triangle, or LOD_NONE = taken out */
};

struct local_half {
  struct local_node *nodes;
  struct local_cell *cells;
  uint32_t node_count, node_room, cell_count, cell_room;
  /* Dealt: nodes and cells of triangle i from node_begin[i], cell_begin[i]. */
  struct clod_node *dealt_nodes;
  struct clod_cell *dealt_cells;
  uint32_t dealt_node_room, dealt_cell_room;
  uint32_t node_begin[CLOD_RING + 1], cell_begin[CLOD_RING + 1];
};

struct clod_local {
  struct lod_arena *arena;
  struct local_half halves[CLOD_HALVES];
  uint32_t *stamp, *value; /* by point id: local node while stamp is current */
  uint32_t stamp_room, value_room, now;
  uint32_t *begin, *list, *fill; /* cells around nodes */
  uint32_t begin_room, list_room, fill_room;
  uint64_t *keys; /* cut edges */
  uint32_t *cuts;
  uint32_t key_room, cut_room;
  uint32_t *made, *gone; /* points made, and points taken out */
  uint32_t made_count, made_room, gone_count, gone_room;
  double *t;
  struct lod_vec3 *samples;
  uint32_t *sample_nodes;
  uint32_t t_room, sample_room, sample_node_room;
  double *line_t; /* by point id, with stamp: parameter on the line's new edge, from ring 0 of halves[0] */
  uint32_t line_room;
};

#define GROW(local, array, room, needed)                                                                                                   \
  do {                                                                                                                                     \
    if (!clod_grow((local)->arena, (void **)&(array), &(room), (needed), sizeof *(array)))                                                 \
      return LOD_MEMORY;                                                                                                                   \
  } while (0)

enum lod_status clod_local_create(struct lod_arena *arena, struct clod_local **local) {
  *local = LOD_NEW_ZERO(arena, 1, struct clod_local);
  if (*local == NULL)
    return LOD_MEMORY;
  (*local)->arena = arena;
  return LOD_OK;
}

static enum lod_status grow_stamps(struct clod_local *local, uint32_t points) {
  uint32_t old = local->stamp_room;
  GROW(local, local->stamp, local->stamp_room, points);
  if (local->stamp_room > old)
    memset(local->stamp + old, 0, (local->stamp_room - old) * sizeof *local->stamp);
  GROW(local, local->value, local->value_room, points);
  GROW(local, local->line_t, local->line_room, points);
  return LOD_OK;
}

/* ---- gathering ---- */

/* Where a node of old patch i lies in the hole, from its coordinates b0 (the vertex), b1, b2 (ring vertices i and i + 1). */
static void place(const struct clod_hole *hole, const struct clod_polygon *polygon, uint32_t i, const double b[3], const bool zero[3],
                  double line_t, struct local_node *node) {
  uint32_t next = (i + 1) % polygon->size;
  (void)hole;
  for (int axis = 0; axis < 2; axis++)
    node->x[axis] = b[1] * polygon->x[i][axis] + b[2] * polygon->x[next][axis];
  node->kind = NODE_INNER;
  node->ref = 0;
  node->t = 0;
  if (zero[0]) {
    node->kind = zero[1] || zero[2] ? NODE_CORNER : NODE_SIDE;
    node->ref = zero[1] ? next : i;
    node->t = b[2];
  } else if (polygon->open && zero[1] && zero[2]) {
    node->kind = NODE_DIAGONAL;
    node->t = line_t;
  } else if (polygon->open && i == 0 && zero[2]) {
    node->kind = NODE_DIAGONAL;
    node->t = (1 - b[1]) * line_t;
  } else if (polygon->open && i + 1 == polygon->old_count && zero[1]) {
    node->kind = NODE_DIAGONAL;
    node->t = line_t + (1 - line_t) * b[2];
  }
}

static enum lod_status gather(struct lod_clod *clod, struct clod_hole *hole, uint32_t h) {
  struct clod_local *local = hole->local;
  struct local_half *half = &local->halves[h];
  const struct clod_polygon *polygon = &hole->halves[h];
  uint32_t nodes = 0, cells = 0;
  for (uint32_t i = 0; i < polygon->old_count; i++) {
    nodes += clod->patches[polygon->old[i] / 3].node_count;
    cells += clod->patches[polygon->old[i] / 3].cell_count;
  }
  GROW(local, half->nodes, half->node_room, nodes);
  GROW(local, half->cells, half->cell_room, cells);
  half->node_count = half->cell_count = 0;
  local->now++;
  double line_t = h == 0 ? hole->line_t : 1 - hole->line_t;
  for (uint32_t i = 0; i < polygon->old_count; i++) {
    const struct clod_patch *patch = &clod->patches[polygon->old[i] / 3];
    uint32_t corner = polygon->old[i] % 3;
    for (uint32_t n = 0; n < patch->node_count; n++) {
      const struct clod_node *node = &patch->nodes[n];
      if (local->stamp[node->id] == local->now)
        continue;
      double at[3] = {node->u0 ? 0 : 1 - node->v - node->w, node->v, node->w}, b[3];
      bool none[3] = {node->u0 != 0, node->v == 0, node->w == 0}, zero[3];
      for (uint32_t k = 0; k < 3; k++) {
        b[k] = at[(corner + k) % 3];
        zero[k] = none[(corner + k) % 3];
      }
      struct local_node *placed = &half->nodes[half->node_count];
      placed->id = node->id;
      placed->p = clod->points[node->id];
      place(hole, polygon, i, b, zero, line_t, placed);
      local->stamp[node->id] = local->now;
      local->value[node->id] = half->node_count++;
    }
    for (uint32_t c = 0; c < patch->cell_count; c++) {
      struct local_cell *cell = &half->cells[half->cell_count++];
      for (int k = 0; k < 3; k++)
        cell->node[k] = local->value[patch->nodes[patch->cells[c].node[k]].id];
      cell->face = patch->cells[c].face;
      cell->target = 0;
    }
  }
  return LOD_OK;
}

/* ---- mending ---- */

static enum lod_status list_cells(struct clod_local *local, const struct local_half *half) {
  GROW(local, local->begin, local->begin_room, half->node_count + 1);
  GROW(local, local->fill, local->fill_room, half->node_count + 1);
  GROW(local, local->list, local->list_room, 3 * half->cell_count + 1);
  memset(local->begin, 0, (half->node_count + 1) * sizeof *local->begin);
  for (uint32_t c = 0; c < half->cell_count; c++)
    for (int k = 0; k < 3; k++)
      local->begin[half->cells[c].node[k] + 1]++;
  for (uint32_t n = 0; n < half->node_count; n++)
    local->begin[n + 1] += local->begin[n];
  memcpy(local->fill, local->begin, half->node_count * sizeof *local->fill);
  for (uint32_t c = 0; c < half->cell_count; c++)
    for (int k = 0; k < 3; k++)
      local->list[local->fill[half->cells[c].node[k]]++] = c;
  return LOD_OK;
}

static struct lod_vec3 cell_normal(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a));
}

static int corner_of(const struct local_cell *cell, uint32_t node) {
  return cell->node[0] == node ? 0 : cell->node[1] == node ? 1 : cell->node[2] == node ? 2 : -1;
}

/* Moves `node`, a point where an edge was cut, to its neighbour `to` on that edge: only if no cell turns over on the source. */
static bool may_move(const struct local_half *half, const uint32_t *ring, uint32_t count, uint32_t node, uint32_t to) {
  for (uint32_t i = 0; i < count; i++) {
    const struct local_cell *cell = &half->cells[ring[i]];
    if (corner_of(cell, to) >= 0)
      continue;
    struct lod_vec3 p[3], q[3];
    for (int k = 0; k < 3; k++) {
      p[k] = half->nodes[cell->node[k]].p;
      q[k] = cell->node[k] == node ? half->nodes[to].p : p[k];
    }
    struct lod_vec3 before = cell_normal(p[0], p[1], p[2]), after = cell_normal(q[0], q[1], q[2]);
    double size = lod_vec3_length(before);
    if (!(lod_vec3_dot(before, after) > 1e-6 * size * lod_vec3_length(after)) || !(lod_vec3_length(after) > 0) || !(size > 0))
      return false;
  }
  return true;
}

/* Neighbours of `node` where the source triangle changes: ends[] = the two on its source edge. All on one triangle: any neighbour is as
 * good, the first two are given. False when it is neither. */
static bool edge_neighbours(const struct local_half *half, const uint32_t *ring, uint32_t count, uint32_t node, uint32_t ends[2]) {
  uint32_t found = 0;
  for (uint32_t i = 0; i < count; i++) {
    const struct local_cell *cell = &half->cells[ring[i]];
    uint32_t left = cell->node[(corner_of(cell, node) + 2) % 3], other = LOD_NONE;
    for (uint32_t j = 0; j < count && other == LOD_NONE; j++)
      if (j != i && corner_of(&half->cells[ring[j]], left) >= 0)
        other = ring[j];
    if (other == LOD_NONE)
      return false; /* not all around */
    if (half->cells[other].face != cell->face) {
      if (found == 2)
        return false;
      ends[found++] = left;
    }
  }
  if (found == 0) {
    for (uint32_t i = 0; i < 2; i++)
      ends[i] = half->cells[ring[i]].node[(corner_of(&half->cells[ring[i]], node) + 2) % 3];
    found = 2;
  }
  return found == 2;
}

static enum lod_status mend_once(struct lod_clod *clod, struct clod_local *local, struct local_half *half, uint32_t *mended) {
  LOD_TRY(list_cells(local, half));
  *mended = 0;
  for (uint32_t n = 0; n < half->node_count; n++) {
    struct local_node *node = &half->nodes[n];
    if (node->kind != NODE_INNER || node->id < clod->vertex_count)
      continue;
    const uint32_t *ring = local->list + local->begin[n];
    uint32_t count = local->begin[n + 1] - local->begin[n], ends[2];
    bool stale = count < 3;
    for (uint32_t i = 0; i < count && !stale; i++)
      stale = half->cells[ring[i]].target != 0; /* taken out or changed in this round */
    if (stale || !edge_neighbours(half, ring, count, n, ends))
      continue;
    for (int e = 0; e < 2; e++) {
      if (!may_move(half, ring, count, n, ends[e]))
        continue;
      for (uint32_t i = 0; i < count; i++) {
        struct local_cell *cell = &half->cells[ring[i]];
        if (corner_of(cell, ends[e]) >= 0) {
          cell->target = LOD_NONE;
        } else {
          cell->node[corner_of(cell, n)] = ends[e];
          cell->target = 1;
        }
      }
      GROW(local, local->gone, local->gone_room, local->gone_count + 1);
      local->gone[local->gone_count++] = node->id;
      node->kind = NODE_GONE;
      ++*mended;
      break;
    }
  }
  uint32_t kept = 0;
  for (uint32_t c = 0; c < half->cell_count; c++)
    if (half->cells[c].target != LOD_NONE) {
      half->cells[kept] = half->cells[c];
      half->cells[kept++].target = 0;
    }
  half->cell_count = kept;
  return LOD_OK;
}

/* Points next to one another go in different rounds. */
static enum lod_status mend(struct lod_clod *clod, struct clod_local *local, struct local_half *half) {
  enum { ROUNDS = 4 };
  uint32_t mended = 1;
  for (int round = 0; round < ROUNDS && mended > 0; round++)
    LOD_TRY(mend_once(clod, local, half, &mended));
  return LOD_OK;
}

/* ---- cutting ---- */

struct cutter {
  struct lod_clod *clod;
  struct clod_local *local;
  struct local_half *half;
  uint32_t diagonal, mask;
  double origin[2], d[2], length2;
  bool good;
};

/* Signed area to the diagonal's line, 0 for what lies on the diagonal. */
static double side_of(const struct cutter *cutter, const struct clod_polygon *polygon, const struct local_node *node) {
  const uint32_t *ends = polygon->diagonals[cutter->diagonal];
  if (node->kind == NODE_DIAGONAL && node->ref == cutter->diagonal)
    return 0;
  if (node->kind == NODE_CORNER && (node->ref == ends[0] || node->ref == ends[1]))
    return 0;
  return cutter->d[0] * (node->x[1] - cutter->origin[1]) - cutter->d[1] * (node->x[0] - cutter->origin[0]);
}

static double along(const struct cutter *cutter, const double x[2]) {
  return (cutter->d[0] * (x[0] - cutter->origin[0]) + cutter->d[1] * (x[1] - cutter->origin[1])) / cutter->length2;
}

/* Inside nodes next to the diagonal are put on it. */
static void snap(struct cutter *cutter, const struct clod_polygon *polygon) {
  for (uint32_t n = 0; n < cutter->half->node_count; n++) {
    struct local_node *node = &cutter->half->nodes[n];
    if (node->kind != NODE_INNER)
      continue;
    double t = along(cutter, node->x);
    if (fabs(side_of(cutter, polygon, node)) > 1e-5 * cutter->length2 || !(t > 1e-4 && t < 1 - 1e-4))
      continue;
    node->kind = NODE_DIAGONAL;
    node->ref = cutter->diagonal;
    node->t = t;
    for (int axis = 0; axis < 2; axis++)
      node->x[axis] = cutter->origin[axis] + t * cutter->d[axis];
  }
}

static enum lod_status new_point(struct lod_clod *clod, struct clod_local *local, struct lod_vec3 p, uint32_t *id) {
  if (clod->free_count > 0) {
    *id = clod->free_points[--clod->free_count];
  } else {
    GROW(clod, clod->points, clod->point_room, clod->point_count + 1);
    *id = clod->point_count++;
  }
  clod->points[*id] = p;
  GROW(local, local->made, local->made_room, local->made_count + 1);
  local->made[local->made_count++] = *id;
  return LOD_OK;
}

/* The node where the diagonal cuts the edge a-b, made once for both cells of it; LOD_NONE when it passes outside of the diagonal. */
static enum lod_status cut_edge(struct cutter *cutter, uint32_t a, uint32_t b, double sa, double sb, uint32_t *cut) {
  struct clod_local *local = cutter->local;
  struct local_half *half = cutter->half;
  if (a > b) {
    uint32_t node = a;
    a = b;
    b = node;
    double s = sa;
    sa = sb;
    sb = s;
  }
  uint64_t key = ((uint64_t)a << 32 | b) + 1;
  uint32_t slot = (uint32_t)((key * 0x9E3779B97F4A7C15u) >> 33) & cutter->mask;
  for (; local->keys[slot] != 0; slot = (slot + 1) & cutter->mask)
    if (local->keys[slot] == key) {
      *cut = local->cuts[slot];
      return LOD_OK;
    }
  double s = sa / (sa - sb), x[2];
  for (int axis = 0; axis < 2; axis++)
    x[axis] = half->nodes[a].x[axis] + s * (half->nodes[b].x[axis] - half->nodes[a].x[axis]);
  double t = along(cutter, x);
  local->keys[slot] = key;
  local->cuts[slot] = *cut = LOD_NONE;
  if (!(t > 0 && t < 1))
    return LOD_OK;
  GROW(local, half->nodes, half->node_room, half->node_count + 1);
  struct local_node *node = &half->nodes[half->node_count];
  *node = (struct local_node){.t = t, .kind = NODE_DIAGONAL, .ref = cutter->diagonal};
  for (int axis = 0; axis < 2; axis++)
    node->x[axis] = cutter->origin[axis] + t * cutter->d[axis];
  struct lod_vec3 p = half->nodes[a].p;
  node->p = lod_vec3_add_scaled(p, lod_vec3_subtract(half->nodes[b].p, p), s);
  LOD_TRY(new_point(cutter->clod, local, node->p, &node->id));
  local->cuts[slot] = *cut = half->node_count++;
  return LOD_OK;
}

static enum lod_status add_cell(struct cutter *cutter, uint32_t a, uint32_t b, uint32_t c, uint32_t face) {
  GROW(cutter->local, cutter->half->cells, cutter->half->cell_room, cutter->half->cell_count + 1);
  cutter->half->cells[cutter->half->cell_count++] = (struct local_cell){{a, b, c}, face, 0};
  return LOD_OK;
}

static enum lod_status cut_cell(struct cutter *cutter, const struct clod_polygon *polygon, uint32_t c) {
  struct local_cell cell = cutter->half->cells[c];
  double s[3];
  uint32_t cut[3], count = 0;
  for (int k = 0; k < 3; k++)
    s[k] = side_of(cutter, polygon, &cutter->half->nodes[cell.node[k]]);
  for (int k = 0; k < 3; k++) {
    int n = (k + 1) % 3;
    cut[k] = LOD_NONE;
    if (s[k] * s[n] < 0)
      LOD_TRY(cut_edge(cutter, cell.node[k], cell.node[n], s[k], s[n], &cut[k]));
    count += cut[k] != LOD_NONE;
  }
  if (count == 0)
    return LOD_OK;
  if (count == 1) {
    int k = cut[0] != LOD_NONE ? 0 : cut[1] != LOD_NONE ? 1 : 2;
    uint32_t a = cell.node[k], b = cell.node[(k + 1) % 3], o = cell.node[(k + 2) % 3];
    cutter->good = cutter->good && s[(k + 2) % 3] == 0;
    cutter->half->cells[c] = (struct local_cell){{a, cut[k], o}, cell.face, 0};
    return add_cell(cutter, cut[k], b, o, cell.face);
  }
  if (count == 3) {
    cutter->good = false;
    return LOD_OK;
  }
  int k = cut[2] == LOD_NONE ? 0 : cut[0] == LOD_NONE ? 1 : 2; /* sides k and k + 1 are cut */
  uint32_t a = cell.node[k], tip = cell.node[(k + 1) % 3], b = cell.node[(k + 2) % 3], m = cut[k], n = cut[(k + 1) % 3];
  cutter->half->cells[c] = (struct local_cell){{m, tip, n}, cell.face, 0};
  LOD_TRY(add_cell(cutter, a, m, n, cell.face));
  return add_cell(cutter, a, n, b, cell.face);
}

static enum lod_status cut_by_diagonals(struct lod_clod *clod, struct clod_hole *hole, uint32_t h, bool *good) {
  struct clod_local *local = hole->local;
  struct local_half *half = &local->halves[h];
  const struct clod_polygon *polygon = &hole->halves[h];
  for (uint32_t d = polygon->open ? 1 : 0; d < polygon->diagonal_count; d++) {
    const double *a = polygon->x[polygon->diagonals[d][0]], *b = polygon->x[polygon->diagonals[d][1]];
    struct cutter cutter = {.clod = clod, .local = local, .half = half, .diagonal = d, .good = true};
    for (int axis = 0; axis < 2; axis++) {
      cutter.origin[axis] = a[axis];
      cutter.d[axis] = b[axis] - a[axis];
    }
    cutter.length2 = cutter.d[0] * cutter.d[0] + cutter.d[1] * cutter.d[1];
    uint32_t size = 64;
    while (size < 4 * half->cell_count)
      size *= 2;
    cutter.mask = size - 1;
    GROW(local, local->keys, local->key_room, size);
    GROW(local, local->cuts, local->cut_room, size);
    memset(local->keys, 0, size * sizeof *local->keys);
    snap(&cutter, polygon);
    uint32_t count = half->cell_count;
    for (uint32_t c = 0; c < count; c++)
      LOD_TRY(cut_cell(&cutter, polygon, c));
    *good = *good && cutter.good;
  }
  return LOD_OK;
}

/* ---- dealing ---- */

/* Barycentric coordinates of x in new triangle t. */
static void coordinates(const struct clod_polygon *polygon, uint32_t t, const double x[2], double b[3]) {
  const double *p = polygon->x[polygon->triangles[t][0]], *q = polygon->x[polygon->triangles[t][1]],
               *r = polygon->x[polygon->triangles[t][2]];
  double area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
  b[1] = ((x[0] - p[0]) * (r[1] - p[1]) - (x[1] - p[1]) * (r[0] - p[0])) / area;
  b[2] = ((q[0] - p[0]) * (x[1] - p[1]) - (q[1] - p[1]) * (x[0] - p[0])) / area;
  b[0] = 1 - b[1] - b[2];
}

static void choose_targets(struct local_half *half, const struct clod_polygon *polygon) {
  for (uint32_t c = 0; c < half->cell_count; c++) {
    struct local_cell *cell = &half->cells[c];
    double x[2] = {0, 0}, best = -INFINITY;
    for (int k = 0; k < 3; k++)
      for (int axis = 0; axis < 2; axis++)
        x[axis] += half->nodes[cell->node[k]].x[axis] / 3;
    cell->target = 0;
    for (uint32_t t = 0; t < polygon->triangle_count && polygon->triangle_count > 1; t++) {
      double b[3];
      coordinates(polygon, t, x, b);
      double least = fmin(b[0], fmin(b[1], b[2]));
      if (least > best) {
        best = least;
        cell->target = t;
      }
    }
  }
}

/* Where a node lies in new triangle t. False when it does not lie there. */
static bool locate(const struct clod_polygon *polygon, uint32_t t, const struct local_node *node, struct clod_node *out) {
  double b[3] = {0, 0, 0};
  const uint32_t *corners = polygon->triangles[t];
  bool zero0 = false;
  if (node->kind == NODE_CORNER) {
    uint32_t k = corners[0] == node->ref ? 0 : corners[1] == node->ref ? 1 : 2;
    if (corners[k] != node->ref)
      return false;
    b[k] = 1;
    zero0 = k != 0;
  } else if (node->kind == NODE_INNER) {
    coordinates(polygon, t, node->x, b);
    if (!(fmin(b[0], fmin(b[1], b[2])) > -1e-6))
      return false;
    double total = 0;
    for (int k = 0; k < 3; k++)
      total += b[k] = fmax(b[k], 1e-9);
    b[1] /= total;
    b[2] /= total;
  } else {
    uint32_t name = node->kind == NODE_SIDE ? node->ref : CLOD_RING + node->ref;
    uint32_t q = polygon->sides[t][0] == name ? 0 : polygon->sides[t][1] == name ? 1 : 2;
    if (polygon->sides[t][q] != name)
      return false;
    bool along_side = node->kind == NODE_SIDE || corners[q] == polygon->diagonals[node->ref][0];
    b[q] = along_side ? 1 - node->t : node->t;
    b[(q + 1) % 3] = along_side ? node->t : 1 - node->t;
    zero0 = q == 1;
  }
  *out = (struct clod_node){.v = b[1], .w = b[2], .id = node->id, .u0 = zero0};
  return true;
}

static enum lod_status deal_half(struct clod_hole *hole, uint32_t h, bool *good) {
  struct clod_local *local = hole->local;
  struct local_half *half = &local->halves[h];
  const struct clod_polygon *polygon = &hole->halves[h];
  GROW(local, half->dealt_cells, half->dealt_cell_room, half->cell_count);
  uint32_t nodes = 0, cells = 0;
  for (uint32_t t = 0; t < polygon->triangle_count; t++) {
    half->node_begin[t] = nodes;
    half->cell_begin[t] = cells;
    local->now++;
    GROW(local, half->dealt_nodes, half->dealt_node_room, nodes + half->node_count);
    for (uint32_t c = 0; c < half->cell_count; c++) {
      const struct local_cell *cell = &half->cells[c];
      if (cell->target != t)
        continue;
      struct clod_cell *out = &half->dealt_cells[cells++];
      out->face = cell->face;
      for (int k = 0; k < 3; k++) {
        const struct local_node *node = &half->nodes[cell->node[k]];
        if (local->stamp[node->id] != local->now) {
          if (!locate(polygon, t, node, &half->dealt_nodes[nodes])) {
            *good = false;
            return LOD_OK;
          }
          local->stamp[node->id] = local->now;
          local->value[node->id] = nodes++ - half->node_begin[t];
        }
        out->node[k] = local->value[node->id];
      }
    }
    *good = *good && cells > half->cell_begin[t];
  }
  half->node_begin[polygon->triangle_count] = nodes;
  half->cell_begin[polygon->triangle_count] = cells;
  return LOD_OK;
}

/* ---- what simplify.c calls ---- */

enum lod_status clod_local_cut(struct lod_clod *clod, struct clod_hole *hole, bool *good) {
  struct clod_local *local = hole->local;
  *good = true;
  local->made_count = local->gone_count = 0;
  for (uint32_t h = 0; h < hole->half_count && *good; h++) {
    LOD_TRY(grow_stamps(local, clod->point_count));
    LOD_TRY(gather(clod, hole, h));
    LOD_TRY(mend(clod, local, &local->halves[h]));
    LOD_TRY(cut_by_diagonals(clod, hole, h, good));
    choose_targets(&local->halves[h], &hole->halves[h]);
  }
  return grow_stamps(local, clod->point_count);
}

enum lod_status clod_local_sample(struct clod_hole *hole, uint32_t h, uint32_t diagonal, double **t, struct lod_vec3 **points,
                                  uint32_t *count) {
  struct clod_local *local = hole->local;
  const struct local_half *half = &local->halves[h];
  *count = 0;
  for (uint32_t n = 0; n < half->node_count; n++)
    if (half->nodes[n].kind == NODE_DIAGONAL && half->nodes[n].ref == diagonal) {
      GROW(local, local->t, local->t_room, *count + 1);
      GROW(local, local->samples, local->sample_room, *count + 1);
      GROW(local, local->sample_nodes, local->sample_node_room, *count + 1);
      local->t[*count] = half->nodes[n].t;
      local->samples[*count] = half->nodes[n].p;
      local->sample_nodes[(*count)++] = n;
    }
  *t = local->t;
  *points = local->samples;
  return LOD_OK;
}

void clod_local_move_samples(struct clod_hole *hole, uint32_t h, uint32_t count) {
  struct clod_local *local = hole->local;
  struct local_half *half = &local->halves[h];
  for (uint32_t s = 0; s < count; s++)
    half->nodes[local->sample_nodes[s]].t = local->t[s];
}

enum lod_status clod_local_deal(struct lod_clod *clod, struct clod_hole *hole, bool *good) {
  struct clod_local *local = hole->local;
  (void)clod;
  if (hole->half_count == 2) { /* both sides of a line see the same parameters */
    const struct local_half *left = &local->halves[0];
    struct local_half *right = &local->halves[1];
    local->now++;
    for (uint32_t n = 0; n < left->node_count; n++)
      if (left->nodes[n].kind == NODE_DIAGONAL && left->nodes[n].ref == 0) {
        local->stamp[left->nodes[n].id] = local->now;
        local->line_t[left->nodes[n].id] = left->nodes[n].t;
      }
    for (uint32_t n = 0; n < right->node_count; n++)
      if (right->nodes[n].kind == NODE_DIAGONAL && right->nodes[n].ref == 0) {
        if (local->stamp[right->nodes[n].id] != local->now) {
          *good = false;
          return LOD_OK;
        }
        right->nodes[n].t = 1 - local->line_t[right->nodes[n].id];
      }
  }
  for (uint32_t h = 0; h < hole->half_count && *good; h++)
    LOD_TRY(deal_half(hole, h, good));
  return LOD_OK;
}

void clod_local_patch(struct clod_hole *hole, uint32_t h, uint32_t i, struct clod_node **nodes, uint32_t *node_count,
                      struct clod_cell **cells, uint32_t *cell_count) {
  struct local_half *half = &hole->local->halves[h];
  *nodes = half->dealt_nodes + half->node_begin[i];
  *node_count = half->node_begin[i + 1] - half->node_begin[i];
  *cells = half->dealt_cells + half->cell_begin[i];
  *cell_count = half->cell_begin[i + 1] - half->cell_begin[i];
}

static enum lod_status give_back(struct lod_clod *clod, const uint32_t *points, uint32_t count) {
  GROW(clod, clod->free_points, clod->free_room, clod->free_count + count);
  memcpy(clod->free_points + clod->free_count, points, count * sizeof *points);
  clod->free_count += count;
  return LOD_OK;
}

enum lod_status clod_local_commit(struct lod_clod *clod, struct clod_hole *hole) {
  return hole->local->gone_count == 0 ? LOD_OK : give_back(clod, hole->local->gone, hole->local->gone_count);
}

enum lod_status clod_local_abandon(struct lod_clod *clod, struct clod_hole *hole) {
  return hole->local->made_count == 0 ? LOD_OK : give_back(clod, hole->local->made, hole->local->made_count);
}
