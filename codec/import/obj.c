/* Wavefront OBJ: v (with colours behind it), vt, vn, f, l, p, usemtl, mtllib; indices that count from the end; continued lines.
 * Curves, surfaces, groups and smoothing are not read. The file is one part: a group is a name, not a piece that moves by itself.
 *
 * Read here rather than by assimp because its reader writes outside of its memory on malformed lines (5.2.5, found by our fuzzer within a
 * hundred inputs), keeps coordinates to a few units in the last place only, and gives every corner a vertex of its own. */
#include <math.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/obj.h"
#include "codec/import/polygons.h"

struct list {
  void *items;
  uint32_t count, capacity;
};

struct obj {
  struct lod_reader *reader;
  uint64_t line;
  struct list positions, colors, uvs, normals;  /* float[3], float[4], float[2], float[3] */
  struct list corner_uvs, corner_normals;       /* uint32_t a corner of polygons; LOD_NONE = none */
  struct list polygon_materials, edges, points; /* uint32_t, uint32_t[2], uint32_t */
  struct list edge_materials, point_materials;
  struct lod_polygons polygons;
  struct lod_obj_materials *materials;
  uint32_t material; /* in use; LOD_NONE */
  bool has_uvs, has_normals;
  double worst; /* squared rounding */
};

/* Room for `more` further items; the new ones are counted. NULL when memory is out. */
static void *extend(struct obj *obj, struct list *list, uint32_t more, size_t size) {
  uint64_t wanted = (uint64_t)list->count + more;
  if (wanted > list->capacity) {
    uint64_t capacity = wanted + wanted / 2 + 64;
    void *items = capacity < UINT32_MAX ? lod_arena_alloc(obj->reader->scratch, capacity, size) : NULL;
    if (!items) {
      lod_reader_memory(obj->reader);
      return NULL;
    }
    if (list->count > 0)
      memcpy(items, list->items, list->count * size);
    list->items = items;
    list->capacity = (uint32_t)capacity;
  }
  void *first = (char *)list->items + list->count * size;
  list->count += more;
  return first;
}

static enum lod_status bad_line(struct obj *obj, const char *what) {
  return lod_reader_bad(obj->reader, "bad-syntax", "line %llu %s", (unsigned long long)obj->line, what);
}

/* --- lines --- */

bool lod_obj_is_word(const char *line, size_t length, const char *word, const char **rest) {
  size_t n = strlen(word);
  if (length < n || memcmp(line, word, n) != 0 || (length > n && line[n] != ' ' && line[n] != '\t'))
    return false;
  *rest = line + n;
  lod_number_skip_blanks(rest, line + length);
  return true;
}

static const char *line_end(const char *at, const char *end) {
  const char *stop = memchr(at, '\n', (size_t)(end - at));
  return stop ? stop : end;
}

static void trim(const char **line, size_t *length) {
  while (*length > 0 && ((*line)[*length - 1] == '\r' || (*line)[*length - 1] == ' ' || (*line)[*length - 1] == '\t'))
    --*length;
  while (*length > 0 && (**line == ' ' || **line == '\t')) {
    ++*line;
    --*length;
  }
}

bool lod_obj_next_line(struct lod_reader *reader, const char **at, const char *end, const char **line, size_t *length) {
  if (*at >= end)
    return false;
  const char *first = *at, *stop = line_end(first, end);
  bool continued = false;
  for (;;) {
    const char *last = stop > first && stop[-1] == '\r' ? stop - 1 : stop;
    if (last == first || last[-1] != '\\' || stop == end)
      break;
    continued = true;
    stop = line_end(stop + 1, end);
  }
  *at = stop < end ? stop + 1 : end;
  *line = first;
  *length = (size_t)(stop - first);
  if (continued) {
    char *joined = lod_arena_copy(reader->scratch, first, *length);
    *line = joined;
    for (size_t i = 0; joined && i < *length; i++)
      if (joined[i] == '\n' || joined[i] == '\r' ||
          (joined[i] == '\\' && i + 1 < *length && (joined[i + 1] == '\n' || joined[i + 1] == '\r')))
        joined[i] = ' ';
    if (!joined)
      return true;
  }
  trim(line, length);
  return true;
}

