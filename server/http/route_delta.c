/* The steps from a level that a client has to one that it wants. */
#include <stdio.h>
#include <string.h>

#include "server/http/deltas.h"
#include "server/http/query.h"

struct wish {
  const struct lod_stored_family *family;
  uint32_t from, to; /* from UINT32_MAX: from nothing */
};

static enum lod_status find_family(const struct lod_exchange *exchange, const struct lod_stored_model *model, struct wish *wish,
                                   struct lod_query_problem *problem) {
  const char *name = lod_target_find(&exchange->target, "family");
  for (uint32_t i = 0; i < model->family_count; i++) {
    const struct lod_stored_family *family = &model->families[i];
    if (name ? strcmp(name, family->name) == 0 : family->levels[0].delta[0] && !wish->family)
      wish->family = family;
  }
  if (!wish->family && name)
    return lod_parameter_fail(problem, "family", "The model '%s' has no family '%.40s'.", model->id, name);
  if (!wish->family && model->family_count == 0)
    return lod_fail(&problem->problem, LOD_UNSUPPORTED, "no-levels", "The model '%s' has no levels.", model->id);
  if (!wish->family)
    wish->family = &model->families[0]; /* none has steps */
  return LOD_OK;
}

static enum lod_status read_wish(const struct lod_exchange *exchange, const struct lod_stored_model *model, struct wish *wish,
                                 struct lod_query_problem *problem) {
  const char *from = lod_target_find(&exchange->target, "from"), *to = lod_target_find(&exchange->target, "to");
  uint64_t number = 0;
  LOD_TRY(find_family(exchange, model, wish, problem));
  const uint32_t last = wish->family->level_count - 1;
  wish->from = UINT32_MAX;
  if (from) {
    LOD_TRY(lod_parameter_integer("from", from, 0, last, &number, problem));
    wish->from = (uint32_t)number;
  }
  uint64_t least = from ? number + 1 : 0;
  if (least > last)
    return lod_parameter_fail(problem, "from", "'from' is the finest level: there is no step beyond it.");
  number = least;
  if (to)
    LOD_TRY(lod_parameter_integer("to", to, least, last, &number, problem));
  wish->to = (uint32_t)number;
  return LOD_OK;
}

static void answer(struct lod_exchange *exchange, bool may_block);

static void answer_blocking(struct lod_exchange *exchange) {
  answer(exchange, true);
}

static void describe(struct lod_reply *reply, const struct wish *wish, const struct lod_chain *chain) {
  const struct lod_stored_level *level = &wish->family->levels[wish->to];
  char number[32];
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = LOD_DELTA_MEDIA_TYPE;
  reply->shared = true;
  lod_chain_etag(chain, reply->etag);
  if (wish->from != UINT32_MAX)
    lod_reply_header(reply, "Lod-From", "%u", wish->from);
  lod_reply_header(reply, "Lod-Family", "%s", wish->family->name);
  lod_reply_header(reply, "Lod-Level", "%u", wish->to);
  lod_format_number(level->facts.error, number);
  lod_reply_header(reply, "Lod-Error", "%s", number);
  lod_reply_header(reply, "Lod-Triangles", "%llu", (unsigned long long)level->facts.triangles);
}

static void answer_wish(struct lod_exchange *exchange, const struct wish *wish, bool may_block) {
  struct lod_query_problem problem = {0};
  struct lod_chain chain;
  struct lod_body *body;
  if (!lod_chain_find(wish->family, wish->from, wish->to, &chain)) {
    lod_reply_problem(&exchange->reply, 404, "no-delta",
                      "Between these levels a step is missing: the family's vertices are not nested there. Ask for the level itself.", "");
  } else if (lod_chain_body(exchange->service, &chain, may_block, &body, &problem.problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
  } else if (!body && !may_block) {
    exchange->work = answer_blocking;
  } else if (!body) {
    lod_reply_problem(&exchange->reply, 503, "model-changed", "The model changed while its steps were gathered; ask again.", "");
    lod_reply_header(&exchange->reply, "Retry-After", "1");
  } else {
    exchange->reply.body = body;
    describe(&exchange->reply, wish, &chain);
  }
}

static void answer(struct lod_exchange *exchange, bool may_block) {
  const char *id = exchange->target.segments[2];
  struct lod_query_problem problem = {0};
  struct wish wish = {0};
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, id);
  if (!model)
    lod_exchange_unknown_model(exchange, id);
  else if (read_wish(exchange, model, &wish, &problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else
    answer_wish(exchange, &wish, may_block);
  lod_store_model_release(model);
}

void lod_answer_delta(struct lod_exchange *exchange) {
  answer(exchange, false);
}
