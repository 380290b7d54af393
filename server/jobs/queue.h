/* Inside of server/jobs: what list.c (the jobs and their rows), queue.c (submit, start, stop), ready.c, run.c (a thread that bakes one job
 * after another) and cancel.c share. */
#ifndef LOD_SERVER_JOBS_QUEUE_H
#define LOD_SERVER_JOBS_QUEUE_H

#include <pthread.h>

#include <jansson.h>

#include "server/jobs/jobs.h"
#include "server/store/catalog.h"

enum { MAX_ATTEMPTS = 3, MAX_WORKERS = 64 };

struct job {
  struct lod_job facts;
  char *name, *format; /* format may be NULL */
  uint32_t attempts;
  double queued, started, stage_began; /* monotonic */
  bool later;                          /* adds the later families to a model that is served */
  enum { NOT_CANCELLED, DELETED, SUPERSEDED, UNWANTED } cancelled;
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

/* The last time that a worker was tried, to see whether bakes can be. */
struct lod_trial {
  pthread_mutex_t mutex;
  double time; /* monotonic; 0 = never */
  struct lod_problem problem;
  uint64_t log_sum;
};

struct lod_jobs {
  struct lod_jobs_settings settings;
  char *worker_path;
  json_t *limits;                    /* or NULL */
  json_t *families, *later_families; /* names: of a first bake, of a later one (the first's among them); later NULL = none */
  struct lod_catalog *catalog;
  int uploads_fd, work_fd;
  pthread_mutex_t erase;  /* one delete at a time; taken before all others */
  pthread_mutex_t submit; /* one new job at a time; taken before `mutex` */
  pthread_mutex_t mutex;  /* guards all below */
  pthread_cond_t changed; /* something to run, or something ended */
  struct job **list;      /* number order */
  size_t count, capacity, ended;
  uint64_t last_number;
  struct lod_jobs_counts counts;
  double moved; /* monotonic: when a job began or ended last, or came when there was none */
  bool stopping;
  struct runner runners[MAX_WORKERS + 1];
  uint32_t runner_count, bakes; /* bakes: at once; a runner is spare, for first bakes, where there are later ones */
  struct lod_trial trial;       /* with a lock of its own */
};

/* ---- list.c ---- */

double lod_jobs_wall_seconds(void);
double lod_jobs_monotonic_seconds(void);

struct lod_number_name {
  char text[24];
};
/* The name of a job's upload and of its folder in work/. */
struct lod_number_name lod_jobs_name(uint64_t number);

/* Tells `changed`; not with the mutex held. */
void lod_jobs_tell(struct lod_jobs *jobs, uint64_t number);
__attribute__((format(printf, 2, 3))) void lod_jobs_say(struct lod_jobs *jobs, const char *format, ...);

bool lod_jobs_has_ended(const struct job *job);
struct job *lod_jobs_create_job(uint64_t number, const char *id, const char *name, const char *format);
void lod_jobs_free_job(struct job *job);

/* Room for one more job. Only new jobs (one at a time) and the start append. */
bool lod_jobs_reserve(struct lod_jobs *jobs);
void lod_jobs_append(struct lod_jobs *jobs, struct job *job);
/* The next three with the mutex held. NULL: none. */
struct job *lod_jobs_find_job(const struct lod_jobs *jobs, uint64_t number);
/* The first job of the model from `from` on that has not ended. */
struct job *lod_jobs_next_open(const struct lod_jobs *jobs, const char *id, uint64_t from);
/* Jobs that wait and are, or are not, to add later families. */
size_t lod_jobs_count_waiting(const struct lod_jobs *jobs, bool later);

/* Forgets jobs that ended long ago. A row that cannot be deleted now is met again at the next start. */
void lod_jobs_prune(struct lod_jobs *jobs);
/* Not with the mutex held, if it can be helped: it waits for the disk, and lod_jobs_find must not. Whoever runs a job may read it. */
enum lod_status lod_jobs_write_row(struct lod_jobs *jobs, const struct job *job, struct lod_problem *problem);
void lod_jobs_remove_files(struct lod_jobs *jobs, uint64_t number);

/* ---- queue.c ---- */

/* A job that bakes the file behind fd. `submit` is held. */
LOD_WARN_UNUSED enum lod_status lod_jobs_add(struct lod_jobs *jobs, const char *id, const char *name, const char *format, bool later,
                                             int fd, uint64_t *number, struct lod_problem *problem);

/* ---- run.c ---- */

/* The thread of a runner. */
void *lod_jobs_run(void *runner);
/* Stops what it runs. */
void lod_jobs_wake(const struct runner *runner);

/* ---- cancel.c ---- */

/* Ends those of the model's open jobs that add later families: it was uploaded anew. */
void lod_jobs_supersede(struct lod_jobs *jobs, const char *id);
/* The problem of a job that was cancelled. */
void lod_jobs_explain_cancel(struct lod_problem *problem, int why);

#endif