/* --- vertices --- */

/* Up to `most` numbers; stops at the end or a comment. -1 when something else is there. */
static int read_numbers(const char *at, const char *end, double *values, int most) {
  int count = 0;
  for (; count < most; count++) {
    lod_number_skip_blanks(&at, end);
    if (at == end || *at == '#')
      return count;
    if (!lod_number_read(&at, end, &values[count]))
      return -1;
  }
  return count;
}

static enum lod_status read_position(struct obj *obj, const char *at, const char *end) {
  double values[8], squared = 0;
  int count = read_numbers(at, end, values, 8);
  if (count < 3)
    return bad_line(obj, "has a vertex that is not three numbers");
  LOD_TRY(lod_reader_add_vertices(obj->reader, 1));
  float *p = extend(obj, &obj->positions, 1, 3 * sizeof(float));
  if (!p)
    return LOD_MEMORY;
  for (int k = 0; k < 3; k++) {
    p[k] = (float)values[k];
    double off = fabs(values[k] - (double)p[k]) + 0x1p-53 * fabs(values[k]);
    squared += isfinite(off) ? off * off : 0;
  }
  obj->worst = fmax(obj->worst, squared);
  /* x y z r g b, or x y z w r g b: colours as MeshLab and ZBrush write them. Vertices without are white. */
  if (count < 6 && obj->colors.count == 0)
    return LOD_OK;
  uint32_t missing = obj->positions.count - obj->colors.count;
  float *c = extend(obj, &obj->colors, missing, 4 * sizeof(float));
  if (!c)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < missing * 4; i++)
    c[i] = 1;
  const double *rgb = values + (count == 7 ? 4 : 3);
  for (int k = 0; count >= 6 && k < 3; k++)
    c[(missing - 1) * 4 + (uint32_t)k] = lod_linear_from_srgb((float)(rgb[k] >= 0 ? fmin(rgb[k], 1) : 0));
  return LOD_OK;
}

static enum lod_status read_uv(struct obj *obj, const char *at, const char *end) {
  double values[3] = {0, 0, 0};
  if (read_numbers(at, end, values, 3) < 1)
    return bad_line(obj, "has a texture coordinate that is no number");
  float *uv = extend(obj, &obj->uvs, 1, 2 * sizeof(float));
  if (!uv)
    return LOD_MEMORY;
  uv[0] = (float)values[0];
  uv[1] = (float)(1 - values[1]); /* v points up here, down in glTF */
  return LOD_OK;
}

static enum lod_status read_normal(struct obj *obj, const char *at, const char *end) {
  double values[3];
  if (read_numbers(at, end, values, 3) < 3)
    return bad_line(obj, "has a normal that is not three numbers");
  float *n = extend(obj, &obj->normals, 1, 3 * sizeof(float));
  if (!n)
    return LOD_MEMORY;
  for (int k = 0; k < 3; k++)
    n[k] = (float)values[k];
  return LOD_OK;
}

/* --- faces, lines, points --- */

/* A whole number that is not zero; *index counts from 0 in the end. */
static bool read_index(const char **at, const char *end, uint32_t count, uint32_t *index) {
  const char *p = *at;
  bool negative = p < end && *p == '-';
  uint64_t value = 0;
  p += negative;
  const char *first = p;
  for (; p < end && *p >= '0' && *p <= '9' && value < UINT32_MAX; p++)
    value = value * 10 + (uint64_t)(*p - '0');
  if (p == first || value == 0 || value >= UINT32_MAX || (negative && value > count))
    return false;
  *index = negative ? count - (uint32_t)value : (uint32_t)value - 1;
  *at = p;
  return true;
}

