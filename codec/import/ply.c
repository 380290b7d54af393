/* PLY 1.0, all three encodings, any property types: polygons, triangle strips, edges; normals, UVs and colours of vertices, UVs of corners,
 * colours of faces. Elements and properties with other names are skipped.
 *
 * Based on: Turk. The PLY Polygon File Format. 1994; names of UV and strip properties as MeshLab, Blender and plyfile write them.
 *
 * Rows are read in the order of the file, each value once. Before anything is allocated, an element's count is compared with the bytes that
 * are left: a row has a least size. Colours count as sRGB (scanners and viewers agree) and are made linear; v of a UV points up in PLY and
 * down in glTF, so it is flipped. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/polygons.h"
#include "codec/import/reader.h"

enum { kMaxElements = 32, kMaxProperties = 256, kMaxName = 48 };

enum encoding { kAscii, kLittle, kBig };

enum type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64, kNoType };
static const uint8_t kSizes[] = {1, 1, 2, 2, 4, 4, 4, 8, 0};
static const struct {
  const char *name;
  enum type type;
} kTypes[] = {
    {"char", kInt8},     {"uchar", kUint8},    {"short", kInt16},     {"ushort", kUint16},   {"int", kInt32},   {"uint", kUint32},
    {"int8", kInt8},     {"uint8", kUint8},    {"int16", kInt16},     {"uint16", kUint16},   {"int32", kInt32}, {"uint32", kUint32},
    {"float", kFloat32}, {"double", kFloat64}, {"float32", kFloat32}, {"float64", kFloat64},
};

/* What a property means. Vertex scalars, then face properties. */
enum meaning {
  kX,
  kY,
  kZ,
  kNormalX,
  kNormalY,
  kNormalZ,
  kU,
  kV,
  kRed,
  kGreen,
  kBlue,
  kAlpha,
  kInterest,
  kEpsilon,
  kScalarMeanings,
  kIndices = kScalarMeanings,
  kTexcoord,
  kVertex1,
  kVertex2,
  kNoMeaning
};
static const struct {
  const char *name;
  enum meaning meaning;
} kMeanings[] = {
    {"x", kX},
    {"y", kY},
    {"z", kZ},
    {"nx", kNormalX},
    {"ny", kNormalY},
    {"nz", kNormalZ},
    {"s", kU},
    {"u", kU},
    {"texture_u", kU},
    {"texture_s", kU},
    {"t", kV},
    {"v", kV},
    {"texture_v", kV},
    {"texture_t", kV},
    {"red", kRed},
    {"green", kGreen},
    {"blue", kBlue},
    {"alpha", kAlpha},
    {"r", kRed},
    {"g", kGreen},
    {"b", kBlue},
    {"a", kAlpha},
    {"doi", kInterest},
    {"interest", kInterest},
    {"diffuse_red", kRed},
    {"diffuse_green", kGreen},
    {"diffuse_blue", kBlue},
    {"diffuse_alpha", kAlpha},
    {"epsilon", kEpsilon},
    {"vertex_indices", kIndices},
    {"vertex_index", kIndices},
    {"texcoord", kTexcoord},
    {"vertex1", kVertex1},
    {"vertex2", kVertex2},
};

struct property {
  enum type type, count_type; /* count_type: kNoType for scalars */
  enum meaning meaning;
};

struct element {
  char name[kMaxName];
  uint64_t count;
  uint32_t first, property_count;
  bool has_list;
};

struct ply {
  struct lod_reader *reader;
  enum encoding encoding;
  const uint8_t *at, *end;
  uint32_t line; /* of the header */

  struct element elements[kMaxElements];
  struct property properties[kMaxProperties];
  uint32_t element_count, property_count;
  char texture[256]; /* "comment TextureFile name" */

  struct lod_mesh mesh;
  bool have_vertices, has_interest;
  double rounding;
  struct lod_polygons polygons;
  uint32_t polygon_capacity; /* of the two arrays below */
  float (*face_colors)[4];   /* a row per polygon kept, or NULL */
  float (*corner_uvs)[2];    /* a row per corner kept, or NULL */
  uint32_t corner_uv_capacity;
  struct lod_polygons strips; /* triangles of tristrips */
  uint32_t *row;              /* scratch for one list */
  uint32_t row_capacity;
};

/* --- header --- */

static enum lod_status bad_header(struct ply *ply, const char *what) {
  return lod_reader_bad(ply->reader, "bad-header", "line %u of the PLY header %s", ply->line, what);
}

