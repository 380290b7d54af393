/* The catalogue: the rows behind the store, in SQLite. Inside server/store, and for server/jobs through lod_store_catalog.
 *
 * Write-ahead log with synchronous=FULL: a function that writes returns after its transaction is on the disk, or with nothing changed.
 * A mutex inside makes every function callable from any thread. Problems: "disk-full", "store-read-only", "store-corrupt", "store-error".
 */
#ifndef LOD_SERVER_STORE_CATALOG_H
#define LOD_SERVER_STORE_CATALOG_H

#include "server/store/store.h"

struct lod_catalog;

LOD_WARN_UNUSED enum lod_status lod_catalog_open(const char *path, struct lod_catalog **catalog, struct lod_problem *problem);
void lod_catalog_close(struct lod_catalog *catalog);
/* LOD_OK while the database answers. */
LOD_WARN_UNUSED enum lod_status lod_catalog_check(struct lod_catalog *catalog, struct lod_problem *problem);

/* The same, reading all of it: LOD_IO "store-corrupt" when its structure is damaged. */
LOD_WARN_UNUSED enum lod_status lod_catalog_check_whole(struct lod_catalog *catalog, struct lod_problem *problem);

/* ---- models and objects ---- */

struct lod_catalog_object {
  const char *sha256, *type;
  uint64_t bytes;
};
struct lod_catalog_model {
  const char *id, *revision, *manifest;
  size_t manifest_size, object_count;
  double created;
  const struct lod_catalog_object *objects; /* all it names */
};

typedef enum lod_status lod_catalog_each_object(void *context, const struct lod_catalog_object *object);
/* object_count and objects are not filled. */
typedef enum lod_status lod_catalog_each_model(void *context, const struct lod_catalog_model *model);
/* What is passed is valid during the call. A status other than LOD_OK ends the walk and is returned. The callback must not use the
 * catalogue. Models come in id order. */
LOD_WARN_UNUSED enum lod_status lod_catalog_read_objects(struct lod_catalog *catalog, lod_catalog_each_object *each, void *context,
                                                         struct lod_problem *problem);
LOD_WARN_UNUSED enum lod_status lod_catalog_read_models(struct lod_catalog *catalog, lod_catalog_each_model *each, void *context,
                                                        struct lod_problem *problem);

/* In one transaction: the model's row and names are replaced, objects that no model names any more are dropped, and when the objects
 * then hold more than quota_bytes (0 = no limit) all is undone and LOD_LIMIT "quota" returned. */
LOD_WARN_UNUSED enum lod_status lod_catalog_put_model(struct lod_catalog *catalog, const struct lod_catalog_model *model,
                                                      uint64_t quota_bytes, struct lod_problem *problem);
/* How jobs of the model end with it: those up to number `last` whose state is below `open_states`. */
struct lod_catalog_ending {
  uint64_t last;
  int open_states, state;
  double finished;
  const struct lod_problem *problem;
};
/* ending: NULL = no job. */
LOD_WARN_UNUSED enum lod_status lod_catalog_delete_model(struct lod_catalog *catalog, const char *id,
                                                         const struct lod_catalog_ending *ending, bool *existed,
                                                         struct lod_problem *problem);

/* ---- jobs ---- */

struct lod_catalog_job {
  uint64_t number;
  const char *id, *name, *format; /* format may be NULL */
  int state;                      /* enum lod_job_state */
  uint32_t attempts;
  double created, finished;
  struct lod_problem problem;
  bool later; /* adds the later families */
};
typedef enum lod_status lod_catalog_each_job(void *context, const struct lod_catalog_job *job);
/* In number order. */
LOD_WARN_UNUSED enum lod_status lod_catalog_read_jobs(struct lod_catalog *catalog, lod_catalog_each_job *each, void *context,
                                                      struct lod_problem *problem);
/* Writes the row of job->number, new or not. */
LOD_WARN_UNUSED enum lod_status lod_catalog_put_job(struct lod_catalog *catalog, const struct lod_catalog_job *job,
                                                    struct lod_problem *problem);
LOD_WARN_UNUSED enum lod_status lod_catalog_delete_job(struct lod_catalog *catalog, uint64_t number, struct lod_problem *problem);
/* The highest number ever given, also when its row is gone: numbers are not used again. */
LOD_WARN_UNUSED enum lod_status lod_catalog_last_job(struct lod_catalog *catalog, uint64_t *number, struct lod_problem *problem);

/* ---- the store behind it, for server/jobs ---- */

struct lod_catalog *lod_store_catalog(struct lod_store *store);
/* The store's directory; not owned. */
int lod_store_directory_fd(struct lod_store *store);

#endif