struct corner {
  uint32_t vertex, uv, normal;
};

/* v, v/vt, v//vn or v/vt/vn, at *at, which is not blank. */
static bool read_corner(struct obj *obj, const char **at, const char *end, struct corner *corner) {
  *corner = (struct corner){LOD_NONE, LOD_NONE, LOD_NONE};
  if (!read_index(at, end, obj->positions.count, &corner->vertex))
    return false;
  if (*at < end && **at == '/') {
    ++*at;
    if (*at < end && **at != '/' && **at != ' ' && **at != '\t' && !read_index(at, end, obj->uvs.count, &corner->uv))
      return false;
    if (*at < end && **at == '/') {
      ++*at;
      if (*at < end && **at != ' ' && **at != '\t' && !read_index(at, end, obj->normals.count, &corner->normal))
        return false;
    }
  }
  return *at == end || **at == ' ' || **at == '\t';
}

static enum lod_status bad_corner(struct obj *obj) {
  return lod_reader_bad(obj->reader, "index-out-of-range", "line %llu refers to a vertex that is no number, 0, or before the first",
                        (unsigned long long)obj->line);
}

static enum lod_status read_face(struct obj *obj, const char *at, const char *end) {
  /* Two bytes a corner at least. */
  uint32_t most = (uint32_t)((end - at) / 2 + 1), count = 0, first = obj->polygons.corner_count;
  uint32_t *corners = lod_polygons_begin(&obj->polygons, obj->reader, most);
  if (!corners)
    return LOD_MEMORY;
  obj->corner_uvs.count = obj->corner_normals.count = first; /* dropped polygons leave no corners */
  for (;; count++) {
    struct corner corner;
    lod_number_skip_blanks(&at, end);
    if (at == end || *at == '#')
      break;
    if (!read_corner(obj, &at, end, &corner))
      return bad_corner(obj);
    uint32_t *uv = extend(obj, &obj->corner_uvs, 1, sizeof *uv), *normal = extend(obj, &obj->corner_normals, 1, sizeof *normal);
    if (!uv || !normal)
      return LOD_MEMORY;
    corners[count] = corner.vertex;
    *uv = corner.uv;
    *normal = corner.normal;
    obj->has_uvs = obj->has_uvs || corner.uv != LOD_NONE;
    obj->has_normals = obj->has_normals || corner.normal != LOD_NONE;
  }
  if (count >= 3) {
    uint32_t *material = extend(obj, &obj->polygon_materials, 1, sizeof *material);
    if (!material)
      return LOD_MEMORY;
    *material = obj->material;
  }
  return lod_polygons_end(&obj->polygons, obj->reader, count);
}

static enum lod_status add_line_or_point(struct obj *obj, bool line, uint32_t a, uint32_t b) {
  uint32_t *item = line ? extend(obj, &obj->edges, 1, 2 * sizeof *item) : extend(obj, &obj->points, 1, sizeof *item);
  uint32_t *material = extend(obj, line ? &obj->edge_materials : &obj->point_materials, 1, sizeof *material);
  if (!item || !material)
    return LOD_MEMORY;
  item[0] = a;
  if (line)
    item[1] = b;
  *material = obj->material;
  return LOD_OK;
}

static enum lod_status read_line_or_points(struct obj *obj, bool line, const char *at, const char *end) {
  uint32_t before = LOD_NONE;
  for (;;) {
    struct corner corner;
    lod_number_skip_blanks(&at, end);
    if (at == end || *at == '#')
      return LOD_OK;
    if (!read_corner(obj, &at, end, &corner))
      return bad_corner(obj);
    if (!line || before != LOD_NONE)
      LOD_TRY(add_line_or_point(obj, line, line ? before : corner.vertex, corner.vertex));
    before = corner.vertex;
  }
}

