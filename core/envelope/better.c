#include "core/envelope/better.h"

#include <string.h>

#include "core/base/sets.h"
#include "core/envelope/cover.h"
#include "core/envelope/internal.h"

struct lod_better_settings lod_better_defaults(void) {
  return (struct lod_better_settings){.level_triangles = 4000, .part_triangles = 300, .all_triangles = 3000};
}

/* ---- going on where the collapse has stopped ---- */

static enum lod_status go_on(const struct lod_collapser *c, double epsilon, const struct lod_progress *progress, struct lod_arena *arena,
                             struct lod_arena *scratch, struct lod_mesh *level, uint32_t *nearby, struct lod_better_report *report) {
  const struct lod_surface *s = &c->surface;
  uint32_t *face_to = LOD_NEW(scratch, s->face_count, uint32_t), live = 0;
  uint8_t *features = LOD_NEW(scratch, s->face_count, uint8_t);
  if (face_to == NULL || features == NULL)
    return LOD_MEMORY;
  for (uint32_t f = 0; f < s->face_count; f++) {
    face_to[f] = s->face[f][0] == LOD_NONE ? LOD_NONE : live;
    if (face_to[f] != LOD_NONE)
      features[live++] = s->feature[f];
  }
  struct lod_cover_settings settings = lod_cover_defaults();
  settings.feature_edges = features;
  struct lod_cover *cover;
  struct lod_problem problem = {0};
  enum lod_status status = lod_cover_create_from(level, c->mesh, c->bvh, c->certificate, face_to, &settings, scratch, &cover, &problem);
  if (status == LOD_BAD_INPUT)
    return LOD_OK; /* no surface that it could work on */
  LOD_TRY(status);
  LOD_TRY(lod_cover_run(cover, epsilon, progress));
  uint32_t before = level->triangle_count;
  if (lod_cover_triangle_count(cover) == before)
    return LOD_OK;
  report->saved_going_on += before - lod_cover_triangle_count(cover);
  struct lod_mesh result; /* the cover still reads the level */
  LOD_TRY(lod_cover_extract(cover, arena, &result, NULL, nearby));
  *level = result;
  return LOD_OK;
}

/* ---- parts, covered from the source ---- */

struct parts {
  uint32_t count;
  uint32_t *of_vertex;    /* source vertex -> part */
  uint32_t *of_triangle;  /* source triangle -> part */
  uint32_t *triangles;    /* of the source, per part */
  uint32_t *first, *list; /* the source's triangles by part, ascending: those of a part begin at first */
  uint32_t *vertex_to;    /* scratch of take_part: LOD_NONE everywhere between calls */
  uint32_t *in_level;     /* triangles of the level, per part; LOD_NONE: not known */
  uint32_t *of_level;     /* level triangle -> part, LOD_NONE: not known */
  struct lod_mesh *cover; /* per part; triangle_count 0: none that is better */
  uint32_t **cover_near;  /* per part: its triangle -> triangle of its cover */
};

/* Sets of vertices that triangles connect. */
static uint32_t *connect(const struct lod_mesh *mesh, struct lod_arena *scratch) {
  uint32_t *sets = lod_sets_create(scratch, mesh->vertex_count);
  for (uint32_t t = 0; sets != NULL && t < mesh->triangle_count; t++)
    for (int k = 1; k < 3; k++)
      lod_sets_join(sets, mesh->triangles[t][0], mesh->triangles[t][k]);
  for (uint32_t v = 0; sets != NULL && v < mesh->vertex_count; v++)
    sets[v] = lod_sets_find(sets, v);
  return sets;
}

