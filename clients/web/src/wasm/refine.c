/* What JavaScript calls of core/refine, compiled to WebAssembly (`make wasm`): a base mesh, an interest that moves, and each frame the mesh
 * that is drawn. A handle is a pointer; 0 means failure. One instance belongs to one page or worker: no threads, no I/O, no clock. */
#include <stdlib.h>
#include <string.h>

#include "core/refine/doi.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(#name))) name
/* core/base/parallel.c has threads; this is what core/refine wants of it. */
bool lod_progress_cancelled(const struct lod_progress *progress) {
  return progress != NULL && progress->cancelled != NULL && progress->cancelled(progress->context);
}
#else
#define EXPORT(name) name
#endif

struct refinement {
  struct lod_arena *arena, *output_arena;
  struct lod_mesh mesh;        /* welded */
  uint32_t *vertex_map, given; /* vertices as they were given -> of mesh */
  float *values;               /* of `attribute`, by vertex of mesh; NULL: none yet */
  struct lod_refiner *refiner;
  struct lod_doi_term term;
  struct lod_doi_object object;
  double bone[1][3];
  struct lod_refine_limits limits;
  struct lod_refine_stats stats;
  uint32_t words[12];
};

void *EXPORT(lodr_alloc)(size_t size) {
  return malloc(size == 0 ? 1 : size);
}
void EXPORT(lodr_free)(void *block) {
  free(block);
}

void EXPORT(lodr_destroy)(struct refinement *r) {
  if (r == NULL)
    return;
  lod_refiner_destroy(r->refiner);
  lod_arena_destroy(r->output_arena);
  lod_arena_destroy(r->arena);
}

static struct refinement *fail(struct lod_arena *arena) {
  lod_arena_destroy(arena);
  return NULL;
}

/* positions: 3 a vertex; index: 3 a triangle; parts: a number a triangle, or 0. Vertices that share a position are one. crease: degrees. */
struct refinement *EXPORT(lodr_create)(const float *positions, uint32_t vertices, const uint32_t *index, uint32_t triangles,
                                       const uint32_t *parts, double crease, uint32_t megabytes) {
  struct lod_arena *arena = lod_arena_create((size_t)megabytes << 20);
  struct refinement *r = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct refinement);
  struct lod_mesh given = {.vertex_count = vertices,
                           .triangle_count = triangles,
                           .positions = (float(*)[3])(uintptr_t)positions,
                           .triangles = (uint32_t(*)[3])(uintptr_t)index,
                           .parts = (uint32_t *)(uintptr_t)parts};
  struct lod_refine_settings settings = lod_refine_defaults();
  settings.crease_degrees = crease;
  if (r == NULL || !lod_mesh_check(&given, NULL) || lod_mesh_weld(&given, arena, &r->mesh, &r->vertex_map) != LOD_OK)
    return fail(arena);
  if (parts != NULL) {
    r->mesh.parts = lod_arena_copy(arena, parts, triangles * sizeof *parts);
    if (r->mesh.parts == NULL)
      return fail(arena);
  }
  if (lod_refiner_create(&r->mesh, &settings, arena, &r->refiner, NULL) != LOD_OK)
    return fail(arena);
  r->arena = arena;
  r->given = vertices;
  r->term = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  r->limits = lod_refine_limits_defaults();
  return r;
}

/* The interest of kind ATTRIBUTE: a number in [0, 1] for each vertex as it was given; where several are one, the largest counts. */
bool EXPORT(lodr_values)(struct refinement *r, const float *values) {
  if (r->values == NULL)
    r->values = LOD_NEW(r->arena, r->mesh.vertex_count, float);
  if (r->values == NULL)
    return false;
  memset(r->values, 0, r->mesh.vertex_count * sizeof *r->values);
  for (uint32_t v = 0; v < r->given; v++) {
    uint32_t to = r->vertex_map[v];
    if (to != LOD_NONE && values[v] > r->values[to])
      r->values[to] = values[v];
  }
  return true;
}

/* v: eye, direction, look (a direction), point: 3 each; then degrees (0 = the kind's default), pixels, fov, height, falloff. parallel:
 * direction counts. part: of focus, LOD_NONE = the point. False: there is no such part. */
