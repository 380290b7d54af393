#include "server/http/interpose.h"

#include <dlfcn.h>
#include <errno.h>
#include <gnutls/gnutls.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>

static _Thread_local const struct lod_interpose *on_thread;

void lod_interpose_on_thread(const struct lod_interpose *hooks) {
  on_thread = hooks;
}

/* The libraries' own. Looked up once: the second look-up of two threads at once finds the same. */
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
typedef int epoll_wait_function(int, struct epoll_event *, int, int);
typedef int setsockopt_function(int, int, int, const void *, socklen_t);
typedef ssize_t record_send_function(gnutls_session_t, const void *, size_t);
NEXT(send, send_function *)
NEXT(sendmsg, sendmsg_function *)
NEXT(accept4, accept4_function *)
NEXT(epoll_wait, epoll_wait_function *)
NEXT(setsockopt, setsockopt_function *)
NEXT(gnutls_record_send, record_send_function *)

/* ---- replies ---- */

static bool file_of(int fd, const void *bytes, size_t size, int *file, off_t *offset) {
  return on_thread != NULL && on_thread->file_of != NULL && on_thread->file_of(on_thread->context, fd, bytes, size, file, offset);
}

static struct lod_sending *sending_of(int fd) {
  return on_thread != NULL && on_thread->sending != NULL ? on_thread->sending(on_thread->context, fd) : NULL;
}

/* The parts, with the line among them. */
static ssize_t send_inserted(struct lod_insert *insert, int fd, const struct iovec *parts, int count, int flags) {
  struct iovec out[LOD_INSERT_PARTS];
  const struct msghdr message = {.msg_iov = out, .msg_iovlen = (size_t)lod_insert_parts(insert, parts, count, out)};
  ssize_t sent = get_sendmsg()(fd, &message, flags);
  if (sent < 0)
    return sent;
  size_t own = lod_insert_account(insert, (size_t)sent);
  if (own > 0)
    return (ssize_t)own;
  errno = EAGAIN; /* a part of the line alone */
  return -1;
}

ssize_t send(int fd, const void *bytes, size_t size, int flags) {
  int file;
  off_t offset;
  struct lod_sending *sending = sending_of(fd);
  if (sending != NULL && sending->insert.active) {
    const struct iovec part = {(void *)bytes, size};
    return send_inserted(&sending->insert, fd, &part, 1, flags);
  }
  if (file_of(fd, bytes, size, &file, &offset))
    return sendfile(fd, file, &offset, size);
  return get_send()(fd, bytes, size, flags);
}

/* libmicrohttpd's header and body: two parts. */
ssize_t sendmsg(int fd, const struct msghdr *message, int flags) {
  int file;
  off_t offset;
  const struct iovec *part = message->msg_iov;
  struct lod_sending *sending = message->msg_iovlen == 1 || message->msg_iovlen == 2 ? sending_of(fd) : NULL;
  struct lod_insert *insert = sending != NULL && sending->insert.active ? &sending->insert : NULL;
  if (message->msg_iovlen != 2 || !file_of(fd, part[1].iov_base, part[1].iov_len, &file, &offset))
    return insert != NULL ? send_inserted(insert, fd, part, (int)message->msg_iovlen, flags) : get_sendmsg()(fd, message, flags);
  ssize_t sent = insert != NULL ? send_inserted(insert, fd, part, 1, flags | MSG_MORE)
                                : get_send()(fd, part[0].iov_base, part[0].iov_len, flags | MSG_MORE);
  if (sent != (ssize_t)part[0].iov_len || (insert != NULL && insert->active))
    return sent;
  ssize_t more = sendfile(fd, file, &offset, part[1].iov_len);
  return more < 0 ? (errno == EAGAIN || errno == EINTR ? sent : more) : sent + more;
}

/* ---- the same over TLS ---- */

/* Sends what is in the record; `answer` is told when it is out. GnuTLS wants the same bytes again after GNUTLS_E_AGAIN. */
static ssize_t send_record(gnutls_session_t session, struct lod_record *record) {
  ssize_t sent = get_gnutls_record_send()(session, record->bytes, record->size);
  if (sent < 0)
    return sent;
  record->size = 0;
  return (ssize_t)record->answer;
}

/* The beginning of a reply: with the line among it, and held back for its body. */
static ssize_t begin_record(gnutls_session_t session, struct lod_sending *sending, const void *bytes, size_t size) {
  struct lod_record *record = &sending->record;
  const struct iovec part = {(void *)bytes, size};
  struct iovec out[LOD_INSERT_PARTS];
  int count = lod_insert_parts(&sending->insert, &part, 1, out);
  char *at = record->bytes;
  for (int i = 0; i < count; at += out[i++].iov_len)
    memcpy(at, out[i].iov_base, out[i].iov_len);
  sending->insert.active = false;
  size_t total = (size_t)(at - record->bytes);
  if (sending->body_follows) {
    record->held = total;
    return (ssize_t)size;
  }
  record->size = total;
  record->answer = size;
  return send_record(session, record);
}

ssize_t gnutls_record_send(gnutls_session_t session, const void *bytes, size_t size) {
  struct lod_sending *sending = on_thread != NULL ? sending_of(gnutls_transport_get_int(session)) : NULL;
  struct lod_record *record = sending != NULL ? &sending->record : NULL;
  if (record == NULL)
    return get_gnutls_record_send()(session, bytes, size);
  if (record->size > 0)
    return send_record(session, record);
  if (record->held > 0) {
    size_t room = LOD_RECORD_BYTES - record->held, taken = size < room ? size : room;
    memcpy(record->bytes + record->held, bytes, taken);
    record->size = record->held + taken;
    record->answer = taken;
    record->held = 0;
    return send_record(session, record);
  }
  if (!sending->insert.active || size + LOD_INSERT_MAX > LOD_RECORD_BYTES)
    return get_gnutls_record_send()(session, bytes, size);
  if (record->bytes == NULL)
    record->bytes = malloc(LOD_RECORD_BYTES);
  return record->bytes != NULL ? begin_record(session, sending, bytes, size) : get_gnutls_record_send()(session, bytes, size);
}

/* ---- connections and events ---- */

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

int epoll_wait(int fd, struct epoll_event *events, int most, int timeout_ms) {
  int count = on_thread != NULL && on_thread->events != NULL ? on_thread->events(on_thread->context, fd, events, most) : -1;
  return count >= 0 ? count : get_epoll_wait()(fd, events, most, timeout_ms);
}

int setsockopt(int fd, int level, int name, const void *value, socklen_t size) {
  if (level == IPPROTO_TCP && name == TCP_NODELAY && size == sizeof(int) && on_thread != NULL && *(const int *)value != 0)
    return 0;
  return get_setsockopt()(fd, level, name, value, size);
}
