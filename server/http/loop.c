/* Event loops over libmicrohttpd 0.9.75 in external epoll mode: waiting, accepting, deadlines, start and stop. README.md says why so. */
#include <errno.h>
#include <gnutls/gnutls.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include "server/http/address.h"
#include "server/http/loop.h"
#include "server/http/memo.h"
#include "server/http/tls.h"
#include "server/log.h"

enum {
  POOL_BYTES = 16 << 10, /* MHD clears the whole pool after each request; 16 KiB suits browsers' headers */
  SWEEP_MS = 1000,
  SLICES = 20,    /* of a sweep over many connections: each asks the kernel about one, and nobody shall wait for thousands */
  SLICE_MIN = 64, /* connections */
  HAND_OVER = 2,  /* a loop that has so many connections more than another gives it the next */
  DRAIN_SWEEP_MS = 20,
  COPIES_MAX = 12 << 20, /* bytes in the buffers of one loop */
};

double lod_loop_clock(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void lod_loop_wake(struct loop *loop) {
  uint64_t one = 1;
  ssize_t ignored = write(loop->wake_fd, &one, sizeof one); /* full means awake already */
  (void)ignored;
}

const char *lod_loop_peer(const struct connection *connection, char text[LOD_ADDRESS_TEXT_MAX]) {
  lod_socket_text(MHD_get_connection_info(connection->mhd, MHD_CONNECTION_INFO_CLIENT_ADDRESS)->client_addr, text);
  return text;
}

/* ---- bodies as files ---- */

/* When a mapped body should go out as a file. A copy is cheaper as long as what all connections have in their buffers stays in the
 * processor's cache: there, a fresh copy is read faster than a page by reference. What is larger than a good part of memory is never mapped
 * in by copying it. Measured, see README.md. */
static bool sendfile_pays(const struct loop *loop, size_t size) {
  size_t each = size < LOD_SEND_BUFFER_BYTES ? size : LOD_SEND_BUFFER_BYTES;
  return (size_t)loop->bulk * each > COPIES_MAX || size > loop->http->memory_bytes / 4;
}

void lod_loop_set_bulk(struct connection *connection, bool bulk) {
  connection->loop->bulk += (uint32_t)bulk - (uint32_t)connection->bulk;
  connection->bulk = bulk;
}

/* The bytes that a connection is sending, as a file: see in_flight. */
static bool file_of(void *context, int fd, const void *bytes, size_t size, int *file, off_t *offset) {
  const struct loop *loop = context;
  const struct connection *connection = fd < loop->fd_count ? loop->by_fd[fd] : NULL;
  const struct lod_body *body = connection ? connection->exchange.reply.body : NULL;
  if (!body || body->file < 0)
    return false;
  uintptr_t at = (uintptr_t)bytes, start = (uintptr_t)body->bytes;
  if (at < start || at - start > body->size || size > body->size - (at - start))
    return false;
  if (!sendfile_pays(loop, body->size))
    return false;
  *file = body->file;
  *offset = (off_t)(at - start);
  return true;
}

/* ---- streams ---- */

void lod_loop_add_stream(struct connection *connection) {
  struct loop *loop = connection->loop;
  connection->streaming = true;
  connection->previous_stream = NULL;
  connection->next_stream = loop->streams;
  if (loop->streams)
    loop->streams->previous_stream = connection;
  loop->streams = connection;
}

static void remove_stream(struct connection *connection) {
  if (!connection->streaming)
    return;
  connection->streaming = false;
  *(connection->previous_stream ? &connection->previous_stream->next_stream : &connection->loop->streams) = connection->next_stream;
  if (connection->next_stream)
    connection->next_stream->previous_stream = connection->previous_stream;
}

static void stop_watching(struct connection *connection) {
  if (connection->watched)
    epoll_ctl(connection->loop->epoll_fd, EPOLL_CTL_DEL, connection->fd, NULL);
  connection->watched = false;
}

void lod_loop_forget_stream(struct connection *connection) {
  stop_watching(connection);
  remove_stream(connection);
}

/* ---- connections ---- */

/* MHD then finds the connection closed and ends it in its own way; the descriptor is MHD's. */
static void cut(struct connection *connection, enum lod_cut reason) {
  if (reason != LOD_CUT_NO && connection->cut == LOD_CUT_NO) {
    connection->cut = reason;
    lod_metrics_cut(connection->loop->http->service->metrics, reason);
    enum lod_log_level level = reason == LOD_CUT_IDLE ? LOD_LOG_DEBUG : LOD_LOG_INFO;
    char peer[LOD_ADDRESS_TEXT_MAX];
    if (lod_log_enabled(level))
      lod_log(level, "%s cut: %s", lod_loop_peer(connection, peer), lod_cut_name(reason));
  }
  shutdown(connection->fd, SHUT_RDWR);
}

/* What a connection is told that is one too many; on TLS it is only closed. */
static void refuse_connection(int fd, bool tls) {
  static const char kText[] =
      "HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nRetry-After: 5\r\nCache-Control: no-store\r\n"
      "Access-Control-Allow-Origin: *\r\nContent-Type: application/problem+json\r\nContent-Length: 115\r\n\r\n"
      "{\"type\":\"/problems/overloaded\",\"title\":\"Overloaded\",\"status\":503,\"detail\":\"Too many connections; try again later.\"}";
  _Static_assert(sizeof kText > 115, "the length is written out above");
  if (!tls && send(fd, kText, sizeof kText - 1, MSG_NOSIGNAL | MSG_DONTWAIT) < 0)
    return;
}

static bool remember_fd(struct loop *loop, struct connection *connection) {
  if (connection->fd >= loop->fd_count) {
    int count = connection->fd * 2 + 64;
    struct connection **table = realloc(loop->by_fd, (size_t)count * sizeof(struct connection *));
    if (!table)
      return false;
    memset(table + loop->fd_count, 0, (size_t)(count - loop->fd_count) * sizeof *table);
    loop->by_fd = table;
    loop->fd_count = count;
  }
  loop->by_fd[connection->fd] = connection;
  return true;
}

static void accept_connection(struct loop *loop, struct MHD_Connection *mhd, void **socket_context) {
  struct connection *connection = calloc(1, sizeof *connection);
  *socket_context = connection;
  if (!connection)
    return; /* begin_request refuses */
  connection->watch = WATCH_PEER;
  connection->loop = loop;
  connection->mhd = mhd;
  connection->fd = MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  lod_deadline_accept(&connection->deadline, loop->now);
  connection->next = loop->connections;
  if (connection->next)
    connection->next->previous = connection;
  loop->connections = connection;
  loop->count++;
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS, 1);
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS_ACCEPTED, 1);
  bool remembered = remember_fd(loop, connection);
  if (loop->http->addresses) {
    connection->address =
        lod_addresses_take(loop->http->addresses, MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_CLIENT_ADDRESS)->client_addr);
    remembered = remembered && connection->address;
  }
  if (!remembered) {
    refuse_connection(connection->fd, loop->http->tls);
    connection->linger = true;
    cut(connection, LOD_CUT_ADDRESS);
  }
}

