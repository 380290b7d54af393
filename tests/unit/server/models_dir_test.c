#include "server/models_dir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <string.h>

static void file_name_becomes_an_id(void **state) {
  (void)state;
  static const char *const kPairs[][2] = {
      {"bunny.ply", "bunny"}, {"Stanford Bunny (1).glb", "Stanford-Bunny--1-"},
      {"a.b.stl", "a.b"},     {"noextension", "noextension"},
      {"-dash.obj", "dash"},  {"\xc3\xa9t\xc3\xa9.ply", "t--"},
      {"../x.ply", "x"},
  };
  char id[LOD_MODEL_ID_MAX + 1];
  for (size_t i = 0; i < sizeof kPairs / sizeof *kPairs; i++) {
    assert_true(lod_models_dir_id(kPairs[i][0], id) || kPairs[i][0][0] == '.');
    if (kPairs[i][0][0] != '.')
      assert_string_equal(id, kPairs[i][1]);
  }
}

static void companions_and_hidden_files_are_no_models(void **state) {
  (void)state;
  static const char *const kNames[] = {".hidden.ply", "scene.bin",     "skin.PNG", "wood.mtl", "README.md",
                                       "bunny.ply~",  "download.part", "",         "---.ply",  "\xff.ply"};
  char id[LOD_MODEL_ID_MAX + 1];
  for (size_t i = 0; i < sizeof kNames / sizeof *kNames; i++)
    assert_false(lod_models_dir_id(kNames[i], id));
}

static void long_name_is_cut_to_a_valid_id(void **state) {
  (void)state;
  char name[300], id[LOD_MODEL_ID_MAX + 1];
  memset(name, 'a', sizeof name);
  strcpy(name + 250, ".ply");
  assert_true(lod_models_dir_id(name, id));
  assert_int_equal(strlen(id), LOD_MODEL_ID_MAX);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(file_name_becomes_an_id),
      cmocka_unit_test(companions_and_hidden_files_are_no_models),
      cmocka_unit_test(long_name_is_cut_to_a_valid_id),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
