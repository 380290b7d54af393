/* glTF 2.0 specification, sections 3 and 4.4 (GLB); KHR_mesh_quantization. */
#include "codec/export/glb_plain.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb_node.h"
#include "codec/export/glb_private.h"

struct plain {
  const struct lod_model *model;
  const struct lod_mesh *mesh;
  const struct lod_glb_plain_settings *settings;
  struct lod_arena *arena, *scratch;
  struct lod_problem *problem;
  struct glb_materials materials;
  json_t *accessors, *views, *meshes, *nodes;
  uint8_t *bin; /* grows in scratch */
  size_t size, room;
  uint32_t *local;  /* wedge (or vertex) -> vertex of the primitive under way; LOD_NONE between */
  uint32_t *global; /* the reverse */
  bool quantised, failed;
};

/* `size` bytes of the binary chunk at a multiple of 4; NULL after failure. */
static uint8_t *take(struct plain *w, size_t size, json_int_t *offset) {
  size_t begin = (w->size + 3) & ~(size_t)3;
  if (w->failed || size > UINT32_MAX || begin + size > UINT32_MAX) {
    w->failed = true;
    return NULL;
  }
  if (begin + size > w->room) {
    size_t room = 2 * w->room > begin + size + 4 ? 2 * w->room : begin + size + 4;
    uint8_t *grown = lod_arena_alloc(w->scratch, room, 1);
    if (grown == NULL) {
      w->failed = true;
      return NULL;
    }
    if (w->size != 0)
      memcpy(grown, w->bin, w->size);
    w->bin = grown;
    w->room = room;
  }
  memset(w->bin + w->size, 0, begin - w->size);
  w->size = begin + size;
  *offset = (json_int_t)begin;
  return w->bin + begin;
}

static uint8_t *take_view(struct plain *w, size_t size, int stride, int target) {
  json_int_t offset = 0;
  uint8_t *bytes = take(w, size, &offset);
  json_t *view = json_pack("{sisIsI}", "buffer", 0, "byteOffset", offset, "byteLength", (json_int_t)size);
  if (stride != 0)
    json_object_set_new(view, "byteStride", json_integer(stride));
  if (target != 0)
    json_object_set_new(view, "target", json_integer(target));
  json_array_append_new(w->views, view);
  return bytes;
}

enum { VERTICES = 34962, INDICES = 34963, BYTE = 5120, UBYTE = 5121, USHORT = 5123, UINT = 5125, FLOAT = 5126 };

/* An accessor over the newest view; returns its number. */
static json_t *accessor(struct plain *w, int component, bool normalized, uint32_t count, const char *type) {
  json_t *json = json_pack("{sIsisIss}", "bufferView", (json_int_t)json_array_size(w->views) - 1, "componentType", component, "count",
                           (json_int_t)count, "type", type);
  if (normalized)
    json_object_set_new(json, "normalized", json_true());
  json_array_append_new(w->accessors, json);
  return json_integer((json_int_t)json_array_size(w->accessors) - 1);
}

static void add_positions(struct plain *w, json_t *attributes, const uint32_t *vertices, uint32_t count) {
  float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
  uint8_t *bytes = take_view(w, 12 * (size_t)count, 0, VERTICES);
  for (uint32_t v = 0; v < count && bytes != NULL; v++) {
    const float *p = w->mesh->positions[vertices[v]];
    memcpy(bytes + 12 * (size_t)v, p, 12);
    for (int i = 0; i < 3; i++) {
      min[i] = p[i] < min[i] ? p[i] : min[i];
      max[i] = p[i] > max[i] ? p[i] : max[i];
    }
  }
  json_object_set_new(attributes, "POSITION", accessor(w, FLOAT, false, count, "VEC3"));
  json_t *json = json_array_get(w->accessors, json_array_size(w->accessors) - 1);
  json_object_set_new(json, "min", json_pack("[fff]", (double)min[0], (double)min[1], (double)min[2]));
  json_object_set_new(json, "max", json_pack("[fff]", (double)max[0], (double)max[1], (double)max[2]));
}

static int8_t normal_byte(float x) {
  float scaled = x * 127;
  return (int8_t)(scaled < 0 ? scaled - 0.5f : scaled + 0.5f);
}
static uint8_t color_byte(float x) {
  return (uint8_t)(x <= 0 ? 0 : x >= 1 ? 255 : x * 255 + 0.5f);
}

