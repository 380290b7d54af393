/* Bearer tokens: who may change which models, and how much they may send. The file holds digests, not tokens:
 *
 *   # name  SHA-256 of the token   rights
 *   ci      sha256:9f86d081...
 *   alice   sha256:60303ae2...     models=alice-*,shared may=write bytes-per-day=10GiB
 *
 * models: ids, where * at the end stands for any rest; none given: all. may: write, delete; none given: both. bytes-per-day: of uploads in
 * any 24 hours from the first on; counted in memory. A single line without "sha256:" is a token in plain text with all rights.
 * A token of 256 random bits needs no slow hash: it cannot be guessed from its digest. `lodestreamd --make-token NAME` makes one. */
#ifndef LOD_SERVER_HTTP_TOKEN_H
#define LOD_SERVER_HTTP_TOKEN_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"

struct lod_tokens;
struct lod_token;

enum lod_right { LOD_RIGHT_WRITE = 1, LOD_RIGHT_DELETE = 2 };

/* before: what it replaces (not owned; its counts of bytes are taken over), or NULL. *plain: the file holds a token in plain text.
 * LOD_BAD_INPUT names the line. */
LOD_WARN_UNUSED enum lod_status lod_tokens_read(const char *path, const struct lod_tokens *before, struct lod_tokens **tokens, bool *plain,
                                                struct lod_problem *problem);
void lod_tokens_destroy(struct lod_tokens *tokens); /* NULL is allowed */

/* The token of an Authorization header's value; NULL: none of ours. Every digest is compared in constant time, so neither content nor
 * length of a token shows in the time that it takes. */
const struct lod_token *lod_tokens_find(const struct lod_tokens *tokens, const char *authorization);
const char *lod_token_name(const struct lod_token *token);
bool lod_token_may(const struct lod_token *token, enum lod_right right, const char *id);
/* Takes so many bytes off the day's share. False: there is not so much left, nothing is taken, and *retry_seconds says when to try again.
 * now: seconds, monotonic. Any thread. */
bool lod_token_take_bytes(const struct lod_token *token, uint64_t bytes, double now, unsigned *retry_seconds);

/* Prints a fresh token and the line for the file. False: no random bytes. */
bool lod_token_make(const char *name, FILE *out);

#endif
