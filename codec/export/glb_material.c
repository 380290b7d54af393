/* Materials go out as they came in; only texture indices change, and only what is used is sent. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb_private.h"

enum { MATERIAL_DEPTH = 32 };

json_t *lod_glb_text(const char *text) {
  json_t *json = json_string(text);
  if (json != NULL || text == NULL)
    return json != NULL ? json : json_string("");
  char safe[256];
  size_t size = 0;
  for (; text[size] != '\0' && size + 1 < sizeof safe; size++)
    safe[size] = (unsigned char)text[size] < 0x80 ? text[size] : '?';
  safe[size] = '\0';
  return json_string(safe);
}

/* What walking one material's JSON finds and does. */
struct walk {
  const struct lod_model *model;
  uint32_t *texture_index; /* model texture -> index in the GLB; LOD_NONE = not met yet */
  uint32_t *texture_order; /* the reverse */
  uint32_t texture_count;
  json_t *extensions;
  uint8_t uv_used;
};

static bool ends_with_texture(const char *key) {
  size_t length = strlen(key);
  return length >= 7 && (strcmp(key + length - 7, "Texture") == 0 || strcmp(key + length - 7, "texture") == 0);
}

/* A textureInfo: {"index": i, "texCoord": set, "extensions": {"KHR_texture_transform": {"texCoord": set}}}. */
static void visit_texture_info(struct walk *walk, json_t *info) {
  json_t *index = json_object_get(info, "index");
  if (!json_is_integer(index))
    return;
  json_int_t texture = json_integer_value(index);
  if (texture < 0 || texture >= (json_int_t)walk->model->texture_count)
    return;
  if (walk->texture_index[texture] == LOD_NONE) {
    walk->texture_order[walk->texture_count] = (uint32_t)texture;
    walk->texture_index[texture] = walk->texture_count++;
  }
  json_object_set_new(info, "index", json_integer(walk->texture_index[texture]));
  json_t *set = json_object_get(json_object_get(json_object_get(info, "extensions"), "KHR_texture_transform"), "texCoord");
  if (!json_is_integer(set))
    set = json_object_get(info, "texCoord");
  json_int_t number = json_is_integer(set) ? json_integer_value(set) : 0;
  if (number >= 0 && number < LOD_UV_SETS)
    walk->uv_used |= (uint8_t)(1u << number);
}

/* False when an object refers to a texture that the model does not have, or is nested too deeply. */
static bool walk_object(struct walk *walk, json_t *object, int depth) {
  if (depth > MATERIAL_DEPTH)
    return false;
  const char *key;
  json_t *value;
  json_object_foreach(object, key, value) {
    if (strcmp(key, "extensions") == 0 && json_is_object(value)) {
      const char *name;
      json_t *extension;
      json_object_foreach(value, name, extension) json_object_set_new(walk->extensions, name, json_true());
    }
    if (json_is_object(value)) {
      if (ends_with_texture(key)) {
        json_int_t index = json_integer_value(json_object_get(value, "index"));
        if (json_object_get(value, "index") != NULL && (index < 0 || index >= (json_int_t)walk->model->texture_count))
          return false;
        visit_texture_info(walk, value);
      }
      if (!walk_object(walk, value, depth + 1))
        return false;
    }
    size_t i;
    json_t *element;
    if (json_is_array(value))
      json_array_foreach(value, i, element) if (json_is_object(element) && !walk_object(walk, element, depth + 1)) return false;
  }
  return true;
}

