/* Submit, find, count; start and stop. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <sys/eventfd.h>
#include <sys/stat.h>

#include "server/jobs/families.h"
#include "server/jobs/queue.h"
#include "server/jobs/upload.h"
#include "server/store/files.h"

struct lod_jobs_settings lod_jobs_defaults(void) {
  return (struct lod_jobs_settings){.workers = 1,
                                    .queue_limit = 64,
                                    .deadline_seconds = 600,
                                    .memory_limit_bytes = UINT64_C(8) << 30,
                                    .upload_limit_bytes = UINT64_C(1) << 30,
                                    .kept_jobs = 1000};
}

/* ---- submit ---- */

enum lod_status lod_jobs_upload_create(struct lod_jobs *jobs, int *fd, struct lod_problem *problem) {
  return lod_upload_create(jobs->uploads_fd, fd, problem);
}

static enum lod_status check_submission(struct lod_jobs *jobs, const char *id, int fd, struct lod_problem *problem) {
  if (!lod_model_id_valid(id))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-id",
                    "A model's id is 1 to %d of A-Z, a-z, 0-9, dot, underscore and dash, and begins with neither dot nor dash.",
                    LOD_MODEL_ID_MAX);
  struct stat facts;
  if (fstat(fd, &facts) != 0)
    return lod_fail_errno(problem, "An upload cannot be read");
  if ((uint64_t)facts.st_size > jobs->settings.upload_limit_bytes)
    return lod_fail(problem, LOD_LIMIT, "limit-bytes", "The upload has %lld bytes, the limit is %llu.", (long long)facts.st_size,
                    (unsigned long long)jobs->settings.upload_limit_bytes);
  pthread_mutex_lock(&jobs->mutex);
  bool full = lod_jobs_count_waiting(jobs, false) >= jobs->settings.queue_limit, stopping = jobs->stopping;
  pthread_mutex_unlock(&jobs->mutex);
  if (full || stopping)
    return lod_fail(problem, LOD_LIMIT, "queue-full",
                    stopping ? "The server is stopping; try again later." : "Too many bakes wait already; try again later.");
  return LOD_OK;
}

enum lod_status lod_jobs_add(struct lod_jobs *jobs, const char *id, const char *name, const char *format, bool later, int fd,
                             uint64_t *number, struct lod_problem *problem) {
  struct job *job = lod_jobs_reserve(jobs) ? lod_jobs_create_job(jobs->last_number + 1, id, name, format) : NULL;
  if (job == NULL)
    return lod_fail_memory(problem);
  job->later = later;
  *number = ++jobs->last_number; /* not used again, whatever happens below */
  enum lod_status status = lod_upload_name(jobs->uploads_fd, fd, lod_jobs_name(*number).text, problem);
  if (status == LOD_OK)
    status = lod_jobs_write_row(jobs, job, problem);
  if (status == LOD_OK) {
    lod_jobs_append(jobs, job);
  } else {
    unlinkat(jobs->uploads_fd, lod_jobs_name(*number).text, 0);
    lod_jobs_free_job(job);
  }
  return status;
}

enum lod_status lod_jobs_submit(struct lod_jobs *jobs, const char *id, const char *name, const char *format, int fd, uint64_t *job,
                                struct lod_problem *problem) {
  pthread_mutex_lock(&jobs->submit);
  enum lod_status status = check_submission(jobs, id, fd, problem);
  if (status == LOD_OK)
    status = lod_jobs_add(jobs, id, name, format, false, fd, job, problem);
  pthread_mutex_unlock(&jobs->submit);
  close(fd);
  if (status == LOD_OK) {
    lod_jobs_supersede(jobs, id);
    lod_jobs_tell(jobs, *job);
  }
  return status;
}

/* ---- find, count ---- */

bool lod_jobs_find(struct lod_jobs *jobs, uint64_t number, struct lod_job *job) {
  pthread_mutex_lock(&jobs->mutex);
  const struct job *found = lod_jobs_find_job(jobs, number);
  if (found != NULL)
    *job = found->facts;
  pthread_mutex_unlock(&jobs->mutex);
  return found != NULL;
}