/* Copies the next header line without its end into `line`; lines end with \n, \r\n or \r. */
static enum lod_status next_line(struct ply *ply, char line[256]) {
  size_t n = 0;
  ply->line++;
  while (ply->at < ply->end && *ply->at != '\n' && *ply->at != '\r') {
    if (*ply->at == 0)
      return bad_header(ply, "holds a NUL byte");
    if (n < 255)
      line[n++] = (char)*ply->at;
    ply->at++;
  }
  line[n] = 0;
  if (ply->at == ply->end)
    return lod_reader_bad(ply->reader, "truncated", "the file ends within its PLY header; expected end_header");
  bool carriage = *ply->at++ == '\r';
  /* A binary body may start with 0x0A, but then no writer ends lines with a lone \r. */
  if (carriage && ply->at < ply->end && *ply->at == '\n')
    ply->at++;
  return LOD_OK;
}

static enum type type_of(const char *name) {
  for (size_t i = 0; i < sizeof kTypes / sizeof *kTypes; i++)
    if (strcmp(name, kTypes[i].name) == 0)
      return kTypes[i].type;
  return kNoType;
}

static enum meaning meaning_of(const char *name) {
  for (size_t i = 0; i < sizeof kMeanings / sizeof *kMeanings; i++)
    if (strcmp(name, kMeanings[i].name) == 0)
      return kMeanings[i].meaning;
  return kNoMeaning;
}

static enum lod_status read_element_line(struct ply *ply, const char *line) {
  struct element *element = &ply->elements[ply->element_count];
  if (ply->element_count == kMaxElements)
    return bad_header(ply, "has more elements than the 32 that are supported");
  char digits[24];
  if (sscanf(line, "element %47s %23[0-9]", element->name, digits) != 2 || strlen(digits) > 18)
    return bad_header(ply, "is no 'element NAME COUNT'");
  element->count = 0;
  for (const char *p = digits; *p; p++)
    element->count = element->count * 10 + (uint64_t)(*p - '0');
  element->first = ply->property_count;
  ply->element_count++;
  return LOD_OK;
}

static enum lod_status read_property_line(struct ply *ply, const char *line) {
  if (ply->element_count == 0)
    return bad_header(ply, "has a property before any element");
  if (ply->property_count == kMaxProperties)
    return bad_header(ply, "has more properties than the 256 that are supported");
  struct property *property = &ply->properties[ply->property_count];
  struct element *element = &ply->elements[ply->element_count - 1];
  char count[kMaxName], type[kMaxName], name[kMaxName];
  *property = (struct property){.count_type = kNoType};
  if (sscanf(line, "property list %47s %47s %47s", count, type, name) == 3) {
    property->count_type = type_of(count);
    element->has_list = true;
    if (property->count_type == kNoType || property->count_type >= kFloat32)
      return bad_header(ply, "counts a list with a type that is no integer");
  } else if (sscanf(line, "property %47s %47s", type, name) != 2) {
    return bad_header(ply, "is no 'property TYPE NAME'");
  }
  property->type = type_of(type);
  property->meaning = meaning_of(name);
  if (property->type == kNoType)
    return bad_header(ply, "names an unknown type");
  bool list = property->count_type != kNoType, list_meaning = property->meaning == kIndices || property->meaning == kTexcoord;
  if (list != list_meaning)
    property->meaning = kNoMeaning;
  element->property_count++;
  ply->property_count++;
  return LOD_OK;
}

static enum lod_status read_format_line(struct ply *ply, const char *line) {
  char encoding[32], version[16];
  if (sscanf(line, "format %31s %15s", encoding, version) != 2)
    return bad_header(ply, "is no 'format ENCODING VERSION'");
  if (strcmp(encoding, "ascii") == 0)
    ply->encoding = kAscii;
  else if (strcmp(encoding, "binary_little_endian") == 0)
    ply->encoding = kLittle;
  else if (strcmp(encoding, "binary_big_endian") == 0)
    ply->encoding = kBig;
  else
    return bad_header(ply, "names an unknown encoding; expected ascii, binary_little_endian or binary_big_endian");
  if (strcmp(version, "1.0") != 0)
    return lod_reader_fail(ply->reader, LOD_UNSUPPORTED, "unsupported-version", "PLY version %s; only 1.0 exists", version);
  return LOD_OK;
}

