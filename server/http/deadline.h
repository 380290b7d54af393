/* When a connection has had its time. libmicrohttpd's own timeout counts inactivity only, so one byte a second keeps a connection for ever;
 * here headers have a deadline, bodies a least rate both ways, and an idle connection a limit. Pure: time and byte counts are parameters.
 */
#ifndef LOD_SERVER_HTTP_DEADLINE_H
#define LOD_SERVER_HTTP_DEADLINE_H

#include <stdbool.h>
#include <stdint.h>

enum lod_phase {
  LOD_PHASE_WAIT,    /* for the next request */
  LOD_PHASE_HEADERS, /* the request line was read */
  LOD_PHASE_RECEIVE, /* a body */
  LOD_PHASE_WORK,    /* on us: no deadline */
  LOD_PHASE_SEND,
};

enum lod_cut {
  LOD_CUT_NO,
  LOD_CUT_HEADERS,
  LOD_CUT_IDLE,
  LOD_CUT_SLOW_SENDER,
  LOD_CUT_SLOW_READER,
  LOD_CUT_ADDRESS,
  LOD_CUT_OVERLOAD,
  LOD_CUT_COUNT
};

struct lod_deadline_limits {
  double header_seconds; /* from the first byte of a request to the end of its headers */
  double idle_seconds;   /* between requests */
  double rate_seconds;   /* bodies are judged over this long */
  double rate_bytes;     /* least bytes a second on average in it */
};

struct lod_deadline {
  enum lod_phase phase;
  double since;      /* when the phase began */
  double first_byte; /* of the request being waited for; 0 = not seen */
  double window;     /* when the present rate window began; 0 = at the next check */
  uint64_t base;     /* bytes at the beginning of the wait or window */
  bool base_known;
};

/* Seconds; now > 0. An accepted connection waits with no byte received. */
void lod_deadline_accept(struct lod_deadline *deadline, double now);
void lod_deadline_enter(struct lod_deadline *deadline, enum lod_phase phase, double now);
/* To be asked about once a second. received, acknowledged: bytes that came from the peer and that it has acknowledged, since it connected.
 */
enum lod_cut lod_deadline_check(struct lod_deadline *deadline, const struct lod_deadline_limits *limits, uint64_t received,
                                uint64_t acknowledged, double now);
/* "headers", "idle", ...: the label of metrics and log. */
const char *lod_cut_name(enum lod_cut cut);

#endif
