/* Meshes of a glTF document: primitives decoded (plain, quantised, Draco), strips and fans unrolled, skins applied, joined by the set of
 * attributes that they have.
 *
 * Based on: Khronos. glTF 2.0 Specification, 3.7; KHR_draco_mesh_compression; KHR_mesh_quantization. */
#include <math.h>
#include <string.h>

#include "codec/export/draco.h"
#include "codec/import/gltf_document.h"

/* One primitive, in its own vertex numbers. */
struct decoded {
  struct lod_mesh mesh; /* vertex_count, positions, attributes by vertex; triangles or edges or points */
  uint32_t group, material, first_vertex;
  bool shares_vertices; /* with the primitive before it in the group */
  double rounding;
};

struct skin {
  const double (*joints)[16];
  uint32_t joint_count;
};

struct source {
  struct lod_gltf_document *document;
  const struct lod_gltf_primitive *primitive;
  uint32_t mesh_number, number; /* for sentences */
  const json_t *draco_names;    /* attribute name -> id; NULL = no Draco */
  struct lod_draco_mesh draco;
};

static enum lod_status bad(struct source *source, const char *type, const char *what) {
  return lod_reader_bad(source->document->reader, type, "meshes[%u].primitives[%u] %s", source->mesh_number, source->number, what);
}

/* --- Draco --- */

static enum lod_status open_draco(struct source *source) {
  struct lod_gltf_document *document = source->document;
  struct lod_reader *reader = document->reader;
  const json_t *mesh = lod_gltf_object(document, "meshes", source->mesh_number);
  const json_t *primitive = json_array_get(json_object_get(mesh, "primitives"), source->number);
  const json_t *extension = lod_gltf_extension(primitive, "KHR_draco_mesh_compression");
  int32_t view;
  if (!extension)
    return LOD_OK;
  const json_t *names = json_object_get(extension, "attributes");
  LOD_TRY(lod_gltf_index(document, extension, "KHR_draco_mesh_compression", "bufferView", document->gltf.view_count, &view));
  if (view < 0 || !json_is_object(names))
    return bad(source, "bad-json", "has KHR_draco_mesh_compression without bufferView or attributes");
  const uint8_t *bytes = NULL;
  size_t size = 0;
  LOD_TRY(lod_gltf_view_bytes(document, (uint32_t)view, &bytes, &size));
  struct lod_draco_limits limits = {reader->limits.max_vertices - reader->vertices, reader->limits.max_triangles - reader->triangles};
  /* 0 would mean no limit. */
  limits.max_vertices += limits.max_vertices == 0;
  limits.max_triangles += limits.max_triangles == 0;
  struct lod_problem problem = {0};
  enum lod_status status = lod_draco_decode(bytes, size, &limits, reader->scratch, &source->draco, &problem);
  if (status == LOD_OK) {
    source->draco_names = names;
    return LOD_OK;
  }
  /* Primitives that carry plain data too, for readers without Draco. */
  if (status == LOD_UNSUPPORTED && document->gltf.accessors[source->primitive->position].view >= 0) {
    lod_scene_warn(reader->scene, "A Draco-compressed primitive could not be decoded; its uncompressed copy was used.");
    return LOD_OK;
  }
  return lod_reader_fail(reader, status, problem.type, "meshes[%u].primitives[%u]: %s", source->mesh_number, source->number,
                         problem.detail);
}

/* An attribute's values, `components` floats a vertex, from Draco where it has them, else from the accessor. */
static enum lod_status read_attribute(struct source *source, const char *name, int32_t accessor_number, int components, bool as_normalized,
                                      uint32_t vertex_count, float **values) {
  struct lod_gltf_document *document = source->document;
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[accessor_number];
  const json_t *id = source->draco_names ? json_object_get(source->draco_names, name) : NULL;
  if (id) {
    json_int_t unique_id = json_integer_value(id);
    const struct lod_draco_attribute *found =
        json_is_integer(id) && unique_id >= 0 && unique_id <= UINT32_MAX ? lod_draco_find(&source->draco, (uint32_t)unique_id) : NULL;
    if (!found || found->components != components)
      return bad(source, "bad-draco", "names a Draco attribute that is missing or has another number of components");
    struct lod_draco_attribute attribute = *found;
    attribute.normalized = attribute.component != LOD_DRACO_FLOAT && (accessor->normalized || as_normalized);
    *values = lod_draco_floats(&source->draco, &attribute, document->reader->scratch);
    return *values ? LOD_OK : lod_reader_memory(document->reader);
  }
  if (accessor->count != vertex_count)
    return bad(source, "bad-accessor", "has attributes of different counts");
  return lod_gltf_read_floats(document, (uint32_t)accessor_number, components, as_normalized, values);
}

