#include "core/mesh/overlay.h"

#include <string.h>

#include "core/mesh/overlay_private.h"

struct lod_overlay_settings lod_overlay_defaults(void) {
  return (struct lod_overlay_settings){.crease_cosine = 0.766044443118978}; /* of 40 degrees */
}

bool lod_overlay_on_face(const struct lod_mesh *mesh, const struct lod_overlay_place *place, uint32_t face, int64_t weights[3]) {
  uint32_t found = 0;
  for (int k = 0; k < 3; k++) {
    weights[k] = 0;
    for (int j = 0; j < 3 && place->face != LOD_NONE; j++)
      if (place->weights[j] != 0 && mesh->triangles[place->face][j] == mesh->triangles[face][k]) {
        weights[k] = place->weights[j];
        found += place->weights[j];
      }
  }
  return found == LOD_OVERLAY_ONE;
}

struct lod_vec3 lod_overlay_position(const struct lod_mesh *mesh, const struct lod_overlay_place *place) {
  struct lod_vec3 p = {0};
  for (int k = 0; k < 3; k++)
    if (place->weights[k] == LOD_OVERLAY_ONE)
      return lod_vec3_from_float(mesh->positions[mesh->triangles[place->face][k]]);
  for (int k = 0; k < 3; k++)
    p = lod_vec3_add_scaled(p, lod_vec3_from_float(mesh->positions[mesh->triangles[place->face][k]]),
                            (double)place->weights[k] * (1.0 / LOD_OVERLAY_ONE));
  return p;
}

static enum lod_status match_vertices(struct overlay_work *w, struct lod_problem *problem) {
  OVERLAY_TRY_NEW(w->match, w->arena, w->fine->vertex_count);
  memset(w->match, 0xff, w->fine->vertex_count * sizeof *w->match);
  for (uint32_t v = 0; v < w->coarse->vertex_count; v++) {
    uint32_t to = w->parents[v];
    if (to == LOD_NONE)
      continue;
    if (to >= w->fine->vertex_count || w->match[to] != LOD_NONE)
      return lod_fail(
          problem, LOD_BAD_INPUT, "bad-parents",
          "Coarse vertex %u is said to be vertex %u of the finer level, which %s; levels that contain one another name each once.", v, to,
          to >= w->fine->vertex_count ? "is not there" : "another one is too");
    w->match[to] = v;
  }
  return LOD_OK;
}

static enum lod_status create(struct overlay_work *w, struct lod_arena *arena, struct lod_overlay *overlay, struct lod_problem *problem) {
  struct overlay_cells cells;
  struct lod_overlay_place *fine;
  struct lod_mesh shown[2];
  uint32_t *fronts[2], back_count[2];
  LOD_TRY(match_vertices(w, problem));
  LOD_TRY(overlay_find_backs(w->coarse, w->arena, &fronts[0], &back_count[0]));
  LOD_TRY(overlay_find_backs(w->fine, w->arena, &fronts[1], &back_count[1]));
  if (back_count[0] + back_count[1] > 0) {
    LOD_TRY(overlay_hide_backs(w->coarse, fronts[0], w->arena, &shown[0]));
    LOD_TRY(overlay_hide_backs(w->fine, fronts[1], w->arena, &shown[1]));
    w->coarse = &shown[0];
    w->fine = &shown[1];
  }
  LOD_TRY(lod_adjacency_create(w->coarse, w->arena, &w->c));
  LOD_TRY(lod_adjacency_create(w->fine, w->arena, &w->f));
  LOD_TRY(overlay_arrange(w));
  LOD_TRY(overlay_follow_lines(w));
  LOD_TRY(overlay_trace(w));
  LOD_TRY(overlay_cut(w, arena, overlay, &cells));
  OVERLAY_TRY_NEW(overlay->coarse, arena, overlay->node_count);
  OVERLAY_TRY_NEW(fine, arena, overlay->node_count);
  if (overlay->node_count != 0)
    memcpy(fine, overlay->fine, overlay->node_count * sizeof *fine);
  overlay->fine = fine;
  LOD_TRY(overlay_embed(w, &cells, overlay));
  if (back_count[0] + back_count[1] > 0)
    LOD_TRY(overlay_mirror_backs(w, fronts[0], fronts[1], arena, overlay));
  overlay->tries = w->tries;
  return overlay_count_up(w, overlay);
}

enum lod_status lod_overlay_create(const struct lod_mesh *coarse, const struct lod_mesh *fine, const uint32_t *parents,
                                   const struct lod_overlay_settings *settings, struct lod_arena *arena, struct lod_overlay *overlay,
                                   struct lod_problem *problem) {
  const struct lod_overlay_settings defaults = lod_overlay_defaults();
  struct overlay_work w = {.coarse = coarse, .fine = fine, .parents = parents, .settings = settings != NULL ? settings : &defaults};
  *overlay = (struct lod_overlay){0};
  if (coarse->triangle_count > 1u << 29 || fine->triangle_count > 1u << 29)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "Levels of %u and %u triangles are too large to lay one over the other.",
                    coarse->triangle_count, fine->triangle_count);
  w.arena = lod_arena_create_child(arena);
  enum lod_status status = w.arena == NULL ? LOD_MEMORY : create(&w, arena, overlay, problem);
  lod_arena_destroy(w.arena);
  if (status == LOD_MEMORY)
    lod_fail_memory(problem);
  else if (status == LOD_LIMIT)
    lod_fail(problem, status, "limit-fragments", "The levels cut one another into more than 2^32 pieces.");
  return status;
}

uint64_t lod_overlay_hash(const struct lod_overlay *o) {
  uint64_t hash = 0xcbf29ce484222325u; /* FNV-1a over 32-bit words */
#define MIX(x) (hash = (hash ^ (uint64_t)(x)) * 0x100000001b3u)
  for (uint32_t n = 0; n < o->node_count; n++)
    for (int i = 0; i < 2; i++) {
      const struct lod_overlay_place *place = i == 0 ? &o->coarse[n] : &o->fine[n];
      MIX(place->face);
      for (int k = 0; k < 3; k++)
        MIX(place->weights[k]);
    }
  for (uint32_t t = 0; t < o->triangle_count; t++) {
    MIX(o->coarse_faces[t]);
    MIX(o->fine_faces[t]);
    for (int k = 0; k < 3; k++)
      MIX(o->triangles[t][k]);
  }
#undef MIX
  return hash;
}
