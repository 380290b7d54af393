/* Refinement on demand and contact points: the query, the level that it starts from, and a warm worker's answer. */
#include <jansson.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/errands.h"
#include "server/http/routes.h"
#include "server/jobs/refine_query.h"
#include "server/store/answers.h"

enum { DEFAULT_BASE_TRIANGLES = 5000, BODY_MAX_BYTES = 32 << 20, CACHED_ANSWER_BYTES = 4 << 20 };

struct facts {
  uint64_t triangles, vertices, base_triangles;
  bool budget;
};

/* What the cache keeps under an ETag. */
struct refined {
  struct lod_body *body;
  struct facts facts;
};

void lod_refined_release(void *value) {
  struct refined *refined = value;
  lod_body_release(refined->body);
  free(refined);
}

/* Where an errand's answer is kept. */
struct origin {
  struct lod_service *service;
  char id[LOD_MODEL_ID_MAX + 1], *revision;
};

struct request {
  struct lod_waiter waiter;
  struct lod_exchange *exchange;
  struct lod_errand *errand; /* this request's own; an equal one may be under way already */
  bool contact;
  char *parameters; /* JSON; the errand's, once there is one */
  char etag[LOD_ETAG_MAX];
  char base_name[96]; /* "envelope:3" */
  uint8_t *values;    /* likewise */
  size_t values_size, values_room;
  bool body_failed;
};

static void finish_request(void *state) {
  struct request *request = state;
  lod_errand_release(request->errand);
  free(request->parameters);
  free(request->values);
  free(request);
}

static struct request *request_of(struct lod_exchange *exchange) {
  if (exchange->state == NULL) {
    struct request *request = calloc(1, sizeof *request);
    if (request == NULL)
      return NULL;
    request->exchange = exchange;
    exchange->state = request;
    exchange->state_finish = finish_request;
  }
  return exchange->state;
}

static void out_of_memory(struct lod_exchange *exchange) {
  lod_reply_problem(&exchange->reply, 503, "memory", "The server is out of memory.", "");
}

/* ---- the query ---- */

static enum lod_status parse(struct lod_exchange *exchange, struct request *request, struct lod_refine_query *query,
                             struct lod_query_problem *problem) {
  const struct lod_target *target = &exchange->target;
  struct lod_refine_parameter list[LOD_TARGET_PARAMETERS + 1];
  uint32_t count = 0;
  for (; count < target->parameter_count; count++)
    list[count] = (struct lod_refine_parameter){target->parameters[count].name, target->parameters[count].value};
  if (request->contact)
    list[count++] = (struct lod_refine_parameter){"doi", "contact"};
  enum lod_status status = lod_refine_query_parse(list, count, request->values_size != 0, query, problem->parameter, &problem->problem);
  if (status != LOD_OK)
    return status;
  json_t *json = json_object();
  for (uint32_t i = 0; i < count; i++)
    json_object_set_new(json, list[i].name, json_string(list[i].value));
  request->parameters = json_dumps(json, JSON_COMPACT | JSON_SORT_KEYS); /* the same for the same request in another order */
  json_decref(json);
  return request->parameters != NULL ? LOD_OK : lod_fail_memory(&problem->problem);
}

/* The level asked for; or the finest of at most DEFAULT_BASE_TRIANGLES; or the coarsest. */
static const struct lod_stored_level *choose(const struct lod_stored_model *model, const struct lod_refine_query *query,
                                             const struct lod_stored_family **family) {
  const struct lod_stored_level *best = NULL;
  for (uint32_t f = 0; f < model->family_count; f++)
    for (uint32_t i = 0; i < model->families[f].level_count; i++) {
      const struct lod_stored_level *level = &model->families[f].levels[i];
      if ((query->family[0] != 0 && strcmp(query->family, model->families[f].name) != 0) ||
          (query->has_level && level->level != query->level))
        continue;
      bool small = level->facts.triangles <= DEFAULT_BASE_TRIANGLES;
      bool was = best != NULL && best->facts.triangles <= DEFAULT_BASE_TRIANGLES;
      bool better = best == NULL || (small && !was) ||
                    (small == was && (small ? level->facts.error < best->facts.error : level->facts.triangles < best->facts.triangles));
      if (better) {
        best = level;
        *family = &model->families[f];
      }
    }
  return best;
}

