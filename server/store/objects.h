/* The content-addressed files beneath objects/, and the mappings that readers share. Inside server/store.
 *
 * Every file has an entry while a revision in memory names it. A revision that readers still hold keeps its objects, also after a newer
 * one has replaced it or the model is deleted; when the last name goes the entry is doomed, and lod_objects_reap unlinks its file.
 * Two locks: whoever adopts, syncs or reaps holds the store's writer lock; a short lock inside guards the table for everyone. */
#ifndef LOD_SERVER_STORE_OBJECTS_H
#define LOD_SERVER_STORE_OBJECTS_H

#include "server/store/store.h"

struct lod_objects;
struct lod_object_entry;

/* directory_fd: the store's directory; objects/ and its 256 folders are made. doomed: called (from any thread, without locks) when there
 * is something to reap; may be NULL. */
LOD_WARN_UNUSED enum lod_status lod_objects_create(int directory_fd, void (*doomed)(void *context), void *context,
                                                   struct lod_objects **objects, struct lod_problem *problem);
/* Nothing may be held any more. */
void lod_objects_destroy(struct lod_objects *objects);

/* At start: the catalogue has this object. It starts without a name. type: static text. */
LOD_WARN_UNUSED enum lod_status lod_objects_add(struct lod_objects *objects, const char *sha256, const char *type, uint64_t bytes,
                                                struct lod_problem *problem);
/* At start, after all lod_objects_add: unlinks files that have no entry. *missing: how many entries have no file of the right size. */
LOD_WARN_UNUSED enum lod_status lod_objects_sweep(struct lod_objects *objects, size_t *missing, struct lod_problem *problem);

/* Names an object that is there; NULL when it is not. */
struct lod_object_entry *lod_objects_name(struct lod_objects *objects, const char *sha256);
/* Takes one name away. */
void lod_objects_unname(struct lod_objects *objects, struct lod_object_entry *entry);
/* Names the object; when it is not there yet, moves the checked file source_fd/<sha256> in. type: static text. Not yet on the disk. */
LOD_WARN_UNUSED enum lod_status lod_objects_adopt(struct lod_objects *objects, int source_fd, const char *sha256, const char *type,
                                                  uint64_t bytes, struct lod_object_entry **entry, struct lod_problem *problem);
/* Syncs the folders of these entries, so that their names survive a power loss. */
LOD_WARN_UNUSED enum lod_status lod_objects_sync(struct lod_objects *objects, struct lod_object_entry *const *entries, size_t count,
                                                 struct lod_problem *problem);
/* Unlinks what nothing names any more. */
void lod_objects_reap(struct lod_objects *objects);

/* Sizes of all objects that are there, together. */
uint64_t lod_objects_bytes(struct lod_objects *objects);
const char *lod_object_entry_sha256(const struct lod_object_entry *entry);
uint64_t lod_object_entry_bytes(const struct lod_object_entry *entry);

/* lod_store_object_open. */
LOD_WARN_UNUSED enum lod_status lod_objects_open(struct lod_objects *objects, const char *sha256, struct lod_object **object,
                                                 struct lod_problem *problem);

#endif
