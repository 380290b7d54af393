/* A bake's output directory: objects named by their SHA-256, and the manifest that makes it whole. */
#ifndef LOD_SERVER_WORKER_OUTPUT_H
#define LOD_SERVER_WORKER_OUTPUT_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum { LOD_HASH_HEX = 64 };

void lod_hash_bytes(const void *bytes, size_t size, char hex[LOD_HASH_HEX + 1]);

/* Writes objects/<sha256> beneath directory_fd: temporary name, sync, rename. An object that is already there is left alone. */
LOD_WARN_UNUSED enum lod_status lod_output_object(int directory_fd, const void *bytes, size_t size, char hex[LOD_HASH_HEX + 1],
                                                  struct lod_problem *problem);

/* The same for a file of any name directly in the directory (manifest.json). Replaces an older one atomically. */
LOD_WARN_UNUSED enum lod_status lod_output_file(int directory_fd, const char *name, const void *bytes, size_t size,
                                                struct lod_problem *problem);

#endif
