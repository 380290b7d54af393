/* Phong-like and PBR materials of OBJ, FBX, Collada ... to glTF 2.0 JSON.
 *
 * Diffuse colour becomes base colour, what is not said to be metallic is not. A shininess exponent n becomes the roughness whose lobe is as
 * wide: sqrt(2 / (n + 2)) (Walter et al. Microfacet Models for Refraction through Rough Surfaces. 2007; Beckmann and Blinn-Phong lobes).
 * Colours are sRGB in files that have no PBR factors, as their viewers show them. */
#include "codec/import/assimp_material.h"

#include <assimp/material.h>
#include <assimp/scene.h>
#include <jansson.h>
#include <png.h>
#include <stdlib.h>
#include <string.h>

/* --- textures --- */

/* Raw texels (old game formats embed them) to PNG; *bytes in reader->arena. */
static enum lod_status encode_texels(struct lod_reader *reader, const struct aiTexture *texture, const uint8_t **bytes, size_t *size) {
  if (texture->mWidth == 0 || texture->mWidth > reader->limits.max_texture_pixels || texture->mHeight > reader->limits.max_texture_pixels)
    return lod_reader_fail(reader, LOD_LIMIT, "limit-texture-pixels", "an embedded texture is %u x %u pixels, the limit is %u each way",
                           texture->mWidth, texture->mHeight, reader->limits.max_texture_pixels);
  png_image image = {.version = PNG_IMAGE_VERSION, .width = texture->mWidth, .height = texture->mHeight, .format = PNG_FORMAT_BGRA};
  png_alloc_size_t length = 0;
  if (!png_image_write_to_memory(&image, NULL, &length, 0, texture->pcData, 0, NULL))
    return lod_reader_bad(reader, "bad-texture", "an embedded texture cannot be written as PNG: %s", image.message);
  uint8_t *out = lod_arena_alloc(reader->arena, length, 1);
  if (!out)
    return lod_reader_memory(reader);
  if (!png_image_write_to_memory(&image, out, &length, 0, texture->pcData, 0, NULL))
    return lod_reader_bad(reader, "bad-texture", "an embedded texture cannot be written as PNG: %s", image.message);
  *bytes = out;
  *size = length;
  return LOD_OK;
}

static const struct aiTexture *find_embedded(const struct aiScene *scene, const char *path) {
  if (path[0] == '*') {
    unsigned long number = strtoul(path + 1, NULL, 10);
    return number < scene->mNumTextures ? scene->mTextures[number] : NULL;
  }
  for (uint32_t i = 0; i < scene->mNumTextures; i++)
    if (path[0] && strcmp(scene->mTextures[i]->mFilename.data, path) == 0)
      return scene->mTextures[i];
  return NULL;
}

static enum lod_status texture_bytes(struct lod_reader *reader, const struct aiScene *scene, const char *path, const uint8_t **bytes,
                                     size_t *size) {
  const struct aiTexture *embedded = find_embedded(scene, path);
  *bytes = NULL;
  if (!embedded)
    return path[0] == '*' ? LOD_OK : lod_reader_open_companion(reader, path, reader->arena, bytes, size);
  if (!embedded->pcData)
    return LOD_OK;
  if (embedded->mHeight > 0)
    return encode_texels(reader, embedded, bytes, size);
  *size = embedded->mWidth;
  *bytes = lod_arena_copy(reader->arena, embedded->pcData, *size);
  return *bytes ? LOD_OK : lod_reader_memory(reader);
}

/* --- JSON --- */

struct context {
  struct lod_reader *reader;
  const struct aiScene *scene;
  const struct aiMaterial *material;
  json_t *json, *pbr; /* pbr belongs to json */
};

/* The first texture of one of two types under json[key]. The same path twice becomes two images; the store keeps equal bytes once. */
static enum lod_status add_texture(struct context *context, enum aiTextureType first, enum aiTextureType second, json_t *owner,
                                   const char *key) {
  struct aiString path;
  unsigned uv_set = 0;
  const uint8_t *bytes;
  size_t size;
  uint32_t image;
  if (aiGetMaterialTexture(context->material, first, 0, &path, NULL, &uv_set, NULL, NULL, NULL, NULL) != aiReturn_SUCCESS &&
      aiGetMaterialTexture(context->material, second, 0, &path, NULL, &uv_set, NULL, NULL, NULL, NULL) != aiReturn_SUCCESS)
    return LOD_OK;
  LOD_TRY(texture_bytes(context->reader, context->scene, path.data, &bytes, &size));
  if (!bytes)
    return LOD_OK;
  LOD_TRY(lod_reader_add_image(context->reader, path.data[0] == '*' ? "" : path.data, bytes, size, &image));
  if (image == LOD_NONE)
    return LOD_OK;
  struct lod_texture texture = {.image = image, .fallback = LOD_NONE};
  uint32_t number = lod_scene_add_texture(context->reader->scene, &texture);
  if (number == LOD_NONE)
    return lod_reader_memory(context->reader);
  json_t *reference = json_pack("{s:i}", "index", (int)number);
  if (uv_set == 1)
    json_object_set_new(reference, "texCoord", json_integer(1));
  return json_object_set_new(owner, key, reference) == 0 ? LOD_OK : lod_reader_memory(context->reader);
}

static bool get_color(const struct context *context, const char *key, struct aiColor4D *color) {
  *color = (struct aiColor4D){0, 0, 0, 1};
  return aiGetMaterialColor(context->material, key, 0, 0, color) == aiReturn_SUCCESS && isfinite(color->r) && isfinite(color->g) &&
         isfinite(color->b);
}

