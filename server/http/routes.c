#include "server/http/routes.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <unistd.h>

#include "server/log.h"

static const char *const kNone[] = {NULL};
static const char *const kPage[] = {"limit", "after", NULL};
static const char *const kDelta[] = {"family", "from", "to", NULL};
static const char *const kUpload[] = {"name", "format", NULL};

static const struct lod_route kRoutes[] = {
    {LOD_GET, "/healthz", kNone, false, NULL, NULL, lod_answer_healthz},
    {LOD_GET, "/readyz", kNone, false, NULL, NULL, lod_answer_readyz},
    {LOD_GET, "/metrics", NULL, false, NULL, NULL, lod_answer_metrics},
    {LOD_GET, "/v1/openapi.json", kNone, false, NULL, NULL, lod_answer_openapi},
    {LOD_GET, "/v1/models", kPage, false, NULL, NULL, lod_answer_models},
    {LOD_GET, "/v1/models/{id}", kNone, false, NULL, NULL, lod_answer_model},
    {LOD_PUT, "/v1/models/{id}", kUpload, true, lod_begin_upload, lod_body_upload, lod_answer_upload},
    {LOD_DELETE, "/v1/models/{id}", kNone, true, NULL, NULL, lod_answer_model_delete},
    {LOD_GET, "/v1/models/{id}/level", NULL, false, NULL, NULL, lod_answer_level},
    {LOD_GET, "/v1/models/{id}/refine", NULL, false, NULL, NULL, lod_answer_refine},
    {LOD_POST, "/v1/models/{id}/refine", NULL, false, lod_begin_refine, lod_body_refine, lod_answer_refine_values},
    {LOD_GET, "/v1/models/{id}/contact", NULL, false, NULL, NULL, lod_answer_contact},
    {LOD_GET, "/v1/models/{id}/patches", NULL, false, NULL, NULL, lod_answer_patches},
    {LOD_GET, "/v1/models/{id}/delta", kDelta, false, NULL, NULL, lod_answer_delta},
    {LOD_GET, "/v1/models/{id}/tileset.json", kNone, false, NULL, NULL, lod_answer_document},
    {LOD_GET, "/v1/models/{id}/model.glb", kNone, false, NULL, NULL, lod_answer_document},
    /* A GLB names its textures by bare sibling names, so they resolve wherever it was fetched from. */
    {LOD_GET, "/v1/models/{id}/{sha256}", kNone, false, NULL, NULL, lod_answer_object},
    {LOD_GET, "/v1/objects/{sha256}", kNone, false, NULL, NULL, lod_answer_object},
    {LOD_GET, "/v1/jobs/{n}", kNone, false, NULL, NULL, lod_answer_job},
    {LOD_GET, "/v1/jobs/{n}/events", kNone, false, NULL, NULL, lod_answer_job_events},
    {LOD_GET, "/", NULL, false, NULL, NULL, lod_answer_viewer},
    {LOD_GET, "/viewer/{path}", NULL, false, NULL, NULL, lod_answer_viewer},
};
enum { ROUTE_COUNT = sizeof kRoutes / sizeof *kRoutes };

static const char *const kMethods[] = {"GET", "HEAD", "PUT", "DELETE", "POST", "OPTIONS"};

const struct lod_route *lod_routes(uint32_t *count) {
  *count = ROUTE_COUNT;
  return kRoutes;
}

const char *const *lod_route_names(uint32_t *count) {
  static const char *names[ROUTE_COUNT + 1];
  for (size_t i = 0; i < ROUTE_COUNT; i++)
    names[i] = kRoutes[i].pattern;
  names[ROUTE_COUNT] = "other";
  *count = ROUTE_COUNT + 1;
  return names;
}

uint32_t lod_route_index(const struct lod_route *route) {
  return route ? (uint32_t)(route - kRoutes) : ROUTE_COUNT;
}

/* ---- matching ---- */

