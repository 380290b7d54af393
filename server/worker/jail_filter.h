/* The seccomp filter of the jail: the system calls that a bake needs, and nothing else. Inside server/worker. */
#ifndef LOD_SERVER_WORKER_JAIL_FILTER_H
#define LOD_SERVER_WORKER_JAIL_FILTER_H

#include <stdbool.h>
#include <stddef.h>

/* Loads the filter for all threads, for good. no_new_privs must be set. False: `why` says what failed. */
bool lod_jail_filter_load(char *why, size_t size);

#endif
