/* Loops over fixed chunks on several threads. Chunk borders depend on count and grain alone, never on the number of threads, so a
 * body that writes only to its own chunk gives bit-identical results for any number of threads. */
#ifndef LOD_CORE_BASE_PARALLEL_H
#define LOD_CORE_BASE_PARALLEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* begin, end: indices of this chunk; chunk: its number, begin / grain. */
typedef void lod_parallel_body(void *context, size_t begin, size_t end, size_t chunk);

/* Runs body for every chunk of [0, count) and returns when all are done. threads: 0 = as many as the machine has, 1 = this thread
 * alone. A thread that cannot be started costs speed, not correctness. Not to be nested. */
void lod_parallel_for(uint32_t threads, size_t count, size_t grain, lod_parallel_body *body, void *context);

/* Number of chunks that lod_parallel_for makes. */
static inline size_t lod_parallel_chunks(size_t count, size_t grain) {
  return count / grain + (count % grain != 0);
}

/* Where a long job tells how far it is and asks whether to go on. A NULL pointer to it, or NULL functions, mean nobody asks. */
struct lod_progress {
  void (*report)(void *context, const char *stage, double fraction); /* stage: static text; fraction in [0, 1] */
  bool (*cancelled)(void *context);                                  /* may be called from any thread */
  void *context;                                                     /* not owned */
};

void lod_progress_report(const struct lod_progress *progress, const char *stage, double fraction);
bool lod_progress_cancelled(const struct lod_progress *progress);

/* A step of something longer: what it reports as 0 to 1 becomes `begin` to `end` of the whole, and it is cancelled with the whole. Pass
 * `step` on; the span must stay where it is while that is in use. end <= begin: only cancels, reports nothing. */
struct lod_progress_span {
  struct lod_progress step;
  const struct lod_progress *whole; /* not owned; may be NULL */
  double begin, end;
};
void lod_progress_span_init(struct lod_progress_span *span, const struct lod_progress *whole, double begin, double end);

#endif
