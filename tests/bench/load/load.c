#include "tests/bench/load/load.h"

#include <arpa/inet.h>
#include <errno.h>
#include <gnutls/gnutls.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { HEADER_MAX = 4096, BUFFER = 256 << 10, EVENTS = 512, SOURCES = 100, WARM_SECONDS = 2 };

struct client {
  struct load_group *group;
  int fd;
  bool measured, warm, shaking;
  gnutls_session_t session;
  uint64_t rest; /* bytes of the body still to come */
  char header[HEADER_MAX];
  size_t header_size;
  double since;         /* of the question in progress */
  double due;           /* of the next question, while pausing; 0 = not */
  size_t written;       /* of the request */
  struct client *later; /* in the list of those who pause */
};

struct loop {
  int epoll;
  char *buffer;
  double now;
  int warm;                       /* connections that had an answer */
  struct client *pausing, **last; /* in order of `due`: every group pauses for the same time */
};

static gnutls_certificate_credentials_t credentials;

double load_now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static double cpu_now(void) {
  struct timespec time;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static size_t bucket_of(double seconds) {
  double place = LOAD_STEPS * log2(seconds * 1e9);
  return place < 0 ? 0 : place >= LOAD_BUCKETS ? LOAD_BUCKETS - 1 : (size_t)place;
}

double load_quantile(const struct load_group *group, double share) {
  uint64_t total = 0, sum = 0;
  for (size_t i = 0; i < LOAD_BUCKETS; i++)
    total += group->histogram[i];
  for (size_t i = 0; i < LOAD_BUCKETS; i++) {
    sum += group->histogram[i];
    if (total && (double)sum >= share * (double)total)
      return exp2((double)(i + 1) / LOAD_STEPS) * 1e-9;
  }
  return 0;
}

/* ---- one connection ---- */

static void drop(struct client *client) {
  if (client->session)
    gnutls_deinit(client->session);
  client->session = NULL;
  if (client->fd >= 0)
    close(client->fd);
  client->fd = -1;
}

static bool open_client(struct loop *loop, struct client *client) {
  /* Many connections need more source addresses than one: a pair of addresses has 28 000 ports. */
  static unsigned source;
  struct sockaddr_in from = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK + source++ % SOURCES)};
  struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(client->group->port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  const int on = 1;
  const struct linger reset = {.l_onoff = 1, .l_linger = 0}; /* no TIME_WAIT: thousands of connections a second */
  client->header_size = 0;
  client->rest = 0;
  client->written = 0;
  client->fd = socket(AF_INET, SOCK_STREAM, 0);
  if (client->fd < 0)
    return false;
  setsockopt(client->fd, IPPROTO_IP, 24 /* IP_BIND_ADDRESS_NO_PORT */, &on, sizeof on);
  setsockopt(client->fd, SOL_SOCKET, SO_LINGER, &reset, sizeof reset);
  struct epoll_event event = {.events = EPOLLIN, .data.ptr = client};
  if (bind(client->fd, (struct sockaddr *)&from, sizeof from) != 0 || connect(client->fd, (struct sockaddr *)&to, sizeof to) != 0 ||
      epoll_ctl(loop->epoll, EPOLL_CTL_ADD, client->fd, &event) != 0)
    return false;
  client->shaking = client->group->tls;
  if (client->shaking) {
    gnutls_init(&client->session, GNUTLS_CLIENT | GNUTLS_NONBLOCK);
    gnutls_priority_set_direct(client->session, "NORMAL:-VERS-ALL:+VERS-TLS1.3:-GROUP-ALL:+GROUP-SECP256R1:-CIPHER-ALL:+AES-256-GCM", NULL);
    gnutls_credentials_set(client->session, GNUTLS_CRD_CERTIFICATE, credentials);
    gnutls_transport_set_int(client->session, client->fd);
  }
  return true;
}

static bool ask(struct client *client) {
  const char *text = client->group->request;
  size_t size = strlen(text);
  ssize_t sent = client->session ? gnutls_record_send(client->session, text, size) : send(client->fd, text, size, MSG_NOSIGNAL);
  return sent == (ssize_t)size;
}

static bool shake_hands(struct client *client) {
  int code = gnutls_handshake(client->session);
  if (code == 0)
    client->shaking = false;
  return code == 0 ? ask(client) : gnutls_error_is_fatal(code) == 0;
}

static bool begin(struct loop *loop, struct client *client) {
  client->since = load_now();
  drop(client);
  return open_client(loop, client) && (client->shaking ? shake_hands(client) : ask(client));
}

static ssize_t receive(struct client *client, char *buffer, size_t size) {
  if (!client->session) {
    ssize_t count = recv(client->fd, buffer, size, MSG_DONTWAIT);
    return count < 0 && errno == EAGAIN ? -2 : count;
  }
  for (;;) {
    ssize_t count = gnutls_record_recv(client->session, buffer, size);
    if (count == GNUTLS_E_AGAIN)
      return -2;
    if (count >= 0 || gnutls_error_is_fatal((int)count))
      return count;
  }
}

enum progress { WAITING, WHOLE, BROKEN };

