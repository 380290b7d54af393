/* Bakes: a durable queue, one worker process a job, deadlines, and what became of each.
 *
 * A job that was acknowledged survives a restart: its upload and its row are synced before lod_jobs_submit returns, and a job that was
 * queued or running when the daemon died runs again (at most 3 times). A job that adds later families waits until no other does, and ends
 * with the problem "superseded" when its model is uploaded anew. */
#ifndef LOD_SERVER_JOBS_JOBS_H
#define LOD_SERVER_JOBS_JOBS_H

#include "server/jobs/stages.h"
#include "server/store/store.h"

struct lod_jobs;

enum lod_job_state { LOD_JOB_QUEUED, LOD_JOB_RUNNING, LOD_JOB_DONE, LOD_JOB_FAILED };

struct lod_jobs_settings {
  struct lod_store *store; /* not owned */
  const char *worker_path; /* the `lodestream` program */
  /* Bakes at once; default 1. With later families one more first bake may run beside them: an upload does not wait minutes for what another
   * model gets later. */
  uint32_t workers;
  uint32_t threads;            /* per worker; 0 = as many as the machine has */
  uint32_t queue_limit;        /* waiting jobs; more are refused with LOD_LIMIT "queue-full"; default 64 */
  uint32_t deadline_seconds;   /* of one bake; default 600 */
  uint64_t memory_limit_bytes; /* of one worker; default 8 GiB */
  uint64_t upload_limit_bytes; /* default 1 GiB; checked by http while the body arrives */
  const char *families;        /* to bake, separated by commas; NULL or "" = the worker's default */
  /* Families that are baked, with the first ones, by a second job once the model is served: uploads are there in seconds, and what needs
   * minutes comes after. NULL or "" = none; else `families` must be set. */
  const char *later_families;
  const char *envelope;    /* options of that family, "key=value" separated by commas; NULL or "" = none. The worker knows them */
  const char *limits_json; /* import limits object for the 'J' frame, or NULL = defaults */
  void (*changed)(void *context, uint64_t job); /* called from any thread whenever a job's state, stage or progress changes */
  void *context;
  void (*log)(void *context, const char *line); /* a line for the operator's log, from any thread; NULL = standard error */
  uint32_t kept_jobs;                           /* ended jobs that lod_jobs_find still knows; default 1000 */
};
struct lod_jobs_settings lod_jobs_defaults(void);

LOD_WARN_UNUSED enum lod_status lod_jobs_create(const struct lod_jobs_settings *settings, struct lod_jobs **jobs,
                                                struct lod_problem *problem);
/* Kills running workers (their jobs run again at the next start) and joins all threads. */
void lod_jobs_destroy(struct lod_jobs *jobs);

/* An unnamed file in the store for an upload's body; the caller writes to it and passes it to submit or closes it. */
LOD_WARN_UNUSED enum lod_status lod_jobs_upload_create(struct lod_jobs *jobs, int *fd, struct lod_problem *problem);
/* Queues a bake of the whole upload. Takes fd in any case. name: file name for messages; format: NULL = sniff. */
LOD_WARN_UNUSED enum lod_status lod_jobs_submit(struct lod_jobs *jobs, const char *id, const char *name, const char *format, int fd,
                                                uint64_t *job, struct lod_problem *problem);

struct lod_job {
  uint64_t number;
  char id[LOD_MODEL_ID_MAX + 1];
  enum lod_job_state state;
  char stage[32];
  double progress;
  struct lod_problem problem; /* status LOD_OK unless failed */
  double created, finished;   /* seconds since 1970 */
  uint64_t next;              /* of a job that is done: the one that adds the later families; 0 = none, or not known any more */
};
/* Deletes the model from the store and ends its open jobs with the problem "cancelled", both or neither, also when the daemon dies
 * meanwhile: what was uploaded before a delete does not come back after it. *existed: whether there was a model or such a job. Waits for a
 * running worker to be killed. */
LOD_WARN_UNUSED enum lod_status lod_jobs_delete_model(struct lod_jobs *jobs, const char *id, bool *existed, struct lod_problem *problem);

/* False when there is no such job (or it ended long ago: the last kept_jobs are kept). */
bool lod_jobs_find(struct lod_jobs *jobs, uint64_t number, struct lod_job *job);

/* Whether a bake that came now would be done: a worker enters its jail and answers (tried, at most once a minute), and what waits or runs
 * moves. For /readyz; blocks while a worker is tried. problem: "queue-stuck", "jail-...", "worker-..." */
bool lod_jobs_ready(struct lod_jobs *jobs, struct lod_problem *problem);

struct lod_jobs_counts {
  uint64_t queued, running, done, failed;                 /* now, now, since start, since start */
  uint64_t queued_later, running_later;                   /* of these: those that add later families */
  uint64_t workers_crashed, workers_killed, retried;      /* since start: by signal, by deadline or limit, after a restart */
  uint64_t workers_done, workers_failed, workers_stopped; /* since start: said so, said why not, by us (a delete, a stop) */
  double bake_seconds;                                    /* since start, of finished jobs */
  double first_wait_seconds, later_wait_seconds;          /* since start, of jobs that began: how long they waited for a worker */
  struct lod_stages stages;
};
struct lod_jobs_counts lod_jobs_counts(struct lod_jobs *jobs);

#endif
