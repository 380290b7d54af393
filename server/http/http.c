/* Event loops over libmicrohttpd 0.9.75 in external epoll mode. */
#include "server/http/http.h"

#include <errno.h>
#include <fcntl.h>
#include <gnutls/gnutls.h>
#include <microhttpd.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include "server/http/background.h"
#include "server/http/deadline.h"
#include "server/http/linger.h"
#include "server/http/socket.h"
#include "server/log.h"

enum {
  POOL_BYTES = 16 << 10, /* MHD clears the whole pool after each request; 16 KiB suits browsers' headers */
  STREAM_BYTES = 4 << 10,
  IGNORED_BODY_MAX = 1 << 20,
  SWEEP_MS = 1000,
  DRAIN_SWEEP_MS = 20,
  RESPONSE_HEADERS = 32,
  HEADER_TEXT_MAX = 4096,
};

enum watch { WATCH_MHD, WATCH_WAKE, WATCH_PEER, WATCH_LINGER };

struct connection {
  enum watch watch; /* WATCH_PEER; first, so that an epoll event finds it */
  struct loop *loop;
  struct MHD_Connection *mhd;
  int fd;
  char peer[LOD_ADDRESS_TEXT_MAX];
  struct connection *previous, *next;
  struct lod_deadline deadline;
  enum lod_cut cut;
  bool linger; /* read on for a while after the close: the peer may still be sending */

  /* of the request in progress */
  bool active, begun, answered, working, work_done, waiting, gone, watched;
  char *target, *parsed; /* as received, for the log; and the copy that exchange.target points into */
  size_t target_capacity;
  char method[12];
  double started;
  uint64_t ignored, sent;
  unsigned status;
  struct lod_exchange exchange;
  struct lod_background_work work;
  struct connection *next_done;
};

struct loop {
  struct lod_http *http;
  struct MHD_Daemon *daemon;
  pthread_t thread;
  bool started;
  int epoll_fd, wake_fd;
  enum watch watch_mhd, watch_wake;
  struct lod_linger *linger;
  struct connection *connections;
  uint32_t count;
  double now, next_sweep;
  pthread_mutex_t done_lock;
  struct connection *done; /* whose background work has ended */
};

struct lod_http {
  struct lod_service *service;
  struct lod_deadline_limits limits;
  struct lod_cache *responses;
  struct lod_background *background;
  char url[LOD_ADDRESS_TEXT_MAX + 16];
  _Atomic double drain_until; /* 0 = not draining */
  uint32_t loop_count;
  struct loop *loops;
};

static double monotonic(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void wake(struct loop *loop) {
  uint64_t one = 1;
  ssize_t ignored = write(loop->wake_fd, &one, sizeof one); /* full means awake already */
  (void)ignored;
}

/* ---- responses ---- */

struct headers {
  struct {
    const char *name, *value;
  } list[RESPONSE_HEADERS];
  uint32_t count;
  char text[HEADER_TEXT_MAX]; /* all of them: what makes two responses of the same body the same */
  size_t size;
};

static void emit_header(void *context, const char *name, const char *value) {
  struct headers *headers = context;
  if (headers->count == RESPONSE_HEADERS)
    return;
  headers->list[headers->count].name = name;
  headers->list[headers->count++].value = value;
  size_t name_size = strlen(name) + 1, value_size = strlen(value) + 1;
  if (name_size + value_size <= sizeof headers->text - headers->size) {
    memcpy(headers->text + headers->size, name, name_size);
    memcpy(headers->text + headers->size + name_size, value, value_size);
    headers->size += name_size + value_size;
  }
}

static void release_body(void *body) {
  lod_body_release(body);
}
static void destroy_response(void *response) {
  MHD_destroy_response(response);
}

static ssize_t read_stream(void *context, uint64_t position, char *buffer, size_t size) {
  struct connection *connection = context;
  struct lod_stream *stream = &connection->exchange.reply.stream;
  (void)position;
  if (connection->gone)
    return MHD_CONTENT_READER_END_WITH_ERROR;
  ssize_t count = stream->read(stream->context, buffer, size);
  if (count < 0)
    return MHD_CONTENT_READER_END_OF_STREAM;
  if (count == 0) { /* an answer of 0 would be asked again at once */
    connection->waiting = true;
    MHD_suspend_connection(connection->mhd);
  }
  return count;
}

/* A response with these headers over a part of the body; the body is retained. NULL: memory. */
static struct MHD_Response *make_response(struct connection *connection, const struct headers *headers, uint64_t first, uint64_t size) {
  const struct lod_reply *reply = &connection->exchange.reply;
  struct MHD_Response *response;
  if (reply->stream.read)
    response = MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, STREAM_BYTES, read_stream, connection, NULL);
  else if (reply->body && size)
    response = MHD_create_response_from_buffer_with_free_callback_cls((size_t)size, (void *)(reply->body->bytes + first), release_body,
                                                                      lod_body_retain(reply->body));
  else
    response = MHD_create_response_from_buffer(0, NULL, MHD_RESPMEM_PERSISTENT);
  for (uint32_t i = 0; response && i < headers->count; i++)
    if (MHD_add_response_header(response, headers->list[i].name, headers->list[i].value) != MHD_YES) {
      MHD_destroy_response(response);
      response = NULL;
    }
  return response;
}

