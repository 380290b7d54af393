/* A watched folder: each file in it becomes a model under its base name, when it comes, when it changes, and at the start when its bytes
 * are not those that the store's revision was made of. A file that goes leaves its model alone. */
#ifndef LOD_SERVER_MODELS_DIR_H
#define LOD_SERVER_MODELS_DIR_H

#include <stdbool.h>

#include "server/jobs/jobs.h"
#include "server/store/store.h"

struct lod_models_dir;

/* Starts a thread that watches. store, jobs: not owned, outlive it. LOD_BAD_INPUT: the folder cannot be read. */
LOD_WARN_UNUSED enum lod_status lod_models_dir_create(const char *directory, struct lod_store *store, struct lod_jobs *jobs,
                                                      struct lod_models_dir **watch, struct lod_problem *problem);
/* Ends the thread. NULL is allowed. */
void lod_models_dir_destroy(struct lod_models_dir *watch);

/* The id of a file name: without its last extension, every character that an id cannot hold a dash. False: not a model (hidden, or a
 * companion such as a texture), or nothing is left of the name. */
bool lod_models_dir_id(const char *name, char id[LOD_MODEL_ID_MAX + 1]);

#endif
