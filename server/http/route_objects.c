/* Immutable bytes by their SHA-256. */
#include <stdio.h>

#include "server/http/routes.h"

static const char *name_of(const struct lod_exchange *exchange) {
  return exchange->target.segments[exchange->target.segment_count - 1];
}

static void answer_body(struct lod_exchange *exchange, struct lod_body *body, const char *type) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 200;
  reply->cache = LOD_CACHE_IMMUTABLE;
  reply->type = type;
  reply->body = body;
  reply->shared = true;
  snprintf(reply->etag, sizeof reply->etag, "\"%s\"", name_of(exchange));
}

static void open_object(struct lod_exchange *exchange) {
  struct lod_query_problem problem = {0};
  struct lod_body *body;
  const char *type;
  if (lod_service_open_object(exchange->service, name_of(exchange), &body, &type, &problem.problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else if (!body)
    lod_reply_problem(&exchange->reply, 404, "unknown-object", "There is no object of this name.", "");
  else
    answer_body(exchange, body, type);
}

void lod_answer_object(struct lod_exchange *exchange) {
  const char *type;
  struct lod_body *body = lod_service_find_object(exchange->service, name_of(exchange), &type);
  if (body)
    answer_body(exchange, body, type);
  else
    exchange->work = open_object;
}
