/* STL, binary and text. Facet normals say nothing that the corners do not, so they are left; corners become shared vertices by the weld.
 *
 * Binary: 80 bytes, a 32-bit count, 50 bytes a facet, all little-endian. Text: solid, facet, outer loop, vertex, endloop, endfacet,
 * endsolid; loops with more than three vertices exist and are triangulated. A file that starts with "solid" is text unless its size says
 * binary. */
#include <string.h>
#include <strings.h>

#include "codec/import/number.h"
#include "codec/import/polygons.h"
#include "codec/import/reader.h"

enum { kHeader = 84, kFacet = 50 };

static uint32_t load_u32(const uint8_t *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static float load_float(const uint8_t *p) {
  uint32_t bits = load_u32(p);
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static enum lod_status add_part(struct lod_reader *reader, const struct lod_mesh *mesh) {
  struct lod_scene_part part = {.mesh = *mesh};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}

static enum lod_status read_binary(struct lod_reader *reader) {
  if (reader->size < kHeader)
    return lod_reader_bad(reader, "truncated", "a binary STL has at least 84 bytes, this file has %zu", reader->size);
  uint64_t count = load_u32(reader->bytes + 80), room = (reader->size - kHeader) / kFacet;
  if (count > room)
    return lod_reader_bad(reader, "truncated", "the STL header promises %llu facets, but there are bytes for %llu",
                          (unsigned long long)count, (unsigned long long)room);
  if (reader->size - kHeader > count * kFacet)
    lod_scene_warn(reader->scene, "%llu bytes behind the last facet were ignored.",
                   (unsigned long long)(reader->size - kHeader - count * kFacet));
  LOD_TRY(lod_reader_add_triangles(reader, count));
  LOD_TRY(lod_reader_add_vertices(reader, count * 3));
  struct lod_mesh mesh = {.vertex_count = (uint32_t)count * 3, .triangle_count = (uint32_t)count};
  mesh.positions = lod_arena_alloc(reader->scratch, mesh.vertex_count, sizeof *mesh.positions);
  mesh.triangles = lod_arena_alloc(reader->scratch, count, sizeof *mesh.triangles);
  if (!mesh.positions || !mesh.triangles)
    return lod_reader_memory(reader);
  const uint8_t *facet = reader->bytes + kHeader;
  for (uint32_t t = 0; t < mesh.triangle_count; t++, facet += kFacet)
    for (uint32_t k = 0; k < 3; k++) {
      for (uint32_t axis = 0; axis < 3; axis++)
        mesh.positions[3 * t + k][axis] = load_float(facet + 12 + 12 * k + 4 * axis);
      mesh.triangles[t][k] = 3 * t + k;
    }
  return add_part(reader, &mesh);
}

struct text {
  struct lod_reader *reader;
  const char *at, *end;
  uint64_t line;
  float (*positions)[3];
  uint32_t vertex_count, vertex_capacity;
  struct lod_polygons polygons;
};

static enum lod_status bad_text(struct text *text, const char *what) {
  return lod_reader_bad(text->reader, "bad-syntax", "line %llu of the STL %s", (unsigned long long)text->line, what);
}

/* The next word, at most 15 characters of it; false at the end. */
static bool next_word(struct text *text, char word[16]) {
  while (text->at < text->end && (*text->at == ' ' || (*text->at >= '\t' && *text->at <= '\r')))
    text->line += *text->at++ == '\n';
  size_t n = 0;
  while (text->at < text->end && *text->at != ' ' && !(*text->at >= '\t' && *text->at <= '\r')) {
    if (n < 15)
      word[n++] = *text->at;
    text->at++;
  }
  word[n] = 0;
  return n > 0;
}

static void skip_line(struct text *text) {
  while (text->at < text->end && *text->at != '\n')
    text->at++;
}

static enum lod_status read_vertex(struct text *text) {
  if (text->vertex_count == text->vertex_capacity) {
    uint64_t capacity = (uint64_t)text->vertex_capacity * 2 + 768;
    float(*positions)[3] = capacity < UINT32_MAX ? lod_arena_alloc(text->reader->scratch, capacity, sizeof *positions) : NULL;
    if (!positions)
      return lod_reader_memory(text->reader);
    if (text->vertex_count > 0)
      memcpy(positions, text->positions, text->vertex_count * sizeof *positions);
    text->positions = positions;
    text->vertex_capacity = (uint32_t)capacity;
  }
  for (int axis = 0; axis < 3; axis++) {
    double value;
    lod_number_skip_blanks(&text->at, text->end);
    if (text->at == text->end)
      return lod_reader_bad(text->reader, "truncated", "the file ends within a vertex");
    if (!lod_number_read(&text->at, text->end, &value))
      return bad_text(text, "has a vertex that is not three numbers");
    text->positions[text->vertex_count][axis] = (float)value;
  }
  text->vertex_count++;
  return lod_reader_add_vertices(text->reader, 1);
}

static enum lod_status end_loop(struct text *text, uint32_t first) {
  uint32_t count = text->vertex_count - first;
  uint32_t *corners = lod_polygons_begin(&text->polygons, text->reader, count);
  if (!corners)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++)
    corners[i] = first + i;
  return lod_polygons_end(&text->polygons, text->reader, count);
}

static enum lod_status read_facets(struct text *text) {
  char word[16];
  bool in_loop = false, in_solid = false;
  uint32_t first = 0;
  while (next_word(text, word)) {
    if (strcasecmp(word, "solid") == 0 || strcasecmp(word, "endsolid") == 0) {
      if (in_loop)
        return bad_text(text, "starts or ends a solid within a loop");
      in_solid = strcasecmp(word, "solid") == 0;
      skip_line(text);
    } else if (strcasecmp(word, "facet") == 0) {
      skip_line(text);
      LOD_TRY(text->polygons.polygon_count % 0x40000 == 0x3FFFF ? lod_reader_progress(text->reader, 0.2) : LOD_OK);
    } else if (strcasecmp(word, "loop") == 0) {
      if (in_loop)
        return bad_text(text, "starts a loop within a loop");
      in_loop = true;
      first = text->vertex_count;
    } else if (strcasecmp(word, "vertex") == 0) {
      if (!in_loop)
        return bad_text(text, "has a vertex outside of a loop");
      LOD_TRY(read_vertex(text));
    } else if (strcasecmp(word, "endloop") == 0) {
      if (!in_loop)
        return bad_text(text, "ends a loop that did not start");
      in_loop = false;
      LOD_TRY(end_loop(text, first));
    } else if (strcasecmp(word, "outer") != 0 && strcasecmp(word, "endfacet") != 0) {
      return bad_text(text, "starts with an unknown word; expected facet, outer loop, vertex, endloop, endfacet or endsolid");
    }
  }
  if (in_loop || in_solid)
    return lod_reader_bad(text->reader, "truncated", "the file ends before endsolid");
  return LOD_OK;
}

static enum lod_status read_text(struct lod_reader *reader) {
  struct text text = {.reader = reader, .at = (const char *)reader->bytes, .end = (const char *)reader->bytes + reader->size, .line = 1};
  if (reader->size >= 3 && memcmp(reader->bytes, "\xEF\xBB\xBF", 3) == 0)
    text.at += 3;
  LOD_TRY(lod_polygons_init(&text.polygons, reader, reader->size / 256));
  LOD_TRY(read_facets(&text));
  struct lod_mesh mesh = {.vertex_count = text.vertex_count, .positions = text.positions};
  struct lod_polygon_triangles triangles;
  LOD_TRY(lod_polygons_triangulate(&text.polygons, reader, text.positions, text.vertex_count, false, &triangles));
  mesh.triangles = triangles.triangles;
  mesh.triangle_count = triangles.count;
  if (text.polygons.dropped > 0)
    lod_scene_warn(reader->scene, "%u facets with fewer than three corners were dropped.", text.polygons.dropped);
  return add_part(reader, &mesh);
}

/* "solid" and no NUL byte where a binary header would be padded. */
static bool is_text(const struct lod_reader *reader) {
  size_t skip = reader->size >= 3 && memcmp(reader->bytes, "\xEF\xBB\xBF", 3) == 0 ? 3 : 0;
  while (skip < reader->size && (reader->bytes[skip] == ' ' || (reader->bytes[skip] >= '\t' && reader->bytes[skip] <= '\r')))
    skip++;
  if (reader->size < skip + 5 || strncasecmp((const char *)reader->bytes + skip, "solid", 5) != 0)
    return false;
  if (reader->size >= kHeader && kHeader + (uint64_t)kFacet * load_u32(reader->bytes + 80) == reader->size)
    return false;
  return memchr(reader->bytes, 0, reader->size < 512 ? reader->size : 512) == NULL;
}

enum lod_status lod_import_stl(struct lod_reader *reader) {
  return is_text(reader) ? read_text(reader) : read_binary(reader);
}
