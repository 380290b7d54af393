#include "server/http/address.h"

#include <netinet/in.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>

#include "server/store/table.h"

struct lod_address {
  char key[40];
  uint32_t count;
};

struct lod_addresses {
  uint32_t limit;
  pthread_mutex_t lock;
  struct lod_table table;
};

struct lod_addresses *lod_addresses_create(uint32_t limit) {
  struct lod_addresses *addresses = calloc(1, sizeof *addresses);
  if (!addresses)
    return NULL;
  addresses->limit = limit;
  pthread_mutex_init(&addresses->lock, NULL);
  return addresses;
}

void lod_addresses_destroy(struct lod_addresses *addresses) {
  if (!addresses)
    return;
  lod_table_finish(&addresses->table);
  pthread_mutex_destroy(&addresses->lock);
  free(addresses);
}

static void write_key(const struct sockaddr *address, char key[40]) {
  const uint8_t *bytes = NULL;
  int count = 0;
  if (address->sa_family == AF_INET) {
    bytes = (const uint8_t *)&((const struct sockaddr_in *)(const void *)address)->sin_addr;
    count = 4;
  } else if (address->sa_family == AF_INET6) {
    const struct in6_addr *in6 = &((const struct sockaddr_in6 *)(const void *)address)->sin6_addr;
    bytes = in6->s6_addr;
    count = 8;
    if (IN6_IS_ADDR_V4MAPPED(in6)) {
      bytes += 12;
      count = 4;
    }
  }
  static const char kDigits[] = "0123456789abcdef";
  *key++ = (char)('0' + count); /* Unix sockets: one address */
  for (int i = 0; i < count; i++) {
    *key++ = kDigits[bytes[i] >> 4];
    *key++ = kDigits[bytes[i] & 15];
  }
  *key = 0;
}

struct lod_address *lod_addresses_take(struct lod_addresses *addresses, const struct sockaddr *address) {
  char key[40];
  write_key(address, key);
  pthread_mutex_lock(&addresses->lock);
  struct lod_address *entry = lod_table_find(&addresses->table, key);
  if (!entry && lod_table_reserve(&addresses->table) && (entry = calloc(1, sizeof *entry)) != NULL) {
    snprintf(entry->key, sizeof entry->key, "%s", key);
    lod_table_insert(&addresses->table, entry->key, entry);
  }
  if (entry && addresses->limit && entry->count >= addresses->limit)
    entry = NULL;
  if (entry)
    entry->count++;
  pthread_mutex_unlock(&addresses->lock);
  return entry;
}

void lod_addresses_release(struct lod_addresses *addresses, struct lod_address *address) {
  if (!address)
    return;
  pthread_mutex_lock(&addresses->lock);
  if (--address->count == 0) {
    lod_table_remove(&addresses->table, address->key);
    free(address);
  }
  pthread_mutex_unlock(&addresses->lock);
}
