/* Disks of the finer surface laid out in coarse triangles, in integers. */
#include <string.h>

#include "core/mesh/overlay_private.h"

enum { DENSE = 48, MAX_SWEEPS = 4000, MEND_ROUNDS = 60 };

struct embedder {
  struct overlay_work *w;
  const struct overlay_cells *cells;
  struct lod_overlay *overlay;
  uint32_t *local; /* by node: its number in the disk at hand; valid when nodes[local] is it */
  uint32_t *nodes; /* of the disk: free ones first */
  uint32_t node_count, free_count, capacity;
  uint32_t begin, end; /* fragments of the disk */
  uint32_t face;
  double (*at)[2]; /* weights of corners 0 and 1, of 1 */
  int64_t (*places)[3];
  /* Neighbours of free nodes. */
  uint32_t *link_begin, *links;
  double *link_weights;
  uint32_t link_capacity;
  double *dense; /* DENSE * (DENSE + 2) */
};

static int64_t twice_area(int64_t (*places)[3], uint32_t a, uint32_t b, uint32_t c) {
  const int64_t *p = places[a], *q = places[b], *r = places[c];
  return (q[1] - p[1]) * (r[2] - p[2]) - (q[2] - p[2]) * (r[1] - p[1]);
}

static enum lod_status reserve(struct embedder *e, uint32_t count) {
  if (count > e->capacity) {
    e->capacity = 2 * count + 64;
    OVERLAY_TRY_NEW(e->nodes, e->w->arena, e->capacity);
    OVERLAY_TRY_NEW(e->at, e->w->arena, e->capacity);
    OVERLAY_TRY_NEW(e->places, e->w->arena, e->capacity);
    OVERLAY_TRY_NEW(e->link_begin, e->w->arena, (size_t)e->capacity + 2);
  }
  if (6 * (e->end - e->begin) > e->link_capacity) {
    e->link_capacity = 12 * (e->end - e->begin) + 64;
    OVERLAY_TRY_NEW(e->links, e->w->arena, e->link_capacity);
    OVERLAY_TRY_NEW(e->link_weights, e->w->arena, e->link_capacity);
  }
  return LOD_OK;
}

static bool known(const struct embedder *e, uint32_t node) {
  return e->local[node] < e->node_count && e->nodes[e->local[node]] == node;
}

/* Numbers the disk's nodes, free ones first; places the others. */
static bool number_nodes(struct embedder *e) {
  const struct lod_overlay *o = e->overlay;
  e->node_count = 0;
  for (int fixed = 0; fixed < 2; fixed++) {
    for (uint32_t i = e->begin; i < e->end; i++)
      for (int k = 0; k < 3; k++) {
        uint32_t node = o->triangles[i][k];
        if ((overlay_sides_of(e->w, e->cells, node, e->face) != 0) != (fixed == 1) || known(e, node))
          continue;
        /* A vertex of the surface that lies on another path, or is another coarse vertex, has no business inside. */
        if (fixed == 0 && (e->cells->node_path[node] != LOD_NONE || (node < o->vertex_count && e->w->match[node] != LOD_NONE)))
          return false;
        e->local[node] = e->node_count;
        e->nodes[e->node_count++] = node;
        if (fixed == 0)
          continue;
        int64_t *place = e->places[e->node_count - 1];
        if (!lod_overlay_on_face(e->w->coarse, &o->coarse[node], e->face, place))
          return false;
        for (int c = 0; c < 2; c++)
          e->at[e->node_count - 1][c] = (double)place[c] / LOD_OVERLAY_ONE;
      }
    if (fixed == 0)
      e->free_count = e->node_count;
  }
  return true;
}

/* Half the tangent of an angle's half, bounded: u, v: sides of it. */
static double half_tangent(struct lod_vec3 u, struct lod_vec3 v) {
  double sine = lod_vec3_length(lod_vec3_cross(u, v)), cosine = lod_vec3_dot(u, v);
  double product = sqrt(lod_vec3_length_squared(u) * lod_vec3_length_squared(v));
  double tangent = product + cosine > 0 ? sine / (product + cosine) : 100;
  return tangent < 0.01 ? 0.01 : tangent > 100 ? 100 : tangent;
}

