#include "server/worker/manifest.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/export/glb.h"
#include "codec/export/interop.h"
#include "codec/stream/units.h"

/* Half a unit of the ninth digit is up to 5e-9 of a number that begins with 1. */
double lod_manifest_raise(double upper) {
  return upper * (1 + 5.01e-9);
}

double lod_manifest_lower(double lower) {
  return lower * (1 - 5.01e-9);
}

static json_t *upper_bound(double value) {
  return json_real(lod_manifest_raise(value));
}

static json_t *lower_bound(double value) {
  return json_real(lod_manifest_lower(value));
}

static json_t *numbers(const double *values, size_t count) {
  json_t *array = json_array();
  for (size_t i = 0; i < count; i++)
    json_array_append_new(array, json_real(values[i]));
  return array;
}

/* Names come from files: what is not UTF-8 must not cost the manifest. */
static json_t *text(const char *string) {
  json_t *value = json_string(string);
  return value != NULL ? value : json_string("(name is not UTF-8)");
}

/* The widest picture's side: what a difference of UV is at most in texels. */
static double most_texels(const struct lod_model *model) {
  double most = 0;
  for (uint32_t i = 0; i < model->image_count; i++) {
    most = model->images[i].width > most ? model->images[i].width : most;
    most = model->images[i].height > most ? model->images[i].height : most;
  }
  return most;
}

static json_t *drift_json(const struct lod_baked_level *level, const struct lod_model *model) {
  json_t *json = level->has_drift ? json_pack("{sf sf}", "uv", level->uv_drift, "normal_degrees", level->normal_drift) : json_object();
  if (level->has_drift && most_texels(model) > 0)
    json_object_set_new(json, "texels", json_real(level->uv_drift * most_texels(model)));
  if (level->uv_bound > 0 && isfinite(level->uv_bound)) {
    json_object_set_new(json, "uv_bound", json_real(level->uv_bound));
    if (most_texels(model) > 0)
      json_object_set_new(json, "texels_bound", json_real(level->uv_bound * most_texels(model)));
  }
  if (level->normal_bound > 0 && isfinite(level->normal_bound))
    json_object_set_new(json, "normal_degrees_bound", json_real(level->normal_bound));
  return json;
}

/* How far UVs and colours of patches are off at corresponding points. */
static void add_slip(const struct lod_baked_level *level, const struct lod_model *model, json_t *patches) {
  json_t *slip = json_object();
  if (level->uv_bound > 0 && isfinite(level->uv_bound)) {
    json_object_set_new(slip, "uv", upper_bound(level->uv_bound));
    if (most_texels(model) > 0)
      json_object_set_new(slip, "texels", upper_bound(level->uv_bound * most_texels(model)));
  }
  if (level->patches.color_bound > 0)
    json_object_set_new(slip, "color", upper_bound(level->patches.color_bound));
  if (json_object_size(slip) != 0)
    json_object_set(patches, "slip", slip);
  json_decref(slip);
}

