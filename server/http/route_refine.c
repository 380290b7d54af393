/* Refinement on demand and contact points: the query, the level that it starts from, and a warm worker's answer. */
#include <jansson.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/routes.h"
#include "server/jobs/pool.h"
#include "server/jobs/refine_query.h"

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

struct request {
  struct lod_pool_job job;
  struct lod_exchange *exchange;
  bool contact;
  char *parameters; /* JSON */
  char etag[LOD_ETAG_MAX];
  char base_name[96]; /* "envelope:3" */
  struct lod_body *base;
  uint8_t *values;
  size_t values_size, values_room;
  bool body_failed;
  atomic_bool gone; /* the client is */
};

static void finish_request(void *state) {
  struct request *request = state;
  free(request->parameters);
  free(request->values);
  lod_body_release(request->base);
  free(request->job.facts);
  free(request->job.bytes);
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
static void make_etag(struct request *request) {
  char values[LOD_ETAG_MAX] = "", *text = NULL;
  if (request->values_size != 0)
    lod_etag_of_bytes(request->values, request->values_size, values);
  int size = asprintf(&text, "%s %s %llu %s %s %s", LOD_VERSION, request->contact ? "contact" : "refine",
                      (unsigned long long)request->job.max_triangles, request->job.base, values, request->parameters);
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

static void keep(struct request *request, struct lod_body *body, const struct facts *facts) {
  struct lod_cache *cache = request->exchange->service->refined;
  struct refined *refined = body->size <= CACHED_ANSWER_BYTES && request->etag[0] != 0 ? calloc(1, sizeof *refined) : NULL;
  if (refined == NULL)
    return;
  refined->body = lod_body_retain(body);
  refined->facts = *facts;
  struct lod_cache_entry *entry = lod_cache_insert(cache, request->etag, strlen(request->etag), 0, refined);
  if (entry != NULL)
    lod_cache_release(cache, entry);
}

static void reply_mesh(struct request *request) {
  struct lod_pool_job *job = &request->job;
  json_t *json = json_loads(job->facts, 0, NULL);
  struct facts facts = {count_of(json, "triangles"), count_of(json, "vertices"), count_of(json, "base_triangles"),
                        json_is_true(json_object_get(json, "budget"))};
  json_decref(json);
  struct lod_body *body = lod_body_create(job->bytes, job->size, free, job->bytes);
  job->bytes = NULL;
  if (body == NULL) {
    out_of_memory(request->exchange);
    return;
  }
  keep(request, body, &facts);
  describe(request, body, &facts);
}

static void reply_contact(struct request *request) {
  json_t *json = json_loads(request->job.facts, 0, NULL);
  json_object_del(json, "bytes");
  json_object_set_new(json, "base", json_string(request->base_name));
  lod_reply_json(&request->exchange->reply, 200, LOD_CACHE_REVALIDATE, json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(9)));
  json_decref(json);
}

/* On a thread of the pool. */
static void take_answer(struct lod_pool_job *job) {
  struct request *request = job->context;
  struct lod_query_problem problem = {.problem = job->problem};
  snprintf(problem.parameter, sizeof problem.parameter, "%s", job->parameter);
  if (job->problem.status != LOD_OK)
    lod_reply_failure(&request->exchange->reply, &problem);
  else if (request->contact)
    reply_contact(request);
  else
    reply_mesh(request);
  request->exchange->finished(request->exchange);
}

/* On a background thread: the base may have to be read from the disk. True: take_answer follows. */
static bool start(struct lod_exchange *exchange) {
  struct request *request = exchange->state;
  struct lod_query_problem problem = {0};
  const char *type;
  request->base = lod_service_find_object(exchange->service, request->job.base, &type);
  if (request->base == NULL &&
      lod_service_open_object(exchange->service, request->job.base, &request->base, &type, &problem.problem) != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return false;
  }
  if (request->base == NULL) {
    lod_reply_problem(&exchange->reply, 503, "model-changed", "The model changed while the level was chosen; ask again.", "");
    lod_reply_header(&exchange->reply, "Retry-After", "1");
    return false;
  }
  request->job.base_bytes = request->base->bytes;
  request->job.base_size = request->base->size;
  if (atomic_load(&request->gone)) {
    lod_reply_problem(&exchange->reply, 503, "cancelled", "The client has gone.", "");
    return false;
  }
  if (lod_pool_submit(exchange->service->pool, &request->job, &problem.problem) == LOD_OK)
    return true; /* from here on the request may be over at any moment */
  lod_reply_failure(&exchange->reply, &problem);
  return false;
}

/* On the event loop, before the request is over. */
static void cancel(struct lod_exchange *exchange) {
  struct request *request = exchange->state;
  if (!atomic_exchange(&request->gone, true))
    lod_pool_cancel(exchange->service->pool, &request->job);
}

static void prepare(struct lod_exchange *exchange, struct request *request, const struct lod_stored_level *level,
                    const struct lod_stored_family *family) {
  request->job.kind = request->contact ? "contact" : "refine";
  request->job.parameters = request->parameters;
  request->job.values = request->values;
  request->job.values_size = request->values_size;
  request->job.max_triangles = exchange->service->config->refine_triangles;
  request->job.done = take_answer;
  request->job.context = request;
  snprintf(request->job.base, sizeof request->job.base, "%s", level->sha256);
  snprintf(request->base_name, sizeof request->base_name, "%s:%u", family->name, level->level);
  make_etag(request);
}

static bool answer_from_cache(struct lod_exchange *exchange, struct request *request) {
  struct lod_cache *cache = exchange->service->refined;
  struct lod_cache_entry *entry =
      request->contact || request->etag[0] == 0 ? NULL : lod_cache_find(cache, request->etag, strlen(request->etag), 0);
  if (entry == NULL)
    return false;
  struct refined *refined = lod_cache_value(entry);
  describe(request, lod_body_retain(refined->body), &refined->facts);
  lod_cache_release(cache, entry);
  return true;
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
    prepare(exchange, request, level, family);
    if (!answer_from_cache(exchange, request)) {
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
                      "The body must be 32-bit little-endian floats, one for each triangle of the base or three.", "");
  else
    answer(exchange, false);
}
