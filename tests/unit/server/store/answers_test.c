/* The cache of answers on the disk: bounds, order of use, restarts, damage, models that go. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dirent.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "server/store/answers.h"
#include "server/store/files.h"

struct fixture {
  char root[64];
  int fd;
  struct lod_answers *answers;
};

static void open_it(struct fixture *f, uint64_t limit) {
  assert_int_equal(lod_answers_open(f->fd, &f->answers, NULL), LOD_OK);
  lod_answers_set_limit(f->answers, limit);
}

static int set_up(void **state) {
  struct fixture *f = calloc(1, sizeof *f);
  strcpy(f->root, "/tmp/lodestream-answers-XXXXXX");
  assert_non_null(mkdtemp(f->root));
  f->fd = open(f->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  assert_true(f->fd >= 0);
  *state = f;
  return 0;
}

static int tear_down(void **state) {
  struct fixture *f = *state;
  lod_answers_close(f->answers);
  lod_empty_folder(f->fd, ".");
  close(f->fd);
  rmdir(f->root);
  free(f);
  return 0;
}

static const char *key_of(int number) {
  static char key[LOD_ANSWER_KEY + 1];
  snprintf(key, sizeof key, "%032x", (unsigned)number);
  return key;
}

static atomic_int released;
static void release(void *held) {
  atomic_fetch_add(&released, 1);
  free(held);
}

static void keep(struct fixture *f, int number, const char *id, size_t size) {
  uint8_t *bytes = malloc(size);
  char facts[32];
  memset(bytes, number, size);
  snprintf(facts, sizeof facts, "{\"n\":%d}", number);
  lod_answers_keep(f->answers, id, key_of(number), bytes, size, facts, bytes, release);
}

static void until_written(struct fixture *f, uint64_t written) {
  for (int i = 0; i < 4000 && lod_answers_counts(f->answers).written < written; i++)
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  assert_int_equal(lod_answers_counts(f->answers).written, written);
}

static bool there(struct fixture *f, int number, size_t size) {
  struct lod_answer *answer = lod_answers_find(f->answers, key_of(number));
  if (answer == NULL)
    return false;
  char facts[32];
  uint8_t first;
  snprintf(facts, sizeof facts, "{\"n\":%d}", number);
  assert_int_equal(answer->size, size);
  assert_string_equal(answer->facts, facts);
  for (size_t i = 0; i < size; i++)
    assert_int_equal(answer->bytes[i], number);
  assert_int_equal(pread(answer->file, &first, 1, 0), 1); /* the file begins with the bytes */
  assert_int_equal(first, number);
  lod_answer_release(answer);
  return true;
}

