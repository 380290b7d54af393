/* Text files of Bezier patches: .bpt (count; degrees and points a patch), Geomview's .bez and .bbp, SurfLab's BezierView .bv.
 *
 * Based on: Geomview manual, BEZ (BEZuvn: degrees u and v, dimension n; BBP is BEZ333); SurfLab, University of Florida: BezierView's data
 * format, 2003 (kinds 1: polyhedron, 3: triangular, 4: tensor of one degree, 5: of two, 8: rational of two, 9 and 10: triangular and tensor
 * with normals, which are left out). A polyhedron's face is an n-sided patch: of three corners a linear triangle, of four a bilinear
 * tensor, of more the triangles that cut it up. Degrees are checked before points are counted, and points against the bytes that are left
 * before memory is taken for them. */
#include <ctype.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/spline.h"
#include "core/mesh/triangulate.h"

struct text {
  struct lod_reader *reader;
  struct lod_splines splines;
  const char *at, *end;
  uint64_t line;
};

static void skip_blank(struct text *text) {
  while (text->at < text->end) {
    char c = *text->at;
    if (c == '#') {
      while (text->at < text->end && *text->at != '\n')
        text->at++;
    } else if (c == ' ' || (c >= '\t' && c <= '\r')) {
      text->line += c == '\n';
      text->at++;
    } else {
      return;
    }
  }
}

static bool at_end(struct text *text) {
  skip_blank(text);
  return text->at == text->end;
}

static enum lod_status next_number(struct text *text, const char *what, double *value) {
  if (at_end(text))
    return lod_reader_bad(text->reader, "truncated", "the file ends in line %llu where %s was expected", (unsigned long long)text->line,
                          what);
  if (!lod_number_read(&text->at, text->end, value))
    return lod_reader_bad(text->reader, "bad-syntax", "line %llu: expected %s", (unsigned long long)text->line, what);
  return LOD_OK;
}

static enum lod_status next_count(struct text *text, const char *what, double most, uint32_t *count) {
  double value;
  LOD_TRY(next_number(text, what, &value));
  if (!(value >= 0 && value <= most && value == (double)(uint32_t)value))
    return lod_reader_bad(text->reader, "bad-syntax", "line %llu: %s is %g; expected a whole number up to %g",
                          (unsigned long long)text->line, what, value, most);
  *count = (uint32_t)value;
  return LOD_OK;
}

static enum lod_status next_patch(struct text *text, bool triangle, const uint32_t degree[2], bool rational) {
  struct lod_reader *reader = text->reader;
  if (degree[0] < 1 || degree[1] < 1 || degree[0] > LOD_SPLINE_DEGREE || degree[1] > LOD_SPLINE_DEGREE)
    return lod_reader_fail(reader, LOD_UNSUPPORTED, "patch-degree", "line %llu has a patch of degree %u by %u; degrees 1 to %d are known",
                           (unsigned long long)text->line, degree[0], degree[1], LOD_SPLINE_DEGREE);
  uint32_t count = lod_spline_point_count(triangle, degree);
  size_t left = (size_t)(text->end - text->at);
  if (left < 6 * (size_t)count - 1)
    return lod_reader_bad(reader, "truncated", "the patch in line %llu needs %u points, for which there are not enough bytes",
                          (unsigned long long)text->line, count);
  struct lod_spline_point *points = LOD_NEW(reader->scratch, count, struct lod_spline_point);
  if (!points)
    return lod_reader_memory(reader);
  for (uint32_t i = 0; i < count; i++) {
    double x[4] = {0, 0, 0, 1};
    for (int axis = 0; axis < (rational ? 4 : 3); axis++)
      LOD_TRY(next_number(text, axis == 3 ? "a weight" : "a coordinate", &x[axis]));
    points[i] = (struct lod_spline_point){x[0], x[1], x[2], x[3]};
  }
  return lod_splines_add(&text->splines, triangle, degree, points, text->line);
}

static enum lod_status read_bpt(struct text *text) {
  uint32_t count = 0;
  LOD_TRY(next_count(text, "the number of patches", 4e9, &count));
  for (uint32_t p = 0; p < count; p++) {
    uint32_t degree[2] = {0, 0};
    if (at_end(text))
      return lod_reader_bad(text->reader, "truncated", "the file promises %u patches and ends in line %llu after %u", count,
                            (unsigned long long)text->line, p);
    for (int i = 0; i < 2; i++)
      LOD_TRY(next_count(text, "a degree", 1000, &degree[i]));
    LOD_TRY(next_patch(text, false, degree, false));
  }
  if (!at_end(text))
    lod_scene_warn(text->reader->scene, "What follows the %u patches that the file promises, from line %llu on, was ignored.", count,
                   (unsigned long long)text->line);
  return LOD_OK;
}