static void add_link(struct embedder *e, uint32_t from, uint32_t to, double weight) {
  uint32_t i = e->link_begin[from];
  while (e->links[i] != LOD_NONE && e->links[i] != to)
    i++;
  if (e->links[i] == LOD_NONE)
    e->link_weights[i] = 0;
  e->links[i] = to;
  e->link_weights[i] += weight;
}

/* Mean value weights (Floater. Mean Value Coordinates. 2003) of the disk as it lies in space, or all alike. */
static void make_links(struct embedder *e, bool uniform) {
  const struct lod_overlay *o = e->overlay;
  memset(e->link_begin, 0, (e->free_count + 2) * sizeof *e->link_begin);
  for (uint32_t i = e->begin; i < e->end; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t n = e->local[o->triangles[i][k]];
      if (n < e->free_count)
        e->link_begin[n + 1] += 2;
    }
  for (uint32_t n = 0; n < e->free_count; n++)
    e->link_begin[n + 1] += e->link_begin[n];
  memset(e->links, 0xff, e->link_begin[e->free_count] * sizeof *e->links);
  for (uint32_t i = e->begin; i < e->end; i++) {
    struct lod_vec3 p[3];
    if (!uniform)
      for (int k = 0; k < 3; k++)
        p[k] = lod_overlay_position(e->w->fine, &o->fine[o->triangles[i][k]]);
    for (int k = 0; k < 3; k++) {
      uint32_t n = e->local[o->triangles[i][k]], a = e->local[o->triangles[i][(k + 1) % 3]], b = e->local[o->triangles[i][(k + 2) % 3]];
      if (n >= e->free_count)
        continue;
      if (uniform) {
        add_link(e, n, a, 1);
        add_link(e, n, b, 1);
        continue;
      }
      struct lod_vec3 u = lod_vec3_subtract(p[(k + 1) % 3], p[k]), v = lod_vec3_subtract(p[(k + 2) % 3], p[k]);
      double tangent = half_tangent(u, v), lu = lod_vec3_length(u), lv = lod_vec3_length(v);
      double shortest = 1e-3 * (lu + lv);
      add_link(e, n, a, tangent / (lu > shortest ? lu : shortest > 0 ? shortest : 1));
      add_link(e, n, b, tangent / (lv > shortest ? lv : shortest > 0 ? shortest : 1));
    }
  }
}

static void solve_dense(struct embedder *e) {
  uint32_t n = e->free_count, width = n + 2;
  double *m = e->dense;
  memset(m, 0, (size_t)n * width * sizeof *m);
  for (uint32_t i = 0; i < n; i++) {
    double *row = m + (size_t)i * width;
    for (uint32_t l = e->link_begin[i]; l < e->link_begin[i + 1] && e->links[l] != LOD_NONE; l++) {
      row[i] += e->link_weights[l];
      if (e->links[l] < n) {
        row[e->links[l]] -= e->link_weights[l];
      } else {
        row[n] += e->link_weights[l] * e->at[e->links[l]][0];
        row[n + 1] += e->link_weights[l] * e->at[e->links[l]][1];
      }
    }
  }
  /* Diagonally dominant: no pivots to look for. A disk without a rim (none is) would divide by zero; its places fail the check. */
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = i + 1; j < n; j++) {
      double factor = m[(size_t)j * width + i];
      if (factor == 0)
        continue;
      factor /= m[(size_t)i * width + i];
      for (uint32_t k = i; k < width; k++)
        m[(size_t)j * width + k] -= factor * m[(size_t)i * width + k];
    }
  for (uint32_t i = n; i-- > 0;)
    for (uint32_t c = 0; c < 2; c++) {
      double sum = m[(size_t)i * width + n + c];
      for (uint32_t k = i + 1; k < n; k++)
        sum -= m[(size_t)i * width + k] * e->at[k][c];
      e->at[i][c] = sum / m[(size_t)i * width + i];
    }
}

