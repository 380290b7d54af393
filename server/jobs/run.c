/* One job in its worker, and what its end means. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <sys/stat.h>

#include "server/jobs/families.h"
#include "server/jobs/queue.h"
#include "server/jobs/watch.h"
#include "server/store/files.h"

/* ---- the end of a job ---- */

/* What becomes of the job. */
static void settle(struct job *job, struct lod_watch_result *result) {
  bool superseded = result->end == LOD_WATCH_STOPPED && job->cancelled == SUPERSEDED;
  if (superseded)
    lod_jobs_explain_cancel(&result->problem, SUPERSEDED);
  job->facts.problem = result->problem;
  /* An orderly stop of the daemon is no failed attempt, nor is a delete, which decides by itself what becomes of the job. */
  if (result->end == LOD_WATCH_STOPPED && !superseded) {
    job->attempts--;
    job->queued = lod_jobs_monotonic_seconds();
    job->facts.state = LOD_JOB_QUEUED;
    job->facts.progress = 0;
    snprintf(job->facts.stage, sizeof job->facts.stage, "queued");
    return;
  }
  job->facts.state = result->end == LOD_WATCH_DONE ? LOD_JOB_DONE : LOD_JOB_FAILED;
  job->facts.finished = lod_jobs_wall_seconds();
  if (job->facts.state == LOD_JOB_DONE) {
    job->facts.progress = 1;
    snprintf(job->facts.stage, sizeof job->facts.stage, "done");
  }
}

void lod_jobs_wake(const struct runner *runner) {
  const uint64_t one = 1;
  ssize_t ignored = write(runner->wake_fd, &one, sizeof one);
  (void)ignored;
}

/* ---- running one job ---- */

/* Payload of the 'J' frame; NULL when memory is out. Free it. */
static char *job_payload(const struct lod_jobs *jobs, const struct job *job) {
  json_t *limits = jobs->limits == NULL ? json_object() : json_deep_copy(jobs->limits);
  /* Below the process's own limit: the worker's allocations meet theirs first, and it can say so. */
  json_object_set_new(limits, "memory_bytes", json_integer((json_int_t)(jobs->settings.memory_limit_bytes / 8 * 7)));
  json_object_set_new(limits, "seconds", json_integer(jobs->settings.deadline_seconds));
  json_t *root = json_pack("{s:s, s:s, s:s, s:s?, s:O, s:o, s:i, s:o}", "job", "bake", "id", job->facts.id, "name", job->name, "format",
                           job->format, "families", job->later ? jobs->later_families : jobs->families, "envelope",
                           lod_option_list(jobs->settings.envelope), "threads", (int)jobs->settings.threads, "limits", limits);
  char *text = root == NULL ? NULL : json_dumps(root, JSON_COMPACT);
  json_decref(root);
  return text;
}

/* The mutex is held. */
static void enter_stage(struct lod_jobs *jobs, struct job *job, const char *stage) {
  double time = lod_jobs_monotonic_seconds();
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
  lod_jobs_tell(jobs, number);
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
                                            .cpu_limit_seconds = cpu_limit(jobs),
                                            .niceness = job->later ? LOD_NICE_LATER_BAKE : LOD_NICE_BAKE},
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
  lod_jobs_tell(jobs, job->facts.number);
  return job->committing;
}

static void run_job(struct runner *runner, struct job *job, struct lod_watch_result *result) {
  struct lod_jobs *jobs = runner->jobs;
  struct lod_number_name name = lod_jobs_name(job->facts.number);
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
  if (lod_jobs_has_ended(job))
    jobs->counts.bake_seconds += lod_jobs_monotonic_seconds() - job->started;
}

