/* A line goes into a reply behind its status line, however the socket cuts what is sent. */
#include "server/http/insert.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <stdio.h>
#include <string.h>

static const char kHeader[] = "HTTP/1.1 200 OK\r\nContent-Length: 11\r\n\r\n", kBody[] = "hello world";
static const char kWhole[] = "HTTP/1.1 200 OK\r\nX-Request-Id: abc\r\nLod-X: 1\r\nContent-Length: 11\r\n\r\nhello world";

/* A caller that knows nothing of the line sends header and body over a socket that takes at most cuts[i] bytes the i-th time. Returns how
 * often it was told that nothing went out. */
static int transfer(const size_t *cuts, size_t cut_count, bool apart, char *arrived) {
  struct lod_insert insert = {0};
  lod_insert_begin(&insert, "X-Request-Id", "abc");
  lod_insert_more(&insert, "Lod-X", "1");
  const size_t header = sizeof kHeader - 1, total = header + sizeof kBody - 1;
  size_t done = 0, size = 0;
  int nothing = 0;
  for (size_t i = 0; done < total; i++) {
    struct iovec parts[2], out[LOD_INSERT_PARTS];
    int count = 0;
    if (done < header)
      parts[count++] = (struct iovec){(void *)(kHeader + done), header - done};
    if (done >= header || !apart) {
      size_t at = done < header ? 0 : done - header;
      parts[count++] = (struct iovec){(void *)(kBody + at), sizeof kBody - 1 - at};
    }
    int made = lod_insert_parts(&insert, parts, count, out);
    assert_in_range(made, 1, LOD_INSERT_PARTS);
    size_t room = i < cut_count ? cuts[i] : 1000, sent = 0;
    for (int k = 0; k < made; k++) {
      size_t taken = out[k].iov_len < room - sent ? out[k].iov_len : room - sent;
      memcpy(arrived + size + sent, out[k].iov_base, taken);
      sent += taken;
    }
    size += sent;
    size_t own = lod_insert_account(&insert, sent);
    assert_true(own <= total - done);
    nothing += own == 0;
    done += own;
  }
  assert_false(insert.active);
  arrived[size] = 0;
  return nothing;
}

static void every_pair_of_cuts_gives_the_same_bytes(void **state) {
  (void)state;
  char arrived[200];
  int nothing = 0;
  for (int apart = 0; apart < 2; apart++)
    for (size_t a = 1; a < sizeof kWhole; a++)
      for (size_t b = 1; b < sizeof kWhole; b++) {
        const size_t cuts[] = {a, b};
        nothing += transfer(cuts, 2, apart, arrived);
        assert_string_equal(arrived, kWhole);
      }
  assert_true(nothing > 0); /* cuts within the line were met */
  size_t ones[200];
  for (size_t i = 0; i < 200; i++)
    ones[i] = 1;
  transfer(ones, 200, false, arrived);
  assert_string_equal(arrived, kWhole);
}

static void what_is_no_reply_is_left_alone(void **state) {
  (void)state;
  struct lod_insert insert = {0};
  struct iovec out[LOD_INSERT_PARTS], part = {(void *)"body bytes\n", 11};
  assert_int_equal(lod_insert_parts(&insert, &part, 1, out), 1); /* nothing was begun */
  assert_int_equal(lod_insert_account(&insert, 5), 5);
  lod_insert_begin(&insert, "X-Request-Id", "abc");
  assert_int_equal(lod_insert_parts(&insert, &part, 1, out), 1);
  assert_false(insert.active);
  char value[200];
  memset(value, 'x', sizeof value - 1);
  value[sizeof value - 1] = 0;
  lod_insert_begin(&insert, "X-Request-Id", value); /* longer than an id may be */
  assert_false(insert.active);
  lod_insert_begin(&insert, "X-Request-Id", "abc");
  const uint32_t before = insert.size;
  lod_insert_more(&insert, "Lod-X", value); /* does not fit: the line that is there stays */
  assert_true(insert.active);
  assert_int_equal(insert.size, before);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(every_pair_of_cuts_gives_the_same_bytes),
                                     cmocka_unit_test(what_is_no_reply_is_left_alone)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