static size_t count_files(const struct fixture *f) {
  struct lod_name_list list;
  int fd = openat(f->fd, "refined", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  list = lod_list_folder(fd);
  size_t count = list.count;
  lod_name_list_finish(&list);
  close(fd);
  return count;
}

static void test_what_was_kept_outlives_a_restart(void **state) {
  struct fixture *f = *state;
  open_it(f, 1 << 20);
  assert_false(there(f, 1, 1000));
  keep(f, 1, "bunny", 1000);
  keep(f, 2, "cow", 70000);
  until_written(f, 2);
  assert_true(there(f, 1, 1000) && there(f, 2, 70000));
  keep(f, 3, "cow", 5); /* on its way when the end comes */
  lod_answers_close(f->answers);
  open_it(f, 1 << 20);
  assert_true(there(f, 1, 1000) && there(f, 2, 70000) && there(f, 3, 5));
  assert_int_equal(lod_answers_counts(f->answers).files, 3);
  assert_int_equal(lod_answers_counts(f->answers).hits, 3);
}

static void test_the_least_recently_used_go_also_after_a_restart(void **state) {
  struct fixture *f = *state;
  open_it(f, 45000);
  for (int i = 1; i <= 4; i++) {
    keep(f, i, "m", 10000);
    until_written(f, (uint64_t)i);
    nanosleep(&(struct timespec){.tv_nsec = 15000000}, NULL); /* the file system's clock is coarse */
  }
  assert_true(there(f, 1, 10000));
  keep(f, 5, "m", 10000); /* 2 is the oldest in use */
  until_written(f, 5);
  assert_true(!there(f, 2, 10000) && there(f, 1, 10000) && there(f, 5, 10000));
  assert_int_equal(lod_answers_counts(f->answers).evicted, 1);
  nanosleep(&(struct timespec){.tv_nsec = 15000000}, NULL);
  assert_true(there(f, 3, 10000));
  lod_answers_close(f->answers);
  open_it(f, 25000);
  assert_int_equal(count_files(f), 2);
  assert_true(there(f, 3, 10000) && !there(f, 4, 10000));
  lod_answers_set_limit(f->answers, 0);
  assert_int_equal(count_files(f), 0);
  assert_int_equal(lod_answers_counts(f->answers).bytes, 0);
}

static void test_what_is_too_large_is_let_go_at_once(void **state) {
  struct fixture *f = *state;
  open_it(f, 4000);
  int before = atomic_load(&released);
  keep(f, 1, "m", 1001);
  assert_int_equal(atomic_load(&released), before + 1);
  lod_answers_set_limit(f->answers, 0);
  keep(f, 2, "m", 1);
  assert_int_equal(atomic_load(&released), before + 2);
  assert_int_equal(count_files(f), 0);
}

static void test_a_model_takes_its_answers_along(void **state) {
  struct fixture *f = *state;
  open_it(f, 1 << 26);
  keep(f, 1, "bunny", 100);
  keep(f, 2, "bunny.2", 100);
  keep(f, 3, "bunny", 100);
  until_written(f, 3);
  struct lod_answer *held = lod_answers_find(f->answers, key_of(1));
  for (int i = 4; i < 20; i++)
    keep(f, i, "bunny", 200000); /* some are written, some wait, one is under way */
  lod_answers_forget(f->answers, "bunny");
  assert_int_equal(held->bytes[99], 1); /* a reader keeps what it has */
  lod_answer_release(held);
  assert_true(there(f, 2, 100));
  lod_answers_close(f->answers);
  open_it(f, 1 << 20);
  assert_int_equal(count_files(f), 1);
}

static bool only_cow(void *context, const char *id) {
  (void)context;
  return strcmp(id, "cow") == 0;
}
static void test_models_that_are_not_there_any_more_are_swept(void **state) {
  struct fixture *f = *state;
  open_it(f, 1 << 20);
  keep(f, 1, "bunny", 100);
  keep(f, 2, "cow", 100);
  until_written(f, 2);
  lod_answers_sweep(f->answers, only_cow, NULL);
  assert_true(!there(f, 1, 100) && there(f, 2, 100));
  assert_int_equal(count_files(f), 1);
}

/* Every byte of a small file, changed or missing. */
static void test_damage_is_found_and_removed(void **state) {
  struct fixture *f = *state;
  open_it(f, 1 << 20);
  char path[128];
  uint64_t written = 0;
  for (size_t damage = 0; damage < 2 * 70; damage++) {
    keep(f, 7, "m", 40);
    until_written(f, ++written);
    snprintf(path, sizeof path, "%s/refined/%s.m", f->root, key_of(7));
    struct stat facts;
    assert_int_equal(stat(path, &facts), 0);
    size_t at = damage / 2;
    if (at >= (size_t)facts.st_size)
      break;
    int fd = open(path, O_RDWR);
    uint8_t byte;
    if (damage % 2 == 0) {
      assert_int_equal(ftruncate(fd, (off_t)at), 0);
    } else {
      assert_int_equal(pread(fd, &byte, 1, (off_t)at), 1);
      byte ^= 0x10;
      assert_int_equal(pwrite(fd, &byte, 1, (off_t)at), 1);
    }
    close(fd);
    assert_false(there(f, 7, 40));
    assert_int_not_equal(stat(path, &facts), 0);
  }
  assert_true(lod_answers_counts(f->answers).lost >= 100);
}

static void test_what_is_no_answer_is_cleared_away(void **state) {
  struct fixture *f = *state;
  assert_int_equal(mkdirat(f->fd, "refined", 0700), 0);
  assert_int_equal(mkdirat(f->fd, "refined/deep", 0700), 0);
  close(openat(f->fd, "refined/.new", O_CREAT | O_WRONLY, 0600));
  close(openat(f->fd, "refined/0123.m", O_CREAT | O_WRONLY, 0600));
  close(openat(f->fd, "refined/00000000000000000000000000000001.-m", O_CREAT | O_WRONLY, 0600));
  close(openat(f->fd, "refined/00000000000000000000000000000001.m", O_CREAT | O_WRONLY, 0600)); /* of no length */
  assert_int_equal(symlinkat("../..", f->fd, "refined/00000000000000000000000000000002.m"), 0);
  open_it(f, 1 << 20);
  assert_int_equal(count_files(f), 1);
  assert_null(lod_answers_find(f->answers, key_of(1)));
  assert_int_equal(count_files(f), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(test_what_was_kept_outlives_a_restart, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_the_least_recently_used_go_also_after_a_restart, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_what_is_too_large_is_let_go_at_once, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_a_model_takes_its_answers_along, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_models_that_are_not_there_any_more_are_swept, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_damage_is_found_and_removed, set_up, tear_down),
      cmocka_unit_test_setup_teardown(test_what_is_no_answer_is_cleared_away, set_up, tear_down),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
