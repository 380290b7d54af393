#include "codec/export/interop.h"

#include <fcntl.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum { HASH_HEX = 64, SCREEN_LINES = 1080 };

/* ---- choosing ---- */

static int by_bytes(const void *a, const void *b) {
  const struct lod_interop_level *x = a, *y = b;
  if (x->bytes != y->bytes)
    return x->bytes < y->bytes ? -1 : 1;
  return x->error < y->error ? -1 : x->error > y->error ? 1 : strcmp(x->object, y->object);
}

static bool read_level(const json_t *json, const char *family, size_t number, struct lod_interop_level *level) {
  const char *object = json_string_value(json_object_get(json, "object")), *type = json_string_value(json_object_get(json, "type"));
  if (object == NULL || type == NULL || strlen(object) != HASH_HEX || strspn(object, "0123456789abcdef") != HASH_HEX ||
      strcmp(type, "model/gltf-binary") != 0)
    return false;
  *level = (struct lod_interop_level){.family = family,
                                      .object = object,
                                      .number = (uint32_t)number,
                                      .error = json_number_value(json_object_get(json, "error")),
                                      .bytes = (uint64_t)json_integer_value(json_object_get(json, "bytes"))};
  snprintf(level->uri, sizeof level->uri, "%s", object);
  return true;
}

uint32_t lod_interop_choose(const json_t *manifest, struct lod_interop_level levels[LOD_INTEROP_LEVELS]) {
  enum { MAX = 1024 };
  struct lod_interop_level *all = calloc(MAX, sizeof *all);
  uint32_t count = 0, kept = 0;
  const char *name;
  json_t *family, *level;
  size_t i;
  if (all == NULL)
    return 0;
  json_object_foreach(json_object_get(manifest, "families"), name, family)
      json_array_foreach(json_object_get(family, "levels"), i, level) if (count < MAX) count += read_level(level, name, i, &all[count]);
  qsort(all, count, sizeof *all, by_bytes);
  for (uint32_t k = 0; k < count; k++)
    if (kept == 0 || all[k].error < all[kept - 1].error)
      all[kept++] = all[k];
  /* From the finest down, so that it is there whatever the number. */
  uint32_t chosen = 0;
  struct lod_interop_level thinned[LOD_INTEROP_LEVELS];
  for (uint32_t k = kept; k > 0 && chosen < LOD_INTEROP_LEVELS; k--)
    if (chosen == 0 || 2 * all[k - 1].bytes <= thinned[chosen - 1].bytes)
      thinned[chosen++] = all[k - 1];
  for (uint32_t k = 0; k < chosen; k++)
    levels[k] = thinned[chosen - 1 - k];
  free(all);
  return chosen;
}

/* ---- 3D Tiles ---- */

static enum lod_status dump(json_t *json, char **text, struct lod_problem *problem) {
  *text = json == NULL ? NULL : json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(12));
  json_decref(json);
  return *text == NULL ? lod_fail_memory(problem) : LOD_OK;
}

static json_t *volume(const json_t *manifest, double widened) {
  const json_t *sphere = json_object_get(json_object_get(manifest, "source"), "sphere"), *center = json_object_get(sphere, "center");
  double x = json_number_value(json_array_get(center, 0)), y = json_number_value(json_array_get(center, 1)),
         z = json_number_value(json_array_get(center, 2)), radius = json_number_value(json_object_get(sphere, "radius"));
  return json_pack("{s[ffff]}", "sphere", x, -z, y, radius + widened);
}

