/* Frames: what is written is read, in pieces of any size; what is not a frame is refused. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/jobs/frame.h"

static void a_frame_is_read_as_it_was_written_byte_by_byte(void **state) {
  (void)state;
  int from[2], to[2];
  assert_int_equal(pipe2(from, O_NONBLOCK), 0);
  assert_int_equal(pipe2(to, O_NONBLOCK), 0);
  static const char *const kPayloads[] = {"{}", "", "{\"stage\":\"certify\",\"progress\":0.42}"};
  for (size_t i = 0; i < 3; i++)
    assert_int_equal(lod_frame_write(from[1], (char)('P' + i), kPayloads[i], strlen(kPayloads[i])), LOD_OK);
  struct lod_frame_reader reader = {0};
  size_t frames = 0;
  char byte, type;
  while (read(from[0], &byte, 1) == 1) {
    assert_int_equal(write(to[1], &byte, 1), 1);
    assert_int_equal(lod_frame_read(to[0], &reader, &type), LOD_OK);
    if (type == 0)
      continue;
    assert_int_equal(type, 'P' + frames);
    assert_int_equal(reader.payload_size, strlen(kPayloads[frames]));
    assert_string_equal(reader.payload, kPayloads[frames]);
    frames++;
  }
  assert_int_equal(frames, 3);
  close(to[1]);
  assert_int_equal(lod_frame_read(to[0], &reader, &type), LOD_IO);
  lod_frame_reader_finish(&reader);
  close(from[0]);
  close(from[1]);
  close(to[0]);
}

static void the_largest_frame_passes_and_a_larger_one_does_not(void **state) {
  (void)state;
  int fds[2];
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, fds), 0);
  char *payload = calloc(1, LOD_FRAME_MAX + 1);
  memset(payload, 'x', LOD_FRAME_MAX);
  assert_int_equal(lod_frame_write(fds[0], 'J', payload, LOD_FRAME_MAX + 1), LOD_IO);
  pid_t child = fork();
  if (child == 0)
    _exit(lod_frame_write(fds[0], 'J', payload, LOD_FRAME_MAX) == LOD_OK ? 0 : 1);
  struct lod_frame_reader reader = {0};
  char type = 0;
  assert_int_equal(lod_frame_read(fds[1], &reader, &type), LOD_OK);
  assert_int_equal(type, 'J');
  assert_int_equal(reader.payload_size, LOD_FRAME_MAX);
  assert_memory_equal(reader.payload, payload, LOD_FRAME_MAX);
  const unsigned char header[5] = {1, 0, 0x10, 0, 'J'}; /* LOD_FRAME_MAX + 1 */
  assert_int_equal(write(fds[0], header, sizeof header), sizeof header);
  assert_int_equal(lod_frame_read(fds[1], &reader, &type), LOD_BAD_INPUT);
  assert_int_equal(type, 0);
  lod_frame_reader_finish(&reader);
  free(payload);
  close(fds[0]);
  close(fds[1]);
}

static void every_truncation_ends_as_an_io_failure(void **state) {
  (void)state;
  const unsigned char frame[] = {3, 0, 0, 0, 'D', 'a', 'b', 'c'};
  for (size_t size = 0; size < sizeof frame; size++) {
    int fds[2];
    assert_int_equal(pipe(fds), 0);
    assert_int_equal(write(fds[1], frame, size), size);
    close(fds[1]);
    struct lod_frame_reader reader = {0};
    char type;
    assert_int_equal(lod_frame_read(fds[0], &reader, &type), LOD_IO);
    assert_int_equal(type, 0);
    lod_frame_reader_finish(&reader);
    close(fds[0]);
  }
}

static void writing_to_a_peer_that_is_gone_is_a_failure_not_a_signal(void **state) {
  (void)state;
  int fds[2];
  signal(SIGPIPE, SIG_DFL);
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, fds), 0);
  close(fds[1]);
  assert_int_equal(lod_frame_write(fds[0], 'J', "{}", 2), LOD_IO);
  close(fds[0]);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_frame_is_read_as_it_was_written_byte_by_byte),
      cmocka_unit_test(the_largest_frame_passes_and_a_larger_one_does_not),
      cmocka_unit_test(every_truncation_ends_as_an_io_failure),
      cmocka_unit_test(writing_to_a_peer_that_is_gone_is_a_failure_not_a_signal),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
