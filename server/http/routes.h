/* The routes: one const table of method, path and handler, and what a handler sees of a request. No libmicrohttpd here.
 *
 * A request goes through its route in up to four steps: begin (headers are there; may refuse before a body is sent), body (a piece of an
 * upload), answer (everything is there; fills the reply) and, when answer sets `work`, that function on a background thread because it
 * waits for the disk. All but work run on the event loop and must not block. */
#ifndef LOD_SERVER_HTTP_ROUTES_H
#define LOD_SERVER_HTTP_ROUTES_H

#include <stdatomic.h>

#include "server/config.h"
#include "server/http/cache.h"
#include "server/http/response.h"
#include "server/http/token.h"
#include "server/jobs/jobs.h"
#include "server/metrics.h"
#include "server/store/store.h"

enum lod_method { LOD_GET, LOD_HEAD, LOD_PUT, LOD_DELETE, LOD_POST, LOD_OPTIONS, LOD_METHOD_OTHER };

/* What all handlers share. */
struct lod_service {
  struct lod_store *store; /* not owned, like the next three */
  struct lod_jobs *jobs;
  struct lod_metrics *metrics;
  _Atomic(const struct lod_config *) config; /* not owned; replaced as a whole by lod_service_set_config */
  struct lod_cache *objects;                 /* hex SHA-256 -> struct lod_body of the mapped object */
  struct lod_cache *responses;               /* http.c's prepared responses, for their counts; not owned, NULL before it runs */
  struct lod_cache *memos;                   /* http.c's replies by target; likewise */
  struct lod_cache *compressed;              /* ETag -> struct lod_body, gzip of what that ETag names */
  struct lod_cache *refined;                 /* ETag -> an answer of route_refine.c */
  struct lod_pool *pool;                     /* warm workers; not owned; NULL: this server refines nothing */
  struct lod_errands *errands;               /* equal requests to them, together; not owned; NULL with pool */
  _Atomic(const struct lod_tokens *) tokens; /* NULL: anyone may write */
  struct kept_tokens *kept;                  /* all that were ever read */
  int viewer_fd;                             /* folder of the viewer's files; -1 = none */
  struct lod_body *openapi;
  atomic_bool draining;
  _Atomic uint64_t job_changes; /* counts up whenever any job changes */
  _Atomic uint64_t refined_memory_hits, refined_store_hits;
};
/* Opens the viewer's folder, reads the token, makes the caches. LOD_BAD_INPUT: the token file is missing or empty. */
LOD_WARN_UNUSED enum lod_status lod_service_init(struct lod_service *service, struct lod_store *store, struct lod_jobs *jobs,
                                                 struct lod_metrics *metrics, const struct lod_config *config, struct lod_problem *problem);
/* Takes other settings and reads the tokens again; both old ones must live on until the service ends: requests may still look at them.
 * LOD_BAD_INPUT: nothing changes. */
LOD_WARN_UNUSED enum lod_status lod_service_set_config(struct lod_service *service, const struct lod_config *config,
                                                       struct lod_problem *problem);
void lod_service_finish(struct lod_service *service);
/* Lets go of what is cached of models that were replaced or deleted, so that the store can remove their objects; any thread. */
void lod_service_trim(struct lod_service *service);
/* The object's bytes when they are mapped already, retained; else NULL. *type: media type, valid while the body is held. */
struct lod_body *lod_service_find_object(struct lod_service *service, const char *sha256, const char **type);
/* The same; maps the object when it has to and reads its beginning from the disk, so it may block. NULL and LOD_OK: there is none. */
LOD_WARN_UNUSED enum lod_status lod_service_open_object(struct lod_service *service, const char *sha256, struct lod_body **body,
                                                        const char **type, struct lod_problem *problem);

