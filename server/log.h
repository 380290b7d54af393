/* The daemon's log: one line an event to stderr, as text or JSON. Any thread may write; a line is one write(2). */
#ifndef LOD_SERVER_LOG_H
#define LOD_SERVER_LOG_H

#include <stdbool.h>
#include <stdint.h>

enum lod_log_level { LOD_LOG_DEBUG, LOD_LOG_INFO, LOD_LOG_WARN, LOD_LOG_ERROR, LOD_LOG_OFF };

/* Lines below `level` are dropped. To be called before any thread is started; text and "info" before that. */
void lod_log_open(bool json, enum lod_log_level level);
/* False for an unknown name. */
bool lod_log_level_parse(const char *name, enum lod_log_level *level);
bool lod_log_enabled(enum lod_log_level level);
/* Any thread, any time. */
void lod_log_set_level(enum lod_log_level level);

__attribute__((format(printf, 2, 3))) void lod_log(enum lod_log_level level, const char *format, ...);

/* A finished request: level info, or warn when `note` says that it was cut. */
struct lod_log_request {
  const char *method, *target; /* as received; bytes that could harm a terminal are escaped */
  const char *peer;            /* address and port */
  const char *id;              /* of the request; "" = none */
  unsigned status;             /* 0 = never answered */
  uint64_t bytes;              /* of the body sent */
  double seconds;              /* from the request line to the last byte handed to the kernel */
  const char *note;            /* NULL, or why it ended early */
};
void lod_log_write_request(const struct lod_log_request *request);

/* Who tried to change what, and what came of it: level info, written also when requests are not (unless the level is above). */
struct lod_log_audit {
  const char *action; /* "PUT", "DELETE" */
  const char *model;
  const char *token; /* its name; "" = none was needed, or it was not a good one */
  const char *peer, *id;
  unsigned status;
};
void lod_log_write_audit(const struct lod_log_audit *audit);

#endif
