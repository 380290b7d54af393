/* The level that a query asks for. */
#include <stdio.h>

#include "server/http/routes.h"
#include "server/http/select.h"

static void describe(struct lod_reply *reply, const struct lod_selection *selection, const struct lod_choice *choice) {
  char number[32];
  lod_reply_header(reply, "Content-Location", "/v1/objects/%s", choice->level->sha256);
  lod_reply_header(reply, "Lod-Family", "%s", choice->family->name);
  lod_reply_header(reply, "Lod-Level", "%u", choice->level->level);
  lod_format_number(choice->level->facts.error, number);
  lod_reply_header(reply, "Lod-Error", "%s", number);
  if (selection->has_view) {
    lod_format_number(choice->screen_error_px, number);
    lod_reply_header(reply, "Lod-Screen-Error", "%s", number);
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
  reply->shared = !selection->has_view; /* a screen error hardly ever comes twice */
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
    answer_body(exchange, selection, choice, body, type);
  }
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
  else
    answer_choice(exchange, &selection, &choice, may_block);
  lod_store_model_release(model);
}

static void choose_and_open(struct lod_exchange *exchange) {
  answer_level(exchange, true);
}

void lod_answer_level(struct lod_exchange *exchange) {
  answer_level(exchange, false);
}