static void forget_connection(struct connection *connection) {
  struct loop *loop = connection->loop;
  stop_watching(connection);
  if (connection->fd < loop->fd_count && loop->by_fd[connection->fd] == connection)
    loop->by_fd[connection->fd] = NULL;
  if (loop->sweep_at == connection)
    loop->sweep_at = connection->next;
  lod_loop_set_bulk(connection, false);
  lod_addresses_release(loop->http->addresses, connection->address);
  if (connection->linger)
    lod_linger_add(loop->linger, connection->fd, loop->now);
  *(connection->previous ? &connection->previous->next : &loop->connections) = connection->next;
  if (connection->next)
    connection->next->previous = connection->previous;
  loop->count--;
  lod_metrics_add(loop->http->service->metrics, LOD_METRIC_CONNECTIONS, -1);
  free(connection->target);
  free(connection->sending.record.bytes);
  free(connection);
}

static void notify_connection(void *context, struct MHD_Connection *mhd, void **socket_context, enum MHD_ConnectionNotificationCode code) {
  if (code == MHD_CONNECTION_NOTIFY_STARTED)
    accept_connection(context, mhd, socket_context);
  else if (*socket_context)
    forget_connection(*socket_context);
}

/* ---- loops ---- */

static void resume_stream(struct connection *connection) {
  connection->waiting = false;
  MHD_resume_connection(connection->mhd);
}

