/* Text files of Bezier patches: .bpt (count; degrees and points a patch), Geomview's .bez and .bbp, SurfLab's BezierView .bv.
 *
 * Based on: Geomview manual, BEZ (BEZuvn: degrees u and v, dimension n; BBP is BEZ333); BezierView file format (kinds 1: polyhedron, 3:
 * triangular, 4: tensor of one degree, 5: of two, 8: rational of two). Degrees are checked before points are counted, and points against
 * the bytes that are left before memory is taken for them. */
#include <ctype.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/spline.h"

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

/* [C][ST]BEZuvn or [C][ST]BBP */
static enum lod_status read_bez(struct text *text) {
  skip_blank(text);
  const char *word = text->at;
  while (text->at < text->end && isalnum((unsigned char)*text->at))
    text->at++;
  size_t length = (size_t)(text->at - word);
  uint32_t degree[2] = {3, 3}, dimension = 3;
  bool colours = false, uv = false;
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

static enum lod_status skip_polyhedron(struct text *text) {
  return lod_reader_fail(text->reader, LOD_UNSUPPORTED, "patch-kind", "line %llu: polyhedra (kind 1) in BezierView files are not read",
                         (unsigned long long)text->line);
}

static enum lod_status read_bv(struct text *text) {
  while (!at_end(text)) {
    if (isalpha((unsigned char)*text->at)) { /* "Group 3 name" */
      while (text->at < text->end && *text->at != '\n')
        text->at++;
      continue;
    }
    uint32_t kind = 0, degree[2] = {0, 0};
    LOD_TRY(next_count(text, "a kind of patch", 1000, &kind));
    if (kind == 1)
      return skip_polyhedron(text);
    if (kind != 3 && kind != 4 && kind != 5 && kind != 8)
      return lod_reader_fail(text->reader, LOD_UNSUPPORTED, "patch-kind", "line %llu: patches of kind %u are not read; 3, 4, 5 and 8 are",
                             (unsigned long long)text->line, kind);
    LOD_TRY(next_count(text, "a degree", 1000, &degree[0]));
    degree[1] = degree[0];
    if (kind == 5 || kind == 8)
      LOD_TRY(next_count(text, "a degree", 1000, &degree[1]));
    LOD_TRY(next_patch(text, kind == 3, degree, kind == 8));
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