struct lod_jobs_counts lod_jobs_counts(struct lod_jobs *jobs) {
  pthread_mutex_lock(&jobs->mutex);
  struct lod_jobs_counts counts = jobs->counts;
  counts.queued_later = lod_jobs_count_waiting(jobs, true);
  for (uint32_t i = 0; i < jobs->runner_count; i++)
    counts.running_later += jobs->runners[i].job != NULL && jobs->runners[i].job->later;
  pthread_mutex_unlock(&jobs->mutex);
  return counts;
}

/* ---- start and stop ---- */

struct load {
  struct lod_jobs *jobs;
  struct lod_problem *problem;
};

static enum lod_status load_job(void *context, const struct lod_catalog_job *row) {
  const struct load *load = context;
  struct job *job = lod_jobs_reserve(load->jobs) ? lod_jobs_create_job(row->number, row->id, row->name, row->format) : NULL;
  if (job == NULL)
    return lod_fail_memory(load->problem);
  job->facts.state = row->state == LOD_JOB_RUNNING ? LOD_JOB_QUEUED : (enum lod_job_state)row->state;
  job->facts.created = row->created;
  job->facts.finished = row->finished;
  job->facts.problem = row->problem;
  job->attempts = row->attempts;
  job->later = row->later;
  if (job->facts.state == LOD_JOB_DONE) {
    job->facts.progress = 1;
    snprintf(job->facts.stage, sizeof job->facts.stage, "done");
  }
  if (row->state == LOD_JOB_RUNNING && row->attempts >= MAX_ATTEMPTS) {
    job->facts.state = LOD_JOB_FAILED;
    job->facts.finished = lod_jobs_wall_seconds();
    (void)lod_fail(&job->facts.problem, LOD_IO, "gave-up", "The server ended %d times while this bake ran; it is not tried again.",
                   MAX_ATTEMPTS);
  }
  load->jobs->counts.retried += row->state == LOD_JOB_RUNNING && job->facts.state == LOD_JOB_QUEUED;
  lod_jobs_append(load->jobs, job);
  return LOD_OK;
}

/* An older upload must not come back after a newer one of its model: its end could not be noted, on a full disk. */
static bool is_outdated(const struct lod_jobs *jobs, size_t at) {
  const struct job *job = jobs->list[at];
  for (size_t i = at + 1; i < jobs->count && !lod_jobs_has_ended(job); i++)
    if (jobs->list[i]->facts.state == LOD_JOB_DONE && jobs->list[i]->later <= job->later &&
        strcmp(jobs->list[i]->facts.id, job->facts.id) == 0)
      return true;
  return false;
}

/* What the last run could not bring to an end. */
static enum lod_status end_old_jobs(struct lod_jobs *jobs, struct lod_problem *problem) {
  for (size_t i = 0; i < jobs->count; i++) {
    struct job *job = jobs->list[i];
    bool unwanted = job->later && jobs->later_families == NULL && !lod_jobs_has_ended(job);
    bool outdated = unwanted || is_outdated(jobs, i);
    if (outdated) {
      lod_jobs_explain_cancel(&job->facts.problem, unwanted ? UNWANTED : SUPERSEDED);
      job->facts.state = LOD_JOB_FAILED;
      job->facts.finished = lod_jobs_wall_seconds();
      jobs->counts.queued--;
      jobs->ended++;
    }
    if (outdated || strcmp(job->facts.problem.type, "gave-up") == 0)
      LOD_TRY(lod_jobs_write_row(jobs, job, problem));
  }
  return LOD_OK;
}

/* Uploads that no open job names: of jobs that have ended, or that were never acknowledged. */
static void sweep_uploads(struct lod_jobs *jobs) {
  struct lod_name_list names = lod_list_folder(jobs->uploads_fd);
  for (size_t i = 0; i < names.count; i++) {
    char *end;
    uint64_t number = strtoull(names.names[i], &end, 10);
    const struct job *job = *end == 0 ? lod_jobs_find_job(jobs, number) : NULL;
    if (job == NULL || lod_jobs_has_ended(job))
      lod_remove_tree(jobs->uploads_fd, names.names[i]);
  }
  lod_name_list_finish(&names);
}

