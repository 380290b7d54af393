#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <jansson.h>

#include "server/jobs/families.h"
#include "server/jobs/jobs.h"
#include "server/jobs/upload.h"
#include "server/jobs/watch.h"
#include "server/store/catalog.h"
#include "server/store/files.h"

enum { MAX_ATTEMPTS = 3, MAX_WORKERS = 64, NAME_MAX_BYTES = 255 };

struct job {
  struct lod_job facts;
  char *name, *format; /* format may be NULL */
  uint32_t attempts;
  double started, stage_began; /* monotonic */
  bool later;                  /* adds the later families to a model that is served */
  enum { NOT_CANCELLED, DELETED, SUPERSEDED } cancelled;
  bool committing;       /* past the point where a cancel can stop it */
  struct runner *runner; /* while running */
};

/* A thread that works on one job after another. */
struct runner {
  struct lod_jobs *jobs;
  pthread_t thread;
  int wake_fd; /* eventfd: stop what is running */
  struct job *job;
};

struct lod_jobs {
  struct lod_jobs_settings settings;
  char *worker_path;
  json_t *limits;                    /* or NULL */
  json_t *families, *later_families; /* names: of a first bake, of a later one (the first's among them); later NULL = none */
  struct lod_catalog *catalog;
  int uploads_fd, work_fd;
  pthread_mutex_t submit; /* one new job at a time; taken before `mutex` */
  pthread_mutex_t mutex;  /* guards all below */
  pthread_cond_t changed; /* something to run, or something ended */
  struct job **list;      /* number order */
  size_t count, capacity, ended;
  uint64_t last_number;
  struct lod_jobs_counts counts;
  bool stopping;
  struct runner runners[MAX_WORKERS];
  uint32_t runner_count;
};

struct lod_jobs_settings lod_jobs_defaults(void) {
  return (struct lod_jobs_settings){.workers = 1,
                                    .queue_limit = 64,
                                    .deadline_seconds = 600,
                                    .memory_limit_bytes = UINT64_C(8) << 30,
                                    .upload_limit_bytes = UINT64_C(1) << 30,
                                    .kept_jobs = 1000};
}

/* ---- small things ---- */