static enum lod_status add_materials(struct glb_materials *out, struct walk *walk, const bool *uses, struct lod_problem *problem) {
  const struct lod_model *model = walk->model;
  for (uint32_t m = 0; m < model->material_count; m++) {
    out->material_index[m] = LOD_NONE;
    out->uv_used[m] = 0;
    if (!uses[m])
      continue;
    json_error_t error;
    json_t *material = model->materials[m].json != NULL ? json_loads(model->materials[m].json, 0, &error) : json_object();
    if (!json_is_object(material)) {
      json_decref(material);
      return lod_fail(problem, LOD_BAD_INPUT, "material", "Material %u (\"%.60s\") is not a JSON object", m, model->materials[m].name);
    }
    walk->uv_used = 0;
    if (!walk_object(walk, material, 0)) {
      json_decref(material);
      return lod_fail(problem, LOD_BAD_INPUT, "material",
                      "Material %u (\"%.60s\") refers to a texture that is not there or is nested too deeply", m, model->materials[m].name);
    }
    out->uv_used[m] = walk->uv_used;
    out->material_index[m] = (uint32_t)json_array_size(out->materials);
    if (json_array_append_new(out->materials, material) != 0)
      return lod_fail_memory(problem);
  }
  return LOD_OK;
}

/* Index of the image in the GLB, adding it when it is new. */
static json_t *image_reference(struct glb_materials *out, const struct walk *walk, const struct lod_glb_settings *settings,
                               uint32_t *image_index, uint32_t image) {
  if (image_index[image] == LOD_NONE) {
    const struct lod_image *from = &walk->model->images[image];
    json_t *json = json_object();
    bool embed = settings->image_uris == NULL;
    if (!embed)
      json_object_set_new(json, "uri", lod_glb_text(settings->image_uris[image]));
    json_object_set_new(json, "mimeType", lod_glb_text(from->mime));
    if (from->name != NULL && from->name[0] != '\0')
      json_object_set_new(json, "name", lod_glb_text(from->name));
    image_index[image] = out->image_count;
    out->embedded[out->image_count++] = embed ? image : LOD_NONE;
    json_array_append_new(out->images, json);
  }
  return json_integer(image_index[image]);
}

static const char *image_extension(const char *mime) {
  return strcmp(mime, "image/ktx2") == 0 ? "KHR_texture_basisu" : strcmp(mime, "image/webp") == 0 ? "EXT_texture_webp" : NULL;
}

/* Equal samplers are one: glTF exporters repeat them. */
static json_t *sampler_reference(struct glb_materials *out, const char *text) {
  json_error_t error;
  json_t *sampler = json_loads(text, 0, &error);
  if (!json_is_object(sampler)) {
    json_decref(sampler);
    return NULL;
  }
  size_t i;
  json_t *other;
  json_array_foreach(out->samplers, i, other) {
    if (json_equal(other, sampler)) {
      json_decref(sampler);
      return json_integer((json_int_t)i);
    }
  }
  json_array_append_new(out->samplers, sampler);
  return json_integer((json_int_t)json_array_size(out->samplers) - 1);
}

static enum lod_status add_textures(struct glb_materials *out, const struct walk *walk, const struct lod_glb_settings *settings,
                                    uint32_t *image_index, struct lod_problem *problem) {
  for (uint32_t i = 0; i < walk->texture_count; i++) {
    const struct lod_texture *texture = &walk->model->textures[walk->texture_order[i]];
    json_t *json = json_object();
    if (texture->sampler != NULL) {
      json_t *sampler = sampler_reference(out, texture->sampler);
      if (sampler != NULL)
        json_object_set_new(json, "sampler", sampler);
    }
    const uint32_t image_count = walk->model->image_count;
    if (texture->image < image_count) {
      const char *extension = image_extension(walk->model->images[texture->image].mime);
      json_t *source = image_reference(out, walk, settings, image_index, texture->image);
      if (extension == NULL) {
        json_object_set_new(json, "source", source);
      } else {
        json_object_set_new(json, "extensions", json_pack("{s{so}}", extension, "source", source));
        json_object_set_new(out->used, extension, json_true());
        if (texture->fallback < image_count)
          json_object_set_new(json, "source", image_reference(out, walk, settings, image_index, texture->fallback));
        else
          json_object_set_new(out->required, extension, json_true());
      }
    }
    if (json_array_append_new(out->textures, json) != 0)
      return lod_fail_memory(problem);
  }
  return LOD_OK;
}