static enum lod_status prepare(struct lod_jobs *jobs, struct lod_problem *problem) {
  const struct lod_jobs_settings *settings = &jobs->settings;
  jobs->worker_path = strdup(settings->worker_path);
  if (jobs->worker_path == NULL)
    return lod_fail_memory(problem);
  json_error_t error;
  if (settings->limits_json != NULL) {
    jobs->limits = json_loads(settings->limits_json, JSON_REJECT_DUPLICATES, &error);
    if (!json_is_object(jobs->limits))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-limits", "The import limits are not a JSON object.");
  }
  LOD_TRY(lod_family_lists(settings->families, settings->later_families, &jobs->families, &jobs->later_families, problem));
  jobs->catalog = lod_store_catalog(settings->store);
  int folder_fd = lod_store_directory_fd(settings->store);
  jobs->uploads_fd = openat(folder_fd, "uploads", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  jobs->work_fd = openat(folder_fd, "work", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (jobs->uploads_fd < 0 || jobs->work_fd < 0)
    return lod_fail_errno(problem, "A folder of the store cannot be opened");
  struct load load = {jobs, problem};
  LOD_TRY(lod_catalog_last_job(jobs->catalog, &jobs->last_number, problem));
  LOD_TRY(lod_catalog_read_jobs(jobs->catalog, load_job, &load, problem));
  LOD_TRY(end_old_jobs(jobs, problem));
  lod_jobs_prune(jobs);
  sweep_uploads(jobs);
  return LOD_OK;
}

static enum lod_status start_runners(struct lod_jobs *jobs, struct lod_problem *problem) {
  jobs->bakes = jobs->settings.workers == 0 ? 1 : jobs->settings.workers;
  if (jobs->bakes > MAX_WORKERS)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "At most %d workers can run at once.", MAX_WORKERS);
  const uint32_t wanted = jobs->bakes + (jobs->later_families != NULL);
  for (uint32_t i = 0; i < wanted; i++) {
    struct runner *runner = &jobs->runners[i];
    runner->jobs = jobs;
    runner->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (runner->wake_fd < 0)
      return lod_fail_errno(problem, "A worker's event cannot be made");
    pthread_mutex_lock(&jobs->mutex); /* runners look at runner_count */
    bool started = pthread_create(&runner->thread, NULL, lod_jobs_run, runner) == 0;
    jobs->runner_count += started;
    pthread_mutex_unlock(&jobs->mutex);
    if (!started) {
      close(runner->wake_fd);
      return lod_fail_memory(problem);
    }
  }
  return LOD_OK;
}

enum lod_status lod_jobs_create(const struct lod_jobs_settings *settings, struct lod_jobs **jobs, struct lod_problem *problem) {
  *jobs = NULL;
  struct lod_jobs *result = calloc(1, sizeof *result);
  if (result == NULL)
    return lod_fail_memory(problem);
  result->settings = *settings;
  result->uploads_fd = result->work_fd = -1;
  pthread_mutex_init(&result->trial.mutex, NULL);
  pthread_mutex_init(&result->erase, NULL);
  pthread_mutex_init(&result->submit, NULL);
  pthread_mutex_init(&result->mutex, NULL);
  pthread_cond_init(&result->changed, NULL);
  enum lod_status status = prepare(result, problem);
  if (status == LOD_OK)
    status = start_runners(result, problem);
  if (status != LOD_OK) {
    lod_jobs_destroy(result);
    return status;
  }
  *jobs = result;
  return LOD_OK;
}

void lod_jobs_destroy(struct lod_jobs *jobs) {
  if (jobs == NULL)
    return;
  pthread_mutex_lock(&jobs->mutex);
  jobs->stopping = true;
  for (uint32_t i = 0; i < jobs->runner_count; i++)
    lod_jobs_wake(&jobs->runners[i]);
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
  for (uint32_t i = 0; i < jobs->runner_count; i++) {
    pthread_join(jobs->runners[i].thread, NULL);
    close(jobs->runners[i].wake_fd);
  }
  for (size_t i = 0; i < jobs->count; i++)
    lod_jobs_free_job(jobs->list[i]);
  free(jobs->list);
  free(jobs->worker_path);
  json_decref(jobs->limits);
  json_decref(jobs->families);
  json_decref(jobs->later_families);
  if (jobs->uploads_fd >= 0)
    close(jobs->uploads_fd);
  if (jobs->work_fd >= 0)
    close(jobs->work_fd);
  pthread_cond_destroy(&jobs->changed);
  pthread_mutex_destroy(&jobs->mutex);
  pthread_mutex_destroy(&jobs->submit);
  pthread_mutex_destroy(&jobs->erase);
  pthread_mutex_destroy(&jobs->trial.mutex);
  free(jobs);
}
