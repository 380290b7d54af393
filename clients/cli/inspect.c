/* lodestream inspect: what is in a model file or in a bake. */
#include <errno.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "clients/cli/cli.h"
#include "clients/cli/draw.h"
#include "clients/cli/facts.h"
#include "core/mesh/flatten.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"picture", 'p', "OUT.png", "Draw the model (of a bake: its finest level) into a PNG; needs no graphics card."},
    {"wireframe", 'w', NULL, "Draw the edges of the triangles over the picture."},
    {"kind", 'k', "KIND",
     "What the picture shows: shaded, wireframe, curvature (red high, blue flat), error (each vertex's distance from --source: a sample, "
     "not the "
     "certified bound), points (vertices), tessellation (--vertices points of re-tiling put into the triangles), fragments (of a bake: the "
     "level and "
     "the next finer one, a colour for each coarse triangle)."},
    {"source", 0, "FILE", "The surface that --kind error compares with."},
    {"vertices", 0, "N", "Points of --kind tessellation. Default 400."},
    {"t", 0, "T", "Where between the levels --kind fragments is: 0 = the coarser, 1 = the finer. Default 0.5."},
    {"size", 's', "PIXELS", "Width and height of the picture. Default 800."},
    {"family", 0, "NAME", "Of a bake: the family to draw. Default: the first."},
    {"level", 0, "K", "Of a bake: the level to draw. Default: the finest."},
    {0},
};

const struct cli_command cli_inspect = {
    .name = "inspect",
    .usage = "MODEL|DIR [options]",
    .sentence = "Show what is in a model file or in a bake, as text, JSON or a picture.",
    .text = "  lodestream inspect bunny.ply --picture bunny.png --wireframe\n"
            "  lodestream inspect bunny --level 3 --picture level3.png\n"
            "  lodestream inspect bunny --level 3 --picture error.png --kind error --source bunny.ply\n"
            "  lodestream inspect bunny --family retile --level 1 --picture fragments.png --kind fragments --t 0",
    .options = kOptions,
    .run = run,
};

struct request {
  const char *path, *picture, *family;
  const char *source;
  bool json, has_level;
  uint32_t level;
  struct cli_drawing drawing;
};

/* Draws the model; finer: what fragments lead to, or NULL. */
static enum lod_status draw(const struct request *request, const struct lod_model *model, const struct lod_model *finer,
                            struct lod_arena *arena, struct lod_problem *problem) {
  struct cli_drawing drawing = request->drawing;
  struct cli_file file = {0};
  struct lod_model source = {0};
  drawing.path = request->picture;
  drawing.source = finer;
  if (drawing.kind == LOD_PICTURE_FRAGMENTS && finer == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "no-finer-level",
                    "A picture of fragments shows a level of a bake and the next finer one; %s is a model, or its level is the finest.",
                    request->path);
  if (drawing.kind == LOD_PICTURE_ERROR && request->source != NULL) {
    LOD_TRY(cli_import(request->source, NULL, arena, &source, &file, problem));
    drawing.source = &source;
  }
  enum lod_status status = cli_draw_model(model, &drawing, arena, problem);
  if (drawing.source == &source)
    cli_file_close(&file);
  return status;
}

static enum lod_status inspect_model(const struct request *request, struct lod_arena *arena, struct lod_problem *problem) {
  struct cli_file file;
  struct lod_model model = {0};
  LOD_TRY(cli_import(request->path, NULL, arena, &model, &file, problem));
  struct lod_topology total = {.closed = true};
  json_t *units = json_array();
  enum lod_status status = LOD_OK;
  for (uint32_t u = 0; u < model.unit_count && status == LOD_OK; u++) {
    struct lod_topology topology;
    status = lod_topology_measure(&model.units[u].mesh, NULL, arena, &topology);
    if (u == 0)
      total = topology;
    json_array_append_new(units, cli_topology_json(&topology));
  }
  struct lod_bounds bounds = lod_model_bounds(&model);
  if (status != LOD_OK)
    status = lod_fail_memory(problem);
  else if (request->picture != NULL)
    status = draw(request, &model, NULL, arena, problem);
  if (status != LOD_OK) {
    /* facts and a problem are never printed both */
  } else if (request->json) {
    json_t *warnings = json_array();
    for (uint32_t i = 0; i < model.warning_count; i++)
      json_array_append_new(warnings, json_string(model.warnings[i]));
    json_t *json = json_pack("{ss sI sI si si si si sf so so}", "format", model.format, "vertices", (json_int_t)model.source_vertices,
                             "triangles", (json_int_t)model.source_triangles, "parts", (int)model.part_count, "materials",
                             (int)model.material_count, "textures", (int)model.texture_count, "images", (int)model.image_count, "diagonal",
                             lod_bounds_diagonal(&bounds), "units", units, "warnings", warnings);
    units = NULL;
    json_dumpf(json, stdout, JSON_COMPACT | JSON_REAL_PRECISION(9));
    printf("\n");
    json_decref(json);
  } else {
    char a[32], b[32], c[32];
    printf("%s: %s, %s, %s vertices and %s triangles in the file\n", request->path, model.format, cli_bytes(file.size, a),
           cli_count(model.source_vertices, b), cli_count(model.source_triangles, c));
    printf("  %u parts, %u materials, %u textures, diagonal %.6g\n", model.part_count, model.material_count, model.texture_count,
           lod_bounds_diagonal(&bounds));
    cli_print_topology(&total);
    if (model.unit_count > 1)
      printf("  and %u parts that occur several times\n", model.unit_count - 1);
    for (uint32_t i = 0; i < model.warning_count; i++)
      printf("  warning: %s\n", model.warnings[i]);
  }
  json_decref(units);
  cli_file_close(&file);
  return status;
}