static enum MHD_Result queue_whole(struct connection *connection, unsigned status, const struct headers *headers) {
  struct lod_http *http = connection->loop->http;
  const struct lod_reply *reply = &connection->exchange.reply;
  uint64_t size = reply->body ? reply->body->size : 0;
  if (!reply->shared || headers->size + 256 > HEADER_TEXT_MAX) {
    struct MHD_Response *response = make_response(connection, headers, 0, size);
    enum MHD_Result result = response ? MHD_queue_response(connection->mhd, status, response) : MHD_NO;
    if (response)
      MHD_destroy_response(response);
    return result;
  }
  uint64_t generation = lod_store_generation(http->service->store);
  struct lod_cache_entry *entry = lod_cache_find(http->responses, headers->text, headers->size, generation);
  if (!entry) {
    struct MHD_Response *response = make_response(connection, headers, 0, size);
    entry = response ? lod_cache_insert(http->responses, headers->text, headers->size, generation, response) : NULL;
  }
  if (!entry)
    return MHD_NO;
  enum MHD_Result result = MHD_queue_response(connection->mhd, status, lod_cache_value(entry));
  lod_cache_release(http->responses, entry);
  return result;
}

/* Puts conditions and ranges into effect and hands the reply to MHD. */
static enum MHD_Result queue_reply(struct connection *connection) {
  struct lod_exchange *exchange = &connection->exchange;
  struct lod_reply *reply = &exchange->reply;
  struct lod_metrics *metrics = exchange->service->metrics;
  struct lod_plan plan = {.status = reply->status, .size = reply->body ? reply->body->size : 0};
  if (reply->status == 200 && reply->body) {
    struct lod_conditions conditions = lod_exchange_conditions(exchange);
    plan = lod_conditions_plan(&conditions, reply->etag, reply->body->size);
    if (plan.status == 416) {
      uint64_t size = reply->body->size;
      lod_reply_problem(reply, 416, "range-not-satisfiable", "The range is malformed or lies outside of the representation.", "");
      lod_reply_header(reply, "Content-Range", "bytes */%llu", (unsigned long long)size);
    } else if (plan.status == 412) {
      lod_reply_problem(reply, 412, "precondition-failed", "If-Match does not name the present representation.", "");
    } else if (plan.status == 206) {
      lod_reply_header(reply, "Content-Range", "bytes %llu-%llu/%llu", (unsigned long long)plan.first,
                       (unsigned long long)(plan.first + plan.size - 1), (unsigned long long)reply->body->size);
      lod_metrics_add(metrics, LOD_METRIC_PARTIAL, 1);
    } else if (plan.status == 304) {
      lod_metrics_add(metrics, LOD_METRIC_NOT_MODIFIED, 1);
    }
  }
  struct headers headers = {.count = 0};
  lod_routes_headers(exchange, emit_header, &headers);
  connection->status = plan.status;
  bool bodiless = plan.status == 304 || exchange->method == LOD_HEAD;
  connection->sent = bodiless ? 0 : plan.status == 206 ? plan.size : reply->body ? reply->body->size : 0;
  lod_deadline_enter(&connection->deadline, LOD_PHASE_SEND, connection->loop->now);
  /* 304 is the whole response under another status: from an empty one MHD would send Content-Length: 0. */
  if (plan.status != 206)
    return queue_whole(connection, plan.status, &headers);
  struct MHD_Response *response = make_response(connection, &headers, plan.first, plan.size);
  enum MHD_Result result = response ? MHD_queue_response(connection->mhd, 206, response) : MHD_NO;
  if (response)
    MHD_destroy_response(response);
  return result;
}

