/* Coarse edges that are finer edges, or chains of them: creases, seams, borders of materials. */
#include <stdlib.h>
#include <string.h>

#include "core/mesh/overlay_private.h"

static bool differs(const uint32_t *values, uint32_t a, uint32_t b) {
  return values != NULL && values[a] != values[b];
}

/* Is the edge of two triangles a line to follow? */
static bool is_line(const struct lod_mesh *mesh, const uint32_t *twin, const struct overlay_work *w, uint32_t h) {
  uint32_t other = twin[h], a = h / 3, b = other / 3;
  if (differs(mesh->materials, a, b) || differs(mesh->parts, a, b))
    return true;
  if (mesh->corners != NULL &&
      (mesh->corners[a][h % 3] != mesh->corners[b][(other + 1) % 3] || mesh->corners[a][(h + 1) % 3] != mesh->corners[b][other % 3]))
    return true;
  struct lod_vec3 m = overlay_normal(mesh, a), n = overlay_normal(mesh, b);
  double lengths = sqrt(lod_vec3_length_squared(m)) * sqrt(lod_vec3_length_squared(n));
  return lengths > 0 && lod_vec3_dot(m, n) < w->settings->crease_cosine * lengths;
}

enum lod_status overlay_add_step(struct overlay_work *w, uint32_t h) {
  if (w->step_count == w->step_capacity) {
    uint32_t capacity = w->step_capacity < 256 ? 256 : 2 * w->step_capacity, *larger;
    OVERLAY_TRY_NEW(larger, w->arena, capacity);
    if (w->step_count != 0)
      memcpy(larger, w->steps, w->step_count * sizeof *larger);
    w->steps = larger;
    w->step_capacity = capacity;
  }
  w->steps[w->step_count++] = h;
  return LOD_OK;
}

void overlay_place_along(struct overlay_work *w, uint32_t p, uint32_t begin) {
  w->paths[p] = (struct overlay_path){.state = PATH_ALONG, .rips = w->paths[p].rips, .first = begin, .count = w->step_count - begin};
  for (uint32_t i = begin; i < w->step_count; i++) {
    w->along[overlay_canonical(w->f.twin, w->steps[i])] = p;
    if (i > begin)
      w->vertex_path[lod_half_edge_start(w->fine, w->steps[i])] = p;
  }
}

/* ---- edges and creases ---- */

static uint32_t coarse_edge_between(const struct overlay_work *w, uint32_t a, uint32_t b) {
  for (uint32_t i = w->c.vertex_begin[a]; i < w->c.vertex_begin[a + 1]; i++) {
    uint32_t h = w->c.vertex_corners[i];
    if (lod_half_edge_end(w->coarse, h) == b && w->c.twin[h] != LOD_NONE && w->paths[overlay_canonical(w->c.twin, h)].state == PATH_NONE)
      return h;
  }
  return LOD_NONE;
}

/* Places the steps from `begin` on, which lead from coarse half-edge e's start to its end, unless the order of paths forbids it. */
static enum lod_status try_along(struct overlay_work *w, uint32_t e, uint32_t begin, struct overlay_sector *sector, bool *placed) {
  uint32_t p = overlay_canonical(w->c.twin, e), first = w->steps[begin], last = w->f.twin[w->steps[w->step_count - 1]];
  *placed = false;
  LOD_TRY(overlay_find_sector(w, p, e == p ? 0 : 1, OVERLAY_WAYS_ALONG, sector));
  if (!overlay_sector_has_edge(w, sector, first))
    return LOD_OK;
  LOD_TRY(overlay_find_sector(w, p, e == p ? 1 : 0, OVERLAY_WAYS_ALONG, sector));
  if (!overlay_sector_has_edge(w, sector, last))
    return LOD_OK;
  if (e != p) { /* steps run the path's way */
    for (uint32_t i = begin, j = w->step_count - 1; i <= j; i++, j--) {
      uint32_t x = w->f.twin[w->steps[i]];
      w->steps[i] = w->f.twin[w->steps[j]];
      w->steps[j] = x;
      if (j == 0)
        break;
    }
  }
  overlay_place_along(w, p, begin);
  overlay_join_fans(w, e, first);
  overlay_join_fans(w, w->c.twin[e], last);
  *placed = true;
  return LOD_OK;
}

