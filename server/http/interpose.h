/* Calls that libmicrohttpd makes into libc and GnuTLS, answered here. The program's own definitions come before those of libraries in the
 * order of symbols, for every library that it loads, so no patched library is needed; without hooks on the calling thread they are the
 * libraries' own.
 *
 *   sendmsg, send       a body of many bytes goes out by sendfile(2) when that is cheaper: libmicrohttpd's own way to do that pushes the
 *                       header in a segment of its own, sets two socket options a response and sends 128 KiB a turn, at twice the CPU;
 *                       and a line of its own is put into a shared reply's header (insert.h)
 *   gnutls_record_send  header and body in one record where they fit: libmicrohttpd makes two, with a call each
 *   accept4             connections may be handed to another loop
 *   epoll_wait          the loop has waited already, on libmicrohttpd's own descriptors, and has its events
 *   setsockopt          TCP_NODELAY is inherited from the listener */
#ifndef LOD_SERVER_HTTP_INTERPOSE_H
#define LOD_SERVER_HTTP_INTERPOSE_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/types.h>

#include "server/http/insert.h"

/* Header and body of a reply as one TLS record, of a connection. */
enum { LOD_RECORD_BYTES = 16 << 10 };
struct lod_record {
  char *bytes;         /* LOD_RECORD_BYTES, or NULL; its owner frees it */
  size_t held;         /* of a header that waits for its body */
  size_t size, answer; /* a record that GnuTLS could not send whole yet, and what its caller is to be told when it is out */
};

/* What is known of a connection's reply in progress. */
struct lod_sending {
  struct lod_insert insert;
  struct lod_record record;
  bool body_follows; /* its header does not come alone */
};

struct lod_interpose {
  /* True when `size` bytes at `bytes`, about to be sent on the socket, are those of a file from *offset on and shall be sent as such. */
  bool (*file_of)(void *context, int socket, const void *bytes, size_t size, int *file, off_t *offset);
  /* False: the accepted socket was taken over, and the next is wanted. */
  bool (*admit)(void *context, int socket, const struct sockaddr *address, socklen_t size);
  /* The connection of a socket; NULL: nothing to do for it. */
  struct lod_sending *(*sending)(void *context, int socket);
  /* Events of libmicrohttpd's epoll descriptor that the loop has fetched; -1: ask the kernel. */
  int (*events)(void *context, int epoll_fd, struct epoll_event *events, int most);
  void *context;
};

/* For the calling thread; NULL ends it. Not owned. */
void lod_interpose_on_thread(const struct lod_interpose *hooks);

#endif