enum lod_status lod_interop_tileset(const json_t *manifest, const struct lod_interop_level *levels, uint32_t count, char **text,
                                    struct lod_problem *problem) {
  json_t *tile = NULL;
  double widest = 0; /* of this level and all finer ones: a parent's volume holds its child's */
  for (uint32_t i = count; i > 0; i--) {
    const struct lod_interop_level *level = &levels[i - 1];
    widest = fmax(widest, level->error);
    json_t *parent = json_pack("{so, sf, ss, s{ss}}", "boundingVolume", volume(manifest, widest), "geometricError", level->error, "refine",
                               "REPLACE", "content", "uri", level->uri);
    if (tile != NULL)
      json_object_set_new(parent, "children", json_pack("[o]", tile));
    tile = parent;
  }
  double diagonal = json_number_value(json_object_get(json_object_get(manifest, "source"), "diagonal"));
  return dump(json_pack("{s{ssss}, sf, so}", "asset", "version", "1.1", "generator", "Lodestream " LOD_VERSION, "geometricError",
                        fmax(diagonal, widest), "root", tile),
              text, problem);
}

/* ---- glTF with MSFT_lod ---- */

/* The arrays of a glTF document whose members refer to one another by position. */
static const char *const kArrays[] = {"accessors", "bufferViews", "buffers",  "images",  "materials",
                                      "meshes",    "nodes",       "samplers", "textures"};
enum { ARRAY_COUNT = sizeof kArrays / sizeof kArrays[0] };
enum { ACCESSORS, BUFFER_VIEWS, BUFFERS, IMAGES, MATERIALS, MESHES, NODES, SAMPLERS, TEXTURES };

struct merge {
  json_t *document;
  size_t offsets[ARRAY_COUNT]; /* of the level that is being added */
  struct lod_problem *problem;
};

static void shift(json_t *object, const char *key, size_t offset) {
  json_t *value = json_object_get(object, key);
  if (json_is_integer(value))
    json_object_set_new(object, key, json_integer(json_integer_value(value) + (json_int_t)offset));
}

static void shift_all(json_t *object, size_t offset) {
  const char *key;
  json_t *value;
  json_object_foreach(object, key, value) json_integer_set(value, json_integer_value(value) + (json_int_t)offset);
}

static void shift_list(json_t *array, size_t offset) {
  size_t i;
  json_t *value;
  json_array_foreach(array, i, value) json_integer_set(value, json_integer_value(value) + (json_int_t)offset);
}

static void shift_mesh(json_t *mesh, const size_t *offsets) {
  size_t i;
  json_t *primitive;
  json_array_foreach(json_object_get(mesh, "primitives"), i, primitive) {
    shift_all(json_object_get(primitive, "attributes"), offsets[ACCESSORS]);
    shift(primitive, "indices", offsets[ACCESSORS]);
    shift(primitive, "material", offsets[MATERIALS]);
    shift(json_object_get(json_object_get(primitive, "extensions"), "KHR_draco_mesh_compression"), "bufferView", offsets[BUFFER_VIEWS]);
  }
}

/* A texture is named by "index" in objects whose own name ends in "Texture", in the core and in every material extension alike. */
static void shift_textures(json_t *json, bool is_texture, size_t offset) {
  const char *key;
  json_t *value;
  if (is_texture)
    shift(json, "index", offset);
  json_object_foreach(json, key, value) {
    size_t length = strlen(key);
    if (json_is_object(value))
      shift_textures(value, length >= 7 && strcmp(key + length - 7, "Texture") == 0, offset);
  }
}

static void shift_member(size_t array, json_t *member, const size_t *offsets) {
  switch (array) {
  case ACCESSORS:
    shift(member, "bufferView", offsets[BUFFER_VIEWS]);
    break;
  case BUFFER_VIEWS:
    shift(member, "buffer", offsets[BUFFERS]);
    break;
  case MATERIALS:
    shift_textures(member, false, offsets[TEXTURES]);
    break;
  case MESHES:
    shift_mesh(member, offsets);
    break;
  case NODES:
    shift(member, "mesh", offsets[MESHES]);
    shift_list(json_object_get(member, "children"), offsets[NODES]);
    break;
  case TEXTURES:
    shift(member, "sampler", offsets[SAMPLERS]);
    shift(member, "source", offsets[IMAGES]);
    break;
  }
}

