/* What the commands of `lodestream` share: options with help, exit statuses, problems as sentences or JSON, files in. */
#ifndef LOD_CLIENTS_CLI_CLI_H
#define LOD_CLIENTS_CLI_CLI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/import/import.h"
#include "core/base/status.h"
#include "core/mesh/model.h"

enum cli_exit { CLI_DONE = 0, CLI_BAD_INPUT = 1, CLI_USAGE = 2, CLI_LIMIT = 3 };

struct cli_option {
  const char *name;     /* long name without dashes; NULL ends the table */
  char letter;          /* short name, 0 = none */
  const char *argument; /* what --help calls the value; NULL = a switch */
  const char *sentence;
};

struct cli_command {
  const char *name;
  const char *usage;    /* after the command's name: "MODEL -o DIR [options]" */
  const char *sentence; /* one line, for the list */
  const char *text;     /* paragraphs and examples for --help */
  const struct cli_option *options;
  int (*run)(int argc, char **argv);
};

extern const struct cli_command cli_bake, cli_inspect, cli_measure, cli_export, cli_decode, cli_get, cli_refine, cli_check_store,
    cli_worker;

/* Walks the command line of `command`. */
struct cli_arguments {
  const struct cli_command *command;
  int argc;
  char **argv;
  const char *operands[16];
  int operand_count;
  bool json;
  /* internal */
  int next;
};

/* Returns the option met (its table entry) with *value, or NULL at the end. Operands are collected on the way. --json sets json. Prints and
 * exits for --help, --version and whatever is not in the table. */
const struct cli_option *cli_next(struct cli_arguments *arguments, const char **value);

/* Prints a usage error with a pointer to --help; returns CLI_USAGE. */
__attribute__((format(printf, 2, 3))) int cli_usage(const struct cli_command *command, const char *format, ...);

/* Prints the problem (as a sentence to standard error, or with json as an object to standard output) and returns the exit status for it. */
int cli_problem(const struct lod_problem *problem, bool json);

/* Whole numbers and reals, complete and finite; false otherwise. */
bool cli_parse_count(const char *text, uint64_t most, uint64_t *value);
bool cli_parse_real(const char *text, double *value);

/* A file's bytes, mapped read-only ("-" = standard input, read). */
struct cli_file {
  const uint8_t *bytes;
  size_t size;
  bool mapped;
};
LOD_WARN_UNUSED enum lod_status cli_file_open(const char *path, struct cli_file *file, struct lod_problem *problem);
void cli_file_close(struct cli_file *file);

/* Imports a model file; what it refers to is looked for beside it. */
LOD_WARN_UNUSED enum lod_status cli_import(const char *path, const char *format, struct lod_arena *arena, struct lod_model *model,
                                           struct cli_file *file, struct lod_problem *problem);

/* "12.3 kB" and "1 234 567" into `buffer`; returns it. */
const char *cli_bytes(uint64_t bytes, char buffer[32]);
const char *cli_count(uint64_t count, char buffer[32]);

/* A bar on a terminal, nothing elsewhere. */
struct cli_bar {
  bool shown;
  int last_percent;
  double started;
};
struct lod_progress cli_bar_start(struct cli_bar *bar);
void cli_bar_end(struct cli_bar *bar);

#endif
