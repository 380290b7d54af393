/* What is sent back: bodies, headers, ETag, conditional requests, ranges and problem+json, each in this one place. No libmicrohttpd here.
 *
 * After RFC 9110 (sections 8.8, 13, 14) and RFC 9457. */
#ifndef LOD_SERVER_HTTP_RESPONSE_H
#define LOD_SERVER_HTTP_RESPONSE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "server/http/query.h"

/* ---- bodies ---- */

/* Immutable bytes with a count; any thread may retain and release. */
struct lod_body {
  const uint8_t *bytes;
  size_t size;
  int file;                      /* the same bytes as an open file, from its beginning; -1: there is none. Not owned */
  void (*finish)(void *context); /* called with context when the last holder releases */
  void *context;
  _Atomic uint32_t holders;
};
/* One holder. Calls finish at once and returns NULL when memory is out. */
struct lod_body *lod_body_create(const void *bytes, size_t size, void (*finish)(void *), void *context);
/* Takes malloc'd text (NULL gives NULL). */
struct lod_body *lod_body_take(char *text, size_t size);
struct lod_body *lod_body_retain(struct lod_body *body);
void lod_body_release(struct lod_body *body); /* NULL is allowed */

/* A body that is made while it is sent. read: bytes put into `buffer`; 0 = nothing yet, ask again when woken; -1 = the end. */
struct lod_stream {
  ssize_t (*read)(void *context, char *buffer, size_t size);
  void (*finish)(void *context);
  void *context;
};

/* ---- replies ---- */

enum { LOD_REPLY_HEADERS = 10, LOD_HEADER_VALUE_MAX = 256, LOD_ETAG_MAX = 80 };

enum lod_cache_rule {
  LOD_CACHE_NO_STORE,   /* nothing may keep it */
  LOD_CACHE_REVALIDATE, /* keep it, ask with If-None-Match each time */
  LOD_CACHE_IMMUTABLE,  /* named by its hash: keep it for a year and never ask */
};
struct lod_header {
  const char *name; /* static text */
  char value[LOD_HEADER_VALUE_MAX];
};
/* A handler's answer. Exactly one of body and stream, or neither for an empty one. */
struct lod_reply {
  unsigned status; /* 0 = not answered yet */
  enum lod_cache_rule cache;
  bool shared;          /* the same headers and body will be asked for again: keep the made-up response */
  const char *own_name; /* a header of this reply alone, beside those of a shared one; static text, NULL = none */
  char own_value[40];
  bool compress;           /* text worth gzip: the answer depends on Accept-Encoding */
  bool encoded;            /* body is gzip */
  const char *type;        /* media type, static text; NULL = no body */
  char etag[LOD_ETAG_MAX]; /* quoted; "" = none */
  struct lod_body *body;
  struct lod_stream stream; /* read != NULL: a stream */
  uint32_t header_count;
  struct lod_header headers[LOD_REPLY_HEADERS]; /* last: not cleared between requests */
};
void lod_reply_finish(struct lod_reply *reply);
/* Adds a header. value: printf format. Dropped with an assert when there is no room: a caller's bug. Control characters become '_'. */
__attribute__((format(printf, 3, 4))) void lod_reply_header(struct lod_reply *reply, const char *name, const char *format, ...);
/* A whole malloc'd JSON text (taken) as the body; ETag from its SHA-256 unless no-store. NULL text: a 500 for want of memory. */
void lod_reply_json(struct lod_reply *reply, unsigned status, enum lod_cache_rule cache, char *text);
/* RFC 9457. type: "unknown-model" becomes "/problems/unknown-model"; parameter "" = none. Replaces whatever the reply held, headers
 * excepted. */
void lod_reply_problem(struct lod_reply *reply, unsigned status, const char *type, const char *detail, const char *parameter);
/* The same from a status: the one mapping from lod_status to HTTP. */
void lod_reply_failure(struct lod_reply *reply, const struct lod_query_problem *problem);
unsigned lod_status_http(const struct lod_problem *problem);
/* Problem object as text, malloc'd; also what a failed job carries. */
char *lod_problem_json(unsigned status, const char *type, const char *detail, const char *parameter);

/* A request's id: the client's X-Request-Id when it is 1 to 64 of A-Z a-z 0-9 . _ : -, else a fresh one of 16 hex digits. */
enum { LOD_REQUEST_ID_MAX = 64 };
void lod_request_id(const char *given, char id[LOD_REQUEST_ID_MAX + 1]);

/* "..." of the first 32 hex digits of SHA-256. */
void lod_etag_of_bytes(const void *bytes, size_t size, char etag[LOD_ETAG_MAX]);

/* ---- conditional requests and ranges ---- */

struct lod_conditions {
  const char *if_match, *if_none_match, *if_range, *range; /* header values, NULL = not sent */
  bool get;                                                /* GET: ranges count; HEAD and others ignore them */
};
struct lod_plan {
  unsigned status;      /* 200, 206, 304, 412 or 416 */
  uint64_t first, size; /* of the part, for 206 */
};
/* What to send of a 200 reply with this ETag ("" = none) and size. */
struct lod_plan lod_conditions_plan(const struct lod_conditions *conditions, const char *etag, uint64_t size);
/* RFC 9110 13.1.1 and 13.1.2 for a method that changes the resource: false = 412. etag NULL: the resource does not exist. */
bool lod_conditions_allow_change(const struct lod_conditions *conditions, const char *etag);

enum lod_range { LOD_RANGE_NONE, LOD_RANGE_PART, LOD_RANGE_BAD };
/* One `bytes=` range of `size` bytes. NONE: no range, another unit, or several ranges (all of it is sent, as RFC 9110 14.2 allows).
 * BAD: malformed or outside. */
enum lod_range lod_range_parse(const char *text, uint64_t size, uint64_t *first, uint64_t *count);
/* Whether a list of entity tags (or "*") names etag. weak: W/ makes no difference. */
bool lod_etag_listed(const char *list, const char *etag, bool weak);
/* Whether an Accept-Encoding value takes gzip. */
bool lod_accepts_gzip(const char *accept_encoding);

/* gzip of the body, NULL when it would not be smaller or memory is out. */
struct lod_body *lod_body_gzip(const struct lod_body *body);

/* Shortest decimal that reads back as the same double. */
void lod_format_number(double value, char text[32]);
/* A decimal of 12 digits that is not below the value, for bounds; for non-negative values. Quicker than the above. */
void lod_format_bound(double value, char text[32]);
/* malloc'd copy of `text` in which every byte that is not part of valid UTF-8 is '?' (JSON needs it). */
char *lod_utf8_copy(const char *text);

#endif
