/* Listening sockets, and what the kernel knows of a connection. */
#ifndef LOD_SERVER_HTTP_SOCKET_H
#define LOD_SERVER_HTTP_SOCKET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

#include "core/base/status.h"

enum { LOD_ADDRESS_TEXT_MAX = 80 };

/* Of each connection. With the kernel's default a 20 MB reader that stalls holds up to 3.6 MB, and a fast one gets half the throughput:
 * measured, see README. */
enum { LOD_SEND_BUFFER_BYTES = 512 << 10 };

/* Opens `count` listeners of one address, "HOST:PORT", "[HOST]:PORT" or ":PORT" (every interface), that share the port by SO_REUSEPORT,
 * so the kernel spreads connections over them. Port 0: a free one. LOD_IO when another process holds the port, of this user too.
 * text: the address as it is now, "127.0.0.1:8080". */
LOD_WARN_UNUSED enum lod_status lod_socket_listen(const char *address, uint32_t count, int *listeners, char text[LOD_ADDRESS_TEXT_MAX],
                                                  struct lod_problem *problem);

/* Bytes received from the peer and acknowledged by it since it connected; false when the kernel does not tell. */
bool lod_socket_counts(int fd, uint64_t *received, uint64_t *acknowledged);

/* "127.0.0.1:40312", "[::1]:40312" */
void lod_socket_text(const struct sockaddr *address, char text[LOD_ADDRESS_TEXT_MAX]);

/* Takes a listening socket that somebody else opened: the first listener; the others are -1. */
LOD_WARN_UNUSED enum lod_status lod_socket_inherit(int fd, uint32_t count, int *listeners, char text[LOD_ADDRESS_TEXT_MAX],
                                                   struct lod_problem *problem);

#endif
