/* Replies by the target that asked for them: who asks again for what was asked for is answered without parsing, matching or choosing.
 *
 * Only for GET and HEAD replies that depend on nothing but the target, whether gzip is taken, and the store's generation: those that
 * handlers call `shared`. Precompressed texts are among them. */
#ifndef LOD_SERVER_HTTP_MEMO_H
#define LOD_SERVER_HTTP_MEMO_H

#include "server/http/routes.h"

struct lod_memo {
  struct lod_cache *responses;      /* not owned */
  struct lod_cache_entry *response; /* held; its value is the prepared response */
  struct lod_body *body;            /* held */
  const struct lod_route *route;
  char etag[LOD_ETAG_MAX];
};

/* For lod_cache_create. */
void lod_memo_finish(void *memo);

/* The memo for a request whose headers are there; held until released; NULL: there is none, or the request has conditions or a range that
 * want the long way. target: as received. */
struct lod_cache_entry *lod_memo_find(struct lod_cache *memos, const struct lod_exchange *exchange, const char *target,
                                      uint64_t generation);
/* Notes the exchange's whole reply; takes `response`, which is held. */
void lod_memo_insert(struct lod_cache *memos, const struct lod_exchange *exchange, const char *target, uint64_t generation,
                     struct lod_cache *responses, struct lod_cache_entry *response);

#endif
