#include "server/http/token.h"

#include <errno.h>
#include <nettle/memops.h>
#include <nettle/sha2.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>

#include "server/config.h"

enum { NAME_MAX_BYTES = 63, LINE_BYTES = 4096, TOKENS_MAX = 10000, DAY_SECONDS = 86400 };

struct lod_token {
  char name[NAME_MAX_BYTES + 1];
  uint8_t digest[SHA256_DIGEST_SIZE];
  unsigned rights;
  char *models;           /* separated by commas; NULL = all */
  uint64_t bytes_per_day; /* 0 = no limit */
  struct share *share;
};

/* What was taken in the present day, which begins with its first byte. */
struct share {
  double began;
  uint64_t bytes;
};

struct lod_tokens {
  struct lod_token *list;
  size_t count;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* guards every share */

static void digest_of(const char *text, size_t size, uint8_t digest[SHA256_DIGEST_SIZE]) {
  struct sha256_ctx hash;
  sha256_init(&hash);
  sha256_update(&hash, size, (const uint8_t *)text);
  sha256_digest(&hash, SHA256_DIGEST_SIZE, digest);
}

static bool read_hex(const char *text, uint8_t digest[SHA256_DIGEST_SIZE]) {
  if (strlen(text) != 2 * SHA256_DIGEST_SIZE || strspn(text, "0123456789abcdefABCDEF") != 2 * SHA256_DIGEST_SIZE)
    return false;
  for (int i = 0; i < SHA256_DIGEST_SIZE; i++) {
    char pair[3] = {text[2 * i], text[2 * i + 1], 0};
    digest[i] = (uint8_t)strtoul(pair, NULL, 16);
  }
  return true;
}

static bool read_rights(const char *text, unsigned *rights) {
  *rights = 0;
  while (*text) {
    size_t size = strcspn(text, ",");
    if (size == 5 && strncmp(text, "write", 5) == 0)
      *rights |= LOD_RIGHT_WRITE;
    else if (size == 6 && strncmp(text, "delete", 6) == 0)
      *rights |= LOD_RIGHT_DELETE;
    else
      return false;
    text += size + (text[size] == ',');
  }
  return *rights != 0;
}

static enum lod_status read_option(struct lod_token *token, const char *word, const char *where, struct lod_problem *problem) {
  if (strncmp(word, "models=", 7) == 0 && word[7] && !token->models) {
    token->models = strdup(word + 7);
    return token->models ? LOD_OK : lod_fail_memory(problem);
  }
  if (strncmp(word, "may=", 4) == 0 && read_rights(word + 4, &token->rights))
    return LOD_OK;
  if (strncmp(word, "bytes-per-day=", 14) == 0 && lod_config_parse_bytes(word + 14, &token->bytes_per_day))
    return LOD_OK;
  return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: '%.60s' is none of models=ID,..., may=write,delete and bytes-per-day=BYTES.",
                  where, word);
}