static enum lod_status read_line(struct obj *obj, const char *line, size_t length) {
  const char *rest, *end = line + length;
  if (lod_obj_is_word(line, length, "v", &rest))
    return read_position(obj, rest, end);
  if (lod_obj_is_word(line, length, "f", &rest) || lod_obj_is_word(line, length, "fo", &rest))
    return read_face(obj, rest, end);
  if (lod_obj_is_word(line, length, "vt", &rest))
    return read_uv(obj, rest, end);
  if (lod_obj_is_word(line, length, "vn", &rest))
    return read_normal(obj, rest, end);
  if (lod_obj_is_word(line, length, "l", &rest))
    return read_line_or_points(obj, true, rest, end);
  if (lod_obj_is_word(line, length, "p", &rest))
    return read_line_or_points(obj, false, rest, end);
  if (lod_obj_is_word(line, length, "mtllib", &rest))
    return lod_obj_materials_load(obj->materials, rest, (size_t)(end - rest));
  if (lod_obj_is_word(line, length, "usemtl", &rest)) {
    obj->material = lod_obj_materials_find(obj->materials, rest, (size_t)(end - rest));
    return obj->material == LOD_NONE ? lod_reader_memory(obj->reader) : LOD_OK;
  }
  if (lod_obj_is_word(line, length, "cstype", &rest))
    lod_scene_warn(obj->reader->scene, "Curves and curved surfaces of the OBJ file were dropped.");
  return LOD_OK;
}

static enum lod_status read_lines(struct obj *obj) {
  const char *at = (const char *)obj->reader->bytes, *end = at + obj->reader->size, *line;
  size_t length;
  if (obj->reader->size >= 3 && memcmp(at, "\xEF\xBB\xBF", 3) == 0)
    at += 3;
  while (lod_obj_next_line(obj->reader, &at, end, &line, &length)) {
    if (!line)
      return lod_reader_memory(obj->reader);
    if (length > UINT32_MAX)
      return bad_line(obj, "is too long");
    obj->line++;
    LOD_TRY(read_line(obj, line, length));
    if ((obj->line & 0xFFFFF) == 0)
      LOD_TRY(lod_reader_progress(obj->reader, 0.3));
  }
  return LOD_OK;
}

/* --- to the part --- */

static enum lod_status fill_wedges(struct obj *obj, struct lod_mesh *mesh) {
  struct lod_arena *arena = obj->reader->scratch;
  const uint32_t *uvs = obj->corner_uvs.items, *normals = obj->corner_normals.items;
  const struct lod_polygons *polygons = &obj->polygons;
  uint32_t count = polygons->corner_count, bad = 0;
  mesh->wedge_count = count;
  mesh->wedge_vertex = polygons->corners;
  mesh->uvs[0] = obj->has_uvs ? lod_arena_calloc(arena, count, sizeof *mesh->uvs[0]) : NULL;
  mesh->normals = obj->has_normals ? lod_arena_calloc(arena, count, sizeof *mesh->normals) : NULL;
  mesh->colors = obj->colors.count ? lod_arena_alloc(arena, count, sizeof *mesh->colors) : NULL;
  if ((obj->has_uvs && !mesh->uvs[0]) || (obj->has_normals && !mesh->normals) || (obj->colors.count && !mesh->colors))
    return lod_reader_memory(obj->reader);
  for (uint32_t c = 0; c < count; c++) {
    bad += (uvs[c] != LOD_NONE && uvs[c] >= obj->uvs.count) || (normals[c] != LOD_NONE && normals[c] >= obj->normals.count);
    if (uvs[c] < obj->uvs.count)
      memcpy(mesh->uvs[0][c], (float *)obj->uvs.items + 2 * (size_t)uvs[c], sizeof *mesh->uvs[0]);
    if (normals[c] < obj->normals.count)
      memcpy(mesh->normals[c], (float *)obj->normals.items + 3 * (size_t)normals[c], sizeof *mesh->normals);
    if (mesh->colors)
      memcpy(mesh->colors[c], (float *)obj->colors.items + 4 * (size_t)polygons->corners[c], sizeof *mesh->colors);
  }
  if (bad > 0)
    lod_scene_warn(obj->reader->scene, "%u corners refer to texture coordinates or normals that the file does not have.", bad);
  return LOD_OK;
}