/* [C][ST]BEZuvn[_ST] or [C][ST]BBP */
static enum lod_status read_bez(struct text *text) {
  skip_blank(text);
  const char *word = text->at;
  while (text->at < text->end && isalnum((unsigned char)*text->at))
    text->at++;
  size_t length = (size_t)(text->at - word);
  uint32_t degree[2] = {3, 3}, dimension = 3;
  bool colours = false, uv = text->end - text->at >= 3 && memcmp(text->at, "_ST", 3) == 0;
  if (uv)
    text->at += 3;
  if (length > 0 && *word == 'C') {
    colours = true;
    word++, length--;
  }
  if (length > 1 && word[0] == 'S' && word[1] == 'T') {
    uv = true;
    word += 2, length -= 2;
  }
  if (length == 6 && strncmp(word, "BEZ", 3) == 0 && isdigit((unsigned char)word[3]) && isdigit((unsigned char)word[4]) &&
      isdigit((unsigned char)word[5])) {
    degree[0] = (uint32_t)(word[3] - '0');
    degree[1] = (uint32_t)(word[4] - '0');
    dimension = (uint32_t)(word[5] - '0');
  } else if (length != 3 || strncmp(word, "BBP", 3) != 0) {
    return lod_reader_bad(text->reader, "bad-syntax", "line %llu: expected BBP or BEZ with two degrees and a dimension",
                          (unsigned long long)text->line);
  }
  if (dimension != 3 && dimension != 4)
    return lod_reader_fail(text->reader, LOD_UNSUPPORTED, "patch-dimension", "points of %u coordinates are not known; 3 and 4 are",
                           dimension);
  while (!at_end(text)) {
    uint32_t swapped[2] = {degree[1], degree[0]}; /* u runs fastest */
    double ignored;
    LOD_TRY(next_patch(text, false, swapped, dimension == 4));
    for (int i = 0; i < (uv ? 8 : 0) + (colours ? 16 : 0); i++)
      LOD_TRY(next_number(text, "a texture coordinate or colour", &ignored));
  }
  return LOD_OK;
}

struct polyhedron {
  struct lod_vec3 *points;
  float (*positions)[3]; /* the same, for triangulation */
  uint32_t count;
};

static enum lod_status add_flat(struct text *text, const struct polyhedron *solid, bool triangle, const uint32_t *corners) {
  static const uint32_t kLinear[2] = {1, 1};
  uint32_t count = lod_spline_point_count(triangle, kLinear);
  struct lod_spline_point *points = LOD_NEW(text->reader->scratch, count, struct lod_spline_point);
  if (!points)
    return lod_reader_memory(text->reader);
  for (uint32_t i = 0; i < count; i++)
    points[i] = (struct lod_spline_point){solid->points[corners[i]].x, solid->points[corners[i]].y, solid->points[corners[i]].z, 1};
  return lod_splines_add(&text->splines, triangle, kLinear, points, text->line);
}

static enum lod_status read_face(struct text *text, const struct polyhedron *solid) {
  struct lod_reader *reader = text->reader;
  uint32_t size = 0;
  LOD_TRY(next_count(text, "the number of a face's corners", 1e6, &size));
  if (size < 3 || (size_t)(text->end - text->at) < 2 * (size_t)size - 1)
    return lod_reader_bad(reader, size < 3 ? "bad-syntax" : "truncated", "line %llu has a face of %u corners, which %s",
                          (unsigned long long)text->line, size, size < 3 ? "is none" : "there are not enough bytes for");
  uint32_t *corners = LOD_NEW(reader->scratch, size, uint32_t);
  if (!corners)
    return lod_reader_memory(reader);
  for (uint32_t i = 0; i < size; i++) {
    LOD_TRY(next_count(text, "a vertex of a face", 4e9, &corners[i]));
    if (corners[i] >= solid->count)
      return lod_reader_bad(reader, "index-out-of-range", "line %llu names vertex %u of %u", (unsigned long long)text->line, corners[i],
                            solid->count);
  }
  if (size == 4) { /* around the face: (0, 0), (1, 0), (1, 1), (0, 1) */
    const uint32_t rows[4] = {corners[0], corners[3], corners[1], corners[2]};
    return add_flat(text, solid, false, rows);
  }
  uint32_t(*triangles)[3] = lod_arena_alloc(reader->scratch, size - 2, sizeof *triangles);
  if (!triangles ||
      lod_triangulate_polygon((const float(*)[3])solid->positions, corners, &size, 1, reader->scratch, triangles, NULL) != LOD_OK)
    return lod_reader_memory(reader);
  for (uint32_t t = 0; t < size - 2; t++) { /* a patch's first row runs against its far corner's turn: spline.h */
    const uint32_t cut[3] = {corners[triangles[t][2]], corners[triangles[t][1]], corners[triangles[t][0]]};
    LOD_TRY(add_flat(text, solid, true, cut));
  }
  return LOD_OK;
}

