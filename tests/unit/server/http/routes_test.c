#include "server/http/routes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

/* ---- the table and the document ---- */

static const char *method_key(enum lod_method method) {
  static const char *const kKeys[] = {"get", "head", "put", "delete", "post", "options"};
  return kKeys[method];
}

static void every_route_is_in_the_openapi_document_and_no_other(void **state) {
  (void)state;
  json_error_t error;
  json_t *document = json_loadb(lod_openapi_json, (size_t)(lod_openapi_json_end - lod_openapi_json), 0, &error);
  assert_non_null(document);
  assert_string_equal(json_string_value(json_object_get(document, "openapi")), "3.1.0");
  json_t *paths = json_object_get(document, "paths"), *path, *operation;
  uint32_t count, found = 0;
  const struct lod_route *routes = lod_routes(&count);
  for (uint32_t i = 0; i < count; i++) {
    operation = json_object_get(json_object_get(paths, routes[i].pattern), method_key(routes[i].method));
    if (!operation)
      fail_msg("%s %s is not in openapi.json", method_key(routes[i].method), routes[i].pattern);
  }
  const char *pattern, *key;
  json_object_foreach(paths, pattern, path) {
    json_object_foreach(path, key, operation) {
      if (strcmp(key, "parameters") == 0)
        continue;
      bool there = false;
      for (uint32_t i = 0; i < count; i++)
        there |= strcmp(routes[i].pattern, pattern) == 0 && strcmp(method_key(routes[i].method), key) == 0;
      if (!there)
        fail_msg("openapi.json has %s %s, the table has not", key, pattern);
      found++;
    }
  }
  assert_int_equal(found, count);
  json_decref(document);
}

/* Query parameters of an operation, references skipped (they are headers and path parameters). */
static void documented_query_parameters_are_those_that_are_checked(void **state) {
  (void)state;
  json_t *document = json_loadb(lod_openapi_json, (size_t)(lod_openapi_json_end - lod_openapi_json), 0, NULL);
  uint32_t count;
  const struct lod_route *routes = lod_routes(&count);
  for (uint32_t i = 0; i < count; i++) {
    if (!routes[i].parameters)
      continue;
    json_t *operation =
        json_object_get(json_object_get(json_object_get(document, "paths"), routes[i].pattern), method_key(routes[i].method));
    json_t *parameters = json_object_get(operation, "parameters"), *parameter;
    size_t index, documented = 0, known = 0;
    while (routes[i].parameters[known])
      known++;
    json_array_foreach(parameters, index, parameter) {
      const char *in = json_string_value(json_object_get(parameter, "in")), *name = json_string_value(json_object_get(parameter, "name"));
      if (!in || strcmp(in, "query") != 0)
        continue;
      bool there = false;
      for (size_t j = 0; j < known; j++)
        there |= strcmp(routes[i].parameters[j], name) == 0;
      if (!there)
        fail_msg("%s documents a parameter %s that is refused", routes[i].pattern, name);
      documented++;
    }
    assert_int_equal(documented, known);
  }
  json_decref(document);
}

static void collect_references(json_t *value, json_t *document) {
  const char *key;
  json_t *member;
  size_t index;
  if (json_is_object(value))
    json_object_foreach(value, key, member) {
      if (strcmp(key, "$ref") == 0) {
        char path[200];
        json_t *at = document;
        snprintf(path, sizeof path, "%s", json_string_value(member) + 2);
        for (char *part = strtok(path, "/"); part; part = strtok(NULL, "/"))
          at = json_object_get(at, part);
        if (!at)
          fail_msg("openapi.json refers to %s, which is not there", json_string_value(member));
      }
      collect_references(member, document);
    }
  json_array_foreach(value, index, member) collect_references(member, document);
}

static void references_of_the_document_resolve(void **state) {
  (void)state;
  json_t *document = json_loadb(lod_openapi_json, (size_t)(lod_openapi_json_end - lod_openapi_json), 0, NULL);
  collect_references(document, document);
  json_decref(document);
}

static void embedded_document_is_the_file(void **state) {
  (void)state;
  FILE *file = fopen("server/http/openapi.json", "r");
  if (!file)
    skip(); /* not run in the repository's root */
  static char text[1 << 20];
  size_t size = fread(text, 1, sizeof text, file);
  fclose(file);
  assert_int_equal(size, lod_openapi_json_end - lod_openapi_json);
  assert_memory_equal(text, lod_openapi_json, size);
}