static json_t *list_of(json_t *document, const char *key) {
  json_t *list = json_object_get(document, key);
  if (list == NULL) {
    list = json_array();
    json_object_set_new(document, key, list);
  }
  return list;
}

static void unite(json_t *document, const json_t *level, const char *key) {
  size_t i, k;
  json_t *name, *known;
  json_array_foreach(json_object_get(level, key), i, name) {
    bool found = false;
    json_array_foreach(list_of(document, key), k, known) found = found || json_equal(known, name);
    if (!found)
      json_array_append(list_of(document, key), name);
  }
}

/* Levels of one model mostly share materials, textures, samplers and images; then those of the document serve. */
static bool shares_materials(const struct merge *merge, const json_t *level) {
  static const size_t kShared[] = {MATERIALS, TEXTURES, SAMPLERS, IMAGES};
  for (size_t i = 0; i < sizeof kShared / sizeof kShared[0]; i++) {
    const json_t *mine = json_object_get(merge->document, kArrays[kShared[i]]), *its = json_object_get(level, kArrays[kShared[i]]);
    if (json_array_size(mine) != json_array_size(its) || (its != NULL && !json_equal(mine, its)))
      return false;
  }
  return true;
}

/* Adds the level's nodes under one node, whose number is returned. data: where the GLB's binary chunk begins. */
static size_t add_level(struct merge *merge, json_t *level, const struct lod_interop_level *facts, size_t data) {
  json_t *document = merge->document, *views = json_object_get(level, "bufferViews"), *value;
  size_t i;
  bool shared = shares_materials(merge, level);
  json_array_foreach(views, i, value)
      json_object_set_new(value, "byteOffset", json_integer(json_integer_value(json_object_get(value, "byteOffset")) + (json_int_t)data));
  json_object_set_new(level, "buffers", json_pack("[{sssI}]", "uri", facts->uri, "byteLength", (json_int_t)facts->bytes));
  for (size_t a = 0; a < ARRAY_COUNT; a++) {
    bool theirs = shared && (a == MATERIALS || a == TEXTURES || a == SAMPLERS || a == IMAGES);
    merge->offsets[a] = theirs ? 0 : json_array_size(json_object_get(document, kArrays[a]));
    if (theirs)
      json_object_del(level, kArrays[a]);
  }
  for (size_t a = 0; a < ARRAY_COUNT; a++)
    json_array_foreach(json_object_get(level, kArrays[a]), i, value) {
      shift_member(a, value, merge->offsets);
      json_array_append(list_of(document, kArrays[a]), value);
    }
  unite(document, level, "extensionsUsed");
  unite(document, level, "extensionsRequired");
  json_t *roots = json_object_get(json_array_get(json_object_get(level, "scenes"), 0), "nodes");
  shift_list(roots, merge->offsets[NODES]);
  char name[64];
  snprintf(name, sizeof name, "%s %u", facts->family, facts->number);
  json_t *nodes = list_of(document, "nodes");
  json_array_append_new(nodes, json_pack("{sssO}", "name", name, "children", roots));
  return json_array_size(nodes) - 1;
}

