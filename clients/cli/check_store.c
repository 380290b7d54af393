/* lodestream check-store: has the daemon's program check a store. The tool itself has neither database nor store. */
#include "clients/cli/cli.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"repair", 0, NULL, "Mend what can be mended: damaged objects go to lost+found/, models that cannot be served whole are removed."},
    {0},
};

const struct cli_command cli_check_store = {
    .name = "check-store",
    .usage = "DIR [--repair]",
    .sentence = "Check a daemon's store, object by object.",
    .text =
        "Reads every object and compares it with the SHA-256 that names it, checks the catalogue, every manifest and every waiting\n"
        "upload, and looks for files that nothing names. No daemon may hold the store meanwhile. Runs lodestreamd --check-store, which\n"
        "is looked for beside this program.",
    .options = kOptions,
    .run = run,
};

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_check_store, .argc = argc, .argv = argv};
  const char *value, *action = "--check-store";
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;)
    if (strcmp(option->name, "repair") == 0)
      action = "--repair-store";
  if (arguments.operand_count != 1)
    return cli_usage(&cli_check_store, "expected one DIR, got %d", arguments.operand_count);
  char path[4096 + 16];
  ssize_t size = readlink("/proc/self/exe", path, 4096);
  path[size > 0 ? size : 0] = 0;
  char *slash = strrchr(path, '/');
  strcpy(slash != NULL ? slash + 1 : path, "lodestreamd");
  fflush(stdout);
  execl(path, path, action, "--store", arguments.operands[0], (char *)NULL);
  fprintf(stderr, "lodestream: cannot run %s: %s\n", path, strerror(errno));
  return CLI_BAD_INPUT;
}