/* Sends an error while a body still arrives, where MHD takes no response any more, and has the connection closed. */
static enum MHD_Result last_word(struct connection *connection) {
  const struct lod_reply *reply = &connection->exchange.reply;
  struct headers headers = {.count = 0};
  char text[HEADER_TEXT_MAX + 2048];
  lod_routes_headers(&connection->exchange, emit_header, &headers);
  size_t body_size = reply->body ? reply->body->size : 0;
  int size = snprintf(text, sizeof text, "HTTP/1.1 %u %s\r\nConnection: close\r\nContent-Length: %zu\r\n", reply->status,
                      MHD_get_reason_phrase_for(reply->status), body_size);
  for (uint32_t i = 0; i < headers.count && (size_t)size < sizeof text; i++)
    size += snprintf(text + size, sizeof text - (size_t)size, "%s: %s\r\n", headers.list[i].name, headers.list[i].value);
  if ((size_t)size + 2 + body_size <= sizeof text) {
    memcpy(text + size, "\r\n", 2);
    if (body_size)
      memcpy(text + size + 2, reply->body->bytes, body_size);
    size_t total = (size_t)size + 2 + body_size;
    const union MHD_ConnectionInfo *tls = MHD_get_connection_info(connection->mhd, MHD_CONNECTION_INFO_GNUTLS_SESSION);
    ssize_t ignored = tls && tls->tls_session ? gnutls_record_send(tls->tls_session, text, total)
                                              : send(connection->fd, text, total, MSG_NOSIGNAL | MSG_DONTWAIT);
    (void)ignored; /* the connection ends either way */
  }
  connection->status = reply->status;
  connection->sent = body_size;
  connection->linger = true;
  return MHD_NO;
}

/* ---- requests ---- */

static const char *look_up_header(void *context, const char *name) {
  return MHD_lookup_connection_value(context, MHD_HEADER_KIND, name);
}

static enum lod_method parse_method(const char *text) {
  static const char *const kNames[] = {"GET", "HEAD", "PUT", "DELETE", "OPTIONS"};
  for (int i = 0; i < LOD_METHOD_OTHER; i++)
    if (strcmp(text, kNames[i]) == 0)
      return (enum lod_method)i;
  return LOD_METHOD_OTHER;
}

static struct connection *connection_of(struct MHD_Connection *mhd) {
  const union MHD_ConnectionInfo *info = MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
  return info ? info->socket_context : NULL;
}

/* The request line was read: a request begins. Its result is the handler's *request_context. */
static void *begin_request(void *context, const char *uri, struct MHD_Connection *mhd) {
  struct connection *connection = connection_of(mhd);
  size_t size = strlen(uri) + 1;
  (void)context;
  if (!connection)
    return NULL;
  if (size > connection->target_capacity) {
    char *both = realloc(connection->target, 2 * size);
    if (!both)
      return NULL;
    connection->target = both;
    connection->target_capacity = size;
  }
  connection->parsed = connection->target + connection->target_capacity;
  memcpy(connection->target, uri, size);
  memcpy(connection->parsed, uri, size);
  connection->active = true;
  connection->begun = connection->answered = connection->working = connection->work_done = connection->waiting = connection->gone = false;
  connection->ignored = connection->sent = 0;
  connection->status = 0;
  strcpy(connection->method, "?");
  connection->exchange = (struct lod_exchange){0};
  connection->started = monotonic();
  lod_deadline_enter(&connection->deadline, LOD_PHASE_HEADERS, connection->loop->now);
  return connection;
}

