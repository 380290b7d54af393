/* Checks a store that no daemon holds: the catalogue, every object's bytes against the SHA-256 that names it, every manifest, and files
 * that nothing names. Repairs what can be repaired without inventing anything. */
#ifndef LOD_SERVER_STORE_CHECK_H
#define LOD_SERVER_STORE_CHECK_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"

struct lod_store_findings {
  uint64_t models, objects, bytes; /* that the catalogue has */
  uint64_t damaged, missing;       /* objects: wrong bytes or size; no file */
  uint64_t broken_models;          /* name a damaged or missing object, or have no proper manifest */
  uint64_t stray;                  /* files beneath objects/ that nothing names */
  uint64_t lost_uploads;           /* queued jobs whose upload is gone */
  uint64_t refined;                /* files beneath refined/: answers that were kept */
  uint64_t refined_damaged;        /* of these: not whole, or no answers */
  uint64_t refined_stray;          /* of these: of models that are not there */
  uint64_t repaired;               /* of all of these, with `repair` */
};

/* A line about each finding goes to `out` (NULL: none). repair: damaged files go to lost+found/, models that cannot be served whole lose
 * their rows (what they shared with others stays), stray files are removed, and answers that are no good, which a cache can lose; the
 * upload of a lost job cannot be had back, its job fails at the next start. LOD_OK whatever was found; LOD_IO "store-locked",
 * "store-corrupt" (the database itself: only a backup helps), ... */
LOD_WARN_UNUSED enum lod_status lod_store_check(const char *directory, bool repair, FILE *out, struct lod_store_findings *findings,
                                                struct lod_problem *problem);

#endif
