/* How many connections each address has: one client shall not take them all. An IPv6 network of 64 bits, which is what one customer gets,
 * counts as one address. Any thread. */
#ifndef LOD_SERVER_HTTP_ADDRESS_H
#define LOD_SERVER_HTTP_ADDRESS_H

#include <stdint.h>
#include <sys/socket.h>

struct lod_addresses;
struct lod_address; /* one connection's share */

/* limit: most connections of one address; 0 = no limit. NULL: memory. */
struct lod_addresses *lod_addresses_create(uint32_t limit);
/* All must have been released. NULL is allowed. */
void lod_addresses_destroy(struct lod_addresses *addresses);
/* NULL: this address has as many as it may (or memory is out). */
struct lod_address *lod_addresses_take(struct lod_addresses *addresses, const struct sockaddr *address);
/* NULL is allowed. */
void lod_addresses_release(struct lod_addresses *addresses, struct lod_address *address);

#endif
