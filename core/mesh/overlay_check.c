/* What an overlay promises, proved anew from its arrays. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/mesh/overlay_private.h"

struct checker {
  const struct lod_overlay *overlay;
  const struct lod_mesh *coarse, *fine;
  const uint32_t *parents;
  struct lod_arena *scratch;
  struct lod_overlay_facts *facts;
};

__attribute__((format(printf, 2, 3))) static void complain(struct checker *c, const char *format, ...) {
  va_list list;
  if (c->facts->reason[0] != '\0')
    return;
  va_start(list, format);
  vsnprintf(c->facts->reason, sizeof c->facts->reason, format, list);
  va_end(list);
}

static bool place_fits(const struct lod_overlay_place *place, const struct lod_mesh *mesh) {
  return place->face == LOD_NONE ||
         (place->face < mesh->triangle_count && (uint64_t)place->weights[0] + place->weights[1] + place->weights[2] == LOD_OVERLAY_ONE);
}

static void check_nodes(struct checker *c) {
  const struct lod_overlay *o = c->overlay;
  for (uint32_t n = 0; n < o->node_count; n++)
    if (!place_fits(&o->coarse[n], c->coarse) || !place_fits(&o->fine[n], c->fine))
      complain(c, "node %u has weights that do not add up to one", n);
  for (uint32_t t = 0; t < c->coarse->triangle_count; t++)
    for (int k = 0; k < 3 && o->states[t] == LOD_OVERLAY_MAPPED; k++) {
      uint32_t v = c->coarse->triangles[t][k];
      int64_t w[3];
      if (c->parents[v] == LOD_NONE || !lod_overlay_on_face(c->coarse, &o->coarse[c->parents[v]], t, w) || w[k] != LOD_OVERLAY_ONE)
        complain(c, "coarse vertex %u does not lie on itself", v);
    }
}

static int64_t twice_area(int64_t w[3][3]) {
  return (w[1][1] - w[0][1]) * (w[2][2] - w[0][2]) - (w[1][2] - w[0][2]) * (w[2][1] - w[0][1]);
}

/* Areas of fragments on either level, summed by triangle. */
static enum lod_status check_areas(struct checker *c, bool on_coarse) {
  const struct lod_overlay *o = c->overlay;
  const struct lod_mesh *mesh = on_coarse ? c->coarse : c->fine;
  const struct lod_overlay_place *places = on_coarse ? o->coarse : o->fine;
  const int64_t whole = (int64_t)LOD_OVERLAY_ONE * LOD_OVERLAY_ONE;
  uint64_t *sums, total = 0;
  uint32_t *counts;
  OVERLAY_TRY_ZERO(sums, c->scratch, mesh->triangle_count);
  OVERLAY_TRY_ZERO(counts, c->scratch, mesh->triangle_count);
  for (uint32_t i = 0; i < o->triangle_count; i++) {
    uint32_t face = on_coarse ? o->coarse_faces[i] : o->fine_faces[i];
    int64_t w[3][3];
    if (on_coarse && (face == LOD_NONE || o->states[face] != LOD_OVERLAY_MAPPED))
      continue;
    for (int k = 0; k < 3; k++)
      if (!lod_overlay_on_face(mesh, &places[o->triangles[i][k]], face, w[k])) {
        complain(c, "fragment %u has a corner that is not on %s triangle %u", i, on_coarse ? "coarse" : "fine", face);
        return LOD_OK;
      }
    int64_t area = twice_area(w);
    if (area <= 0)
      complain(c, "fragment %u has no area on %s triangle %u", i, on_coarse ? "coarse" : "fine", face);
    if (on_coarse && area < c->facts->smallest_area)
      c->facts->smallest_area = area;
    sums[face] += (uint64_t)area;
    counts[face]++;
    if (on_coarse && counts[face] > c->facts->largest)
      c->facts->largest = counts[face];
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (on_coarse ? o->states[t] != LOD_OVERLAY_MAPPED : !overlay_takes_part(mesh, t))
      continue;
    if (sums[t] != (uint64_t)whole)
      complain(c, "the fragments on %s triangle %u do not tile it", on_coarse ? "coarse" : "fine", t);
    total += sums[t] / (uint64_t)whole;
  }
  *(on_coarse ? &c->facts->coarse_area : &c->facts->fine_area) = total;
  return LOD_OK;
}