/* A normal of no length (beside triangles without area) is none that glTF knows. */
static void put_normal(uint8_t *to, const float n[3]) {
  static const float kUp[3] = {0, 0, 1};
  const float *from = n[0] == 0 && n[1] == 0 && n[2] == 0 ? kUp : n;
  for (int i = 0; i < 3; i++)
    to[i] = (uint8_t)normal_byte(from[i]);
  to[3] = 0;
}

static void add_wedge_attributes(struct plain *w, json_t *attributes, const struct lod_part *part, uint8_t uv_used, const uint32_t *wedges,
                                 uint32_t count, bool normals) {
  static const char *const kSets[LOD_UV_SETS] = {"TEXCOORD_0", "TEXCOORD_1"};
  const struct lod_mesh *mesh = w->mesh;
  if (normals && mesh->normals != NULL) {
    uint8_t *bytes = take_view(w, 4 * (size_t)count, 4, VERTICES);
    for (uint32_t v = 0; v < count && bytes != NULL; v++)
      put_normal(bytes + 4 * (size_t)v, mesh->normals[wedges[v]]);
    json_object_set_new(attributes, "NORMAL", accessor(w, BYTE, true, count, "VEC3"));
    w->quantised = true;
  }
  bool sets[LOD_UV_SETS];
  for (int set = 0; set < LOD_UV_SETS; set++)
    sets[set] = part->has_uv[set] && mesh->uvs[set] != NULL && (uv_used >> set & 1) != 0;
  sets[0] |= sets[1] && mesh->uvs[0] != NULL; /* glTF counts sets from 0 without gaps */
  for (int set = 0; set < LOD_UV_SETS && sets[0]; set++) {
    if (!sets[set])
      continue;
    uint8_t *bytes = take_view(w, 8 * (size_t)count, 0, VERTICES);
    for (uint32_t v = 0; v < count && bytes != NULL; v++)
      memcpy(bytes + 8 * (size_t)v, mesh->uvs[set][wedges[v]], 8);
    json_object_set_new(attributes, kSets[set], accessor(w, FLOAT, false, count, "VEC2"));
  }
  if (part->has_colors && mesh->colors != NULL) {
    uint8_t *bytes = take_view(w, 4 * (size_t)count, 0, VERTICES);
    for (uint32_t v = 0; v < count && bytes != NULL; v++)
      for (int i = 0; i < 4; i++)
        bytes[4 * (size_t)v + (size_t)i] = color_byte(mesh->colors[wedges[v]][i]);
    json_object_set_new(attributes, "COLOR_0", accessor(w, UBYTE, true, count, "VEC4"));
  }
}

static json_t *add_indices(struct plain *w, const uint32_t *indices, size_t count, uint32_t vertices) {
  bool narrow = vertices <= 65535; /* the largest number is reserved */
  uint8_t *bytes = take_view(w, count * (narrow ? 2 : 4), 0, INDICES);
  for (size_t i = 0; i < count && bytes != NULL; i++) {
    if (narrow)
      memcpy(bytes + 2 * i, &(uint16_t){(uint16_t)indices[i]}, 2);
    else
      memcpy(bytes + 4 * i, &indices[i], 4);
  }
  return accessor(w, narrow ? USHORT : UINT, false, (uint32_t)count, "SCALAR");
}

/* ---- groups ---- */

struct group {
  uint32_t part, material, count, *items;
};

static int compare_groups(const void *a, const void *b) {
  const struct group *x = a, *y = b;
  if (x->part != y->part)
    return x->part < y->part ? -1 : 1;
  return x->material < y->material ? -1 : x->material > y->material;
}

struct tags {
  const uint32_t *parts, *materials; /* NULL: 0, LOD_NONE */
  uint32_t count;
};

