/* Header lines that are put into a reply on its way to the socket. Prepared replies are shared by all connections; what differs from
 * request to request, its id among others, goes in here, behind the status line, and libmicrohttpd never knows. */
#ifndef LOD_SERVER_HTTP_INSERT_H
#define LOD_SERVER_HTTP_INSERT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>
#include <sys/uio.h>

enum { LOD_INSERT_MAX = 192 };

struct lod_insert {
  char line[LOD_INSERT_MAX]; /* "Name: value\r\n", once or more often */
  uint32_t size, sent;
  size_t before; /* bytes of the reply that go out before the line, from the next send on */
  bool active;   /* not yet sent, or not to its end */
  bool placed;   /* `before` is known */
};

/* For the reply that is sent next. */
void lod_insert_begin(struct lod_insert *insert, const char *name, const char *value);
/* Another line behind those that there are; left out when it does not fit. Before anything is sent. */
void lod_insert_more(struct lod_insert *insert, const char *name, const char *value);

/* The bytes of one or two parts, whose first begins with the reply's status line, with the line among them; returns how many parts. One
 * part more than LOD_INSERT_PARTS is never needed. */
enum { LOD_INSERT_PARTS = 4 };
int lod_insert_parts(struct lod_insert *insert, const struct iovec *parts, int count, struct iovec out[LOD_INSERT_PARTS]);

/* `sent` bytes of what lod_insert_parts gave went out: how many of the caller's own these were. 0: the line alone has moved on. */
size_t lod_insert_account(struct lod_insert *insert, size_t sent);

#endif
