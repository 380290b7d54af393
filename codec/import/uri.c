/* URIs of files that a model refers to: data URIs are decoded, relative ones are checked and read through the caller. */
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "codec/import/reader.h"

static int hex_digit(char c) {
  if (c >= '0' && c <= '9')
    return c - '0';
  if (c >= 'a' && c <= 'f')
    return c - 'a' + 10;
  return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* In place is allowed. A '%' without two digits stays as it is: files named so exist. Returns the new length. */
static size_t percent_decode(const char *text, size_t length, char *out) {
  size_t n = 0;
  for (size_t i = 0; i < length; i++) {
    if (text[i] == '%' && i + 2 < length && hex_digit(text[i + 1]) >= 0 && hex_digit(text[i + 2]) >= 0) {
      out[n++] = (char)(hex_digit(text[i + 1]) * 16 + hex_digit(text[i + 2]));
      i += 2;
    } else {
      out[n++] = text[i];
    }
  }
  return n;
}

static int base64_value(char c) {
  if (c >= 'A' && c <= 'Z')
    return c - 'A';
  if (c >= 'a' && c <= 'z')
    return c - 'a' + 26;
  if (c >= '0' && c <= '9')
    return c - '0' + 52;
  if (c == '+' || c == '-')
    return 62;
  return c == '/' || c == '_' ? 63 : -1;
}

/* Writes at most 3 * (length / 4 + 1) bytes; false when a character is no base64. */
static bool base64_decode(const char *text, size_t length, uint8_t *out, size_t *size) {
  uint32_t bits = 0;
  int held = 0;
  size_t n = 0;
  while (length > 0 && text[length - 1] == '=')
    length--;
  for (size_t i = 0; i < length; i++) {
    int value = base64_value(text[i]);
    if (value < 0)
      return false;
    bits = bits << 6 | (uint32_t)value;
    held += 6;
    if (held >= 8) {
      held -= 8;
      out[n++] = (uint8_t)(bits >> held);
    }
  }
  *size = n;
  return held < 6;
}

static enum lod_status open_data(struct lod_reader *reader, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size) {
  const char *comma = strchr(uri, ',');
  if (!comma)
    return lod_reader_bad(reader, "bad-uri", "a data URI has no comma before its data");
  const char *data = comma + 1;
  size_t length = strlen(data);
  size_t header = (size_t)(comma - uri);
  bool base64 = header >= 7 && strncasecmp(comma - 7, ";base64", 7) == 0;
  /* No larger than its text, which the file's own size already counts. */
  uint8_t *out = lod_arena_alloc(arena, length + 4, 1);
  if (!out)
    return lod_reader_memory(reader);
  if (!base64) {
    *size = percent_decode(data, length, (char *)out);
  } else {
    /* Some writers percent-encode '+', '/' and '='. */
    size_t plain = percent_decode(data, length, (char *)out);
    if (!base64_decode((const char *)out, plain, out, size))
      return lod_reader_bad(reader, "bad-uri", "a data URI holds characters that are not base64");
  }
  *bytes = out;
  return LOD_OK;
}

/* scheme = ALPHA *( ALPHA / DIGIT / "+" / "-" / "." ) ":" (RFC 3986, 3.1) */
static bool has_scheme(const char *path) {
  const char *p = path;
  if (!((*p >= 'a' && *p <= 'z') || (*p >= 'A' && *p <= 'Z')))
    return false;
  while ((*p >= 'a' && *p <= 'z') || (*p >= 'A' && *p <= 'Z') || (*p >= '0' && *p <= '9') || *p == '+' || *p == '-' || *p == '.')
    p++;
  return *p == ':';
}

static bool is_safe(const char *path, size_t length) {
  if (length == 0 || strlen(path) != length || path[0] == '/' || has_scheme(path))
    return false;
  for (const char *p = path; *p; p++)
    if ((unsigned char)*p < 0x20 || *p == 0x7F || *p == '\\')
      return false;
  for (const char *segment = path; segment; segment = strchr(segment, '/')) {
    segment += *segment == '/';
    size_t n = strcspn(segment, "/");
    if (n == 2 && segment[0] == '.' && segment[1] == '.')
      return false;
  }
  return true;
}

static enum lod_status check_safe(struct lod_reader *reader, const char *path, size_t length, const char *original) {
  if (is_safe(path, length))
    return LOD_OK;
  return lod_reader_bad(reader, "unsafe-uri", "refers to '%.200s'; only relative paths beneath the model's own folder are read", original);
}

static enum lod_status open_checked(struct lod_reader *reader, const char *path, size_t length, const char *original,
                                    struct lod_arena *arena, const uint8_t **bytes, size_t *size) {
  LOD_TRY(check_safe(reader, path, length, original));
  if (!reader->files)
    return lod_reader_bad(reader, "missing-file",
                          "refers to '%.200s', but the model came without further files; expected a self-contained file", original);
  struct lod_problem problem = {0};
  enum lod_status status = reader->files->read(reader->files->context, path, arena, bytes, size, &problem);
  if (status != LOD_OK)
    return lod_reader_fail(reader, status, problem.type, "%s", problem.detail);
  return lod_reader_add_bytes(reader, *size);
}

static bool is_data(const char *uri) {
  return strncasecmp(uri, "data:", 5) == 0;
}

static enum lod_status decode_path(struct lod_reader *reader, const char *uri, char **path, size_t *length) {
  *path = lod_arena_copy(reader->scratch, uri, strlen(uri));
  if (!*path)
    return lod_reader_memory(reader);
  *length = percent_decode(uri, strlen(uri), *path);
  (*path)[*length] = 0;
  return LOD_OK;
}

enum lod_status lod_reader_check_uri(struct lod_reader *reader, const char *uri) {
  char *path = NULL;
  size_t length = 0;
  if (is_data(uri))
    return LOD_OK;
  LOD_TRY(decode_path(reader, uri, &path, &length));
  return check_safe(reader, path, length, uri);
}

enum lod_status lod_reader_open_uri(struct lod_reader *reader, const char *uri, struct lod_arena *arena, const uint8_t **bytes,
                                    size_t *size) {
  char *path = NULL;
  size_t length = 0;
  if (is_data(uri))
    return open_data(reader, uri, arena, bytes, size);
  LOD_TRY(decode_path(reader, uri, &path, &length));
  return open_checked(reader, path, length, uri, arena, bytes, size);
}

enum lod_status lod_reader_open_path(struct lod_reader *reader, const char *path, struct lod_arena *arena, const uint8_t **bytes,
                                     size_t *size) {
  char *copy = lod_arena_copy(reader->scratch, path, strlen(path));
  if (!copy)
    return lod_reader_memory(reader);
  for (char *p = copy; *p; p++)
    if (*p == '\\')
      *p = '/';
  while (copy[0] == '.' && copy[1] == '/')
    copy += 2;
  return open_checked(reader, copy, strlen(copy), path, arena, bytes, size);
}

enum lod_status lod_reader_open_optional(struct lod_reader *reader, const char *name, bool is_uri, struct lod_arena *arena,
                                         const uint8_t **bytes, size_t *size) {
  struct lod_problem *outer = reader->problem, local = {0};
  reader->problem = &local;
  *bytes = NULL;
  enum lod_status status =
      is_uri ? lod_reader_open_uri(reader, name, arena, bytes, size) : lod_reader_open_path(reader, name, arena, bytes, size);
  reader->problem = outer;
  if (status == LOD_OK)
    return LOD_OK;
  *bytes = NULL;
  if (strcmp(local.type, "missing-file") != 0 && strcmp(local.type, "bad-uri") != 0)
    return lod_fail(outer, status, local.type, "%s", local.detail);
  if (!is_uri && name[0] == '.' && name[1] == '/')
    name += 2;
  lod_scene_warn(reader->scene, "'%.200s', which the model refers to, could not be read and was left out.", name);
  return LOD_OK;
}

enum lod_status lod_reader_open_companion(struct lod_reader *reader, const char *path, struct lod_arena *arena, const uint8_t **bytes,
                                          size_t *size) {
  struct lod_problem *outer = reader->problem, local = {0};
  reader->problem = &local;
  enum lod_status status = lod_reader_open_optional(reader, path, false, arena, bytes, size);
  reader->problem = outer;
  if (status == LOD_OK)
    return LOD_OK;
  if (strcmp(local.type, "unsafe-uri") != 0)
    return lod_fail(outer, status, local.type, "%s", local.detail);
  const char *last = path + strlen(path);
  while (last > path && last[-1] != '/' && last[-1] != '\\' && last[-1] != ':')
    last--;
  *bytes = NULL;
  if (*last == 0 || strcmp(last, "..") == 0 || strcmp(last, ".") == 0)
    return LOD_OK;
  return lod_reader_open_optional(reader, last, false, arena, bytes, size);
}
