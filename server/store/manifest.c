#include "server/store/manifest.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What objects may be. A type beyond these would let a worker choose how a browser treats its bytes. */
static const char *const kTypes[] = {
    "model/gltf-binary",
    "application/json",
    "model/gltf+json",
    "image/png",
    "image/jpeg",
    "image/webp",
    "image/ktx2",
    "application/vnd.lodestream.delta",
    "application/vnd.lodestream.units",
    "application/vnd.lodestream.patches",
};
static const char kDeltaType[] = "application/vnd.lodestream.delta";
static const char kPatchesType[] = "application/vnd.lodestream.patches";

const char *lod_manifest_media_type(const char *type) {
  for (size_t i = 0; i < sizeof kTypes / sizeof kTypes[0]; i++)
    if (strcmp(kTypes[i], type) == 0)
      return kTypes[i];
  return NULL;
}

#define BAD(...) lod_fail(problem, LOD_BAD_INPUT, "bad-manifest", "manifest.json: " __VA_ARGS__)

/* ---- single members; `where` names the JSON object for people ---- */

static enum lod_status get_object(const json_t *json, const char *where, const char *key, json_t **value, struct lod_problem *problem) {
  *value = json_object_get(json, key);
  if (!json_is_object(*value))
    return BAD("%s.%s is missing or not an object", where, key);
  return LOD_OK;
}

static enum lod_status get_count(const json_t *json, const char *where, const char *key, uint64_t *count, struct lod_problem *problem) {
  const json_t *value = json_object_get(json, key);
  if (!json_is_integer(value) || json_integer_value(value) < 0)
    return BAD("%s.%s is missing or not a count", where, key);
  *count = (uint64_t)json_integer_value(value);
  return LOD_OK;
}

/* A number that is finite and not negative. */
static enum lod_status get_measure(const json_t *json, const char *where, const char *key, double *measure, struct lod_problem *problem) {
  const json_t *value = json_object_get(json, key);
  *measure = json_number_value(value);
  if (!json_is_number(value) || !isfinite(*measure) || *measure < 0)
    return BAD("%s.%s is missing or not a finite number of at least 0", where, key);
  return LOD_OK;
}

static enum lod_status check_text(const json_t *json, const char *where, const char *key, struct lod_problem *problem) {
  if (!json_is_string(json_object_get(json, key)))
    return BAD("%s.%s is missing or not a text", where, key);
  return LOD_OK;
}

static enum lod_status check_numbers(const json_t *array, size_t count, const char *where, struct lod_problem *problem) {
  if (!json_is_array(array) || json_array_size(array) != count)
    return BAD("%s is missing or does not hold %zu numbers", where, count);
  for (size_t i = 0; i < count; i++) {
    const json_t *value = json_array_get(array, i);
    if (!json_is_number(value) || !isfinite(json_number_value(value)))
      return BAD("%s[%zu] is not a finite number", where, i);
  }
  return LOD_OK;
}

static bool is_sha256(const char *text) {
  return strlen(text) == LOD_SHA256_HEX && strspn(text, "0123456789abcdef") == LOD_SHA256_HEX;
}

/* ---- source, parts, textures ---- */

