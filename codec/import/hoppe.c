/* Meshes in Hoppe's text format: "Vertex n x y z {...}" and "Face n a b c ... {...}" with 1-based numbers that may have gaps.
 *
 * Based on: Hoppe. Mesh processing library, file formats (.m). Attributes in braces are not read. */
#include <stdio.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/polygons.h"
#include "codec/import/reader.h"

struct hoppe {
  struct lod_reader *reader;
  const char *at, *end; /* the line */
  uint64_t line;
  uint32_t vertex_count, capacity; /* capacity: of `vertex_of`, highest number + 1 */
  uint32_t *vertex_of;             /* number in the file -> vertex, LOD_NONE = none */
  float (*positions)[3];
  double worst;
  struct lod_polygons polygons;
};

static enum lod_status bad_line(struct hoppe *hoppe, const char *what) {
  return lod_reader_bad(hoppe->reader, "bad-syntax", "line %llu %s", (unsigned long long)hoppe->line, what);
}

static bool next_number(struct hoppe *hoppe, double *value) {
  lod_number_skip_blanks(&hoppe->at, hoppe->end);
  return hoppe->at < hoppe->end && *hoppe->at != '{' && lod_number_read(&hoppe->at, hoppe->end, value);
}

static bool next_id(struct hoppe *hoppe, uint32_t *id) {
  double value;
  if (!next_number(hoppe, &value) || !(value >= 0) || value >= hoppe->capacity || value != floor(value))
    return false;
  *id = (uint32_t)value;
  return true;
}

static enum lod_status read_vertex(struct hoppe *hoppe) {
  uint32_t id;
  double squared = 0;
  if (!next_id(hoppe, &id))
    return bad_line(hoppe, "has a vertex without a number, or with one that is too large for the file");
  LOD_TRY(lod_reader_add_vertices(hoppe->reader, 1));
  for (int axis = 0; axis < 3; axis++) {
    double value;
    if (!next_number(hoppe, &value))
      return bad_line(hoppe, "has a vertex without three coordinates");
    hoppe->positions[hoppe->vertex_count][axis] = (float)value;
    double off = fabs(value - (double)(float)value) + 0x1p-53 * fabs(value);
    squared += isfinite(off) ? off * off : 0;
  }
  hoppe->worst = fmax(hoppe->worst, squared);
  hoppe->vertex_of[id] = hoppe->vertex_count++;
  return LOD_OK;
}

static enum lod_status read_face(struct hoppe *hoppe) {
  double ignored;
  uint32_t id, count = 0;
  if (!next_number(hoppe, &ignored))
    return bad_line(hoppe, "has a face without a number");
  /* Two bytes a corner at least. */
  uint32_t *corners = lod_polygons_begin(&hoppe->polygons, hoppe->reader, (uint32_t)((hoppe->end - hoppe->at) / 2 + 1));
  if (!corners)
    return LOD_MEMORY;
  for (;;) {
    lod_number_skip_space(&hoppe->at, hoppe->end);
    if (hoppe->at == hoppe->end || *hoppe->at == '{')
      break;
    if (!next_id(hoppe, &id) || hoppe->vertex_of[id] == LOD_NONE)
      return lod_reader_bad(hoppe->reader, "index-out-of-range", "line %llu has a face with a vertex that does not exist",
                            (unsigned long long)hoppe->line);
    corners[count++] = hoppe->vertex_of[id];
  }
  return lod_polygons_end(&hoppe->polygons, hoppe->reader, count);
}

static enum lod_status read_lines(struct hoppe *hoppe) {
  const char *text = (const char *)hoppe->reader->bytes, *end = text + hoppe->reader->size;
  while (text < end) {
    const char *stop = memchr(text, '\n', (size_t)(end - text));
    hoppe->end = stop ? stop : end;
    hoppe->at = text;
    hoppe->line++;
    size_t length = (size_t)(hoppe->end - text);
    if (length > UINT32_MAX)
      return bad_line(hoppe, "is too long");
    if (length > 7 && memcmp(text, "Vertex ", 7) == 0) {
      hoppe->at += 7;
      LOD_TRY(read_vertex(hoppe));
    } else if (length > 5 && memcmp(text, "Face ", 5) == 0) {
      hoppe->at += 5;
      LOD_TRY(read_face(hoppe));
    }
    text = stop ? stop + 1 : end;
  }
  return LOD_OK;
}

enum lod_status lod_import_hoppe(struct lod_reader *reader) {
  struct hoppe hoppe = {.reader = reader};
  /* A vertex line has at least "Vertex 1 0 0 0\n"; numbers may have gaps, but not wilder than bytes in the file. */
  uint64_t most = reader->size / 15 + 1;
  if (reader->size >= UINT32_MAX)
    return lod_reader_fail(reader, LOD_LIMIT, "limit-bytes", "a .m file of 4 GiB or more");
  hoppe.capacity = (uint32_t)reader->size + 1;
  hoppe.vertex_of = LOD_NEW(reader->scratch, hoppe.capacity, uint32_t);
  hoppe.positions = lod_arena_alloc(reader->scratch, most, sizeof *hoppe.positions);
  if (!hoppe.vertex_of || !hoppe.positions)
    return lod_reader_memory(reader);
  memset(hoppe.vertex_of, 0xFF, hoppe.capacity * sizeof *hoppe.vertex_of);
  LOD_TRY(lod_polygons_init(&hoppe.polygons, reader, reader->size / 64));
  LOD_TRY(read_lines(&hoppe));
  struct lod_mesh mesh = {.vertex_count = hoppe.vertex_count, .positions = hoppe.positions};
  struct lod_polygon_triangles triangles;
  LOD_TRY(lod_polygons_triangulate(&hoppe.polygons, reader, mesh.positions, mesh.vertex_count, false, &triangles));
  mesh.triangles = triangles.triangles;
  mesh.triangle_count = triangles.count;
  struct lod_scene_part part = {.mesh = mesh, .rounding = sqrt(hoppe.worst) * (1 + 0x1p-50)};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}
