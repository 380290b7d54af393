/* An open store in a fresh folder under /tmp, and folders for bakes beside it. */
#ifndef LOD_TESTS_STORE_FIXTURE_H
#define LOD_TESTS_STORE_FIXTURE_H

#include "server/store/files.h"
#include "server/store/store.h"
#include "tests/unit/server/store/bake_folder.h"

struct fixture {
  char root[64], path[80];
  int root_fd, bakes;
  struct lod_store *store;
};

static inline void reopen(struct fixture *fixture) {
  struct lod_problem problem = {0};
  lod_store_close(fixture->store);
  fixture->store = NULL;
  if (lod_store_open(fixture->path, &fixture->store, &problem) != LOD_OK)
    fail_msg("%s: %s", problem.type, problem.detail);
}

static inline int set_up(void **state) {
  struct fixture *fixture = calloc(1, sizeof *fixture);
  strcpy(fixture->root, "/tmp/lodestream-store-XXXXXX");
  assert_non_null(mkdtemp(fixture->root));
  snprintf(fixture->path, sizeof fixture->path, "%s/store", fixture->root);
  fixture->root_fd = open(fixture->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  reopen(fixture);
  *state = fixture;
  return 0;
}

static inline int tear_down(void **state) {
  struct fixture *fixture = *state;
  lod_store_close(fixture->store);
  close(fixture->root_fd);
  lod_remove_tree(AT_FDCWD, fixture->root);
  free(fixture);
  return 0;
}

/* A fresh folder beside the store; close what is returned. */
static inline int bake_folder(struct fixture *fixture) {
  char name[32];
  snprintf(name, sizeof name, "bake-%d", fixture->bakes++);
  assert_int_equal(mkdirat(fixture->root_fd, name, 0700), 0);
  int fd = openat(fixture->root_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  assert_true(fd >= 0);
  return fd;
}

#endif
