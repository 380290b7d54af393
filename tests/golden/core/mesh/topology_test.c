/* The facts of every PLY model of shared/models/{scans,cad,thin,iso} as shared/tools/checkmesh states them (topology.tsv beside this). */
#include "core/mesh/topology.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/import/import.h"

enum { COLUMNS = 16 };
static const char *const kColumns[COLUMNS] = {
    "vertices", "triangles",  "degenerate", "edges", "components", "boundary edges", "boundary loops", "non-manifold edges",
    "bow ties", "duplicates", "zero areas", "euler", "genus",      "manifold",       "closed",         "oriented"};
static const int64_t kUndefined = INT64_MIN;

static uint8_t *read_file(const char *path, size_t *size) {
  FILE *file = fopen(path, "rb");
  if (file == NULL)
    return NULL;
  assert_int_equal(fseek(file, 0, SEEK_END), 0);
  *size = (size_t)ftell(file);
  rewind(file);
  uint8_t *bytes = malloc(*size + 1);
  assert_non_null(bytes);
  assert_int_equal(fread(bytes, 1, *size, file), *size);
  fclose(file);
  return bytes;
}

static void facts_of(const struct lod_mesh *mesh, struct lod_arena *arena, int64_t facts[COLUMNS]) {
  struct lod_topology t;
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &t), LOD_OK);
  const int64_t all[COLUMNS] = {t.vertices,
                                t.triangles,
                                t.degenerate_triangles,
                                t.edges,
                                t.components,
                                t.boundary_edges,
                                t.boundary_loops,
                                t.non_manifold_edges,
                                t.non_manifold_vertices,
                                t.duplicate_triangles,
                                t.zero_area_triangles,
                                t.euler,
                                t.has_genus ? t.genus : kUndefined,
                                t.manifold,
                                t.closed,
                                t.oriented};
  memcpy(facts, all, sizeof all);
}

/* Differences between the line's figures and the model's; each is printed. */
static int compare_line(const char *folder, char *line) {
  char path[1024], *save = NULL, *name = strtok_r(line, "\t\n", &save);
  snprintf(path, sizeof path, "%s/models/%s", folder, name);
  size_t size = 0;
  uint8_t *bytes = read_file(path, &size);
  if (bytes == NULL)
    return -1;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_import_request request = {.name = name, .bytes = bytes, .size = size, .threads = 1};
  struct lod_model model;
  struct lod_problem problem = {0};
  enum lod_status status = lod_import_model(&request, arena, &model, &problem);
  int different = 0;
  int64_t facts[COLUMNS] = {0};
  if (status != LOD_OK)
    print_error("%s: %s\n", name, problem.detail);
  else
    facts_of(&model.units[0].mesh, arena, facts);
  for (int c = 0; status == LOD_OK && c < COLUMNS; c++) {
    const char *cell = strtok_r(NULL, "\t\n", &save);
    assert_non_null(cell);
    int64_t expected = strcmp(cell, "-") == 0 ? kUndefined : strtoll(cell, NULL, 10);
    if (facts[c] != expected) {
      print_error("%s: %s is %" PRId64 ", checkmesh says %s\n", name, kColumns[c], facts[c], cell);
      different++;
    }
  }
  lod_arena_destroy(arena);
  free(bytes);
  return status == LOD_OK ? different : 1;
}

static void every_model_has_the_facts_that_checkmesh_states(void **state) {
  (void)state;
  const char *folder = getenv("LODESTREAM_SHARED");
  FILE *table = fopen("tests/golden/core/mesh/topology.tsv", "r");
  assert_non_null(table);
  char line[1024];
  int different = 0, compared = 0, lines = 0;
  while (fgets(line, sizeof line, table) != NULL) {
    if (line[0] == '#')
      continue;
    lines++;
    int result = compare_line(folder != NULL ? folder : "../shared", line);
    compared += result >= 0;
    different += result > 0;
  }
  fclose(table);
  assert_int_equal(lines, 71);
  assert_int_equal(different, 0);
  if (compared == 0)
    skip();
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(every_model_has_the_facts_that_checkmesh_states)};
  return cmocka_run_group_tests_name("golden core/mesh/topology", tests, NULL, NULL);
}
