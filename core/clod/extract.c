/* One C-LOD out of the structure that holds them all, and corresponding points of now. */
#include <math.h>
#include <string.h>

#include "core/clod/internal.h"

static bool lives(const struct clod_patch *patch, uint32_t number) {
  return patch->born <= number && number < patch->died;
}

/* Numbers what is used from 0 on; map: old -> new, LOD_NONE = not used. */
static uint32_t number_used(uint32_t *map, uint32_t count) {
  uint32_t used = 0;
  for (uint32_t i = 0; i < count; i++)
    map[i] = map[i] == 0 ? LOD_NONE : used++;
  return used;
}

struct maps {
  uint32_t *vertex, *edge, *sector;
};

static enum lod_status allocate(struct lod_patches *patches, const struct lod_clod *clod, struct lod_arena *arena) {
  patches->positions = LOD_NEW(arena, patches->vertex_count, struct lod_vec3);
  patches->normals = LOD_NEW(arena, patches->normal_count, struct lod_vec3);
  patches->corners = lod_arena_alloc(arena, patches->patch_count, sizeof *patches->corners);
  patches->sectors = lod_arena_alloc(arena, patches->patch_count, sizeof *patches->sectors);
  patches->edges = lod_arena_alloc(arena, patches->patch_count, sizeof *patches->edges);
  patches->partners = lod_arena_alloc(arena, patches->patch_count, sizeof *patches->partners);
  patches->ends = lod_arena_alloc(arena, patches->edge_count, sizeof *patches->ends);
  patches->inner = lod_arena_alloc(arena, patches->edge_count, sizeof *patches->inner);
  patches->sharp = LOD_NEW(arena, patches->edge_count, bool);
  patches->centres = LOD_NEW(arena, patches->patch_count, struct lod_vec3);
  bool ok = patches->positions != NULL && patches->normals != NULL && patches->corners != NULL && patches->sectors != NULL &&
            patches->edges != NULL && patches->partners != NULL && patches->ends != NULL && patches->inner != NULL &&
            patches->sharp != NULL && patches->centres != NULL;
  if (clod->mesh->materials != NULL)
    ok = (patches->materials = LOD_NEW(arena, patches->patch_count, uint32_t)) != NULL && ok;
  if (clod->mesh->parts != NULL)
    ok = (patches->parts = LOD_NEW(arena, patches->patch_count, uint32_t)) != NULL && ok;
  return ok ? LOD_OK : LOD_MEMORY;
}

static void fill(const struct lod_clod *clod, uint32_t number, const struct maps *maps, struct lod_patches *patches) {
  for (uint32_t v = 0; v < clod->vertex_count; v++)
    if (maps->vertex[v] != LOD_NONE)
      patches->positions[maps->vertex[v]] = clod->positions[v];
  for (uint32_t s = 0; s < clod->sector_count; s++)
    if (maps->sector[s] != LOD_NONE)
      patches->normals[maps->sector[s]] = clod->sectors[s];
  for (uint32_t e = 0; e < clod->edge_count; e++) {
    uint32_t n = maps->edge[e];
    if (n == LOD_NONE)
      continue;
    for (int i = 0; i < 2; i++) {
      patches->ends[n][i] = maps->vertex[clod->edges[e].ends[i]];
      patches->inner[n][i] = clod->edges[e].inner[i];
    }
    patches->sharp[n] = (clod->edges[e].flags & CLOD_SHARP) != 0;
  }
  uint32_t next = 0;
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (!lives(patch, number))
      continue;
    for (uint32_t k = 0; k < 3; k++) {
      patches->corners[next][k] = maps->vertex[patch->corners[k]];
      patches->edges[next][k] = 2 * maps->edge[patch->sides[k] >> 1] + (patch->sides[k] & 1);
      patches->sectors[next][k] = maps->sector[patch->sectors[k]];
    }
    patches->centres[next] = patch->centre;
    if (patches->materials != NULL)
      patches->materials[next] = patch->material;
    if (patches->parts != NULL)
      patches->parts[next] = patch->part;
    next++;
  }
}

static enum lod_status extract(const struct lod_clod *clod, uint32_t number, struct lod_arena *arena, struct lod_arena *scratch,
                               struct lod_patches *patches, double *error) {
  struct maps maps = {LOD_NEW_ZERO(scratch, clod->vertex_count, uint32_t), LOD_NEW_ZERO(scratch, clod->edge_count, uint32_t),
                      LOD_NEW_ZERO(scratch, clod->sector_count, uint32_t)};
  if (maps.vertex == NULL || maps.edge == NULL || maps.sector == NULL)
    return LOD_MEMORY;
  double worst = 0;
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (!lives(patch, number))
      continue;
    patches->patch_count++;
    worst = fmax(worst, patch->bound);
    for (uint32_t k = 0; k < 3; k++) {
      maps.vertex[patch->corners[k]] = 1;
      maps.edge[patch->sides[k] >> 1] = 1;
      struct lod_vec3 normal = clod->sectors[patch->sectors[k]];
      maps.sector[patch->sectors[k]] = lod_vec3_length_squared(normal) > 0.5;
    }
  }
  patches->vertex_count = number_used(maps.vertex, clod->vertex_count);
  patches->edge_count = number_used(maps.edge, clod->edge_count);
  patches->normal_count = number_used(maps.sector, clod->sector_count);
  LOD_TRY(allocate(patches, clod, arena));
  fill(clod, number, &maps, patches);
  LOD_TRY(clod_attributes_extract(clod, number, arena, scratch, &patches->attributes, patches->patch_count));
  if (error != NULL)
    *error = worst;
  return lod_patches_find_partners(patches, scratch);
}

enum lod_status lod_clod_extract(const struct lod_clod *clod, uint32_t number, struct lod_arena *arena, struct lod_patches *patches,
                                 double *error) {
  *patches = (struct lod_patches){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : extract(clod, number, arena, scratch, patches, error);
  lod_arena_destroy(scratch);
  return status;
}

void lod_clod_samples(const struct lod_clod *clod, uint32_t per_side, void (*take)(void *context, const struct lod_clod_sample *sample),
                      void *context) {
  uint32_t living = 0;
  for (uint32_t p = 0; p < clod->patch_count; p++) {
    const struct clod_patch *patch = &clod->patches[p];
    if (patch->died != UINT32_MAX)
      continue;
    for (uint32_t c = 0; c < patch->cell_count; c++)
      for (uint32_t i = 0; i <= per_side; i++)
        for (uint32_t j = 0; i + j <= per_side; j++) {
          double l[3] = {(double)(per_side - i - j) / per_side, (double)i / per_side, (double)j / per_side};
          struct lod_clod_sample sample = {.patch = living, .face = patch->cells[c].face};
          for (int k = 0; k < 3; k++) {
            const struct clod_node *node = &patch->nodes[patch->cells[c].node[k]];
            struct lod_barycentric at = clod_domain(node);
            sample.at.u += l[k] * at.u;
            sample.at.v += l[k] * at.v;
            sample.at.w += l[k] * at.w;
            sample.point = lod_vec3_add_scaled(sample.point, clod->points[node->id], l[k]);
          }
          take(context, &sample);
        }
    living++;
  }
}