static enum lod_status find_parts(const struct lod_mesh *source, const struct lod_mesh *level, const uint32_t *nearby,
                                  struct lod_arena *scratch, struct parts *p) {
  uint32_t *root = connect(source, scratch), *level_root = connect(level, scratch);
  uint32_t *part_of_root = LOD_NEW(scratch, level->vertex_count, uint32_t);
  p->of_vertex = LOD_NEW(scratch, source->vertex_count, uint32_t);
  p->of_triangle = LOD_NEW(scratch, source->triangle_count, uint32_t);
  p->of_level = LOD_NEW(scratch, level->triangle_count, uint32_t);
  if (root == NULL || level_root == NULL || part_of_root == NULL || p->of_vertex == NULL || p->of_triangle == NULL || p->of_level == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < source->vertex_count; v++) /* a root is the lowest vertex of its part */
    p->of_vertex[v] = root[v] == v ? p->count++ : p->of_vertex[root[v]];
  p->triangles = LOD_NEW_ZERO(scratch, p->count, uint32_t);
  p->in_level = LOD_NEW_ZERO(scratch, p->count, uint32_t);
  p->first = LOD_NEW(scratch, p->count, uint32_t);
  p->list = LOD_NEW(scratch, source->triangle_count, uint32_t);
  p->vertex_to = LOD_NEW(scratch, source->vertex_count, uint32_t);
  p->cover = LOD_NEW_ZERO(scratch, p->count, struct lod_mesh);
  p->cover_near = LOD_NEW_ZERO(scratch, p->count, uint32_t *);
  if (p->first == NULL || p->list == NULL || p->vertex_to == NULL || p->triangles == NULL || p->in_level == NULL || p->cover == NULL ||
      p->cover_near == NULL)
    return LOD_MEMORY;
  memset(p->vertex_to, 0xff, source->vertex_count * sizeof *p->vertex_to);
  memset(part_of_root, 0xff, level->vertex_count * sizeof *part_of_root);
  for (uint32_t t = 0; t < source->triangle_count; t++) {
    uint32_t part = p->of_triangle[t] = p->of_vertex[source->triangles[t][0]];
    p->triangles[part]++;
    if (nearby[t] == LOD_NONE || nearby[t] >= level->triangle_count)
      continue;
    uint32_t *of = &part_of_root[level_root[level->triangles[nearby[t]][0]]];
    if (*of != LOD_NONE && *of != part) /* a triangle of another part may certify; then neither part can be told apart */
      p->in_level[part] = p->in_level[*of] = LOD_NONE;
    else
      *of = part;
  }
  for (uint32_t part = 0, sum = 0; part < p->count; sum += p->triangles[part++])
    p->first[part] = sum;
  for (uint32_t t = 0; t < source->triangle_count; t++)
    p->list[p->first[p->of_triangle[t]]++] = t;
  for (uint32_t part = 0; part < p->count; part++)
    p->first[part] -= p->triangles[part];
  for (uint32_t t = 0; t < level->triangle_count; t++) {
    uint32_t part = p->of_level[t] = part_of_root[level_root[level->triangles[t][0]]];
    if (part != LOD_NONE && p->in_level[part] != LOD_NONE)
      p->in_level[part]++;
  }
  return LOD_OK;
}

/* The triangles of one part as a mesh of their own. */
static enum lod_status take_part(const struct lod_mesh *source, const struct parts *p, uint32_t part, struct lod_arena *scratch,
                                 struct lod_mesh *mesh) {
  *mesh = (struct lod_mesh){.triangle_count = p->triangles[part]};
  mesh->positions = lod_arena_alloc(scratch, 3 * (size_t)mesh->triangle_count, sizeof *mesh->positions);
  mesh->triangles = lod_arena_alloc(scratch, mesh->triangle_count, sizeof *mesh->triangles);
  mesh->materials = source->materials == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, uint32_t);
  mesh->parts = source->parts == NULL ? NULL : LOD_NEW(scratch, mesh->triangle_count, uint32_t);
  if (mesh->positions == NULL || mesh->triangles == NULL || (source->materials != NULL && mesh->materials == NULL) ||
      (source->parts != NULL && mesh->parts == NULL))
    return LOD_MEMORY;
  const uint32_t *list = p->list + p->first[part];
  for (uint32_t i = 0; i < mesh->triangle_count; i++) {
    for (int k = 0; k < 3; k++) {
      uint32_t v = source->triangles[list[i]][k], *to = &p->vertex_to[v];
      if (*to == LOD_NONE) {
        *to = mesh->vertex_count;
        memcpy(mesh->positions[mesh->vertex_count++], source->positions[v], sizeof *mesh->positions);
      }
      mesh->triangles[i][k] = *to;
    }
    if (mesh->materials != NULL)
      mesh->materials[i] = source->materials[list[i]];
    if (mesh->parts != NULL)
      mesh->parts[i] = source->parts[list[i]];
  }
  for (uint32_t i = 0; i < 3 * mesh->triangle_count; i++)
    p->vertex_to[source->triangles[list[i / 3]][i % 3]] = LOD_NONE;
  return LOD_OK;
}

