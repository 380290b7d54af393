/* Materials go out as the JSON they came in as; only the numbers of textures are exchanged, and textures that cannot be had are taken out.
 *
 * A texture reference is an object with an integer "index" under a member whose name ends in "Texture" ("baseColorTexture",
 * "clearcoatNormalTexture", ...): that is how the core and every KHR_materials_* extension write it. */
#include <stdlib.h>
#include <string.h>

#include "codec/import/gltf_document.h"

struct lod_gltf_materials {
  uint32_t material_count, texture_count, image_count;
  uint32_t *materials, *textures, *images; /* number in the scene; LOD_NONE = cannot be had; kUnseen */
};

static const uint32_t kUnseen = LOD_NONE - 1;

static uint32_t *make_map(struct lod_arena *arena, uint32_t count) {
  uint32_t *map = LOD_NEW(arena, count, uint32_t);
  for (uint32_t i = 0; map && i < count; i++)
    map[i] = kUnseen;
  return map;
}

enum lod_status lod_gltf_materials_create(struct lod_gltf_document *document, struct lod_gltf_materials **materials) {
  struct lod_arena *arena = document->reader->scratch;
  struct lod_gltf_materials *result = LOD_NEW_ZERO(arena, 1, struct lod_gltf_materials);
  if (!result)
    return lod_reader_memory(document->reader);
  result->material_count = (uint32_t)json_array_size(json_object_get(document->root, "materials"));
  result->texture_count = (uint32_t)json_array_size(json_object_get(document->root, "textures"));
  result->image_count = (uint32_t)json_array_size(json_object_get(document->root, "images"));
  result->materials = make_map(arena, result->material_count);
  result->textures = make_map(arena, result->texture_count);
  result->images = make_map(arena, result->image_count);
  *materials = result;
  return result->materials && result->textures && result->images ? LOD_OK : lod_reader_memory(document->reader);
}

/* Bytes of the file itself live as long as the caller's request; everything else is copied next to the model. */
static enum lod_status keep_bytes(struct lod_reader *reader, const uint8_t **bytes, size_t size) {
  if ((uintptr_t)*bytes >= (uintptr_t)reader->bytes && (uintptr_t)*bytes < (uintptr_t)reader->bytes + reader->size)
    return LOD_OK;
  *bytes = lod_arena_copy(reader->arena, *bytes, size);
  return *bytes ? LOD_OK : lod_reader_memory(reader);
}

static enum lod_status load_image(struct lod_gltf_document *document, struct lod_gltf_materials *materials, uint32_t number,
                                  uint32_t *image) {
  struct lod_reader *reader = document->reader;
  uint32_t *known = &materials->images[number];
  *image = *known;
  if (*known != kUnseen)
    return LOD_OK;
  const json_t *object = lod_gltf_object(document, "images", number);
  const char *uri = json_string_value(json_object_get(object, "uri")), *name = json_string_value(json_object_get(object, "name"));
  const uint8_t *bytes = NULL;
  size_t size = 0;
  int32_t view = -1;
  LOD_TRY(lod_gltf_index(document, object, "images", "bufferView", document->gltf.view_count, &view));
  *known = *image = LOD_NONE;
  if (view >= 0) {
    LOD_TRY(lod_gltf_view_bytes(document, (uint32_t)view, &bytes, &size));
    LOD_TRY(keep_bytes(reader, &bytes, size));
  } else if (uri) {
    LOD_TRY(lod_reader_open_optional(reader, uri, true, reader->arena, &bytes, &size));
    if (!bytes)
      return LOD_OK;
  } else {
    lod_scene_warn(reader->scene, "Image %u has neither a uri nor a bufferView and was dropped.", number);
    return LOD_OK;
  }
  bool is_data = uri && strncmp(uri, "data:", 5) == 0;
  LOD_TRY(lod_reader_add_image(reader, name && name[0] ? name : (uri && !is_data ? uri : ""), bytes, size, image));
  *known = *image;
  return LOD_OK;
}

/* texture[.extensions[extension]].source as an image of the scene. */
static enum lod_status load_source(struct lod_gltf_document *document, struct lod_gltf_materials *materials, const json_t *object,
                                   uint32_t *image) {
  int32_t source = -1;
  *image = LOD_NONE;
  if (!object)
    return LOD_OK;
  LOD_TRY(lod_gltf_index(document, object, "textures", "source", materials->image_count, &source));
  return source < 0 ? LOD_OK : load_image(document, materials, (uint32_t)source, image);
}