/* Gauss and Seidel, over-relaxed, until nothing moves by what an integer would show. */
static void solve_sweeping(struct embedder *e) {
  for (uint32_t i = 0; i < e->free_count; i++)
    e->at[i][0] = e->at[i][1] = 1.0 / 3;
  for (uint32_t sweep = 0; sweep < MAX_SWEEPS; sweep++) {
    double moved = 0;
    for (uint32_t i = 0; i < e->free_count; i++) {
      double sum[3] = {0};
      for (uint32_t l = e->link_begin[i]; l < e->link_begin[i + 1] && e->links[l] != LOD_NONE; l++) {
        sum[0] += e->link_weights[l] * e->at[e->links[l]][0];
        sum[1] += e->link_weights[l] * e->at[e->links[l]][1];
        sum[2] += e->link_weights[l];
      }
      for (int c = 0; c < 2; c++) {
        double step = sum[c] / sum[2] - e->at[i][c];
        e->at[i][c] += 1.4 * step;
        moved = fabs(step) > moved ? fabs(step) : moved;
      }
    }
    if (moved < 1e-9)
      return;
  }
}

static void round_places(struct embedder *e) {
  for (uint32_t i = 0; i < e->free_count; i++) {
    for (int c = 0; c < 2; c++) {
      double x = e->at[i][c];
      e->places[i][c] = x > 0 && x < 1 ? (int64_t)(x * LOD_OVERLAY_ONE + 0.5) : 0;
    }
    e->places[i][2] = LOD_OVERLAY_ONE - e->places[i][0] - e->places[i][1];
  }
}

/* Fragments without positive area; *sum: twice the area of all. */
static uint32_t count_folded(const struct embedder *e, int64_t *sum) {
  const struct lod_overlay *o = e->overlay;
  uint32_t folded = 0;
  *sum = 0;
  for (uint32_t i = e->begin; i < e->end; i++) {
    int64_t area = twice_area(e->places, e->local[o->triangles[i][0]], e->local[o->triangles[i][1]], e->local[o->triangles[i][2]]);
    folded += area <= 0;
    *sum += area;
  }
  return folded;
}

/* The least area around a free node. */
static int64_t least_around(const struct embedder *e, uint32_t n) {
  const struct lod_overlay *o = e->overlay;
  int64_t least = INT64_MAX;
  for (uint32_t i = e->begin; i < e->end; i++) {
    uint32_t a = e->local[o->triangles[i][0]], b = e->local[o->triangles[i][1]], c = e->local[o->triangles[i][2]];
    if (a != n && b != n && c != n)
      continue;
    int64_t area = twice_area(e->places, a, b, c);
    least = area < least ? area : least;
  }
  return least;
}

/* Moves corners of fragments without area to where the least area around them is larger, in ever smaller steps. */
static void mend(struct embedder *e) {
  static const int kWays[6][2] = {{1, 0}, {0, 1}, {-1, 1}, {-1, 0}, {0, -1}, {1, -1}};
  const struct lod_overlay *o = e->overlay;
  for (int round = 0; round < MEND_ROUNDS; round++) {
    bool any = false;
    for (uint32_t i = e->begin; i < e->end; i++) {
      uint32_t corners[3];
      for (int k = 0; k < 3; k++)
        corners[k] = e->local[o->triangles[i][k]];
      if (twice_area(e->places, corners[0], corners[1], corners[2]) > 0)
        continue;
      any = true;
      for (int k = 0; k < 3; k++) {
        if (corners[k] >= e->free_count)
          continue;
        int64_t *place = e->places[corners[k]], best = least_around(e, corners[k]);
        for (int64_t step = LOD_OVERLAY_ONE / 64; step > 0; step /= 2)
          for (int way = 0; way < 6; way++) {
            const int64_t old[3] = {place[0], place[1], place[2]};
            place[0] += step * kWays[way][0];
            place[1] += step * kWays[way][1];
            place[2] = LOD_OVERLAY_ONE - place[0] - place[1];
            int64_t least = place[0] > 0 && place[1] > 0 && place[2] > 0 ? least_around(e, corners[k]) : INT64_MIN;
            if (least > best)
              best = least;
            else
              memcpy(place, old, sizeof old);
          }
      }
    }
    if (!any)
      return;
  }
}