static enum lod_status check_source(const json_t *root, struct lod_manifest *manifest, struct lod_problem *problem) {
  json_t *source, *bounds, *sphere;
  uint64_t count = 0;
  double measure = 0;
  LOD_TRY(get_object(root, "", "source", &source, problem));
  LOD_TRY(check_text(source, "source", "format", problem));
  LOD_TRY(check_text(source, "source", "name", problem));
  LOD_TRY(check_text(source, "source", "sha256", problem));
  if (!is_sha256(json_string_value(json_object_get(source, "sha256"))))
    return BAD("source.sha256 is not 64 lower-case hex digits");
  static const char *const kCounts[] = {"bytes", "vertices", "components", "boundary_loops"};
  for (size_t i = 0; i < sizeof kCounts / sizeof kCounts[0]; i++)
    LOD_TRY(get_count(source, "source", kCounts[i], &count, problem));
  LOD_TRY(get_count(source, "source", "triangles", &manifest->triangles, problem));
  if (!json_is_boolean(json_object_get(source, "closed")))
    return BAD("source.closed is missing or not true or false");
  LOD_TRY(get_measure(source, "source", "diagonal", &manifest->diagonal, problem));
  LOD_TRY(get_object(source, "source", "bounds", &bounds, problem));
  const json_t *low = json_object_get(bounds, "min"), *high = json_object_get(bounds, "max");
  LOD_TRY(check_numbers(low, 3, "source.bounds.min", problem));
  LOD_TRY(check_numbers(high, 3, "source.bounds.max", problem));
  for (size_t i = 0; i < 3; i++)
    if (json_number_value(json_array_get(low, i)) > json_number_value(json_array_get(high, i)))
      return BAD("source.bounds: min[%zu] is above max[%zu]", i, i);
  LOD_TRY(get_object(source, "source", "sphere", &sphere, problem));
  LOD_TRY(check_numbers(json_object_get(sphere, "center"), 3, "source.sphere.center", problem));
  return get_measure(sphere, "source.sphere", "radius", &measure, problem);
}

static enum lod_status check_textures(const json_t *root, struct lod_problem *problem) {
  const json_t *textures = json_object_get(root, "textures");
  if (textures == NULL)
    return LOD_OK;
  if (!json_is_array(textures))
    return BAD("textures is not a list");
  for (size_t i = 0; i < json_array_size(textures); i++) {
    const json_t *texture = json_array_get(textures, i);
    uint64_t count = 0;
    if (!json_is_object(texture))
      return BAD("textures[%zu] is not an object", i);
    LOD_TRY(check_text(texture, "textures[]", "object", problem));
    LOD_TRY(check_text(texture, "textures[]", "type", problem));
    LOD_TRY(get_count(texture, "textures[]", "bytes", &count, problem));
    LOD_TRY(get_count(texture, "textures[]", "width", &count, problem));
    LOD_TRY(get_count(texture, "textures[]", "height", &count, problem));
  }
  return LOD_OK;
}

/* ---- families ---- */

/* A name that goes into a URL's query and a response header. */
static bool is_family_name(const char *name) {
  size_t length = strlen(name);
  return length >= 1 && length <= 32 && strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789-") == length && strcmp(name, "auto") != 0;
}

/* level.delta or level.first: name and bytes. */
static enum lod_status read_step(const json_t *level, size_t index, const char *where, const char *key, char name[LOD_SHA256_HEX + 1],
                                 uint64_t *bytes, struct lod_problem *problem) {
  const json_t *json = json_object_get(level, key);
  uint64_t to = 0;
  if (json == NULL)
    return LOD_OK;
  const char *object = json_string_value(json_object_get(json, "object"));
  if (!json_is_object(json) || object == NULL || !is_sha256(object))
    return BAD("%s.levels[%zu].%s is not an object with an object's name", where, index, key);
  LOD_TRY(get_count(json, where, "bytes", bytes, problem));
  if (strcmp(key, "delta") == 0)
    LOD_TRY(get_count(json, where, "to", &to, problem));
  else if (json_string_value(json_object_get(json, "type")) == NULL ||
           strcmp(json_string_value(json_object_get(json, "type")), kDeltaType) != 0)
    return BAD("%s.levels[%zu].%s.type is not %s", where, index, key, kDeltaType);
  if (strcmp(key, "delta") == 0 ? to != index + 1 : index != 0)
    return BAD("%s.levels[%zu].%s leads somewhere else than to the next level", where, index, key);
  memcpy(name, object, LOD_SHA256_HEX + 1);
  return LOD_OK;
}