static enum lod_status read_header(struct ply *ply) {
  char line[256];
  bool have_format = false;
  LOD_TRY(next_line(ply, line));
  if (strncmp(line, "ply", 3) != 0)
    return bad_header(ply, "is not 'ply'");
  for (;;) {
    LOD_TRY(next_line(ply, line));
    char word[16] = "";
    sscanf(line, "%15s", word);
    if (strcmp(word, "end_header") == 0)
      break;
    if (strcmp(word, "format") == 0) {
      LOD_TRY(read_format_line(ply, line));
      have_format = true;
    } else if (strcmp(word, "element") == 0) {
      LOD_TRY(read_element_line(ply, line));
    } else if (strcmp(word, "property") == 0) {
      LOD_TRY(read_property_line(ply, line));
    } else if (strcmp(word, "comment") == 0) {
      sscanf(line, "comment TextureFile %255[^\r\n]", ply->texture);
    } else if (word[0] && strcmp(word, "obj_info") != 0) {
      return bad_header(ply, "starts with an unknown word; expected format, element, property, comment, obj_info or end_header");
    }
  }
  return have_format ? LOD_OK : bad_header(ply, "ends a header without a format line");
}

/* --- values --- */

static uint16_t load16(const uint8_t *p, bool big) {
  return (uint16_t)(big ? p[0] << 8 | p[1] : p[1] << 8 | p[0]);
}
static uint32_t load32(const uint8_t *p, bool big) {
  return big ? (uint32_t)load16(p, true) << 16 | load16(p + 2, true) : (uint32_t)load16(p + 2, false) << 16 | load16(p, false);
}

static double load(const uint8_t *p, enum type type, bool big) {
  switch (type) {
  case kInt8:
    return (int8_t)p[0];
  case kUint8:
    return p[0];
  case kInt16:
    return (int16_t)load16(p, big);
  case kUint16:
    return load16(p, big);
  case kInt32:
    return (int32_t)load32(p, big);
  case kUint32:
    return load32(p, big);
  case kFloat32: {
    uint32_t bits = load32(p, big);
    float value;
    memcpy(&value, &bits, sizeof value);
    return (double)value;
  }
  default: {
    uint64_t high = load32(p, big), low = load32(p + 4, big), bits = big ? high << 32 | low : low << 32 | high;
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
  }
  }
}

static enum lod_status truncated(struct ply *ply, const struct element *element, uint64_t row) {
  return lod_reader_bad(ply->reader, "truncated", "the file ends in row %llu of the %llu rows that the header promises for '%s'",
                        (unsigned long long)row, (unsigned long long)element->count, element->name);
}

/* The next value of either encoding. */
static enum lod_status next_value(struct ply *ply, const struct element *element, uint64_t row, enum type type, double *value) {
  if (ply->encoding == kAscii) {
    const char *at = (const char *)ply->at, *end = (const char *)ply->end;
    lod_number_skip_space(&at, end);
    if (at == end)
      return truncated(ply, element, row);
    if (!lod_number_read(&at, end, value))
      return lod_reader_bad(ply->reader, "bad-number", "row %llu of '%s' holds something that is no number", (unsigned long long)row,
                            element->name);
    ply->at = (const uint8_t *)at;
    return LOD_OK;
  }
  if ((size_t)(ply->end - ply->at) < kSizes[type])
    return truncated(ply, element, row);
  *value = load(ply->at, type, ply->encoding == kBig);
  ply->at += kSizes[type];
  return LOD_OK;
}

/* A list's length: at most what the bytes that are left can hold. */
static enum lod_status next_count(struct ply *ply, const struct element *element, uint64_t row, const struct property *property,
                                  uint32_t *count) {
  double value = 0;
  LOD_TRY(next_value(ply, element, row, property->count_type, &value));
  size_t least = ply->encoding == kAscii ? 1 : kSizes[property->type];
  if (!(value >= 0) || value != floor(value) || value > 4e9)
    return lod_reader_bad(ply->reader, "bad-number", "row %llu of '%s' has a list of %g values", (unsigned long long)row, element->name,
                          value);
  if ((uint64_t)value > (uint64_t)(ply->end - ply->at) / least)
    return truncated(ply, element, row);
  *count = (uint32_t)value;
  return LOD_OK;
}

static enum lod_status skip_property(struct ply *ply, const struct element *element, uint64_t row, const struct property *property) {
  uint32_t count = 1;
  double ignored;
  if (property->count_type != kNoType)
    LOD_TRY(next_count(ply, element, row, property, &count));
  for (uint32_t i = 0; i < count; i++)
    LOD_TRY(next_value(ply, element, row, property->type, &ignored));
  return LOD_OK;
}

/* Every row takes at least so many bytes. */
static enum lod_status check_count(struct ply *ply, const struct element *element) {
  uint64_t least = 0;
  for (uint32_t i = 0; i < element->property_count; i++) {
    const struct property *property = &ply->properties[element->first + i];
    enum type type = property->count_type != kNoType ? property->count_type : property->type;
    least += ply->encoding == kAscii ? 2 : kSizes[type];
  }
  if (element->count > 0 && least == 0)
    return lod_reader_bad(ply->reader, "bad-header", "element '%s' has rows but no property", element->name);
  uint64_t left = (uint64_t)(ply->end - ply->at) + (ply->encoding == kAscii);
  if (least > 0 && element->count > left / least)
    return lod_reader_bad(ply->reader, "truncated", "the header promises %llu rows of '%s', but only %llu bytes are left",
                          (unsigned long long)element->count, element->name, (unsigned long long)left);
  return LOD_OK;
}

