/* Boundaries, and where the surface is cut: coarse edges there are chains of finer boundary edges.
 *
 * Where the surface is cut several boundaries lead from one vertex to the next. Whole loops go together first: a coarse loop and a finer
 * one that passes its vertices in the same order, of parts of the surface that hold the same vertices, the most alike first. What is left
 * (there is a difference in topology) goes edge by edge. */
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/mesh/overlay_private.h"

static uint32_t next_on_boundary(const struct overlay_work *w, uint32_t h) {
  h = lod_half_edge_next(h);
  while (w->f.twin[h] != LOD_NONE)
    h = lod_half_edge_next(w->f.twin[h]);
  return h;
}

/* The boundary of the finer surface from h on, up to the next coarse vertex: is that where the path ends? */
static enum lod_status walk_boundary(struct overlay_work *w, uint32_t p, uint32_t h, bool *reached) {
  uint32_t goal = w->parents[overlay_path_end(w, p)], begin = w->step_count;
  *reached = false;
  for (uint32_t at = h;; at = next_on_boundary(w, at)) {
    uint32_t v = lod_half_edge_end(w->fine, at);
    LOD_TRY(overlay_add_step(w, at));
    if (w->match[v] != LOD_NONE || w->vertex_path[v] != LOD_NONE) {
      *reached = v == goal;
      break;
    }
    if (w->step_count - begin > w->fine->triangle_count) /* a ring without a coarse vertex */
      break;
  }
  if (!*reached)
    w->step_count = begin;
  return LOD_OK;
}

/* A coarse boundary edge and a finer boundary half-edge that leads where it leads. */
struct candidate {
  double score;
  uint32_t path, half_edge;
};

/* How alike two triangles lie at their boundary edges: the direction into the triangle, and which side is its front. */
static double likeness(const struct overlay_work *w, uint32_t p, uint32_t h) {
  struct lod_vec3 inward[2], normal[2];
  const struct lod_mesh *const meshes[2] = {w->coarse, w->fine};
  const uint32_t half_edges[2] = {p, h};
  for (int i = 0; i < 2; i++) {
    uint32_t e = half_edges[i];
    struct lod_vec3 along =
        lod_vec3_subtract(overlay_at(meshes[i], lod_half_edge_end(meshes[i], e)), overlay_at(meshes[i], lod_half_edge_start(meshes[i], e)));
    normal[i] = lod_vec3_normalize(overlay_normal(meshes[i], e / 3));
    inward[i] = lod_vec3_normalize(lod_vec3_cross(normal[i], along));
  }
  return lod_vec3_dot(inward[0], inward[1]) + 0.5 * lod_vec3_dot(normal[0], normal[1]);
}

static int compare_candidates(const void *left, const void *right) {
  const struct candidate *a = left, *b = right;
  if (a->score != b->score)
    return a->score > b->score ? -1 : 1;
  return a->path != b->path ? (a->path < b->path ? -1 : 1) : (a->half_edge > b->half_edge) - (a->half_edge < b->half_edge);
}

static bool fans_fit(const struct overlay_work *w, uint32_t coarse_corner, uint32_t fine_corner) {
  uint32_t c = w->c.fan_of[coarse_corner], f = w->f.fan_of[fine_corner];
  return w->fan_to[c] == LOD_NONE ? w->fan_from[f] == LOD_NONE : w->fan_to[c] == f;
}

static enum lod_status add_candidate(struct overlay_work *w, struct candidate **list, uint32_t *count, uint32_t *capacity,
                                     const struct candidate *candidate) {
  if (*count == *capacity) {
    struct candidate *larger;
    *capacity = 2 * *capacity + 64;
    OVERLAY_TRY_NEW(larger, w->arena, *capacity);
    if (*count > 0)
      memcpy(larger, *list, *count * sizeof *larger);
    *list = larger;
  }
  (*list)[(*count)++] = *candidate;
  return LOD_OK;
}

static enum lod_status list_candidates(struct overlay_work *w, struct candidate **list, uint32_t *count) {
  uint32_t capacity = 0;
  *count = 0;
  *list = NULL;
  for (uint32_t p = 0; p < 3 * w->coarse->triangle_count; p++) {
    uint32_t vertex = w->parents[overlay_path_start(w, p)];
    if (!overlay_takes_part(w->coarse, p / 3) || w->c.twin[p] != LOD_NONE || vertex == LOD_NONE ||
        w->parents[overlay_path_end(w, p)] == LOD_NONE || w->paths[p].state != PATH_NONE)
      continue;
    for (uint32_t i = w->f.vertex_begin[vertex]; i < w->f.vertex_begin[vertex + 1]; i++) {
      uint32_t h = w->f.vertex_corners[i], begin = w->step_count;
      bool reached;
      if (w->f.twin[h] != LOD_NONE)
        continue;
      LOD_TRY(walk_boundary(w, p, h, &reached));
      w->step_count = begin;
      if (!reached)
        continue;
      LOD_TRY(add_candidate(w, list, count, &capacity, &(struct candidate){likeness(w, p, h), p, h}));
    }
  }
  if (*count > 0)
    qsort(*list, *count, sizeof **list, compare_candidates);
  return LOD_OK;
}