bool EXPORT(lodr_interest)(struct refinement *r, uint32_t kind, bool parallel, uint32_t part, const double *v) {
  struct lod_doi_term *term = &r->term;
  *term = lod_doi_term_defaults((enum lod_doi_kind)kind);
  memcpy(term->view.eye, v, sizeof term->view.eye);
  memcpy(term->view.direction, v + 3, sizeof term->view.direction);
  memcpy(term->look, v + 6, sizeof term->look);
  memcpy(term->point, v + 9, sizeof term->point);
  memcpy(r->bone, v + 9, sizeof r->bone);
  term->view.parallel = parallel;
  term->degrees = v[12] > 0 ? v[12] : term->degrees;
  term->pixels = v[13];
  term->view.fov_degrees = v[14];
  term->view.height_px = v[15];
  term->falloff = v[16];
  r->object = (struct lod_doi_object){.dominance = 1, .part = LOD_NONE, .bone_count = 1, .bones = r->bone};
  if (kind == LOD_DOI_FOCUS && part != LOD_NONE) { /* asked for each frame: nothing of it stays in the arena */
    struct lod_arena *scratch = lod_arena_create_child(r->arena);
    bool found = scratch != NULL && lod_doi_object_of_part(&r->mesh, part, false, scratch, &r->object, NULL) == LOD_OK;
    if (found)
      memcpy(r->bone, r->object.bones, sizeof r->bone);
    lod_arena_destroy(scratch);
    if (!found)
      return false;
    r->object.bones = r->bone;
  }
  term->values = r->values;
  if (kind == LOD_DOI_ATTRIBUTE && r->values == NULL)
    return false;
  term->objects = &r->object;
  term->object_count = 1;
  return true;
}

/* One frame. Returns splits and merges, 0 when nothing is left to do; -1 when memory is out. */
int32_t EXPORT(lodr_update)(struct refinement *r, uint32_t steps, uint32_t max_triangles, uint32_t max_operations) {
  struct lod_doi doi = {.terms = &r->term, .term_count = 1};
  r->limits.steps = steps;
  r->limits.max_triangles = max_triangles;
  r->limits.max_operations = max_operations;
  if (lod_refine_update(r->refiner, &doi, &r->limits, &r->stats) != LOD_OK)
    return -1;
  return (int32_t)(r->stats.splits + r->stats.merges);
}

/* All at once from the base, as the server does it. */
bool EXPORT(lodr_run)(struct refinement *r, uint32_t steps, uint32_t max_triangles) {
  struct lod_doi doi = {.terms = &r->term, .term_count = 1};
  r->limits.steps = steps;
  r->limits.max_triangles = max_triangles;
  lod_refiner_reset(r->refiner);
  return lod_refine_run(r->refiner, &doi, &r->limits, NULL, &r->stats) == LOD_OK;
}

/* Touches `point` of the interest: out[0..2] the contact, [3..5] its normal, [6] the distance. */
bool EXPORT(lodr_contact)(struct refinement *r, uint32_t steps, double *out) {
  struct lod_contact contact;
  if (lod_refine_contact(r->refiner, r->term.point, steps, &contact, NULL) != LOD_OK)
    return false;
  memcpy(out, contact.point, sizeof contact.point);
  memcpy(out + 3, contact.normal, sizeof contact.normal);
  out[6] = contact.distance;
  return true;
}

/* The drawn mesh, a vertex for each wedge: vertices, triangles, addresses of positions, normals, the middles of their parents' edges (where
 * a new vertex comes from), identities (the same from frame to frame), indices, levels of triangles. Valid until the next call; 0: memory.
 */
const uint32_t *EXPORT(lodr_mesh)(struct refinement *r) {
  struct lod_refine_output output;
  lod_arena_destroy(r->output_arena);
  r->output_arena = lod_arena_create_child(r->arena);
  if (r->output_arena == NULL || lod_refiner_mesh(r->refiner, r->output_arena, &output) != LOD_OK)
    return NULL;
  const struct lod_mesh *mesh = &output.mesh;
  float(*positions)[3] = lod_arena_alloc(r->output_arena, mesh->wedge_count, sizeof *positions);
  float(*from)[3] = lod_arena_alloc(r->output_arena, mesh->wedge_count, sizeof *from);
  uint32_t *ids = LOD_NEW(r->output_arena, mesh->wedge_count, uint32_t);
  if (positions == NULL || from == NULL || ids == NULL)
    return NULL;
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    uint32_t v = mesh->wedge_vertex[w];
    const float *a = mesh->positions[output.parents[v][0]], *b = mesh->positions[output.parents[v][1]];
    memcpy(positions[w], mesh->positions[v], sizeof positions[w]);
    for (int k = 0; k < 3; k++)
      from[w][k] = (a[k] + b[k]) / 2;
    ids[w] = output.ids[v];
  }
  const void *const addresses[6] = {positions, mesh->normals, from, ids, mesh->corners, output.levels};
  r->words[0] = mesh->wedge_count;
  r->words[1] = mesh->triangle_count;
  for (int i = 0; i < 6; i++)
    r->words[2 + i] = (uint32_t)(uintptr_t)addresses[i];
  r->words[8] = r->stats.splits;
  r->words[9] = r->stats.merges;
  r->words[10] = r->stats.budget;
  return r->words;
}
