/* Numbers in text files: fast, exact, independent of the locale, never past `end`. */
#ifndef LOD_CODEC_IMPORT_NUMBER_H
#define LOD_CODEC_IMPORT_NUMBER_H

#include <stdbool.h>
#include <stdint.h>

/* Reads one decimal number ("1", "-2.5e-3", "nan", "inf") at *at, which must not be white space; moves *at behind it. The nearest double.
 * False when there is none, or something other than white space or `end` follows. */
bool lod_number_read(const char **at, const char *end, double *value);

/* Moves *at over blanks (not over line ends). */
static inline void lod_number_skip_blanks(const char **at, const char *end) {
  while (*at < end && (**at == ' ' || **at == '\t'))
    ++*at;
}

/* Moves *at over all white space. */
static inline void lod_number_skip_space(const char **at, const char *end) {
  while (*at < end && (**at == ' ' || (**at >= '\t' && **at <= '\r')))
    ++*at;
}

#endif
