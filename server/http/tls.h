/* The certificate that HTTPS answers with, which can be replaced while the server runs. libmicrohttpd is given a function that fetches the
 * present one for each handshake; what older connections use stays valid. */
#ifndef LOD_SERVER_HTTP_TLS_H
#define LOD_SERVER_HTTP_TLS_H

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>

#include "core/base/status.h"

/* Reads a PEM chain and its private key and makes them the present ones. LOD_BAD_INPUT says what is wrong, and nothing changes. */
LOD_WARN_UNUSED enum lod_status lod_tls_load(const char *certificate_path, const char *key_path, struct lod_problem *problem);
/* Frees all that was ever loaded: no session may be left. */
void lod_tls_finish(void);

/* gnutls_certificate_retrieve_function2. */
int lod_tls_retrieve(gnutls_session_t session, const gnutls_datum_t *authorities, int authority_count,
                     const gnutls_pk_algorithm_t *algorithms, int algorithm_count, gnutls_pcert_st **chain, unsigned *chain_length,
                     gnutls_privkey_t *key);

#endif
