/* Immutable bytes by their SHA-256, and the documents of a model that are such bytes. */
#include <stdio.h>
#include <string.h>

#include "server/http/routes.h"

static void answer_body(struct lod_exchange *exchange, struct lod_body *body, const char *type, const char *name,
                        enum lod_cache_rule cache) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 200;
  reply->cache = cache;
  reply->type = type;
  reply->body = body;
  reply->shared = true;
  snprintf(reply->etag, sizeof reply->etag, "\"%s\"", name);
}

/* work: what goes on on a background thread when the object is not mapped yet; NULL = this is it. */
static void answer_named(struct lod_exchange *exchange, const char *name, enum lod_cache_rule cache,
                         void (*work)(struct lod_exchange *exchange)) {
  struct lod_query_problem problem = {0};
  const char *type;
  struct lod_body *body = lod_service_find_object(exchange->service, name, &type);
  if (!body && work)
    exchange->work = work;
  else if (!body && lod_service_open_object(exchange->service, name, &body, &type, &problem.problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else if (!body)
    lod_reply_problem(&exchange->reply, 404, "unknown-object", "There is no object of this name.", "");
  else
    answer_body(exchange, body, type, name, cache);
}

static const char *last_segment(const struct lod_exchange *exchange) {
  return exchange->target.segments[exchange->target.segment_count - 1];
}

static void open_object(struct lod_exchange *exchange) {
  answer_named(exchange, last_segment(exchange), LOD_CACHE_IMMUTABLE, NULL);
}

void lod_answer_object(struct lod_exchange *exchange) {
  answer_named(exchange, last_segment(exchange), LOD_CACHE_IMMUTABLE, open_object);
}

/* ---- tileset.json and model.glb ---- */

static void find_document(struct lod_exchange *exchange, void (*work)(struct lod_exchange *exchange)) {
  const char *id = exchange->target.segments[2];
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, id);
  if (!model) {
    lod_exchange_unknown_model(exchange, id);
    return;
  }
  const char *name = strcmp(last_segment(exchange), "model.glb") == 0 ? model->gltf : model->tileset;
  if (*name)
    answer_named(exchange, name, LOD_CACHE_REVALIDATE, work);
  else
    lod_reply_problem(&exchange->reply, 404, "unknown-object", "This revision was baked without this document; upload the model again.",
                      "");
  lod_store_model_release(model);
}

static void open_document(struct lod_exchange *exchange) {
  find_document(exchange, NULL);
}

void lod_answer_document(struct lod_exchange *exchange) {
  find_document(exchange, open_document);
}
