/* Facts about a step between levels, counted in integers. */
#include <string.h>

#include "core/retile/internal.h"

/* Weights of the point on another face that holds it too: by the vertices that weigh. */
static bool on_face(const struct lod_mesh *coarse, const struct lod_retile_point *point, uint32_t face, int64_t weights[3]) {
  uint32_t found = 0;
  for (int k = 0; k < 3; k++) {
    weights[k] = 0;
    for (int j = 0; j < 3; j++)
      if (point->weights[j] != 0 && coarse->triangles[point->face][j] == coarse->triangles[face][k]) {
        weights[k] = point->weights[j];
        found += point->weights[j];
      }
  }
  return found == LOD_RETILE_ONE;
}

static int64_t twice_area(int64_t w[3][3]) {
  return (w[1][1] - w[0][1]) * (w[2][2] - w[0][2]) - (w[1][2] - w[0][2]) * (w[2][1] - w[0][1]);
}

static bool check_points(const struct lod_retile_level *level, const struct lod_retile_level *finer) {
  for (uint32_t v = 0; v < finer->mesh.vertex_count; v++) {
    const struct lod_retile_point *at = &level->flat[v];
    if (at->face >= level->mesh.triangle_count || (uint64_t)at->weights[0] + at->weights[1] + at->weights[2] != LOD_RETILE_ONE)
      return false;
  }
  for (uint32_t v = 0; v < level->mesh.vertex_count; v++) {
    if (level->parents[v] >= finer->mesh.vertex_count)
      return false;
    const struct lod_retile_point *at = &level->flat[level->parents[v]];
    bool own = false;
    for (int k = 0; k < 3; k++)
      own = own || (at->weights[k] == LOD_RETILE_ONE && level->mesh.triangles[at->face][k] == v);
    if (!own)
      return false;
  }
  return true;
}

enum lod_status lod_retile_check_map(const struct lod_retile_level *level, const struct lod_retile_level *finer, struct lod_arena *arena,
                                     struct lod_retile_map_facts *facts) {
  *facts = (struct lod_retile_map_facts){.valid = check_points(level, finer)};
  if (!facts->valid)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency adjacency;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : lod_adjacency_create(&level->mesh, scratch, &adjacency);
  for (uint32_t t = 0; status == LOD_OK && t < finer->mesh.triangle_count; t++) {
    const struct lod_retile_point *p[3];
    for (int k = 0; k < 3; k++)
      p[k] = &level->flat[finer->mesh.triangles[t][k]];
    int weighs = p[0]->weights[0] != 0 ? 0 : p[0]->weights[1] != 0 ? 1 : 2;
    uint32_t v = level->mesh.triangles[p[0]->face][weighs];
    bool inside = false, upright = false, flat = false; /* on one of the two triangles of a pillow it is upright, on the other not */
    for (uint32_t i = adjacency.vertex_begin[v]; i < adjacency.vertex_begin[v + 1] && !upright; i++) {
      uint32_t face = adjacency.vertex_corners[i] / 3;
      int64_t w[3][3];
      if (on_face(&level->mesh, p[0], face, w[0]) && on_face(&level->mesh, p[1], face, w[1]) && on_face(&level->mesh, p[2], face, w[2])) {
        inside = true;
        upright = twice_area(w) > 0;
        flat = flat || twice_area(w) == 0;
      }
    }
    facts->inside += inside;
    facts->folded += inside && !upright && !flat;
    facts->flattened += inside && !upright && flat;
    facts->straddling += !inside;
  }
  lod_arena_destroy(scratch);
  return status;
}
