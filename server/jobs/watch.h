/* A bake in its process, from the job frame to what became of it. Inside server/jobs. */
#ifndef LOD_SERVER_JOBS_WATCH_H
#define LOD_SERVER_JOBS_WATCH_H

#include "server/jobs/spawn.h"

struct lod_watch {
  struct lod_spawn_settings spawn;
  const char *job; /* payload of the 'J' frame */
  size_t job_size;
  double deadline_seconds;
  uint64_t output_limit_bytes; /* of all files beneath spawn.output_fd together */
  int stop_fd;                 /* readable: stop the worker */
  void (*progress)(void *context, const char *stage, double fraction);
  void *context;
};

enum lod_watch_end {
  LOD_WATCH_DONE,    /* it said so; the folder awaits lod_store_commit_bake */
  LOD_WATCH_FAILED,  /* it said why */
  LOD_WATCH_CRASHED, /* it ended, or talked nonsense, without an answer */
  LOD_WATCH_KILLED,  /* by a limit of time, processor time or output */
  LOD_WATCH_STOPPED, /* by stop_fd */
};

enum { LOD_WATCH_LOG_BYTES = 4096 };

struct lod_watch_result {
  enum lod_watch_end end;
  struct lod_problem problem;        /* of FAILED, CRASHED and KILLED */
  char log[LOD_WATCH_LOG_BYTES + 1]; /* the last of what it wrote to standard output and error; printable, lines ended by \n */
};

/* Blocks until the worker has ended; no process and no descriptor is left. */
void lod_watch_run(const struct lod_watch *watch, struct lod_watch_result *result);

#endif
