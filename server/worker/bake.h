/* The bake pipeline: import, families, GLB, decode, certify, write. The only place where core and codec meet.
 *
 * Output directory: manifest.json and objects/<sha256>. Every file is written under a temporary name, synced and renamed; the manifest is
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
  uint32_t family_count; /* 0 = those that are quick */
  /* Errors to meet, a level each (model units, or shares of the diagonal where epsilon_relative); none = the family's own ladder. */
  double epsilons[LOD_BAKE_MAX_LIST];
  bool epsilon_relative[LOD_BAKE_MAX_LIST];
  uint32_t epsilon_count;
  uint32_t
      vertices[LOD_BAKE_MAX_LIST]; /* vertices of each level of families that can be asked for a number (retile); none = their ladder */
  uint32_t vertices_count;
  const char *retile_options[LOD_BAKE_MAX_LIST]; /* "key=value", retile_recipe.h. Not owned */
  uint32_t retile_option_count;
  const char *envelope_options[LOD_BAKE_MAX_LIST]; /* "key=value", envelope_recipe.h. Not owned */
  uint32_t envelope_option_count;
  uint32_t patches[LOD_BAKE_MAX_LIST]; /* patches of each level of the family clod; none = its ladder of errors */
  uint32_t patches_count;
  bool patches_search; /* clod by the paper's search for patterns (lod_clod_search) instead of by least certified error */
  const char *edges;   /* text of edges that `envelope` keeps (edges.h), edges_size bytes, from file edges_name; or NULL */
  size_t edges_size;
  const char *edges_name;
  uint32_t threads;          /* as lod_parallel_for */
  uint64_t max_memory_bytes; /* of everything the bake allocates itself; 0 = no limit */
  struct lod_import_limits limits;
  const struct lod_progress *progress; /* may be NULL */
};

struct lod_bake_request lod_bake_defaults(void);

/* The families that can be baked, one after the other; NULL behind the last. */
const struct lod_family *lod_bake_family(uint32_t index);

LOD_WARN_UNUSED enum lod_status lod_bake_run(const struct lod_bake_request *request, struct lod_problem *problem);

#endif