/* --- vertices --- */

static enum lod_status read_positions(struct source *source, struct decoded *out) {
  struct lod_gltf_document *document = source->document;
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[source->primitive->position];
  uint64_t count = source->draco_names ? source->draco.point_count : accessor->count;
  float *positions;
  if (!source->draco_names)
    LOD_TRY(lod_gltf_check_fits(document, (uint32_t)source->primitive->position));
  LOD_TRY(lod_reader_add_vertices(document->reader, count));
  if (accessor->component == LOD_GLTF_UINT)
    return bad(source, "bad-accessor", "has positions of 32-bit integers");
  out->mesh.vertex_count = (uint32_t)count;
  LOD_TRY(read_attribute(source, "POSITION", source->primitive->position, 3, false, out->mesh.vertex_count, &positions));
  out->mesh.positions = (float(*)[3])(void *)positions;
  /* Integers over 127, 255, ... are at most 1: half a unit in the last place of a float below 1, three axes, and a little for the division.
   */
  out->rounding = accessor->normalized && accessor->component != LOD_GLTF_FLOAT ? 1.74 * 0x1p-25 : 0;
  return LOD_OK;
}

static enum lod_status read_colors(struct source *source, struct lod_mesh *mesh) {
  struct lod_gltf_document *document = source->document;
  int components = document->gltf.accessors[source->primitive->color].components;
  float *values;
  if (components != 3 && components != 4)
    return bad(source, "bad-accessor", "has colours that are neither RGB nor RGBA");
  LOD_TRY(read_attribute(source, "COLOR_0", source->primitive->color, components, true, mesh->vertex_count, &values));
  if (components == 4) {
    mesh->colors = (float(*)[4])(void *)values;
    return LOD_OK;
  }
  mesh->colors = lod_arena_alloc(document->reader->scratch, mesh->vertex_count, sizeof *mesh->colors);
  if (!mesh->colors)
    return lod_reader_memory(document->reader);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    memcpy(mesh->colors[v], values + 3 * (size_t)v, 3 * sizeof(float));
    mesh->colors[v][3] = 1;
  }
  return LOD_OK;
}

/* An interest of the model's own (refine: attribute=doi) travels as the colours' alpha, the one channel that all families and coders carry
 * and that an opaque material does not draw. */