/* Keeps the cover of a part when it has fewer triangles than the level has there. It lives in `arena`. */
static enum lod_status cover_part(const struct lod_mesh *source, struct parts *p, uint32_t part, double epsilon,
                                  const struct lod_progress *progress, struct lod_arena *arena, struct lod_arena *scratch) {
  struct lod_mesh *mesh = LOD_NEW(scratch, 1, struct lod_mesh);
  struct lod_bvh *bvh;
  struct lod_cover *cover;
  struct lod_problem problem = {0};
  if (mesh == NULL)
    return LOD_MEMORY;
  LOD_TRY(take_part(source, p, part, scratch, mesh));
  LOD_TRY(lod_bvh_create(mesh, 1, scratch, &bvh));
  enum lod_status status = lod_cover_create(mesh, bvh, NULL, scratch, &cover, &problem);
  if (status == LOD_BAD_INPUT)
    return LOD_OK;
  LOD_TRY(status);
  LOD_TRY(lod_cover_run(cover, epsilon, progress));
  if (lod_cover_triangle_count(cover) >= p->in_level[part])
    return LOD_OK;
  p->cover_near[part] = LOD_NEW(arena, mesh->triangle_count, uint32_t);
  return p->cover_near[part] == NULL ? LOD_MEMORY : lod_cover_extract(cover, arena, &p->cover[part], NULL, p->cover_near[part]);
}

/* Vertices that no triangle names any more. */
static enum lod_status drop_unused(struct lod_mesh *mesh, struct lod_arena *scratch) {
  uint32_t *vertex_to = LOD_NEW(scratch, mesh->vertex_count, uint32_t), used = 0;
  if (vertex_to == NULL)
    return LOD_MEMORY;
  memset(vertex_to, 0xff, mesh->vertex_count * sizeof *vertex_to);
  for (uint32_t i = 0; i < 3 * mesh->triangle_count; i++)
    vertex_to[mesh->triangles[i / 3][i % 3]] = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (vertex_to[v] != LOD_NONE) {
      memmove(mesh->positions[used], mesh->positions[v], sizeof *mesh->positions);
      vertex_to[v] = used++;
    }
  for (uint32_t i = 0; i < 3 * mesh->triangle_count; i++)
    mesh->triangles[i / 3][i % 3] = vertex_to[mesh->triangles[i / 3][i % 3]];
  mesh->vertex_count = used;
  return LOD_OK;
}