static void print_levels(const json_t *manifest) {
  const char *name;
  json_t *family;
  double diagonal = json_number_value(json_object_get(json_object_get(manifest, "source"), "diagonal"));
  json_object_foreach(json_object_get(manifest, "families"), name, family) {
    printf("%s\n  level  triangles    edges   points  vertices         error  %% of diagonal       bytes\n", name);
    size_t i;
    json_t *level;
    json_array_foreach(json_object_get(family, "levels"), i, level) {
      char t[32], e[32], p[32], v[32], b[32];
      double error = json_number_value(json_object_get(level, "error"));
      printf("  %5zu %10s %8s %8s %9s  %12.6g  %13.4f  %10s\n", i,
             cli_count((uint64_t)json_integer_value(json_object_get(level, "triangles")), t),
             cli_count((uint64_t)json_integer_value(json_object_get(level, "edges")), e),
             cli_count((uint64_t)json_integer_value(json_object_get(level, "points")), p),
             cli_count((uint64_t)json_integer_value(json_object_get(level, "vertices")), v), error, 100 * error / diagonal,
             cli_bytes((uint64_t)json_integer_value(json_object_get(level, "bytes")), b));
    }
  }
}

static enum lod_status draw_level(const struct request *request, const json_t *manifest, struct lod_arena *arena,
                                  struct lod_problem *problem) {
  json_t *families = json_object_get(manifest, "families");
  const char *name = request->family != NULL ? request->family : json_object_iter_key(json_object_iter(families));
  json_t *levels = name == NULL ? NULL : json_object_get(json_object_get(families, name), "levels");
  size_t count = json_array_size(levels);
  size_t index = request->has_level ? request->level : count - 1;
  if (count == 0 || index >= count)
    return lod_fail(problem, LOD_BAD_INPUT, "no-such-level", "%s: family %s has no level %zu; it has %zu levels.", request->path,
                    name == NULL ? "(none)" : name, index, count);
  struct cli_file files[2];
  struct lod_model models[2] = {{0}};
  uint32_t wanted = request->drawing.kind == LOD_PICTURE_FRAGMENTS && index + 1 < count ? 2 : 1, opened = 0;
  enum lod_status status = LOD_OK;
  for (; opened < wanted && status == LOD_OK; opened++) {
    char path[4200];
    const char *object = json_string_value(json_object_get(json_array_get(levels, index + opened), "object"));
    snprintf(path, sizeof path, "%s/objects/%s", request->path, object);
    status = cli_import(path, "glb", arena, &models[opened], &files[opened], problem);
    if (status != LOD_OK)
      break;
  }
  struct request with = *request;
  for (size_t i = index; i < index + wanted; i++) /* decoded positions are off by less than the errors, which count quantisation */
    with.drawing.reach += json_number_value(json_object_get(json_array_get(levels, i), "error"));
  if (status == LOD_OK)
    status = draw(&with, &models[0], wanted == 2 ? &models[1] : NULL, arena, problem);
  while (opened > 0)
    cli_file_close(&files[--opened]);
  return status;
}