static enum lod_status read_interest(struct source *source, struct lod_mesh *mesh) {
  struct lod_gltf_document *document = source->document;
  const struct lod_gltf_primitive *primitive = source->primitive;
  const json_t *material = primitive->material >= 0 ? lod_gltf_object(document, "materials", (uint32_t)primitive->material) : NULL;
  const char *mode = json_string_value(json_object_get(material, "alphaMode"));
  float *values;
  if (document->gltf.accessors[primitive->interest].components != 1)
    return bad(source, "bad-accessor", "has a _DOI that is no scalar");
  LOD_TRY(read_attribute(source, "_DOI", primitive->interest, 1, true, mesh->vertex_count, &values));
  if (!mesh->colors) {
    mesh->colors = lod_arena_alloc(document->reader->scratch, mesh->vertex_count, sizeof *mesh->colors);
    if (!mesh->colors)
      return lod_reader_memory(document->reader);
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
      mesh->colors[v][0] = mesh->colors[v][1] = mesh->colors[v][2] = mesh->colors[v][3] = 1;
  }
  if (mode && strcmp(mode, "OPAQUE") != 0) {
    lod_scene_warn(document->reader->scene, "_DOI of a primitive whose material is not opaque was dropped: it would change its looks.");
    return LOD_OK;
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    mesh->colors[v][3] = values[v] >= 0 ? fminf(values[v], 1) : 0;
  return LOD_OK;
}

static enum lod_status read_attributes(struct source *source, struct decoded *out) {
  const struct lod_gltf_primitive *primitive = source->primitive;
  struct lod_mesh *mesh = &out->mesh;
  float *values;
  if (primitive->normal >= 0) {
    LOD_TRY(read_attribute(source, "NORMAL", primitive->normal, 3, false, mesh->vertex_count, &values));
    mesh->normals = (float(*)[3])(void *)values;
  }
  for (int set = 0; set < LOD_UV_SETS; set++) {
    if (primitive->uv[set] < 0)
      continue;
    LOD_TRY(read_attribute(source, set ? "TEXCOORD_1" : "TEXCOORD_0", primitive->uv[set], 2, false, mesh->vertex_count, &values));
    mesh->uvs[set] = (float(*)[2])(void *)values;
  }
  if (primitive->epsilon >= 0)
    LOD_TRY(read_attribute(source, "_EPSILON", primitive->epsilon, 1, false, mesh->vertex_count, &mesh->limits));
  if (primitive->color >= 0)
    LOD_TRY(read_colors(source, mesh));
  return primitive->interest >= 0 ? read_interest(source, mesh) : LOD_OK;
}

/* --- skin --- */

struct influences {
  int sets;
  float *joints[LOD_GLTF_SKIN_SETS], *weights[LOD_GLTF_SKIN_SETS]; /* 4 a vertex each */
};

static enum lod_status read_influences(struct source *source, uint32_t vertex_count, struct influences *influences) {
  static const char *const kJoints[] = {"JOINTS_0", "JOINTS_1", "JOINTS_2", "JOINTS_3"};
  static const char *const kWeights[] = {"WEIGHTS_0", "WEIGHTS_1", "WEIGHTS_2", "WEIGHTS_3"};
  const struct lod_gltf_primitive *primitive = source->primitive;
  influences->sets = 0;
  for (int set = 0; set < LOD_GLTF_SKIN_SETS; set++) {
    if (primitive->joints[set] < 0 || primitive->weights[set] < 0)
      break;
    LOD_TRY(read_attribute(source, kJoints[set], primitive->joints[set], 4, false, vertex_count, &influences->joints[set]));
    LOD_TRY(read_attribute(source, kWeights[set], primitive->weights[set], 4, true, vertex_count, &influences->weights[set]));
    influences->sets++;
  }
  return LOD_OK;
}

/* The joints' matrices of one vertex blended by its weights, and the same with absolute values (for the bound on rounding). */
static enum lod_status blend(struct source *source, const struct skin *skin, const struct influences *influences, uint32_t v,
                             double matrix[16], double absolute[16]) {
  double sum = 0;
  memset(matrix, 0, 16 * sizeof *matrix);
  memset(absolute, 0, 16 * sizeof *absolute);
  for (int i = 0; i < 4 * influences->sets; i++) {
    double weight = (double)influences->weights[i / 4][4 * (size_t)v + (size_t)(i % 4)];
    float joint = influences->joints[i / 4][4 * (size_t)v + (size_t)(i % 4)];
    if (!(weight > 0) || !isfinite(weight))
      continue;
    if (!(joint >= 0) || joint >= (float)skin->joint_count)
      return bad(source, "index-out-of-range", "has a vertex that hangs on a joint which its skin does not have");
    const double *m = skin->joints[(uint32_t)joint];
    for (int k = 0; k < 16; k++) {
      matrix[k] += weight * m[k];
      absolute[k] += weight * fabs(m[k]);
    }
    sum += weight;
  }
  if (!(sum > 0)) {
    /* No weight at all: the first joint carries it. */
    for (int k = 0; k < 16; k++)
      absolute[k] = fabs(matrix[k] = skin->joints[0][k]);
    return LOD_OK;
  }
  for (int k = 0; k < 16; k++) {
    matrix[k] /= sum;
    absolute[k] /= sum;
  }
  return LOD_OK;
}

static void skin_normal(const double m[16], float n[3]) {
  struct lod_vec3 x = {m[0], m[1], m[2]}, y = {m[4], m[5], m[6]}, z = {m[8], m[9], m[10]};
  struct lod_vec3 yz = lod_vec3_cross(y, z), zx = lod_vec3_cross(z, x), xy = lod_vec3_cross(x, y);
  double sign = lod_vec3_dot(x, yz) < 0 ? -1 : 1;
  struct lod_vec3 sum = lod_vec3_scale(yz, sign * (double)n[0]);
  sum = lod_vec3_add_scaled(sum, zx, sign * (double)n[1]);
  lod_vec3_to_float(lod_vec3_normalize(lod_vec3_add_scaled(sum, xy, sign * (double)n[2])), n);
}

/* Every vertex to where its joints put it: rounding is what the float takes away, and at most 32 roundings of the blend and the product. */
static enum lod_status apply_skin(struct source *source, const struct skin *skin, struct decoded *out) {
  struct influences influences;
  struct lod_mesh *mesh = &out->mesh;
  LOD_TRY(read_influences(source, mesh->vertex_count, &influences));
  if (influences.sets == 0 || skin->joint_count == 0)
    return LOD_OK;
  double worst = 0, stretch = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    double m[16], absolute[16], squared = 0;
    float p[3];
    LOD_TRY(blend(source, skin, &influences, v, m, absolute));
    memcpy(p, mesh->positions[v], sizeof p);
    for (int row = 0; row < 3; row++) {
      double value = m[row] * (double)p[0] + m[4 + row] * (double)p[1] + m[8 + row] * (double)p[2] + m[12 + row];
      double size = absolute[row] * fabs((double)p[0]) + absolute[4 + row] * fabs((double)p[1]) + absolute[8 + row] * fabs((double)p[2]) +
                    absolute[12 + row];
      mesh->positions[v][row] = (float)value;
      double off = fabs(value - (double)(float)value) + 32 * 0x1p-53 * size;
      squared += isfinite(off) ? off * off : 0;
    }
    worst = fmax(worst, squared);
    if (out->rounding > 0)
      stretch = fmax(stretch, lod_matrix_stretch(m));
    if (mesh->normals)
      skin_normal(m, mesh->normals[v]);
  }
  out->rounding = out->rounding * stretch + sqrt(worst) * (1 + 0x1p-50);
  return LOD_OK;
}

