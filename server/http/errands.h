/* One job of the pool for all who ask the same while it is under way. */
#ifndef LOD_SERVER_HTTP_ERRANDS_H
#define LOD_SERVER_HTTP_ERRANDS_H

#include <stdatomic.h>

#include "server/http/response.h"
#include "server/jobs/pool.h"

struct lod_errands;

/* What a job needs and what comes out; counted. The caller fills the first part. */
struct lod_errand {
  struct lod_pool_job job; /* kind, base, max_triangles; the rest is filled from what follows */
  char key[LOD_ETAG_MAX];  /* equal keys are one errand */
  char *parameters;        /* JSON, malloc'd */
  struct lod_body *base;
  uint8_t *values; /* malloc'd, or NULL */
  size_t values_size;
  void (*landed)(struct lod_errand *errand); /* once, on a thread of the pool, before any waiter is told; may be NULL */
  void *context;                             /* of landed */
  void (*finish_context)(void *context);     /* may be NULL */
  struct lod_body *answer;                   /* landed may put the answer here, for all waiters */

  /* the module's own */
  atomic_uint holders;
  struct lod_errands *errands;
  struct lod_waiter *waiters;
  struct lod_errand *next;
  bool listed;
};

/* Somebody who waits; lives in the caller until done was called. */
struct lod_waiter {
  /* Once, from any thread; errand->job.problem says how it ended. `cancelled`: this one left before. */
  void (*done)(struct lod_waiter *waiter, struct lod_errand *errand, bool cancelled);
  struct lod_errand *errand; /* held until done has returned */
  struct lod_waiter *next;
  enum { LOD_WAITER_NEW, LOD_WAITER_WAITING, LOD_WAITER_LEFT, LOD_WAITER_TOLD } state;
};

/* pool: not owned. NULL: memory. */
struct lod_errands *lod_errands_create(struct lod_pool *pool);
void lod_errands_destroy(struct lod_errands *errands); /* after the pool; NULL is allowed */

struct lod_errand *lod_errand_create(void);         /* one holder; NULL: memory */
void lod_errand_release(struct lod_errand *errand); /* NULL is allowed */

/* Submits `errand`, or waits for an equal one that is under way. LOD_OK: done follows, maybe before this returns. Else it does not: the
 * queue is full, or the waiter has left already (LOD_CANCELLED). */
LOD_WARN_UNUSED enum lod_status lod_errands_join(struct lod_errands *errands, struct lod_errand *errand, struct lod_waiter *waiter,
                                                 struct lod_problem *problem);
/* Does not want the answer any more; the last one cancels the job. done follows at once unless it was called already. At most once, and
 * `waiter` must still be there. */
void lod_errands_leave(struct lod_errands *errands, struct lod_waiter *waiter);

/* Requests that were answered by another's job, since the start. */
uint64_t lod_errands_shared(struct lod_errands *errands);

#endif