/* Of a vertex with two lines, none of them a boundary: the one that the other goes on in; LOD_NONE for other vertices. */
static uint32_t next_on_line(const struct overlay_work *w, const uint8_t *lines, uint32_t h) {
  uint32_t v = lod_half_edge_end(w->fine, h), found = LOD_NONE;
  if (w->match[v] != LOD_NONE || w->vertex_path[v] != LOD_NONE)
    return LOD_NONE;
  for (uint32_t i = w->f.vertex_begin[v]; i < w->f.vertex_begin[v + 1]; i++) {
    uint32_t out = w->f.vertex_corners[i];
    if (w->f.twin[out] == LOD_NONE)
      return LOD_NONE;
    if (!lines[overlay_canonical(w->f.twin, out)] || out == w->f.twin[h])
      continue;
    if (found != LOD_NONE)
      return LOD_NONE;
    found = out;
  }
  return found;
}

static enum lod_status follow_line(struct overlay_work *w, const uint8_t *lines, uint32_t h, struct overlay_sector *sector) {
  uint32_t begin = w->step_count, start = lod_half_edge_start(w->fine, h), at = h;
  bool placed = false;
  double length = 0;
  for (; at != LOD_NONE && w->step_count - begin < w->fine->vertex_count; at = next_on_line(w, lines, at)) {
    LOD_TRY(overlay_add_step(w, at));
    length += lod_vec3_distance(overlay_at(w->fine, lod_half_edge_start(w->fine, at)), overlay_at(w->fine, lod_half_edge_end(w->fine, at)));
  }
  uint32_t end = lod_half_edge_end(w->fine, w->steps[w->step_count - 1]);
  if (w->match[end] != LOD_NONE && end != start) {
    uint32_t e = coarse_edge_between(w, w->match[start], w->match[end]);
    double straight = lod_vec3_distance(overlay_at(w->fine, start), overlay_at(w->fine, end));
    if (e != LOD_NONE && length <= 1.6 * straight)
      LOD_TRY(try_along(w, e, begin, sector, &placed));
  }
  if (!placed)
    w->step_count = begin;
  return LOD_OK;
}

/* A finer edge between two coarse vertices that a coarse edge joins. */
static enum lod_status take_edge(struct overlay_work *w, uint32_t h, struct overlay_sector *sector) {
  uint32_t begin = w->step_count;
  bool placed = false;
  uint32_t e = coarse_edge_between(w, w->match[lod_half_edge_start(w->fine, h)], w->match[lod_half_edge_end(w->fine, h)]);
  if (e == LOD_NONE)
    return LOD_OK;
  LOD_TRY(overlay_add_step(w, h));
  LOD_TRY(try_along(w, e, begin, sector, &placed));
  if (!placed)
    w->step_count = begin;
  return LOD_OK;
}

enum lod_status overlay_retake_edge(struct overlay_work *w, uint32_t path, struct overlay_sector *sector, bool *placed) {
  uint32_t a = w->parents[overlay_path_start(w, path)], b = w->parents[overlay_path_end(w, path)];
  *placed = false;
  for (uint32_t i = w->f.vertex_begin[a]; i < w->f.vertex_begin[a + 1] && !*placed; i++) {
    uint32_t h = w->f.vertex_corners[i], begin = w->step_count;
    if (w->f.twin[h] == LOD_NONE || lod_half_edge_end(w->fine, h) != b || w->along[overlay_canonical(w->f.twin, h)] != LOD_NONE)
      continue;
    LOD_TRY(overlay_add_step(w, h));
    LOD_TRY(try_along(w, path, begin, sector, placed));
    if (!*placed)
      w->step_count = begin;
  }
  return LOD_OK;
}

enum lod_status overlay_follow_lines(struct overlay_work *w) {
  uint32_t half_edges = 3 * w->fine->triangle_count;
  struct overlay_sector sector = {0};
  uint8_t *lines;
  LOD_TRY(overlay_trace_boundaries(w));
  OVERLAY_TRY_ZERO(lines, w->arena, half_edges);
  for (uint32_t h = 0; h < half_edges; h++)
    if (w->f.twin[h] != LOD_NONE && w->f.twin[h] > h && overlay_takes_part(w->fine, h / 3))
      lines[h] = is_line(w->fine, w->f.twin, w, h);
  for (int pass = 0; pass < 2; pass++)
    for (uint32_t h = 0; h < half_edges; h++) {
      uint32_t edge = overlay_canonical(w->f.twin, h), start = lod_half_edge_start(w->fine, h);
      if (w->f.twin[h] == LOD_NONE || w->along[edge] != LOD_NONE || w->match[start] == LOD_NONE)
        continue;
      if (pass == 1 && w->match[lod_half_edge_end(w->fine, h)] != LOD_NONE)
        LOD_TRY(take_edge(w, h, &sector));
      else if (pass == 0 && lines[edge])
        LOD_TRY(follow_line(w, lines, h, &sector));
    }
  return LOD_OK;
}
