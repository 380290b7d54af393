#include <math.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/header.h"

struct lod_delta_encode_request lod_delta_encode_defaults(void) {
  return (struct lod_delta_encode_request){.from = LOD_NONE, .unit_count = 1, .normal_degrees = 3, .normal_bits = 8};
}

static enum lod_status check_request(const struct lod_delta_encode_request *request, struct lod_problem *problem) {
  const struct lod_mesh *fine = request->fine;
  if (fine->triangle_count >= LOD_NONE / 6 || fine->vertex_count >= LOD_NONE / 6)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "A delta holds at most %u triangles.", LOD_NONE / 6 - 1);
  for (uint32_t t = 0; t < fine->triangle_count; t++) {
    const uint32_t *v = fine->triangles[t];
    if (v[0] == v[1] || v[1] == v[2] || v[2] == v[0])
      return lod_fail(problem, LOD_BAD_INPUT, "degenerate", "Triangle %u of a level to encode has a vertex twice.", t);
  }
  return LOD_OK;
}

/* Grid indices of the finer level's vertices, which must be on the grid to the bit. */
static enum lod_status find_cells(const struct lod_delta_encode_request *request, struct lod_arena *arena, int32_t (**cells)[3],
                                  struct lod_problem *problem) {
  const struct lod_mesh *fine = request->fine;
  int32_t(*q)[3] = *cells = lod_arena_alloc(arena, fine->vertex_count, sizeof *q);
  if (q == NULL)
    return lod_fail_memory(problem);
  for (uint32_t v = 0; v < fine->vertex_count; v++)
    for (int i = 0; i < 3; i++) {
      double steps = floor(((double)fine->positions[v][i] - (double)request->grid.origin[i]) / (double)request->grid.step + 0.5);
      if (!(steps >= 0 && steps < 0x1p24))
        return lod_fail(problem, LOD_BAD_INPUT, "off-grid", "Vertex %u of a level to encode lies outside its grid.", v);
      q[v][i] = (int32_t)steps;
      if (lod_step_position(&request->grid, i, q[v][i]) != fine->positions[v][i])
        return lod_fail(problem, LOD_BAD_INPUT, "off-grid", "Vertex %u of a level to encode is not on its grid.", v);
    }
  return LOD_OK;
}

static enum lod_status encode_first(struct step *s) {
  int32_t(*given)[3];
  const uint32_t vertices = s->header.vertices;
  LOD_TRY(find_cells(s->request, s->scratch, &given, s->problem));
  s->cells = lod_arena_alloc(s->scratch, vertices, sizeof *s->cells);
  if (s->cells == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_step_topology(s));
  for (uint32_t v = 0; v < vertices; v++)
    memcpy(s->cells[v], given[s->source[v]], sizeof *given);
  LOD_TRY(lod_step_locate(s));
  LOD_TRY(lod_step_kept(s));
  LOD_TRY(lod_step_predict(s));
  LOD_TRY(lod_step_geometry(s));
  LOD_TRY(lod_step_attributes(s));
  return lod_coder_finish(&s->coder) ? LOD_OK : LOD_MEMORY;
}

static enum lod_status encode(struct step *s, struct lod_arena *arena, uint8_t **bytes, size_t *size) {
  const struct lod_delta_encode_request *request = s->request;
  const struct lod_mesh *fine = request->fine, empty = {0};
  const struct lod_coder_tables *tables = lod_coder_tables_create(s->scratch);
  LOD_TRY(check_request(request, s->problem));
  LOD_TRY(lod_cut_create((const uint32_t(*)[3])fine->triangles, fine->triangle_count, fine->vertex_count, s->scratch, &s->cut));
  s->cut_vertices = s->cut.vertex_count;
  s->components = s->cut.component_count;
  s->header = (struct lod_delta_header){.from = request->base != NULL ? request->from : LOD_NONE,
                                        .to = request->to,
                                        .unit = request->unit,
                                        .unit_count = request->unit_count,
                                        .base_vertices = request->base != NULL ? request->base->vertex_count : 0,
                                        .vertices = fine->vertex_count,
                                        .triangles = fine->triangle_count,
                                        .edges = fine->edge_count,
                                        .points = fine->point_count,
                                        .wedges = fine->wedge_count,
                                        .grid = request->grid};
  uint8_t *used = LOD_NEW_ZERO(s->scratch, fine->vertex_count, uint8_t);
  if (tables == NULL || used == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < fine->triangle_count; t++)
    for (int i = 0; i < 3; i++)
      used[fine->triangles[t][i]] = 1;
  for (uint32_t v = 0; v < fine->vertex_count; v++)
    s->loose += !used[v];
  if (fine->wedge_count != 0) {
    uint32_t corners = 0;
    uint8_t *cornered = LOD_NEW_ZERO(s->scratch, fine->wedge_count, uint8_t);
    if (cornered == NULL)
      return LOD_MEMORY;
    for (uint32_t t = 0; t < fine->triangle_count; t++)
      for (int i = 0; i < 3; i++) {
        corners += !cornered[fine->corners[t][i]];
        cornered[fine->corners[t][i]] = 1;
      }
    if (corners != fine->wedge_count)
      return lod_fail(s->problem, LOD_BAD_INPUT, "loose-wedges", "A level to encode has attributes at segments or points.");
  }
  LOD_TRY(lod_step_base(request->base != NULL ? request->base : &empty, &request->grid, s->scratch, &s->base));
  if (request->base != NULL)
    LOD_TRY(lod_delta_checksum(request->base, s->scratch, &s->header.base_checksum));
  LOD_TRY(lod_delta_checksum(fine, s->scratch, &s->header.checksum));
  lod_coder_encode(&s->coder, tables, s->scratch);
  s->coder.primer = request->primer;
  LOD_TRY(encode_first(s));
  if (s->coder.out_size > UINT32_MAX)
    return lod_fail(s->problem, LOD_LIMIT, "limit-bytes", "A delta would have more than 4 GB.");
  uint8_t header[LOD_DELTA_MAX_HEADER_BYTES];
  struct delta_inner inner = {
      .cut_vertices = s->cut_vertices, .components = s->components, .first_crc = lod_crc32(s->coder.out, s->coder.out_size)};
  if (request->memory != NULL && (*request->memory = lod_coder_remember(&s->coder, arena)) == NULL)
    return LOD_MEMORY;
  s->header.size = s->coder.out_size;
  if (request->part)
    lod_delta_write_short(&s->header, &inner, header);
  else
    lod_delta_write_header(&s->header, &inner, header);
  s->statistics->header += 8.0 * (double)s->header.header_bytes;
  *size = s->header.size;
  *bytes = LOD_NEW(arena, *size, uint8_t);
  if (*bytes == NULL)
    return LOD_MEMORY;
  memcpy(*bytes, header, s->header.header_bytes);
  if (s->coder.out_size != 0)
    memcpy(*bytes + s->header.header_bytes, s->coder.out, s->coder.out_size);
  return LOD_OK;
}

enum lod_status lod_delta_encode(const struct lod_delta_encode_request *request, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                                 struct lod_problem *problem) {
  struct lod_delta_statistics ignored = {0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct step s = {.arena = scratch,
                   .scratch = scratch,
                   .problem = problem,
                   .request = request,
                   .statistics = request->statistics != NULL ? request->statistics : &ignored};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : encode(&s, arena, bytes, size);
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