/* Items by part and material, in their order; groups sorted. False: memory, or a tag out of range (then *range). */
static bool make_groups(struct plain *w, struct tags tags, struct group **result, uint32_t *group_count, bool *range) {
  uint32_t room = 8, count = 0, last = 0;
  struct group *groups = LOD_NEW(w->scratch, room, struct group);
  uint32_t *of = LOD_NEW(w->scratch, tags.count, uint32_t);
  *range = false;
  for (uint32_t i = 0; i < tags.count && groups != NULL && of != NULL; i++) {
    uint32_t part = tags.parts == NULL ? 0 : tags.parts[i], material = tags.materials == NULL ? LOD_NONE : tags.materials[i];
    if (part >= w->model->part_count || (material != LOD_NONE && material >= w->model->material_count)) {
      *range = true;
      return false;
    }
    if (count == 0 || groups[last].part != part || groups[last].material != material)
      for (last = 0; last < count && (groups[last].part != part || groups[last].material != material); last++)
        ;
    if (last == count) {
      if (count == room) {
        struct group *grown = LOD_NEW(w->scratch, 2 * room, struct group);
        if (grown == NULL)
          return false;
        memcpy(grown, groups, count * sizeof *groups);
        groups = grown;
        room *= 2;
      }
      groups[count++] = (struct group){.part = part, .material = material};
    }
    groups[last].count++;
    of[i] = last;
  }
  if (groups == NULL || of == NULL)
    return false;
  for (uint32_t g = 0; g < count; g++) {
    groups[g].items = LOD_NEW(w->scratch, groups[g].count, uint32_t);
    if (groups[g].items == NULL)
      return false;
    groups[g].count = 0;
  }
  for (uint32_t i = 0; i < tags.count; i++)
    groups[of[i]].items[groups[of[i]].count++] = i;
  if (count > 1)
    qsort(groups, count, sizeof *groups, compare_groups);
  *result = groups;
  *group_count = count;
  return true;
}

static uint8_t uv_used(const struct plain *w, uint32_t material) {
  return material == LOD_NONE ? 0 : w->materials.uv_used[material];
}

static void set_material(const struct plain *w, json_t *primitive, uint32_t material) {
  if (material != LOD_NONE)
    json_object_set_new(primitive, "material", json_integer((json_int_t)w->materials.material_index[material]));
}

static json_t *triangles_json(struct plain *w, const struct group *group) {
  const struct lod_mesh *mesh = w->mesh;
  const uint32_t(*corners)[3] = (const uint32_t(*)[3])(mesh->corners != NULL ? mesh->corners : mesh->triangles);
  uint32_t *indices = LOD_NEW(w->scratch, 3 * (size_t)group->count, uint32_t), count = 0;
  json_t *primitive = json_object(), *attributes = json_object();
  if (indices == NULL) {
    w->failed = true;
    return primitive;
  }
  for (uint32_t i = 0; i < group->count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t from = corners[group->items[i]][k], *local = &w->local[from];
      if (*local == LOD_NONE) {
        w->global[count] = from;
        *local = count++;
      }
      indices[3 * (size_t)i + (size_t)k] = *local;
    }
  uint32_t *vertices = LOD_NEW(w->scratch, count, uint32_t);
  w->failed |= vertices == NULL;
  for (uint32_t v = 0; v < count; v++) {
    w->local[w->global[v]] = LOD_NONE;
    if (vertices != NULL)
      vertices[v] = mesh->corners != NULL ? mesh->wedge_vertex[w->global[v]] : w->global[v];
  }
  if (!w->failed) {
    add_positions(w, attributes, vertices, count);
    if (mesh->corners != NULL)
      add_wedge_attributes(w, attributes, &w->model->parts[group->part], uv_used(w, group->material), w->global, count, true);
    json_object_set_new(primitive, "indices", add_indices(w, indices, 3 * (size_t)group->count, count));
  }
  json_object_set_new(primitive, "attributes", attributes);
  set_material(w, primitive, group->material);
  return primitive;
}

/* Edges (ends 2) or points (ends 1), two vertices an edge: they are few. */
static json_t *lines_json(struct plain *w, const struct group *group, uint32_t ends) {
  const struct lod_mesh *mesh = w->mesh;
  size_t count = (size_t)ends * group->count;
  uint32_t *vertices = LOD_NEW(w->scratch, count, uint32_t);
  const float *thickness = ends == 2 ? mesh->edge_thickness : mesh->point_thickness;
  json_t *primitive = json_pack("{si}", "mode", ends == 2 ? 1 : 0), *attributes = json_object();
  w->failed |= vertices == NULL;
  for (size_t i = 0; i < count && vertices != NULL; i++)
    vertices[i] = ends == 2 ? mesh->edges[group->items[i / 2]][i % 2] : mesh->points[group->items[i]];
  if (!w->failed)
    add_positions(w, attributes, vertices, (uint32_t)count);
  if (!w->failed && thickness != NULL) {
    uint8_t *bytes = take_view(w, 4 * count, 0, VERTICES);
    for (size_t i = 0; i < count && bytes != NULL; i++)
      memcpy(bytes + 4 * i, &thickness[group->items[i / ends]], 4);
    json_object_set_new(attributes, "_THICKNESS", accessor(w, FLOAT, false, (uint32_t)count, "SCALAR"));
  }
  json_object_set_new(primitive, "attributes", attributes);
  set_material(w, primitive, group->material);
  return primitive;
}

