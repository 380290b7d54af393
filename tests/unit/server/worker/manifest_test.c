/* A bound stays one when it is written down. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "server/worker/manifest.h"
#include "tests/data/shapes.h"

static double written(double value) {
  char text[40];
  snprintf(text, sizeof text, "%.9g", value); /* as jansson does */
  return strtod(text, NULL);
}

static void written_bounds_hold(void **state) {
  (void)state;
  uint64_t seed = 3;
  for (int i = 0; i < 200000; i++) {
    double value = ldexp(1 + lod_random_unit(&seed), (int)(lod_random_next(&seed) % 60) - 40);
    assert_true(written(lod_manifest_raise(value)) >= value);
    assert_true(written(lod_manifest_lower(value)) <= value);
    assert_true(written(lod_manifest_raise(value)) <= value * (1 + 2e-8));
  }
  const double seen = 1.716336290587937e-06; /* once fell below what it bounds */
  assert_true(written(lod_manifest_raise(seen)) >= seen);
  assert_true(written(lod_manifest_raise(0)) == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(written_bounds_hold),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
