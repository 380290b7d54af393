#include "core/base/status.h"

#include <stdarg.h>
#include <stdio.h>

enum lod_status lod_fail(struct lod_problem *problem, enum lod_status status, const char *type, const char *format, ...) {
  if (problem == NULL || problem->status != LOD_OK)
    return status;
  problem->status = status;
  snprintf(problem->type, sizeof problem->type, "%s", type);
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(problem->detail, sizeof problem->detail, format, arguments);
  va_end(arguments);
  return status;
}

enum lod_status lod_fail_memory(struct lod_problem *problem) {
  return lod_fail(problem, LOD_MEMORY, "out-of-memory",
                  "The job needs more memory than it may use. Raise the memory limit or send a smaller model.");
}

const char *lod_status_name(enum lod_status status) {
  static const char *const kNames[] = {"ok", "bad-input", "unsupported", "limit", "memory", "io", "cancelled"};
  return (unsigned)status < sizeof kNames / sizeof kNames[0] ? kNames[status] : "unknown";
}
