#include "server/http/errands.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

struct lod_errands {
  struct lod_pool *pool;
  pthread_mutex_t mutex; /* guards the list, each errand's waiters and each waiter's state; held over no call of the pool */
  struct lod_errand *first;
  uint64_t shared;
};

struct lod_errands *lod_errands_create(struct lod_pool *pool) {
  struct lod_errands *errands = calloc(1, sizeof *errands);
  if (errands == NULL)
    return NULL;
  errands->pool = pool;
  pthread_mutex_init(&errands->mutex, NULL);
  return errands;
}

void lod_errands_destroy(struct lod_errands *errands) {
  if (errands == NULL)
    return;
  pthread_mutex_destroy(&errands->mutex);
  free(errands);
}

struct lod_errand *lod_errand_create(void) {
  struct lod_errand *errand = calloc(1, sizeof *errand);
  if (errand != NULL)
    atomic_init(&errand->holders, 1);
  return errand;
}

void lod_errand_release(struct lod_errand *errand) {
  if (errand == NULL || atomic_fetch_sub(&errand->holders, 1) != 1)
    return;
  if (errand->finish_context != NULL)
    errand->finish_context(errand->context);
  free(errand->parameters);
  free(errand->values);
  free(errand->job.facts);
  free(errand->job.bytes);
  lod_body_release(errand->base);
  lod_body_release(errand->answer);
  free(errand);
}

/* The mutex is held. */
static void unlist(struct lod_errand *errand) {
  for (struct lod_errand **at = &errand->errands->first; errand->listed && *at != NULL; at = &(*at)->next)
    if (*at == errand) {
      *at = errand->next;
      break;
    }
  errand->listed = false;
}

/* Tells all but `but` (NULL: all) that the errand is over. Whether `but` was still waiting. */
static bool tell(struct lod_errand *errand, const struct lod_waiter *but) {
  bool waited = false;
  pthread_mutex_lock(&errand->errands->mutex);
  unlist(errand);
  struct lod_waiter *waiters = errand->waiters;
  errand->waiters = NULL;
  for (struct lod_waiter *w = waiters; w != NULL; w = w->next)
    w->state = LOD_WAITER_TOLD;
  pthread_mutex_unlock(&errand->errands->mutex);
  for (struct lod_waiter *next; waiters != NULL; waiters = next) {
    next = waiters->next; /* a waiter that was told may be gone */
    if (waiters == but)
      waited = true;
    else
      waiters->done(waiters, errand, false);
    lod_errand_release(errand);
  }
  return waited;
}

/* On a thread of the pool, or where the last waiter left. */
static void landed(struct lod_pool_job *job) {
  struct lod_errand *errand = job->context;
  if (errand->landed != NULL)
    errand->landed(errand);
  (void)tell(errand, NULL);
  lod_errand_release(errand);
}

/* The mutex is held. */
static void add_waiter(struct lod_errand *errand, struct lod_waiter *waiter) {
  atomic_fetch_add(&errand->holders, 1);
  waiter->errand = errand;
  waiter->state = LOD_WAITER_WAITING;
  waiter->next = errand->waiters;
  errand->waiters = waiter;
}

enum lod_status lod_errands_join(struct lod_errands *errands, struct lod_errand *errand, struct lod_waiter *waiter,
                                 struct lod_problem *problem) {
  struct lod_errand *same;
  pthread_mutex_lock(&errands->mutex);
  if (waiter->state == LOD_WAITER_LEFT) {
    pthread_mutex_unlock(&errands->mutex);
    return lod_fail(problem, LOD_CANCELLED, "cancelled", "The client has gone.");
  }
  for (same = errands->first; same != NULL && strcmp(same->key, errand->key) != 0; same = same->next)
    ;
  if (same != NULL) {
    add_waiter(same, waiter);
    errands->shared++;
    pthread_mutex_unlock(&errands->mutex);
    return LOD_OK;
  }
  errand->errands = errands;
  errand->next = errands->first;
  errands->first = errand;
  errand->listed = true;
  atomic_fetch_add(&errand->holders, 1); /* the pool's */
  add_waiter(errand, waiter);
  pthread_mutex_unlock(&errands->mutex);
  errand->job.parameters = errand->parameters;
  errand->job.base_bytes = errand->base->bytes;
  errand->job.base_size = errand->base->size;
  errand->job.values = errand->values;
  errand->job.values_size = errand->values_size;
  errand->job.done = landed;
  errand->job.context = errand;
  struct lod_problem full = {0};
  enum lod_status status = lod_pool_submit(errands->pool, &errand->job, &full);
  if (status == LOD_OK)
    return LOD_OK;
  errand->job.problem = full;         /* for those who joined meanwhile */
  bool waited = tell(errand, waiter); /* else it left, and was told then */
  lod_errand_release(errand);
  return waited ? lod_fail(problem, status, full.type, "%s", full.detail) : LOD_OK;
}

void lod_errands_leave(struct lod_errands *errands, struct lod_waiter *waiter) {
  struct lod_errand *errand = NULL;
  bool last = false;
  pthread_mutex_lock(&errands->mutex);
  if (waiter->state == LOD_WAITER_NEW) {
    waiter->state = LOD_WAITER_LEFT;
  } else if (waiter->state == LOD_WAITER_WAITING) {
    errand = waiter->errand;
    struct lod_waiter **at = &errand->waiters;
    while (*at != waiter)
      at = &(*at)->next;
    *at = waiter->next;
    waiter->state = LOD_WAITER_TOLD;
    last = errand->waiters == NULL;
    if (last) /* whoever asks the same from now on must not be told that it was cancelled */
      unlist(errand);
  }
  pthread_mutex_unlock(&errands->mutex);
  if (errand == NULL)
    return;
  if (last)
    lod_pool_cancel(errands->pool, &errand->job);
  waiter->done(waiter, errand, true);
  lod_errand_release(errand);
}

uint64_t lod_errands_shared(struct lod_errands *errands) {
  pthread_mutex_lock(&errands->mutex);
  uint64_t shared = errands->shared;
  pthread_mutex_unlock(&errands->mutex);
  return shared;
}
