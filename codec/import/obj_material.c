/* MTL files to glTF 2.0 materials.
 *
 * Kd is the base colour (sRGB, as viewers show it), d or 1 - Tr its alpha, Ke the emission; Pm and Pr are metallic and roughness where a
 * file has them. Else nothing is metallic, and a shininess exponent Ns becomes the roughness whose lobe is as wide: sqrt(2 / (Ns + 2))
 * (Walter et al. Microfacet Models for Refraction through Rough Surfaces. 2007). Bump maps hold heights and are dropped; norm is kept. */
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/obj.h"

enum { kBuckets = 4096, kMaxMaterials = 1 << 20 };

struct material {
  char *name;
  uint32_t next;  /* in its bucket */
  uint32_t scene; /* number in the scene; LOD_NONE = not added */
  bool defined;
  double color[3], emission[3], alpha, shininess, metallic, roughness; /* below 0 = not said */
  char *maps[3];                                                       /* map_Kd, map_Ke, norm */
};

struct lod_obj_materials {
  struct lod_reader *reader;
  uint32_t buckets[kBuckets];
  struct material *items;
  uint32_t count, capacity;
  /* Textures by path; the few that a file has. */
  char **texture_paths;
  uint32_t *textures;
  uint32_t texture_count, texture_capacity;
};

struct lod_obj_materials *lod_obj_materials_create(struct lod_reader *reader) {
  struct lod_obj_materials *materials = LOD_NEW_ZERO(reader->scratch, 1, struct lod_obj_materials);
  if (!materials)
    return NULL;
  materials->reader = reader;
  memset(materials->buckets, 0xFF, sizeof materials->buckets);
  return materials;
}

static uint32_t bucket_of(const char *name, size_t length) {
  uint32_t hash = 2166136261u; /* FNV-1a */
  for (size_t i = 0; i < length; i++)
    hash = (hash ^ (uint8_t)name[i]) * 16777619u;
  return hash % kBuckets;
}

static bool make_room(struct lod_obj_materials *materials) {
  if (materials->count < materials->capacity)
    return true;
  uint32_t capacity = materials->capacity * 2 + 16;
  struct material *items = LOD_NEW(materials->reader->scratch, capacity, struct material);
  if (!items || capacity > kMaxMaterials * 2)
    return false;
  if (materials->count > 0)
    memcpy(items, materials->items, materials->count * sizeof *items);
  materials->items = items;
  materials->capacity = capacity;
  return true;
}

uint32_t lod_obj_materials_find(struct lod_obj_materials *materials, const char *name, size_t length) {
  uint32_t *bucket = &materials->buckets[bucket_of(name, length)];
  for (uint32_t i = *bucket; i != LOD_NONE; i = materials->items[i].next)
    if (strlen(materials->items[i].name) == length && memcmp(materials->items[i].name, name, length) == 0)
      return i;
  char *copy = lod_arena_copy(materials->reader->scratch, name, length);
  if (!copy || !make_room(materials))
    return LOD_NONE;
  /* A NUL within would make the name shorter than it is looked for. */
  for (size_t i = 0; i < length; i++)
    if (copy[i] == 0)
      copy[i] = '?';
  materials->items[materials->count] = (struct material){
      .name = copy, .next = *bucket, .scene = LOD_NONE, .color = {1, 1, 1}, .alpha = 1, .shininess = -1, .metallic = -1, .roughness = -1};
  return *bucket = materials->count++;
}

/* --- MTL --- */

static void read_channels(const char *at, const char *end, double values[3]) {
  int count = 0;
  for (; count < 3; count++) {
    lod_number_skip_blanks(&at, end);
    if (at == end || !lod_number_read(&at, end, &values[count]) || !isfinite(values[count]))
      break;
  }
  /* One number means grey. */
  for (int k = count; count > 0 && k < 3; k++)
    values[k] = values[count - 1];
}

static double read_number(const char *at, const char *end, double otherwise) {
  double value;
  return at < end && lod_number_read(&at, end, &value) && isfinite(value) ? value : otherwise;
}