static enum lod_status read_patches(const json_t *level, size_t index, const char *where, struct lod_stored_level *stored,
                                    struct lod_problem *problem) {
  const json_t *json = json_object_get(level, "patches");
  if (json == NULL)
    return LOD_OK;
  const char *object = json_string_value(json_object_get(json, "object")), *type = json_string_value(json_object_get(json, "type"));
  if (!json_is_object(json) || object == NULL || !is_sha256(object) || type == NULL || strcmp(type, kPatchesType) != 0)
    return BAD("%s.levels[%zu].patches is not an object with an object's name and the type %s", where, index, kPatchesType);
  LOD_TRY(get_count(json, where, "patches", &stored->patch_facts.triangles, problem));
  LOD_TRY(get_count(json, where, "bytes", &stored->patch_facts.bytes, problem));
  LOD_TRY(get_measure(json, where, "error", &stored->patch_facts.error, problem));
  memcpy(stored->patches, object, LOD_SHA256_HEX + 1);
  return LOD_OK;
}

static enum lod_status read_level(const json_t *json, size_t index, const char *where, bool whole, struct lod_stored_level *level,
                                  struct lod_problem *problem) {
  uint64_t number = 0, count = 0;
  double lower = 0;
  if (!json_is_object(json))
    return BAD("%s.levels[%zu] is not an object", where, index);
  LOD_TRY(get_count(json, where, "level", &number, problem));
  if (number != index)
    return BAD("%s.levels[%zu] says that it is level %llu", where, index, (unsigned long long)number);
  level->level = (uint32_t)number;
  LOD_TRY(get_count(json, where, "vertices", &count, problem));
  LOD_TRY(get_count(json, where, "triangles", &level->facts.triangles, problem));
  LOD_TRY(get_measure(json, where, "error", &level->facts.error, problem));
  if (json_object_get(json, "error_lower") != NULL) {
    LOD_TRY(get_measure(json, where, "error_lower", &lower, problem));
    if (lower > level->facts.error)
      return BAD("%s.levels[%zu]: error_lower is above error", where, index);
  }
  if (json_object_get(json, "cell") != NULL)
    LOD_TRY(get_measure(json, where, "cell", &level->facts.cell, problem));
  if (!whole)
    return LOD_OK;
  LOD_TRY(get_count(json, where, "bytes", &level->facts.bytes, problem));
  LOD_TRY(check_text(json, where, "object", problem));
  LOD_TRY(check_text(json, where, "type", problem));
  const char *name = json_string_value(json_object_get(json, "object"));
  level->type = lod_manifest_media_type(json_string_value(json_object_get(json, "type")));
  if (!is_sha256(name) || level->type == NULL)
    return BAD("%s.levels[%zu]: object or type is wrong", where, index);
  memcpy(level->sha256, name, sizeof level->sha256);
  LOD_TRY(read_patches(json, index, where, level, problem));
  LOD_TRY(read_step(json, index, where, "delta", level->delta, &level->delta_bytes, problem));
  return read_step(json, index, where, "first", level->first, &level->first_bytes, problem);
}

/* whole: of the whole model, which selection uses; else of a part, where the GLB's name and size may be left out. */
static enum lod_status read_family(const char *name, const json_t *json, bool whole, struct lod_stored_family *family,
                                   struct lod_problem *problem) {
  if (!is_family_name(name) || !json_is_object(json))
    return BAD("families has a member with a wrong name or shape");
  const json_t *nested = json_object_get(json, "nested"), *levels = json_object_get(json, "levels");
  if (!json_is_boolean(nested))
    return BAD("families.%s.nested is missing or not true or false", name);
  size_t count = json_array_size(levels);
  if (!json_is_array(levels) || count == 0 || count > LOD_MANIFEST_MAX_LEVELS)
    return BAD("families.%s.levels is missing or does not hold 1 to %d levels", name, LOD_MANIFEST_MAX_LEVELS);
  family->nested = json_is_true(nested);
  family->name = strdup(name);
  family->levels = calloc(count, sizeof *family->levels);
  if (family->name == NULL || family->levels == NULL)
    return lod_fail_memory(problem);
  family->level_count = (uint32_t)count;
  for (size_t i = 0; i < count; i++)
    LOD_TRY(read_level(json_array_get(levels, i), i, name, whole, &family->levels[i], problem));
  if (family->levels[count - 1].delta[0] != '\0')
    return BAD("%s.levels: the last one has a delta, to no level", name);
  return LOD_OK;
}

