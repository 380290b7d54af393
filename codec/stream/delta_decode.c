#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/header.h"

static enum lod_status check_frame(struct step *s, size_t size, const struct delta_inner *inner, const uint8_t *bytes,
                                   const struct lod_delta_limits *limits) {
  const struct lod_delta_header *h = &s->header;
  if (size < h->size)
    return lod_fail(s->problem, LOD_BAD_INPUT, "truncated", "A delta needs %zu bytes; there are %zu.", h->size, size);
  if (limits != NULL && limits->max_vertices != 0 && h->vertices > limits->max_vertices)
    return lod_fail(s->problem, LOD_LIMIT, "limit-vertices", "A delta declares %u vertices; the limit is %llu.", h->vertices,
                    (unsigned long long)limits->max_vertices);
  if (limits != NULL && limits->max_triangles != 0 && h->triangles > limits->max_triangles)
    return lod_fail(s->problem, LOD_LIMIT, "limit-triangles", "A delta declares %u triangles; the limit is %llu.", h->triangles,
                    (unsigned long long)limits->max_triangles);
  if (limits != NULL && limits->max_memory_bytes != 0 && h->memory_bytes > limits->max_memory_bytes)
    return lod_fail(s->problem, LOD_LIMIT, "limit-memory", "A delta declares that it takes %llu bytes to decode; the limit is %llu.",
                    (unsigned long long)h->memory_bytes, (unsigned long long)limits->max_memory_bytes);
  if (lod_crc32(bytes + h->header_bytes, h->size - h->header_bytes) != inner->first_crc)
    return lod_fail(s->problem, LOD_BAD_INPUT, "delta", "A delta is damaged: the checksum of its bytes is not the one in its header.");
  return LOD_OK;
}

static enum lod_status check_base(struct step *s, const struct lod_mesh *base) {
  const struct lod_delta_header *h = &s->header;
  uint32_t checksum = 0;
  if ((base != NULL) != (h->from != LOD_NONE))
    return lod_fail(s->problem, LOD_BAD_INPUT, "wrong-base",
                    base != NULL ? "A first picture needs no level to start from; there is one."
                                 : "A delta needs a level to start from; there is none.");
  if (base == NULL)
    return LOD_OK;
  if (base->vertex_count == h->base_vertices)
    LOD_TRY(lod_delta_checksum(base, s->scratch, &checksum));
  if (base->vertex_count != h->base_vertices || checksum != h->base_checksum)
    return lod_fail(s->problem, LOD_BAD_INPUT, "wrong-base",
                    "A delta starts from a level of %u vertices with checksum %08x; this one has %u vertices and checksum %08x.",
                    h->base_vertices, h->base_checksum, base->vertex_count, checksum);
  return LOD_OK;
}

static void fill_groups(const struct step *s, const uint32_t *index, uint32_t count, uint32_t *parts, uint32_t *materials) {
  for (uint32_t i = 0; i < count; i++) {
    parts[i] = s->groups.pairs[index[i]][0];
    materials[i] = s->groups.pairs[index[i]][1];
  }
}

static enum lod_status make_mesh(struct step *s, struct lod_mesh *mesh) {
  const struct lod_delta_header *h = &s->header;
  *mesh = (struct lod_mesh){.vertex_count = h->vertices,
                            .triangle_count = h->triangles,
                            .edge_count = h->edges,
                            .point_count = h->points,
                            .triangles = s->triangles,
                            .wedge_count = h->wedges,
                            .corners = s->wedge_corners,
                            .wedge_vertex = s->wedge_vertex,
                            .normals = s->normals,
                            .uvs = {s->uvs[0], s->uvs[1]},
                            .colors = s->colors};
  mesh->positions = lod_arena_alloc(s->arena, h->vertices, sizeof *mesh->positions);
  mesh->parts = LOD_NEW(s->arena, h->triangles, uint32_t);
  mesh->materials = LOD_NEW(s->arena, h->triangles, uint32_t);
  if (mesh->positions == NULL || mesh->parts == NULL || mesh->materials == NULL)
    return LOD_MEMORY;
  fill_groups(s, s->groups.triangles, h->triangles, mesh->parts, mesh->materials);
  if (h->edges != 0) {
    mesh->edges = s->edges;
    mesh->edge_thickness = s->edge_thickness;
    mesh->edge_parts = LOD_NEW(s->arena, h->edges, uint32_t);
    mesh->edge_materials = LOD_NEW(s->arena, h->edges, uint32_t);
    if (mesh->edge_parts == NULL || mesh->edge_materials == NULL)
      return LOD_MEMORY;
    fill_groups(s, s->groups.edges, h->edges, mesh->edge_parts, mesh->edge_materials);
  }
  if (h->points != 0) {
    mesh->points = s->points;
    mesh->point_thickness = s->point_thickness;
    mesh->point_parts = LOD_NEW(s->arena, h->points, uint32_t);
    mesh->point_materials = LOD_NEW(s->arena, h->points, uint32_t);
    if (mesh->point_parts == NULL || mesh->point_materials == NULL)
      return LOD_MEMORY;
    fill_groups(s, s->groups.points, h->points, mesh->point_parts, mesh->point_materials);
  }
  return LOD_OK;
}