struct lod_exchange {
  struct lod_service *service;   /* not owned */
  const struct lod_route *route; /* NULL: none; the reply says why */
  enum lod_method method;
  struct lod_target target;
  const char *(*header)(void *context, const char *name); /* NULL when it was not sent; valid until the reply is queued */
  void *header_context;
  bool length_known; /* Content-Length was sent */
  uint64_t length;
  const struct lod_token *token; /* that the request came with; NULL: none of ours, or none is asked for */
  const char *request_id;        /* the client's own, or one of ours */
  void *state;                   /* a handler's own; state_finish is called with it at the end, however that comes */
  void (*state_finish)(void *state);
  void (*work)(struct lod_exchange *exchange);
  /* Instead of work, for what is answered by somebody else. start runs on a background thread; true: `finished` will be called, from any
   * thread, once the reply is there (maybe before start returns); false: it is there now. cancel (may be NULL) is called on the event loop,
   * at most once and before the request is over, when the client goes away meanwhile. */
  bool (*start)(struct lod_exchange *exchange);
  void (*cancel)(struct lod_exchange *exchange);
  void (*finished)(struct lod_exchange *exchange); /* set by http.c */
  struct lod_reply reply;                          /* last */
};

struct lod_route {
  enum lod_method method; /* GET serves HEAD too */
  const char *pattern;    /* "{id}" any segment, "{n}" digits, "{sha256}" 64 lower-case hex digits, "{path}" one or more segments, last */
  const char *const *parameters; /* known names, NULL-terminated; NULL = the handler checks them, or any goes */
  bool protected;                /* needs the bearer token when one is configured */
  void (*begin)(struct lod_exchange *exchange);
  void (*body)(struct lod_exchange *exchange, const char *bytes, size_t size);
  void (*answer)(struct lod_exchange *exchange);
};
/* The table; *count rows, literal paths before patterns. */
const struct lod_route *lod_routes(uint32_t *count);
/* Labels for metrics: each row's pattern, then "other". */
const char *const *lod_route_names(uint32_t *count);
uint32_t lod_route_index(const struct lod_route *route);

/* Finds the route of a parsed target and does what every route has in common: 404, 405 with Allow, OPTIONS, unknown parameters, the token,
 * then the route's begin. Leaves reply.status 0 when the route's answer is to be called. */
void lod_routes_begin(struct lod_exchange *exchange);

/* Headers that every reply carries, whatever its status: CORS, cache rule, ETag, type and protection. emit is called for each. */
void lod_routes_headers(const struct lod_exchange *exchange, void (*emit)(void *context, const char *name, const char *value),
                        void *context);

/* Handlers, one file a noun. */
void lod_answer_healthz(struct lod_exchange *exchange);
void lod_answer_readyz(struct lod_exchange *exchange);
void lod_answer_metrics(struct lod_exchange *exchange);
void lod_answer_openapi(struct lod_exchange *exchange);
void lod_answer_models(struct lod_exchange *exchange);
void lod_answer_model(struct lod_exchange *exchange);
void lod_answer_model_delete(struct lod_exchange *exchange);
void lod_begin_upload(struct lod_exchange *exchange);
void lod_body_upload(struct lod_exchange *exchange, const char *bytes, size_t size);
void lod_answer_upload(struct lod_exchange *exchange);
void lod_answer_level(struct lod_exchange *exchange);
void lod_answer_patches(struct lod_exchange *exchange);
void lod_answer_delta(struct lod_exchange *exchange);
void lod_answer_refine(struct lod_exchange *exchange);
void lod_answer_contact(struct lod_exchange *exchange);
void lod_begin_refine(struct lod_exchange *exchange);
void lod_body_refine(struct lod_exchange *exchange, const char *bytes, size_t size);
void lod_answer_refine_values(struct lod_exchange *exchange);
void lod_refined_release(void *value); /* of service->refined */
void lod_answer_object(struct lod_exchange *exchange);
void lod_answer_document(struct lod_exchange *exchange);
void lod_answer_job(struct lod_exchange *exchange);
void lod_answer_job_events(struct lod_exchange *exchange);
void lod_answer_viewer(struct lod_exchange *exchange);

/* Helpers that handlers share. */
struct lod_conditions lod_exchange_conditions(const struct lod_exchange *exchange);
/* Turns a 200 reply that is worth it into its gzip form when the client takes that and asks for no range. may_block false: what takes long
 * is left to exchange->work. */
void lod_exchange_compress(struct lod_exchange *exchange, bool may_block);
/* 404 "unknown-model". */
void lod_exchange_unknown_model(struct lod_exchange *exchange, const char *id);
/* A malloc'd JSON text of a job. */
char *lod_job_json(const struct lod_job *job);

/* The OpenAPI document, embedded in the program. */
extern const char lod_openapi_json[];
extern const char lod_openapi_json_end[];

#endif