/* Streams look for news when jobs changed, and once a sweep for their heartbeat. */
static void resume_streams(struct loop *loop) {
  for (struct connection *connection = loop->streams; connection; connection = connection->next_stream)
    if (connection->waiting)
      resume_stream(connection);
}

static void resume_done(struct loop *loop) {
  pthread_mutex_lock(&loop->lock);
  struct connection *done = loop->done;
  loop->done = NULL;
  pthread_mutex_unlock(&loop->lock);
  while (done) {
    struct connection *next = done->next_done;
    done->working = false;
    done->work_done = true;
    done->exchange.work = NULL;
    done->exchange.start = NULL;
    MHD_resume_connection(done->mhd);
    done = next;
  }
}

/* A suspended connection hears nothing from MHD when its peer goes, so the socket of a waiting stream, or of a request whose work can be
 * cancelled, is watched here. */
static void watch_streams(struct loop *loop) {
  for (struct connection *connection = loop->streams; connection; connection = connection->next_stream)
    if ((connection->waiting || (connection->working && connection->exchange.cancel)) && !connection->watched) {
      struct epoll_event event = {.events = EPOLLRDHUP | EPOLLET, .data.ptr = connection};
      connection->watched = epoll_ctl(loop->epoll_fd, EPOLL_CTL_ADD, connection->fd, &event) == 0;
    }
}

/* ---- accepting ---- */

/* Connections that a loop serves, and those that wait for it. */
static uint32_t load_of(const struct loop *loop) {
  return atomic_load(&loop->count) + atomic_load(&loop->guest_count);
}

/* False when there is no more room for guests, or the loop has come to hold more than `most`. */
static bool add_guest(struct loop *loop, uint32_t most, int fd, const struct sockaddr *address, socklen_t size) {
  pthread_mutex_lock(&loop->lock);
  const bool taken = loop->guest_count < GUESTS && load_of(loop) <= most;
  if (taken) {
    struct guest *guest = &loop->guests[loop->guest_count++];
    guest->fd = fd;
    guest->size = size;
    memcpy(&guest->address, address, size);
  }
  pthread_mutex_unlock(&loop->lock);
  return taken;
}

/* Gives the socket to a loop that has less to do. The kernel spreads connections over the listeners by a hash, which leaves few connections
 * badly spread, and a listener that systemd opened is on one loop alone. */
static bool hand_over(struct loop *loop, int fd, const struct sockaddr *address, socklen_t size) {
  struct loop *least = loop;
  struct lod_http *http = loop->http;
  for (uint32_t i = 0; i < http->loop_count; i++)
    if (load_of(&http->loops[i]) < load_of(least))
      least = &http->loops[i];
  const uint32_t own = load_of(loop);
  if (own < load_of(least) + HAND_OVER || !add_guest(least, own - HAND_OVER, fd, address, size))
    return false;
  lod_loop_wake(least);
  return true;
}

