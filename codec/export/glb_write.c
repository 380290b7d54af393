/* Puts a level together as GLB: primitives by (part, material), accessors, nodes, one binary chunk.
 *
 * glTF 2.0 specification, sections 3 and 4.4 (GLB); KHR_draco_mesh_compression. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb_node.h"
#include "codec/export/glb_private.h"
#include "core/base/parallel.h"

struct lod_glb_settings lod_glb_defaults(void) {
  return (struct lod_glb_settings){
      .normal_bits = 8, .uv_bits = 12, .color_bits = 8, .draco_speed = -1, .threads = 0, .generator = "Lodestream " LOD_VERSION};
}

/* ---- growing bytes ---- */

struct bytes {
  uint8_t *data;
  size_t size, capacity;
  bool failed;
};

static void append(struct bytes *bytes, const void *data, size_t size) {
  if (bytes->failed)
    return;
  if (size > bytes->capacity - bytes->size) {
    size_t capacity = bytes->capacity < 4096 ? 4096 : bytes->capacity;
    while (capacity - bytes->size < size && capacity < SIZE_MAX / 2)
      capacity *= 2;
    uint8_t *grown = capacity - bytes->size < size ? NULL : realloc(bytes->data, capacity);
    if (grown == NULL) {
      bytes->failed = true;
      return;
    }
    bytes->data = grown;
    bytes->capacity = capacity;
  }
  if (size > 0)
    memcpy(bytes->data + bytes->size, data, size);
  bytes->size += size;
}

static void append_text(struct bytes *bytes, const char *text) {
  append(bytes, text, strlen(text));
}

static void append_padding(struct bytes *bytes, size_t alignment, char filler) {
  while (!bytes->failed && bytes->size % alignment != 0)
    append(bytes, &filler, 1);
}

/* ---- grouping ---- */

/* Everything that is written, in order: unit, part, material, mode. */
struct writer {
  const struct lod_model *model;
  const struct lod_glb_settings *settings;
  struct lod_arena *arena;   /* results */
  struct lod_arena *scratch; /* gone when the GLB is written */
  struct lod_problem *problem;
  struct glb_unit *units;
  uint32_t **order[3]; /* per mode (triangles, lines, points) and unit: items sorted by primitive */
  struct glb_primitive *primitives;
  uint32_t primitive_count, primitive_capacity;
  struct glb_materials materials;
  json_t *accessors, *views, *meshes, *nodes;
  struct bytes bin;
};

enum { MODES = 3 };
static const enum glb_mode kModes[MODES] = {GLB_TRIANGLES, GLB_LINES, GLB_POINTS};

static uint64_t item_key(const struct glb_unit *unit, enum glb_mode mode, uint32_t item) {
  uint32_t part, material;
  if (mode == GLB_TRIANGLES) {
    part = glb_triangle_part(unit, unit->triangles[item]);
    material = glb_triangle_material(unit->mesh, unit->triangles[item]);
  } else if (mode == GLB_LINES) {
    part = unit->edges[item].part;
    material = unit->edges[item].material;
  } else {
    part = unit->points[item].part;
    material = unit->points[item].material;
  }
  return (uint64_t)part << 32 | material;
}

static uint32_t item_count(const struct glb_unit *unit, enum glb_mode mode) {
  return mode == GLB_TRIANGLES ? unit->triangle_count : mode == GLB_LINES ? unit->edge_count : unit->point_count;
}

struct group {
  uint64_t key;
  uint32_t count, begin;
};

static int compare_groups(const void *a, const void *b) {
  const struct group *x = a, *y = b;
  return x->key < y->key ? -1 : x->key > y->key;
}

static uint32_t find_group(const struct group *groups, uint32_t count, uint64_t key) {
  uint32_t low = 0, high = count;
  while (high - low > 1) {
    uint32_t middle = low + (high - low) / 2;
    if (groups[middle].key <= key)
      low = middle;
    else
      high = middle;
  }
  return low;
}

