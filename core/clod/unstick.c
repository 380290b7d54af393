/* What the paper does when no pattern is found any more (Gopi & Manocha 1998, 8.2): curves of edges are made planar, so that more pairs of
 * them go on into one another. (Its other two ways, swaps of diagonals around vertices of high degree and larger angles, are search.c's.)
 */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"

struct moves {
  struct lod_clod *clod;
  struct lod_vec3 (*inner)[2]; /* by edge, as they will be */
  bool *moved;                 /* by edge */
  uint32_t *edge;              /* by edge: its successor */
};

/* Inner points where the tangent planes of the ends meet the plane of the chord and the mean normal; false where there is none, or the
 * curve lies in it already. */
static bool flatten(const struct lod_clod *clod, const struct clod_edge *edge, struct lod_vec3 inner[2]) {
  const struct clod_patch *patch = &clod->patches[edge->users[0] / 3];
  uint32_t k = edge->users[0] % 3;
  struct lod_vec3 normal[2] = {clod_sector_normal(clod, patch->sectors[k]), clod_sector_normal(clod, patch->sectors[(k + 1) % 3])};
  struct lod_vec3 chord = lod_vec3_subtract(clod->positions[edge->ends[1]], clod->positions[edge->ends[0]]);
  double length = lod_vec3_length(chord);
  struct lod_vec3 across = lod_vec3_normalize(lod_vec3_cross(chord, lod_vec3_add(normal[0], normal[1])));
  bool bent = false;
  for (int i = 0; i < 2; i++) {
    struct lod_vec3 near = clod->positions[edge->ends[i]], leg = lod_vec3_subtract(edge->inner[i], near);
    struct lod_vec3 along = lod_vec3_normalize(lod_vec3_cross(normal[i], across));
    double run = lod_vec3_dot(leg, along);
    if (!(fabs(run) > 0.1 * length / 3) || lod_vec3_length(leg) > 2 * fabs(run))
      return false; /* the planes say little, or the leg leaves them */
    inner[i] = lod_vec3_add_scaled(near, along, run);
    bent = bent || lod_vec3_distance(inner[i], edge->inner[i]) > 1e-9 * length;
  }
  return bent;
}

static struct lod_bezier net_of(const struct moves *moves, const struct clod_patch *patch) {
  struct lod_bezier net = clod_net(moves->clod, patch);
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = patch->sides[k];
    net.p[3 + 2 * k] = moves->inner[side >> 1][side & 1];
    net.p[4 + 2 * k] = moves->inner[side >> 1][1 - (side & 1)];
  }
  return net;
}

/* The bound of a living patch with its edges as they will be; INFINITY where it folds. */
static double bound_of(const struct moves *moves, uint32_t p, double error) {
  const struct clod_patch *patch = &moves->clod->patches[p];
  struct lod_bezier net = net_of(moves, patch);
  if (!lod_bezier_is_regular(&net))
    return INFINITY;
  return clod_patch_bound(moves->clod, &net, patch->nodes, patch->cells, patch->cell_count, error);
}

static uint32_t choose(struct moves *moves, double error) {
  struct lod_clod *clod = moves->clod;
  uint32_t count = 0;
  for (uint32_t e = 0; e < clod->edge_count; e++)
    memcpy(moves->inner[e], clod->edges[e].inner, sizeof moves->inner[e]);
  for (uint32_t e = 0; e < clod->edge_count; e++) {
    const struct clod_edge *edge = &clod->edges[e];
    struct lod_vec3 inner[2];
    if (edge->users[0] == LOD_NONE || edge->users[1] == LOD_NONE || (edge->flags & (CLOD_SHARP | CLOD_FIXED)) != 0 ||
        !flatten(clod, edge, inner))
      continue;
    memcpy(moves->inner[e], inner, sizeof inner);
    moves->moved[e] = true;
    for (int i = 0; i < 2 && moves->moved[e]; i++)
      moves->moved[e] = isfinite(bound_of(moves, edge->users[i] / 3, error));
    if (!moves->moved[e])
      memcpy(moves->inner[e], edge->inner, sizeof edge->inner);
    count += moves->moved[e];
  }
  return count;
}

/* Edges and patches are never changed, only followed by others. */
static enum lod_status replace_patch(struct moves *moves, uint32_t p) {
  struct lod_clod *clod = moves->clod;
  if (!clod_grow(clod->arena, (void **)&clod->patches, &clod->patch_room, clod->patch_count + 1, sizeof *clod->patches))
    return LOD_MEMORY;
  struct clod_patch *old = &clod->patches[p], *patch = &clod->patches[clod->patch_count];
  struct lod_bezier net = net_of(moves, old);
  *patch = *old;
  patch->born = old->died = clod->number;
  patch->bound = clod_patch_bound(clod, &net, old->nodes, old->cells, old->cell_count, INFINITY);
  old->nodes = NULL;
  old->cells = NULL;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = patch->sides[k], e = side >> 1, half = 3 * clod->patch_count + k;
    if (moves->moved[e]) {
      patch->sides[k] = 2 * moves->edge[e] + (side & 1);
      clod->edges[e].users[side & 1] = LOD_NONE;
    }
    clod->edges[patch->sides[k] >> 1].users[side & 1] = half;
    clod->half[patch->corners[k]] = half;
  }
  clod->patch_count++;
  return LOD_OK;
}

static enum lod_status replace(struct moves *moves) {
  struct lod_clod *clod = moves->clod;
  uint32_t edges = clod->edge_count, patches = clod->patch_count;
  clod->number++;
  for (uint32_t e = 0; e < edges; e++) {
    if (!moves->moved[e])
      continue;
    if (!clod_grow(clod->arena, (void **)&clod->edges, &clod->edge_room, clod->edge_count + 1, sizeof *clod->edges))
      return LOD_MEMORY;
    moves->edge[e] = clod->edge_count;
    clod->edges[clod->edge_count] = clod->edges[e];
    clod->edges[clod->edge_count].users[0] = clod->edges[clod->edge_count].users[1] = LOD_NONE;
    memcpy(clod->edges[clod->edge_count++].inner, moves->inner[e], sizeof moves->inner[e]);
  }
  for (uint32_t p = 0; p < patches; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (patch->died != UINT32_MAX)
      continue;
    bool any = false;
    for (int k = 0; k < 3; k++)
      any = any || moves->moved[patch->sides[k] >> 1];
    if (any)
      LOD_TRY(replace_patch(moves, p));
  }
  return LOD_OK;
}

enum lod_status lod_clod_straighten(struct lod_clod *clod, double error, uint32_t *moved) {
  struct lod_arena *scratch = lod_arena_create_child(clod->arena);
  struct moves moves = {.clod = clod};
  enum lod_status status = LOD_MEMORY;
  *moved = 0;
  if (scratch != NULL) {
    moves.inner = lod_arena_alloc(scratch, clod->edge_count, sizeof *moves.inner);
    moves.moved = LOD_NEW_ZERO(scratch, clod->edge_count, bool);
    moves.edge = LOD_NEW(scratch, clod->edge_count, uint32_t);
    if (moves.inner != NULL && moves.moved != NULL && moves.edge != NULL) {
      *moved = choose(&moves, error);
      status = *moved == 0 ? LOD_OK : replace(&moves);
    }
  }
  lod_arena_destroy(scratch);
  return status;
}