/* MHD has accepted a socket for this loop. It does so once after its limit was reached, and would close it. */
static bool admit(void *context, int fd, const struct sockaddr *address, socklen_t size) {
  struct loop *loop = context;
  if (size > sizeof loop->guests->address)
    return true;
  return !hand_over(loop, fd, address, size) && (loop->count < loop->share || !add_guest(loop, UINT32_MAX, fd, address, size));
}

/* As many as there is room for; MHD would close the others. */
static void take_guests(struct loop *loop) {
  struct guest guests[GUESTS];
  const uint32_t room = loop->count < loop->share ? loop->share - loop->count : 0;
  pthread_mutex_lock(&loop->lock);
  const uint32_t count = loop->guest_count < room ? loop->guest_count : room;
  memcpy(guests, loop->guests, count * sizeof *guests);
  loop->guest_count -= count;
  memmove(loop->guests, loop->guests + count, loop->guest_count * sizeof *guests);
  pthread_mutex_unlock(&loop->lock);
  for (uint32_t i = 0; i < count; i++)
    MHD_add_connection(loop->daemon, guests[i].fd, (const struct sockaddr *)&guests[i].address,
                       guests[i].size); /* closes what it refuses */
}

static bool take_first_guest(struct loop *loop, struct guest *guest) {
  pthread_mutex_lock(&loop->lock);
  const bool any = loop->guest_count > 0;
  if (any) {
    *guest = loop->guests[0];
    loop->guest_count--;
    memmove(loop->guests, loop->guests + 1, loop->guest_count * sizeof *guest);
  }
  pthread_mutex_unlock(&loop->lock);
  return any;
}

static bool put_first_guest(struct loop *loop, const struct guest *guest) {
  pthread_mutex_lock(&loop->lock);
  const bool room = loop->guest_count < GUESTS;
  if (room) {
    memmove(loop->guests + 1, loop->guests, loop->guest_count * sizeof *guest);
    loop->guests[0] = *guest;
    loop->guest_count++;
  }
  pthread_mutex_unlock(&loop->lock);
  return room;
}

/* MHD does not accept at its limit; `admit` makes guests of those in the backlog while there is room for guests. */
static bool next_waiting(struct loop *loop, struct guest *guest) {
  if (take_first_guest(loop, guest))
    return true;
  guest->size = sizeof guest->address;
  guest->fd =
      loop->listener < 0 ? -1 : accept4(loop->listener, (struct sockaddr *)&guest->address, &guest->size, SOCK_NONBLOCK | SOCK_CLOEXEC);
  return guest->fd >= 0 || take_first_guest(loop, guest);
}

/* At the limit, who comes waits: in the backlog, or as a guest. Another loop may have room. When waiting takes long they are told, so that
 * they can go elsewhere. */
static void help_waiting(struct loop *loop) {
  enum { AT_ONCE = 64 };
  struct guest guest;
  if (loop->count < loop->share) {
    loop->saturated = 0;
    return;
  }
  if (loop->saturated == 0)
    loop->saturated = loop->now;
  const bool tell = loop->now - loop->saturated >= (double)loop->http->service->config->wait_seconds;
  for (int i = 0; i < AT_ONCE && next_waiting(loop, &guest); i++) {
    if (hand_over(loop, guest.fd, (struct sockaddr *)&guest.address, guest.size))
      continue;
    if (!tell && put_first_guest(loop, &guest))
      return;
    lod_metrics_cut(loop->http->service->metrics, LOD_CUT_OVERLOAD);
    refuse_connection(guest.fd, loop->http->tls);
    lod_linger_add(loop->linger, guest.fd, loop->now);
    close(guest.fd);
  }
}

/* ---- the sweep ---- */