static json_t *level_json(const struct lod_baked_level *level, uint32_t index, const struct lod_model *model) {
  json_t *json = json_pack("{sI sI sI sI sI}", "level", (json_int_t)index, "vertices", (json_int_t)level->vertices, "triangles",
                           (json_int_t)level->triangles, "edges", (json_int_t)level->edges, "points", (json_int_t)level->points);
  json_object_set_new(json, "error", upper_bound(level->error.upper));
  json_object_set_new(json, "error_lower", lower_bound(level->error.lower));
  if (level->cell > 0)
    json_object_set_new(json, "cell", json_real(level->cell));
  if (level->counted) {
    json_object_set_new(json, "candidates", json_integer((json_int_t)level->candidates));
    json_object_set_new(json, "retained", json_integer((json_int_t)level->retained));
  }
  if (level->asked != 0)
    json_object_set_new(json, "vertices_asked", json_integer((json_int_t)level->asked));
  if (level->has_drift || (level->uv_bound > 0 && isfinite(level->uv_bound)))
    json_object_set_new(json, "drift", drift_json(level, model));
  json_object_set_new(json, "bytes", json_integer((json_int_t)level->size));
  json_object_set_new(json, "object", json_string(level->object));
  json_object_set_new(json, "type", json_string("model/gltf-binary"));
  if (level->patches.size != 0) {
    json_t *patches = json_pack("{sI sI ss ss}", "patches", (json_int_t)level->patches.count, "bytes", (json_int_t)level->patches.size,
                                "object", level->patches.object, "type", "application/vnd.lodestream.patches");
    json_object_set_new(patches, "error", upper_bound(level->patches.error));
    add_slip(level, model, patches);
    json_object_set_new(json, "patches", patches);
  }
  if (level->delta.size != 0) {
    json_t *delta =
        json_pack("{sI sI ss}", "to", (json_int_t)index + 1, "bytes", (json_int_t)level->delta.size, "object", level->delta.object);
    if (level->delta.units.size != 0)
      json_object_set_new(delta, "units",
                          json_pack("{sI sI sI ss ss}", "units", (json_int_t)level->delta.units.count, "first",
                                    (json_int_t)level->delta.units.first, "bytes", (json_int_t)level->delta.units.size, "object",
                                    level->delta.units.object, "type", LOD_UNITS_TYPE));
    if (level->delta.overlaid)
      json_object_set_new(delta, "unmapped", json_integer((json_int_t)level->delta.unmapped));
    json_object_set_new(json, "delta", delta);
  }
  if (level->first.size != 0)
    json_object_set_new(
        json, "first",
        json_pack("{sI ss ss}", "bytes", (json_int_t)level->first.size, "object", level->first.object, "type", LOD_DELTA_TYPE));
  return json;
}

/* Where a level's triangles, of any family, need fewer bytes than these patches at no more error, the manifest says so. */
static void name_polygons(const struct lod_manifest_facts *facts, const struct lod_baked_level *curved, json_t *json) {
  size_t fewest = curved->patches.size;
  const struct lod_family *family = NULL;
  uint32_t index = 0;
  for (uint32_t f = 0; f < facts->family_count; f++)
    for (uint32_t i = 0; i < facts->families[f].level_count; i++) {
      const struct lod_baked_level *level = &facts->families[f].levels[i];
      if (level->error.upper > curved->patches.error || level->size >= fewest)
        continue;
      fewest = level->size;
      family = facts->families[f].family;
      index = i;
    }
  if (family != NULL)
    json_object_set_new(json_object_get(json, "patches"), "polygons",
                        json_pack("{ss sI sI}", "family", family->name, "level", (json_int_t)index, "bytes", (json_int_t)fewest));
}

static json_t *families_json(const struct lod_manifest_facts *facts) {
  json_t *families = json_object();
  for (uint32_t f = 0; f < facts->family_count; f++) {
    const struct lod_baked_family *family = &facts->families[f];
    json_t *levels = json_array();
    for (uint32_t i = 0; i < family->level_count; i++) {
      json_t *level = level_json(&family->levels[i], i, facts->model);
      if (family->levels[i].patches.size != 0)
        name_polygons(facts, &family->levels[i], level);
      json_array_append_new(levels, level);
    }
    json_object_set_new(families, family->family->name, json_pack("{sb so}", "nested", family->nested, "levels", levels));
  }
  return families;
}

static json_t *part_families_json(const struct lod_manifest_facts *facts, uint32_t part) {
  json_t *families = json_object();
  for (uint32_t f = 0; f < facts->family_count; f++) {
    const struct lod_baked_family *family = &facts->families[f];
    json_t *levels = json_array();
    for (uint32_t i = 0; i < family->level_count; i++) {
      const struct lod_part_figures *figures = &family->levels[i].parts[part];
      json_t *level = json_pack("{sI sI sI sI sI}", "level", (json_int_t)i, "vertices", (json_int_t)figures->vertices, "triangles",
                                (json_int_t)figures->triangles, "edges", (json_int_t)figures->edges, "points", (json_int_t)figures->points);
      json_object_set_new(level, "error", upper_bound(figures->error));
      json_object_set_new(level, "bytes", json_integer((json_int_t)family->levels[i].size));
      json_object_set_new(level, "object", json_string(family->levels[i].object));
      json_object_set_new(level, "type", json_string("model/gltf-binary"));
      json_array_append_new(levels, level);
    }
    json_object_set_new(families, family->family->name, json_pack("{sb so}", "nested", family->nested, "levels", levels));
  }
  return families;
}

