#include "codec/import/number.h"

#include <math.h>

#include "codec/import/text.h"
#include "tests/data/shapes.h"
#include "tests/unit/codec/import/importing.h"

static void expect_like_strtod(const char *text) {
  size_t length = strlen(text);
  char *exact = malloc(length ? length : 1);
  memcpy(exact, text, length);
  const char *at = exact;
  double value = 0, wanted = strtod(text, NULL);
  if (!lod_number_read(&at, exact + length, &value))
    fail_msg("'%s' is a number", text);
  if (memcmp(&value, &wanted, sizeof value) != 0)
    fail_msg("'%s' is %.17g, got %.17g", text, wanted, value);
  assert_ptr_equal(at, exact + length);
  free(exact);
}

static void decimals_are_read_as_the_nearest_double(void **state) {
  (void)state;
  static const char *const kTexts[] = {"0",
                                       "-0",
                                       "+1",
                                       "1.",
                                       ".5",
                                       "-.5e1",
                                       "1e22",
                                       "1e23",
                                       "123456789012345",
                                       "1234567890123456789",
                                       "0.1",
                                       "1e-22",
                                       "1e-23",
                                       "4.9406564584124654e-324",
                                       "1.7976931348623157e308",
                                       "5.841406E-07",
                                       "00000000000000000000001",
                                       "0.000000000000000000001"};
  for (size_t i = 0; i < sizeof kTexts / sizeof *kTexts; i++)
    expect_like_strtod(kTexts[i]);
  uint64_t seed = 3;
  for (int i = 0; i < 200000; i++) {
    char text[64];
    double value = (lod_random_unit(&seed) - 0.5) * pow(10, (double)(lod_random_next(&seed) % 40) - 20);
    snprintf(text, sizeof text, "%.*g", 1 + (int)(lod_random_next(&seed) % 17), value);
    expect_like_strtod(text);
    snprintf(text, sizeof text, "%.*f", (int)(lod_random_next(&seed) % 12), value);
    expect_like_strtod(text);
  }
}

static void what_is_no_number_is_refused(void **state) {
  (void)state;
  static const char *const kTexts[] = {"", "-", ".", "e5", "1e", "1e+", "0x10", "1,5", "12abc", "--1"};
  for (size_t i = 0; i < sizeof kTexts / sizeof *kTexts; i++) {
    const char *at = kTexts[i];
    double value;
    assert_false(lod_number_read(&at, kTexts[i] + strlen(kTexts[i]), &value));
  }
}

static void text_becomes_utf8_without_control_characters(void **state) {
  (void)state;
  char text[] = "a\xC3\xA4\xE2\x98\x83\xF0\x9F\x98\x80 \xFF\xC3\x28\xED\xA0\x80\xE0\x80\x80\n\x7F\xC3";
  lod_text_clean(text);
  assert_string_equal(text, "a\xC3\xA4\xE2\x98\x83\xF0\x9F\x98\x80 ?"
                            "?("
                            "?"
                            "?"
                            "?"
                            "?"
                            "?"
                            "?"
                            "  "
                            "?");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(decimals_are_read_as_the_nearest_double),
      cmocka_unit_test(what_is_no_number_is_refused),
      cmocka_unit_test(text_becomes_utf8_without_control_characters),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