static void check_connection(struct connection *connection, const struct lod_deadline_limits *limits, bool draining, bool late) {
  uint64_t received = 0, acknowledged = 0;
  struct lod_deadline *deadline = &connection->deadline;
  if (connection->bulk && deadline->phase == LOD_PHASE_WAIT && connection->loop->now - deadline->since > 1)
    lod_loop_set_bulk(connection, false); /* by now its buffers are empty */
  if (connection->waiting && (connection->gone || draining || late))
    return; /* resume_streams ends it */
  if (late || (draining && deadline->phase == LOD_PHASE_WAIT && deadline->first_byte == 0)) {
    cut(connection, LOD_CUT_NO);
    return;
  }
  if (connection->working || connection->exchange.reply.stream.read || !lod_socket_counts(connection->fd, &received, &acknowledged))
    return;
  enum lod_cut reason = lod_deadline_check(deadline, limits, received, acknowledged, connection->loop->now);
  if (reason != LOD_CUT_NO)
    cut(connection, reason);
}

/* A slice of the sweep, all of it while draining. Returns milliseconds to the next. */
static int sweep(struct loop *loop, bool draining, bool late) {
  const struct lod_config *config = loop->http->service->config;
  const struct lod_deadline_limits limits = {(double)config->header_seconds, (double)config->idle_seconds, (double)config->rate_seconds,
                                             (double)config->rate_bytes};
  uint32_t slices = draining ? 1 : loop->count / SLICE_MIN + 1;
  if (slices > SLICES)
    slices = SLICES;
  if (!loop->sweep_at || draining) { /* a new round */
    loop->sweep_at = loop->connections;
    resume_streams(loop);
    MHD_run(loop->daemon);
    lod_linger_sweep(loop->linger, loop->now);
    help_waiting(loop);
  }
  uint32_t left = draining ? UINT32_MAX : loop->count / slices + 1;
  for (struct connection *next; loop->sweep_at && left > 0; left--) {
    struct connection *connection = loop->sweep_at;
    next = connection->next;
    check_connection(connection, &limits, draining, late);
    loop->sweep_at = next;
  }
  return SWEEP_MS / (int)slices;
}

static bool any_suspended(const struct loop *loop) {
  for (const struct connection *connection = loop->connections; connection; connection = connection->next)
    if (connection->working || connection->waiting)
      return true;
  return false;
}

static void take_own_events(struct loop *loop) {
  struct epoll_event events[EVENTS];
  int count = epoll_wait(loop->epoll_fd, events, EVENTS, 0);
  for (int i = 0; i < count; i++) {
    enum watch kind = *(enum watch *)events[i].data.ptr;
    if (kind == WATCH_WAKE) {
      uint64_t value;
      ssize_t ignored = read(loop->wake_fd, &value, sizeof value);
      (void)ignored;
      resume_done(loop);
      take_guests(loop);
      resume_streams(loop);
    } else if (kind == WATCH_PEER) {
      struct connection *connection = events[i].data.ptr;
      connection->gone = true;
      if (connection->waiting)
        resume_stream(connection);
      else if (connection->working && connection->exchange.cancel)
        connection->exchange.cancel(&connection->exchange);
    } else if (kind == WATCH_LINGER) {
      lod_linger_read(loop->linger);
    }
  }
}

/* Waits for libmicrohttpd's events and ours together, and keeps the former. */
static void take_events(struct loop *loop, int timeout_ms) {
  bool own = false;
  struct epoll_event *next = loop->events + loop->event_count; /* an edge that was not handed over yet does not come again */
  loop->fetched = false;
  int count = epoll_wait(loop->mhd_fd, next, EVENTS - loop->event_count, timeout_ms);
  loop->now = lod_loop_clock();
  for (int i = 0; i < count; i++)
    if (next[i].data.ptr == &loop->watch_own)
      own = true;
    else
      loop->events[loop->event_count++] = next[i];
  loop->fetched = true;
  if (own)
    take_own_events(loop);
}