static size_t keep_escapes(void *context, struct MHD_Connection *mhd, char *text) {
  (void)context;
  (void)mhd;
  return strlen(text); /* query.c decodes */
}

static enum MHD_Result begin_exchange(struct connection *connection, const char *method) {
  struct lod_exchange *exchange = &connection->exchange;
  connection->begun = true;
  snprintf(connection->method, sizeof connection->method, "%s", method);
  exchange->service = connection->loop->http->service;
  exchange->method = parse_method(method);
  exchange->header = look_up_header;
  exchange->header_context = connection->mhd;
  const char *length = look_up_header(connection->mhd, "Content-Length");
  exchange->length_known = length != NULL;
  exchange->length = length ? strtoull(length, NULL, 10) : 0;
  bool has_body = exchange->length > 0 || look_up_header(connection->mhd, "Transfer-Encoding");
  struct lod_query_problem problem = {0};
  if (lod_target_parse(connection->parsed, &exchange->target, &problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else
    lod_routes_begin(exchange);
  if (exchange->reply.status && has_body) { /* refused before the body: MHD closes after it, and skips "100 Continue" */
    connection->linger = true;
    return queue_reply(connection);
  }
  lod_deadline_enter(&connection->deadline, has_body ? LOD_PHASE_RECEIVE : LOD_PHASE_WORK, connection->loop->now);
  return MHD_YES; /* a reply in this first call would close the connection */
}

static enum MHD_Result take_body(struct connection *connection, const char *bytes, size_t size) {
  struct lod_exchange *exchange = &connection->exchange;
  if (exchange->route && exchange->route->body && !exchange->reply.status) {
    exchange->route->body(exchange, bytes, size);
    return exchange->reply.status ? last_word(connection) : MHD_YES;
  }
  connection->ignored += size;
  return connection->ignored > IGNORED_BODY_MAX ? MHD_NO : MHD_YES;
}

static void run_work(struct lod_background_work *work) {
  struct connection *connection = (struct connection *)((char *)work - offsetof(struct connection, work));
  struct loop *loop = connection->loop;
  connection->exchange.work(&connection->exchange);
  lod_exchange_compress(&connection->exchange, true);
  pthread_mutex_lock(&loop->done_lock);
  connection->next_done = loop->done;
  loop->done = connection;
  pthread_mutex_unlock(&loop->done_lock);
  wake(loop);
}

static enum MHD_Result answer(struct connection *connection) {
  struct lod_exchange *exchange = &connection->exchange;
  if (!connection->answered) {
    connection->answered = true;
    lod_deadline_enter(&connection->deadline, LOD_PHASE_WORK, connection->loop->now);
    if (!exchange->reply.status)
      exchange->route->answer(exchange);
  }
  if (!exchange->work && !connection->work_done)
    lod_exchange_compress(exchange, false);
  if (exchange->work) {
    connection->working = true;
    connection->work.run = run_work;
    MHD_suspend_connection(connection->mhd);
    lod_background_add(connection->loop->http->background, &connection->work);
    return MHD_YES;
  }
  return queue_reply(connection);
}

static enum MHD_Result handle(void *context, struct MHD_Connection *mhd, const char *url, const char *method, const char *version,
                              const char *bytes, size_t *size, void **request_context) {
  struct connection *connection = *request_context;
  (void)context, (void)mhd, (void)url, (void)version;
  if (!connection)
    return MHD_NO; /* no memory at the request line */
  if (!connection->begun)
    return begin_exchange(connection, method);
  if (*size) {
    enum MHD_Result result = take_body(connection, bytes, *size);
    *size = 0;
    return result;
  }
  return answer(connection);
}

static void stop_watching(struct connection *connection) {
  if (connection->watched)
    epoll_ctl(connection->loop->epoll_fd, EPOLL_CTL_DEL, connection->fd, NULL);
  connection->watched = false;
}

static void end_request(void *context, struct MHD_Connection *mhd, void **request_context, enum MHD_RequestTerminationCode code) {
  static const char *const kNotes[] = {NULL, "connection failed", "timeout", "server stopped", "peer stopped sending", "peer went away"};
  struct connection *connection = *request_context;
  (void)context, (void)mhd;
  if (!connection || !connection->active)
    return;
  struct lod_exchange *exchange = &connection->exchange;
  struct lod_service *service = connection->loop->http->service;
  double seconds = monotonic() - connection->started;
  bool whole = code == MHD_REQUEST_TERMINATED_COMPLETED_OK;
  const char *note = connection->cut                                 ? lod_cut_name(connection->cut)
                     : (size_t)code < sizeof kNotes / sizeof *kNotes ? kNotes[code]
                                                                     : "failed";
  if (connection->status == 0 && !connection->begun)
    note = note ? note : "refused by the HTTP parser";
  else if (connection->gone || connection->status >= 400 || exchange->reply.stream.read)
    note = NULL; /* a stream's end and a refused upload are no accident */
  if (whole && connection->sent)
    lod_metrics_add(service->metrics, LOD_METRIC_BODY_BYTES_SENT, (int64_t)connection->sent);
  lod_metrics_request(service->metrics, lod_route_index(exchange->route), connection->status, seconds);
  struct lod_log_request line = {
      connection->method, connection->target, connection->peer, connection->status, connection->sent, seconds, note};
  lod_log_write_request(&line);
  stop_watching(connection);
  lod_reply_finish(&exchange->reply);
  if (exchange->state_finish)
    exchange->state_finish(exchange->state);
  exchange->state_finish = NULL;
  connection->active = connection->waiting = false;
  *request_context = NULL;
  lod_deadline_enter(&connection->deadline, LOD_PHASE_WAIT, connection->loop->now);
}

/* ---- connections ---- */

static void accept_connection(struct loop *loop, struct MHD_Connection *mhd, void **socket_context) {
  struct connection *connection = calloc(1, sizeof *connection);
  *socket_context = connection;
  if (!connection)
    return; /* begin_request refuses */
  connection->watch = WATCH_PEER;
  connection->loop = loop;
  connection->mhd = mhd;
  connection->fd = MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  lod_socket_text(MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_CLIENT_ADDRESS)->client_addr, connection->peer);
  lod_deadline_accept(&connection->deadline, loop->now);
  connection->next = loop->connections;
  if (connection->next)
    connection->next->previous = connection;
  loop->connections = connection;
  loop->count++;
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS, 1);
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS_ACCEPTED, 1);
}

