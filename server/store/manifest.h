/* Reads a manifest that a worker wrote. The worker has parsed a stranger's file and is not trusted: every figure is checked before the
 * daemon believes it.
 *
 * An object reference is any JSON object with the key "object": its SHA-256 (64 lower-case hex digits), "type" from a short list (absent
 * in parts; in "delta" it is the delta type) and "bytes". All of them are collected, so keys that later versions add keep their objects. */
#ifndef LOD_SERVER_STORE_MANIFEST_H
#define LOD_SERVER_STORE_MANIFEST_H

#include "server/store/store.h"

enum {
  LOD_MANIFEST_MAX_BYTES = 64 << 20,
  LOD_MANIFEST_MAX_DEPTH = 32,
  LOD_MANIFEST_MAX_OBJECTS = 1 << 16,
  LOD_MANIFEST_MAX_FAMILIES = 16,
  LOD_MANIFEST_MAX_LEVELS = 256
};

struct lod_manifest_object {
  char sha256[LOD_SHA256_HEX + 1];
  const char *type; /* static text; NULL when no reference says it */
  uint64_t bytes;   /* of the file; 0 when only parts refer to it (their figure is a share of the file) */
};

struct lod_manifest {
  char *text; /* as it came, unless the id was replaced */
  size_t size;
  char *id, *revision;
  uint64_t triangles; /* of the source */
  double diagonal;
  uint32_t family_count;
  struct lod_stored_family *families;
  char tileset[LOD_SHA256_HEX + 1], gltf[LOD_SHA256_HEX + 1]; /* "" = none */
  size_t object_count;
  struct lod_manifest_object *objects; /* sorted by name, each once */
};

/* text need not end in NUL. id: the name it is stored under; replaces another one in the text. LOD_BAD_INPUT "bad-manifest" with a
 * sentence that names the member, or LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_manifest_parse(const char *text, size_t size, const char *id, struct lod_manifest **manifest,
                                                   struct lod_problem *problem);
void lod_manifest_destroy(struct lod_manifest *manifest);

/* The static copy of a media type that objects may have; NULL when it is not on the list. */
const char *lod_manifest_media_type(const char *type);

#endif
