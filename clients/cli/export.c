/* lodestream export: a bake as files for others. */
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "codec/export/tree.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"output", 'o', "OUT", "The folder to make; it must not exist or be empty. Required."},
    {"format", 'f', "NAME", "static (default): every level, a page, the manifest. 3dtiles: tileset.json. gltf: model.gltf with MSFT_lod."},
    {"viewer", 0, "DIR", "The viewer's files, to be copied beside."},
    {0},
};

const struct cli_command cli_export = {
    .name = "export",
    .usage = "DIR -o OUT --format static|3dtiles|gltf",
    .sentence = "Turn a bake into a tree of files that any file server can serve.",
    .text = "  lodestream bake bunny.ply -o bunny && lodestream export bunny -o site --format static\n"
            "  lodestream export bunny -o tiles --format 3dtiles     for CesiumJS and other readers of 3D Tiles 1.1\n"
            "A tileset's geometric errors are the certified ones. OUT appears whole or not at all.",
    .options = kOptions,
    .run = run,
};

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_export, .argc = argc, .argv = argv};
  static const char *const kFormats[] = {[LOD_EXPORT_STATIC] = "static", [LOD_EXPORT_TILES] = "3dtiles", [LOD_EXPORT_GLTF] = "gltf"};
  enum { FORMAT_COUNT = sizeof kFormats / sizeof kFormats[0] };
  unsigned format = LOD_EXPORT_STATIC;
  const char *output = NULL, *viewer = NULL, *value = NULL;
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (strcmp(option->name, "output") == 0)
      output = value;
    else if (strcmp(option->name, "viewer") == 0)
      viewer = value;
    else if (strcmp(option->name, "format") == 0) {
      for (format = 0; format < FORMAT_COUNT && strcmp(value, kFormats[format]) != 0;)
        format++;
      if (format == FORMAT_COUNT)
        return cli_usage(&cli_export, "--format %s: expected static, 3dtiles or gltf", value);
    }
  }
  if (viewer != NULL && format != LOD_EXPORT_STATIC)
    return cli_usage(&cli_export, "--viewer goes with --format static");
  if (arguments.operand_count != 1)
    return cli_usage(&cli_export, "expected one bake's DIR, got %d", arguments.operand_count);
  if (output == NULL)
    return cli_usage(&cli_export, "-o OUT is missing");
  struct lod_problem problem = {0};
  int directory_fd = open(arguments.operands[0], O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  enum lod_status status = directory_fd >= 0
                               ? lod_export_tree(directory_fd, (enum lod_export_format)format, output, viewer, &problem)
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