/* Takes a piece of an answer. */
static enum progress take(struct client *client, const char *bytes, size_t size) {
  client->group->bytes += client->measured ? size : 0;
  while (size) {
    if (client->rest) {
      size_t part = size < client->rest ? size : (size_t)client->rest;
      client->rest -= part;
      bytes += part;
      size -= part;
      if (!client->rest)
        return size ? BROKEN : WHOLE;
      continue;
    }
    size_t old = client->header_size, room = HEADER_MAX - 1 - old, part = size < room ? size : room;
    memcpy(client->header + old, bytes, part);
    client->header[old + part] = 0;
    client->header_size = old + part;
    const char *end = strstr(client->header, "\r\n\r\n");
    if (!end && part < size)
      return BROKEN;
    if (!end)
      return WAITING;
    size_t used = (size_t)(end + 4 - client->header) - old;
    bytes += used;
    size -= used;
    client->header_size = 0;
    unsigned status = client->header[8] == ' ' ? (unsigned)strtoul(client->header + 9, NULL, 10) : 0;
    const char *length = strcasestr(client->header, "\r\nContent-Length:");
    if (status != client->group->status)
      return BROKEN;
    client->rest = status != 304 && status != 204 && length && length < end ? strtoull(length + 17, NULL, 10) : 0;
    if (!client->rest)
      return size ? BROKEN : WHOLE;
  }
  return WAITING;
}

static bool next(struct loop *loop, struct client *client) {
  struct load_group *group = client->group;
  loop->warm += !client->warm;
  client->warm = true;
  if (!client->measured)
    return true; /* asked once */
  group->answers++;
  group->histogram[bucket_of(load_now() - client->since)]++;
  if (group->reconnect)
    return begin(loop, client);
  if (group->pause_seconds > 0) {
    client->due = loop->now + group->pause_seconds;
    client->later = NULL;
    *loop->last = client;
    loop->last = &client->later;
    return true;
  }
  client->since = load_now();
  return ask(client);
}

static bool handle(struct loop *loop, struct client *client) {
  if (client->shaking)
    return shake_hands(client);
  for (;;) {
    ssize_t count = receive(client, loop->buffer, BUFFER);
    if (count == -2)
      return true;
    if (count <= 0)
      return false;
    enum progress progress = take(client, loop->buffer, (size_t)count);
    if (progress == BROKEN)
      return false;
    if (progress == WHOLE)
      return next(loop, client);
    if (!client->session && count < BUFFER)
      return true; /* no more for now: saves the call that would say so */
  }
}

/* ---- all ---- */

static void wake_pausing(struct loop *loop) {
  while (loop->pausing && loop->pausing->due <= loop->now) {
    struct client *client = loop->pausing;
    loop->pausing = client->later;
    if (!loop->pausing)
      loop->last = &loop->pausing;
    client->due = 0;
    client->since = load_now();
    if (!ask(client)) {
      client->group->errors++;
      (void)begin(loop, client);
    }
  }
}

static struct client *open_all(struct loop *loop, struct load_group *groups, int count, int *total) {
  *total = 0;
  for (int i = 0; i < count; i++)
    *total += groups[i].connections + groups[i].silent;
  struct client *clients = calloc((size_t)*total, sizeof *clients), *client = clients;
  for (int i = 0; clients && i < count; i++) {
    if (groups[i].tls && !credentials)
      gnutls_certificate_allocate_credentials(&credentials);
    for (int k = 0; k < groups[i].connections + groups[i].silent; k++, client++) {
      *client = (struct client){.group = &groups[i], .fd = -1, .measured = k < groups[i].connections};
      if (!begin(loop, client))
        groups[i].errors++;
    }
  }
  return clients;
}

static void forget_results(struct load_group *groups, int count) {
  for (int i = 0; i < count; i++) {
    groups[i].answers = groups[i].bytes = groups[i].errors = 0;
    memset(groups[i].histogram, 0, sizeof groups[i].histogram);
  }
}

/* Handles what is there, until `until` or, when warm is set, until every connection had an answer. */
static void run_until(struct loop *loop, double until, int warm) {
  while ((loop->now = load_now()) < until && (warm == 0 || loop->warm < warm)) {
    struct epoll_event events[EVENTS];
    double left = loop->pausing ? loop->pausing->due - loop->now : 0.1;
    int ready = epoll_wait(loop->epoll, events, EVENTS, left <= 0 ? 0 : (int)(left * 1000) + 1);
    loop->now = load_now();
    for (int i = 0; i < ready; i++) {
      struct client *client = events[i].data.ptr;
      if (handle(loop, client))
        continue;
      client->group->errors++;
      if (client->due == 0)
        (void)begin(loop, client);
      else
        drop(client);
    }
    wake_pausing(loop);
  }
}

double load_run(struct load_group *groups, int count, double *seconds, void (*started)(void *context), void *context) {
  struct rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) == 0) {
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
  }
  struct loop loop = {.epoll = epoll_create1(EPOLL_CLOEXEC), .buffer = malloc(BUFFER), .now = load_now()};
  loop.last = &loop.pausing;
  forget_results(groups, count);
  int total;
  struct client *clients = open_all(&loop, groups, count, &total);
  if (!clients || !loop.buffer || loop.epoll < 0)
    abort(); /* a bench without memory */
  run_until(&loop, load_now() + WARM_SECONDS, total);
  uint64_t errors = 0;
  for (int i = 0; i < count; i++)
    errors += groups[i].errors;
  forget_results(groups, count);
  groups->errors = errors;
  if (started)
    started(context);
  double began = load_now(), cpu = cpu_now();
  run_until(&loop, began + *seconds, 0);
  cpu = cpu_now() - cpu;
  *seconds = loop.now - began;
  for (int i = 0; i < total; i++)
    drop(&clients[i]);
  free(clients);
  free(loop.buffer);
  close(loop.epoll);
  return cpu;
}
