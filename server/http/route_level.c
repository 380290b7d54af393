/* The level that a query asks for. */
#include <stdio.h>

#include "server/http/deltas.h"
#include "server/http/select.h"

static void describe(struct lod_reply *reply, const struct lod_selection *selection, const struct lod_choice *choice) {
  char number[32];
  lod_reply_header(reply, "Lod-Family", "%s", choice->family->name);
  lod_reply_header(reply, "Lod-Level", "%u", choice->level->level);
  lod_format_number(choice->level->facts.error, number);
  lod_reply_header(reply, "Lod-Error", "%s", number);
  if (selection->has_view) { /* it hardly ever comes twice */
    lod_format_bound(choice->screen_error_px, number);
    reply->own_name = "Lod-Screen-Error";
    snprintf(reply->own_value, sizeof reply->own_value, "%s", number);
  }
  lod_reply_header(reply, "Lod-Triangles", "%llu", (unsigned long long)choice->level->facts.triangles);
}

static void answer_body(struct lod_exchange *exchange, const struct lod_selection *selection, const struct lod_choice *choice,
                        struct lod_body *body, const char *type) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = type;
  reply->body = body;
  reply->shared = true;
  snprintf(reply->etag, sizeof reply->etag, "\"%s\"", choice->level->sha256);
  describe(reply, selection, choice);
}

static void choose_and_open(struct lod_exchange *exchange);

/* may_block: on a background thread; else an object that is not mapped yet is left to one. */
static void answer_choice(struct lod_exchange *exchange, const struct lod_selection *selection, const struct lod_choice *choice,
                          bool may_block) {
  struct lod_query_problem problem = {0};
  const char *type, *name = choice->level->sha256;
  struct lod_body *body = lod_service_find_object(exchange->service, name, &type);
  if (!body && !may_block) {
    exchange->work = choose_and_open;
  } else if (!body && lod_service_open_object(exchange->service, name, &body, &type, &problem.problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
  } else if (!body) {
    /* Between choosing and opening the model was replaced or deleted. */
    lod_reply_problem(&exchange->reply, 503, "model-changed", "The model changed while the level was chosen; ask again.", "");
    lod_reply_header(&exchange->reply, "Retry-After", "1");
  } else {
    lod_reply_header(&exchange->reply, "Content-Location", "/v1/objects/%s", name);
    answer_body(exchange, selection, choice, body, type);
  }
}

/* The steps from the level that the client has, where these are fewer bytes than the level. False: send the level. */
static bool answer_steps(struct lod_exchange *exchange, const struct lod_selection *selection, const struct lod_choice *choice,
                         bool may_block) {
  struct lod_query_problem problem = {0};
  struct lod_chain chain;
  struct lod_body *body;
  if (selection->have == UINT32_MAX || !lod_chain_find(choice->family, selection->have, choice->level->level, &chain) ||
      chain.bytes >= choice->level->facts.bytes)
    return false;
  if (lod_chain_body(exchange->service, &chain, may_block, &body, &problem.problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
  } else if (!body && !may_block) {
    exchange->work = choose_and_open;
  } else if (!body) {
    return false; /* answer_choice finds out why */
  } else {
    answer_body(exchange, selection, choice, body, LOD_DELTA_MEDIA_TYPE);
    lod_chain_etag(&chain, exchange->reply.etag);
    lod_reply_header(&exchange->reply, "Lod-From", "%u", selection->have);
  }
  return true;
}

static void answer_level(struct lod_exchange *exchange, bool may_block) {
  const char *id = exchange->target.segments[2];
  struct lod_query_problem problem = {0};
  struct lod_selection selection;
  struct lod_choice choice;
  if (lod_selection_parse(&exchange->target, &selection, &problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return;
  }
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, id);
  if (!model)
    lod_exchange_unknown_model(exchange, id);
  else if (lod_selection_choose(&selection, model, &choice, &problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else if (!answer_steps(exchange, &selection, &choice, may_block))
    answer_choice(exchange, &selection, &choice, may_block);
  lod_store_model_release(model);
}

static void choose_and_open(struct lod_exchange *exchange) {
  answer_level(exchange, true);
}

void lod_answer_level(struct lod_exchange *exchange) {
  answer_level(exchange, false);
}
