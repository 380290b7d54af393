/* Any bytes as a worker's manifest: no crash, and what is believed is within its bounds and reads back the same. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/store/manifest.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(bool condition) {
  if (!condition)
    abort();
}

static void check(const struct lod_manifest *manifest, const char *id) {
  require(strcmp(manifest->id, id) == 0);
  require(strlen(manifest->text) == manifest->size);
  require(isfinite(manifest->diagonal) && manifest->diagonal >= 0);
  require(manifest->family_count >= 1 && manifest->family_count <= LOD_MANIFEST_MAX_FAMILIES);
  require(manifest->object_count >= 1 && manifest->object_count <= LOD_MANIFEST_MAX_OBJECTS);
  for (size_t i = 0; i < manifest->object_count; i++) {
    const struct lod_manifest_object *object = &manifest->objects[i];
    require(strlen(object->sha256) == LOD_SHA256_HEX && strspn(object->sha256, "0123456789abcdef") == LOD_SHA256_HEX);
    require(object->type != NULL && lod_manifest_media_type(object->type) == object->type);
    require(i == 0 || strcmp(manifest->objects[i - 1].sha256, object->sha256) < 0);
  }
  for (uint32_t f = 0; f < manifest->family_count; f++) {
    const struct lod_stored_family *family = &manifest->families[f];
    require(family->level_count >= 1 && strlen(family->name) <= 32);
    for (uint32_t i = 0; i < family->level_count; i++) {
      const struct lod_stored_level *level = &family->levels[i];
      require(level->level == i && isfinite(level->facts.error) && level->facts.error >= 0 && isfinite(level->facts.cell));
      bool named = false; /* every level's object is one that will be checked and kept */
      for (size_t k = 0; k < manifest->object_count; k++)
        named |= strcmp(manifest->objects[k].sha256, level->sha256) == 0 && manifest->objects[k].bytes == level->facts.bytes;
      require(named);
    }
  }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  struct lod_manifest *manifest, *again;
  struct lod_problem problem = {0};
  enum lod_status status = lod_manifest_parse((const char *)data, size, "fuzz-id", &manifest, &problem);
  if (status != LOD_OK) {
    require(manifest == NULL && problem.status == status && problem.detail[0] != 0);
    return 0;
  }
  check(manifest, "fuzz-id");
  /* As the next start reads it from the catalogue. */
  require(lod_manifest_parse(manifest->text, manifest->size, "fuzz-id", &again, NULL) == LOD_OK);
  check(again, "fuzz-id");
  require(strcmp(again->text, manifest->text) == 0 && again->object_count == manifest->object_count);
  require(again->diagonal == manifest->diagonal && again->families[0].levels[0].facts.error == manifest->families[0].levels[0].facts.error);
  lod_manifest_destroy(again);
  lod_manifest_destroy(manifest);
  return 0;
}
