/* A few threads for what waits for the disk, so that event loops never do. */
#ifndef LOD_SERVER_HTTP_BACKGROUND_H
#define LOD_SERVER_HTTP_BACKGROUND_H

#include <stdbool.h>
#include <stdint.h>

struct lod_background;

/* One piece of work; the memory is the caller's and must stay until run has been called. */
struct lod_background_work {
  void (*run)(struct lod_background_work *work);
  struct lod_background_work *next; /* used by the queue */
};

/* NULL when no thread can be started. */
struct lod_background *lod_background_create(uint32_t threads);
/* Runs what is queued, then ends. NULL is allowed. */
void lod_background_destroy(struct lod_background *background);
/* False, and the work is not taken: LOD_BACKGROUND_MAX pieces wait already. */
enum { LOD_BACKGROUND_MAX = 1024 };
bool lod_background_add(struct lod_background *background, struct lod_background_work *work);

#endif
