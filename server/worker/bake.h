/* The bake pipeline: import, families, GLB, decode, certify, write. The only place where core and codec meet.
 *
 * Output directory: manifest.json and objects/<sha256>. Objects are written under a temporary name, synced and renamed; the manifest is
 * written last, so a directory with a manifest is whole. */
#ifndef LOD_SERVER_WORKER_BAKE_H
#define LOD_SERVER_WORKER_BAKE_H

#include <stdint.h>

#include "codec/import/import.h"
#include "core/base/parallel.h"
#include "core/base/status.h"

enum { LOD_BAKE_MAX_FAMILIES = 8, LOD_BAKE_MAX_LIST = 64 };

struct lod_bake_request {
  const char *id;     /* model id written to the manifest */
  const char *name;   /* file name, for messages */
  const char *format; /* NULL = sniff */
  const uint8_t *bytes;
  size_t size;
  const struct lod_import_files *files; /* NULL: the model must be self-contained */
  int directory_fd;                     /* output directory, exists */
  const char *families[LOD_BAKE_MAX_FAMILIES];
  uint32_t family_count; /* 0 = the default families */
  uint32_t threads;
  uint64_t max_memory_bytes; /* 0 = no limit */
  struct lod_import_limits limits;
  const struct lod_progress *progress;
};

struct lod_bake_request lod_bake_defaults(void);

LOD_WARN_UNUSED enum lod_status lod_bake_run(const struct lod_bake_request *request, struct lod_problem *problem);

#endif
