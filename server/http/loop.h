/* What http.c and loop.c share: connections, loops, and who calls whom. Inside these two files, which alone include microhttpd.h. */
#ifndef LOD_SERVER_HTTP_LOOP_H
#define LOD_SERVER_HTTP_LOOP_H

#include <microhttpd.h>
#include <pthread.h>
#include <stdint.h>
#include <sys/socket.h>

#include "server/http/background.h"
#include "server/http/cache.h"
#include "server/http/deadline.h"
#include "server/http/http.h"
#include "server/http/interpose.h"
#include "server/http/linger.h"
#include "server/http/routes.h"
#include "server/http/socket.h"

enum watch { WATCH_OWN, WATCH_WAKE, WATCH_PEER, WATCH_LINGER };
enum { EVENTS = 64 };

struct connection {
  enum watch watch; /* WATCH_PEER; first, so that an epoll event finds it */
  struct loop *loop;
  struct MHD_Connection *mhd;
  int fd;
  struct lod_address *address;
  struct connection *previous, *next;
  struct connection *previous_stream, *next_stream; /* while `streaming` */
  struct lod_deadline deadline;
  enum lod_cut cut;
  bool linger; /* read on for a while after the close: the peer may still be sending */

  /* of the request in progress */
  bool active, begun, answered, working, work_done, waiting, gone, watched, streaming, bulk;
  char *target, *parsed; /* as received, for the log; and the copy that exchange.target points into */
  size_t target_capacity;
  char method[12], request_id[LOD_REQUEST_ID_MAX + 1];
  struct lod_cache_entry *memo; /* the reply as it was given before */
  struct lod_sending sending;
  double started;
  uint64_t ignored, sent;
  unsigned status;
  struct lod_background_work work;
  struct connection *next_done;
  struct lod_exchange exchange;
};

/* A socket that another loop has accepted. */
struct guest {
  int fd;
  struct sockaddr_storage address;
  socklen_t size;
};
enum { GUESTS = 256, LOOPS_MAX = 256 };

struct loop {
  struct lod_http *http;
  struct MHD_Daemon *daemon;
  pthread_t thread;
  bool started;
  int epoll_fd, wake_fd, listener; /* listener: MHD's; -1 = none */
  /* We wait on libmicrohttpd's epoll descriptor, where ours is one of those watched, and hand its events over when it asks. */
  int mhd_fd;
  enum watch watch_own, watch_wake;
  struct epoll_event events[EVENTS];
  int event_count;
  bool fetched; /* there is nothing to ask the kernel for */
  struct lod_linger *linger;
  struct lod_interpose hooks;
  struct connection *connections, *streams;
  struct connection *sweep_at; /* next in the sweep; NULL: it is over */
  struct connection **by_fd;   /* of `fd_count` */
  int fd_count;
  _Atomic uint32_t count;
  uint32_t bulk;  /* connections with `bulk` */
  uint32_t share; /* of the limit of connections */
  double now, next_slice, saturated;
  _Atomic double beat;          /* `now` for others: whether this loop still turns */
  pthread_mutex_t lock;         /* guards the next three */
  struct connection *done;      /* whose background work has ended */
  struct guest guests[GUESTS];  /* in the order in which they came */
  _Atomic uint32_t guest_count; /* changed under the lock */
};

struct lod_http {
  struct lod_service *service;
  struct lod_cache *responses, *memos;
  struct lod_addresses *addresses;
  struct lod_background *background;
  char url[LOD_ADDRESS_TEXT_MAX + 16];
  bool tls;
  size_t memory_bytes;        /* of the machine */
  _Atomic double drain_until; /* 0 = not draining */
  uint32_t loop_count;
  struct loop *loops;
};

/* http.c: what libmicrohttpd calls for each request. */
void *lod_request_begin(void *context, const char *uri, struct MHD_Connection *mhd);
enum MHD_Result lod_request_handle(void *context, struct MHD_Connection *mhd, const char *url, const char *method, const char *version,
                                   const char *bytes, size_t *size, void **request_context);
void lod_request_end(void *context, struct MHD_Connection *mhd, void **request_context, enum MHD_RequestTerminationCode code);

/* loop.c. */
double lod_loop_clock(void); /* seconds */
void lod_loop_wake(struct loop *loop);
/* The connection's reply is a stream: it is resumed when there may be news. */
void lod_loop_add_stream(struct connection *connection);
/* Whether the connection is one of those that pull large bodies: their bytes are in its buffers, also after the request is over for us. */
void lod_loop_set_bulk(struct connection *connection, bool bulk);
/* The request is over. */
void lod_loop_forget_stream(struct connection *connection);
const char *lod_loop_peer(const struct connection *connection, char text[LOD_ADDRESS_TEXT_MAX]);

#endif