/* --- vertices --- */

static float color_scale(enum type type) {
  static const float scales[] = {1 / 127.0f, 1 / 255.0f, 1 / 32767.0f, 1 / 65535.0f, 1 / 255.0f, 1 / 255.0f, 1, 1, 1};
  return scales[type];
}

static float color_from(double value, enum type type, bool alpha) {
  float scaled = (float)value * color_scale(type);
  scaled = scaled >= 0 ? fminf(scaled, 1) : 0;
  return alpha ? scaled : lod_linear_from_srgb(scaled);
}

static const struct property *find(const struct ply *ply, const struct element *element, enum meaning meaning) {
  for (uint32_t i = 0; i < element->property_count; i++)
    if (ply->properties[element->first + i].meaning == meaning)
      return &ply->properties[element->first + i];
  return NULL;
}

static enum lod_status allocate_vertices(struct ply *ply, const struct element *element) {
  struct lod_mesh *mesh = &ply->mesh;
  struct lod_arena *arena = ply->reader->scratch;
  for (enum meaning m = kX; m <= kZ; m++)
    if (!find(ply, element, m))
      return lod_reader_bad(ply->reader, "bad-header", "element vertex lacks property %c", "xyz"[m - kX]);
  LOD_TRY(lod_reader_add_vertices(ply->reader, element->count));
  mesh->vertex_count = (uint32_t)element->count;
  bool ok = (mesh->positions = lod_arena_alloc(arena, element->count, sizeof *mesh->positions)) != NULL;
  if (find(ply, element, kNormalX) && find(ply, element, kNormalY) && find(ply, element, kNormalZ))
    ok = ok && (mesh->normals = lod_arena_calloc(arena, element->count, sizeof *mesh->normals)) != NULL;
  if (find(ply, element, kU) && find(ply, element, kV))
    ok = ok && (mesh->uvs[0] = lod_arena_calloc(arena, element->count, sizeof *mesh->uvs[0])) != NULL;
  if ((find(ply, element, kRed) && find(ply, element, kGreen) && find(ply, element, kBlue)) || find(ply, element, kInterest))
    ok = ok && (mesh->colors = lod_arena_calloc(arena, element->count, sizeof *mesh->colors)) != NULL;
  if (find(ply, element, kEpsilon))
    ok = ok && (mesh->limits = lod_arena_calloc(arena, element->count, sizeof *mesh->limits)) != NULL;
  if (!ok)
    return lod_reader_memory(ply->reader);
  ply->has_interest = find(ply, element, kInterest) != NULL;
  for (uint32_t v = 0; mesh->colors && v < mesh->vertex_count; v++)
    mesh->colors[v][0] = mesh->colors[v][1] = mesh->colors[v][2] = mesh->colors[v][3] = 1;
  return LOD_OK;
}

/* How far storing `value` as a float moves it, parsing of decimals included. Text of a property declared float says which float it means.
 */
static double rounding_of(const struct ply *ply, double value, enum type type) {
  if (type == kFloat32)
    return 0;
  return fabs(value - (double)(float)value) + (ply->encoding == kAscii ? 0x1p-53 * fabs(value) : 0);
}

static void store_scalar(struct ply *ply, uint32_t v, const struct property *property, double value, double *moved) {
  struct lod_mesh *mesh = &ply->mesh;
  enum meaning m = property->meaning;
  if (m <= kZ) {
    double off = rounding_of(ply, value, property->type);
    mesh->positions[v][m - kX] = (float)value;
    *moved += off * off;
  } else if (m <= kNormalZ) {
    if (mesh->normals)
      mesh->normals[v][m - kNormalX] = (float)value;
  } else if (m <= kV) {
    if (mesh->uvs[0])
      mesh->uvs[0][v][m - kU] = m == kV ? (float)(1 - value) : (float)value;
  } else if (m == kEpsilon) {
    mesh->limits[v] = (float)value; /* cleaned with the part */
  } else if (m == kInterest) {      /* travels as alpha: gltf_mesh.c says why */
    mesh->colors[v][3] = color_from(value, property->type, true);
  } else if (m == kAlpha && ply->has_interest) {
    return;
  } else if (m <= kAlpha && mesh->colors) {
    mesh->colors[v][m - kRed] = color_from(value, property->type, m == kAlpha);
  }
}

