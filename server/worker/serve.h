/* The worker process: one job over the socket it was born with (server/jobs/frame.h), then the end. */
#ifndef LOD_SERVER_WORKER_SERVE_H
#define LOD_SERVER_WORKER_SERVE_H

/* Jails itself, reads the job, runs it, answers. Returns the process's exit status: 0 when the answer was sent, whatever it says. */
int lod_worker_serve(void);

#endif
