#include "server/http/response.h"

#include <assert.h>
#include <ctype.h>
#include <jansson.h>
#include <math.h>
#include <nettle/sha2.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>
#include <zlib.h>

/* ---- bodies ---- */

struct lod_body *lod_body_create(const void *bytes, size_t size, void (*finish)(void *), void *context) {
  struct lod_body *body = malloc(sizeof *body);
  if (!body) {
    if (finish)
      finish(context);
    return NULL;
  }
  body->bytes = bytes;
  body->size = size;
  body->file = -1;
  body->finish = finish;
  body->context = context;
  atomic_init(&body->holders, 1);
  return body;
}

struct lod_body *lod_body_take(char *text, size_t size) {
  return text ? lod_body_create(text, size, free, text) : NULL;
}

struct lod_body *lod_body_retain(struct lod_body *body) {
  atomic_fetch_add_explicit(&body->holders, 1, memory_order_relaxed);
  return body;
}

void lod_body_release(struct lod_body *body) {
  if (!body || atomic_fetch_sub_explicit(&body->holders, 1, memory_order_acq_rel) != 1)
    return;
  if (body->finish)
    body->finish(body->context);
  free(body);
}

struct lod_body *lod_body_gzip(const struct lod_body *body) {
  if (body->size < 256 || body->size > UINT32_MAX)
    return NULL;
  z_stream stream = {0};
  if (deflateInit2(&stream, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY) != Z_OK)
    return NULL;
  size_t capacity = body->size - body->size / 16; /* not worth it above */
  char *out = malloc(capacity);
  bool done = false;
  if (out) {
    stream.next_in = (Bytef *)body->bytes;
    stream.avail_in = (uInt)body->size;
    stream.next_out = (Bytef *)out;
    stream.avail_out = (uInt)capacity;
    done = deflate(&stream, Z_FINISH) == Z_STREAM_END;
  }
  size_t size = stream.total_out;
  deflateEnd(&stream);
  if (!done) {
    free(out);
    return NULL;
  }
  return lod_body_take(out, size);
}

/* ---- text ---- */

void lod_format_number(double value, char text[32]) {
  /* A decimal of up to 15 digits survives the way to a double and back, and %g drops its zeros: 15 digits are the shortest or too few. */
  for (int digits = 15; digits <= 17; digits++) {
    snprintf(text, 32, "%.*g", digits, value);
    if (strtod(text, NULL) == value)
      return;
  }
}

void lod_format_bound(double value, char text[32]) {
  snprintf(text, 32, "%.12g", value);
  const double raised = value * (1 + 1e-11);
  if (!isfinite(raised))
    lod_format_number(value, text);
  else if (strtod(text, NULL) < value)
    snprintf(text, 32, "%.12g", raised);
}

/* Length of the valid UTF-8 sequence at p (RFC 3629), 0 when there is none. */
static size_t utf8_length(const unsigned char *p) {
  if (p[0] < 0x80)
    return 1;
  size_t length = p[0] >= 0xc2 && p[0] < 0xe0 ? 2 : p[0] >= 0xe0 && p[0] < 0xf0 ? 3 : p[0] >= 0xf0 && p[0] < 0xf5 ? 4 : 0;
  for (size_t i = 1; i < length; i++)
    if ((p[i] & 0xc0) != 0x80)
      return 0;
  if ((p[0] == 0xe0 && p[1] < 0xa0) || (p[0] == 0xed && p[1] > 0x9f) || (p[0] == 0xf0 && p[1] < 0x90) || (p[0] == 0xf4 && p[1] > 0x8f))
    return 0;
  return length;
}

char *lod_utf8_copy(const char *text) {
  char *copy = strdup(text);
  for (unsigned char *p = (unsigned char *)copy; p && *p;) {
    size_t length = utf8_length(p);
    if (!length)
      *p = '?';
    p += length ? length : 1;
  }
  return copy;
}

void lod_etag_of_bytes(const void *bytes, size_t size, char etag[LOD_ETAG_MAX]) {
  struct sha256_ctx hash;
  uint8_t digest[16];
  sha256_init(&hash);
  sha256_update(&hash, size, bytes);
  sha256_digest(&hash, sizeof digest, digest);
  char *out = etag;
  *out++ = '"';
  for (size_t i = 0; i < sizeof digest; i++)
    out += snprintf(out, 3, "%02x", digest[i]);
  memcpy(out, "\"", 2);
}

