/* Any bytes on the worker's socket, in pieces of any size: the reader finds exactly the frames that are there, and then says why it stops.
 * The first byte of the input is the size of the pieces. */
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/jobs/frame.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
  if (!condition)
    abort();
}

/* What the reader must find next in data: LOD_OK with a frame, LOD_BAD_INPUT, or LOD_IO at the end. */
static enum lod_status expect(const uint8_t *data, size_t size, size_t *payload_size) {
  if (size < 5)
    return LOD_IO;
  *payload_size = (size_t)data[0] | (size_t)data[1] << 8 | (size_t)data[2] << 16 | (size_t)data[3] << 24;
  if (*payload_size > LOD_FRAME_MAX)
    return LOD_BAD_INPUT;
  if (size - 5 < *payload_size)
    return LOD_IO;
  return data[4] == 0 ? LOD_BAD_INPUT : LOD_OK;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  if (size == 0 || size > 32768) /* a pipe holds 64 KiB */
    return 0;
  size_t piece = 1 + data[0];
  data++, size--;
  if (piece < size / 16) /* a run of many system calls is a slow one */
    piece = size / 16;
  int fds[2];
  require(pipe2(fds, O_NONBLOCK | O_CLOEXEC) == 0);
  struct lod_frame_reader reader = {0};
  size_t sent = 0, at = 0, payload_size = 0;
  enum lod_status status = LOD_OK;
  while (status == LOD_OK) {
    char type;
    status = lod_frame_read(fds[0], &reader, &type);
    if (status == LOD_OK && type == 0) {
      size_t count = size - sent < piece ? size - sent : piece;
      require(count == 0 || write(fds[1], data + sent, count) == (ssize_t)count);
      if (count == 0) {
        require(fds[1] >= 0);
        close(fds[1]);
        fds[1] = -1;
      }
      sent += count;
      continue;
    }
    if (status == LOD_MEMORY)
      break;
    require(status == expect(data + at, size - at, &payload_size));
    if (status == LOD_OK) {
      require(type == (char)data[at + 4] && reader.payload_size == payload_size && reader.payload[payload_size] == 0);
      require(memcmp(reader.payload, data + at + 5, payload_size) == 0);
      at += 5 + payload_size;
    }
  }
  lod_frame_reader_finish(&reader);
  close(fds[0]);
  if (fds[1] >= 0)
    close(fds[1]);
  return 0;
}