/* ---- the whole ---- */

enum { KINDS = 3 };

static enum lod_status add_meshes(struct plain *w, struct group *const groups[KINDS], const uint32_t counts[KINDS]) {
  uint32_t at[KINDS] = {0};
  static const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  for (uint32_t p = 0; p < w->model->part_count; p++) {
    json_t *primitives = json_array();
    for (int kind = 0; kind < KINDS; kind++)
      for (; at[kind] < counts[kind] && groups[kind][at[kind]].part == p; at[kind]++) {
        const struct group *group = &groups[kind][at[kind]];
        json_array_append_new(primitives, kind == 0 ? triangles_json(w, group) : lines_json(w, group, kind == 1 ? 2 : 1));
      }
    if (json_array_size(primitives) == 0) {
      json_decref(primitives);
      continue;
    }
    json_t *mesh = json_pack("{so}", "primitives", primitives);
    if (w->model->part_count > 1)
      json_object_set_new(mesh, "extras", json_pack("{sI}", "part", (json_int_t)p));
    json_array_append_new(w->meshes, mesh);
    lod_glb_add_nodes(w->nodes, json_array_size(w->meshes) - 1, w->model->parts[p].name, kIdentity);
  }
  return w->failed ? lod_fail_memory(w->problem) : LOD_OK;
}

static void set_unless_empty(json_t *root, const char *name, json_t *value) {
  if (json_array_size(value) != 0)
    json_object_set(root, name, value);
}

static json_t *root_json(struct plain *w) {
  json_t *asset = json_pack("{ss}", "version", "2.0"), *scene = json_array(), *used = json_array(), *required = json_array(), *value;
  const char *key;
  json_object_set_new(asset, "generator",
                      lod_glb_text(w->settings->generator != NULL ? w->settings->generator : "Lodestream " LOD_VERSION));
  if (w->settings->extras_json != NULL)
    json_object_set_new(asset, "extras", json_loads(w->settings->extras_json, JSON_DECODE_ANY, NULL));
  for (size_t i = 0; i < json_array_size(w->nodes); i++)
    json_array_append_new(scene, json_integer((json_int_t)i));
  json_object_foreach(w->materials.used, key, value) json_array_append_new(used, json_string(key));
  json_object_foreach(w->materials.required, key, value) json_array_append_new(required, json_string(key));
  if (w->quantised) {
    json_array_append_new(used, json_string("KHR_mesh_quantization"));
    json_array_append_new(required, json_string("KHR_mesh_quantization"));
  }
  json_t *root = json_pack("{so}", "asset", asset);
  set_unless_empty(root, "extensionsUsed", used);
  set_unless_empty(root, "extensionsRequired", required);
  json_object_set_new(root, "scene", json_integer(0));
  json_object_set_new(root, "scenes", json_array_size(scene) != 0 ? json_pack("[{sO}]", "nodes", scene) : json_pack("[{}]"));
  set_unless_empty(root, "nodes", w->nodes);
  set_unless_empty(root, "meshes", w->meshes);
  set_unless_empty(root, "materials", w->materials.materials);
  set_unless_empty(root, "textures", w->materials.textures);
  set_unless_empty(root, "samplers", w->materials.samplers);
  set_unless_empty(root, "images", w->materials.images);
  set_unless_empty(root, "accessors", w->accessors);
  set_unless_empty(root, "bufferViews", w->views);
  if (w->size != 0)
    json_object_set_new(root, "buffers", json_pack("[{sI}]", "byteLength", (json_int_t)((w->size + 3) & ~(size_t)3)));
  json_decref(scene);
  json_decref(used);
  json_decref(required);
  return root;
}

static void put_u32(uint8_t *at, size_t value) {
  for (int i = 0; i < 4; i++)
    at[i] = (uint8_t)(value >> 8 * i);
}

