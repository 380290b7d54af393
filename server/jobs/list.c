/* Jobs in memory, their rows, and the words about them. */
#include <assert.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "server/jobs/queue.h"
#include "server/jobs/watch.h"
#include "server/store/files.h"

enum { NAME_MAX_BYTES = 255 };

double lod_jobs_wall_seconds(void) {
  struct timespec time;
  clock_gettime(CLOCK_REALTIME, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

double lod_jobs_monotonic_seconds(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

struct lod_number_name lod_jobs_name(uint64_t number) {
  struct lod_number_name name;
  snprintf(name.text, sizeof name.text, "%" PRIu64, number);
  return name;
}

void lod_jobs_tell(struct lod_jobs *jobs, uint64_t number) {
  if (jobs->settings.changed != NULL)
    jobs->settings.changed(jobs->settings.context, number);
}

void lod_jobs_say(struct lod_jobs *jobs, const char *format, ...) {
  char line[LOD_WATCH_LOG_BYTES + 1024];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(line, sizeof line, format, arguments);
  va_end(arguments);
  if (jobs->settings.log != NULL)
    jobs->settings.log(jobs->settings.context, line);
  else
    fprintf(stderr, "lodestreamd: %s\n", line);
}

bool lod_jobs_has_ended(const struct job *job) {
  return job->facts.state == LOD_JOB_DONE || job->facts.state == LOD_JOB_FAILED;
}

void lod_jobs_free_job(struct job *job) {
  if (job == NULL)
    return;
  free(job->name);
  free(job->format);
  free(job);
}

struct job *lod_jobs_create_job(uint64_t number, const char *id, const char *name, const char *format) {
  struct job *job = calloc(1, sizeof *job);
  if (job == NULL)
    return NULL;
  job->facts.number = number;
  job->facts.created = lod_jobs_wall_seconds();
  job->queued = lod_jobs_monotonic_seconds();
  snprintf(job->facts.id, sizeof job->facts.id, "%s", id);
  snprintf(job->facts.stage, sizeof job->facts.stage, "queued");
  job->name = strndup(name == NULL ? id : name, NAME_MAX_BYTES);
  job->format = format == NULL ? NULL : strdup(format);
  if (job->name == NULL || (format != NULL && job->format == NULL)) {
    lod_jobs_free_job(job);
    return NULL;
  }
  return job;
}

bool lod_jobs_reserve(struct lod_jobs *jobs) {
  bool reserved = true;
  pthread_mutex_lock(&jobs->mutex);
  if (jobs->count == jobs->capacity) {
    size_t capacity = jobs->capacity == 0 ? 64 : jobs->capacity * 2;
    struct job **list = reallocarray(jobs->list, capacity, sizeof *list);
    reserved = list != NULL;
    if (reserved) {
      jobs->list = list;
      jobs->capacity = capacity;
    }
  }
  pthread_mutex_unlock(&jobs->mutex);
  return reserved;
}

void lod_jobs_append(struct lod_jobs *jobs, struct job *job) {
  pthread_mutex_lock(&jobs->mutex);
  assert(jobs->count < jobs->capacity && (jobs->count == 0 || jobs->list[jobs->count - 1]->facts.number < job->facts.number));
  jobs->list[jobs->count++] = job;
  jobs->ended += lod_jobs_has_ended(job);
  if (jobs->counts.queued + jobs->counts.running == 0)
    jobs->moved = lod_jobs_monotonic_seconds();
  jobs->counts.queued += job->facts.state == LOD_JOB_QUEUED;
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
}

struct job *lod_jobs_find_job(const struct lod_jobs *jobs, uint64_t number) {
  size_t low = 0, high = jobs->count;
  while (low < high) {
    size_t middle = low + (high - low) / 2;
    if (jobs->list[middle]->facts.number < number)
      low = middle + 1;
    else
      high = middle;
  }
  return low < jobs->count && jobs->list[low]->facts.number == number ? jobs->list[low] : NULL;
}

/* Takes the oldest ended job beyond kept_jobs out of the list; NULL when there is none. */
static struct job *detach_oldest(struct lod_jobs *jobs) {
  struct job *job = NULL;
  pthread_mutex_lock(&jobs->mutex);
  for (size_t i = 0; jobs->ended > jobs->settings.kept_jobs && i < jobs->count && job == NULL; i++) {
    if (!lod_jobs_has_ended(jobs->list[i]))
      continue;
    job = jobs->list[i];
    memmove(jobs->list + i, jobs->list + i + 1, (jobs->count - i - 1) * sizeof *jobs->list);
    jobs->count--;
    jobs->ended--;
  }
  pthread_mutex_unlock(&jobs->mutex);
  return job;
}

void lod_jobs_prune(struct lod_jobs *jobs) {
  for (struct job *job; (job = detach_oldest(jobs)) != NULL; lod_jobs_free_job(job))
    if (lod_catalog_delete_job(jobs->catalog, job->facts.number, NULL) != LOD_OK)
      continue;
}

enum lod_status lod_jobs_write_row(struct lod_jobs *jobs, const struct job *job, struct lod_problem *problem) {
  const struct lod_catalog_job row = {.number = job->facts.number,
                                      .id = job->facts.id,
                                      .name = job->name,
                                      .format = job->format,
                                      .state = (int)job->facts.state,
                                      .attempts = job->attempts,
                                      .created = job->facts.created,
                                      .finished = job->facts.finished,
                                      .problem = job->facts.problem,
                                      .later = job->later};
  return lod_catalog_put_job(jobs->catalog, &row, problem);
}

void lod_jobs_remove_files(struct lod_jobs *jobs, uint64_t number) {
  lod_remove_tree(jobs->work_fd, lod_jobs_name(number).text);
  unlinkat(jobs->uploads_fd, lod_jobs_name(number).text, 0);
}

struct job *lod_jobs_next_open(const struct lod_jobs *jobs, const char *id, uint64_t from) {
  for (size_t i = 0; i < jobs->count; i++)
    if (jobs->list[i]->facts.number >= from && !lod_jobs_has_ended(jobs->list[i]) && strcmp(jobs->list[i]->facts.id, id) == 0)
      return jobs->list[i];
  return NULL;
}

size_t lod_jobs_count_waiting(const struct lod_jobs *jobs, bool later) {
  size_t count = 0;
  for (size_t i = 0; i < jobs->count; i++)
    count += jobs->list[i]->facts.state == LOD_JOB_QUEUED && jobs->list[i]->later == later;
  return count;
}