static void free_family(struct lod_stored_family *family) {
  free((char *)family->name);
  free(family->levels);
}

static enum lod_status read_families(const json_t *root, struct lod_manifest *manifest, struct lod_problem *problem) {
  json_t *families, *json;
  const char *name;
  LOD_TRY(get_object(root, "", "families", &families, problem));
  size_t count = json_object_size(families);
  if (count == 0 || count > LOD_MANIFEST_MAX_FAMILIES)
    return BAD("families does not hold 1 to %d families", LOD_MANIFEST_MAX_FAMILIES);
  manifest->families = calloc(count, sizeof *manifest->families);
  if (manifest->families == NULL)
    return lod_fail_memory(problem);
  json_object_foreach(families, name, json) LOD_TRY(read_family(name, json, true, &manifest->families[manifest->family_count++], problem));
  return LOD_OK;
}

static enum lod_status check_part(const json_t *part, size_t index, struct lod_problem *problem) {
  char where[64];
  if (!json_is_object(part) || !json_is_string(json_object_get(part, "name")))
    return BAD("parts[%zu] is not an object with a name", index);
  const json_t *instances = json_object_get(part, "instances");
  if (!json_is_array(instances) || json_array_size(instances) == 0)
    return BAD("parts[%zu].instances is missing or empty", index);
  for (size_t i = 0; i < json_array_size(instances); i++) {
    snprintf(where, sizeof where, "parts[%zu].instances[%zu]", index, i);
    LOD_TRY(check_numbers(json_array_get(instances, i), 16, where, problem));
  }
  json_t *families = json_object_get(part, "families"), *json;
  const char *name;
  if (families != NULL && !json_is_object(families))
    return BAD("parts[%zu].families is not an object", index);
  json_object_foreach(families, name, json) {
    struct lod_stored_family family = {0};
    enum lod_status status = read_family(name, json, false, &family, problem);
    free_family(&family);
    if (status != LOD_OK)
      return status;
  }
  return LOD_OK;
}

static enum lod_status check_parts(const json_t *root, struct lod_problem *problem) {
  const json_t *parts = json_object_get(root, "parts");
  if (!json_is_array(parts) || json_array_size(parts) == 0)
    return BAD("parts is missing or empty");
  for (size_t i = 0; i < json_array_size(parts); i++)
    LOD_TRY(check_part(json_array_get(parts, i), i, problem));
  return LOD_OK;
}

/* The name of root[key].object; "" when there is none. Its type decides how browsers take it, so it is fixed. */
static enum lod_status read_document(const json_t *root, const char *key, const char *type, char name[LOD_SHA256_HEX + 1],
                                     struct lod_problem *problem) {
  const json_t *json = json_object_get(root, key);
  name[0] = '\0';
  if (json == NULL)
    return LOD_OK;
  const char *object = json_string_value(json_object_get(json, "object")), *given = json_string_value(json_object_get(json, "type"));
  if (object == NULL || !is_sha256(object) || given == NULL || strcmp(given, type) != 0)
    return BAD("%s is not an object of type %s", key, type);
  memcpy(name, object, LOD_SHA256_HEX + 1);
  return LOD_OK;
}

/* ---- object references ---- */

struct references {
  struct lod_manifest_object *list;
  size_t count, capacity;
};

static enum lod_status add_reference(struct references *references, const json_t *json, bool share, bool delta,
                                     struct lod_problem *problem) {
  const char *name = json_string_value(json_object_get(json, "object"));
  const json_t *type = json_object_get(json, "type"), *bytes = json_object_get(json, "bytes");
  if (name == NULL || !is_sha256(name))
    return BAD("an object is not named by 64 lower-case hex digits");
  struct lod_manifest_object object = {.type = delta ? lod_manifest_media_type(kDeltaType) : NULL};
  memcpy(object.sha256, name, sizeof object.sha256);
  if (json_is_string(type))
    object.type = lod_manifest_media_type(json_string_value(type));
  if ((type != NULL || !share) && object.type == NULL)
    return BAD("object %.12s has a missing or unknown type", name);
  if (bytes != NULL || !share) {
    if (!json_is_integer(bytes) || json_integer_value(bytes) <= 0)
      return BAD("object %.12s has a missing or wrong size", name);
    object.bytes = share ? 0 : (uint64_t)json_integer_value(bytes);
  }
  if (references->count == references->capacity) {
    size_t capacity = references->capacity == 0 ? 64 : references->capacity * 2;
    void *list = reallocarray(references->list, capacity, sizeof *references->list);
    if (list == NULL)
      return lod_fail_memory(problem);
    references->list = list;
    references->capacity = capacity;
  }
  references->list[references->count++] = object;
  return LOD_OK;
}

