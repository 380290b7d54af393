/* The cage of a worker, entered before it reads a byte of input.
 *
 * In this order: every descriptor but 0 to 5 is closed; limits; a user, network and IPC namespace of its own; the output folder as its
 * root; no capabilities; no_new_privs; Landlock (nothing may be opened but beneath the output folder); a seccomp allow-list (no new
 * program, process, socket or executable page; signals to itself only). Then it reads back what it dropped and tries what must fail.
 * Descriptors, limits, capabilities, no_new_privs and seccomp are required: where one fails, so does lod_jail_enter. The others are used
 * where the kernel has them; what is missing is named on standard error and in the report. No privileges are needed. */
#ifndef LOD_SERVER_WORKER_JAIL_H
#define LOD_SERVER_WORKER_JAIL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct lod_jail_settings {
  const char *strategy; /* "auto": as above; "none": nothing, with a loud warning. NULL: the environment's LODESTREAM_JAIL, else "auto" */
  /* 0: the limit stays as whoever started us has set it. Limits are only ever lowered. */
  uint64_t max_memory_bytes;
  uint64_t max_cpu_seconds;
  uint64_t max_file_bytes; /* of one file */
};
struct lod_jail_settings lod_jail_defaults(void);

enum lod_jail_state {
  LOD_JAIL_OFF,         /* not tried: strategy "none" */
  LOD_JAIL_ACTIVE,      /* done and read back */
  LOD_JAIL_UNAVAILABLE, /* this kernel or container does not allow it */
};
struct lod_jail_step {
  const char *name; /* "descriptors", "limits", "namespaces", "root", "capabilities", "no-new-privileges", "landlock", "seccomp" */
  bool required;
  enum lod_jail_state state;
  char detail[80]; /* what it does here, or why not */
};
enum { LOD_JAIL_STEPS = 8 };
struct lod_jail_report {
  const char *strategy;
  struct lod_jail_step steps[LOD_JAIL_STEPS];
};

/* For the calling process, for good. Must be called while it has one thread, with the worker's descriptors in place (frame.h).
 * LOD_UNSUPPORTED "jail-STEP" when a required step fails; LOD_BAD_INPUT "jail-strategy" for an unknown strategy. The report is filled
 * in any case; may be NULL. */
LOD_WARN_UNUSED enum lod_status lod_jail_enter(const struct lod_jail_settings *settings, struct lod_jail_report *report,
                                               struct lod_problem *problem);

/* {"strategy":"auto","steps":{"seccomp":{"state":"active","required":true,"detail":".."},..}}; returns the length, cut to size - 1. */
size_t lod_jail_report_json(const struct lod_jail_report *report, char *text, size_t size);

#endif