static void forget_connection(struct connection *connection) {
  struct loop *loop = connection->loop;
  stop_watching(connection);
  if (connection->linger)
    lod_linger_add(loop->linger, connection->fd, loop->now);
  *(connection->previous ? &connection->previous->next : &loop->connections) = connection->next;
  if (connection->next)
    connection->next->previous = connection->previous;
  loop->count--;
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS, -1);
  free(connection->target);
  free(connection);
}

static void notify_connection(void *context, struct MHD_Connection *mhd, void **socket_context, enum MHD_ConnectionNotificationCode code) {
  if (code == MHD_CONNECTION_NOTIFY_STARTED)
    accept_connection(context, mhd, socket_context);
  else if (*socket_context)
    forget_connection(*socket_context);
}

/* MHD then finds the connection closed and ends it in its own way; the descriptor is MHD's. */
static void cut(struct connection *connection, enum lod_cut reason) {
  if (reason != LOD_CUT_NO && connection->cut == LOD_CUT_NO) {
    connection->cut = reason;
    lod_metrics_cut(connection->loop->http->service->metrics, reason);
    enum lod_log_level level = reason == LOD_CUT_IDLE ? LOD_LOG_DEBUG : LOD_LOG_INFO;
    lod_log(level, "%s cut: %s", connection->peer, lod_cut_name(reason));
  }
  shutdown(connection->fd, SHUT_RDWR);
}

/* ---- loops ---- */

static void resume_stream(struct connection *connection) {
  connection->waiting = false;
  MHD_resume_connection(connection->mhd);
}

/* Streams look for news when jobs changed, and once a sweep for their heartbeat. */
static void resume_streams(struct loop *loop) {
  for (struct connection *connection = loop->connections; connection; connection = connection->next)
    if (connection->waiting)
      resume_stream(connection);
}