enum lod_status lod_glb_materials_init(const struct lod_model *model, const bool *uses, const struct lod_glb_settings *settings,
                                       struct lod_arena *arena, struct glb_materials *out, struct lod_problem *problem) {
  *out = (struct glb_materials){.materials = json_array(),
                                .textures = json_array(),
                                .samplers = json_array(),
                                .images = json_array(),
                                .used = json_object(),
                                .required = json_object()};
  out->material_index = LOD_NEW(arena, model->material_count, uint32_t);
  out->uv_used = LOD_NEW(arena, model->material_count, uint8_t);
  out->embedded = LOD_NEW(arena, model->image_count, uint32_t);
  struct walk walk = {.model = model,
                      .texture_index = LOD_NEW(arena, model->texture_count, uint32_t),
                      .texture_order = LOD_NEW(arena, model->texture_count, uint32_t),
                      .extensions = out->used};
  uint32_t *image_index = LOD_NEW(arena, model->image_count, uint32_t);
  if (out->materials == NULL || out->textures == NULL || out->samplers == NULL || out->images == NULL || out->used == NULL ||
      out->required == NULL || out->material_index == NULL || out->uv_used == NULL || out->embedded == NULL || walk.texture_index == NULL ||
      walk.texture_order == NULL || image_index == NULL)
    return lod_fail_memory(problem);
  memset(walk.texture_index, 0xff, model->texture_count * sizeof *walk.texture_index);
  memset(image_index, 0xff, model->image_count * sizeof *image_index);
  LOD_TRY(add_materials(out, &walk, uses, problem));
  return add_textures(out, &walk, settings, image_index, problem);
}

static void add_array(json_t *root, const char *name, json_t *value) {
  if (json_array_size(value) != 0)
    json_object_set(root, name, value);
}

static json_t *keys_of(const json_t *object) {
  json_t *keys = json_array(), *value;
  const char *key;
  json_object_foreach((json_t *)object, key, value) json_array_append_new(keys, json_string(key));
  return keys;
}

static char *document_of(const struct glb_materials *materials) {
  json_t *used = keys_of(materials->used), *required = keys_of(materials->required);
  json_t *root = json_pack("{s{ssss}}", "asset", "version", "2.0", "generator", "Lodestream " LOD_VERSION);
  add_array(root, "extensionsUsed", used);
  add_array(root, "extensionsRequired", required);
  add_array(root, "materials", materials->materials);
  add_array(root, "textures", materials->textures);
  add_array(root, "samplers", materials->samplers);
  add_array(root, "images", materials->images);
  json_decref(used);
  json_decref(required);
  char *text = json_dumps(root, JSON_COMPACT);
  json_decref(root);
  return text;
}

enum lod_status lod_gltf_materials_write(const struct lod_model *model, const char *const *image_uris, struct lod_arena *arena, char **text,
                                         struct lod_problem *problem) {
  struct lod_glb_settings settings = lod_glb_defaults();
  struct glb_materials materials;
  bool *uses = LOD_NEW(arena, model->material_count, bool);
  if (uses == NULL)
    return lod_fail_memory(problem);
  memset(uses, 1, model->material_count * sizeof *uses);
  settings.image_uris = image_uris;
  enum lod_status status = lod_glb_materials_init(model, uses, &settings, arena, &materials, problem);
  char *made = status == LOD_OK ? document_of(&materials) : NULL;
  if (status == LOD_OK) {
    *text = made == NULL ? NULL : lod_arena_copy(arena, made, strlen(made) + 1);
    status = *text == NULL ? lod_fail_memory(problem) : LOD_OK;
  }
  free(made);
  lod_glb_materials_finish(&materials);
  return status;
}

void lod_glb_materials_finish(struct glb_materials *out) {
  json_decref(out->materials);
  json_decref(out->textures);
  json_decref(out->samplers);
  json_decref(out->images);
  json_decref(out->used);
  json_decref(out->required);
}
