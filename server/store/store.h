/* What the daemon holds: a catalogue of models (SQLite) and content-addressed objects (files named by their SHA-256).
 *
 * Layout of the directory: catalog.sqlite, objects/ab/<sha256>, uploads/<job>, work/<job>/ (a worker's output), refined/ (a cache,
 * answers.h), all on one file system. Everything else is written, fsynced, renamed, the folder fsynced, and only then named by the
 * catalogue in one transaction: a revision is whole or not there. All functions may be called from any thread. */
#ifndef LOD_SERVER_STORE_STORE_H
#define LOD_SERVER_STORE_STORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/level/screen.h"

enum { LOD_SHA256_HEX = 64, LOD_MODEL_ID_MAX = 128 };

struct lod_store;

/* Opens or makes the store; removes what an interrupted run left (work/, unnamed objects). One process at a time holds it. */
LOD_WARN_UNUSED enum lod_status lod_store_open(const char *directory, struct lod_store **store, struct lod_problem *problem);
/* All models and objects must have been released, all other users be gone. NULL is allowed. */
void lod_store_close(struct lod_store *store);
/* The most that all objects together may hold (each counted once); a bake that would exceed it fails with LOD_LIMIT "quota". 0 = no limit.
 */
void lod_store_set_quota(struct lod_store *store, uint64_t bytes);
/* What all objects hold now, each counted once. */
uint64_t lod_store_bytes(struct lod_store *store);
/* True while the catalogue answers and the directory can be written: for /readyz. */
bool lod_store_ready(struct lod_store *store, struct lod_problem *problem);

/* 1 to 128 of [A-Za-z0-9._-], not beginning with a dot or dash: safe in a URL and as a file name. */
bool lod_model_id_valid(const char *id);

/* ---- objects ---- */

/* Immutable bytes, mapped read-only. Valid until released, even when the object is deleted meanwhile. */
struct lod_object {
  char sha256[LOD_SHA256_HEX + 1];
  const char *type; /* media type, "model/gltf-binary", "image/png" */
  const uint8_t *bytes;
  size_t size;
  int file; /* the same bytes as an open file, for sendfile(2); -1 below LOD_OBJECT_FILE_BYTES */
};
enum { LOD_OBJECT_FILE_BYTES = 64 << 10 };
/* NULL *object and LOD_OK: there is no such object. sha256: 64 lower-case hex digits. */
LOD_WARN_UNUSED enum lod_status lod_store_object_open(struct lod_store *store, const char *sha256, struct lod_object **object,
                                                      struct lod_problem *problem);
void lod_store_object_release(struct lod_object *object);

/* ---- answers that were computed from a model: answers.h ---- */

struct lod_answers;
struct lod_answers *lod_store_answers(struct lod_store *store);
/* lod_answers_keep, unless the model has another revision by now. */
void lod_store_keep_answer(struct lod_store *store, const char *id, const char *revision, const char *key, const uint8_t *bytes,
                           size_t size, const char *facts, void *held, void (*release)(void *held));

/* ---- models ---- */

struct lod_stored_level {
  uint32_t level; /* 0 = coarsest */
  struct lod_level_facts facts;
  char sha256[LOD_SHA256_HEX + 1];
  const char *type;
  /* The step to the next level; of level 0 also the level itself in the form of a step. "" and 0 = none. */
  char delta[LOD_SHA256_HEX + 1], first[LOD_SHA256_HEX + 1];
  uint64_t delta_bytes, first_bytes;
  /* The level as curved patches ("" = none), and what choosing needs to know of these: triangles is the number of patches. */
  char patches[LOD_SHA256_HEX + 1];
  struct lod_level_facts patch_facts;
};
struct lod_stored_family {
  const char *name;
  bool nested;
  uint32_t level_count;
  struct lod_stored_level *levels; /* level order */
};
/* One revision of a model as the manifest has it; immutable, counted. */
struct lod_stored_model {
  const char *id, *revision;
  const char *manifest; /* JSON text as served by GET /v1/models/{id} */
  size_t manifest_size;
  char manifest_etag[LOD_SHA256_HEX + 3]; /* quoted */
  double created;                         /* seconds since 1970 */
  uint64_t bytes;                         /* of all its objects */
  uint64_t triangles;                     /* of the source */
  double diagonal;
  uint32_t family_count;
  struct lod_stored_family *families; /* of the whole model: manifest.families */
  /* Objects that describe the levels to clients of others; "" = none. */
  char tileset[LOD_SHA256_HEX + 1], gltf[LOD_SHA256_HEX + 1];
};
/* NULL when there is none. Cheap: a lock, a hash look-up and a count. */
struct lod_stored_model *lod_store_model_open(struct lod_store *store, const char *id);
void lod_store_model_release(struct lod_stored_model *model);

/* Models with id > after in id order, at most limit; returns how many were filled in. Each must be released. */
size_t lod_store_model_list(struct lod_store *store, const char *after, size_t limit, struct lod_stored_model **models);
size_t lod_store_model_count(struct lod_store *store);
/* Counts up whenever any model appears, changes or goes: to cache the list. */
uint64_t lod_store_generation(struct lod_store *store);

/* *existed: whether there was one. Objects that nothing else names go too; readers keep what they hold. ending (catalog.h): jobs whose rows
 * end in the same transaction; NULL = none. */
struct lod_catalog_ending;
LOD_WARN_UNUSED enum lod_status lod_store_model_delete(struct lod_store *store, const char *id, const struct lod_catalog_ending *ending,
                                                       bool *existed, struct lod_problem *problem);

/* Takes a finished bake directory (manifest.json + objects/) into the store as the new revision of `id`: checks the manifest's shape and
 * every object's hash and size, moves, syncs, commits. The worker that wrote it is not trusted, and must be dead: nothing may write to the
 * files meanwhile. On failure nothing changes; problems are "bad-manifest", "bad-object", "quota", "disk-full", "store-read-only",
 * "store-error". */
LOD_WARN_UNUSED enum lod_status lod_store_commit_bake(struct lod_store *store, const char *id, int directory_fd,
                                                      struct lod_problem *problem);

#endif
