/* lodestream refine: subdivide a model, or a level of a bake, where a degree of interest says so. */
#include <errno.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "server/worker/refine.h"

static int run(int argc, char **argv);

/* Those of the query, with dashes. */
static const struct cli_option kOptions[] = {
    {"output", 'o', "OUT.glb", "Where the refined model goes. Required, but for --contact."},
    {"contact", 0, NULL, "Print where --point touches the refined surface: point, normal, distance."},
    {"values", 0, "FILE", "Interest of your own: 32-bit floats in [0, 1], one for each triangle, corner or vertex of the base."},
    {"doi", 0, "LIST", "uniform, silhouette, curvature, screen, focus, gaze, contact, attribute, patches; several with commas."},
    {"combine", 0, "HOW", "How several interests combine: max (default) or product."},
    {"gather", 0, "HOW", "How values at edges and vertices become a triangle's: max (default), mean, min."},
    {"steps", 0, "N", "Deepest level of subdivision, 0 to 10; default 3."},
    {"max-triangles", 0, "N", "The most triangles of the result; what is most wanted is refined first."},
    {"max-bytes", 0, "N", "The most bytes that its geometry may take, likewise."},
    {"base", 0, "FAMILY[:LEVEL]", "Of a bake: what is refined; default: the finest level of at most 5000 triangles."},
    {"form", 0, "FORM", "Of silhouette: face (default), edge, static, cone."},
    {"eye", 0, "X,Y,Z", "The viewer: silhouette, screen, gaze."},
    {"direction", 0, "X,Y,Z", "From the model towards a viewer far away, instead of --eye: silhouette."},
    {"angle", 0, "DEGREES", "silhouette (face 20, static 30, cone 0), curvature (10)."},
    {"fov", 0, "DEGREES", "Vertical field of view: screen; default 60."},
    {"height", 0, "PIXELS", "Of the picture: screen; default 1080."},
    {"px", 0, "PIXELS", "Error that is let pass: screen; default 1."},
    {"look", 0, "X,Y,Z", "The point looked at: gaze."},
    {"part", 0, "LIST", "Names or numbers of parts: focus."},
    {"point", 0, "X,Y,Z", "focus (several with semicolons), contact."},
    {"dominance", 0, "D,D,...", "How much each part, then each point, matters, 0 to 1: focus. Default 1 each."},
    {"falloff", 0, "LENGTH", "Where interest has gone: focus; default a quarter of the model's size."},
    {"distance", 0, "FROM", "centre (default) or skeleton of a part: focus."},
    {"attribute", 0, "CHANNEL", "red, green, blue, alpha, u, v, or doi, the model's own (glTF _DOI, PLY property doi): attribute."},
    {"per", 0, "WHAT", "What --values stand for: triangle, corner, vertex, or count (default): whichever their count fits."},
    {"threshold", 0, "ERROR", "Of equation 6: patches; default 1."},
    {"scheme", 0, "SCHEME", "loop (default), paper (other vertices stay unmoved), sqrt3."},
    {"crease", 0, "DEGREES", "Edges that bend more stay sharp; default none."},
    {"corner", 0, "DEGREES", "Sharp lines that turn more have a corner; default none."},
    {"touch", 0, "LENGTH", "Boundary vertices nearer than this are one; default 0."},
    {"positions", 0, "WHERE", "limit (default) or level."},
    {"encoding", 0, "CODING", "plain (default) or draco."},
    {0},
};

const struct cli_command cli_refine = {
    .name = "refine",
    .usage = "MODEL|DIR -o OUT.glb --doi LIST [options]",
    .sentence = "Subdivide where a degree of interest says so.",
    .text = "  lodestream refine bunny.ply -o fine.glb --doi silhouette --eye 0,0.1,1 --angle 20\n"
            "  lodestream refine engine -o fine.glb --base envelope:3 --doi focus --part piston --falloff 0.2\n"
            "  lodestream refine bunny.ply --contact --point 0,0.2,0 --steps 5",
    .options = kOptions,
    .run = run,
};

