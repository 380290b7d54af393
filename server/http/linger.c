#include "server/http/linger.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

enum { LINGER_SECONDS = 10, LINGER_MAX = 64 };

struct lod_linger {
  int tag; /* first: epoll events point at it */
  int epoll_fd;
  int count;
  struct {
    int fd;
    double until;
  } list[LINGER_MAX];
};

struct lod_linger *lod_linger_create(int epoll_fd, int tag) {
  struct lod_linger *linger = calloc(1, sizeof *linger);
  if (linger) {
    linger->tag = tag;
    linger->epoll_fd = epoll_fd;
  }
  return linger;
}

static void end(struct lod_linger *linger, int index) {
  epoll_ctl(linger->epoll_fd, EPOLL_CTL_DEL, linger->list[index].fd, NULL);
  close(linger->list[index].fd);
  linger->list[index] = linger->list[--linger->count];
}

void lod_linger_destroy(struct lod_linger *linger) {
  while (linger && linger->count)
    end(linger, 0);
  free(linger);
}

void lod_linger_add(struct lod_linger *linger, int fd, double now) {
  int copy = linger->count < LINGER_MAX ? fcntl(fd, F_DUPFD_CLOEXEC, 0) : -1;
  if (copy < 0)
    return; /* too many at once: this peer sees a reset */
  shutdown(copy, SHUT_WR);
  linger->list[linger->count].fd = copy;
  linger->list[linger->count++].until = now + LINGER_SECONDS;
  struct epoll_event event = {.events = EPOLLIN | EPOLLRDHUP, .data.ptr = &linger->tag};
  if (epoll_ctl(linger->epoll_fd, EPOLL_CTL_ADD, copy, &event) != 0)
    end(linger, linger->count - 1);
}

void lod_linger_read(struct lod_linger *linger) {
  for (int i = linger->count - 1; i >= 0; i--) {
    ssize_t count = recv(linger->list[i].fd, NULL, 1 << 20, MSG_TRUNC | MSG_DONTWAIT); /* MSG_TRUNC: TCP discards, nothing is copied */
    if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR))
      end(linger, i);
  }
}

void lod_linger_sweep(struct lod_linger *linger, double now) {
  for (int i = linger->count - 1; i >= 0; i--)
    if (now > linger->list[i].until)
      end(linger, i);
}