/* --- triangles, lines, points --- */

static uint64_t element_count(int32_t mode, uint64_t indices) {
  switch (mode) {
  case LOD_GLTF_TRIANGLES:
    return indices / 3;
  case LOD_GLTF_STRIP:
  case LOD_GLTF_FAN:
    return indices >= 3 ? indices - 2 : 0;
  case LOD_GLTF_LINES:
    return indices / 2;
  case LOD_GLTF_LINE_STRIP:
    return indices >= 2 ? indices - 1 : 0;
  case LOD_GLTF_LINE_LOOP:
    return indices >= 2 ? indices : 0;
  default:
    return indices;
  }
}

/* at(i): the i-th index of the primitive. */
static uint32_t at(const uint32_t *indices, uint64_t i) {
  return indices ? indices[i] : (uint32_t)i;
}

static enum lod_status fill_triangles(struct source *source, struct lod_mesh *mesh, const uint32_t *indices, uint32_t count) {
  int32_t mode = source->primitive->mode;
  mesh->triangles = lod_arena_alloc(source->document->reader->scratch, count, sizeof *mesh->triangles);
  if (!mesh->triangles)
    return lod_reader_memory(source->document->reader);
  for (uint32_t i = 0; i < count; i++) {
    uint64_t first = mode == LOD_GLTF_TRIANGLES ? 3 * (uint64_t)i : (mode == LOD_GLTF_FAN ? 0 : i);
    uint64_t second = mode == LOD_GLTF_TRIANGLES ? first + 1 : (uint64_t)i + 1, third = second + 1;
    if (mode == LOD_GLTF_STRIP) { /* 3.7.2.1: (i, i + (1 + i % 2), i + (2 - i % 2)) */
      second = (uint64_t)i + 1 + i % 2;
      third = (uint64_t)i + 2 - i % 2;
    }
    uint32_t *t = mesh->triangles[mesh->triangle_count];
    t[0] = at(indices, first);
    t[1] = at(indices, second);
    t[2] = at(indices, third);
    /* Strips are sewn together by triangles without area. */
    bool sewing = mode == LOD_GLTF_STRIP && (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]);
    mesh->triangle_count += !sewing;
  }
  return LOD_OK;
}

