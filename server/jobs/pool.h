/* Warm workers for what somebody waits for: refinements and contact points. One thread and one jailed process each, started beforehand and
 * kept; a bounded queue before them, a deadline on each request, and a new worker for every one that dies.
 *
 * Frames (frame.h) after {"job":"refine","memory_bytes":N} as the first 'J'. From the daemon:
 *
 * - 'Q' {"kind":"refine"|"contact","base":SHA-256,"base_bytes":N,"values_bytes":N,"max_triangles":N,"parameters":{name:value}}
 * - 'V' the values' bytes (little-endian floats), in as many frames as it takes
 * - 'B' the base's bytes, after an 'N'
 * - 'X' stop what you do; may come before the 'B's that were asked for, and an idle worker passes over it
 *
 * From the worker:
 *
 * - 'N' {}: the base is not here
 * - 'R' facts {"bytes":N,...}, then 'G' the answer's N bytes, in as many frames as it takes
 * - 'F' failed {"status":"bad-input","type":"bad-parameter","detail":"...","parameter":"eye"}
 *
 * Each 'Q' is answered by one 'R' or one 'F'. Anything else ends the worker. */
#ifndef LOD_SERVER_JOBS_POOL_H
#define LOD_SERVER_JOBS_POOL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct lod_pool;

struct lod_pool_settings {
  const char *worker_path;
  uint32_t workers;                             /* default 2 */
  uint32_t queue_limit;                         /* requests that wait for a worker; default 32 */
  double deadline_seconds;                      /* from submit to answer; default 10 */
  uint64_t memory_limit_bytes;                  /* of one worker; default 2 GiB */
  const char *folder;                           /* a writable one, for a moment at each worker's start; NULL, or not so: /tmp */
  void (*log)(void *context, const char *line); /* any thread; NULL = standard error */
  void *context;
};
struct lod_pool_settings lod_pool_defaults(void);

enum { LOD_POOL_PARAMETER = 32 };

/* One request. The caller fills the first part and keeps it in place until done was called; the pool fills the second. */
struct lod_pool_job {
  const char *kind;       /* "refine" or "contact" */
  const char *parameters; /* JSON object of strings */
  char base[65];          /* SHA-256 in hex: what workers keep a base by */
  const uint8_t *base_bytes;
  size_t base_size;
  const void *values; /* may be NULL */
  size_t values_size;
  uint64_t max_triangles;
  void (*done)(struct lod_pool_job *job); /* once, on a thread of the pool, or in lod_pool_cancel, or in destroy */
  void *context;

  /* status LOD_OK: `facts` and `bytes` are the answer, malloc'd, the caller's. LOD_CANCELLED "deadline" or "cancelled"; LOD_IO
   * "worker-crashed"; else what the worker says, with the parameter that is wrong. */
  struct lod_problem problem;
  char parameter[LOD_POOL_PARAMETER + 1];
  char *facts;
  uint8_t *bytes;
  size_t size;

  /* the pool's own */
  struct lod_pool_job *next;
  double deadline, submitted;
  bool cancelled, running;
};

LOD_WARN_UNUSED enum lod_status lod_pool_create(const struct lod_pool_settings *settings, struct lod_pool **pool,
                                                struct lod_problem *problem);
/* Ends what runs and what waits (done is called with "cancelled") and all workers. NULL is allowed. */
void lod_pool_destroy(struct lod_pool *pool);

/* LOD_LIMIT "queue-full": then done is not called. */
LOD_WARN_UNUSED enum lod_status lod_pool_submit(struct lod_pool *pool, struct lod_pool_job *job, struct lod_problem *problem);
/* Nobody wants the answer any more: done follows soon, with "cancelled" unless the answer was there first. Only before done was called. */
void lod_pool_cancel(struct lod_pool *pool, struct lod_pool_job *job);

/* Why a worker ended that was not told to. */
enum lod_pool_end {
  LOD_POOL_END_SIGNAL,    /* died at work */
  LOD_POOL_END_EXIT,      /* ended by itself at work */
  LOD_POOL_END_NONSENSE,  /* was ended: what it said made no sense */
  LOD_POOL_END_DEADLINE,  /* was ended: its request took too long */
  LOD_POOL_END_CANCELLED, /* was ended: it did not stop when told to */
  LOD_POOL_END_IDLE,      /* died between two requests */
  LOD_POOL_ENDS,
};
const char *lod_pool_end_name(enum lod_pool_end end);

struct lod_pool_counts {
  uint64_t waiting, running, alive;                             /* now; alive: workers */
  uint64_t answered, failed, refused, cancelled, late, crashed; /* requests since the start, by how they ended */
  uint64_t workers_started, ends[LOD_POOL_ENDS];
  double seconds, wait_seconds; /* at work; in the queue */
};
struct lod_pool_counts lod_pool_counts(struct lod_pool *pool);

#endif
