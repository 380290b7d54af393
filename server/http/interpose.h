/* Three calls that libmicrohttpd makes into libc, answered here. The program's own definitions come before libc's in the order of symbols,
 * for every library that it loads, so no patched library is needed; without a hook on the calling thread they are libc's.
 *
 *   sendmsg, send   a body of many bytes goes out by sendfile(2) when that is cheaper: libmicrohttpd's own way to do that pushes the
 *                   header in a segment of its own, sets two socket options a response and sends 128 KiB a turn, at twice the CPU
 *   accept4         connections may be handed to another loop */
#ifndef LOD_SERVER_HTTP_INTERPOSE_H
#define LOD_SERVER_HTTP_INTERPOSE_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/socket.h>
#include <sys/types.h>

struct lod_interpose {
  /* True when `size` bytes at `bytes`, about to be sent on the socket, are those of a file from *offset on and shall be sent as such. */
  bool (*file_of)(void *context, int socket, const void *bytes, size_t size, int *file, off_t *offset);
  /* False: the accepted socket was taken over, and the next is wanted. */
  bool (*admit)(void *context, int socket, const struct sockaddr *address, socklen_t size);
  void *context;
};

/* For the calling thread; NULL ends it. Not owned. */
void lod_interpose_on_thread(const struct lod_interpose *hooks);

#endif
