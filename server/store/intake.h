/* Checks a finished bake directory, which a worker that is not trusted has written, before any of it enters the store. */
#ifndef LOD_SERVER_STORE_INTAKE_H
#define LOD_SERVER_STORE_INTAKE_H

#include "server/store/manifest.h"

/* Reads directory_fd/manifest.json and checks that every object it names is a regular file of one name in directory_fd/objects with the
 * size and SHA-256 that it claims; syncs each and makes it read-only. Other files are ignored. On LOD_OK every object's `bytes` is the
 * file's; *objects_fd is the open folder, the caller's to close. */
LOD_WARN_UNUSED enum lod_status lod_intake_check(int directory_fd, const char *id, struct lod_manifest **manifest, int *objects_fd,
                                                 struct lod_problem *problem);

/* SHA-256 of bytes as 64 lower-case hex digits and a NUL. */
void lod_sha256_text(const void *bytes, size_t size, char digest[LOD_SHA256_HEX + 1]);

#endif