/* Only x y z as floats, perhaps with other scalars that are skipped: the common scan, one copy a vertex. */
static bool read_plain_positions(struct ply *ply, const struct element *element) {
  size_t stride = 0, offset = 0;
  enum meaning expected = kX;
  for (uint32_t i = 0; i < element->property_count; i++) {
    const struct property *property = &ply->properties[element->first + i];
    if (property->count_type != kNoType)
      return false;
    if (property->meaning <= kZ) {
      if (property->type != kFloat32 || property->meaning != expected)
        return false;
      if (expected++ == kX)
        offset = stride;
      else if (stride != offset + 4 * (size_t)property->meaning)
        return false;
    } else if (property->meaning < kScalarMeanings) {
      return false;
    }
    stride += kSizes[property->type];
  }
  if (ply->encoding != kLittle || (uint64_t)(ply->end - ply->at) / stride < element->count)
    return false;
  const uint32_t probe = 1;
  if (*(const uint8_t *)&probe != 1)
    return false;
  for (uint32_t v = 0; v < ply->mesh.vertex_count; v++, ply->at += stride)
    memcpy(ply->mesh.positions[v], ply->at + offset, sizeof ply->mesh.positions[v]);
  return true;
}

static enum lod_status read_vertices(struct ply *ply, const struct element *element) {
  if (ply->have_vertices)
    return lod_reader_bad(ply->reader, "bad-header", "there are two vertex elements");
  LOD_TRY(allocate_vertices(ply, element));
  ply->have_vertices = true;
  if (read_plain_positions(ply, element))
    return LOD_OK;
  double worst = 0;
  for (uint32_t v = 0; v < ply->mesh.vertex_count; v++) {
    double moved = 0;
    for (uint32_t i = 0; i < element->property_count; i++) {
      const struct property *property = &ply->properties[element->first + i];
      if (property->meaning >= kScalarMeanings) {
        LOD_TRY(skip_property(ply, element, v, property));
        continue;
      }
      double value = 0;
      LOD_TRY(next_value(ply, element, v, property->type, &value));
      store_scalar(ply, v, property, value, &moved);
    }
    /* NaN and infinity are found later, where it is known whether the vertex is used. */
    if (isfinite(moved))
      worst = fmax(worst, moved);
  }
  ply->rounding = sqrt(worst) * (1 + 0x1p-50);
  return LOD_OK;
}

/* --- faces --- */

static enum lod_status to_index(struct ply *ply, const struct element *element, uint64_t row, double value, uint32_t *index) {
  if (!(value >= 0) || value >= 4294967295.0 || value != floor(value))
    return lod_reader_bad(ply->reader, "index-out-of-range", "row %llu of '%s' refers to vertex %g", (unsigned long long)row, element->name,
                          value);
  *index = (uint32_t)value;
  return LOD_OK;
}

/* Rows of one uchar list of 32-bit indices and nothing else, as nearly all files have: 13 bytes a triangle. Stops at the first row that is
 * no whole triangle; the general loop goes on from there. */
static uint64_t read_plain_triangles(struct ply *ply, const struct element *element) {
  const struct property *property = &ply->properties[element->first];
  bool plain = element->property_count == 1 && property->meaning == kIndices && kSizes[property->count_type] == 1 &&
               (property->type == kInt32 || property->type == kUint32) && ply->encoding != kAscii;
  if (!plain)
    return 0;
  uint64_t row = 0;
  uint32_t *out = ply->polygons.corners;
  bool big = ply->encoding == kBig;
  for (; row < element->count && ply->end - ply->at >= 13 && ply->at[0] == 3; row++, ply->at += 13)
    for (int k = 0; k < 3; k++)
      *out++ = load32(ply->at + 1 + 4 * k, big);
  ply->polygons.polygon_count = (uint32_t)row;
  ply->polygons.corner_count = (uint32_t)row * 3;
  return row;
}

static enum lod_status read_face_indices(struct ply *ply, const struct element *element, uint64_t row, const struct property *property,
                                         uint32_t *count) {
  LOD_TRY(next_count(ply, element, row, property, count));
  uint32_t *corners = lod_polygons_begin(&ply->polygons, ply->reader, *count);
  if (!corners)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < *count; i++) {
    double value = 0;
    LOD_TRY(next_value(ply, element, row, property->type, &value));
    LOD_TRY(to_index(ply, element, row, value, &corners[i]));
  }
  return LOD_OK;
}

