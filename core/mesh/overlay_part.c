/* The border between coarse triangles that are drawn as fragments and others. */
#include <string.h>

#include "core/mesh/overlay_private.h"

/* Marks vertices and edges of triangles whose state is not `mapped`. */
static void mark_bare(const struct lod_mesh *coarse, const struct lod_adjacency *c, const uint8_t *states, uint8_t *vertices,
                      uint8_t *edges) {
  for (uint32_t h = 0; h < 3 * coarse->triangle_count; h++)
    if (states[h / 3] != LOD_OVERLAY_MAPPED && states[h / 3] != LOD_OVERLAY_EMPTY) {
      vertices[coarse->triangles[h / 3][h % 3]] = 1;
      edges[c->edge_of[h]] = 1;
    }
}

/* Whether a place lies on a marked edge or vertex, or on a triangle that is not mapped. */
static bool is_bare(const struct lod_mesh *coarse, const struct lod_adjacency *c, const uint8_t *states, const uint8_t *vertices,
                    const uint8_t *edges, const struct lod_overlay_place *place) {
  const uint32_t *w = place->weights, t = place->face;
  if (t == LOD_NONE)
    return true;
  const uint32_t zeros = (uint32_t)(w[0] == 0) + (w[1] == 0) + (w[2] == 0);
  if (zeros == 0)
    return states[t] != LOD_OVERLAY_MAPPED;
  if (zeros == 1) /* the edge opposite of the corner without weight */
    return edges[c->edge_of[3 * t + (w[0] == 0 ? 1u : w[1] == 0 ? 2u : 0u)]] != 0;
  return vertices[coarse->triangles[t][w[0] != 0 ? 0 : w[1] != 0 ? 1 : 2]] != 0;
}

static enum lod_status find_bare(const struct lod_overlay *o, const struct lod_mesh *coarse, const struct lod_adjacency *c,
                                 const uint8_t *states, struct lod_arena *arena, uint8_t **bare) {
  uint8_t *vertices, *edges;
  OVERLAY_TRY_ZERO(vertices, arena, coarse->vertex_count);
  OVERLAY_TRY_ZERO(edges, arena, c->edge_count);
  OVERLAY_TRY_NEW(*bare, arena, o->node_count);
  mark_bare(coarse, c, states, vertices, edges);
  for (uint32_t n = 0; n < o->node_count; n++)
    (*bare)[n] = is_bare(coarse, c, states, vertices, edges, &o->coarse[n]);
  return LOD_OK;
}

enum lod_status overlay_part_create(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const uint8_t *before,
                                    struct lod_arena *arena, struct overlay_part *part) {
  LOD_TRY(lod_adjacency_create(coarse, arena, &part->c));
  LOD_TRY(find_bare(overlay, coarse, &part->c, overlay->states, arena, &part->held));
  OVERLAY_TRY_ZERO(part->settled, arena, overlay->node_count);
  if (before == NULL)
    return LOD_OK;
  LOD_TRY(find_bare(overlay, coarse, &part->c, before, arena, &part->settled));
  for (uint32_t n = 0; n < overlay->node_count; n++)
    part->settled[n] = !part->settled[n] && !part->held[n];
  return LOD_OK;
}

/* The half-edge under which nodes of h are listed, where a triangle beside h is mapped. */
static uint32_t listed(const struct overlay_part *part, const struct lod_overlay *o, uint32_t h) {
  const uint32_t twin = part->c.twin[h];
  return twin == LOD_NONE || o->states[twin / 3] != LOD_OVERLAY_MAPPED ? LOD_NONE : twin < h ? twin : h;
}

uint32_t overlay_part_count(const struct overlay_part *part, const struct lod_overlay *overlay, uint32_t h) {
  const uint32_t p = listed(part, overlay, h);
  return p == LOD_NONE ? 0 : overlay->crossing_begin[p + 1] - overlay->crossing_begin[p];
}

uint32_t overlay_part_node(const struct overlay_part *part, const struct lod_overlay *overlay, uint32_t h, uint32_t index) {
  const uint32_t p = listed(part, overlay, h);
  return overlay->crossings[p == h ? overlay->crossing_begin[p] + index : overlay->crossing_begin[p + 1] - 1 - index];
}