/* share: inside parts, whose figures are a share of the file. */
static enum lod_status collect(struct references *references, const json_t *json, bool share, const char *member, int depth,
                               struct lod_problem *problem) {
  if (depth > LOD_MANIFEST_MAX_DEPTH)
    return BAD("nested deeper than %d", LOD_MANIFEST_MAX_DEPTH);
  if (json_is_array(json))
    for (size_t i = 0; i < json_array_size(json); i++)
      LOD_TRY(collect(references, json_array_get(json, i), share, member, depth + 1, problem));
  if (!json_is_object(json))
    return LOD_OK;
  if (json_object_get(json, "object") != NULL)
    LOD_TRY(add_reference(references, json, share, strcmp(member, "delta") == 0, problem));
  const char *key;
  json_t *value;
  json_object_foreach((json_t *)json, key, value)
      LOD_TRY(collect(references, value, share || (depth == 0 && strcmp(key, "parts") == 0), key, depth + 1, problem));
  return LOD_OK;
}

static int compare_objects(const void *a, const void *b) {
  return strcmp(((const struct lod_manifest_object *)a)->sha256, ((const struct lod_manifest_object *)b)->sha256);
}

/* One entry an object; what several references say of it must agree. */
static enum lod_status merge_references(struct references *references, struct lod_problem *problem) {
  if (references->count > 1)
    qsort(references->list, references->count, sizeof *references->list, compare_objects);
  size_t kept = 0;
  for (size_t i = 0; i < references->count; i++) {
    const struct lod_manifest_object *next = &references->list[i];
    struct lod_manifest_object *last = kept == 0 ? NULL : &references->list[kept - 1];
    if (last == NULL || compare_objects(last, next) != 0) {
      references->list[kept++] = *next;
      continue;
    }
    if ((last->type != NULL && next->type != NULL && last->type != next->type) ||
        (last->bytes != 0 && next->bytes != 0 && last->bytes != next->bytes))
      return BAD("object %.12s is described in two ways", next->sha256);
    if (last->type == NULL)
      last->type = next->type;
    if (last->bytes == 0)
      last->bytes = next->bytes;
  }
  references->count = kept;
  for (size_t i = 0; i < kept; i++)
    if (references->list[i].type == NULL)
      return BAD("object %.12s has no type", references->list[i].sha256);
  if (kept > LOD_MANIFEST_MAX_OBJECTS)
    return BAD("more than %d objects", LOD_MANIFEST_MAX_OBJECTS);
  return LOD_OK;
}

static enum lod_status collect_objects(const json_t *root, struct lod_manifest *manifest, struct lod_problem *problem) {
  struct references references = {0};
  enum lod_status status = collect(&references, root, false, "", 0, problem);
  if (status == LOD_OK)
    status = merge_references(&references, problem);
  manifest->objects = references.list;
  manifest->object_count = references.count;
  return status;
}

/* ---- the whole ---- */

