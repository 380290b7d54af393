/* Importing bytes in tests: exact-size heap buffers, GLBs from a JSON text and a BIN chunk, files from a table. */
#ifndef LOD_TESTS_UNIT_CODEC_IMPORT_IMPORTING_H
#define LOD_TESTS_UNIT_CODEC_IMPORT_IMPORTING_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "codec/import/import.h"

struct test_import {
  struct lod_arena *arena;
  struct lod_model model;
  struct lod_problem problem;
  enum lod_status status;
  uint8_t *bytes; /* exact size: reading past the end is seen */
};

struct test_file {
  const char *name;
  const void *bytes;
  size_t size;
};

struct test_files {
  const struct test_file *files;
  size_t count;
  char asked[256]; /* the last name */
};

static enum lod_status test_read_file(void *context, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                                      struct lod_problem *problem) {
  struct test_files *files = context;
  snprintf(files->asked, sizeof files->asked, "%s", uri);
  for (size_t i = 0; i < files->count; i++)
    if (strcmp(files->files[i].name, uri) == 0) {
      *bytes = lod_arena_copy(arena, files->files[i].bytes, files->files[i].size);
      *size = files->files[i].size;
      return LOD_OK;
    }
  return lod_fail(problem, LOD_BAD_INPUT, "missing-file", "'%s' is not there", uri);
}

static inline struct test_import test_import_with(const void *bytes, size_t size, const char *name, struct test_files *files,
                                                  const struct lod_import_limits *limits) {
  struct test_import import = {.arena = lod_arena_create((size_t)1 << 30), .bytes = malloc(size ? size : 1)};
  struct lod_import_files source = {test_read_file, files};
  assert_non_null(import.arena);
  if (size > 0)
    memcpy(import.bytes, bytes, size);
  struct lod_import_request request = {
      .name = name, .bytes = import.bytes, .size = size, .files = files ? &source : NULL, .limits = limits, .threads = 1};
  import.status = lod_import_model(&request, import.arena, &import.model, &import.problem);
  if (import.status != LOD_OK) {
    assert_true(import.problem.status == import.status);
    assert_true(import.problem.type[0] != 0 && import.problem.detail[0] != 0);
  }
  return import;
}

static inline struct test_import test_import_bytes(const void *bytes, size_t size, const char *name) {
  return test_import_with(bytes, size, name, NULL, NULL);
}

static inline void test_import_end(struct test_import *import) {
  lod_arena_destroy(import->arena);
  free(import->bytes);
}

static inline void test_expect_problem(struct test_import import, const char *type) {
  if (import.status == LOD_OK || strcmp(import.problem.type, type) != 0)
    fail_msg("expected '%s', got status %d '%s': %s", type, (int)import.status, import.problem.type, import.problem.detail);
  test_import_end(&import);
}

static inline void test_expect_ok(const struct test_import *import) {
  if (import->status != LOD_OK)
    fail_msg("%s: %s", import->problem.type, import->problem.detail);
}

static inline bool test_has_warning(const struct lod_model *model, const char *words) {
  for (uint32_t i = 0; i < model->warning_count; i++)
    if (strstr(model->warnings[i], words))
      return true;
  return false;
}

/* Growing bytes. */
struct test_bytes {
  uint8_t *bytes;
  size_t size;
};

static inline void test_append(struct test_bytes *to, const void *bytes, size_t size) {
  to->bytes = realloc(to->bytes, to->size + size + 1);
  assert_non_null(to->bytes);
  memcpy(to->bytes + to->size, bytes, size);
  to->size += size;
}

static inline void test_append_u32(struct test_bytes *to, uint32_t value) {
  const uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
  test_append(to, bytes, 4);
}

/* A GLB; bin may be NULL. */
static inline struct test_bytes test_glb(const char *json, const void *bin, size_t bin_size) {
  struct test_bytes glb = {0};
  size_t json_size = (strlen(json) + 3) / 4 * 4, padded = (bin_size + 3) / 4 * 4;
  test_append(&glb, "glTF", 4);
  test_append_u32(&glb, 2);
  test_append_u32(&glb, (uint32_t)(20 + json_size + (bin ? 8 + padded : 0)));
  test_append_u32(&glb, (uint32_t)json_size);
  test_append(&glb, "JSON", 4);
  test_append(&glb, json, strlen(json));
  while (glb.size % 4)
    test_append(&glb, " ", 1);
  if (bin) {
    test_append_u32(&glb, (uint32_t)padded);
    test_append(&glb, "BIN", 4);
    test_append(&glb, bin, bin_size);
    while (glb.size % 4)
      test_append(&glb, "", 1);
  }
  return glb;
}

static inline struct test_import test_import_glb(const char *json, const void *bin, size_t bin_size) {
  struct test_bytes glb = test_glb(json, bin, bin_size);
  struct test_import import = test_import_bytes(glb.bytes, glb.size, "test.glb");
  free(glb.bytes);
  return import;
}

#endif
