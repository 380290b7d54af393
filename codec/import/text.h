/* Strings of uploaded files end in JSON, so they must be UTF-8 without control characters. */
#ifndef LOD_CODEC_IMPORT_TEXT_H
#define LOD_CODEC_IMPORT_TEXT_H

/* In place: every byte that is no part of well-formed UTF-8 becomes '?', every control character a space. */
void lod_text_clean(char *text);

#endif
