/* The source made as much of a surface as it can be before it is cut: of triangles with the same three corners one is kept, and triangles
 * are turned so that neighbours run along their edge against each other. What was a wall with two sides is remembered, and gets its other
 * side back in every level (extract.c). */
#include <string.h>

#include "core/retile/internal.h"

/* Have the two triangles the same corners? They have two in common. */
static bool same_corners(const uint32_t *a, const uint32_t *b) {
  for (int k = 0; k < 3; k++)
    if (a[k] != b[0] && a[k] != b[1] && a[k] != b[2])
      return false;
  return true;
}

static bool same_turn(const uint32_t *a, const uint32_t *b) {
  int k = b[0] == a[0] ? 0 : b[1] == a[0] ? 1 : 2;
  return b[(k + 1) % 3] == a[1];
}

/* back: for each triangle its other side, or LOD_NONE; dropped: it is one of several. */
static void find_doubles(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, uint32_t *back, bool *dropped,
                         uint32_t *dropped_count) {
  *dropped_count = 0;
  memset(back, 0xff, mesh->triangle_count * sizeof *back);
  memset(dropped, 0, mesh->triangle_count * sizeof *dropped);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint32_t e = adjacency->edge_of[3 * (size_t)t];
    for (uint32_t i = e == LOD_NONE || dropped[t] ? 0 : adjacency->edge_begin[e];
         e != LOD_NONE && !dropped[t] && i < adjacency->edge_begin[e + 1]; i++) {
      uint32_t other = adjacency->edge_half_edges[i] / 3;
      if (other <= t || !same_corners(mesh->triangles[t], mesh->triangles[other]))
        continue;
      dropped[other] = true;
      ++*dropped_count;
      if (back[t] == LOD_NONE && !same_turn(mesh->triangles[t], mesh->triangles[other]))
        back[t] = other;
    }
  }
}

static double twice_area(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
  return lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]), p),
                                        lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]), p)));
}

/* Which triangles to turn over, over edges of two; where a surface cannot be oriented the cut stays. Of each piece the larger part, by
 * area, stays as it is. */
static enum lod_status find_turns(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, struct lod_arena *scratch,
                                  bool *turned) {
  uint32_t *queue, count = mesh->triangle_count;
  bool *seen;
  RETILE_TRY_NEW(queue, scratch, count);
  RETILE_TRY_NEW_ZERO(seen, scratch, count);
  memset(turned, 0, count * sizeof *turned);
  for (uint32_t seed = 0; seed < count; seed++) {
    uint32_t begin = 0, end = 0;
    double kept = 0, changed = 0;
    if (seen[seed] || adjacency->edge_of[3 * (size_t)seed] == LOD_NONE)
      continue;
    queue[end++] = seed;
    seen[seed] = true;
    while (begin < end) {
      uint32_t t = queue[begin++];
      *(turned[t] ? &changed : &kept) += twice_area(mesh, t);
      for (uint32_t k = 0; k < 3; k++) {
        uint32_t h = 3 * t + k, e = adjacency->edge_of[h], first = adjacency->edge_begin[e];
        if (adjacency->edge_begin[e + 1] - first != 2)
          continue;
        uint32_t other = adjacency->edge_half_edges[first] == h ? adjacency->edge_half_edges[first + 1] : adjacency->edge_half_edges[first];
        if (seen[other / 3])
          continue;
        seen[other / 3] = true;
        turned[other / 3] = turned[t] != (lod_half_edge_start(mesh, h) == lod_half_edge_start(mesh, other));
        queue[end++] = other / 3;
      }
    }
    for (uint32_t i = 0; i < end && changed > kept; i++)
      turned[queue[i]] = !turned[queue[i]];
  }
  return LOD_OK;
}

/* The triangles of `from` that are not dropped; corners 1 and 2 of turned ones changed. */
static enum lod_status select_triangles(const struct lod_mesh *from, const uint32_t *chosen, uint32_t count, const bool *turned,
                                        struct lod_arena *arena, struct lod_mesh *to) {
  *to = *from;
  to->triangle_count = count;
  RETILE_TRY_NEW(to->triangles, arena, count);
  if (from->corners != NULL)
    RETILE_TRY_NEW(to->corners, arena, count);
  if (from->materials != NULL)
    RETILE_TRY_NEW(to->materials, arena, count);
  if (from->parts != NULL)
    RETILE_TRY_NEW(to->parts, arena, count);
  for (uint32_t i = 0; i < count; i++) {
    uint32_t t = chosen[i];
    for (int k = 0; k < 3; k++) {
      int place = turned != NULL && turned[i] && k != 0 ? 3 - k : k;
      to->triangles[i][k] = from->triangles[t][place];
      if (from->corners != NULL)
        to->corners[i][k] = from->corners[t][place];
    }
    if (from->materials != NULL)
      to->materials[i] = from->materials[t];
    if (from->parts != NULL)
      to->parts[i] = from->parts[t];
  }
  return LOD_OK;
}

static enum lod_status clean(struct cleaned *cleaned, struct lod_adjacency *adjacency, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = cleaned->source;
  uint32_t *back, *chosen, dropped_count, count = 0;
  bool *dropped, *turned = NULL;
  LOD_TRY(lod_adjacency_create(mesh, arena, adjacency));
  RETILE_TRY_NEW(back, scratch, mesh->triangle_count);
  RETILE_TRY_NEW(dropped, scratch, mesh->triangle_count);
  find_doubles(mesh, adjacency, back, dropped, &dropped_count);
  if (dropped_count == 0 && adjacency->misoriented_edges == 0) {
    cleaned->adjacency = adjacency;
    return LOD_OK;
  }
  RETILE_TRY_NEW(chosen, arena, mesh->triangle_count);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    if (!dropped[t])
      chosen[count++] = t;
  struct lod_mesh once = *mesh;
  if (dropped_count != 0) {
    LOD_TRY(select_triangles(mesh, chosen, count, NULL, scratch, &once));
    LOD_TRY(lod_adjacency_create(&once, scratch, adjacency));
  }
  if (adjacency->misoriented_edges != 0) {
    RETILE_TRY_NEW(turned, arena, count);
    LOD_TRY(find_turns(&once, adjacency, scratch, turned));
  }
  LOD_TRY(select_triangles(mesh, chosen, count, turned, arena, &cleaned->mesh));
  RETILE_TRY_NEW(cleaned->back, arena, count);
  for (uint32_t i = 0; i < count; i++)
    cleaned->back[i] = back[chosen[i]];
  cleaned->from = chosen;
  cleaned->turned = turned;
  return LOD_OK;
}

enum lod_status clean_source(const struct lod_mesh *mesh, struct lod_arena *arena, struct cleaned *cleaned) {
  *cleaned = (struct cleaned){.source = mesh, .mesh = *mesh};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency *adjacency = LOD_NEW(arena, 1, struct lod_adjacency);
  enum lod_status status = scratch == NULL || adjacency == NULL ? LOD_MEMORY : clean(cleaned, adjacency, arena, scratch);
  lod_arena_destroy(scratch);
  return status;
}

struct lod_retile_point clean_point(const struct cleaned *cleaned, struct lod_retile_point point) {
  if (cleaned->from == NULL)
    return point;
  struct lod_retile_point own = {cleaned->from[point.face], {point.weights[0], point.weights[1], point.weights[2]}};
  if (cleaned->turned != NULL && cleaned->turned[point.face]) {
    own.weights[1] = point.weights[2];
    own.weights[2] = point.weights[1];
  }
  return own;
}
