#include "server/http/insert.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

void lod_insert_begin(struct lod_insert *insert, const char *name, const char *value) {
  int size = snprintf(insert->line, sizeof insert->line, "%s: %s\r\n", name, value);
  insert->size = (uint32_t)size;
  insert->sent = 0;
  insert->before = 0;
  insert->placed = false;
  insert->active = size > 0 && (size_t)size < sizeof insert->line;
}

void lod_insert_more(struct lod_insert *insert, const char *name, const char *value) {
  const size_t room = sizeof insert->line - insert->size;
  const int size = snprintf(insert->line + insert->size, room, "%s: %s\r\n", name, value);
  if (insert->active && size > 0 && (size_t)size < room)
    insert->size += (uint32_t)size;
}

static void put(struct iovec *out, int *count, const void *bytes, size_t size) {
  if (size > 0)
    out[(*count)++] = (struct iovec){(void *)bytes, size};
}

int lod_insert_parts(struct lod_insert *insert, const struct iovec *parts, int count, struct iovec out[LOD_INSERT_PARTS]) {
  assert(count >= 1 && count <= 2);
  const char *first = parts[0].iov_base;
  size_t size = parts[0].iov_len;
  int made = 0;
  if (insert->active && !insert->placed) {
    const char *end = size > 5 && memcmp(first, "HTTP/", 5) == 0 ? memchr(first, '\n', size) : NULL;
    insert->active = end != NULL; /* else this is no reply's beginning */
    insert->placed = true;
    insert->before = end != NULL ? (size_t)(end + 1 - first) : 0;
  }
  size_t before = insert->active && insert->before <= size ? insert->before : size;
  put(out, &made, first, before);
  if (insert->active && insert->before <= size)
    put(out, &made, insert->line + insert->sent, insert->size - insert->sent);
  put(out, &made, first + before, size - before);
  if (count == 2)
    put(out, &made, parts[1].iov_base, parts[1].iov_len);
  return made;
}

size_t lod_insert_account(struct lod_insert *insert, size_t sent) {
  if (!insert->active)
    return sent;
  size_t before = insert->before, left = insert->size - insert->sent;
  if (sent < before) {
    insert->before -= sent;
    return sent;
  }
  insert->before = 0;
  if (sent - before < left) {
    insert->sent += (uint32_t)(sent - before);
    return before;
  }
  insert->active = false;
  return sent - left;
}
