/* Geomview's OFF as text: [ST][C][N][4][n]OFF, counts, a vertex a line, a face a line (how many corners, their vertices, perhaps a colour).
 *
 * Based on: Geomview manual, OFF. A line of a vertex: position (with 4: homogeneous), with N a normal, with C a colour of 3 or 4 numbers
 * (up to 1, or up to 255 where any is larger), with ST texture coordinates. Colours of faces are not read. n: the next number is the
 * dimension, of which 3 alone is read; what is binary is refused. Counts are held against the bytes before memory is taken for them. */
#include <math.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/polygons.h"
#include "codec/import/reader.h"

enum { NUMBERS = 16, VERTEX_BYTES = 6, FACE_BYTES = 4 }; /* "0 0 0\n" and "0\n" with what a line end may lack */

struct off {
  struct lod_reader *reader;
  const char *at, *end;
  uint64_t line;
  bool has_uv, has_color, has_normal, homogeneous;
  uint32_t vertex_count, face_count;
  double worst, brightest;
  struct lod_mesh mesh;
  struct lod_polygons polygons;
};

static enum lod_status bad_line(struct off *off, const char *what) {
  return lod_reader_bad(off->reader, "bad-syntax", "line %llu of the OFF %s", (unsigned long long)off->line, what);
}

/* To the next thing that is neither white space nor a comment, over line ends; false at the end of the file. */
static bool find_next(struct off *off) {
  while (off->at < off->end) {
    if (*off->at == '#')
      while (off->at < off->end && *off->at != '\n')
        off->at++;
    else if (*off->at == ' ' || (*off->at >= '\t' && *off->at <= '\r'))
      off->line += *off->at++ == '\n';
    else
      return true;
  }
  return false;
}

static bool is_line_over(struct off *off) {
  lod_number_skip_blanks(&off->at, off->end);
  return off->at == off->end || *off->at == '\n' || *off->at == '\r' || *off->at == '#';
}

static enum lod_status read_count(struct off *off, const char *what, double most, uint32_t *count) {
  double value;
  if (!find_next(off))
    return lod_reader_bad(off->reader, "truncated", "the file ends within its OFF header");
  if (!lod_number_read(&off->at, off->end, &value) || !(value >= 0) || value != floor(value))
    return lod_reader_bad(off->reader, "bad-header", "the counts of the OFF header are no whole numbers");
  if (value > most)
    return lod_reader_bad(off->reader, "truncated", "the OFF header promises %.0f %s, more than %zu bytes can hold", value, what,
                          off->reader->size);
  *count = value < UINT32_MAX ? (uint32_t)value : UINT32_MAX;
  return LOD_OK;
}

static bool take(struct off *off, const char *word) {
  const size_t size = strlen(word);
  const bool found = (size_t)(off->end - off->at) >= size && memcmp(off->at, word, size) == 0;
  off->at += found ? size : 0;
  return found;
}

static enum lod_status read_header(struct off *off) {
  const double bytes = (double)off->reader->size + 1;
  uint32_t dimension = 3, edges;
  find_next(off);
  off->has_uv = take(off, "ST");
  off->has_color = take(off, "C");
  off->has_normal = take(off, "N");
  off->homogeneous = take(off, "4");
  const bool any_dimension = take(off, "n");
  if (!take(off, "OFF"))
    return lod_reader_bad(off->reader, "bad-header", "the file does not begin with OFF, as COFF, NOFF and the like do too");
  lod_number_skip_blanks(&off->at, off->end);
  if (take(off, "BINARY"))
    return lod_reader_fail(off->reader, LOD_UNSUPPORTED, "unsupported", "binary OFF is not read; write it as text");
  if (any_dimension)
    LOD_TRY(read_count(off, "dimensions", 1e9, &dimension));
  if (dimension != 3)
    return lod_reader_fail(off->reader, LOD_UNSUPPORTED, "unsupported", "the OFF has %u dimensions; 3 are read", dimension);
  LOD_TRY(read_count(off, "vertices", bytes / VERTEX_BYTES, &off->vertex_count));
  LOD_TRY(read_count(off, "faces", bytes / FACE_BYTES + 1, &off->face_count));
  if (!is_line_over(off)) /* some leave the number of edges out */
    LOD_TRY(read_count(off, "edges", 1e15, &edges));
  return is_line_over(off) ? LOD_OK : bad_line(off, "says more than its three counts");
}

static void set_position(struct off *off, uint32_t v, const double *numbers) {
  const double w = off->homogeneous ? numbers[3] : 1;
  double squared = 0;
  for (int axis = 0; axis < 3; axis++) {
    const double value = numbers[axis] / w;
    off->mesh.positions[v][axis] = (float)value;
    const double lost = fabs(value - (double)(float)value) + 0x1p-52 * fabs(value);
    squared += isfinite(lost) ? lost * lost : 0;
  }
  off->worst = fmax(off->worst, squared);
}

/* Numbers of a vertex's line, in the order of the header's letters. */
static enum lod_status set_vertex(struct off *off, uint32_t v, const double *numbers, int count) {
  int at = off->homogeneous ? 4 : 3;
  const int behind = off->has_uv ? 2 : 0, colors = off->has_color ? count - at - behind - (off->has_normal ? 3 : 0) : 0;
  if (count < at + behind + (off->has_normal ? 3 : 0) + (off->has_color ? 3 : 0))
    return bad_line(off, "has a vertex with too few numbers");
  set_position(off, v, numbers);
  for (int i = 0; off->has_normal && i < 3; i++)
    off->mesh.normals[v][i] = (float)numbers[at++];
  for (int i = 0; off->has_color && i < (colors < 4 ? colors : 4); i++) {
    off->mesh.colors[v][i] = (float)numbers[at + i];
    off->brightest = fmax(off->brightest, numbers[at + i]);
  }
  at += colors;
  for (int i = 0; off->has_uv && i < 2; i++)
    off->mesh.uvs[0][v][i] = (float)numbers[at++];
  return LOD_OK;
}