static enum lod_status read_polyhedron(struct text *text) {
  struct lod_reader *reader = text->reader;
  struct polyhedron solid = {0};
  uint32_t faces = 0;
  LOD_TRY(next_count(text, "the number of vertices", 4e9, &solid.count));
  LOD_TRY(next_count(text, "the number of faces", 4e9, &faces));
  if ((size_t)(text->end - text->at) / 6 + 1 < (size_t)solid.count || (size_t)(text->end - text->at) / 8 < (size_t)faces)
    return lod_reader_bad(reader, "truncated",
                          "the polyhedron in line %llu has %u vertices and %u faces, for which there are not enough bytes",
                          (unsigned long long)text->line, solid.count, faces);
  solid.points = LOD_NEW(reader->scratch, (size_t)solid.count + 1, struct lod_vec3);
  solid.positions = lod_arena_alloc(reader->scratch, (size_t)solid.count + 1, sizeof *solid.positions);
  if (!solid.points || !solid.positions)
    return lod_reader_memory(reader);
  for (uint32_t v = 0; v < solid.count; v++) {
    double x[3];
    for (int axis = 0; axis < 3; axis++) {
      LOD_TRY(next_number(text, "a coordinate", &x[axis]));
      if (!(x[axis] > -1e30 && x[axis] < 1e30))
        return lod_reader_bad(reader, "non-finite", "line %llu has a coordinate that is not a finite number",
                              (unsigned long long)text->line);
    }
    solid.points[v] = (struct lod_vec3){x[0], x[1], x[2]};
    lod_vec3_to_float(solid.points[v], solid.positions[v]);
  }
  for (uint32_t f = 0; f < faces; f++)
    LOD_TRY(read_face(text, &solid));
  return LOD_OK;
}

/* Kinds 9 and 10 give normals of degrees of their own behind the points: what the points say is the surface. */
static enum lod_status skip_normals(struct text *text, bool triangle, const uint32_t degree[2]) {
  double ignored;
  for (uint32_t i = 0, count = 3 * lod_spline_point_count(triangle, degree); i < count; i++)
    LOD_TRY(next_number(text, "a normal", &ignored));
  return LOD_OK;
}

static enum lod_status read_bv_patch(struct text *text, uint32_t kind) {
  bool two = kind == 5 || kind == 8 || kind == 10, triangle = kind == 3 || kind == 9, has_normals = kind >= 9;
  uint32_t degree[2] = {0, 0}, normal[2] = {0, 0};
  LOD_TRY(next_count(text, "a degree", 1000, &degree[0]));
  degree[1] = degree[0];
  if (two)
    LOD_TRY(next_count(text, "a degree", 1000, &degree[1]));
  for (int i = 0; has_normals && i < (two ? 2 : 1); i++) {
    LOD_TRY(next_count(text, "a degree of normals", 100, &normal[i]));
    normal[1] = i == 0 ? normal[0] : normal[1];
  }
  LOD_TRY(next_patch(text, triangle, degree, kind == 8));
  return has_normals ? skip_normals(text, triangle, normal) : LOD_OK;
}

static enum lod_status read_bv(struct text *text) {
  while (!at_end(text)) {
    if (isalpha((unsigned char)*text->at)) { /* "Group 3 name" */
      while (text->at < text->end && *text->at != '\n')
        text->at++;
      continue;
    }
    uint32_t kind = 0;
    LOD_TRY(next_count(text, "a kind of patch", 1000, &kind));
    if (kind == 1)
      LOD_TRY(read_polyhedron(text));
    else if (kind == 3 || kind == 4 || kind == 5 || kind == 8 || kind == 9 || kind == 10)
      LOD_TRY(read_bv_patch(text, kind));
    else
      return lod_reader_fail(text->reader, LOD_UNSUPPORTED, "patch-kind",
                             "line %llu: patches of kind %u are not read; 1, 3, 4, 5, 8, 9 and 10 are", (unsigned long long)text->line,
                             kind);
  }
  return LOD_OK;
}

enum lod_status lod_import_patches(struct lod_reader *reader) {
  struct text text = {.reader = reader,
                      .splines = {.reader = reader},
                      .at = (const char *)reader->bytes,
                      .end = (const char *)reader->bytes + reader->size,
                      .line = 1};
  if (strcmp(reader->format, "bpt") == 0)
    LOD_TRY(read_bpt(&text));
  else if (strcmp(reader->format, "bv") == 0)
    LOD_TRY(read_bv(&text));
  else
    LOD_TRY(read_bez(&text));
  return lod_splines_finish(&text.splines);
}
