/* lodestream bake: a model file in, a directory of certified levels out. */
#include "server/worker/bake.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/leftovers.h"
#include "core/level/hierarchy.h"
#include "server/worker/envelope_recipe.h"
#include "server/worker/retile_recipe.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"output", 'o', "DIR", "Where manifest.json and objects/ go; made when it is not there. Required."},
    {"family", 'f', "NAME", "A family of levels to bake; may be given several times. Default: cluster."},
    {"epsilon", 'e', "X|X%",
     "An error to meet in as few bytes as can be, in model units or in percent of the diagonal; may be repeated. Default: a ladder."},
    {"vertices", 0, "N,N,...", "Vertices of each level of families that can be asked for a number: retile. Default: a ladder."},
    {"retile", 0, "KEY=VALUE",
     "How retile works; may be repeated: mode=turk (the paper's own), placement=elimination|turk, curvature=tensor|turk|none,\n"
     "measure=cost|length|angle, projection=polar|planes, and by number adapt, anisotropy, lead, settle, prune, steps, damping, radius,\n"
     "flips, crease, corner (degrees), seed, and of the ladder ratio, least, finest (error in percent of the diagonal; 0.02)."},
    {"envelope", 0, "KEY=VALUE",
     "How envelope works; may be repeated: nested=1 (vertices of levels are vertices of finer ones, with deltas), guard=all|closed|none\n"
     "(where faces must not newly cross), rms (most of the mean error, a share of the greatest), and what attributes may be off by:\n"
     "slip (of textures, in errors of the level; 1), texels, degrees (of normals; 60), color; 0 = no bound."},
    {"edges", 0, "FILE", "Edges that the family envelope keeps: a line each, x y z of both ends. codec/FORMAT.md, section 8."},
    {"format", 0, "NAME", "The file's format, where its content does not tell."},
    {"id", 0, "ID", "The model's id in the manifest. Default: the file's name without its ending."},
    {"jobs", 'j', "N", "Threads; results do not depend on it. Default: as many as the machine has."},
    {"max-bytes", 0, "N", "Refuse files larger than this, with all that they refer to; 0, here and below: the most that is possible."},
    {"patches", 0, "N,N,...", "Patches of each level of the family clod. Default: a ladder of errors."},
    {"patterns", 0, NULL, "The family clod merges patterns found depth first, as its paper does, instead of by least certified error."},
    {"max-vertices", 0, "N", "Refuse models with more vertices."},
    {"max-triangles", 0, "N", "Refuse models with more triangles."},
    {"max-instances", 0, "N", "Refuse models with more placed parts."},
    {"max-depth", 0, "N", "Refuse node trees deeper than this."},
    {"max-texture-pixels", 0, "N", "Refuse textures wider or higher than this."},
    {"max-texture-bytes", 0, "N", "Refuse encoded textures larger than this."},
    {"max-memory", 0, "N", "Stop when the bake itself holds more bytes than this. Default: no limit."},
    {0},
};

const struct cli_command cli_bake = {
    .name = "bake",
    .usage = "MODEL -o DIR [options]",
    .sentence = "Make levels of detail with certified errors from a model file.",
    .text = "MODEL is glTF, GLB, PLY, STL, OBJ, OFF or anything assimp reads; its content tells which. Files that it refers to\n"
            "are looked for beside it and never elsewhere. DIR gets manifest.json and objects/<sha256>; the manifest is\n"
            "written last, so a directory with a manifest is whole.\n\n"
            "  lodestream bake bunny.ply -o bunny\n"
            "  lodestream bake engine.glb -o engine --family cluster --epsilon 0.5% --epsilon 2%\n"
            "  lodestream bake bunny.ply -o bunny --family retile --vertices 200,800,3200\n"
            "  lodestream bake bunny.ply -o bunny --family retile --vertices 800 --retile mode=turk",
    .options = kOptions,
    .run = run,
};

