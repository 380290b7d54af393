#include "core/base/parallel.h"

#include <pthread.h>
#include <stdatomic.h>
#include <unistd.h>

enum { MAX_THREADS = 64 };

struct loop {
  lod_parallel_body *body;
  void *context;
  size_t count, grain, chunks;
  _Atomic size_t next;
};

static void *work(void *argument) {
  struct loop *loop = argument;
  for (;;) {
    size_t chunk = atomic_fetch_add_explicit(&loop->next, 1, memory_order_relaxed);
    if (chunk >= loop->chunks)
      return NULL;
    size_t begin = chunk * loop->grain;
    size_t rest = loop->count - begin;
    loop->body(loop->context, begin, begin + (rest < loop->grain ? rest : loop->grain), chunk);
  }
}

void lod_parallel_for(uint32_t threads, size_t count, size_t grain, lod_parallel_body *body, void *context) {
  if (count == 0)
    return;
  if (grain == 0)
    grain = 1;
  struct loop loop = {.body = body, .context = context, .count = count, .grain = grain, .chunks = lod_parallel_chunks(count, grain)};
  if (threads == 0) {
    long online = sysconf(_SC_NPROCESSORS_ONLN);
    threads = online > 0 ? (uint32_t)online : 1;
  }
  if (threads > MAX_THREADS)
    threads = MAX_THREADS;
  if (threads > loop.chunks)
    threads = (uint32_t)loop.chunks;
  pthread_t others[MAX_THREADS];
  uint32_t started = 0;
  while (started + 1 < threads && pthread_create(&others[started], NULL, work, &loop) == 0)
    started++;
  work(&loop);
  for (uint32_t i = 0; i < started; i++)
    pthread_join(others[i], NULL);
}

void lod_progress_report(const struct lod_progress *progress, const char *stage, double fraction) {
  if (progress != NULL && progress->report != NULL)
    progress->report(progress->context, stage, fraction);
}

bool lod_progress_cancelled(const struct lod_progress *progress) {
  return progress != NULL && progress->cancelled != NULL && progress->cancelled(progress->context);
}

static void report_step(void *context, const char *stage, double fraction) {
  const struct lod_progress_span *span = context;
  if (span->end > span->begin)
    lod_progress_report(span->whole, stage, span->begin + (span->end - span->begin) * fraction);
}

static bool step_cancelled(void *context) {
  const struct lod_progress_span *span = context;
  return lod_progress_cancelled(span->whole);
}

void lod_progress_span_init(struct lod_progress_span *span, const struct lod_progress *whole, double begin, double end) {
  *span = (struct lod_progress_span){.step = {report_step, step_cancelled, span}, .whole = whole, .begin = begin, .end = end};
}