static enum lod_status inspect_bake(const struct request *request, struct lod_arena *arena, struct lod_problem *problem) {
  char path[4200];
  snprintf(path, sizeof path, "%s/manifest.json", request->path);
  json_error_t error;
  json_t *manifest = json_load_file(path, 0, &error);
  if (manifest == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "no-manifest", "%s is no bake: %s, line %d: %s.", request->path, path, error.line, error.text);
  enum lod_status status = request->picture != NULL ? draw_level(request, manifest, arena, problem) : LOD_OK;
  if (status != LOD_OK) {
    /* facts and a problem are never printed both */
  } else if (request->json) {
    json_dumpf(manifest, stdout, JSON_COMPACT | JSON_REAL_PRECISION(9));
    printf("\n");
  } else {
    const json_t *source = json_object_get(manifest, "source");
    char a[32], b[32];
    printf("%s: %s from %s, %s vertices, %s triangles, diagonal %.6g\n", request->path, json_string_value(json_object_get(manifest, "id")),
           json_string_value(json_object_get(source, "name")),
           cli_count((uint64_t)json_integer_value(json_object_get(source, "vertices")), a),
           cli_count((uint64_t)json_integer_value(json_object_get(source, "triangles")), b),
           json_number_value(json_object_get(source, "diagonal")));
    print_levels(manifest);
    size_t i;
    json_t *warning;
    json_array_foreach(json_object_get(json_object_get(manifest, "bake"), "warnings"), i, warning)
        printf("warning: %s\n", json_string_value(warning));
  }
  json_decref(manifest);
  return status;
}

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_inspect, .argc = argc, .argv = argv};
  struct request request = {.drawing = {.size = 800, .t = 0.5, .vertices = 400}};
  const char *value = NULL;
  uint64_t number;
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (strcmp(option->name, "picture") == 0) {
      request.picture = value;
    } else if (strcmp(option->name, "wireframe") == 0) {
      request.drawing.kind = LOD_PICTURE_WIREFRAME;
    } else if (strcmp(option->name, "kind") == 0) {
      uint32_t kind = 0;
      while (lod_picture_kind_name(kind) != NULL && strcmp(lod_picture_kind_name(kind), value) != 0)
        kind++;
      if (lod_picture_kind_name(kind) == NULL)
        return cli_usage(&cli_inspect, "--kind %s: expected shaded, wireframe, curvature, error, points, tessellation or fragments", value);
      request.drawing.kind = (enum lod_picture_kind)kind;
    } else if (strcmp(option->name, "source") == 0) {
      request.source = value;
    } else if (strcmp(option->name, "vertices") == 0) {
      if (!cli_parse_count(value, 10000000, &number) || number < 4)
        return cli_usage(&cli_inspect, "--vertices %s: expected a whole number of at least 4", value);
      request.drawing.vertices = (uint32_t)number;
    } else if (strcmp(option->name, "t") == 0) {
      if (!cli_parse_real(value, &request.drawing.t) || request.drawing.t < 0 || request.drawing.t > 1)
        return cli_usage(&cli_inspect, "--t %s: expected a number from 0 to 1", value);
    } else if (strcmp(option->name, "family") == 0) {
      request.family = value;
    } else if (strcmp(option->name, "size") == 0) {
      if (!cli_parse_count(value, 8192, &number) || number < 16)
        return cli_usage(&cli_inspect, "--size %s: expected 16 to 8192 pixels", value);
      request.drawing.size = (uint32_t)number;
    } else if (strcmp(option->name, "level") == 0) {
      if (!cli_parse_count(value, UINT32_MAX, &number))
        return cli_usage(&cli_inspect, "--level %s: expected a whole number", value);
      request.level = (uint32_t)number;
      request.has_level = true;
    }
  }
  if (arguments.operand_count != 1)
    return cli_usage(&cli_inspect, "expected one MODEL or DIR, got %d", arguments.operand_count);
  if (request.drawing.kind == LOD_PICTURE_ERROR && request.source == NULL)
    return cli_usage(&cli_inspect, "--kind error needs --source FILE to compare with");
  request.path = arguments.operands[0];
  request.json = arguments.json;
  struct stat st;
  bool is_directory = stat(request.path, &st) == 0 && S_ISDIR(st.st_mode);
  struct lod_problem problem = {0};
  struct lod_arena *arena = lod_arena_create(0);
  enum lod_status status = arena == NULL  ? lod_fail_memory(&problem)
                           : is_directory ? inspect_bake(&request, arena, &problem)
                                          : inspect_model(&request, arena, &problem);
  lod_arena_destroy(arena);
  return status == LOD_OK ? CLI_DONE : cli_problem(&problem, request.json);
}