static enum lod_status place_vertices(struct step *s, struct lod_delta_level *level) {
  struct lod_mesh *mesh = &level->mesh;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int i = 0; i < 3; i++) {
      mesh->positions[v][i] = lod_step_position(&s->header.grid, i, s->cells[v][i]);
      if (!(mesh->positions[v][i] >= -3.4e38f && mesh->positions[v][i] <= 3.4e38f))
        return lod_step_bad(s, "positions");
    }
  return LOD_OK;
}

/* Everything behind the header, whose counts are in s->header. */
static enum lod_status decode_body(struct step *s, const uint8_t *bytes, const struct delta_inner *inner, const struct lod_mesh *base,
                                   struct lod_delta_level *level) {
  const struct lod_mesh empty = {0};
  s->cut_vertices = inner->cut_vertices;
  s->components = inner->components;
  LOD_TRY(lod_step_base(base != NULL ? base : &empty, &s->header.grid, s->scratch, &s->base));
  s->cells = lod_arena_calloc(s->scratch, s->header.vertices, sizeof *s->cells);
  const struct lod_coder_tables *tables = lod_coder_tables_create(s->scratch);
  if (s->cells == NULL || tables == NULL)
    return LOD_MEMORY;
  const struct lod_coder_memory *primer = s->coder.primer;
  lod_coder_decode(&s->coder, tables, bytes + s->header.header_bytes, s->header.size - s->header.header_bytes);
  s->coder.primer = primer;
  LOD_TRY(lod_step_topology(s));
  LOD_TRY(lod_step_locate(s));
  LOD_TRY(lod_step_kept(s));
  LOD_TRY(lod_step_predict(s));
  LOD_TRY(lod_step_geometry(s));
  LOD_TRY(lod_step_attributes(s));
  if (!lod_coder_finish(&s->coder))
    return lod_step_bad(s, "bytes");
  LOD_TRY(make_mesh(s, &level->mesh));
  level->kept = NULL;
  if (base != NULL) {
    uint32_t *kept = LOD_NEW(s->arena, base->vertex_count, uint32_t);
    if (kept == NULL)
      return LOD_MEMORY;
    for (uint32_t b = 0; b < base->vertex_count; b++)
      kept[s->base.order[b]] = s->kept[b];
    level->kept = kept;
  }
  return place_vertices(s, level);
}

static enum lod_status decode(struct step *s, const uint8_t *bytes, size_t size, const struct lod_mesh *base,
                              const struct lod_delta_limits *limits, struct lod_delta_level *level) {
  struct delta_inner inner;
  uint32_t checksum;
  LOD_TRY(lod_delta_read_header(bytes, size, &s->header, &inner, s->problem));
  LOD_TRY(check_frame(s, size, &inner, bytes, limits));
  LOD_TRY(check_base(s, base));
  LOD_TRY(decode_body(s, bytes, &inner, base, level));
  LOD_TRY(lod_delta_checksum(&level->mesh, s->scratch, &checksum));
  if (checksum != s->header.checksum)
    return lod_fail(s->problem, LOD_BAD_INPUT, "delta", "A delta decodes to a level with checksum %08x; its header says %08x.", checksum,
                    s->header.checksum);
  return LOD_OK;
}

enum lod_status lod_delta_decode(const uint8_t *bytes, size_t size, const struct lod_mesh *base, const struct lod_delta_limits *limits,
                                 struct lod_arena *arena, struct lod_delta_level *level, struct lod_problem *problem) {
  struct lod_delta_statistics ignored = {0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct step s = {.arena = arena, .scratch = scratch, .problem = problem, .statistics = &ignored};
  *level = (struct lod_delta_level){0};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : decode(&s, bytes, size, base, limits, level);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

static enum lod_status decode_part(struct step *s, const uint8_t *bytes, size_t size, const struct lod_mesh *base,
                                   const struct lod_delta_limits *limits, struct lod_coder_memory **memory, struct lod_delta_level *level) {
  struct delta_inner inner;
  LOD_TRY(lod_delta_read_short(bytes, size, &s->header, &inner, s->problem));
  LOD_TRY(check_frame(s, size, &inner, bytes, limits));
  LOD_TRY(decode_body(s, bytes, &inner, base, level));
  if (memory != NULL && (*memory = lod_coder_remember(&s->coder, s->arena)) == NULL)
    return LOD_MEMORY;
  return LOD_OK;
}

enum lod_status lod_delta_decode_part(const uint8_t *bytes, size_t size, const struct lod_delta_header *header, const struct lod_mesh *base,
                                      const struct lod_delta_limits *limits, const struct lod_coder_memory *primer, struct lod_arena *arena,
                                      struct lod_coder_memory **memory, struct lod_delta_level *level, struct lod_problem *problem) {
  struct lod_delta_statistics ignored = {0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct step s = {.arena = arena, .scratch = scratch, .problem = problem, .statistics = &ignored, .header = *header};
  s.coder.primer = primer;
  *level = (struct lod_delta_level){0};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : decode_part(&s, bytes, size, base, limits, memory, level);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
