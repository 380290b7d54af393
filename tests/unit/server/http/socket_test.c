/* Listening. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "server/http/socket.h"

enum { LISTENERS = 2 };

/* A process that is forked while a socket is open has a copy of it until it runs a program. Here: the next socket that is closed stays open
 * until somebody pauses so many times. */
static bool armed;
static int copy = -1, pauses;

int close(int fd) {
  if (armed)
    copy = dup(fd);
  armed = false;
  return (int)syscall(SYS_close, fd);
}

int nanosleep(const struct timespec *time, struct timespec *left) {
  (void)time;
  (void)left;
  if (copy >= 0 && --pauses <= 0) {
    syscall(SYS_close, copy);
    copy = -1;
  }
  return 0;
}

static void close_all(const int listeners[LISTENERS]) {
  for (int i = 0; i < LISTENERS; i++)
    close(listeners[i]);
}

/* A port that nobody has; its address in text. */
static const char *free_address(char text[LOD_ADDRESS_TEXT_MAX]) {
  int listeners[LISTENERS];
  struct lod_problem problem = {0};
  assert_int_equal(lod_socket_listen("127.0.0.1:0", LISTENERS, listeners, text, &problem), LOD_OK);
  close_all(listeners);
  const char *address = strstr(text, "127.0.0.1:");
  assert_non_null(address);
  return address;
}

static void test_a_port_that_is_taken_is_told(void **state) {
  (void)state;
  int first[LISTENERS], second[LISTENERS];
  char text[LOD_ADDRESS_TEXT_MAX], again[LOD_ADDRESS_TEXT_MAX];
  struct lod_problem problem = {0};
  const char *address = free_address(text);
  assert_int_equal(lod_socket_listen(address, LISTENERS, first, again, &problem), LOD_OK);
  assert_string_equal(again, text);
  assert_int_equal(lod_socket_listen(address, LISTENERS, second, again, &problem), LOD_IO);
  assert_string_equal(problem.type, "cannot-listen");
  assert_non_null(strstr(problem.detail, address));
  close_all(first);
}

static void test_a_worker_that_starts_meanwhile_is_no_hindrance(void **state) {
  (void)state;
  int listeners[LISTENERS];
  char text[LOD_ADDRESS_TEXT_MAX], again[LOD_ADDRESS_TEXT_MAX];
  struct lod_problem problem = {0};
  const char *address = free_address(text);
  armed = true;
  pauses = 3;
  assert_int_equal(lod_socket_listen(address, LISTENERS, listeners, again, &problem), LOD_OK);
  assert_string_equal(again, text);
  assert_int_equal(copy, -1);
  close_all(listeners);
}

static void test_an_address_that_is_none_is_told(void **state) {
  (void)state;
  static const char *const wrong[] = {"",
                                      "8080",
                                      "127.0.0.1:",
                                      "127.0.0.1:http",
                                      "[::1]:80x",
                                      "127.0.0.1:-1",
                                      "127.0.0.1:65536",
                                      "127.0.0.1:73888",
                                      "localhost:4294967297",
                                      "127.0.0.1:18446744073709551617"};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    int listeners[LISTENERS];
    char text[LOD_ADDRESS_TEXT_MAX];
    struct lod_problem problem = {0};
    assert_int_equal(lod_socket_listen(wrong[i], LISTENERS, listeners, text, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.type, "bad-setting");
    assert_non_null(strstr(problem.detail, wrong[i]));
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_a_port_that_is_taken_is_told),
      cmocka_unit_test(test_an_address_that_is_none_is_told),
      cmocka_unit_test(test_a_worker_that_starts_meanwhile_is_no_hindrance),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