/* The different keys, sorted. Runs of equal keys are counted once before sorting: triangles come by part and material mostly. */
static enum lod_status collect_groups(const struct glb_unit *unit, enum glb_mode mode, uint32_t count, struct lod_arena *scratch,
                                      struct group **groups, uint32_t *group_count) {
  uint32_t runs = 0;
  uint64_t last = 0;
  for (uint32_t i = 0; i < count; i++) {
    uint64_t key = item_key(unit, mode, i);
    runs += i == 0 || key != last;
    last = key;
  }
  struct group *list = LOD_NEW(scratch, runs, struct group);
  if (list == NULL)
    return LOD_MEMORY;
  runs = 0;
  for (uint32_t i = 0; i < count; i++) {
    uint64_t key = item_key(unit, mode, i);
    if (runs == 0 || key != list[runs - 1].key)
      list[runs++] = (struct group){.key = key};
    list[runs - 1].count++;
  }
  qsort(list, runs, sizeof *list, compare_groups);
  uint32_t kept = 0;
  for (uint32_t i = 0; i < runs; i++) {
    if (kept > 0 && list[kept - 1].key == list[i].key)
      list[kept - 1].count += list[i].count;
    else
      list[kept++] = list[i];
  }
  *groups = list;
  *group_count = kept;
  return LOD_OK;
}

static enum lod_status add_primitives(struct writer *w, uint32_t u, int mode, struct group *groups, uint32_t group_count) {
  const struct glb_unit *unit = &w->units[u];
  const uint32_t count = item_count(unit, kModes[mode]);
  if (w->primitive_count + group_count > w->primitive_capacity) {
    uint32_t capacity = 2 * (w->primitive_count + group_count) + 16;
    struct glb_primitive *grown = LOD_NEW(w->scratch, capacity, struct glb_primitive);
    if (grown == NULL)
      return LOD_MEMORY;
    if (w->primitive_count > 0)
      memcpy(grown, w->primitives, w->primitive_count * sizeof *grown);
    w->primitives = grown;
    w->primitive_capacity = capacity;
  }
  uint32_t begin = 0;
  for (uint32_t i = 0; i < group_count; i++) {
    const uint32_t part = (uint32_t)(groups[i].key >> 32), material = (uint32_t)groups[i].key;
    if (part >= w->model->part_count || (material != LOD_NONE && material >= w->model->material_count))
      return LOD_BAD_INPUT;
    w->primitives[w->primitive_count++] = (struct glb_primitive){
        .mode = kModes[mode], .unit = u, .part = part, .material = material, .begin = begin, .count = groups[i].count};
    groups[i].begin = begin;
    begin += groups[i].count;
  }
  uint32_t *order = w->order[mode][u] = LOD_NEW(w->scratch, count, uint32_t);
  if (order == NULL)
    return LOD_MEMORY;
  uint32_t group = 0;
  for (uint32_t i = 0; i < count; i++) {
    uint64_t key = item_key(unit, kModes[mode], i);
    if (groups[group].key != key)
      group = find_group(groups, group_count, key);
    order[groups[group].begin++] = i;
  }
  return LOD_OK;
}

static enum lod_status group_items(struct writer *w) {
  for (uint32_t u = 0; u < w->model->unit_count; u++)
    for (int mode = 0; mode < MODES; mode++) {
      uint32_t count = item_count(&w->units[u], kModes[mode]);
      if (count == 0)
        continue;
      struct group *groups;
      uint32_t group_count;
      enum lod_status status = collect_groups(&w->units[u], kModes[mode], count, w->scratch, &groups, &group_count);
      if (status == LOD_OK)
        status = add_primitives(w, u, mode, groups, group_count);
      if (status == LOD_BAD_INPUT)
        return lod_fail(w->problem, status, "mesh", "A level's triangle names a part or material that the model does not have");
      if (status != LOD_OK)
        return lod_fail_memory(w->problem);
    }
  return LOD_OK;
}

/* ---- encoding ---- */

enum { BATCH = 16 };

struct batch {
  struct glb_build builds[BATCH];
  uint32_t count;
};

static void encode_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct batch *batch = context;
  (void)chunk;
  for (size_t i = begin; i < end; i++)
    lod_glb_encode_triangles(&batch->builds[i]);
}

