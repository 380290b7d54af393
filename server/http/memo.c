#include "server/http/memo.h"

#include <stdlib.h>
#include <string.h>

enum { KEY_MAX = 1024 };

struct key {
  size_t size;
  char text[KEY_MAX];
};

/* False when the request is not of the kind that has memos. */
static bool make_key(const struct lod_exchange *exchange, const char *target, struct key *key) {
  const char *cors = exchange->service->config->cors;
  void *context = exchange->header_context;
  size_t size = strlen(target);
  if ((exchange->method != LOD_GET && exchange->method != LOD_HEAD) || size > KEY_MAX - 1)
    return false;
  if (strcmp(cors, "*") != 0 && *cors && strcmp(cors, "none") != 0)
    return false; /* the reply depends on the Origin */
  if (exchange->header(context, "If-Match") || (exchange->method == LOD_GET && exchange->header(context, "Range")))
    return false;
  key->text[0] = lod_accepts_gzip(exchange->header(context, "Accept-Encoding")) ? 'z' : 'p';
  memcpy(key->text + 1, target, size);
  key->size = size + 1;
  return true;
}

void lod_memo_finish(void *value) {
  struct lod_memo *memo = value;
  lod_cache_release(memo->responses, memo->response);
  lod_body_release(memo->body);
  free(memo);
}

struct lod_cache_entry *lod_memo_find(struct lod_cache *memos, const struct lod_exchange *exchange, const char *target,
                                      uint64_t generation) {
  struct key key;
  return make_key(exchange, target, &key) ? lod_cache_find(memos, key.text, key.size, generation) : NULL;
}

void lod_memo_insert(struct lod_cache *memos, const struct lod_exchange *exchange, const char *target, uint64_t generation,
                     struct lod_cache *responses, struct lod_cache_entry *response) {
  struct key key;
  const struct lod_reply *reply = &exchange->reply;
  struct lod_memo *memo = reply->status == 200 && reply->body && make_key(exchange, target, &key) ? malloc(sizeof *memo) : NULL;
  if (!memo) {
    lod_cache_release(responses, response);
    return;
  }
  *memo = (struct lod_memo){responses, response, lod_body_retain(reply->body), exchange->route, ""};
  memcpy(memo->etag, reply->etag, sizeof memo->etag);
  struct lod_cache_entry *entry = lod_cache_insert(memos, key.text, key.size, generation, memo);
  if (entry)
    lod_cache_release(memos, entry);
}