/* libmicrohttpd asks for what was kept. -1, the kernel itself, is for take_events. */
static int give_events(void *context, int fd, struct epoll_event *events, int most) {
  struct loop *loop = context;
  if (fd != loop->mhd_fd || !loop->fetched)
    return -1;
  int count = loop->event_count < most ? loop->event_count : most;
  memcpy(events, loop->events, (size_t)count * sizeof *events);
  memmove(loop->events, loop->events + count, (size_t)(loop->event_count - count) * sizeof *events);
  loop->event_count -= count;
  return count;
}

static void stop_accepting(struct loop *loop) {
  MHD_run(loop->daemon);
  take_events(loop, 0);
  MHD_run(loop->daemon); /* takes what waits in the backlog */
  MHD_socket listener = loop->listener >= 0 ? MHD_quiesce_daemon(loop->daemon) : MHD_INVALID_SOCKET;
  if (listener != MHD_INVALID_SOCKET)
    close(listener);
  loop->listener = -1;
}

static struct lod_sending *sending(void *context, int fd) {
  const struct loop *loop = context;
  return fd >= 0 && fd < loop->fd_count && loop->by_fd[fd] ? &loop->by_fd[fd]->sending : NULL;
}

static void *run_loop(void *argument) {
  struct loop *loop = argument;
  bool accepting = true;
  lod_interpose_on_thread(&loop->hooks);
  for (;;) {
    double until = atomic_load(&loop->http->drain_until);
    bool draining = until > 0, late = draining && loop->now >= until;
    MHD_UNSIGNED_LONG_LONG mhd_ms;
    double rest = 1e3 * (loop->next_slice - loop->now);
    int timeout_ms = draining ? DRAIN_SWEEP_MS : rest < 1 ? 1 : (int)rest;
    if (MHD_get_timeout(loop->daemon, &mhd_ms) == MHD_YES && mhd_ms < (MHD_UNSIGNED_LONG_LONG)timeout_ms)
      timeout_ms = (int)mhd_ms;
    take_events(loop, timeout_ms);
    atomic_store_explicit(&loop->beat, loop->now, memory_order_relaxed);
    if (draining && accepting) {
      accepting = false;
      stop_accepting(loop);
    }
    if (loop->now >= loop->next_slice || draining)
      loop->next_slice = loop->now + 1e-3 * sweep(loop, draining, late);
    MHD_run(loop->daemon);
    if (loop->guest_count > 0 && loop->count < loop->share)
      take_guests(loop);
    if (loop->streams)
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

static size_t keep_escapes(void *context, struct MHD_Connection *mhd, char *text) {
  (void)context;
  (void)mhd;
  return strlen(text); /* query.c decodes */
}

static void destroy_response(void *response) {
  MHD_destroy_response(response);
}

static bool add_watch(int epoll_fd, int fd, enum watch *watch) {
  struct epoll_event event = {.events = EPOLLIN, .data.ptr = watch};
  return epoll_ctl(epoll_fd, EPOLL_CTL_ADD, fd, &event) == 0;
}

/* Authenticated ciphers only, and the server chooses: with 128 bits a body costs a quarter less than with 256. */
static const char kCiphers[] = "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2:-CIPHER-ALL:+AES-128-GCM:+CHACHA20-POLY1305:+AES-256-GCM:"
                               "%SERVER_PRECEDENCE";

/* Takes the listener; -1: connections come from other loops. */
static enum lod_status start_loop(struct loop *loop, int listener, struct lod_problem *problem) {
  const struct lod_config *config = loop->http->service->config;
  const bool tls = loop->http->tls;
  unsigned flags = MHD_USE_EPOLL | MHD_USE_ERROR_LOG | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_TURBO | (tls ? MHD_USE_TLS : 0);
  if (listener < 0)
    flags |= MHD_USE_NO_LISTEN_SOCKET;
  struct MHD_OptionItem more[] = {
      {listener < 0 ? MHD_OPTION_LISTEN_BACKLOG_SIZE : MHD_OPTION_LISTEN_SOCKET, listener < 0 ? 1 : listener, NULL},
      {tls ? MHD_OPTION_HTTPS_CERT_CALLBACK : MHD_OPTION_END, 0, (void *)lod_tls_retrieve},
      {MHD_OPTION_HTTPS_PRIORITIES, 0, (void *)kCiphers},
      {MHD_OPTION_END, 0, NULL}};
  loop->listener = listener;
  loop->share = (uint32_t)((config->connections + loop->http->loop_count - 1) / loop->http->loop_count);
  loop->watch_own = WATCH_OWN;
  loop->watch_wake = WATCH_WAKE;
  loop->hooks = (struct lod_interpose){file_of, admit, sending, give_events, loop};
  loop->now = lod_loop_clock();
  atomic_init(&loop->beat, loop->now);
  /* No MHD_OPTION_CONNECTION_TIMEOUT: it counts inactivity alone; sweep() has the deadlines. */
  loop->daemon = MHD_start_daemon(
      flags, 0, NULL, NULL, lod_request_handle, loop, MHD_OPTION_EXTERNAL_LOGGER, log_mhd, NULL, MHD_OPTION_CONNECTION_LIMIT,
      (unsigned)loop->share, MHD_OPTION_CONNECTION_MEMORY_LIMIT, (size_t)POOL_BYTES, MHD_OPTION_NOTIFY_COMPLETED, lod_request_end, loop,
      MHD_OPTION_NOTIFY_CONNECTION, notify_connection, loop, MHD_OPTION_URI_LOG_CALLBACK, lod_request_begin, loop,
      MHD_OPTION_UNESCAPE_CALLBACK, keep_escapes, NULL, MHD_OPTION_STRICT_FOR_CLIENT, 1, MHD_OPTION_ARRAY, more, MHD_OPTION_END);
  if (!loop->daemon) {
    if (listener >= 0)
      close(listener);
    return lod_fail(problem, LOD_IO, "cannot-listen", "The HTTP server could not be started.");
  }
  loop->mhd_fd = MHD_get_daemon_info(loop->daemon, MHD_DAEMON_INFO_EPOLL_FD)->listen_fd;
  loop->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
  loop->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  if (loop->epoll_fd < 0 || loop->wake_fd < 0 || !add_watch(loop->mhd_fd, loop->epoll_fd, &loop->watch_own) ||
      !add_watch(loop->epoll_fd, loop->wake_fd, &loop->watch_wake))
    return lod_fail(problem, LOD_IO, "cannot-listen", "epoll: %s.", strerror(errno));
  loop->linger = lod_linger_create(loop->epoll_fd, WATCH_LINGER);
  if (!loop->linger)
    return lod_fail_memory(problem);
  return LOD_OK;
}

static enum lod_status start_loops(struct lod_http *http, int inherited, struct lod_problem *problem) {
  const struct lod_config *config = http->service->config;
  char address[LOD_ADDRESS_TEXT_MAX];
  int listeners[LOOPS_MAX];
  enum lod_status status = LOD_OK;
  http->tls = *config->tls_cert != 0;
  if (http->tls)
    status = lod_tls_load(config->tls_cert, config->tls_key, problem);
  if (status == LOD_OK)
    status = inherited >= 0 ? lod_socket_inherit(inherited, http->loop_count, listeners, address, problem)
                            : lod_socket_listen(config->listen, http->loop_count, listeners, address, problem);
  if (status == LOD_OK) {
    snprintf(http->url, sizeof http->url, "%s://%s", http->tls ? "https" : "http", address);
    for (uint32_t i = 0; i < http->loop_count; i++) {
      if (status == LOD_OK)
        status = start_loop(&http->loops[i], listeners[i], problem);
      else if (listeners[i] >= 0)
        close(listeners[i]);
    }
  }
  for (uint32_t i = 0; status == LOD_OK && i < http->loop_count; i++) {
    http->loops[i].started = pthread_create(&http->loops[i].thread, NULL, run_loop, &http->loops[i]) == 0;
    if (!http->loops[i].started)
      status = lod_fail(problem, LOD_MEMORY, "cannot-listen", "A thread of the HTTP server could not be started.");
  }
  return status;
}

enum lod_status lod_http_create(struct lod_service *service, int inherited, struct lod_http **result, struct lod_problem *problem) {
  const struct lod_config *config = service->config;
  long processors = sysconf(_SC_NPROCESSORS_ONLN);
  uint64_t loops = config->loops ? config->loops : processors > 0 ? (uint64_t)processors : 1;
  struct lod_http *http = calloc(1, sizeof *http);
  *result = NULL;
  if (!http)
    return lod_fail_memory(problem);
  http->service = service;
  http->memory_bytes = (size_t)sysconf(_SC_PHYS_PAGES) * (size_t)sysconf(_SC_PAGESIZE);
  http->loop_count = loops < LOOPS_MAX ? (uint32_t)loops : LOOPS_MAX;
  http->loops = calloc(http->loop_count, sizeof *http->loops);
  http->responses = lod_cache_create(config->cached_objects, destroy_response);
  http->memos = lod_cache_create(config->cached_objects, lod_memo_finish);
  service->responses = http->responses;
  service->memos = http->memos;
  http->background = lod_background_create(2);
  if (config->address_connections)
    http->addresses = lod_addresses_create((uint32_t)config->address_connections);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++) {
    http->loops[i].http = http;
    http->loops[i].epoll_fd = http->loops[i].wake_fd = http->loops[i].listener = http->loops[i].mhd_fd = -1;
    pthread_mutex_init(&http->loops[i].lock, NULL);
  }
  bool whole = http->loops && http->responses && http->memos && http->background && (http->addresses || !config->address_connections);
  enum lod_status status = whole ? start_loops(http, inherited, problem) : lod_fail_memory(problem);
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

double lod_http_idle_seconds(const struct lod_http *http) {
  double now = lod_loop_clock(), longest = 0;
  for (uint32_t i = 0; i < http->loop_count; i++) {
    double idle = now - atomic_load_explicit(&http->loops[i].beat, memory_order_relaxed);
    longest = idle > longest ? idle : longest;
  }
  return longest;
}

void lod_http_settings_changed(struct lod_http *http) {
  lod_cache_clear(http->memos); /* headers may differ now */
  lod_cache_clear(http->responses);
}

void lod_http_job_changed(struct lod_http *http) {
  lod_service_trim(http->service);
  for (uint32_t i = 0; i < http->loop_count; i++)
    lod_loop_wake(&http->loops[i]);
}

void lod_http_destroy(struct lod_http *http, double drain_seconds) {
  if (!http)
    return;
  atomic_store(&http->service->draining, true);
  atomic_store(&http->drain_until, lod_loop_clock() + drain_seconds);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++)
    if (http->loops[i].started)
      lod_loop_wake(&http->loops[i]);
  for (uint32_t i = 0; http->loops && i < http->loop_count; i++) {
    struct loop *loop = &http->loops[i];
    if (loop->started)
      pthread_join(loop->thread, NULL);
    if (loop->daemon)
      MHD_stop_daemon(loop->daemon);
    while (loop->guest_count > 0)
      close(loop->guests[--loop->guest_count].fd);
    free(loop->by_fd);
    lod_linger_destroy(loop->linger);
    if (loop->epoll_fd >= 0)
      close(loop->epoll_fd);
    if (loop->wake_fd >= 0)
      close(loop->wake_fd);
    pthread_mutex_destroy(&loop->lock);
  }
  lod_background_destroy(http->background);
  http->service->responses = http->service->memos = NULL;
  lod_cache_destroy(http->memos);
  lod_cache_destroy(http->responses);
  lod_addresses_destroy(http->addresses);
  lod_tls_finish();
  free(http->loops);
  free(http);
}
