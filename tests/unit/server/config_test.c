#include "server/config.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static struct lod_config config;
static struct lod_problem problem;
static enum lod_config_action action;

static enum lod_status read_flags(char *const *flags) {
  int count = 0;
  while (flags[count])
    count++;
  lod_config_finish(&config);
  memset(&problem, 0, sizeof problem);
  return lod_config_read(count, flags, "/nowhere/bin/lodestreamd", &config, &action, &problem);
}
#define FLAGS(...) read_flags((char *[]){"lodestreamd", __VA_ARGS__, NULL})

static void settings_have_defaults(void **state) {
  (void)state;
  assert_int_equal(FLAGS("--store", "s"), LOD_OK);
  assert_string_equal(config.store, "s");
  assert_string_equal(config.listen, "127.0.0.1:8080");
  assert_int_equal(config.upload_bytes, 1 << 30);
  assert_int_equal(config.bakes, 1);
  assert_string_equal(config.cors, "*");
}

static void both_spellings_of_a_flag_work_and_the_last_wins(void **state) {
  (void)state;
  assert_int_equal(FLAGS("--store=s", "--connections=100", "--connections", "200", "--rate-bytes", "64KiB"), LOD_OK);
  assert_int_equal(config.connections, 200);
  assert_int_equal(config.rate_bytes, 65536);
}

static void file_is_read_first_and_flags_win(void **state) {
  (void)state;
  char path[] = "/tmp/lodestream-config-XXXXXX";
  FILE *file = fdopen(mkstemp(path), "w");
  fputs("# a comment\n\n  store = /var/models dir \nbakes=3\nupload-bytes = 2MiB\r\nlisten =127.0.0.1:0", file);
  fclose(file);
  enum lod_status status = FLAGS("--bakes", "4", "--config", path);
  unlink(path);
  assert_int_equal(status, LOD_OK);
  assert_string_equal(config.store, "/var/models dir");
  assert_int_equal(config.bakes, 4);
  assert_int_equal(config.upload_bytes, 2 << 20);
  assert_string_equal(config.listen, "127.0.0.1:0");
}

static void wrong_flags_are_told(void **state) {
  (void)state;
  assert_int_equal(FLAGS("--listen", "x:1"), LOD_BAD_INPUT);
  assert_non_null(strstr(problem.detail, "--store"));
  assert_int_equal(FLAGS("--store", "s", "--loop", "1"), LOD_BAD_INPUT);
  assert_non_null(strstr(problem.detail, "--loop"));
  assert_int_equal(FLAGS("--store"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "extra"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--bakes", "0"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--bakes", "-1"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--bakes", "1K"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--upload-bytes", "99999999999999999999"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--upload-bytes", "18014398509481984KiB"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--tls-cert", "c"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--log", "xml"), LOD_BAD_INPUT);
  assert_int_equal(FLAGS("--store", "s", "--config", "/nowhere/at/all"), LOD_BAD_INPUT);
}

static void wrong_line_of_a_file_is_named(void **state) {
  (void)state;
  memset(&problem, 0, sizeof problem);
  assert_int_equal(lod_config_read_text("f", "# x\nlisten = a\ncolour = red\n", &config, &problem), LOD_BAD_INPUT);
  assert_non_null(strstr(problem.detail, "f, line 3"));
  assert_non_null(strstr(problem.detail, "colour"));
  memset(&problem, 0, sizeof problem);
  assert_int_equal(lod_config_read_text("f", "listen\n", &config, &problem), LOD_BAD_INPUT);
  assert_non_null(strstr(problem.detail, "line 1"));
}

static void help_and_version_need_nothing_else(void **state) {
  (void)state;
  assert_int_equal(FLAGS("--help"), LOD_OK);
  assert_int_equal(action, LOD_CONFIG_HELP);
  assert_int_equal(FLAGS("--version"), LOD_OK);
  assert_int_equal(action, LOD_CONFIG_VERSION);
}

static void help_names_every_setting_that_a_file_may_set(void **state) {
  (void)state;
  char *text = NULL;
  size_t size;
  FILE *out = open_memstream(&text, &size);
  lod_config_help(out);
  fclose(out);
  static const char *const kNames[] = {"--store DIR",    "--listen HOST:PORT", "--models DIR", "--token-file FILE", "--tls-cert FILE",
                                       "--tls-key FILE", "--config FILE",      "--viewer DIR", "--worker PATH",     "--help",
                                       "--version"};
  for (size_t i = 0; i < sizeof kNames / sizeof *kNames; i++)
    assert_non_null(strstr(text, kNames[i]));
  free(text);
}

static void limits_that_were_set_reach_the_worker(void **state) {
  (void)state;
  assert_int_equal(FLAGS("--store", "s"), LOD_OK);
  char *json = lod_config_limits_json(&config);
  assert_string_equal(json, "{}");
  free(json);
  assert_int_equal(FLAGS("--store", "s", "--limit-vertices", "1000", "--limit-texture-bytes", "1MiB"), LOD_OK);
  json = lod_config_limits_json(&config);
  assert_string_equal(json, "{\"vertices\":1000,\"texture_bytes\":1048576}");
  free(json);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(settings_have_defaults),
      cmocka_unit_test(both_spellings_of_a_flag_work_and_the_last_wins),
      cmocka_unit_test(file_is_read_first_and_flags_win),
      cmocka_unit_test(wrong_flags_are_told),
      cmocka_unit_test(wrong_line_of_a_file_is_named),
      cmocka_unit_test(help_and_version_need_nothing_else),
      cmocka_unit_test(help_names_every_setting_that_a_file_may_set),
      cmocka_unit_test(limits_that_were_set_reach_the_worker),
  };
  int failed = cmocka_run_group_tests(tests, NULL, NULL);
  lod_config_finish(&config);
  return failed;
}
