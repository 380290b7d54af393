/* The request target: percent-decoded path segments and query parameters. Pure; the parser of every hostile URL.
 *
 * A target is split at '/', '?', '&' and '=' before it is decoded, so an encoded slash stays inside its segment and can never make a path.
 */
#ifndef LOD_SERVER_HTTP_QUERY_H
#define LOD_SERVER_HTTP_QUERY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum { LOD_TARGET_SEGMENTS = 16, LOD_TARGET_PARAMETERS = 24, LOD_PARAMETER_NAME_MAX = 32 };

struct lod_parameter {
  const char *name, *value; /* decoded; value is "" for a bare name */
};
struct lod_target {
  const char *segments[LOD_TARGET_SEGMENTS]; /* decoded; "/" has none, "/a/" has "a" and "" */
  uint32_t segment_count;
  struct lod_parameter parameters[LOD_TARGET_PARAMETERS];
  uint32_t parameter_count;
};

/* What is wrong with a request: a problem, and the name of the parameter that it is about ("" = none). */
struct lod_query_problem {
  struct lod_problem problem;
  char parameter[LOD_PARAMETER_NAME_MAX + 1];
};

/* text: the target of the request line ("/a/b?c=d", "http://host/a", "*"), changed in place; `target` points into it.
 * LOD_BAD_INPUT: bad percent encoding, an encoded or raw control character, too many segments or parameters, a parameter given twice. */
LOD_WARN_UNUSED enum lod_status lod_target_parse(char *text, struct lod_target *target, struct lod_query_problem *problem);

/* Value of a parameter, NULL when it is not there. */
const char *lod_target_find(const struct lod_target *target, const char *name);

/* LOD_BAD_INPUT naming the first parameter that is not in `known` (NULL-terminated). */
LOD_WARN_UNUSED enum lod_status lod_target_check_names(const struct lod_target *target, const char *const *known,
                                                       struct lod_query_problem *problem);

/* Finite decimal number > 0 (and < below, unless below is 0). Nothing else may follow; no hexadecimal, "inf" or "nan". */
LOD_WARN_UNUSED enum lod_status lod_parameter_number(const char *name, const char *text, double below, double *value,
                                                     struct lod_query_problem *problem);
/* Decimal integer in [minimum, maximum]. */
LOD_WARN_UNUSED enum lod_status lod_parameter_integer(const char *name, const char *text, uint64_t minimum, uint64_t maximum,
                                                      uint64_t *value, struct lod_query_problem *problem);

/* LOD_BAD_INPUT "bad-parameter" about `name`. */
__attribute__((format(printf, 3, 4))) enum lod_status lod_parameter_fail(struct lod_query_problem *problem, const char *name,
                                                                         const char *format, ...);

#endif