/* "-s 1 1 1 name.png": with options the last word is the name, else the whole rest (names have spaces). */
static char *read_map(struct lod_reader *reader, const char *at, const char *end) {
  if (at < end && *at == '-') {
    const char *last = end;
    while (last > at && last[-1] != ' ' && last[-1] != '\t')
      last--;
    at = last;
  }
  return lod_arena_copy(reader->scratch, at, (size_t)(end - at));
}

static bool read_property(struct lod_reader *reader, struct material *material, const char *line, size_t length) {
  static const char *const kMaps[] = {"map_Kd", "map_Ke", "norm"};
  const char *rest, *end = line + length;
  if (lod_obj_is_word(line, length, "Kd", &rest))
    read_channels(rest, end, material->color);
  else if (lod_obj_is_word(line, length, "Ke", &rest))
    read_channels(rest, end, material->emission);
  else if (lod_obj_is_word(line, length, "d", &rest))
    material->alpha = read_number(rest, end, material->alpha);
  else if (lod_obj_is_word(line, length, "Tr", &rest))
    material->alpha = 1 - read_number(rest, end, 1 - material->alpha);
  else if (lod_obj_is_word(line, length, "Ns", &rest))
    material->shininess = read_number(rest, end, -1);
  else if (lod_obj_is_word(line, length, "Pm", &rest))
    material->metallic = read_number(rest, end, -1);
  else if (lod_obj_is_word(line, length, "Pr", &rest))
    material->roughness = read_number(rest, end, -1);
  for (int map = 0; map < 3; map++)
    if (lod_obj_is_word(line, length, kMaps[map], &rest) && rest < end && !(material->maps[map] = read_map(reader, rest, end)))
      return false;
  return true;
}

static enum lod_status read_library(struct lod_obj_materials *materials, const uint8_t *bytes, size_t size) {
  const char *at = (const char *)bytes, *end = at + size, *line, *rest;
  size_t length;
  uint32_t current = LOD_NONE;
  while (lod_obj_next_line(materials->reader, &at, end, &line, &length)) {
    if (!line)
      return lod_reader_memory(materials->reader);
    if (lod_obj_is_word(line, length, "newmtl", &rest)) {
      current = lod_obj_materials_find(materials, rest, (size_t)(line + length - rest));
      if (current == LOD_NONE)
        return lod_reader_memory(materials->reader);
      materials->items[current].defined = true;
    } else if (current != LOD_NONE && !read_property(materials->reader, &materials->items[current], line, length)) {
      return lod_reader_memory(materials->reader);
    }
  }
  return LOD_OK;
}

static enum lod_status load_library(struct lod_obj_materials *materials, const char *name) {
  const uint8_t *bytes;
  size_t size;
  LOD_TRY(lod_reader_open_companion(materials->reader, name, materials->reader->scratch, &bytes, &size));
  return bytes ? read_library(materials, bytes, size) : LOD_OK;
}

/* The format separates names by blanks, its users put blanks into names: several are taken for several when each ends in .mtl. */
enum lod_status lod_obj_materials_load(struct lod_obj_materials *materials, const char *names, size_t length) {
  char *name = lod_arena_copy(materials->reader->scratch, names, length);
  if (!name)
    return lod_reader_memory(materials->reader);
  for (char *blank; (blank = strstr(name, ".mtl ")) != NULL;) {
    blank[4] = 0;
    LOD_TRY(load_library(materials, name));
    name = blank + 5;
  }
  return name[0] ? load_library(materials, name) : LOD_OK;
}

/* --- to glTF --- */