/* Brings what a build made to the writer's own arena and forgets the rest. */
static enum lod_status keep_result(struct writer *w, struct glb_build *build) {
  struct glb_primitive *primitive = build->primitive;
  if (build->status != LOD_OK) {
    if (w->problem != NULL && w->problem->status == LOD_OK)
      *w->problem = build->problem;
    return build->status;
  }
  if (primitive->draco != NULL) {
    primitive->draco = lod_arena_copy(w->scratch, primitive->draco, primitive->draco_size);
    return primitive->draco != NULL ? LOD_OK : lod_fail_memory(w->problem);
  }
  struct glb_array *positions = &primitive->attributes[GLB_POSITION];
  positions->values = lod_arena_copy(w->scratch, positions->values, primitive->vertex_count * sizeof(float[3]));
  primitive->indices = lod_arena_copy(w->scratch, primitive->indices, primitive->index_count * sizeof *primitive->indices);
  return positions->values != NULL && primitive->indices != NULL ? LOD_OK : lod_fail_memory(w->problem);
}

static enum lod_status run_batch(struct writer *w, struct batch *batch) {
  lod_parallel_for(w->settings->threads, batch->count, 1, encode_chunk, batch);
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; i < batch->count; i++) {
    if (status == LOD_OK)
      status = keep_result(w, &batch->builds[i]);
    lod_arena_destroy(batch->builds[i].arena);
  }
  batch->count = 0;
  return status;
}

static uint8_t uv_used_by(const struct writer *w, uint32_t material) {
  return material == LOD_NONE ? 0 : w->materials.uv_used[material];
}

static enum lod_status start_build(struct writer *w, struct glb_primitive *primitive, const struct glb_scratch *scratch,
                                   struct batch *batch) {
  struct glb_build *build = &batch->builds[batch->count];
  *build = (struct glb_build){.arena = lod_arena_create_child(w->scratch), .settings = w->settings, .primitive = primitive};
  if (build->arena == NULL)
    return lod_fail_memory(w->problem);
  batch->count++;
  const uint32_t *order = w->order[0][primitive->unit] + primitive->begin;
  build->status = lod_glb_build_triangles(&w->units[primitive->unit], order, &w->model->parts[primitive->part],
                                          uv_used_by(w, primitive->material), scratch, build);
  if (build->status != LOD_OK)
    return keep_result(w, build);
  return LOD_OK;
}

static enum lod_status encode_primitives(struct writer *w) {
  uint32_t vertices = 0, wedges = 0;
  for (uint32_t u = 0; u < w->model->unit_count; u++) {
    vertices = w->units[u].vertex_count > vertices ? w->units[u].vertex_count : vertices;
    wedges = w->units[u].mesh->wedge_count > wedges ? w->units[u].mesh->wedge_count : wedges;
  }
  struct glb_scratch scratch = {.vertices = LOD_NEW(w->scratch, vertices, uint32_t), .wedges = LOD_NEW(w->scratch, wedges, uint32_t)};
  if (scratch.vertices == NULL || scratch.wedges == NULL)
    return lod_fail_memory(w->problem);
  memset(scratch.vertices, 0xff, vertices * sizeof *scratch.vertices);
  memset(scratch.wedges, 0xff, wedges * sizeof *scratch.wedges);
  struct batch batch = {.count = 0};
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; i < w->primitive_count && status == LOD_OK; i++) {
    struct glb_primitive *primitive = &w->primitives[i];
    if (primitive->mode == GLB_TRIANGLES) {
      status = start_build(w, primitive, &scratch, &batch);
      if (status == LOD_OK && batch.count == BATCH)
        status = run_batch(w, &batch);
      continue;
    }
    const uint32_t *order = w->order[primitive->mode == GLB_LINES ? 1 : 2][primitive->unit] + primitive->begin;
    status = lod_glb_build_lines(&w->units[primitive->unit], order, &w->model->parts[primitive->part], uv_used_by(w, primitive->material),
                                 w->settings, &scratch, w->scratch, primitive, w->problem);
  }
  if (status == LOD_OK)
    return run_batch(w, &batch);
  for (uint32_t i = 0; i < batch.count; i++)
    lod_arena_destroy(batch.builds[i].arena);
  return status;
}

