/* Bakes that shall not be: of a model that is deleted, and later families of one that was uploaded anew.
 *
 * A delete must not end an acknowledged upload and then not delete: should the daemon die in between, an older revision would be back for
 * good. So its jobs are only held at first; their rows end in the transaction that deletes the model. */
#include <string.h>

#include "server/jobs/queue.h"

void lod_jobs_explain_cancel(struct lod_problem *problem, int why) {
  static const char *const kTexts[] = {[DELETED] = "The model was deleted before its bake had ended.",
                                       [SUPERSEDED] = "The model was uploaded anew before this bake had ended.",
                                       [UNWANTED] = "The server was started anew and adds no later families any more."};
  (void)lod_fail(problem, LOD_CANCELLED, why == SUPERSEDED ? "superseded" : "cancelled", "%s", kTexts[why]);
}

/* A waiting job ends. The mutex is held. */
static void end_waiting(struct lod_jobs *jobs, struct job *job, double time) {
  lod_jobs_explain_cancel(&job->facts.problem, job->cancelled);
  job->facts.state = LOD_JOB_FAILED;
  job->facts.finished = time;
  jobs->counts.queued--;
  jobs->counts.failed++;
  jobs->ended++;
}

void lod_jobs_supersede(struct lod_jobs *jobs, const char *id) {
  uint64_t number = 0;
  pthread_mutex_lock(&jobs->mutex);
  for (struct job *job; !jobs->stopping && (job = lod_jobs_next_open(jobs, id, number)) != NULL;) {
    number = job->facts.number + 1;
    if (!job->later || job->cancelled != NOT_CANCELLED)
      continue;
    job->cancelled = SUPERSEDED;
    if (job->facts.state == LOD_JOB_RUNNING) {
      lod_jobs_wake(job->runner);
      continue;
    }
    uint64_t ended = job->facts.number;
    end_waiting(jobs, job, lod_jobs_wall_seconds());
    (void)lod_jobs_write_row(jobs, job, NULL);
    lod_jobs_remove_files(jobs, ended);
    pthread_mutex_unlock(&jobs->mutex);
    lod_jobs_tell(jobs, ended);
    pthread_mutex_lock(&jobs->mutex);
  }
  pthread_mutex_unlock(&jobs->mutex);
}

/* Marks all open jobs of the model and waits until none of them runs: those that had not ended by themselves wait again, and do not start.
 * Returns the number of the last of them; 0 = there is none. */
static uint64_t hold_jobs(struct lod_jobs *jobs, const char *id) {
  uint64_t last = 0;
  pthread_mutex_lock(&jobs->mutex);
  for (bool running = true; running;) {
    running = false;
    last = 0;
    struct job *job;
    for (uint64_t number = 0; (job = lod_jobs_next_open(jobs, id, number)) != NULL; number = last + 1) {
      last = job->facts.number;
      job->cancelled = DELETED;
      if (job->facts.state == LOD_JOB_RUNNING) {
        running = true;
        lod_jobs_wake(job->runner);
      }
    }
    if (running)
      pthread_cond_wait(&jobs->changed, &jobs->mutex);
  }
  pthread_mutex_unlock(&jobs->mutex);
  return last;
}

/* The rows of held jobs have ended, or, with `deleted` false, the jobs go on. */
static void release_jobs(struct lod_jobs *jobs, const char *id, uint64_t last, bool deleted, double time) {
  struct job *job;
  uint64_t number = 0;
  pthread_mutex_lock(&jobs->mutex);
  while ((job = lod_jobs_next_open(jobs, id, number)) != NULL && job->facts.number <= last) {
    number = job->facts.number;
    if (deleted) {
      end_waiting(jobs, job, time);
      lod_jobs_remove_files(jobs, number);
    } else {
      job->cancelled = NOT_CANCELLED;
    }
    pthread_mutex_unlock(&jobs->mutex);
    lod_jobs_tell(jobs, number);
    pthread_mutex_lock(&jobs->mutex);
    number++;
  }
  pthread_cond_broadcast(&jobs->changed);
  pthread_mutex_unlock(&jobs->mutex);
}

enum lod_status lod_jobs_delete_model(struct lod_jobs *jobs, const char *id, bool *existed, struct lod_problem *problem) {
  struct lod_problem why = {0};
  lod_jobs_explain_cancel(&why, DELETED);
  pthread_mutex_lock(&jobs->erase);
  uint64_t last = hold_jobs(jobs, id);
  const struct lod_catalog_ending ending = {.last = last,
                                            .open_states = LOD_JOB_DONE, /* queued and running come before it */
                                            .state = LOD_JOB_FAILED,
                                            .finished = lod_jobs_wall_seconds(),
                                            .problem = &why};
  enum lod_status status = lod_store_model_delete(jobs->settings.store, id, last == 0 ? NULL : &ending, existed, problem);
  *existed = *existed || last != 0;
  if (last != 0)
    release_jobs(jobs, id, last, status == LOD_OK, ending.finished);
  pthread_mutex_unlock(&jobs->erase);
  return status;
}
