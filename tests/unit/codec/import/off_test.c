/* OFF as text: letters of the header, attributes, faces of any size, and what damaged files say. */
#include "tests/unit/codec/import/importing.h"

#include <math.h>

static struct test_import import(const char *text) {
  return test_import_bytes(text, strlen(text), "a.off");
}

static void quads_become_triangles(void **state) {
  (void)state;
  struct test_import i = import("OFF\n# square\n4 1 0\n0 0 0 # a corner\n1 0 0\r\n\n1 1 0\n0 1 0\n4 0 1 2 3 255 0 0\n");
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "off");
  assert_int_equal(i.model.source_triangles, 2);
  assert_int_equal(i.model.material_count, 0);
  test_import_end(&i);
  i = import("OFF 3 1 999999999999999\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2"); /* edges are not believed */
  test_expect_ok(&i);
  test_import_end(&i);
  i = import("OFF 3 1\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2");
  test_expect_ok(&i);
  assert_int_equal(i.model.source_triangles, 1);
  test_import_end(&i);
}

static void attributes_follow_the_letters_of_the_header(void **state) {
  (void)state;
  struct test_import i =
      import("STCNOFF\n3 1 3\n0 0 0 0 0 1 255 0 0 0.25 0.5\n1 0 0 0 0 1 0 255 0 128 1 0\n0 1 0 0 0 1 0 0 255 0 1\n3 0 1 2\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_true(i.model.parts[0].has_normals && i.model.parts[0].has_colors);
  assert_non_null(mesh->normals);
  assert_non_null(mesh->colors);
  assert_non_null(mesh->uvs[0]);
  for (uint32_t w = 0; w < 3; w++) {
    const uint32_t v = mesh->wedge_count > 0 ? mesh->wedge_vertex[w] : w;
    const float *p = mesh->positions[v], *color = mesh->colors[w];
    assert_true(fabsf(mesh->normals[w][2] - 1) < 1e-3f);
    const int kind = p[0] > 0.5f ? 1 : p[1] > 0.5f ? 2 : 0;
    for (int c = 0; c < 3; c++)
      assert_true(fabsf(color[c] - (c == kind ? 1.f : 0.f)) < 0.01f);
    assert_true(fabsf(color[3] - (kind == 1 ? 128.f / 255 : 1.f)) < 0.01f);
    if (kind == 0)
      assert_true(fabsf(mesh->uvs[0][w][0] - 0.25f) < 1e-3f);
  }
  test_import_end(&i);
}

static void homogeneous_positions_are_divided(void **state) {
  (void)state;
  struct test_import i = import("4OFF\n3 1 3\n0 0 0 1\n4 0 0 2\n0 6 0 3\n3 0 1 2\n");
  test_expect_ok(&i);
  float furthest = 0;
  for (uint32_t v = 0; v < i.model.units[0].mesh.vertex_count; v++)
    furthest = fmaxf(furthest, i.model.units[0].mesh.positions[v][0] * (float)i.model.units[0].scale);
  assert_true(furthest <= 2);
  test_import_end(&i);
  test_expect_problem(import("nOFF 4\n3 1 3\n0 0 0 1\n4 0 0 2\n0 6 0 3\n3 0 1 2\n"), "unsupported");
  test_expect_problem(import("OFF BINARY\n3 1 3\n"), "unsupported");
}

static void damaged_files_are_refused_by_name(void **state) {
  (void)state;
  test_expect_problem(import("OFF\n4000000000 1 0\n0 0 0\n"), "truncated");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0 0\n"), "truncated");
  test_expect_problem(import("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), "truncated");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1"), "truncated");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"), "index-out-of-range");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"), "index-out-of-range");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n"), "bad-syntax");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n"), "bad-syntax");
  test_expect_problem(import("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4000000000 0 1 2\n"), "bad-syntax");
  test_expect_problem(import("OFF\n3.5 1 0\n0 0 0\n"), "bad-header");
  /* A face that is not one: assimp's reader went past its memory here. */
  static const char kFuzzed[] = "OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n/\0\0\0\0\0\0"
                                "2 3@";
  test_expect_problem(test_import_bytes(kFuzzed, sizeof kFuzzed - 1, "a.off"), "empty");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(quads_become_triangles), cmocka_unit_test(attributes_follow_the_letters_of_the_header),
      cmocka_unit_test(homogeneous_positions_are_divided), cmocka_unit_test(damaged_files_are_refused_by_name)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