static json_t *parts_json(const struct lod_manifest_facts *facts) {
  json_t *parts = json_array();
  for (uint32_t p = 0; p < facts->model->part_count; p++) {
    const struct lod_part *part = &facts->model->parts[p];
    json_t *instances = json_array();
    for (uint32_t i = 0; i < part->instance_count; i++)
      json_array_append_new(instances, numbers(part->instances[i], 16));
    json_t *json = json_object();
    json_object_set_new(json, "name", text(part->name));
    json_object_set_new(json, "instances", instances);
    json_object_set_new(json, "families", part_families_json(facts, p));
    json_array_append_new(parts, json);
  }
  return parts;
}

static json_t *source_json(const struct lod_manifest_facts *facts) {
  const struct lod_source_facts *source = facts->source;
  json_t *json = json_object();
  json_object_set_new(json, "format", json_string(facts->model->format));
  json_object_set_new(json, "name", text(facts->request->name));
  json_object_set_new(json, "sha256", json_string(source->sha256));
  json_object_set_new(json, "bytes", json_integer((json_int_t)source->bytes));
  json_object_set_new(json, "vertices", json_integer((json_int_t)facts->model->source_vertices));
  json_object_set_new(json, "triangles", json_integer((json_int_t)facts->model->source_triangles));
  json_object_set_new(json, "components", json_integer((json_int_t)source->components));
  json_object_set_new(json, "boundary_loops", json_integer((json_int_t)source->boundary_loops));
  json_object_set_new(json, "non_manifold_edges", json_integer((json_int_t)source->non_manifold_edges));
  json_object_set_new(json, "degenerate_triangles", json_integer((json_int_t)source->degenerate_triangles));
  json_object_set_new(json, "closed", json_boolean(source->closed));
  json_object_set_new(json, "diagonal", json_real(lod_bounds_diagonal(&source->bounds)));
  json_object_set_new(json, "bounds", json_pack("{so so}", "min", numbers(source->bounds.min, 3), "max", numbers(source->bounds.max, 3)));
  json_object_set_new(json, "sphere",
                      json_pack("{so so}", "center", numbers(source->sphere.center, 3), "radius", json_real(source->sphere.radius)));
  return json;
}

static json_t *textures_json(const struct lod_manifest_facts *facts) {
  json_t *textures = json_array();
  for (uint32_t i = 0; i < facts->model->image_count; i++) {
    const struct lod_image *image = &facts->model->images[i];
    json_array_append_new(textures,
                          json_pack("{ss ss sI sI sI}", "object", facts->image_objects[i], "type", image->mime, "bytes",
                                    (json_int_t)image->size, "width", (json_int_t)image->width, "height", (json_int_t)image->height));
  }
  return textures;
}

static json_t *settings_json(const struct lod_bake_request *request) {
  json_t *families = json_array();
  for (uint32_t i = 0; i < request->family_count; i++)
    json_array_append_new(families, json_string(request->families[i]));
  json_t *epsilons = json_array();
  for (uint32_t i = 0; i < request->epsilon_count; i++) {
    char value[40];
    double epsilon = request->epsilons[i];
    snprintf(value, sizeof value, request->epsilon_relative[i] ? "%.9g%%" : "%.9g", request->epsilon_relative[i] ? 100 * epsilon : epsilon);
    json_array_append_new(epsilons, json_string(value));
  }
  json_t *settings = json_pack("{so so ss}", "families", families, "epsilons", epsilons, "version", LOD_VERSION);
  if (request->patches_count > 0) {
    json_t *patches = json_array();
    for (uint32_t i = 0; i < request->patches_count; i++)
      json_array_append_new(patches, json_integer((json_int_t)request->patches[i]));
    json_object_set_new(settings, "patches", patches);
  }
  return settings;
}

static enum lod_status add_document(json_t *manifest, const char *key, const char *type, const void *bytes, size_t size, int directory_fd,
                                    struct lod_problem *problem) {
  char object[LOD_HASH_HEX + 1];
  LOD_TRY(lod_output_object(directory_fd, bytes, size, object, problem));
  json_object_set_new(manifest, key, json_pack("{ss ss sI}", "object", object, "type", type, "bytes", (json_int_t)size));
  return LOD_OK;
}

