#include "tests/unit/codec/import/importing.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

/* root/inside.txt, root/sub/deep.txt, root/link -> ../secret.txt, root/dirlink -> .., secret.txt */
struct tree {
  char folder[64];
  int root;
  struct lod_import_files files;
  struct lod_arena *arena;
};

static void write_file(int folder, const char *name, const char *text) {
  int fd = openat(folder, name, O_CREAT | O_WRONLY, 0600);
  assert_true(fd >= 0 && write(fd, text, strlen(text)) == (ssize_t)strlen(text));
  close(fd);
}

static int make_tree(void **state) {
  struct tree *tree = calloc(1, sizeof *tree);
  strcpy(tree->folder, "/tmp/lod-files-XXXXXX");
  assert_non_null(mkdtemp(tree->folder));
  int top = open(tree->folder, O_RDONLY | O_DIRECTORY);
  assert_int_equal(mkdirat(top, "root", 0700), 0);
  assert_int_equal(mkdirat(top, "root/sub", 0700), 0);
  write_file(top, "secret.txt", "secret");
  write_file(top, "root/inside.txt", "inside");
  write_file(top, "root/sub/deep.txt", "deep");
  assert_int_equal(symlinkat("../secret.txt", top, "root/link"), 0);
  assert_int_equal(symlinkat("..", top, "root/dirlink"), 0);
  assert_int_equal(mkfifoat(top, "root/fifo", 0600), 0);
  tree->root = openat(top, "root", O_RDONLY | O_DIRECTORY);
  close(top);
  tree->files = lod_import_files_beneath(&tree->root);
  tree->arena = lod_arena_create(0);
  *state = tree;
  return 0;
}

static int remove_tree(void **state) {
  struct tree *tree = *state;
  static const char *const kNames[] = {"root/fifo", "root/dirlink", "root/link", "root/sub/deep.txt", "root/inside.txt", "secret.txt"};
  int top = open(tree->folder, O_RDONLY | O_DIRECTORY);
  for (size_t i = 0; i < sizeof kNames / sizeof *kNames; i++)
    unlinkat(top, kNames[i], 0);
  unlinkat(top, "root/sub", AT_REMOVEDIR);
  unlinkat(top, "root", AT_REMOVEDIR);
  close(top);
  rmdir(tree->folder);
  close(tree->root);
  lod_arena_destroy(tree->arena);
  free(tree);
  return 0;
}

static enum lod_status read_name(struct tree *tree, const char *name, const char *expected) {
  const uint8_t *bytes = NULL;
  size_t size = 0;
  struct lod_problem problem = {0};
  enum lod_status status = tree->files.read(tree->files.context, name, tree->arena, &bytes, &size, &problem);
  if (status == LOD_OK) {
    assert_non_null(expected);
    assert_int_equal(size, strlen(expected));
    assert_memory_equal(bytes, expected, size);
  } else {
    assert_string_equal(problem.type, "missing-file");
  }
  return status;
}

static void files_beneath_the_folder_are_read(void **state) {
  assert_int_equal(read_name(*state, "inside.txt", "inside"), LOD_OK);
  assert_int_equal(read_name(*state, "sub/deep.txt", "deep"), LOD_OK);
}

static void nothing_above_the_folder_is_read(void **state) {
  static const char *const kNames[] = {"../secret.txt", "sub/../../secret.txt", "link", "dirlink/secret.txt", "/etc/passwd", "sub", "fifo",
                                       "absent"};
  for (size_t i = 0; i < sizeof kNames / sizeof *kNames; i++)
    assert_int_equal(read_name(*state, kNames[i], NULL), LOD_BAD_INPUT);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(files_beneath_the_folder_are_read, make_tree, remove_tree),
      cmocka_unit_test_setup_teardown(nothing_above_the_folder_is_read, make_tree, remove_tree),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