static void unknown_base(struct lod_exchange *exchange, const struct lod_stored_model *model) {
  char detail[300] = "This model has no such level to start from; it has";
  if (model->family_count == 0) {
    lod_reply_problem(&exchange->reply, 422, "no-levels", "This model has no level to start from.", "");
    return;
  }
  for (uint32_t f = 0; f < model->family_count; f++) {
    size_t used = strlen(detail);
    snprintf(detail + used, sizeof detail - used, "%s %s:0 to %u", f == 0 ? "" : ",", model->families[f].name,
             model->families[f].level_count == 0 ? 0 : model->families[f].level_count - 1);
  }
  lod_reply_problem(&exchange->reply, 400, "bad-parameter", detail, "base");
}

/* The tag of the exact request: which bytes are refined, how, and by which version. */
static void make_etag(struct request *request, uint64_t max_triangles, const char *base) {
  char values[LOD_ETAG_MAX] = "", *text = NULL;
  if (request->values_size != 0)
    lod_etag_of_bytes(request->values, request->values_size, values);
  int size = asprintf(&text, "%s %s %llu %s %s %s", LOD_VERSION, request->contact ? "contact" : "refine", (unsigned long long)max_triangles,
                      base, values, request->parameters);
  if (size > 0)
    lod_etag_of_bytes(text, (size_t)size, request->etag);
  free(size < 0 ? NULL : text);
}

/* ---- the answer ---- */

static void describe(struct request *request, struct lod_body *body, const struct facts *facts) {
  struct lod_reply *reply = &request->exchange->reply;
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = "model/gltf-binary";
  reply->body = body;
  snprintf(reply->etag, sizeof reply->etag, "%s", request->etag);
  lod_reply_header(reply, "Lod-Base", "%s", request->base_name);
  lod_reply_header(reply, "Lod-Base-Triangles", "%llu", (unsigned long long)facts->base_triangles);
  lod_reply_header(reply, "Lod-Triangles", "%llu", (unsigned long long)facts->triangles);
  lod_reply_header(reply, "Lod-Vertices", "%llu", (unsigned long long)facts->vertices);
  lod_reply_header(reply, "Lod-Budget", "%s", facts->budget ? "reached" : "kept");
}

static uint64_t count_of(const json_t *json, const char *name) {
  json_int_t value = json_integer_value(json_object_get(json, name));
  return value > 0 ? (uint64_t)value : 0;
}

static struct facts facts_of(const char *text) {
  json_t *json = json_loads(text, 0, NULL);
  struct facts facts = {count_of(json, "triangles"), count_of(json, "vertices"), count_of(json, "base_triangles"),
                        json_is_true(json_object_get(json, "budget"))};
  json_decref(json);
  return facts;
}

static void remember(struct lod_service *service, const char *etag, struct lod_body *body, const struct facts *facts) {
  struct lod_cache *cache = service->refined;
  struct refined *refined = body->size <= CACHED_ANSWER_BYTES && etag[0] != 0 ? calloc(1, sizeof *refined) : NULL;
  if (refined == NULL)
    return;
  refined->body = lod_body_retain(body);
  refined->facts = *facts;
  struct lod_cache_entry *entry = lod_cache_insert(cache, etag, strlen(etag), 0, refined);
  if (entry != NULL)
    lod_cache_release(cache, entry);
}

/* The hex digits between an ETag's quotes: what the store's cache knows an answer by. */
static bool key_of(const char *etag, char key[LOD_ANSWER_KEY + 1]) {
  if (strlen(etag) != LOD_ANSWER_KEY + 2)
    return false;
  memcpy(key, etag + 1, LOD_ANSWER_KEY);
  key[LOD_ANSWER_KEY] = 0;
  return true;
}

static void release_body(void *body) {
  lod_body_release(body);
}

/* On a thread of the pool, once for all who wait. */
static void keep_answer(struct lod_errand *errand) {
  const struct origin *origin = errand->context;
  struct lod_pool_job *job = &errand->job;
  char key[LOD_ANSWER_KEY + 1];
  if (job->problem.status != LOD_OK || strcmp(job->kind, "refine") != 0)
    return;
  errand->answer = lod_body_create(job->bytes, job->size, free, job->bytes);
  job->bytes = NULL;
  if (errand->answer == NULL)
    return;
  struct facts facts = facts_of(job->facts);
  remember(origin->service, errand->key, errand->answer, &facts);
  if (key_of(errand->key, key))
    lod_store_keep_answer(origin->service->store, origin->id, origin->revision, key, errand->answer->bytes, errand->answer->size,
                          job->facts, lod_body_retain(errand->answer), release_body);
}

