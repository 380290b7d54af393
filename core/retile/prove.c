/* Is a level within an error of the source, both ways? Proven triangle by triangle (certify.h); those that fail are told to match.c, so
 * that vertices come there. */
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/mesh/certify.h"
#include "core/retile/internal.h"

/* The tiling as it is, as a mesh of positions: what extract.c will write. */
static enum lod_status current_mesh(const struct tiling *t, struct lod_arena *arena, struct lod_mesh *mesh, uint32_t **face_to,
                                    uint32_t **face_from) {
  *mesh = (struct lod_mesh){.vertex_count = t->vertex_count};
  RETILE_TRY_NEW(mesh->positions, arena, t->vertex_count);
  RETILE_TRY_NEW(mesh->triangles, arena, t->face_count);
  RETILE_TRY_NEW(*face_to, arena, t->face_count);
  RETILE_TRY_NEW(*face_from, arena, t->face_count);
  for (uint32_t v = 0; v < t->vertex_count; v++)
    lod_vec3_to_float(t->positions[v], mesh->positions[v]);
  for (uint32_t f = 0; f < t->face_count; f++) {
    (*face_to)[f] = LOD_NONE;
    if (t->faces[f][0] == LOD_NONE)
      continue;
    (*face_to)[f] = mesh->triangle_count;
    (*face_from)[mesh->triangle_count] = f;
    for (int k = 0; k < 3; k++)
      mesh->triangles[mesh->triangle_count][k] = t->faces[f][k];
    mesh->triangle_count++;
  }
  return LOD_OK;
}

struct prover {
  const struct lod_bvh *items, *target;
  double error, rounding;
  const uint32_t *hints; /* by item triangle */
  bool *failed;          /* by item triangle */
};

static void prove_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  enum { MOST_SPLITS = 200 };
  struct prover *p = context;
  struct lod_vertex_cache cache;
  (void)chunk;
  lod_vertex_cache_init(&cache);
  struct lod_certifier c = {
      .items = p->items, .target = p->target, .cache = &cache, .relative = 0.1, .rounding = p->rounding, .known_upper = INFINITY};
  uint32_t last = LOD_NONE;
  for (size_t i = begin; i < end; i++) {
    struct lod_piece rest[LOD_CERTIFY_REST];
    lod_certifier_init(&c, 0.9 * p->error); /* pieces up to 0.99 of it are dropped */
    c.last = last;
    uint32_t left = lod_certify_primitive(&c, (uint32_t)i, p->hints[i], MOST_SPLITS, rest);
    p->failed[i] = left != 0 || c.upper + c.rounding > p->error || c.reached > p->error;
    last = c.last;
  }
}

/* A vertex that may go back lies on the face, or on a neighbour: that one is blamed. */
static void blame(struct tiling *t, uint32_t f, double error) {
  uint32_t blamed = f;
  for (uint32_t k = 0; k < 3 && t->flat_head[blamed] == LOD_NONE; k++)
    if (t->twin[3 * f + k] != LOD_NONE && t->flat_head[t->twin[3 * f + k] / 3] != LOD_NONE)
      blamed = t->twin[3 * f + k] / 3;
  t->missed[blamed] = fmaxf(t->missed[blamed], (float)(1.01 * error));
  t->missed[f] = fmaxf(t->missed[f], (float)(1.01 * error));
}

static uint32_t blame_items(struct tiling *t, const bool *failed, uint32_t count, const uint32_t *face_from, double error) {
  uint32_t bad = 0;
  for (uint32_t i = 0; i < count; i++)
    if (failed[i]) {
      blame(t, face_from[i], error);
      bad++;
    }
  return bad;
}

static uint32_t blame_sources(struct tiling *t, const bool *failed, double error, bool *wanted) {
  uint32_t bad = 0;
  for (uint32_t s = 0; s < t->sheet->face_count; s++) {
    if (!failed[s])
      continue;
    bad++;
    for (uint32_t k = 0; k < 3 && t->sheet->faces[s][0] != LOD_NONE; k++) {
      uint32_t v = t->sheet->faces[s][k];
      uint32_t f = t->dead[v] ? t->flat[v].face : t->corner[v] / 3;
      if (f == LOD_NONE)
        continue;
      blame(t, f, error);
      wanted[v] = t->dead[v];
    }
  }
  return bad;
}

static enum lod_status prove(struct tiling *t, double error, uint32_t threads, struct lod_arena *arena, bool *wanted, uint32_t *bad) {
  enum { GRAIN = 512 };
  struct lod_mesh mesh;
  uint32_t *face_to, *face_from, *hints;
  struct lod_bvh *bvh;
  bool *failed;
  uint32_t sources = t->sheet->face_count;
  memset(wanted, 0, t->vertex_count * sizeof *wanted);
  LOD_TRY(current_mesh(t, arena, &mesh, &face_to, &face_from));
  LOD_TRY(lod_bvh_create(&mesh, threads, arena, &bvh));
  RETILE_TRY_NEW(hints, arena, (size_t)mesh.triangle_count + sources);
  RETILE_TRY_NEW_ZERO(failed, arena, (size_t)mesh.triangle_count + sources);
  for (uint32_t i = 0; i < mesh.triangle_count; i++)
    hints[i] = t->points[mesh.triangles[i][0]].face;
  double rounding = lod_tolerance_rounding(lod_mesh_magnitude(t->sheet->mesh));
  struct prover p = {bvh, t->source, error, rounding, hints, failed};
  lod_parallel_for(threads, mesh.triangle_count, GRAIN, prove_chunk, &p);
  *bad = blame_items(t, failed, mesh.triangle_count, face_from, error);
  if (mesh.triangle_count == 0)
    return LOD_OK;
  for (uint32_t s = 0; s < sources; s++) {
    hints[s] = LOD_NONE;
    for (uint32_t k = 0; k < 3 && t->sheet->faces[s][0] != LOD_NONE && hints[s] == LOD_NONE; k++)
      if (t->dead[t->sheet->faces[s][k]] && t->flat[t->sheet->faces[s][k]].face != LOD_NONE)
        hints[s] = face_to[t->flat[t->sheet->faces[s][k]].face];
    failed[s] = false;
  }
  p.items = t->source;
  p.target = bvh;
  lod_parallel_for(threads, sources, GRAIN, prove_chunk, &p);
  *bad += blame_sources(t, failed, error, wanted);
  return LOD_OK;
}

enum lod_status prove_level(struct tiling *tiling, double error, uint32_t threads, struct lod_arena *arena, bool *wanted, uint32_t *bad) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : prove(tiling, error, threads, scratch, wanted, bad);
  lod_arena_destroy(scratch);
  return status;
}
