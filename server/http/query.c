/* Request targets after RFC 3986, query strings after the WHATWG form rule ('+' is a space). */
#include "server/http/query.h"

#include <ctype.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int hex_digit(char c) {
  if (c >= '0' && c <= '9')
    return c - '0';
  c = (char)(c | 0x20);
  return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* Decodes in place. False on a bad escape or a control character, encoded or not: none has a use in an id, a name or a number. */
static bool decode(char *text, bool form) {
  char *out = text;
  for (const char *in = text; *in; in++) {
    unsigned char c = (unsigned char)*in;
    if (c == '%') {
      int high = hex_digit(in[1]), low = high < 0 ? -1 : hex_digit(in[2]);
      if (low < 0)
        return false;
      c = (unsigned char)(high << 4 | low);
      in += 2;
    } else if (c == '+' && form) {
      c = ' ';
    }
    if (c < 0x20 || c == 0x7f)
      return false;
    *out++ = (char)c;
  }
  *out = 0;
  return true;
}

enum lod_status lod_parameter_fail(struct lod_query_problem *problem, const char *name, const char *format, ...) {
  char detail[sizeof problem->problem.detail];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(detail, sizeof detail, format, arguments);
  va_end(arguments);
  snprintf(problem->parameter, sizeof problem->parameter, "%s", name);
  return lod_fail(&problem->problem, LOD_BAD_INPUT, "bad-parameter", "%s", detail);
}

static enum lod_status parse_path(char *path, struct lod_target *target, struct lod_query_problem *problem) {
  if (!*path)
    return LOD_OK;
  for (char *segment = path; segment;) {
    char *slash = strchr(segment, '/');
    if (slash)
      *slash++ = 0;
    if (target->segment_count == LOD_TARGET_SEGMENTS)
      return lod_fail(&problem->problem, LOD_BAD_INPUT, "bad-target", "The path has more than %d segments.", LOD_TARGET_SEGMENTS);
    if (!decode(segment, false))
      return lod_fail(&problem->problem, LOD_BAD_INPUT, "bad-target", "The path has a bad percent escape or a control character.");
    target->segments[target->segment_count++] = segment;
    segment = slash;
  }
  return LOD_OK;
}

static enum lod_status parse_query(char *query, struct lod_target *target, struct lod_query_problem *problem) {
  for (char *pair = query; pair;) {
    char *next = strchr(pair, '&');
    if (next)
      *next++ = 0;
    if (*pair) {
      char *value = strchr(pair, '=');
      if (value)
        *value++ = 0;
      if (!decode(pair, true) || (value && !decode(value, true)))
        return lod_parameter_fail(problem, "", "The query has a bad percent escape or a control character.");
      if (lod_target_find(target, pair))
        return lod_parameter_fail(problem, pair, "The parameter '%.*s' is given twice.", LOD_PARAMETER_NAME_MAX, pair);
      if (target->parameter_count == LOD_TARGET_PARAMETERS)
        return lod_parameter_fail(problem, pair, "The query has more than %d parameters.", LOD_TARGET_PARAMETERS);
      target->parameters[target->parameter_count++] = (struct lod_parameter){pair, value ? value : ""};
    }
    pair = next;
  }
  return LOD_OK;
}

enum lod_status lod_target_parse(char *text, struct lod_target *target, struct lod_query_problem *problem) {
  target->segment_count = target->parameter_count = 0;
  char *fragment = strchr(text, '#');
  if (fragment)
    *fragment = 0;
  char *query = strchr(text, '?');
  if (query)
    *query++ = 0;
  char *path = text;
  if (*path != '/') { /* absolute form, or "*" */
    char *authority = strstr(path, "://");
    path = authority ? authority + 3 : path;
    if (authority)
      path += strcspn(path, "/");
    if (*path && *path != '/') {
      target->segments[target->segment_count++] = path;
      return decode(path, false) ? LOD_OK : lod_fail(&problem->problem, LOD_BAD_INPUT, "bad-target", "The request target is not a path.");
    }
  }
  if (*path == '/')
    path++;
  LOD_TRY(parse_path(path, target, problem));
  return parse_query(query, target, problem);
}

const char *lod_target_find(const struct lod_target *target, const char *name) {
  for (uint32_t i = 0; i < target->parameter_count; i++)
    if (strcmp(target->parameters[i].name, name) == 0)
      return target->parameters[i].value;
  return NULL;
}

enum lod_status lod_target_check_names(const struct lod_target *target, const char *const *known, struct lod_query_problem *problem) {
  for (uint32_t i = 0; i < target->parameter_count; i++) {
    const char *const *name = known;
    while (*name && strcmp(*name, target->parameters[i].name) != 0)
      name++;
    if (!*name)
      return lod_parameter_fail(problem, target->parameters[i].name, "There is no parameter '%.*s' here.", LOD_PARAMETER_NAME_MAX,
                                target->parameters[i].name);
  }
  return LOD_OK;
}

enum lod_status lod_parameter_number(const char *name, const char *text, double below, double *value, struct lod_query_problem *problem) {
  char copy[64];
  size_t size = strlen(text);
  bool plain = size > 0 && size < sizeof copy && strspn(text, "0123456789.eE+- ") == size;
  char *end = copy;
  if (plain) {
    memcpy(copy, text, size + 1);
    /* The '+' of "1e+5" was read as a space by the form rule; leading and other spaces stay wrong because strtod stops or isspace sees
     * them. */
    for (size_t i = 1; i < size; i++)
      if (copy[i] == ' ' && (copy[i - 1] | 0x20) == 'e')
        copy[i] = '+';
    plain = !isspace((unsigned char)copy[0]);
    *value = strtod(copy, &end);
  }
  if (!plain || *end || !isfinite(*value) || !(*value > 0))
    return lod_parameter_fail(problem, name, "'%s' must be a finite number greater than 0, not '%.40s'.", name, text);
  if (below > 0 && *value >= below)
    return lod_parameter_fail(problem, name, "'%s' must be less than %g, not '%.40s'.", name, below, text);
  return LOD_OK;
}

enum lod_status lod_parameter_integer(const char *name, const char *text, uint64_t minimum, uint64_t maximum, uint64_t *value,
                                      struct lod_query_problem *problem) {
  size_t size = strlen(text);
  uint64_t sum = 0;
  bool good = size > 0 && size <= 19 && strspn(text, "0123456789") == size; /* 19 digits fit 64 bits */
  for (size_t i = 0; good && i < size; i++)
    sum = sum * 10 + (uint64_t)(text[i] - '0');
  if (!good || sum < minimum || sum > maximum)
    return lod_parameter_fail(problem, name, "'%s' must be an integer from %llu to %llu, not '%.40s'.", name, (unsigned long long)minimum,
                              (unsigned long long)maximum, text);
  *value = sum;
  return LOD_OK;
}
