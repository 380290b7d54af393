#include "codec/export/tree.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#define A "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"
#define B "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb"
#define C "cccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccc"
#define D "dddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddd"

static const char kManifest[] =
    "{\"id\":\"a<b\",\"source\":{\"triangles\":12,\"diagonal\":1.5},\"families\":{\"cluster\":{\"levels\":[{\"object\":\"" A
    "\",\"triangles\":4,\"bytes\":1},{\"object\":\"" B "\",\"triangles\":8,\"bytes\":2,\"delta\":{\"object\":\"" D
    "\"}}]},\"uniform\":{\"levels\":[{\"object\":\"" A "\"}]}},\"textures\":[{\"object\":\"" C "\"},{\"object\":\"" C "\"}]}";

struct folder {
  char path[64];
  int bake;
};

static void path_in(const struct folder *folder, const char *name, char path[512]) {
  snprintf(path, 512, "%s/%s", folder->path, name);
}

static void put(const struct folder *folder, const char *name, const char *text) {
  char path[512];
  path_in(folder, name, path);
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  fputs(text, file);
  fclose(file);
}

static void expect(const struct folder *folder, const char *name, const char *text) {
  char path[512], content[4096] = "";
  struct stat facts;
  path_in(folder, name, path);
  assert_int_equal(lstat(path, &facts), 0);
  assert_true(S_ISREG(facts.st_mode));
  FILE *file = fopen(path, "rb");
  size_t size = fread(content, 1, sizeof content - 1, file);
  fclose(file);
  content[size] = '\0';
  if (text != NULL)
    assert_string_equal(content, text);
}

static bool exists(const struct folder *folder, const char *name) {
  char path[512];
  path_in(folder, name, path);
  return access(path, F_OK) == 0;
}

static struct folder make(const char *manifest) {
  struct folder folder = {"/tmp/lodestream-static-XXXXXX", -1};
  char path[512];
  assert_non_null(mkdtemp(folder.path));
  path_in(&folder, "bake", path);
  assert_int_equal(mkdir(path, 0755), 0);
  folder.bake = open(path, O_RDONLY | O_DIRECTORY);
  path_in(&folder, "bake/objects", path);
  assert_int_equal(mkdir(path, 0755), 0);
  put(&folder, "bake/manifest.json", manifest);
  put(&folder, "bake/objects/" A, "level 0");
  put(&folder, "bake/objects/" B, "level 1");
  put(&folder, "bake/objects/" C, "texture");
  put(&folder, "bake/objects/" D, "delta");
  return folder;
}

static void finish(struct folder *folder) {
  char command[128];
  close(folder->bake);
  snprintf(command, sizeof command, "rm -r '%s'", folder->path);
  assert_int_equal(system(command), 0);
}

/* What else lies beside bake/ and out/. */
static int count_entries(const struct folder *folder) {
  char command[128];
  snprintf(command, sizeof command, "ls -A '%s' | wc -l", folder->path);
  FILE *pipe = popen(command, "r");
  int count = -1;
  assert_int_equal(fscanf(pipe, "%d", &count), 1);
  pclose(pipe);
  return count;
}

static void a_bake_becomes_a_tree_of_plain_files(void **state) {
  (void)state;
  struct folder folder = make(kManifest);
  char out[512], viewer[512];
  path_in(&folder, "out/", out);
  path_in(&folder, "viewer", viewer);
  assert_int_equal(mkdir(viewer, 0755), 0);
  put(&folder, "viewer/index.html", "the viewer");
  assert_int_equal(symlink("/etc/passwd", strcat(viewer, "/link")), 0);
  path_in(&folder, "viewer", viewer);
  struct lod_problem problem = {0};
  if (lod_export_tree(folder.bake, LOD_EXPORT_STATIC, out, viewer, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  expect(&folder, "out/manifest.json", kManifest);
  expect(&folder, "out/objects/" B, "level 1");
  expect(&folder, "out/families/cluster/0.glb", "level 0");
  expect(&folder, "out/families/cluster/1.glb", "level 1");
  expect(&folder, "out/families/cluster/1.delta.bin", "delta");
  expect(&folder, "out/families/uniform/0.glb", "level 0");
  expect(&folder, "out/objects/" C, "texture");
  expect(&folder, "out/families/cluster/" C, "texture"); /* beside the level that says "uri": "cccc..." */
  expect(&folder, "out/families/uniform/" C, "texture");
  expect(&folder, "out/viewer/index.html", "the viewer");
  assert_false(exists(&folder, "out/viewer/link"));
  char path[512], page[8192] = "";
  path_in(&folder, "out/index.html", path);
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  assert_true(fread(page, 1, sizeof page - 1, file) > 0);
  fclose(file);
  assert_non_null(strstr(page, "<h1>a&#60;b</h1>"));
  assert_non_null(strstr(page, "href=\"families/cluster/1.glb\""));
  assert_non_null(strstr(page, "href=\"viewer/index.html\""));
  struct stat facts;
  assert_int_equal(stat(out, &facts), 0);
  assert_int_equal(facts.st_mode & 0777, 0755);
  assert_int_equal(count_entries(&folder), 3);
  finish(&folder);
}

static void what_is_there_already_is_left_alone(void **state) {
  (void)state;
  struct folder folder = make(kManifest);
  char out[512];
  path_in(&folder, "out", out);
  assert_int_equal(mkdir(out, 0755), 0);
  assert_int_equal(lod_export_tree(folder.bake, LOD_EXPORT_STATIC, out, NULL, NULL), LOD_OK); /* empty: taken */
  put(&folder, "out/mine", "precious");
  struct lod_problem problem = {0};
  assert_int_equal(lod_export_tree(folder.bake, LOD_EXPORT_STATIC, out, NULL, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "output");
  expect(&folder, "out/mine", "precious");
  assert_int_equal(count_entries(&folder), 2);
  finish(&folder);
}

static void a_manifest_that_lies_leaves_nothing_behind(void **state) {
  (void)state;
  const char *kBad[] = {
      "[]",
      "{\"families\":",
      "{\"families\":{\"../x\":{\"levels\":[]}}}",
      "{\"families\":{\"a\":{\"levels\":[{\"object\":\"../../etc/passwd\"}]}}}",
      "{\"families\":{\"a\":{\"levels\":[{}]}}}",
      "{\"families\":{\"a\":{\"levels\":[{\"object\":\"eeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeee\"}]}}}",
      "{\"families\":{\"a\":{\"levels\":[]}},\"textures\":[{\"object\":7}]}",
  };
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    struct folder folder = make(kBad[i]);
    char out[512];
    path_in(&folder, "out", out);
    struct lod_problem problem = {0};
    assert_int_equal(lod_export_tree(folder.bake, LOD_EXPORT_STATIC, out, NULL, &problem), LOD_BAD_INPUT);
    assert_string_not_equal(problem.detail, "");
    assert_int_equal(count_entries(&folder), 1);
    finish(&folder);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_bake_becomes_a_tree_of_plain_files),
      cmocka_unit_test(what_is_there_already_is_left_alone),
      cmocka_unit_test(a_manifest_that_lies_leaves_nothing_behind),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