void lod_request_id(const char *given, char id[LOD_REQUEST_ID_MAX + 1]) {
  static const char kSet[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._:-", kDigits[] = "0123456789abcdef";
  static _Atomic uint64_t counter;
  size_t size = given ? strspn(given, kSet) : 0;
  if (size && size <= LOD_REQUEST_ID_MAX && given[size] == 0) {
    memcpy(id, given, size + 1);
    return;
  }
  uint64_t seed = atomic_load_explicit(&counter, memory_order_relaxed);
  if (seed == 0 && getrandom(&seed, sizeof seed, 0) == sizeof seed)
    atomic_compare_exchange_strong(&counter, &(uint64_t){0}, seed);
  /* A counter that is mixed so that neighbours do not look alike; unique, not secret. */
  uint64_t number = atomic_fetch_add_explicit(&counter, 1, memory_order_relaxed);
  number = (number ^ number >> 31) * UINT64_C(0x9e3779b97f4a7c15);
  number ^= number >> 29;
  for (int i = 0; i < 16; i++)
    id[i] = kDigits[number >> (60 - 4 * i) & 15];
  id[16] = 0;
}

/* ---- replies ---- */

static void drop_content(struct lod_reply *reply) {
  lod_body_release(reply->body);
  reply->body = NULL;
  if (reply->stream.read && reply->stream.finish)
    reply->stream.finish(reply->stream.context);
  reply->stream = (struct lod_stream){0};
  reply->etag[0] = 0;
  reply->own_name = NULL;
  reply->shared = reply->compress = reply->encoded = false;
}

void lod_reply_finish(struct lod_reply *reply) {
  drop_content(reply);
  reply->status = 0;
  reply->header_count = 0;
  reply->type = NULL;
  reply->cache = LOD_CACHE_NO_STORE;
}

void lod_reply_header(struct lod_reply *reply, const char *name, const char *format, ...) {
  assert(reply->header_count < LOD_REPLY_HEADERS);
  if (reply->header_count == LOD_REPLY_HEADERS)
    return;
  struct lod_header *header = &reply->headers[reply->header_count++];
  header->name = name;
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(header->value, sizeof header->value, format, arguments);
  va_end(arguments);
  for (char *p = header->value; *p; p++)
    if ((unsigned char)*p < 0x20 || *p == 0x7f)
      *p = '_';
}

void lod_reply_json(struct lod_reply *reply, unsigned status, enum lod_cache_rule cache, char *text) {
  drop_content(reply);
  size_t size = text ? strlen(text) : 0;
  reply->body = lod_body_take(text, size);
  if (!reply->body) {
    lod_reply_problem(reply, 500, "memory", "The server is out of memory.", "");
    return;
  }
  reply->status = status;
  reply->type = "application/json";
  reply->cache = cache;
  reply->compress = true;
  if (cache != LOD_CACHE_NO_STORE)
    lod_etag_of_bytes(reply->body->bytes, size, reply->etag);
}

char *lod_problem_json(unsigned status, const char *type, const char *detail, const char *parameter) {
  char uri[96], title[64];
  snprintf(uri, sizeof uri, "/problems/%s", type);
  snprintf(title, sizeof title, "%s", type);
  for (char *p = title; *p; p++)
    *p = *p == '-' ? ' ' : p == title ? (char)toupper((unsigned char)*p) : *p;
  char *clean_detail = lod_utf8_copy(detail), *clean_parameter = lod_utf8_copy(parameter);
  json_t *object = json_pack("{s:s, s:s, s:I, s:s*}", "type", uri, "title", title, "status", (json_int_t)status, "detail", clean_detail);
  if (object && *parameter && clean_parameter)
    json_object_set_new(object, "parameter", json_string(clean_parameter));
  char *text = object ? json_dumps(object, JSON_COMPACT) : NULL;
  json_decref(object);
  free(clean_detail);
  free(clean_parameter);
  return text;
}

void lod_reply_problem(struct lod_reply *reply, unsigned status, const char *type, const char *detail, const char *parameter) {
  drop_content(reply);
  char *text = lod_problem_json(status, type, detail, parameter);
  reply->status = status;
  reply->cache = LOD_CACHE_NO_STORE;
  reply->type = "application/problem+json";
  reply->body = lod_body_take(text, text ? strlen(text) : 0);
  if (!reply->body)
    reply->type = NULL;
}

unsigned lod_status_http(const struct lod_problem *problem) {
  switch (problem->status) {
  case LOD_OK:
    return 200;
  case LOD_BAD_INPUT:
    return 400;
  case LOD_UNSUPPORTED:
    return 422;
  case LOD_LIMIT: /* a full queue passes with time, a full store when something is deleted */
    return strcmp(problem->type, "queue-full") == 0 ? 503 : strcmp(problem->type, "quota") == 0 ? 507 : 413;
  case LOD_IO:
    return strcmp(problem->type, "disk-full") == 0 ? 507 : strcmp(problem->type, "store-read-only") == 0 ? 503 : 500;
  case LOD_MEMORY:
  case LOD_CANCELLED:
    return 503;
  default:
    return 500;
  }
}

void lod_reply_failure(struct lod_reply *reply, const struct lod_query_problem *problem) {
  unsigned status = lod_status_http(&problem->problem);
  lod_reply_problem(reply, status, problem->problem.type, problem->problem.detail, problem->parameter);
  if (status == 503)
    lod_reply_header(reply, "Retry-After", "5");
}

/* ---- conditional requests ---- */

bool lod_etag_listed(const char *list, const char *etag, bool weak) {
  for (const char *p = list; *p;) {
    p += strspn(p, " \t,");
    if (*p == '*')
      return true;
    bool is_weak = p[0] == 'W' && p[1] == '/';
    const char *tag = is_weak ? p + 2 : p;
    if (*tag != '"')
      return false; /* not a list of entity tags: matches nothing */
    const char *end = strchr(tag + 1, '"');
    if (!end)
      return false;
    size_t size = (size_t)(end + 1 - tag);
    if ((weak || !is_weak) && *etag && strlen(etag) == size && memcmp(tag, etag, size) == 0)
      return true;
    p = end + 1;
  }
  return false;
}

/* Reads digits, saturating; false when there is none. */
static bool read_count(const char **text, uint64_t *value) {
  const char *p = *text;
  *value = 0;
  for (; *p >= '0' && *p <= '9'; p++) {
    uint64_t digit = (uint64_t)(*p - '0');
    *value = *value > (UINT64_MAX - digit) / 10 ? UINT64_MAX : *value * 10 + digit;
  }
  bool any = p != *text;
  *text = p;
  return any;
}

enum lod_range lod_range_parse(const char *text, uint64_t size, uint64_t *first, uint64_t *count) {
  *first = *count = 0;
  if (!text || strncasecmp(text, "bytes=", 6) != 0)
    return LOD_RANGE_NONE;
  const char *p = text + 6;
  if (strchr(p, ','))
    return LOD_RANGE_NONE;
  p += strspn(p, " \t");
  uint64_t from = 0, to = UINT64_MAX;
  bool has_from = read_count(&p, &from);
  if (*p++ != '-')
    return LOD_RANGE_BAD;
  bool has_to = read_count(&p, &to);
  p += strspn(p, " \t");
  if (*p || (!has_from && !has_to))
    return LOD_RANGE_BAD;
  if (!has_from) { /* the last `to` bytes */
    if (to == 0 || size == 0)
      return LOD_RANGE_BAD;
    *count = to < size ? to : size;
    *first = size - *count;
    return LOD_RANGE_PART;
  }
  if (!has_to)
    to = UINT64_MAX;
  if (from >= size || to < from)
    return LOD_RANGE_BAD;
  *first = from;
  *count = (to < size - 1 ? to : size - 1) - from + 1;
  return LOD_RANGE_PART;
}

struct lod_plan lod_conditions_plan(const struct lod_conditions *conditions, const char *etag, uint64_t size) {
  struct lod_plan whole = {.status = 200, .first = 0, .size = size};
  if (conditions->if_match && !lod_etag_listed(conditions->if_match, etag, false))
    return (struct lod_plan){.status = 412};
  if (conditions->if_none_match && *etag && lod_etag_listed(conditions->if_none_match, etag, true))
    return (struct lod_plan){.status = 304};
  if (!conditions->get || !conditions->range)
    return whole;
  /* If-Range holds one strong tag; a date never matches because nothing here has one. */
  if (conditions->if_range && (!*etag || strcmp(conditions->if_range, etag) != 0))
    return whole;
  struct lod_plan part = {.status = 206};
  switch (lod_range_parse(conditions->range, size, &part.first, &part.size)) {
  case LOD_RANGE_NONE:
    return whole;
  case LOD_RANGE_PART:
    return part;
  default:
    return (struct lod_plan){.status = 416};
  }
}

bool lod_conditions_allow_change(const struct lod_conditions *conditions, const char *etag) {
  if (conditions->if_match && (!etag || !lod_etag_listed(conditions->if_match, etag, false)))
    return false;
  return !conditions->if_none_match || !etag || !lod_etag_listed(conditions->if_none_match, etag, true);
}

bool lod_accepts_gzip(const char *accept_encoding) {
  for (const char *p = accept_encoding; p && *p;) {
    p += strspn(p, " \t,");
    size_t size = strcspn(p, ",;");
    size_t name = strcspn(p, ",; \t");
    const char *end = p + size;
    bool zero = false;
    if (*end == ';') {
      const char *q = strstr(end, "q=");
      size_t rest = strcspn(end, ",");
      zero = q && q < end + rest && strtod(q + 2, NULL) <= 0;
      end += rest;
    }
    if ((name == 4 && strncasecmp(p, "gzip", 4) == 0) || (name == 1 && *p == '*'))
      return !zero;
    p = end;
  }
  return false;
}
