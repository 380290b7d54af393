#include "codec/export/ply.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

#include "codec/import/import.h"
#include "tests/data/models.h"

/* Back through the importer, which every other program's reader resembles. */
static struct lod_model read_back(struct lod_arena *arena, const struct lod_mesh *mesh) {
  uint8_t *bytes;
  size_t size;
  struct lod_problem problem = {0};
  if (lod_ply_encode(mesh, "a test", arena, &bytes, &size, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  struct lod_import_request request = {.name = "test.ply", .bytes = bytes, .size = size, .threads = 1};
  struct lod_model model;
  if (lod_import_model(&request, arena, &model, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  assert_int_equal(model.unit_count, 1);
  return model;
}

static void triangles_and_attributes_come_back(void **state) {
  (void)state;
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_model model = lod_sample_model(arena, number);
    for (uint32_t u = 0; u < model.unit_count; u++) {
      const struct lod_mesh *mesh = &model.units[u].mesh;
      struct lod_model back = read_back(arena, mesh);
      const struct lod_mesh *other = &back.units[0].mesh;
      assert_int_equal(other->triangle_count, mesh->triangle_count);
      assert_int_equal(other->normals != NULL, mesh->normals != NULL);
      assert_int_equal(other->uvs[0] != NULL, mesh->uvs[0] != NULL);
      assert_int_equal(other->colors != NULL, mesh->colors != NULL);
      for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int c = 0; c < 3; c++) {
          for (int i = 0; i < 3; i++)
            assert_true(other->positions[other->triangles[t][c]][i] == mesh->positions[mesh->triangles[t][c]][i]);
          for (int i = 0; i < 3 && mesh->normals != NULL; i++)
            assert_float_equal(other->normals[other->corners[t][c]][i], mesh->normals[mesh->corners[t][c]][i], 1e-6);
          for (int i = 0; i < 2 && mesh->uvs[0] != NULL; i++)
            assert_float_equal(other->uvs[0][other->corners[t][c]][i], mesh->uvs[0][mesh->corners[t][c]][i], 1e-6);
          for (int i = 0; i < 4 && mesh->colors != NULL; i++)
            assert_float_equal(other->colors[other->corners[t][c]][i], mesh->colors[mesh->corners[t][c]][i], 0.005);
        }
    }
    lod_arena_destroy(arena);
  }
}

static void edges_are_an_element_of_their_own_with_thickness(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_branches(arena);
  const struct lod_mesh *mesh = &model.units[0].mesh;
  uint8_t *bytes;
  size_t size;
  assert_int_equal(lod_ply_encode(mesh, NULL, arena, &bytes, &size, NULL), LOD_OK);
  const char *header = lod_arena_copy(arena, bytes, size), *end = strstr(header, "end_header\n");
  char expected[64];
  snprintf(expected, sizeof expected, "element edge %u\n", mesh->edge_count);
  assert_non_null(strstr(header, expected));
  assert_null(strstr(header, "comment"));
  const size_t begin = (size_t)(end - header) + strlen("end_header\n");
  assert_int_equal(size, begin + 12 * (size_t)mesh->vertex_count + 13 * (size_t)mesh->triangle_count + 12 * (size_t)mesh->edge_count);
  const uint8_t *last = bytes + size - 12;
  uint32_t ends[2];
  float thickness;
  memcpy(ends, last, 8);
  memcpy(&thickness, last + 8, 4);
  assert_memory_equal(ends, mesh->edges[mesh->edge_count - 1], 8);
  assert_true(thickness == mesh->edge_thickness[mesh->edge_count - 1]);
  lod_arena_destroy(arena);
}

static void a_full_disk_is_reported(void **state) {
  (void)state;
  FILE *full = fopen("/dev/full", "wb");
  if (full == NULL)
    skip();
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_smooth(arena);
  struct lod_problem problem = {0};
  assert_int_equal(lod_ply_write(&model.units[0].mesh, NULL, full, &problem), LOD_IO);
  assert_string_not_equal(problem.detail, "");
  fclose(full);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(triangles_and_attributes_come_back),
      cmocka_unit_test(edges_are_an_element_of_their_own_with_thickness),
      cmocka_unit_test(a_full_disk_is_reported),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