/* ---- JSON of geometry ---- */

static json_t *json_index(size_t index) {
  return json_integer((json_int_t)index);
}

static size_t add_view(struct writer *w, const void *data, size_t size, size_t alignment, int stride, int target) {
  append_padding(&w->bin, alignment, 0);
  json_t *view = json_pack("{sisIsI}", "buffer", 0, "byteOffset", (json_int_t)w->bin.size, "byteLength", (json_int_t)size);
  if (w->bin.size == 0)
    json_object_del(view, "byteOffset");
  if (stride != 0)
    json_object_set_new(view, "byteStride", json_integer(stride));
  if (target != 0)
    json_object_set_new(view, "target", json_integer(target));
  append(&w->bin, data, size);
  json_array_append_new(w->views, view);
  return json_array_size(w->views) - 1;
}

static const char *accessor_type(int components) {
  static const char *const kTypes[] = {"SCALAR", "VEC2", "VEC3", "VEC4"};
  return kTypes[components - 1];
}

enum { TARGET_VERTICES = 34962, TARGET_INDICES = 34963 };

static size_t add_attribute(struct writer *w, const struct glb_primitive *primitive, enum glb_attribute attribute) {
  const struct glb_array *array = &primitive->attributes[attribute];
  json_t *accessor = json_object();
  if (array->values != NULL) {
    size_t stride = (size_t)array->components * lod_draco_component_size(array->component);
    json_object_set_new(accessor, "bufferView",
                        json_index(add_view(w, array->values, stride * primitive->vertex_count, 4, 0, TARGET_VERTICES)));
  }
  json_object_set_new(accessor, "componentType", json_integer(array->component));
  if (attribute == GLB_COLOR_0)
    json_object_set_new(accessor, "normalized", json_true());
  json_object_set_new(accessor, "count", json_integer(primitive->vertex_count));
  json_object_set_new(accessor, "type", json_string(accessor_type(array->components)));
  if (attribute == GLB_POSITION) {
    const float *min = primitive->min, *max = primitive->max;
    json_object_set_new(accessor, "min", json_pack("[fff]", (double)min[0], (double)min[1], (double)min[2]));
    json_object_set_new(accessor, "max", json_pack("[fff]", (double)max[0], (double)max[1], (double)max[2]));
  }
  json_array_append_new(w->accessors, accessor);
  return json_array_size(w->accessors) - 1;
}

static size_t add_indices(struct writer *w, const struct glb_primitive *primitive) {
  json_t *accessor = json_object();
  const uint32_t vertices = primitive->vertex_count;
  /* The largest number of a type is reserved for primitive restart. */
  int component = vertices <= 255 ? LOD_DRACO_UINT8 : vertices <= 65535 ? LOD_DRACO_UINT16 : LOD_DRACO_UINT32;
  if (primitive->draco == NULL) {
    size_t size = lod_draco_component_size((enum lod_draco_component)component);
    uint8_t *narrow = malloc(size * primitive->index_count + 1);
    for (uint32_t i = 0; i < primitive->index_count && narrow != NULL; i++)
      for (size_t byte = 0; byte < size; byte++)
        narrow[i * size + byte] = (uint8_t)(primitive->indices[i] >> (8 * byte));
    w->bin.failed |= narrow == NULL;
    if (narrow != NULL)
      json_object_set_new(accessor, "bufferView", json_index(add_view(w, narrow, size * primitive->index_count, size, 0, TARGET_INDICES)));
    free(narrow);
  }
  json_object_set_new(accessor, "componentType", json_integer(component));
  json_object_set_new(accessor, "count", json_integer(primitive->index_count));
  json_object_set_new(accessor, "type", json_string("SCALAR"));
  json_array_append_new(w->accessors, accessor);
  return json_array_size(w->accessors) - 1;
}

