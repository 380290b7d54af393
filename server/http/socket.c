#include "server/http/socket.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/tcp.h> /* its tcp_info has the byte counts that netinet/tcp.h lacks */
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { BACKLOG = 1024, DEAD_PEER_MS = 60000 };

void lod_socket_text(const struct sockaddr *address, char text[LOD_ADDRESS_TEXT_MAX]) {
  char host[INET6_ADDRSTRLEN] = "?";
  if (address->sa_family == AF_INET) {
    const struct sockaddr_in *in = (const struct sockaddr_in *)(const void *)address;
    inet_ntop(AF_INET, &in->sin_addr, host, sizeof host);
    snprintf(text, LOD_ADDRESS_TEXT_MAX, "%s:%u", host, ntohs(in->sin_port));
  } else if (address->sa_family == AF_INET6) {
    const struct sockaddr_in6 *in6 = (const struct sockaddr_in6 *)(const void *)address;
    inet_ntop(AF_INET6, &in6->sin6_addr, host, sizeof host);
    snprintf(text, LOD_ADDRESS_TEXT_MAX, "[%s]:%u", host, ntohs(in6->sin6_port));
  } else {
    snprintf(text, LOD_ADDRESS_TEXT_MAX, "local");
  }
}

static enum lod_status resolve(const char *address, struct addrinfo **found, struct lod_problem *problem) {
  char host[256];
  const char *colon = strrchr(address, ':');
  size_t size = colon ? (size_t)(colon - address) : 0;
  if (!colon || size >= sizeof host || !colon[1] || strspn(colon + 1, "0123456789") != strlen(colon + 1))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--listen: '%s' is not HOST:PORT.", address);
  /* getaddrinfo would take the port modulo 65 536. */
  if (strtoull(colon + 1, NULL, 10) > UINT16_MAX)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--listen: '%s': a port is a number from 0 to 65535.", address);
  bool brackets = size >= 2 && address[0] == '[' && address[size - 1] == ']';
  snprintf(host, sizeof host, "%.*s", (int)(brackets ? size - 2 : size), address + brackets);
  struct addrinfo hints = {.ai_flags = AI_PASSIVE | AI_NUMERICSERV, .ai_socktype = SOCK_STREAM};
  int error = getaddrinfo(*host ? host : NULL, colon + 1, &hints, found);
  return error == 0 ? LOD_OK : lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--listen: '%s': %s.", address, gai_strerror(error));
}

static int open_bound(const struct addrinfo *info, const struct sockaddr *address, bool share) {
  const int on = 1, buffer = LOD_SEND_BUFFER_BYTES;
  const unsigned dead = DEAD_PEER_MS;
  int fd = socket(info->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0)
    return -1;
  setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  /* These are inherited by accepted sockets. */
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &buffer, sizeof buffer);
  setsockopt(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, &dead, sizeof dead);
  if ((share && setsockopt(fd, SOL_SOCKET, SO_REUSEPORT, &on, sizeof on) != 0) || bind(fd, address, info->ai_addrlen) != 0) {
    int error = errno;
    close(fd);
    errno = error;
    return -1;
  }
  return fd;
}

/* Opens `count` listeners at the address; false, and errno, when it is taken. *was_free is set when it was not just before. */
static bool open_all(const struct addrinfo *info, uint32_t count, int *listeners, struct sockaddr_storage *bound, bool *was_free) {
  socklen_t size = sizeof *bound;
  /* SO_REUSEPORT would let a second daemon of this user take half of the connections; a socket without it finds the port taken. It also
   * picks the free port when 0 is asked for. */
  int probe = open_bound(info, info->ai_addr, false);
  bool good = probe >= 0 && listen(probe, 1) == 0 && getsockname(probe, (struct sockaddr *)bound, &size) == 0;
  int error = errno;
  *was_free = *was_free || good;
  if (probe >= 0)
    close(probe);
  uint32_t opened = 0;
  for (; good && opened < count; opened++) {
    listeners[opened] = open_bound(info, (struct sockaddr *)bound, true);
    good = listeners[opened] >= 0 && listen(listeners[opened], BACKLOG) == 0;
    error = errno;
  }
  while (!good && opened-- > 0)
    if (listeners[opened] >= 0)
      close(listeners[opened]);
  errno = error;
  return good;
}

enum lod_status lod_socket_listen(const char *address, uint32_t count, int *listeners, char text[LOD_ADDRESS_TEXT_MAX],
                                  struct lod_problem *problem) {
  enum { TRIES = 200, PAUSE_NS = 10 * 1000 * 1000 };
  struct addrinfo *info;
  struct sockaddr_storage bound;
  LOD_TRY(resolve(address, &info, problem));
  /* A worker that another thread starts meanwhile has a copy of the probe until it runs a program of its own. And a free port that the
   * system picked may be taken by somebody between the probe and the listeners; then there is another. */
  int tries = TRIES;
  bool good, was_free = false;
  while (!(good = open_all(info, count, listeners, &bound, &was_free)) && errno == EADDRINUSE && was_free && --tries > 0)
    nanosleep(&(struct timespec){0, PAUSE_NS}, NULL);
  int error = errno;
  freeaddrinfo(info);
  if (!good)
    return lod_fail(problem, LOD_IO, "cannot-listen", "--listen: cannot listen on '%s': %s.", address, strerror(error));
  lod_socket_text((struct sockaddr *)&bound, text);
  return LOD_OK;
}

enum lod_status lod_socket_inherit(int fd, uint32_t count, int *listeners, char text[LOD_ADDRESS_TEXT_MAX], struct lod_problem *problem) {
  struct sockaddr_storage bound;
  socklen_t size = sizeof bound, number_size = sizeof(int);
  int listening = 0;
  const int on = 1, buffer = LOD_SEND_BUFFER_BYTES;
  const unsigned dead = DEAD_PEER_MS;
  if (getsockopt(fd, SOL_SOCKET, SO_ACCEPTCONN, &listening, &number_size) != 0 || !listening ||
      getsockname(fd, (struct sockaddr *)&bound, &size) != 0 || fcntl(fd, F_SETFD, FD_CLOEXEC) != 0 || fcntl(fd, F_SETFL, O_NONBLOCK) != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "cannot-listen",
                    "The socket that the service manager passed is not a listening stream socket.");
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &buffer, sizeof buffer);
  setsockopt(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, &dead, sizeof dead);
  lod_socket_text((struct sockaddr *)&bound, text);
  for (uint32_t i = 0; i < count; i++)
    listeners[i] = i == 0 ? fd : -1;
  return LOD_OK;
}

bool lod_socket_counts(int fd, uint64_t *received, uint64_t *acknowledged) {
  struct tcp_info info;
  socklen_t size = sizeof info;
  if (getsockopt(fd, IPPROTO_TCP, TCP_INFO, &info, &size) != 0 ||
      size < offsetof(struct tcp_info, tcpi_bytes_received) + sizeof info.tcpi_bytes_received)
    return false;
  *received = info.tcpi_bytes_received;
  *acknowledged = info.tcpi_bytes_acked;
  return true;
}