static uint32_t little_endian(const uint8_t *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

/* The JSON of an object that is a GLB; *data: where its binary chunk begins. NULL, and a problem, when it is none. */
static json_t *read_glb(const struct lod_interop_level *level, int bake_directory_fd, size_t *data, struct lod_problem *problem) {
  char path[16 + HASH_HEX];
  snprintf(path, sizeof path, "objects/%s", level->object);
  int fd = openat(bake_directory_fd, path, O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  struct stat facts = {0};
  json_t *json = NULL;
  if (fd >= 0 && fstat(fd, &facts) == 0 && S_ISREG(facts.st_mode) && facts.st_size >= 20 && (uint64_t)facts.st_size == level->bytes) {
    size_t size = (size_t)facts.st_size;
    const uint8_t *bytes = mmap(NULL, size, PROT_READ, MAP_PRIVATE, fd, 0);
    if (bytes != MAP_FAILED) {
      size_t length = little_endian(bytes + 12);
      if (memcmp(bytes, "glTF\2\0\0\0", 8) == 0 && memcmp(bytes + 16, "JSON", 4) == 0 && length <= size - 20) {
        json = json_loadb((const char *)bytes + 20, length, JSON_REJECT_DUPLICATES, NULL);
        *data = 20 + length + 8;
      }
      munmap((void *)bytes, size);
    }
  }
  if (fd >= 0)
    close(fd);
  if (!json_is_object(json) &&
      lod_fail(problem, LOD_BAD_INPUT, "bad-object", "objects/%.12s... is not the GLB that the manifest names.", level->object) != LOD_OK) {
    json_decref(json);
    return NULL;
  }
  return json;
}

/* Share of the screen that the sphere's disc covers where this error is one pixel. */
static double coverage(double error, double radius) {
  double across = error > 0 ? 2 * radius / (error * SCREEN_LINES) : 1;
  return fmin(1, acos(-1.0) / 4 * across * across);
}

enum lod_status lod_interop_gltf(const json_t *manifest, const struct lod_interop_level *levels, uint32_t count, int bake_directory_fd,
                                 char **text, struct lod_problem *problem) {
  struct merge merge = {.problem = problem};
  double radius = json_number_value(json_object_get(json_object_get(json_object_get(manifest, "source"), "sphere"), "radius"));
  merge.document = json_pack("{s{ssss}}", "asset", "version", "2.0", "generator", "Lodestream " LOD_VERSION);
  json_t *coarser = json_array(), *shares = json_array();
  size_t finest = 0;
  enum lod_status status = LOD_OK;
  for (uint32_t i = count; i > 0 && status == LOD_OK; i--) {
    size_t data = 0;
    json_t *level = read_glb(&levels[i - 1], bake_directory_fd, &data, problem);
    status = level == NULL ? problem->status : LOD_OK;
    if (level == NULL)
      break;
    size_t node = add_level(&merge, level, &levels[i - 1], data);
    json_decref(level);
    if (i == count)
      finest = node;
    else
      json_array_append_new(coarser, json_integer((json_int_t)node));
    json_array_append_new(shares, json_real(i > 1 ? coverage(levels[i - 2].error, radius) : 0));
  }
  if (status == LOD_OK && json_array_size(coarser) != 0) {
    json_t *node = json_array_get(json_object_get(merge.document, "nodes"), finest);
    json_object_set_new(node, "extensions", json_pack("{s{sO}}", "MSFT_lod", "ids", coarser));
    json_object_set_new(node, "extras", json_pack("{sO}", "MSFT_screencoverage", shares));
    json_array_append_new(list_of(merge.document, "extensionsUsed"), json_string("MSFT_lod"));
  }
  json_decref(coarser);
  json_decref(shares);
  json_object_set_new(merge.document, "scene", json_integer(0));
  json_object_set_new(merge.document, "scenes", json_pack("[{s[I]}]", "nodes", (json_int_t)finest));
  if (status == LOD_OK)
    return dump(merge.document, text, problem);
  json_decref(merge.document);
  return status;
}

enum lod_status lod_interop_glb(const char *text, uint8_t **glb, size_t *size, struct lod_problem *problem) {
  size_t length = strlen(text), padded = (length + 3) & ~(size_t)3;
  *size = 20 + padded;
  *glb = *size > UINT32_MAX ? NULL : malloc(*size);
  if (*glb == NULL)
    return lod_fail_memory(problem);
  const uint32_t words[5] = {0x46546c67, 2, (uint32_t)*size, (uint32_t)padded, 0x4e4f534a};
  for (size_t i = 0; i < 5; i++)
    for (size_t k = 0; k < 4; k++)
      (*glb)[4 * i + k] = (uint8_t)(words[i] >> 8 * k);
  memset(*glb + 20, ' ', padded);
  memcpy(*glb + 20, text, length);
  return LOD_OK;
}
