/* Closing after an early refusal: a connection whose peer is still sending is read, and what comes is thrown away, for a short while.
 * A close with unread bytes would be a reset, and a reset takes the refusal from the peer before it was read. */
#ifndef LOD_SERVER_HTTP_LINGER_H
#define LOD_SERVER_HTTP_LINGER_H

struct lod_linger;

/* epoll_fd: not owned; where readable sockets are reported, with a pointer to an int that is `tag`. NULL: memory. */
struct lod_linger *lod_linger_create(int epoll_fd, int tag);
/* Closes all. NULL is allowed. */
void lod_linger_destroy(struct lod_linger *linger);
/* Keeps a duplicate of fd, says that nothing more will be sent, and reads until the peer closes or its time is over. now: seconds. */
void lod_linger_add(struct lod_linger *linger, int fd, double now);
/* Reads what is there. */
void lod_linger_read(struct lod_linger *linger);
void lod_linger_sweep(struct lod_linger *linger, double now);

#endif