static enum lod_status fill_lines_or_points(struct source *source, struct lod_mesh *mesh, const uint32_t *indices, uint64_t index_count,
                                            uint32_t count) {
  struct lod_arena *scratch = source->document->reader->scratch;
  int32_t mode = source->primitive->mode;
  if (mode == LOD_GLTF_POINTS) {
    mesh->points = LOD_NEW(scratch, count, uint32_t);
    if (!mesh->points)
      return lod_reader_memory(source->document->reader);
    for (uint32_t i = 0; i < count; i++)
      mesh->points[i] = at(indices, i);
    mesh->point_count = count;
    return LOD_OK;
  }
  mesh->edges = lod_arena_alloc(scratch, count, sizeof *mesh->edges);
  if (!mesh->edges)
    return lod_reader_memory(source->document->reader);
  for (uint32_t i = 0; i < count; i++) {
    uint64_t first = mode == LOD_GLTF_LINES ? 2 * (uint64_t)i : i;
    mesh->edges[i][0] = at(indices, first);
    mesh->edges[i][1] = at(indices, (first + 1) % index_count);
  }
  mesh->edge_count = count;
  return LOD_OK;
}

static enum lod_status read_elements(struct source *source, struct decoded *out) {
  struct lod_gltf_document *document = source->document;
  const struct lod_gltf_primitive *primitive = source->primitive;
  struct lod_mesh *mesh = &out->mesh;
  if (source->draco_names) {
    LOD_TRY(lod_reader_add_triangles(document->reader, source->draco.triangle_count));
    mesh->triangles = source->draco.triangles;
    mesh->triangle_count = source->draco.triangle_count;
    return LOD_OK;
  }
  bool indexed = primitive->indices >= 0;
  uint64_t index_count = indexed ? document->gltf.accessors[primitive->indices].count : mesh->vertex_count;
  uint64_t count = element_count(primitive->mode, index_count);
  uint32_t *indices = NULL;
  if (indexed)
    LOD_TRY(lod_gltf_check_fits(document, (uint32_t)primitive->indices));
  LOD_TRY(lod_reader_add_triangles(document->reader, count));
  /* Counts beyond what elements need (two indices of a triangle) are bounded with them. */
  if (indexed && index_count > 3 * (count + 1))
    return bad(source, "bad-accessor", "has a wrong number of indices");
  if (indexed)
    LOD_TRY(lod_gltf_read_integers(document, (uint32_t)primitive->indices, 1, &indices));
  for (uint64_t i = 0; indexed && i < index_count; i++)
    if (indices[i] >= mesh->vertex_count)
      return lod_reader_bad(document->reader, "index-out-of-range",
                            "meshes[%u].primitives[%u]: index %llu is %u, but there are %u vertices", source->mesh_number, source->number,
                            (unsigned long long)i, indices[i], mesh->vertex_count);
  bool whole = primitive->mode == LOD_GLTF_TRIANGLES ? index_count % 3 == 0 : primitive->mode != LOD_GLTF_LINES || index_count % 2 == 0;
  if (!whole)
    lod_scene_warn(document->reader->scene, "A primitive has indices left over that make no whole triangle or line.");
  if (primitive->mode >= LOD_GLTF_TRIANGLES)
    return fill_triangles(source, mesh, indices, (uint32_t)count);
  return fill_lines_or_points(source, mesh, indices, index_count, (uint32_t)count);
}

/* --- joining --- */

static uint32_t group_of(const struct lod_gltf_primitive *primitive) {
  return (uint32_t)(primitive->normal >= 0) | (uint32_t)(primitive->uv[0] >= 0) << 1 | (uint32_t)(primitive->uv[1] >= 0) << 2 |
         (uint32_t)(primitive->color >= 0 || primitive->interest >= 0) << 3 | (uint32_t)(primitive->epsilon >= 0) << 4;
}

static bool same_vertices(const struct lod_gltf_primitive *a, const struct lod_gltf_primitive *b) {
  return a->position == b->position && a->normal == b->normal && memcmp(a->uv, b->uv, sizeof a->uv) == 0 && a->color == b->color &&
         a->interest == b->interest && a->epsilon == b->epsilon && memcmp(a->joints, b->joints, sizeof a->joints) == 0 &&
         memcmp(a->weights, b->weights, sizeof a->weights) == 0;
}