static void resume_done(struct loop *loop) {
  pthread_mutex_lock(&loop->done_lock);
  struct connection *done = loop->done;
  loop->done = NULL;
  pthread_mutex_unlock(&loop->done_lock);
  while (done) {
    struct connection *next = done->next_done;
    done->working = false;
    done->work_done = true;
    done->exchange.work = NULL;
    MHD_resume_connection(done->mhd);
    done = next;
  }
}

/* A suspended connection hears nothing from MHD when its peer goes, so a waiting stream's socket is watched here. */
static void watch_streams(struct loop *loop) {
  for (struct connection *connection = loop->connections; connection; connection = connection->next)
    if (connection->waiting && !connection->watched) {
      struct epoll_event event = {.events = EPOLLRDHUP | EPOLLET, .data.ptr = connection};
      connection->watched = epoll_ctl(loop->epoll_fd, EPOLL_CTL_ADD, connection->fd, &event) == 0;
    }
}

static void sweep(struct loop *loop, bool draining, bool late) {
  for (struct connection *connection = loop->connections; connection; connection = connection->next) {
    uint64_t received = 0, acknowledged = 0;
    struct lod_deadline *deadline = &connection->deadline;
    if (connection->waiting && (connection->gone || draining || late))
      continue; /* resume_streams ends it */
    if (late || (draining && deadline->phase == LOD_PHASE_WAIT && deadline->first_byte == 0)) {
      cut(connection, LOD_CUT_NO);
      continue;
    }
    if (connection->working || connection->exchange.reply.stream.read || !lod_socket_counts(connection->fd, &received, &acknowledged))
      continue;
    enum lod_cut reason = lod_deadline_check(deadline, &loop->http->limits, received, acknowledged, loop->now);
    if (reason != LOD_CUT_NO)
      cut(connection, reason);
  }
  lod_linger_sweep(loop->linger, loop->now);
}

static bool any_suspended(const struct loop *loop) {
  for (const struct connection *connection = loop->connections; connection; connection = connection->next)
    if (connection->working || connection->waiting)
      return true;
  return false;
}

static void stop_accepting(struct loop *loop) {
  MHD_run(loop->daemon); /* takes what waits in the backlog */
  MHD_socket listener = MHD_quiesce_daemon(loop->daemon);
  if (listener != MHD_INVALID_SOCKET)
    close(listener);
}

static void take_events(struct loop *loop, int timeout_ms) {
  struct epoll_event events[64];
  int count = epoll_wait(loop->epoll_fd, events, 64, timeout_ms);
  loop->now = monotonic();
  for (int i = 0; i < count; i++) {
    enum watch kind = *(enum watch *)events[i].data.ptr;
    if (kind == WATCH_WAKE) {
      uint64_t value;
      ssize_t ignored = read(loop->wake_fd, &value, sizeof value);
      (void)ignored;
      resume_streams(loop);
    } else if (kind == WATCH_PEER) {
      struct connection *connection = events[i].data.ptr;
      connection->gone = true;
      if (connection->waiting)
        resume_stream(connection);
    } else if (kind == WATCH_LINGER) {
      lod_linger_read(loop->linger);
    }
  }
}

static void *run_loop(void *argument) {
  struct loop *loop = argument;
  bool accepting = true;
  for (;;) {
    double until = atomic_load(&loop->http->drain_until);
    bool draining = until > 0, late = draining && loop->now >= until;
    MHD_UNSIGNED_LONG_LONG mhd_ms;
    int timeout_ms = draining ? DRAIN_SWEEP_MS : SWEEP_MS;
    if (MHD_get_timeout(loop->daemon, &mhd_ms) == MHD_YES && mhd_ms < (MHD_UNSIGNED_LONG_LONG)timeout_ms)
      timeout_ms = (int)mhd_ms;
    take_events(loop, timeout_ms);
    if (draining && accepting) {
      accepting = false;
      stop_accepting(loop);
    }
    resume_done(loop);
    if (loop->now >= loop->next_sweep || draining) {
      resume_streams(loop);
      MHD_run(loop->daemon);
      sweep(loop, draining, late);
      loop->next_sweep = loop->now + 1e-3 * SWEEP_MS;
    }
    MHD_run(loop->daemon);
    watch_streams(loop);
    if (draining && (loop->count == 0 || late) && !any_suspended(loop))
      return NULL;
  }
}

