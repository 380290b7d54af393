/* A disk that fails, and the order in which things reach it. This program's own write, fsync and rename come before libc's for the store
 * and for SQLite alike: they note what is called, and make the Nth call fail. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/jobs/jobs.h"
#include "server/store/catalog.h"
#include "server/store/check.h"
#include "tests/unit/server/store/fixture.h"

/* ---- the shim ---- */

enum kind { WRITE, SYNC, RENAME, LINK };
static const char *const kKinds[] = {"write", "sync", "rename", "link"};

struct event {
  enum kind kind;
  char path[200]; /* what was written, synced, or its new name */
  uint64_t inode;
};

static struct {
  pthread_mutex_t lock;
  bool on;
  long calls, fail_at; /* the fail_at-th call fails; 0 = none */
  bool lasting;        /* and all after it */
  int error;
  bool failed;
  struct event events[4000];
  size_t count;
} shim = {.lock = PTHREAD_MUTEX_INITIALIZER};

/* Notes a call; true: it shall fail, and errno says how. */
static bool note(enum kind kind, int fd, const char *path) {
  if (!shim.on)
    return false;
  char link[40], name[200] = "";
  struct stat facts = {0};
  if (path == NULL) {
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, name, sizeof name - 1);
    name[size > 0 ? size : 0] = 0;
    fstat(fd, &facts);
  } else {
    snprintf(name, sizeof name, "%s", path);
    fstatat(fd, path, &facts, AT_SYMLINK_NOFOLLOW);
  }
  if (strstr(name, "lodestream-store") == NULL && path == NULL)
    return false; /* another file of this process */
  pthread_mutex_lock(&shim.lock);
  bool fails = ++shim.calls == shim.fail_at || (shim.lasting && shim.fail_at != 0 && shim.calls > shim.fail_at);
  if (!fails && shim.count < sizeof shim.events / sizeof *shim.events) {
    struct event *event = &shim.events[shim.count++];
    event->kind = kind;
    event->inode = facts.st_ino;
    snprintf(event->path, sizeof event->path, "%s", name);
  }
  shim.failed |= fails;
  pthread_mutex_unlock(&shim.lock);
  errno = shim.error;
  return fails;
}