static void finish_origin(void *context) {
  struct origin *origin = context;
  free(origin->revision);
  free(origin);
}

static void reply_contact(struct request *request, const struct lod_pool_job *job) {
  json_t *json = json_loads(job->facts, 0, NULL);
  json_object_del(json, "bytes");
  json_object_set_new(json, "base", json_string(request->base_name));
  lod_reply_json(&request->exchange->reply, 200, LOD_CACHE_REVALIDATE, json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(9)));
  json_decref(json);
}

/* On a thread of the pool, or on the event loop for a client that has gone. */
static void take_answer(struct lod_waiter *waiter, struct lod_errand *errand, bool cancelled) {
  struct request *request = (struct request *)((char *)waiter - offsetof(struct request, waiter));
  struct lod_exchange *exchange = request->exchange;
  const struct lod_pool_job *job = &errand->job;
  if (cancelled) {
    lod_reply_problem(&exchange->reply, 503, "cancelled", "The client has gone.", "");
  } else if (job->problem.status != LOD_OK) {
    struct lod_query_problem problem = {.problem = job->problem};
    snprintf(problem.parameter, sizeof problem.parameter, "%s", job->parameter);
    lod_reply_failure(&exchange->reply, &problem);
  } else if (request->contact) {
    reply_contact(request, job);
  } else if (errand->answer == NULL) {
    out_of_memory(exchange);
  } else {
    struct facts facts = facts_of(job->facts);
    describe(request, lod_body_retain(errand->answer), &facts);
  }
  exchange->finished(exchange);
}

static bool answer_from_memory(struct lod_exchange *exchange, struct request *request) {
  struct lod_cache *cache = exchange->service->refined;
  struct lod_cache_entry *entry =
      request->contact || request->etag[0] == 0 ? NULL : lod_cache_find(cache, request->etag, strlen(request->etag), 0);
  if (entry == NULL)
    return false;
  struct refined *refined = lod_cache_value(entry);
  atomic_fetch_add(&exchange->service->refined_memory_hits, 1);
  describe(request, lod_body_retain(refined->body), &refined->facts);
  lod_cache_release(cache, entry);
  return true;
}

static void release_answer(void *answer) {
  lod_answer_release(answer);
}

static bool answer_from_store(struct lod_exchange *exchange, struct request *request) {
  char key[LOD_ANSWER_KEY + 1];
  struct lod_answer *answer =
      request->contact || !key_of(request->etag, key) ? NULL : lod_answers_find(lod_store_answers(exchange->service->store), key);
  if (answer == NULL)
    return false;
  struct facts facts = facts_of(answer->facts);
  struct lod_body *body = lod_body_create(answer->bytes, answer->size, release_answer, answer);
  if (body == NULL)
    return false;
  atomic_fetch_add(&exchange->service->refined_store_hits, 1);
  body->file = answer->file;
  remember(exchange->service, request->etag, body, &facts);
  describe(request, body, &facts);
  return true;
}

