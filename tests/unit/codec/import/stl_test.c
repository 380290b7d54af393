#include "tests/data/shapes.h"
#include "tests/unit/codec/import/importing.h"

static struct test_bytes binary_stl(const struct lod_mesh *mesh) {
  struct test_bytes stl = {0};
  char header[80] = "solid that is binary all the same";
  test_append(&stl, header, sizeof header);
  test_append_u32(&stl, mesh->triangle_count);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const float normal[3] = {0, 0, 0};
    test_append(&stl, normal, sizeof normal);
    for (int k = 0; k < 3; k++)
      test_append(&stl, mesh->positions[mesh->triangles[t][k]], 3 * sizeof(float));
    test_append(&stl, "\0\0", 2);
  }
  return stl;
}

static void a_binary_cube_comes_back_with_eight_shared_corners(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  struct test_bytes stl = binary_stl(&cube);
  struct test_import i = test_import_bytes(stl.bytes, stl.size, NULL);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "stl");
  assert_int_equal(i.model.units[0].mesh.vertex_count, 8);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 12);
  assert_true(i.model.rounding == 0);
  test_import_end(&i);
  free(stl.bytes);
  lod_arena_destroy(arena);
}

static void every_prefix_of_a_binary_cube_is_refused(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh cube = lod_shape_cube(arena, 2);
  struct test_bytes stl = binary_stl(&cube);
  for (size_t n = 0; n < stl.size; n++) {
    struct test_import i = test_import_bytes(stl.bytes, n, "cube.stl");
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
  free(stl.bytes);
  lod_arena_destroy(arena);
}

static const char kText[] =
    "solid two words\n"
    "  facet normal 0 0 1\n    outer loop\n      vertex 0 0 0\n      vertex 1 0 0\n      vertex 1 1 0\n      vertex 0 1 0\n"
    "    endloop\n  endfacet\n"
    "  FACET NORMAL 0 0 1\r\n    OUTER LOOP\r\n VERTEX 0 0 0\r\n VERTEX 0 1 0\r\n VERTEX -1e-3 1 0\r\n ENDLOOP\r\n ENDFACET\r\n"
    "endsolid two words\n";

static void text_with_a_loop_of_four_makes_two_triangles_of_it(void **state) {
  (void)state;
  struct test_import i = test_import_bytes(kText, strlen(kText), "a.txt");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 3);
  assert_int_equal(i.model.units[0].mesh.vertex_count, 5);
  test_import_end(&i);
}

static void every_prefix_of_a_text_is_refused(void **state) {
  (void)state;
  /* Up to "endsolid": what follows is a name. */
  for (size_t n = 0; n < strlen(kText) - strlen("endsolid two words\n"); n++) {
    struct test_import i = test_import_bytes(kText, n, "a.stl");
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
}

static void a_text_with_another_word_names_the_line(void **state) {
  (void)state;
  const char *text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertx 1 0 0\nendloop\nendfacet\nendsolid\n";
  struct test_import i = test_import_bytes(text, strlen(text), "a.stl");
  assert_string_equal(i.problem.type, "bad-syntax");
  assert_non_null(strstr(i.problem.detail, "line 5"));
  test_import_end(&i);
}

static void hoppes_mesh_with_gaps_in_its_numbers_is_read(void **state) {
  (void)state;
  const char *text = "# comment\nVertex 1 0 0 0 {normal=(0 0 1)}\nVertex 7 1 0 0\nVertex 3 0 1 0.5\nFace 1 1 7 3 {rgb=(1 0 0)}\n";
  struct test_import i = test_import_bytes(text, strlen(text), "a.m");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 1);
  test_import_end(&i);
  text = "Vertex 1 0 0 0\nVertex 2 1 0 0\nFace 1 1 2 3\n";
  test_expect_problem(test_import_bytes(text, strlen(text), "a.m"), "index-out-of-range");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_binary_cube_comes_back_with_eight_shared_corners),
      cmocka_unit_test(every_prefix_of_a_binary_cube_is_refused),
      cmocka_unit_test(text_with_a_loop_of_four_makes_two_triangles_of_it),
      cmocka_unit_test(every_prefix_of_a_text_is_refused),
      cmocka_unit_test(a_text_with_another_word_names_the_line),
      cmocka_unit_test(hoppes_mesh_with_gaps_in_its_numbers_is_read),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
