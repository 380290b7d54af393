/* One worker process: started with nothing but what it needs, and ended without a trace. Inside server/jobs. */
#ifndef LOD_SERVER_JOBS_SPAWN_H
#define LOD_SERVER_JOBS_SPAWN_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

#include "core/base/status.h"

/* Answering goes before baking, and models that nobody can see yet before those that are served. */
enum { LOD_NICE_ANSWER = 0, LOD_NICE_BAKE = 10, LOD_NICE_LATER_BAKE = 19 };

struct lod_spawn_settings {
  const char *path;            /* the `lodestream` program; started as `path worker` */
  int input_fd, output_fd;     /* become descriptors 4 and 5; not owned */
  uint64_t memory_limit_bytes; /* RLIMIT_DATA and, with room for mapped files, RLIMIT_AS; also the largest file it may write */
  uint64_t cpu_limit_seconds;  /* of all its threads together */
  int niceness;                /* one of the below: what waits for whom */
};

struct lod_process {
  pid_t pid;
  int pid_fd;    /* readable when it has ended; -1 where the kernel has no such thing */
  int socket_fd; /* our end of descriptor 3; blocking */
  int log_fd;    /* what it writes to standard output and error; non-blocking */
};

/* The child has its own process group, an empty signal mask, its limits, descriptors 0 to 5 and a fresh environment before the program
 * starts; it dies with the calling thread. LOD_IO "worker-missing" when the program cannot be started. */
LOD_WARN_UNUSED enum lod_status lod_process_spawn(const struct lod_spawn_settings *settings, struct lod_process *process,
                                                  struct lod_problem *problem);
/* True once the leader has ended; does not reap it. */
bool lod_process_has_ended(const struct lod_process *process);

struct lod_process_end {
  int signal; /* 0: it left by itself */
  int code;   /* exit status, when signal == 0 */
};
/* Kills what is left of the group, waits for the leader, closes all descriptors. */
struct lod_process_end lod_process_finish(struct lod_process *process);

#endif