static enum lod_status read_vertices(struct off *off) {
  struct lod_mesh *mesh = &off->mesh;
  const uint32_t count = off->vertex_count;
  LOD_TRY(lod_reader_add_vertices(off->reader, count));
  mesh->vertex_count = count;
  mesh->positions = lod_arena_alloc(off->reader->scratch, count, sizeof *mesh->positions);
  bool good = mesh->positions != NULL;
  if (off->has_normal)
    good &= (mesh->normals = lod_arena_calloc(off->reader->scratch, count, sizeof *mesh->normals)) != NULL;
  if (off->has_color)
    good &= (mesh->colors = lod_arena_calloc(off->reader->scratch, count, sizeof *mesh->colors)) != NULL;
  if (off->has_uv)
    good &= (mesh->uvs[0] = lod_arena_calloc(off->reader->scratch, count, sizeof *mesh->uvs[0])) != NULL;
  if (!good)
    return lod_reader_memory(off->reader);
  for (uint32_t v = 0; v < count; v++) {
    double numbers[NUMBERS];
    int used = 0;
    if (!find_next(off))
      return lod_reader_bad(off->reader, "truncated", "the file ends behind %u of its %u vertices", v, count);
    if (mesh->colors)
      mesh->colors[v][0] = mesh->colors[v][1] = mesh->colors[v][2] = mesh->colors[v][3] = -1; /* not said */
    while (used < NUMBERS && !is_line_over(off))
      if (!lod_number_read(&off->at, off->end, &numbers[used++]))
        return bad_line(off, "has a vertex that is not made of numbers");
    LOD_TRY(set_vertex(off, v, numbers, used));
    while (off->at < off->end && *off->at != '\n' && *off->at != '\r')
      off->at++;
  }
  const float scale = off->brightest > 1 ? 1.0f / 255 : 1;
  for (uint32_t v = 0; mesh->colors && v < count; v++)
    for (int i = 0; i < 4; i++) {
      const float value = mesh->colors[v][i], scaled = value < 0 ? (i == 3 ? 1 : 0) : fminf(value * scale, 1);
      mesh->colors[v][i] = i == 3 ? scaled : lod_linear_from_srgb(scaled);
    }
  return LOD_OK;
}

static enum lod_status read_face(struct off *off) {
  double value;
  if (!lod_number_read(&off->at, off->end, &value) || !(value >= 0) || value != floor(value))
    return bad_line(off, "has a face without a number of corners");
  if (value > (double)(off->end - off->at) / 2 + 1)
    return bad_line(off, "has a face with more corners than the file has bytes for");
  const uint32_t count = (uint32_t)value;
  uint32_t *corners = lod_polygons_begin(&off->polygons, off->reader, count);
  if (corners == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++) {
    if (!find_next(off))
      return lod_reader_bad(off->reader, "truncated", "the file ends within a face");
    if (!lod_number_read(&off->at, off->end, &value))
      return bad_line(off, "has a face with a corner that is no number");
    if (!(value >= 0) || value >= off->vertex_count || value != floor(value))
      return lod_reader_bad(off->reader, "index-out-of-range", "line %llu: a face names vertex %g of %u", (unsigned long long)off->line,
                            value, off->vertex_count);
    corners[i] = (uint32_t)value;
  }
  while (off->at < off->end && *off->at != '\n' && *off->at != '\r') /* its colour */
    off->at++;
  return lod_polygons_end(&off->polygons, off->reader, count);
}

enum lod_status lod_import_off(struct lod_reader *reader) {
  struct off off = {.reader = reader, .at = (const char *)reader->bytes, .end = (const char *)reader->bytes + reader->size, .line = 1};
  LOD_TRY(read_header(&off));
  LOD_TRY(read_vertices(&off));
  LOD_TRY(lod_polygons_init(&off.polygons, reader, off.face_count));
  for (uint32_t f = 0; f < off.face_count; f++) {
    if (!find_next(&off))
      return lod_reader_bad(reader, "truncated", "the file ends behind %u of its %u faces", f, off.face_count);
    LOD_TRY(read_face(&off));
  }
  if (find_next(&off))
    lod_scene_warn(reader->scene, "What follows the last face, from line %llu on, was ignored.", (unsigned long long)off.line);
  if (off.polygons.dropped > 0)
    lod_scene_warn(reader->scene, "%u faces with fewer than three corners were dropped.", off.polygons.dropped);
  struct lod_polygon_triangles triangles;
  LOD_TRY(lod_polygons_triangulate(&off.polygons, reader, off.mesh.positions, off.mesh.vertex_count, false, &triangles));
  off.mesh.triangles = triangles.triangles;
  off.mesh.triangle_count = triangles.count;
  LOD_TRY(lod_scene_share_index(&off.mesh, reader->scratch));
  struct lod_scene_part part = {.mesh = off.mesh, .rounding = sqrt(off.worst) * (1 + 0x1p-50)};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}
