/* The warm worker, spoken to as the daemon does, over its socket in a process of its own. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/jobs/frame.h"
#include "server/worker/refine.h"

static const char kBase[] = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
enum { BASE_BYTES = sizeof kBase - 1 };

struct spoken {
  int fd;
  pid_t worker;
  struct lod_frame_reader reader;
};

static void start(struct spoken *s) {
  int ends[2];
  *s = (struct spoken){0};
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends), 0);
  s->worker = fork();
  assert_true(s->worker >= 0);
  if (s->worker == 0) {
    alarm(300);
    close(ends[0]); /* may be the worker's number */
    if (ends[1] != LOD_WORKER_SOCKET_FD && dup2(ends[1], LOD_WORKER_SOCKET_FD) < 0)
      _exit(3);
    if (ends[1] != LOD_WORKER_SOCKET_FD)
      close(ends[1]);
    _exit(lod_refine_serve("{\"job\":\"refine\",\"memory_bytes\":1000000000}"));
  }
  close(ends[1]);
  s->fd = ends[0];
}

/* The worker ends by itself once nobody speaks. */
static void finish(struct spoken *s) {
  int status;
  close(s->fd);
  assert_int_equal(waitpid(s->worker, &status, 0), s->worker);
  assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  lod_frame_reader_finish(&s->reader);
}

static void say(struct spoken *s, char type, const void *bytes, size_t size) {
  assert_int_equal(lod_frame_write(s->fd, type, bytes, size), LOD_OK);
}

static char hear(struct spoken *s) {
  char type;
  assert_int_equal(lod_frame_read(s->fd, &s->reader, &type), LOD_OK);
  return type;
}

static void ask(struct spoken *s, const char *base, int steps, int values) {
  char text[300];
  int size = snprintf(text, sizeof text,
                      "{\"kind\":\"refine\",\"base\":\"%s\",\"base_bytes\":%d,\"values_bytes\":%d,\"max_triangles\":100000,\"parameters\":{"
                      "\"doi\":\"%s\",\"steps\":\"%d\"}}",
                      base, (int)BASE_BYTES, values, values != 0 ? "attribute" : "uniform", steps);
  say(s, 'Q', text, (size_t)size);
}

static void give_base(struct spoken *s) {
  assert_int_equal(hear(s), 'N');
  say(s, 'B', kBase, BASE_BYTES);
}

/* All of an answer; its triangles. */
static json_int_t take_answer(struct spoken *s) {
  assert_int_equal(hear(s), 'R');
  json_t *facts = json_loadb(s->reader.payload, s->reader.payload_size, 0, NULL);
  json_int_t left = json_integer_value(json_object_get(facts, "bytes")),
             triangles = json_integer_value(json_object_get(facts, "triangles"));
  json_decref(facts);
  while (left > 0) {
    assert_int_equal(hear(s), 'G');
    left -= (json_int_t)s->reader.payload_size;
  }
  assert_int_equal(left, 0);
  return triangles;
}

static void take_cancelled(struct spoken *s) {
  assert_int_equal(hear(s), 'F');
  json_t *failure = json_loadb(s->reader.payload, s->reader.payload_size, 0, NULL);
  assert_string_equal(json_string_value(json_object_get(failure, "type")), "cancelled");
  json_decref(failure);
}

static void test_base_is_asked_for_once(void **state) {
  (void)state;
  struct spoken s;
  start(&s);
  ask(&s, "one", 2, 0);
  give_base(&s);
  assert_int_equal(take_answer(&s), 64);
  ask(&s, "one", 1, 0);
  assert_int_equal(take_answer(&s), 16);
  finish(&s);
}

/* The client left while the worker asked for the base: the daemon says so first, and sends the base when it hears that it is wanted. */
static void test_cancelled_before_base(void **state) {
  (void)state;
  struct spoken s;
  start(&s);
  ask(&s, "one", 5, 0);
  assert_int_equal(hear(&s), 'N');
  say(&s, 'X', "", 0);
  say(&s, 'B', kBase, 10);
  say(&s, 'B', kBase + 10, BASE_BYTES - 10);
  take_cancelled(&s);
  ask(&s, "one", 1, 0); /* is not cancelled, and the base is here */
  assert_int_equal(take_answer(&s), 16);
  finish(&s);
}

static void test_cancelled_before_values(void **state) {
  (void)state;
  struct spoken s;
  float values[4] = {1, 0, 0, 0};
  start(&s);
  ask(&s, "one", 2, sizeof values);
  say(&s, 'X', "", 0);
  say(&s, 'V', values, sizeof values);
  give_base(&s);
  take_cancelled(&s);
  finish(&s);
}

static void test_idle_passes_over(void **state) {
  (void)state;
  struct spoken s;
  start(&s);
  say(&s, 'X', "", 0);
  ask(&s, "one", 1, 0);
  give_base(&s);
  assert_int_equal(take_answer(&s), 16);
  say(&s, 'X', "", 0);
  ask(&s, "one", 0, 0);
  assert_int_equal(take_answer(&s), 4);
  finish(&s);
}

static void test_nonsense_ends_it(void **state) {
  (void)state;
  struct spoken s;
  start(&s);
  ask(&s, "one", 1, 0);
  assert_int_equal(hear(&s), 'N');
  say(&s, 'V', kBase, BASE_BYTES);
  while (hear(&s) == 'F') { /* why, and then the end */
    char type;
    if (lod_frame_read(s.fd, &s.reader, &type) == LOD_IO)
      break;
    fail();
  }
  finish(&s);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_base_is_asked_for_once),  cmocka_unit_test(test_cancelled_before_base),
      cmocka_unit_test(test_cancelled_before_values), cmocka_unit_test(test_idle_passes_over),
      cmocka_unit_test(test_nonsense_ends_it),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
