#include "server/http/background.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>

struct lod_background {
  pthread_mutex_t lock;
  pthread_cond_t wake;
  struct lod_background_work *first, **last;
  bool ending;
  uint32_t waiting;
  uint32_t thread_count;
  pthread_t threads[];
};

static void *run(void *argument) {
  struct lod_background *background = argument;
  pthread_mutex_lock(&background->lock);
  for (;;) {
    while (!background->first && !background->ending)
      pthread_cond_wait(&background->wake, &background->lock);
    struct lod_background_work *work = background->first;
    if (!work)
      break;
    background->first = work->next;
    background->waiting--;
    if (!background->first)
      background->last = &background->first;
    pthread_mutex_unlock(&background->lock);
    work->run(work);
    pthread_mutex_lock(&background->lock);
  }
  pthread_mutex_unlock(&background->lock);
  return NULL;
}

struct lod_background *lod_background_create(uint32_t threads) {
  struct lod_background *background = calloc(1, sizeof *background + threads * sizeof *background->threads);
  if (!background)
    return NULL;
  pthread_mutex_init(&background->lock, NULL);
  pthread_cond_init(&background->wake, NULL);
  background->last = &background->first;
  while (background->thread_count < threads && pthread_create(&background->threads[background->thread_count], NULL, run, background) == 0)
    background->thread_count++;
  if (background->thread_count)
    return background;
  lod_background_destroy(background);
  return NULL;
}

bool lod_background_add(struct lod_background *background, struct lod_background_work *work) {
  work->next = NULL;
  pthread_mutex_lock(&background->lock);
  bool room = background->waiting < LOD_BACKGROUND_MAX;
  if (room) {
    background->waiting++;
    *background->last = work;
    background->last = &work->next;
    pthread_cond_signal(&background->wake);
  }
  pthread_mutex_unlock(&background->lock);
  return room;
}

void lod_background_destroy(struct lod_background *background) {
  if (!background)
    return;
  pthread_mutex_lock(&background->lock);
  background->ending = true;
  pthread_cond_broadcast(&background->wake);
  pthread_mutex_unlock(&background->lock);
  for (uint32_t i = 0; i < background->thread_count; i++)
    pthread_join(background->threads[i], NULL);
  pthread_cond_destroy(&background->wake);
  pthread_mutex_destroy(&background->lock);
  free(background);
}