static json_t *primitive_json(struct writer *w, const struct glb_primitive *primitive) {
  json_t *json = json_object(), *attributes = json_object(), *ids = json_object();
  uint32_t id = 0; /* in the order in which glb_primitive.c gave Draco its unique ids */
  for (int attribute = 0; attribute < GLB_ATTRIBUTES; attribute++) {
    if (primitive->attributes[attribute].components == 0)
      continue;
    json_object_set_new(attributes, kGlbAttributeNames[attribute], json_index(add_attribute(w, primitive, (enum glb_attribute)attribute)));
    json_object_set_new(ids, kGlbAttributeNames[attribute], json_integer(id++));
  }
  json_object_set_new(json, "attributes", attributes);
  if (primitive->index_count > 0)
    json_object_set_new(json, "indices", json_index(add_indices(w, primitive)));
  if (primitive->mode != GLB_TRIANGLES)
    json_object_set_new(json, "mode", json_integer(primitive->mode));
  if (primitive->material != LOD_NONE)
    json_object_set_new(json, "material", json_integer(w->materials.material_index[primitive->material]));
  if (primitive->draco != NULL) {
    size_t view = add_view(w, primitive->draco, primitive->draco_size, 1, 0, 0);
    json_object_set_new(json, "extensions",
                        json_pack("{s{sIsO}}", "KHR_draco_mesh_compression", "bufferView", (json_int_t)view, "attributes", ids));
    json_object_set_new(w->materials.used, "KHR_draco_mesh_compression", json_true());
    json_object_set_new(w->materials.required, "KHR_draco_mesh_compression", json_true());
  }
  if (primitive->smooth_normals)
    json_object_set_new(json, "extras", json_pack("{ss}", "normals", "smooth"));
  json_decref(ids);
  return json;
}

static int compare_primitives(const void *a, const void *b) {
  const struct glb_primitive *x = a, *y = b;
  if (x->part != y->part)
    return x->part < y->part ? -1 : 1;
  if (x->mode != y->mode)
    return x->mode > y->mode ? -1 : 1; /* triangles first */
  return x->material < y->material ? -1 : x->material > y->material;
}

/* A mesh for every part that has something left at this level, and its nodes. */
static enum lod_status add_meshes(struct writer *w) {
  if (w->primitive_count > 1)
    qsort(w->primitives, w->primitive_count, sizeof *w->primitives, compare_primitives);
  for (uint32_t begin = 0, end; begin < w->primitive_count; begin = end) {
    const uint32_t p = w->primitives[begin].part;
    const struct lod_part *part = &w->model->parts[p];
    json_t *primitives = json_array();
    for (end = begin; end < w->primitive_count && w->primitives[end].part == p; end++)
      json_array_append_new(primitives, primitive_json(w, &w->primitives[end]));
    json_t *mesh = json_pack("{so}", "primitives", primitives);
    if (w->model->part_count > 1)
      json_object_set_new(mesh, "extras", json_pack("{sI}", "part", (json_int_t)p));
    json_array_append_new(w->meshes, mesh);
    for (uint32_t i = 0; i < part->instance_count; i++)
      lod_glb_add_nodes(w->nodes, json_array_size(w->meshes) - 1, part->name, part->instances[i]);
  }
  return w->bin.failed ? lod_fail_memory(w->problem) : LOD_OK;
}

static void embed_images(struct writer *w) {
  for (uint32_t i = 0; i < w->materials.image_count; i++) {
    if (w->materials.embedded[i] == LOD_NONE)
      continue;
    const struct lod_image *image = &w->model->images[w->materials.embedded[i]];
    json_object_set_new(json_array_get(w->materials.images, i), "bufferView", json_index(add_view(w, image->bytes, image->size, 4, 0, 0)));
  }
}

/* ---- the whole ---- */

/* glTF forbids empty arrays and objects at the top. digits: 9 give every float back exactly, 17 every double. */
static void append_member(struct bytes *out, const char *name, json_t *value, size_t digits) {
  if (json_array_size(value) == 0 && json_object_size(value) == 0 && !json_is_integer(value))
    return;
  char *text = json_dumps(value, JSON_COMPACT | JSON_ENCODE_ANY | JSON_REAL_PRECISION(digits));
  if (text == NULL) {
    out->failed = true;
    return;
  }
  append_text(out, out->size > 1 ? ",\"" : "\"");
  append_text(out, name);
  append_text(out, "\":");
  append_text(out, text);
  free(text);
}

