/* Whole bakes inside the jail, with every importer, and into a store that believes nothing: what the libraries need is let through. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/jobs/frame.h"
#include "server/store/files.h"
#include "server/store/store.h"
#include "server/worker/bake.h"
#include "server/worker/jail.h"

static char root[64];

static int make_root(void **state) {
  (void)state;
  strcpy(root, "/tmp/lodestream-jailed-XXXXXX");
  return mkdtemp(root) == NULL;
}

static int remove_root(void **state) {
  (void)state;
  lod_remove_tree(AT_FDCWD, root);
  return 0;
}

/* The worker: jailed before it looks at the model. */
_Noreturn static void bake(const char *name, int model_fd, int output_fd) {
  int sockets[2];
  struct stat facts;
  struct lod_problem problem = {0};
  struct lod_jail_settings settings = lod_jail_defaults();
  settings.strategy = "auto";
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, sockets) != 0)
    _exit(2);
  const int wanted[] = {fcntl(sockets[0], F_DUPFD, 20), fcntl(model_fd, F_DUPFD, 20), fcntl(output_fd, F_DUPFD, 20)};
  for (int i = 0; i < 3; i++)
    dup2(wanted[i], 3 + i);
  if (lod_jail_enter(&settings, NULL, &problem) != LOD_OK) {
    fprintf(stderr, "%s: %s\n", problem.type, problem.detail);
    _exit(3);
  }
  if (fstat(LOD_WORKER_INPUT_FD, &facts) != 0)
    _exit(4);
  struct lod_bake_request request = lod_bake_defaults();
  request.id = "model";
  request.name = name;
  request.size = (size_t)facts.st_size;
  request.bytes = mmap(NULL, request.size, PROT_READ, MAP_PRIVATE, LOD_WORKER_INPUT_FD, 0);
  request.directory_fd = LOD_WORKER_OUTPUT_FD;
  request.threads = 2;
  if (request.bytes == MAP_FAILED)
    _exit(5);
  if (lod_bake_run(&request, &problem) != LOD_OK) {
    fprintf(stderr, "%s: %s: %s\n", name, problem.type, problem.detail);
    _exit(6);
  }
  _exit(0);
}

static void bake_and_store(const char *name, int model_fd) {
  char path[96], store_path[96];
  struct lod_problem problem = {0};
  snprintf(path, sizeof path, "%s/output", root);
  snprintf(store_path, sizeof store_path, "%s/store", root);
  assert_int_equal(mkdir(path, 0700), 0);
  int output_fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  pid_t child = fork();
  if (child == 0)
    bake(name, model_fd, output_fd);
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
    fail_msg("%s: the jailed bake ended with state %x", name, (unsigned)status);
  struct lod_store *store;
  assert_int_equal(lod_store_open(store_path, &store, &problem), LOD_OK);
  if (lod_store_commit_bake(store, "model", output_fd, &problem) != LOD_OK)
    fail_msg("%s: %s: %s", name, problem.type, problem.detail);
  struct lod_stored_model *model = lod_store_model_open(store, "model");
  assert_non_null(model);
  assert_true(model->family_count >= 1 && model->families[0].level_count >= 1 && model->triangles > 0);
  lod_store_model_release(model);
  lod_store_close(store);
  close(output_fd);
  lod_remove_tree(AT_FDCWD, path);
}

static const char kOctahedron[] = "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
                                  "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";

static void an_octahedron_in_obj_bakes_in_the_jail(void **state) {
  (void)state;
  char path[96];
  snprintf(path, sizeof path, "%s/octahedron.obj", root);
  int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  assert_int_equal(write(fd, kOctahedron, sizeof kOctahedron - 1), sizeof kOctahedron - 1);
  bake_and_store("octahedron.obj", fd);
  close(fd);
}

/* One of each importer and decoder. */
static void models_of_every_format_bake_in_the_jail(void **state) {
  (void)state;
  static const char *const kModels[] = {
      "models/gltf/BoxTextured.glb",       "models/gltf/Duck-embedded.gltf",
      "models/gltf/heart-draco.glb",       "models/gltf/CesiumMan.glb",
      "models/formats/dolphins-ascii.ply", "models/formats/spot-big-endian-double.ply",
      "models/formats/spider-ascii.stl",   "models/formats/1002-tray-bottom-binary.stl",
      "models/formats/suzanne.obj",        "models/formats/fandisk-quads.off",
      "models/formats/fandisk.m",
  };
  const char *shared = getenv("LODESTREAM_SHARED") != NULL ? getenv("LODESTREAM_SHARED") : "../shared";
  int baked = 0;
  for (size_t i = 0; i < sizeof kModels / sizeof kModels[0]; i++) {
    char path[512];
    snprintf(path, sizeof path, "%s/%s", shared, kModels[i]);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
      continue;
    bake_and_store(strrchr(kModels[i], '/') + 1, fd);
    baked++;
    close(fd);
  }
  print_message("  %d shared models baked in the jail\n", baked);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(an_octahedron_in_obj_bakes_in_the_jail, make_root, remove_root),
      cmocka_unit_test_setup_teardown(models_of_every_format_bake_in_the_jail, make_root, remove_root),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