/* Levels lie beside both documents under their own names. */
static enum lod_status add_documents(json_t *manifest, int directory_fd, struct lod_problem *problem) {
  struct lod_interop_level levels[LOD_INTEROP_LEVELS];
  uint32_t count = lod_interop_choose(manifest, levels);
  char *tileset = NULL, *gltf = NULL;
  uint8_t *glb = NULL;
  size_t size = 0;
  if (count == 0)
    return LOD_OK;
  enum lod_status status = lod_interop_tileset(manifest, levels, count, &tileset, problem);
  if (status == LOD_OK)
    status = add_document(manifest, "tileset", "application/json", tileset, strlen(tileset), directory_fd, problem);
  if (status == LOD_OK)
    status = lod_interop_gltf(manifest, levels, count, directory_fd, &gltf, problem);
  if (status == LOD_OK)
    status = lod_interop_glb(gltf, &glb, &size, problem);
  if (status == LOD_OK)
    status = add_document(manifest, "gltf", "model/gltf-binary", glb, size, directory_fd, problem);
  free(tileset);
  free(gltf);
  free(glb);
  return status;
}

/* Patch streams name materials by number: where there are any, the materials are a document of their own. */
static enum lod_status add_materials(const struct lod_manifest_facts *facts, json_t *manifest, struct lod_problem *problem) {
  bool curved = false;
  for (uint32_t f = 0; f < facts->family_count; f++)
    for (uint32_t i = 0; i < facts->families[f].level_count; i++)
      curved = curved || facts->families[f].levels[i].patches.size != 0;
  if (!curved || facts->model->material_count == 0)
    return LOD_OK;
  struct lod_arena *arena = lod_arena_create(0);
  const char **uris = arena == NULL ? NULL : LOD_NEW(arena, facts->model->image_count, const char *);
  enum lod_status status = uris == NULL ? lod_fail_memory(problem) : LOD_OK;
  for (uint32_t i = 0; status == LOD_OK && i < facts->model->image_count; i++)
    uris[i] = facts->image_objects[i];
  char *text = NULL;
  if (status == LOD_OK)
    status = lod_gltf_materials_write(facts->model, uris, arena, &text, problem);
  if (status == LOD_OK)
    status = add_document(manifest, "materials", "model/gltf+json", text, strlen(text), facts->request->directory_fd, problem);
  lod_arena_destroy(arena);
  return status;
}

enum lod_status lod_manifest_text(const struct lod_manifest_facts *facts, char **text_out, struct lod_problem *problem) {
  json_t *settings = settings_json(facts->request);
  char *settings_text = json_dumps(settings, JSON_COMPACT);
  char revision[LOD_HASH_HEX + 1] = "";
  if (settings_text != NULL) {
    char key[LOD_HASH_HEX + 4096];
    int length = snprintf(key, sizeof key, "%s%s", facts->source->sha256, settings_text);
    lod_hash_bytes(key, (size_t)length < sizeof key ? (size_t)length : sizeof key - 1, revision);
    revision[32] = '\0';
  }
  free(settings_text);

  json_t *warnings = json_array();
  for (uint32_t i = 0; i < facts->model->warning_count; i++)
    json_array_append_new(warnings, text(facts->model->warnings[i]));
  json_t *bake = json_object();
  json_object_set_new(bake, "settings", settings);
  json_object_set_new(bake, "seconds", json_real(facts->seconds));
  json_object_set_new(bake, "peak_bytes", json_integer((json_int_t)facts->peak_bytes));
  json_object_set_new(bake, "warnings", warnings);

  json_t *manifest = json_object();
  json_object_set_new(manifest, "id", text(facts->request->id));
  json_object_set_new(manifest, "revision", json_string(revision));
  json_object_set_new(manifest, "source", source_json(facts));
  json_object_set_new(manifest, "families", families_json(facts));
  json_object_set_new(manifest, "parts", parts_json(facts));
  json_object_set_new(manifest, "textures", textures_json(facts));
  json_object_set_new(manifest, "bake", bake);
  enum lod_status status = add_documents(manifest, facts->request->directory_fd, problem);
  if (status == LOD_OK)
    status = add_materials(facts, manifest, problem);
  *text_out = status == LOD_OK ? json_dumps(manifest, JSON_COMPACT | JSON_REAL_PRECISION(9)) : NULL;
  json_decref(manifest);
  return status == LOD_OK && *text_out == NULL ? lod_fail_memory(problem) : status;
}
