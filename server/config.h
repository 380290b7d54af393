/* Settings of the daemon: defaults, then a file of `key = value` lines, then flags of the same names. Every setting is declared once, in
 * config.c, with its kind, default, limits and sentence; --help prints that table. */
#ifndef LOD_SERVER_CONFIG_H
#define LOD_SERVER_CONFIG_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"

struct lod_config {
  char *store, *listen, *models, *token_file, *tls_cert, *tls_key, *viewer, *worker, *log, *log_level, *cors, *families, *later_families,
      *envelope;    /* "" = not set */
  char *token_name; /* of --make-token; NULL = none */
  uint64_t loops, connections, address_connections, wait_seconds, header_seconds, idle_seconds, rate_seconds, rate_bytes, drain_seconds,
      cached_objects;
  uint64_t store_bytes, upload_bytes, bakes, bake_threads, bake_queue, bake_seconds, bake_memory;
  uint64_t refine_workers, refine_queue, refine_seconds, refine_memory, refine_triangles, refined_bytes;
  uint64_t limit_vertices, limit_triangles, limit_instances, limit_depth, limit_texture_pixels,
      limit_texture_bytes; /* 0 = the worker's default */
};

enum lod_config_action {
  LOD_CONFIG_RUN,
  LOD_CONFIG_HELP,
  LOD_CONFIG_VERSION,
  LOD_CONFIG_CHECK_STORE,  /* --check-store */
  LOD_CONFIG_REPAIR_STORE, /* --repair-store */
  LOD_CONFIG_MAKE_TOKEN,   /* --make-token NAME: in token_name */
};

/* Reads the command line, and the file that --config names. program: path of this program, where the viewer and the worker are looked for.
 * LOD_BAD_INPUT names the flag or the line. `config` is to be finished in any case. */
LOD_WARN_UNUSED enum lod_status lod_config_read(int argc, char *const *argv, const char *program, struct lod_config *config,
                                                enum lod_config_action *action, struct lod_problem *problem);
void lod_config_finish(struct lod_config *config);

/* One `key = value` of a file; name: for messages. Exposed for tests. */
LOD_WARN_UNUSED enum lod_status lod_config_read_text(const char *name, const char *text, struct lod_config *config,
                                                     struct lod_problem *problem);

void lod_config_help(FILE *out);

/* Names of the settings that differ and that a running daemon cannot change, separated by blanks; "" = none. */
void lod_config_fixed_differences(const struct lod_config *a, const struct lod_config *b, char *names, size_t size);

/* 12, 64KiB, 1GiB; false when it is not such a number. */
bool lod_config_parse_bytes(const char *text, uint64_t *value);

/* Import limits that were set, as the worker takes them: {"vertices":1000}; malloc'd, "{}" when none was. NULL: memory. */
char *lod_config_limits_json(const struct lod_config *config);

#endif
