/* Steps between the levels of a family, one behind the other, as one body. */
#ifndef LOD_SERVER_HTTP_DELTAS_H
#define LOD_SERVER_HTTP_DELTAS_H

#include "server/http/routes.h"

#define LOD_DELTA_MEDIA_TYPE "application/vnd.lodestream.delta"

enum { LOD_CHAIN_STEPS = 257 };

/* Objects whose bytes, in this order, lead to level `to`. */
struct lod_chain {
  uint32_t count;
  const char *names[LOD_CHAIN_STEPS]; /* SHA-256, borrowed from the model */
  uint64_t bytes;
};

/* From level `from`, or, when that is UINT32_MAX, from nothing, to level `to` (> from, of the family). False when a step is missing. */
bool lod_chain_find(const struct lod_stored_family *family, uint32_t from, uint32_t to, struct lod_chain *chain);

/* The chain's bytes. NULL and LOD_OK: not all objects are mapped and may_block is false, or, with may_block, one is gone. */
LOD_WARN_UNUSED enum lod_status lod_chain_body(struct lod_service *service, const struct lod_chain *chain, bool may_block,
                                               struct lod_body **body, struct lod_problem *problem);

/* Quoted; differs from every object's. */
void lod_chain_etag(const struct lod_chain *chain, char etag[LOD_ETAG_MAX]);

#endif