static bool get_number(const struct context *context, const char *key, float *value) {
  unsigned count = 1;
  return aiGetMaterialFloatArray(context->material, key, 0, 0, value, &count) == aiReturn_SUCCESS && count == 1 && isfinite(*value);
}

static double unit(double value) {
  return value >= 0 ? fmin(value, 1) : 0;
}

/* Component of a colour: clamped, made linear where the file says sRGB. */
static double channel(float value, bool linear) {
  float clamped = (float)unit((double)value);
  return (double)(linear ? clamped : lod_linear_from_srgb(clamped));
}

static void set_base_color(struct context *context, bool textured) {
  struct aiColor4D color;
  float opacity = 1;
  bool linear = get_color(context, "$clr.base", &color);
  if (!linear && !get_color(context, "$clr.diffuse", &color))
    color = (struct aiColor4D){1, 1, 1, 1};
  /* Exporters write a black or grey diffuse colour next to a texture that replaces it. */
  if (!linear && textured && color.r == 0 && color.g == 0 && color.b == 0)
    color = (struct aiColor4D){1, 1, 1, 1};
  if (!get_number(context, "$mat.opacity", &opacity))
    opacity = 1;
  /* Nothing is exported to be invisible: writers that mean "not transparent" put 0 where 1 belongs. */
  double alpha = opacity > 0 ? unit((double)opacity) : 1;
  json_object_set_new(context->pbr, "baseColorFactor",
                      json_pack("[f,f,f,f]", channel(color.r, linear), channel(color.g, linear), channel(color.b, linear), alpha));
  if (alpha < 1)
    json_object_set_new(context->json, "alphaMode", json_string("BLEND"));
}

static void set_factors(struct context *context) {
  float metallic, roughness, shininess;
  bool has_metallic = get_number(context, "$mat.metallicFactor", &metallic),
       has_roughness = get_number(context, "$mat.roughnessFactor", &roughness);
  double rough = 1;
  if (has_roughness)
    rough = unit((double)roughness);
  else if (get_number(context, "$mat.shininess", &shininess) && shininess > 0)
    rough = sqrt(2 / ((double)shininess + 2));
  json_object_set_new(context->pbr, "metallicFactor", json_real(has_metallic ? unit((double)metallic) : 0));
  json_object_set_new(context->pbr, "roughnessFactor", json_real(rough));
  struct aiColor4D emissive;
  if (get_color(context, "$clr.emissive", &emissive) && (emissive.r > 0 || emissive.g > 0 || emissive.b > 0))
    json_object_set_new(
        context->json, "emissiveFactor",
        json_pack("[f,f,f]", channel(emissive.r, has_metallic), channel(emissive.g, has_metallic), channel(emissive.b, has_metallic)));
  int two_sided = 0;
  unsigned count = 1;
  if (aiGetMaterialIntegerArray(context->material, "$mat.twosided", 0, 0, &two_sided, &count) == aiReturn_SUCCESS && two_sided)
    json_object_set_new(context->json, "doubleSided", json_true());
}

static enum lod_status fill(struct context *context) {
  LOD_TRY(add_texture(context, aiTextureType_BASE_COLOR, aiTextureType_DIFFUSE, context->pbr, "baseColorTexture"));
  LOD_TRY(add_texture(context, aiTextureType_NORMALS, aiTextureType_NORMAL_CAMERA, context->json, "normalTexture"));
  LOD_TRY(add_texture(context, aiTextureType_EMISSIVE, aiTextureType_EMISSION_COLOR, context->json, "emissiveTexture"));
  set_base_color(context, json_object_get(context->pbr, "baseColorTexture") != NULL);
  set_factors(context);
  if (json_object_get(context->json, "emissiveTexture") && !json_object_get(context->json, "emissiveFactor"))
    json_object_set_new(context->json, "emissiveFactor", json_pack("[f,f,f]", 1.0, 1.0, 1.0));
  return LOD_OK;
}

static enum lod_status add_material(struct context *context, const char *name, uint32_t *material) {
  char *text = json_dumps(context->json, JSON_COMPACT | JSON_REAL_PRECISION(9));
  if (!text)
    return lod_reader_memory(context->reader);
  *material = lod_scene_add_material(context->reader->scene, name, text);
  free(text);
  return *material == LOD_NONE ? lod_reader_memory(context->reader) : LOD_OK;
}

enum lod_status lod_assimp_material(struct lod_reader *reader, const struct aiScene *scene, uint32_t number, uint32_t *material) {
  struct context context = {
      .reader = reader, .scene = scene, .material = scene->mMaterials[number], .json = json_object(), .pbr = json_object()};
  struct aiString name = {0};
  *material = LOD_NONE;
  aiGetMaterialString(context.material, AI_MATKEY_NAME, &name);
  bool made_up = strcmp(name.data, AI_DEFAULT_MATERIAL_NAME) == 0;
  if (made_up) {
    json_decref(context.json);
    json_decref(context.pbr);
    return LOD_OK;
  }
  enum lod_status status = LOD_MEMORY;
  if (context.json && context.pbr && json_object_set_new(context.json, "pbrMetallicRoughness", context.pbr) == 0)
    status = fill(&context);
  else
    lod_reader_memory(reader);
  if (status == LOD_OK)
    status = add_material(&context, name.data, material);
  json_decref(context.json);
  return status;
}
