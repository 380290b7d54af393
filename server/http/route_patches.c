/* GET /v1/models/{id}/patches: the curved level that a query asks for, as patches. Chooses as /level does, by the patches' own errors and
 * bytes. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/routes.h"
#include "server/http/select.h"

/* A copy of the model's families with only the levels that have patches, and these in place of the levels' GLBs. */
struct curved {
  struct lod_stored_model model;
  struct lod_stored_family *families;
  struct lod_stored_level *levels;
};

static bool gather(const struct lod_stored_model *model, struct curved *curved) {
  uint32_t count = 0;
  for (uint32_t f = 0; f < model->family_count; f++)
    count += model->families[f].level_count;
  curved->model = *model;
  curved->families = calloc(model->family_count + 1, sizeof *curved->families);
  curved->levels = calloc((size_t)count + 1, sizeof *curved->levels);
  if (!curved->families || !curved->levels)
    return false;
  struct lod_stored_level *next = curved->levels;
  curved->model.families = curved->families;
  curved->model.family_count = 0;
  for (uint32_t f = 0; f < model->family_count; f++) {
    const struct lod_stored_family *family = &model->families[f];
    struct lod_stored_family copy = {.name = family->name, .nested = family->nested, .levels = next};
    for (uint32_t k = 0; k < family->level_count; k++) {
      const struct lod_stored_level *level = &family->levels[k];
      if (!level->patches[0])
        continue;
      *next = *level;
      next->facts = level->patch_facts;
      memcpy(next->sha256, level->patches, sizeof next->sha256);
      next++;
      copy.level_count++;
    }
    if (copy.level_count > 0)
      curved->families[curved->model.family_count++] = copy;
  }
  return true;
}

static void free_curved(struct curved *curved) {
  free(curved->families);
  free(curved->levels);
}

static void answer(struct lod_exchange *exchange, bool may_block);

static void answer_on_thread(struct lod_exchange *exchange) {
  answer(exchange, true);
}

static void reply_with(struct lod_exchange *exchange, const struct lod_selection *selection, const struct lod_choice *choice,
                       bool may_block) {
  struct lod_query_problem problem = {0};
  struct lod_reply *reply = &exchange->reply;
  const char *type, *name = choice->level->sha256;
  char number[32];
  struct lod_body *body = lod_service_find_object(exchange->service, name, &type);
  if (!body && !may_block) {
    exchange->work = answer_on_thread;
    return;
  }
  if (!body && lod_service_open_object(exchange->service, name, &body, &type, &problem.problem) != LOD_OK) {
    lod_reply_failure(reply, &problem);
    return;
  }
  if (!body) {
    lod_reply_problem(reply, 503, "model-changed", "The model changed while the level was chosen; ask again.", "");
    lod_reply_header(reply, "Retry-After", "1");
    return;
  }
  lod_reply_header(reply, "Content-Location", "/v1/objects/%s", name);
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = type;
  reply->body = body;
  snprintf(reply->etag, sizeof reply->etag, "\"%s\"", name);
  lod_reply_header(reply, "Lod-Family", "%s", choice->family->name);
  lod_reply_header(reply, "Lod-Level", "%u", choice->level->level);
  lod_format_number(choice->level->facts.error, number);
  lod_reply_header(reply, "Lod-Error", "%s", number);
  if (selection->has_view) {
    lod_format_number(choice->screen_error_px, number);
    lod_reply_header(reply, "Lod-Screen-Error", "%s", number);
  }
  lod_reply_header(reply, "Lod-Patches", "%llu", (unsigned long long)choice->level->facts.triangles);
}

static void answer(struct lod_exchange *exchange, bool may_block) {
  const char *id = exchange->target.segments[2];
  struct lod_query_problem problem = {0};
  struct lod_selection selection;
  struct lod_choice choice;
  struct curved curved = {0};
  if (lod_selection_parse(&exchange->target, &selection, &problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return;
  }
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, id);
  if (!model) {
    lod_exchange_unknown_model(exchange, id);
    return;
  }
  if (!gather(model, &curved)) {
    lod_fail_memory(&problem.problem);
    lod_reply_failure(&exchange->reply, &problem);
  } else if (curved.model.family_count == 0) {
    lod_reply_problem(&exchange->reply, 404, "no-patches", "The model was not baked as curved patches: bake it with the family clod.", "");
  } else if (lod_selection_choose(&selection, &curved.model, &choice, &problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
  } else {
    reply_with(exchange, &selection, &choice, may_block);
  }
  free_curved(&curved);
  lod_store_model_release(model);
}

void lod_answer_patches(struct lod_exchange *exchange) {
  answer(exchange, false);
}