static bool parse_epsilon(const char *text, double *value, bool *relative) {
  char number[64];
  size_t length = strlen(text);
  *relative = length > 0 && text[length - 1] == '%';
  if (length == 0 || length >= sizeof number)
    return false;
  memcpy(number, text, length + 1);
  if (*relative)
    number[length - 1] = '\0';
  if (!cli_parse_real(number, value) || *value < 0)
    return false;
  if (*relative)
    *value /= 100;
  return true;
}

static int add_family(struct lod_bake_request *request, const char *name) {
  char names[256] = "";
  const struct lod_family *family;
  for (uint32_t i = 0; (family = lod_bake_family(i)) != NULL; i++) {
    if (strcmp(family->name, name) == 0) {
      if (request->family_count == LOD_BAKE_MAX_FAMILIES)
        return cli_usage(&cli_bake, "--family was given more than %d times", LOD_BAKE_MAX_FAMILIES);
      request->families[request->family_count++] = name;
      return CLI_DONE;
    }
    size_t length = strlen(names);
    snprintf(names + length, sizeof names - length, "%s%s", i == 0 ? "" : ", ", family->name);
  }
  return cli_usage(&cli_bake, "--family %s: this version bakes %s", name, names);
}

/* "200,800,3200" */
static bool parse_list(const char *text, uint32_t *numbers, uint32_t *count) {
  char list[1024];
  if (strlen(text) >= sizeof list)
    return false;
  strcpy(list, text);
  for (char *word = list, *next; word != NULL; word = next) {
    next = strchr(word, ',');
    if (next != NULL)
      *next++ = '\0';
    uint64_t number;
    if (*count == LOD_BAKE_MAX_LIST || !cli_parse_count(word, UINT32_MAX - 1, &number) || number == 0)
      return false;
    numbers[(*count)++] = (uint32_t)number;
  }
  return true;
}

/* One option into the request; CLI_DONE or the exit status. */
static int apply_option(struct lod_bake_request *request, const struct cli_option *option, const char *value, const char **output) {
  const struct {
    const char *name;
    uint64_t most;
    uint64_t *wide;
    uint32_t *narrow;
  } counts[] = {
      {"jobs", 1024, NULL, &request->threads},
      {"max-bytes", UINT64_MAX, &request->limits.max_bytes, NULL},
      {"max-vertices", UINT64_MAX, &request->limits.max_vertices, NULL},
      {"max-triangles", UINT64_MAX, &request->limits.max_triangles, NULL},
      {"max-instances", UINT32_MAX, NULL, &request->limits.max_instances},
      {"max-depth", UINT32_MAX, NULL, &request->limits.max_depth},
      {"max-texture-pixels", UINT32_MAX, NULL, &request->limits.max_texture_pixels},
      {"max-texture-bytes", UINT64_MAX, &request->limits.max_texture_bytes, NULL},
      {"max-memory", UINT64_MAX, &request->max_memory_bytes, NULL},
  };
  for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
    if (strcmp(option->name, counts[i].name) != 0)
      continue;
    uint64_t number;
    if (!cli_parse_count(value, counts[i].most, &number))
      return counts[i].most == UINT64_MAX ? cli_usage(&cli_bake, "--%s %s: expected a whole number", option->name, value)
                                          : cli_usage(&cli_bake, "--%s %s: expected a whole number up to %llu", option->name, value,
                                                      (unsigned long long)counts[i].most);
    if (counts[i].wide != NULL)
      *counts[i].wide = number;
    else
      *counts[i].narrow = (uint32_t)number;
    return CLI_DONE;
  }
  if (strcmp(option->name, "output") == 0) {
    *output = value;
  } else if (strcmp(option->name, "family") == 0) {
    return add_family(request, value);
  } else if (strcmp(option->name, "epsilon") == 0) {
    if (request->epsilon_count == LOD_BAKE_MAX_LIST)
      return cli_usage(&cli_bake, "--epsilon was given more than %d times", LOD_BAKE_MAX_LIST);
    uint32_t i = request->epsilon_count++;
    if (!parse_epsilon(value, &request->epsilons[i], &request->epsilon_relative[i]))
      return cli_usage(&cli_bake,
                       "--epsilon %s: expected a number of model units or a percentage of the diagonal, 0 or more, such as 0.25%%", value);
  } else if (strcmp(option->name, "vertices") == 0) {
    if (!parse_list(value, request->vertices, &request->vertices_count))
      return cli_usage(&cli_bake, "--vertices %s: expected at most %d whole numbers above 0, such as 200,800,3200", value,
                       LOD_BAKE_MAX_LIST);
  } else if (strcmp(option->name, "retile") == 0) {
    struct lod_retile_settings ignored = lod_retile_defaults();
    struct lod_problem problem = {0};
    if (request->retile_option_count == LOD_BAKE_MAX_LIST)
      return cli_usage(&cli_bake, "--retile was given more than %d times", LOD_BAKE_MAX_LIST);
    if (lod_retile_recipe_option(value, &ignored, &problem) != LOD_OK)
      return cli_usage(&cli_bake, "--retile %s", problem.detail);
    request->retile_options[request->retile_option_count++] = value;
  } else if (strcmp(option->name, "envelope") == 0) {
    struct lod_envelope_options ignored = lod_envelope_options_defaults();
    struct lod_problem problem = {0};
    if (request->envelope_option_count == LOD_BAKE_MAX_LIST)
      return cli_usage(&cli_bake, "--envelope was given more than %d times", LOD_BAKE_MAX_LIST);
    if (lod_envelope_recipe_option(value, &ignored, &problem) != LOD_OK)
      return cli_usage(&cli_bake, "--envelope %s", problem.detail);
    request->envelope_options[request->envelope_option_count++] = value;
  } else if (strcmp(option->name, "patches") == 0) {
    if (!parse_list(value, request->patches, &request->patches_count))
      return cli_usage(&cli_bake, "--patches %s: expected at most %d whole numbers above 0, such as 200,800,3200", value,
                       LOD_BAKE_MAX_LIST);
  } else if (strcmp(option->name, "patterns") == 0) {
    request->patches_search = true;
  } else if (strcmp(option->name, "edges") == 0) {
    request->edges_name = value;
  } else if (strcmp(option->name, "format") == 0) {
    request->format = value;
  } else if (strcmp(option->name, "id") == 0) {
    request->id = value;
  }
  return CLI_DONE;
}