static void log_mhd(void *context, const char *format, va_list arguments) {
  char text[512];
  (void)context;
  vsnprintf(text, sizeof text, format, arguments);
  text[strcspn(text, "\n")] = 0;
  lod_log(LOD_LOG_DEBUG, "libmicrohttpd: %s", text);
}

/* ---- start and stop ---- */

static bool add_watch(struct loop *loop, int fd, enum watch *watch) {
  struct epoll_event event = {.events = EPOLLIN, .data.ptr = watch};
  return epoll_ctl(loop->epoll_fd, EPOLL_CTL_ADD, fd, &event) == 0;
}

/* Takes the listener. */
static enum lod_status start_loop(struct loop *loop, int listener, char *certificate, char *key, struct lod_problem *problem) {
  const struct lod_config *config = loop->http->service->config;
  unsigned flags = MHD_USE_EPOLL | MHD_USE_ERROR_LOG | MHD_ALLOW_SUSPEND_RESUME | (certificate ? MHD_USE_TLS : 0);
  struct MHD_OptionItem tls[] = {{certificate ? MHD_OPTION_HTTPS_MEM_CERT : MHD_OPTION_END, 0, certificate},
                                 {MHD_OPTION_HTTPS_MEM_KEY, 0, key},
                                 {MHD_OPTION_HTTPS_PRIORITIES, 0, (void *)"NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"},
                                 {MHD_OPTION_END, 0, NULL}};
  uint64_t share = (config->connections + loop->http->loop_count - 1) / loop->http->loop_count;
  loop->watch_mhd = WATCH_MHD;
  loop->watch_wake = WATCH_WAKE;
  loop->now = monotonic();
  /* No MHD_OPTION_CONNECTION_TIMEOUT: it counts inactivity alone; sweep() has the deadlines. */
  loop->daemon = MHD_start_daemon(flags, 0, NULL, NULL, handle, loop, MHD_OPTION_EXTERNAL_LOGGER, log_mhd, NULL, MHD_OPTION_LISTEN_SOCKET,
                                  listener, MHD_OPTION_CONNECTION_LIMIT, (unsigned)share, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
                                  (size_t)POOL_BYTES, MHD_OPTION_NOTIFY_COMPLETED, end_request, loop, MHD_OPTION_NOTIFY_CONNECTION,
                                  notify_connection, loop, MHD_OPTION_URI_LOG_CALLBACK, begin_request, loop, MHD_OPTION_UNESCAPE_CALLBACK,
                                  keep_escapes, NULL, MHD_OPTION_STRICT_FOR_CLIENT, 1, MHD_OPTION_ARRAY, tls, MHD_OPTION_END);
  if (!loop->daemon) {
    close(listener);
    return lod_fail(problem, LOD_IO, "cannot-listen", "The HTTP server could not be started%s.",
                    certificate ? "; do --tls-cert and --tls-key hold a PEM certificate and its key?" : "");
  }
  int mhd_fd = MHD_get_daemon_info(loop->daemon, MHD_DAEMON_INFO_EPOLL_FD)->listen_fd;
  loop->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
  loop->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  if (loop->epoll_fd < 0 || loop->wake_fd < 0 || !add_watch(loop, mhd_fd, &loop->watch_mhd) ||
      !add_watch(loop, loop->wake_fd, &loop->watch_wake))
    return lod_fail(problem, LOD_IO, "cannot-listen", "epoll: %s.", strerror(errno));
  loop->linger = lod_linger_create(loop->epoll_fd, WATCH_LINGER);
  if (!loop->linger)
    return lod_fail_memory(problem);
  return LOD_OK;
}

/* A whole file as text; malloc'd. */
static enum lod_status read_pem(const char *path, char **text, struct lod_problem *problem) {
  enum { PEM_MAX = 1 << 20 };
  FILE *file = fopen(path, "re");
  *text = file ? calloc(1, PEM_MAX) : NULL;
  size_t size = *text ? fread(*text, 1, PEM_MAX - 1, file) : 0;
  if (file)
    fclose(file);
  return size ? LOD_OK : lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "'%s' cannot be read or is empty.", path);
}

