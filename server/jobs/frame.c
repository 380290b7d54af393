#include "server/jobs/frame.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { HEADER = 5 };

/* send() rather than write(): a peer that is gone must be an error here, not a SIGPIPE. Tests also use pipes. */
static ssize_t write_some(int fd, const char *bytes, size_t size) {
  ssize_t sent = send(fd, bytes, size, MSG_NOSIGNAL);
  return sent < 0 && errno == ENOTSOCK ? write(fd, bytes, size) : sent;
}

static enum lod_status write_all(int fd, const char *bytes, size_t size) {
  while (size > 0) {
    ssize_t sent = write_some(fd, bytes, size);
    if (sent < 0 && errno == EINTR)
      continue;
    if (sent <= 0)
      return LOD_IO;
    bytes += sent;
    size -= (size_t)sent;
  }
  return LOD_OK;
}

enum lod_status lod_frame_write(int fd, char type, const char *payload, size_t size) {
  if (size > LOD_FRAME_MAX) {
    errno = EMSGSIZE;
    return LOD_IO;
  }
  const char header[HEADER] = {(char)(size & 0xff), (char)(size >> 8 & 0xff), (char)(size >> 16 & 0xff), (char)(size >> 24 & 0xff), type};
  LOD_TRY(write_all(fd, header, sizeof header));
  return write_all(fd, payload, size);
}

/* Up to `size` bytes. LOD_OK with *got 0: no more for now. */
static enum lod_status read_some(int fd, void *bytes, size_t size, size_t *got) {
  *got = 0;
  ssize_t count;
  do
    count = read(fd, bytes, size);
  while (count < 0 && errno == EINTR);
  if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
    return LOD_OK;
  if (count == 0)
    errno = 0;
  if (count <= 0)
    return LOD_IO;
  *got = (size_t)count;
  return LOD_OK;
}

static enum lod_status start_payload(struct lod_frame_reader *reader) {
  const uint8_t *header = reader->header;
  uint32_t size = (uint32_t)header[0] | (uint32_t)header[1] << 8 | (uint32_t)header[2] << 16 | (uint32_t)header[3] << 24;
  if (size > LOD_FRAME_MAX)
    return LOD_BAD_INPUT;
  char *payload = realloc(reader->payload, (size_t)size + 1);
  if (payload == NULL)
    return LOD_MEMORY;
  reader->payload = payload;
  reader->payload_size = 0;
  reader->payload_expected = size;
  return LOD_OK;
}

enum lod_status lod_frame_read(int fd, struct lod_frame_reader *reader, char *type) {
  *type = 0;
  while (reader->header_size < HEADER) {
    size_t got;
    LOD_TRY(read_some(fd, reader->header + reader->header_size, HEADER - reader->header_size, &got));
    if (got == 0)
      return LOD_OK;
    reader->header_size += got;
    if (reader->header_size == HEADER) {
      enum lod_status status = start_payload(reader);
      if (status != LOD_OK) {
        reader->header_size = 0;
        return status;
      }
    }
  }
  while (reader->payload_size < reader->payload_expected) {
    size_t got;
    LOD_TRY(read_some(fd, reader->payload + reader->payload_size, reader->payload_expected - reader->payload_size, &got));
    if (got == 0)
      return LOD_OK;
    reader->payload_size += got;
  }
  reader->payload[reader->payload_size] = 0;
  reader->header_size = 0;
  *type = (char)reader->header[HEADER - 1];
  return *type == 0 ? LOD_BAD_INPUT : LOD_OK; /* type 0 would read as "nothing yet" */
}

void lod_frame_reader_finish(struct lod_frame_reader *reader) {
  free(reader->payload);
  *reader = (struct lod_frame_reader){0};
}
