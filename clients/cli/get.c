/* lodestream get: asks a server for the level that meets a screen error, over HTTP. */
#include <curl/curl.h>
#include <errno.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "clients/cli/cli.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {
    {"output", 'o', "FILE", "Where the GLB goes; - is standard output. Required."},
    {"px", 0, "P", "Screen error to meet, in pixels. Default 1."},
    {"distance", 0, "D", "From the eye to the surface of the model's bounding sphere, in model units."},
    {"fov", 0, "DEGREES", "Vertical field of view. Default 60."},
    {"height", 0, "PIXELS", "Height of the window. Default 1080."},
    {"error", 0, "E", "Error to meet in model units, instead of pixels."},
    {"max-bytes", 0, "N", "The least error in at most so many bytes."},
    {"max-triangles", 0, "N", "The least error in at most so many triangles."},
    {"family", 0, "NAME", "A family, or auto (default): whichever needs the fewest bytes."},
    {"token", 0, "FILE", "File with a bearer token, for servers that want one."},
    {0},
};

const struct cli_command cli_get = {
    .name = "get",
    .usage = "URL -o FILE [options]",
    .sentence = "Fetch the level that meets a screen error from a server.",
    .text = "URL is a model's: http://host:port/v1/models/ID\n\n"
            "  lodestream get http://127.0.0.1:8080/v1/models/bunny --px 1 --distance 2 --fov 60 --height 1080 -o out.glb",
    .options = kOptions,
    .run = run,
};

struct answer {
  FILE *out;
  char *problem; /* the body of an error answer */
  size_t problem_size;
  CURL *curl;
  json_t *facts;
};

static size_t receive_body(char *bytes, size_t size, size_t count, void *context) {
  struct answer *answer = context;
  long status = 0;
  curl_easy_getinfo(answer->curl, CURLINFO_RESPONSE_CODE, &status);
  if (status == 200)
    return fwrite(bytes, size, count, answer->out) * size;
  size_t add = size * count;
  if (answer->problem_size + add < 65536) {
    char *grown = realloc(answer->problem, answer->problem_size + add + 1);
    if (grown == NULL)
      return 0;
    memcpy(grown + answer->problem_size, bytes, add);
    answer->problem = grown;
    answer->problem_size += add;
    grown[answer->problem_size] = '\0';
  }
  return add;
}

static size_t receive_header(char *bytes, size_t size, size_t count, void *context) {
  static const char *const kWanted[] = {"lod-family",    "lod-level",        "lod-error", "lod-screen-error",
                                        "lod-triangles", "content-location", "etag"};
  struct answer *answer = context;
  size_t length = size * count;
  const char *colon = memchr(bytes, ':', length);
  for (size_t i = 0; colon != NULL && i < sizeof kWanted / sizeof kWanted[0]; i++) {
    size_t name = (size_t)(colon - bytes);
    if (name != strlen(kWanted[i]) || strncasecmp(bytes, kWanted[i], name) != 0)
      continue;
    const char *value = colon + 1, *end = bytes + length;
    while (value < end && (*value == ' ' || *value == '\t'))
      value++;
    while (end > value && (end[-1] == '\r' || end[-1] == '\n' || end[-1] == ' '))
      end--;
    json_object_set_new(answer->facts, kWanted[i], json_stringn(value, (size_t)(end - value)));
  }
  return length;
}

static void append(char *url, size_t capacity, const char *name, const char *value, CURL *curl) {
  char *escaped = curl_easy_escape(curl, value, 0);
  size_t length = strlen(url);
  snprintf(url + length, capacity - length, "%c%s=%s", strchr(url, '?') == NULL ? '?' : '&', name, escaped == NULL ? "" : escaped);
  curl_free(escaped);
}

static enum lod_status read_token(const char *path, char header[512], struct lod_problem *problem) {
  FILE *in = fopen(path, "r");
  if (in == NULL)
    return lod_fail(problem, LOD_IO, "cannot-open", "Cannot open the token's file %s: %s.", path, strerror(errno));
  char token[400] = "";
  bool got = fgets(token, sizeof token, in) != NULL;
  fclose(in);
  token[strcspn(token, "\r\n")] = '\0';
  if (!got || token[0] == '\0')
    return lod_fail(problem, LOD_BAD_INPUT, "no-token", "The first line of %s is empty; expected a token.", path);
  snprintf(header, 512, "Authorization: Bearer %s", token);
  return LOD_OK;
}