static void warn_dropped(struct source *source) {
  struct lod_scene *scene = source->document->reader->scene;
  const json_t *mesh = lod_gltf_object(source->document, "meshes", source->mesh_number);
  const json_t *primitive = json_array_get(json_object_get(mesh, "primitives"), source->number);
  if (source->primitive->has_tangent)
    lod_scene_warn(scene, "Tangents were dropped; viewers compute them from normals and texture coordinates.");
  if (source->primitive->has_other)
    lod_scene_warn(scene,
                   "Vertex attributes other than POSITION, NORMAL, TEXCOORD_0, TEXCOORD_1, COLOR_0, _DOI and _EPSILON were dropped.");
  if (json_array_size(json_object_get(primitive, "targets")) > 0)
    lod_scene_warn(scene, "Morph targets were dropped; the model is in its rest pose.");
}

/* previous: the primitive before it in its group, whose vertices it may share; NULL = none. */
static enum lod_status decode(struct source *source, struct lod_gltf_materials *materials, const struct skin *skin,
                              const struct lod_gltf_primitive *previous, const struct decoded *previous_decoded, struct decoded *out) {
  const struct lod_gltf_primitive *primitive = source->primitive;
  *out = (struct decoded){.group = group_of(primitive)};
  if (primitive->position < 0) {
    lod_scene_warn(source->document->reader->scene, "A primitive without positions was dropped.");
    return LOD_OK;
  }
  warn_dropped(source);
  LOD_TRY(lod_gltf_material(source->document, materials, primitive->material, &out->material));
  LOD_TRY(open_draco(source));
  if (previous && !source->draco_names && same_vertices(previous, primitive)) {
    out->mesh = previous_decoded->mesh;
    out->mesh.triangles = NULL;
    out->mesh.edges = NULL;
    out->mesh.points = NULL;
    out->mesh.triangle_count = out->mesh.edge_count = out->mesh.point_count = 0;
    out->rounding = previous_decoded->rounding;
    out->shares_vertices = true;
  } else {
    LOD_TRY(read_positions(source, out));
    LOD_TRY(read_attributes(source, out));
    if (skin->joints)
      LOD_TRY(apply_skin(source, skin, out));
  }
  return read_elements(source, out);
}

static void append_rows(void *to, const void *from, uint32_t first, uint32_t count, size_t size) {
  if (to && from && count > 0)
    memcpy((char *)to + first * size, from, count * size);
}

static void append(struct lod_mesh *mesh, struct decoded *from) {
  const struct lod_mesh *piece = &from->mesh;
  if (!from->shares_vertices) {
    from->first_vertex = mesh->vertex_count;
    append_rows(mesh->positions, piece->positions, mesh->vertex_count, piece->vertex_count, sizeof *piece->positions);
    append_rows(mesh->limits, piece->limits, mesh->vertex_count, piece->vertex_count, sizeof *piece->limits);
    append_rows(mesh->normals, piece->normals, mesh->vertex_count, piece->vertex_count, sizeof *piece->normals);
    for (int set = 0; set < LOD_UV_SETS; set++)
      append_rows(mesh->uvs[set], piece->uvs[set], mesh->vertex_count, piece->vertex_count, sizeof *piece->uvs[set]);
    append_rows(mesh->colors, piece->colors, mesh->vertex_count, piece->vertex_count, sizeof *piece->colors);
    mesh->vertex_count += piece->vertex_count;
  }
  for (uint32_t t = 0; t < piece->triangle_count; t++, mesh->triangle_count++) {
    for (int k = 0; k < 3; k++)
      mesh->triangles[mesh->triangle_count][k] = from->first_vertex + piece->triangles[t][k];
    mesh->materials[mesh->triangle_count] = from->material;
  }
  for (uint32_t e = 0; e < piece->edge_count; e++, mesh->edge_count++) {
    for (int k = 0; k < 2; k++)
      mesh->edges[mesh->edge_count][k] = from->first_vertex + piece->edges[e][k];
    mesh->edge_materials[mesh->edge_count] = from->material;
  }
  for (uint32_t i = 0; i < piece->point_count; i++, mesh->point_count++) {
    mesh->points[mesh->point_count] = from->first_vertex + piece->points[i];
    mesh->point_materials[mesh->point_count] = from->material;
  }
}

