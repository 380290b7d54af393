/* What a refinement asks for, from the parameters of a query or a command line. Pure; shared by daemon, worker and tool. */
#ifndef LOD_SERVER_JOBS_REFINE_QUERY_H
#define LOD_SERVER_JOBS_REFINE_QUERY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum {
  LOD_REFINE_QUERY_TERMS = 4,
  LOD_REFINE_QUERY_OBJECTS = 16,
  LOD_REFINE_QUERY_NAME = 64,
  LOD_REFINE_QUERY_STEPS = 10,
  LOD_REFINE_QUERY_PARAMETER = 32,
};

struct lod_refine_parameter {
  const char *name, *value;
};

/* Names as in the query. */
enum lod_refine_interest {
  LOD_INTEREST_UNIFORM,
  LOD_INTEREST_SILHOUETTE,
  LOD_INTEREST_CURVATURE,
  LOD_INTEREST_SCREEN,
  LOD_INTEREST_FOCUS,
  LOD_INTEREST_GAZE,
  LOD_INTEREST_CONTACT,
  LOD_INTEREST_ATTRIBUTE,
  LOD_INTEREST_PATCHES,
  LOD_INTERESTS,
};
enum lod_refine_form { LOD_FORM_FACE, LOD_FORM_EDGE, LOD_FORM_STATIC, LOD_FORM_CONE, LOD_FORMS };
enum lod_refine_per { LOD_PER_COUNT, LOD_PER_TRIANGLE, LOD_PER_CORNER, LOD_PER_VERTEX, LOD_PERS }; /* COUNT: as many as there are say */
enum lod_refine_scheme { LOD_SCHEME_LOOP, LOD_SCHEME_PAPER, LOD_SCHEME_SQRT3, LOD_SCHEMES };

struct lod_refine_query {
  enum lod_refine_interest interests[LOD_REFINE_QUERY_TERMS];
  uint32_t interest_count;
  bool product;
  int gather; /* 0 maximum, 1 mean, 2 minimum */
  enum lod_refine_form form;
  enum lod_refine_scheme scheme;
  uint32_t steps;
  uint64_t max_triangles, max_bytes;      /* 0 = not given */
  char family[LOD_REFINE_QUERY_NAME + 1]; /* of the base; "" = any */
  bool has_level;
  uint32_t level;
  bool has_eye, has_direction, has_look, has_angle;
  double eye[3], direction[3], look[3]; /* look: a point */
  double fov, height, px, angle, threshold, falloff;
  char parts[LOD_REFINE_QUERY_OBJECTS][LOD_REFINE_QUERY_NAME + 1];
  uint32_t part_count;
  double dominance[2 * LOD_REFINE_QUERY_OBJECTS]; /* of the parts, then of the points; 1 unless given */
  double points[LOD_REFINE_QUERY_OBJECTS][3];
  uint32_t point_count;
  bool skeleton;
  int channel; /* attribute: 0 to 3 red, green, blue, alpha; 4, 5 u, v; 6 the model's own interest; -1 = values are sent with the request */
  enum lod_refine_per per;
  double crease, corner, touch;
  bool level_positions, draco;
};

/* list: in any order, each name once. values_sent: a body with numbers came along. On LOD_BAD_INPUT "bad-parameter", `parameter` names the
 * culprit. */
LOD_WARN_UNUSED enum lod_status lod_refine_query_parse(const struct lod_refine_parameter *list, uint32_t count, bool values_sent,
                                                       struct lod_refine_query *query, char parameter[LOD_REFINE_QUERY_PARAMETER + 1],
                                                       struct lod_problem *problem);

/* Names that it knows with a sentence each, NULL behind the last: for help and for tests. */
struct lod_refine_parameter_help {
  const char *name, *sentence;
};
extern const struct lod_refine_parameter_help lod_refine_parameters[];

/* x,y,z: three finite numbers and nothing else. */
bool lod_refine_parse_vector(const char *text, double vector[3]);

#endif