/* Puts the file into place and prints the facts, or prints the problem. part: what was downloaded; NULL: standard output. */
static int report(struct answer *answer, CURLcode code, const char *url, const char *error, bool json, const char *part,
                  const char *output) {
  long status = 0;
  curl_easy_getinfo(answer->curl, CURLINFO_RESPONSE_CODE, &status);
  struct lod_problem problem = {0};
  if (code != CURLE_OK) {
    lod_fail(&problem, LOD_IO, "no-answer", "%s: %s.", url, error[0] ? error : curl_easy_strerror(code));
    return cli_problem(&problem, json);
  }
  if (status != 200) {
    json_t *body = answer->problem == NULL ? NULL : json_loads(answer->problem, 0, NULL);
    const char *detail = json_string_value(json_object_get(body, "detail"));
    lod_fail(&problem, LOD_BAD_INPUT, "http-status", "%s: status %ld%s%s", url, status, detail ? ": " : "", detail ? detail : ".");
    json_decref(body);
    return cli_problem(&problem, json);
  }
  if (part != NULL && rename(part, output) != 0) {
    lod_fail(&problem, LOD_IO, "write-failed", "Cannot write %s: %s.", output, strerror(errno));
    return cli_problem(&problem, json);
  }
  curl_off_t bytes = 0;
  curl_easy_getinfo(answer->curl, CURLINFO_SIZE_DOWNLOAD_T, &bytes);
  json_object_set_new(answer->facts, "bytes", json_integer(bytes));
  FILE *out = part == NULL ? stderr : stdout;
  if (json) {
    json_dumpf(answer->facts, out, JSON_COMPACT);
    fprintf(out, "\n");
  } else {
    const char *name;
    json_t *value;
    json_object_foreach(answer->facts, name, value) {
      if (json_is_string(value))
        fprintf(out, "%-18s %s\n", name, json_string_value(value));
      else
        fprintf(out, "%-18s %lld\n", name, (long long)json_integer_value(value));
    }
  }
  return CLI_DONE;
}

/* Downloads into FILE.part, renamed when it is whole: an answer cut short leaves no broken GLB. */
static int fetch(CURL *curl, const char *url, const char *token_path, const char *output, bool json) {
  char part[4096], error[CURL_ERROR_SIZE] = "", token[512];
  bool to_stdout = strcmp(output, "-") == 0;
  snprintf(part, sizeof part, "%s.part", output);
  struct lod_problem problem = {0};
  if (token_path != NULL && read_token(token_path, token, &problem) != LOD_OK)
    return cli_problem(&problem, json);
  struct answer answer = {.out = to_stdout ? stdout : fopen(part, "wb"), .curl = curl, .facts = json_object()};
  if (answer.out == NULL) {
    lod_fail(&problem, LOD_IO, "cannot-open", "Cannot write %s: %s.", part, strerror(errno));
    json_decref(answer.facts);
    return cli_problem(&problem, json);
  }
  struct curl_slist *headers = NULL;
  if (token_path != NULL)
    headers = curl_slist_append(headers, token);
  curl_easy_setopt(curl, CURLOPT_URL, url);
  curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https");
  curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
  curl_easy_setopt(curl, CURLOPT_USERAGENT, "lodestream/" LOD_VERSION);
  curl_easy_setopt(curl, CURLOPT_CONNECTTIMEOUT, 10L);
  curl_easy_setopt(curl, CURLOPT_LOW_SPEED_LIMIT, 1L);
  curl_easy_setopt(curl, CURLOPT_LOW_SPEED_TIME, 60L);
  curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, error);
  curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, receive_body);
  curl_easy_setopt(curl, CURLOPT_WRITEDATA, &answer);
  curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, receive_header);
  curl_easy_setopt(curl, CURLOPT_HEADERDATA, &answer);
  CURLcode code = curl_easy_perform(curl);
  if (!to_stdout && fclose(answer.out) != 0 && code == CURLE_OK)
    code = CURLE_WRITE_ERROR;
  int exit_status = report(&answer, code, url, error, json, to_stdout ? NULL : part, output);
  if (!to_stdout && exit_status != CLI_DONE)
    unlink(part);
  curl_slist_free_all(headers);
  json_decref(answer.facts);
  free(answer.problem);
  return exit_status;
}

static int run(int argc, char **argv) {
  /* Option names and the query's names. */
  static const char *const kQuery[][2] = {{"px", "px"},
                                          {"distance", "distance"},
                                          {"fov", "fov"},
                                          {"height", "height"},
                                          {"error", "error"},
                                          {"max-bytes", "max_bytes"},
                                          {"max-triangles", "max_triangles"},
                                          {"family", "family"}};
  struct cli_arguments arguments = {.command = &cli_get, .argc = argc, .argv = argv};
  const char *output = NULL, *token = NULL, *value = NULL;
  const char *query[sizeof kQuery / sizeof kQuery[0]] = {NULL};
  for (const struct cli_option *option; (option = cli_next(&arguments, &value)) != NULL;) {
    if (strcmp(option->name, "output") == 0)
      output = value;
    else if (strcmp(option->name, "token") == 0)
      token = value;
    for (size_t i = 0; i < sizeof kQuery / sizeof kQuery[0]; i++)
      if (strcmp(option->name, kQuery[i][0]) == 0)
        query[i] = value;
  }
  if (arguments.operand_count != 1)
    return cli_usage(&cli_get, "expected one URL, got %d", arguments.operand_count);
  if (output == NULL)
    return cli_usage(&cli_get, "-o FILE is missing");
  curl_global_init(CURL_GLOBAL_DEFAULT);
  CURL *curl = curl_easy_init();
  if (curl == NULL)
    return CLI_LIMIT;
  char url[4096];
  size_t length = strlen(arguments.operands[0]);
  while (length > 0 && arguments.operands[0][length - 1] == '/')
    length--;
  snprintf(url, sizeof url, "%.*s/level", (int)length, arguments.operands[0]);
  for (size_t i = 0; i < sizeof kQuery / sizeof kQuery[0]; i++)
    if (query[i] != NULL)
      append(url, sizeof url, kQuery[i][1], query[i], curl);
  int status = fetch(curl, url, token, output, arguments.json);
  curl_easy_cleanup(curl);
  curl_global_cleanup();
  return status;
}