#define NEXT(result, name, ...)                                                                                                            \
  static result (*name##_next)(__VA_ARGS__);                                                                                               \
  if (name##_next == NULL)                                                                                                                 \
  *(void **)&name##_next = dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *bytes, size_t size) {
  NEXT(ssize_t, write, int, const void *, size_t);
  return note(WRITE, fd, NULL) ? -1 : write_next(fd, bytes, size);
}
ssize_t pwrite64(int fd, const void *bytes, size_t size, off64_t offset) {
  NEXT(ssize_t, pwrite64, int, const void *, size_t, off64_t);
  return note(WRITE, fd, NULL) ? -1 : pwrite64_next(fd, bytes, size, offset);
}
ssize_t pwrite(int fd, const void *bytes, size_t size, off_t offset) {
  NEXT(ssize_t, pwrite, int, const void *, size_t, off_t);
  return note(WRITE, fd, NULL) ? -1 : pwrite_next(fd, bytes, size, offset);
}
int fsync(int fd) {
  NEXT(int, fsync, int);
  return note(SYNC, fd, NULL) ? -1 : fsync_next(fd);
}
int fdatasync(int fd) {
  NEXT(int, fdatasync, int);
  return note(SYNC, fd, NULL) ? -1 : fdatasync_next(fd);
}
int renameat(int old_folder, const char *old, int folder, const char *new) {
  NEXT(int, renameat, int, const char *, int, const char *);
  return note(RENAME, old_folder, old) ? -1 : renameat_next(old_folder, old, folder, new);
}
int linkat(int old_folder, const char *old, int folder, const char *new, int flags) {
  NEXT(int, linkat, int, const char *, int, const char *, int);
  return note(LINK, folder, new) ? -1 : linkat_next(old_folder, old, folder, new, flags);
}

static void shim_start(long fail_at, int error) {
  shim.calls = 0;
  shim.count = 0;
  shim.failed = false;
  shim.fail_at = fail_at;
  shim.error = error;
  shim.on = true;
}
static void shim_stop(void) {
  shim.on = false;
}

static char self[4096]; /* this program, which is the worker as well */

/* ---- fixture ---- */

/* The shim first: closing the store is not under test, and may not fail. */
static int stop_and_tear_down(void **state) {
  shim_stop();
  return tear_down(state);
}

/* A bake of `id` whose content depends on `revision`, in a folder beside the store. */
static int make_bake(struct fixture *fixture, const char *id, const char *revision) {
  char coarse[40], fine[40];
  snprintf(coarse, sizeof coarse, "coarse %s", revision);
  snprintf(fine, sizeof fine, "fine %s", revision);
  int fd = bake_folder(fixture);
  const struct bake_level levels[] = {{coarse, 0}, {"shared by all", 0}, {fine, 0}};
  assert_int_equal(write_bake(fd, id, revision, levels, 3, NULL), 0);
  return fd;
}

static size_t find_event(size_t from, enum kind kind, const char *part, uint64_t inode) {
  for (size_t i = from; i < shim.count; i++)
    if (shim.events[i].kind == kind && (part == NULL || strstr(shim.events[i].path, part) != NULL) &&
        (inode == 0 || shim.events[i].inode == inode))
      return i;
  return SIZE_MAX;
}

static size_t last_event(enum kind kind, const char *part) {
  size_t found = SIZE_MAX;
  for (size_t i = 0; i < shim.count; i++)
    if (shim.events[i].kind == kind && strstr(shim.events[i].path, part) != NULL)
      found = i;
  return found;
}

static void print_order(void) {
  const char *last = "";
  for (size_t i = 0; i < shim.count; i++) {
    const char *name = strrchr(shim.events[i].path, '/');
    name = name == NULL ? shim.events[i].path : name + 1;
    if (strcmp(name, last) != 0 || shim.events[i].kind != WRITE)
      print_message("  %-6s %.40s\n", kKinds[shim.events[i].kind], name);
    last = name;
  }
}

/* ---- the order ---- */

static void a_revision_is_on_the_disk_before_a_row_names_it(void **state) {
  struct fixture *fixture = *state;
  int fd = make_bake(fixture, "cube", "r1");
  shim_start(0, 0);
  assert_int_equal(lod_store_commit_bake(fixture->store, "cube", fd, NULL), LOD_OK);
  shim_stop();
  close(fd);
  print_order();
  size_t row = find_event(0, WRITE, "catalog.sqlite-wal", 0), renames = 0;
  assert_true(row != SIZE_MAX);
  for (size_t i = find_event(0, RENAME, NULL, 0); i != SIZE_MAX; i = find_event(i + 1, RENAME, NULL, 0)) {
    const struct event *moved = &shim.events[i];
    char folder[16];
    snprintf(folder, sizeof folder, "objects/%.2s", moved->path);
    assert_true(find_event(0, SYNC, NULL, moved->inode) < i); /* its bytes before its name */
    size_t folder_sync = find_event(i, SYNC, folder, 0);
    assert_true(folder_sync < row); /* its name before the row */
    renames++;
  }
  assert_int_equal(renames, 3);
  size_t row_sync = last_event(SYNC, "catalog.sqlite-wal");
  assert_true(row_sync != SIZE_MAX && row_sync > last_event(WRITE, "catalog.sqlite-wal")); /* the row before the answer */
}

static void an_upload_is_on_the_disk_before_it_is_acknowledged(void **state) {
  struct fixture *fixture = *state;
  struct lod_jobs_settings settings = lod_jobs_defaults();
  struct lod_jobs *jobs;
  settings.store = fixture->store;
  settings.worker_path = "/bin/false";
  assert_int_equal(lod_jobs_create(&settings, &jobs, NULL), LOD_OK);
  int fd;
  uint64_t number;
  assert_int_equal(lod_jobs_upload_create(jobs, &fd, NULL), LOD_OK);
  struct stat facts;
  assert_int_equal(fstat(fd, &facts), 0);
  shim_start(0, 0);
  assert_int_equal(write(fd, "model", 5), 5);
  assert_int_equal(lod_jobs_submit(jobs, "cube", "cube.ply", NULL, fd, &number, NULL), LOD_OK);
  size_t acknowledged = shim.count; /* a runner goes on writing */
  shim_stop();
  size_t sync = find_event(0, SYNC, NULL, facts.st_ino), name = find_event(0, LINK, NULL, 0);
  assert_true(sync < name); /* bytes before name */
  size_t folder = find_event(name, SYNC, "uploads", 0);
  size_t row = find_event(0, WRITE, "catalog.sqlite-wal", 0);
  assert_true(folder < row); /* name before row */
  size_t row_sync = find_event(row, SYNC, "catalog.sqlite-wal", 0);
  assert_true(row_sync < acknowledged);
  lod_jobs_destroy(jobs);
}

/* ---- faults ---- */

static void expect_sound(struct fixture *fixture, long call) {
  struct lod_store_findings findings;
  struct lod_problem problem = {0};
  lod_store_close(fixture->store);
  fixture->store = NULL;
  if (lod_store_check(fixture->path, false, NULL, &findings, &problem) != LOD_OK)
    fail_msg("call %ld: %s: %s", call, problem.type, problem.detail);
  assert_int_equal(findings.damaged + findings.missing + findings.broken_models, 0);
  reopen(fixture);
}

static const char *revision_of(struct fixture *fixture, const char *id, char text[40]) {
  struct lod_stored_model *model = lod_store_model_open(fixture->store, id);
  snprintf(text, 40, "%s", model == NULL ? "" : model->revision);
  lod_store_model_release(model);
  return text;
}

/* Every call that reaches the disk fails in its turn. What was acknowledged is there; what was refused left the old revision, or, when
 * only the row's sync failed, either; and the next commit succeeds without anybody's help. */
static void fail_each_call(struct fixture *fixture, int error) {
  char before[40] = "", found[40], next[40];
  long call = 1, acknowledged = 0, refused = 0;
  for (bool reached = true; reached; call++) {
    snprintf(next, sizeof next, "e%d-r%ld", error, call);
    int fd = make_bake(fixture, "cube", next);
    struct lod_problem problem = {0};
    shim_start(call, error);
    enum lod_status status = lod_store_commit_bake(fixture->store, "cube", fd, &problem);
    shim_stop();
    close(fd);
    reached = shim.failed;
    acknowledged += status == LOD_OK;
    refused += status != LOD_OK;
    if (status != LOD_OK) {
      assert_int_equal(problem.status, LOD_IO);
      assert_true(strlen(problem.detail) > 20);
      if (error == ENOSPC)
        assert_true(strcmp(problem.type, "disk-full") == 0 || strcmp(problem.type, "store-error") == 0);
      assert_string_equal(revision_of(fixture, "cube", found), before); /* nothing changed for readers */
    }
    expect_sound(fixture, call);
    revision_of(fixture, "cube", found);
    if (status == LOD_OK)
      assert_string_equal(found, next);
    else if (strcmp(found, next) != 0)
      assert_string_equal(found, before);
    strcpy(before, found);
  }
  print_message("  errno %d: %ld calls failed in turn, %ld commits refused, %ld acknowledged and found again\n", error, call - 2, refused,
                acknowledged);
  assert_true(refused > 8);
  assert_true(acknowledged >= 1);
}

static void an_error_of_the_disk_loses_nothing_acknowledged(void **state) {
  fail_each_call(*state, EIO);
}
static void a_full_disk_loses_nothing_acknowledged(void **state) {
  fail_each_call(*state, ENOSPC);
}

/* State of the job's row, as the next start would read it; -1 = no such row. */
struct wanted {
  uint64_t number;
  int state;
};
static enum lod_status take_state(void *context, const struct lod_catalog_job *row) {
  struct wanted *wanted = context;
  if (row->number == wanted->number)
    wanted->state = row->state;
  return LOD_OK;
}
static int state_on_disk(struct fixture *fixture, uint64_t number) {
  struct wanted wanted = {number, -1};
  assert_int_equal(lod_catalog_read_jobs(lod_store_catalog(fixture->store), take_state, &wanted, NULL), LOD_OK);
  return wanted.state;
}

static void a_delete_ends_upload_and_model_or_neither(void **state) {
  struct fixture *fixture = *state;
  struct lod_jobs_settings settings = lod_jobs_defaults();
  struct lod_jobs *jobs;
  settings.store = fixture->store;
  settings.worker_path = self; /* waits for ever */
  assert_int_equal(lod_jobs_create(&settings, &jobs, NULL), LOD_OK);
  int bake_fd = make_bake(fixture, "cube", "r1"), fd;
  assert_int_equal(lod_store_commit_bake(fixture->store, "cube", bake_fd, NULL), LOD_OK);
  close(bake_fd);
  uint64_t number;
  assert_int_equal(lod_jobs_upload_create(jobs, &fd, NULL), LOD_OK);
  assert_int_equal(write(fd, "model", 5), 5);
  assert_int_equal(lod_jobs_submit(jobs, "cube", "cube.ply", NULL, fd, &number, NULL), LOD_OK);
  long refused = 0;
  char found[40];
  struct lod_job job;
  for (long call = 1;; call++) {
    bool existed;
    struct lod_problem problem = {0};
    shim.lasting = true; /* the runner's own notes come in between */
    shim_start(call, EIO);
    enum lod_status status = lod_jobs_delete_model(jobs, "cube", &existed, &problem);
    shim_stop();
    shim.lasting = false;
    assert_true(lod_jobs_find(jobs, number, &job));
    revision_of(fixture, "cube", found);
    int row = state_on_disk(fixture, number);
    if (status == LOD_OK) {
      assert_true(existed && found[0] == 0 && row == LOD_JOB_FAILED);
      assert_string_equal(job.problem.type, "cancelled");
      break;
    }
    assert_true(call < 1000 && job.state < LOD_JOB_DONE && row >= 0 && row < LOD_JOB_DONE);
    assert_string_equal(found, "r1");
    refused++;
  }
  lod_jobs_destroy(jobs);
  print_message("  %ld deletes failed, each leaving the model and its upload\n", refused);
  assert_true(refused > 0);
}

/* ---- check and repair ---- */

static void spoil(struct fixture *fixture, const char *sha256, const char *how) {
  char path[300];
  snprintf(path, sizeof path, "%s/objects/%.2s/%s", fixture->path, sha256, sha256);
  if (strcmp(how, "remove") == 0) {
    assert_int_equal(unlink(path), 0);
    return;
  }
  assert_int_equal(chmod(path, 0600), 0);
  FILE *file = fopen(path, "r+");
  assert_non_null(file);
  fputc('X', file); /* the same size, other bytes */
  fclose(file);
}

static void check_finds_what_is_damaged_and_repair_leaves_a_sound_store(void **state) {
  struct fixture *fixture = *state;
  static const char *const kIds[] = {"whole", "damaged", "missing"};
  char bad[2][LOD_SHA256_HEX + 1];
  for (int i = 0; i < 3; i++) {
    int fd = make_bake(fixture, kIds[i], kIds[i]);
    assert_int_equal(lod_store_commit_bake(fixture->store, kIds[i], fd, NULL), LOD_OK);
    close(fd);
    struct lod_stored_model *model = lod_store_model_open(fixture->store, kIds[i]);
    if (i > 0)
      strcpy(bad[i - 1], model->families[0].levels[2].sha256);
    lod_store_model_release(model);
  }
  struct lod_store_findings findings;
  struct lod_problem problem = {0};
  assert_int_equal(lod_store_check(fixture->path, false, NULL, &findings, &problem), LOD_IO);
  assert_string_equal(problem.type, "store-locked");
  lod_store_close(fixture->store);
  fixture->store = NULL;
  assert_int_equal(lod_store_check(fixture->path, false, NULL, &findings, NULL), LOD_OK);
  assert_int_equal(findings.models, 3);
  assert_int_equal(findings.objects, 7);
  assert_int_equal(findings.damaged + findings.missing + findings.broken_models + findings.stray, 0);

  spoil(fixture, bad[0], "change");
  spoil(fixture, bad[1], "remove");
  char path[160];
  snprintf(path, sizeof path, "%s/objects/00/stray", fixture->path);
  FILE *stray = fopen(path, "w");
  assert_non_null(stray);
  fclose(stray);
  for (int repair = 0; repair < 2; repair++) {
    assert_int_equal(lod_store_check(fixture->path, repair, NULL, &findings, NULL), LOD_OK);
    assert_int_equal(findings.damaged, 1);
    assert_int_equal(findings.missing, 1);
    assert_int_equal(findings.broken_models, 2);
    assert_int_equal(findings.stray, repair ? 3 : 1); /* with two that only the two models named */
    assert_int_equal(findings.repaired, repair ? 6 : 0);
  }
  reopen(fixture);
  assert_int_equal(lod_store_model_count(fixture->store), 1);
  lod_store_close(fixture->store);
  fixture->store = NULL;
  assert_int_equal(lod_store_check(fixture->path, false, NULL, &findings, NULL), LOD_OK);
  assert_int_equal(findings.models, 1);
  assert_int_equal(findings.damaged + findings.missing + findings.broken_models + findings.stray, 0);
  snprintf(path, sizeof path, "%s/lost+found/%s", fixture->path, bad[0]);
  assert_int_equal(access(path, F_OK), 0); /* kept for whoever wants to look */
  reopen(fixture);
}

int main(int argc, char **argv) {
  (void)argv;
  while (argc > 1) /* a worker that does not answer */
    pause();
  ssize_t size = readlink("/proc/self/exe", self, sizeof self - 1);
  self[size > 0 ? size : 0] = 0;
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(a_revision_is_on_the_disk_before_a_row_names_it, set_up, stop_and_tear_down),
      cmocka_unit_test_setup_teardown(an_upload_is_on_the_disk_before_it_is_acknowledged, set_up, stop_and_tear_down),
      cmocka_unit_test_setup_teardown(an_error_of_the_disk_loses_nothing_acknowledged, set_up, stop_and_tear_down),
      cmocka_unit_test_setup_teardown(a_full_disk_loses_nothing_acknowledged, set_up, stop_and_tear_down),
      cmocka_unit_test_setup_teardown(a_delete_ends_upload_and_model_or_neither, set_up, stop_and_tear_down),
      cmocka_unit_test_setup_teardown(check_finds_what_is_damaged_and_repair_leaves_a_sound_store, set_up, stop_and_tear_down),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