/* ---- dispatch ---- */

static const char *authorization, *origin;
static const char *header(void *context, const char *name) {
  (void)context;
  return strcmp(name, "Authorization") == 0 ? authorization : strcmp(name, "Origin") == 0 ? origin : NULL;
}

static struct lod_config config;
static struct lod_service service = {.config = &config};
static struct lod_exchange exchange;
static char text[512];

static void begin(enum lod_method method, const char *target) {
  struct lod_query_problem problem = {0};
  lod_reply_finish(&exchange.reply);
  exchange = (struct lod_exchange){.service = &service, .method = method, .header = header};
  snprintf(text, sizeof text, "%s", target);
  assert_int_equal(lod_target_parse(text, &exchange.target, &problem), LOD_OK);
  lod_routes_begin(&exchange);
}

static const char *reply_header(const char *name) {
  for (uint32_t i = 0; i < exchange.reply.header_count; i++)
    if (strcmp(exchange.reply.headers[i].name, name) == 0)
      return exchange.reply.headers[i].value;
  return NULL;
}

static void paths_lead_to_their_routes(void **state) {
  (void)state;
  static const char *const kPairs[][2] = {
      {"/", "/"},
      {"/healthz", "/healthz"},
      {"/v1/models", "/v1/models"},
      {"/v1/models/level", "/v1/models/{id}"},
      {"/v1/models/bunny/level?px=1", "/v1/models/{id}/level"},
      {"/v1/models/b/0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef", "/v1/models/{id}/{sha256}"},
      {"/v1/objects/0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef", "/v1/objects/{sha256}"},
      {"/v1/models/b/tileset.json", "/v1/models/{id}/tileset.json"},
      {"/v1/models/b/model.glb", "/v1/models/{id}/model.glb"},
      {"/v1/jobs/12", "/v1/jobs/{n}"},
      {"/v1/jobs/12/events", "/v1/jobs/{n}/events"},
      {"/viewer/", "/viewer/{path}"},
      {"/viewer/a/b.js?v=1", "/viewer/{path}"},
  };
  for (size_t i = 0; i < sizeof kPairs / sizeof *kPairs; i++) {
    begin(LOD_GET, kPairs[i][0]);
    assert_int_equal(exchange.reply.status, 0);
    assert_string_equal(exchange.route->pattern, kPairs[i][1]);
    begin(LOD_HEAD, kPairs[i][0]);
    assert_int_equal(exchange.reply.status, 0);
  }
}

static void unknown_paths_are_404(void **state) {
  (void)state;
  static const char *const kPaths[] = {"/v1",
                                       "/v1/",
                                       "/healthz/",
                                       "/v1/models/",
                                       "/v1/models/a/deltas",
                                       "/v1/models/a/level/x",
                                       "/v1/jobs/x",
                                       "/v1/jobs/99999999999999999999",
                                       "/v1/objects/ABC",
                                       "/v1/models/a/tileset.glb",
                                       "/viewer",
                                       "/favicon.ico"};
  for (size_t i = 0; i < sizeof kPaths / sizeof *kPaths; i++) {
    begin(LOD_GET, kPaths[i]);
    assert_int_equal(exchange.reply.status, 404);
  }
}

static void wrong_method_is_405_with_what_is_allowed(void **state) {
  (void)state;
  begin(LOD_PUT, "/v1/models");
  assert_int_equal(exchange.reply.status, 405);
  assert_string_equal(reply_header("Allow"), "GET, HEAD, OPTIONS");
  begin(LOD_METHOD_OTHER, "/v1/models/a");
  assert_int_equal(exchange.reply.status, 405);
  assert_string_equal(reply_header("Allow"), "GET, HEAD, PUT, DELETE, OPTIONS");
}

static void preflight_allows_upload_with_a_token(void **state) {
  (void)state;
  begin(LOD_OPTIONS, "/v1/models/a");
  assert_int_equal(exchange.reply.status, 204);
  assert_non_null(strstr(reply_header("Access-Control-Allow-Methods"), "PUT"));
  assert_non_null(strstr(reply_header("Access-Control-Allow-Methods"), "DELETE"));
  assert_non_null(strstr(reply_header("Access-Control-Allow-Headers"), "Authorization"));
  begin(LOD_OPTIONS, "*");
  assert_int_equal(exchange.reply.status, 204);
}