static enum lod_status trace_edges(struct overlay_work *w) {
  struct candidate *list;
  uint32_t count;
  LOD_TRY(list_candidates(w, &list, &count));
  for (uint32_t i = 0; i < count; i++) {
    uint32_t p = list[i].path, h = list[i].half_edge, begin = w->step_count;
    bool reached;
    if (w->paths[p].state != PATH_NONE || w->along[h] != LOD_NONE || !fans_fit(w, p, h))
      continue;
    LOD_TRY(walk_boundary(w, p, h, &reached));
    uint32_t last = reached ? lod_half_edge_next(w->steps[w->step_count - 1]) : LOD_NONE;
    if (!reached || !fans_fit(w, lod_half_edge_next(p), last)) {
      w->step_count = begin;
      continue;
    }
    overlay_place_along(w, p, begin);
    overlay_join_fans(w, p, h);
    overlay_join_fans(w, lod_half_edge_next(p), last);
  }
  return LOD_OK;
}

/* ---- whole loops ---- */

struct loops {
  uint32_t *half_edges; /* coarse, loop by loop */
  uint32_t *begin;      /* count + 1 */
  uint32_t count;
  uint32_t *coarse_part, *fine_part; /* by triangle: the least triangle of its connected part */
};

static enum lod_status find_parts(const struct lod_mesh *mesh, const uint32_t *twin, struct lod_arena *arena, uint32_t **part) {
  if ((*part = lod_sets_create(arena, mesh->triangle_count)) == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
    if (twin[h] != LOD_NONE && twin[h] > h)
      lod_sets_join(*part, h / 3, twin[h] / 3);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    (*part)[t] = lod_sets_find(*part, t);
  return LOD_OK;
}

static uint32_t next_on_border(const uint32_t *twin, uint32_t h) {
  h = lod_half_edge_next(h);
  while (twin[h] != LOD_NONE)
    h = lod_half_edge_next(twin[h]);
  return h;
}

static bool on_border(const struct lod_mesh *mesh, const uint32_t *twin, uint32_t h) {
  return twin[h] == LOD_NONE && overlay_takes_part(mesh, h / 3);
}

static enum lod_status find_loops(struct overlay_work *w, struct loops *l) {
  uint32_t borders = 0, at = 0;
  bool *seen;
  LOD_TRY(find_parts(w->coarse, w->c.twin, w->arena, &l->coarse_part));
  LOD_TRY(find_parts(w->fine, w->f.twin, w->arena, &l->fine_part));
  for (uint32_t h = 0; h < 3 * w->coarse->triangle_count; h++)
    borders += on_border(w->coarse, w->c.twin, h);
  OVERLAY_TRY_NEW(l->half_edges, w->arena, borders);
  OVERLAY_TRY_NEW(l->begin, w->arena, (size_t)borders + 1);
  OVERLAY_TRY_ZERO(seen, w->arena, 3 * (size_t)w->coarse->triangle_count);
  for (uint32_t h = 0; h < 3 * w->coarse->triangle_count; h++) {
    if (seen[h] || !on_border(w->coarse, w->c.twin, h))
      continue;
    l->begin[l->count++] = at;
    for (uint32_t p = h; !seen[p]; p = next_on_border(w->c.twin, p)) {
      seen[p] = true;
      l->half_edges[at++] = p;
    }
  }
  l->begin[l->count] = at;
  return LOD_OK;
}

/* Do all vertices of the loop's part belong to the finer part too? Of large parts a share is looked at. */
static bool parts_fit(const struct overlay_work *w, const struct loops *l, const uint32_t *members, uint32_t member_count, uint32_t fine) {
  enum { LOOKED_AT = 512 };
  uint32_t step = member_count / LOOKED_AT + 1;
  for (uint32_t i = 0; i < member_count; i += step)
    for (int k = 0; k < 3; k++) {
      uint32_t v = w->parents[w->coarse->triangles[members[i]][k]];
      bool found = v == LOD_NONE;
      for (uint32_t c = found ? 0 : w->f.vertex_begin[v]; !found && c < w->f.vertex_begin[v + 1]; c++)
        found = l->fine_part[w->f.vertex_corners[c] / 3] == fine;
      if (!found)
        return false;
    }
  return true;
}

/* Does the finer border from h on pass the loop's vertices, and come back to h? *score: how alike, on average. */
static enum lod_status walk_loop(struct overlay_work *w, const struct loops *l, uint32_t loop, uint32_t h, bool *fits, double *score) {
  uint32_t begin = w->step_count, at = h;
  double sum = 0;
  *fits = true;
  for (uint32_t i = l->begin[loop]; i < l->begin[loop + 1] && *fits; i++) {
    uint32_t p = l->half_edges[i];
    LOD_TRY(walk_boundary(w, p, at, fits));
    *fits = *fits && fans_fit(w, p, at) && w->along[at] == LOD_NONE;
    if (!*fits)
      break;
    sum += likeness(w, p, at);
    at = next_on_boundary(w, w->steps[w->step_count - 1]);
    w->step_count = begin;
  }
  w->step_count = begin;
  *fits = *fits && at == h;
  *score = sum / (l->begin[loop + 1] - l->begin[loop]);
  return LOD_OK;
}

/* Members of each part, part by part: triangles in `order`, from begin[part] on. */
static enum lod_status list_members(const uint32_t *part, uint32_t count, struct lod_arena *arena, uint32_t **begin, uint32_t **order) {
  OVERLAY_TRY_ZERO(*begin, arena, (size_t)count + 1);
  OVERLAY_TRY_NEW(*order, arena, count);
  for (uint32_t t = 0; t < count; t++)
    (*begin)[part[t]]++;
  for (uint32_t t = 0, sum = 0; t <= count; t++)
    (*begin)[t] = sum += t < count ? (*begin)[t] : 0;
  for (uint32_t t = count; t-- > 0;)
    (*order)[--(*begin)[part[t]]] = t;
  return LOD_OK;
}

static enum lod_status list_loop_candidates(struct overlay_work *w, const struct loops *l, struct candidate **list, uint32_t *count) {
  static const double kSamePart = 8; /* outweighs any likeness, which is at most 1.5 */
  uint32_t capacity = 0, *begin, *members;
  *count = 0;
  *list = NULL;
  LOD_TRY(list_members(l->coarse_part, w->coarse->triangle_count, w->arena, &begin, &members));
  for (uint32_t loop = 0; loop < l->count; loop++) {
    uint32_t p = l->half_edges[l->begin[loop]], vertex = w->parents[overlay_path_start(w, p)], first = *count;
    for (uint32_t i = vertex == LOD_NONE ? 0 : w->f.vertex_begin[vertex]; vertex != LOD_NONE && i < w->f.vertex_begin[vertex + 1]; i++) {
      uint32_t h = w->f.vertex_corners[i];
      struct candidate found = {.path = loop, .half_edge = h};
      bool fits;
      if (w->f.twin[h] != LOD_NONE)
        continue;
      LOD_TRY(walk_loop(w, l, loop, h, &fits, &found.score));
      if (fits)
        LOD_TRY(add_candidate(w, list, count, &capacity, &found));
    }
    uint32_t part = l->coarse_part[p / 3];
    for (uint32_t i = first; i<*count && * count - first> 1; i++)
      if (parts_fit(w, l, members + begin[part], begin[part + 1] - begin[part], l->fine_part[(*list)[i].half_edge / 3]))
        (*list)[i].score += kSamePart;
  }
  if (*count > 0)
    qsort(*list, *count, sizeof **list, compare_candidates);
  return LOD_OK;
}

static enum lod_status trace_loops(struct overlay_work *w) {
  struct loops l = {0};
  struct candidate *list;
  uint32_t count;
  LOD_TRY(find_loops(w, &l));
  LOD_TRY(list_loop_candidates(w, &l, &list, &count));
  for (uint32_t i = 0; i < count; i++) {
    uint32_t loop = list[i].path, at = list[i].half_edge;
    double score;
    bool fits = w->paths[l.half_edges[l.begin[loop]]].state == PATH_NONE;
    if (fits)
      LOD_TRY(walk_loop(w, &l, loop, at, &fits, &score));
    for (uint32_t k = l.begin[loop]; fits && k < l.begin[loop + 1]; k++) {
      uint32_t p = l.half_edges[k], begin = w->step_count;
      bool reached;
      LOD_TRY(walk_boundary(w, p, at, &reached));
      if (!reached)
        break; /* the finer loop passes a vertex twice, where one of the paths just placed runs: the rest goes edge by edge */
      uint32_t last = w->steps[w->step_count - 1];
      overlay_place_along(w, p, begin);
      overlay_join_fans(w, p, at);
      overlay_join_fans(w, lod_half_edge_next(p), lod_half_edge_next(last));
      at = next_on_boundary(w, last);
    }
  }
  return LOD_OK;
}

enum lod_status overlay_trace_boundaries(struct overlay_work *w) {
  LOD_TRY(trace_loops(w));
  return trace_edges(w);
}
