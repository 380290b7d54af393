/* From bytes to a document that may be trusted: GLB container, JSON, member types, index ranges, extensions, URIs.
 *
 * Based on: Khronos. glTF 2.0 Specification, sections 3.2 to 3.9 and 4.4 (GLB). Only what import uses is checked: a broken animation or
 * camera does not keep a model out. What validators call an error in numbers that we do not read (min, max) is let through. */
#include <string.h>

#include "codec/import/gltf_document.h"

static const uint32_t kGlbMagic = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;

/* --- container --- */

static uint32_t load_u32(const uint8_t *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

struct chunk {
  uint32_t type;
  const uint8_t *bytes;
  size_t size;
};

static enum lod_status next_chunk(struct lod_reader *reader, size_t *at, size_t end, struct chunk *chunk) {
  if (end - *at < 8)
    return lod_reader_bad(reader, "truncated", "the GLB ends within a chunk header");
  uint32_t length = load_u32(reader->bytes + *at);
  chunk->type = load_u32(reader->bytes + *at + 4);
  *at += 8;
  if (length > end - *at)
    return lod_reader_bad(reader, "truncated", "a GLB chunk says it has %u bytes, but %zu are left", length, end - *at);
  chunk->bytes = reader->bytes + *at;
  chunk->size = length;
  *at += length;
  return LOD_OK;
}

static enum lod_status read_glb(struct lod_gltf_document *document, const uint8_t **json, size_t *json_size) {
  struct lod_reader *reader = document->reader;
  if (reader->size < 12)
    return lod_reader_bad(reader, "truncated", "a GLB has at least 12 bytes, this file has %zu", reader->size);
  uint32_t version = load_u32(reader->bytes + 4), length = load_u32(reader->bytes + 8);
  if (load_u32(reader->bytes) != kGlbMagic)
    return lod_reader_bad(reader, "bad-glb", "the file does not start with 'glTF'");
  if (version != 2)
    return lod_reader_fail(reader, LOD_UNSUPPORTED, "unsupported-version", "binary glTF of version %u; expected 2", version);
  if (length > reader->size)
    return lod_reader_bad(reader, "truncated", "the GLB header says %u bytes, the file has %zu", length, reader->size);
  if (length < 12)
    return lod_reader_bad(reader, "bad-glb", "the GLB header says %u bytes, fewer than the header itself has", length);
  if (length < reader->size)
    lod_scene_warn(reader->scene, "%zu bytes behind the GLB were ignored.", reader->size - length);
  struct chunk chunk;
  size_t at = 12;
  LOD_TRY(next_chunk(reader, &at, length, &chunk));
  if (chunk.type != kJsonChunk)
    return lod_reader_bad(reader, "bad-glb", "the first chunk of the GLB is not JSON");
  *json = chunk.bytes;
  *json_size = chunk.size;
  for (uint32_t number = 1; at < length; number++) {
    LOD_TRY(next_chunk(reader, &at, length, &chunk));
    if (chunk.type == kJsonChunk || (chunk.type == kBinaryChunk && document->binary))
      return lod_reader_bad(reader, "bad-glb", "the GLB has two %s chunks", chunk.type == kJsonChunk ? "JSON" : "BIN");
    if (chunk.type == kBinaryChunk) {
      document->binary = chunk.bytes;
      document->binary_size = chunk.size;
    }
  }
  return LOD_OK;
}

/* --- JSON --- */

/* Brackets within brackets, outside of strings: checked before any recursive parser sees the text. */
static enum lod_status check_depth(struct lod_reader *reader, const uint8_t *text, size_t size) {
  uint32_t depth = 0;
  bool in_string = false;
  for (size_t i = 0; i < size; i++) {
    uint8_t c = text[i];
    if (in_string) {
      if (c == '\\')
        i++;
      else if (c == '"')
        in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '[' || c == '{') {
      if (++depth > reader->limits.max_depth)
        return lod_reader_fail(reader, LOD_LIMIT, "limit-depth", "the JSON is nested deeper than %u", reader->limits.max_depth);
    } else if ((c == ']' || c == '}') && depth > 0) {
      depth--;
    }
  }
  return LOD_OK;
}

static enum lod_status parse_json(struct lod_gltf_document *document, const uint8_t *text, size_t size) {
  struct lod_reader *reader = document->reader;
  if (size >= 3 && memcmp(text, "\xEF\xBB\xBF", 3) == 0) {
    text += 3;
    size -= 3;
  }
  /* Some writers fill the chunk with NUL in place of spaces. */
  while (size > 0 && text[size - 1] == 0)
    size--;
  LOD_TRY(check_depth(reader, text, size));
  json_error_t error;
  document->root = json_loadb((const char *)text, size, 0, &error);
  if (!document->root)
    return lod_reader_bad(reader, "bad-json", "line %d, column %d: %s", error.line, error.column, error.text);
  if (!json_is_object(document->root))
    return lod_reader_bad(reader, "bad-json", "the JSON is no object");
  return LOD_OK;
}

/* --- members --- */

enum kind { kIndex, kCount, kBool, kString, kNumbers, kIndices, kObject, kArray };
static const char *const kKindNames[] = {"an index", "a whole number",      "true or false", "a string",
                                         "numbers",  "an array of indices", "an object",     "an array"};

/* What each object's members must be; `target` is the collection that an index points into, `length` that of an array of numbers. Members
 * with `pass` are what tinygltf gets to see. Members that are not listed are ignored. */
static const struct rule {
  const char *owner, *key;
  enum kind kind;
  const char *target;
  uint32_t length;
  bool required, pass;
} kRules[] = {
    {"scenes", "nodes", kIndices, "nodes", 0, false, true},
    {"scenes", "name", kString, NULL, 0, false, false},
    {"nodes", "children", kIndices, "nodes", 0, false, true},
    {"nodes", "mesh", kIndex, "meshes", 0, false, true},
    {"nodes", "skin", kIndex, "skins", 0, false, true},
    {"nodes", "matrix", kNumbers, NULL, 16, false, true},
    {"nodes", "translation", kNumbers, NULL, 3, false, true},
    {"nodes", "rotation", kNumbers, NULL, 4, false, true},
    {"nodes", "scale", kNumbers, NULL, 3, false, true},
    {"nodes", "name", kString, NULL, 0, false, true},
    {"nodes", "extensions", kObject, NULL, 0, false, false},
    {"meshes", "primitives", kArray, NULL, 0, true, false},
    {"meshes", "name", kString, NULL, 0, false, true},
    {"primitives", "attributes", kObject, NULL, 0, true, true},
    {"primitives", "indices", kIndex, "accessors", 0, false, true},
    {"primitives", "material", kIndex, "materials", 0, false, true},
    {"primitives", "mode", kCount, NULL, 0, false, true},
    {"primitives", "targets", kArray, NULL, 0, false, false},
    {"primitives", "extensions", kObject, NULL, 0, false, false},
    {"accessors", "bufferView", kIndex, "bufferViews", 0, false, true},
    {"accessors", "byteOffset", kCount, NULL, 0, false, true},
    {"accessors", "componentType", kCount, NULL, 0, true, true},
    {"accessors", "count", kCount, NULL, 0, true, true},
    {"accessors", "type", kString, NULL, 0, true, true},
    {"accessors", "normalized", kBool, NULL, 0, false, true},
    {"accessors", "sparse", kObject, NULL, 0, false, true},
    {"sparse", "count", kCount, NULL, 0, true, true},
    {"sparse", "indices", kObject, NULL, 0, true, true},
    {"sparse", "values", kObject, NULL, 0, true, true},
    {"sparse.indices", "bufferView", kIndex, "bufferViews", 0, true, true},
    {"sparse.indices", "byteOffset", kCount, NULL, 0, false, true},
    {"sparse.indices", "componentType", kCount, NULL, 0, true, true},
    {"sparse.values", "bufferView", kIndex, "bufferViews", 0, true, true},
    {"sparse.values", "byteOffset", kCount, NULL, 0, false, true},
    {"bufferViews", "buffer", kIndex, "buffers", 0, true, true},
    {"bufferViews", "byteOffset", kCount, NULL, 0, false, true},
    {"bufferViews", "byteLength", kCount, NULL, 0, true, true},
    {"bufferViews", "byteStride", kCount, NULL, 0, false, true},
    {"bufferViews", "extensions", kObject, NULL, 0, false, false},
    {"buffers", "byteLength", kCount, NULL, 0, true, false},
    {"buffers", "uri", kString, NULL, 0, false, false},
    {"skins", "joints", kIndices, "nodes", 0, true, true},
    {"skins", "inverseBindMatrices", kIndex, "accessors", 0, false, true},
    {"textures", "source", kIndex, "images", 0, false, false},
    {"textures", "sampler", kIndex, "samplers", 0, false, false},
    {"textures", "extensions", kObject, NULL, 0, false, false},
    {"images", "bufferView", kIndex, "bufferViews", 0, false, false},
    {"images", "uri", kString, NULL, 0, false, false},
    {"images", "mimeType", kString, NULL, 0, false, false},
    {"images", "name", kString, NULL, 0, false, false},
    {"materials", "name", kString, NULL, 0, false, false},
    {"samplers", "name", kString, NULL, 0, false, false},
};

/* Collections in the order in which they are checked; `pass`: tinygltf gets the members of their objects that pass. */
static const struct {
  const char *name;
  bool pass;
} kCollections[] = {
    {"scenes", true},   {"nodes", true},   {"meshes", true},    {"accessors", true}, {"bufferViews", true}, {"skins", true},
    {"buffers", false}, {"images", false}, {"textures", false}, {"samplers", false}, {"materials", false},
};

static uint32_t collection_size(const struct lod_gltf_document *document, const char *name) {
  return (uint32_t)json_array_size(json_object_get(document->root, name));
}

/* A whole number from 0 to 2^53 - 1; 3.0 is one too. */
static bool get_count(const json_t *value, uint64_t *count) {
  if (json_is_integer(value) && json_integer_value(value) >= 0 && json_integer_value(value) < 1ll << 53) {
    *count = (uint64_t)json_integer_value(value);
    return true;
  }
  double real = json_real_value(value);
  if (!json_is_real(value) || !(real >= 0) || real >= 0x1p53 || real != (double)(uint64_t)real)
    return false;
  *count = (uint64_t)real;
  return true;
}

static bool is_numbers(const json_t *value, uint32_t length) {
  if (!json_is_array(value) || json_array_size(value) != length)
    return false;
  for (uint32_t i = 0; i < length; i++)
    if (!json_is_number(json_array_get(value, i)))
      return false;
  return true;
}

static enum lod_status bad_index(struct lod_gltf_document *document, const char *label, const char *key, uint64_t index, const char *target,
                                 uint32_t size) {
  return lod_reader_bad(document->reader, "index-out-of-range", "%s.%s is %llu, but there are %u %s", label, key, (unsigned long long)index,
                        size, target);
}

/* An array of indices, rewritten as integers into `clean`. */
static enum lod_status check_indices(struct lod_gltf_document *document, const char *label, const struct rule *rule, const json_t *value,
                                     json_t **clean) {
  uint32_t size = collection_size(document, rule->target);
  *clean = json_array();
  for (size_t i = 0; i < json_array_size(value); i++) {
    uint64_t index;
    if (!get_count(json_array_get(value, i), &index))
      return lod_reader_bad(document->reader, "bad-json", "%s.%s holds something that is no index", label, rule->key);
    if (index >= size)
      return bad_index(document, label, rule->key, index, rule->target, size);
    if (json_array_append_new(*clean, json_integer((json_int_t)index)) != 0)
      return lod_reader_memory(document->reader);
  }
  return LOD_OK;
}

/* Checks one member; *clean: a new reference to what tinygltf may see. */
static enum lod_status check_member(struct lod_gltf_document *document, const char *label, const struct rule *rule, json_t *value,
                                    json_t **clean) {
  uint64_t count = 0;
  bool right = false;
  switch (rule->kind) {
  case kIndex:
  case kCount:
    right = get_count(value, &count);
    break;
  case kBool:
    right = json_is_boolean(value);
    break;
  case kString:
    right = json_is_string(value);
    break;
  case kNumbers:
    right = is_numbers(value, rule->length);
    break;
  case kIndices:
  case kArray:
    right = json_is_array(value);
    break;
  case kObject:
    right = json_is_object(value);
    break;
  }
  if (!right) {
    char length[16] = "";
    if (rule->kind == kNumbers)
      snprintf(length, sizeof length, "%u ", rule->length);
    return lod_reader_bad(document->reader, "bad-json", "%s.%s is not %s%s", label, rule->key, length, kKindNames[rule->kind]);
  }
  if (rule->kind == kIndices)
    return check_indices(document, label, rule, value, clean);
  if (rule->kind == kIndex && count >= collection_size(document, rule->target))
    return bad_index(document, label, rule->key, count, rule->target, collection_size(document, rule->target));
  *clean = rule->kind == kIndex || rule->kind == kCount ? json_integer((json_int_t)count) : json_incref(value);
  return *clean ? LOD_OK : lod_reader_memory(document->reader);
}

/* Checks an object against the rules of `owner` and puts what passes into `clean`. */
static enum lod_status check_object(struct lod_gltf_document *document, const char *owner, const char *label, json_t *object,
                                    json_t *clean) {
  if (!json_is_object(object))
    return lod_reader_bad(document->reader, "bad-json", "%s is no object", label);
  for (size_t i = 0; i < sizeof kRules / sizeof *kRules; i++) {
    const struct rule *rule = &kRules[i];
    if (strcmp(rule->owner, owner) != 0)
      continue;
    json_t *value = json_object_get(object, rule->key), *part = NULL;
    if (!value) {
      if (rule->required)
        return lod_reader_bad(document->reader, "bad-json", "%s lacks %s", label, rule->key);
      continue;
    }
    enum lod_status status = check_member(document, label, rule, value, &part);
    if (status == LOD_OK && rule->pass && json_object_set(clean, rule->key, part) != 0)
      status = lod_reader_memory(document->reader);
    json_decref(part);
    LOD_TRY(status);
  }
  return LOD_OK;
}

/* Replaces clean[key] (a shared reference) by a checked copy of object[key]. */
static enum lod_status check_nested(struct lod_gltf_document *document, const char *owner, const char *label, json_t *object,
                                    const char *key, json_t *clean) {
  json_t *copy = json_object();
  if (!copy || json_object_set_new(clean, key, copy) != 0)
    return lod_reader_memory(document->reader);
  return check_object(document, owner, label, json_object_get(object, key), copy);
}

static enum lod_status check_sparse(struct lod_gltf_document *document, const char *label, json_t *accessor, json_t *clean) {
  char nested[96];
  json_t *sparse = json_object_get(accessor, "sparse");
  snprintf(nested, sizeof nested, "%s.sparse", label);
  LOD_TRY(check_nested(document, "sparse", nested, accessor, "sparse", clean));
  json_t *clean_sparse = json_object_get(clean, "sparse");
  snprintf(nested, sizeof nested, "%s.sparse.indices", label);
  LOD_TRY(check_nested(document, "sparse.indices", nested, sparse, "indices", clean_sparse));
  snprintf(nested, sizeof nested, "%s.sparse.values", label);
  return check_nested(document, "sparse.values", nested, sparse, "values", clean_sparse);
}

/* attributes: every member an index of an accessor. */
static enum lod_status check_attributes(struct lod_gltf_document *document, const char *label, json_t *primitive, json_t *clean) {
  json_t *copy = json_object(), *value;
  const char *key;
  if (!copy || json_object_set_new(clean, "attributes", copy) != 0)
    return lod_reader_memory(document->reader);
  uint32_t size = collection_size(document, "accessors");
  json_object_foreach(json_object_get(primitive, "attributes"), key, value) {
    uint64_t index;
    if (!get_count(value, &index))
      return lod_reader_bad(document->reader, "bad-json", "%s.attributes.%.40s is no index", label, key);
    if (index >= size)
      return bad_index(document, label, key, index, "accessors", size);
    if (json_object_set_new(copy, key, json_integer((json_int_t)index)) != 0)
      return lod_reader_memory(document->reader);
  }
  return LOD_OK;
}

static enum lod_status check_primitives(struct lod_gltf_document *document, const char *label, json_t *mesh, json_t *clean) {
  json_t *list = json_array(), *primitives = json_object_get(mesh, "primitives");
  if (!list || json_object_set_new(clean, "primitives", list) != 0)
    return lod_reader_memory(document->reader);
  for (size_t i = 0; i < json_array_size(primitives); i++) {
    char nested[96];
    snprintf(nested, sizeof nested, "%s.primitives[%zu]", label, i);
    json_t *copy = json_object();
    if (!copy || json_array_append_new(list, copy) != 0)
      return lod_reader_memory(document->reader);
    LOD_TRY(check_object(document, "primitives", nested, json_array_get(primitives, i), copy));
    LOD_TRY(check_attributes(document, nested, json_array_get(primitives, i), copy));
    if (json_integer_value(json_object_get(copy, "mode")) > LOD_GLTF_FAN)
      return lod_reader_bad(document->reader, "bad-json", "%s.mode is %lld; expected 0 to 6", nested,
                            (long long)json_integer_value(json_object_get(copy, "mode")));
  }
  return LOD_OK;
}

static enum lod_status check_collection(struct lod_gltf_document *document, const char *name, json_t *clean) {
  json_t *array = json_object_get(document->root, name);
  if (!array)
    return LOD_OK;
  if (!json_is_array(array))
    return lod_reader_bad(document->reader, "bad-json", "%s is no array", name);
  if (json_array_size(array) > INT32_MAX - 1)
    return lod_reader_fail(document->reader, LOD_LIMIT, "limit-bytes", "there are more than 2^31 - 2 %s", name);
  for (size_t i = 0; i < json_array_size(array); i++) {
    char label[48];
    snprintf(label, sizeof label, "%s[%zu]", name, i);
    json_t *object = json_array_get(array, i), *copy = json_object();
    if (!copy || json_array_append_new(clean, copy) != 0)
      return lod_reader_memory(document->reader);
    LOD_TRY(check_object(document, name, label, object, copy));
    if (strcmp(name, "meshes") == 0)
      LOD_TRY(check_primitives(document, label, object, copy));
    if (json_object_get(copy, "sparse"))
      LOD_TRY(check_sparse(document, label, object, copy));
  }
  return LOD_OK;
}

/* tinygltf insists on a bufferView for index accessors, Draco's have none: they get the number behind the last view. */
static enum lod_status add_no_view(struct lod_gltf_document *document, json_t *clean, int32_t *no_view) {
  json_t *accessors = json_object_get(clean, "accessors"), *views = json_object_get(clean, "bufferViews");
  *no_view = (int32_t)json_array_size(views);
  json_t *view = json_pack("{s:i,s:i}", "buffer", 0, "byteLength", 1);
  if (!view || json_array_append_new(views, view) != 0)
    return lod_reader_memory(document->reader);
  for (size_t i = 0; i < json_array_size(accessors); i++) {
    json_t *accessor = json_array_get(accessors, i);
    if (!json_object_get(accessor, "bufferView") && json_object_set_new(accessor, "bufferView", json_integer(*no_view)) != 0)
      return lod_reader_memory(document->reader);
  }
  return LOD_OK;
}

static enum lod_status check_all(struct lod_gltf_document *document, json_t *clean, int32_t *no_view) {
  for (size_t i = 0; i < sizeof kCollections / sizeof *kCollections; i++) {
    json_t *list = json_array();
    if (!list)
      return lod_reader_memory(document->reader);
    enum lod_status status = check_collection(document, kCollections[i].name, list);
    if (status == LOD_OK && kCollections[i].pass && json_object_set(clean, kCollections[i].name, list) != 0)
      status = lod_reader_memory(document->reader);
    json_decref(list);
    LOD_TRY(status);
  }
  json_t *scene = json_object_get(document->root, "scene");
  if (scene) {
    uint64_t index;
    if (!get_count(scene, &index))
      return lod_reader_bad(document->reader, "bad-json", "scene is no index");
    if (index >= collection_size(document, "scenes"))
      return bad_index(document, "root", "scene", index, "scenes", collection_size(document, "scenes"));
    if (json_object_set_new(clean, "scene", json_integer((json_int_t)index)) != 0)
      return lod_reader_memory(document->reader);
  }
  if (json_object_set_new(clean, "asset", json_pack("{s:s}", "version", "2.0")) != 0)
    return lod_reader_memory(document->reader);
  return add_no_view(document, clean, no_view);
}

/* --- asset, extensions, URIs --- */

static enum lod_status check_version(struct lod_gltf_document *document) {
  const json_t *asset = json_object_get(document->root, "asset");
  const char *version = json_string_value(json_object_get(asset, "version")),
             *least = json_string_value(json_object_get(asset, "minVersion"));
  if (!json_is_object(asset) || !version)
    return lod_reader_bad(document->reader, "bad-json", "asset.version is missing; expected \"2.0\"");
  if (strncmp(version, "2.", 2) != 0)
    return lod_reader_fail(document->reader, LOD_UNSUPPORTED, "unsupported-version", "glTF version \"%.20s\"; expected 2.0", version);
  if (least && strcmp(least, "2.0") != 0)
    return lod_reader_fail(document->reader, LOD_UNSUPPORTED, "unsupported-version", "needs glTF version %.20s; this reader knows 2.0",
                           least);
  return LOD_OK;
}

/* Extensions whose meaning is kept (a material's JSON goes out as it came in) or may be left out without changing the shape. */
static const char *const kKnown[] = {
    "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization", "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",           "KHR_texture_basisu",      "KHR_texture_transform", "KHR_materials_variants",
    "KHR_lights_punctual",        "KHR_xmp_json_ld",         "KHR_node_visibility",
};

static bool is_known(const char *name) {
  for (size_t i = 0; i < sizeof kKnown / sizeof *kKnown; i++)
    if (strcmp(name, kKnown[i]) == 0)
      return true;
  return strncmp(name, "KHR_materials_", 14) == 0;
}

static enum lod_status check_extensions(struct lod_gltf_document *document) {
  const json_t *required = json_object_get(document->root, "extensionsRequired"), *used = json_object_get(document->root, "extensionsUsed");
  for (size_t i = 0; i < json_array_size(required); i++) {
    const char *name = json_string_value(json_array_get(required, i));
    if (!name)
      return lod_reader_bad(document->reader, "bad-json", "extensionsRequired[%zu] is no string", i);
    if (!is_known(name))
      return lod_reader_fail(document->reader, LOD_UNSUPPORTED, "unsupported-extension",
                             "requires the extension %.80s, which is not supported", name);
  }
  for (size_t i = 0; i < json_array_size(used); i++) {
    const char *name = json_string_value(json_array_get(used, i));
    if (name && strcmp(name, "KHR_materials_variants") == 0)
      lod_scene_warn(document->reader->scene, "Material variants were dropped; the default materials are used.");
    else if (name && strcmp(name, "KHR_lights_punctual") == 0)
      lod_scene_warn(document->reader->scene, "Lights were dropped.");
    else if (name && !is_known(name))
      lod_scene_warn(document->reader->scene, "The extension %.80s is not supported and was dropped, unless it belongs to materials.",
                     name);
  }
  if (json_array_size(json_object_get(document->root, "animations")) > 0)
    lod_scene_warn(document->reader->scene, "Animations were dropped; the model is in its rest pose.");
  return LOD_OK;
}

static enum lod_status check_uris(struct lod_gltf_document *document, const char *collection) {
  const json_t *array = json_object_get(document->root, collection);
  for (size_t i = 0; i < json_array_size(array); i++) {
    const char *uri = json_string_value(json_object_get(json_array_get(array, i), "uri"));
    if (uri)
      LOD_TRY(lod_reader_check_uri(document->reader, uri));
  }
  return LOD_OK;
}

/* --- all together --- */

static enum lod_status parse_structure(struct lod_gltf_document *document, json_t *clean) {
  struct lod_reader *reader = document->reader;
  int32_t no_view = -1;
  char message[200] = "";
  LOD_TRY(check_all(document, clean, &no_view));
  char *text = json_dumps(clean, JSON_COMPACT | JSON_REAL_PRECISION(17));
  if (!text)
    return lod_reader_memory(reader);
  enum lod_status status = lod_gltf_parse(text, strlen(text), no_view, reader->scratch, &document->gltf, message);
  free(text);
  if (status == LOD_MEMORY)
    return lod_reader_memory(reader);
  if (status != LOD_OK)
    return lod_reader_fail(reader, status, "bad-gltf", "%s", message);
  document->gltf.view_count = (uint32_t)no_view;
  return LOD_OK;
}

enum lod_status lod_gltf_document_init(struct lod_gltf_document *document, struct lod_reader *reader) {
  *document = (struct lod_gltf_document){.reader = reader};
  const uint8_t *json = reader->bytes;
  size_t size = reader->size;
  if (reader->size >= 4 && memcmp(reader->bytes, "glTF", 4) == 0)
    LOD_TRY(read_glb(document, &json, &size));
  LOD_TRY(parse_json(document, json, size));
  LOD_TRY(check_version(document));
  LOD_TRY(check_extensions(document));
  json_t *clean = json_object();
  if (!clean)
    return lod_reader_memory(reader);
  enum lod_status status = parse_structure(document, clean);
  json_decref(clean);
  LOD_TRY(status);
  LOD_TRY(check_uris(document, "buffers"));
  LOD_TRY(check_uris(document, "images"));
  document->buffer_count = collection_size(document, "buffers");
  document->buffers = LOD_NEW_ZERO(reader->scratch, document->buffer_count, struct lod_gltf_bytes);
  document->views = LOD_NEW_ZERO(reader->scratch, document->gltf.view_count, struct lod_gltf_bytes);
  return document->buffers && document->views ? LOD_OK : lod_reader_memory(reader);
}

void lod_gltf_document_finish(struct lod_gltf_document *document) {
  json_decref(document->root);
  document->root = NULL;
}

json_t *lod_gltf_object(const struct lod_gltf_document *document, const char *collection, uint32_t index) {
  json_t *object = json_array_get(json_object_get(document->root, collection), index);
  return json_is_object(object) ? object : NULL;
}

json_t *lod_gltf_extension(const json_t *object, const char *name) {
  json_t *extension = json_object_get(json_object_get(object, "extensions"), name);
  return json_is_object(extension) ? extension : NULL;
}

enum lod_status lod_gltf_index(struct lod_gltf_document *document, const json_t *object, const char *what, const char *key, uint32_t count,
                               int32_t *index) {
  uint64_t value;
  const json_t *member = json_object_get(object, key);
  *index = -1;
  if (!member)
    return LOD_OK;
  if (!get_count(member, &value))
    return lod_reader_bad(document->reader, "bad-json", "%s.%s is no index", what, key);
  if (value >= count || value > INT32_MAX)
    return bad_index(document, what, key, value, "of them", count);
  *index = (int32_t)value;
  return LOD_OK;
}