static bool match_segment(const char *pattern, size_t size, const char *segment) {
  size_t length = strlen(segment);
  if (size == 4 && strncmp(pattern, "{id}", 4) == 0)
    return length > 0;
  if (size == 3 && strncmp(pattern, "{n}", 3) == 0)
    return length > 0 && length <= 18 && strspn(segment, "0123456789") == length;
  if (size == 8 && strncmp(pattern, "{sha256}", 8) == 0)
    return length == LOD_SHA256_HEX && strspn(segment, "0123456789abcdef") == LOD_SHA256_HEX;
  return size == length && strncmp(pattern, segment, size) == 0;
}

static bool match(const char *pattern, const struct lod_target *target) {
  uint32_t i = 0;
  pattern++; /* the leading slash */
  while (*pattern) {
    size_t size = strcspn(pattern, "/");
    if (size == 6 && strncmp(pattern, "{path}", 6) == 0)
      return i < target->segment_count;
    if (i == target->segment_count || !match_segment(pattern, size, target->segments[i]))
      return false;
    i++;
    pattern += size + (pattern[size] == '/');
  }
  return i == target->segment_count;
}

/* ---- what all routes have in common ---- */

static void allow_methods(struct lod_exchange *exchange, uint32_t methods) {
  char list[64] = "";
  for (uint32_t i = 0; i < sizeof kMethods / sizeof *kMethods; i++)
    if (methods & 1u << i) {
      size_t used = strlen(list);
      snprintf(list + used, sizeof list - used, "%s%s", used ? ", " : "", kMethods[i]);
    }
  lod_reply_header(&exchange->reply, "Allow", "%s", list);
}

static void answer_options(struct lod_exchange *exchange, uint32_t methods) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 204;
  allow_methods(exchange, methods);
  lod_reply_header(reply, "Access-Control-Allow-Methods", "GET, HEAD, PUT, DELETE, POST, OPTIONS");
  lod_reply_header(
      reply, "Access-Control-Allow-Headers",
      "Authorization, Content-Type, Content-Disposition, Range, If-Range, If-Match, If-None-Match, Last-Event-ID, X-Request-Id");
  lod_reply_header(reply, "Access-Control-Max-Age", "86400");
}

/* True when the request may go on; else 401 or 403 is said. */
static bool check_token(struct lod_exchange *exchange) {
  const struct lod_tokens *tokens = exchange->service->tokens;
  if (!tokens || !exchange->route->protected)
    return true;
  const char *sent = exchange->header(exchange->header_context, "Authorization");
  exchange->token = lod_tokens_find(tokens, sent);
  if (!exchange->token) {
    lod_reply_problem(
        &exchange->reply, 401, "unauthorized",
        sent ? "The bearer token is none of those that this server knows." : "This request needs `Authorization: Bearer TOKEN`.", "");
    lod_reply_header(&exchange->reply, "WWW-Authenticate",
                     sent ? "Bearer realm=\"lodestream\", error=\"invalid_token\"" : "Bearer realm=\"lodestream\"");
    return false;
  }
  enum lod_right right = exchange->method == LOD_DELETE ? LOD_RIGHT_DELETE : LOD_RIGHT_WRITE;
  if (lod_token_may(exchange->token, right, exchange->target.segments[2]))
    return true;
  lod_reply_problem(&exchange->reply, 403, "forbidden", "The bearer token does not allow this for this model.", "");
  lod_reply_header(&exchange->reply, "WWW-Authenticate", "Bearer realm=\"lodestream\", error=\"insufficient_scope\"");
  return false;
}