/* On a background thread: the answer or the base may have to be read from the disk. True: take_answer follows. */
static bool start(struct lod_exchange *exchange) {
  struct request *request = exchange->state;
  struct lod_service *service = exchange->service;
  struct lod_errand *errand = request->errand;
  struct lod_query_problem problem = {0};
  const char *type;
  if (answer_from_store(exchange, request) || answer_from_memory(exchange, request))
    return false;
  errand->base = lod_service_find_object(service, errand->job.base, &type);
  if (errand->base == NULL && lod_service_open_object(service, errand->job.base, &errand->base, &type, &problem.problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return false;
  }
  if (errand->base == NULL) {
    lod_reply_problem(&exchange->reply, 503, "model-changed", "The model changed while the level was chosen; ask again.", "");
    lod_reply_header(&exchange->reply, "Retry-After", "1");
    return false;
  }
  if (lod_errands_join(service->errands, errand, &request->waiter, &problem.problem) == LOD_OK)
    return true; /* from here on the request may be over at any moment */
  lod_reply_failure(&exchange->reply, &problem);
  return false;
}

/* On the event loop, before the request is over. */
static void cancel(struct lod_exchange *exchange) {
  struct request *request = exchange->state;
  lod_errands_leave(exchange->service->errands, &request->waiter);
}

/* The request as an errand, not sent yet. False: memory. */
static bool prepare(struct lod_exchange *exchange, struct request *request, const struct lod_stored_model *model,
                    const struct lod_stored_level *level, const struct lod_stored_family *family) {
  uint64_t max_triangles = exchange->service->config->refine_triangles;
  struct lod_errand *errand = request->errand = lod_errand_create();
  struct origin *origin = calloc(1, sizeof *origin);
  snprintf(request->base_name, sizeof request->base_name, "%s:%u", family->name, level->level);
  make_etag(request, max_triangles, level->sha256);
  if (errand == NULL || origin == NULL || (origin->revision = strdup(model->revision)) == NULL) {
    free(origin);
    return false;
  }
  origin->service = exchange->service;
  snprintf(origin->id, sizeof origin->id, "%s", model->id);
  errand->context = origin;
  errand->finish_context = finish_origin;
  errand->landed = keep_answer;
  errand->job.kind = request->contact ? "contact" : "refine";
  errand->job.max_triangles = max_triangles;
  snprintf(errand->job.base, sizeof errand->job.base, "%s", level->sha256);
  snprintf(errand->key, sizeof errand->key, "%s", request->etag);
  errand->parameters = request->parameters;
  errand->values = request->values;
  errand->values_size = request->values_size;
  request->parameters = NULL;
  request->values = NULL;
  request->waiter.done = take_answer;
  return request->etag[0] != 0;
}

static void answer(struct lod_exchange *exchange, bool contact) {
  struct request *request = request_of(exchange);
  struct lod_query_problem problem = {0};
  struct lod_refine_query query;
  if (request == NULL || request->body_failed) {
    out_of_memory(exchange);
    return;
  }
  if (exchange->service->pool == NULL) {
    lod_reply_problem(&exchange->reply, 422, "no-refinement", "This server was started without workers for refinement.", "");
    return;
  }
  request->contact = contact;
  if (parse(exchange, request, &query, &problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return;
  }
  const char *id = exchange->target.segments[2];
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, id);
  const struct lod_stored_family *family = NULL;
  const struct lod_stored_level *level = model == NULL ? NULL : choose(model, &query, &family);
  if (model == NULL) {
    lod_exchange_unknown_model(exchange, id);
  } else if (level == NULL) {
    unknown_base(exchange, model);
  } else {
    if (!prepare(exchange, request, model, level, family)) {
      out_of_memory(exchange);
    } else if (!answer_from_memory(exchange, request)) {
      exchange->start = start;
      exchange->cancel = cancel;
    }
  }
  lod_store_model_release(model);
}

void lod_answer_refine(struct lod_exchange *exchange) {
  answer(exchange, false);
}

void lod_answer_contact(struct lod_exchange *exchange) {
  answer(exchange, true);
}

/* ---- numbers of the client's own ---- */

void lod_begin_refine(struct lod_exchange *exchange) {
  if (exchange->length_known && exchange->length > BODY_MAX_BYTES)
    lod_reply_problem(&exchange->reply, 413, "limit-bytes", "The numbers take more than the 32 MiB that this server takes.", "");
}

void lod_body_refine(struct lod_exchange *exchange, const char *bytes, size_t size) {
  struct request *request = request_of(exchange);
  if (request == NULL) {
    out_of_memory(exchange);
    return;
  }
  if (request->values_size + size > BODY_MAX_BYTES) {
    lod_reply_problem(&exchange->reply, 413, "limit-bytes", "The numbers take more than the 32 MiB that this server takes.", "");
    return;
  }
  if (request->values_size + size > request->values_room) {
    size_t room = 2 * (request->values_size + size) + 4096;
    uint8_t *grown = realloc(request->values, room);
    if (grown == NULL) {
      request->body_failed = true;
      return;
    }
    request->values = grown;
    request->values_room = room;
  }
  memcpy(request->values + request->values_size, bytes, size);
  request->values_size += size;
}

void lod_answer_refine_values(struct lod_exchange *exchange) {
  struct request *request = request_of(exchange);
  if (request != NULL && (request->values_size == 0 || request->values_size % 4 != 0))
    lod_reply_problem(&exchange->reply, 400, "bad-body",
                      "The body must be 32-bit little-endian floats, one for each triangle, corner or vertex of the base.", "");
  else
    answer(exchange, false);
}