static enum lod_status add_texture(struct lod_gltf_document *document, const json_t *object, uint32_t image, uint32_t fallback,
                                   uint32_t *texture) {
  const json_t *sampler = json_object_get(object, "sampler");
  char *text = NULL;
  if (sampler) {
    text = json_dumps(lod_gltf_object(document, "samplers", (uint32_t)json_number_value(sampler)), JSON_COMPACT);
    if (!text)
      return lod_reader_memory(document->reader);
  }
  struct lod_texture entry = {.image = image, .fallback = fallback, .sampler = text};
  *texture = lod_scene_add_texture(document->reader->scene, &entry);
  free(text);
  return *texture == LOD_NONE ? lod_reader_memory(document->reader) : LOD_OK;
}

static enum lod_status load_texture(struct lod_gltf_document *document, struct lod_gltf_materials *materials, uint32_t number,
                                    uint32_t *texture) {
  uint32_t *known = &materials->textures[number];
  *texture = *known;
  if (*known != kUnseen)
    return LOD_OK;
  const json_t *object = lod_gltf_object(document, "textures", number);
  uint32_t plain, webp, basis;
  LOD_TRY(load_source(document, materials, object, &plain));
  LOD_TRY(load_source(document, materials, lod_gltf_extension(object, "EXT_texture_webp"), &webp));
  LOD_TRY(load_source(document, materials, lod_gltf_extension(object, "KHR_texture_basisu"), &basis));
  *known = *texture = LOD_NONE;
  uint32_t image = basis != LOD_NONE ? basis : (webp != LOD_NONE ? webp : plain);
  if (image == LOD_NONE)
    return LOD_OK;
  LOD_TRY(add_texture(document, object, image, image == plain ? LOD_NONE : plain, texture));
  *known = *texture;
  return LOD_OK;
}

static bool ends_with(const char *text, const char *ending) {
  size_t length = strlen(text), tail = strlen(ending);
  return length >= tail && strcmp(text + length - tail, ending) == 0;
}

/* Exchanges or removes one reference; *keep tells which. */
static enum lod_status remap_reference(struct lod_gltf_document *document, struct lod_gltf_materials *materials, json_t *reference,
                                       bool *keep) {
  int32_t number = -1;
  uint32_t texture;
  LOD_TRY(lod_gltf_index(document, reference, "material texture", "index", materials->texture_count, &number));
  LOD_TRY(load_texture(document, materials, (uint32_t)number, &texture));
  *keep = texture != LOD_NONE;
  if (json_number_value(json_object_get(reference, "texCoord")) >= LOD_UV_SETS)
    lod_scene_warn(document->reader->scene, "A texture uses UV set %g; only sets 0 and 1 are kept.",
                   json_number_value(json_object_get(reference, "texCoord")));
  if (*keep && json_object_set_new(reference, "index", json_integer(texture)) != 0)
    return lod_reader_memory(document->reader);
  return LOD_OK;
}

/* Depth is bounded by the limit on nested JSON. */
static enum lod_status remap_textures(struct lod_gltf_document *document, struct lod_gltf_materials *materials, json_t *object) {
  const char *key;
  json_t *value;
  void *next;
  json_object_foreach_safe(object, next, key, value) {
    bool keep = true;
    if (!json_is_object(value))
      continue;
    if (ends_with(key, "Texture") && json_object_get(value, "index"))
      LOD_TRY(remap_reference(document, materials, value, &keep));
    else
      LOD_TRY(remap_textures(document, materials, value));
    if (!keep)
      json_object_del(object, key);
  }
  return LOD_OK;
}

enum lod_status lod_gltf_material(struct lod_gltf_document *document, struct lod_gltf_materials *materials, int32_t number,
                                  uint32_t *material) {
  *material = LOD_NONE;
  if (number < 0)
    return LOD_OK;
  uint32_t *known = &materials->materials[number];
  if (*known != kUnseen) {
    *material = *known;
    return LOD_OK;
  }
  json_t *object = lod_gltf_object(document, "materials", (uint32_t)number);
  LOD_TRY(remap_textures(document, materials, object));
  char *text = json_dumps(object, JSON_COMPACT);
  if (!text)
    return lod_reader_memory(document->reader);
  *material = *known = lod_scene_add_material(document->reader->scene, json_string_value(json_object_get(object, "name")), text);
  free(text);
  return *material == LOD_NONE ? lod_reader_memory(document->reader) : LOD_OK;
}