/* Lays the disk out; true when the map is a bijection: all areas are positive, and together they are the triangle's. */
static bool lay_out(struct embedder *e) {
  int64_t sum, whole = (int64_t)LOD_OVERLAY_ONE * LOD_OVERLAY_ONE;
  for (int attempt = 0; attempt < 3; attempt++) {
    if (attempt < 2 && e->free_count > 0) {
      make_links(e, attempt == 1);
      if (e->free_count <= DENSE)
        solve_dense(e);
      else
        solve_sweeping(e);
      round_places(e);
    } else {
      mend(e);
    }
    if (count_folded(e, &sum) == 0)
      return sum == whole;
  }
  return false;
}

static enum lod_status embed_face(struct embedder *e, uint32_t face) {
  struct lod_overlay *o = e->overlay;
  uint8_t *state = &o->states[face];
  e->face = face;
  if (*state != LOD_OVERLAY_MAPPED)
    return LOD_OK;
  LOD_TRY(reserve(e, 3 * (e->end - e->begin)));
  if (e->begin == e->end || !number_nodes(e)) {
    *state = LOD_OVERLAY_TORN;
    return LOD_OK;
  }
  if (!lay_out(e)) {
    /* Edges without their two triangles or a rim that is not one loop show in Euler's number. */
    *state = LOD_OVERLAY_FOLDED;
    uint64_t rim = e->node_count - e->free_count;
    if (e->end - e->begin != 2 * (uint64_t)e->free_count + rim - 2)
      *state = LOD_OVERLAY_TORN;
    return LOD_OK;
  }
  for (uint32_t i = 0; i < e->free_count; i++) {
    struct lod_overlay_place *place = &o->coarse[e->nodes[i]];
    place->face = face;
    for (int k = 0; k < 3; k++)
      place->weights[k] = (uint32_t)e->places[i][k];
  }
  return LOD_OK;
}

/* Coarse vertices and what lies on paths. */
static void place_fixed(struct embedder *e) {
  struct overlay_work *w = e->w;
  struct lod_overlay *o = e->overlay;
  for (uint32_t n = 0; n < o->node_count; n++) {
    struct lod_overlay_place place = {.face = LOD_NONE};
    uint32_t p = e->cells->node_path[n], v = n < o->vertex_count ? w->match[n] : LOD_NONE;
    if (v != LOD_NONE && w->c.vertex_begin[v] < w->c.vertex_begin[v + 1]) {
      uint32_t corner = w->c.vertex_corners[w->c.vertex_begin[v]];
      place.face = corner / 3;
      place.weights[corner % 3] = LOD_OVERLAY_ONE;
    } else if (p != LOD_NONE) {
      place.face = p / 3;
      place.weights[p % 3] = LOD_OVERLAY_ONE - e->cells->node_along[n];
      place.weights[(p + 1) % 3] = e->cells->node_along[n];
    }
    o->coarse[n] = place;
  }
}

/* ---- beside what is not mapped ---- */

/* The weights of the point of the triangle nearest to p, roughly: the foot on its plane, drawn into it. Returns the distance squared. */
static double nearest_on(const struct lod_mesh *mesh, uint32_t t, struct lod_vec3 p, uint32_t weights[3]) {
  struct lod_vec3 v[3];
  double w[3], sum = 0;
  for (int k = 0; k < 3; k++)
    v[k] = overlay_at(mesh, mesh->triangles[t][k]);
  struct lod_vec3 normal = lod_vec3_cross(lod_vec3_subtract(v[1], v[0]), lod_vec3_subtract(v[2], v[0]));
  for (int k = 0; k < 3; k++) {
    struct lod_vec3 a = v[(k + 1) % 3], b = v[(k + 2) % 3];
    w[k] = lod_vec3_dot(normal, lod_vec3_cross(lod_vec3_subtract(a, p), lod_vec3_subtract(b, p)));
    w[k] = w[k] > 0 ? w[k] : 0;
    sum += w[k];
  }
  for (int k = 0; k < 2; k++)
    weights[k] = sum > 0 ? (uint32_t)(w[k] / sum * LOD_OVERLAY_ONE) : LOD_OVERLAY_ONE / 3;
  weights[2] = LOD_OVERLAY_ONE - weights[0] - weights[1];
  struct lod_overlay_place place = {.face = t, .weights = {weights[0], weights[1], weights[2]}};
  return lod_vec3_distance_squared(lod_overlay_position(mesh, &place), p);
}

