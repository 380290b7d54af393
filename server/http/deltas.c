#include "server/http/deltas.h"

#include <stdlib.h>
#include <string.h>

/* More steps at once than this are joined in memory for no client: it can ask for fewer. */
enum { MOST_BYTES = 1 << 28 };

bool lod_chain_find(const struct lod_stored_family *family, uint32_t from, uint32_t to, struct lod_chain *chain) {
  *chain = (struct lod_chain){0};
  if (to >= family->level_count || (from != UINT32_MAX && from >= to))
    return false;
  if (from == UINT32_MAX) {
    const struct lod_stored_level *level = &family->levels[0];
    if (!level->first[0])
      return false;
    chain->names[chain->count++] = level->first;
    chain->bytes = level->first_bytes;
    from = 0;
  }
  for (uint32_t k = from; k < to; k++) {
    const struct lod_stored_level *level = &family->levels[k];
    if (!level->delta[0] || chain->count == LOD_CHAIN_STEPS)
      return false;
    chain->names[chain->count++] = level->delta;
    chain->bytes += level->delta_bytes;
  }
  return true;
}

static enum lod_status open_one(struct lod_service *service, const char *name, bool may_block, struct lod_body **body,
                                struct lod_problem *problem) {
  const char *type;
  *body = lod_service_find_object(service, name, &type);
  return *body || !may_block ? LOD_OK : lod_service_open_object(service, name, body, &type, problem);
}

enum lod_status lod_chain_body(struct lod_service *service, const struct lod_chain *chain, bool may_block, struct lod_body **body,
                               struct lod_problem *problem) {
  *body = NULL;
  if (chain->count == 1)
    return open_one(service, chain->names[0], may_block, body, problem);
  if (!may_block) /* copying takes time too */
    return LOD_OK;
  if (chain->bytes > MOST_BYTES)
    return lod_fail(problem, LOD_LIMIT, "limit-bytes", "These steps have %llu bytes together; ask for fewer of them.",
                    (unsigned long long)chain->bytes);
  char *joined = malloc(chain->bytes ? (size_t)chain->bytes : 1);
  size_t size = 0;
  if (!joined)
    return lod_fail_memory(problem);
  for (uint32_t i = 0; i < chain->count; i++) {
    struct lod_body *step;
    enum lod_status status = open_one(service, chain->names[i], true, &step, problem);
    const bool fits = status == LOD_OK && step && step->size <= chain->bytes - size;
    if (fits)
      memcpy(joined + size, step->bytes, step->size);
    size += fits ? step->size : 0;
    if (status == LOD_OK)
      lod_body_release(step);
    if (!fits) {
      free(joined);
      return status;
    }
  }
  *body = lod_body_take(joined, size);
  return *body ? LOD_OK : lod_fail_memory(problem);
}

void lod_chain_etag(const struct lod_chain *chain, char etag[LOD_ETAG_MAX]) {
  char *names = malloc((size_t)chain->count * LOD_SHA256_HEX + 1);
  etag[0] = '\0';
  if (!names)
    return;
  for (uint32_t i = 0; i < chain->count; i++)
    memcpy(names + (size_t)i * LOD_SHA256_HEX, chain->names[i], LOD_SHA256_HEX);
  lod_etag_of_bytes(names, (size_t)chain->count * LOD_SHA256_HEX, etag);
  free(names);
}