void lod_routes_begin(struct lod_exchange *exchange) {
  const struct lod_target *target = &exchange->target;
  uint32_t methods = 0;
  if (exchange->method == LOD_OPTIONS && target->segment_count == 1 && strcmp(target->segments[0], "*") == 0) {
    answer_options(exchange, 1u << LOD_GET | 1u << LOD_HEAD | 1u << LOD_PUT | 1u << LOD_DELETE | 1u << LOD_POST | 1u << LOD_OPTIONS);
    return;
  }
  enum lod_method wanted = exchange->method == LOD_HEAD ? LOD_GET : exchange->method;
  for (uint32_t i = 0; i < ROUTE_COUNT; i++)
    if (match(kRoutes[i].pattern, target)) {
      methods |= 1u << kRoutes[i].method | (kRoutes[i].method == LOD_GET ? 1u << LOD_HEAD : 0) | 1u << LOD_OPTIONS;
      if (kRoutes[i].method == wanted && !exchange->route)
        exchange->route = &kRoutes[i];
    }
  if (!methods) {
    lod_reply_problem(&exchange->reply, 404, "unknown-path", "There is nothing at this path; GET /v1/openapi.json lists what there is.",
                      "");
    return;
  }
  if (exchange->method == LOD_OPTIONS) {
    answer_options(exchange, methods);
    return;
  }
  if (!exchange->route) {
    lod_reply_problem(&exchange->reply, 405, "method-not-allowed",
                      "This path does not take this method; the Allow header lists those that it takes.", "");
    allow_methods(exchange, methods);
    return;
  }
  struct lod_query_problem problem = {0};
  if (!check_token(exchange))
    return;
  if (exchange->route->parameters && lod_target_check_names(target, exchange->route->parameters, &problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else if (exchange->route->begin)
    exchange->route->begin(exchange);
}

/* ---- headers of every reply ---- */

/* The origin to allow: "*", the request's when it is listed, or NULL. *varies: whether it depends on the request. */
static const char *allowed_origin(const struct lod_exchange *exchange, bool *varies) {
  const char *list = exchange->service->config->cors;
  *varies = false;
  if (strcmp(list, "*") == 0)
    return "*";
  if (!*list || strcmp(list, "none") == 0)
    return NULL;
  *varies = true;
  const char *origin = exchange->header(exchange->header_context, "Origin");
  size_t size = origin ? strlen(origin) : 0;
  for (const char *p = list; size && *p;) {
    p += strspn(p, " ,");
    size_t length = strcspn(p, " ,");
    if (length == size && strncmp(p, origin, size) == 0)
      return origin;
    p += length;
  }
  return NULL;
}

void lod_routes_headers(const struct lod_exchange *exchange, void (*emit)(void *context, const char *name, const char *value),
                        void *context) {
  static const char *const kCache[] = {"no-store", "no-cache", "public, max-age=31536000, immutable"};
  const struct lod_reply *reply = &exchange->reply;
  bool varies;
  const char *origin = allowed_origin(exchange, &varies);
  if (reply->type)
    emit(context, "Content-Type", reply->type);
  if (reply->encoded)
    emit(context, "Content-Encoding", "gzip");
  if (*reply->etag)
    emit(context, "ETag", reply->etag);
  emit(context, "Cache-Control", kCache[reply->cache]);
  if (reply->body && *reply->etag)
    emit(context, "Accept-Ranges", "bytes");
  for (uint32_t i = 0; i < reply->header_count; i++)
    emit(context, reply->headers[i].name, reply->headers[i].value);
  if (varies && reply->compress)
    emit(context, "Vary", "Origin, Accept-Encoding");
  else if (varies || reply->compress)
    emit(context, "Vary", varies ? "Origin" : "Accept-Encoding");
  if (!reply->shared && exchange->request_id)
    emit(context, "X-Request-Id", exchange->request_id);
  if (origin) {
    emit(context, "Access-Control-Allow-Origin", origin);
    emit(context, "Access-Control-Expose-Headers",
         "ETag, Content-Range, Content-Location, Location, Retry-After, Lod-Family, Lod-From, Lod-Level, Lod-Error, Lod-Screen-Error, "
         "Lod-Triangles, Lod-Vertices, Lod-Base, Lod-Base-Triangles, Lod-Budget, "
         "Server-Timing, X-Request-Id");
    emit(context, "Timing-Allow-Origin", origin);
  }
  emit(context, "Cross-Origin-Resource-Policy", "cross-origin");
  emit(context, "X-Content-Type-Options", "nosniff");
}

/* ---- what handlers share ---- */

static void release_body(void *body) {
  lod_body_release(body);
}

struct kept_tokens {
  struct lod_tokens *tokens;
  struct kept_tokens *older;
};

static enum lod_status read_tokens(struct lod_service *service, const char *path, struct lod_problem *problem) {
  struct lod_tokens *tokens = NULL;
  bool plain = false;
  if (*path)
    LOD_TRY(lod_tokens_read(path, service->tokens, &tokens, &plain, problem));
  struct kept_tokens *kept = tokens ? malloc(sizeof *kept) : NULL;
  if (tokens && !kept) {
    lod_tokens_destroy(tokens);
    return lod_fail_memory(problem);
  }
  if (plain)
    lod_log(LOD_LOG_WARN,
            "--token-file holds a token in plain text; lodestreamd --make-token NAME makes one of which only the digest is kept");
  if (kept) {
    *kept = (struct kept_tokens){tokens, service->kept};
    service->kept = kept;
  }
  service->tokens = tokens;
  return LOD_OK;
}

enum lod_status lod_service_set_config(struct lod_service *service, const struct lod_config *config, struct lod_problem *problem) {
  LOD_TRY(read_tokens(service, config->token_file, problem));
  service->config = config;
  return LOD_OK;
}

enum lod_status lod_service_init(struct lod_service *service, struct lod_store *store, struct lod_jobs *jobs, struct lod_metrics *metrics,
                                 const struct lod_config *config, struct lod_problem *problem) {
  service->store = store;
  service->jobs = jobs;
  service->metrics = metrics;
  service->config = config;
  service->viewer_fd = -1;
  service->objects = lod_cache_create(config->cached_objects, release_body);
  service->compressed = lod_cache_create(64, release_body);
  service->refined = lod_cache_create(64, lod_refined_release);
  service->openapi = lod_body_create(lod_openapi_json, (size_t)(lod_openapi_json_end - lod_openapi_json), NULL, NULL);
  if (!service->objects || !service->compressed || !service->refined || !service->openapi)
    return lod_fail_memory(problem);
  if (*config->viewer) {
    service->viewer_fd = open(config->viewer, O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (service->viewer_fd < 0)
      return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--viewer: '%s' is not a folder that can be read.", config->viewer);
  }
  return read_tokens(service, config->token_file, problem);
}

void lod_service_finish(struct lod_service *service) {
  lod_cache_destroy(service->objects);
  lod_cache_destroy(service->compressed);
  lod_cache_destroy(service->refined);
  lod_body_release(service->openapi);
  if (service->viewer_fd >= 0)
    close(service->viewer_fd);
  service->objects = service->compressed = service->refined = NULL;
  service->tokens = NULL;
  while (service->kept) {
    struct kept_tokens *older = service->kept->older;
    lod_tokens_destroy(service->kept->tokens);
    free(service->kept);
    service->kept = older;
  }
  service->openapi = NULL;
  service->viewer_fd = -1;
}

void lod_service_trim(struct lod_service *service) {
  uint64_t generation = lod_store_generation(service->store);
  lod_cache_trim(service->objects, generation);
  if (service->memos)
    lod_cache_trim(service->memos, generation);
  if (service->responses)
    lod_cache_trim(service->responses, generation);
}

static void release_object(void *object) {
  lod_store_object_release(object);
}

/* Holds the cached body for the caller and lets the entry go. */
static struct lod_body *take_object(struct lod_service *service, struct lod_cache_entry *entry, const char **type) {
  struct lod_body *body = lod_body_retain(lod_cache_value(entry));
  *type = ((const struct lod_object *)body->context)->type;
  lod_cache_release(service->objects, entry);
  return body;
}

struct lod_body *lod_service_find_object(struct lod_service *service, const char *sha256, const char **type) {
  struct lod_cache_entry *entry = lod_cache_find(service->objects, sha256, LOD_SHA256_HEX, lod_store_generation(service->store));
  return entry ? take_object(service, entry, type) : NULL;
}

/* A page that is not in memory would stop an event loop, and all of its connections, for the time of a disk access. The beginning is read
 * here, on a background thread, and the rest asked for: by when it is sent it is there. */
static void read_ahead(const struct lod_object *object) {
  enum { BEGINNING = 4 << 20 };
  void *bytes = (void *)object->bytes;
  if (madvise(bytes, object->size < BEGINNING ? object->size : BEGINNING, MADV_POPULATE_READ) != 0 || object->size > BEGINNING)
    madvise(bytes, object->size, MADV_WILLNEED);
}

enum lod_status lod_service_open_object(struct lod_service *service, const char *sha256, struct lod_body **body, const char **type,
                                        struct lod_problem *problem) {
  uint64_t generation = lod_store_generation(service->store);
  struct lod_object *object;
  *body = NULL;
  LOD_TRY(lod_store_object_open(service->store, sha256, &object, problem));
  if (!object)
    return LOD_OK;
  read_ahead(object);
  struct lod_body *opened = lod_body_create(object->bytes, object->size, release_object, object);
  if (opened)
    opened->file = object->file;
  struct lod_cache_entry *entry = opened ? lod_cache_insert(service->objects, sha256, LOD_SHA256_HEX, generation, opened) : NULL;
  if (!entry)
    return lod_fail_memory(problem);
  *body = take_object(service, entry, type);
  return LOD_OK;
}

struct lod_conditions lod_exchange_conditions(const struct lod_exchange *exchange) {
  void *context = exchange->header_context;
  return (struct lod_conditions){
      .if_match = exchange->header(context, "If-Match"),
      .if_none_match = exchange->header(context, "If-None-Match"),
      .if_range = exchange->header(context, "If-Range"),
      .range = exchange->header(context, "Range"),
      .get = exchange->method == LOD_GET,
  };
}

static void compress_in_background(struct lod_exchange *exchange) {
  lod_exchange_compress(exchange, true);
}

void lod_exchange_compress(struct lod_exchange *exchange, bool may_block) {
  enum { QUICK_BYTES = 16 << 10 };
  struct lod_reply *reply = &exchange->reply;
  struct lod_cache *cache = exchange->service->compressed;
  void *context = exchange->header_context;
  if (reply->status != 200 || !reply->compress || reply->encoded || !reply->body || exchange->header(context, "Range") ||
      !lod_accepts_gzip(exchange->header(context, "Accept-Encoding")))
    return;
  size_t key_size = strlen(reply->etag);
  struct lod_cache_entry *entry = key_size ? lod_cache_find(cache, reply->etag, key_size, 0) : NULL;
  struct lod_body *smaller = entry ? lod_body_retain(lod_cache_value(entry)) : NULL;
  if (!smaller) {
    if (!may_block && reply->body->size > QUICK_BYTES) {
      exchange->work = compress_in_background;
      return;
    }
    smaller = lod_body_gzip(reply->body);
    if (smaller && key_size)
      entry = lod_cache_insert(cache, reply->etag, key_size, 0, lod_body_retain(smaller));
  }
  if (entry)
    lod_cache_release(cache, entry);
  if (!smaller)
    return;
  lod_body_release(reply->body);
  reply->body = smaller;
  reply->encoded = true;
  if (key_size) /* other bytes, so another tag */
    snprintf(reply->etag + key_size - 1, sizeof reply->etag - key_size + 1, "-gzip\"");
}

void lod_exchange_unknown_model(struct lod_exchange *exchange, const char *id) {
  char detail[256];
  snprintf(detail, sizeof detail, "There is no model '%.*s'.", LOD_MODEL_ID_MAX, id);
  lod_reply_problem(&exchange->reply, 404, "unknown-model", detail, "");
}
