/* Decimal text to double.
 *
 * Based on: Clinger. How to read floating point numbers accurately. 1990. At most 15 digits (below 2^53) times or over a power of ten up
 * to 10^22 is one rounding of two exact doubles, hence the nearest double. Everything else goes to strtod. */
#include "codec/import/number.h"

#include <locale.h>
#include <stdlib.h>
#include <string.h>

static const double kPowersOfTen[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                      1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

static bool is_space(char c) {
  return c == ' ' || (c >= '\t' && c <= '\r');
}

/* The rare rest: many digits, large exponents, nan, inf. */
static bool read_slowly(const char **at, const char *end, double *value) {
  char token[512];
  size_t n = 0;
  const char *p = *at;
  while (p < end && !is_space(*p) && n + 1 < sizeof token) {
    char c = *p++;
    /* No hexadecimal floats: no format of ours has them. */
    if (c == 'x' || c == 'X' || c == '(')
      return false;
    token[n++] = c;
  }
  if (n == 0 || (p < end && !is_space(*p)))
    return false;
  token[n] = 0;
  static const char kPoint[] = ".";
  const char *point = localeconv()->decimal_point;
  char *dot = strchr(token, '.');
  if (dot && strcmp(point, kPoint) != 0 && strlen(point) == 1)
    *dot = point[0];
  char *stop;
  *value = strtod(token, &stop);
  *at = p;
  return *stop == 0;
}

bool lod_number_read(const char **at, const char *end, double *value) {
  const char *p = *at;
  bool negative = p < end && *p == '-';
  if (p < end && (*p == '-' || *p == '+'))
    p++;
  uint64_t digits = 0;
  int count = 0, scale = 0;
  const char *first = p;
  for (; p < end && *p >= '0' && *p <= '9'; p++) {
    digits = digits * 10 + (uint64_t)(*p - '0');
    count += count > 0 || *p != '0';
    if (count > 15)
      return read_slowly(at, end, value);
  }
  bool any = p > first;
  if (p < end && *p == '.') {
    p++;
    for (; p < end && *p >= '0' && *p <= '9'; p++) {
      digits = digits * 10 + (uint64_t)(*p - '0');
      count += count > 0 || *p != '0';
      scale--;
      any = true;
      if (count > 15 || scale < -300)
        return read_slowly(at, end, value);
    }
  }
  if (!any)
    return read_slowly(at, end, value);
  if (p < end && (*p == 'e' || *p == 'E')) {
    p++;
    bool minus = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+'))
      p++;
    int exponent = 0;
    const char *exponent_first = p;
    for (; p < end && *p >= '0' && *p <= '9' && exponent < 1000; p++)
      exponent = exponent * 10 + (*p - '0');
    if (p == exponent_first)
      return false;
    scale += minus ? -exponent : exponent;
  }
  if (scale < -22 || scale > 22)
    return read_slowly(at, end, value);
  if (p < end && !is_space(*p))
    return false;
  double result = scale < 0 ? (double)digits / kPowersOfTen[-scale] : (double)digits * kPowersOfTen[scale];
  *value = negative ? -result : result;
  *at = p;
  return true;
}