/* Fragments meet along whole sides: a side that lies inside a finer triangle, or on an edge of two, has a twin. */
static enum lod_status check_sides(struct checker *c) {
  const struct lod_overlay *o = c->overlay;
  struct lod_mesh mesh = {.vertex_count = o->node_count, .triangle_count = o->triangle_count, .triangles = o->triangles}, fronts, shown;
  struct lod_adjacency sides, fine;
  uint32_t *front, *fragment_front, backs;
  LOD_TRY(overlay_find_backs(c->fine, c->scratch, &front, &backs));
  OVERLAY_TRY_NEW(fragment_front, c->scratch, o->triangle_count);
  for (uint32_t i = 0; i < o->triangle_count; i++) /* each side of a wall by itself; they are mirrored, so the first is enough */
    fragment_front[i] = front[o->fine_faces[i]];
  LOD_TRY(overlay_hide_backs(&mesh, fragment_front, c->scratch, &fronts));
  LOD_TRY(overlay_hide_backs(c->fine, front, c->scratch, &shown));
  LOD_TRY(lod_adjacency_create(&fronts, c->scratch, &sides));
  LOD_TRY(lod_adjacency_create(&shown, c->scratch, &fine));
  for (uint32_t h = 0; h < 3 * o->triangle_count; h++) {
    if (sides.twin[h] != LOD_NONE || fragment_front[h / 3] != LOD_NONE)
      continue;
    uint32_t t = o->fine_faces[h / 3];
    int64_t a[3], b[3];
    bool on_end = false;
    lod_overlay_on_face(c->fine, &o->fine[lod_half_edge_start(&mesh, h)], t, a);
    lod_overlay_on_face(c->fine, &o->fine[lod_half_edge_end(&mesh, h)], t, b);
    for (uint32_t k = 0; k < 3; k++) /* the side opposite corner k is half-edge k + 1 */
      on_end = on_end || (a[k] == 0 && b[k] == 0 && fine.twin[3 * t + (k + 1) % 3] == LOD_NONE);
    if (!on_end)
      complain(c, "fragment %u has a side that no other fragment shares", h / 3);
  }
  return LOD_OK;
}

enum lod_status lod_overlay_check(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                                  const uint32_t *parents, struct lod_arena *arena, struct lod_overlay_facts *facts) {
  struct checker c = {.overlay = overlay, .coarse = coarse, .fine = fine, .parents = parents, .facts = facts};
  *facts = (struct lod_overlay_facts){.smallest_area = INT64_MAX};
  c.scratch = lod_arena_create_child(arena);
  enum lod_status status = c.scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK)
    check_nodes(&c);
  if (status == LOD_OK && facts->reason[0] == '\0')
    status = check_areas(&c, true);
  if (status == LOD_OK && facts->reason[0] == '\0')
    status = check_areas(&c, false);
  if (status == LOD_OK && facts->reason[0] == '\0')
    status = check_sides(&c);
  lod_arena_destroy(c.scratch);
  for (uint32_t n = overlay->vertex_count; n < overlay->node_count; n++)
    facts->bent++;
  facts->bent -= overlay->crossing_begin[3 * coarse->triangle_count];
  for (uint32_t i = 0; i < overlay->crossing_begin[3 * coarse->triangle_count]; i++)
    facts->bent += overlay->crossings[i] < overlay->vertex_count;
  facts->valid = status == LOD_OK && facts->reason[0] == '\0' && facts->coarse_area == overlay->mapped;
  return status;
}
