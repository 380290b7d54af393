/* lodestream: the tool. A thin command line over server/worker, and over HTTP with libcurl. */
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "clients/cli/cli.h"

static const struct cli_command *const kCommands[] = {&cli_bake, &cli_inspect, &cli_measure,     &cli_export, &cli_decode,
                                                      &cli_get,  &cli_refine,  &cli_check_store, &cli_worker};
enum { COMMAND_COUNT = sizeof kCommands / sizeof kCommands[0] };

static void print_overview(FILE *out) {
  fprintf(out, "Usage: lodestream COMMAND ...\n\nProgressive levels of detail with certified errors.\n\nCommands:\n");
  for (int i = 0; i < COMMAND_COUNT; i++)
    fprintf(out, "  %-11s %s\n", kCommands[i]->name, kCommands[i]->sentence);
  fprintf(out, "\nlodestream COMMAND --help explains each. A first try:\n"
               "  lodestream bake model.glb -o levels && lodestream inspect levels\n");
}

static int run(int argc, char **argv) {
  if (argc < 2) {
    print_overview(stderr);
    return CLI_USAGE;
  }
  if (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0 || strcmp(argv[1], "help") == 0) {
    print_overview(stdout);
    return CLI_DONE;
  }
  if (strcmp(argv[1], "--version") == 0) {
    printf("lodestream %s\n", LOD_VERSION);
    return CLI_DONE;
  }
  for (int i = 0; i < COMMAND_COUNT; i++)
    if (strcmp(argv[1], kCommands[i]->name) == 0)
      return kCommands[i]->run(argc - 2, argv + 2);
  fprintf(stderr, "lodestream: there is no command \"%s\"\n\n", argv[1]);
  print_overview(stderr);
  return CLI_USAGE;
}

/* Facts that did not reach their file are no success. */
int main(int argc, char **argv) {
  int status = run(argc, argv);
  if (fflush(stdout) == 0 && !ferror(stdout))
    return status;
  fprintf(stderr, "lodestream: cannot write to standard output: %s\n", strerror(errno));
  return status == CLI_DONE ? CLI_BAD_INPUT : status;
}