static enum lod_status assemble(struct plain *w, uint8_t **bytes, size_t *size) {
  json_t *root = root_json(w);
  char *json = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(9));
  json_decref(root);
  size_t text = json == NULL ? 0 : strlen(json), padded = (text + 3) & ~(size_t)3, bin = (w->size + 3) & ~(size_t)3;
  size_t total = 12 + 8 + padded + (bin != 0 ? 8 + bin : 0);
  enum lod_status status = json == NULL ? lod_fail_memory(w->problem) : LOD_OK;
  if (status == LOD_OK && total > UINT32_MAX)
    status = lod_fail(w->problem, LOD_LIMIT, "limit-bytes", "The mesh takes %zu bytes, more than a GLB can hold (4 GiB).", total);
  uint8_t *out = status == LOD_OK ? lod_arena_alloc(w->arena, total, 1) : NULL;
  if (status == LOD_OK && out == NULL)
    status = lod_fail_memory(w->problem);
  if (status == LOD_OK) {
    memcpy(out, "glTF\2\0\0\0", 8);
    put_u32(out + 8, total);
    put_u32(out + 12, padded);
    memcpy(out + 16, "JSON", 4);
    memset(out + 20, ' ', padded);
    memcpy(out + 20, json, text);
    if (bin != 0) {
      put_u32(out + 20 + padded, bin);
      memcpy(out + 24 + padded, "BIN\0", 4);
      memcpy(out + 28 + padded, w->bin, w->size);
      memset(out + 28 + padded + w->size, 0, bin - w->size);
    }
    *bytes = out;
    *size = total;
  }
  free(json);
  return status;
}

static void embed_images(struct plain *w) {
  for (uint32_t i = 0; i < w->materials.image_count; i++) {
    if (w->materials.embedded[i] == LOD_NONE)
      continue;
    const struct lod_image *image = &w->model->images[w->materials.embedded[i]];
    uint8_t *bytes = take_view(w, image->size, 0, 0);
    if (bytes != NULL)
      memcpy(bytes, image->bytes, image->size);
    json_object_set_new(json_array_get(w->materials.images, i), "bufferView", json_integer((json_int_t)json_array_size(w->views) - 1));
  }
}

static enum lod_status write(struct plain *w, uint8_t **bytes, size_t *size) {
  const struct lod_mesh *mesh = w->mesh;
  const struct tags tags[KINDS] = {{mesh->parts, mesh->materials, mesh->triangle_count},
                                   {mesh->edge_parts, mesh->edge_materials, mesh->edge_count},
                                   {mesh->point_parts, mesh->point_materials, mesh->point_count}};
  struct group *groups[KINDS];
  uint32_t counts[KINDS], items = mesh->corners != NULL ? mesh->wedge_count : mesh->vertex_count;
  bool range, *uses = LOD_NEW_ZERO(w->scratch, w->model->material_count, bool);
  w->local = LOD_NEW(w->scratch, items, uint32_t);
  w->global = LOD_NEW(w->scratch, items, uint32_t);
  w->room = 40 * (size_t)items + 12 * (size_t)mesh->triangle_count + 4096;
  w->bin = lod_arena_alloc(w->scratch, w->room, 1);
  if (uses == NULL || w->local == NULL || w->global == NULL || w->bin == NULL)
    return lod_fail_memory(w->problem);
  memset(w->local, 0xff, items * sizeof *w->local);
  for (int kind = 0; kind < KINDS; kind++) {
    if (!make_groups(w, tags[kind], &groups[kind], &counts[kind], &range))
      return range ? lod_fail(w->problem, LOD_BAD_INPUT, "mesh", "A triangle names a part or material that the model does not have.")
                   : lod_fail_memory(w->problem);
    for (uint32_t g = 0; g < counts[kind]; g++)
      if (groups[kind][g].material != LOD_NONE)
        uses[groups[kind][g].material] = true;
  }
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.image_uris = w->settings->image_uris;
  LOD_TRY(lod_glb_materials_init(w->model, uses, &settings, w->scratch, &w->materials, w->problem));
  LOD_TRY(add_meshes(w, groups, counts));
  embed_images(w);
  return w->failed ? lod_fail_memory(w->problem) : assemble(w, bytes, size);
}

enum lod_status lod_glb_write_plain(const struct lod_model *model, const struct lod_mesh *mesh,
                                    const struct lod_glb_plain_settings *settings, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                                    struct lod_problem *problem) {
  struct plain w = {.model = model,
                    .mesh = mesh,
                    .settings = settings,
                    .arena = arena,
                    .scratch = lod_arena_create_child(arena),
                    .problem = problem,
                    .accessors = json_array(),
                    .views = json_array(),
                    .meshes = json_array(),
                    .nodes = json_array()};
  enum lod_status status = w.scratch == NULL ? lod_fail_memory(problem) : write(&w, bytes, size);
  lod_glb_materials_finish(&w.materials);
  json_decref(w.accessors);
  json_decref(w.views);
  json_decref(w.meshes);
  json_decref(w.nodes);
  lod_arena_destroy(w.scratch);
  return status;
}
