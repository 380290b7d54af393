#include "codec/import/text.h"

#include <stddef.h>

/* Length of the well-formed sequence at p (Unicode 15, table 3-7), 0 = none. */
static size_t sequence_length(const unsigned char *p) {
  unsigned char lead = p[0], low = 0x80, high = 0xBF;
  size_t length;
  if (lead < 0x80)
    return 1;
  if (lead >= 0xC2 && lead <= 0xDF)
    length = 2;
  else if (lead >= 0xE0 && lead <= 0xEF)
    length = 3;
  else if (lead >= 0xF0 && lead <= 0xF4)
    length = 4;
  else
    return 0;
  if (lead == 0xE0)
    low = 0xA0;
  if (lead == 0xED)
    high = 0x9F;
  if (lead == 0xF0)
    low = 0x90;
  if (lead == 0xF4)
    high = 0x8F;
  for (size_t i = 1; i < length; i++) {
    if (p[i] < low || p[i] > high)
      return 0;
    low = 0x80;
    high = 0xBF;
  }
  return length;
}

void lod_text_clean(char *text) {
  for (unsigned char *p = (unsigned char *)text; *p;) {
    size_t length = sequence_length(p);
    if (length == 0)
      *p = '?';
    else if (*p < 0x20 || *p == 0x7F)
      *p = ' ';
    p += length ? length : 1;
  }
}