/* line: changed. */
static enum lod_status read_line(struct lod_token *token, char *line, const char *where, struct lod_problem *problem) {
  char *rest = NULL;
  const char *name = strtok_r(line, " \t", &rest), *digest = strtok_r(NULL, " \t", &rest);
  if (strlen(name) > NAME_MAX_BYTES || strspn(name, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-") != strlen(name))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: a token's name is 1 to %d of A-Z a-z 0-9 . _ -.", where, NAME_MAX_BYTES);
  snprintf(token->name, sizeof token->name, "%s", name);
  if (!digest || strncmp(digest, "sha256:", 7) != 0 || !read_hex(digest + 7, token->digest))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: after the name comes sha256: and 64 hex digits.", where);
  token->rights = LOD_RIGHT_WRITE | LOD_RIGHT_DELETE;
  for (const char *word; (word = strtok_r(NULL, " \t", &rest)) != NULL;)
    LOD_TRY(read_option(token, word, where, problem));
  return LOD_OK;
}

static struct lod_token *add(struct lod_tokens *tokens) {
  struct lod_token *list = reallocarray(tokens->list, tokens->count + 1, sizeof *list);
  if (!list)
    return NULL;
  tokens->list = list;
  list[tokens->count] = (struct lod_token){.share = calloc(1, sizeof(struct share))};
  return list[tokens->count].share ? &list[tokens->count++] : NULL;
}

static void take_over_shares(struct lod_tokens *tokens, const struct lod_tokens *before) {
  pthread_mutex_lock(&lock);
  for (size_t i = 0; before && i < tokens->count; i++)
    for (size_t k = 0; k < before->count; k++)
      if (strcmp(tokens->list[i].name, before->list[k].name) == 0)
        *tokens->list[i].share = *before->list[k].share;
  pthread_mutex_unlock(&lock);
}

static enum lod_status read_all(FILE *file, const char *path, struct lod_tokens *tokens, bool *plain, struct lod_problem *problem) {
  char line[LINE_BYTES], where[300];
  for (unsigned number = 1; fgets(line, sizeof line, file); number++) {
    size_t size = strcspn(line, "\r\n");
    snprintf(where, sizeof where, "--token-file: %.200s, line %u", path, number);
    if (line[size] == 0 && !feof(file))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s is too long.", where);
    line[size] = 0;
    if (strspn(line, " \t") == size || *line == '#')
      continue;
    struct lod_token *token = tokens->count < TOKENS_MAX ? add(tokens) : NULL;
    if (!token)
      return lod_fail_memory(problem);
    if (tokens->count == 1 && !strstr(line, "sha256:")) {
      digest_of(line, size, token->digest);
      strcpy(token->name, "token");
      token->rights = LOD_RIGHT_WRITE | LOD_RIGHT_DELETE;
      *plain = true;
      return LOD_OK;
    }
    LOD_TRY(read_line(token, line, where, problem));
  }
  return tokens->count ? LOD_OK : lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--token-file: '%s' holds no token.", path);
}

enum lod_status lod_tokens_read(const char *path, const struct lod_tokens *before, struct lod_tokens **result, bool *plain,
                                struct lod_problem *problem) {
  *result = NULL;
  *plain = false;
  FILE *file = fopen(path, "re");
  if (!file)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--token-file: '%s' cannot be read: %s.", path, strerror(errno));
  struct lod_tokens *tokens = calloc(1, sizeof *tokens);
  enum lod_status status = tokens ? read_all(file, path, tokens, plain, problem) : lod_fail_memory(problem);
  fclose(file);
  if (status != LOD_OK) {
    lod_tokens_destroy(tokens);
    return status;
  }
  take_over_shares(tokens, before);
  *result = tokens;
  return LOD_OK;
}

void lod_tokens_destroy(struct lod_tokens *tokens) {
  for (size_t i = 0; tokens && i < tokens->count; i++) {
    free(tokens->list[i].models);
    free(tokens->list[i].share);
  }
  if (tokens)
    free(tokens->list);
  free(tokens);
}

const struct lod_token *lod_tokens_find(const struct lod_tokens *tokens, const char *authorization) {
  if (!authorization || strncasecmp(authorization, "Bearer ", 7) != 0)
    return NULL;
  authorization += 7;
  authorization += strspn(authorization, " ");
  uint8_t digest[SHA256_DIGEST_SIZE];
  digest_of(authorization, strlen(authorization), digest);
  const struct lod_token *found = NULL;
  for (size_t i = 0; i < tokens->count; i++) /* all of them, whichever it is */
    if (memeql_sec(digest, tokens->list[i].digest, sizeof digest) != 0)
      found = &tokens->list[i];
  return found;
}

const char *lod_token_name(const struct lod_token *token) {
  return token->name;
}

bool lod_token_may(const struct lod_token *token, enum lod_right right, const char *id) {
  if (!(token->rights & right))
    return false;
  if (!token->models)
    return true;
  for (const char *p = token->models; *p;) {
    size_t size = strcspn(p, ",");
    bool open = size > 0 && p[size - 1] == '*';
    if (open ? strncmp(p, id, size - 1) == 0 : strlen(id) == size && strncmp(p, id, size) == 0)
      return true;
    p += size + (p[size] == ',');
  }
  return false;
}

bool lod_token_take_bytes(const struct lod_token *token, uint64_t bytes, double now, unsigned *retry_seconds) {
  if (!token->bytes_per_day)
    return true;
  struct share *share = token->share;
  pthread_mutex_lock(&lock);
  if (share->bytes == 0 || now - share->began >= DAY_SECONDS)
    *share = (struct share){now, 0};
  bool enough = bytes <= token->bytes_per_day && share->bytes <= token->bytes_per_day - bytes;
  if (enough)
    share->bytes += bytes;
  *retry_seconds = (unsigned)(DAY_SECONDS - (now - share->began)) + 1;
  pthread_mutex_unlock(&lock);
  return enough;
}

bool lod_token_make(const char *name, FILE *out) {
  uint8_t secret[32], digest[SHA256_DIGEST_SIZE];
  char token[2 * sizeof secret + 1];
  if (getrandom(secret, sizeof secret, 0) != sizeof secret)
    return false;
  for (size_t i = 0; i < sizeof secret; i++)
    snprintf(token + 2 * i, 3, "%02x", secret[i]);
  digest_of(token, strlen(token), digest);
  fprintf(out, "token, to be given to its holder and kept nowhere else:\n%s\nline for --token-file:\n%s sha256:", token, name);
  for (size_t i = 0; i < sizeof digest; i++)
    fprintf(out, "%02x", digest[i]);
  fputc('\n', out);
  explicit_bzero(secret, sizeof secret);
  explicit_bzero(token, sizeof token);
  return true;
}