/* Numbers of lod_obj_materials to those of the scene, in place; *any: one of them has a material. */
static enum lod_status resolve(struct obj *obj, uint32_t *materials, uint32_t count, bool *any) {
  uint32_t last = LOD_NONE, resolved = LOD_NONE;
  for (uint32_t i = 0; i < count; i++) {
    if (materials[i] != last) {
      last = materials[i];
      resolved = LOD_NONE;
      if (last != LOD_NONE)
        LOD_TRY(lod_obj_materials_resolve(obj->materials, last, &resolved));
    }
    materials[i] = resolved;
    *any = *any || resolved != LOD_NONE;
  }
  return LOD_OK;
}

static enum lod_status fill_materials(struct obj *obj, const struct lod_polygon_triangles *triangles, struct lod_mesh *mesh) {
  uint32_t *by_polygon = obj->polygon_materials.items;
  bool any = false;
  LOD_TRY(resolve(obj, by_polygon, obj->polygon_materials.count, &any));
  LOD_TRY(resolve(obj, obj->edge_materials.items, obj->edge_materials.count, &any));
  LOD_TRY(resolve(obj, obj->point_materials.items, obj->point_materials.count, &any));
  if (!any)
    return LOD_OK;
  mesh->edge_materials = obj->edge_materials.items;
  mesh->point_materials = obj->point_materials.items;
  mesh->materials = LOD_NEW(obj->reader->scratch, triangles->count, uint32_t);
  if (!mesh->materials)
    return lod_reader_memory(obj->reader);
  for (uint32_t t = 0; t < triangles->count; t++)
    mesh->materials[t] = by_polygon[triangles->polygon ? triangles->polygon[t] : t];
  return LOD_OK;
}

static enum lod_status build(struct obj *obj) {
  struct lod_reader *reader = obj->reader;
  struct lod_polygon_triangles triangles;
  struct lod_mesh mesh = {.vertex_count = obj->positions.count,
                          .positions = obj->positions.items,
                          .edge_count = obj->edges.count,
                          .edges = obj->edges.items,
                          .point_count = obj->points.count,
                          .points = obj->points.items};
  /* Some writers number normals that they do not write. */
  obj->has_uvs = obj->has_uvs && obj->uvs.count > 0;
  obj->has_normals = obj->has_normals && obj->normals.count > 0;
  bool wedges = obj->has_uvs || obj->has_normals || obj->colors.count > 0;
  LOD_TRY(lod_polygons_triangulate(&obj->polygons, reader, mesh.positions, mesh.vertex_count, wedges, &triangles));
  mesh.triangles = triangles.triangles;
  mesh.triangle_count = triangles.count;
  if (wedges) {
    mesh.corners = triangles.corners;
    LOD_TRY(fill_wedges(obj, &mesh));
  }
  LOD_TRY(fill_materials(obj, &triangles, &mesh));
  if (obj->polygons.dropped > 0)
    lod_scene_warn(reader->scene, "%u faces with fewer than three corners were dropped.", obj->polygons.dropped);
  struct lod_scene_part part = {.mesh = mesh, .rounding = sqrt(obj->worst) * (1 + 0x1p-50)};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}

enum lod_status lod_import_obj(struct lod_reader *reader) {
  struct obj *obj = LOD_NEW_ZERO(reader->scratch, 1, struct obj);
  if (!obj)
    return lod_reader_memory(reader);
  obj->reader = reader;
  obj->material = LOD_NONE;
  obj->materials = lod_obj_materials_create(reader);
  if (!obj->materials)
    return lod_reader_memory(reader);
  LOD_TRY(lod_polygons_init(&obj->polygons, reader, reader->size / 64));
  LOD_TRY(read_lines(obj));
  return build(obj);
}