/* Nodes that no mapped triangle holds: on the nearest of the triangles at a coarse vertex that the finer surface leads to from here. */
static enum lod_status place_strays(struct embedder *e) {
  struct overlay_work *w = e->w;
  struct lod_overlay *o = e->overlay;
  uint32_t *owner, *queue, head = 0, tail = 0;
  OVERLAY_TRY_NEW(owner, w->arena, o->vertex_count);
  OVERLAY_TRY_NEW(queue, w->arena, o->vertex_count);
  for (uint32_t v = 0; v < o->vertex_count; v++) {
    owner[v] = w->match[v] != LOD_NONE && o->coarse[v].face != LOD_NONE ? w->match[v] : LOD_NONE;
    if (owner[v] != LOD_NONE)
      queue[tail++] = v;
  }
  while (head < tail) {
    uint32_t v = queue[head++];
    for (uint32_t i = w->f.vertex_begin[v]; i < w->f.vertex_begin[v + 1]; i++)
      for (int k = 1; k < 3; k++) {
        uint32_t c = w->f.vertex_corners[i], u = w->fine->triangles[c / 3][(c + (uint32_t)k) % 3];
        if (owner[u] == LOD_NONE) {
          owner[u] = owner[v];
          queue[tail++] = u;
        }
      }
  }
  for (uint32_t n = 0; n < o->node_count; n++) {
    if (o->coarse[n].face != LOD_NONE || o->fine[n].face == LOD_NONE)
      continue;
    uint32_t v = n;
    for (int k = 0; n >= o->vertex_count && k < 3; k++)
      if (o->fine[n].weights[k] != 0)
        v = w->fine->triangles[o->fine[n].face][k];
    struct lod_vec3 p = lod_overlay_position(w->fine, &o->fine[n]);
    double best = INFINITY;
    for (uint32_t i = owner[v] == LOD_NONE ? 0 : w->c.vertex_begin[owner[v]]; owner[v] != LOD_NONE && i < w->c.vertex_begin[owner[v] + 1];
         i++) {
      struct lod_overlay_place place = {.face = w->c.vertex_corners[i] / 3};
      double distance = nearest_on(w->coarse, place.face, p, place.weights);
      if (distance < best) {
        best = distance;
        o->coarse[n] = place;
      }
    }
  }
  return LOD_OK;
}

enum lod_status overlay_count_up(struct overlay_work *w, struct lod_overlay *o) {
  bool *lost;
  OVERLAY_TRY_ZERO(lost, w->arena, w->fine->triangle_count);
  o->mapped = o->failed = o->lost = 0;
  for (uint32_t t = 0; t < w->coarse->triangle_count; t++) {
    o->mapped += o->states[t] == LOD_OVERLAY_MAPPED;
    o->failed += o->states[t] != LOD_OVERLAY_MAPPED && o->states[t] != LOD_OVERLAY_EMPTY;
  }
  for (uint32_t i = 0; i < o->triangle_count; i++)
    if (o->coarse_faces[i] == LOD_NONE || o->states[o->coarse_faces[i]] != LOD_OVERLAY_MAPPED)
      lost[o->fine_faces[i]] = true;
  for (uint32_t t = 0; t < w->fine->triangle_count; t++)
    o->lost += lost[t];
  return LOD_OK;
}

enum lod_status overlay_embed(struct overlay_work *w, const struct overlay_cells *cells, struct lod_overlay *overlay) {
  struct embedder e = {.w = w, .cells = cells, .overlay = overlay};
  OVERLAY_TRY_ZERO(e.local, w->arena, overlay->node_count);
  OVERLAY_TRY_NEW(e.dense, w->arena, (size_t)DENSE * (DENSE + 2));
  place_fixed(&e);
  uint32_t at = 0;
  for (uint32_t face = 0; face < w->coarse->triangle_count; face++) {
    e.begin = at;
    while (at < overlay->triangle_count && overlay->coarse_faces[at] == face)
      at++;
    e.end = at;
    LOD_TRY(embed_face(&e, face));
  }
  return place_strays(&e);
}