static double wall_seconds(void) {
  struct timespec time;
  clock_gettime(CLOCK_REALTIME, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

static double monotonic_seconds(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

struct number_name {
  char text[24];
};
static struct number_name name_of(uint64_t number) {
  struct number_name name;
  snprintf(name.text, sizeof name.text, "%" PRIu64, number);
  return name;
}

static void tell(struct lod_jobs *jobs, uint64_t number) {
  if (jobs->settings.changed != NULL)
    jobs->settings.changed(jobs->settings.context, number);
}

__attribute__((format(printf, 2, 3))) static void say(struct lod_jobs *jobs, const char *format, ...) {
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

static bool has_ended(const struct job *job) {
  return job->facts.state == LOD_JOB_DONE || job->facts.state == LOD_JOB_FAILED;
}

static void free_job(struct job *job) {
  if (job == NULL)
    return;
  free(job->name);
  free(job->format);
  free(job);
}

static struct job *create_job(uint64_t number, const char *id, const char *name, const char *format) {
  struct job *job = calloc(1, sizeof *job);
  if (job == NULL)
    return NULL;
  job->facts.number = number;
  job->facts.created = wall_seconds();
  snprintf(job->facts.id, sizeof job->facts.id, "%s", id);
  snprintf(job->facts.stage, sizeof job->facts.stage, "queued");
  job->name = strndup(name == NULL ? id : name, NAME_MAX_BYTES);
  job->format = format == NULL ? NULL : strdup(format);
  if (job->name == NULL || (format != NULL && job->format == NULL)) {
    free_job(job);
    return NULL;
  }
  return job;
}

/* Room for one more job. Only new jobs (one at a time) and the start append. */
static bool reserve_list(struct lod_jobs *jobs) {
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

static void append_job(struct lod_jobs *jobs, struct job *job) {
  pthread_mutex_lock(&jobs->mutex);
  assert(jobs->count < jobs->capacity && (jobs->count == 0 || jobs->list[jobs->count - 1]->facts.number < job->facts.number));
  jobs->list[jobs->count++] = job;
  jobs->ended += has_ended(job);
  jobs->counts.queued += job->facts.state == LOD_JOB_QUEUED;
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
}

static struct job *find_job(const struct lod_jobs *jobs, uint64_t number) {
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
    if (!has_ended(jobs->list[i]))
      continue;
    job = jobs->list[i];
    memmove(jobs->list + i, jobs->list + i + 1, (jobs->count - i - 1) * sizeof *jobs->list);
    jobs->count--;
    jobs->ended--;
  }
  pthread_mutex_unlock(&jobs->mutex);
  return job;
}

/* Forgets jobs that ended long ago. A row that cannot be deleted now is met again at the next start. */
static void prune(struct lod_jobs *jobs) {
  for (struct job *job; (job = detach_oldest(jobs)) != NULL; free_job(job))
    if (lod_catalog_delete_job(jobs->catalog, job->facts.number, NULL) != LOD_OK)
      continue;
}

/* Not with the mutex held, if it can be helped: it waits for the disk, and lod_jobs_find must not. Whoever runs a job may read it. */
static enum lod_status write_row(struct lod_jobs *jobs, const struct job *job, struct lod_problem *problem) {
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

static void remove_files(struct lod_jobs *jobs, uint64_t number) {
  lod_remove_tree(jobs->work_fd, name_of(number).text);
  unlinkat(jobs->uploads_fd, name_of(number).text, 0);
}

/* ---- the end of a job, and cancelling ---- */

/* What becomes of the job. */
static void settle(struct job *job, struct lod_watch_result *result) {
  bool cancelled = result->end == LOD_WATCH_STOPPED && job->cancelled != NOT_CANCELLED;
  if (cancelled && job->cancelled == DELETED)
    (void)lod_fail(&result->problem, LOD_CANCELLED, "cancelled", "The model was deleted before its bake had ended.");
  else if (cancelled)
    (void)lod_fail(&result->problem, LOD_CANCELLED, "superseded", "The model was uploaded anew before this bake had ended.");
  job->facts.problem = result->problem;
  if (result->end == LOD_WATCH_STOPPED && !cancelled) { /* an orderly stop of the daemon is no failed attempt */
    job->attempts--;
    job->facts.state = LOD_JOB_QUEUED;
    job->facts.progress = 0;
    snprintf(job->facts.stage, sizeof job->facts.stage, "queued");
    return;
  }
  job->facts.state = result->end == LOD_WATCH_DONE ? LOD_JOB_DONE : LOD_JOB_FAILED;
  job->facts.finished = wall_seconds();
  if (job->facts.state == LOD_JOB_DONE) {
    job->facts.progress = 1;
    snprintf(job->facts.stage, sizeof job->facts.stage, "done");
  }
}

static void wake(const struct runner *runner) {
  const uint64_t one = 1;
  ssize_t ignored = write(runner->wake_fd, &one, sizeof one);
  (void)ignored;
}

/* The first job of the model from *from on that has not ended. The mutex is held. */
static struct job *next_open_job(const struct lod_jobs *jobs, const char *id, uint64_t from) {
  for (size_t i = 0; i < jobs->count; i++)
    if (jobs->list[i]->facts.number >= from && !has_ended(jobs->list[i]) && strcmp(jobs->list[i]->facts.id, id) == 0)
      return jobs->list[i];
  return NULL;
}

/* Ends the model's open jobs: DELETED all, SUPERSEDED those that add later families. After DELETED none of them
 * can change the model any more. */
static void cancel_jobs(struct lod_jobs *jobs, const char *id, int why) {
  uint64_t number = 0;
  pthread_mutex_lock(&jobs->mutex);
  for (struct job *job; !jobs->stopping && (job = next_open_job(jobs, id, number)) != NULL;) {
    number = job->facts.number;
    if (why == SUPERSEDED && !job->later) {
      number++;
      continue;
    }
    job->cancelled = why;
    if (job->facts.state == LOD_JOB_QUEUED) {
      struct lod_watch_result stopped = {.end = LOD_WATCH_STOPPED};
      settle(job, &stopped);
      jobs->counts.queued--;
      jobs->counts.failed++;
      jobs->ended++;
      (void)write_row(jobs, job, NULL);
      remove_files(jobs, number);
      pthread_mutex_unlock(&jobs->mutex);
      tell(jobs, number);
      pthread_mutex_lock(&jobs->mutex);
      continue;
    }
    wake(job->runner);
    while (why == DELETED && job->committing) {
      pthread_cond_wait(&jobs->changed, &jobs->mutex);
      job = find_job(jobs, number);
      if (job == NULL)
        break;
    }
    number++;
  }
  pthread_mutex_unlock(&jobs->mutex);
}

/* ---- submit ---- */

enum lod_status lod_jobs_upload_create(struct lod_jobs *jobs, int *fd, struct lod_problem *problem) {
  return lod_upload_create(jobs->uploads_fd, fd, problem);
}

/* Jobs that wait and are, or are not, to add later families. The mutex is held. */
static size_t count_waiting(const struct lod_jobs *jobs, bool later) {
  size_t count = 0;
  for (size_t i = 0; i < jobs->count; i++)
    count += jobs->list[i]->facts.state == LOD_JOB_QUEUED && jobs->list[i]->later == later;
  return count;
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
  bool full = count_waiting(jobs, false) >= jobs->settings.queue_limit, stopping = jobs->stopping;
  pthread_mutex_unlock(&jobs->mutex);
  if (full || stopping)
    return lod_fail(problem, LOD_LIMIT, "queue-full",
                    stopping ? "The server is stopping; try again later." : "Too many bakes wait already; try again later.");
  return LOD_OK;
}

/* A job that bakes the file behind fd. `submit` is held. */
static enum lod_status add_job(struct lod_jobs *jobs, const char *id, const char *name, const char *format, bool later, int fd,
                               uint64_t *number, struct lod_problem *problem) {
  struct job *job = reserve_list(jobs) ? create_job(jobs->last_number + 1, id, name, format) : NULL;
  if (job == NULL)
    return lod_fail_memory(problem);
  job->later = later;
  *number = ++jobs->last_number; /* not used again, whatever happens below */
  enum lod_status status = lod_upload_name(jobs->uploads_fd, fd, name_of(*number).text, problem);
  if (status == LOD_OK)
    status = write_row(jobs, job, problem);
  if (status == LOD_OK) {
    append_job(jobs, job);
  } else {
    unlinkat(jobs->uploads_fd, name_of(*number).text, 0);
    free_job(job);
  }
  return status;
}

enum lod_status lod_jobs_submit(struct lod_jobs *jobs, const char *id, const char *name, const char *format, int fd, uint64_t *job,
                                struct lod_problem *problem) {
  pthread_mutex_lock(&jobs->submit);
  enum lod_status status = check_submission(jobs, id, fd, problem);
  if (status == LOD_OK)
    status = add_job(jobs, id, name, format, false, fd, job, problem);
  pthread_mutex_unlock(&jobs->submit);
  close(fd);
  if (status == LOD_OK) {
    cancel_jobs(jobs, id, SUPERSEDED);
    tell(jobs, *job);
  }
  return status;
}

/* ---- running one job ---- */

/* Payload of the 'J' frame; NULL when memory is out. Free it. */
static char *job_payload(const struct lod_jobs *jobs, const struct job *job) {
  json_t *limits = jobs->limits == NULL ? json_object() : json_deep_copy(jobs->limits);
  /* Below the process's own limit: the worker's allocations meet theirs first, and it can say so. */
  json_object_set_new(limits, "memory_bytes", json_integer((json_int_t)(jobs->settings.memory_limit_bytes / 8 * 7)));
  json_object_set_new(limits, "seconds", json_integer(jobs->settings.deadline_seconds));
  json_t *root =
      json_pack("{s:s, s:s, s:s, s:s?, s:O, s:i, s:o}", "job", "bake", "id", job->facts.id, "name", job->name, "format", job->format,
                "families", job->later ? jobs->later_families : jobs->families, "threads", (int)jobs->settings.threads, "limits", limits);
  char *text = root == NULL ? NULL : json_dumps(root, JSON_COMPACT);
  json_decref(root);
  return text;
}

/* The mutex is held. */
static void enter_stage(struct lod_jobs *jobs, struct job *job, const char *stage) {
  double time = monotonic_seconds();
  lod_stages_add(&jobs->counts.stages, job->facts.stage, time - job->stage_began);
  job->stage_began = time;
  snprintf(job->facts.stage, sizeof job->facts.stage, "%s", stage);
}

static void take_progress(void *context, const char *stage, double fraction) {
  const struct runner *runner = context;
  struct lod_jobs *jobs = runner->jobs;
  pthread_mutex_lock(&jobs->mutex);
  struct job *job = runner->job;
  if (strcmp(job->facts.stage, stage) != 0)
    enter_stage(jobs, job, stage);
  job->facts.progress = fraction;
  uint64_t number = job->facts.number;
  pthread_mutex_unlock(&jobs->mutex);
  tell(jobs, number);
}

/* Processor seconds that the job may use: all its threads for the whole time, and a little to tell the end. */
static uint64_t cpu_limit(const struct lod_jobs *jobs) {
  long online = sysconf(_SC_NPROCESSORS_ONLN);
  uint64_t threads = jobs->settings.threads != 0 ? jobs->settings.threads : online > 0 ? (uint64_t)online : 1;
  return threads * jobs->settings.deadline_seconds + 10;
}

static void watch_worker(struct runner *runner, const struct job *job, int input_fd, int output_fd, struct lod_watch_result *result) {
  struct lod_jobs *jobs = runner->jobs;
  char *payload = job_payload(jobs, job);
  if (payload == NULL) {
    result->end = LOD_WATCH_FAILED;
    (void)lod_fail_memory(&result->problem);
    return;
  }
  const struct lod_watch watch = {.spawn = {.path = jobs->worker_path,
                                            .input_fd = input_fd,
                                            .output_fd = output_fd,
                                            .memory_limit_bytes = jobs->settings.memory_limit_bytes,
                                            .cpu_limit_seconds = cpu_limit(jobs)},
                                  .job = payload,
                                  .job_size = strlen(payload),
                                  .deadline_seconds = jobs->settings.deadline_seconds,
                                  .output_limit_bytes = jobs->settings.memory_limit_bytes,
                                  .stop_fd = runner->wake_fd,
                                  .progress = take_progress,
                                  .context = runner};
  lod_watch_run(&watch, result);
  free(payload);
}

/* False when the job was cancelled or the daemon stops. From here on a cancel waits. */
static bool begin_commit(struct lod_jobs *jobs, struct job *job) {
  pthread_mutex_lock(&jobs->mutex);
  job->committing = job->cancelled == NOT_CANCELLED;
  if (job->committing)
    enter_stage(jobs, job, "store");
  pthread_mutex_unlock(&jobs->mutex);
  tell(jobs, job->facts.number);
  return job->committing;
}

static void run_job(struct runner *runner, struct job *job, struct lod_watch_result *result) {
  struct lod_jobs *jobs = runner->jobs;
  struct number_name name = name_of(job->facts.number);
  result->end = LOD_WATCH_FAILED;
  lod_remove_tree(jobs->work_fd, name.text);
  int input_fd = openat(jobs->uploads_fd, name.text, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
  if (input_fd < 0) {
    (void)lod_fail(&result->problem, LOD_IO, "upload-lost", "The upload is not there any more. Send it again.");
    return;
  }
  int output_fd = -1;
  if (mkdirat(jobs->work_fd, name.text, 0700) == 0)
    output_fd = openat(jobs->work_fd, name.text, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (output_fd < 0)
    (void)lod_fail_errno(&result->problem, "A folder for the worker cannot be made");
  else
    watch_worker(runner, job, input_fd, output_fd, result);
  close(input_fd);
  if (result->end == LOD_WATCH_DONE) {
    if (!begin_commit(jobs, job))
      result->end = LOD_WATCH_STOPPED;
    else if (lod_store_commit_bake(jobs->settings.store, job->facts.id, output_fd, &result->problem) != LOD_OK)
      result->end = LOD_WATCH_FAILED;
  }
  if (output_fd >= 0)
    close(output_fd);
}

/* What the counters and the log learn. The mutex is held. */
static void count_end(struct lod_jobs *jobs, const struct job *job, const struct lod_watch_result *result) {
  jobs->counts.done += job->facts.state == LOD_JOB_DONE;
  jobs->counts.failed += job->facts.state == LOD_JOB_FAILED;
  jobs->counts.workers_crashed += result->end == LOD_WATCH_CRASHED;
  jobs->counts.workers_killed += result->end == LOD_WATCH_KILLED;
  jobs->counts.workers_done += result->end == LOD_WATCH_DONE;
  jobs->counts.workers_failed += result->end == LOD_WATCH_FAILED;
  jobs->counts.workers_stopped += result->end == LOD_WATCH_STOPPED;
  if (has_ended(job))
    jobs->counts.bake_seconds += monotonic_seconds() - job->started;
}

/* What a person should know of: a failure, and whatever the worker wrote (its jail's warnings among it). */
static void log_end(struct lod_jobs *jobs, const struct lod_job *job, const struct lod_watch_result *result) {
  const char *lead = result->log[0] == 0 ? "" : "; the worker wrote: ";
  if (job->state == LOD_JOB_FAILED)
    say(jobs, "job %" PRIu64 " (%s) failed: %s: %s%s%s", job->number, job->id, job->problem.type, job->problem.detail, lead, result->log);
  else if (result->log[0] != 0)
    say(jobs, "job %" PRIu64 " (%s)%s%s", job->number, job->id, lead, result->log);
}

/* Queues the job that adds the later families to what `job` has just stored; returns its number. 0: there is nothing to add, a newer upload
 * waits already, or it cannot be (which is no failure of `job`, and is logged). Before `job` itself is noted as done: should the daemon die
 * in between, `job` runs again and finds this one waiting. */
static uint64_t add_later_job(struct lod_jobs *jobs, const struct job *job) {
  uint64_t number = 0;
  struct lod_problem problem = {0};
  if (jobs->later_families == NULL || job->later)
    return 0;
  pthread_mutex_lock(&jobs->submit);
  pthread_mutex_lock(&jobs->mutex);
  bool wanted = !jobs->stopping && next_open_job(jobs, job->facts.id, job->facts.number + 1) == NULL;
  bool full = count_waiting(jobs, true) >= jobs->settings.queue_limit;
  pthread_mutex_unlock(&jobs->mutex);
  if (wanted && !full) {
    int fd = openat(jobs->uploads_fd, name_of(job->facts.number).text, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    enum lod_status status = fd < 0 ? lod_fail_errno(&problem, "The upload cannot be read")
                                    : add_job(jobs, job->facts.id, job->name, job->format, true, fd, &number, &problem);
    if (status != LOD_OK)
      number = 0;
    if (fd >= 0)
      close(fd);
  }
  pthread_mutex_unlock(&jobs->submit);
  if (wanted && number == 0)
    say(jobs, "job %" PRIu64 " (%s): the later families are not baked: %s", job->facts.number, job->facts.id,
        full ? "too many models wait for theirs already" : problem.detail);
  return number;
}

static void finish_job(struct runner *runner, struct job *job, struct lod_watch_result *result) {
  struct lod_jobs *jobs = runner->jobs;
  uint64_t number = job->facts.number;
  struct lod_problem problem = {0};
  /* On the disk first, then for everyone to see. */
  pthread_mutex_lock(&jobs->mutex);
  struct job after = *job;
  pthread_mutex_unlock(&jobs->mutex);
  settle(&after, result);
  if (after.facts.state == LOD_JOB_DONE)
    after.facts.next = add_later_job(jobs, job);
  if (write_row(jobs, &after, &problem) != LOD_OK)
    say(jobs, "job %" PRIu64 ": its end could not be noted and it may run again: %s", number, problem.detail);
  if (has_ended(&after))
    remove_files(jobs, number);
  else
    lod_remove_tree(jobs->work_fd, name_of(number).text);
  log_end(jobs, &after.facts, result);
  pthread_mutex_lock(&jobs->mutex);
  lod_stages_add(&jobs->counts.stages, job->facts.stage, monotonic_seconds() - job->stage_began);
  job->facts = after.facts;
  job->attempts = after.attempts;
  job->runner = NULL;
  job->committing = false;
  runner->job = NULL;
  jobs->counts.running--;
  jobs->counts.queued += !has_ended(job);
  jobs->ended += has_ended(job);
  count_end(jobs, job, result);
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
  tell(jobs, number);
  prune(jobs);
}

/* The oldest waiting job of this kind whose model no other worker is at: uploads of one model take effect in their order. The mutex is
 * held. */
static struct job *oldest_job(const struct lod_jobs *jobs, bool later) {
  for (size_t i = 0; i < jobs->count; i++) {
    bool busy = jobs->list[i]->facts.state != LOD_JOB_QUEUED || jobs->list[i]->later != later;
    for (uint32_t k = 0; k < jobs->runner_count && !busy; k++)
      busy = jobs->runners[k].job != NULL && strcmp(jobs->runners[k].job->facts.id, jobs->list[i]->facts.id) == 0;
    if (!busy)
      return jobs->list[i];
  }
  return NULL;
}

/* Models that are not served yet come first. The mutex is held. */
static struct job *next_job(const struct lod_jobs *jobs) {
  struct job *job = oldest_job(jobs, false);
  return job != NULL ? job : oldest_job(jobs, true);
}

/* The mutex is held. */
static void start_job(struct runner *runner, struct job *job) {
  struct lod_jobs *jobs = runner->jobs;
  uint64_t ignored;
  if (read(runner->wake_fd, &ignored, sizeof ignored) < 0) /* a late wish to stop the job before */
    ignored = 0;
  runner->job = job;
  job->runner = runner;
  job->started = job->stage_began = monotonic_seconds();
  job->attempts++;
  job->facts.state = LOD_JOB_RUNNING;
  job->facts.progress = 0;
  snprintf(job->facts.stage, sizeof job->facts.stage, "start");
  jobs->counts.queued--;
  jobs->counts.running++;
}

static void *run_jobs(void *argument) {
  struct runner *runner = argument;
  struct lod_jobs *jobs = runner->jobs;
  struct lod_watch_result *result = malloc(sizeof *result);
  if (result == NULL)
    abort(); /* a few kilobytes at start */
  pthread_mutex_lock(&jobs->mutex);
  while (!jobs->stopping) {
    struct job *job = next_job(jobs);
    if (job == NULL) {
      pthread_cond_wait(&jobs->changed, &jobs->mutex);
      continue;
    }
    start_job(runner, job);
    pthread_mutex_unlock(&jobs->mutex);
    (void)write_row(jobs, job, NULL); /* not noted (a full disk): the attempt does not count, nothing worse */
    tell(jobs, job->facts.number);
    memset(result, 0, sizeof *result);
    run_job(runner, job, result);
    finish_job(runner, job, result);
    pthread_mutex_lock(&jobs->mutex);
  }
  pthread_mutex_unlock(&jobs->mutex);
  free(result);
  return NULL;
}

/* ---- cancel, find, count ---- */

void lod_jobs_cancel_model(struct lod_jobs *jobs, const char *id) {
  cancel_jobs(jobs, id, DELETED);
}

bool lod_jobs_find(struct lod_jobs *jobs, uint64_t number, struct lod_job *job) {
  pthread_mutex_lock(&jobs->mutex);
  const struct job *found = find_job(jobs, number);
  if (found != NULL)
    *job = found->facts;
  pthread_mutex_unlock(&jobs->mutex);
  return found != NULL;
}

struct lod_jobs_counts lod_jobs_counts(struct lod_jobs *jobs) {
  pthread_mutex_lock(&jobs->mutex);
  struct lod_jobs_counts counts = jobs->counts;
  counts.queued_later = count_waiting(jobs, true);
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
  struct job *job = reserve_list(load->jobs) ? create_job(row->number, row->id, row->name, row->format) : NULL;
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
    job->facts.finished = wall_seconds();
    (void)lod_fail(&job->facts.problem, LOD_IO, "gave-up", "The server ended %d times while this bake ran; it is not tried again.",
                   MAX_ATTEMPTS);
  }
  load->jobs->counts.retried += row->state == LOD_JOB_RUNNING && job->facts.state == LOD_JOB_QUEUED;
  append_job(load->jobs, job);
  return LOD_OK;
}

/* Uploads that no open job names: of jobs that have ended, or that were never acknowledged. */
static void sweep_uploads(struct lod_jobs *jobs) {
  struct lod_name_list names = lod_list_folder(jobs->uploads_fd);
  for (size_t i = 0; i < names.count; i++) {
    char *end;
    uint64_t number = strtoull(names.names[i], &end, 10);
    const struct job *job = *end == 0 ? find_job(jobs, number) : NULL;
    if (job == NULL || has_ended(job))
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
  for (size_t i = 0; i < jobs->count; i++)
    if (strcmp(jobs->list[i]->facts.problem.type, "gave-up") == 0)
      LOD_TRY(write_row(jobs, jobs->list[i], problem));
  prune(jobs);
  sweep_uploads(jobs);
  return LOD_OK;
}

static enum lod_status start_runners(struct lod_jobs *jobs, struct lod_problem *problem) {
  uint32_t wanted = jobs->settings.workers == 0 ? 1 : jobs->settings.workers;
  if (wanted > MAX_WORKERS)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "At most %d workers can run at once.", MAX_WORKERS);
  for (uint32_t i = 0; i < wanted; i++) {
    struct runner *runner = &jobs->runners[i];
    runner->jobs = jobs;
    runner->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (runner->wake_fd < 0)
      return lod_fail_errno(problem, "A worker's event cannot be made");
    pthread_mutex_lock(&jobs->mutex); /* runners look at runner_count */
    bool started = pthread_create(&runner->thread, NULL, run_jobs, runner) == 0;
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
    wake(&jobs->runners[i]);
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
  for (uint32_t i = 0; i < jobs->runner_count; i++) {
    pthread_join(jobs->runners[i].thread, NULL);
    close(jobs->runners[i].wake_fd);
  }
  for (size_t i = 0; i < jobs->count; i++)
    free_job(jobs->list[i]);
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
  free(jobs);
}
