/* Immutable bytes by their SHA-256. */
#include <stdio.h>

#include "server/http/routes.h"

void lod_answer_object(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  const char *sha256 = exchange->target.segments[exchange->target.segment_count - 1], *type;
  struct lod_query_problem problem = {0};
  struct lod_body *body;
  if (lod_service_object(exchange->service, sha256, &body, &type, &problem.problem) != LOD_OK)
    lod_reply_failure(reply, &problem);
  else if (!body)
    lod_reply_problem(reply, 404, "unknown-object", "There is no object of this name.", "");
  else {
    reply->status = 200;
    reply->cache = LOD_CACHE_IMMUTABLE;
    reply->type = type;
    reply->body = body;
    reply->shared = true;
    snprintf(reply->etag, sizeof reply->etag, "\"%s\"", sha256);
  }
}
