#include "server/http/tls.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { CHAIN_MAX = 16 };

struct identity {
  gnutls_pcert_st chain[CHAIN_MAX];
  unsigned length;
  gnutls_privkey_t key;
  struct identity *older; /* kept: a handshake may still use it, and one is a few kilobytes */
};
static _Atomic(struct identity *) present;

static void free_identity(struct identity *identity) {
  for (unsigned i = 0; i < identity->length; i++)
    gnutls_pcert_deinit(&identity->chain[i]);
  if (identity->key)
    gnutls_privkey_deinit(identity->key);
  free(identity);
}

/* Whether the two belong together: gnutls tells only when both are put into credentials. */
static int check_pair(const char *certificate_path, const char *key_path) {
  gnutls_certificate_credentials_t credentials;
  int code = gnutls_certificate_allocate_credentials(&credentials);
  if (code < 0)
    return code;
  code = gnutls_certificate_set_x509_key_file(credentials, certificate_path, key_path, GNUTLS_X509_FMT_PEM);
  gnutls_certificate_free_credentials(credentials);
  return code < 0 ? code : 0;
}

enum lod_status lod_tls_load(const char *certificate_path, const char *key_path, struct lod_problem *problem) {
  gnutls_datum_t certificate = {NULL, 0}, key = {NULL, 0};
  int code = gnutls_load_file(certificate_path, &certificate);
  if (code < 0)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--tls-cert: '%s' cannot be read: %s", certificate_path, gnutls_strerror(code));
  code = gnutls_load_file(key_path, &key);
  if (code < 0) {
    gnutls_free(certificate.data);
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--tls-key: '%s' cannot be read: %s", key_path, gnutls_strerror(code));
  }
  struct identity *identity = calloc(1, sizeof *identity);
  unsigned length = CHAIN_MAX;
  code = identity ? check_pair(certificate_path, key_path) : GNUTLS_E_MEMORY_ERROR;
  if (code == 0)
    code = gnutls_pcert_list_import_x509_raw(identity->chain, &length, &certificate, GNUTLS_X509_FMT_PEM, 0);
  if (code == 0) {
    identity->length = length;
    code = gnutls_privkey_init(&identity->key);
  }
  if (code == 0)
    code = gnutls_privkey_import_x509_raw(identity->key, &key, GNUTLS_X509_FMT_PEM, NULL, 0);
  gnutls_free(certificate.data);
  explicit_bzero(key.data, key.size);
  gnutls_free(key.data);
  if (code < 0) {
    if (identity)
      free_identity(identity);
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--tls-cert and --tls-key do not hold a PEM certificate and its key: %s",
                    gnutls_strerror(code));
  }
  identity->older = atomic_load(&present);
  atomic_store(&present, identity);
  return LOD_OK;
}

void lod_tls_finish(void) {
  struct identity *identity = atomic_exchange(&present, NULL);
  while (identity) {
    struct identity *older = identity->older;
    free_identity(identity);
    identity = older;
  }
}

int lod_tls_retrieve(gnutls_session_t session, const gnutls_datum_t *authorities, int authority_count,
                     const gnutls_pk_algorithm_t *algorithms, int algorithm_count, gnutls_pcert_st **chain, unsigned *chain_length,
                     gnutls_privkey_t *key) {
  (void)session, (void)authorities, (void)authority_count, (void)algorithms, (void)algorithm_count;
  struct identity *identity = atomic_load(&present);
  if (!identity)
    return -1;
  *chain = identity->chain;
  *chain_length = identity->length;
  *key = identity->key;
  return 0;
}
