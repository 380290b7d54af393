/* Reads a level back the way a client sees it. Every number in the JSON is checked before it is used; what the writer does not write is
 * refused. */
#include <jansson.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "codec/export/draco.h"
#include "codec/export/glb.h"

struct reader {
  const struct lod_model *model;
  struct lod_problem *problem;
  json_t *root;
  const uint8_t *bin;
  size_t bin_size;
  struct lod_arena *scratch; /* decoded primitives, until the units are put together */
  uint32_t *material_of;     /* GLB material -> model material */
  size_t material_count;
};

__attribute__((format(printf, 2, 3))) static enum lod_status bad(struct reader *r, const char *format, ...) {
  char detail[300];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(detail, sizeof detail, format, arguments);
  va_end(arguments);
  return lod_fail(r->problem, LOD_BAD_INPUT, "glb", "GLB level: %s", detail);
}

/* ---- container ---- */

static uint32_t get_u32(const uint8_t *at) {
  return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static enum lod_status open_container(struct reader *r, const uint8_t *bytes, size_t size) {
  if (size < 20 || memcmp(bytes, "glTF\2\0\0\0", 8) != 0)
    return bad(r, "the bytes do not begin with a GLB 2.0 header");
  if (get_u32(bytes + 8) != size)
    return lod_fail(r->problem, LOD_BAD_INPUT, "truncated", "GLB level: the header says %u bytes, there are %zu", get_u32(bytes + 8), size);
  const size_t json_size = get_u32(bytes + 12);
  if (json_size > size - 20 || memcmp(bytes + 16, "JSON", 4) != 0)
    return bad(r, "the JSON chunk is longer than the file, or not the first");
  const size_t rest = size - 20 - json_size;
  if (rest > 0) {
    const uint8_t *chunk = bytes + 20 + json_size;
    if (rest < 8 || memcmp(chunk + 4, "BIN\0", 4) != 0 || get_u32(chunk) != rest - 8)
      return bad(r, "the second chunk is not a BIN chunk that ends with the file");
    r->bin = chunk + 8;
    r->bin_size = rest - 8;
  }
  json_error_t error;
  r->root = json_loadb((const char *)bytes + 20, json_size, 0, &error);
  if (r->root == NULL)
    return bad(r, "JSON, line %d: %s", error.line, error.text);
  return LOD_OK;
}

/* A whole number in [0, most]; missing: `missing` (negative: it must be there). */
static bool get_number(json_t *object, const char *key, json_int_t missing, json_int_t most, json_int_t *number) {
  json_t *value = json_object_get(object, key);
  *number = value == NULL ? missing : json_is_integer(value) ? json_integer_value(value) : -1;
  return *number >= 0 && *number <= most;
}

static json_t *element(struct reader *r, const char *array, json_t *index) {
  if (!json_is_integer(index) || json_integer_value(index) < 0)
    return NULL;
  return json_array_get(json_object_get(r->root, array), (size_t)json_integer_value(index)); /* NULL when out of range */
}

static enum lod_status get_view(struct reader *r, json_t *index, const uint8_t **data, size_t *size) {
  json_t *view = element(r, "bufferViews", index);
  json_int_t buffer, offset, length;
  if (view == NULL || !get_number(view, "buffer", -1, 0, &buffer) || !get_number(view, "byteOffset", 0, (json_int_t)r->bin_size, &offset) ||
      !get_number(view, "byteLength", -1, (json_int_t)r->bin_size - offset, &length) || json_object_get(view, "byteStride") != NULL)
    return bad(r, "a buffer view is missing, reaches beyond the BIN chunk or is interleaved");
  *data = r->bin + offset;
  *size = (size_t)length;
  return LOD_OK;
}

/* ---- accessors ---- */

struct accessor {
  json_int_t component, count;
  int components;
  bool normalized;
  const uint8_t *data; /* NULL: no buffer view */
};

static int components_of(const char *type) {
  static const char *const kTypes[] = {"SCALAR", "VEC2", "VEC3", "VEC4"};
  for (int i = 0; i < 4 && type != NULL; i++)
    if (strcmp(type, kTypes[i]) == 0)
      return i + 1;
  return 0;
}

static enum lod_status get_accessor(struct reader *r, json_t *index, struct accessor *out) {
  json_t *json = element(r, "accessors", index);
  json_int_t offset;
  if (json == NULL || !get_number(json, "componentType", -1, LOD_DRACO_FLOAT, &out->component) ||
      !get_number(json, "count", -1, LOD_NONE - 1, &out->count) || !get_number(json, "byteOffset", 0, 0, &offset))
    return bad(r, "an accessor is missing or has a wrong componentType, count or byteOffset");
  out->components = components_of(json_string_value(json_object_get(json, "type")));
  out->normalized = json_is_true(json_object_get(json, "normalized"));
  const size_t width = lod_draco_component_size((enum lod_draco_component)out->component);
  if (out->components == 0 || width == 0 || out->component == LOD_DRACO_INT32)
    return bad(r, "an accessor has an unknown type or componentType");
  out->data = NULL;
  json_t *view = json_object_get(json, "bufferView");
  if (view == NULL)
    return LOD_OK;
  size_t size;
  LOD_TRY(get_view(r, view, &out->data, &size));
  if (size / (width * (size_t)out->components) < (size_t)out->count)
    return bad(r, "an accessor of %lld elements reaches beyond its buffer view of %zu bytes", (long long)out->count, size);
  return LOD_OK;
}

/* ---- one primitive, decoded ---- */

struct part_mesh {
  struct part_mesh *next; /* of its unit */
  uint32_t part, material;
  int mode;
  uint32_t vertex_count, index_count;
  float (*positions)[3];
  float (*normals)[3];
  float (*uvs[LOD_UV_SETS])[2];
  float (*colors)[4];
  float *thickness;
  uint32_t *indices;
};

static float *plain_floats(struct reader *r, const struct accessor *accessor) {
  const size_t count = (size_t)accessor->count * (size_t)accessor->components;
  float *out = LOD_NEW(r->scratch, count, float);
  for (size_t i = 0; i < count && out != NULL; i++) {
    if (accessor->component == LOD_DRACO_FLOAT) {
      memcpy(&out[i], accessor->data + 4 * i, 4);
    } else if (accessor->component == LOD_DRACO_UINT8) {
      out[i] = (float)(accessor->data[i] / (accessor->normalized ? 255.0 : 1.0));
    } else {
      uint16_t value;
      memcpy(&value, accessor->data + 2 * i, 2);
      out[i] = (float)(value / (accessor->normalized ? 65535.0 : 1.0));
    }
  }
  return out;
}

/* The attribute as floats, `*components` each, from Draco or from the BIN chunk. NULL *values: the primitive does not have it. */
static enum lod_status get_attribute(struct reader *r, json_t *primitive, const struct lod_draco_mesh *draco, json_t *ids, const char *name,
                                     uint32_t *vertex_count, int *components, float **values) {
  *values = NULL;
  json_t *index = json_object_get(json_object_get(primitive, "attributes"), name);
  if (index == NULL)
    return LOD_OK;
  struct accessor accessor;
  LOD_TRY(get_accessor(r, index, &accessor));
  if (*vertex_count != LOD_NONE && accessor.count != *vertex_count)
    return bad(r, "%s has %lld elements where POSITION has %u", name, (long long)accessor.count, *vertex_count);
  *vertex_count = (uint32_t)accessor.count;
  *components = accessor.components;
  if (accessor.component != LOD_DRACO_FLOAT &&
      ((accessor.component != LOD_DRACO_UINT8 && accessor.component != LOD_DRACO_UINT16) || !accessor.normalized))
    return bad(r, "%s is neither float nor normalised", name);
  if (draco != NULL) {
    json_int_t id;
    if (!get_number(ids, name, -1, UINT32_MAX, &id))
      return bad(r, "%s has no Draco id", name);
    const struct lod_draco_attribute *attribute = lod_draco_find(draco, (uint32_t)id);
    if (attribute == NULL || attribute->components != accessor.components || (json_int_t)attribute->component != accessor.component ||
        draco->point_count != accessor.count)
      return bad(r, "%s and what Draco holds for it disagree in type or number", name);
    *values = lod_draco_floats(draco, attribute, r->scratch);
  } else {
    if (accessor.data == NULL)
      return bad(r, "%s has no buffer view", name);
    *values = plain_floats(r, &accessor);
  }
  return *values != NULL ? LOD_OK : lod_fail_memory(r->problem);
}

static enum lod_status get_indices(struct reader *r, json_t *primitive, const struct lod_draco_mesh *draco, struct part_mesh *out) {
  json_t *index = json_object_get(primitive, "indices");
  if (index == NULL) {
    if (out->mode != 0)
      return bad(r, "a primitive of mode %d has no indices", out->mode);
    return LOD_OK;
  }
  struct accessor accessor;
  LOD_TRY(get_accessor(r, index, &accessor));
  if (accessor.components != 1 || accessor.count % (out->mode == 4 ? 3 : 2) != 0 || out->mode == 0)
    return bad(r, "%lld indices do not fit mode %d", (long long)accessor.count, out->mode);
  out->index_count = (uint32_t)accessor.count;
  if (draco != NULL) {
    if (accessor.count != 3 * (json_int_t)draco->triangle_count)
      return bad(r, "%lld indices are announced, Draco holds %u triangles", (long long)accessor.count, draco->triangle_count);
    out->indices = &draco->triangles[0][0];
    return LOD_OK;
  }
  const size_t width = lod_draco_component_size((enum lod_draco_component)accessor.component);
  if (accessor.data == NULL ||
      (accessor.component != LOD_DRACO_UINT8 && accessor.component != LOD_DRACO_UINT16 && accessor.component != LOD_DRACO_UINT32))
    return bad(r, "indices have no buffer view or are not unsigned integers");
  out->indices = LOD_NEW(r->scratch, out->index_count, uint32_t);
  if (out->indices == NULL)
    return lod_fail_memory(r->problem);
  for (uint32_t i = 0; i < out->index_count; i++) {
    out->indices[i] = 0;
    for (size_t byte = 0; byte < width; byte++)
      out->indices[i] |= (uint32_t)accessor.data[i * width + byte] << (8 * byte);
    if (out->indices[i] >= out->vertex_count)
      return lod_fail(r->problem, LOD_BAD_INPUT, "index-out-of-range", "GLB level: index %u of a primitive with %u vertices",
                      out->indices[i], out->vertex_count);
  }
  return LOD_OK;
}

static enum lod_status widen_colors(struct reader *r, const float *values, int components, struct part_mesh *out) {
  if (values == NULL)
    return LOD_OK;
  if (components < 3)
    return bad(r, "COLOR_0 has %d components", components);
  out->colors = lod_arena_alloc(r->scratch, out->vertex_count, sizeof *out->colors);
  if (out->colors == NULL)
    return lod_fail_memory(r->problem);
  for (uint32_t v = 0; v < out->vertex_count; v++)
    for (int i = 0; i < 4; i++)
      out->colors[v][i] = i < components ? values[(size_t)v * (size_t)components + (size_t)i] : 1;
  return LOD_OK;
}

static enum lod_status get_attributes(struct reader *r, json_t *primitive, const struct lod_draco_mesh *draco, json_t *ids,
                                      struct part_mesh *out) {
  static const struct {
    const char *name;
    int components;
  } kExpected[] = {{"POSITION", 3}, {"NORMAL", 3}, {"TEXCOORD_0", 2}, {"TEXCOORD_1", 2}, {"_THICKNESS", 1}, {"COLOR_0", 0}};
  enum { EXPECTED = sizeof kExpected / sizeof *kExpected };
  float *values[EXPECTED];
  int components = 0;
  out->vertex_count = LOD_NONE;
  for (int i = 0; i < EXPECTED; i++) {
    LOD_TRY(get_attribute(r, primitive, draco, ids, kExpected[i].name, &out->vertex_count, &components, &values[i]));
    if (values[i] != NULL && kExpected[i].components != 0 && components != kExpected[i].components)
      return bad(r, "%s has %d components", kExpected[i].name, components);
  }
  if (values[0] == NULL)
    return bad(r, "a primitive has no POSITION");
  for (size_t i = 0; i < 3 * (size_t)out->vertex_count; i++)
    if (!isfinite(values[0][i]))
      return bad(r, "a position is not finite");
  out->positions = (float(*)[3])values[0];
  out->normals = (float(*)[3])values[1];
  out->uvs[0] = (float(*)[2])values[2];
  out->uvs[1] = (float(*)[2])values[3];
  out->thickness = values[4];
  return widen_colors(r, values[5], components, out);
}

static enum lod_status get_primitive(struct reader *r, json_t *json, uint32_t part, struct part_mesh *out) {
  json_int_t mode, material;
  if (!get_number(json, "mode", 4, 4, &mode) || mode == 2 || mode == 3)
    return bad(r, "a primitive has a mode other than POINTS, LINES and TRIANGLES");
  *out = (struct part_mesh){.part = part, .material = LOD_NONE, .mode = (int)mode};
  if (json_object_get(json, "material") != NULL) {
    if (r->material_count == 0 || !get_number(json, "material", -1, (json_int_t)r->material_count - 1, &material))
      return bad(r, "a primitive names a material that is not there");
    out->material = r->material_of[material];
  }
  json_t *extension = json_object_get(json_object_get(json, "extensions"), "KHR_draco_mesh_compression");
  struct lod_draco_mesh draco;
  if (extension != NULL) {
    const uint8_t *data;
    size_t size;
    if (mode != 4)
      return bad(r, "only triangles can be Draco compressed");
    LOD_TRY(get_view(r, json_object_get(extension, "bufferView"), &data, &size));
    struct accessor positions, indices; /* what they announce bounds what Draco may unpack */
    LOD_TRY(get_accessor(r, json_object_get(json_object_get(json, "attributes"), "POSITION"), &positions));
    LOD_TRY(get_accessor(r, json_object_get(json, "indices"), &indices));
    const struct lod_draco_limits limits = {.max_vertices = (uint64_t)positions.count + 1,
                                            .max_triangles = (uint64_t)indices.count / 3 + 1};
    LOD_TRY(lod_draco_decode(data, size, &limits, r->scratch, &draco, r->problem));
  }
  const struct lod_draco_mesh *decoded = extension != NULL ? &draco : NULL;
  LOD_TRY(get_attributes(r, json, decoded, json_object_get(extension, "attributes"), out));
  return get_indices(r, json, decoded, out);
}

/* ---- units ---- */

struct totals {
  uint64_t vertices, triangles, edges, points;
  bool normals, uvs[LOD_UV_SETS], colors, edge_thickness, point_thickness;
};

static struct totals sum_up(const struct part_mesh *list) {
  struct totals sum = {0};
  for (const struct part_mesh *m = list; m != NULL; m = m->next) {
    sum.vertices += m->vertex_count;
    sum.triangles += m->mode == 4 ? m->index_count / 3 : 0;
    sum.edges += m->mode == 1 ? m->index_count / 2 : 0;
    sum.points += m->mode == 0 ? m->vertex_count : 0;
    sum.normals |= m->normals != NULL;
    sum.colors |= m->colors != NULL;
    sum.uvs[0] |= m->uvs[0] != NULL;
    sum.uvs[1] |= m->uvs[1] != NULL;
    sum.edge_thickness |= m->mode == 1 && m->thickness != NULL;
    sum.point_thickness |= m->mode == 0 && m->thickness != NULL;
  }
  return sum;
}

static void *optional(struct lod_arena *arena, bool wanted, size_t count, size_t size, bool *good) {
  void *memory = wanted ? lod_arena_calloc(arena, count, size) : NULL;
  *good = *good && (!wanted || memory != NULL);
  return memory;
}

static bool allocate_unit(const struct totals *sum, struct lod_arena *arena, struct lod_mesh *mesh) {
  bool good = true;
  const bool wedges = sum->normals || sum->colors || sum->uvs[0] || sum->uvs[1];
  const size_t vertices = sum->vertices, triangles = sum->triangles, edges = sum->edges, points = sum->points;
  *mesh = (struct lod_mesh){.vertex_count = (uint32_t)vertices,
                            .triangle_count = (uint32_t)triangles,
                            .edge_count = (uint32_t)edges,
                            .point_count = (uint32_t)points,
                            .wedge_count = wedges ? (uint32_t)vertices : 0};
  mesh->positions = optional(arena, true, vertices, sizeof *mesh->positions, &good);
  mesh->triangles = optional(arena, true, triangles, sizeof *mesh->triangles, &good);
  mesh->materials = optional(arena, true, triangles, sizeof *mesh->materials, &good);
  mesh->parts = optional(arena, true, triangles, sizeof *mesh->parts, &good);
  mesh->corners = optional(arena, wedges, triangles, sizeof *mesh->corners, &good);
  mesh->wedge_vertex = optional(arena, wedges, vertices, sizeof *mesh->wedge_vertex, &good);
  mesh->normals = optional(arena, sum->normals, vertices, sizeof *mesh->normals, &good);
  mesh->uvs[0] = optional(arena, sum->uvs[0], vertices, sizeof *mesh->uvs[0], &good);
  mesh->uvs[1] = optional(arena, sum->uvs[1], vertices, sizeof *mesh->uvs[1], &good);
  mesh->colors = optional(arena, sum->colors, vertices, sizeof *mesh->colors, &good);
  mesh->edges = optional(arena, edges > 0, edges, sizeof *mesh->edges, &good);
  mesh->edge_thickness = optional(arena, sum->edge_thickness, edges, sizeof *mesh->edge_thickness, &good);
  mesh->edge_materials = optional(arena, edges > 0, edges, sizeof *mesh->edge_materials, &good);
  mesh->edge_parts = optional(arena, edges > 0, edges, sizeof *mesh->edge_parts, &good);
  mesh->points = optional(arena, points > 0, points, sizeof *mesh->points, &good);
  mesh->point_thickness = optional(arena, sum->point_thickness, points, sizeof *mesh->point_thickness, &good);
  mesh->point_materials = optional(arena, points > 0, points, sizeof *mesh->point_materials, &good);
  mesh->point_parts = optional(arena, points > 0, points, sizeof *mesh->point_parts, &good);
  return good;
}

static void put_attributes(const struct part_mesh *m, uint32_t base, struct lod_mesh *mesh) {
  const size_t count = m->vertex_count;
  memcpy(mesh->positions[base], m->positions, count * sizeof *m->positions);
  for (uint32_t v = 0; v < m->vertex_count && mesh->wedge_vertex != NULL; v++)
    mesh->wedge_vertex[base + v] = base + v;
  if (mesh->normals != NULL && m->normals != NULL)
    memcpy(mesh->normals[base], m->normals, count * sizeof *m->normals);
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (mesh->uvs[set] != NULL && m->uvs[set] != NULL)
      memcpy(mesh->uvs[set][base], m->uvs[set], count * sizeof *m->uvs[set]);
  for (uint32_t v = 0; v < m->vertex_count && mesh->colors != NULL; v++)
    for (int i = 0; i < 4; i++)
      mesh->colors[base + v][i] = m->colors != NULL ? m->colors[v][i] : 1;
}

/* Where the next of each kind goes. */
struct cursor {
  uint32_t vertex, triangle, edge, point;
};

static void put_primitive(const struct part_mesh *m, struct cursor *at, struct lod_mesh *mesh) {
  put_attributes(m, at->vertex, mesh);
  for (uint32_t i = 0; m->mode == 4 && i + 2 < m->index_count; i += 3, at->triangle++) {
    for (int c = 0; c < 3; c++) {
      mesh->triangles[at->triangle][c] = at->vertex + m->indices[i + (uint32_t)c];
      if (mesh->corners != NULL)
        mesh->corners[at->triangle][c] = mesh->triangles[at->triangle][c];
    }
    mesh->parts[at->triangle] = m->part;
    mesh->materials[at->triangle] = m->material;
  }
  for (uint32_t i = 0; m->mode == 1 && i + 1 < m->index_count; i += 2, at->edge++) {
    mesh->edges[at->edge][0] = at->vertex + m->indices[i];
    mesh->edges[at->edge][1] = at->vertex + m->indices[i + 1];
    if (m->thickness != NULL)
      mesh->edge_thickness[at->edge] = m->thickness[m->indices[i]];
    mesh->edge_parts[at->edge] = m->part;
    mesh->edge_materials[at->edge] = m->material;
  }
  for (uint32_t i = 0; m->mode == 0 && i < m->vertex_count; i++, at->point++) {
    mesh->points[at->point] = at->vertex + i;
    if (m->thickness != NULL)
      mesh->point_thickness[at->point] = m->thickness[i];
    mesh->point_parts[at->point] = m->part;
    mesh->point_materials[at->point] = m->material;
  }
  at->vertex += m->vertex_count;
}

static enum lod_status put_unit_together(struct reader *r, const struct part_mesh *list, struct lod_arena *arena, struct lod_mesh *mesh) {
  const struct totals sum = sum_up(list);
  if (sum.vertices >= LOD_NONE || sum.triangles >= LOD_NONE || sum.edges >= LOD_NONE)
    return lod_fail(r->problem, LOD_LIMIT, "limit-vertices", "GLB level: a unit has more than 2^32 - 2 vertices, triangles or edges");
  struct lod_mesh loose;
  if (!allocate_unit(&sum, r->scratch, &loose))
    return lod_fail_memory(r->problem);
  struct cursor at = {0};
  for (const struct part_mesh *m = list; m != NULL; m = m->next)
    put_primitive(m, &at, &loose);
  enum lod_status status = lod_mesh_weld(&loose, arena, mesh, NULL);
  return status == LOD_MEMORY ? lod_fail_memory(r->problem) : status;
}

/* ---- the whole ---- */

static enum lod_status read_materials(struct reader *r) {
  json_t *list = json_object_get(json_object_get(r->root, "extras"), "materials");
  r->material_count = json_array_size(json_object_get(r->root, "materials"));
  r->material_of = LOD_NEW(r->scratch, r->material_count, uint32_t);
  if (r->material_of == NULL)
    return lod_fail_memory(r->problem);
  for (size_t i = 0; i < r->material_count; i++) {
    json_t *number = list != NULL ? json_array_get(list, i) : NULL;
    const json_int_t material = list == NULL ? (json_int_t)i : json_is_integer(number) ? json_integer_value(number) : -1;
    if (material < 0 || material >= (json_int_t)r->model->material_count)
      return bad(r, "material %zu is none of the model's", i);
    r->material_of[i] = (uint32_t)material;
  }
  return LOD_OK;
}

/* Into lists by unit, in the order of the file. */
static enum lod_status read_primitives(struct reader *r, struct part_mesh **first) {
  struct part_mesh **last = LOD_NEW_ZERO(r->scratch, r->model->unit_count, struct part_mesh *);
  if (last == NULL)
    return lod_fail_memory(r->problem);
  size_t i, k;
  json_t *mesh, *json;
  json_array_foreach(json_object_get(r->root, "meshes"), i, mesh) {
    json_int_t part;
    const json_int_t missing = r->model->part_count == 1 ? 0 : -1;
    if (r->model->part_count == 0 ||
        !get_number(json_object_get(mesh, "extras"), "part", missing, (json_int_t)r->model->part_count - 1, &part))
      return bad(r, "mesh %zu does not say which part of the model it is", i);
    const uint32_t unit = r->model->parts[part].unit;
    json_array_foreach(json_object_get(mesh, "primitives"), k, json) {
      struct part_mesh *m = LOD_NEW(r->scratch, 1, struct part_mesh);
      if (m == NULL)
        return lod_fail_memory(r->problem);
      LOD_TRY(get_primitive(r, json, (uint32_t)part, m));
      if (last[unit] == NULL)
        first[unit] = m;
      else
        last[unit]->next = m;
      last[unit] = m;
    }
  }
  return LOD_OK;
}

static enum lod_status read_all(struct reader *r, const uint8_t *bytes, size_t size, struct lod_arena *arena, struct lod_mesh *meshes) {
  LOD_TRY(open_container(r, bytes, size));
  LOD_TRY(read_materials(r));
  struct part_mesh **first = LOD_NEW_ZERO(r->scratch, r->model->unit_count, struct part_mesh *);
  if (first == NULL)
    return lod_fail_memory(r->problem);
  LOD_TRY(read_primitives(r, first));
  for (uint32_t u = 0; u < r->model->unit_count; u++)
    LOD_TRY(put_unit_together(r, first[u], arena, &meshes[u]));
  return LOD_OK;
}

enum lod_status lod_glb_read(const uint8_t *bytes, size_t size, const struct lod_model *model, struct lod_arena *arena,
                             struct lod_mesh *meshes, struct lod_problem *problem) {
  struct reader r = {.model = model, .problem = problem, .scratch = lod_arena_create_child(arena)};
  if (r.scratch == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = read_all(&r, bytes, size, arena, meshes);
  json_decref(r.root);
  lod_arena_destroy(r.scratch);
  return status;
}