static enum lod_status read_face_uvs(struct ply *ply, const struct element *element, uint64_t row, const struct property *property,
                                     uint32_t first_corner) {
  uint32_t count;
  LOD_TRY(next_count(ply, element, row, property, &count));
  uint64_t wanted = (uint64_t)first_corner + count / 2;
  if (wanted > ply->corner_uv_capacity) {
    uint64_t capacity = wanted + wanted / 2 + 64;
    float(*uvs)[2] = capacity < UINT32_MAX ? lod_arena_calloc(ply->reader->scratch, capacity, sizeof *uvs) : NULL;
    if (!uvs)
      return lod_reader_memory(ply->reader);
    if (ply->corner_uvs)
      memcpy(uvs, ply->corner_uvs, ply->corner_uv_capacity * sizeof *uvs);
    ply->corner_uvs = uvs;
    ply->corner_uv_capacity = (uint32_t)capacity;
  }
  for (uint32_t i = 0; i < count; i++) {
    double value = 0;
    LOD_TRY(next_value(ply, element, row, property->type, &value));
    if (i / 2 < count / 2)
      ply->corner_uvs[first_corner + i / 2][i % 2] = i % 2 ? (float)(1 - value) : (float)value;
  }
  return LOD_OK;
}

static enum lod_status read_face(struct ply *ply, const struct element *element, uint64_t row) {
  uint32_t count = 0, polygon = ply->polygons.polygon_count, first_corner = ply->polygons.corner_count;
  for (uint32_t i = 0; i < element->property_count; i++) {
    const struct property *property = &ply->properties[element->first + i];
    double value = 0;
    if (property->meaning == kIndices) {
      LOD_TRY(read_face_indices(ply, element, row, property, &count));
    } else if (property->meaning == kTexcoord) {
      LOD_TRY(read_face_uvs(ply, element, row, property, first_corner));
    } else if (property->count_type == kNoType && property->meaning >= kRed && property->meaning <= kAlpha && ply->face_colors) {
      LOD_TRY(next_value(ply, element, row, property->type, &value));
      ply->face_colors[polygon][property->meaning - kRed] = color_from(value, property->type, property->meaning == kAlpha);
    } else {
      LOD_TRY(skip_property(ply, element, row, property));
    }
  }
  return lod_polygons_end(&ply->polygons, ply->reader, count);
}

static enum lod_status read_faces(struct ply *ply, const struct element *element) {
  if (ply->polygons.corners)
    return lod_reader_bad(ply->reader, "bad-header", "there are two face elements");
  if (!find(ply, element, kIndices))
    return lod_reader_bad(ply->reader, "bad-header", "element face lacks the list vertex_indices");
  if (element->count > ply->reader->limits.max_triangles)
    return lod_reader_add_triangles(ply->reader, element->count);
  LOD_TRY(lod_polygons_init(&ply->polygons, ply->reader, element->count));
  if (find(ply, element, kRed) && find(ply, element, kGreen) && find(ply, element, kBlue)) {
    ply->face_colors = lod_arena_calloc(ply->reader->scratch, element->count, sizeof *ply->face_colors);
    if (!ply->face_colors)
      return lod_reader_memory(ply->reader);
    for (uint64_t i = 0; i < element->count; i++)
      ply->face_colors[i][3] = 1;
  }
  for (uint64_t row = read_plain_triangles(ply, element); row < element->count; row++) {
    LOD_TRY(read_face(ply, element, row));
    if ((row & 0xFFFFF) == 0xFFFFF)
      LOD_TRY(lod_reader_progress(ply->reader, 0.4 * (double)row / (double)element->count));
  }
  if (ply->polygons.dropped > 0)
    lod_scene_warn(ply->reader->scene, "%u faces with fewer than three corners were dropped.", ply->polygons.dropped);
  return LOD_OK;
}

/* One strip: every index but the first two makes a triangle with the two before it, every other one turned over; -1 starts anew. */
static enum lod_status read_strip(struct ply *ply, const struct element *element, uint64_t row, const struct property *property) {
  uint32_t count, run = 0, before[2] = {0, 0};
  LOD_TRY(next_count(ply, element, row, property, &count));
  for (uint32_t i = 0; i < count; i++) {
    double value = 0;
    LOD_TRY(next_value(ply, element, row, property->type, &value));
    if (value == -1) {
      run = 0;
      continue;
    }
    uint32_t index = 0;
    LOD_TRY(to_index(ply, element, row, value, &index));
    /* Equal neighbours only turn the strip. */
    if (run >= 2 && before[0] != before[1] && before[1] != index && before[0] != index) {
      uint32_t *corners = lod_polygons_begin(&ply->strips, ply->reader, 3);
      if (!corners)
        return LOD_MEMORY;
      bool odd = run & 1;
      corners[0] = before[odd ? 1 : 0];
      corners[1] = before[odd ? 0 : 1];
      corners[2] = index;
      LOD_TRY(lod_polygons_end(&ply->strips, ply->reader, 3));
    }
    before[0] = before[1];
    before[1] = index;
    run++;
  }
  return LOD_OK;
}

