/* lodestream export: a bake as files for others. */
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "codec/export/static.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"output", 'o', "OUT", "The folder to make; it must not exist or be empty. Required."},
    {"format", 'f', "NAME", "static (default): a tree that any file server can serve."},
    {"viewer", 0, "DIR", "The viewer's files, to be copied beside."},
    {0},
};

const struct cli_command cli_export = {
    .name = "export",
    .usage = "DIR -o OUT --format static",
    .sentence = "Turn a bake into a tree that any file server can serve.",
    .text = "  lodestream bake bunny.ply -o bunny && lodestream export bunny -o site --format static\n"
            "OUT appears whole or not at all.",
    .options = kOptions,
    .run = run,
};

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_export, .argc = argc, .argv = argv};
  const char *output = NULL, *viewer = NULL, *value = NULL;
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (strcmp(option->name, "output") == 0)
      output = value;
    else if (strcmp(option->name, "viewer") == 0)
      viewer = value;
    else if (strcmp(option->name, "format") == 0 && strcmp(value, "static") != 0)
      return cli_usage(&cli_export, "--format %s: this version writes static", value);
  }
  if (arguments.operand_count != 1)
    return cli_usage(&cli_export, "expected one bake's DIR, got %d", arguments.operand_count);
  if (output == NULL)
    return cli_usage(&cli_export, "-o OUT is missing");
  struct lod_problem problem = {0};
  int directory_fd = open(arguments.operands[0], O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  enum lod_status status = directory_fd >= 0
                               ? lod_export_static(directory_fd, output, viewer, &problem)
                               : lod_fail(&problem, LOD_IO, "cannot-open", "Cannot open %s: %s.", arguments.operands[0], strerror(errno));
  if (directory_fd >= 0)
    close(directory_fd);
  if (status != LOD_OK)
    return cli_problem(&problem, arguments.json);
  if (arguments.json) {
    json_t *json = json_pack("{ss}", "output", output);
    json_dumpf(json, stdout, JSON_COMPACT);
    printf("\n");
    json_decref(json);
  }
  return CLI_DONE;
}