static json_t *keys_of(json_t *object) {
  json_t *keys = json_array();
  const char *key;
  json_t *value;
  json_object_foreach(object, key, value) json_array_append_new(keys, json_string(key));
  return keys;
}

static json_t *asset_json(const struct lod_glb_settings *settings) {
  json_t *asset = json_pack("{ss}", "version", "2.0");
  if (settings->generator != NULL)
    json_object_set_new(asset, "generator", lod_glb_text(settings->generator));
  if (settings->extras_json != NULL) {
    json_error_t error;
    json_t *extras = json_loads(settings->extras_json, JSON_DECODE_ANY, &error);
    if (extras != NULL)
      json_object_set_new(asset, "extras", extras);
  }
  return asset;
}

/* Which material of the model each of ours is, where that is not simply its number. */
static json_t *root_extras(const struct writer *w) {
  json_t *list = json_array();
  bool plain = true;
  for (uint32_t m = 0; m < w->model->material_count; m++) {
    if (w->materials.material_index[m] == LOD_NONE)
      continue;
    plain = plain && w->materials.material_index[m] == m;
    json_array_append_new(list, json_integer(m));
  }
  json_t *extras = json_object();
  if (!plain)
    json_object_set(extras, "materials", list);
  json_decref(list);
  return extras;
}

static void append_json(struct writer *w, struct bytes *out) {
  json_t *roots = json_array(), *child;
  size_t i;
  json_array_foreach(w->nodes, i, child) if (!lod_glb_node_is_child(w->nodes, i)) json_array_append_new(roots, json_index(i));
  json_t *scenes = json_array_size(roots) > 0 ? json_pack("[{sO}]", "nodes", roots) : json_pack("[{}]");
  json_t *buffers = w->bin.size > 0 ? json_pack("[{sI}]", "byteLength", (json_int_t)w->bin.size) : json_array();
  json_t *scene = json_integer(0);
  struct {
    const char *name;
    json_t *value;
    size_t digits;
  } members[] = {
      {"asset", asset_json(w->settings), 17},
      {"extensionsUsed", keys_of(w->materials.used), 9},
      {"extensionsRequired", keys_of(w->materials.required), 9},
      {"scene", scene, 9},
      {"scenes", scenes, 9},
      {"nodes", json_incref(w->nodes), 17},
      {"meshes", json_incref(w->meshes), 9},
      {"materials", json_incref(w->materials.materials), 9},
      {"textures", json_incref(w->materials.textures), 9},
      {"samplers", json_incref(w->materials.samplers), 9},
      {"images", json_incref(w->materials.images), 9},
      {"accessors", json_incref(w->accessors), 9},
      {"bufferViews", json_incref(w->views), 9},
      {"buffers", buffers, 9},
      {"extras", root_extras(w), 9},
  };
  append_text(out, "{");
  for (size_t m = 0; m < sizeof members / sizeof *members; m++) {
    append_member(out, members[m].name, members[m].value, members[m].digits);
    json_decref(members[m].value);
  }
  append_text(out, "}");
  json_decref(roots);
}

static void put_u32(uint8_t *at, size_t value) {
  for (int i = 0; i < 4; i++)
    at[i] = (uint8_t)(value >> (8 * i));
}

static enum lod_status assemble(struct writer *w, uint8_t **bytes, size_t *size) {
  struct bytes json = {0};
  append_json(w, &json);
  append_padding(&json, 4, ' ');
  append_padding(&w->bin, 4, 0);
  enum lod_status status = LOD_OK;
  const size_t bin_chunk = w->bin.size > 0 ? 8 + w->bin.size : 0;
  const size_t total = 12 + 8 + json.size + bin_chunk;
  if (json.failed || w->bin.failed)
    status = lod_fail_memory(w->problem);
  else if (total > UINT32_MAX)
    status = lod_fail(w->problem, LOD_LIMIT, "limit-bytes", "The level takes %zu bytes, more than a GLB can hold (4 GiB)", total);
  uint8_t *out = status == LOD_OK ? lod_arena_alloc(w->arena, total, 1) : NULL;
  if (status == LOD_OK && out == NULL)
    status = lod_fail_memory(w->problem);
  if (status == LOD_OK) {
    memcpy(out, "glTF\2\0\0\0", 8);
    put_u32(out + 8, total);
    put_u32(out + 12, json.size);
    memcpy(out + 16, "JSON", 4);
    memcpy(out + 20, json.data, json.size);
    if (bin_chunk > 0) {
      put_u32(out + 20 + json.size, w->bin.size);
      memcpy(out + 24 + json.size, "BIN\0", 4);
      memcpy(out + 28 + json.size, w->bin.data, w->bin.size);
    }
    *bytes = out;
    *size = total;
  }
  free(json.data);
  return status;
}