static enum lod_status read_strips(struct ply *ply, const struct element *element) {
  if (ply->strips.corners)
    return lod_reader_bad(ply->reader, "bad-header", "there are two tristrips elements");
  LOD_TRY(lod_polygons_init(&ply->strips, ply->reader, 0));
  for (uint64_t row = 0; row < element->count; row++)
    for (uint32_t i = 0; i < element->property_count; i++) {
      const struct property *property = &ply->properties[element->first + i];
      if (property->meaning == kIndices)
        LOD_TRY(read_strip(ply, element, row, property));
      else
        LOD_TRY(skip_property(ply, element, row, property));
    }
  return LOD_OK;
}

static enum lod_status read_edges(struct ply *ply, const struct element *element) {
  struct lod_mesh *mesh = &ply->mesh;
  if (mesh->edges)
    return lod_reader_bad(ply->reader, "bad-header", "there are two edge elements");
  if (element->count > ply->reader->limits.max_triangles)
    return lod_reader_add_triangles(ply->reader, element->count);
  mesh->edges = lod_arena_calloc(ply->reader->scratch, element->count, sizeof *mesh->edges);
  if (!mesh->edges)
    return lod_reader_memory(ply->reader);
  mesh->edge_count = (uint32_t)element->count;
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    for (uint32_t i = 0; i < element->property_count; i++) {
      const struct property *property = &ply->properties[element->first + i];
      double value = 0;
      if (property->meaning != kVertex1 && property->meaning != kVertex2) {
        LOD_TRY(skip_property(ply, element, e, property));
        continue;
      }
      LOD_TRY(next_value(ply, element, e, property->type, &value));
      LOD_TRY(to_index(ply, element, e, value, &mesh->edges[e][property->meaning - kVertex1]));
    }
  return LOD_OK;
}

static enum lod_status skip_element(struct ply *ply, const struct element *element) {
  for (uint64_t row = 0; row < element->count; row++)
    for (uint32_t i = 0; i < element->property_count; i++)
      LOD_TRY(skip_property(ply, element, row, &ply->properties[element->first + i]));
  return LOD_OK;
}

static enum lod_status read_element(struct ply *ply, const struct element *element) {
  LOD_TRY(check_count(ply, element));
  if (strcmp(element->name, "vertex") == 0)
    return read_vertices(ply, element);
  if (strcmp(element->name, "face") == 0)
    return read_faces(ply, element);
  if (strcmp(element->name, "tristrips") == 0)
    return read_strips(ply, element);
  if (strcmp(element->name, "edge") == 0 && find(ply, element, kVertex1) && find(ply, element, kVertex2))
    return read_edges(ply, element);
  if (element->count > 0)
    lod_scene_warn(ply->reader->scene, "PLY element '%s' was skipped.", element->name);
  return skip_element(ply, element);
}

/* --- from polygons to the part --- */

/* Attributes of corners and faces: a wedge is a corner, and the vertices' attributes are copied to it. */
static enum lod_status spread_to_corners(struct ply *ply, const struct lod_polygon_triangles *triangles) {
  struct lod_mesh *mesh = &ply->mesh;
  struct lod_arena *arena = ply->reader->scratch;
  const struct lod_polygons *polygons = &ply->polygons;
  uint32_t count = polygons->corner_count;
  float(*normals)[3] = mesh->normals ? lod_arena_calloc(arena, count, sizeof *normals) : NULL;
  float(*uvs)[2] = mesh->uvs[0] || ply->corner_uvs ? lod_arena_calloc(arena, count, sizeof *uvs) : NULL;
  float(*colors)[4] = mesh->colors || ply->face_colors ? lod_arena_calloc(arena, count, sizeof *colors) : NULL;
  if ((mesh->normals && !normals) || ((mesh->uvs[0] || ply->corner_uvs) && !uvs) || ((mesh->colors || ply->face_colors) && !colors))
    return lod_reader_memory(ply->reader);
  for (uint32_t p = 0; p < polygons->polygon_count; p++) {
    uint32_t begin = polygons->starts ? polygons->starts[p] : 3 * p, end = polygons->starts ? polygons->starts[p + 1] : 3 * p + 3;
    for (uint32_t c = begin; c < end; c++) {
      uint32_t v = polygons->corners[c];
      if (normals)
        memcpy(normals[c], mesh->normals[v], sizeof *normals);
      if (ply->corner_uvs && c < ply->corner_uv_capacity)
        memcpy(uvs[c], ply->corner_uvs[c], sizeof *uvs);
      else if (mesh->uvs[0])
        memcpy(uvs[c], mesh->uvs[0][v], sizeof *uvs);
      if (mesh->colors)
        memcpy(colors[c], mesh->colors[v], sizeof *colors);
      else if (ply->face_colors)
        memcpy(colors[c], ply->face_colors[p], sizeof *colors);
    }
  }
  mesh->normals = normals;
  mesh->uvs[0] = uvs;
  mesh->colors = colors;
  mesh->wedge_count = count;
  mesh->wedge_vertex = polygons->corners;
  mesh->corners = triangles->corners;
  return LOD_OK;
}

