#include "server/http/interpose.h"

#include <dlfcn.h>
#include <errno.h>
#include <sys/sendfile.h>

static _Thread_local const struct lod_interpose *on_thread;

void lod_interpose_on_thread(const struct lod_interpose *hooks) {
  on_thread = hooks;
}

/* libc's own. Looked up once a call site: the second look-up of two threads at once finds the same. */
#define NEXT(name, type)                                                                                                                   \
  static _Atomic(type) next_##name;                                                                                                        \
  static type get_##name(void) {                                                                                                           \
    type found = next_##name;                                                                                                              \
    if (found == NULL) {                                                                                                                   \
      *(void **)&found = dlsym(RTLD_NEXT, #name);                                                                                          \
      next_##name = found;                                                                                                                 \
    }                                                                                                                                      \
    return found;                                                                                                                          \
  }
typedef ssize_t send_function(int, const void *, size_t, int);
typedef ssize_t sendmsg_function(int, const struct msghdr *, int);
typedef int accept4_function(int, struct sockaddr *, socklen_t *, int);
NEXT(send, send_function *)
NEXT(sendmsg, sendmsg_function *)
NEXT(accept4, accept4_function *)

static bool file_of(int fd, const void *bytes, size_t size, int *file, off_t *offset) {
  return on_thread != NULL && on_thread->file_of != NULL && on_thread->file_of(on_thread->context, fd, bytes, size, file, offset);
}

ssize_t send(int fd, const void *bytes, size_t size, int flags) {
  int file;
  off_t offset;
  if (file_of(fd, bytes, size, &file, &offset))
    return sendfile(fd, file, &offset, size);
  return get_send()(fd, bytes, size, flags);
}

/* libmicrohttpd's header and body: two parts. */
ssize_t sendmsg(int fd, const struct msghdr *message, int flags) {
  int file;
  off_t offset;
  const struct iovec *part = message->msg_iov;
  if (message->msg_iovlen != 2 || !file_of(fd, part[1].iov_base, part[1].iov_len, &file, &offset))
    return get_sendmsg()(fd, message, flags);
  ssize_t sent = get_send()(fd, part[0].iov_base, part[0].iov_len, flags | MSG_MORE);
  if (sent != (ssize_t)part[0].iov_len)
    return sent;
  ssize_t more = sendfile(fd, file, &offset, part[1].iov_len);
  return more < 0 ? (errno == EAGAIN || errno == EINTR ? sent : more) : sent + more;
}

int accept4(int listener, struct sockaddr *address, socklen_t *size, int flags) {
  socklen_t room = size ? *size : 0;
  for (;;) {
    if (size)
      *size = room;
    int fd = get_accept4()(listener, address, size, flags);
    if (fd < 0 || on_thread == NULL || on_thread->admit == NULL || on_thread->admit(on_thread->context, fd, address, size ? *size : 0))
      return fd;
  }
}
