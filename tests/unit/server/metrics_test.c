#include "server/metrics.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const kRoutes[] = {"/a", "other"}, *const kCuts[] = {"no", "idle"};

/* Every sample belongs to a family that has HELP and TYPE above it. */
static void every_metric_has_help_and_type(void **state) {
  (void)state;
  struct lod_metrics *metrics = lod_metrics_create(kRoutes, 2, kCuts, 2);
  lod_metrics_request(metrics, 0, 200, 0.001);
  lod_metrics_request(metrics, 1, 418, 100);
  lod_metrics_cut(metrics, 1);
  size_t size;
  char *text = lod_metrics_text(metrics, NULL, 0, &size), family[128] = "", help[128] = "";
  assert_int_equal(strlen(text), size);
  unsigned samples = 0;
  for (char *line = strtok(text, "\n"); line; line = strtok(NULL, "\n")) {
    if (sscanf(line, "# HELP %127s", help) == 1) {
      assert_true(strlen(line) > strlen("# HELP ") + strlen(help) + 5);
      continue;
    }
    if (sscanf(line, "# TYPE %127s", family) == 1) {
      assert_string_equal(family, help);
      continue;
    }
    assert_int_equal(strncmp(line, family, strlen(family)), 0);
    samples++;
  }
  assert_true(samples > LOD_METRIC_COUNT);
  free(text);
  lod_metrics_destroy(metrics);
}

static void counts_appear_under_their_labels(void **state) {
  (void)state;
  struct lod_metrics *metrics = lod_metrics_create(kRoutes, 2, kCuts, 2);
  for (int i = 0; i < 3; i++)
    lod_metrics_request(metrics, 0, 200, 0.002);
  lod_metrics_request(metrics, 0, 599, 20);
  lod_metrics_add(metrics, LOD_METRIC_CONNECTIONS, 5);
  lod_metrics_add(metrics, LOD_METRIC_CONNECTIONS, -2);
  lod_metrics_set(metrics, LOD_METRIC_BAKE_SECONDS, 1.5);
  lod_metrics_cut(metrics, 1);
  size_t size;
  char *text = lod_metrics_text(metrics, NULL, 0, &size);
  static const char *const kLines[] = {
      "lodestream_http_requests_total{route=\"/a\",status=\"200\"} 3\n",
      "lodestream_http_requests_total{route=\"/a\",status=\"other\"} 1\n",
      "lodestream_http_request_duration_seconds_bucket{route=\"/a\",le=\"0.001\"} 0\n",
      "lodestream_http_request_duration_seconds_bucket{route=\"/a\",le=\"0.0025\"} 3\n",
      "lodestream_http_request_duration_seconds_bucket{route=\"/a\",le=\"10\"} 3\n",
      "lodestream_http_request_duration_seconds_bucket{route=\"/a\",le=\"+Inf\"} 4\n",
      "lodestream_http_request_duration_seconds_count{route=\"/a\"} 4\n",
      "lodestream_http_connections 3\n",
      "lodestream_bake_seconds_total 1.500\n",
      "lodestream_http_connections_cut_total{reason=\"idle\"} 1\n",
  };
  for (size_t i = 0; i < sizeof kLines / sizeof *kLines; i++)
    if (!strstr(text, kLines[i]))
      fail_msg("missing: %s in\n%s", kLines[i], text);
  free(text);
  lod_metrics_destroy(metrics);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_metric_has_help_and_type),
      cmocka_unit_test(counts_appear_under_their_labels),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