#define ALLOCATE(field, count) ((mesh->field = lod_arena_alloc(arena, (count), sizeof *mesh->field)) != NULL)

static bool allocate_group(struct lod_mesh *mesh, uint32_t group, const uint64_t sizes[4], struct lod_arena *arena) {
  return ALLOCATE(positions, sizes[0]) && (!(group & 1) || ALLOCATE(normals, sizes[0])) && (!(group & 2) || ALLOCATE(uvs[0], sizes[0])) &&
         (!(group & 4) || ALLOCATE(uvs[1], sizes[0])) && (!(group & 8) || ALLOCATE(colors, sizes[0])) &&
         (!(group & 16) || ALLOCATE(limits, sizes[0])) && ALLOCATE(triangles, sizes[1]) && ALLOCATE(materials, sizes[1]) &&
         ALLOCATE(edges, sizes[2]) && ALLOCATE(edge_materials, sizes[2]) && ALLOCATE(points, sizes[3]) &&
         ALLOCATE(point_materials, sizes[3]);
}

static enum lod_status join_group(struct lod_reader *reader, struct decoded *all, uint32_t count, uint32_t group,
                                  struct lod_gltf_pieces *pieces) {
  struct lod_mesh mesh = {0};
  uint64_t sizes[4] = {0};
  uint32_t first_vertex = 0;
  double rounding = 0;
  for (uint32_t i = 0; i < count; i++) {
    if (all[i].group != group)
      continue;
    sizes[0] += all[i].shares_vertices ? 0 : all[i].mesh.vertex_count;
    sizes[1] += all[i].mesh.triangle_count;
    sizes[2] += all[i].mesh.edge_count;
    sizes[3] += all[i].mesh.point_count;
    rounding = fmax(rounding, all[i].rounding);
  }
  if (sizes[1] + sizes[2] + sizes[3] == 0)
    return LOD_OK;
  if (!allocate_group(&mesh, group, sizes, reader->scratch))
    return lod_reader_memory(reader);
  for (uint32_t i = 0; i < count; i++) {
    if (all[i].group != group)
      continue;
    all[i].first_vertex = first_vertex;
    append(&mesh, &all[i]);
    first_vertex = all[i].first_vertex;
  }
  if (lod_scene_share_index(&mesh, reader->scratch) != LOD_OK)
    return lod_reader_memory(reader);
  pieces->meshes[pieces->count] = mesh;
  pieces->rounding[pieces->count++] = rounding;
  return LOD_OK;
}

enum lod_status lod_gltf_read_mesh(struct lod_gltf_document *document, struct lod_gltf_materials *materials, uint32_t number,
                                   const double (*joints)[16], uint32_t joint_count, struct lod_gltf_pieces *pieces) {
  const struct lod_gltf_mesh *mesh = &document->gltf.meshes[number];
  const struct lod_gltf_primitive *primitives = document->gltf.primitives + mesh->first_primitive;
  const struct skin skin = {joints, joint_count};
  struct lod_reader *reader = document->reader;
  int64_t last_of_group[LOD_GLTF_GROUPS];
  memset(last_of_group, 0xFF, sizeof last_of_group);
  pieces->count = 0;
  struct decoded *all = LOD_NEW_ZERO(reader->scratch, mesh->primitive_count, struct decoded);
  if (!all)
    return lod_reader_memory(reader);
  for (uint32_t i = 0; i < mesh->primitive_count; i++) {
    struct source source = {.document = document, .primitive = &primitives[i], .mesh_number = number, .number = i};
    int64_t *last = &last_of_group[group_of(&primitives[i])];
    LOD_TRY(decode(&source, materials, &skin, *last >= 0 ? &primitives[*last] : NULL, *last >= 0 ? &all[*last] : NULL, &all[i]));
    if (primitives[i].position >= 0)
      *last = source.draco_names ? -1 : (int64_t)i;
  }
  for (uint32_t group = 0; group < LOD_GLTF_GROUPS; group++)
    LOD_TRY(join_group(reader, all, mesh->primitive_count, group, pieces));
  return LOD_OK;
}