static void print_summary(int directory_fd, const char *directory, bool json) {
  int fd = openat(directory_fd, "manifest.json", O_RDONLY | O_CLOEXEC);
  json_t *manifest = fd < 0 ? NULL : json_loadfd(fd, 0, NULL);
  if (fd >= 0)
    close(fd);
  if (manifest == NULL)
    return;
  if (json) {
    json_dumpf(manifest, stdout, JSON_COMPACT | JSON_REAL_PRECISION(9));
    printf("\n");
  } else {
    const char *name;
    json_t *family;
    json_object_foreach(json_object_get(manifest, "families"), name, family) {
      printf("%s: %zu levels in %.2f s -> %s\n", name, json_array_size(json_object_get(family, "levels")),
             json_real_value(json_object_get(json_object_get(manifest, "bake"), "seconds")), directory);
    }
    size_t i;
    json_t *warning;
    json_array_foreach(json_object_get(json_object_get(manifest, "bake"), "warnings"), i, warning)
        printf("warning: %s\n", json_string_value(warning));
  }
  json_decref(manifest);
}

static int bake_file(struct lod_bake_request *request, const char *path, const char *output, bool json) {
  struct lod_problem problem = {0};
  struct cli_file file, edges = {0};
  if (cli_file_open(path, &file, &problem) != LOD_OK)
    return cli_problem(&problem, json);
  if (request->edges_name != NULL && cli_file_open(request->edges_name, &edges, &problem) != LOD_OK) {
    cli_file_close(&file);
    return cli_problem(&problem, json);
  }
  if (request->edges_name != NULL) {
    request->edges = edges.size == 0 ? "" : (const char *)edges.bytes;
    request->edges_size = edges.size;
  }
  bool made = mkdir(output, 0755) == 0;
  if (!made && errno != EEXIST) {
    lod_fail(&problem, LOD_IO, "cannot-open", "Cannot make the output directory %s: %s.", output, strerror(errno));
    cli_file_close(&file);
    if (request->edges_name != NULL)
      cli_file_close(&edges);
    return cli_problem(&problem, json);
  }
  const char *slash = strrchr(path, '/');
  const char *base = slash != NULL ? slash + 1 : strcmp(path, "-") == 0 ? "stdin" : path;
  char parent[4096] = ".", id[256];
  if (slash != NULL)
    snprintf(parent, sizeof parent, "%.*s", slash == path ? 1 : (int)(slash - path), path);
  const char *dot = strrchr(base, '.');
  snprintf(id, sizeof id, "%.*s", dot == NULL || dot == base ? (int)strlen(base) : (int)(dot - base), base);
  int parent_fd = open(parent, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  struct lod_import_files files = lod_import_files_beneath(&parent_fd);
  struct cli_bar bar;
  struct lod_progress progress = cli_bar_start(&bar);
  request->bytes = file.bytes;
  request->size = file.size;
  request->name = base;
  if (request->id == NULL)
    request->id = id;
  request->files = parent_fd >= 0 ? &files : NULL;
  request->progress = &progress;
  request->directory_fd = open(output, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  int exit_status;
  if (request->directory_fd < 0)
    lod_fail(&problem, LOD_IO, "cannot-open", "Cannot open the output directory %s: %s.", output, strerror(errno));
  json_t *before = cli_named_objects(request->directory_fd);
  if (request->directory_fd < 0 || lod_bake_run(request, &problem) != LOD_OK) {
    cli_bar_end(&bar);
    exit_status = cli_problem(&problem, json);
  } else {
    cli_bar_end(&bar);
    cli_remove_leftovers(request->directory_fd, before);
    print_summary(request->directory_fd, output, json);
    exit_status = CLI_DONE;
  }
  json_decref(before);
  if (request->directory_fd >= 0)
    close(request->directory_fd);
  if (parent_fd >= 0)
    close(parent_fd);
  if (exit_status != CLI_DONE && made)
    rmdir(output); /* unless something is in it */
  cli_file_close(&file);
  if (request->edges_name != NULL)
    cli_file_close(&edges);
  return exit_status;
}

/* Options that only one family reads, where it is not asked for: somebody expects them to do something. */
static int check_families(const struct lod_bake_request *request) {
  const struct {
    bool given;
    const char *option, *family;
  } owned[] = {
      {request->vertices_count > 0, "vertices", "retile"},
      {request->retile_option_count > 0, "retile", "retile"},
      {request->envelope_option_count > 0, "envelope", "envelope"},
      {request->edges_name != NULL, "edges", "envelope"},
      {request->patches_count > 0, "patches", "clod"},
      {request->patches_search, "patterns", "clod"},
  };
  for (size_t i = 0; i < sizeof owned / sizeof owned[0]; i++) {
    bool asked = !owned[i].given;
    for (uint32_t f = 0; f < request->family_count; f++)
      asked = asked || strcmp(request->families[f], owned[i].family) == 0;
    if (!asked)
      return cli_usage(&cli_bake, "--%s is for the family %s, which is not baked: add --family %s", owned[i].option, owned[i].family,
                       owned[i].family);
  }
  return CLI_DONE;
}

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_bake, .argc = argc, .argv = argv};
  struct lod_bake_request request = lod_bake_defaults();
  request.id = NULL;
  const char *output = NULL, *value = NULL;
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    int status = apply_option(&request, option, value, &output);
    if (status != CLI_DONE)
      return status;
  }
  if (arguments.operand_count != 1)
    return cli_usage(&cli_bake, "expected one MODEL, got %d", arguments.operand_count);
  if (output == NULL)
    return cli_usage(&cli_bake, "-o DIR is missing: where shall the levels go?");
  int status = check_families(&request);
  return status != CLI_DONE ? status : bake_file(&request, arguments.operands[0], output, arguments.json);
}