/* What a person should know of: a failure, and whatever the worker wrote (its jail's warnings among it). */
static void log_end(struct lod_jobs *jobs, const struct lod_job *job, const struct lod_watch_result *result) {
  const char *lead = result->log[0] == 0 ? "" : "; the worker wrote: ";
  if (job->state == LOD_JOB_FAILED)
    lod_jobs_say(jobs, "job %" PRIu64 " (%s) failed: %s: %s%s%s", job->number, job->id, job->problem.type, job->problem.detail, lead,
                 result->log);
  else if (result->log[0] != 0)
    lod_jobs_say(jobs, "job %" PRIu64 " (%s)%s%s", job->number, job->id, lead, result->log);
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
  bool wanted = !jobs->stopping && lod_jobs_next_open(jobs, job->facts.id, job->facts.number + 1) == NULL;
  bool full = lod_jobs_count_waiting(jobs, true) >= jobs->settings.queue_limit;
  pthread_mutex_unlock(&jobs->mutex);
  if (wanted && !full) {
    int fd = openat(jobs->uploads_fd, lod_jobs_name(job->facts.number).text, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    enum lod_status status = fd < 0 ? lod_fail_errno(&problem, "The upload cannot be read")
                                    : lod_jobs_add(jobs, job->facts.id, job->name, job->format, true, fd, &number, &problem);
    if (status != LOD_OK)
      number = 0;
    if (fd >= 0)
      close(fd);
  }
  pthread_mutex_unlock(&jobs->submit);
  if (wanted && number == 0)
    lod_jobs_say(jobs, "job %" PRIu64 " (%s): the later families are not baked: %s", job->facts.number, job->facts.id,
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
  if (lod_jobs_write_row(jobs, &after, &problem) != LOD_OK)
    lod_jobs_say(jobs, "job %" PRIu64 ": its end could not be noted and it may run again: %s", number, problem.detail);
  if (lod_jobs_has_ended(&after))
    lod_jobs_remove_files(jobs, number);
  else
    lod_remove_tree(jobs->work_fd, lod_jobs_name(number).text);
  log_end(jobs, &after.facts, result);
  pthread_mutex_lock(&jobs->mutex);
  lod_stages_add(&jobs->counts.stages, job->facts.stage, lod_jobs_monotonic_seconds() - job->stage_began);
  job->facts = after.facts;
  job->attempts = after.attempts;
  job->queued = after.queued;
  job->runner = NULL;
  job->committing = false;
  runner->job = NULL;
  jobs->moved = lod_jobs_monotonic_seconds();
  jobs->counts.running--;
  jobs->counts.queued += !lod_jobs_has_ended(job);
  jobs->ended += lod_jobs_has_ended(job);
  count_end(jobs, job, result);
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
  lod_jobs_tell(jobs, number);
  lod_jobs_prune(jobs);
}

/* Whether one more job of this kind may run. Later families take minutes: all runners but the spare one are theirs when nothing else waits,
 * and a model that nobody can see yet still starts at once. The mutex is held. */
static bool has_room(const struct lod_jobs *jobs, bool later) {
  uint32_t all = 0, firsts = 0;
  for (uint32_t i = 0; i < jobs->runner_count; i++) {
    const struct job *job = jobs->runners[i].job;
    all += job != NULL;
    firsts += job != NULL && !job->later;
  }
  return (later ? all : firsts) < jobs->bakes;
}

/* The oldest waiting job of this kind whose model no other worker is at: uploads of one model take effect in their order. The mutex is
 * held. */
static struct job *oldest_job(const struct lod_jobs *jobs, bool later) {
  for (size_t i = 0; has_room(jobs, later) && i < jobs->count; i++) {
    const struct job *job = jobs->list[i];
    bool busy = job->facts.state != LOD_JOB_QUEUED || job->cancelled != NOT_CANCELLED || job->later != later;
    for (uint32_t k = 0; k < jobs->runner_count && !busy; k++)
      busy = jobs->runners[k].job != NULL && strcmp(jobs->runners[k].job->facts.id, job->facts.id) == 0;
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
  job->started = job->stage_began = jobs->moved = lod_jobs_monotonic_seconds();
  *(job->later ? &jobs->counts.later_wait_seconds : &jobs->counts.first_wait_seconds) += job->started - job->queued;
  job->attempts++;
  job->facts.state = LOD_JOB_RUNNING;
  job->facts.progress = 0;
  snprintf(job->facts.stage, sizeof job->facts.stage, "start");
  jobs->counts.queued--;
  jobs->counts.running++;
}

void *lod_jobs_run(void *argument) {
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
    (void)lod_jobs_write_row(jobs, job, NULL); /* not noted (a full disk): the attempt does not count, nothing worse */
    lod_jobs_tell(jobs, job->facts.number);
    memset(result, 0, sizeof *result);
    run_job(runner, job, result);
    finish_job(runner, job, result);
    pthread_mutex_lock(&jobs->mutex);
  }
  pthread_mutex_unlock(&jobs->mutex);
  free(result);
  return NULL;
}
