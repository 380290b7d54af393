/* Any bytes as a request target, then as the query of a level: no crash, and what is accepted keeps its promises. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/select.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
  if (!condition)
    abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static struct lod_stored_level levels[] = {{.level = 0, .facts = {.error = 1, .cell = 2, .bytes = 10, .triangles = 1}},
                                             {.level = 1, .facts = {.error = 0.1, .cell = 0.2, .bytes = 100, .triangles = 10}}};
  static struct lod_stored_family family = {"cluster", true, 2, levels};
  static const struct lod_stored_model model = {.id = "m", .family_count = 1, .families = &family};
  char *text = malloc(size + 1);
  if (!text)
    return 0;
  memcpy(text, data, size);
  text[size] = 0;
  struct lod_target target;
  struct lod_query_problem problem = {0};
  if (lod_target_parse(text, &target, &problem) == LOD_OK) {
    for (uint32_t i = 0; i < target.segment_count; i++)
      for (const char *p = target.segments[i]; *p; p++)
        require((unsigned char)*p >= 0x20 && *p != 0x7f);
    struct lod_selection selection;
    struct lod_choice choice;
    if (lod_selection_parse(&target, &selection, &problem) == LOD_OK) {
      require(isfinite(selection.limit) && selection.limit >= 0);
      if (lod_selection_choose(&selection, &model, &choice, &problem) == LOD_OK)
        require(choice.family == &family && (choice.level == &levels[0] || choice.level == &levels[1]));
      else
        require(problem.problem.detail[0] != 0);
    } else {
      require(problem.problem.status == LOD_BAD_INPUT && problem.problem.detail[0] != 0);
    }
  } else {
    require(problem.problem.status == LOD_BAD_INPUT);
  }
  free(text);
  return 0;
}