static enum lod_status check_head(json_t *root, const char *text, size_t size, const char *id, struct lod_manifest *manifest,
                                  struct lod_problem *problem) {
  LOD_TRY(check_text(root, "", "id", problem));
  LOD_TRY(check_text(root, "", "revision", problem));
  const char *revision = json_string_value(json_object_get(root, "revision"));
  size_t length = strlen(revision);
  /* It goes into ETags and URLs. */
  if (length == 0 || length > 128 || strspn(revision, "0123456789abcdefghijklmnopqrstuvwxyz-") != length)
    return BAD("revision is not 1 to 128 of a-z, 0-9 and dash");
  manifest->revision = strdup(revision);
  manifest->id = strdup(id);
  if (strcmp(json_string_value(json_object_get(root, "id")), id) == 0) {
    manifest->text = malloc(size + 1);
    if (manifest->text != NULL) {
      memcpy(manifest->text, text, size);
      manifest->text[size] = 0;
    }
    manifest->size = size;
  } else if (json_object_set_new(root, "id", json_string(id)) == 0) {
    /* 17 digits bring every double back unchanged: a certified error must not be rounded down. */
    manifest->text = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(17));
    manifest->size = manifest->text == NULL ? 0 : strlen(manifest->text);
  }
  return manifest->text == NULL || manifest->revision == NULL || manifest->id == NULL ? lod_fail_memory(problem) : LOD_OK;
}

static enum lod_status check_bake(const json_t *root, struct lod_problem *problem) {
  json_t *bake, *settings;
  double seconds = 0;
  LOD_TRY(get_object(root, "", "bake", &bake, problem));
  LOD_TRY(get_object(bake, "bake", "settings", &settings, problem));
  LOD_TRY(get_measure(bake, "bake", "seconds", &seconds, problem));
  const json_t *warnings = json_object_get(bake, "warnings");
  if (!json_is_array(warnings))
    return BAD("bake.warnings is missing or not a list");
  for (size_t i = 0; i < json_array_size(warnings); i++)
    if (!json_is_string(json_array_get(warnings, i)))
      return BAD("bake.warnings[%zu] is not a text", i);
  return LOD_OK;
}

static enum lod_status parse(json_t *root, const char *text, size_t size, const char *id, struct lod_manifest *manifest,
                             struct lod_problem *problem) {
  if (!json_is_object(root))
    return BAD("not a JSON object");
  LOD_TRY(check_head(root, text, size, id, manifest, problem));
  LOD_TRY(check_source(root, manifest, problem));
  LOD_TRY(read_families(root, manifest, problem));
  LOD_TRY(check_parts(root, problem));
  LOD_TRY(check_textures(root, problem));
  LOD_TRY(check_bake(root, problem));
  LOD_TRY(read_document(root, "tileset", "application/json", manifest->tileset, problem));
  LOD_TRY(read_document(root, "gltf", "model/gltf-binary", manifest->gltf, problem));
  char materials[LOD_SHA256_HEX + 1]; /* only named */
  LOD_TRY(read_document(root, "materials", "model/gltf+json", materials, problem));
  return collect_objects(root, manifest, problem);
}

enum lod_status lod_manifest_parse(const char *text, size_t size, const char *id, struct lod_manifest **manifest,
                                   struct lod_problem *problem) {
  *manifest = NULL;
  if (size > LOD_MANIFEST_MAX_BYTES)
    return BAD("larger than %d bytes", LOD_MANIFEST_MAX_BYTES);
  if (memchr(text, 0, size) != NULL)
    return BAD("holds a NUL byte"); /* jansson takes one behind a number for white space */
  json_error_t error;
  json_t *root = json_loadb(text, size, JSON_REJECT_DUPLICATES, &error);
  if (root == NULL)
    return BAD("line %d, column %d: %s", error.line, error.column, error.text);
  struct lod_manifest *result = calloc(1, sizeof *result);
  enum lod_status status = result == NULL ? lod_fail_memory(problem) : parse(root, text, size, id, result, problem);
  json_decref(root);
  if (status != LOD_OK) {
    lod_manifest_destroy(result);
    return status;
  }
  *manifest = result;
  return LOD_OK;
}

void lod_manifest_destroy(struct lod_manifest *manifest) {
  if (manifest == NULL)
    return;
  for (uint32_t i = 0; i < manifest->family_count; i++)
    free_family(&manifest->families[i]);
  free(manifest->families);
  free(manifest->objects);
  free(manifest->revision);
  free(manifest->id);
  free(manifest->text);
  free(manifest);
}