static enum lod_status find_texture(struct lod_obj_materials *materials, char *path, uint32_t *texture) {
  struct lod_reader *reader = materials->reader;
  const uint8_t *bytes;
  size_t size;
  uint32_t image;
  for (uint32_t i = 0; i < materials->texture_count; i++)
    if (strcmp(materials->texture_paths[i], path) == 0) {
      *texture = materials->textures[i];
      return LOD_OK;
    }
  *texture = LOD_NONE;
  LOD_TRY(lod_reader_open_companion(reader, path, reader->arena, &bytes, &size));
  if (bytes) {
    LOD_TRY(lod_reader_add_image(reader, path, bytes, size, &image));
    struct lod_texture entry = {.image = image, .fallback = LOD_NONE};
    if (image != LOD_NONE && (*texture = lod_scene_add_texture(reader->scene, &entry)) == LOD_NONE)
      return lod_reader_memory(reader);
  }
  if (materials->texture_count == materials->texture_capacity) {
    uint32_t capacity = materials->texture_capacity * 2 + 16;
    char **paths = LOD_NEW(reader->scratch, capacity, char *);
    uint32_t *textures = LOD_NEW(reader->scratch, capacity, uint32_t);
    if (!paths || !textures)
      return lod_reader_memory(reader);
    for (uint32_t i = 0; i < materials->texture_count; i++) {
      paths[i] = materials->texture_paths[i];
      textures[i] = materials->textures[i];
    }
    materials->texture_paths = paths;
    materials->textures = textures;
    materials->texture_capacity = capacity;
  }
  materials->texture_paths[materials->texture_count] = path;
  materials->textures[materials->texture_count++] = *texture;
  return LOD_OK;
}

static double unit(double value) {
  return value >= 0 ? fmin(value, 1) : 0;
}
static double linear(double value) {
  return (double)lod_linear_from_srgb((float)unit(value));
}

/* NULL when memory is out. */
static json_t *make_json(const struct material *material, const uint32_t textures[3]) {
  /* Nothing is exported to be invisible: writers that mean "not transparent" put 0 where 1 belongs. */
  double alpha = material->alpha > 0 ? unit(material->alpha) : 1;
  /* A black diffuse colour next to a texture that replaces it. */
  bool black = material->color[0] <= 0 && material->color[1] <= 0 && material->color[2] <= 0 && textures[0] != LOD_NONE;
  double rough = material->roughness >= 0 ? unit(material->roughness) : (material->shininess > 0 ? sqrt(2 / (material->shininess + 2)) : 1);
  json_t *json = json_pack("{s:{s:[f,f,f,f],s:f,s:f}}", "pbrMetallicRoughness", "baseColorFactor", black ? 1.0 : linear(material->color[0]),
                           black ? 1.0 : linear(material->color[1]), black ? 1.0 : linear(material->color[2]), alpha, "metallicFactor",
                           unit(material->metallic), "roughnessFactor", rough);
  if (!json)
    return NULL;
  int failures = 0;
  if (alpha < 1)
    failures += json_object_set_new(json, "alphaMode", json_string("BLEND"));
  const double *e = material->emission;
  bool glows = e[0] > 0 || e[1] > 0 || e[2] > 0;
  if (glows || textures[1] != LOD_NONE)
    failures += json_object_set_new(
        json, "emissiveFactor", json_pack("[f,f,f]", glows ? linear(e[0]) : 1.0, glows ? linear(e[1]) : 1.0, glows ? linear(e[2]) : 1.0));
  static const char *const kKeys[] = {"baseColorTexture", "emissiveTexture", "normalTexture"};
  for (int map = 0; map < 3; map++)
    if (textures[map] != LOD_NONE)
      failures += json_object_set_new(map == 0 ? json_object_get(json, "pbrMetallicRoughness") : json, kKeys[map],
                                      json_pack("{s:i}", "index", (int)textures[map]));
  if (failures == 0)
    return json;
  json_decref(json);
  return NULL;
}

enum lod_status lod_obj_materials_resolve(struct lod_obj_materials *materials, uint32_t number, uint32_t *out) {
  struct material *material = &materials->items[number];
  uint32_t textures[3] = {LOD_NONE, LOD_NONE, LOD_NONE};
  *out = material->scene;
  if (!material->defined || material->scene != LOD_NONE)
    return LOD_OK;
  for (int map = 0; map < 3; map++)
    if (material->maps[map])
      LOD_TRY(find_texture(materials, material->maps[map], &textures[map]));
  json_t *json = make_json(material, textures);
  char *text = json ? json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(9)) : NULL;
  json_decref(json);
  if (!text)
    return lod_reader_memory(materials->reader);
  *out = material->scene = lod_scene_add_material(materials->reader->scene, material->name, text);
  free(text);
  return *out == LOD_NONE ? lod_reader_memory(materials->reader) : LOD_OK;
}