enum { MAX_PARAMETERS = 32, DEFAULT_BASE_TRIANGLES = 5000 };
static const uint64_t kMostTriangles = 64u << 20;

struct job {
  struct lod_refine_parameter list[MAX_PARAMETERS];
  char names[MAX_PARAMETERS][LOD_REFINE_QUERY_PARAMETER + 1];
  uint32_t count;
  const char *output, *values, *input;
  bool contact;
  struct lod_refine_query query;
};

/* ---- the base ---- */

static double number_of(const json_t *level, const char *name) {
  return json_number_value(json_object_get(level, name));
}

/* The level of a bake that is asked for, or the finest of at most DEFAULT_BASE_TRIANGLES, or the coarsest. Borrowed from the manifest. */
static const char *choose(json_t *families, const struct lod_refine_query *q) {
  const char *name, *best = NULL;
  double best_error = 0, best_triangles = 0;
  json_t *family;
  json_object_foreach(families, name, family) {
    size_t i;
    json_t *level;
    if (q->family[0] != 0 && strcmp(q->family, name) != 0)
      continue;
    json_array_foreach(json_object_get(family, "levels"), i, level) {
      const char *object = json_string_value(json_object_get(level, "object"));
      double error = number_of(level, "error"), triangles = number_of(level, "triangles");
      if (object == NULL || (q->has_level && number_of(level, "level") != (double)q->level))
        continue;
      bool small = triangles <= DEFAULT_BASE_TRIANGLES, was = best_triangles <= DEFAULT_BASE_TRIANGLES;
      if (best == NULL || (small && !was) || (small == was && (small ? error < best_error : triangles < best_triangles))) {
        best = object;
        best_error = error;
        best_triangles = triangles;
      }
    }
  }
  return best;
}