static uint32_t first_part_of(const struct lod_model *model, uint32_t unit) {
  for (uint32_t p = 0; p < model->part_count; p++)
    if (model->parts[p].unit == unit)
      return p;
  return 0;
}

static enum lod_status prepare(struct writer *w, const struct lod_mesh *meshes) {
  const struct lod_model *model = w->model;
  w->units = LOD_NEW(w->scratch, model->unit_count, struct glb_unit);
  for (int mode = 0; mode < MODES; mode++)
    w->order[mode] = LOD_NEW_ZERO(w->scratch, model->unit_count, uint32_t *);
  bool *uses = LOD_NEW_ZERO(w->scratch, model->material_count, bool);
  if (w->units == NULL || w->order[0] == NULL || w->order[1] == NULL || w->order[2] == NULL || uses == NULL)
    return lod_fail_memory(w->problem);
  for (uint32_t u = 0; u < model->unit_count; u++) {
    const double scale = model->units[u].scale > 0 ? model->units[u].scale : 1;
    LOD_TRY(
        lod_glb_quantise(&meshes[u], first_part_of(model, u), w->settings->position_error / scale, w->scratch, &w->units[u], w->problem));
  }
  LOD_TRY(group_items(w));
  for (uint32_t i = 0; i < w->primitive_count; i++)
    if (w->primitives[i].material != LOD_NONE)
      uses[w->primitives[i].material] = true;
  return lod_glb_materials_init(model, uses, w->settings, w->scratch, &w->materials, w->problem);
}

static struct lod_glb_settings clamped(const struct lod_glb_settings *settings) {
  struct lod_glb_settings s = *settings;
  s.normal_bits = s.normal_bits < 2 ? 2 : s.normal_bits > 16 ? 16 : s.normal_bits;
  s.uv_bits = s.uv_bits < 1 ? 1 : s.uv_bits > 24 ? 24 : s.uv_bits;
  s.color_bits = s.color_bits < 1 ? 1 : s.color_bits > 16 ? 16 : s.color_bits;
  s.draco_speed = s.draco_speed < -1 ? -1 : s.draco_speed > 10 ? 10 : s.draco_speed;
  return s;
}

enum lod_status lod_glb_write(const struct lod_model *model, const struct lod_mesh *meshes, const struct lod_glb_settings *settings,
                              struct lod_arena *arena, uint8_t **bytes, size_t *size, struct lod_problem *problem) {
  const struct lod_glb_settings safe = clamped(settings);
  struct writer w = {.model = model, .settings = &safe, .arena = arena, .scratch = lod_arena_create_child(arena), .problem = problem};
  if (w.scratch == NULL)
    return lod_fail_memory(problem);
  w.accessors = json_array();
  w.views = json_array();
  w.meshes = json_array();
  w.nodes = json_array();
  enum lod_status status = prepare(&w, meshes);
  if (status == LOD_OK)
    status = encode_primitives(&w);
  if (status == LOD_OK)
    status = add_meshes(&w);
  if (status == LOD_OK) {
    embed_images(&w);
    status = assemble(&w, bytes, size);
  }
  free(w.bin.data);
  lod_glb_materials_finish(&w.materials);
  json_decref(w.accessors);
  json_decref(w.views);
  json_decref(w.meshes);
  json_decref(w.nodes);
  lod_arena_destroy(w.scratch);
  return status;
}
