/* lodestream measure: the certified distance between two models, and the topology of both. */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "clients/cli/cli.h"
#include "clients/cli/facts.h"
#include "core/mesh/distance.h"
#include "core/mesh/flatten.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"relative", 0, "R", "Stop when the interval is narrower than this share of its lower end. Default 0.01."},
    {"jobs", 'j', "N", "Threads; results do not depend on it. Default: as many as the machine has."},
    {"topology-only", 0, NULL, "Do not measure distances."},
    {0},
};

const struct cli_command cli_measure = {
    .name = "measure",
    .usage = "A B [options]",
    .sentence = "Certified two-sided Hausdorff distance between two models, RMS, and topology of both.",
    .text = "Prints {\"lower\":..,\"upper\":..,\"rms\":..,\"diagonal\":..,\"a\":{..},\"b\":{..}} with --json. The distance lies in\n"
            "[lower, upper], proven by branch and bound; rms is sampled. diagonal is that of A's bounding box.",
    .options = kOptions,
    .run = run,
};

struct side {
  struct cli_file file;
  struct lod_model model;
  struct lod_mesh mesh; /* all instances, welded */
  double rounding;
  struct lod_topology topology;
};

static enum lod_status load(const char *path, struct lod_arena *arena, struct side *side, struct lod_problem *problem) {
  LOD_TRY(cli_import(path, NULL, arena, &side->model, &side->file, problem));
  struct lod_mesh flat;
  LOD_TRY(lod_model_flatten(&side->model, arena, &flat, &side->rounding, problem));
  flat.wedge_count = 0; /* geometry alone */
  flat.corners = NULL;
  flat.wedge_vertex = NULL;
  flat.normals = NULL;
  flat.colors = NULL;
  flat.uvs[0] = flat.uvs[1] = NULL;
  if (lod_mesh_weld(&flat, arena, &side->mesh, NULL) != LOD_OK || lod_topology_measure(&side->mesh, NULL, arena, &side->topology) != LOD_OK)
    return lod_fail_memory(problem);
  return LOD_OK;
}

static enum lod_status measure(const struct side *a, const struct side *b, double relative, uint32_t threads, struct lod_arena *arena,
                               struct lod_distance *distance, struct lod_problem *problem) {
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.relative = relative;
  settings.threads = threads;
  settings.rms = true;
  if (lod_distance_measure(&a->mesh, &b->mesh, &settings, arena, distance) != LOD_OK)
    return lod_fail_memory(problem);
  /* What storing either model's positions as float may have moved. */
  double rounding = a->rounding + b->rounding;
  struct lod_interval *intervals[] = {&distance->a_to_b, &distance->b_to_a, &distance->two_sided};
  for (int i = 0; i < 3; i++) {
    intervals[i]->lower = fmax(0, intervals[i]->lower - rounding);
    intervals[i]->upper += rounding;
  }
  return LOD_OK;
}

static void print_json(const struct lod_distance *distance, double diagonal, const struct side *a, const struct side *b) {
  json_t *json = json_object();
  if (distance != NULL) {
    json_object_set_new(json, "lower", json_real(distance->two_sided.lower));
    json_object_set_new(json, "upper", json_real(distance->two_sided.upper));
    json_object_set_new(json, "rms", json_real(distance->rms));
    json_object_set_new(json, "a_to_b", json_pack("[f f]", distance->a_to_b.lower, distance->a_to_b.upper));
    json_object_set_new(json, "b_to_a", json_pack("[f f]", distance->b_to_a.lower, distance->b_to_a.upper));
    json_object_set_new(json, "complete", json_boolean(distance->complete));
  }
  json_object_set_new(json, "diagonal", json_real(diagonal));
  json_object_set_new(json, "a", cli_topology_json(&a->topology));
  json_object_set_new(json, "b", cli_topology_json(&b->topology));
  json_dumpf(json, stdout, JSON_COMPACT | JSON_REAL_PRECISION(12));
  printf("\n");
  json_decref(json);
}

static int print(const char *paths[2], bool topology_only, double relative, uint32_t threads, bool json) {
  struct lod_problem problem = {0};
  struct lod_arena *arena = lod_arena_create(0);
  struct side sides[2] = {0};
  struct lod_distance distance = {0};
  enum lod_status status = arena == NULL ? lod_fail_memory(&problem) : LOD_OK;
  for (int i = 0; i < 2 && status == LOD_OK; i++)
    status = load(paths[i], arena, &sides[i], &problem);
  if (status == LOD_OK && !topology_only)
    status = measure(&sides[0], &sides[1], relative, threads, arena, &distance, &problem);
  int exit_status = CLI_DONE;
  if (status != LOD_OK) {
    exit_status = cli_problem(&problem, json);
  } else {
    struct lod_bounds bounds = lod_mesh_bounds(&sides[0].mesh);
    double diagonal = lod_bounds_diagonal(&bounds);
    if (json) {
      print_json(topology_only ? NULL : &distance, diagonal, &sides[0], &sides[1]);
    } else {
      if (!topology_only) {
        printf("distance  [%.9g, %.9g]  (%.4g %% of the diagonal %.6g)%s\n", distance.two_sided.lower, distance.two_sided.upper,
               100 * distance.two_sided.upper / diagonal, diagonal, distance.complete ? "" : "  budget ran out: looser than asked for");
        printf("  A to B  [%.9g, %.9g]\n  B to A  [%.9g, %.9g]\nrms        %.9g (sampled)\n", distance.a_to_b.lower, distance.a_to_b.upper,
               distance.b_to_a.lower, distance.b_to_a.upper, distance.rms);
      }
      for (int i = 0; i < 2; i++) {
        printf("%s\n", paths[i]);
        cli_print_topology(&sides[i].topology);
      }
    }
  }
  for (int i = 0; i < 2; i++)
    cli_file_close(&sides[i].file);
  lod_arena_destroy(arena);
  return exit_status;
}

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_measure, .argc = argc, .argv = argv};
  const char *value = NULL;
  double relative = lod_distance_defaults().relative;
  uint64_t threads = 0;
  bool topology_only = false;
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (strcmp(option->name, "topology-only") == 0)
      topology_only = true;
    else if (strcmp(option->name, "relative") == 0 && (!cli_parse_real(value, &relative) || relative < 0))
      return cli_usage(&cli_measure, "--relative %s: expected a number, 0 or more", value);
    else if (strcmp(option->name, "jobs") == 0 && !cli_parse_count(value, 1024, &threads))
      return cli_usage(&cli_measure, "--jobs %s: expected a whole number up to 1024", value);
  }
  if (arguments.operand_count != 2)
    return cli_usage(&cli_measure, "expected two models, got %d", arguments.operand_count);
  return print(arguments.operands, topology_only, relative, (uint32_t)threads, arguments.json);
}
