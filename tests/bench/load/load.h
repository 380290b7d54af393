/* An HTTP client for benches: many connections in one thread, each asking again as soon as its answer is whole. Bodies are copied out of
 * the kernel and thrown away. Latencies go into a histogram of 64 steps an octave (1 % wide). */
#ifndef LOD_TESTS_BENCH_LOAD_H
#define LOD_TESTS_BENCH_LOAD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { LOAD_STEPS = 64, LOAD_OCTAVES = 36, LOAD_BUCKETS = LOAD_STEPS * LOAD_OCTAVES };

/* Connections that all ask the same. */
struct load_group {
  uint16_t port;       /* on 127.0.0.1 */
  bool tls;            /* certificates are not checked */
  bool reconnect;      /* a new connection for each request */
  const char *request; /* whole text */
  unsigned status;     /* that every answer must have */
  int connections;
  int silent;           /* further connections that ask once and then stay; not measured */
  double pause_seconds; /* between an answer and the next question of a connection */

  /* what came out */
  uint64_t answers, bytes, errors;
  uint64_t histogram[LOAD_BUCKETS];
};

/* Runs all groups side by side for so long, after a warm-up that ends when every connection has had an answer, or after two seconds.
 * started: called (unless NULL) when the measuring begins. Returns the CPU seconds of this thread meanwhile. *seconds: how long it took. A
 * connection that cannot be made, an answer of another status or one cut short is counted in errors; its connection is made anew. */
double load_run(struct load_group *groups, int count, double *seconds, void (*started)(void *context), void *context);

/* Latency in seconds below which a share (0.99) of the answers came. */
double load_quantile(const struct load_group *group, double share);

double load_now(void);

#endif
