/* Answers that were computed once and may be asked for again: a cache on the disk. They are not objects: no model's bytes count them and no
 * manifest names them. The least recently used go when all take more than the limit, they outlive a restart, and a model's go with it.
 *
 * refined/<key>.<id>: the answer's bytes, then facts, then a footer of 24 bytes: size of the bytes (8), of the facts (4), CRC-32 of all
 * before it (4), "LODANSW1"; numbers little-endian. Written behind the answer by a thread of low priority and not synced: what a power loss
 * cuts short is found out by its footer when it is asked for, and removed. */
#ifndef LOD_SERVER_STORE_ANSWERS_H
#define LOD_SERVER_STORE_ANSWERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum { LOD_ANSWER_KEY = 32 };

struct lod_answers;

/* directory_fd: the store's; not owned. Nothing is kept or removed until a limit is set. */
LOD_WARN_UNUSED enum lod_status lod_answers_open(int directory_fd, struct lod_answers **answers, struct lod_problem *problem);
/* Writes what waits to be written. All answers must have been released. NULL is allowed. */
void lod_answers_close(struct lod_answers *answers);
/* The most that all files may hold together; 0: nothing is kept. One answer may take a quarter. */
void lod_answers_set_limit(struct lod_answers *answers, uint64_t bytes);
/* Removes those of models that are not there any more: at start. */
void lod_answers_sweep(struct lod_answers *answers, bool (*there)(void *context, const char *id), void *context);

struct lod_answer {
  const uint8_t *bytes; /* mapped */
  size_t size;
  int file;    /* the same bytes from its beginning, for sendfile(2) */
  char *facts; /* as they were given */
  size_t mapped;
};
/* NULL: there is none. Reads the disk. key: LOD_ANSWER_KEY lower-case hex digits. */
struct lod_answer *lod_answers_find(struct lod_answers *answers, const char *key);
void lod_answer_release(struct lod_answer *answer); /* NULL is allowed; any thread */

/* Takes `held`, which keeps `bytes` alive until release(held); facts: copied. May be dropped: too large, or the disk is slower than the
 * answers. Does not wait. */
void lod_answers_keep(struct lod_answers *answers, const char *id, const char *key, const uint8_t *bytes, size_t size, const char *facts,
                      void *held, void (*release)(void *held));
/* Removes all of a model. */
void lod_answers_forget(struct lod_answers *answers, const char *id);

/* For a store that nobody holds: "", or what is wrong with refined/NAME, as in "refined/NAME is ...". *id: the model that it belongs to, in
 * name; NULL when the name is no answer's. Reads all of it. */
const char *lod_answer_judge(int folder_fd, const char *name, const char **id);

struct lod_answers_counts {
  uint64_t files, bytes;                 /* now */
  uint64_t hits, written, evicted, lost; /* since the start; lost: not written, or found damaged */
};
struct lod_answers_counts lod_answers_counts(struct lod_answers *answers);

#endif