static void unknown_parameter_is_refused_by_name(void **state) {
  (void)state;
  begin(LOD_GET, "/v1/models?limits=3");
  assert_int_equal(exchange.reply.status, 400);
  assert_non_null(strstr((const char *)exchange.reply.body->bytes, "\"parameter\":\"limits\""));
}

static void changes_need_the_token_and_reading_does_not(void **state) {
  (void)state;
  char path[] = "/tmp/lodestream-token-XXXXXX";
  int fd = mkstemp(path);
  assert_true(fd >= 0);
  assert_int_equal(write(fd, "secret\n", 7), 7);
  close(fd);
  struct lod_tokens *tokens;
  bool plain;
  assert_int_equal(lod_tokens_read(path, NULL, &tokens, &plain, NULL), LOD_OK);
  assert_true(plain);
  unlink(path);
  service.tokens = tokens;
  static const char *const kWrong[] = {NULL, "", "Basic secret", "Bearer", "Bearer ", "Bearer secre", "Bearer secret2", "secret"};
  for (size_t i = 0; i < sizeof kWrong / sizeof *kWrong; i++) {
    authorization = kWrong[i];
    begin(LOD_DELETE, "/v1/models/a");
    assert_int_equal(exchange.reply.status, 401);
    assert_non_null(strstr(reply_header("WWW-Authenticate"), "Bearer"));
    begin(LOD_GET, "/v1/models/a");
    assert_int_equal(exchange.reply.status, 0);
  }
  authorization = "bearer secret";
  begin(LOD_DELETE, "/v1/models/a");
  assert_int_equal(exchange.reply.status, 0);
  authorization = NULL;
  service.tokens = NULL;
  lod_tokens_destroy(tokens);
}

/* ---- headers ---- */

static char emitted[4096];
static void emit(void *context, const char *name, const char *value) {
  (void)context;
  snprintf(emitted + strlen(emitted), sizeof emitted - strlen(emitted), "%s: %s\n", name, value);
}

static const char *headers_for(const char *cors, const char *from) {
  config.cors = (char *)cors;
  origin = from;
  emitted[0] = 0;
  begin(LOD_GET, "/nope");
  lod_routes_headers(&exchange, emit, NULL);
  return emitted;
}

static void every_reply_is_protected_and_open_to_the_allowed_origins(void **state) {
  (void)state;
  const char *all = headers_for("*", "https://a.example");
  assert_non_null(strstr(all, "Access-Control-Allow-Origin: *\n"));
  assert_non_null(strstr(all, "X-Content-Type-Options: nosniff\n"));
  assert_non_null(strstr(all, "Cross-Origin-Resource-Policy: cross-origin\n"));
  assert_non_null(strstr(all, "Timing-Allow-Origin: *\n"));
  assert_non_null(strstr(all, "Cache-Control: no-store\n"));
  assert_null(strstr(all, "Vary"));
  all = headers_for("https://b.example https://a.example", "https://a.example");
  assert_non_null(strstr(all, "Access-Control-Allow-Origin: https://a.example\n"));
  assert_non_null(strstr(all, "Vary: Origin\n"));
  all = headers_for("https://b.example https://a.example", "https://a.example.evil");
  assert_null(strstr(all, "Access-Control-Allow-Origin"));
  assert_non_null(strstr(all, "Vary: Origin\n"));
  all = headers_for("none", "https://a.example");
  assert_null(strstr(all, "Access-Control-Allow-Origin"));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_route_is_in_the_openapi_document_and_no_other),
      cmocka_unit_test(documented_query_parameters_are_those_that_are_checked),
      cmocka_unit_test(references_of_the_document_resolve),
      cmocka_unit_test(embedded_document_is_the_file),
      cmocka_unit_test(paths_lead_to_their_routes),
      cmocka_unit_test(unknown_paths_are_404),
      cmocka_unit_test(wrong_method_is_405_with_what_is_allowed),
      cmocka_unit_test(preflight_allows_upload_with_a_token),
      cmocka_unit_test(unknown_parameter_is_refused_by_name),
      cmocka_unit_test(changes_need_the_token_and_reading_does_not),
      cmocka_unit_test(every_reply_is_protected_and_open_to_the_allowed_origins),
  };
  int failed = cmocka_run_group_tests(tests, NULL, NULL);
  lod_reply_finish(&exchange.reply);
  return failed;
}
