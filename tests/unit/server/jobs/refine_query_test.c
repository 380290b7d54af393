/* The parameters of a refinement: what they mean, and which of them is named when they mean nothing. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "server/jobs/refine_query.h"

/* "a=b&c=d" into a query; returns the parameter that is wrong, or NULL. */
static const char *parse(const char *text, bool values, struct lod_refine_query *query) {
  static char parameter[LOD_REFINE_QUERY_PARAMETER + 1];
  static char copy[1024];
  struct lod_refine_parameter list[40];
  struct lod_problem problem = {0};
  uint32_t count = 0;
  snprintf(copy, sizeof copy, "%s", text);
  for (char *save = NULL, *pair = strtok_r(copy, "&", &save); pair != NULL; pair = strtok_r(NULL, "&", &save)) {
    char *equals = strchr(pair, '=');
    *equals = 0;
    list[count++] = (struct lod_refine_parameter){pair, equals + 1};
  }
  if (lod_refine_query_parse(list, count, values, query, parameter, &problem) == LOD_OK)
    return NULL;
  assert_int_equal(problem.status, LOD_BAD_INPUT);
  assert_string_equal(problem.type, "bad-parameter");
  assert_true(strlen(problem.detail) > 10);
  return parameter;
}

static void test_good_queries_are_understood(void **state) {
  (void)state;
  struct lod_refine_query q;
  assert_null(parse("doi=uniform&steps=3", false, &q));
  assert_int_equal(q.interest_count, 1);
  assert_int_equal(q.steps, 3);
  assert_null(parse("doi=silhouette&eye=1,-2.5,3e2&steps=3&angle=20", false, &q));
  assert_true(q.has_eye && q.eye[0] == 1 && q.eye[1] == -2.5 && q.eye[2] == 300 && q.has_angle && q.angle == 20);
  assert_null(parse("doi=silhouette&form=static&angle=30", false, &q));
  assert_null(parse("doi=focus,screen&combine=product&part=bracelet,2&falloff=0.5&eye=0,0,1&px=2", false, &q));
  assert_true(q.product && q.part_count == 2 && q.falloff == 0.5 && q.px == 2);
  assert_string_equal(q.parts[0], "bracelet");
  assert_null(parse("doi=gaze&eye=0,0,5&look=0,1,0&base=envelope:3&max_triangles=1000000000", false, &q));
  assert_true(q.has_level && q.level == 3 && q.max_triangles == 1000000000);
  assert_string_equal(q.family, "envelope");
  assert_null(parse("doi=focus&point=1,2,3;4,5,6", false, &q));
  assert_int_equal(q.point_count, 2);
  assert_null(parse("doi=contact&point=0,0,0", false, &q));
  assert_null(parse("doi=attribute", true, &q));
  assert_null(parse("doi=attribute&attribute=red&gather=mean", false, &q));
  assert_null(parse("doi=uniform&scheme=sqrt3&crease=40&corner=30&touch=0.001&positions=level&encoding=draco", false, &q));
}

static void test_each_bad_query_names_its_culprit(void **state) {
  (void)state;
  static const struct {
    const char *query, *parameter;
    bool values;
  } kBad[] = {
      {"steps=3", "doi", false},
      {"doi=", "doi", false},
      {"doi=nothing", "doi", false},
      {"doi=uniform,uniform", "doi", false},
      {"doi=uniform,curvature,silhouette,screen,gaze", "doi", false},
      {"doi=silhouette", "eye", false},
      {"doi=silhouette&eye=1,2", "eye", false},
      {"doi=silhouette&eye=1,2,x", "eye", false},
      {"doi=silhouette&eye=1,2,3,4", "eye", false},
      {"doi=silhouette&eye=nan,0,0", "eye", false},
      {"doi=silhouette&eye=1e999,0,0", "eye", false},
      {"doi=silhouette&direction=0,0,0", "direction", false},
      {"doi=silhouette&direction=0,0,1&eye=0,0,1", "direction", false},
      {"doi=silhouette&eye=0,0,1&form=round", "form", false},
      {"doi=silhouette&eye=0,0,1&angle=91", "angle", false},
      {"doi=silhouette&eye=0,0,1&angle=-1", "angle", false},
      {"doi=uniform&eye=0,0,1", "eye", false},
      {"doi=uniform&colour=red", "colour", false},
      {"doi=uniform&steps=2&steps=3", "steps", false},
      {"doi=uniform&steps=11", "steps", false},
      {"doi=uniform&steps=-1", "steps", false},
      {"doi=uniform&steps=", "steps", false},
      {"doi=uniform&max_triangles=0", "max_triangles", false},
      {"doi=uniform&max_triangles=99999999999999999999", "max_triangles", false},
      {"doi=uniform&base=", "base", false},
      {"doi=uniform&base=:3", "base", false},
      {"doi=uniform&base=cluster:x", "base", false},
      {"doi=gaze&eye=0,0,1", "look", false},
      {"doi=gaze&look=0,0,1", "eye", false},
      {"doi=gaze&eye=0,0,1&look=0,0,1", "look", false},
      {"doi=screen&eye=0,0,1&fov=180", "fov", false},
      {"doi=screen&eye=0,0,1&px=0", "px", false},
      {"doi=focus", "part", false},
      {"doi=focus&part=,", "part", false},
      {"doi=focus&point=1,2,3;", "point", false},
      {"doi=focus&point=1,2,3&distance=far", "distance", false},
      {"doi=contact", "point", false},
      {"doi=contact&point=1,2,3;4,5,6", "point", false},
      {"doi=contact,uniform&point=1,2,3&combine=product", "combine", false},
      {"doi=contact&point=1,2,3&scheme=paper", "scheme", false},
      {"doi=attribute", "attribute", false},
      {"doi=attribute&attribute=smell", "attribute", false},
      {"doi=attribute&attribute=red", "attribute", true},
      {"doi=uniform", "doi", true},
      {"doi=attribute&per=face", "per", true},
      {"doi=attribute&per=vertex&attribute=red", "per", false},
      {"doi=focus&part=a,b&dominance=1", "dominance", false},
      {"doi=focus&part=a&dominance=1,1", "dominance", false},
      {"doi=focus&part=a&dominance=1.1", "dominance", false},
      {"doi=focus&part=a&dominance=0.5,", "dominance", false},
      {"doi=curvature&dominance=1", "dominance", false},
      {"doi=uniform&combine=sum", "combine", false},
  };
  struct lod_refine_query q;
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    const char *parameter = parse(kBad[i].query, kBad[i].values, &q);
    if (parameter == NULL || strcmp(parameter, kBad[i].parameter) != 0)
      fail_msg("%s: '%s' instead of '%s'", kBad[i].query, parameter == NULL ? "(accepted)" : parameter, kBad[i].parameter);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_good_queries_are_understood),
      cmocka_unit_test(test_each_bad_query_names_its_culprit),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