/* path: of the file that holds the base. */
static enum lod_status find_base(const struct job *job, char *path, size_t size, struct lod_problem *problem) {
  struct stat facts;
  if (stat(job->input, &facts) != 0)
    return lod_fail(problem, LOD_IO, "cannot-open", "Cannot open %s: %s.", job->input, strerror(errno));
  if (!S_ISDIR(facts.st_mode)) {
    snprintf(path, size, "%s", job->input);
    return job->query.family[0] == 0
               ? LOD_OK
               : lod_fail(problem, LOD_BAD_INPUT, "bad-parameter", "--base names a level of a bake; %s is a file.", job->input);
  }
  snprintf(path, size, "%s/manifest.json", job->input);
  json_error_t error;
  json_t *manifest = json_load_file(path, 0, &error);
  if (manifest == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-manifest", "%s holds no readable manifest.json: %s.", job->input, error.text);
  const char *object = choose(json_object_get(manifest, "families"), &job->query);
  if (object != NULL)
    snprintf(path, size, "%s/objects/%s", job->input, object);
  json_decref(manifest);
  return object != NULL ? LOD_OK : lod_fail(problem, LOD_BAD_INPUT, "unknown-base", "%s has no level like --base asks for.", job->input);
}

/* ---- running ---- */

static enum lod_status write_file(const char *path, const uint8_t *bytes, size_t size, struct lod_problem *problem) {
  bool to_stdout = strcmp(path, "-") == 0;
  FILE *out = to_stdout ? stdout : fopen(path, "wb");
  bool written = out != NULL && fwrite(bytes, 1, size, out) == size;
  if (out != NULL && (to_stdout ? fflush(out) : fclose(out)) != 0)
    written = false;
  return written ? LOD_OK : lod_fail(problem, LOD_IO, "write-failed", "Cannot write %s: %s.", path, strerror(errno));
}

static enum lod_status touch(struct lod_refine_base *base, const struct job *job, struct lod_problem *problem) {
  struct lod_contact c;
  LOD_TRY(lod_refine_touch(base, &job->query, &c, problem));
  printf("{\"point\":[%.9g,%.9g,%.9g],\"normal\":[%.9g,%.9g,%.9g],\"distance\":%.9g,\"steps\":%u}\n", c.point[0], c.point[1], c.point[2],
         c.normal[0], c.normal[1], c.normal[2], c.distance, job->query.steps);
  return LOD_OK;
}

static enum lod_status refine(struct lod_refine_base *base, const struct job *job, const struct cli_file *values, bool json,
                              struct lod_problem *problem) {
  struct lod_refine_request request = {.query = &job->query,
                                       .values = (const float *)(const void *)values->bytes,
                                       .value_count = values->size / sizeof(float),
                                       .max_triangles = kMostTriangles};
  struct lod_refine_answer answer;
  char parameter[LOD_REFINE_QUERY_PARAMETER + 1];
  LOD_TRY(lod_refine_answer(base, &request, &answer, parameter, problem));
  LOD_TRY(write_file(job->output, answer.bytes, answer.size, problem));
  FILE *facts = strcmp(job->output, "-") == 0 ? stderr : stdout;
  char count[32], from[32], bytes[32];
  if (json)
    fprintf(facts, "{\"triangles\":%u,\"vertices\":%u,\"base_triangles\":%u,\"deepest\":%u,\"budget\":%s,\"bytes\":%zu}\n",
            answer.triangles, answer.vertices, answer.base_triangles, answer.deepest, answer.budget ? "true" : "false", answer.size);
  else
    fprintf(facts, "%s triangles from %s, %u steps deep, %s%s\n", cli_count(answer.triangles, count),
            cli_count(answer.base_triangles, from), answer.deepest, cli_bytes(answer.size, bytes),
            answer.budget ? "; the budget ended before the interest did" : "");
  return LOD_OK;
}

static enum lod_status work(struct job *job, bool json, struct lod_problem *problem) {
  struct cli_file file = {0}, values = {0};
  struct lod_refine_base *base = NULL;
  char path[4096];
  enum lod_status status = find_base(job, path, sizeof path, problem);
  if (status == LOD_OK)
    status = cli_file_open(path, &file, problem);
  if (status == LOD_OK && job->values != NULL)
    status = cli_file_open(job->values, &values, problem);
  if (status == LOD_OK)
    status = lod_refine_base_create(path, file.bytes, file.size, 0, &base, problem);
  if (status == LOD_OK)
    status = job->contact ? touch(base, job, problem) : refine(base, job, &values, json, problem);
  lod_refine_base_destroy(base);
  cli_file_close(&values);
  cli_file_close(&file);
  return status;
}

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_refine, .argc = argc, .argv = argv};
  struct job job = {0};
  const struct cli_option *option;
  const char *value = NULL;
  while ((option = cli_next(&arguments, &value)) != NULL) {
    if (strcmp(option->name, "output") == 0) {
      job.output = value;
    } else if (strcmp(option->name, "contact") == 0) {
      job.contact = true;
    } else if (strcmp(option->name, "values") == 0) {
      job.values = value;
    } else if (job.count < MAX_PARAMETERS) {
      snprintf(job.names[job.count], sizeof job.names[0], "%s", option->name);
      for (char *c = job.names[job.count]; *c != 0; c++)
        *c = *c == '-' ? '_' : *c;
      job.list[job.count] = (struct lod_refine_parameter){job.names[job.count], value};
      job.count++;
    }
  }
  if (arguments.operand_count != 1)
    return cli_usage(&cli_refine, "expected one MODEL or DIR, got %d", arguments.operand_count);
  if (job.output == NULL && !job.contact)
    return cli_usage(&cli_refine, "-o OUT.glb is missing");
  if (job.contact && job.count < MAX_PARAMETERS)
    job.list[job.count++] = (struct lod_refine_parameter){"doi", "contact"};
  job.input = arguments.operands[0];
  char parameter[LOD_REFINE_QUERY_PARAMETER + 1];
  struct lod_problem problem = {0};
  if (lod_refine_query_parse(job.list, job.count, job.values != NULL, &job.query, parameter, &problem) != LOD_OK)
    return cli_usage(&cli_refine, "%s", problem.detail);
  return work(&job, arguments.json, &problem) == LOD_OK ? CLI_DONE : cli_problem(&problem, arguments.json);
}
