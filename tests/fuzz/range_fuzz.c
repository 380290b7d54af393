/* Any bytes as Range, If-None-Match, If-Range and Accept-Encoding: no crash, and a part lies inside of the whole. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/response.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
  if (!condition)
    abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static const uint64_t kSizes[] = {0, 1, 10, UINT64_C(1) << 40, UINT64_MAX};
  char *text = malloc(size + 1);
  if (!text)
    return 0;
  memcpy(text, data, size);
  text[size] = 0;
  for (size_t i = size % 2; i < sizeof kSizes / sizeof *kSizes; i += 2) { /* half of them at a time: runs are short */
    uint64_t first, count;
    if (lod_range_parse(text, kSizes[i], &first, &count) == LOD_RANGE_PART)
      require(count > 0 && first < kSizes[i] && count <= kSizes[i] - first);
    const struct lod_conditions conditions = {
        .if_none_match = text, .if_match = i % 2 ? text : NULL, .if_range = text, .range = text, .get = true};
    struct lod_plan plan = lod_conditions_plan(&conditions, "\"a\"", kSizes[i]);
    require(plan.status == 200 || plan.status == 206 || plan.status == 304 || plan.status == 412 || plan.status == 416);
  }
  lod_accepts_gzip(text);
  char *copy = lod_utf8_copy(text);
  require(!copy || strlen(copy) == strlen(text));
  free(copy);
  free(text);
  return 0;
}
