/* Any bytes as the parameters of a refinement, as a URL's query or as the pairs that a worker is sent: no crash, and what is accepted keeps
 * its promises. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/query.h"
#include "server/jobs/refine_query.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
  if (!condition)
    abort();
}

static void require_finite(const double v[3]) {
  for (int i = 0; i < 3; i++)
    require(isfinite(v[i]) && fabs(v[i]) < 1e30);
}

static void check(const struct lod_refine_query *q, bool values_sent) {
  require(q->interest_count >= 1 && q->interest_count <= LOD_REFINE_QUERY_TERMS);
  for (uint32_t i = 0; i < q->interest_count; i++) {
    require((unsigned)q->interests[i] < LOD_INTERESTS);
    for (uint32_t k = 0; k < i; k++)
      require(q->interests[i] != q->interests[k]);
  }
  require((unsigned)q->form < LOD_FORMS && (unsigned)q->scheme < LOD_SCHEMES && q->gather >= 0 && q->gather <= 2);
  require(q->steps <= LOD_REFINE_QUERY_STEPS && !(q->has_eye && q->has_direction));
  require(q->part_count <= LOD_REFINE_QUERY_OBJECTS && q->point_count <= LOD_REFINE_QUERY_OBJECTS);
  require(strlen(q->family) <= LOD_REFINE_QUERY_NAME);
  for (uint32_t i = 0; i < q->part_count; i++)
    require(q->parts[i][0] != 0 && strlen(q->parts[i]) <= LOD_REFINE_QUERY_NAME);
  for (uint32_t i = 0; i < q->point_count; i++)
    require_finite(q->points[i]);
  for (uint32_t i = 0; i < q->part_count + q->point_count; i++)
    require(q->dominance[i] >= 0 && q->dominance[i] <= 1);
  require_finite(q->eye);
  require_finite(q->direction);
  require_finite(q->look);
  require(q->fov > 0 && q->fov < 180 && q->height > 0 && q->px > 0 && q->angle >= 0 && q->angle <= 90);
  require(q->crease >= 0 && q->crease <= 180 && q->corner >= 0 && q->corner <= 180 && q->touch >= 0 && isfinite(q->touch));
  require(!q->has_direction || q->direction[0] != 0 || q->direction[1] != 0 || q->direction[2] != 0);
  for (uint32_t i = 0; i < q->interest_count; i++) {
    require(q->interests[i] != LOD_INTEREST_FOCUS || q->part_count + q->point_count > 0);
    require(q->interests[i] != LOD_INTEREST_CONTACT || q->point_count == 1);
    require(q->interests[i] != LOD_INTEREST_GAZE || (q->has_eye && q->has_look));
    (void)values_sent;
  }
}

static void parse(const struct lod_refine_parameter *list, uint32_t count, bool values_sent) {
  struct lod_refine_query query;
  struct lod_problem problem = {0};
  char parameter[LOD_REFINE_QUERY_PARAMETER + 1];
  enum lod_status status = lod_refine_query_parse(list, count, values_sent, &query, parameter, &problem);
  if (status == LOD_OK) {
    check(&query, values_sent);
    return;
  }
  require(status == LOD_BAD_INPUT && problem.detail[0] != 0 && strcmp(problem.type, "bad-parameter") == 0);
  require(memchr(parameter, 0, sizeof parameter) != NULL);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  struct lod_refine_parameter list[LOD_TARGET_PARAMETERS];
  struct lod_query_problem problem = {0};
  struct lod_target target;
  if (size == 0)
    return 0;
  char *text = malloc(size + 1);
  if (text == NULL)
    return 0;
  memcpy(text, data + 1, size - 1);
  text[size - 1] = 0;
  bool values_sent = (data[0] & 1) != 0;
  if ((data[0] & 2) == 0) { /* as a URL */
    if (lod_target_parse(text, &target, &problem) == LOD_OK) {
      for (uint32_t i = 0; i < target.parameter_count; i++)
        list[i] = (struct lod_refine_parameter){target.parameters[i].name, target.parameters[i].value};
      parse(list, target.parameter_count, values_sent);
    }
  } else { /* name, value, name, value, one a line: what no URL can say */
    uint32_t count = 0;
    for (char *at = text; at != NULL && count < LOD_TARGET_PARAMETERS;) {
      list[count].name = strsep(&at, "\n");
      list[count].value = at == NULL ? "" : strsep(&at, "\n");
      count++;
    }
    parse(list, count, values_sent);
  }
  free(text);
  return 0;
}