/* The level without its triangles of exchanged parts, then their covers. */
static enum lod_status assemble(const struct lod_mesh *source, const struct parts *p, struct lod_arena *arena, struct lod_arena *scratch,
                                struct lod_mesh *level, uint32_t *nearby, struct lod_better_report *report) {
  struct lod_mesh merged = *level; /* free edges and points stay as they are: they have vertices of their own */
  size_t triangles = level->triangle_count, vertices = level->vertex_count;
  for (uint32_t part = 0; part < p->count; part++) {
    triangles += p->cover[part].triangle_count;
    vertices += p->cover[part].vertex_count;
  }
  uint32_t *triangle_to = LOD_NEW(scratch, level->triangle_count, uint32_t), *base = LOD_NEW(scratch, p->count, uint32_t);
  uint32_t *within = LOD_NEW_ZERO(scratch, p->count, uint32_t); /* source triangles of a part met so far */
  merged.positions = lod_arena_alloc(arena, vertices, sizeof *merged.positions);
  merged.triangles = lod_arena_alloc(arena, triangles, sizeof *merged.triangles);
  merged.materials = level->materials == NULL ? NULL : LOD_NEW(arena, triangles, uint32_t);
  merged.parts = level->parts == NULL ? NULL : LOD_NEW(arena, triangles, uint32_t);
  if (triangle_to == NULL || base == NULL || within == NULL || merged.positions == NULL || merged.triangles == NULL ||
      (level->materials != NULL && merged.materials == NULL) || (level->parts != NULL && merged.parts == NULL))
    return LOD_MEMORY;
  memcpy(merged.positions, level->positions, level->vertex_count * sizeof *merged.positions);
  merged.triangle_count = 0;
  for (uint32_t t = 0; t < level->triangle_count; t++) {
    uint32_t part = p->of_level[t];
    triangle_to[t] = part != LOD_NONE && p->cover[part].triangle_count != 0 ? LOD_NONE : merged.triangle_count++;
    if (triangle_to[t] == LOD_NONE)
      continue;
    memcpy(merged.triangles[triangle_to[t]], level->triangles[t], sizeof *merged.triangles);
    if (merged.materials != NULL)
      merged.materials[triangle_to[t]] = level->materials[t];
    if (merged.parts != NULL)
      merged.parts[triangle_to[t]] = level->parts[t];
  }
  for (uint32_t part = 0; part < p->count; part++) {
    const struct lod_mesh *cover = &p->cover[part];
    base[part] = merged.triangle_count;
    for (uint32_t t = 0; t < cover->triangle_count; t++, merged.triangle_count++) {
      for (int k = 0; k < 3; k++)
        merged.triangles[merged.triangle_count][k] = merged.vertex_count + cover->triangles[t][k];
      if (merged.materials != NULL)
        merged.materials[merged.triangle_count] = cover->materials[t];
      if (merged.parts != NULL)
        merged.parts[merged.triangle_count] = cover->parts[t];
    }
    if (cover->triangle_count == 0)
      continue;
    memcpy(merged.positions + merged.vertex_count, cover->positions, cover->vertex_count * sizeof *merged.positions);
    merged.vertex_count += cover->vertex_count;
    report->parts_exchanged++;
    report->saved_in_parts += p->in_level[part] - cover->triangle_count;
  }
  for (uint32_t t = 0; t < source->triangle_count; t++) {
    uint32_t part = p->of_triangle[t], i = within[part]++;
    if (p->cover[part].triangle_count != 0)
      nearby[t] = p->cover_near[part][i] == LOD_NONE ? LOD_NONE : base[part] + p->cover_near[part][i];
    else if (nearby[t] != LOD_NONE && nearby[t] < level->triangle_count)
      nearby[t] = triangle_to[nearby[t]];
  }
  *level = merged;
  return drop_unused(level, scratch);
}

static enum lod_status exchange_parts(const struct lod_collapser *c, double epsilon, uint32_t most, uint32_t budget,
                                      const struct lod_progress *progress, struct lod_arena *arena, struct lod_arena *scratch,
                                      struct lod_mesh *level, uint32_t *nearby, struct lod_better_report *report) {
  struct parts parts = {0};
  bool any = false;
  LOD_TRY(find_parts(c->mesh, level, nearby, scratch, &parts));
  for (uint32_t part = 0; part < parts.count; part++) {
    if (parts.triangles[part] > most || parts.triangles[part] > budget || parts.in_level[part] == LOD_NONE || parts.in_level[part] <= 4)
      continue;
    budget -= parts.triangles[part];
    struct lod_arena *inner = lod_arena_create_child(scratch);
    enum lod_status status = inner == NULL ? LOD_MEMORY : cover_part(c->mesh, &parts, part, epsilon, progress, scratch, inner);
    lod_arena_destroy(inner);
    LOD_TRY(status);
    any = any || parts.cover[part].triangle_count != 0;
  }
  return any ? assemble(c->mesh, &parts, arena, scratch, level, nearby, report) : LOD_OK;
}

enum lod_status lod_envelope_better(const struct lod_collapser *c, double epsilon, const struct lod_better_settings *settings,
                                    const struct lod_progress *progress, struct lod_arena *arena, struct lod_mesh *level, uint32_t *nearby,
                                    struct lod_better_report *report) {
  *report = (struct lod_better_report){0};
  if (c->mesh->wedge_count != 0 || c->kept_count != 0 || level->edge_count + level->point_count != 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK && level->triangle_count <= settings->level_triangles)
    status = go_on(c, epsilon, progress, arena, scratch, level, nearby, report);
  uint32_t scale = c->settings.vertex_subset ? 10 : 1; /* among the source's vertices the cover often is the better */
  if (status == LOD_OK && settings->part_triangles != 0)
    status = exchange_parts(c, epsilon, scale * settings->part_triangles, scale * settings->all_triangles, progress, arena, scratch, level,
                            nearby, report);
  lod_arena_destroy(scratch);
  return status;
}