/* Triangles of strips behind those of faces; they have no corner attributes, so then the vertices' own are used for all. */
static enum lod_status append_strips(struct ply *ply, struct lod_polygon_triangles *triangles) {
  struct lod_polygon_triangles strips;
  struct lod_mesh *mesh = &ply->mesh;
  LOD_TRY(lod_polygons_triangulate(&ply->strips, ply->reader, mesh->positions, mesh->vertex_count, false, &strips));
  if (triangles->count == 0) {
    *triangles = strips;
    return LOD_OK;
  }
  uint32_t(*all)[3] = lod_arena_alloc(ply->reader->scratch, (size_t)triangles->count + strips.count, sizeof *all);
  if (!all)
    return lod_reader_memory(ply->reader);
  memcpy(all, triangles->triangles, triangles->count * sizeof *all);
  memcpy(all + triangles->count, strips.triangles, strips.count * sizeof *all);
  triangles->triangles = all;
  triangles->count += strips.count;
  return LOD_OK;
}

static enum lod_status add_texture(struct ply *ply, uint32_t *material) {
  const uint8_t *bytes = NULL;
  size_t size = 0;
  uint32_t image;
  *material = LOD_NONE;
  if (!ply->texture[0] || !ply->mesh.uvs[0])
    return LOD_OK;
  LOD_TRY(lod_reader_open_optional(ply->reader, ply->texture, false, ply->reader->arena, &bytes, &size));
  if (!bytes)
    return LOD_OK;
  LOD_TRY(lod_reader_add_image(ply->reader, ply->texture, bytes, size, &image));
  if (image == LOD_NONE)
    return LOD_OK;
  struct lod_texture texture = {.image = image, .fallback = LOD_NONE};
  if (lod_scene_add_texture(ply->reader->scene, &texture) == LOD_NONE)
    return lod_reader_memory(ply->reader);
  *material = lod_scene_add_material(ply->reader->scene, "",
                                     "{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0},\"metallicFactor\":0}}");
  return *material == LOD_NONE ? lod_reader_memory(ply->reader) : LOD_OK;
}

static enum lod_status build(struct ply *ply) {
  struct lod_mesh *mesh = &ply->mesh;
  struct lod_polygon_triangles triangles = {0};
  bool by_corner = (ply->corner_uvs || (ply->face_colors && !mesh->colors)) && !ply->strips.corner_count;
  if (ply->polygons.corners)
    LOD_TRY(lod_polygons_triangulate(&ply->polygons, ply->reader, mesh->positions, mesh->vertex_count, by_corner, &triangles));
  if (ply->strips.corner_count > 0)
    LOD_TRY(append_strips(ply, &triangles));
  mesh->triangles = triangles.triangles;
  mesh->triangle_count = triangles.count;
  if (by_corner && triangles.count > 0)
    LOD_TRY(spread_to_corners(ply, &triangles));
  else if (lod_scene_share_index(mesh, ply->reader->scratch) != LOD_OK)
    return lod_reader_memory(ply->reader);
  uint32_t material;
  LOD_TRY(add_texture(ply, &material));
  if (material != LOD_NONE) {
    mesh->materials = lod_arena_calloc(ply->reader->scratch, mesh->triangle_count, sizeof *mesh->materials);
    if (!mesh->materials)
      return lod_reader_memory(ply->reader);
  }
  struct lod_scene_part part = {.mesh = *mesh, .rounding = ply->rounding};
  return lod_scene_add_part(ply->reader->scene, &part, ply->reader->name, ply->reader->problem);
}

enum lod_status lod_import_ply(struct lod_reader *reader) {
  struct ply *ply = LOD_NEW_ZERO(reader->scratch, 1, struct ply);
  if (!ply)
    return lod_reader_memory(reader);
  ply->reader = reader;
  ply->at = reader->bytes;
  ply->end = reader->bytes + reader->size;
  LOD_TRY(read_header(ply));
  for (uint32_t i = 0; i < ply->element_count; i++)
    LOD_TRY(read_element(ply, &ply->elements[i]));
  if (!ply->have_vertices)
    return lod_reader_bad(reader, "bad-header", "there is no vertex element");
  return build(ply);
}