static enum lod_status start_loops(struct lod_http *http, struct lod_problem *problem) {
  const struct lod_config *config = http->service->config;
  char address[LOD_ADDRESS_TEXT_MAX], *certificate = NULL, *key = NULL;
  int listeners[256];
  enum lod_status status = LOD_OK;
  if (*config->tls_cert)
    status = read_pem(config->tls_cert, &certificate, problem);
  if (status == LOD_OK && *config->tls_key)
    status = read_pem(config->tls_key, &key, problem);
  if (status == LOD_OK)
    status = lod_socket_listen(config->listen, http->loop_count, listeners, address, problem);
  if (status == LOD_OK) {
    snprintf(http->url, sizeof http->url, "%s://%s", certificate ? "https" : "http", address);
    for (uint32_t i = 0; i < http->loop_count; i++) {
      if (status == LOD_OK)
        status = start_loop(&http->loops[i], listeners[i], certificate, key, problem);
      else
        close(listeners[i]);
    }
  }
  for (uint32_t i = 0; status == LOD_OK && i < http->loop_count; i++) {
    http->loops[i].started = pthread_create(&http->loops[i].thread, NULL, run_loop, &http->loops[i]) == 0;
    if (!http->loops[i].started)
      status = lod_fail(problem, LOD_MEMORY, "cannot-listen", "A thread of the HTTP server could not be started.");
  }
  free(certificate);
  if (key)
    explicit_bzero(key, strlen(key));
  free(key);
  return status;
}

enum lod_status lod_http_create(struct lod_service *service, struct lod_http **result, struct lod_problem *problem) {
  const struct lod_config *config = service->config;
  long processors = sysconf(_SC_NPROCESSORS_ONLN);
  uint64_t loops = config->loops ? config->loops : processors > 0 ? (uint64_t)processors : 1;
  struct lod_http *http = calloc(1, sizeof *http);
  *result = NULL;
  if (!http)
    return lod_fail_memory(problem);
  http->service = service;
  http->limits = (struct lod_deadline_limits){(double)config->header_seconds, (double)config->idle_seconds, (double)config->rate_seconds,
                                              (double)config->rate_bytes};
  http->loop_count = loops < 256 ? (uint32_t)loops : 256;
  http->loops = calloc(http->loop_count, sizeof *http->loops);
  http->responses = lod_cache_create(config->cached_objects, destroy_response);
  service->responses = http->responses;
  http->background = lod_background_create(2);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++) {
    http->loops[i].http = http;
    http->loops[i].epoll_fd = http->loops[i].wake_fd = -1;
    pthread_mutex_init(&http->loops[i].done_lock, NULL);
  }
  enum lod_status status = http->loops && http->responses && http->background ? start_loops(http, problem) : lod_fail_memory(problem);
  if (status != LOD_OK) {
    lod_http_destroy(http, 0);
    return status;
  }
  *result = http;
  return LOD_OK;
}

const char *lod_http_url(const struct lod_http *http) {
  return http->url;
}

void lod_http_job_changed(struct lod_http *http) {
  lod_service_trim(http->service);
  for (uint32_t i = 0; i < http->loop_count; i++)
    wake(&http->loops[i]);
}

void lod_http_destroy(struct lod_http *http, double drain_seconds) {
  if (!http)
    return;
  atomic_store(&http->service->draining, true);
  atomic_store(&http->drain_until, monotonic() + drain_seconds);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++)
    if (http->loops[i].started)
      wake(&http->loops[i]);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++) {
    struct loop *loop = &http->loops[i];
    if (loop->started)
      pthread_join(loop->thread, NULL);
    if (loop->daemon)
      MHD_stop_daemon(loop->daemon);
    lod_linger_destroy(loop->linger);
    if (loop->epoll_fd >= 0)
      close(loop->epoll_fd);
    if (loop->wake_fd >= 0)
      close(loop->wake_fd);
    pthread_mutex_destroy(&loop->done_lock);
  }
  lod_background_destroy(http->background);
  http->service->responses = NULL;
  lod_cache_destroy(http->responses);
  free(http->loops);
  free(http);
}
