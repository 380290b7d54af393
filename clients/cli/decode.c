/* lodestream decode: a level, or what deltas make of one, as a client sees it, as PLY. */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/deltas.h"
#include "clients/cli/patches.h"
#include "codec/export/ply.h"
#include "core/mesh/flatten.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"output", 'o', "OUT.ply", "Where the PLY goes; - is standard output. Required."},
    {"delta", 'd', "DELTA", "A step to apply, behind those named before; may be repeated. The same as naming it behind the level."},
    {0},
};

const struct cli_command cli_decode = {
    .name = "decode",
    .usage = "LEVEL.glb | [LEVEL.glb] DELTA... | PATCHES -o OUT.ply",
    .sentence = "Decode a level to PLY: what a client sees, all instances placed.",
    .text = "Deltas are applied to the level one after the other; the first may be a first picture, which needs no level (then the units\n"
            "of a model with instances are not placed, as only a level's GLB says where).\n\n"
            "  lodestream decode levels/objects/3f9a... -o level.ply\n"
            "  lodestream decode families/retile/0.glb families/retile/0.delta.bin families/retile/1.delta.bin -o 2.ply\n"
            "  lodestream decode --delta families/retile/0.delta.bin families/retile/0.glb -o 1.ply",
    .options = kOptions,
    .run = run,
};

static enum lod_status write_ply(const struct lod_mesh *mesh, const char *path, struct lod_problem *problem) {
  bool to_stdout = strcmp(path, "-") == 0;
  FILE *out = to_stdout ? stdout : fopen(path, "wb");
  if (out == NULL)
    return lod_fail(problem, LOD_IO, "write-failed", "Cannot write %s: %s.", path, strerror(errno));
  enum lod_status status = lod_ply_write(mesh, "decoded by lodestream " LOD_VERSION, out, problem);
  if ((to_stdout ? fflush(out) : fclose(out)) != 0 && status == LOD_OK)
    status = lod_fail(problem, LOD_IO, "write-failed", "Cannot write %s: %s.", path, strerror(errno));
  if (status != LOD_OK && !to_stdout)
    unlink(path);
  return status;
}

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_decode, .argc = argc, .argv = argv};
  const char *output = NULL, *value = NULL;
  const char *deltas[sizeof arguments.operands / sizeof *arguments.operands];
  int delta_count = 0;
  const int most = (int)(sizeof deltas / sizeof *deltas);
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (option->letter == 'o')
      output = value;
    else if (delta_count++ < most)
      deltas[delta_count - 1] = value;
  }
  if (arguments.operand_count + delta_count > most)
    return cli_usage(&cli_decode, "expected at most %d files, got %d", most, arguments.operand_count + delta_count);
  for (int i = 0; i < delta_count; i++) /* wherever --delta stands, the level comes first */
    arguments.operands[arguments.operand_count++] = deltas[i];
  if (arguments.operand_count < 1)
    return cli_usage(&cli_decode, "expected LEVEL.glb or DELTA...");
  if (output == NULL)
    return cli_usage(&cli_decode, "-o OUT.ply is missing");
  struct lod_problem problem = {0};
  struct cli_file file = {0};
  struct lod_model model = {0};
  struct lod_mesh mesh;
  double rounding;
  struct lod_arena *arena = lod_arena_create(0);
  const bool curved = cli_is_patches(arguments.operands[0]);
  const int first = curved || cli_is_delta(arguments.operands[0]) ? 0 : 1; /* delta */
  enum lod_status status = arena == NULL ? lod_fail_memory(&problem) : LOD_OK;
  if (status == LOD_OK && curved && arguments.operand_count > 1)
    status = lod_fail(&problem, LOD_BAD_INPUT, "patches", "Patches are decoded by themselves: expected one file.");
  if (status == LOD_OK && curved)
    status = cli_tessellate(arguments.operands[0], arena, &mesh, &problem);
  if (status == LOD_OK && first == 1)
    status = cli_import(arguments.operands[0], NULL, arena, &model, &file, &problem);
  for (int i = first; !curved && status == LOD_OK && i < arguments.operand_count; i++)
    status = cli_apply_deltas(arguments.operands[i], i > 0, &model, arena, &problem);
  if (status == LOD_OK && !curved)
    status = lod_model_flatten(&model, arena, &mesh, &rounding, &problem);
  if (status == LOD_OK)
    status = write_ply(&mesh, output, &problem);
  if (status == LOD_OK && arguments.json)
    fprintf(strcmp(output, "-") == 0 ? stderr : stdout, "{\"vertices\":%u,\"triangles\":%u,\"edges\":%u,\"points\":%u}\n",
            mesh.vertex_count, mesh.triangle_count, mesh.edge_count, mesh.point_count);
  cli_file_close(&file);
  lod_arena_destroy(arena);
  return status == LOD_OK ? CLI_DONE : cli_problem(&problem, arguments.json);
}
