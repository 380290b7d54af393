/* Whether a bake that comes now would be done. */
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/jobs/queue.h"
#include "server/jobs/watch.h"
#include "server/store/files.h"

/* A trial holds for so long; one that failed is soon made again. */
static const double kGoodSeconds = 60, kBadSeconds = 5;
/* A waiting bake begins at once when a runner is free, and a running one ends by its deadline; later than this, none of them moves. */
static const double kStartSeconds = 10, kEndSeconds = 60;

static bool moves(struct lod_jobs *jobs, struct lod_problem *problem) {
  pthread_mutex_lock(&jobs->mutex);
  double still = lod_jobs_monotonic_seconds() - jobs->moved;
  uint64_t running = jobs->counts.running, queued = jobs->counts.queued;
  pthread_mutex_unlock(&jobs->mutex);
  double most = running > 0 ? jobs->settings.deadline_seconds + kEndSeconds : kStartSeconds;
  if (running + queued == 0 || still <= most)
    return true;
  (void)lod_fail(problem, LOD_IO, "queue-stuck", "No bake has begun or ended for %.0f seconds, and %llu wait or run.", still,
                 (unsigned long long)(running + queued));
  return false;
}

/* A worker that enters its jail, says so and ends. */
static void try_worker(struct lod_jobs *jobs, int output_fd, struct lod_watch_result *result) {
  static const char kJob[] = "{\"job\":\"try\"}";
  int input_fd = open("/dev/null", O_RDONLY | O_CLOEXEC), stop_fd = eventfd(0, EFD_CLOEXEC);
  const struct lod_watch watch = {.spawn = {.path = jobs->worker_path,
                                            .input_fd = input_fd,
                                            .output_fd = output_fd,
                                            .memory_limit_bytes = jobs->settings.memory_limit_bytes,
                                            .cpu_limit_seconds = 10,
                                            .niceness = LOD_NICE_ANSWER},
                                  .job = kJob,
                                  .job_size = sizeof kJob - 1,
                                  .deadline_seconds = 10,
                                  .output_limit_bytes = 1 << 20,
                                  .stop_fd = stop_fd};
  if (input_fd >= 0 && stop_fd >= 0) {
    lod_watch_run(&watch, result);
  } else {
    result->end = LOD_WATCH_FAILED;
    (void)lod_fail_errno(&result->problem, "A worker cannot be tried");
  }
  if (input_fd >= 0)
    close(input_fd);
  if (stop_fd >= 0)
    close(stop_fd);
}

/* What the worker wrote (its jail's warnings among it) is logged once, and again when it differs. */
static void log_trial(struct lod_jobs *jobs, const struct lod_watch_result *result) {
  struct lod_trial *trial = &jobs->trial;
  uint64_t sum = 14695981039346656037u; /* FNV-1a */
  for (const char *p = result->log; *p != 0; p++)
    sum = (sum ^ (unsigned char)*p) * 1099511628211u;
  if (sum != trial->log_sum && result->log[0] != 0)
    lod_jobs_say(jobs, "a worker was tried; it wrote: %s", result->log);
  trial->log_sum = sum;
}

static void make_trial(struct lod_jobs *jobs) {
  static const char kName[] = "trial";
  struct lod_trial *trial = &jobs->trial;
  struct lod_watch_result result = {.end = LOD_WATCH_FAILED};
  lod_remove_tree(jobs->work_fd, kName);
  int output_fd =
      mkdirat(jobs->work_fd, kName, 0700) == 0 ? openat(jobs->work_fd, kName, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW) : -1;
  if (output_fd < 0)
    (void)lod_fail_errno(&result.problem, "A folder for the worker cannot be made");
  else
    try_worker(jobs, output_fd, &result);
  if (output_fd >= 0)
    close(output_fd);
  lod_remove_tree(jobs->work_fd, kName);
  log_trial(jobs, &result);
  trial->problem = result.end == LOD_WATCH_DONE ? (struct lod_problem){0} : result.problem;
  trial->time = lod_jobs_monotonic_seconds();
}

bool lod_jobs_ready(struct lod_jobs *jobs, struct lod_problem *problem) {
  if (!moves(jobs, problem))
    return false;
  struct lod_trial *trial = &jobs->trial;
  pthread_mutex_lock(&trial->mutex);
  double age = lod_jobs_monotonic_seconds() - trial->time;
  if (trial->time == 0 || age > (trial->problem.status == LOD_OK ? kGoodSeconds : kBadSeconds))
    make_trial(jobs);
  *problem = trial->problem;
  pthread_mutex_unlock(&trial->mutex);
  return problem->status == LOD_OK;
}
